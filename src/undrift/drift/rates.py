"""Matrix and dynamic drift over temperature, from rate steps at several soaks.

Offsets of the static table are subtracted first. A mounting is a part of a soak in which the device turned about one direction of
its case. In a soak each sensor i reads ::

    u_i - offset_i(T) = sum_j K_ij w_j + d_im + noise        axes j, mounting m

Turns are about the axes of the case, and each determines the column of K of its axis. d is the offset error of the table
(hysteresis, warm-up, g-sensitivity). Each mounting determines it, because it has two rates or more: a single rate is left out. An
axis that no soak turned keeps its column of K from the calibration, without an uncertainty. Each K_ij(T) gets a smooth curve
(fit/curve.py), and ``M(T) = K(T)^-1`` with dM = -M dK M. K is the best straight line over the imposed rates. The dynamic table
contains the curvature.

Dynamic drift is the rate error that remains, per axis, as a table over measured rate and temperature: ``e(w, T) = w - true rate``
with the measured rate w about the axis itself, so that the lookup needs no inversion. A smooth surface with e(0, T) = 0, a tensor
product of cubic splines, is fitted to the steps of all soaks::

    r_k = e(w_k, T_k) + d_m(k) + noise          e(w, T) = sum_ij c_ij B_i(w) B_j(T)
    minimise  sum (r_k - e_k - d_m)^2 / v_k + integral (d2e/dw2)^2 / s_w^2 + integral (d2e/dT2)^2 / s_T^2

The penalty is the prior of the surface, which gives the covariance [1]_. The softness (s_w, s_T) maximises the restricted
likelihood of this prior, and the variances v include the excess of the residuals over the known variances.

References
----------
.. [1] G. Wahba, "Bayesian confidence intervals for the cross-validated smoothing spline", J. R. Stat. Soc. B 45, 1983, 133-150.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, interpolated
from undrift.drift.observe import RateSteps, not_observable
from undrift.drift.offset import known_variance, near_data
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.curve import Cubics, fit_curve
from undrift.fit.gls import determined, excess_variance
from undrift.fit.triad import inverse_jacobian
from undrift.model import AXES, DynamicDrift, ScaleDrift, StaticDrift, TriadModel, Verdict
from undrift.units import si_factor

STEP_C = 5.0  # between the nodes of the dynamic table
# a node between soaks and further from both is extrapolated: matrices change more evenly than offsets
MATRIX_GAP_C = 10.0
MAINLY = 0.9  # least share of a turning rate that is about an axis of the case
SAME_RATE = 0.01  # relative to the largest rate: closer rates are equal
NEAR_RATE = 0.02  # relative to the largest rate: a node this far beyond the measured rates is not extrapolated
LOOSE = 1e2  # prior variance of d, in units of the residuals' mean square: it is free
SOFTNESS = (1e-2, 1e-1, 1.0, 1e1, 1e2)  # s_w and s_T, relative to the spans and the residuals, from stiff to soft
FREE = 2  # surfaces w and w T, which have no penalty
MAX_INTERVALS = 6  # intervals of 30 deg/s over the note's rates
LEAST_DIGIT = 1e-9  # relative to the readings, the arithmetic error of a mean
LEAST_NOISE = 1e-6  # relative to the values (rad/s if all values are 0), below which noise cannot be resolved


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps(RateSteps):
    """Usable rate steps, n rows. The offset is subtracted from the readings, and soaks are numbered over all sessions."""

    mounting: IntArray  # (n,), numbered over all soaks
    axis: IntArray  # (n,), main axis about which the mounting turned
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SoakMatrices:
    """The forward matrix at each of S soaks."""

    temp_c: FloatArray  # (S,), mean temperature of the soak's steps, degC, increasing
    forward: FloatArray  # (S, 3, 3), K, raw unit per rad/s: sensor, axis, or NaN for an axis that the soak did not turn
    variance: FloatArray  # (S, 3, 3), of each element, that unit squared


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaleFit:
    """The matrix over temperature."""

    drift: ScaleDrift  # gyroscope matrices at the nodes
    soaks: SoakMatrices
    forward: FloatArray  # (n, 3, 3), K at the nodes, raw unit per rad/s
    uncertainty: FloatArray  # (n, 3, 3), of each element, or NaN for an axis that was not turned
    verdict: Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DynamicFit:
    """The table of rate-dependent drift."""

    drift: DynamicDrift  # an axis that was not turned has zeros with uncertainty NaN
    surfaces: tuple["Surface | None", ...]  # per axis, or None if the axis was not turned
    verdict: Verdict


# ---- rate steps made ready


def prepared(steps: RateSteps, model: TriadModel, *, static: StaticDrift | None) -> Steps:
    """Return the usable rows of rate steps without their offsets: those of mountings that turned at two rates or more."""
    finite = np.isfinite(steps.gyro).all(axis=1) & np.isfinite(steps.rate_b).all(axis=1) & np.isfinite(steps.temp_c)
    usable = steps.taken(finite & steps.rate_b.any(axis=1))
    if not len(usable):
        raise InputError(
            f"rate steps: none of {len(steps)} dwells has rate, reading and temperature. Check turn_rate_dps, temp_c and gaps."
        )
    soak, axis = _number_groups(usable.session, usable.soak), np.abs(usable.rate_b).argmax(axis=1)
    mounting, turn_rate = _number_groups(soak, axis), usable.rate_b[np.arange(len(axis)), axis]
    spans = np.array([np.ptp(turn_rate[mounting == m]) for m in range(mounting.max() + 1)])
    rows = spans[mounting] > SAME_RATE * np.abs(turn_rate).max()
    rows &= np.abs(turn_rate) > MAINLY * np.linalg.norm(usable.rate_b, axis=1)
    if not rows.any():
        raise NotObservable(
            "rate steps: no axis was turned at two rates in a soak. Turn about each axis in both directions."
        )
    lost = int((~finite).sum() + (~rows).sum())
    left_out = (
        f"{lost} of {len(steps)} rate steps were left out: they have gaps, a single rate in a soak, or an axis between the axes of "
        "the case."
    )
    return Steps(
        session=usable.session,
        soak=soak,
        mounting=mounting,
        axis=axis,
        temp_c=usable.temp_c,
        rate_b=usable.rate_b,
        gyro=usable.gyro - _offset_at(usable.temp_c, model, static),
        gyro_variance=np.maximum(
            known_variance(usable.gyro_variance), (LEAST_DIGIT * np.abs(usable.gyro).max(axis=0)) ** 2
        ),
        findings=(finding("drift.left_out", "warn", left_out),) if lost else (),
    ).taken(rows)


def _number_groups(*keys: IntArray) -> IntArray:
    """Return the number of each combination of keys, (n,)."""
    return np.unique(np.column_stack(keys), axis=0, return_inverse=True)[1].reshape(-1)


def _offset_at(temp_c: FloatArray, model: TriadModel, static: StaticDrift | None) -> FloatArray:
    """Return the gyroscopes' offset at temperatures (n,), (n, 3): from the table, or the constant."""
    if static is None or static.gyro_offset is None:
        return np.tile(model.offset, (len(temp_c), 1))
    return interpolated(temp_c, static.temp_c, static.gyro_offset)


def measured_rate(reading: FloatArray, temp_c: FloatArray, model: TriadModel, scale: ScaleDrift | None) -> FloatArray:
    """Return the rate M(T) y of mean readings without offset, y (n, 3), rad/s."""
    matrix = np.tile(model.matrix, (len(temp_c), 1, 1))
    if scale is not None and scale.gyro_matrix is not None:
        matrix = interpolated(temp_c, scale.temp_c, scale.gyro_matrix)
    return np.asarray(np.einsum("nij,nj->ni", matrix, reading) * si_factor(model.unit_out, "rate"))


# ---- matrix over temperature


def fit_scale(steps: Steps, model: TriadModel, *, temp_c: FloatArray) -> ScaleFit:
    """Fit the gyroscopes' matrix over temperature, at nodes (n,), degC."""
    soaks = soak_matrices(steps, model)
    turned_soaks = np.isfinite(soaks.forward[:, 0, :])
    count = turned_soaks.sum(axis=0)
    spans_c = [float(np.ptp(soaks.temp_c[rows])) if rows.any() else 0.0 for rows in turned_soaks.T]
    if max(spans_c) <= 0.0:
        raise NotObservable(
            f"scale over temperature: expected rate steps at two soaks or more, got {count.max()}. Repeat the steps at another "
            "temperature, ten degrees or more away.",
            soaks=int(count.max()),
        )
    forward = np.tile(_forward(model), (len(temp_c), 1, 1))
    variance = np.full(forward.shape, np.nan)
    for j in np.flatnonzero(spans_c):
        rows = turned_soaks[:, j]
        nodes = fit_curve(soaks.temp_c[rows], soaks.forward[rows, :, j], soaks.variance[rows, :, j]).at(temp_c)
        forward[:, :, j], variance[:, :, j] = nodes.value, nodes.uncertainty**2
    matrix, unknown = np.linalg.inv(forward), np.isnan(variance)
    jacobian = np.stack([inverse_jacobian(m) for m in matrix])
    spread = np.sqrt(np.einsum("nij,nj->ni", jacobian**2, np.where(unknown, 0.0, variance).reshape(-1, 9)))
    unit_per_si = 1.0 / si_factor(model.unit_out, "rate")
    open_axes = ", ".join(AXES[j] for j in np.flatnonzero(count < 2))
    findings = [_axis_not_turned(f"Scale factor {open_axes} over temperature")] if open_axes else []
    return ScaleFit(
        drift=ScaleDrift(
            temp_c=temp_c,
            gyro_matrix=matrix * unit_per_si,
            gyro_uncertainty=np.where(unknown, np.nan, spread.reshape(-1, 3, 3))
            * unit_per_si,  # column j of M has the uncertainty of column j of K
            gyro_extrapolated=~near_data(temp_c, soaks.temp_c, gap_c=MATRIX_GAP_C),
        ),
        soaks=soaks,
        forward=forward,
        uncertainty=np.sqrt(variance),
        verdict=Verdict.of(*steps.findings, *findings),
    )


def _axis_not_turned(what: str) -> Finding:
    problem = "the device was not turned about this axis at two rates and two temperatures."
    return not_observable("warn", what, problem, "Turn about it both ways at three soaks or more.")


def soak_matrices(steps: Steps, model: TriadModel) -> SoakMatrices:
    """Fit the forward matrix at each soak: column j to the turns about axis j, each mounting with its own offset."""
    numbers = np.unique(steps.soak)
    temp_c = np.array([steps.temp_c[steps.soak == s].mean() for s in numbers])
    constant, forward, variance = _forward(model), *np.full((2, len(numbers), 3, 3), np.nan)
    for m in np.unique(steps.mounting):
        rows = np.flatnonzero(steps.mounting == m)
        j, k = steps.axis[rows[0]], np.searchsorted(numbers, steps.soak[rows[0]])
        rate, beside = steps.rate_b[rows, j], steps.rate_b[rows] * (np.arange(3) != j)
        reading, size = steps.gyro[rows] - beside @ constant.T, np.abs(rate).max()
        design = np.column_stack((rate / size, np.ones(len(rows))))
        for i in range(3):
            theta, covariance = _weigh(design, reading[:, i], steps.gyro_variance[rows, i])
            forward[k, i, j], variance[k, i, j] = theta[0] / size, covariance[0, 0] / size**2
    order = np.argsort(temp_c, kind="stable")
    return SoakMatrices(temp_c=temp_c[order], forward=forward[order], variance=variance[order])


def _forward(model: TriadModel) -> FloatArray:
    return np.asarray(model.forward_matrix / si_factor(model.unit_out, "rate"))


def _weigh(design: FloatArray, y: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return least-squares parameters and their covariance for values y (n,) of variance v (n,), and of their excess."""
    residual = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    v = v + excess_variance(residual, v, len(y) - design.shape[1])
    covariance = np.linalg.inv(design.T @ (design / v[:, None]))
    return covariance @ (design.T @ (y / v)), covariance


# ---- dynamic drift


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SurfacePoints:
    """Residual rates of an axis, n rows."""

    turn_rate: FloatArray  # (n,), measured rate, rad/s
    temp_c: FloatArray  # (n,), degC
    value: FloatArray  # (n,), measured minus imposed rate, rad/s
    variance: FloatArray  # (n,), of the value, (rad/s)^2
    soak: IntArray  # (n,), from 0
    mounting: IntArray  # (n,), from 0, rows with the same number share d

    def __len__(self) -> int:
        return len(self.value)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surface:
    """A fitted surface."""

    rate: Cubics
    temp: Cubics
    coefficients: FloatArray  # (P,), c in the splines that vanish at rate zero
    covariance: FloatArray  # (P, P), of c, (rad/s)^2
    softness: tuple[float, float]  # s_w and s_T, in spans and residuals

    def at(self, turn_rate: FloatArray, temp_c: FloatArray) -> FloatArray:
        """Return e at points (n,), rad/s."""
        return np.asarray(_design(self.rate, self.temp, turn_rate, temp_c) @ self.coefficients)

    def uncertainty(self, turn_rate: FloatArray, temp_c: FloatArray) -> FloatArray:
        """Return the standard uncertainty of e at points (n,), rad/s."""
        x = _design(self.rate, self.temp, turn_rate, temp_c)
        return np.asarray(np.sqrt(np.maximum(np.einsum("np,np->n", x @ self.covariance, x), 0.0)))


def fit_dynamic(
    steps: Steps,
    model: TriadModel,
    *,
    span_c: tuple[float, float],
    scale: ScaleDrift | None = None,
) -> DynamicFit:
    """Fit the dynamic drift of the gyroscopes.

    Nodes are the imposed rates, zero and the ends of the measured rates, rad/s, and temperatures every 5 degC with the ends of
    ``span_c``.
    """
    points = [_surface_points(axis, steps, model, scale) for axis in range(3)]
    axis_points = [data for data in points if data is not None]
    if not axis_points:
        soaks = len(np.unique(steps.soak))
        raise NotObservable(
            f"dynamic drift: each axis needs turns in three soaks or more, got {len(steps)} turns on all axes together (number of "
            f"soaks: {soaks}, {steps.temp_c.min():.1f} to {steps.temp_c.max():.1f} degC). Repeat the turns at another temperature.",
            soaks=soaks,
        )
    low_c, high_c = span_c
    between = STEP_C * np.arange(np.floor(low_c / STEP_C) + 1.0, np.ceil(high_c / STEP_C))
    temp_c = np.concatenate(([low_c], between, [high_c]))
    imposed = np.take_along_axis(steps.rate_b, steps.axis[:, None], axis=1)
    turn_rate = _rate_nodes(imposed[:, 0], np.concatenate([data.turn_rate for data in axis_points]))
    grid_w, grid_t = np.tile(turn_rate, len(temp_c)), np.repeat(temp_c, len(turn_rate))
    shape = (len(temp_c), len(turn_rate))
    error, uncertainty, extrapolated = np.zeros((*shape, 3)), np.full((*shape, 3), np.nan), np.zeros(shape, bool)
    surfaces: list[Surface | None] = [None, None, None]
    findings = list(steps.findings)
    for axis, data in enumerate(points):
        if data is None:
            findings.append(_axis_not_turned(f"Dynamic drift {AXES[axis]}"))
            continue
        surface = surfaces[axis] = fit_surface(
            data,
            rate_span=(float(turn_rate[0]), float(turn_rate[-1])),
            temp_span=span_c,
        )
        error[:, :, axis] = surface.at(grid_w, grid_t).reshape(shape)
        uncertainty[:, :, axis] = surface.uncertainty(grid_w, grid_t).reshape(shape)
        extrapolated |= _unseen(data, turn_rate, temp_c)
    drift = DynamicDrift(
        temp_c=temp_c, turn_rate=turn_rate, error=error, uncertainty=uncertainty, extrapolated=extrapolated
    )
    return DynamicFit(drift=drift, surfaces=tuple(surfaces), verdict=Verdict.of(*findings))


def _surface_points(axis: int, steps: Steps, model: TriadModel, scale: ScaleDrift | None) -> SurfacePoints | None:
    """Return the rows of mountings that turned about an axis, or None without three soaks."""
    axis_steps = steps.taken(steps.axis == axis)
    if len(np.unique(axis_steps.soak)) < 3:
        return None
    rate = measured_rate(axis_steps.gyro, axis_steps.temp_c, model, scale)[:, axis]
    row = measured_rate(np.eye(3), np.zeros(3), model, None)[:, axis]  # row of M
    return SurfacePoints(
        turn_rate=rate,
        temp_c=axis_steps.temp_c,
        value=rate - axis_steps.rate_b[:, axis],
        variance=axis_steps.gyro_variance @ row**2,
        soak=_number_groups(axis_steps.soak),
        mounting=_number_groups(axis_steps.mounting),
    )


def _rate_nodes(imposed: FloatArray, measured: FloatArray) -> FloatArray:
    """Return the imposed rates, zero, and the ends of the measured rates if they are beyond, rad/s."""
    tolerance, rates = SAME_RATE * float(np.abs(imposed).max()), np.sort(np.append(imposed, 0.0))
    groups = np.split(rates, np.flatnonzero(np.diff(rates) > tolerance) + 1)
    nodes = np.array([0.0 if (group == 0.0).any() else group.mean() for group in groups])
    ends = np.array([measured.min(), measured.max()])
    return np.sort(np.append(nodes, ends[(ends < nodes[0] - tolerance) | (ends > nodes[-1] + tolerance)]))


def _unseen(points: SurfacePoints, turn_rate: FloatArray, temp_c: FloatArray) -> BoolArray:
    """Mark nodes beyond the temperatures, or beyond the rates that were measured around their temperature."""
    soaks = [points.soak == s for s in np.unique(points.soak)]
    soaks.sort(key=lambda rows: float(points.temp_c[rows].mean()))
    soak_c = np.array([points.temp_c[rows].mean() for rows in soaks])
    low = np.interp(temp_c, soak_c, [min(points.turn_rate[rows].min(), 0.0) for rows in soaks])[:, None]
    high = np.interp(temp_c, soak_c, [max(points.turn_rate[rows].max(), 0.0) for rows in soaks])[:, None]
    slack = NEAR_RATE * float(np.abs(points.turn_rate).max())
    outside = (turn_rate < low - slack) | (turn_rate > high + slack)
    return np.asarray(outside | ~near_data(temp_c, soak_c, gap_c=MATRIX_GAP_C)[:, None])


# ---- the surface e(w, T) with e(0, T) = 0 through scattered points


@determined("rate drift")
def fit_surface(points: SurfacePoints, *, rate_span: tuple[float, float], temp_span: tuple[float, float]) -> Surface:
    """Fit a surface to the residual rates of an axis at three soaks or more, with the most likely softness."""
    soaks, levels = len(np.unique(points.soak)), len(np.unique(points.turn_rate))
    low, high = (float(f((*rate_span, 0.0, f(points.turn_rate)))) for f in (min, max))
    cold, hot = (float(f((*temp_span, f(points.temp_c)))) for f in (min, max))
    rate = Cubics(low=low, high=high, intervals=min(MAX_INTERVALS, max(2, levels // 2)))
    temp = Cubics(low=cold, high=hot, intervals=min(MAX_INTERVALS, soaks - 1))
    groups = int(points.mounting.max()) + 1
    value = points.value - (np.bincount(points.mounting, points.value) / np.bincount(points.mounting))[points.mounting]
    surface = _design(rate, temp, points.turn_rate, points.temp_c)
    x, p = np.column_stack((surface, np.eye(groups)[points.mounting])), surface.shape[1]
    size = max(float(np.sqrt(np.mean(value**2))), float(np.sqrt(points.variance.min())), LEAST_NOISE)
    known_variance, excess = np.maximum(points.variance, (LEAST_NOISE * size) ** 2), 0.0  # a device without noise
    flat, bent = (_vanishing(rate).T @ rate.products(d) @ _vanishing(rate) for d in (0, 2))
    bends = np.kron(temp.products(0), bent), np.kron(temp.products(2), flat)

    def solved(softness: tuple[float, float], v: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Return the coefficients of surface and offsets, their covariance, and minus twice the log likelihood."""
        roughness = bends[0] / (softness[0] * size) ** 2 + bends[1] / (softness[1] * size) ** 2
        penalty = np.eye(p + groups) / (LOOSE * size**2)
        penalty[:p, :p] = roughness
        precision = x.T @ (x / v[:, None]) + penalty
        covariance = np.linalg.inv(precision)
        c = covariance @ (x.T @ (value / v))
        stiff = np.linalg.eigvalsh(roughness)[FREE:]
        misfit = ((value - x @ c) ** 2 / v).sum() + c @ penalty @ c
        loss = np.linalg.slogdet(precision)[1] - np.log(stiff).sum() + np.log(v).sum() + misfit
        return c, covariance, float(loss)

    choices = [(w, t) for t in SOFTNESS for w in SOFTNESS]
    for _ in range(3):  # the excess follows from the residuals, and the softness from both
        v = known_variance + excess
        best = min(choices, key=lambda softness: solved(softness, v)[2])
        c, covariance, _ = solved(best, v)
        freedom = len(value) - float(((x @ covariance) * x / v[:, None]).sum())
        excess = excess_variance(value - x @ c, known_variance, round(freedom))
    return Surface(
        rate=rate,
        temp=temp,
        coefficients=c[:p],
        covariance=covariance[:p, :p],
        softness=best,
    )


def _design(rate: Cubics, temp: Cubics, turn_rate: FloatArray, temp_c: FloatArray) -> FloatArray:
    over_rate, over_temp = rate.at(turn_rate) @ _vanishing(rate), temp.at(temp_c)
    return np.asarray((over_temp[:, :, None] * over_rate[:, None, :]).reshape(len(turn_rate), -1))


def _vanishing(rate: Cubics) -> FloatArray:
    """Return combinations of the splines, one per column, that are zero at rate zero."""
    return np.asarray(np.linalg.svd(rate.at(np.zeros(1)))[2][1:].T)
