"""Ctrl-C, Ctrl-Z and SIGTERM while a rig is driven: an exception first, and no disturbance while the table is stopped."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

NAMES = (
    "SIGINT",
    "SIGTERM",
    "SIGHUP",
    "SIGTSTP",
)  # as far as the system has them; a halted program leaves a table turning


@contextmanager
def stopping_on_signals() -> Iterator[None]:
    """Turn SIGTERM, SIGHUP and SIGTSTP (Ctrl-Z) into the exception of Ctrl-C within the block, so that `finally` is reached.

    Only the first signal raises: those after it do not disturb what is closed in the block.

    Yields
    ------
    None
        Once. Outside the main thread, which gets no signals, nothing changes.
    """
    stopped: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        stopped.append(number)
        if len(stopped) == 1:
            raise KeyboardInterrupt(f"stopped by {signal.Signals(number).name}")

    with _handled(interrupt):
        yield


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let no signal disturb the block; one that came is handed at its end to whoever handled it before.

    Yields
    ------
    None
        Once.

    Raises
    ------
    KeyboardInterrupt
        A signal came within, and is not ignored outside.
    """
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)

    with _handled(note):
        yield
    if came:
        outside = signal.getsignal(came[0])
        if callable(outside):
            outside(came[0], None)
        elif outside != signal.SIG_IGN:
            raise KeyboardInterrupt(f"stopped by {signal.Signals(came[0]).name}")


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, held in before.items():
            signal.signal(number, held)
