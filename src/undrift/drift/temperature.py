"""Temperature of the sensors in a recording: checked, smoothed over time, and the lag of the thermometer subtracted.

A board thermometer comes noisy, in steps of up to 1 degC, with gaps, stale or on the wrong scale. What a fit cannot use raises;
what needs care is a finding; the rest is smoothed.

Noise that blurs the steps is smoothed by a moving mean, over 30 s or as much less as leaves 0.02 K of it. Steps that no noise blurs
tell only when they change: there the temperature is midway between two steps, and it is interpolated between those moments.

A thermometer lags the sensors, T_m' = (T - T_m) / tau. The lag stays in the smooth course, and is subtracted from it::

    in use      y = (tau s + 1) / (tau_f s + 1) T_m     causal, over uneven steps; leaves the lag tau_f
    for a fit   T = T_m + tau T_m'                      of a temperature smoothed over time: nothing is left

The lead makes the noise of one reading tau / tau_f times as large; its slow part, which alone turns into angle, stays as it was.

The time constant comes from the sensors themselves. A block of rest at reading T_m and slope T_m' was at T = T_m + tau T_m'.
Per axis::

    y = f(T_m + tau T_m') + m_pose + h d + w exp(-t / t_w)      f a cubic spline; d = +1 cooling, -1 warming; t since power-on

tau has the least residual: the profile of n_eff sum over axes of log(residual), f, m, h, w fitted anew at each. A hysteresis h does
not depend on the speed of the ramp and a lag does, so that ramps of two speeds separate them and one does not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, frozen
from undrift.drift.observe import RestBlocks
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.curve import Cubics
from undrift.record import Session, Still, Turn

BOARD_C = (-40.0, 125.0)  # where parts of a board work
OFF_SET_POINT_C = 5.0  # between the column and a stated set-point: another scale
STALE_S = 30.0  # a value that stays this long and then jumps was not measured meanwhile
JUMP_SIDE = 5  # readings on either side of a jump
SET_POINT_UNCERTAINTY_C = 0.5  # standard uncertainty of a stated set-point, K
HOT_C = 45.0  # above it all along: no room, and no body
COARSE_C = 0.5
SPIKE = 8.0 * 1.4826  # times the median distance from the running median: eight standard deviations
LEAST_SPIKE_C = 0.5
WINDOW_S, LEAST_REACH_S = 30.0, 1.0  # longest window of the moving mean, and half of the shortest
KNOWN_TO_C = 0.02  # the window is as long as the mean needs for this standard deviation: a longer one blurs fast ramps
QUIET = 0.05  # of a step: noise below does not repeat its changes
BLURRED = 0.35  # of a step: where the scatter of readings, steps included, is larger, their mean shows no step
SAME_STEP = 0.02  # of a step: how far a column may be from whole steps
# ---- and of the lag
RAMP_C_PER_MIN = 1.0  # at which noise and the lag left are balanced
AT_ONCE = 1e-300  # s: a low-pass so fast that it is not there
NODE_C = 5.0  # between the spline's knots
MOST_KNOTS = 16
FEWEST = 24  # blocks
MOVING_C_PER_MIN = 0.1
TWO_SPEEDS = 1.5  # fast over slow
TURN_C = 4.0  # K after a turn, over which a hysteresis is still changing: excluded where other blocks remain
WARM_UP_S = 600.0  # time constant of the power-on transient that is fitted with the lag
BOTH_WAYS = 0.1  # of the variance of the slopes that the temperature must leave open
_STRAY = 6.0  # standard deviations of a reading: further from the smooth course is a stray
_LEAST_NOISE_C = 0.05

Source = Literal["column", "set-points", "means"]  # means: rows of a table of set-points


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureSettings:
    """How a temperature is taken."""

    least_span_c: float = 2.0  # span of all recordings together, K; see check_span
    longest_gap_s: float = 10.0  # gaps up to this are interpolated; longer ones stay NaN
    most_missing: float = 0.5  # share of the readings that may be missing, 0 to 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Temperature:
    """The temperature of one recording, N samples."""

    temp_c: FloatArray  # (N,), smooth course, degC; NaN where it is not known
    # Standard uncertainty of the course, root-mean-square, K; the thermometer's own offset and lag are not in it
    uncertainty_c: float
    noise_c: float  # standard deviation of one reading, K; 0 for set-points
    step_c: float  # step in which the readings come, K; 0 where there is none
    source: Source
    findings: tuple[Finding, ...]  # what looks wrong

    def __post_init__(self) -> None:
        object.__setattr__(self, "temp_c", frozen(self.temp_c, (None,), "temp_c"))


def trusted_temperature(
    session: Session, index: int, *, settings: TemperatureSettings = TemperatureSettings()
) -> Temperature:
    """Return the temperature of one recording, smoothed, with what looks wrong about it."""
    if not 0 <= index < len(session.records):
        raise InputError(f"temperature: wanted recording 0 to {len(session.records) - 1}, got {index}")
    record = session.records[index]
    if session.means:  # rows that are means
        if record.temp_c is None:
            raise InputError(
                f"temperature of recording {index}: wanted the column of the set-points, got none; state columns.temp"
            )
        return _as_stated(record.temp_c, record.time, index, "means")
    pieces: list[Still | Turn] = [*session.stills, *session.turns]
    stated = [
        (slice(piece.start, piece.stop), piece.temp_c)
        for piece in pieces
        if piece.recording == index and piece.temp_c is not None
    ]
    if record.temp_c is not None:
        return _from_column(record.temp_c, record.time, stated, index, settings)
    if not stated:
        raise InputError(
            f"temperature of recording {index}: wanted a column (columns.temp) or set-points (temp_c of its stills and turns), got "
            "neither; map the thermometer's column or state temp_c"
        )
    temp_c = np.full(len(record), np.nan)
    for rows, set_point in stated:
        temp_c[rows] = set_point
    warned = finding("drift.temperature_set_points", "warn", recording=index, pieces=len(stated))
    return _as_stated(temp_c, record.time, index, "set-points", warned)


def _as_stated(temp_c: FloatArray, time: FloatArray, index: int, source: Source, *findings: Finding) -> Temperature:
    _check_board(temp_c, time, index)
    return Temperature(
        temp_c=temp_c, uncertainty_c=SET_POINT_UNCERTAINTY_C, noise_c=0.0, step_c=0.0, source=source, findings=findings
    )


def check_span(temperatures: Sequence[Temperature], *, settings: TemperatureSettings = TemperatureSettings()) -> float:
    """Return the span of temperatures together; raise where it is too small for a thermal fit."""
    known = np.concatenate([found.temp_c[np.isfinite(found.temp_c)] for found in temperatures])
    if not len(known):
        raise NotObservable("thermal drift: wanted a recording with a known temperature, got none; map its column")
    low, high = float(known.min()), float(known.max())
    span = high - low
    if span == 0.0:
        raise NotObservable(
            f"thermal drift: wanted temperatures that differ, got {low:.2f} degC throughout (constant); check that the column is "
            "the thermometer's, and record while the device warms",
            span_c=span,
        )
    if span < settings.least_span_c:
        raise NotObservable(
            f"thermal drift: wanted a span of {settings.least_span_c:g} degC or more, got {span:.2g} ({low:.2f} to {high:.2f}); "
            "record while the device warms or cools further",
            span_c=span,
        )
    return span


def _from_column(
    raw: FloatArray, time: FloatArray, stated: list[tuple[slice, float]], index: int, settings: TemperatureSettings
) -> Temperature:
    finite = np.isfinite(raw)
    missing = 1.0 - float(finite.mean())
    if missing > settings.most_missing or finite.sum() < 2:
        raise InputError(
            f"temperature of recording {index}: wanted readings in {100 * (1 - settings.most_missing):g} % of the rows or more, "
            f"got {int(finite.sum())} of {len(raw)} (the others NaN); map another column or leave it out and state set-points",
            missing=missing,
        )
    _check_board(raw, time, index)
    step, notes = step_of(raw[finite]), list[Finding]()
    spikes = _spikes(raw, step)
    if spikes.any():
        size = np.ptp(raw[spikes | np.roll(spikes, 1)])
        first, count = time[spikes][0], spikes.sum()
        notes.append(
            finding("drift.temperature_spikes", "info", recording=index, count=count, first_s=first, largest_c=size)
        )
    stale, repeated = _stale(np.where(spikes, np.nan, raw), time, step, index)
    used = finite & ~spikes & ~stale
    noise = noise_of(raw[used], step)
    course, uncertainty = _course(raw[used], time[used], step, noise)
    notes += [*repeated, *_suspicious(raw[used], time[used], step, noise, index), *_off_set_points(raw, stated, index)]
    temp_c = np.full(len(time), np.nan)
    temp_c[used] = course

    gone = np.flatnonzero(~used)
    if len(gone):
        ends = np.concatenate(([-np.inf], time[used], [np.inf]))
        after = np.searchsorted(ends, time[gone])
        short = gone[ends[after] - ends[after - 1] <= settings.longest_gap_s]
        temp_c[short] = np.interp(time[short], time[used], course)
        notes.append(
            finding(
                "drift.temperature_gaps",
                "info",
                recording=index,
                missing=len(gone),
                interpolated=len(short),
                longest_s=settings.longest_gap_s,
                left_out=len(gone) - len(short),
            )
        )
    return Temperature(
        temp_c=temp_c, uncertainty_c=uncertainty, noise_c=noise, step_c=step, source="column", findings=tuple(notes)
    )


def _check_board(temp_c: FloatArray, time: FloatArray, index: int) -> None:
    bad = np.flatnonzero((temp_c < BOARD_C[0]) | (temp_c > BOARD_C[1]))
    if len(bad):
        raise InputError(
            f"temperature of recording {index}: wanted {BOARD_C[0]:g} to {BOARD_C[1]:g} degC of a board, got "
            f"{temp_c[bad[0]]:g} degC at {time[bad[0]]:.6g} s ({len(bad)} such); check units.temp and scale.temp",
            temp_c=float(temp_c[bad[0]]),
        )


# ---- plausibility


def _spikes(temp_c: FloatArray, step_c: float) -> BoolArray:
    """Mark readings that lie apart from those before and after, (N,)."""
    from scipy.ndimage import median_filter

    known = np.isfinite(temp_c)
    spikes = np.zeros(len(temp_c), dtype=bool)
    if known.sum() >= 5:
        off = np.abs(temp_c[known] - median_filter(temp_c[known], size=5, mode="nearest"))
        spikes[known] = off > max(SPIKE * float(np.median(off)), 2.5 * step_c, LEAST_SPIKE_C)
    return spikes


def _stale(temp_c: FloatArray, time: FloatArray, step_c: float, index: int) -> tuple[BoolArray, list[Finding]]:
    """Mark readings that repeat an old one, (N,)."""
    finite = np.flatnonzero(np.isfinite(temp_c))
    values, at = temp_c[finite], time[finite]
    first = np.flatnonzero(np.concatenate(([True], np.diff(values) != 0.0)))
    last = np.append(first[1:], len(values)) - 1
    stay = at[last] - at[first]
    jump = np.append(np.abs(np.diff(values[first])), 0.0)
    wait = np.append(at[first[1:]] - at[last[:-1]], 0.0)  # a gap between may have hidden the way
    sudden = (jump > max(1.5 * step_c, 0.2)) & (wait < 5.0 * float(np.median(np.diff(at))))
    lively = len(first) > 0.3 * len(values)  # noise changes most readings
    long = (stay >= STALE_S) & (sudden | lively)
    stale = np.zeros(len(temp_c), dtype=bool)
    for run in np.flatnonzero(long):
        stale[finite[first[run] + 1 : last[run] + 1]] = True
    if not long.any():
        return stale, []
    worst = int(np.flatnonzero(long)[np.argmax(stay[long])])
    return stale, [
        finding(
            "drift.temperature_stale",
            "info",
            recording=index,
            temp_c=values[first[worst]],
            duration_s=stay[worst],
            start_s=at[first[worst]],
            jump_c=jump[worst],
            count=int(long.sum()),
        )
    ]


def _suspicious(temp_c: FloatArray, time: FloatArray, step_c: float, noise_c: float, index: int) -> list[Finding]:
    """Look for coarse steps, jumps, and a temperature of no room."""
    findings: list[Finding] = []
    if step_c >= COARSE_C:
        findings.append(finding("drift.temperature_steps", "info", recording=index, step_c=step_c))
    if len(temp_c) >= 2 * JUMP_SIDE:  # medians of five readings that differ from the next five
        middle = np.median(np.lib.stride_tricks.sliding_window_view(temp_c, JUMP_SIDE), axis=1)
        change = np.abs(middle[JUMP_SIDE:] - middle[:-JUMP_SIDE])
        lasts = time[2 * JUMP_SIDE - 1 :] - time[: 1 - 2 * JUMP_SIDE]
        jumps = np.flatnonzero(change > np.maximum(np.maximum(lasts, 1.0), max(1.5 * step_c, 6.0 * noise_c)))
        if len(jumps):  # by more than a board changes, 1 K within a second
            groups = np.split(jumps, np.flatnonzero(np.diff(jumps) > JUMP_SIDE) + 1)
            first = time[groups[0][len(groups[0]) // 2] + JUMP_SIDE]  # medians differ while most of one side is past it
            size, count = change[jumps].max(), len(groups)
            findings.append(
                finding("drift.temperature_jumps", "info", recording=index, largest_c=size, first_s=first, count=count)
            )
    if temp_c.min() > HOT_C:
        low, high = temp_c.min(), temp_c.max()
        findings.append(finding("drift.temperature_hot", "warn", recording=index, low_c=low, high_c=high))
    return findings


def _off_set_points(raw: FloatArray, stated: list[tuple[slice, float]], index: int) -> list[Finding]:
    apart = [(float(np.nanmedian(raw[p])) - c, c) for p, c in stated if np.isfinite(raw[p]).any()]
    far = [pair for pair in apart if abs(pair[0]) > OFF_SET_POINT_C]
    if not far:
        return []
    off, at = max(far, key=lambda pair: abs(pair[0]))
    return [
        finding(
            "drift.temperature_off_set_point",
            "warn",
            recording=index,
            read_c=at + off,
            set_point_c=at,
            edge_c=at + np.copysign(OFF_SET_POINT_C, off),
            count=len(far),
            pieces=len(apart),
            limit_c=OFF_SET_POINT_C,
        )
    ]


# ---- the smooth course behind readings; temp_c (N,) degC, time (N,) s


def step_of(temp_c: FloatArray) -> float:
    """Return the step in which readings come."""
    values = np.unique(temp_c)
    if len(values) < 2 or len(values) > max(2, len(temp_c) // 4):
        return 0.0
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * np.abs(values).max()]
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    off = np.abs(gaps / step - np.round(gaps / step))
    return step if (off < SAME_STEP * np.maximum(gaps / step, 1.0)).mean() > 0.95 else 0.0


def noise_of(temp_c: FloatArray, step_c: float) -> float:
    """Return the standard deviation of one reading, from the differences of neighbours."""
    if len(temp_c) < 3:
        return 0.0
    bend = np.diff(temp_c, 2)
    size = np.sort(np.abs(bend))[: max(2, int(0.99 * len(bend)))]  # without what stands alone
    both = float(np.sqrt(np.mean(size**2) / 6.0))
    return both if step_c == 0.0 or both >= BLURRED * step_c else both**2 / step_c * math.sqrt(math.pi)


def _course(temp_c: FloatArray, time: FloatArray, step: float, noise: float) -> tuple[FloatArray, float]:
    """Return the smooth course behind readings and its standard uncertainty."""
    if len(temp_c) < 8 or np.ptp(temp_c) == 0.0:
        return temp_c, math.hypot(noise, step / math.sqrt(12.0))
    interval_s = float(np.median(np.diff(time)))
    window_s = float(np.clip(interval_s * (noise / KNOWN_TO_C) ** 2, 2.0 * LEAST_REACH_S, WINDOW_S))
    if step > 0.0 and noise < BLURRED * step:
        smooth = temp_c if noise < QUIET * step else moving_mean(temp_c, time, WINDOW_S)
        return _between_steps(smooth, time, step, float(temp_c[0])), step / math.sqrt(12.0)
    ripple = 0.0  # what noise s leaves of the steps in a mean: step / pi exp(-2 pi^2 s^2 / step^2), a sine of the temperature
    if step > 0.0:
        blur = max(noise**2 / step**2 - 1.0 / 12.0, 0.0)
        ripple = step / math.pi * math.exp(-2.0 * math.pi**2 * blur) / math.sqrt(2.0)
    return moving_mean(temp_c, time, window_s), math.hypot(noise / math.sqrt(max(window_s / interval_s, 1.0)), ripple)


def moving_mean(values: FloatArray, time: FloatArray, window_s: float) -> FloatArray:
    """Return the mean over a window around each sample, (N,). Near the ends the window shrinks on both sides: nothing shifts."""
    length = float(time[-1] - time[0])
    if length < 2.0 * LEAST_REACH_S or float(np.median(np.diff(time))) > LEAST_REACH_S:
        return values
    total = np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))))
    middle = np.clip(time, time[0] + LEAST_REACH_S, time[-1] - LEAST_REACH_S)
    reach = np.minimum(0.5 * window_s, np.minimum(middle - time[0], time[-1] - middle))
    mean = (np.interp(middle + reach, time, total) - np.interp(middle - reach, time, total)) / (2.0 * reach)
    return np.asarray(mean)


def _between_steps(temp_c: FloatArray, time: FloatArray, step: float, origin_c: float) -> FloatArray:
    """Return the course between the moments at which the temperature passes midway between two steps, (N,).

    Noise repeats a passage: passages of one height that lead across count once, at their mean time. Passages that lead back hold a
    turn between the first and the last.
    """
    code = np.round((temp_c - origin_c) / step)
    change = np.flatnonzero(np.diff(code))
    at, height = 0.5 * (time[change] + time[change + 1]), origin_c + 0.5 * step * (code[change] + code[change + 1])
    points = [(time[0], temp_c[0])]  # the record begins and ends in the middle of a step
    for group in np.split(np.arange(len(at)), np.flatnonzero(np.abs(np.diff(height)) > 0.1 * step) + 1):
        if len(group) % 2:
            points.append((at[group].mean(), height[group[0]]))
        elif len(group):
            longest = group[int(np.argmax(np.diff(at[group])))]
            turn = 0.5 * (at[longest] + at[longest + 1]), origin_c + step * code[change[longest] + 1]
            points += [(at[group[0]], height[group[0]]), turn, (at[group[-1]], height[group[0]])]
    points.append((time[-1], temp_c[-1]))
    moments, course = np.array(points).T
    return np.asarray(np.interp(time, moments, course))


# ---- lag of the thermometer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LagFit:
    """A thermometer's lag."""

    lag_s: float = 0.0  # time constant, s; 0 where it is not known
    uncertainty_s: float = math.inf  # standard uncertainty, s; infinite where it is not observable
    observable: bool = False  # False where the recording does not separate a lag from something else
    two_speeds: bool = False  # whether ramps of two speeds were seen: then hysteresis is not taken for lag
    # (k,), time constants tried, s; empty where none was
    lags_s: FloatArray = field(default_factory=lambda: np.empty(0))
    # (k,), twice the loss of log-likelihood against the best of them, 1
    misfit: FloatArray = field(default_factory=lambda: np.empty(0))
    findings: tuple[Finding, ...]  # why it is not observable


@dataclass(frozen=True, slots=True, kw_only=True)
class LagState:
    """What the lead carries from chunk to chunk."""

    time: float = math.nan  # Of the last reading, s; NaN before the first
    temp_c: float = math.nan  # The last reading, degC
    smooth_c: float = math.nan  # The reading behind the low-pass tau_f, degC
    output_c: float = math.nan  # The last temperature given out, degC; held where readings are NaN


# ---- subtract a lag


def without_lag(
    temp_c: FloatArray, time: FloatArray, *, lag_s: float, smooth_s: float, state: LagState | None = None
) -> tuple[FloatArray, LagState]:
    """Subtract the thermometer's lag, looking back only: a filter with state; (N,) degC over (N,) s."""
    from undrift.kernels.calibrate import lead

    _check_times(lag_s, smooth_s)
    x, t = (np.ascontiguousarray(v, dtype=np.float64) for v in (temp_c, time))
    if x.shape != t.shape or x.ndim != 1:
        raise InputError(
            f"lag: wanted a time for each temperature, got {t.shape} for {x.shape}; pass both of one record"
        )
    held = state or LagState()
    if len(t) and t[0] <= held.time:
        raise InputError(f"lag: wanted readings from after {held.time:.6g} s, got {t[0]:.6g} s; push chunks in order")
    carried = np.array([held.time, held.temp_c, held.smooth_c, held.output_c])
    y = np.empty_like(x)
    lead(x, t, y, lag_s, smooth_s or AT_ONCE, carried)
    at, last, low, output = (float(v) for v in carried)
    return y, LagState(time=at, temp_c=last, smooth_c=low, output_c=output)


def without_lag_smooth(temp_c: FloatArray, time: FloatArray, *, lag_s: float) -> FloatArray:
    """Subtract the lag from a temperature that is smooth over time, for a fit: ``T = T_m + tau dT_m/dt``."""
    _check_times(lag_s, 1.0)
    out = np.array(temp_c, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(out))
    if lag_s == 0.0 or len(known) < 2:
        return out
    for piece in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        if len(piece) >= 2:
            out[piece] += lag_s * np.gradient(out[piece], time[piece])
    return out


def default_smooth_s(lag_s: float, *, noise_c: float, interval_s: float, step_c: float = 0.0) -> float:
    """Return how much of the lag to leave, so that noise made larger and lag left weigh the same at 1 degC/min.

    The mean of a second has the noise n = noise sqrt(min(interval, 1 s) / 1 s); steps that no noise blurs add
    step / sqrt(12). The lead makes n tau / tau_f of it and leaves tau_f dT/dt: equal at tau_f = sqrt(n tau / (dT/dt)), kept
    between a twentieth and a half of tau and over one interval.
    """
    _check_times(lag_s, 1.0)
    if min(noise_c, step_c) < 0.0 or interval_s <= 0.0:
        raise InputError(
            f"lag: wanted noise and step of 0 K or more and an interval above 0 s, got {noise_c:g}, {step_c:g}, {interval_s:g}"
        )
    if lag_s == 0.0:
        return 0.0
    blurred = noise_c >= BLURRED * step_c
    white = math.hypot(noise_c, step_c / math.sqrt(12.0) if blurred else 0.0) * math.sqrt(min(interval_s, 1.0))
    noise = white if blurred else math.hypot(white, step_c / math.sqrt(12.0))
    return min(0.5 * lag_s, max(0.05 * lag_s, math.sqrt(noise * lag_s / (RAMP_C_PER_MIN / 60.0)), interval_s))


def _check_times(lag_s: float, smooth_s: float) -> None:
    if not (0.0 <= lag_s < math.inf and 0.0 <= smooth_s < math.inf):
        raise InputError(f"lag: wanted lag_s and smooth_s of 0 s or more, got {lag_s:g} and {smooth_s:g}")
    if lag_s > 0.0 and smooth_s == 0.0:
        raise InputError(f"lag: wanted smooth_s above 0 s to subtract {lag_s:g} s, got 0; default_smooth_s gives one")


def sensor_course(trusted: Sequence[Temperature], session: Session, lag_s: float) -> list[FloatArray]:
    """Return the temperature of the sensors in each recording: the thermometer's lag taken off where a thermometer was read."""
    return [
        t.temp_c if t.source != "column" else without_lag_smooth(t.temp_c, record.time, lag_s=lag_s)
        for t, record in zip(trusted, session.records, strict=True)
    ]


def met_in_use(
    sessions: Sequence[Session],
    trusted: Sequence[Sequence[Temperature]],
    course: Sequence[Sequence[FloatArray]],
    lag_s: float,
    smooth_s: float,
) -> list[FloatArray]:
    """Return the extremes, (2,) degC each, that ``correct`` would look up: readings are noisier than their smooth course."""
    ends: list[FloatArray] = []
    for session, own, smooth in zip(sessions, trusted, course, strict=True):
        for record, temperature, settled in zip(session.records, own, smooth, strict=True):
            if record.temp_c is None or temperature.source != "column":
                continue
            met, gain = record.temp_c, 1.0
            if lag_s > 0.0:
                met, gain = without_lag(met, record.time, lag_s=lag_s, smooth_s=smooth_s)[0], lag_s / smooth_s
            far = _STRAY * gain * max(temperature.noise_c, temperature.step_c, _LEAST_NOISE_C)
            near = met[np.abs(met - settled) <= far]  # a gap is near nothing
            if len(near):
                ends.append(np.array([near.min(), near.max()]))
    return ends


# ---- estimate a lag


def estimate_lag(blocks: RestBlocks, *, longest_s: float = 300.0) -> LagFit:
    """Find the time constant, up to a longest one, at which readings at one temperature agree whatever the ramp was."""
    ramp = blocks.ramp_c_per_min
    direction, way = _directions(blocks)
    moved = np.isfinite(blocks.temp_c) & np.isfinite(ramp) & (direction != 0.0)
    rows = moved & (way > TURN_C)
    if rows.sum() < FEWEST or len(np.unique(direction[rows])) < 2:
        rows = moved
    readings = _readings(blocks, rows)
    moving = np.abs(ramp[rows][np.abs(ramp[rows]) > MOVING_C_PER_MIN])
    if rows.sum() < FEWEST or readings.shape[1] == 0 or len(moving) < FEWEST:
        few = {"count": len(moving), "least_c_per_min": MOVING_C_PER_MIN, "wanted": FEWEST}
        return LagFit(findings=(finding("drift.lag_few_blocks", "info", **few),))
    temp, slope, pose = blocks.temp_c[rows], ramp[rows] / 60.0, blocks.pose[rows]
    poses = np.asarray(pose[:, None] == np.unique(pose)[1:], dtype=np.float64)
    q, _ = np.linalg.qr(np.hstack((_spline(temp), poses)))
    rest = ramp[rows] - q @ (q.T @ ramp[rows])
    left = float(rest @ rest / max(float(ramp[rows] @ ramp[rows]), 1e-12))
    if left < BOTH_WAYS:  # temperature and pose explain which way it went
        return LagFit(findings=(finding("drift.lag_one_way", "info", percent=100.0 * (1.0 - left)),))
    slow, fast = np.quantile(moving, (0.1, 0.9))
    two_speeds = bool(fast > TWO_SPEEDS * slow)
    fixed = [poses, direction[rows][:, None]] if two_speeds else [poses]
    power_on = np.exp(-blocks.power_on_s[rows] / WARM_UP_S)
    if np.ptp(power_on) > 0.1:
        fixed.append(power_on[:, None])

    def residual(lag: float) -> FloatArray:
        q, r = np.linalg.qr(np.hstack((_spline(temp + lag * slope), *fixed)))
        q = q[:, np.abs(np.diag(r)) > 1e-9 * np.abs(r).max()]
        return np.asarray(readings - q @ (q.T @ readings))

    def losses(lags: FloatArray) -> FloatArray:
        return np.array([float(np.log(np.mean(residual(lag) ** 2, axis=0)).sum()) for lag in lags])

    coarse = np.concatenate(([0.0], np.geomspace(1.0, longest_s, 40)))
    best = int(losses(coarse).argmin())
    around = np.linspace(coarse[max(best - 1, 0)], coarse[min(best + 1, len(coarse) - 1)], 25)
    lags = np.unique(np.concatenate((coarse, around)))
    loss = losses(lags)
    best = int(loss.argmin())
    return _judged(float(lags[best]), lags, _independent(residual(lags[best])) * (loss - loss[best]), two_speeds)


def _judged(lag: float, lags: FloatArray, misfit: FloatArray, two_speeds: bool) -> LagFit:
    i = min(max(int(misfit.argmin()), 1), len(lags) - 2)
    curve, tilt, _ = np.polyfit(lags[i - 1 : i + 2] - lag, misfit[i - 1 : i + 2], 2)
    uncertainty = 1.0 / float(np.sqrt(curve)) if curve > 0.0 else float(np.ptp(lags[misfit <= 1.0]))
    if curve > 0.0:
        lag = float(np.clip(lag - 0.5 * tilt / curve, lags[i - 1], lags[i + 1]))
    findings: tuple[Finding, ...] = ()
    at_end = bool(misfit[-1] <= 4.0)  # within two standard deviations
    if at_end:
        findings = (finding("drift.lag_unbounded", "info", longest_s=lags[-1]),)
    elif not two_speeds:
        findings = (finding("drift.lag_or_hysteresis", "info", lag_s=lag),)
    return LagFit(
        lag_s=0.0 if at_end else lag,
        uncertainty_s=uncertainty if two_speeds and not at_end else float("inf"),
        observable=two_speeds and not at_end,
        two_speeds=two_speeds,
        lags_s=lags,
        misfit=misfit,
        findings=findings,
    )


def _readings(blocks: RestBlocks, kept: BoolArray) -> FloatArray:
    """Return the axes that depend on temperature, each with unit spread, shape (n, a)."""
    one_pose = all(len(np.unique(blocks.pose[blocks.session == s])) == 1 for s in np.unique(blocks.session))
    columns = (np.hstack((blocks.gyro, blocks.accel)) if one_pose else blocks.gyro)[kept]
    if len(columns) == 0:
        return np.empty((0, 0))
    columns = columns[:, np.isfinite(columns).all(axis=0)]
    spread = columns.std(axis=0)
    lively = columns[:, spread > 0.0]
    return np.asarray((lively - lively.mean(axis=0)) / spread[spread > 0.0])


def _directions(blocks: RestBlocks) -> tuple[FloatArray, FloatArray]:
    """Return -1 warming, +1 cooling, 0 before the first K, and the way since the last turn, K, shape (n,) each."""
    direction, way = np.zeros(len(blocks)), np.zeros(len(blocks))
    for session in np.unique(blocks.session):
        rows = np.flatnonzero((blocks.session == session) & np.isfinite(blocks.temp_c))
        temp = blocks.temp_c[rows]
        turns, signs = _turns(temp)
        for (start, stop), sign in zip(pairwise((*turns, len(temp))), signs, strict=True):
            leg = temp[start:stop]
            direction[rows[start:stop]] = sign
            since = np.abs(leg - leg[0])
            way[rows[start:stop]] = np.where(since.max() - since < 1.0, 0.0, since) if stop < len(temp) else since
    return direction, way


def _turns(temp: FloatArray) -> tuple[list[int], list[float]]:
    """Return where each leg begins and its sign: -1 warming, +1 cooling; none where it moved by less than a kelvin."""
    turns: list[int] = []
    signs: list[float] = []
    low = high = 0  # rows of the extremes since the last turn
    for k, value in enumerate(temp):
        low = k if value < temp[low] else low
        high = k if value > temp[high] else high
        sign = signs[-1] if signs else 0.0
        if sign <= 0.0 and value < temp[high] - 1.0:
            turns.append(high if signs else 0)
            signs.append(1.0)
            low = k
        elif sign >= 0.0 and value > temp[low] + 1.0:
            turns.append(low if signs else 0)
            signs.append(-1.0)
            high = k
    return turns, signs


def _spline(temp: FloatArray) -> FloatArray:
    """Return a cubic spline basis over the temperatures, (n, k)."""
    low, high = float(temp.min()), float(temp.max()) + 1e-9
    return Cubics(low=low, high=high, intervals=int(np.clip(round((high - low) / NODE_C), 1, MOST_KNOTS))).at(temp)


def _independent(residual: FloatArray) -> float:
    """Return how many independent blocks the residuals are worth, by the correlation of neighbours."""
    before, after = residual[:-1], residual[1:]
    rho = float((before * after).sum() / max(float((residual**2).sum()), 1e-300))
    rho = min(max(rho, 0.0), 0.99)
    return max(len(residual) * (1.0 - rho) / (1.0 + rho), 4.0)
