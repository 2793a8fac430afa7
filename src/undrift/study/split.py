"""What the error of an optimum is made of, and which effect hides a parameter.

The optimum's values of each parameter, the others at the optimum, are run again with one effect switched off (sim/switches.py) and
the draws of all the others. Mean squares of independent errors add. So the part of an effect is what the mean square loses where
that effect is switched off; what no single effect takes belongs to several together. An effect hides a parameter whose values
differ by more than the margin without that effect alone.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError
from undrift.findings import Finding, finding
from undrift.sim.switches import EFFECTS, EffectName
from undrift.study.case import Unit, run_unit
from undrift.study.judge import SYMBOLS, Judged, Optimum, judge_values
from undrift.study.plan import MARGIN_DEG, Study, StudyTask, column_of
from undrift.study.run import Executor, TaskSurface
from undrift.study.space import Setting
from undrift.study.statistics import compare_pairs, mean_interval
from undrift.units import RADIAN_PER_DEGREE

MOST_VALUES = 5  # of a parameter that are run again: the optimum's with its neighbours, and both ends


@dataclass(frozen=True, slots=True, kw_only=True)
class Term:
    """What one effect adds to the error, and whether it hides what a parameter does."""

    effect: str  # One of ``EFFECTS``
    share: float  # Of the mean square that is lost without it; below 0 where the error grows
    share_interval: tuple[float, float]  # Its 95 % interval over the subjects
    rms_deg: float  # Root of that loss, deg; 0 where there is none
    judged: Judged  # The parameter's values without the effect
    best: int  # Place of the value with the least error without it
    span_deg: float  # Greatest less least mean error over the values without it, deg


@dataclass(frozen=True, slots=True, kw_only=True)
class Split:
    """The error with one value of a parameter, by effect, and what each effect hides."""

    parameter: str  # One of the surface's ``names``
    values: FloatArray  # (k,), that were run, Hz or deg/s
    rms_deg: float  # With all effects, root of the mean square over the subjects, deg
    judged: Judged  # The parameter's values with all effects
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
            "parameter": SYMBOLS[self.parameter],
            "verdict": self.judged.verdict,
            "margin_deg": self.judged.widest.margin,
        }
        if not (covering := self.covering):
            return finding("study.not_covered", "info", **numbers)
        spans, p = (tuple(each) for each in zip(*((t.span_deg, t.judged.p_better) for t in covering), strict=True))
        return finding(
            "study.covered", "warn", effects=tuple(t.effect for t in covering), span_deg=spans, p=p, **numbers
        )


def split_findings(splits: tuple[Split, ...]) -> tuple[Finding, ...]:
    """Say what the error of an optimum is made of, and what hides each parameter."""
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
    return (made_of, *(split.finding for split in splits if split.finding is not None))


def split_error(
    parameter: str,
    values: FloatArray,
    error: FloatArray,
    without: Mapping[EffectName, FloatArray],
    *,
    at: int,
    level: float = 0.05,
    margin_deg: float = MARGIN_DEG["rms"],
) -> Split:
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
                judged=_judged(other, level, margin_deg, tests),
                best=int(np.argmin(mean)),
                span_deg=float(np.ptp(mean)),
            )
        )
    terms.sort(key=lambda term: -term.share)
    return Split(
        parameter=parameter,
        values=values,
        rms_deg=float(np.sqrt(total)),
        judged=_judged(error, level, margin_deg, tests),
        terms=tuple(terms),
        together=1.0 - sum(term.share for term in terms),
    )


def _judged(error: FloatArray, level: float, margin: float, tests: int) -> Judged:
    best, subjects = int(np.argmin(error.mean(axis=0))), len(error)
    return judge_values(best, compare_pairs(error), subjects, level=level, margin=margin, tests=tests)


# ---- runs with an effect switched off


def units_without(study: Study, task: StudyTask, surface: TaskSurface, optimum: Optimum) -> tuple[Unit, ...]:
    """Return the units that split the error of an optimum, those of a subject one after the other."""
    lines = _lines(surface, optimum)
    places = np.unique(np.concatenate(list(lines.values()))) if lines else np.empty(0, dtype=np.int64)
    parts = dict[Setting, list[FloatArray]]()
    for point in _points(task, surface)[places]:
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
    surfaces: tuple[TaskSurface, ...],
    optima: tuple[Optimum, ...],
    executor: Executor,
    *,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[tuple[Split, ...], ...]:
    """Split the error of each task's optimum along its parameters; ``advance`` gets units done and units in all."""
    held = list(zip(study.tasks, surfaces, optima, strict=True))
    units = [(k, unit) for k, each in enumerate(held) for unit in units_without(study, *each)]
    tables = [{effect: np.full(surface.error_rms_deg.shape, np.nan) for effect in EFFECTS} for surface in surfaces]
    rows = [{subject: row for row, subject in enumerate(_subjects(study, surface))} for surface in surfaces]
    places = [
        {tuple(point): place for place, point in enumerate(_points(task, surface).tolist())}
        for task, surface, _ in held
    ]
    advance(0, len(units))
    for done, (number, runs) in enumerate(executor.run(run_unit, [unit for _, unit in units]), 1):
        k, unit = units[number]
        if unit.without is not None:
            own = [places[k][tuple(point)] for point in unit.task.space.points().tolist()]
            tables[k][unit.without][rows[k][unit.subject], own] = runs[column_of(study.objective, study.timing)]
        advance(done, len(units))
    return tuple(
        _split(study, surface, optimum, found) for (_, surface, optimum), found in zip(held, tables, strict=True)
    )


def _split(
    study: Study, surface: TaskSurface, optimum: Optimum, found: Mapping[EffectName, FloatArray]
) -> tuple[Split, ...]:
    """Split the error along each parameter with two values or more, by the subjects of whom every run is there."""
    every, splits = surface.error(study.objective, study.timing), []
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
                    level=study.level,
                    margin_deg=study.margin_deg,
                )
            )
    return tuple(splits)


def _subjects(study: Study, surface: TaskSurface) -> list[int]:
    return [subject for subject in range(study.subjects) if subject not in surface.left_out]


def _lines(surface: TaskSurface, optimum: Optimum) -> dict[str, IntArray]:
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


def _points(task: StudyTask, surface: TaskSurface) -> FloatArray:
    """Return the protocols of a surface as the plan has their values, (P, n)."""
    units = [RADIAN_PER_DEGREE if name.endswith("_dps") else 1.0 for name in surface.names]
    held = [surface.column(name) * unit for name, unit in zip(surface.names, units, strict=True)]
    lists = map(np.array, task.space.values)
    return np.stack([v[np.abs(v - own[:, None]).argmin(axis=1)] for v, own in zip(lists, held, strict=True)], axis=1)
