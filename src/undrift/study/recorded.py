"""Recorded people as a task of a study: poses of a device at L5 or on another segment, the rest before, people in a table.

A recorded motion must begin at rest. Three figures of its first ``rest_s`` seconds, rates and accelerations as means over 0.25 s::

    w    |mean of w_b|                          how fast the body turns
    a    |mean of p''|                          how fast its velocity changes
    e    angle(mean of f_b, R_nb^T z)           tilt error of a device without errors at the end of that time
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
    """How the poses of a device are found in a file of poses or markers."""

    markers: tuple[str, ...] = ()  # Labels of one rigid cluster, for TRC or C3D
    # Or the segment that the device is worn on, found by its markers: pelvis (the device sits at L5) or trunk
    body: BodyName | None = None
    up: Literal["y", "z"] | None = None  # Laboratory axis that points up, for markers


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnMotion(Posed):
    """A recorded motion: every subject performs it, or that of one of several people, each with another unit of the device."""

    path: str  # File of poses or markers; workers read it there
    sha256: str  # Of its content
    rest_s: float  # How long the body is at rest at the beginning, s
    hold: bool = False  # The recording has no rest: its first pose is held for ``rest_s`` before it
    others: tuple["OwnMotion", ...] = ()  # Of further people
    again: tuple["OwnMotion", ...] = ()  # Further trials of the same person

    @property
    def people(self) -> int:
        """How many were recorded."""
        return 1 + len(self.others)

    def of(self, number: int) -> tuple["OwnMotion", ...]:
        """Return the trials of a subject."""
        person = (self, *self.others)[number % self.people]
        return (person, *person.again)


# ---- recorded motions

SAMPLE_RATE_HZ = 100.0
WINDOW_S = 0.25
LEAST_REST_S = 0.5  # the initial tilt is a mean over the rest
LONGEST_REST_S = 6.0  # as in the note; the remaining recording counts as motion
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
    """Measure how still a body is at the beginning of its poses."""
    start, stop = spline.span_s
    count = int((stop - start) * SAMPLE_RATE_HZ)
    motion = spline.at(start + np.arange(count) / SAMPLE_RATE_HZ, STANDARD_GRAVITY)
    swing = rotate(motion.q_nb, motion.force_b) - np.array([0.0, 0.0, STANDARD_GRAVITY])
    up = rotate(quaternion_conjugate(motion.q_nb), np.array([0.0, 0.0, 1.0]))
    mean = np.cumsum(motion.force_b, axis=0)
    tilt = np.arctan2(np.linalg.norm(np.cross(mean, up), axis=1), (mean * up).sum(axis=1))
    # by the number of samples since the first pose: what the time up to there shows
    rate, acceleration = (np.maximum.accumulate(_windowed(x)) for x in (motion.rate_b, swing))
    kept = (rate <= MOST_TURN_RATE) & (acceleration <= MOST_ACCELERATION) & (tilt <= MOST_TILT_ERROR)
    last = min(round(rest_s * SAMPLE_RATE_HZ), count) - 1
    still_s = (int(np.flatnonzero(kept)[-1]) + 1) / SAMPLE_RATE_HZ if kept.any() else 0.0
    return RestQuality(float(rate[last]), float(acceleration[last]), float(tilt[last]), still_s)


def check_rest(spline: PoseSpline, rest_s: float, path: Path) -> None:
    """Refuse a motion that does not begin with the rest that is stated."""
    found = measure_rest(spline, rest_s)
    if (np.array(found[:3]) <= (MOST_TURN_RATE, MOST_ACCELERATION, MOST_TILT_ERROR)).all():
        return
    still_s = np.floor(10.0 * found.still_s) / 10.0
    todo = (
        f"set rest_s = {still_s:g}"
        if still_s >= LEAST_REST_S
        else f"take a recording that begins with {LEAST_REST_S:g} s at rest or more, or set hold = true and rest_s = 6"
    )
    raise InputError(
        f"{path}: wanted a body at rest for its first rest_s = {rest_s:g} s, got one that turns at up to "
        f"{found.turn_rate / RADIAN_PER_DEGREE:.3g} deg/s and accelerates by up to {found.acceleration:.2g} m/s2 (at rest: "
        f"{MOST_TURN_RATE / RADIAN_PER_DEGREE:g} and {MOST_ACCELERATION:g}), for which the first tilt alone would be wrong by "
        f"{found.tilt_error / RADIAN_PER_DEGREE:.1f} deg; it is still for {still_s:g} s: {todo}",
        **found._asdict(),
    )


def _windowed(values: FloatArray) -> FloatArray:
    """Return the size of the mean over the window that ends at each sample; 0 before the first whole one: cameras are noisy."""
    width = round(WINDOW_S * SAMPLE_RATE_HZ)
    whole = np.linalg.norm(window_sums(values, width) / width, axis=1)
    return np.concatenate((np.zeros(len(values) - len(whole)), whole))


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
        held = rest_of(motion, self.spline.at(np.array([start]), gravity_m_s2).q_nb)
        held |= {"moving": np.zeros(1), "valid": np.ones(1)}
        kept: dict[str, Any] = {name: np.array(getattr(motion, name)) for name in held}
        for name, row in held.items():
            kept[name][time < self.held_s] = row
        return replace(motion, **kept)


def rest_of(motion: Motion, q_nb: FloatArray) -> dict[str, FloatArray]:
    """Return a row of a motion for a rest in a pose (1, 4), by the fields of a motion."""
    still = np.zeros((1, 3))
    up = rotate(quaternion_conjugate(q_nb), np.array([0.0, 0.0, motion.gravity_m_s2]))
    turning = {} if motion.angular_acceleration_b is None else {"angular_acceleration_b": still}
    return {"q_nb": q_nb, "rate_b": still, "mean_rate_b": still, "force_b": up} | turning


@lru_cache(maxsize=4)
def read_motion(own: OwnMotion) -> RecordedTask:
    """Read a recorded motion, and refuse one that does not begin with the rest that is stated."""
    path, rest_s = Path(own.path), own.rest_s
    if sha256_of(path) != own.sha256:
        raise InputError(f"{path}: wanted the file that the study began with, got another content; start a new study")
    reference = read_poses(path, own)
    spline = fit_pose_spline(reference, SKIN if own.body else PoseSettings())
    length = spline.span_s[1] - spline.span_s[0]
    refused = ""
    if reference.position is None:
        refused = "poses with positions, got none; accelerometers cannot be simulated without them"
    elif len(spline.pieces) > 1:
        refused = f"poses without long gaps, got {len(spline.pieces) - 1}; cut the recording between gaps"
    elif own.hold and rest_s < LEAST_REST_S:
        refused = f"a rest_s of {LEAST_REST_S:g} s or more to hold the first pose for, got {rest_s:g}; 6 is the note's"
    elif not own.hold and not LEAST_REST_S <= rest_s < length - 1.0:
        span = f"{LEAST_REST_S:g} s to {length - 1.0:.1f} s"
        refused = f"a rest_s of {span}, got {rest_s:g}; state how long the body is at rest at the beginning"
    if refused:
        raise InputError(f"{path}: wanted {refused}")
    if own.hold:
        return RecordedTask(spline=spline, moving_s=(rest_s, rest_s + length), held_s=rest_s)
    check_rest(spline, rest_s, path)
    return RecordedTask(spline=spline, moving_s=(rest_s, length))


def read_poses(path: Path, how: Posed) -> Reference:
    """Read the poses of a cluster or file, or of a device on a segment: at L5 on a pelvis, at the origin of another."""
    if how.body is None:
        return read_reference(path, labels=how.markers or None, up=how.up)
    if how.markers or how.up is None:
        raise InputError(f"{path}: wanted a body and up, got {'markers too' if how.markers else 'no up'}; name the two")
    offset = L5_OFFSET if how.body == "pelvis" else (0.0, 0.0, 0.0)
    return device_on(find_body(read_markers(path, up=how.up), how.body), offset_b=offset)


def sha256_of(path: Path) -> str:
    """Return the mark of a file's content."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: wanted a file of poses or markers, got {error.strerror}; check the path") from error


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class MotionEntry(Posed):
    """[task.motion]."""

    file: str = ""  # file of poses or markers, relative to study.toml
    folder: str = ""  # alternative: folder with one file per person
    # alternative: CSV table with columns file (relative to the table), person (one or more files each) and label
    table: str = ""
    label: str = ""  # use only the rows of the table with this label
    rest_s: Positive | None = None  # rest at the start, s; if not given, it is detected, at most 6 s
    hold: bool = False  # Hold the first pose for ``rest_s`` before a recording that has no rest


def recorded_motion(entry: MotionEntry, folder: Path) -> OwnMotion:
    """Return the recorded motion of a plan; each file is read, so that one is refused now rather than by a worker."""
    named = [name for name in ("file", "folder", "table") if getattr(entry, name)]
    if len(named) != 1 or (entry.label and not entry.table):
        got = " and ".join([*named, *["label"] * bool(entry.label)]) or "none"
        raise InputError(
            "task.motion: wanted a file, a folder with one of each person, or a table of files and people (and with it a label), "
            f"got {got}; name one"
        )
    path = folder / str(getattr(entry, named[0]))
    try:
        files = sorted(one for one in path.iterdir() if one.is_file()) if entry.folder else [path]
        trials = _trials_in(path, entry.label) if entry.table else [[one] for one in files]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: wanted a {named[0]} of recorded people, got {error}") from error
    if len(trials) < 3 and not entry.file:
        raise InputError(f"{path}: wanted three people or more, got {len(trials)}; record more")
    given = {item.name: getattr(entry, item.name) for item in fields(OwnMotion) if hasattr(entry, item.name)}
    people = []
    for files in trials:
        paths = [one.resolve() for one in files]
        first, *again = (
            OwnMotion(path=str(one), sha256=sha256_of(one), **given | {"rest_s": _rest_in(one, entry)}) for one in paths
        )
        for motion in (first, *again):
            read_motion(motion)
        people.append(replace(first, again=tuple(again)))
    return replace(people[0], others=tuple(people[1:]))


def _trials_in(path: Path, label: str) -> list[list[Path]]:
    """Return the files of each person in a table, of the rows with a label where one is given."""
    rows = list(csv.DictReader(path.read_text("utf-8-sig").splitlines(), skipinitialspace=True))
    wanted, people, seen = ["file", "person", *["label"] * bool(label)], dict[str, list[Path]](), set[str]()
    for line, row in enumerate(rows, 2):
        if missing := [name for name in wanted if not row.get(name)]:
            raise InputError(
                f"{path}: wanted {', '.join(wanted)} in each row, got no {missing[0]} in line {line}; add it"
            )
        if row["file"] in seen:
            raise InputError(f"{path}: wanted each file once, got {row['file']} again in line {line}; delete one")
        seen.add(row["file"])
        if not label or row["label"] == label:
            people.setdefault(row["person"], []).append(path.parent / row["file"])
    if rows and not people:
        labels = ", ".join(dict.fromkeys(row["label"] for row in rows))
        raise InputError(f"{path}: wanted one of its labels {labels}, got {label}; name one")
    return list(people.values())


def _rest_in(path: Path, entry: MotionEntry) -> float:
    """Return the rest that is stated, or that a recording begins with, s."""
    if entry.rest_s is not None or entry.hold:
        return entry.rest_s or LONGEST_REST_S
    reference = read_poses(path, entry)
    spline = fit_pose_spline(reference, SKIN if entry.body else PoseSettings())
    still_s = float(np.floor(10.0 * measure_rest(spline, LEAST_REST_S).still_s) / 10.0)
    return min(max(still_s, LEAST_REST_S), LONGEST_REST_S)  # one that is too short is refused when the motion is read
