"""Recorder: a thread reads the device; what it says goes to the disk, and stays at hand for a while.

::

    with Recorder(source, folder) as recorder:      # open, first reading awaited
        start = recorder.now()                      # the host's monotonic clock
        ...                                         # a dwell
        record = recorder.between(start, recorder.now(), deadline_s=2.0)
"""

import logging
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from undrift.arrays import FloatArray
from undrift.errors import InputError, RigTimeout, UndriftError
from undrift.live.chunk import Chunk
from undrift.live.clock import ClockFit, ClockSettings
from undrift.live.recent import Recent
from undrift.live.source import Source
from undrift.live.writer import PieceWriter
from undrift.record import Record

log = logging.getLogger(__name__)
READ_S = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderSettings:
    """How a device is recorded.

    Parameters
    ----------
    silence_s : float
        Longest host time without a good reading before the device counts as lost, s.
    keep_s : float
        Device time that ``between`` reaches back, s.
    piece_s : float
        Device time in a piece on the disk, s.
    disk_s : float
        Longest wait for the disk, s.
    clock : ClockSettings
        How the device's clock is found.
    """

    silence_s: float = 5.0
    keep_s: float = 600.0
    piece_s: float = 10.0
    disk_s: float = 30.0
    clock: ClockSettings = field(default_factory=ClockSettings)

    def __post_init__(self) -> None:
        for name in ("silence_s", "keep_s", "piece_s", "disk_s"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"recorder: wanted {name} above 0, got {getattr(self, name)}; every wait has an end")


@dataclass(frozen=True, slots=True, kw_only=True)
class Tally:
    """What became of a recording.

    Parameters
    ----------
    readings : int
        Good ones.
    written : int
        Rows on the disk, those of gaps among them; 0 without a folder.
    pieces : int
        Files.
    missing, gaps : int
        Readings that never came, and stretches of such.
    garbled, late : int
        Readings left out: spoilt, and late or double.
    restarts : int
        Times that the device began to count anew.
    clock : ClockFit or None
        The device's clock on the host's; None before the first reading.
    """

    readings: int
    written: int
    pieces: int
    missing: int
    gaps: int
    garbled: int
    late: int
    restarts: int
    clock: ClockFit | None


class Recorder:
    """Records a device from ``start`` to ``stop``; a context manager does both.

    Parameters
    ----------
    source : Source
        The device; opened and closed here.
    folder : Path or str or None
        Where pieces are written; None for none.
    settings : RecorderSettings
        How.
    """

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
        """Open the device and wait for its first reading.

        Raises
        ------
        LinkError
            Nobody is there.
        RigTimeout
            No good reading came in ``silence_s``.
        InputError
            Started before, or a folder that cannot be made.
        """
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
        """Wait for a reading that was certainly taken after a moment; return its device time, s. RigTimeout where none comes.

        Parameters
        ----------
        moment : float
            The host's monotonic clock, s.
        deadline_s : float
            Longest wait, host s.
        """
        return self._recent.begun(moment, deadline_s)

    def between(self, start: float, stop: float, deadline_s: float = 5.0, *, first: float | None = None) -> Record:
        """Return what the device said in a stretch of the host's time.

        Parameters
        ----------
        start, stop : float
            The host's monotonic clock, s; ``stop`` may lie a little ahead.
        deadline_s : float
            Longest wait for readings up to ``stop``, host s, beyond that moment.
        first : float or None
            Device time from which readings are wanted, as ``begun`` returned it for ``start``; what came since checks it, s.

        Returns
        -------
        Record
            Raw, on the device's clock; NaN rows where readings are missing.

        Raises
        ------
        RigTimeout
            Readings up to ``stop`` did not come, or with ``first`` fewer than two that are certainly later than ``start``.
        LinkError
            The device is lost.
        InputError
            The stretch is no longer kept, or holds fewer than two readings.
        """
        times, values = self._recent.between(start, stop, deadline_s, first)
        return self.source.description.record(times, values)

    def latest(self) -> FloatArray:
        """Return the newest reading for display: raw, shape (C,), in the order of ``source.description.measured``.

        Raises
        ------
        LinkError
            The device is lost.
        InputError
            None has come yet.
        """
        return self._recent.latest()

    def check(self) -> None:
        """Raise what has gone wrong behind the scenes, if anything.

        Raises
        ------
        LinkError
            The device is lost.
        RigTimeout
            It fell silent, or the disk did.
        """
        self._recent.check()

    def tally(self) -> Tally:
        """Return what became of the recording so far.

        Returns
        -------
        Tally
            Counts and clock.
        """
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
        """Stop, write what is left, let go of the device; harmless when called again.

        Returns
        -------
        Tally
            Of the whole recording.

        Raises
        ------
        LinkError
            The disk hangs.
        InputError
            The last readings could not be written, and nobody was told yet.
        """
        self._stopping.set()
        self._recent.end()
        if self._thread is not None:
            self._thread.join(self.settings.disk_s + 2.0)
        self.source.close()
        if self._writer is not None:
            self._writer.stop(self.settings.disk_s)
            if self._writer.failure is not None and not self._recent.failed:  # the last piece: nobody was told yet
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
