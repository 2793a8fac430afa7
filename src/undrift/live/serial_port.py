"""Readings over a serial port or whatever pyserial opens: ``serial:///dev/ttyUSB0?baud=115200&...``."""

from typing import Any

from undrift.errors import InputError, LinkError
from undrift.live.address import Address
from undrift.live.source import ByteSource, Port, Source

BAUD = 115_200


class SerialPort:
    """A serial port that bytes come from.

    Parameters
    ----------
    port : serial.Serial
        Open.
    """

    datagrams = False

    def __init__(self, port: Any) -> None:
        self._port = port

    def receive(self, wait_s: float) -> bytes:
        """Return what has come.

        Parameters
        ----------
        wait_s : float
            Longest wait for the first byte, s.

        Returns
        -------
        bytes
            b"" where nothing came in time.
        """
        self._port.timeout = wait_s
        first: bytes = self._port.read(1)
        waiting = self._port.in_waiting if first else 0
        return first + bytes(self._port.read(waiting)) if waiting else first

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()


def open_from(address: Address) -> Source:
    """Return a source that reads a serial port.

    Parameters
    ----------
    address : Address
        Place ///dev/name, COM3, or a URL of pyserial's; option baud.

    Returns
    -------
    Source
        Not opened yet.

    Raises
    ------
    InputError
        No port, or an option that is none of a stream's.
    """
    place = address.place.removeprefix("//")
    text = address.option("baud", str(BAUD))
    if not place or not text.isdigit() or int(text) == 0:
        raise InputError(f"device: wanted serial:///dev/name?baud=115200, got '{place}' and baud '{text}'; name both")

    def connect() -> Port:
        try:
            import serial
        except ImportError as error:
            raise LinkError("serial port: wanted the package pyserial, got none; pip install undrift[live]") from error
        return SerialPort(serial.serial_for_url(place, baudrate=int(text)))

    return ByteSource(f"serial:{place}", address.describe("baud"), connect)
