"""Rotation between device and reference, and a check that both use the same quaternions, verticals and signs.

Mounting: the rotation R from the device's case b to the body m that the reference tracks. From rates about two axes or more, R
minimises sum |w - R u|^2 over the rates w of the body and u of the device about their means (Kabsch's problem, 1976). A movement
about one axis, such as rising from a chair, does not determine R. If the axes of the body have no meaning, such as those of a
cluster of markers, the vertical at rest replaces the second axis::

    R = R(g, angle) R1        R1: shortest rotation from the mean specific force to the vertical g of the body
    angle = atan2(sum g . (u x v), sum u . v - (u . g)(v . g))        u = R1 w: rates of the device, v: rates of the body

Conventions: after a constant rotation R_mb, the rates of the reference must equal the rates of the device. A large residual
indicates an inverted quaternion. The mean of the specific force in n over the whole recording must be gravity, up::

    u = mean_k R(q_k) R_mb f_k / g = (0, 0, 1)          (a motion that returns to its start has no mean acceleration)

If u is along another axis, the vertical axis of the laboratory is wrong. If u = (0, 0, -1), the vertical or the sign of the
acceleration is reversed.
"""

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray, interpolated
from undrift.errors import AlignmentError, Implausible
from undrift.findings import Finding, finding
from undrift.frames import cross, quaternion_conjugate, quaternion_of, quaternion_product, rotate, rotation
from undrift.model import AXES
from undrift.orientation import shortest_rotation_up
from undrift.record import Record, Reference
from undrift.sync import MotionSpan, RunningIntegral, native_poses, pose_rates
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

Align = Literal["auto", "level"]
REST_S = 10.0  # duration of the rest before the motion that determines tilt and heading
LEAD_S = 0.5  # time before the motion at which integration starts
LEAST_SPREAD = 0.02  # smallest second singular value relative to the largest, for rotation about two axes
MIRRORED_SHARE = 0.2  # third singular value relative to the second, above which a reflection cannot be noise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mounting:
    """Mounting of the device on the body of the reference."""

    rotation: FloatArray  # (3, 3), turns vectors from the case b to the body m
    applied: bool  # True if the readings were rotated with ``rotation``

    @property
    def angle(self) -> float:
        """Angle of the rotation, rad."""
        return float(np.arccos(np.clip(0.5 * (np.trace(self.rotation) - 1.0), -1.0, 1.0)))


def align(
    record: Record, poses: Reference, motion: MotionSpan, *, lag_s: float, how: Align, above: float
) -> tuple[Record, Mounting | None]:
    """Return the record in the axes of the body, and its mounting, or None if the motion does not determine it.

    "auto" removes a rotation that exceeds ``above`` (rad), from rates. "level" removes any rotation, from the vertical at rest and
    the rates, or from the rates only if the recording does not begin at rest.
    """
    matrix: FloatArray | None = None
    if how == "level":
        with suppress(AlignmentError):
            matrix = rotation_by_level(record, poses, motion, lag_s=lag_s)
    if matrix is None:
        try:
            matrix = rotation_by_rates(record, poses, lag_s=lag_s)
        except AlignmentError:  # rotation about one axis
            return record, None
    mounting = Mounting(rotation=matrix, applied=True)
    if how == "auto" and mounting.angle <= above:
        return record, replace(mounting, applied=False)
    return turned(record, matrix), mounting


def turned(record: Record, matrix: FloatArray) -> Record:
    """Return the record in the axes to which a rotation (3, 3) turns its vectors."""
    gyro, accel = (x if x is None else x @ matrix.T for x in (record.gyro, record.accel))
    return replace(record, gyro=gyro, accel=accel)


def common_rates(record: Record, poses: Reference, lag_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the rates of device and reference minus their means, (K, 3) each, for the steps that both contain."""
    rates = pose_rates(poses)
    gyro = np.empty((0, 3)) if record.gyro is None else record.gyro
    mean, inside = RunningIntegral(record.time, gyro).mean(rates.start + lag_s, rates.stop + lag_s)
    good = inside & rates.valid
    return mean[good] - mean[good].mean(axis=0), rates.rate[good] - rates.rate[good].mean(axis=0)


def best_rotation(u: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
    """Return the rotation (3, 3) that minimises sum |w - R u|^2, the singular values, and whether a reflection fits better."""
    left, singular, right = np.linalg.svd(w.T @ u)
    sign = float(np.sign(np.linalg.det(left @ right)))
    return left @ np.diag((1.0, 1.0, sign)) @ right, singular, sign < 0.0


def rotation_by_rates(record: Record, poses: Reference, *, lag_s: float) -> FloatArray:
    """Return the rotation (3, 3) from the device to the body of the reference, from their rates."""
    matrix, singular, is_mirrored = best_rotation(*common_rates(record, poses, lag_s))
    if not singular[1] > LEAST_SPREAD * singular[0]:
        raise AlignmentError(
            "alignment: the rotation is about one axis only. Turn the device about a second axis, or provide the mounting.",
            spread=float(singular[1] / max(singular[0], 1e-300)),
        )
    if is_mirrored and singular[2] > MIRRORED_SHARE * singular[1]:
        raise AlignmentError(
            "alignment: the result is a reflection, not a rotation. Check if an axis of the device or of the reference is reversed."
        )
    return matrix


def rotation_by_level(record: Record, poses: Reference, motion: MotionSpan, *, lag_s: float) -> FloatArray:
    """Return the rotation (3, 3) from the device to the body, from their verticals at rest and rotation about a level axis."""
    start_s, stop_s = motion.start_s - REST_S, motion.start_s - LEAD_S
    rest = poses.valid & (poses.time >= start_s - lag_s) & (poses.time < stop_s - lag_s)
    forces = np.empty((0, 3)) if record.accel is None else record.accel
    forces = forces[((record.time >= start_s) & (record.time < stop_s))[: len(forces)]]
    if not motion.rested or not rest.any() or not np.isfinite(forces).any():
        raise AlignmentError(
            "alignment: there is no common vertical at rest before the motion. Start the recording with a rest."
        )
    vertical = rotate(quaternion_conjugate(poses.q_nb[rest]), np.array([0.0, 0.0, 1.0])).mean(axis=0)
    g, f = (x / np.linalg.norm(x) for x in (vertical, np.nanmean(forces, axis=0)))
    q_level = quaternion_product(quaternion_conjugate(shortest_rotation_up(g)), shortest_rotation_up(f))
    rates, v = common_rates(record, poses, lag_s)
    u = rotate(q_level, rates)
    across, along = float((cross(u, v) @ g).sum()), float((u * v).sum() - ((u @ g) * (v @ g)).sum())
    if math.hypot(across, along) < LEAST_SPREAD * float((v * v).sum()):
        raise AlignmentError("alignment: there is no rotation about a level axis. Bend forward or turn over once.")
    return rotation(quaternion_product(quaternion_of(math.atan2(across, along) * g), q_level)).as_matrix()


# ---- conventions of device and reference

# Remaining shares of the squared rates: 0.001 to 0.04 in sound recordings (BROAD, before calibration)
UNLIKE, EXPLAINED = 0.15, 0.1
TILTED, CLEARLY = 30.0 * RADIAN_PER_DEGREE, 60.0 * RADIAN_PER_DEGREE
LENGTH = (0.8, 1.2)  # range of the length of u for matching attitudes and forces
LEAST_RATE = 2.0 * RADIAN_PER_DEGREE  # smallest rms rate that exceeds the noise, rad/s


def unexplained_share(record: Record, poses: Reference, lag_s: float) -> tuple[float, FloatArray | None]:
    """Return the share of the rates' square that no rotation between the bodies explains, and the best rotation (3, 3).

    The share is NaN if the motion is too small to compare rates. The rotation is None if the motion is about one axis only.
    """
    u, w = common_rates(record, poses, lag_s)
    r_mb, singular, _ = best_rotation(u, w)
    total = 0.5 * float((w**2).sum() + (u**2).sum())
    enough = len(w) > 0 and math.sqrt(total / len(w)) >= LEAST_RATE
    share = float(((w - u @ r_mb.T) ** 2).sum()) / total if enough else math.nan
    return share, r_mb if singular[1] > LEAST_SPREAD * singular[0] else None


def check_reference(record: Record, poses: Reference, lag_s: float) -> tuple[Finding, ...]:
    """Return findings on the convention of a reference's poses, or raise if it is clearly wrong. The record is in SI units."""
    share, r_mb = unexplained_share(record, poses, lag_s)
    if math.isnan(share):
        return ()
    if share > UNLIKE:
        others = {
            "its quaternions turn level to body, not body to level": quaternion_conjugate(poses.q_nb),
            "its quaternions are x-y-z-w, not w-x-y-z": np.roll(poses.q_nb, 1, axis=1),
        }
        shares = {
            text: unexplained_share(record, native_poses(replace(poses, q_nb=q)), lag_s)[0]
            for text, q in others.items()
        }
        texts = [text for text in sorted(shares, key=lambda text: shares[text]) if shares[text] < EXPLAINED]
        if texts:
            raise _implausible(poses, ", or ".join(texts), "Convert them, or enter their order in the map of the file.")
        return (
            finding(
                "validate.rates_differ",
                "warn",
                f"Device and reference do not turn in the same way: {100.0 * share:.0f} % of the squared rates remain. The "
                "reference is of another segment or trial, or the device moves on the body.",
                "Check that the reference belongs to this body and this trial.",
            ),
        )
    if record.accel is None or r_mb is None:
        return ()

    visible = poses.valid & (poses.time + lag_s >= record.time[0]) & (poses.time + lag_s <= record.time[-1])
    force = interpolated(poses.time[visible] + lag_s, record.time, record.accel)
    finite = np.isfinite(force).all(axis=1)
    up = rotate(poses.q_nb[visible][finite], force[finite] @ r_mb.T).mean(axis=0) / STANDARD_GRAVITY
    length = float(np.linalg.norm(up))
    angle = math.acos(float(np.clip(up[2] / max(length, 1e-9), -1.0, 1.0)))
    if not LENGTH[0] < length < LENGTH[1]:
        return ()
    k = int(np.abs(up).argmax())
    axis = f"{'+' if up[k] > 0.0 else '-'}{AXES[k]}"
    text = f"the axis of its laboratory that points up is {axis}, not +z"
    if axis == "-z":
        text = "acceleration has the opposite sign, or its laboratory is mirrored (left-handed) or upside down"
    if angle > CLEARLY:
        raise _implausible(poses, text, f"{_NAME_UP}, or correct the sign of the columns.")
    return check_vertical(angle, text)


_NAME_UP = "Set the axis of the laboratory that points up (`reference_up`, or up in the map of a table)"


def check_vertical(angle: float, text: str) -> tuple[Finding, ...]:
    """Return a finding if the angle between the verticals of device and reference, rad, is large."""
    if not angle > TILTED:
        return ()
    sentence = f"Gravity is {angle / RADIAN_PER_DEGREE:.0f} deg off the vertical of the reference: {text}."
    return (finding("validate.not_up", "warn", sentence, f"{_NAME_UP}, or correct the columns or the mounting."),)


def _implausible(poses: Reference, text: str, action: str) -> Implausible:
    name = poses.name or "reference"
    return Implausible(
        f"{name}: the poses do not agree with the readings of the device: {text}. {action}", mistake=text
    )
