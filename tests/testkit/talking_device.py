"""A device for tests that sends at its rate after the first connection, and falls silent when it is told to."""

import contextlib
import socket
import time

from testkit.byte_sender import Listener

CHANNELS = "count,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,temp"


def resting(k: int) -> str:
    """Return the numbers of reading k of a device at rest. A sawtooth rotation distinguishes the readings."""
    return f"{(k % 50) * 0.01:.4f},0.02,-0.01,0.01,0.02,9.81,{25.0 + k * 1e-4:.4f}"


class TalkingDevice(Listener):
    """Device that sends numbered lines to all listeners, as a context manager."""

    def __init__(self, rate: float = 200.0) -> None:
        self.rate, self.silent = rate, False
        self._clients: list[socket.socket] = []
        super().__init__(self._accept, self._talk)

    @property
    def address(self) -> str:
        options = f"channels={CHANNELS}&rate={self.rate:g}&gyro_unit=dps&accel_unit=m/s2&device=talker"
        return f"tcp://127.0.0.1:{self.port}?{options}"

    def __exit__(self, *failure: object) -> None:
        super().__exit__(*failure)
        for client in self._clients:
            client.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while not self._end.is_set():
                self._clients.append(self._listener.accept()[0])

    def _talk(self) -> None:
        while not self._clients and not self._end.wait(0.01):
            pass
        start, k = time.monotonic(), 0
        while not self._end.wait(0.01):
            lines = []
            while k < (time.monotonic() - start) * self.rate:
                lines.append(f"{k},{resting(k)}\n")
                k += 1
            for client in [] if self.silent else list(self._clients):
                with contextlib.suppress(OSError):
                    client.sendall("".join(lines).encode())
