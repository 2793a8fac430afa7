"""Dynamic drift: the rate-dependent error after offset(T) and matrix, per axis, as a table over measured rate and temperature.

``e(w, T) = w - true rate`` for w the measured rate of the axis' own turns, so that the lookup needs no inversion; what turns about
another axis do is left to the matrix. Rests that lay as the device turned stand at rate zero. A smooth surface, a tensor product of
cubic splines with e(0, T) = 0, goes through the scattered steps of all soaks::

    r_k = e(w_k, T_k) + d_g(k) + noise          e(w, T) = sum_ij c_ij B_i(w) B_j(T)
    minimise  sum (r_k - e_k - d_g)^2 / v_k + l_w integral (d2e/dw2)^2 + l_T integral (d2e/dT2)^2

d_g is what a soak and mounting leave of the offset: it belongs to the static table, as rate zero does, so that nothing counts
twice. The two stiffnesses l have the least cross-validated error: whole soaks between the first and the last, and whole rates, are
held out. A group g that is held out of a linear smoother with hat matrix H misses by (1 - H_gg)^-1 r_g, so nothing is fitted anew
[1]_. Rate, temperature and residual are scaled to one beforehand. The covariance is that of the smoothness prior [2]_, and the
variances v hold the excess that the residuals show beyond those stated.

References
----------
.. [1] P. Craven, G. Wahba, "Smoothing noisy data with spline functions", Numerische Mathematik 31, 1979, 377-403.
.. [2] G. Wahba, "Bayesian confidence intervals for the cross-validated smoothing spline", J. R. Stat. Soc. B 45, 1983, 133-150.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.drift.scale import MATRIX_GAP_C, Steps, measured_rate, rests_of, steps_of
from undrift.drift.static import near_data
from undrift.errors import NotObservable
from undrift.findings import finding
from undrift.fit.least_squares import determined, excess_variance
from undrift.model import AXES, Calibration, DynamicDrift, ScaleDrift, StaticDrift, Verdict

DEFAULT_STEP_C = 5.0
_OWN = 0.5  # share of the turning rate from which a row counts for an axis
_SAME_RATE = 0.01  # of the greatest: imposed rates nearer to each other are one node
_NEAR_RATE = 0.02  # of the greatest: how far beyond the measured rates a node still counts as seen
_LOOSE = 1e2  # variance of d_g about the mean of its rows, in units of the residuals' own: it is free
_SOFTNESS = (1e-2, 1e-1, 1.0, 1e1, 1e2)  # prior size of a second derivative, in spans and in residuals; stiff first
_MOST_INTERVALS = 6  # of 30 deg/s over the note's rates
_NEGLIGIBLE = 1e-2  # weight
_LEAST = 1e-6  # of the values: less noise is beyond what the equations resolve; rad/s where all values are 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SurfacePoints:
    """Residual rates of one axis, n rows."""

    turn_rate: FloatArray  # (n,), measured rate, rad/s; 0 for a rest
    temp_c: FloatArray  # (n,), degC
    value: FloatArray  # (n,), measured less imposed rate, rad/s
    variance: FloatArray  # (n,), of the value, (rad/s)^2, above 0
    soak: IntArray  # (n,), which soak, from 0
    mounting: IntArray  # (n,), which soak and mounting, from 0: rows of one number share d
    level: IntArray  # (n,), which rate, whatever its sign; 0 for rests

    def __len__(self) -> int:
        return len(self.value)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cubics:
    """Cubic B-splines on even knots."""

    low: float
    high: float
    intervals: int  # between the knots

    @property
    def knots(self) -> FloatArray:
        """Knots in units of the span, ends four-fold, shape (intervals + 7,)."""
        return np.concatenate((np.zeros(3), np.linspace(0.0, 1.0, self.intervals + 1), np.ones(3)))

    def at(self, x: FloatArray) -> FloatArray:
        """Return the splines at points, (n,) -> (n, intervals + 3)."""
        from scipy.interpolate import BSpline

        z = np.clip((x - self.low) / (self.high - self.low), 0.0, 1.0)
        return np.asarray(BSpline.design_matrix(z, self.knots, 3).toarray())

    def products(self, derivative: int) -> FloatArray:
        """Return the integrals over the span of the products of all pairs, or of their derivatives."""
        from scipy.interpolate import BSpline

        at, weight = np.polynomial.legendre.leggauss(4)
        step = 1.0 / self.intervals
        z = (np.arange(self.intervals)[:, None] * step + 0.5 * step * (at + 1.0)).ravel()
        y: FloatArray = np.asarray(BSpline(self.knots, np.eye(self.intervals + 3), 3)(z, nu=derivative))
        return np.asarray(y.T @ (y * np.tile(0.5 * step * weight, self.intervals)[:, None]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """A fitted surface."""

    rate: Cubics
    temp: Cubics
    coefficients: FloatArray  # (P,), c in the splines that vanish at rate zero
    covariance: FloatArray  # (P, P), of c, (rad/s)^2
    # Size of second derivatives over rate and temperature, in spans and residuals: mean of the logarithms
    softness: tuple[float, float]
    excess: float  # Standard deviation that the residuals show beyond the variances stated, rad/s
    residuals: FloatArray  # (n,), rad/s
    offsets: FloatArray  # (G,), d of each mounting, rad/s

    def at(self, turn_rate: FloatArray, temp_c: FloatArray) -> FloatArray:
        """Return e at points (n,), rad/s."""
        return np.asarray(_design(self.rate, self.temp, turn_rate, temp_c) @ self.coefficients)

    def uncertainty(self, turn_rate: FloatArray, temp_c: FloatArray) -> FloatArray:
        """Return the standard uncertainty of e at points (n,), rad/s."""
        x = _design(self.rate, self.temp, turn_rate, temp_c)
        return np.asarray(np.sqrt(np.maximum(np.einsum("np,np->n", x @ self.covariance, x), 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DynamicFit:
    """The table of rate-dependent drift."""

    drift: DynamicDrift  # an axis that was not turned has zeros with uncertainty NaN
    surfaces: tuple[Surface | None, ...]  # one an axis; None where it was not turned
    before: FloatArray  # (3,), residual rms of each axis about the offset of its mountings before the fit, rad/s
    after: FloatArray  # (3,), and after it
    verdict: Verdict


def fit_dynamic(
    steps: RateSteps,
    calibration: Calibration,
    *,
    static: StaticDrift | None,
    scale: ScaleDrift | None,
    rests: RestBlocks | None = None,
    temp_c: FloatArray | None = None,
    like: "DynamicFit | None" = None,
) -> DynamicFit:
    """Fit the dynamic drift of the gyroscopes.

    Nodes of the measured rate (k,), rad/s, are the imposed rates, zero and the ends of what was measured, those of the temperature
    (m,) every 5 degC over the soaks; the softness of each surface is found by cross-validation, or as in an earlier fit.
    """
    clean = steps_of(steps)
    points = _points(clean, calibration, static, scale, rests)
    turn_rate, temp_c = _nodes(clean, points, temp_c)
    shape = (len(temp_c), len(turn_rate), 3)
    error, uncertainty, marks = np.zeros(shape), np.full(shape, np.nan), np.zeros(shape[:2], dtype=bool)
    w, t = np.tile(turn_rate, len(temp_c)), np.repeat(temp_c, len(turn_rate))
    before, after = np.full(3, np.nan), np.full(3, np.nan)
    surfaces: list[Surface | None] = [None, None, None]
    for axis, own in enumerate(points):
        if own is None:
            continue
        ends = (float(turn_rate[0]), float(turn_rate[-1])), (float(temp_c[0]), float(temp_c[-1]))
        earlier = None if like is None else like.surfaces[axis]
        alike = earlier.softness if earlier is not None else None if like is None else (_SOFTNESS[0], _SOFTNESS[0])
        surface = surfaces[axis] = fit_surface(own, rate_span=ends[0], temp_span=ends[1], softness=alike)
        error[:, :, axis] = surface.at(w, t).reshape(shape[:2])
        uncertainty[:, :, axis] = surface.uncertainty(w, t).reshape(shape[:2])
        marks |= _unseen(own, turn_rate, temp_c)
        means = np.bincount(own.mounting, own.value) / np.bincount(own.mounting)
        before[axis] = np.sqrt(np.mean((own.value - means[own.mounting]) ** 2))
        after[axis] = np.sqrt(np.mean(surface.residuals**2))
    return DynamicFit(
        drift=DynamicDrift(
            temp_c=temp_c, turn_rate=turn_rate, error=error, uncertainty=uncertainty, extrapolated=marks
        ),
        surfaces=tuple(surfaces),
        before=before,
        after=after,
        verdict=_verdict(points).also(clean.verdict),
    )


def _points(
    steps: Steps,
    calibration: Calibration,
    static: StaticDrift | None,
    scale: ScaleDrift | None,
    rests: RestBlocks | None,
) -> list[SurfacePoints | None]:
    """Return the rows of each axis' own rate, rests that lay as the device turned among them.

    None for an axis that was not turned at two soaks and two rates.
    """
    n, (block, of) = len(steps), rests_of(steps, rests)
    gyro, temp_c = steps.gyro, steps.temp_c
    if rests is not None and len(block):
        gyro, temp_c = np.concatenate((gyro, rests.gyro[block])), np.concatenate((temp_c, rests.temp_c[block]))
    rate = measured_rate(gyro, temp_c, calibration, static=static, scale=scale)
    row, imposed = np.concatenate((np.arange(n), of)), np.concatenate((steps.rate_b, np.zeros((len(of), 3))))
    made = measured_rate(np.eye(4, 3, -1), np.zeros(4), calibration, static=None, scale=None)
    variance = steps.gyro_variance @ ((made[1:] - made[0]).T ** 2).T
    found: list[SurfacePoints | None] = []
    for axis in range(3):
        own = np.flatnonzero(np.abs(steps.rate_b[:, axis]) > _OWN * np.linalg.norm(steps.rate_b, axis=1))
        if len(np.unique(steps.soak[own])) < 2 or len(np.unique(steps.rate_b[own, axis])) < 2:
            found.append(None)
            continue
        rows = np.concatenate((own, n + np.flatnonzero(np.isin(steps.mounting[of], steps.mounting[own]))))
        size = np.abs(imposed[rows, axis])
        found.append(
            SurfacePoints(
                turn_rate=np.where(rows < n, rate[rows, axis], 0.0),
                temp_c=temp_c[rows],
                value=rate[rows, axis] - imposed[rows, axis],
                variance=variance[row[rows], axis],
                soak=np.unique(steps.soak[row[rows]], return_inverse=True)[1].reshape(-1),
                mounting=np.unique(steps.mounting[row[rows]], return_inverse=True)[1].reshape(-1),
                level=np.round(size / (_SAME_RATE * size.max())).astype(np.int64),
            )
        )
    return found


def _nodes(
    steps: Steps, points: list[SurfacePoints | None], temp_c: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Return the imposed rates, zero, and the ends of what was measured where they lie beyond; and the temperatures."""
    have = [p for p in points if p is not None]
    soaks = len(np.unique(steps.soak))
    if not have:
        raise NotObservable(
            f"dynamic drift: wanted an axis turned at two rates and two soaks or more, got {len(steps)} steps at {soaks} soaks, "
            f"{steps.temp_c.min():.1f} to {steps.temp_c.max():.1f} degC; repeat the steps at another temperature",
            soaks=soaks,
        )
    if temp_c is None:
        temps = np.concatenate([p.temp_c for p in have]) / DEFAULT_STEP_C
        first, last = np.floor(np.round(temps.min(), 2)), np.ceil(np.round(temps.max(), 2))
        temp_c = DEFAULT_STEP_C * np.arange(first, last + 0.5)
    tolerance = _SAME_RATE * float(np.abs(steps.along).max())
    wanted = np.sort(np.concatenate((steps.along, [0.0])))
    groups = np.split(wanted, np.flatnonzero(np.diff(wanted) > tolerance) + 1)
    nodes = np.array([0.0 if (g == 0.0).any() else g.mean() for g in groups])
    measured = np.concatenate([p.turn_rate for p in have])
    below, above = measured.min(keepdims=True), measured.max(keepdims=True)
    below, above = below[below < nodes[0] - tolerance], above[above > nodes[-1] + tolerance]
    return np.concatenate((below, nodes, above)), temp_c


def _unseen(own: SurfacePoints, turn_rate: FloatArray, temp_c: FloatArray) -> BoolArray:
    """Mark nodes beyond the temperatures, or beyond the rates that were measured around their temperature."""
    rows = [own.soak == s for s in np.unique(own.soak)]
    at = np.array([own.temp_c[r].mean() for r in rows])
    order = np.argsort(at)
    ends = [np.array([f(np.append(own.turn_rate[r], 0.0)) for r in rows])[order] for f in (np.min, np.max)]
    slack = _NEAR_RATE * float(np.abs(own.turn_rate).max())
    low, high = (np.interp(temp_c, at[order], end)[:, None] for end in ends)
    outside = (turn_rate < low - slack) | (turn_rate > high + slack)
    return np.asarray(outside | ~near_data(temp_c, at, gap_c=MATRIX_GAP_C)[:, None])


def _verdict(points: list[SurfacePoints | None]) -> Verdict:
    found, two = [], []
    for axis, own in zip(AXES, points, strict=True):
        if own is None:
            found.append(finding("drift.dynamic_not_observable", "warn", axis=axis))
            continue
        steady = own.turn_rate[own.level > 0]
        if (steady > 0.0).all() or (steady < 0.0).all():
            way, other = ("+", "-") if steady[0] > 0.0 else ("-", "+")
            found.append(finding("drift.dynamic_one_way", "warn", axis=axis, way=way + axis, other=other + axis))
        if len(np.unique(own.soak)) == 2:
            two.append(axis)
    if two:
        found.append(finding("drift.dynamic_two_temperatures", "warn", axes=two))
    return Verdict.of(*found)


# ---- the surface e(w, T) with e(0, T) = 0 through scattered points


@determined("rate drift")
def fit_surface(
    points: SurfacePoints,
    *,
    rate_span: tuple[float, float],
    temp_span: tuple[float, float],
    softness: tuple[float, float] | None = None,
) -> Surface:
    """Fit a surface to the residual rates of one axis: find the excess, fit again with it, mix those that predict about as well."""
    soaks, levels = len(np.unique(points.soak)), len(np.unique(points.turn_rate))
    if soaks < 2 or levels < 2:
        raise NotObservable(
            f"rate drift: wanted steps at two rates and two temperatures or more, got {levels} and {soaks}; "
            "repeat the steps at another soak",
            soaks=soaks,
            rates=levels,
        )
    low, high = (float(f((*rate_span, 0.0, f(points.turn_rate)))) for f in (min, max))
    cold, hot = (float(f((*temp_span, f(points.temp_c)))) for f in (min, max))
    rate = Cubics(low=low, high=high, intervals=min(_MOST_INTERVALS, max(2, levels // 2)))
    temp = Cubics(low=cold, high=hot, intervals=min(_MOST_INTERVALS, max(1, soaks - 1)))
    groups = int(points.mounting.max()) + 1
    means = np.bincount(points.mounting, points.value, groups) / np.maximum(np.bincount(points.mounting), 1)
    points = replace(points, value=points.value - means[points.mounting])
    x = np.column_stack((_design(rate, temp, points.turn_rate, points.temp_c), np.eye(groups)[points.mounting]))
    bends, p, excess = _roughness(rate, temp), x.shape[1] - groups, 0.0
    size = max(float(np.sqrt(np.mean(points.value**2))), float(np.sqrt(points.variance.min())), _LEAST)
    points = replace(points, variance=np.maximum(points.variance, (_LEAST * size) ** 2))  # a device without noise
    pairs = [softness or (_SOFTNESS[0], _SOFTNESS[0])]
    weights: FloatArray = np.ones(1)
    for turn in range(3):
        v = points.variance + excess
        if softness is None and (turn == 0 or (turn == 1 and excess > float(np.median(points.variance)))):
            pairs, weights = _softnesses(points, x, v, size, bends)
        solutions = [_solve(points, x, v, _penalty(pair, size, bends, groups)) for pair in pairs]
        r = sum((w * s[2] for w, s in zip(weights, solutions, strict=True)), np.zeros(len(points)))
        freedom = len(points) - float(weights @ [s[3] for s in solutions])
        before, excess = excess, excess_variance(r, points.variance, round(freedom))
        if abs(excess - before) <= 0.02 * float(np.median(v)):
            break
    c = weights @ np.array([s[0] for s in solutions])
    of_rate, of_temp = np.exp(weights @ np.log(np.array(pairs))).tolist()
    covariance = np.zeros((p, p))
    for w, s in zip(weights, solutions, strict=True):
        off = (s[0] - c)[:p]
        covariance += w * (s[1][:p, :p] + np.outer(off, off))
    return Surface(
        rate=rate,
        temp=temp,
        coefficients=c[:p],
        covariance=covariance,
        softness=(of_rate, of_temp),
        excess=float(np.sqrt(excess)),
        residuals=r,
        offsets=means + c[p:],
    )


def _softnesses(
    points: SurfacePoints, x: FloatArray, v: FloatArray, size: float, bends: tuple[FloatArray, FloatArray]
) -> tuple[list[tuple[float, float]], FloatArray]:
    """Return the pairs whose cross-validated error is small enough to count, and their weights."""
    groups, few = int(points.mounting.max()) + 1, len(np.unique(points.soak)) < 3
    pairs = [(of_rate, of_temp) for of_temp in _SOFTNESS[: 1 if few else None] for of_rate in _SOFTNESS]
    scores = np.array([_held_out_square(points, x, v, _penalty(pair, size, bends, groups)) for pair in pairs])
    if not scores.min() > 0.0:  # nothing could be left out: as stiff as may be; or what was is met exactly
        return [pairs[int(scores.argmin())]], np.ones(1)
    weights = (scores / scores.min()) ** (-0.5 * len(points))
    kept = weights > _NEGLIGIBLE * weights.sum()
    return [pair for pair, keep in zip(pairs, kept, strict=True) if keep], weights[kept] / weights[kept].sum()


def _held_out_square(points: SurfacePoints, x: FloatArray, v: FloatArray, penalty: FloatArray) -> float:
    """Return the weighted sum of squares of all rows when their soak, or their rate, is held out."""
    z = np.linalg.inv(np.linalg.cholesky(x.T @ (x / v[:, None]) + penalty)) @ x.T
    r = points.value - z.T @ (z @ (points.value / v))

    def missed(rows: IntArray) -> FloatArray:
        hat = z[:, rows].T @ z[:, rows] / v[rows]
        return np.asarray(np.linalg.solve(np.eye(len(rows)) - hat, r[rows]))

    total, soaks = 0.0, np.unique(points.soak)
    middle = np.array([points.temp_c[points.soak == s].mean() for s in soaks])
    for s in soaks[(middle > middle.min()) & (middle < middle.max())]:
        rows = np.flatnonzero(points.soak == s)
        off = missed(rows)
        for g in np.unique(points.mounting[rows]):  # its offset is its own: only how it differs over rate counts
            own = points.mounting[rows] == g
            w = 1.0 / v[rows][own]
            off[own] -= (w * off[own]).sum() / w.sum()
        total += float((off**2 / v[rows]).sum())
    for level in np.unique(points.level[points.level > 0])[:-1]:
        rows = np.flatnonzero(points.level == level)
        total += float((missed(rows) ** 2 / v[rows]).sum())
    return total


def _solve(
    points: SurfacePoints, x: FloatArray, v: FloatArray, penalty: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return coefficients of surface and offsets, their covariance, what is left, and the parameters in effect."""
    covariance = np.linalg.inv(x.T @ (x / v[:, None]) + penalty)
    c = covariance @ (x.T @ (points.value / v))
    return c, covariance, points.value - x @ c, float(((x @ covariance) * x / v[:, None]).sum())


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
    return np.asarray(np.linalg.svd(rate.at(np.zeros(1)))[2][1:].T)
