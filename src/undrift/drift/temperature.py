"""Temperature of the sensors in a recording: checked, smoothed over time, and the lag of the thermometer subtracted.

A board thermometer comes noisy, in steps of up to 1 degC, with gaps, stale or on the wrong scale. A temperature that a fit cannot
use raises an error; one that needs care is a finding; the rest is smoothed.

Noise that blurs the steps is smoothed by a moving mean, over 30 s or as much less as leaves 0.02 K of it. Steps that no noise blurs
carry information only when they change: there the temperature is midway between two steps, and it is interpolated between.

A thermometer lags the sensors, T_m' = (T - T_m) / tau. The lag is subtracted from the smooth course::

    in use      y = (tau s + 1) / (tau_f s + 1) T_m     causal, over uneven steps; leaves the lag tau_f
    for a fit   T = T_m + tau T_m'                      of a temperature smoothed over time: nothing is left

The lead makes the noise of one reading tau / tau_f times as large; its slow part, which alone turns into angle, stays as it was.

The time constant comes from the sensors themselves. A block of rest at reading T_m and slope T_m' was at T = T_m + tau T_m'.
Per axis::

    y = f(T_m + tau T_m') + m_pose + h c + w exp(-t / t_w)      f a cubic spline; c = +1 cooling, -1 warming; t since power-on

tau has the least residual: the profile of n_eff sum over axes of log(residual), with f, m, h, w fitted at each tau. A hysteresis h
does not depend on the speed of the ramp and a lag does, so ramps of two speeds separate them and one does not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, frozen
from undrift.drift.observe import RestBlocks
from undrift.drift.offset import CROSSED_C, cooling
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.curve import Cubics
from undrift.record import Session, Still, Turn

LEAST_SPAN_C = 2.0  # of all recordings together
LONGEST_GAP_S = 10.0  # gaps up to this are interpolated; longer ones stay NaN
MOST_MISSING = 0.5  # share of the readings that may be missing
BOARD_C = (-40.0, 125.0)  # where parts of a board work
OFF_SET_POINT_C = 5.0  # between the column and a stated set-point: another scale
STALE_S = 30.0  # a value that stays this long and then jumps was not measured meanwhile
HOT_C = 45.0  # above it all along: no room, and no body
SPIKE = 8.0 * 1.4826  # times the median distance from the running median: eight standard deviations
LEAST_SPIKE_C = 0.5
WINDOW_S, LEAST_REACH_S = 30.0, 1.0  # longest window of the moving mean, and half of the shortest
KNOWN_TO_C = 0.02  # the window is as long as the mean needs for this standard deviation: a longer one blurs fast ramps
QUIET = 0.05  # of a step: noise below does not repeat its changes
BLURRED = 0.35  # of a step: if the scatter of readings, steps included, is larger, their mean shows no step
SAME_STEP = 0.02  # of a step: how far a column may be from whole steps
# ---- and of the lag
RAMP_C_PER_MIN = 1.0  # at which noise and the lag left are balanced
AT_ONCE = 1e-300  # s: a low-pass so fast that it is not there
NODE_C = 5.0  # between the spline's knots
MOST_KNOTS = 16
FEWEST = 24  # blocks
MOVING_C_PER_MIN = 0.1
TWO_SPEEDS = 1.5  # fast over slow
WARM_UP_S = 600.0  # time constant of the power-on transient that is fitted with the lag
BOTH_WAYS = 0.1  # of the variance of the slopes that the temperature must leave open
_STRAY = 6.0  # standard deviations of a reading: further from the smooth course is a stray
_LEAST_NOISE_C = 0.05

Source = Literal["column", "set-points", "means"]  # means: rows that are means over set-points


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Temperature:
    """The temperature of one recording, N samples."""

    temp_c: FloatArray  # (N,), smooth course, degC; NaN if it is not known
    noise_c: float  # standard deviation of one reading, K; 0 for set-points
    step_c: float  # step in which the readings come, K; 0 if there is none
    source: Source
    findings: tuple[Finding, ...]  # doubts about the column

    def __post_init__(self) -> None:
        object.__setattr__(self, "temp_c", frozen(self.temp_c, (None,), "temp_c"))


def trusted_temperature(session: Session, index: int) -> Temperature:
    """Return the temperature of one recording, smoothed, with findings on what looks wrong."""
    record = session.records[index]
    pieces: list[Still | Turn] = [*session.stills, *session.turns]
    set_points = [
        (slice(piece.start, piece.stop), piece.temp_c)
        for piece in pieces
        if piece.recording == index and piece.temp_c is not None
    ]
    temp_c = record.temp_c
    if temp_c is not None and not session.means:
        return _from_column(temp_c, record.time, set_points, index)
    if temp_c is None:
        if not set_points:
            raise InputError(
                f"temperature of recording {index}: there is neither a column (columns.temp) nor a set-point (temp_c of stills and "
                "turns). Map the thermometer's column or state temp_c."
            )
        temp_c = np.full(len(record), np.nan)
        for rows, set_point in set_points:
            temp_c[rows] = set_point
    _check_board(temp_c, record.time, index)
    return Temperature(
        temp_c=temp_c,
        noise_c=0.0,
        step_c=0.0,
        source="means" if session.means else "set-points",
        findings=(),
    )


def check_span(temperatures: Sequence[Temperature]) -> float:
    """Return the span of temperatures together, K; raise if it is too small for a thermal fit."""
    known = np.concatenate([temperature.temp_c[np.isfinite(temperature.temp_c)] for temperature in temperatures])
    if not len(known):
        raise NotObservable("thermal drift: no recording has a known temperature. Map its column.")
    low, high = float(known.min()), float(known.max())
    if high - low < LEAST_SPAN_C:
        constant = " (constant): check that the column is the thermometer's" if low == high else ""
        raise NotObservable(
            f"thermal drift: the temperatures span {high - low:.2g} degC ({low:.2f} to {high:.2f}){constant}. Record "
            f"{LEAST_SPAN_C:g} degC or more, while the device warms or cools.",
            span_c=high - low,
        )
    return high - low


def _from_column(
    readings: FloatArray, time: FloatArray, set_points: list[tuple[slice, float]], index: int
) -> Temperature:
    finite = np.isfinite(readings)
    if finite.mean() < 1.0 - MOST_MISSING or finite.sum() < 2:
        raise InputError(
            f"temperature of recording {index}: only {finite.sum()} of {len(readings)} rows have a reading. Map another column, or "
            "leave it out and state set-points.",
            missing=1.0 - float(finite.mean()),
        )
    _check_board(readings, time, index)
    step, findings = step_of(readings[finite]), list[Finding]()
    spikes = _spikes(readings, step)
    stale = _stale(np.where(spikes, np.nan, readings), time, step)
    used = finite & ~spikes & ~stale
    noise = noise_of(readings[used], step)
    known_c, known_s = readings[used], time[used]
    longest_s = max(LONGEST_GAP_S, 3.0 * float(np.median(np.diff(known_s))))
    parts = np.split(np.arange(len(known_s)), np.flatnonzero(np.diff(known_s) > longest_s) + 1)
    # each side of a long pause by itself: the soak before it does not reach the soak after it
    course = np.concatenate([_course(known_c[rows], known_s[rows], step, noise) for rows in parts])
    temp_c = np.full(len(time), np.nan)
    temp_c[used] = course
    gone = np.flatnonzero(~used)
    if len(gone):
        ends = np.concatenate(([-np.inf], time[used], [np.inf]))
        after = np.searchsorted(ends, time[gone])
        short = gone[ends[after] - ends[after - 1] <= LONGEST_GAP_S]
        temp_c[short] = np.interp(time[short], time[used], course)
        findings.append(
            finding(
                "drift.temperature_left_out",
                "info",
                recording=index,
                missing=int((~finite).sum()),
                spikes=int(spikes.sum()),
                stale=int(stale.sum()),
                interpolated=len(short),
                rows=len(time),
            )
        )
    low, high = float(readings[used].min()), float(readings[used].max())
    if low > HOT_C:
        findings.append(finding("drift.temperature_hot", "warn", recording=index, low_c=low, high_c=high))
    apart = [(float(np.nanmedian(readings[p])) - c, c) for p, c in set_points if np.isfinite(readings[p]).any()]
    off, set_point = max(apart, key=lambda pair: abs(pair[0]), default=(0.0, 0.0))
    if abs(off) > OFF_SET_POINT_C:
        edge_c = set_point + math.copysign(OFF_SET_POINT_C, off)
        values = {"read_c": set_point + off, "set_point_c": set_point, "limit_c": OFF_SET_POINT_C, "edge_c": edge_c}
        findings.append(finding("drift.temperature_off_set_point", "warn", recording=index, **values))
    return Temperature(temp_c=temp_c, noise_c=noise, step_c=step, source="column", findings=tuple(findings))


def _check_board(temp_c: FloatArray, time: FloatArray, index: int) -> None:
    bad = np.flatnonzero((temp_c < BOARD_C[0]) | (temp_c > BOARD_C[1]))
    if len(bad):
        raise InputError(
            f"temperature of recording {index}: {temp_c[bad[0]]:g} degC at {time[bad[0]]:.6g} s ({len(bad)} such) is outside "
            f"{BOARD_C[0]:g} to {BOARD_C[1]:g} degC. Check units.temp and scale.temp.",
            temp_c=float(temp_c[bad[0]]),
        )


def _spikes(temp_c: FloatArray, step_c: float) -> BoolArray:
    """Mark readings that lie apart from those before and after, (N,)."""
    from scipy.ndimage import median_filter

    known = np.isfinite(temp_c)
    spikes = np.zeros(len(temp_c), dtype=bool)
    if known.sum() >= 5:
        off = np.abs(temp_c[known] - median_filter(temp_c[known], size=5, mode="nearest"))
        spikes[known] = off > max(SPIKE * float(np.median(off)), 2.5 * step_c, LEAST_SPIKE_C)
    return spikes


def _stale(temp_c: FloatArray, time: FloatArray, step_c: float) -> BoolArray:
    """Mark readings that repeat an old one, (N,)."""
    finite = np.flatnonzero(np.isfinite(temp_c))
    values, at = temp_c[finite], time[finite]
    first = np.flatnonzero(np.concatenate(([True], np.diff(values) != 0.0)))
    last = np.append(first[1:], len(values)) - 1
    jump = np.append(np.abs(np.diff(values[first])), 0.0)
    wait = np.append(at[first[1:]] - at[last[:-1]], 0.0)  # a gap between may have hidden the way
    sudden = (jump > max(1.5 * step_c, 0.2)) & (wait < 5.0 * float(np.median(np.diff(at))))
    lively = len(first) > 0.3 * len(values)  # noise changes most readings
    stale = np.zeros(len(temp_c), dtype=bool)
    for run in np.flatnonzero((at[last] - at[first] >= STALE_S) & (sudden | lively)):
        stale[finite[first[run] + 1 : last[run] + 1]] = True
    return stale


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


def _course(temp_c: FloatArray, time: FloatArray, step: float, noise: float) -> FloatArray:
    """Return the smooth course behind readings."""
    if len(temp_c) < 8 or np.ptp(temp_c) == 0.0:
        return temp_c
    if step > 0.0 and noise < BLURRED * step:  # midway between two steps when the temperature passes there
        smooth = temp_c if noise < QUIET * step else moving_mean(temp_c, time, WINDOW_S)
        code = np.round((smooth - temp_c[0]) / step)
        change = np.flatnonzero(np.diff(code))
        passed_c = temp_c[0] + 0.5 * step * (code[change] + code[change + 1])
        moments = np.concatenate((time[:1], 0.5 * (time[change] + time[change + 1]), time[-1:]))
        course: FloatArray = np.interp(time, moments, np.concatenate((smooth[:1], passed_c, smooth[-1:])))
        return course
    interval_s = float(np.median(np.diff(time)))
    window_s = float(np.clip(interval_s * (noise / KNOWN_TO_C) ** 2, 2.0 * LEAST_REACH_S, WINDOW_S))
    return moving_mean(temp_c, time, window_s)


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


# ---- subtract a lag


@dataclass(frozen=True, slots=True, kw_only=True)
class LagState:
    """What the lead carries from chunk to chunk."""

    time: float = math.nan  # time of the last reading, s; NaN before the first
    temp_c: float = math.nan  # last reading, degC
    smooth_c: float = math.nan  # reading behind the low-pass tau_f, degC
    output_c: float = math.nan  # last temperature returned, degC; held while readings are NaN


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


def looked_up_c(
    sessions: Sequence[Session],
    trusted: Sequence[Sequence[Temperature]],
    course: Sequence[Sequence[FloatArray]],
    lag_s: float,
    smooth_s: float,
) -> FloatArray:
    """Return the extremes, degC, that ``correct`` would look up: readings are noisier than their smooth course."""
    ends = list[float]()
    for session, of_session, smooth in zip(sessions, trusted, course, strict=True):
        for record, temperature, smooth_c in zip(session.records, of_session, smooth, strict=True):
            if record.temp_c is None or temperature.source != "column":
                continue
            used_c, gain = record.temp_c, 1.0
            if lag_s > 0.0:
                used_c, gain = without_lag(used_c, record.time, lag_s=lag_s, smooth_s=smooth_s)[0], lag_s / smooth_s
            far = _STRAY * gain * max(temperature.noise_c, temperature.step_c, _LEAST_NOISE_C)
            near = used_c[np.abs(used_c - smooth_c) <= far]  # a gap is near nothing
            ends += [near.min(), near.max()] if len(near) else []
    return np.array(ends)


# ---- estimate a lag


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LagFit:
    """A thermometer's lag."""

    lag_s: float = 0.0  # time constant, s; 0 if it is not known
    uncertainty_s: float = math.inf  # standard uncertainty, s; infinite if not observable
    findings: tuple[Finding, ...] = ()  # why it is not observable


def estimate_lag(blocks: RestBlocks, *, longest_s: float = 300.0) -> LagFit:
    """Return the time constant, up to a longest one, at which readings at one temperature agree whatever the ramp was."""
    direction = cooling(blocks)
    moved = np.isfinite(blocks.temp_c) & np.isfinite(blocks.ramp_c_per_min) & (direction != 0.0)
    settled = moved & (np.abs(direction) > 0.99)  # after a turn a hysteresis is still changing
    rows = settled if settled.sum() >= FEWEST and len(np.unique(direction[settled])) > 1 else moved
    blocks, direction = blocks.taken(rows), direction[rows]
    readings = _readings(blocks)
    moving = np.abs(blocks.ramp_c_per_min[np.abs(blocks.ramp_c_per_min) > MOVING_C_PER_MIN])
    if readings.shape[1] == 0 or len(moving) < FEWEST:
        return _unknown(
            f"{len(moving)} blocks of rest change by over {MOVING_C_PER_MIN:g} degC/min, and {FEWEST} are needed"
        )
    temp, slope = blocks.temp_c, blocks.ramp_c_per_min / 60.0
    poses = np.asarray(blocks.pose[:, None] == np.unique(blocks.pose)[1:], dtype=np.float64)
    q, _ = np.linalg.qr(np.hstack((_spline(temp), poses)))
    unexplained = float(np.sum((slope - q @ (q.T @ slope)) ** 2) / max(float(slope @ slope), 1e-300))
    if unexplained < BOTH_WAYS:
        return _unknown(
            f"each temperature was passed at one speed: it explains {100.0 * (1.0 - unexplained):.0f} % of the slopes"
        )
    steady = np.abs(blocks.ramp_c_per_min[_away_from_ends(blocks)])  # at the ends a ramp is not at its speed
    steady = steady[steady > MOVING_C_PER_MIN]
    slow, fast = np.quantile(steady if len(steady) >= FEWEST else moving, (0.1, 0.9))
    two_speeds = bool(fast > TWO_SPEEDS * slow)
    fixed = [poses, direction[:, None]] if two_speeds else [poses]
    power_on = np.exp(-blocks.power_on_s / WARM_UP_S)
    if np.ptp(power_on) > 0.1:
        fixed.append(power_on[:, None])

    def residual(lag: float) -> FloatArray:
        q, r = np.linalg.qr(np.hstack((_spline(temp + lag * slope), *fixed)))
        q = q[:, np.abs(np.diag(r)) > 1e-9 * np.abs(r).max()]
        return np.asarray(readings - q @ (q.T @ readings))

    def loss(lags: FloatArray) -> FloatArray:
        return np.array([float(np.log(np.mean(residual(lag) ** 2, axis=0)).sum()) for lag in lags])

    coarse = np.concatenate(([0.0], np.geomspace(1.0, longest_s, 40)))
    best = int(loss(coarse).argmin())
    lags = np.unique(np.append(np.linspace(coarse[max(best - 1, 0)], coarse[min(best + 1, 40)], 25), longest_s))
    losses = loss(lags)
    best = int(losses.argmin())
    misfit = _independent(residual(lags[best])) * (losses - losses[best])  # twice the loss of log-likelihood
    if misfit[-1] <= 4.0:  # within two standard deviations
        return _unknown(f"any lag up to {longest_s:g} s fits")
    i, lag = min(max(best, 1), len(lags) - 2), float(lags[best])
    curve, tilt, _ = np.polyfit(lags[i - 1 : i + 2] - lag, misfit[i - 1 : i + 2], 2)
    if curve > 0.0:
        lag = float(np.clip(lag - 0.5 * tilt / curve, lags[i - 1], lags[i + 1]))
    if not two_speeds:  # then hysteresis may be taken for lag
        unknown = _unknown(f"ramps have one speed, and a lag of {lag:.3g} s explains the same loop as hysteresis")
        return LagFit(lag_s=lag, findings=unknown.findings)
    return LagFit(
        lag_s=lag, uncertainty_s=1.0 / math.sqrt(curve) if curve > 0.0 else float(np.ptp(lags[misfit <= 1.0]))
    )


def _away_from_ends(blocks: RestBlocks) -> BoolArray:
    """Return True for blocks away from the coldest and the hottest temperature of their session, (n,)."""
    away = np.zeros(len(blocks), bool)
    for session in np.unique(blocks.session):
        rows = blocks.session == session
        temp_c = blocks.temp_c[rows]
        away[rows] = (temp_c > temp_c.min() + CROSSED_C) & (temp_c < temp_c.max() - CROSSED_C)
    return away


def _unknown(problem: str) -> LagFit:
    return LagFit(findings=(finding("drift.lag_not_observable", "info", problem=problem),))


def _readings(blocks: RestBlocks) -> FloatArray:
    """Return the axes that depend on temperature, each with unit spread, shape (n, a)."""
    if not len(blocks):
        return np.empty((0, 0))
    one_pose = all(len(np.unique(blocks.pose[blocks.session == s])) == 1 for s in np.unique(blocks.session))
    columns = np.hstack((blocks.gyro, blocks.accel)) if one_pose else blocks.gyro
    columns = columns[:, np.isfinite(columns).all(axis=0)]
    spread = columns.std(axis=0)
    return np.asarray((columns - columns.mean(axis=0))[:, spread > 0.0] / spread[spread > 0.0])


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
