"""Output of a long command while it works: its progress, and questions to a person.

The command line, the browser page or a script selects the screen (``showing_on``). A command calls ``progress`` and ``screen``.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TypeAlias

Progress: TypeAlias = Callable[[str, float], None]  # current task, and completed share of the whole, 0 to 1


class Screen:
    """Lines and questions of a long command. This default does not show anything, and asks with Python's ``input``."""

    def progress(self, task: str, share: float) -> None:
        """Show the current task and the completed share, 0 to 1."""

    def say(self, *lines: str) -> None:
        """Show lines that remain visible."""

    def over(self, line: str, *, step: int | None = None, last: bool = False) -> None:
        """Show a line that replaces the last one. In a log, a line appears once for each numbered step."""

    def ask(self, line: str) -> str:
        """Return the answer to a question. Raise EOFError if nobody can answer."""
        return input(line)


_SCREEN: ContextVar[Screen | None] = ContextVar("screen", default=None)
_SHARE: ContextVar[tuple[float, float]] = ContextVar("share", default=(0.0, 1.0))  # start and stop of the current part


def screen() -> Screen:
    """Return the screen of the running command."""
    return _SCREEN.get() or Screen()


@contextmanager
def showing_on(shown: Screen) -> Iterator[None]:
    """Show the progress, lines and questions of the block on a screen."""
    token = _SCREEN.set(shown)
    try:
        yield
    finally:
        _SCREEN.reset(token)


def progress(task: str, share: float) -> None:
    """Report the current task and the completed share, 0 to 1, of the command or of its current part."""
    start, stop = _SHARE.get()
    screen().progress(task, start + share * (stop - start))


@contextmanager
def part(start: float, stop: float) -> Iterator[None]:
    """Scale the progress within a block from one share of the whole to another."""
    low, high = _SHARE.get()
    token = _SHARE.set((low + start * (high - low), low + stop * (high - low)))
    try:
        yield
    finally:
        _SHARE.reset(token)


@contextmanager
def reading(stop: float, *files: Path) -> Iterator[None]:
    """Report progress while a block reads files, from 0 to a share of the whole."""
    from undrift.files import WATCH, bytes_in

    total, shares = sum(map(bytes_in, files)), dict[Path, float]()
    task = f"reading {files[0].name}" if len(files) == 1 else "reading"

    def watch(path: Path, share: float) -> None:
        shares[path] = max(share, shares.get(path, 0.0))
        done = sum(share * bytes_in(path) for path, share in shares.items())
        progress(f"reading {path.name}", stop * min(1.0, done / max(total, 1)))

    progress(task, 0.0)
    token = WATCH.set(watch)
    try:
        yield
    finally:
        WATCH.reset(token)
