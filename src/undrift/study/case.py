"""A device in a trial: its readings, and the remaining error of the pitch after correction.

    readings -> correct (offset of the rest subtracted) -> strapdown from the rest, as orient -> pitch error = pitch - true pitch

Two errors are computed. The aligned error compares with the true pitch at the time of the readings, as in the note. The real-time
error compares with the current true pitch. The simulation knows the delay of its device: the group delay of the filter, minus the
half sample by which strapdown integrates early.

A kind of error can be switched off. It is set to zero, not removed, so that all other draws stay the same.
"""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.correction.correct import correct_checked, corrected_arrays
from undrift.correction.motion import fit_motion
from undrift.correction.rest import LEAST_IN_MOTION_S, rest_offset
from undrift.frames import integrate_strapdown
from undrift.model import Calibration
from undrift.orientation import GRAVITY_WITHIN, sagittal_pitch, shortest_rotation_up
from undrift.record import Record, Still
from undrift.sim.device.effects import BUTTERWORTH, LowPass, Sampling, SensorChain
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.tasks import Task
from undrift.study.recorded import SAMPLE_RATE_HZ, RecordedTask
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

WORN_S = 1800.0  # time since power-on: half an hour
REST_S = 6.0  # the note's rest before a motion
TRIALS_KEPT = 128  # number of true motions that a process keeps, because stages of a study share them
REST_ENDS_S = 0.2  # time before the motion: a person leans before the marked start

OffsetRule = Literal["rest", "motion", "none"]
EffectName = Literal["noise", "gyroscope offset", "accelerometer offset", "scale and axes", "delay", "assumed figures"]
EFFECTS: tuple[EffectName, ...] = get_args(EffectName)
ASSUMED: EffectName = (
    "assumed figures"  # errors of a preset whose size has no published source: omitted when a unit is drawn
)

# ---- generators and devices


def stream(seed: int, *words: str | int) -> np.random.Generator:
    """Return the random generator for a part of a study. The same seed and words give the same numbers."""
    keys = tuple(word if isinstance(word, int) else zlib.crc32(word.encode()) for word in words)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=keys))


def on_the_clock(device: DeviceModel) -> DeviceModel:
    """Return a device that samples with the motion, because sessions are marked by sample and the lag is removed anyway."""
    sampling = device.sampling
    clock = Sampling(gyro_averaging=sampling.gyro_averaging, accel_averaging=sampling.accel_averaging)
    return device if sampling.on_grid else replace(device, sampling=clock)


@lru_cache(maxsize=64)
def with_cutoff(device: DeviceModel, cutoff_hz: float | None) -> DeviceModel:
    """Return a device that samples with its motion and has a low-pass with this cut-off, within the tolerance of its parts."""
    device = on_the_clock(device)
    if cutoff_hz is None:
        return device
    chains: dict[str, Any] = {}
    for name, chain in (("gyro", device.gyro), ("accel", device.accel)):
        low_pass = LowPass(cutoff_hz=np.full(3, cutoff_hz), quality=np.full(3, BUTTERWORTH))
        if chain.low_pass is not None:
            share = chain.low_pass.cutoff_hz / np.median(chain.low_pass.cutoff_hz)
            low_pass = LowPass(cutoff_hz=cutoff_hz * share, quality=chain.low_pass.quality)
        chains[name] = replace(chain, low_pass=low_pass)
    return replace(device, **chains)


_OFFSET = {
    "offset": ("constant", "per_k"), "g_sensitivity": ("matrix",), "warm_up": ("amplitude",), "hysteresis": ("amplitude",),
    "instability": ("instability",), "random_walk": ("bias_walk",),
}  # fmt: skip
_SCALE: dict[str, tuple[str, ...]] = {
    "scale": ("error",), "thermal_scale": ("per_k",), "nonlinearity": ("quadratic",),
    "rate_drift": ("coefficients",),
}  # fmt: skip


def device_without(device: DeviceModel, effect: EffectName) -> DeviceModel:
    """Return a device without a kind of error. The delay is removed in the comparison, assumed errors when a unit is drawn."""
    chains = {}
    for name, chain in (("gyro", device.gyro), ("accel", device.accel)):
        fields: dict[str, tuple[str, ...]] = {}
        if effect == ("gyroscope offset" if name == "gyro" else "accelerometer offset"):
            fields = _OFFSET
        elif effect == "noise":
            fields = {"white_noise": ("random_walk",)}
        elif effect == "scale and axes":
            fields = _SCALE
        chains[name] = _zeroed(chain, fields, square=effect == "scale and axes", fine=effect == "noise")
    thermometer = replace(device.thermometer, noise_c=0.0) if effect == "noise" else device.thermometer
    return replace(device, gyro=chains["gyro"], accel=chains["accel"], thermometer=thermometer)


def _zeroed(chain: SensorChain, fields: dict[str, tuple[str, ...]], *, square: bool, fine: bool) -> SensorChain:
    changed: dict[str, Any] = {}
    for name, columns in fields.items():
        effect = getattr(chain, name)
        if effect is not None:
            changed[name] = replace(effect, **{column: np.zeros_like(getattr(effect, column)) for column in columns})
    chain = replace(chain, **changed)
    if square:
        chain = replace(chain, scale=replace(chain.scale, axes=np.eye(3)))
    if fine and chain.adc is not None:  # without noise, the steps of the converter would not be dithered
        chain = replace(chain, adc=replace(chain.adc, bits=chain.adc.bits + 16))
    return chain


def pitch_delay_s(device: DeviceModel) -> float:
    """Return the delay of the pitch relative to the true pitch, s."""
    late_s = 0.0 if device.gyro.low_pass is None else float(device.gyro.low_pass.group_delay_s[1])
    held_s = 0.5 / SAMPLE_RATE_HZ if device.sampling.gyro_averaging == "instant" else 0.0
    return late_s + float(device.sampling.gyro_delay_s[1]) - held_s


# ---- trial and errors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Worn:
    """A simulated trial of a device."""

    performed: Task | RecordedTask
    device: DeviceModel
    record: Record  # readings of the device
    gyro: FloatArray  # (N, 3), signal before the low-pass, rad/s
    accel: FloatArray  # (N, 3), signal before the low-pass, m/s2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """A trial ready to be corrected and judged."""

    record: Record
    pitch_now: FloatArray  # (N,), true sagittal pitch, rad
    pitch: FloatArray  # (N,), true sagittal pitch at the time to which the readings belong, rad
    still: Still  # samples in the rest
    moving: slice  # samples of the motion


@lru_cache(maxsize=TRIALS_KEPT)
def true_motion(performed: Task | RecordedTask) -> Motion:
    """Return the motion of a task at the sample rate of a study."""
    time = np.arange(round(performed.duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    return performed.at(time, STANDARD_GRAVITY)


@lru_cache(maxsize=TRIALS_KEPT)
def _true_pitch(performed: Task | RecordedTask) -> "tuple[FloatArray, CubicSpline | None]":
    """Return the true pitch (N,), rad, and its spline over the sample number."""
    from scipy.interpolate import CubicSpline

    pitch = sagittal_pitch(true_motion(performed).q_nb)
    (valid,) = np.nonzero(np.isfinite(pitch))
    return pitch, CubicSpline(valid, np.unwrap(pitch[valid])) if len(valid) > 1 else None


def simulate_worn(
    device: DeviceModel, performed: Task | RecordedTask, *, temp_c: float, rng: np.random.Generator
) -> Worn:
    """Simulate a trial of a device that is worn at a board temperature, degC."""
    simulated = simulate_device(device, true_motion(performed), rng=rng, temp_c=temp_c, power_on_s=WORN_S)
    gyro, accel = (triad.before("low_pass") for triad in (simulated.gyro, simulated.accel))
    return Worn(performed=performed, device=device, record=simulated.record, gyro=gyro, accel=accel)


def make_case(worn: Worn, device: DeviceModel | None = None, *, aligned: bool = True) -> Case:
    """Return the case of a trial, or of the same trial with the low-pass filters of another device."""
    device, performed = device or worn.device, worn.performed
    start, stop = (round(moment * SAMPLE_RATE_HZ) for moment in performed.moving_s)
    pitch, _ = _true_pitch(performed)
    delayed = _delayed_pitch(performed, pitch_delay_s(device) * SAMPLE_RATE_HZ)
    return Case(
        record=worn.record if device is worn.device else _filtered(device, worn),
        pitch_now=pitch if aligned else delayed,
        pitch=delayed,
        still=Still(start=0, stop=max(start - round(REST_ENDS_S * SAMPLE_RATE_HZ), 2)),
        moving=slice(start, min(stop + 1, len(pitch))),
    )


def _filtered(device: DeviceModel, worn: Worn) -> Record:
    """Return the readings of a trial with the low-passes of a device."""
    readings = dict[str, Any]()
    for name in ("gyro", "accel"):
        chain, signal = getattr(device, name), getattr(worn, name)
        if chain.low_pass is not None:
            signal, _ = chain.low_pass.filtered(signal, 1.0 / SAMPLE_RATE_HZ)
        readings[name] = np.where(np.isnan(getattr(worn.record, name)), np.nan, chain.converted(signal)[0])
    return replace(worn.record, **readings)


def _delayed_pitch(performed: Task | RecordedTask, samples: float) -> FloatArray:
    """Return the true pitch (N,), rad, delayed by a number of samples, NaN next to gaps."""
    pitch, spline = _true_pitch(performed)
    if spline is None or samples == 0.0:
        return pitch
    valid, at = np.isfinite(pitch), np.clip(np.arange(len(pitch)) - samples, 0, len(pitch) - 1)
    shifted = np.asarray(spline(at))
    if not valid.all():
        shifted[~(valid[np.floor(at).astype(int)] & valid[np.ceil(at).astype(int)])] = np.nan
    return shifted


def pitch_errors_deg(case: Case, calibrations: Sequence[Calibration | None], offset: OffsetRule) -> FloatArray:
    """Return the errors of the pitch over the motion with each calibration, (K, 3), deg.

    The columns are rms aligned, rms in real time, and largest aligned. A row is NaN without a calibration, and if the calibrated
    accelerometers do not measure gravity at rest.
    """
    out, rows, turns = np.full((len(calibrations), 3), np.nan), list[int](), list[FloatArray]()
    rest, start = slice(case.still.start, case.still.stop), case.still.stop - 1
    for row, calibration in enumerate(calibrations):
        if calibration is None:
            continue
        rates, forces = corrected_arrays(case.record, calibration)
        upward = forces[rest].mean(axis=0)
        if not abs(float(np.linalg.norm(upward)) / STANDARD_GRAVITY - 1.0) <= GRAVITY_WITHIN:
            continue
        if offset == "rest" or (offset == "motion" and case.record.duration_s < LEAST_IN_MOTION_S):
            rates = rates - rates[rest].mean(axis=0)
        elif offset == "motion":
            record = correct_checked(case.record, calibration, policy="hold", threads=1, check=False).record
            remainder = fit_motion(record, rest_offset(record, case.still), calibration.gyro).offset
            rates = rates - remainder.at(record.time)
        # the tilt of the rest applies at its end, where strapdown begins
        turns.append(integrate_strapdown(rates[start:], case.record.time[start:], shortest_rotation_up(upward)))
        rows.append(row)
    if rows:
        moving = slice(case.moving.start, case.moving.stop)
        pitch = sagittal_pitch(np.array(turns)[:, moving.start - start : moving.stop - start])
        errors = ((pitch - true[moving] + np.pi) % (2.0 * np.pi) - np.pi for true in (case.pitch, case.pitch_now))
        aligned, now = (error / RADIAN_PER_DEGREE for error in errors)
        squares = (np.nanmean(aligned**2, axis=1), np.nanmean(now**2, axis=1))
        out[rows] = np.column_stack((*np.sqrt(squares), np.nanmax(np.abs(aligned), axis=1)))
    return out
