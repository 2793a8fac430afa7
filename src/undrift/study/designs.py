"""Rates to dwell at: D- and I-optimal sets beside the uniform grid of the note, for the rates of each task.

One axis reads ``y = f(w)^T c + e``, f = (1, w, ..., w^p); with the share x_i of the time at rate w_i the
information is ``M = sum_i x_i f_i f_i^T``. D-optimal: greatest det M; I-optimal: least mean of ``f(w)^T M^-1 f(w)`` over the task.
``x_i <- x_i (g_i / sum_j x_j g_j)^(1/2)`` (Silvey et al., Communications in Statistics A7(14), 1978), g the derivative.
"""

from dataclasses import dataclass
from typing import Literal, cast

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.rig.programme import Protocol, rate_grid
from undrift.sim.motion.tasks import TaskName
from undrift.study.case import device_of, perform
from undrift.study.plan import TABLE_1, Study, StudyTask
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

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
    share = np.full(len(f), 1.0 / len(f))
    for _ in range(ROUNDS):
        inverse = np.linalg.inv((f * share[:, None]).T @ f)
        gain = np.einsum("ni,ij,nj->n", f, inverse if wanted is None else inverse @ wanted @ inverse, f)
        mean = float(share @ gain)
        if gain.max() < mean * (1.0 + CONVERGED):
            break
        share = share * np.sqrt(gain / mean)
        share = share / share.sum()
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
    for number in range(1 if task.motion is not None else min(study.subjects, PERFORMED)):
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
