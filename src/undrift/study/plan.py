"""Plan of a study: which tasks, whose, with which device, and which protocols are tried; recorded motions as tasks.

A candidate is a Protocol and what is set of the device: cut-off frequency, omega_m, omega_M and step vary as in the note, more
where it is listed (study/space.py), the rest comes from the plan. study.toml holds a plan (docs/study.md shows one). The note's
study is a preset; spaces surround its values; dwell, brackets and set-points are choices, since it does not give them.

A recorded motion must begin at rest. Three figures of its first ``rest_s`` seconds, rates and accelerations as means over 0.25 s::

    w    |mean of w_b|                          how fast the body turns
    a    |mean of p''|                          how fast its velocity changes
    e    angle(mean of f_b, R_nb^T z)           tilt error of a device without errors at the end of that time
"""

import csv
import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from itertools import chain, product
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, cast, get_args

import numpy as np
from annotated_types import Ge, Gt, Lt, MinLen

from undrift.arrays import FloatArray, window_sums
from undrift.base.codec import Key, read, stored, tree_of
from undrift.errors import FileFormatError, InputError
from undrift.frames import quaternion_conjugate, rotate
from undrift.io.formats import read_markers, read_reference
from undrift.io.reference import L5_OFFSET, BodyName, device_on, find_body
from undrift.programme import GridRule, Protocol
from undrift.record import FACES, Reference
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.model import DeviceModel, device_from_json, device_json, read_device
from undrift.sim.device.presets import PRESETS, preset
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, PoseSpline, fit_pose_spline
from undrift.sim.motion.tasks import CATEGORIES, DEFAULT, Category, Group, Kind, TaskName, category_tree
from undrift.study.space import FURTHER, OF_NOTE, TURN_RATES, Grid, Space
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- what the bench does wrong

Positive = Annotated[float, Gt(0.0)]


# [study.bench] where a key is left out. The note gives its encoder and its servo; the rest is assumed but where a source stands.
NOTE_BENCH = BenchErrors(
    face_tilt=0.1 * RADIAN_PER_DEGREE,  # Assumed: a squared block on a plate, as of the rival methods
    mount_tilt=0.1 * RADIAN_PER_DEGREE,  # Assumed: the same block
    level=0.05 * RADIAN_PER_DEGREE,  # Assumed: a bubble level
    wobble=0.01 * RADIAN_PER_DEGREE,  # Assumed: a motor's bearings; precision tables state a few arc seconds
    table_rate=0.01 * 0.01,  # Known: crystals of a controller and a computer differ by 50 to 100 ppm
    servo=0.012 * RADIAN_PER_DEGREE,  # Note: largest error of the angle; the encoder reads it
    encoder_lines=10_000,  # Note: N = 10,000, read as lines
    soak_k=0.3,  # Assumed: a small chamber is even to some tenths of a kelvin
    board_lag_s=600.0,  # Assumed: a board in its box, 1 K behind at the soak's limit of 0.1 K/min
    inclination=0.05 * RADIAN_PER_DEGREE,  # Assumed: a digital inclinometer, as of the rival methods
)


# ---- the plan

# Poses in which accelerometers are read: a face up, or one inclined by an angle, deg, toward another. The preset's: the note's
# six faces, five without -z, without -x or without +z; four inclined ones about +z with +z, and with all faces; the twelve edges.
POSE = r"[+-]([xyz])( \d+(?:\.\d+)? [+-]([xyz]))?"
_ABOUT_Z = tuple(f"+z 45 {side}" for side in FACES[:4])
_EDGES = tuple(f"{one} 45 {other}" for k, one in enumerate(FACES) for other in FACES[2 * (k // 2) + 2 :])
POSES: tuple[tuple[str, ...], ...] = (
    FACES, FACES[:5], FACES[:1] + FACES[2:], FACES[:4] + FACES[5:], ("+z", *_ABOUT_Z), FACES + _ABOUT_Z, _EDGES
)  # fmt: skip

Objective = Literal["rms", "maximum", "end"]  # Of the pitch error over the motion; end: median of its last half second
# The true pitch of the same instant, as who acts on the display needs it; or that of the instant which the readings belong to
Timing = Literal["real time", "offline"]
# Of the gyroscopes in a trial, that is taken off: the mean of the rest before it, what the motion shows from there on, or nothing
OffsetRule = Literal["rest", "motion", "none"]

# Smallest difference that matters, deg. The note's Figure 3: a simulated and an actual device differ by 0.15 deg at most, which it
# calls very low; a simulation shows nothing finer of real devices. An error that grows evenly to 0.15 deg has 0.15 / sqrt(3) rms.
MARGIN_DEG: dict[Objective, float] = {"rms": 0.087, "maximum": 0.15, "end": 0.15}
_FIGURES: dict[Objective, str] = {"rms": "rms", "maximum": "max", "end": "end"}


def column_of(objective: Objective, timing: Timing) -> str:
    """Return the column of surface.parquet that a study minimises."""
    return f"error_{'' if timing == 'real time' else 'offline_'}{_FIGURES[objective]}_deg"


ERRORS = tuple(column_of(objective, timing) for timing in get_args(Timing) for objective in _FIGURES)


@dataclass(frozen=True, slots=True, kw_only=True)
class Posed:
    """How the poses of a device are found in a file of poses or markers."""

    markers: tuple[str, ...] = ()  # Labels of one rigid cluster, for TRC or C3D
    # Or the segment that the device is worn on, found by its markers: pelvis (the device sits at L5), thorax or trunk
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


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyTask:
    """One task of a study."""

    name: str  # sit_to_stand, step, posturography or free; any word for a motion of one's own
    space: Space  # What is tried
    base: Protocol  # All that is not varied: dwell, brackets, temperatures
    motion: OwnMotion | None = None  # Performed in place of the library's task
    category: str = DEFAULT  # Of the subjects who perform it
    poses: tuple[tuple[str, ...], ...] = POSES  # Sets in which the accelerometers are read, to choose from by number
    places: tuple[
        tuple[float, ...], ...
    ] = ()  # Lists of set-points, degC, likewise; an empty one stays at room temperature

    @property
    def key(self) -> str:
        """Name of the task and its category, good for a file."""
        return self.name if self.category == DEFAULT else f"{self.name}-{self.category}"

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_]+", self.name):
            raise InputError(f"task: wanted a name of letters, digits and _, got '{self.name}'; rename it")
        for pose in chain.from_iterable(self.poses):
            if not (form := re.fullmatch(POSE, pose)) or form[1] == form[3]:
                raise InputError(
                    f'poses: wanted a face as "+z" or an inclined one as "+z 45 +x", got "{pose}"; write it so'
                )
        count = max(dict(self.space.further).get("poses", (0.0,)))
        if count > len(self.poses) or any(len(set(one)) < max(len(one), 4) for one in self.poses):
            raise InputError(
                "poses: wanted sets of four poses or more, each pose once, and numbers of these sets, got others"
            )
        if self.places and {"set_points", "warmest_c"} & set(self.space.names):
            raise InputError("places: wanted lists of set-points, or set_points and warmest_c, got both; leave one out")
        if max(dict(self.space.further).get("places", (0.0,))) > len(self.places):
            raise InputError(f"places: wanted numbers of the plan's lists, got {len(self.places)} lists; give more")
        for temps_c in self.places:
            replace(self.base, temperatures_c=temps_c)  # refuses what does not rise
        if self.motion is None and self.name not in get_args(TaskName):
            raise InputError(
                f"task: wanted one of {', '.join(get_args(TaskName))}, got '{self.name}'; name one, or give a motion of your own"
            )

    def protocol_of(self, point: Sequence[float] | FloatArray) -> Protocol:
        """Return the protocol of a candidate; what it says of gain, quality and tables is not of a protocol."""
        stated = self.base.temperatures_c
        values: dict[str, Any] = dict(zip(self.space.names, map(float, point), strict=True))
        given = {
            name: values[name]
            for name in ("cutoff_hz", *TURN_RATES, "dwell_s", "bracket_s", "face_s", "soak_c_per_min")
            if name in values
        }
        if "faces" in values:
            given["faces"] = FACES[: int(values["faces"])]
        if "poses" in values:
            given["faces"] = self.poses[int(values["poses"]) - 1]
        if "order" in values:
            given["order"] = "random" if values["order"] == 2.0 else "alternating"
        count, temps_c = int(values.get("set_points", len(stated))), stated
        warmest_c = values.get("warmest_c", stated[-1] if stated else 0.0)
        if "places" in values:
            temps_c = self.places[int(values["places"]) - 1]
        elif stated and (count, warmest_c) != (len(stated), stated[-1]):
            temps_c = tuple(np.linspace(stated[0], warmest_c, count).tolist()) if count > 1 else ()
        return replace(self.base, **given, temperatures_c=temps_c)


INSTRUMENTS = ("faces fixture", "inclined plane", "rate table", "chamber")  # by what they ask of a laboratory


@dataclass(frozen=True, slots=True, kw_only=True)
class Aim:
    """What a study minimises, and by what it judges."""

    objective: Objective = "rms"  # rms, maximum or end of the pitch error
    timing: Timing = "offline"  # The delay is estimated and removed, as in the note's comparison; or real time
    level: Annotated[float, Gt(0.0), Lt(1.0)] = 0.05  # Of the tests
    # Smallest difference of mean errors that matters, deg; where not given 0.087 for rms, 0.15 for maximum and end: the note's
    margin_deg: Positive = MARGIN_DEG["rms"]
    rig_minutes_max: Positive | None = None  # Longest session that is allowed, min
    # Mean error that is good enough, deg: the cheapest session whose upper limit on other subjects is below it is looked for
    target_deg: Positive | None = None
    confidence: Annotated[float, Ge(0.5), Lt(1.0)] = 0.95  # Of that limit, one-sided


AIM = Aim()
DEVICE = "enc03j_3031"  # the note's


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame(Aim):
    """What holds for all tasks of a study."""

    name: str = ""  # For people
    device: str = DEVICE  # Preset, of which every subject wears a unit of its own; or path of a device.json
    subjects: Annotated[int, Ge(3)] = 30  # How many, from the cohort
    group: Group = "simulation"  # simulation or testing, as in the note's Table 2
    # Board temperature of the trials above the calibration's, least and greatest, K
    excursion_k: tuple[float, float] = (10.0, 15.0)
    seed: Annotated[int, Ge(0)] = 0  # Same seed, same bits
    # Tolerance of an amplifier's gain and null and of its converter's reference; 1 % parts are assumed
    chain_sd: Annotated[float, Ge(0.0), Key("chain_percent", unit=0.01)] = 0.01
    # Of the gyroscopes: that of the rest before a motion is taken off; or what a motion of 20 s or more shows; none is the note's
    offset: OffsetRule = "rest"
    bench: BenchErrors = NOTE_BENCH  # What the bench does wrong; the default is the preset's


@dataclass(frozen=True, slots=True, kw_only=True)
class Study(Frame):
    """A study; ``device`` is for people where ``worn`` is given."""

    tasks: tuple[StudyTask, ...]  # One or more
    worn: str = ""  # Text of a device.json, which every subject wears; none draws units of ``device``
    lab: tuple[tuple[str, Category], ...] = ()  # Categories of a lab's own, by name

    def __post_init__(self) -> None:
        names = [task.key for task in self.tasks]
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
            for name, part in (("gain", "amplifier"), ("bits", "adc")):
                if name in task.space.names and getattr(self._unit().gyro, part) is None:
                    what = f"a device with {'an amplifier' if name == 'gain' else 'a converter'} to vary its {name}"
                    raise InputError(f"study: wanted {what}, got {self.device}; leave {name} out")
            if max(dict(task.space.further).get("set_points", (0.0,))) > 1.0 and not task.base.temperatures_c:
                raise InputError(
                    "study: wanted set_points_c whose number varies, got none; state the first and the last"
                )
        if not (self.target_deg is None or self.target_deg > 0.0) or not 0.5 <= self.confidence < 1.0:
            raise InputError(
                f"study: wanted a target_deg above 0 and a confidence from 0.5 to below 1, got {self.target_deg} and "
                f"{self.confidence:g}; 1 deg and 0.95 are usual"
            )
        if not self.margin_deg > 0.0:
            raise InputError(f"study: wanted a margin_deg above 0, got {self.margin_deg:g}; state what matters to you")
        if not self.excursion_k[0] <= self.excursion_k[1]:
            raise InputError(
                f"study: wanted excursion_k as least and greatest, got {self.excursion_k[0]:g} and {self.excursion_k[1]:g}"
            )

    def _unit(self) -> DeviceModel:
        return device_from_json(json.loads(self.worn)) if self.worn else preset(self.device)

    @property
    def of_note(self) -> bool:
        """Whether the note's device is studied: only then is it compared with the note's rows."""
        return self.device == DEVICE and not self.worn

    @property
    def names(self) -> tuple[str, ...]:
        """Tasks, each once however many categories perform it."""
        return tuple(dict.fromkeys(task.name for task in self.tasks))

    @property
    def categories(self) -> tuple[str, ...]:
        """Categories of the subjects."""
        return tuple(dict.fromkeys(task.category for task in self.tasks))

    @property
    def known(self) -> tuple[str, ...]:
        """All categories that subjects can have."""
        return (*CATEGORIES, *dict(self.lab))

    def kind(self, category: str) -> Kind:
        """Return a category by its name, or the numbers of a lab's own."""
        return dict(self.lab).get(category) or cast("Kind", category)


def with_categories(study: Study, categories: Sequence[str]) -> Study:
    """Return a study whose drawn tasks are performed by each of several categories; a recorded motion and ``free`` have none."""
    once = {task.name: task for task in study.tasks}.values()
    crossed = (_performed_by(task, categories, study.known) for task in once)
    return replace(study, tasks=tuple(chain.from_iterable(crossed)))


def _performed_by(task: StudyTask, categories: Sequence[str], known: Sequence[str]) -> list[StudyTask]:
    unknown = [name for name in categories if name not in known]
    if unknown or not categories or len(set(categories)) < len(categories):
        got = ", ".join(unknown or categories) or "none"
        raise InputError(f"categories: wanted some of {', '.join(known)}, each once, got {got}; name one or more")
    drawn = task.motion is None and task.name != "free"
    return [replace(task, category=each) for each in categories] if drawn else [task]


def ends_of(study: Study) -> Study:
    """Return a study of the first and last value of everything that it tries: a first look."""
    tasks = []
    for task in study.tasks:
        first, *lists = (v if len(v) < 3 else (v[0], v[-1]) for v in task.space.values)
        further = tuple(zip(task.space.names[4:], lists[3:], strict=True))
        if task.space.only:  # not every combination was meant
            further = tuple((name, values[:1]) for name, values in task.space.further)
        rates: Any = dict(zip(TURN_RATES, lists, strict=False))
        ends = Space(cutoff_hz=first, **rates, further=further)
        tasks.append(replace(task, space=ends) if any(True for _ in ends.grids()) else task)
    return replace(study, tasks=tuple(tasks))


# ---- the note's study as a preset

SET_POINTS_C = (18.0, 30.0, 45.0, 60.0, 75.0)
# 11.1: each task's own in its place; samples come at 100 Hz
CUTOFFS_HZ = (5.0, 8.0, 11.1, 14.0, 20.0, 30.0, 40.0, 45.0)


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
# Step, omega_m, omega_M: the note's with values below and above each. 8.5, 7 and 0.14 divide the note's own span, so do their
# neighbours below. No omega_m below the note's has its step: 2.5, 1.5 and 0.05 are tried with others. Gain 20 takes 186 deg/s.
TRIED_DPS: dict[TaskName, tuple[Rates, Rates, Rates]] = {
    "sit_to_stand": ((2.5, 5, 8.5, 10, 20), (2.5, 5, 10, 20), (50, 70, 90, 110)),
    "step": ((1.5, 3, 6, 7, 9, 14), (1.5, 3, 6, 12), (24, 33, 45, 57)),
    "posturography": ((0.07, 0.1, 0.14, 0.15, 0.7), (0.05, 0.1, 0.2, 0.8), (3.6, 4.3, 5, 6.4)),
}


# What else is tried at the note's rates, one at a time or as stated; the first value is the plan's own
BESIDE: dict[str, tuple[float, ...]] = {
    "dwell_s": (2.0, 0.5, 1.0, 4.0),
    "bracket_s": (6.0, 2.0),
    "face_s": (6.0, 2.0),
    "poses": (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0),
    "set_points": (5.0, 1.0, 2.0, 3.0),
    "warmest_c": (75.0, 45.0),
    "soak_c_per_min": (0.1, 0.3),
    "order": (1.0, 2.0),
}


def note_study(*, subjects: int = 30, seed: int = 0, quick: bool = False) -> Study:
    """Return the note's study."""
    tasks = []
    for name, (steps, lows, highs) in TRIED_DPS.items():
        row = TABLE_1[name]
        own = row.cutoff_hz
        cutoffs = tuple(own if f == 11.1 else f for f in CUTOFFS_HZ)
        if quick:
            first, top = steps.index(row.turn_rate_step_dps), highs.index(row.turn_rate_max_dps)
            steps, highs = steps[first : first + 2], highs[top - 1 : top + 1]
            lows, cutoffs = (row.turn_rate_min_dps,), (cutoffs[0], own)
        base = Protocol(name=name, grid="paper", dwell_s=2.0, bracket_s=6.0, temperatures_c=SET_POINTS_C)
        space = _space(cutoffs, steps, lows, highs)
        if not quick:
            step, low, high = row.turn_rate_step_dps, row.turn_rate_min_dps, row.turn_rate_max_dps
            space = _beside(space, (step * RADIAN_PER_DEGREE, low * RADIAN_PER_DEGREE, high * RADIAN_PER_DEGREE))
        tasks.append(StudyTask(name=name, space=space, base=base))
    return Study(name="note", device=DEVICE, tasks=tuple(tasks), subjects=subjects, seed=seed)


def _beside(space: Space, rates: Grid) -> Space:
    """Return a space with what else is tried at some rates, alone and together, and the fewest rates at room temperature."""

    def row(grid: Grid, **changed: float) -> Rates:
        return (*grid, *(changed.get(name, values[0]) for name, values in BESIDE.items()))

    grids = sorted(space.grids(), key=lambda grid: round((grid[2] - grid[1]) / grid[0]))
    rows = [row(grid) for grid in space.grids()]
    rows += [row(rates, **{name: value}) for name, values in BESIDE.items() for value in values[1:]]
    rows += [
        row(rates, set_points=count, warmest_c=warmest_c, dwell_s=dwell_s, bracket_s=bracket_s)
        for count, warmest_c in ((1.0, 75.0), (2.0, 75.0), (2.0, 45.0), (3.0, 75.0), (3.0, 45.0))
        for dwell_s, bracket_s in product((2.0, 0.5), (6.0, 2.0))
    ]
    rows += [row(grid, set_points=1.0, dwell_s=dwell_s) for grid in grids[:3] for dwell_s in (2.0, 0.5)]
    return replace(space, further=tuple(BESIDE.items()), only=tuple(dict.fromkeys(rows)))


def _space(cutoff_hz: Rates, steps_dps: Rates, lows_dps: Rates, highs_dps: Rates, **further: Rates) -> Space:
    step, low, high = (tuple(v * RADIAN_PER_DEGREE for v in rates) for rates in (steps_dps, lows_dps, highs_dps))
    more = tuple((name, further[name]) for name in FURTHER if further.get(name))
    return Space(cutoff_hz=tuple(cutoff_hz), turn_rate_step=step, turn_rate_min=low, turn_rate_max=high, further=more)


# ---- recorded motion as a task

SAMPLE_RATE_HZ = 100.0
WINDOW_S = 0.25
LEAST_REST_S = 0.5  # the tilt at the start is a mean over the rest
LONGEST_REST_S = 6.0  # the note's; more of a recording is left to the motion
# People who stand quietly keep to 1.4 deg/s, 0.03 m/s2 and 0.6 deg over 5 s at the pelvis; who has begun to rise is at 10 deg/s.
MOST_TURN_RATE = 5.0 * RADIAN_PER_DEGREE  # rad/s
MOST_ACCELERATION = 0.3  # m/s2
MOST_TILT_ERROR = 1.0 * RADIAN_PER_DEGREE  # rad
SKIN = PoseSettings(cutoff_hz=10.0, position_cutoff_hz=6.0)  # markers on skin: what is above is not the bone


class RestQuality(NamedTuple):
    """How still a body is for a time from the first pose on, and how long it is."""

    turn_rate: float  # Largest, rad/s
    acceleration: float  # Largest, m/s2
    tilt_error: float  # Of a device without errors, at the end of the time, rad
    still_s: float  # How long the body truly is still, s


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


# ---- study.toml

Values = Annotated[tuple[Positive, ...], MinLen(1)]
MoreValues = tuple[Positive, ...]


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class SpaceEntry:
    """[task.space]."""

    cutoff_hz: Values  # Of the low-pass, Hz
    turn_rate_step_dps: Values  # d
    turn_rate_min_dps: Values  # omega_m
    turn_rate_max_dps: Values  # omega_M
    # Left out: the device's or the protocol's own value alone
    gain: MoreValues = ()  # Of the gyroscopes' amplifier
    quality: MoreValues = ()  # Q of the low-pass of both triads, 0.5 or more
    sample_rate_hz: MoreValues = ()  # Of the trial, 25 to 400; 100 where not given
    bits: MoreValues = ()  # Of the converter of both triads, over the same span
    dwell_s: MoreValues = ()  # At a rate
    bracket_s: MoreValues = ()  # At rest around a block of rates
    face_s: MoreValues = ()  # On a face
    faces: MoreValues = ()  # How many: 6, or 5 without -z
    # In place of faces: sets of poses, each a list of faces ("+z") and inclined ones ("+z 45 +x": +z up, 45 deg toward +x)
    poses: tuple[tuple[str, ...], ...] = ()
    # Lists of set-points in place of the protocol's, degC, rising; an empty one stays at room temperature
    places: tuple[tuple[float, ...], ...] = ()
    # How many, evenly from the protocol's first to its last; 1 stays at room temperature
    set_points: MoreValues = ()
    warmest_c: MoreValues = ()  # The last of them; the protocol's where not given
    soak_c_per_min: MoreValues = ()  # Slope at which a soak ends
    order: MoreValues = ()  # Of the rates: 1 rising, 2 random
    static_step_c: MoreValues = ()  # Between nodes of the static table, K
    dynamic_step_c: MoreValues = ()  # Of the dynamic table, K


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class ProtocolEntry:
    """[task.protocol]."""

    dwell_s: Positive = 2.0  # At a rate
    bracket_s: Positive = 6.0  # At rest around a block of rates
    face_s: Positive = 6.0  # On a face
    grid: GridRule = "paper"  # paper or inclusive
    # Of the chamber, degC, rising; empty stays at room temperature
    set_points_c: tuple[float, ...] = SET_POINTS_C


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class MotionEntry(Posed):
    """[task.motion]."""

    file: str = ""  # Poses or markers, from the folder of study.toml
    folder: str = ""  # Or of several people: every file in it, one a person
    # Or a CSV table with columns file (from the table's folder) and person, which may have several files, and label
    table: str = ""
    label: str = ""  # Only the rows of the table with this label
    rest_s: Positive | None = None  # Rest at the beginning, s; found where not given, at most 6 s
    hold: bool = False  # Hold the first pose for ``rest_s`` before a recording that has no rest


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class TaskEntry:
    """[[task]]."""

    name: str  # Of the task
    space: SpaceEntry  # What is tried
    protocol: ProtocolEntry = ProtocolEntry()  # What is not varied
    motion: MotionEntry | None = None  # In place of a drawn performance
    category: str = ""  # Of its subjects, in place of those of [study]


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class StudyEntry(Frame):
    """[study]."""

    # Of the subjects: level_1 to level_4 (2 is the note's), young, elderly, impaired, parkinson, or one of [category.NAME]
    categories: tuple[str, ...] = (DEFAULT,)


def _with_all(tree: dict[str, Any]) -> dict[str, Any]:
    """Return the tree of study.toml with all keys of bench and categories, and the margin of its objective."""
    study, lab = tree.get("study", {}), tree.get("category", {})
    if isinstance(lab, dict) and all(isinstance(table, dict) for table in lab.values()):
        tree = tree | {"category": {name: category_tree(name, table) for name, table in lab.items()}}
    if not isinstance(study, dict):
        return tree
    margins: dict[Any, float] = dict(MARGIN_DEG)
    study = {"margin_deg": margins.get(study.get("objective", "rms"), 0.0)} | study
    stated: Any = study.get("bench", {})
    study = study | {"bench": tree_of(NOTE_BENCH) | stated if isinstance(stated, dict) else stated}
    return tree | {"study": study}


@stored(complete=_with_all)
@dataclass(frozen=True, slots=True, kw_only=True)
class StudyFile:
    """The whole file."""

    study: StudyEntry = StudyEntry()  # What holds for all tasks
    task: Annotated[tuple[TaskEntry, ...], MinLen(1)]  # One or more
    # Of a lab's own: a table each, with what is other than in the category that it is `like`; [mean, standard deviation]
    category: dict[str, Category] = field(default_factory=dict)


def read_study(path: str | Path) -> Study:
    """Read a study."""
    held, folder = read(StudyFile, path), Path(path).parent
    head = held.study
    given = {item.name: getattr(head, item.name) for item in fields(head)} | {"name": head.name or Path(path).stem}
    categories = given.pop("categories")
    try:
        if head.device not in PRESETS:
            if not (worn := folder / head.device).exists():
                known = ", ".join(PRESETS)
                raise InputError(
                    f"device: wanted one of {known} or a device.json, got '{head.device}'; name one of them"
                )
            text = json.dumps(device_json(read_device(worn)), sort_keys=True)  # in one spelling
            given |= {"device": Path(head.device).stem, "worn": text}
        entries, kinds = (
            [(_task_of(entry, folder, given["bench"].board_lag_s), entry.category) for entry in held.task],
            (*CATEGORIES, *held.category),
        )
        crossed = (_performed_by(task, (own,) if own else categories, kinds) for task, own in entries)
        tasks = tuple(chain.from_iterable(crossed))
        people = [task.motion.people for task in tasks if task.motion is not None and task.motion.others]
        given["subjects"] = min(head.subjects, *people) if people else head.subjects  # no person counts twice
        return Study(**given, tasks=tasks, lab=tuple(held.category.items()))
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _task_of(entry: TaskEntry, folder: Path, board_lag_s: float) -> StudyTask:
    base, space = entry.protocol, entry.space
    if entry.motion is not None and entry.category:
        raise InputError(
            f"{entry.name}: wanted a category or a recorded motion, got both; recorded people are who they are, leave category out"
        )
    motion = None if entry.motion is None else _own_motion(entry.motion, folder)
    further: dict[str, Any] = {name: getattr(space, name) for name in FURTHER}
    further |= {name: tuple(map(float, range(1, len(further[name]) + 1))) for name in ("poses", "places")}
    kept: dict[str, Any] = {name: getattr(base, name) for name in ("dwell_s", "bracket_s", "face_s", "grid")}
    return StudyTask(
        name=entry.name,
        space=_space(*(getattr(space, name) for name in OF_NOTE), **further),
        base=Protocol(name=entry.name, temperatures_c=base.set_points_c, board_lag_s=board_lag_s, **kept),
        motion=motion,
        poses=space.poses or POSES,
        places=space.places,
    )


def _own_motion(entry: MotionEntry, folder: Path) -> OwnMotion:
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
