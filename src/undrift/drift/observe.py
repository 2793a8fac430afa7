"""Observations of thermal sessions: blocks of rest, and dwells at a steady rate, one row each, with their temperatures.

Blocks of rest are means over ten seconds or so. A mean leaves out samples that lie more than six robust standard deviations from
the median of their block. Its variance comes from the differences of neighbouring half-second means, pooled over the rest::

    var of a block's mean = mean((m_(k+1) - m_k)^2) / 2 / number of half seconds

so that a ramp does not count as noise; bias instability from block to block is left to the fit.

Sessions are made ready first: each reading once, in the calibration's units, codes restored, one switch-on a session.

A session in several recordings whose clock runs on from one to the next was switched on once, when the first began; a clock that
begins anew is another switch-on.

The fit takes sessions as independent. A copy of one would halve the variance and add a second switch-on, so it is refused.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.codes import code_variance, restored
from undrift.calibration.plausibility import axis_vectors
from undrift.calibration.table import dwell_means
from undrift.errors import InputError, NotObservable
from undrift.findings import finding
from undrift.fit.gls import block_size
from undrift.model import Calibration, TriadModel, Verdict
from undrift.record import Record, Session, Still, Turn
from undrift.segments import find_still
from undrift.units import RADIAN_PER_DEGREE, SI_UNIT, Quantity, is_physical, si_factor

Temperatures = Sequence[Sequence[FloatArray]]  # per session, per recording: (N,), degC, lag subtracted

BLOCK_S = 10.0  # length of a block of rest: shorter follows a fast ramp, longer averages more noise
RAMP_S = 60.0  # stretch over which the slope of the temperature is taken
SETTLE_S = 0.3  # start of each dwell that is discarded
SOAK_C = 1.5  # a dwell further than this from the first one of its soak begins another soak
_SAME_POSE = 3.0 * RADIAN_PER_DEGREE  # between mean specific forces of one mounting; drift tilts them by 1-2 deg
_STATED_C = 1.0  # a run states the mean that the thermometer read in a dwell, which varies within a soak, K
FAR = 6.0  # robust standard deviations: further samples are outliers
ROBUST = 1.4826  # standard deviation of normal noise over its median absolute deviation
_LEAST_SHARE = 0.5  # of a block's samples that have to be there
_JUMP = 1.0  # degC: a temperature this far off its block, and far off its scatter, is an outlier
_RESTLESS = 0.5 * RADIAN_PER_DEGREE  # rad/s, standard uncertainty of the mean of a block
_GAP_S = 60.0  # a clock that runs on after a longer pause is taken as another switch-on


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StretchMeans:
    """Means over stretches of thermal sessions, n rows."""

    session: IntArray  # (n,), which session, from 0
    time: FloatArray  # (n,), middle of the stretch, s; the recordings of a session follow each other on this clock
    temp_c: FloatArray  # (n,), mean temperature, degC, lag subtracted
    gyro: FloatArray  # (n, 3), mean reading, raw unit; NaN where the session has no such sensors
    accel: FloatArray  # (n, 3), likewise
    gyro_variance: FloatArray  # (n, 3), of the mean by the scatter inside the stretch, raw unit squared

    def __len__(self) -> int:
        return len(self.temp_c)

    def taken(self, which: Any) -> Self:
        """Return some of the rows, numbers unchanged."""
        own: dict[str, Any] = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return replace(self, **{name: v[which] for name, v in own.items() if hasattr(v, "shape")})

    def followed_by(self, others: Sequence[Self]) -> Self:
        """Return all rows, one after another; a column that one of them lacks is left out."""
        columns = {name: [getattr(part, name) for part in (self, *others)] for name in self.__dataclass_fields__}
        lacking = {name for name, of in columns.items() if any(part is None for part in of)}
        joined: dict[str, Any] = {k: None if k in lacking else np.concatenate(of) for k, of in columns.items()}
        return replace(self, **joined)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestBlocks(StretchMeans):
    """Means over blocks of rest, n rows in the order of session and time."""

    pose: IntArray  # (n,), which orientation; numbers are not shared by sessions
    power_on_s: FloatArray  # (n,), time since the first recording of the same power-on began, s
    ramp_c_per_min: FloatArray  # (n,), slope of the temperature, degC/min: above 0 while warming
    accel_variance: FloatArray  # (n, 3), likewise
    # (n, 3), standard deviation of what the converter's steps leave in the mean, raw unit: constant at one level
    gyro_step_error: FloatArray | None = None
    accel_step_error: FloatArray | None = None  # (n, 3), likewise
    # (n,), as ``pose``, but a face that was mounted anew, after another one, has another number: it is not level as before
    mounting: IntArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateSteps(StretchMeans):
    """Means over dwells at a steady rate, n rows in the order of session and time."""

    soak: IntArray  # (n,), dwells of one number were made at one temperature
    rate_b: FloatArray  # (n, 3), imposed rate in case axes, rad/s


def observe_rests(sessions: Sequence[Session], *, temperatures: Temperatures) -> RestBlocks:
    """Gather the rests of thermal sessions into blocks."""
    parts: list[RestBlocks] = []
    poses = 0
    for number, (session, temps) in enumerate(zip(sessions, temperatures, strict=True)):
        _check_lengths(session, temps)
        if session.means:
            parts.append(set_point_rests(session, temps, number=number, first_pose=poses))
            poses = int(parts[-1].pose.max(initial=poses - 1)) + 1
            continue
        begins_s, ages_s = session.begins_s, _ages(session.records)
        steps = [(_record_step(record.gyro), _record_step(record.accel)) for record in session.records]
        stills = find_rests(session)
        numbers = _poses(session, stills)
        mountings = poses + np.append(0, np.cumsum(np.diff(numbers) != 0))
        for still, pose, mounting in zip(stills, (poses + numbers).tolist(), mountings.tolist(), strict=True):
            k = still.recording
            clocks_s = float(begins_s[k]), float(ages_s[k])
            blocks = rest_blocks(
                session.records[k], temps[k], still, steps[k], clocks_s=clocks_s, session=number, pose=pose
            )
            parts.append(replace(blocks, mounting=np.full(len(blocks), mounting, np.int64)))
        poses = max(poses + int(numbers.max()), int(mountings.max())) + 1
    if not any(len(part) for part in parts):
        raise NotObservable(
            "rests: wanted stretches at rest with a known temperature, got none; leave the device still while its temperature "
            "changes, and record the temperature or state temp_c"
        )
    return parts[0].followed_by(parts[1:])


def observe_steps(sessions: Sequence[Session], *, temperatures: Temperatures) -> RateSteps:
    """Gather the dwells at known rates of thermal sessions."""
    none, three, whole = np.zeros(0), np.zeros((0, 3)), np.zeros(0, np.int64)
    steps = RateSteps(
        session=whole, soak=whole, time=none, temp_c=none, rate_b=three, gyro=three, accel=three, gyro_variance=three
    )
    parts: list[RateSteps] = []
    soaks = 0
    for number, (session, temps) in enumerate(zip(sessions, temperatures, strict=True)):
        _check_lengths(session, temps)
        if session.means:
            parts.append(set_point_steps(session, temps, number=number, first_soak=soaks))
            soaks = int(parts[-1].soak.max(initial=soaks - 1)) + 1
            continue
        turns = [
            turn
            for turn in session.turns
            if turn.axis is not None and turn.turn_rate is not None and session.records[turn.recording].gyro is not None
        ]
        if turns:
            turns.sort(key=lambda t: (t.recording, t.start))
            parts.append(_steps(session, turns, temps, session_number=number, first_soak=soaks))
            soaks = int(parts[-1].soak.max()) + 1
    return steps.followed_by(parts)


def _check_lengths(session: Session, temps: Sequence[FloatArray]) -> None:
    for k, (record, temp) in enumerate(zip(session.records, temps, strict=True)):
        if len(record) != len(temp):
            raise InputError(
                f"temperature of recording {k}: wanted {len(record)} values, got {len(temp)}; one a sample, NaN where unknown"
            )


# ---- rests and their poses


def find_rests(session: Session) -> tuple[Still, ...]:
    """Return the rests that a session states, else those found in it, in order of time."""
    if session.stills:
        return tuple(sorted(session.stills, key=lambda s: (s.recording, s.start)))
    turning = [(t.recording, t.start, t.stop) for t in session.turns]
    rests: list[Still] = []
    for number, record in enumerate(session.records):
        spans = [(a, b) for r, a, b in turning if r == number]
        stills = find_still(record, recording=number).stills
        rests.extend(s for s in stills if all(s.stop <= a or s.start >= b for a, b in spans))
    if not rests:
        raise NotObservable(
            "rests: wanted stretches at rest, got none; leave the device still while its temperature changes, or state [[still]]"
        )
    return tuple(rests)


def with_rests(sessions: Sequence[Session]) -> tuple[list[Session], Verdict]:
    """Return the sessions without the bare recordings that never rest, unless there is nothing else; a finding names those."""
    kept, left_out = list[Session](), list[str]()
    for number, session in enumerate(sessions):
        try:
            if not (session.stills or session.turns or session.means):
                find_rests(session)
        except NotObservable:
            left_out.append(session.inputs[0][0] if session.inputs else f"session {number + 1}")
        else:
            kept.append(session)
    if not kept or not left_out:
        return list(sessions), Verdict()
    return kept, Verdict.of(finding("drift.no_rests", "warn", count=len(left_out), names=tuple(left_out[:5])))


def _poses(session: Session, stills: tuple[Still, ...]) -> IntArray:
    """Return which pose each still is in, from 0."""
    numbers, faces = list[int](), dict[str, int]()
    before: Still | None = None
    mean: FloatArray | None = None
    for still in stills:
        accel, last = session.records[still.recording].accel, mean
        mean = None if accel is None else np.nanmedian(accel[still.start : still.stop], axis=0)
        same = before is not None and before.recording == still.recording and _lie_alike(last, mean)
        following = max(numbers, default=-1) + 1
        if still.face is not None:
            numbers.append(faces.setdefault(still.face, following))
        else:
            numbers.append(numbers[-1] if same else following)
        before = still
    return np.array(numbers, np.int64)


def _lie_alike(one: FloatArray | None, two: FloatArray | None) -> bool:
    if one is None or two is None:
        return one is two
    return bool(np.arctan2(np.linalg.norm(np.cross(one, two)), one @ two) < _SAME_POSE)


# ---- blocks of one rest


def rest_blocks(
    record: Record,
    temp_c: FloatArray,
    still: Still,
    steps: tuple[FloatArray, FloatArray],
    *,
    clocks_s: tuple[float, float],
    session: int,
    pose: int,
) -> RestBlocks:
    """Return the blocks of one rest.

    ``steps`` are the least between readings of each sensor, raw unit, over the recording; ``clocks_s`` the time of its first sample
    on the session's clock and since power-on, s.
    """
    inside = slice(still.start, still.stop)
    time, temp = record.time[inside], temp_c[inside]
    edges = _edges(time, BLOCK_S)
    count, size = len(edges) - 1, block_size(record.sample_rate_hz)
    gyro, gyro_variance, gyro_step = _means(record.gyro, inside, edges, size, steps[0])
    accel, accel_variance, accel_step = _means(record.accel, inside, edges, size, steps[1])
    middle = np.array([0.5 * (time[a] + time[b - 1]) for a, b in pairwise(edges)])
    temps = np.full(count, np.nan)
    for k, (a, b) in enumerate(pairwise(edges)):
        known = temp[a:b][np.isfinite(temp[a:b])]
        if len(known) >= _LEAST_SHARE * (b - a):
            off = np.abs(known - np.median(known))
            temps[k] = known[off <= _JUMP + FAR * ROBUST * np.median(off)].mean()
    blocks = RestBlocks(
        session=np.full(count, session, np.int64),
        pose=np.full(count, pose, np.int64),
        time=middle - record.time[0] + clocks_s[0],
        power_on_s=middle - record.time[0] + clocks_s[1],
        temp_c=temps,
        ramp_c_per_min=np.array([_slope(time, temp, at, RAMP_S) for at in middle]),
        gyro=gyro,
        accel=accel,
        gyro_variance=gyro_variance,
        accel_variance=accel_variance,
        gyro_step_error=gyro_step,
        accel_step_error=accel_step,
    )
    return blocks.taken(np.isfinite(temps) & (np.isfinite(gyro).all(axis=1) | np.isfinite(accel).all(axis=1)))


def _edges(time: FloatArray, block_s: float) -> IntArray:
    # As many blocks of about block_s as fit; a still shorter than two blocks is one.
    count = max(1, int((time[-1] - time[0]) / block_s + 0.05))
    edges = np.searchsorted(time, time[0] + (time[-1] - time[0]) * np.arange(1, count) / count)
    return np.unique(np.concatenate(([0], edges, [len(time)])))


def _means(
    readings: FloatArray | None, inside: slice, edges: IntArray, size: int, step: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, its variance and its step error of each block, shape (B, 3); NaN if too many samples are missing."""
    means = np.full((len(edges) - 1, 3), np.nan)
    if readings is None:
        return means, means.copy(), np.zeros_like(means)
    counts, square, pairs = np.zeros(len(means)), np.zeros(3), 0
    scatter: list[FloatArray] = []
    for k, (start, stop) in enumerate(pairwise(edges)):
        block = _clean(readings[inside][start:stop])
        if len(block) < _LEAST_SHARE * (stop - start):
            continue
        means[k], counts[k] = block.mean(axis=0), len(block)
        scatter.append(block.var(axis=0))
        own = min(size, max(1, len(block) // 2))
        halves = block[: len(block) // own * own].reshape(-1, own, 3).mean(axis=1)
        square += (np.diff(halves, axis=0) ** 2).sum(axis=0) * own
        pairs += len(halves) - 1
    if not scatter:
        return means, means.copy(), np.zeros_like(means)
    variance = square / (2.0 * pairs) if pairs else np.full(3, np.nan)  # of a sample with the noise of a half second
    error, seen = np.sqrt(code_variance(step, np.mean(scatter, axis=0))), np.isfinite(means)
    return means, np.where(seen, variance / np.maximum(counts, 1.0)[:, None], np.nan), np.where(seen, error, np.nan)


def _clean(block: FloatArray) -> FloatArray:
    """Return the samples of a block, (n, 3), that are readings and no outliers."""
    block = block[np.isfinite(block).all(axis=1)]
    if not len(block):
        return block
    off = np.abs(block - np.median(block, axis=0))
    deviation = np.maximum(ROBUST * np.median(off, axis=0), _step(block))
    return block[(off <= FAR * deviation).all(axis=1)]


def _record_step(values: FloatArray | None) -> FloatArray:
    return np.zeros(3) if values is None else _step(values[np.isfinite(values).all(axis=1)])


def _step(values: FloatArray) -> FloatArray:
    """Return the least step between readings of each axis, (n, 3) -> (3,); 0 if all are equal.

    A converter whose noise is below one code has no median deviation.
    """
    steps = np.diff(np.sort(values, axis=0), axis=0)
    least = np.where(steps > 0.0, steps, np.inf).min(axis=0, initial=np.inf)
    return np.where(np.isfinite(least), least, 0.0)


def _slope(time: FloatArray, temp: FloatArray, middle: float, span_s: float) -> float:
    """Return the slope of the temperature about a moment, degC/min."""
    start, stop = np.searchsorted(time, (middle - 0.5 * span_s, middle + 0.5 * span_s))
    known = np.isfinite(temp[start:stop])
    t, y = time[start:stop][known], temp[start:stop][known]
    if len(t) < 2:
        return 0.0
    t = t - t.mean()
    return float(60.0 * (t @ (y - y.mean())) / (t @ t))


# ---- dwells at a steady rate


def _steps(
    session: Session,
    turns: list[Turn],
    temps: Sequence[FloatArray],
    *,
    session_number: int,
    first_soak: int,
) -> RateSteps:
    dwells = dwell_means(session.records, turns, settle_s=SETTLE_S)
    count = len(turns)
    temp, accel = np.zeros(count), np.full((count, 3), np.nan)
    for k, turn in enumerate(turns):
        own = temps[turn.recording][turn.start : turn.stop]
        if not np.isfinite(own).any():
            raise InputError(
                f"dwell [{turn.start}, {turn.stop}) of recording {turn.recording}: wanted a temperature, got none; map its column "
                "or state temp_c"
            )
        temp[k] = np.nanmean(own)
        values = session.records[turn.recording].accel
        if values is not None and np.isfinite(values[turn.start : turn.stop]).any():
            accel[k] = np.nanmean(values[turn.start : turn.stop], axis=0)
    stated = np.array([np.nan if turn.temp_c is None else turn.temp_c for turn in turns])
    return RateSteps(
        session=np.full(count, session_number, np.int64),
        soak=first_soak + _soaks(temp, stated),
        time=np.zeros(count) if dwells.span is None else dwells.span.mean(axis=1),
        temp_c=temp,
        rate_b=axis_vectors(dwells.axis) * dwells.turn_rate[:, None],
        gyro=dwells.reading,
        accel=accel,
        gyro_variance=np.full((count, 3), np.nan) if dwells.noise is None else dwells.noise**2,
    )


def _soaks(temp_c: FloatArray, stated_c: FloatArray | None = None) -> IntArray:
    """Return which soak each dwell belongs to: by the temperature that is stated where one is, else by the thermometer."""
    numbers, first = np.zeros(len(temp_c), np.int64), 0
    for k in range(1, len(temp_c)):
        apart = abs(temp_c[k] - temp_c[first]) - SOAK_C
        stated = np.nan if stated_c is None else abs(stated_c[k] - stated_c[first]) - _STATED_C
        another = bool((apart if np.isnan(stated) else stated) > 0.0)
        first = k if another else first
        numbers[k] = numbers[k - 1] + another
    return numbers


# ---- means over set-points: a row at rest is a block of rest, a row with an imposed rate a dwell
#
# Without a stated uncertainty, rows have the usual one of the others, or one step of the readings, q / sqrt(12). The fits determine
# the scatter beyond that.


def set_point_rests(session: Session, temps: Sequence[FloatArray], *, number: int, first_pose: int) -> RestBlocks:
    """Return the rows at rest of a session of set-points."""
    parts, forces = list[RestBlocks](), list[FloatArray]()
    for k, (record, means, temp_c) in enumerate(zip(session.records, session.means, temps, strict=True)):
        rows = np.flatnonzero((means.rate_b == 0.0).all(axis=1) & np.isfinite(temp_c))
        columns = _columns(session, k, temp_c, rows, number)
        pose = np.full(len(rows), first_pose, np.int64)
        for row, force in enumerate(columns["accel"]):
            if np.isfinite(force).all():
                alike = [i for i, other in enumerate(forces) if _lie_alike(other, force)]
                forces += [] if alike else [force]
                pose[row] += alike[0] if alike else len(forces) - 1
        parts.append(
            RestBlocks(
                **columns,
                pose=pose,
                mounting=pose,
                power_on_s=record.time[rows] - record.time[0] + _ages(session.records)[k],
                ramp_c_per_min=np.zeros(len(rows)),
                accel_variance=_stated_variance(record.accel, means.accel_uncertainty)[rows],
                gyro_step_error=np.zeros((len(rows), 3)),
                accel_step_error=np.zeros((len(rows), 3)),
            )
        )
    return parts[0].followed_by(parts[1:])


def set_point_steps(session: Session, temps: Sequence[FloatArray], *, number: int, first_soak: int) -> RateSteps:
    """Return the rows with an imposed rate of a session of set-points."""
    parts = list[RateSteps]()
    for k, (means, temp_c) in enumerate(zip(session.means, temps, strict=True)):
        known = np.flatnonzero(np.isfinite(temp_c))
        soak, turning = _soaks(temp_c[known]), (means.rate_b[known] != 0.0).any(axis=1)
        rows = known[turning]
        columns = _columns(session, k, temp_c, rows, number)
        parts.append(RateSteps(**columns, soak=first_soak + soak[turning], rate_b=means.rate_b[rows]))
        first_soak += int(soak.max(initial=-1)) + 1
    return parts[0].followed_by(parts[1:])


def _columns(session: Session, k: int, temp_c: FloatArray, rows: IntArray, number: int) -> dict[str, Any]:
    """Return what rows of set-points have in common, at rest and turning; NaN for a triad that they do not have."""
    record, means = session.records[k], session.means[k]
    nothing = np.full((len(record), 3), np.nan)
    return {
        "session": np.full(len(rows), number, np.int64),
        "time": record.time[rows] - record.time[0] + session.begins_s[k],
        "temp_c": temp_c[rows],
        "gyro": (nothing if record.gyro is None else record.gyro)[rows],
        "accel": (nothing if record.accel is None else record.accel)[rows],
        "gyro_variance": _stated_variance(record.gyro, means.gyro_uncertainty)[rows],
    }


def _stated_variance(values: FloatArray | None, uncertainty: FloatArray) -> FloatArray:
    """Return the variance of rows of means (N, 3); the median of the others, or that of one step, for rows without one."""
    variance = uncertainty**2
    if values is not None:
        for axis, column in enumerate(variance.T):
            known = column[np.isfinite(column)]
            usual = np.median(known) if len(known) else _resolution(values[:, axis])
            variance[:, axis] = np.where(np.isfinite(column), column, usual)
    return np.asarray(variance)


def _resolution(values: FloatArray) -> float:
    """Return the variance of one step of the readings, uniform over it: the largest that divides all their differences.

    The least difference is no step: rows of a steep offset lie far apart.
    """
    known = np.unique(values[np.isfinite(values)])
    nothing, step = 1e-9 * float(np.abs(known).max(initial=0.0)), 0.0
    for rest in np.diff(known).tolist():  # Euclid's algorithm
        while rest > nothing:
            step, rest = rest, step % rest
    return step**2 / 12.0


# ---- sessions made ready


def in_units_of(session: Session, calibration: Calibration) -> Session:
    """Return a session in the units that a calibration reads, with the half steps of truncated codes put back."""
    records = tuple(_prepared(record, k, calibration) for k, record in enumerate(session.records))
    means = [
        replace(
            means,
            gyro_uncertainty=means.gyro_uncertainty * _unit_ratio(old.gyro_unit, new.gyro_unit, "rate"),
            accel_uncertainty=means.accel_uncertainty * _unit_ratio(old.accel_unit, new.accel_unit, "accel"),
        )
        for means, old, new in zip(session.means, session.records, records, strict=bool(session.means))
    ]
    return replace(session, records=records, means=tuple(means))


def _unit_ratio(old: str, new: str, quantity: Quantity) -> float:
    return 1.0 if old == new else si_factor(old, quantity) / si_factor(new, quantity)


def _prepared(record: Record, number: int, calibration: Calibration) -> Record:
    if record.state == "corrected":
        raise InputError(
            f"recording {number}: wanted raw readings, got a corrected record; a table is subtracted from the device's own readings"
        )
    before, units = (record.gyro_unit, record.accel_unit), list[str]()
    for triad, values, unit in zip(calibration.triads, (record.gyro, record.accel), before, strict=True):
        wanted = unit if values is None or triad.model is None else triad.model.unit_in
        if wanted != unit and not (is_physical(unit) and is_physical(wanted)):
            raise InputError(
                f"recording {number}: wanted {triad.sensor} readings in {wanted}, the unit of the calibration, got {unit}; record "
                "as for the calibration, or calibrate in this unit"
            )
        units.append(wanted)
    if tuple(units) != before:
        record = replace(record.in_units(*units), gyro_unit=units[0], accel_unit=units[1])
    gyro = calibration.gyro
    return restored(record, calibration.adc, None if gyro is None else gyro.code_offset)


def nominal_models(sessions: Sequence[Session]) -> Calibration:
    """Return a calibration that keeps the scale that the readings' units state, and knows no offset."""
    first = sessions[0]
    unit = next((r.gyro_unit for s in sessions for r in s.records if r.gyro is not None), None)
    if unit is None:
        raise NotObservable(
            "drift: without a calibration, accelerometers at rest show only how the offset changes. Calibrate six faces, and give "
            "the calibration."
        )
    if not is_physical(unit):
        raise NotObservable(
            f"drift: wanted a calibration, or gyroscope readings in a physical unit, got {unit}; give "
            "`calibration`, or the scale of the columns"
        )
    return Calibration(
        device=first.serial or first.records[0].device,
        reference_temp_c=float("nan"),
        gravity_m_s2=first.gravity_m_s2,
        gyro=nominal_triad(unit, "rate"),
        verdict=Verdict(status="marginal", findings=(finding("calibration.nominal", "warn"),)),
        file_map=first.file_map,
    )


def nominal_triad(unit: str, quantity: Quantity) -> TriadModel:
    """Return the model of sensors that are what their unit says."""
    return TriadModel(
        method="nominal",
        unit_in=unit,
        unit_out=SI_UNIT[quantity],
        matrix=np.eye(3) * si_factor(unit, quantity),
        offset=np.zeros(3),
        covariance=np.zeros((12, 12)),
        rms_residual=0.0,
        count=0,
        rank=0,
        condition=1.0,
        valid_range=(-np.inf, np.inf),
    )


def accel_unit_of(sessions: Sequence[Session], device: Calibration) -> str:
    """Return the unit of the accelerometers' readings."""
    if device.accel is not None:
        return device.accel.unit_in
    units = {record.accel_unit for session in sessions for record in session.records if record.accel is not None}
    return units.pop() if len(units) == 1 else "count"


def _ages(records: Sequence[Record]) -> FloatArray:
    """Return how long before each record its device was switched on, s."""
    ages, first = np.zeros(len(records)), records[0].time[0]
    for k in range(1, len(records)):
        if records[k].time[0] <= records[k - 1].time[-1]:
            first = records[k].time[0]
        ages[k] = records[k].time[0] - first
    return ages


def check_at_rest(rests: RestBlocks, device: Calibration) -> None:
    """Refuse blocks of rest in which the device moved all the time: a log that never lies still looks even throughout."""
    if device.gyro is None or not np.isfinite(rests.gyro_variance).any():
        return
    known = np.sqrt(np.nanmedian(rests.gyro_variance, axis=0)) * device.gyro.si_per_reading("rate")
    if np.nanmax(known) > _RESTLESS:
        dps = float(np.nanmax(known)) / RADIAN_PER_DEGREE
        raise NotObservable(
            f"rests: wanted stretches at rest, got none: readings move so much that the mean of ten seconds is known to {dps:.2g} "
            "deg/s only; leave the device still while its temperature changes",
            deg_per_s=dps,
        )


# ---- recordings cut from one switch-on are put together


def one_power_on(sessions: Sequence[Session]) -> list[Session]:
    """Put recordings together whose clock runs on from one to the next: the device was not switched off between them."""
    chains: list[list[int]] = []
    for k in sorted(range(len(sessions)), key=lambda k: (sessions[k].records[0].time[0], k)):
        before = [chain for chain in chains if _continues(sessions[chain[-1]], sessions[k])]
        if before:
            max(before, key=lambda chain: sessions[chain[-1]].records[-1].time[-1]).append(k)
        else:
            chains.append([k])
    return [
        replace(
            sessions[group[0]],
            records=tuple(record for k in group for record in sessions[k].records),
            inputs=tuple(named for k in group for named in sessions[k].inputs),
        )
        for group in sorted(chains, key=min)
    ]


def _continues(earlier: Session, later: Session) -> bool:
    pause = later.records[0].time[0] - earlier.records[-1].time[-1]
    return bool(0.0 < pause <= _GAP_S and earlier.serial == later.serial)


# ---- data given twice are refused


def check_once(sessions: Sequence[Session]) -> None:
    """Refuse data that were given twice, as one file or as equal readings: they would make the uncertainty too small."""
    first = dict[str, str]()
    for number, session in enumerate(sessions):
        # settings may be equal
        files = [(name, digest) for name, digest in session.inputs if not name.endswith(".toml")]
        digests = {digest: name for name, digest in files}
        for k, record in enumerate(session.records):
            readings = np.column_stack([part for part in (record.gyro, record.accel) if part is not None])
            stuck = len(readings) < 2 or not (np.nanmin(readings, axis=0) < np.nanmax(readings, axis=0)).any()
            if not stuck:
                digest = hashlib.sha256(np.ascontiguousarray(readings).tobytes()).hexdigest()
                digests[digest] = files[k][0] if len(files) == len(session.records) else f"recording {k}"
        for digest, name in digests.items():
            name = f"session {number + 1} ({name})"
            if digest in first:
                raise InputError(
                    f"drift: the same data are in {first[digest]} and {name}. Leave one out: the same data twice would make the "
                    "uncertainty too small."
                )
        first |= {digest: f"session {number + 1} ({name})" for digest, name in digests.items()}
