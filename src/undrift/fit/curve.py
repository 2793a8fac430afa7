"""A smooth curve over temperature with its covariance, and the cubic spline through every point.

The curve is a Gaussian process about a parabola (C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning",
2006, section 2.7)::

    y = f(T) + Z c + u + e          rows y (n,) of each column, regressors Z (n, p)
    f(T) = a + b x + g 4 x^2 + h(x)       x = (T - T_0) / span
    cov h = q bending(x, x')        departure from the parabola, an integrated Wiener process
    cov u = s C                     contribution of a visit to a temperature, with correlation C
    cov e                           known

a, b and c have no prior. The prior of g is wide: over 10 K the slope of an offset changes by as much as its mean. The two
hyperparameters, the sizes of bends and visits, are common to all columns, each in the unit of its column. They maximise the
restricted likelihood times a half-t prior for each (A. Gelman, "Prior distributions for variance parameters", 2006). If a few rows
cannot determine a size, it therefore has its usual value, not zero. The covariance contains both variances, widened by Student's
factor.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import NotObservable
from undrift.fit.gls import student_factor

BOW_SPAN_C = 10.0  # span over which the slope changes by as much as its mean: prior of the parabola [assumed]
BEND_SPAN_C = 50.0
DEPARTURE = 2.47e-3  # rms departure from a parabola over 50 K, share of the range, from simulated ENC-03J devices
DEPARTURE_OF_UNIT = 0.0202  # rms departure from a parabola of a bend of size 1 over the span
VISIT_OF_RANGE = 3e-3  # usual scatter of visits: share of the range of the values [assumed]
VISIT_OF_NOISE = 2.4  # smallest usual scatter, share of a row's noise [assumed]
SMALLEST = 1e-12  # smallest range of readings, for constant readings: rad/s, m/s2 or count
JITTER = 1e-11  # smallest variance, share of the variance of the values: a curve through exact values remains solvable


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NodeValues:
    """Values of curves at nodes, with covariance."""

    value: FloatArray  # (m, k), unit of the values
    covariance: FloatArray  # (k, m, m), covariance of the nodes of each curve, unit squared

    @property
    def uncertainty(self) -> FloatArray:
        """Standard uncertainty of each node, shape (m, k)."""
        variance = np.diagonal(self.covariance, axis1=1, axis2=2).T
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """A fitted curve of k columns, evaluated with ``at``."""

    origin_c: float  # T_0, degC
    span_c: float  # degC
    x: FloatArray  # (n,), scaled temperature of the rows
    value: FloatArray  # (n, k)
    basis: FloatArray  # (n, 2 + p): constant, x, regressors
    stated: FloatArray  # (k, n, n), covariance of e
    correlation: FloatArray  # (n, n), C
    bow: FloatArray  # (k,), prior variance of g
    bend: FloatArray  # (k,), q
    visit: FloatArray  # (k,), s
    widening: float = 1.0  # Student's factor of q and s in the covariance

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the rows of each column, (k, n, n)."""
        return self.kernel(self.x, self.x) + self.visit[:, None, None] * self.correlation + self.stated

    @property
    def coefficient(self) -> FloatArray:
        """Coefficients of the regressors, (p, k), unit of the values per unit of the regressor."""
        return np.asarray(np.einsum("kpn,nk->pk", self.trend_gain, self.value)[2:])

    @property
    def coefficient_uncertainty(self) -> FloatArray:
        """Standard uncertainty of each coefficient, (p, k)."""
        gain = self.trend_gain[:, 2:]
        return np.asarray(np.sqrt(np.einsum("kpn,knm,kpm->pk", gain, self.widened.covariance, gain)))

    @property
    def visit_deviation(self) -> FloatArray:
        """Standard deviation of the contribution of a future visit, (k,), unit of the values."""
        return np.asarray(np.sqrt(self.widening * self.visit))

    @property
    def widened(self) -> "Curve":
        """Return the curve with both variances widened for few degrees of freedom."""
        return replace(self, bend=self.widening * self.bend, visit=self.widening * self.visit, widening=1.0)

    @property
    def trend_gain(self) -> FloatArray:
        """(H' V^-1 H)^-1 H' V^-1, (k, 2 + p, n)."""
        weighted = np.linalg.solve(self.covariance, self.basis[None]).swapaxes(1, 2)
        return np.linalg.solve(weighted @ self.basis, weighted)

    def kernel(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Covariance of f without its line at scaled temperatures (i,) and (j,), (k, i, j)."""
        bows = 16.0 * np.outer(x**2, y**2)
        return self.bow[:, None, None] * bows + self.bend[:, None, None] * bending(x, y)

    def at(self, temp_c: FloatArray) -> NodeValues:
        """Return the curves at temperatures (m,), degC, with their covariance, for zero regressors.

        Rasmussen and Williams, eqs. 2.41 and 2.42.
        """
        nodes = (np.asarray(temp_c, float) - self.origin_c) / self.span_c
        basis = np.column_stack([np.ones(len(nodes)), nodes, np.zeros((len(nodes), self.basis.shape[1] - 2))])
        gain = np.linalg.solve(self.covariance, self.kernel(self.x, nodes)).swapaxes(1, 2)
        gain = gain + (basis - gain @ self.basis) @ self.trend_gain
        wide = self.widened
        shared = gain @ wide.kernel(self.x, nodes)
        covariance = wide.kernel(nodes, nodes) - shared - shared.swapaxes(1, 2)
        return NodeValues(
            value=np.einsum("kmn,nk->mk", gain, self.value),
            covariance=covariance + gain @ wide.covariance @ gain.swapaxes(1, 2),
        )


def fit_curve(
    temp_c: FloatArray,
    value: FloatArray,
    variance: FloatArray,
    *,
    regressors: FloatArray | None = None,
    correlation: FloatArray | None = None,
    shared: FloatArray | None = None,
) -> Curve:
    """Fit a curve to each column of ``value`` (n, k) at ``temp_c`` (n,), degC.

    ``variance`` (n, k) is that of the rows, and ``shared`` (k, n, n) is an additional known covariance. ``correlation`` (n, n)
    assigns rows to visits (default: each row is a visit). Raise ``NotObservable`` if all rows are at the same temperature, or do
    not determine a line and the coefficients of ``regressors`` (n, p).
    """
    span = float(np.ptp(temp_c)) if len(temp_c) else 0.0
    if span <= 0.0:
        raise NotObservable(
            f"curve over temperature: expected two temperatures or more, got {min(len(temp_c), 1)}. Record at another temperature."
        )
    origin = 0.5 * float(temp_c.min() + temp_c.max())
    x = (temp_c - origin) / span
    basis = np.column_stack([np.ones(len(x)), x, *([] if regressors is None else [regressors])])
    if np.linalg.matrix_rank(basis) < basis.shape[1]:
        raise NotObservable(
            f"curve over temperature: {len(x)} rows do not determine a line and {basis.shape[1] - 2} effects. "
            "Record more temperatures."
        )
    noise, spread = np.sqrt(np.median(variance, axis=0)), np.ptp(value, axis=0)
    size = np.maximum(np.maximum(spread, math.sqrt(np.mean(spread**2))), np.maximum(2.0 * noise, SMALLEST))
    exact = JITTER * np.maximum(value.var(axis=0), 0.01 * size**2)
    known_covariance = np.array([np.diag(rows) for rows in (variance + exact).T])
    curve = Curve(
        origin_c=origin,
        span_c=span,
        x=x,
        value=value,
        basis=basis,
        stated=known_covariance if shared is None else known_covariance + shared,
        correlation=np.eye(len(x)) if correlation is None else correlation,
        bow=(span / (8.0 * BOW_SPAN_C) * size) ** 2,
        bend=(DEPARTURE / DEPARTURE_OF_UNIT * size) ** 2 * span / BEND_SPAN_C,
        visit=np.maximum(VISIT_OF_RANGE * size, VISIT_OF_NOISE * noise) ** 2,
    )
    curve = _maximize_likelihood(curve)
    freedom = _visit_freedom(curve)
    # without a contrast, only the prior counts
    return replace(curve, widening=student_factor(freedom) if freedom >= 1.0 else 1.0)


def log_restricted_likelihood(contrasts: FloatArray, covariance: FloatArray) -> float:
    """Return the log restricted likelihood of contrasts A'y (k, r) of all columns together, with covariance (k, r, r)."""
    factor = np.linalg.cholesky(covariance)
    white = np.linalg.solve(factor, contrasts[:, :, None])
    return float(-np.log(np.diagonal(factor, axis1=1, axis2=2)).sum() - 0.5 * (white**2).sum())


def _maximize_likelihood(usual: Curve) -> Curve:
    """Return the curve at the sizes of bends and visits that maximise likelihood times prior."""
    from scipy.optimize import minimize

    free = np.linalg.qr(usual.basis, mode="complete")[0][:, usual.basis.shape[1] :]  # A: A' (1, x, Z) = 0
    contrasts = (free.T @ usual.value).T
    visits = usual.visit[:, None, None] * (free.T @ usual.correlation @ free)
    bends = usual.bend[:, None, None] * (free.T @ bending(usual.x, usual.x) @ free)
    bows = usual.bow[:, None, None] * np.outer(*[4.0 * free.T @ usual.x**2] * 2)
    known_covariance = free.T @ usual.stated @ free + bows

    def loss(log_size: FloatArray) -> float:
        bend, visit = np.exp(log_size)
        prior = _log_half_t(bend, 1.0, 3.0) + _log_half_t(visit, 1.0, 1.0)
        return -log_restricted_likelihood(contrasts, known_covariance + bend**2 * bends + visit**2 * visits) - prior

    coarse = [np.array([bend, visit]) for bend in (-2.0, 0.0, 2.0) for visit in (-2.0, 0.0, 2.0, 4.0)]
    start: Any = min(coarse, key=loss)
    options: Any = {
        "xatol": 1e-2,
        "fatol": 1e-2,
        "initial_simplex": start + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
    }
    bend, visit = np.exp(2.0 * minimize(loss, start, method="Nelder-Mead", options=options).x)
    return replace(usual, bend=bend * usual.bend, visit=visit * usual.visit)


def _log_half_t(size: float, scale: float, freedom: float) -> float:
    """Return the log density of log(size) if size has a half-t distribution."""
    return math.log(size) - 0.5 * (freedom + 1.0) * math.log1p((size / scale) ** 2 / freedom)


def _visit_freedom(curve: Curve) -> float:
    """Return the degrees of freedom of the visit variance of all columns, tr(P C)^2 / tr(P C P C).

    P = V^-1 - V^-1 H (H' V^-1 H)^-1 H' V^-1 for the covariance V of the rows and their basis H.
    """
    inverse = np.linalg.inv(curve.covariance)
    projector = inverse - inverse @ curve.basis @ curve.trend_gain
    product = curve.visit[:, None, None] * (projector @ curve.correlation)
    squares = (product * product.swapaxes(1, 2)).sum()
    return float(np.trace(product, axis1=1, axis2=2).sum() ** 2 / max(float(squares), 1e-300))


def bending(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the covariance of an integrated Wiener process that runs in both directions from 0, where its value and slope are 0.

    k(s, t) = m^2 (3 M - m) / 6 on the same side of 0, with m the smaller and M the larger of |s| and |t|, and k = 0 across it.
    """
    least = np.minimum(np.abs(x)[:, None], np.abs(y)[None, :])
    most = np.maximum(np.abs(x)[:, None], np.abs(y)[None, :])
    same_side = x[:, None] * y[None, :] > 0.0
    return np.where(same_side, least**2 * (3.0 * most - least) / 6.0, 0.0)


def not_a_knot(temp_c: FloatArray, value: FloatArray, variance: FloatArray, nodes: FloatArray) -> NodeValues:
    """Interpolate values (n, k) at temperatures (n,) to nodes (m,) with a cubic spline with not-a-knot ends."""
    from scipy.interpolate import CubicSpline

    basis = np.asarray(CubicSpline(temp_c, np.eye(len(temp_c)), bc_type="not-a-knot")(nodes))
    covariance = np.einsum("mi,ik,ni->kmn", basis, variance, basis)
    return NodeValues(value=basis @ value, covariance=covariance)
