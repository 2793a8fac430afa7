"""Rates of a table that undrift does not drive, from the log of its controller.

The log contains time and rate, or time and angle, on its own clock. A time t of the log is, on the clock of the recording::

    t + lag + skew (t - tm)          tm: middle of the aligned times

Rates and readings are correlated at every shift, and the lags of parts of the log give a straight line (``sync.lag_line``). Steady
stretches of the log become dwells, with the rate in the log. The readings of a dwell exclude the settling and three times the
uncertainty of the lag.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray, runs
from undrift.errors import AlignmentError, FileFormatError, InputError
from undrift.io.text import parse_text, sniff
from undrift.model import AXES
from undrift.record import Record, Turn
from undrift.sync import LONGEST_STEP, LagLine, PoseRates, coarse_lag, lag_line
from undrift.units import RADIAN_PER_DEGREE

TIMES = {"time_s": 1.0, "time_ms": 1e-3, "time_us": 1e-6}  # factor to s by column
RATES = {"turn_rate_dps": RADIAN_PER_DEGREE, "turn_rate_rad_s": 1.0, "turn_rate_rpm": np.pi / 30.0}  # factor to rad/s
ANGLES = {"angle_deg": RADIAN_PER_DEGREE, "angle_rad": 1.0, "angle_turns": 2.0 * np.pi}  # factor to rad
MIN_ROWS = 30
ROUNDING = 1e-9  # relative error of a number in text
SETTLE_S = 0.5  # time omitted at both ends of a dwell, in which the table and the device's filter settle
LEAST_S = 1.0  # shortest remaining dwell
RAMP_S = 3.0  # time before and after a dwell in which the rate changes
STEADY = 0.02  # largest relative departure of a steady rate from its median
LEAST_RATE = 0.05 * RADIAN_PER_DEGREE  # rate below which the table is at rest, rad/s
LARGEST_UNCERTAINTY = 0.01  # largest relative uncertainty of a rate (a dwell with a larger uncertainty is omitted)
PARTS, PART_S = 12, 30.0  # largest number of parts of the log and their shortest length, each with a lag
FLOOR_S, JUMP_S = 1e-3, 0.3  # uncertainty of a lag on a ramp, and deviation from the line if a clock jumped
UNKNOWN_SKEW = 1e-4  # relative drift of two quartz clocks that a single part cannot compare


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateLog:
    """The log of a table's controller."""

    name: str
    time: FloatArray  # (M,), time on the controller's clock, s
    angle: FloatArray  # (M,), angle, rad (the integral of the rate if the log contains rates)
    resolution: float  # resolution of an angle, rad, or of a rate, rad/s
    has_angle: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class LoggedTurn:
    """A dwell of the log on the recording."""

    turn: Turn
    uncertainty: float  # standard uncertainty of the rate, rad/s


def read_rate_log(path: str | Path) -> RateLog:
    """Read a log with a header, a column in TIMES, and a column in RATES or ANGLES, separated by comma, semicolon or tab."""
    text, values = sniff(path), RATES | ANGLES
    times, rates = ([name for name in text.names if name.strip() in table] for table in (TIMES, values))
    if len(times) != 1 or len(rates) != 1:
        raise FileFormatError(
            f"{path}: a log has one column out of {', '.join(TIMES)} and one out of {', '.join(values)}, got "
            f"{', '.join(text.names)[:80]}. Rename the columns."
        )
    table, kind = parse_text(text, (times[0], rates[0])), rates[0].strip()
    time, value = table.numbers(times[0]) * TIMES[times[0].strip()], table.numbers(rates[0]) * values[kind]
    valid = np.isfinite(time) & np.isfinite(value)
    time, value = time[valid], value[valid]
    if len(time) < MIN_ROWS or not (np.diff(time) > 0.0).all():
        got = f"{len(time)} rows" if len(time) < MIN_ROWS else "time that repeats or goes back"
        raise FileFormatError(f"{path}: expected {MIN_ROWS} rows or more with increasing time, got {got}. Repair it.")
    steps = np.diff(np.unique(value))
    steps = steps[steps > ROUNDING * np.abs(value).max()]
    if kind in RATES:
        value = np.concatenate(([0.0], np.cumsum(0.5 * (value[1:] + value[:-1]) * np.diff(time))))
    elif value.min() > -1e-9 - np.pi and value.max() < 2.0 * np.pi + 1e-9:
        value = np.unwrap(value)
    resolution = float(steps.min()) if len(steps) else 0.0
    return RateLog(name=str(path), time=time, angle=value, resolution=resolution, has_angle=kind in ANGLES)


# ---- clocks


def align_clocks(log: RateLog, record: Record) -> LagLine:
    """Determine the lag of the recording behind the log, as a line over the time of the log."""
    if record.gyro is None:
        raise InputError(f"{log.name}: the recording has no gyroscope to align the log with. Map its columns.")
    step = np.diff(log.time)
    valid = step <= LONGEST_STEP * np.median(step)
    rate = np.where(valid, np.diff(log.angle) / step, 0.0)[:, None]
    shift = float(record.time[0] - log.time[0])  # first with the first samples aligned, then at every shift
    rates = PoseRates(start=log.time[:-1] + shift, stop=log.time[1:] + shift, rate=rate, valid=valid)
    initial_lag = coarse_lag(record.time, record.gyro, rates, float(max(np.ptp(record.time), np.ptp(log.time))))
    rates = rates.part((rates.start + initial_lag > record.time[0]) & (rates.stop + initial_lag < record.time[-1]))
    count = int(np.clip(np.ptp(rates.start) / PART_S, 1, PARTS))
    parts = [rates.part(rows) for rows in np.array_split(np.arange(len(rates.start)), count) if rates.rate[rows].any()]
    line = lag_line(record, parts, near=initial_lag, average_s=0.1, floor_s=FLOOR_S)
    if (off_s := np.abs(line.off_s).max()) > JUMP_S:
        raise AlignmentError(
            f"{log.name}: a lag is {off_s:.2f} s off a line: a clock jumped, or readings are missing. Cut both files there."
        )
    unknown = UNKNOWN_SKEW if np.isinf(line.skew_uncertainty) else line.skew_uncertainty
    return replace(line, middle_s=line.middle_s - shift, lag_s=line.lag_s + shift, skew_uncertainty=unknown)


# ---- dwells


def cut_dwells(log: RateLog, records: Sequence[tuple[Record, LagLine]]) -> tuple[tuple[LoggedTurn, ...], int]:
    """Return the steady dwells of a log on the recordings, and the number of omitted dwells (uncertain or not recorded)."""
    turns, missed, senses = list[LoggedTurn](), 0, dict[float, str]()
    for start, stop in steady_stretches(log):
        turn_rate, uncertainty = _achieved(log, start, stop)
        accurate = uncertainty <= LARGEST_UNCERTAINTY * abs(turn_rate)
        count = len(turns)
        for number, (record, line) in enumerate(records if accurate else ()):
            rows = _recorded(record, line, start, stop)
            if rows is None:
                continue
            axis, sign = _match_axis(log, record, line, start, stop)
            turn = Turn(start=rows.start, stop=rows.stop, axis=AXES[axis], turn_rate=sign * turn_rate, recording=number)
            turns.append(LoggedTurn(turn=turn, uncertainty=uncertainty))
            up = np.zeros(3) if record.accel is None else np.nanmean(record.accel[rows], axis=0)
            if abs(up[axis]) > 0.9 * np.linalg.norm(up):
                senses.setdefault(sign * float(np.sign(up[axis])), AXES[axis])
        missed += len(turns) == count
    if len(senses) > 1:
        raise InputError(
            f"{log.name}: the gyroscopes {' and '.join(senses.values())} have opposite signs for the positive sense of the table. "
            "Check the signs of the columns, or of the log between mountings."
        )
    return tuple(turns), missed


def steady_stretches(log: RateLog) -> list[tuple[float, float]]:
    """Return start and stop, on the clock of the log, of the stretches at a constant rate, without rest."""
    step = np.diff(log.time)
    typical = float(np.median(step))
    width = max(1, round(0.2 / typical))
    rate = (log.angle[width:] - log.angle[:-width]) / (log.time[width:] - log.time[:-width])
    noise = 2.0 * log.resolution / (width * typical if log.has_angle else 1.0)
    gaps = np.cumsum(np.concatenate(([False], step > 5.0 * typical)))
    regular = (gaps[width:] == gaps[:-width]) & (np.abs(rate) > LEAST_RATE)
    steady = np.abs(rate[width:] - rate[:-width]) <= STEADY * np.abs(rate[width:]) + noise
    stretches = list[tuple[float, float]]()
    for start, stop in runs(regular[width:] & regular[:-width] & steady):
        level = rate[start : stop + width]
        steady_level = np.abs(level - np.median(level)) <= STEADY * np.abs(np.median(level)) + noise
        # slow ends of a ramp are cut off
        longest = max(runs(steady_level), key=lambda run: run[1] - run[0], default=(0, 0))
        first, last = log.time[start + longest[0]], log.time[start + longest[1] - 1 + width]
        if last - first >= 2.0 * SETTLE_S + LEAST_S:
            stretches.append((float(first), float(last)))
    return stretches


def _achieved(log: RateLog, start: float, stop: float) -> tuple[float, float]:
    """Return the rate of a dwell, from a line through the angles, and its standard uncertainty, including their resolution."""
    rows = slice(*np.searchsorted(log.time, (start + SETTLE_S, stop - SETTLE_S)))
    t, phi = log.time[rows], log.angle[rows]
    (slope, _), covariance = np.polyfit(t - t.mean(), phi - phi.mean(), 1, cov=True)
    coarse = log.resolution / float(np.ptp(t)) if log.has_angle else log.resolution
    return float(slope), float(np.hypot(np.sqrt(covariance[0, 0]), coarse / np.sqrt(6.0 if log.has_angle else 12.0)))


def _recorded(record: Record, line: LagLine, start: float, stop: float) -> slice | None:
    """Return the samples of a dwell without its settling, or None if the recording does not contain it."""
    first = line.later(start) + SETTLE_S + 3.0 * line.uncertainty_s(start)
    last = line.later(stop) - SETTLE_S - 3.0 * line.uncertainty_s(stop)
    if min(last, float(record.time[-1])) - max(first, float(record.time[0])) < LEAST_S:
        return None
    rows = slice(*(int(k) for k in np.searchsorted(record.time, (first, last))))
    inside = np.isfinite(np.asarray(record.gyro)[rows]).all(axis=1)
    return rows if inside.sum() >= 10 and inside.mean() >= 0.8 else None


def _match_axis(log: RateLog, record: Record, line: LagLine, start: float, stop: float) -> tuple[int, float]:
    """Return axis and sign of the gyroscope that follows the log over a dwell and the ramps at its ends."""
    room = SETTLE_S + RAMP_S
    rows = slice(*np.searchsorted(record.time, (line.later(start) - room, line.later(stop) + room)))
    valid = np.isfinite(np.asarray(record.gyro)[rows]).all(axis=1)
    time, gyro = record.time[rows][valid], np.asarray(record.gyro)[rows][valid]
    logged = line.middle_s + (time - line.later(line.middle_s)) / (1.0 + line.skew)
    rate = np.gradient(np.interp(logged, log.time, log.angle), logged)
    follows = (rate - rate.mean()) @ (gyro - gyro.mean(axis=0))
    axis = int(np.argmax(np.abs(follows)))
    return axis, float(np.sign(follows[axis]))
