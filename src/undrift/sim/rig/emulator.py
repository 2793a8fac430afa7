"""Emulator: a rig that does not exist, on a real socket.

Server: one thread that carries bytes between clients and an emulated machine, over TCP on the loopback and over a pty.

The thread also brings the machine up to now every few milliseconds, so that it goes on while no client says anything.

Faults: what an emulated rig can be made to suffer, and what the real one would do.

Faults of the link change the bytes of answers between card and client; faults of the rig are handed to the machine.
"""

import contextlib
import os
import random
import selectors
import socket
import threading
import time
import tty
from collections import deque
from dataclasses import dataclass, field
from types import TracebackType
from typing import Literal, Protocol, Self, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.sim.rig.axes import Clock, HostClock, ServoSettings
from undrift.sim.rig.galil_card import CardSettings
from undrift.sim.rig.galil_language import GalilMachine
from undrift.sim.rig.grbl import GrblMachine, GrblSettings

# ---- Faults: what an emulated rig can be made to suffer, and what the real one would do.

LINK_FAULTS = {
    "drop_bytes": "every third byte of each answer is lost",
    "stall": "answers are held back until the fault is cleared, then come late; the card keeps executing its last command",
    "garbage": "each answer is replaced by random bytes without a prompt",
    "half_reply": "the second half of each answer, prompt included, is lost",
    "slow_link": "answers come at 20 bytes a second of the host's time",
    "late_reply": "each answer comes 0.5 s late, host's time",
    "disconnect": "every client's socket is closed once; the card keeps executing its last command, clients may come back",
}
RIG_FAULTS = {
    "amplifier_fault": "no torque while it lasts; with OE1 the card switches the motor off, SC 8; else the error grows",
    "encoder_loss": "the count freezes and the axis runs away, until the error passes ER with OE1: motor off, SC 8",
    "limit_switch": "the forward switch closes: a forward motion slows to rest, SC 2; BG forward is refused with TC 22",
    "limit_switch_reverse": "the reverse switch closes: a reverse motion slows to rest, SC 3; BG back is refused with TC 22",
    "abort_input": "the motion ends at once, SC 6; with OE1 the motor is switched off",
    "power_cut": "sockets close, none is accepted, the axis coasts to rest by friction; cleared, the card starts afresh",
    "message": "the card sends a line that nobody asked for, once",
}
SLOW_BYTES_PER_S = 20.0
LATE_S = 0.5


def check_fault(name: str) -> None:
    """Refuse a fault that is not one."""
    if name not in LINK_FAULTS and name not in RIG_FAULTS:
        known = ", ".join((*LINK_FAULTS, *RIG_FAULTS))
        raise InputError(f"fault: wanted one of {known}, got '{name}'; name one of them")


class FaultyLink:
    """What the link does to answers."""

    def __init__(self, seed: int = 0) -> None:
        self._active: dict[str, int | None] = {}  # answers that it still lasts for; None without end
        self._random = random.Random(seed)
        self._lock = threading.Lock()

    def start(self, name: str, answers: int | None) -> None:
        """Let a fault begin."""
        with self._lock:
            self._active[name] = answers

    def stop(self, name: str | None) -> None:
        """Let a fault end."""
        with self._lock:
            if name is None:
                self._active.clear()
            else:
                self._active.pop(name, None)

    @property
    def stalled(self) -> bool:
        """Whether answers are held back."""
        with self._lock:
            return "stall" in self._active

    def take_disconnect(self) -> bool:
        """Tell, once, that clients are to be cut off."""
        with self._lock:
            return self._active.pop("disconnect", 0) != 0

    def pass_on(self, answer: bytes, free_at: float) -> list[tuple[float, bytes]]:
        """Return an answer as it arrives: pieces with the host's time at which each is sent."""
        now = max(time.monotonic(), free_at)
        with self._lock:
            if self._struck("garbage"):
                letters = [byte for byte in range(256) if byte not in b":?"]
                answer = bytes(self._random.choice(letters) for _ in range(len(answer) + 8))
            if self._struck("half_reply"):
                answer = answer[: len(answer) // 2]
            if self._struck("drop_bytes"):
                answer = (
                    bytes(byte for place, byte in enumerate(answer, start=1) if place % 3) if len(answer) > 1 else b""
                )
            if self._struck("late_reply"):
                now = max(time.monotonic() + LATE_S, free_at)
            if self._struck("slow_link"):
                step = 1.0 / SLOW_BYTES_PER_S
                return [(now + step * (place + 1), answer[place : place + 1]) for place in range(len(answer))]
        return [(now, answer)]

    def _struck(self, name: str) -> bool:
        if name not in self._active:
            return False
        left = self._active[name]
        if left is not None:
            if left <= 1:
                del self._active[name]
            else:
                self._active[name] = left - 1
        return True


# ---- Server: one thread that carries bytes between clients and an emulated machine, over TCP on the loopback and over a pty.

TICK_S = 0.005
READ_SIZE = 4096


class Session(Protocol):
    """What a machine gives to a client."""

    def greet(self) -> bytes:
        """Return what a new client hears."""

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes, return answers."""

    def unasked(self) -> bytes:
        """Return unsolicited messages."""


class Machine(Protocol):
    """What stands behind the server."""

    def open_session(self, serial: bool) -> Session:
        """Return a new client's session."""

    def close_session(self, session: object) -> None:
        """Forget a client."""

    def tick(self) -> None:
        """Come up to now."""


class _Client:
    def __init__(self, session: Session, connection: socket.socket | None, descriptor: int) -> None:
        self.session, self.connection, self.descriptor = session, connection, descriptor
        self.pending: deque[tuple[float, bytes]] = deque()

    def free_at(self) -> float:
        return self.pending[-1][0] if self.pending else 0.0


class Server:
    """Serves until closed."""

    def __init__(self, machine: Machine, link: FaultyLink, address: tuple[str, int], with_pty: bool = False) -> None:
        self._machine, self._link = machine, link
        self._listener = socket.create_server(address)
        self._listener.setblocking(False)
        self.host, self.port = self._listener.getsockname()[:2]
        self.pty_path: str | None = None
        self._wake, self._woken = socket.socketpair()
        self._woken.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._clients: list[_Client] = []
        self._descriptors: tuple[int, ...] = ()
        self._dark = self._closing = False
        self._settled = threading.Event()
        if with_pty:
            self._open_pty()
        self._thread = threading.Thread(target=self._serve, name="emulated-rig", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and close every socket; harmless when called again."""
        if not self._closing:
            self._closing = True
            with contextlib.suppress(OSError):  # the thread may have seen it by itself, and closed all
                self._wake.send(b"x")
            self._thread.join()

    def set_dark(self, dark: bool) -> None:
        """Cut the power: clients are dropped and none is taken until it comes back."""
        self._dark = dark
        self.settle()

    def settle(self, timeout_s: float = 2.0) -> None:
        """Wait until the thread has gone round once more."""
        self._settled.clear()
        self._wake.send(b"x")
        self._settled.wait(timeout_s)

    def _open_pty(self) -> None:
        near, far = os.openpty()
        tty.setraw(far)
        os.set_blocking(near, False)
        self._descriptors = (near, far)  # the far end stays open: a client may come and go
        self.pty_path = os.ttyname(far)
        self._clients.append(_Client(self._machine.open_session(serial=True), None, near))
        self._selector.register(near, selectors.EVENT_READ)

    def _serve(self) -> None:
        try:
            while not self._closing:
                settling = not self._settled.is_set()
                for key, _ in self._selector.select(self._wait()):
                    self._ready(key.fileobj)
                self._machine.tick()
                if self._dark or self._link.take_disconnect():
                    self._drop_all()
                for client in list(self._clients):
                    self._speak(client)
                if settling:
                    self._settled.set()
        finally:
            self._tear_down()

    def _wait(self) -> float:
        due = min((client.pending[0][0] for client in self._clients if client.pending), default=None)
        return TICK_S if due is None else min(max(due - time.monotonic(), 0.0), TICK_S)

    def _ready(self, source: object) -> None:
        if source is self._woken:
            self._woken.recv(READ_SIZE)
        elif source is self._listener:
            self._accept()
        else:
            client = next((c for c in self._clients if source in (c.connection, c.descriptor)), None)
            if client is not None:
                self._hear(client)

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:
            return
        if self._dark:
            connection.close()
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = _Client(self._machine.open_session(serial=False), connection, connection.fileno())
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ)
        self._queue(client, client.session.greet())

    def _hear(self, client: _Client) -> None:
        try:
            data = os.read(client.descriptor, READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return
        for answer in client.session.feed(data):
            self._queue(client, answer)

    def _queue(self, client: _Client, answer: bytes) -> None:
        if answer:
            client.pending.extend(self._link.pass_on(answer, client.free_at()))

    def _speak(self, client: _Client) -> None:
        self._queue(client, client.session.unasked())
        if self._link.stalled:
            return
        while client.pending and client.pending[0][0] <= time.monotonic():
            due, data = client.pending.popleft()
            try:
                sent = os.write(client.descriptor, data) if data else 0
            except BlockingIOError:
                sent = 0
            except OSError:
                self._drop(client)
                return
            if sent < len(data):  # the client does not read: keep the rest for later
                client.pending.appendleft((due, data[sent:]))
                return

    def _drop_all(self) -> None:
        for client in list(self._clients):
            self._drop(client)

    def _drop(self, client: _Client) -> None:
        client.pending.clear()
        if client.connection is None:  # a terminal stays; what is in its line is lost
            return
        self._selector.unregister(client.connection)
        client.connection.close()
        self._machine.close_session(client.session)
        self._clients.remove(client)

    def _tear_down(self) -> None:
        self._drop_all()
        self._selector.close()
        self._listener.close()
        self._wake.close()
        self._woken.close()
        for descriptor in self._descriptors:
            os.close(descriptor)
        self._settled.set()


# ---- emulator

EmulatorKind = Literal["galil", "grbl"]
LOOPBACK = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True, slots=True, kw_only=True)
class EmulatorSettings:
    """What is emulated, and where it listens."""

    kind: EmulatorKind = "galil"  # galil (a servo card) or grbl (a stepper board)
    servo: ServoSettings = field(default_factory=ServoSettings)  # Loop of the servo card
    card: CardSettings = field(default_factory=CardSettings)  # The servo card
    grbl: GrblSettings = field(default_factory=GrblSettings)  # The stepper board
    host: str = "127.0.0.1"  # A loopback address
    port: int = 0  # 0 takes a free one
    with_pty: bool = False  # True opens a pseudo terminal as well
    speed: float = 1.0  # Emulated seconds in one of the host's
    history_s: float = 1200.0  # How far back the axis is remembered, emulated s
    fault_seed: int = 0  # Seed of the garbage on a faulty link


class Emulator:
    """A running rig; a context manager that closes it."""

    def __init__(self, settings: EmulatorSettings, clock: Clock | None = None) -> None:
        if settings.kind not in get_args(EmulatorKind):
            wanted = " or ".join(get_args(EmulatorKind))
            raise InputError(f"emulator kind: wanted {wanted}, got '{settings.kind}'; name one of them")
        if settings.host not in LOOPBACK:
            raise InputError(
                f"emulator host: wanted one of {', '.join(LOOPBACK)}, got '{settings.host}'; it serves this computer only"
            )
        GalilMachine(settings.servo, settings.card, HostClock()).card.axis.warm()
        chosen = clock or HostClock(settings.speed)
        self.settings, self.clock = settings, chosen
        self.machine: GalilMachine | GrblMachine
        if settings.kind == "galil":
            self.machine = GalilMachine(settings.servo, settings.card, chosen, settings.history_s)
        else:
            self.machine = GrblMachine(settings.grbl, chosen, settings.history_s)
        self._broken: set[str] = set()
        self._link = FaultyLink(settings.fault_seed)
        self._server = Server(self.machine, self._link, (settings.host, settings.port), settings.with_pty)
        self.host: str = self._server.host
        self.port: int = self._server.port
        self.pty_path: str | None = self._server.pty_path

    def __enter__(self) -> Self:
        """Return the emulator itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Close every socket and end the thread; harmless when called again."""
        self._server.close()

    def now(self) -> float:
        """Return emulated time from the start, s."""
        return self.clock.now()

    @property
    def motor_on(self) -> bool:
        """Whether the motor holds the axis."""
        return self.machine.motor_on

    def axis_angle(self) -> float:
        """Return the true angle of the axis now, rad."""
        return self.machine.present()[0]

    def axis_rate(self) -> float:
        """Return the true turn rate of the axis now, rad/s."""
        return self.machine.present()[1]

    def axis_state(self, time: float, *, mean_s: float = 0.0) -> tuple[float, float]:
        """Return the true angle and turn rate at a moment of the past, or now."""
        angle, rate = self.axis_states(np.array([time]), mean_s=mean_s)
        return float(angle[0]), float(rate[0])

    def axis_states(self, times: FloatArray, *, mean_s: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return the true angle and turn rate at moments of the past: times (n,) s -> (n,) rad."""
        if not mean_s > 0.0:
            return self.machine.states(times)
        before = np.maximum(times - mean_s, 0.0)  # the axis rested before it was made
        angle, _ = self.machine.states(np.concatenate((times, before)))
        return angle[: len(times)], (angle[: len(times)] - angle[len(times) :]) / mean_s

    def history(self, last_s: float | None = None) -> tuple[FloatArray, FloatArray]:
        """Return where the axis has been, (n,) s."""
        return self.machine.history(last_s)

    def inject(self, fault: str, *, answers: int | None = None) -> None:
        """Let a fault begin; the names and what each does stand in sim/rig/emulator.py."""
        check_fault(fault)
        if fault in LINK_FAULTS:
            self._link.start(fault, answers)
        else:
            self.machine.set_fault(fault, True)
            self._broken.add(fault)
        if fault == "power_cut":
            self._server.set_dark(True)
        self._server.settle()

    def clear(self, fault: str | None = None) -> None:
        """Let a fault end; after a power cut the rig starts afresh."""
        if fault is not None:
            check_fault(fault)
        self._link.stop(fault)
        for name in sorted(self._broken & ({fault} if fault else self._broken)):
            self.machine.set_fault(name, False)
            self._broken.discard(name)
        self._server.set_dark("power_cut" in self._broken)
        self._server.settle()


def start_emulator(settings: EmulatorSettings | None = None, *, clock: Clock | None = None) -> Emulator:
    """Start an emulated rig; use it in a `with` block, or close it."""
    return Emulator(settings or EmulatorSettings(), clock)
