"""A device in tests: listens on loopback, sends what it is given to who connects, as fast as the socket takes it."""

import contextlib
import socket
import threading
from collections.abc import Iterable


class Sender:
    """Sends pieces of bytes to its only client; stays open until closed or told to hang up."""

    def __init__(self, pieces: Iterable[bytes], hang_up: bool = False) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._pieces, self._hang_up = pieces, hang_up
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def __enter__(self) -> "Sender":
        return self

    def __exit__(self, *failure: object) -> None:
        self._end.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._thread.join(10)
        self._listener.close()

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
