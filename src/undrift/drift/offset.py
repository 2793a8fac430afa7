"""Offsets over temperature, from blocks of rest (static drift).

    gyroscopes       y = u - K G a                             u mean reading, K = M^-1; a g-sensitivity is not an offset
    accelerometers   y = u in one pose;  offset(T) = offset(T_ref) + y(T) - y(T_ref)
    both             y = f(T) + h c + A exp(-t / tau) + d_s + P_pose + u + e

f      a smooth curve (fit/curve.py) through the means of the cells. A cell holds the blocks of one session and one visit within a
       narrow range of temperature, so that the hot end of a warm-up counts no more than its degrees
u      flicker noise, of the size that the blocks within the rests show, and what one visit to a temperature adds beyond it: one
       variance about the curve, axes pooled
h      half-width of the hysteresis: c = +1 while cooling, -1 while warming, and in between over ``CROSSED_C`` after a turn
A, tau warm-up, t since power-on. It differs from f only if time and temperature differ: in a soak, or in several warm-ups
d_s    shift of session s; its variance counts for a future session
P      what a pose adds, from cells with several poses

T_ref and offset(T_ref) are those of the calibration. One pose cannot separate a change of scale along gravity from a change of
offset: 0.02 %/K * |T - T_ref| of what gravity reads counts as uncertainty. The uncertainty of a node is that of a future visit:
noise, visit, curve between and beyond the temperatures seen, half-width of the hysteresis, poses and sessions.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.plausibility import check_gravity
from undrift.drift.observe import FAR, ROBUST, RestBlocks
from undrift.errors import Implausible, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.curve import Cubics, Curve, NodeValues, fit_curve, not_a_knot
from undrift.fit.gls import student_factor
from undrift.fit.least_squares import determined, excess_variance
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
HELD_C = 0.5  # a soak stays within this of its mean
SOAK_LENGTH, LEAST_SOAKS = 3.0, 5  # lower quartiles of a stretch; temperatures from which a log is one of soaks
FLICKER_S = 10.0 ** np.arange(1.0, 4.1, 0.5)  # time constants of the processes that flicker noise is made of
PAIRED = 30  # blocks of a cell that its correlation is taken from
RESTS_APART_S = 60.0
LEAST_JUDGED = 5  # blocks of a cell and pose: fewer do not show which one is wrong
AXES_ALIKE = 2.0  # degrees of freedom by which the axes of a triad are taken to be alike [assumed]
GROUPS = 20  # groups of neighbouring cells that are left out in turn, at most
LEAST_LEFT_OUT, CHANCE = 5, 1e-3  # groups that are judged by; chance of a false finding
SHARED_C = 1.0  # sessions with cells nearer than this share a temperature
# ---- hysteresis
# K; the temperature must change by START_C before it has a direction, and by TURN_C the other way before it has another
START_C = TURN_C = 1.0
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
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestScatter:
    """Scatter between the rests of one cell beyond their noise, raw unit."""

    pose: FloatArray  # (3,), standard deviation from pose to pose
    rest: FloatArray  # (3,), from rest to rest of one pose
    known: FloatArray  # (3,), standard deviation of one rest by noise
    poses: int
    rests: int
    pose_covariance: FloatArray  # (3, n, n), covariance of the cells by poses
    rest_variance: FloatArray  # (n, 3), variance of each cell by rests


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cells:
    """Means of the blocks of one session, visit and temperature, n cells."""

    session: IntArray  # (n,)
    temp_c: FloatArray  # (n,), degC
    value: FloatArray  # (n, 3), raw unit
    variance: FloatArray  # (n, 3), by noise, steps and rests
    regressors: FloatArray  # (n, p)
    flicker: (
        FloatArray  # (3, n, n), covariance from flicker noise (size from the blocks within cells), raw unit squared
    )
    correlation: FloatArray  # (n, n), of what visits add beyond it, mean diagonal 1
    groups: IntArray  # (n,), neighbours in temperature
    scatter: RestScatter | None  # None if no cell has two rests


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HysteresisLoop:
    """Half-width of the hysteresis: offset while cooling minus offset while warming, over two."""

    half: FloatArray  # (3,), raw unit
    uncertainty: FloatArray  # (3,), standard uncertainty


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnOn:
    """Scatter between sessions, raw unit."""

    sessions: int
    shift: FloatArray  # (s, 3), each session against those that share its temperatures; NaN if none does
    variance: FloatArray = field(
        default_factory=lambda: np.full(3, np.nan)
    )  # (3,), between sessions; NaN if not observable
    future_variance: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,), for a future session


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OffsetCurve:
    """A fitted curve and the effects with it."""

    curve: Curve
    cells: Cells
    loop: HysteresisLoop | None  # None if the temperature went one way only
    warm_up: WarmUp | None
    turn_on: TurnOn | None  # None for one session
    findings: tuple[Finding, ...]

    @property
    def visit_variance(self) -> FloatArray:
        """Variance that a future visit and its rest add, (3,), raw unit squared."""
        flicker = np.diagonal(self.cells.flicker, axis1=1, axis2=2).mean(axis=1)
        rest = 0.0 if self.cells.scatter is None else self.cells.scatter.rest**2
        return np.asarray(flicker + self.curve.visit_deviation**2 + rest)

    def through_set_points(self, nodes: FloatArray) -> NodeValues:
        """Return the note's curve: not-a-knot through the means of the set-points, effects subtracted."""
        cells, order = self.cells, np.argsort(self.cells.temp_c, kind="stable")
        residual = cells.value - cells.regressors @ self.curve.coefficient
        variance = cells.variance + np.diagonal(cells.flicker, axis1=1, axis2=2).T + self.curve.visit_deviation**2
        rows = np.split(order, np.flatnonzero(np.diff(bins_of(cells.temp_c[order], 1.0))) + 1)
        spline = not_a_knot(
            np.array([cells.temp_c[r].mean() for r in rows]),
            np.array([residual[r].mean(axis=0) for r in rows]),
            np.array([variance[r].sum(axis=0) / len(r) ** 2 for r in rows]),
            nodes,
        )
        if cells.scatter is None:
            return spline
        poses = np.diagonal(cells.scatter.pose_covariance, axis1=1, axis2=2).mean(axis=1)  # shared by all set-points
        return replace(spline, covariance=spline.covariance + poses[:, None, None])


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
    curve: OffsetCurve
    offsets: Offsets
    unknown_scale: FloatArray | None = None  # (n, 3), part of ``uncertainty`` for a change of scale along gravity

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
        gyro = _triad(rates, nodes, settings)
        findings += [*rates.findings, *gyro.curve.findings, *_triad_findings("gyroscope", gyro)]
    forces = accel_offsets(blocks, calibration, settings.accel_unit)
    if isinstance(forces, Finding):
        findings.append(forces)
    else:
        accel, own = _accel(forces, nodes, calibration, settings)
        findings += [*forces.findings, *own] if accel else own
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
    loop = None if gyro is None else gyro.curve.loop
    table = StaticDrift(
        temp_c=nodes,
        **columns,
        gyro_hysteresis=None if loop is None else loop.half,
        warm_up=None if gyro is None else gyro.curve.warm_up,
    )
    return StaticFit(table=table, gyro=gyro, accel=accel, verdict=Verdict.of(*findings))


# ---- offset readings


def gyro_offsets(blocks: RestBlocks, calibration: Calibration | None) -> Offsets | None:
    """Return the gyroscopes' readings at rest without g-sensitivity; None if there are none."""
    blocks = blocks.taken(np.isfinite(blocks.gyro).all(axis=1))
    if not len(blocks):
        return None
    model, force = None if calibration is None else calibration.gyro, specific_force(blocks, calibration)
    common, findings = np.zeros(3), list[Finding]()
    if model is None or model.g_sensitivity is None or force is None:
        findings.append(finding("drift.g_unknown", "info"))
    elif G_NAMES[0] in model.parameters:  # uncertainty of the g-sensitivity, at the mean specific force
        start, k, mean = model.parameters.index(G_NAMES[0]), model.forward_matrix, force.mean(axis=0)
        of_g = model.covariance[start : start + len(G_NAMES), start : start + len(G_NAMES)].reshape(3, 3, 3, 3)
        common = np.einsum("ka,kb,i,j,aibj->k", k, k, mean, mean, of_g)
    return Offsets(
        blocks=blocks,
        value=blocks.gyro - felt_by_gyro(blocks, calibration),
        variance=known_variance(blocks.gyro_variance),
        step_error=blocks.gyro_step_error,
        common_variance=common,
        findings=tuple(findings),
    )


def accel_offsets(blocks: RestBlocks, calibration: Calibration | None, accel_unit: str) -> Offsets | Finding:
    """Return the accelerometers' readings in the pose that saw the widest range of temperature, if possible of one mounting."""
    blocks = blocks.taken(np.isfinite(blocks.accel).all(axis=1))
    if not len(blocks):
        return finding("drift.accel_no_readings", "info")
    force = specific_force(blocks, calibration)
    if force is None and is_physical(accel_unit):
        force = blocks.accel * si_factor(accel_unit, "accel")
    if force is not None:
        try:
            check_gravity(force, STANDARD_GRAVITY if calibration is None else calibration.gravity_m_s2)
        except Implausible as error:
            return finding("drift.accel_gravity", "warn", problem=str(error))
    poses = len(np.unique(blocks.pose))
    chosen, span = _widest(blocks, blocks.pose)
    if chosen.mounting is not None:  # a face mounted again is not level as before: its tilt would count as temperature
        mounted, seen = _widest(chosen, chosen.mounting)
        chosen, span = (mounted, seen) if seen >= MOST_OF_SPAN * span else (chosen, span)
    percent = 100.0 * UNKNOWN_SCALE_PER_K
    return Offsets(
        blocks=chosen,
        value=np.array(chosen.accel),
        variance=known_variance(chosen.accel_variance),
        step_error=chosen.accel_step_error,
        common_variance=np.zeros(3),
        findings=(finding("drift.accel_one_pose", "info", poses=poses, span_c=span, percent_per_c=percent),),
    )


def _widest(blocks: RestBlocks, number: IntArray) -> tuple[RestBlocks, float]:
    """Return the blocks of the number that saw the widest range of temperature, and this range, degC."""
    spans = {n: float(np.ptp(blocks.temp_c[number == n])) for n in np.unique(number)}
    widest = max(spans, key=lambda n: spans[n])
    return blocks.taken(number == widest), spans[widest]


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


def _triad(
    offsets: Offsets,
    nodes: FloatArray,
    settings: StaticSettings,
    reference: tuple[float, TriadModel] | None = None,
) -> TriadDrift:
    """Fit one triad; with a reference the table is its offset plus the change since its temperature."""
    fit = fit_offset_curve(offsets, warm_up=settings.warm_up)
    temp_c, n = offsets.blocks.temp_c, len(nodes)
    inside = np.quantile(temp_c, np.linspace(0.0, 1.0, SLOPE_POINTS))
    at = np.concatenate((nodes, inside, [nodes[0] if reference is None else reference[0]]))
    at_nodes = fit.through_set_points(at) if settings.not_a_knot else fit.curve.at(at)
    variances = np.diagonal(at_nodes.covariance, axis1=1, axis2=2).T
    value, variance = at_nodes.value[:n], variances[:n]
    if reference is not None:  # the last point: its error is shared by both ends of the difference
        model = reference[1]
        value = model.offset + at_nodes.value[:n] - at_nodes.value[-1]
        variance = variance + variances[-1] - 2.0 * at_nodes.covariance[:, :n, -1].T + np.diag(model.covariance)[9:12]
    future = offsets.common_variance + fit.visit_variance
    if fit.turn_on is not None:
        future = future + fit.turn_on.future_variance
    if fit.loop is not None:
        future = future + fit.loop.half**2
    temps, rows = inside - inside.mean(), slice(n, n + SLOPE_POINTS)
    weight = temps / (temps @ temps)
    slope_variance = np.einsum("i,kij,j->k", weight, at_nodes.covariance[:, rows, rows], weight)
    return TriadDrift(
        offset=value,
        uncertainty=np.sqrt(np.maximum(variance, 0.0) + future),
        visit=np.sqrt(fit.visit_variance),
        extrapolated=~near_data(nodes, temp_c, gap_c=GAP_C),
        slope=np.asarray(weight @ at_nodes.value[rows]),
        slope_uncertainty=np.sqrt(np.maximum(slope_variance, 0.0)),
        span_c=(float(temp_c.min()), float(temp_c.max())),
        curve=fit,
        offsets=offsets,
    )


def _accel(
    offsets: Offsets, nodes: FloatArray, calibration: Calibration | None, settings: StaticSettings
) -> tuple[TriadDrift | None, list[Finding]]:
    model = None if calibration is None else calibration.accel
    reference = calibration.reference_temp_c if calibration is not None else float("nan")
    anchor = None if model is None or not np.isfinite(reference) else (reference, model)
    try:
        triad = _triad(offsets, nodes, settings, anchor)
    except NotObservable as error:
        return None, [finding("drift.accel_not_observable", "info", problem=str(error))]
    if model is None:
        return replace(triad, offset=None), [finding("drift.accel_uncalibrated", "info")]
    if anchor is None:
        return replace(triad, offset=None), [finding("drift.accel_no_reference", "info")]
    gravity = triad.curve.curve.at(np.array([reference])).value[0] - model.offset
    unknown = UNKNOWN_SCALE_PER_K * np.abs(nodes - reference)[:, None] * np.abs(gravity)
    triad = replace(triad, uncertainty=np.hypot(triad.uncertainty, unknown), unknown_scale=unknown)
    return triad, _triad_findings("accelerometer", triad)


def near_data(nodes: FloatArray, temp_c: FloatArray, *, gap_c: float) -> BoolArray:
    """Return a mask of nodes (n,) with data (k,) nearby: within ``gap_c`` inside the range of the data, 0.5 K outside."""
    nearest = np.abs(nodes[:, None] - temp_c[None, :]).min(axis=1)
    return np.asarray(nearest <= np.where((nodes < temp_c.min()) | (nodes > temp_c.max()), EDGE_C, gap_c))


def far_from_data(sensor: str, triad: TriadDrift) -> list[Finding]:
    """Return the finding on nodes without data nearby."""
    count, nodes, (low, high) = int(triad.extrapolated.sum()), len(triad.extrapolated), triad.span_c
    if not count:
        return []
    return [
        finding("drift.nodes_extrapolated", "info", sensor=sensor, count=count, nodes=nodes, low_c=low, high_c=high)
    ]


def _triad_findings(sensor: str, triad: TriadDrift) -> list[Finding]:
    loop = triad.curve.loop
    if loop is None:
        return far_from_data(sensor, triad)
    size = {"half_width": loop.half, "uncertainty": loop.uncertainty}
    return [*far_from_data(sensor, triad), finding("drift.hysteresis", "info", sensor=sensor, **size)]


@determined("offset over temperature")
def fit_offset_curve(offsets: Offsets, *, warm_up: bool) -> OffsetCurve:
    """Fit offset over temperature, with hysteresis, warm-up and the shifts of sessions."""
    blocks, findings = offsets.blocks, list[Finding]()
    direction = cooling(blocks)
    has_loop = both_ways(blocks, direction)
    if not has_loop:
        findings.append(finding("drift.hysteresis_unknown", "info", overlap_c=OVERLAP_C))
    tau = None
    if warm_up:
        try:
            tau = warm_up_time(blocks, offsets.value)
        except NotObservable as error:
            percent = 100.0 * (1.0 - float(error.numbers["share"]))  # type: ignore[arg-type]
            findings.append(finding("drift.warm_up_not_observable", "info", percent=percent))
    regressors = [direction] if has_loop else []
    regressors += [] if tau is None else [np.exp(-blocks.power_on_s / tau)]
    cells = cells_of(
        offsets,
        regressors=np.array(regressors).reshape(-1, len(blocks)).T,
        direction=direction if has_loop else np.zeros(len(blocks)),
        chunk_s=np.inf if tau is None else CHUNK_S,
    )
    turn_on = between_sessions(cells) if len(np.unique(cells.session)) > 1 else None
    if turn_on is None:
        findings.append(finding("drift.one_session", "info"))
    elif not np.isfinite(turn_on.variance).all():
        findings.append(finding("drift.sessions_apart", "info", sessions=turn_on.sessions))
    curve = _curve_through(cells, turn_on)
    findings += _left_out_findings(curve, cells)
    return OffsetCurve(
        curve=curve,
        cells=cells,
        loop=HysteresisLoop(half=curve.coefficient[0], uncertainty=curve.coefficient_uncertainty[0])
        if has_loop
        else None,
        warm_up=None if tau is None else warm_up_table(tau, curve.coefficient[-1]),
        turn_on=turn_on,
        findings=tuple(findings),
    )


def _curve_through(cells: Cells, turn_on: TurnOn | None, shifts: FloatArray | None = None) -> Curve:
    """Fit the curve with the regressors of the cells, and with shifts of sessions (n, f) if they are to be found."""
    shared = cells.flicker
    if cells.scatter is not None:
        shared = shared + cells.scatter.pose_covariance
    if turn_on is not None:
        together = cells.session[:, None] == cells.session
        shared = shared + np.nan_to_num(turn_on.variance)[:, None, None] * together
    return fit_curve(
        cells.temp_c,
        cells.value,
        cells.variance,
        regressors=cells.regressors if shifts is None else np.column_stack((shifts, cells.regressors)),
        correlation=cells.correlation,
        shared=shared,
    )


def _left_out_findings(curve: Curve, cells: Cells) -> list[Finding]:
    """Return the finding that groups of neighbours, left out in turn, are missed by more than is stated."""
    from scipy.special import chdtri

    count, ratio = len(np.unique(cells.groups)), curve.left_out(cells.groups)[1]
    if count < LEAST_LEFT_OUT or not ratio.max() > np.sqrt(chdtri(count, CHANCE / len(ratio)) / count):
        return []
    return [finding("drift.left_out_above", "warn", ratio=ratio, groups=count)]


# ---- cells


def cells_of(offsets: Offsets, *, regressors: FloatArray, direction: FloatArray, chunk_s: float) -> Cells:
    """Average blocks of one session, visit, direction (n,) and temperature; regressors (n, p) are averaged with them.

    Cells are cut where the time since power-on passes ``chunk_s``, twice and four times this, and so on.
    """
    blocks, value = offsets.blocks, offsets.value
    chunk = np.floor(np.log2(np.maximum(blocks.power_on_s / chunk_s, 0.5)))
    visit = visits_of(blocks)
    used = np.flatnonzero(visit >= 0)
    parts = split_by(used, visit[used], np.round(direction[used]), chunk[used])
    width = max(CELL_C, sum(float(np.ptp(blocks.temp_c[rows])) for rows in parts) / MOST_CELLS)
    members = [
        rows[_near_others(value[rows], blocks.pose[rows])] for part in parts for rows in _binned(blocks, part, width)
    ]
    members.sort(key=lambda rows: float(blocks.temp_c[rows].mean()))
    temp_c = np.array([blocks.temp_c[rows].mean() for rows in members])
    means = np.array([value[rows].mean(axis=0) for rows in members])
    about = temp_c - temp_c.mean()
    slope = np.asarray(about @ means / max(float(about @ about), 1e-9))
    level = value - slope * blocks.temp_c[:, None]  # the usual slope within a cell is subtracted
    rests, cell = rests_of(blocks, members)
    wander = _flicker_variance(offsets, rests, level)
    scatter = scatter_of_rests(offsets, rests, cell, level, wander)
    correlation, of_cell = flicker_correlation(blocks, members), visit[[rows[0] for rows in members]]
    variance = np.array([_variance_of_cell(offsets, rows) for rows in members])
    return Cells(
        session=np.array([blocks.session[rows[0]] for rows in members], np.int64),
        temp_c=temp_c,
        value=means,
        variance=variance if scatter is None else variance + scatter.rest_variance,
        regressors=np.array([regressors[rows].mean(axis=0) for rows in members]),
        flicker=wander[:, None, None] * correlation,
        correlation=correlation * (of_cell[:, None] == of_cell) / np.diag(correlation).mean(),
        groups=bins_of(temp_c, max(1.5 * width, float(np.ptp(temp_c)) / GROUPS)),
        scatter=scatter,
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


def _binned(blocks: RestBlocks, rows: IntArray, width: float) -> list[IntArray]:
    rows = rows[np.argsort(blocks.temp_c[rows], kind="stable")]
    return np.split(rows, np.flatnonzero(np.diff(bins_of(blocks.temp_c[rows], width))) + 1)


def _near_others(value: FloatArray, pose: IntArray) -> BoolArray:
    """Return True for blocks of a cell near the others of their pose; a whole pose that differs is not an outlier."""
    good = np.ones(len(value), bool)
    for rows in split_by(np.arange(len(value)), pose):
        off = np.abs(value[rows] - np.median(value[rows], axis=0))
        near = (off <= FAR * ROBUST * np.median(off, axis=0)).all(axis=1)
        if len(rows) >= LEAST_JUDGED and near.mean() > 0.5:
            good[rows] = near
    return good


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


def visits_of(blocks: RestBlocks) -> IntArray:
    """Return which visit each block belongs to, (n,): a step of temperature begins another; -1 on ramps between many soaks."""
    order = np.lexsort((blocks.time, blocks.session))
    step = (np.abs(np.diff(blocks.temp_c[order])) > STEP_C) | (np.diff(blocks.session[order]) != 0)
    number, count = np.empty(len(blocks), np.int64), 0
    for rows in np.split(order, np.flatnonzero(step) + 1):
        soaks = _soaks_of(blocks.time[rows], blocks.temp_c[rows])
        number[rows] = np.where(soaks < 0, -1, soaks + count)
        count += int(soaks.max()) + 1
    return number


def _soaks_of(time: FloatArray, temp_c: FloatArray) -> IntArray:
    """Return which soak each block of one log belongs to, (n,), -1 between soaks; all 0 if the soaks are few.

    A soak stays near its mean for three times as long as the log usually does.
    """
    starts, total = [0], 0.0
    for k, temp in enumerate(temp_c.tolist()):
        if k > starts[-1] and abs(temp - total / (k - starts[-1])) > HELD_C:
            starts.append(k)
            total = 0.0
        total += temp
    stretch = np.repeat(np.arange(len(starts)), np.diff([*starts, len(time)]))
    length = np.bincount(stretch, np.gradient(time)) if len(time) > 1 else np.zeros(1)
    middle = np.array([np.median(part) for part in np.split(temp_c, starts[1:])])
    held = length >= SOAK_LENGTH * np.quantile(length, 0.25)
    if np.count_nonzero(np.diff(np.sort(middle[held])) > STEP_C) < LEAST_SOAKS - 1:
        return np.zeros(len(time), np.int64)
    begins = held & ~np.append(False, held[:-1] & (np.abs(np.diff(middle)) <= STEP_C))
    soak = np.where(held, np.cumsum(begins) - 1, -1)[stretch]
    return np.where(np.abs(temp_c - middle[stretch]) <= 0.5 * HELD_C, soak, -1)


def flicker(lag_s: FloatArray) -> FloatArray:
    """Return the correlation of flicker noise over time: a sum of first-order processes of equal variance."""
    return np.asarray(np.mean([np.exp(-np.abs(lag_s) / tau) for tau in FLICKER_S], axis=0))


def flicker_correlation(blocks: RestBlocks, members: list[IntArray]) -> FloatArray:
    """Return the mean correlation of the blocks of two cells, (n, n); 0 between sessions.

    The offset wanders as flicker noise does.
    """
    sampled = [rows[np.linspace(0, len(rows) - 1, min(len(rows), PAIRED)).astype(int)] for rows in members]
    starts = np.concatenate(([0], np.cumsum([len(rows) for rows in sampled])))
    time, session = blocks.time[np.concatenate(sampled)], blocks.session[[rows[0] for rows in members]]
    correlation = np.zeros((len(members), len(members)))
    for k in range(len(members)):
        lag = np.abs(time[starts[k] : starts[k + 1], None] - time[None, :])
        correlation[k] = np.add.reduceat(flicker(lag).mean(axis=0), starts[:-1]) / np.diff(starts)
    correlation *= session[:, None] == session
    return 0.5 * (correlation + correlation.T)


def _flicker_variance(offsets: Offsets, rests: list[IntArray], level: FloatArray) -> FloatArray:
    """Return the variance of flicker noise, (3,), from the scatter of the blocks of each rest; at least what chance hides.

    E(scatter) = noise + variance n / (n - 1) (1 - c)          n blocks, c their mean correlation
    """
    rests = [rows for rows in rests if len(rows) > 1]
    if not rests:
        return np.zeros(3)
    freedom = np.array([len(rows) - 1.0 for rows in rests]) / sum(len(rows) - 1.0 for rows in rests)
    scatter = freedom @ [level[rows].var(axis=0, ddof=1) for rows in rests]
    noise = freedom @ [offsets.variance[rows].mean(axis=0) for rows in rests]
    share = freedom @ [
        len(rows) / (len(rows) - 1.0) * (1.0 - flicker(np.subtract.outer(*[offsets.blocks.time[rows]] * 2)).mean())
        for rows in rests
    ]
    hidden = noise * np.sqrt(2.0 / sum(len(rows) - 1.0 for rows in rests))
    return np.asarray(np.maximum(scatter - noise, hidden) / max(share, 1e-9))


def rests_of(blocks: RestBlocks, members: list[IntArray]) -> tuple[list[IntArray], IntArray]:
    """Return the blocks of each rest of one cell and pose, and the cell of each rest."""
    rests, cell = list[IntArray](), list[int]()
    for k, rows in enumerate(members):
        for part in split_by(rows, blocks.pose[rows]):
            part = part[np.argsort(blocks.time[part], kind="stable")]
            runs = np.split(part, np.flatnonzero(np.diff(blocks.time[part]) > RESTS_APART_S) + 1)
            rests, cell = rests + runs, cell + [k] * len(runs)
    return rests, np.array(cell)


def scatter_of_rests(
    offsets: Offsets, rests: list[IntArray], cell: IntArray, level: FloatArray, wander: FloatArray
) -> RestScatter | None:
    """Compare the rests of each cell: effects of poses, and scatter from rest to rest; None if no cell has two rests.

    m_r = m_cell + P_pose + E_r + noise          mean m_r of each rest, from ``level`` (n, 3); flicker of variance ``wander`` (3,)
    """
    blocks = offsets.blocks
    poses = np.unique(blocks.pose)
    in_pose = (blocks.pose[[rows[0] for rows in rests]][:, None] == poses).astype(float)
    in_cell = (cell[:, None] == np.arange(cell.max() + 1)).astype(float)
    mean = np.array([level[rows].mean(axis=0) for rows in rests])
    noise = wander + [offsets.variance[rows].mean(axis=0) / len(rows) for rows in rests]
    centre = np.eye(len(rests)) - in_cell @ (in_cell / in_cell.sum(axis=0)).T
    effects = centre @ in_pose
    inverse, compared = np.linalg.pinv(effects, rcond=1e-6), int(np.linalg.matrix_rank(effects, tol=1e-6))
    freedom = len(rests) - int(cell.max()) - 1 - compared
    if compared + freedom < 1:
        return None
    rest: FloatArray = np.zeros(3)
    pose: FloatArray = np.zeros(3)
    if freedom > 0:
        residual = centre - (effects @ inverse if compared else 0.0)
        rest = _axes_alike(((residual @ mean) ** 2).sum(axis=0) - (residual**2 @ noise).sum(axis=0), freedom, freedom)
    if compared > 0:
        gain = inverse @ centre
        square = ((gain @ mean) ** 2).sum(axis=0) - (gain**2 @ (noise + rest)).sum(axis=0)
        pose = _axes_alike(square, compared, float(((gain @ in_pose) ** 2).sum()))
    share = np.array([len(rows) for rows in rests], float)[:, None] * in_cell
    share /= share.sum(axis=0)
    by_pose = share.T @ in_pose
    return RestScatter(
        pose=np.sqrt(pose),
        rest=np.sqrt(rest),
        known=np.sqrt(noise.mean(axis=0)),
        poses=len(poses),
        rests=len(rests),
        pose_covariance=(pose * student_factor(compared + AXES_ALIKE))[:, None, None] * (by_pose @ by_pose.T),
        rest_variance=(share**2).sum(axis=0)[:, None] * rest * student_factor(freedom + AXES_ALIKE),
    )


def _axes_alike(square: FloatArray, freedom: int, size: float) -> FloatArray:
    """Return variances of the three axes, (3,), from excess squares, drawn towards their mean: sensors of one triad are alike."""
    variance = np.maximum(square, 0.0) / size
    return np.asarray((freedom * variance + AXES_ALIKE * variance.mean()) / (freedom + AXES_ALIKE))


# ---- scatter between switch-ons


def between_sessions(cells: Cells) -> TurnOn:
    """Return how much the offset moves between sessions: their shifts, and the variance that these show (Paule and Mandel).

    The variance is at least that of the shifts: sessions that agree by chance do not prove that nothing moves.
    """
    numbers = np.unique(cells.session)
    contrasts = _shift_contrasts(cells, numbers)
    free = contrasts.shape[1]
    unknown = TurnOn(sessions=len(numbers), shift=np.full((len(numbers), 3), np.nan))
    if free == 0:
        return unknown
    try:
        curve = _curve_through(cells, None, (cells.session[:, None] == numbers) @ contrasts)
    except NotObservable:
        return unknown
    part = np.abs(contrasts)
    seen = np.asarray(part.any(axis=1))
    shift = np.where(seen[:, None], contrasts @ curve.coefficient[:free], np.nan)
    known = part[seen] @ curve.coefficient_uncertainty[:free] ** 2 / part[seen].sum(axis=1, keepdims=True)
    excess = np.array([excess_variance(shift[seen, axis], known[:, axis], free) for axis in range(3)])
    variance = np.maximum(excess, known.mean(axis=0))
    return TurnOn(
        sessions=len(numbers), shift=shift, variance=variance, future_variance=student_factor(free) * variance
    )


def _shift_contrasts(cells: Cells, numbers: IntArray) -> FloatArray:
    """Return the contrasts that make the shifts of s sessions, (s, f): in each group that shares temperatures they sum to zero.

    A session that shares no temperature with another has a row of zeros.
    """
    from scipy.linalg import block_diag
    from scipy.sparse.csgraph import connected_components

    temps = [cells.temp_c[cells.session == number] for number in numbers]
    tied = [[np.abs(one[:, None] - two).min() <= SHARED_C for two in temps] for one in temps]
    count, group = connected_components(np.array(tied))
    sizes = np.bincount(group, minlength=count)
    contrasts = np.zeros((len(numbers), len(numbers) - count))
    contrasts[np.argsort(group, kind="stable")] = block_diag(
        *(np.vstack((np.eye(n - 1), -np.ones(n - 1))) for n in sizes)
    )
    return contrasts


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
        if way == 0 and temp - low >= START_C:
            way, high = 1, temp
        elif way == 0 and high - temp >= START_C:
            way, low = -1, temp
        elif way == 1 and high - temp > TURN_C:
            way, low, turned = -1, temp, True
        elif way == -1 and temp - low > TURN_C:
            way, high, turned = 1, temp, True
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
