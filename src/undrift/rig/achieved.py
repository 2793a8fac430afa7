"""The rate that was achieved, from positions of the encoder over a dwell.

A line through (t_i, phi_i) by weighted least squares: slope sum w (t - tm)(phi - phim) / S, S = sum w (t - tm)^2, w = 1 / d^2.
When a position was taken is known no better than d, between question and answer of the link or a tick of the controller's own
clock, so quick answers count more; a floor of half the median d keeps a few from counting alone. The standard uncertainty sqrt(r /
((n - 2) S)), r the sum of w times squared residuals, has the counts of the encoder and the delays of the link in it. It grows with
whatever is wrong, so it is no measure of whether the table turned steadily: that is the misfit, the largest distance from the line
that the delays do not explain, max |residual_i| - |slope| (d_i + median d), and the rate between the first position and the last.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.errors import InputError
from undrift.rig.rig import Position

FLOOR = 0.5  # of the median delay


@dataclass(frozen=True, slots=True, kw_only=True)
class Achieved:
    """A rate as it was.

    Parameters
    ----------
    turn_rate : float
        rad/s.
    uncertainty : float
        Standard, rad/s.
    between_ends : float
        Way from the first position to the last over its time, rad/s.
    misfit : float
        Farthest from steady that a position is, delays of the link left out, rad; 0 where they explain it all.
    span_s : float
        From the first position to the last, s.
    delay_s : float
        Largest of the median time in which a position may have been taken and of those at both ends, s.
    """

    turn_rate: float
    uncertainty: float
    between_ends: float
    misfit: float
    span_s: float
    delay_s: float


def achieved_turn_rate(positions: Sequence[Position]) -> Achieved:
    """Return the mean rate over a dwell.

    Parameters
    ----------
    positions : sequence of Position
        Three or more, in order of time.

    Returns
    -------
    Achieved
        Slope, its uncertainty, and how straight the line was.

    Raises
    ------
    InputError
        Fewer than three.
    """
    if len(positions) < 3:
        raise InputError(f"achieved rate: wanted three positions or more, got {len(positions)}; dwell longer")
    delay = 2.0 * np.array([p.within_s for p in positions])
    floor = FLOOR * float(np.median(delay))
    weight = np.ones_like(delay) if floor <= 0.0 else 1.0 / (delay * delay + floor * floor)
    weight /= weight.sum()
    time = np.array([p.time for p in positions]) - positions[0].time
    angle = np.array([p.angle for p in positions]) - positions[0].angle
    t, phi = time - weight @ time, angle - weight @ angle
    square = float(weight @ (t * t))
    slope = float(weight @ (t * phi)) / square
    residual = phi - slope * t
    spread = float(weight @ (residual * residual)) / ((len(time) - 2) * square)
    beyond = np.abs(residual) - abs(slope) * (delay + np.median(delay))
    return Achieved(
        turn_rate=slope,
        uncertainty=float(np.sqrt(spread)),
        between_ends=float((angle[-1] - angle[0]) / (time[-1] - time[0])),
        misfit=max(0.0, float(beyond.max())),
        span_s=float(time[-1] - time[0]),
        delay_s=float(max(np.median(delay), delay[0], delay[-1])),
    )
