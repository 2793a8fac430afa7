"""Equations of a gyroscope against an orientation reference, over windows, and their solution."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.errors import NotObservable
from undrift.findings import Finding
from undrift.fit.gls import fit_huber, student_factor
from undrift.fit.triad import scaled_condition
from undrift.frames import quaternion_conjugate, quaternion_product, rotate, rotation_vector
from undrift.sync import Lag

# ---- window equations
#
# Over a window from pose i to pose j, with M, offset and d at their present values:
#
#     u  = y + c sign(y)                                    readings y; c of each sensor
#     w  = M (u - offset) - m(t) d                          m = 1 while the device turns
#     R_w = exp(w dt) ... exp(w dt)                         product over the window's samples
#     y  = log(R_w^T R_i^T R_j)                             what is left, rad, in the body at j
#     y  = J (dM, dd, dc) + pose noise                      J from one running sum of R regressor dt along the recording
#
# Poses are taken at their own times; the integration is read off there, the lag added. So no pose is ever interpolated.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """One recording prepared for the fit."""

    time: FloatArray  # (N,), s, record clock
    gyro: FloatArray  # (N, 3), readings, raw unit; gaps are zero
    gaps: IntArray  # (N,), gaps counted from the start: a window without one has the same count at both ends
    lag: Lag  # Of the record against the reference
    moving: BoolArray  # (N,), between the first and the last rest
    turning: FloatArray  # (N,), m: 1 where d acts, else 0
    rest_offset: FloatArray  # (3,), mean reading at rest before the motion, raw unit; NaN where there is none
    rest_sign: FloatArray  # (3,), mean sign of the readings there
    rest_uncertainty: FloatArray  # (3,), standard uncertainty of that mean, raw unit, from blocks of one second
    unit: str  # Of the readings
    at: FloatArray  # (L,), times of the poses at which windows start and end, s, record clock
    q_nb: FloatArray  # (L, 4), those poses; NaN rows are gaps
    findings: tuple[Finding, ...] = ()  # Of the clocks and ends of both files

    @property
    def rested(self) -> bool:
        """Whether it has a rest before the motion."""
        return bool(np.isfinite(self.rest_offset).all())

    def zero(self, codes: FloatArray) -> FloatArray:
        """Return the mean at rest of readings that c (3,) corrects, raw unit."""
        return self.rest_offset + self.rest_sign * codes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Windows:
    """Equations of one recording."""

    turn: FloatArray  # (n, 3), y, rad
    # (n, 3, P), J: matrix row by row, d, c, then the rotations of the recordings
    design: FloatArray
    first: IntArray  # (n,), number of the pose at which each window starts


def window_equations(recording: Recording, guess: FloatArray, offset: FloatArray, reach: int) -> Windows:
    """Return the equations of all windows that span ``reach`` strides, at M row by row, d and c.

    ``offset`` (3,) is that of readings without c: its own part of it goes with c, c sign(u) less what it is at rest.
    """
    from undrift.kernels.rotation import accumulate

    matrix, moving = guess[:9].reshape(3, 3), recording.turning[:, None]
    sign = np.sign(recording.gyro) - recording.rest_sign
    u = recording.gyro + sign * guess[12:15] - offset
    rate = u @ matrix.T - moving * guess[9:12]
    regressors = np.concatenate((u, moving, sign), axis=1)
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
    of_codes = np.einsum("narj,rj->naj", design[..., 4:7], matrix)
    blocks = (design[..., :3].reshape(n, 3, 9), -design[..., 3], of_codes)
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


def solve(
    recordings: Sequence[Recording],
    windows: Sequence[Windows],
    *,
    free: IntArray,
    reach: int,
    prior: tuple[FloatArray, FloatArray] | None = None,
) -> Solution:
    """Solve the window equations of several recordings for the parameters ``free``, by number.

    ``prior`` is how far each parameter is below its expected value, and its standard deviation, (P,) each. Windows overlap
    ``reach`` times, so that what they know counts once for all of these: prior rows are sigma sqrt(reach) / deviation.
    """
    a = np.concatenate([w.design for w in windows])[:, :, free]
    y = np.concatenate([w.turn for w in windows])
    independent = independent_windows(windows, reach)
    expected = None if prior is None else (prior[0][free], prior[1][free])
    if 3 * independent + (0 if expected is None else np.isfinite(expected[1]).sum()) <= len(free):
        raise NotObservable(
            f"reference: wanted more than {len(free) // 3} windows that do not overlap, got {independent}; "
            "record longer motion, or ask for shorter windows",
            windows=independent,
        )
    rows, turn, pull = a.reshape(-1, len(free)), y.reshape(-1), np.zeros(len(free))
    scale = _USUAL
    for _ in range(1 if expected is None else _PRIOR_PASSES):
        whole, wanted = rows, turn
        if expected is not None:
            pull = scale * np.sqrt(reach) / expected[1]
            whole, wanted = np.vstack((rows, np.diag(pull))), np.append(turn, pull * expected[0])
        condition = full_rank(whole)
        x, weight, scale = fit_huber(whole, wanted, prior=len(whole) - len(rows))
    residual = y - a @ x
    weight = weight[: len(rows)].reshape(-1, 3)

    def covariance() -> FloatArray:
        unknowns = float(len(free))
        made, freedom = _covariance(recordings, windows, (a, weight * residual, weight == 1.0), reach, pull**2)
        if expected is not None:
            normal = np.einsum("nap,naq->pq", a, (weight == 1.0)[:, :, None] * a) + np.diag(pull**2)
            shares = np.linalg.solve(normal, np.diag(pull**2))
            by_prior = shares * np.where(pull > 0.0, expected[1], 0.0)
            unknowns -= float(np.trace(shares))
            made = made * student_factor(max(freedom, 3.0 * independent) - unknowns)
            return np.asarray(made + by_prior @ by_prior.T)
        return made * student_factor(max(freedom, 3.0 * independent) - unknowns)

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


_USUAL, _PRIOR_PASSES = 5e-3, 3  # rad, of a window, from which the weight of a prior begins; passes that settle it
# Lags, in windows: from neighbours to windows that have nothing in common
_LAGS = np.array((0.0, 1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 1.0, 5 / 4, 3 / 2, 2.0))
_STRETCH = 1200  # strides, 10 min: longer recordings are taken stretch by stretch, as if these were apart


def _covariance(
    recordings: Sequence[Recording],
    windows: Sequence[Windows],
    equations: tuple[FloatArray, FloatArray, BoolArray],  # A (n, 3, P), p (n, 3), D (n, 3), in the body
    reach: int,
    pull: FloatArray,  # (P,), what a prior adds to the normal equations
) -> tuple[FloatArray, float]:
    """Return the covariance of the solution, (P, P), and the degrees of freedom of the residuals before the fit."""
    from scipy.optimize import nnls

    a, bounded, free = equations
    size, lags = a.shape[2], np.unique(np.rint(reach * _LAGS).astype(np.int64))
    gain = a @ np.linalg.inv(np.einsum("nap,naq->pq", a, free[:, :, None] * a) + np.diag(pull))
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
