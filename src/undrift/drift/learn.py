"""Learning in use: rests found in daily recordings update the gyroscopes' offset over temperature; no chamber is needed.

Each recording is one switch-on. Its rests, in parts of 2 K, are observations of each axis::

    y = m(T) + f(T) + a(date) + s + e       m table (or constant offset) before, f its error, s shift of the switch-on, e noise

    f    Gaussian, linear between nodes: inside the table sigma(T) sigma(T') rho(T - T'), rho a Matern 3/2; beyond it by h and h',
         on one side, also u2 h h' (slope) and q b(h, h'), an integrated Wiener process (bend); everywhere t2 / sessions, the
         switch-on of the sessions behind it. A constant offset is a table of one node with one slope on both sides.
    a    ageing: a Wiener process from the date of the table, g2 a day
    s    turn-on bias repeatability, variance t2
    e    noise of the rest, steps of a converter, the turn of a body, the half-width h of a loop that the table knows, and r2:
         poses, bias instability, and what else differs from rest to rest, as hysteresis and thermometer lag do

A Kalman filter over the recordings, in order of date, gives the likelihood of t, g, r and q at the points of a grid. Likelihood
times a stated prior (log-normal) is the weight of a point, and the mixture is the result. Each point leaves out a rest that a
contaminated normal distribution takes for an outlier. A node's uncertainty is that of a rest to come: curve, ageing so far, t2, h
and r2, of which no number of rests makes the last three smaller. Learning always begins at the tables before and takes all rests so
far: day by day and all at once give the same.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, TypeVar

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, interpolated
from undrift.drift.checks import STATUS_BEFORE, verdict_without
from undrift.drift.daily_rests import CELL_C, UNKNOWN, LearnSettings, daily_rests, in_order, raw_per_si
from undrift.drift.static import near_data
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, Level, finding
from undrift.fit.smooth import bending
from undrift.model import (
    AXES,
    Calibration,
    DriftTables,
    DynamicDrift,
    Learnt,
    ScaleDrift,
    StaticDrift,
    TriadModel,
    Verdict,
    versions_used,
)
from undrift.record import Session
from undrift.units import RADIAN_PER_DEGREE

_DPS = RADIAN_PER_DEGREE
_MARGIN_C = 5.0  # nodes reach this far beyond rests that the table before did not cover
_GAP_C = 5.0  # a node between rests this far from both is extrapolated
_STEP_C = 1.0  # between nodes where there was no table
_OUTLIER, _OUTLIER_SD = 0.01, 5.0 * _DPS  # share and standard deviation of cells that are no rest of this device, rad/s
_END_C = 10.0  # the slope at the end of a table is that of its last ten degrees
_POINTS = (4, 3, 4, 3)  # of the grid: turn-on, ageing, rest, bend
_REACH = 2.0  # standard deviations that the grid covers
_FEW = 3  # recordings: fewer do not show the repeatability
_MONTH, _SECONDS_A_DAY = 30.0, 86400.0
_PREFIX, _SETTINGS, _INPUTS = "drift.learn_", "drift_learn_", "drift_inputs_before"
_SOME_LEFT_OUT, _MOST_LEFT_OUT = 0.1, 0.5  # of the cells: marginal, and bad

T = TypeVar("T", StaticDrift, ScaleDrift, DynamicDrift)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LearnFit:
    """What daily recordings changed, n nodes, m cells of rest."""

    calibration: Calibration  # with the new table and what it was learnt from
    temp_c: FloatArray  # (n,), nodes, degC
    before: FloatArray  # (n, 3), offset before, rad/s
    before_uncertainty: FloatArray  # (n, 3), standard uncertainty for a switch-on to come, rad/s
    after: FloatArray  # (n, 3), the same with the rests; its uncertainty is for a rest to come
    after_uncertainty: FloatArray
    curve_uncertainty: FloatArray  # (n, 3), of the mean over switch-ons on the last date, rad/s
    extrapolated: BoolArray  # (n,), true where no data were near
    turn_on: FloatArray  # (3,), t, rad/s
    turn_on_uncertainty: FloatArray  # (3,)
    ageing: FloatArray  # (3,), in 30 days, rad/s
    ageing_uncertainty: FloatArray  # (3,)
    rest_scatter: FloatArray  # (3,), r, rad/s
    rest_temp_c: FloatArray  # (m,), degC
    rest_offset: FloatArray  # (m, 3), rad/s
    rest_uncertainty: FloatArray  # (m, 3), standard uncertainty by noise and the turn of a body, rad/s
    rest_kept: BoolArray  # (m,), false where it was left out
    recordings: int  # behind the table, earlier ones included
    verdict: Verdict


def learn_drift(
    sessions: Sequence[Session],
    calibration: Calibration,
    *,
    dates: Sequence[datetime],
    settings: LearnSettings = LearnSettings(),
) -> LearnFit:
    """Update the gyroscopes' offset over temperature by the rests of daily recordings; dates: one a session."""
    model = _checked(sessions, calibration, dates)
    held = None if calibration.drift is None else calibration.drift.learnt
    before = calibration.drift if held is None else held.before
    verdict = verdict_without(_PREFIX, calibration, f"{_SETTINGS}status_before")  # that of earlier learning goes
    base = replace(calibration, drift=before, verdict=verdict)
    new, found, used = daily_rests(sessions, calibration, base, dates, settings)
    if not any(part is not None and len(part.temp_c) for part in (held, *new)):
        raise NotObservable(
            "learn: wanted rests of some seconds with a known temperature, got none; "
            + "; ".join(item.text for item in found)
        )
    evidence = in_order(held, new, base)
    nodes = _nodes(before, base, evidence)
    prior = _Prior.of(base, nodes, evidence, settings)
    kept = np.ones(len(evidence.temp_c), bool)
    first = [_learnt(prior, evidence, axis, kept) for axis in range(3)]
    kept = np.min([axis.kept for axis in first], axis=0) >= 0.5  # what moves about one axis is no rest
    axes = first if kept.all() else [_learnt(prior, evidence, axis, kept) for axis in range(3)]
    nothing = [_learnt(prior, evidence, axis, np.zeros(len(kept), bool)) for axis in range(3)]
    si = 1.0 / raw_per_si(model)
    static, far = _table(before, nodes, axes, evidence.temp_c[kept])
    fit = LearnFit(
        calibration=calibration,
        temp_c=nodes,
        before=np.stack([axis.offset for axis in nothing], axis=1) * si,
        before_uncertainty=np.stack([axis.deviation for axis in nothing], axis=1) * si,
        after=np.stack([axis.offset for axis in axes], axis=1) * si,
        after_uncertainty=np.stack([axis.deviation for axis in axes], axis=1) * si,
        curve_uncertainty=np.stack([axis.curve_deviation for axis in axes], axis=1) * si,
        extrapolated=far,
        turn_on=np.array([axis.turn_on[0] for axis in axes]) * si,
        turn_on_uncertainty=np.array([axis.turn_on[1] for axis in axes]) * si,
        ageing=np.array([axis.ageing[0] for axis in axes]) * si,
        ageing_uncertainty=np.array([axis.ageing[1] for axis in axes]) * si,
        rest_scatter=np.array([axis.rest for axis in axes]) * si,
        rest_temp_c=evidence.temp_c,
        rest_offset=evidence.gyro_offset * si,
        rest_uncertainty=np.sqrt(evidence.gyro_variance) * si,
        rest_kept=kept,
        recordings=len(evidence.recordings),
        verdict=Verdict(),
    )
    covered = before is not None and before.static is not None and before.static.gyro_offset is not None
    verdict = Verdict.of(*found, *_findings(fit, evidence, covered))
    made = _calibrated(base, calibration, _tables(before, static, evidence), verdict, used)
    return replace(fit, calibration=made, verdict=verdict)


def _checked(sessions: Sequence[Session], calibration: Calibration, dates: Sequence[datetime]) -> TriadModel:
    """Return the gyroscopes' model; refuse what cannot be learnt from."""
    if not sessions:
        raise InputError("learn: wanted a recording or more, got none; name its file")
    if len(dates) != len(sessions):
        raise InputError(f"learn: wanted a date for each of {len(sessions)} recordings, got {len(dates)}; state them")
    names = {s.serial or s.records[0].device for s in sessions} | {calibration.device}
    named = sorted(name for name in names if name)
    if len(named) > 1:
        raise InputError(f"learn: wanted recordings and calibration of one device, got {', '.join(named)}; sort them")
    if calibration.gyro is None:
        raise InputError("learn: wanted a calibration of the gyroscopes, got one without; calibrate them first")
    return calibration.gyro


# ---- the curve


def _nodes(before: DriftTables | None, base: Calibration, evidence: Learnt) -> FloatArray:
    """Return the nodes of the new table: those before, and on to a margin beyond rests that they did not cover."""
    table = None if before is None else before.static
    low, high = float(evidence.temp_c.min()), float(evidence.temp_c.max())
    if table is None or table.gyro_offset is None:
        reference = base.reference_temp_c
        if np.isfinite(reference):
            low, high = min(low, reference), max(high, reference)
        low, high = np.floor(low - _MARGIN_C), np.ceil(high + _MARGIN_C)
        return np.arange(low, high + 0.5 * _STEP_C, _STEP_C)
    old, step = table.temp_c, float(np.median(np.diff(table.temp_c)))
    below = 0 if low >= old[0] else int(np.ceil((old[0] - low + _MARGIN_C) / step))
    above = 0 if high <= old[-1] else int(np.ceil((high + _MARGIN_C - old[-1]) / step))
    return np.concatenate((old[0] - step * np.arange(below, 0, -1), old, old[-1] + step * np.arange(1, above + 1)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Prior:
    """What was known before, d nodes of f, raw unit."""

    nodes: FloatArray  # (n,), of the table, degC
    x: FloatArray  # (d,), nodes of f, degC
    at_nodes: FloatArray  # (n, 3), m
    at_rests: FloatArray  # (m, 3), m
    days: FloatArray  # (r,), of the recordings since the table, day
    raw: FloatArray  # (3,), raw unit per rad/s
    loop: FloatArray  # (3,), half-width of the hysteresis about the table
    covariance: FloatArray  # (3, d, d), of f inside the table, with the slope beyond
    bending: FloatArray  # (d, d), of f beyond, for a bend of 1
    sessions: int  # behind the table
    settings: LearnSettings

    @classmethod
    def of(cls, base: Calibration, nodes: FloatArray, evidence: Learnt, settings: LearnSettings) -> "_Prior":
        """Return the prior of the three axes."""
        x = np.linspace(nodes[0], nodes[-1], int(np.ceil((nodes[-1] - nodes[0]) / CELL_C)) + 1)
        raw = raw_per_si(base.gyro)
        level = _Level.of(base, evidence.temp_c, settings, raw)
        h = x - np.clip(x, *level.span_c)
        return cls(
            nodes=nodes,
            x=x,
            at_nodes=level.at(nodes),
            at_rests=level.at(evidence.temp_c),
            days=_days(evidence),
            raw=raw,
            loop=level.loop,
            covariance=level.covariance(x, h, settings.correlation_c),
            bending=3.0 / _END_C**3 * bending(h, h),
            sessions=max(base.provenance.count("drift_sessions", 1), 1),
            settings=settings,
        )

    def at(self, axis: int, z: FloatArray) -> "_Point":
        """Return the grid at points z (4, G) of the standard normal prior."""
        own, raw = self.settings, self.raw[axis]
        factor = np.array([own.factor, own.factor, own.factor, own.bend_factor])[:, None] ** z
        middle = np.array([own.turn_on, own.ageing / _MONTH**0.5, own.rest, own.bend])
        turn_on, ageing, rest, bend = raw * middle[:, None] * factor
        grown = (turn_on**2 / self.sessions)[:, None, None] + (bend**2)[:, None, None] * self.bending
        return _Point(turn_on=turn_on, ageing=ageing, rest=rest, covariance=self.covariance[axis] + grown)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Point:
    """Points of the grid, G of them, raw unit."""

    turn_on: FloatArray  # (G,), t
    ageing: FloatArray  # (G,), g, in a day
    rest: FloatArray  # (G,), r
    covariance: FloatArray  # (G, d, d), of f


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Level:
    """The table before, or a constant offset as a table of one node, raw unit."""

    temp_c: FloatArray  # (k,), degC
    offset: FloatArray  # (k, 3)
    deviation: FloatArray  # (k, 3), standard uncertainty
    slope: FloatArray  # (2, 3), beyond either end, per K
    slope_deviation: FloatArray  # (2, 3), likewise
    # (3,), half-width of the hysteresis, not in ``deviation``
    loop: FloatArray = field(default_factory=lambda: np.zeros(3))

    @property
    def span_c(self) -> tuple[float, float]:
        """Least and greatest temperature, degC."""
        return float(self.temp_c[0]), float(self.temp_c[-1])

    @classmethod
    def of(cls, base: Calibration, seen_c: FloatArray, settings: LearnSettings, raw: FloatArray) -> "_Level":
        """Return what a calibration knows; raw: raw unit per SI unit."""
        table, model = None if base.drift is None else base.drift.static, base.gyro
        if table is not None and table.gyro_offset is not None:
            temp, offset = table.temp_c, table.gyro_offset
            own = np.full(offset.shape, np.nan) if table.gyro_uncertainty is None else table.gyro_uncertainty
            loop = np.zeros(3) if table.gyro_hysteresis is None else table.gyro_hysteresis
            own = np.where(np.isfinite(own), np.sqrt(np.maximum(own**2 - loop**2, 0.0)), settings.turn_on * raw)
            ends = ((temp[0], min(temp[0] + _END_C, temp[-1])), (max(temp[-1] - _END_C, temp[0]), temp[-1]))
            change = [interpolated(np.array(pair), temp, offset) for pair in ends]
            slope = np.array([(b - a) / (pair[1] - pair[0]) for (a, b), pair in zip(change, ends, strict=True)])
            doubt = 2.0**0.5 * own[[0, -1]] / np.array([pair[1] - pair[0] for pair in ends])[:, None]
            return cls(temp_c=temp, offset=offset, deviation=own, slope=slope, slope_deviation=doubt, loop=loop)
        constant = np.zeros(3) if model is None else model.offset
        variance = np.full(3, np.nan) if model is None else np.diag(model.covariance)[9:12]
        variance = np.where(np.isfinite(variance) & (variance > 0.0), variance, (UNKNOWN * raw) ** 2)
        reference = base.reference_temp_c
        if not np.isfinite(reference):  # it was found at some temperature of use
            reference, variance = float(np.median(seen_c)), variance + (settings.slope * _END_C * raw) ** 2
        return cls(
            temp_c=np.array([reference]),
            offset=constant[None, :],
            deviation=np.sqrt(variance)[None, :],
            slope=np.zeros((2, 3)),
            slope_deviation=np.array([settings.slope * raw] * 2),
        )

    def at(self, temp_c: FloatArray) -> FloatArray:
        """Return m(T), (n, 3): beyond the ends straight on."""
        h = temp_c - np.clip(temp_c, *self.span_c)
        beyond = np.where(h[:, None] < 0.0, self.slope[0], self.slope[1]) * h[:, None]
        return np.asarray(interpolated(temp_c, self.temp_c, self.offset) + beyond)

    def covariance(self, x: FloatArray, h: FloatArray, length_c: float) -> FloatArray:
        """Return the covariance of its errors at x (d,), which lie h (d,) beyond, (3, d, d)."""
        own = interpolated(x, self.temp_c, self.deviation)
        inside = np.clip(x, *self.span_c)  # the error at the end goes on
        ratio = 3.0**0.5 * np.abs(inside[:, None] - inside) / length_c
        alike = (1.0 + ratio) * np.exp(-ratio)
        same = np.ones((len(x), len(x))) if len(self.temp_c) == 1 else h[:, None] * h > 0.0
        slope = np.where(h[:, None] < 0.0, self.slope_deviation[0], self.slope_deviation[1]) * h[:, None]
        return np.asarray(
            np.einsum("ik,jk,ij->kij", own, own, alike) + np.einsum("ik,jk,ij->kij", slope, slope, same.astype(float))
        )


def _days(evidence: Learnt) -> FloatArray:
    """Return the dates of recordings as days since the table, or since the first where that is earlier."""
    since, *dates = (datetime.fromisoformat(text) for text in (evidence.since, *(d for _, d in evidence.recordings)))
    since = since if since.tzinfo else since.replace(tzinfo=UTC)
    return np.array([(date - min(since, dates[0])).total_seconds() / _SECONDS_A_DAY for date in dates])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Axis:
    """What was learnt of one axis, raw unit."""

    offset: FloatArray  # (n,), at the nodes, on the last date
    deviation: FloatArray  # (n,), for a rest to come
    curve_deviation: FloatArray  # (n,), for the mean of all
    turn_on: tuple[float, float]  # t and its standard uncertainty
    ageing: tuple[float, float]  # likewise, in 30 days
    rest: float  # r
    kept: FloatArray  # (m,), probability that each cell is a rest of this device


def _learnt(prior: _Prior, evidence: Learnt, axis: int, used: BoolArray) -> _Axis:
    """Filter the cells of one axis at the points of a grid, then of a finer one where the weight is, and return the mixture."""
    steps = [np.linspace(-_REACH, _REACH, count) for count in _POINTS]
    unit = np.array([part.ravel() for part in np.meshgrid(*steps, indexing="ij")])
    z, width = unit, np.ones(len(unit))
    for last in (False, False, True) if used.any() else (True,):
        point = prior.at(axis, z)
        made = _filtered(prior, evidence, axis, used, point)
        score = made.score - 0.5 * (z**2).sum(axis=0)
        weight = np.exp(score - score.max())
        weight /= weight.sum()
        if last:
            break
        centre = z @ weight
        # halves the step of an axis of three points about a peak narrower than it, which would seem exact else
        least = 0.25 * width * np.array([axis_steps[1] - axis_steps[0] for axis_steps in steps])
        width = np.maximum(np.sqrt((z - centre[:, None]) ** 2 @ weight), least)
        z = centre[:, None] + width[:, None] * unit
    d = len(prior.x)
    at = np.zeros((len(prior.nodes), d + 2))
    k, share = _places(prior.nodes, prior.x)
    rows = np.arange(len(k))
    at[rows, k], at[rows, k + 1], at[:, d] = 1.0 - share, share, 1.0
    curves = made.mean @ at.T
    middle = weight @ curves
    own = weight @ (np.einsum("nd,gde,ne->gn", at, made.covariance, at, optimize=True) + (curves - middle) ** 2)
    to_come = weight @ (point.turn_on**2 + (point.rest**2 if used.any() else 0.0)) + prior.loop[axis] ** 2
    return _Axis(
        offset=prior.at_nodes[:, axis] + middle,
        deviation=np.sqrt(np.maximum(own + to_come, 0.0)),
        curve_deviation=np.sqrt(np.maximum(own, 0.0)),
        turn_on=_weighed(weight, point.turn_on),
        ageing=_weighed(weight, point.ageing * _MONTH**0.5),
        rest=_weighed(weight, point.rest)[0],
        kept=made.kept @ weight,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Filtered:
    """State on the last date at G points: f at d nodes, ageing, switch-on; raw unit."""

    mean: FloatArray  # (G, d + 2)
    covariance: FloatArray  # (G, d + 2, d + 2)
    score: FloatArray  # (G,), logarithm of the likelihood
    kept: FloatArray  # (m, G), 1 where a cell was taken, else 0


def _filtered(prior: _Prior, evidence: Learnt, axis: int, used: BoolArray, point: _Point) -> _Filtered:
    """Run the Kalman filter over the recordings, cell by cell."""
    d, count = len(prior.x), len(point.turn_on)
    mean, spread = np.zeros((count, d + 2)), np.zeros((count, d + 2, d + 2))
    spread[:, :d, :d] = point.covariance
    score, kept = np.zeros(count), np.ones((len(used), count))
    misfit = evidence.gyro_offset[:, axis] - prior.at_rests[:, axis]
    variance = evidence.gyro_variance[:, axis] + prior.loop[axis] ** 2
    first, shares = _places(evidence.temp_c, prior.x)
    today, outlier = 0.0, float(prior.raw[axis]) * _OUTLIER_SD
    far = np.log(_OUTLIER) - 0.5 * np.log(2.0 * np.pi * outlier**2)
    for number, day in enumerate(prior.days.tolist()):
        spread[:, d, d] += point.ageing**2 * (day - today)
        today = day
        mean[:, d + 1] = spread[:, d + 1, :] = spread[:, :, d + 1] = 0.0
        spread[:, d + 1, d + 1] = point.turn_on**2
        for row in np.flatnonzero((evidence.recording == number) & used):
            at, w = [first[row], first[row] + 1, d, d + 1], np.array([1.0 - shares[row], shares[row], 1.0, 1.0])
            gain = spread[:, :, at] @ w
            total = gain[:, at] @ w + variance[row] + point.rest**2
            error = misfit[row] - mean[:, at] @ w
            near = np.log(1.0 - _OUTLIER) - 0.5 * (np.log(2.0 * np.pi * total) + error**2 / total)
            other = far - 0.5 * (error / outlier) ** 2
            kept[row] = near > other
            score += np.maximum(near, other)
            weight = np.where(near > other, 1.0 / total, 0.0)[:, None] * gain
            mean += weight * error[:, None]
            spread -= weight[:, :, None] * gain[:, None, :]
    return _Filtered(mean=mean, covariance=spread, score=score, kept=kept)


def _places(at: FloatArray, x: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return which node lies before each temperature, and the share of the way to the next."""
    place = np.interp(at, x, np.arange(len(x)))
    first = np.minimum(place.astype(np.int64), len(x) - 2)
    return first, place - first


def _weighed(weight: FloatArray, value: FloatArray) -> tuple[float, float]:
    mean = float(weight @ value)
    return mean, float(np.sqrt(weight @ (value - mean) ** 2))


# ---- tables, verdict and provenance


def _table(
    before: DriftTables | None, nodes: FloatArray, axes: list[_Axis], seen_c: FloatArray
) -> tuple[StaticDrift, BoolArray]:
    """Return the static table at the nodes, the accelerometers' columns held at their ends, and where no data were near."""
    old = None if before is None else before.static
    far = np.ones(len(nodes), bool) if not len(seen_c) else ~near_data(nodes, seen_c, gap_c=_GAP_C)
    if old is None:
        held = StaticDrift(temp_c=nodes)
    else:
        held = _extended(old, nodes)
        if old.gyro_offset is not None:
            marks = np.zeros(len(old.temp_c), bool) if old.gyro_extrapolated is None else old.gyro_extrapolated
            inside = (nodes >= old.temp_c[0]) & (nodes <= old.temp_c[-1])
            far &= ~inside | marks[np.abs(nodes[:, None] - old.temp_c).argmin(axis=1)]
    made = replace(
        held,
        gyro_offset=np.stack([axis.offset for axis in axes], axis=1),
        gyro_uncertainty=np.stack([axis.deviation for axis in axes], axis=1),
        gyro_extrapolated=far,
    )
    return made, far


def _tables(before: DriftTables | None, static: StaticDrift, evidence: Learnt) -> DriftTables:
    """Return the tables with a new static one; the others reach as far, so that none narrows it."""
    known = before or DriftTables()
    nodes = static.temp_c
    scale = None if known.scale is None else _extended(known.scale, _reaching(known.scale.temp_c, nodes))
    dynamic = None if known.dynamic is None else _extended(known.dynamic, _reaching(known.dynamic.temp_c, nodes))
    return replace(known, static=static, scale=scale, dynamic=dynamic, learnt=evidence)


def _reaching(temp_c: FloatArray, nodes: FloatArray) -> FloatArray:
    return np.concatenate((nodes[nodes < temp_c[0]], temp_c, nodes[nodes > temp_c[-1]]))


def _extended(table: T, nodes: FloatArray) -> T:
    """Return a table whose ends are held on to further nodes, marked as extrapolated.

    Beyond an end the uncertainty grows by the mean slope of the table, in quadrature.
    """
    old, own = np.asarray(table.temp_c), dict[str, Any]()
    nearest, h = np.abs(nodes[:, None] - old).argmin(axis=1), np.abs(nodes - np.clip(nodes, old[0], old[-1]))
    for sensor, kind in itertools.product(("gyro_", "accel_", ""), ("offset", "matrix", "error")):
        value = getattr(table, sensor + kind, None)
        if value is None:
            continue
        known, marks = getattr(table, f"{sensor}uncertainty"), getattr(table, f"{sensor}extrapolated")
        wide = h.reshape(-1, *[1] * (value.ndim - 1))
        own[sensor + kind] = value[nearest]
        if known is not None:
            slope = np.ptp(value, axis=0) / (old[-1] - old[0])
            own[f"{sensor}uncertainty"] = np.hypot(known[nearest], wide * slope)
        beyond = np.broadcast_to(h.reshape(-1, *[1] * (value.ndim - 2)) > 0.0, own[sensor + kind].shape[:-1])
        beyond = beyond if kind != "matrix" else h > 0.0
        own[f"{sensor}extrapolated"] = beyond if marks is None else marks[nearest] | beyond
    return replace(table, temp_c=nodes, **own)


def _calibrated(
    base: Calibration,
    given: Calibration,
    tables: DriftTables,
    verdict: Verdict,
    used: tuple[tuple[str, str], ...],
) -> Calibration:
    """Return a calibration with the tables; used: name and sha256 of the files that were learnt from."""
    held = given.provenance
    settings = {name: text for name, text in held.settings if not name.startswith(_SETTINGS)}
    count = 0 if tables.learnt is None else len(tables.learnt.recordings)
    settings |= {
        f"{_SETTINGS}recordings": f"{count}",
        f"{_SETTINGS}status_before": base.verdict.status,
    }
    # what learning adds goes with the tables when new ones are fitted
    settings.setdefault(_INPUTS, f"{len(held.inputs)}")
    settings.setdefault(STATUS_BEFORE, base.verdict.status)
    provenance = replace(
        held,
        inputs=tuple(dict.fromkeys((*held.inputs, *used))),
        settings=tuple(settings.items()),
        versions=held.versions or versions_used(),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    return replace(given, drift=tables, verdict=base.verdict.also(verdict), provenance=provenance)


def _findings(fit: LearnFit, evidence: Learnt, covered: bool) -> list[Finding]:
    """Return what was learnt and what it is worth; covered: whether there was a table before."""
    near = ~fit.extrapolated if not fit.extrapolated.all() else fit.extrapolated
    change = np.abs(fit.after - fit.before)[near] / _DPS
    row, axis = np.unravel_index(int(change.argmax()), change.shape)
    uncertain = [np.sqrt(np.mean(u[near] ** 2)) / _DPS for u in (fit.before_uncertainty, fit.after_uncertainty)]
    where = {"largest_dps": change[row, axis], "axis": AXES[axis], "temp_c": fit.temp_c[near][row]}
    found = [finding("drift.learn_changed", "info", before_dps=uncertain[0], after_dps=uncertain[1], **where)]
    sizes = {"dps": fit.turn_on / _DPS, "uncertainty_dps": fit.turn_on_uncertainty / _DPS}
    if fit.recordings < _FEW:
        found.append(finding("drift.learn_few", "warn", recordings=fit.recordings, **sizes))
    else:
        found.append(
            finding("drift.learn_turn_on", "info", recordings=fit.recordings, rest_dps=fit.rest_scatter / _DPS, **sizes)
        )
    sizes = {"dps": fit.ageing / _DPS, "uncertainty_dps": fit.ageing_uncertainty / _DPS}
    found.append(finding("drift.learn_ageing", "info", days=_days(evidence)[-1], **sizes))
    if not covered:
        found.append(finding("drift.learn_no_table", "info"))
    left, count = int((~fit.rest_kept).sum()), len(fit.rest_kept)
    level: Level = "warn" if left > _SOME_LEFT_OUT * count else "info"
    if left > _MOST_LEFT_OUT * count:
        found.append(finding("drift.learn_most_left_out", "fail", count=left, cells=count))
    elif left:
        found.append(finding("drift.learn_left_out", level, count=left, cells=count))
    return found
