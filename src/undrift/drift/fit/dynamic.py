"""Dynamic drift: what the rate does to the error after offset(T) and matrix, per axis, as a table over measured rate and T.

``e(w, T) = w - true rate`` for w the measured rate of the axis' own turns: a smooth surface through the steps of all soaks
(``tensor.py``). Over the measured rate, so that the lookup needs no inversion. Rests that lay as the device turned stand at rate
zero. The table knows the axis' own rate alone: what turns about another axis do is left to the matrix.

Default nodes: the rates that were imposed, zero, and the ends of what was measured; every 5 degC over the soaks.
"""

from dataclasses import dataclass, field

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.model import AXES, Calibration, DynamicDrift, ScaleDrift, StaticDrift, Verdict
from undrift.drift.fit.scale import NodeSettings
from undrift.drift.fit.static import near_data
from undrift.drift.fit.steps import Steps, measured_rate, rests_of, steps_of
from undrift.drift.fit.tensor import Surface, SurfacePoints, fit_surface
from undrift.drift.observe.observations import RateSteps, RestBlocks
from undrift.errors import InputError, NotObservable

DEFAULT_STEP_C = 5.0
_OWN = 0.5  # share of the turning rate from which a row speaks of an axis
_SAME_RATE = 0.01  # of the greatest: imposed rates nearer to each other are one node
_NEAR_RATE = 0.02  # of the greatest: how far beyond the measured rates a node still counts as seen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DynamicFit:
    """The table of rate-dependent drift.

    Parameters
    ----------
    drift : DynamicDrift
        e at the nodes, with uncertainty and marks. An axis that was not turned has zeros with uncertainty NaN.
    surfaces : tuple of Surface or None
        One an axis; None where it was not turned.
    before, after : array, shape (3,)
        Root-mean-square residual of each axis about the offset of its mountings before and after, rad/s.
    excess : array, shape (3,)
        Scatter of the steps beyond the noise they stated, rad/s.
    verdict : Verdict
        In words.
    """

    drift: DynamicDrift
    surfaces: tuple[Surface | None, Surface | None, Surface | None]
    before: FloatArray
    after: FloatArray
    excess: FloatArray
    verdict: Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DynamicSettings:
    """Nodes of the table, and how stiff its surface is.

    Parameters
    ----------
    turn_rate : array, shape (k,), or None
        Nodes of the measured rate, rad/s; None takes the imposed rates, zero, and the ends of what was measured.
    temp_c : array, shape (m,), or None
        Nodes of the temperature, degC; None takes every 5 degC over the soaks.
    softness : tuple of three (float, float), or None
        Of each axis' surface over rate and temperature, as an earlier fit found it; None finds it by leaving out.
    nodes : NodeSettings
        Marks of extrapolation.
    """

    turn_rate: FloatArray | None = None
    temp_c: FloatArray | None = None
    softness: tuple[tuple[float, float], ...] | None = None
    nodes: NodeSettings = field(default_factory=NodeSettings)


def fit_dynamic(
    steps: RateSteps | Steps,
    calibration: Calibration,
    *,
    static: StaticDrift | None,
    scale: ScaleDrift | None,
    rests: RestBlocks | None = None,
    settings: DynamicSettings = DynamicSettings(),
) -> DynamicFit:
    """Fit the dynamic drift of the gyroscopes.

    Parameters
    ----------
    steps : RateSteps or Steps
        Dwells at steady rates at two temperatures or more.
    calibration : Calibration
        The device's constant model.
    static : StaticDrift or None
        Offset table, raw unit; the constant offset where there is none.
    scale : ScaleDrift or None
        Matrix table; the constant matrix where there is none.
    rests : RestBlocks, optional
        Rests at rate zero.
    settings : DynamicSettings
        Nodes.

    Returns
    -------
    DynamicFit
        Table with uncertainty and marks.

    Raises
    ------
    InputError
        Steps without a usable row, or nodes that do not increase.
    NotObservable
        One temperature only, or one rate only.
    """
    clean = steps_of(steps)
    rate = measured_rate(clean.gyro, clean.temp_c, calibration, static=static, scale=scale)
    at_rest = _rest_rows(clean, rests, calibration, static, scale)
    points = tuple(_points(clean, rate, at_rest, _variances(clean, calibration), axis) for axis in range(3))
    turn_rate, temp_c = _nodes(clean, points, settings)
    surfaces: list[Surface | None] = []
    for axis in range(3):
        own = points[axis]
        softness = None if settings.softness is None else settings.softness[axis]
        surfaces.append(
            None
            if own is None
            else fit_surface(own, rate_span=_ends(turn_rate), temp_span=_ends(temp_c), softness=softness)
        )
    drift = _table(points, surfaces, turn_rate, temp_c, settings)
    before, after, excess = (np.full(3, np.nan) for _ in range(3))
    for axis, (own, surface) in enumerate(zip(points, surfaces, strict=True)):
        if own is not None and surface is not None:
            before[axis], after[axis] = _rms_about_mountings(own), float(np.sqrt(np.mean(surface.residuals**2)))
            excess[axis] = surface.excess
    return DynamicFit(
        drift=drift,
        surfaces=(surfaces[0], surfaces[1], surfaces[2]),
        before=before,
        after=after,
        excess=excess,
        verdict=_verdict(clean, points).also(clean.verdict),
    )


def softness_of(fit: DynamicFit) -> tuple[tuple[float, float], ...]:
    """Return how soft each axis' surface was found to be, to fit parts of the same data alike.

    Parameters
    ----------
    fit : DynamicFit
        Fitted to all data.

    Returns
    -------
    tuple of three (float, float)
        For ``DynamicSettings.softness``.
    """
    return tuple((1e-2, 1e-2) if surface is None else surface.softness for surface in fit.surfaces)


def _variances(steps: Steps, calibration: Calibration) -> FloatArray:
    """Return the variance of each row's rate, (rad/s)^2, shape (n, 3)."""
    eye = np.zeros((4, 3))
    eye[1:] = np.eye(3)
    made = measured_rate(eye, np.zeros(4), calibration, static=None, scale=None)
    matrix = (made[1:] - made[0]).T
    return np.asarray(steps.variance @ (matrix**2).T)


def _rest_rows(
    steps: Steps,
    rests: RestBlocks | None,
    calibration: Calibration,
    static: StaticDrift | None,
    scale: ScaleDrift | None,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return rate, temperature and step row of the rests that lay as the device turned."""
    block, of = rests_of(steps, rests)
    if rests is None or not len(block):
        return np.empty((0, 3)), np.empty(0), of
    found = rests.taken(block)
    rate = measured_rate(found.gyro, found.temp_c, calibration, static=static, scale=scale)
    return rate, found.temp_c, of


def _points(
    steps: Steps,
    rate: FloatArray,
    at_rest: tuple[FloatArray, FloatArray, IntArray],
    variances: FloatArray,
    axis: int,
) -> SurfacePoints | None:
    """Return what speaks of one axis' own rate; None where it was not turned at two soaks and two rates."""
    own = np.flatnonzero(np.abs(steps.rate_b[:, axis]) > _OWN * np.linalg.norm(steps.rate_b, axis=1))
    if len(np.unique(steps.soak[own])) < 2 or len(np.unique(steps.rate_b[own, axis])) < 2:
        return None
    of = at_rest[2]
    still = np.flatnonzero(np.isin(steps.mounting[of], steps.mounting[own]))
    rows = np.concatenate((own, of[still]))
    imposed = np.abs(steps.rate_b[own, axis])
    level = np.round(imposed / (_SAME_RATE * imposed.max())).astype(np.int64)
    return SurfacePoints(
        turn_rate=np.concatenate((rate[own, axis], np.zeros(len(still)))),
        temp_c=np.concatenate((steps.temp_c[own], at_rest[1][still])),
        value=np.concatenate((rate[own, axis] - steps.rate_b[own, axis], at_rest[0][still, axis])),
        variance=variances[rows, axis],
        soak=np.unique(steps.soak[rows], return_inverse=True)[1].reshape(-1),
        mounting=np.unique(steps.mounting[rows], return_inverse=True)[1].reshape(-1),
        level=np.concatenate((level, np.zeros(len(still), dtype=np.int64))),
    )


def _nodes(
    steps: Steps, points: tuple[SurfacePoints | None, ...], settings: DynamicSettings
) -> tuple[FloatArray, FloatArray]:
    have = [p for p in points if p is not None]
    soaks = len(np.unique(steps.soak))
    if not have:
        raise NotObservable(
            f"dynamic drift: wanted an axis turned at two rates and two soaks or more, got {len(steps)} steps at {soaks} soaks, "
            f"{steps.temp_c.min():.1f} to {steps.temp_c.max():.1f} degC; repeat the steps at another temperature",
            soaks=soaks,
        )
    temps = np.concatenate([p.temp_c for p in have])
    temp_c, turn_rate = settings.temp_c, settings.turn_rate
    if temp_c is None:
        low, high = (f(temps / DEFAULT_STEP_C) * DEFAULT_STEP_C for f in (_floor, _ceil))
        temp_c = np.linspace(low, high, round((high - low) / DEFAULT_STEP_C) + 1)
    if turn_rate is None:
        turn_rate = _rate_nodes(np.concatenate([p.turn_rate for p in have]), steps.along)
    if (np.diff(turn_rate) <= 0.0).any() or (np.diff(temp_c) <= 0.0).any():
        raise InputError("dynamic drift: wanted nodes that increase, got some that do not; sort and merge them")
    return turn_rate, temp_c


def _floor(x: FloatArray) -> float:
    return float(np.floor(round(float(x.min()), 2)))


def _ceil(x: FloatArray) -> float:
    return float(np.ceil(round(float(x.max()), 2)))


def _rate_nodes(measured: FloatArray, imposed: FloatArray) -> FloatArray:
    """Return the imposed rates, zero, and the ends of what was measured where they lie beyond."""
    tolerance = _SAME_RATE * float(np.abs(imposed).max())
    wanted = np.sort(np.concatenate((imposed, [0.0])))
    first = np.concatenate(([True], np.diff(wanted) > tolerance))
    groups = np.split(wanted, np.flatnonzero(first)[1:])
    nodes = np.array([0.0 if (g == 0.0).any() else g.mean() for g in groups])
    low, high = float(measured.min()), float(measured.max())
    below = [low] if low < nodes[0] - tolerance else []
    above = [high] if high > nodes[-1] + tolerance else []
    return np.concatenate((below, nodes, above))


def _table(
    points: tuple[SurfacePoints | None, ...],
    surfaces: list[Surface | None],
    turn_rate: FloatArray,
    temp_c: FloatArray,
    settings: DynamicSettings,
) -> DynamicDrift:
    shape = (len(temp_c), len(turn_rate), 3)
    error, uncertainty = np.zeros(shape), np.full(shape, np.nan)
    marks = np.zeros(shape[:2], dtype=bool)
    w, t = np.tile(turn_rate, len(temp_c)), np.repeat(temp_c, len(turn_rate))
    for axis, (own, surface) in enumerate(zip(points, surfaces, strict=True)):
        if own is None or surface is None:
            continue
        error[:, :, axis] = surface.at(w, t).reshape(shape[:2])
        uncertainty[:, :, axis] = surface.uncertainty(w, t).reshape(shape[:2])
        marks |= _unseen(own, turn_rate, temp_c, settings)
    return DynamicDrift(temp_c=temp_c, turn_rate=turn_rate, error=error, uncertainty=uncertainty, extrapolated=marks)


def _unseen(own: SurfacePoints, turn_rate: FloatArray, temp_c: FloatArray, settings: DynamicSettings) -> BoolArray:
    """Mark nodes beyond the temperatures, or beyond the rates that were measured around their temperature."""
    soaks = np.unique(own.soak)
    at = np.array([own.temp_c[own.soak == s].mean() for s in soaks])
    order = np.argsort(at)
    ends = [np.array([f(np.append(own.turn_rate[own.soak == s], 0.0)) for s in soaks])[order] for f in (np.min, np.max)]
    slack = _NEAR_RATE * float(np.abs(own.turn_rate).max())
    low, high = (np.interp(temp_c, at[order], end)[:, None] for end in ends)
    outside = (turn_rate < low - slack) | (turn_rate > high + slack)
    near = near_data(temp_c, at, edge_c=settings.nodes.edge_c, gap_c=settings.nodes.gap_c)
    return np.asarray(outside | ~near[:, None])


def _rms_about_mountings(own: SurfacePoints) -> float:
    means = np.bincount(own.mounting, own.value) / np.bincount(own.mounting)
    return float(np.sqrt(np.mean((own.value - means[own.mounting]) ** 2)))


def _ends(nodes: FloatArray) -> tuple[float, float]:
    return float(nodes[0]), float(nodes[-1])


def _verdict(steps: Steps, points: tuple[SurfacePoints | None, ...]) -> Verdict:
    reasons = []
    for axis, own in zip(AXES, points, strict=True):
        if own is None:
            reasons.append(
                f"dynamic drift of {axis} was not observable: it was not turned at two rates and two temperatures, and its table "
                f"holds zeros; turn about {axis} both ways at three soaks or more"
            )
            continue
        steady = own.turn_rate[own.level > 0]
        if (steady > 0.0).all() or (steady < 0.0).all():
            way, other = ("+", "-") if (steady > 0.0).all() else ("-", "+")
            reasons.append(
                f"dynamic drift of {axis}: turned only about {way}{axis}; nodes of the other sign are extrapolated and an offset "
                f"that the rests do not show cannot be told from it: turn about {other}{axis} as well"
            )
        if len(np.unique(own.soak)) == 2:
            reasons.append(f"dynamic drift of {axis}: two temperatures show no bend between them; add a soak")
    return Verdict(status="marginal" if reasons else "good", reasons=tuple(reasons))
