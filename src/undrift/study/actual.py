"""The "actual" device of the note's Figure 3, and the model of it that a study works with.

The study's model is a unit without the effects that a study leaves out; the actual device is the same unit with them::

    hysteresis      offset differs between warming and cooling               as the kind of device has it
    thermometer     board thermometer lags behind the sensors                80 s, LM335 in still air
    adc_inl         integral non-linearity of the converter, a bow           2 LSB [assumed], gyroscopes and accelerometers
    g_sensitivity   specific force feigns a rate                             as the kind of device has it

All else, above all gains, offsets and their drift over temperature, is the same in both.
"""

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from undrift.errors import InputError
from undrift.sim.device.chain import SensorChain
from undrift.sim.device.model import DeviceModel

Hidden = Literal["hysteresis", "thermometer", "adc_inl", "g_sensitivity"]
HIDDEN: tuple[Hidden, ...] = get_args(Hidden)
INL_LSB = 2.0  # [assumed] what 12-bit converters of the note's time are specified to
LEAST_LAG_S = 80.0  # LM335 in still air


def study_model(unit: DeviceModel) -> DeviceModel:
    """Return a unit as a study models it: without the hidden effects.

    Parameters
    ----------
    unit : DeviceModel
        A unit of a preset.

    Returns
    -------
    DeviceModel
        Same gains, offsets, drift and noise.
    """
    return replace(
        unit,
        gyro=_plain(unit.gyro),
        accel=_plain(unit.accel),
        thermometer=replace(unit.thermometer, lag_s=0.0),
    )


def actual_device(unit: DeviceModel, hidden: tuple[Hidden, ...] = HIDDEN) -> DeviceModel:
    """Return a unit with the effects that the study's model lacks, or some of them.

    Parameters
    ----------
    unit : DeviceModel
        A unit of a preset, which says how large its hysteresis, g-sensitivity and lag are.
    hidden : tuple of str
        Which effects are on: hysteresis, thermometer, adc_inl, g_sensitivity.

    Returns
    -------
    DeviceModel
        ``study_model(unit)`` and those effects.

    Raises
    ------
    InputError
        An effect that is not one.
    """
    unknown = [name for name in hidden if name not in HIDDEN]
    if unknown:
        raise InputError(f"actual device: wanted effects of {', '.join(HIDDEN)}, got '{unknown[0]}'; name some of them")
    made = study_model(unit)
    gyro, accel, thermometer = made.gyro, made.accel, made.thermometer
    if "hysteresis" in hidden:
        gyro = replace(gyro, hysteresis=unit.gyro.hysteresis)
        accel = replace(accel, hysteresis=unit.accel.hysteresis)
    if "g_sensitivity" in hidden:
        gyro = replace(gyro, g_sensitivity=unit.gyro.g_sensitivity)
    if "adc_inl" in hidden:
        gyro, accel = _bowed(gyro), _bowed(accel)
    if "thermometer" in hidden:
        thermometer = replace(thermometer, lag_s=max(unit.thermometer.lag_s, LEAST_LAG_S))
    return replace(made, gyro=gyro, accel=accel, thermometer=thermometer)


def _plain(chain: SensorChain) -> SensorChain:
    adc = None if chain.adc is None else replace(chain.adc, inl_lsb=np.zeros(3))
    return replace(chain, hysteresis=None, g_sensitivity=None, adc=adc)


def _bowed(chain: SensorChain) -> SensorChain:
    return chain if chain.adc is None else replace(chain, adc=replace(chain.adc, inl_lsb=np.full(3, INL_LSB)))
