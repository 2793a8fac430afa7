"""Source: where readings come from. Each kind is a file of its own and a row in the table of address.py."""

import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from undrift.errors import LinkError, RigTimeout
from undrift.live.chunk import Chunk
from undrift.live.decoder import decoder_for
from undrift.live.description import StreamDescription

POLL_S = 0.05


class Source(Protocol):
    """A device that sends by itself."""

    @property
    def name(self) -> str:
        """What to call it in a message."""

    @property
    def description(self) -> StreamDescription:
        """What it sends."""

    @property
    def errors(self) -> int:
        """Garbled readings that were left out so far."""

    def open(self) -> None:
        """Connect; LinkError where nobody is."""

    def read(self, deadline_s: float) -> Chunk:
        """Return what has come, one reading or more.

        Parameters
        ----------
        deadline_s : float
            RigTimeout where nothing good came in so many host seconds; LinkError where the link is lost.
        """

    def close(self) -> None:
        """Let go of it; harmless when called again."""


class Port(Protocol):
    """An open way on which bytes come."""

    datagrams: bool

    def receive(self, wait_s: float) -> bytes:
        """Return bytes, b"" where none came in time; OSError or EOFError where the way is gone.

        Parameters
        ----------
        wait_s : float
            Longest wait, s.
        """

    def close(self) -> None:
        """Let go of it."""


class ByteSource:
    """A device whose bytes come through a port.

    Parameters
    ----------
    name : str
        What to call it in a message.
    description : StreamDescription
        What it sends.
    connect : callable
        Opens the port; OSError where that fails.
    """

    def __init__(self, name: str, description: StreamDescription, connect: Callable[[], Port]) -> None:
        self.name, self.description = name, description
        self._connect = connect
        self._port: Port | None = None
        self._decoder = decoder_for(description)

    @property
    def errors(self) -> int:
        """Garbled readings that were left out so far."""
        return self._decoder.errors

    def open(self) -> None:
        """Connect.

        Raises
        ------
        LinkError
            Nobody is there.
        """
        self.close()
        errors = self._decoder.errors
        self._decoder = decoder_for(self.description)
        self._decoder.errors = errors
        try:
            self._port = self._connect()
        except (OSError, ValueError) as error:
            reason = str(error) or type(error).__name__
            raise LinkError(
                f"{self.name}: wanted a connection, got '{reason}'; check power, cable and address"
            ) from error

    def read(self, deadline_s: float) -> Chunk:
        """Return what has come.

        Parameters
        ----------
        deadline_s : float
            Longest wait, host s.

        Returns
        -------
        Chunk
            One reading or more.

        Raises
        ------
        RigTimeout
            Nothing good came in time.
        LinkError
            The link is lost, or was never opened.
        """
        if self._port is None:
            raise LinkError(f"{self.name}: wanted an open link, got a closed one; open it first")
        last, came = time.monotonic() + deadline_s, 0
        while True:
            data = self._receive(self._port, min(max(last - time.monotonic(), 0.0), POLL_S))
            arrived = time.monotonic()
            came += len(data)
            rows = self._decoder.feed(data, whole=self._port.datagrams) if data else ()
            if len(rows):
                counter, values = self.description.split(np.asarray(rows))
                return Chunk(host_time=np.full(len(rows), arrived), counter=counter, values=values)
            if arrived >= last:
                what = f"{came} bytes and no reading in them; check format, checksum and baud" if came else "nothing"
                raise RigTimeout(
                    f"{self.name}: wanted a reading within {deadline_s:g} s, got {what}; check that the device sends",
                    deadline_s=deadline_s,
                )

    def close(self) -> None:
        """Let go of the port; harmless when called again."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def _receive(self, port: Port, wait_s: float) -> bytes:
        try:
            return port.receive(wait_s)
        except (OSError, EOFError) as error:
            reason = str(error) or type(error).__name__
            raise LinkError(f"{self.name}: wanted readings, got a lost link: {reason}; reconnect") from error
