"""Result of a command: one answer with findings, tables and figures.

A command returns a ``Report``. The terminal (``terminal.show``), the page (``page.write_page``) and JSON (``as_json``)
show the same tables. Cells are numbers, and only a renderer formats them.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from undrift import __version__
from undrift.findings import Finding, Status, Verdict, most_consequential_first
from undrift.io.store import findings_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Plain: TypeAlias = bool | int | float | str | Sequence["Plain"] | Mapping[str, "Plain"] | None
Drawing: TypeAlias = Callable[[], "Figure"]  # function that only the page calls
NO_VALUE = "–"


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value and its uncertainty in one cell. The uncertainty gives the number of digits."""

    value: float
    uncertainty: float

    def __str__(self) -> str:
        if not math.isfinite(self.value):
            return NO_VALUE
        if not (math.isfinite(self.uncertainty) and self.uncertainty > 0.0):
            return f"{self.value:.4g}"
        places = max(0, 1 - math.floor(math.log10(self.uncertainty)))
        if places <= 9:
            return f"{self.value:z.{places}f} ± {self.uncertainty:.{places}f}"
        power = math.floor(math.log10(max(abs(self.value), self.uncertainty)))
        value, uncertainty = self.value * 10.0**-power, self.uncertainty * 10.0**-power
        return f"({value:.{places + power}f} ± {uncertainty:.{places + power}f})e{power}"


Cell: TypeAlias = float | int | str | bool | Estimate | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table with its note and figure. Without rows, it is a figure or a note with a title, or is not shown.

    Parameters
    ----------
    title : str
        Heading. The key of the table in JSON is the title in lower case with underscores.
    columns : sequence of str
        Column heads with units, all different.
    rows : sequence of sequences
        Cells: numbers in the unit of the head, words, or None.
    form : str or mapping
        Format of floats, for all columns or by head: ".2f".
    note : str
        Sentences under the table.
    figure : callable
        Function without arguments that draws a matplotlib Figure.
    """

    title: str
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[Cell]] = ()
    form: str | Mapping[str, str] = ".3g"
    note: str = ""
    figure: Drawing | None = None

    @classmethod
    def of(cls, title: str, rows: Sequence[Mapping[str, Cell]], *, note: str = "", **more: Any) -> "Table":
        """Return a table from rows, each a mapping from column head to cell. A table without rows is not shown."""
        if not rows:
            return cls(title=title)
        return cls(title=title, columns=[*rows[0]], rows=[tuple(row.values()) for row in rows], note=note, **more)

    def __bool__(self) -> bool:
        """Return True if there is anything to show."""
        return bool(self.rows or self.note or self.figure)

    @property
    def key(self) -> str:
        """Return the name of the table in JSON."""
        return re.sub(r"[^a-z0-9]+", "_", self.title.lower()).strip("_")

    @property
    def cells(self) -> list[list[str]]:
        """Return the cells as text, for terminal and page."""
        forms = [self.form if isinstance(self.form, str) else self.form.get(head, ".3g") for head in self.columns]
        return [[cell_text(cell, form) for cell, form in zip(row, forms, strict=True)] for row in self.rows]

    def records(self) -> list[dict[str, Plain]]:
        """Return the rows for JSON, each a mapping from head to cell."""
        return [dict(zip(self.columns, map(plain, row), strict=True)) for row in self.rows]


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """The result of a command.

    Parameters
    ----------
    title : str
        Title of the page.
    answer : str
        One or two sentences with numbers and units.
    tables, details : sequence of Table
        Tables for every reader, and tables that a terminal shows with --details only and a page folds.
    notes : sequence of str
        Sentences for the record.
    findings : sequence of Finding
        Doubts about the result. Verdict and exit code follow from their levels.
    judged : bool
        True if the verdict is shown even if it is good.
    figures : sequence of callables
        Functions that draw matplotlib Figures. The first one follows the answer.
    written : sequence of Path
        Files and folders.
    data : mapping
        Values for programs, in addition to the tables, such as a calibration.
    next_command : sequence
        Words of the command that usually follows, without "undrift".
    """

    title: str
    answer: str
    tables: Sequence[Table] = ()
    details: Sequence[Table] = ()
    notes: Sequence[str] = ()
    findings: Sequence[Finding] = ()
    judged: bool = False
    figures: Sequence[Drawing] = ()
    written: Sequence[Path] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    next_command: Sequence[object] = ()

    @property
    def status(self) -> Status:
        """Return good, marginal or bad, from the levels of the findings."""
        return Verdict.of(*self.findings).status

    @property
    def verdict_shown(self) -> bool:
        """Return True if the verdict is shown."""
        return self.judged or self.status != "good"

    @property
    def exit_code(self) -> int:
        """Return 1 if the verdict is bad, otherwise 0."""
        return int(self.status == "bad")

    @property
    def ordered_findings(self) -> tuple[Finding, ...]:
        """Return each finding once, starting with the most consequential."""
        return most_consequential_first(self.findings)

    def __str__(self) -> str:
        if not self.answer:
            rows = [f"  {': '.join(cells)}" for table in self.tables for cells in table.cells]
            return "\n".join([self.title, *rows])
        return f"{self.title}: {self.answer}" + (f"\nverdict {self.status}" if self.verdict_shown else "")

    def _repr_html_(self) -> str:
        from undrift.report.page import notebook_text

        return notebook_text(self)


def as_json(report: Report, command: str) -> dict[str, Plain]:
    """Return the report as one JSON object. Numbers are those of the tables, in the units of their heads."""
    tables = {table.key: table.records() for table in (*report.tables, *report.details) if table.rows}
    return {
        "kind": "undrift." + command.replace(" ", "_"),
        "version": __version__,
        "verdict": report.status if report.verdict_shown else None,
        "answer": report.answer,
        "findings": plain(report.ordered_findings),
        "notes": list(report.notes),
        "tables": tables,
        "written": [str(path) for path in report.written],
        "data": plain(report.data),
    }


def cell_text(cell: Cell, form: str) -> str:
    """Return a cell as text: a dash for no value, no sign before a zero."""
    if cell is None:
        return NO_VALUE
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, str | Estimate):
        return str(cell)
    if not math.isfinite(cell):
        return NO_VALUE
    return f"{cell:{form.replace('.', 'z.', 1)}}" if isinstance(cell, float) else str(cell)


def plain(value: object) -> Plain:
    """Return a value made of JSON types: dataclasses as mappings, arrays as lists, NaN and infinity as None."""
    if isinstance(value, Finding):
        (value,) = findings_json([value])
    if is_dataclass(value):
        return {item.name: plain(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # arrays and numbers of numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None  # avoids -0.0
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, Sequence | set | frozenset):
        return [plain(item) for item in value]
    return str(value)
