"""A clock of tests on which no time passes but what is waited for: one thread does everything.

A wait carries out what is due meanwhile, in the order of its time, and then it is later. Servers of tests listen on it.
"""

import heapq
import itertools
import threading
from collections.abc import Callable
from typing import Any

from undrift.base.clock import Clock, Port, Repeat, Step


class VirtualRepeat(Repeat):
    """A step that a virtual clock takes when it is due."""

    def __init__(self, step: Step, due: Callable[[float, "VirtualRepeat"], None]) -> None:
        self.ended, self._step, self._due = False, step, due

    def end(self, longest_s: float | None = None) -> None:
        self.ended = True

    def take(self) -> None:
        """Take the step and say when the next is due."""
        pause = None if self.ended else self._step()
        if pause is not None and not self.ended:
            self._due(pause, self)


class VirtualCondition(threading.Condition):
    """A condition of one thread: while it waits, the clock carries out what is due."""

    def __init__(self, clock: "VirtualClock") -> None:
        super().__init__(threading.RLock())
        self._clock, self._told = clock, False

    def wait(self, timeout: float | None = None) -> bool:
        """Let time pass until someone notifies."""
        self._told = False
        self._clock.pass_until(self._clock.now() + (0.0 if timeout is None else timeout), lambda: self._told)
        return self._told

    def notify(self, n: int = 1) -> None:
        self._told = True


class VirtualClock(Clock):
    """Stands still unless someone waits; for one thread, and what stands on this clock alone."""

    def __init__(self) -> None:
        super().__init__()
        self._now = 0.0
        self._due: list[tuple[float, int, VirtualRepeat]] = []  # a heap
        self._number = itertools.count()
        self._doors: dict[tuple[str, int], Callable[[], Port]] = {}

    def now(self) -> float:
        return self._now

    def wait(self, duration_s: float) -> None:
        """Carry out what is due within a while; then it is that much later, or more where that took longer."""
        self.pass_until(self._now + duration_s)

    def jump(self, time_s: float) -> None:
        """Advance the clock without running what is due (for code that holds a lock)."""
        self._now = max(self._now, time_s)

    def pass_until(self, time_s: float, enough: Callable[[], bool] = lambda: False) -> None:
        """Carry out what is due up to a moment, or until there is no more need to."""
        while not enough() and self._due and self._due[0][0] <= time_s:
            due, _, repeat = heapq.heappop(self._due)
            self.jump(due)
            repeat.take()
        if not enough():
            self.jump(time_s)

    def repeat(self, step: Step, name: str) -> Repeat:
        """Take a step with the next wait, and whenever it is due again."""
        result = VirtualRepeat(step, self._later)
        self._later(0.0, result)
        return result

    def condition(self) -> threading.Condition:
        return VirtualCondition(self)

    def listen(self, host: str, port: int, connect: Callable[[], Port]) -> int:
        """Let a server on this clock be reached; return its port, a free one for 0."""
        taken = next(number for number in itertools.count(port or 1) if (host, number) not in self._doors)
        self._doors[host, taken] = connect
        return taken

    def forget(self, host: str, port: int) -> None:
        """Let a server be reached no more."""
        self._doors.pop((host, port), None)

    def connection(self, host: str, port: int) -> Port | None:
        """Return a way to a server on this clock; raise ConnectionRefusedError if there is none."""
        if (host, port) not in self._doors:
            raise ConnectionRefusedError("Connection refused: nothing on this clock listens there")
        return self._doors[host, port]()

    def _later(self, pause_s: float, repeat: Any) -> None:
        heapq.heappush(self._due, (self._now + pause_s, next(self._number), repeat))
