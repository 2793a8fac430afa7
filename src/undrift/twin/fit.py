"""Twin: the device model fitted to a real device from recordings with an optical reference.

Gyroscopes by rotation over windows (``calibration.reference``), accelerometers by specific force (``twin.accel``), noise and
bandwidth by the spectrum at rest, the ADC by its codes (``calibration.codes``). Every parameter comes with a standard error, or
with a finding that names why these recordings do not identify it.

White noise N through the device's own second-order Butterworth low-pass of bandwidth f_b leaves, at rest, the density::

    S(f) = 2 N^2 / (1 + (f / f_b)^4), and its images at multiples of the sample rate

Averaged periodograms scatter as chi-square, so the Whittle likelihood sum(log S + P / S) is maximised over f_b, N^2 in closed
form. Only the upper part of the band counts: people and floors move a device at low frequency. Where no bandwidth is better
than an infinite one by more than chi-square allows, the noise is flat and only a lower limit is stated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.calibrate import device_adc
from undrift.calibration.codes import AdcFinding, identify_adc
from undrift.calibration.reference import ReferenceFit, ReferenceSettings, fit_aligned
from undrift.errors import CalibrationError, InputError
from undrift.findings import Finding, finding
from undrift.frames import rotate
from undrift.model import AXES, G_NAMES, MATRIX_NAMES, AdcModel, TriadModel
from undrift.record import Record, Reference
from undrift.twin.accel import (
    CUTOFF_HZ,
    HIGHEST,
    AccelFit,
    Match,
    PreparedAccel,
    match,
    prepare_accel,
    smoothed,
    solve_accel,
    stretches,
)
from undrift.units import STANDARD_GRAVITY

# ---- parameters of a twin

SIGNIFICANT = 4.0  # standard errors from zero that set an effect apart from none: nine elements are tried at once
_PER_FORCE = "rad/s per m/s2"


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinParameter:
    """One parameter of the device model."""

    name: str
    value: float | str  # Best value; NaN where there is none
    standard_error: float  # Same unit; NaN where it has no meaning
    unit: str  # "1" for a ratio, "" for a word
    finding: Finding | None = None  # Why the recordings do not identify it; None where they do

    @property
    def identifiable(self) -> bool:
        """Whether the recordings identify it."""
        return self.finding is None

    @property
    def reason(self) -> str:
        """Why they do not, as text; "" where they do."""
        return "" if self.finding is None else self.finding.text


def known(name: str, value: float, error: float, unit: str) -> TwinParameter:
    """Return a parameter that the recordings identify."""
    return TwinParameter(name=name, value=float(value), standard_error=float(error), unit=unit)


def unknown(name: str, unit: str, why: Finding) -> TwinParameter:
    """Return a parameter that the recordings do not identify."""
    return TwinParameter(name=name, value=float("nan"), standard_error=float("nan"), unit=unit, finding=why)


def triad_parameters(prefix: str, model: TriadModel, covariance: FloatArray, unit: str) -> list[TwinParameter]:
    """Return rotation, matrix and offset of a fitted triad; covariance (12 or more, 12 or more).

    The rotation is that of the polar decomposition M = R S: the axes of the sensor against those of the optical body.
    """
    turn, jacobian = polar_rotation(model.matrix)
    error = np.sqrt(np.einsum("ip,pq,iq->i", jacobian, covariance[:9, :9], jacobian))
    sigma = np.sqrt(np.diag(covariance))
    found = [known(f"{prefix}_rotation_{a}", turn[i], error[i], "rad") for i, a in enumerate(AXES)]
    cells = model.matrix.ravel()
    found += [known(f"{prefix}_matrix_{n[-2:]}", cells[i], sigma[i], "1") for i, n in enumerate(MATRIX_NAMES)]
    found += [known(f"{prefix}_offset_{a}", model.offset[i], sigma[9 + i], unit) for i, a in enumerate(AXES)]
    return found


def polar_rotation(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rotation vector of the polar part of a matrix, (3,) rad, and its change with the matrix, (3, 9)."""
    from scipy.spatial.transform import Rotation

    def of(m: FloatArray) -> FloatArray:
        left, _, right = np.linalg.svd(m)
        return np.asarray(Rotation.from_matrix(left @ right).as_rotvec())

    step = 1e-6
    columns = [(of(matrix + d) - of(matrix - d)) / (2.0 * step) for d in step * np.eye(9).reshape(9, 3, 3)]
    return of(matrix), np.stack(columns, axis=1)


def g_sensitivity_parameters(values: FloatArray, errors: FloatArray) -> list[TwinParameter]:
    """Return the nine elements (9,) of the g-sensitivity; those that do not differ from zero are not identified."""
    zero = finding("twin.g_sensitivity_zero", "info", sigmas=SIGNIFICANT)
    found = zip((f"gyro_g_sensitivity_{name[-2:]}" for name in G_NAMES), values, errors, strict=True)
    every = [known(name, value, error, _PER_FORCE) for name, value, error in found]
    return [p if abs(float(p.value)) > SIGNIFICANT * p.standard_error else replace(p, finding=zero) for p in every]


def mean_with_error(values: Sequence[float] | FloatArray, errors: Sequence[float] | FloatArray) -> tuple[float, float]:
    """Return the mean of several estimates (R,) and its standard error, the larger of their own and their scatter's."""
    x, e = np.asarray(values, float), np.asarray(errors, float)
    claimed = float(np.sqrt((e**2).sum())) / len(x)
    scatter = float(x.std(ddof=1) / np.sqrt(len(x))) if len(x) > 1 else 0.0
    return float(x.mean()), max(claimed, scatter)


# ---- white noise and bandwidth at rest

BAND = (0.35, 0.95)  # of half the sample rate
_SEGMENT = 256  # samples
_IMAGES = 3  # of the spectrum on either side
_BETTER = 9.0  # chi-square, one degree of freedom, three standard deviations
_LIMIT = 4.0  # the same, two


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestNoise:
    """White noise of a triad, and its bandwidth where the spectrum shows one."""

    random_walk: FloatArray  # (3,), N, unit/sqrt(Hz)
    random_walk_error: FloatArray  # (3,), its standard error
    bandwidth_hz: float  # f_b; NaN where the noise is flat
    bandwidth_error_hz: float  # Standard error; NaN likewise
    bandwidth_above_hz: float  # Lower limit


def rest_noise(records: Sequence[Record], channel: str, *, step: float = 0.0) -> RestNoise | None:
    """Return white noise and bandwidth of a triad from recordings at rest; ``step`` is the code step, in its unit."""
    from scipy.signal import welch

    spectra, counts = [], []
    for record in records:
        values, rate = getattr(record, channel), records[0].sample_rate_hz
        if values is None or len(values) < 4 * _SEGMENT or not np.isfinite(values).all():
            continue
        if values.std(axis=0).all():  # readings that never change hold no noise
            counts.append(2 * (len(values) // _SEGMENT) - 1)
            used = values[: len(values) // _SEGMENT * _SEGMENT]
            window = np.hanning(_SEGMENT)
            f, power = welch(used, rate, window=window, noverlap=_SEGMENT // 2, axis=0)  # type: ignore[call-overload]
            spectra.append(power)
    if not spectra:
        return None
    chosen = (f >= BAND[0] * 0.5 * rate) & (f <= BAND[1] * 0.5 * rate)
    density = np.einsum("r,rfi->fi", np.array(counts, float) / sum(counts), np.array(spectra)[:, chosen])
    averaged = 0.8 * sum(counts)  # independent ones: Hann windows that half overlap
    return _likely(f[chosen], density, averaged, rate=rate, step=step)


def _likely(f: FloatArray, density: FloatArray, averaged: float, *, rate: float, step: float) -> RestNoise:
    trials = np.geomspace(0.1, 10.0, 400) * 0.5 * rate  # beyond 1 the noise folds back: no bandwidth, only a limit
    shapes = [_shape(f, bandwidth, rate) for bandwidth in trials]
    cost = np.array([_cost(density / shape[:, None], shape, averaged) for shape in shapes])
    flat = _cost(density, np.ones(len(f)), averaged)
    best = int(np.argmin(cost))
    bandwidth = error = float("nan")
    shape: FloatArray = np.ones(len(f))
    near = trials[cost <= cost[best] + 1.0]
    above = float(trials[cost <= min(flat, cost[best]) + _LIMIT].min())
    if flat - cost[best] > _BETTER and best > 0 and trials[best] < 0.45 * rate:
        bandwidth, error, shape = float(trials[best]), 0.5 * float(near[-1] - near[0]), shapes[best]
    square = 0.5 * (density / shape[:, None]).mean(axis=0) - step**2 / (12.0 * rate)  # less the codes' own noise
    level = np.sqrt(np.maximum(square, 0.0))
    independent = averaged * len(f) * 2.0 / 3.0  # neighbouring bins of a Hann window share
    return RestNoise(
        random_walk=level,
        random_walk_error=level * 0.5 / np.sqrt(independent),
        bandwidth_hz=bandwidth,
        bandwidth_error_hz=error,
        bandwidth_above_hz=min(above, 0.5 * rate),
    )


def _shape(f: FloatArray, bandwidth: float, rate: float) -> FloatArray:
    # What lies above half the sample rate folds back into the band.
    images = np.abs(f[:, None] + rate * np.arange(-_IMAGES, _IMAGES + 1))
    return np.asarray((1.0 / (1.0 + (images / bandwidth) ** 4)).sum(axis=1))


def _cost(whitened: FloatArray, shape: FloatArray, averaged: float) -> float:
    # -2 log likelihood with the level at its best: P / S averages 1.
    n = len(shape) * 2.0 / 3.0
    return float(2.0 * averaged * n * (np.log(whitened.mean(axis=0)) + np.log(shape).mean()).sum())


# ---- fit


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinSettings:
    """Settings of the fit of a twin."""

    gravity_m_s2: float = STANDARD_GRAVITY  # Local gravity: the accelerometer's scale is in proportion to it
    gyro_cutoff_hz: float = 20.0  # Low-pass at which gyroscope residuals are stated, Hz
    accel_cutoff_hz: float = CUTOFF_HZ  # Low-pass of the accelerometer fit, Hz


TWIN_SETTINGS = TwinSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """Recordings of one device made ready once, for fits to all or to some of them."""

    records: tuple[Record, ...]  # As given
    references: tuple[Reference, ...]  # As given
    matches: tuple[Match, ...]  # One for each
    adc: AdcModel | None  # Rounding of the gyroscope codes
    accel_codes: AdcFinding | None  # ADC of the accelerometer, by its codes
    accel: PreparedAccel | None  # Equations of the accelerometer
    accel_refused: str  # Why there are none


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Twin:
    """A device model fitted to a real device.

    Parameters
    ----------
    gyro : ReferenceFit
        Matrix, offsets, lags.
    accel : AccelFit or None
        Matrix, offset, lever arm, delay.
    adc : AdcModel or None
        Rounding of the gyroscope codes.
    gyro_noise, accel_noise : RestNoise or None
        At rest.
    parameters : tuple of TwinParameter
        All, with standard errors, or why they are not identified.
    gyro_residual_rms : array, shape (R,)
        Corrected readings less the poses' rate, per axis, rad/s, after a low-pass; one for each recording.
    gyro_signal_rms : array, shape (R,)
        Of the body rate, likewise.
    settings : TwinSettings
        Gravity and cut-offs of the fit.
    """

    gyro: ReferenceFit
    accel: AccelFit | None
    adc: AdcModel | None
    gyro_noise: RestNoise | None
    accel_noise: RestNoise | None
    parameters: tuple[TwinParameter, ...]
    gyro_residual_rms: FloatArray
    gyro_signal_rms: FloatArray
    settings: TwinSettings

    @property
    def delay(self) -> float:
        """Mean delay of the gyroscopes, s."""
        return float(self.gyro.lags_s.mean())


def prepare_twin(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    settings: TwinSettings = TWIN_SETTINGS,
    names: Sequence[str] = (),
) -> Prepared:
    """Bring recordings of one device and their references together."""
    if not records or len(records) != len(references):
        raise InputError(
            f"twin: wanted one reference for each record, got {len(records)} records and {len(references)} references"
        )
    adc, called = device_adc(records), list(names) or [""] * len(records)
    settings = _as_slow(settings, records)
    records = [record.in_si() for record in records]
    matches = tuple(match(r, p, adc=adc, name=n) for r, p, n in zip(records, references, called, strict=True))
    accel, refused, codes = None, "", records[0].accel
    try:
        accel = prepare_accel(matches, gravity_m_s2=settings.gravity_m_s2, cutoff_hz=settings.accel_cutoff_hz)
    except (InputError, CalibrationError) as error:
        refused = str(error)
    return Prepared(
        records=tuple(records),
        references=tuple(references),
        matches=matches,
        adc=adc,
        accel_codes=None if codes is None else identify_adc(codes),
        accel=accel,
        accel_refused=refused,
    )


def _as_slow(settings: TwinSettings, records: Sequence[Record]) -> TwinSettings:
    """Return settings whose cut-offs the slowest recording can have."""
    highest = HIGHEST * min(record.sample_rate_hz for record in records)
    gyro, accel = (min(each, highest) for each in (settings.gyro_cutoff_hz, settings.accel_cutoff_hz))
    return replace(settings, gyro_cutoff_hz=gyro, accel_cutoff_hz=accel)


def fit_twin(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    settings: TwinSettings = TWIN_SETTINGS,
    names: Sequence[str] = (),
) -> Twin:
    """Fit the device model to a real device.

    Parameters
    ----------
    records : sequence of Record
        Raw recordings of one device in one mounting. Without a rest, one has the device's offset in motion.
    references : sequence of Reference
        One for each record.
    settings : TwinSettings
        Gravity and cut-offs.
    names : sequence of str
        What to call the recordings.

    Returns
    -------
    Twin
        Parameters with standard errors.

    Raises
    ------
    InputError
        Sequences that do not match, no gyroscope, or counts.
    AlignmentError
        A record and its reference share no motion.
    NotObservable
        The motion leaves the gyroscope matrix undetermined.
    """
    return fit_prepared(prepare_twin(records, references, settings=settings, names=names), settings=settings)


def fit_prepared(
    prepared: Prepared,
    *,
    settings: TwinSettings = TWIN_SETTINGS,
    chosen: Sequence[int] | None = None,
    brief: bool = False,
) -> Twin:
    """Fit the device model to chosen recordings."""
    number = list(range(len(prepared.records)) if chosen is None else chosen)
    settings = _as_slow(settings, prepared.records)
    matches = [prepared.matches[k] for k in number]
    gyro = fit_aligned(matches, ReferenceSettings(mounting="one", turning=False))
    rests, codes = [m.rest for m in matches if m.span.rested], prepared.accel_codes
    twin = Twin(
        gyro=gyro,
        accel=None if prepared.accel is None else solve_accel(prepared.accel, chosen=number),
        adc=prepared.adc,
        gyro_noise=rest_noise(rests, "gyro", step=_step(None if prepared.adc is None else prepared.adc.gyro_lsb)),
        accel_noise=rest_noise(rests, "accel", step=_step(None if codes is None else codes.lsb)),
        parameters=(),
        gyro_residual_rms=np.empty(0),
        gyro_signal_rms=np.empty(0),
        settings=settings,
    )
    if brief:
        return twin
    left, signal = np.array([gyro_residual(m, gyro, settings) for m in matches]).T
    parameters = _parameters(twin, prepared, matches)
    return replace(twin, parameters=parameters, gyro_residual_rms=left, gyro_signal_rms=signal)


def gyro_residual(match: Match, fit: ReferenceFit, settings: TwinSettings) -> tuple[float, float]:
    """Return rms of corrected readings less the rate of the poses, and of that rate, after a low-pass, rad/s."""
    motion = match.at(match.lag.seconds, settings.gravity_m_s2)
    model = fit.model_at_rest_offset(match.rest_offset)
    done = (match.gyro - model.offset) @ model.matrix.T
    low: list[FloatArray] = [np.empty((0, 6))]
    for rows in stretches(match, motion, match.gyro):
        both = [rotate(motion.q_nb[rows], rate[rows]) for rate in (done, motion.rate_b)]
        low.append(smoothed(np.hstack(both), settings.gyro_cutoff_hz, match.record.sample_rate_hz)[0])
    found = np.concatenate(low)
    if not len(found):
        return float("nan"), float("nan")
    left, seen = ((x**2).mean() for x in (found[:, :3] - found[:, 3:], found[:, 3:]))
    return float(np.sqrt(left)), float(np.sqrt(seen))


def _parameters(twin: Twin, prepared: Prepared, matches: Sequence[Match]) -> tuple[TwinParameter, ...]:
    gyro, model, first = twin.gyro, twin.gyro.triad.model, matches[0].record
    found = [known("gyro_delay", *mean_with_error(gyro.lags_s, gyro.lag_uncertainties_s), "s")]
    found += triad_parameters("gyro", model, model.covariance, "rad/s")
    errors = np.sqrt(np.maximum(np.diag(model.covariance)[9:12], 0.0))
    if np.isfinite(gyro.rest_offsets).all(axis=1).any():
        moved = zip(AXES, gyro.motion_offset, errors, strict=True)
        found += [known(f"gyro_motion_offset_{a}", value, error, "rad/s") for a, value, error in moved]
    else:
        found += [unknown("gyro_motion_offset", "rad/s", finding("twin.never_rests", "info"))]
    found += _g_sensitivity(matches)
    found += _accel_parameters(twin, prepared.accel_refused)
    found += _noise_parameters("gyro", twin.gyro_noise, "rad/s/sqrt(Hz)", first.sample_rate_hz)
    found += _noise_parameters("accel", twin.accel_noise, "m/s2/sqrt(Hz)", first.sample_rate_hz)
    codes = None if first.gyro is None else identify_adc(first.gyro)
    rounding = None if twin.adc is None or twin.adc.gyro_lsb is None else twin.adc.gyro_rounding
    return tuple(found + _adc("gyro", codes, rounding, "rad/s") + _adc("accel", prepared.accel_codes, None, "m/s2"))


def _step(lsb: FloatArray | None) -> float:
    return 0.0 if lsb is None else float(np.mean(lsb))


def _g_sensitivity(matches: Sequence[Match]) -> list[TwinParameter]:
    if any(match.record.accel is None for match in matches):
        return [unknown("gyro_g_sensitivity", _PER_FORCE, finding("twin.no_accelerometer", "info"))]
    try:
        model = fit_aligned(matches, ReferenceSettings(g_sensitivity=True, mounting="one", turning=False)).triad.model
    except CalibrationError as error:
        return [unknown("gyro_g_sensitivity", _PER_FORCE, finding("twin.not_fitted", "warn", error=str(error)))]
    values = np.zeros(9) if model.g_sensitivity is None else model.g_sensitivity.ravel()
    return g_sensitivity_parameters(values, model.standard_uncertainty[12:])


def _accel_parameters(twin: Twin, refused: str) -> list[TwinParameter]:
    fit = twin.accel
    if fit is None:
        why = finding("twin.not_fitted", "warn", error=refused)
        return [unknown("accel_matrix", "1", why), unknown("lever_arm", "m", why)]
    sigma = np.sqrt(np.diag(fit.covariance))
    gyro_error = mean_with_error(twin.gyro.lags_s, twin.gyro.lag_uncertainties_s)[1]
    found = [known("accel_delay", twin.delay + fit.delay, float(np.hypot(sigma[15], gyro_error)), "s")]
    found += triad_parameters("accel", fit.model, fit.covariance, "m/s2")
    return found + [known(f"lever_arm_{a}", fit.lever_arm[i], sigma[12 + i], "m") for i, a in enumerate(AXES)]


def _noise_parameters(prefix: str, noise: RestNoise | None, unit: str, rate: float) -> list[TwinParameter]:
    name = "angle_random_walk" if prefix == "gyro" else "velocity_random_walk"
    if noise is None:
        why = finding("twin.no_rest", "info", samples=4 * _SEGMENT)
        return [unknown(f"{prefix}_{name}", unit, why), unknown(f"{prefix}_bandwidth", "Hz", why)]
    found = [
        known(f"{prefix}_{name}_{a}", noise.random_walk[i], noise.random_walk_error[i], unit)
        for i, a in enumerate(AXES)
    ]
    if np.isfinite(noise.bandwidth_hz):
        return [*found, known(f"{prefix}_bandwidth", noise.bandwidth_hz, noise.bandwidth_error_hz, "Hz")]
    limits = finding("twin.bandwidth_above", "info", above_hz=noise.bandwidth_above_hz, nyquist_hz=0.5 * rate)
    return [*found, unknown(f"{prefix}_bandwidth", "Hz", limits)]


def _adc(prefix: str, codes: AdcFinding | None, rounding: str | None, unit: str) -> list[TwinParameter]:
    if codes is None:
        return []
    if codes.lsb is None:
        return [unknown(f"{prefix}_lsb", unit, codes.finding)]
    rounding, word = rounding or codes.rounding, unknown(f"{prefix}_rounding", "", codes.finding)
    step = known(f"{prefix}_lsb", float(codes.lsb.mean()), float(codes.lsb.std()), unit)
    return [step, replace(word, value=rounding, finding=None) if rounding else word]
