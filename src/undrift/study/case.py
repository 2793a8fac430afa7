"""A device in a trial: its readings, and the remaining error of the pitch after correction.

    readings -> correct (offset of the rest subtracted) -> strapdown from the rest, as orient -> pitch
    error = pitch - true pitch

Two errors are computed. The aligned error compares with the true pitch at the time of the readings, as in the note. The real-time
error compares with the current true pitch. The simulation knows the delay of its device: the group delay of the filter, minus the
half sample by which strapdown integrates early.

A kind of error can be switched off. It is set to zero and not removed, so that all other draws stay the same.
"""

import zlib
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.correction.correct import correct_checked
from undrift.correction.motion import fit_motion
from undrift.correction.rest import LEAST_IN_MOTION_S, rest_offset
from undrift.errors import Implausible
from undrift.frames import integrate_strapdown
from undrift.model import Calibration
from undrift.orientation import GRAVITY_WITHIN, sagittal_pitch, shortest_rotation_up
from undrift.record import Record, Still
from undrift.sim.device.effects import BUTTERWORTH, LowPass, Sampling, SensorChain
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import Simulated, simulate_device
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.tasks import Task
from undrift.study.recorded import SAMPLE_RATE_HZ, RecordedTask
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

WORN_S = 1800.0  # the device has been on for half an hour
REST_S = 6.0  # the note's rest before a motion
TRIALS_KEPT = 128  # true motions that a process keeps: stages of a study share them
REST_ENDS_S = 0.2  # before the motion: a person leans before the marked start

OffsetRule = Literal["rest", "motion", "none"]
EffectName = Literal["noise", "gyroscope offset", "accelerometer offset", "scale and axes", "delay", "assumed figures"]
EFFECTS: tuple[EffectName, ...] = get_args(EffectName)
ASSUMED: EffectName = (
    "assumed figures"  # errors of a preset whose size no source states: left out where a unit is drawn
)

# ---- generators and devices


def stream(seed: int, *words: str | int) -> np.random.Generator:
    """Return the random generator for a part of a study. The same seed and words give the same numbers."""
    keys = tuple(word if isinstance(word, int) else zlib.crc32(word.encode()) for word in words)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=keys))


def on_the_clock(device: DeviceModel) -> DeviceModel:
    """Return a device that samples with the motion: sessions are marked by sample, and the lag is removed in any case."""
    sampling = device.sampling
    clock = Sampling(gyro_averaging=sampling.gyro_averaging, accel_averaging=sampling.accel_averaging)
    return device if sampling.on_grid else replace(device, sampling=clock)


def with_cutoff(device: DeviceModel, cutoff_hz: float | None) -> DeviceModel:
    """Return a device that samples with its motion and has a low-pass of this cut-off, within the tolerance of its own parts."""
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
    """Return a device without a kind of error. The delay is removed in the comparison, assumed figures where a unit is drawn."""
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
    if fine and chain.adc is not None:  # without noise the steps of the converter would not be dithered
        chain = replace(chain, adc=replace(chain.adc, bits=chain.adc.bits + 16))
    return chain


def pitch_delay_s(device: DeviceModel) -> float:
    """Return the delay of the pitch against the true pitch, s."""
    late_s = 0.0 if device.gyro.low_pass is None else float(device.gyro.low_pass.group_delay_s[1])
    held_s = 0.5 / SAMPLE_RATE_HZ if device.sampling.gyro_averaging == "instant" else 0.0
    return late_s + float(device.sampling.gyro_delay_s[1]) - held_s


# ---- trial and errors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """A trial ready to be corrected and judged."""

    record: Record
    pitch_now: FloatArray  # (N,), true sagittal pitch, rad
    pitch: FloatArray  # (N,), true sagittal pitch at the instant that the readings belong to, rad
    still: Still  # samples of the rest
    moving: slice  # samples of the motion


@lru_cache(maxsize=TRIALS_KEPT)
def true_motion(performed: Task | RecordedTask) -> Motion:
    """Return the motion of a task at the sample rate of a study."""
    time = np.arange(round(performed.duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    return performed.at(time, STANDARD_GRAVITY)


@lru_cache(maxsize=TRIALS_KEPT)
def _true_pitch(performed: Task | RecordedTask) -> FloatArray:
    return sagittal_pitch(true_motion(performed).q_nb)


def simulate_worn(
    device: DeviceModel, performed: Task | RecordedTask, *, temp_c: float, rng: np.random.Generator
) -> Simulated:
    """Simulate a trial of a device that is worn at a board temperature, degC."""
    return simulate_device(device, true_motion(performed), rng=rng, temp_c=temp_c, power_on_s=WORN_S)


def make_case(device: DeviceModel, performed: Task | RecordedTask, worn: Simulated, *, aligned: bool = True) -> Case:
    """Return the case of a device. Only its low-pass filters may differ from those of the simulated device."""
    start, stop = (round(moment * SAMPLE_RATE_HZ) for moment in performed.moving_s)
    pitch = _true_pitch(performed)
    delayed = _delayed(pitch, pitch_delay_s(device) * SAMPLE_RATE_HZ)
    return Case(
        record=_filtered(device, worn),
        pitch_now=pitch if aligned else delayed,
        pitch=delayed,
        still=Still(start=0, stop=max(start - round(REST_ENDS_S * SAMPLE_RATE_HZ), 2)),
        moving=slice(start, min(stop + 1, len(pitch))),
    )


def _filtered(device: DeviceModel, worn: Simulated) -> Record:
    """Return the readings of a simulated trial with the low-passes of a device."""
    readings = dict[str, Any]()
    for name in ("gyro", "accel"):
        chain, triad = getattr(device, name), getattr(worn, name)
        signal = triad.true + sum(x for effect, x in triad.contributions.items() if effect not in ("low_pass", "adc"))
        if chain.low_pass is not None:
            signal, _ = chain.low_pass.filtered(signal, 1.0 / SAMPLE_RATE_HZ)
        readings[name] = np.where(np.isnan(getattr(worn.record, name)), np.nan, chain.converted(signal)[0])
    return replace(worn.record, **readings)


def _delayed(pitch: FloatArray, samples: float) -> FloatArray:
    """Return a pitch (N,), rad, delayed by a number of samples, NaN next to gaps."""
    from scipy.interpolate import CubicSpline

    valid, place = np.isfinite(pitch), np.arange(len(pitch))
    if valid.sum() < 2 or samples == 0.0:
        return pitch
    at = np.clip(place - samples, 0, len(pitch) - 1)
    shifted = np.asarray(CubicSpline(place[valid], np.unwrap(pitch[valid]))(at))
    shifted[~(valid[np.floor(at).astype(int)] & valid[np.ceil(at).astype(int)])] = np.nan
    return shifted


def pitch_errors_deg(case: Case, calibration: Calibration, offset: OffsetRule) -> tuple[float, float, float]:
    """Return the errors of the pitch over the motion, deg: rms aligned, rms in real time, largest aligned.

    Raises Implausible if the calibrated accelerometers do not measure gravity at rest.
    """
    record = correct_checked(case.record, calibration, policy="hold", threads=1, check=False).record
    rates, forces, rest = np.asarray(record.gyro), np.asarray(record.accel), slice(case.still.start, case.still.stop)
    upward = forces[rest].mean(axis=0)
    length = float(np.linalg.norm(upward))
    if not abs(length / STANDARD_GRAVITY - 1.0) <= GRAVITY_WITHIN:
        raise Implausible(f"trial: the corrected specific force at rest is {length:.3g} m/s2. Calibrate again.")
    if offset == "rest" or (offset == "motion" and record.duration_s < LEAST_IN_MOTION_S):
        rates = rates - rates[rest].mean(axis=0)
    elif offset == "motion":
        remainder = fit_motion(record, rest_offset(record, case.still), calibration.gyro).offset
        rates = rates - remainder.at(record.time)
    start = case.still.stop - 1  # the tilt of the rest holds at its end, and strapdown begins there
    pitch = sagittal_pitch(integrate_strapdown(rates[start:], record.time[start:], shortest_rotation_up(upward)))
    moving = slice(case.moving.start - start, case.moving.stop - start)
    errors = ((pitch - true[start:] + np.pi) % (2.0 * np.pi) - np.pi for true in (case.pitch, case.pitch_now))
    aligned, now = (error[moving] / RADIAN_PER_DEGREE for error in errors)
    return float(np.sqrt(np.nanmean(aligned**2))), float(np.sqrt(np.nanmean(now**2))), float(np.nanmax(np.abs(aligned)))
