"""Recent: the readings of the last minutes, for whoever waits for them; one thread brings them, any other asks."""

import threading
import time
from collections import deque
from collections.abc import Callable

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError, LinkError, RigTimeout, UndriftError
from undrift.live.chunk import Chunk
from undrift.live.clock import ClockFit, ClockSettings
from undrift.live.description import StreamDescription
from undrift.live.timeline import Block, Timeline

WAKE_S = 0.2


class Recent:
    """Readings at hand.

    Parameters
    ----------
    name : str
        What to call the device in a message.
    description : StreamDescription
        What it sends.
    keep_s : float
        Device time that is kept, s.
    clock : ClockSettings
        How the device's clock is found.
    """

    def __init__(self, name: str, description: StreamDescription, keep_s: float, clock: ClockSettings) -> None:
        self.timeline = Timeline(description, clock)
        self._name, self._keep_s = name, keep_s
        self._news = threading.Condition()
        self._ring: deque[Block] = deque()
        self._forgotten = -np.inf  # device time up to which blocks have left the ring
        self._failure: UndriftError | None = None
        self._ended = False

    def place(self, chunk: Chunk) -> Block:
        """Put a chunk on the device's clock.

        Parameters
        ----------
        chunk : Chunk
            The next of the stream.

        Returns
        -------
        Block
            May be empty.
        """
        with self._news:
            return self.timeline.add(chunk)

    def keep(self, block: Block) -> None:
        """Keep a block and wake who waits.

        Parameters
        ----------
        block : Block
            Not empty.
        """
        with self._news:
            self._ring.append(block)
            while self._ring[0].time[-1] < block.time[-1] - self._keep_s:
                self._forgotten = float(self._ring.popleft().time[-1])
            self._news.notify_all()

    def fail(self, error: UndriftError) -> None:
        """Have everybody who asks from now on told of an error.

        Parameters
        ----------
        error : UndriftError
            Raised where they ask.
        """
        with self._news:
            self._failure = error
            self._news.notify_all()

    @property
    def failed(self) -> bool:
        """Whether an error is told to everybody who asks."""
        return self._failure is not None

    def end(self) -> None:
        """Let nobody wait any longer."""
        with self._news:
            self._ended = True
            self._news.notify_all()

    def check(self) -> None:
        """Raise what has failed, if anything."""
        if self._failure is not None:
            raise self._failure

    def clock(self) -> ClockFit | None:
        """Return the device's clock on the host's.

        Returns
        -------
        ClockFit or None
            None before the first reading.
        """
        with self._news:
            return self.timeline.clock() if self.timeline.readings else None

    def latest(self) -> FloatArray:
        """Return the newest reading, raw, shape (C,); InputError before the first."""
        with self._news:
            self.check()
            if not self._ring:
                raise InputError("readings: wanted the newest, got none yet; start the recorder")
            newest: FloatArray = self._ring[-1].values[-1].copy()
            return newest

    def wait_for_first(self, deadline_s: float) -> None:
        """Wait for a first reading.

        Parameters
        ----------
        deadline_s : float
            Longest wait, host s.

        Raises
        ------
        RigTimeout
            None came.
        """
        self._wait(lambda: bool(self._ring), deadline_s, "a first reading")

    def begun(self, moment: float, deadline_s: float) -> float:
        """Wait for a reading that was certainly taken after a moment; return its device time, s, as ``Recorder.begun`` does.

        Parameters
        ----------
        moment : float
            The host's monotonic clock, s.
        deadline_s : float
            Longest wait, host s.
        """
        found: list[float] = []

        def later() -> bool:
            if self._ring and self._ring[-1].time[-1] >= self._first_after(moment):
                found.append(float(self._ring[-1].time[-1]))
            return bool(found)

        self._wait(later, deadline_s, "a reading that is certainly later than the start of a dwell")
        return found[0]

    def _first_after(self, moment: float) -> float:
        """Return the device time that certainly lies after a moment; infinite while the clock is not settled."""
        fit, description = self.timeline.clock(), self.timeline.description
        # later by what 95 of 100 packets are late at most: delays that differ so much may hide as much that they share
        period_s = 1.0 / (description.rate * description.clock_speed)  # a reading may be the mean since the one before
        return fit.device_time(moment + fit.jitter_s + period_s) if fit.settled else np.inf

    def between(
        self, start: float, stop: float, deadline_s: float, first: float | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return device times, shape (N,), and raw values, (N, C), as ``Recorder.between`` does.

        Parameters
        ----------
        start, stop : float
            The host's monotonic clock, s.
        deadline_s : float
            Longest wait beyond ``stop``, host s.
        first : float or None
            Device time from which readings are wanted, as ``begun`` returned it for ``start``, s.
        """
        if not start < stop:
            raise InputError(f"readings: wanted a start before the stop, got {start:.3f} and {stop:.3f} s; swap them")

        def complete() -> bool:
            fit = self.timeline.clock() if self._ring else None
            return fit is not None and fit.settled >= certain and fit.host_time(float(self._ring[-1].time[-1])) >= stop

        certain = first is not None

        self._wait(complete, max(stop - time.monotonic(), 0.0) + deadline_s, "readings up to the end of a dwell")
        with self._news:
            fit = self.timeline.clock()
            last = fit.device_time(stop)
            first = fit.device_time(start) if first is None else max(first, self._first_after(start))
            if first < self._forgotten:
                raise InputError(
                    f"readings: wanted those since {time.monotonic() - start:.1f} s ago, got a recorder that keeps "
                    f"{self._keep_s:g} device seconds; keep more",
                    keep_s=self._keep_s,
                )
            blocks = [block for block in self._ring if block.time[-1] >= first and block.time[0] <= last]
        times = np.concatenate([block.time for block in blocks]) if blocks else np.empty(0)
        inside = (times >= first) & (times <= last)
        if inside.sum() < 2:
            count = int(inside.sum())
            if certain:
                raise RigTimeout(
                    f"{self._name}: wanted two readings or more that are certainly later than the start of a dwell of "
                    f"{stop - start:.3f} s, got {count}; the link is late: dwell longer",
                    readings=count,
                )
            raise InputError(f"readings: wanted two or more in {stop - start:.3f} s, got {count}; dwell longer")
        return times[inside], np.concatenate([block.values for block in blocks])[inside]

    def _wait(self, ready: Callable[[], bool], deadline_s: float, what: str) -> None:
        last = time.monotonic() + deadline_s
        with self._news:
            while True:
                self.check()
                if ready():
                    return
                left = last - time.monotonic()
                if self._ended:
                    raise LinkError(f"{self._name}: wanted {what}, got a recorder that was stopped; start another")
                if left <= 0.0:
                    behind = bool(self._ring) and not self.timeline.clock().settled
                    got = "a backlog; wait, or check the stated rate" if behind else "none; check that the device sends"
                    raise RigTimeout(
                        f"{self._name}: wanted {what} within {deadline_s:g} s, got {got}",
                        deadline_s=deadline_s,
                    )
                self._news.wait(min(left, WAKE_S))
