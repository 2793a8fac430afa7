"""Mounting: the rotation R from the device's case b to the body m that the reference tracks.

From rates about two axes or more, R minimises sum |w - R u|^2 over the rates w of the body and u of the device about their means
(Kabsch's problem, 1976). A movement about one axis, such as rising from a chair, does not determine that rotation. If the axes of
the body mean nothing, as those of a cluster of markers, the vertical at rest replaces the second axis::

    R = R(g, angle) R1        R1: shortest rotation from the mean specific force to the vertical g of the body
    angle = atan2(sum g . (u x v), sum u . v - (u . g)(v . g))        u = R1 w: rates of the device, v: rates of the body
"""

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import AlignmentError
from undrift.frames import cross, quaternion_conjugate, quaternion_of, quaternion_product, rotate, rotation
from undrift.orientation import shortest_rotation_up
from undrift.record import Record, Reference
from undrift.sync import MotionSpan
from undrift.validation.reference_frames import best_rotation, common_rates

Align = Literal["auto", "level"]
REST_S = 10.0  # rest before the motion that gives tilt and heading
LEAD_S = 0.5  # integration starts so long before the motion
LEAST_SPREAD = 0.02  # smallest second singular value relative to the largest, for rotation about two axes
MIRRORED_SHARE = 0.2  # third singular value relative to the second, from which a reflection is no effect of noise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mounting:
    """Mounting of the device on the body of the reference."""

    rotation: FloatArray  # (3, 3), turns vectors from the case b to the body m
    applied: bool  # True if the readings were rotated with it

    @property
    def angle(self) -> float:
        """Angle of the rotation, rad."""
        return float(np.arccos(np.clip(0.5 * (np.trace(self.rotation) - 1.0), -1.0, 1.0)))


def align(
    record: Record, poses: Reference, motion: MotionSpan, *, lag_s: float, how: Align, above: float
) -> tuple[Record, Mounting | None]:
    """Return the record in the axes of the body, and its mounting, or None if the motion does not determine it.

    "auto" removes a rotation that exceeds ``above`` (rad), from rates. "level" removes any rotation, from the vertical at rest and
    the rates, or from the rates alone if the recording does not begin at rest.
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
    """Return the record in axes to which a rotation (3, 3) turns its vectors."""
    gyro, accel = (x if x is None else x @ matrix.T for x in (record.gyro, record.accel))
    return replace(record, gyro=gyro, accel=accel)


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
    """Return the rotation (3, 3) from their verticals at rest and rotation about a level axis."""
    start_s, stop_s = motion.start_s - REST_S, motion.start_s - LEAD_S
    rest = poses.valid & (poses.time >= start_s - lag_s) & (poses.time < stop_s - lag_s)
    forces = np.empty((0, 3)) if record.accel is None else record.accel
    forces = forces[((record.time >= start_s) & (record.time < stop_s))[: len(forces)]]
    if not motion.rested or not rest.any() or not np.isfinite(forces).any():
        raise AlignmentError(
            "alignment: no common vertical at rest before the motion. Start the recording with a rest."
        )
    vertical = rotate(quaternion_conjugate(poses.q_nb[rest]), np.array([0.0, 0.0, 1.0])).mean(axis=0)
    g, f = (x / np.linalg.norm(x) for x in (vertical, np.nanmean(forces, axis=0)))
    q_level = quaternion_product(quaternion_conjugate(shortest_rotation_up(g)), shortest_rotation_up(f))
    rates, v = common_rates(record, poses, lag_s)
    u = rotate(q_level, rates)
    across, along = float((cross(u, v) @ g).sum()), float((u * v).sum() - ((u @ g) * (v @ g)).sum())
    if math.hypot(across, along) < LEAST_SPREAD * float((v * v).sum()):
        raise AlignmentError("alignment: no rotation about a level axis. Bend or turn over once.")
    return rotation(quaternion_product(quaternion_of(math.atan2(across, along) * g), q_level)).as_matrix()
