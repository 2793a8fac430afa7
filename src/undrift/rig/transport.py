"""Transport: bytes to and from a rig or device, over TCP or over a serial port.

A place is written as a URL: ``tcp://host:port``; ``serial:///dev/ttyUSB0`` or a bare path (a pty too); and what pyserial itself
understands: ``socket://host:port``, ``loop://``. Nothing here waits longer than it was told.
"""

import contextlib
import socket
from typing import Protocol
from urllib.parse import urlsplit

from undrift.errors import InputError, LinkError

POLL_S = 0.05  # how long one read may wait; closing takes at most this long


class Transport(Protocol):
    """An open way for bytes."""

    def read(self) -> bytes:
        """Return what has come, b"" when nothing came for a moment; OSError or EOFError when the way is gone."""

    def write(self, data: bytes) -> None:
        """Send all of it or raise OSError.

        Parameters
        ----------
        data : bytes
            What to send.
        """

    def wake(self) -> None:
        """Let a `read` that waits in another thread return soon, before `close`."""

    def close(self) -> None:
        """Let go of it; harmless when called again."""


class TcpTransport:
    """Bytes over a TCP socket.

    Parameters
    ----------
    host : str
        Name or number of the other machine.
    port : int
        Its port.
    connect_timeout_s : float
        Longest wait for the connection, s.

    Raises
    ------
    OSError
        Nobody answers there.
    """

    def __init__(self, host: str, port: int, connect_timeout_s: float) -> None:
        self._socket = socket.create_connection((host, port), timeout=connect_timeout_s)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(1.0)

    def read(self) -> bytes:
        """Return what has come, b"" when nothing came within a second.

        Returns
        -------
        bytes
            At most 64 KiB.

        Raises
        ------
        EOFError
            The other side closed.
        """
        try:
            data = self._socket.recv(65536)
        except TimeoutError:
            return b""
        if not data:
            raise EOFError("the other side closed the connection")
        return data

    def write(self, data: bytes) -> None:
        """Send all of it.

        Parameters
        ----------
        data : bytes
            What to send.
        """
        self._socket.sendall(data)

    def wake(self) -> None:
        """End the conversation, so that a read returns at once."""
        with contextlib.suppress(OSError):  # the other side was first
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()


class SerialTransport:
    """Bytes over whatever pyserial opens: a port, a pty, ``socket://`` or ``loop://``.

    Parameters
    ----------
    url : str
        As pyserial takes it.
    baud : int
        Bits per second; 8 data bits, no parity, one stop bit.
    hardware_handshake : bool
        Use RTS/CTS.

    Raises
    ------
    OSError
        No such port, or it is taken.
    LinkError
        pyserial is not installed.
    """

    def __init__(self, url: str, baud: int, hardware_handshake: bool) -> None:
        try:
            import serial
        except ImportError as error:
            raise LinkError("serial port: wanted the package pyserial, got none; pip install undrift[live]") from error
        self._port = serial.serial_for_url(
            url, baudrate=baud, timeout=POLL_S, write_timeout=1.0, rtscts=hardware_handshake
        )

    def read(self) -> bytes:
        """Return what has come, b"" when nothing came for a moment.

        Returns
        -------
        bytes
            As many as were waiting, at least the first that came.
        """
        first: bytes = self._port.read(1)
        waiting = self._port.in_waiting if first else 0
        return first + bytes(self._port.read(waiting)) if waiting else first

    def write(self, data: bytes) -> None:
        """Send all of it.

        Parameters
        ----------
        data : bytes
            What to send.
        """
        self._port.write(data)

    def wake(self) -> None:
        """Nothing to do: a read waits a moment only."""

    def close(self) -> None:
        """Let go of the port."""
        self._port.close()


def open_transport(
    url: str, *, baud: int = 19200, hardware_handshake: bool = False, connect_timeout_s: float = 5.0
) -> Transport:
    """Open a way for bytes.

    Parameters
    ----------
    url : str
        ``tcp://host:port``, ``serial:///dev/ttyUSB0``, a path, ``socket://host:port`` or ``loop://``.
    baud : int
        Bits per second of a serial port.
    hardware_handshake : bool
        RTS/CTS of a serial port.
    connect_timeout_s : float
        Longest wait for a TCP connection, s.

    Returns
    -------
    Transport
        Open.

    Raises
    ------
    InputError
        Not a URL of one of these kinds.
    LinkError
        Nobody answers there, or the port cannot be opened.
    """
    place = _parse(url)
    try:
        if isinstance(place, str):
            return SerialTransport(place, baud, hardware_handshake)
        return TcpTransport(*place, connect_timeout_s)
    except (OSError, ValueError) as error:  # pyserial's SerialException is an OSError
        reason = str(error) or type(error).__name__
        raise LinkError(f"{url}: wanted a connection, got '{reason}'; check power, cable and address") from error


def _parse(url: str) -> tuple[str, int] | str:
    """Return (host, port) of a TCP address, or the name that pyserial takes."""
    wanted = "wanted tcp://host:port, serial:///path, a path, socket://host:port or loop://"
    if url.startswith("tcp://"):
        parts = urlsplit(url)
        try:
            host, port = parts.hostname, parts.port
        except ValueError:
            host = port = None
        if not host or not port or parts.path not in ("", "/"):
            raise InputError(f"link: {wanted}, got '{url}'; name host and port")
        return host, port
    if url.startswith("serial://"):
        url = url.removeprefix("serial://")
    elif not url.startswith(("socket://", "loop://", "/", "COM")):
        raise InputError(f"link: {wanted}, got '{url}'; say how the rig is connected")
    if not url:
        raise InputError(f"link: {wanted}, got no name of a port; write serial:///dev/ttyUSB0")
    return url
