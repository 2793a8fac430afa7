"""Rates of a table that undrift does not drive, from the log of its own controller.

The log holds time and rate, or time and angle, on a clock of its own: another origin, another speed. A moment t of the log was, on
the clock of the recording, at::

    t + offset + drift (t - tm)          tm: the middle of the moments that were aligned

The lengths of both rates are correlated at every shift of the whole, then ``sync.lag_of`` finds the lag in parts of the log, and
a straight line through the lags gives offset and drift with their uncertainty. Steady stretches of the log become dwells. The rate
is taken from the log, over the readings within the dwell minus the settling and three times that uncertainty.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray, runs
from undrift.errors import AlignmentError, FileFormatError, InputError
from undrift.io.columns import TextLayout
from undrift.io.text import open_text, parse_text
from undrift.model import AXES
from undrift.record import Record, Turn
from undrift.sync import (
    LONGEST_STEP,
    Lag,
    LagSettings,
    PoseRates,
    lag_correlation,
    lag_line,
    lag_of,
    middle_of_motion,
)
from undrift.units import RADIAN_PER_DEGREE

TIMES = {"time_s": 1.0, "time_ms": 1e-3, "time_us": 1e-6}  # column -> factor to s
RATES = {"turn_rate_dps": RADIAN_PER_DEGREE, "turn_rate_rad_s": 1.0, "turn_rate_rpm": np.pi / 30.0}  # to rad/s
ANGLES = {"angle_deg": RADIAN_PER_DEGREE, "angle_rad": 1.0, "angle_turns": 2.0 * np.pi}  # to rad
ROUNDING = 1e-9  # of a number in text
SETTLE_S = 0.5  # left out at both ends of a dwell: the table swings out, the device's filter settles
LEAST_S = 1.0  # shortest dwell that is left
RAMP_S = 3.0  # before and after a dwell: the rate changes in it
STEADY = 0.02  # largest departure of a steady rate from its median, relative
LEAST_RATE = 0.05 * RADIAN_PER_DEGREE  # below it the table rests, rad/s
LARGEST_UNCERTAINTY = 0.01  # of an achieved rate, relative; a dwell of more is left out
LARGEST_DRIFT = 0.01  # between the clocks; more is a wrong unit of time
PARTS, PART_S = 12, 30.0  # of the log at most, each at least so long; each has a lag
ALIKE, APART_S = 0.9, 2.0  # of the best correlation, and s from the best shift: another shift that may be the right one
FLOOR_S, JUMP_S = 1e-3, 0.3  # of a lag: what the shape of a ramp hides; off the line, a clock jumped
UNKNOWN_DRIFT = 1e-4  # of two quartz clocks that one part cannot compare


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateLog:
    """The log of a table's controller."""

    name: str
    time: FloatArray  # (M,), controller s
    angle: FloatArray  # (M,), rad; the integral of the rate if the log has rates
    resolution: float  # of one angle, rad, or of one rate, rad/s
    has_angle: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Clocks:
    """Clock of a recording minus clock of a log."""

    offset_s: float  # at ``middle_s``
    drift: float  # seconds per second by which the recording's clock runs faster
    middle_s: float  # on the log's clock
    offset_uncertainty_s: float  # standard
    drift_uncertainty: float  # standard; that of two quartz clocks if one part only has a lag
    correlation: float  # least of the parts

    def recorded(self, time: float) -> float:
        """Return the recording's time of a moment of the log."""
        return time + self.offset_s + self.drift * (time - self.middle_s)

    def uncertainty_s(self, time: float) -> float:
        """Return the standard uncertainty of that time."""
        return float(np.hypot(self.offset_uncertainty_s, (time - self.middle_s) * self.drift_uncertainty))


@dataclass(frozen=True, slots=True, kw_only=True)
class LoggedTurn:
    """A dwell of the log on the recording."""

    turn: Turn
    uncertainty: float  # standard, of the rate, rad/s


def read_rate_log(path: str | Path) -> RateLog:
    """Read a log: a header, a column of TIMES, and one of RATES or ANGLES; comma, semicolon or tab between them."""
    first, *others = open_text(path).head.splitlines()
    delimiter = max(",;\t", key=first.decode("utf-8", "replace").count)
    text = open_text(
        path, TextLayout(delimiter=delimiter, decimal="," if delimiter == ";" and b"," in others[0] else ".")
    )
    names, values = [name.strip() for name in text.names], RATES | ANGLES
    named = [[name for name in names if name in table] for table in (TIMES, values)]
    if any(len(found) != 1 for found in named):
        raise FileFormatError(
            f"{path}: wanted one column out of {', '.join(TIMES)} and one out of {', '.join(values)}, got "
            f"{', '.join(names)[:80]}; rename the columns"
        )
    (when,), (what,) = named
    columns = (text.names[names.index(when)], text.names[names.index(what)])
    table = parse_text(text, columns)
    time, value = table.numbers(columns[0]) * TIMES[when], table.numbers(columns[1]) * values[what]
    whole = np.isfinite(time) & np.isfinite(value)
    time, value = time[whole], value[whole]
    if len(time) < 30 or not (np.diff(time) > 0.0).all():
        wrong = "fewer" if len(time) < 30 else f"one that does not after {time[np.argmin(np.diff(time) > 0.0)]:g} s"
        raise FileFormatError(f"{path}: wanted 30 rows or more whose time goes forward, got {wrong}; mend the log")
    steps = np.diff(np.unique(value))
    steps = steps[steps > ROUNDING * np.abs(value).max()]
    if what in RATES:
        value = np.concatenate(([0.0], np.cumsum(0.5 * (value[1:] + value[:-1]) * np.diff(time))))
    elif value.min() > -1e-9 - np.pi and value.max() < 2.0 * np.pi + 1e-9:
        value = np.unwrap(value)
    resolution = float(steps.min()) if len(steps) else 0.0
    return RateLog(name=str(path), time=time, angle=value, resolution=resolution, has_angle=what in ANGLES)


# ---- clocks


def align_clocks(log: RateLog, record: Record, offset_s: float | None = None) -> Clocks:
    """Find offset and drift between the clock of a log and that of a recording; the offset may be known to a second."""
    if record.gyro is None:
        raise InputError(f"{log.name}: wanted a recording with a gyroscope to align by, got none; map its columns")
    step = np.diff(log.time)
    valid = step <= LONGEST_STEP * np.median(step)
    rate = np.where(valid, np.diff(log.angle) / step, 0.0)[:, None]
    rates = PoseRates(start=log.time[:-1], stop=log.time[1:], rate=rate, valid=valid)
    rough = _rough_offset(log, record, rates) if offset_s is None else offset_s
    when, lags = _lags(log, record, rates, rough)
    late = np.array([lag.seconds for lag in lags])
    line = lag_line(when, late, np.hypot([lag.standard_uncertainty for lag in lags], FLOOR_S))
    if np.abs(line.off_s).max() > JUMP_S:
        worst = int(np.argmax(np.abs(line.off_s)))
        raise AlignmentError(
            f"clocks: wanted one offset and drift along the log, got a lag {line.off_s[worst]:+.2f} s off the line at "
            f"{when[worst]:.0f} s; a clock jumped, or readings are missing: cut the files there"
        )
    unknown = np.isinf(line.skew_uncertainty)
    if abs(line.skew) > max(LARGEST_DRIFT, 0.0 if unknown else 4.0 * line.skew_uncertainty):
        raise AlignmentError(
            f"{log.name}: wanted clocks that agree to {LARGEST_DRIFT:.0%}, got {line.skew:+.1%}; check the unit of time"
        )
    return Clocks(
        offset_s=rough + line.lag_s,
        drift=line.skew,
        middle_s=line.middle_s,
        offset_uncertainty_s=line.lag_uncertainty_s,
        drift_uncertainty=UNKNOWN_DRIFT if unknown else line.skew_uncertainty,
        correlation=min(lag.correlation_after for lag in lags),
    )


def _scores(
    time: FloatArray, gyro: FloatArray, rates: PoseRates, longest_s: float
) -> tuple[float, FloatArray, FloatArray]:
    """Return the best correlation, a score of each shift, and the shifts, s: among equals the widest overlap is best."""
    nothing: FloatArray = np.zeros(1)
    best, score, lags = 0.0, nothing, nothing
    for centre in (True, False):
        shifts, correlation, overlap = lag_correlation(time, gyro, rates, longest_s, centre=centre)
        here = np.nan_to_num(correlation) * np.sqrt(overlap / max(overlap.max(), 1.0))
        if here.max() > score.max():
            best, score, lags = float(np.nan_to_num(correlation)[np.argmax(here)]), here, shifts
    return best, score, lags


def _rough_offset(log: RateLog, record: Record, rates: PoseRates) -> float:
    """Return recording minus log, s, to a cell, or refuse if two shifts are as good."""
    shift = float(record.time[0] - log.time[0])  # first samples together, then every shift
    longest = float(max(np.ptp(record.time), np.ptp(log.time)))
    best, score, lags = _scores(record.time, np.asarray(record.gyro), rates.part(slice(None), shift), longest)
    if best < LagSettings().least_correlation:
        raise AlignmentError(
            f"{log.name}: wanted the log of the table that turned this device, got a correlation of {best:.2f} at best; "
            "check that the two belong together"
        )
    first = lags[np.argmax(score)]
    rivals = (score > ALIKE * score.max()) & (np.abs(lags - first) > APART_S)
    if rivals.any():
        other = lags[np.argmax(np.where(rivals, score, 0.0))]
        raise AlignmentError(
            f"{log.name}: wanted one shift between the clocks, got {shift + first:.1f} and {shift + other:.1f} s "
            "alike; state it to a second: `rates_offset_s`"
        )
    return shift + float(first)


def _lags(log: RateLog, record: Record, rates: PoseRates, rough: float) -> tuple[FloatArray, list[Lag]]:
    """Return the times of the log at which a lag was found, and the lags, recording minus log minus the rough offset."""
    span = float(np.ptp(log.time))
    count = max(1, min(PARTS, int(span / PART_S)))
    reach = LagSettings(longest_lag_s=APART_S + 0.5 * LARGEST_DRIFT * span, average_s=0.1)
    when, lags, why = list[float](), list[Lag](), "no motion"
    for rows in np.array_split(np.arange(len(rates.start)), count):
        part = rates.part(rows, rough)
        near = (record.time >= part.start[0] - reach.longest_lag_s) & (
            record.time <= part.stop[-1] + reach.longest_lag_s
        )
        if near.sum() < 30 or not part.rate.any():
            continue
        time, gyro = record.time[near], np.asarray(record.gyro)[near]
        try:
            _, score, shifts = _scores(time, gyro, part, reach.longest_lag_s)
            lag = lag_of(time, gyro, part, reach, near=float(shifts[np.argmax(score)]))
        except AlignmentError as error:
            why = str(error)
            continue
        if lag.standard_uncertainty < APART_S:
            when.append(middle_of_motion(part) - rough)
            lags.append(lag)
    if not lags:
        raise AlignmentError(
            f"{log.name}: wanted turns that show how late it is, got none ({why[:120]}); log whole ramps"
        )
    return np.array(when), lags


# ---- dwells


def cut_dwells(log: RateLog, records: Sequence[tuple[Record, Clocks]]) -> tuple[tuple[LoggedTurn, ...], int]:
    """Return the steady dwells of a log on the recordings, and how many were left out as too uncertain or not recorded."""
    turns, missed, senses = list[LoggedTurn](), 0, dict[float, str]()
    for start, stop in steady_stretches(log):
        turn_rate, uncertainty = _achieved(log, start, stop)
        if uncertainty > LARGEST_UNCERTAINTY * abs(turn_rate):
            missed += 1
            continue
        before = len(turns)
        for number, (record, clocks) in enumerate(records):
            inside = _recorded(record, clocks, start, stop)
            if inside is None:
                continue
            axis, sign = _axis_of(log, record, clocks, start, stop)
            turn = Turn(
                start=inside.start, stop=inside.stop, axis=AXES[axis], turn_rate=sign * turn_rate, recording=number
            )
            turns.append(LoggedTurn(turn=turn, uncertainty=uncertainty))
            if record.accel is not None:
                up = np.nanmean(record.accel[inside], axis=0)
                if abs(up[axis]) > 0.9 * np.linalg.norm(up):
                    senses.setdefault(sign * float(np.sign(up[axis])), AXES[axis])
        missed += len(turns) == before
    if len(senses) > 1:
        first, second = senses.values()
        raise InputError(
            f"{log.name}: wanted gyroscopes that all take the table's positive sense alike, got {first} and {second} opposite; "
            "check the signs of the columns, or of the log between mountings"
        )
    return tuple(turns), missed


def steady_stretches(log: RateLog) -> list[tuple[float, float]]:
    """Return start and stop, on the log's clock, of the stretches at one rate, rest left out."""
    step = np.diff(log.time)
    typical = float(np.median(step))
    width = max(1, round(0.2 / typical))
    rate = (log.angle[width:] - log.angle[:-width]) / (log.time[width:] - log.time[:-width])
    noise = 2.0 * log.resolution / (width * typical if log.has_angle else 1.0)
    gaps = np.cumsum(np.concatenate(([False], step > 5.0 * typical)))
    whole = (gaps[width:] == gaps[:-width]) & (np.abs(rate) > LEAST_RATE)
    steady = np.abs(rate[width:] - rate[:-width]) <= STEADY * np.abs(rate[width:]) + noise
    stretches = list[tuple[float, float]]()
    for start, stop in runs(whole[width:] & whole[:-width] & steady):
        level = rate[start : stop + width]
        off = np.abs(level - np.median(level)) > STEADY * np.abs(np.median(level)) + noise
        longest = max(runs(~off), key=lambda run: run[1] - run[0], default=(0, 0))  # slow ends of a ramp are cut off
        first, last = log.time[start + longest[0]], log.time[start + longest[1] - 1 + width]
        if last - first >= 2.0 * SETTLE_S + LEAST_S:
            stretches.append((float(first), float(last)))
    return stretches


def _achieved(log: RateLog, start: float, stop: float) -> tuple[float, float]:
    """Return the rate of a dwell and its standard uncertainty: a line through the angles, and the steps of their resolution."""
    rows = slice(*np.searchsorted(log.time, (start + SETTLE_S, stop - SETTLE_S)))
    t, phi = log.time[rows], log.angle[rows]
    away = t - t.mean()
    square = float(away @ away)
    slope = float(away @ phi) / square
    residual = phi - phi.mean() - slope * away
    scatter = float(np.sqrt(residual @ residual / (len(t) - 2) / square))
    coarse = log.resolution / float(np.ptp(t)) if log.has_angle else log.resolution
    return slope, float(np.hypot(scatter, coarse / np.sqrt(6.0 if log.has_angle else 12.0)))


def _recorded(record: Record, clocks: Clocks, start: float, stop: float) -> slice | None:
    """Return the samples of a dwell without its settling; None if the recording does not contain it."""
    first = clocks.recorded(start) + SETTLE_S + 3.0 * clocks.uncertainty_s(start)
    last = clocks.recorded(stop) - SETTLE_S - 3.0 * clocks.uncertainty_s(stop)
    if min(last, float(record.time[-1])) - max(first, float(record.time[0])) < LEAST_S:
        return None
    rows = slice(*(int(k) for k in np.searchsorted(record.time, (first, last))))
    inside = np.isfinite(np.asarray(record.gyro)[rows]).all(axis=1)
    return rows if inside.sum() >= 10 and inside.mean() >= 0.8 else None


def _axis_of(log: RateLog, record: Record, clocks: Clocks, start: float, stop: float) -> tuple[int, float]:
    """Return axis and sign of the gyroscope that follows the log over a dwell and the ramps at its ends."""
    room = SETTLE_S + RAMP_S
    rows = slice(*np.searchsorted(record.time, (clocks.recorded(start) - room, clocks.recorded(stop) + room)))
    whole = np.isfinite(np.asarray(record.gyro)[rows]).all(axis=1)
    time, gyro = record.time[rows][whole], np.asarray(record.gyro)[rows][whole]
    logged = clocks.middle_s + (time - clocks.recorded(clocks.middle_s)) / (1.0 + clocks.drift)
    rate = np.gradient(np.interp(logged, log.time, log.angle), logged)
    follows = (rate - rate.mean()) @ (gyro - gyro.mean(axis=0))
    axis = int(np.argmax(np.abs(follows)))
    return axis, float(np.sign(follows[axis]))
