"""Lag of a board thermometer behind the sensors, T_m' = (T - T_m) / tau: estimated from rests, and subtracted.

::

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
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.drift.observe import RestBlocks
from undrift.errors import InputError
from undrift.findings import Finding, finding

RAMP_C_PER_MIN = 1.0  # at which noise and the lag left are balanced
AT_ONCE = 1e-300  # s: a low-pass so fast that it is not there
DITHERED = 0.35  # of a step: more noise than this averages the steps away
NODE_C = 5.0  # between the spline's knots
MOST_KNOTS = 16
FEWEST = 24  # blocks
MOVING_C_PER_MIN = 0.1
TWO_SPEEDS = 1.5  # fast over slow
TURN_C = 4.0  # K after a turn, over which a hysteresis is still changing: excluded where other blocks remain
WARM_UP_S = 600.0  # time constant of the power-on transient that is fitted with the lag
BOTH_WAYS = 0.1  # of the variance of the slopes that the temperature must leave open


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
    blurred = noise_c >= DITHERED * step_c
    white = math.hypot(noise_c, step_c / math.sqrt(12.0) if blurred else 0.0) * math.sqrt(min(interval_s, 1.0))
    noise = white if blurred else math.hypot(white, step_c / math.sqrt(12.0))
    return min(0.5 * lag_s, max(0.05 * lag_s, math.sqrt(noise * lag_s / (RAMP_C_PER_MIN / 60.0)), interval_s))


def _check_times(lag_s: float, smooth_s: float) -> None:
    if not (0.0 <= lag_s < math.inf and 0.0 <= smooth_s < math.inf):
        raise InputError(f"lag: wanted lag_s and smooth_s of 0 s or more, got {lag_s:g} and {smooth_s:g}")
    if lag_s > 0.0 and smooth_s == 0.0:
        raise InputError(f"lag: wanted smooth_s above 0 s to subtract {lag_s:g} s, got 0; default_smooth_s gives one")


# ---- estimate it


def estimate_lag(blocks: RestBlocks, *, longest_s: float = 300.0) -> LagFit:
    """Find the time constant, up to a longest one, at which readings at one temperature agree whatever the ramp was."""
    ramp = blocks.ramp_c_per_min
    direction, way = _directions(blocks)
    moved = np.isfinite(blocks.temp_c) & np.isfinite(ramp) & (direction != 0.0)
    kept = moved & (way > TURN_C)
    if kept.sum() < FEWEST or len(np.unique(direction[kept])) < 2:
        kept = moved
    readings = _readings(blocks, kept)
    moving = np.abs(ramp[kept][np.abs(ramp[kept]) > MOVING_C_PER_MIN])
    if kept.sum() < FEWEST or readings.shape[1] == 0 or len(moving) < FEWEST:
        few = {"count": len(moving), "least_c_per_min": MOVING_C_PER_MIN, "wanted": FEWEST}
        return LagFit(findings=(finding("drift.lag_few_blocks", "info", **few),))
    temp, slope, pose = blocks.temp_c[kept], ramp[kept] / 60.0, blocks.pose[kept]
    poses = np.asarray(pose[:, None] == np.unique(pose)[1:], dtype=np.float64)
    q, _ = np.linalg.qr(np.hstack((_spline(temp), poses)))
    rest = ramp[kept] - q @ (q.T @ ramp[kept])
    left = float(rest @ rest / max(float(ramp[kept] @ ramp[kept]), 1e-12))
    if left < BOTH_WAYS:  # temperature and pose explain which way it went
        return LagFit(findings=(finding("drift.lag_one_way", "info", percent=100.0 * (1.0 - left)),))
    slow, fast = np.quantile(moving, (0.1, 0.9))
    two_speeds = bool(fast > TWO_SPEEDS * slow)
    fixed = [poses, direction[kept][:, None]] if two_speeds else [poses]
    power_on = np.exp(-blocks.power_on_s[kept] / WARM_UP_S)
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
    found: tuple[Finding, ...] = ()
    at_end = bool(misfit[-1] <= 4.0)  # within two standard deviations
    if at_end:
        found = (finding("drift.lag_unbounded", "info", longest_s=lags[-1]),)
    elif not two_speeds:
        found = (finding("drift.lag_or_hysteresis", "info", lag_s=lag),)
    return LagFit(
        lag_s=0.0 if at_end else lag,
        uncertainty_s=uncertainty if two_speeds and not at_end else float("inf"),
        observable=two_speeds and not at_end,
        two_speeds=two_speeds,
        lags_s=lags,
        misfit=misfit,
        findings=found,
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
    """Return a cubic B-spline basis over the temperatures, shape (n, k)."""
    from scipy.interpolate import BSpline

    low, high = float(temp.min()), float(temp.max()) + 1e-9
    cells = int(np.clip(round((high - low) / NODE_C), 1, MOST_KNOTS))
    knots = np.concatenate(([low] * 3, np.linspace(low, high, cells + 1), [high] * 3))
    return np.asarray(BSpline.design_matrix(np.clip(temp, low, high), knots, 3).toarray())


def _independent(residual: FloatArray) -> float:
    """Return how many independent blocks the residuals are worth, by the correlation of neighbours."""
    before, after = residual[:-1], residual[1:]
    rho = float((before * after).sum() / max(float((residual**2).sum()), 1e-300))
    rho = min(max(rho, 0.0), 0.99)
    return max(len(residual) * (1.0 - rho) / (1.0 + rho), 4.0)
