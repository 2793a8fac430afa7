"""What rate steps at several soaks show: the matrix over temperature, and the dynamic drift that is left.

Matrix over temperature, that is thermal scale factor and cross-axis.
At one soak, after the offset table is subtracted, each sensor i reads ::

    u_i - offset_i(T) = sum_j K_ij w_j + d_im + noise        j the axes that were turned, m the mounting

A mounting is a stretch of one soak in which the device turned about one direction of its case. d is what soak and mounting leave of
the offset (hysteresis, warm-up, g-sensitivity); it is fitted where a mounting has two rates or more. Where it has one rate, one way
round, the mean reading of the rests of the same soak is its zero; without rests the table is. An axis that no soak turned
keeps its column of K from the calibration and has no uncertainty: nothing is known of it. Each K_ij(T) goes through a smoothing
curve (fit/curve.py), and ``M(T) = K(T)^-1`` with dM = -M dK M.

K is the best straight line over the imposed rates. What bends belongs to the dynamic table; so the noise is what a line, a
parabola and a cubic leave.

Dynamic drift is the rate-dependent error after offset(T) and matrix, per axis, as a table over measured rate and temperature.

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
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, interpolated
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.drift.offset import near_data
from undrift.errors import InputError, NotObservable
from undrift.findings import finding
from undrift.fit.curve import Cubics, fit_curve
from undrift.fit.equations import inverse_jacobian
from undrift.fit.least_squares import determined, excess_variance
from undrift.model import AXES, Calibration, DynamicDrift, ScaleDrift, StaticDrift, TriadModel, Verdict
from undrift.units import si_factor

_BENT = 8  # rows of a mounting from which a parabola and a cubic differ from noise
_SAME_DIRECTION = 0.98  # cosine
_SAME_POSE = 0.2  # of the largest difference between two poses, or of gravity
_SAME_RATE = 0.01  # of the greatest: rates of one mounting nearer to each other are one, and imposed rates one node
_SAME_TEMPERATURE_C = 1.5
# a node between soaks and further from both is extrapolated: matrices change more evenly than offsets
MATRIX_GAP_C = 10.0
# ---- and of the dynamic drift
DEFAULT_STEP_C = 5.0
_MAINLY = 0.5  # share of the turning rate from which a row counts for an axis
_NEAR_RATE = 0.02  # of the greatest: how far beyond the measured rates a node still counts as seen
_LOOSE = 1e2  # variance of d_g about the mean of its rows, in units of the residuals' own: it is free
_SOFTNESS = (1e-2, 1e-1, 1.0, 1e1, 1e2)  # prior size of a second derivative, in spans and in residuals; stiff first
_MOST_INTERVALS = 6  # of 30 deg/s over the note's rates
_NEGLIGIBLE = 1e-2  # weight
_LEAST = 1e-6  # of the values: less noise is beyond what the equations resolve; rad/s where all values are 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps(RateSteps):
    """Usable rate steps, n rows; the variance is the median where it is not known."""

    mounting: IntArray  # (n,), numbered from 0 over all soaks, as soaks are over all sessions
    along: FloatArray  # (n,), rate along the direction of its mounting, rad/s
    verdict: Verdict  # what was left out


# Temperature, K, its variance, residuals: a row of SoakMatrices
Soak: TypeAlias = tuple[float, FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class SoakMatrices:
    """The forward matrix at each of S soaks."""

    temp_c: FloatArray  # (S,), mean temperature of the soak's steps, degC, increasing
    forward: FloatArray  # (S, 3, 3), K, raw unit per rad/s: sensor, axis; NaN for an axis that the soak did not turn
    variance: FloatArray  # (S, 3, 3), of each element, that unit squared
    rms: FloatArray  # (S, 3), residual of each sensor about its line, raw unit

    @property
    def seen(self) -> BoolArray:
        """Which axes each soak turned, shape (S, 3)."""
        return np.asarray(np.isfinite(self.forward[:, 0, :]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaleFit:
    """The matrix over temperature."""

    drift: ScaleDrift  # gyroscope matrices at the nodes
    soaks: SoakMatrices
    # (3,), thermal sensitivity of each scale factor, %/K of its value at the reference temperature; NaN where not seen
    percent_per_k: FloatArray
    percent_per_k_uncertainty: FloatArray  # (3,), standard uncertainty of that
    verdict: Verdict


def fit_scale(
    steps: RateSteps, calibration: Calibration, *, static: StaticDrift | None, temp_c: FloatArray
) -> ScaleFit:
    """Fit the gyroscopes' matrix over temperature, at nodes (n,), degC."""
    clean, model = steps_of(steps), gyro_model(calibration)
    soaks = soak_matrices(clean, calibration, static=static)
    forward, variance = _over_temperature(soaks, model, temp_c)
    matrix = np.linalg.inv(forward)
    jacobian = np.stack([inverse_jacobian(m) for m in matrix])
    unknown = np.isnan(variance)
    spread = np.sqrt(np.einsum("nij,nj->ni", jacobian**2, np.where(unknown, 0.0, variance).reshape(-1, 9)))
    uncertainty = np.where(unknown, np.nan, spread.reshape(-1, 3, 3))  # column j of M needs column j of K
    to_out = 1.0 / si_factor(model.unit_out, "rate")
    slope, doubt = _sensitivity(soaks, calibration.reference_temp_c)
    drift = ScaleDrift(
        temp_c=temp_c,
        gyro_matrix=matrix * to_out,
        gyro_uncertainty=uncertainty * to_out,
        gyro_extrapolated=~near_data(temp_c, soaks.temp_c, gap_c=MATRIX_GAP_C),
    )
    verdict = _verdict(soaks).also(clean.verdict)
    return ScaleFit(drift=drift, soaks=soaks, percent_per_k=slope, percent_per_k_uncertainty=doubt, verdict=verdict)


def scale_matrices(
    steps: Steps, calibration: Calibration, *, static: StaticDrift | None, temp_c: FloatArray
) -> ScaleDrift:
    """Return the matrices of ``fit_scale`` alone."""
    model = gyro_model(calibration)
    forward, _ = _over_temperature(soak_matrices(steps, calibration, static=static), model, temp_c, spread=False)
    return ScaleDrift(temp_c=temp_c, gyro_matrix=np.linalg.inv(forward) / si_factor(model.unit_out, "rate"))


def soak_matrices(steps: Steps, calibration: Calibration, *, static: StaticDrift | None) -> SoakMatrices:
    """Fit the forward matrix at each soak."""
    kept = _forward(gyro_model(calibration))
    own = steps.gyro - offset_at(steps.temp_c, calibration, static)
    parts = [_one_soak(steps, own, np.flatnonzero(steps.soak == s), kept) for s in np.unique(steps.soak)]
    parts.sort(key=lambda part: part[0])
    return SoakMatrices(*(np.array(column) for column in zip(*parts, strict=True)))


def _forward(model: TriadModel) -> FloatArray:
    return np.asarray(model.forward_matrix / si_factor(model.unit_out, "rate"))


def _weighted(
    design: FloatArray, y: FloatArray, v: FloatArray, full: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return least-squares parameters and their covariance for values y (n,) of variance v (n,) and what the full design leaves."""
    full = design if full is None else full
    found, _, rank, _ = np.linalg.lstsq(full, y, rcond=None)
    v = v + excess_variance(y - full @ found, v, len(y) - int(rank))
    inverse = np.linalg.inv(design.T @ (design / v[:, None]))
    return inverse @ (design.T @ (y / v)), inverse


def _one_soak(steps: Steps, own: FloatArray, rows: IntArray, matrix: FloatArray) -> Soak:
    """Return a soak by the columns of the axes that it turned."""
    rate, reading = steps.rate_b[rows], own[rows]
    turned = np.flatnonzero((np.abs(rate) > 0.5 * np.linalg.norm(rate, axis=1, keepdims=True)).any(axis=0))
    still = np.setdiff1d(np.arange(3), turned)
    reading = reading - rate[:, still] @ matrix[:, still].T
    design = np.column_stack((rate[:, turned] / np.abs(rate).max(), _mountings(steps, rows)[0]))
    if np.linalg.matrix_rank(design, tol=1e-3) < design.shape[1]:
        raise NotObservable(
            f"scale over temperature: wanted turns that separate the axes at {steps.temp_c[rows].mean():.1f} degC, got "
            f"{len(rows)} that do not; turn about each axis at two rates or more"
        )
    forward, spread = np.full((2, 3, 3), np.nan)
    forward[:, turned], spread[:, turned], rms = _slopes(steps, reading, rows, rate[:, turned])
    return float(steps.temp_c[rows].mean()), forward, spread, rms


def _slopes(
    steps: Steps, reading: FloatArray, rows: IntArray, rate: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the readings of each sensor per rate (n, k) of some rows, (3, k), their variance, and the residuals' rms."""
    main, (offsets, bends) = np.abs(rate).max(), _mountings(steps, rows)
    design = np.column_stack((rate / main, offsets))
    full, count, variance = np.column_stack((design, bends)), rate.shape[1], steps.gyro_variance[rows]
    fits = [_weighted(design, reading[:, i], variance[:, i], full) for i in range(3)]
    left = [np.sqrt(np.mean((reading[:, i] - design @ theta) ** 2)) for i, (theta, _) in enumerate(fits)]
    slope = np.array([theta[:count] / main for theta, _ in fits])
    return slope, np.array([np.diag(inverse)[:count] / main**2 for _, inverse in fits]), np.array(left)


def _mountings(steps: Steps, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return a column of ones for each mounting with two rates or more, and its parabola and cubic where they differ from noise."""
    offsets, bends = [], []
    for m in np.unique(steps.mounting[rows]):
        inside = steps.mounting[rows] == m
        along = steps.along[rows][inside]
        if _one_rate(along):
            continue
        offsets.append(inside.astype(float))
        if len(np.unique(np.abs(along))) > 3 and len(along) >= _BENT:
            z = np.where(inside, steps.along[rows], 0.0) / np.abs(along).max()
            bends += [z**2, z**3]
    return np.array(offsets).reshape(-1, len(rows)).T, np.array(bends).reshape(-1, len(rows)).T


def _over_temperature(
    soaks: SoakMatrices, model: TriadModel, nodes: FloatArray, *, spread: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Return K at the nodes and the variance of each element; NaN variance where unwanted and for axes that were not turned."""
    forward, variance = np.tile(_forward(model), (len(nodes), 1, 1)), np.full((len(nodes), 3, 3), np.nan)
    temperatures = [soaks.temp_c[soaks.seen[:, j]] for j in range(3)]
    most = max(len(t) for t in temperatures)
    if most < 2 or max(float(np.ptp(t)) for t in temperatures if len(t)) <= 0.0:
        raise NotObservable(
            f"scale over temperature: wanted rate steps at two soaks or more, got {most}; repeat the steps at another "
            "temperature, ten degrees or more away",
            soaks=most,
        )
    for j, temps in enumerate(temperatures):
        if len(temps) >= 2:  # one temperature, or none: nothing over temperature
            have = soaks.seen[:, j]
            at = fit_curve(temps, soaks.forward[have, :, j], soaks.variance[have, :, j]).at(nodes)
            forward[:, :, j] = at.value
            if spread:
                variance[:, :, j] = at.uncertainty**2
    return forward, variance


def _sensitivity(soaks: SoakMatrices, reference_temp_c: float) -> tuple[FloatArray, FloatArray]:
    """Return the slope of each own scale factor over its value at the reference, %/K, with its standard uncertainty."""
    slope, doubt = np.full(3, np.nan), np.full(3, np.nan)
    for j in range(3):
        have = soaks.seen[:, j]
        t, k, v = soaks.temp_c[have], soaks.forward[have, j, j], soaks.variance[have, j, j]
        if len(t) < 2 or np.ptp(t) == 0.0:
            continue
        zero = reference_temp_c if np.isfinite(reference_temp_c) else float(t.mean())
        (value, change), inverse = _weighted(np.column_stack((np.ones(len(t)), t - zero)), k, v)
        slope[j], doubt[j] = 100.0 * change / value, abs(100.0 / value) * np.sqrt(inverse[1, 1])
    return slope, doubt


def _verdict(soaks: SoakMatrices) -> Verdict:
    """Return which axes turned at too few temperatures."""
    findings, count = [], soaks.seen.sum(axis=0)
    for axis, n in zip(AXES, count, strict=True):
        if n < 2:
            findings.append(finding("drift.scale_not_observable", "warn", axis=axis, soaks=n))
    two = ", ".join(axis for axis, n in zip(AXES, count, strict=True) if n == 2)
    if two:
        findings.append(finding("drift.two_temperatures", "warn", what=f"scale factor {two}"))
    return Verdict.of(*findings)


# ---- rate steps made ready: usable rows, soaks and mountings by number


def steps_of(steps: RateSteps) -> Steps:
    """Return the usable rows of rate steps."""
    if isinstance(steps, Steps):
        return steps
    finite = np.isfinite(steps.gyro).all(axis=1) & np.isfinite(steps.rate_b).all(axis=1) & np.isfinite(steps.temp_c)
    rows = np.flatnonzero(finite & (np.abs(steps.rate_b).max(axis=1, initial=0.0) > 0.0))
    if not len(rows):
        raise InputError(
            f"rate steps: wanted dwells with rate, reading and temperature, got {len(steps)} rows and none of them usable; "
            "check turn_rate_dps, temp_c and gaps in the recording"
        )
    usable = steps.taken(rows)
    soak = np.unique(np.column_stack((usable.session, usable.soak)), axis=0, return_inverse=True)[1].reshape(-1)
    direction, along = _directions(usable.rate_b)
    mounting = np.unique(np.column_stack((soak, direction)), axis=0, return_inverse=True)[1].reshape(-1)
    lost = len(steps) - int(finite.sum())
    gaps = [finding("drift.steps_left_out", "warn", count=lost, steps=len(steps))] if lost else []
    own = {name: getattr(usable, name) for name in usable.__dataclass_fields__}
    own |= {"soak": soak, "gyro_variance": _variance(usable.gyro_variance, usable.gyro)}
    return Steps(**own, mounting=mounting, along=along, verdict=Verdict.of(*gaps))


def _one_rate(along: FloatArray) -> bool:
    return float(np.ptp(along)) < _SAME_RATE * float(np.abs(along).max())


def of_one_rate(steps: Steps) -> BoolArray:
    """Tell which rows belong to a mounting that turned at one rate, one way round: they do not show their own zero."""
    alone = [m for m in np.unique(steps.mounting) if _one_rate(steps.along[steps.mounting == m])]
    return np.isin(steps.mounting, alone)


def with_rest_as_zero(
    steps: Steps, blocks: RestBlocks | None, calibration: Calibration, static: StaticDrift | None
) -> Steps:
    """Return steps whose mountings of one rate have the rests of their soak at zero, in their own pose where one lay so."""
    if blocks is None or not len(blocks):
        return steps
    zero = blocks.gyro - offset_at(blocks.temp_c, calibration, static)
    gyro, variance, alone = steps.gyro.copy(), steps.gyro_variance.copy(), of_one_rate(steps)
    for m in np.unique(steps.mounting[alone]):
        rows = np.flatnonzero(steps.mounting == m)
        near = np.abs(blocks.temp_c - steps.temp_c[rows].mean()) < _SAME_TEMPERATURE_C
        near &= np.isfinite(zero).all(axis=1) & (blocks.session == steps.session[rows[0]])
        pose = steps.accel[rows].mean(axis=0)
        alike = near & (np.linalg.norm(blocks.accel - pose, axis=1) < _SAME_POSE * np.linalg.norm(pose))
        own = zero[alike if alike.any() else near]
        if len(own):
            gyro[rows] -= own.mean(axis=0)
            known = np.nan_to_num(blocks.gyro_variance[near]).mean(axis=0)
            variance[rows] += (own.var(axis=0, ddof=1) if len(own) > 1 else known) / len(own)
    return replace(steps, gyro=gyro, gyro_variance=variance)


def _directions(rate_b: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return which direction each row turns about, up to its sign, and the rate along it."""
    length = np.linalg.norm(rate_b, axis=1)
    unit = rate_b / length[:, None]
    axes: list[FloatArray] = []
    number, sign = np.empty(len(rate_b), dtype=np.int64), np.empty(len(rate_b))
    for k, direction in enumerate(unit):
        cosine = np.array([direction @ other for other in axes])
        near = np.flatnonzero(np.abs(cosine) > _SAME_DIRECTION)
        if not len(near):
            axis = int(np.abs(direction).argmax())
            axes.append(direction * np.sign(direction[axis]))
            near, cosine = np.array([len(axes) - 1]), np.append(cosine, np.sign(direction[axis]))
        number[k], sign[k] = near[0], np.sign(cosine[near[0]])
    return number, length * sign


def _variance(variance: FloatArray, reading: FloatArray) -> FloatArray:
    """Return variances that are known and above zero; elsewhere the median of the others, or the last digit."""
    known = np.isfinite(variance) & (variance > 0.0)
    least = (1e-9 * np.maximum(np.abs(reading).max(axis=0), 1e-30)) ** 2
    middle = np.array([np.median(v[ok]) if ok.any() else 0.0 for v, ok in zip(variance.T, known.T, strict=True)])
    return np.asarray(np.maximum(np.where(known, variance, middle), least))


def gyro_model(calibration: Calibration) -> TriadModel:
    """Return the gyroscopes' constant model."""
    if calibration.gyro is None:
        raise InputError(
            "rate steps: wanted a calibration with gyroscopes, got one without; calibrate on a rate table first"
        )
    return calibration.gyro


def offset_at(temp_c: FloatArray, calibration: Calibration, static: StaticDrift | None) -> FloatArray:
    """Return the gyroscopes' offset at temperatures (n,), (n, 3): from the table, else the constant."""
    if static is None or static.gyro_offset is None:
        return np.tile(gyro_model(calibration).offset, (len(temp_c), 1))
    return interpolated(temp_c, static.temp_c, static.gyro_offset)


def measured_rate(
    gyro: FloatArray,
    temp_c: FloatArray,
    calibration: Calibration,
    *,
    static: StaticDrift | None,
    scale: ScaleDrift | None,
) -> FloatArray:
    """Return the rate of mean readings (n, 3), rad/s: M(T) (u - offset(T))."""
    model = gyro_model(calibration)
    matrix = np.tile(model.matrix, (len(temp_c), 1, 1))
    if scale is not None and scale.gyro_matrix is not None:
        matrix = interpolated(temp_c, scale.temp_c, scale.gyro_matrix)
    rate: FloatArray = np.einsum("nij,nj->ni", matrix, gyro - offset_at(temp_c, calibration, static))
    return rate * si_factor(model.unit_out, "rate")


def rests_of(steps: Steps, blocks: RestBlocks | None) -> tuple[IntArray, IntArray]:
    """Find the blocks of rest that lay as the device turned: same session, temperature and pose as a mounting."""
    nothing = np.empty(0, dtype=np.int64)
    if blocks is None or not len(blocks):
        return nothing, nothing
    firsts = np.unique(steps.mounting, return_index=True)[1]
    means = np.array([steps.accel[steps.mounting == steps.mounting[k]].mean(axis=0) for k in firsts])
    temps = np.array([steps.temp_c[steps.mounting == steps.mounting[k]].mean() for k in firsts])
    span = np.linalg.norm(means[:, None] - means[None], axis=2).max()
    if not np.isfinite(span) or span == 0.0:
        return nothing, nothing
    rests, of = [], []
    usable = np.isfinite(blocks.gyro).all(axis=1) & np.isfinite(blocks.accel).all(axis=1) & np.isfinite(blocks.temp_c)
    for b in np.flatnonzero(usable):
        off = np.linalg.norm(means - blocks.accel[b], axis=1) / span
        apart = np.abs(temps - blocks.temp_c[b])
        fits = (off < _SAME_POSE) & (apart < _SAME_TEMPERATURE_C) & (steps.session[firsts] == blocks.session[b])
        if fits.any():
            rests.append(b)
            of.append(firsts[np.flatnonzero(fits)[apart[fits].argmin()]])
    return np.array(rests, dtype=np.int64), np.array(of, dtype=np.int64)


# ---- dynamic drift


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
    for axis, data in enumerate(points):
        if data is None:
            continue
        ends = (float(turn_rate[0]), float(turn_rate[-1])), (float(temp_c[0]), float(temp_c[-1]))
        earlier = None if like is None else like.surfaces[axis]
        alike = earlier.softness if earlier is not None else None if like is None else (_SOFTNESS[0], _SOFTNESS[0])
        surface = surfaces[axis] = fit_surface(data, rate_span=ends[0], temp_span=ends[1], softness=alike)
        error[:, :, axis] = surface.at(w, t).reshape(shape[:2])
        uncertainty[:, :, axis] = surface.uncertainty(w, t).reshape(shape[:2])
        marks |= _unseen(data, turn_rate, temp_c)
        means = np.bincount(data.mounting, data.value) / np.bincount(data.mounting)
        before[axis] = np.sqrt(np.mean((data.value - means[data.mounting]) ** 2))
        after[axis] = np.sqrt(np.mean(surface.residuals**2))
    return DynamicFit(
        drift=DynamicDrift(
            temp_c=temp_c, turn_rate=turn_rate, error=error, uncertainty=uncertainty, extrapolated=marks
        ),
        surfaces=tuple(surfaces),
        before=before,
        after=after,
        verdict=_dynamic_verdict(points).also(clean.verdict),
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
    points: list[SurfacePoints | None] = []
    for axis in range(3):
        own = np.flatnonzero(np.abs(steps.rate_b[:, axis]) > _MAINLY * np.linalg.norm(steps.rate_b, axis=1))
        if len(np.unique(steps.soak[own])) < 2 or len(np.unique(steps.rate_b[own, axis])) < 2:
            points.append(None)
            continue
        rows = np.concatenate((own, n + np.flatnonzero(np.isin(steps.mounting[of], steps.mounting[own]))))
        size = np.abs(imposed[rows, axis])
        points.append(
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
    return points


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


def _unseen(points: SurfacePoints, turn_rate: FloatArray, temp_c: FloatArray) -> BoolArray:
    """Mark nodes beyond the temperatures, or beyond the rates that were measured around their temperature."""
    rows = [points.soak == s for s in np.unique(points.soak)]
    at = np.array([points.temp_c[r].mean() for r in rows])
    order = np.argsort(at)
    ends = [np.array([f(np.append(points.turn_rate[r], 0.0)) for r in rows])[order] for f in (np.min, np.max)]
    slack = _NEAR_RATE * float(np.abs(points.turn_rate).max())
    low, high = (np.interp(temp_c, at[order], end)[:, None] for end in ends)
    outside = (turn_rate < low - slack) | (turn_rate > high + slack)
    return np.asarray(outside | ~near_data(temp_c, at, gap_c=MATRIX_GAP_C)[:, None])


def _dynamic_verdict(points: list[SurfacePoints | None]) -> Verdict:
    findings, two = [], []
    for axis, data in zip(AXES, points, strict=True):
        if data is None:
            findings.append(finding("drift.dynamic_not_observable", "warn", axis=axis))
            continue
        steady = data.turn_rate[data.level > 0]
        if (steady > 0.0).all() or (steady < 0.0).all():
            way, other = ("+", "-") if steady[0] > 0.0 else ("-", "+")
            findings.append(finding("drift.dynamic_one_way", "warn", axis=axis, way=way + axis, other=other + axis))
        if len(np.unique(data.soak)) == 2:
            two.append(axis)
    if two:
        findings.append(finding("drift.two_temperatures", "warn", what=f"dynamic drift {', '.join(two)}"))
    return Verdict.of(*findings)


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
    scores = _held_out_squares(points, x, v, np.array([_penalty(pair, size, bends, groups) for pair in pairs]))
    if not scores.min() > 0.0:  # nothing could be left out: as stiff as may be; or what was is met exactly
        return [pairs[int(scores.argmin())]], np.ones(1)
    weights = (scores / scores.min()) ** (-0.5 * len(points))
    kept = weights > _NEGLIGIBLE * weights.sum()
    return [pair for pair, keep in zip(pairs, kept, strict=True) if keep], weights[kept] / weights[kept].sum()


def _held_out_squares(points: SurfacePoints, x: FloatArray, v: FloatArray, penalties: FloatArray) -> FloatArray:
    """Return the weighted sum of squares of all rows when their soak, or their rate, is held out, for penalties (k, P, P)."""
    z = np.linalg.inv(np.linalg.cholesky(x.T @ (x / v[:, None]) + penalties)) @ x.T
    r = points.value - ((z @ (points.value / v))[:, None, :] @ z)[:, 0]

    def missed(rows: IntArray) -> FloatArray:
        own = z[:, :, rows]
        hat = own.swapaxes(1, 2) @ own / v[rows]
        return np.asarray(np.linalg.solve(np.eye(len(rows)) - hat, r[:, rows, None])[..., 0])

    total, soaks = np.zeros(len(penalties)), np.unique(points.soak)
    middle = np.array([points.temp_c[points.soak == s].mean() for s in soaks])
    for s in soaks[(middle > middle.min()) & (middle < middle.max())]:
        rows = np.flatnonzero(points.soak == s)
        off = missed(rows)
        for g in np.unique(points.mounting[rows]):  # its offset is its own: only how it differs over rate counts
            own = points.mounting[rows] == g
            w = 1.0 / v[rows][own]
            off[:, own] -= (off[:, own] @ w / w.sum())[:, None]
        total += (off**2 / v[rows]).sum(axis=1)
    for level in np.unique(points.level[points.level > 0])[:-1]:
        rows = np.flatnonzero(points.level == level)
        total += (missed(rows) ** 2 / v[rows]).sum(axis=1)
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


@lru_cache(maxsize=16)  # of the surfaces in hand: each is asked many times
def _vanishing(rate: Cubics) -> FloatArray:
    """Return combinations of the splines, one a column, that are zero at rate zero."""
    return np.asarray(np.linalg.svd(rate.at(np.zeros(1)))[2][1:].T)
