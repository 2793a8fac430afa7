"""Decoders, which convert bytes to rows of numbers. Corrupted readings are counted and omitted, without an error.

A StreamDescription contains the channels in their order, their units and the framing. It is part of an address,
``tcp://host:port?channels=count,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,temp&rate=100&gyro_unit=count``.
"""

import binascii
import re
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import reduce
from operator import xor
from typing import Annotated, Any, Literal

import numpy as np

from undrift.arrays import FloatArray, Shape, freeze
from undrift.errors import InputError, check_choices, check_positive
from undrift.plugins import typed_options
from undrift.record import Record
from undrift.units import canonical_unit

# ---- Checksums after readings: ``xor`` as in NMEA 0183, and ``crc16`` (CRC-16/CCITT-FALSE, 0x1021 from 0xFFFF). For "123456789"
# they are 0x31 and 0x29B1.


CHECKSUMS: dict[
    str, tuple[Callable[[bytes], int], int]
] = {  # function from bytes to number, and size of the number, bytes
    "none": (lambda data: 0, 0),
    "xor": (lambda data: reduce(xor, data, 0), 1),
    "crc16": (lambda data: binascii.crc_hqx(data, 0xFFFF), 2),
}


# ---- StreamDescription: channels, units and framing of the stream of a device.

COUNTER, IGNORED = "count", "-"
TRIADS = ("gyro", "accel", "mag")
MEASURED = (*(f"{triad}_{axis}" for triad in TRIADS for axis in "xyz"), "temp")


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamDescription:
    """Channels, units and framing of a stream of readings."""

    # channels in order: gyro_x .. accel_z, mag_x (uT), temp, ``count`` (counter of the device) or ``-`` (omitted)
    channels: tuple[str, ...] = (COUNTER, *MEASURED[:6])
    rate: float = 0.0  # nominal sample rate, Hz of the device's clock
    gyro_unit: str = "count"  # unit: rad/s, dps, count or v
    accel_unit: str = "count"  # unit: m/s2, g, mg, count or v
    gyro_gain: float = (
        1.0  # size of a step of the numbers in that unit, for example 0.061 for a device that sends codes
    )
    accel_gain: float = 1.0  # size of a step of the numbers in that unit
    temp_scale: float = 1.0  # temperature in degC = temp_scale * number + temp_zero
    temp_zero: float = 0.0  # temperature of the number 0, degC
    tick: float = 0.0  # device seconds per step of the counter (0 for a counter of readings)
    counter_bits: int = 0  # width of the counter (0 for a counter that never wraps)
    format: Literal["line", "frame", "log"] = (
        "line"  # line (only numbers), frame (binary) or log (any text of io/log.py)
    )
    separator: str = ","  # separator of the numbers in a line, or in a log the words before a reading's first number
    checksum: Literal["none", "xor", "crc16"] = (
        "none"  # none, xor or crc16, after a line as ``*hex`` and after a frame as bytes
    )
    sync: str = "aa55"  # first bytes of a frame, hex
    # fields of a frame in the format of Python's struct, with one field per channel, < or > for the byte order
    pack: str = ""
    clock_speed: float = 1.0  # device seconds per host second (1 for hardware)
    device: str = ""  # serial number or name

    def __post_init__(self) -> None:
        self._check_channels()
        check_positive(self, "stream", "Set a positive value", "rate", "clock_speed")
        check_positive(self, "stream", "Set the unit per step", "gyro_gain", "accel_gain")
        object.__setattr__(self, "gyro_unit", canonical_unit(self.gyro_unit, "rate"))
        object.__setattr__(self, "accel_unit", canonical_unit(self.accel_unit, "accel"))
        check_choices(self, "stream")
        if not 0 <= self.counter_bits <= 53 or self.tick < 0.0:
            raise InputError(
                f"stream: counter_bits must be 0 to 53 and tick 0 or more, got {self.counter_bits} and {self.tick:g}. "
                "Check the device's manual."
            )

    @property
    def measured(self) -> tuple[str, ...]:
        """Return the measured channels, in the order of a chunk's values."""
        return tuple(name for name in self.channels if name not in (COUNTER, IGNORED))

    @property
    def has_counter(self) -> bool:
        """Return True if the device sends a counter."""
        return COUNTER in self.channels

    @property
    def tick_s(self) -> float:
        """Return the device seconds per step of the counter."""
        return self.tick if self.has_counter and self.tick > 0.0 else 1.0 / self.rate

    def record(self, time: FloatArray, values: FloatArray) -> Record:
        """Return a record of the readings, from time (N,), s, and values (N, C)."""
        column_of = {name: column for column, name in enumerate(self.measured)}

        def triad(name: str, gain: float = 1.0) -> FloatArray | None:
            names = [f"{name}_{axis}" for axis in "xyz"]
            return values[:, [column_of[channel] for channel in names]] * gain if names[0] in column_of else None

        return Record(
            time=time,
            gyro=triad("gyro", self.gyro_gain),
            accel=triad("accel", self.accel_gain),
            mag_ut=triad("mag"),
            temp_c=values[:, column_of["temp"]] * self.temp_scale + self.temp_zero if "temp" in column_of else None,
            gyro_unit=self.gyro_unit,
            accel_unit=self.accel_unit,
            device=self.device,
        )

    def text_of(self, reading: FloatArray) -> str:
        """Return a reading (C,) as text."""
        return "  ".join(f"{name} {value:.6g}" for name, value in zip(self.measured, reading.tolist(), strict=True))

    def split(self, rows: FloatArray) -> tuple[FloatArray | None, FloatArray]:
        """Split decoded rows (N, K) into counter (N,), or None without counter, and measured values (N, C)."""
        columns = [column for column, name in enumerate(self.channels) if name not in (COUNTER, IGNORED)]
        counter = rows[:, self.channels.index(COUNTER)] if self.has_counter else None
        return counter, np.ascontiguousarray(rows[:, columns])

    def _check_channels(self) -> None:
        names, accepted = [name for name in self.channels if name != IGNORED], (COUNTER, IGNORED, *MEASURED)
        for name in names:
            if name not in accepted or names.count(name) > 1:
                raise InputError(
                    f"stream: channels must be among {', '.join(accepted)}, each at most once, got '{name}'. Correct the list."
                )
        for triad in TRIADS:
            axis_count = sum(name.startswith(triad) for name in names)
            if axis_count not in (0, 3):
                raise InputError(f"stream: {triad} requires all three axes, got {axis_count}. List x, y and z.")
        if not any(name.startswith(("gyro", "accel")) for name in names):
            raise InputError("stream: no channel of gyro or accel. List the channels that the device sends.")


TYPES: dict[str, Any] = {field.name: type(field.default) for field in fields(StreamDescription)}
TYPES["channels"] = lambda text: tuple(text.split(","))


def described(options: Mapping[str, str]) -> StreamDescription:
    """Return the description in the options of an address."""
    return StreamDescription(**typed_options(tuple(options.items()), TYPES, "stream"))


# ---- Counters: the device's counter without wraps and restarts.

RESTART_S = 2.0
SILENCE_S = 0.25


class Counter:
    """Converter of the device's counter to a count without wraps.

    A counter with b bits wraps at 2^b. The number of wraps in a silence is estimated from the host's clock. A small step back is a
    late or duplicate reading, which is omitted. A step that differs from the host's clock by more than ``RESTART_S`` is a restart
    of the device. The count then continues with the value expected from the host's clock.
    """

    def __init__(self, bits: int, tick_s: float, clock_speed: float = 1.0) -> None:
        self._modulus, self._tick_s, self._speed = 2.0**bits if bits else 0.0, tick_s, clock_speed
        self._last: tuple[float, float] | None = None  # last counter and its time of arrival, host s
        self._total = -1.0

    def unwrap(self, raw: FloatArray, host_time: float) -> FloatArray:
        """Return increasing counts (N,) of readings that arrive at a time, host s. Late and repeated readings are NaN."""
        return np.array([self._next(value, host_time) for value in raw.tolist()])

    def _next(self, raw: float, host_time: float) -> float:
        before, before_s = self._last or (raw - 1.0, host_time)
        step, expected = raw - before, (host_time - before_s) * self._speed / self._tick_s
        if self._modulus:
            step = (step + self._modulus / 2.0) % self._modulus - self._modulus / 2.0
            step += max(round((expected - step) / self._modulus), 0) * self._modulus
        if step <= 0.0 and -step * self._tick_s < RESTART_S:
            return np.nan
        if abs(step - expected) > RESTART_S * max(self._speed, 1.0) / self._tick_s + 0.1 * abs(expected):
            step = max(round(expected), 1.0)
        self._last, self._total = (raw, host_time), self._total + step
        return self._total


class Arrivals:
    """Counter of readings for a device without counter, which includes the readings lost in a silence."""

    def __init__(self, rate: float, clock_speed: float = 1.0) -> None:
        self._per_host_s = rate * clock_speed
        self._total, self._host = -1.0, np.inf  # last count, and its time of arrival, host s

    def count(self, number: int, host_time: float) -> FloatArray:
        """Return the counts (N,) of readings that arrive at a time, host s."""
        silent_s = host_time - self._host
        due = silent_s * self._per_host_s
        lost = round(due - number) if silent_s > SILENCE_S and number < due / 2.0 else 0
        counts: FloatArray = self._total + lost + np.arange(1.0, number + 1.0)
        self._total, self._host = float(counts[-1]), host_time
        return counts


# ---- Chunk: readings as they arrived.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chunk:
    """N readings that arrived together, N > 0."""

    host_time: float  # time of arrival on the host's monotonic clock, s
    # (N,), counter of the device, ticks, or None for a device without counter
    counter: Annotated[FloatArray | None, Shape("n")]
    # (N, C), raw readings in the order of ``StreamDescription.measured``, in the device's units
    values: Annotated[FloatArray, Shape("n", "c")]

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.values)


# ---- Decoders.

LONGEST_LINE = 4096


class Decoder(ABC):
    """Base class of decoders. A subclass finds the rows in the received bytes."""

    def __init__(self, description: StreamDescription) -> None:
        self.errors = 0
        self._width = len(description.channels)
        self._checksum_of, self._checksum_size = CHECKSUMS[description.checksum]
        self._rest = b""
        self._begun = False  # False until the first line or frame, which may be incomplete

    def feed(self, data: bytes, *, whole: bool = False) -> FloatArray:
        """Add bytes and return the completed rows, (N, K). `whole` marks a datagram, after which no bytes are stored."""
        rows = self._rows(self._rest + data, whole)
        valid = finite(rows)
        self.errors += len(rows) - len(valid)
        return valid

    def _lines(self, buffer: bytes, is_datagram: bool) -> list[bytes]:
        """Return the complete lines in the buffer, and store the incomplete rest."""
        *lines, self._rest = buffer.split(b"\n")
        if is_datagram:
            lines, self._rest, self._begun = [*lines, self._rest], b"", True
        elif len(self._rest) > LONGEST_LINE:
            self._rest, self.errors = b"", self.errors + 1
        return lines

    @abstractmethod
    def _rows(self, buffer: bytes, is_datagram: bool) -> FloatArray:
        """Return the complete rows in the buffer, and store the incomplete rest."""


class LineDecoder(Decoder):
    """Decoder of lines of numbers, ``12,0.5,-3`` or ``$12,0.5,-3*5C`` with a checksum of the text between $ and *."""

    def __init__(self, description: StreamDescription) -> None:
        super().__init__(description)
        self._separator = description.separator.encode("ascii", errors="replace")
        if not self._separator:
            raise InputError("stream: no separator between the numbers of a line. Set `separator`.")

    def _rows(self, buffer: bytes, is_datagram: bool) -> FloatArray:
        rows = []
        for line in map(bytes.strip, self._lines(buffer, is_datagram)):
            row = self._row(line)
            if row is not None:
                rows.append(row)
            elif line and self._begun:
                self.errors += 1
            self._begun = True
        return np.array(rows, dtype=float).reshape(-1, self._width)

    def _row(self, line: bytes) -> list[float] | None:
        """Return the numbers of a line, or None if the line is corrupted."""
        line = line.removeprefix(b"$")
        try:
            if self._checksum_size:
                line, _, checksum_text = line.rpartition(b"*")
                if len(checksum_text) != 2 * self._checksum_size or int(checksum_text, 16) != self._checksum_of(line):
                    return None
            texts = line.split(self._separator)
            if len(texts) != self._width or b"_" in line:  # Python would parse 1_0 as 10
                return None
            return [float(text) for text in texts]
        except ValueError:
            return None


class FrameDecoder(Decoder):
    """Decoder of frames: sync bytes, fields of fixed width, checksum of the fields. Bad frames are skipped up to the next sync."""

    def __init__(self, description: StreamDescription) -> None:
        super().__init__(description)
        try:
            self._sync = bytes.fromhex(description.sync)
        except ValueError as error:
            raise InputError(
                f"stream: sync must be hex bytes, got '{description.sync}'. Write for example aa55."
            ) from error
        if not self._sync:
            raise InputError("stream: frames require sync bytes. Set `sync`.")
        self._fields = frame_fields(description.pack, self._width)
        self._order: Literal["little", "big"] = "little" if description.pack.startswith("<") else "big"
        self._in_step = True  # False within a stretch of corrupted bytes, which counts as one error

    def _rows(self, buffer: bytes, is_datagram: bool) -> FloatArray:
        head, body, tail = len(self._sync), self._fields.size, self._checksum_size
        start, rows = 0, list[tuple[float, ...]]()
        while len(buffer) - start >= head + body + tail:
            fields, end = buffer[start + head : start + head + body], start + head + body
            is_frame = buffer.startswith(self._sync, start)
            if is_frame and int.from_bytes(buffer[end : end + tail], self._order) == self._checksum_of(fields):
                rows.append(self._fields.unpack(fields))
                start, self._in_step, self._begun = end + tail, True, True
                continue
            if is_frame or (self._in_step and self._begun):
                self.errors += 1
            self._in_step = False
            position = buffer.find(self._sync, start + 1)
            start = position if position >= 0 else max(start + 1, len(buffer) - head + 1)
        self._rest = b"" if is_datagram else buffer[start:]
        if is_datagram and start < len(buffer):
            self.errors += 1
        return np.array(rows, dtype=float).reshape(-1, self._width)


def frame_fields(pack: str, channels: int) -> struct.Struct:
    """Return the fields of a frame."""
    if not re.fullmatch(r"[<>](\d{0,3}[bBhHiIqQfd])+", pack):
        raise InputError(
            f"stream: pack must be < or > and codes from bBhHiIqQfd, got '{pack}'. Write for example <H6h."
        )
    fields_of_frame = struct.Struct(pack)
    count = len(fields_of_frame.unpack(bytes(fields_of_frame.size)))
    if count != channels:
        raise InputError(
            f"stream: pack must have a field for each of {channels} channels, got {count} in '{pack}'. Correct it."
        )
    return fields_of_frame


def finite(rows: FloatArray) -> FloatArray:
    """Return the rows without infinite values, (M, K), because no device sends infinity."""
    return np.asarray(rows[~np.isinf(rows).any(axis=1)])


def decoder_for(description: StreamDescription) -> Decoder:
    """Return the decoder of a stream."""
    from undrift.live.log import LogDecoder  # it imports this module

    decoders: dict[str, type[Decoder]] = {"line": LineDecoder, "frame": FrameDecoder}
    return decoders.get(description.format, LogDecoder)(description)
