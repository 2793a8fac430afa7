"""Comparison of the twin with the real device on a motion that was not used in the fit.

The twin is fitted to the other recordings of the device. Its readings of the held-out motion and the real readings are corrected
with the twin's matrix, each with its own offset, and integrated from the same orientation over every window. The result is the
largest difference of sagittal pitch in a window while the vertical is within 60 deg of the sagittal plane. (Beyond 60 deg, pitch
more than doubles a difference of tilt.)
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray, IntArray, runs
from undrift.calibration.codes import restored_gyro
from undrift.errors import InputError
from undrift.frames import integrate_strapdown, quaternion_conjugate, quaternion_product, rotate
from undrift.orientation import sagittal_pitch
from undrift.sim.device.effects import Adc, LeverArm, Offset, Sampling, Scale, SensorChain, WhiteNoise
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion
from undrift.twin.accel import pose_spline
from undrift.twin.fit import RestNoise, Twin, fit_prepared
from undrift.validation.trial import wrapped

# ---- the twin as a device to simulate

BITS = 16


def device_of(twin: Twin, *, sample_rate_hz: float, serial: str = "") -> DeviceModel:
    """Return the fitted device for simulation."""
    model, half_s = twin.gyro.triad.model, 0.5 / sample_rate_hz
    gyro = _chain(model.matrix, model.offset, twin.gyro_noise, "rad/s")
    if twin.adc is not None and twin.adc.gyro_lsb is not None:
        reference = float(np.mean(twin.adc.gyro_lsb)) * 2.0 ** (BITS - 1)
        gyro = replace(gyro, adc=Adc(bits=BITS, reference=reference, rounding=twin.adc.gyro_rounding, codes=False))
    accel, delay_s = SensorChain(unit="m/s2", scale=Scale(nominal_sensitivity=1.0)), twin.delay
    if twin.accel is not None:
        delay_s = twin.delay + twin.accel.delay
        accel = _chain(twin.accel.model.matrix, twin.accel.model.offset, twin.accel_noise, "m/s2")
        accel = replace(accel, lever_arm=LeverArm(arms=np.tile(twin.accel.lever_arm, (3, 1))))
    sampling = Sampling(
        sample_rate_hz=sample_rate_hz,
        gyro_delay_s=np.full(3, half_s - twin.delay),
        accel_delay_s=np.full(3, -delay_s),
    )
    return DeviceModel(serial=serial, gyro=gyro, accel=accel, sampling=sampling, name="twin", source_tag="fitted")


def _chain(matrix: FloatArray, offset: FloatArray, noise: RestNoise | None, unit: str) -> SensorChain:
    """Return the chain whose readings a correction matrix (3, 3) and offset (3,) correct."""
    forward = np.linalg.inv(matrix)
    gain = np.linalg.norm(forward, axis=1)
    return SensorChain(
        unit=unit,
        scale=Scale(nominal_sensitivity=1.0, error=gain - 1.0, axes=forward / gain[:, None]),
        offset=Offset(constant=offset),
        white_noise=None if noise is None else WhiteNoise(random_walk=noise.random_walk),
    )


# ---- errors over windows

WINDOWS_S = (5.0, 50.0)
STRIDE_S = 0.5  # time from one window to the next
POINTS_PER_S = 36.0  # rate at which a window is compared
IN_PLANE = 0.5  # smallest component of the vertical in the sagittal plane
SHARED_CLOCK_S = 1e-3  # largest difference of delays between a device's recordings if device and optics share a clock
MOTION_CUTOFF_HZ = 20.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOutTrial:
    """Differences between real and simulated device in W windows of a held-out recording."""

    recording: str
    window_s: float  # length of the windows
    pitch: FloatArray  # (W,), largest difference in each window, rad, or NaN if the vertical is never near the plane


def compare_held_out(
    twin: Twin,
    *,
    rng: np.random.Generator,
    lengths_s: Sequence[float] = WINDOWS_S,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> tuple[HeldOutTrial, ...]:
    """Compare each recording of a twin with the twin fitted to all its other recordings."""
    prepared = twin.prepared
    count = len(prepared.matches)
    if count < 2:
        raise InputError("twin: at least two recordings are needed to hold one out. Record the device a second time.")
    trials = list[HeldOutTrial]()
    for number, match in enumerate(prepared.matches):
        progress(f"held out: recording {number + 1} of {count}", number / count)
        by_others = fit_prepared(prepared, chosen=[k for k in range(count) if k != number])
        motion, real, simulated = _rates(by_others, number, rng)
        valid = match.moving & (np.asarray(motion.valid) > 0.0)
        valid &= np.isfinite(real).all(axis=1) & np.isfinite(simulated).all(axis=1)
        for length_s in lengths_s:
            windows = [_windows(motion, real, simulated, slice(*stretch), length_s) for stretch in runs(valid)]
            if pitch := [largest for stretch in windows for largest in stretch]:
                trials.append(HeldOutTrial(recording=match.name, window_s=length_s, pitch=np.array(pitch)))
    return tuple(trials)


def _rates(twin: Twin, number: int, rng: np.random.Generator) -> tuple[Motion, FloatArray, FloatArray]:
    """Return the motion of a held-out recording, and corrected rates of the real and the simulated device, (N, 3) rad/s."""
    match, model = twin.prepared.matches[number], twin.gyro.triad.model
    rate_hz = match.record.sample_rate_hz
    lag_s = twin.delay if abs(match.lag.seconds - twin.delay) < SHARED_CLOCK_S else match.lag.seconds
    spline = pose_spline(replace(match.reference, position=None), MOTION_CUTOFF_HZ)
    motion = spline.at(match.record.time - (lag_s - 0.5 / rate_hz), twin.prepared.gravity_m_s2)
    # without delay: the motion is evaluated at the delayed times
    device = replace(device_of(twin, sample_rate_hz=rate_hz), sampling=Sampling())
    readings = restored_gyro(np.asarray(simulate_device(device, motion, rng=rng).record.gyro), twin.adc)
    offset = twin.gyro.model_at_rest_offset(match.rest_offset).offset
    return motion, (match.gyro - offset) @ model.matrix.T, (readings - model.offset) @ model.matrix.T


def _windows(motion: Motion, real: FloatArray, simulated: FloatArray, rows: slice, length_s: float) -> Iterator[float]:
    """Yield the largest difference between the pitch from two rates (N, 3), rad/s, in every window of a stretch, rad."""
    time, q_nb, rate_hz = motion.time[rows], motion.q_nb[rows], motion.sample_rate_hz
    samples, stride = round(length_s * rate_hz), max(1, round(STRIDE_S * rate_hz))
    if len(time) <= samples:
        return
    tracks = [integrate_strapdown(rate[rows], time, q_nb[0]) for rate in (real, simulated)]
    points: IntArray = np.arange(0, samples + 1, max(1, round(rate_hz / POINTS_PER_S)))
    points[-1] = samples
    for first in range(0, len(time) - samples, stride):
        real_q, simulated_q = (
            quaternion_product(quaternion_product(q_nb[first], quaternion_conjugate(q[first])), q[first + points])
            for q in tracks
        )
        vertical = rotate(quaternion_conjugate(simulated_q), np.array([0.0, 0.0, 1.0]))
        near_plane = np.hypot(vertical[:, 0], vertical[:, 2]) > IN_PLANE
        pitch = np.abs(wrapped(sagittal_pitch(real_q) - sagittal_pitch(simulated_q)))[near_plane]
        yield float(np.nanmax(pitch)) if np.isfinite(pitch).any() else np.nan
