"""study.toml: which tasks, whose, with which device, and which protocols are tried.

[study]
name = "my laboratory"
device = "enc03j_3031"              # a preset: every subject wears a unit of its own; or a device.json, as a twin is
subjects = 30
group = "simulation"                # or testing: the note's Table 2
excursion_k = [10.0, 15.0]          # board above the calibration's room temperature in the trials
objective = "rms"                   # or maximum, of the pitch error
level = 0.05
rig_minutes_max = 240.0             # leave out for no limit
seed = 0
[[task]]
name = "sit_to_stand"               # step, posturography, free; any word with [task.motion]
[task.space]                        # every combination whose step divides the span is tried
cutoff_hz = [5.0, 11.1, 20.0]
turn_rate_step_dps = [5.0, 10.0]
turn_rate_min_dps = [5.0]
turn_rate_max_dps = [45.0, 90.0]
[task.protocol]                     # what is not varied; leave out for the note's
dwell_s = 2.0
bracket_s = 6.0
face_s = 6.0
grid = "paper"
set_points_c = [18.0, 30.0, 45.0, 60.0, 75.0]
[task.motion]                       # own poses or markers in place of a drawn performance
file = "squat.c3d"                  # from the folder of study.toml
body = "pelvis"                     # or thorax, trunk; or markers = [...] of one rigid cluster
up = "y"
rest_s = 6.0                        # the body is at rest that long at the beginning, which its poses must bear out;
hold = true                         # or, without such a rest: the first pose is held that long before the recording
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from undrift.errors import FileFormatError, InputError
from undrift.io.bodies import BodyName
from undrift.io.toml import Entry, read_toml
from undrift.protocol import GridRule, Protocol
from undrift.sim.device.presets import PRESETS
from undrift.sim.motion.subject import Group
from undrift.study.note import DEVICE, SET_POINTS_C
from undrift.study.plan import Objective, OwnMotion, Space, Study, StudyTask
from undrift.units import RADIAN_PER_DEGREE

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Values = Annotated[list[Positive], Field(min_length=1)]


class SpaceEntry(Entry):
    """[task.space].

    Parameters
    ----------
    cutoff_hz : list of float
        Of the low-pass, Hz.
    turn_rate_step_dps, turn_rate_min_dps, turn_rate_max_dps : list of float
        Step, least and greatest rate, deg/s.
    """

    cutoff_hz: Values
    turn_rate_step_dps: Values
    turn_rate_min_dps: Values
    turn_rate_max_dps: Values


class ProtocolEntry(Entry):
    """[task.protocol].

    Parameters
    ----------
    dwell_s, bracket_s, face_s : float
        Seconds at a rate, at rest around a block of rates, on a face.
    grid : str
        paper or inclusive.
    set_points_c : list of float
        Of the chamber, degC, rising; empty stays at room temperature.
    """

    dwell_s: Positive = 2.0
    bracket_s: Positive = 6.0
    face_s: Positive = 6.0
    grid: GridRule = "paper"
    set_points_c: list[Finite] = Field(default_factory=lambda: list(SET_POINTS_C))


class MotionEntry(Entry):
    """[task.motion].

    Parameters
    ----------
    file : str
        Poses or markers, from the folder of study.toml.
    rest_s : float
        Rest at the beginning, s.
    markers : list of str
        Labels of one rigid cluster, for TRC or C3D.
    body : str or None
        Or pelvis, thorax or trunk, found by its markers.
    up : str or None
        Laboratory axis that points up, for markers.
    hold : bool
        Hold the first pose for ``rest_s`` before a recording that has no rest.
    """

    file: str
    rest_s: Positive
    markers: list[str] = Field(default_factory=list)
    body: BodyName | None = None
    up: Literal["y", "z"] | None = None
    hold: bool = False


class TaskEntry(Entry):
    """[[task]].

    Parameters
    ----------
    name : str
        Of the task.
    space : SpaceEntry
        What is tried.
    protocol : ProtocolEntry
        What is not varied.
    motion : MotionEntry or None
        In place of a drawn performance.
    """

    name: str
    space: SpaceEntry
    protocol: ProtocolEntry = ProtocolEntry()
    motion: MotionEntry | None = None


class StudyEntry(Entry):
    """[study].

    Parameters
    ----------
    name : str
        For people.
    device : str
        Preset, or path of a device.json.
    subjects : int
        How many.
    group : str
        simulation or testing.
    excursion_k : list of float
        Least and greatest, K.
    objective : str
        rms or maximum.
    level : float
        Of the tests.
    rig_minutes_max : float or None
        Longest session, min.
    seed : int
        Same seed, same bits.
    """

    name: str = ""
    device: str = DEVICE
    subjects: Annotated[int, Field(ge=3)] = 30
    group: Group = "simulation"
    excursion_k: Annotated[list[Finite], Field(min_length=2, max_length=2)] = Field(
        default_factory=lambda: [10.0, 15.0]
    )
    objective: Objective = "rms"
    level: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.05
    rig_minutes_max: Positive | None = None
    seed: Annotated[int, Field(ge=0)] = 0


class StudyFile(Entry):
    """The whole file.

    Parameters
    ----------
    study : StudyEntry
        What holds for all tasks.
    task : list of TaskEntry
        One or more.
    """

    study: StudyEntry = StudyEntry()
    task: Annotated[list[TaskEntry], Field(min_length=1)]


def read_study(path: str | Path) -> Study:
    """Read a study.

    Parameters
    ----------
    path : str or Path
        study.toml.

    Returns
    -------
    Study
        Rates in rad/s; a device.json and the marks of motion files taken in, so that workers need no study.toml.

    Raises
    ------
    InputError
        No such file.
    FileFormatError
        Not TOML, an unknown, missing or wrong entry, a device or motion that cannot be read; names the file.
    """
    held = read_toml(path, StudyFile)
    folder, said = Path(path).parent, held.study
    try:
        return Study(
            name=said.name or Path(path).stem,
            device=said.device if said.device in PRESETS else Path(said.device).stem,
            worn="" if said.device in PRESETS else _device_text(folder / said.device, said.device),
            tasks=tuple(_task(entry, folder) for entry in held.task),
            subjects=said.subjects,
            group=said.group,
            excursion_k=(said.excursion_k[0], said.excursion_k[1]),
            objective=said.objective,
            level=said.level,
            rig_minutes_max=said.rig_minutes_max,
            seed=said.seed,
        )
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _task(entry: TaskEntry, folder: Path) -> StudyTask:
    from undrift.study.motion import read_motion, sha256_of

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


def _device_text(path: Path, said: str) -> str:
    """Return a device.json in one spelling, after it was read as a device."""
    import json

    from undrift.sim.device.store import device_json, read_device

    if not path.exists():
        raise InputError(f"device: wanted one of {', '.join(PRESETS)} or a device.json, got '{said}'; name one of them")
    return json.dumps(device_json(read_device(path)), sort_keys=True)
