"""Bench: an emulated table, chamber and device together, on loopback sockets, on one clock; and hands that mount the device.

The hands are a socket of their own: ``MOUNT +x`` is answered by ``OK +x``, ``FACE?`` by the face that points up.
"""

import contextlib
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self, cast
from urllib.parse import urlsplit

import numpy as np

from undrift.errors import InputError, RigFault
from undrift.session import Face
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.random import random_device
from undrift.sim.rig.air import AirSettings
from undrift.sim.rig.chamber import EmulatedChamber
from undrift.sim.rig.clock import Clock
from undrift.sim.rig.emulator import Emulator, EmulatorSettings, start_emulator
from undrift.sim.rig.faults import FaultyLink
from undrift.sim.rig.server import Server
from undrift.sim.rig.stream import EmulatedDevice, StreamSettings

HANDS_TIMEOUT_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchPorts:
    """Where the parts of a bench listen; 0 takes a free port.

    Parameters
    ----------
    chamber, hands : int
        Of the chamber and of the hands; table and device have theirs in their own settings.
    """

    chamber: int = 0
    hands: int = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EmulatedBenchSettings:
    """What is emulated.

    Parameters
    ----------
    rig : EmulatorSettings
        The table; its speed is that of the whole bench.
    air : AirSettings
        The chamber.
    stream : StreamSettings
        How the device is mounted and sends.
    device : DeviceModel or None
        The hidden truth; None draws one of consumer grade from the stream's seed.
    ports : BenchPorts
        Where the chamber and the hands listen.
    """

    rig: EmulatorSettings = field(default_factory=EmulatorSettings)
    air: AirSettings = field(default_factory=AirSettings)
    stream: StreamSettings = field(default_factory=StreamSettings)
    device: DeviceModel | None = None
    ports: BenchPorts = field(default_factory=BenchPorts)


class Bench:
    """A running bench; a context manager that closes it.

    Parameters
    ----------
    settings : EmulatedBenchSettings
        What is emulated.
    clock : Clock, optional
        Emulated time; the host's clock times the rig's speed unless given.
    """

    def __init__(self, settings: EmulatedBenchSettings, clock: Clock | None = None) -> None:
        self.settings = settings
        chosen = settings.device or random_device(np.random.default_rng(settings.stream.seed), grade="consumer")
        self.device: DeviceModel = chosen
        with contextlib.ExitStack() as opened:
            self.rig: Emulator = opened.enter_context(start_emulator(settings.rig, clock=clock))
            host = settings.rig.host
            self.chamber = EmulatedChamber(settings.air, self.rig.clock, host, settings.ports.chamber)
            opened.callback(self.chamber.close)
            self.stream = EmulatedDevice(chosen, self.rig, self.chamber.board_temp, self.rig.clock, settings.stream)
            opened.callback(self.stream.close)
            hands = Server(_Hands(self.stream), FaultyLink(), (host, settings.ports.hands))
            opened.callback(hands.close)
            self._opened = opened.pop_all()
        options = f"?clock_speed={settings.rig.speed!r}"
        if settings.rig.kind == "galil":
            options += f"&encoder_lines={settings.rig.servo.encoder_lines}"
        self.rig_address = f"{settings.rig.kind}:tcp://{self.rig.host}:{self.rig.port}{options}"
        self.device_address = self.stream.address(settings.rig.speed)
        self.chamber_address = self.chamber.address
        self.hands_address = f"tcp://{hands.host}:{hands.port}"

    def __enter__(self) -> Self:
        """Return the bench itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it.

        Parameters
        ----------
        kind, error, trace : object
            What ended the block.
        """
        self.close()

    def mount(self, face: Face) -> None:
        """Mount the device with another face up.

        Parameters
        ----------
        face : str
            "+x", ... "-z".

        Raises
        ------
        InputError
            Not a face.
        """
        self.stream.mount(face)

    def close(self) -> None:
        """Close every socket and end every thread; harmless when called again."""
        self._opened.close()


class BenchHands:
    """Hands of an emulated bench in another process, as a run asks for them.

    Parameters
    ----------
    address : str
        ``hands_address`` of the bench.
    """

    def __init__(self, address: str) -> None:
        parts = urlsplit(address)
        if parts.scheme != "tcp" or not parts.hostname or not parts.port:
            raise InputError(f"hands: wanted tcp://host:port, got '{address}'; rig emulate prints it")
        self._place = (parts.hostname, parts.port)

    def mount(self, up: Face) -> None:
        """Have the device mounted.

        Parameters
        ----------
        up : str
            Axis of the device that points up.

        Raises
        ------
        RigFault
            The bench is not there, or did not do it.
        """
        try:
            with socket.create_connection(self._place, timeout=HANDS_TIMEOUT_S) as link:
                link.sendall(f"MOUNT {up}\n".encode("ascii"))
                said = link.makefile("r", encoding="ascii", errors="replace").readline().strip()
        except OSError as error:
            raise RigFault(f"hands: wanted {up} up, got '{error}'; is the emulated bench running?") from error
        if said != f"OK {up}":
            raise RigFault(f"hands: wanted {up} up, got '{said}'; mount it with a face that there is")


def start_bench(settings: EmulatedBenchSettings | None = None, *, clock: Clock | None = None) -> Bench:
    """Start an emulated bench; use it in a `with` block, or close it.

    Parameters
    ----------
    settings : EmulatedBenchSettings, optional
        What is emulated.
    clock : Clock, optional
        A HandClock makes it repeatable.

    Returns
    -------
    Bench
        Listening.

    Raises
    ------
    InputError
        Settings that do not fit, or a host that is not a loopback address.
    """
    return Bench(settings or EmulatedBenchSettings(), clock)


class _Hands:
    """What stands behind the hands' socket."""

    def __init__(self, device: EmulatedDevice) -> None:
        self._do: Callable[[Face], None] = device.mount
        self._device = device

    def open_session(self, serial: bool) -> "_Hands":
        return self

    def close_session(self, session: object) -> None:
        pass

    def tick(self) -> None:
        pass

    def greet(self) -> bytes:
        return b""

    def unasked(self) -> bytes:
        return b""

    def feed(self, data: bytes) -> list[bytes]:
        return [self._answer(line.strip()).encode("ascii") + b"\n" for line in data.decode("latin-1").splitlines()]

    def _answer(self, line: str) -> str:
        if line == "FACE?":
            return str(self._device.face)
        word, _, face = line.partition(" ")
        try:
            if word != "MOUNT":
                raise InputError("hands: wanted MOUNT +x or FACE?, got another word; say one of them")
            self._do(cast(Face, face))
        except InputError as error:
            return f"ERROR {error}".encode("ascii", errors="replace").decode("ascii")
        return f"OK {face}"
