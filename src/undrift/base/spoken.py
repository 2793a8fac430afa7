"""Arguments in texts: written as Python has them, `gravity_m_s2`, and shown as options where the command line called.

Sentences of findings are spoken as templates, before their values go in: a file named `old`.csv stays as it is. Of other texts,
errors and notes, nobody can tell any more which words are values: there a word in back-ticks is an option only where the running
command has a parameter of exactly that name. Data in JSON and cells of tables stay as they are.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

CALLED: ContextVar[tuple[str, ...]] = ContextVar("CALLED", default=())  # the words of the command line, if it called
NAMED: ContextVar[frozenset[str]] = ContextVar("NAMED", default=frozenset())  # parameters of the command that runs
SHOWING: ContextVar[bool] = ContextVar("SHOWING", default=False)  # to a reader, not as data
OPTIONS = {"longest_lag_s": "max_lag_s", "column_map": "map"}  # where it is not the argument's name
_ARGUMENT = re.compile(r"`([a-z]\w*)`")


def option_of(name: str) -> str:
    """Return the option of an argument: --gravity-m-s2 of gravity_m_s2."""
    return "--" + OPTIONS.get(name, name).replace("_", "-")


def spoken(text: str) -> str:
    """Return a text in which the parameters of the running command stand as options; other words in back-ticks stay."""
    known = NAMED.get()
    return _ARGUMENT.sub(lambda m: option_of(m[1]) if {m[1], OPTIONS.get(m[1])} & known else m[0], text)


def spoken_template(template: str) -> str:
    """Return a sentence without its values in which all arguments stand as options, if the command line shows it."""
    return _ARGUMENT.sub(lambda m: option_of(m[1]), template) if SHOWING.get() else template


@contextmanager
def showing() -> Iterator[None]:
    """Let findings of a ``with`` block name options, if the command line called."""
    before = SHOWING.set(bool(CALLED.get()))
    try:
        yield
    finally:
        SHOWING.reset(before)
