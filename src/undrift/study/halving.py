"""Successive halving: for spaces too wide for every protocol to meet every subject.

All candidates meet a few subjects, the better part goes on to more, and so on; the last few meet all::

    rung r: n_r candidates on s_r subjects;  n_{r+1} = ceil(n_r / keep),  s_{r+1} = min(growth s_r, S)

Subjects are the same for all candidates of a rung, and the errors of earlier rungs are kept: only new subjects cost anything.
A candidate that could not calibrate a device falls out. The winner was also lucky; what it is worth is said by the other
cohort (testing.py).
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError, NotObservable
from undrift.protocol import Protocol
from undrift.study.executor import Executor
from undrift.study.plan import Study, StudyTask
from undrift.study.store import RunStore
from undrift.study.unit import Unit, run_unit


@dataclass(frozen=True, slots=True, kw_only=True)
class HalvingSettings:
    """How fast candidates are dropped.

    Parameters
    ----------
    first_subjects : int
        Of the first rung; too few, and the best protocol may be dropped by chance.
    keep : float
        Candidates of a rung over those of the next.
    growth : float
        Subjects of the next rung over those of a rung.
    least : int
        So many candidates meet all subjects.
    """

    first_subjects: int = 3
    keep: float = 2.0
    growth: float = 2.0
    least: int = 4

    def __post_init__(self) -> None:
        if self.first_subjects < 1 or not self.keep > 1.0 or not self.growth > 1.0 or self.least < 1:
            raise InputError(
                f"halving: wanted one subject or more, keep and growth above 1 and one last candidate or more, got "
                f"{self.first_subjects}, {self.keep:g}, {self.growth:g} and {self.least}"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rung:
    """A rung.

    Parameters
    ----------
    subjects : int
        That its candidates had met at its end.
    candidates : array of int
        Places among all candidates.
    mean_deg : array, shape (len(candidates),)
        Mean of the objective, deg; infinite where a device was left uncalibrated.
    """

    subjects: int
    candidates: IntArray
    mean_deg: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Halving:
    """Outcome.

    Parameters
    ----------
    protocols : tuple of Protocol
        All candidates.
    best : int
        Place of the best of the last rung.
    rungs : tuple of Rung
        From all candidates to the last few.
    runs : int
        Sessions simulated and fitted.
    runs_of_grid : int
        What every candidate on every subject would have cost.
    """

    protocols: tuple[Protocol, ...]
    best: int
    rungs: tuple[Rung, ...]
    runs: int
    runs_of_grid: int


def halve(
    study: Study, task: StudyTask, executor: Executor, folder: Path, *, settings: HalvingSettings = HalvingSettings()
) -> Halving:
    """Find the best protocol of a task with a part of the runs.

    Parameters
    ----------
    study : Study
        Gives device, subjects, objective and seed.
    task : StudyTask
        What is tried.
    executor : Executor
        Where.
    folder : Path
        Finished runs are kept there, a folder for each rung; those that it holds already are not done again.
    settings : HalvingSettings
        How fast candidates are dropped.

    Returns
    -------
    Halving
        The best, and the way to it.

    Raises
    ------
    NotObservable
        No candidate calibrates every device.
    """
    protocols = tuple(p for cutoff in task.space.cutoff_hz for p in task.candidates(cutoff))
    error = np.full((study.subjects, len(protocols)), np.nan)
    left: IntArray = np.arange(len(protocols))
    met, wanted, runs = 0, min(settings.first_subjects, study.subjects), 0
    rungs: list[Rung] = []
    while True:
        block = tuple(range(met, wanted)), left
        error[met:wanted, left] = _run(study, task, block, protocols, executor, folder / f"rung-{len(rungs)}")
        runs += (wanted - met) * len(left)
        mean = error[:wanted, left].mean(axis=0)
        mean = np.where(np.isfinite(mean), mean, np.inf)
        rungs.append(Rung(subjects=wanted, candidates=left, mean_deg=mean))
        if not np.isfinite(mean).any():
            raise NotObservable(
                f"halving: wanted a protocol of {task.name} that calibrates every device, got none; try other rates"
            )
        if wanted == study.subjects:
            best = int(left[np.argmin(mean)])
            break
        kept = max(math.ceil(len(left) / settings.keep), settings.least)
        left = np.sort(left[np.argsort(mean, kind="stable")[:kept]])
        met, wanted = wanted, min(math.ceil(wanted * settings.growth), study.subjects)
        if len(left) <= settings.least:
            wanted = study.subjects
    return Halving(
        protocols=protocols,
        best=best,
        rungs=tuple(rungs),
        runs=runs,
        runs_of_grid=study.subjects * len(protocols),
    )


def _run(
    study: Study,
    task: StudyTask,
    block: tuple[tuple[int, ...], IntArray],
    protocols: tuple[Protocol, ...],
    executor: Executor,
    folder: Path,
) -> FloatArray:
    """Return the errors of a block of subjects and candidates: units as a study's, with the candidates that are left."""
    subjects, left = block
    cutoffs = np.array([protocols[place].cutoff_hz for place in left])
    only = {
        cutoff: replace(
            task,
            space=replace(
                task.space,
                cutoff_hz=(cutoff,),
                only=tuple(_grid(protocols[place]) for place in left[cutoffs == cutoff]),
            ),
        )
        for cutoff in dict.fromkeys(cutoffs.tolist())
    }
    units = [Unit(study=study, task=only[cutoff], subject=s, cutoff_hz=cutoff) for s in subjects for cutoff in only]
    store = RunStore(folder, study, only=tuple(only.values()))
    todo = [unit for unit in units if not store.holds(unit)]
    for place, found in executor.run(run_unit, todo):
        store.write(todo[place], found)
    error, wanted = (
        np.empty((len(subjects), len(left))),
        "error_rms_deg" if study.objective == "rms" else "error_max_deg",
    )
    for unit in units:
        error[subjects.index(unit.subject), cutoffs == unit.cutoff_hz] = store.read(unit)[wanted]
    return error


def _grid(protocol: Protocol) -> tuple[float, float, float]:
    return protocol.turn_rate_step, protocol.turn_rate_min, protocol.turn_rate_max
