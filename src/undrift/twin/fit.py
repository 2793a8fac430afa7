"""Twin: the device model fitted to a real device from recordings with an optical reference.

    gyroscopes        rotation over windows (``calibration.reference``)
    accelerometers    specific force from the poses (``twin.accel``)
    codes             step and rounding (``calibration.codes``)
    white noise       N = s / sqrt(sample rate), with s^2 the median variance within quarter seconds of rest, minus step^2 / 12

Every parameter has a standard error, or a reason why these recordings do not identify it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import device_adc, identify_adc
from undrift.calibration.reference import ReferenceFit, ReferenceSettings, fit_aligned
from undrift.errors import CalibrationError, InputError
from undrift.frames import rotate
from undrift.model import AXES, MATRIX_NAMES, AdcModel, TriadModel
from undrift.record import Record, Reference
from undrift.twin.accel import (
    CUTOFF_HZ,
    MAX_CUTOFF_SHARE,
    AccelFit,
    Match,
    PreparedAccel,
    low_passed,
    match,
    prepare_accel,
    solve_accel,
    stretches,
)
from undrift.units import STANDARD_GRAVITY

# ---- parameters of a twin


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinParameter:
    """One parameter of the device model."""

    name: str
    value: float | str  # NaN if it is not identified
    standard_error: float  # same unit
    unit: str  # "1" for a ratio, "" for a word
    reason: str = ""  # reason if the recordings do not identify it (otherwise empty)

    @property
    def identifiable(self) -> bool:
        """True if the recordings identify it."""
        return isinstance(self.value, str) or not math.isnan(self.value)


def known(name: str, value: float | str, error: float, unit: str) -> TwinParameter:
    """Return a parameter that the recordings identify."""
    return TwinParameter(name=name, value=value, standard_error=float(error), unit=unit)


def unknown(name: str, unit: str, reason: str) -> TwinParameter:
    """Return a parameter that the recordings do not identify."""
    return TwinParameter(name=name, value=float("nan"), standard_error=float("nan"), unit=unit, reason=reason)


def triad_parameters(prefix: str, model: TriadModel, covariance: FloatArray, unit: str) -> list[TwinParameter]:
    """Return matrix and offset of a fitted triad, with the covariance of at least 12 parameters."""
    sigma = np.sqrt(np.maximum(np.diag(covariance)[:12], 0.0))
    names = [*(f"{prefix}_matrix_{name[-2:]}" for name in MATRIX_NAMES), *(f"{prefix}_offset_{axis}" for axis in AXES)]
    values = np.concatenate((model.matrix.ravel(), model.offset))
    units = ("1",) * 9 + (unit,) * 3
    return [known(*row) for row in zip(names, values.tolist(), sigma.tolist(), units, strict=True)]


def mean_with_error(values: FloatArray, errors: FloatArray) -> tuple[float, float]:
    """Return the mean of several estimates (R,) and its standard error, the larger of their errors' and their scatter's."""
    claimed = float(np.sqrt((errors**2).sum())) / len(values)
    scatter = float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
    return float(values.mean()), max(claimed, scatter)


# ---- white noise at rest

BLOCK_S = 0.25  # people and floors move a device more slowly
MIN_REST_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestNoise:
    """White noise of a triad that gives the scatter at rest at the sample rate of the recordings."""

    random_walk: FloatArray  # (3,), N, unit/sqrt(Hz)
    random_walk_error: FloatArray  # (3,), standard error


def rest_noise(records: Sequence[Record], channel: str, *, step: float = 0.0) -> RestNoise | None:
    """Return the white noise of a triad at rest, or None without 2 s of changing readings. ``step`` is its code step."""
    variances: list[FloatArray] = []
    freedom = 1
    for record in records:
        values, width = getattr(record, channel), max(round(BLOCK_S * record.sample_rate_hz), 2)
        count = 0 if values is None else len(values) // width
        if count < MIN_REST_S / BLOCK_S or not np.isfinite(values).all():
            continue
        blocks = values[: count * width].reshape(count, width, 3)
        if blocks.std(axis=(0, 1)).all():
            variances.append(blocks.var(axis=1, ddof=1) / record.sample_rate_hz)
            freedom = width - 1
    if not variances:
        return None
    table = np.concatenate(variances)
    median = np.median(table, axis=0) / (1.0 - 2.0 / (9.0 * freedom)) ** 3  # Wilson and Hilferty: median of chi-square
    walk = np.sqrt(np.maximum(median - step**2 / (12.0 * records[0].sample_rate_hz), 0.0))
    return RestNoise(random_walk=walk, random_walk_error=1.25 * walk / np.sqrt(2.0 * freedom * len(table)))


# ---- fit


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinSettings:
    """Settings of the fit of a twin."""

    gravity_m_s2: float = STANDARD_GRAVITY  # local gravity: the accelerometer's scale is proportional to it
    gyro_cutoff_hz: float = 20.0  # low-pass for the gyroscope residuals, Hz
    accel_cutoff_hz: float = CUTOFF_HZ  # low-pass of the accelerometer fit, Hz


TWIN_SETTINGS = TwinSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """Recordings of a device, aligned once for fits to all or to some of them."""

    matches: tuple[Match, ...]
    adc: AdcModel | None  # rounding of the gyroscope codes
    accel: PreparedAccel | None  # equations of the accelerometer
    accel_refused: str  # reason if no accelerometers were fitted
    settings: TwinSettings  # cut-offs that the slowest recording allows


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
        White noise at rest.
    parameters : tuple of TwinParameter
        All parameters with standard errors, or with the reason why they are not identified.
    gyro_residual_rms : array, shape (R,)
        Corrected readings minus the rate of the poses, per axis, rad/s, after a low-pass; one for each recording.
    gyro_signal_rms : array, shape (R,)
        The rate of the poses after the same low-pass, per axis, rad/s.
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
        Names of the recordings.

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
    return fit_prepared(prepare_twin(records, references, settings=settings, names=names))


def prepare_twin(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    settings: TwinSettings = TWIN_SETTINGS,
    names: Sequence[str] = (),
) -> Prepared:
    """Align recordings of a device with their references."""
    if not records or len(records) != len(references):
        raise InputError(
            f"twin: each record needs one reference, got {len(records)} records and {len(references)} references."
        )
    adc = device_adc(records)
    labels = list(names) or [""] * len(records)
    matches = tuple(match(*item, adc=adc) for item in zip(records, references, labels, strict=True))
    highest_hz = MAX_CUTOFF_SHARE * min(record.sample_rate_hz for record in records)
    settings = TwinSettings(
        gravity_m_s2=settings.gravity_m_s2,
        gyro_cutoff_hz=min(settings.gyro_cutoff_hz, highest_hz),
        accel_cutoff_hz=min(settings.accel_cutoff_hz, highest_hz),
    )
    accel, refused = None, ""
    try:
        accel = prepare_accel(matches, gravity_m_s2=settings.gravity_m_s2, cutoff_hz=settings.accel_cutoff_hz)
    except (InputError, CalibrationError) as error:
        refused = str(error)
    return Prepared(matches=matches, adc=adc, accel=accel, accel_refused=refused, settings=settings)


def fit_prepared(prepared: Prepared, *, chosen: Sequence[int] | None = None) -> Twin:
    """Fit the device model to all recordings, or to a subset."""
    numbers = list(range(len(prepared.matches)) if chosen is None else chosen)
    matches = [prepared.matches[k] for k in numbers]
    gyro = fit_aligned(matches, ReferenceSettings(mounting="one", turning=False))
    accel = None if prepared.accel is None else solve_accel(prepared.accel, chosen=numbers)
    rests = [item.rest for item in matches if item.span.rested]
    codes, parameters = _adc_parameters(matches[0].record, prepared.adc)
    noise = {name: rest_noise(rests, name, step=codes[name]) for name in ("gyro", "accel")}
    fitted = _gyro_parameters(gyro) + _accel_parameters(gyro, accel, prepared.accel_refused)
    scatter = _noise_parameters("gyro_angle", "rad/s", noise["gyro"])
    scatter += _noise_parameters("accel_velocity", "m/s2", noise["accel"])
    residual, signal = np.array([gyro_residual(item, gyro, prepared.settings) for item in matches]).T
    return Twin(
        gyro=gyro,
        accel=accel,
        adc=prepared.adc,
        gyro_noise=noise["gyro"],
        accel_noise=noise["accel"],
        parameters=(*fitted, *scatter, *parameters),
        gyro_residual_rms=residual,
        gyro_signal_rms=signal,
        settings=prepared.settings,
    )


def gyro_residual(match: Match, fit: ReferenceFit, settings: TwinSettings) -> tuple[float, float]:
    """Return rms of corrected readings minus the rate of the poses, and of that rate, after a low-pass, rad/s."""
    motion = match.at(match.lag.seconds, settings.gravity_m_s2)
    model = fit.model_at_rest_offset(match.rest_offset)
    corrected = (match.gyro - model.offset) @ model.matrix.T
    columns: list[FloatArray] = [np.empty((0, 6))]
    for rows in stretches(match, motion, match.gyro):
        both = np.hstack([rotate(motion.q_nb[rows], rate[rows]) for rate in (corrected, motion.rate_b)])
        columns.append(low_passed(both, settings.gyro_cutoff_hz, match.record.sample_rate_hz)[0])
    readings, poses = np.hsplit(np.concatenate(columns), 2)
    if not len(poses):
        return float("nan"), float("nan")
    return float(np.sqrt(((readings - poses) ** 2).mean())), float(np.sqrt((poses**2).mean()))


# ---- the table of parameters


def _gyro_parameters(fit: ReferenceFit) -> list[TwinParameter]:
    model = fit.triad.model
    rows = [known("gyro_delay", *mean_with_error(fit.lags_s, fit.lag_uncertainties_s), "s")]
    rows += triad_parameters("gyro", model, model.covariance, "rad/s")
    if not np.isfinite(fit.rest_offsets).all(axis=1).any():
        return [
            *rows,
            unknown("gyro_motion_offset", "rad/s", "the recordings have no rest: the offset is that in motion"),
        ]
    errors = np.sqrt(np.maximum(np.diag(model.covariance)[9:12], 0.0))
    moved = zip(AXES, fit.motion_offset.tolist(), errors.tolist(), strict=True)
    return rows + [known(f"gyro_motion_offset_{axis}", value, error, "rad/s") for axis, value, error in moved]


def _accel_parameters(gyro: ReferenceFit, fit: AccelFit | None, refused: str) -> list[TwinParameter]:
    if fit is None:
        return [unknown("accel_matrix", "1", refused), unknown("lever_arm", "m", refused)]
    sigma = np.sqrt(np.diag(fit.covariance))
    delay, error = mean_with_error(gyro.lags_s, gyro.lag_uncertainties_s)
    rows = [known("accel_delay", delay + fit.delay, float(np.hypot(sigma[15], error)), "s")]
    rows += triad_parameters("accel", fit.model, fit.covariance, "m/s2")
    return rows + [
        known(f"lever_arm_{axis}", float(fit.lever_arm[i]), sigma[12 + i], "m") for i, axis in enumerate(AXES)
    ]


def _noise_parameters(prefix: str, unit: str, noise: RestNoise | None) -> list[TwinParameter]:
    name, unit = f"{prefix}_random_walk", f"{unit}/sqrt(Hz)"
    if noise is None:
        return [unknown(name, unit, f"no {MIN_REST_S:g} s of rest without gaps in which every reading changes")]
    rows = zip(AXES, noise.random_walk.tolist(), noise.random_walk_error.tolist(), strict=True)
    return [known(f"{name}_{axis}", value, error, unit) for axis, value, error in rows]


def _adc_parameters(record: Record, adc: AdcModel | None) -> tuple[dict[str, float], list[TwinParameter]]:
    """Return the step of each triad's codes, 0 if there is none, and the parameters of the codes."""
    steps, rows = {"gyro": 0.0, "accel": 0.0}, list[TwinParameter]()
    for name, unit in (("gyro", "rad/s"), ("accel", "m/s2")):
        readings = getattr(record, name)
        if readings is None:
            continue
        codes = identify_adc(readings)
        if codes.lsb is None:
            rows.append(unknown(f"{name}_lsb", unit, codes.reason))
            continue
        steps[name] = float(codes.lsb.mean())
        rows.append(known(f"{name}_lsb", steps[name], float(codes.lsb.std()), unit))
        adc_rounding = adc.gyro_rounding if name == "gyro" and adc is not None and adc.gyro_lsb is not None else None
        rounding = adc_rounding or codes.rounding
        word = f"{name}_rounding"
        rows.append(known(word, rounding, float("nan"), "") if rounding else unknown(word, "", codes.reason))
    return steps, rows
