"""Gyroscope against an orientation reference: mocap, a robot arm, anything that gives poses of the same body.

w = M (u - o) - G a, with w the body rate of the reference. Rates are never differentiated from poses: readings are integrated
over windows and compared with how far the reference turned, so pose noise enters twice a window whatever the rate. Windows grow
from 2 s, where the linearisation is safe for a raw device, by doubling to 16 s: pose errors do not grow with the window, the
rotation that an error of M or o causes does. Recordings of one device are pooled. Long windows suit real optics, whose errors
drift with the pose; where pose and reading noise are white, ``weights="noise"`` reaches the least error that the poses allow, a
quarter less. Offsets at rest and in motion differ (rounding, vibration, g-sensitivity: 0.01 to 0.05 deg/s), so a recording's
offset is its own mean at rest plus a change to motion that all recordings share, fitted with M: a new recording needs its own
rest alone. Each recording has a small rotation R of its own between device and body, w = R (M (u - o) - G a), whose mean over the
recordings is none: markers are put on anew, and clusters are defined anew. Where one mounting is stated it is the same for all.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.adc import restored_gyro
from undrift.errors import AlignmentError, Implausible, InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.equations import offset_of
from undrift.fit.least_squares import TriadFit, fit_huber, scaled_condition
from undrift.fit.smooth import widening_of
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotate, rotation_vector
from undrift.model import G_NAMES, MATRIX_NAMES, OFFSET_NAMES, AdcModel, TriadModel, Verdict
from undrift.record import Mounting, Record, Reference
from undrift.sync import LONGEST_STEP, Lag, LagSettings, MotionSpan, find_lag, find_motion, native_poses

# ---- window equations of a gyroscope against an orientation reference, and their solution
#
# Over a window from pose i to pose j, with M, offset and d at their present values:
#
#     w  = M (u - offset) - d - G a                         readings u, specific force a
#     R_w = exp(w dt) ... exp(w dt)                         product over the window's samples
#     y  = log(R_w^T R_i^T R_j)                             what is left, rad, in the body at j
#     y  = J (dM, dd, dG) + pose noise                      J from one running sum of R regressor dt along the recording
#
# Poses are taken at their own times; the integration is read off there, the lag added. So no pose is ever interpolated.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """One recording prepared for the fit."""

    time: FloatArray  # (N,), s, record clock
    gyro: FloatArray  # (N, 3), readings, raw unit, after ADC correction; gaps are zero
    accel: FloatArray | None  # (N, 3), m/s2, where a g-sensitivity is wanted
    gaps: IntArray  # (N,), gaps counted from the start: a window without one has the same count at both ends
    lag: Lag  # Of the record against the reference
    moving: BoolArray  # (N,), between the first and the last rest
    rest_offset: FloatArray  # (3,), mean reading at rest before the motion, raw unit
    rest_uncertainty: FloatArray  # (3,), standard uncertainty of that mean, raw unit, from blocks of one second
    at: FloatArray  # (L,), times of the poses at which windows start and end, s, record clock
    q_nb: FloatArray  # (L, 4), those poses; NaN rows are gaps


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Windows:
    """Equations of one recording."""

    turn: FloatArray  # (n, 3), y, rad
    # (n, 3, P), J: matrix row by row, then d, then G where accel readings are given, then the rotations of the recordings
    design: FloatArray
    first: IntArray  # (n,), number of the pose at which each window starts


def window_equations(recording: Recording, guess: FloatArray, offset: FloatArray, reach: int) -> Windows:
    """Return the equations of all windows that span ``reach`` strides, at M row by row, d and, with accel readings, G."""
    from undrift.kernels.rotation import accumulate

    u = recording.gyro - offset
    rate = u @ guess[:9].reshape(3, 3).T - guess[9:12]
    columns: list[FloatArray] = [u, np.ones((len(u), 1))]
    if recording.accel is not None:
        columns.append(np.nan_to_num(recording.accel))
        rate = rate - columns[2] @ guess[12:].reshape(3, 3).T
    regressors = np.concatenate(columns, axis=1)
    points, channels = len(recording.at), regressors.shape[1]
    q, total = np.empty((points, 4)), np.zeros((points, 3, 3, channels))
    accumulate(
        np.ascontiguousarray(rate).reshape(-1),
        np.ascontiguousarray(regressors).reshape(-1),
        np.ascontiguousarray(recording.time),
        recording.at,
        q.reshape(-1),
        total.reshape(-1),
    )
    first = np.flatnonzero(_whole(recording, reach))
    last = first + reach
    turned = quaternion_product(quaternion_conjugate(q[first]), q[last])
    seen = quaternion_product(quaternion_conjugate(recording.q_nb[first]), recording.q_nb[last])
    turn = rotation_vector(quaternion_product(quaternion_conjugate(turned), seen))
    gain = total[last] - total[first]
    back = quaternion_conjugate(q[last])[:, None, None, :]
    design = np.moveaxis(rotate(back, np.moveaxis(gain, 1, -1)), -1, 1)  # (n, 3 residual, 3 row, C regressor)
    n = len(first)
    blocks = (design[..., :3].reshape(n, 3, 9), -design[..., 3], -design[..., 4:].reshape(n, 3, 3 * (channels - 4)))
    return Windows(turn=turn, design=np.concatenate(blocks, axis=2), first=first)


def _whole(recording: Recording, reach: int) -> BoolArray:
    if len(recording.at) <= reach:
        return np.zeros(0, bool)
    seen = np.isfinite(recording.q_nb[:, 0])
    sample = np.clip(np.searchsorted(recording.time, recording.at), 0, len(recording.time) - 1)
    count = recording.gaps[sample]
    whole: BoolArray = seen[:-reach] & seen[reach:] & (count[:-reach] == count[reach:])
    return whole


# ---- robust least squares of overlapping windows
#
# Huber's estimate by reweighting: an equation whose residual r exceeds k s counts k s / |r|, s from the median. To first order it
# errs by x = (A^T D A)^-1 A^T p, with p = w r the bounded residuals and D = 0 where the bound holds, else 1.
#
# Neighbouring windows share readings and pose errors. In n a window's residual is e_j - e_i, with e the error of orientation along
# the recording, of three shapes alike for all axes and recordings of a device:
#
#     poses       e white                              cov e = I
#     readings    e a random walk                      min(s, t)
#     offset      e the integral of a random walk      min(s, t)^2 (3 max(s, t) - min(s, t)) / 6
#
# Their sizes, none negative, are those whose sums of products p_i . p_(i + lag) are nearest to the ones seen, less what the fit
# took of them. The residuals' sum of squares is like a chi-square's of 3 tr(V)^2 / tr(V^2) degrees of freedom for a covariance V
# (Satterthwaite 1946), but at least three times the windows that do not overlap, less the parameters. Intervals are Student's of as
# many. Scores by themselves (Newey and West 1987) would say too little: some ten windows that do not overlap hold 18 parameters.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """One linear solution."""

    step: FloatArray  # (P,), change of the parameters that were kept
    covariance: Callable[[], FloatArray]  # (P, P), of the kept parameters; computed when called
    residuals: FloatArray  # (n, 3), rad, all windows
    scale: float  # Robust standard deviation of the residuals, rad
    condition: float  # Of the design with columns scaled to one


def independent_windows(windows: Sequence[Windows], reach: int) -> int:
    """Return how many windows that do not overlap the recordings hold."""
    return sum(-(-len(w.first) // reach) for w in windows)


def solve(recordings: Sequence[Recording], windows: Sequence[Windows], *, free: IntArray, reach: int) -> Solution:
    """Solve the window equations of several recordings for the parameters ``free``, by number."""
    a = np.concatenate([w.design for w in windows])[:, :, free]
    y = np.concatenate([w.turn for w in windows])
    independent = independent_windows(windows, reach)
    if 3 * independent <= len(free):
        raise NotObservable(
            f"reference: wanted more than {len(free) // 3} windows that do not overlap, got {independent}; "
            "record longer motion, or ask for shorter windows",
            windows=independent,
        )
    rows = a.reshape(-1, len(free))
    condition = full_rank(rows)
    x, weight, scale = fit_huber(rows, y.reshape(-1))
    residual = y - a @ x
    weight = weight.reshape(-1, 3)

    def covariance() -> FloatArray:
        made, freedom = _covariance(recordings, windows, (a, weight * residual, weight == 1.0), reach)
        return made * widening_of(max(freedom, 3.0 * independent) - len(free))

    return Solution(step=x, covariance=covariance, residuals=residual, scale=scale, condition=condition)


def full_rank(design: FloatArray, what: str = "reference") -> float:
    """Return the condition number of a design (E, P) whose columns were scaled to one; raise where it is short of rank."""
    rank, condition = scaled_condition(design)
    if rank < design.shape[1]:
        raise NotObservable(
            f"{what}: wanted motion about all three axes, got a design of rank {rank} for {design.shape[1]} parameters; "
            "turn the device about every axis",
            rank=rank,
        )
    return condition


# Lags, in windows: from neighbours to windows that have nothing in common
_LAGS = np.array((0.0, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 1.0, 5 / 4, 3 / 2, 2.0))
_STRETCH = 1200  # strides, 10 min: longer recordings are taken stretch by stretch, as if these were apart


def _covariance(
    recordings: Sequence[Recording],
    windows: Sequence[Windows],
    equations: tuple[FloatArray, FloatArray, BoolArray],  # A (n, 3, P), p (n, 3), D (n, 3), in the body
    reach: int,
) -> tuple[FloatArray, float]:
    """Return the covariance of the solution, (P, P), and the degrees of freedom of the residuals before the fit."""
    from scipy.optimize import nnls

    a, bounded, free = equations
    size, lags = a.shape[2], np.unique(np.rint(reach * _LAGS).astype(np.int64))
    gain = a @ np.linalg.inv(np.einsum("nap,naq->pq", a, free[:, :, None] * a))
    table = np.concatenate((gain, free[:, :, None] * a, bounded[:, :, None]), axis=2)
    ends = np.cumsum([len(w.first) for w in windows])[:-1]
    seen, taken = np.zeros(len(lags)), np.zeros((len(lags), size, size))
    made, carried, products = np.zeros((len(lags), 3)), np.zeros((3, size, size)), np.zeros((3, 3))
    traces = np.zeros(3)
    for recording, w, own in zip(recordings, windows, np.split(table, ends), strict=True):
        whole = _level(recording.q_nb[w.first + reach], own)
        cuts = np.flatnonzero(np.diff(w.first // _STRETCH)) + 1
        for first, part in zip(np.split(w.first, cuts), np.split(whole, cuts), strict=True):
            c, design, p = part[:, :, :size], part[:, :, size:-1], part[:, :, -1]
            shapes = _shapes(first - first[:1], reach)
            moved = [np.tensordot(shape, c, axes=1) for shape in shapes]  # cov(residuals) C^T, (n, 3, P)
            carried += [np.einsum("nap,naq->pq", c, m) for m in moved]
            products += [[(s * t).sum() for t in shapes] for s in shapes]
            traces += [np.trace(s) for s in shapes]
            for k, lag in enumerate(lags):
                i, j = _apart(first, int(lag))
                shifted = np.zeros_like(design)
                shifted[i] += 0.5 * design[j]
                shifted[j] += 0.5 * design[i]
                seen[k] += (p[i] * p[j]).sum()
                taken[k] += np.einsum("nap,naq->pq", design, shifted)
                made[k] += [3.0 * s[i, j].sum() - 2.0 * (shifted * m).sum() for s, m in zip(shapes, moved, strict=True)]
    made += np.einsum("lpq,kqp->lk", taken, carried)
    length = np.maximum(np.linalg.norm(made, axis=0), 1e-300)
    sizes = nnls(made / length, seen)[0] / length
    freedom = 3.0 * float(traces @ sizes) ** 2 / max(float(sizes @ products @ sizes), 1e-300)
    return np.tensordot(sizes, carried, axes=1), freedom


def _shapes(first: IntArray, reach: int) -> list[FloatArray]:
    """Return the covariances (n, n) of e_j - e_i over windows from ``first`` (n,) that span ``reach``, of unit size each."""
    t = np.concatenate((first, first + reach)).astype(np.float64)
    low, high = np.minimum(t[:, None], t), np.maximum(t[:, None], t)
    errors, n = ((low == high).astype(np.float64), low, low**2 * (3.0 * high - low) / 6.0), len(first)
    return [of[n:, n:] - of[n:, :n] - of[:n, n:] + of[:n, :n] for of in errors]


def _apart(first: IntArray, lag: int) -> tuple[IntArray, IntArray]:
    """Return the numbers of the windows that have another one ``lag`` strides later, and of those."""
    later = np.searchsorted(first, first + lag)
    there = np.flatnonzero(first[np.minimum(later, len(first) - 1)] == first + lag) if len(first) else later
    return there, later[there]


def _level(q: FloatArray, table: FloatArray) -> FloatArray:
    """Return columns (n, 3, C), turned from the bodies q_nb (n, 4) into n."""
    return np.moveaxis(rotate(q[:, None, :], np.moveaxis(table, 1, 2)), 2, 1)


# ---- all poses in one chain: as efficient as white noise allows
#
# From pose i to the next pose j the reference turns by what the gyroscope integrated, but for the noise of both poses and that of
# the readings in between. In n, with e the noise of a pose and h that of one step:
#
#     y_j = A_j x + e_j - e_i + h_j        var e = s^2 (1 - kappa),  var h = s^2 kappa,  per axis
#
# Neighbouring equations share a pose, so their covariance is tridiagonal. kappa maximises the restricted likelihood: near 0 the
# poses are noisier and the chain acts like one long window, near 1 the readings are and it acts like many short ones. Each
# equation is whitened by the Cholesky factor; a whitened residual beyond k standard deviations counts k / |r|.

_SEARCH = 24  # steps of golden section: kappa's logit to 1e-3
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def solve_chain(recordings: Sequence[Recording], steps: Sequence[Windows], *, free: IntArray) -> Solution:
    """Solve the chains of several recordings for the parameters ``free``, by number."""
    # y and A side by side, (n, 3, 1 + P), turned from the body at the later pose into n
    sides = [np.concatenate((w.turn[:, :, None], w.design[:, :, free]), axis=2) for w in steps]
    tables = [_level(r.q_nb[w.first + 1], side) for r, w, side in zip(recordings, steps, sides, strict=True)]
    links = [np.diff(w.first) == 1 for w in steps]
    rows = 3 * sum(len(t) for t in tables)
    if rows <= 2 * len(free):
        raise NotObservable(
            f"reference: wanted more than {2 * len(free) // 3} steps between poses, got {rows // 3}; record longer motion",
            steps=rows // 3,
        )
    condition = full_rank(np.concatenate([t[:, :, 1:].reshape(-1, len(free)) for t in tables]))
    white = _whitened(tables, links, _most_likely(tables, links))
    y, a = white[:, 0], white[:, 1:]
    x, weight, scale = fit_huber(a, y)
    length = np.linalg.norm(a, axis=0)
    scaled = a / length
    residual = y - scaled @ (x * length)
    # Covariance of Huber's estimate for normal noise.
    fully = float(np.mean(weight == 1.0))
    variance = float(((weight * residual) ** 2).sum()) / (len(y) - len(x)) / max(fully, 0.1) ** 2
    covariance = np.linalg.inv(scaled.T @ scaled) * variance / np.outer(length, length)
    residual = residual.reshape(-1, 3)
    return Solution(step=x, covariance=lambda: covariance, residuals=residual, scale=scale, condition=condition)


def _most_likely(tables: Sequence[FloatArray], links: Sequence[BoolArray]) -> float:
    """Return kappa by golden section over its logit; sine waves diagonalise the covariance of an unbroken run."""
    from scipy.fft import dst

    runs = [run for t, linked in zip(tables, links, strict=True) for run in np.split(t, np.flatnonzero(~linked) + 1)]
    waves = np.concatenate([dst(run, type=1, axis=0, norm="ortho").reshape(-1, run.shape[2]) for run in runs])
    value = np.concatenate([2.0 - 2.0 * np.cos(np.pi * np.arange(1, len(r) + 1) / (len(r) + 1)) for r in runs])
    y, a = waves[:, 0], waves[:, 1:]

    def cost(logit: float) -> float:
        kappa = 1.0 / (1.0 + np.exp(-logit))
        variance = np.repeat((1.0 - kappa) * value + kappa, 3)
        weighted = a / variance[:, None]
        normal = weighted.T @ a
        residual = y - a @ np.linalg.solve(normal, weighted.T @ y)
        square = max(float((residual**2 / variance).sum()), 1e-300)
        return float((len(y) - a.shape[1]) * np.log(square) + np.log(variance).sum() + np.linalg.slogdet(normal)[1])

    low, high = -12.0, 12.0
    for _ in range(_SEARCH):
        inner, outer = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        low, high = (low, outer) if cost(inner) < cost(outer) else (inner, high)
    return float(1.0 / (1.0 + np.exp(-0.5 * (low + high))))


def _whitened(tables: Sequence[FloatArray], links: Sequence[BoolArray], kappa: float) -> FloatArray:
    """Return rows (3 n, 1 + P) with covariance s^2 I, each of them local in time, so that one bad pose stays few rows."""
    from scipy.linalg import cholesky_banded, solve_banded

    blocks = []
    for table, linked in zip(tables, links, strict=True):
        if len(table):
            band = np.vstack((np.full(len(table), 2.0 - kappa), np.append((kappa - 1.0) * linked, 0.0)))
            white = solve_banded((1, 0), cholesky_banded(band, lower=True), table.reshape(len(table), -1))
            blocks.append(white.reshape(-1, table.shape[2]))
    return np.concatenate(blocks)


# ---- settings and results

Offset = Literal["motion", "rest", "common"]
Weights = Literal["windows", "noise"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceSettings:
    """How a device is fitted to a reference."""

    window_s: float = 2.0  # First window, s: the error of the raw readings over it must stay below about 0.5 rad
    # Last window, s. Longer weighs pose noise less and slow changes of the offset more
    longest_window_s: float = 16.0
    stride_s: float = 0.5  # From the start of one window to the next, s
    # "motion": rest offset of each recording plus one fitted change from rest to motion. "rest": rest offsets alone.
    # "common": one fitted offset for all, whatever they read at rest
    offset: Offset = "motion"
    g_sensitivity: bool = False  # Fit G as well; needs accelerometer readings
    # "windows": long windows, each alike. "noise": after the first windows, neighbouring poses as one chain weighed
    # by the white noise of poses and readings
    weights: Weights = "windows"
    # "each": device and reference body are turned against each other anew in each recording. "one": by the matrix alone
    mounting: Mounting = "each"

    def __post_init__(self) -> None:
        if not 0.0 < self.stride_s <= self.window_s <= self.longest_window_s:
            raise InputError(
                "reference: wanted 0 < stride_s <= window_s <= longest_window_s, got "
                f"{self.stride_s:g}, {self.window_s:g}, {self.longest_window_s:g} s"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReferenceFit:
    """A gyroscope fitted to references, pooled over recordings of one device."""

    # Model, residuals of the longest windows (rad, shape (n, 3)), verdict. The model's offset is the mean in-motion
    # offset of the recordings
    triad: TriadFit
    # (3,), reading in motion less reading at rest, at zero rate, raw unit; zero unless ``offset`` is "motion"
    motion_offset: FloatArray
    rest_offsets: FloatArray  # (R, 3), mean reading at rest of each recording, raw unit
    lags_s: FloatArray  # (R,), lag of each recording, s
    lag_uncertainties_s: FloatArray  # (R,), its standard uncertainty, s
    turn_rates_rms: FloatArray  # (R,), root-mean-square body rate of each recording in motion, rad/s
    window_s: float  # Length of the longest windows that the recordings were long enough for, s
    window_rms: float  # Robust standard deviation of the residual rotation of the longest windows, rad
    offset_mode: Offset  # As in the settings
    mountings: FloatArray  # (R, 3), rotation vector of each recording from the mean mounting to its own body, rad

    def model_at_rest_offset(self, rest_offset: FloatArray) -> TriadModel:
        """Return the model for a recording that reads ``rest_offset`` (3,) at rest."""
        if self.offset_mode == "common":
            return self.triad.model
        return replace(self.triad.model, offset=rest_offset + self.motion_offset)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """A recording evaluated by a fit to the others."""

    recording: int  # Its number
    fit: ReferenceFit  # Fit to all others
    # That fit with the held-out recording's own rest offset: nothing in it knows the held-out reference
    model: TriadModel
    # Root-mean-square rotation that remains over windows of ``window_s`` in the held-out recording, rad
    before: float  # with the rest offset alone
    after: float  # with the model
    extrapolation: Finding | None  # Where the held-out rates exceed what the others saw
    adc: AdcModel | None  # What the readings were corrected for
    rounding: Finding | None  # Why that was chosen, where there was something to correct


# ---- recordings

MARGIN_S = 0.5  # of rest that belongs to the motion on either side


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Aligned:
    """A record and its reference on one clock."""

    record: Record
    gyro: FloatArray  # (N, 3), its readings, corrected for the ADC's rounding where it is known
    reference: Reference  # Poses at the frames that the cameras took
    lag: Lag  # Of the gyroscope readings against the poses
    span: MotionSpan  # From the first to the last rest, on the record's clock

    @property
    def at_rest(self) -> BoolArray:
        """True where there are readings of the rest before the motion, shape (N,)."""
        before = self.record.time < self.span.start_s - MARGIN_S
        return np.asarray(before & np.isfinite(self.gyro).all(axis=1))

    def corrected(self, adc: AdcModel | None) -> "Aligned":
        """Return it with readings corrected for the half steps that the rounding took."""
        return replace(self, gyro=restored_gyro(self.gyro, adc))


def align(record: Record, reference: Reference, lag_settings: LagSettings = LagSettings()) -> Aligned:
    """Find lag and motion of one recording."""
    poses = native_poses(reference)
    lag = find_lag(record, poses, lag_settings)
    span = find_motion(record, poses, lag_s=lag.seconds)
    return Aligned(record=record, gyro=np.asarray(record.gyro), reference=poses, lag=lag, span=span)


def recording_of(aligned: Aligned, settings: ReferenceSettings) -> Recording:
    """Return the rest of a recording, and its poses at the ends of windows."""
    record, gyro, time, motion = aligned.record, aligned.gyro, aligned.record.time, aligned.span
    if settings.g_sensitivity and record.accel is None:
        raise InputError("reference: wanted gyro and accel for a g-sensitivity, got one only; map the other's columns")
    poses, lag = aligned.reference, aligned.lag
    gap: BoolArray = np.asarray(np.isnan(gyro).any(axis=1))
    step = np.diff(time)
    late = np.concatenate(([False], step > LONGEST_STEP * np.median(step)))
    rest, rest_uncertainty = _rest(aligned)
    # Strapdown holds each reading over the step before its stamp: half a sample.
    at = poses.time + (lag.seconds - 0.5 * float(np.median(step)))
    inside = (at >= max(motion.start_s - MARGIN_S, time[0])) & (at <= min(motion.stop_s + MARGIN_S, time[-1]))
    chosen = np.flatnonzero(inside)[:: max(1, round(settings.stride_s * poses.sample_rate_hz))]
    return Recording(
        time=time,
        gyro=np.where(gap[:, None], 0.0, gyro),
        accel=record.in_units(record.gyro_unit, "m/s2").accel if settings.g_sensitivity else None,
        gaps=np.cumsum(gap | late),
        lag=lag,
        moving=(time >= motion.start_s) & (time < motion.stop_s),
        rest_offset=rest,
        rest_uncertainty=rest_uncertainty,
        at=np.ascontiguousarray(at[chosen]),
        q_nb=np.ascontiguousarray(poses.q_nb[chosen]),
    )


def _rest(aligned: Aligned) -> tuple[FloatArray, FloatArray]:
    time, at_rest = aligned.record.time, aligned.at_rest
    readings, second = aligned.gyro[at_rest], np.floor(time[at_rest] - time[0]).astype(np.int64)
    if len(readings) < 2 or second[-1] == second[0]:
        raise InputError(
            "reference: wanted two seconds of rest readings before the motion, got fewer; record a rest first"
        )
    blocks = np.flatnonzero(np.concatenate(([True], np.diff(second) > 0)))
    means = np.add.reduceat(readings, blocks) / np.diff(np.append(blocks, len(readings)))[:, None]
    return readings.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(len(means))


# ---- fit

_REFINEMENTS = 2  # passes at the longest window
_MOUNTING = 0.05  # matrices of single recordings may differ by this share before their mounting is taken to differ


def fit_reference(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    settings: ReferenceSettings = ReferenceSettings(),
    adc: AdcModel | None = None,
    lag_settings: LagSettings = LagSettings(),
) -> ReferenceFit:
    """Fit matrix, in-motion offset and, on request, g-sensitivity of a gyroscope to references."""
    return fit_aligned([one.corrected(adc) for one in align_all(records, references, lag_settings)], settings)


def fit_aligned(aligned: Sequence[Aligned], settings: ReferenceSettings) -> ReferenceFit:
    """Fit the gyroscopes of one device to recordings whose lag and motion are known."""
    return _fit([recording_of(one, settings) for one in aligned], settings, aligned[0].record.gyro_unit)


def leave_one_out(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    settings: ReferenceSettings = ReferenceSettings(),
    adc: AdcModel | None = None,
    lag_settings: LagSettings = LagSettings(),
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> tuple[HeldOut, ...]:
    """Fit each recording's model to all others of the device, and evaluate it there; progress takes what is done, and 0 to 1.

    Whether the readings are corrected for ``adc`` is cross-validated among the others each time.
    """
    if len(records) < 2:
        raise InputError(
            f"leave one out: wanted two recordings of a device or more, got {len(records)}; add recordings"
        )
    unit, trials, errors = records[0].gyro_unit, list[HeldOut](), None
    aligned = align_all(records, references, lag_settings)
    plain, corrected = ([recording_of(one.corrected(each), settings) for one in aligned] for each in (None, adc))
    if adc is not None:
        progress("cross-validating the correction of the ADC", 0.0)
        errors = _adc_errors((plain, corrected), settings, unit) if len(records) > 2 else None
    for i in range(len(records)):
        progress(f"fit without recording {i + 1} of {len(records)}", i / len(records))
        keep, why = (True, None) if adc is None else _adc_choice(errors, without=i)
        prepared = corrected if keep else plain
        fit = _fit([*prepared[:i], *prepared[i + 1 :]], settings, unit)
        trials.append(_held_out(i, prepared[i], fit, settings, (adc if keep else None, why)))
    return tuple(trials)


def cross_validated_adc(
    records: Sequence[Record],
    references: Sequence[Reference],
    adc: AdcModel | None,
    *,
    settings: ReferenceSettings = ReferenceSettings(),
    lag_settings: LagSettings = LagSettings(),
) -> tuple[AdcModel | None, Finding | None]:
    """Return the ADC model where correcting for it lowers the error on recordings that a fit has not seen, and the evidence."""
    if adc is None:
        return None, None
    errors = None
    if len(records) > 1:
        aligned = align_all(records, references, lag_settings)
        plain, corrected = ([recording_of(one.corrected(each), settings) for one in aligned] for each in (None, adc))
        errors = _adc_errors((plain, corrected), settings, records[0].gyro_unit)
    keep, why = _adc_choice(errors, without=None)
    return adc if keep else None, why


def _adc_errors(
    variants: tuple[list[Recording], list[Recording]], settings: ReferenceSettings, unit: str
) -> FloatArray | None:
    """Return the rms rotation, rad, that a fit to recording i alone leaves in j, (2, R, R), codes as they are and corrected.

    None where single recordings are too short for a fit.
    """
    count = len(variants[0])
    errors = np.full((2, count, count), np.nan)
    for which, prepared in enumerate(variants):
        mounted = _first_mountings(prepared, settings)
        for i in range(count):
            try:
                fit = _fit([prepared[i]], settings, unit)
            except NotObservable:
                return None
            for j in range(count):
                if i != j:
                    model = fit.model_at_rest_offset(prepared[j].rest_offset)
                    errors[which, i, j] = _left(prepared[j], model, mounted[j] @ mounted[i].T, fit.window_s, settings)
    return errors


def _adc_choice(errors: FloatArray | None, *, without: int | None) -> tuple[bool, Finding]:
    """Return whether to correct, by two recordings or more other than one; where there are no errors, as the codes say."""
    if errors is None:
        return True, finding("reference.adc_not_validated", "info")
    seen = errors if without is None else np.delete(np.delete(errors, without, axis=1), without, axis=2)
    plain, corrected = np.sqrt(np.nanmean(seen**2, axis=(1, 2)))
    degrees = {"with_deg": float(np.degrees(corrected)), "without_deg": float(np.degrees(plain))}
    keep = bool(corrected <= plain)
    return keep, finding("reference.adc", "info", choice="kept" if keep else "left out", **degrees)


def align_all(records: Sequence[Record], references: Sequence[Reference], lag_settings: LagSettings) -> list[Aligned]:
    """Find lag and motion of the recordings of one device."""
    if not records or len(records) != len(references):
        raise InputError(
            f"reference: wanted one reference for each record, got {len(records)} records and {len(references)} references"
        )
    units = sorted({r.gyro_unit for r in records})
    if len(units) > 1:
        raise InputError(
            f"reference: wanted one unit for all recordings of a device, got {', '.join(units)}; convert them"
        )
    return [align(*pair, lag_settings) for pair in zip(records, references, strict=True)]


def _fit(prepared: Sequence[Recording], settings: ReferenceSettings, unit: str) -> ReferenceFit:
    offsets = [np.zeros(3) if settings.offset == "common" else p.rest_offset for p in prepared]
    mounted = _first_mountings(prepared, settings)
    guess = _first_guess(prepared, mounted, settings)
    count = len(prepared) if settings.mounting == "each" else 1
    extra = 3 * (count - 1)
    free = np.arange(len(guess) + extra)
    if settings.offset == "rest":
        free = np.delete(free, np.s_[9:12])
    solution, used = None, settings.window_s

    def equations(reach: int) -> list[Windows]:
        each = zip(prepared, mounted, offsets, strict=True)
        return [_of_device(p, guess, r, o, reach, (i, count)) for i, (p, r, o) in enumerate(each)]

    def step(found: Solution) -> None:
        moved = np.zeros(len(guess) + extra)
        moved[free] = found.step
        guess[:] += moved[: len(guess)]
        turns = moved[len(guess) :].reshape(-1, 3)
        for i, turn in enumerate((*turns, -turns.sum(axis=0)) if extra else ()):
            mounted[i] = rotate(quaternion_of(turn), mounted[i].T).T

    for length in _lengths(settings):
        reach = max(1, round(length / settings.stride_s))
        windows = equations(reach)
        if solution is not None and independent_windows(windows, reach) <= len(free) / 3.0:
            break  # too short for longer windows: stay with the last ones
        solution, used = solve(prepared, windows, free=free, reach=reach), length
        step(solution)
    for _ in range(_REFINEMENTS if settings.weights == "noise" else 0):
        solution, used = solve_chain(prepared, equations(1), free=free), settings.stride_s
        step(solution)
    determinant = np.linalg.det(guess[:9].reshape(3, 3))
    if solution is None or determinant <= 0.0:
        raise Implausible(
            f"reference: wanted a right-handed matrix, got a determinant of {determinant:.3g}; "
            "one axis of the readings or of the reference is reversed"
        )
    return _result(prepared, mounted, settings, unit, guess, free[: len(free) - extra], solution, used)


def _of_device(
    recording: Recording, guess: FloatArray, mounted: FloatArray, offset: FloatArray, reach: int, place: tuple[int, int]
) -> Windows:
    """Return a recording's equations in the device's parameters and, after them, in the turns of all recordings but the last.

    ``place`` is the number of the recording, and how many there are that turn; the last turns back what the others do.
    """
    (number, count), size = place, len(guess)
    to_body = np.stack([_turned(unit, mounted) for unit in np.eye(size)], axis=1)
    windows = window_equations(recording, to_body @ guess, offset, reach)
    if count < 2:
        return replace(windows, design=windows.design @ to_body)
    cross = [np.cross(axis, np.eye(3)).T for axis in np.eye(3)]
    turns = np.stack([_turned(to_body @ guess, each) for each in cross], axis=1)  # (P, 3): by a rotation of the body
    columns = np.zeros((size, size + 3 * (count - 1)))
    columns[:, :size] = to_body
    if number < count - 1:
        columns[:, size + 3 * number : size + 3 * number + 3] = turns
    else:
        columns[:, size:] = np.tile(-turns, count - 1)
    return replace(windows, design=windows.design @ columns)


def _turned(parameters: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return M, d and G, one after the other, turned by a matrix (3, 3)."""
    parts = parameters[:9], parameters[9:12], parameters[12:]
    return np.concatenate([(rotation @ part.reshape(3, -1)).reshape(-1) for part in parts])


def _lengths(settings: ReferenceSettings) -> list[float]:
    lengths = [settings.window_s]
    if settings.weights == "noise":
        return lengths  # a start for the chain
    while lengths[-1] < settings.longest_window_s:
        lengths.append(min(2.0 * lengths[-1], settings.longest_window_s))
    return lengths + [lengths[-1]] * _REFINEMENTS


def _first_mountings(prepared: Sequence[Recording], settings: ReferenceSettings) -> FloatArray:
    """Return the rotation from the first recording's body to each one's, (R, 3, 3), where single fits show one; else none."""
    none = np.tile(np.eye(3), (len(prepared), 1, 1))
    matrices = np.array([p.lag.matrix for p in prepared])
    if settings.mounting == "one" or _difference(matrices) <= _MOUNTING:
        return none
    left, _, right = np.linalg.svd(matrices @ np.linalg.pinv(matrices[0]))
    turned = left @ right
    return turned if (np.linalg.det(turned) > 0.0).all() else none


def _difference(matrices: FloatArray) -> float:
    """Return how far matrices (R, 3, 3) are from their mean, as a share of its size."""
    mean = matrices.mean(axis=0)
    return float(np.abs(matrices - mean).max()) / float(np.linalg.norm(mean, 2))


def _first_guess(prepared: Sequence[Recording], mounted: FloatArray, settings: ReferenceSettings) -> FloatArray:
    # The lag search has fitted rate = A u + c for every recording; no errors-in-variables care is needed for a start.
    back = np.swapaxes(mounted, 1, 2)
    matrices = back @ np.array([p.lag.matrix for p in prepared])
    matrix, worst = matrices.mean(axis=0), _difference(matrices)
    if worst > _MOUNTING:
        raise AlignmentError(
            f"reference: wanted one {'mounting' if settings.mounting == 'one' else 'device'} for all recordings, got matrices that "
            f"differ by {worst:.0%}{'' if settings.mounting == 'one' else ' apart from a rotation'}; fit recordings with other "
            "marker clusters (`mounting` one) or other sensors apart",
            difference=worst,
        )
    constants = [
        np.zeros(3)
        if settings.offset == "rest"
        else -r @ p.lag.constant - matrix @ p.rest_offset * (settings.offset == "motion")
        for p, r in zip(prepared, back, strict=True)
    ]
    g = np.zeros(9 if settings.g_sensitivity else 0)
    return np.concatenate((matrix.reshape(-1), np.mean(constants, axis=0), g))


def _result(
    prepared: Sequence[Recording],
    mounted: FloatArray,
    settings: ReferenceSettings,
    unit: str,
    guess: FloatArray,
    free: IntArray,
    solution: Solution,
    window_s: float,
) -> ReferenceFit:
    from scipy.spatial.transform import Rotation

    matrix = guess[:9].reshape(3, 3)
    motion_offset, jacobian = offset_of(matrix, guess[9:12], len(guess))  # from (M, d, G) to (M, o, G)
    rest = np.array([p.rest_offset for p in prepared])
    base = np.zeros(3) if settings.offset == "common" else rest.mean(axis=0)
    covariance = np.zeros((len(guess), len(guess)))
    covariance[np.ix_(free, free)] = solution.covariance()[: len(free), : len(free)]
    covariance = jacobian @ covariance @ jacobian.T
    if settings.offset != "common":
        spread = np.array([p.rest_uncertainty for p in prepared])
        covariance[range(9, 12), range(9, 12)] += (spread**2).sum(axis=0) / len(prepared) ** 2
    seen = [(p.gyro[p.moving] - base - motion_offset) @ matrix.T for p in prepared]
    model = TriadModel(
        method=f"reference/{settings.offset}",
        unit_in=unit,
        unit_out="rad/s",
        matrix=matrix,
        offset=base + motion_offset,
        g_sensitivity=guess[12:].reshape(3, 3) if settings.g_sensitivity else None,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES, *(G_NAMES if settings.g_sensitivity else ())),
        covariance=covariance,
        rms_residual=float(np.sqrt((solution.residuals**2).mean())) / window_s,
        count=solution.residuals.size,
        rank=len(free),
        condition=solution.condition,
        valid_range=(min(float(w.min()) for w in seen), max(float(w.max()) for w in seen)),
    )
    return ReferenceFit(
        triad=TriadFit(model=model, residuals=solution.residuals, verdict=Verdict.of(*_judged(model, rest, settings))),
        motion_offset=np.zeros(3) if settings.offset == "common" else motion_offset,
        rest_offsets=rest,
        lags_s=np.array([p.lag.seconds for p in prepared]),
        lag_uncertainties_s=np.array([p.lag.standard_uncertainty for p in prepared]),
        turn_rates_rms=np.array([np.sqrt((w**2).sum(axis=1).mean()) for w in seen]),
        window_s=window_s,
        window_rms=solution.scale,
        offset_mode=settings.offset,
        mountings=Rotation.from_matrix(mounted).as_rotvec(),
    )


def _judged(model: TriadModel, rest: FloatArray, settings: ReferenceSettings) -> Iterator[Finding]:
    sigma, scale = model.standard_uncertainty, float(np.linalg.norm(model.matrix, 2))
    uncertain = float(sigma[:9].max()) / scale
    if uncertain > 2e-3:
        yield finding("reference.uncertainty", "warn", uncertainty_percent=100.0 * uncertain)
    if settings.offset == "motion" and len(rest) > 1:
        spread_dps = np.degrees(rest.std(axis=0, ddof=1).max() * scale)
        if spread_dps > 0.03:
            yield finding("reference.rest_offset", "warn", spread_dps=spread_dps)
    if model.g_sensitivity is not None and (np.abs(model.g_sensitivity).reshape(-1) < 3.0 * sigma[12:]).all():
        yield finding("reference.g_sensitivity", "warn")


def _left(
    recording: Recording, model: TriadModel, turn: FloatArray, window_s: float, settings: ReferenceSettings
) -> float:
    """Return the rms rotation that a model leaves over the windows of a recording, rad; ``turn`` leads from the model's body."""
    g = np.zeros(0) if model.g_sensitivity is None else model.g_sensitivity.reshape(-1)
    parameters = _turned(np.concatenate((model.matrix.reshape(-1), np.zeros(3), g)), turn)
    windows = window_equations(recording, parameters, model.offset, max(1, round(window_s / settings.stride_s)))
    return float(np.sqrt((windows.turn**2).sum(axis=1).mean()))


def _held_out(
    number: int,
    recording: Recording,
    fit: ReferenceFit,
    settings: ReferenceSettings,
    adc: tuple[AdcModel | None, Finding | None],
) -> HeldOut:
    model = fit.model_at_rest_offset(recording.rest_offset)
    plain = replace(model, matrix=_rigid(model.matrix), offset=recording.rest_offset)
    before, after = (_left(recording, one, np.eye(3), settings.window_s, settings) for one in (plain, model))
    rate = np.abs((recording.gyro[recording.moving] - model.offset) @ model.matrix.T)
    limit = max(abs(model.valid_range[0]), abs(model.valid_range[1]))
    beyond = float((rate > limit).any(axis=1).mean())
    rms = float(np.sqrt((rate**2).sum(axis=1).mean()))
    most = float(fit.turn_rates_rms.max())
    extrapolation = None
    if beyond > 0.0 or rms > 1.5 * most:
        names = ("most_dps", "rms_dps", "seen_dps", "seen_rms_dps")
        rates = zip(names, np.degrees((rate.max(), rms, limit, most)), strict=True)
        extrapolation = finding("validate.extrapolated", "warn", **dict(rates))
    return HeldOut(
        recording=number,
        fit=fit,
        model=model,
        before=before,
        after=after,
        extrapolation=extrapolation,
        adc=adc[0],
        rounding=adc[1],
    )


def _rigid(matrix: FloatArray) -> FloatArray:
    # The nearest rotation times the nominal scale: a raw device in that mounting before any calibration.
    left, singular, right = np.linalg.svd(matrix)
    scale = float(np.exp(np.log(singular).mean()))
    nominal = 1.0 if 0.5 < scale < 2.0 else scale
    return np.asarray(nominal * left @ right)
