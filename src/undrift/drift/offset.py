"""Offsets over temperature, from blocks of rest (static drift).

    gyroscopes       y = u - K G a                             u mean reading, K = M^-1; a g-sensitivity is not an offset
    accelerometers   y = u in one pose;  offset(T) = offset(T_ref) + y(T) - y(T_ref)
    both             y = f(T) + h c + A exp(-t / tau) + d_s + v + r + e

f      a smooth curve (fit/curve.py) through the means of the cells. A cell holds the blocks of one visit within a narrow range of
       temperature, so that the hot end of a warm-up counts no more than its degrees
v      deviation of one visit to a temperature: flicker noise of the size that the blocks within the rests show, and beyond it one
       variance about the curve
r      deviation of one rest, from the rests of a cell: other poses, hysteresis, a device that moved
h      half-width of the hysteresis: c = +1 while cooling, -1 while warming, and in between over ``CROSSED_C`` after a turn
A, tau warm-up, t since power-on. It differs from f only if time and temperature differ: in a soak, or in several warm-ups
d_s    shift of session s; its variance counts for a future session
e      noise of the means, and what the steps of a converter leave

T_ref and offset(T_ref) are those of the calibration. One pose cannot separate a change of scale along gravity from a change of
offset: 0.02 %/K * |T - T_ref| of what gravity reads counts as uncertainty. The uncertainty of a node is that of a future visit:
the curve between and beyond the temperatures seen, visit, rest, half-width of the hysteresis and session.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.plausibility import check_gravity
from undrift.drift.observe import FAR, ROBUST, RestBlocks
from undrift.errors import Implausible, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.curve import Cubics, Curve, NodeValues, fit_curve, not_a_knot
from undrift.fit.gls import determined, excess_variance, student_factor
from undrift.model import G_NAMES, Calibration, StaticDrift, TriadModel, Verdict, WarmUp
from undrift.units import STANDARD_GRAVITY, is_physical, si_factor

UNKNOWN_SCALE_PER_K = 2e-4  # of accelerometers seen in one pose: a capacitive sensor shifts by +-1 % in 50 K
EDGE_C = 0.5  # a node this far outside the temperatures seen is extrapolated
GAP_C = 5.0  # and so is a node between temperatures seen, this far from both
SLOPE_POINTS = 60
MOST_OF_SPAN = 0.8  # share of a pose's range that one mounting must have seen for the others to be left out [assumed]
# ---- cells
CELL_C, MOST_CELLS = 0.5, 100  # narrowest cell; cells are widened until there are about as many
STEP_C = 2.0  # between blocks: a larger step begins another visit
SLOW, STILL = 0.25, 0.05  # shares of a log's fast ramps [assumed]
LEAST_SOAKS = 5  # temperatures from which a log is one of soaks [assumed]
FLICKER_S = 10.0 ** np.arange(1.0, 4.1, 0.5)  # time constants of the processes that flicker noise is made of
PAIRED = 30  # blocks of a cell that its correlation is taken from
RESTS_APART_S = 60.0
LEAST_JUDGED = 5  # blocks of a rest: fewer do not determine which one is wrong
AXES_ALIKE = 2.0  # degrees of freedom by which the axes of a triad are taken to be alike [assumed]
GROUPS = 20  # groups of neighbouring cells that are left out in turn, at most
LEAST_LEFT_OUT, CHANCE = 5, 1e-3  # groups that are judged by; chance of a false finding
SHARED_C = 1.0  # sessions with cells nearer than this share a temperature
DISAGREE = 2.0  # times the noise of a rest: scatter of rests that is reported
# ---- hysteresis
TURN_C = 1.0  # K; the temperature must change by this much before it has a direction, or another one
CROSSED_C = 4.0  # after a turn the loop is crossed over this much of temperature
OVERLAP_C = 3.0  # range that both directions must have seen
# ---- warm-up
CHUNK_S = 120.0  # cells are cut there and at its doubles
LEAST_OWN = 0.05  # share of the variance of exp(-t / tau) that temperature must leave unexplained
CURVE_INTERVALS = 5  # of the curve over temperature that a warm-up must differ from
WARM_UP_NODES, WARM_UP_SPAN = 13, 5.0  # of its table; time constants


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticSettings:
    """How offset over temperature is fitted."""

    not_a_knot: bool = False  # True for the note's spline through the set-point means, False for the smooth curve
    warm_up: bool = False  # fit a power-on transient; recordings begin at power-on
    accel_unit: str = "count"  # unit of the accelerometer's readings if no calibration states it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Offsets:
    """Offset readings of one triad, n blocks."""

    blocks: RestBlocks
    value: FloatArray  # (n, 3), raw unit
    variance: FloatArray  # (n, 3), variance by noise, raw unit squared
    step_error: FloatArray | None  # (n, 3), what the converter's steps leave in each, raw unit
    common_variance: FloatArray  # (3,), variance of what all of them have in common, raw unit squared


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cells:
    """Means of the blocks of one visit and temperature, n cells."""

    session: IntArray  # (n,)
    temp_c: FloatArray  # (n,), degC
    value: FloatArray  # (n, 3), raw unit
    variance: FloatArray  # (n, 3), by noise, steps and rests, raw unit squared
    regressors: FloatArray  # (n, p)
    flicker: FloatArray  # (3,), variance of flicker noise, raw unit squared
    wander: FloatArray  # (n, n), correlation of the flicker noise of cells, mean diagonal below 1
    correlation: FloatArray  # (n, n), of the deviations of visits beyond it, mean diagonal 1
    groups: IntArray  # (n,), neighbours in temperature
    rest: FloatArray  # (3,), standard deviation from rest to rest beyond their noise, raw unit
    rest_noise: FloatArray  # (3,), standard deviation of one rest by noise, raw unit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnOn:
    """Scatter between sessions, raw unit; NaN if the sessions share no temperatures."""

    shift: FloatArray  # (s, 3), each session against those that share its temperatures
    variance: FloatArray  # (3,), between sessions
    future_variance: FloatArray  # (3,), for a future session; 0 if not observable


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadDrift:
    """Offset over temperature of one triad, n nodes, raw unit."""

    offset: FloatArray | None  # (n, 3), absolute; None if only the change is known
    uncertainty: FloatArray  # (n, 3), standard uncertainty of each node, for a future visit
    visit: FloatArray  # (3,), standard deviation of what one visit adds; part of ``uncertainty``
    extrapolated: BoolArray  # (n,), True if no data were near
    slope: FloatArray  # (3,), mean over the temperatures of the blocks, raw unit per K
    slope_uncertainty: FloatArray  # (3,)
    span_c: tuple[float, float]  # least and greatest temperature seen, degC
    curve: Curve
    cells: Cells
    offsets: Offsets
    turn_on: TurnOn | None  # None for one session
    hysteresis: FloatArray | None = None  # (3,), half-width; None if the temperature went one way only
    hysteresis_uncertainty: FloatArray | None = None  # (3,)
    warm_up: WarmUp | None = None
    unknown_scale: FloatArray | None = None  # (n, 3), part of ``uncertainty`` for a change of scale along gravity
    findings: tuple[Finding, ...] = ()

    @property
    def curve_uncertainty(self) -> FloatArray:
        """Standard uncertainty of the curve itself, the mean over visits, shape (n, 3)."""
        return np.asarray(np.sqrt(np.maximum(self.uncertainty**2 - self.visit**2, 0.0)))

    @property
    def mostly_unknown_scale(self) -> bool:
        """True if a change of scale is most of the variance, at half the nodes near data or more."""
        if self.unknown_scale is None:
            return False
        near = ~self.extrapolated if not self.extrapolated.all() else self.extrapolated
        total = np.maximum((self.uncertainty[near] ** 2).sum(axis=1), 1e-300)
        return bool(np.median((self.unknown_scale[near] ** 2).sum(axis=1) / total) > 0.5)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StaticFit:
    """A static tuning table and what it is worth."""

    table: StaticDrift  # at the nodes asked for
    gyro: TriadDrift | None  # None if a triad was not observed
    accel: TriadDrift | None
    verdict: Verdict


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
        findings += [*gyro.findings, *_left_out_findings("gyroscope", gyro)]
        if calibration is None or calibration.gyro is None or calibration.gyro.g_sensitivity is None:
            findings.append(finding("drift.g_unknown", "info"))
    try:
        accel = _fit_accel(blocks, nodes, calibration, settings)
        missing = "" if accel.offset is not None else _NO_TABLE
        findings += [_one_pose(blocks, accel), *_left_out_findings("accelerometer", accel)]
        findings += () if gyro is not None else accel.findings  # otherwise those of the gyroscopes at the same rests
    except NotObservable as error:
        missing = str(error)
    except Implausible as error:
        findings.append(finding("drift.accel_gravity", "warn", problem=str(error)))
        missing = ""
    if missing:
        findings.append(finding("drift.accel_not_observable", "info", problem=missing))
    if gyro is None and accel is None:
        raise NotObservable(
            "static drift: expected readings at two temperatures or more, got none; "
            + "; ".join(item.text for item in findings)
        )
    columns = {
        f"{sensor}_{name}": getattr(triad, name)
        for sensor, triad in (("gyro", gyro), ("accel", accel))
        if triad is not None and triad.offset is not None
        for name in ("offset", "uncertainty", "extrapolated", "visit")
    }
    table = StaticDrift(
        temp_c=nodes,
        **columns,
        gyro_hysteresis=None if gyro is None else gyro.hysteresis,
        warm_up=None if gyro is None else gyro.warm_up,
    )
    return StaticFit(table=table, gyro=gyro, accel=accel, verdict=Verdict.of(*findings))


_NO_TABLE = (
    "only the change over temperature is known. Calibrate six faces with a temperature column: the calibration must have "
    "accelerometers and a reference temperature."
)


def _one_pose(blocks: RestBlocks, accel: TriadDrift) -> Finding:
    return finding(
        "drift.accel_one_pose",
        "warn" if accel.mostly_unknown_scale else "info",
        poses=len(np.unique(blocks.pose)),
        span_c=accel.span_c[1] - accel.span_c[0],
        percent_per_c=100.0 * UNKNOWN_SCALE_PER_K,
    )


# ---- offset readings


def gyro_offsets(blocks: RestBlocks, calibration: Calibration | None) -> Offsets | None:
    """Return the gyroscopes' readings at rest without g-sensitivity; None if there are none."""
    blocks = blocks.taken(np.isfinite(blocks.gyro).all(axis=1))
    if not len(blocks):
        return None
    model, force = None if calibration is None else calibration.gyro, specific_force(blocks, calibration)
    common = np.zeros(3)
    if model is not None and model.g_sensitivity is not None and force is not None and G_NAMES[0] in model.parameters:
        start, k, mean = model.parameters.index(G_NAMES[0]), model.forward_matrix, force.mean(axis=0)
        of_g = model.covariance[start : start + len(G_NAMES), start : start + len(G_NAMES)].reshape(3, 3, 3, 3)
        common = np.einsum("ka,kb,i,j,aibj->k", k, k, mean, mean, of_g)  # at the mean specific force
    return Offsets(
        blocks=blocks,
        value=blocks.gyro - felt_by_gyro(blocks, calibration),
        variance=known_variance(blocks.gyro_variance),
        step_error=blocks.gyro_step_error,
        common_variance=common,
    )


def accel_offsets(blocks: RestBlocks, calibration: Calibration | None, accel_unit: str) -> Offsets:
    """Return the accelerometers' readings in the pose that saw the widest range of temperature, if possible of one mounting.

    Raises ``NotObservable`` without readings and ``Implausible`` if they cannot be gravity.
    """
    blocks = blocks.taken(np.isfinite(blocks.accel).all(axis=1))
    if not len(blocks):
        raise NotObservable("no readings. Map the accel columns.")
    force = specific_force(blocks, calibration)
    if force is None and is_physical(accel_unit):
        force = blocks.accel * si_factor(accel_unit, "accel")
    if force is not None:
        check_gravity(force, STANDARD_GRAVITY if calibration is None else calibration.gravity_m_s2)
    blocks = _widest(blocks, blocks.pose, 0.0)
    if blocks.mounting is not None:  # a face mounted again is not level as before: its tilt would count as temperature
        blocks = _widest(blocks, blocks.mounting, MOST_OF_SPAN * float(np.ptp(blocks.temp_c)))
    return Offsets(
        blocks=blocks,
        value=np.array(blocks.accel),
        variance=known_variance(blocks.accel_variance),
        step_error=blocks.accel_step_error,
        common_variance=np.zeros(3),
    )


def _widest(blocks: RestBlocks, number: IntArray, least_c: float) -> RestBlocks:
    """Return the blocks of the number that saw the widest range of temperature; all blocks if that is below ``least_c``."""
    widest = max(np.unique(number).tolist(), key=lambda k: float(np.ptp(blocks.temp_c[number == k])))
    chosen = blocks.taken(number == widest)
    return chosen if np.ptp(chosen.temp_c) >= least_c else blocks


def known_variance(variance: FloatArray) -> FloatArray:
    """Return variances, (n, 3), with the mean of the others where a variance is not known."""
    usual = np.nanmean(variance, axis=0) if np.isfinite(variance).any() else np.zeros(3)
    return np.where(np.isfinite(variance), variance, usual)


def specific_force(blocks: RestBlocks, calibration: Calibration | None) -> FloatArray | None:
    """Return the corrected specific force of blocks, (n, 3), m/s2."""
    model = None if calibration is None else calibration.accel
    if model is None or not np.isfinite(blocks.accel).all():
        return None
    return np.asarray((blocks.accel - model.offset) @ model.matrix.T)


def felt_by_gyro(blocks: RestBlocks, calibration: Calibration | None) -> FloatArray:
    """Return what specific force adds to the gyroscopes' readings of blocks, (n, 3), raw unit; 0 if that is not known."""
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
    """Fit one triad; with a reference the table is its offset plus the change since its temperature."""
    blocks, findings = offsets.blocks, list[Finding]()
    direction, tau = cooling(blocks), None
    has_loop = both_ways(blocks, direction)
    if not has_loop:
        findings.append(finding("drift.hysteresis_unknown", "warn", overlap_c=OVERLAP_C))
    if settings.warm_up:
        try:
            tau = warm_up_time(blocks, offsets.value)
        except NotObservable as error:
            findings.append(finding("drift.warm_up_not_observable", "info", problem=str(error)))
    columns = ([direction] if has_loop else []) + ([] if tau is None else [np.exp(-blocks.power_on_s / tau)])
    regressors = np.array(columns).reshape(-1, len(blocks)).T
    cells = cells_of(offsets, regressors, direction * has_loop, chunk_s=np.inf if tau is None else CHUNK_S)
    turn_on = between_sessions(cells)
    if turn_on is None or not np.isfinite(turn_on.variance).all():
        findings.append(finding("drift.turn_on_unknown", "info", sessions=len(np.unique(cells.session))))
    if (cells.rest > DISAGREE * cells.rest_noise).any():
        findings.append(
            finding("drift.rests_disagree", "info", ratio=cells.rest / np.maximum(cells.rest_noise, 1e-300))
        )
    curve = _curve_through(cells, turn_on)

    # the curve at the nodes, at the temperatures of the blocks for its mean slope, and at the reference
    temp_c, n = blocks.temp_c, len(nodes)
    inside = np.quantile(temp_c, np.linspace(0.0, 1.0, SLOPE_POINTS))
    points = np.concatenate((nodes, inside, [nodes[0] if reference is None else reference[0]]))
    at = _through_set_points(cells, curve, points) if settings.not_a_knot else curve.at(points)
    variances = at.uncertainty**2
    value, variance = at.value[:n], variances[:n]
    if reference is not None:  # the last point: its error is shared by both ends of the difference
        model = reference[1]
        value = model.offset + value - at.value[-1]
        variance = variance + variances[-1] - 2.0 * at.covariance[:, :n, -1].T + np.diag(model.covariance)[9:12]
    rows, weight = slice(n, n + SLOPE_POINTS), (inside - inside.mean()) / ((inside - inside.mean()) ** 2).sum()
    slope_variance = np.einsum("i,kij,j->k", weight, at.covariance[:, rows, rows], weight)
    visit = np.sqrt(curve.visit_deviation**2 + cells.flicker * np.diag(cells.wander).mean() + cells.rest**2)
    half = curve.coefficient[0] if has_loop else np.zeros(3)
    future = offsets.common_variance + visit**2 + half**2 + (0.0 if turn_on is None else turn_on.future_variance)
    return TriadDrift(
        offset=value,
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
        hysteresis=half if has_loop else None,
        hysteresis_uncertainty=curve.coefficient_uncertainty[0] if has_loop else None,
        warm_up=None if tau is None else warm_up_table(tau, curve.coefficient[-1]),
        findings=tuple(findings),
    )


def _fit_accel(
    blocks: RestBlocks, nodes: FloatArray, calibration: Calibration | None, settings: StaticSettings
) -> TriadDrift:
    offsets = accel_offsets(blocks, calibration, settings.accel_unit)
    model = None if calibration is None else calibration.accel
    reference_c = np.nan if calibration is None else calibration.reference_temp_c
    if model is None or not np.isfinite(reference_c):
        return replace(_fit_triad(offsets, nodes, settings), offset=None)
    triad = _fit_triad(offsets, nodes, settings, (reference_c, model))
    gravity = triad.curve.at(np.array([reference_c])).value[0] - model.offset
    unknown = UNKNOWN_SCALE_PER_K * np.abs(nodes - reference_c)[:, None] * np.abs(gravity)
    return replace(triad, uncertainty=np.hypot(triad.uncertainty, unknown), unknown_scale=unknown)


def near_data(nodes: FloatArray, temp_c: FloatArray, *, gap_c: float) -> BoolArray:
    """Return a mask of nodes (n,) with data (k,) nearby: within ``gap_c`` inside the range of the data, 0.5 K outside."""
    nearest = np.abs(nodes[:, None] - temp_c[None, :]).min(axis=1)
    return np.asarray(nearest <= np.where((nodes < temp_c.min()) | (nodes > temp_c.max()), EDGE_C, gap_c))


def _curve_through(cells: Cells, turn_on: TurnOn | None, shifts: FloatArray | None = None) -> Curve:
    """Fit the curve with the regressors of the cells, and with shifts of sessions (n, f) if they are to be determined."""
    together = (cells.session[:, None] == cells.session).astype(float)
    between = np.zeros(3) if turn_on is None else np.nan_to_num(turn_on.variance)
    return fit_curve(
        cells.temp_c,
        cells.value,
        cells.variance,
        regressors=cells.regressors if shifts is None else np.column_stack((shifts, cells.regressors)),
        correlation=cells.correlation,
        shared=cells.flicker[:, None, None] * cells.wander + between[:, None, None] * together,
    )


def _through_set_points(cells: Cells, curve: Curve, nodes: FloatArray) -> NodeValues:
    """Return the note's curve: not-a-knot through the means of the set-points, effects subtracted."""
    residual = cells.value - cells.regressors @ curve.coefficient
    variance = cells.variance + np.diag(cells.wander)[:, None] * cells.flicker + curve.visit_deviation**2
    bins = bins_of(cells.temp_c, 1.0)
    rows = [np.flatnonzero(bins == k) for k in np.unique(bins)]
    return not_a_knot(
        np.array([cells.temp_c[r].mean() for r in rows]),
        np.array([residual[r].mean(axis=0) for r in rows]),
        np.array([variance[r].sum(axis=0) / len(r) ** 2 for r in rows]),
        nodes,
    )


def _left_out_findings(sensor: str, triad: TriadDrift) -> list[Finding]:
    """Return the finding that groups of neighbours, left out in turn, are missed by more than is stated."""
    from scipy.special import chdtri

    groups = triad.cells.groups
    count, ratio = len(np.unique(groups)), triad.curve.left_out(groups)[1]
    if count < LEAST_LEFT_OUT or not ratio.max() > np.sqrt(chdtri(count, CHANCE / len(ratio)) / count):
        return []
    return [finding("drift.left_out_above", "warn", sensor=sensor, ratio=ratio, groups=count)]


# ---- cells


def cells_of(offsets: Offsets, regressors: FloatArray, direction: FloatArray, *, chunk_s: float) -> Cells:
    """Average blocks of one visit, direction (n,) and temperature; regressors (n, p) are averaged with them.

    Cells are cut where the time since power-on passes ``chunk_s``, twice and four times this, and so on.
    """
    blocks = offsets.blocks
    visit, chunk = visits_of(blocks), np.floor(np.log2(np.maximum(blocks.power_on_s / chunk_s, 0.5)))
    used = np.flatnonzero(visit >= 0)
    parts = split_by(used, visit[used], np.round(direction[used]), chunk[used])
    parts = [rows[np.argsort(blocks.temp_c[rows], kind="stable")] for rows in parts]
    width = max(CELL_C, sum(float(np.ptp(blocks.temp_c[rows])) for rows in parts) / MOST_CELLS)
    members = [rows for part in parts for rows in split_by(part, bins_of(blocks.temp_c[part], width))]
    members.sort(key=lambda rows: float(blocks.temp_c[rows].mean()))
    rests = [_rests_of(offsets, rows) for rows in members]
    members = [np.concatenate(part) for part in rests]
    temp_c = np.array([blocks.temp_c[rows].mean() for rows in members])
    means = np.array([offsets.value[rows].mean(axis=0) for rows in members])
    about = temp_c - temp_c.mean()
    slope = np.asarray(about @ means / max(float(about @ about), 1e-9))
    level = offsets.value - slope * blocks.temp_c[:, None]  # the usual slope within a cell is subtracted
    flicker = _flicker_variance(offsets, [rows for part in rests for rows in part], level)
    rest, rest_noise = _scatter_of_rests(offsets, rests, level, flicker)
    share = np.array([sum(len(rows) ** 2 for rows in part) / sum(map(len, part)) ** 2 for part in rests])
    wander, of_cell = flicker_correlation(blocks, members), visit[[rows[0] for rows in members]]
    return Cells(
        session=np.array([blocks.session[rows[0]] for rows in members], np.int64),
        temp_c=temp_c,
        value=means,
        variance=np.array([_variance_of_cell(offsets, rows) for rows in members]) + share[:, None] * rest**2,
        regressors=np.array([regressors[rows].mean(axis=0) for rows in members]),
        flicker=flicker,
        wander=wander,
        correlation=wander * (of_cell[:, None] == of_cell) / np.diag(wander).mean(),
        groups=bins_of(temp_c, max(1.5 * width, float(np.ptp(temp_c)) / GROUPS)),
        rest=rest,
        rest_noise=rest_noise,
    )


def split_by(rows: IntArray, *keys: FloatArray | IntArray) -> list[IntArray]:
    """Return the rows of each combination of keys."""
    number = np.unique(np.column_stack(keys), axis=0, return_inverse=True)[1].reshape(-1)
    return [rows[number == k] for k in range(number.max(initial=-1) + 1)]


def bins_of(temp_c: FloatArray, width: float) -> IntArray:
    """Return numbers of bins of increasing temperatures, (n,): a bin begins at a value and holds those within a width above it."""
    bins, begin = np.zeros(len(temp_c), np.int64), temp_c[0]
    for k in range(1, len(temp_c)):
        new = temp_c[k] - begin > width
        begin = temp_c[k] if new else begin
        bins[k] = bins[k - 1] + new
    return bins


def visits_of(blocks: RestBlocks) -> IntArray:
    """Return which visit each block belongs to, (n,): a step of temperature, or another session, begins another one.

    A log through soaks has one visit at each soak, and -1 on the ramps between: a ramp would carry the deviation of one visit over
    to the next.
    """
    ramp = np.abs(blocks.ramp_c_per_min)
    fast = float(np.quantile(ramp, 0.9))
    slow = ramp <= SLOW * fast
    soaks = np.count_nonzero(np.diff(np.sort(blocks.temp_c[slow])) > STEP_C) + 1
    if not slow.any() or np.median(ramp[slow]) >= STILL * fast or soaks < LEAST_SOAKS:  # one ramp, or soaks only
        slow = np.ones(len(blocks), bool)
    order = np.lexsort((blocks.time, blocks.session))
    order = order[slow[order]]
    step = (np.abs(np.diff(blocks.temp_c[order])) > STEP_C) | (np.diff(blocks.session[order]) != 0)
    visit = np.full(len(blocks), -1, np.int64)
    visit[order] = np.concatenate(([0], np.cumsum(step)))
    return visit


def _rests_of(offsets: Offsets, rows: IntArray) -> list[IntArray]:
    """Return the blocks of each rest of a cell: of one pose, without a pause; blocks far from the others of a rest are left out."""
    blocks, rests = offsets.blocks, list[IntArray]()
    for part in split_by(rows, blocks.pose[rows]):
        part = part[np.argsort(blocks.time[part], kind="stable")]
        for rest in np.split(part, np.flatnonzero(np.diff(blocks.time[part]) > RESTS_APART_S) + 1):
            off = np.abs(offsets.value[rest] - np.median(offsets.value[rest], axis=0))
            near = (off <= FAR * ROBUST * np.median(off, axis=0)).all(axis=1)
            rests.append(rest[near] if len(rest) >= LEAST_JUDGED and near.mean() > 0.5 else rest)
    return rests


def _variance_of_cell(offsets: Offsets, rows: IntArray) -> FloatArray:
    step_error = None if offsets.step_error is None else offsets.step_error[rows]
    return variance_of_mean(offsets.value[rows], offsets.variance[rows], step_error)


def variance_of_mean(value: FloatArray, variance: FloatArray, step_error: FloatArray | None) -> FloatArray:
    """Return the variance of a mean over blocks (n, 3) by their noise and by what a converter's steps leave, (3,)."""
    noise: FloatArray = variance.mean(axis=0) / len(value)
    if step_error is None:
        return noise
    left = np.nanmean(step_error, axis=0)
    steps = np.ptp(value, axis=0) / np.maximum(np.sqrt(12.0) * left, 1e-300)  # steps of the converter that were crossed
    return np.asarray(noise + left**2 / (1.0 + np.where(left > 0.0, steps, 0.0)))


def _scatter_of_rests(
    offsets: Offsets, rests: list[list[IntArray]], level: FloatArray, flicker: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviation between the rests of a cell beyond their noise, and that noise, (3,) each.

    Of n rests in a cell, with mean levels m and noise variances v: sum (m - mean)^2 = (n - 1) s^2 + (1 - 1/n) sum v. The axes of a
    triad are alike, so s^2 is drawn towards their mean. Poses that are visited again and again count once in Student's factor.
    """
    square, noise, freedom, known = np.zeros(3), np.zeros(3), 0, list[FloatArray]()
    for part in rests:
        means = np.array([level[rows].mean(axis=0) for rows in part])
        variance = np.array([flicker + _variance_of_cell(offsets, rows) for rows in part])
        known.append(variance.mean(axis=0))
        square += ((means - means.mean(axis=0)) ** 2).sum(axis=0)
        noise += (1.0 - 1.0 / len(part)) * variance.sum(axis=0)
        freedom += len(part) - 1
    rest = np.maximum(square - noise, 0.0) / max(freedom, 1)
    poses = len(np.unique(offsets.blocks.pose))
    freedom = min(freedom, poses - 1) if poses > 1 else freedom
    rest = (freedom * rest + AXES_ALIKE * rest.mean()) / (freedom + AXES_ALIKE) * student_factor(freedom + AXES_ALIKE)
    return np.sqrt(rest), np.sqrt(np.mean(known, axis=0))


def _flicker_variance(offsets: Offsets, rests: list[IntArray], level: FloatArray) -> FloatArray:
    """Return the variance of flicker noise, (3,), from the scatter of the blocks of each rest; at least as much as chance hides.

    E(scatter) = noise + variance n / (n - 1) (1 - c)          n blocks, c their mean correlation
    """
    rests = [rows for rows in rests if len(rows) > 1]
    if not rests:
        return np.zeros(3)
    freedom = np.array([len(rows) - 1.0 for rows in rests])
    weight = freedom / freedom.sum()
    scatter = weight @ [level[rows].var(axis=0, ddof=1) for rows in rests]
    noise = weight @ [offsets.variance[rows].mean(axis=0) for rows in rests]
    lags_s = [np.subtract.outer(offsets.blocks.time[rows], offsets.blocks.time[rows]) for rows in rests]
    share = weight @ ((freedom + 1.0) / freedom * [1.0 - _flicker(lag_s).mean() for lag_s in lags_s])
    return np.asarray(np.maximum(scatter - noise, noise * np.sqrt(2.0 / freedom.sum())) / max(share, 1e-9))


def _flicker(lag_s: FloatArray) -> FloatArray:
    """Return the correlation of flicker noise over time: a sum of first-order processes of equal variance."""
    return np.asarray(np.mean([np.exp(-np.abs(lag_s) / tau) for tau in FLICKER_S], axis=0))


def flicker_correlation(blocks: RestBlocks, members: list[IntArray]) -> FloatArray:
    """Return the mean correlation of the flicker noise of the blocks of two cells, (n, n); 0 between sessions."""
    sampled = [rows[np.linspace(0, len(rows) - 1, min(len(rows), PAIRED)).astype(int)] for rows in members]
    starts = np.concatenate(([0], np.cumsum([len(rows) for rows in sampled])))
    time, session = blocks.time[np.concatenate(sampled)], blocks.session[[rows[0] for rows in members]]
    correlation = np.zeros((len(members), len(members)))
    for k in range(len(members)):
        lag_s = time[starts[k] : starts[k + 1], None] - time[None, :]
        correlation[k] = np.add.reduceat(_flicker(lag_s).mean(axis=0), starts[:-1]) / np.diff(starts)
    correlation *= session[:, None] == session
    return 0.5 * (correlation + correlation.T)


# ---- scatter between switch-ons


def between_sessions(cells: Cells) -> TurnOn | None:
    """Return how much the offset moves between sessions that share temperatures; None for one session.

    Their shifts sum to zero; the variance is that which these show (Paule and Mandel), and at least their own: sessions that agree
    by chance do not prove that nothing moves.
    """
    from scipy.sparse.csgraph import connected_components

    numbers = np.unique(cells.session)
    if len(numbers) < 2:
        return None
    temps = [cells.temp_c[cells.session == number] for number in numbers]
    tied = [[np.abs(first[:, None] - second).min() <= SHARED_C for second in temps] for first in temps]
    group = connected_components(np.array(tied))[1]
    sharing = np.flatnonzero(group == np.bincount(group).argmax())
    free, shift = len(sharing) - 1, np.full((len(numbers), 3), np.nan)
    unknown = TurnOn(shift=shift, variance=np.full(3, np.nan), future_variance=np.zeros(3))
    contrasts = np.zeros((len(numbers), free))
    contrasts[sharing] = np.vstack((np.eye(free), -np.ones(free)))
    try:
        curve = _curve_through(cells, None, (cells.session[:, None] == numbers) @ contrasts) if free else None
    except NotObservable:
        curve = None
    if curve is None:
        return unknown
    shift[sharing] = contrasts[sharing] @ curve.coefficient[:free]
    known = curve.coefficient_uncertainty[:free] ** 2
    known = np.vstack((known, known.mean(axis=0)))
    excess = np.array([excess_variance(shift[sharing, axis], known[:, axis], free) for axis in range(3)])
    variance = np.maximum(excess, known.mean(axis=0))
    return TurnOn(shift=shift, variance=variance, future_variance=student_factor(free) * variance)


# ---- hysteresis: which way the temperature went


def cooling(blocks: RestBlocks) -> FloatArray:
    """Return c of each block, (n,): +1 while cooling, -1 while warming, 0 before it moved."""
    state = np.zeros(len(blocks))
    for rows in split_by(np.arange(len(blocks)), blocks.session):
        rows = rows[np.argsort(blocks.time[rows], kind="stable")]
        state[rows] = _direction(blocks.temp_c[rows].tolist())
    return state


def _direction(temp_c: list[float]) -> FloatArray:
    state = np.zeros(len(temp_c))
    way, turned, low, high = 0, False, temp_c[0], temp_c[0]
    for k, temp in enumerate(temp_c):
        low, high = min(low, temp), max(high, temp)
        if way <= 0 and temp - low > TURN_C:
            way, high, turned = 1, temp, way != 0
        elif way >= 0 and high - temp > TURN_C:
            way, low, turned = -1, temp, way != 0
        back, gone = (high - temp, temp - low) if way == 1 else (temp - low, high - temp)  # from the last extreme
        crossed = 2.0 * back / CROSSED_C
        lacking = 2.0 - 2.0 * gone / CROSSED_C if turned else 0.0  # since the turn before
        state[k] = -way * (1.0 - min(2.0, max(crossed, lacking, 0.0)))
    return state


def both_ways(blocks: RestBlocks, state: FloatArray) -> bool:
    """Return True if both directions have seen a common range of temperature."""
    up, down = blocks.temp_c[state < -0.5], blocks.temp_c[state > 0.5]
    return bool(len(up) and len(down) and min(up.max(), down.max()) - max(up.min(), down.min()) >= OVERLAP_C)


# ---- warm-up


def warm_up_time(blocks: RestBlocks, value: FloatArray) -> float:
    """Return the time constant of the warm-up of values (n, 3), s: least squares on a grid."""
    low = float(blocks.temp_c.min())
    high = low + max(float(np.ptp(blocks.temp_c)), 1e-9)
    basis = Cubics(low=low, high=high, intervals=CURVE_INTERVALS).at(blocks.temp_c)

    def unexplained(values: FloatArray) -> FloatArray:
        return np.asarray(values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0])

    constants, residual = np.geomspace(30.0, 3600.0, 25), unexplained(value)
    gain, share = np.zeros(len(constants)), np.zeros(len(constants))
    for k, tau in enumerate(constants):
        decay = np.exp(-blocks.power_on_s / tau)[:, None]
        rest = unexplained(decay)
        share[k] = rest.var() / max(float(decay.var()), 1e-300)
        explained = (rest.T @ residual)[0] ** 2 / max(float((rest**2).sum()), 1e-300)
        gain[k] = float((explained / np.maximum(residual.var(axis=0), 1e-300)).sum())
    best = int(np.argmax(gain))
    if share[best] < LEAST_OWN:
        raise NotObservable(
            f"warm-up: {100.0 * (1.0 - share[best]):.1f} % of the transient since power-on is explained by temperature. Hold one "
            "temperature for half an hour after power-on, or warm up from two temperatures.",
            share=float(share[best]),
        )
    return float(constants[best])


def warm_up_table(time_constant_s: float, amplitude: FloatArray) -> WarmUp:
    """Return the warm-up as a table that ends at zero."""
    time = time_constant_s * WARM_UP_SPAN * np.linspace(0.0, 1.0, WARM_UP_NODES) ** 1.5
    decay = np.exp(-time / time_constant_s)
    decay[-1] = 0.0
    return WarmUp(power_on_s=time, gyro_offset=decay[:, None] * amplitude)
