"""Held out: the twin, simulated on a motion to which it was not fitted, compared with the real device.

The twin comes from the other recordings of the device. Its readings of the held-out motion and the real readings are corrected
alike, by the twin's matrix and each less its own offset, and integrated from the same orientation over every window. What
counts is the largest difference of sagittal pitch in a window, where the vertical is within 60 deg of the sagittal plane:
beyond, pitch stretches a difference of tilt more than twofold. Two more figures need no plane: the largest angle between the
two verticals, and the difference at the window's end about each axis of the body.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, runs
from undrift.calibration.codes import restored_gyro
from undrift.errors import InputError
from undrift.frames import (
    integrate_strapdown,
    quaternion_conjugate,
    quaternion_product,
    rotate,
    rotation_vector,
)
from undrift.orientation import sagittal_pitch
from undrift.sim.device.effects import Adc, LeverArm, Offset, Sampling, Scale, SensorChain, WhiteNoise
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion
from undrift.twin.accel import Match, pose_spline
from undrift.twin.fit import Prepared, RestNoise, Twin, fit_prepared
from undrift.validation.trial import wrapped

# ---- the twin as a device to simulate

_BITS = 16


def device_of(twin: Twin, *, sample_rate_hz: float, serial: str = "") -> DeviceModel:
    """Return the fitted device for simulation."""
    model, half = twin.gyro.triad.model, 0.5 / sample_rate_hz
    gyro = chain_of(model.matrix, model.offset, twin.gyro_noise, "rad/s")
    if twin.adc is not None and twin.adc.gyro_lsb is not None:
        reference = float(np.mean(twin.adc.gyro_lsb)) * 2.0 ** (_BITS - 1)
        gyro = replace(gyro, adc=Adc(bits=_BITS, reference=reference, rounding=twin.adc.gyro_rounding, codes=False))
    accel, late = SensorChain(unit="m/s2", scale=Scale(nominal_sensitivity=1.0)), twin.delay
    if twin.accel is not None:
        late = twin.delay + twin.accel.delay
        accel = chain_of(twin.accel.model.matrix, twin.accel.model.offset, twin.accel_noise, "m/s2")
        accel = replace(accel, lever_arm=LeverArm(arms=np.tile(twin.accel.lever_arm, (3, 1))))
    return DeviceModel(
        serial=serial,
        gyro=gyro,
        accel=accel,
        sampling=Sampling(
            sample_rate_hz=sample_rate_hz, gyro_delay_s=np.full(3, half - twin.delay), accel_delay_s=np.full(3, -late)
        ),
        name="twin",
        source_tag="fitted",
    )


def chain_of(matrix: FloatArray, offset: FloatArray, noise: RestNoise | None, unit: str) -> SensorChain:
    """Return the chain whose readings a correction matrix (3, 3) and offset (3,) correct."""
    forward = np.linalg.inv(matrix)
    gain = np.linalg.norm(forward, axis=1)
    return SensorChain(
        unit=unit,
        scale=Scale(nominal_sensitivity=1.0, error=gain - 1.0, axes=forward / gain[:, None]),
        offset=Offset(constant=offset),
        white_noise=None if noise is None else WhiteNoise(random_walk=noise.random_walk),
    )


# ---- windows

LENGTHS_S = (5.0, 50.0)
SHARED_CLOCK_S = 1e-3  # delays of a device's recordings agree to this where device and optics share a clock
IN_PLANE = 0.5  # shortest part of the vertical in the sagittal plane
STRIDE_S = 0.5  # from one window to the next
POINTS_PER_S = 36.0  # at which a window is compared
_MOTION_CUTOFF_HZ = 20.0
_FRESH = 30  # samples: shorter stretches hold nothing

# ---- errors over windows


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WindowErrors:
    """Differences over all windows of one length."""

    pitch: FloatArray  # (W,), largest difference in each, rad; NaN where the vertical never came near the plane
    tilt: FloatArray  # (W,), largest angle between the verticals, rad
    end: FloatArray  # (W, 3), size of the difference at the end about each axis of the body, rad


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOutTrial:
    """One held-out recording."""

    recording: str
    window_s: float  # Length of the windows
    errors: WindowErrors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOutMotion:
    """A held-out motion and the twin of the other recordings."""

    match: Match  # The held-out recording
    twin: Twin  # Of the others
    device: DeviceModel  # The twin without delay: the motion is evaluated at the delayed instants
    motion: Motion  # Of the poses, at those instants
    # (3,), of the real readings in motion: their own rest plus the twin's change from rest to motion, or the twin's, rad/s
    offset: FloatArray

    def corrected(self, readings: FloatArray, offset: FloatArray) -> FloatArray:
        """Return readings (N, 3) corrected by the twin's matrix and an offset (3,), rad/s."""
        return np.asarray((readings - offset) @ self.twin.gyro.triad.model.matrix.T)

    def simulated(self, device: DeviceModel, rng: np.random.Generator) -> FloatArray:
        """Return a device's readings of the motion, (N, 3) rad/s, corrected as the real readings are."""
        adc = self.twin.adc if device.gyro.adc is not None else None
        return self.corrected(restored_gyro(_read(device, self.motion, rng), adc), self.twin.gyro.triad.model.offset)

    def found(self, rng: np.random.Generator, length_s: float) -> WindowErrors:
        """Compare the real readings with simulated ones over every window of the motion."""
        real = self.corrected(self.match.gyro, self.offset)
        return window_errors(self, real, self.simulated(self.device, rng), length_s)


def _read(device: DeviceModel, motion: Motion, rng: np.random.Generator) -> FloatArray:
    return np.asarray(simulate_device(device, motion, rng=rng).record.gyro, dtype=np.float64)


def hold_out(prepared: Prepared, number: int, *, twin: Twin | None = None) -> HeldOutMotion:
    """Fit the twin to all recordings but one, and return it with the motion of that one."""
    others = [k for k in range(len(prepared.records)) if k != number]
    if twin is None:
        if not others:
            raise InputError("twin: wanted two recordings to hold one out, got one; record the device a second time")
        twin = fit_prepared(prepared, chosen=others, brief=True)
    match = prepared.matches[number]
    rate = match.record.sample_rate_hz
    lag = twin.delay if abs(match.lag.seconds - twin.delay) < SHARED_CLOCK_S else match.lag.seconds
    spline = pose_spline(replace(match.reference, position=None), _MOTION_CUTOFF_HZ)
    motion = spline.at(match.record.time - (lag - 0.5 / rate), twin.settings.gravity_m_s2)
    device = replace(device_of(twin, sample_rate_hz=rate), sampling=Sampling())
    offset = twin.gyro.model_at_rest_offset(match.rest_offset).offset
    return HeldOutMotion(match=match, twin=twin, device=device, motion=motion, offset=offset)


def compare_held_out(
    prepared: Prepared,
    *,
    rng: np.random.Generator,
    lengths_s: Sequence[float] = LENGTHS_S,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> tuple[HeldOutTrial, ...]:
    """Hold every recording out in turn and compare the twin of the others with it; progress takes what is done, and 0 to 1."""
    found = []
    for number in range(len(prepared.records)):
        progress(f"held out: recording {number + 1} of {len(prepared.records)}", number / len(prepared.records))
        held = hold_out(prepared, number)
        real, simulated = held.corrected(held.match.gyro, held.offset), held.simulated(held.device, rng)
        for length in lengths_s:
            errors = window_errors(held, real, simulated, length)
            if len(errors.pitch):
                found.append(HeldOutTrial(recording=held.match.name, window_s=length, errors=errors))
    return tuple(found)


def window_errors(
    held: HeldOutMotion, one: FloatArray, other: FloatArray, length_s: float, within: BoolArray | None = None
) -> WindowErrors:
    """Compare two rates (N, 3), rad/s, over every window of the motion, or of another part of the recording."""
    known = (held.match.moving if within is None else within) & (np.asarray(held.motion.valid) > 0.0)
    if within is None:
        known &= np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1)
    rows = [run_errors(held.motion, one, other, slice(int(a), int(b)), length_s) for a, b in runs(known)]
    table = np.concatenate([np.empty((0, 5)), *rows])
    return WindowErrors(pitch=table[:, 0], tilt=table[:, 1], end=table[:, 2:])


def run_errors(motion: Motion, one: FloatArray, other: FloatArray, rows: slice, length_s: float) -> FloatArray:
    """Compare two rates (N, 3), rad/s, over every window of one stretch: pitch, tilt, end about x, y, z, (W, 5) rad."""
    time, q = motion.time[rows], motion.q_nb[rows]
    rate = motion.sample_rate_hz
    samples, stride = round(length_s * rate), max(1, round(STRIDE_S * rate))
    if len(time) <= max(samples, _FRESH):
        return np.empty((0, 5))
    tracks = [integrate_strapdown(w[rows], time, q[0]) for w in (one, other)]
    within: IntArray = np.arange(0, samples + 1, max(1, round(rate / POINTS_PER_S)))
    within[-1] = samples
    return np.array([_window(tracks, q, first, within) for first in range(0, len(time) - samples, stride)])


def _window(tracks: Sequence[FloatArray], q: FloatArray, first: int, within: IntArray) -> FloatArray:
    a, b = (
        quaternion_product(quaternion_product(q[first], quaternion_conjugate(t[first])), t[first + within])
        for t in tracks
    )
    vertical = rotate(quaternion_conjugate(b), np.array([0.0, 0.0, 1.0]))
    near = np.hypot(vertical[:, 0], vertical[:, 2]) > IN_PLANE
    pitch = np.abs(wrapped(sagittal_pitch(a) - sagittal_pitch(b)))[near]
    turn = rotation_vector(quaternion_product(quaternion_conjugate(b), a))
    tilt = np.linalg.norm(np.cross(turn, vertical), axis=1)  # small: the part of the turn across the vertical
    largest = np.nanmax(pitch) if np.isfinite(pitch).any() else np.nan
    return np.concatenate(([largest, tilt.max()], np.abs(turn[-1])))
