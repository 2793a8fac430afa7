"""Window equations of a gyroscope against an orientation reference, and their solution.

Over a window from pose i to pose j, with M, offset and d at their present values:

    w  = M (u - offset) - d - G a                         readings u, specific force a
    R_w = exp(w dt) ... exp(w dt)                         product over the window's samples
    y  = log(R_w^T R_i^T R_j)                             what is left, rad, in the body at j
    y  = J (dM, dd, dG) + pose noise                      J from one running sum of R regressor dt along the recording

Poses are taken at their own times; the integration is read off there, the lag added. So no pose is ever interpolated.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.errors import NotObservable
from undrift.fit.least_squares import scaled_condition
from undrift.frames import quaternion_conjugate, quaternion_product, rotate, rotation_vector
from undrift.sync import Lag, box_sums


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
    blocks = (design[..., :3].reshape(n, 3, 9), -design[..., 3], -design[..., 4:].reshape(n, 3, -1))
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
# Huber's estimate by reweighting: an equation whose residual r exceeds k s counts k s / |r|, s from the median. Neighbouring
# windows share readings and pose errors, so the covariance is the sandwich N^-1 S N^-1 with S the long-run covariance of the
# scores g = J^T w r, lags up to the window length and beyond under Bartlett's triangle (Newey and West 1987). The triangle is what
# the squares of all sliding sums of B neighbours give, which is how it is computed here.

_REWEIGHTINGS = 15
_HUBER = 1.345  # k


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """One linear solution."""

    step: FloatArray  # (P,), change of the parameters that were kept
    covariance: FloatArray  # (P, P), sandwich
    residuals: FloatArray  # (n, 3), rad, all windows
    scale: float  # Robust standard deviation of the residuals, rad
    condition: float  # Of the design with columns scaled to one


def independent_windows(windows: Sequence[Windows], reach: int) -> int:
    """Return how many windows that do not overlap the recordings hold."""
    return sum(-(-len(w.first) // reach) for w in windows)


def solve(windows: Sequence[Windows], *, kept: IntArray, reach: int) -> Solution:
    """Solve the window equations of several recordings for the parameters ``kept``, by number."""
    a = np.concatenate([w.design for w in windows])[:, :, kept]
    y = np.concatenate([w.turn for w in windows])
    independent = independent_windows(windows, reach)
    if 3 * independent <= len(kept):
        raise NotObservable(
            f"reference: wanted more than {len(kept) // 3} windows that do not overlap, got {independent}; "
            "record longer motion, or ask for shorter windows",
            windows=independent,
        )
    rows = a.reshape(-1, len(kept))
    condition = _full_rank(rows)
    x, weight, scale = _huber(rows, y.reshape(-1))
    residual = y - a @ x
    bread = np.linalg.inv((rows.T * weight) @ rows)
    scores = np.einsum("nap,na->np", a, weight.reshape(-1, 3) * residual)
    meat = _long_run(scores, windows, 2 * reach)
    # Residuals are short of errors by their leverage, P / n on average; HC3's square of it, not HC1's first power
    # (MacKinnon and White 1985).
    covariance = bread @ meat @ bread * (3 * independent / (3 * independent - len(kept))) ** 2
    return Solution(step=x, covariance=covariance, residuals=residual, scale=scale, condition=condition)


def _full_rank(design: FloatArray) -> float:
    rank, condition = scaled_condition(design)
    if rank < design.shape[1]:
        raise NotObservable(
            f"reference: wanted motion about all three axes, got a design of rank {rank} for {design.shape[1]} parameters; "
            "turn the device about every axis",
            rank=rank,
        )
    return condition


def _huber(a: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return parameters, weights and robust scale (Huber, "Robust estimation of a location parameter", 1964)."""
    length = np.linalg.norm(a, axis=0)
    scaled = a / length
    weight = np.ones(len(y))
    x, scale = np.zeros(a.shape[1]), 0.0
    for _ in range(_REWEIGHTINGS):
        previous = x
        x = np.linalg.solve((scaled.T * weight) @ scaled, scaled.T @ (weight * y))
        size = np.abs(y - scaled @ x)
        scale = 1.4826 * float(np.median(size))
        weight = np.minimum(1.0, _HUBER * scale / np.maximum(size, 1e-15)) if scale > 0.0 else weight
        if np.abs(x - previous).max() <= 1e-9 * max(float(np.abs(x).max()), 1e-12):
            break
    return x / length, weight, scale


def _long_run(scores: FloatArray, windows: Sequence[Windows], width: int) -> FloatArray:
    size = scores.shape[1]
    meat, ends = np.zeros((size, size)), np.cumsum([len(w.first) for w in windows])
    for w, own in zip(windows, np.split(scores, ends[:-1]), strict=True):
        if len(own):
            line = np.zeros((int(w.first[-1] - w.first[0]) + 2 * width - 1, size))
            line[w.first - w.first[0] + width - 1] = own
            sums = box_sums(line, width)
            meat += sums.T @ sums / width
    return meat


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


def solve_chain(recordings: Sequence[Recording], steps: Sequence[Windows], *, kept: IntArray) -> Solution:
    """Solve the chains of several recordings for the parameters ``kept``, by number."""
    tables = [_in_level(r, w, kept) for r, w in zip(recordings, steps, strict=True)]
    links = [np.diff(w.first) == 1 for w in steps]
    rows = 3 * sum(len(t) for t in tables)
    if rows <= 2 * len(kept):
        raise NotObservable(
            f"reference: wanted more than {2 * len(kept) // 3} steps between poses, got {rows // 3}; record longer motion",
            steps=rows // 3,
        )
    condition = _full_rank(np.concatenate([t[:, :, 1:].reshape(-1, len(kept)) for t in tables]))
    white = _whitened(tables, links, _most_likely(tables, links))
    y, a = white[:, 0], white[:, 1:]
    x, weight, scale = _huber(a, y)
    length = np.linalg.norm(a, axis=0)
    scaled = a / length
    residual = y - scaled @ (x * length)
    # Covariance of Huber's estimate for normal noise.
    fully = float(np.mean(weight == 1.0))
    variance = float(((weight * residual) ** 2).sum()) / (len(y) - len(x)) / max(fully, 0.1) ** 2
    covariance = np.linalg.inv(scaled.T @ scaled) * variance / np.outer(length, length)
    residual = residual.reshape(-1, 3)
    return Solution(step=x, covariance=covariance, residuals=residual, scale=scale, condition=condition)


def _in_level(recording: Recording, steps: Windows, kept: IntArray) -> FloatArray:
    """Return y and A side by side, (n, 3, 1 + P), turned from the body at the later pose into n."""
    q = recording.q_nb[steps.first + 1][:, None, :]
    table = np.concatenate((steps.turn[:, :, None], steps.design[:, :, kept]), axis=2)
    return np.moveaxis(rotate(q, np.moveaxis(table, 1, 2)), 2, 1)


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
