"""One file, one verb: options in, result and summary out. Command line, Python and the bench call the same function.

A verb reads its inputs (``inputs``), checks the files that it will write before the work begins (``outputs``), computes by calling
the stages, writes the files that were asked for, and returns its result. It prints nothing and draws nothing: the result's
``summary()`` (``base/summary``) says what came out, and each renderer shows that::

    orient(record, output=..., opening=Opening()) -> Oriented          a dataclass of values, with summary() and a short repr

Parameters are the options of the command line (``base/options``): ``power_on_s`` is ``--power-on-s``, its help is the docstring.
Settings that several verbs share are dataclasses marked ``@options``. A verb that takes long has a parameter ``progress``, which
it calls with what is being done and the share of the whole that is done. Angles and rates of options are in the units that their
names state; results hold SI.

Open ``orient.py`` first: it is the shortest complete one. Nothing here imports numpy before a verb is called.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

# Each a function in the module of its name
VERBS = (
    "calibrate", "certificate", "correct", "demo", "drift", "export", "info", "mount", "noise", "orient",
    "record", "sample", "simulate", "study", "twin", "validate",
)  # fmt: skip
GROUPS = {  # of commands in one module: the function of each
    "rig": {name: name for name in ("run", "stop", "check")},
}


class Commands(ModuleType):
    """A package that makes each module that has the name of a command one that is called, as the import system binds it."""

    def __setattr__(self, name: str, value: Any) -> None:
        home = self.__name__.rpartition(".")[2]
        words = (*VERBS, *GROUPS) if home in ("undrift", "commands") else GROUPS.get(home, ())
        if name in words and type(value) is ModuleType:
            value.__class__ = Command
        super().__setattr__(name, value)


class Command(Commands):
    """A module of a command's name: ``undrift.twin(...)`` calls it, ``undrift.rig.run(...)`` one of a group."""

    def __call__(self, *given: Any, **stated: Any) -> Any:
        *_, group, name = self.__name__.split(".")
        home = group if group in GROUPS else name
        return getattr(import_module(f"undrift.commands.{home}"), name)(*given, **stated)

    def __getattr__(self, name: str) -> Any:
        group = self.__name__.rpartition(".")[2]
        if name not in GROUPS.get(group, {}).values():
            raise AttributeError(f"module '{self.__name__}' has no attribute '{name}'")
        return getattr(import_module(f"undrift.commands.{group}"), name)


sys.modules[__name__].__class__ = Commands
Progress: TypeAlias = Callable[[str, float], None]  # what is being done, and the share of the whole that is done


class Screen:
    """Where a command that goes on shows what it does, and who answers its questions: nowhere, and Python's ``input``."""

    def say(self, *lines: str) -> None:
        """Show lines that stay."""

    def over(self, line: str, *, step: int | None = None, last: bool = False) -> None:
        """Show lines over those before; a log has those of each step above a blank one, and none that has no number."""

    def ask(self, line: str) -> str:
        """Return the answer to a question; EOFError where there is nobody."""
        return input(line)


def silent(_what: str, _share: float) -> None:
    """Take how far a verb is, and say nothing."""


def part_of(progress: Progress, start: float, stop: float) -> Progress:
    """Return how a part of a verb, from one share of the whole to another, says how far it is."""
    return lambda what, share: progress(what, start + share * (stop - start))


@contextmanager
def reading(progress: Progress, stop: float, *files: Path) -> Iterator[None]:
    """Say how far files are read while a block reads them, from nothing to a share of the whole."""
    from undrift.files import WATCH, bytes_in

    whole, shares = sum(map(bytes_in, files)), dict[Path, float]()

    def watch(path: Path, share: float) -> None:
        shares[path] = max(share, shares.get(path, 0.0))
        done = sum(share * bytes_in(path) for path, share in shares.items())
        progress(f"reading {path.name}", stop * min(1.0, done / max(whole, 1)))

    progress(f"reading {files[0].name}" if len(files) == 1 else "reading", 0.0)
    token = WATCH.set(watch)
    try:
        yield
    finally:
        WATCH.reset(token)
