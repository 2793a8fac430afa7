"""Source: the device that the bench listens to, by address; it reconnects by itself, and any page may ask it.

A thread takes what the recorder has brought, some fifteen times a second: corrected by the calibration that is set, oriented from
the last rest, kept for two minutes, written to a file while one is open. Time goes on over a lost connection, with a gap.
"""

import itertools
import json
import math
import threading
import time
from collections import deque
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.correction.correct import Corrector
from undrift.errors import InputError, UndriftError
from undrift.files import write_whole
from undrift.io.columns import native_columns
from undrift.io.parquet import ParquetWriter
from undrift.io.store import read_calibration
from undrift.io.text import Appender, sidecar_of, statement_of
from undrift.live.log import described_address
from undrift.live.recorder import Recorder, RecorderSettings
from undrift.live.transports import source_at
from undrift.model import BodyMounting, Calibration
from undrift.orientation import OrientStream, sagittal_pitch
from undrift.record import Face, Record, joined
from undrift.units import is_physical

PERIOD_S = 1.0 / 15.0  # between two looks at the recorder, host s
KEEP_S = 120.0  # device s
GATHER_S = 0.04  # host s for which readings are left to gather
SILENCE_S, RETRY_S = 2.0, 1.0
STALE_S = 1.0  # host time without readings after which the newest ones are no longer "now"
RATE_OVER_S = 5.0  # host s over which the sample rate is counted
STOP_S = 20.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Update:
    """Readings that came together."""

    number: int  # Counts up by one
    raw: Record  # In the device's units
    corrected: Record | None  # The same samples, rad/s and m/s2
    q_nb: FloatArray | None  # (N, 4), from the last rest; NaN where unknown
    pitch: FloatArray | None  # (N,), rad, forward lean positive


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """How a source is doing."""

    error: str  # One line; "" while readings come
    nominal_rate_hz: float
    sample_rate_hz: float  # Achieved over the last seconds, device time; NaN before there are any
    readings: int  # Since the source was started
    lost: int  # Numbers that are missing
    garbled: int  # Left out because they were damaged
    temp_c: float  # Newest; NaN where the device has none
    oriented: bool  # Whether the readings have both triads in physical units, so that there is a pitch
    rested_s: float  # Device time since the last rest, from which the pitch is counted; NaN where it is unknown
    correction: str  # Why nothing is corrected, or what the calibration does not cover, a line each; "" if all is well
    notes: str  # What a reader of the corrected signals may not expect, a line each
    file: Path | None  # What is being written
    file_error: str  # Why the last file ended early; "" where it did not
    file_s: float  # How much of it there is, device s


def listened(address: str) -> str:
    """Return an address that says what the device sends, found by listening where it does not."""
    return described_address(address)[0]


class LiveDevice:
    """One device, from `start` to `stop`."""

    def __init__(self, address: str, silence_s: float = SILENCE_S) -> None:
        self.address, self._silence_s = address, silence_s  # the latter: longest host time without readings
        self.recorder = self._fresh()  # of the present connection; refuses an address that is none
        self.name = self.recorder.source.description.device or self.recorder.source.name
        self.error = ""
        self._thread: threading.Thread | None = None
        self._stopping, self._lock, self._file_lock = threading.Event(), threading.RLock(), threading.RLock()
        self._kept: deque[Update] = deque()
        self._number = 0
        self._start, self._last, self._heard = 0.0, -math.inf, -math.inf  # device s, device s, host s
        self._counted: deque[tuple[float, int]] = deque()
        self._before = np.zeros(3, dtype=int)  # readings, lost and garbled of earlier connections
        self._temp_c = math.nan
        self.calibration: Calibration | None = None  # that corrects the readings
        self.calibration_file: Path | None = None  # where it came from
        self._corrector: Corrector | None = None
        self._orient = OrientStream()
        self.mounting: BodyMounting | None = None  # of the calibration; sides that are set overrule it
        self.axes: tuple[Face, Face] = "+x", "+z"  # forward and up on the upright segment: they define the pitch
        self._correction = self._notes = ""
        self.file: Path | None = None  # that is being written
        self._unwritten = dict[Appender | ParquetWriter, list[Record]]()
        self._file_start, self._file_error = math.nan, ""

    @property
    def nominal_rate_hz(self) -> float:
        """Stated readings per second of the device."""
        return self.recorder.source.description.rate

    @property
    def speed(self) -> float:
        """Device seconds in one of the host's: 1 for hardware."""
        return self.recorder.source.description.clock_speed

    def start(self) -> None:
        """Connect and wait for a first reading; raises where none comes."""
        if self._thread is not None:
            raise InputError("source: wanted a fresh one, got one that was started before; make another")
        self.recorder.start()
        self._thread = threading.Thread(target=self._run, name="bench-source", daemon=True)
        self._thread.start()

    def stop(self) -> Path | None:
        """Let go of the device, finish the file that is open and return it; harmless when called again."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(STOP_S)
            with suppress(UndriftError):  # what came since its last look
                self._take()
        self.recorder.stop()
        return self.stop_writing()

    def recent(self, seconds: float) -> Record | None:
        """Return the newest readings in raw units; None while the device is silent."""
        with self._lock:
            if time.monotonic() - self._heard > STALE_S or not self._kept:
                return None
            start = self._last - seconds
            held = list(itertools.takewhile(lambda one: one.raw.time[-1] > start, reversed(self._kept)))
        record = joined([one.raw for one in reversed(held)])
        first = int(np.searchsorted(record.time, start, side="right"))
        return record.part(first, len(record)) if len(record) - first >= 2 else None

    def updates(self, after: int = 0) -> list[Update]:
        """Return what came after an update of that number, as far back as it is kept."""
        with self._lock:
            return list(itertools.takewhile(lambda one: one.number > after, reversed(self._kept)))[::-1]

    def status(self) -> Status:
        """Return how it is doing."""
        with self._lock:
            rate, description, file = math.nan, self.recorder.source.description, self.file
            if len(self._counted) > 1 and time.monotonic() - self._heard < STALE_S:
                (t0, n0), (t1, n1) = self._counted[0], self._counted[-1]
                rate = (n1 - n0) / (t1 - t0) / description.clock_speed
            readings, lost, garbled = (self._before + self._tally()).tolist()
            rested = self._orient.rested
            return Status(
                error=self.error,
                nominal_rate_hz=description.rate,
                sample_rate_hz=rate,
                readings=readings,
                lost=lost,
                garbled=garbled,
                temp_c=self._temp_c,
                oriented=bool(self._kept) and self._kept[-1].q_nb is not None,
                rested_s=math.nan if rested is None else self._last - rested,
                correction=self._correction,
                notes=self._notes,
                file=file,
                file_error=self._file_error,
                file_s=0.0 if file is None else max(self._last - self._file_start, 0.0),
            )

    def set_calibration(self, calibration: Calibration | None) -> None:
        """Correct by a calibration from now on, or by none."""
        corrector = None if calibration is None else Corrector(calibration, "hold")
        with self._lock:
            self.calibration, self._corrector = calibration, corrector
            self.mounting = None if calibration is None else calibration.mounting
            self._correction = self._notes = ""
            self._orient = OrientStream()

    def use(self, path: Path | None) -> None:
        """Correct by the calibration in a file from now on, or by none; what is wrong with it stands in the status."""
        self.calibration_file = path
        try:
            self.set_calibration(None if path is None else read_calibration(path))
        except UndriftError as error:
            self.set_calibration(None)
            self._correction = str(error) if path is None else str(error).replace(str(path), path.name)

    def set_axes(self, forward: Face, up: Face) -> None:
        """Count the pitch about other axes from now on."""
        sagittal_pitch(np.array([1.0, 0.0, 0.0, 0.0]), forward=forward, up=up)  # refuses what are no two axes
        self.axes, self.mounting = (forward, up), None

    def write_to(self, path: Path) -> Path:
        """Write the raw readings from now on, to a CSV that grows and is returned; a Parquet file takes its place at the end."""
        with self._file_lock:
            if self.file is not None:
                raise InputError(f"record: wanted to start, got {self.file.name} still open; stop it first")
            log = Appender(path if path.suffix == ".csv" else path.with_name(f"{path.name}.csv"))
            self.file, self._unwritten = path, {log: []} | ({} if log.path == path else {ParquetWriter(path): []})
            self._file_start, self._file_error = max(self._last, 0.0), ""
            return log.path

    def stop_writing(self) -> Path | None:
        """Finish the file; None where there was nothing to write."""
        with self._file_lock:
            if (path := self.file) is None:
                return None
            try:
                with ExitStack() as stack:
                    for writer in self._unwritten:
                        stack.enter_context(writer)
                    for writer, unwritten in self._unwritten.items():
                        if unwritten:
                            _write(writer, unwritten, self.file)
            finally:
                log = next(iter(self._unwritten)).path
                self.file, self._unwritten = None, {}  # only now: who sees no writer finds the file
            if not path.exists():
                return None
            for one in {log, sidecar_of(log)} - {path, sidecar_of(path)}:
                one.unlink()
            return path

    def _fresh(self) -> Recorder:
        settings = RecorderSettings(silence_s=self._silence_s, keep_s=KEEP_S, gather_s=GATHER_S)
        return Recorder(source_at(self.address), settings)

    def _tally(self) -> FloatArray:
        timeline = self.recorder.timeline
        return np.array([timeline.readings, timeline.marker.missing, self.recorder.source.errors])

    def _run(self) -> None:
        while not self._stopping.wait(PERIOD_S):
            try:
                self._take()
            except UndriftError as error:
                self.error = str(error)
                self._reconnect()

    def _reconnect(self) -> None:
        """Make a new connection, until there is one or the source is stopped."""
        while not self._stopping.is_set():
            self.recorder.stop()
            fresh = self._fresh()
            try:
                fresh.start()
            except UndriftError as error:
                self.error = str(error)
                self._stopping.wait(RETRY_S)
                continue
            with self._lock:
                self._before = self._before + self._tally()
                speed = fresh.source.description.clock_speed
                self._start = max(self._last, 0.0) + max(time.monotonic() - self._heard, PERIOD_S) * speed
                self.recorder, self.error = fresh, ""
                self._counted.clear()
                self.set_calibration(self.calibration)
            return

    def _take(self) -> None:
        """Take what has come since the last look. The work is done outside the lock: a page never waits for it."""
        came = self.recorder.since(self._last - self._start)
        if came is None:
            return
        raw = came if not self._start else replace(came, time=came.time + self._start)
        corrected, (forward, up) = self._corrected(raw), self.axes
        shown = corrected or raw
        whole = shown.gyro is not None and shown.accel is not None
        physical = is_physical(shown.gyro_unit) and is_physical(shown.accel_unit)
        q = self._orient.push(shown) if whole and physical else None
        if q is None or (worn := self.mounting) is None:
            pitch = None if q is None else sagittal_pitch(q, forward=forward, up=up)
        else:
            pitch = sagittal_pitch(worn.of_body(q))
        with self._lock:
            now = time.monotonic()
            self._heard, self._last, self._number = now, float(raw.time[-1]), self._number + 1
            self._counted.append((now, self.recorder.timeline.readings))
            while self._counted[0][0] < now - RATE_OVER_S:
                self._counted.popleft()
            if raw.temp_c is not None and (known := raw.temp_c[~np.isnan(raw.temp_c)]).size:
                self._temp_c = float(known[-1])
            self._kept.append(Update(number=self._number, raw=raw, corrected=corrected, q_nb=q, pitch=pitch))
            while self._kept[0].raw.time[-1] < self._last - KEEP_S:
                self._kept.popleft()
        self._append(raw)

    def _corrected(self, raw: Record) -> Record | None:
        corrector, done, notes = self._corrector, None, ""
        if corrector is None:
            return None
        try:
            done = corrector.push_checked(raw)
            other = (one.text for one in done.findings if one.code == "correct.device")
            words, notes = "\n".join((*corrector.warnings, *other)), "\n".join(done.notes)
            if worn := self.mounting:
                notes = f"{notes}\npitch of the {worn.place} by the calibration's mounting".lstrip()
        except UndriftError as error:  # another device, or another unit: not its calibration
            words = str(error)
        with self._lock:
            if self._corrector is corrector:  # no other calibration was set meanwhile
                self._corrector, self._correction, self._notes = corrector if done else None, words, notes
        return None if done is None else done.record

    def _append(self, raw: Record) -> None:
        with self._file_lock:
            try:
                for writer, unwritten in self._unwritten.items():
                    unwritten.append(raw)
                    if raw.time[-1] - unwritten[0].time[0] >= writer.write_every_s:
                        _write(writer, unwritten, self.file)
            except UndriftError as error:  # a full disk: what was written is in the CSV
                self._file_error = str(error)
                for writer in self._unwritten:
                    writer.__exit__(type(error), error, None)
                self.file, self._unwritten = None, {}


def _write(writer: Appender | ParquetWriter, unwritten: list[Record], file: Path | None) -> None:
    """Write what a writer has not written yet; the CSV of another file states beside it what it holds."""
    record, beside = joined(unwritten), sidecar_of(writer.path)
    if writer.path != file and not beside.exists():
        stated = statement_of(record, writer.path, native_columns(record)[0])
        write_whole(beside, json.dumps(stated | {"samples": None}) + "\n")
    writer.write(record)
    unwritten.clear()
