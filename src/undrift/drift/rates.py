"""Matrix and dynamic drift over temperature, from rate steps at several soaks.

Offsets of the static table are subtracted first. A mounting is a part of a soak in which the device turned about one direction of
its case. In a soak each sensor i reads ::

    u_i - offset_i(T) = sum_j K_ij w_j + d_im + noise        axes j, mounting m

Turns are about the axes of the case. Each turn determines the column of K for its axis. d is the offset error of the table
(hysteresis, warm-up, g-sensitivity). Each mounting determines its d, because it has two rates or more. A mounting with a single
rate is omitted. If no soak contains turns about an axis, the axis keeps its column of K from the calibration, without an
uncertainty. Each K_ij(T) gets a smooth curve (fit/curve.py), and ``M(T) = K(T)^-1`` with dM = -M dK M. K is the best straight line
over the imposed rates. The dynamic table contains the curvature.

Dynamic drift is the rate error that remains, per axis, as a table over measured rate and temperature: ``e(w, T) = w - true rate``
with the measured rate w about the axis itself, so that the lookup needs no inversion. At each soak it is a polynomial without a
constant, because d contains the constant part::

    w_k - true rate_k = d + sum_n c_n w_k^n + noise        n = 1 .. 5, at most half the number of rates

Its values at the nodes of the rate get smooth curves over temperature, as the elements of K do.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, interpolated
from undrift.drift.observe import RateSteps, not_observable
from undrift.drift.offset import known_variance, near_data
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.curve import fit_curve
from undrift.fit.gls import determined, excess_variance
from undrift.fit.triad import inverse_jacobian
from undrift.model import AXES, DynamicDrift, ScaleDrift, StaticDrift, TriadModel
from undrift.units import si_factor

STEP_C = 5.0  # between the nodes of the dynamic table
# distance from both neighbouring soaks from which a node is extrapolated: matrices change more evenly than offsets
MATRIX_GAP_C = 10.0
MAINLY = 0.9  # smallest share of a turn rate that is about an axis of the case
SAME_RATE = 0.01  # relative to the largest rate: rates closer than this are equal
NEAR_RATE = 0.02  # relative to the largest rate: a node up to this far beyond the measured rates is not extrapolated
HIGHEST_POWER = 5  # highest power of the rate
LEAST_DIGIT = 1e-9  # arithmetic error of a mean, relative to the readings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps(RateSteps):
    """Usable rate steps, n rows. The offset is subtracted from the readings, and soaks are numbered over all sessions."""

    mounting: IntArray  # (n,), number of the mounting, over all soaks
    axis: IntArray  # (n,), main axis about which the mounting turned
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SoakMatrices:
    """The forward matrix at each of S soaks."""

    temp_c: FloatArray  # (S,), mean temperature of the soak's steps, degC, increasing
    forward: FloatArray  # (S, 3, 3), K, raw unit per rad/s: sensor, axis, or NaN for an axis that the soak did not turn
    variance: FloatArray  # (S, 3, 3), variance of each element, that unit squared


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaleFit:
    """The matrix over temperature."""

    drift: ScaleDrift  # gyroscope matrices at the nodes
    soaks: SoakMatrices
    forward: FloatArray  # (n, 3, 3), K at the nodes, raw unit per rad/s
    uncertainty: FloatArray  # (n, 3, 3), uncertainty of each element, or NaN for an axis that was not turned
    findings: tuple[Finding, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DynamicFit:
    """The table of rate-dependent drift."""

    drift: DynamicDrift  # an axis that was not turned has zeros with uncertainty NaN
    findings: tuple[Finding, ...]


# ---- preparation of rate steps


def prepared(steps: RateSteps, model: TriadModel, *, static: StaticDrift | None) -> Steps:
    """Return the usable rate steps without their offsets: the rows of mountings that turned at two rates or more."""
    finite = np.isfinite(steps.gyro).all(axis=1) & np.isfinite(steps.rate_b).all(axis=1) & np.isfinite(steps.temp_c)
    usable = steps.taken(finite & steps.rate_b.any(axis=1))
    if not len(usable):
        raise InputError(
            f"rate steps: none of the {len(steps)} dwells has rate, reading and temperature. Check turn_rate_dps, temp_c and gaps."
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
    offset: FloatArray = np.tile(model.offset, (len(usable), 1))
    if static is not None and static.gyro_offset is not None:
        offset = interpolated(usable.temp_c, static.temp_c, static.gyro_offset)
    lost = int((~finite).sum() + (~rows).sum())
    left_out = (
        f"{lost} of {len(steps)} rate steps were omitted: they have gaps, a single rate in a soak, or a turn axis that is not an "
        f"axis of the case."
    )
    return Steps(
        session=usable.session,
        soak=soak,
        mounting=mounting,
        axis=axis,
        temp_c=usable.temp_c,
        rate_b=usable.rate_b,
        gyro=usable.gyro - offset,
        gyro_variance=np.maximum(
            known_variance(usable.gyro_variance), (LEAST_DIGIT * np.abs(usable.gyro).max(axis=0)) ** 2
        ),
        findings=(finding("drift.left_out", "warn", left_out),) if lost else (),
    ).taken(rows)


def _number_groups(*keys: IntArray) -> IntArray:
    """Return the number of each combination of keys, (n,)."""
    return np.unique(np.column_stack(keys), axis=0, return_inverse=True)[1].reshape(-1)


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
        findings=(*steps.findings, *findings),
    )


def _axis_not_turned(what: str) -> Finding:
    problem = "the device was not turned about this axis at two rates and two temperatures."
    return not_observable("warn", what, problem, "Turn the device about it in both directions at three soaks or more.")


def soak_matrices(steps: Steps, model: TriadModel) -> SoakMatrices:
    """Fit the forward matrix at each soak: column j to the turns about axis j, with a separate offset for each mounting."""
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
    """Return least-squares parameters and their covariance, for values y (n,) with the variance v (n,) and an excess variance."""
    residual = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    v = v + excess_variance(residual, v, len(y) - design.shape[1])
    covariance = np.linalg.inv(design.T @ (design / v[:, None]))
    return covariance @ (design.T @ (y / v)), covariance


# ---- dynamic drift


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
    turned = [axis for axis in range(3) if len(np.unique(steps.soak[steps.axis == axis])) >= 3]
    if not turned:
        soaks = len(np.unique(steps.soak))
        raise NotObservable(
            f"dynamic drift: each axis needs turns in three soaks or more, got {len(steps)} turns on all axes together (number of "
            f"soaks: {soaks}, {steps.temp_c.min():.1f} to {steps.temp_c.max():.1f} degC). Repeat the turns at another temperature.",
            soaks=soaks,
        )
    low_c, high_c = span_c
    between = STEP_C * np.arange(np.floor(low_c / STEP_C) + 1.0, np.ceil(high_c / STEP_C))
    temp_c = np.concatenate(([low_c], between, [high_c]))
    imposed = np.take_along_axis(steps.rate_b, steps.axis[:, None], axis=1)[:, 0]
    rates = measured_rate(steps.gyro, steps.temp_c, model, scale)
    measured = np.take_along_axis(rates, steps.axis[:, None], axis=1)[:, 0]
    turn_rate = _rate_nodes(imposed, measured[np.isin(steps.axis, turned)])
    shape = (len(temp_c), len(turn_rate))
    error, uncertainty, extrapolated = np.zeros((*shape, 3)), np.full((*shape, 3), np.nan), np.zeros(shape, bool)
    findings = [*steps.findings, *(_axis_not_turned(f"Dynamic drift {AXES[k]}") for k in {0, 1, 2} - {*turned})]
    for axis in turned:
        rows = steps.axis == axis
        row = measured_rate(np.eye(3), np.zeros(3), model, None)[:, axis]  # row of M
        error[:, :, axis], uncertainty[:, :, axis] = _fit_axis(
            measured[rows],
            value=measured[rows] - imposed[rows],
            variance=steps.gyro_variance[rows] @ row**2,
            temp_c=steps.temp_c[rows],
            soak=steps.soak[rows],
            nodes=(temp_c, turn_rate),
        )
        extrapolated |= _unseen(measured[rows], steps.temp_c[rows], steps.soak[rows], turn_rate, temp_c)
    drift = DynamicDrift(
        temp_c=temp_c, turn_rate=turn_rate, error=error, uncertainty=uncertainty, extrapolated=extrapolated
    )
    return DynamicFit(drift=drift, findings=tuple(findings))


@determined("rate drift")
def _fit_axis(
    rate: FloatArray,
    *,
    value: FloatArray,
    variance: FloatArray,
    temp_c: FloatArray,
    soak: IntArray,
    nodes: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return e of an axis at nodes of temperature (m,) and rate (k,), and its standard uncertainty, (m, k), rad/s."""
    soaks, size = [soak == number for number in np.unique(soak)], float(np.abs(rate).max())
    levels = min(len(np.unique(np.round((rate - value)[rows] / (SAME_RATE * size)))) for rows in soaks)
    powers = np.arange(1, max(1, min(levels // 2, HIGHEST_POWER)) + 1)
    theta, covariance = np.zeros((len(soaks), len(powers))), np.zeros((len(soaks), len(powers), len(powers)))
    for k, rows in enumerate(soaks):
        design = np.column_stack((np.ones(rows.sum()), (rate[rows, None] / size) ** powers))
        solution, spread = _weigh(design, value[rows], variance[rows])
        theta[k], covariance[k] = solution[1:], spread[1:, 1:]
    # along the axes of their mean covariance, the errors of the coefficients are independent
    vectors = np.linalg.eigh(covariance.mean(axis=0))[1]
    variances = np.einsum("pq,spr,rq->sq", vectors, covariance, vectors)
    soak_c = np.array([temp_c[rows].mean() for rows in soaks])
    curve = fit_curve(soak_c, theta @ vectors, variances).at(nodes[0])
    basis = ((nodes[1][:, None] / size) ** powers @ vectors).T
    return curve.value @ basis, np.sqrt(curve.uncertainty**2 @ basis**2)


def _rate_nodes(imposed: FloatArray, measured: FloatArray) -> FloatArray:
    """Return the imposed rates, zero, and the ends of the measured rates if they are beyond, rad/s."""
    tolerance, rates = SAME_RATE * float(np.abs(imposed).max()), np.sort(np.append(imposed, 0.0))
    groups = np.split(rates, np.flatnonzero(np.diff(rates) > tolerance) + 1)
    nodes = np.array([0.0 if (group == 0.0).any() else group.mean() for group in groups])
    ends = np.array([measured.min(), measured.max()])
    return np.sort(np.append(nodes, ends[(ends < nodes[0] - tolerance) | (ends > nodes[-1] + tolerance)]))


def _unseen(
    rate: FloatArray, rate_temp_c: FloatArray, soak: IntArray, turn_rate: FloatArray, temp_c: FloatArray
) -> BoolArray:
    """Mark nodes beyond the measured temperatures, or beyond the rates measured near their temperature."""
    soaks = [soak == number for number in np.unique(soak)]
    soaks.sort(key=lambda rows: float(rate_temp_c[rows].mean()))
    soak_c = np.array([rate_temp_c[rows].mean() for rows in soaks])
    low = np.interp(temp_c, soak_c, [min(rate[rows].min(), 0.0) for rows in soaks])[:, None]
    high = np.interp(temp_c, soak_c, [max(rate[rows].max(), 0.0) for rows in soaks])[:, None]
    slack = NEAR_RATE * float(np.abs(rate).max())
    outside = (turn_rate < low - slack) | (turn_rate > high + slack)
    return np.asarray(outside | ~near_data(temp_c, soak_c, gap_c=MATRIX_GAP_C)[:, None])
