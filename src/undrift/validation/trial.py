"""Orientation errors of a recording against its reference, in degrees.

The readings are corrected, and the lag relative to the reference is determined. If requested, the mean rate of the first still
phase is subtracted (correction/rest.py). The initial tilt is from the specific force, and the initial heading from the reference,
both over the rest before the motion. Strapdown integration starts half a second before the motion, q(t_k) = q(t_(k-1)) exp(w_k
(t_k - t_(k-1))). With both orientations from body to level frame, the error in earth axes is e = q_imu (x) q_ref^-1 = (w, x, y,
z), and [1]_::

    total        2 acos |w|
    heading      2 atan(z / w)             signed, positive if the sensor has turned too far about the vertical
    inclination  2 acos sqrt(w^2 + z^2)    angle between the two verticals
    pitch        signed difference of the two sagittal pitches, wrapped to (-pi, pi]

Root-mean-square values are over the valid poses of the motion. The mounting, the rotation R that minimises sum
|w - R u|^2 over common rates, is Kabsch's problem (1976).

References
----------
.. [1] D. Laidig, M. Caruso, A. Cereatti, T. Seel, "BROAD - A benchmark for robust inertial orientation estimation", Data
   6(7), 72, 2021.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, frozen
from undrift.base.summary import Shown
from undrift.calibration.codes import device_adc
from undrift.calibration.triads import check_triads
from undrift.correction.correct import OffsetLeft, Policy, correct_checked, correct_whole, offset_left
from undrift.correction.rest import IN_MOTION, RestOffset, find_rest_offset, mean_variance
from undrift.drift.observe import nominal_triad
from undrift.errors import AlignmentError, InputError, check_choices
from undrift.findings import Finding, finding
from undrift.frames import (
    cross,
    integrate_strapdown,
    quaternion_conjugate,
    quaternion_of,
    quaternion_product,
    rotate,
    rotation,
    rotation_vector,
)
from undrift.model import AdcModel, BodyMounting, Calibration, TriadModel
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
from undrift.sync import Lag, LagSettings, MotionSpan, find_motion, in_step, native_poses, padding, seen_poses
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical
from undrift.validation.expected import (
    ERROR_PRIOR,
    ErrorPrior,
    Expected,
    OffsetKind,
    OffsetSource,
    Strapdown,
    expected_errors,
)
from undrift.validation.reference_frames import check_reference, common_rates

# ---- track: orientation from the readings alone, started from rest


def orientation_at(time: FloatArray, q_nb: FloatArray, times: FloatArray) -> FloatArray:
    """Return a track's orientation at other times, along the great arc between samples: times (M,) s -> (M, 4)."""
    k = np.clip(np.searchsorted(time, times, side="right") - 1, 0, len(time) - 2)
    share = (times - time[k]) / (time[k + 1] - time[k])
    step = rotation_vector(quaternion_product(quaternion_conjugate(q_nb[k]), q_nb[k + 1]))
    q = quaternion_product(q_nb[k], quaternion_of(step * share[:, None]))
    inside = (times >= time[0]) & (times <= time[-1])
    return np.where(inside[:, None], q, np.nan)


def track_from_rest(
    record: Record, reference: Reference, motion: MotionSpan, *, shift_s: float
) -> tuple[FloatArray, FloatArray]:
    """Integrate the readings from the rest before the motion to the end of the record: time and orientation."""
    if record.gyro is None:
        raise InputError("validate: the record has no gyroscope. Map its columns.")
    stop = motion.start_s - LEAD_S
    rest_mask = (record.time >= motion.start_s - REST_S) & (record.time < stop)
    first = int(np.searchsorted(record.time, stop))
    check_gaps(record.gyro[first:], record.time[first:], "validate")
    start = _mean_pose(reference, motion.start_s - REST_S - shift_s, stop - shift_s)
    if record.accel is not None:
        force = record.accel[rest_mask]
        force = force[np.isfinite(force).all(axis=1)]
        if not len(force):
            raise InputError(
                f"validate: the specific force at rest before {stop:.6g} s has only gaps (NaN). Correct without gaps "
                "(policy hold, temperatures filled in)."
            )
        tilt = shortest_rotation_up(force.mean(axis=0))  # the heading is corrected below
        e = quaternion_product(start, quaternion_conjugate(tilt))
        turn = np.array([e[0], 0.0, 0.0, e[3]])
        start = quaternion_product(turn / np.linalg.norm(turn), tilt)
    time = record.time[first:]
    return time, integrate_strapdown(record.gyro[first:], time, start)


FILTER_OFFSET = 0.5 * RADIAN_PER_DEGREE  # initial uncertainty of the rate offset in the filter, rad/s (as in VQF)
START_S = 1.0  # time over which the reference determines the initial orientation of a recording without rest, s


def track_from_reference(
    record: Record, reference: Reference, motion: MotionSpan, *, shift_s: float
) -> tuple[FloatArray, FloatArray]:
    """Integrate the readings from the first pose. The initial orientation is the mean of q_ref (x) q^-1 over a second."""
    if record.gyro is None:
        raise InputError("validate: the record has no gyroscope. Map its columns.")
    first = int(np.searchsorted(record.time, motion.start_s))
    time, gyro = record.time[first:], record.gyro[first:]
    check_gaps(gyro, time, "validate")
    q = orientation_at(time, integrate_strapdown(gyro, time, np.array([1.0, 0.0, 0.0, 0.0])), reference.time + shift_s)
    start = quaternion_product(reference.q_nb, quaternion_conjugate(q))
    finite: BoolArray = np.asarray(np.isfinite(start).all(axis=1))
    finite &= reference.time < reference.time[int(np.argmax(finite))] + START_S
    return time, integrate_strapdown(gyro, time, _mean_of(start[finite]))


def track_filtered(
    record: Record, reference: Reference, motion: MotionSpan, *, shift_s: float
) -> tuple[FloatArray, FloatArray]:
    """Run the filter over the whole record, and set its heading from the reference before the motion or in its first second."""
    q, _ = filtered(record, np.asarray(record.gyro), FILTER_OFFSET, magnetometer=False)
    q_heading = quaternion_product(
        reference.q_nb, quaternion_conjugate(orientation_at(record.time, q, reference.time + shift_s))
    )
    start_s, stop_s = motion.start_s - shift_s, motion.start_s - shift_s + START_S
    if motion.rested:
        start_s, stop_s = start_s - REST_S, start_s - LEAD_S
    valid = np.isfinite(q_heading).all(axis=1) & (reference.time >= start_s) & (reference.time < stop_s)
    if not valid.any():
        raise AlignmentError(
            f"validate: the reference has no pose from {start_s:.1f} s to {stop_s:.1f} s. The heading requires a pose."
        )
    turn = np.array([1.0, 0.0, 0.0, 1.0]) * _mean_of(q_heading[valid])
    return record.time, quaternion_product(turn / np.linalg.norm(turn), q)


def _mean_pose(reference: Reference, start_s: float, stop_s: float) -> FloatArray:
    valid: BoolArray = reference.valid & (reference.time >= start_s) & (reference.time < stop_s)
    if not valid.any():
        raise AlignmentError(
            f"validate: the reference has no pose at rest from {start_s:.1f} s to {stop_s:.1f} s. The heading requires a pose."
        )
    return _mean_of(reference.q_nb[valid])


def _mean_of(q: FloatArray) -> FloatArray:
    q = (q * np.where(q @ q[0] < 0.0, -1.0, 1.0)[:, None]).mean(axis=0)
    mean: FloatArray = q / np.linalg.norm(q)
    return mean


# ---- Mounting: rotation from device case to the body that the reference tracks

_LEAST_SPREAD = 0.02  # smallest second singular value relative to the largest, for rotation about two axes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    """Rotation from the device's case b to the body m of the reference."""

    rotation: FloatArray  # (3, 3), R_mb, which turns vectors from b to m
    angle: float  # angle of that rotation, rad
    residual_rms: float  # rms residual of the rates after the rotation, per axis, rad/s


def align_rates(record: Record, reference: Reference, *, lag_s: float) -> Alignment:
    """Determine the rotation from the device to the body of the reference from their rates."""
    u, w = common_rates(record, native_poses(reference), lag_s)
    left_vectors, singular, right = np.linalg.svd(w.T @ u)
    if not singular[1] > _LEAST_SPREAD * singular[0]:
        raise AlignmentError(
            "alignment: the rotation is about one axis only. Turn the device about a second axis, or provide the mounting.",
            spread=float(singular[1] / max(singular[0], 1e-300)),
        )
    sign = float(np.sign(np.linalg.det(left_vectors @ right)))
    if sign < 0.0 and singular[2] > 0.2 * singular[1]:
        raise AlignmentError(
            "alignment: the result is a reflection, not a rotation. Check if an axis of the device or of the reference is reversed."
        )
    rotation = left_vectors @ np.diag((1.0, 1.0, sign)) @ right
    cosine = float(np.clip(0.5 * (np.trace(rotation) - 1.0), -1.0, 1.0))
    residual = w - u @ rotation.T
    return Alignment(
        rotation=rotation, angle=float(np.arccos(cosine)), residual_rms=float(np.sqrt((residual**2).mean()))
    )


def align_level(record: Record, reference: Reference, motion: MotionSpan, *, lag_s: float) -> Alignment:
    """Determine the rotation from device to body from their verticals at rest. Rotation about one level axis is sufficient.

    R = R(g, angle) R1, where R1 is the shortest rotation from the mean force f to the vertical g of the body. With the rates u =
    R1 w of the device and v of the body, angle = atan2(sum g . (u x v), sum u . v - (u . g)(v . g)).
    """
    start_s, stop_s = motion.start_s - REST_S, motion.start_s - LEAD_S
    valid = reference.valid & (reference.time >= start_s - lag_s) & (reference.time < stop_s - lag_s)
    rest_mask = (record.time >= start_s) & (record.time < stop_s)
    if not motion.rested or record.accel is None or not valid.any() or not np.isfinite(record.accel[rest_mask]).any():
        raise AlignmentError(
            "alignment: no common vertical at rest before the motion. Start the recording with a rest."
        )
    vertical = rotate(quaternion_conjugate(reference.q_nb[valid]), np.array([0.0, 0.0, 1.0])).mean(axis=0)
    force = np.nanmean(record.accel[rest_mask], axis=0)
    g, f = (x / np.linalg.norm(x) for x in (vertical, force))
    q_level = quaternion_product(quaternion_conjugate(shortest_rotation_up(g)), shortest_rotation_up(f))
    w, v = common_rates(record, native_poses(reference), lag_s)
    u = rotate(q_level, w)
    across, along = float((cross(u, v) @ g).sum()), float((u * v).sum() - ((u @ g) * (v @ g)).sum())
    if math.hypot(across, along) < _LEAST_SPREAD * float((v * v).sum()):
        raise AlignmentError("alignment: no rotation about a level axis. Bend or turn over once.")
    angle = math.atan2(across, along)
    q_body = quaternion_product(quaternion_of(angle * g), q_level)
    residual = v - rotate(q_body, w)
    return Alignment(
        rotation=rotation(q_body).as_matrix(),
        angle=2.0 * math.acos(min(abs(float(q_body[0])), 1.0)),
        residual_rms=float(np.sqrt((residual**2).mean())),
    )


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
        Judged orientation, w-x-y-z.
    reference_q_nb : array, shape (N, 4)
        Reference orientation, w-x-y-z.
    forward, up : str
        Axes of the body that span its sagittal plane, "+x" and the like.

    Returns
    -------
    OrientationError
        In rad.

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


def of_known(summary: Callable[[FloatArray], Any], values: FloatArray) -> float:
    """Return a summary of the finite values, or NaN if there are only gaps."""
    finite = values[np.isfinite(values)]
    return float(summary(finite)) if len(finite) else float("nan")


def rms(values: FloatArray) -> float:
    """Return the root-mean-square of the finite values."""
    return of_known(lambda finite: np.sqrt((finite**2).mean()), values)


def slope(time: FloatArray, values: FloatArray, chosen: BoolArray) -> float:
    """Return the least-squares slope of the chosen values over time."""
    good = chosen & np.isfinite(values)
    if good.sum() < 2:
        return float("nan")
    t = time[good] - time[good].mean()
    return float((t * values[good]).sum() / (t * t).sum())


# ---- Results in degrees.


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """Results of a recording, or their mean or median over recordings."""

    lag_ms: float  # lag of the record relative to the reference, ms
    rmse_total_deg: float  # Root-mean-square error over the motion, deg
    rmse_inclination_deg: float
    rmse_heading_deg: float
    rmse_pitch_deg: float
    # mean signed, standard deviation and largest pitch error over the motion, deg, for samples with defined pitch. In
    # tumbling motion, the largest pitch error can exceed the total error.
    mean_pitch_deg: float
    sd_pitch_deg: float
    max_abs_pitch_deg: float
    # range of motion in pitch minus range in the reference, deg, which is meaningful for less than half a turn
    range_pitch_error_deg: float
    max_total_deg: float  # Largest total error over the motion, deg
    end_total_deg: float  # median error after the motion, deg, or NaN if the recording ends with the motion
    end_inclination_deg: float
    drift_deg_per_min: float  # Slope of the total error over the motion, deg/min
    # root-mean-square total error with the lag and without it, deg (the main results are with one of the two)
    rmse_total_before_lag_deg: float
    rmse_total_after_lag_deg: float
    valid_optics: float  # Share of the motion in which the reference saw the body
    valid_optics_file: float  # Share of all its poses in which the reference saw the body, rests and ends counted
    # Share of the samples of the motion with an error at all in which sensor and reference have a pitch: the vertical
    # is not within 5 deg of the normal of the sagittal plane
    pitch_defined: float
    motion_s: float  # Length of the motion, s
    turn_rate_rms_dps: float  # Root-mean-square body rate in motion, deg/s


def degrees(angle: float) -> float:
    """Return an angle in degrees."""
    return angle / RADIAN_PER_DEGREE


# ---- One trial

OffsetChoice = Literal["none", "rest", "motion"]
Adc = Literal["auto", "none"]
Align = Literal["auto", "level"]


LAG_SETTINGS = LagSettings()
REST_S = 10.0  # rest before the motion that gives tilt and heading
LEAD_S = 0.5  # integration starts so long before the motion
END_S = 3.0  # time after the motion over which the end error is taken
# A lag up to this is the sensor's own and stays in the main figures, as in benchmarks. A longer one comes from clocks or
# filters and is removed. Both root-mean-square totals are reported.
OWN_LAG_S = 0.01


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialSettings:
    """Settings of the comparison of a recording with its reference.

    Parameters
    ----------
    offset : str
        "rest" subtracts the mean rate of the first still phase after correction, as ``correct`` and ``orient`` do; "motion" what
        gravity shows from there on; "none" uses the calibration's offset.
    adc : str
        "auto" gives back what rounding took: as the calibration says, or, without one, as the record's own codes say.
        "none" leaves the codes as they are.
    align : str
        Rotation between device case and the reference's body: "auto" removes it, from rates, if it exceeds ``align_above``.
        "level" always removes it, from gravity at rest and rates about the vertical, or from rates if the recording does not begin
        at rest: for a body whose axes mean nothing, such as a cluster of markers.
    forward, up : str
        Axes of the body that span its sagittal plane.
    mounting : BodyMounting or None
        How the device is worn: its readings are turned to the segment's axes before they are compared.
    power_on_s : float or None
        Time since power-on at the first sample, s; None where it is not known: then no warm-up is subtracted.
    policy : str
        Temperatures outside a tuning table: "raise", "hold" its end, or "nan", as ``correct`` has it.
    lag : LagSettings
        Of the lag search.
    align_above : float
        Rotation above which "auto" removes it, rad.
    prior : ErrorPrior
        What the error to expect of a calibration takes from other recordings and devices.
    method : str
        "strapdown", or "vqf": a filter with accelerometers over the whole record, offline; it states no error to expect.
    """

    offset: OffsetChoice = "none"
    adc: Adc = "auto"
    align: Align = "auto"
    forward: Face = "+x"
    up: Face = "+z"
    mounting: BodyMounting | None = None
    power_on_s: float | None = None
    policy: Policy = "raise"
    lag: LagSettings = LAG_SETTINGS
    align_above: float = 5.0 * RADIAN_PER_DEGREE
    prior: ErrorPrior = ERROR_PRIOR
    method: Literal["strapdown", "vqf"] = "strapdown"

    def __post_init__(self) -> None:
        check_choices(self, "validate")


TRIAL_SETTINGS = TrialSettings()


def rows_of(figures: Figures) -> dict[str, str]:
    """Return the errors that a notebook shows, deg."""
    names = ("total", "inclination", "heading", "pitch")
    return {f"{name}, rms": f"{getattr(figures, f'rmse_{name}_deg'):.2f} deg" for name in names}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mounting:
    """Mounting of the device on the body of the reference."""

    alignment: Alignment  # rotation from device case to body
    applied: bool  # True if the readings were rotated with it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial(Shown):
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
    motion : MotionSpan
        On the record's clock.
    mounting : Mounting or None
        Rotation between device case and the reference's body; None where it was not looked for.
    mean_inclination : tuple of float
        Mean angle of the body's z axis from the vertical over the motion, sensor and reference, rad: what agreement
        over trials is taken on.
    findings : tuple of Finding
        What was done or met that a reader may not expect.
    time : array, shape (N,)
        s, reference clock, the samples of the series below.
    error : OrientationError
        Total, heading, inclination and pitch error, rad, shape (N,) each; NaN where the reference saw nothing.
    sensor_pitch, reference_pitch : array, shape (N,)
        Sagittal pitch, rad.
    moving : array, shape (N,)
        1 within the motion.
    expected : Expected or None
        Errors to expect by the calibration's uncertainty; None without a calibration of the gyroscopes.
    rest : RestOffset, MotionOffset or None
        What was subtracted of the offset, left at the first still phase or shown by the motion.
    """

    recording: str
    figures: Figures
    lag: Lag
    lag_undone: bool
    motion: MotionSpan
    mounting: Mounting | None
    mean_inclination: tuple[float, float]
    findings: tuple[Finding, ...]
    time: FloatArray
    error: OrientationError
    sensor_pitch: FloatArray
    reference_pitch: FloatArray
    moving: FloatArray
    expected: Expected | None = None
    rest: OffsetLeft | None = None

    def __post_init__(self) -> None:
        n = len(self.time)
        for name in ("time", "sensor_pitch", "reference_pitch", "moving"):
            object.__setattr__(self, name, frozen(getattr(self, name), (n,), f"Trial.{name}"))

    def _rows(self) -> dict[str, str]:
        return {"recording": self.recording} | rows_of(self.figures)


def validate_trial(
    record: Record,
    reference: Reference,
    *,
    calibration: Calibration | None = None,
    settings: TrialSettings = TRIAL_SETTINGS,
    name: str = "",
    source: OffsetSource | None = None,
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
    source : OffsetSource or None
        Where the calibration's offset comes from, for the error to expect; None reads it off the settings and the model.

    Returns
    -------
    Trial
        Figures in degrees, and the error sample by sample.

    Raises
    ------
    InputError
        No gyroscope, gaps in the rate, or a unit that nothing turns into rad/s.
    AlignmentError
        No common motion, or no pose in the rest before it.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    >>> trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    >>> found = undrift.validate_trial(trial.record, trial.reference, calibration=calibration)
    >>> bool(found.figures.max_abs_pitch_deg < 0.5)
    True
    """
    done, findings = _corrected(record, calibration, settings)
    gaps, poses = _gaps(done), native_poses(reference)
    done, lag, clock_findings = _in_step(done, poses, gaps, settings)
    poses, reference = (seen_poses(done, ref, lag) for ref in (poses, reference))
    findings += (*clock_findings, *check_reference(_worn(done, settings), poses, lag.seconds))
    motion = find_motion(done, reference, lag_s=lag.seconds)
    done, rest_offset, offset_findings = _re_zeroed(
        done, motion, settings, None if calibration is None else calibration.gyro
    )
    done, mounting = _aligned(_worn(done, settings), poses, (lag, motion), settings)
    shift_s = lag.seconds - 0.5 / done.sample_rate_hz  # strapdown uses each reading for the step before its time stamp
    track, start_findings = _track(done, (reference, poses), motion, shift_s, settings)
    undone = max(abs(lag.seconds), abs(shift_s)) > OWN_LAG_S
    axes: dict[str, Face] = {"forward": settings.forward, "up": settings.up}
    tracks = [orientation_at(*track, reference.time + shift) for shift in (0.0, shift_s)]
    errors = [compare_orientations(q, reference.q_nb, **axes) for q in tracks]
    error, sensor = errors[undone], tracks[undone]
    moving, after = _stretches(reference, motion, lag.seconds * undone)
    pitches = sagittal_pitch(sensor, **axes), sagittal_pitch(reference.q_nb, **axes)
    findings += _pitch_axes(sensor, reference.time < motion.start_s - lag.seconds * undone, settings)
    rates = np.asarray(done.between(motion.start_s, motion.stop_s).gyro)
    both = moving & np.isfinite(error.total)
    figures = Figures(
        lag_ms=lag.seconds * 1e3,
        **_in_degrees(errors, undone, pitches, reference.time, (moving, after)),
        valid_optics=float(reference.valid[moving].mean()) if moving.any() else 0.0,
        valid_optics_file=float(reference.valid.mean()),
        pitch_defined=float(np.isfinite(error.pitch[moving]).sum() / both.sum()) if both.any() else float("nan"),
        motion_s=motion.stop_s - motion.start_s,
        turn_rate_rms_dps=degrees(float(np.sqrt(np.nanmean((rates**2).sum(axis=1))))),
    )
    judged = Trial(
        recording=name or reference.name,
        figures=figures,
        lag=lag,
        lag_undone=undone,
        motion=motion,
        mounting=mounting,
        mean_inclination=_mean_inclinations(sensor[both], reference.q_nb[both]),
        findings=(*findings, *start_findings, *offset_findings),
        time=reference.time,
        error=error,
        sensor_pitch=pitches[0],
        reference_pitch=pitches[1],
        moving=moving.astype(float),
        rest=rest_offset,
    )
    late = shift_s * (not undone)
    return replace(judged, expected=_expected(judged, done, track, late, calibration, settings, source))


def check_scale(trial: Trial) -> None:
    """Raise InputError if a device has over twice or under half the rate of its reference, for example in a wrong unit."""
    times = 1.0 / float(np.linalg.norm(trial.lag.matrix, ord=2))  # the matrix maps readings to the reference's rate
    if not 0.5 < times < 2.0:
        raise InputError(
            f"{trial.recording}: the rates are {times:.3g} times the rates of the reference. Check the unit and the scale of the "
            "gyroscope."
        )


def _track(
    record: Record, references: tuple[Reference, Reference], motion: MotionSpan, shift_s: float, settings: TrialSettings
) -> tuple[tuple[FloatArray, FloatArray], tuple[Finding, ...]]:
    """Return time and orientation from the rest or, without a rest, from the poses, and a finding in the latter case."""
    reference, poses = references
    if settings.method == "vqf":
        track = track_filtered(record, reference, motion, shift_s=shift_s)
    elif motion.rested:
        track = track_from_rest(record, reference, motion, shift_s=shift_s)
    else:
        track = track_from_reference(record, poses, motion, shift_s=shift_s)
    if motion.rested:
        return track, ()
    what = f"orientation starts at {float(track[0][0]):.1f} s from the reference, over {START_S:g} s, and end errors are from the "
    return track, (finding("validate.no_rest", "info", what=what + "last seconds of the motion"),)


def _mean_inclinations(sensor: FloatArray, reference: FloatArray) -> tuple[float, float]:
    return of_known(np.mean, inclination_of(sensor)), of_known(np.mean, inclination_of(reference))


def _pitch_axes(sensor: FloatArray, before: BoolArray, settings: TrialSettings) -> tuple[Finding, ...]:
    """Return a finding if the axes of the pitch do not agree with the rest before the motion."""
    rest = before & np.isfinite(sensor).all(axis=1)
    axis_findings = check_pitch_axes(sensor, rest, settings.forward, settings.up) if rest.any() else ()
    return tuple(warning for warning in axis_findings if warning.level == "warn")


_KINDS: dict[OffsetChoice, OffsetKind] = {"none": "other", "rest": "subtracted", "motion": "shown"}


def _expected(
    judged: Trial,
    done: Record,
    track: tuple[FloatArray, FloatArray],
    delay_s: float,
    calibration: Calibration | None,
    settings: TrialSettings,
    source: OffsetSource | None,
) -> Expected | None:
    """Return the expected errors of a corrected recording, or None without a covariance of the gyroscopes."""
    model = None if calibration is None else calibration.gyro
    if calibration is None or model is None or settings.method == "vqf" or not model.covariance[:9, :9].any():
        return None
    if source is None:
        fitted_in_motion = (model.method in IN_MOTION and judged.rest is None) or model.moving_offset is not None
        source = OffsetSource(rest=_KINDS[settings.offset if judged.rest else "none"], in_motion=fitted_in_motion)
    mounting, subtracted = judged.mounting, judged.rest
    before: tuple[float, float] | None = (float(done.time[0]), judged.motion.start_s - LEAD_S)
    stretch = before if subtracted is None and judged.motion.rested else subtracted and subtracted.rest_s
    rest = done.between(*stretch) if stretch else None
    still = np.empty((0, 3)) if rest is None else np.asarray(rest.gyro)
    still = still[np.isfinite(still).all(axis=1)]
    variance = np.array([mean_variance(axis) for axis in still.T]) if len(still) > 1 else np.zeros(3)
    applied = np.eye(3) if mounting is None or not mounting.applied else mounting.alignment.rotation
    applied = applied if settings.mounting is None else applied @ settings.mounting.matrix
    offset_covariance, offset_prior = np.diag(variance), np.zeros(3)
    if subtracted is not None and not isinstance(subtracted, RestOffset):
        offset_covariance = applied @ subtracted.covariance.mean(axis=0) @ applied.T
        offset_prior = np.sqrt(np.diag(applied @ np.diag(subtracted.prior**2) @ applied.T))
    left_in = 0.0 if mounting is None or mounting.applied else mounting.alignment.angle
    course = Strapdown(
        record=done.part(len(done) - len(track[0]), len(done)),
        q_nb=track[1],
        stop_s=judged.motion.stop_s,
        delay_s=delay_s,
        turned=applied,
        offset_covariance=offset_covariance,
        offset_prior=offset_prior,
        noise_density=0.0 if rest is None else float(np.sqrt(variance.mean() * rest.duration_s)),
        tilt=_start_uncertainty(rest if judged.motion.rested else None, calibration, settings),
        mounting=left_in / np.sqrt(3.0),
    )
    return expected_errors(course, model, source, settings.prior)


def _start_uncertainty(rest: Record | None, calibration: Calibration, settings: TrialSettings) -> float:
    """Return the standard uncertainty of the tilt before the motion against the reference, each level axis, rad."""
    if rest is None or rest.accel is None:
        return settings.prior.pose
    if calibration.accel is None or np.isnan(rest.accel).any():
        return settings.prior.tilt
    parts = dict(initial_tilt(rest, Still(start=0, stop=len(rest))).parts)
    # recordings that a calibration is judged by share its temperature and time
    start_error = math.hypot(parts["scatter"], parts.get("calibration", 0.0))
    return math.hypot(start_error / math.sqrt(2.0), settings.prior.pose)


def _in_step(
    record: Record, poses: Reference, gaps: BoolArray, settings: TrialSettings
) -> tuple[Record, Lag, list[Finding]]:
    try:
        return in_step(record, poses, settings.lag)
    except AlignmentError as unmatched:
        if gaps.any():
            raise AlignmentError(f"{unmatched}; {gaps.mean():.0%} of the samples are gaps (NaN)") from unmatched
        raise


def _stretches(reference: Reference, motion: MotionSpan, lag_s: float) -> tuple[BoolArray, BoolArray]:
    """Return which poses are within the motion, pauses left out where the reference marks them, and which just after it."""
    start_s, stop_s = motion.start_s - lag_s, motion.stop_s - lag_s
    moving = (reference.time >= start_s) & (reference.time < stop_s)
    if reference.moving is not None and (reference.moving > 0.0).any():
        moving = reference.moving > 0.0
    after = (reference.time >= stop_s) & (reference.time < stop_s + END_S)
    return moving, after if motion.rested else moving & (reference.time >= stop_s - END_S)


def _in_degrees(
    errors: list[OrientationError],
    undone: bool,
    pitches: tuple[FloatArray, FloatArray],
    time: FloatArray,
    stretches: tuple[BoolArray, BoolArray],
) -> dict[str, float]:
    """Return the errors over the motion and after it, with or without the lag. `pitches` are of sensor and reference, rad."""
    error, (moving, after) = errors[undone], stretches
    total, pitch = error.total[moving], error.pitch[moving]
    both = moving & np.isfinite(pitches[0]) & np.isfinite(pitches[1])
    ranges = [of_known(np.ptp, angles_of_one[both]) for angles_of_one in pitches]
    angles = {
        "rmse_total_deg": rms(total),
        "rmse_inclination_deg": rms(error.inclination[moving]),
        "rmse_heading_deg": rms(error.heading[moving]),
        "rmse_pitch_deg": rms(pitch),
        "mean_pitch_deg": of_known(np.mean, pitch),
        "sd_pitch_deg": of_known(np.std, pitch),
        "max_abs_pitch_deg": of_known(np.max, np.abs(pitch)),
        "range_pitch_error_deg": ranges[0] - ranges[1],
        "max_total_deg": of_known(np.max, total),
        "end_total_deg": of_known(np.median, error.total[after]),
        "end_inclination_deg": of_known(np.median, error.inclination[after]),
        "drift_deg_per_min": 60.0 * slope(time, error.total, moving),
        "rmse_total_before_lag_deg": rms(errors[0].total[moving]),
        "rmse_total_after_lag_deg": rms(errors[1].total[moving]),
    }
    return {name: degrees(angle) for name, angle in angles.items()}


def check_poses(record: Record, reference: Reference, settings: TrialSettings = TrialSettings()) -> tuple[Finding, ...]:
    """Return findings on the convention of a reference for an unaligned record, or raise an error if it is clearly wrong."""
    if not (is_physical(record.gyro_unit) and is_physical(record.accel_unit)):
        return ()
    done, poses = record.in_si(), native_poses(reference)
    done, lag, _ = _in_step(done, poses, _gaps(done), settings)
    return check_reference(done, poses, lag.seconds)


def _gaps(record: Record) -> BoolArray:
    """Return True for samples with a missing channel. Raise InputError if all rates are missing."""
    missing = [~np.isfinite(values).all(axis=1) for values in (record.gyro, record.accel) if values is not None]
    if record.gyro is not None and missing[0].all():
        check_gaps(record.gyro, record.time, "validate")
    return np.asarray(np.any(missing, axis=0))


def _corrected(
    record: Record, calibration: Calibration | None, settings: TrialSettings
) -> tuple[Record, tuple[Finding, ...]]:
    original, record = record, unpadded(record)
    padded = padding(original, record)
    if calibration is None:
        adc = device_adc([record]) if settings.adc == "auto" and record.state == "raw" else None
        if adc is None:
            return record.in_si(), (*padded, *check_triads(record))
        done = correct_whole(record, nominal_calibration(record, adc))
        return done.record, (*padded, *check_triads(record))
    if settings.adc == "none":
        gyro = calibration.gyro
        calibration = replace(calibration, adc=None, gyro=None if gyro is None else replace(gyro, code_offset=None))
    done = correct_checked(record, calibration, policy=settings.policy, power_on_s=settings.power_on_s)
    return done.record.in_si(), (*padded, *done.findings)


def nominal_calibration(record: Record, adc: AdcModel | None) -> Calibration:
    """Return the nominal calibration of a device with the unit of its readings, including the rounding of its codes."""
    return Calibration(
        device=record.device,
        reference_temp_c=float("nan"),
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=None if record.gyro is None else nominal_triad(record.gyro_unit, "rate"),
        accel=None if record.accel is None else nominal_triad(record.accel_unit, "accel"),
        adc=adc,
    )


def _re_zeroed(
    record: Record, motion: MotionSpan, settings: TrialSettings, model: TriadModel | None
) -> tuple[Record, OffsetLeft | None, tuple[Finding, ...]]:
    """Subtract the remaining offset of the first still phase, or of the rest before the motion if there is no still phase."""
    if settings.offset == "none":
        return record, None, ()
    offset_findings, rest = tuple[Finding, ...](), None
    try:
        rest = find_rest_offset(record)
    except InputError:
        if motion.rested:
            rest = find_rest_offset(record, (float(record.time[0]), motion.start_s - LEAD_S))
            what = f"the mean rate from {rest.start_s:.1f} to {rest.stop_s:.1f} s, which is not still, was subtracted, but "
            what += "correct and orient do not accept the offset rest here"
            offset_findings = (finding("validate.no_rest", "warn", what=what),)
        elif settings.offset == "rest":
            what = "the offset of the gyroscopes is not removed, but it can be determined from motion"
            return record, None, (finding("validate.no_rest", "warn", what=what),)
    remainder = offset_left(record, settings.offset, rest, model)
    return replace(record, gyro=np.asarray(record.gyro) - remainder.at(record.time)), remainder, offset_findings


def _aligned(
    record: Record, poses: Reference, lag_and_motion: tuple[Lag, MotionSpan], settings: TrialSettings
) -> tuple[Record, Mounting | None]:
    lag, motion = lag_and_motion
    if settings.align == "level":
        with suppress(AlignmentError):
            alignment = align_level(record, poses, motion, lag_s=lag.seconds)
            return _turned(record, alignment.rotation), Mounting(alignment=alignment, applied=True)
    try:
        alignment = align_rates(record, poses, lag_s=lag.seconds)
    except AlignmentError:
        return record, None  # rotation about one axis cannot determine the mounting, so the mounting is unchanged
    if settings.align == "auto" and alignment.angle <= settings.align_above:
        return record, Mounting(alignment=alignment, applied=False)
    return _turned(record, alignment.rotation), Mounting(alignment=alignment, applied=True)


def _worn(record: Record, settings: TrialSettings) -> Record:
    return record if settings.mounting is None else _turned(record, settings.mounting.matrix)


def _turned(record: Record, rotation: FloatArray) -> Record:
    gyro, accel = (x if x is None else x @ rotation.T for x in (record.gyro, record.accel))
    return replace(record, gyro=gyro, accel=accel)
