"""Outcome of a study: for each task the optimum, what it is worth on other subjects, its statistics, and the note's row.

surfaces -> optimum -> the other cohort -> power, optional stopping -> Table 1 beside the note's, Figure 3
-> rates to dwell at, rival methods, real recordings

Forecast: how long each stage of a study will take on this machine, all of them, before anything runs.

Calibration sessions and the other cohort are measured by a unit of each task; the rest costs about the same whatever the study is,
as timed on one processor of two that were both busy.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Literal, cast, get_args

import numpy as np

from undrift.errors import InputError, UndriftError
from undrift.sim.device.model import DeviceModel
from undrift.sim.motion.tasks import TaskName
from undrift.study.case import Unit, device_of, run_unit, seeded, units_of
from undrift.study.figure3 import EffectRow, Figure3, effect_table, figure3
from undrift.study.judge import (
    PARAMETERS,
    Beside,
    Cohort,
    Optimum,
    ParameterEffect,
    Tested,
    cohort_of,
    compare_with_note,
    find_optimum,
    other_study,
    run_testing,
)
from undrift.study.plan import DEVICE, TABLE_1, Study, StudyTask, Untried
from undrift.study.real import RealData, RealOutcome, judge_real
from undrift.study.rivals import TASKS, DesignRow, RivalRow, compare_rivals, design_rows
from undrift.study.run import Executor, RunStore, TaskSurface, count_runs, run_study, without_lost
from undrift.study.statistics import OptionalStopping, power_of_anova, stopping_of, subjects_needed
from undrift.units import RADIAN_PER_DEGREE

# ---- Forecast: how long each stage of a study will take on this machine, all of them, before anything runs.

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
    """One stage of a study."""

    name: StageName  # Which, as ``judge_study`` tells it
    seconds: float  # How long it will take, s


def forecast(study: Study, folder: Path, *, workers: int, rivals: bool, real: RealData | None) -> tuple[Stage, ...]:
    """Say how long a study will take."""
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


# ---- outcome

TESTING = "testing"
FIRST_LOOK = 10  # subjects
TOO_LONG = "every session with it takes longer than rig_minutes_max"


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectPower:
    """How surely a study of this size finds what one parameter does."""

    name: str  # Of the parameter
    power: float  # Were this study's means the truth, 0 to 1
    subjects: int | None  # For a power of 0.8; None where no number is worth it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaskOutcome:
    """What a study says of one task."""

    surface: TaskSurface  # All errors
    optimum: Optimum  # With its equals
    tested: tuple[Tested, Tested]  # The optimum and its cheapest equal on the other cohort
    # Half the 95 % interval of the means over each parameter, between-subject differences taken out (Loftus and
    # Masson, 1994); 0 where it could not be tested, deg
    effect_reach_deg: tuple[float, ...]
    powers: tuple[EffectPower, ...]  # One for each parameter that could be tested
    stopping: OptionalStopping | None  # Of the parameter with the least p; None with ten subjects or fewer
    stopping_of: str  # That parameter
    beside: Beside | None  # The note's row; None for other tasks
    untried: tuple[Untried, ...] = ()  # Values of the plan that no protocol has, or none that is short enough


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StudyOutcome:
    """What a study says."""

    study: Study  # What was done
    runs: int  # Sessions simulated, fitted and judged
    tasks: tuple[TaskOutcome, ...]  # One a task
    cohorts: tuple[Cohort, Cohort]  # Who chose, and who tested
    figure3: Figure3 | None  # For a study with a sit-to-stand
    figure3_missing: str  # Why there is none
    # What sets its two devices apart, effect by effect; empty where the rivals were not asked for either
    figure3_effects: tuple[EffectRow, ...] = ()
    designs: tuple[DesignRow, ...] = ()  # D- and I-optimal rates beside the uniform grid, by task
    rivals: tuple[RivalRow, ...] = ()  # Other ways to calibrate; empty where they were not asked for
    rivals_missing: str = "not asked for"  # Why there are none
    real: RealOutcome | None = None  # Real recordings, where some were given


def judge_study(
    study: Study,
    executor: Executor,
    folder: Path,
    *,
    advance: Callable[[int, int], None] | None = None,
    rivals: bool = False,
    real: RealData | None = None,
    say: Callable[[StageName], None] | None = None,
) -> StudyOutcome:
    """Run a study, or what is left of it, and judge it."""
    say = say or _silent
    say("calibration sessions")
    surfaces = tuple(map(without_lost, run_study(study, executor, folder, advance=advance)))
    optima = tuple(
        find_optimum(surface, objective=study.objective, level=study.level, rig_minutes_max=study.rig_minutes_max)
        for surface in surfaces
    )
    say("the other cohort")
    tested = run_testing(study, surfaces, optima, folder / TESTING)
    say("rates to dwell at")
    designs = tuple(row for held in zip(study.tasks, surfaces, optima, strict=True) for row in _designs(study, *held))
    say("Figure 3")
    figure, missing = _figure3(study)
    effects: tuple[EffectRow, ...] = ()
    if rivals and figure is not None:
        say("Figure 3, effect by effect")
        effects = _figure3_effects(study)
    rows, rivals_missing = _rivals(study, say) if rivals else ((), "not asked for")
    if real is not None:
        say("real recordings")
    return StudyOutcome(
        study=study,
        runs=count_runs(study),
        tasks=tuple(_judge(study, *held) for held in zip(study.tasks, surfaces, optima, tested, strict=True)),
        cohorts=(cohort_of(study), cohort_of(other_study(study))),
        figure3=figure,
        figure3_missing=missing,
        figure3_effects=effects,
        designs=designs,
        rivals=rows,
        rivals_missing=rivals_missing,
        real=None if real is None else judge_real(real, study),
    )


def _silent(stage: StageName) -> None:
    """Say nothing."""


def _designs(study: Study, task: StudyTask, surface: TaskSurface, optimum: Optimum) -> tuple[DesignRow, ...]:
    step, low, high = (
        round(float(getattr(surface, name)[optimum.best]), 9) * RADIAN_PER_DEGREE
        for name in ("turn_rate_step_dps", "turn_rate_min_dps", "turn_rate_max_dps")
    )
    found = replace(task.base, turn_rate_step=step, turn_rate_min=low, turn_rate_max=high)
    return design_rows(study, task, found)


def _rivals(study: Study, say: Callable[[StageName], None]) -> tuple[tuple[RivalRow, ...], str]:
    """Compare the methods on units of the study's kind, or of the note's where every subject wears one device."""
    known = get_args(TaskName)
    tasks = tuple(cast("TaskName", task.name) for task in study.tasks if task.motion is None and task.name in known)
    say("rival methods")
    try:
        return compare_rivals(kind=DEVICE if study.worn else study.device, seed=study.seed, tasks=tasks or TASKS), ""
    except UndriftError as error:  # this device cannot be calibrated so: the study's own figures stand
        return (), str(error)


def _judge(
    study: Study, task: StudyTask, surface: TaskSurface, optimum: Optimum, tested: tuple[Tested, Tested]
) -> TaskOutcome:
    row = TABLE_1.get(cast("TaskName", surface.task))
    least, stopping = _stopping(study, surface, optimum)
    return TaskOutcome(
        surface=surface,
        optimum=optimum,
        tested=tested,
        effect_reach_deg=tuple(map(_reach, optimum.effects)),
        powers=tuple(_power(study, effect) for effect in optimum.effects if effect.test is not None),
        stopping=stopping,
        stopping_of=least,
        beside=None
        if row is None
        else compare_with_note(surface, optimum, row, objective=study.objective, level=study.level),
        untried=(*task.space.untried(), *_too_long(study, surface)),
    )


def _too_long(study: Study, surface: TaskSurface) -> tuple[Untried, ...]:
    """Return the rates and steps whose every session is longer than is allowed."""
    most = np.inf if study.rig_minutes_max is None else study.rig_minutes_max
    rows = []
    for name in PARAMETERS[1:]:
        values = getattr(surface, name)
        for value in np.unique(values):
            if (surface.rig_minutes[values == value] > most).all():
                rate = float(value) * RADIAN_PER_DEGREE
                rows.append(Untried(parameter=name.removesuffix("_dps"), value=rate, reason=TOO_LONG))
    return tuple(rows)


def _reach(effect: ParameterEffect) -> float:
    from scipy.stats import t as t_distribution

    found = effect.test
    if found is None:
        return 0.0
    return float(t_distribution.ppf(0.975, found.dof[1]) * np.sqrt(effect.error_variance / found.subjects))


def _power(study: Study, effect: ParameterEffect) -> EffectPower:
    found = effect.test
    if found is None:
        return EffectPower(name=effect.name, power=float("nan"), subjects=None)
    means, variance, epsilon = found.means, effect.error_variance, effect.epsilon
    try:
        count: int | None = subjects_needed(means, variance, epsilon=epsilon, level=study.level)
    except InputError:  # the means hardly differ: no number of subjects is worth it
        count = None
    reached = power_of_anova(means, variance, found.subjects, epsilon=epsilon, level=study.level)
    return EffectPower(name=effect.name, power=reached, subjects=count)


def _stopping(study: Study, surface: TaskSurface, optimum: Optimum) -> tuple[str, OptionalStopping | None]:
    """Look again at the parameter with the least p as if after each subject."""
    tested = [effect for effect in optimum.effects if effect.test is not None]
    if not tested:
        return "", None
    least = min(tested, key=lambda effect: effect.p_holm)
    others = [name for name in PARAMETERS if name != least.name]
    columns = {name: getattr(surface, name) for name in PARAMETERS}
    same = np.all([np.isclose(columns[name], columns[name][optimum.best]) for name in others], axis=0)
    held = same & np.isin(columns[least.name], least.values)
    table = surface.error(study.objective)[:, held]
    table = table[np.isfinite(table).all(axis=1)]  # looks are at subjects with every run
    if len(table) <= FIRST_LOOK:
        return "", None
    rng = seeded(study, "stopping", surface.task)
    return least.name, stopping_of(table, first=FIRST_LOOK, level=study.level, simulations=400, rng=rng)


def _figure3(study: Study) -> tuple[Figure3 | None, str]:
    if not any(task.name == "sit_to_stand" and task.motion is None for task in study.tasks):
        return None, "the study has no sit-to-stand of the library"
    try:
        return figure3(_typical(study), seed=study.seed, excursion_k=sum(study.excursion_k) / 2.0), ""
    except UndriftError as error:  # this device cannot be calibrated so: the study's own figures stand
        return None, str(error)


def _figure3_effects(study: Study) -> tuple[EffectRow, ...]:
    try:
        return effect_table(_typical(study), seed=study.seed, excursion_k=sum(study.excursion_k) / 2.0, back=False)
    except UndriftError:  # an effect alone can be more than the fit takes: the figure stands without its table
        return ()


def _typical(study: Study) -> DeviceModel:
    from undrift.sim.device.presets import preset

    return device_of(study, 0) if study.worn else preset(study.device)
