"""One file per verb: a function from options to a result with a summary. Command line, Python and the bench call the
same function.

A verb reads its inputs (``inputs``) and checks its output files before the work begins (``outputs``). It calls the
stages, writes the requested files, and returns its result. It prints and draws nothing. Each renderer shows the
``summary()`` of the result (``base/summary``)::

    orient(record, output=..., opening=Opening()) -> Oriented          a dataclass of values, with summary() and a short repr

Parameters are the options of the command line (``base/options``): ``power_on_s`` is ``--power-on-s``, and its help is
the docstring. Settings that several verbs share are dataclasses marked ``@options``. A long verb has a parameter
``progress``, which it calls with the current task and the completed share. Angles and rates of options are in the units
of their names. Results are in SI.

Open ``orient.py`` first, the shortest complete verb. Nothing here imports numpy before a verb is called.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

# Each a function in the module of its name
VERBS = (
    "calibrate", "certificate", "correct", "demo", "drift", "export", "info", "mount", "noise", "orient",
    "record", "sample", "simulate", "study", "twin", "validate",
)  # fmt: skip
GROUPS = {  # of commands in one module: the function of each
    "rig": {name: name for name in ("run", "stop", "check")},
}


Progress: TypeAlias = Callable[[str, float], None]  # current task, and share of the whole that is done


class Screen:
    """Progress display and questions of a long command. This default shows nothing and asks with Python's ``input``."""

    def say(self, *lines: str) -> None:
        """Show lines that stay."""

    def over(self, line: str, *, step: int | None = None, last: bool = False) -> None:
        """Show lines over the previous lines. In a log, only the lines above a blank line appear, once per numbered
        step.
        """

    def ask(self, line: str) -> str:
        """Return the answer to a question. Raise EOFError if nobody can answer."""
        return input(line)


def silent(_what: str, _share: float) -> None:
    """Ignore the progress of a verb."""


def part_of(progress: Progress, start: float, stop: float) -> Progress:
    """Return the progress function of a part of a verb, from one share of the whole to another."""
    return lambda what, share: progress(what, start + share * (stop - start))


@contextmanager
def reading(progress: Progress, stop: float, *files: Path) -> Iterator[None]:
    """Report progress while a block reads files, from 0 to a share of the whole."""
    from undrift.files import WATCH, bytes_in

    total, shares = sum(map(bytes_in, files)), dict[Path, float]()

    def watch(path: Path, share: float) -> None:
        shares[path] = max(share, shares.get(path, 0.0))
        done = sum(share * bytes_in(path) for path, share in shares.items())
        progress(f"reading {path.name}", stop * min(1.0, done / max(total, 1)))

    progress(f"reading {files[0].name}" if len(files) == 1 else "reading", 0.0)
    token = WATCH.set(watch)
    try:
        yield
    finally:
        WATCH.reset(token)
