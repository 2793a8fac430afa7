"""Devices for tests: one on loopback, as fast as the socket allows, and one on a virtual clock that sends each piece on
time.
"""

import contextlib
import math
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Self

from testkit.virtual_clock import VirtualClock


class Listener:
    """Server on a free port of loopback with its threads, as a context manager."""

    def __init__(self, *work: Callable[[], None]) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._end = threading.Event()
        self._threads = [threading.Thread(target=run) for run in work]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self._end.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join(10)
        self._listener.close()


class Sender(Listener):
    """Device that sends pieces of bytes to its only client and stays open until it is closed or told to hang up."""

    def __init__(self, pieces: Iterable[bytes], hang_up: bool = False) -> None:
        self._pieces, self._hang_up = pieces, hang_up
        super().__init__(self._serve)

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            client, _ = self._listener.accept()
            with client:
                for piece in self._pieces:
                    client.sendall(piece)
                    if self._end.is_set():
                        return
                if not self._hang_up:
                    self._end.wait(30)


class Paced:
    """Sends pieces of bytes when they are due, s from the connection on, to its only client on a virtual clock."""

    datagrams = False

    def __init__(self, clock: VirtualClock, pieces: Iterable[tuple[float, bytes]], hang_up: bool = False) -> None:
        self._clock, self._left, self._hang_up, self._start = clock, deque(pieces), hang_up, 0.0
        self.port = clock.listen("127.0.0.1", 0, self._connect)

    def receive(self, wait_s: float) -> bytes:
        last = self._clock.now() + wait_s
        while True:
            data = b""
            while self._left and self._start + self._left[0][0] <= self._clock.now():
                data += self._left.popleft()[1]
            if data:
                return data
            if self._hang_up and not self._left:
                raise EOFError("the other side closed the connection")
            if self._clock.now() >= last:
                return b""
            self._clock.jump(min(last, self._start + self._left[0][0] if self._left else math.inf))

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass

    def _connect(self) -> "Paced":
        self._start = self._clock.now()
        return self
