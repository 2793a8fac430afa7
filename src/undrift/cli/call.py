"""Call a command: parse its arguments, run it with its progress on the screen, and show its report.

A command is a function of ``undrift.commands`` that returns a ``Report``. Its parameters are the options, and its
docstring is the help. ``--report``, ``--details`` and ``--json`` belong to every command.
"""

import json as json_format
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

from cyclopts import App, CycloptsError, Group, MissingArgumentError, Parameter, UnusedCliTokensError

from undrift import __version__
from undrift.base.options import WRITTEN
from undrift.base.spoken import NAMED
from undrift.cli import examples
from undrift.cli.app import ABOUT, COMMANDS
from undrift.cli.screen import Terminal
from undrift.commands.outputs import check_output, files_in, origin_of
from undrift.errors import InputError
from undrift.report.report import Report, as_json, plain
from undrift.report.terminal import say, show
from undrift.screen import showing_on

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel
    from cyclopts.help.protocols import HelpFormatter

FUNCTIONS = {  # module and function of each command
    **{name: f"{name}:{name}" for name in COMMANDS if name != "rig"},
    "bench": "open_bench:bench",
    **{f"rig {name}": f"rig:{name}" for name in ("run", "stop", "check")},
}
DISPLAY = Group("Display", sort_key=99)


def app() -> App:
    """Return the commands. Each is imported when it is called."""
    root = App(
        name="undrift",
        help=ABOUT,
        version=__version__,
        help_format="plaintext",
        help_formatter=_formatter(),
        result_action="return_value",
        suppress_keyboard_interrupt=False,
        default_parameter=Parameter(negative=(), json_list=False, json_dict=False),  # "[1] walk.csv" is a name
    )
    for words, place in FUNCTIONS.items():
        *groups, name = words.split(" ")
        home = root
        for group in groups:
            home = home[group] if group in home else home.command(_group(group))
        home.command(f"undrift.commands.{place}", name=name, help_epilogue=examples(words))
    root.register_install_completion_command(add_to_startup=False)  # the shell's start file is not changed
    return root


def _group(name: str) -> App:
    return App(name=name, help=COMMANDS[name], help_format="plaintext", help_epilogue=examples(name))


def call(arguments: Sequence[str]) -> int:
    """Run the command given by the arguments, and return the exit code."""
    root = app()
    root.meta.suppress_keyboard_interrupt = False

    @root.meta.default
    def run(
        *words: Annotated[str, Parameter(show=False, allow_leading_hyphen=True)],
        report: Annotated[Path | None, Parameter(group=DISPLAY, help="File for the report page (.html).")] = None,
        details: Annotated[
            bool, Parameter(group=DISPLAY, negative=(), show_default=False, help="Show every finding and table.")
        ] = False,
        json: Annotated[
            bool, Parameter(group=DISPLAY, negative=(), show_default=False, help="One JSON object on stdout.")
        ] = False,
    ) -> int:
        if not words:
            raise InputError(f'Unknown command "{arguments[0]}". Run undrift --help.')
        command, bound, _ = root.parse_args(words, exit_on_error=False, print_error=False)
        if bound is None:  # --help and --version
            command()
            return 0
        chain, apps, _ = root.parse_commands(words)
        if apps[-1].default_command is None:  # a group without a command
            root.help_print(words)
            return 0
        name = " ".join(chain)
        NAMED.set(_option_names(command))
        read = files_in(tuple(value for key, value in bound.arguments.items() if not _is_output(command, key)))
        inputs = tuple(dict.fromkeys(read))
        check_output(report, endings=(".html",), reads=inputs)
        origin = None if report is None else origin_of(*inputs)  # before an input is overwritten
        with Terminal(name) as terminal, showing_on(terminal):
            result: Report = command(*bound.args, **bound.kwargs)
        if report is not None:
            from undrift.report.page import write_report

            write_report(report, result, origin)
        if json:
            write_json(as_json(result, name))
        else:
            show(result, details=details)
            say(*([] if report is None else [f"Wrote {report}"]))
        return result.exit_code

    try:
        code = root.meta(list(arguments), exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as error:
        command = " ".join(("undrift", *(error.command_chain or ())))
        if isinstance(error, UnusedCliTokensError):
            unused = " ".join(error.unused_tokens or ())
            raise InputError(f"unexpected argument {unused}. Run {command} --help.") from error
        sentence = str(error).strip().splitlines()[0]
        if isinstance(error, MissingArgumentError):
            lacking = "requires a value" if error.keyword else "is missing"
            sentence = re.sub(r"^(?:Command .* p|P)arameter (.*) requires an argument", rf"\1 {lacking}", sentence)
        raise InputError(f"{sentence} Run {command} --help.") from error
    return code if isinstance(code, int) else 0


def _option_names(command: Callable[..., Any]) -> frozenset[str]:
    """Return the names of all parameters of a command, including the fields of its settings."""
    names = {"reference_map"}  # info also refers to options of validate
    for name, hint in get_type_hints(command).items():
        names |= {name, *(item.name for item in fields(hint))} if is_dataclass(hint) else {name}
    return frozenset(names)


def _is_output(command: Callable[..., Any], name: str) -> bool:
    return WRITTEN in getattr(get_type_hints(command, include_extras=True)[name], "__metadata__", ())


def _formatter() -> "HelpFormatter":
    """Return a help formatter that fills the lines of the terminal, because the line breaks of docstrings do not match."""
    from cyclopts.help import DefaultFormatter
    from rich.text import Text

    class Flowing(DefaultFormatter):
        def __call__(self, console: Any, options: Any, panel: "HelpPanel") -> None:
            for entry in panel.entries:
                if isinstance(text := getattr(entry.description, "primary_renderable", None), Text):
                    text.plain = text.plain.replace("\n", " ")
            super().__call__(console, options, panel)

    return Flowing()


def write_json(value: Any) -> None:
    """Write a JSON object to stdout, with null for NaN."""
    sys.stdout.write(json_format.dumps(plain(value), ensure_ascii=False, allow_nan=False) + "\n")
