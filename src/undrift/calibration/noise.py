"""Noise of a device at rest: Allan variance coefficients, each with its interval or the reason why it is not observable.

    sigma^2(tau) = 3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3          IEEE Std 952-1997, annex C

N angle (velocity) random walk, B bias instability, K rate (acceleration) random walk, Q quantisation. Non-negative least squares
fits their squares to the overlapping variances at octaves of tau. Each variance is weighted with half of its degrees of freedom,
because octaves share their readings: all octaves together contain no more information than the shortest, 1/2 + 1/4 + 1/8 + ... = 1.
Long averages of slow noise share more, and get less weight. A coefficient is not observable if its square is less than two standard
errors above zero. In this case, it only has an upper limit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import FloatArray, IntArray, frozen
from undrift.errors import InputError
from undrift.findings import Finding, Level, finding
from undrift.fit.gls import excess_variance
from undrift.model import AXES, Verdict
from undrift.record import Record
from undrift.segments import BENCH_ACCEL_LIMIT, BENCH_RATE_LIMIT
from undrift.shown import Shown
from undrift.units import RADIAN_PER_DEGREE, is_physical

# ---- overlapping Allan deviation with confidence limits
#
# x_k is the phase, the sum of the first k readings times the sample period. With tau = m periods and second differences D2:
#
#     sigma^2 = mean D2(x)^2 / (2 tau^2)        over every k whose 2 m samples are all present
#
# The estimate of a variance is distributed as chi-square with ``edf`` equivalent degrees of freedom. They depend on the kind of
# noise, which is estimated from the slope of the curve at tau (Howe, Allan, Barnes, "Properties of signal sources and measurement
# methods", 1981; Riley, NIST SP 1065, 2008, section 5.4.1). With gaps, edf is taken from a gapless record with as many differences.

LEAST_AVERAGES = 30  # averages from which the slope determines the kind of noise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AllanDeviation:
    """Deviation over averaging time, with confidence limits."""

    taus_s: FloatArray  # (M,), averaging times, s
    deviation: FloatArray  # (M,), Allan deviations, unit of the readings
    lower: FloatArray  # (M,), confidence limits, unit of the readings
    upper: FloatArray
    edf: FloatArray  # (M,), equivalent degrees of freedom


def allan_deviation(x: ArrayLike, sample_rate_hz: float, *, taus: Sequence[float] | None = None) -> AllanDeviation:
    """Return the overlapping Allan deviation of one channel (N,), with NaN for missing samples, and its 95 % limits.

    ``taus`` are in s, octaves by default. With missing samples, averaging times with fewer than 2 tau of complete second
    differences are omitted.
    """
    y = frozen(x, (None,), "x")
    gap = np.isnan(y)
    octaves = 2.0 ** np.arange((int((~gap).sum()) // 4).bit_length())
    lengths = octaves if taus is None else np.unique(np.rint(np.asarray(taus, float) * sample_rate_hz))
    phase = np.concatenate(([0.0], np.cumsum(np.where(gap, 0.0, y - np.nanmean(y)))))
    missing = np.concatenate(([0], np.cumsum(gap)))
    rows = list[tuple[int, int, float]]()  # m, number of second differences, and their mean square
    for m in lengths.astype(int).tolist():
        difference = phase[2 * m :] - 2.0 * phase[m:-m] + phase[: -2 * m]
        difference = difference[missing[2 * m :] == missing[: -2 * m]]
        if len(difference) >= 2 * m or not gap.any():
            rows.append((m, len(difference), float(difference @ difference) / len(difference)))
    if not rows:
        raise InputError(
            f"allan_deviation: {int(gap.sum())} gaps leave no complete averaging time. Record without gaps."
        )
    m, terms, square = np.array(rows).T
    variance = 0.5 * square / m**2
    # d log sigma^2 / d log tau (the last averages are few and reuse the slope before them)
    slope = np.full(len(m), -1.0)
    if len(m) > 1:
        slope = np.gradient(np.log(np.maximum(variance, 1e-300)), np.log(m))
        last = max(1, int((terms >= LEAST_AVERAGES * m).sum()))
        slope[last:] = slope[last - 1]
    edf = _degrees_of_freedom(terms + 2.0 * m, m, slope)
    low, high = _interval_factors(edf)
    deviation = np.sqrt(variance)
    return AllanDeviation(
        taus_s=m / sample_rate_hz, deviation=deviation, lower=deviation * low, upper=deviation * high, edf=edf
    )


def _degrees_of_freedom(n: FloatArray, m: FloatArray, slope: FloatArray) -> FloatArray:
    """Return the equivalent degrees of freedom of n phases for averages of m samples, by the kind of noise."""
    white_phase = (n + 1.0) * (n - 2.0 * m) / (2.0 * (n - m))
    white = (1.5 * (n - 1.0) / m - 2.0 * (n - 2.0) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    flicker = np.where(m > 1.0, 1.25 * n**2 / (m * (n + 3.0 * m)), 2.0 * (n - 2.0) ** 2 / (2.3 * n - 4.9))
    walk = (n - 2.0) / m * ((n - 1.0) ** 2 - 3.0 * m * (n - 1.0) + 4.0 * m**2) / (n - 3.0) ** 2
    return np.maximum(np.select([slope < -1.5, slope < -0.5, slope < 0.5], [white_phase, white, flicker], walk), 1.0)


def _interval_factors(edf: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the 95 % limits of a standard deviation over its estimate: sqrt(edf / chi-square quantile)."""
    from scipy.special import gammaincinv

    high, low = 2.0 * gammaincinv(0.5 * edf, 0.975), 2.0 * gammaincinv(0.5 * edf, 0.025)
    return np.sqrt(edf / high), np.sqrt(edf / np.maximum(low, 1e-300))


# ---- coefficients

FLICKER = 2.0 * np.log(2.0) / np.pi
_NAMES = ("angle_random_walk", "bias_instability", "rate_random_walk")
TERMS = {  # an accelerometer has other terms for the same slopes
    "gyro": dict(zip(_NAMES, ("angle random walk", "bias instability", "rate random walk"), strict=True)),
    "accel": dict(zip(_NAMES, ("velocity random walk", "bias instability", "acceleration random walk"), strict=True)),
}
_ROWS = ("quantization", *_NAMES)  # order of the coefficients in the fit
_UNITS = (" s", "/sqrt(Hz)", "", "/sqrt(s)")
# standard errors of a square: smallest observable value, and upper limit of an unobservable square
OBSERVABLE, UPPER = 2.0, 5.0
# variances have weight 1 / SHARED, or 1 / SHARED_LONG below FEW degrees of freedom
SHARED, SHARED_LONG, FEW = 2.0, 3.5, 100.0
SHORTEST = 64  # samples
LONGER = 4  # factor of the record length: twice the averaging time with twice the confidence
MOST_DROP_OUTS = 0.1  # largest share of steps that are drop-outs in an evenly sampled record
ROUNDS = 6  # iterations of the fit, whose weights follow from the model
DEPARTURE = 0.1  # largest relative deviation of the variance from the model without a finding
USUAL_WALK = (3e-4, 0.2)  # angle random walk of boards, from the best to the oldest, deg/s/sqrt(Hz)
LEAST_HZ = 0.5  # lowest sample rate at which the noise of a board is recorded


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseCoefficient:
    """One coefficient and its confidence interval."""

    value: float  # NaN if not observable
    interval: tuple[float, float]  # lower and upper limit, or (0, upper limit) if not observable
    unit: str  # unit of all three
    reason: str = ""  # why it is not observable, or ""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisNoise:
    """Noise of an axis."""

    axis: str  # x, y or z
    curve: AllanDeviation
    angle_random_walk: NoiseCoefficient  # N (for an accelerometer: velocity random walk)
    bias_instability: NoiseCoefficient  # B
    rate_random_walk: NoiseCoefficient  # K (for an accelerometer: acceleration random walk)
    quantization: NoiseCoefficient  # Q, quantisation of the angle (velocity)
    model_error: float  # share of the Allan variance by which the curve departs from the model

    def terms(self, taus_s: FloatArray, *, limits: bool = False) -> dict[str, FloatArray]:
        """Return the terms of the Allan variance, by name: 0, or with ``limits`` its upper limit, if a term is not observable."""
        variances = dict[str, FloatArray]()
        for name, shape in zip(_ROWS, _shapes(taus_s).T, strict=True):
            coefficient: NoiseCoefficient = getattr(self, name)
            unknown = coefficient.interval[1] if limits else 0.0
            variances[name] = (unknown if np.isnan(coefficient.value) else coefficient.value) ** 2 * shape
        return variances

    def angle_uncertainty(self, tau_s: float) -> dict[str, float]:
        """Return the standard uncertainty of an angle by term, rad, if a gyroscope's offset is a mean over a rest.

        The rest lasts tau, as long as the motion, and ends when the motion begins. The two means differ by sqrt(2) sigma(tau), by
        definition of the Allan deviation, so u = tau sqrt(2) sigma(tau). A term that is not observable counts with its upper limit.
        """
        terms = self.terms(np.array([tau_s]), limits=True)
        return {name: float(tau_s * np.sqrt(2.0 * terms[name][0])) for name in _NAMES}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseFit(Shown):
    """Noise of a device at rest."""

    gyro: tuple[AxisNoise, ...]  # one entry per axis; empty if the record has no such triad
    accel: tuple[AxisNoise, ...]
    gyro_unit: str  # rad/s and m/s2, or the unit of the readings if it is not a physical one
    accel_unit: str
    duration_s: float
    verdict: Verdict  # terms that are not observable, and the necessary record length

    def facts(self) -> dict[str, str]:
        """Return the rows of the table of values: name, and value with unit."""
        rows = {"record": f"{self.duration_s:.4g} s"}
        for triad, terms in TERMS.items():
            for name, term in terms.items():
                coefficients = [getattr(axis, name) for axis in getattr(self, triad)]
                if coefficients:
                    values = ", ".join("not observable" if c.reason else f"{c.value:.3g}" for c in coefficients)
                    rows[f"{triad}: {term}"] = f"{values} {coefficients[0].unit}"
        return rows | {"verdict": self.verdict.status}


def fit_noise(record: Record) -> NoiseFit:
    """Fit noise coefficients with 95 % intervals to a recording of a device at rest.

    The module docstring defines model and weights. Raises ``InputError`` for fewer than 64 samples, uneven time, a constant
    channel, or motion.

    Parameters
    ----------
    record : Record
        Recording at rest throughout. Averages that span a drop-out or a gap (NaN) are not used.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> gyro = 0.01 * np.random.default_rng(1).standard_normal((20_000, 3))
    >>> noise = undrift.fit_noise(undrift.Record(time=np.arange(20_000) / 100.0, gyro=gyro))
    >>> print(f"{noise.gyro[0].angle_random_walk.value:.4f}")  # 0.01 rad/s at 100 Hz: 0.001 rad/s/sqrt(Hz)
    0.0010
    """
    units = (record.gyro_unit, "rad/s"), (record.accel_unit, "m/s2")
    record = record.in_units(*(si if is_physical(unit) else unit for unit, si in units))
    gyro, accel = _fit_triad(record, "gyro"), _fit_triad(record, "accel")
    findings = (*_unit_findings(record, gyro), *_findings("gyro", gyro, record), *_findings("accel", accel, record))
    return NoiseFit(
        gyro=gyro,
        accel=accel,
        gyro_unit=record.gyro_unit,
        accel_unit=record.accel_unit,
        duration_s=record.duration_s,
        verdict=Verdict.of(*findings),
    )


def _fit_triad(record: Record, name: str) -> tuple[AxisNoise, ...]:
    """Return the noise of each axis of a triad."""
    values, unit = getattr(record, name), getattr(record, f"{name}_unit")
    if values is None:
        return ()
    places, finite = _places(record), np.isfinite(values).all(axis=1)
    if finite.sum() < SHORTEST:
        raise InputError(
            f"noise: expected {SHORTEST} {name} readings or more, got {int(finite.sum())} and {int((~finite).sum())} gaps (NaN). "
            "Record longer."
        )
    _check_rest(values[finite], record.time[finite], record.sample_rate_hz, name, physical=is_physical(unit))
    readings = np.full((int(places[-1]) + 1, 3), np.nan)  # samples on an even clock
    readings[places[finite]] = values[finite]
    curves = [allan_deviation(column, record.sample_rate_hz) for column in readings.T]
    return tuple(_fit_axis(curve, axis, unit) for curve, axis in zip(curves, AXES, strict=True))


def _places(record: Record) -> IntArray:
    """Return the position of each sample (N,) on an even clock with drop-outs."""
    steps = np.diff(record.time) * record.sample_rate_hz
    over = steps > 1.5
    if len(record) < SHORTEST or over.mean() > MOST_DROP_OUTS:
        raise InputError(
            f"noise: expected {SHORTEST} evenly spaced samples or more, got {len(record)} with {int(over.sum())} drop-outs. Record "
            "longer. If a host added the time stamps, set clock = 'regular' in a map."
        )
    return np.concatenate(([0], np.cumsum(np.where(over, np.maximum(np.rint(steps), 2.0), 1.0).astype(np.int64))))


def _check_rest(values: FloatArray, time: FloatArray, rate_hz: float, name: str, *, physical: bool) -> None:
    """Raise if a channel is stuck, or if means over 0.1 s vary more within a second than they do at rest."""
    deviation = values.std(axis=0)
    if (deviation == 0.0).any():
        raise InputError(f"noise: {name} {AXES[int(np.argmin(deviation))]} has a constant value. Check the column.")
    tenth = max(1, min(round(0.1 * rate_hz), len(values) // 30))
    means = values[: len(values) // (10 * tenth) * 10 * tenth].reshape(-1, 10, tenth, 3).mean(axis=2)
    motion = np.sqrt(means.var(axis=1).sum(axis=1))
    # spread of the means that noise without motion causes
    white = float(np.sqrt((np.diff(values, axis=0).var(axis=0) / 2.0).sum() / tenth))
    usual, limit = float(np.median(motion)), BENCH_RATE_LIMIT if name == "gyro" else BENCH_ACCEL_LIMIT
    moving = np.flatnonzero(motion > 10.0 * max(usual, white))
    if len(moving) or (physical and usual > max(limit, 3.0 * white)):
        first_s = float(time[int(moving[0] if len(moving) else 0) * 10 * tenth])
        raise InputError(
            f"noise: the device must be at rest, but {name} readings move in {len(moving) or len(motion)} of {len(motion)} "
            f"windows, first at {first_s:.6g} s, by up to {motion.max():.3g}. Lay the device down, or cut out a stretch at rest.",
            first_s=first_s,
            motion=float(motion.max()),
        )


def _shapes(tau: FloatArray) -> FloatArray:
    """Return the Allan variance of a unit of Q^2, N^2, B^2 and K^2, (M, 4)."""
    return np.column_stack((3.0 / tau**2, 1.0 / tau, np.full(len(tau), FLICKER), tau / 3.0))


def _fit_axis(curve: AllanDeviation, axis: str, unit: str) -> AxisNoise:
    """Fit an axis. The square of an observable coefficient is chi-square distributed with 2 (square / error)^2 degrees of
    freedom."""
    from scipy.optimize import nnls

    # variance of the curve over its square
    measured, shapes, log_variance = curve.deviation**2, _shapes(curve.taus_s), 2.0 / curve.edf
    shared = np.where(curve.edf < FEW, SHARED_LONG, SHARED) * log_variance
    model, departure = measured, 0.0
    for _ in range(ROUNDS):
        spread = model * np.sqrt(shared + departure)
        rows = shapes / spread[:, None]
        size = np.linalg.norm(rows, axis=0)
        squares = nnls(rows / size, measured / spread)[0] / size
        model = np.maximum(shapes @ squares, 1e-3 * measured)
        departure = excess_variance(
            np.log(measured / model), log_variance, float(len(measured) - np.count_nonzero(squares))
        )
    errors = np.sqrt(np.diag(np.linalg.pinv((rows / size).T @ (rows / size)))) / size  # errors with all terms free
    observable, value = squares > OBSERVABLE * errors, np.sqrt(squares)
    low, high = _interval_factors(2.0 * np.where(observable, squares / errors, 1.0) ** 2)
    high = np.where(observable, value * high, np.sqrt(squares + UPPER * errors))
    coefficients = {
        name: NoiseCoefficient(
            value=float(value[k]) if observable[k] else np.nan,
            interval=(float(value[k] * low[k]) if observable[k] else 0.0, float(high[k])),
            unit=unit + _UNITS[k],
            reason="" if observable[k] else f"not observable in averages up to {curve.taus_s[-1]:.3g} s: record longer",
        )
        for k, name in enumerate(_ROWS)
    }
    return AxisNoise(axis=axis, curve=curve, model_error=float(np.sqrt(departure)), **coefficients)


CORRECT_UNIT = "Correct the unit in the map or the column's name."


def _unit_findings(record: Record, gyro: tuple[AxisNoise, ...]) -> Iterator[Finding]:
    """Yield a finding if time or gyroscope seem to be in another unit."""
    if record.sample_rate_hz < LEAST_HZ:
        sentence = f"Time is in milliseconds, not seconds: the file has {record.sample_rate_hz:.3g} samples a second."
        yield finding("noise.unit", "warn", sentence, CORRECT_UNIT)
    elif gyro and is_physical(record.gyro_unit):
        walk = float(np.median([axis.angle_random_walk.value for axis in gyro])) / RADIAN_PER_DEGREE
        if not USUAL_WALK[0] <= walk <= USUAL_WALK[1]:
            unit, other = ("deg/s", "rad/s") if walk > USUAL_WALK[1] else ("rad/s", "deg/s")
            sentence = f"Gyroscope is in {unit}, not {other}: the angle random walk is {walk:.2g} deg/s/sqrt(Hz) (usual: 0.002 "
            sentence += "to 0.05)."
            yield finding("noise.unit", "warn", sentence, CORRECT_UNIT)


def _findings(triad: str, axes: tuple[AxisNoise, ...], record: Record) -> Iterator[Finding]:
    """Yield findings about terms that are not observable, and about a curve that departs from the model."""
    for name, term in TERMS[triad].items():
        lost = tuple(axis.axis for axis in axes if getattr(axis, name).reason)
        if lost:
            no_axis = name == "bias_instability" and len(lost) == len(axes)
            level: Level = "warn" if name == "angle_random_walk" or no_axis else "info"
            wanted_h = int(np.ceil(LONGER * record.duration_s / 3600.0))
            axis_names, longest_s = f"{triad} {', '.join(lost)}", axes[0].curve.taus_s[-1]
            yield finding(
                "session.not_observable",
                level,
                f"{axis_names}: {term} is not observable in {record.duration_s:.0f} s (averaging times up to {longest_s:.4g} s).",
                f"Record {wanted_h} h or more at rest, at a steady temperature.",
            )
    worst = max((axis.model_error for axis in axes), default=0.0)
    if worst >= DEPARTURE:
        yield finding(
            "noise.model_error",
            "warn",
            f"The Allan curve of the {triad} departs from the model by {100.0 * worst:.0f} % of its variance.",
            "Record raw readings, without a filter, on a bench without vibration.",
            error_percent=100.0 * worst,
        )
