"""Generalised least squares with known sources of error, excess variances from the residuals, and a budget.

    y = X theta + e                  E rows, P parameters
    cov(e) = V = sum_i S_i + sum_j s_j E_j
    theta = C (X' V^-1 y + K m)      C = (X' V^-1 X + K)^-1,   prior mean m and precision K

S_i are the known sources. E_j is the shape of an error of unknown size. For example, the tilt of a plate acts across gravity, and a
wobble of a rate table increases with the rate. Its variance s_j >= 0 maximises the restricted likelihood (Patterson and Thompson
1971), which equates the residuals with their expectation:

    r' V^-1 E_j V^-1 r = tr(P E_j)   P = V^-1 - V^-1 X C X' V^-1

A few residuals determine an excess variance only roughly. Its contribution to the covariance is therefore widened by the square of
Student's quantile over the normal quantile, for nu_j = tr(P E_j)^2 / tr(P E_j P E_j) degrees of freedom. An interval of 1.96
standard uncertainties then contains the true value in 95 % of cases.

For three sensors and known inputs (``solve_inverse``): M s - c - G a = f + e, with readings s, inputs f, and specific force a if
the sensors respond to it. If the readings were the columns of X, their errors would make M too small. Their projection s^ on the
known columns (f, a, 1) replaces them, and the current M multiplies the remainder:

    M s^ - c - G a = f - M (s - s^) + e

A prior of G applies to the g-sensitivity of the readings, H = M^-1 G. Otherwise, the prior would pull a scale without an input
towards zero. With M_0 and H of the previous step, it is a prior of G - (M - M_0) H.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import NotObservable

MAX_ITERATIONS, MOST_HALVINGS = 100, 12
FIRST_STEPS = 5  # number of steps for a single excess variance, enough to compare likelihoods
TOLERANCE = 1e-4  # step of the excess variances, in their standard errors, at which the iteration ends
ROUNDS, CONVERGED = 8, 0.01  # fit of the inverse model: rounds, and final change in standard deviations of a row
ROUNDING = 1e-11  # relative to a variance: a sum of covariances is positive definite only within rounding
RANK_OF_ROWS = 1e-14  # relative to the largest pivot: below this, a parameter is not determined
RANK = 1e-9  # limit relative to the largest singular value of known columns
SHOWN = 1e-6  # smallest share of a shape that must remain in the residuals
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prior:
    """Prior knowledge about the parameters."""

    mean: FloatArray  # (P,)
    precision: FloatArray  # (P, P), inverse covariance, with zero rows for parameters without a prior


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GlsFit:
    """Result of a generalised least-squares fit."""

    theta: FloatArray  # (P,)
    covariance: FloatArray  # (P, P)
    budget: Mapping[str, FloatArray]  # covariance (P, P) by source, which sums to ``covariance``
    excess: Mapping[str, float]  # excess variance s_j by its kind
    freedom: Mapping[str, float]  # degrees of freedom nu_j of each excess variance
    residuals: FloatArray  # (E,), y - X theta
    gains: FloatArray  # (P, E), d theta / d y
    sources: Mapping[str, FloatArray]  # covariance (E, E) of the rows by source, including its widened excess variance


@contextmanager
def determined(quantity: str) -> Iterator[None]:
    """Raise ``NotObservable`` instead of a ``LinAlgError``: the readings do not determine a quantity."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise NotObservable(
            f"{quantity}: the readings do not determine it ({error}). Record more temperatures, and check that no axis repeats a "
            f"single reading."
        ) from error


def student_factor(freedom: float) -> float:
    """Return (t / 1.96)^2 for the 97.5 % quantile t of Student's distribution, with at least one degree of freedom."""
    from scipy.special import stdtrit

    return float(stdtrit(max(freedom, 1.0), 0.975) / NORMAL_95) ** 2


def solve(
    design: FloatArray,
    value: FloatArray,
    sources: Mapping[str, FloatArray],
    *,
    excess: Mapping[str, FloatArray] | None = None,
    prior: Prior | None = None,
    start: Mapping[str, float] | None = None,
) -> GlsFit:
    """Fit theta to y = X theta + e for ``design`` X (E, P) and ``value`` y (E,).

    ``sources`` contains the known covariances S_i by name, and ``excess`` the shapes E_j of errors of unknown size. Each is a
    matrix (E, E) or its diagonal (E,). The sum of the sources must be positive definite. In the budget, an excess belongs to the
    source named by the first word of its kind. ``start`` contains initial values of the excess variances from a similar fit. Raise
    ``numpy.linalg.LinAlgError`` if rows and prior together do not determine theta.
    """
    length = np.linalg.norm(design, axis=0)
    length[length == 0.0] = 1.0
    parts = {name: _matrix(share) for name, share in sources.items()}
    shapes = dict(excess or {})
    rows = _GlsRows(
        design=design / length,
        value=value,
        prior=np.zeros((0, len(length))) if prior is None else _root(prior.precision / np.outer(length, length)),
        mean=np.zeros(len(length)) if prior is None else prior.mean * length,
        stated=np.sum([*parts.values()], axis=0),
        shapes=tuple(shapes.values()),
    )
    variances, state = _excess_variances(rows, None if start is None else np.array([start[kind] for kind in shapes]))
    products = [_times(state.projector, shape) for shape in rows.shapes]  # P E_j
    freedom = [float(np.trace(a) ** 2 / max(float((a * a.T).sum()), 1e-300)) for a in products]
    gains = state.gains / length[:, None]
    for (kind, shape), variance, nu in zip(shapes.items(), variances, freedom, strict=True):
        source = kind.partition(" ")[0]
        parts[source] = parts.get(source, 0.0) + variance * student_factor(nu) * _matrix(shape)
    budget = {name: carried(gains, share) for name, share in parts.items()}
    if prior is not None:
        covariance = state.covariance / np.outer(length, length)
        budget["prior"] = covariance @ prior.precision @ covariance
    return GlsFit(
        theta=state.theta / length,
        covariance=np.sum([*budget.values()], axis=0),
        budget=budget,
        excess=dict(zip(shapes, variances.tolist(), strict=True)),
        freedom=dict(zip(shapes, freedom, strict=True)),
        residuals=state.residuals,
        gains=gains,
        sources=parts,
    )


def solve_inverse(
    reading: FloatArray,
    value: FloatArray,
    force: FloatArray | None,
    matrix: FloatArray,
    sources: Mapping[str, FloatArray],
    *,
    excess: Mapping[str, FloatArray] | None = None,
    prior: Prior | None = None,
) -> GlsFit:
    """Fit M, c and G to readings (E, 3) of known inputs (E, 3), and of a specific force (E, 3), starting from ``matrix``.

    The parameters are M row by row, c, and G row by row. In ``prior``, G is independent of M and c. Sources and shapes describe the
    rows of the readings, 3 E in all.
    """
    count, forces = len(reading), [] if force is None else [force]
    # inputs along an axis with a prior are due to a small tilt of the others, and their noise would pull the scale towards zero
    turn_axes = np.full(3, True) if prior is None else np.diag(prior.precision)[:9:4] == 0.0
    columns = np.hstack([value[:, turn_axes], np.ones((count, 1)), *forces])
    left, singular, _ = np.linalg.svd(
        columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False
    )
    left = left[:, singular > RANK * singular[0]]
    smooth = left @ (left.T @ reading)
    blocks = [
        np.einsum("ij,ek->eijk", np.eye(3), term) for term in (smooth, -np.ones((count, 1)), *(-f for f in forces))
    ]
    design, remainder = np.hstack([block.reshape(3 * count, -1) for block in blocks]), reading - smooth
    smallest = float(np.sqrt(np.diag(np.sum([_matrix(term) for term in sources.values()], axis=0)).min()))
    known_g = force is not None and prior is not None
    slope: FloatArray = np.zeros((3, 3))  # H
    variances: Mapping[str, float] | None = None
    for number in range(ROUNDS):
        as_read = prior if prior is None or not known_g else _convert_prior(prior, matrix, slope)
        fit = solve(
            design, (value - remainder @ matrix.T).ravel(), sources, excess=excess, prior=as_read, start=variances
        )
        variances = fit.excess
        change, matrix = fit.theta[:9].reshape(3, 3) - matrix, fit.theta[:9].reshape(3, 3)
        if np.abs(remainder @ change.T).max() <= CONVERGED * smallest and not (known_g and number == 0):
            break
        if known_g:
            slope = np.linalg.solve(matrix, fit.theta[12:].reshape(3, 3))
    return fit


def _convert_prior(prior: Prior, matrix: FloatArray, slope: FloatArray) -> Prior:
    """Return the prior of M, c and G (21) with G - (M - M_0) H instead of G, for M_0 ``matrix`` and H ``slope``."""
    jacobian = np.eye(21)
    jacobian[12:, :9] = -np.kron(np.eye(3), slope.T)
    shift = np.append(np.zeros(12), matrix @ slope)
    mean = np.linalg.solve(jacobian, prior.mean - shift)
    return Prior(mean=mean, precision=jacobian.T @ prior.precision @ jacobian)


def _matrix(covariance: FloatArray) -> FloatArray:
    """Return a covariance (E, E), from the matrix or from its diagonal (E,)."""
    return np.diag(covariance) if covariance.ndim == 1 else covariance


def _root(precision: FloatArray) -> FloatArray:
    """Return R (P, P) with R' R = K."""
    variance, vectors = np.linalg.eigh(precision)
    return np.asarray((vectors * np.sqrt(variance.clip(0.0))).T)


def carried(gains: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the covariance (P, P) of the parameters for a covariance (E, E) of the rows."""
    return np.asarray(gains @ covariance @ gains.T)


# ---- solution for one covariance


def _times(matrix: FloatArray, shape: FloatArray) -> FloatArray:
    """Return the product of a matrix (., E) and a shape (E, E), or the diagonal (E,) of a shape."""
    return np.asarray(matrix * shape if shape.ndim == 1 else matrix @ shape)


@dataclass(frozen=True, kw_only=True, eq=False)
class _State:
    theta: FloatArray  # (P,), of the scaled columns
    residuals: FloatArray  # (E,)
    deviance: float  # -2 log of the restricted likelihood, up to a constant
    root: FloatArray  # (E, E), L^-1
    orthonormal: FloatArray  # (E, P), Q without the rows of the prior
    inverse_triangle: FloatArray  # (P, P), T^-1
    white_residuals: FloatArray  # (E,), L^-1 r

    @property
    def covariance(self) -> FloatArray:
        """C, (P, P)."""
        return np.asarray(self.inverse_triangle @ self.inverse_triangle.T)

    @property
    def gains(self) -> FloatArray:
        """C X' V^-1, (P, E)."""
        return np.asarray(self.inverse_triangle @ self.orthonormal.T @ self.root)

    @cached_property
    def weighted(self) -> FloatArray:
        """V^-1 r, (E,)."""
        return np.asarray(self.white_residuals @ self.root)

    @cached_property
    def inverse(self) -> FloatArray:
        """V^-1, (E, E)."""
        return np.asarray(self.root.T @ self.root)

    @cached_property
    def projector(self) -> FloatArray:
        """P, (E, E)."""
        weighted_design = self.root.T @ self.orthonormal
        return np.asarray(self.inverse - weighted_design @ weighted_design.T)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _GlsRows:
    design: FloatArray  # (E, P), columns of length one
    value: FloatArray  # (E,)
    prior: FloatArray  # (., P), R with R' R = K
    mean: FloatArray  # (P,), m
    stated: FloatArray  # (E, E), sum of S_i
    shapes: tuple[FloatArray, ...]  # E_j, (E, E) or its diagonal (E,)

    def solve(self, variances: FloatArray) -> _State:
        """Return the solution for excess variances (J,), from V = L L' and the factorisation L^-1 X (with the prior) = Q T.

        Then C = T^-1 T'^-1, and P = V^-1 - B B' with B = L'^-1 Q. The condition of X is not squared.
        """
        from scipy.linalg.lapack import dtrtri

        excess = [variance * _matrix(shape) for variance, shape in zip(variances, self.shapes, strict=True) if variance]
        covariance = self.stated + sum(excess, np.zeros_like(self.stated))
        # noise may be smaller than the rounding error of a common source, so that the sum is singular
        factor = np.linalg.cholesky(covariance + np.diag(ROUNDING * np.diag(covariance)))
        root = np.asarray(dtrtri(factor, lower=1)[0])
        orthonormal, triangle = np.linalg.qr(np.vstack((root @ self.design, self.prior)))
        pivots = np.abs(np.diag(triangle))
        if not pivots.min() > RANK_OF_ROWS * pivots.max():
            raise np.linalg.LinAlgError("rows and prior do not determine all parameters")
        observations = np.concatenate((root @ self.value, self.prior @ self.mean))
        inverse_triangle, projection = np.linalg.inv(triangle), orthonormal.T @ observations
        theta, remainder = inverse_triangle @ projection, observations - orthonormal @ projection
        return _State(
            theta=theta,
            residuals=self.value - self.design @ theta,
            deviance=2.0 * float(np.log(np.diag(factor)).sum() + np.log(pivots).sum()) + float(remainder @ remainder),
            root=root,
            orthonormal=orthonormal[: len(root)],
            inverse_triangle=inverse_triangle,
            white_residuals=remainder[: len(root)],
        )


# ---- excess variances by restricted likelihood: Fisher scoring, bounded at zero
#
# The score of variances s is g_j = r' V^-1 E_j V^-1 r - tr(P E_j), the information is I_jk = tr(P E_j P E_k). A step leads to
#
#     s+ = argmin_{x >= 0} (x - s)' I (x - s) / 2 - g' (x - s)
#
# as long as the likelihood increases. Otherwise, two similar shapes would exchange their variances endlessly. The
# likelihood may have several maxima, so the ascent begins with the kind that has the largest likelihood without the others.


def _excess_variances(rows: _GlsRows, first: FloatArray | None) -> tuple[FloatArray, _State]:
    """Return the variance s_j >= 0 of each shape, and the solution for them. Start from ``first`` (J,), if it is given."""
    zero: FloatArray = np.zeros(len(rows.shapes))
    start = zero, rows.solve(zero)
    # a shape that the parameters absorb does not appear in the residuals, and its variance stays zero
    shares = [
        [np.trace(_times(matrix, shape)) for matrix in (start[1].projector, start[1].inverse)] for shape in rows.shapes
    ]
    observable = np.array([k for k, (residual, total) in enumerate(shares) if residual > SHOWN * total], int)
    if first is not None:
        start = first, rows.solve(first)
    elif len(observable) > 1:
        candidates = (_climb(rows, *start, observable[[n]], FIRST_STEPS) for n in range(len(observable)))
        start = min(candidates, key=lambda found: found[1].deviance)
    return _climb(rows, *start, observable, MAX_ITERATIONS)


def _climb(
    rows: _GlsRows, variances: FloatArray, state: _State, free: IntArray, steps: int
) -> tuple[FloatArray, _State]:
    """Improve the variances of the free shapes with at most ``steps`` steps of Fisher scoring. Return variances and solution."""
    for _ in range(steps if len(free) else 0):
        products = [_times(state.projector, rows.shapes[k]) for k in free]
        square = [_times(state.weighted, rows.shapes[k]) @ state.weighted for k in free]
        score = np.array(square) - [np.trace(product) for product in products]
        information = np.array([[(first * second.T).sum() for second in products] for first in products])
        step = np.zeros(len(variances))
        step[free] = _bounded_step(variances[free], score, information)
        if score @ step[free] <= 2.0 * TOLERANCE**2:
            break
        for halvings in range(MOST_HALVINGS):
            ahead = variances + 0.5**halvings * step
            if (reached := rows.solve(ahead)).deviance < state.deviance:
                break
        else:
            break  # the increase of the likelihood is below its rounding error
        variances, state = ahead, reached
    return variances, state


def _bounded_step(variances: FloatArray, score: FloatArray, information: FloatArray) -> FloatArray:
    """Return s+ - s, a step of Fisher scoring that keeps every variance at or above zero."""
    from scipy.optimize import nnls

    if len(variances) == 1:
        return np.asarray(np.maximum(score / information[0], -variances))
    length = np.sqrt(np.diag(information))
    scaled = information / np.outer(length, length)
    size, vectors = np.linalg.eigh(scaled)
    root = np.sqrt(size.clip(RANK * size[-1]))  # scaled = R' R, R = diag(root) vectors'
    target = scaled @ (variances * length) + score / length
    return np.asarray(nnls(root[:, None] * vectors.T, vectors.T @ target / root)[0] / length - variances)


# ---- excess variance: scatter of the residuals beyond the known noise


def excess_variance(residuals: FloatArray, variances: FloatArray, freedom: float) -> float:
    """Return s2 >= 0 such that sum r_k^2 / (v_k + s2) = degrees of freedom, for residuals r and variances v (E,).

    A swaying hand or a nonlinearity moves whole poses. Only residuals reveal this, not the noise within a rest (Paule and Mandel,
    "Consensus values and weighting factors", 1982).
    """
    from scipy.optimize import brentq

    square = residuals**2
    if freedom <= 0 or not square.any():
        return 0.0
    high = float(square.sum()) / freedom  # upper bound, at which the weighted sum is at most the degrees of freedom
    low = 1e-12 * high

    def beyond(excess: float) -> float:
        return float((square / (variances + excess)).sum()) - freedom

    return 0.0 if beyond(low) <= 0.0 else float(brentq(beyond, low, high, xtol=low, rtol=1e-9))


# ---- robust least squares: a residual beyond k standard deviations s counts k s / |r|, s from the median of all
#
# P. J. Huber, "Robust estimation of a location parameter", 1964. To first order the estimate follows the rows within the bound.

HUBER = 1.345  # k: for normal residuals, as efficient as least squares with 95 % of the rows


def fit_huber(
    design: FloatArray,
    reading: FloatArray,
    *,
    together: int = 1,
    mad_factor: float = 1.4826,
    passes: int = 15,
    prior: int = 0,
) -> tuple[FloatArray, FloatArray, float]:
    """Return parameters (P,), weights (E,) and robust scale. Each group of ``together`` rows has a common weight, from its rms.

    The last ``prior`` rows are not readings. They keep their weight and do not contribute to the scale.
    """
    length = np.linalg.norm(design, axis=0)
    scaled, weight = design / length, np.ones(len(reading))
    x, scale = np.zeros(design.shape[1]), 0.0
    for _ in range(passes):
        previous = x
        x = np.linalg.solve((scaled.T * weight) @ scaled, scaled.T @ (weight * reading))
        size = np.sqrt(((reading - scaled @ x) ** 2).reshape(-1, together).mean(axis=1))
        scale = mad_factor * float(np.median(size[: len(size) - prior]))
        if scale > 0.0:
            weight = np.repeat(np.minimum(1.0, HUBER * scale / np.maximum(size, 1e-15)), together)
        weight[len(weight) - prior :] = 1.0
        if np.abs(x - previous).max() <= 1e-9 * max(float(np.abs(x).max()), 1e-12):
            break
    return x / length, weight, scale


# ---- noise of a mean reading, from the scatter of short block means within the windows

BLOCK_S = 0.5  # means of this length count as independent of each other
_LEAST_SPARE_BLOCKS = 6  # number of blocks below which the estimate is too uncertain


def noise_of_means(windows: Sequence[FloatArray], sizes: Sequence[int], removed: int = 1) -> FloatArray | None:
    """Return the standard deviation (P, 3) of the mean of each window (N, 3), or None with too few blocks."""
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
    """Return the number of samples in a block."""
    return max(1, round(BLOCK_S * sample_rate_hz))
