"""Recorded people as a task of a study: poses of a device at L5 or on another segment, initial rest, and people in a table.

A recorded motion must begin at rest. Three quantities of its first ``rest_s`` seconds are checked, with rates and accelerations as
means over 0.25 s::

    w    |mean of w_b|                          turn rate of the body
    a    |mean of p''|                          acceleration of the body
    e    angle(mean of f_b, R_nb^T z)           tilt error of an ideal device at the end of that time
"""

import csv
import hashlib
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from annotated_types import Gt

from undrift.arrays import FloatArray, window_sums
from undrift.base.codec import stored
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, rotate
from undrift.io.formats import read_markers, read_reference
from undrift.io.reference import L5_OFFSET, BodyName, device_on, find_body
from undrift.record import Reference
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, PoseSpline, fit_pose_spline
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

Positive = Annotated[float, Gt(0.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Posed:
    """Settings to obtain the poses of a device from a file of poses or markers."""

    markers: tuple[str, ...] = ()  # labels of a rigid cluster, for TRC or C3D
    # Or the segment that the device is worn on, found by its markers: pelvis (the device sits at L5) or trunk
    body: BodyName | None = None
    up: Literal["y", "z"] | None = None  # Laboratory axis that points up, for markers


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnMotion(Posed):
    """A recorded motion for all subjects, or motions of several people, each with another unit of the device."""

    path: str  # file of poses or markers, which the workers read
    sha256: str  # Of its content
    rest_s: float  # duration of the rest at the beginning, s
    hold: bool = False  # True to hold the first pose for ``rest_s``, if the recording has no rest
    others: tuple["OwnMotion", ...] = ()  # Of further people
    again: tuple["OwnMotion", ...] = ()  # Further trials of the same person

    @property
    def people(self) -> int:
        """Number of recorded people."""
        return 1 + len(self.others)

    def of(self, number: int) -> tuple["OwnMotion", ...]:
        """Return the trials of a subject."""
        person = (self, *self.others)[number % self.people]
        return (person, *person.again)


# ---- recorded motions

SAMPLE_RATE_HZ = 100.0
WINDOW_S = 0.25
LEAST_REST_S = 0.5  # the initial tilt is a mean over the rest
LONGEST_REST_S = 6.0  # longest rest, as in the note (the remaining recording counts as motion)
# At the pelvis, quiet stance stays below 1.4 deg/s, 0.03 m/s2 and 0.6 deg over 5 s. A person who starts to rise reaches 10 deg/s.
MOST_TURN_RATE = 5.0 * RADIAN_PER_DEGREE  # rad/s
MOST_ACCELERATION = 0.3  # m/s2
MOST_TILT_ERROR = 1.0 * RADIAN_PER_DEGREE  # rad
SKIN = PoseSettings(
    cutoff_hz=10.0, position_cutoff_hz=6.0
)  # markers on skin do not follow the bone above these frequencies


class RestQuality(NamedTuple):
    """Motion of a body during its first poses."""

    turn_rate: float  # largest rate, rad/s
    acceleration: float  # largest acceleration, m/s2
    tilt_error: float  # tilt error that a perfect device would make at the end, rad
    still_s: float  # duration for which the body is at rest, s


def measure_rest(spline: PoseSpline, rest_s: float) -> RestQuality:
    """Measure turn rate, acceleration and tilt error of a body at the beginning of its poses."""
    start, stop = spline.span_s
    count = int((stop - start) * SAMPLE_RATE_HZ)
    motion = spline.at(start + np.arange(count) / SAMPLE_RATE_HZ, STANDARD_GRAVITY)
    swing = rotate(motion.q_nb, motion.force_b) - np.array([0.0, 0.0, STANDARD_GRAVITY])
    up = rotate(quaternion_conjugate(motion.q_nb), np.array([0.0, 0.0, 1.0]))
    mean = np.cumsum(motion.force_b, axis=0)
    tilt = np.arctan2(np.linalg.norm(np.cross(mean, up), axis=1), (mean * up).sum(axis=1))
    # largest values from the first pose to each sample
    rate, acceleration = (np.maximum.accumulate(_windowed(x)) for x in (motion.rate_b, swing))
    is_still = (rate <= MOST_TURN_RATE) & (acceleration <= MOST_ACCELERATION) & (tilt <= MOST_TILT_ERROR)
    last = min(round(rest_s * SAMPLE_RATE_HZ), count) - 1
    still_s = (int(np.flatnonzero(is_still)[-1]) + 1) / SAMPLE_RATE_HZ if is_still.any() else 0.0
    return RestQuality(float(rate[last]), float(acceleration[last]), float(tilt[last]), still_s)


def check_rest(spline: PoseSpline, rest_s: float, path: Path) -> None:
    """Raise InputError if a motion does not begin with a rest of the given duration."""
    quality = measure_rest(spline, rest_s)
    if (np.array(quality[:3]) <= (MOST_TURN_RATE, MOST_ACCELERATION, MOST_TILT_ERROR)).all():
        return
    still_s = np.floor(10.0 * quality.still_s) / 10.0
    todo = (
        f"set rest_s = {still_s:g}"
        if still_s >= LEAST_REST_S
        else f"use a recording that begins with at least {LEAST_REST_S:g} s at rest, or set hold = true and rest_s = 6"
    )
    raise InputError(
        f"{path}: the body must be at rest for the first rest_s = {rest_s:g} s, but it turns at up to "
        f"{quality.turn_rate / RADIAN_PER_DEGREE:.3g} deg/s and accelerates by up to {quality.acceleration:.2g} m/s2 (at rest: "
        f"{MOST_TURN_RATE / RADIAN_PER_DEGREE:g} and {MOST_ACCELERATION:g}). The initial tilt would be wrong by "
        f"{quality.tilt_error / RADIAN_PER_DEGREE:.1f} deg. The body is still for {still_s:g} s. To continue, {todo}.",
        **quality._asdict(),
    )


def _windowed(values: FloatArray) -> FloatArray:
    """Return the length of the mean over the window that ends at each sample, 0 before the first whole window."""
    width = round(WINDOW_S * SAMPLE_RATE_HZ)
    sizes = np.linalg.norm(window_sums(values, width) / width, axis=1)
    return np.concatenate((np.zeros(len(values) - len(sizes)), sizes))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedTask:
    """A recorded motion as a task."""

    spline: PoseSpline  # poses
    moving_s: tuple[float, float]  # first and last instant of motion, s from the start
    held_s: float = 0.0  # duration of a rest in the first pose that is put before the recording, s

    @property
    def duration_s(self) -> float:
        """Length, s."""
        start, stop = self.spline.span_s
        return self.held_s + stop - start

    def at(self, time: FloatArray, gravity_m_s2: float) -> Motion:
        """Return the motion at times (N,), s."""
        start = self.spline.span_s[0]
        motion = replace(self.spline.at(time - self.held_s + start, gravity_m_s2), time=time)
        if self.held_s == 0.0:
            return motion
        rest_values = rest_of(motion, self.spline.at(np.array([start]), gravity_m_s2).q_nb)
        rest_values |= {"moving": np.zeros(1), "valid": np.ones(1)}
        values: dict[str, Any] = {name: np.array(getattr(motion, name)) for name in rest_values}
        for name, row in rest_values.items():
            values[name][time < self.held_s] = row
        return replace(motion, **values)


def rest_of(motion: Motion, q_nb: FloatArray) -> dict[str, FloatArray]:
    """Return a row of a motion for a rest in a pose (1, 4), by the fields of a motion."""
    still = np.zeros((1, 3))
    up = rotate(quaternion_conjugate(q_nb), np.array([0.0, 0.0, motion.gravity_m_s2]))
    turning = {} if motion.angular_acceleration_b is None else {"angular_acceleration_b": still}
    return {"q_nb": q_nb, "rate_b": still, "mean_rate_b": still, "force_b": up} | turning


@lru_cache(maxsize=4)
def read_motion(motion: OwnMotion) -> RecordedTask:
    """Read a recorded motion. Raise InputError if it does not begin with its rest."""
    path, rest_s = Path(motion.path), motion.rest_s
    if sha256_of(path) != motion.sha256:
        raise InputError(f"{path}: the file has changed since the study began. Start a new study.")
    reference = read_poses(path, motion)
    spline = fit_pose_spline(reference, SKIN if motion.body else PoseSettings())
    length = spline.span_s[1] - spline.span_s[0]
    problem = ""
    if reference.position is None:
        problem = "the poses have no positions, which the simulation of accelerometers requires"
    elif len(spline.pieces) > 1:
        problem = f"the poses have {len(spline.pieces) - 1} long gaps. Cut the recording between gaps"
    elif motion.hold and rest_s < LEAST_REST_S:
        problem = f"to hold the first pose, rest_s must be {LEAST_REST_S:g} s or more, got {rest_s:g}. The note uses 6"
    elif not motion.hold and not LEAST_REST_S <= rest_s < length - 1.0:
        span = f"{LEAST_REST_S:g} s to {length - 1.0:.1f} s"
        problem = f"rest_s must be {span}, got {rest_s:g}. Set the duration of the rest at the beginning"
    if problem:
        raise InputError(f"{path}: {problem}.")
    if motion.hold:
        return RecordedTask(spline=spline, moving_s=(rest_s, rest_s + length), held_s=rest_s)
    check_rest(spline, rest_s, path)
    return RecordedTask(spline=spline, moving_s=(rest_s, length))


def read_poses(path: Path, how: Posed) -> Reference:
    """Read the poses of a cluster, a file, or a device on a segment (at L5 of a pelvis, at the origin of other segments)."""
    if how.body is None:
        return read_reference(path, labels=how.markers or None, up=how.up)
    if how.markers or how.up is None:
        raise InputError(
            f"{path}: a body requires up and no markers, got {'markers too' if how.markers else 'no up'}. Set body and up."
        )
    offset = L5_OFFSET if how.body == "pelvis" else (0.0, 0.0, 0.0)
    return device_on(find_body(read_markers(path, up=how.up), how.body), offset_b=offset)


def sha256_of(path: Path) -> str:
    """Return the sha256 of a file."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot read the pose or marker file ({error.strerror}). Check the path.") from error


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class MotionEntry(Posed):
    """[task.motion]."""

    file: str = ""  # file of poses or markers, relative to study.toml
    folder: str = ""  # alternative: folder with one file per person
    # alternative: CSV table with columns file (relative to the table), person (one or more files each) and label
    table: str = ""
    label: str = ""  # use only the rows of the table with this label
    rest_s: Positive | None = None  # rest at the start, s (by default it is detected, at most 6 s)
    hold: bool = False  # hold the first pose for ``rest_s`` if a recording has no rest


def recorded_motion(entry: MotionEntry, folder: Path) -> OwnMotion:
    """Return the recorded motion of a plan. Each file is read, so that errors are raised before the workers start."""
    sources = [name for name in ("file", "folder", "table") if getattr(entry, name)]
    if len(sources) != 1 or (entry.label and not entry.table):
        got = " and ".join([*sources, *["label"] * bool(entry.label)]) or "none"
        raise InputError(
            "task.motion: a file, a folder with a file per person, or a table of files and people (optionally with a label) is "
            f"required, got {got}. Set one of them."
        )
    path = folder / str(getattr(entry, sources[0]))
    try:
        files = sorted(file for file in path.iterdir() if file.is_file()) if entry.folder else [path]
        trials = _trials_in(path, entry.label) if entry.table else [[file] for file in files]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot read the {sources[0]} of recorded people ({error}).") from error
    if len(trials) < 3 and not entry.file:
        raise InputError(f"{path}: at least three people are required, got {len(trials)}. Record more people.")
    common = {item.name: getattr(entry, item.name) for item in fields(OwnMotion) if hasattr(entry, item.name)}
    people = []
    for files in trials:
        paths = [file.resolve() for file in files]
        first, *again = (
            OwnMotion(path=str(p), sha256=sha256_of(p), **common | {"rest_s": _rest_in(p, entry)}) for p in paths
        )
        for motion in (first, *again):
            read_motion(motion)
        people.append(replace(first, again=tuple(again)))
    return replace(people[0], others=tuple(people[1:]))


def _trials_in(path: Path, label: str) -> list[list[Path]]:
    """Return the files of each person in a table, from all rows or from the rows with a label."""
    rows = list(csv.DictReader(path.read_text("utf-8-sig").splitlines(), skipinitialspace=True))
    columns, people, files = ["file", "person", *["label"] * bool(label)], dict[str, list[Path]](), set[str]()
    for line, row in enumerate(rows, 2):
        if missing := [name for name in columns if not row.get(name)]:
            raise InputError(
                f"{path}: {', '.join(columns)} are required in each row, got no {missing[0]} in line {line}. Add it."
            )
        if row["file"] in files:
            raise InputError(f"{path}: {row['file']} is listed again in line {line}. Delete a line.")
        files.add(row["file"])
        if not label or row["label"] == label:
            people.setdefault(row["person"], []).append(path.parent / row["file"])
    if rows and not people:
        labels = ", ".join(dict.fromkeys(row["label"] for row in rows))
        raise InputError(f"{path}: no row has the label {label}. Use one of {labels}.")
    return list(people.values())


def _rest_in(path: Path, entry: MotionEntry) -> float:
    """Return the rest in the entry or, by default, the detected rest at the start of a recording, s."""
    if entry.rest_s is not None or entry.hold:
        return entry.rest_s or LONGEST_REST_S
    reference = read_poses(path, entry)
    spline = fit_pose_spline(reference, SKIN if entry.body else PoseSettings())
    still_s = float(np.floor(10.0 * measure_rest(spline, LEAST_REST_S).still_s) / 10.0)
    return min(max(still_s, LEAST_REST_S), LONGEST_REST_S)  # read_motion raises an error if it is too short
