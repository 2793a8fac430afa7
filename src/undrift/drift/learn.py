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

Observations are temperature, reading and variance of each cell of a rest. A worn body turns while it rests. The mean rate of a rest
is the turn from its first to its last moment over its duration: gravity shows that about two axes, and the third is taken to turn
as much. The scatter of half seconds does not count there: sway goes to and fro, and its sum is that turn. Blocks, lag, warm-up,
g-sensitivity and the steps of a converter are those of ``undrift drift`` (drift/observe.py, drift/rests.py).
"""

import hashlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, TypeVar

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, interpolated
from undrift.calibration.observe import in_one_unit
from undrift.drift import observe
from undrift.drift.accel_in_use import AccelUseFit, accel_before, learn_accel, rest_forces, with_accel_in_use
from undrift.drift.checks import STATUS_BEFORE, verdict_without
from undrift.drift.observe import ObserveSettings, RestBlocks
from undrift.drift.rests import Offsets, bins_of, gyro_offsets, variance_of_mean
from undrift.drift.static import near_data
from undrift.drift.temperature import TemperatureSettings, sensor_course, trusted_temperature
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, Level, finding
from undrift.fit.smooth import bending
from undrift.model import (
    AXES,
    NO_TABLES,
    Calibration,
    DriftTables,
    DynamicDrift,
    Learnt,
    RestForces,
    ScaleDrift,
    StaticDrift,
    TriadModel,
    Verdict,
    versions_used,
)
from undrift.record import Record, Session, Still
from undrift.segments import StillSettings, find_still
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, Quantity, is_physical, si_factor

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
CELL_C = 2.0  # width of a temperature cell, K
UNKNOWN = 1.0 * _DPS  # standard uncertainty of an offset whose own is not known, rad/s
_WORN_RATE, _WORN_ACCEL = 3.0 * _DPS, 0.3  # rad/s, m/s2: a body that sits or stands quietly varies less within a second
_STEADY_C = 0.1  # of shift by ten seconds of lag: less is not reported
_WORN_S = 5.0  # shortest worn rest, s
_USELESS = 3.0  # a rest whose turn is this many times the table's uncertainty adds nothing

T = TypeVar("T", StaticDrift, ScaleDrift, DynamicDrift)


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnSettings:
    """Stated priors of what daily use does not show by itself; medians, and factors of one standard deviation."""

    turn_on: float = 0.02 * _DPS  # from one switch-on to the next, standard deviation, rad/s
    ageing: float = 0.01 * _DPS  # in 30 days, standard deviation, rad/s
    rest: float = 0.005 * _DPS  # from rest to rest of one switch-on: poses, bias instability, standard deviation, rad/s
    factor: float = 2.5  # spread of the three
    slope: float = 0.05 * _DPS  # standard deviation of the slope about a constant offset, rad/s per K
    bend: float = 0.03 * _DPS  # departure from a straight line 10 K beyond a table, standard deviation, rad/s
    bend_factor: float = 4.0  # its spread
    correlation_c: float = 10.0  # length over which the error of a table stays the same, K
    power_on_s: float | None = None  # time since power-on when a recording begins, s; None where it is not known
    observe: ObserveSettings = field(default_factory=ObserveSettings)
    temperature: TemperatureSettings = field(default_factory=TemperatureSettings)


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
    accel: AccelUseFit | None = None  # None without accelerometers, or rests of them


def learn_drift(
    sessions: Sequence[Session],
    calibration: Calibration,
    *,
    dates: Sequence[datetime],
    settings: LearnSettings = LearnSettings(),
) -> LearnFit:
    """Update the gyroscopes' offset over temperature by the rests of daily recordings; dates: one a session."""
    model = _checked(sessions, calibration, dates)
    earlier = None if calibration.drift is None else calibration.drift.learnt
    before = calibration.drift if earlier is None else earlier.before
    verdict = verdict_without(_PREFIX, calibration, f"{_SETTINGS}status_before")  # that of earlier learning goes
    base = replace(calibration, accel=accel_before(calibration), drift=before, verdict=verdict)
    new, findings, used = daily_rests(sessions, calibration, base, dates, settings)
    if not any(part is not None and len(part.temp_c) for part in (earlier, *new)):
        raise NotObservable(
            "learn: wanted rests of some seconds with a known temperature, got none; "
            + "; ".join(item.text for item in findings)
        )
    evidence = in_order(earlier, new, base)
    nodes = _nodes(before, base, evidence)
    prior = _Prior.of(base, nodes, evidence, settings)
    at_rest = np.ones(len(evidence.temp_c), bool)
    first = [_learnt(prior, evidence, axis, at_rest) for axis in range(3)]
    at_rest = np.min([axis.kept for axis in first], axis=0) >= 0.5  # what moves about one axis is no rest
    axes = first if at_rest.all() else [_learnt(prior, evidence, axis, at_rest) for axis in range(3)]
    nothing = [_learnt(prior, evidence, axis, np.zeros(len(at_rest), bool)) for axis in range(3)]
    si = 1.0 / raw_per_si(model)
    static, far = _table(before, nodes, axes, evidence.temp_c[at_rest])
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
        rest_kept=at_rest,
        recordings=len(evidence.recordings),
        verdict=Verdict(),
    )
    covered = before is not None and before.static is not None and before.static.gyro_offset is not None
    accel = None if evidence.accel is None else learn_accel(base, evidence.accel, _days(evidence))
    findings += _findings(fit, evidence, covered) + ([] if accel is None else list(accel.findings))
    verdict = Verdict.of(*findings)
    made = _calibrated(base, calibration, _tables(before, static, evidence), verdict, used)
    made = made if accel is None else with_accel_in_use(made, accel)
    return replace(fit, calibration=made, verdict=verdict, accel=accel)


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
            sd = np.full(offset.shape, np.nan) if table.gyro_uncertainty is None else table.gyro_uncertainty
            loop = np.zeros(3) if table.gyro_hysteresis is None else table.gyro_hysteresis
            sd = np.where(np.isfinite(sd), np.sqrt(np.maximum(sd**2 - loop**2, 0.0)), settings.turn_on * raw)
            ends = ((temp[0], min(temp[0] + _END_C, temp[-1])), (max(temp[-1] - _END_C, temp[0]), temp[-1]))
            change = [interpolated(np.array(pair), temp, offset) for pair in ends]
            slope = np.array([(b - a) / (pair[1] - pair[0]) for (a, b), pair in zip(change, ends, strict=True)])
            doubt = 2.0**0.5 * sd[[0, -1]] / np.array([pair[1] - pair[0] for pair in ends])[:, None]
            return cls(temp_c=temp, offset=offset, deviation=sd, slope=slope, slope_deviation=doubt, loop=loop)
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
        sd = interpolated(x, self.temp_c, self.deviation)
        inside = np.clip(x, *self.span_c)  # the error at the end goes on
        ratio = 3.0**0.5 * np.abs(inside[:, None] - inside) / length_c
        alike = (1.0 + ratio) * np.exp(-ratio)
        same = np.ones((len(x), len(x))) if len(self.temp_c) == 1 else h[:, None] * h > 0.0
        slope = np.where(h[:, None] < 0.0, self.slope_deviation[0], self.slope_deviation[1]) * h[:, None]
        return np.asarray(
            np.einsum("ik,jk,ij->kij", sd, sd, alike) + np.einsum("ik,jk,ij->kij", slope, slope, same.astype(float))
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
        fit = _filtered(prior, evidence, axis, used, point)
        score = fit.score - 0.5 * (z**2).sum(axis=0)
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
    curves = fit.mean @ at.T
    middle = weight @ curves
    own = weight @ (np.einsum("nd,gde,ne->gn", at, fit.covariance, at, optimize=True) + (curves - middle) ** 2)
    to_come = weight @ (point.turn_on**2 + (point.rest**2 if used.any() else 0.0)) + prior.loop[axis] ** 2
    return _Axis(
        offset=prior.at_nodes[:, axis] + middle,
        deviation=np.sqrt(np.maximum(own + to_come, 0.0)),
        curve_deviation=np.sqrt(np.maximum(own, 0.0)),
        turn_on=_weighed(weight, point.turn_on),
        ageing=_weighed(weight, point.ageing * _MONTH**0.5),
        rest=_weighed(weight, point.rest)[0],
        kept=fit.kept @ weight,
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
    score, at_rest = np.zeros(count), np.ones((len(used), count))
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
            at_rest[row] = near > other
            score += np.maximum(near, other)
            weight = np.where(near > other, 1.0 / total, 0.0)[:, None] * gain
            mean += weight * error[:, None]
            spread -= weight[:, :, None] * gain[:, None, :]
    return _Filtered(mean=mean, covariance=spread, score=score, kept=at_rest)


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
        base = StaticDrift(temp_c=nodes)
    else:
        base = _extended(old, nodes)
        if old.gyro_offset is not None:
            marks = np.zeros(len(old.temp_c), bool) if old.gyro_extrapolated is None else old.gyro_extrapolated
            inside = (nodes >= old.temp_c[0]) & (nodes <= old.temp_c[-1])
            far &= ~inside | marks[np.abs(nodes[:, None] - old.temp_c).argmin(axis=1)]
    static = replace(
        base,
        gyro_offset=np.stack([axis.offset for axis in axes], axis=1),
        gyro_uncertainty=np.stack([axis.deviation for axis in axes], axis=1),
        gyro_extrapolated=far,
    )
    return static, far


def _tables(before: DriftTables | None, static: StaticDrift, evidence: Learnt) -> DriftTables:
    """Return the tables with a new static one; the others reach as far, so that none narrows it."""
    known = before or NO_TABLES
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
    old, fields = np.asarray(table.temp_c), dict[str, Any]()
    nearest, h = np.abs(nodes[:, None] - old).argmin(axis=1), np.abs(nodes - np.clip(nodes, old[0], old[-1]))
    for sensor, kind in itertools.product(("gyro_", "accel_", ""), ("offset", "matrix", "error")):
        value = getattr(table, sensor + kind, None)
        if value is None:
            continue
        known, marks = getattr(table, f"{sensor}uncertainty"), getattr(table, f"{sensor}extrapolated")
        wide = h.reshape(-1, *[1] * (value.ndim - 1))
        fields[sensor + kind] = value[nearest]
        if known is not None:
            slope = np.ptp(value, axis=0) / (old[-1] - old[0])
            fields[f"{sensor}uncertainty"] = np.hypot(known[nearest], wide * slope)
        beyond = np.broadcast_to(h.reshape(-1, *[1] * (value.ndim - 2)) > 0.0, fields[sensor + kind].shape[:-1])
        beyond = beyond if kind != "matrix" else h > 0.0
        fields[f"{sensor}extrapolated"] = beyond if marks is None else marks[nearest] | beyond
    return replace(table, temp_c=nodes, **fields)


def _calibrated(
    base: Calibration, given: Calibration, tables: DriftTables, verdict: Verdict, used: tuple[tuple[str, str], ...]
) -> Calibration:
    """Return a calibration with the tables; used: name and sha256 of the files that were learnt from."""
    previous = given.provenance
    settings = {name: text for name, text in previous.settings if not name.startswith(_SETTINGS)}
    count = 0 if tables.learnt is None else len(tables.learnt.recordings)
    settings |= {f"{_SETTINGS}recordings": f"{count}", f"{_SETTINGS}status_before": base.verdict.status}
    # what learning adds goes with the tables when new ones are fitted
    settings.setdefault(_INPUTS, f"{len(previous.inputs)}")
    settings.setdefault(STATUS_BEFORE, base.verdict.status)
    provenance = replace(
        previous,
        inputs=tuple(dict.fromkeys((*previous.inputs, *used))),
        settings=tuple(settings.items()),
        versions=previous.versions or versions_used(),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
    )
    verdict = base.verdict.also(verdict)
    return replace(given, accel=base.accel, drift=tables, verdict=verdict, provenance=provenance)


def _findings(fit: LearnFit, evidence: Learnt, covered: bool) -> list[Finding]:
    """Return what was learnt and what it is worth; covered: whether there was a table before."""
    near = ~fit.extrapolated if not fit.extrapolated.all() else fit.extrapolated
    change = np.abs(fit.after - fit.before)[near] / _DPS
    row, axis = np.unravel_index(int(change.argmax()), change.shape)
    uncertain = [np.sqrt(np.mean(u[near] ** 2)) / _DPS for u in (fit.before_uncertainty, fit.after_uncertainty)]
    where = {"largest_dps": change[row, axis], "axis": AXES[axis], "temp_c": fit.temp_c[near][row]}
    findings = [finding("drift.learn_changed", "info", before_dps=uncertain[0], after_dps=uncertain[1], **where)]
    sizes = {"dps": fit.turn_on / _DPS, "uncertainty_dps": fit.turn_on_uncertainty / _DPS}
    if fit.recordings < _FEW:
        findings.append(finding("drift.learn_few", "warn", recordings=fit.recordings, **sizes))
    else:
        findings.append(
            finding("drift.learn_turn_on", "info", recordings=fit.recordings, rest_dps=fit.rest_scatter / _DPS, **sizes)
        )
    sizes = {"dps": fit.ageing / _DPS, "uncertainty_dps": fit.ageing_uncertainty / _DPS}
    findings.append(finding("drift.learn_ageing", "info", days=_days(evidence)[-1], **sizes))
    if not covered:
        findings.append(finding("drift.learn_no_table", "info"))
    left, count = int((~fit.rest_kept).sum()), len(fit.rest_kept)
    level: Level = "warn" if left > _SOME_LEFT_OUT * count else "info"
    if left > _MOST_LEFT_OUT * count:
        findings.append(finding("drift.learn_most_left_out", "fail", count=left, cells=count))
    elif left:
        findings.append(finding("drift.learn_left_out", level, count=left, cells=count))
    return findings


# ---- rests of daily recordings


def daily_rests(
    sessions: Sequence[Session],
    given: Calibration,
    base: Calibration,
    dates: Sequence[datetime],
    settings: LearnSettings,
) -> tuple[list[Learnt], list[Finding], tuple[tuple[str, str], ...]]:
    """Return the cells of each recording that is new, findings on the others, and the files that were learnt from."""
    held = None if given.drift is None else given.drift.learnt
    seen = {digest for digest, _ in held.recordings} if held is not None else set[str]()
    files, used = {digest for _, digest in given.provenance.inputs}, list[tuple[str, str]]()
    new, repeated, without, notes = list[Learnt](), list[str](), list[str](), list[Finding]()
    rests, worn, turning, ramps = 0, 0, 0, list[float]()
    for number, (session, date) in enumerate(zip(sessions, dates, strict=True)):
        name = session.inputs[0][0] if session.inputs else f"recording {number + 1}"
        digest = _digest(session)
        if digest in seen or any(own in files for file, own in session.inputs if not file.endswith(".toml")):
            repeated.append(name)
            continue
        seen.add(digest)
        stamp = (date if date.tzinfo else date.replace(tzinfo=UTC)).astimezone(UTC).isoformat(timespec="seconds")
        cells = _cells(observe.in_units_of(in_one_unit(session), base), base, settings)
        turning += cells.turning
        notes += [item for item in cells.notes if item.code not in {note.code for note in notes}]
        if cells.learnt is None:
            without.append(name)
            continue
        used += session.inputs
        ramps.append(cells.ramp_c_per_min)
        rests, worn = rests + cells.rests, worn + cells.worn
        new.append(replace(cells.learnt, recordings=((digest, stamp),)))
    if repeated:
        notes.append(finding("drift.learn_repeated", "info", count=len(repeated), names=tuple(repeated[:5])))
    if without:
        notes.append(finding("drift.learn_no_rests", "info", count=len(without), names=tuple(without[:5])))
    if turning:
        notes.append(finding("drift.learn_turning", "info", count=turning))
    ramp = float(np.mean(ramps)) if ramps else 0.0
    if ramp / 6.0 > _STEADY_C and (base.drift is None or base.drift.lag_s == 0.0):
        notes.append(finding("drift.learn_lag", "info", ramp_c_per_min=ramp, shift_c=ramp / 6.0))
    if new:
        notes.append(finding("drift.learn_rests", "info", recordings=len(new), rests=rests, worn=worn))
    return new, notes, tuple(used)


def _digest(session: Session) -> str:
    """Return a hash of the readings, whatever file they came in."""
    found = hashlib.sha256()
    for record in session.records:
        for part in (record.time - record.time[0], record.gyro, record.accel, record.temp_c):
            found.update(b"-" if part is None else np.ascontiguousarray(part).tobytes())
    return found.hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Cells:
    """What one recording shows."""

    learnt: Learnt | None = None
    rests: int = 0  # used
    worn: int = 0  # of them
    turning: int = 0  # left out, as they turn too much
    ramp_c_per_min: float = 0.0  # of the temperature in the blocks, root mean square, degC/min
    notes: tuple[Finding, ...] = ()


def _cells(session: Session, base: Calibration, settings: LearnSettings) -> _Cells:
    """Return the offset in each temperature cell of one recording, in the calibration's units."""
    trusted = [trusted_temperature(session, k, settings=settings.temperature) for k in range(len(session.records))]
    course = sensor_course(trusted, session, 0.0 if base.drift is None else base.drift.lag_s)
    notes = tuple(item for t in trusted for item in t.findings)
    stills, worn = _stills(session, base)
    if not stills:
        return _Cells(notes=notes)
    try:
        blocks = observe.observe_rests(
            [replace(session, stills=stills)], temperatures=[course], settings=settings.observe
        )
        of_still = _still_of(blocks, session, stills)
        blocks, turn = _with_turns(blocks, of_still, session, stills, worn, base)
        observe.check_at_rest(blocks, base)
    except NotObservable:
        return _Cells(notes=notes)
    useful = turn <= _USELESS * _doubt(base, blocks.temp_c, settings)
    turning = len(np.unique(of_still[~useful]))
    useful &= np.isfinite(blocks.gyro).all(axis=1)
    blocks, of_still = blocks.taken(useful), of_still[useful]
    offsets = gyro_offsets(blocks, base, None) if useful.any() else None
    if offsets is None:
        return _Cells(turning=turning, notes=notes)
    offsets = replace(offsets, value=offsets.value - _warm_up(base, offsets.blocks, settings.power_on_s))
    used = np.unique(of_still)
    turn_raw = turn[useful][:, None] * raw_per_si(base.gyro)
    parts = [_parts(offsets, np.flatnonzero(of_still == number), turn_raw) for number in used]
    temp_c, mean, variance = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    cells = Learnt(
        temp_c=temp_c,
        gyro_offset=mean,
        gyro_variance=variance + offsets.common_variance,
        recording=np.zeros(len(temp_c), np.int64),
        recordings=(("", ""),),
        since="",
        accel=rest_forces(session, stills, worn, course, base),
    )
    return _Cells(
        learnt=cells,
        rests=len(used),
        worn=int(worn[used].sum()),
        turning=turning,
        ramp_c_per_min=float(np.sqrt(np.mean(blocks.ramp_c_per_min**2))),
        notes=(*notes, *offsets.findings),
    )


def _parts(offsets: Offsets, rows: IntArray, turn: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return temperature, offset and variance of each part of a rest; a part may turn as far as the whole, in less time."""
    blocks, step = offsets.blocks, offsets.step_error
    rows = rows[np.argsort(blocks.temp_c[rows], kind="stable")]
    bins = bins_of(blocks.temp_c[rows], CELL_C)
    temp_c, mean, variance = list[float](), list[FloatArray](), list[FloatArray]()
    for number in range(bins.max() + 1):
        own = rows[bins == number]
        noise = variance_of_mean(offsets.value[own], offsets.variance[own], None if step is None else step[own])
        temp_c.append(float(blocks.temp_c[own].mean()))
        mean.append(offsets.value[own].mean(axis=0))
        variance.append(noise + (turn[own[0]] * len(rows) / len(own)) ** 2)
    return np.array(temp_c), np.array(mean), np.array(variance)


def _stills(session: Session, base: Calibration) -> tuple[tuple[Still, ...], BoolArray]:
    """Return rests as on a table, and those of a quiet body between them, in order of time; true for the latter."""
    try:
        quiet = list(observe.find_rests(session))
    except NotObservable:
        quiet = []
    worn: list[Still] = []
    for number, record in enumerate(session.records):
        if session.stills or record.gyro is None or record.accel is None or _force(record, base) is None:
            continue  # stated, or nothing bounds the turn
        settings = StillSettings(
            min_duration_s=_WORN_S,
            gyro_threshold=_WORN_RATE / _si(base.gyro, record.gyro_unit, "rate"),
            accel_threshold=_WORN_ACCEL / _si(base.accel, record.accel_unit, "accel"),
        )
        if record.duration_s > 2.0 * _WORN_S:
            found = find_still(record, settings, recording=number).stills
            own = [s for s in quiet if s.recording == number]
            worn += [s for s in found if all(s.stop <= o.start or o.stop <= s.start for o in own)]
    every = sorted([(s, False) for s in quiet] + [(s, True) for s in worn], key=lambda p: (p[0].recording, p[0].start))
    return tuple(s for s, _ in every), np.array([w for _, w in every], bool)


def raw_per_si(model: TriadModel | None) -> FloatArray:
    """Return raw units per rad/s, (3,)."""
    return np.ones(3) if model is None else model.scale_factor / si_factor(model.unit_out, "rate")


def _si(model: TriadModel | None, unit: str, quantity: Quantity) -> float:
    """Return how much of the SI unit one raw unit is."""
    if model is None:
        return si_factor(unit, quantity)
    return si_factor(model.unit_out, quantity) / float(model.scale_factor.mean())


def _force(record: Record, base: Calibration) -> FloatArray | None:
    """Return the specific force, (N, 3), m/s2 but for the offset of sensors without calibration; None in counts."""
    if record.accel is None:
        return None
    if base.accel is not None:
        return np.asarray((record.accel - base.accel.offset) @ base.accel.matrix.T)
    return record.accel * si_factor(record.accel_unit, "accel") if is_physical(record.accel_unit) else None


def _still_of(blocks: RestBlocks, session: Session, stills: tuple[Still, ...]) -> IntArray:
    """Return the rest that each block belongs to, (n,)."""
    records, begins_s = session.records, session.begins_s
    starts = [begins_s[s.recording] + records[s.recording].time[s.start] - records[s.recording].time[0] for s in stills]
    return np.asarray(np.searchsorted(starts, blocks.time, side="right") - 1)


def _with_turns(
    blocks: RestBlocks,
    of_still: IntArray,
    session: Session,
    stills: tuple[Still, ...],
    worn: BoolArray,
    base: Calibration,
) -> tuple[RestBlocks, FloatArray]:
    """Return blocks, the sway taken out of their variance, and the mean rate at which their rest may have turned, (n,) rad/s."""
    turn, variance = np.zeros(len(blocks)), np.array(blocks.gyro_variance)
    forces = [_force(record, base) for record in session.records]
    for number in np.unique(of_still):
        rows, still = np.flatnonzero(of_still == number), stills[number]
        record, force = session.records[still.recording], forces[still.recording]
        if force is None or record.gyro is None:
            continue
        inside = slice(still.start, still.stop)
        turn[rows] = _turn(force[inside], record.time[inside])
        if worn[number]:  # the turn of the whole rest bounds its sway: white noise is left
            steps = np.diff(record.gyro[inside], axis=0)
            variance[rows] = np.nanvar(steps, axis=0) / 2.0 * len(rows) / len(steps)
    return replace(blocks, gyro_variance=variance), turn


def _turn(force: FloatArray, time: FloatArray) -> float:
    """Return the mean rate that a rest may have had about each axis, rad/s, by the directions of gravity in its seconds."""
    known = np.isfinite(force).all(axis=1)
    force, time = force[known], time[known]
    duration_s = float(time[-1] - time[0]) if len(time) else 0.0
    if duration_s < 2.0:
        return 0.0
    second = np.minimum((time - time[0]).astype(np.int64), int(duration_s) - 1)
    count = np.bincount(second).astype(float)
    means = np.stack([np.bincount(second, part) for part in force.T], axis=1) / np.maximum(count, 1.0)[:, None]
    means = means[count > 0.5 * np.median(count)]
    up = means / np.linalg.norm(means, axis=1, keepdims=True)
    noise = float(np.var(np.diff(force, axis=0), axis=0).sum()) / 2.0 / float(np.median(count)) / STANDARD_GRAVITY**2
    ends, spread = float(((up[-1] - up[0]) ** 2).sum()), float(2.0 * up.var(axis=0).sum())
    return float(np.sqrt(max(max(ends, spread) - 4.0 * noise, 0.0) / 2.0)) / duration_s


def _doubt(base: Calibration, temp_c: FloatArray, settings: LearnSettings) -> FloatArray:
    """Return how uncertain the offset was before, (n,), rad/s: the table, a new switch-on, and the way beyond."""
    table, model = None if base.drift is None else base.drift.static, base.gyro
    shared = np.full(len(temp_c), settings.turn_on)
    if model is None or table is None or table.gyro_offset is None:
        return np.asarray(np.hypot(shared, UNKNOWN))
    beyond = np.abs(temp_c - np.clip(temp_c, table.temp_c[0], table.temp_c[-1]))
    doubt: FloatArray = np.hypot(shared, settings.slope * beyond)
    if table.gyro_uncertainty is None:
        return doubt
    own = table.gyro_uncertainty * _si(model, model.unit_in, "rate")
    return np.asarray(np.hypot(doubt, np.interp(temp_c, table.temp_c, np.nan_to_num(own).max(axis=1))))


def _warm_up(base: Calibration, blocks: RestBlocks, power_on_s: float | None) -> FloatArray:
    """Return the warm-up in each block, (n, 3), where the time since power-on is known."""
    static = None if base.drift is None else base.drift.static
    if static is None or static.warm_up is None or power_on_s is None:
        return np.zeros((len(blocks), 3))
    table, since = static.warm_up, blocks.power_on_s + power_on_s
    return interpolated(since, table.power_on_s, table.gyro_offset)


def in_order(earlier: Learnt | None, new: list[Learnt], base: Calibration) -> Learnt:
    """Return all cells so far, recordings in order of date: what was learnt first makes no difference."""
    parts = [*([] if earlier is None else [earlier]), *new]
    recordings = [one for batch in parts for one in batch.recordings]
    begins = np.cumsum([0, *(len(batch.recordings) for batch in parts)])[:-1].tolist()
    order = sorted(range(len(recordings)), key=lambda k: (recordings[k][1], recordings[k][0]))

    def joined(batches: list[tuple[Any, int]], *names: str) -> dict[str, Any]:
        place = np.argsort(order)[np.concatenate([batch.recording + begin for batch, begin in batches])]
        rows = np.argsort(place, kind="stable")
        columns = {name: np.concatenate([getattr(batch, name) for batch, _ in batches])[rows] for name in names}
        return columns | {"recording": place[rows]}

    forces = [(batch.accel, begin) for batch, begin in zip(parts, begins, strict=True) if batch.accel is not None]
    since = base.provenance.created if earlier is None else earlier.since
    return Learnt(
        **joined(list(zip(parts, begins, strict=True)), "temp_c", "gyro_offset", "gyro_variance"),
        recordings=tuple(recordings[k] for k in order),
        since=since or recordings[order[0]][1],
        before=base.drift,
        accel=RestForces(**joined(forces, "force", "variance", "temp_c"), model=forces[0][0].model) if forces else None,
    )
