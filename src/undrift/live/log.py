"""Description of a device that prints text, determined by listening for a few seconds, so that no options are required.

The lines have the formats that ``io/log.py`` reads from a file. Names or a header determine channels and units. A missing unit is
proposed from the size of the readings, as in ``undrift info``, and reported in a note. If the device prints its time, that time is
used. Otherwise time is derived from its counter or from the order of the readings, with a rate measured with this computer's clock.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast
from urllib.parse import urlencode

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError, RigTimeout
from undrift.io.guess import MapProposal, propose, sample_of
from undrift.io.labels import Label, label_of
from undrift.io.log import LineReader, LogLine, SerialLog, cycle_of, find_readings, lines_of, log_text, readings_in
from undrift.io.text import find_table
from undrift.live.clock import DeviceClock
from undrift.live.decoder import COUNTER, IGNORED, Decoder, StreamDescription
from undrift.live.transports import POLL_S, ByteSource, SerialPort, device_address, source_at
from undrift.record import sample_rate_of

BYTE_WAYS = ("serial", "tcp", "udp")
SILENCE_S = 6.0  # longest wait for the first byte, host s (some boards restart when a connection is opened)
LISTEN_S = 3.0  # time to listen, host s
GARBAGE = 0.1  # largest fraction of bytes that are not text
ANY = StreamDescription(
    channels=("accel_x", "accel_y", "accel_z"), rate=1.0
)  # placeholder until the description is known
LEARNT_LINES = 256  # number of lines to learn the shapes of a log from
TICKS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
DESCRIBE = (
    "Describe it in the address, for example with channels=count,accel_x,accel_y,accel_z&rate=100 (docs/live.md), or save its "
    "lines with a terminal program, and read that file"
)
Pieces = Sequence[tuple[float, bytes]]  # time of arrival, host s, and bytes


class LogDecoder(Decoder):
    """Decoder of text lines with words and numbers. It learns the shapes of a reading from the first lines."""

    def __init__(self, description: StreamDescription) -> None:
        super().__init__(description)
        self._first, self._reader = description.separator, LineReader()
        self._unread, self._cycle = list[LogLine](), list[tuple[str, ...]]()

    def _rows(self, buffer: bytes, is_datagram: bool) -> FloatArray:
        texts = [line.decode("utf-8", "replace") for line in self._lines(buffer, is_datagram)]
        if texts and not self._begun:  # the first line may be incomplete
            texts, self._begun = texts[1:], True
        fresh = list(filter(None, map(self._reader.take, texts)))
        self._unread += fresh
        if not self._cycle and not self._learn():
            self._unread = self._unread[-LEARNT_LINES:]
            return np.empty((0, self._width))
        self.errors += sum(line.shape not in self._cycle for line in fresh)
        readings = list(readings_in(self._unread, self._cycle))
        if readings:  # lines after the last reading may continue
            last = readings[-1][-1]
            self._unread = self._unread[next(k for k, line in enumerate(self._unread) if line is last) + 1 :]
        stamped = self._width > sum(len(shape) - 2 for shape in self._cycle)
        rows = [
            [*([reading[0].stamp_s] if stamped else ()), *(value for line in reading for value in line.values)]
            for reading in readings
        ]
        return np.array(rows, dtype=float).reshape(-1, self._width)

    def _learn(self) -> bool:
        """Learn the sequence of line shapes. Return True if their count of numbers matches the channels."""
        cycle = cycle_of(self._unread)
        start = next((k for k, shape in enumerate(cycle) if " ".join(shape[:2]).strip() == self._first), 0)
        cycle = cycle[start:] + cycle[:start]
        numbers = sum(len(shape) - 2 for shape in cycle)
        if fits := bool(cycle) and self._width in (numbers, numbers + 1):
            self._cycle = cycle
        return fits


def described_address(address: str) -> tuple[str, tuple[str, ...]]:
    """Return an address with a description of the device, and notes. An address that has a description is not changed."""
    kind, place, options = device_address(address)
    given_options = dict(options)
    if kind not in BYTE_WAYS or {"channels", "rate", "format"} & given_options.keys():
        return address, ()
    source = cast(ByteSource, source_at(f"{address}{'&' if options else '?'}channels={','.join(ANY.channels)}&rate=1"))
    try:
        pieces = listen(source)
    finally:
        source.close()
    stream_options, notes = description_of(pieces, source.name, given_options)
    return f"{kind}:{place}?{urlencode(stream_options | given_options, safe=',/+')}", notes


def listen(source: ByteSource) -> Pieces:
    """Open a device and return its bytes of a few seconds, which must be text."""
    source.open()
    now, pieces = source.clock.now, list[tuple[float, bytes]]()
    last = now() + SILENCE_S
    while now() < last:
        if data := source.receive(POLL_S):
            last = last if pieces else now() + LISTEN_S
            pieces.append((now(), data))
    if not pieces:
        raise RigTimeout(f"{source.name}: no text within {SILENCE_S:g} s. Check that the device sends.")
    content = b"".join(data for _, data in pieces)
    garbage = sum(byte > 0x7E or (byte < 0x20 and byte not in b"\t\n\r\x1b") for byte in content)
    if garbage > GARBAGE * len(content):
        baud = ""
        if isinstance(source.port, SerialPort):
            baud = f" at {source.port.baud} baud. Set another baud rate in the address: {source.name}?baud=9600"
        raise InputError(f"{source.name}: the bytes are not lines of text{baud}. {DESCRIBE}")
    return pieces


def description_of(pieces: Pieces, name: str, given_options: dict[str, str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """Return the options of an address for the bytes from a device, and notes on proposed units and times."""
    log, first_words, last_line = _log_of(pieces, name)
    channels = [IGNORED] * len(log.names)
    values, arrival_s = _readings_of(pieces, first_words, len(channels))
    text = log_text(Path(name), log)
    proposal = propose(sample_of(text), text)  # as for a log file
    labels = [label_of(column) for column in log.names]
    columns_of = _columns_of(proposal, log.names, labels)
    triads = [columns_of[triad] for triad in ("gyro", "accel") if triad in columns_of]
    if not len(values) or not triads or any(len(columns) != 3 for columns in triads):
        raise InputError(f"{name}: expected readings of three axes, got '{last_line}'. {DESCRIBE}")

    options, units = {"format": "log", "separator": first_words}, dict[str, str]()
    for channel, columns in columns_of.items():
        label = labels[columns[0]]
        unit = label.unit if label and label.unit else proposal.units[channel]
        units[channel] = given_options.get(f"{channel}_unit", unit)
        if channel in ("gyro", "accel"):
            if units[channel] == "?":
                raise InputError(
                    f"{name}: the unit of its {channel} readings is unknown, got '{last_line}'. Set it in the address: "
                    f"{name}?{channel}_unit={'dps' if channel == 'gyro' else 'g'}, or save its lines with a terminal program"
                )
            options[f"{channel}_unit"] = units[channel]
            options[f"{channel}_gain"] = f"{label.gain if label else 1.0:g}"
        if channel != "temp" or units[channel].lower() == "degc":
            for k, axis in zip(columns, ("_x", "_y", "_z") if len(columns) == 3 else ("",), strict=True):
                channels[k] = f"{channel}{axis}"
    clock, notes = _clock_of(values, arrival_s, channels, TICKS.get(units.get("time", ""), 0.0))
    if proposal.reasons:
        proposed = ", ".join(f"{channel} in {units[channel]}" for channel in units if channel in proposal.reasons)
        reason = "; ".join(f"{channel} by {why}" for channel, why in proposal.reasons.items())
        notes += (f"the names do not contain the units, so these are proposed: {proposed} ({reason})",)
    return options | clock | {"channels": ",".join(channels)}, notes


def _log_of(pieces: Pieces, name: str) -> tuple[SerialLog, str, str]:
    """Return the readings in the bytes from a device, the words before the first number of a reading, and the last line."""
    content = b"".join(data for _, data in pieces)
    whole_lines = content.partition(b"\n")[2]  # the first line may be incomplete
    lines = [line.strip()[:60] for line in content.decode("utf-8", "replace").split("\n")[:-1]]
    last_line = next(filter(None, reversed(lines)), "")
    log, table = find_readings(whole_lines), find_table(Path(name), content)
    if (
        log is not None
        and log.plain
        and table is not None
        and table.layout.header
        and len(table.names) == len(log.names)
    ):
        log = replace(log, names=table.names)
    if log is None or len(log.names) < 3 or log.names[-1].isdecimal():
        raise InputError(f"{name}: expected lines of numbers with names, got '{last_line}'. {DESCRIBE}")
    first_shape = cycle_of([*lines_of(whole_lines)])[0]
    return log, " ".join(first_shape[:2]).strip(), last_line


def _readings_of(pieces: Pieces, first_words: str, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the readings (N, count) in the bytes, and their times of arrival (N,), host s."""
    unused = (IGNORED,) * (count - len(ANY.channels))
    decoder = LogDecoder(replace(ANY, channels=(*ANY.channels, *unused), separator=first_words))
    blocks = [decoder.feed(data) for _, data in pieces]
    arrival_s = np.repeat([arrived for arrived, _ in pieces], [len(block) for block in blocks])
    return np.concatenate(blocks), arrival_s


def _columns_of(proposal: MapProposal, names: Sequence[str], labels: Sequence[Label | None]) -> dict[str, list[int]]:
    """Return the columns of each channel: the proposed columns, and a magnetometer or thermometer whose names contain its unit."""
    columns_of = dict[str, list[int]]()
    for channel, entry in proposal.columns.items():
        listed = entry if isinstance(entry, list) else [entry]
        columns_of[channel] = [names.index(column) for column in listed if column in names]
    for channel, count in (("mag", 3), ("temp", 1)):
        columns = [k for k, label in enumerate(labels) if label and label.unit and label.channel == channel]
        if channel not in columns_of and len(columns) == count:
            columns_of[channel] = columns
    return columns_of


def _clock_of(
    values: FloatArray, arrival_s: FloatArray, channels: list[str], tick: float
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Mark the channel of time or counter. Return the options of the clock, and a note for a device without time."""
    steps, time = np.diff(values, axis=0), channels.index("time") if "time" in channels else None
    if time is not None and tick and (steps[:, time] > 0.0).mean() > 0.9:
        channels[time] = COUNTER
        rises = np.flatnonzero(np.diff(values[:, time], prepend=-np.inf) > 0.0)
        rate = sample_rate_of(values[rises, time] * tick)
        return {"tick": f"{tick:g}", "counter_bits": "0" if tick == 1.0 else "32", "rate": f"{rate:.5g}"}, ()
    channels[:] = [IGNORED if channel == "time" else channel for channel in channels]
    counter = next(
        (k for k, name in enumerate(channels) if name == IGNORED and (steps[:, k] == 1.0).mean() > 0.9), None
    )
    count = np.arange(float(len(arrival_s))) if counter is None else values[:, counter] - values[0, counter]
    if counter is not None:
        channels[counter] = COUNTER
    # rate from this computer's clock: the line below all arrivals, as packets arrive late but never early
    nominal, line = float(count[-1]) / max(arrival_s[-1] - arrival_s[0], 1e-3), DeviceClock()
    for k in np.flatnonzero(np.diff(arrival_s, append=np.inf) > 0.0):  # the last reading of each piece
        line.add(count[k] / nominal, arrival_s[k])
    return {"rate": f"{nominal / line.fit().rate:.5g}"}, (
        "the device prints no time, so times are from this computer's clock",
    )
