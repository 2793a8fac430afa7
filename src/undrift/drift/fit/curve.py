"""One triad's offset over temperature with what goes beside it: hysteresis, warm-up, sessions.

Effects enter one after another: the scatter between sessions, the loop where both directions were seen and it is significant,
the warm-up where it was asked for and can be told.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import WarmUp
from undrift.drift.fit.cells import Cells, CellSettings, gather, walk
from undrift.drift.fit.combine import TurnOn, between_sessions
from undrift.drift.fit.hysteresis import HysteresisSettings, Loop, both_ways, cooling
from undrift.drift.fit.offsets import Offsets
from undrift.drift.fit.spline import NodeValues, SmoothSpline, Wander, fit_smooth, not_a_knot
from undrift.drift.fit.warm_up import warm_up_table, warm_up_time
from undrift.drift.fit.weigh import SmoothSettings
from undrift.drift.observe.observations import RestBlocks
from undrift.errors import NotObservable

_CHUNK_S = 120.0  # cells are cut there and at its doubles where a warm-up is fitted


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveSettings:
    """What is fitted beside the curve.

    Parameters
    ----------
    hysteresis : bool
        Look for a loop between warming and cooling.
    warm_up : bool
        Fit an offset that dies away after power-on; recordings begin at power-on.
    smooth, cells, sweeps : SmoothSettings, CellSettings, HysteresisSettings
        Of the parts.
    """

    hysteresis: bool = True
    warm_up: bool = False
    smooth: SmoothSettings = field(default_factory=SmoothSettings)
    cells: CellSettings = field(default_factory=CellSettings)
    sweeps: HysteresisSettings = field(default_factory=HysteresisSettings)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OffsetCurve:
    """A fitted curve and the effects beside it.

    Parameters
    ----------
    spline : SmoothSpline
        The middle curve.
    cells : Cells
        What it was fitted to.
    loop : Loop or None
        Hysteresis, significant or not; None where it cannot be seen.
    kept_loop : bool
        Whether the loop is part of the model.
    warm_up : WarmUp or None
        Where it was asked for and can be told.
    turn_on : TurnOn or None
        None for one session.
    reasons : tuple of str
        What was found and what could not be, one sentence each.
    """

    spline: SmoothSpline
    cells: Cells
    loop: Loop | None
    kept_loop: bool
    warm_up: WarmUp | None
    turn_on: TurnOn | None
    reasons: tuple[str, ...]

    @property
    def extra_variance(self) -> FloatArray:
        """Variance that every node gets beside that of the middle curve: half the loop, the session to come; shape (3,)."""
        extra = np.zeros(3) if self.turn_on is None else self.turn_on.variance_to_come
        if self.kept_loop and self.loop is not None:
            extra = extra + self.loop.half**2
        return extra

    def through_set_points(self, nodes: FloatArray) -> NodeValues:
        """Return the note's curve: not-a-knot through the means of the set-points, effects taken off.

        Parameters
        ----------
        nodes : array, shape (m,)
            degC.

        Returns
        -------
        NodeValues
            Raw unit; the wander of the smoothing spline counts as variance of the means.
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
    """Fit offset over temperature and what goes beside it.

    Parameters
    ----------
    offsets : Offsets
        Of one triad.
    settings : CurveSettings
        Effects to look for.

    Returns
    -------
    OffsetCurve
        Curve, effects, and words.

    Raises
    ------
    NotObservable
        One temperature only.
    """
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
