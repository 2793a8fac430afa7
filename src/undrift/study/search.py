"""Search of a space too wide for its grid, and the front of error against minutes on the rig.

halving    draws at most ``candidates`` points by a Latin hypercube over the lists, and halves those (study/run.py)
cma        CMA-ES over the places in the lists [1]_: each generation of ``POPULATION`` candidates meets ``MET`` subjects, the next
           generation the next subjects; then the ``FINALISTS`` best are halved, so that a few meet every subject

Candidates of different generations met different subjects. They are compared as if all had met all: y_sp = a_p + b_s, a of the
candidate, b of the subject, by least squares over the runs there are. What no other beats in both a and minutes meets every
subject too, at most ``FRONT`` of them: the front then has means over all subjects, whatever the search.

A combination of rates whose step does not divide the span is the nearest that does, by places in the lists.

References
----------
.. [1] N. Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772, 2016; the package cma.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError, NotObservable
from undrift.study import run
from undrift.study.case import seeded
from undrift.study.judge import pareto_front
from undrift.study.plan import ERRORS, Objective, Study, StudyTask, Timing
from undrift.study.statistics import mean_interval

POPULATION, MET, FINALISTS = 24, 4, 16
MOST_CANDIDATES = 600  # of cma, where the plan has no number
FRONT = 8  # candidates that meet every subject for the front alone
NO_ERROR = 1e6  # deg: what was not calibrated, or takes too long


def tried_of(study: Study, task: StudyTask) -> int:
    """Return how many candidates of a task are tried at most."""
    most = study.candidates or (MOST_CANDIDATES if study.search == "cma" else task.space.count)
    return min(most, task.space.count)


def runs_of_task(study: Study, task: StudyTask) -> int:
    """Return how many sessions a task simulates and fits, resumed or not; at most, where the front or cma decide."""
    tried, evolved = tried_of(study, task), study.search == "cma"
    if study.search == "grid":
        return study.subjects * task.space.count
    runs = -(-tried // POPULATION) * POPULATION * min(MET, study.subjects) if evolved else 0
    runs += run.runs_of(run.rounds_of(min(tried, FINALISTS) if evolved else tried, study.subjects))
    return runs + min(FRONT, tried) * study.subjects


def count_runs(study: Study) -> int:
    """Return the runs of all tasks."""
    return sum(runs_of_task(study, task) for task in study.tasks)


def search_study(
    study: Study,
    executor: run.Executor,
    folder: Path,
    *,
    advance: Callable[[int, int], None],
    tell: Callable[[str], None],
) -> tuple[run.Halving, ...]:
    """Search every task, or resume that; ``advance`` gets runs done and runs in all at most, ``tell`` each round."""
    check_installed(study)
    total, done = count_runs(study), 0
    run.RunStore(folder, study)

    def count(runs: int) -> None:
        nonlocal done
        done += runs
        advance(done, total)

    count(0)
    found = []
    for task in study.tasks:
        own = folder / run.HALVING / task.key
        if study.search == "cma":
            searched = evolve(study, task, executor, own, count, tell)
        else:
            points = None if tried_of(study, task) == task.space.count else drawn(study, task)
            searched = run.halve(study, task, executor, own, points=points, count=count, tell=tell)
        found.append(_with_front(study, task, searched, executor, own, count))
    advance(done, done)
    run.join_pieces(run.pieces_of(folder), folder)
    return tuple(found)


def check_installed(study: Study) -> None:
    """Refuse a search whose package is not installed."""
    if study.search == "cma" and find_spec("cma") is None:
        raise InputError("study: wanted the package cma for search = cma, got none; pip install undrift[search]")


Count = Callable[[int], None]
Tell = Callable[[str], None]


def drawn(study: Study, task: StudyTask) -> FloatArray:
    """Return different candidates of a Latin hypercube over the lists, at most as many as the plan has, (P, n)."""
    from scipy.stats.qmc import LatinHypercube

    lists = Lists(task)
    rng = seeded(study, "candidates", task.key)
    unit = LatinHypercube(len(lists.sizes), rng=rng).random(tried_of(study, task))
    return np.unique(lists.points(np.floor(unit * lists.sizes)), axis=0)


class Lists:
    """The lists of a space, and candidates by their places in them."""

    def __init__(self, task: StudyTask) -> None:
        self._values = [np.array(values) for values in task.space.values]
        self.sizes = np.array([len(values) for values in self._values])  # (n,)
        held = [[list(v).index(x) for v, x in zip(self._values[1:4], grid, strict=True)] for grid in task.space.grids()]
        self._grids = np.array(held)  # (G, 3), places of the rates that a step divides

    def points(self, places: FloatArray) -> FloatArray:
        """Return the candidates nearest to places (P, n), which need not be whole, (P, n)."""
        whole = np.clip(np.rint(places), 0, self.sizes - 1).astype(np.int64)
        apart = ((places[:, None, 1:4] - self._grids) / self.sizes[1:4]) ** 2
        whole[:, 1:4] = self._grids[apart.sum(axis=2).argmin(axis=1)]
        return np.stack([values[column] for values, column in zip(self._values, whole.T, strict=True)], axis=1)


# ---- CMA-ES


def evolve(
    study: Study, task: StudyTask, executor: run.Executor, folder: Path, count: Count, tell: Tell
) -> run.Halving:
    """Search a task by CMA-ES, then halve the best of what it tried."""
    strategy, lists = _strategy(study, task)
    free, met = np.flatnonzero(lists.sizes > 1), min(MET, study.subjects)
    table: dict[tuple[float, ...], int] = {}  # candidates and their places
    tried: list[tuple[IntArray, IntArray, run.TaskSurface]] = []  # subjects, places and errors of each generation
    rounds, runs, generations = [], 0, -(-tried_of(study, task) // POPULATION)
    for number in range(generations):
        asked = strategy.ask()
        whole = np.zeros((len(asked), len(lists.sizes)))
        whole[:, free] = asked
        points, which = np.unique(lists.points(whole), axis=0, return_inverse=True)
        subjects = (number * met + np.arange(met)) % study.subjects
        own = run.unmet(study, task, points)
        allowed = run.allowed_of(study, task, points, own)
        if len(allowed):
            tell(f"{task.key}, generation {number + 1} of {generations}: {len(allowed)} protocols on {met} subjects")
            block = subjects.tolist(), allowed
            run.run_block(study, task, points, block, executor, folder / f"generation-{number + 1}", own, count)
            runs += len(allowed) * met
        mean = run.mean_of(own.error(study.objective, study.timing)[subjects])
        strategy.tell(asked, np.where(np.isfinite(mean), mean, NO_ERROR)[which.ravel()].tolist())
        places = np.array([table.setdefault(tuple(point), len(table)) for point in points.tolist()])
        tried.append((subjects, places, own))
        rounds.append(run.Round(subjects=met, candidates=places, mean_deg=mean))
    points = np.array(list(table))
    every = run.unmet(study, task, points)
    for subjects, places, own in tried:
        every.rig_minutes[places] = own.rig_minutes
        for name in ERRORS:
            getattr(every, name)[np.ix_(subjects, places)] = getattr(own, name)[subjects]
    level, uncertainty = estimated(every.error(study.objective, study.timing))
    best = np.argsort(level + uncertainty, kind="stable")[:FINALISTS]
    best = np.sort(best[np.isfinite(level[best])])
    if not len(best):
        raise NotObservable(
            f"cma: wanted a protocol of {task.key} that calibrates devices in the time allowed, got none; try other rates"
        )
    last = run.halve(study, task, executor, folder / "finalists", points=points[best], count=count, tell=tell)
    for name in ERRORS:
        getattr(every, name)[:, best] = np.where(
            np.isfinite(found := getattr(last.every, name)), found, getattr(every, name)[:, best]
        )
    rounds += [replace(each, candidates=best[each.candidates]) for each in last.rounds]
    return replace(
        last,
        points=points,
        protocols=tuple(map(task.protocol_of, points)),
        best=int(best[last.best]),
        rounds=tuple(rounds),
        runs=runs + last.runs,
        every=every,
        generations=generations,
    )


def _strategy(study: Study, task: StudyTask) -> tuple[Any, Lists]:
    import cma

    lists = Lists(task)
    sizes = lists.sizes[lists.sizes > 1]
    if len(sizes) < 2:
        raise InputError(
            f"study: wanted two parameters or more to vary for cma, got {len(sizes)} of {task.key}; use grid"
        )
    options = {
        "bounds": [[-0.5] * len(sizes), (sizes - 0.501).tolist()],
        "integer_variables": list(range(len(sizes))),
        "CMA_stds": (sizes / 4.0).tolist(),
        "popsize": POPULATION,
        "seed": int(seeded(study, "cma", task.key).integers(1, 2**31)),
        "verbose": -9,
    }
    return cma.CMAEvolutionStrategy((sizes - 1) / 2.0, 1.0, options), lists


def estimated(error: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean error of each candidate as if it had met every subject, and its uncertainty: error (S, P), NaN not met."""
    there = np.isfinite(error)
    looks, seen = there.sum(axis=0), there.sum(axis=1)
    values, subject, level = np.where(there, error, 0.0), np.zeros(len(error)), np.zeros(error.shape[1])
    for _ in range(200):  # least squares, one side after the other
        level = (values - there * subject[:, None]).sum(axis=0) / np.maximum(looks, 1)
        before = subject
        subject = (values - there * level).sum(axis=1) / np.maximum(seen, 1)
        subject -= subject[seen > 0].mean() if seen.any() else 0.0
        if np.abs(subject - before).max() < 1e-12:
            break
    left = there * (values - level - subject[:, None])
    spare = max(int(there.sum()) - int((looks > 0).sum()) - int((seen > 0).sum()) + 1, 1)
    sd = float(np.sqrt((left**2).sum() / spare))
    return np.where(looks > 0, level, np.inf), sd / np.sqrt(np.maximum(looks, 1))


# ---- front of error against minutes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Front:
    """The protocols that no other beats in both error and minutes, of those that met every subject."""

    surface: run.TaskSurface  # Of all that were tried
    places: IntArray  # (n,), by rising minutes
    mean_deg: FloatArray  # (n,), of the objective
    interval_deg: FloatArray  # (n, 2), its 95 % interval


def front_of(surface: run.TaskSurface, objective: Objective, timing: Timing, rig_minutes_max: float | None) -> Front:
    """Find the front of a surface whose protocols need not have met every subject."""
    error = surface.error(objective, timing)
    whole = np.isfinite(error).all(axis=0) & (surface.rig_minutes <= (rig_minutes_max or np.inf))
    mean = np.where(whole, np.where(np.isfinite(error), error, 0.0).mean(axis=0), np.inf)
    places = pareto_front(surface.rig_minutes, mean)
    ends = np.array([mean_interval(error[:, place])[1] for place in places]).reshape(-1, 2)
    return Front(surface=surface, places=places, mean_deg=mean[places], interval_deg=ends)


def _with_front(
    study: Study, task: StudyTask, found: run.Halving, executor: run.Executor, folder: Path, count: Count
) -> run.Halving:
    """Let every subject meet what seems to be on the front."""
    every, (level, uncertainty) = found.every, estimated(found.every.error(study.objective, study.timing))
    places = pareto_front(every.rig_minutes, np.where(np.isfinite(every.rig_minutes), level + uncertainty, np.inf))
    places = places[np.unique(np.linspace(0, len(places) - 1, min(FRONT, len(places))).round().astype(int))]
    places = np.sort(places[~np.isfinite(every.error(study.objective, study.timing)[:, places]).all(axis=0)])
    if not len(places):
        return found
    block = range(study.subjects), places
    run.run_block(study, task, found.points, block, executor, folder / "front", every, count)
    return replace(found, runs=found.runs + len(places) * study.subjects)
