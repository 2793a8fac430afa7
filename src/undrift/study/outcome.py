"""Outcome of a study: for each task the optimum, its error on other subjects, its statistics, and the note's row.

    surfaces -> optimum -> the other cohort -> power, optional stopping -> Table 1 with the note's rows, Figure 3
             -> rates to dwell at, rival methods, real recordings

What the error of an optimum is made of, and which effect hides a parameter: the optimum's values of each parameter, the others at
the optimum, are run again with one effect switched off (study/case.py) and the draws of all the others. Mean squares of
independent errors add. So the part of an effect is what the mean square loses where that effect is switched off; what no single
effect takes belongs to several together. An effect hides a parameter whose values differ by more than the margin without that
effect alone.

The forecast gives the time of each stage on this machine before anything runs. Calibration sessions and the other cohort are
measured by a unit of each task; the rest costs about the same whatever the study is, as timed on one of two busy processors.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, groupby
from operator import call
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, NamedTuple, cast, get_args

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError
from undrift.findings import Finding, finding
from undrift.sim.motion.tasks import TaskName
from undrift.study import judge, run, search
from undrift.study import target as targets
from undrift.study.case import EffectName, Unit, effects_of_study, run_unit, run_units, seeded, typical_unit, units_of
from undrift.study.figure3 import DRAWN_UNITS, DrawnRow, EffectRow, Figure3, drawn_cohort, effect_table, figure3
from undrift.study.plan import AIM, DEVICE, MARGIN_DEG, TABLE_1, Aim, Study, StudyTask, column_of
from undrift.study.real import RealData, RealOutcome, judge_real, tried
from undrift.study.rivals import TASKS, UNITS, RivalPlan, RivalRow, Rivals, TriadRow, compare_rivals
from undrift.study.space import TURN_RATES, Setting, Untried
from undrift.study.statistics import (
    Anova,
    MixedModel,
    OneWay,
    OptionalStopping,
    compare_pairs,
    mean_interval,
    power_of_anova,
    stopping_of,
    subjects_needed,
)
from undrift.units import RADIAN_PER_DEGREE

# ---- what the error of an optimum is made of

MOST_VALUES = 5  # of a parameter that are run again: the optimum's with its neighbours, and both ends


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """What one effect adds to the error, and whether it hides what a parameter does."""

    effect: str  # One of ``effects_of_study``
    share: float  # Of the mean square that is lost without it; below 0 where the error grows
    share_interval: tuple[float, float]  # Its 95 % interval over the subjects
    rms_deg: float  # Root of that loss, deg; 0 where there is none
    judged: judge.ParameterVerdict  # The parameter's values without the effect
    best: int  # Place of the value with the least error without it
    span_deg: float  # Greatest less least mean error over the values without it, deg


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorBreakdown:
    """The error with one value of a parameter, by effect, and what each effect hides."""

    parameter: str  # One of the surface's ``names``
    values: FloatArray  # (k,), that were run, Hz or deg/s
    rms_deg: float  # With all effects, root of the mean square over the subjects, deg
    judged: judge.ParameterVerdict  # The parameter's values with all effects
    terms: tuple[Term, ...]  # By falling share
    together: float  # Share that no single effect takes with it: several at once, or none of those switched off

    @property
    def covering(self) -> tuple[Term, ...]:
        """Effects without which the parameter is worth setting, though it is not with all of them."""
        if self.judged.verdict == "better":
            return ()
        return tuple(term for term in self.terms if term.judged.verdict == "better")

    @property
    def finding(self) -> Finding | None:
        """What hides the parameter; None where it decides the error."""
        if self.judged.verdict == "better":
            return None
        numbers = {
            "parameter": judge.SYMBOLS[self.parameter],
            "verdict": self.judged.verdict,
            "margin_deg": self.judged.widest.margin,
        }
        if not (covering := self.covering):
            return finding("study.not_covered", "info", **numbers)
        spans, p = (tuple(each) for each in zip(*((t.span_deg, t.judged.p_better) for t in covering), strict=True))
        return finding(
            "study.covered", "warn", effects=tuple(t.effect for t in covering), span_deg=spans, p=p, **numbers
        )


def split_findings(splits: tuple[ErrorBreakdown, ...], deciding: Collection[str] = ()) -> tuple[Finding, ...]:
    """Say what the error of an optimum is made of, and what hides each parameter but those that decide it over all protocols."""
    if not splits:
        return ()
    first = splits[0]  # all are about one protocol
    names, shares = (tuple(each) for each in zip(*((t.effect, 100.0 * t.share) for t in first.terms), strict=True))
    made_of = finding(
        "study.error_split",
        "info",
        effects=names,
        share_percent=shares,
        rms_deg=first.rms_deg,
        together_percent=100.0 * first.together,
    )
    hidden = (split.finding for split in splits if split.parameter not in deciding)
    return (made_of, *(each for each in hidden if each is not None))


def split_error(
    parameter: str,
    values: FloatArray,
    error: FloatArray,
    without: Mapping[EffectName, FloatArray],
    *,
    at: int,
    aim: Aim = AIM,
) -> ErrorBreakdown:
    """Split the error at one of a parameter's values: error with all effects, and without each, (S, k) deg, k values."""
    wrong = [name for name, other in without.items() if other.shape != error.shape]
    if error.ndim != 2 or min(error.shape) < 2 or wrong or not without:
        named = ", ".join(wrong) or f"{error.shape} of {len(without)} effects"
        raise InputError(
            f"split: wanted subjects by two values or more, alike for all effects, got {named}; run each effect alike"
        )
    tests = 1 + len(without)
    total = float((error[:, at] ** 2).mean())
    terms = []
    for effect, other in without.items():
        loss = error[:, at] ** 2 - other[:, at] ** 2
        lost = float(loss.mean())
        _, ends = mean_interval(loss - lost / total * error[:, at] ** 2)  # both change with the subjects: about 0
        mean = other.mean(axis=0)
        terms.append(
            Term(
                effect=effect,
                share=lost / total,
                share_interval=((lost + ends[0]) / total, (lost + ends[1]) / total),
                rms_deg=float(np.sqrt(max(lost, 0.0))),
                judged=_verdict(other, aim, tests),
                best=int(np.argmin(mean)),
                span_deg=float(np.ptp(mean)),
            )
        )
    terms.sort(key=lambda term: -term.share)
    return ErrorBreakdown(
        parameter=parameter,
        values=values,
        rms_deg=float(np.sqrt(total)),
        judged=_verdict(error, aim, tests),
        terms=tuple(terms),
        together=1.0 - sum(term.share for term in terms),
    )


def _verdict(error: FloatArray, aim: Aim, tests: int) -> judge.ParameterVerdict:
    best, subjects = int(np.argmin(error.mean(axis=0))), len(error)
    return judge.judge_values(best, compare_pairs(error), subjects, aim, tests=tests)


# ---- runs with an effect switched off


def units_without(study: Study, task: StudyTask, surface: run.TaskSurface, optimum: judge.Optimum) -> tuple[Unit, ...]:
    """Return the units that split the error of an optimum, those of a subject one after the other."""
    lines = _lines(surface, optimum)
    places = np.unique(np.concatenate(list(lines.values()))) if lines else np.empty(0, dtype=np.int64)
    parts = dict[Setting, list[FloatArray]]()
    for point in points_of(task, surface)[places]:
        parts.setdefault(task.space.setting_of(point), []).append(point)
    tasks = [(replace(task, space=task.space.narrowed(np.array(of))), setting) for setting, of in parts.items()]
    return tuple(
        Unit(study=study, task=part, subject=subject, setting=setting, without=effect)
        for subject in _subjects(study, surface)
        for effect in effects_of_study(study)
        for part, setting in tasks
    )


def split_study(
    study: Study,
    surfaces: tuple[run.TaskSurface, ...],
    optima: tuple[judge.Optimum, ...],
    executor: run.Executor,
    *,
    beside: Sequence[Callable[[], Any]] = (),
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[tuple[tuple[ErrorBreakdown, ...], ...], list[Any]]:
    """Split the error of each task's optimum along its parameters; return what other jobs gave that are done beside it too.

    ``advance`` gets units done and units in all.
    """
    held = list(zip(study.tasks, surfaces, optima, strict=True))
    units = [(k, unit) for k, each in enumerate(held) for unit in units_without(study, *each)]
    tables = [
        {effect: np.full(surface.error_rms_deg.shape, np.nan) for effect in effects_of_study(study)}
        for surface in surfaces
    ]
    rows = [{subject: row for row, subject in enumerate(_subjects(study, surface))} for surface in surfaces]
    places = [
        {tuple(point): place for place, point in enumerate(points_of(task, surface).tolist())}
        for task, surface, _ in held
    ]
    groups = [tuple(of) for _, of in groupby(units, lambda each: (each[0], each[1].subject))]
    jobs = [*beside, *(partial(run_units, tuple(unit for _, unit in of)) for of in groups)]
    others: list[Any] = [None] * len(beside)
    done, total = 0, len(beside) + len(units)
    advance(done, total)
    for number, runs in executor.run(cast("Callable[[Any], Any]", call), jobs):
        done += 1 if number < len(beside) else len(runs)
        advance(done, total)
        if number < len(beside):
            others[number] = runs
            continue
        for (k, unit), errors in zip(groups[number - len(beside)], runs, strict=True):
            if unit.without is not None:
                own = [places[k][tuple(point)] for point in unit.task.space.points().tolist()]
                tables[k][unit.without][rows[k][unit.subject], own] = errors[column_of(study.objective, study.timing)]
    rows_of = zip(held, tables, strict=True)
    return tuple(_split(study, surface, optimum, found) for (_, surface, optimum), found in rows_of), others


def _split(
    study: Study, surface: run.TaskSurface, optimum: judge.Optimum, found: Mapping[EffectName, FloatArray]
) -> tuple[ErrorBreakdown, ...]:
    """Split the error along each parameter with two values or more, by the subjects of whom every run is there."""
    every, splits = surface.aimed(study), []
    for name, line in _lines(surface, optimum).items():
        without = {effect: table[:, line] for effect, table in found.items()}
        there = np.isfinite([every[:, line], *without.values()]).all(axis=(0, 2))
        if there.sum() > 2:
            splits.append(
                split_error(
                    name,
                    surface.column(name)[line],
                    every[np.ix_(there, line)],
                    {effect: table[there] for effect, table in without.items()},
                    at=int(np.flatnonzero(line == optimum.best)[0]),
                    aim=study,
                )
            )
    return tuple(splits)


def _subjects(study: Study, surface: run.TaskSurface) -> list[int]:
    return [subject for subject in range(study.subjects) if subject not in surface.left_out]


def _lines(surface: run.TaskSurface, optimum: judge.Optimum) -> dict[str, IntArray]:
    """Return the places of the protocols that differ from the optimum in one parameter, by rising values; five at most."""
    lines = {}
    for effect in optimum.effects:
        line = surface.line(optimum.best, effect.name)
        line = line[np.isin(surface.column(effect.name)[line], effect.values)]
        if len(line) > MOST_VALUES:
            at, last = int(np.flatnonzero(line == optimum.best)[0]), len(line) - 1
            line = line[sorted({0, max(at - 1, 0), at, min(at + 1, last), last})]
        if len(line) > 1:
            lines[effect.name] = line
    return lines


def points_of(task: StudyTask, surface: run.TaskSurface) -> FloatArray:
    """Return the protocols of a surface as the plan has their values, (P, n)."""
    units = [RADIAN_PER_DEGREE if name.endswith("_dps") else 1.0 for name in surface.names]
    held = [surface.column(name) * unit for name, unit in zip(surface.names, units, strict=True)]
    lists = map(np.array, task.space.values)
    return np.stack([v[np.abs(v - own[:, None]).argmin(axis=1)] for v, own in zip(lists, held, strict=True)], axis=1)


# ---- forecast

StageName = Literal[
    "calibration sessions", "the other cohort", "what the error is made of", "Figure 3, effect by effect",
    "Figure 3, drawn units", "rival methods", "real recordings",
]  # fmt: skip
POOL_S = 3.0  # workers start
DESIGNS_S = 0.4  # a task
FIGURE3_S = 3.0
EFFECTS_S = 9.0
DRAWN_S = 5.0  # a unit of the drawn cohort: the thermal fits of its simulated and its actual device
RIVALS_S = 10.0  # a unit, calibrated by every method once, for all tasks
TRIAL_S, WORN_S, ROWS_S = 2.5, 3.5, 0.3  # a real trial; the device worn in captures; a capture or stance


class Stage(NamedTuple):
    """One stage of a study and its forecast."""

    name: StageName
    seconds: float


def forecast(study: Study, folder: Path, *, workers: int, rivals: bool, real: RealData | None) -> tuple[Stage, ...]:
    """Return the stages of a study with their times; what is on the disk already costs nothing."""
    store, searched = run.RunStore(folder, study), study.search != "grid"
    sessions, cohort, split = 0.0, 0.0, 0.0
    for task in study.tasks:
        whole = Unit(study=study, task=task, subject=0, setting=task.space.setting_of(task.space.first[0]))
        one = replace(whole, task=replace(task, space=task.space.narrowed(task.space.first)))
        run_unit(one)  # what is compiled or imported the first time does not count
        crossed = sum(other.name == task.name for other in study.tasks)
        unit_s = _unit_s(one)
        cohort += (2.0 + (crossed if crossed > 1 else 0)) * study.subjects * unit_s
        split += len(effects_of_study(study)) * study.subjects * min(len(task.space.cutoff_hz), MOST_VALUES) * unit_s
        if study.search == "cma" or search.tried_of(study, task) < task.space.count:  # hardly two of one setting
            sessions += search.runs_of_task(study, task) * unit_s
        elif searched:
            share = search.runs_of_task(study, task) / (study.subjects * task.space.count)
            sessions += share * study.subjects * len(task.space.settings()) * _unit_s(whole)
        elif left := [unit for unit in units_of(replace(study, tasks=(task,))) if not store.holds(unit)]:
            sessions += len(left) * _unit_s(left[0])
    if searched:
        sessions *= max(1.0 - run.runs_held(folder) / search.count_runs(study), 0.0)
    figured, real_s = _has_figure3(study), 0.0
    beside = DESIGNS_S * len(study.tasks) + FIGURE3_S * figured
    if real is not None:
        trials, rows = sum(len(device.pairs) for device in real.devices), len(real.captures) + len(real.stances)
        real_s = TRIAL_S * trials + WORN_S * bool(real.captures) + ROWS_S * rows + FIGURE3_S * bool(real.actual)
    stages = (
        Stage("calibration sessions", sessions / workers + (POOL_S if sessions and workers > 1 else 0.0)),
        Stage("the other cohort", cohort),
        Stage("what the error is made of", (split + beside) / workers + (POOL_S if workers > 1 else 0.0)),
        Stage("Figure 3, effect by effect", EFFECTS_S if figured and rivals else 0.0),
        Stage("Figure 3, drawn units", DRAWN_UNITS * DRAWN_S / workers if figured and rivals else 0.0),
        Stage("rival methods", UNITS * RIVALS_S / workers if rivals else 0.0),
        Stage("real recordings", real_s),
    )
    return tuple(stage for place, stage in enumerate(stages) if place < 3 or stage.seconds > 0.0)


def duration(seconds: float) -> str:
    """Return a time in s, min or h."""
    if seconds < 90.0:
        return f"{max(seconds, 1.0):.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


class StudyProgress:
    """Says how far a study is: what is being done and the share of the whole, by the forecast of its stages.

    Lines above the last of a text stay: each stage with its forecast, each round of a search.
    """

    def __init__(self, progress: Callable[[str, float], None], stages: tuple[Stage, ...] = ()) -> None:
        self._progress, self._stages, self._stage = progress, stages, ""

    def begin(self, stage: StageName) -> None:
        """Take which stage begins; one without a forecast has nothing to do."""
        names, self._stage = [each.name for each in self._stages], stage
        if stage in names:
            left = self._stages[names.index(stage) :]
            rest = f"; {duration(sum(each.seconds for each in left))} left in all" if len(left) > 1 else ""
            self.tell(f"{stage}, about {duration(left[0].seconds)}{rest}")

    def tell(self, line: str) -> None:
        """Take a line about the stage."""
        self._progress(f"{line}\n{self._stage}", self._share(0.0))

    def advance(self, done: int, total: int, counted: str = "units of work") -> None:
        """Take how much of the stage is done."""
        self._progress(f"{self._stage}: {done} of {total} {counted}", self._share(done / max(total, 1)))

    def _share(self, part: float) -> float:
        whole, before_s = sum(stage.seconds for stage in self._stages), 0.0
        for stage in self._stages:
            if stage.name == self._stage:
                return (before_s + part * stage.seconds) / whole if whole > 0.0 else part
            before_s += stage.seconds
        return part


def _has_figure3(study: Study) -> bool:
    return any(task.name == "sit_to_stand" and task.motion is None for task in study.tasks)


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
    """Power of a study of this size for one parameter."""

    name: str  # Of the parameter
    power: float  # Were this study's means the truth, 0 to 1
    subjects: int | None  # For a power of 0.8; None where no number is enough


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaskOutcome:
    """What came out of one task."""

    surface: run.TaskSurface  # All errors; of the last round's protocols in a halving
    optimum: judge.Optimum  # With its equals
    tested: tuple[judge.Tested, judge.Tested]  # The optimum and its cheapest equal on the other cohort
    target: targets.CheapestSession | None  # The cheapest session that is good enough; None where no target is stated
    # Half the 95 % interval of the means over each parameter, between-subject differences taken out (Loftus and
    # Masson, 1994); 0 where it could not be tested, deg
    effect_reach_deg: tuple[float, ...]
    powers: tuple[EffectPower, ...]  # One for each parameter that could be tested
    stopping: OptionalStopping | None  # Of the parameter with the least p; None with ten subjects or fewer
    stopping_of: str  # That parameter
    one_way: OneWay | None  # All protocols as if other subjects had met each, as the note may have; None: not possible
    repeated: Anova | None  # The same by repeated measures
    note: judge.NoteComparison | None  # With the note's row; None for other tasks
    splits: tuple[ErrorBreakdown, ...]  # Of the optimum's error, by parameter; none of one that has a single value
    untried: tuple[Untried, ...]  # Values of the plan that no protocol has, or none that is short enough
    halving: search.Halving | None  # Its rounds, where protocols were searched so
    front: search.Front  # Of error against minutes on the rig

    @property
    def to_use(self) -> tuple[int, judge.Tested]:
        """The protocol to use, and what it does on the other cohort: by the target, or the cheapest equal of the optimum."""
        return (
            (self.optimum.cheapest, self.tested[1]) if self.target is None else (self.target.place, self.target.tested)
        )

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What a person should know of this task."""
        note = () if self.note is None else self.note.findings
        target = () if self.target is None else (self.target.finding,)
        deciding = {each.name for each in self.optimum.effects if each.judged and each.judged.verdict == "better"}
        split = split_findings(self.splits, deciding)
        return (*target, *_findings(self), *split, *untried_findings(self.untried), *note)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StudyOutcome:
    """What came out of a study."""

    study: Study
    runs: int  # Sessions simulated, fitted and judged
    tasks: tuple[TaskOutcome, ...]  # One a task
    cohorts: tuple[judge.Cohort, ...]  # Of each category who chose, and who tested
    figure3: Figure3 | None  # For a study with a sit-to-stand
    figure3_missing: Finding | None  # Why there is none
    # Differences of its two devices, effect by effect; empty where the rivals were not asked for either
    figure3_effects: tuple[EffectRow, ...] = ()
    # Largest errors of drawn units, one row for each compensation; empty where the rivals were not asked for
    figure3_drawn: tuple[DrawnRow, ...] = ()
    designs: tuple[search.DesignRow, ...] = ()  # D- and I-optimal rates and the uniform grid, by task
    rivals: tuple[RivalRow, ...] = ()  # Other ways to calibrate; empty where they were not asked for
    rival_triads: tuple[TriadRow, ...] = ()  # Each triad alone by each of them
    rivals_missing: Finding | None = None  # Why there are none
    real: RealOutcome | None = None  # Real recordings, where some were given
    categories: tuple[judge.CategoryComparison, ...] = ()  # One a task that several categories perform


def judge_study(
    study: Study,
    executor: run.Executor,
    folder: Path,
    *,
    course: StudyProgress = StudyProgress(lambda what, share: None),
    rivals: bool = False,
    real: RealData | None = None,
) -> StudyOutcome:
    """Run a study, or what is left of it, and judge it."""
    begin = course.begin
    begin("calibration sessions")
    halvings: tuple[search.Halving | None, ...] = (None,) * len(study.tasks)
    if study.search == "grid":
        runs, met = search.count_runs(study), run.run_study(study, executor, folder, advance=course.advance)
    else:
        advance = partial(course.advance, counted="runs")
        halvings = halved = search.search_study(study, executor, folder, advance=advance, tell=course.tell)
        runs, met = sum(each.runs for each in halved), tuple(each.surface for each in halved)
    surfaces = tuple(map(run.without_lost, met))
    optima = tuple(judge.find_optimum(surface, study) for surface in surfaces)
    begin("the other cohort")
    chosen = tuple(map(partial(targets.choose, aim=study), study.tasks, surfaces, optima))
    others, tested = judge.other_study(study), _on_others(study, surfaces, optima, chosen, folder / TESTING, executor)
    categories = judge.compare_categories(study, surfaces, optima, folder / TESTING)
    begin("what the error is made of")
    warmer, tasks = sum(study.excursion_k) / 2.0, zip(study.tasks, surfaces, optima, strict=True)
    jobs: list[Callable[[], Any]] = [partial(_figure3_of, study, warmer)]
    jobs += [partial(_designs, study, *each) for each in tasks]
    splits, rest = split_study(study, surfaces, optima, executor, beside=jobs, advance=course.advance)
    (figure, missing), *designs = rest
    effects, drawn = tuple[EffectRow, ...](), tuple[DrawnRow, ...]()
    compared: Rivals | None = None
    rivals_missing: Finding | None = finding("study.rivals_not_asked", "info")
    if rivals and figure is not None:
        effects, drawn = _beside_figure3(study, warmer, executor, course)
    if rivals:
        begin("rival methods")
        compared, rivals_missing = tried("Other ways to calibrate", lambda: _rivals(study, executor, course.advance))
    if real is not None:
        begin("real recordings")
    return StudyOutcome(
        study=study,
        runs=runs,
        tasks=tuple(map(partial(_judge, study), study.tasks, surfaces, optima, tested, chosen, splits, halvings)),
        cohorts=tuple(judge.cohort_of(each, kind) for kind in study.categories for each in (study, others)),
        figure3=figure,
        figure3_missing=missing,
        figure3_effects=effects,
        figure3_drawn=drawn,
        designs=tuple(chain.from_iterable(designs)),
        rivals=compared.rows if compared else (),
        rival_triads=compared.triads if compared else (),
        rivals_missing=rivals_missing,
        real=None if real is None else judge_real(real, study),
        categories=categories,
    )


def _figure3_of(study: Study, excursion_k: float) -> tuple[Figure3 | None, Finding | None]:
    """Return the figure of a study with a sit-to-stand, or why there is none."""
    if not _has_figure3(study):
        return None, finding("study.no_sit_to_stand", "info")
    return tried("Figure 3", lambda: figure3(typical_unit(study), seed=study.seed, excursion_k=excursion_k))


def _on_others(
    study: Study,
    surfaces: tuple[run.TaskSurface, ...],
    optima: tuple[judge.Optimum, ...],
    chosen: tuple[int | None, ...],
    folder: Path,
    executor: run.Executor,
) -> tuple[tuple[judge.Tested, ...], ...]:
    """Run each task's optimum, its cheapest equal and, with a target, what was chosen on the other cohort."""
    places = [[int(getattr(optimum, name)) for optimum in optima] for name in ("best", "cheapest")]
    if study.target_deg is not None:
        places.append([o.best if place is None else place for o, place in zip(optima, chosen, strict=True)])
    return judge.run_testing(study, surfaces, places, folder, executor)


def _designs(
    study: Study, task: StudyTask, surface: run.TaskSurface, optimum: judge.Optimum
) -> tuple[search.DesignRow, ...]:
    dps = {name: round(float(getattr(surface, f"{name}_dps")[optimum.best]), 9) for name in TURN_RATES}
    rates: dict[str, Any] = {name: rate * RADIAN_PER_DEGREE for name, rate in dps.items()}
    return search.design_rows(study, task, replace(task.base, **rates))


def _beside_figure3(
    study: Study, excursion_k: float, executor: run.Executor, course: StudyProgress
) -> tuple[tuple[EffectRow, ...], tuple[DrawnRow, ...]]:
    """Return the figure effect by effect, and over units of the study's kind, or of the note's where all wear one device."""
    unit, kind = typical_unit(study), DEVICE if study.worn else study.device
    words: Any = {"seed": study.seed, "excursion_k": excursion_k}
    course.begin("Figure 3, effect by effect")
    effects, _ = tried("Figure 3", lambda: effect_table(unit, back=False, **words))
    course.begin("Figure 3, drawn units")
    drawn, _ = tried("Figure 3", lambda: drawn_cohort(kind, executor=executor, advance=course.advance, **words))
    return effects or (), drawn or ()


def _rivals(study: Study, executor: run.Executor, advance: Callable[[int, int], None]) -> Rivals:
    """Compare the methods on units of the study's kind, or of the note's where every subject wears one device."""
    known = get_args(TaskName)
    held = (cast("TaskName", task.name) for task in study.tasks if task.motion is None and task.name in known)
    tasks = tuple(dict.fromkeys(held))
    plan = RivalPlan(
        kind=DEVICE if study.worn else study.device,
        seed=study.seed,
        tasks=tasks or TASKS,
        errors=study.bench,
        margin_deg=study.margin_deg / MARGIN_DEG[study.objective] * MARGIN_DEG["maximum"],
        level=study.level,
    )
    return compare_rivals(plan, executor=executor, advance=advance)


def _judge(
    study: Study,
    task: StudyTask,
    surface: run.TaskSurface,
    optimum: judge.Optimum,
    tested: tuple[judge.Tested, ...],
    chosen: int | None,
    splits: tuple[ErrorBreakdown, ...],
    halving: search.Halving | None,
) -> TaskOutcome:
    row = TABLE_1.get(cast("TaskName", surface.task)) if study.of_note else None
    least, stopping = _stopping(study, surface, optimum)
    one_way, repeated = judge.analyses_of(surface, study)
    return TaskOutcome(
        surface=surface,
        optimum=optimum,
        tested=(tested[0], tested[1]),
        target=targets.judge_target(task, surface, optimum, chosen, tested[-1], _obstacle(splits), study),
        effect_reach_deg=tuple(map(_reach, optimum.effects)),
        powers=tuple(_power(study, effect, effect.test) for effect in optimum.effects if effect.test),
        stopping=stopping,
        stopping_of=least,
        one_way=one_way,
        repeated=repeated,
        note=row if row is None else judge.compare_with_note(surface, optimum, row, study),
        splits=splits,
        untried=(*task.space.untried(), *_too_long(study, surface if halving is None else halving.every)),
        halving=halving,
        front=search.front_of(surface if halving is None else run.without_lost(halving.every), study),
    )


def _obstacle(splits: tuple[ErrorBreakdown, ...]) -> tuple[str, float] | None:
    """Return the effect with the largest share of an optimum's error."""
    return (splits[0].terms[0].effect, splits[0].terms[0].share) if splits else None


def _too_long(study: Study, surface: run.TaskSurface) -> tuple[Untried, ...]:
    """Return the rates and steps whose every session is longer than is allowed."""
    most = np.inf if study.rig_minutes_max is None else study.rig_minutes_max
    rows = []
    for name in judge.PARAMETERS[1:]:
        values = getattr(surface, name)
        for value in np.unique(values):
            if (surface.rig_minutes[values == value] > most).all():
                rate = float(value) * RADIAN_PER_DEGREE
                rows.append(Untried(parameter=name.removesuffix("_dps"), value=rate, reason=TOO_LONG))
    return tuple(rows)


def _reach(effect: judge.ParameterEffect) -> float:
    from scipy.stats import t as t_distribution

    if (found := effect.test) is None:
        return 0.0
    return float(t_distribution.ppf(0.975, found.dof[1]) * np.sqrt(effect.error_variance / found.subjects))


def _power(study: Study, effect: judge.ParameterEffect, found: Anova | MixedModel) -> EffectPower:
    means, variance, epsilon = found.means, effect.error_variance, effect.epsilon
    count = subjects_needed(means, variance, epsilon=epsilon, level=study.level)
    reached = power_of_anova(means, variance, found.subjects, epsilon=epsilon, level=study.level)
    return EffectPower(name=effect.name, power=reached, subjects=count)


def _stopping(study: Study, surface: run.TaskSurface, optimum: judge.Optimum) -> tuple[str, OptionalStopping | None]:
    """Look again at the parameter with the least p as if after each subject."""
    tested = [effect for effect in optimum.effects if effect.test is not None]
    if not tested:
        return "", None
    least = min(tested, key=lambda effect: effect.p_holm)
    table = surface.aimed(study)[:, np.sort(least.places)]
    table = table[np.isfinite(table).all(axis=1)]  # looks are at subjects with every run
    if len(table) <= FIRST_LOOK:
        return "", None
    rng = seeded(study, "stopping", surface.task)
    return least.name, stopping_of(table, first=FIRST_LOOK, level=study.level, simulations=400, rng=rng)


# ---- findings


def _findings(task: TaskOutcome) -> tuple[Finding, ...]:
    found, surface, halving = task.optimum, task.surface, task.halving
    subjects, alike, protocols = len(surface.error_rms_deg), int(found.equivalent.sum()), len(surface.cutoff_hz)
    margin, rows = found.margin_deg, list[Finding]()
    if surface.left_out:
        rows.append(finding("study.subjects_left_out", "warn", subjects=surface.left_out))
    if found.failed:
        rows.append(finding("study.runs_missing", "warn", missing=found.failed, runs=surface.error_rms_deg.size))
    if mixed := tuple(judge.SYMBOLS[effect.name] for effect in found.effects if effect.mixed is not None):
        rows.append(finding("study.mixed_model", "warn", parameters=mixed))
    if found.cheapest != found.best:
        saved = float(surface.rig_minutes[found.best] - surface.rig_minutes[found.cheapest])
        more = float(surface.error("rms", found.timing)[:, found.cheapest].mean()) - found.error_rms_deg
        rows.append(finding("study.shorter_session", "info", saved_min=saved, difference_deg=more, margin_deg=margin))
    if found.edges:
        edges = tuple(judge.SYMBOLS[name] for name in found.edges)
        best = tuple(float(surface.column(name)[found.best]) for name in found.edges)
        rows.append(finding("study.optimum_at_edge", "warn", parameters=edges, values=best))
    rows += _parameters(found, subjects)
    counts = {"alike": alike, "worse": found.worse.sum(), "open": found.undecided.sum(), "protocols": protocols}
    if found.flat:
        rows.append(finding("study.flat_minimum", "info", subjects=subjects, margin_deg=margin, **counts))
    elif protocols > 1:
        rows.append(finding("study.as_good", "info", subjects=subjects, margin_deg=margin, **counts))
    if halving is not None:
        candidates = tuple(len(each.candidates) for each in halving.rounds)
        met = tuple(each.subjects for each in halving.rounds)
        runs, grid = halving.runs, halving.runs_of_grid
        if halving.generations:
            numbers = {"generations": halving.generations, "tried": len(halving.points), "subjects": met[0]}
            rows.append(finding("study.evolution", "info", runs=runs, grid=grid, **numbers))
        else:
            rows.append(finding("study.halving", "info", protocols=candidates, subjects=met, runs=runs, grid=grid))
    return tuple(rows)


def _parameters(found: judge.Optimum, subjects: int) -> list[Finding]:
    """Say which parameters are worth setting, which are not, and for which this study is too small."""
    rows = []
    held = [(effect, effect.judged) for effect in found.effects if effect.judged is not None]
    for verdict in ("better", "equivalent", "not decidable"):
        if not (own := [(effect, judged) for effect, judged in held if judged.verdict == verdict]):
            continue
        p = tuple(judged.p_better if verdict == "better" else judged.p_equivalent for _, judged in own)
        rows.append(
            finding(
                "study.deciding"
                if verdict == "better"
                else "study.none_decides"
                if verdict == "equivalent"
                else "study.undecided",
                "warn" if verdict == "not decidable" else "info",
                parameters=tuple(judge.SYMBOLS[effect.name] for effect, _ in own),
                span_deg=tuple(effect.span_deg for effect, _ in own),
                p=p,
                margin_deg=found.margin_deg,
                subjects=subjects,
                needed=tuple(judge.needed_text(judged.subjects_needed) for _, judged in own),
            )
        )
    return rows or [finding("study.not_tested", "info")]


def untried_findings(rows: tuple[Untried, ...]) -> tuple[Finding, ...]:
    """Return a finding for each value of the plan that no protocol has."""
    return tuple(
        finding(
            "study.value_not_tried",
            "info",
            parameter=judge.SYMBOLS[f"{row.parameter}_dps"],
            value_dps=row.value / RADIAN_PER_DEGREE,
            reason=row.reason,
        )
        for row in rows
    )
