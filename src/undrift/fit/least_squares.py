"""Weighted least squares of the forward model s = K a + b, shared by the fits whose inputs are known.

Each sensor is a row of its own, with the standard deviation of every equation given::

    minimise  sum_p ((s_pi - K_i . a_p - b_i) / sigma_pi)^2          i = x, y, z

Where sigma is not known beforehand it is estimated from the residuals, and the covariance is widened by v / (v - 2), v the
spare equations: the variance of Student's t, so that 95 % intervals of 1.96 standard uncertainties still hold (JCGM 101,
6.4.9).

TriadFit: what every fit returns, and the linear algebra that the fits share.

Forward model of a triad: s = K a + b. Least squares gives (K, b) with their covariance; the correction needs the inverse,
a = M (s - o) with M = K^-1 and o = b. The covariance is carried over to first order::

    dM = -M dK M        do = db

Excess variance: what the residuals show beyond the noise that was put in.

::

    sum r_k^2 / (v_k + s2) = degrees of freedom,   s2 >= 0

The stated variances v_k know the noise within a still. Hands that sway, a table that is not quite still, a nonlinearity:
these move whole poses and show only in the residuals. s2 is what makes the weighted sum of squares equal its expectation [1]_.

References
----------
.. [1] R. C. Paule and J. Mandel, "Consensus values and weighting factors", J. Res. NBS 87, 1982, 377-385.

Least squares of readings whose offset wanders while they are taken.

Readings u of times t follow X theta + b(t) + n: n is white with known standard deviations, b a random walk that is zero in
the middle t_m of the session and spreads by q sqrt(|t - t_m|) either way::

    V(q) = diag(sigma^2) + q^2 min(|t_i - t_m|, |t_j - t_m|)     for t_i, t_j on one side of t_m, else diagonal

For each q, generalised least squares gives theta(q) with covariance C(q), and the restricted likelihood says how well that q
explains what is left (REML [1]_)::

    -2 log L(q) = log|V| + log|X' V^-1 X| + r' V^-1 r

One session knows its q to a factor of two or so, and its offset and g-sensitivity hang on it. So no single q is taken: the
parameters are averaged over all of them, each weighted by L(q), and the covariance is that of the error over every q that L(q)
allows [2]_::

    theta = E1 theta(q)        covariance = E0 C(q) + E0 (theta(q) - theta)(theta(q) - theta)'

E0 takes every q from zero up for equally likely beforehand: nothing milder gives intervals that hold where the walk is too
small to show. E1 takes 1 / (q + q0), with q0 a walk that ends a tenth of one reading's noise off: where nothing wanders the
error of the offset is then 1.1 times what it would be if that were known, where E0 makes it 1.3 times. There the intervals
of the offset are too wide, since no session can rule a small walk out: drift costs uncertainty instead of hiding in it.

References
----------
.. [1] D. A. Harville, "Maximum likelihood approaches to variance component estimation and to related problems", 1977.
.. [2] A. Gelman, "Prior distributions for variance parameters in hierarchical models", 2006.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError, NotObservable
from undrift.model import MATRIX_NAMES, OFFSET_NAMES, TriadModel, Verdict

# ---- TriadFit: what every fit returns, and the linear algebra that the fits share.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadFit:
    """A fitted triad, its residuals, and what it is worth."""

    model: TriadModel  # The inverse model, with covariance, count, rank, condition and range
    residuals: FloatArray  # (E,), residual of each equation, unit_out
    verdict: Verdict  # In words


def inverse_jacobian(matrix: FloatArray) -> FloatArray:
    """Return d vec(M) / d vec(K) for M = K^-1, both stacked row by row.

    Arrays: matrix (3, 3) -> (9, 9).
    """
    return -np.kron(matrix, matrix.T)


def scaled_condition(design: FloatArray) -> tuple[int, float]:
    """Return rank and condition number of a design after scaling its columns to one.

    Arrays: design (E, P).
    """
    length = np.linalg.norm(design, axis=0)
    length[length == 0.0] = 1.0
    singular = np.linalg.svd(design / length, compute_uv=False)
    rank = int((singular > singular[0] * max(design.shape) * np.finfo(float).eps * 10.0).sum())
    return rank, float(singular[0] / singular[-1]) if rank == design.shape[1] else float("inf")


# ---- Excess variance: what the residuals show beyond the noise that was put in.


def excess_variance(residuals: FloatArray, variances: FloatArray, freedom: int) -> float:
    """Return the common variance to add so that residuals and variances agree.

    Arrays: residuals (E,), variances (E,).
    """
    square = residuals**2
    if freedom <= 0 or not square.any():
        return 0.0
    high = float(square.sum()) / freedom  # there the weighted sum is at most the degrees of freedom
    if (variances > 0.0).all() and float((square / variances).sum()) <= freedom:
        return 0.0
    excess = max(high - float(variances.mean()), 1e-9 * high)
    for _ in range(50):  # Newton's method on 1 / sum, which is nearly linear in s2
        weight = 1.0 / (variances + excess)
        total = float((square * weight).sum())
        step = (total * total / freedom - total) / float((square * weight * weight).sum())
        before, excess = excess, min(max(excess + step, 0.01 * excess), high)
        if abs(excess - before) <= 1e-9 * high:
            break
    return excess


# ---- Noise of a mean reading, told by the scatter of short block means within the windows.

BLOCK_S = 0.5  # means of this length count as independent of each other
_LEAST_SPARE = 6  # fewer spare blocks than this say nothing


def noise_of_means(windows: Sequence[FloatArray], sizes: Sequence[int], removed: int = 1) -> FloatArray | None:
    """Return the standard deviation of the mean of each window.

    Arrays: windows (N, 3) -> (P, 3).
    """
    square, spare = np.zeros(3), 0
    for values, size in zip(windows, sizes, strict=True):
        count = len(values) // size
        if count > removed:
            means = values[: count * size].reshape(count, size, 3).mean(axis=1)
            square += ((means - means.mean(axis=0)) ** 2).sum(axis=0)
            spare += count - removed
    if spare < _LEAST_SPARE:
        return None
    share = np.array([size / max(1, len(values)) for values, size in zip(windows, sizes, strict=True)])
    return np.asarray(np.sqrt(square / spare * share[:, None]))


def block_size(sample_rate_hz: float) -> int:
    """Return the samples in one block."""
    return max(1, round(BLOCK_S * sample_rate_hz))


# ---- Least squares of readings whose offset wanders while they are taken.

_LEAST_SPARE_WANDERING = 4  # with fewer, the average over q has no finite variance
_SPREADS = (0.02, 1e6, 180)  # q sqrt(half the session) in units of the median sigma: steps of a tenth
_QUIET = 0.1  # q0, in the same unit
_EVIDENCE = 3.84  # 95 %: chi-square of one degree of freedom


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wandering:
    """One sensor's solution."""

    theta: FloatArray  # (P,), parameters
    covariance: FloatArray  # (P, P), of them
    walk: float  # Most likely q, reading per square root of a second; 0 where it is not told from none
    square: float  # r' V^-1 r at the most likely q; E - P is expected


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Solutions:
    """Solutions for T values of q: theta (T, P), covariance (T, P, P), square (T,), and log L (T,)."""

    theta: FloatArray
    covariance: FloatArray
    square: FloatArray
    likelihood: FloatArray


def fit_wandering(design: FloatArray, reading: FloatArray, sigma: FloatArray, time: FloatArray | None) -> Wandering:
    """Solve for the parameters of one sensor and how its offset wandered.

    Arrays: design (E, P), reading (E,), sigma (E,), time (E,) s.
    """
    x, y = design / sigma[:, None], reading / sigma
    if time is None or len(reading) < design.shape[1] + _LEAST_SPARE_WANDERING:
        only = _solved(x, y, np.zeros(len(y)), np.zeros(1))
        return Wandering(theta=only.theta[0], covariance=only.covariance[0], walk=0.0, square=float(only.square[0]))
    away = time - 0.5 * (time.min() + time.max())
    half = max(float(np.abs(away).max()), 1e-9)
    unit = float(np.median(sigma)) / half**0.5
    same = np.sign(away)[:, None] == np.sign(away)[None, :]
    shape = np.where(same, np.minimum(np.abs(away)[:, None], np.abs(away)[None, :]), 0.0)
    gain, basis = np.linalg.eigh(
        shape * unit**2 / np.outer(sigma, sigma)
    )  # V(q) is diagonal in this basis, for every q
    spread = np.concatenate(([0.0], np.geomspace(*_SPREADS)))
    solutions = _solved(basis.T @ x, basis.T @ y, gain.clip(0.0), spread)
    return _averaged(solutions, spread, unit)


def _solved(x: FloatArray, y: FloatArray, gain: FloatArray, spread: FloatArray) -> _Solutions:
    # Uncorrelated readings of variance 1 + gain spread^2, solved for every spread at once.
    length = np.linalg.norm(x, axis=0)
    x = x / length
    weight = 1.0 / (1.0 + spread[:, None] ** 2 * gain)
    normal = (weight[:, None, :] * x.T) @ x
    inverse = np.linalg.inv(normal)
    start = np.linalg.lstsq(x, y, rcond=None)[
        0
    ]  # what is left of y is small, so that rounding in the normal equations is too
    left = y - x @ start
    step = (inverse @ ((weight * left) @ x)[:, :, None])[:, :, 0]
    square = (weight * (left - step @ x.T) ** 2).sum(axis=1)
    return _Solutions(
        theta=(start + step) / length,
        covariance=inverse / np.outer(length, length),
        square=square,
        likelihood=0.5 * (np.log(weight).sum(axis=1) - np.linalg.slogdet(normal)[1] - square),
    )


def _averaged(solutions: _Solutions, spread: FloatArray, unit: float) -> Wandering:
    best = int(np.argmax(solutions.likelihood))
    shows = 2.0 * (solutions.likelihood[best] - solutions.likelihood[0]) > _EVIDENCE
    step = np.gradient(spread)
    step[[0, -1]] *= 0.5  # trapezoids
    share = np.exp(solutions.likelihood - solutions.likelihood[best]) * step
    likely = share / (spread + _QUIET)
    share, likely = share / share.sum(), likely / likely.sum()
    theta = likely @ solutions.theta
    apart = solutions.theta - theta
    return Wandering(
        theta=theta,
        covariance=np.einsum("t,tij->ij", share, solutions.covariance) + (share[:, None] * apart).T @ apart,
        walk=unit * _peak(spread, solutions.likelihood, best) if shows else 0.0,
        square=float(solutions.square[best]),
    )


def _peak(spread: FloatArray, likelihood: FloatArray, best: int) -> float:
    if best < 2 or best == len(spread) - 1:
        return float(spread[best])
    left, middle, right = likelihood[best - 1 : best + 2]
    bend = left - 2.0 * middle + right  # parabola through three points of a geometric grid
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(spread[best] * (spread[best + 1] / spread[best]) ** np.clip(shift, -1.0, 1.0))


# ---- Parameters in the words of a laboratory: m_xx is the scale of x, m_xy a cross-axis term, offset_y the offset of y.


def in_words(names: Sequence[str]) -> str:
    """Return names of parameters in words, those of one kind together."""
    ends = [(name.partition("_")[0], name.rpartition("_")[2]) for name in names]
    scales = [end[0] for head, end in ends if head == "m" and end[0] == end[-1]]
    crossed = [end for head, end in ends if head == "m" and end[0] != end[-1]]
    offsets = [end for head, end in ends if head == "offset"]
    parts = (
        f"scale of {_listed(scales)}" if scales else "",
        f"cross-axis term{'s' * (len(crossed) > 1)} {_listed(crossed)}" if crossed else "",
        f"offset of {_listed(offsets)}" if offsets else "",
    )
    return ", ".join(part for part in parts if part)


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


# ---- least squares


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForwardFit:
    """Forward model of a triad by least squares."""

    matrix: FloatArray  # (3, 3), K, reading per input
    offset: FloatArray  # (3,), b, reading
    covariance: FloatArray  # (12, 12), of K row by row, then b
    residuals: FloatArray  # (E, 3), reading less model
    rank: int  # Of the design with columns scaled to one
    condition: float  # Of the design with columns scaled to one


def fit_forward(inputs: FloatArray, readings: FloatArray, sigma: FloatArray | None) -> ForwardFit:
    """Fit K and b to readings of known inputs.

    Arrays: inputs (E, 3), readings (E, 3), sigma (E, 3).
    """
    if inputs.shape != readings.shape or inputs.ndim != 2 or inputs.shape[1] != 3:
        raise InputError(f"fit: wanted inputs and readings (E, 3), got {inputs.shape} and {readings.shape}")
    design = np.column_stack((inputs, np.ones(len(inputs))))
    rank, condition = scaled_condition(design)
    if rank < 4:
        raise NotObservable(
            f"fit: wanted inputs that span three axes and an offset (rank 4), got rank {rank} from {len(inputs)} equations; "
            "record the axes or signs that are missing",
            rank=rank,
        )
    spread = np.ones_like(readings) if sigma is None else np.broadcast_to(sigma, readings.shape)
    spread = np.maximum(spread, 1e-9 * np.abs(readings).max())  # a channel without any scatter still has a last digit
    theta = np.empty((3, 4))
    covariance = np.zeros((12, 12))
    for row in range(3):
        weighted = design / spread[:, row, None]
        theta[row] = np.linalg.lstsq(weighted, readings[:, row] / spread[:, row], rcond=None)[0]
        covariance[np.ix_(_places(row), _places(row))] = np.linalg.inv(weighted.T @ weighted)
    residuals = readings - design @ theta.T
    if sigma is None:
        scale = np.repeat([student_variance(residuals[:, row], len(inputs) - 4) for row in range(3)], 4)
        order = np.concatenate([_places(row) for row in range(3)])
        covariance[np.ix_(order, order)] *= scale[:, None]
    return ForwardFit(
        matrix=theta[:, :3],
        offset=theta[:, 3],
        covariance=covariance,
        residuals=residuals,
        rank=3 * rank,
        condition=condition,
    )


def student_variance(residuals: FloatArray, spare: int) -> float:
    """Return the residual variance widened for its own uncertainty."""
    return float((residuals**2).sum() / (spare - 2)) if spare > 2 else float("nan")


def triad_from_forward(
    forward: ForwardFit, *, method: str, unit_in: str, unit_out: str, valid_range: tuple[float, float], verdict: Verdict
) -> TriadFit:
    """Turn a forward fit into the inverse model that corrects readings."""
    matrix = np.linalg.inv(forward.matrix)
    jacobian = np.eye(12)
    jacobian[:9, :9] = inverse_jacobian(matrix)
    residuals = forward.residuals @ matrix.T
    model = TriadModel(
        method=method,
        unit_in=unit_in,
        unit_out=unit_out,
        matrix=matrix,
        offset=forward.offset,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES),
        covariance=jacobian @ forward.covariance @ jacobian.T,
        rms_residual=float(np.sqrt((residuals**2).mean())),
        count=residuals.size,
        rank=forward.rank,
        condition=forward.condition,
        valid_range=valid_range,
    )
    return TriadFit(model=model, residuals=residuals, verdict=verdict)


def fit_paper(
    inputs: FloatArray, readings: FloatArray, sigma: FloatArray | None, *, method: str, unit_in: str, unit_out: str
) -> TriadFit:
    """Fit the note's calibration matrix, which has no offset column.

    C = L S^T (S S^T)^-1 with L (3, N) the imposed and S (3, N) the measured quantities [1]_, eqs. 3 and 6. To first order in
    the noise of S its covariance is (C V C^T) (x) (S S^T)^-1, V the variance of one reading.

    References
    ----------
    .. [1] D. Giansanti et al., "Guidelines for calibration and drift compensation of a wearable device with rate-gyroscopes
       and accelerometers", 2007.

    Arrays: inputs (N, 3), readings (N, 3), sigma (N, 3).
    """
    rank, condition = scaled_condition(readings)
    if rank < 3:
        raise NotObservable(
            f"fit: wanted readings that span three axes, got rank {rank} from {len(readings)} columns; record the missing axes",
            rank=rank,
        )
    gram = np.linalg.inv(readings.T @ readings)
    matrix = inputs.T @ readings @ gram  # eq. 3, eq. 6
    residuals = readings @ matrix.T - inputs
    if sigma is None:
        noise = np.eye(3) * student_variance(residuals, residuals.size - 9)
    else:
        noise = matrix @ np.diag((np.broadcast_to(sigma, readings.shape) ** 2).mean(axis=0)) @ matrix.T
    covariance = np.zeros((12, 12))
    covariance[:9, :9] = np.kron(noise, gram)
    model = TriadModel(
        method=method,
        unit_in=unit_in,
        unit_out=unit_out,
        matrix=matrix,
        offset=np.zeros(3),
        covariance=covariance,
        rms_residual=float(np.sqrt((residuals**2).mean())),
        count=residuals.size,
        rank=3 * rank,
        condition=condition,
        valid_range=(float(inputs.min()), float(inputs.max())),
    )
    return TriadFit(model=model, residuals=residuals, verdict=Verdict())


def offset_warning(fit: TriadFit, inputs: FloatArray, readings: FloatArray, sigma: FloatArray | None) -> Verdict:
    """Say what an offset that was left in the readings costs a matrix fitted without offset column.

    With an offset b' in units of the measurand, C = (I + k b' b'^T)^-1 K^-1, k = N / sigma and sigma the sum of squared inputs on
    one axis: the gain along b' shrinks by k b'^2 / (1 + k b'^2).

    Arrays: inputs (N, 3), readings (N, 3), sigma (N, 3).
    """
    forward = fit_forward(inputs, readings, sigma)
    left = np.linalg.solve(forward.matrix, forward.offset)
    uncertain = np.sqrt(np.diag(forward.covariance)[9:])
    if not (np.abs(forward.offset) > 4.0 * np.nan_to_num(uncertain)).any():
        return Verdict()
    k = len(inputs) / float((inputs**2).sum(axis=0).mean())
    share = k * float(left @ left)
    loss = share / (1.0 + share)
    unit = fit.model.unit_out
    values = ", ".join(f"{v:.4g}" for v in left)
    return Verdict(
        status="bad" if loss > 0.01 else "marginal" if loss > 1e-4 else "good",
        remarks=(
            f"mode paper has no offset column and an offset of ({values}) {unit} is left in the readings: the gain along it is "
            f"{100 * loss:.2g} % too small; remove the offset first, or use mode affine",
        ),
    )


def _places(row: int) -> IntArray:
    return np.array([3 * row, 3 * row + 1, 3 * row + 2, 9 + row], dtype=np.int64)
