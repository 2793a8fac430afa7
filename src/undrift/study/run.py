"""Run a study: its units on an executor, each kept as it is finished, and the whole error surface in the end."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.study.executor import Executor
from undrift.study.plan import Study
from undrift.study.store import RunStore
from undrift.study.unit import Unit, run_unit, units_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaskSurface:
    """All errors of one task: S subjects, P protocols.

    Parameters
    ----------
    task : str
        Its name.
    cutoff_hz, turn_rate_step_dps, turn_rate_min_dps, turn_rate_max_dps : array, shape (P,)
        The protocols, Hz and deg/s.
    rig_minutes : array, shape (P,)
        Length of a session, min.
    error_rms_deg, error_max_deg : array, shape (S, P)
        Pitch error over the motion, deg; NaN where the protocol could not calibrate the device.
    left_out : tuple of int
        Subjects that are not among the S, since no protocol could calibrate their device.
    """

    task: str
    cutoff_hz: FloatArray
    turn_rate_step_dps: FloatArray
    turn_rate_min_dps: FloatArray
    turn_rate_max_dps: FloatArray
    rig_minutes: FloatArray
    error_rms_deg: FloatArray
    error_max_deg: FloatArray
    left_out: tuple[int, ...] = ()

    def error(self, objective: str) -> FloatArray:
        """Return the errors that are to be small.

        Parameters
        ----------
        objective : str
            rms or maximum.

        Returns
        -------
        array, shape (S, P)
            deg.
        """
        return self.error_rms_deg if objective == "rms" else self.error_max_deg


def run_study(
    study: Study, executor: Executor, folder: Path, *, advance: Callable[[int, int], None] | None = None
) -> tuple[TaskSurface, ...]:
    """Run a study, or what is left of it.

    Parameters
    ----------
    study : Study
        What to do.
    executor : Executor
        Where.
    folder : Path
        Finished units are kept there; those that it holds already are not done again.
    advance : callable, optional
        Told how many units are done, of how many.

    Returns
    -------
    tuple of TaskSurface
        One a task.

    Raises
    ------
    InputError
        A folder that holds another study.
    """
    units, store = units_of(study), RunStore(folder, study)
    left = [unit for unit in units if not store.holds(unit)]
    done = len(units) - len(left)
    if advance:
        advance(done, len(units))
    for place, runs in executor.run(run_unit, left):
        store.write(left[place], runs)
        done += 1
        if advance:
            advance(done, len(units))
    return read_surfaces(store.join(units), study)


def read_surfaces(path: Path, study: Study) -> tuple[TaskSurface, ...]:
    """Read the surface of a finished study.

    Parameters
    ----------
    path : Path
        surface.parquet.
    study : Study
        Whose it is.

    Returns
    -------
    tuple of TaskSurface
        One a task.

    Raises
    ------
    InputError
        Rows that are not those of the study.
    """
    import pyarrow.parquet as pq

    table = pq.read_table(path)
    columns = {name: table.column(name).to_numpy(zero_copy_only=False) for name in table.column_names}
    found = []
    for task in study.tasks:
        rows = columns["task"] == task.name
        protocols = sum(len(task.candidates(cutoff)) for cutoff in task.space.cutoff_hz)
        if rows.sum() != study.subjects * protocols:
            raise InputError(
                f"{path}: wanted {study.subjects * protocols} runs of {task.name}, got {rows.sum()}; run the study to its end"
            )
        shaped = {
            name: np.asarray(values[rows], float).reshape(study.subjects, protocols)
            for name, values in columns.items()
            if name not in ("task", "subject")
        }
        found.append(
            TaskSurface(
                task=task.name,
                error_rms_deg=shaped.pop("error_rms_deg"),
                error_max_deg=shaped.pop("error_max_deg"),
                **{name: values[0] for name, values in shaped.items()},
            )
        )
    return tuple(found)


def without_lost(surface: TaskSurface) -> TaskSurface:
    """Leave out the subjects whose device no protocol could calibrate: they say nothing of which protocol is better.

    Parameters
    ----------
    surface : TaskSurface
        Of all subjects.

    Returns
    -------
    TaskSurface
        Of those with a run at least; the others are named. As it is where fewer than three would be left.
    """
    there = np.isfinite(surface.error_rms_deg).any(axis=1)
    if there.all() or there.sum() < 3:
        return surface
    return replace(
        surface,
        error_rms_deg=surface.error_rms_deg[there],
        error_max_deg=surface.error_max_deg[there],
        left_out=tuple(int(subject) for subject in np.flatnonzero(~there)),
    )


def count_runs(study: Study) -> int:
    """Return how many sessions a study simulates and fits.

    Parameters
    ----------
    study : Study
        What to do.

    Returns
    -------
    int
        Runs.
    """
    return sum(study.subjects * len(task.candidates(cutoff)) for task in study.tasks for cutoff in task.space.cutoff_hz)


__all__ = ["TaskSurface", "Unit", "count_runs", "read_surfaces", "run_study", "without_lost"]
