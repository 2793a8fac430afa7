"""Rests of daily recordings, as observations of the gyroscopes' offset: temperature, reading and variance of each cell.

A worn body turns while it rests. The mean rate of a rest is the turn from its first to its last moment over its duration: gravity
shows that about two axes, and the third is taken to turn as much.
The scatter of half seconds does not count there: sway goes to and fro, and its sum is that turn. Blocks, lag, warm-up,
g-sensitivity and the steps of a converter are those of ``undrift drift`` (drift/observe.py, drift/rests.py).
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, interpolated
from undrift.calibration.observe import in_one_unit
from undrift.drift.observe import ObserveSettings, RestBlocks, find_rests, observe_rests
from undrift.drift.rests import Offsets, bins_of, gyro_offsets, variance_of_mean
from undrift.drift.sessions import check_at_rest, in_units_of, sensor_course
from undrift.drift.temperature import TemperatureSettings, trusted_temperature
from undrift.errors import NotObservable
from undrift.findings import Finding, finding
from undrift.model import Calibration, Learnt, TriadModel
from undrift.record import Record, Session, Still
from undrift.segments import StillSettings, find_still
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, Quantity, is_physical, si_factor

_DPS = RADIAN_PER_DEGREE
CELL_C = 2.0  # width of a temperature cell, K
UNKNOWN = 1.0 * _DPS  # standard uncertainty of an offset whose own is not known, rad/s
_WORN_RATE, _WORN_ACCEL = 3.0 * _DPS, 0.3  # rad/s, m/s2: a body that sits or stands quietly varies less within a second
_STEADY_C = 0.1  # of shift by ten seconds of lag: less is not reported
_WORN_S = 5.0  # shortest worn rest, s
_USELESS = 3.0  # a rest whose turn is this many times the table's uncertainty adds nothing


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
        cells = _cells(in_units_of(in_one_unit(session), base), base, settings)
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
        blocks = observe_rests([replace(session, stills=stills)], temperatures=[course], settings=settings.observe)
        of_still = _still_of(blocks, session, stills)
        blocks, turn = _with_turns(blocks, of_still, session, stills, worn, base)
        check_at_rest(blocks, base)
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
    made = Learnt(
        temp_c=temp_c,
        gyro_offset=mean,
        gyro_variance=variance + offsets.common_variance,
        recording=np.zeros(len(temp_c), np.int64),
        recordings=(("", ""),),
        since="",
    )
    return _Cells(
        learnt=made,
        rests=len(used),
        worn=int(worn[used].sum()),
        turning=turning,
        ramp_c_per_min=float(np.sqrt(np.mean(blocks.ramp_c_per_min**2))),
        notes=(*notes, *offsets.findings),
    )


def _parts(offsets: Offsets, rows: IntArray, turn: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return temperature, offset and variance of each part of a rest; a part may turn as far as the whole, in less time."""
    blocks, held = offsets.blocks, offsets.step_error
    rows = rows[np.argsort(blocks.temp_c[rows], kind="stable")]
    bins = bins_of(blocks.temp_c[rows], CELL_C)
    temp_c, mean, variance = list[float](), list[FloatArray](), list[FloatArray]()
    for number in range(bins.max() + 1):
        own = rows[bins == number]
        noise = variance_of_mean(offsets.value[own], offsets.variance[own], None if held is None else held[own])
        temp_c.append(float(blocks.temp_c[own].mean()))
        mean.append(offsets.value[own].mean(axis=0))
        variance.append(noise + (turn[own[0]] * len(rows) / len(own)) ** 2)
    return np.array(temp_c), np.array(mean), np.array(variance)


def _stills(session: Session, base: Calibration) -> tuple[tuple[Still, ...], BoolArray]:
    """Return rests as on a table, and those of a quiet body between them, in order of time; true for the latter."""
    try:
        quiet = list(find_rests(session))
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


def in_order(held: Learnt | None, new: list[Learnt], base: Calibration) -> Learnt:
    """Return all cells so far, recordings in order of date: what was learnt first makes no difference."""
    parts = [*([] if held is None else [held]), *new]
    recordings = [one for part in parts for one in part.recordings]
    begins = np.cumsum([0, *(len(part.recordings) for part in parts)])
    number = np.concatenate([part.recording + begin for part, begin in zip(parts, begins[:-1], strict=True)])
    order = sorted(range(len(recordings)), key=lambda k: (recordings[k][1], recordings[k][0]))
    place = np.argsort(order)[number]
    rows = np.argsort(place, kind="stable")
    since = base.provenance.created if held is None else held.since
    return Learnt(
        temp_c=np.concatenate([part.temp_c for part in parts])[rows],
        gyro_offset=np.concatenate([part.gyro_offset for part in parts])[rows],
        gyro_variance=np.concatenate([part.gyro_variance for part in parts])[rows],
        recording=place[rows],
        recordings=tuple(recordings[k] for k in order),
        since=since or recordings[order[0]][1],
        before=base.drift,
    )
