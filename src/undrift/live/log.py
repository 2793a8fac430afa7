"""A device that prints text: what its lines hold is found by listening for a few seconds, so that no option need describe it.

The lines are those that ``io/log.py`` reads in a file. Names, or a header, say which channel a number is, and in which unit; what
they do not say is proposed by the size of the readings, as ``undrift info`` does, and noted. Time is the device's own where it
prints one, else by its counter of readings or their order, at a rate by this computer's clock. A serial port is tried at the usual
baud rates until its bytes are text.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlencode

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError, RigTimeout
from undrift.io.guess import example_map
from undrift.io.labelled import label_of, sheet_of
from undrift.io.log import LineReader, LogLine, cycle_of, find_readings, lines_of, log_text, readings_in
from undrift.live.clock import DeviceClock
from undrift.live.decoder import COUNTER, IGNORED, LONGEST_LINE, Decoder, StreamDescription
from undrift.live.transports import GROUP, POLL_S, SOURCES, ByteSource, SerialPort, source_at
from undrift.plugins import split_address
from undrift.record import sample_rate_of

BAUDS = (115_200, 9_600, 921_600, 57_600, 460_800, 230_400, 38_400, 19_200, 1_000_000, 2_000_000)  # the usual first
BYTE_WAYS = ("serial", "tcp", "udp")
SILENCE_S = 6.0  # host s until the first byte: a board that was reset by the connection starts first
LISTEN_S, TRY_S = 3.0, 1.0  # host s of readings, and of one baud rate
GARBAGE = 0.1  # a larger share of bytes that are no text is another baud rate
ANY = StreamDescription(channels=("accel_x", "accel_y", "accel_z"), rate=1.0)  # until it is known
LEARNT_LINES = 256  # among which the shapes of a log are looked for
TICKS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
DESCRIBE = (
    "describe it in the address, as in channels=count,accel_x,accel_y,accel_z&rate=100 (docs/live.md), or record its lines as they "
    "come: `output` walk.log"
)
Pieces = Sequence[tuple[float, bytes]]  # bytes, and when they came, host s


class LogDecoder(Decoder):
    """Lines as firmware prints them, words and all: which shapes make a reading is learnt from the first lines."""

    def __init__(self, description: StreamDescription) -> None:
        super().__init__(description)
        self._first, self._reader = description.separator, LineReader()
        self._begun, self._lines, self._cycle = False, list[LogLine](), list[tuple[str, ...]]()

    def _rows(self, held: bytes, whole: bool) -> FloatArray:
        *lines, self._rest = held.split(b"\n")
        if whole:
            lines, self._rest, self._begun = [*lines, self._rest], b"", True
        elif len(self._rest) > LONGEST_LINE:
            self._rest, self.errors = b"", self.errors + 1
        texts = [line.decode("utf-8", "replace") for line in lines]
        if texts and not self._begun:  # it may be torn
            texts, self._begun = texts[1:], True
        fresh = list(filter(None, map(self._reader.take, texts)))
        self._lines += fresh
        if not self._cycle and not self._learn():
            self._lines = self._lines[-LEARNT_LINES:]
            return np.empty((0, self._width))
        self.errors += sum(line.shape not in self._cycle for line in fresh)
        readings = list(readings_in(self._lines, self._cycle))
        if readings:  # what is behind the last may go on
            last = readings[-1][-1]
            self._lines = self._lines[next(k for k, line in enumerate(self._lines) if line is last) + 1 :]
        stamped = self._width > sum(len(shape) - 2 for shape in self._cycle)
        rows = [
            [*([one[0].stamp_s] if stamped else ()), *(value for line in one for value in line.values)]
            for one in readings
        ]
        return np.array(rows, dtype=float).reshape(-1, self._width)

    def _learn(self) -> bool:
        """Learn the shapes in turn; whether they hold as many numbers as there are channels."""
        cycle = cycle_of(self._lines)
        start = next((k for k, shape in enumerate(cycle) if " ".join(shape[:2]).strip() == self._first), 0)
        cycle = cycle[start:] + cycle[:start]
        numbers = sum(len(shape) - 2 for shape in cycle)
        if fits := bool(cycle) and self._width in (numbers, numbers + 1):
            self._cycle = cycle
        return fits


def described_address(address: str) -> tuple[str, tuple[str, ...]]:
    """Return an address that says what the device sends, and notes; as it is where it says so itself."""
    kind, place, options = split_address(address, "device", SOURCES, GROUP, "name how it is connected")
    stated = dict(options)
    if kind not in BYTE_WAYS or {"channels", "rate", "description", "format"} & stated.keys():
        return address, ()
    source = source_at(address, ANY)
    if not isinstance(source, ByteSource):
        return address, ()
    try:
        pieces, baud = listen(source)
    finally:
        source.close()
    sent, notes = description_of(pieces, source.name, stated)
    sent |= {"baud": str(baud)} if baud and "baud" not in stated else {}
    return f"{kind}:{place}?{urlencode(sent | stated, safe=',/+')}", notes


def listen(source: ByteSource) -> tuple[Pieces, int]:
    """Open a device and return what it sends for some seconds, at the first baud rate at which it is text; 0 for another way."""
    source.open()
    now, port = source.clock.now, source.port
    bauds = dict.fromkeys((port.baud, *BAUDS)) if isinstance(port, SerialPort) else (0,)
    for baud in bauds:
        if baud and baud != port.baud:
            port.set_baud(baud)
        pieces, content, began, last, text = list[tuple[float, bytes]](), b"", now(), now() + SILENCE_S, True
        while now() < last and (text or now() < began + TRY_S):
            if data := source.receive(POLL_S):
                last = last if pieces else now() + LISTEN_S
                pieces.append((now(), data))
                content = (content + data)[-256:]
                garbage = sum(byte > 0x7E or (byte < 0x20 and byte not in b"\t\n\r\x1b") for byte in content)
                text = garbage <= GARBAGE * len(content)
        if not pieces:
            raise RigTimeout(
                f"{source.name}: wanted text within {SILENCE_S:g} s, got nothing; check that the device sends"
            )
        if text:
            return pieces, baud
    raise InputError(
        f"{source.name}: wanted lines of text, got other bytes{f' at {len(bauds)} baud rates' * (len(bauds) > 1)}; {DESCRIBE}"
    )


def description_of(pieces: Pieces, name: str, stated: dict[str, str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Return the options of an address for what was heard of a device, and notes of what no name states."""
    content = b"".join(data for _, data in pieces)
    lines = [line.strip()[:60] for line in content.decode("utf-8", "replace").split("\n")[:-1]]
    sheet, log = sheet_of(Path(name), content), find_readings(content.partition(b"\n")[2])  # the first may be torn
    if log is not None and log.plain and sheet is not None and any(sheet.names) and len(sheet.names) == len(log.names):
        log = replace(log, names=sheet.names)
    if log is None or len(log.names) < 3 or log.names[-1].isdecimal():
        raise InputError(
            f"{name}: wanted lines of numbers with names, got '{next(filter(None, lines[::-1]), '')}'; {DESCRIBE}"
        )
    first = " ".join(cycle_of([*lines_of(content.partition(b"\n")[2])])[0][:2]).strip()
    decoder = LogDecoder(replace(ANY, channels=(*ANY.channels, *[IGNORED] * (len(log.names) - 3)), separator=first))
    rows = [decoder.feed(data) for _, data in pieces]
    values, came = np.concatenate(rows), np.repeat([arrived for arrived, _ in pieces], [len(one) for one in rows])
    named, shown = example_map(log.names, log_text(Path(name), log), ())[:2]  # what a file of these lines would need
    places = {
        channel: [log.names.index(one) for one in (held if isinstance(held, list) else [held]) if one in log.names]
        for channel, held in tomllib.loads(named)["columns"].items()
    }
    units = tomllib.loads(shown)["units"]
    labels = [label_of(one) for one in log.names]
    for channel in {"mag", "temp"} - places.keys():
        columns = [k for k, label in enumerate(labels) if label and label.unit and label.channel == channel]
        places |= {channel: columns} if len(columns) == {"mag": 3, "temp": 1}[channel] else {}
    triads = [places[triad] for triad in ("gyro", "accel") if triad in places]
    if not len(values) or not triads or any(len(columns) != 3 for columns in triads):
        raise InputError(f"{name}: wanted readings of three axes, got '{lines[-1]}'; {DESCRIBE}")
    channels, sent = [IGNORED] * len(log.names), {"format": "log", "separator": first}
    for channel, columns in places.items():
        label = labels[columns[0]]
        units[channel] = stated.get(f"{channel}_unit") or (label.unit if label and label.unit else units[channel])
        if channel in ("gyro", "accel"):
            if units[channel] == "?":
                raise InputError(
                    f"{name}: wanted the unit of its {channel} readings, got '{lines[-1]}'; name it in the address: "
                    f"{name}?{channel}_unit={'dps' if channel == 'gyro' else 'g'}, or record its lines: `output` walk.log"
                )
            sent |= {f"{channel}_unit": units[channel], f"{channel}_gain": f"{label.gain if label else 1.0:g}"}
        if channel != "temp" or units[channel].lower() == "degc":
            for k, axis in zip(columns, ("_x", "_y", "_z") if len(columns) == 3 else ("",), strict=True):
                channels[k] = f"{channel}{axis}"
    clock, notes = _clock_of(values, came, channels, TICKS.get(units.get("time", ""), 0.0))
    why = shown.partition("  # proposed: ")[2]
    taken = ", ".join(f"{channel} in {unit}" for channel, unit in units.items() if f"{channel} by " in why)
    notes += (f"no name states the units; taken: {taken} ({why})",) if why else ()
    return sent | clock | {"channels": ",".join(channels)}, notes


def _clock_of(
    values: FloatArray, came: FloatArray, channels: list[str], tick: float
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Mark the channel that is time or counts; return the options of the clock, and a note of a device without time."""
    steps, time = np.diff(values, axis=0), channels.index("time") if "time" in channels else None
    if time is not None and tick and (steps[:, time] > 0.0).mean() > 0.9:
        channels[time] = COUNTER
        rises = np.flatnonzero(np.diff(values[:, time], prepend=-np.inf) > 0.0)
        rate = sample_rate_of(values[rises, time] * tick)
        return {"tick": f"{tick:g}", "counter_bits": "0" if tick == 1.0 else "32", "rate": f"{rate:.5g}"}, ()
    channels[:] = [IGNORED if channel == "time" else channel for channel in channels]
    counter = next((k for k, one in enumerate(channels) if one == IGNORED and (steps[:, k] == 1.0).mean() > 0.9), None)
    count = np.arange(float(len(came))) if counter is None else values[:, counter] - values[0, counter]
    if counter is not None:
        channels[counter] = COUNTER
    # By this computer's clock: the line below all arrivals, as packets come late and never early
    nominal, line = float(count[-1]) / max(came[-1] - came[0], 1e-3), DeviceClock()
    line.add(count / nominal, came)
    return {"rate": f"{nominal / line.fit().rate:.5g}"}, (
        "the device states no time: times are by this computer's clock",
    )
