"""Temperature of the sensors in a recording: checks, smoothing over time, and subtraction of the thermometer's lag.

The readings of a board thermometer may be noisy, change in steps of up to 1 degC, have gaps, be frozen or have the wrong scale. A
temperature that a fit cannot use raises an error, a doubtful temperature causes a finding, and all others are smoothed.

Steps that are blurred by noise are smoothed with a moving mean, long enough to reduce the noise to 0.02 K, and 30 s at most. Steps
without noise are informative only when they change. At a change the temperature is midway between two steps, and it is interpolated
from change to change.

A thermometer lags behind the sensors, T_m' = (T - T_m) / tau. The lag is subtracted from the smooth temperature::

    in use      y = (tau s + 1) / (tau_f s + 1) T_m     causal, for uneven time steps, with the remaining lag tau_f
    for a fit   T = T_m + tau T_m'                      from a smoothed temperature, without a remaining lag

The lead amplifies the noise of a single reading by tau / tau_f. It does not change the slow part of the noise, and only
this part adds up to an angle.

The gyroscopes themselves determine the time constant. A block of rest at reading T_m and slope T_m' was at T = T_m + tau T_m'.
Per axis::

    y = f(T_m + tau T_m') + m_pose + h c + w exp(-t / t_w)      polynomial f, c = +1 cooling, -1 warming, t since power-on

tau minimises the residuals of all axes, each relative to its variance, with f, m, h, w fitted at each tau (Gauss-Newton). A
hysteresis h does not depend on the speed of the ramp, but a lag does, so ramps of two speeds separate them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, runs
from undrift.drift.observe import RestBlocks
from undrift.drift.offset import cooling
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding, told_apart
from undrift.record import Session, Still, Turn

LEAST_SPAN_C = 2.0  # smallest common span of all recordings
LONGEST_GAP_S = 10.0  # longest gap that is interpolated (longer gaps stay NaN)
MOST_MISSING = 0.5  # share of the readings that may be missing
BOARD_C = (-40.0, 125.0)  # operating range of the parts of a board
OFF_SET_POINT_C = 5.0  # largest difference between the column and a given set-point on the same scale
HOT_C = 45.0  # a temperature above this throughout is neither that of a room nor of a body
SPIKE = 8.0 * 1.4826  # limit relative to the median distance from the running median: eight standard deviations
LEAST_SPIKE_C = 0.5
WINDOW_S, LEAST_REACH_S = 30.0, 1.0  # longest window of the moving mean, and half of the shortest window
KNOWN_TO_C = 0.02  # standard deviation of the mean that determines the window: a longer window blurs fast ramps
BLURRED = 0.35  # in steps: if the readings, including steps, scatter more than this, their mean has no steps
QUIET = 0.05  # in steps: with less noise, changes of step do not repeat
SAME_STEP = 0.02  # in steps: largest distance of a column from whole steps
# ---- lag
RAMP_C_PER_MIN = 1.0  # slope at which noise and remaining lag are balanced
LONGEST_LAG_S = 300.0
NODE_C, MOST_KNOTS = 5.0, 16  # temperature span per power of the polynomial, and largest number of powers
FEWEST = 24  # blocks
MOVING_C_PER_MIN = 0.1
WARM_UP_S = 600.0  # time constant of the power-on transient that is fitted with the lag
LEAST_OWN = 0.1  # share of the squared slopes that temperature and direction must leave unexplained, for a second speed
SEARCH_S = 5.0  # step of the search for the lag

Source = Literal["column", "set-points", "means"]  # "means": rows that are means over set-points


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Temperature:
    """Temperature of a recording, N samples."""

    time: FloatArray  # (N,), s
    temp_c: FloatArray  # (N,), smooth temperature, degC, or NaN if unknown
    noise_c: float = 0.0  # standard deviation of the mean over a second, due to noise and steps, K
    scatter_c: float = 0.0  # median distance of readings from the smooth temperature, K
    source: Source
    findings: tuple[Finding, ...] = ()  # findings about the column


def trusted_temperature(session: Session, index: int, *, means: bool = False) -> Temperature:
    """Return the smoothed temperature of a recording, with findings about doubtful readings. ``means`` are not smoothed."""
    record, temp_c = session.records[index], session.records[index].temp_c
    pieces: list[Still | Turn] = [*session.stills, *session.turns]
    set_points = [
        (slice(piece.start, piece.stop), piece.temp_c)
        for piece in pieces
        if piece.recording == index and piece.temp_c is not None
    ]
    if temp_c is None and not set_points:
        raise InputError(
            f"temperature of recording {index}: there is neither a column (columns.temp) nor a set-point (temp_c of stills and "
            "turns). Map the thermometer's column or set temp_c."
        )
    source: Source = "means" if means else "set-points" if temp_c is None else "column"
    if temp_c is None:
        temp_c = np.full(len(record), np.nan)
        for rows, set_point in set_points:
            temp_c[rows] = set_point
    bad = np.flatnonzero((temp_c < BOARD_C[0]) | (temp_c > BOARD_C[1]))
    if len(bad):
        raise InputError(
            f"temperature of recording {index}: {temp_c[bad[0]]:g} degC at {record.time[bad[0]]:.6g} s ({len(bad)} readings) is "
            f"outside {BOARD_C[0]:g} to {BOARD_C[1]:g} degC. Check units.temp and scale.temp.",
            temp_c=float(temp_c[bad[0]]),
        )
    if source == "column":
        return _column_temperature(temp_c, record.time, set_points, index)
    return Temperature(time=record.time, temp_c=temp_c, source=source)


def check_span(temperatures: Sequence[Temperature]) -> float:
    """Return the common span of all temperatures, K. Raise if it is too small for a thermal fit."""
    temp_c = np.concatenate([temperature.temp_c[np.isfinite(temperature.temp_c)] for temperature in temperatures])
    if not len(temp_c):
        raise NotObservable("thermal drift: no recording has a known temperature. Map its column.")
    low, high = float(temp_c.min()), float(temp_c.max())
    if high - low < LEAST_SPAN_C:
        constant = " (constant): check that the column is the thermometer's" if low == high else ""
        raise NotObservable(
            f"thermal drift: the temperatures span {high - low:.2g} degC ({low:.2f} to {high:.2f}){constant}. Record "
            f"{LEAST_SPAN_C:g} degC or more, while the device warms or cools.",
            span_c=high - low,
        )
    return high - low


def _column_temperature(
    readings: FloatArray, time: FloatArray, set_points: list[tuple[slice, float]], index: int
) -> Temperature:
    finite = np.isfinite(readings)
    if finite.mean() < 1.0 - MOST_MISSING or finite.sum() < 2:
        raise InputError(
            f"temperature of recording {index}: only {finite.sum()} of {len(readings)} rows have a reading. Map another column, or "
            "omit it and give set-points.",
            missing=1.0 - float(finite.mean()),
        )
    step, findings = step_of(readings[finite]), list[Finding]()
    used = finite & ~_spikes(readings, step)
    noise_c, course = _smooth(readings[used], time[used], step)
    temp_c = np.interp(time, time[used], course)
    for start, stop in runs(~used):  # long gaps stay open
        if start == 0 or stop == len(time) or time[stop] - time[start - 1] > LONGEST_GAP_S:
            temp_c[start:stop] = np.nan
    low, high = float(readings[used].min()), float(readings[used].max())
    if low > HOT_C:
        sentence = (
            f"The temperature of recording {index} is {low:.1f} to {high:.1f} degC throughout, above room temperature."
        )
        action = "Check for degF read as degC or a wrong scale (units.temp, scale.temp). Ignore this for a chamber or a warm chip."
        findings.append(finding("drift.temperature_implausible", "warn", sentence, action))
    differences = [(float(np.nanmedian(readings[p])) - c, c) for p, c in set_points if np.isfinite(readings[p]).any()]
    difference, set_point = max(differences, key=lambda pair: abs(pair[0]), default=(0.0, 0.0))
    if abs(difference) > OFF_SET_POINT_C:
        size = told_apart(difference, "+.1f", OFF_SET_POINT_C)
        sentence = f"The temperature of recording {index} is {size} degC from the set-point of {set_point:.1f} degC "
        sentence += f"(limit {OFF_SET_POINT_C:g} degC)."
        findings.append(finding("drift.temperature_implausible", "warn", sentence, "Check units.temp and scale.temp."))
    return Temperature(
        time=time,
        temp_c=temp_c,
        noise_c=noise_c,
        scatter_c=float(np.nanmedian(np.abs(readings - temp_c))),
        source="column",
        findings=tuple(findings),
    )


def _spikes(temp_c: FloatArray, step_c: float) -> BoolArray:
    """Mark readings that differ from the readings before and after, (N,)."""
    from scipy.ndimage import median_filter

    finite, spikes = np.isfinite(temp_c), np.zeros(len(temp_c), dtype=bool)
    deviation = np.abs(temp_c[finite] - median_filter(temp_c[finite], size=5, mode="nearest"))
    spikes[finite] = deviation > max(SPIKE * float(np.median(deviation)), 2.5 * step_c, LEAST_SPIKE_C)
    return spikes


# ---- smooth course of readings; temp_c (N,) degC, time (N,) s


def step_of(temp_c: FloatArray) -> float:
    """Return the step of the readings, or 0 if they are not on a grid."""
    values = np.unique(temp_c)
    if len(values) < 2 or len(values) > max(2, len(temp_c) // 4):
        return 0.0
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * np.abs(values).max()]
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    deviation = np.abs(gaps / step - np.round(gaps / step))
    return step if (deviation < SAME_STEP * np.maximum(gaps / step, 1.0)).mean() > 0.95 else 0.0


def _smooth(temp_c: FloatArray, time: FloatArray, step: float) -> tuple[float, FloatArray]:
    """Return the noise of the mean over a second, and the smooth temperature, which is not interpolated across a long gap."""
    if len(temp_c) < 8 or np.ptp(temp_c) == 0.0:
        return 0.0, temp_c
    interval_s = float(np.median(np.diff(time)))
    bend = np.sort(np.abs(np.diff(temp_c, 2)))
    noise = float(np.sqrt(np.mean(bend[: max(2, int(0.99 * len(bend)))] ** 2) / 6.0))  # without outliers
    parts = np.split(np.arange(len(time)), np.flatnonzero(np.diff(time) > max(LONGEST_GAP_S, 3.0 * interval_s)) + 1)
    if noise >= BLURRED * step:
        window_s = float(np.clip(interval_s * (noise / KNOWN_TO_C) ** 2, 2.0 * LEAST_REACH_S, WINDOW_S))
        course = np.concatenate([moving_mean(temp_c[rows], time[rows], window_s) for rows in parts])
        return noise * math.sqrt(min(interval_s, 1.0)), course
    window_s = WINDOW_S if noise > QUIET * step else 0.0
    course = np.concatenate([_between_steps(temp_c[rows], time[rows], step, window_s) for rows in parts])
    return step / math.sqrt(12.0), course


def _between_steps(temp_c: FloatArray, time: FloatArray, step: float, window_s: float) -> FloatArray:
    """Return the course that is midway between two steps when the readings pass there, (N,)."""
    smooth = moving_mean(temp_c, time, window_s) if window_s > 0.0 else temp_c
    code = np.round((smooth - temp_c[0]) / step)
    change = np.flatnonzero(np.diff(code))
    passed_c = temp_c[0] + 0.5 * step * (code[change] + code[change + 1])
    moments = np.concatenate((time[:1], 0.5 * (time[change] + time[change + 1]), time[-1:]))
    return np.asarray(np.interp(time, moments, np.concatenate((smooth[:1], passed_c, smooth[-1:]))))


def moving_mean(values: FloatArray, time: FloatArray, window_s: float) -> FloatArray:
    """Return the mean over a window around each sample, (N,). Near the ends, the window shrinks on both sides to avoid a shift."""
    if time[-1] - time[0] < 2.0 * LEAST_REACH_S or float(np.median(np.diff(time))) > LEAST_REACH_S:
        return values
    total = np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))))
    middle = np.clip(time, time[0] + LEAST_REACH_S, time[-1] - LEAST_REACH_S)
    reach = np.minimum(0.5 * window_s, np.minimum(middle - time[0], time[-1] - middle))
    mean = (np.interp(middle + reach, time, total) - np.interp(middle - reach, time, total)) / (2.0 * reach)
    return np.asarray(mean)


# ---- subtract a lag


def without_lag_smooth(temperature: Temperature, *, lag_s: float) -> FloatArray:
    """Subtract the lag from the smooth temperature of a column, for a fit: ``T = T_m + tau dT_m/dt``."""
    out = np.array(temperature.temp_c, dtype=np.float64)
    for start, stop in runs(np.isfinite(out)):
        if temperature.source == "column" and stop - start > 1:
            out[start:stop] += lag_s * np.gradient(out[start:stop], temperature.time[start:stop])
    return out


def default_smooth_s(lag_s: float, temperature: Temperature) -> float:
    """Return the remaining lag, s, for which amplified noise and lag have the same effect at 1 degC/min.

    The lead amplifies the noise n of the mean of a second by tau / tau_f, and leaves the error tau_f dT/dt. They are equal at
    tau_f = sqrt(n tau / (dT/dt)), limited to the range from a twentieth to a half of tau and to more than one interval.
    """
    balanced_s = math.sqrt(temperature.noise_c * lag_s / (RAMP_C_PER_MIN / 60.0))
    return min(0.5 * lag_s, max(0.05 * lag_s, balanced_s, float(np.median(np.diff(temperature.time)))))


# ---- estimate a lag


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LagFit:
    """A thermometer's lag."""

    lag_s: float = 0.0  # time constant, s, or 0 if not observable
    uncertainty_s: float = math.inf  # standard uncertainty, s, or infinity if not observable


def estimate_lag(blocks: RestBlocks) -> LagFit:
    """Return the time constant for which the gyroscope readings at equal temperature agree in all ramps."""
    direction = cooling(blocks)
    usable = np.isfinite(blocks.temp_c) & np.isfinite(blocks.ramp_c_per_min) & np.isfinite(blocks.gyro).all(axis=1)
    settled = usable & (np.abs(direction) > 0.99)  # after a reversal, hysteresis is still changing
    rows = settled if settled.sum() >= FEWEST else usable
    blocks, direction = blocks.taken(rows), direction[rows]
    temp_c, slope = blocks.temp_c, blocks.ramp_c_per_min / 60.0
    if (np.abs(blocks.ramp_c_per_min) > MOVING_C_PER_MIN).sum() < FEWEST or not np.ptp(blocks.gyro, axis=0).all():
        return LagFit()
    readings = (blocks.gyro - blocks.gyro.mean(axis=0)) / np.ptp(blocks.gyro, axis=0)
    pose = blocks.pose[:, None] == np.unique(blocks.pose)[1:]
    effects = np.column_stack((pose, direction, np.exp(-blocks.power_on_s / WARM_UP_S)))
    own = _remove_effects(slope[:, None], _curve(temp_c), effects)
    if (own**2).sum() < LEAST_OWN * (slope**2).sum():
        return LagFit()

    def residual(lag_s: float) -> FloatArray:
        return _remove_effects(readings, _curve(temp_c + lag_s * slope), effects)

    search = np.arange(0.0, LONGEST_LAG_S, SEARCH_S)
    lag = float(search[np.argmin([np.log((residual(s) ** 2).mean(axis=0)).sum() for s in search])])
    for _ in range(3):
        left = residual(lag)
        weight = 1.0 / (left**2).mean(axis=0)
        change = residual(lag - 0.5) - residual(lag + 0.5)  # minus the derivative, per s
        information = float((weight * change**2).sum())
        lag += float((weight * change * left).sum()) / information
    correlated = len(left) / _independent(left)
    return LagFit(lag_s=max(lag, 0.0), uncertainty_s=math.sqrt(correlated / information))


def _curve(temp_c: FloatArray) -> FloatArray:
    """Return polynomials over the temperatures (n,), with about one degree of freedom per 5 K, (n, k)."""
    low, span = float(temp_c.min()), float(np.ptp(temp_c)) + 1e-9
    degree = 2 + int(np.clip(round(span / NODE_C), 1, MOST_KNOTS))
    return np.polynomial.chebyshev.chebvander(2.0 * (temp_c - low) / span - 1.0, degree)


def _remove_effects(values: FloatArray, *effects: FloatArray) -> FloatArray:
    """Return the residuals of values (n, k) after a least-squares fit of effects (n, .)."""
    q, r = np.linalg.qr(np.hstack(effects))
    q = q[:, np.abs(np.diag(r)) > 1e-9 * np.abs(r).max()]
    return np.asarray(values - q @ (q.T @ values))


def _independent(residual: FloatArray) -> float:
    """Return the number of independent blocks equivalent to the residuals, from the correlation of neighbours."""
    rho = float((residual[:-1] * residual[1:]).sum() / max(float((residual**2).sum()), 1e-300))
    rho = min(max(rho, 0.0), 0.99)
    return max(len(residual) * (1.0 - rho) / (1.0 + rho), 4.0)
