"""Orientation q_nb of the device case: initial tilt at rest, strapdown from there, and the angles of the result.

The specific force f in b points up at rest. Without a rest, correction/motion.py determines its vertical part in motion. The
shortest rotation that turns f to the z axis of n is, for f of length one::

    q_nb ~ (1 + f_z, f_y, -f_x, 0)

To first order, its error is the horizontal part of the error of f over |f|, with the sources in correction/rest.py. It has two
components. 95 % of errors are therefore within a circle of 1.73 (equal components) to 1.96 (one component) standard uncertainties.
Strapdown (frames.py) starts from this orientation. Angles of q_nb = (w, x, y, z)::

    inclination = 2 acos sqrt(w^2 + z^2)         angle of the body's z axis from the vertical
    heading     = 2 atan(z / w)                  turn about the vertical
    pitch       = atan2(-u . forward, u . up)    vertical u seen in b, forward lean is positive

The pitch has no singularity until the vertical leaves the sagittal plane, where it is a gap (NaN).

Strapdown drifts by the uncertainty of the offset times the time since the rest. A filter (VQF [1]_) computes the inclination from
the accelerometers and tracks the offset, with this uncertainty as the prior. Its heading is 0 at the rest (6D), or is relative to
magnetic east with a magnetometer (9D).

.. [1] D. Laidig, T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic disturbance
   rejection", Information Fusion 91, 187-204, 2023, and the package ``vqf``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, Shape, bridged, freeze, runs
from undrift.calibration.triads import check_triads
from undrift.correction.rest import (
    FEWEST,
    IN_MOTION,
    LEAST_IN_MOTION_S,
    force_covariances,
    mean_variance,
    moved_by,
    rest_offset,
    rests_from_first,
)
from undrift.errors import InputError, check_choices, check_type
from undrift.findings import Finding, finding, two_digits
from undrift.frames import integrate_strapdown, quaternion_conjugate, quaternion_product, rotate, rotation
from undrift.io.dataframes import orientation_frame
from undrift.kernels.attitude import filtered_attitude
from undrift.model import AXES, BodyMounting, TriadModel
from undrift.record import FACES, Face, Record, Still
from undrift.segments import unpadded
from undrift.shown import Shown
from undrift.sync import padding
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, si_factor

if TYPE_CHECKING:
    import pandas as pd
    from scipy.spatial.transform import Rotation

# ---- Initial tilt

GRAVITY_WITHIN = 0.2  # relative to standard gravity (otherwise, the readings are not specific force at rest in m/s2)
NOT_CALIBRATED = "scatter only, without the unknown uncertainty of the accelerometer, typically 0.3 deg"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tilt:
    """Orientation at rest."""

    q_nb: Annotated[FloatArray, Shape(4)]  # b to n, w-x-y-z
    specific_force: Annotated[FloatArray, Shape(3)]  # mean over the still phase, m/s2, frame b
    inclination_uncertainty: float  # standard uncertainty of the direction of gravity, both level axes together, rad
    expanded_uncertainty: float  # 95 % quantile of the error of the direction, rad
    parts: tuple[tuple[str, float], ...]  # share of each source, rad, with a sum of squares equal to the total
    basis: str  # "calibration", or the reason why the share of the accelerometers is missing

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def statement(self) -> str:
        """Return the uncertainty of the tilt as text."""
        total_deg, most = (
            angle / RADIAN_PER_DEGREE for angle in (self.inclination_uncertainty, self.expanded_uncertainty)
        )
        if self.basis != "calibration":
            return f"{self.basis} (scatter {total_deg:.2g} deg)"
        shares = ", ".join(f"{name} {sigma / RADIAN_PER_DEGREE:.2g}" for name, sigma in self.parts)
        return f"standard uncertainty {total_deg:.2g} deg, 95 % within {most:.2g} deg (in deg: {shares})"


def initial_tilt(record: Record, still: Still) -> Tilt:
    """Determine the orientation of a device at rest, with heading 0."""
    if record.accel is None:
        raise InputError("tilt: no accelerometer readings. Map the accelerometer columns.")
    force: FloatArray = record.accel[still.start : still.stop] * si_factor(record.accel_unit, "accel")
    if len(force) < FEWEST:
        raise InputError(
            f"tilt: expected {FEWEST} samples at rest or more, got {len(force)}. Give a longer still phase."
        )
    if np.isnan(force).any():
        raise InputError("tilt: the still phase has gaps (NaN). Choose another still phase.")
    mean = force.mean(axis=0)
    length = float(np.linalg.norm(mean))
    if abs(length / STANDARD_GRAVITY - 1.0) > GRAVITY_WITHIN:
        raise InputError(
            f"tilt: expected a mean specific force within {GRAVITY_WITHIN:.0%} of gravity, got {length:.3g} m/s2. "
            "Check the unit of the accelerometer, the mapping of its axes, and that the device was still.",
            length=length,
        )
    return _compute_tilt(record, mean, force_covariances(record, still, force))


def _compute_tilt(record: Record, mean: FloatArray, covariances: dict[str, FloatArray]) -> Tilt:
    """Return the tilt from a specific force (3,), with its covariances (3, 3) by source."""
    from scipy.special import chdtri

    length = float(np.linalg.norm(mean))
    level = (np.eye(3) - np.outer(mean, mean) / length**2) / length
    parts = {name: level @ covariance @ level for name, covariance in covariances.items()}
    total = np.sum([*parts.values()], axis=0)
    variance = float(np.trace(total))
    # 1: errors in one component, 2: equal errors in both
    freedom = max(variance**2 / max(float((total**2).sum()), 1e-300), 1.0)
    return Tilt(
        q_nb=shortest_rotation_up(mean),
        specific_force=mean,
        inclination_uncertainty=math.sqrt(variance),
        expanded_uncertainty=math.sqrt(variance * float(chdtri(freedom, 0.05)) / freedom),
        parts=tuple((name, math.sqrt(np.trace(share))) for name, share in parts.items()),
        basis=NOT_CALIBRATED if record.accel_uncertainty is None else "calibration",
    )


def shortest_rotation_up(force: FloatArray) -> FloatArray:
    """Return the shortest rotation (4,) that turns a vector (3,) to the z axis of n."""
    x, y, z = force / np.linalg.norm(force)
    level = math.hypot(x, y)
    if z > -0.5:
        q = np.array([1.0 + z, y, -x, 0.0])
    elif level > 0.0:  # near half a turn, 1 + z cancels: multiply by (1 - z) / level, which keeps the direction
        q = np.array([level, y / level * (1.0 - z), -x / level * (1.0 - z), 0.0])
    else:
        q = np.array([0.0, 1.0, 0.0, 0.0])
    return np.asarray(q / np.linalg.norm(q))


# ---- Strapdown


def check_gaps(gyro_b: FloatArray, time: FloatArray, what: str) -> None:
    """Raise for a rate (N, 3) with gaps, because the orientation after a gap is unknown."""
    gap = np.asarray(~np.isfinite(gyro_b).all(axis=1))
    if gap.any():
        start, stop = runs(gap)[0]
        raise InputError(
            f"{what}: expected a rate at every sample, got a gap (NaN) at {int(gap.sum())} of {len(gap)}, the first stretch from "
            f"{time[start]:.6g} to {time[stop - 1]:.6g} s. After a gap the orientation is unknown. Correct without gaps (policy "
            "hold, temperatures filled in), or orient each stretch between gaps from its own rest.",
            gaps=int(gap.sum()),
        )


# ---- Angles

IN_PLANE = np.sin(np.radians(5.0))  # smallest component of the vertical in the sagittal plane


def inclination_of(q_nb: FloatArray) -> FloatArray:
    """Return the angle between the body's z and the vertical, rad."""
    w, x, y, z = np.moveaxis(q_nb, -1, 0)
    # The arc cosine loses half of its digits near zero.
    return np.asarray(2.0 * np.arctan2(np.hypot(x, y), np.hypot(w, z)))


def heading_of(q_nb: FloatArray) -> FloatArray:
    """Return the turn about the vertical, rad."""
    w, _, _, z = np.moveaxis(q_nb, -1, 0)
    flip = np.where(w < 0.0, -1.0, 1.0)  # q and -q are the same orientation
    return np.asarray(2.0 * np.arctan2(flip * z, flip * w))


def sagittal_pitch(q_nb: FloatArray, *, forward: Face = "+x", up: Face = "+z") -> FloatArray:
    """Return the direction of gravity in the segment's sagittal plane, rad, positive for forward lean."""
    if forward not in FACES or up not in FACES or forward[1] == up[1]:
        raise InputError(
            f"pitch: expected two different axes of {', '.join(FACES)}, got forward {forward} and up {up}. Give the axes that "
            f"point forward and up."
        )
    vertical = rotate(quaternion_conjugate(q_nb), np.array([0.0, 0.0, 1.0]))
    forward_part, upward = (
        vertical[..., AXES.index(face[1])] * (1.0 if face[0] == "+" else -1.0) for face in (forward, up)
    )
    return np.where(np.hypot(forward_part, upward) > IN_PLANE, np.arctan2(-forward_part, upward), np.nan)


FAR_UP_DEG = 60.0  # angle between the axis for up and the vertical at rest above which the device is worn differently


def check_pitch_axes(q_nb: FloatArray, rest: slice | BoolArray | None, forward: Face, up: Face) -> tuple[Finding, ...]:
    """Return a finding if the axis for up is far from the vertical at rest, or on average without a rest.

    The finding names the axis nearest to the vertical, and for forward the axis along which the vertical leans most.
    """
    vertical = rotate(quaternion_conjugate(q_nb), np.array([0.0, 0.0, 1.0]))
    mean = np.nanmean(vertical if rest is None else vertical[rest], axis=0)
    cosine = mean[AXES.index(up[1])] / np.linalg.norm(mean) * (1.0 if up[0] == "+" else -1.0)
    off_deg = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    if off_deg < FAR_UP_DEG:
        return ()
    k, leans = int(np.abs(mean).argmax()), np.nanstd(vertical, axis=0)
    axis = max((axis for axis in AXES if axis != AXES[k]), key=lambda axis: leans[AXES.index(axis)])
    upward, when = FACES[2 * k + int(mean[k] < 0.0)], "on average" if rest is None else "at rest"
    return (
        finding(
            "orient.pitch_axes",
            "warn",
            f"Pitch from forward {forward} and up {up} does not match an upright segment: {when} the axis for up is "
            f"{off_deg:.0f} deg from the vertical.",
            f"Use {upward} for `up`, and +{axis} or -{axis} for `forward`, so that the pitch is positive when the segment "
            "leans forward.",
            up=upward,
            forward=axis,
        ),
    )


# ---- A whole record

NORMAL_95 = 1.96  # 95 % of normal errors lie within 1.96 standard uncertainties
LONGEST_HOLE_S = 0.1  # time in which a person turns by 10 deg, s
# During a rest, a standing person sways by 1 deg/s rms and by 0.5 deg from its first third to its last
MOVING_RATE, TURNED = 5.0 * RADIAN_PER_DEGREE, 1.5 * RADIAN_PER_DEGREE
WARN_DRIFT = 1.0 * RADIAN_PER_DEGREE  # strapdown drift that optics can measure in a trial of two minutes


@dataclass(frozen=True, slots=True, kw_only=True)
class OrientSettings:
    """Settings of the orientation of a record."""

    # "rest" subtracts the mean rate of the still phase, including any true slow turn. "motion" also subtracts the offset that
    # gravity determines in motion, starting from that rest
    offset: Literal["none", "rest", "motion"] = "none"
    method: Literal["strapdown", "vqf"] = "strapdown"  # vqf: filter with accelerometers over the whole record
    # the filter also uses the magnetic field, and the axes of n are magnetic east, magnetic north and up
    magnetometer: bool = False
    # axes of the device that point forward and up on an upright segment, and define the pitch
    forward: Face = "+x"
    up: Face = "+z"
    # mounting of the device on the body: orientation, angles and the axes above then refer to the segment
    mounting: BodyMounting | None = None

    def __post_init__(self) -> None:
        check_choices(self, "orient")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Orientation(Shown):
    """Orientation of the device case over time."""

    time: Annotated[FloatArray, Shape("n")]  # time on the record's clock, s
    q_nb: Annotated[FloatArray, Shape("n", 4)]  # b to n, w-x-y-z
    inclination: Annotated[FloatArray, Shape("n")]  # angle of the body's z from the vertical, rad
    heading: Annotated[FloatArray, Shape("n")]  # turn about the vertical, rad
    pitch: Annotated[FloatArray, Shape("n")]  # direction of gravity in the sagittal plane, forward lean positive, rad
    tilt: Tilt  # tilt at the still phase or, without a still phase, at the first sample
    still: Still | None  # still phase of the initial tilt, or None if the device never rests
    offset: Annotated[FloatArray, Shape(3)]  # rate that was subtracted at that phase, rad/s
    offset_uncertainty: float  # standard uncertainty of the offset, all axes together, rad/s
    # 95 % limit of the pitch error, rad. None for a filter, or if the uncertainty of the accelerometers is unknown.
    pitch_limit: Annotated[FloatArray | None, Shape("n")] = None
    findings: tuple[Finding, ...] = ()  # findings about expected strapdown drift and unsuitable axes of the pitch

    def __post_init__(self) -> None:
        freeze(self)

    def facts(self) -> dict[str, str]:
        """Return the rows of the table of values: name, and value with unit."""
        angles = (("inclination", self.inclination), ("pitch", self.pitch), ("heading", self.heading))
        spans = {
            name: f"{np.nanmin(angle) / RADIAN_PER_DEGREE:.1f} to {np.nanmax(angle) / RADIAN_PER_DEGREE:.1f} deg"
            for name, angle in angles
        }
        findings = {item.code: item.sentence for item in self.findings}
        return {"samples": str(len(self.time))} | spans | {"tilt": self.tilt.statement} | findings

    @property
    def rotation(self) -> "Rotation":
        """Return the orientation as a scipy Rotation of length N, from body to level frame."""
        return rotation(self.q_nb)

    def to_frame(self) -> "pd.DataFrame":
        """Return the orientation as a pandas DataFrame: time_s, q_w to q_z, and the angles in deg, as `orient` writes them."""
        return orientation_frame(self.time, self.q_nb, (self.inclination, self.heading, self.pitch))


def orient(
    record: Record,
    still: Still | None = None,
    settings: OrientSettings = OrientSettings(),
    *,
    gyro_model: TriadModel | None = None,
) -> Orientation:
    """Determine the orientation of the device at every sample.

    Parameters
    ----------
    record : Record
        Rate and specific force in physical units. For a corrected record, the uncertainty of the tilt includes the calibration.
    still : Still, optional
        A still phase, by default the first detected phase. Without a still phase, gravity in motion determines tilt and offset.
    settings : OrientSettings
        Method, offset and axes.
    gyro_model : TriadModel, optional
        Model of the gyroscopes. Its covariance is then included in the uncertainty of the offset.

    Raises
    ------
    InputError
        There is no gyroscope, no still phase (in less than 20 s, or for the offset "rest"), or there are gaps, holes in time, a
        dead axis or counts.
    Implausible
        Columns, units or the sample rate clearly differ from their declaration.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    >>> trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    >>> orientation = undrift.orient(undrift.correct(trial.record, calibration))
    >>> orientation.q_nb.shape == (len(trial.record), 4)
    True
    """
    check_type(record, Record, "orient: `record`", "Read a file with read_record.")
    check_type(settings, OrientSettings, "orient: `settings`", "Write OrientSettings(...).")
    disagreements, full_record = check_triads(record), record.in_si()
    check_whole(full_record)
    _check_field(full_record, settings)
    record = unpadded(full_record)
    findings, rates = (*disagreements, *padding(full_record, record)), np.asarray(record.gyro)
    if still is not None:
        first = int(full_record.time.searchsorted(record.time[0]))
        still = replace(still, start=max(still.start - first, 0), stop=min(max(still.stop - first, 1), len(record)))
    rests = _rests(record, still, settings.offset)
    still = rests[0] if rests else None
    anchor = 0 if still is None else still.stop - 1
    offsets: FloatArray = np.zeros((len(record), 3))
    if settings.offset == "motion" or still is None:
        from undrift.correction.motion import fit_motion  # imports scipy and a kernel

        motion = fit_motion(record, None if still is None else rest_offset(record, still), gyro_model)
        uncertainty = math.hypot(motion.offset.uncertainty, float(np.linalg.norm(motion.offset.mean)))
    if settings.offset == "motion":
        offsets, uncertainty = motion.offset.at(record.time), motion.offset.uncertainty
        findings += motion.offset.findings
    elif still is not None:
        if settings.offset == "rest":
            offsets += rates[still.start : still.stop].mean(axis=0)
        uncertainty = _offset_uncertainty(record, rests, offsets, gyro_model)
    if still is None:
        tilt = _compute_tilt(record, motion.vertical, {"motion": motion.vertical_covariance})
    else:
        tilt = initial_tilt(record, still)
    gyro = rates - offsets
    if settings.method == "vqf":
        q, field_findings = filtered(record, gyro, uncertainty, magnetometer=settings.magnetometer)
        q, findings = q if field_findings else _level_at(q, anchor, tilt.q_nb), findings + field_findings
    else:
        q = _both_ways(gyro, record.time, tilt.q_nb, anchor)
        findings += (_expected_drift(record, anchor, uncertainty, settings.offset, rested=still is not None),)
    if settings.mounting is not None:
        q = _segment_orientation(q, settings.mounting, anchor, magnetometer=settings.magnetometer)
    rest = None if still is None else slice(still.start, still.stop)
    findings += () if still is None else _check_rest(record, still)
    findings += check_pitch_axes(q, rest, settings.forward, settings.up)
    pitch, limit = sagittal_pitch(q, forward=settings.forward, up=settings.up), None
    if settings.method == "strapdown" and tilt.basis == "calibration":
        scale_uncertainty = 0.0 if gyro_model is None else gyro_model.relative_uncertainty
        limit = _pitch_limit(
            record.time - record.time[anchor], pitch - pitch[anchor], tilt, uncertainty, scale_uncertainty
        )
    return Orientation(
        time=record.time,
        q_nb=q,
        inclination=inclination_of(q),
        heading=heading_of(q),
        pitch=pitch,
        tilt=tilt,
        still=still,
        offset=offsets[anchor],
        offset_uncertainty=uncertainty,
        pitch_limit=limit,
        findings=findings,
    )


def _pitch_limit(
    time_s: FloatArray, pitch: FloatArray, tilt: Tilt, offset_uncertainty: float, scale_uncertainty: float
) -> FloatArray:
    """Return the 95 % limit of the pitch error over the time since the rest (N,): tilt, offset and scale factor, rad."""
    parts = (
        tilt.expanded_uncertainty,
        NORMAL_95 * offset_uncertainty * np.abs(time_s),
        NORMAL_95 * scale_uncertainty * pitch,
    )
    limit: FloatArray = np.sqrt(sum(np.square(component) for component in parts))
    return limit


def _segment_orientation(q_nb: FloatArray, mounting: BodyMounting, anchor: int, *, magnetometer: bool) -> FloatArray:
    q = mounting.of_body(q_nb)
    half = 0.0 if magnetometer else -0.5 * float(heading_of(q[anchor]))  # the heading of the segment is 0 at the rest
    return quaternion_product(np.array([math.cos(half), 0.0, 0.0, math.sin(half)]), q)


def _rests(record: Record, still: Still | None, offset: str) -> tuple[Still, ...]:
    """Return the given still phase, or the detected still phases, or no phases in motion."""
    if still is not None:
        return (still,)
    try:
        return rests_from_first(record, "orient")
    except InputError as error:
        missing = error.numbers.get("missing") == "rest" and record.accel is not None
        if offset == "rest" or not missing or record.duration_s < LEAST_IN_MOTION_S:
            raise
        return ()


def _offset_uncertainty(record: Record, rests: Sequence[Still], offsets: FloatArray, model: TriadModel | None) -> float:
    """Return the standard uncertainty of the rate's offset, all axes together: rad/s."""
    gyro = np.asarray(record.gyro)
    windows = [gyro[still.start : still.stop] for still in rests]
    middles = [(still.start + still.stop) // 2 for still in rests]
    worst = max(
        float(np.linalg.norm(window.mean(axis=0) - offsets[k])) for window, k in zip(windows, middles, strict=True)
    )
    if model is not None and not offsets.any():
        worst = max(worst, si_factor(model.unit_out, "rate") * float(np.sqrt(np.trace(model.offset_covariance))))
    scatter = min(sum(mean_variance(axis) for axis in window.T) for window in windows if len(window) > 1)
    unmoved = model is not None and model.method in IN_MOTION and model.moving_offset is None and not offsets.any()
    moving = 0.0 if unmoved else 1.0 - sum(map(len, windows)) / len(gyro)
    rest_sigma = math.hypot(worst, math.sqrt(scatter), moved_by(model) * moving)
    subtracted_sigma = record.offset_uncertainty  # uncertainty of the offset that ``correct`` subtracted
    return rest_sigma if subtracted_sigma is None or offsets.any() else min(rest_sigma, subtracted_sigma)


def _check_rest(record: Record, still: Still) -> tuple[Finding, ...]:
    """Return a finding if the device moved during the rest for tilt and offset: rates vary, or gravity turns."""
    if record.gyro is None or record.accel is None:
        return ()
    gyro, accel = record.gyro[still.start : still.stop], record.accel[still.start : still.stop]
    spread = float(np.linalg.norm(np.nanstd(gyro, axis=0)))
    third = max(len(accel) // 3, 1)
    first, last = np.nanmean(accel[:third], axis=0), np.nanmean(accel[-third:], axis=0)
    tilt = float(np.arctan2(np.linalg.norm(np.cross(first, last)), first @ last))
    if spread <= MOVING_RATE and tilt <= TURNED:
        return ()
    start_s, stop_s = record.time[still.start], record.time[still.stop - 1]
    return (
        finding(
            "orient.rest_turns",
            "warn",
            f"The device is not at rest from {start_s:.6g} to {stop_s:.6g} s: its rates vary by "
            f"{spread / RADIAN_PER_DEGREE:.3g} deg/s rms, and gravity turns by {tilt / RADIAN_PER_DEGREE:.2g} deg.",
            "Give a stretch in which the device is at rest, or record a rest.",
        ),
    )


def _expected_drift(record: Record, anchor: int, uncertainty: float, offset: str, *, rested: bool) -> Finding:
    """Return a finding with the expected error of strapdown at the end farther from the rest, or from the first sample."""
    time = record.time
    duration = max(float(time[-1] - time[anchor]), float(time[anchor] - time[0]))
    drift_deg, offset_dps = uncertainty * duration / RADIAN_PER_DEGREE, uncertainty / RADIAN_PER_DEGREE
    start = "the rest" if rested else "the first sample"
    advice = "Subtract the offset (`offset` rest or motion), or use" if offset == "none" else "Use"
    return finding(
        "orient.drift",
        "warn" if uncertainty * duration > WARN_DRIFT else "info",
        f"Expect a strapdown drift of {two_digits(drift_deg)} deg: the offset is uncertain by {offset_dps:.2g} deg/s, over "
        f"{duration:.0f} s from {start} to the far end.",
        f"{advice} the filter (`method` vqf).",
        drift_deg=drift_deg,
        offset_dps=offset_dps,
        duration_s=duration,
        start=start,
    )


# ---- filter


def filtered(
    record: Record, gyro: FloatArray, uncertainty: float, *, magnetometer: bool
) -> tuple[FloatArray, tuple[Finding, ...]]:
    """Return the orientation (N, 4) by VQF over the whole record, offline, with findings about the field.

    The heading is relative to its start. With a magnetometer, it is relative to magnetic east, the x axis of n.
    """
    if record.accel is None or np.isnan(record.accel).any():
        got = "none" if record.accel is None else f"{int(np.isnan(record.accel).any(axis=1).sum())} gaps"
        raise InputError(
            f"orient: the filter needs an accelerometer without gaps, got {got}. Use the method strapdown."
        )
    mag_ut = None
    if magnetometer:
        mag_ut = np.asarray(record.mag_ut)
        if not np.isfinite(mag_ut).all(axis=1).any():
            raise InputError("orient: the magnetometer readings are all gaps. Omit the magnetometer.")
        mag_ut = bridged(record.time, mag_ut)  # the magnetometer's sample rate may be lower
    q, disturbed = filtered_attitude(record.time, gyro, record.accel, mag_ut, offset_sigma=uncertainty)
    if not magnetometer:
        return q, ()
    sentence = "Heading is relative to magnetic east: x of the level frame points to it, and y to magnetic north."
    sentence += f" The field was disturbed for {100.0 * disturbed:.2g} % of the time."
    north = finding("orient.north", "info", sentence)
    return q, (north, magnetometer_not_calibrated()) if record.state == "raw" else (north,)


def magnetometer_not_calibrated() -> Finding:
    """Return a finding about the hard and soft iron of an uncalibrated magnetometer."""
    return finding(
        "orient.field",
        "warn",
        "The magnetometer is not calibrated: hard iron of 1 uT turns the heading by up to 3 deg.",
        "Calibrate the device from motion with `magnetometer`.",
    )


def _level_at(q_nb: FloatArray, anchor: int, wanted: FloatArray) -> FloatArray:
    """Return the orientations turned about the vertical, so that the heading at a sample equals the heading of ``wanted``."""
    w, _, _, z = quaternion_product(wanted, quaternion_conjugate(q_nb[anchor]))
    return quaternion_product(np.array([w, 0.0, 0.0, z]) / math.hypot(w, z), q_nb)


def _check_field(record: Record, settings: OrientSettings) -> None:
    """Raise if the magnetometer is requested, but the record has none or the settings cannot use it."""
    if settings.magnetometer and (settings.method != "vqf" or record.mag_ut is None):
        got = "no readings" if record.mag_ut is None else settings.method
        raise InputError(
            f"orient: a magnetometer requires its readings and the method vqf, got {got}. Omit the magnetometer, or change the "
            "method."
        )


_MOST_RATE = 4000.0 * RADIAN_PER_DEGREE  # rad/s, widest range of wearable gyroscopes


def check_whole(record: Record) -> None:
    """Raise if a gap is too long to be bridged, or if an axis is dead."""
    time, gyro = record.time, record.gyro
    if gyro is None:
        raise InputError("orient: no gyroscope readings. Map the gyroscope columns.")
    check_gaps(gyro, time, "orient")
    steps = np.diff(time)
    holes = np.flatnonzero(steps > max(LONGEST_HOLE_S, 5.0 * float(np.median(steps))))
    if len(holes):
        k = int(holes[0])
        raise InputError(
            f"orient: expected readings without holes over {LONGEST_HOLE_S:g} s, got {len(holes)}, the first of {steps[k]:.3g} s "
            f"at {time[k]:.6g} s. After a hole the orientation is unknown. Orient each stretch from its own rest.",
            hole_s=float(steps[k]),
        )
    fastest = float(np.abs(gyro).max())
    if fastest > _MOST_RATE:
        raise InputError(
            f"orient: expected angular rates up to {_MOST_RATE / RADIAN_PER_DEGREE:g} deg/s, the largest range of gyroscopes, got "
            f"{fastest / RADIAN_PER_DEGREE:.4g} deg/s. Check the unit of the gyroscope.",
            rate=fastest,
        )
    dead = [axis for axis, moves in zip("xyz", np.ptp(gyro, axis=0) > 0.0, strict=True) if not moves]
    if dead and len(dead) < 3:
        raise InputError(
            f"orient: {', '.join(dead)} of the gyroscopes has a constant value. Check the device and its columns."
        )


def _both_ways(gyro: FloatArray, time: FloatArray, q_nb: FloatArray, anchor: int) -> FloatArray:
    q = np.empty((len(time), 4))
    q[anchor:] = integrate_strapdown(gyro[anchor:], time[anchor:], q_nb)
    undone = np.vstack((np.zeros(3), -gyro[anchor:0:-1]))  # the step to sample k, reversed, leads to sample k - 1
    q[: anchor + 1] = integrate_strapdown(undone, -time[anchor::-1], q_nb)[::-1]
    return q
