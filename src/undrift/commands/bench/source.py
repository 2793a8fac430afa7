"""The device to which the bench is connected, by address. It reconnects automatically, and every page may read it.

A thread collects the readings of the recorder about fifteen times a second. Readings are kept for two minutes, and
written to a file while a file is open. Time continues over a lost connection, with a gap.
"""

import itertools
import math
import os
import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.clock import Clock
from undrift.errors import InputError, LinkError, UndriftError
from undrift.io.text import Appender
from undrift.live.hands import HandHeld
from undrift.live.log import described_address
from undrift.live.recorder import Recorder
from undrift.live.transports import lsl_streams, serial_ports, source_at
from undrift.record import Record, joined

PERIOD_S = 1.0 / 15.0  # time between two reads of the recorder, host s
KEEP_S = 120.0  # device s
SILENCE_S, RETRY_S = 2.0, 1.0
STALE_S = 1.0  # host time without readings after which the device counts as silent, s
RATE_OVER_S = 5.0  # time over which the sample rate is measured, host s
STOP_S = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """State of a source."""

    error: str  # a message, or "" while readings arrive
    sample_rate_hz: float  # sample rate over the last seconds of device time, Hz; NaN at the start
    readings: int  # number of readings since the source was started
    lost: int  # number of missing readings
    garbled: int  # number of readings omitted because they were damaged
    temp_c: float  # newest temperature; NaN without a thermometer
    file: Path | None  # file that is being written
    file_error: str  # reason why the last file ended early, or ""
    file_s: float  # length of the file, device s


def found_devices() -> tuple[list[tuple[str, str]], list[str]]:
    """Return the addresses of serial ports and LSL streams with their names, and the reasons why some could not be searched."""
    senders, notes = list[tuple[str, str]](), list[str]()
    for kind, listed in (("serial://", serial_ports), ("lsl:", lsl_streams)):
        try:
            senders += [(kind + name, text) for name, text in listed()]
        except LinkError as error:
            notes.append(str(error))
    return senders, notes


class LiveDevice:
    """One device, from `start` to `stop`."""

    def __init__(self, address: str, silence_s: float = SILENCE_S) -> None:
        self.address, self._silence_s = address, silence_s  # address, and longest host time without readings, s
        self.recorder = self._fresh()  # source for the current connection; raises for an invalid address
        self.name = self.recorder.source.description.device or self.recorder.source.name
        self.error = ""
        self._thread: threading.Thread | None = None
        self._stopping, self._lock, self._file_lock = threading.Event(), threading.RLock(), threading.RLock()
        self._kept: deque[Record] = deque()
        self._start, self._last, self._heard = 0.0, -math.inf, -math.inf  # device s, device s, host s
        self._counted: deque[tuple[float, int]] = deque()
        self._before = np.zeros(3, dtype=int)  # readings, lost and garbled of earlier connections
        self._temp_c = math.nan
        self.file: Path | None = None  # file that is being written
        self._log: Appender | None = None
        self._unwritten = list[Record]()
        self._file_start, self._file_error = math.nan, ""

    @property
    def speed(self) -> float:
        """Return the device seconds per second of the host, which is 1 for hardware."""
        return self.recorder.source.description.clock_speed

    def start(self) -> None:
        """Connect and wait for a first reading. Raise an error if none comes."""
        if self._thread is not None:
            raise InputError("source: this source was started before. Create a new source.")
        self.recorder.start()
        self._thread = threading.Thread(target=self._run, name="bench-source", daemon=True)
        self._thread.start()

    def stop(self) -> Path | None:
        """Disconnect the device, finish the open file and return it. Repeated calls have no effect."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(STOP_S)
            with suppress(UndriftError):  # data received since the last read
                self._take()
        self.recorder.stop()
        return self.stop_writing()

    def recent(self, seconds: float) -> Record | None:
        """Return the newest readings in raw units, or None while the device is silent."""
        with self._lock:
            if time.monotonic() - self._heard > STALE_S or not self._kept:
                return None
            start = self._last - seconds
            newest = list(itertools.takewhile(lambda record: record.time[-1] > start, reversed(self._kept)))
        record = joined(newest[::-1])
        first = int(np.searchsorted(record.time, start, side="right"))
        return record.part(first, len(record)) if len(record) - first >= 2 else None

    def status(self) -> Status:
        """Return the current status."""
        with self._lock:
            rate, description, file = math.nan, self.recorder.source.description, self.file
            if len(self._counted) > 1 and time.monotonic() - self._heard < STALE_S:
                (t0, n0), (t1, n1) = self._counted[0], self._counted[-1]
                rate = (n1 - n0) / (t1 - t0) / description.clock_speed
            readings, lost, garbled = (self._before + self._tally()).tolist()
            return Status(
                error=self.error,
                sample_rate_hz=rate,
                readings=readings,
                lost=lost,
                garbled=garbled,
                temp_c=self._temp_c,
                file=file,
                file_error=self._file_error,
                file_s=0.0 if file is None else max(self._last - self._file_start, 0.0),
            )

    def write_to(self, path: Path) -> None:
        """Write the raw readings from now on to a growing CSV file."""
        with self._file_lock:
            if self.file is not None:
                raise InputError(f"record: {self.file.name} is still being recorded. Stop it first.")
            self.file, self._log, self._unwritten = path, Appender(path), []
            self._file_start, self._file_error = max(self._last, 0.0), ""

    def stop_writing(self) -> Path | None:
        """Finish the file and return it, or None if nothing was written."""
        with self._file_lock:
            path, log = self.file, self._log
            if path is None or log is None:
                return None
            try:
                with log:
                    if self._unwritten:
                        log.write(joined(self._unwritten))
            finally:
                self.file, self._log, self._unwritten = None, None, []  # set last, because then the file must exist
            return path if path.exists() else None

    def _fresh(self) -> Recorder:
        return Recorder(source_at(self.address), silence_s=self._silence_s, keep_s=KEEP_S)

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
        """Try to connect again until a connection exists or the source is stopped."""
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
            return

    def _take(self) -> None:
        """Process the readings since the last call. The work is done without the lock, so that pages never wait."""
        came = self.recorder.since(self._last - self._start)
        if came is None:
            return
        raw = came if not self._start else replace(came, time=came.time + self._start)
        with self._lock:
            now = time.monotonic()
            self._heard, self._last = now, float(raw.time[-1])
            self._counted.append((now, self.recorder.timeline.readings))
            while self._counted[0][0] < now - RATE_OVER_S:
                self._counted.popleft()
            if raw.temp_c is not None and (finite := raw.temp_c[~np.isnan(raw.temp_c)]).size:
                self._temp_c = float(finite[-1])
            self._kept.append(raw)
            while self._kept[0].time[-1] < self._last - KEEP_S:
                self._kept.popleft()
        self._append(raw)

    def _append(self, raw: Record) -> None:
        with self._file_lock:
            if (log := self._log) is None:
                return
            self._unwritten.append(raw)
            try:
                if raw.time[-1] - self._unwritten[0].time[0] >= log.write_every_s:
                    log.write(joined(self._unwritten))
                    self._unwritten.clear()
            except UndriftError as error:  # if the disk is full, the readings so far are in the CSV
                self._file_error = str(error)
                log.__exit__(type(error), error, None)
                self.file, self._log, self._unwritten = None, None, []


def connected(address: str) -> LiveDevice:
    """Connect the device at an address. If the address does not contain the format of the data, it is determined by listening."""
    device = LiveDevice(described_address(address)[0])
    device.start()
    return device


class PracticeDevice(HandHeld):
    """The simulated hand-held device that a bench starts if there is no real device."""

    def __init__(self, gravity_m_s2: float) -> None:
        seed, speed = (os.environ.get(f"UNDRIFT_PRACTICE_{name}", "") for name in ("SEED", "SPEED"))
        clock = Clock.started(float(speed or 1.0))
        super().__init__(seed=int(seed) if seed else None, clock=clock, gravity_m_s2=gravity_m_s2)
