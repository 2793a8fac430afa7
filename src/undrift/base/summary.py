"""The result of a command as a ``Summary``, from which the terminal output, a page, JSON and the notebook view are
made.

A command returns its result. The result's ``summary()`` contains an answer in a sentence, sections with text, tables
and figures, verdict and findings, and ``data`` for ``--json``. A renderer chooses the appearance, never the content.
Tables have text cells. Figures are referenced by module and function (``at``) and drawn when a renderer needs them, so
that nothing here imports matplotlib.

::

    commands/<verb>.py  ->  Summary  ->  cli/common.show | report/page.write_page | data as JSON | as_html, in a notebook
"""

import importlib
import math
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypeVar

from undrift.findings import SHOWN_FIRST, Finding, Verdict, most_consequential_first

NOTHING_WRITTEN = "No tables were written: add -o calibration.json to keep them"
_SIGNED_ZERO = re.compile(r"(?<![\w.+/-])-(0(?:\.0+)?)(?![\w.])")  # as a small negative value is rounded
Item = TypeVar("Item")
Plain: TypeAlias = bool | int | float | str | Sequence["Plain"] | Mapping[str, "Plain"] | None
Cells = Sequence[tuple[str, Callable[[Item], str]]]  # column heads of a table, each with the function for its cells


def sentence(text: str) -> str:
    """Return a text with a capital first letter, unless its first word is a name: a command, a serial number, a file, an option."""
    first, _, rest = text.partition(" ")
    word = first.rstrip(",.:;")
    literal = word == "undrift" or rest.startswith("--") or not (word.isalpha() and word.islower())
    return text if literal else text[:1].upper() + text[1:]


def without_signed_zeros(text: str) -> str:
    """Return a text in which no zero has a sign: 0.000 for -0.000."""
    return _SIGNED_ZERO.sub(r"\1", text)


def at(place: str) -> Any:
    """Return the object of a place, "package.module:name"."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """A figure of a page, drawn when a renderer asks for it."""

    place: str  # "undrift.report.figures:draw_orientation"
    of: tuple[Any, ...]  # values to draw
    options: Mapping[str, Any] = field(default_factory=dict)

    def draw(self) -> Any:
        """Return the figure of matplotlib."""
        return at(self.place)(*self.of, **self.options)


def figure_of(name: str, *of: Any) -> Drawing:
    """Return a figure from its drawing function in the report, such as "figures:draw_record", and the values to draw."""
    return Drawing(place=f"undrift.report.{name}", of=of)


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A heading with text, findings, figures and a table under it."""

    title: str
    text: tuple[str, ...] = ()  # Paragraphs
    findings: tuple[Finding, ...] = ()  # The most consequential are shown, the others folded
    columns: tuple[str, ...] = ()  # Heads of the table, with units
    rows: tuple[tuple[str, ...], ...] = ()  # Cells
    pictures: tuple[Drawing | str, ...] = ()  # To be drawn, or SVG elements
    words: bool = False  # Cells hold words rather than figures: aligned at the left
    folded: bool | Literal["page"] = False  # Among the details: at the end of a page, and on a terminal on request
    on: Literal["both", "page", "terminal"] = "both"

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", tuple(map(without_signed_zeros, self.text)))
        object.__setattr__(self, "rows", tuple(tuple(map(without_signed_zeros, row)) for row in self.rows))


class Result(ABC):
    """Result of a command. It prints as one line, and as tables in a notebook."""

    __slots__ = ()

    @abstractmethod
    def summary(self) -> "Summary":
        """Return the summary, which every renderer shows."""

    def __repr__(self) -> str:
        summary = self.summary()
        verdict = f"; verdict: {summary.verdict.status}" if summary.verdict else ""
        return f"<{type(self).__name__}: {summary.title}: {summary.answer.rstrip('.')}{verdict}>"

    def _repr_html_(self) -> str:
        return as_html(self.summary())


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Summary(Result):
    """One result: an answer with its supporting tables and figures. A command without other values returns it directly."""

    title: str
    answer: str  # one sentence with numbers
    data: Mapping[str, Any] = field(default_factory=dict)  # output of --json, units in the keys
    pictures: tuple[Drawing | str, ...] = ()
    sections: tuple[Section, ...] = ()
    page: Callable[[], Iterable[Section]] = tuple  # further sections for a page only, created when it is written
    verdict: Verdict | None = None  # a bad verdict sets exit code 1
    judged: str = ""  # subject of the verdict if it is not the result, such as "the calibration"
    findings: tuple[Finding, ...] = ()  # in addition to the findings of the verdict
    notes: tuple[str, ...] = ()
    written: tuple[Path | None, ...] = ()  # Files and folders
    sources: tuple[Path, ...] = ()  # files created during the command that the page lists with the inputs
    brief: bool = (
        False  # A terminal shows findings, and a verdict that is not bad, on request: the sections have what matters
    )
    after: tuple[str, ...] = ()  # lines for the terminal, below the names of the written files
    next: tuple[object, ...] = ()  # Words of the command that follows
    failed: bool = False  # a script must stop, independent of the verdict, because a file of a folder could not be read

    def __post_init__(self) -> None:
        object.__setattr__(self, "answer", without_signed_zeros(self.answer))
        object.__setattr__(self, "notes", tuple(map(without_signed_zeros, self.notes)))

    @property
    def headed(self) -> str:
        """The verdict as a heading, such as "Verdict: good", or an empty string."""
        about = f" of {self.judged}" if self.judged else ""
        return f"Verdict{about}: {self.verdict.status}" if self.verdict else ""

    @property
    def stops(self) -> bool:
        """True if a script must stop because the exit code of the command is 1."""
        return self.failed or (self.verdict is not None and self.verdict.status == "bad")

    def summary(self) -> "Summary":
        """Return itself."""
        return self


def today() -> str:
    """Return the date of a page, ISO 8601, UTC. The environment variable SOURCE_DATE_EPOCH (s since 1970) overrides it."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    moment = datetime.fromtimestamp(int(epoch), UTC) if epoch.isdigit() else datetime.now(UTC)
    return moment.isoformat(timespec="seconds")


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Command and input files of a page, and its date."""

    command: str = ""
    inputs: tuple[tuple[str, str], ...] = ()  # File and sha256
    date: str = field(default_factory=today)


def table_section(title: str, items: Iterable[Item], cells: Cells[Item], **more: Any) -> Section:
    """Return a section with one row per item. Each column has a head and a function that returns its cell."""
    rows = tuple(tuple(cell(item) for _, cell in cells) for item in items)
    return Section(title=title, columns=tuple(head for head, _ in cells), rows=rows, **more)


def rows_section(title: str, rows: Sequence[dict[str, str]], **more: Any) -> Section:
    """Return a section with rows that have the same heads. Without rows, the section has a title only."""
    if not rows:
        return Section(title=title)
    return Section(title=title, columns=tuple(rows[0]), rows=tuple(tuple(row.values()) for row in rows), **more)


def number(value: float, form: str = ".2f") -> str:
    """Return a number as text, or a dash if it is not finite."""
    return f"{value:{form.replace('.', 'z.', 1)}}" if math.isfinite(value) else "–"  # z: no zero below zero


def interval(ends: Sequence[float], form: str = ".3f") -> str:
    """Return an interval."""
    return f"{ends[0]:{form}} to {ends[1]:{form}}"


def plain_words(name: str) -> str:
    """Return a name of the code as words."""
    return name.replace("_", " ")


def plain(value: object) -> Plain:
    """Return a value made of what JSON knows: arrays as lists, NaN and infinity as None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # arrays and numbers of numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None  # no -0.0
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, Sequence | set | frozenset):
        return [plain(item) for item in value]
    return str(value)


def findings_of(value: Mapping[str, object]) -> list[object]:
    """Return the findings of the parts of an answer: of its trials, or tasks."""
    lists = [rows for rows in value.values() if isinstance(rows, list)]
    parts = [row for rows in lists for row in rows if isinstance(row, Mapping)]
    return [item for row in parts for item in row.get("findings", ())]


def as_html(summary: Summary) -> str:
    """Return a summary as a part of a notebook: answer, tables, verdict with its first findings."""
    parts = [f"<h4>{escape(summary.title)}</h4><p>{escape(summary.answer)}</p>"]
    for section in (entry for entry in summary.sections if entry.folded is not True and entry.on != "page"):
        head = "".join(f"<th>{escape(name)}</th>" for name in section.columns)
        body = ("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in section.rows)
        if section.rows:
            parts.append(f"<table><caption>{escape(section.title)}</caption><tr>{head}</tr>{''.join(body)}</table>")
        parts += (f"<p>{escape(line)}</p>" for line in section.text)
    if summary.verdict is not None:
        parts.append(f"<p>{summary.headed}</p>")
    findings = (*(summary.verdict.findings if summary.verdict else ()), *summary.findings)
    items = (f"<li>{escape(item.text)}</li>" for item in most_consequential_first(findings)[:SHOWN_FIRST])
    return "".join((*parts, "<ul>", *items, "</ul>"))
