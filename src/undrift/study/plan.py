"""Plan of a study: which tasks, whose, with which device, and which protocols are tried.

A candidate is a Protocol: cut-off frequency, omega_m, omega_M and step as the note varies them, the rest from the plan. Every
combination of the four whose step divides the span is a candidate.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal, get_args

from undrift.errors import InputError
from undrift.io.bodies import BodyName
from undrift.protocol import Protocol
from undrift.sim.motion.library import TaskName
from undrift.sim.motion.subject import Group

Objective = Literal["rms", "maximum"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Untried:
    """A value of the plan that no protocol has.

    Parameters
    ----------
    parameter : str
        turn_rate_step, turn_rate_min or turn_rate_max.
    value : float
        rad/s.
    reason : str
        Why not.
    """

    parameter: str
    value: float
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Space:
    """The values that are tried.

    Parameters
    ----------
    cutoff_hz : tuple of float
        Of the low-pass, Hz.
    turn_rate_step, turn_rate_min, turn_rate_max : tuple of float
        d, omega_m, omega_M, rad/s.
    only : tuple of (float, float, float)
        These combinations of the three and no others, where given.
    """

    cutoff_hz: tuple[float, ...]
    turn_rate_step: tuple[float, ...]
    turn_rate_min: tuple[float, ...]
    turn_rate_max: tuple[float, ...]
    only: tuple[tuple[float, float, float], ...] = ()

    def grids(self) -> Iterator[tuple[float, float, float]]:
        """Return the combinations of step, omega_m and omega_M whose step divides the span.

        Yields
        ------
        (float, float, float)
            step, omega_m, omega_M, rad/s.
        """
        if self.only:
            yield from self.only
            return
        for step, low, high in product(self.turn_rate_step, self.turn_rate_min, self.turn_rate_max):
            count = (high - low) / step
            if high > low and abs(count - round(count)) < 1e-6:
                yield step, low, high

    def untried(self) -> tuple[Untried, ...]:
        """Return the rates and steps that no combination has, and why.

        Returns
        -------
        tuple of Untried
            Empty where all are tried, or ``only`` names the combinations.
        """
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
    """A recorded motion: every subject performs it, each with another unit of the device.

    Parameters
    ----------
    path : str
        File of poses or markers; workers read it there.
    sha256 : str
        Of its content.
    rest_s : float
        How long the body is at rest at the beginning, s.
    markers : tuple of str
        Labels of one rigid cluster, for TRC or C3D.
    body : str or None
        Or the segment that the device is worn on, found by its markers: pelvis (the device sits at L5), thorax or trunk.
    up : str or None
        Laboratory axis that points up, for markers.
    hold : bool
        The recording has no rest: its first pose is held for ``rest_s`` before it.
    """

    path: str
    sha256: str
    rest_s: float
    markers: tuple[str, ...] = ()
    body: BodyName | None = None
    up: Literal["y", "z"] | None = None
    hold: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyTask:
    """One task of a study.

    Parameters
    ----------
    name : str
        sit_to_stand, step, posturography or free; any word for a motion of one's own.
    space : Space
        What is tried.
    base : Protocol
        All that is not varied: dwell, brackets, temperatures.
    motion : OwnMotion, optional
        Performed in place of the library's task.
    """

    name: str
    space: Space
    base: Protocol
    motion: OwnMotion | None = None

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_]+", self.name):
            raise InputError(f"task: wanted a name of letters, digits and _, got '{self.name}'; rename it")
        if self.motion is None and self.name not in get_args(TaskName):
            raise InputError(
                f"task: wanted one of {', '.join(get_args(TaskName))}, got '{self.name}'; name one, or give a motion of your own"
            )

    def candidates(self, cutoff_hz: float) -> tuple[Protocol, ...]:
        """Return the protocols that are tried with one cut-off frequency.

        Parameters
        ----------
        cutoff_hz : float
            Hz.

        Returns
        -------
        tuple of Protocol
            In the order of ``space.grids``.
        """
        return tuple(
            replace(self.base, cutoff_hz=cutoff_hz, turn_rate_step=step, turn_rate_min=low, turn_rate_max=high)
            for step, low, high in self.space.grids()
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A study.

    Parameters
    ----------
    name : str
        For people.
    device : str
        Kind of device, one of the presets; every subject wears a unit of its own. For people where ``worn`` is given.
    tasks : tuple of StudyTask
        One or more.
    subjects : int
        How many, from the cohort.
    group : str
        simulation or testing, as in the note's Table 2.
    excursion_k : tuple of float
        Board temperature of the trials above the calibration's, least and greatest, K.
    objective : str
        rms or maximum of the pitch error.
    level : float
        Of the tests.
    rig_minutes_max : float or None
        Longest session that is allowed, min.
    seed : int
        Same seed, same bits.
    worn : str
        Text of a device.json, which every subject wears; none draws units of ``device``.
    """

    name: str
    device: str
    tasks: tuple[StudyTask, ...]
    subjects: int = 30
    group: Group = "simulation"
    excursion_k: tuple[float, float] = (10.0, 15.0)
    objective: Objective = "rms"
    level: float = 0.05
    rig_minutes_max: float | None = None
    seed: int = 0
    worn: str = ""

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
    """Return a study of the first and last value of everything that it tries: a first look.

    Parameters
    ----------
    study : Study
        Any.

    Returns
    -------
    Study
        At most sixteen protocols a task; all of a task's where no pair of ends divides its span.
    """
    return replace(study, tasks=tuple(map(_ends, study.tasks)))


def _ends(task: StudyTask) -> StudyTask:
    space = task.space
    ends = Space(
        cutoff_hz=_outer(space.cutoff_hz),
        turn_rate_step=_outer(space.turn_rate_step),
        turn_rate_min=_outer(space.turn_rate_min),
        turn_rate_max=_outer(space.turn_rate_max),
    )
    return replace(task, space=ends if any(True for _ in ends.grids()) else space)


def _outer(values: tuple[float, ...]) -> tuple[float, ...]:
    return values if len(values) < 3 else (values[0], values[-1])
