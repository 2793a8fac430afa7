"""The rate that was achieved, from positions of the encoder over a dwell.

A line through (t_i, phi_i) by least squares: slope sum (t - tm)(phi - phim) / S, S = sum (t - tm)^2, with standard uncertainty
sqrt(r / ((n - 2) S)), r the sum of squared residuals: counts of the encoder and the delays of the link are in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.errors import InputError
from undrift.rig.rig import Position


@dataclass(frozen=True, slots=True, kw_only=True)
class Achieved:
    """A rate as it was.

    Parameters
    ----------
    turn_rate : float
        rad/s.
    uncertainty : float
        Standard, rad/s.
    """

    turn_rate: float
    uncertainty: float


def achieved_turn_rate(positions: Sequence[Position]) -> Achieved:
    """Return the mean rate over a dwell.

    Parameters
    ----------
    positions : sequence of Position
        Three or more, in order of time.

    Returns
    -------
    Achieved
        Slope and its uncertainty.

    Raises
    ------
    InputError
        Fewer than three.
    """
    if len(positions) < 3:
        raise InputError(f"achieved rate: wanted three positions or more, got {len(positions)}; dwell longer")
    time = np.array([p.time for p in positions]) - positions[0].time
    angle = np.array([p.angle for p in positions]) - positions[0].angle
    t, phi = time - time.mean(), angle - angle.mean()
    square = float(t @ t)
    slope = float(t @ phi) / square
    residual = phi - slope * t
    return Achieved(turn_rate=slope, uncertainty=float(np.sqrt(residual @ residual / ((len(time) - 2) * square))))
