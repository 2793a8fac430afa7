"""Readings over UDP: the device sends to this computer's port, ``udp://:port?...`` or ``udp://address-of-this-computer:port?...``."""

import socket

from undrift.live.address import Address
from undrift.live.source import ByteSource, Port, Source
from undrift.live.tcp import SocketPort, host_and_port

BUFFER_BYTES = 1 << 22  # what the system keeps while nobody looks


def open_from(address: Address) -> Source:
    """Return a source that listens for datagrams.

    Parameters
    ----------
    address : Address
        Place //host:port; the host is this computer's own address, none for all of them.

    Returns
    -------
    Source
        Not opened yet.

    Raises
    ------
    InputError
        No port, or an option that is none of a stream's.
    """
    host, port = host_and_port(address)

    def connect() -> Port:
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            listener.bind((host, port))
        except OSError:
            listener.close()
            raise
        return SocketPort(listener, datagrams=True)

    return ByteSource(f"udp://{host}:{port}", address.describe(), connect)
