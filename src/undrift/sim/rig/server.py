"""Server: one thread that carries bytes between clients and an emulated machine, over TCP on the loopback and over a pty.

The thread also brings the machine up to now every few milliseconds, so that it goes on while no client says anything.
"""

import contextlib
import os
import selectors
import socket
import threading
import time
import tty
from collections import deque
from typing import Protocol

from undrift.sim.rig.faults import FaultyLink

TICK_S = 0.005
READ_SIZE = 4096


class Session(Protocol):
    """What a machine gives to a client."""

    def greet(self) -> bytes:
        """Return what a new client hears."""

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes, return answers.

        Parameters
        ----------
        data : bytes
            Any.
        """

    def unasked(self) -> bytes:
        """Return what is said without being asked."""


class Machine(Protocol):
    """What stands behind the server."""

    def open_session(self, serial: bool) -> Session:
        """Return a new client's session.

        Parameters
        ----------
        serial : bool
            True for a serial link.
        """

    def close_session(self, session: object) -> None:
        """Forget a client.

        Parameters
        ----------
        session : object
            Which.
        """

    def tick(self) -> None:
        """Come up to now."""


class _Client:
    def __init__(self, session: Session, connection: socket.socket | None, descriptor: int) -> None:
        self.session, self.connection, self.descriptor = session, connection, descriptor
        self.pending: deque[tuple[float, bytes]] = deque()

    def free_at(self) -> float:
        return self.pending[-1][0] if self.pending else 0.0


class Server:
    """Serves until closed.

    Parameters
    ----------
    machine : Machine
        The emulated controller.
    link : FaultyLink
        What is done to answers.
    address : tuple
        Host and port; port 0 takes a free one.
    with_pty : bool
        True opens a pseudo terminal as well.
    """

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
        """Cut the power: clients are dropped and none is taken until it comes back.

        Parameters
        ----------
        dark : bool
            True for no power.
        """
        self._dark = dark
        self.settle()

    def settle(self, timeout_s: float = 2.0) -> None:
        """Wait until the thread has gone round once more.

        Parameters
        ----------
        timeout_s : float
            At most so long, s.
        """
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
