"""A report on a terminal: answer, verdict with at most three findings, tables, notes and written files.

Lines are broken at spaces to fit the width of the terminal. Brackets in names are not markup.
"""

import shlex
import sys
import textwrap
from collections.abc import Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

from undrift.base.spoken import showing, spoken
from undrift.findings import SHOWN_FIRST
from undrift.report.report import Report, Table

if TYPE_CHECKING:
    from rich.console import Console

COLOURS = {"good": "green", "marginal": "yellow", "bad": "red"}
GAPS = ((3, " ("), (1, " ("), (1, " "))  # gaps between columns, and places at which heads break, from wide to narrow


def show(report: Report, *, details: bool = False) -> None:
    """Print a report. With details, print all findings and the tables that are details."""
    with showing():
        say(report.answer)
        if report.verdict_shown:
            say(f"verdict: {report.status}", style=f"bold {COLOURS[report.status]}")
        _show_findings(report, details=details)
        for table in (*report.tables, *(report.details if details else ())):
            _show_table(table)
        if (titles := [table.title for table in report.details if table]) and not details:
            say(f"  More tables ({', '.join(titles)}): --details")
        say(*(f"  {note}" for note in report.notes), *(f"Wrote {path}" for path in report.written))
        if report.next_command:
            say("Next: undrift " + shlex.join(map(str, report.next_command)))


def say(*lines: str, err: bool = False, style: str = "") -> None:
    """Print lines unchanged, with breaks only at spaces."""
    out = console(err=err)
    for line in (line for text in lines for line in spoken(text).split("\n")):
        for segment in [line] if out.soft_wrap else wrap(line, out.width):
            out.print(segment, markup=False, soft_wrap=True, style=style)


def console(*, err: bool = False) -> "Console":
    """Return the console for results (stdout) or messages (stderr). Without a terminal, it is as wide as a table needs."""
    from rich import console as rich

    class Console(rich.Console):
        def on_broken_pipe(self) -> None:  # the reader of stdout has stopped: no failure
            raise BrokenPipeError

    terminal = (sys.stderr if err else sys.stdout).isatty()
    return Console(stderr=err, width=None if terminal else 400, highlight=False, emoji=False, soft_wrap=not terminal)


def wrap(line: str, width: int, **options: Any) -> list[str]:
    """Return a line split to the width, without broken words. A word wider than the terminal gets its own line."""
    from rich.cells import cell_len

    indent = line[: len(line) - len(line.lstrip())]
    options |= {"subsequent_indent": indent, "break_long_words": False, "break_on_hyphens": False}
    return textwrap.wrap(line, max(1, width - max(0, cell_len(line) - len(line))), **options) or [""]


def _show_findings(report: Report, *, details: bool) -> None:
    findings = report.ordered_findings
    visible = findings if details else findings[:SHOWN_FIRST]
    say(*(f"  - {item.text}" for item in visible))
    if len(findings) > len(visible):
        say(f"  {len(findings) - len(visible)} more: --details")


def _show_table(table: Table) -> None:
    """Print a table and its note. If it is too wide even with narrow columns, print a line for each cell."""
    if table.rows:
        print_cells(table.title, table.columns, table.cells)
    elif table.note:
        say(table.title, style="table.title")
    if table.note:
        say(f"  {table.note}")


def print_cells(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print text cells: columns after the first are right-aligned, and a unit in brackets has its own line."""
    from rich.cells import cell_len, set_cell_size

    out = console()
    say(title, style="table.title")
    for gap, break_before in GAPS:
        names = [head.replace(break_before, f"\n{break_before[1:]}").split("\n") for head in heads]
        head_lines = [*zip_longest(*map(reversed, names), fillvalue="")][::-1]
        widths = [max(map(cell_len, column)) for column in zip(*head_lines, *rows, strict=True)]
        rule = "─" * (sum(widths) + gap * (len(widths) - 1))
        if len(rule) + 2 <= out.width:
            break
    else:
        say(*(_stacked_cells(heads, row) for row in rows))
        return

    def line(cells: Sequence[str]) -> str:
        padded = (" " * (width - cell_len(cell)) + cell for cell, width in zip(cells[1:], widths[1:], strict=True))
        return " " + (" " * gap).join((set_cell_size(cells[0], widths[0]), *padded)) + " "

    out.print("", *map(line, head_lines), sep="\n", markup=False, soft_wrap=True, style="table.header")
    out.print(f" {rule} ", *map(line, rows), "", sep="\n", markup=False, soft_wrap=True)


def _stacked_cells(heads: Sequence[str], row: Sequence[str]) -> str:
    cells = [(head, cell.strip()) for head, cell in zip(heads, row, strict=True) if cell.strip()]
    return "".join(f"\n  {head}: {cell}" if head else f" {cell}" for head, cell in cells).strip()
