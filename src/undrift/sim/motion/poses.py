"""Convert camera poses to the motion of an ideal sensor at the body's origin.

Each stretch between long gaps is processed separately. Short gaps are bridged with a cubic. A low-pass without delay is applied in
n to the position and to the quaternion without sign jumps. The rotation into b is the last step. Then a quintic spline is fitted to
each coordinate. Position p(t) and the four components s(t) of a quaternion are splines, and the orientation is s over its length.
All quantities follow in closed form::

    q = s / |s|
    w = 2 Im(conj(s) s') / |s|^2                                       angular rate of b against n, seen in b
    w' = 2 Im(conj(s) s'') / |s|^2  -  2 w (s . s') / |s|^2            conj(s') s' is a number, so it adds nothing
    f_b = R_nb^T (p'' + g z)

so that integration of the rate returns the pose. A pose sequence with linear interpolation between the camera frames must first be
reduced to those frames. The low-pass is a Butterworth of order n, forward and backward. Two passes attenuate by 6 dB at the cut-off
f_c, so each pass is designed for f_c / (sqrt(2) - 1)^(1 / 2n) [1]_.

References
----------
.. [1] D. A. Winter, "Biomechanics and Motor Control of Human Movement", 4th ed., 2009, section 3.4.4.2.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotate, signed
from undrift.record import Reference
from undrift.sim.device.simulate import Streams, draw_streams
from undrift.sim.motion.motion import Motion, mean_rate
from undrift.sim.motion.tasks import Task

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

# ---- Spline of a pose

DEGREE = 5


def quintic(time: FloatArray, values: FloatArray) -> "BSpline":
    """Return the quintic spline through values."""
    from scipy.interpolate import make_interp_spline

    return make_interp_spline(time, values, k=DEGREE)


def turning(spline: "BSpline", time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return q_nb (N, 4), rate_b (N, 3) rad/s and angular acceleration (N, 3) rad/s2 of a spline of quaternions."""
    s, first, second = spline(time), spline(time, nu=1), spline(time, nu=2)
    square = (s * s).sum(axis=1, keepdims=True)
    inverse = quaternion_conjugate(s)
    rate = 2.0 * quaternion_product(inverse, first)[:, 1:] / square
    swell = 2.0 * (s * first).sum(axis=1, keepdims=True) / square
    acceleration = 2.0 * quaternion_product(inverse, second)[:, 1:] / square - rate * swell
    return s / np.sqrt(square), rate, acceleration


# ---- Stretches between long gaps

FEWEST = 12  # smallest number of poses in a stretch, twice the minimum for a quintic


GAP_S = 0.1  # longest gap that is bridged
TRIM_S = 0.2  # time omitted at each end of a longer gap
END_TRIM_S = 0.1  # time omitted at the ends of the recording


def find_stretches(time: FloatArray, visible: BoolArray) -> list[tuple[IntArray, float, float]]:
    """Return the stretches between long gaps: rows (K,) with poses, and start and end of the known motion, s."""
    rows = np.flatnonzero(visible)
    breaks = np.flatnonzero(np.diff(time[rows]) > GAP_S * (1.0 + 1e-9)) + 1
    spans = []
    for piece in np.split(rows, breaks):
        if len(piece) < FEWEST:
            continue
        before = END_TRIM_S if piece[0] == 0 else TRIM_S
        after = END_TRIM_S if piece[-1] == len(time) - 1 else TRIM_S
        start, stop = float(time[piece[0]]) + before, float(time[piece[-1]]) - after
        if stop > start:
            spans.append((piece, start, stop))
    if not spans:
        raise InputError(
            f"poses: no stretch of at least {FEWEST} poses without a gap over {GAP_S:g} s is longer than the trimmed part, "
            f"got {len(rows)} valid poses of {len(time)}. Trim less, or record without gaps."
        )
    return spans


# ---- Low-pass

ORDER = 4  # in each direction: a quarter of the cut-off passes within 1e-5, so no loss looks like a scale factor
_PAD = 3.0  # number of periods of the cut-off that are mirrored at each end


def zero_phase(x: FloatArray, cutoff_hz: float, *, sample_rate_hz: float, order: int = ORDER) -> FloatArray:
    """Return the columns of x after a low-pass without delay."""
    from scipy.signal import butter, sosfiltfilt

    design_hz = cutoff_hz / (math.sqrt(2.0) - 1.0) ** (0.5 / order)
    if not 0.0 < design_hz < 0.5 * sample_rate_hz:
        highest = 0.5 * sample_rate_hz * cutoff_hz / design_hz if cutoff_hz > 0.0 else 0.5 * sample_rate_hz
        raise InputError(
            f"low-pass: cut-off must be between 0 and {highest:.3g} Hz at {sample_rate_hz:.6g} samples/s, got {cutoff_hz:g} "
            "Hz. Reduce it, or set None for no filter."
        )
    sections = butter(order, design_hz, fs=sample_rate_hz, output="sos")
    pad = min(len(x) - 1, math.ceil(_PAD * sample_rate_hz / cutoff_hz))
    return np.ascontiguousarray(sosfiltfilt(sections, x, axis=0, padtype="odd", padlen=pad))


# ---- Poses to motion

_EVEN = 0.02  # share of a step: poses further from their even grid are interpolated before filtering


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSettings:
    """Settings of the conversion from poses to a motion."""

    # cut-off of the orientation's low-pass, Hz (a lower cut-off reduces camera noise and fast motion; None: no filter)
    cutoff_hz: float | None = 20.0
    # cut-off of the position's low-pass, Hz; it is lower because acceleration noise increases with frequency squared
    position_cutoff_hz: float | None = 10.0
    order: int = ORDER  # order of the Butterworth low-pass, per direction (a higher order is sharper and rings longer)


class PosePiece(NamedTuple):
    """Splines through a stretch of poses between long gaps."""

    start_s: float  # start of the known motion, s
    stop_s: float
    quaternion: "BSpline"
    position: "BSpline | None"  # m, frame n


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseSpline:
    """A motion that can be evaluated at any time."""

    pieces: tuple[PosePiece, ...]  # in order of time
    moving_time: FloatArray  # (K,), times of the motion marks, s
    moving: FloatArray  # (K,), 1 in motion (all 1 without marks)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time with a known motion, s."""
        return self.pieces[0].start_s, self.pieces[-1].stop_s

    def at(self, time: FloatArray, gravity_m_s2: float) -> Motion:
        """Return the motion at given times."""
        q, rate, swing, force = (np.full((len(time), width), np.nan) for width in (4, 3, 3, 3))
        valid = np.zeros(len(time))
        for piece in self.pieces:
            rows = np.flatnonzero((time >= piece.start_s) & (time <= piece.stop_s))
            q[rows], rate[rows], swing[rows] = turning(piece.quaternion, time[rows])
            valid[rows] = 1.0
            if piece.position is not None:
                push = piece.position(time[rows], nu=2) + np.array([0.0, 0.0, gravity_m_s2])
                force[rows] = rotate(quaternion_conjugate(q[rows]), push)
        mean = mean_rate(time, q, rate[0])
        first = np.flatnonzero((valid[1:] > 0.0) & (valid[:-1] == 0.0)) + 1  # no step before a gap's end
        mean[first] = rate[first]
        nearest = np.searchsorted(0.5 * (self.moving_time[1:] + self.moving_time[:-1]), time)
        return Motion(
            time=time,
            q_nb=q,
            rate_b=rate,
            mean_rate_b=mean,
            force_b=force,
            gravity_m_s2=gravity_m_s2,
            moving=self.moving[nearest] * valid,
            angular_acceleration_b=swing,
            valid=valid,
        )

    def position(self, time: FloatArray) -> FloatArray:
        """Return the position of the body's origin, (N, 3) m."""
        out = np.full((len(time), 3), np.nan)
        for piece in self.pieces:
            if piece.position is not None:
                rows = np.flatnonzero((time >= piece.start_s) & (time <= piece.stop_s))
                out[rows] = piece.position(time[rows])
        return out


def fit_pose_spline(reference: Reference, settings: PoseSettings = PoseSettings()) -> PoseSpline:
    """Return splines through the poses of a body."""
    time, visible = reference.time, reference.valid
    if reference.position is not None:
        visible = visible & np.isfinite(reference.position).all(axis=1)
    step, pieces = 1.0 / reference.sample_rate_hz, []
    for rows, start, stop in find_stretches(time, visible):
        t, position = time[rows], None
        if reference.position is not None:
            position = _smooth(t, reference.position[rows], step, settings.position_cutoff_hz, settings.order)
        quaternion = _smooth(t, signed(reference.q_nb[rows]), step, settings.cutoff_hz, settings.order)
        pieces.append(PosePiece(start, stop, quaternion, position))
    moving = np.ones(len(time)) if reference.moving is None else reference.moving
    return PoseSpline(pieces=tuple(pieces), moving_time=time, moving=moving)


def _smooth(time: FloatArray, values: FloatArray, step: float, cutoff_hz: float | None, order: int) -> "BSpline":
    """Return the spline through values after a low-pass. Off an even grid, they are first interpolated with a cubic."""
    from scipy.interpolate import CubicSpline

    if cutoff_hz is None:
        return quintic(time, values)
    even = np.linspace(time[0], time[-1], round((time[-1] - time[0]) / step) + 1)
    if len(time) != len(even) or np.abs(time - even).max() > _EVEN * step:
        values = CubicSpline(time, values)(even)
    rate = float((len(even) - 1) / (even[-1] - even[0]))
    return quintic(even, zero_phase(values, cutoff_hz, sample_rate_hz=rate, order=order))


# ---- Simulated optics


SLOW_S = 5.0  # time constant of the slow error, s
HIDDEN_S = 0.2  # length of a gap, s


@dataclass(frozen=True, slots=True, kw_only=True)
class OpticsSettings:
    """Errors of cameras."""

    sample_rate_hz: float = 100.0  # poses per second
    delay_s: float = 0.0  # a pose with time stamp t was taken at t - delay_s
    angle_sd: float = 3e-4  # noise about each body axis, rad
    position_sd: float = 2e-4  # noise of each coordinate, m
    gaps: int = 2  # number of gaps while the device moves
    mount_sd: float = 0.0  # misalignment of the marker body relative to the case about each axis, rad
    slow_sd: float = 0.0  # first-order Gauss-Markov error about each body axis, rad


def see(task: Task, *, rng: np.random.Generator, settings: OpticsSettings | None = None) -> Reference:
    """Return camera poses of a task."""
    chosen, streams = settings or OpticsSettings(), draw_streams(rng)
    time = np.arange(round(task.duration_s * chosen.sample_rate_hz)) / chosen.sample_rate_hz
    motion = task.at(time - chosen.delay_s, 9.8)
    q, position = disturbed(motion.q_nb, task.position(time - chosen.delay_s), streams=streams, settings=chosen)
    starts = streams.of("gap").uniform(task.moving_s[0], task.moving_s[1] - HIDDEN_S, chosen.gaps)
    hidden = ((time >= starts[:, None]) & (time < starts[:, None] + HIDDEN_S)).any(axis=0)
    q[hidden] = np.nan
    position[hidden] = np.nan
    return Reference(time=time, q_nb=q, position=position, moving=motion.moving, name=f"simulated optics, {task.name}")


def disturbed(
    q_nb: FloatArray, position: FloatArray, *, streams: Streams, settings: OpticsSettings
) -> tuple[FloatArray, FloatArray]:
    """Return poses with camera errors, q_nb (N, 4) and position (N, 3), m."""
    mount = quaternion_of(streams.of("mount").normal(0.0, settings.mount_sd, 3))
    error = streams.of("angle").normal(0.0, settings.angle_sd, (len(q_nb), 3))
    if settings.slow_sd:
        from scipy.signal import lfilter

        keep = np.exp(-1.0 / (SLOW_S * settings.sample_rate_hz))
        draws = streams.of("slow").normal(0.0, settings.slow_sd, (len(q_nb), 3))
        draws[1:] *= np.sqrt(1.0 - keep**2)
        error = error + lfilter([1.0], [1.0, -keep], draws, axis=0)
    shifted = position + streams.of("position").normal(0.0, settings.position_sd, position.shape)
    return quaternion_product(quaternion_product(q_nb, mount), quaternion_of(error)), shifted
