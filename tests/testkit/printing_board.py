"""A board that prints readings to a serial port as the sketches of docs/firmware-logger do: firmware behind a pseudo-terminal."""

import contextlib
import os
import select
import threading
import time
from collections.abc import Callable

import numpy as np

from testkit.pseudo_terminal import open_pseudo_terminal


def sketch_line(k: int, time_us: int, gyro: np.ndarray, accel: np.ndarray, temp_c: float) -> bytes:
    """Return a line of the shape that needs no map."""
    g, a = (",".join(str(round(value)) for value in triad) for triad in (gyro, accel))
    seconds, micros = divmod(time_us, 1_000_000)
    return (
        f"count:{k},time(s):{seconds}.{micros:06d},gyro(count):{g},accel(count):{a},temp(C):{temp_c:.2f}\r\n".encode()
    )


def resting_line(k: int, rate: float = 100.0) -> bytes:
    """Return reading k of a board that lies still."""
    rng = np.random.default_rng(k)
    gyro, accel = np.array([120.0, -60.0, 30.0]) + rng.normal(0.0, 4.0, 3), np.array([150.0, -90.0, 16300.0])
    return sketch_line(k, round(k * 1e6 / rate), gyro, accel + rng.normal(0.0, 30.0, 3), 25.0 + 1e-4 * k)


class PrintingBoard:
    """A board, as a context manager. ``write`` prints a text. ``print_lines`` prints at a rate until the board is
    closed.

    With patience it waits for a busy computer. Real boards lose data that the line cannot buffer.
    """

    def __init__(self, patience_s: float = 0.0) -> None:
        self._near, self._far = open_pseudo_terminal()
        os.set_blocking(self._near, False)
        self.port = os.ttyname(self._far)
        self._end, self._lock, self._patience_s = threading.Event(), threading.Lock(), patience_s
        self._thread: threading.Thread | None = None

    def __enter__(self) -> "PrintingBoard":
        return self

    def __exit__(self, *failure: object) -> None:
        self._end.set()
        if self._thread is not None:
            self._thread.join(10)
        self.unplug()

    def write(self, data: bytes) -> None:
        """Print data. It is lost if nobody reads within the board's patience."""
        with self._lock, contextlib.suppress(BlockingIOError):
            while self._near >= 0 and data and select.select([], [self._near], [], self._patience_s)[1]:
                data = data[os.write(self._near, data) :]

    def print_lines(self, line: Callable[[int], bytes] = resting_line, rate: float = 100.0) -> "PrintingBoard":
        """Print reading after reading from now on."""

        def run() -> None:
            start, k = time.monotonic(), 0
            while not self._end.wait(0.01):
                while k < (time.monotonic() - start) * rate:
                    self.write(line(k))
                    k += 1

        self._thread = threading.Thread(target=run)
        self._thread.start()
        return self

    def unplug(self) -> None:
        with self._lock:
            if self._near >= 0:
                os.close(self._near)
                os.close(self._far)
                self._near = -1
