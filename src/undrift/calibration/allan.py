"""Allan deviation and its relatives, with confidence from equivalent degrees of freedom.

With phase x_k = sum of the first k readings times the sample period, tau = m periods, D2 and D3 the second and third
difference over m samples, and S the running sum of x::

    ADEV^2  = mean D2(x)^2 / (2 tau^2)        every m-th k;  OADEV: every k
    HDEV^2  = mean D3(x)^2 / (6 tau^2)        every m-th k;  OHDEV: every k
    MDEV^2  = mean D3(S)^2 / (2 m^2 tau^2)    every k
    TOTDEV^2 = mean D2(x*)^2 / (2 tau^2)      x* the phase continued by point reflection at both ends

The estimate of a variance is distributed as chi-square with ``edf`` equivalent degrees of freedom [1]_, which depend on the
kind of noise; the kind is told at each tau from the lag-1 autocorrelation of the averaged readings [2]_.

References
----------
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
_STRIDES = 64  # overlaps finer than this carry no more information


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AllanDeviation:
    """Deviation over averaging time, with confidence.

    Parameters
    ----------
    estimator : str
        Which of the six.
    taus_s : array, shape (M,)
        Averaging times, s.
    deviation : array, shape (M,)
        Unit of the readings.
    lower, upper : array, shape (M,)
        Confidence limits, unit of the readings.
    edf : array, shape (M,)
        Equivalent degrees of freedom.
    noise : array, shape (M,)
        Kind of noise as the power of frequency: 2 white phase, 1 flicker phase, 0 white, -1 flicker, -2 random walk.
    confidence : float
        Probability that the limits enclose the truth.
    """

    estimator: Estimator
    taus_s: FloatArray
    deviation: FloatArray
    lower: FloatArray
    upper: FloatArray
    edf: FloatArray
    noise: IntArray
    confidence: float


def allan_deviation(
    x: ArrayLike,
    sample_rate_hz: float,
    *,
    taus: Literal["octave", "decade", "all"] | Sequence[float] | FloatArray = "octave",
    estimator: Estimator = "oadev",
    confidence: float = 0.95,
) -> AllanDeviation:
    """Return the Allan deviation of one channel, or a relative of it.

    Equations and sources: module docstring.

    Parameters
    ----------
    x : array_like, shape (N,)
        Evenly sampled readings at rest, any unit, no gaps.
    sample_rate_hz : float
        Hz.
    taus : str or sequence of float
        octave (1, 2, 4, ... samples, up to a quarter of the record), decade (1, 2, 4, 10, ...), all, or averaging times, s.
    estimator : str
        adev, oadev, mdev, hdev, ohdev or totdev.
    confidence : float
        Probability of the limits, between 0 and 1.

    Returns
    -------
    AllanDeviation
        At whole numbers of samples.

    Raises
    ------
    InputError
        Gaps, too few samples, an unknown estimator, or averaging times that the record cannot show.
    """
    y = frozen(x, (None,), "x")
    if (
        estimator not in get_args(Estimator)
        or np.isnan(y).any()
        or not sample_rate_hz > 0.0
        or not 0.0 < confidence < 1.0
    ):
        raise InputError(
            f"allan_deviation: wanted readings without gaps, a sample rate, a confidence within (0, 1) and one of "
            f"{', '.join(get_args(Estimator))}, got {int(np.isnan(y).sum())} gaps, {sample_rate_hz:g} Hz, {confidence:g} and "
            f"'{estimator}'; cut the record at its gaps"
        )
    m = _averages(taus, len(y), sample_rate_hz, estimator)
    phase = np.concatenate(([0.0], np.cumsum(y - y.mean())))
    deviation = _deviations(phase, m, estimator)
    noise = _kinds(phase, m, 2 if _ORDER[estimator] == 2 else 3)
    edf = np.array([_edf(int(mk), int(a), len(phase), estimator) for mk, a in zip(m, noise, strict=True)])
    lower, upper = _limits(deviation, edf, confidence)
    return AllanDeviation(
        estimator=estimator,
        taus_s=m / sample_rate_hz,
        deviation=deviation,
        lower=lower,
        upper=upper,
        edf=edf,
        noise=noise,
        confidence=confidence,
    )


def _averages(
    taus: Literal["octave", "decade", "all"] | Sequence[float] | FloatArray,
    count: int,
    rate: float,
    estimator: Estimator,
) -> IntArray:
    """Return the averaging times in samples."""
    longest = count // 4
    if isinstance(taus, str):
        powers = np.arange(64)
        grids = {
            "octave": 2.0 ** powers[:40],
            "decade": np.outer(10.0 ** powers[:12], (1, 2, 4)).reshape(-1),
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
    from undrift.kernels.allan import second_difference, third_difference

    size = m.astype(float)
    if estimator in ("hdev", "ohdev"):
        square = [third_difference(phase, int(k), int(k) if estimator == "hdev" else 1) / 3.0 for k in m]
    elif estimator == "mdev":
        sums = np.concatenate(([0.0], np.cumsum(phase - phase.mean())))
        square = [third_difference(sums, int(k), 1) / float(k) ** 2 for k in m]
    elif estimator == "totdev":
        inner = len(phase) - 2
        left, right = 2.0 * phase[0] - phase[inner:0:-1], 2.0 * phase[-1] - phase[-2 : -2 - inner : -1]
        longer = np.concatenate(
            (left, phase, right)
        )  # the centres of the differences are the inner points of the phase
        square = [second_difference(longer[inner + 1 - int(k) : 2 * inner + 1 + int(k)], int(k), 1) for k in m]
    else:
        square = [second_difference(phase, int(k), int(k) if estimator == "adev" else 1) for k in m]
    deviation: FloatArray = np.sqrt(np.array(square) / 2.0) / size
    return deviation


def _kinds(phase: FloatArray, m: IntArray, order: int) -> IntArray:
    """Return the power of frequency at each averaging time, from the lag-1 autocorrelation (SP 1065, 5.5.6)."""
    least = -2 if order == 2 else -4
    kinds = np.zeros(len(m), np.int64)
    kind = 0
    for at, k in enumerate(m):
        z = np.diff(phase[:: int(k)])
        if len(z) >= 30:
            kind = int(np.clip(_power(z), least, 2))
        kinds[at] = kind
    return kinds


def _power(z: FloatArray) -> int:
    for differences in range(4):
        away = z - z.mean()
        square = float(away @ away)
        lag = float(away[1:] @ away[:-1]) / square if square > 0.0 else 0.0
        delta = lag / (1.0 + lag)
        if delta < 0.25 or differences == 3:
            return -2 * differences - round(2.0 * delta)
        z = np.diff(z)
    return 0


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
    zero = float(_covariance(np.zeros(1), filtered, alpha, order)[0])
    later = _covariance(j / strides, filtered, alpha, order)
    weight = 2.0 * (1.0 - j / terms)
    weight[-1] /= 2.0
    total = zero**2 + float(weight @ later**2)
    return max(terms * zero**2 / total, 1.0)


def _covariance(t: FloatArray, filtered: int, alpha: int, order: int) -> FloatArray:
    """Return the generalised autocovariance of the differenced phase at shifts t (in units of m)."""
    rows = {2: (6.0, -4.0, 1.0), 3: (20.0, -15.0, 6.0, -1.0)}[order]
    total = rows[0] * _averaged(t, filtered, alpha)
    for shift, weight in enumerate(rows[1:], start=1):
        total = total + weight * (_averaged(t - shift, filtered, alpha) + _averaged(t + shift, filtered, alpha))
    return total


def _averaged(t: FloatArray, filtered: int, alpha: int) -> FloatArray:
    f = float(filtered)
    value: FloatArray = (
        f * f * (2.0 * _power_law(t, alpha) - _power_law(t - 1.0 / f, alpha) - _power_law(t + 1.0 / f, alpha))
    )
    return value


def _power_law(t: FloatArray, alpha: int) -> FloatArray:
    size = np.abs(t)
    exponent = 3 - alpha
    if exponent % 2:
        value: FloatArray = size**exponent
    else:
        value = size**exponent * np.log(np.where(size > 0.0, size, 1.0))
    return value if alpha in (0, 1, -3, -4) else -value


def _limits(deviation: FloatArray, edf: FloatArray, confidence: float) -> tuple[FloatArray, FloatArray]:
    """Return sqrt(edf / chi-square quantile) either way."""
    from scipy.special import gammaincinv

    tail = 0.5 * (1.0 - confidence)
    high, low = 2.0 * gammaincinv(0.5 * edf, 1.0 - tail), 2.0 * gammaincinv(0.5 * edf, tail)
    return deviation * np.sqrt(edf / high), deviation * np.sqrt(edf / np.maximum(low, 1e-300))
