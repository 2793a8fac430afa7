"""One recording against its reference: the error in degrees, as a person would meet it.

Protocol: readings are corrected; the lag against the reference is found; on request the mean rate of the first rest
is taken out; tilt from specific force and heading from the reference over the rest before the motion; strapdown from half
a second before the motion on. Errors (``errors.py``) count where the reference saw the body: root-mean-square over the
motion, the end error as the median over the first three seconds after it.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, frozen
from undrift.calibration.adc import identify_record_adc
from undrift.calibration.model import AdcModel, Calibration, TriadModel
from undrift.correct import Policy, correct_checked
from undrift.drift.lookup.beyond import find_beyond
from undrift.errors import AlignmentError, InputError
from undrift.orientation.angles import inclination_of, sagittal_pitch
from undrift.orientation.strapdown import check_gaps
from undrift.record import Record, Reference
from undrift.session import Face
from undrift.sync import Lag, LagSettings, Motion, find_lag, find_motion, native_poses
from undrift.units import RADIAN_PER_DEGREE, SI_UNIT, STANDARD_GRAVITY, si_factor
from undrift.validation.align import Alignment, align_rates
from undrift.validation.errors import OrientationError, compare_orientations, rms
from undrift.validation.figures import Figures, Stretches, degrees, figures_of
from undrift.validation.track import track_from_rest

RestOffset = Literal["none", "rest"]
Adc = Literal["auto", "none"]
Align = Literal["auto", "none", "rates"]


LAG_SETTINGS = LagSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialSettings:
    """How a recording is judged.

    Parameters
    ----------
    offset : str
        "rest" takes the mean rate of the first rest out after correction; "none" trusts the calibration's offset.
    adc : str
        "auto" gives back what rounding took: as the calibration says, or, without one, as the record's own codes say.
        "none" leaves the codes as they are.
    align : str
        Rotation between device case and the reference's body, from rates: "rates" always, "none" never, "auto" where it
        exceeds 5 deg.
    rest_s : float
        Rest before the motion that gives tilt and heading, s.
    lead_s : float
        How long before the motion the integration starts, s; the rest mean ends there too.
    end_s : float
        Time after the motion over which the end error is taken, s.
    undo_lag_above_s : float
        A lag up to this is the sensor's own and stays in the main figures, as benchmarks have it; a longer one is a matter
        of clocks or filters and is undone, s. Both root-mean-square totals are reported in any case.
    forward, up : str
        Axes of the body that span its sagittal plane.
    power_on_s : float or None
        Time since power-on at the first sample, s; None where it is not known: then no warm-up is taken off.
    policy : str
        Temperatures outside a tuning table: "raise", "hold" its end, or "nan", as ``correct`` has it.
    lag : LagSettings
        Of the lag search.
    """

    offset: RestOffset = "none"
    adc: Adc = "auto"
    align: Align = "auto"
    rest_s: float = 10.0
    lead_s: float = 0.5
    end_s: float = 3.0
    undo_lag_above_s: float = 0.01
    forward: Face = "+x"
    up: Face = "+z"
    power_on_s: float | None = None
    policy: Policy = "raise"
    lag: LagSettings = LAG_SETTINGS


ALIGN_ABOVE = 5.0 * RADIAN_PER_DEGREE  # rad
TRIAL_SETTINGS = TrialSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mounting:
    """How the device sits on the reference's body, and whether that was undone.

    Parameters
    ----------
    alignment : Alignment
        Rotation from device case to body.
    applied : bool
        Whether the readings were turned by it.
    """

    alignment: Alignment
    applied: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """One recording judged.

    Parameters
    ----------
    recording : str
        Name.
    figures : Figures
        Its errors.
    lag : Lag
        As found, with correlation before and after.
    lag_undone : bool
        Whether the main figures have the lag taken out.
    motion : Motion
        On the record's clock.
    mounting : Mounting or None
        Rotation between device case and the reference's body; None where it was not looked for.
    mean_inclination : tuple of float
        Mean angle of the body's z axis from the vertical over the motion, sensor and reference, rad: what agreement
        over trials is taken on.
    notes : tuple of str
        What was done or met that a reader may not expect.
    time : array, shape (N,)
        s, reference clock, the samples of the series below.
    error : OrientationError
        Total, heading, inclination and pitch error, rad, shape (N,) each; NaN where the reference saw nothing.
    sensor_pitch, reference_pitch : array, shape (N,)
        Sagittal pitch, rad.
    moving : array, shape (N,)
        1 within the motion.
    """

    recording: str
    figures: Figures
    lag: Lag
    lag_undone: bool
    motion: Motion
    mounting: Mounting | None
    mean_inclination: tuple[float, float]
    notes: tuple[str, ...]
    time: FloatArray
    error: OrientationError
    sensor_pitch: FloatArray
    reference_pitch: FloatArray
    moving: FloatArray

    def __post_init__(self) -> None:
        n = len(self.time)
        for name in ("time", "sensor_pitch", "reference_pitch", "moving"):
            object.__setattr__(self, name, frozen(getattr(self, name), (n,), f"Trial.{name}"))


def validate_trial(
    record: Record,
    reference: Reference,
    *,
    calibration: Calibration | None = None,
    settings: TrialSettings = TRIAL_SETTINGS,
    name: str = "",
) -> Trial:
    """Judge one recording against its reference.

    Parameters
    ----------
    record : Record
        Raw readings, or corrected ones with no calibration given.
    reference : Reference
        Poses of the same body on their own clock.
    calibration : Calibration or None
        Of this device; None judges the readings as they come.
    settings : TrialSettings
        Offset, ADC, alignment, protocol.
    name : str
        What to call it; the reference's name where empty.

    Returns
    -------
    Trial
        Figures in degrees, and the error sample by sample.

    Raises
    ------
    InputError
        No gyroscope, gaps in the rate, or a unit that nothing turns into rad/s.
    AlignmentError
        No common motion, no rest before it, or no pose in that rest.
    """
    done, notes = _corrected(record, calibration, settings)
    if done.gyro is not None and not np.isfinite(done.gyro).all(axis=1).any():
        check_gaps(done.gyro, done.time, "validate")
    share = _gaps(done).mean()
    poses = native_poses(reference)
    try:
        lag = find_lag(done, poses, settings.lag)
    except AlignmentError as unmatched:
        if share > 0.0:
            raise AlignmentError(f"{unmatched}; {share:.0%} of the samples are gaps (NaN)") from unmatched
        raise
    motion = find_motion(done, reference, lag_s=lag.seconds)
    notes += _gaps_before(done, motion, settings)
    if settings.offset == "rest":
        done = _without_rest_mean(done, motion, settings)
    done, mounting = _aligned(done, poses, lag, settings)
    held = 0.5 / done.sample_rate_hz  # strapdown holds each reading over the step before its stamp
    track = track_from_rest(
        done, reference, motion, shift_s=lag.seconds - held, rest_s=settings.rest_s, lead_s=settings.lead_s
    )
    errors = tuple(
        _compared(track.at(reference.time + shift), reference, settings) for shift in (0.0, lag.seconds - held)
    )
    undone = abs(lag.seconds) > settings.undo_lag_above_s
    error, sensor_pitch, tilt = errors[1] if undone else errors[0]
    stretches = _stretches(reference, motion, lag.seconds if undone else 0.0, settings)
    reference_pitch = sagittal_pitch(reference.q_nb, forward=settings.forward, up=settings.up)
    figures = replace(
        figures_of(error, (sensor_pitch, reference_pitch), stretches, lag_s=lag.seconds),
        rmse_total_before_lag_deg=degrees(rms(errors[0][0].total[stretches.moving])),
        rmse_total_after_lag_deg=degrees(rms(errors[1][0].total[stretches.moving])),
        motion_s=motion.stop_s - motion.start_s,
        turn_rate_rms_dps=_turn_rate_rms(done, motion),
    )
    both = stretches.moving & np.isfinite(error.total)
    return Trial(
        recording=name or reference.name,
        figures=figures,
        lag=lag,
        lag_undone=undone,
        motion=motion,
        mounting=mounting,
        mean_inclination=(_mean(tilt[both]), _mean(inclination_of(reference.q_nb[both]))),
        notes=notes,
        time=reference.time,
        error=error,
        sensor_pitch=sensor_pitch,
        reference_pitch=reference_pitch,
        moving=stretches.moving.astype(float),
    )


def _gaps(record: Record) -> BoolArray:
    """True where a channel that the record has is missing."""
    mask = np.zeros(len(record), dtype=bool)
    for values in (record.gyro, record.accel):
        if values is not None:
            mask |= ~np.isfinite(values).all(axis=1)
    return mask


def _gaps_before(record: Record, motion: Motion, settings: TrialSettings) -> tuple[str, ...]:
    """Say what is missing of the rest that tilt and offset are taken from; after it, a gap is refused."""
    gaps = _gaps(record)[record.time < motion.start_s - settings.lead_s]
    if not gaps.any():
        return ()
    return (
        f"{int(gaps.sum())} of {len(gaps)} samples before the motion are gaps (NaN): the rest is taken from the others",
    )


def _compared(
    q: FloatArray, reference: Reference, settings: TrialSettings
) -> tuple[OrientationError, FloatArray, FloatArray]:
    error = compare_orientations(q, reference.q_nb, forward=settings.forward, up=settings.up)
    return error, sagittal_pitch(q, forward=settings.forward, up=settings.up), inclination_of(q)


def _stretches(reference: Reference, motion: Motion, lag_s: float, settings: TrialSettings) -> Stretches:
    start, stop = motion.start_s - lag_s, motion.stop_s - lag_s
    moving = (reference.time >= start) & (reference.time < stop)
    if reference.moving is not None and (reference.moving > 0.0).any():
        moving = reference.moving > 0.0
    after = (reference.time >= stop) & (reference.time < stop + settings.end_s)
    return Stretches(time=reference.time, moving=moving, after=after, valid=reference.valid)


def _turn_rate_rms(record: Record, motion: Motion) -> float:
    rates = record.between(motion.start_s, motion.stop_s).gyro
    return float("nan") if rates is None else degrees(float(np.sqrt(np.nanmean((rates**2).sum(axis=1)))))


def _mean(angles: FloatArray) -> float:
    return float(angles.mean()) if len(angles) else float("nan")


def _corrected(
    record: Record, calibration: Calibration | None, settings: TrialSettings
) -> tuple[Record, tuple[str, ...]]:
    if calibration is None:
        adc = identify_record_adc(record) if settings.adc == "auto" and record.state == "raw" else None
        if adc is None:
            return record.in_si(), ()
        done = correct_checked(record, nominal_calibration(record, adc))
        return done.record, (f"gyro codes rounded {adc.gyro_rounding.replace('_', ' ')}: the mean loss was given back",)
    if settings.adc == "none":
        calibration = replace(calibration, adc=None)
    done = correct_checked(record, calibration, policy=settings.policy, power_on_s=settings.power_on_s)
    beyond = (one.text for one in find_beyond(done.record, calibration) if one.text)
    return done.record.in_si(), (*done.warnings, *beyond, *done.notes)


def nominal_calibration(record: Record, adc: AdcModel | None) -> Calibration:
    """Return the calibration of a device that is what its unit says, apart from the rounding of its codes.

    Parameters
    ----------
    record : Record
        In physical units.
    adc : AdcModel or None
        Rounding of the codes.

    Returns
    -------
    Calibration
        Identity matrices and zero offsets.

    Raises
    ------
    InputError
        Counts or volts.
    """

    def nominal(unit: str, quantity: Literal["rate", "accel"]) -> TriadModel:
        return TriadModel(
            method="nominal",
            unit_in=unit,
            unit_out=SI_UNIT[quantity],
            matrix=np.eye(3) * si_factor(unit, quantity),
            offset=np.zeros(3),
            covariance=np.zeros((12, 12)),
            rms_residual=0.0,
            count=0,
            rank=0,
            condition=1.0,
            valid_range=(-np.inf, np.inf),
        )

    return Calibration(
        device=record.device,
        reference_temp_c=float("nan"),
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=None if record.gyro is None else nominal(record.gyro_unit, "rate"),
        accel=None if record.accel is None else nominal(record.accel_unit, "accel"),
        adc=adc,
    )


def _without_rest_mean(record: Record, motion: Motion, settings: TrialSettings) -> Record:
    rest = record.between(record.time[0], motion.start_s - settings.lead_s).gyro
    seen = np.empty((0, 3)) if rest is None else rest[np.isfinite(rest).all(axis=1)]
    if record.gyro is None or not len(seen):
        raise InputError("validate: wanted gyro readings at rest before the motion, got none; use offset none")
    return replace(record, gyro=record.gyro - seen.mean(axis=0))


def _aligned(record: Record, poses: Reference, lag: Lag, settings: TrialSettings) -> tuple[Record, Mounting | None]:
    if settings.align == "none":
        return record, None
    try:
        found = align_rates(record, poses, lag_s=lag.seconds)
    except AlignmentError:
        if settings.align == "rates":
            raise
        return record, None  # turning about one axis alone does not show the mounting; it is taken as stated
    if settings.align == "auto" and found.angle <= ALIGN_ABOVE:
        return record, Mounting(alignment=found, applied=False)
    turned = replace(
        record,
        gyro=None if record.gyro is None else record.gyro @ found.rotation.T,
        accel=None if record.accel is None else record.accel @ found.rotation.T,
    )
    return turned, Mounting(alignment=found, applied=True)
