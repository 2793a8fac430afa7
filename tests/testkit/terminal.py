"""Text on terminals of several widths: the same words and numbers, none cropped and none broken."""

import importlib
import io
import os
import pkgutil
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import wraps
from typing import Any

import pytest
from rich.cells import cell_len

from testkit.remembered import put_everywhere
from undrift import cli
from undrift.cli import common

WIDTHS = (60, 80, 120)  # columns


class Terminal(io.StringIO):
    """A terminal that stores its text."""

    def isatty(self) -> bool:
        return True


def words_of(text: str) -> Counter[str]:
    """Count the words and numbers, without rules of tables and colons after headings."""
    return Counter(word for word in (part.strip("─:") for part in text.split()) if word)


def differences(text: str, whole: str, width: int, spare: str = "") -> list[str]:
    """Return the differences of a terminal's text from the whole text, and its lines that could have been shorter."""
    told, wanted = words_of(text) + words_of(spare), words_of(whole)
    lost = [f"lost: {word}" for word in wanted - told]
    made_up = [f"not in the whole text: {word}" for word in set(told) - set(wanted)]
    wide = (line for line in text.splitlines() if cell_len(line.rstrip()) > width and len(line.split()) > 1)
    return lost + made_up + [f"wider than {width}: {line}" for line in wide]


class Widths:
    """Show all output on several terminals in addition to its target."""

    def __init__(self) -> None:
        self.whole, self.narrow = io.StringIO(), {width: Terminal() for width in WIDTHS}
        self._within, self._spare = False, ""

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Watch what commands show."""
        for module in pkgutil.iter_modules(cli.__path__):  # an import inside the block would keep the replacement
            importlib.import_module(f"{cli.__name__}.{module.name}")
        with pytest.MonkeyPatch.context() as patch:
            if common.SAID_EVERY_S >= 1.0:  # its thread would write to whichever place is shown on just then
                patch.setattr(common, "SAID_EVERY_S", 3600.0)
            for function in (common.say, common.show_table, common.show_verdict):
                put_everywhere(patch, function, self._on_all(function), within=cli.__name__)
            yield

    def differences(self) -> list[str]:
        """Return the differences of the terminals from the whole text."""
        texts = ((text.getvalue(), self.whole.getvalue(), width) for width, text in self.narrow.items())
        return [line for item in texts for line in differences(*item, spare=self._spare)]

    def _on_all(self, function: Callable[..., None]) -> Callable[..., None]:
        @wraps(function)
        def shown(*args: Any, **words: Any) -> None:
            values = [arg if isinstance(arg, str) or not hasattr(arg, "__next__") else list(arg) for arg in args]
            if not self._within:
                self._within = True
                if function.__name__ == "show_table":  # a stacked table leaves out heads that have no cell
                    heads = (head for head, *cells in zip(values[1], *values[2], strict=True) if not any(cells))
                    self._spare += " ".join(("", *heads))
                for place, width in ((self.whole, 400), *((text, width) for width, text in self.narrow.items())):
                    with on(place, width):
                        function(*values, **words)
                self._within = False
            function(*values, **words)

        return shown


@contextmanager
def on(place: io.StringIO, width: int) -> Iterator[None]:
    """Redirect stdout and stderr to a target with a width."""
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(place), redirect_stderr(place):
        for name, value in (("COLUMNS", width), ("LINES", 50), ("TERM", "dumb")):
            patch.setitem(os.environ, name, str(value))
        yield
