"""Twin: the device model fitted to a real device from recordings with an optical reference.

Gyroscopes by rotation over windows (``calibration.fit.reference``), accelerometers by specific force (``accel``), noise and
bandwidth by the spectrum at rest (``rest``), the ADC by its codes (``calibration.adc``). Every parameter comes with a standard
error, or with the reason why these recordings do not tell it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.adc import AdcFinding, identify_adc
from undrift.calibration.fit.reference import ReferenceFit, ReferenceSettings, fit_reference
from undrift.calibration.model import AXES, AdcModel
from undrift.calibration.procedure_reference import device_adc
from undrift.errors import CalibrationError, InputError
from undrift.frames import rotate
from undrift.record import Record, Reference
from undrift.twin.accel import CUTOFF_HZ, AccelFit, PreparedAccel, prepare_accel, solve_accel
from undrift.twin.match import Match, match, smoothed, stretches
from undrift.twin.parameters import (
    TwinParameter,
    g_sensitivity_parameters,
    known,
    mean_with_error,
    triad_parameters,
    unknown,
)
from undrift.twin.rest import RestNoise, rest_noise
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

REFERENCE_SETTINGS = ReferenceSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinSettings:
    """How a device is twinned.

    Parameters
    ----------
    gravity_m_s2 : float
        Local gravity: the accelerometer's scale stands and falls with it.
    gyro_cutoff_hz : float
        Low-pass at which gyroscope residuals are stated, Hz.
    accel_cutoff_hz : float
        Low-pass of the accelerometer fit, Hz.
    offset_spread : float
        Offset at rest between recordings of a device, standard deviation where one recording alone cannot tell, rad/s.
    motion_offset_spread : float
        The same of the change from rest to motion, rad/s.
    """

    gravity_m_s2: float = STANDARD_GRAVITY
    gyro_cutoff_hz: float = 20.0
    accel_cutoff_hz: float = CUTOFF_HZ
    offset_spread: float = 0.01 * RADIAN_PER_DEGREE
    motion_offset_spread: float = 0.01 * RADIAN_PER_DEGREE


TWIN_SETTINGS = TwinSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """Recordings of one device made ready once, for fits to all or to some of them.

    Parameters
    ----------
    records, references : tuple
        As given.
    matches : tuple of Match
        One for each.
    adc : AdcModel or None
        Rounding of the gyroscope codes.
    accel_codes : AdcFinding or None
        What the accelerometer codes say.
    accel : PreparedAccel or None
        Equations of the accelerometer.
    accel_reason : str
        Why there are none.
    """

    records: tuple[Record, ...]
    references: tuple[Reference, ...]
    matches: tuple[Match, ...]
    adc: AdcModel | None
    accel_codes: AdcFinding | None
    accel: PreparedAccel | None
    accel_reason: str


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
        All, with standard errors or reasons.
    gyro_residual_rms : array, shape (R,)
        Per axis, rad/s, after a low-pass; one for each recording.
    gyro_signal_rms : array, shape (R,)
        Of the body rate, likewise.
    settings : TwinSettings
        As asked.
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
    """Bring recordings of one device and their references together.

    Parameters
    ----------
    records : sequence of Record
        Raw recordings of one device in one mounting.
    references : sequence of Reference
        One for each record.
    settings : TwinSettings
        Gravity and cut-offs.
    names : sequence of str
        What to call the recordings.

    Returns
    -------
    Prepared
        For ``fit_prepared``.

    Raises
    ------
    InputError
        Sequences that do not match.
    AlignmentError
        A record and its reference share no motion.
    """
    if not records or len(records) != len(references):
        raise InputError(
            f"twin: wanted one reference for each record, got {len(records)} records and {len(references)} references"
        )
    adc = device_adc(records)
    called = list(names) or [""] * len(records)
    records = [record.in_si() for record in records]
    matches = tuple(match(r, p, adc=adc, name=n) for r, p, n in zip(records, references, called, strict=True))
    accel, why = None, ""
    try:
        accel = prepare_accel(matches, gravity_m_s2=settings.gravity_m_s2, cutoff_hz=settings.accel_cutoff_hz)
    except (InputError, CalibrationError) as error:
        why = str(error)
    codes = records[0].accel
    return Prepared(
        records=tuple(records),
        references=tuple(references),
        matches=matches,
        adc=adc,
        accel_codes=None if codes is None else identify_adc(codes),
        accel=accel,
        accel_reason=why,
    )


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
        Raw recordings of one device in one mounting; each begins with a rest.
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
    """Fit the device model to chosen recordings.

    Parameters
    ----------
    prepared : Prepared
        Recordings of one device.
    settings : TwinSettings
        As prepared.
    chosen : sequence of int, optional
        Numbers of the recordings; all by default.
    brief : bool
        Leave out what a prediction does not need: the g-sensitivity, the table of parameters, residuals.

    Returns
    -------
    Twin
        Parameters with standard errors; none where brief.
    """
    number = list(range(len(prepared.records)) if chosen is None else chosen)
    records, references = [prepared.records[k] for k in number], [prepared.references[k] for k in number]
    matches = [prepared.matches[k] for k in number]
    gyro = fit_reference(records, references, settings=REFERENCE_SETTINGS, adc=prepared.adc)
    accel = None if prepared.accel is None else solve_accel(
        prepared.accel, chosen=number, cutoff_hz=settings.accel_cutoff_hz
    )  # fmt: skip
    rests, codes = [m.rest for m in matches], prepared.accel_codes
    twin = Twin(
        gyro=gyro,
        accel=accel,
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
    residuals = np.array([gyro_residual(m, gyro, settings) for m in matches])
    return replace(
        twin,
        parameters=_parameters(twin, prepared, records, references),
        gyro_residual_rms=residuals[:, 0],
        gyro_signal_rms=residuals[:, 1],
    )


def gyro_residual(match: Match, fit: ReferenceFit, settings: TwinSettings) -> tuple[float, float]:
    """Return what is left between corrected readings and the rate of the poses, and that rate itself.

    Parameters
    ----------
    match : Match
        The recording.
    fit : ReferenceFit
        Of the device.
    settings : TwinSettings
        Cut-off.

    Returns
    -------
    tuple of float
        Root mean square per axis of residual and of rate, both after the low-pass, rad/s.
    """
    motion = match.at(match.lag.seconds, settings.gravity_m_s2)
    model = fit.model_at_rest_offset(match.rest_offset)
    done = (match.gyro - model.offset) @ model.matrix.T
    left, seen = [], []
    for rows in stretches(match, motion, match.gyro):
        both = np.concatenate(
            (rotate(motion.q_nb[rows], done[rows]), rotate(motion.q_nb[rows], motion.rate_b[rows])), axis=1
        )
        low, _ = smoothed(both, settings.gyro_cutoff_hz, match.record.sample_rate_hz)
        left.append(low[:, :3] - low[:, 3:])
        seen.append(low[:, 3:])
    if not left:
        return float("nan"), float("nan")
    return tuple(float(np.sqrt((np.concatenate(x) ** 2).mean())) for x in (left, seen))  # type: ignore[return-value]


def _parameters(
    twin: Twin, prepared: Prepared, records: Sequence[Record], references: Sequence[Reference]
) -> tuple[TwinParameter, ...]:
    gyro = twin.gyro
    found = [known("gyro_delay", *mean_with_error(gyro.lags_s, gyro.lag_uncertainties_s), "s")]
    found += triad_parameters("gyro", gyro.triad.model, gyro.triad.model.covariance, "rad/s")
    moved = zip(AXES, gyro.motion_offset, _motion_error(gyro), strict=True)
    found += [known(f"gyro_motion_offset_{a}", value, error, "rad/s") for a, value, error in moved]
    found += _g_sensitivity(prepared, records, references)
    found += _accel_parameters(twin, prepared.accel_reason)
    found += _noise_parameters("gyro", twin.gyro_noise, "rad/s/sqrt(Hz)", records[0].sample_rate_hz)
    found += _noise_parameters("accel", twin.accel_noise, "m/s2/sqrt(Hz)", records[0].sample_rate_hz)
    codes = None if records[0].gyro is None else identify_adc(records[0].gyro)
    rounding = None if twin.adc is None or twin.adc.gyro_lsb is None else twin.adc.gyro_rounding
    return tuple(found + _adc("gyro", codes, rounding, "rad/s") + _adc("accel", prepared.accel_codes, None, "m/s2"))


def _step(lsb: FloatArray | None) -> float:
    return 0.0 if lsb is None else float(np.mean(lsb))


def _motion_error(gyro: ReferenceFit) -> FloatArray:
    total = gyro.triad.model.covariance[range(9, 12), range(9, 12)]
    error: FloatArray = np.sqrt(np.maximum(total, 0.0))
    return error


def _g_sensitivity(
    prepared: Prepared, records: Sequence[Record], references: Sequence[Reference]
) -> list[TwinParameter]:
    unit = "rad/s per m/s2"
    if any(record.accel is None for record in records):
        return [unknown("gyro_g_sensitivity", unit, "no accelerometer readings beside the gyroscope's")]
    settings = replace(REFERENCE_SETTINGS, g_sensitivity=True)
    try:
        model = fit_reference(records, references, settings=settings, adc=prepared.adc).triad.model
    except CalibrationError as error:
        return [unknown("gyro_g_sensitivity", unit, str(error))]
    values = np.zeros(9) if model.g_sensitivity is None else model.g_sensitivity.ravel()
    return g_sensitivity_parameters(values, model.standard_uncertainty[12:])


def _accel_parameters(twin: Twin, reason: str) -> list[TwinParameter]:
    fit = twin.accel
    if fit is None:
        return [unknown("accel_matrix", "1", reason), unknown("lever_arm", "m", reason)]
    sigma = np.sqrt(np.diag(fit.covariance))
    gyro_error = mean_with_error(twin.gyro.lags_s, twin.gyro.lag_uncertainties_s)[1]
    found = [known("accel_delay", twin.delay + fit.delay, float(np.hypot(sigma[15], gyro_error)), "s")]
    found += triad_parameters("accel", fit.model, fit.covariance, "m/s2")
    return found + [known(f"lever_arm_{a}", fit.lever_arm[i], sigma[12 + i], "m") for i, a in enumerate(AXES)]


def _noise_parameters(prefix: str, noise: RestNoise | None, unit: str, rate: float) -> list[TwinParameter]:
    name = "angle_random_walk" if prefix == "gyro" else "velocity_random_walk"
    if noise is None:
        why = "no rest of 1024 samples or more without gaps in which every reading changes"
        return [unknown(f"{prefix}_{name}", unit, why), unknown(f"{prefix}_bandwidth", "Hz", why)]
    found = [
        known(f"{prefix}_{name}_{a}", noise.random_walk[i], noise.random_walk_error[i], unit)
        for i, a in enumerate(AXES)
    ]
    if np.isfinite(noise.bandwidth_hz):
        return [*found, known(f"{prefix}_bandwidth", noise.bandwidth_hz, noise.bandwidth_error_hz, "Hz")]
    reason = (
        f"noise at rest tells of no low-pass below half the sample rate, {0.5 * rate:.0f} Hz: it lies above "
        f"{noise.bandwidth_above_hz:.0f} Hz; only faster sampling would tell"
    )
    return [*found, unknown(f"{prefix}_bandwidth", "Hz", reason)]


def _adc(prefix: str, codes: AdcFinding | None, rounding: str | None, unit: str) -> list[TwinParameter]:
    if codes is None:
        return []
    if codes.lsb is None:
        return [unknown(f"{prefix}_lsb", unit, codes.reason)]
    told = rounding or codes.rounding
    step = known(f"{prefix}_lsb", float(codes.lsb.mean()), float(codes.lsb.std()), unit)
    word = TwinParameter(
        name=f"{prefix}_rounding",
        value=told or float("nan"),
        standard_error=float("nan"),
        unit="",
        identifiable=told is not None,
        reason="" if told is not None else codes.reason,
    )
    return [step, word]
