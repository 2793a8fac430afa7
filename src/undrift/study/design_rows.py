"""Rates to dwell at for each task of a study: D- and I-optimal sets beside the uniform grid, at equal dwelling time.

The rates of a task are those of the cohort's motions about the axis of the pitch. Rates are chosen between the grid's greatest
rates both ways; what a dwell is uncertain by is the white noise of the device alone, N / sqrt(dwell), so that errors compare
sets of rates and leave out what the offset wanders. Two polynomials are held: the straight line that the note's matrix is, and a
cubic, which shows whether the line bends.
"""

from dataclasses import dataclass
from typing import Literal, cast

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.protocol import Protocol, rate_grid
from undrift.sim.motion.library import TaskName
from undrift.study.case import device_of, perform
from undrift.study.design import Criterion, RateDesign, optimal_rates, prediction_sd
from undrift.study.note import TABLE_1
from undrift.study.plan import Study, StudyTask
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

DEGREES = (1, 3)
CANDIDATES = 181
SAMPLES = 4000  # of the rates of a task
PERFORMED = 10  # subjects
RATE_HZ = 50.0

Set = Literal["uniform", "D", "I"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignRow:
    """One set of rates for one task.

    Parameters
    ----------
    task : str
        What is done.
    grid : str
        Whose uniform grid it is compared with: the note's, or that of the optimum.
    degree : int
        Of the polynomial that an axis' reading is taken for.
    criterion : str
        uniform, D or I.
    turn_rate_dps, share : tuple of float
        Rates of one axis, deg/s, increasing, and shares of the time; neighbours gathered.
    d_efficiency_uniform, i_efficiency_uniform : float
        What the uniform grid has of the information of this set; 1 for the grid itself.
    dwells : int
        How many the uniform grid makes of one axis: all sets have their time.
    dwell_s : float or None
        One dwell, s; None where it is stated by its uncertainty.
    error_dps : float or None
        Predicted error of the rate over the task, root-mean-square, deg/s; None for a device without white noise.
    beyond : float
        Share of the task's rates above the greatest of the grid.
    """

    task: str
    grid: str
    degree: int
    criterion: Set
    turn_rate_dps: tuple[float, ...]
    share: tuple[float, ...]
    d_efficiency_uniform: float
    i_efficiency_uniform: float
    dwells: int
    dwell_s: float | None
    error_dps: float | None
    beyond: float


def design_rows(study: Study, task: StudyTask, found: Protocol) -> tuple[DesignRow, ...]:
    """Compare sets of rates for one task.

    Parameters
    ----------
    study : Study
        Gives cohort and device.
    task : StudyTask
        What is done.
    found : Protocol
        The optimum; its grid is compared with where the note has none for the task.

    Returns
    -------
    tuple of DesignRow
        By degree: uniform, D, I; a degree that the grid has too few rates for is left out.
    """
    note = TABLE_1.get(cast("TaskName", task.name)) if task.motion is None else None
    if note is None:
        grid, name = found.turn_rates(), "the optimum's"
    else:
        dps = rate_grid(note.turn_rate_min_dps, note.turn_rate_max_dps, note.turn_rate_step_dps, rule="paper")
        grid, name = dps * RADIAN_PER_DEGREE, "the note's"
    rates, sd = task_rates(study, task), _dwell_sd(study, task.base)
    rows: list[DesignRow] = []
    for degree in DEGREES:
        try:
            rows += _of_degree(task, name, grid, rates, sd, degree)
        except InputError:  # too few rates in the grid for this polynomial
            continue
    return tuple(rows)


def task_rates(study: Study, task: StudyTask) -> FloatArray:
    """Return the rates that occur in a task about the axis of the pitch.

    Parameters
    ----------
    study : Study
        Gives the cohort.
    task : StudyTask
        What is done.

    Returns
    -------
    array, shape (m,)
        Of ten subjects in motion, rad/s, 4000 at most.
    """
    seen = []
    for number in range(1 if task.motion is not None else min(study.subjects, PERFORMED)):
        performed = perform(study, task, number)
        start, stop = performed.moving_s
        time = np.arange(start, min(stop, performed.duration_s), 1.0 / RATE_HZ)
        seen.append(performed.at(time, STANDARD_GRAVITY).rate_b[:, 1])
    rates: FloatArray = np.concatenate(seen)
    known: FloatArray = rates[np.isfinite(rates)]
    return known[:: len(known) // SAMPLES + 1].copy()


def _dwell_sd(study: Study, base: Protocol) -> float | None:
    """Return how uncertain the mean of one dwell is, rad/s."""
    noise = device_of(study, 0).gyro.white_noise
    if base.dwell_s is None:
        return base.turn_rate_uncertainty
    return None if noise is None else float(noise.random_walk[1] / np.sqrt(base.dwell_s))


def _of_degree(
    task: StudyTask, name: str, grid: FloatArray, rates: FloatArray, dwell_sd: float | None, degree: int
) -> list[DesignRow]:
    top, even = float(np.abs(grid).max()), np.full(len(grid), 1.0 / len(grid))
    candidates, criteria = np.linspace(-top, top, CANDIDATES), cast("tuple[Criterion, ...]", ("D", "I"))
    made: list[tuple[Set, FloatArray, FloatArray, RateDesign | None]] = [("uniform", grid, even, None)]
    for criterion in criteria:
        design = optimal_rates(candidates, rates, grid, criterion=criterion, degree=degree)
        made.append((criterion, design.turn_rate, design.share, design))
    rows = []
    for which, at, share, own in made:
        error = None
        if dwell_sd is not None:
            error = prediction_sd(at, share, rates, dwell_sd=dwell_sd, dwells=len(grid), degree=degree)
        told, parts = (at, share) if own is None else _gathered(at, share, 5.0 * top / (CANDIDATES - 1))
        rows.append(
            DesignRow(
                task=task.name,
                grid=name,
                degree=degree,
                criterion=which,
                turn_rate_dps=tuple(float(rate / RADIAN_PER_DEGREE) for rate in told),
                share=tuple(map(float, parts)),
                d_efficiency_uniform=1.0 if own is None else own.d_efficiency_uniform,
                i_efficiency_uniform=1.0 if own is None else own.i_efficiency_uniform,
                dwells=len(grid),
                dwell_s=task.base.dwell_s,
                error_dps=None if error is None else error / RADIAN_PER_DEGREE,
                beyond=float(np.mean(np.abs(rates) > top * (1.0 + 1e-9))),
            )
        )
    return rows


def _gathered(rate: FloatArray, share: FloatArray, near: float) -> tuple[FloatArray, FloatArray]:
    """Return a design whose neighbouring rates, of one stop that falls between candidates, are one rate."""
    groups = np.concatenate(([0], np.cumsum(np.diff(rate) > near)))
    total = np.bincount(groups, weights=share).astype(np.float64)
    return np.bincount(groups, weights=share * rate).astype(np.float64) / total, total
