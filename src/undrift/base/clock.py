"""Time: the host's clock, and virtual ones that jump to what happens next, as fast as the host can or at a pace.

Whoever waits asks a clock: drivers, links, simulated benches and runs. On the host's clock a wait sleeps and what goes on beside
it has threads. On a virtual clock one thread does everything: a wait carries out what is due meanwhile, in the order of its time,
and then it is later. So a soak of hours takes as long as its computing does, and nothing depends on how busy the host is.

    clock.wait(3.0)                          beside it, what is due
    clock.until(lambda: rig.idle, 10.0)      polls
    clock.repeat(beat, "heartbeat")          beat() says after how many seconds it is due again; None ends it
"""

import heapq
import itertools
import math
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

from undrift.errors import InputError

T = TypeVar("T")
Step = Callable[[], float | None]  # does some work; seconds until the next, None for no more
POLL_S = 0.02


class Port(Protocol):
    """A way for bytes; OSError or EOFError when it is gone."""

    datagrams: bool  # Whether what is received at once is whole

    def receive(self, wait_s: float) -> bytes:
        """Return what has come, b"" where nothing came in time."""

    def write(self, data: bytes) -> None:
        """Send all of it."""

    def wake(self) -> None:
        """Wake up a read that is blocked in another thread."""

    def close(self) -> None:
        """Close it."""


class Repeat:
    """A thread that takes a step again and again."""

    def __init__(self, step: Step, name: str, speed: float) -> None:
        self._step, self._speed = step, speed
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def end(self, longest_s: float | None = None) -> None:
        """Take no further step, and wait for the one under way, host s; harmless when called again."""
        self._ended.set()
        if self._thread is not threading.current_thread():
            self._thread.join(longest_s)

    def _run(self) -> None:
        pause: float | None = 0.0
        while pause is not None and not self._ended.wait(pause / self._speed):
            pause = self._step()


class Clock:
    """The host's monotonic clock times a speed."""

    def __init__(self, speed: float = 1.0, *, zero_s: float = 0.0) -> None:
        if not 0.0 < speed < 1e6:
            raise InputError(f"clock: wanted a speed above 0, got {speed:g}; hardware runs at 1")
        self.speed = speed  # seconds of this clock in one of the host's: 1 for hardware, that of a simulation otherwise
        self._zero_s = zero_s

    @classmethod
    def started(cls, speed: float = 1.0) -> "Clock":
        """Return a clock that shows 0 now."""
        return cls(speed, zero_s=time.monotonic())

    @property
    def host(self) -> "Clock":
        """The same clock in seconds of the host, for time-outs of links and processes."""
        return self if self.speed == 1.0 else HOST

    def now(self) -> float:
        """Return the time, s; only differences count."""
        return self.speed * (time.monotonic() - self._zero_s)

    def wait(self, duration_s: float) -> None:
        """Wait."""
        if duration_s > 0.0:
            time.sleep(duration_s / self.speed)

    def until(self, ask: Callable[[], T], within_s: float, every_s: float = POLL_S) -> T | None:
        """Ask until the answer is true, and return it; None where it is not in time."""
        last = self.now() + within_s
        while not (answer := ask()):
            if self.now() >= last:
                return None
            self.wait(every_s)
        return answer

    def repeat(self, step: Step, name: str) -> Repeat:
        """Take a step now and whenever it is due again, beside whatever else goes on."""
        return Repeat(step, name, self.speed)

    def condition(self) -> threading.Condition:
        """Return a condition whose waits take this clock's time."""
        return threading.Condition()

    def connection(self, host: str, port: int) -> Port | None:
        """Return a way to a server on this clock, or None if servers are reached by sockets."""
        return None


HOST = Clock()


# ---- A clock on which no time passes but what is waited for.


class VirtualRepeat(Repeat):
    """A step that a virtual clock takes when it is due."""

    def __init__(self, step: Step, due: Callable[[float, "VirtualRepeat"], None]) -> None:
        self.ended, self._step, self._due = False, step, due

    def end(self, longest_s: float | None = None) -> None:
        """Take no further step."""
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
        """Let who waits go on."""
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
        """Return the time, s."""
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
        made = VirtualRepeat(step, self._later)
        self._later(0.0, made)
        return made

    def condition(self) -> threading.Condition:
        """Return a condition whose waits take this clock's time."""
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


class PacedClock(VirtualClock):
    """The time of a simulation: it passes while someone waits alone, and no faster than so many seconds in one of the host's."""

    def __init__(self, pace: float = math.inf) -> None:
        super().__init__()
        self._pace = pace

    def wait(self, duration_s: float) -> None:
        """Let it be later, and have the host wait as long."""
        if duration_s > 0.0 and math.isfinite(self._pace):  # a sleep of 0 s still takes a millisecond of a busy host
            time.sleep(duration_s / self._pace)
        super().wait(duration_s)
