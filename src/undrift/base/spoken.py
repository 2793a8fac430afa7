"""Names of arguments in texts: written as in Python, `gravity_m_s2`, and shown as options on the command line.

Findings are converted as templates, before their values are inserted, so a file named `old`.csv does not change. Errors and
notes already contain their values. In them, a word in back-ticks becomes an option only if the running command has a parameter
of exactly that name. Data in JSON and table cells do not change.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

CALLED: ContextVar[tuple[str, ...]] = ContextVar("CALLED", default=())  # the words of the command line, if it called
NAMED: ContextVar[frozenset[str]] = ContextVar("NAMED", default=frozenset())  # parameters of the command that runs
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
    """Return the option of an argument: --gravity-m-s2 of gravity_m_s2."""
    return "--" + OPTIONS.get(name, name).replace("_", "-")


def spoken(text: str) -> str:
    """Replace parameters of the running command in a text by their options. Other words in back-ticks do not change."""
    option_names = NAMED.get()
    return _ARGUMENT.sub(lambda m: option_of(m[1]) if {m[1], OPTIONS.get(m[1])} & option_names else m[0], text)


def spoken_template(template: str) -> str:
    """Replace all arguments in a template by their options, if the command line shows it."""
    return _ARGUMENT.sub(lambda m: option_of(m[1]), template) if SHOWING.get() else template


@contextmanager
def showing() -> Iterator[None]:
    """Make findings name options within a ``with`` block, if the command line is running."""
    before = SHOWING.set(bool(CALLED.get()))
    try:
        yield
    finally:
        SHOWING.reset(before)
