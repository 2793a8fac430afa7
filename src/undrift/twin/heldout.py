"""Held out: the twin, simulated on a motion to which it was not fitted, compared with the real device.

The twin comes from the other recordings of the device. Its readings of the held-out motion and the real readings are corrected
alike, by the twin's matrix and each less its own offset, and integrated from the same orientation over every window. What
counts is the largest difference of sagittal pitch in a window, where the vertical is within 60 deg of the sagittal plane:
beyond, pitch stretches a difference of tilt more than twofold. Two more figures need no plane: the largest angle between the
two verticals, and the difference at the window's end about each axis of the body.

End errors: those of many devices that the twin allows, and the real one's. Each draw has a matrix and an in-motion offset from
the covariance of the fit, an offset at rest that differs from the mean of the other recordings as much as recordings of a
device differ, and noise and codes of its own. The held-out motion is the rate between its poses, the corrected real rate
where the poses are missing, and nothing at rest. The readings go through the protocol of ``validation.trial``: (a) as they
come, (b) less their mean over the first rest. The poses are smoothed further than for windows: pose noise of 1 deg/s would
carry codes of a device that pauses to both sides of zero, and a code that changes sign loses nothing on average to
truncation, while one that does not loses half a step.

Contributions: every part of the twin is simulated alone against a twin without it, over the same windows of the same held-out
motion. What the poses add at rest is measured: the real gyroscope against the poses over windows before the motion. Parts add
as squares; the rest of the difference is unexplained: poses that err more in motion than at rest, markers and board that
give, and effects of the device that the model lacks, which these recordings cannot separate.

Excitation: whether a held-out motion lies within what the twin's training shows of its parameters. Over a window of a motion, an
error of matrix and offset turns the twin by ::

    e = D p        D = integral R_nb [ (u - o)^T x I, -I ] dt,  p = (dM row by row, M do)

in n, readings u, o those at rest. The training determines p by N = sum D^T D over its windows; e of a window beyond what training
has seen is not determined, however small the residuals of training are. The leverage of a window, h = trace(D N^-1 D^T), is
compared with the largest of the training itself, the rule for hidden extrapolation in regression (R. D. Cook, "Detection of
influential observation", 1977). Most of the held-out windows above it is a finding. What the fit's own covariance C makes of the
held-out windows, trace(D C D^T), is stated in degrees, and its share by axis: (D^T D C)_pp summed over the column of M that belongs
to turns about that axis.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, runs
from undrift.calibration.adc import restored_gyro
from undrift.calibration.reference import TURN_ON
from undrift.calibration.reference_accel import pose_columns
from undrift.errors import InputError
from undrift.findings import Finding, finding
from undrift.frames import (
    integrate_strapdown,
    quaternion_conjugate,
    quaternion_of,
    quaternion_product,
    rotate,
    rotation,
    rotation_vector,
)
from undrift.model import AXES, TriadModel
from undrift.orientation import sagittal_pitch
from undrift.sim.device.effects import Adc, LeverArm, Offset, Sampling, Scale, SensorChain, WhiteNoise
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion
from undrift.twin.accel import Match, pose_spline, stretches
from undrift.twin.fit import Prepared, RestNoise, Twin, fit_prepared, spread_of
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.trial import TrialSettings, compare_orientations, validate_trial, wrapped

# ---- the twin as a device to simulate, and draws of it within its uncertainty

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


def drawn_gyro(device: DeviceModel, twin: Twin, rng: np.random.Generator) -> DeviceModel:
    """Return a device with gyroscope matrix and in-motion offset drawn from the twin's uncertainty."""
    model = twin.gyro.triad.model
    spread = model.covariance[:12, :12].copy()
    spread[range(9, 12), range(9, 12)] += twin.settings.motion_offset_spread**2
    step = rng.multivariate_normal(np.zeros(12), spread, method="eigh")
    chain = chain_of(model.matrix + step[:9].reshape(3, 3), model.offset + step[9:], None, "rad/s")
    return replace(device, gyro=replace(device.gyro, scale=chain.scale, offset=chain.offset))


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

# ---- excitation

WINDOW_S = LENGTHS_S[0]
FAR_BEYOND, _TURN_STEPS = 10.0, 360  # [assumed] leverage: a turn about three times as large as any of the training
MOST_BEYOND = 0.5  # share of held-out windows beyond the training's largest leverage


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Excitation:
    """A held-out motion against the training."""

    beyond: float  # Share of windows whose leverage exceeds the largest of the training
    leverage: float  # Median leverage of held-out windows over that largest one
    predicted: float  # Rotation over a window by the covariance of matrix and offset, held out, rms, rad
    trained: float  # The same in training
    axis_share: FloatArray  # (3,), of the held-out variance, by turns about x, y, z; the rest is the offset's

    def finding(self, recording: str) -> Finding | None:
        """Return the finding of a motion beyond the training; None within it."""
        if self.beyond <= MOST_BEYOND:
            return None
        return finding(
            "twin.beyond_training",
            "warn",
            recording=recording,
            beyond_percent=100.0 * self.beyond,
            axis=AXES[int(np.argmax(self.axis_share))],
            predicted_deg=self.predicted / RADIAN_PER_DEGREE,
            trained_deg=self.trained / RADIAN_PER_DEGREE,
            window_s=WINDOW_S,
        )


def excitation(held_out: FloatArray, training: Sequence[FloatArray], model: TriadModel) -> Excitation:
    """Compare windows of a held-out motion (W, 3, 12) with those that a gyroscope model was fitted to."""
    from scipy.linalg import block_diag

    seen = np.concatenate(training)
    if not len(held_out) or not len(seen):
        return Excitation(beyond=0.0, leverage=np.nan, predicted=np.nan, trained=np.nan, axis_share=np.full(3, np.nan))
    size = np.sqrt(np.einsum("nap,nap->p", seen, seen))
    inverse = np.linalg.pinv(np.einsum("nap,naq->pq", seen / size, seen / size)) / np.outer(size, size)
    limit, leverage = float(_traces(seen, inverse).max()), _traces(held_out, inverse)
    turned = block_diag(np.eye(9), model.matrix)
    covariance = turned @ model.covariance[:12, :12] @ turned.T
    each = np.einsum("nap,naq,qp->p", held_out, held_out, covariance) / len(held_out)
    return Excitation(
        beyond=float(np.mean(leverage > limit)),
        leverage=float(np.median(leverage)) / limit,
        predicted=float(np.sqrt(each.sum())),
        trained=float(np.sqrt(_traces(seen, covariance).mean())),
        axis_share=each[:9].reshape(3, 3).sum(axis=0) / each.sum(),
    )


def not_excited(prepared: Prepared, twin: Twin) -> Finding | None:
    """Return a finding on the axes about which a twin of all recordings was never turned; None where there are none.

    One even turn about each axis in a window is compared with the windows of the training, as another motion is.
    """
    model, share = twin.gyro.triad.model, (np.arange(_TURN_STEPS) + 0.5) / _TURN_STEPS
    trained, beyond = [motion_windows(match) for match in prepared.matches], dict[str, float]()
    for axis, turn in zip(AXES, 2.0 * np.pi * np.eye(3), strict=True):
        r_nb = rotation(quaternion_of(np.outer(share, turn))).as_matrix()
        u = np.linalg.solve(model.matrix, turn / WINDOW_S)
        d = WINDOW_S * pose_columns(r_nb, np.tile(u, (_TURN_STEPS, 1))).mean(axis=0)
        found = excitation(d[None], trained, model)
        if found.leverage > FAR_BEYOND:
            beyond[axis] = found.predicted / RADIAN_PER_DEGREE
    if not beyond:
        return None
    return finding("twin.not_excited", "warn", axes=[*beyond], off_deg=max(beyond.values()), seconds=WINDOW_S)


def _traces(design: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nap,pq,naq->n", design, covariance, design))


def motion_windows(match: Match) -> FloatArray:
    """Return D of every window of a recording's motion, (W, 3, 12)."""
    motion, rate = match.at(match.lag.seconds, 0.0), match.record.sample_rate_hz
    samples, stride, found = round(WINDOW_S * rate), max(1, round(STRIDE_S * rate)), [np.empty((0, 3, 12))]
    for rows in stretches(match, motion, match.gyro):
        r_nb, u = rotation(motion.q_nb[rows]).as_matrix(), match.gyro[rows] - np.nan_to_num(match.rest_offset)
        total = np.cumsum(pose_columns(r_nb, u), axis=0) / rate
        first = np.arange(0, len(total) - samples, stride)
        found.append(total[first + samples] - total[first])
    return np.concatenate(found)


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
    excitation: Excitation  # Of the recording, against those that the twin was fitted to


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
    found, windows = [], [motion_windows(match) for match in prepared.matches]
    for number in range(len(prepared.records)):
        progress(f"held out: recording {number + 1} of {len(prepared.records)}", number / len(prepared.records))
        held = hold_out(prepared, number)
        excited = excitation(windows[number], [*windows[:number], *windows[number + 1 :]], held.twin.gyro.triad.model)
        real, simulated = held.corrected(held.match.gyro, held.offset), held.simulated(held.device, rng)
        for length in lengths_s:
            errors = window_errors(held, real, simulated, length)
            if len(errors.pitch):
                found.append(
                    HeldOutTrial(recording=held.match.name, window_s=length, errors=errors, excitation=excited)
                )
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


def plain(device: DeviceModel) -> DeviceModel:
    """Return the device without noise and rounding."""
    offset = Offset(constant=device.gyro.raw_offset)
    return replace(device, gyro=replace(device.gyro, white_noise=None, adc=None, offset=offset))


# ---- end errors of devices that the twin allows, and of the real one

Row = Literal["raw", "rest"]
ROWS: tuple[Row, ...] = ("raw", "rest")
_SLOW_CUTOFF_HZ = 5.0
_LEAD_S, _END_S, _EVERY_S = 0.5, 3.0, 0.25
_WITHIN = (2.5, 97.5)  # per cent of the draws


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ending:
    """End errors of one recording."""

    recording: str
    row: Row  # "raw": no offset subtracted. "rest": less the mean of the first rest
    real: FloatArray  # (2,), total and inclination, rad
    simulated: FloatArray  # (D, 2), the same of every draw

    @property
    def interval(self) -> FloatArray:
        """Central 95 % of the draws, shape (2, 2): low and high of total and inclination, rad."""
        return np.asarray(np.percentile(self.simulated, _WITHIN, axis=0).T)

    @property
    def covered(self) -> tuple[bool, bool]:
        """Whether the real total and inclination lie within the central 95 % of the draws."""
        inside = (self.real >= self.interval[:, 0]) & (self.real <= self.interval[:, 1])
        return bool(inside[0]), bool(inside[1])


def end_errors(
    prepared: Prepared,
    *,
    rng: np.random.Generator,
    draws: int = 60,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> tuple[Ending, ...]:
    """Compare simulated and real end errors of every recording, each against the twin of the others; "rest" where it rests."""
    found: list[Ending] = []
    for number in range(len(prepared.records)):
        progress(f"end errors: recording {number + 1} of {len(prepared.records)}", number / len(prepared.records))
        held = hold_out(prepared, number)
        simulated = _simulated(held, rng, draws)
        for k, row in enumerate(ROWS[: len(simulated)]):
            settings = TrialSettings(offset="none" if row == "raw" else "rest", adc="none")
            figures = validate_trial(prepared.records[number], prepared.references[number], settings=settings).figures
            real = np.array([figures.end_total_deg, figures.end_inclination_deg]) * RADIAN_PER_DEGREE
            found.append(Ending(recording=held.match.name, row=row, real=real, simulated=simulated[k]))
    return tuple(found)


def _simulated(held: HeldOutMotion, rng: np.random.Generator, draws: int) -> FloatArray:
    match, twin, span = held.match, held.twin, held.match.span
    last = int(np.searchsorted(match.record.time, span.stop_s + _END_S)) + 1
    time = match.record.time[:last]
    slow = pose_spline(replace(match.reference, position=None), _SLOW_CUTOFF_HZ)
    motion = slow.at(held.motion.time[:last], twin.settings.gravity_m_s2)
    inside = (time >= span.start_s) & (time < span.stop_s)
    with_pose = (np.asarray(motion.valid) > 0.0)[:, None]
    rate = np.where(with_pose, np.nan_to_num(motion.mean_rate_b), held.corrected(match.gyro[:last], held.offset))
    rate = rate * inside[:, None]
    if span.rested:
        first, after = int(np.searchsorted(time, span.start_s - _LEAD_S)), span.stop_s
        seen = motion.q_nb[:first][with_pose[:first, 0]]
        start = seen[-1] if len(seen) else np.array([1.0, 0.0, 0.0, 0.0])
    else:  # from the reference, to the last of the motion, as ``validate_trial`` has it
        first, after = int(np.flatnonzero(with_pose[:, 0] & inside)[0]), span.stop_s - _END_S
        start = motion.q_nb[first]
    truth = integrate_strapdown(rate[first:], time[first:], start)
    ends = np.searchsorted(time[first:], np.arange(after, min(after + _END_S, time[-1]), _EVERY_S))
    tilted, out = start, np.empty((len(ROWS) if span.rested else 1, draws, 2))
    if twin.accel is not None and span.rested:  # the tilt error of a start from the raw accelerometer at rest
        up = rotate(quaternion_conjugate(start), np.array([0.0, 0.0, twin.settings.gravity_m_s2]))
        reading = np.linalg.solve(twin.accel.model.matrix, up) + twin.accel.model.offset
        turn = np.cross(reading / np.linalg.norm(reading), up / np.linalg.norm(up))
        tilted = quaternion_product(start, quaternion_of(turn))
    for d in range(draws):
        device, change = _drawn(held, rng)
        motion = _turning(time, rate + inside[:, None] * change)
        readings = _read(device, motion, rng)
        for k, offset in enumerate((np.zeros(3), readings[:first].mean(axis=0)) if span.rested else (np.zeros(3),)):
            q = integrate_strapdown(readings[first:] - offset, time[first:], tilted)
            error = compare_orientations(q[ends], truth[ends])
            out[k, d] = np.median(error.total), np.median(error.inclination)
    return out


def _drawn(held: HeldOutMotion, rng: np.random.Generator) -> tuple[DeviceModel, FloatArray]:
    """Return a device with its offset at rest, and the apparent rate of its change of offset in motion."""
    twin, gyro = held.twin, held.twin.gyro
    step = rng.multivariate_normal(np.zeros(12), gyro.triad.model.covariance[:12, :12], method="eigh")
    matrix = gyro.triad.model.matrix + step[:9].reshape(3, 3)
    again = np.sqrt(1.0 + 1.0 / len(gyro.rest_offsets))  # the mean of n and one more recording
    rests = gyro.rest_offsets[np.isfinite(gyro.rest_offsets).all(axis=1)]
    spread = spread_of(rests, twin.settings.offset_spread) if len(rests) else np.full(3, TURN_ON)
    rest = (rests.mean(axis=0) if len(rests) else 0.0) + again * spread * rng.standard_normal(3)
    moved = again * twin.settings.motion_offset_spread * rng.standard_normal(3)
    change = matrix @ (gyro.motion_offset + step[9:] + moved)
    chain = chain_of(matrix, rest, None, "rad/s")
    return replace(held.device, gyro=replace(held.device.gyro, scale=chain.scale, offset=Offset(constant=rest))), change


def _turning(time: FloatArray, rate: FloatArray) -> Motion:
    # Rates alone: nothing here needs orientation or force.
    n = len(time)
    return Motion(
        time=time,
        q_nb=np.tile((1.0, 0.0, 0.0, 0.0), (n, 1)),
        rate_b=rate,
        mean_rate_b=rate,
        force_b=np.full((n, 3), np.nan),
        gravity_m_s2=0.0,
        moving=np.ones(n),
    )


# ---- contributions

DRAWS = 5
_MARGIN_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ErrorSource:
    """One contribution."""

    name: str
    pitch: float  # Median over windows of the largest difference of pitch, rad
    tilt: float  # Median over windows of the largest angle between the verticals, rad


def contributions(
    prepared: Prepared, number: int, *, rng: np.random.Generator, length_s: float = 5.0
) -> tuple[ErrorSource, ...]:
    """Return what limits the twin on one held-out recording."""
    held = hold_out(prepared, number)
    bare, gyro = plain(held.device), held.device.gyro
    ideal = held.simulated(bare, rng)

    def alone(device: DeviceModel) -> FloatArray:
        return _medians(window_errors(held, held.simulated(device, rng), ideal, length_s))

    fits = np.mean([alone(drawn_gyro(bare, held.twin, rng)) for _ in range(DRAWS)], axis=0)
    whole = _medians(held.found(rng, length_s))
    white = alone(replace(bare, gyro=replace(bare.gyro, white_noise=gyro.white_noise)))
    codes = alone(replace(bare, gyro=replace(bare.gyro, adc=gyro.adc)))
    still = held.motion.time < held.match.span.start_s - _MARGIN_S
    real, seen = held.corrected(held.match.gyro, held.match.rest_offset), np.nan_to_num(held.motion.mean_rate_b)
    rest = _medians(window_errors(held, real, seen, length_s, within=still))
    known = [codes, fits, rest] if np.isfinite(rest[0]) else [white, codes, fits]  # the rest holds white noise already
    itself = hold_out(prepared, number, twin=fit_prepared(prepared, chosen=[number], brief=True))
    parts = {
        "white noise": white,
        "ADC steps": codes,
        "uncertainty of matrix and offset": fits,
        "device and poses at rest": rest,
        "unexplained": np.sqrt(np.maximum(whole**2 - np.square(known).sum(axis=0), 0.0)),
        "found": whole,
        "found with a twin of this recording": _medians(itself.found(rng, length_s)),
    }
    if not held.match.span.rested:
        del parts["device and poses at rest"]
    if gyro.white_noise is None:
        del parts["white noise"]
    return tuple(ErrorSource(name=name, pitch=float(pitch), tilt=float(tilt)) for name, (pitch, tilt) in parts.items())


def _medians(errors: WindowErrors) -> FloatArray:
    """Return the medians over windows of the differences of pitch and tilt, (2,), rad; NaN where there are none."""
    seen = (errors.pitch[np.isfinite(errors.pitch)], errors.tilt)
    return np.array([np.median(values) if len(values) else np.nan for values in seen])
