"""Options: data about a parameter, in addition to its name, type and default, for the command line, forms and docs.

A command is a function. Its options are its parameters and the fields of its settings (dataclasses marked
``@options``). They are options of the command line, keyword arguments in Python, and fields of a form, all with the
same name. The docstring is their help.
"""

from collections.abc import Callable
from dataclasses import field, is_dataclass
from functools import wraps
from inspect import signature
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, cast, get_type_hints

from cyclopts import Parameter

Value = TypeVar("Value")
options = Parameter(name="*")  # of a dataclass: each field is an option
WRITTEN = "written"  # marks a parameter that names a file to write

Flag: TypeAlias = Annotated[bool, Parameter(show_default=False)]
Files: TypeAlias = Annotated[Path, Parameter(required=True)]  # of *files: one or more
Json: TypeAlias = Annotated[bool, Parameter(show_default=False, help="One JSON object on stdout.")]
Details: TypeAlias = Annotated[
    bool, Parameter(show_default=False, help="Show every finding, and every finding of a calibration that is read.")
]
Output: TypeAlias = Annotated[Path, WRITTEN, Parameter(name=["--output", "-o"])]
OptionalOutput: TypeAlias = Annotated[Path | None, WRITTEN, Parameter(name=["--output", "-o"])]
WrittenPath: TypeAlias = Annotated[Path | None, WRITTEN]
Side: TypeAlias = Annotated[Literal["+x", "-x", "+y", "-y", "+z", "-z"], Parameter(allow_leading_hyphen=True)]
Up: TypeAlias = Annotated[Literal["y", "z"] | None, Parameter(help="Laboratory axis that points up, in TRC or C3D.")]
Gravity: TypeAlias = Annotated[float, Parameter(help="Local gravity, m/s2.")]
Policy: TypeAlias = Literal["raise", "hold", "nan"]
Report: TypeAlias = Annotated[Path | None, WRITTEN, Parameter(help="Report page to write: .html.")]


def verb(function: Callable[..., Value]) -> Callable[..., Value]:
    """Make a command callable from Python like from the command line: files by name, fields of settings as keywords."""

    @wraps(function)
    def called(*given: Any, **keywords: Any) -> Value:
        hints = get_type_hints(function)
        for name, hint in hints.items():
            if name != "return" and is_dataclass(hint) and name not in keywords:
                kinds = get_type_hints(hint)
                settings = {key: _as(kinds[key], keywords.pop(key)) for key in kinds.keys() & keywords.keys()}
                keywords |= {name: cast(Any, hint)(**settings)} if settings else {}
        positionals = (
            item if isinstance(item, list | tuple) else (item,) for item in given
        )  # accept a list as well as several names
        call = signature(function).bind(*chain.from_iterable(positionals), **keywords)
        call.arguments.update({name: _as(hints[name], value) for name, value in call.arguments.items()})
        return function(*call.args, **call.kwargs)

    return called


def _as(hint: Any, value: Any) -> Any:
    """Return a value with names of files as paths, and one of several as several."""
    if "Path" in str(hint) and isinstance(value, str | tuple | list):
        value = Path(value) if isinstance(value, str) else tuple(map(Path, value))
    return (value,) if "tuple[" in str(hint) and isinstance(value, str | Path) else value


def stated(**values: object) -> tuple[object, ...]:
    """Return options as arguments of a command, without options that are None or ""."""
    options = {name: value for name, value in values.items() if value not in (None, "")}
    return tuple(word for name, value in options.items() for word in (f"--{name.replace('_', '-')}", value))


def asked(label: str, value: str = "", **how: Any) -> Any:
    """Return a field of a dataclass that a form asks for: its label, or the option of a command, and more of a form's field."""
    return field(default=value, metadata={"label": label, **how})
