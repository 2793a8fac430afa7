"""Allan deviation and its relatives, each with confidence limits.

With phase x_k = sum of the first k readings times the sample period, tau = m periods, D2 and D3 the second and third difference
over m samples, and S the running sum of x:

    ADEV^2  = mean D2(x)^2 / (2 tau^2)        every m-th k;  OADEV: every k
    HDEV^2  = mean D3(x)^2 / (6 tau^2)        every m-th k;  OHDEV: every k
    MDEV^2  = mean D3(S)^2 / (2 m^2 tau^2)    every k
    TOTDEV^2 = mean D2(x*)^2 / (2 tau^2)      x* the phase continued by point reflection at both ends

Where samples are missing, only terms whose samples are all there count: the mean runs over them, averaging times go up to those
of which two windows' worth of terms are left, the kind of noise comes from neighbouring whole averages, and the degrees of
freedom are those of a record without gaps with as many terms. Overlapping and plain ADEV and HDEV can do so.

The estimate of a variance is distributed as chi-square with ``edf`` equivalent degrees of freedom [1]_, which depend on the kind
of noise; the kind is found at each tau from the lag-1 autocorrelation of the averaged readings [2]_.

.. [1] C. A. Greenhall and W. J. Riley, "Uncertainty of stability variances based on finite differences", PTTI 2003.
.. [2] W. J. Riley, "Handbook of frequency stability analysis", NIST SP 1065, 2008, sections 5.2-5.5.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import FloatArray, IntArray, frozen
from undrift.errors import InputError

Estimator = Literal["adev", "oadev", "mdev", "hdev", "ohdev", "totdev"]
_SPAN = {"adev": 2, "oadev": 2, "mdev": 3, "hdev": 3, "ohdev": 3, "totdev": 1}  # samples needed, in units of m
_ORDER = {"adev": 2, "oadev": 2, "mdev": 2, "hdev": 3, "ohdev": 3, "totdev": 2}
_TOTAL_EDF = {0: (1.5, 0.0), -1: (1.16832, 0.222), -2: (0.9285, 0.358)}  # SP 1065 table 7: edf = b T / tau - c
_LEAST_AVERAGES = 30  # of a length, to tell the kind of noise
_STRIDES = 64  # overlaps finer than this carry no more information


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AllanDeviation:
    """Deviation over averaging time, with confidence."""

    taus_s: FloatArray  # (M,), averaging times, s
    deviation: FloatArray  # (M,), unit of the readings
    lower: FloatArray  # (M,), confidence limits, unit of the readings
    upper: FloatArray
    edf: FloatArray  # (M,), equivalent degrees of freedom
    noise: IntArray  # (M,), power of frequency: 2 white phase, 1 flicker phase, 0 white, -1 flicker, -2 random walk


Taus = Literal["octave", "decade", "all"] | Sequence[float] | FloatArray


def allan_deviation(
    x: ArrayLike,
    sample_rate_hz: float,
    *,
    taus: Taus = "octave",
    estimator: Estimator = "oadev",
    confidence: float = 0.95,
) -> AllanDeviation:
    """Return the Allan deviation of one channel (N,), or a relative of it."""
    y = frozen(x, (None,), "x")
    able = estimator in get_args(Estimator) and sample_rate_hz > 0.0 and 0.0 < confidence < 1.0
    gap = np.isnan(y)
    if not able or (gap.any() and estimator not in _GAPPED):
        raise InputError(
            f"allan_deviation: wanted readings (without gaps for mdev and totdev), a sample rate, a confidence within (0, 1) and "
            f"one of {', '.join(get_args(Estimator))}, got {int(gap.sum())} gaps, {sample_rate_hz:g} Hz, {confidence:g} and "
            f"'{estimator}'; cut the record at its gaps, or use oadev"
        )
    if gap.any():
        return _with_gaps(y, sample_rate_hz, taus, estimator, confidence)
    m = averages_of(taus, len(y), sample_rate_hz, estimator)
    phase = np.concatenate(([0.0], np.cumsum(y - y.mean())))
    deviation = _deviations(phase, m, estimator)
    noise = _kinds(phase, m, _ORDER[estimator])
    edf = np.array([_edf(int(mk), int(a), len(phase), estimator) for mk, a in zip(m, noise, strict=True)])
    lower, upper = _limits(deviation, edf, confidence)
    taus_s = m / sample_rate_hz
    return AllanDeviation(taus_s=taus_s, deviation=deviation, lower=lower, upper=upper, edf=edf, noise=noise)


_GAPPED = ("adev", "oadev", "hdev", "ohdev")


def _with_gaps(y: FloatArray, rate: float, taus: Taus, estimator: Estimator, confidence: float) -> AllanDeviation:
    """Return the deviation of readings (N,) with gaps, NaN, by the terms that are whole."""
    gap, order, span = np.isnan(y), _ORDER[estimator], _SPAN[estimator]
    phase = np.concatenate(([0.0], np.cumsum(np.where(gap, 0.0, y - np.nanmean(y)))))
    lost = np.concatenate(([0], np.cumsum(gap)))
    weights = {2: (1.0, -2.0, 1.0), 3: (-1.0, 3.0, -3.0, 1.0)}[order]
    kept, squares, phases, kinds, kind = list[int](), list[float](), list[int](), list[int](), 0
    for m in averages_of(taus, int((~gap).sum()), rate, estimator).tolist():
        first = np.arange(0, len(phase) - order * m, m if estimator in ("adev", "hdev") else 1)
        first = first[lost[first + order * m] == lost[first]]
        whole = len(first) * (m if estimator in ("adev", "hdev") else 1)
        if whole < span * m:
            continue
        difference = sum(weight * phase[first + k * m] for k, weight in enumerate(weights))
        average = np.diff(phase[::m])
        average[np.diff(lost[::m]) > 0] = np.nan
        if np.isfinite(average).sum() >= _LEAST_AVERAGES:
            kind = int(np.clip(_power(average), -2 if order == 2 else -4, 2))
        kept.append(m)
        kinds.append(kind)
        phases.append(whole + order * m)
        squares.append(float(np.mean(difference**2)) / (2.0 if order == 2 else 6.0))
    if not kept:
        raise InputError(
            "allan_deviation: wanted averaging times of which whole windows are left, got none between "
            f"{int(gap.sum())} gaps; record longer without gaps"
        )
    averages, noise = np.array(kept, np.int64), np.array(kinds, np.int64)
    deviation = np.sqrt(np.array(squares)) / averages
    edf = np.array([_edf(m, a, n, estimator) for m, a, n in zip(kept, kinds, phases, strict=True)])
    lower, upper = _limits(deviation, edf, confidence)
    return AllanDeviation(taus_s=averages / rate, deviation=deviation, lower=lower, upper=upper, edf=edf, noise=noise)


def averages_of(taus: Taus, count: int, rate: float, estimator: Estimator) -> IntArray:
    """Return the averaging times in samples."""
    longest = count // 4
    if isinstance(taus, str):
        grids = {
            "octave": 2.0 ** np.arange(40),
            "decade": np.outer(10.0 ** np.arange(12), (1, 2, 4)).reshape(-1),
            "all": np.arange(1, longest + 1),
        }
        if taus not in grids or longest < 1:
            raise InputError(
                f"allan_deviation: wanted octave, decade, all or averaging times, and 4 samples or more, got '{taus}' and {count} "
                "samples; record longer"
            )
        return grids[taus][grids[taus] <= longest].astype(np.int64)
    wanted = np.asarray(taus, float)
    m: IntArray = np.unique(np.rint(wanted * rate).astype(np.int64))
    if not len(m) or m[0] < 1 or m[-1] * _SPAN[estimator] >= count + (estimator != "mdev"):
        raise InputError(
            f"allan_deviation: wanted averaging times from {1.0 / rate:g} s to under {count / _SPAN[estimator] / rate:g} s, got "
            f"{wanted.min() if len(wanted) else np.nan:g} to {wanted.max() if len(wanted) else np.nan:g} s; record longer or ask "
            "for less"
        )
    return m


def _deviations(phase: FloatArray, m: IntArray, estimator: Estimator) -> FloatArray:
    """Return deviations in the unit of the readings; the phase counts in readings, so tau is m."""
    from undrift.kernels.calibrate import second_difference, third_difference

    if estimator in ("hdev", "ohdev"):
        square = [third_difference(phase, int(k), int(k) if estimator == "hdev" else 1) / 3.0 for k in m]
    elif estimator == "mdev":
        sums = np.concatenate(([0.0], np.cumsum(phase - phase.mean())))
        square = [third_difference(sums, int(k), 1) / float(k) ** 2 for k in m]
    elif estimator == "totdev":
        inner = len(phase) - 2
        left, right = 2.0 * phase[0] - phase[inner:0:-1], 2.0 * phase[-1] - phase[-2 : -2 - inner : -1]
        longer = np.concatenate((left, phase, right))  # differences are centred at the inner points of the phase
        square = [second_difference(longer[inner + 1 - int(k) : 2 * inner + 1 + int(k)], int(k), 1) for k in m]
    else:
        square = [second_difference(phase, int(k), int(k) if estimator == "adev" else 1) for k in m]
    return np.asarray(np.sqrt(np.array(square) / 2.0) / m.astype(float))


def _kinds(phase: FloatArray, m: IntArray, order: int) -> IntArray:
    """Return the power of frequency at each averaging time, from the lag-1 autocorrelation (SP 1065, 5.5.6)."""
    kinds, kind = [], 0
    for k in m:
        z = np.diff(phase[:: int(k)])
        if len(z) >= _LEAST_AVERAGES:
            kind = int(np.clip(_power(z), -2 if order == 2 else -4, 2))
        kinds.append(kind)
    return np.array(kinds, np.int64)


def _power(z: FloatArray) -> int:
    differences = 0
    while True:
        away, gap = z - (z.mean() if not np.isnan(z).any() else np.nanmean(z)), np.isnan(z)
        away = np.where(gap, 0.0, away) if gap.any() else away
        square = float(away @ away)
        lag = float(away[1:] @ away[:-1]) / square if square > 0.0 else 0.0
        if gap.any():  # pairs are fewer than averages
            lag *= (len(z) - gap.sum()) / max(1, int((~gap[1:] & ~gap[:-1]).sum()))
        delta = lag / (1.0 + lag)
        if delta < 0.25 or differences == 3:
            return -2 * differences - round(2.0 * delta)
        z, differences = np.diff(z), differences + 1


def _edf(m: int, alpha: int, phases: int, estimator: Estimator) -> float:
    """Return the equivalent degrees of freedom [1]; of totdev by SP 1065, at short tau those of oadev."""
    if estimator == "totdev" and m >= 8:
        b, c = _TOTAL_EDF[max(-2, min(0, alpha))]
        return max(b * (phases - 1) / m - c, 1.0)
    order = _ORDER[estimator]
    strides = 1 if estimator in ("adev", "hdev") else min(m, _STRIDES)
    filtered = 1 if estimator == "mdev" else min(m, 1000)
    length = m / filtered + m * order if estimator != "mdev" else m * (order + 1)
    terms = max(1, 1 + int(strides * (phases - length) / m))
    j = np.arange(1, min(terms, (order + 1) * strides) + 1)
    zero = float(_autocovariance(np.zeros(1), filtered, alpha, order)[0])
    later = _autocovariance(j / strides, filtered, alpha, order)
    weight = 2.0 * (1.0 - j / terms)
    weight[-1] /= 2.0
    total = zero**2 + float(weight @ later**2)
    return max(terms * zero**2 / total, 1.0)


def _autocovariance(t: FloatArray, filtered: int, alpha: int, order: int) -> FloatArray:
    """Return the generalised autocovariance of the differenced phase at shifts t (in units of m)."""
    f = float(filtered)

    def power(t: FloatArray) -> FloatArray:
        size, exponent = np.abs(t), 3 - alpha
        value: FloatArray = size**exponent
        if exponent % 2 == 0:
            value = value * np.log(np.where(size > 0.0, size, 1.0))
        return value if alpha in (0, 1, -3, -4) else -value

    def averaged(t: FloatArray) -> FloatArray:
        return np.asarray(f * f * (2.0 * power(t) - power(t - 1.0 / f) - power(t + 1.0 / f)))

    first, *rows = {2: (6.0, -4.0, 1.0), 3: (20.0, -15.0, 6.0, -1.0)}[order]
    total = first * averaged(t)
    for shift, weight in enumerate(rows, start=1):
        total = total + weight * (averaged(t - shift) + averaged(t + shift))
    return total


def _limits(deviation: FloatArray, edf: FloatArray, confidence: float) -> tuple[FloatArray, FloatArray]:
    """Return sqrt(edf / chi-square quantile) either way."""
    from scipy.special import gammaincinv

    tail = 0.5 * (1.0 - confidence)
    high, low = 2.0 * gammaincinv(0.5 * edf, 1.0 - tail), 2.0 * gammaincinv(0.5 * edf, tail)
    return deviation * np.sqrt(edf / high), deviation * np.sqrt(edf / np.maximum(low, 1e-300))
