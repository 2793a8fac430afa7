"""Twin: the device model fitted to a real device from recordings with an optical reference.

    gyroscopes        rotation over windows (``calibration.reference``)
    accelerometers    specific force from the poses (``twin.accel``)
    codes             step and rounding (``calibration.codes``)
    white noise       N = s / sqrt(sample rate), with s^2 the median variance within quarter seconds of rest, minus step^2 / 12

Every parameter has a standard error, or a reason why these recordings do not identify it.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.codes import device_adc, identify_adc
from undrift.calibration.reference import ReferenceFit, fit_aligned
from undrift.errors import CalibrationError, InputError
from undrift.model import AXES, MATRIX_NAMES, AdcModel, TriadModel
from undrift.record import Record, Reference
from undrift.twin.accel import AccelFit, AccelRows, Match, match, prepare_accel, solve_accel
from undrift.units import STANDARD_GRAVITY

BLOCK_S = 0.25  # length of a block at rest, s: motion of people and floors is slower
MIN_REST_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinParameter:
    """One parameter of the device model."""

    name: str
    unit: str  # "1" for a ratio
    value: float = math.nan  # NaN if it is not identified
    standard_error: float = math.nan  # standard error, same unit
    reason: str = ""  # reason if the recordings do not identify it (otherwise empty)

    @property
    def identifiable(self) -> bool:
        """True if the recordings identify it."""
        return not math.isnan(self.value)


class RestNoise(NamedTuple):
    """White noise of a triad that explains the scatter at rest at the sample rate of the recordings."""

    random_walk: FloatArray  # (3,), N, unit/sqrt(Hz)
    random_walk_error: FloatArray  # (3,), standard error


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """Recordings of a device, aligned once for fits to all or to some of them."""

    matches: tuple[Match, ...]
    adc: AdcModel | None  # rounding of the gyroscope codes
    accel: tuple[AccelRows, ...]  # equations of the accelerometer, one per recording (empty: not usable)
    accel_refused: str  # reason why no accelerometers were fitted, or ""
    gravity_m_s2: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Twin:
    """A device model fitted to R recordings of a real device."""

    gyro: ReferenceFit  # matrix, offsets, lags
    accel: AccelFit | None  # matrix, offset, lever arm, delay
    adc: AdcModel | None  # rounding of the gyroscope codes
    gyro_noise: RestNoise | None  # white noise at rest
    accel_noise: RestNoise | None
    parameters: tuple[TwinParameter, ...]  # with standard errors, or with the reason why they are not identified
    prepared: Prepared

    @property
    def delay(self) -> float:
        """Mean delay of the gyroscopes, s."""
        return float(self.gyro.lags_s.mean())


def fit_twin(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    gravity_m_s2: float = STANDARD_GRAVITY,
    names: Sequence[str] = (),
) -> Twin:
    """Fit the device model to a real device.

    Parameters
    ----------
    records : sequence of Record
        Raw recordings of one device in one mounting. The offset of a recording without a rest is the offset of the device in
        motion.
    references : sequence of Reference
        One for each record.
    gravity_m_s2 : float
        Local gravity: the accelerometer's scale is proportional to it.
    names : sequence of str
        Names of the recordings.

    Returns
    -------
    Twin
        Parameters with standard errors.

    Raises
    ------
    InputError
        If the sequences do not match, a record has no gyroscope, or its readings are counts.
    AlignmentError
        If a record and its reference share no motion.
    NotObservable
        If the motion leaves the gyroscope matrix undetermined.
    """
    if not records or len(records) != len(references):
        raise InputError(
            f"twin: each record needs one reference, got {len(records)} records and {len(references)} references."
        )
    adc = device_adc(records)
    labels = list(names) or [""] * len(records)
    matches = tuple(match(*item, adc=adc) for item in zip(records, references, labels, strict=True))
    accel: tuple[AccelRows, ...] = ()
    refused = ""
    try:
        accel = prepare_accel(matches, gravity_m_s2=gravity_m_s2)
    except (InputError, CalibrationError) as error:
        refused = str(error)
    return fit_prepared(
        Prepared(matches=matches, adc=adc, accel=accel, accel_refused=refused, gravity_m_s2=gravity_m_s2)
    )


def fit_prepared(prepared: Prepared, *, chosen: Sequence[int] | None = None) -> Twin:
    """Fit the device model to all recordings, or to a subset."""
    numbers = range(len(prepared.matches)) if chosen is None else chosen
    matches = [prepared.matches[k] for k in numbers]
    gyro = fit_aligned(matches, "one", turning=False)
    accel = solve_accel([prepared.accel[k] for k in numbers]) if prepared.accel else None
    rests = [item.rest for item in matches if item.span.rested]
    noise = {name: rest_noise(rests, name, step=_code_step(matches[0].record, name)) for name in ("gyro", "accel")}
    return Twin(
        gyro=gyro,
        accel=accel,
        adc=prepared.adc,
        gyro_noise=noise["gyro"],
        accel_noise=noise["accel"],
        parameters=tuple(_parameters(gyro, accel, noise, prepared.accel_refused)),
        prepared=prepared,
    )


def _code_step(record: Record, channel: str) -> float:
    """Return the mean step of a triad's codes, or 0 without a grid of codes."""
    values = getattr(record, channel)
    lsb = None if values is None else identify_adc(values).lsb
    return 0.0 if lsb is None else float(lsb.mean())


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
    return RestNoise(walk, 1.25 * walk / np.sqrt(2.0 * freedom * len(table)))


# ---- the table of parameters


def mean_with_error(values: FloatArray, errors: FloatArray) -> tuple[float, float]:
    """Return the mean of several estimates (R,) and its standard error, the larger one from their errors and their scatter."""
    claimed = float(np.sqrt((errors**2).sum())) / len(values)
    scatter = float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
    return float(values.mean()), max(claimed, scatter)


def _parameters(
    gyro: ReferenceFit, accel: AccelFit | None, noise: Mapping[str, RestNoise | None], accel_refused: str
) -> Iterator[TwinParameter]:
    """Yield the table of parameters."""
    delay, delay_error = mean_with_error(gyro.lags_s, gyro.lag_uncertainties_s)
    errors = np.sqrt(np.maximum(np.diag(gyro.triad.model.covariance), 0.0))
    yield TwinParameter(name="gyro_delay", unit="s", value=delay, standard_error=delay_error)
    yield from _triad("gyro", "rad/s", gyro.triad.model, errors)
    if np.isfinite(gyro.rest_offsets).all(axis=1).any():
        yield from _axes("gyro_motion_offset", "rad/s", gyro.motion_offset, errors[9:12])
    else:
        reason = "No recording contains a rest, so the offset applies in motion"
        yield TwinParameter(name="gyro_motion_offset", unit="rad/s", reason=reason)
    if accel is None:
        yield TwinParameter(name="accel_matrix", unit="1", reason=accel_refused)
        yield TwinParameter(name="lever_arm", unit="m", reason=accel_refused)
    else:
        errors = np.sqrt(np.diag(accel.covariance))
        error = math.hypot(errors[15], delay_error)
        yield TwinParameter(name="accel_delay", unit="s", value=delay + accel.delay, standard_error=error)
        yield from _triad("accel", "m/s2", accel.model, errors)
        yield from _axes("lever_arm", "m", accel.lever_arm, errors[12:15])
    for triad, name, unit in (
        ("gyro", "gyro_angle_random_walk", "rad/s/sqrt(Hz)"),
        ("accel", "accel_velocity_random_walk", "m/s2/sqrt(Hz)"),
    ):
        scatter = noise[triad]
        if scatter is None:
            reason = f"no {MIN_REST_S:g} s of rest without gaps in which every reading changes"
            yield TwinParameter(name=name, unit=unit, reason=reason)
        else:
            yield from _axes(name, unit, scatter.random_walk, scatter.random_walk_error)


def _triad(name: str, unit: str, model: TriadModel, errors: FloatArray) -> Iterator[TwinParameter]:
    yield from _axes(f"{name}_matrix", "1", model.matrix.ravel(), errors[:9])
    yield from _axes(f"{name}_offset", unit, model.offset, errors[9:12])


def _axes(name: str, unit: str, values: FloatArray, errors: FloatArray) -> Iterator[TwinParameter]:
    """Yield the parameters of three axes, or of a matrix row by row."""
    labels = AXES if len(values) == 3 else [entry[-2:] for entry in MATRIX_NAMES]
    for label, value, error in zip(labels, values.tolist(), errors.tolist(), strict=True):
        yield TwinParameter(name=f"{name}_{label}", unit=unit, value=value, standard_error=error)
