"""Optimal designs: at which rates a table should dwell, from the Fisher information, as a rival to the note's uniform grids.

One axis reads, at rate w, ``y = f(w)^T c + e`` with f = (1, w, w^2, ..., w^p), scaled to the largest rate. A design puts the share
x_i of the dwelling time at rate w_i; its information is ``M = sum_i x_i f_i f_i^T``::

    D-optimal   greatest det M                                   the coefficients together
    I-optimal   least mean of f(w)^T M^-1 f(w) over the task     what the correction will be wrong by, on average

Both are convex; the multiplicative algorithm climbs to them from a uniform start [1]_: ``x_i <- x_i (g_i / sum_j x_j
g_j)^(1/2)`` with g the directional derivative: ``f^T M^-1 f`` for D, ``f^T M^-1 B M^-1 f`` for I, B the mean of f f^T over
the task.

References ---------- .. [1] S. D. Silvey, D. M. Titterington, B. Torsney, "An algorithm for optimal designs on a finite
design space", Communications in Statistics A7(14), 1978.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError

Criterion = Literal["D", "I"]
ROUNDS = 4000
CONVERGED = 1e-6  # of the greatest derivative over its mean
NOTHING = 1e-3  # share of the time that is not worth a stop


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateDesign:
    """Where to dwell, and for which share of the time.

    Parameters
    ----------
    criterion : str
        D or I.
    turn_rate : array, shape (k,)
        Rates, rad/s, increasing.
    share : array, shape (k,)
        Of the time; they add up to 1.
    d_efficiency_uniform, i_efficiency_uniform : float
        What the uniform grid reaches of this design's information, by each measure: 1 is as good, 0.5 needs twice the time.
    """

    criterion: Criterion
    turn_rate: FloatArray
    share: FloatArray
    d_efficiency_uniform: float
    i_efficiency_uniform: float


def optimal_rates(
    candidates: FloatArray,
    task_rates: FloatArray,
    uniform: FloatArray,
    *,
    criterion: Criterion = "I",
    degree: int = 3,
) -> RateDesign:
    """Find the rates that tell most for the dwelling time.

    Parameters
    ----------
    candidates : array, shape (n,)
        Rates that the table can turn at, rad/s.
    task_rates : array, shape (m,)
        Rates that occur in the task, rad/s: what the correction is for.
    uniform : array, shape (u,)
        The grid to compare with, rad/s; equal time at each.
    criterion : str
        D or I.
    degree : int
        Of the polynomial that an axis' reading is.

    Returns
    -------
    RateDesign
        Rates with a share of a thousandth or more.

    Raises
    ------
    InputError
        Fewer candidates or grid rates than coefficients.
    """
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
    rates, share = candidates[kept], share[kept] / share[kept].sum()
    order = np.argsort(rates)
    own = f[kept]
    grid = np.vander(uniform / top, needed, increasing=True)
    even = grid.T @ grid / len(grid)
    made = (own * share[:, None]).T @ own
    return RateDesign(
        criterion=criterion,
        turn_rate=rates[order],
        share=share[order],
        d_efficiency_uniform=float((np.linalg.det(even) / np.linalg.det(made)) ** (1.0 / needed)),
        i_efficiency_uniform=float(np.trace(np.linalg.solve(made, wanted)) / np.trace(np.linalg.solve(even, wanted))),
    )


def prediction_sd(
    turn_rate: FloatArray, share: FloatArray, task_rates: FloatArray, *, dwell_sd: float, dwells: float, degree: int = 3
) -> float:
    """Return how wrong the fitted curve will be over a task, root-mean-square.

    Parameters
    ----------
    turn_rate, share : array, shape (k,)
        A design: rates, rad/s, and shares of the time.
    task_rates : array, shape (m,)
        Rates of the task, rad/s.
    dwell_sd : float
        Standard deviation of the mean of one dwell, rad/s.
    dwells : float
        How many dwells the time allows.
    degree : int
        Of the polynomial.

    Returns
    -------
    float
        rad/s.
    """
    top = float(np.abs(turn_rate).max())
    f = np.vander(turn_rate / top, degree + 1, increasing=True)
    aim = np.vander(task_rates / top, degree + 1, increasing=True)
    information = (f * share[:, None]).T @ f * dwells
    return float(dwell_sd * np.sqrt(np.mean(np.einsum("mi,ij,mj->m", aim, np.linalg.inv(information), aim))))


def _climb(f: FloatArray, wanted: FloatArray | None) -> FloatArray:
    share = np.full(len(f), 1.0 / len(f))
    for _ in range(ROUNDS):
        inverse = np.linalg.inv((f * share[:, None]).T @ f)
        middle = inverse if wanted is None else inverse @ wanted @ inverse
        gain = np.einsum("ni,ij,nj->n", f, middle, f)
        mean = float(share @ gain)
        if gain.max() < mean * (1.0 + CONVERGED):
            break
        share = share * np.sqrt(gain / mean)
        share = share / share.sum()
    return share
