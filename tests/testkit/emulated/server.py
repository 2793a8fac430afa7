"""Server: carries bytes between clients and an emulated machine, over TCP on the loopback, over a pty, or within a virtual clock.

On the host's clock it is a thread, which also brings the machine up to now every few milliseconds, so that it goes on while no
client says anything. Faults of the link change the bytes of answers between machine and client.
"""

import contextlib
import math
import os
import random
import selectors
import socket
import threading
from collections import deque
from collections.abc import Callable
from typing import Self

from undrift.base.clock import Clock, VirtualClock
from undrift.errors import InputError

LINK_FAULTS = {
    "drop_bytes": "every third byte of each answer is lost",
    "stall": "answers are held back until the fault is cleared, then come late; the card keeps executing its last command",
    "garbage": "each answer is replaced by random bytes without a prompt",
    "half_reply": "the second half of each answer, prompt included, is lost",
    "slow_link": "answers come at 20 bytes a second of the host's time",
    "late_reply": "each answer comes 0.5 s late, host's time",
    "disconnect": "every client's socket is closed once; the card keeps executing its last command, clients may come back",
}
SLOW_BYTES_PER_S = 20.0
LATE_S = 0.5


class FaultyLink:
    """What the link does to answers."""

    def __init__(self, clock: Clock, seed: int = 0) -> None:
        self.now = clock.host.now
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
            for known in list(self._active) if name is None else [name]:
                self._active.pop(known, None)

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
        now = max(self.now(), free_at)
        with self._lock:
            if self._struck("garbage"):
                letters = [byte for byte in range(256) if byte not in b":?"]
                answer = bytes(self._random.choice(letters) for _ in range(len(answer) + 8))
            if self._struck("half_reply"):
                answer = answer[: len(answer) // 2]
            if self._struck("drop_bytes"):
                kept = bytes(byte for place, byte in enumerate(answer, start=1) if place % 3)
                answer = kept if len(answer) > 1 else b""
            if self._struck("late_reply"):
                now = max(self.now() + LATE_S, free_at)
            if self._struck("slow_link"):
                step = 1.0 / SLOW_BYTES_PER_S
                return [(now + step * (place + 1), answer[place : place + 1]) for place in range(len(answer))]
        return [(now, answer)]

    def _struck(self, name: str) -> bool:
        left = self._active.get(name, 0)
        if left is not None and left > 1:
            self._active[name] = left - 1
        elif left is not None:
            self._active.pop(name, None)
        return left != 0


# ---- What stands behind the server


class ClientSession:
    """One client of a machine: this one reads nothing and sends what it is given."""

    def __init__(self, machine: "Machine") -> None:
        self._machine, self._unasked = machine, b""

    def greet(self) -> bytes:
        """Return what a new client hears."""
        return b""

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes letter by letter, return answers; without power there are none."""
        machine = self._machine
        with machine.lock:
            machine.tick()
            answers = [self._take(letter) for letter in data.decode("latin-1")] if machine.powered else []
            machine.tick()
            return [answer.encode("latin-1", "replace") for answer in answers if answer]

    def _take(self, letter: str) -> str:
        return ""

    def tell(self, data: bytes) -> None:
        """Queue a message."""
        self._unasked += data

    def unasked(self) -> bytes:
        """Return what the machine says without being asked, since the last look."""
        data, self._unasked = self._unasked, b""
        return data


class Machine:
    """A machine, its clock and its clients."""

    def __init__(self, clock: Clock) -> None:
        self.clock, self.lock = clock, threading.RLock()
        self.sessions: list[ClientSession] = []

    @property
    def powered(self) -> bool:
        """Whether it has power."""
        return True

    def new_session(self, serial: bool) -> ClientSession:
        """Make what a client talks to."""
        return ClientSession(self)

    def open_session(self, serial: bool) -> ClientSession:
        """Return what a new client talks to."""
        with self.lock:
            self.sessions.append(self.new_session(serial))
            return self.sessions[-1]

    def close_session(self, session: ClientSession) -> None:
        """Forget a client; the machine goes on."""
        with self.lock:
            self.sessions = [kept for kept in self.sessions if kept is not session]

    def tell(self, text: str) -> None:
        """Say something to all clients."""
        for session in self.sessions:
            session.tell(text.encode("latin-1", "replace"))

    def tick(self) -> None:
        """Come up to now."""


class LineSession(ClientSession):
    """One client that gives commands line by line."""

    def __init__(self, machine: "Machine", obey: Callable[[str], str]) -> None:
        super().__init__(machine)
        self._obey, self._held = obey, b""

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes, return answers."""
        *lines, self._held = (self._held + data).split(b"\n")
        self._held = self._held[-1024:]
        answers = [self._obey(line.decode("ascii", errors="replace").strip()) for line in lines]
        return [answer.encode("ascii") + b"\n" for answer in answers if answer]


class LineMachine(Machine):
    """A machine whose clients give commands line by line; what it refuses is answered by ERROR."""

    def __init__(self, clock: Clock, obey: Callable[[str], str]) -> None:
        super().__init__(clock)
        self._obey = obey

    def new_session(self, serial: bool) -> ClientSession:
        """Make what a client talks to."""
        return LineSession(self, self._answer)

    def _answer(self, line: str) -> str:
        try:
            return self._obey(line)
        except InputError as error:
            return f"ERROR {error}".encode("ascii", errors="replace").decode("ascii")


class Closed:
    """What is closed at the end of a `with` block."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close every socket and end every thread; harmless when called again."""


class Served(Closed):
    """A machine with a server of its own, and faults."""

    faulty = "fault"  # what a message calls its faults
    faults: dict[str, str]

    def serve(self, machine: Machine, address: tuple[str, int], seed: int, with_pty: bool = False) -> None:
        """Begin to listen."""
        self._lock, self._broken = machine.lock, set[str]()
        self._link = FaultyLink(machine.clock, seed)
        self._server = server_of(machine, self._link, address, with_pty)
        self.host, self.port = self._server.host, self._server.port

    def set_fault(self, fault: str, on: bool) -> None:
        """Break or mend a part of the machine."""

    def inject(self, fault: str, *, answers: int | None = None) -> None:
        """Let a fault begin."""
        self._check(fault)
        if fault in LINK_FAULTS:
            self._link.start(fault, answers)
        else:
            with self._lock:
                self.set_fault(fault, True)
                self._broken.add(fault)
        self._server.settle()

    def clear(self, fault: str | None = None) -> None:
        """Let a fault end, or all."""
        if fault is not None:
            self._check(fault)
        self._link.stop(fault)
        with self._lock:
            for name in sorted(self._broken & ({fault} if fault else self._broken)):
                self.set_fault(name, False)
                self._broken.discard(name)
        self._server.settle()

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._server._clients) if isinstance(self._server, Server) else 0

    def close(self) -> None:
        """Close every socket and end the thread; harmless when called again."""
        self._server.close()

    def _check(self, fault: str) -> None:
        if fault not in (*LINK_FAULTS, *self.faults):
            known = ", ".join((*LINK_FAULTS, *self.faults))
            raise InputError(f"{self.faulty}: wanted one of {known}, got '{fault}'; name one of them")


# ---- Server

TICK_S, IDLE_S = 0.005, 0.02  # between two looks: of a client on a virtual clock, of a server that nobody asks (host s)
READ_SIZE = 4096
# Fair to all clients: each is obeyed for so long in a round, so many bytes at a time, and is read no further while it has not been
# obeyed, or does not read so many answers of its own.
TURN_S = 0.005
MOUTHFUL = 16
UNREAD = 4096


class _Client:
    """Who talks to a machine, and what is under way to them."""

    def __init__(
        self, session: ClientSession, link: FaultyLink, connection: socket.socket | None = None, descriptor: int = -1
    ) -> None:
        self.session, self._link = session, link
        self.connection, self.descriptor = connection, descriptor
        self.inbox = b""  # what was read and is still to be obeyed
        self.pending: deque[tuple[float, bytes]] = deque()  # and when each is due

    def queue(self, answer: bytes) -> None:
        if answer:
            self.pending.extend(self._link.pass_on(answer, self.pending[-1][0] if self.pending else 0.0))

    def feed(self, data: bytes) -> None:
        for answer in self.session.feed(data):
            self.queue(answer)

    @property
    def is_due(self) -> bool:
        """Whether the first answer that is under way arrives now."""
        return bool(self.pending) and not self._link.stalled and self.pending[0][0] <= self._link.now()


class Server:
    """Serves until closed, from a thread."""

    def __init__(self, machine: Machine, link: FaultyLink, address: tuple[str, int], with_pty: bool = False) -> None:
        self._machine, self._link = machine, link
        self._listener = socket.create_server(address)
        self._listener.setblocking(False)
        self.host, self.port = self._listener.getsockname()[:2]
        self.pty_path: str | None = None
        self._wake, self._woken = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._selector.register(self._woken, selectors.EVENT_READ, lambda: self._woken.recv(READ_SIZE))
        self._clients: list[_Client] = []
        self._descriptors: tuple[int, ...] = ()
        self.dark = False  # power is cut: clients are dropped and none is taken
        self._closing = False
        self._settled = threading.Event()
        if with_pty:
            self._descriptors = near, far = os.openpty()  # the far end stays open: a client may come and go
            import tty

            tty.setraw(far)
            os.set_blocking(near, False)
            self.pty_path = os.ttyname(far)
            self._welcome(_Client(self._machine.open_session(serial=True), link, None, near))
        self._thread = threading.Thread(target=self._serve, name="emulated-rig", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and close every socket; harmless when called again."""
        if not self._closing:
            self._closing = True
            with contextlib.suppress(OSError):  # the thread may have seen it by itself, and closed all
                self._wake.send(b"x")
            self._thread.join()

    def settle(self, timeout_s: float = 2.0) -> None:
        """Wait until the thread has gone round once more; a server that was closed is settled."""
        self._settled.clear()
        with contextlib.suppress(OSError):
            self._wake.send(b"x")
            self._settled.wait(timeout_s)

    def _serve(self) -> None:
        try:
            while not self._closing:
                settling = not self._settled.is_set()
                due = min((client.pending[0][0] for client in self._clients if client.pending), default=math.inf)
                due = 0.0 if any(client.inbox for client in self._clients) else due
                for key, _ in self._selector.select(min(max(due - self._link.now(), 0.0), IDLE_S)):
                    key.data()
                self._machine.tick()
                if self.dark or self._link.take_disconnect():
                    self._drop_all()
                for client in list(self._clients):
                    self._obey(client)
                    self._speak(client)
                    self._listen(client)
                if settling:
                    self._settled.set()
        finally:
            self._drop_all()
            for closed in (self._selector, self._listener, self._wake, self._woken):
                closed.close()
            for descriptor in self._descriptors:
                os.close(descriptor)
            self._settled.set()

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:
            return
        if self.dark:
            connection.close()
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = _Client(self._machine.open_session(serial=False), self._link, connection, connection.fileno())
        self._welcome(client)
        client.queue(client.session.greet())

    def _welcome(self, client: _Client) -> None:
        self._clients.append(client)
        self._listen(client)

    def _hear(self, client: _Client) -> None:
        try:
            client.inbox = os.read(client.descriptor, READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            client.inbox = b""
        if not client.inbox:
            self._drop(client)

    def _obey(self, client: _Client) -> None:
        """Give a client its turn; the rest of what it sent waits for the next."""
        until = self._link.now() + TURN_S
        while client.inbox:
            mouthful, client.inbox = client.inbox[:MOUTHFUL], client.inbox[MOUTHFUL:]
            client.feed(mouthful)
            if self._link.now() > until:
                return

    def _listen(self, client: _Client) -> None:
        """Read from a client only what can be obeyed soon; its system holds back the rest."""
        if client not in self._clients:
            return
        wanted = not client.inbox and len(client.pending) < UNREAD
        if wanted and client.descriptor not in self._selector.get_map():
            self._selector.register(client.descriptor, selectors.EVENT_READ, lambda: self._hear(client))
        elif not wanted and client.descriptor in self._selector.get_map():
            self._selector.unregister(client.descriptor)

    def _speak(self, client: _Client) -> None:
        client.queue(client.session.unasked())
        while client.is_due:
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
        client.inbox = b""
        if client.connection is None:  # a terminal stays; what is in its line is lost
            return
        if client.descriptor in self._selector.get_map():
            self._selector.unregister(client.descriptor)
        client.connection.close()
        self._machine.close_session(client.session)
        self._clients.remove(client)


# ---- Within a virtual clock: who waits for an answer takes the time that it needs, and nobody else does.

WIRE_S = 2e-4  # that bytes are under way, either way


class Wire:
    """One client's way to a machine on the same virtual clock."""

    datagrams = False

    def __init__(self, machine: Machine, link: FaultyLink, clock: VirtualClock) -> None:
        self.cut = False
        self._machine, self._clock = machine, clock
        self._client = _Client(machine.open_session(serial=False), link)
        self._client.queue(self._client.session.greet())

    def receive(self, wait_s: float) -> bytes:
        """Return what has come, after as long as that takes."""
        clock, client = self._clock, self._client
        last = clock.now() + wait_s
        while True:
            self._machine.tick()
            client.queue(client.session.unasked())
            if self.cut:
                raise EOFError("the other side closed the connection")
            if client.is_due:
                clock.jump(clock.now() + WIRE_S)
                data = b""
                while client.is_due:
                    data += client.pending.popleft()[1]
                return data
            if clock.now() >= last:
                return b""
            due = client.pending[0][0] if client.pending else math.inf
            clock.jump(min(last, due if due > clock.now() else math.inf, clock.now() + TICK_S))

    def write(self, data: bytes) -> None:
        """Send all of it."""
        if self.cut:
            raise BrokenPipeError("Broken pipe")
        self._clock.jump(self._clock.now() + WIRE_S)
        self._machine.tick()
        self._client.feed(data)

    def wake(self) -> None:
        """Nothing to do: no other thread waits."""

    def close(self) -> None:
        """Let go of the machine."""
        if not self.cut:
            self.cut = True
            self._machine.close_session(self._client.session)


class VirtualServer:
    """Serves those on the same virtual clock until closed."""

    pty_path = None

    def __init__(self, machine: Machine, link: FaultyLink, address: tuple[str, int], clock: VirtualClock) -> None:
        self._machine, self._link, self._clock = machine, link, clock
        self._wires: list[Wire] = []
        self.dark = False
        self.host = address[0]
        self.port = clock.listen(*address, self._connect)

    def close(self) -> None:
        """Cut every wire; harmless when called again."""
        self._clock.forget(self.host, self.port)
        self._cut()

    def settle(self, timeout_s: float = 0.0) -> None:
        """Let a fault that begins or ends be felt."""
        self._machine.tick()
        if self.dark or self._link.take_disconnect():
            self._cut()

    def _connect(self) -> Wire:
        if self.dark:
            raise ConnectionRefusedError("Connection refused: no power")
        self._wires = [wire for wire in self._wires if not wire.cut]
        self._wires.append(Wire(self._machine, self._link, self._clock))
        return self._wires[-1]

    def _cut(self) -> None:
        for wire in self._wires:
            wire.close()
        self._wires.clear()


def server_of(
    machine: Machine, link: FaultyLink, address: tuple[str, int], with_pty: bool = False
) -> Server | VirtualServer:
    """Return what carries bytes to a machine, by the clock that the machine goes by."""
    if isinstance(machine.clock, VirtualClock):
        return VirtualServer(machine, link, address, machine.clock)
    return Server(machine, link, address, with_pty)
