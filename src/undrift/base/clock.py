"""Time: the clock of the host, and the clock of a simulation, on which time passes only during a wait.

Drivers, links, benches and runs ask a clock for the time and wait on it. On the simulation's clock, a soak of hours takes only as
long as its computation.

    clock.wait(3.0)
    clock.until(lambda: rig.idle, 10.0)      polls
    clock.repeat(beat, "heartbeat")          a thread; beat() returns the seconds until its next call, None to end
"""

import math
import threading
import time
from collections.abc import Callable
from typing import Protocol, TypeVar

from undrift.errors import InputError

T = TypeVar("T")
Step = Callable[[], float | None]  # works and returns the seconds until its next call, or None to end
POLL_S = 0.02


class Port(Protocol):
    """A byte connection. Its methods raise OSError or EOFError if the connection is lost."""

    datagrams: bool  # True if each receive returns one complete message

    def receive(self, wait_s: float) -> bytes:
        """Return the received bytes, or b"" if nothing arrives in time."""

    def write(self, data: bytes) -> None:
        """Send all bytes."""

    def close(self) -> None:
        """Close it."""


class Repeat:
    """A thread that repeats a step."""

    def __init__(self, step: Step, name: str, speed: float) -> None:
        self._step, self._speed = step, speed
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def end(self, longest_s: float | None = None) -> None:
        """Start no further step, and wait for the current one, at most ``longest_s`` seconds of the host. Safe to call again."""
        self._ended.set()
        if self._thread is not threading.current_thread():
            self._thread.join(longest_s)

    def _run(self) -> None:
        pause: float | None = 0.0
        while pause is not None and not self._ended.wait(pause / self._speed):
            pause = self._step()


class Clock:
    """The host's monotonic clock, multiplied by a speed."""

    def __init__(self, speed: float = 1.0, *, zero_s: float = 0.0) -> None:
        if not 0.0 < speed < 1e6:
            raise InputError(f"clock: expected a speed above 0, got {speed:g}. Use 1 for hardware.")
        self.speed = speed  # seconds of this clock per second of the host (1 for hardware)
        self._zero_s = zero_s

    @classmethod
    def started(cls, speed: float = 1.0) -> "Clock":
        """Return a clock that starts at 0 now."""
        return cls(speed, zero_s=time.monotonic())

    def now(self) -> float:
        """Return the time, s. Only differences are meaningful."""
        return self.speed * (time.monotonic() - self._zero_s)

    def wait(self, duration_s: float) -> None:
        """Wait."""
        if duration_s > 0.0:
            time.sleep(duration_s / self.speed)

    def until(self, ask: Callable[[], T], within_s: float, every_s: float = POLL_S) -> T | None:
        """Poll until the answer is true, and return it. Return None after ``within_s`` seconds."""
        last = self.now() + within_s
        while not (answer := ask()):
            if self.now() >= last:
                return None
            self.wait(every_s)
        return answer

    def repeat(self, step: Step, name: str) -> Repeat:
        """Run a step now, and again whenever it is due, in a separate thread."""
        return Repeat(step, name, self.speed)

    def condition(self) -> threading.Condition:
        """Return a condition variable whose waits use this clock's time."""
        return threading.Condition()

    def connection(self, host: str, port: int) -> Port | None:
        """Return a connection to a server on this clock, or None if servers are reached with sockets."""
        return None


HOST = Clock()


class PacedClock(Clock):
    """The clock of a simulation: time passes only during a wait, at most ``pace`` seconds per second of the host."""

    def __init__(self, pace: float = math.inf) -> None:
        super().__init__()
        self._now, self._pace = 0.0, pace

    def now(self) -> float:
        """Return the time, s."""
        return self._now

    def wait(self, duration_s: float) -> None:
        """Advance the time, and sleep if there is a pace."""
        if duration_s > 0.0 and math.isfinite(self._pace):  # a sleep of 0 s still takes a millisecond of a busy host
            time.sleep(duration_s / self._pace)
        self._now += max(duration_s, 0.0)
