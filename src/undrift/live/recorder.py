"""Recorder: a thread reads the device and stores its latest readings.

::

    with Recorder(source) as recorder:              # open the device and wait for its first reading
        start = recorder.now()                      # host's monotonic clock
        ...                                         # a dwell
        record = recorder.between(start, recorder.now(), deadline_s=2.0)
"""

import itertools
import logging
from collections import deque
from collections.abc import Callable, Iterable

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.clock import HOST, Clock, Repeat
from undrift.errors import InputError, LinkError, RigTimeout, UndriftError
from undrift.live.clock import Block, Timeline
from undrift.live.transports import Source
from undrift.record import Record

log = logging.getLogger(__name__)
READ_S, WAKE_S, STOP_S = 0.2, 0.2, 32.0


class Recorder:
    """Recorder of a device from ``start`` to ``stop``, also a context manager. A thread reads, and any thread may ask.

    A device without a valid reading for `silence_s` host seconds is lost. Readings are stored for `keep_s` device seconds.
    """

    def __init__(self, source: Source, *, silence_s: float = 5.0, keep_s: float = 600.0, clock: Clock = HOST) -> None:
        self.source, self._silence_s, self._keep_s = source, silence_s, keep_s
        self.timeline = Timeline(source.description)
        self._clock = clock
        self._reader: Repeat | None = None
        self._stopping, self._heard = False, clock.now()
        self._news = clock.condition()
        self._ring: deque[Block] = deque()
        self._forgotten = -np.inf  # device time up to which readings were removed, s
        self._failure: UndriftError | None = None

    def __enter__(self) -> "Recorder":
        self.start()
        return self

    def __exit__(self, *failure: object) -> None:
        self.stop()

    def now(self) -> float:
        """Return the time of the host's monotonic clock, s."""
        return self._clock.now()

    def start(self) -> None:
        """Open the device and wait for its first reading."""
        if self._reader is not None:
            raise InputError("recorder: it was started before. Create a new recorder.")
        self.source.open()
        try:
            self._heard = self.now()
            self._reader = self._clock.repeat(self._read, "device-reader")
            self._wait(lambda: bool(self._ring), self._silence_s + 2.0 * READ_S, "a first reading")
        except BaseException:  # includes Ctrl-C, so that no thread remains
            self.stop()
            raise

    def begun(self, moment: float, deadline_s: float = 5.0) -> float:
        """Wait for a reading that was certainly taken after a host time, s, and return its device time, s.

        RigTimeout is raised if no such reading arrives.
        """
        self._wait(
            lambda: bool(self._ring) and self._newest() >= self._first_after(moment),
            deadline_s,
            "a reading that is certainly later than the start of a dwell",
        )
        return self._newest()

    def between(self, start: float, stop: float, deadline_s: float = 5.0, *, first: float = -np.inf) -> Record:
        """Return the readings that were certainly taken between two host times, s. `first` is a device time from `begun`."""
        if not start < stop:
            raise InputError(f"readings: start must be before stop, got {start:.3f} and {stop:.3f} s. Swap them.")

        def is_complete() -> bool:
            fit = self.timeline.clock() if self._ring else None
            return fit is not None and fit.settled and fit.host_time(self._newest()) >= stop

        self._wait(is_complete, max(stop - self.now(), 0.0) + deadline_s, "readings up to the end of a dwell")
        with self._news:
            fit, first = self.timeline.clock(), max(first, self._first_after(start))
            if first < self._forgotten:
                raise InputError(
                    f"readings: the start was {self.now() - start:.1f} s ago, but the recorder stores only "
                    f"{self._keep_s:g} device seconds. Increase keep_s.",
                    keep_s=self._keep_s,
                )
            times, values = _joined(self._ring)
        # compared in host time, as in `is_complete`, because conversion with rounding could omit the last reading
        inside = (times >= first) & (fit.host_zero + fit.rate * (times - fit.device_zero) <= stop)
        if (count := int(inside.sum())) < 2:
            raise RigTimeout(
                f"{self.source.name}: at least two readings must be certainly later than the start of a dwell of "
                f"{stop - start:.3f} s, got {count}. The link is late. Use a longer dwell.",
                readings=count,
            )
        return self.source.description.record(times[inside], values[inside])

    def since(self, device_time: float = -np.inf) -> Record | None:
        """Return the readings after a device time, s, without waiting, or None if there are fewer than two.

        A failure is raised after all readings before it were returned.
        """
        with self._news:
            blocks = list(itertools.takewhile(lambda block: block.time[-1] > device_time, reversed(self._ring)))[::-1]
        times, values = _joined(blocks) if blocks else (np.empty(0), np.empty((0, 0)))
        later = times > device_time
        if int(later.sum()) >= 2:
            return self.source.description.record(times[later], values[later])
        self.check()
        return None

    def latest(self) -> str:
        """Return the latest reading as text."""
        with self._news:
            self.check()
            if not self._ring:
                raise InputError("readings: no reading yet. Start the recorder.")
            return self.source.description.text_of(self._ring[-1].values[-1])

    def check(self) -> None:
        """Raise the error of the reading thread, if it has failed."""
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Stop recording and close the device. A second call has no effect."""
        with self._news:
            self._stopping = True
            self._news.notify_all()
        if self._reader is not None:
            self._reader.end(STOP_S)
        self.source.close()

    def _read(self) -> float | None:
        """Read the device once. Return the pause until the next read, host s, or None after a failure."""
        try:
            chunk = self.source.read(READ_S)
            if chunk is None and self.now() - self._heard > self._silence_s:
                raise RigTimeout(
                    f"{self.source.name}: no reading within {self._silence_s:g} s, got {self.source.received_instead()}. Check "
                    "that the device sends.",
                    deadline_s=self._silence_s,
                )
        except UndriftError as error:
            log.info("recorder: %s", error)
            with self._news:
                self._failure = error
                self._news.notify_all()
            return None
        if chunk is not None:
            self._heard = self.now()
            with self._news:
                block = self.timeline.add(chunk)
                if len(block.time):
                    self._ring.append(block)
                    while self._ring[0].time[-1] < self._newest() - self._keep_s:
                        self._forgotten = float(self._ring.popleft().time[-1])
                    self._news.notify_all()
        return 0.0

    def _newest(self) -> float:
        return float(self._ring[-1].time[-1])

    def _first_after(self, moment: float) -> float:
        """Return the device time that is certainly after a host time, s. It is infinite until the clock is settled."""
        fit, description = self.timeline.clock(), self.source.description
        # later by the 95 % quantile of the delays, because a common delay of that size cannot be excluded
        period_s = 1.0 / (description.rate * description.clock_speed)  # a reading may be a mean over a period
        return fit.device_time(moment + fit.jitter_s + period_s) if fit.settled else np.inf

    def _wait(self, ready: Callable[[], bool], deadline_s: float, what: str) -> None:
        last = self.now() + deadline_s
        with self._news:
            while True:
                self.check()
                if ready():
                    return
                left_s = last - self.now()
                if self._stopping:
                    raise LinkError(
                        f"{self.source.name}: the recorder was stopped while waiting for {what}. Start another recorder."
                    )
                if left_s <= 0.0:
                    behind = bool(self._ring) and not self.timeline.clock().settled
                    cause = "a backlog. Wait, or check the rate" if behind else "none. Check that the device sends"
                    raise RigTimeout(
                        f"{self.source.name}: expected {what} within {deadline_s:g} s, got {cause}.",
                        deadline_s=deadline_s,
                    )
                self._news.wait(min(left_s, WAKE_S))


def _joined(blocks: Iterable[Block]) -> tuple[FloatArray, FloatArray]:
    """Return device times (N,) and values (N, C) of successive blocks."""
    times, values = zip(*((block.time, block.values) for block in blocks), strict=True)
    return np.concatenate(times), np.concatenate(values)


class DwellReadings:
    """Readings of a started recorder, dwell by dwell. Readings before ``start`` are excluded."""

    def __init__(self, recorder: Recorder, deadline_s: float = 5.0) -> None:
        self.recorder = recorder
        self._deadline_s = deadline_s
        self._start: tuple[float, float] | None = None  # start, host s, and first certain reading, device s
        self._end: float | None = None

    def start(self) -> None:
        """Start a dwell now, and wait for a reading that is certainly after the start."""
        start = self.recorder.now()
        self._start, self._end = (start, self.recorder.begun(start, self._deadline_s)), None

    def end(self) -> None:
        """End the dwell now, independent of the time of ``stop``."""
        self._end = self.recorder.now()

    def stop(self) -> Record:
        """Return the readings since ``start``."""
        if self._start is None:
            raise InputError("dwell: no dwell was started. Start it first.")
        (start, first), self._start = self._start, None
        stop = self.recorder.now() if self._end is None else self._end
        return self.recorder.between(start, stop, self._deadline_s, first=first)

    def latest(self) -> str:
        """Return the latest reading as text."""
        return self.recorder.latest()

    def close(self) -> None:
        """Stop the recorder. A second call has no effect."""
        self.recorder.stop()
