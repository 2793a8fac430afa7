"""A terminal of a given width that stores its text."""

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout

import pytest


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@contextmanager
def on(place: io.StringIO, width: int) -> Iterator[None]:
    """Redirect stdout and stderr to a target with a width."""
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(place), redirect_stderr(place):
        for name, value in (("COLUMNS", width), ("LINES", 50), ("TERM", "dumb")):
            patch.setitem(os.environ, name, str(value))
        yield
