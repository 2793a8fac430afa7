"""Static drift: absolute offsets over temperature, from blocks of rest.

::

    gyroscopes       y = u - K (G a + Earth rate)                           u mean reading, K = M^-1: drift/rests.py
    accelerometers   y = u in one pose; offset(T) = offset(T_ref) + y(T) - y(T_ref)
    both             y = f(T) + h c + A exp(-t / tau) + d_s + e

f      a smoothing spline (fit/smooth.py)
h c    hysteresis: c = +1 while cooling, -1 while warming, in between straight over ``reversal_c`` after a turn; 0 before the
       temperature has moved by ``start_c``. Fitted with f, so that unequal numbers of blocks up and down do not pull the middle.
A, tau warm-up, t since power-on: A one a sensor, tau of the device, the least squares on a grid. f explains any change that goes
       with temperature, so A shows only where time and temperature differ: on a soak, or in warm-ups from different temperatures.
d_s    the shift of session s: drift/rests.py

T_ref and offset(T_ref) are those of the calibration. One pose does not separate a change of scale along gravity from one of offset:
0.02 %/K * |T - T_ref| of what gravity reads counts as uncertainty. The uncertainty of a node holds the noise, the bias instability,
the curve between and beyond the temperatures seen, the hysteresis half-width where one was found, and the scatter between sessions.
It belongs to the offset at a reading of this thermometer, whose own offset and self-heating are part of the table.

g-sensitivity, where the calibration has none: means of rests in several poses, reading u in a cell of temperature, corrected
specific force a, ::

    u_r = m_cell + H a_r + P_pose + E_r + noise and instability          G = M H, which ``correct`` subtracts as G a

H by least squares within cells; P, what poses leave of that, and E have their variances from the same rests, and all of it is in
the covariance of H, widened for few poses by Student's factor. H is kept where its nine elements are larger, by that covariance,
than chance makes them once in a thousand. A G that the calibration has is kept.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.drift.observe import RestBlocks
from undrift.drift.rests import (
    UNKNOWN_SCALE_PER_K,
    Cells,
    CellSettings,
    Offsets,
    RestScatter,
    TurnOn,
    accel_offsets,
    between_sessions,
    bins_of,
    centred_on_cells,
    excess,
    gather,
    gyro_offsets,
    indicators,
    known_variance,
    pooled,
    specific_force,
)
from undrift.errors import NotObservable
from undrift.findings import Finding, finding
from undrift.fit.smooth import NodeValues, Scatter, SmoothSettings, SmoothSpline, fit_smooth, not_a_knot, widening_of
from undrift.model import AXES, G_NAMES, Calibration, StaticDrift, TriadModel, Verdict, WarmUp
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, si_factor

_SLOPE_POINTS = 60
_CHUNK_S = 120.0  # cells are cut there and at its doubles where a warm-up is fitted
_SIGNIFICANT = 3.0  # standard uncertainties, on one axis or more
_LEAST_OWN = 0.05  # of the variance of exp(-t / tau) that temperature does not explain
_KNOTS = 6
_NODES = 13
_SPAN = 5.0  # time constants that a table covers
_CHANCE = 1e-3
_LEAST_SEEN = 0.3  # of the best seen direction of gravity: a worse one is not estimated
_RESOLVED = (
    0.1  # singular value, in root rests of a pose: below, poses differ by what drifts in gravity's reading alone
)
_LEAST_SPARE = 1  # poses beyond those that H takes


@dataclass(frozen=True, slots=True, kw_only=True)
class HysteresisSettings:
    """When a sweep goes up and when down."""

    start_c: float = 1.0  # temperature has to move by this before it has a direction, degC
    turn_c: float = 1.0  # and come back by this before the direction changes: more than the thermometer's noise, degC
    reversal_c: float = 4.0  # after a turn the loop is crossed over this much of temperature, degC
    overlap_c: float = 3.0  # both directions have to have seen a common range as wide as this, degC


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveSettings:
    """Effects beside temperature."""

    hysteresis: bool = True  # look for a loop between warming and cooling
    warm_up: bool = False  # fit a power-on transient; recordings begin at power-on
    smooth: SmoothSettings = field(default_factory=SmoothSettings)
    cells: CellSettings = field(default_factory=CellSettings)
    sweeps: HysteresisSettings = field(default_factory=HysteresisSettings)


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticSettings:
    """How offset over temperature is fitted."""

    not_a_knot: bool = False  # True for the note's spline through the set-point means, False for the smoothing spline
    edge_c: float = 0.5  # a node this far outside the temperatures seen is extrapolated, degC
    gap_c: float = 5.0  # a node between temperatures seen, this far from both, is extrapolated, degC
    latitude_deg: float | None = None  # to subtract the Earth rate along the vertical; None leaves it in
    accel_unit: str = "count"  # of the accelerometer's readings where no calibration states it
    curve: CurveSettings = field(default_factory=CurveSettings)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Loop:
    """Hysteresis."""

    half: FloatArray  # (3,), h: offset while cooling minus offset while warming, over two, raw unit
    uncertainty: FloatArray  # (3,), standard uncertainty

    @property
    def significant(self) -> bool:
        """Whether one axis or more exceeds three standard uncertainties."""
        return bool((np.abs(self.half) > _SIGNIFICANT * self.uncertainty).any())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OffsetCurve:
    """A fitted curve and the effects beside it."""

    spline: SmoothSpline  # the middle curve
    cells: Cells  # what it was fitted to
    loop: Loop | None  # hysteresis, significant or not; None where it does not show
    kept_loop: bool  # whether the loop is part of the model
    warm_up: WarmUp | None  # where it was asked for and observable
    turn_on: TurnOn | None  # None for one session
    findings: tuple[Finding, ...]

    @property
    def extra_variance(self) -> FloatArray:
        """Variance that every node gets beside that of the middle curve: hysteresis half-width, session to come; (3,)."""
        extra = np.zeros(3) if self.turn_on is None else self.turn_on.variance_to_come
        if self.kept_loop and self.loop is not None:
            extra = extra + self.loop.half**2
        return extra

    def through_set_points(self, nodes: FloatArray) -> NodeValues:
        """Return the note's curve: not-a-knot through the means of the set-points, effects subtracted."""
        cells = self.cells
        left = cells.value - cells.regressors @ self.spline.coefficient
        own = cells.variance + self.spline.scatter_deviation**2 * np.diag(cells.correlation)[:, None]
        order = np.argsort(cells.temp_c, kind="stable")
        joined = np.empty(len(order), np.int64)
        joined[order] = bins_of(cells.temp_c[order], 1.0)
        rows = [np.flatnonzero(joined == k) for k in range(joined.max() + 1)]
        found = not_a_knot(
            np.array([cells.temp_c[r].mean() for r in rows]),
            np.array([left[r].mean(axis=0) for r in rows]),
            np.array([own[r].sum(axis=0) / len(r) ** 2 for r in rows]),
            nodes,
        )
        if cells.between is None:
            return found
        usual = np.diagonal(cells.between.shared, axis1=1, axis2=2).mean(axis=1)  # all set-points share the poses
        return replace(found, covariance=found.covariance + usual[:, None, None])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadDrift:
    """Offset over temperature of one triad, n nodes, raw unit."""

    offset: FloatArray | None  # (n, 3), absolute; None where only the change is known
    uncertainty: FloatArray  # (n, 3), standard uncertainty of each node
    extrapolated: BoolArray  # (n,), true where no data were near
    slope: FloatArray  # (3,), mean over the temperatures of the blocks, raw unit per K
    slope_uncertainty: FloatArray  # (3,)
    span_c: tuple[float, float]  # least and greatest temperature seen, degC
    leave_out_rms: FloatArray  # (3,), cross-validated error of cells; NaN where there are too few
    scatter: FloatArray  # (3,), bias instability, standard deviation
    curve: OffsetCurve
    # (n, 3), the part of ``uncertainty`` for a change of scale; None where gravity is not in the readings
    unknown_scale: FloatArray | None = None

    @property
    def mostly_unknown_scale(self) -> bool:
        """Whether an unobserved change of scale is most of the variance, at half the nodes near data or more."""
        if self.unknown_scale is None:
            return False
        near = ~self.extrapolated if not self.extrapolated.all() else self.extrapolated
        share = (self.unknown_scale[near] ** 2).sum(axis=1) / np.maximum(
            (self.uncertainty[near] ** 2).sum(axis=1), 1e-300
        )
        return bool(np.median(share) > 0.5)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StaticFit:
    """A static tuning table and what it is worth."""

    table: StaticDrift  # at the nodes asked for
    gyro: TriadDrift | None  # None where a triad was not observed
    accel: TriadDrift | None
    gyro_slope: FloatArray | None  # (3,), rad/s per K in b; None without a matrix
    verdict: Verdict


def fit_static(
    blocks: RestBlocks,
    *,
    nodes: FloatArray,
    calibration: Calibration | None = None,
    settings: StaticSettings = StaticSettings(),
) -> StaticFit:
    """Fit offset over temperature of both triads, at nodes (n,), degC."""
    found: list[Finding] = []
    gyro, accel, accel_table = None, None, None
    rates = gyro_offsets(blocks, calibration, settings.latitude_deg)
    if rates is not None:
        gyro = _triad(rates, nodes, settings)
        found += [*rates.findings, *gyro.curve.findings, *_triad_findings("gyroscope", gyro)]
    forces = accel_offsets(blocks, calibration, settings.accel_unit)
    if isinstance(forces, Finding):
        found.append(forces)
    else:
        accel, own = _accel(forces, nodes, calibration, settings)
        found += [*forces.findings, *own] if accel else own
        accel_table = None if accel is None or accel.offset is None else accel
    if gyro is None and accel is None:
        raise NotObservable(
            "static drift: wanted readings at two temperatures or more, got none; "
            + "; ".join(item.text for item in found)
        )
    table = StaticDrift(
        temp_c=nodes,
        gyro_offset=None if gyro is None else gyro.offset,
        gyro_uncertainty=None if gyro is None else gyro.uncertainty,
        gyro_extrapolated=None if gyro is None else gyro.extrapolated,
        accel_offset=None if accel_table is None else accel_table.offset,
        accel_uncertainty=None if accel_table is None else accel_table.uncertainty,
        accel_extrapolated=None if accel_table is None else accel_table.extrapolated,
        gyro_hysteresis=gyro.curve.loop.half if gyro and gyro.curve.kept_loop and gyro.curve.loop else None,
        warm_up=None if gyro is None else gyro.curve.warm_up,
    )
    model = None if calibration is None else calibration.gyro
    return StaticFit(
        table=table,
        gyro=gyro,
        accel=accel,
        gyro_slope=None if model is None or gyro is None else model.matrix @ gyro.slope,
        verdict=Verdict(
            status="marginal" if isinstance(forces, Finding) and forces.code == "drift.accel_gravity" else "good",
            findings=tuple(found),
        ),
    )


def _triad(
    offsets: Offsets, nodes: FloatArray, settings: StaticSettings, reference: tuple[float, TriadModel] | None = None
) -> TriadDrift:
    """Fit one triad; with a reference the table is its offset plus the change since its temperature."""
    curve = fit_curve(offsets, settings.curve)
    temp_c = offsets.blocks.temp_c
    span = float(temp_c.min()), float(temp_c.max())
    inside = np.quantile(temp_c, np.linspace(0.0, 1.0, _SLOPE_POINTS))
    at = np.concatenate((nodes, inside, [nodes[0] if reference is None else reference[0]]))
    found = curve.through_set_points(at) if settings.not_a_knot else curve.spline.at(at)
    variance = offsets.common_variance + curve.extra_variance
    n = len(nodes)
    value, own = found.value[:n], np.diagonal(found.covariance, axis1=1, axis2=2).T[:n]
    if reference is not None:
        value, own = _from_reference(found, n, reference[1])
    temps, rows = found.temp_c[n : n + _SLOPE_POINTS], slice(n, n + _SLOPE_POINTS)
    weight = (temps - temps.mean()) / ((temps - temps.mean()) @ (temps - temps.mean()))
    slope_variance = np.einsum("i,kij,j->k", weight, found.covariance[:, rows, rows], weight)
    return TriadDrift(
        offset=value,
        uncertainty=np.sqrt(np.maximum(own, 0.0) + variance),
        extrapolated=~near_data(nodes, temp_c, edge_c=settings.edge_c, gap_c=settings.gap_c),
        slope=np.asarray(weight @ found.value[rows]),
        slope_uncertainty=np.sqrt(np.maximum(slope_variance, 0.0)),
        span_c=span,
        leave_out_rms=curve.spline.leave_out_rms,
        scatter=curve.spline.scatter_deviation,
        curve=curve,
    )


def _from_reference(found: NodeValues, count: int, model: TriadModel) -> tuple[FloatArray, FloatArray]:
    # The last point is the reference temperature: its error is shared by both ends of the difference.
    value = model.offset + found.value[:count] - found.value[-1]
    variance = np.diagonal(found.covariance, axis1=1, axis2=2).T
    shared = found.covariance[:, :count, -1].T
    names = [model.parameters.index(f"offset_{axis}") for axis in AXES]
    return value, variance[:count] + variance[-1] - 2.0 * shared + np.diag(model.covariance)[names]


def _accel(
    offsets: Offsets, nodes: FloatArray, calibration: Calibration | None, settings: StaticSettings
) -> tuple[TriadDrift | None, list[Finding]]:
    model = None if calibration is None else calibration.accel
    reference = calibration.reference_temp_c if calibration is not None else float("nan")
    known = None if model is None or not np.isfinite(reference) else (reference, model)
    try:
        found = _triad(offsets, nodes, settings, known)
    except NotObservable as error:
        return None, [finding("drift.accel_not_observable", "info", problem=str(error))]
    if model is None:
        return replace(found, offset=None), [finding("drift.accel_uncalibrated", "info")]
    if known is None:
        return replace(found, offset=None), [finding("drift.accel_no_reference", "info")]
    gravity = found.curve.spline.at(np.array([reference])).value[0] - model.offset
    unknown = UNKNOWN_SCALE_PER_K * np.abs(nodes - reference)[:, None] * np.abs(gravity)
    found = replace(found, uncertainty=np.hypot(found.uncertainty, unknown), unknown_scale=unknown)
    return found, _triad_findings("accelerometer", found)


def near_data(nodes: FloatArray, temp_c: FloatArray, *, edge_c: float, gap_c: float) -> BoolArray:
    """Tell which nodes (n,) have data (k,) near them, degC."""
    nearest = np.abs(nodes[:, None] - temp_c[None, :]).min(axis=1)
    outside = (nodes < temp_c.min()) | (nodes > temp_c.max())
    near: BoolArray = np.where(outside, nearest <= edge_c, nearest <= gap_c)
    return near


def far_from_data(sensor: str, found: TriadDrift) -> list[Finding]:
    """Return the finding on nodes that no data were near."""
    count, nodes, (low, high) = int(found.extrapolated.sum()), len(found.extrapolated), found.span_c
    if not count:
        return []
    return [
        finding("drift.nodes_extrapolated", "info", sensor=sensor, count=count, nodes=nodes, low_c=low, high_c=high)
    ]


def _triad_findings(sensor: str, found: TriadDrift) -> list[Finding]:
    loop = found.curve.loop
    if loop is None:
        return far_from_data(sensor, found)
    if found.curve.kept_loop:
        seen = finding("drift.hysteresis", "info", sensor=sensor, half_width=loop.half, uncertainty=loop.uncertainty)
    else:
        seen = finding("drift.no_hysteresis", "info", sensor=sensor, half_width=loop.half, uncertainty=loop.uncertainty)
    return [*far_from_data(sensor, found), seen]


# ---- one triad: the curve with hysteresis, warm-up and sessions


def fit_curve(offsets: Offsets, settings: CurveSettings = CurveSettings()) -> OffsetCurve:
    """Fit offset over temperature and what goes beside it."""
    blocks, found = offsets.blocks, list[Finding]()
    state = cooling(blocks, settings.sweeps)
    seen = settings.hysteresis and both_ways(blocks, state, settings.sweeps)
    if settings.hysteresis and not seen:
        found.append(_no_loop(blocks, state, settings.sweeps))
    tau = None
    if settings.warm_up:
        try:
            tau = warm_up_time(blocks, offsets.value)
        except NotObservable as error:
            own = error.numbers["share"]
            found.append(finding("drift.warm_up_not_observable", "info", percent=100.0 * (1.0 - own)))  # type: ignore[operator]
    loop = None
    if seen:
        full = _fit(offsets, state, tau, with_loop=True, settings=settings)
        loop = Loop(half=full[1].coefficient[0], uncertainty=full[1].coefficient_uncertainty[0])
    kept = loop is not None and loop.significant
    cells, spline, turn_on = full if kept else _fit(offsets, state, tau, with_loop=False, settings=settings)
    warm_up = None if tau is None else warm_up_table(tau, spline.coefficient[-1])
    found += _turn_on_findings(turn_on)
    return OffsetCurve(
        spline=spline,
        cells=cells,
        loop=loop,
        kept_loop=kept,
        warm_up=warm_up,
        turn_on=turn_on,
        findings=tuple(found),
    )


def _fit(
    offsets: Offsets, state: FloatArray, tau: float | None, *, with_loop: bool, settings: CurveSettings
) -> tuple[Cells, SmoothSpline, TurnOn | None]:
    blocks = offsets.blocks
    columns = [state] if with_loop else []
    if tau is not None:
        columns.append(np.exp(-blocks.power_on_s / tau))
    chunked = settings.cells if tau is None else replace(settings.cells, chunk_s=_CHUNK_S)
    cells = gather(
        blocks,
        offsets.value,
        offsets.variance,
        direction=state if with_loop else np.zeros(len(blocks)),
        regressors=np.column_stack(columns) if columns else np.zeros((len(blocks), 0)),
        step_error=offsets.step_error,
        settings=chunked,
    )
    turn_on, smooth = None, settings.smooth
    if cells.pairs:  # few pairs know the scatter less well than hundreds of blocks
        smooth = replace(smooth, scatter_spread=float(np.hypot(smooth.scatter_spread, np.sqrt(2.0 / cells.pairs))))
    if len(np.unique(cells.session)) > 1:
        turn_on = between_sessions(cells, cells.regressors, smooth)
    poses = None if cells.between is None else cells.between.shared
    sessions = None if turn_on is None else turn_on.shared(cells.session)
    spline = fit_smooth(
        cells.temp_c,
        cells.value,
        cells.variance,
        regressors=cells.regressors if columns else None,
        groups=cells.groups,
        scatter=Scatter(
            correlation=cells.correlation,
            variance=cells.instability,
            shared=poses if sessions is None else sessions if poses is None else sessions + poses,
        ),
        settings=smooth,
    )
    return cells, spline, turn_on


def _no_loop(blocks: RestBlocks, state: FloatArray, settings: HysteresisSettings) -> Finding:
    """Return why there is no loop: no sweep, sweeps of both ways over different temperatures, or of one way."""
    of_session = [np.flatnonzero(blocks.session == number) for number in np.unique(blocks.session)]
    swept = [rows for rows in of_session if _is_sweep(blocks.temp_c[rows], settings.overlap_c)]
    if not swept:
        return finding("drift.hysteresis_no_sweep", "info")
    ways = state[np.concatenate(swept)]
    if (ways < -0.5).any() and (ways > 0.5).any():
        return finding("drift.hysteresis_no_overlap", "info", overlap_c=settings.overlap_c)
    return finding("drift.hysteresis_one_way", "info")


def _is_sweep(temp_c: FloatArray, wide_c: float) -> bool:
    """Whether a session went through temperatures: a stretch without gaps, or three plateaus."""
    rising = np.sort(temp_c)
    plateaus = np.split(rising, np.flatnonzero(np.diff(rising) > wide_c) + 1)
    return len(plateaus) > 2 or max(float(np.ptp(plateau)) for plateau in plateaus) >= wide_c


def _turn_on_findings(turn_on: TurnOn | None) -> list[Finding]:
    if turn_on is None:
        return [finding("drift.one_session", "info")]
    if not turn_on.observable:
        return [finding("drift.sessions_apart", "info", sessions=turn_on.sessions)]
    if not turn_on.bounded.any():
        return []
    axes = tuple(axis for axis, held in zip(AXES, turn_on.bounded.tolist(), strict=True) if held)
    return [finding("drift.turn_on_bound", "info", sessions=turn_on.sessions, axes=axes)]


# ---- hysteresis: which way the temperature went


def cooling(blocks: RestBlocks, settings: HysteresisSettings = HysteresisSettings()) -> FloatArray:
    """Return c of each block, (n,): where in the loop the device was."""
    state = np.zeros(len(blocks))
    for session in np.unique(blocks.session):
        rows = np.flatnonzero(blocks.session == session)
        rows = rows[np.argsort(blocks.time[rows], kind="stable")]
        state[rows] = _direction(blocks.temp_c[rows].tolist(), settings)
    return state


def _direction(temp_c: list[float], settings: HysteresisSettings) -> FloatArray:
    state = np.zeros(len(temp_c))
    way, low, high = 0, temp_c[0], temp_c[0]
    turned = False
    for k, temp in enumerate(temp_c):
        low, high = min(low, temp), max(high, temp)
        if way == 0:
            if temp - low >= settings.start_c:
                way, high = 1, temp
            elif high - temp >= settings.start_c:
                way, low = -1, temp
        elif way == 1 and high - temp > settings.turn_c:
            way, low, turned = -1, temp, True
        elif way == -1 and temp - low > settings.turn_c:
            way, high, turned = 1, temp, True
        if way == 0:
            continue
        back = (high - temp) if way == 1 else (temp - low)  # from the extreme of this leg
        gone = (temp - low) if way == 1 else (high - temp)  # since the turn before
        crossed = 2.0 * back / settings.reversal_c
        lacking = 2.0 - 2.0 * gone / settings.reversal_c if turned else 0.0
        state[k] = -way * (1.0 - min(2.0, max(crossed, lacking, 0.0)))
    return state


def both_ways(blocks: RestBlocks, state: FloatArray, settings: HysteresisSettings = HysteresisSettings()) -> bool:
    """Tell whether both directions have seen a common range of temperature."""
    up, down = blocks.temp_c[state < -0.5], blocks.temp_c[state > 0.5]
    if not len(up) or not len(down):
        return False
    return bool(min(up.max(), down.max()) - max(up.min(), down.min()) >= settings.overlap_c)


# ---- warm-up


def warm_up_time(blocks: RestBlocks, value: FloatArray, *, least_s: float = 30.0, most_s: float = 3600.0) -> float:
    """Return the time constant of the warm-up of values (n, 3), s."""
    smooth = _smooth_basis(blocks.temp_c)
    constants = np.geomspace(least_s, most_s, 25)
    misfit, own = np.zeros(len(constants)), np.zeros(len(constants))
    left = _residual(smooth, value)
    scale = left.var(axis=0)
    for k, tau in enumerate(constants):
        decay = np.exp(-blocks.power_on_s / tau)[:, None]
        rest = _residual(smooth, decay)
        own[k] = rest.var() / max(float(decay.var()), 1e-300)
        explained = (rest.T @ left)[0] ** 2 / max(float((rest**2).sum()), 1e-300)
        misfit[k] = -float((explained / np.maximum(scale, 1e-300)).sum())
    best = int(np.argmin(misfit))
    if own[best] < _LEAST_OWN:
        raise NotObservable(
            f"warm-up: wanted temperature and time since power-on that differ, got {100.0 * (1.0 - own[best]):.1f} % of the one "
            "explained by the other; hold one temperature for half an hour after power-on, or warm up from two temperatures",
            share=float(own[best]),
        )
    return float(constants[best])


def warm_up_table(time_constant_s: float, amplitude: FloatArray) -> WarmUp:
    """Return the warm-up as a table that ends at zero."""
    time = time_constant_s * _SPAN * np.linspace(0.0, 1.0, _NODES) ** 1.5
    decay = np.exp(-time / time_constant_s)
    decay[-1] = 0.0
    return WarmUp(power_on_s=time, gyro_offset=decay[:, None] * amplitude)


def _smooth_basis(temp_c: FloatArray) -> FloatArray:
    x = (temp_c - temp_c.min()) / max(float(np.ptp(temp_c)), 1e-9)
    knots = np.linspace(0.0, 1.0, _KNOTS)[1:-1]
    return np.column_stack([x**power for power in range(4)] + [np.maximum(x - knot, 0.0) ** 3 for knot in knots])


def _residual(basis: FloatArray, values: FloatArray) -> FloatArray:
    left: FloatArray = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return left


# ---- g-sensitivity


def with_g_sensitivity(rests: RestBlocks, device: Calibration) -> tuple[Calibration, Verdict]:
    """Give a calibration the g-sensitivity that rests in several poses show."""
    model = device.gyro
    if model is None or device.accel is None or model.g_sensitivity is not None:
        return device, Verdict()
    blocks = rests.taken(np.flatnonzero(np.isfinite(rests.gyro).all(axis=1) & np.isfinite(rests.accel).all(axis=1)))
    force = specific_force(blocks, device)
    if not len(blocks) or force is None:
        return device, Verdict()
    between = gather(
        blocks,
        blocks.gyro,
        known_variance(blocks.gyro_variance),
        direction=np.zeros(len(blocks)),
        regressors=np.zeros((len(blocks), 0)),
        step_error=blocks.gyro_step_error,
    ).between
    estimated = None if between is None else _g_sensitivity(between, force)
    if between is None or estimated is None:
        return device, Verdict()
    count, m = len(model.parameters), model.matrix
    covariance = np.zeros((count + len(G_NAMES), count + len(G_NAMES)))
    covariance[:count, :count] = model.covariance
    covariance[count:, count:] = np.einsum("ak,bk,kij->aibj", m, m, estimated[1]).reshape(len(G_NAMES), len(G_NAMES))
    g = m @ estimated[0]
    known = replace(model, g_sensitivity=g, parameters=(*model.parameters, *G_NAMES), covariance=covariance)
    size = float(np.abs(g).max()) * si_factor(model.unit_out, "rate") * STANDARD_GRAVITY / RADIAN_PER_DEGREE
    estimate = finding("drift.g_sensitivity", "info", largest_dps_per_g=size, poses=between.poses)
    return replace(device, gyro=known), Verdict(findings=(estimate,))


def _g_sensitivity(between: RestScatter, force: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return H (3, 3), raw unit per m/s2, and the covariance of each row, (3, 3, 3); None where it is not observable."""
    from scipy.special import chdtri

    members = between.members
    centred, poses = centred_on_cells(members), indicators(members.pose)
    seen = centred @ np.array([force[rows].mean(axis=0) for rows in members.rows])
    size = np.linalg.svd(seen, compute_uv=False)
    if len(size) < 3 or size[-1] < _LEAST_SEEN * size[0]:
        return None
    taken = np.linalg.pinv(seen) @ centred
    left_out = centred - seen @ taken
    spare = int(np.linalg.matrix_rank(left_out @ poses, tol=_RESOLVED))
    if spare < _LEAST_SPARE:
        return None
    covariance = between.covariance + (between.rest**2)[:, None, None] * np.eye(len(seen))
    of_pose = _inverse(left_out @ poses) @ left_out
    pose_variance = pooled(excess(of_pose, of_pose @ poses, between.mean, covariance), spare)
    covariance = covariance + pose_variance[:, None, None] * (poses @ poses.T)
    found = (taken @ between.mean).T
    known = widening_of(spare + 2.0) * np.einsum("ij,kjl,ml->kim", taken, covariance, taken)
    square = sum(float(h @ np.linalg.solve(c, h)) for h, c in zip(found, known, strict=True))
    return (found, known) if square > float(chdtri(len(G_NAMES), _CHANCE)) else None


def _inverse(columns: FloatArray) -> FloatArray:
    """Return the pseudo-inverse without directions that are hardly resolved."""
    left, size, right = np.linalg.svd(columns, full_matrices=False)
    kept = size > _RESOLVED
    inverse: FloatArray = (right[kept].T / size[kept]) @ left[:, kept].T
    return inverse
