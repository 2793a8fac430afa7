"""Recorded people as a task of a study: poses of a device at L5 or on another segment, an initial rest, and a table of people.

A recorded motion must begin at rest. The body is at rest until one of three quantities exceeds its limit, with rates and
accelerations as means over 0.25 s::

    w    |mean of w_b|                          turn rate of the body
    a    |mean of p''|                          acceleration of the body
    e    angle(mean of f_b, R_nb^T z)           tilt error of an ideal device at the end of that time
"""

import csv
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import PositiveFloat

from undrift.arrays import BoolArray, FloatArray, window_sums
from undrift.base.codec import stored
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, rotate
from undrift.io.formats import read_markers, read_reference
from undrift.io.reference import L5_OFFSET, BodyName, device_on, find_body
from undrift.record import Reference
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, PoseSpline, fit_pose_spline
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY


@dataclass(frozen=True, slots=True, kw_only=True)
class Posed:
    """Settings to obtain the poses of a device from a file of poses or markers."""

    markers: tuple[str, ...] = ()  # labels of a rigid cluster, for TRC or C3D
    # or segment on which the device is worn, located by its markers: pelvis (device at L5) or trunk
    body: BodyName | None = None
    up: Literal["y", "z"] | None = None  # laboratory axis that points up, for markers
    rest_s: PositiveFloat | None = None  # rest at the start, s (by default it is detected, at most 6 s)
    hold: bool = False  # hold the first pose for ``rest_s`` if a recording has no rest


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnMotion(Posed):
    """A recorded motion of a person."""

    path: str  # file of poses or markers, which the workers read


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedPeople:
    """Recorded motions of several people, each with a different unit of the device, or of one person with all units."""

    trials: tuple[tuple[OwnMotion, ...], ...]  # motions of each person

    def of(self, number: int) -> tuple[OwnMotion, ...]:
        """Return the trials of a subject."""
        return self.trials[number % len(self.trials)]


# ---- recorded motions

SAMPLE_RATE_HZ = 100.0
WINDOW_S = 0.25
LEAST_REST_S = 0.5  # the initial tilt is a mean over the rest
LONGEST_REST_S = 6.0  # longest rest, as in the note (the remaining recording counts as motion)
# At the pelvis, quiet stance stays below 1.4 deg/s, 0.03 m/s2 and 0.6 deg over 5 s. A person who starts to rise reaches 10 deg/s.
MOST_TURN_RATE = 5.0 * RADIAN_PER_DEGREE  # rad/s
MOST_ACCELERATION = 0.3  # m/s2
MOST_TILT_ERROR = 1.0 * RADIAN_PER_DEGREE  # rad
# markers on skin do not follow the bone above these frequencies
SKIN = PoseSettings(cutoff_hz=10.0, position_cutoff_hz=6.0)


def find_rest(spline: PoseSpline) -> BoolArray:
    """Return True for each sample if the body was at rest from the first pose to this sample, (N,)."""
    start, stop = spline.span_s
    time = start + np.arange(int((stop - start) * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    motion = spline.at(time, STANDARD_GRAVITY)
    swing = rotate(motion.q_nb, motion.force_b) - np.array([0.0, 0.0, STANDARD_GRAVITY])
    up = rotate(quaternion_conjugate(motion.q_nb), np.array([0.0, 0.0, 1.0]))
    mean = np.cumsum(motion.force_b, axis=0)
    tilt = np.arctan2(np.linalg.norm(np.cross(mean, up), axis=1), (mean * up).sum(axis=1))
    rate, acceleration = (np.maximum.accumulate(_windowed(x)) for x in (motion.rate_b, swing))
    is_still: BoolArray = (rate <= MOST_TURN_RATE) & (acceleration <= MOST_ACCELERATION) & (tilt <= MOST_TILT_ERROR)
    return is_still


def length_of_rest(is_still: BoolArray) -> float:
    """Return the duration for which a body is at rest, rounded down to 0.1 s."""
    still_s = (int(np.flatnonzero(is_still)[-1]) + 1) / SAMPLE_RATE_HZ if is_still.any() else 0.0
    return float(np.floor(10.0 * still_s) / 10.0)


def check_rest(is_still: BoolArray, rest_s: float, path: Path) -> None:
    """Raise InputError if a motion does not begin with a rest of the given duration."""
    if is_still[min(round(rest_s * SAMPLE_RATE_HZ), len(is_still)) - 1]:
        return
    still_s = length_of_rest(is_still)
    todo = (
        f"set rest_s = {still_s:g}"
        if still_s >= LEAST_REST_S
        else f"use a recording that begins with at least {LEAST_REST_S:g} s at rest, or set hold = true and rest_s = 6"
    )
    raise InputError(
        f"{path}: the body must be at rest for the first rest_s = {rest_s:g} s: at most "
        f"{MOST_TURN_RATE / RADIAN_PER_DEGREE:g} deg/s, {MOST_ACCELERATION:g} m/s2, and an error of the initial tilt of "
        f"{MOST_TILT_ERROR / RADIAN_PER_DEGREE:g} deg. The body is still for only {still_s:g} s. To continue, {todo}.",
        still_s=still_s,
    )


def _windowed(values: FloatArray) -> FloatArray:
    """Return the length of the mean over the window that ends at each sample, or 0 before the first whole window."""
    width = round(WINDOW_S * SAMPLE_RATE_HZ)
    sizes = np.linalg.norm(window_sums(values, width) / width, axis=1)
    return np.concatenate((np.zeros(len(values) - len(sizes)), sizes))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedTask:
    """A recorded motion as a task."""

    spline: PoseSpline  # poses
    moving_s: tuple[float, float]  # first and last instant of motion, s from the start
    held_s: float = 0.0  # duration of a rest in the first pose that is added before the recording, s

    @property
    def duration_s(self) -> float:
        """Length, s."""
        start, stop = self.spline.span_s
        return self.held_s + stop - start

    def at(self, time: FloatArray, gravity_m_s2: float) -> Motion:
        """Return the motion at times (N,), s."""
        start = self.spline.span_s[0]
        motion = replace(self.spline.at(time - self.held_s + start, gravity_m_s2), time=time)
        is_start = time < self.held_s
        if not is_start.any():
            return motion
        q_nb = self.spline.at(np.array([start]), gravity_m_s2).q_nb
        still, up = np.zeros(3), rotate(quaternion_conjugate(q_nb), np.array([0.0, 0.0, gravity_m_s2]))
        vectors = {"q_nb": q_nb, "rate_b": still, "mean_rate_b": still, "force_b": up, "angular_acceleration_b": still}
        at_rest: dict[str, Any] = {
            name: np.where(is_start[:, None], row, getattr(motion, name)) for name, row in vectors.items()
        }
        at_rest |= {"moving": motion.moving * ~is_start, "valid": np.where(is_start, 1.0, motion.valid)}
        return replace(motion, **at_rest)


@lru_cache(maxsize=4)
def read_motion(motion: OwnMotion) -> RecordedTask:
    """Read a recorded motion. Raise InputError if it does not begin with a rest."""
    path = Path(motion.path)
    reference = read_poses(path, motion)
    spline = fit_pose_spline(reference, SKIN if motion.body else PoseSettings())
    length = spline.span_s[1] - spline.span_s[0]
    is_still = np.zeros(1, dtype=bool) if motion.hold else find_rest(spline)
    detected_s = LONGEST_REST_S if motion.hold else min(max(length_of_rest(is_still), LEAST_REST_S), LONGEST_REST_S)
    rest_s = detected_s if motion.rest_s is None else motion.rest_s
    problem = ""
    if reference.position is None:
        problem = "the poses have no positions, which the simulation of accelerometers requires"
    elif len(spline.pieces) > 1:
        problem = f"the poses have {len(spline.pieces) - 1} long gaps. Cut the recording at the gaps"
    elif motion.hold and rest_s < LEAST_REST_S:
        problem = f"to hold the first pose, rest_s must be {LEAST_REST_S:g} s or more, got {rest_s:g}. The note uses 6"
    elif not motion.hold and not LEAST_REST_S <= rest_s < length - 1.0:
        span = f"{LEAST_REST_S:g} s to {length - 1.0:.1f} s"
        problem = f"rest_s must be {span}, got {rest_s:g}. Set the duration of the rest at the beginning"
    if problem:
        raise InputError(f"{path}: {problem}.")
    if motion.hold:
        return RecordedTask(spline=spline, moving_s=(rest_s, rest_s + length), held_s=rest_s)
    check_rest(is_still, rest_s, path)
    return RecordedTask(spline=spline, moving_s=(rest_s, length))


def read_poses(path: Path, how: Posed) -> Reference:
    """Read the poses of a cluster, a file, or a device on a segment (at L5 of a pelvis, at the origin of other segments)."""
    if how.body is None:
        return read_reference(path, labels=how.markers or None, up=how.up)
    if how.markers or how.up is None:
        raise InputError(
            f"{path}: a body requires `up` and no markers, got {'markers' if how.markers else 'no `up`'}. Set body and up."
        )
    offset = L5_OFFSET if how.body == "pelvis" else (0.0, 0.0, 0.0)
    return device_on(find_body(read_markers(path, up=how.up), how.body), offset_b=offset)


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class MotionEntry(Posed):
    """[task.motion]."""

    file: str = ""  # file of poses or markers, relative to study.toml
    folder: str = ""  # alternative: folder with one file per person
    # alternative: CSV table with the columns file (relative to the table) and person. A person may have several files
    table: str = ""


def recorded_people(entry: MotionEntry, folder: Path) -> RecordedPeople:
    """Return the recorded people of a plan. Each file is read, so that errors are raised before the workers start."""
    sources = [name for name in ("file", "folder", "table") if getattr(entry, name)]
    if len(sources) != 1:
        raise InputError(
            "task.motion: a file, a folder with a file per person, or a table of files and people is required, got "
            f"{' and '.join(sources) or 'none'}. Set one of them."
        )
    path = folder / str(getattr(entry, sources[0]))
    try:
        files = sorted(file for file in path.iterdir() if file.is_file()) if entry.folder else [path]
        people = _people_in(path) if entry.table else [[file] for file in files]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot read the {sources[0]} of recorded people ({error}).") from error
    if len(people) < 3 and not entry.file:
        raise InputError(f"{path}: at least three people are required, got {len(people)}. Record more people.")
    how: dict[str, Any] = {item.name: getattr(entry, item.name) for item in fields(Posed)}
    trials = tuple(tuple(OwnMotion(path=str(file.resolve()), **how) for file in files) for files in people)
    for motion in (motion for person in trials for motion in person):
        read_motion(motion)
    return RecordedPeople(trials=trials)


def _people_in(path: Path) -> list[list[Path]]:
    """Return the files of each person in a table."""
    people, files = dict[str, list[Path]](), set[str]()
    for line, row in enumerate(csv.DictReader(path.read_text("utf-8-sig").splitlines(), skipinitialspace=True), 2):
        if missing := [name for name in ("file", "person") if not row.get(name)]:
            raise InputError(
                f"{path}: file and person are required in each row, got no {missing[0]} in line {line}. Add it."
            )
        if row["file"] in files:
            raise InputError(f"{path}: {row['file']} is listed again in line {line}. Delete a line.")
        files.add(row["file"])
        people.setdefault(row["person"], []).append(path.parent / row["file"])
    return list(people.values())
