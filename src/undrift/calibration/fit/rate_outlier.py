"""Dwells of a rate table that no straight line through the others explains: a rate stated with a wrong sign, value or axis.

One such dwell moves a least-squares fit, and an offset that is let wander follows it. So before either, each sensor is fitted by
least absolute deviations, which a few false dwells do not move::

    (K, b) = argmin sum_i |s_i - K w_i - b|        e_i = K^-1 (s_i - b) - w_i, rad/s; with rests, + H a_i beside b

A dwell is refused where |e_i| is beyond both limits::

    8 times the typical |e|           median over the dwells, less one for every parameter that the fit makes exact
    0.5 % of the largest rate         curvature of a sound sensor stays below
"""

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.dwells import DwellMeans
from undrift.calibration.fit.rate_rests import RestMeans
from undrift.calibration.fit.result import scaled_condition
from undrift.calibration.model import AXES
from undrift.errors import Implausible
from undrift.units import RADIAN_PER_DEGREE

SCATTERS = 8.0  # times the typical error: beyond any tail that noise, wobble or drift makes of a few tens of dwells
SHARE = 0.005  # of the largest rate
_LEAST_SPARE = 4  # equations beyond the four parameters of a sensor; with fewer, no dwell can be told from the others
_ROUNDS = 60


def check_dwells(
    dwells: DwellMeans,
    rates: FloatArray,
    *,
    rests: RestMeans | None = None,
    numbers: tuple[int, ...] | None = None,
) -> None:
    """Raise when the reading of a dwell contradicts all the others.

    Parameters
    ----------
    dwells : DwellMeans
        Mean readings about x, y and z.
    rates : array, shape (N, 3)
        Imposed rate of each, rad/s.
    rests : RestMeans, optional
        They count as dwells at zero rate; with their specific force, what gravity adds to a reading is told apart.
    numbers : tuple of int, optional
        Number of each dwell among the session's turns, from one; None counts the dwells.

    Raises
    ------
    Implausible
        Names the dwells, what they were said to be and what they read.
    """
    design, reading = _equations(dwells, rates, rests)
    spare = len(design) - design.shape[1]
    if spare < _LEAST_SPARE or np.linalg.matrix_rank(design) < design.shape[1]:
        return
    theta = np.array([_least_deviations(design, column) for column in reading.T])
    if abs(np.linalg.det(theta[:, :3])) < 1e-6 * np.prod(np.linalg.norm(theta[:, :3], axis=1)):
        return  # two columns that read the same; the fit itself says so
    away = (reading - design @ theta.T) @ np.linalg.inv(theta[:, :3]).T
    error = np.linalg.norm(away, axis=1)
    typical = float(np.median(np.sort(error)[design.shape[1] :]))
    limit = max(SCATTERS * typical, SHARE * float(np.abs(rates).max()))
    wrong = np.flatnonzero(error[: len(rates)] > limit)
    if len(wrong):
        numbers = tuple(range(1, len(rates) + 1)) if numbers is None else numbers
        named = "; ".join(_named(dwells, rates[k] + away[k], k, numbers[k]) for k in wrong[:3])
        more = f"; and {len(wrong) - 3} more" if len(wrong) > 3 else ""
        raise Implausible(
            f"rate table: wanted dwells that agree within {limit / RADIAN_PER_DEGREE:.2g} deg/s, got {named}{more}; check its "
            "sign, value, axis and times, or leave it out",
            turns=tuple(numbers[k] for k in wrong),
        )


def _equations(dwells: DwellMeans, rates: FloatArray, rests: RestMeans | None) -> tuple[FloatArray, FloatArray]:
    if rests is None:
        return np.column_stack((rates, np.ones(len(rates)))), dwells.reading
    imposed = np.vstack((rates, np.zeros_like(rests.reading)))
    reading = np.vstack((dwells.reading, rests.reading))
    plain = np.column_stack((imposed, np.ones(len(imposed))))
    full = np.column_stack((plain, np.vstack((rests.dwell_force, rests.force))))
    enough = len(full) - full.shape[1] >= _LEAST_SPARE and scaled_condition(full)[0] == full.shape[1]
    return (full if enough else plain), reading


def _named(dwells: DwellMeans, read: FloatArray, k: int, number: int) -> str:
    said = dwells.turn_rate[k] / RADIAN_PER_DEGREE
    own = AXES.index(dwells.axis[k])
    most = int(np.abs(read).argmax())
    about = "" if most == own or abs(read[most]) < 2.0 * abs(read[own]) else f" about {AXES[most]}"
    value = read[most if about else own] / RADIAN_PER_DEGREE
    return f"turn {number}, {dwells.axis[k]} at {said:+.4g} deg/s: reads as {value:+.4g}{about}"


def _least_deviations(design: FloatArray, reading: FloatArray) -> FloatArray:
    # Iteratively reweighted least squares; the floor shrinks until the deviations that stay are the false ones.
    theta = np.linalg.lstsq(design, reading, rcond=None)[0]
    for step in range(_ROUNDS):
        away = np.abs(reading - design @ theta)
        floor = max(float(np.median(away)) * 0.9**step, 1e-12 * float(np.abs(reading).max()), 1e-300)
        root = 1.0 / np.sqrt(np.maximum(away, floor))
        theta = np.linalg.lstsq(design * root[:, None], reading * root, rcond=None)[0]
    solution: FloatArray = theta
    return solution
