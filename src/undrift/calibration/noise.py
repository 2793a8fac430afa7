"""Noise of a device at rest: coefficients of the Allan variance, each with its interval, or the reason why it is not observable.

    sigma^2(tau) = 3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3          IEEE Std 952-1997, annex C

N angle (velocity) random walk, B bias instability, K rate (acceleration) random walk, Q quantisation. All four are fitted to the
overlapping variances at octaves of tau by generalised least squares, linear in Q^2, N^2, B^2, K^2 >= 0. Variances come from the
equivalent degrees of freedom, correlations from the spectrum of the model (neighbouring octaves share half of their samples).
A coefficient whose square is less than two standard errors above zero is not observable and has an upper limit only.
"""

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
#     sigma^2 = mean D2(x)^2 / (2 tau^2)        over every k whose 2 m samples are all present
#
# The estimate of a variance is distributed as chi-square with ``edf`` equivalent degrees of freedom [1]_, which depend on the kind
# of noise. The kind is determined at each tau from the lag-1 autocorrelation of the averaged readings [2]_. With gaps, the degrees
# of freedom are those of a record without gaps that has as many second differences.
#
# .. [1] C. A. Greenhall and W. J. Riley, "Uncertainty of stability variances based on finite differences", PTTI 2003.
# .. [2] W. J. Riley, "Handbook of frequency stability analysis", NIST SP 1065, 2008, sections 5.2-5.5.

_LEAST_AVERAGES = 30  # averages that determine the kind of noise
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
    """Return the overlapping Allan deviation of one channel (N,), NaN where samples are missing; taus in s, octaves by default.

    Averaging times with fewer than 2 tau of complete second differences are left out if samples are missing.
    """
    y = frozen(x, (None,), "x")
    gap = np.isnan(y)
    if not (sample_rate_hz > 0.0 and 0.0 < confidence < 1.0):
        raise InputError(
            f"allan_deviation: expected a sample rate above 0 and a confidence between 0 and 1, got {sample_rate_hz:g} Hz and "
            f"{confidence:g}."
        )
    averages = averages_of(taus, int((~gap).sum()), sample_rate_hz)
    phase = np.concatenate(([0.0], np.cumsum(np.where(gap, 0.0, y - np.nanmean(y)))))
    missing = np.concatenate(([0], np.cumsum(gap)))
    lengths, squares, phases = list[int](), list[float](), list[int]()
    for m in averages.tolist():
        difference = phase[2 * m :] - 2.0 * phase[m:-m] + phase[: -2 * m]
        if gap.any():
            difference = difference[missing[2 * m :] == missing[: -2 * m]]
            if len(difference) < 2 * m:
                continue
        lengths.append(m)
        squares.append(float(difference @ difference) / len(difference))
        phases.append(len(difference) + 2 * m)
    if not lengths:
        raise InputError(
            f"allan_deviation: {int(gap.sum())} gaps leave no complete averaging time. Record without gaps."
        )
    deviation = np.sqrt(0.5 * np.array(squares)) / np.array(lengths)
    kinds = _noise_kinds(phase, missing, lengths)
    edf = np.array([_degrees_of_freedom(*row) for row in zip(lengths, kinds, phases, strict=True)])
    low, high = _interval_factors(edf, confidence)
    return AllanDeviation(
        taus_s=np.array(lengths) / sample_rate_hz,
        deviation=deviation,
        lower=deviation * low,
        upper=deviation * high,
        edf=edf,
        noise=np.array(kinds, np.int64),
    )


def _interval_factors(edf: FloatArray, confidence: float) -> tuple[FloatArray, FloatArray]:
    """Return the limits of a standard deviation over its estimate: sqrt(edf / chi-square quantile)."""
    from scipy.special import gammaincinv

    tail = 0.5 * (1.0 - confidence)
    high, low = 2.0 * gammaincinv(0.5 * edf, 1.0 - tail), 2.0 * gammaincinv(0.5 * edf, tail)
    return np.sqrt(edf / high), np.sqrt(edf / np.maximum(low, 1e-300))


def averages_of(taus: Sequence[float] | None, count: int, rate: float) -> IntArray:
    """Return the averaging times in samples: octaves up to a quarter of the record, or the given times."""
    if taus is None:
        if count < 4:
            raise InputError(f"allan_deviation: expected 4 samples or more, got {count}. Record longer.")
        return np.asarray(2 ** np.arange((count // 4).bit_length()), np.int64)
    m: IntArray = np.unique(np.rint(np.asarray(taus, float) * rate).astype(np.int64))
    if not len(m) or m[0] < 1 or m[-1] * 2 > count:
        raise InputError(
            f"allan_deviation: expected averaging times from {1.0 / rate:g} s to {count / 2 / rate:g} s, got "
            f"{min(taus, default=np.nan):g} to {max(taus, default=np.nan):g} s. Record longer, or ask for less."
        )
    return m


def _noise_kinds(phase: FloatArray, missing: IntArray, lengths: Sequence[int]) -> list[int]:
    """Return the power of frequency at each averaging time, from the lag-1 autocorrelation (SP 1065, 5.5.6)."""
    kinds, kind = list[int](), 0
    for m in lengths:
        z = np.where(np.diff(missing[::m]) > 0, np.nan, np.diff(phase[::m]))
        if np.isfinite(z).sum() >= _LEAST_AVERAGES:
            kind = int(np.clip(_power(z), -2, 2))
        kinds.append(kind)
    return kinds


def _power(z: FloatArray) -> int:
    differences = 0
    while True:
        present = np.isfinite(z)
        away = np.where(present, z - np.nanmean(z), 0.0)
        pairs = max(1, int((present[1:] & present[:-1]).sum()))
        square = float(away @ away) / present.sum() * (pairs + 1)
        lag = float(away[1:] @ away[:-1]) / square if square > 0.0 else 0.0
        delta = lag / (1.0 + lag)
        if delta < 0.25 or differences == 3:
            return -2 * differences - round(2.0 * delta)
        z, differences = np.diff(z), differences + 1


def _degrees_of_freedom(m: int, alpha: int, phases: int) -> float:
    """Return the equivalent degrees of freedom [1]."""
    strides, filtered = min(m, _STRIDES), min(m, 1000)
    terms = max(1, 1 + int(strides * (phases - m / filtered - 2.0 * m) / m))
    j = np.arange(1, min(terms, 3 * strides) + 1)
    zero = float(_autocovariance(np.zeros(1), filtered, alpha)[0])
    weight = 2.0 * (1.0 - j / terms)
    weight[-1] /= 2.0
    total = zero**2 + float(weight @ _autocovariance(j / strides, filtered, alpha) ** 2)
    return max(terms * zero**2 / total, 1.0)


def _autocovariance(t: FloatArray, filtered: int, alpha: int) -> FloatArray:
    """Return the generalised autocovariance of the phase, differenced twice, at shifts t (in units of m)."""
    exponent, f = 3 - alpha, float(filtered)

    def power(t: FloatArray) -> FloatArray:
        size = np.abs(t)
        value: FloatArray = size**exponent
        if exponent % 2 == 0:
            value = value * np.log(np.where(size > 0.0, size, 1.0))
        return value if alpha in (0, 1) else -value

    def averaged(t: FloatArray) -> FloatArray:
        return np.asarray(f * f * (2.0 * power(t) - power(t - 1.0 / f) - power(t + 1.0 / f)))

    once, twice = (averaged(t - shift) + averaged(t + shift) for shift in (1, 2))
    return np.asarray(6.0 * averaged(t) - 4.0 * once + twice)


# ---- coefficients

FLICKER = 2.0 * np.log(2.0) / np.pi
_NAMES = ("angle_random_walk", "bias_instability", "rate_random_walk")
TERMS = {  # an accelerometer has other terms for the same slopes
    "gyro": dict(zip(_NAMES, ("angle random walk", "bias instability", "rate random walk"), strict=True)),
    "accel": dict(zip(_NAMES, ("velocity random walk", "bias instability", "acceleration random walk"), strict=True)),
}
_ROWS = ("quantization", *_NAMES)  # order of the coefficients in the fit
_UNITS = (" s", "/sqrt(Hz)", "", "/sqrt(s)")
_REASONS = (
    "not observable: no part of the curve falls with the averaging time itself",
    "not observable: no part of the curve falls with the square root of the averaging time",
    "not observable: no flat part of the curve stands out; record longer",
    "not observable: no certain rise of the curve up to {:.3g} s; record longer",
)
# Standard errors of a square: below the first it is not observable; its upper limit lies the second above the estimate. At 1.96,
# 87 to 90 % of the limits of K held in 480 simulated axes, because the standard error of a small square is small too; at 3, 95 %.
OBSERVABLE, UPPER = 2.0, 3.0
SHORTEST = 64  # samples
_LONGER = 4  # times the record that does not show a term: twice the averaging time with twice the confidence
_MOST_DROP_OUTS = 0.1  # of the steps: a time with more of them is not even between drop-outs
_MODEL_ERRORS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)  # of the variance at each tau, tried in turn


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseCoefficient:
    """One coefficient and its confidence interval."""

    value: float  # NaN if not observable
    interval: tuple[float, float]  # lower and upper limit; (0, upper limit) if not observable
    unit: str  # unit of all three
    reason: str = ""  # why it is not observable; "" if it is


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisNoise:
    """Noise of one axis."""

    axis: str  # x, y or z
    angle_random_walk: NoiseCoefficient  # N; velocity random walk for an accelerometer
    bias_instability: NoiseCoefficient  # B
    rate_random_walk: NoiseCoefficient  # K; acceleration random walk for an accelerometer
    quantization: NoiseCoefficient  # Q, of the angle (velocity)
    model_error: float  # share of the Allan variance by which the curve departs from the model

    def terms(self, taus_s: FloatArray) -> dict[str, FloatArray]:
        """Return the observable terms of the Allan variance, by name."""
        return {
            name: np.nan_to_num(getattr(self, name).value) ** 2 * shape
            for name, shape in zip(_ROWS, _shapes(taus_s).T, strict=True)
        }


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
        Which terms are not observable, and how long to record.
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
                coefficients = [getattr(axis, name) for axis in getattr(self, triad)]
                if coefficients:
                    values = ", ".join("not observable" if c.reason else f"{c.value:.3g}" for c in coefficients)
                    rows[f"{triad}: {term}"] = f"{values} {coefficients[0].unit}"
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
        verdict=Verdict.of(*_unit_findings(record, gyro), *_judged(gyro, accel, record.duration_s, taus_s)),
    )


def _places(record: Record) -> IntArray | None:
    """Return the place of each sample (N,) on an even clock; None where none is missing."""
    steps = np.diff(record.time) * record.sample_rate_hz
    over = steps > 1.5
    if len(record) < SHORTEST or over.mean() > _MOST_DROP_OUTS:
        raise InputError(
            f"noise: wanted {SHORTEST} evenly spaced samples or more, got {len(record)} with {int(over.sum())} drop-outs; record "
            "longer, or where a host stamped the samples use clock = 'regular' in a map"
        )
    if not over.any():
        return None
    return np.concatenate(([0], np.cumsum(np.where(over, np.maximum(np.rint(steps), 2.0), 1.0).astype(np.int64))))


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
    count, deviation = len(values) // width, values.std(axis=0)
    if (deviation == 0.0).any():
        raise InputError(f"noise: {what} {AXES[int(np.argmin(deviation))]} has one value throughout. Check the column.")
    spread = values[: count * width].reshape(count, width, 3).std(axis=1)
    moved = np.flatnonzero((spread > 10.0 * np.maximum(np.median(spread, axis=0), deviation * 1e-3)).any(axis=1))
    if len(moved):
        first_s = float(time[int(moved[0]) * width])
        raise InputError(
            f"noise: the device must be at rest, but {what} shows motion in {len(moved)} of {count} windows, first at "
            f"{first_s:.6g} s. Cut out a stretch at rest.",
            first_s=first_s,
        )
    if factor is not None:
        motion, noise = (part * factor for part in _slow_motion(values, width))
        limit = BENCH_RATE_LIMIT if quantity == "rate" else BENCH_ACCEL_LIMIT
        if motion > max(limit, 3.0 * noise):
            raise InputError(
                f"noise: the device must be at rest, but {what} readings vary by {motion:.3g} {SI_UNIT[quantity]} within "
                f"{width / rate:.2g} s; a device on a bench stays below {limit:.2g}. Lay the device down.",
                motion=motion,
            )


def _slow_motion(values: FloatArray, width: int) -> tuple[float, float]:
    """Return the typical spread of tenths of windows of ``width`` samples, and what white noise alone would make of it."""
    tenth, count = max(1, width // 10), len(values) // width
    tenths = values[: count * width].reshape(count, width, 3)[:, : width // tenth * tenth]
    means = tenths.reshape(count, -1, tenth, 3).mean(axis=2)
    white = float(np.sqrt((np.diff(values, axis=0).var(axis=0) / 2.0).sum() / tenth))
    return float(np.median(np.sqrt(means.var(axis=1).sum(axis=1)))), white


def _shapes(tau: FloatArray) -> FloatArray:
    """Return the Allan variance of a unit of Q^2, N^2, B^2 and K^2, (M, 4)."""
    return np.column_stack((3.0 / tau**2, 1.0 / tau, np.full(len(tau), FLICKER), tau / 3.0))


def _axis(curve: AllanDeviation, axis: str, unit: str, record: Record, confidence: float) -> AxisNoise:
    """Fit one axis. The square of an observable coefficient is distributed as chi-square with 2 (square / error)^2 degrees."""
    squares, errors, model_error = _fit(curve, record)
    low, high = np.zeros(4), np.sqrt(squares + UPPER * errors)
    value, observable = np.full(4, np.nan), squares > OBSERVABLE * errors
    value[observable] = np.sqrt(squares[observable])
    factors = _interval_factors(2.0 * (squares[observable] / errors[observable]) ** 2, confidence)
    low[observable], high[observable] = value[observable] * factors
    coefficients = {
        name: NoiseCoefficient(
            value=float(value[k]),
            interval=(float(low[k]), float(high[k])),
            unit=unit + _UNITS[k],
            reason="" if observable[k] else _REASONS[k].format(curve.taus_s[-1]),
        )
        for k, name in enumerate(_ROWS)
    }
    return AxisNoise(axis=axis, model_error=model_error, **coefficients)


def _fit(curve: AllanDeviation, record: Record) -> tuple[FloatArray, FloatArray, float]:
    """Return the squares of the coefficients (4,), their standard errors, and the error of the model.

    The error of the model is the least share of the variance, equal at each tau, that brings chi-square to its degrees of freedom.
    """
    measured, shapes = curve.deviation**2, _shapes(curve.taus_s)
    spectra, squared_gain = _spectra(curve.taus_s, record)
    model: FloatArray = measured
    covariance: FloatArray = np.diag(2.0 * measured**2 / curve.edf)
    for _ in range(6):
        for model_error in _MODEL_ERRORS:
            squares, errors, chi = _weighted(measured, shapes, covariance + np.diag((model_error * model) ** 2))
            freedom = len(measured) - int((squares > 0.0).sum())
            if chi <= freedom + np.sqrt(2.0 * max(freedom, 1)):
                break
        model = np.maximum(shapes @ squares, 1e-3 * measured)
        covariance = _covariance(squares, model, curve.edf, spectra, squared_gain)
    return squares, errors, model_error


def _weighted(measured: FloatArray, shapes: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return non-negative coefficients, their standard errors with all terms free, and chi-square."""
    from scipy.optimize import nnls

    white = np.linalg.solve(np.linalg.cholesky(covariance), np.column_stack((shapes, measured)))
    size = np.linalg.norm(white[:, :-1], axis=0)
    design = white[:, :-1] / size
    value = nnls(design, white[:, -1])[0]
    residual = white[:, -1] - design @ value
    return value / size, np.sqrt(np.diag(np.linalg.pinv(design.T @ design))) / size, float(residual @ residual)


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


def _unit_findings(record: Record, gyro: tuple[AxisNoise, ...]) -> Iterator[Finding]:
    """Yield a finding if time or gyroscope seem to be in another unit."""
    if record.sample_rate_hz < _LEAST_HZ:
        what = f"{record.sample_rate_hz:.3g} samples a second"
        yield finding("noise.unit", "warn", text="Time is in milliseconds, not seconds", what=what)
    elif gyro and is_physical(record.gyro_unit):
        walk = float(np.median([axis.angle_random_walk.value for axis in gyro])) / RADIAN_PER_DEGREE
        what = f"angle random walk of {walk:.2g} deg/s/sqrt(Hz), usual: 0.002 to 0.05"
        if walk < _USUAL_WALK[0]:
            yield finding("noise.unit", "warn", text="Gyroscope is in rad/s, not deg/s", what=what)
        elif walk > _USUAL_WALK[1]:
            yield finding("noise.unit", "warn", text="Gyroscope is in deg/s, not rad/s", what=what)


def _judged(
    gyro: tuple[AxisNoise, ...], accel: tuple[AxisNoise, ...], duration_s: float, taus_s: FloatArray
) -> Iterator[Finding]:
    for triad, axes in (("gyro", gyro), ("accel", accel)):
        for name, term in TERMS[triad].items():
            lost = tuple(axis.axis for axis in axes if getattr(axis, name).reason)
            if lost:
                no_axis = name == "bias_instability" and len(lost) == len(axes)
                level: Level = "warn" if name == "angle_random_walk" or no_axis else "info"
                yield finding(
                    "noise.not_observable",
                    level,
                    triad=triad,
                    axes=lost,
                    term=term,
                    duration_s=duration_s,
                    longest_s=taus_s[-1],
                    wanted_h=int(np.ceil(_LONGER * duration_s / 3600.0)),
                )
        worst = max((axis.model_error for axis in axes), default=0.0)
        if worst >= 0.1:
            yield finding("noise.model_error", "warn", triad=triad, error_percent=100.0 * worst)
