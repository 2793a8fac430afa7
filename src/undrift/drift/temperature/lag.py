"""Lag: a board thermometer trails the sensors, T_m' = (T - T_m) / tau, and how that is taken off.

::

    in use      y = (tau s + 1) / (tau_f s + 1) T_m     causal, over uneven steps; leaves the lag tau_f
    for a fit   T = T_m + tau T_m'                      of a temperature smoothed over time: nothing is left

The lead makes the noise of one reading tau / tau_f times as large; its slow part, which alone turns into angle, stays as it was.
"""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError

RAMP_C_PER_MIN = 1.0  # for which noise and lag left are balanced
AT_ONCE = 1e-300  # s: a low-pass so fast that it is not there
DITHERED = 0.35  # of a step: more noise than this averages the steps away


@dataclass(frozen=True, slots=True, kw_only=True)
class LagState:
    """What the lead carries from chunk to chunk.

    Parameters
    ----------
    time : float
        Of the last reading, s; NaN before the first.
    temp_c : float
        The last reading, degC.
    smooth_c : float
        The reading behind the low-pass tau_f, degC.
    output_c : float
        The last temperature given out, degC; held where readings are NaN.
    """

    time: float = math.nan
    temp_c: float = math.nan
    smooth_c: float = math.nan
    output_c: float = math.nan


def without_lag(
    temp_c: FloatArray, time: FloatArray, *, lag_s: float, smooth_s: float, state: LagState | None = None
) -> tuple[FloatArray, LagState]:
    """Take the thermometer's lag off, looking back only.

    ``(tau s + 1) / (tau_f s + 1)``, solved exactly for readings that are straight between samples. Chunks that hand the state on
    give the bits of one call. Of a thermometer that had settled before the first reading.

    Parameters
    ----------
    temp_c : array, shape (N,)
        What it reads, degC; NaN holds the last output, and is NaN before the first reading.
    time : array, shape (N,)
        s, increasing, also from the last chunk on.
    lag_s : float
        tau, s; 0 for a thermometer without lag.
    smooth_s : float
        tau_f, s, above 0; 0 only where lag_s is 0. See :func:`default_smooth_s`.
    state : LagState, optional
        From the last chunk; none for the first.

    Returns
    -------
    temp_c : array, shape (N,)
        Temperature of the sensors, degC.
    state : LagState
        For the next chunk.

    Raises
    ------
    InputError
        Another number of times than of readings, times below 0 s, a lag without smoothing, or a chunk from before the last.
    """
    from undrift.kernels.lag import lead

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
    """Take the thermometer's lag off a temperature that is smooth over time, for a fit: ``T = T_m + tau dT_m/dt``.

    Nothing is delayed and no lag is left. Of raw readings it would make noise only; :func:`undrift.drift.temperature.trusted.
    trusted_temperature` smooths them.

    Parameters
    ----------
    temp_c : array, shape (N,)
        Smoothed readings, degC; NaN stays NaN.
    time : array, shape (N,)
        s, increasing.
    lag_s : float
        tau, s.

    Returns
    -------
    array, shape (N,)
        Temperature of the sensors, degC.

    Raises
    ------
    InputError
        A lag below 0 s.
    """
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

    Parameters
    ----------
    lag_s : float
        tau, s.
    noise_c : float
        Standard deviation of one reading, K.
    interval_s : float
        Between readings, s.
    step_c : float
        Step of the reading, K; 0 for none.

    Returns
    -------
    float
        tau_f, s; 0 where lag_s is 0.

    Raises
    ------
    InputError
        A figure below 0.
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
    balance = math.sqrt(noise * lag_s / (RAMP_C_PER_MIN / 60.0))
    return min(0.5 * lag_s, max(0.05 * lag_s, balance, interval_s))


def _check_times(lag_s: float, smooth_s: float) -> None:
    if not (0.0 <= lag_s < math.inf and 0.0 <= smooth_s < math.inf):
        raise InputError(f"lag: wanted lag_s and smooth_s of 0 s or more, got {lag_s:g} and {smooth_s:g}")
    if lag_s > 0.0 and smooth_s == 0.0:
        raise InputError(f"lag: wanted smooth_s above 0 s to take off {lag_s:g} s, got 0; default_smooth_s gives one")
