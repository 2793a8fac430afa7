"""Checksums that devices put behind their readings.

``xor`` is that of NMEA 0183, ``sum`` the low byte of the sum, ``crc16`` CRC-16/CCITT-FALSE (0x1021 from 0xFFFF), ``crc32`` that of
Ethernet. Of the nine digits "123456789" they make 0x31, 0xDD, 0x29B1 and 0xCBF43926.
"""

import binascii
import zlib
from collections.abc import Callable
from functools import reduce
from operator import xor
from typing import NamedTuple


class Checksum(NamedTuple):
    """How a checksum is made.

    Parameters
    ----------
    of : callable
        Bytes to number.
    size : int
        Bytes that hold it.
    """

    of: Callable[[bytes], int]
    size: int


CHECKSUMS = {
    "none": Checksum(lambda data: 0, 0),
    "xor": Checksum(lambda data: reduce(xor, data, 0), 1),
    "sum": Checksum(lambda data: sum(data) & 0xFF, 1),
    "crc16": Checksum(lambda data: binascii.crc_hqx(data, 0xFFFF), 2),
    "crc32": Checksum(zlib.crc32, 4),
}
