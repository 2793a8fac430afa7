"""Readings from Lab Streaming Layer: ``lsl:name?channels=gyro_x,...&rate=100&offline=yes``.

The time stamps of the sender are the device's clock. ``offline=yes`` looks for streams on this computer only, without multicast.
"""

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from undrift.errors import InputError, LinkError, RigTimeout
from undrift.live.address import Address
from undrift.live.chunk import Chunk
from undrift.live.description import COUNTER, StreamDescription
from undrift.live.source import POLL_S, Source

RESOLVE_S = 5.0
OFFLINE = "[multicast]\nResolveScope = machine\n[lab]\nKnownPeers = {127.0.0.1}\n"


class Inlet(Protocol):
    """What an LSL inlet does here."""

    def pull_chunk(self, timeout: float = 0.0) -> tuple[list[list[float]], list[float]]:
        """Return samples and their time stamps; both empty where none came in time.

        Parameters
        ----------
        timeout : float
            Longest wait, s.
        """

    def close_stream(self) -> None:
        """Let go of the stream."""


class LslSource:
    """A stream of the Lab Streaming Layer.

    Parameters
    ----------
    name : str
        What to call it in a message.
    description : StreamDescription
        Channels of the stream in their order, without a counter.
    connect : callable
        Finds the stream; LinkError where it is not there.

    Raises
    ------
    InputError
        A counter among the channels.
    """

    def __init__(self, name: str, description: StreamDescription, connect: Callable[[], Inlet]) -> None:
        if description.has_counter:
            raise InputError(
                "lsl: wanted the channels of the stream, got 'count' among them; LSL has stamps of its own"
            )
        self.name, self.errors = name, 0
        self.description = replace(description, channels=(COUNTER, *description.channels), tick=1.0, counter_bits=0)
        self._connect = connect
        self._inlet: Inlet | None = None

    def open(self) -> None:
        """Find the stream.

        Raises
        ------
        LinkError
            It is not there.
        """
        self.close()
        self._inlet = self._connect()

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
            The stream ended, or was never opened.
        """
        if self._inlet is None:
            raise LinkError(f"{self.name}: wanted an open stream, got a closed one; open it first")
        last = time.monotonic() + deadline_s
        while True:
            samples, stamps = self._pull(self._inlet, min(max(last - time.monotonic(), 0.0), POLL_S))
            arrived = time.monotonic()
            width = len(self.description.channels) - 1
            good = [(stamp, *row) for stamp, row in zip(stamps, samples, strict=True) if len(row) == width]
            self.errors += len(stamps) - len(good)
            rows = np.array(good, dtype=float).reshape(-1, width + 1)
            sound = rows[~np.isinf(rows).any(axis=1)]
            self.errors += len(rows) - len(sound)
            if len(sound):
                counter, values = self.description.split(sound)
                return Chunk(host_time=np.full(len(sound), arrived), counter=counter, values=values)
            if arrived >= last:
                got = f"{self.errors} samples of another width than {width}" if self.errors else "nothing"
                raise RigTimeout(
                    f"{self.name}: wanted a reading within {deadline_s:g} s, got {got}; check that the device sends",
                    deadline_s=deadline_s,
                )

    def close(self) -> None:
        """Let go of the stream; harmless when called again."""
        if self._inlet is not None:
            self._inlet.close_stream()
            self._inlet = None

    def _pull(self, inlet: Inlet, wait_s: float) -> tuple[list[list[float]], list[float]]:
        try:
            return inlet.pull_chunk(timeout=wait_s)
        except (RuntimeError, OSError) as error:  # pylsl's LostError is a RuntimeError
            raise LinkError(
                f"{self.name}: wanted readings, got a lost stream: {error}; start the sender again"
            ) from error


def stay_offline() -> None:
    """Tell the library, before its first use in this process, to look on this computer only; a stated configuration stays."""
    if "LSLAPICFG" not in os.environ:
        path = Path(tempfile.gettempdir()) / f"undrift-lsl-{os.getpid()}.cfg"
        path.write_text(OFFLINE, encoding="ascii")
        os.environ["LSLAPICFG"] = str(path)


def open_from(address: Address) -> Source:
    """Return a source that reads an LSL stream.

    Parameters
    ----------
    address : Address
        Place: name of the stream; option offline.

    Returns
    -------
    Source
        Not opened yet.

    Raises
    ------
    InputError
        No name, or an option that is none of a stream's.
    """
    name, offline = address.place, address.option("offline", "no")
    if not name or offline not in ("yes", "no"):
        raise InputError(f"device: wanted lsl:name?offline=yes or no, got '{name}' and '{offline}'; name the stream")

    def connect() -> Inlet:
        if offline == "yes":
            stay_offline()
        return _inlet(name)

    return LslSource(f"lsl:{name}", address.describe("offline"), connect)


def _inlet(name: str) -> Inlet:
    try:
        import pylsl
    except (ImportError, RuntimeError) as error:  # the second where the library beneath it is missing
        raise LinkError("lsl: wanted the package pylsl, got none; pip install undrift[live]") from error
    found = pylsl.resolve_byprop("name", name, timeout=RESOLVE_S)
    if not found:
        raise LinkError(f"lsl:{name}: wanted a stream of that name, got none in {RESOLVE_S:g} s; start the sender")
    steadied: Inlet = pylsl.StreamInlet(
        found[0], recover=False, processing_flags=pylsl.proc_dejitter | pylsl.proc_monotonize
    )
    return steadied
