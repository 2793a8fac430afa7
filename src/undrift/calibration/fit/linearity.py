"""Linearity of one rate axis: how far its dwells are from the best straight line (IEEE Std 1431, clause 12 terms).

reading = o + S w                                   least-squares line over all dwells of the axis
scale_factor_nonlinearity   largest |reading - line| / S
scale_factor_asymmetry      2 (S+ - S-) / (S+ + S-), from reading = o + S+ max(w, 0) + S- min(w, 0)
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import NotObservable
from undrift.session import Axis


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linearity:
    """Table of one axis: imposed rate, and how far the reading is from the line.

    Parameters
    ----------
    axis : str
        x, y or z.
    turn_rate : array, shape (N,)
        Imposed, rad/s, increasing.
    error : array, shape (N,)
        Reading less line, in rad/s of input.
    scale_factor : float
        Slope of the line, reading per rad/s.
    offset : float
        Reading of the line at zero rate.
    scale_factor_nonlinearity : float
        Largest departure from the line, rad/s.
    scale_factor_nonlinearity_percent : float
        The same in per cent of the largest imposed rate.
    scale_factor_asymmetry : float
        Dimensionless; NaN where one sign is missing.
    """

    axis: Axis
    turn_rate: FloatArray
    error: FloatArray
    scale_factor: float
    offset: float
    scale_factor_nonlinearity: float
    scale_factor_nonlinearity_percent: float
    scale_factor_asymmetry: float


def linearity(reading: FloatArray, turn_rate: FloatArray, axis: Axis) -> Linearity:
    """Compare the dwells of one axis with their best straight line.

    Parameters
    ----------
    reading : array, shape (N,)
        Mean reading of the axis' own sensor in each dwell.
    turn_rate : array, shape (N,)
        Imposed rate, rad/s.
    axis : str
        x, y or z.

    Returns
    -------
    Linearity
        Table and figures.

    Raises
    ------
    NotObservable
        Fewer than two different rates.
    """
    if len(np.unique(turn_rate)) < 2:
        raise NotObservable(
            f"rate axis {axis}: wanted dwells at two different rates or more, got {len(np.unique(turn_rate))}; "
            "record both signs of several rates"
        )
    order = np.argsort(turn_rate)
    rate, value = turn_rate[order], reading[order]
    line = np.column_stack((np.ones_like(rate), rate))
    offset, slope = np.linalg.lstsq(line, value, rcond=None)[0]
    error = (value - offset - slope * rate) / slope
    worst = float(np.abs(error).max())
    return Linearity(
        axis=axis,
        turn_rate=rate,
        error=error,
        scale_factor=float(slope),
        offset=float(offset),
        scale_factor_nonlinearity=worst,
        scale_factor_nonlinearity_percent=100.0 * worst / float(np.abs(rate).max()),
        scale_factor_asymmetry=_asymmetry(value, rate),
    )


def _asymmetry(reading: FloatArray, rate: FloatArray) -> float:
    if len(np.unique(rate)) < 3 or not ((rate > 0.0).any() and (rate < 0.0).any()):
        return float("nan")
    bent = np.column_stack((np.ones_like(rate), np.maximum(rate, 0.0), np.minimum(rate, 0.0)))
    _, plus, minus = np.linalg.lstsq(bent, reading, rcond=None)[0]
    return float(2.0 * (plus - minus) / (plus + minus))
