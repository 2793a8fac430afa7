"""Static drift: absolute offsets over temperature, from blocks of rest.

::

    gyroscopes       y = u - K (G a + Earth rate)                           u mean reading, K = M^-1: ``drift/rests.py``
    accelerometers   y = u in one pose; offset(T) = offset(T_ref) + y(T) - y(T_ref)
    both             y = f(T) + h c + A exp(-t / tau) + d_s + e             ``drift/static.py``

T_ref and offset(T_ref) are those of the calibration. One pose cannot tell a change of scale along gravity from one of offset:
0.02 %/K * |T - T_ref| of what gravity reads counts as uncertainty, a capacitive accelerometer's usual sensitivity shift
(+-1 % in 50 K). The uncertainty of a node holds the noise, what wanders in a run, the curve
between and beyond the temperatures seen, half the loop of hysteresis where one was found, and the scatter between sessions
where there are several. It is of the offset at a reading of this thermometer, whose trim and self-heating belong to the table.

One triad's offset over temperature with what goes beside it: hysteresis, warm-up, sessions.

Effects enter one after another: the scatter between sessions, the loop where both directions were seen and it is significant,
the warm-up where it was asked for and can be told.

Thermal hysteresis: offset while cooling against offset while warming.

The middle curve f and half the loop h are told together::

    y = f(T) + h c + e        c = +1 while cooling, -1 while warming, in between straight over ``reversal_c`` after a turn

so that an unequal number of blocks on the way up and on the way down does not pull the middle. Before the temperature has moved
by ``start_c`` the state is not known and c = 0.

Warm-up: what a device that was switched on a short while ago adds to its settled offset.

::

    y = f(T) + A exp(-t / tau) + e        t since power-on, A one a sensor, tau of the device

tau is the one with the least squares of residuals on a grid, all axes together, beside a spline over temperature. The curve f
explains any change that goes with temperature, so A is seen only where time and temperature are not the same thing: on a soak at
one temperature, or in several warm-ups from different temperatures.

Gyroscopes that feel gravity, told by rests in several poses at one temperature, where the calibration does not know.

Means of rests (``drift/rests.py``), reading u in a cell of temperature and corrected specific force a, ::

    u_r = m_cell + H a_r + P_pose + E_r + noise and wander          G = M H, what ``correct`` takes off as M (u - offset) - G a

H by least squares within cells; P, what poses leave of that, and E have their variances from the same rests, and all of it is in
the covariance of H, widened for few poses by Student's factor. H is kept where its nine elements are larger, by that covariance,
than chance makes them once in a thousand. A G that the calibration has is kept, and nothing is estimated: it counts once.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.drift.observe import RestBlocks
from undrift.drift.rests import (
    Cells,
    CellSettings,
    Offsets,
    RestScatter,
    TurnOn,
    about_cells,
    accel_offsets,
    between_sessions,
    excess,
    gather,
    gyro_offsets,
    in_poses,
    known_variance,
    pooled,
    specific_force,
    walk,
)
from undrift.errors import NotObservable
from undrift.fit.smooth import NodeValues, SmoothSettings, SmoothSpline, Wander, fit_smooth, not_a_knot, widening_of
from undrift.model import AXES, G_NAMES, Calibration, StaticDrift, TriadModel, Verdict, WarmUp
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, si_factor

# ---- Thermal hysteresis: offset while cooling against offset while warming.

_SIGNIFICANT = 3.0  # standard uncertainties, on one axis or more


@dataclass(frozen=True, slots=True, kw_only=True)
class HysteresisSettings:
    """When a sweep goes up and when down."""

    start_c: float = 1.0  # Temperature has to move by this before a direction is told, degC
    # It has to come back by this from its extreme before the direction changes, degC; more than the thermometer's
    # noise
    turn_c: float = 1.0
    reversal_c: float = 4.0  # After a turn the loop is crossed over this much of temperature, degC
    overlap_c: float = 3.0  # Both directions have to have seen a common range as wide as this, degC


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Loop:
    """What the sweeps say about hysteresis."""

    half: FloatArray  # (3,), h: offset while cooling minus offset while warming, over two, raw unit
    uncertainty: FloatArray  # (3,), standard uncertainty

    @property
    def significant(self) -> bool:
        """Whether one axis or more exceeds three standard uncertainties."""
        return bool((np.abs(self.half) > _SIGNIFICANT * self.uncertainty).any())


def cooling(blocks: RestBlocks, settings: HysteresisSettings = HysteresisSettings()) -> FloatArray:
    """Return c of each block: where in the loop the device was.

    Arrays:  -> (n,).
    """
    state = np.zeros(len(blocks))
    for session in np.unique(blocks.session):
        rows = np.flatnonzero(blocks.session == session)
        rows = rows[np.argsort(blocks.time[rows], kind="stable")]
        state[rows] = _followed(blocks.temp_c[rows].tolist(), settings)
    return state


def both_ways(blocks: RestBlocks, state: FloatArray, settings: HysteresisSettings = HysteresisSettings()) -> bool:
    """Tell whether both directions have seen a common range of temperature.

    Arrays: state (n,).
    """
    up, down = blocks.temp_c[state < -0.5], blocks.temp_c[state > 0.5]
    if not len(up) or not len(down):
        return False
    return bool(min(up.max(), down.max()) - max(up.min(), down.min()) >= settings.overlap_c)


def _followed(temp_c: list[float], settings: HysteresisSettings) -> FloatArray:
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


# ---- Warm-up: what a device that was switched on a short while ago adds to its settled offset.

_LEAST_OWN = 0.05  # of the variance of exp(-t / tau) that temperature does not explain
_KNOTS = 6
_NODES = 13
_SPAN = 5.0  # time constants that a table covers


def warm_up_time(blocks: RestBlocks, value: FloatArray, *, least_s: float = 30.0, most_s: float = 3600.0) -> float:
    """Return the time constant of the warm-up.

    Arrays: value (n, 3).
    """
    smooth = _smooth_basis(blocks.temp_c)
    constants = np.geomspace(least_s, most_s, 25)
    misfit, own = np.zeros(len(constants)), np.zeros(len(constants))
    left = _without(smooth, value)
    scale = left.var(axis=0)
    for k, tau in enumerate(constants):
        fading = np.exp(-blocks.power_on_s / tau)[:, None]
        rest = _without(smooth, fading)
        own[k] = rest.var() / max(float(fading.var()), 1e-300)
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
    """Return the warm-up as a table that ends at zero.

    Arrays: amplitude (3,).
    """
    time = time_constant_s * _SPAN * np.linspace(0.0, 1.0, _NODES) ** 1.5
    fading = np.exp(-time / time_constant_s)
    fading[-1] = 0.0
    return WarmUp(power_on_s=time, gyro_offset=fading[:, None] * amplitude)


def _smooth_basis(temp_c: FloatArray) -> FloatArray:
    x = (temp_c - temp_c.min()) / max(float(np.ptp(temp_c)), 1e-9)
    knots = np.linspace(0.0, 1.0, _KNOTS)[1:-1]
    return np.column_stack([x**power for power in range(4)] + [np.maximum(x - knot, 0.0) ** 3 for knot in knots])


def _without(basis: FloatArray, values: FloatArray) -> FloatArray:
    left: FloatArray = values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
    return left


# ---- One triad's offset over temperature with what goes beside it: hysteresis, warm-up, sessions.

_CHUNK_S = 120.0  # cells are cut there and at its doubles where a warm-up is fitted


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveSettings:
    """What is fitted beside the curve."""

    hysteresis: bool = True  # Look for a loop between warming and cooling
    warm_up: bool = False  # Fit an offset that dies away after power-on; recordings begin at power-on
    smooth: SmoothSettings = field(default_factory=SmoothSettings)  # Of the parts
    cells: CellSettings = field(default_factory=CellSettings)  # Of the parts
    sweeps: HysteresisSettings = field(default_factory=HysteresisSettings)  # Of the parts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OffsetCurve:
    """A fitted curve and the effects beside it."""

    spline: SmoothSpline  # The middle curve
    cells: Cells  # What it was fitted to
    loop: Loop | None  # Hysteresis, significant or not; None where it cannot be seen
    kept_loop: bool  # Whether the loop is part of the model
    warm_up: WarmUp | None  # Where it was asked for and can be told
    turn_on: TurnOn | None  # None for one session
    reasons: tuple[str, ...]  # What was found and what could not be, one sentence each

    @property
    def extra_variance(self) -> FloatArray:
        """Variance that every node gets beside that of the middle curve: half the loop, the session to come; shape (3,)."""
        extra = np.zeros(3) if self.turn_on is None else self.turn_on.variance_to_come
        if self.kept_loop and self.loop is not None:
            extra = extra + self.loop.half**2
        return extra

    def through_set_points(self, nodes: FloatArray) -> NodeValues:
        """Return the note's curve: not-a-knot through the means of the set-points, effects taken off.

        Arrays: nodes (m,) degC.
        """
        cells = self.cells
        left = cells.value - cells.regressors @ self.spline.coefficient
        own = cells.variance + self.spline.scatter_deviation**2 * np.diag(cells.correlation)[:, None]
        order = np.argsort(cells.temp_c, kind="stable")
        joined = np.empty(len(order), np.int64)
        joined[order] = walk(cells.temp_c[order], 1.0)
        rows = [np.flatnonzero(joined == k) for k in range(joined.max() + 1)]
        found = not_a_knot(
            np.array([cells.temp_c[r].mean() for r in rows]),
            np.array([left[r].mean(axis=0) for r in rows]),
            np.array([own[r].sum(axis=0) / len(r) ** 2 for r in rows]),
            nodes,
        )
        if cells.between is None:
            return found
        usual = np.diagonal(cells.between.shared, axis1=1, axis2=2).mean(axis=1)  # all set-points are of the same poses
        return replace(found, covariance=found.covariance + usual[:, None, None])


def fit_curve(offsets: Offsets, settings: CurveSettings = CurveSettings()) -> OffsetCurve:
    """Fit offset over temperature and what goes beside it."""
    blocks, reasons = offsets.blocks, []
    state = cooling(blocks, settings.sweeps)
    seen = settings.hysteresis and both_ways(blocks, state, settings.sweeps)
    if settings.hysteresis and not seen:
        reasons.append(_no_loop(blocks, state, settings.sweeps))
    tau = None
    if settings.warm_up:
        try:
            tau = warm_up_time(blocks, offsets.value)
        except NotObservable as error:
            reasons.append(str(error))
    loop = None
    if seen:
        full = _fit(offsets, state, tau, with_loop=True, settings=settings)
        loop = Loop(half=full[1].coefficient[0], uncertainty=full[1].coefficient_uncertainty[0])
    kept = loop is not None and loop.significant
    cells, spline, turn_on = full if kept else _fit(offsets, state, tau, with_loop=False, settings=settings)
    warm_up = None if tau is None else warm_up_table(tau, spline.coefficient[-1])
    reasons += _of_sessions(turn_on)
    return OffsetCurve(
        spline=spline,
        cells=cells,
        loop=loop,
        kept_loop=kept,
        warm_up=warm_up,
        turn_on=turn_on,
        reasons=tuple(reasons),
    )


def _no_loop(blocks: RestBlocks, state: FloatArray, settings: HysteresisSettings) -> str:
    """Return why there is no loop: no sweep, sweeps of one way, or of both ways over different temperatures."""
    of_session = [np.flatnonzero(blocks.session == number) for number in np.unique(blocks.session)]
    swept = [rows for rows in of_session if _is_sweep(blocks.temp_c[rows], settings.overlap_c)]
    if not swept:
        return (
            "hysteresis is not observable: no sweep was seen, each session rested at one or two temperatures; half the loop is not "
            "in the uncertainty: record a sweep up and back"
        )
    ways = state[np.concatenate(swept)]
    if (ways < -0.5).any() and (ways > 0.5).any():
        return (
            f"hysteresis is not observable: warming and cooling share no {settings.overlap_c:g} degC; half the loop is not in the "
            "uncertainty: record a sweep up and back over the same temperatures"
        )
    return (
        "hysteresis is not observable: the temperature went one way only; the table is of that way, and half the loop is not "
        "in its uncertainty: record a sweep back"
    )


def _is_sweep(temp_c: FloatArray, wide_c: float) -> bool:
    """Tell whether a session went through temperatures: a stretch without gaps, or three plateaus."""
    rising = np.sort(temp_c)
    plateaus = np.split(rising, np.flatnonzero(np.diff(rising) > wide_c) + 1)
    return len(plateaus) > 2 or max(float(np.ptp(plateau)) for plateau in plateaus) >= wide_c


def _of_sessions(turn_on: TurnOn | None) -> list[str]:
    if turn_on is None:
        return ["one session: how far the offset moves between switch-ons is not known; record on another day"]
    if not turn_on.observable:
        return [
            "how far the offset moves between switch-ons is not observable: no two sessions share a temperature, where a shift "
            "could be told from drift, and it is not in the uncertainty: record them over shared temperatures"
        ]
    if not turn_on.bounded.any():
        return []
    axes = ", ".join(axis for axis, held in zip("xyz", turn_on.bounded.tolist(), strict=True) if held)
    return [
        f"between the {turn_on.sessions} sessions no shift is seen on {axes}: what is stated there is a bound, as well as their "
        "shifts are known; record more sessions"
    ]


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
        wander=Wander(
            correlation=cells.correlation,
            scatter=cells.scatter,
            shared=poses if sessions is None else sessions if poses is None else sessions + poses,
        ),
        settings=smooth,
    )
    return cells, spline, turn_on


# ---- Gyroscopes that feel gravity, told by rests in several poses at one temperature, where the calibration does not know.

_CHANCE = 1e-3
_LEAST_SEEN = 0.3  # of the best seen direction of gravity: a worse one is not told
_TOLD = 0.1  # singular value, in root rests of a pose: below, poses differ by what drifts in gravity's reading alone
_LEAST_SPARE = 1  # poses beyond those that H takes


def with_felt_gravity(rests: RestBlocks, device: Calibration) -> tuple[Calibration, Verdict]:
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
    felt = None if between is None else _felt(between, force)
    if between is None or felt is None:
        return device, Verdict()
    known = _with_g(model, *felt)
    size = float(np.abs(known.g_sensitivity).max()) * si_factor(model.unit_out, "rate")  # type: ignore[arg-type]
    told = (
        f"the gyroscopes feel gravity, by up to {size * STANDARD_GRAVITY / RADIAN_PER_DEGREE:.2g} (deg/s)/g: told by rests in "
        f"{between.poses} poses, part of the calibration now, and taken off by the corrected specific force"
    )
    return replace(device, gyro=known), Verdict(remarks=(told,))


def _felt(between: RestScatter, force: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return H, shape (3, 3), raw unit per m/s2, and the covariance of each row, shape (3, 3, 3); None where it is not told."""
    members = between.members
    about, poses = about_cells(members), in_poses(members)
    seen = about @ np.array([force[rows].mean(axis=0) for rows in members.rows])
    size = np.linalg.svd(seen, compute_uv=False)
    if len(size) < 3 or size[-1] < _LEAST_SEEN * size[0]:
        return None
    taken = np.linalg.pinv(seen) @ about
    beside = about - seen @ taken
    spare = int(np.linalg.matrix_rank(beside @ poses, tol=_TOLD))
    if spare < _LEAST_SPARE:
        return None
    covariance = between.covariance + (between.rest**2)[:, None, None] * np.eye(len(seen))
    of_pose = _inverse(beside @ poses) @ beside
    left = pooled(excess(of_pose, of_pose @ poses, between.mean, covariance), spare)
    covariance = covariance + left[:, None, None] * (poses @ poses.T)
    found = (taken @ between.mean).T
    known = widening_of(spare + 2.0) * np.einsum("ij,kjl,ml->kim", taken, covariance, taken)
    square = sum(float(h @ np.linalg.solve(c, h)) for h, c in zip(found, known, strict=True))
    return (found, known) if square > _least_square() else None


def _inverse(columns: FloatArray) -> FloatArray:
    """Return the pseudo-inverse without what is told by next to nothing."""
    left, size, right = np.linalg.svd(columns, full_matrices=False)
    told = size > _TOLD
    inverse: FloatArray = (right[told].T / size[told]) @ left[:, told].T
    return inverse


def _least_square() -> float:
    from scipy.special import chdtri

    return float(chdtri(len(G_NAMES), _CHANCE))


def _with_g(model: TriadModel, felt: FloatArray, known: FloatArray) -> TriadModel:
    count = len(model.parameters)
    covariance = np.zeros((count + len(G_NAMES), count + len(G_NAMES)))
    covariance[:count, :count] = model.covariance
    m = model.matrix
    covariance[count:, count:] = np.einsum("ak,bk,kij->aibj", m, m, known).reshape(len(G_NAMES), len(G_NAMES))
    return replace(model, g_sensitivity=m @ felt, parameters=(*model.parameters, *G_NAMES), covariance=covariance)


# ---- static

_SLOPE_POINTS = 60
UNKNOWN_SCALE_PER_K = 2e-4  # of an accelerometer that was seen in one pose


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticSettings:
    """How offset over temperature is fitted."""

    not_a_knot: bool = False  # True for the note's spline through the set-point means, False for the smoothing spline
    edge_c: float = 0.5  # A node this far outside the temperatures seen is extrapolated, degC
    gap_c: float = 5.0  # A node between temperatures seen, this far from both, is extrapolated, degC
    # Where the device lay, deg: the Earth rate along the vertical is taken off; None leaves it in
    latitude_deg: float | None = None
    # Unit of the accelerometer's readings where no calibration states it: count where it is not known
    accel_unit: str = "count"
    curve: CurveSettings = field(default_factory=CurveSettings)  # Effects beside temperature


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadDrift:
    """Offset over temperature of one triad, n nodes."""

    offset: FloatArray | None  # (n, 3), absolute, raw unit; None where only the change is known
    uncertainty: FloatArray  # (n, 3), standard uncertainty of each node, raw unit
    extrapolated: BoolArray  # (n,), true where no data were near
    slope: FloatArray  # (3,), mean slope over the temperatures of the blocks, raw unit per K
    slope_uncertainty: FloatArray  # (3,), mean slope over the temperatures of the blocks, raw unit per K
    span_c: tuple[float, float]  # Least and greatest temperature seen, degC
    # (3,), root-mean-square error of cells that their neighbours tell, raw unit; NaN where there are too few
    leave_out_rms: FloatArray
    scatter: FloatArray  # (3,), what wanders in a run, standard deviation, raw unit
    curve: OffsetCurve  # The fit and its effects
    # (n, 3), the part of ``uncertainty`` that stands for a change of scale, raw unit; None where gravity is not in
    # the readings
    unknown_scale: FloatArray | None = None

    @property
    def mostly_unknown_scale(self) -> bool:
        """Whether a change of scale that nobody saw is most of the variance, at half the nodes near data or more."""
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

    table: StaticDrift  # At the nodes asked for
    gyro: TriadDrift | None  # None where a triad was not observed
    accel: TriadDrift | None  # None where a triad was not observed
    gyro_slope: FloatArray | None  # (3,), rad/s per K in b; None without a matrix
    verdict: Verdict  # In words


def fit_static(
    blocks: RestBlocks,
    *,
    nodes: FloatArray,
    calibration: Calibration | None = None,
    settings: StaticSettings = StaticSettings(),
) -> StaticFit:
    """Fit offset over temperature of both triads.

    Arrays: nodes (n,) degC.
    """
    reasons: list[str] = []
    gyro, accel, accel_table = None, None, None
    rates = gyro_offsets(blocks, calibration, settings.latitude_deg)
    if rates is not None:
        gyro = _triad(rates, nodes, settings)
        reasons += [*rates.reasons, *gyro.curve.reasons, *_told("gyroscope", gyro)]
    forces = accel_offsets(blocks, calibration, settings.accel_unit)
    if isinstance(forces, str):
        reasons.append(forces)
    else:
        accel, said = _accel(forces, nodes, calibration, settings)
        reasons += [*forces.reasons, *said] if accel else said
        accel_table = None if accel is None or accel.offset is None else accel
    if gyro is None and accel is None:
        raise NotObservable(
            "static drift: wanted readings at two temperatures or more, got none; " + "; ".join(reasons)
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
            status="marginal" if isinstance(forces, str) and "left out" in forces else "good",
            remarks=tuple(dict.fromkeys(reasons)),
        ),
    )


def near_data(nodes: FloatArray, temp_c: FloatArray, *, edge_c: float, gap_c: float) -> BoolArray:
    """Tell which nodes have data near them.

    Arrays: nodes (n,) degC, temp_c (k,) degC -> (n,).
    """
    nearest = np.abs(nodes[:, None] - temp_c[None, :]).min(axis=1)
    outside = (nodes < temp_c.min()) | (nodes > temp_c.max())
    near: BoolArray = np.where(outside, nearest <= edge_c, nearest <= gap_c)
    return near


def far_from_data(name: str, found: TriadDrift) -> list[str]:
    """Return what is to be said of nodes that no data were near."""
    count = int(found.extrapolated.sum())
    if not count:
        return []
    return [
        f"{name}: {count} of {len(found.extrapolated)} nodes have no data near them (seen: {found.span_c[0]:.1f} to "
        f"{found.span_c[1]:.1f} degC) and are marked extrapolated"
    ]


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
        value, own = _since(found, n, reference[1])
    slope, slope_uncertainty = _slope(found, slice(n, n + _SLOPE_POINTS))
    return TriadDrift(
        offset=value,
        uncertainty=np.sqrt(np.maximum(own, 0.0) + variance),
        extrapolated=~near_data(nodes, temp_c, edge_c=settings.edge_c, gap_c=settings.gap_c),
        slope=slope,
        slope_uncertainty=slope_uncertainty,
        span_c=span,
        leave_out_rms=curve.spline.leave_out_rms,
        scatter=curve.spline.scatter_deviation,
        curve=curve,
    )


def _since(found: NodeValues, count: int, model: TriadModel) -> tuple[FloatArray, FloatArray]:
    # The last point is the reference temperature: its error is shared by both ends of the difference.
    value = model.offset + found.value[:count] - found.value[-1]
    variance = np.diagonal(found.covariance, axis1=1, axis2=2).T
    shared = found.covariance[:, :count, -1].T
    names = [model.parameters.index(f"offset_{axis}") for axis in AXES]
    return value, variance[:count] + variance[-1] - 2.0 * shared + np.diag(model.covariance)[names]


def _slope(found: NodeValues, inside: slice) -> tuple[FloatArray, FloatArray]:
    x = found.temp_c[inside] - found.temp_c[inside].mean()
    weight = x / (x @ x)
    variance = np.einsum("i,kij,j->k", weight, found.covariance[:, inside, inside], weight)
    return np.asarray(weight @ found.value[inside]), np.sqrt(np.maximum(variance, 0.0))


def _accel(
    offsets: Offsets, nodes: FloatArray, calibration: Calibration | None, settings: StaticSettings
) -> tuple[TriadDrift | None, list[str]]:
    model = None if calibration is None else calibration.accel
    reference = calibration.reference_temp_c if calibration is not None else float("nan")
    told = ""
    if model is None:
        told = (
            "no accelerometer calibration in physical units: the change over temperature is known, the offset is not; "
        )
        told += "calibrate six faces"
    elif not np.isfinite(reference):
        told = "the calibration names no reference temperature: the change of the accelerometers is known, their offset is not"
    known = None if model is None or told else (reference, model)
    try:
        found = _triad(offsets, nodes, settings, known)
    except NotObservable as error:
        return None, [f"accelerometer offset over temperature: {error}"]
    if told:
        return replace(found, offset=None), [f"accelerometer: {told}"]
    if known is not None:
        found = _with_unknown_scale(found, nodes, known)
    return found, _told("accelerometer", found)


def _with_unknown_scale(found: TriadDrift, nodes: FloatArray, known: tuple[float, TriadModel]) -> TriadDrift:
    reference, model = known
    gravity = found.curve.spline.at(np.array([reference])).value[0] - model.offset
    unknown = UNKNOWN_SCALE_PER_K * np.abs(nodes - reference)[:, None] * np.abs(gravity)
    return replace(found, uncertainty=np.hypot(found.uncertainty, unknown), unknown_scale=unknown)


def _told(name: str, found: TriadDrift) -> list[str]:
    said = far_from_data(name, found)
    loop = found.curve.loop
    if loop is not None:
        size = ", ".join(f"{h:.3g} +- {u:.2g}" for h, u in zip(loop.half, loop.uncertainty, strict=True))
        what = "modelled, and half of it counts as uncertainty" if found.curve.kept_loop else "not significant"
        said.append(f"{name}: half the loop between cooling and warming is {size} raw units on x, y, z: {what}")
    return said
