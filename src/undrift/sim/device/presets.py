"""Presets: kinds of devices by name, as grades whose tolerance is two standard deviations and the end of the spread.

``enc03j_3031`` is the note's device: three Murata ENC-03J gyroscopes and three ICSensors 3031 accelerometers, a gain stage and
a second-order low-pass for each channel, 12 bits at 5 V, an LM335 on the board. The others are digital parts of ``sheets.py``.
"""

import math
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from undrift.errors import InputError
from undrift.sim.device.adc import Adc
from undrift.sim.device.amplifier import Amplifier
from undrift.sim.device.grade import Grade, TriadGrade
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.random import random_device, typical_device
from undrift.sim.device.sampling import Sampling
from undrift.sim.device.sheets import SHEETS, AccelSheet, GyroSheet, Sheet
from undrift.sim.device.thermometer import Thermometer, lm335
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

PresetName = Literal[
    "enc03j_3031", "mpu6050", "icm20948", "bmi160", "bmi270", "bmi088", "lsm6dso", "xsens_mti1", "shimmer3"
]
PRESETS: tuple[str, ...] = get_args(PresetName)
LIMIT_SD = 2.0
DPS = RADIAN_PER_DEGREE
G = STANDARD_GRAVITY
FLOOR = math.sqrt(2.0 * math.log(2.0) / math.pi)  # of the Allan deviation over B: data sheets state the floor
ONE_SIDED = math.sqrt(2.0)  # a data sheet's density over the random walk


def preset(name: str) -> DeviceModel:
    """Return the typical device of a kind: every error at half its tolerance, with signs that alternate by axis.

    Parameters
    ----------
    name : str
        One of ``PRESETS``.

    Returns
    -------
    DeviceModel
        The same at every call.

    Raises
    ------
    InputError
        A name that is not one.
    """
    return typical_device(preset_grade(name), serial=f"{name}-typical")


def random_device_of(name: str, rng: np.random.Generator, *, serial: str = "") -> DeviceModel:
    """Draw a unit of a kind within its tolerances.

    Parameters
    ----------
    name : str
        One of ``PRESETS``.
    rng : Generator
        Draws each property from a stream of its own.
    serial : str
        Serial number; where not given it follows from the kind and all that is drawn.

    Returns
    -------
    DeviceModel
        Its true values are its fields.

    Raises
    ------
    InputError
        A name that is not one.
    """
    return random_device(rng, grade=preset_grade(name), serial=serial)


def preset_grade(name: str) -> Grade:
    """Return how the units of a kind spread.

    Parameters
    ----------
    name : str
        One of ``PRESETS``.

    Returns
    -------
    Grade
        Cut off at two standard deviations, the tolerance.

    Raises
    ------
    InputError
        A name that is not one.
    """
    if name == "enc03j_3031":
        return _enc03j_3031()
    for sheet in SHEETS:
        if sheet.name == name:
            return _digital(sheet)
    raise InputError(
        f"preset: wanted one of {', '.join(PRESETS)}, got '{name}'; name one of them or give a device.json"
    )


def _digital(sheet: Sheet) -> Grade:
    return Grade(
        name=sheet.name,
        gyro=_gyro(sheet.gyro),
        accel=_accel(sheet.accel),
        thermometer=Thermometer(noise_c=0.05, step_c=0.125),
        trim_error_sd=0.5,
        sampling=Sampling(gyro_averaging="interval", accel_averaging="interval"),
        limit_sd=LIMIT_SD,
        source_tag=f"gyro {sheet.gyro.tag}; accel {sheet.accel.tag}",
    )


def _gyro(sheet: GyroSheet) -> TriadGrade:
    return TriadGrade(
        unit="count" if sheet.counts_per_dps else "rad/s",
        sensitivity=sheet.counts_per_dps / DPS or 1.0,
        sensitivity_sd=0.01 * sheet.scale_percent / LIMIT_SD,
        misalignment_sd=0.01 * sheet.cross_percent / LIMIT_SD,
        nonlinearity_sd=0.01 * sheet.nonlinearity_percent / LIMIT_SD,
        offset_sd=sheet.offset_dps * DPS / LIMIT_SD,
        offset_per_k_sd=sheet.offset_dps_per_k * DPS / LIMIT_SD,
        scale_per_k_sd=0.01 * sheet.scale_percent_per_k / LIMIT_SD,
        g_sensitivity_sd=sheet.g_dps_per_g * DPS / G / LIMIT_SD,
        random_walk=sheet.noise_dps_per_sqrt_hz * DPS / ONE_SIDED,
        instability=sheet.instability_deg_per_h * DPS / 3600.0 / FLOOR,
        full_scale=sheet.range_dps * DPS,
        adc=Adc(bits=16, reference=2.0**15) if sheet.counts_per_dps else None,
    )


def _accel(sheet: AccelSheet) -> TriadGrade:
    return TriadGrade(
        unit="count" if sheet.counts_per_g else "m/s2",
        sensitivity=sheet.counts_per_g / G or 1.0,
        sensitivity_sd=0.01 * sheet.scale_percent / LIMIT_SD,
        misalignment_sd=0.01 * sheet.cross_percent / LIMIT_SD,
        nonlinearity_sd=0.01 * sheet.nonlinearity_percent / LIMIT_SD,
        offset_sd=1e-3 * G * sheet.offset_mg / LIMIT_SD,
        offset_per_k_sd=1e-3 * G * sheet.offset_mg_per_k / LIMIT_SD,
        scale_per_k_sd=0.01 * sheet.scale_percent_per_k / LIMIT_SD,
        random_walk=1e-6 * G * sheet.noise_ug_per_sqrt_hz / ONE_SIDED,
        instability=1e-3 * G * sheet.instability_mg / FLOOR,
        full_scale=sheet.range_g * G,
        adc=Adc(bits=16, reference=2.0**15) if sheet.counts_per_g else None,
    )


def _enc03j_3031() -> Grade:
    """Return the note's device. Tags stand beside the figures; what the note leaves unsaid is assumed."""
    board = Adc(bits=12, reference=5.0, signed=False)  # assumed
    gyro = TriadGrade(
        unit="count",
        sensitivity=0.67e-3 / DPS,  # V per deg/s, found
        sensitivity_sd=0.20 / LIMIT_SD,  # known
        misalignment_sd=0.01 / LIMIT_SD,  # assumed
        nonlinearity_sd=0.001 / LIMIT_SD,  # found, after calibration; 5 % by specification
        offset_sd=5.0 * DPS / LIMIT_SD,  # assumed: what trimming leaves
        offset_per_k_sd=0.07 * DPS,  # assumed, inferred from the note
        offset_per_k2_sd=1.5e-3 * DPS,  # assumed
        scale_per_k_sd=0.002,  # assumed
        rate_drift_sd=2e-4 / LIMIT_SD,  # assumed
        g_sensitivity_sd=0.02 * DPS / G,  # assumed
        warm_up_sd=0.15 * DPS,  # found on the sister type: 0.05 to 0.25 deg/s
        warm_up_s=600.0,  # assumed
        hysteresis_sd=0.05 * DPS,  # assumed
        random_walk=0.011 * DPS / ONE_SIDED,  # calc
        instability=10.0 * DPS / 3600.0 / FLOOR,  # assumed
        full_scale=300.0 * DPS,  # found
        amplifier=Amplifier(gain=20.0, null=2.5, low=0.0, high=5.0),  # assumed
        cutoff_hz=11.1,  # note, Table 1: sit-to-stand
        part_sd=0.01 / LIMIT_SD,  # assumed
        adc=board,
    )
    accel = TriadGrade(
        unit="count",
        sensitivity=10e-3 / G,  # V per g, assumed
        sensitivity_sd=0.30 / LIMIT_SD,  # assumed
        misalignment_sd=0.01 / LIMIT_SD,  # assumed
        nonlinearity_sd=0.002 / LIMIT_SD,  # assumed
        offset_sd=0.2 * G / LIMIT_SD,  # assumed: what trimming leaves of 2.5 g
        offset_per_k_sd=0.4e-3 * G / LIMIT_SD,  # assumed
        scale_per_k_sd=0.0002 / LIMIT_SD,  # assumed
        lever_arm_sd=0.5e-3,  # found: positioning error of the authors' simulation
        random_walk=100e-6 * G / ONE_SIDED,  # assumed
        instability=0.02e-3 * G / FLOOR,  # assumed
        full_scale=2.0 * G,  # assumed
        amplifier=Amplifier(gain=75.0, null=2.5, low=0.0, high=5.0),  # assumed
        cutoff_hz=11.1,
        part_sd=0.01 / LIMIT_SD,
        adc=board,
    )
    return Grade(
        name="enc03j_3031",
        gyro=gyro,
        accel=accel,
        thermometer=replace(lm335(), noise_c=0.05),
        trim_error_sd=1.0,  # known: after a one-point trim, 2 at most
        sampling=Sampling(gyro_averaging="instant", accel_averaging="instant"),
        limit_sd=LIMIT_SD,
        source_tag="note, found, calc, known and assumed: see presets.py",
    )
