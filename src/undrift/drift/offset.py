"""Offsets over temperature, from blocks of rest (static drift).

    gyroscopes       y = u - K G a                             mean reading u, K = M^-1, without the g-sensitivity term
    accelerometers   y = u in a single pose,   offset(T) = offset(T_ref) + y(T) - y(T_ref)
    both             y = f(T) + f'(T) dT/dt l + h c + A exp(-t / tau) + d_s + w + v + e

f      smooth curve (fit/curve.py) through the means of the cells. A cell contains the blocks of one rest within a narrow range of
       temperature, so that the hot end of a warm-up is weighted by its temperature range only
l      remaining lag of the thermometer, a common unknown of known size: soaks often end before it has settled, with the same sign
w      flicker noise of known size (fit/priors.py): the rests of a session share most of it, so residuals do not reveal it
v      deviation of a rest, with a common variance about the curve: half of it is independent (pose, mounting, a device that
       moved), and half is shared with the following rests, as for flicker noise
h      half-width of the hysteresis: c = +1 while cooling, -1 while warming, and between these over ``CROSSED_C`` after a turn
A, tau warm-up, t since power-on. It differs from f only if time and temperature differ: in a soak, or in several warm-ups
d_s    shift of session s, whose variance counts for a future session
e      noise of the means, and rounding errors of the converter

T_ref and offset(T_ref) belong to the calibration. A single pose cannot separate a change of scale along gravity from a change of
offset, so 0.02 %/K * |T - T_ref| of the gravity reading counts as uncertainty. The uncertainty of a node applies to a future visit.
It contains the curve between and beyond the observed temperatures, the visit (w and v), the half-width of the hysteresis and the
session.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.drift.observe import RestBlocks, not_observable
from undrift.errors import NotObservable
from undrift.findings import Finding, finding
from undrift.fit.curve import Curve, NodeValues, fit_curve, not_a_knot
from undrift.fit.gls import determined, excess_variance, student_factor
from undrift.fit.priors import ACCEL_FLICKER, GYRO_FLICKER, THERMOMETER_LAG
from undrift.model import G_NAMES, Calibration, StaticDrift, TriadModel, WarmUp

UNKNOWN_SCALE_PER_K = 2e-4  # accelerometers in a single pose: the scale of a capacitive sensor changes by +-1 % in 50 K
EDGE_C = 0.5  # distance outside the observed temperatures from which a node is extrapolated
GAP_C = 5.0  # distance from both neighbouring observed temperatures from which a node between them is extrapolated
SLOPE_POINTS = 60
# ---- cells
CELL_C, MOST_CELLS = 0.5, 100  # narrowest cell, and number of cells above which they are widened
APART_C, APART_S = 2.0, 60.0  # a larger step or a longer pause between blocks begins another rest
SLOW, STILL = 0.25, 0.05  # shares of a log's fast ramps [assumed]
LEAST_SOAKS = 5  # number of temperatures from which a log consists of soaks [assumed]
OWN = 0.5  # part of the variance of v that is independent from rest to rest [assumed]
FLICKER_S = 10.0 ** np.arange(1.0, 4.1, 0.5)  # time constants of the processes that add up to flicker noise
FLICKER_OF_FLOOR = 2.41  # total standard deviation over bias instability: sqrt(7 ln(sqrt 10) / pi) / 0.664
PAIRED = 30  # number of blocks of a cell from which its correlation is computed
SHARED_C = 1.0  # largest distance between cells of two sessions at a common temperature
# ---- hysteresis
CROSSED_C = 4.0  # change of temperature after a reversal over which the loop is crossed
OVERLAP_C = 3.0  # smallest common range of both directions
# ---- warm-up
CHUNK_S = 120.0  # time at which cells are cut, and at its multiples by powers of two
LEAST_OWN = 0.05  # share of the variance of exp(-t / tau) that temperature must leave unexplained
CURVE_POWER = 7  # degree of the polynomial over temperature from which a warm-up must differ
WARM_UP_NODES, WARM_UP_SPAN = 13, 5.0  # nodes of its table, and its length in time constants


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticSettings:
    """Settings of the offset over temperature."""

    not_a_knot: bool = False  # True for the note's spline through the set-point means, False for the smooth curve
    warm_up: bool = False  # fit a power-on transient, if recordings begin at power-on
    accel: bool = True  # False if poses determine the accelerometers, so that the fit to a single pose is not needed
    lag_uncertainty_s: float = THERMOMETER_LAG  # standard uncertainty of the remaining lag, s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Offsets:
    """Offset readings of a triad, n blocks."""

    blocks: RestBlocks
    value: FloatArray  # (n, 3), raw unit
    variance: FloatArray  # (n, 3), variance due to noise, raw unit squared
    step_error: FloatArray  # (n, 3), rounding error of the converter in each block, raw unit
    common_variance: FloatArray  # (3,), variance of the common error, raw unit squared
    flicker: FloatArray  # (3,), known variance of w, raw unit squared


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cells:
    """Means of the blocks of a rest at a temperature, n cells."""

    session: IntArray  # (n,)
    temp_c: FloatArray  # (n,), degC
    value: FloatArray  # (n, 3), raw unit
    variance: FloatArray  # (n, 3), variance due to noise and steps, raw unit squared
    regressors: FloatArray  # (n, p)
    correlation: FloatArray  # (n, n), correlation of the deviations v, mean diagonal 1
    ramp_c_per_s: FloatArray  # (n,), slope of the temperature at the end of soaks, or 0 on a sweep
    flicker: FloatArray  # (3, n, n), covariance of w, raw unit squared


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnOn:
    """Scatter between sessions, raw unit squared."""

    variance: FloatArray  # (3,), variance between sessions
    future_variance: FloatArray  # (3,), variance of a future session


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadDrift:
    """Offset over temperature of a triad, n nodes, raw unit."""

    offset: FloatArray  # (n, 3), absolute
    uncertainty: FloatArray  # (n, 3), standard uncertainty of each node, for a future visit
    visit: FloatArray  # (3,), standard deviation of a visit's contribution, included in ``uncertainty``
    extrapolated: BoolArray  # (n,), True if there were no data near the node
    slope: FloatArray  # (3,), mean slope over the temperatures of the blocks, raw unit per K
    slope_uncertainty: FloatArray  # (3,)
    span_c: tuple[float, float]  # lowest and highest temperature of the data, degC
    curve: Curve
    cells: Cells
    offsets: Offsets
    turn_on: TurnOn | None  # None if sessions share no temperature
    gravity: FloatArray  # (3,), reading due to gravity, for accelerometers in a single pose (otherwise 0)
    hysteresis: FloatArray | None = None  # (3,), half-width, or None if the temperature only rose or only fell
    hysteresis_uncertainty: FloatArray | None = None  # (3,)
    warm_up: WarmUp | None = None
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StaticFit:
    """A static tuning table with its findings."""

    table: StaticDrift  # at the requested nodes
    gyro: TriadDrift | None  # None if a triad was not observed
    accel: TriadDrift | None
    findings: tuple[Finding, ...]


def fit_static(
    blocks: RestBlocks,
    *,
    nodes: FloatArray,
    calibration: Calibration | None = None,
    settings: StaticSettings = StaticSettings(),
) -> StaticFit:
    """Fit offset over temperature of both triads, at nodes (n,), degC."""
    findings, gyro, accel = list[Finding](), None, None
    rates = gyro_offsets(blocks, calibration)
    if rates is not None:
        gyro = _fit_triad(rates, nodes, settings)
        findings += gyro.findings
    if settings.accel and np.isfinite(blocks.accel).any():
        try:
            accel = _fit_accel(blocks, nodes, calibration, settings)
        except NotObservable as error:
            what = "Accelerometer offset over temperature"
            findings.append(not_observable("info", what, str(error)))
    if accel is not None:
        findings += () if gyro is not None else accel.findings  # the gyroscopes report the same rests
        span_c, percent_per_c = accel.span_c[1] - accel.span_c[0], 100.0 * UNKNOWN_SCALE_PER_K
        findings.append(
            finding(
                "drift.accel_one_pose",
                "info",
                f"The accelerometer offset over {span_c:.1f} degC comes from one pose, so {percent_per_c:g} % of gravity per degC "
                "counts as uncertainty of the scale.",
                "Rest on all six faces at three temperatures.",
            )
        )
    if gyro is None and accel is None and settings.accel:
        raise NotObservable(
            "static drift: expected readings at two temperatures or more, got none. "
            + " ".join(item.text for item in findings)
        )
    columns = {
        f"{sensor}_{name}": getattr(triad, name)
        for sensor, triad in (("gyro", gyro), ("accel", accel))
        if triad is not None
        for name in ("offset", "uncertainty", "extrapolated")
    }
    table = StaticDrift(
        temp_c=nodes,
        **columns,
        gyro_hysteresis=None if gyro is None else gyro.hysteresis,
        warm_up=None if gyro is None else gyro.warm_up,
    )
    return StaticFit(table=table, gyro=gyro, accel=accel, findings=tuple(findings))


# ---- offset readings


def gyro_offsets(blocks: RestBlocks, calibration: Calibration | None) -> Offsets | None:
    """Return the gyroscopes' readings at rest without g-sensitivity, or None without readings."""
    blocks = blocks.taken(np.isfinite(blocks.gyro).all(axis=1))
    if not len(blocks):
        return None
    model, force = None if calibration is None else calibration.gyro, specific_force(blocks, calibration)
    common = np.zeros(3)
    if model is not None and model.g_sensitivity is not None and force is not None:
        k, mean = model.forward_matrix, force.mean(axis=0)
        g_covariance = model.covariance_of(G_NAMES).reshape(3, 3, 3, 3)
        common = np.einsum("ka,kb,i,j,aibj->k", k, k, mean, mean, g_covariance)  # evaluated at the mean specific force
    return Offsets(
        blocks=blocks,
        value=blocks.gyro - felt_by_gyro(blocks, calibration),
        variance=known_variance(blocks.gyro_variance),
        step_error=blocks.gyro_step_error,
        common_variance=common,
        flicker=_flicker_variance(model, GYRO_FLICKER),
    )


def accel_offsets(blocks: RestBlocks, model: TriadModel) -> Offsets:
    """Return the accelerometers' readings in the pose with the widest range of temperature."""
    blocks = blocks.taken(np.isfinite(blocks.accel).all(axis=1))
    spans_c = [float(np.ptp(blocks.temp_c[blocks.pose == pose])) for pose in np.unique(blocks.pose)]
    blocks = blocks.taken(blocks.pose == np.unique(blocks.pose)[int(np.argmax(spans_c))])
    return Offsets(
        blocks=blocks,
        value=np.array(blocks.accel),
        variance=known_variance(blocks.accel_variance),
        step_error=blocks.accel_step_error,
        common_variance=np.zeros(3),
        flicker=_flicker_variance(model, ACCEL_FLICKER),
    )


def known_variance(variance: FloatArray) -> FloatArray:
    """Return variances, (n, 3), with unknown values replaced by the mean variance."""
    usual = np.nanmean(variance, axis=0) if np.isfinite(variance).any() else np.zeros(3)
    return np.where(np.isfinite(variance), variance, usual)


def _flicker_variance(model: TriadModel | None, instability: float) -> FloatArray:
    """Return the variance of flicker noise, (3,), raw unit squared, for a bias instability in SI units, or 0 without a scale."""
    scale = np.zeros(3) if model is None else np.linalg.norm(model.forward_matrix, axis=1)
    return np.asarray((FLICKER_OF_FLOOR * instability * scale) ** 2)


def specific_force(blocks: RestBlocks, calibration: Calibration | None) -> FloatArray | None:
    """Return the corrected specific force of blocks, (n, 3), m/s2."""
    model = None if calibration is None else calibration.accel
    if model is None or not np.isfinite(blocks.accel).all():
        return None
    return np.asarray((blocks.accel - model.offset) @ model.matrix.T)


def felt_by_gyro(blocks: RestBlocks, calibration: Calibration | None) -> FloatArray:
    """Return the effect of the specific force on the gyroscope readings of blocks, (n, 3), raw unit, or 0 if it is unknown."""
    model, force = None if calibration is None else calibration.gyro, specific_force(blocks, calibration)
    if model is None or model.g_sensitivity is None or force is None:
        return np.zeros((len(blocks), 3))
    return np.asarray(force @ (model.forward_matrix @ model.g_sensitivity).T)


# ---- one triad


@determined("offset over temperature")
def _fit_triad(
    offsets: Offsets,
    nodes: FloatArray,
    settings: StaticSettings,
    reference: tuple[float, TriadModel] | None = None,
) -> TriadDrift:
    """Fit a triad. With a reference the table is the reference offset plus the change since the reference temperature."""
    blocks, findings = offsets.blocks, list[Finding]()
    direction, tau = cooling(blocks), None
    has_loop = both_ways(blocks, direction)
    if not has_loop:
        findings.append(
            finding(
                "drift.hysteresis_unknown",
                "warn",
                f"Warming and cooling did not pass the same {OVERLAP_C:g} degC: the uncertainty lacks hysteresis, warm-up and "
                "lag of the thermometer.",
                "Record a warming and a cooling ramp over the same temperatures.",
            )
        )
    if settings.warm_up:
        try:
            tau = warm_up_time(blocks, offsets.value)
        except NotObservable as error:
            findings.append(not_observable("info", "Warm-up", str(error)))
    columns = ([direction] if has_loop else []) + ([] if tau is None else [np.exp(-blocks.power_on_s / tau)])
    regressors = np.array(columns).reshape(-1, len(blocks)).T
    cells = cells_of(offsets, regressors, direction * has_loop, chunk_s=np.inf if tau is None else CHUNK_S)
    turn_on = between_sessions(cells, settings.lag_uncertainty_s)
    if turn_on is None:
        what, action = "Turn-on bias repeatability", "Record two sessions on two days, over the same temperatures."
        findings.append(not_observable("info", what, "it is not included in the uncertainty.", action))
    curve = _fit_curve(cells, turn_on, settings.lag_uncertainty_s)

    # the curve at the nodes, at the temperatures of the blocks for its mean slope, and at the reference
    temp_c, n = blocks.temp_c, len(nodes)
    inside = np.quantile(temp_c, np.linspace(0.0, 1.0, SLOPE_POINTS))
    points = np.concatenate((nodes, inside, [nodes[0] if reference is None else reference[0]]))
    at = _fit_set_points(cells, curve, points) if settings.not_a_knot else curve.at(points)
    variances = at.uncertainty**2
    value, variance = at.value[:n], variances[:n]
    gravity = np.zeros(3)
    if reference is not None:  # the last point, the reference, contributes the same error to every difference
        model = reference[1]
        gravity = at.value[-1] - model.offset
        variance = variance + variances[-1] - 2.0 * at.covariance[:, :n, -1].T + np.diag(model.covariance)[9:12]
    rows, weight = slice(n, n + SLOPE_POINTS), (inside - inside.mean()) / ((inside - inside.mean()) ** 2).sum()
    slope_variance = np.einsum("i,kij,j->k", weight, at.covariance[:, rows, rows], weight)
    half = curve.coefficient[0] if has_loop else np.zeros(3)
    visit = np.sqrt(curve.visit_deviation**2 + cells.flicker.diagonal(axis1=1, axis2=2).mean(axis=1))
    future = offsets.common_variance + visit**2 + half**2 + (0.0 if turn_on is None else turn_on.future_variance)
    return TriadDrift(
        offset=value - gravity,
        uncertainty=np.sqrt(np.maximum(variance, 0.0) + future),
        visit=visit,
        extrapolated=~near_data(nodes, temp_c, gap_c=GAP_C),
        slope=np.asarray(weight @ at.value[rows]),
        slope_uncertainty=np.sqrt(np.maximum(slope_variance, 0.0)),
        span_c=(float(temp_c.min()), float(temp_c.max())),
        curve=curve,
        cells=cells,
        offsets=offsets,
        turn_on=turn_on,
        gravity=gravity,
        hysteresis=half if has_loop else None,
        hysteresis_uncertainty=curve.coefficient_uncertainty[0] if has_loop else None,
        warm_up=None if tau is None else warm_up_table(tau, curve.coefficient[-1]),
        findings=tuple(findings),
    )


def _fit_accel(
    blocks: RestBlocks, nodes: FloatArray, calibration: Calibration | None, settings: StaticSettings
) -> TriadDrift:
    if calibration is None or calibration.accel is None or not np.isfinite(calibration.reference_temp_c):
        raise NotObservable(
            "it requires an accelerometer calibration with a reference temperature. Calibrate from six faces in recordings with a "
            "temperature column."
        )
    model, reference_c = calibration.accel, calibration.reference_temp_c
    triad = _fit_triad(accel_offsets(blocks, model), nodes, settings, (reference_c, model))
    unknown = UNKNOWN_SCALE_PER_K * np.abs(nodes - reference_c)[:, None] * np.abs(triad.gravity)
    return replace(triad, uncertainty=np.hypot(triad.uncertainty, unknown))


def near_data(nodes: FloatArray, temp_c: FloatArray, *, gap_c: float) -> BoolArray:
    """Return a mask of nodes (n,) with data (k,) nearby: within ``gap_c`` inside the range of the data, 0.5 K outside."""
    nearest = np.abs(nodes[:, None] - temp_c[None, :]).min(axis=1)
    return np.asarray(nearest <= np.where((nodes < temp_c.min()) | (nodes > temp_c.max()), EDGE_C, gap_c))


def _fit_curve(cells: Cells, turn_on: TurnOn | None, lag_s: float, shifts: FloatArray | None = None) -> Curve:
    """Fit the curve with the regressors of the cells, and with shifts of sessions (n, f) if they are to be determined."""
    between, lag_slope = np.zeros(3) if turn_on is None else turn_on.variance, lag_s * _offset_per_lag(cells).T
    return fit_curve(
        cells.temp_c,
        cells.value,
        cells.variance,
        regressors=cells.regressors if shifts is None else np.column_stack((shifts, cells.regressors)),
        correlation=cells.correlation,
        shared=cells.flicker
        + lag_slope[:, :, None] * lag_slope[:, None, :]
        + between[:, None, None] * (cells.session[:, None] == cells.session),
    )


def _offset_per_lag(cells: Cells) -> FloatArray:
    """Return the shift of each cell per second of lag, (n, 3), raw unit per s: ramp times the slope of a cubic over temperature."""
    from numpy.polynomial.polynomial import polyder, polyfit, polyval

    span_c = max(float(np.ptp(cells.temp_c)), 1e-9)
    x = (cells.temp_c - cells.temp_c.mean()) / span_c
    cubic = polyfit(x, cells.value, min(3, len(np.unique(bins_of(cells.temp_c, APART_C))) - 1))
    return np.asarray(polyval(x, polyder(cubic)).T / span_c * cells.ramp_c_per_s[:, None])


def _fit_set_points(cells: Cells, curve: Curve, nodes: FloatArray) -> NodeValues:
    """Return the note's curve: a not-a-knot spline through the means of the set-points, after effects are subtracted."""
    residual = cells.value - cells.regressors @ curve.coefficient
    variance = cells.variance + np.diag(cells.correlation)[:, None] * curve.visit_deviation**2
    variance = variance + cells.flicker.diagonal(axis1=1, axis2=2).T
    rows = split_by(np.arange(len(residual)), bins_of(cells.temp_c, 1.0))
    return not_a_knot(
        np.array([cells.temp_c[r].mean() for r in rows]),
        np.array([residual[r].mean(axis=0) for r in rows]),
        np.array([variance[r].sum(axis=0) / len(r) ** 2 for r in rows]),
        nodes,
    )


# ---- cells


def cells_of(offsets: Offsets, regressors: FloatArray, direction: FloatArray, *, chunk_s: float) -> Cells:
    """Average blocks of the same rest, direction (n,) and temperature, with their regressors (n, p).

    Cells end when the time since power-on passes ``chunk_s``, twice ``chunk_s``, four times ``chunk_s``, and so on.
    """
    blocks = offsets.blocks
    rest, chunk = rests_of(blocks), np.floor(np.log2(np.maximum(blocks.power_on_s / chunk_s, 0.5)))
    used = np.flatnonzero(rest >= 0)
    parts = split_by(used, rest[used], np.round(direction[used]), chunk[used])
    parts = [rows[np.argsort(blocks.temp_c[rows], kind="stable")] for rows in parts]
    width = max(CELL_C, sum(float(np.ptp(blocks.temp_c[rows])) for rows in parts) / MOST_CELLS)
    members = [rows for group in parts for rows in split_by(group, bins_of(blocks.temp_c[group], width))]
    members.sort(key=lambda rows: float(blocks.temp_c[rows].mean()))
    first, soaked = [rows[0] for rows in members], at_soaks(blocks, used)
    flicker = flicker_correlation(blocks, members)
    return Cells(
        session=blocks.session[first],
        temp_c=np.array([blocks.temp_c[rows].mean() for rows in members]),
        value=np.array([offsets.value[rows].mean(axis=0) for rows in members]),
        variance=np.array([variance_of_mean(offsets.variance[rows], offsets.step_error[rows]) for rows in members]),
        regressors=np.array([regressors[rows].mean(axis=0) for rows in members]),
        ramp_c_per_s=np.array([(soaked * blocks.ramp_c_per_min)[rows].mean() for rows in members]) / 60.0,
        correlation=OWN * (rest[first][:, None] == rest[first]) + (1.0 - OWN) * flicker / np.diag(flicker).mean(),
        flicker=offsets.flicker[:, None, None] * flicker,
    )


def split_by(rows: IntArray, *keys: FloatArray | IntArray) -> list[IntArray]:
    """Return the rows of each combination of keys."""
    number = np.unique(np.column_stack(keys), axis=0, return_inverse=True)[1].reshape(-1)
    return [rows[number == k] for k in range(number.max(initial=-1) + 1)]


def bins_of(temp_c: FloatArray, width: float) -> IntArray:
    """Return bin numbers of increasing temperatures, (n,). A bin begins at a value and contains values up to a width above it."""
    bins, begin = np.zeros(len(temp_c), np.int64), temp_c[0]
    for k in range(1, len(temp_c)):
        new = temp_c[k] - begin > width
        begin = temp_c[k] if new else begin
        bins[k] = bins[k - 1] + new
    return bins


def rests_of(blocks: RestBlocks) -> IntArray:
    """Return the rest of each block, (n,). A new rest begins with a session, a pose, a pause, or a step of temperature.

    In a log with soaks, each soak is one rest. Blocks on ramps get -1, because a ramp would transfer a deviation to the next soak.
    """
    ramp = np.abs(blocks.ramp_c_per_min)
    fast = float(np.quantile(ramp, 0.9))
    slow = ramp <= SLOW * fast
    soaks = np.count_nonzero(np.diff(np.sort(blocks.temp_c[slow])) > APART_C) + 1
    if not slow.any() or np.median(ramp[slow]) >= STILL * fast or soaks < LEAST_SOAKS:  # one ramp, or soaks only
        slow = np.ones(len(blocks), bool)
    order = np.lexsort((blocks.time, blocks.session))
    order = order[slow[order]]
    limits = ((blocks.session, 0), (blocks.pose, 0), (blocks.time, APART_S), (blocks.temp_c, APART_C))
    another = [np.abs(np.diff(column[order])) > limit for column, limit in limits]
    number = np.full(len(blocks), -1, np.int64)
    number[order] = np.concatenate(([0], np.cumsum(np.any(another, axis=0))))
    return number


def at_soaks(blocks: RestBlocks, used: IntArray) -> BoolArray:
    """Return True for the blocks of sessions with separate temperatures, each no wider than a rest, (n,).

    On a sweep, the thermometer lags in use as it did in the log, so a table that contains the lag is correct.
    """
    soaked = np.zeros(len(blocks), bool)
    for rows in split_by(used, blocks.session[used]):
        temp_c = np.sort(blocks.temp_c[rows])
        soaks = np.split(temp_c, np.flatnonzero(np.diff(temp_c) > APART_C) + 1)
        soaked[rows] = max(float(np.ptp(soak)) for soak in soaks) <= APART_C
    return soaked


def variance_of_mean(variance: FloatArray, step_error: FloatArray) -> FloatArray:
    """Return the variance of a mean over blocks (n, 3), from their noise and common rounding errors of the converter, (3,)."""
    return np.asarray(variance.mean(axis=0) / len(variance) + (step_error**2).mean(axis=0))


def flicker_correlation(blocks: RestBlocks, members: list[IntArray]) -> FloatArray:
    """Return the mean correlation over time between the blocks of two cells, (n, n), or 0 between sessions.

    Flicker noise is a sum of first-order processes of equal variance, with time constants spaced evenly in their logarithm.
    """
    sampled = [rows[np.linspace(0, len(rows) - 1, min(len(rows), PAIRED)).astype(int)] for rows in members]
    counts = np.array([len(rows) for rows in sampled])
    starts = np.cumsum(counts) - counts
    time, session = blocks.time[np.concatenate(sampled)], blocks.session[[rows[0] for rows in members]]
    correlation = np.zeros((len(members), len(members)))
    for k, rows in enumerate(sampled):
        lag_s = np.abs(blocks.time[rows][:, None] - time)
        process = np.mean([np.exp(-lag_s / tau).mean(axis=0) for tau in FLICKER_S], axis=0)
        correlation[k] = np.add.reduceat(process, starts) / counts
    correlation *= session[:, None] == session
    return np.asarray(0.5 * (correlation + correlation.T))


# ---- scatter between switch-ons


def between_sessions(cells: Cells, lag_s: float) -> TurnOn | None:
    """Return the change of the offset between sessions with common temperatures, or None if no two sessions have common
    temperatures.

    The shifts of the sessions sum to zero. Their excess variance (Paule and Mandel) counts, with the variance of the shifts as its
    lower limit, because sessions that agree by chance do not prove that the offset is constant.
    """
    from scipy.sparse.csgraph import connected_components

    numbers = np.unique(cells.session)
    temps = [cells.temp_c[cells.session == number] for number in numbers]
    tied = [[np.abs(first[:, None] - second).min() <= SHARED_C for second in temps] for first in temps]
    group = connected_components(np.array(tied))[1]
    sharing = numbers[group == np.bincount(group).argmax()]
    free = len(sharing) - 1
    if free == 0:
        return None
    contrasts = np.vstack((np.eye(free), -np.ones(free)))
    try:
        curve = _fit_curve(cells, None, lag_s, (cells.session[:, None] == sharing) @ contrasts)
    except NotObservable:
        return None
    shift, shift_variance = contrasts @ curve.coefficient[:free], curve.coefficient_uncertainty[:free] ** 2
    shift_variance = np.vstack((shift_variance, shift_variance.mean(axis=0)))
    excess = np.array([excess_variance(shift[:, axis], shift_variance[:, axis], free) for axis in range(3)])
    variance = np.maximum(excess, shift_variance.mean(axis=0))
    return TurnOn(variance=variance, future_variance=student_factor(free) * variance)


# ---- hysteresis: direction of the temperature change


def cooling(blocks: RestBlocks) -> FloatArray:
    """Return c of each block, (n,): +1 while cooling, -1 while warming, 0 before the temperature changed.

    In the play operator of Prandtl, p follows the temperature at a distance of at most ``CROSSED_C`` / 2, and c is that distance.
    """
    state, reach = np.zeros(len(blocks)), 0.5 * CROSSED_C
    for rows in split_by(np.arange(len(blocks)), blocks.session):
        rows = rows[np.argsort(blocks.time[rows], kind="stable")]
        play = blocks.temp_c[rows[0]]
        for k in rows:
            play = min(max(play, blocks.temp_c[k] - reach), blocks.temp_c[k] + reach)
            state[k] = (play - blocks.temp_c[k]) / reach
    return state


def both_ways(blocks: RestBlocks, state: FloatArray) -> bool:
    """Return True if cooling and warming cover a common range of temperature."""
    up, down = blocks.temp_c[state < -0.5], blocks.temp_c[state > 0.5]
    return bool(len(up) and len(down) and min(up.max(), down.max()) - max(up.min(), down.min()) >= OVERLAP_C)


# ---- warm-up


def warm_up_time(blocks: RestBlocks, value: FloatArray) -> float:
    """Return the time constant of the warm-up of values (n, 3), s: least squares on a grid."""
    low, span = float(blocks.temp_c.min()), max(float(np.ptp(blocks.temp_c)), 1e-9)
    basis = np.polynomial.chebyshev.chebvander(2.0 * (blocks.temp_c - low) / span - 1.0, CURVE_POWER)

    def unexplained(values: FloatArray) -> FloatArray:
        return np.asarray(values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0])

    constants = np.geomspace(30.0, 3600.0, 25)
    decay, residual = np.exp(-blocks.power_on_s[:, None] / constants), unexplained(value)
    unexplained_decay = unexplained(decay)
    share = unexplained_decay.var(axis=0) / np.maximum(decay.var(axis=0), 1e-300)
    explained = (unexplained_decay.T @ residual) ** 2 / np.maximum((unexplained_decay**2).sum(axis=0), 1e-300)[:, None]
    best = int((explained / np.maximum(residual.var(axis=0), 1e-300)).sum(axis=1).argmax())
    if share[best] < LEAST_OWN:
        raise NotObservable(
            f"warm-up: {100.0 * (1.0 - share[best]):.1f} % of the transient since power-on is explained by temperature. Keep the "
            f"temperature constant for half an hour after power-on, or warm up from two temperatures.",
            share=float(share[best]),
        )
    return float(constants[best])


def warm_up_table(time_constant_s: float, amplitude: FloatArray) -> WarmUp:
    """Return the warm-up as a table whose last value is zero."""
    time = time_constant_s * WARM_UP_SPAN * np.linspace(0.0, 1.0, WARM_UP_NODES) ** 1.5
    decay = np.exp(-time / time_constant_s)
    decay[-1] = 0.0
    return WarmUp(power_on_s=time, gyro_offset=decay[:, None] * amplitude)
