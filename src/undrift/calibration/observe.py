"""Observed: what a session shows before anything is fitted: rests, faces, turns, temperature.

Stillness: does the device rest where a session says so, and is no stretch counted twice?

Three figures of each still, whatever the offset of its sensors::

    spread    largest standard deviation of the readings, smoothed over 0.1 s, in a window of 1 s; three axes together
    tilting   angle between the mean specific force of its first and of its last third
    rate      mean rate reading less its median over all stills: a slow turn that no window sees

Each has a limit that a bench keeps. Over the limit the still is named and makes the verdict marginal; over three times the limit
the session is refused. Readings in counts have no bench limit: there a still is held against the other stills.

Mean rate at rest over several rests, and what it is worth.

::

    m = sum w_p m_p / sum w_p        w_p = 1 / (v_p + s2)
    var m = sum share_p^2 (v_p + k s2),   share_p = w_p / sum w_p

v_p is the variance of the mean of rest p, told by block means within the rests; blocks of half a second see what samples one
by one do not (flicker, a filter), blocks of an eighth of a rest see what wanders over the whole of it. s2 is the scatter
between rests beyond that (Paule and Mandel, ``fit/least_squares.py``): each switch-on has an offset of its own, and it drifts. Few
rests know their own scatter badly, so that s2 counts k times, k = (t / z)^2 with t and z the 97.5 % points of Student's
distribution, for one rest less than there are, and of the normal.

One temperature: of a session that visits several set-points, the pieces at one of them.

A constant matrix and offset hold at one temperature. Where the stated stills and turns fall into groups of temperature more than
3 K apart, the group nearest to 25 degC serves, of those that hold at least half as many pieces as the largest; the others are for
the drift tables.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, pairwise

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.checks import check_gravity
from undrift.errors import Implausible, InputError
from undrift.fit.least_squares import block_size, excess_variance, noise_of_means
from undrift.record import FACES, Record, Session, Still, Turn
from undrift.segments import (
    BENCH_ACCEL_LIMIT,
    BENCH_RATE_LIMIT,
    StillSettings,
    faces_of,
    find_still,
    find_turns,
    sample_count,
    sliding_moments,
    still_means,
)
from undrift.units import RADIAN_PER_DEGREE, Quantity, is_physical, si_factor

# ---- Stillness: does the device rest where a session says so, and is no stretch counted twice?

_TILTING_LIMIT = 0.5 * RADIAN_PER_DEGREE  # a device that settles on a bench or a cushion stays below it
_FAR = 3.0  # limits: no rest at all
_OTHERS = 10.0  # a still in counts may spread this many times the median of all stills
_SHARED = 0.1  # of the shorter of two stretches: more than this is counting twice
_WARM = 10.0  # K between stills: offsets may then differ


@dataclass(frozen=True, slots=True, kw_only=True)
class _Finding:
    """How far a still is over a limit, as a multiple of it, and what it does."""

    still: int
    excess: float
    does: str
    remedy: str = "shorten it to the part at rest, or leave it out"


def check_stills(session: Session, stills: tuple[Still, ...], *, stated: bool) -> tuple[str, ...]:
    """Hold every still against what a device at rest does."""
    groups = [_rate_findings(session, stills, stated=stated)]
    if stated:
        groups += [_spread_findings(session, stills), _tilting_findings(session, stills)]
    worst = [max(group, key=lambda finding: finding.excess) for group in groups if group]
    for finding in sorted(worst, key=lambda finding: -finding.excess):
        if finding.excess > _FAR:
            where = piece_name(session, stills[finding.still], finding.still, stated=stated)
            raise Implausible(
                f"{where}: wanted a device at rest, got {finding.does}; {finding.remedy}", still=finding.still
            )
    said: list[str] = []
    for group in filter(None, groups):
        finding = max(group, key=lambda finding: finding.excess)
        where = piece_name(session, stills[finding.still], finding.still, stated=stated)
        others = f", and {len(group) - 1} more likewise" if len(group) > 1 else ""
        said.append(f"{where} is not quite still: {finding.does}{others}; {finding.remedy}")
    return tuple(said)


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
    if any((a is None) != (b is None) for a, b in pairs):
        return False
    return all(a is None or b is None or np.array_equal(a, b, equal_nan=True) for a, b in pairs) and any(
        a is not None and float(np.nanstd(a)) > 0.0 for a, _ in pairs
    )


def _spread_findings(session: Session, stills: tuple[Still, ...]) -> list[_Finding]:
    findings: list[_Finding] = []
    for rate in (True, False):
        spreads = np.array([_spread(session.records[s.recording], s, rate) for s in stills])
        seen = np.isfinite(spreads)
        if not seen.any():
            continue
        unit = _unit(session, rate)
        if is_physical(unit):
            limit = (BENCH_RATE_LIMIT if rate else BENCH_ACCEL_LIMIT) / si_factor(unit, "rate" if rate else "accel")
        elif seen.sum() > 2:
            limit = _OTHERS * float(np.median(spreads[seen]))
        else:
            continue
        for number in np.flatnonzero(seen & (spreads > limit)):
            does = f"readings that sway by up to {_told(spreads[number], unit)} rms"
            findings.append(_Finding(still=int(number), excess=float(spreads[number]) / max(limit, 1e-300), does=does))
    return findings


def _tilting_findings(session: Session, stills: tuple[Still, ...]) -> list[_Finding]:
    if not is_physical(_unit(session, False)):
        return []
    findings: list[_Finding] = []
    for number, still in enumerate(stills):
        accel = session.records[still.recording].accel
        third = (still.stop - still.start) // 3
        if accel is None or not third:
            continue
        ends = [accel[still.start : still.start + third], accel[still.stop - third : still.stop]]
        ends = [end[~np.isnan(end).any(axis=1)] for end in ends]
        if not all(len(end) for end in ends):
            continue
        first, last = (end.mean(axis=0) for end in ends)
        angle = float(np.arctan2(np.linalg.norm(np.cross(first, last)), first @ last))
        if angle > _TILTING_LIMIT:
            does = f"a tilt of {angle / RADIAN_PER_DEGREE:.2f} deg from its first to its last third"
            findings.append(_Finding(still=number, excess=angle / _TILTING_LIMIT, does=does))
    return findings


def _rate_findings(session: Session, stills: tuple[Still, ...], *, stated: bool) -> list[_Finding]:
    unit = _unit(session, True)
    if len(stills) < 3 or not is_physical(unit) or session.kind == "thermal" or _warmed(session, stills):
        return []
    means = np.array([_mean(session.records[s.recording].gyro, s) for s in stills])
    if not np.isfinite(means).any():
        return []
    off = np.linalg.norm(means - np.nanmedian(means, axis=0), axis=1)
    limit = BENCH_RATE_LIMIT / si_factor(unit, "rate")
    # Stills that were found in one recording may drift with its warming; whole recordings apart have different units.
    most = np.inf if stated or len(session.records) > 1 else _FAR
    return [
        _Finding(
            still=int(number),
            excess=min(float(off[number]) / limit, most),
            does=f"a mean rate {_told(off[number], unit)} off that of the other stills",
            remedy="it turns slowly, its unit is not theirs, or the offset drifts: check, and warm the device up before recording",
        )
        for number in np.flatnonzero(off > limit)
    ]


def _warmed(session: Session, stills: tuple[Still, ...]) -> bool:
    values: list[float] = []
    for still in stills:
        temp_c = session.records[still.recording].temp_c
        if still.temp_c is not None:
            values.append(still.temp_c)
        elif temp_c is not None and np.isfinite(temp_c[still.start : still.stop]).any():
            values.append(float(np.nanmean(temp_c[still.start : still.stop])))
    return len(values) > 1 and max(values) - min(values) > _WARM


def _mean(values: FloatArray | None, still: Still) -> FloatArray:
    part = np.zeros((0, 3)) if values is None else values[still.start : still.stop]
    part = part[~np.isnan(part).any(axis=1)]
    return np.asarray(part.mean(axis=0)) if len(part) else np.full(3, np.nan)


def _spread(record: Record, still: Still, rate: bool) -> float:
    values = record.gyro if rate else record.accel
    if values is None:
        return float("nan")
    values = values[still.start : still.stop]
    smooth = max(1, round(0.1 * record.sample_rate_hz))
    window = min(sample_count(1.0, record.sample_rate_hz), len(values) - smooth + 1)
    if window < 2:
        return float("nan")
    spread = sliding_moments(values, window, smooth)[1]
    spread = spread[np.isfinite(spread)]
    return float(spread.max()) if len(spread) else float("nan")


def _unit(session: Session, rate: bool) -> str:
    return session.records[0].gyro_unit if rate else session.records[0].accel_unit


def _told(value: float, unit: str) -> str:
    if unit == "rad/s":
        return f"{value / RADIAN_PER_DEGREE:.3g} deg/s"
    return f"{value:.3g} {'deg/s' if unit == 'dps' else unit}"


# ---- Mean rate at rest over several rests, and what it is worth.

_LONG_BLOCKS = 8  # of one rest
_ROUNDS = 50


def mean_of_rests(windows: Sequence[FloatArray], sizes: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Return the mean reading over rests and its variance.

    Arrays: windows (N, 3) -> (3,), (3,).
    """
    return _weighted(np.array([w.mean(axis=0) for w in windows]), _variances(windows, sizes))


def _variances(windows: Sequence[FloatArray], sizes: Sequence[int]) -> FloatArray:
    # Of each rest's mean: by blocks of half a second, or by longer ones where those show more wandering.
    variances = np.array([w.var(axis=0) / max(1, len(w) - 1) for w in windows])
    long = [max(size, len(w) // _LONG_BLOCKS) for w, size in zip(windows, sizes, strict=True)]
    for lengths in (sizes, long):
        noise = noise_of_means(windows, lengths)
        if noise is not None:
            variances = np.maximum(variances, noise**2)
    return variances


def _weighted(means: FloatArray, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
    if len(means) == 1:
        return means[0], variances[0]
    from scipy.stats import norm, t

    factor = float((t.ppf(0.975, len(means) - 1) / norm.ppf(0.975)) ** 2)
    mean, variance = np.zeros(3), np.zeros(3)
    for axis in range(3):
        value, own = means[:, axis], variances[:, axis]
        excess, middle = 0.0, float(value.mean())
        for _ in range(_ROUNDS):
            before, excess = excess, excess_variance(value - middle, own, len(value) - 1)
            total = own + excess
            weight = 1.0 / total if (total > 0.0).all() else np.ones(len(value))
            middle = float(weight @ value / weight.sum())
            if abs(excess - before) <= 1e-6 * excess:
                break
        share = weight / weight.sum()
        mean[axis], variance[axis] = middle, float(share**2 @ (own + factor * excess))
    return mean, variance


# ---- One temperature: of a session that visits several set-points, the pieces at one of them.

APART_C = 3.0
ROOM_C = 25.0


def at_one_temperature(session: Session) -> tuple[Session, tuple[str, ...]]:
    """Return a session with the stated pieces of one temperature."""
    pieces: tuple[Still | Turn, ...] = (*session.stills, *session.turns)
    temps = np.array([piece_temperature(session, piece) for piece in pieces])
    if len(pieces) < 2 or np.isnan(temps).any() or np.ptp(temps) <= APART_C:
        return session, ()
    group = _groups(temps)
    counts = np.bincount(group)
    if len(counts) == 1:
        return session, ()
    means = np.bincount(group, temps) / counts
    able = np.flatnonzero(2 * counts >= counts.max())
    chosen = int(able[np.argmin(np.abs(means[able] - ROOM_C))])
    kept = group == chosen
    stills = tuple(s for s, keep in zip(session.stills, kept[: len(session.stills)], strict=True) if keep)
    turns = tuple(t for t, keep in zip(session.turns, kept[len(session.stills) :], strict=True) if keep)
    said = (
        f"the session visits {len(counts)} temperatures from {means.min():.1f} to {means.max():.1f} degC: its {counts[chosen]} "
        f"stills and turns at {means[chosen]:.1f} degC were used; undrift drift makes tables of all"
    )
    return replace(session, stills=stills, turns=turns), (said,)


def piece_temperature(session: Session, piece: Still | Turn) -> float:
    """Return the temperature of a still or turn."""
    if piece.temp_c is not None:
        return piece.temp_c
    column = session.records[piece.recording].temp_c
    if column is None or not np.isfinite(column[piece.start : piece.stop]).any():
        return float("nan")
    return float(np.nanmean(column[piece.start : piece.stop]))


def _groups(temps: FloatArray) -> IntArray:
    """Number the temperatures from cold to warm, a new number after each gap."""
    order = np.argsort(temps)
    number = np.concatenate(([0], np.cumsum(np.diff(temps[order]) > APART_C)))
    group = np.empty(len(temps), dtype=np.int64)
    group[order] = number
    return group


# ---- observe

_FULL_TURN = 2.0 * np.pi  # rad
_NEAR_FULL = 0.1  # a turn this near a whole number, relative, counts as whole
_FEW = 9  # stills: with fewer, pauses that were too short are worth a word


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrateSettings:
    """Choices that a session file does not make.

    Parameters
    ----------
    still : StillSettings
        How still phases are found where the session states none.
    window_s : float
        Longest stretch of each face that is averaged, s.
    settle_s : float
        Start of each dwell that is thrown away, s.
    latitude_deg : float or None
        For the Earth's rate on a rate table, deg; None leaves it out.
    angle_uncertainty_deg : float
        Standard uncertainty of a turn by a known angle, deg.
    scale_tolerance : float
        How far a scale factor may be from the one the unit states, relative; physical units only.
    remove_offset : bool
        Mode paper has no offset column: take the offset off first, as the note's order of steps does.
    identify_adc : bool
        Look for the step and rounding of the codes.
    """

    still: StillSettings = field(default_factory=StillSettings)
    window_s: float = 6.0
    settle_s: float = 0.3
    latitude_deg: float | None = None
    angle_uncertainty_deg: float = 1.0
    scale_tolerance: float = 0.25
    remove_offset: bool = True
    identify_adc: bool = True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observed:
    """A session with its stills, stated or found."""

    session: Session  # As read
    settings: CalibrateSettings  # Choices
    stills: tuple[Still, ...]  # Stated in the session, else found; found ones carry a face where gravity shows one
    found: bool  # True where they were found
    reasons: tuple[str, ...]  # Why a recording gave none

    @property
    def faced(self) -> tuple[Still, ...]:
        """Stills with a face."""
        return tuple(s for s in self.stills if s.face is not None)

    def rest_means(self) -> FloatArray:
        """Return the mean rate reading of each still, shape (P, 3).

        Arrays:  -> (P, 3).
        """
        means = [
            still_means(record.gyro, [s for s in self.stills if s.recording == number])
            for number, record in enumerate(self.session.records)
            if record.gyro is not None
        ]
        return np.concatenate(means)

    def rest_rate(self) -> tuple[FloatArray, FloatArray]:
        """Return the mean rate reading over all rests and its variance.

        Arrays:  -> (3,), (3,).
        """
        windows, sizes = [], []
        for still in self.stills:
            record = self.session.records[still.recording]
            if record.gyro is not None:
                window = record.gyro[still.start : still.stop]
                window = window[~np.isnan(window).any(axis=1)]
                if len(window):
                    windows.append(window)
                    sizes.append(block_size(record.sample_rate_hz))
        if not windows:
            return np.full(3, np.nan), np.full(3, np.nan)
        return mean_of_rests(windows, sizes)

    def mean_temperature(self) -> float:
        """Return the mean temperature over stills and turns."""
        pieces: tuple[Still | Turn, ...] = (*self.stills, *self.session.turns)
        values = [piece_temperature(self.session, piece) for piece in pieces]
        known = [value for value in values if np.isfinite(value)]
        return float(np.mean(known)) if known else float("nan")

    def full_turns(self) -> tuple[Turn, ...]:
        """Return three full turns about x, y and z found between rests, with their angles."""
        full: list[Turn] = []
        for number, record in enumerate(self.session.records):
            stills = [s for s in self.stills if s.recording == number]
            if record.gyro is None or not is_physical(record.gyro_unit) or len(stills) < 2:
                continue
            search = find_turns(record, stills)
            angles = search.rotation_angle * si_factor(record.gyro_unit, "rate")
            for turn, angle in zip(search.rotations, angles, strict=True):
                along = float(angle[np.argmax(np.abs(angle))])
                whole = round(along / _FULL_TURN)
                if turn.axis is not None and whole and abs(along - whole * _FULL_TURN) < _NEAR_FULL * abs(along):
                    full.append(replace(turn, angle=whole * _FULL_TURN))
        one_each = len(full) == 3 and {t.axis for t in full} == {"x", "y", "z"}
        return tuple(full) if one_each else ()

    def plateaus(self) -> int:
        """Return how many steady turns the recordings hold."""
        return sum(
            len(find_turns(record, [s for s in self.stills if s.recording == number]).plateaus)
            for number, record in enumerate(self.session.records)
            if record.gyro is not None
        )


def observe(session: Session, settings: CalibrateSettings) -> Observed:
    """Take a session's stills as stated, or find and label them."""
    session = in_one_unit(session)
    check_counted_once(session)
    stills = session.stills
    reasons: list[str] = []
    if not stills:
        stills, reasons = _found(session, settings.still)
        stills = _labelled(session, stills)
        if len(stills) < _FEW and len({s.face for s in stills} - {None}) < len(FACES):
            short = [_told_short(session, number, stills, settings.still) for number in range(len(session.records))]
            reasons += filter(None, short)
    for number, record in enumerate(session.records):
        own = [s for s in stills if s.recording == number]
        if own and record.accel is not None and is_physical(record.accel_unit):
            check_gravity(still_means(record.accel, own) * si_factor(record.accel_unit, "accel"), session.gravity_m_s2)
    reasons += check_stills(session, stills, stated=bool(session.stills))
    return Observed(session=session, settings=settings, stills=stills, found=not session.stills, reasons=tuple(reasons))


def in_one_unit(session: Session) -> Session:
    """Return the session with each triad in one unit: that of the first recording that has the triad."""
    quantities: tuple[Quantity, Quantity] = ("rate", "accel")
    wanted = [_common_unit(session, quantity) for quantity in quantities]
    records = tuple(
        replace(r.in_units(wanted[0], wanted[1]), gyro_unit=wanted[0], accel_unit=wanted[1])
        if (r.gyro_unit, r.accel_unit) != (wanted[0], wanted[1])
        else r
        for r in session.records
    )
    return replace(session, records=records)


def _common_unit(session: Session, quantity: Quantity) -> str:
    rate = quantity == "rate"
    units = [
        (number, record.gyro_unit if rate else record.accel_unit)
        for number, record in enumerate(session.records)
        if (record.gyro if rate else record.accel) is not None
    ]
    if not units:
        return session.records[0].gyro_unit if rate else session.records[0].accel_unit
    first, unit = units[0]
    for number, other in units:
        if other != unit and not (is_physical(other) and is_physical(unit)):
            raise InputError(
                f"recording {number}: wanted {'gyro' if rate else 'accel'} readings in {unit} as in recording {first}, got "
                f"{other}; nothing tells how they compare: give all recordings one unit, or the scale of the columns"
            )
    return unit


def _found(session: Session, settings: StillSettings) -> tuple[tuple[Still, ...], list[str]]:
    stills: tuple[Still, ...] = ()
    reasons: list[str] = []
    for number, record in enumerate(session.records):
        search = find_still(record, settings, recording=number)
        stills = (*stills, *search.stills)
        if not search.stills:
            reasons.append(f"recording {number}: {search.reason}")
    return stills, reasons


def _told_short(session: Session, number: int, stills: tuple[Still, ...], settings: StillSettings) -> str:
    # Pauses too short for a still, seen through a window of a fifth of its length.
    record = session.records[number]
    shorter = replace(settings, window_s=settings.window_s / 5.0, min_duration_s=settings.min_duration_s / 10.0)
    own = [s for s in stills if s.recording == number]
    if not own:  # nothing shows what this device's rest looks like; the search has said why
        return ""
    short = [
        s
        for s in find_still(record, shorter, recording=number).stills
        if not any(s.start < o.stop and o.start < s.stop for o in own)
    ]
    if len(short) < 3:
        return ""
    return (
        f"recording {number}: {len(short)} pauses were shorter than the {settings.window_s + settings.min_duration_s:g} s that a "
        "pose must be held; hold each for 3 s or more"
    )


def _labelled(session: Session, stills: tuple[Still, ...]) -> tuple[Still, ...]:
    unit = session.records[0].accel_unit
    if any(r.accel is None or r.accel_unit != unit for r in session.records):
        return stills
    if not stills or (not is_physical(unit) and len(stills) < 5):
        return stills  # counts have no zero to tell a direction from, unless poses share a sphere
    means = [
        still_means(accel, [still])[0]
        for still in stills
        if (accel := session.records[still.recording].accel) is not None
    ]
    faces = faces_of(np.array(means), centred=is_physical(unit))
    return tuple(replace(still, face=face) for still, face in zip(stills, faces, strict=True))
