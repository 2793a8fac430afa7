"""Recorder: a thread reads the device; what it says stays at hand for a while.

::

    with Recorder(source) as recorder:              # open, first reading awaited
        start = recorder.now()                      # the host's monotonic clock
        ...                                         # a dwell
        record = recorder.between(start, recorder.now(), deadline_s=2.0)
"""

import itertools
import logging
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.clock import HOST, Clock, Repeat
from undrift.errors import InputError, LinkError, RigTimeout, UndriftError, check_positive
from undrift.live.clock import Block, ClockSettings, Timeline
from undrift.live.transports import Source
from undrift.record import Record

log = logging.getLogger(__name__)
READ_S, WAKE_S, STOP_S = 0.2, 0.2, 32.0
WAITED_S = 5e-4  # a read that took longer than this had to wait for data


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderSettings:
    """How a device is recorded."""

    silence_s: float = 5.0  # Longest host time without a good reading before the device counts as lost, s
    keep_s: float = 600.0  # Device time that ``between`` reaches back, s
    clock: ClockSettings = field(default_factory=ClockSettings)  # How the device's clock is found
    # Rest of the reader after it had to wait for a reading, host s: readings gather meanwhile, and cost less together. They
    # come so much later at most; each wait still shows when a reading came.
    gather_s: float = 0.0

    def __post_init__(self) -> None:
        check_positive(self, "recorder", "every wait has an end", "silence_s", "keep_s")
        if not 0.0 <= self.gather_s <= READ_S:
            raise InputError(
                f"recorder: wanted gather_s from 0 to {READ_S:g} s, got {self.gather_s}; readings would pile up"
            )


class Recorder:
    """Records a device from ``start`` to ``stop``; a context manager does both. One thread brings readings, any other asks."""

    def __init__(self, source: Source, settings: RecorderSettings = RecorderSettings(), clock: Clock = HOST) -> None:
        self.source, self.settings = source, settings
        self.timeline = Timeline(source.description, settings.clock)
        self._clock = clock
        self._reader: Repeat | None = None
        self._stopping, self._heard = False, clock.now()
        self._news = clock.condition()
        self._ring: deque[Block] = deque()
        self._forgotten = -np.inf  # device time up to which blocks have left the ring
        self._failure: UndriftError | None = None

    def __enter__(self) -> "Recorder":
        self.start()
        return self

    def __exit__(self, *failure: object) -> None:
        self.stop()

    def now(self) -> float:
        """Return the host's monotonic clock, s."""
        return self._clock.now()

    def start(self) -> None:
        """Open the device and wait for its first reading."""
        if self._reader is not None:
            raise InputError("recorder: wanted a fresh one, got one that was started before; make another")
        self.source.open()
        try:
            self._heard = self.now()
            self._reader = self._clock.repeat(self._read, "device-reader")
            self._wait(lambda: bool(self._ring), self.settings.silence_s + 2.0 * READ_S, "a first reading")
        except BaseException:  # Ctrl-C too: nothing is left running
            self.stop()
            raise

    def begun(self, moment: float, deadline_s: float = 5.0) -> float:
        """Wait for a reading that was certainly taken after a moment; return its device time, s. RigTimeout where none comes."""
        found: list[float] = []

        def later() -> bool:
            if self._ring and self._ring[-1].time[-1] >= self._first_after(moment):
                found.append(float(self._ring[-1].time[-1]))
            return bool(found)

        self._wait(later, deadline_s, "a reading that is certainly later than the start of a dwell")
        return found[0]

    def between(self, start: float, stop: float, deadline_s: float = 5.0, *, first: float | None = None) -> Record:
        """Return the readings in a stretch of the host's time; with a device time from `begun`, none taken before its start."""
        if not start < stop:
            raise InputError(f"readings: wanted a start before the stop, got {start:.3f} and {stop:.3f} s; swap them")
        certain = first is not None

        def complete() -> bool:
            fit = self.timeline.clock() if self._ring else None
            return fit is not None and fit.settled >= certain and fit.host_time(float(self._ring[-1].time[-1])) >= stop

        self._wait(complete, max(stop - self.now(), 0.0) + deadline_s, "readings up to the end of a dwell")
        with self._news:
            fit = self.timeline.clock()
            last = fit.device_time(stop)
            first = fit.device_time(start) if first is None else max(first, self._first_after(start))
            if first < self._forgotten:
                keep_s = self.settings.keep_s
                raise InputError(
                    f"readings: wanted those since {self.now() - start:.1f} s ago, got a recorder that keeps "
                    f"{keep_s:g} device seconds; keep more",
                    keep_s=keep_s,
                )
            blocks = [block for block in self._ring if block.time[-1] >= first and block.time[0] <= last]
        times, values = _joined(blocks)
        # in the host's time, as in `complete`: rounding there and back would leave the last one out
        inside = (times >= first) & (fit.host_zero + fit.rate * (times - fit.device_zero) <= stop)
        if (count := int(inside.sum())) >= 2:
            return self.source.description.record(times[inside], values[inside])
        if certain:
            raise RigTimeout(
                f"{self.source.name}: wanted two readings or more that are certainly later than the start of a dwell of "
                f"{stop - start:.3f} s, got {count}; the link is late: dwell longer",
                readings=count,
            )
        raise InputError(f"readings: wanted two or more in {stop - start:.3f} s, got {count}; dwell longer")

    def since(self, device_time: float = -np.inf) -> Record | None:
        """Return what has come later than a device time, without waiting; None while that is less than two readings.
        A failure is raised once all that came before it was returned."""
        with self._news:
            blocks = list(itertools.takewhile(lambda block: block.time[-1] > device_time, reversed(self._ring)))[::-1]
        times, values = _joined(blocks)
        later = times > device_time
        if int(later.sum()) >= 2:
            return self.source.description.record(times[later], values[later])
        self.check()
        return None

    def latest(self) -> str:
        """Return the newest reading in words."""
        with self._news:
            self.check()
            if not self._ring:
                raise InputError("readings: wanted the newest, got none yet; start the recorder")
            newest = self._ring[-1].values[-1].tolist()
        return "  ".join(
            f"{name} {value:.6g}" for name, value in zip(self.source.description.measured, newest, strict=True)
        )

    def check(self) -> None:
        """Raise what has gone wrong behind the scenes, if anything."""
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Stop and let go of the device; harmless when called again."""
        with self._news:
            self._stopping = True
            self._news.notify_all()
        if self._reader is not None:
            self._reader.end(STOP_S)
        self.source.close()

    def _read(self) -> float | None:
        """Read what comes; return how long to rest until the next, None after a failure."""
        began = self.now()
        try:
            chunk = self.source.read(READ_S)
        except UndriftError as error:
            if isinstance(error, RigTimeout) and self.now() - self._heard <= self.settings.silence_s:
                return 0.0
            log.info("recorder: %s", error)
            with self._news:
                self._failure = error
                self._news.notify_all()
            return None
        self._heard = self.now()
        with self._news:
            self._keep(self.timeline.add(chunk))
        return self.settings.gather_s if self._heard - began > WAITED_S else 0.0

    def _keep(self, block: Block) -> None:
        if not len(block.time):
            return
        self._ring.append(block)
        while self._ring[0].time[-1] < block.time[-1] - self.settings.keep_s:
            self._forgotten = float(self._ring.popleft().time[-1])
        self._news.notify_all()

    def _first_after(self, moment: float) -> float:
        """Return the device time that certainly lies after a moment; infinite while the clock is not settled."""
        fit, description = self.timeline.clock(), self.source.description
        # later by what 95 of 100 packets are late at most: delays that differ so much may hide as much that they share
        period_s = 1.0 / (description.rate * description.clock_speed)  # a reading may be the mean since the one before
        return fit.device_time(moment + fit.jitter_s + period_s) if fit.settled else np.inf

    def _wait(self, ready: Callable[[], bool], deadline_s: float, what: str) -> None:
        last = self.now() + deadline_s
        with self._news:
            while True:
                self.check()
                if ready():
                    return
                left = last - self.now()
                if self._stopping:
                    raise LinkError(
                        f"{self.source.name}: wanted {what}, got a recorder that was stopped; start another"
                    )
                if left <= 0.0:
                    behind = bool(self._ring) and not self.timeline.clock().settled
                    got = "a backlog; wait, or check the stated rate" if behind else "none; check that the device sends"
                    raise RigTimeout(
                        f"{self.source.name}: wanted {what} within {deadline_s:g} s, got {got}", deadline_s=deadline_s
                    )
                self._news.wait(min(left, WAKE_S))


def _joined(blocks: Sequence[Block]) -> tuple[FloatArray, FloatArray]:
    """Return device times (N,) and values (N, C) of blocks of the ring, one after the other."""
    times, values = [np.empty(0), *(block.time for block in blocks)], [block.values for block in blocks]
    return np.concatenate(times), np.concatenate(values) if values else np.empty((0, 0))


class DwellReadings:
    """Readings of a recorder that has been started, dwell by dwell; none that the device took before ``start``, unless asked."""

    def __init__(self, recorder: Recorder, deadline_s: float = 5.0) -> None:
        self.recorder = recorder
        self._deadline_s = deadline_s
        self._start: float | None = None
        self._first: float | None = None  # by the device's clock, where that is certain
        self._end: float | None = None

    def start(self, *, certain: bool = True) -> None:
        """Begin a dwell now."""
        self.recorder.check()
        start = self.recorder.now()
        self._first = self.recorder.begun(start, self._deadline_s) if certain else None
        self._start, self._end = start, None

    def end(self) -> None:
        """Let the dwell end now, whenever ``stop`` is called."""
        self._end = self.recorder.now()

    def stop(self) -> Record:
        """Return the readings since ``start``."""
        if self._start is None:
            raise InputError("dwell: wanted one that was started, got none; start it first")
        start, self._start = self._start, None
        stop = self.recorder.now() if self._end is None else self._end
        return self.recorder.between(start, stop, self._deadline_s, first=self._first)

    def latest(self) -> str:
        """Return the newest reading in words."""
        return self.recorder.latest()

    def close(self) -> None:
        """Stop the recorder; harmless when called again."""
        self.recorder.stop()
