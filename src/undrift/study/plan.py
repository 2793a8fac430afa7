"""Plan of a study: which tasks, whose, with which device, and which protocols are tried; recorded motions as tasks.

A candidate is a Protocol: cut-off frequency, omega_m, omega_M and step vary as in the note, the rest comes from the plan. Every
combination of the four whose step divides the span is a candidate. study.toml holds a plan (docs/study.md shows one). The note's
study is a preset; spaces surround its values; dwell, brackets and set-points are choices, since it does not give them.

A recorded motion must begin at rest. Three figures of its first ``rest_s`` seconds, rates and accelerations as means over 0.25 s::

    w    |mean of w_b|                          how fast the body turns
    a    |mean of p''|                          how fast its velocity changes
    e    angle(mean of f_b, R_nb^T z)           tilt error of a device without errors at the end of that time
"""

import hashlib
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args

import numpy as np
from pydantic import Field

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import Entry, read_toml
from undrift.frames import quaternion_conjugate, rotate
from undrift.io.formats import read_markers, read_reference
from undrift.io.mocap import Up
from undrift.io.reference import L5_OFFSET, BodyName, device_on, find_body
from undrift.record import Reference
from undrift.rig.programme import GridRule, Protocol
from undrift.sim.device.model import device_json, read_device
from undrift.sim.device.presets import PRESETS
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, PoseSpline, fit_pose_spline
from undrift.sim.motion.tasks import Group, TaskName
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

Objective = Literal["rms", "maximum"]
Search = Literal["grid", "halving"]
Grid = tuple[float, float, float]
TURN_RATES = ("turn_rate_step", "turn_rate_min", "turn_rate_max")


@dataclass(frozen=True, slots=True, kw_only=True)
class Untried:
    """A value of the plan that no protocol has."""

    parameter: str  # turn_rate_step, turn_rate_min or turn_rate_max
    value: float  # rad/s
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Space:
    """The values that are tried."""

    cutoff_hz: tuple[float, ...]  # Of the low-pass
    turn_rate_step: tuple[float, ...]  # d, rad/s
    turn_rate_min: tuple[float, ...]  # omega_m, rad/s
    turn_rate_max: tuple[float, ...]  # omega_M, rad/s
    only: tuple[Grid, ...] = ()  # Of the combinations of the three these and no others, where given

    def numbered_grids(self) -> Iterator[tuple[int, Grid]]:
        """Return the combinations of step, omega_m and omega_M whose step divides the span, numbered without ``only``."""
        number = 0
        for step, low, high in product(self.turn_rate_step, self.turn_rate_min, self.turn_rate_max):
            count = (high - low) / step
            if high > low and abs(count - round(count)) < 1e-6:
                if not self.only or (step, low, high) in self.only:
                    yield number, (step, low, high)
                number += 1

    def grids(self) -> Iterator[Grid]:
        """Return the combinations of step, omega_m and omega_M that are tried."""
        return (grid for _, grid in self.numbered_grids())

    def untried(self) -> tuple[Untried, ...]:
        """Return the rates and steps that no combination has, and why."""
        if self.only:
            return ()
        tried = list(self.grids())
        lows, highs = self.turn_rate_min, self.turn_rate_max
        rows = []
        for place, name in enumerate(TURN_RATES):
            for value in getattr(self, name):
                if any(grid[place] == value for grid in tried):
                    continue
                if name == "turn_rate_min" and value >= max(highs):
                    reason = "not below any omega_M"
                elif name == "turn_rate_max" and value <= min(lows):
                    reason = "not above any omega_m"
                elif name == "turn_rate_step":
                    reason = "divides no span from an omega_m to an omega_M"
                else:
                    reason = "no step divides a span that it ends"
                rows.append(Untried(parameter=name, value=value, reason=reason))
        return tuple(rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnMotion:
    """A recorded motion: every subject performs it, each with another unit of the device."""

    path: str  # File of poses or markers; workers read it there
    sha256: str  # Of its content
    rest_s: float  # How long the body is at rest at the beginning, s
    markers: tuple[str, ...] = ()  # Labels of one rigid cluster, for TRC or C3D
    # Or the segment that the device is worn on, found by its markers: pelvis (the device sits at L5), thorax or trunk
    body: BodyName | None = None
    up: Literal["y", "z"] | None = None  # Laboratory axis that points up, for markers
    hold: bool = False  # The recording has no rest: its first pose is held for ``rest_s`` before it


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyTask:
    """One task of a study."""

    name: str  # sit_to_stand, step, posturography or free; any word for a motion of one's own
    space: Space  # What is tried
    base: Protocol  # All that is not varied: dwell, brackets, temperatures
    motion: OwnMotion | None = None  # Performed in place of the library's task

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_]+", self.name):
            raise InputError(f"task: wanted a name of letters, digits and _, got '{self.name}'; rename it")
        if self.motion is None and self.name not in get_args(TaskName):
            raise InputError(
                f"task: wanted one of {', '.join(get_args(TaskName))}, got '{self.name}'; name one, or give a motion of your own"
            )

    def candidates(self, cutoff_hz: float) -> tuple[Protocol, ...]:
        """Return the protocols that are tried with one cut-off frequency."""
        return tuple(
            replace(self.base, cutoff_hz=cutoff_hz, turn_rate_step=step, turn_rate_min=low, turn_rate_max=high)
            for step, low, high in self.space.grids()
        )

    def protocols(self) -> tuple[Protocol, ...]:
        """Return all protocols that are tried, by cut-off frequency, then by grid."""
        return tuple(protocol for cutoff in self.space.cutoff_hz for protocol in self.candidates(cutoff))


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A study."""

    name: str  # For people
    # Kind of device, one of the presets; every subject wears a unit of its own. For people where ``worn`` is given
    device: str
    tasks: tuple[StudyTask, ...]  # One or more
    subjects: int = 30  # How many, from the cohort
    group: Group = "simulation"  # simulation or testing, as in the note's Table 2
    # Board temperature of the trials above the calibration's, least and greatest, K
    excursion_k: tuple[float, float] = (10.0, 15.0)
    objective: Objective = "rms"  # rms or maximum of the pitch error
    search: Search = "grid"  # Every protocol on every subject, or successive halving
    level: float = 0.05  # Of the tests
    rig_minutes_max: float | None = None  # Longest session that is allowed, min
    seed: int = 0  # Same seed, same bits
    worn: str = ""  # Text of a device.json, which every subject wears; none draws units of ``device``

    def __post_init__(self) -> None:
        names = [task.name for task in self.tasks]
        if len(set(names)) < len(names):
            raise InputError(f"study: wanted another name for each task, got {', '.join(names)}; rename one")
        if not self.tasks or self.subjects < 3:
            raise InputError(
                f"study: wanted a task or more and three subjects or more, got {len(self.tasks)} and {self.subjects}"
            )
        for task in self.tasks:
            if not task.space.cutoff_hz or not any(True for _ in task.space.grids()):
                raise InputError(
                    f"study: wanted protocols to try for {task.name}, got none; give cut-offs, and steps that divide the span"
                )
        if not self.excursion_k[0] <= self.excursion_k[1]:
            raise InputError(
                f"study: wanted excursion_k as least and greatest, got {self.excursion_k[0]:g} and {self.excursion_k[1]:g}"
            )


def ends_of(study: Study) -> Study:
    """Return a study of the first and last value of everything that it tries: a first look."""
    tasks = []
    for task in study.tasks:
        tried = {name: getattr(task.space, name) for name in ("cutoff_hz", *TURN_RATES)}
        ends = Space(**{name: v if len(v) < 3 else (v[0], v[-1]) for name, v in tried.items()})
        tasks.append(replace(task, space=ends) if any(True for _ in ends.grids()) else task)
    return replace(study, tasks=tuple(tasks))


# ---- the note's study as a preset

DEVICE = "enc03j_3031"
SET_POINTS_C = (18.0, 30.0, 45.0, 60.0, 75.0)
CUTOFFS_HZ = (5.0, 7.0, 9.0, 11.1, 13.0, 16.0, 20.0, 25.0, 30.0, 40.0)  # 11.1: each task's own in its place


@dataclass(frozen=True, slots=True)
class NoteRow:
    """A row of the note's Table 1."""

    cutoff_hz: float  # Hz
    turn_rate_step_dps: float  # deg/s
    turn_rate_min_dps: float  # deg/s
    turn_rate_max_dps: float  # deg/s
    p_value: float  # Printed as statistical significance
    erratum: str = ""  # What is printed and not meant


TABLE_1: dict[TaskName, NoteRow] = {
    "sit_to_stand": NoteRow(11.1, 5.0, 5.0, 90.0, 0.048),
    "step": NoteRow(11.4, 3.0, 3.0, 45.0, 0.040, erratum="printed 111.4 Hz; lies between 11.1 and 11.5"),
    "posturography": NoteRow(11.5, 0.1, 0.1, 5.0, 0.049),
}
Rates = tuple[float, ...]
TRIED_DPS: dict[TaskName, tuple[Rates, Rates, Rates]] = {  # step, omega_m, omega_M
    "sit_to_stand": ((5, 10, 15, 20), (5, 10, 15, 20), (50, 60, 70, 80, 90)),
    "step": ((3, 6, 9, 12), (3, 6, 9, 12), (21, 27, 33, 39, 45)),
    "posturography": ((0.1, 0.2, 0.3, 0.4), (0.1, 0.2, 0.3, 0.4), (3.0, 3.5, 4.0, 4.5, 5.0)),
}


def note_study(*, subjects: int = 30, seed: int = 0, quick: bool = False) -> Study:
    """Return the note's study."""
    tasks = []
    for name, (steps, lows, highs) in TRIED_DPS.items():
        own = TABLE_1[name].cutoff_hz
        cutoffs = tuple(own if f == 11.1 else f for f in CUTOFFS_HZ)
        if quick:
            steps, lows, highs, cutoffs = steps[:2], lows[:1], highs[-3::2], (cutoffs[0], own)
        base = Protocol(name=name, grid="paper", dwell_s=2.0, bracket_s=6.0, temperatures_c=SET_POINTS_C)
        tasks.append(StudyTask(name=name, space=_space(cutoffs, steps, lows, highs), base=base))
    return Study(name="note", device=DEVICE, tasks=tuple(tasks), subjects=subjects, seed=seed)


def _space(cutoff_hz: Rates, steps_dps: Rates, lows_dps: Rates, highs_dps: Rates) -> Space:
    step, low, high = (tuple(v * RADIAN_PER_DEGREE for v in rates) for rates in (steps_dps, lows_dps, highs_dps))
    return Space(cutoff_hz=tuple(cutoff_hz), turn_rate_step=step, turn_rate_min=low, turn_rate_max=high)


# ---- recorded motion as a task

SAMPLE_RATE_HZ = 100.0
WINDOW_S = 0.25
LEAST_REST_S = 0.5  # the tilt at the start is a mean over the rest
# People who stand quietly keep to 1.4 deg/s, 0.03 m/s2 and 0.6 deg over 5 s at the pelvis; who has begun to rise is at 10 deg/s.
MOST_TURN_RATE = 5.0 * RADIAN_PER_DEGREE  # rad/s
MOST_ACCELERATION = 0.3  # m/s2
MOST_TILT_ERROR = 1.0 * RADIAN_PER_DEGREE  # rad
SKIN = PoseSettings(cutoff_hz=10.0, position_cutoff_hz=6.0)  # markers on skin: what is above is not the bone


class Rest(NamedTuple):
    """How still a body is for a time from the first pose on, and how long it is."""

    turn_rate: float  # Largest, rad/s
    acceleration: float  # Largest, m/s2
    tilt_error: float  # Of a device without errors, at the end of the time, rad
    still_s: float  # How long the body truly is still, s


def measure_rest(spline: PoseSpline, rest_s: float) -> Rest:
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
    return Rest(float(rate[last]), float(acceleration[last]), float(tilt[last]), still_s)


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
    """Return the size of the mean over the window that ends at each sample; over what there is before the first whole one."""
    n, width = len(values), max(round(WINDOW_S * SAMPLE_RATE_HZ), 1)
    total = np.concatenate((np.zeros((1, 3)), np.cumsum(values, axis=0)))
    ends = np.arange(1, n + 1)
    first = np.maximum(ends - width, 0)
    size: FloatArray = np.linalg.norm((total[ends] - total[first]) / (ends - first)[:, None], axis=1)
    size[: min(width, n) - 1] = 0.0  # a shorter mean would let the noise of cameras count
    return size


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedTask:
    """A recorded motion as a task."""

    spline: PoseSpline  # The poses
    moving_s: tuple[float, float]  # First and last instant of motion, s from the beginning
    held_s: float = 0.0  # How long the first pose is held before the recording begins, s

    @property
    def duration_s(self) -> float:
        """Length, s."""
        start, stop = self.spline.span_s
        return self.held_s + stop - start

    def at(self, time: FloatArray, gravity_m_s2: float) -> Motion:
        """Return the motion at given instants: time (N,)."""
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
    reference = read_poses(path, body=own.body, markers=own.markers, up=own.up)
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


def read_poses(path: Path, *, body: BodyName | None, markers: tuple[str, ...], up: Up | None) -> Reference:
    """Read the poses of a cluster or file, or of a device on a segment: at L5 on a pelvis, at the origin of another."""
    if body is None:
        return read_reference(path, labels=markers or None, up=up)
    if markers or up is None:
        raise InputError(f"{path}: wanted a body and up, got {'markers too' if markers else 'no up'}; name the two")
    offset = L5_OFFSET if body == "pelvis" else (0.0, 0.0, 0.0)
    return device_on(find_body(read_markers(path, up=up), body), offset_b=offset)


def sha256_of(path: Path) -> str:
    """Return the mark of a file's content."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: wanted a file of poses or markers, got {error.strerror}; check the path") from error


# ---- study.toml

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Values = Annotated[list[Positive], Field(min_length=1)]


class SpaceEntry(Entry):
    """[task.space]."""

    cutoff_hz: Values  # Of the low-pass, Hz
    turn_rate_step_dps: Values  # d
    turn_rate_min_dps: Values  # omega_m
    turn_rate_max_dps: Values  # omega_M


class ProtocolEntry(Entry):
    """[task.protocol]."""

    dwell_s: Positive = 2.0  # At a rate
    bracket_s: Positive = 6.0  # At rest around a block of rates
    face_s: Positive = 6.0  # On a face
    grid: GridRule = "paper"  # paper or inclusive
    # Of the chamber, degC, rising; empty stays at room temperature
    set_points_c: list[Finite] = Field(default_factory=lambda: list(SET_POINTS_C))


class MotionEntry(Entry):
    """[task.motion]."""

    file: str  # Poses or markers, from the folder of study.toml
    rest_s: Positive  # Rest at the beginning, s
    markers: list[str] = Field(default_factory=list)  # Labels of one rigid cluster, for TRC or C3D
    body: BodyName | None = None  # Or pelvis, thorax or trunk, found by its markers
    up: Literal["y", "z"] | None = None  # Laboratory axis that points up, for markers
    hold: bool = False  # Hold the first pose for ``rest_s`` before a recording that has no rest


class TaskEntry(Entry):
    """[[task]]."""

    name: str  # Of the task
    space: SpaceEntry  # What is tried
    protocol: ProtocolEntry = ProtocolEntry()  # What is not varied
    motion: MotionEntry | None = None  # In place of a drawn performance


class StudyEntry(Entry):
    """[study]."""

    name: str = ""  # For people
    device: str = DEVICE  # Preset, or path of a device.json
    subjects: Annotated[int, Field(ge=3)] = 30  # How many
    group: Group = "simulation"  # simulation or testing
    # Least and greatest, K
    excursion_k: Annotated[list[Finite], Field(min_length=2, max_length=2)] = Field(
        default_factory=lambda: [10.0, 15.0]
    )
    objective: Objective = "rms"  # rms or maximum
    search: Search = "grid"  # or halving: the better part of the protocols meets more subjects
    level: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.05  # Of the tests
    rig_minutes_max: Positive | None = None  # Longest session, min
    seed: Annotated[int, Field(ge=0)] = 0  # Same seed, same bits


class StudyFile(Entry):
    """The whole file."""

    study: StudyEntry = StudyEntry()  # What holds for all tasks
    task: Annotated[list[TaskEntry], Field(min_length=1)]  # One or more


def read_study(path: str | Path) -> Study:
    """Read a study."""
    held, folder = read_toml(path, StudyFile), Path(path).parent
    head = held.study
    given = head.model_dump() | {"name": head.name or Path(path).stem, "excursion_k": tuple(head.excursion_k)}
    try:
        if head.device not in PRESETS:
            given |= {"device": Path(head.device).stem, "worn": _device_text(folder / head.device, head.device)}
        return Study(**given, tasks=tuple(_task_of(entry, folder) for entry in held.task))
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _task_of(entry: TaskEntry, folder: Path) -> StudyTask:
    base = entry.protocol.model_dump(exclude={"set_points_c"})
    motion = None
    if entry.motion is not None:
        file = (folder / entry.motion.file).resolve()
        given = entry.motion.model_dump(exclude={"file"}) | {"markers": tuple(entry.motion.markers)}
        motion = OwnMotion(path=str(file), sha256=sha256_of(file), **given)
        read_motion(motion)  # refused now rather than by a worker
    return StudyTask(
        name=entry.name,
        space=_space(*map(tuple, entry.space.model_dump().values())),
        base=Protocol(name=entry.name, temperatures_c=tuple(entry.protocol.set_points_c), **base),
        motion=motion,
    )


def _device_text(path: Path, head: str) -> str:
    """Return a device.json in one spelling, after it was read as a device."""
    if not path.exists():
        raise InputError(f"device: wanted one of {', '.join(PRESETS)} or a device.json, got '{head}'; name one of them")
    return json.dumps(device_json(read_device(path)), sort_keys=True)
