"""Search of what a study tries: halving, evolution, the front of error against minutes on the rig; and rates to dwell at.

grid       every protocol meets every subject (study/run.py)
halving    all candidates, or at most ``candidates`` of a Latin hypercube over the lists, meet a few subjects, the better part
           meets more, the last few meet all; errors of earlier rounds are kept, so that only new subjects cost runs
cma        CMA-ES over the places in the lists [1]_: each generation of ``POPULATION`` candidates meets ``MET`` subjects, the next
           generation the next subjects; then the ``FINALISTS`` best are halved, so that a few meet every subject

A candidate that could not calibrate a device drops out. The error of the winner is biased low by the selection; the other cohort
gives an unbiased one. Candidates of different generations met different subjects. They are compared as if all had met all:
y_sp = a_p + b_s, a of the candidate, b of the subject, by least squares over the runs there are. What no other beats in both a and
minutes meets every subject too, at most ``FRONT`` of them: the front then has means over all subjects, whatever the search.

A combination of rates whose step does not divide the span is the nearest that does, by places in the lists.

Rates to dwell at need no search. One axis reads ``y = f(w)^T c + e``, f = (1, w, ..., w^p); with the share x_i of the time at rate
w_i the information is ``M = sum_i x_i f_i f_i^T``. D-optimal: greatest det M; I-optimal: least mean of ``f(w)^T M^-1 f(w)`` over
the task. ``x_i <- x_i (g_i / sum_j x_j g_j)^(1/2)`` [2]_, g the derivative.

References
----------
.. [1] N. Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772, 2016; the package cma.
.. [2] S. D. Silvey, D. M. Titterington and B. Torsney, Communications in Statistics A7(14), 1978.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError, NotObservable
from undrift.rig.programme import Protocol, rate_grid
from undrift.sim.motion.tasks import TaskName
from undrift.study.case import Unit, columns_of, device_of, perform, seeded, session_of
from undrift.study.plan import ERRORS, TABLE_1, Aim, Study, StudyTask
from undrift.study.run import HALVING, Executor, RunStore, TaskSurface, further_of, join_pieces, pieces_of
from undrift.study.statistics import mean_interval
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- successive halving

Count = Callable[[int], None]  # Gets the runs of each unit that is done
Tell = Callable[[str], None]  # Gets each round in words
FIRST_SUBJECTS = 3  # of the first round; too few, and the best protocol may be dropped by chance
LEAST = 4  # so many candidates meet all subjects


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Round:
    """One round of a halving."""

    subjects: int  # That its candidates had met at its end
    candidates: IntArray  # (n,), places among all protocols
    mean_deg: FloatArray  # (n,), of the objective; infinite where a device was left uncalibrated


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Halving:
    """Outcome of a halving: its rounds, and the surface of all runs that were made."""

    points: FloatArray  # (P, n), all candidates
    best: int  # Place of the best of the last round
    rounds: tuple[Round, ...]  # From all candidates to the last few
    runs: int  # Sessions simulated and fitted
    runs_of_grid: int  # The same for every candidate on every subject
    every: TaskSurface  # All P candidates; NaN where a candidate did not meet a subject
    generations: int = 0  # Of CMA-ES, the first of the rounds; the others halve

    @property
    def surface(self) -> TaskSurface:
        """The candidates of the last round, which met every subject."""
        return self.every.at(self.rounds[-1].candidates)


def rounds_of(candidates: int, subjects: int) -> tuple[tuple[int, int], ...]:
    """Return how many candidates each round has, and how many subjects they have met at its end."""
    plan = [(candidates, min(FIRST_SUBJECTS, subjects))]
    while plan[-1][1] < subjects:
        count, met = plan[-1]
        count = min(count, max(math.ceil(count / 2), LEAST))
        plan.append((count, subjects if count <= LEAST else min(2 * met, subjects)))
    return tuple(plan)


def runs_of(plan: tuple[tuple[int, int], ...]) -> int:
    """Return the runs of the rounds of a halving."""
    return sum(count * (met - before) for (count, met), (_, before) in zip(plan, ((0, 0), *plan), strict=False))


@dataclass(frozen=True, slots=True)
class TaskSearch:
    """Search of one task: where its candidates are run, and what gets its progress."""

    study: Study
    task: StudyTask
    executor: Executor
    folder: Path  # Of its blocks of runs
    count: Count = lambda runs: None
    tell: Tell = lambda text: None

    def unmet(self, points: FloatArray) -> TaskSurface:
        """Return the surface of candidates (P, n) that have met nobody."""
        varied: dict[str, Any] = columns_of(self.task, points)
        varied["further"] = {name: varied.pop(name) for name in further_of(self.task)}
        varied |= {name: np.full((self.study.subjects, len(points)), np.nan) for name in ERRORS}
        return TaskSurface(task=self.task.key, rig_minutes=np.full(len(points), np.nan), **varied)

    def allowed(self, points: FloatArray, every: TaskSurface) -> IntArray:
        """Return which candidates have a session that is allowed; where that has an end, write the minutes of all."""
        if self.study.rig_minutes_max is None:
            return np.arange(len(points))
        held = ((self.task.protocol_of(point), self.task.space.setting_of(point).quality) for point in points)
        every.rig_minutes[:] = [session_of(*each).length_s[0] / 60.0 for each in held]
        return np.flatnonzero(every.rig_minutes <= self.study.rig_minutes_max)

    def run(self, name: str, points: FloatArray, subjects: Sequence[int], places: IntArray, every: TaskSurface) -> None:
        """Run a block of subjects and of candidates, places of the points, and write its errors into the surface."""
        space = self.task.space
        settings, tasks, places_of = [space.setting_of(points[place]) for place in places], [], {}
        for setting in dict.fromkeys(settings):
            alike = places_of[setting] = places[[each == setting for each in settings]]
            tasks.append(replace(self.task, space=space.narrowed(points[alike])))
        units = [
            Unit(study=self.study, task=only, subject=subject, setting=only.space.settings()[0])
            for subject in subjects
            for only in tasks
        ]
        store = RunStore(self.folder / name, self.study, only=tuple(tasks))
        self.count(sum(len(unit.task.space.only) for unit in units if store.holds(unit)))
        for unit in store.finish(units, self.executor):
            self.count(len(unit.task.space.only))
        for unit in units:
            found, alike = store.read(unit), places_of[unit.setting]
            every.rig_minutes[alike] = found["rig_minutes"]
            for error in ERRORS:
                getattr(every, error)[unit.subject, alike] = found[error]

    def halve(self, points: FloatArray | None = None) -> Halving:
        """Find the best protocol of the task, or of some points (P, n), with a part of the runs."""
        study, task = self.study, self.task
        points = task.space.points() if points is None else points
        every = self.unmet(points)
        left = self.allowed(points, every)
        plan = rounds_of(len(left), study.subjects)
        rounds: list[Round] = []
        met = runs = 0
        for number, (kept, wanted) in enumerate(plan, 1):
            if rounds:
                left = np.sort(left[np.argsort(rounds[-1].mean_deg, kind="stable")[:kept]])
            if len(left):
                self.tell(f"{task.key}, round {number} of {len(plan)}: {len(left)} protocols on {wanted} subjects")
            runs += len(left) * (wanted - met)
            self.run(f"round-{number}", points, range(met, wanted), left, every)
            mean = mean_of(every.aimed(study)[:wanted, left])
            rounds.append(Round(subjects=wanted, candidates=left, mean_deg=mean))
            if not np.isfinite(mean).any():
                raise NotObservable(
                    f"halving: wanted a protocol of {task.key} that calibrates every device, got none; try other rates"
                )
            met = wanted
        return Halving(
            points=points,
            best=int(left[np.argmin(rounds[-1].mean_deg)]),
            rounds=tuple(rounds),
            runs=runs,
            runs_of_grid=study.subjects * task.space.count,
            every=every,
        )


def mean_of(error: FloatArray) -> FloatArray:
    """Return the mean errors (P,) of candidates that met the same subjects, (S, P); infinite where a device was not calibrated."""
    there = np.isfinite(error).any(axis=1)  # a device that no candidate calibrates does not compare them
    mean = error[there].mean(axis=0) if there.any() else np.full(error.shape[1], np.inf)
    return np.where(np.isfinite(mean), mean, np.inf)


# ---- candidates beyond the grid

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
    runs += runs_of(rounds_of(min(tried, FINALISTS) if evolved else tried, study.subjects))
    return runs + min(FRONT, tried) * study.subjects


def count_runs(study: Study) -> int:
    """Return the runs of all tasks."""
    return sum(runs_of_task(study, task) for task in study.tasks)


def search_study(
    study: Study, executor: Executor, folder: Path, *, advance: Callable[[int, int], None], tell: Callable[[str], None]
) -> tuple[Halving, ...]:
    """Search every task, or resume that; ``advance`` gets runs done and runs in all at most, ``tell`` each round."""
    check_installed(study)
    total, done = count_runs(study), 0
    RunStore(folder, study)

    def count(runs: int) -> None:
        nonlocal done
        done += runs
        advance(done, total)

    count(0)
    found = []
    for task in study.tasks:
        search = TaskSearch(study, task, executor, folder / HALVING / task.key, count, tell)
        if study.search == "cma":
            searched = evolve(search)
        else:
            searched = search.halve(None if tried_of(study, task) == task.space.count else drawn(study, task))
        found.append(_with_front(search, searched))
    advance(done, done)
    join_pieces(pieces_of(folder), folder)
    return tuple(found)


def check_installed(study: Study) -> None:
    """Refuse a search whose package is not installed."""
    if study.search == "cma" and find_spec("cma") is None:
        raise InputError("study: wanted the package cma for search = cma, got none; pip install undrift[search]")


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


def evolve(search: TaskSearch) -> Halving:
    """Search a task by CMA-ES, then halve the best of what it tried."""
    study, task = search.study, search.task
    strategy, lists = _strategy(study, task)
    free, met = np.flatnonzero(lists.sizes > 1), min(MET, study.subjects)
    table: dict[tuple[float, ...], int] = {}  # candidates and their places
    tried: list[tuple[IntArray, IntArray, TaskSurface]] = []  # subjects, places and errors of each generation
    rounds, runs, generations = [], 0, -(-tried_of(study, task) // POPULATION)
    for number in range(generations):
        asked = strategy.ask()
        whole = np.zeros((len(asked), len(lists.sizes)))
        whole[:, free] = asked
        points, which = np.unique(lists.points(whole), axis=0, return_inverse=True)
        subjects = (number * met + np.arange(met)) % study.subjects
        own = search.unmet(points)
        allowed = search.allowed(points, own)
        if len(allowed):
            search.tell(
                f"{task.key}, generation {number + 1} of {generations}: {len(allowed)} protocols on {met} subjects"
            )
            search.run(f"generation-{number + 1}", points, subjects.tolist(), allowed, own)
            runs += len(allowed) * met
        mean = mean_of(own.aimed(study)[subjects])
        strategy.tell(asked, np.where(np.isfinite(mean), mean, NO_ERROR)[which.ravel()].tolist())
        places = np.array([table.setdefault(tuple(point), len(table)) for point in points.tolist()])
        tried.append((subjects, places, own))
        rounds.append(Round(subjects=met, candidates=places, mean_deg=mean))
    points = np.array(list(table))
    every = search.unmet(points)
    for subjects, places, own in tried:
        every.rig_minutes[places] = own.rig_minutes
        for name in ERRORS:
            getattr(every, name)[np.ix_(subjects, places)] = getattr(own, name)[subjects]
    level, uncertainty = estimated(every.aimed(study))
    best = np.argsort(level + uncertainty, kind="stable")[:FINALISTS]
    best = np.sort(best[np.isfinite(level[best])])
    if not len(best):
        raise NotObservable(
            f"cma: wanted a protocol of {task.key} that calibrates devices in the time allowed, got none; try other rates"
        )
    last = replace(search, folder=search.folder / "finalists").halve(points[best])
    for name in ERRORS:
        getattr(every, name)[:, best] = np.where(
            np.isfinite(found := getattr(last.every, name)), found, getattr(every, name)[:, best]
        )
    rounds += [replace(each, candidates=best[each.candidates]) for each in last.rounds]
    return replace(
        last,
        points=points,
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

    surface: TaskSurface  # Of all that were tried
    places: IntArray  # (n,), by rising minutes
    mean_deg: FloatArray  # (n,), of the objective
    interval_deg: FloatArray  # (n, 2), its 95 % interval


def pareto_front(minutes: FloatArray, error: FloatArray) -> IntArray:
    """Return the protocols that no other beats in both time and error: minutes (P,), error (P,)."""
    front: list[int] = []
    least = np.inf
    for place in np.lexsort((error, minutes)):
        if error[place] < least:
            front.append(int(place))
            least = error[place]
    return np.array(front, dtype=np.int64)


def front_of(surface: TaskSurface, aim: Aim) -> Front:
    """Find the front of a surface whose protocols need not have met every subject."""
    error = surface.aimed(aim)
    whole = np.isfinite(error).all(axis=0) & (surface.rig_minutes <= (aim.rig_minutes_max or np.inf))
    mean = np.where(whole, np.where(np.isfinite(error), error, 0.0).mean(axis=0), np.inf)
    places = pareto_front(surface.rig_minutes, mean)
    ends = np.array([mean_interval(error[:, place])[1] for place in places]).reshape(-1, 2)
    return Front(surface=surface, places=places, mean_deg=mean[places], interval_deg=ends)


def _with_front(search: TaskSearch, found: Halving) -> Halving:
    """Let every subject meet what seems to be on the front."""
    study, every, (level, uncertainty) = search.study, found.every, estimated(found.every.aimed(search.study))
    places = pareto_front(every.rig_minutes, np.where(np.isfinite(every.rig_minutes), level + uncertainty, np.inf))
    places = places[np.unique(np.linspace(0, len(places) - 1, min(FRONT, len(places))).round().astype(int))]
    places = np.sort(places[~np.isfinite(every.aimed(study)[:, places]).all(axis=0)])
    if not len(places):
        return found
    search.run("front", found.points, range(study.subjects), places, every)
    return replace(found, runs=found.runs + len(places) * study.subjects)


# ---- optimal designs

Criterion = Literal["uniform", "D", "I"]
ROUNDS = 4000
CONVERGED = 1e-6  # of the greatest derivative over its mean
NOTHING = 1e-3  # share of the time that is not worth a stop


@dataclass(frozen=True, slots=True, eq=False)
class RateDesign:
    """Where to dwell, and for which share of the time."""

    criterion: Criterion  # D or I, or the uniform grid itself
    turn_rate: FloatArray  # (k,), rates, rad/s, increasing
    share: FloatArray  # (k,), of the time; they add up to 1
    d_efficiency_uniform: float  # Of the uniform grid's information over this design's; 0.5 needs twice the time
    i_efficiency_uniform: float  # As above, by the error over the task


def optimal_rates(
    candidates: FloatArray, task_rates: FloatArray, uniform: FloatArray, *, criterion: Criterion = "I", degree: int = 3
) -> RateDesign:
    """Find the rates that tell most for the dwelling time.
    candidates (n,) rad/s, increasing, task_rates (m,), uniform (u,) rad/s."""
    needed = degree + 1
    if min(len(np.unique(candidates)), len(np.unique(uniform))) < needed:
        raise InputError(
            f"design: wanted {needed} rates or more for a polynomial of degree {degree}, got {len(np.unique(candidates))} "
            f"candidates and {len(np.unique(uniform))} in the grid"
        )
    top = float(np.abs(candidates).max())
    f = np.vander(candidates / top, needed, increasing=True)
    aim = np.vander(task_rates / top, needed, increasing=True)
    wanted = aim.T @ aim / len(aim)
    share = _climb(f, wanted if criterion == "I" else None)
    kept = share > NOTHING
    share, own = share[kept] / share[kept].sum(), f[kept]
    grid = np.vander(uniform / top, needed, increasing=True)
    even = grid.T @ grid / len(grid)
    made = (own * share[:, None]).T @ own
    return RateDesign(
        criterion=criterion,
        turn_rate=candidates[kept],
        share=share,
        d_efficiency_uniform=float((np.linalg.det(even) / np.linalg.det(made)) ** (1.0 / needed)),
        i_efficiency_uniform=float(np.trace(np.linalg.solve(made, wanted)) / np.trace(np.linalg.solve(even, wanted))),
    )


def prediction_sd(
    turn_rate: FloatArray, share: FloatArray, task_rates: FloatArray, *, dwell_sd: float, dwells: float, degree: int = 3
) -> float:
    """Return how wrong the fitted curve will be over a task, root-mean-square.
    turn_rate (k,) rad/s, share (k,) rad/s, task_rates (m,) rad/s."""
    top = float(np.abs(turn_rate).max())
    f = np.vander(turn_rate / top, degree + 1, increasing=True)
    aim = np.vander(task_rates / top, degree + 1, increasing=True)
    information = (f * share[:, None]).T @ f * dwells
    return float(dwell_sd * np.sqrt(np.mean(np.einsum("mi,ij,mj->m", aim, np.linalg.inv(information), aim))))


def _climb(f: FloatArray, wanted: FloatArray | None) -> FloatArray:
    from undrift.kernels.note import climb

    share = np.full(len(f), 1.0 / len(f))
    climb(f, np.eye(f.shape[1]) if wanted is None else wanted, wanted is not None, ROUNDS, CONVERGED, share)
    return share


# ---- rates to dwell at for each task

DEGREES = (1, 3)
CANDIDATES = 181
SAMPLES = 4000  # of the rates of a task
PERFORMED = 10  # subjects
RATE_HZ = 50.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignRow:
    """One set of rates for one task."""

    task: str  # What is done
    grid: str  # Whose uniform grid it is compared with: the note's, or that of the optimum
    degree: int  # Of the polynomial that an axis' reading is taken for
    criterion: Criterion  # uniform, D or I
    turn_rate_dps: tuple[float, ...]  # Rates of one axis, increasing; neighbours gathered
    share: tuple[float, ...]  # Of the time, at each
    d_efficiency_uniform: float  # Of the uniform grid's information over this set's; 1 for the grid itself
    i_efficiency_uniform: float  # As above
    dwells: int  # How many the uniform grid makes of one axis: all sets have their time
    dwell_s: float | None  # One dwell, s; None where it is stated by its uncertainty
    # Predicted error of the rate over the task, root-mean-square, deg/s; None for a device without white noise
    error_dps: float | None
    beyond: float  # Share of the task's rates above the greatest of the grid


def design_rows(study: Study, task: StudyTask, found: Protocol) -> tuple[DesignRow, ...]:
    """Compare sets of rates for one task."""
    note = TABLE_1.get(cast("TaskName", task.name)) if task.motion is None else None
    if note is None:
        grid, name = found.turn_rates(), "the optimum's"
    else:
        dps = rate_grid(note.turn_rate_min_dps, note.turn_rate_max_dps, note.turn_rate_step_dps, rule="paper")
        grid, name = dps * RADIAN_PER_DEGREE, "the note's"
    rates, dwell_s = task_rates(study, task), task.base.dwell_s
    noise = device_of(study, 0).gyro.white_noise
    dwell_sd = task.base.turn_rate_uncertainty if dwell_s is None else None
    if dwell_s is not None and noise is not None:
        dwell_sd = float(noise.random_walk[1] / np.sqrt(dwell_s))
    top, even = float(np.abs(grid).max()), np.full(len(grid), 1.0 / len(grid))
    candidates, criteria = np.linspace(-top, top, CANDIDATES), cast("tuple[Criterion, ...]", ("D", "I"))
    rows = []
    for degree in DEGREES:
        if len(np.unique(grid)) <= degree:  # too few rates for this polynomial
            continue
        designs = [RateDesign("uniform", grid, even, 1.0, 1.0)]
        designs += [optimal_rates(candidates, rates, grid, criterion=c, degree=degree) for c in criteria]
        for design in designs:
            at, share, error = design.turn_rate, design.share, None
            if dwell_sd is not None:
                error = prediction_sd(at, share, rates, dwell_sd=dwell_sd, dwells=len(grid), degree=degree)
            if design.criterion != "uniform":
                at, share = _gathered(at, share, 5.0 * top / (CANDIDATES - 1))
            row = DesignRow(
                task=task.key,
                grid=name,
                degree=degree,
                criterion=design.criterion,
                turn_rate_dps=tuple(float(rate / RADIAN_PER_DEGREE) for rate in at),
                share=tuple(map(float, share)),
                d_efficiency_uniform=design.d_efficiency_uniform,
                i_efficiency_uniform=design.i_efficiency_uniform,
                dwells=len(grid),
                dwell_s=dwell_s,
                error_dps=None if error is None else error / RADIAN_PER_DEGREE,
                beyond=float(np.mean(np.abs(rates) > top * (1.0 + 1e-9))),
            )
            rows.append(row)
    return tuple(rows)


def task_rates(study: Study, task: StudyTask) -> FloatArray:
    """Return the rates that occur in a task about the axis of the pitch, (m,) rad/s."""
    seen = []
    for number in range(min(task.motion.people if task.motion else study.subjects, PERFORMED)):
        performed, _ = perform(study, task, number)
        start, stop = performed.moving_s
        time = np.arange(start, min(stop, performed.duration_s), 1.0 / RATE_HZ)
        seen.append(performed.at(time, STANDARD_GRAVITY).rate_b[:, 1])
    rates: FloatArray = np.concatenate(seen)
    known: FloatArray = rates[np.isfinite(rates)]
    return known[:: len(known) // SAMPLES + 1].copy()


def _gathered(rate: FloatArray, share: FloatArray, near: float) -> tuple[FloatArray, FloatArray]:
    """Return a design whose neighbouring rates, of one stop that falls between candidates, are one rate."""
    groups = np.concatenate(([0], np.cumsum(np.diff(rate) > near)))
    total = np.bincount(groups, weights=share).astype(np.float64)
    return np.bincount(groups, weights=share * rate).astype(np.float64) / total, total
