"""What the fits share: weighted least squares of s = K a + b, its covariance, excess variance, and drifting offsets.

Each sensor is a row of its own, with the standard deviation of every equation given; i = x, y, z::

    minimise  sum_p ((s_pi - K_i . a_p - b_i) / sigma_pi)^2
    a = M (s - o)        M = K^-1, o = b;   dM = -M dK M,   do = db

Where sigma is not known it is estimated from the residuals, and the covariance is widened by v / (v - 2), v the spare
equations: the variance of Student's t, so that 95 % intervals of 1.96 standard uncertainties still hold (JCGM 101, 6.4.9).
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError, NotObservable
from undrift.findings import Level, finding
from undrift.model import TriadModel, Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadFit:
    """A fitted triad, its residuals, and what it is worth."""

    model: TriadModel  # The inverse model, with covariance, count, rank, condition and range
    residuals: FloatArray  # (E,), residual of each equation, unit_out
    verdict: Verdict


@contextmanager
def determined(what: str) -> Iterator[None]:
    """Turn equations without a solution into one line: the readings do not determine what was asked for."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise NotObservable(
            f"{what}: wanted readings that determine it, got equations without a solution ({error}); record more temperatures, "
            "and check that no axis repeats one reading"
        ) from error


def triad_fit(residuals: FloatArray, verdict: Verdict = Verdict(), **of_model: Any) -> TriadFit:
    """Return a fit by its residuals (E,), unit_out, its verdict, and the fields of its TriadModel that these do not give."""
    rms = float(np.sqrt((residuals**2).mean()))
    return TriadFit(
        model=TriadModel(rms_residual=rms, count=residuals.size, **of_model), residuals=residuals, verdict=verdict
    )


def inverse_jacobian(matrix: FloatArray) -> FloatArray:
    """Return d vec(M) / d vec(K) (9, 9) for M = K^-1, both stacked row by row."""
    return -np.kron(matrix, matrix.T)


def scaled_condition(design: FloatArray) -> tuple[int, float]:
    """Return rank and condition number of a design (E, P) whose columns were scaled to one."""
    length = np.linalg.norm(design, axis=0)
    length[length == 0.0] = 1.0
    singular = np.linalg.svd(design / length, compute_uv=False)
    rank = int((singular > singular[0] * max(design.shape) * np.finfo(float).eps * 10.0).sum())
    return rank, float(singular[0] / singular[-1]) if rank == design.shape[1] else float("inf")


# ---- excess variance: what the residuals show beyond the stated noise


def excess_variance(residuals: FloatArray, variances: FloatArray, freedom: float) -> float:
    """Return s2 >= 0 such that sum r_k^2 / (v_k + s2) = degrees of freedom, for residuals r and variances v (E,).

    The stated variances know the noise within a rest. A hand that sways, a table that is not quite still or a nonlinearity
    moves whole poses and shows in the residuals alone (Paule and Mandel, "Consensus values and weighting factors", 1982).
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


# ---- groups of parameters that scatter about 0 by an unknown size: the data give size and parameters
#
#     y = X theta + n,  n white of variance 1     theta_g ~ N(0, v_g) for each group g, the others by a precision given
#     maximise over v    2 log p(y | v) = c' theta - log|X'X + P| + log|P|        c = X'y, P = diag(1 / v_g)
#     v_g <- |theta_g|^2 / gamma_g     gamma_g = n_g - tr(C_g) / v_g,  C = (X'X + P)^-1     (MacKay, "Bayesian interpolation", 1992)
#
# A group leaves its least size, 0 for none of it, only where chance makes such a gain of likelihood once in a thousand.

GROUP_SHOWS = 9.55  # of 2 log p: chi-square of one degree of freedom on the boundary, chance 1e-3
_STEPS = 20  # of v, unless it stops before


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Components:
    """Parameters of all groups."""

    theta: FloatArray  # (P,)
    covariance: FloatArray  # (P, P)
    variance: FloatArray  # (G,), v of each group
    likelihood: float  # log p(y | v), to a constant


def fit_components(
    normal: FloatArray,
    moment: FloatArray,
    precision: FloatArray,
    groups: Sequence[IntArray],
    least: FloatArray,
    first: float,
) -> Components:
    """Fit X'X (P, P) and X'y (P,); groups of places start at the variance ``first`` and never go below ``least`` (G,)."""
    chosen: set[int] = set()
    best = _at_sizes(normal, moment, precision, groups, least)
    while len(chosen) < len(groups):
        tries = []
        for number in set(range(len(groups))) - chosen:
            free = [*chosen, number]
            variance = best.variance.copy()
            variance[number] = max(first, least[number])
            tries.append((number, _climbed(normal, moment, precision, groups, (variance, least), free)))
        number, made = max(tries, key=lambda one: one[1].likelihood)
        if 2.0 * (made.likelihood - best.likelihood) < GROUP_SHOWS:
            break
        chosen.add(number)
        best = made
    return best


def _climbed(
    normal: FloatArray,
    moment: FloatArray,
    precision: FloatArray,
    groups: Sequence[IntArray],
    sizes: tuple[FloatArray, FloatArray],
    free: Sequence[int],
) -> Components:
    variance, least = sizes
    made = _at_sizes(normal, moment, precision, groups, variance)
    for _ in range(_STEPS):
        before = variance.copy()
        for number in free:
            own = groups[number]
            left = len(own) - float(made.covariance[own, own].sum()) / max(float(made.variance[number]), 1e-300)
            size = float(made.theta[own] @ made.theta[own]) / max(left, 1e-3 * len(own))
            variance[number] = max(size, least[number], 1e-6 * float(made.variance[number]))
        made = _at_sizes(normal, moment, precision, groups, variance)
        if (np.abs(variance - before) <= 1e-3 * before).all():
            break
    return made


def _at_sizes(
    normal: FloatArray, moment: FloatArray, precision: FloatArray, groups: Sequence[IntArray], variance: FloatArray
) -> Components:
    prior, on, logs = precision.copy(), np.ones(len(moment), bool), 0.0
    for own, size in zip(groups, variance, strict=True):
        on[own] = size > 0.0
        if size > 0.0:
            prior[own] = 1.0 / size
            logs -= len(own) * float(np.log(size))
    theta, covariance = np.zeros(len(moment)), np.zeros_like(normal)
    whole = normal[np.ix_(on, on)] + np.diag(prior[on])
    covariance[np.ix_(on, on)] = np.linalg.inv(whole) if on.any() else 0.0
    theta[on] = covariance[np.ix_(on, on)] @ moment[on]
    likelihood = 0.5 * (float(moment @ theta) - float(np.linalg.slogdet(whole)[1]) + logs)
    return Components(theta=theta, covariance=covariance, variance=variance.copy(), likelihood=likelihood)


# ---- noise of a mean reading, from the scatter of short block means within the windows

BLOCK_S = 0.5  # means of this length count as independent of each other
_LEAST_SPARE_BLOCKS = 6  # with fewer, the estimate is too uncertain to use


def noise_of_means(windows: Sequence[FloatArray], sizes: Sequence[int], removed: int = 1) -> FloatArray | None:
    """Return the standard deviation (P, 3) of the mean of each window (N, 3); None where there are too few blocks."""
    square, spare = np.zeros(3), 0
    for values, size in zip(windows, sizes, strict=True):
        count = len(values) // size
        if count > removed:
            means = values[: count * size].reshape(count, size, 3).mean(axis=1)
            square += ((means - means.mean(axis=0)) ** 2).sum(axis=0)
            spare += count - removed
    if spare < _LEAST_SPARE_BLOCKS:
        return None
    share = np.array([size / max(1, len(values)) for values, size in zip(windows, sizes, strict=True)])
    return np.asarray(np.sqrt(square / spare * share[:, None]))


def block_size(sample_rate_hz: float) -> int:
    """Return the samples in one block."""
    return max(1, round(BLOCK_S * sample_rate_hz))


# ---- offsets that drift: least squares with a random walk of unknown size
#
# Readings at times t follow X theta + b(t) + n: n white with known standard deviations, b a random walk that is zero in the
# middle t_m of the session and spreads by q sqrt(|t - t_m|) either way:
#
#     V(q) = diag(sigma^2) + q^2 min(|t_i - t_m|, |t_j - t_m|)     t_i, t_j on one side of t_m, else diagonal
#     -2 log L(q) = log|V| + log|X' V^-1 X| + r' V^-1 r            restricted likelihood (Harville 1977)
#
# One session knows its q to a factor of two or so, and its offset and g-sensitivity depend on it. So no single q is taken: the
# parameters are averaged over all, weighted by L(q), and the covariance is that of the error over every q (Gelman 2006):
#
#     theta = E1 theta(q)        covariance = E0 C(q) + E0 (theta(q) - theta)(theta(q) - theta)'
#
# E0 takes every q >= 0 as equally likely beforehand: nothing milder gives intervals that hold where the walk is too small to
# show. E1 takes 1 / (q + q0), with q0 a walk that ends a tenth of one reading's noise off: without drift the error of the
# offset is then 1.1 times the least possible, where E0 makes it 1.3 times.

_LEAST_SPARE_EQUATIONS = 4  # with fewer, the average over q has no finite variance
_SPREADS = (0.02, 1e6, 180)  # q sqrt(half the session) in units of the median sigma: steps of a tenth
_SMALL_WALK = 0.1  # q0, in the same unit
_EVIDENCE = 3.84  # 95 %: chi-square of one degree of freedom


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WalkFit:
    """One sensor's parameters and the random walk of its offset."""

    theta: FloatArray  # (P,)
    covariance: FloatArray  # (P, P)
    walk: float  # most likely q, reading per root second; 0 where it is not significant
    square: float  # r' V^-1 r at the most likely q; E - P is expected


def fit_with_walk(design: FloatArray, reading: FloatArray, sigma: FloatArray, time: FloatArray | None) -> WalkFit:
    """Fit one sensor whose offset may drift: design (E, P), reading, sigma and time (E,); no walk without times."""
    x, y = design / sigma[:, None], reading / sigma
    if time is None or len(reading) < design.shape[1] + _LEAST_SPARE_EQUATIONS:
        theta, covariance, square, _ = _solved(x, y, np.zeros(len(y)), np.zeros(1))
        return WalkFit(theta=theta[0], covariance=covariance[0], walk=0.0, square=float(square[0]))
    away = time - 0.5 * (time.min() + time.max())
    half = max(float(np.abs(away).max()), 1e-9)
    unit = float(np.median(sigma)) / half**0.5
    same = np.sign(away)[:, None] == np.sign(away)[None, :]
    shape = np.where(same, np.minimum(np.abs(away)[:, None], np.abs(away)[None, :]), 0.0)
    gain, basis = np.linalg.eigh(shape * unit**2 / np.outer(sigma, sigma))  # V(q) is diagonal in this basis for every q
    spread = np.concatenate(([0.0], np.geomspace(*_SPREADS)))
    thetas, covariances, squares, likelihood = _solved(basis.T @ x, basis.T @ y, gain.clip(0.0), spread)
    best = int(np.argmax(likelihood))
    shows = 2.0 * (likelihood[best] - likelihood[0]) > _EVIDENCE
    theta, covariance = averaged(spread, likelihood, thetas, covariances, (1.0, spread + _SMALL_WALK))
    walk = unit * (float(spread[best]) if best < 2 else geometric_peak(spread, likelihood, best)) if shows else 0.0
    return WalkFit(theta=theta, covariance=covariance, walk=walk, square=float(squares[best]))


def averaged(
    grid: FloatArray,
    likelihood: FloatArray,
    thetas: FloatArray,
    covariances: FloatArray,
    over: tuple[FloatArray | float, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return theta and covariance averaged over a grid (T,): E0 weighs by the likelihood over the first of two, E1 the second."""
    step = np.gradient(grid)
    step[[0, -1]] *= 0.5  # trapezoids
    by_likelihood = np.exp(likelihood - likelihood.max()) * step
    share, likely = (part / part.sum() for part in (by_likelihood / over[0], by_likelihood / over[1]))
    theta = likely @ thetas
    apart = thetas - theta
    return theta, np.einsum("t,tij->ij", share, covariances) + (share[:, None] * apart).T @ apart


def _solved(
    x: FloatArray, y: FloatArray, gain: FloatArray, spread: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return theta (T, P), covariance, r' V^-1 r and log L for T spreads: uncorrelated, variance 1 + gain spread^2."""
    length = np.linalg.norm(x, axis=0)
    x = x / length
    weight = 1.0 / (1.0 + spread[:, None] ** 2 * gain)
    normal = (weight[:, None, :] * x.T) @ x
    inverse = np.linalg.inv(normal)
    start = np.linalg.lstsq(x, y, rcond=None)[0]  # the rest of y is small, and so is rounding in the normal equations
    left = y - x @ start
    step = (inverse @ ((weight * left) @ x)[:, :, None])[:, :, 0]
    square = (weight * (left - step @ x.T) ** 2).sum(axis=1)
    likelihood = 0.5 * (np.log(weight).sum(axis=1) - np.linalg.slogdet(normal)[1] - square)
    return (start + step) / length, inverse / np.outer(length, length), square, likelihood


def geometric_peak(grid: FloatArray, likelihood: FloatArray, best: int) -> float:
    """Return where a parabola through the best point of a geometric grid and its neighbours is highest."""
    if best == len(grid) - 1:
        return float(grid[best])
    left, middle, right = likelihood[best - 1 : best + 2]
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(grid[best] * (grid[best + 1] / grid[best]) ** np.clip(shift, -1.0, 1.0))


# ---- names of parameters: m_xx is the scale of x, m_xy a cross-axis term, offset_y the offset of y


def parameter_names(names: Sequence[str]) -> str:
    """Return names of parameters as a laboratory says them, those of one kind together."""
    ends = [(name.partition("_")[0], name.rpartition("_")[2]) for name in names]
    scales = [end[0] for head, end in ends if head == "m" and end[0] == end[-1]]
    crossed = [end for head, end in ends if head == "m" and end[0] != end[-1]]
    offsets = [end for head, end in ends if head == "offset"]
    kinds = (("scale of", scales), (f"cross-axis term{'s' * (len(crossed) > 1)}", crossed), ("offset of", offsets))
    return ", ".join(
        f"{kind} {' and '.join((', '.join(of[:-1]), of[-1])).removeprefix(' and ')}" for kind, of in kinds if of
    )


# ---- forward model s = K a + b


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForwardFit:
    """Forward model of a triad by least squares."""

    matrix: FloatArray  # (3, 3), K, reading per input
    offset: FloatArray  # (3,), b, reading
    covariance: FloatArray  # (12, 12), of K row by row, then b
    residuals: FloatArray  # (E, 3), reading less model
    rank: int  # Of the design with columns scaled to one
    condition: float


def whitened(values: FloatArray, sigma: FloatArray, shared: FloatArray | None) -> FloatArray:
    """Return values (E, k) in standard deviations: noise sigma (E,), and errors in common, columns (E, c) of one deviation each."""
    scaled = values / sigma[:, None]
    if shared is None:
        return scaled
    in_sigma = shared / sigma[:, None]
    return np.linalg.solve(np.linalg.cholesky(np.eye(len(scaled)) + in_sigma @ in_sigma.T), scaled)


def fit_forward(
    inputs: FloatArray, readings: FloatArray, sigma: FloatArray | None, shared: FloatArray | None = None
) -> ForwardFit:
    """Fit K and b to readings (E, 3) of known inputs (E, 3) with standard deviations sigma (E, 3), where known.

    ``shared`` (3, E, c) are errors that the readings of one sensor have in common, columns of one standard deviation each.
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
        in_common = None if shared is None or sigma is None else shared[row]
        both = whitened(np.column_stack((design, readings[:, row])), spread[:, row], in_common)
        weighted = both[:, :4]
        theta[row] = np.linalg.lstsq(weighted, both[:, 4], rcond=None)[0]
        covariance[_block(row)] = np.linalg.inv(weighted.T @ weighted)
    residuals = readings - design @ theta.T
    for row in range(3) if sigma is None else ():
        covariance[_block(row)] *= student_variance(residuals[:, row], len(inputs) - 4)
        if shared is not None:
            moved = np.linalg.pinv(design) @ shared[row]
            covariance[_block(row)] += moved @ moved.T
    return ForwardFit(
        matrix=theta[:, :3],
        offset=theta[:, 3],
        covariance=covariance,
        residuals=residuals,
        rank=3 * rank,
        condition=condition,
    )


def student_variance(residuals: FloatArray, spare: int) -> float:
    """Return the residual variance, widened for its own uncertainty; NaN below three spare equations."""
    return float((residuals**2).sum() / (spare - 2)) if spare > 2 else float("nan")


def triad_from_forward(forward: ForwardFit, *, valid_range: tuple[float, float], **names: Any) -> TriadFit:
    """Turn a forward fit into the inverse model that corrects readings; names are method, unit_in and unit_out."""
    matrix = np.linalg.inv(forward.matrix)
    jacobian = np.eye(12)
    jacobian[:9, :9] = inverse_jacobian(matrix)
    return triad_fit(
        forward.residuals @ matrix.T,
        matrix=matrix,
        offset=forward.offset,
        covariance=jacobian @ forward.covariance @ jacobian.T,
        rank=forward.rank,
        condition=forward.condition,
        valid_range=valid_range,
        **names,
    )


def fit_paper(
    inputs: FloatArray,
    readings: FloatArray,
    sigma: FloatArray | None,
    shared: FloatArray | None = None,
    **names: Any,
) -> TriadFit:
    """Fit the note's calibration matrix, which has no offset column, to inputs and readings (N, 3).

    C = L S^T (S S^T)^-1 with L (3, N) the imposed and S (3, N) the measured quantities (note, eqs. 3 and 6). To first order in
    the noise of S its covariance is (C V C^T) (x) (S S^T)^-1, V the variance of one reading.
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
    for column, errors in zip(matrix.T, () if shared is None else shared, strict=False):
        moved = np.kron(column[:, None], (readings @ gram).T @ errors)  # dC = -C dS (S^T) (S S^T)^-1, row by row
        covariance[:9, :9] += moved @ moved.T
    return triad_fit(
        residuals,
        matrix=matrix,
        offset=np.zeros(3),
        covariance=covariance,
        rank=3 * rank,
        condition=condition,
        valid_range=(float(inputs.min()), float(inputs.max())),
        **names,
    )


def offset_verdict(fit: TriadFit, inputs: FloatArray, readings: FloatArray, sigma: FloatArray | None) -> Verdict:
    """Return what an offset left in the readings costs a matrix that was fitted without an offset column.

    With an offset b' in units of the measurand, C = (I + k b' b'^T)^-1 K^-1, k = N / sigma and sigma the sum of squared inputs on
    one axis: the gain along b' shrinks by k b'^2 / (1 + k b'^2).
    """
    forward = fit_forward(inputs, readings, sigma)
    uncertain = np.sqrt(np.diag(forward.covariance)[9:])
    if not (np.abs(forward.offset) > 4.0 * np.nan_to_num(uncertain)).any():
        return Verdict()
    left = np.linalg.solve(forward.matrix, forward.offset)
    share = len(inputs) / float((inputs**2).sum(axis=0).mean()) * float(left @ left)
    loss = share / (1.0 + share)
    level: Level = "fail" if loss > 0.01 else "warn" if loss > 1e-4 else "info"
    unit, percent = fit.model.unit_out, 100.0 * loss
    return Verdict.of(finding("paper_mode.offset_left", level, offset=left, unit=unit, loss_percent=percent))


def _block(row: int) -> tuple[IntArray, ...]:
    places = [3 * row, 3 * row + 1, 3 * row + 2, 9 + row]
    return np.ix_(places, places)
