"""Clocks of an emulated rig: the host's, sped up, or one that a test moves by hand."""

import time
from typing import Protocol

from undrift.errors import InputError


class Clock(Protocol):
    """Emulated time, s from the start."""

    def now(self) -> float:
        """Return emulated time, s."""


class HostClock:
    """The host's monotonic clock, faster by a factor.

    Parameters
    ----------
    speed : float
        Emulated seconds in one of the host's.

    Raises
    ------
    InputError
        A factor that is not positive.
    """

    def __init__(self, speed: float = 1.0) -> None:
        if not speed > 0.0:
            raise InputError(f"emulator speed: wanted a positive factor, got {speed}; 1 is real time")
        self.speed = speed
        self._start = time.monotonic()

    def now(self) -> float:
        """Return emulated time since the clock was made, s."""
        return (time.monotonic() - self._start) * self.speed


class HandClock:
    """A clock that stands still until it is told to move on, for tests that must repeat to the last bit."""

    def __init__(self) -> None:
        self._time = 0.0

    def now(self) -> float:
        """Return emulated time, s."""
        return self._time

    def advance(self, duration_s: float) -> None:
        """Move on.

        Parameters
        ----------
        duration_s : float
            s, zero or more.

        Raises
        ------
        InputError
            A clock does not go back.
        """
        if duration_s < 0.0:
            raise InputError(f"clock: wanted zero or more seconds, got {duration_s}; a clock does not go back")
        self._time += duration_s
