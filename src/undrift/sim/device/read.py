"""Read: what a simulated device says to a motion."""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, frozen
from undrift.record import Record
from undrift.sim.device.device import Rounding, SimulatedDevice, SimulatedThermometer, SimulatedTriad
from undrift.sim.motion.motion import Motion
from undrift.sim.streams import Streams, draw_streams


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reading:
    """A record, and where its sensors ran out of range.

    Parameters
    ----------
    record : Record
        Raw readings.
    gyro_saturated, accel_saturated : array of bool, shape (N, 3)
        True where a reading was held to full scale.
    """

    record: Record
    gyro_saturated: BoolArray
    accel_saturated: BoolArray


def read(
    device: SimulatedDevice,
    motion: Motion,
    *,
    rng: np.random.Generator,
    temp_c: float | FloatArray | None = None,
) -> Reading:
    """Return the readings of a device in a motion.

    Parameters
    ----------
    device : SimulatedDevice
        The sensors.
    motion : Motion
        N samples.
    rng : Generator
        Draws the noise, each effect from a stream of its own.
    temp_c : float or array, shape (N,), optional
        Temperature of the board, degC; the reference temperature where not given.

    Returns
    -------
    Reading
        Record in frame s, raw, with the thermometer's column.

    Raises
    ------
    InputError
        A temperature for another number of samples.
    """
    n = len(motion)
    temp = device.reference_temp_c if temp_c is None else temp_c
    true_temp = frozen(np.full(n, temp) if np.ndim(temp) == 0 else temp, (n,), "temp_c")
    warmth = true_temp - device.reference_temp_c
    streams = draw_streams(rng)
    rate = motion.mean_rate_b if device.sampling == "mean" else motion.rate_b
    gyro = _felt(device.gyro, rate, motion, warmth) + _noise(device.gyro, motion, streams, "gyro")
    accel = _felt(device.accel, motion.force_b, motion, warmth) + _noise(device.accel, motion, streams, "accel")
    gyro_raw, gyro_saturated = _digitised(device.gyro, gyro * device.gyro.sensitivity)
    accel_raw, accel_saturated = _digitised(device.accel, accel * device.accel.sensitivity)
    record = Record(
        time=motion.time,
        gyro=gyro_raw,
        accel=accel_raw,
        temp_c=_thermometer(device.thermometer, motion.time, true_temp, streams),
        gyro_unit=device.gyro.unit,
        accel_unit=device.accel.unit,
        device=device.serial,
    )
    return Reading(record=record, gyro_saturated=gyro_saturated, accel_saturated=accel_saturated)


def round_to_step(values: FloatArray, lsb: float, rounding: Rounding) -> FloatArray:
    """Return values rounded to whole steps.

    Parameters
    ----------
    values : array
        Any unit.
    lsb : float
        The step, same unit; 0 rounds nothing.
    rounding : str
        nearest, floor or toward_zero.

    Returns
    -------
    array
        Same shape.
    """
    if lsb == 0.0:
        return values
    steps = values / lsb
    if rounding == "nearest":
        whole = np.rint(steps)
    elif rounding == "floor":
        whole = np.floor(steps)
    else:
        whole = np.trunc(steps)
    rounded: FloatArray = whole * lsb
    return rounded


def _felt(triad: SimulatedTriad, x: FloatArray, motion: Motion, warmth: FloatArray) -> FloatArray:
    felt: FloatArray = x @ triad.axes.T + triad.offset
    if triad.offset_per_k.any():
        felt = felt + np.outer(warmth, triad.offset_per_k)
    if triad.g_sensitivity.any():
        felt = felt + motion.force_b @ triad.g_sensitivity.T
    return felt


def _noise(triad: SimulatedTriad, motion: Motion, streams: Streams, name: str) -> FloatArray:
    shape, sample_rate_hz = (len(motion), 3), motion.sample_rate_hz
    noise = np.zeros(shape)
    if triad.random_walk.any():
        noise = noise + streams.of(name + "_white").standard_normal(shape) * (
            triad.random_walk * np.sqrt(sample_rate_hz)
        )
    if triad.bias_walk.any():
        steps = streams.of(name + "_walk").standard_normal(shape) * (triad.bias_walk / np.sqrt(sample_rate_hz))
        steps[0] = 0.0
        noise = noise + np.cumsum(steps, axis=0)
    return noise


def _digitised(triad: SimulatedTriad, raw: FloatArray) -> tuple[FloatArray, BoolArray]:
    codes = round_to_step(raw, triad.lsb, triad.rounding)
    saturated: BoolArray = np.abs(codes) > triad.full_scale
    return np.clip(codes, -triad.full_scale, triad.full_scale), saturated


def _thermometer(
    thermometer: SimulatedThermometer, time: FloatArray, true_temp: FloatArray, streams: Streams
) -> FloatArray:
    temp: FloatArray = true_temp
    if thermometer.lag_s > 0.0 and np.ptp(true_temp) > 0.0:
        from scipy.signal import lfilter

        keep = float(np.exp(-(time[-1] - time[0]) / (len(time) - 1) / thermometer.lag_s))
        temp = np.asarray(lfilter([1.0 - keep], [1.0, -keep], true_temp, zi=[keep * true_temp[0]])[0])
    if thermometer.noise_c > 0.0:
        temp = temp + streams.of("thermometer").normal(0.0, thermometer.noise_c, len(time))
    return round_to_step(temp + thermometer.offset_c, thermometer.lsb_c, "nearest")
