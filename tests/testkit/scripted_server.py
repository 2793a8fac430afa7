"""Servers with scripted answers for the rig's drivers, over a real socket on loopback or within a virtual clock."""

import contextlib
import socket
import threading
from collections.abc import Callable, Iterable
from typing import Any

from testkit.virtual_clock import VirtualClock

Answer = Callable[[str], bytes | None]


class Scripted:
    """Server on a free port. A function answers each command that ends with the terminator. None means no answer."""

    def __init__(self, answer: Answer, terminator: bytes = b"\r", at_once: str = "") -> None:
        self.heard: list[str] = []
        self._answer = answer
        self._terminator = terminator
        self._at_once = at_once.encode("latin-1")
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._clients: list[socket.socket] = []
        self._came = threading.Event()
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    @property
    def url(self) -> str:
        host, port = self._listener.getsockname()
        return f"tcp://{host}:{port}"

    def __enter__(self) -> "Scripted":
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def say(self, data: bytes) -> None:
        self._client().sendall(data)

    def hang_up(self) -> None:
        self._client().shutdown(socket.SHUT_RDWR)

    def refuse_from_now_on(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.hang_up()

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for client in self._clients:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join(timeout=5)
        for client in self._clients:
            client.close()

    def _client(self) -> socket.socket:
        """Return the latest client. A client that connected just now may not be accepted yet."""
        assert self._came.wait(timeout=10.0), "nobody connected"
        return self._clients[-1]

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            self._clients.append(client)
            self._came.set()
            thread = threading.Thread(target=self._serve, args=(client,))
            self._threads.append(thread)
            thread.start()

    def _serve(self, client: socket.socket) -> None:
        waiting = b""
        try:
            while data := client.recv(4096):
                waiting = self._hear(client, waiting, data)
        except OSError:
            return

    def _hear(self, client: Any, waiting: bytes, data: bytes) -> bytes:
        """Answer completed commands and return the incomplete rest."""
        for byte in data:
            waiting += bytes([byte])
            if bytes([byte]) in self._at_once and self._at_once:
                self._do(client, chr(byte))
                waiting = waiting[:-1]
            elif waiting.endswith(self._terminator):
                self._do(client, waiting[: -len(self._terminator)].decode("latin-1"))
                waiting = b""
        return waiting

    def _do(self, client: Any, command: str) -> None:
        self.heard.append(command)
        if (answer := self._answer(command)) is not None:
            client.sendall(answer)


class Line:
    """One client's way to a scripted server on a virtual clock."""

    datagrams = False

    def __init__(self, server: "VirtualScripted", clock: VirtualClock) -> None:
        self.cut = False
        self._server, self._clock, self._waiting, self._said = server, clock, b"", b""

    def sendall(self, data: bytes) -> None:
        self._said += data

    def receive(self, wait_s: float) -> bytes:
        if not self._said:
            if self.cut:
                raise EOFError("the other side closed the connection")
            self._clock.jump(self._clock.now() + wait_s)
        data, self._said = self._said, b""
        return data

    def write(self, data: bytes) -> None:
        if self.cut:
            raise BrokenPipeError("Broken pipe")
        self._clock.jump(self._clock.now() + 2e-4)
        self._waiting = self._server._hear(self, self._waiting, data)

    def close(self) -> None:
        self.cut = True


class VirtualScripted(Scripted):
    """The same server within a virtual clock. Only the client that waits for an answer spends the time for it."""

    def __init__(self, answer: Answer, clock: VirtualClock, terminator: bytes = b"\r", at_once: str = "") -> None:
        self.heard: list[str] = []
        self._answer, self._terminator, self._at_once = answer, terminator, at_once.encode("latin-1")
        self._clock, self._lines = clock, list[Line]()
        self._port = clock.listen("127.0.0.1", 0, self._connect)

    @property
    def url(self) -> str:
        return f"tcp://127.0.0.1:{self._port}"

    @property
    def line(self) -> Line:
        """Return the line of the latest client."""
        return self._lines[-1]

    def hang_up(self) -> None:
        self.line.cut = True

    def refuse_from_now_on(self) -> None:
        self._clock.forget("127.0.0.1", self._port)
        for line in self._lines:
            line.cut = True

    def accept_again(self) -> None:
        self._clock.listen("127.0.0.1", self._port, self._connect)

    def close(self) -> None:
        self._clock.forget("127.0.0.1", self._port)

    def _connect(self) -> Line:
        self._lines.append(Line(self, self._clock))
        return self.line


def transcript(lines: Iterable[tuple[str, bytes]]) -> tuple[Answer, list[str]]:
    """Return an answer that plays a dialogue in its order, and the list of what did not fit it."""
    residual = list(lines)
    wrong: list[str] = []

    def answer(command: str) -> bytes:
        if not residual or residual[0][0] != command:
            wrong.append(f"heard {command!r}, wanted {residual[0][0] if residual else 'nothing'!r}")
            return b"?"
        return residual.pop(0)[1]

    return answer, wrong
