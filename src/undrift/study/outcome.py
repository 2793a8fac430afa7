"""Outcome of a study: for each task the optimum, its error on other subjects, its statistics, and the note's row.

    surfaces -> optimum -> the other cohort -> Table 1 with the note's rows, Figure 3 -> rival methods

What the error of an optimum is made of, and which effect hides a parameter: the optimum's values of each parameter, the others at
the optimum, are run again with one effect switched off (study/case.py) and the draws of all the others. Mean squares of
independent errors add. So the part of an effect is what the mean square loses where that effect is switched off; what no single
effect takes belongs to several together. An effect hides a parameter whose values differ by more than the margin without that
effect alone.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from operator import call
from pathlib import Path
from typing import Any, TypeVar, cast, get_args

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError, UndriftError
from undrift.findings import Finding, finding
from undrift.sim.motion.tasks import TaskName
from undrift.study import front as fronts
from undrift.study import judge, run
from undrift.study import target as targets
from undrift.study.case import EFFECTS, EffectName, Unit, run_units, typical_unit
from undrift.study.figure3 import DrawnRow, Figure3, drawn_cohort, figure3
from undrift.study.plan import AIM, DEVICE, MARGIN_DEG, TABLE_1, Aim, Study, StudyTask, column_of
from undrift.study.rivals import TASKS, RivalPlan, RivalRow, Rivals, TriadRow, compare_rivals
from undrift.study.space import Setting, Untried
from undrift.study.statistics import compare_pairs
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.agreement import mean_interval

# ---- what the error of an optimum is made of

MOST_VALUES = 5  # of a parameter that are run again: the optimum's with its neighbours, and both ends


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """What one effect adds to the error, and whether it hides what a parameter does."""

    effect: str  # One of ``EFFECTS``
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
        for effect in EFFECTS
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
    tables = [{effect: np.full(surface.error_rms_deg.shape, np.nan) for effect in EFFECTS} for surface in surfaces]
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


# ---- progress

T = TypeVar("T")


class StudyProgress:
    """Reports the stage of a study, and how much of the stage is done."""

    def __init__(self, progress: Callable[[str, float], None], stages: int = 3) -> None:
        self._progress, self._stage, self._number, self._stages = progress, "", -1, stages

    def begin(self, stage: str) -> None:
        """Report that a stage begins, in a line that stays."""
        self._stage, self._number = stage, self._number + 1
        self._progress(f"{stage}\n{stage}", self._share(0.0))

    def advance(self, done: int, total: int) -> None:
        """Report how much of the stage is done."""
        self._progress(f"{self._stage}: {done} of {total} units of work", self._share(done / max(total, 1)))

    def _share(self, part: float) -> float:
        return min((self._number + part) / self._stages, 1.0)


def _has_figure3(study: Study) -> bool:
    return any(task.name == "sit_to_stand" and task.motion is None for task in study.tasks)


def tried(part: str, work: Callable[[], T]) -> tuple[T | None, Finding | None]:
    """Return the result of a part of the study, or a finding on why it failed."""
    try:
        return work(), None
    except UndriftError as error:
        return None, finding("study.part_failed", "info", part=part, reason=str(error))


# ---- outcome

TESTING = "testing"
TOO_LONG = "every session with it takes longer than rig_minutes_max"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaskOutcome:
    """What came out of one task."""

    surface: run.TaskSurface  # All errors
    optimum: judge.Optimum  # With its equals
    tested: tuple[judge.Tested, judge.Tested]  # The optimum and its cheapest equal on the other cohort
    target: targets.CheapestSession | None  # The cheapest session that is good enough; None where no target is stated
    # Half the 95 % interval of the means over each parameter, between-subject differences taken out (Loftus and
    # Masson, 1994); 0 where it could not be tested, deg
    effect_reach_deg: tuple[float, ...]
    note: judge.NoteComparison | None  # With the note's row; None for other tasks
    splits: tuple[ErrorBreakdown, ...]  # Of the optimum's error, by parameter; none of one that has a single value
    untried: tuple[Untried, ...]  # Values of the plan that no protocol has, or none that is short enough
    front: fronts.Front  # Of error against minutes on the rig

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
    # Largest errors of drawn units, one row for each compensation; empty where the rivals were not asked for
    figure3_drawn: tuple[DrawnRow, ...] = ()
    rivals: tuple[RivalRow, ...] = ()  # Other ways to calibrate; empty where they were not asked for
    rival_triads: tuple[TriadRow, ...] = ()  # Each triad alone by each of them
    rivals_missing: Finding | None = None  # Why there are none


def judge_study(
    study: Study,
    executor: run.Executor,
    folder: Path,
    *,
    course: StudyProgress = StudyProgress(lambda what, share: None),
    rivals: bool = False,
) -> StudyOutcome:
    """Run a study, or what is left of it, and judge it."""
    begin = course.begin
    begin("calibration sessions")
    surfaces = tuple(map(run.without_lost, run.run_study(study, executor, folder, advance=course.advance)))
    optima = tuple(judge.find_optimum(surface, study) for surface in surfaces)
    begin("the other cohort")
    chosen = tuple(map(partial(targets.choose, aim=study), study.tasks, surfaces, optima))
    others, tested = judge.other_study(study), _on_others(study, surfaces, optima, chosen, folder / TESTING, executor)
    begin("what the error is made of")
    warmer = sum(study.excursion_k) / 2.0
    jobs: list[Callable[[], Any]] = [partial(_figure3_of, study, warmer)]
    splits, ((figure, missing),) = split_study(study, surfaces, optima, executor, beside=jobs, advance=course.advance)
    drawn = tuple[DrawnRow, ...]()
    compared: Rivals | None = None
    rivals_missing: Finding | None = finding("study.rivals_not_asked", "info")
    if rivals and figure is not None:
        drawn = _drawn_units(study, warmer, executor, course)
    if rivals:
        begin("rival methods")
        compared, rivals_missing = tried("Other ways to calibrate", lambda: _rivals(study, executor, course.advance))
    return StudyOutcome(
        study=study,
        runs=run.count_runs(study),
        tasks=tuple(map(partial(_judge, study), study.tasks, surfaces, optima, tested, chosen, splits)),
        cohorts=tuple(judge.cohort_of(each, kind) for kind in study.categories for each in (study, others)),
        figure3=figure,
        figure3_missing=missing,
        figure3_drawn=drawn,
        rivals=compared.rows if compared else (),
        rival_triads=compared.triads if compared else (),
        rivals_missing=rivals_missing,
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


def _drawn_units(
    study: Study, excursion_k: float, executor: run.Executor, course: StudyProgress
) -> tuple[DrawnRow, ...]:
    """Return the figure over units of the study's kind, or of the note's if all subjects wear one device."""
    kind = DEVICE if study.worn else study.device
    words: Any = {"seed": study.seed, "excursion_k": excursion_k}
    course.begin("Figure 3, drawn units")
    drawn, _ = tried("Figure 3", lambda: drawn_cohort(kind, executor=executor, advance=course.advance, **words))
    return drawn or ()


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
) -> TaskOutcome:
    row = TABLE_1.get(cast("TaskName", surface.task)) if study.of_note else None
    return TaskOutcome(
        surface=surface,
        optimum=optimum,
        tested=(tested[0], tested[1]),
        target=targets.judge_target(task, surface, optimum, chosen, tested[-1], _obstacle(splits), study),
        effect_reach_deg=tuple(map(_reach, optimum.effects)),
        note=row if row is None else judge.compare_with_note(surface, optimum, row, study),
        splits=splits,
        untried=(*task.space.untried(), *_too_long(study, surface)),
        front=fronts.front_of(surface, study),
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

    if (found := effect.anova) is None:
        return 0.0
    return float(t_distribution.ppf(0.975, found.dof[1]) * np.sqrt(effect.error_variance / found.subjects))


# ---- findings


def _findings(task: TaskOutcome) -> tuple[Finding, ...]:
    found, surface = task.optimum, task.surface
    subjects, alike, protocols = len(surface.error_rms_deg), int(found.equivalent.sum()), len(surface.cutoff_hz)
    margin, rows = found.margin_deg, list[Finding]()
    if surface.left_out:
        rows.append(finding("study.subjects_left_out", "warn", subjects=surface.left_out))
    if found.failed:
        rows.append(finding("study.runs_missing", "warn", missing=found.failed, runs=surface.error_rms_deg.size))
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
