"""Course: one coordinate over time, a sum of parts whose derivatives are closed forms.

``Step``      least-jerk change between two rests: 10 s^3 - 15 s^4 + 6 s^5; peak rate 1.875 A/T, acceleration 5.77 A/T^2
``ViaPoint``  least-jerk there and back: through a turning point at a given instant, its acceleration left free
``Wave``      a sinusoid that swells and ebbs
``Sway``      a sum of sinusoids under one such envelope
``Burst``     a decaying oscillation: the knock of a heel
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from undrift.arrays import FloatArray


class Part(Protocol):
    """A function of time with its first two derivatives."""

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative.

        Parameters
        ----------
        time : array, shape (N,)
            s.

        Returns
        -------
        array, shape (3, N)
            Value, per s, per s2.
        """
        ...


Course = tuple[Part, ...]


def course_at(course: Course, time: FloatArray) -> FloatArray:
    """Return a course and its first two derivatives.

    Parameters
    ----------
    course : tuple of Part
        What adds up.
    time : array, shape (N,)
        s.

    Returns
    -------
    array, shape (3, N)
        Value in rad or m, per s, per s2.
    """
    total = np.zeros((3, len(time)))
    for part in course:
        total += part.at(time)
    return total


@dataclass(frozen=True, slots=True)
class Step:
    """A smooth change: the quintic of least jerk, 10 s^3 - 15 s^4 + 6 s^5 of the local time s.

    Parameters
    ----------
    start_s, duration_s : float
        s.
    change : float
        rad or m.
    """

    start_s: float
    duration_s: float
    change: float

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative.

        Parameters
        ----------
        time : array, shape (N,)
            s.

        Returns
        -------
        array, shape (3, N)
            Value, per s, per s2.
        """
        s = np.clip((time - self.start_s) / self.duration_s, 0.0, 1.0)
        left = s * (1.0 - s)
        value = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
        first, second = 30.0 * left * left / self.duration_s, 60.0 * left * (1.0 - 2.0 * s) / self.duration_s**2
        return self.change * np.stack((value, first, second))


@dataclass(frozen=True, slots=True)
class ViaPoint:
    """There and back with least jerk: rest, a turning point, rest.

    The integral of the squared jerk is least among all courses that start and end at rest and stand still for an
    instant at the via-point. Each side is a quintic; acceleration and jerk pass the via-point unbroken, which gives its
    acceleration (T and U the two durations, A and B the two changes)::

        a = (20/3) (B / U^3 - A / T^3) / (1 / T + 1 / U)

    There and back evenly (B = -A, U = T): peak rate 1.728 A/T, acceleration at the turn -6.67 A/T^2.

    Parameters
    ----------
    start_s : float
        s.
    there_s, back_s : float
        Durations before and after the via-point, s.
    there, back : float
        Changes before and after it, rad or m.
    """

    start_s: float
    there_s: float
    back_s: float
    there: float
    back: float

    @property
    def acceleration(self) -> float:
        """Acceleration at the via-point, rad/s2 or m/s2."""
        pull = self.back / self.back_s**3 - self.there / self.there_s**3
        return 20.0 / 3.0 * pull / (1.0 / self.there_s + 1.0 / self.back_s)

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative.

        Parameters
        ----------
        time : array, shape (N,)
            s.

        Returns
        -------
        array, shape (3, N)
            Value, per s, per s2.
        """
        via_s = self.start_s + self.there_s
        total = Step(self.start_s, self.there_s, self.there).at(time) + Step(via_s, self.back_s, self.back).at(time)
        bend = _bend(np.clip((via_s - time) / self.there_s, 0.0, 1.0), self.there_s) * [[1.0], [-1.0], [1.0]]
        after = time > via_s
        bend[:, after] = _bend(np.clip((time[after] - via_s) / self.back_s, 0.0, 1.0), self.back_s)
        return total + self.acceleration * bend


def _bend(s: FloatArray, duration_s: float) -> FloatArray:
    """Return T^2 s^2 (1 - s)^3 / 2 and its derivatives: unit acceleration at s = 0, no value or rate at either end."""
    left = 1.0 - s
    value = 0.5 * duration_s**2 * s * s * left**3
    first = 0.5 * duration_s * s * left * left * (2.0 - 5.0 * s)
    return np.stack((value, first, left * (1.0 - 8.0 * s + 10.0 * s * s)))


@dataclass(frozen=True, slots=True)
class Wave:
    """A sinusoid that swells at the start and ebbs at the end.

    Parameters
    ----------
    amplitude : float
        rad or m.
    frequency_hz : float
        Hz.
    phase : float
        rad.
    start_s, stop_s : float
        Where it is not zero, s.
    swell_s : float
        Time to full amplitude, and back to none, s.
    """

    amplitude: float
    frequency_hz: float
    phase: float
    start_s: float
    stop_s: float
    swell_s: float = 1.0

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative.

        Parameters
        ----------
        time : array, shape (N,)
            s.

        Returns
        -------
        array, shape (3, N)
            Value, per s, per s2.
        """
        one = (self.amplitude,), (self.frequency_hz,), (self.phase,)
        return Sway(*one, self.start_s, self.stop_s, self.swell_s).at(time)


@dataclass(frozen=True, slots=True)
class Sway:
    """A sum of sinusoids under one envelope.

    Parameters
    ----------
    amplitudes : tuple of float
        rad or m.
    frequencies_hz : tuple of float
        Hz.
    phases : tuple of float
        rad.
    start_s, stop_s : float
        Where it is not zero, s.
    swell_s : float
        Time to full amplitude, and back to none, s.
    """

    amplitudes: tuple[float, ...]
    frequencies_hz: tuple[float, ...]
    phases: tuple[float, ...]
    start_s: float
    stop_s: float
    swell_s: float

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative.

        Parameters
        ----------
        time : array, shape (N,)
            s.

        Returns
        -------
        array, shape (3, N)
            Value, per s, per s2.
        """
        rise = Step(self.start_s, self.swell_s, 1.0).at(time)
        e, e1, e2 = rise - Step(self.stop_s - self.swell_s, self.swell_s, 1.0).at(time)
        speed, amplitude = 2.0 * math.pi * np.array(self.frequencies_hz), np.array(self.amplitudes)
        turn = np.outer(speed, time) + np.array(self.phases)[:, None]
        sine, cosine = np.sin(turn), np.cos(turn)
        v, v1, v2 = amplitude @ sine, (amplitude * speed) @ cosine, -(amplitude * speed**2) @ sine
        return np.stack((e * v, e1 * v + e * v1, e2 * v + 2.0 * e1 * v1 + e * v2))


@dataclass(frozen=True, slots=True)
class Burst:
    """A knock that dies away: A (u/T)^3 exp(3 - 3 u/T) sin(w u), u the time since it came.

    Parameters
    ----------
    amplitude : float
        A, m.
    frequency_hz : float
        w / 2 pi, Hz.
    start_s : float
        When it comes, s.
    peak_s : float
        T, from there to the peak of the envelope, s.
    """

    amplitude: float
    frequency_hz: float
    start_s: float
    peak_s: float

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative.

        Parameters
        ----------
        time : array, shape (N,)
            s.

        Returns
        -------
        array, shape (3, N)
            Value, per s, per s2.
        """
        u = np.maximum((time - self.start_s) / self.peak_s, 0.0)
        decay = np.exp(3.0 - 3.0 * u)
        e, e1 = u**3 * decay, 3.0 * u * u * (1.0 - u) * decay / self.peak_s
        e2 = 3.0 * u * (2.0 - 6.0 * u + 3.0 * u * u) * decay / self.peak_s**2
        speed = 2.0 * math.pi * self.frequency_hz
        sine, cosine = np.sin(speed * self.peak_s * u), np.cos(speed * self.peak_s * u)
        first, second = e1 * sine + e * speed * cosine, (e2 - e * speed**2) * sine + 2.0 * e1 * speed * cosine
        return self.amplitude * np.stack((e * sine, first, second))
