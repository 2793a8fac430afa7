"""``undrift record``: record a device to a file, optionally with a guide through the poses of a calibration.

Readings are appended to a CSV. It is complete after each second, even if a cable, a full disk or a power cut ends the
recording. At the end, it is converted to the requested file. The format of a device's output is determined by listening
(``live/log.py``).
"""

import math
import signal
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self, TypeAlias

from undrift.base.options import OptionalOutput, verb
from undrift.base.summary import Section, Summary, summary_of
from undrift.commands import Screen
from undrift.commands.files import Place, check_output
from undrift.errors import InputError, LinkError, UndriftError

if TYPE_CHECKING:
    from undrift.commands.bench.guides import Guide
    from undrift.commands.bench.source import Status
    from undrift.record import Record

LOOK_S = 0.2  # between two looks at the device, host s
LOG_S = 5.0  # of the recording between two lines if there is no terminal
FIRST_S, LOST_S = 6.0, 10.0  # host s for the first reading (a board may restart), and for a lost device
CLOCK_S = 10.0  # of a recording that shows the rate of a device without time better than listening did
PAUSE_S = 1.0  # host s without readings that are not mentioned
RATE_S = 2.0  # of a recording after which its rate is shown
NOW_S, MOST_S = 0.5, 100.0  # of readings for the displayed mean, and of readings in one step of a guide
LINES = (".log", ".txt")  # as they come
FORMATS = (".parquet", ".csv", ".csv.gz", *LINES)
HOW = {
    "face": "Faces: lay it on each of its six faces, on a level table, and let go. Each is captured by itself, in any order.",
    "turn": "Turns: lay it along a straight edge. Turn it once on the table, as seen from above, back to the edge, and let go.",
    "pose": "Poses: lay or lean it in 15 poses of any kind, 30 deg apart, and let go. Each is captured by itself.",
}
LISTED = {  # possible sources: in words, and the option to name a source
    "serial_ports": ("Serial ports", "port"),
    "lsl_streams": ("LSL streams", "name"),
}
Guides: TypeAlias = "Sequence[Guide]"


@verb
def record(
    address: str | None = None,
    /,
    *,
    output: OptionalOutput = None,
    port: str | None = None,
    lsl: str | None = None,
    udp: str | None = None,
    guide: Literal["six-faces", "turns", "poses"] | None = None,
    duration_s: float = math.inf,
    place: Place = Place(),
    screen: Screen = Screen(),
) -> Summary:
    """Record a device until Ctrl-C. Without device and file, list serial ports and LSL streams.

    Parameters
    ----------
    address : str or None
        A serial port, or another address (docs/live.md): tcp://host:port. The format of text lines is determined by
        listening.
    output : Path or None
        File to write: .parquet, .csv or .csv.gz. A .log or .txt file contains the lines of the device, each with a time
        stamp.
    port : str or None
        Serial port, for example /dev/ttyUSB0, COM3 or /dev/ttyUSB0?baud=9600. The default is 115200 baud.
    lsl : str or None
        Stream of the Lab Streaming Layer with its content: NAME?channels=...&rate=100
    udp : str or None
        Port of this computer to which the device sends.
    guide : str or None
        Guide through the poses of a calibration, then calibrate: six-faces (accelerometers), turns (the faces, then
        turns by hand, for both sensors) or poses (15 arbitrary poses).
    duration_s : float
        Longest time to record, s.
    """
    ways = {"serial://": port, "lsl:": lsl, "udp://:": udp, "": address}
    addresses = [f"{kind}{value}" for kind, value in ways.items() if value is not None]
    if not addresses and output is None:
        return _senders(screen)
    where = address_of(addresses)
    if output is None:
        raise InputError(f"record: expected a file to write, got none. Add `output` walk.parquet to record {where}.")
    check_output(output, endings=FORMATS)
    folder = output.with_name(output.name.partition(".")[0])
    calibration = folder.with_name(f"{folder.name}.json")
    for path in (output, *((folder, calibration) if guide else ())):
        if path.exists():
            raise InputError(
                f"{path}: the file exists already, and recordings are never overwritten. Choose another name."
            )
    if output.suffix in LINES:
        if guide is not None:
            raise InputError(
                f"`guide`: expected a file of readings, got {output}, a file of lines. Set `output` to walk.parquet."
            )
        return _record_lines(where, output, duration_s, screen)
    recording = _Recording(where, output, screen)
    guides = _guides(guide, folder, place)
    screen.say(*(HOW[step_guide.step] for step_guide in guides))
    record, status = recording.run(guides, duration_s)
    summary = recording.summary(record, status)
    if guides and all(step_guide.complete for step_guide in guides):
        calibrated = _calibrated(guides, output, calibration, place)
        sections = (Section(title="Recording", text=(summary.answer,)), *calibrated.sections)
        notes, written = (*summary.notes, *calibrated.notes), (output, *calibrated.written)
        return replace(
            calibrated,
            data={**calibrated.data, "recording": summary.data},
            sections=sections,
            notes=notes,
            written=written,
        )
    done = ", ".join(f"{len(step_guide.done)} of {len(step_guide.order)} {step_guide.step}s" for step_guide in guides)
    abandoned = (f"the guide was left at {done}: nothing was calibrated",) if guides else ()
    return replace(summary, notes=(*summary.notes, *abandoned))


def address_of(addresses: list[str]) -> str:
    """Return the address of the one device that is named, or of the only port."""
    from undrift.live.transports import serial_ports

    candidates = addresses or [f"serial://{name}" for name, _ in serial_ports()]
    if len(candidates) != 1:
        raise InputError(
            f"record: expected one device, got {len(candidates)} ({', '.join(candidates)}). Choose one with `port` NAME."
        )
    return (
        f"serial://{candidates[0]}"
        if candidates[0].startswith("/") or candidates[0].upper().startswith("COM")
        else candidates[0]
    )


def _senders(screen: Screen) -> Summary:
    """List the available devices, and the reasons why some kinds could not be searched."""
    from undrift.live import transports

    screen.over("Looking for serial ports and LSL streams ...")
    listed, notes = dict[str, list[tuple[str, str]]](), list[str]()
    for way in LISTED:
        try:
            listed[way] = getattr(transports, way)()
        except LinkError as error:
            listed[way], notes = [], [*notes, str(error)]
    screen.over("")
    counts = (f"{title}: {len(listed[way])}" for way, (title, _) in LISTED.items())
    none = "Nothing was found that can be recorded: connect the device, or name its address."
    return Summary(
        title="What can be recorded",
        answer=f"{', '.join(counts)}." if any(listed.values()) else none,
        data={way: [{head: name, "device": text} for name, text in listed[way]] for way, (_, head) in LISTED.items()},
        sections=tuple(
            Section(title=title, columns=(head, "device"), rows=tuple(listed[way]), words=True)
            for way, (title, head) in LISTED.items() if listed[way]
        ),
        notes=tuple(notes),
        next=("record", "--port", listed["serial_ports"][0][0], "-o", "walk.parquet") if listed["serial_ports"] else (),
    )  # fmt: skip


def _record_lines(where: str, output: Path, duration_s: float, screen: Screen) -> Summary:
    """Write the lines of a device as they come, the time since the first before each."""
    from undrift.io.text import Appender
    from undrift.live.log import ANY, BYTE_WAYS, listen
    from undrift.live.transports import POLL_S, ByteSource, source_at

    source = source_at(where, ANY)
    if where.partition(":")[0] not in BYTE_WAYS or not isinstance(source, ByteSource):
        raise InputError(
            f"{where}: only a device that prints lines can be recorded as lines. Set `output` to walk.parquet."
        )
    screen.over(f"Listening to {where} ...")
    ended, count, stamp, rest = "stopped", 0, 0.0, b""
    try:
        with Appender(output) as file:
            pieces = list(listen(source))
            began = pieces[0][0]
            screen.over("")
            screen.say(f"Recording the lines of {source.name}. Ctrl-C ends it.")
            while source.clock.now() - began < duration_s:
                text = list[bytes]()
                for arrived, data in pieces:
                    *lines, rest = (rest + data).split(b"\n")
                    for line in lines:
                        stamp = max(arrived - began, stamp + 1e-6)
                        text.append(b"[%12.6f] %s\n" % (stamp, line.rstrip(b"\r")))
                file.append(b"".join(text))
                count += len(text)
                screen.over(f"{stamp:7.1f} s   {count} lines", step=int(stamp / LOG_S))
                data = source.receive(POLL_S)
                pieces = [(source.clock.now(), data)] if data else []
            ended = "time"
    except KeyboardInterrupt:
        ended = "stopped"
    except UndriftError as error:  # a cable, a full disk
        if count:
            raise type(error)(f"{error} (the {count} lines until then are in {output})") from error
        raise
    finally:
        screen.over("")
        source.close()
    return Summary(
        title=f"Lines of {source.name}",
        answer=f"{count} lines recorded in {stamp:.1f} s.",
        data={"address": where, "output": str(output), "ended": ended, "seconds": stamp, "lines": count},
        written=(output,),
        next=("info", output),
    )


class _CtrlC:
    """The first Ctrl-C ends a recording. Further signals shortly after, or while the file is written, are ignored."""

    def __init__(self) -> None:
        self.deaf, self._before = False, signal.getsignal(signal.SIGINT)
        alone = threading.current_thread() is threading.main_thread()
        self._hears = alone and callable(self._before)  # not where it is ignored (nohup)

    def __enter__(self) -> Self:
        if self._hears:
            signal.signal(signal.SIGINT, self._heard)
        return self

    def __exit__(self, *_: object) -> None:
        if self._hears:
            signal.signal(signal.SIGINT, self._before)

    def _heard(self, *_: object) -> None:
        if not self.deaf:
            self.deaf = True
            raise KeyboardInterrupt


class _Recording:
    """One recording, from the first look at the device to the file."""

    def __init__(self, address: str, output: Path, screen: Screen) -> None:
        from undrift.commands.bench.source import LiveDevice
        from undrift.live.log import described_address

        screen.over(f"Listening to {address} ...")
        self.address, self.notes = described_address(address)
        self.listened, self.shown = self.address != address, ""
        self.source, self.screen, self.output, self.ended = LiveDevice(self.address, FIRST_S), screen, output, "stopped"
        self.began = datetime.now(UTC).isoformat(timespec="milliseconds")
        self.file = output if output.name.endswith(".csv") else output.with_name(f"{output.name}.csv")
        screen.over("")
        notes, source = (f"  note: {note}" for note in self.notes), self.source.recorder.source
        sent, triads = source.description, {name.partition("_")[0] for name in source.description.measured}
        units = {"gyro": sent.gyro_unit, "accel": sent.accel_unit, "mag": "uT", "temp": "degC"}
        channels = ", ".join(f"{name} in {unit}" for name, unit in units.items() if name in triads)
        screen.say(f"Recording {source.name}: {channels}, {sent.rate:g} Hz. Ctrl-C ends it.", *notes)

    def run(self, guides: Guides, duration_s: float) -> "tuple[Record, Status]":
        """Record until the end, and write the file. Errors that end it early are raised with the state of the file."""
        with _CtrlC() as ctrl_c:
            return self._run(guides, duration_s, ctrl_c)

    def _run(self, guides: Guides, duration_s: float, ctrl_c: _CtrlC) -> "tuple[Record, Status]":
        self.source.write_to(self.file)
        try:
            self.source.start()
            self.ended = self._watch(guides, duration_s)
        except KeyboardInterrupt:
            self.ended = "stopped"
        finally:
            ctrl_c.deaf = True
            self.screen.over(self.shown, last=True)
            status, full = self.source.status(), ""
            try:
                self.source.stop()
            except InputError as error:
                full = str(error)
        full = full or status.file_error
        try:
            record, where, failed = self._read_back(full)
        except UndriftError as error:
            got = (
                full
                or f"{self.source.name}: fewer than two readings arrived before the recording was stopped. Try again."
            )
            raise InputError(got) from error
        remaining = f"the {record.duration_s:.1f} s until then are in {where}"
        if failed:
            raise InputError(f"{failed} ({remaining})")
        if self.ended == "lost":
            raise LinkError(f"{status.error} ({remaining})")
        return record, status

    def summary(self, record: "Record", status: "Status") -> Summary:
        """Return how long and how complete a recording is."""
        lost, garbled, rate_hz = status.lost, status.garbled, record.sample_rate_hz
        data = {"address": self.address, "output": str(self.output), "ended": self.ended, "seconds": record.duration_s}
        return Summary(
            title=f"Recording {self.output.name}",
            answer=f"{record.duration_s:.1f} s recorded at {rate_hz:.5g} Hz: {lost} of {status.readings + lost} readings lost, "
            f"{garbled} damaged ones left out.",
            data=data | {"sample_rate_hz": rate_hz, "readings": len(record), "lost": lost, "garbled": garbled},
            sections=(Section(title="Address", text=(f"address: {self.address}",), folded=True),),
            notes=self.notes,
            written=(self.output,),
            next=("info", self.output),
        )

    def _read_back(self, full: str) -> "tuple[Record, Path, str]":
        """Return all readings, their file, and the reason if it is not the requested file."""
        from undrift.io.column_map import ColumnMap
        from undrift.io.formats import read_record
        from undrift.io.write import write_record_as

        description, timeline = self.source.recorder.source.description, self.source.recorder.timeline
        record = replace(read_record(self.file, ColumnMap(gaps="keep")), device=description.device)
        # A rate that was found in seconds is better known now, by this computer's clock
        if (
            self.listened
            and not description.tick
            and record.duration_s > CLOCK_S
            and (clock := timeline.clock()).settled
        ):
            record = replace(record, time=record.time * clock.rate * description.clock_speed)
        try:
            if not full:
                write_record_as(record, self.output, {"address": self.address, "began": self.began})
        except InputError as error:
            full = str(error)
        if full:
            return record, self.file, full
        if self.file != self.output:
            self.file.unlink()
        return record, self.output, ""

    def _watch(self, guides: Guides, duration_s: float) -> str:
        """Show the readings and the instructions of a guide until the end. Return the reason of the end."""
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


def _line(status: "Status", newest: "Record | None") -> str:
    """Return how the recording is doing, in a line."""
    import numpy as np

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
    from undrift.commands.bench.capture import Capture
    from undrift.commands.bench.guides import Poses, SixFaces, Turns
    from undrift.io.session import gravity_of

    gravity, how = gravity_of(place.gravity_m_s2, place.latitude_deg, place.height_m)
    capture = Capture(folder, place.serial, gravity_m_s2=None if how == "standard" else gravity)
    kinds = {"six-faces": (SixFaces,), "turns": (SixFaces, Turns), "poses": (Poses,)}
    return [kind(capture) for kind in kinds.get(name or "", ())]


def _calibrated(guides: Guides, output: Path, calibration: Path, place: Place) -> Summary:
    """Calibrate by the faces and turns that guides captured, or by the poses in the recording."""
    from undrift.commands.calibrate import calibrate

    capture = guides[0].capture
    if guides[0].step == "pose":
        return summary_of(calibrate(output, output=calibration, place=place))
    capture.save()
    return summary_of(calibrate(capture.folder, output=calibration))
