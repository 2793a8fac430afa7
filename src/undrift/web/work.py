"""A command that runs in a thread of the server, with its progress for the page."""

import time
from collections.abc import Callable
from typing import Any, TypeVar

from undrift.errors import InputError
from undrift.screen import Screen, showing_on

Value = TypeVar("Value")


class Work(Screen):
    """Progress of a command. A cancelled command ends when it reports progress the next time, and writes no output."""

    def __init__(self, name: str) -> None:
        self.name, self.task, self.share, self.cancelled = name, "starting", 0.0, False
        self._start_s = time.monotonic()

    def progress(self, task: str, share: float) -> None:
        self.task, self.share = task, share
        if self.cancelled:
            raise InputError(f"{self.name}: cancelled. Nothing was written.")

    def ask(self, line: str) -> str:
        raise EOFError

    @property
    def text(self) -> str:
        """Return the task and the duration so far."""
        return f"{self.name}: {self.task}, {time.monotonic() - self._start_s:.0f} s"

    def run(self, function: Callable[..., Value], *values: Any, **options: Any) -> Value:
        """Call a function that reports its progress here."""
        with showing_on(self):
            return function(*values, **options)
