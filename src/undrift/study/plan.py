"""Plan of a study: which tasks, whose, with which device, and which protocols are tried.

A candidate is a Protocol: cut-off frequency, omega_m, omega_M and step vary as in the note, the rest comes from the plan. Every
combination of the four whose step divides the span is a candidate. study.toml holds a plan (docs/study.md shows one):

    [study]  name device subjects group excursion_k objective search level rig_minutes_max seed
    [[task]] name; [task.space] what is tried; [task.protocol] what is not varied; [task.motion] an own motion

The note's study is a preset: its three tasks, its device, its Table 1. Spaces surround the note's values; dwell, brackets and
set-points are choices, since the note does not give them.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import Field

from undrift.errors import FileFormatError, InputError
from undrift.files import Entry, read_toml
from undrift.io.reference import BodyName
from undrift.rig.programme import GridRule, Protocol
from undrift.sim.device.presets import PRESETS
from undrift.sim.motion.tasks import Group, TaskName
from undrift.units import RADIAN_PER_DEGREE

Objective = Literal["rms", "maximum"]
Search = Literal["grid", "halving"]
Grid = tuple[float, float, float]


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
        for place, name in enumerate(("turn_rate_step", "turn_rate_min", "turn_rate_max")):
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
        values = (
            getattr(task.space, name) for name in ("cutoff_hz", "turn_rate_step", "turn_rate_min", "turn_rate_max")
        )
        cutoffs, steps, lows, highs = (v if len(v) < 3 else (v[0], v[-1]) for v in values)
        ends = Space(cutoff_hz=cutoffs, turn_rate_step=steps, turn_rate_min=lows, turn_rate_max=highs)
        tasks.append(replace(task, space=ends) if any(True for _ in ends.grids()) else task)
    return replace(study, tasks=tuple(tasks))


# ---- the note's study as a preset

DEVICE = "enc03j_3031"
SET_POINTS_C = (18.0, 30.0, 45.0, 60.0, 75.0)
CUTOFFS_HZ = (5.0, 7.0, 9.0, 11.1, 13.0, 16.0, 20.0, 25.0, 30.0, 40.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoteRow:
    """A row of the note's Table 1."""

    cutoff_hz: float  # Hz
    turn_rate_step_dps: float  # deg/s
    turn_rate_min_dps: float  # deg/s
    turn_rate_max_dps: float  # deg/s
    p_value: float  # Printed as statistical significance
    erratum: str = ""  # What is printed and not meant


TABLE_1: dict[TaskName, NoteRow] = {
    "sit_to_stand": NoteRow(
        cutoff_hz=11.1, turn_rate_step_dps=5.0, turn_rate_min_dps=5.0, turn_rate_max_dps=90.0, p_value=0.048
    ),
    "step": NoteRow(
        cutoff_hz=11.4,
        turn_rate_step_dps=3.0,
        turn_rate_min_dps=3.0,
        turn_rate_max_dps=45.0,
        p_value=0.040,
        erratum="printed 111.4 Hz; lies between 11.1 and 11.5",
    ),
    "posturography": NoteRow(
        cutoff_hz=11.5, turn_rate_step_dps=0.1, turn_rate_min_dps=0.1, turn_rate_max_dps=5.0, p_value=0.049
    ),
}


def note_study(*, subjects: int = 30, seed: int = 0, quick: bool = False) -> Study:
    """Return the note's study."""
    tasks = (
        _task("sit_to_stand", (5, 10, 15, 20), (5, 10, 15, 20), (50, 60, 70, 80, 90), 1.0, quick),
        _task("step", (3, 6, 9, 12), (3, 6, 9, 12), (21, 27, 33, 39, 45), 1.0, quick),
        _task("posturography", (1, 2, 3, 4), (1, 2, 3, 4), (30, 35, 40, 45, 50), 0.1, quick),
    )
    return Study(name="note", device=DEVICE, tasks=tasks, subjects=subjects, seed=seed)


def _task(
    name: TaskName,
    steps: tuple[int, ...],
    lows: tuple[int, ...],
    highs: tuple[int, ...],
    unit_dps: float,
    quick: bool,
) -> StudyTask:
    own = TABLE_1[name].cutoff_hz
    cutoffs = tuple(own if f == CUTOFFS_HZ[3] else f for f in CUTOFFS_HZ)
    if quick:
        steps, lows, highs, cutoffs = steps[:2], lows[:1], highs[-3::2], (cutoffs[0], own)
    in_si = [tuple(round(v * unit_dps, 9) * RADIAN_PER_DEGREE for v in values) for values in (steps, lows, highs)]
    return StudyTask(
        name=name,
        space=Space(cutoff_hz=cutoffs, turn_rate_step=in_si[0], turn_rate_min=in_si[1], turn_rate_max=in_si[2]),
        base=Protocol(name=name, grid="paper", dwell_s=2.0, bracket_s=6.0, temperatures_c=SET_POINTS_C),
    )


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
    held = read_toml(path, StudyFile)
    folder, head = Path(path).parent, held.study
    try:
        return Study(
            name=head.name or Path(path).stem,
            device=head.device if head.device in PRESETS else Path(head.device).stem,
            worn="" if head.device in PRESETS else _device_text(folder / head.device, head.device),
            tasks=tuple(_task_file(entry, folder) for entry in held.task),
            subjects=head.subjects,
            group=head.group,
            excursion_k=(head.excursion_k[0], head.excursion_k[1]),
            objective=head.objective,
            search=head.search,
            level=head.level,
            rig_minutes_max=head.rig_minutes_max,
            seed=head.seed,
        )
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _task_file(entry: TaskEntry, folder: Path) -> StudyTask:
    from undrift.study.case import read_motion, sha256_of

    space, base, motion = entry.space, entry.protocol, None
    if entry.motion is not None:
        file = (folder / entry.motion.file).resolve()
        motion = OwnMotion(
            path=str(file),
            sha256=sha256_of(file),
            rest_s=entry.motion.rest_s,
            markers=tuple(entry.motion.markers),
            body=entry.motion.body,
            up=entry.motion.up,
            hold=entry.motion.hold,
        )
        read_motion(motion)  # refused now rather than by a worker
    return StudyTask(
        name=entry.name,
        space=Space(
            cutoff_hz=tuple(space.cutoff_hz),
            turn_rate_step=_si(space.turn_rate_step_dps),
            turn_rate_min=_si(space.turn_rate_min_dps),
            turn_rate_max=_si(space.turn_rate_max_dps),
        ),
        base=Protocol(
            name=entry.name,
            grid=base.grid,
            dwell_s=base.dwell_s,
            bracket_s=base.bracket_s,
            face_s=base.face_s,
            temperatures_c=tuple(base.set_points_c),
        ),
        motion=motion,
    )


def _si(values_dps: list[float]) -> tuple[float, ...]:
    return tuple(value * RADIAN_PER_DEGREE for value in values_dps)


def _device_text(path: Path, head: str) -> str:
    """Return a device.json in one spelling, after it was read as a device."""
    import json

    from undrift.sim.device.model import device_json, read_device

    if not path.exists():
        raise InputError(f"device: wanted one of {', '.join(PRESETS)} or a device.json, got '{head}'; name one of them")
    return json.dumps(device_json(read_device(path)), sort_keys=True)
