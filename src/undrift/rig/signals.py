"""What becomes of Ctrl-C and SIGTERM while a rig is driven: an exception first, and no disturbance while the table is stopped."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # as far as the system has them


@contextmanager
def stopping_on_signals() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP into the exception of Ctrl-C within the block, so that `finally` is reached.

    Yields
    ------
    None
        Once. Outside the main thread, which gets no signals, nothing changes.
    """

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt(f"stopped by {signal.Signals(number).name}")

    with _handled(interrupt):
        yield


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let no signal disturb the block; one that came is raised as KeyboardInterrupt at its end.

    Yields
    ------
    None
        Once.

    Raises
    ------
    KeyboardInterrupt
        A signal came within.
    """
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)

    with _handled(note):
        yield
    if came:
        raise KeyboardInterrupt(f"stopped by {signal.Signals(came[0]).name}")


@contextmanager
def _handled(handler: object) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
    before = {number: signal.signal(number, handler) for number in numbers}  # type: ignore[arg-type]
    try:
        yield
    finally:
        for number, held in before.items():
            signal.signal(number, held)
