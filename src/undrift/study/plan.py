"""Plan of a study: study.toml, or the note's study as a preset.

    [study]            device, people, temperatures, sessions, target
    [[task]]           a task of the library, or recorded people ([task.tried] varies the note's four numbers one at a time)
    [[session]]        a custom session with a protocol.toml
    [category.NAME]    a custom category of people

The page "Keys" of the documentation lists every key with its default.
"""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from annotated_types import Ge, MinLen
from pydantic import Field, NonNegativeFloat, PositiveFloat

from undrift.base.codec import FileTable, stored, toml_of, value_of
from undrift.errors import FileFormatError, InputError
from undrift.io.column_map import naming
from undrift.programme import Protocol, read_protocol
from undrift.sim.device.model import DeviceModel, device_from_json, device_json, read_device
from undrift.sim.device.presets import PRESETS, grade_of, preset, random_device, without_assumed
from undrift.sim.motion.bench import BenchErrors
from undrift.sim.motion.tasks import CATEGORIES, DEFAULT, Category, Group, Kind, TaskName, category_tree
from undrift.study.case import OffsetRule, stream
from undrift.study.recorded import MotionEntry, RecordedPeople, recorded_people
from undrift.study.sessions import SESSIONS, CalibrationSession, Fit, table_protocol
from undrift.units import RADIAN_PER_DEGREE

Values = tuple[float, ...]
Timing = Literal["aligned", "real time"]
DEVICE = "enc03j_3031"  # device of the note
MARGIN_DEG = 0.087  # rms of an error that grows evenly to 0.15 deg, the difference in the note's Figure 3
SUBJECTS = 30
COUNT_S = 0.1  # longest time between two counts of the encoder at a rate that a table can impose


class BenchTable(FileTable):
    """Standard deviations of the errors of a bench. Encoder and servo are from the note, other values are assumed."""

    face_tilt_deg: NonNegativeFloat = 0.1  # tilt of each face about each axis: a squared block on a plate
    mount_tilt_deg: NonNegativeFloat = (
        0.1  # tilt of the device relative to the table's axis, about each axis, for each mounting: the same block
    )
    level_deg: NonNegativeFloat = (
        0.05  # tilt of the table's axis from the vertical, about each horizontal axis: a bubble level
    )
    # wobble of the table's axis between dwells, about each axis: a motor's bearings (precision tables have a few arc seconds)
    wobble_deg: NonNegativeFloat = 0.01
    table_rate_percent: NonNegativeFloat = (
        0.01  # error of all rates: crystals of a controller and a computer differ by 50 to 100 ppm
    )
    servo_deg: NonNegativeFloat = 0.012  # error of the angle turned in a dwell: the largest error in the note
    encoder_lines: Annotated[int, Ge(0)] = (
        10_000  # lines of the encoder, four counts each, as in the note (0: rates without steps)
    )

    @property
    def errors(self) -> BenchErrors:
        """Errors of the simulated bench."""
        return BenchErrors(
            face_tilt=self.face_tilt_deg * RADIAN_PER_DEGREE,
            mount_tilt=self.mount_tilt_deg * RADIAN_PER_DEGREE,
            level=self.level_deg * RADIAN_PER_DEGREE,
            wobble=self.wobble_deg * RADIAN_PER_DEGREE,
            table_rate=0.01 * self.table_rate_percent,
            servo=self.servo_deg * RADIAN_PER_DEGREE,
            encoder_lines=self.encoder_lines,
        )


NOTE_BENCH = BenchTable()

# ---- the plan

Parameter = Literal["cutoff_hz", "turn_rate_step_dps", "turn_rate_min_dps", "turn_rate_max_dps"]
PARAMETERS: tuple[Parameter, ...] = get_args(Parameter)
HEADINGS: dict[Parameter, str] = {
    "cutoff_hz": "cut-off (Hz)",
    "turn_rate_step_dps": "step (deg/s)",
    "turn_rate_min_dps": "omega_m (deg/s)",
    "turn_rate_max_dps": "omega_M (deg/s)",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class NoteNumbers:
    """The four numbers of the note's Table 1."""

    cutoff_hz: float
    turn_rate_step_dps: float
    turn_rate_min_dps: float
    turn_rate_max_dps: float

    def session(self) -> CalibrationSession:
        """Return a rate-table session at room temperature with these rates."""
        rates = (self.turn_rate_step_dps, self.turn_rate_min_dps, self.turn_rate_max_dps)
        name = "step {:g}, {:g} to {:g} deg/s".format(*rates)
        return CalibrationSession(name=name, kind="table", protocol=table_protocol(name, *rates), by_means=True)


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class TryEntry:
    """[task.tried]: values of the note's four numbers. Other values are tried one at a time around the first value of each list."""

    cutoff_hz: Annotated[tuple[PositiveFloat, ...], MinLen(1)] = (11.1,)
    turn_rate_step_dps: Annotated[tuple[PositiveFloat, ...], MinLen(1)] = (5.0,)
    turn_rate_min_dps: Annotated[tuple[PositiveFloat, ...], MinLen(1)] = (5.0,)
    turn_rate_max_dps: Annotated[tuple[PositiveFloat, ...], MinLen(1)] = (90.0,)

    @property
    def around(self) -> NoteNumbers:
        """Return the first value of each list."""
        return NoteNumbers(**{name: getattr(self, name)[0] for name in PARAMETERS})


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyTask:
    """One task of a study."""

    name: str  # sit_to_stand, step, posturography or free (any word for recorded people)
    category: str = DEFAULT  # category of the people who perform the task
    motion: RecordedPeople | None = None  # recorded people instead of the library's task
    tried: TryEntry | None = None  # values of the note's numbers

    @property
    def key(self) -> str:
        """Return the name of the task and its category, suitable as a file name."""
        return self.name if self.category == DEFAULT else f"{self.name}-{self.category}"

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_]+", self.name):
            raise InputError(f"task: the name must have letters, digits and _ only, got '{self.name}'. Rename it.")
        if self.motion is None and self.name not in get_args(TaskName):
            names = ", ".join(get_args(TaskName))
            raise InputError(f"task: expected one of {names}, got '{self.name}'. Choose one, or add [task.motion].")
        for numbers in self.variations():  # refuses a step that does not divide the span
            numbers[2].session()

    def variations(self) -> Iterator[tuple[Parameter, float, NoteNumbers]]:
        """Yield each parameter with several values, and each value with the four numbers, of which one is varied."""
        if self.tried is None:
            return
        for parameter in PARAMETERS:
            values = getattr(self.tried, parameter)
            for value in sorted({*values}) if len(values) > 1 else ():
                yield parameter, value, replace(self.tried.around, **{parameter: value})


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """Settings for all tasks of a study."""

    name: str = ""
    device: str = DEVICE  # a preset, of which every subject wears a different unit, or the path of a device.json
    subjects: Annotated[int, Ge(3)] = SUBJECTS  # smallest number of people
    # largest number of people; people are added until the mean errors are known to margin / 4
    subjects_max: Annotated[int, Ge(3)] = SUBJECTS
    group: Group = "simulation"  # simulation or testing, as in the note's Table 2
    # board temperature of the trials above room temperature, smallest and largest, K
    excursion_k: tuple[float, float] = (10.0, 15.0)
    seed: Annotated[int, Ge(0)] = 0
    offset: OffsetRule = "rest"  # offset that is subtracted in a trial (none in the note)
    timing: Timing = "aligned"  # compare with the true pitch at the time of the readings, or with the current one
    fit: Fit = "product"  # mode of the fits ("paper": the note's matrix and not-a-knot splines)
    margin_deg: PositiveFloat = MARGIN_DEG  # smallest difference that matters
    target_deg: tuple[PositiveFloat, ...] = (0.5, 1.0, 2.0)  # target errors that are good enough
    bench: BenchTable = NOTE_BENCH


@dataclass(frozen=True, slots=True, kw_only=True)
class Study(Frame):
    """A study."""

    tasks: tuple[StudyTask, ...]
    sessions: tuple[CalibrationSession, ...] = tuple(SESSIONS.values())
    worn: str = ""  # text of a device.json for all subjects (empty: random units of ``device``)
    lab: tuple[tuple[str, Category], ...] = ()  # categories defined by a laboratory, by name
    shipped: bool = False  # True if the shipped fits are used, after ``with_checked_fits``

    def __post_init__(self) -> None:
        keys = [task.key for task in self.tasks]
        names = [session.name for session in self.sessions]
        if not keys or len(set(keys)) < len(keys):
            raise InputError(
                f"study: expected one or more tasks with different names, got {', '.join(keys) or 'none'}."
            )
        categories = (*CATEGORIES, *dict(self.lab))
        unknown = [task.category for task in self.tasks if task.category not in categories]
        if unknown:
            raise InputError(f"categories: expected some of {', '.join(categories)}, got '{unknown[0]}'.")
        if not names or len(set(names)) < len(names):
            raise InputError(f"study: expected one or more different sessions, got {', '.join(names) or 'none'}.")
        if not self.excursion_k[0] <= self.excursion_k[1]:
            raise InputError(f"study: excursion_k must be the smallest and the largest value, got {self.excursion_k}.")
        tried = (numbers.session() for task in self.tasks for *_, numbers in task.variations())
        for session in (*self.sessions, *tried):
            if session.protocol is not None:
                self._check_rates(session.protocol)

    def _check_rates(self, protocol: Protocol) -> None:
        """Raise if there is no rate, or if the table would turn by less than one count of its encoder in 0.1 s."""
        if protocol.rates is None:
            raise InputError(f"study: the protocol of {protocol.name} has no rates. Add the table [rates].")
        if not self.bench.encoder_lines:
            return
        count_deg = 360.0 / (4.0 * self.bench.encoder_lines)
        rates_dps = protocol.turn_rates() / RADIAN_PER_DEGREE
        slowest = float(rates_dps[rates_dps > 0.0].min())
        if slowest * COUNT_S < count_deg * (1.0 - 1e-9):
            raise InputError(
                f"study: {protocol.name} has a rate of {slowest:g} deg/s, less than one count ({count_deg:g} deg) of "
                f"the table's encoder in {COUNT_S:g} s. The table cannot turn that slowly. Start at {count_deg / COUNT_S:g} deg/s."
            )

    def unit(self, number: int, *, assumed: bool = True) -> DeviceModel:
        """Return the device that a subject wears, without the errors of assumed size if ``assumed`` is False."""
        if self.worn:
            return device_from_json(json.loads(self.worn))
        return _drawn_unit(self.device, self.seed, self.group, number, assumed)

    def typical_unit(self) -> DeviceModel:
        """Return the device of the study, or the typical unit of its kind."""
        return device_from_json(json.loads(self.worn)) if self.worn else preset(self.device)

    def kind(self, category: str) -> Kind:
        """Return a category by name: predefined, or defined by a laboratory."""
        return dict(self.lab).get(category) or category  # type: ignore[return-value]

    def other(self) -> "Study":
        """Return the study with the other group of people and other devices."""
        return replace(self, group="testing" if self.group == "simulation" else "simulation")


@lru_cache(maxsize=SUBJECTS)
def _drawn_unit(kind: str, seed: int, group: Group, number: int, assumed: bool) -> DeviceModel:
    grade = grade_of(kind)
    rng = stream(seed, group, "device", number)
    return random_device(rng, grade=grade if assumed else without_assumed(grade))


def with_categories(study: Study, categories: Sequence[str]) -> Study:
    """Return a study in which each of several categories performs the simulated tasks."""
    tasks = {task.name: task for task in study.tasks}.values()
    return replace(study, tasks=tuple(crossed for task in tasks for crossed in _crossed(task, categories)))


def _crossed(task: StudyTask, categories: Sequence[str]) -> tuple[StudyTask, ...]:
    """Return a task performed by each category. Recorded people and free motion have no category."""
    if task.motion is not None or task.name == "free":
        return (task,)
    return tuple(replace(task, category=category) for category in categories)


# ---- the note's study


@dataclass(frozen=True, slots=True)
class NoteRow:
    """A row of the note's Table 1, with the values that are tried in addition to the note's."""

    tried: TryEntry
    p_value: float  # printed as statistical significance
    erratum: str = ""

    @property
    def numbers(self) -> NoteNumbers:
        """Values of the note."""
        return self.tried.around


def _row(cutoff: float, step: Values, low: Values, high: Values, p: float, erratum: str = "") -> NoteRow:
    cutoffs = (cutoff, 5.0, 8.0, 14.0, 20.0, 40.0)
    tried = TryEntry(cutoff_hz=cutoffs, turn_rate_step_dps=step, turn_rate_min_dps=low, turn_rate_max_dps=high)
    return NoteRow(tried, p, erratum)


# Cut-off, steps, omega_m and omega_M, each with the value of the note first, and p. Each step divides the span. Rates below one
# count in 0.1 s (0.09 deg/s) cannot be imposed, so posturography has no smaller rates than in the note.
ERRATUM = "The note prints 111.4 Hz. This is read as 11.4 Hz, which is between the other two values."
TABLE_1: dict[TaskName, NoteRow] = {
    "sit_to_stand": _row(11.1, (5.0, 2.5, 17.0), (5.0, 10.0, 20.0), (90.0, 50.0, 110.0), 0.048),
    "step": _row(11.4, (3.0, 1.5, 14.0), (3.0, 6.0, 12.0), (45.0, 24.0, 57.0), 0.040, ERRATUM),
    "posturography": _row(11.5, (0.1, 0.7, 4.9), (0.1, 0.2, 0.8), (5.0, 3.6, 10.0), 0.049),
}


def note_study() -> Study:
    """Return the note's study: its three tasks and fits, with its rates tried one at a time."""
    return Study(
        name="note", tasks=tuple(StudyTask(name=name, tried=row.tried) for name, row in TABLE_1.items()), fit="paper"
    )


# ---- study.toml


class TaskEntry(FileTable):
    """[[task]]."""

    name: str  # name of the task
    category: str = ""  # category of its people, instead of the category in [study]
    motion: MotionEntry | None = None  # recorded motion instead of a drawn performance
    tried: TryEntry | None = None  # values of the note's numbers


class SessionEntry(FileTable):
    """[[session]]."""

    name: str
    protocol: str  # path of a protocol.toml, from the folder of study.toml


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class StudyEntry(Frame):
    """[study]."""

    # category of the people: level_1 to level_4 (level_2 is the note's), young, elderly, impaired, parkinson, or a [category.NAME]
    categories: tuple[str, ...] = (DEFAULT,)
    sessions: tuple[str, ...] = tuple(SESSIONS)  # names of sessions to try


class StudyFile(FileTable):
    """The whole file."""

    study: StudyEntry = StudyEntry()
    task: Annotated[tuple[TaskEntry, ...], MinLen(1)]
    session: tuple[SessionEntry, ...] = ()
    category: dict[str, Category] = Field(default_factory=dict)


def _with_whole_categories(tree: dict[str, Any]) -> dict[str, Any]:
    """Return the tree of study.toml with all keys of its categories."""
    tables = tree.get("category", {})
    if not isinstance(tables, dict) or not all(isinstance(table, dict) for table in tables.values()):
        return tree
    return tree | {"category": {name: category_tree(name, table) for name, table in tables.items()}}


def read_study(path: str | Path) -> Study:
    """Read study.toml."""
    folder = Path(path).parent
    tree, text = toml_of(path)
    with naming(path):
        tree = _with_whole_categories(tree)
    file = value_of(StudyFile, tree, str(path), text)
    head = file.study
    frame: dict[str, Any] = {name: getattr(head, name) for name in Frame.__dataclass_fields__}
    frame["name"] = head.name or Path(path).stem
    try:
        if head.device not in PRESETS:
            if not (folder / head.device).exists():
                names = ", ".join(PRESETS)
                raise InputError(f"device: expected one of {names}, or a device.json, got '{head.device}'.")
            text = json.dumps(device_json(read_device(folder / head.device)), sort_keys=True)
            frame |= {"device": Path(head.device).stem, "worn": text}
        custom_sessions = [
            CalibrationSession(name=entry.name, kind="table", protocol=read_protocol(folder / entry.protocol))
            for entry in file.session
        ]
        unknown = [name for name in head.sessions if name not in SESSIONS]
        if unknown:
            raise InputError(
                f"sessions: expected some of {', '.join(SESSIONS)}, got '{unknown[0]}'. Name a protocol in [[session]]."
            )
        sessions = (*(SESSIONS[name] for name in head.sessions), *custom_sessions)
        tasks = [
            task
            for entry in file.task
            for task in _crossed(_task(entry, folder), (entry.category,) if entry.category else head.categories)
        ]
        return Study(**frame, tasks=tuple(tasks), sessions=sessions, lab=tuple(file.category.items()))
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _task(entry: TaskEntry, folder: Path) -> StudyTask:
    if entry.motion is not None and entry.category:
        raise InputError(f"{entry.name}: recorded people have no category. Remove `category`.")
    motion = None if entry.motion is None else recorded_people(entry.motion, folder)
    return StudyTask(name=entry.name, motion=motion, tried=entry.tried)
