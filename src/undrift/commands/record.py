"""``undrift record``: record a device to a file, optionally with a guide through the poses of a calibration.

Readings are appended to a CSV. The file is complete after each second, even if an unplugged cable, a full disk or a power cut ends
the recording. At the end, it is converted to the requested file. The format of a device's output is determined by listening
(``live/log.py``).
"""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from undrift.base.options import OptionalOutput
from undrift.commands.bench.capture import Capture
from undrift.commands.bench.guides import Guide, Poses, SixFaces, Turns
from undrift.commands.bench.source import LiveDevice, Status, found_devices
from undrift.commands.calibrate import calibrate
from undrift.commands.files import Place
from undrift.commands.outputs import check_output
from undrift.errors import InputError, LinkError, UndriftError
from undrift.io.column_map import ColumnMap
from undrift.io.formats import read_record
from undrift.io.write import write_record_as
from undrift.live.log import described_address
from undrift.live.transports import serial_ports
from undrift.record import Record
from undrift.report import Report, Table
from undrift.rig.lock import stopping_on_signals, uninterrupted
from undrift.screen import screen

LOOK_S = 0.2  # time between two reads of the device, host s
LOG_S = 5.0  # recorded time between two progress lines if there is no terminal, s
FIRST_S, LOST_S = 6.0, 10.0  # longest wait for the first reading (a board may restart), and for a lost device, host s
CLOCK_S = 10.0  # recorded time after which the rate of a device without time is more accurate than from listening, s
PAUSE_S = 1.0  # time without readings that is not reported, host s
RATE_S = 2.0  # recorded time after which the rate is printed, s
NOW_S, MOST_S = 0.5, 100.0  # duration of the displayed mean, and of the readings in a guide's step, s
FORMATS = (".parquet", ".csv", ".csv.gz")
HOW = {
    "face": "Faces: lay it on each of its six faces, on a level table, and let go. Each is captured automatically, in any order.",
    "turn": "Turns: lay it along a straight edge. Turn it once on the table, as seen from above, back to the edge, and let go.",
    "pose": "Poses: lay or lean it in 15 poses of any kind, 30 deg apart, and let go. Each is captured automatically.",
}
Guides: TypeAlias = Sequence[Guide]


def record(
    address: str | None = None,
    /,
    *,
    output: OptionalOutput = None,
    guide: Literal["six-faces", "turns", "poses"] | None = None,
    duration_s: float = math.inf,
    place: Place = Place(),
) -> Report:
    """Record a device until Ctrl-C. Without device and file, list serial ports and LSL streams.

    Parameters
    ----------
    address : str or None
        A serial port (/dev/ttyUSB0, COM3, /dev/ttyUSB0?baud=9600), tcp://host:port, udp://:9000, or lsl:NAME (see
        docs/live.md). The default is the only serial port. The format of text lines is determined by listening.
    output : Path or None
        File to write: .parquet, .csv or .csv.gz.
    guide : str or None
        Guide through the poses of a calibration, then calibrate: six-faces (accelerometers), turns (the faces, then
        turns by hand, for both sensors) or poses (15 arbitrary poses).
    duration_s : float
        Longest time to record, s.
    """
    if address is None and output is None:
        return _senders()
    where = address_of(address)
    if output is None:
        raise InputError(f"record: expected a file to write, got none. Add `output` walk.parquet to record {where}.")
    check_output(output, endings=FORMATS)
    folder = output.with_name(output.name.partition(".")[0])
    calibration = folder.with_name(f"{folder.name}.json")
    for path in (output, *((folder, calibration) if guide else ())):
        if path.exists():
            raise InputError(
                f"{path}: the file already exists, and recordings are never overwritten. Choose another name."
            )
    recording = _Recording(where, output)
    guides = _guides(guide, folder, place)
    screen().say(*(HOW[step_guide.step] for step_guide in guides))
    readings, status = recording.run(guides, duration_s)
    report = recording.report(readings, status)
    if guides and all(step_guide.complete for step_guide in guides):
        calibrated = _calibrated(guides, output, calibration, place)
        return replace(
            calibrated,
            notes=[report.answer, *report.notes, *calibrated.notes],
            written=[output, *calibrated.written],
            data={**calibrated.data, "recording": report.data},
        )
    if guides:
        done = ", ".join(f"{len(part.done)} of {len(part.order)} {part.step}s" for part in guides)
        report = replace(report, notes=[*report.notes, f"The guide was left at {done}. Nothing was calibrated."])
    return report


def address_of(address: str | None) -> str:
    """Return an address with its kind: the given address, or the only serial port."""
    if address is None:
        ports = [name for name, _ in serial_ports()]
        if len(ports) != 1:
            raise InputError(
                f"record: expected one serial port, got {len(ports)} ({', '.join(ports)}). Give the device."
            )
        (address,) = ports
    return f"serial://{address}" if address.startswith("/") or address.upper().startswith("COM") else address


def _senders() -> Report:
    """List the available devices, and the reasons why some kinds could not be searched."""
    screen().over("Looking for serial ports and LSL streams ...")
    devices, notes = found_devices()
    screen().over("")
    ports = [(name.removeprefix("serial://"), text) for name, text in devices if name.startswith("serial:")]
    streams = [device for device in devices if device[0].startswith("lsl:")]
    rows = [("serial port", *port) for port in ports] + [("LSL stream", *stream) for stream in streams]
    answer = f"Serial ports: {len(ports)}, LSL streams: {len(streams)}."
    return Report(
        title="Available devices",
        answer=answer if rows else "No device was found. Connect the device, or give its address.",
        tables=[Table(title="Devices", columns=("kind", "address", "device"), rows=rows)],
        notes=notes,
        next_command=("record", ports[0][0], "-o", "walk.parquet") if ports else (),
    )


class _Recording:
    """A recording, from the first connection to the device to the file."""

    def __init__(self, address: str, output: Path) -> None:
        self.screen, self.shown = screen(), ""
        self.screen.over(f"Listening to {address} ...")
        self.address, self.notes = described_address(address)
        self.is_rate_rough = self.address != address  # determined by listening for a few seconds
        self.source, self.output, self.ended = LiveDevice(self.address, FIRST_S), output, "stopped"
        self.began = datetime.now(UTC).isoformat(timespec="milliseconds")
        self.file = output if output.name.endswith(".csv") else output.with_name(f"{output.name}.csv")
        self.screen.over("")
        sent = self.source.recorder.source.description
        triads = {name.partition("_")[0] for name in sent.measured}
        units = {"gyro": sent.gyro_unit, "accel": sent.accel_unit, "mag": "uT", "temp": "degC"}
        channels = ", ".join(f"{name} in {unit}" for name, unit in units.items() if name in triads)
        notes = (f"  note: {note}" for note in self.notes)
        name = self.source.recorder.source.name
        self.screen.say(f"Recording {name}: {channels}, {sent.rate:g} Hz. Ctrl-C ends it.", *notes)

    def run(self, guides: Guides, duration_s: float) -> tuple[Record, Status]:
        """Record until the end, and write the file. Errors that end it early are raised with the state of the file."""
        with stopping_on_signals():
            self.source.write_to(self.file)
            try:
                self.source.start()
                self.ended = self._watch(guides, duration_s)
            except KeyboardInterrupt:
                self.ended = "stopped"
            finally:
                with uninterrupted():
                    self.screen.over(self.shown, last=True)
                    status, disk_error = self.source.status(), ""
                    try:
                        self.source.stop()
                    except InputError as error:
                        disk_error = str(error)
            with uninterrupted():
                return self._finish(status, disk_error or status.file_error), status

    def _finish(self, status: Status, disk_error: str) -> Record:
        """Write the requested file from the CSV, and return its readings. If the disk is full, only the CSV remains."""
        try:
            record = self._read_back()
        except UndriftError as error:
            too_few = (
                f"{self.source.name}: fewer than two readings arrived before the recording was stopped. Try again."
            )
            raise InputError(disk_error or too_few) from error
        remaining = f"the {record.duration_s:.1f} s until then are in"
        try:
            if disk_error:
                raise InputError(disk_error)
            write_record_as(record, self.output, {"address": self.address, "began": self.began})
        except InputError as error:
            raise InputError(f"{error} ({remaining} {self.file})") from error
        if self.file != self.output:
            self.file.unlink()
        if self.ended == "lost":
            raise LinkError(f"{status.error} ({remaining} {self.output})")
        return record

    def _read_back(self) -> Record:
        """Return all readings in the CSV."""
        description, timeline = self.source.recorder.source.description, self.source.recorder.timeline
        record = replace(read_record(self.file, ColumnMap(gaps="keep")), device=description.device)
        if self.is_rate_rough and not description.tick and record.duration_s > CLOCK_S:
            clock = timeline.clock()  # the source knows the rate more accurately now
            if clock.settled:
                record = replace(record, time=record.time * clock.rate * description.clock_speed)
        return record

    def report(self, record: Record, status: Status) -> Report:
        """Return the duration and the completeness of a recording."""
        lost, garbled, rate_hz = status.lost, status.garbled, record.sample_rate_hz
        return Report(
            title=f"Recording {self.output.name}",
            answer=f"{record.duration_s:.1f} s are recorded at {rate_hz:.5g} Hz: {lost} of {status.readings + lost} readings are "
            f"lost, and {garbled} damaged readings are left out.",
            notes=[*self.notes, f"The address of the device is {self.address}."],
            written=[self.output],
            data={
                "address": self.address,
                "ended": self.ended,
                "seconds": record.duration_s,
                "sample_rate_hz": rate_hz,
                "readings": len(record),
                "lost": lost,
                "garbled": garbled,
            },
            next_command=("info", self.output),
        )

    def _watch(self, guides: Guides, duration_s: float) -> str:
        """Show the readings and the instructions of a guide until the end. Return the reason for the end."""
        source, heard, texts = self.source, time.monotonic(), list[str]()
        while True:
            time.sleep(LOOK_S)
            now, status = time.monotonic(), source.status()
            newest = source.recent(min((now - heard + 1.0) * source.speed, MOST_S))
            heard = heard if newest is None else now
            if newest is None and now - heard < PAUSE_S and not status.file_error:
                continue
            guide = next((candidate for candidate in guides if not candidate.complete), None)
            if guide is not None:
                guide.update(newest, now, source)
                texts += [guide.light.text] if texts[-1:] != [guide.light.text] else []
            step = len(texts) if guides else int(status.file_s / LOG_S)
            self.shown = _line(status, newest)
            if guide is not None:
                countdown = "" if guide.light.left_s is None else f" {guide.light.left_s:.0f} s"
                count = f"{guide.step.capitalize()}s: {len(guide.done)} of {len(guide.order)}"
                self.shown = f"{count}\n{guide.light.text}{countdown}\n{self.shown}"
            self.screen.over(self.shown, step=step)
            if now - heard > LOST_S:
                return "lost"
            if guides and guide is None:
                return "guide"
            if status.file_error or status.file_s >= duration_s:
                return "time"


def _line(status: Status, newest: Record | None) -> str:
    """Return the state of the recording as one line."""
    if newest is None:
        return f"{status.file_s:7.1f} s   no readings: {status.error or 'waiting for the device'}"
    rate = f"{status.sample_rate_hz:.1f}" if status.file_s > RATE_S else "-"
    cells = [f"{status.file_s:7.1f} s", f"{rate:>5} Hz", f"{status.lost} lost"]
    if newest.accel is not None:
        accel = newest.accel[newest.time > newest.time[-1] - NOW_S]
        length, coarse = np.nanmean(np.linalg.norm(accel, axis=1)), newest.accel_unit in ("count", "mg")
        cells.append(f"|a| {length:{'.0f' if coarse else '.4g'}} {newest.accel_unit}")
    cells += [f"{status.temp_c:.1f} degC"] if math.isfinite(status.temp_c) else []
    return "   ".join(cells)


# ---- guides


def _guides(name: str | None, folder: Path, place: Place) -> Guides:
    """Return the guides of a calibration by hand, which share their captures."""
    gravity, source = place.gravity
    capture = Capture(folder, place.serial, gravity_m_s2=None if source == "standard" else gravity)
    kinds = {"six-faces": (SixFaces,), "turns": (SixFaces, Turns), "poses": (Poses,)}
    return [kind(capture) for kind in kinds.get(name or "", ())]


def _calibrated(guides: Guides, output: Path, calibration: Path, place: Place) -> Report:
    """Calibrate from the faces and turns that guides captured, or from the poses in the recording."""
    capture = guides[0].capture
    if guides[0].step == "pose":
        return calibrate(output, output=calibration, place=place)
    capture.save()
    return calibrate(capture.folder, output=calibration)
