"""Orientation errors of a recording against its reference, in degrees.

The readings are corrected, and their lag behind the reference and the mounting are determined. If requested, the mean rate of the
first still phase is subtracted. The initial tilt is computed from the specific force, and the initial heading from the reference,
both over the rest before the motion. Strapdown integration starts half a second before the motion, q(t_k) = q(t_(k-1)) exp(w_k (t_k
- t_(k-1))). With both orientations from body to level frame, the error in earth axes is e = q_imu (x) q_ref^-1 = (w, x, y, z), and
[1]_::

    total        2 acos |w|
    heading      2 atan(z / w)             signed, positive if the sensor has turned too far about the vertical
    inclination  2 acos sqrt(w^2 + z^2)    angle between the two verticals
    pitch        signed difference of the two sagittal pitches, wrapped to (-pi, pi]

Root-mean-square values are over the valid poses of the motion.

References
----------
.. [1] D. Laidig, M. Caruso, A. Cereatti, T. Seel, "BROAD - A benchmark for robust inertial orientation estimation", Data
   6(7), 72, 2021.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.triads import check_triads
from undrift.correction.correct import correct_checked
from undrift.correction.rest import IN_MOTION, RemainingOffset, find_offset, mean_variance
from undrift.errors import AlignmentError, InputError, check_choices, check_type
from undrift.findings import Finding, finding
from undrift.frames import (
    integrate_strapdown,
    quaternion_conjugate,
    quaternion_of,
    quaternion_product,
    rotation_vector,
)
from undrift.model import BodyMounting, Calibration, TriadModel
from undrift.orientation import (
    check_gaps,
    check_pitch_axes,
    filtered,
    heading_of,
    inclination_of,
    initial_tilt,
    sagittal_pitch,
    shortest_rotation_up,
)
from undrift.record import Face, Record, Reference, Still
from undrift.segments import unpadded
from undrift.shown import Shown
from undrift.sync import LONGEST_LAG_S, Clocks, Lag, MotionSpan, find_motion, in_step, padding
from undrift.units import RADIAN_PER_DEGREE, is_physical
from undrift.validation.align import LEAD_S, REST_S, Align, Mounting, align, check_reference, check_vertical, turned
from undrift.validation.expected import ERROR_PRIOR, ErrorPrior, Expected, OffsetSource, Strapdown, expected_errors

OffsetChoice = Literal["none", "rest", "motion"]
Track = tuple[FloatArray, FloatArray]  # times (N,), s, on the clock of the record, and orientations (N, 4)

START_S = 1.0  # time over which the reference gives the initial orientation of a recording without rest
END_S = 3.0  # time after the motion over which the end error is taken
FILTER_OFFSET = 0.5 * RADIAN_PER_DEGREE  # initial uncertainty of the rate offset in the filter, rad/s (as in VQF)
# A lag up to this is due to the sensor and stays in the errors, as in benchmarks. A longer lag is due to clocks or filters and is
# removed.
OWN_LAG_S = 0.01
SCALE_RANGE = (0.5, 2.0)  # ratio of the rates of device and reference: outside this range, a unit is wrong


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialSettings:
    """Settings of the comparison of a recording with its reference."""

    # offset that is subtracted after the correction, as ``correct`` and ``orient`` do
    offset: OffsetChoice = "none"
    # "auto" removes the rotation between device case and body of the reference if it exceeds ``align_above``, rad. "level" always
    # removes it, for a body whose axes have no meaning, such as a cluster of markers (validation/align.py)
    align: Align = "auto"
    align_above: float = 5.0 * RADIAN_PER_DEGREE
    # axes of the body that span its sagittal plane
    forward: Face = "+x"
    up: Face = "+z"
    mounting: BodyMounting | None = None  # rotation of the readings to the axes of the segment
    longest_lag_s: float = LONGEST_LAG_S  # largest lag between the clocks, s
    prior: ErrorPrior = ERROR_PRIOR  # changes between recordings of a device, for the expected errors
    method: Literal["strapdown", "vqf"] = "strapdown"  # "vqf": filter over the whole record, without expected errors

    def __post_init__(self) -> None:
        check_choices(self, "validate")


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """Errors of a recording, or their mean or median over recordings."""

    lag_ms: float  # lag of the record behind the reference
    rmse_total_deg: float  # root mean square over the motion
    rmse_inclination_deg: float
    rmse_heading_deg: float
    rmse_pitch_deg: float
    max_abs_pitch_deg: float  # largest pitch error, which can exceed the total error near the side of the body
    end_total_deg: float  # median error after the motion, or at its end if there is no rest before the motion
    end_inclination_deg: float
    valid_optics: float  # share of the motion in which the reference has poses
    # share of the samples with an error for which pitch is defined: the vertical is 5 deg or more from the normal of the sagittal
    # plane
    pitch_defined: float
    motion_s: float  # duration of the motion


def rows_of(figures: Figures) -> dict[str, str]:
    """Return the errors that a notebook displays, deg."""
    names = ("total", "inclination", "heading", "pitch")
    return {f"{name}, rms": f"{getattr(figures, f'rmse_{name}_deg'):.2f} deg" for name in names}


# ---- Orientation errors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrientationError:
    """Error of an orientation against another, sample by sample, NaN if either is missing."""

    total: FloatArray  # (N,), rad
    heading: FloatArray  # (N,), rad, signed
    inclination: FloatArray  # (N,), rad
    # (N,), signed difference of sagittal pitch, rad, or NaN if the vertical is too far from the sagittal plane
    pitch: FloatArray


def compare_orientations(
    q_nb: FloatArray, reference_q_nb: FloatArray, *, forward: Face = "+x", up: Face = "+z"
) -> OrientationError:
    """Compare orientations of the same body at the same times.

    Parameters
    ----------
    q_nb : array, shape (N, 4)
        Orientation to be judged, w-x-y-z.
    reference_q_nb : array, shape (N, 4)
        Reference orientation, w-x-y-z.
    forward, up : str
        Axes of the body that span its sagittal plane, for example "+x".

    Returns
    -------
    OrientationError
        Errors in rad.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    >>> trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    >>> orientation = undrift.orient(undrift.correct(trial.record, calibration))
    >>> error = undrift.compare_orientations(orientation.q_nb, trial.motion.q_nb)
    >>> bool(np.degrees(np.abs(error.pitch)).max() < 0.1)
    True
    """
    for q in (q_nb, reference_q_nb):
        check_type(q, np.ndarray, "compare_orientations", "Give quaternions (N, 4), for example orientation.q_nb.")
    e = quaternion_product(q_nb, quaternion_conjugate(reference_q_nb))
    pitch = sagittal_pitch(q_nb, forward=forward, up=up) - sagittal_pitch(reference_q_nb, forward=forward, up=up)
    return OrientationError(
        total=2.0 * np.arctan2(np.linalg.norm(e[:, 1:], axis=1), np.abs(e[:, 0])),
        heading=heading_of(e),
        inclination=inclination_of(e),
        pitch=wrapped(pitch),
    )


def wrapped(angle: FloatArray) -> FloatArray:
    """Return angles wrapped to (-pi, pi]."""
    result: FloatArray = np.pi - np.mod(np.pi - angle, 2.0 * np.pi)
    return result


def of_finite(summary: Callable[[FloatArray], Any], values: FloatArray) -> float:
    """Return a summary of the finite values, or NaN if there are only gaps."""
    finite = values[np.isfinite(values)]
    return float(summary(finite)) if len(finite) else float("nan")


def rms(values: FloatArray) -> float:
    """Return the root mean square of the finite values."""
    return of_finite(lambda finite: np.sqrt((finite**2).mean()), values)


# ---- One trial


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial(Shown):
    """One recording compared with its reference. Series have shape (N,), on the clock of the reference."""

    recording: str  # name
    figures: Figures
    clocks: Clocks
    lag_undone: bool  # True if the lag is removed from the errors
    motion: MotionSpan  # start and end of the motion, on the clock of the record
    mounting: Mounting | None  # None if the motion does not determine it
    findings: tuple[Finding, ...]
    time: FloatArray  # s
    q_nb: FloatArray  # (N, 4), orientation of the body from the device
    error: OrientationError  # NaN if the reference has no pose
    sensor_pitch: FloatArray  # sagittal pitch from the device, rad
    reference_pitch: FloatArray  # rad
    moving: BoolArray  # within the motion
    expected: Expected | None = None  # None without a calibration that contains its covariance
    rest: RemainingOffset | None = None  # offset that was subtracted

    @property
    def lag(self) -> Lag:
        """Lag of the recording behind the reference."""
        return self.clocks.lag

    @property
    def within_expected(self) -> bool | None:
        """Return True if the errors over and after the motion are within the expected 95 % limits, or None without limits."""
        if self.expected is None:
            return None
        end_deg = self.figures.end_total_deg
        end_within = math.isnan(end_deg) or end_deg <= self.expected.end_at_most_deg
        return end_within and self.figures.rmse_total_deg <= self.expected.rmse_at_most_deg

    def facts(self) -> dict[str, str]:
        """Return the rows of the table of values: name, and value with unit."""
        return {"recording": self.recording} | rows_of(self.figures)


def validate_trial(
    record: Record,
    reference: Reference,
    *,
    calibration: Calibration | None = None,
    settings: TrialSettings = TrialSettings(),
    name: str = "",
    source: OffsetSource | None = None,
    clocks: Clocks | None = None,
) -> Trial:
    """Compare one recording with its reference.

    Parameters
    ----------
    record : Record
        Raw readings or, without a calibration, corrected readings.
    reference : Reference
        Poses of the same body on their own clock.
    calibration : Calibration or None
        Calibration of this device, or None to compare the readings as they are.
    settings : TrialSettings
        Offset, alignment, axes of the pitch.
    name : str
        Name of the trial, by default the name of the reference.
    source : OffsetSource or None
        Source of the calibration's offset, for the expected errors. By default it follows from the settings and the model.
    clocks : Clocks or None
        Clocks of an earlier trial of the same recording, to avoid the search for the lag.

    Returns
    -------
    Trial
        Figures in degrees, and the error of each sample.

    Raises
    ------
    InputError
        There are no gyroscopes, the rate has gaps, the unit is not physical, or the rates are in a wrong unit.
    AlignmentError
        There is no common motion, or no pose in the rest before the motion.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    >>> trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    >>> result = undrift.validate_trial(trial.record, trial.reference, calibration=calibration)
    >>> bool(result.figures.max_abs_pitch_deg < 0.5)
    True
    """
    check_type(record, Record, "validate: `record`", "Read a file with read_record.")
    check_type(reference, Reference, "validate: `reference`", "Read a file with read_reference.")
    name, model = name or reference.name, None if calibration is None else calibration.gyro
    record, findings = _corrected(record, calibration)
    clocks = clocks or synchronise(record, reference, settings.longest_lag_s)
    record, reference, poses, lag = replace(record, time=clocks.time), clocks.reference, clocks.poses, clocks.lag
    frame_findings = check_reference(_worn(record, settings), poses, lag.seconds)
    _check_scale(name, lag)
    motion = find_motion(record, reference, lag_s=lag.seconds)
    record, rest, rest_findings = _without_offset(record, settings.offset, model)
    record, mounting = align(
        _worn(record, settings), poses, motion, lag_s=lag.seconds, how=settings.align, above=settings.align_above
    )

    # a strapdown holds each reading over the step before its time stamp: half a sample
    shift_s = lag.seconds - 0.5 / record.sample_rate_hz
    lag_undone = max(abs(lag.seconds), abs(shift_s)) > OWN_LAG_S
    track = _track(record, reference, poses, motion, shift_s, settings)
    q_nb = orientation_at(*track, reference.time + shift_s * lag_undone)
    axes: dict[str, Face] = {"forward": settings.forward, "up": settings.up}
    error = compare_orientations(q_nb, reference.q_nb, **axes)

    start_s, stop_s = motion.start_s - lag.seconds * lag_undone, motion.stop_s - lag.seconds * lag_undone
    before, moving = reference.time < start_s, (reference.time >= start_s) & (reference.time < stop_s)
    if reference.moving is not None and (reference.moving > 0.0).any():
        moving = reference.moving > 0.0  # pauses are left out
    after = (reference.time >= stop_s) & (reference.time < stop_s + END_S)
    tilt = of_finite(np.median, error.inclination[before])
    frame_findings = frame_findings or check_vertical(tilt, "the axes differ at the rest before the motion")
    if not motion.rested:
        after = moving & (reference.time >= stop_s - END_S)
        sentence = (
            "The recording has no rest before the motion. Therefore the reference determines the initial orientation, at "
            f"{track[0][0]:.1f} s, and end errors are from the last seconds of the motion."
        )
        rest_findings += (finding("validate.no_rest", "info", sentence, "Record a pause at rest."),)
    pitch_findings = check_pitch_axes(q_nb, rows, **axes) if (rows := before & np.isfinite(q_nb[:, 0])).any() else ()
    trial = Trial(
        recording=name,
        figures=_figures(error, moving, after, valid=reference.valid, lag_s=lag.seconds, motion=motion),
        clocks=clocks,
        lag_undone=lag_undone,
        motion=motion,
        mounting=mounting,
        findings=(
            *findings, *clocks.findings, *frame_findings,
            *(item for item in pitch_findings if item.level == "warn"), *rest_findings,
        ),
        time=reference.time,
        q_nb=q_nb,
        error=error,
        sensor_pitch=sagittal_pitch(q_nb, **axes),
        reference_pitch=sagittal_pitch(reference.q_nb, **axes),
        moving=moving,
        rest=rest,
    )  # fmt: skip
    if calibration is None or model is None or settings.method == "vqf" or not model.covariance[:9, :9].any():
        return trial
    run = _strapdown(trial, record, track, calibration, settings, delay_s=0.0 if lag_undone else shift_s)
    expected = expected_errors(run, model, source or _source(trial, model, settings), settings.prior)
    return replace(trial, expected=expected)


def _figures(
    error: OrientationError, moving: BoolArray, after: BoolArray, *, valid: BoolArray, lag_s: float, motion: MotionSpan
) -> Figures:
    """Return the errors over the motion and after it."""
    compared = moving & np.isfinite(error.total)
    total, inclination, heading, pitch = (
        rms(values[moving]) / RADIAN_PER_DEGREE
        for values in (error.total, error.inclination, error.heading, error.pitch)
    )
    return Figures(
        lag_ms=lag_s * 1e3,
        rmse_total_deg=total,
        rmse_inclination_deg=inclination,
        rmse_heading_deg=heading,
        rmse_pitch_deg=pitch,
        max_abs_pitch_deg=of_finite(np.max, np.abs(error.pitch[moving])) / RADIAN_PER_DEGREE,
        end_total_deg=of_finite(np.median, error.total[after]) / RADIAN_PER_DEGREE,
        end_inclination_deg=of_finite(np.median, error.inclination[after]) / RADIAN_PER_DEGREE,
        valid_optics=float(valid[moving].mean()) if moving.any() else 0.0,
        pitch_defined=float(np.isfinite(error.pitch[compared]).mean()) if compared.any() else float("nan"),
        motion_s=motion.stop_s - motion.start_s,
    )


def check_poses(record: Record, reference: Reference, longest_lag_s: float = LONGEST_LAG_S) -> tuple[Finding, ...]:
    """Return findings on the conventions of a reference for readings without a calibration, or raise if they are clearly wrong."""
    if not (is_physical(record.gyro_unit) and is_physical(record.accel_unit)):
        return ()
    record = record.in_si()
    clocks = synchronise(record, reference, longest_lag_s)
    return check_reference(replace(record, time=clocks.time), clocks.poses, clocks.lag.seconds)


# ---- readings


def _corrected(record: Record, calibration: Calibration | None) -> tuple[Record, tuple[Finding, ...]]:
    full_record, record = record, unpadded(record)
    if calibration is None:
        return record.in_si(), (*padding(full_record, record), *check_triads(record))
    corrected = correct_checked(record, calibration)
    return corrected.record.in_si(), (*padding(full_record, record), *corrected.findings)


def _worn(record: Record, settings: TrialSettings) -> Record:
    return record if settings.mounting is None else turned(record, settings.mounting.matrix)


def synchronise(record: Record, reference: Reference, longest_lag_s: float = LONGEST_LAG_S) -> Clocks:
    """Find the difference between the clocks of a recording and its reference. An error also mentions gaps, a possible cause."""
    if record.gyro is not None and not np.isfinite(record.gyro).all(axis=1).any():
        check_gaps(record.gyro, record.time, "validate")
    try:
        return in_step(record, reference, longest_lag_s)
    except AlignmentError as unmatched:
        readings = np.hstack([x for x in (record.gyro, record.accel) if x is not None])
        gaps = float(np.isnan(readings).any(axis=1).mean())
        if gaps == 0.0:
            raise
        raise AlignmentError(f"{unmatched}; {gaps:.0%} of the samples are gaps (NaN)") from unmatched


def _check_scale(name: str, lag: Lag) -> None:
    """Raise InputError if the rate of a device is over twice or under half that of its reference, for example in a wrong unit."""
    ratio = 1.0 / float(np.linalg.norm(lag.matrix, ord=2))  # the matrix maps readings to the rate of the reference
    if not SCALE_RANGE[0] < ratio < SCALE_RANGE[1]:
        raise InputError(
            f"{name}: the rates are {ratio:.3g} times the rates of the reference. Check the unit and the scale of the gyroscope."
        )


def _without_offset(
    record: Record, offset: OffsetChoice, model: TriadModel | None
) -> tuple[Record, RemainingOffset | None, tuple[Finding, ...]]:
    """Subtract the remaining offset, determined from the first still phase or from motion."""
    if offset == "none":
        return record, None, ()
    try:
        remainder = find_offset(record, offset, model)
    except InputError as error:
        if error.numbers.get("missing") != "rest":
            raise
        which = "offset of the gyroscopes is not removed" if model is None else "offset of the calibration is used"
        sentence = f"The recording has no rest before the motion, so the {which}."
        action = "Record a pause at rest, or determine the offset from motion (`offset` motion)."
        return record, None, (finding("validate.no_rest", "warn", sentence, action),)
    return replace(record, gyro=np.asarray(record.gyro) - remainder.at(record.time)), remainder, ()


# ---- orientation by the device


def orientation_at(time: FloatArray, q_nb: FloatArray, times: FloatArray) -> FloatArray:
    """Return a track's orientation at other times, along the great arc between samples: times (M,) s -> (M, 4)."""
    k = np.clip(np.searchsorted(time, times, side="right") - 1, 0, len(time) - 2)
    share = (times - time[k]) / (time[k + 1] - time[k])
    step = rotation_vector(quaternion_product(quaternion_conjugate(q_nb[k]), q_nb[k + 1]))
    q = quaternion_product(q_nb[k], quaternion_of(step * share[:, None]))
    inside = (times >= time[0]) & (times <= time[-1])
    return np.where(inside[:, None], q, np.nan)


def _track(
    record: Record, reference: Reference, poses: Reference, motion: MotionSpan, shift_s: float, settings: TrialSettings
) -> Track:
    """Return the orientation from the filter, or from strapdown that starts at the rest before the motion or at the first poses."""
    gyro = np.asarray(record.gyro)
    if settings.method == "vqf":
        q = filtered(record, gyro, FILTER_OFFSET, magnetometer=False)[0]
        start_s, stop_s = motion.start_s - shift_s, motion.start_s - shift_s + START_S
        if motion.rested:
            start_s, stop_s = start_s - REST_S, start_s - LEAD_S
        q_poses = orientation_at(record.time, q, reference.time + shift_s)
        return record.time, quaternion_product(_turn_to(reference, q_poses, start_s, stop_s, heading_only=True), q)
    begin_s = motion.start_s - LEAD_S * motion.rested
    first = int(np.searchsorted(record.time, begin_s))
    time, gyro = record.time[first:], gyro[first:]
    check_gaps(gyro, time, "validate")
    if not motion.rested:
        q = integrate_strapdown(gyro, time, np.array([1.0, 0.0, 0.0, 0.0]))
        q_poses = orientation_at(time, q, poses.time + shift_s)
        start_s = poses.time[int(np.argmax(np.isfinite(q_poses).all(axis=1) & poses.valid))]
        return time, quaternion_product(_turn_to(poses, q_poses, start_s, start_s + START_S), q)
    start = _turn_to(reference, None, begin_s + LEAD_S - REST_S - shift_s, begin_s - shift_s)
    if record.accel is not None:
        forces = record.accel[(record.time >= begin_s + LEAD_S - REST_S) & (record.time < begin_s)]
        forces = forces[np.isfinite(forces).all(axis=1)]
        if not len(forces):
            raise InputError(
                f"validate: the specific force at rest before {begin_s:.6g} s has only gaps (NaN). Correct without gaps "
                "(policy hold, temperatures filled in)."
            )
        tilt = shortest_rotation_up(forces.mean(axis=0))
        start = quaternion_product(_about_vertical(quaternion_product(start, quaternion_conjugate(tilt))), tilt)
    return time, integrate_strapdown(gyro, time, start)


def _turn_to(
    reference: Reference, q: FloatArray | None, start_s: float, stop_s: float, *, heading_only: bool = False
) -> FloatArray:
    """Return the mean rotation in earth axes from orientations (N, 4) to the reference, over a stretch of its clock."""
    turns = reference.q_nb if q is None else quaternion_product(reference.q_nb, quaternion_conjugate(q))
    turns = turns[np.isfinite(turns).all(axis=1) & (reference.time >= start_s) & (reference.time < stop_s)]
    if not len(turns):
        raise AlignmentError(
            f"validate: the reference has no pose at rest from {start_s:.1f} s to {stop_s:.1f} s. The heading requires a pose."
        )
    mean: FloatArray = (turns * np.where(turns @ turns[0] < 0.0, -1.0, 1.0)[:, None]).mean(axis=0)
    return _about_vertical(mean) if heading_only else mean / np.linalg.norm(mean)


def _about_vertical(q: FloatArray) -> FloatArray:
    """Return the vertical part of a rotation."""
    turn = q * np.array([1.0, 0.0, 0.0, 1.0])
    return np.asarray(turn / np.linalg.norm(turn))


# ---- expected errors


def _source(trial: Trial, model: TriadModel, settings: TrialSettings) -> OffsetSource:
    """Return the source of the offset: the calibration, the rest before the motion, or the motion."""
    from_calibration = trial.rest is None
    fitted_in_motion = (model.method in IN_MOTION and from_calibration) or model.moving_offset is not None
    kind: Literal["subtracted", "shown"] = "shown" if settings.offset == "motion" else "subtracted"
    return OffsetSource(rest="other" if from_calibration else kind, in_motion=fitted_in_motion)


def _strapdown(
    trial: Trial, record: Record, track: Track, calibration: Calibration, settings: TrialSettings, *, delay_s: float
) -> Strapdown:
    """Return the integration of a trial, and the uncertainties of its start, its offset and its noise."""
    mounting, subtracted, motion = trial.mounting, trial.rest, trial.motion
    stretch = (float(record.time[0]), motion.start_s - LEAD_S) if motion.rested else None
    if subtracted is not None:
        stretch = subtracted.rest_s
    rest = None if stretch is None else record.between(*stretch)
    rates = np.empty((0, 3)) if rest is None else np.asarray(rest.gyro)
    rates = rates[np.isfinite(rates).all(axis=1)]
    variance = np.array([mean_variance(axis) for axis in rates.T]) if len(rates) > 1 else np.zeros(3)
    rotation = np.eye(3) if mounting is None or not mounting.applied else mounting.rotation
    rotation = rotation if settings.mounting is None else rotation @ settings.mounting.matrix
    offset_covariance, offset_prior = np.diag(variance), np.zeros(3)
    if subtracted is not None and subtracted.prior is not None:
        offset_covariance = rotation @ subtracted.covariance.mean(axis=0) @ rotation.T
        offset_prior = np.sqrt(np.diag(rotation @ np.diag(subtracted.prior**2) @ rotation.T))
    angle_left_in = 0.0 if mounting is None or mounting.applied else mounting.angle
    return Strapdown(
        record=record.part(len(record) - len(track[0]), len(record)),
        q_nb=track[1],
        stop_s=motion.stop_s,
        delay_s=delay_s,
        turned=rotation,
        offset_covariance=offset_covariance,
        offset_prior=offset_prior,
        noise_density=0.0 if rest is None else float(np.sqrt(variance.mean() * rest.duration_s)),
        tilt=_tilt_uncertainty(rest if motion.rested else None, calibration, settings.prior),
        mounting=angle_left_in / np.sqrt(3.0),
    )


def _tilt_uncertainty(rest: Record | None, calibration: Calibration, prior: ErrorPrior) -> float:
    """Return the standard uncertainty of the tilt before the motion against the reference, each level axis, rad."""
    if rest is None or rest.accel is None:
        return prior.pose
    if calibration.accel is None or np.isnan(rest.accel).any():
        return prior.tilt
    # the calibration is judged at its temperature and soon after it was made
    parts = dict(initial_tilt(rest, Still(start=0, stop=len(rest))).parts)
    return math.hypot(math.hypot(parts["scatter"], parts.get("calibration", 0.0)) / math.sqrt(2.0), prior.pose)
