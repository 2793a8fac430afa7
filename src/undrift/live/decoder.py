"""Decoders: bytes in, rows of numbers out. What is garbled is counted and left out; it is never fatal here."""

import re
from typing import Protocol

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.live.checksums import CHECKSUMS
from undrift.live.description import StreamDescription

LONGEST_LINE = 4096


class Decoder(Protocol):
    """Turns bytes into rows."""

    errors: int

    def feed(self, data: bytes, *, whole: bool = False) -> FloatArray:
        """Take bytes, return what they complete.

        Parameters
        ----------
        data : bytes
            The next of the stream.
        whole : bool
            True where nothing of a reading may come later: a datagram.
        """


class LineDecoder:
    """Lines of numbers, ``12,0.5,-3`` or ``$12,0.5,-3*5C`` with a checksum of what stands between $ and *.

    The line that is under way when the link opens is left out without a word, as it is never whole.

    Parameters
    ----------
    description : StreamDescription
        Channels, separator, checksum.
    """

    def __init__(self, description: StreamDescription) -> None:
        self.errors = 0
        self._width = len(description.channels)
        self._separator = description.separator.encode("ascii", errors="replace")
        if not self._separator:
            raise InputError("stream: wanted a separator between the numbers of a line, got none; name it")
        self._checksum = None if description.checksum == "none" else CHECKSUMS[description.checksum]
        self._rest = b""
        self._first = True

    def feed(self, data: bytes, *, whole: bool = False) -> FloatArray:
        """Take bytes, return what they complete.

        Parameters
        ----------
        data : bytes
            The next of the stream.
        whole : bool
            True where the last line ends with the data.

        Returns
        -------
        array, shape (N, K)
            A row for each sound line.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
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
        table = np.array(rows, dtype=float).reshape(-1, self._width)
        sound = finite(table)
        self.errors += len(table) - len(sound)
        return sound

    def _row(self, line: bytes) -> list[float] | None:
        line = line.removeprefix(b"$")
        if self._checksum is not None:
            line, _, said = line.rpartition(b"*")
            if len(said) != 2 * self._checksum.size:
                return None
            try:
                if int(said, 16) != self._checksum.of(line):
                    return None
            except ValueError:
                return None
        parts = line.split(self._separator)
        if len(parts) != self._width or b"_" in line:  # Python reads 1_0 as ten
            return None
        try:
            return [float(part) for part in parts]
        except ValueError:
            return None


class FrameDecoder:
    """Frames: sync bytes, fields of fixed width, checksum of the fields. After a bad one the next sync bytes are looked for.

    Parameters
    ----------
    description : StreamDescription
        Sync bytes, fields, checksum.

    Raises
    ------
    InputError
        Sync bytes or fields that cannot be.
    """

    def __init__(self, description: StreamDescription) -> None:
        self.errors = 0
        try:
            self._sync = bytes.fromhex(description.sync)
        except ValueError as error:
            raise InputError(f"stream: wanted sync bytes in hex, got '{description.sync}'; as in aa55") from error
        if not self._sync:
            raise InputError("stream: wanted sync bytes, got none; a frame that cannot be found again is not read")
        self._fields = frame_fields(description.pack, len(description.channels))
        self._checksum = CHECKSUMS[description.checksum]
        self._order: str = "little" if description.pack.startswith("<") else "big"
        self._rest = b""
        self._in_step = True  # what stands before the first sync bytes is a frame that was under way

    def feed(self, data: bytes, *, whole: bool = False) -> FloatArray:
        """Take bytes, return what they complete.

        Parameters
        ----------
        data : bytes
            The next of the stream.
        whole : bool
            True where the last frame ends with the data.

        Returns
        -------
        array, shape (N, K)
            A row for each sound frame.
        """
        held = self._rest + data
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
        names = self._fields.names or ()
        rows = np.array([table[name].astype(float) for name in names]).T.reshape(len(table), len(names))
        sound = finite(rows)
        self.errors += len(rows) - len(sound)
        return sound

    def _resume(self, held: bytes, at: int) -> int:
        """Return where the next sync bytes may stand; a stretch of rubbish is one error."""
        if self._in_step and at:
            self.errors += 1
        self._in_step = False
        place = held.find(self._sync, at)
        return place if place >= 0 else max(at + 1, len(held) - len(self._sync) + 1)


def frame_fields(pack: str, channels: int) -> np.dtype[np.void]:
    """Return the fields of a frame.

    Parameters
    ----------
    pack : str
        < or > and codes out of bBhHiIqQfd, each with a count before it where wanted: "<H6hf".
    channels : int
        Fields that there are to be.

    Returns
    -------
    dtype
        Packed, a field for each channel.

    Raises
    ------
    InputError
        Not such a text, or another number of fields.
    """
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
    """Return the rows without infinity, which no device means.

    Parameters
    ----------
    rows : array, shape (N, K)
        As decoded; NaN is a gap and stays.

    Returns
    -------
    array, shape (M, K)
        The sound ones.
    """
    sound: FloatArray = rows[~np.isinf(rows).any(axis=1)]
    return sound


def decoder_for(description: StreamDescription) -> Decoder:
    """Return the decoder of a stream.

    Parameters
    ----------
    description : StreamDescription
        What is sent.

    Returns
    -------
    Decoder
        Fresh.
    """
    return LineDecoder(description) if description.format == "line" else FrameDecoder(description)
