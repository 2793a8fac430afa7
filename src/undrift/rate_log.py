"""Rates of a table that undrift does not drive, from the log of its own controller.

The log holds time and rate, or time and angle, on a clock of its own: another origin, another speed. With w the rate of the table
and u the readings of the gyroscope, a moment t of the log was, on the clock of the recording, at::

    t + offset + drift (t - tm)          tm: the middle of the moments that were aligned

The lengths of w and u are correlated at every shift of the whole; then ``lag_of`` finds the lag in windows along the log, and a
straight line through the lags gives offset and drift with their uncertainty. Steady stretches of the log become dwells: the rate
is that of the log, whose clock counts, over what is read: the dwell less the settling and three times that uncertainty.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray, runs
from undrift.errors import AlignmentError, FileFormatError, InputError
from undrift.io.columns import TextLayout
from undrift.io.text import open_text, parse_text
from undrift.model import AXES
from undrift.record import Record, Turn
from undrift.sync import LONGEST_STEP, Lag, LagSettings, PoseRates, lag_correlation, lag_of
from undrift.units import RADIAN_PER_DEGREE

TIMES = {"time_s": 1.0, "time_ms": 1e-3, "time_us": 1e-6}  # column -> factor to s
RATES = {"turn_rate_dps": RADIAN_PER_DEGREE, "turn_rate_rad_s": 1.0, "turn_rate_rpm": np.pi / 30.0}  # to rad/s
ANGLES = {"angle_deg": RADIAN_PER_DEGREE, "angle_rad": 1.0, "angle_turns": 2.0 * np.pi}  # to rad
SETTLE_S = 0.5  # left out at both ends of a dwell: the table swings out, the device's filter settles
LEAST_S = 1.0  # shortest dwell that is left
STEADY = 0.02  # largest departure of a steady rate from its median, relative
LEAST_RATE = 0.05 * RADIAN_PER_DEGREE  # below it the table rests, rad/s
LARGEST_UNCERTAINTY = 0.01  # of an achieved rate, relative; a dwell of more is left out
LARGEST_DRIFT = 0.01  # between the clocks; more is a wrong unit of time
WINDOWS, WINDOW_S = 12, 30.0  # at most, along the log, each at least so long; lags are found in each


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateLog:
    """What a table's controller wrote."""

    name: str
    time: FloatArray  # (M,), controller s
    angle: FloatArray  # (M,), rad; the integral of the rate where the log has rates
    resolution: float  # Of one angle, rad, or of one rate, rad/s
    has_angle: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Clocks:
    """How the clock of a log stands against that of a recording."""

    offset_s: float  # At ``middle_s``: recording less log
    drift: float  # Seconds a second by which the recording's clock runs faster
    middle_s: float  # On the log's clock
    offset_uncertainty_s: float  # Standard
    drift_uncertainty: float  # Standard; that of two quartz clocks where one window alone shows the lag
    windows: int  # In which the lag was found
    correlation: float  # Least of them

    def recorded(self, time: float) -> float:
        """Return the recording's time of a moment of the log."""
        return time + self.offset_s + self.drift * (time - self.middle_s)

    def uncertainty_s(self, time: float) -> float:
        """Return the standard uncertainty of that."""
        return float(np.hypot(self.offset_uncertainty_s, (time - self.middle_s) * self.drift_uncertainty))


@dataclass(frozen=True, slots=True, kw_only=True)
class LoggedTurn:
    """A dwell of the log on the recording."""

    turn: Turn
    uncertainty: float  # Standard, of the rate, rad/s


ROUNDING = 1e-9  # of a number in text


def read_rate_log(path: str | Path) -> RateLog:
    """Read a log: a header, a column of TIMES, and one of RATES or ANGLES; comma, semicolon or tab between them."""
    first = open_text(path).head.splitlines()[0].decode("utf-8", "replace")
    decimal = "." if first.count(";") == 0 else _decimal(path)
    text = open_text(path, TextLayout(delimiter=max(",;\t", key=first.count), decimal=decimal))
    held = [name.strip() for name in text.names]
    named = [[name for name in held if name in table] for table in (TIMES, {**RATES, **ANGLES})]
    if any(len(names) != 1 for names in named):
        raise FileFormatError(
            f"{path}: wanted one column out of {', '.join(TIMES)} and one out of {', '.join((*RATES, *ANGLES))}, got "
            f"{', '.join(held)[:80]}; rename the columns"
        )
    (when,), (what,) = named
    table = parse_text(text, (text.names[held.index(when)], text.names[held.index(what)]))
    time, value = (table.numbers(text.names[held.index(name)]) for name in (when, what))
    whole = np.isfinite(time) & np.isfinite(value)
    time, value = time[whole] * TIMES[when], value[whole] * ({**RATES, **ANGLES}[what])
    if len(time) < 30 or not (np.diff(time) > 0.0).all():
        wrong = "fewer" if len(time) < 30 else f"one that does not after {time[np.argmin(np.diff(time) > 0.0)]:g} s"
        raise FileFormatError(f"{path}: wanted 30 rows or more whose time goes forward, got {wrong}; mend the log")
    apart = np.diff(np.unique(value))
    apart = apart[apart > ROUNDING * np.abs(value).max()]
    step = float(apart.min()) if len(apart) else 0.0
    if what in RATES:
        value = np.concatenate(([0.0], np.cumsum(0.5 * (value[1:] + value[:-1]) * np.diff(time))))
    elif value.min() > -1e-9 - np.pi and value.max() < 2.0 * np.pi + 1e-9:
        value = np.unwrap(value)
    return RateLog(name=str(path), time=time, angle=value, resolution=step, has_angle=what in ANGLES)


def _decimal(path: str | Path) -> str:
    """Return the decimal mark of a file with semicolons: a comma, where its first row has one."""
    return "," if b"," in open_text(path).head.splitlines()[1] else "."


def align_clocks(log: RateLog, record: Record, offset_s: float | None = None) -> Clocks:
    """Find offset and drift between the clock of a log and that of a recording; the offset may be known to a second."""
    if record.gyro is None:
        raise InputError(f"{log.name}: wanted a recording with a gyroscope to align by, got none; map its columns")
    rates = _rates(log)
    at, found = _lags(log, record, rates, _rough_offset(log, record, rates) if offset_s is None else offset_s)
    clocks = _line(at, found)
    if abs(clocks.drift) > max(LARGEST_DRIFT, 4.0 * clocks.drift_uncertainty):
        raise AlignmentError(
            f"{log.name}: wanted clocks that agree to {LARGEST_DRIFT:.0%}, got {clocks.drift:+.1%}; check the unit of time"
        )
    return clocks


def _rates(log: RateLog) -> PoseRates:
    step = np.diff(log.time)
    valid = step <= LONGEST_STEP * np.median(step)
    rate = np.where(valid, np.diff(log.angle) / step, 0.0)[:, None]
    return PoseRates(start=log.time[:-1], stop=log.time[1:], rate=rate, valid=valid)


ALIKE = 0.9  # of the best score: another shift may be the right one
APART_S = 2.0  # shifts nearer each other are one


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
    """Return recording less log, s, to a cell, or refuse where two shifts are as good."""
    shift = float(record.time[0] - log.time[0])  # first samples together, then every shift
    moved = PoseRates(start=rates.start + shift, stop=rates.stop + shift, rate=rates.rate, valid=rates.valid)
    longest = float(max(np.ptp(record.time), np.ptp(log.time)))
    best, score, lags = _scores(record.time, np.asarray(record.gyro), moved, longest)
    if best < LagSettings().least_correlation:
        raise AlignmentError(
            f"{log.name}: wanted the log of the table that turned this device, got a correlation of {best:.2f} at best; "
            "check that the two belong together"
        )
    first = int(np.argmax(score))
    rivals = np.flatnonzero((score > ALIKE * score[first]) & (np.abs(lags - lags[first]) > APART_S))
    if len(rivals):
        other = rivals[np.argmax(score[rivals])]
        raise AlignmentError(
            f"{log.name}: wanted one shift between the clocks, got {shift + lags[first]:.1f} and {shift + lags[other]:.1f} s "
            "alike; state it to a second: `rates_offset_s`"
        )
    return shift + float(lags[first])


def _lags(log: RateLog, record: Record, rates: PoseRates, rough: float) -> tuple[FloatArray, list[Lag]]:
    """Return the moments of the log at which a lag was found, and the lags, recording less log."""
    span = float(np.ptp(log.time))
    count = max(1, min(WINDOWS, int(span / WINDOW_S)))
    reach = LagSettings(longest_lag_s=APART_S + 0.5 * LARGEST_DRIFT * span, average_s=0.1)
    edges, at, lags = np.linspace(log.time[0], log.time[-1], count + 1), list[float](), list[Lag]()
    why = "no motion"
    for start, stop in pairwise(edges):
        inside = (rates.start >= start) & (rates.stop <= stop)
        near = (record.time >= start + rough - reach.longest_lag_s) & (
            record.time <= stop + rough + reach.longest_lag_s
        )
        if inside.sum() < 30 or near.sum() < 30:
            continue
        window = PoseRates(
            start=rates.start[inside] + rough,
            stop=rates.stop[inside] + rough,
            rate=rates.rate[inside],
            valid=rates.valid[inside],
        )
        try:
            time, gyro = record.time[near], np.asarray(record.gyro)[near]
            _, score, shifts = _scores(time, gyro, window, reach.longest_lag_s)
            lag = lag_of(time, gyro, window, reach, near=float(shifts[np.argmax(score)]))
        except AlignmentError as error:
            why = str(error)
            continue
        if np.isfinite(lag.standard_uncertainty) and lag.standard_uncertainty < APART_S:
            moved = inside & (np.abs(rates.rate[:, 0]) > LEAST_RATE)
            at.append(float(rates.start[moved].mean()) if moved.any() else 0.5 * (start + stop))
            lags.append(lag)
    if not lags:
        raise AlignmentError(
            f"{log.name}: wanted turns that show how late it is, got none ({why[:120]}); log whole ramps"
        )
    return np.array(at), [replace(lag, seconds=rough + lag.seconds) for lag in lags]


UNKNOWN_DRIFT = 1e-4  # of two quartz clocks that one window cannot compare
FLOOR_S = 1e-3  # of a lag: what the shape of a ramp hides
JUMP_S = 0.3


def _line(at: FloatArray, lags: Sequence[Lag]) -> Clocks:
    """Fit a straight line to the lags; its uncertainty has their scatter in it."""
    lag = np.array([each.seconds for each in lags])
    weight = 1.0 / np.hypot([each.standard_uncertainty for each in lags], FLOOR_S) ** 2
    middle = float(weight @ at / weight.sum())
    away = at - middle
    square = float(weight @ away**2)
    observable = len(at) >= 2 and square > 0.0
    offset = float(weight @ lag / weight.sum())
    drift = float(weight @ (away * (lag - offset)) / square) if observable else 0.0
    miss = lag - offset - drift * away
    if np.abs(miss).max() > JUMP_S:
        worst = int(np.argmax(np.abs(miss)))
        raise AlignmentError(
            f"clocks: wanted one offset and drift along the log, got a lag {miss[worst]:+.2f} s off the line at {at[worst]:.0f} s; "
            "a clock jumped, or readings are missing: cut the files there"
        )
    spread = max(1.0, float(weight @ miss**2) / (len(at) - 2)) if len(at) > 2 else 1.0
    return Clocks(
        offset_s=offset,
        drift=drift,
        middle_s=middle,
        offset_uncertainty_s=float(np.sqrt(spread / weight.sum())),
        drift_uncertainty=float(np.sqrt(spread / square)) if observable else UNKNOWN_DRIFT,
        windows=len(at),
        correlation=min(each.correlation_after for each in lags),
    )


# ---- dwells

RAMP_S = 3.0  # beside a dwell: in it the rate changes


def cut_dwells(log: RateLog, records: Sequence[tuple[Record, Clocks]]) -> tuple[tuple[LoggedTurn, ...], int]:
    """Return the steady dwells of a log on the recordings, and how many were left out as too uncertain or not recorded."""
    turns, missed, senses = list[LoggedTurn](), 0, dict[float, str]()
    for first, last in steady_stretches(log):
        inner = np.searchsorted(log.time, (log.time[first] + SETTLE_S, log.time[last - 1] - SETTLE_S))
        turn_rate, uncertainty = _achieved(log, int(inner[0]), int(inner[1]))
        if uncertainty > LARGEST_UNCERTAINTY * abs(turn_rate):
            missed += 1
            continue
        before = len(turns)
        for number, (record, clocks) in enumerate(records):
            found = _on(record, clocks, (log, first, last))
            if found is None:
                continue
            begin, end, axis, sign = found
            turn = Turn(start=begin, stop=end, axis=AXES[axis], turn_rate=sign * turn_rate, recording=number)
            turns.append(LoggedTurn(turn=turn, uncertainty=uncertainty))
            if record.accel is not None:
                up = np.nanmean(record.accel[begin:end], axis=0)
                if abs(up[axis]) > 0.9 * np.linalg.norm(up):
                    senses.setdefault(sign * float(np.sign(up[axis])), AXES[axis])
        missed += len(turns) == before
    if len(senses) > 1:
        one, other = senses.values()
        raise InputError(
            f"{log.name}: wanted gyroscopes that all take the table's positive sense alike, got {one} and {other} opposite; check "
            "the signs of the columns, or of the log between mountings"
        )
    return tuple(turns), missed


def steady_stretches(log: RateLog) -> list[tuple[int, int]]:
    """Return the stretches [first, last) of a log at one rate, resting left out."""
    step = np.diff(log.time)
    typical = float(np.median(step))
    width = max(1, round(0.2 / typical))
    rate = (log.angle[width:] - log.angle[:-width]) / (log.time[width:] - log.time[:-width])
    noise = 2.0 * log.resolution / (width * typical) if log.has_angle else 2.0 * log.resolution
    breaks = np.cumsum(np.concatenate(([False], step > 5.0 * typical)))
    whole = breaks[width:] == breaks[:-width]
    shortest = max(3, int((2.0 * SETTLE_S + LEAST_S) / typical / 2.0))
    stretches = list[tuple[int, int]]()
    for start, stop in runs(whole & (np.abs(rate) > LEAST_RATE)):
        k = int(start)
        while k < stop:
            level = float(np.median(rate[k : k + max(3, 2 * width)]))
            limit, first = STEADY * abs(level) + noise, min(stop, k + shortest)
            if (np.abs(rate[k:first] - level) > limit).any():  # a ramp: one step on
                k += max(1, width // 4)
                continue
            inside = np.abs(rate[k:stop] - level) <= limit
            end = k + (int(np.argmin(inside)) if not inside.all() else len(inside))
            if end - k >= 3 and log.time[end + width - 1] - log.time[k] >= 2.0 * SETTLE_S + LEAST_S:
                stretches.append((k, end + width))
                k = end + width
            else:
                k += max(1, (end - k) // 2)
    return stretches


def _achieved(log: RateLog, first: int, last: int) -> tuple[float, float]:
    """Return the rate of a stretch and its standard uncertainty: a line through the angles, and the steps of their resolution."""
    t, phi = log.time[first:last], log.angle[first:last]
    away = t - t.mean()
    square = float(away @ away)
    slope = float(away @ phi) / square
    left = phi - phi.mean() - slope * away
    scatter = float(np.sqrt(left @ left / (len(t) - 2) / square))
    coarse = log.resolution / float(np.ptp(t)) if log.has_angle else log.resolution
    return slope, float(np.hypot(scatter, coarse / np.sqrt(6.0 if log.has_angle else 12.0)))


def _on(record: Record, clocks: Clocks, stretch: tuple[RateLog, int, int]) -> tuple[int, int, int, float] | None:
    """Return samples, axis and sign of a dwell on a recording; None where the recording does not hold it.

    Axis and sign are those of the gyroscope that follows the log over the dwell and the ramps at its ends.
    """
    log, first, last = stretch
    ends = (float(log.time[first]), float(log.time[last - 1]))
    start, stop = (
        clocks.recorded(end) + sign * (SETTLE_S + 3.0 * clocks.uncertainty_s(end))
        for end, sign in zip(ends, (1.0, -1.0), strict=True)
    )
    start, stop = max(start, float(record.time[0])), min(stop, float(record.time[-1]))
    if stop - start < LEAST_S:
        return None
    begin, end = (int(k) for k in np.searchsorted(record.time, (start, stop)))
    inside = np.isfinite(np.asarray(record.gyro)[begin:end]).all(axis=1)
    if inside.sum() < 10 or inside.mean() < 0.8:
        return None
    pad = SETTLE_S + RAMP_S
    near = slice(*np.searchsorted(record.time, (clocks.recorded(ends[0]) - pad, clocks.recorded(ends[1]) + pad)))
    shown = np.asarray(record.gyro)[near]
    # the angle of the log at the recording's samples, and its rate between them
    known = clocks.middle_s + (record.time[near] - clocks.recorded(clocks.middle_s)) / (1.0 + clocks.drift)
    rate = np.gradient(np.interp(known, log.time, log.angle), known)
    whole = np.isfinite(shown).all(axis=1)
    rate, shown = rate[whole] - rate[whole].mean(), shown[whole] - shown[whole].mean(axis=0)
    follows = rate @ shown
    axis = int(np.argmax(np.abs(follows)))
    return begin, end, axis, float(np.sign(follows[axis]))
