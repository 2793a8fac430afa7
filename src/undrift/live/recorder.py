"""Recorder: a thread reads the device; what it says goes to the disk, and stays at hand for a while.

::

    with Recorder(source, folder) as recorder:      # open, first reading awaited
        start = recorder.now()                      # the host's monotonic clock
        ...                                         # a dwell
        record = recorder.between(start, recorder.now(), deadline_s=2.0)

Writer: a thread that takes blocks from a bounded queue and puts them on the disk as pieces.

A full queue makes the reader wait, never lose: the sender's socket then fills, and TCP makes the sender wait too.

Pieces: records on the disk, each whole and synced before it counts; what was cut off is left aside by its name.

``live-01-00001.parquet`` is the first piece of the first connection recorded into a folder. A file that was under way when the
power went ends with ``.part`` and is never read.

Dwells: the readings of one stretch after another, for a run that starts and stops them.

A dwell holds no reading that the device took before ``start`` was called, however late readings come, unless asked otherwise.
"""

import contextlib
import logging
import os
import queue
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError, LinkError, RigTimeout, UndriftError
from undrift.io.parquet import read_parquet, write_parquet
from undrift.live.clock import Block, ClockFit, ClockSettings, Timeline
from undrift.live.decoder import Chunk, StreamDescription
from undrift.live.transports import Source
from undrift.record import Record

# ---- Recent: the readings of the last minutes, for whoever waits for them; one thread brings them, any other asks.

WAKE_S = 0.2


class Recent:
    """Readings at hand."""

    def __init__(self, name: str, description: StreamDescription, keep_s: float, clock: ClockSettings) -> None:
        self.timeline = Timeline(description, clock)
        self._name, self._keep_s = name, keep_s
        self._news = threading.Condition()
        self._ring: deque[Block] = deque()
        self._forgotten = -np.inf  # device time up to which blocks have left the ring
        self._failure: UndriftError | None = None
        self._ended = False

    def place(self, chunk: Chunk) -> Block:
        """Put a chunk on the device's clock."""
        with self._news:
            return self.timeline.add(chunk)

    def keep(self, block: Block) -> None:
        """Keep a block and wake who waits."""
        with self._news:
            self._ring.append(block)
            while self._ring[0].time[-1] < block.time[-1] - self._keep_s:
                self._forgotten = float(self._ring.popleft().time[-1])
            self._news.notify_all()

    def fail(self, error: UndriftError) -> None:
        """Report an error to everybody who asks from now on."""
        with self._news:
            self._failure = error
            self._news.notify_all()

    @property
    def failed(self) -> bool:
        """Whether an error is reported to everybody who asks."""
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
        """Return the device's clock on the host's."""
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
        """Wait for a first reading."""
        self._wait(lambda: bool(self._ring), deadline_s, "a first reading")

    def begun(self, moment: float, deadline_s: float) -> float:
        """Wait for a reading that was certainly taken after a moment; return its device time, s, as ``Recorder.begun`` does."""
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
        """Return device times, shape (N,), and raw values, (N, C), as ``Recorder.between`` does."""
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


# ---- Pieces: records on the disk, each whole and synced before it counts; what was cut off is left aside by its name.

NAME = re.compile(r"live-(\d{2,})-(\d{5,})\.parquet")


def write_synced(record: Record, path: Path | str) -> None:
    """Write a record so that it survives a power cut once this returns."""
    path = Path(path)
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


def next_connection(folder: Path | str) -> int:
    """Return the number of the next connection to be recorded into a folder."""
    return max((int(found.group(1)) for found in map(NAME.fullmatch, _names(folder)) if found), default=0) + 1


def piece_path(folder: Path | str, connection: int, piece: int) -> Path:
    """Return where a piece is written."""
    return Path(folder) / f"live-{connection:02d}-{piece:05d}.parquet"


def iter_pieces(folder: Path | str, connection: int = 1) -> Iterator[Record]:
    """Read the pieces of one connection in their order."""
    for name in sorted(_names(folder)):
        found = NAME.fullmatch(name)
        if found and int(found.group(1)) == connection:
            yield read_parquet(Path(folder) / name).record


def read_pieces(folder: Path | str, connection: int = 1) -> Record:
    """Read one connection as one record."""
    pieces = list(iter_pieces(folder, connection))
    if not pieces:
        raise InputError(f"{folder}: wanted pieces of connection {connection}, got none; check folder and number")

    def joined(name: str) -> object:
        parts = [getattr(piece, name) for piece in pieces]
        return None if parts[0] is None else np.concatenate(parts)

    channels = {name: joined(name) for name in ("time", "gyro", "accel", "temp_c", "mag_ut")}
    return replace(pieces[0], **channels)  # type: ignore[arg-type]


def _names(folder: Path | str) -> list[str]:
    return [path.name for path in Path(folder).iterdir()] if Path(folder).is_dir() else []


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


# ---- Writer: a thread that takes blocks from a bounded queue and puts them on the disk as pieces.

QUEUE_BLOCKS = 4096
KEPT_ROWS = 2  # stay behind for the next piece, so that the last one is a record of two rows at least


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
                self._attempt(keep=KEPT_ROWS)
        if self.failure is None:
            self._attempt(keep=0)

    def _attempt(self, keep: int) -> None:
        try:
            self._write(keep)
        except UndriftError as error:
            self.failure = error

    def _write(self, keep: int) -> None:
        if self._count < KEPT_ROWS:
            return
        time: FloatArray = np.concatenate([block.time for block in self._held])
        values: FloatArray = np.concatenate([block.values for block in self._held])
        cut = len(time) - keep
        path = piece_path(self.folder, self.connection, self.pieces + 1)
        write_synced(self._description.record(time[:cut], values[:cut]), path)
        self.pieces, self.rows = self.pieces + 1, self.rows + cut
        self._held = [Block(time[cut:], values[cut:])]
        self._count = keep


# ---- recorder

log = logging.getLogger(__name__)
READ_S = 0.2


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


class Recorder:
    """Records a device from ``start`` to ``stop``; a context manager does both."""

    def __init__(
        self, source: Source, folder: Path | str | None = None, settings: RecorderSettings = RecorderSettings()
    ) -> None:
        self.source, self.settings = source, settings
        self._folder = None if folder is None else Path(folder)
        self._recent = Recent(source.name, source.description, settings.keep_s, settings.clock)
        self._writer: PieceWriter | None = None
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()

    def __enter__(self) -> "Recorder":
        """Start."""
        self.start()
        return self

    def __exit__(self, *failure: object) -> None:
        """Stop."""
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
            self._recent.wait_for_first(self.settings.silence_s + 2.0 * READ_S)
        except BaseException:  # Ctrl-C too: nothing is left running
            self.stop()
            raise

    def begun(self, moment: float, deadline_s: float = 5.0) -> float:
        """Wait for a reading that was certainly taken after a moment; return its device time, s. RigTimeout where none comes."""
        return self._recent.begun(moment, deadline_s)

    def between(self, start: float, stop: float, deadline_s: float = 5.0, *, first: float | None = None) -> Record:
        """Return the readings in a stretch of the host's time."""
        times, values = self._recent.between(start, stop, deadline_s, first)
        return self.source.description.record(times, values)

    def latest(self) -> FloatArray:
        """Return the newest reading for display: raw, shape (C,), in the order of ``source.description.measured``."""
        return self._recent.latest()

    def check(self) -> None:
        """Raise what has gone wrong behind the scenes, if anything."""
        self._recent.check()

    def tally(self) -> Tally:
        """Return what became of the recording so far."""
        line, writer = self._recent.timeline, self._writer
        return Tally(
            readings=line.readings,
            written=writer.rows if writer else 0,
            pieces=writer.pieces if writer else 0,
            missing=line.missing,
            gaps=line.gaps,
            garbled=self.source.errors,
            late=line.late,
            restarts=line.restarts,
            clock=self._recent.clock(),
        )

    def stop(self) -> Tally:
        """Stop, write what is left, let go of the device; harmless when called again."""
        self._stopping.set()
        self._recent.end()
        if self._thread is not None:
            self._thread.join(self.settings.disk_s + 2.0)
        self.source.close()
        if self._writer is not None:
            self._writer.stop(self.settings.disk_s)
            if self._writer.failure is not None and not self._recent.failed:  # the last piece: nobody knows yet
                self._recent.fail(self._writer.failure)
                raise self._writer.failure
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
                self._keep(chunk)
        except UndriftError as error:
            log.info("recorder: %s", error)
            self._recent.fail(error)

    def _keep(self, chunk: Chunk) -> None:
        block = self._recent.place(chunk)
        if not len(block.time):
            return
        if self._writer is not None:
            self._writer.put(block, self.settings.disk_s)
        self._recent.keep(block)


# ---- Dwells: the readings of one stretch after another, for a run that starts and stops them.


class DwellReadings:
    """Readings of a recorder that has been started, dwell by dwell."""

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
