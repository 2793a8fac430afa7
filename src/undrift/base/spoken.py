"""Names of arguments in texts: written as in Python, `gravity_m_s2`, and shown in the words of the active interface.

The command line shows options, --gravity-m-s2, and the page of the bench shows its own words (``calling``). Texts of findings are
converted where they are shown. Errors and notes contain values, which may contain any text. Therefore a word in back-ticks in them
is converted only if the running command, or the page, has a parameter of exactly that name. Data in JSON and table cells do not
change.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar

CALLED: ContextVar[tuple[str, ...]] = ContextVar("CALLED", default=())  # True if the command line made the call
NAMED: ContextVar[frozenset[str]] = ContextVar("NAMED", default=frozenset())  # parameters of the running command
PAGE: ContextVar[Mapping[str, str]] = ContextVar("PAGE", default={})  # noqa: B039  # words of the page, if it is active
SHOWING: ContextVar[bool] = ContextVar(
    "SHOWING", default=False
)  # True while text is shown to a person, not written as data
OPTIONS = {
    "longest_lag_s": "max_lag_s",
    "column_map": "map",
    "labels": "markers",
}  # options whose name differs from the argument
_ARGUMENT = re.compile(r"`([a-z]\w*)`")


def option_of(name: str) -> str:
    """Return the option for an argument: --gravity-m-s2 for gravity_m_s2."""
    return "--" + OPTIONS.get(name, name).replace("_", "-")


def _name_of(name: str) -> str:
    """Return the name of an argument on the page or the command line. For missing fields, the page uses the option."""
    page = PAGE.get()
    return page.get(name, f"command line: {option_of(name)}") if page else option_of(name)


def spoken(text: str) -> str:
    """Replace parameters of the running command, or of the page, in a text. Other words in back-ticks do not change."""
    names = NAMED.get() | PAGE.get().keys()
    return _ARGUMENT.sub(lambda m: _name_of(m[1]) if {m[1], OPTIONS.get(m[1])} & names else m[0], text)


def spoken_finding(text: str) -> str:
    """Replace all arguments in the text of a finding, if the command line or the page shows it."""
    return _ARGUMENT.sub(lambda m: _name_of(m[1]), text) if SHOWING.get() else text


@contextmanager
def showing() -> Iterator[None]:
    """Use names of options in findings within a ``with`` block, if the command line or the page is running."""
    before = SHOWING.set(bool(CALLED.get() or PAGE.get()))
    try:
        yield
    finally:
        SHOWING.reset(before)


@contextmanager
def calling(words: Mapping[str, str]) -> Iterator[None]:
    """Use the words of a page for arguments within a ``with`` block."""
    before = PAGE.set(words)
    try:
        yield
    finally:
        PAGE.reset(before)
