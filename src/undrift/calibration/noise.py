"""Noise of a device at rest: coefficients of the Allan variance, each with its interval, or the reason why there is none.

    sigma^2(tau) = 3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3          IEEE Std 952-1997, annex C

N angle (velocity) random walk, B bias instability, K rate (acceleration) random walk, Q quantisation. The overlapping variances at
octaves of tau are fitted by generalised least squares, linear in Q^2, N^2, B^2, K^2 >= 0: variances from the equivalent degrees of
freedom, correlations from the spectrum of the model itself (neighbouring octaves share half their samples). A term that is not two
standard deviations above zero is not observable and gets an upper limit: a short record does not show the rise at long tau.
Intervals of B and K are those of the profile likelihood, with every other term free.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import FloatArray, IntArray, frozen
from undrift.base.summary import Shown
from undrift.errors import InputError
from undrift.findings import Finding, Level, finding
from undrift.model import AXES, NoiseModel, Verdict
from undrift.record import Record
from undrift.segments import BENCH_ACCEL_LIMIT, BENCH_RATE_LIMIT
from undrift.units import RADIAN_PER_DEGREE, SI_UNIT, Quantity, is_physical, si_factor

# ---- overlapping Allan deviation with confidence limits
#
# With phase x_k = sum of the first k readings times the sample period, tau = m periods and D2 the second difference over m samples:
#
#     sigma^2 = mean D2(x)^2 / (2 tau^2)        over every k
#
# Where samples are missing, only terms whose samples are all there count: the mean runs over them, averaging times go up to those
# of which two windows' worth of terms are left, the kind of noise comes from neighbouring whole averages, and the degrees of
# freedom are those of a record without gaps with as many terms.
#
# The estimate of a variance is distributed as chi-square with ``edf`` equivalent degrees of freedom [1]_, which depend on the kind
# of noise; the kind is found at each tau from the lag-1 autocorrelation of the averaged readings [2]_.
#
# .. [1] C. A. Greenhall and W. J. Riley, "Uncertainty of stability variances based on finite differences", PTTI 2003.
# .. [2] W. J. Riley, "Handbook of frequency stability analysis", NIST SP 1065, 2008, sections 5.2-5.5.


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


def allan_deviation(
    x: ArrayLike, sample_rate_hz: float, *, taus: Sequence[float] | None = None, confidence: float = 0.95
) -> AllanDeviation:
    """Return the overlapping Allan deviation of one channel (N,), NaN where samples are missing; taus in s, octaves by default."""
    y = frozen(x, (None,), "x")
    gap = np.isnan(y)
    if not (sample_rate_hz > 0.0 and 0.0 < confidence < 1.0):
        raise InputError(
            f"allan_deviation: wanted a sample rate above 0 and a confidence within (0, 1), got {sample_rate_hz:g} Hz and "
            f"{confidence:g}; state others"
        )
    phase = np.concatenate(([0.0], np.cumsum(np.where(gap, 0.0, y - np.nanmean(y)))))
    lost = np.concatenate(([0], np.cumsum(gap))) if gap.any() else None
    m = averages_of(taus, int((~gap).sum()), sample_rate_hz)
    if lost is None:
        deviation, phases = _deviations(phase, m), np.full(len(m), len(phase))
    else:
        m, deviation, phases = _of_whole_terms(phase, lost, m)
    noise = _kinds(phase, lost, m)
    edf = np.array([_edf(*each) for each in zip(m.tolist(), noise.tolist(), phases.tolist(), strict=True)])
    lower, upper = _limits(deviation, edf, confidence)
    taus_s = m / sample_rate_hz
    return AllanDeviation(taus_s=taus_s, deviation=deviation, lower=lower, upper=upper, edf=edf, noise=noise)


def _of_whole_terms(phase: FloatArray, lost: IntArray, m: IntArray) -> tuple[IntArray, FloatArray, IntArray]:
    """Return averaging times in samples, deviations, and phases of a record without gaps that has as many terms; lost (N + 1,)."""
    lengths, squares, phases = list[int](), list[float](), list[int]()
    for k in m.tolist():
        first = np.arange(0, len(phase) - 2 * k)
        first = first[lost[first + 2 * k] == lost[first]]
        if len(first) < 2 * k:
            continue
        difference = phase[first] - 2.0 * phase[first + k] + phase[first + 2 * k]
        lengths.append(k)
        phases.append(len(first) + 2 * k)
        squares.append(float(np.mean(difference**2)) / 2.0)
    if not lengths:
        raise InputError(
            "allan_deviation: wanted averaging times of which whole windows are left, got none between "
            f"{int(lost[-1])} gaps; record longer without gaps"
        )
    averages = np.array(lengths, np.int64)
    return averages, np.sqrt(np.array(squares)) / averages, np.array(phases, np.int64)


def averages_of(taus: Sequence[float] | None, count: int, rate: float) -> IntArray:
    """Return the averaging times in samples: octaves up to a quarter of the record, or those that are stated."""
    if taus is None:
        if count < 4:
            raise InputError(f"allan_deviation: wanted 4 samples or more, got {count}; record longer")
        return np.asarray(2 ** np.arange((count // 4).bit_length()), np.int64)
    wanted = np.asarray(taus, float)
    m: IntArray = np.unique(np.rint(wanted * rate).astype(np.int64))
    if not len(m) or m[0] < 1 or m[-1] * 2 > count:
        raise InputError(
            f"allan_deviation: wanted averaging times from {1.0 / rate:g} s to {count / 2 / rate:g} s, got "
            f"{wanted.min() if len(wanted) else np.nan:g} to {wanted.max() if len(wanted) else np.nan:g} s; record longer or ask "
            "for less"
        )
    return m


def _deviations(phase: FloatArray, m: IntArray) -> FloatArray:
    """Return deviations in the unit of the readings; the phase counts in readings, so tau is m."""
    from undrift.kernels.calibrate import second_difference

    square = np.array([second_difference(phase, int(k)) for k in m])
    return np.asarray(np.sqrt(square / 2.0) / m.astype(float))


def _kinds(phase: FloatArray, lost: IntArray | None, m: IntArray) -> IntArray:
    """Return the power of frequency at each averaging time, from the lag-1 autocorrelation (SP 1065, 5.5.6)."""
    kinds, kind = [], 0
    for k in m.tolist():
        z = np.diff(phase[::k])
        if lost is not None:
            z[np.diff(lost[::k]) > 0] = np.nan
        if np.isfinite(z).sum() >= _LEAST_AVERAGES:
            kind = int(np.clip(_power(z), -2, 2))
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


def _edf(m: int, alpha: int, phases: int) -> float:
    """Return the equivalent degrees of freedom [1]."""
    strides, filtered = min(m, _STRIDES), min(m, 1000)
    terms = max(1, 1 + int(strides * (phases - m / filtered - 2.0 * m) / m))
    j = np.arange(1, min(terms, 3 * strides) + 1)
    zero = float(_autocovariance(np.zeros(1), filtered, alpha)[0])
    later = _autocovariance(j / strides, filtered, alpha)
    weight = 2.0 * (1.0 - j / terms)
    weight[-1] /= 2.0
    total = zero**2 + float(weight @ later**2)
    return max(terms * zero**2 / total, 1.0)


def _autocovariance(t: FloatArray, filtered: int, alpha: int) -> FloatArray:
    """Return the generalised autocovariance of the phase, differenced twice, at shifts t (in units of m)."""
    f = float(filtered)

    def power(t: FloatArray) -> FloatArray:
        size, exponent = np.abs(t), 3 - alpha
        value: FloatArray = size**exponent
        if exponent % 2 == 0:
            value = value * np.log(np.where(size > 0.0, size, 1.0))
        return value if alpha in (0, 1) else -value

    def averaged(t: FloatArray) -> FloatArray:
        return np.asarray(f * f * (2.0 * power(t) - power(t - 1.0 / f) - power(t + 1.0 / f)))

    once, twice = (averaged(t - shift) + averaged(t + shift) for shift in (1, 2))
    return np.asarray(6.0 * averaged(t) - 4.0 * once + twice)


def _limits(deviation: FloatArray, edf: FloatArray, confidence: float) -> tuple[FloatArray, FloatArray]:
    """Return sqrt(edf / chi-square quantile) either way."""
    from scipy.special import gammaincinv

    tail = 0.5 * (1.0 - confidence)
    high, low = 2.0 * gammaincinv(0.5 * edf, 1.0 - tail), 2.0 * gammaincinv(0.5 * edf, tail)
    return deviation * np.sqrt(edf / high), deviation * np.sqrt(edf / np.maximum(low, 1e-300))


FLICKER = 2.0 * np.log(2.0) / np.pi
_NAMES = ("angle_random_walk", "bias_instability", "rate_random_walk")
TERMS = {  # an accelerometer has other terms for the same slopes
    "gyro": dict(zip(_NAMES, ("angle random walk", "bias instability", "rate random walk"), strict=True)),
    "accel": dict(zip(_NAMES, ("velocity random walk", "bias instability", "acceleration random walk"), strict=True)),
}
SIGNIFICANT = 2.0  # standard deviations above zero
SHORTEST = 64  # samples
_LONGER = 4  # times the record that does not show a term: twice the averaging time with twice the confidence
_MOST_DROP_OUTS = 0.1  # of the steps: a time with more of them is not even between drop-outs
_MODEL_ERRORS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)  # of the variance at each tau, tried in turn


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseCoefficient:
    """One coefficient and its confidence interval."""

    value: float  # NaN where the record does not show it
    interval: tuple[float, float]  # Lower and upper limit; (0, upper limit) where it is not shown
    unit: str  # Unit of all three
    finding: Finding | None = None  # Why it is not shown; None when it is

    @property
    def reason(self) -> str:
        """The finding as a text; "" where it is shown."""
        return "" if self.finding is None else self.finding.text


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisNoise:
    """Noise of one axis."""

    axis: str  # x, y or z
    angle_random_walk: NoiseCoefficient  # N; velocity random walk for an accelerometer
    bias_instability: NoiseCoefficient  # B
    rate_random_walk: NoiseCoefficient  # K; acceleration random walk for an accelerometer
    quantization: NoiseCoefficient  # Q, of the angle (velocity)
    model_error: float  # Share of the Allan variance by which the curve departs from the model

    def terms(self, taus_s: FloatArray) -> dict[str, FloatArray]:
        """Return the terms of the Allan variance that the record shows, by name."""
        shapes = {"angle_random_walk": 1.0 / taus_s, "bias_instability": FLICKER + 0.0 * taus_s}
        shapes |= {"rate_random_walk": taus_s / 3.0, "quantization": 3.0 / taus_s**2}
        return {name: np.nan_to_num(getattr(self, name).value) ** 2 * shape for name, shape in shapes.items()}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseFit(Shown):
    """Noise of a device at rest.

    Parameters
    ----------
    gyro, accel : tuple of AxisNoise
        Three axes, or none where the record has no such triad.
    gyro_unit, accel_unit : str
        rad/s and m/s2, or the device's unit where it is not a physical one.
    taus_s : array, shape (M,)
        Averaging times, s.
    gyro_adev, accel_adev : array, shape (M, 3)
        Overlapping Allan deviation; no columns where the record has no such triad.
    gyro_limits, accel_limits : array, shape (2, M, 3)
        Lower and upper limit of the deviations; no columns likewise.
    duration_s : float
        Length of the record, s.
    confidence : float
        Probability of the intervals.
    verdict : Verdict
        What was not observable, and how long to record.
    """

    gyro: tuple[AxisNoise, ...]
    accel: tuple[AxisNoise, ...]
    gyro_unit: str
    accel_unit: str
    taus_s: FloatArray
    gyro_adev: FloatArray
    accel_adev: FloatArray
    gyro_limits: FloatArray
    accel_limits: FloatArray
    duration_s: float
    confidence: float
    verdict: Verdict

    def _rows(self) -> dict[str, str]:
        rows = {"record": f"{self.duration_s:.4g} s"}
        for triad, terms in TERMS.items():
            for name, term in terms.items():
                held = [getattr(axis, name) for axis in getattr(self, triad)]
                if held:
                    values = ", ".join("not seen" if np.isnan(one.value) else f"{one.value:.3g}" for one in held)
                    rows[f"{triad}: {term}"] = f"{values} {held[0].unit}"
        return rows | {"verdict": self.verdict.status}

    def model(self) -> NoiseModel:
        """Return the coefficients as a calibration keeps them.

        Returns
        -------
        NoiseModel
            SI; NaN where not observable or not recorded.

        Raises
        ------
        InputError
            The readings are counts or volts.
        """
        values = []
        for axes, unit in ((self.gyro, self.gyro_unit), (self.accel, self.accel_unit)):
            if axes and not is_physical(unit):
                raise InputError(
                    f"noise model: wanted rad/s and m/s2, got {unit}; correct the record with its calibration first"
                )
            values += [np.array([getattr(axis, name).value for axis in axes] or (np.nan,) * 3) for name in _NAMES]
        names = (*_NAMES, "velocity_random_walk", "accel_bias_instability", "accel_random_walk")
        return NoiseModel(**dict(zip(names, values, strict=True)))


def fit_noise(record: Record, *, confidence: float = 0.95) -> NoiseFit:
    """Fit noise coefficients to a device at rest.

    Model and weights: module docstring.

    Parameters
    ----------
    record : Record
        At rest throughout. Drop-outs and gaps (NaN) are allowed: what spans one does not count, so that the longest averaging time
        is that of the stretches between them.
    confidence : float
        Probability of the intervals, between 0 and 1.

    Returns
    -------
    NoiseFit
        SI where the record's unit is physical, else in the device's unit.

    Raises
    ------
    InputError
        Fewer than 64 samples, uneven time, a channel that never changes, or motion; says where.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> gyro = 0.01 * np.random.default_rng(1).standard_normal((20_000, 3))
    >>> found = undrift.fit_noise(undrift.Record(time=np.arange(20_000) / 100.0, gyro=gyro))
    >>> print(f"{found.gyro[0].angle_random_walk.value:.4f}")  # 0.01 rad/s at 100 Hz: 0.001 rad/s/sqrt(Hz)
    0.0010
    """
    places = _places(record)
    gyro, gyro_unit, gyro_curves, taus_s = _triad(record, "rate", confidence, places)
    accel, accel_unit, accel_curves, accel_taus_s = _triad(record, "accel", confidence, places)
    shared = min(len(taus_s), len(accel_taus_s))  # one triad may have more gaps than the other
    gyro_curves, accel_curves, taus_s = gyro_curves[:, :shared], accel_curves[:, :shared], taus_s[:shared]
    return NoiseFit(
        gyro=gyro,
        accel=accel,
        gyro_unit=gyro_unit,
        accel_unit=accel_unit,
        taus_s=taus_s,
        gyro_adev=gyro_curves[0],
        accel_adev=accel_curves[0],
        gyro_limits=gyro_curves[1:],
        accel_limits=accel_curves[1:],
        duration_s=record.duration_s,
        confidence=confidence,
        verdict=Verdict.of(
            *_of_units(record, gyro), *_judged(gyro, accel, record.duration_s), *_gaps(record, places, taus_s)
        ),
    )


def _places(record: Record) -> IntArray | None:
    """Return the place of each sample (N,) on an even clock; None where none is missing."""
    steps = np.diff(record.time) * record.sample_rate_hz
    over = steps > 1.5
    if len(record) < SHORTEST or over.mean() > _MOST_DROP_OUTS:
        raise InputError(
            f"noise: wanted {SHORTEST} evenly spaced samples or more, got {len(record)} with {int(over.sum())} drop-outs; record "
            "longer, or where a host stamped the samples use `clock` regular"
        )
    if not over.any():
        return None
    return np.concatenate(([0], np.cumsum(np.where(over, np.maximum(np.rint(steps), 2.0), 1.0).astype(np.int64))))


def _gaps(record: Record, places: IntArray | None, taus_s: FloatArray) -> Iterator[Finding]:
    whole = np.ones(len(record), bool)
    for values in (record.gyro, record.accel):
        whole &= True if values is None else np.isfinite(values).all(axis=1)
    seen = (np.arange(len(record)) if places is None else places)[whole]
    lost, span = np.diff(seen) - 1, int(seen[-1] - seen[0]) + 1
    if lost.any():
        share = 100.0 * float(lost.sum()) / span
        yield finding("noise.gaps", "info", gaps=(lost > 0).sum(), missing_percent=share, longest_s=taus_s[-1])


def _triad(
    record: Record, quantity: Quantity, confidence: float, places: IntArray | None
) -> tuple[tuple[AxisNoise, ...], str, FloatArray, FloatArray]:
    """Return the noise of each axis, its unit, deviations with lower and upper limits (3, M, axes), and averaging times (M,)."""
    what = "gyro" if quantity == "rate" else "accel"
    values, unit = getattr(record, what), getattr(record, f"{what}_unit")
    if values is None:
        taus_s = averages_of(None, len(record), record.sample_rate_hz) / record.sample_rate_hz
        return (), SI_UNIT[quantity], np.empty((3, len(taus_s), 0)), taus_s
    factor = si_factor(unit, quantity) if is_physical(unit) else None
    whole = np.isfinite(values).all(axis=1)
    if whole.sum() < SHORTEST:
        raise InputError(
            f"noise: wanted {SHORTEST} {what} readings or more, got {int(whole.sum())} beside {int((~whole).sum())} gaps (NaN); "
            "record longer"
        )
    _check_rest(values[whole], record.time[whole], record.sample_rate_hz, quantity, factor)
    shown = unit if factor is None else SI_UNIT[quantity]
    scaled = values * (1.0 if factor is None else factor)
    if places is not None or not whole.all():
        places = np.arange(len(values)) if places is None else places
        spread = np.full((int(places[-1]) + 1, 3), np.nan)
        spread[places[whole]] = scaled[whole]
        scaled = spread
    curves = [allan_deviation(column, record.sample_rate_hz, confidence=confidence) for column in scaled.T]
    axes = tuple(_axis(curve, axis, shown, record, confidence) for curve, axis in zip(curves, AXES, strict=True))
    # The same gaps on all axes: the same averaging times.
    limits = np.stack([np.column_stack([getattr(c, k) for c in curves]) for k in ("deviation", "lower", "upper")])
    return axes, shown, limits, curves[0].taus_s


def _check_rest(values: FloatArray, time: FloatArray, rate: float, quantity: Quantity, factor: float | None) -> None:
    """Raise where the spread within one-second windows is ten times the usual, or where a channel is stuck."""
    what = "gyro" if quantity == "rate" else "accel"
    width = min(max(16, round(rate)), len(values) // 4)
    count, whole = len(values) // width, values.std(axis=0)
    if (whole == 0.0).any():
        raise InputError(
            f"noise: wanted readings that vary, got one value throughout in {what} {AXES[int(np.argmin(whole))]}; check the column"
        )
    spread = values[: count * width].reshape(count, width, 3).std(axis=1)
    moved = np.flatnonzero((spread > 10.0 * np.maximum(np.median(spread, axis=0), whole * 1e-3)).any(axis=1))
    if len(moved):
        at = float(time[int(moved[0]) * width])
        raise InputError(
            f"noise: wanted a device at rest, got {what} motion in {len(moved)} of {count} windows, first at {at:.6g} s; "
            "cut out a stretch at rest",
            first_s=at,
        )
    if factor is not None:
        motion, noise = (part * factor for part in _slow_motion(values, width))
        limit = BENCH_RATE_LIMIT if quantity == "rate" else BENCH_ACCEL_LIMIT
        if motion > max(limit, 3.0 * noise):
            raise InputError(
                f"noise: wanted a device at rest, got {what} readings that vary by {motion:.3g} {SI_UNIT[quantity]} within "
                f"{width / rate:.2g} s, where a bench allows {limit:.2g}; lay the device down",
                motion=motion,
            )


def _slow_motion(values: FloatArray, width: int) -> tuple[float, float]:
    """Return the typical spread of tenths of windows of ``width`` samples, and what white noise alone would make of it."""
    tenth, count = max(1, width // 10), len(values) // width
    tenths = values[: count * width].reshape(count, width, 3)[:, : width // tenth * tenth]
    means = tenths.reshape(count, -1, tenth, 3).mean(axis=2)
    white = float(np.sqrt((np.diff(values, axis=0).var(axis=0) / 2.0).sum() / tenth))
    return float(np.median(np.sqrt(means.var(axis=1).sum(axis=1)))), white


def _axis(curve: AllanDeviation, axis: str, unit: str, record: Record, confidence: float) -> AxisNoise:
    from scipy.special import ndtri

    tau = curve.taus_s
    design = np.column_stack((3.0 / tau**2, 1.0 / tau, np.full(len(tau), FLICKER), tau / 3.0))
    terms, squares, errors, departures, misfit = _fit(curve, design, record)
    wide = float(ndtri(0.5 + 0.5 * confidence))
    likelihood = _Likelihood.of(curve, design, departures, wide)
    rows: tuple[tuple[int, str, str, Finding], ...] = (
        (0, "quantization", f"{unit} s", finding("noise.no_quantization", "info")),
        (1, "angle_random_walk", f"{unit}/sqrt(Hz)", finding("noise.no_random_walk", "info")),
        (2, "bias_instability", unit, finding("noise.no_flat_part", "info")),
        (3, "rate_random_walk", f"{unit}/sqrt(s)", finding("noise.no_rise", "info", longest_s=tau[-1])),
    )
    coefficients: dict[str, NoiseCoefficient] = {}
    for term, name, of, why in rows:
        if term in _LONG:
            low, high = likelihood.interval(term)
        elif term in terms:  # limits by the logarithm stay positive
            low, high = np.sqrt(squares[term]) * np.exp(np.array([-0.5, 0.5]) * wide * errors[term] / squares[term])
        else:
            high = float(np.sqrt(max(squares[term], 0.0) + wide * errors[term]))
        if term in terms:
            value = float(np.sqrt(squares[term]))
            coefficients[name] = NoiseCoefficient(
                value=value, interval=(min(float(low), value), max(float(high), value)), unit=of
            )
        else:
            coefficients[name] = NoiseCoefficient(value=np.nan, interval=(0.0, high), unit=of, finding=why)
    return AxisNoise(axis=axis, model_error=misfit, **coefficients)


def _fit(
    curve: AllanDeviation, design: FloatArray, record: Record
) -> tuple[tuple[int, ...], FloatArray, FloatArray, FloatArray, float]:
    """Return the terms kept, squares of the coefficients, their standard errors, relative covariance (M, M), and model error."""
    measured = curve.deviation**2
    spectra, squared_gain = _spectra(curve.taus_s, record)
    covariance: FloatArray = np.diag(2.0 * measured**2 / curve.edf)
    total, misfit, terms, squares = _stretched(measured, design, covariance, measured)
    for _ in range(5):
        model: FloatArray = np.maximum(design @ squares, 1e-3 * measured)
        covariance = _covariance(squares, model, curve.edf, spectra, squared_gain)
        total, misfit, terms, squares = _stretched(measured, design, covariance, model)
    errors = np.zeros(4)
    for term in range(4):  # a dropped term's limit comes from a fit with it added
        chosen = sorted({*terms, term})
        value, cov, _ = _weighted(measured, design[:, chosen], total)
        at = chosen.index(term)
        errors[term] = float(np.sqrt(cov[at, at]))
        if term not in terms:
            squares[term] = float(value[at])
    return terms, squares, errors, total / np.outer(model, model), misfit


# ---- intervals of what long averaging times show
#
# Flicker and random walk explain the same few points, each of few degrees of freedom. The logarithm of an Allan variance s2 with
# edf of them about its expectation m is taken as normal with the limits of chi-square at the confidence asked, whatever m is, and
# with the correlations of the fit. With r the departures,
#
#     c(q) = r' C^-1 r,    q = Q^2, N^2, B^2, K^2 >= 0
#
# and the interval of a coefficient holds those values at which the least c over the other three exceeds the least of all by no more
# than the square of the normal's quantile: a rise that another term may explain as well widens it.

_LONG = (2, 3)
_STEPS = 30
_SETTLED = 1e-3  # of c
_LEAST_SHARE = 1e-12  # of the measured variance
_WIDEST = 1e6  # of the coefficient's square: the search for a limit ends there


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Likelihood:
    """Departures of logarithmic Allan variances, M averaging times."""

    white: FloatArray  # (M, M), inverse root of their covariance
    value: FloatArray  # (M,), middle of log m less log s2
    design: FloatArray  # (M, 4), over s2, columns scaled to one
    unit: FloatArray  # (4,), those scales
    wide: float  # quantile of the normal

    @classmethod
    def of(cls, curve: AllanDeviation, design: FloatArray, relative: FloatArray, wide: float) -> "_Likelihood":
        """Take the fit's covariance relative to the model, (M, M), with the spread of the logarithm of chi-square."""
        from scipy.special import chdtri, ndtr

        ends = np.log(curve.edf / chdtri(curve.edf, ndtr(np.array([[-wide], [wide]]))))
        spread = (ends[1] - ends[0]) / (2.0 * wide) / np.sqrt(2.0 / curve.edf)
        white = np.linalg.inv(np.linalg.cholesky(relative * np.outer(spread, spread)))
        scaled = design / curve.deviation[:, None] ** 2
        unit = scaled.max(axis=0)
        return cls(white=white, value=0.5 * (ends[0] + ends[1]), design=scaled / unit, unit=unit, wide=wide)

    def interval(self, term: int) -> tuple[float, float]:
        """Return the limits of one coefficient."""
        from scipy.optimize import brentq

        every = np.arange(4)
        best, least = self._least(every, np.full(4, 0.1))
        others, limit = every[every != term], least + self.wide**2

        def over(log_square: float) -> float:
            q = best.copy()
            q[term] = np.exp(log_square)
            return self._least(others, q)[1] - limit

        middle = float(np.log(max(best[term], 1e-9)))
        end, far = middle, float(np.log(_WIDEST))
        while end < far and over(end) < 0.0:
            end += 1.0
        high = float(brentq(over, end - 1.0, end, xtol=0.01)) if middle < end < far else end
        low = -np.inf
        if best[term] > 0.0 and over(-far) > 0.0:
            low = float(brentq(over, -far, middle, xtol=0.01))
        lower, upper = np.sqrt(np.exp((low, high)) / self.unit[term])
        return float(lower), float(upper)

    def _least(self, free: IntArray, q: FloatArray) -> tuple[FloatArray, float]:
        """Return the free ones of q (4,) at the least c, the others as given, and c: Gauss-Newton steps that stay positive."""
        from scipy.optimize import nnls

        fixed = np.setdiff1d(np.arange(4), free)
        q, (cost, model) = np.array(q), self._cost(q)
        for _ in range(_STEPS):
            target = self.value - np.log(model) + 1.0 - (self.design[:, fixed] @ q[fixed]) / model
            wanted, step = q.copy(), 1.0
            wanted[free] = nnls(self.white @ (self.design[:, free] / model[:, None]), self.white @ target)[0]
            for step in 0.5 ** np.arange(10):
                trial = q + step * (wanted - q)
                new, changed = self._cost(trial)
                if new < cost:
                    break
            else:
                return q, cost
            q, model, gain, cost = trial, changed, cost - new, new
            if gain < _SETTLED:
                break
        return q, cost

    def _cost(self, q: FloatArray) -> tuple[float, FloatArray]:
        model: FloatArray = np.maximum(self.design @ q, _LEAST_SHARE)
        departure = self.white @ (self.value - np.log(model))
        return float(departure @ departure), model


def _stretched(
    measured: FloatArray, design: FloatArray, covariance: FloatArray, model: FloatArray
) -> tuple[FloatArray, float, tuple[int, ...], FloatArray]:
    """Return the covariance with the least model error that the residuals bear, that error, and the fit under it."""
    for misfit in _MODEL_ERRORS:
        total: FloatArray = covariance + np.diag((misfit * model) ** 2)
        kept, squares, chi = _significant(measured, design, total)
        freedom = len(measured) - len(kept)
        if chi <= freedom + np.sqrt(2.0 * max(freedom, 1)):
            break
    return total, misfit, kept, squares


def _significant(
    measured: FloatArray, design: FloatArray, covariance: FloatArray
) -> tuple[tuple[int, ...], FloatArray, float]:
    """Return the best set of terms that all stand out from zero: least chi-square plus four for each term."""
    tried = [terms for size in range(1, min(4, len(measured)) + 1) for terms in itertools.combinations(range(4), size)]
    fits = [(terms, *_weighted(measured, design[:, terms], covariance)) for terms in tried]
    seen = [one for one in fits if (one[1] > SIGNIFICANT * np.sqrt(np.diag(one[2]))).all()]
    # Where nothing stands out, the white term is what there is.
    terms, value, _, chi = min(seen, key=lambda one: one[3] + SIGNIFICANT**2 * len(one[0]), default=fits[1])
    squares = np.zeros(4)
    squares[list(terms)] = value
    return terms if seen else (), squares, chi


def _weighted(measured: FloatArray, design: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    white = np.linalg.solve(np.linalg.cholesky(covariance), np.column_stack((design, measured)))
    a, b = white[:, :-1], white[:, -1]
    size = np.linalg.norm(a, axis=0)
    inverse = np.linalg.pinv((a / size).T @ (a / size)) / np.outer(size, size)
    value = inverse @ (a.T @ b)
    residual = b - a @ value
    return value, inverse, float(residual @ residual)


def _spectra(tau: FloatArray, record: Record) -> tuple[FloatArray, FloatArray]:
    """Return one-sided spectra of the four terms (F, 4), and the squared gain of each Allan variance times root df (M, F)."""
    top = 0.5 * record.sample_rate_hz
    edges = np.geomspace(0.2 / record.duration_s, top, 3001)
    f = np.sqrt(edges[1:] * edges[:-1])
    spectra = np.column_stack(
        (8.0 * np.pi**2 * f**2 / (2.0 * top), np.full(len(f), 2.0), 1.0 / (np.pi * f), 1.0 / (2.0 * np.pi**2 * f**2))
    )
    x = np.pi * np.outer(tau, f)
    gain = 2.0 * np.sin(x) ** 4 / x**2
    return spectra, gain * np.sqrt(np.diff(edges))


def _covariance(
    squares: FloatArray, model: FloatArray, edf: FloatArray, spectra: FloatArray, squared_gain: FloatArray
) -> FloatArray:
    """Return the covariance of the Allan variances: correlations of the model's spectrum, variances 2 sigma^4 / edf."""
    root = squared_gain * (spectra @ np.maximum(squares, 0.0))
    gram = root @ root.T
    size = np.sqrt(np.diag(gram))
    correlation = 0.999 * gram / np.outer(size, size) + 0.001 * np.eye(len(size))
    spread = model * np.sqrt(2.0 / edf)
    return np.asarray(correlation * np.outer(spread, spread))


_USUAL_WALK = (3e-4, 0.2)  # deg/s/sqrt(Hz): of boards, from the best to the oldest
_LEAST_HZ = 0.5  # below, no noise of a board is recorded


def _of_units(record: Record, gyro: tuple[AxisNoise, ...]) -> Iterator[Finding]:
    """Yield what speaks for another unit of time or of the gyroscope."""
    if record.sample_rate_hz < _LEAST_HZ:
        what = f"{record.sample_rate_hz:.3g} samples a second"
        yield finding("noise.unit", "warn", text="Time is in milliseconds, not seconds", what=what)
    elif gyro and is_physical(record.gyro_unit):
        walk = float(np.median([axis.angle_random_walk.value for axis in gyro])) / RADIAN_PER_DEGREE
        named = ("rad/s, not deg/s", "deg/s, not rad/s")
        for k, wrong in enumerate((walk < _USUAL_WALK[0], walk > _USUAL_WALK[1])):
            if wrong:
                what = f"angle random walk of {walk:.2g} deg/s/sqrt(Hz), usual: 0.002 to 0.05"
                yield finding("noise.unit", "warn", text=f"Gyroscope is in {named[k]}", what=what)


def _judged(gyro: tuple[AxisNoise, ...], accel: tuple[AxisNoise, ...], duration_s: float) -> Iterator[Finding]:
    for triad, axes in (("gyro", gyro), ("accel", accel)):
        for name, term in TERMS[triad].items():
            lost = tuple(a.axis for a in axes if getattr(a, name).finding)
            if lost:
                nowhere = name == "bias_instability" and len(lost) == len(axes)
                level: Level = "warn" if name == "angle_random_walk" or nowhere else "info"
                more = {"duration_s": duration_s, "wanted_h": int(np.ceil(_LONGER * duration_s / 3600.0))}
                yield finding("noise.not_observable", level, triad=triad, axes=lost, term=term, **more)
        worst = max((a.model_error for a in axes), default=0.0)
        if worst >= 0.1:
            yield finding("noise.model_error", "warn", triad=triad, error_percent=100.0 * worst)
