"""Commands on the command line: parse and call them, and show a summary as text (``show``) or as JSON (``write_json``).

``command_of`` makes a command from a function of ``undrift.commands``. It adds --report, --details and --json, and
shows the summary of the result. For example, ``undrift.cli.common:orient`` is the command ``orient``.

Messages and progress go to stderr. Nothing here imports numpy or rich before a command runs: ``--help`` answers at once.
"""

import inspect
import json
import os
import shlex
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from dataclasses import Field, fields, is_dataclass, replace
from importlib import import_module
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from cyclopts import App, Parameter

from undrift import __version__
from undrift.base.options import WRITTEN, Details, Json, Report
from undrift.base.spoken import NAMED, showing, spoken, spoken_template
from undrift.base.summary import Result, findings_of, plain
from undrift.cli import examples
from undrift.cli.app import COMMANDS
from undrift.commands import GROUPS, VERBS, Progress, Screen
from undrift.commands.files import check_output, files_in, origin_of
from undrift.findings import SHOWN_FIRST, Finding, Verdict, most_consequential_first

if TYPE_CHECKING:
    from rich.console import Console

    from undrift.base.summary import Section, Summary


def group(name: str, text: str) -> App:
    """Return a command group without commands."""
    return App(
        name=name,
        help=text,
        help_epilogue=examples(name),
        help_format="plaintext",
        default_parameter=Parameter(negative=()),
        result_action="return_value",
    )


# ---- Results


def console(*, err: bool = False) -> "Console":
    """Return the console for results (stdout) or messages (stderr), as wide as a table needs where that is not a terminal."""
    from rich import console as rich

    class Console(rich.Console):
        def on_broken_pipe(self) -> None:  # the reader of stdout, such as head, has seen enough: no failure
            raise BrokenPipeError

    terminal = (sys.stderr if err else sys.stdout).isatty()
    return Console(stderr=err, width=None if terminal else 400, highlight=False, emoji=False, soft_wrap=not terminal)


def say(*lines: str, err: bool = False, style: str = "") -> None:
    """Print lines unchanged. Brackets in names are not markup, and lines are broken only at spaces, to the terminal's
    width.
    """
    _print(*map(spoken, lines), err=err, style=style)


def _print(*lines: str, err: bool = False, style: str = "") -> None:
    out = console(err=err)
    for line in (line for text in lines for line in text.split("\n")):
        for segment in [line] if out.soft_wrap else _wrap(line, out.width):
            out.print(segment, markup=False, soft_wrap=True, style=style)


class Terminal(Screen):
    """Progress and questions on stderr and stdin. Lines are cut to the terminal's width. Elsewhere each step is printed
    once.
    """

    _step: int | None = None  # That has its line
    _lines = 1  # number of lines shown last, which the next lines overwrite

    def say(self, *lines: str) -> None:
        say(*lines, err=True)

    def over(self, line: str, *, step: int | None = None, last: bool = False) -> None:
        if sys.stderr.isatty():
            width = console(err=True).width - 1
            lines = [_wrap(row, width, max_lines=1, placeholder=" …")[0] for row in line.split("\n")]
            above = f"\x1b[{self._lines - 1}A" if self._lines > 1 else ""
            sys.stderr.write(f"\r{above}\x1b[J" + "\n".join(lines) + "\n" * last)
            sys.stderr.flush()
            self._lines = 1 if last else len(lines)
        elif step not in (None, self._step):
            self._step = step
            sys.stderr.write(line.partition("\n\n")[0].replace("\n", ". ") + "\n")

    def ask(self, line: str) -> str:
        sys.stderr.write(line)
        sys.stderr.flush()
        if answer := sys.stdin.readline():
            return answer
        raise EOFError


def _wrap(line: str, width: int, **options: Any) -> list[str]:
    """Return a line split to the width, without broken words. A word wider than the terminal gets its own line."""
    from rich.cells import cell_len

    indent = line[: len(line) - len(line.lstrip())]
    options |= {"subsequent_indent": indent, "break_long_words": False, "break_on_hyphens": False}
    return textwrap.wrap(line, max(1, width - max(0, cell_len(line) - len(line))), **options) or [""]


SAID_EVERY, SAID_EVERY_S = "UNDRIFT_PROGRESS_S", 8.0  # if stderr is not a terminal; the variable sets another interval


class ProgressBar:
    """Progress of a long command: a bar on a terminal, otherwise a line on stderr every 8 s, with the remaining time."""

    def __init__(self, command: str) -> None:
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar
        from rich.table import Column

        self._command, self._what, self._share, self._begun = command, "reading", 0.0, False
        columns = (
            TextColumn("{task.description}", markup=False, table_column=Column(overflow="fold")),  # wraps at spaces
            BarColumn(max(4, min(40, console(err=True).width - 60))),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeRemainingColumn(),
        )
        hidden = not sys.stderr.isatty()
        self._bar = Bar(*columns, console=console(err=True), transient=True, disable=hidden)
        self._stop = threading.Event()
        self._task = self._bar.add_task(self._what, total=1.0)
        self._began_s = time.monotonic()
        self._teller = threading.Thread(target=self._report_periodically, daemon=True)

    def __enter__(self) -> "ProgressBar":
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._bar.stop()

    def __call__(self, what: str, share: float) -> None:
        """Show the current task and the completed share, 0 to 1. Lines above the last line stay visible."""
        if not self._begun:  # do not disturb the earlier content of the screen
            self._begun = True
            self._bar.start()
            if not sys.stderr.isatty():
                self._teller.start()
        *lines, self._what = what.split("\n")
        self._share = share
        say(*(f"undrift {self._command}: {line}" for line in lines), err=True)
        self._bar.update(self._task, description=self._what, completed=share)

    def _report_periodically(self) -> None:
        interval = os.environ.get(SAID_EVERY, "")
        while not self._stop.wait(float(interval) if interval.replace(".", "", 1).isdigit() else SAID_EVERY_S):
            passed_s, share = time.monotonic() - self._began_s, self._share
            remaining = "time left not known yet"
            if share > 0.0:
                remaining = f"about {passed_s * (1.0 - share) / share:.0f} s left ({100.0 * share:.0f} %)"
            sys.stderr.write(f"undrift {self._command}: {self._what}, {passed_s:.0f} s so far, {remaining}\n")
            sys.stderr.flush()


def show_table(title: str, heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table. If it does not fit with narrow columns and headings, print a line for each cell.

    Columns after the first are right-aligned, and a unit in brackets is on a separate line. Text is never cropped or
    broken.
    """
    from rich.cells import cell_len, set_cell_size

    out, cell_rows = console(), list(rows)
    say(title, style="table.title")
    for gap, parted in ((3, " ("), (1, " ("), (1, " ")):
        names = [head.replace(parted, f"\n{parted[1:]}").split("\n") for head in heads]
        tops = [*zip_longest(*map(reversed, names), fillvalue="")][::-1]
        wide = [max(map(cell_len, column)) for column in zip(*tops, *cell_rows, strict=True)]
        rule = "─" * (sum(wide) + gap * (len(wide) - 1))
        if len(rule) + 2 <= out.width:
            break
    else:
        return _print(*(_stack_cells(heads, row) for row in cell_rows))

    def laid(cells: Sequence[str]) -> str:
        placed = (" " * (most - cell_len(cell)) + cell for cell, most in zip(cells[1:], wide[1:], strict=True))
        return " " + (" " * gap).join((set_cell_size(cells[0], wide[0]), *placed)) + " "

    out.print("", *map(laid, tops), sep="\n", markup=False, soft_wrap=True, style="table.header")
    return out.print(f" {rule} ", *map(laid, cell_rows), "", sep="\n", markup=False, soft_wrap=True)


def _stack_cells(heads: Sequence[str], row: Sequence[str]) -> str:
    """Return a row with a line for each cell. A cell without a heading follows the cell before it."""
    cells = [(head, cell.strip()) for head, cell in zip(heads, row, strict=True) if cell.strip()]
    return "".join(f"\n  {head}: {cell}" if head else f" {cell}" for head, cell in cells).strip()


ENVELOPE = ("kind", "format", "version", "verdict", "findings", "result", "error")  # of every answer in JSON


KINDS = {  # kinds of answers that differ from the command's name
    **dict.fromkeys(("calibrate", "drift"), "undrift.calibration"),
    "correct": "undrift.correction",
    "orient": "undrift.orientation",
    "validate": "undrift.validation",
    "simulate": "undrift.simulation",
}


def write_json(value: Mapping[str, object], command: str, *, error: Mapping[str, str] | None = None) -> None:
    """Write a JSON object to stdout: the envelope and the command's own values, which are also in ``result``.

    The envelope contains kind, format, verdict and findings of the command. NaN is written as null.
    """
    kind = KINDS.get(command, "undrift." + (command.replace(" ", "_") or "call"))
    verdict = value.get("verdict")
    judged = verdict.get("findings", ()) if isinstance(verdict, Mapping) else ()
    findings = value.get("findings", [*judged, *findings_of(value)])
    values = {key: item for key, item in value.items() if key not in ENVELOPE}
    head = {"kind": value.get("kind", kind), "format": value.get("format", 1), "version": __version__}
    rest = {"verdict": verdict, "findings": findings, "result": None if error else values, "error": error}
    sys.stdout.write(json.dumps(plain(head | values | rest), ensure_ascii=False, allow_nan=False) + "\n")


def show_verdict(verdict: "Verdict", heading: str, *, details: bool) -> None:
    """Show a verdict under its heading with its three most consequential findings, or all of them with details."""
    colour = {"good": "green", "marginal": "yellow", "bad": "red"}[verdict.status]
    say(heading[:1].lower() + heading[1:], style=f"bold {colour}")
    show_findings(verdict.findings, details=details)


def show_findings(findings: Iterable[Finding], *, details: bool) -> None:
    """Show the three most consequential findings, or all of them with details."""
    ordered = most_consequential_first(findings)
    visible = ordered if details else ordered[:SHOWN_FIRST]
    for item in visible:
        say(f"  - {spoken_template(item.sentence)}")
        if item.action:
            say(f"    -> {spoken_template(item.action)}")
    if len(ordered) > len(visible):
        say(f"  {len(ordered) - len(visible)} more: --details")


def show(summary: "Summary", *, details: bool) -> None:
    """Show a summary on a terminal: answer, sections, verdict or warnings, notes, written files and next steps."""
    say(summary.answer)
    for section in summary.sections:
        if details or (section.on != "page" and section.folded is not True):
            _show_section(section, details=details)
    if summary.verdict is not None and (details or not summary.brief or summary.verdict.status == "bad"):
        show_verdict(summary.verdict, summary.headed, details=details)
    if not summary.brief:
        say(*(f"  warning: {warning.text}" for warning in summary.findings if warning.level != "info"))
    say(*(f"  note: {note}" for note in summary.notes), *(f"Wrote {path}" for path in summary.written if path))
    say(*summary.after)
    if summary.next:
        say("Next: undrift " + shlex.join(map(str, summary.next)))


def _show_section(section: "Section", *, details: bool) -> None:
    if section.rows:
        show_table(section.title, section.columns, section.rows)
    say(*(f"  {line}" for line in section.text))
    if section.findings:
        say(section.title)
        show_findings(section.findings, details=details)


# ---- Commands of undrift.commands: parse, call, show

SHOWN_BY: dict[Any, Callable[[str], Any]] = {Progress: ProgressBar, Screen: lambda _: nullcontext(Terminal())}
OWN: dict[str, tuple[Any, Any]] = {"report": (Report, None), "details": (Details, False), "json": (Json, False)}


def __getattr__(name: str) -> Callable[..., int] | App:
    """Return a command of ``undrift.commands``, or a group of them, by its name, imported when it is called."""
    if name not in (*VERBS, *GROUPS):
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    module = import_module(f"undrift.commands.{name}")
    if name in VERBS:
        return command_of(name, getattr(module, name))
    command_group = group(name, COMMANDS[name])
    for word, function in GROUPS[name].items():
        called = f"{name} {word}"
        command_group.command(command_of(called, getattr(module, function)), name=word, help_epilogue=examples(called))
    return command_group


def _fields(hint: Any) -> "tuple[Field[Any], ...]":
    """Return the fields of settings, each an option. Other parameters have none."""
    settings = getattr(hint, "__origin__", hint)  # of Annotated[...]
    return fields(settings) if is_dataclass(settings) else ()


def command_of(name: str, verb: Callable[..., Result]) -> Callable[..., int]:
    """Return a command of the command line with the parameters of the verb and of the display. It returns the exit
    code.
    """
    hints, parameters = get_type_hints(verb, include_extras=True), inspect.signature(verb).parameters
    injected = {key for key in parameters if hints[key] in (Progress, Screen)}
    names = {name for key in parameters for name in (key, *(field.name for field in _fields(hints[key])))}
    options = [field.replace(annotation=hints[key]) for key, field in parameters.items() if key not in injected]
    read = [field.name for field in options if WRITTEN not in getattr(field.annotation, "__metadata__", ())]

    def command(*words: Any, report: Path | None = None, details: bool = False, json: bool = False, **more: Any) -> int:
        NAMED.set(frozenset(names) | {"reference_map"})  # info also sends people to validate
        files = tuple(dict.fromkeys(files_in((*words, *(more.get(key) for key in read)))))
        check_output(report, endings=(".html",), reads=files)
        origin = None if report is None else origin_of(*files)  # before the command, which may overwrite its input
        with ExitStack() as stack:
            result = verb(*words, **more, **{key: stack.enter_context(SHOWN_BY[hints[key]](name)) for key in injected})
        with ExitStack() as stack:
            lasting = result if isinstance(result, AbstractContextManager) else None  # goes on until Ctrl-C
            if lasting is not None:
                stack.enter_context(lasting)
                stack.enter_context(suppress(KeyboardInterrupt))
            summary = result.summary()
            if report is not None and origin is not None:
                from undrift.report.page import write_page

                output_files = origin_of(*summary.sources).inputs
                write_page(report, summary, replace(origin, inputs=(*origin.inputs, *output_files)))
            if json:
                write_json(summary.data, name)
            else:
                with showing():
                    show(summary, details=details)
                say(*([] if report is None else [f"Wrote {report}"]))
            if lasting is not None:
                sys.stdout.flush()
                threading.Event().wait()
        return int(summary.stops)

    added = [
        inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=value, annotation=hint)
        for key, (hint, value) in OWN.items()
    ]
    command.__name__, command.__doc__ = verb.__name__, verb.__doc__
    command.__annotations__ = {field.name: field.annotation for field in (*options, *added)}
    command.__signature__ = inspect.Signature([*options, *added])  # type: ignore[attr-defined]
    return command
