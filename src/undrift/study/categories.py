"""Does the best protocol depend on the category of subjects? Each category's optimum, worn by the others.

For each task the optimum of every category is tried on the other cohort of every category: people, units and seed that no optimum
was chosen with, so the choice favours none. Subject by subject, the error with another category's optimum less that with its own is
judged against the margin, p after Bonferroni over all such pairs of a task. "better" means that the own optimum is, by more than
the margin: the categories need protocols of their own. "equivalent" means that the other's does as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby, product
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.findings import Finding, finding
from undrift.sim.motion.categories import CATEGORIES, CategoryName
from undrift.study import judge
from undrift.study.plan import Study, StudyTask
from undrift.study.run import InProcess, TaskSurface, run_study
from undrift.study.statistics import Decision, decide_between

LEAST = 3  # subjects of a comparison


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossed:
    """The optimum that was chosen for one category, worn by another."""

    chosen: CategoryName  # Whose optimum
    worn: CategoryName  # Who wears it
    subjects: int  # Of the other cohort, whose device both protocols calibrate
    error_deg: float  # Mean error of the objective with it, deg
    own_deg: float  # With the wearers' own optimum
    decision: Decision | None  # The own optimum against it; None with too few subjects


@dataclass(frozen=True, slots=True, kw_only=True)
class CategoryComparison:
    """All categories of one task."""

    task: str  # As the library names it
    categories: tuple[CategoryName, ...]
    crossed: tuple[Crossed, ...]  # Every category's optimum worn by every other category
    margin_deg: float  # Smallest difference that matters

    @property
    def finding(self) -> Finding:
        """Whether one protocol does for all."""
        verdicts = [cell.decision.verdict if cell.decision else "not decidable" for cell in self.crossed]
        apart = [cell for cell, verdict in zip(self.crossed, verdicts, strict=True) if verdict == "better"]
        words = {"task": self.task.replace("_", " "), "margin_deg": self.margin_deg}
        if apart:
            return finding("study.categories_differ", "info", pairs=_pairs(apart), **words)
        if all(verdict == "equivalent" for verdict in verdicts):
            return finding("study.categories_alike", "info", count=len(self.categories), **words)
        left = [cell for cell, verdict in zip(self.crossed, verdicts, strict=True) if verdict != "equivalent"]
        needed = [cell.decision.subjects_needed if cell.decision else None for cell in left]
        most = judge.needed_text(None if None in needed else max(n for n in needed if n is not None))
        return finding("study.categories_undecided", "warn", pairs=_pairs(left), needed=most, **words)


def _pairs(cells: Sequence[Crossed]) -> tuple[str, ...]:
    return tuple(
        f"{CATEGORIES[cell.worn].label} with the optimum of {CATEGORIES[cell.chosen].label} "
        f"{cell.error_deg:.3f} deg, with their own {cell.own_deg:.3f} deg"
        for cell in cells
    )


def compare_categories(
    study: Study, surfaces: Sequence[TaskSurface], optima: Sequence[judge.Optimum], folder: Path
) -> tuple[CategoryComparison, ...]:
    """Wear each category's optimum in all categories of its task, on the other cohort."""
    other, found = judge.other_study(study), []
    held = sorted(zip(study.tasks, surfaces, optima, strict=True), key=lambda each: study.names.index(each[0].name))
    for name, group in groupby(held, key=lambda each: each[0].name):
        own = tuple(group)
        categories = tuple(task.category for task, _, _ in own)
        if len(own) < 2:
            continue
        errors: dict[tuple[CategoryName, CategoryName], FloatArray] = {}
        for task, surface, optimum in own:
            only: StudyTask = judge.only(task, surface, optimum.best)
            tasks = tuple(replace(only, category=category) for category in categories)
            # a few seconds' work, as of the optima on their own categories
            ran = run_study(replace(other, tasks=tasks), InProcess(), folder / f"{name}-{task.category}")
            for category, each in zip(categories, ran, strict=True):
                errors[task.category, category] = each.error(study.objective, study.timing)[:, 0]
        tests = len(categories) * (len(categories) - 1)
        crossed = tuple(
            _crossed(chosen, worn, errors[chosen, worn], errors[worn, worn], study, tests)
            for chosen, worn in product(categories, repeat=2)
            if chosen != worn
        )
        found.append(CategoryComparison(task=name, categories=categories, crossed=crossed, margin_deg=study.margin_deg))
    return tuple(found)


def _crossed(
    chosen: CategoryName, worn: CategoryName, error: FloatArray, own: FloatArray, study: Study, tests: int
) -> Crossed:
    both = np.stack((own, error), axis=1)
    both = both[np.isfinite(both).all(axis=1)]
    decision = None
    if len(both) >= LEAST:
        decision = decide_between(*both.T, margin=study.margin_deg, level=study.level, tests=tests)
    own_deg, error_deg = both.mean(axis=0).tolist() if len(both) else (float("nan"), float("nan"))
    return Crossed(
        chosen=chosen, worn=worn, subjects=len(both), error_deg=error_deg, own_deg=own_deg, decision=decision
    )
