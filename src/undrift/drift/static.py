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
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.drift.observe import RestBlocks
from undrift.drift.rests import (
    UNKNOWN_SCALE_PER_K,
    Cells,
    Offsets,
    TurnOn,
    accel_offsets,
    between_sessions,
    bins_of,
    gather,
    gyro_offsets,
)
from undrift.errors import NotObservable
from undrift.findings import Finding, finding
from undrift.fit.least_squares import determined
from undrift.fit.smooth import Cubics, NodeValues, Scatter, SmoothSpline, fit_smooth, not_a_knot
from undrift.model import AXES, Calibration, StaticDrift, TriadModel, Verdict, WarmUp

_EDGE_C = 0.5  # a node this far outside the temperatures seen is extrapolated
_GAP_C = 5.0  # and so is one between temperatures seen, this far from both
_START_C = 1.0  # temperature has to move by this before it has a direction
_TURN_C = 1.0  # and come back by this before the direction changes: more than the thermometer's noise
_REVERSAL_C = 4.0  # after a turn the loop is crossed over this much of temperature
_OVERLAP_C = 3.0  # both directions have to have seen a common range as wide as this
_SIGNIFICANT = 3.0  # standard uncertainties on one axis or more: a smaller half-width is not kept
_SLOPE_POINTS = 60
_CHUNK_S = 120.0  # cells are cut there and at its doubles where a warm-up is fitted
_LEAST_OWN = 0.05  # of the variance of exp(-t / tau) that temperature does not explain
_CHANCE = 1e-3  # of soaks that are missed by as much although the stated uncertainty is right
_LEAST_LEFT_OUT, _FAR_BELOW = 5, 1.0 / 3.0  # soaks that are judged by; error over stated, on all axes
_INTERVALS = 5  # of the curve over temperature that a warm-up has to differ from
_NODES = 13
_SPAN = 5.0  # time constants that a table covers


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticSettings:
    """How offset over temperature is fitted."""

    not_a_knot: bool = False  # True for the note's spline through the set-point means, False for the smoothing spline
    warm_up: bool = False  # fit a power-on transient; recordings begin at power-on
    latitude_deg: float | None = None  # to subtract the Earth rate along the vertical; None leaves it in
    accel_unit: str = "count"  # of the accelerometer's readings where no calibration states it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HysteresisLoop:
    """Hysteresis."""

    half: FloatArray  # (3,), h: offset while cooling minus offset while warming, over two, raw unit
    uncertainty: FloatArray  # (3,), standard uncertainty


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OffsetCurve:
    """A fitted curve and the effects beside it."""

    spline: SmoothSpline  # the middle curve
    cells: Cells  # what it was fitted to
    loop: HysteresisLoop | None  # hysteresis, significant or not; None where it does not show
    kept_loop: bool  # whether the loop is part of the model
    warm_up: WarmUp | None  # where it was asked for and observable
    turn_on: TurnOn | None  # None for one session
    findings: tuple[Finding, ...]

    @property
    def visit_variance(self) -> FloatArray:
        """What a visit to come adds, (3,), raw unit squared: legs, and rests of one leg that disagree."""
        rest = 0.0 if self.cells.between is None else self.cells.between.rest**2
        return np.asarray(self.spline.visit_deviation**2 + rest)

    def through_set_points(self, nodes: FloatArray) -> NodeValues:
        """Return the note's curve: not-a-knot through the means of the set-points, effects subtracted."""
        cells = self.cells
        residual = cells.value - cells.regressors @ self.spline.coefficient
        variance = cells.variance + self.spline.visit_deviation**2
        order = np.argsort(cells.temp_c, kind="stable")
        joined = np.empty(len(order), np.int64)
        joined[order] = bins_of(cells.temp_c[order], 1.0)
        rows = [np.flatnonzero(joined == k) for k in range(joined.max() + 1)]
        curve = not_a_knot(
            np.array([cells.temp_c[r].mean() for r in rows]),
            np.array([residual[r].mean(axis=0) for r in rows]),
            np.array([variance[r].sum(axis=0) / len(r) ** 2 for r in rows]),
            nodes,
        )
        if cells.between is None:
            return curve
        usual = np.diagonal(cells.between.shared, axis1=1, axis2=2).mean(axis=1)  # all set-points share the poses
        return replace(curve, covariance=curve.covariance + usual[:, None, None])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadDrift:
    """Offset over temperature of one triad, n nodes, raw unit."""

    offset: FloatArray | None  # (n, 3), absolute; None where only the change is known
    uncertainty: FloatArray  # (n, 3), standard uncertainty of each node, for a visit to come
    visit: FloatArray  # (3,), standard deviation of what one visit adds; part of ``uncertainty``
    extrapolated: BoolArray  # (n,), true where no data were near
    slope: FloatArray  # (3,), mean over the temperatures of the blocks, raw unit per K
    slope_uncertainty: FloatArray  # (3,)
    span_c: tuple[float, float]  # least and greatest temperature seen, degC
    curve: OffsetCurve
    offsets: Offsets  # what it was fitted to
    # (n, 3), the part of ``uncertainty`` for a change of scale; None where gravity is not in the readings
    unknown_scale: FloatArray | None = None

    @property
    def curve_uncertainty(self) -> FloatArray:
        """Standard uncertainty of the curve itself, the mean over visits, shape (n, 3)."""
        return np.asarray(np.sqrt(np.maximum(self.uncertainty**2 - self.visit**2, 0.0)))

    @property
    def mostly_unknown_scale(self) -> bool:
        """Whether an unobserved change of scale is most of the variance, at half the nodes near data or more."""
        if self.unknown_scale is None:
            return False
        near = ~self.extrapolated if not self.extrapolated.all() else self.extrapolated
        whole = np.maximum((self.uncertainty[near] ** 2).sum(axis=1), 1e-300)
        return bool(np.median((self.unknown_scale[near] ** 2).sum(axis=1) / whole) > 0.5)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StaticFit:
    """A static tuning table and what it is worth."""

    table: StaticDrift  # at the nodes asked for
    gyro: TriadDrift | None  # None where a triad was not observed
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
    rates = gyro_offsets(blocks, calibration, settings.latitude_deg)
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
            "static drift: wanted readings at two temperatures or more, got none; "
            + "; ".join(item.text for item in findings)
        )
    columns = {
        f"{sensor}_{name}": getattr(triad, name)
        for sensor, triad in (("gyro", gyro), ("accel", accel))
        if triad is not None and triad.offset is not None
        for name in ("offset", "uncertainty", "extrapolated", "visit")
    }
    loop = gyro.curve.loop if gyro is not None and gyro.curve.kept_loop else None
    table = StaticDrift(
        temp_c=nodes,
        **columns,
        gyro_hysteresis=None if loop is None else loop.half,
        warm_up=None if gyro is None else gyro.curve.warm_up,
    )
    return StaticFit(table=table, gyro=gyro, accel=accel, verdict=Verdict.of(*findings))


def _triad(
    offsets: Offsets,
    nodes: FloatArray,
    settings: StaticSettings,
    reference: tuple[float, TriadModel] | None = None,
) -> TriadDrift:
    """Fit one triad; with a reference the table is its offset plus the change since its temperature."""
    curve = fit_curve(offsets, warm_up=settings.warm_up)
    temp_c, n = offsets.blocks.temp_c, len(nodes)
    inside = np.quantile(temp_c, np.linspace(0.0, 1.0, _SLOPE_POINTS))
    at = np.concatenate((nodes, inside, [nodes[0] if reference is None else reference[0]]))
    at_nodes = curve.through_set_points(at) if settings.not_a_knot else curve.spline.at(at)
    every = np.diagonal(at_nodes.covariance, axis1=1, axis2=2).T
    value, variance = at_nodes.value[:n], every[:n]
    if reference is not None:  # the last point: its error is shared by both ends of the difference
        model = reference[1]
        value = model.offset + at_nodes.value[:n] - at_nodes.value[-1]
        variance = variance + every[-1] - 2.0 * at_nodes.covariance[:, :n, -1].T + np.diag(model.covariance)[9:12]
    # Beside that of the middle curve: the session to come, the hysteresis half-width
    extra = offsets.common_variance + (0.0 if curve.turn_on is None else curve.turn_on.variance_to_come)
    visit = curve.visit_variance
    if curve.kept_loop and curve.loop is not None:
        extra = extra + curve.loop.half**2
    temps, rows = at_nodes.temp_c[n : n + _SLOPE_POINTS], slice(n, n + _SLOPE_POINTS)
    weight = (temps - temps.mean()) / ((temps - temps.mean()) @ (temps - temps.mean()))
    slope_variance = np.einsum("i,kij,j->k", weight, at_nodes.covariance[:, rows, rows], weight)
    return TriadDrift(
        offset=value,
        uncertainty=np.sqrt(np.maximum(variance, 0.0) + extra + visit),
        visit=np.sqrt(visit),
        extrapolated=~near_data(nodes, temp_c, gap_c=_GAP_C),
        slope=np.asarray(weight @ at_nodes.value[rows]),
        slope_uncertainty=np.sqrt(np.maximum(slope_variance, 0.0)),
        span_c=(float(temp_c.min()), float(temp_c.max())),
        curve=curve,
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
    gravity = triad.curve.spline.at(np.array([reference])).value[0] - model.offset
    unknown = UNKNOWN_SCALE_PER_K * np.abs(nodes - reference)[:, None] * np.abs(gravity)
    triad = replace(triad, uncertainty=np.hypot(triad.uncertainty, unknown), unknown_scale=unknown)
    return triad, _triad_findings("accelerometer", triad)


def near_data(nodes: FloatArray, temp_c: FloatArray, *, gap_c: float) -> BoolArray:
    """Tell which nodes (n,) have data (k,) near them: within a gap between two, and at the ends within half a degree."""
    nearest = np.abs(nodes[:, None] - temp_c[None, :]).min(axis=1)
    return np.asarray(nearest <= np.where((nodes < temp_c.min()) | (nodes > temp_c.max()), _EDGE_C, gap_c))


def far_from_data(sensor: str, found: TriadDrift) -> list[Finding]:
    """Return the finding on nodes that no data were near."""
    count, nodes, (low, high) = int(found.extrapolated.sum()), len(found.extrapolated), found.span_c
    if not count:
        return []
    return [
        finding("drift.nodes_extrapolated", "info", sensor=sensor, count=count, nodes=nodes, low_c=low, high_c=high)
    ]


def _triad_findings(sensor: str, triad: TriadDrift) -> list[Finding]:
    loop, has_loop = triad.curve.loop, triad.curve.kept_loop
    if loop is None:
        return far_from_data(sensor, triad)
    size = {"half_width": loop.half, "uncertainty": loop.uncertainty}
    seen = finding("drift.hysteresis" if has_loop else "drift.no_hysteresis", "info", sensor=sensor, **size)
    return [*far_from_data(sensor, triad), seen]


# ---- one triad: the curve with hysteresis, warm-up and sessions


@determined("offset over temperature")
def fit_curve(offsets: Offsets, *, warm_up: bool) -> OffsetCurve:
    """Fit offset over temperature, with hysteresis, warm-up and the shifts of sessions."""
    blocks, findings, state = offsets.blocks, list[Finding](), cooling(offsets.blocks)
    seen = both_ways(blocks, state)
    if not seen:
        findings.append(_no_loop(blocks, state))
    tau = None
    if warm_up:
        try:
            tau = warm_up_time(blocks, offsets.value)
        except NotObservable as error:
            own = error.numbers["share"]
            findings.append(finding("drift.warm_up_not_observable", "info", percent=100.0 * (1.0 - own)))  # type: ignore[operator]
    decay = [] if tau is None else [np.exp(-blocks.power_on_s / tau)]
    loop, has_loop = None, False
    if seen:
        cells, spline, turn_on = _smoothed(_cells(offsets, [state, *decay], state, tau))
        loop = HysteresisLoop(half=spline.coefficient[0], uncertainty=spline.coefficient_uncertainty[0])
        has_loop = bool((np.abs(loop.half) > _SIGNIFICANT * loop.uncertainty).any())
    if not has_loop:
        cells, spline, turn_on = _smoothed(_cells(offsets, decay, None, tau))
    if turn_on is None:
        findings.append(finding("drift.one_session", "info"))
    elif not np.isfinite(turn_on.variance).all():
        findings.append(finding("drift.sessions_apart", "info", sessions=turn_on.sessions))
    elif turn_on.bounded.any():
        axes = tuple(axis for axis, held in zip(AXES, turn_on.bounded, strict=True) if held)
        findings.append(finding("drift.turn_on_bound", "info", sessions=turn_on.sessions, axes=axes))
    findings += _left_out_findings(spline)
    return OffsetCurve(
        spline=spline,
        cells=cells,
        loop=loop,
        kept_loop=has_loop,
        warm_up=None if tau is None else warm_up_table(tau, spline.coefficient[-1]),
        turn_on=turn_on,
        findings=tuple(findings),
    )


def _cells(offsets: Offsets, columns: list[FloatArray], direction: FloatArray | None, tau: float | None) -> Cells:
    """Gather the blocks, with the means of columns (n,) as regressors; blocks of different directions (n,) are not averaged."""
    blocks = offsets.blocks
    return gather(
        blocks,
        offsets.value,
        offsets.variance,
        direction=np.zeros(len(blocks)) if direction is None else direction,
        regressors=np.array(columns).reshape(-1, len(blocks)).T,
        step_error=offsets.step_error,
        chunk_s=np.inf if tau is None else _CHUNK_S,
    )


def _smoothed(cells: Cells) -> tuple[Cells, SmoothSpline, TurnOn | None]:
    """Fit the curve with the regressors of the cells."""
    turn_on, shared = None, cells.instability if cells.between is None else cells.instability + cells.between.shared
    if len(np.unique(cells.session)) > 1:
        turn_on = between_sessions(cells)
        shared = (np.nan_to_num(turn_on.variance)[:, None, None] * (cells.session[:, None] == cells.session)) + shared
    spline = fit_smooth(
        cells.temp_c,
        cells.value,
        cells.variance,
        regressors=cells.regressors if cells.regressors.size else None,
        groups=cells.groups,
        scatter=Scatter(correlation=cells.visits, expected=cells.expected, shared=shared),
    )
    return cells, spline, turn_on


def _left_out_findings(spline: SmoothSpline) -> list[Finding]:
    """Return the finding that soaks, left out in turn, are missed by more or by far less than is stated."""
    from scipy.special import chdtri

    count, ratio = len(np.unique(spline.groups)), spline.left_out[1]
    if count < _LEAST_LEFT_OUT or np.isnan(ratio).any():
        return []
    size = {"ratio": ratio, "groups": count}
    if ratio.max() > np.sqrt(chdtri(count, _CHANCE / len(ratio)) / count):
        return [finding("drift.left_out_above", "warn", **size)]
    return [finding("drift.left_out_below", "info", **size)] if ratio.max() < _FAR_BELOW else []


def _no_loop(blocks: RestBlocks, state: FloatArray) -> Finding:
    """Return why there is no loop: no sweep, sweeps of both ways over different temperatures, or of one way."""
    of_session = [np.flatnonzero(blocks.session == number) for number in np.unique(blocks.session)]
    swept = [rows for rows in of_session if _is_sweep(blocks.temp_c[rows])]
    if not swept:
        return finding("drift.hysteresis_no_sweep", "info")
    ways = state[np.concatenate(swept)]
    if (ways < -0.5).any() and (ways > 0.5).any():
        return finding("drift.hysteresis_no_overlap", "info", overlap_c=_OVERLAP_C)
    return finding("drift.hysteresis_one_way", "info")


def _is_sweep(temp_c: FloatArray) -> bool:
    """Whether a session went through temperatures: a stretch without gaps, or three plateaus."""
    rising = np.sort(temp_c)
    plateaus = np.split(rising, np.flatnonzero(np.diff(rising) > _OVERLAP_C) + 1)
    return len(plateaus) > 2 or max(float(np.ptp(plateau)) for plateau in plateaus) >= _OVERLAP_C


# ---- hysteresis: which way the temperature went


def cooling(blocks: RestBlocks) -> FloatArray:
    """Return c of each block, (n,): where in the loop the device was."""
    state = np.zeros(len(blocks))
    for session in np.unique(blocks.session):
        rows = np.flatnonzero(blocks.session == session)
        rows = rows[np.argsort(blocks.time[rows], kind="stable")]
        state[rows] = _direction(blocks.temp_c[rows].tolist())
    return state


def _direction(temp_c: list[float]) -> FloatArray:
    state = np.zeros(len(temp_c))
    way, turned, low, high = 0, False, temp_c[0], temp_c[0]
    for k, temp in enumerate(temp_c):
        low, high = min(low, temp), max(high, temp)
        if way == 0 and temp - low >= _START_C:
            way, high = 1, temp
        elif way == 0 and high - temp >= _START_C:
            way, low = -1, temp
        elif way == 1 and high - temp > _TURN_C:
            way, low, turned = -1, temp, True
        elif way == -1 and temp - low > _TURN_C:
            way, high, turned = 1, temp, True
        back, gone = (high - temp, temp - low) if way == 1 else (temp - low, high - temp)  # from the last extreme
        crossed = 2.0 * back / _REVERSAL_C
        lacking = 2.0 - 2.0 * gone / _REVERSAL_C if turned else 0.0  # since the turn before
        state[k] = -way * (1.0 - min(2.0, max(crossed, lacking, 0.0)))
    return state


def both_ways(blocks: RestBlocks, state: FloatArray) -> bool:
    """Tell whether both directions have seen a common range of temperature."""
    up, down = blocks.temp_c[state < -0.5], blocks.temp_c[state > 0.5]
    return bool(len(up) and len(down) and min(up.max(), down.max()) - max(up.min(), down.min()) >= _OVERLAP_C)


# ---- warm-up


def warm_up_time(blocks: RestBlocks, value: FloatArray) -> float:
    """Return the time constant of the warm-up of values (n, 3), s."""
    low = float(blocks.temp_c.min())
    high = low + max(float(np.ptp(blocks.temp_c)), 1e-9)
    basis = Cubics(low=low, high=high, intervals=_INTERVALS).at(blocks.temp_c)

    def unexplained(values: FloatArray) -> FloatArray:
        return np.asarray(values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0])

    constants, residual = np.geomspace(30.0, 3600.0, 25), unexplained(value)
    misfit, share = np.zeros(len(constants)), np.zeros(len(constants))
    for k, tau in enumerate(constants):
        decay = np.exp(-blocks.power_on_s / tau)[:, None]
        rest = unexplained(decay)
        share[k] = rest.var() / max(float(decay.var()), 1e-300)
        explained = (rest.T @ residual)[0] ** 2 / max(float((rest**2).sum()), 1e-300)
        misfit[k] = -float((explained / np.maximum(residual.var(axis=0), 1e-300)).sum())
    best = int(np.argmin(misfit))
    if share[best] < _LEAST_OWN:
        raise NotObservable(
            f"warm-up: wanted temperature and time since power-on that differ, got {100.0 * (1.0 - share[best]):.1f} % of the one "
            "explained by the other; hold one temperature for half an hour after power-on, or warm up from two temperatures",
            share=float(share[best]),
        )
    return float(constants[best])


def warm_up_table(time_constant_s: float, amplitude: FloatArray) -> WarmUp:
    """Return the warm-up as a table that ends at zero."""
    time = time_constant_s * _SPAN * np.linspace(0.0, 1.0, _NODES) ** 1.5
    decay = np.exp(-time / time_constant_s)
    decay[-1] = 0.0
    return WarmUp(power_on_s=time, gyro_offset=decay[:, None] * amplitude)
