"""Matrix over temperature: thermal scale factor, cross-axis and asymmetry, from rate steps at several soaks.

At one soak, after the offset table is subtracted, each sensor i reads ::

    u_i - offset_i(T) = sum_j K_ij w_j + d_im + noise        j the axes that were turned, m the mounting

A mounting is a stretch of one soak in which the device turned about one direction of its case. d is what soak and mounting leave of
the offset (hysteresis, warm-up, g-sensitivity); it is fitted where a mounting has two rates or more. Where it has one rate, one way
round, the mean reading of the rests of the same soak is its zero; without rests the table is. An axis that no soak turned
keeps its column of K from the calibration and has no uncertainty: nothing is known of it. Each K_ij(T) goes through a smoothing
spline (fit/smooth.py), and ``M(T) = K(T)^-1`` with dM = -M dK M.

K is the best straight line over the imposed rates. What bends belongs to the dynamic table; so the noise is what a line, a
parabola and a cubic leave.

Scale factor asymmetry (IEEE Std 528): at each soak and axis, o the offset of the mounting::

    u = o + S+ max(w, 0) + S- min(w, 0)        asymmetry = 2 (S+ - S-) / (S+ + S-)
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, interpolated
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.drift.static import near_data
from undrift.errors import InputError, NotObservable
from undrift.findings import finding
from undrift.fit.equations import inverse_jacobian
from undrift.fit.least_squares import excess_variance
from undrift.fit.smooth import fit_smooth
from undrift.model import AXES, Calibration, ScaleDrift, StaticDrift, TriadModel, Verdict
from undrift.units import si_factor

_BENT = 8  # rows of a mounting from which a parabola and a cubic differ from noise
_OWN = 0.9  # share of the turning rate from which a row counts for one axis alone
_SAME_DIRECTION = 0.98  # cosine
_SAME_POSE = 0.2  # of the largest difference between two poses, or of gravity
_SAME_RATE = 0.01  # of the greatest: rates of one mounting nearer to each other are one
_SAME_TEMPERATURE_C = 1.5
# a node between soaks and further from both is extrapolated: matrices change more evenly than offsets
MATRIX_GAP_C = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps(RateSteps):
    """Usable rate steps, n rows; the variance is the median where it is not known."""

    mounting: IntArray  # (n,), numbered from 0 over all soaks, as soaks are over all sessions
    along: FloatArray  # (n,), rate along the direction of its mounting, rad/s
    verdict: Verdict  # what was left out


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Asymmetry:
    """Scale factor asymmetry of three gyroscopes at S soaks."""

    temp_c: FloatArray  # (S,), degC, increasing
    value: FloatArray  # (S, 3), 1; NaN where an axis did not turn both ways at two rates each
    uncertainty: FloatArray  # (S, 3), standard uncertainty
    mean: FloatArray  # (3,), over the soaks, weighted; their scatter beyond the stated noise counts
    mean_uncertainty: FloatArray  # (3,)
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
    return ScaleFit(
        drift=drift,
        soaks=soaks,
        percent_per_k=slope,
        percent_per_k_uncertainty=doubt,
        verdict=_verdict(soaks, slope, doubt).also(clean.verdict),
    )


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


def _one_soak(
    steps: Steps, own: FloatArray, rows: IntArray, kept: FloatArray
) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Return temperature, K, its variance, and residual of one soak."""
    rate, reading, variance = steps.rate_b[rows], own[rows], steps.gyro_variance[rows]
    main = np.abs(rate).max()
    turned = np.flatnonzero((np.abs(rate) > 0.5 * np.linalg.norm(rate, axis=1, keepdims=True)).any(axis=0))
    still = np.setdiff1d(np.arange(3), turned)
    reading = reading - rate[:, still] @ kept[:, still].T
    offsets, bends = _mountings(steps, rows)
    design = np.column_stack((rate[:, turned] / main, offsets))
    if np.linalg.matrix_rank(design, tol=1e-3) < design.shape[1]:
        raise NotObservable(
            f"scale over temperature: wanted turns that separate the axes at {steps.temp_c[rows].mean():.1f} degC, got "
            f"{len(rows)} that do not; turn about each axis at two rates or more"
        )
    forward, spread, rms = np.full((3, 3), np.nan), np.full((3, 3), np.nan), np.full(3, np.nan)
    full = np.column_stack((design, bends))
    for i in range(3):
        theta, inverse = _weighted(design, reading[:, i], variance[:, i], full)
        forward[i, turned] = theta[: len(turned)] / main
        spread[i, turned] = np.diag(inverse)[: len(turned)] / main**2
        rms[i] = np.sqrt(np.mean((reading[:, i] - design @ theta) ** 2))
    return float(steps.temp_c[rows].mean()), forward, spread, rms


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


def _over_temperature(soaks: SoakMatrices, model: TriadModel, nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return K at the nodes and the variance of each element; NaN variance for axes that were not turned."""
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
            at = fit_smooth(temps, soaks.forward[have, :, j], soaks.variance[have, :, j]).at(nodes)
            forward[:, :, j], variance[:, :, j] = at.value, at.uncertainty**2
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


def _verdict(soaks: SoakMatrices, slope: FloatArray, doubt: FloatArray) -> Verdict:
    found, count = [], soaks.seen.sum(axis=0)
    for axis, n, s, u in zip(AXES, count, slope, doubt, strict=True):
        if n < 2:
            found.append(finding("drift.scale_not_observable", "warn", axis=axis, soaks=n))
        else:
            found.append(finding("drift.scale", "info", axis=axis, percent_per_k=s, expanded_percent_per_k=2.0 * u))
    two = tuple(axis for axis, n in zip(AXES, count, strict=True) if n == 2)
    return Verdict.of(*found, *([finding("drift.scale_two_temperatures", "warn", axes=two)] if two else []))


# ---- scale factor asymmetry


def scale_asymmetry(steps: RateSteps, calibration: Calibration, *, static: StaticDrift | None = None) -> Asymmetry:
    """Compare the scale factors of the two ways round at each soak."""
    clean = steps_of(steps)
    reading = clean.gyro - offset_at(clean.temp_c, calibration, static)
    numbers = np.unique(clean.soak)
    temps = np.array([clean.temp_c[clean.soak == s].mean() for s in numbers])
    order = np.argsort(temps, kind="stable")
    value, doubt = np.full((len(numbers), 3), np.nan), np.full((len(numbers), 3), np.nan)
    main = np.abs(clean.rate_b) > _OWN * np.linalg.norm(clean.rate_b, axis=1, keepdims=True)
    for k, s in enumerate(numbers[order]):
        for axis in range(3):
            rows = np.flatnonzero((clean.soak == s) & main[:, axis])
            of_axis = clean.rate_b[rows, axis], reading[rows, axis], clean.gyro_variance[rows, axis]
            value[k, axis], doubt[k, axis] = _asymmetry_of(*of_axis)
    mean, mean_doubt = np.full(3, np.nan), np.full(3, np.nan)
    for axis, have in enumerate(np.isfinite(value).T):
        y, v = value[have, axis], doubt[have, axis] ** 2
        if len(y):
            spread = v + excess_variance(y - np.average(y, weights=1.0 / v), v, len(y) - 1)
            mean[axis], mean_doubt[axis] = np.average(y, weights=1.0 / spread), np.sqrt(1.0 / (1.0 / spread).sum())
    unseen = tuple(axis for axis, a in zip(AXES, mean, strict=True) if np.isnan(a))
    found = [finding("drift.asymmetry_not_observable", "warn", axes=unseen)] if unseen else []
    found += [
        finding("drift.asymmetry", "info", axis=axis, percent=100.0 * a, expanded_percent=200.0 * u)
        for axis, a, u in zip(AXES, mean, mean_doubt, strict=True)
        if abs(a) > 3.0 * u
    ]
    return Asymmetry(
        temp_c=temps[order],
        value=value,
        uncertainty=doubt,
        mean=mean,
        mean_uncertainty=mean_doubt,
        verdict=Verdict.of(*found).also(clean.verdict),
    )


def _asymmetry_of(rate: FloatArray, reading: FloatArray, variance: FloatArray) -> tuple[float, float]:
    """Return the asymmetry of one axis at one soak and its standard uncertainty; NaN where it does not show."""
    if len(np.unique(rate[rate > 0.0])) < 2 or len(np.unique(rate[rate < 0.0])) < 2:
        return float("nan"), float("nan")
    z = rate / np.abs(rate).max()
    design = np.column_stack((np.ones_like(z), np.maximum(z, 0.0), np.minimum(z, 0.0)))
    full = np.column_stack((design, z**2, z**3)) if len(z) > 7 else design  # curvature is no noise
    (_, plus, minus), inverse = _weighted(design, reading, variance, full)
    total = plus + minus
    slope = np.array([0.0, 4.0 * minus, -4.0 * plus]) / total**2
    return float(2.0 * (plus - minus) / total), float(np.sqrt(slope @ inverse @ slope))


# ---- rate steps made ready: usable rows, soaks and mountings by number


def steps_of(steps: RateSteps) -> Steps:
    """Return the usable rows of rate steps."""
    if isinstance(steps, Steps):
        return steps
    known = np.isfinite(steps.gyro).all(axis=1) & np.isfinite(steps.rate_b).all(axis=1) & np.isfinite(steps.temp_c)
    rows = np.flatnonzero(known & (np.abs(steps.rate_b).max(axis=1, initial=0.0) > 0.0))
    if not len(rows):
        raise InputError(
            f"rate steps: wanted dwells with rate, reading and temperature, got {len(steps)} rows and none of them usable; "
            "check turn_rate_dps, temp_c and gaps in the recording"
        )
    kept = steps.taken(rows)
    soak = np.unique(np.column_stack((kept.session, kept.soak)), axis=0, return_inverse=True)[1].reshape(-1)
    direction, along = _directions(kept.rate_b)
    mounting = np.unique(np.column_stack((soak, direction)), axis=0, return_inverse=True)[1].reshape(-1)
    lost = len(steps) - int(known.sum())
    gaps = [finding("drift.steps_left_out", "warn", count=lost, steps=len(steps))] if lost else []
    own = {name: getattr(kept, name) for name in kept.__dataclass_fields__}
    own |= {"soak": soak, "gyro_variance": _variance(kept.gyro_variance, kept.gyro)}
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
    found: list[FloatArray] = []
    number, sign = np.empty(len(rate_b), dtype=np.int64), np.empty(len(rate_b))
    for k, direction in enumerate(unit):
        cosine = np.array([direction @ other for other in found])
        near = np.flatnonzero(np.abs(cosine) > _SAME_DIRECTION)
        if not len(near):
            axis = int(np.abs(direction).argmax())
            found.append(direction * np.sign(direction[axis]))
            near, cosine = np.array([len(found) - 1]), np.append(cosine, np.sign(direction[axis]))
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
    found, of = [], []
    usable = np.isfinite(blocks.gyro).all(axis=1) & np.isfinite(blocks.accel).all(axis=1) & np.isfinite(blocks.temp_c)
    for b in np.flatnonzero(usable):
        off = np.linalg.norm(means - blocks.accel[b], axis=1) / span
        apart = np.abs(temps - blocks.temp_c[b])
        fits = (off < _SAME_POSE) & (apart < _SAME_TEMPERATURE_C) & (steps.session[firsts] == blocks.session[b])
        if fits.any():
            found.append(b)
            of.append(firsts[np.flatnonzero(fits)[apart[fits].argmin()]])
    return np.array(found, dtype=np.int64), np.array(of, dtype=np.int64)
