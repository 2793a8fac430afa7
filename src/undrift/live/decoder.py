"""Decoders: bytes in, rows of numbers out. What is garbled is counted and left out; it is never fatal here.

A StreamDescription says what a device sends: which channels in which order, in which units, how it is framed. It is written in an
address, ``tcp://host:port?channels=count,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,temp&rate=100&gyro_unit=count``, or under
``[stream]`` in a TOML file with the same keys, which an address names as ``description=FILE``.
"""

import binascii
import re
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args

import numpy as np

from undrift.arrays import BoolArray, FloatArray, Shape, freeze
from undrift.base.codec import stored, toml_of, value_of
from undrift.base.summary import at
from undrift.errors import InputError, check_positive
from undrift.record import Record
from undrift.units import canonical_unit

# ---- Checksums behind readings: ``xor`` is that of NMEA 0183, ``sum`` the low byte of the sum, ``crc16`` CRC-16/CCITT-FALSE
# (0x1021 from 0xFFFF), ``crc32`` that of Ethernet. Of "123456789" they make 0x31, 0xDD, 0x29B1 and 0xCBF43926.


class Checksum(NamedTuple):
    """How a checksum is made."""

    of: Callable[[bytes], int]  # Bytes to number
    size: int  # Bytes that hold it


CHECKSUMS = {
    "none": Checksum(lambda data: 0, 0),
    "xor": Checksum(lambda data: reduce(xor, data, 0), 1),
    "sum": Checksum(lambda data: sum(data) & 0xFF, 1),
    "crc16": Checksum(lambda data: binascii.crc_hqx(data, 0xFFFF), 2),
    "crc32": Checksum(zlib.crc32, 4),
}


# ---- StreamDescription: what a device sends: which channels in which order, in which units, how it is framed.

Framing = Literal["line", "frame", "log"]
COUNTER, IGNORED = "count", "-"
TRIADS = ("gyro", "accel", "mag")
MEASURED = (*(f"{triad}_{axis}" for triad in TRIADS for axis in "xyz"), "temp")


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class StreamDescription:
    """What a device sends."""

    # In order: gyro_x .. accel_z, mag_x (uT), temp; ``count`` for the device's own counter, ``-`` for what is left
    # out
    channels: tuple[str, ...] = (COUNTER, *MEASURED[:6])
    rate: float = 0.0  # Nominal readings per second of the device
    gyro_unit: str = "count"  # Units as sent: rad/s, dps, m/s2, g, mg, count or v
    accel_unit: str = "count"
    gyro_gain: float = 1.0  # Of that unit in one of the numbers sent: 0.061 of a device that sends codes
    accel_gain: float = 1.0
    temp_scale: float = 1.0  # degC = temp_scale * sent + temp_zero
    temp_zero: float = 0.0
    tick: float = 0.0  # Device seconds a step of the counter; 0 for a counter of readings
    counter_bits: int = 0  # Width of the counter; 0 for one that never wraps
    format: Framing = "line"  # line (numbers alone), frame (binary) or log (any text of io/log.py)
    separator: str = ","  # Between the numbers of a line; of a log, the words before the first number of a reading
    checksum: str = "none"  # none, xor, sum, crc16 or crc32: behind a line as ``*hex``, behind a frame as bytes
    sync: str = "aa55"  # First bytes of a frame, hex
    # Fields of a frame as Python's struct writes them, one for each channel, little (<) or big (>) end first
    pack: str = ""
    clock_speed: float = 1.0  # Device seconds per host second: 1 for hardware, that of a simulated device otherwise
    device: str = ""  # Serial number or name

    def __post_init__(self) -> None:
        self._check_channels()
        check_positive(self, "stream", "there is no default", "rate", "clock_speed")
        check_positive(self, "stream", "state the unit of one number that is sent", "gyro_gain", "accel_gain")
        object.__setattr__(self, "gyro_unit", canonical_unit(self.gyro_unit, "rate"))
        object.__setattr__(self, "accel_unit", canonical_unit(self.accel_unit, "accel"))
        if self.format not in get_args(Framing):
            raise InputError(f"stream: wanted format line, frame or log, got '{self.format}'; name one of them")
        if self.checksum not in CHECKSUMS:
            raise InputError(f"stream: wanted checksum {', '.join(CHECKSUMS)}, got '{self.checksum}'; name one of them")
        if not 0 <= self.counter_bits <= 53 or self.tick < 0.0:
            raise InputError(
                f"stream: wanted counter_bits 0 to 53 and a tick of 0 or more, got {self.counter_bits} and {self.tick:g}; "
                "look into the device's manual"
            )

    @property
    def measured(self) -> tuple[str, ...]:
        """Channels that are kept, in the order of a chunk's values."""
        return tuple(name for name in self.channels if name not in (COUNTER, IGNORED))

    @property
    def has_counter(self) -> bool:
        """Whether the device counts for itself."""
        return COUNTER in self.channels

    @property
    def tick_s(self) -> float:
        """Device seconds a step of the counter."""
        return self.tick if self.has_counter and self.tick > 0.0 else 1.0 / self.rate

    def record(self, time: FloatArray, values: FloatArray) -> Record:
        """Return readings as a record: time (N,) s, values (N, C)."""
        place = {name: column for column, name in enumerate(self.measured)}

        def triad(name: str, gain: float = 1.0) -> FloatArray | None:
            names = [f"{name}_{axis}" for axis in "xyz"]
            return values[:, [place[each] for each in names]] * gain if names[0] in place else None

        return Record(
            time=time,
            gyro=triad("gyro", self.gyro_gain),
            accel=triad("accel", self.accel_gain),
            mag_ut=triad("mag"),
            temp_c=values[:, place["temp"]] * self.temp_scale + self.temp_zero if "temp" in place else None,
            gyro_unit=self.gyro_unit,
            accel_unit=self.accel_unit,
            device=self.device,
        )

    def split(self, rows: FloatArray) -> tuple[FloatArray | None, FloatArray]:
        """Take decoded rows apart: rows (N, K) -> (N,), (N, C)."""
        kept = [column for column, name in enumerate(self.channels) if name not in (COUNTER, IGNORED)]
        counter = rows[:, self.channels.index(COUNTER)] if self.has_counter else None
        return counter, np.ascontiguousarray(rows[:, kept])

    def _check_channels(self) -> None:
        names = [name for name in self.channels if name != IGNORED]
        known = (COUNTER, IGNORED, *MEASURED)
        wrong = [name for name in names if name not in known]
        if wrong or len(set(names)) < len(names):
            what = wrong[0] if wrong else next(name for name in names if names.count(name) > 1)
            raise InputError(
                f"stream: wanted channels out of {', '.join(known)}, each once, got '{what}'; mend the list"
            )
        for triad in TRIADS:
            held = sum(name.startswith(triad) for name in names)
            if held not in (0, 3):
                raise InputError(f"stream: wanted all three axes of {triad}, got {held}; name x, y and z")
        if not any(name.startswith(("gyro", "accel")) for name in names):
            raise InputError("stream: wanted channels of gyro or accel, got neither; say what the device sends")


KINDS: dict[str, Any] = {field.name: type(field.default) for field in fields(StreamDescription)}


def described(base: StreamDescription | None, options: tuple[tuple[str, str], ...]) -> StreamDescription:
    """Return a description with options of an address in it."""
    given: dict[str, object] = {}
    for name, text in options:
        if name not in KINDS:
            raise InputError(f"stream: wanted options out of {', '.join(KINDS)}, got '{name}'; mend the address")
        try:
            given[name] = tuple(text.split(",")) if KINDS[name] is tuple else KINDS[name](text)
        except ValueError as error:
            raise InputError(f"stream: wanted a number for {name}, got '{text}'; mend the address") from error
    return StreamDescription(**given) if base is None else replace(base, **given)  # type: ignore[arg-type]


def read_description(path: str | Path) -> StreamDescription:
    """Read a description from a TOML file."""
    tables, text = toml_of(path)
    return value_of(_File, {name: table for name, table in tables.items() if name == "stream"}, str(path), text).stream


@stored()
@dataclass(frozen=True, slots=True)
class _File:
    """A TOML file with a description; other tables in it are not for us."""

    stream: StreamDescription


# ---- Counters: what the device counted, made to go on for ever.

RESTART_S = 2.0
SILENCE_S = 0.25


class Counter:
    """Unwraps the device's counter.

    A counter of b bits wraps at 2^b; whole turns that went by in a silence are estimated from the host's clock. A step back by a
    little is a reading that came late or twice: it is left out. A step that disagrees with the host's clock by more than
    ``RESTART_S`` is a device that started anew: its count goes on from where the host's clock says it would be.
    """

    def __init__(self, bits: int, tick_s: float, clock_speed: float = 1.0) -> None:
        self._modulus = 2.0**bits if bits else 0.0
        self._tick = tick_s
        self._speed = clock_speed
        self._raw = self._host = self._total = 0.0
        self._begun = False
        self.late = 0
        self.restarts = 0

    def unwrap(self, raw: FloatArray, host_time: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return counts that only rise: raw (N,), host_time (N,) s -> (N,), (N,)."""
        if not self._begun and len(raw):
            self._raw, self._host, self._begun = float(raw[0]) - 1.0, float(host_time[0]), True
            self._total = -1.0
        step = np.diff(raw, prepend=self._raw)
        if self._modulus:
            step %= self._modulus
        ordinary = (
            (step > 0.0)
            & (step * self._tick < RESTART_S / 2.0)
            & (np.diff(host_time, prepend=self._host) < RESTART_S / 2.0)
        )
        if ordinary.all():
            count: FloatArray = self._total + np.cumsum(step)
            if len(raw):
                self._raw, self._host, self._total = float(raw[-1]), float(host_time[-1]), float(count[-1])
            return count, ordinary
        pairs = [self._next(r, h) for r, h in zip(raw.tolist(), host_time.tolist(), strict=True)]
        return np.array([total for total, _ in pairs]), np.array([kept for _, kept in pairs], dtype=bool)

    def _next(self, raw: float, host: float) -> tuple[float, bool]:
        step = raw - self._raw
        expected = (host - self._host) * self._speed / self._tick
        if self._modulus:
            step = (step + self._modulus / 2.0) % self._modulus - self._modulus / 2.0
            step += max(round((expected - step) / self._modulus), 0) * self._modulus
        if step <= 0.0 and -step * self._tick < RESTART_S:
            self.late += 1
            return self._total, False
        slack = RESTART_S * max(self._speed, 1.0) / self._tick + 0.1 * abs(expected)
        if abs(step - expected) > slack:
            self.restarts += 1
            step = max(round(expected), 1.0)
        self._raw, self._host, self._total = raw, host, self._total + step
        return self._total, True


class Arrivals:
    """Counts for a device that does not: one a reading, and what a silence says was lost."""

    def __init__(self, rate: float, clock_speed: float = 1.0) -> None:
        self._per_host_s = rate * clock_speed
        self._total = -1.0
        self._host: float | None = None

    def count(self, host_time: FloatArray) -> FloatArray:
        """Return counts: host_time (N,) s -> (N,)."""
        n = len(host_time)
        if not n:
            return np.empty(0)
        silent = 0.0 if self._host is None else float(host_time[0]) - self._host
        due = silent * self._per_host_s
        lost = round(due - n) if silent > SILENCE_S and n < due / 2.0 else 0
        self._host = float(host_time[-1])
        found: FloatArray = self._total + lost + np.arange(1.0, n + 1.0)
        self._total = float(found[-1])
        return found


# ---- Chunk: readings as they came in, with the host's time of arrival; nothing is interpreted yet.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chunk:
    """Readings that came together, N of them."""

    host_time: Annotated[FloatArray, Shape("n")]  # (N,), when each came, s, the host's monotonic clock
    # (N,), of the device's own counter, ticks; None for a device that sends none
    counter: Annotated[FloatArray | None, Shape("n")]
    # (N, C), raw readings in the order of ``StreamDescription.measured``, the device's units
    values: Annotated[FloatArray, Shape("n", "c")]

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.host_time)


# ---- decoder

LONGEST_LINE = 4096


class Decoder(ABC):
    """Bytes in, rows of numbers out; a framing finds the rows in what has come."""

    def __init__(self, description: StreamDescription) -> None:
        self.errors = 0
        self._width, self._checksum = len(description.channels), CHECKSUMS[description.checksum]
        self._rest = b""

    def feed(self, data: bytes, *, whole: bool = False) -> FloatArray:
        """Take bytes, return what they complete, (N, K); whole bytes are a datagram, of which nothing is kept."""
        rows = self._rows(self._rest + data, whole)
        sound = finite(rows)
        self.errors += len(rows) - len(sound)
        return sound

    @abstractmethod
    def _rows(self, held: bytes, whole: bool) -> FloatArray:
        """Return the rows in what has come, and keep what may go on."""


class LineDecoder(Decoder):
    """Lines of numbers, ``12,0.5,-3`` or ``$12,0.5,-3*5C`` with a checksum of what stands between $ and *."""

    def __init__(self, description: StreamDescription) -> None:
        super().__init__(description)
        self._separator = description.separator.encode("ascii", errors="replace")
        if not self._separator:
            raise InputError("stream: wanted a separator between the numbers of a line, got none; name it")
        self._first = True

    def _rows(self, held: bytes, whole: bool) -> FloatArray:
        *lines, self._rest = held.split(b"\n")
        if whole:
            lines.append(self._rest)
            self._rest, self._first = b"", False
        if len(self._rest) > LONGEST_LINE:
            self._rest, self.errors = b"", self.errors + 1
        rows = []
        for line in lines:
            stripped = line.strip()
            row = self._row(stripped) if stripped else None
            if row is not None:
                rows.append(row)
            elif stripped and not self._first:
                self.errors += 1
            self._first = False
        return np.array(rows, dtype=float).reshape(-1, self._width)

    def _row(self, line: bytes) -> list[float] | None:
        line = line.removeprefix(b"$")
        try:
            if self._checksum.size:
                line, _, stated = line.rpartition(b"*")
                if len(stated) != 2 * self._checksum.size or int(stated, 16) != self._checksum.of(line):
                    return None
            parts = line.split(self._separator)
            if len(parts) != self._width or b"_" in line:  # Python reads 1_0 as ten
                return None
            return [float(part) for part in parts]
        except ValueError:
            return None


class FrameDecoder(Decoder):
    """Frames: sync bytes, fields of fixed width, checksum of the fields. After a bad one the next sync bytes are looked for."""

    def __init__(self, description: StreamDescription) -> None:
        super().__init__(description)
        try:
            self._sync = bytes.fromhex(description.sync)
        except ValueError as error:
            raise InputError(f"stream: wanted sync bytes in hex, got '{description.sync}'; as in aa55") from error
        if not self._sync:
            raise InputError("stream: wanted sync bytes, got none; a frame that cannot be found again is not read")
        self._fields = frame_fields(description.pack, self._width)
        self._order: str = "little" if description.pack.startswith("<") else "big"
        self._in_step = True  # what stands before the first sync bytes is a frame that was under way

    def _rows(self, held: bytes, whole: bool) -> FloatArray:
        head, body, tail = len(self._sync), self._fields.itemsize, self._checksum.size
        at, found = 0, []
        while len(held) - at >= head + body + tail:
            end = at + head + body
            if not held.startswith(self._sync, at):
                at = self._resume(held, at)
            elif int.from_bytes(held[end : end + tail], self._order) == self._checksum.of(held[at + head : end]):  # type: ignore[arg-type]
                found.append(held[at + head : end])
                at, self._in_step = end + tail, True
            else:
                self.errors, self._in_step = self.errors + 1, False
                at += 1
        self._rest = b"" if whole else held[at:]
        if whole and at < len(held):
            self.errors += 1
        table = np.frombuffer(b"".join(found), dtype=self._fields)
        columns = [table[name].astype(float) for name in self._fields.names or ()]
        return np.array(columns).T.reshape(len(table), self._width)

    def _resume(self, held: bytes, at: int) -> int:
        """Return where the next sync bytes may stand; a stretch of rubbish is one error."""
        if self._in_step and at:
            self.errors += 1
        self._in_step = False
        place = held.find(self._sync, at)
        return place if place >= 0 else max(at + 1, len(held) - len(self._sync) + 1)


def frame_fields(pack: str, channels: int) -> np.dtype[np.void]:
    """Return the fields of a frame."""
    if not re.fullmatch(r"[<>](\d{0,3}[bBhHiIqQfd])+", pack):
        raise InputError(f"stream: wanted pack as < or > and codes out of bBhHiIqQfd, got '{pack}'; as in <H6h")
    codes = "".join(code * int(count or 1) for count, code in re.findall(r"(\d*)([a-zA-Z])", pack))
    if len(codes) != channels:
        raise InputError(
            f"stream: wanted a field for each of {channels} channels, got {len(codes)} in '{pack}'; mend it"
        )
    numpy_of = {"b": "i1", "B": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "q": "i8", "Q": "u8"}
    return np.dtype(
        [(f"f{k}", pack[0] + numpy_of.get(code, f"f{4 if code == 'f' else 8}")) for k, code in enumerate(codes)]
    )


def finite(rows: FloatArray) -> FloatArray:
    """Return the rows without infinity, which no device means: rows (N, K) -> (M, K)."""
    return np.asarray(rows[~np.isinf(rows).any(axis=1)])


DECODERS = {"line": LineDecoder, "frame": FrameDecoder}
LOG = "undrift.live.log:LogDecoder"  # loaded where it is asked for: it reads as io/log.py does, which the simulator must not


def decoder_for(description: StreamDescription) -> Decoder:
    """Return the decoder of a stream."""
    decoder: Decoder = (DECODERS.get(description.format) or at(LOG))(description)
    return decoder
