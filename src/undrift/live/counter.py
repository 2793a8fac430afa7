"""Counters: what the device counted, made to go on for ever.

A counter of b bits wraps at 2^b. Steps are taken modulo that; whole turns that went by in a silence are told from the host's
clock. A step back by a little is a reading that came late or twice: it is left out. A step that disagrees with the host's
clock by more than ``RESTART_S`` is a device that started anew: its count goes on from where the host's clock says it would be.
"""

import numpy as np

from undrift.arrays import BoolArray, FloatArray

RESTART_S = 2.0
SILENCE_S = 0.25


class Counter:
    """Unwraps the device's counter.

    Parameters
    ----------
    bits : int
        Its width; 0 for one that never wraps.
    tick_s : float
        Device seconds a step.
    clock_speed : float
        Device seconds per host second.
    """

    def __init__(self, bits: int, tick_s: float, clock_speed: float = 1.0) -> None:
        self._modulus = 2.0**bits if bits else 0.0
        self._tick = tick_s
        self._speed = clock_speed
        self._raw = self._host = self._total = 0.0
        self._begun = False
        self.late = 0
        self.restarts = 0

    def unwrap(self, raw: FloatArray, host_time: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return counts that only rise.

        Parameters
        ----------
        raw : array, shape (N,)
            As sent.
        host_time : array, shape (N,)
            When each came, s.

        Returns
        -------
        count : array, shape (N,)
            From 0 at the first reading; rises where ``kept``.
        kept : array of bool, shape (N,)
            False for readings that came late or twice.
        """
        if not self._begun and len(raw):
            self._raw, self._host, self._begun = float(raw[0]) - 1.0, float(host_time[0]), True
            self._total = -1.0
        step = np.diff(raw, prepend=self._raw)
        if self._modulus:
            step %= self._modulus
        ordinary = (
            (step > 0.0)
            & (step * self._tick < RESTART_S / 2.0)
            & (np.diff(host_time, prepend=self._host) < RESTART_S / 2.0)
        )
        if ordinary.all():
            count: FloatArray = self._total + np.cumsum(step)
            if len(raw):
                self._raw, self._host, self._total = float(raw[-1]), float(host_time[-1]), float(count[-1])
            return count, ordinary
        pairs = [self._next(r, h) for r, h in zip(raw.tolist(), host_time.tolist(), strict=True)]
        return np.array([total for total, _ in pairs]), np.array([kept for _, kept in pairs], dtype=bool)

    def _next(self, raw: float, host: float) -> tuple[float, bool]:
        step = raw - self._raw
        expected = (host - self._host) * self._speed / self._tick
        if self._modulus:
            step = (step + self._modulus / 2.0) % self._modulus - self._modulus / 2.0
            step += max(round((expected - step) / self._modulus), 0) * self._modulus
        if step <= 0.0 and -step * self._tick < RESTART_S:
            self.late += 1
            return self._total, False
        slack = RESTART_S * max(self._speed, 1.0) / self._tick + 0.1 * abs(expected)
        if abs(step - expected) > slack:
            self.restarts += 1
            step = max(round(expected), 1.0)
        self._raw, self._host, self._total = raw, host, self._total + step
        return self._total, True


class Arrivals:
    """Counts for a device that does not: one a reading, and what a silence says was lost.

    A silence of more than ``SILENCE_S`` after which fewer than half the readings of that time come at once has lost the others.

    Parameters
    ----------
    rate : float
        Readings per device second.
    clock_speed : float
        Device seconds per host second.
    """

    def __init__(self, rate: float, clock_speed: float = 1.0) -> None:
        self._per_host_s = rate * clock_speed
        self._total = -1.0
        self._host: float | None = None

    def count(self, host_time: FloatArray) -> FloatArray:
        """Return counts.

        Parameters
        ----------
        host_time : array, shape (N,)
            When each came, s.

        Returns
        -------
        array, shape (N,)
            From 0 at the first reading.
        """
        n = len(host_time)
        if not n:
            return np.empty(0)
        silent = 0.0 if self._host is None else float(host_time[0]) - self._host
        due = silent * self._per_host_s
        lost = round(due - n) if silent > SILENCE_S and n < due / 2.0 else 0
        self._host = float(host_time[-1])
        found: FloatArray = self._total + lost + np.arange(1.0, n + 1.0)
        self._total = float(found[-1])
        return found
