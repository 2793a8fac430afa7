"""Turns: plateaus of constant rate, and the rotations between one still phase and the next.

A plateau is a stretch where the smoothed rate r, less the offset at rest, is far from zero and steady::

    |r| > least_floors * floor        d <= max(steadiness * |r|, 4 floor)        d as in ``still.py``

where no window is four times as unsteady as the quiet quarter of the stretch: a ramp is trimmed off, a step cuts it in two.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.record import Record
from undrift.segments.still import FLOOR_QUANTILE, runs, sample_count, sliding_moments
from undrift.session import Axis, Still, Turn


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnSettings:
    """How steady turns and rotations are looked for.

    Parameters
    ----------
    window_s : float
        Length over which a rate must be steady, s.
    smooth_s : float
        Averaging before the spread is taken, s.
    min_duration_s : float
        Shortest plateau kept, s.
    steadiness : float
        Largest spread of a plateau as a share of its rate.
    least_floors : float
        A plateau or rotation must exceed this many noise floors.
    """

    window_s: float = 1.0
    smooth_s: float = 0.1
    min_duration_s: float = 1.0
    steadiness: float = 0.05
    least_floors: float = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TurnSearch:
    """Steady turns and rotations found in a record; what they truly were, only the rig or the protocol knows.

    Parameters
    ----------
    plateaus : tuple of Turn
        Stretches of constant rate; ``axis`` is the sensor axis that reads most, ``turn_rate`` is left open.
    plateau_rate : array, shape (P, 3)
        Mean reading of each less the offset at rest, gyro unit.
    rotations : tuple of Turn
        Motions between one still phase and the next; ``angle`` is left open.
    rotation_angle : array, shape (R, 3)
        Integral of each reading less the offset at rest, gyro unit times s.
    """

    plateaus: tuple[Turn, ...]
    plateau_rate: FloatArray
    rotations: tuple[Turn, ...]
    rotation_angle: FloatArray


def find_turns(record: Record, stills: Sequence[Still], settings: TurnSettings = TurnSettings()) -> TurnSearch:
    """Find plateaus of constant rate, and the rotations between still phases.

    Parameters
    ----------
    record : Record
        With gyroscope, any unit.
    stills : sequence of Still
        Still phases of this record, in order of time; they give the offset and bound the rotations.
    settings : TurnSettings
        Window and limits.

    Returns
    -------
    TurnSearch
        Plateaus and rotations with what the gyroscope read.

    Raises
    ------
    InputError
        The record has no gyroscope.
    """
    if record.gyro is None:
        raise InputError("find_turns: wanted a gyroscope, got a record without; map the gyro columns")
    fs = record.sample_rate_hz
    window, smooth = sample_count(settings.window_s, fs), max(1, round(settings.smooth_s * fs))
    mean, spread = sliding_moments(record.gyro, window, smooth)
    offset, floor = _rest(record.gyro, stills, mean, spread)
    plateaus, rates = _plateaus(record.gyro, mean - offset, spread, (offset, floor), stills, settings, fs)
    rotations, angles = _rotations(record, stills, offset, settings.least_floors * floor)
    return TurnSearch(plateaus=plateaus, plateau_rate=rates, rotations=rotations, rotation_angle=angles)


def _rest(gyro: FloatArray, stills: Sequence[Still], mean: FloatArray, spread: FloatArray) -> tuple[FloatArray, float]:
    floor = float(np.quantile(spread[np.isfinite(spread)], FLOOR_QUANTILE))
    if stills:
        rest = np.concatenate([gyro[s.start : s.stop] for s in stills])
        return np.nanmean(rest, axis=0), floor
    return np.median(mean[np.isfinite(spread)], axis=0), floor


def _plateaus(
    gyro: FloatArray,
    rate: FloatArray,
    spread: FloatArray,
    rest: tuple[FloatArray, float],
    stills: Sequence[Still],
    settings: TurnSettings,
    fs: float,
) -> tuple[tuple[Turn, ...], FloatArray]:
    offset, floor = rest
    edge = (len(gyro) - len(rate)) // 2
    size = np.linalg.norm(rate, axis=1)
    steady = (size > settings.least_floors * floor) & (spread <= np.maximum(settings.steadiness * size, 4.0 * floor))
    for still in stills:
        steady[max(0, still.start - edge) : max(0, still.stop - edge)] = False
    turns: list[Turn] = []
    rates: list[FloatArray] = []
    for first, last in runs(steady):
        # A ramp at an end, or a step between two rates, stands out from the run's own quiet windows.
        own = spread[first:last]
        for start, stop in runs(own <= max(4.0 * float(np.quantile(own, 0.25)), 4.0 * floor)):
            begin = int(first + start) + edge if first + start else 0
            end = int(first + stop) + edge if first + stop < len(rate) else len(gyro)
            if end - begin < sample_count(settings.min_duration_s, fs):
                continue
            reading = np.nanmean(gyro[begin:end], axis=0) - offset
            axis: Axis = ("x", "y", "z")[int(np.argmax(np.abs(reading)))]
            turns.append(Turn(start=begin, stop=end, axis=axis, recording=stills[0].recording if stills else 0))
            rates.append(reading)
    return tuple(turns), np.array(rates).reshape(-1, 3)


def _rotations(
    record: Record, stills: Sequence[Still], offset: FloatArray, least: float
) -> tuple[tuple[Turn, ...], FloatArray]:
    turns: list[Turn] = []
    angles: list[FloatArray] = []
    gyro = record.gyro
    for before, after in itertools.pairwise(stills):
        if gyro is None or after.start <= before.stop:
            continue
        reading = gyro[before.stop : after.start] - offset
        if not np.nanmax(np.linalg.norm(reading, axis=1)) > least:
            continue
        angle = np.asarray(np.trapezoid(np.nan_to_num(reading), record.time[before.stop : after.start], axis=0))
        share = np.abs(angle) / max(float(np.linalg.norm(angle)), np.finfo(float).tiny)
        axis: Axis | None = ("x", "y", "z")[int(np.argmax(share))] if share.max() > 0.9 else None
        turns.append(Turn(start=before.stop, stop=after.start, axis=axis, recording=before.recording))
        angles.append(angle)
    return tuple(turns), np.array(angles).reshape(-1, 3)
