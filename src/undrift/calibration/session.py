"""What a session shows before anything is fitted: rests, faces, turns, temperature; and what every fit returns.

``observe`` takes the stills of a session as stated, or finds and labels them, checks that the device rests in them and that no
reading counts twice. ``at_one_temperature`` keeps the pieces of one set-point: a constant matrix holds at one temperature.
``Outcome`` is what a fit of one triad returns to ``calibrate``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise

import numpy as np

from undrift import segments
from undrift.arrays import FloatArray, runs
from undrift.calibration.codes import code_steps, code_variance
from undrift.calibration.plausibility import (
    SCALE_TOLERANCE,
    check_gravity,
    rate_unit_words,
    stuck_at_rate,
    stuck_in_motion,
)
from undrift.calibration.settings import CalibrateSettings
from undrift.errors import Implausible, InputError
from undrift.findings import Finding, finding
from undrift.fit.gls import student_factor
from undrift.fit.least_squares import TriadFit, block_size, excess_variance, noise_of_means
from undrift.model import AXES, Verdict, level_of
from undrift.record import FACES, Record, Session, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

# ---- rest: does the device rest where a session states it, and is no stretch counted twice?
#
# Three figures of each still, whatever the offset of its sensors:
#
#     sway    largest standard deviation of the readings, smoothed over 0.1 s, in a window of 1 s; three axes together
#     tilt    angle between the mean specific force of its first and of its last third
#     rate    mean rate reading less its median over all stills: a slow turn that no window shows
#
# Each has a limit that a bench keeps. Over the limit the still is a finding and makes the verdict marginal; over three times the
# limit the session is refused. Readings in counts have no bench limit: there a still is compared with the other stills.

_TILT_LIMIT_DEG = 0.5  # a device that settles on a bench or a cushion stays below it
_FAR = 3.0  # limits: no rest at all
_OTHERS = 10.0  # a still in counts may spread this many times the median of all stills
_SHARED = 0.1  # of the shorter of two stretches: more than this is counting twice
_WARM = 10.0  # K between stills: offsets may then differ


_Figure = tuple[FloatArray, float, str]  # of each still, its limit, and its unit


def check_stills(session: Session, stills: tuple[Still, ...], *, stated: bool) -> tuple[Finding, ...]:
    """Compare every still with a device at rest; raise where it is far from it."""
    figures = {"rate": [_rates(session, stills)]}
    if stated:
        figures |= {
            "sway": [_sways(session, stills, rate) for rate in (True, False)],
            "tilt": [_tilts(session, stills)],
        }
    # Stills that were found in one recording may drift with its warming; whole recordings apart have different units.
    most = {"rate": np.inf if stated or len(session.records) > 1 else _FAR}
    findings: list[tuple[float, int, Finding]] = []
    for kind, parts in figures.items():
        over = [
            (min(value / limit, most.get(kind, np.inf)), number, value, unit)
            for values, limit, unit in parts
            for number, value in enumerate(values.tolist())
            if value > limit  # not where it is NaN
        ]
        if over:
            multiple, number, value, unit = max(over, key=lambda one: one[0])
            still, of = piece_name(session, stills[number], number, stated=stated), len(over)
            if kind == "tilt":
                item = finding("still.tilt", "warn", still=still, stills=of, tilt_deg=value)
            else:  # rates as a person reads them, in deg/s
                value, unit = (value / RADIAN_PER_DEGREE, "dps") if unit == "rad/s" else (value, unit)
                shown = {kind: value, "unit": "deg/s" if unit == "dps" else unit}
                item = finding(
                    {"rate": "still.rate", "sway": "still.sway"}[kind], "warn", still=still, stills=of, **shown
                )
            findings.append((multiple, number, item))
    if findings:
        multiple, number, item = max(findings, key=lambda one: one[0])
        if multiple > _FAR:
            at = item.values["still"]
            raise Implausible(f"{at}: wanted a device at rest, got {item.detail}; {item.action}", still=number)
    return tuple(item for _, _, item in findings)


def check_counted_once(session: Session) -> None:
    """Raise when readings would count twice: the same recording, the same still or the same turn stated again."""
    for (one, first), (two, second) in combinations(enumerate(session.records), 2):
        if _same(first, second):
            raise InputError(
                f"recording {two}: wanted new readings, got those of recording {one} again; take one of the two out"
            )
    pieces: tuple[tuple[str, tuple[Still | Turn, ...]], ...] = (("still", session.stills), ("turn", session.turns))
    for what, stated in pieces:
        order = sorted(range(len(stated)), key=lambda k: (stated[k].recording, stated[k].start))
        for one, two in pairwise(order):
            a, b = stated[one], stated[two]
            shared = min(a.stop, b.stop) - b.start if a.recording == b.recording else 0
            if shared > _SHARED * min(a.stop - a.start, b.stop - b.start):
                early, late = min(one, two), max(one, two)
                raise InputError(
                    f"{piece_name(session, stated[late], late, what=what)}: wanted a stretch of its own, got one that "
                    f"shares {100.0 * shared / (stated[late].stop - stated[late].start):.0f} % of its samples with [[{what}]] "
                    f"{early + 1}; take one of the two out or correct its times"
                )


# ---- turns: steady where a rate is stated, from rest to rest where an angle is
#
# r is the reading of the turned axis less its offset, smoothed over 0.1 s; its level in a turn is the 90 % quantile of |r|.
#
#     stop     share of a dwell, settled, in stretches of 0.2 s or more with |r| below a fifth of its level: the table stood still
#     spread   standard deviation of the rest of r, as a share of its mean
#     cut      |r| at the start or end of a turn by an angle, as a share of its level: some of the angle is missing
#
# Each is a finding with the worst turn and how many there are. A turn near the noise is not judged: where its level is under eight
# times what white noise, by the steps between neighbouring samples, leaves of r.

_STOPPED, _STOP_S = 0.2, 0.2  # of the level, and s
_STOP_LIMITS = (0.0, 0.05)  # of a dwell: warn above the first, fail above the second, for each of the three
_SPREAD_LIMITS = (0.05, np.inf)
_CUT_LIMITS = (0.2, 0.5)
_NOISES = 8.0
_SMOOTH_S = 0.1
_END_S = 0.3  # a recording that turns throughout its last part is cut off


def check_turns(session: Session, stills: tuple[Still, ...], settle_s: float) -> Iterator[Finding]:
    """Compare every stated turn with one that is steady, or from rest to rest."""
    shares: dict[str, list[tuple[float, int]]] = {"stop": [], "spread": [], "edge": []}
    spoilt, rates_hz = saturated_turns(session, settle_s), [record.sample_rate_hz for record in session.records]
    for k, turn in enumerate(session.turns):
        rate = np.abs(_smooth_rate(session, stills, turn, settle_s, rates_hz[turn.recording]))
        if not len(rate) or k in spoilt:
            continue
        level = float(np.quantile(rate, 0.9))
        if turn.angle is not None:
            shares["edge"].append((float(rate[[0, -1]].max()) / level, k))
            continue
        stopped, least = rate < _STOPPED * level, _STOP_S * rates_hz[turn.recording]
        stops = sum(stop - start for start, stop in runs(stopped) if stop - start >= least)
        shares["stop"].append((float(stops) / len(rate), k))
        shares["spread"].append((float(rate[~stopped].std() / rate[~stopped].mean()), k))
    limits = {"stop": _STOP_LIMITS, "spread": _SPREAD_LIMITS, "edge": _CUT_LIMITS}
    for kind, found in shares.items():
        over = [one for one in found if one[0] > limits[kind][0]]
        if over:
            share, k = max(over)
            named = piece_name(session, session.turns[k], k, what="turn")
            shown = {f"{kind}_percent": 100.0 * share, "limit_percent": 100.0 * limits[kind][0]}
            yield finding(
                {"stop": "turn.stop", "spread": "turn.unsteady", "edge": "turn.cut"}[kind],
                level_of(share, limits[kind]),
                turn=named,
                turns=len(over),
                **shown,
            )


def settling(length: int, settle_s: float, rate_hz: float) -> int:
    """Return how many samples at the start of a dwell of so many samples are left out: half of it at most."""
    return min(round(settle_s * rate_hz), length // 2)


def saturated_turns(session: Session, settle_s: float) -> tuple[int, ...]:
    """Return the numbers of the stated turns in which a gyroscope sticks at the end of its range."""
    spoilt, rates_hz = [], [record.sample_rate_hz for record in session.records]
    for k, turn in enumerate(session.turns):
        record = session.records[turn.recording]
        if record.gyro is not None:
            steady = turn.turn_rate is not None
            start = turn.start + (settling(turn.stop - turn.start, settle_s, rates_hz[turn.recording]) if steady else 0)
            part = record.gyro[start : turn.stop]
            if stuck_at_rate(part) if steady else stuck_in_motion([part]):
                spoilt.append(k)
    return tuple(spoilt)


def _smooth_rate(
    session: Session, stills: tuple[Still, ...], turn: Turn, settle_s: float, rate_hz: float
) -> FloatArray:
    """Return r (N,) of a turn, raw unit; none where it has no axis, rate or reading, or is near the noise."""
    record = session.records[turn.recording]
    if record.gyro is None or turn.axis is None or not (turn.turn_rate or turn.angle):
        return np.empty(0)
    column = record.gyro[:, AXES.index(turn.axis)]
    rests = [column[s.start : s.stop] for s in stills if s.recording == turn.recording]
    alike = [t for t in session.turns if (t.recording, t.axis) == (turn.recording, turn.axis)]
    rates = np.array([t.turn_rate or 0.0 for t in alike])
    if not rests and not np.ptp(rates):
        return np.empty(0)  # nothing shows the offset
    means = np.array([np.nanmean(values) for values in rests or [column[t.start : t.stop] for t in alike]])
    offset = float(means.mean() if rests else np.polynomial.Polynomial.fit(rates, means, 1)(0.0))
    skip = 0 if turn.turn_rate is None else settling(turn.stop - turn.start, settle_s, rate_hz)
    width, values = max(1, round(_SMOOTH_S * rate_hz)), column[turn.start + skip : turn.stop] - offset
    if len(values) < 2 * width or np.isnan(values).any():
        return np.empty(0)
    rate = np.convolve(values, np.full(width, 1.0 / width), mode="valid")
    noise = float(np.diff(values).std()) / np.sqrt(2.0 * width)
    return rate if np.quantile(np.abs(rate), 0.9) > _NOISES * noise else np.empty(0)


def piece_name(session: Session, piece: Still | Turn, number: int, *, what: str = "still", stated: bool = True) -> str:
    """Return how to call a still or turn."""
    time = session.records[piece.recording].time
    span = f"{time[piece.start]:.1f}-{time[piece.stop - 1]:.1f} s"
    name = f"[[{what}]] {number + 1}" if stated else f"{what} found"
    return f"{name} (recording {piece.recording}, {span})"


def _same(one: Record, two: Record) -> bool:
    if len(one) != len(two):
        return False
    pairs = ((one.gyro, two.gyro), (one.accel, two.accel))
    alike = all(a is b if a is None or b is None else np.array_equal(a, b, equal_nan=True) for a, b in pairs)
    return alike and any(a is not None and float(np.nanstd(a)) > 0.0 for a, _ in pairs)


def _sways(session: Session, stills: tuple[Still, ...], rate: bool) -> _Figure:
    spreads = np.array([_spread(session.records[s.recording], s, rate) for s in stills])
    seen, unit, limit = spreads[np.isfinite(spreads)], _unit(session, rate), np.inf
    if is_physical(unit):
        limit = (segments.BENCH_RATE_LIMIT if rate else segments.BENCH_ACCEL_LIMIT) / si_factor(
            unit, "rate" if rate else "accel"
        )
    elif len(seen) > 2:
        limit = max(_OTHERS * float(np.median(seen)), 1e-300)
        if (seen > limit).any():  # a reading at rest may toggle between two codes
            limit = max(limit, float(np.nan_to_num(code_steps(session.records, rate=rate)).max()))
    return spreads, limit, unit


def _tilts(session: Session, stills: tuple[Still, ...]) -> _Figure:
    zero: FloatArray = np.zeros(3)
    limit = _TILT_LIMIT_DEG
    if not is_physical(_unit(session, False)):  # counts: about the centre of the sphere, where rests enough show it
        means = np.array([mean_reading(session.records[s.recording].accel, s.start, s.stop) for s in stills])
        if len(means) < 6 or not np.isfinite(means).all():
            return np.zeros(0), limit, "deg"
        zero, radius = segments.sphere_of(means)
        limit += 2.0 * float(np.nan_to_num(code_steps(session.records, rate=False)).max()) / radius / RADIAN_PER_DEGREE
    tilts = []
    for still in stills:
        accel, third = session.records[still.recording].accel, (still.stop - still.start) // 3
        first, last = (mean_reading(accel, start, start + third) - zero for start in (still.start, still.stop - third))
        tilts.append(float(np.arctan2(np.linalg.norm(np.cross(first, last)), first @ last)) / RADIAN_PER_DEGREE)
    return np.array(tilts), limit, "deg"


def _rates(session: Session, stills: tuple[Still, ...]) -> _Figure:
    unit = _unit(session, True)
    if len(stills) < 3 or not is_physical(unit) or session.kind == "thermal" or _warmed(session, stills):
        return np.zeros(0), np.inf, unit
    means = np.array([mean_reading(session.records[s.recording].gyro, s.start, s.stop) for s in stills])
    if not np.isfinite(means).any():
        return np.zeros(0), np.inf, unit
    off = np.linalg.norm(means - np.nanmedian(means, axis=0), axis=1)
    return off, segments.BENCH_RATE_LIMIT / si_factor(unit, "rate"), unit


def _warmed(session: Session, stills: tuple[Still, ...]) -> bool:
    temps = piece_temperatures(session, stills)
    known = temps[np.isfinite(temps)]
    return len(known) > 1 and float(np.ptp(known)) > _WARM


def whole_readings(values: FloatArray | None, start: int, stop: int) -> FloatArray:
    """Return the readings (n, 3) of a stretch of a triad, gaps left out; none of a triad that is not there."""
    part = np.zeros((0, 3)) if values is None else values[start:stop]
    return part[~np.isnan(part).any(axis=1)]


def mean_reading(values: FloatArray | None, start: int, stop: int) -> FloatArray:
    """Return their mean (3,), NaN where there are none."""
    part = whole_readings(values, start, stop)
    return np.asarray(part.mean(axis=0)) if len(part) else np.full(3, np.nan)


def _spread(record: Record, still: Still, rate: bool) -> float:
    values = record.gyro if rate else record.accel
    smooth = max(1, round(0.1 * record.sample_rate_hz))
    window = min(segments.sample_count(1.0, record.sample_rate_hz), still.stop - still.start - smooth + 1)
    if values is None or window < 2:
        return float("nan")
    spread = segments.sliding_moments(values[still.start : still.stop], window, smooth)[1]
    return float(spread.max(where=np.isfinite(spread), initial=-np.inf)) if np.isfinite(spread).any() else float("nan")


def _unit(session: Session, rate: bool) -> str:
    return session.records[0].gyro_unit if rate else session.records[0].accel_unit


# ---- mean rate over several rests and its variance
#
#     m = sum w_p m_p / sum w_p        w_p = 1 / (v_p + s2)
#     var m = sum share_p^2 (v_p + k s2),   share_p = w_p / sum w_p
#
# v_p is the variance of the mean of rest p, from block means within the rests; blocks of half a second show what samples one
# by one do not (flicker, a filter), blocks of an eighth of a rest show slow drift. s2 is the scatter between rests beyond that
# (Paule and Mandel): each switch-on has an offset of its own. Few rests know their own scatter badly, so that s2 counts k times,
# k = (t / z)^2 with t and z the 97.5 % points of Student's distribution, for one rest less than there are, and of the normal.
# Where offsets creep with temperature (calibration/creep.py), m_p - m = c_p z + noise with z ~ N(0, 1): the shares are those of
# V = diag(v + s2) + c c', and s2 is the scatter about the most likely c z.

_LONG_BLOCKS = 8  # of one rest
_ROUNDS = 50


def mean_of_rests(
    windows: Sequence[FloatArray], sizes: Sequence[int], creep: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the mean reading over rests and its variance: windows (N, 3), block sizes, c (P,) -> (3,), (3,)."""
    means = np.array([w.mean(axis=0) for w in windows])
    variances = np.array([w.var(axis=0) / max(1, len(w) - 1) for w in windows])
    long = [max(size, len(w) // _LONG_BLOCKS) for w, size in zip(windows, sizes, strict=True)]
    for lengths in (sizes, long):
        noise = noise_of_means(windows, lengths)
        if noise is not None:
            variances = np.maximum(variances, noise**2)
    c = np.zeros(len(means)) if creep is None else creep
    if len(means) == 1:
        return means[0], variances[0] + c[0] ** 2
    factor, mean, variance = student_factor(len(means) - 1), np.zeros(3), np.zeros(3)
    for axis in range(3):
        value, within = means[:, axis], variances[:, axis]
        excess, middle, spent = 0.0, float(value.mean()), 0.0
        moved: FloatArray = np.zeros(len(value))
        for _ in range(_ROUNDS):
            before, excess = excess, excess_variance(value - middle - moved, within, len(value) - 1 - spent)
            total = within + excess
            known = (total > 0.0).all()
            weight = 1.0 / total if known else np.ones(len(value))
            seen = float(weight @ c**2) if known else np.inf
            spent = seen / (1.0 + seen) if np.isfinite(seen) else float(c.any())
            slope = weight * c / (weight @ c**2) if c.any() else c
            share = weight - spent * slope * float(weight @ c)  # V^-1 1
            share /= share.sum()
            middle = float(share @ value)
            moved = spent * float(slope @ (value - middle)) * c
            if abs(excess - before) <= 1e-6 * excess:
                break
        mean[axis], variance[axis] = middle, float(share**2 @ (within + factor * excess)) + float(share @ c) ** 2
    return mean, variance


# ---- one temperature

APART_C = 3.0
ROOM_C = 25.0


def at_one_temperature(session: Session) -> tuple[Session, tuple[Finding, ...]]:
    """Return a session with the stated pieces of one temperature.

    Where stills and turns fall into groups more than 3 K apart, the group nearest to 25 degC is used, of those that hold at least
    half as many pieces as the largest. Faces that it lacks come from the group with most faces, nearest to it: creep.py states
    what their temperature adds.
    """
    temps = piece_temperatures(session, (*session.stills, *session.turns))
    if len(temps) < 2 or np.isnan(temps).any() or np.ptp(temps) <= APART_C:
        return session, ()
    order = np.argsort(temps)
    group = np.empty(len(temps), dtype=np.int64)
    group[order] = np.concatenate(([0], np.cumsum(np.diff(temps[order]) > APART_C)))  # a new number after each gap
    counts = np.bincount(group)
    if len(counts) == 1:
        return session, ()
    means = np.bincount(group, temps) / counts
    able = np.flatnonzero(2 * counts >= counts.max())
    chosen = int(able[np.argmin(np.abs(means[able] - ROOM_C))])
    used = group == chosen
    faces = [still.face for still in session.stills]
    counted = [len({f for f, k in zip(faces, group, strict=False) if k == g} - {None}) for g in range(len(counts))]
    if counted[chosen] < max(counted):
        nearest = min(range(len(counts)), key=lambda k: (-counted[k], abs(means[k] - means[chosen])))
        used |= (group == nearest) & np.array([*(face is not None for face in faces), *(False for _ in session.turns)])
    stills = tuple(s for s, keep in zip(session.stills, used[: len(session.stills)], strict=True) if keep)
    turns = tuple(t for t, keep in zip(session.turns, used[len(session.stills) :], strict=True) if keep)
    visited = finding(
        "session.temperatures",
        "warn",
        groups=len(counts),
        least_temp_c=means.min(),
        most_temp_c=means.max(),
        pieces=int(used.sum()),
        temp_c=temps[used].mean(),
    )
    return replace(session, stills=stills, turns=turns), (visited,)


def piece_temperatures(session: Session, pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return the temperature of each still or turn, as stated or as recorded; NaN where there is none."""
    temps = []
    for piece in pieces:
        column = session.records[piece.recording].temp_c
        part = np.full(1, np.nan) if column is None else column[piece.start : piece.stop]
        seen = float(np.nanmean(part)) if np.isfinite(part).any() else float("nan")
        temps.append(seen if piece.temp_c is None else piece.temp_c)
    return np.array(temps)


def spans_of(records: Sequence[Record], pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return start and stop of each stretch (P, 2), s, on one clock on which the recordings follow each other."""
    begins = np.concatenate(([0.0], np.cumsum([record.duration_s for record in records])))
    clocks = [begin + record.time - record.time[0] for begin, record in zip(begins[:-1], records, strict=True)]
    ends = [clocks[piece.recording][[piece.start, piece.stop - 1]] for piece in pieces]
    return np.array(ends).reshape(-1, 2)


def middles(records: Sequence[Record], pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return the middle of each stretch (P,), s, on that clock."""
    return np.asarray(spans_of(records, pieces).mean(axis=1))


# ---- what a session shows

_FULL_TURN = 2.0 * np.pi  # rad
_NEAR_FULL = 0.1  # a turn this near a whole number, relative, counts as whole
_FREE = 0.1  # largest share of free poses among rests on faces
_SAME_POSE = 0.26  # of gravity: 15 deg
_FEW = 9  # stills: with fewer, pauses that were too short are reported


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observed:
    """A session with its stills, stated or found."""

    session: Session
    settings: CalibrateSettings
    stills: tuple[Still, ...]  # Stated in the session, else found; found ones carry a face where gravity shows one
    found: bool  # True where they were found
    findings: tuple[Finding, ...] = ()
    searches: tuple[segments.StillSearch, ...] = ()  # One for each recording where they were found
    _turns: dict[int, segments.TurnSearch] = field(default_factory=dict)  # Of a recording, once it was asked for

    @property
    def adapted(self) -> bool:
        """Whether another window or threshold than the usual found them: a fit must not search with the usual ones."""
        return any(replace(search.settings, adapt=False) != segments.StillSettings() for search in self.searches)

    @property
    def faced(self) -> tuple[Still, ...]:
        """Stills with a face."""
        return tuple(s for s in self.stills if s.face is not None)

    def rest_means(self) -> FloatArray:
        """Return the mean rate reading of each still, shape (P, 3)."""
        own = [(r.gyro, [s for s in self.stills if s.recording == k]) for k, r in enumerate(self.session.records)]
        return np.concatenate([segments.still_means(gyro, stills) for gyro, stills in own if gyro is not None])

    def rest_rate(self, creep: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the mean rate reading over all rests and its variance, (3,) each; creep (P,) of each rest, unit of the reading."""
        windows, sizes, rows = [], [], []
        for row, still in enumerate(self.stills):
            record = self.session.records[still.recording]
            window = whole_readings(record.gyro, still.start, still.stop)
            if len(window):
                windows.append(window)
                sizes.append(block_size(record.sample_rate_hz))
                rows.append(row)
        if not windows:
            return np.full(3, np.nan), np.full(3, np.nan)
        mean, variance = mean_of_rests(windows, sizes, None if creep is None else creep[rows])
        # All rests lie at one place between two codes
        scatter = np.mean([window.var(axis=0) for window in windows], axis=0)
        return mean, variance + code_variance(code_steps(self.session.records, rate=True), scatter)

    def mean_temperature(self) -> float:
        """Return the mean temperature over stills and turns."""
        values = piece_temperatures(self.session, (*self.stills, *self.session.turns))
        return float(np.mean(values[np.isfinite(values)])) if np.isfinite(values).any() else float("nan")

    def full_turns(self) -> tuple[Turn, ...]:
        """Return three full turns about x, y and z found between rests, with their angles."""
        full: list[Turn] = []
        for _, record, search in self.turn_searches():
            if not is_physical(record.gyro_unit):
                continue
            angles = search.rotation_angle * si_factor(record.gyro_unit, "rate")
            for turn, angle in zip(search.rotations, angles, strict=True):
                along = float(angle[np.argmax(np.abs(angle))])
                whole = round(along / _FULL_TURN)
                if turn.axis is not None and whole and abs(along - whole * _FULL_TURN) < _NEAR_FULL * abs(along):
                    full.append(replace(turn, angle=whole * _FULL_TURN))
        one_each = len(full) == 3 and {t.axis for t in full} == {"x", "y", "z"}
        return tuple(full) if one_each else ()

    def turns_of(self, angle: float) -> tuple[Turn, ...]:
        """Return the turns between rests by a known angle, rad; their sign and axis as the gyroscope reads them.

        In physical units their angle is near the known one; in counts a full turn brings the device back to its pose.
        """
        turned: list[tuple[Turn, float]] = []
        tolerance, whole = SCALE_TOLERANCE, abs(angle / _FULL_TURN - round(angle / _FULL_TURN)) < 1e-6
        for _, record, search in self.turn_searches():
            physical = is_physical(record.gyro_unit)
            factor = si_factor(record.gyro_unit, "rate") if physical else 1.0
            for turn, read in zip(search.rotations, search.rotation_angle, strict=True):
                along = float(read[np.argmax(np.abs(read))]) * factor
                returns = self._returns(turn)  # a move between faces, read twice as large, is none
                near = abs(abs(along) - angle) < tolerance * angle and (returns is not False or not whole)
                near = near if physical else whole and returns is True
                if turn.axis is not None and near:
                    turned.append((replace(turn, angle=float(np.copysign(angle, along))), abs(along)))
        most = max((size for _, size in turned), default=0.0)
        return tuple(turn for turn, size in turned if size * (1.0 + tolerance) > most * (1.0 - tolerance))

    def _returns(self, turn: Turn) -> bool | None:
        """Tell whether gravity reads the same before a turn and after it, within about 15 deg; None where that is unknown."""
        accel = self.session.records[turn.recording].accel
        own = [s for s in self.stills if s.recording == turn.recording]
        if accel is None or len(own) < 5:
            return None
        before, after = (s for s in own if turn.start == s.stop or turn.stop == s.start)
        moved = np.diff(segments.still_means(accel, (before, after)), axis=0)
        return bool(np.linalg.norm(moved) < _SAME_POSE * segments.sphere_of(segments.still_means(accel, own))[1])

    def with_turns(self) -> "Observed":
        """Return it with its turns by the known angle, where they are found about x, y and z; else the finding that says so."""
        angle_deg = self.settings.turn_angle_deg
        if angle_deg is None or self.session.turns:
            return self
        turns = self.turns_of(angle_deg * RADIAN_PER_DEGREE)
        lacking = tuple(axis for axis in ("x", "y", "z") if axis not in {turn.axis for turn in turns})
        if lacking:
            self._check_rate_unit(angle_deg)
            why = self._why_missing(angle_deg)
            missing = finding(
                "session.turns_missing", "warn", angle_deg=angle_deg, axes=lacking, count=len(turns), why=why
            )
            return replace(self, findings=(*self.findings, missing))
        shown = tuple(f"{turn.axis} {'+' if (turn.angle or 0.0) > 0.0 else '-'}" for turn in turns)
        found = finding("session.turns_found", "info", angle_deg=angle_deg, count=len(turns), turns=shown)
        return replace(self, session=replace(self.session, turns=turns), findings=(*self.findings, found))

    def _check_rate_unit(self, angle_deg: float) -> None:
        """Raise if turns back to the same pose read the multiple of the angle that a mistaken unit gives."""
        for number, record, search in self.turn_searches():
            ratio = self._reading_ratio(record, search, angle_deg)
            if cause := rate_unit_words(ratio):
                raise Implausible(
                    f"gyroscope: recording {number} is declared in {record.gyro_unit}, but its turns by {angle_deg:g} deg read "
                    f"{ratio:.3g} times that angle: {cause}. Correct the unit of the gyroscope columns.",
                    ratio=ratio,
                )

    def _reading_ratio(self, record: Record, search: segments.TurnSearch, angle_deg: float) -> float:
        """Return the median of what turns back to the same pose read over their angle; NaN without such turns or in counts."""
        unit = si_factor(record.gyro_unit, "rate") if is_physical(record.gyro_unit) else np.nan
        read = [
            float(np.abs(angle).max()) * unit / RADIAN_PER_DEGREE / angle_deg
            for turn, angle in zip(search.rotations, search.rotation_angle, strict=True)
            if self._returns(turn)
        ]
        return float(np.median(read)) if read else np.nan

    def _why_missing(self, angle_deg: float) -> str:
        """Return why turns by a known angle may be missing: the recording ends in one, or they read a multiple of it."""
        for number, record, search in self.turn_searches():
            gyro = np.asarray(record.gyro)
            last = np.linalg.norm(gyro[-round(_END_S * record.sample_rate_hz) :], axis=1)
            if search.rotations and last.min() > _CUT_LIMITS[1] * np.linalg.norm(gyro, axis=1).max():
                return f"; recording {number} still turns at its end: its last turn is cut off"
            ratio = self._reading_ratio(record, search, angle_deg)
            if abs(ratio - 1.0) > SCALE_TOLERANCE:
                rate_hz = record.sample_rate_hz
                return (
                    f"; turns back to the same pose read {ratio:.3g} times that angle: the angle, the unit or range of the "
                    f"gyroscope or the sample rate is another ({rate_hz:.3g} samples a second stated, not {ratio * rate_hz:.3g})"
                )
        return ""

    def without_saturated_turns(self) -> tuple["Observed", tuple[Finding, ...]]:
        """Return it without the turns in which a gyroscope sticks at the end of its range, and the finding that names them."""
        session, numbers = self.session, saturated_turns(self.session, self.settings.settle_s)
        if not numbers:
            return self, ()
        names = tuple(piece_name(session, session.turns[k], k, what="turn") for k in numbers)
        sound = tuple(turn for k, turn in enumerate(session.turns) if k not in numbers)
        left = finding("gyro.saturated", "warn", what="turns", count=len(numbers), of=len(session.turns), pieces=names)
        return replace(self, session=replace(session, turns=sound)), (left,)

    @property
    def mostly_faces(self) -> bool:
        """True where rests lie on all six faces and few of them elsewhere."""
        free = len(self.stills) - len(self.faced)
        return {still.face for still in self.faced} == set(FACES) and free <= _FREE * len(self.stills)

    def plateaus(self) -> tuple[Turn, ...]:
        """Return the steady turns that the recordings hold."""
        return tuple(turn for _, _, search in self.turn_searches() for turn in search.plateaus)

    def turn_searches(self) -> Iterator[tuple[int, Record, segments.TurnSearch]]:
        """Yield the number of each recording with gyroscopes, the recording, and the turns found in it, searched once."""
        for number, record in enumerate(self.session.records):
            if record.gyro is not None:
                if number not in self._turns:
                    self._turns[number] = segments.find_turns(record, [s for s in self.stills if s.recording == number])
                yield number, record, self._turns[number]


def look(session: Session, settings: CalibrateSettings) -> Observed:
    """Take a session's stills as stated, or find and label them; nothing is checked."""
    session, searches = in_one_unit(session), tuple[segments.StillSearch, ...]()
    if not session.stills:
        searches = segments.find_poses(session.records, settings.still)
    stills = session.stills or labelled(session, tuple(still for search in searches for still in search.stills))
    return Observed(session=session, settings=settings, stills=stills, found=not session.stills, searches=searches)


def observe(session: Session, settings: CalibrateSettings) -> Observed:
    """Take a session's stills as stated, or find and label them, and check that they are such."""
    check_counted_once(in_one_unit(session))
    seen = look(session, settings)
    session, stills = seen.session, seen.stills
    findings = [
        finding("session.no_still", "warn", recording=number, reason=search.reason)
        for number, search in enumerate(seen.searches)
        if not search.stills
    ]
    if seen.found and len(stills) < _FEW and len({s.face for s in stills} - {None}) < len(FACES):
        findings += _pauses_left_out(session, seen.searches)
    for number, record in enumerate(session.records):
        own = [s for s in stills if s.recording == number]
        if own and record.accel is not None and is_physical(record.accel_unit):
            check_gravity(
                segments.still_means(record.accel, own) * si_factor(record.accel_unit, "accel"), session.gravity_m_s2
            )
    findings += check_stills(session, stills, stated=not seen.found)
    findings += check_turns(session, stills, settings.settle_s)
    return replace(seen, findings=tuple(findings)).with_turns()


def in_one_unit(session: Session) -> Session:
    """Return the session with each triad in one unit: that of the first recording that has the triad."""
    gyro, accel = (_common_unit(session, rate=rate) for rate in (True, False))
    records = tuple(
        r
        if (r.gyro_unit, r.accel_unit) == (gyro, accel)
        else replace(r.in_units(gyro, accel), gyro_unit=gyro, accel_unit=accel)
        for r in session.records
    )
    return replace(session, records=records)


def _common_unit(session: Session, *, rate: bool) -> str:
    units = [
        (number, record.gyro_unit if rate else record.accel_unit)
        for number, record in enumerate(session.records)
        if (record.gyro if rate else record.accel) is not None
    ]
    first, unit = units[0] if units else (0, _unit(session, rate))
    for number, other in units:
        if other != unit and not (is_physical(other) and is_physical(unit)):
            raise InputError(
                f"recording {number}: wanted {'gyro' if rate else 'accel'} readings in {unit} as in recording {first}, got "
                f"{other}; they cannot be compared: give all recordings one unit, or the scale of the columns"
            )
    return unit


def _pauses_left_out(session: Session, searches: Sequence[segments.StillSearch]) -> list[Finding]:
    """Report pauses that were too short or too restless for a still."""
    findings = []
    for number, (record, search) in enumerate(zip(session.records, searches, strict=True)):
        if not search.stills:  # nothing shows what this device's rest looks like; the search has given the reason
            continue
        least = search.settings.window_s + search.settings.min_duration_s
        short = len(segments.short_pauses(record, search, search.settings))
        if short >= 3:
            findings.append(finding("session.short_pauses", "warn", recording=number, pauses=short, least_s=least))
        restless = [one for one in segments.left_out(record, search) if one.why == "too restless"]
        if restless:
            quietest = min(restless, key=lambda one: one.value / one.limit)
            numbers = {
                "pauses": len(restless),
                "spread": quietest.value,
                "unit": quietest.unit,
                "limit": quietest.limit,
            }
            findings.append(finding("session.restless_pauses", "warn", recording=number, **numbers))
    return findings


def labelled(session: Session, stills: tuple[Still, ...]) -> tuple[Still, ...]:
    """Return stills with the face that points up, where gravity shows one."""
    unit = session.records[0].accel_unit
    if any(r.accel is None or r.accel_unit != unit for r in session.records):
        return stills
    if not stills or (not is_physical(unit) and len(stills) < 5):
        return stills  # counts have no known zero, unless poses share a sphere
    means = [segments.still_means(np.asarray(session.records[still.recording].accel), [still])[0] for still in stills]
    faces = segments.faces_of(np.array(means), centred=is_physical(unit))
    return tuple(replace(still, face=face) for still, face in zip(stills, faces, strict=True))


# ---- what a fit of one triad returns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """One triad's fit, the method that gave it, and findings beyond those of the fit; without a fit, why there is none."""

    fit: TriadFit | None = None
    method: str = "none"
    findings: tuple[Finding, ...] = ()
    used: tuple[Still, ...] = ()  # stills behind the fit, for an accelerometer

    def after(self, *findings: Finding) -> "Outcome":
        """Return the same outcome with findings put before its own."""
        return replace(self, findings=(*findings, *self.findings))


def with_offset(fit: TriadFit, offset: FloatArray, variance: FloatArray) -> TriadFit:
    """Return a fit to readings without their offset for the readings themselves: offset and variance (3,), their unit."""
    covariance = np.array(fit.model.covariance)
    covariance[9:12, 9:12] = np.diag(variance)
    return TriadFit(
        model=replace(fit.model, offset=offset, covariance=covariance, budget=None),
        residuals=fit.residuals,
        verdict=fit.verdict.also(Verdict.of(finding("paper_mode.offset_removed", "info"))),
    )
