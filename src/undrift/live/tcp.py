"""Readings over TCP: the device listens, ``tcp://host:port?...``."""

import socket
from urllib.parse import urlsplit

from undrift.errors import InputError
from undrift.live.address import Address
from undrift.live.source import ByteSource, Port, Source

CONNECT_S = 5.0
LARGEST = 1 << 16


class SocketPort:
    """A socket that bytes come from.

    Parameters
    ----------
    connection : socket
        Connected, or bound.
    datagrams : bool
        True for UDP.
    """

    def __init__(self, connection: socket.socket, datagrams: bool) -> None:
        self.datagrams = datagrams
        self._socket = connection

    def receive(self, wait_s: float) -> bytes:
        """Return what has come.

        Parameters
        ----------
        wait_s : float
            Longest wait, s.

        Returns
        -------
        bytes
            b"" where nothing came in time.

        Raises
        ------
        EOFError
            The other side closed the connection.
        """
        self._socket.settimeout(max(wait_s, 1e-4))
        try:
            data = self._socket.recv(LARGEST)
        except TimeoutError:
            return b""
        if not data and not self.datagrams:
            raise EOFError("the other side closed the connection")
        return data

    def close(self) -> None:
        """Let go of the socket."""
        self._socket.close()


def host_and_port(address: Address) -> tuple[str, int]:
    """Return host and port of a place.

    Parameters
    ----------
    address : Address
        Its place is //host:port.

    Returns
    -------
    host : str
        "" where none is named.
    port : int
        1 to 65535.

    Raises
    ------
    InputError
        No port.
    """
    parts = urlsplit(address.place)
    try:
        port = parts.port
    except ValueError:
        port = None
    if not port or parts.path not in ("", "/"):
        wanted = f"{address.kind}://host:port"
        raise InputError(f"device: wanted {wanted}, got '{address.kind}:{address.place}'; name host and port")
    return parts.hostname or "", port


def open_from(address: Address) -> Source:
    """Return a source that connects over TCP.

    Parameters
    ----------
    address : Address
        Place //host:port.

    Returns
    -------
    Source
        Not opened yet.

    Raises
    ------
    InputError
        No host or port, or an option that is none of a stream's.
    """
    host, port = host_and_port(address)
    if not host:
        raise InputError(f"device: wanted tcp://host:port, got no host in '{address.place}'; name it")

    def connect() -> Port:
        connection = socket.create_connection((host, port), timeout=CONNECT_S)
        return SocketPort(connection, datagrams=False)

    return ByteSource(f"tcp://{host}:{port}", address.describe(), connect)
