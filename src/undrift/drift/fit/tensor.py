"""A smooth surface e(w, T) with e(0, T) = 0 through scattered rate steps: a tensor product of cubic splines.

::

    r_k = e(w_k, T_k) + d_g(k) + noise          e(w, T) = sum_ij c_ij B_i(w) B_j(T)
    minimise  sum (r_k - e_k - d_g)^2 / v_k + l_w integral (d2e/dw2)^2 + l_T integral (d2e/dT2)^2

d_g is what a soak and mounting leave of the offset: it is the static table's affair, not the rate's, and is fitted along and
forgotten. So is e(0, T) = 0: rate zero belongs to the static table, and nothing is counted twice. The two stiffnesses l are
those that foretell best what was left out: whole soaks between the first and the last, and whole rates. A group g that is left
out of a linear smoother with hat matrix H misses by (1 - H_gg)^-1 r_g, so nothing is fitted anew [1]_. Rate, temperature and
residual are scaled to one beforehand. The covariance is that of the smoothness prior [2]_, and the variances v hold
the excess that the residuals show beyond what the dwells stated.

References
----------
.. [1] P. Craven, G. Wahba, "Smoothing noisy data with spline functions", Numerische Mathematik 31, 1979, 377-403.
.. [2] G. Wahba, "Bayesian confidence intervals for the cross-validated smoothing spline", J. R. Stat. Soc. B 45, 1983, 133-150.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.fit.excess import excess_variance
from undrift.errors import NotObservable

_LOOSE = 1e2  # variance of d_g about the mean of its rows, in units of the residuals' own: it is free
_SOFTNESS = (1e-2, 1e-1, 1.0, 1e1, 1e2)  # prior size of a second derivative, in spans and in residuals; stiff first
_MOST_INTERVALS = 6  # of 30 deg/s over the note's rates
_NEGLIGIBLE = 1e-2  # weight


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SurfacePoints:
    """Residual rates of one axis, n rows.

    Parameters
    ----------
    turn_rate : array, shape (n,)
        Measured rate, rad/s; 0 for a rest.
    temp_c : array, shape (n,)
        degC.
    value : array, shape (n,)
        Measured less imposed rate, rad/s.
    variance : array, shape (n,)
        Of the value, (rad/s)^2, above 0.
    soak : array of int, shape (n,)
        Which soak, from 0.
    mounting : array of int, shape (n,)
        Which soak and mounting, from 0: rows of one number share what is left of the offset.
    level : array of int, shape (n,)
        Which rate, whatever its sign; 0 for rests.
    """

    turn_rate: FloatArray
    temp_c: FloatArray
    value: FloatArray
    variance: FloatArray
    soak: IntArray
    mounting: IntArray
    level: IntArray

    def __len__(self) -> int:
        return len(self.value)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cubics:
    """Cubic B-splines on even knots.

    Parameters
    ----------
    low, high : float
        Where they begin and end.
    intervals : int
        Between the knots.
    """

    low: float
    high: float
    intervals: int

    @property
    def knots(self) -> FloatArray:
        """Knots in units of the span, ends four-fold, shape (intervals + 7,)."""
        return np.concatenate((np.zeros(3), np.linspace(0.0, 1.0, self.intervals + 1), np.ones(3)))

    def at(self, x: FloatArray) -> FloatArray:
        """Return the splines at some points.

        Parameters
        ----------
        x : array, shape (n,)
            From low to high; held there beyond.

        Returns
        -------
        array, shape (n, intervals + 3)
            One spline a column.
        """
        from scipy.interpolate import BSpline

        z = np.clip((x - self.low) / (self.high - self.low), 0.0, 1.0)
        return np.asarray(BSpline.design_matrix(z, self.knots, 3).toarray())

    def products(self, derivative: int) -> FloatArray:
        """Return the integrals of the products of all pairs, or of their derivatives, over the span.

        Parameters
        ----------
        derivative : int
            0 or 2, with respect to the share of the span.

        Returns
        -------
        array, shape (intervals + 3, intervals + 3)
            By Gauss' rule of four points an interval, which is exact.
        """
        from scipy.interpolate import BSpline

        at, weight = np.polynomial.legendre.leggauss(4)
        step = 1.0 / self.intervals
        z = (np.arange(self.intervals)[:, None] * step + 0.5 * step * (at + 1.0)).ravel()
        spline = BSpline(self.knots, np.eye(self.intervals + 3), 3)
        y: FloatArray = np.asarray(spline(z, nu=derivative))
        made: FloatArray = y.T @ (y * np.tile(0.5 * step * weight, self.intervals)[:, None])
        return made


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """A fitted surface.

    Parameters
    ----------
    rate, temp : Cubics
        Its splines.
    coefficients : array, shape (P,)
        c in the splines that vanish at rate zero.
    covariance : array, shape (P, P)
        Of c, (rad/s)^2.
    softness : (float, float)
        Size of second derivatives over rate and temperature, in spans and residuals: mean of the logarithms.
    excess : float
        Standard deviation that the residuals show beyond the variances stated, rad/s.
    residuals : array, shape (n,)
        What is left, rad/s.
    offsets : array, shape (G,)
        d of each mounting, rad/s.
    """

    rate: Cubics
    temp: Cubics
    coefficients: FloatArray
    covariance: FloatArray
    softness: tuple[float, float]
    excess: float
    residuals: FloatArray
    offsets: FloatArray

    def at(self, turn_rate: FloatArray, temp_c: FloatArray) -> FloatArray:
        """Return e at some points.

        Parameters
        ----------
        turn_rate, temp_c : array, shape (n,)
            Measured rate, rad/s, and temperature, degC.

        Returns
        -------
        array, shape (n,)
            rad/s.
        """
        e: FloatArray = _design(self.rate, self.temp, turn_rate, temp_c) @ self.coefficients
        return e

    def uncertainty(self, turn_rate: FloatArray, temp_c: FloatArray) -> FloatArray:
        """Return the standard uncertainty of e at some points.

        Parameters
        ----------
        turn_rate, temp_c : array, shape (n,)
            Measured rate, rad/s, and temperature, degC.

        Returns
        -------
        array, shape (n,)
            rad/s; 0 at rate zero, where e is 0 by its definition.
        """
        x = _design(self.rate, self.temp, turn_rate, temp_c)
        deviation: FloatArray = np.sqrt(np.maximum(np.einsum("np,np->n", x @ self.covariance, x), 0.0))
        return deviation


def fit_surface(
    points: SurfacePoints,
    *,
    rate_span: tuple[float, float],
    temp_span: tuple[float, float],
    softness: tuple[float, float] | None = None,
) -> Surface:
    """Fit a surface to the residual rates of one axis.

    Parameters
    ----------
    points : SurfacePoints
        Steps, and rests at rate zero.
    rate_span : (float, float)
        Measured rates that the surface is wanted for, rad/s; widened to hold zero and all points.
    temp_span : (float, float)
        Temperatures likewise, degC.
    softness : (float, float), optional
        Over rate and temperature; found by leaving out where not given.

    Returns
    -------
    Surface
        With covariance.

    Raises
    ------
    NotObservable
        Points at fewer than two temperatures, or at fewer than two rates.
    """
    soaks, levels = len(np.unique(points.soak)), len(np.unique(points.turn_rate))
    if soaks < 2 or levels < 2:
        raise NotObservable(
            f"rate drift: wanted steps at two rates and two temperatures or more, got {levels} and {soaks}; "
            "repeat the steps at another soak",
            soaks=soaks,
            rates=levels,
        )
    low, high = (f((*rate_span, 0.0, f(points.turn_rate))) for f in (min, max))
    cold, hot = (f((*temp_span, f(points.temp_c))) for f in (min, max))
    rate = Cubics(low=float(low), high=float(high), intervals=min(_MOST_INTERVALS, max(2, levels // 2)))
    temp = Cubics(low=float(cold), high=float(hot), intervals=min(_MOST_INTERVALS, max(1, soaks - 1)))
    return _settled(points, rate, temp, softness)


def _settled(points: SurfacePoints, rate: Cubics, temp: Cubics, softness: tuple[float, float] | None) -> Surface:
    """Fit, find the excess, fit again with it, and mix the surfaces that foretell about as well."""
    groups = int(points.mounting.max()) + 1
    means = np.bincount(points.mounting, points.value, groups) / np.maximum(np.bincount(points.mounting), 1)
    points = replace(points, value=points.value - means[points.mounting])
    x = np.column_stack((_design(rate, temp, points.turn_rate, points.temp_c), np.eye(groups)[points.mounting]))
    bends, p, excess = _roughness(rate, temp), x.shape[1] - groups, 0.0
    size = max(float(np.sqrt(np.mean(points.value**2))), float(np.sqrt(points.variance.min())))
    pairs = [softness or (_SOFTNESS[0], _SOFTNESS[0])]
    weights: FloatArray = np.ones(1)
    for turn in range(3):
        v = points.variance + excess
        if softness is None and (turn == 0 or (turn == 1 and excess > float(np.median(points.variance)))):
            pairs, weights = _softnesses(points, x, v, size, bends)
        solutions = [_solve(points, x, v, _penalty(pair, size, bends, groups)) for pair in pairs]
        r = sum((w * s.residuals for w, s in zip(weights, solutions, strict=True)), np.zeros(len(points)))
        freedom = len(points) - float(weights @ [s.effective for s in solutions])
        before, excess = excess, excess_variance(r, points.variance, round(freedom))
        if abs(excess - before) <= 0.02 * float(np.median(v)):
            break
    c = weights @ np.array([s.coefficients for s in solutions])
    typical = np.exp(weights @ np.log(np.array(pairs)))
    covariance = np.zeros((p, p))
    for w, s in zip(weights, solutions, strict=True):
        off = (s.coefficients - c)[:p]
        covariance += w * (s.covariance[:p, :p] + np.outer(off, off))
    return Surface(
        rate=rate,
        temp=temp,
        coefficients=c[:p],
        covariance=covariance,
        softness=(float(typical[0]), float(typical[1])),
        excess=float(np.sqrt(excess)),
        residuals=r,
        offsets=means + c[p:],
    )


def _softnesses(
    points: SurfacePoints, x: FloatArray, v: FloatArray, size: float, bends: tuple[FloatArray, FloatArray]
) -> tuple[list[tuple[float, float]], FloatArray]:
    """Return the pairs that foretell what was left out well enough to count, and their weights."""
    groups, few = int(points.mounting.max()) + 1, len(np.unique(points.soak)) < 3
    pairs = [(of_rate, of_temp) for of_temp in _SOFTNESS[: 1 if few else None] for of_rate in _SOFTNESS]
    scores = np.array([_left_out(points, x, v, _penalty(pair, size, bends, groups)) for pair in pairs])
    if not scores.any():  # nothing could be left out: as stiff as may be
        return pairs[:1], np.ones(1)
    weights = (scores / scores.min()) ** (-0.5 * len(points))
    kept = weights > _NEGLIGIBLE * weights.sum()
    return [pair for pair, keep in zip(pairs, kept, strict=True) if keep], weights[kept] / weights[kept].sum()


def _left_out(points: SurfacePoints, x: FloatArray, v: FloatArray, penalty: FloatArray) -> float:
    """Return the weighted sum of squares of all rows when their soak, or their rate, is left out."""
    z = np.linalg.inv(np.linalg.cholesky(x.T @ (x / v[:, None]) + penalty)) @ x.T
    r = points.value - z.T @ (z @ (points.value / v))
    total = 0.0
    soaks = np.unique(points.soak)
    middle = np.array([points.temp_c[points.soak == s].mean() for s in soaks])
    for s in soaks[(middle > middle.min()) & (middle < middle.max())]:
        rows = np.flatnonzero(points.soak == s)
        missed = _missed(rows, z, r, v)
        for g in np.unique(points.mounting[rows]):  # its offset is its own: only how it differs over rate counts
            own = points.mounting[rows] == g
            w = 1.0 / v[rows][own]
            missed[own] -= (w * missed[own]).sum() / w.sum()
        total += float((missed**2 / v[rows]).sum())
    inner = np.unique(points.level[points.level > 0])[:-1]
    for level in inner:
        rows = np.flatnonzero(points.level == level)
        total += float((_missed(rows, z, r, v) ** 2 / v[rows]).sum())
    return total


def _missed(rows: IntArray, z: FloatArray, r: FloatArray, v: FloatArray) -> FloatArray:
    hat = z[:, rows].T @ z[:, rows] / v[rows]
    missed: FloatArray = np.linalg.solve(np.eye(len(rows)) - hat, r[rows])
    return missed


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Solution:
    """Coefficients of surface and offsets, their covariance, what is left, and the parameters in effect."""

    coefficients: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    effective: float


def _solve(points: SurfacePoints, x: FloatArray, v: FloatArray, penalty: FloatArray) -> _Solution:
    covariance = np.linalg.inv(x.T @ (x / v[:, None]) + penalty)
    c = covariance @ (x.T @ (points.value / v))
    effective = float(((x @ covariance) * x / v[:, None]).sum())
    return _Solution(coefficients=c, covariance=covariance, residuals=points.value - x @ c, effective=effective)


def _penalty(
    softness: tuple[float, float], size: float, bends: tuple[FloatArray, FloatArray], groups: int
) -> FloatArray:
    p = len(bends[0])
    penalty = np.zeros((p + groups, p + groups))
    penalty[:p, :p] = sum(bend / (soft * size) ** 2 for bend, soft in zip(bends, softness, strict=True))
    penalty[p:, p:] = np.eye(groups) / (_LOOSE * size**2)
    return penalty


def _roughness(rate: Cubics, temp: Cubics) -> tuple[FloatArray, FloatArray]:
    """Return the squared second derivatives over rate and over temperature as forms in c."""
    vanishing = _vanishing(rate)
    flat, bent = (vanishing.T @ rate.products(d) @ vanishing for d in (0, 2))
    return np.kron(temp.products(0), bent), np.kron(temp.products(2), flat)


def _design(rate: Cubics, temp: Cubics, turn_rate: FloatArray, temp_c: FloatArray) -> FloatArray:
    over_rate, over_temp = rate.at(turn_rate) @ _vanishing(rate), temp.at(temp_c)
    return np.asarray((over_temp[:, :, None] * over_rate[:, None, :]).reshape(len(turn_rate), -1))


def _vanishing(rate: Cubics) -> FloatArray:
    """Return combinations of the splines, one a column, that are zero at rate zero."""
    at_zero = rate.at(np.zeros(1))
    return np.asarray(np.linalg.svd(at_zero)[2][1:].T)
