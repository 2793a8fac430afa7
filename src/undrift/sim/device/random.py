"""Random devices: units of a production run, drawn from a grade.

A grade states how units spread: tolerances as standard deviations, noise as typical values. The figures of the presets
are those of consumer and industrial parts as their datasheets and users state them; "wearable" is a body-worn logger that
writes deg/s and g, truncated.
"""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from undrift.errors import InputError
from undrift.sim.device.device import Rounding, SimulatedDevice, SimulatedThermometer, SimulatedTriad
from undrift.sim.streams import Streams, draw_streams
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

DPS = RADIAN_PER_DEGREE
MG = 1e-3 * STANDARD_GRAVITY

GradeName = Literal["consumer", "industrial", "wearable"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TriadGrade:
    """How the sensors of one kind spread over units.

    Parameters
    ----------
    unit : str
        Unit of the reading.
    sensitivity : float
        Nominal, raw unit per rad/s or m/s2.
    sensitivity_sd : float
        Relative standard deviation of it.
    misalignment_sd : float
        Of each axis about each axis across it, rad.
    offset_sd : float
        rad/s or m/s2.
    offset_per_k_sd : float
        rad/s/K or m/s2/K.
    g_sensitivity_sd : float
        rad/s per m/s2.
    random_walk : float
        White noise, rad/s/sqrt(Hz) or m/s2/sqrt(Hz).
    bias_walk : float
        rad/s/sqrt(s) or m/s2/sqrt(s).
    lsb : float
        Step, raw unit.
    rounding : str
        nearest, floor or toward_zero.
    full_scale : float
        Raw unit.
    """

    unit: str
    sensitivity: float
    sensitivity_sd: float
    misalignment_sd: float
    offset_sd: float
    offset_per_k_sd: float
    g_sensitivity_sd: float = 0.0
    random_walk: float
    bias_walk: float
    lsb: float = 1.0
    rounding: Rounding = "nearest"
    full_scale: float = 32767.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Grade:
    """How devices spread over units.

    Parameters
    ----------
    gyro, accel : TriadGrade
        The sensors.
    thermometer : SimulatedThermometer
        The same in every unit.
    """

    gyro: TriadGrade
    accel: TriadGrade
    thermometer: SimulatedThermometer = field(default_factory=lambda: SimulatedThermometer(noise_c=0.05, lsb_c=0.125))


def grade_named(name: GradeName) -> Grade:
    """Return a preset.

    Parameters
    ----------
    name : str
        consumer: 16-bit counts, 2000 deg/s and 8 g. industrial: the same codes, an order quieter and truer. wearable:
        deg/s and g with a coarse step, cut off toward zero.

    Returns
    -------
    Grade
        How its units spread.

    Raises
    ------
    InputError
        A name that is not one.
    """
    if name == "consumer":
        return _CONSUMER
    if name == "industrial":
        return _INDUSTRIAL
    if name == "wearable":
        return _WEARABLE
    raise InputError(f"grade: wanted consumer, industrial or wearable, got '{name}'; name one of them or give a Grade")


def random_device(
    rng: np.random.Generator, *, grade: GradeName | Grade = "consumer", serial: str = ""
) -> SimulatedDevice:
    """Draw one unit of a production run.

    Parameters
    ----------
    rng : Generator
        Draws each property from a stream of its own.
    grade : str or Grade
        How units spread.
    serial : str
        Serial number; drawn where not given.

    Returns
    -------
    SimulatedDevice
        Its true values are its fields.

    Raises
    ------
    InputError
        A grade that is not one.
    """
    chosen = grade_named(grade) if isinstance(grade, str) else grade
    streams = draw_streams(rng)
    return SimulatedDevice(
        serial=serial or f"SIM-{streams.of('serial').integers(0, 10**6):06d}",
        gyro=_triad(chosen.gyro, streams, "gyro"),
        accel=_triad(chosen.accel, streams, "accel"),
        thermometer=chosen.thermometer,
    )


def _triad(grade: TriadGrade, streams: Streams, name: str) -> SimulatedTriad:
    def draw(effect: str, sd: float, shape: tuple[int, ...] = (3,)) -> np.ndarray:
        return streams.of(f"{name}_{effect}").normal(0.0, sd, shape)

    lean = draw("axes", grade.misalignment_sd, (3, 3))
    axes = np.where(np.eye(3, dtype=bool), 1.0, lean)
    return SimulatedTriad(
        unit=grade.unit,
        sensitivity=grade.sensitivity * (1.0 + draw("sensitivity", grade.sensitivity_sd)),
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        offset=draw("offset", grade.offset_sd),
        offset_per_k=draw("offset_per_k", grade.offset_per_k_sd),
        g_sensitivity=draw("g_sensitivity", grade.g_sensitivity_sd, (3, 3)),
        random_walk=np.full(3, grade.random_walk),
        bias_walk=np.full(3, grade.bias_walk),
        lsb=grade.lsb,
        rounding=grade.rounding,
        full_scale=grade.full_scale,
    )


# One-sided densities of datasheets are divided by sqrt(2): see SimulatedTriad.random_walk.
_CONSUMER = Grade(
    gyro=TriadGrade(
        unit="count",
        sensitivity=16.4 / DPS,
        sensitivity_sd=0.01,
        misalignment_sd=0.01,
        offset_sd=3.0 * DPS,
        offset_per_k_sd=0.05 * DPS,
        g_sensitivity_sd=0.1 * DPS / STANDARD_GRAVITY,
        random_walk=0.007 * DPS / math.sqrt(2.0),
        bias_walk=3e-4 * DPS,
    ),
    accel=TriadGrade(
        unit="count",
        sensitivity=4096.0 / STANDARD_GRAVITY,
        sensitivity_sd=0.01,
        misalignment_sd=0.01,
        offset_sd=40.0 * MG,
        offset_per_k_sd=0.5 * MG,
        random_walk=0.18 * MG / math.sqrt(2.0),
        bias_walk=2e-3 * MG,
    ),
)
_INDUSTRIAL = Grade(
    gyro=TriadGrade(
        unit="count",
        sensitivity=4755.0,
        sensitivity_sd=0.002,
        misalignment_sd=0.002,
        offset_sd=0.5 * DPS,
        offset_per_k_sd=0.005 * DPS,
        g_sensitivity_sd=0.003 * DPS / STANDARD_GRAVITY,
        random_walk=0.003 * DPS / math.sqrt(2.0),
        bias_walk=1e-4 * DPS,
    ),
    accel=TriadGrade(
        unit="count",
        sensitivity=415.0,
        sensitivity_sd=0.002,
        misalignment_sd=0.002,
        offset_sd=10.0 * MG,
        offset_per_k_sd=0.1 * MG,
        random_walk=0.08 * MG / math.sqrt(2.0),
        bias_walk=5e-4 * MG,
    ),
)
_WEARABLE = Grade(
    gyro=TriadGrade(
        unit="dps",
        sensitivity=1.0 / DPS,
        sensitivity_sd=0.003,
        misalignment_sd=0.004,
        offset_sd=0.3 * DPS,
        offset_per_k_sd=0.02 * DPS,
        random_walk=0.006 * DPS,
        bias_walk=2e-4 * DPS,
        lsb=0.061,
        rounding="toward_zero",
        full_scale=2000.0,
    ),
    accel=TriadGrade(
        unit="g",
        sensitivity=1.0 / STANDARD_GRAVITY,
        sensitivity_sd=0.003,
        misalignment_sd=0.004,
        offset_sd=20.0 * MG,
        offset_per_k_sd=0.2 * MG,
        random_walk=0.3 * MG,
        bias_walk=1e-3 * MG,
        lsb=0.0005,
        full_scale=16.0,
    ),
)
