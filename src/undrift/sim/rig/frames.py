"""How the emulated device writes its readings: lines with an XOR behind a star, or frames with sync bytes and a CRC-16.

Both are written here from their definitions, apart from the readers in live/.
"""

import struct
from typing import Literal, get_args

from undrift.arrays import FloatArray
from undrift.errors import InputError

Framing = Literal["line", "frame"]
COUNTER_BITS = 16
SYNC = b"\xaa\x55"


def check_framing(framing: str) -> None:
    """Refuse a framing that is not one.

    Parameters
    ----------
    framing : str
        line or frame.

    Raises
    ------
    InputError
        Neither.
    """
    if framing not in get_args(Framing):
        raise InputError(f"emulated device: wanted format line or frame, got '{framing}'; name one of them")


def line_of(count: int, row: FloatArray) -> bytes:
    """Return a reading as a line: numbers joined by commas, star, two hex digits of the XOR of all before it.

    Parameters
    ----------
    count : int
        Of the reading.
    row : array, shape (K,)
        Channels.

    Returns
    -------
    bytes
        Ends with LF.
    """
    numbers = (f"{int(value)}" if value.is_integer() else repr(value) for value in row.tolist())
    text = ",".join((str(count % 2**COUNTER_BITS), *numbers)).encode("ascii")
    total = 0
    for byte in text:
        total ^= byte
    return b"%s*%02X\n" % (text, total)


def frame_of(count: int, row: FloatArray) -> bytes:
    """Return a reading as a frame: AA 55, counter in two bytes, channels as doubles, CRC-16 of these, little end first.

    Parameters
    ----------
    count : int
        Of the reading.
    row : array, shape (K,)
        Channels.

    Returns
    -------
    bytes
        6 + 8 K of them.
    """
    body = struct.pack(f"<H{len(row)}d", count % 2**COUNTER_BITS, *row.tolist())
    return SYNC + body + struct.pack("<H", _crc16(body))


def _crc16(data: bytes) -> int:
    """Remainder of the polynomial x^16 + x^12 + x^5 + 1, begun with ones, most significant bit first."""
    register = 0xFFFF
    for byte in data:
        register = ((register << 8) & 0xFFFF) ^ _TABLE[(register >> 8) ^ byte]
    return register


def _entry(byte: int) -> int:
    register = byte << 8
    for _ in range(8):
        register = (register << 1) ^ (0x1021 if register & 0x8000 else 0)
    return register & 0xFFFF


_TABLE = tuple(_entry(byte) for byte in range(256))
