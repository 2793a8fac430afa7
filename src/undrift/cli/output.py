"""What every command does with a result: one JSON object on stdout, or something a person likes to read."""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    from undrift.calibration.model import Verdict

Json: TypeAlias = bool | int | float | str | Sequence["Json"] | Mapping[str, "Json"] | None


def console() -> "Console":
    """Return the console that results are shown on (stdout).

    Returns
    -------
    Console
        As wide as a table needs where stdout is not a terminal.
    """
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 400, highlight=False, soft_wrap=not sys.stdout.isatty())


def progress() -> "Progress":
    """Return a progress display on stderr, with the time left; silent where stderr is not a terminal.

    Returns
    -------
    Progress
        To be used as a context.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    stderr = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=stderr, transient=True, disable=not stderr.is_terminal)


def table(title: str, *columns: str) -> "Table":
    """Return an empty table whose columns after the first are right-aligned.

    Parameters
    ----------
    title : str
        Heading.
    *columns : str
        Column heads; a unit in brackets goes on a line of its own. Where space is short the first column folds.

    Returns
    -------
    Table
        Ready for rows.
    """
    from rich import box
    from rich.table import Table

    made = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False)
    for k, column in enumerate(columns):
        head = column.replace(" (", "\n(")
        made.add_column(head, justify="right" if k else "left", no_wrap=k > 0, overflow="fold")
    return made


def write_json(value: object) -> None:
    """Write one JSON object to stdout.

    Parameters
    ----------
    value : object
        Mappings, sequences, numbers, arrays; NaN is written as null.
    """
    sys.stdout.write(json.dumps(plain(value), ensure_ascii=False, allow_nan=False) + "\n")


def plain(value: object) -> Json:
    """Return a value made of what JSON knows.

    Parameters
    ----------
    value : object
        Mappings, sequences, numbers, arrays, strings, None.

    Returns
    -------
    Json
        The same, with arrays as lists and NaN or infinity as None.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, Sequence | set | frozenset):
        return [plain(item) for item in value]
    return str(value)


def waiting(what: str) -> "AbstractContextManager[object]":
    """Return a context that shows on a terminal's stderr that something is being worked on.

    Parameters
    ----------
    what : str
        What is being done.

    Returns
    -------
    context manager
        Silent where stderr is not a terminal.
    """
    from contextlib import nullcontext

    from rich.console import Console

    stderr = Console(stderr=True)
    return stderr.status(what) if stderr.is_terminal else nullcontext()


def show_verdict(verdict: "Verdict") -> None:
    """Show a verdict and its reasons, one a line.

    Parameters
    ----------
    verdict : Verdict
        What a fit is worth.
    """
    colour = {"good": "green", "marginal": "yellow", "bad": "red"}[verdict.status]
    out = console()
    out.print(f"[bold {colour}]verdict: {verdict.status}[/bold {colour}]")
    for reason in verdict.reasons:
        out.print(f"  - {reason}", markup=False)
