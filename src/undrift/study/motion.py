"""Motion of one's own in a study: poses from a file, to be asked at any instant as a task of the library is."""

import hashlib
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, rotate
from undrift.io.bodies import L5_OFFSET, BodyName, device_on, find_body
from undrift.io.markers import Up
from undrift.io.reference import read_markers, read_reference
from undrift.record import Reference
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, PoseSpline, fit_pose_spline
from undrift.study.plan import OwnMotion
from undrift.study.rest import LEAST_REST_S, check_rest

SKIN = PoseSettings(cutoff_hz=10.0, position_cutoff_hz=6.0)  # markers on skin: what is above is not the bone


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedTask:
    """A recorded motion as a task.

    Parameters
    ----------
    spline : PoseSpline
        The poses.
    moving_s : (float, float)
        First and last instant of motion, s from the beginning.
    held_s : float
        How long the first pose is held before the recording begins, s.
    """

    spline: PoseSpline
    moving_s: tuple[float, float]
    held_s: float = 0.0

    @property
    def duration_s(self) -> float:
        """Length, s."""
        start, stop = self.spline.span_s
        return self.held_s + stop - start

    def at(self, time: FloatArray, gravity_m_s2: float) -> Motion:
        """Return the motion at given instants.

        Parameters
        ----------
        time : array, shape (N,)
            s from the beginning, increasing.
        gravity_m_s2 : float
            m/s2.

        Returns
        -------
        Motion
            NaN outside the recording; at rest in the first pose while that is held.
        """
        start = self.spline.span_s[0]
        motion = replace(self.spline.at(time - self.held_s + start, gravity_m_s2), time=time)
        if self.held_s == 0.0:
            return motion
        first = self.spline.at(np.array([start]), gravity_m_s2).q_nb
        up = rotate(quaternion_conjugate(first), np.array([0.0, 0.0, gravity_m_s2]))
        rows, swing = (time < self.held_s)[:, None], motion.angular_acceleration_b
        return replace(
            motion,
            q_nb=np.where(rows, first, motion.q_nb),
            rate_b=np.where(rows, 0.0, motion.rate_b),
            mean_rate_b=np.where(rows, 0.0, motion.mean_rate_b),
            force_b=np.where(rows, up, motion.force_b),
            moving=np.where(rows[:, 0], 0.0, motion.moving),
            angular_acceleration_b=None if swing is None else np.where(rows, 0.0, swing),
            valid=np.where(rows[:, 0], 1.0, motion.valid),
        )


def read_motion(own: OwnMotion) -> RecordedTask:
    """Read a recorded motion.

    Parameters
    ----------
    own : OwnMotion
        Which file, and how long the rest at its beginning is.

    Returns
    -------
    RecordedTask
        Kept for the next unit of work in the same process.

    Raises
    ------
    InputError
        No such file, a file that has changed, gaps, no positions, a rest that is too short or too long, a body not at rest then.
    """
    return _read(own)


@lru_cache(maxsize=4)
def _read(own: OwnMotion) -> RecordedTask:
    if sha256_of(Path(own.path)) != own.sha256:
        raise InputError(
            f"{own.path}: wanted the file that the study began with, got another content; start a new study"
        )
    reference = read_poses(Path(own.path), body=own.body, markers=own.markers, up=own.up)
    spline = fit_pose_spline(reference, SKIN if own.body else PoseSettings())
    if reference.position is None:
        raise InputError(
            f"{own.path}: wanted poses with positions, got none; without them nobody knows what accelerometers feel"
        )
    if len(spline.pieces) > 1:
        raise InputError(
            f"{own.path}: wanted poses without long gaps, got {len(spline.pieces) - 1}; cut the recording between gaps"
        )
    length = spline.span_s[1] - spline.span_s[0]
    if own.hold:
        if own.rest_s < LEAST_REST_S:
            raise InputError(
                f"{own.path}: wanted a rest_s of {LEAST_REST_S:g} s or more to hold the first pose for, got {own.rest_s:g}; "
                "6 is the note's"
            )
        return RecordedTask(spline=spline, moving_s=(own.rest_s, own.rest_s + length), held_s=own.rest_s)
    if not LEAST_REST_S <= own.rest_s < length - 1.0:
        raise InputError(
            f"{own.path}: wanted a rest_s of {LEAST_REST_S:g} s to {length - 1.0:.1f} s, got {own.rest_s:g}; state how long the "
            "body is at rest at the beginning"
        )
    check_rest(spline, own.rest_s, Path(own.path))
    return RecordedTask(spline=spline, moving_s=(own.rest_s, length))


def read_poses(path: Path, *, body: BodyName | None, markers: tuple[str, ...], up: Up | None) -> Reference:
    """Read the poses of a cluster or file, or of a device on a segment: at L5 on a pelvis, at the origin of another.

    Parameters
    ----------
    path : Path
        Poses or markers.
    body : str or None
        pelvis, thorax or trunk, found by its markers.
    markers : tuple of str
        Or labels of one rigid cluster.
    up : str or None
        Laboratory axis that points up, for markers.

    Returns
    -------
    Reference
        Poses.

    Raises
    ------
    InputError
        A body with markers too, or without up; and all that the readers raise.
    """
    if body is None:
        return read_reference(path, labels=markers or None, up=up)
    if markers or up is None:
        raise InputError(f"{path}: wanted a body and up, got {'markers too' if markers else 'no up'}; name the two")
    offset = L5_OFFSET if body == "pelvis" else (0.0, 0.0, 0.0)
    return device_on(find_body(read_markers(path, up=up), body), offset_b=offset)


def sha256_of(path: Path) -> str:
    """Return the mark of a file's content.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    str
        Sixty-four hexadecimal digits.

    Raises
    ------
    InputError
        No such file.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: wanted a file of poses or markers, got {error.strerror}; check the path") from error
