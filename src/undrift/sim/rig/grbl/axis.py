"""Stepper: a shaft that follows a planned path, a ripple of its detents apart.

A path is a list of pieces of constant acceleration, x = x0 + v0 t + a t^2/2 from the start of each; what the pulses say and what
the shaft does are two paths, since a motor without current loses steps.
"""

import bisect
import math
from dataclasses import dataclass, field

import numpy as np

from undrift.arrays import FloatArray

GRIP = 1e6  # deg/s2: a motor that gets its current back holds at once


@dataclass(slots=True)
class Path:
    """Pieces of constant acceleration, deg.

    Parameters
    ----------
    start : list of float
        When each begins, s.
    angle, rate, acceleration : list of float
        deg, deg/s, deg/s2 at its beginning.
    """

    start: list[float] = field(default_factory=lambda: [0.0])
    angle: list[float] = field(default_factory=lambda: [0.0])
    rate: list[float] = field(default_factory=lambda: [0.0])
    acceleration: list[float] = field(default_factory=lambda: [0.0])

    def at(self, time: float) -> tuple[float, float]:
        """Return angle and rate at a moment.

        Parameters
        ----------
        time : float
            s.

        Returns
        -------
        angle, rate : float
            deg, deg/s.
        """
        i = max(bisect.bisect_right(self.start, time) - 1, 0)
        t = time - self.start[i]
        return (
            self.angle[i] + t * (self.rate[i] + 0.5 * self.acceleration[i] * t),
            self.rate[i] + self.acceleration[i] * t,
        )

    def many(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return angle and rate at many moments.

        Parameters
        ----------
        times : array, shape (n,)
            s.

        Returns
        -------
        angle, rate : array, shape (n,)
            deg, deg/s.
        """
        first = max(
            bisect.bisect_right(self.start, float(times.min(initial=math.inf))) - 1, 0
        )  # only what is asked for
        start, angle = np.array(self.start[first:]), np.array(self.angle[first:])
        rate, acceleration = np.array(self.rate[first:]), np.array(self.acceleration[first:])
        i = np.clip(np.searchsorted(start, times, side="right") - 1, 0, None)
        t = times - start[i]
        return angle[i] + t * (rate[i] + 0.5 * acceleration[i] * t), rate[i] + acceleration[i] * t

    def cut(self, time: float) -> None:
        """Forget what was planned after a moment; what is under way there goes on without end.

        Parameters
        ----------
        time : float
            s.
        """
        keep = max(bisect.bisect_right(self.start, time), 1)
        for column in (self.start, self.angle, self.rate, self.acceleration):
            del column[keep:]

    def go(self, time: float, angle: float, rate: float, acceleration: float) -> None:
        """Add a piece at the end.

        Parameters
        ----------
        time : float
            When it begins, s.
        angle, rate, acceleration : float
            deg, deg/s, deg/s2.
        """
        self.start.append(time)
        self.angle.append(angle)
        self.rate.append(rate)
        self.acceleration.append(acceleration)

    def slow(self, time: float, deceleration: float) -> float:
        """Come to rest from whatever goes on at a moment.

        Parameters
        ----------
        time : float
            s.
        deceleration : float
            deg/s2, positive.

        Returns
        -------
        float
            When it rests, s.
        """
        angle, rate = self.at(time)
        self.cut(time)
        duration = abs(rate) / deceleration
        self.go(time, angle, rate, -math.copysign(deceleration, rate) if rate else 0.0)
        self.go(time + duration, angle + 0.5 * rate * duration, 0.0, 0.0)
        return time + duration

    def follow(self, time: float, rate: float, legs: list[tuple[float, float]]) -> float:
        """Replace what was planned by legs of constant acceleration, after which the axis rests.

        Parameters
        ----------
        time : float
            When they begin, s.
        rate : float
            Then, deg/s.
        legs : list of (float, float)
            Duration, s, and acceleration, deg/s2, of each.

        Returns
        -------
        float
            When they end, s.
        """
        angle, _ = self.at(time)
        self.cut(time)
        for duration, acceleration in legs:
            self.go(time, angle, rate, acceleration)
            angle += duration * (rate + 0.5 * acceleration * duration)
            rate += acceleration * duration
            time += duration
        self.go(time, angle, 0.0, 0.0)
        return time


class Stepper:
    """The pulses of a board and the shaft that follows them while its motor has current."""

    def __init__(self) -> None:
        self.pulses, self.shaft = Path(), Path()
        self.energised = True
        self.ratio = (
            1.0  # deg of the shaft in a deg of the pulses: what the steps-per-degree setting makes of a true step
        )

    def follow(self, time: float, legs: list[tuple[float, float]]) -> None:
        """Replace what was planned.

        Parameters
        ----------
        time : float
            When the legs begin, s.
        legs : list of (float, float)
            Duration, s, and acceleration, deg/s2, of each.
        """
        _, rate = self.pulses.at(time)
        self.pulses.follow(time, rate, legs)
        if self.energised:
            self.shaft.follow(time, self.ratio * rate, [(duration, self.ratio * a) for duration, a in legs])

    def slow(self, time: float, deceleration: float) -> float:
        """Come to rest.

        Parameters
        ----------
        time : float
            From when, s.
        deceleration : float
            deg/s2, positive.

        Returns
        -------
        float
            When it rests, s.
        """
        if self.energised:
            self.shaft.slow(time, self.ratio * deceleration)
        return self.pulses.slow(time, deceleration)

    def set_current(self, time: float, on: bool, coast: float) -> None:
        """Switch the motor's current; without it the shaft coasts and the pulses go on by themselves.

        Parameters
        ----------
        time : float
            s.
        on : bool
            True for current.
        coast : float
            Deceleration by friction, deg/s2.
        """
        if self.energised != on:
            self.shaft.slow(time, GRIP if on else coast)
        self.energised = on

    def count_from_zero(self, time: float) -> None:
        """Forget the pulses: the board has started afresh.

        Parameters
        ----------
        time : float
            s.
        """
        self.pulses.cut(time)
        self.pulses.go(time, 0.0, 0.0, 0.0)


def rippled(angle: FloatArray, rate: FloatArray, amplitude: float, period: float) -> tuple[FloatArray, FloatArray]:
    """Add the ripple of the detents: x + A sin(2 pi x / p).

    Parameters
    ----------
    angle, rate : array, shape (n,)
        deg, deg/s.
    amplitude : float
        A, deg.
    period : float
        p, a full step, deg.

    Returns
    -------
    angle, rate : array, shape (n,)
        deg, deg/s.
    """
    phase = 2.0 * math.pi * angle / period
    factor = 1.0 + amplitude * 2.0 * math.pi / period * np.cos(phase)
    return angle + amplitude * np.sin(phase), rate * factor
