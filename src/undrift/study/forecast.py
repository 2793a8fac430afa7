"""Forecast: how long each stage of a study will take on this machine, all of them, before anything runs.

Calibration sessions and the other cohort are measured by a unit of each task; the rest costs about the same whatever the study is,
as timed on one processor of two that were both busy.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Literal

from undrift.study.plan import Study, StudyTask
from undrift.study.real_plan import RealData
from undrift.study.store import RunStore
from undrift.study.unit import Unit, run_unit, units_of

StageName = Literal[
    "calibration sessions",
    "the other cohort",
    "rates to dwell at",
    "Figure 3",
    "Figure 3, effect by effect",
    "rival methods",
    "real recordings",
]
POOL_S = 3.0  # workers start
DESIGNS_S = 0.4  # a task
FIGURE3_S = 4.0
EFFECTS_S = 15.0
RIVALS_S = 20.0  # units are calibrated by every method once, for all tasks
TRIAL_S, WORN_S, ROWS_S = 2.5, 3.5, 0.3  # a real trial; the device worn in captures; a capture or stance


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """One stage of a study.

    Parameters
    ----------
    name : str
        Which, as ``judge_study`` tells it.
    seconds : float
        How long it will take, s.
    """

    name: StageName
    seconds: float


def forecast(study: Study, folder: Path, *, workers: int, rivals: bool, real: RealData | None) -> tuple[Stage, ...]:
    """Say how long a study will take.

    Parameters
    ----------
    study : Study
        What to do.
    folder : Path
        What it holds already is not done again.
    workers : int
        That share the calibration sessions.
    rivals : bool
        Whether rival methods and Figure 3 effect by effect are made.
    real : RealData or None
        Recordings to judge.

    Returns
    -------
    tuple of Stage
        In the order in which they are done; those that will not be are left out.
    """
    store = RunStore(folder, study)
    left = [unit for unit in units_of(study) if not store.holds(unit)]
    sessions, cohort = 0.0, 0.0
    for task in study.tasks:
        own = [unit for unit in left if unit.task.name == task.name]
        one = Unit(study=study, task=_one(task), subject=0, cutoff_hz=task.space.cutoff_hz[0])
        run_unit(one)  # what is compiled or imported the first time does not count
        cohort += 2.0 * study.subjects * _unit_s(one)
        sessions += len(own) * _unit_s(own[0]) if own else 0.0
    stages = [
        Stage(name="calibration sessions", seconds=sessions / workers + (POOL_S if left and workers > 1 else 0.0)),
        Stage(name="the other cohort", seconds=cohort),
        Stage(name="rates to dwell at", seconds=DESIGNS_S * len(study.tasks)),
    ]
    figured = any(task.name == "sit_to_stand" and task.motion is None for task in study.tasks)
    if figured:
        stages.append(Stage(name="Figure 3", seconds=FIGURE3_S))
    if figured and rivals:
        stages.append(Stage(name="Figure 3, effect by effect", seconds=EFFECTS_S))
    if rivals:
        stages.append(Stage(name="rival methods", seconds=RIVALS_S))
    if real is not None:
        stages.append(Stage(name="real recordings", seconds=_real_s(real)))
    return tuple(stages)


def _real_s(real: RealData) -> float:
    trials = sum(len(device.pairs) for device in real.devices)
    return TRIAL_S * trials + WORN_S * bool(real.captures) + ROWS_S * (len(real.captures) + len(real.stances))


def _one(task: StudyTask) -> StudyTask:
    space = task.space
    return replace(task, space=replace(space, only=(next(space.grids()),)))


def _unit_s(unit: Unit) -> float:
    start = perf_counter()
    run_unit(unit)
    return perf_counter() - start
