"""Stillness: does the device rest where a session says so, and is no stretch counted twice?

Three figures of each still, whatever the offset of its sensors::

    spread    largest standard deviation of the readings, smoothed over 0.1 s, in a window of 1 s; three axes together
    tilting   angle between the mean specific force of its first and of its last third
    rate      mean rate reading less its median over all stills: a slow turn that no window sees

Each has a limit that a bench keeps. Over the limit the still is named and makes the verdict marginal; over three times the limit
the session is refused. Readings in counts have no bench limit: there a still is held against the other stills.
"""

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import Implausible, InputError
from undrift.record import Record
from undrift.segments import sliding_moments
from undrift.segments.still import BENCH_ACCEL_LIMIT, BENCH_RATE_LIMIT, sample_count
from undrift.session import Session, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

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
    """Hold every still against what a device at rest does.

    Parameters
    ----------
    session : Session
        Recordings, one unit for each triad.
    stills : tuple of Still
        Stated or found.
    stated : bool
        True tests spread and tilting too; found stills have passed a test of the spread.

    Returns
    -------
    tuple of str
        A sentence for each still that moves a little.

    Raises
    ------
    Implausible
        A still that does not rest; names it.
    """
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
    """Raise when readings would count twice: the same recording, the same still or the same turn stated again.

    Parameters
    ----------
    session : Session
        As read.

    Raises
    ------
    InputError
        Names the two.
    """
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
    """Return how to call a still or turn.

    Parameters
    ----------
    session : Session
        With its recording.
    piece : Still or Turn
        The stretch.
    number : int
        Its place, from 0.
    what : str
        still or turn.
    stated : bool
        True names the entry of session.toml, counted from 1.

    Returns
    -------
    str
        Entry, recording and span in s.
    """
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
