"""A steady rate out of finite jogs: one is sent whenever less than a while's worth is queued.

The controller's planner joins jogs of one direction and rate without slowing down, as long as the queue reaches further than it
needs to stop. Whoever feeds it can die: the queue ends and the table comes to rest by itself.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass

from undrift.errors import RigError
from undrift.rig.clock import Clock


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """One jog.

    Parameters
    ----------
    distance_deg : float
        Signed, a whole number of steps.
    deg_per_min : float
        Above zero.
    """

    distance_deg: float
    deg_per_min: float

    @property
    def duration_s(self) -> float:
        """How long it lasts at full rate, s."""
        return 60.0 * abs(self.distance_deg) / self.deg_per_min


class Feeder:
    """Sends jogs from its own thread from birth until `end`.

    Parameters
    ----------
    jog : callable
        Sends one.
    segment : Segment
        The jog that is repeated.
    clock : Clock
        The table's.
    queued : int
        How many jogs are kept queued.
    room : int or None
        How many jogs the travel allows; None for any number.
    """

    def __init__(
        self, jog: Callable[[Segment], None], segment: Segment, clock: Clock, queued: int, room: int | None
    ) -> None:
        self.failure: RigError | None = None
        self._jog = jog
        self._segment = segment
        self._clock = clock
        self._ahead_s = queued * segment.duration_s
        self._room = room
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._feed, name="grbl feeder", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Send no more, and wait for the thread; harmless when called again."""
        self._end.set()
        self._thread.join(timeout=10.0)

    def _feed(self) -> None:
        sent = 0
        planned = self._clock.now()
        pause_s = 0.25 * self._segment.duration_s / self._clock.speed
        while not self._end.is_set() and (self._room is None or sent < self._room):
            now = self._clock.now()
            if planned - now > self._ahead_s:
                self._end.wait(pause_s)
                continue
            try:
                self._jog(self._segment)
            except RigError as error:
                self.failure = error
                return
            planned = max(planned, now) + self._segment.duration_s
            sent += 1
