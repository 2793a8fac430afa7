"""Recorder: a thread reads the device; what it says goes to the disk, and stays at hand for a while.

::

    with Recorder(source, folder) as recorder:      # open, first reading awaited
        start = recorder.now()                      # the host's monotonic clock
        ...                                         # a dwell
        record = recorder.between(start, recorder.now(), deadline_s=2.0)

A second thread puts blocks on the disk as pieces, each whole and synced before it counts: ``live-01-00001.parquet`` is the first of
the first connection recorded into a folder; one that was under way when the power went ends with ``.part`` and is never read. A
full queue makes the reader wait, never lose: the sender's socket then fills, and TCP makes the sender wait too.
"""

import contextlib
import logging
import os
import queue
import re
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError, LinkError, RigTimeout, UndriftError
from undrift.io.parquet import write_parquet
from undrift.live.clock import Block, ClockFit, ClockSettings, Timeline
from undrift.live.decoder import StreamDescription
from undrift.live.transports import Source
from undrift.record import Record

log = logging.getLogger(__name__)

# ---- Pieces on the disk.

NAME = re.compile(r"live-(\d{2,})-(\d{5,})\.parquet")
QUEUE_BLOCKS = 4096
KEPT_ROWS = 2  # stay behind for the next piece, so that the last one is a record of two rows at least


def write_synced(record: Record, path: Path) -> None:
    """Write a record so that it survives a power cut once this returns."""
    part = path.with_name(path.name + ".new.part")
    try:
        write_parquet(record, part)
        _sync(part)
        part.replace(path)
        _sync(path.parent)
    except OSError as error:
        part.unlink(missing_ok=True)
        reason = error.strerror or str(error)
        raise InputError(f"{path}: wanted to write readings, got '{reason}'; free the disk or the folder") from error


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def next_connection(folder: Path) -> int:
    """Return the number of the next connection to be recorded into a folder."""
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
    return max((int(found.group(1)) for found in map(NAME.fullmatch, names) if found), default=0) + 1


def piece_path(folder: Path, connection: int, piece: int) -> Path:
    """Return where a piece is written."""
    return folder / f"live-{connection:02d}-{piece:05d}.parquet"


class PieceWriter:
    """Writes blocks until stopped."""

    def __init__(self, folder: Path, description: StreamDescription, rows: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.connection = folder, next_connection(folder)
        self.pieces = self.rows = 0
        self.failure: UndriftError | None = None
        self._description = description
        self._wanted = max(rows, 2 * KEPT_ROWS)
        self._queue: queue.Queue[Block | None] = queue.Queue(QUEUE_BLOCKS)
        self._held: list[Block] = []
        self._count = 0
        self._thread = threading.Thread(target=self._run, name="piece-writer", daemon=True)
        self._thread.start()

    def put(self, block: Block, deadline_s: float) -> None:
        """Hand over a block."""
        if self.failure is not None:
            raise self.failure
        try:
            self._queue.put(block, timeout=deadline_s)
        except queue.Full as error:
            raise RigTimeout(
                f"{self.folder}: wanted room for readings within {deadline_s:g} s, got a disk that does not keep up; "
                "use a faster one",
                deadline_s=deadline_s,
            ) from error

    def stop(self, deadline_s: float) -> None:
        """Write what is left and end the thread; harmless when called again."""
        if self._thread.is_alive():
            with contextlib.suppress(queue.Full):  # reported below
                self._queue.put(None, timeout=deadline_s)
            self._thread.join(deadline_s)
        if self._thread.is_alive():
            raise LinkError(
                f"{self.folder}: wanted the last readings written in {deadline_s:g} s, got no end; check the disk"
            )

    def _run(self) -> None:
        while (block := self._queue.get()) is not None:
            if self.failure is not None:
                continue  # the queue must not fill up
            self._held.append(block)
            self._count += len(block.time)
            if self._count >= self._wanted:
                self._write(keep=KEPT_ROWS)
        if self.failure is None and self._count >= KEPT_ROWS:
            self._write(keep=0)

    def _write(self, keep: int) -> None:
        time: FloatArray = np.concatenate([block.time for block in self._held])
        values: FloatArray = np.concatenate([block.values for block in self._held])
        cut = len(time) - keep
        path = piece_path(self.folder, self.connection, self.pieces + 1)
        try:
            write_synced(self._description.record(time[:cut], values[:cut]), path)
        except UndriftError as error:
            self.failure = error
            return
        self.pieces, self.rows = self.pieces + 1, self.rows + cut
        self._held = [Block(time[cut:], values[cut:])]
        self._count = keep


# ---- recorder


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderSettings:
    """How a device is recorded."""

    silence_s: float = 5.0  # Longest host time without a good reading before the device counts as lost, s
    keep_s: float = 600.0  # Device time that ``between`` reaches back, s
    piece_s: float = 10.0  # Device time in a piece on the disk, s
    disk_s: float = 30.0  # Longest wait for the disk, s
    clock: ClockSettings = field(default_factory=ClockSettings)  # How the device's clock is found

    def __post_init__(self) -> None:
        for name in ("silence_s", "keep_s", "piece_s", "disk_s"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"recorder: wanted {name} above 0, got {getattr(self, name)}; every wait has an end")


@dataclass(frozen=True, slots=True, kw_only=True)
class Tally:
    """What became of a recording."""

    readings: int  # Good ones
    written: int  # Rows on the disk, those of gaps among them; 0 without a folder
    pieces: int  # Files
    missing: int  # Readings that never came, and stretches of such
    gaps: int
    garbled: int  # Readings left out: spoilt, and late or double
    late: int
    restarts: int  # Times that the device began to count anew
    clock: ClockFit | None  # The device's clock on the host's; None before the first reading


READ_S, WAKE_S = 0.2, 0.2


class Recorder:
    """Records a device from ``start`` to ``stop``; a context manager does both. One thread brings readings, any other asks."""

    def __init__(
        self, source: Source, folder: Path | str | None = None, settings: RecorderSettings = RecorderSettings()
    ) -> None:
        self.source, self.settings = source, settings
        self._folder = None if folder is None else Path(folder)
        self._timeline = Timeline(source.description, settings.clock)
        self._writer: PieceWriter | None = None
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._news = threading.Condition()
        self._ring: deque[Block] = deque()
        self._forgotten = -np.inf  # device time up to which blocks have left the ring
        self._failure: UndriftError | None = None

    def __enter__(self) -> "Recorder":
        self.start()
        return self

    def __exit__(self, *failure: object) -> None:
        self.stop()

    @staticmethod
    def now() -> float:
        """Return the host's monotonic clock, s."""
        return time.monotonic()

    def start(self) -> None:
        """Open the device and wait for its first reading."""
        if self._thread is not None:
            raise InputError("recorder: wanted a fresh one, got one that was started before; make another")
        self.source.open()
        try:
            self._writer = self._open_writer()
            self._thread = threading.Thread(target=self._run, name="device-reader", daemon=True)
            self._thread.start()
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
            fit = self._timeline.clock() if self._ring else None
            return fit is not None and fit.settled >= certain and fit.host_time(float(self._ring[-1].time[-1])) >= stop

        self._wait(complete, max(stop - time.monotonic(), 0.0) + deadline_s, "readings up to the end of a dwell")
        with self._news:
            fit = self._timeline.clock()
            last = fit.device_time(stop)
            first = fit.device_time(start) if first is None else max(first, self._first_after(start))
            if first < self._forgotten:
                keep_s = self.settings.keep_s
                raise InputError(
                    f"readings: wanted those since {time.monotonic() - start:.1f} s ago, got a recorder that keeps "
                    f"{keep_s:g} device seconds; keep more",
                    keep_s=keep_s,
                )
            blocks = [block for block in self._ring if block.time[-1] >= first and block.time[0] <= last]
        times = np.concatenate([block.time for block in blocks]) if blocks else np.empty(0)
        inside = (times >= first) & (times <= last)
        if (count := int(inside.sum())) >= 2:
            values = np.concatenate([block.values for block in blocks])
            return self.source.description.record(times[inside], values[inside])
        if certain:
            raise RigTimeout(
                f"{self.source.name}: wanted two readings or more that are certainly later than the start of a dwell of "
                f"{stop - start:.3f} s, got {count}; the link is late: dwell longer",
                readings=count,
            )
        raise InputError(f"readings: wanted two or more in {stop - start:.3f} s, got {count}; dwell longer")

    def latest(self) -> FloatArray:
        """Return the newest reading for display: raw, shape (C,), in the order of ``source.description.measured``."""
        with self._news:
            self.check()
            if not self._ring:
                raise InputError("readings: wanted the newest, got none yet; start the recorder")
            newest: FloatArray = self._ring[-1].values[-1].copy()
            return newest

    def check(self) -> None:
        """Raise what has gone wrong behind the scenes, if anything."""
        if self._failure is not None:
            raise self._failure

    def tally(self) -> Tally:
        """Return what became of the recording so far."""
        line, writer = self._timeline, self._writer
        with self._news:
            clock = line.clock() if line.readings else None
        return Tally(
            readings=line.readings,
            written=writer.rows if writer else 0,
            pieces=writer.pieces if writer else 0,
            missing=line.marker.missing,
            gaps=line.marker.gaps,
            garbled=self.source.errors,
            late=line.counter.late,
            restarts=line.counter.restarts,
            clock=clock,
        )

    def stop(self) -> Tally:
        """Stop, write what is left, let go of the device; harmless when called again."""
        with self._news:
            self._stopping.set()
            self._news.notify_all()
        if self._thread is not None:
            self._thread.join(self.settings.disk_s + 2.0)
        self.source.close()
        if self._writer is not None:
            self._writer.stop(self.settings.disk_s)
            if self._writer.failure is not None and self._failure is None:  # the last piece: nobody knows yet
                self._failure = self._writer.failure
                raise self._failure
        return self.tally()

    def _open_writer(self) -> PieceWriter | None:
        if self._folder is None:
            return None
        rows = round(self.settings.piece_s * self.source.description.rate)
        try:
            return PieceWriter(self._folder, self.source.description, rows)
        except OSError as error:
            raise InputError(f"{self._folder}: wanted a folder, got '{error.strerror}'; choose another") from error

    def _run(self) -> None:
        heard = time.monotonic()
        try:
            while not self._stopping.is_set():
                try:
                    chunk = self.source.read(READ_S)
                except RigTimeout:
                    if time.monotonic() - heard > self.settings.silence_s:
                        raise
                    continue
                heard = time.monotonic()
                with self._news:
                    block = self._timeline.add(chunk)
                if len(block.time):
                    if self._writer is not None:
                        self._writer.put(block, self.settings.disk_s)
                    self._keep(block)
        except UndriftError as error:
            log.info("recorder: %s", error)
            with self._news:
                self._failure = error
                self._news.notify_all()

    def _keep(self, block: Block) -> None:
        with self._news:
            self._ring.append(block)
            while self._ring[0].time[-1] < block.time[-1] - self.settings.keep_s:
                self._forgotten = float(self._ring.popleft().time[-1])
            self._news.notify_all()

    def _first_after(self, moment: float) -> float:
        """Return the device time that certainly lies after a moment; infinite while the clock is not settled."""
        fit, description = self._timeline.clock(), self.source.description
        # later by what 95 of 100 packets are late at most: delays that differ so much may hide as much that they share
        period_s = 1.0 / (description.rate * description.clock_speed)  # a reading may be the mean since the one before
        return fit.device_time(moment + fit.jitter_s + period_s) if fit.settled else np.inf

    def _wait(self, ready: Callable[[], bool], deadline_s: float, what: str) -> None:
        last = time.monotonic() + deadline_s
        with self._news:
            while True:
                self.check()
                if ready():
                    return
                left = last - time.monotonic()
                if self._stopping.is_set():
                    raise LinkError(
                        f"{self.source.name}: wanted {what}, got a recorder that was stopped; start another"
                    )
                if left <= 0.0:
                    behind = bool(self._ring) and not self._timeline.clock().settled
                    got = "a backlog; wait, or check the stated rate" if behind else "none; check that the device sends"
                    raise RigTimeout(
                        f"{self.source.name}: wanted {what} within {deadline_s:g} s, got {got}", deadline_s=deadline_s
                    )
                self._news.wait(min(left, WAKE_S))


class DwellReadings:
    """Readings of a recorder that has been started, dwell by dwell; none that the device took before ``start``, unless asked."""

    def __init__(self, recorder: Recorder, deadline_s: float = 5.0) -> None:
        self.recorder = recorder
        self._deadline_s = deadline_s
        self._start: float | None = None
        self._first: float | None = None  # by the device's clock, where that is certain

    def start(self, *, certain: bool = True) -> None:
        """Begin a dwell now."""
        self.recorder.check()
        start = self.recorder.now()
        self._first = self.recorder.begun(start, self._deadline_s) if certain else None
        self._start = start

    def stop(self) -> Record:
        """Return the readings since ``start``."""
        if self._start is None:
            raise InputError("dwell: wanted one that was started, got none; start it first")
        start, self._start = self._start, None
        return self.recorder.between(start, self.recorder.now(), self._deadline_s, first=self._first)

    def latest(self) -> str:
        """Return the newest reading in words."""
        pairs = zip(self.recorder.source.description.measured, self.recorder.latest().tolist(), strict=True)
        return "  ".join(f"{name} {value:.6g}" for name, value in pairs)

    def close(self) -> None:
        """Stop the recorder; harmless when called again."""
        self.recorder.stop()
