"""The clock a rig is driven by: the host's monotonic seconds, or an emulator's, which may run faster.

t = speed * (host monotonic time). A motion that takes 6 s on the table takes 6 / speed seconds of waiting here.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from undrift.errors import InputError
from undrift.rig.rig import Position


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """Seconds of the table.

    Parameters
    ----------
    speed : float
        Table seconds per host second: 1 for hardware; what the emulator was started with otherwise.
    """

    speed: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 < self.speed < 1e6:
            raise InputError(f"clock: wanted a speed above 0, got {self.speed:g}; hardware runs at 1")

    def now(self) -> float:
        """Return the time, s.

        Returns
        -------
        float
            Table seconds since an arbitrary start, never going back.
        """
        return self.speed * time.monotonic()

    def wait(self, duration_s: float) -> None:
        """Wait.

        Parameters
        ----------
        duration_s : float
            Table seconds; nothing happens when not above zero.
        """
        if duration_s > 0.0:
            time.sleep(duration_s / self.speed)

    def mean_turn_rate(self, position: Callable[[], Position], duration_s: float) -> float:
        """Return the mean rate over a while, from two positions.

        Parameters
        ----------
        position : callable
            Returns where the axis stands.
        duration_s : float
            Table seconds between the two; one count more or less matters less the longer it is.

        Returns
        -------
        float
            rad/s.

        Raises
        ------
        InputError
            Not a duration.
        """
        if not (math.isfinite(duration_s) and duration_s > 0.0):
            raise InputError(f"measured rate: wanted a duration above 0 s, got {duration_s}; give seconds")
        first = position()
        self.wait(duration_s)
        last = position()
        return (last.angle - first.angle) / (last.time - first.time)
