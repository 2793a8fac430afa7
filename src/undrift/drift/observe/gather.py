"""Observations: what thermal sessions show, gathered into blocks of rest (``blocks.py``) and dwells at a steady rate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.fit.dwells import DwellSettings, dwell_means
from undrift.drift.observe.blocks import rest_blocks, whole_of
from undrift.drift.observe.observations import RateSteps, RestBlocks
from undrift.errors import InputError, NotObservable
from undrift.record import Record
from undrift.segments import StillSettings, find_still
from undrift.session import Session, Still, Turn
from undrift.units import RADIAN_PER_DEGREE

Temperatures = Sequence[Sequence[FloatArray]]  # per session, per recording: shape (N,), degC, lag taken off

_SAME_POSE = 3.0 * RADIAN_PER_DEGREE  # between mean specific forces of one mounting; drift tilts them by 1-2 deg
_STATED_C = 1.0  # a run states the mean that the thermometer read in a dwell, which wanders within a soak, K
_EVEN = 4.0  # a log that never moves: the spread of nearly all blocks lies within this factor of the median


@dataclass(frozen=True, slots=True, kw_only=True)
class ObserveSettings:
    """How a thermal session is cut up.

    Parameters
    ----------
    block_s : float
        Length of a block of rest, s. Shorter follows a fast ramp, longer averages more noise.
    ramp_s : float
        Stretch over which the slope of the temperature is taken, s.
    settle_s : float
        Start of each dwell that is thrown away, s.
    soak_c : float
        A dwell further than this from the first one of its soak begins another soak, degC.
    """

    block_s: float = 10.0
    ramp_s: float = 60.0
    settle_s: float = 0.3
    soak_c: float = 1.5


def observe_rests(
    sessions: Sequence[Session], *, temperatures: Temperatures, settings: ObserveSettings = ObserveSettings()
) -> RestBlocks:
    """Gather the rests of thermal sessions into blocks.

    Stated stills count; where a session states none they are found in the data, and a log that never moves is one rest.
    Stills of one stated face are one pose, and so are stills of one recording that lie within 3 deg of each other.

    Parameters
    ----------
    sessions : sequence of Session
        One device.
    temperatures : sequence of sequence of array, shape (N,)
        Of each recording of each session, degC, lag taken off; NaN where it is not known.
    settings : ObserveSettings
        Lengths.

    Returns
    -------
    RestBlocks
        In the order of session and time.

    Raises
    ------
    NotObservable
        A session without a rest, or none whose temperature is known.
    InputError
        Temperatures of another length than their recording.
    """
    parts: list[RestBlocks] = []
    poses = 0
    for number, (session, temps) in enumerate(zip(sessions, temperatures, strict=True)):
        _check_lengths(session, temps)
        begins = np.concatenate(([0.0], np.cumsum([record.duration_s for record in session.records])))
        wholes = [whole_of(record, float(begin)) for record, begin in zip(session.records, begins, strict=False)]
        stills = _rests(session)
        numbers = poses + _poses(session, stills)
        poses = int(numbers.max()) + 1
        parts.extend(
            rest_blocks(
                session.records[still.recording],
                temps[still.recording],
                still,
                wholes[still.recording],
                block_s=settings.block_s,
                ramp_s=settings.ramp_s,
                session=number,
                pose=int(pose),
            )
            for still, pose in zip(stills, numbers, strict=True)
        )
    if not any(len(part) for part in parts):
        raise NotObservable(
            "rests: wanted stretches at rest with a known temperature, got none; leave the device still while its temperature "
            "changes, and record the temperature or state temp_c"
        )
    return RestBlocks(**{name: _stacked(parts, name) for name in RestBlocks.__dataclass_fields__})


def observe_steps(
    sessions: Sequence[Session], *, temperatures: Temperatures, settings: ObserveSettings = ObserveSettings()
) -> RateSteps:
    """Gather the dwells at known rates of thermal sessions.

    Parameters
    ----------
    sessions : sequence of Session
        One device.
    temperatures : sequence of sequence of array, shape (N,)
        Of each recording of each session, degC, lag taken off.
    settings : ObserveSettings
        Settling time, and what makes a soak.

    Returns
    -------
    RateSteps
        In the order of session and time; no rows where no turn has an axis and a rate.

    Raises
    ------
    InputError
        A dwell whose temperature is not known, has gaps, or is shorter than its settling time.
    Implausible
        Saturated samples.
    """
    parts: list[RateSteps] = []
    soaks = 0
    for number, (session, temps) in enumerate(zip(sessions, temperatures, strict=True)):
        _check_lengths(session, temps)
        turns = [t for t in session.turns if t.axis is not None and t.turn_rate is not None]
        if not turns:
            continue
        turns.sort(key=lambda t: (t.recording, t.start))
        part = _steps(session, turns, temps, settings)
        soak = soaks + _soaks(turns, part.temp_c, settings.soak_c)
        soaks = int(soak.max()) + 1
        parts.append(_numbered(part, number, soak))
    if not parts:
        return _no_steps()
    return RateSteps(**{name: _stacked(parts, name) for name in RateSteps.__dataclass_fields__})


def _stacked(parts: Sequence[RestBlocks | RateSteps], name: str) -> Any:
    if any(getattr(part, name) is None for part in parts):
        return None
    return np.concatenate([getattr(part, name) for part in parts])


def _rests(session: Session) -> tuple[Still, ...]:
    if session.stills:
        return tuple(sorted(session.stills, key=lambda s: (s.recording, s.start)))
    turning = [(t.recording, t.start, t.stop) for t in session.turns]
    found: list[Still] = []
    for number, record in enumerate(session.records):
        spans = [(a, b) for r, a, b in turning if r == number]
        if not spans and _never_moves(record):
            found.append(Still(start=0, stop=len(record), recording=number))
            continue
        stills = find_still(record, StillSettings(), recording=number).stills
        found.extend(s for s in stills if all(s.stop <= a or s.start >= b for a, b in spans))
    if not found:
        raise NotObservable(
            "rests: wanted stretches at rest, got none; leave the device still while its temperature changes, or state [[still]]"
        )
    return tuple(found)


def _never_moves(record: Record) -> bool:
    """Tell whether nearly all seconds of a record are as quiet as the median second, and the specific force stays."""
    size = max(4, round(record.sample_rate_hz))
    for values in (record.gyro, record.accel):
        if values is None:
            continue
        values = values[np.isfinite(values).all(axis=1)]
        if len(values) < 8 * size:
            return False
        seconds = values[: len(values) // size * size].reshape(-1, size, 3)
        middle = np.median(seconds, axis=1)
        spread = np.median(np.abs(seconds - middle[:, None, :]), axis=1).sum(axis=1)
        usual = max(float(np.median(spread)), 1e-300)
        steps = np.abs(np.diff(middle, axis=0)).sum(axis=1)
        if np.quantile(spread, 0.98) > _EVEN * usual or np.quantile(steps, 0.98) > _EVEN * usual:
            return False
    return _direction_stays(record)


def _direction_stays(record: Record) -> bool:
    if record.accel is None:
        return True
    known = record.accel[np.isfinite(record.accel).all(axis=1)]
    means = np.array([np.median(part, axis=0) for part in np.array_split(known, 8)])
    return all(_angle(means[0], mean) < _SAME_POSE for mean in means)


def _angle(one: FloatArray, two: FloatArray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(one, two)), one @ two))


def _poses(session: Session, stills: tuple[Still, ...]) -> IntArray:
    """Return which pose each still is in, from 0."""
    numbers = np.zeros(len(stills), np.int64)
    faces: dict[str, int] = {}
    following = 0
    before: tuple[int, FloatArray | None, int] | None = None
    for k, still in enumerate(stills):
        accel = session.records[still.recording].accel
        mean = None if accel is None else np.nanmedian(accel[still.start : still.stop], axis=0)
        if still.face is not None and still.face in faces:
            numbers[k] = faces[still.face]
        elif before is not None and before[0] == still.recording and still.face is None and _lies_like(before[1], mean):
            numbers[k] = before[2]
        else:
            numbers[k], following = following, following + 1
        if still.face is not None:
            faces[still.face] = int(numbers[k])
        before = (still.recording, mean, int(numbers[k]))
    return numbers


def _lies_like(one: FloatArray | None, two: FloatArray | None) -> bool:
    return (one is None and two is None) or (one is not None and two is not None and _angle(one, two) < _SAME_POSE)


def _check_lengths(session: Session, temps: Sequence[FloatArray]) -> None:
    for k, (record, temp) in enumerate(zip(session.records, temps, strict=True)):
        if len(record) != len(temp):
            raise InputError(
                f"temperature of recording {k}: wanted {len(record)} values, got {len(temp)}; one a sample, NaN where unknown"
            )


def _steps(session: Session, turns: list[Turn], temps: Sequence[FloatArray], settings: ObserveSettings) -> RateSteps:
    dwells = dwell_means(session.records, turns, DwellSettings(settle_s=settings.settle_s))
    count = len(turns)
    temp, accel = np.zeros(count), np.full((count, 3), np.nan)
    for k, turn in enumerate(turns):
        own = temps[turn.recording][turn.start : turn.stop]
        if not np.isfinite(own).any():
            raise InputError(
                f"dwell [{turn.start}, {turn.stop}) of recording {turn.recording}: wanted a temperature, got none; map its column "
                "or state temp_c"
            )
        temp[k] = float(np.nanmean(own))
        values = session.records[turn.recording].accel
        if values is not None and np.isfinite(values[turn.start : turn.stop]).any():
            accel[k] = np.nanmean(values[turn.start : turn.stop], axis=0)
    imposed = np.zeros((count, 3))
    imposed[np.arange(count), ["xyz".index(axis) for axis in dwells.axis]] = dwells.turn_rate
    zeros = np.zeros(count, np.int64)
    return RateSteps(
        session=zeros,
        soak=zeros,
        time=dwells.time if dwells.time is not None else np.zeros(count),
        temp_c=temp,
        rate_b=imposed,
        gyro=dwells.reading,
        accel=accel,
        gyro_variance=np.full((count, 3), np.nan) if dwells.noise is None else dwells.noise**2,
    )


def _soaks(turns: list[Turn], temp_c: FloatArray, apart_c: float) -> IntArray:
    """Return which soak each dwell belongs to: by the temperature that is stated where one is, else by the thermometer."""
    numbers = np.zeros(len(turns), np.int64)
    first = 0
    for k in range(1, len(turns)):
        here, there = turns[k].temp_c, turns[first].temp_c
        apart = abs(temp_c[k] - temp_c[first]) - apart_c
        another = bool((apart if here is None or there is None else abs(here - there) - _STATED_C) > 0.0)
        first = k if another else first
        numbers[k] = numbers[k - 1] + another
    return numbers


def _numbered(part: RateSteps, session: int, soak: IntArray) -> RateSteps:
    return replace(part, session=np.full(len(part), session, np.int64), soak=soak)


def _no_steps() -> RateSteps:
    none, three, whole = np.zeros(0), np.zeros((0, 3)), np.zeros(0, np.int64)
    return RateSteps(
        session=whole, soak=whole, time=none, temp_c=none, rate_b=three, gyro=three, accel=three, gyro_variance=three
    )
