"""Which task is measured how: a task returns values and events, or says in one line why the recording does not show it.

A value's name ends in its unit (``UNITS``). It has an entry for each repetition, or one alone.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias, get_args

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.measures.worn import Course

TaskName = Literal["sit-to-stand", "5xSTS", "standing", "walk", "step", "tug"]
TASKS: tuple[TaskName, ...] = get_args(TaskName)
UNITS = {  # longest first: the end of a name, and the unit
    "_m2_s4": "m2/s4", "_m_s2": "m/s2", "_m_s": "m/s", "_per_min": "steps/min", "_percent": "%", "_deg2": "deg2", "_dps": "deg/s",
    "_deg": "deg", "_hz": "Hz", "_s": "s", "_m": "m",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Event:
    """A stretch of a recording, as BIDS has it."""

    onset: float  # s since the first sample
    duration: float  # s
    trial_type: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskResult:
    """What a recording shows of a task."""

    values: Mapping[str, FloatArray]  # by name: (K,) a repetition each, or (1,)
    events: tuple[Event, ...]
    missing: tuple[tuple[str, str], ...] = ()  # measures that are left out, and why
    by_time: Mapping[str, float] = field(default_factory=dict)  # change of a measure, in its unit, by 1 s of its times
    strides: int = 0  # that a value is the mean or spread of, where they are strides


TaskMeasure: TypeAlias = Callable[[Course], TaskResult]


def measure_of(task: TaskName, place: str = "lower-back") -> TaskMeasure:
    """Return the function that measures a task by a device at a place of the body."""
    from undrift.measures import rising, standing, stepping, up_and_go, walking

    functions: dict[TaskName, dict[str, TaskMeasure]] = {
        "sit-to-stand": {"lower-back": rising.sit_to_stand, "thigh": rising.sit_to_stand_of_thigh},
        "5xSTS": {"lower-back": rising.five_times, "thigh": rising.five_times_of_thigh},
        "standing": {"lower-back": standing.sway},
        "walk": {"lower-back": walking.walk, "thigh": walking.walk_of_thigh, "shank": walking.walk_of_shank},
        "step": {"lower-back": stepping.step},
        "tug": {"lower-back": up_and_go.up_and_go},
    }
    if place not in functions[task]:
        places = " or ".join(functions[task])
        raise InputError(
            f"{task}: wanted a device at the {places}, got one at the {place}; name where it was worn, or another task"
        )
    return functions[task][place]


def unit_of(name: str) -> tuple[str, str]:
    """Return the words and the unit of a measure's name."""
    ending = next(end for end in UNITS if name.endswith(end))
    return name.removesuffix(ending).replace("_", " "), UNITS[ending]


def is_time(name: str) -> bool:
    """Tell whether a measure is a time, by its unit."""
    return unit_of(name)[1] == "s"


def not_shown(task: str, wanted: str, got: str, advice: str) -> InputError:
    """Return the refusal of a recording that does not show a task."""
    return InputError(f"{task}: wanted {wanted}, got {got}; {advice}")


TYPES = {  # of events, for people
    "sit-to-stand": "From sitting to standing: from first to last motion of the trunk, or of the thigh that wears the device",
    "5xSTS": "Five times sit-to-stand: from the first motion to the fifth time upright",
    "flexion": "Trunk flexion: from the first motion to the greatest forward pitch",
    "seat-off": "The seat is left: greatest upward acceleration of the rise; by a thigh, the hip has come 5 % of its way up",
    "extension": "Trunk extension: from the greatest forward pitch to the last motion",
    "stand-to-sit": "Sitting down: from first to last motion of the trunk, or of the thigh",
    "standing": "Quiet stance",
    "tug": "Timed up and go: from the first motion of the trunk out of the chair to the last into it",
    "turn": "Turn about the vertical: from 5 to 95 % of the change of heading",
    "rise": "The body is lifted onto a step: upward velocity above a tenth of its peak",
    "walking": "Steps in a row: from the first contact to the last",
    "initial contact": "A foot comes down: greatest upward acceleration, a little after the touch; by a shank, its swing ends",
    "end contact": "The foot leaves the ground: least swing rate of the shank before its greatest",
    "mid-swing": "Greatest rate at which the thigh swings forward",
}
