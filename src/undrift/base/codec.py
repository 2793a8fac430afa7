"""Files of values: JSON and TOML <-> classes that pydantic checks. A class defines the file, with its keys and units.

::

    class Turn(FileTable):                                 a table of a TOML file, in the units of the file
        start_s: float
        turn_rate_dps: float | None = None

    @stored(kind="undrift.loop")                           a dataclass in a JSON file
    @dataclass(frozen=True, slots=True, kw_only=True, eq=False)
    class Loop:
        temp_c: Annotated[FloatArray, Shape("n", rising=True)]
        rms: AnyNumber = math.nan
        half_width: Annotated[FloatArray | None, Shape("n"), LATER] = None

    json_text(loop, "loop.json")   {"kind": "undrift.loop", "format": 1, "temp_c": [20.0, 30.0], "rms": null}
    read_json(Loop, "loop.json")   the same value, to the last bit
    read_toml(Turn, "turn.toml")

Tables are strict and closed: a number is not text, and an unknown key is an error. A key is required if its field has no
default, or in a dataclass that is stored ``whole``. A dataclass is built by pydantic when a file is read, with its
``__post_init__``. It is not checked when the program creates one.
"""

import difflib
import json
import math
import re
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic_core import core_schema

from undrift.errors import FileFormatError, InputError
from undrift.files import MOST_TREE, read_tree, too_large

Value = TypeVar("Value")
Tree = dict[str, Any]
FORMAT = 1  # second key of a file with a kind
LATER = Field(exclude_if=lambda value: value is None or (isinstance(value, float) and value == 0.0))  # optional key
_CLOSED = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
_KINDS: dict[type, str] = {}  # first key of the files of a class


class FileTable(BaseModel):
    """A table of a file: unknown keys are an error, and no value is converted."""

    model_config = ConfigDict(**_CLOSED, frozen=True, defer_build=True)

    def but(self, **values: Any) -> Self:
        """Return a copy with other values, which are not checked."""
        return self.model_copy(update=values)


def stored(*, kind: str = "", whole: bool = False, form: "As | None" = None) -> Callable[[type[Value]], type[Value]]:
    """Return a decorator for a dataclass in a file. ``kind`` makes it a separate file, and ``whole`` makes all keys required.

    LATER keys remain optional. With a ``form``, the file contains another type instead.
    """

    def build(cls: Any, source: Any, handler: Any) -> Any:
        schema = handler(source)
        for field in handler.resolve_ref_schema(schema)["schema"]["fields"]:
            if field["schema"]["type"] == "default" and "serialization_exclude_if" not in field:
                field["schema"] = field["schema"]["schema"]
        return schema

    def mark(cls: Any) -> Any:
        about = {"description": (cls.__doc__ or "").partition("\n")[0]}
        cls.__pydantic_config__ = ConfigDict(**_CLOSED, json_schema_extra=about)
        if kind:
            _KINDS[cls] = kind
        if whole or form:
            cls.__get_pydantic_core_schema__ = form.__get_pydantic_core_schema__ if form else classmethod(build)
        return cls

    return mark


@dataclass(frozen=True, slots=True)
class As:
    """Annotation of a type that is stored as another type in a file."""

    form: Any  # type in the file
    read: Callable[[Any], Any]  # converts from the form
    write: Callable[[Any], Any]  # converts to plain lists, dicts and numbers

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        write = core_schema.plain_serializer_function_ser_schema(self.write)
        return core_schema.no_info_after_validator_function(
            self.read, handler.generate_schema(self.form), serialization=write
        )


def _from_null(value: Any) -> float:
    return math.nan if value is None else float(value)


def to_null(value: float) -> float | str | None:
    return value if math.isfinite(value) else None if math.isnan(value) else "inf" if value > 0.0 else "-inf"


Gap = Annotated[float, As(float | None, _from_null, to_null)]  # number, with NaN stored as null in a file
AnyNumber = Annotated[float, As(float | None | Literal["inf", "-inf"], _from_null, to_null)]  # also infinite
Pairs = Annotated[tuple[tuple[str, str], ...], As(dict[str, str], lambda table: tuple(table.items()), dict)]


# ---- from tree to value


_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)


def value_of(cls: type[Value], tree: Any, name: str, text: str = "") -> Value:
    """Return the value of a tree. Error messages use ``name``, and line numbers if the TOML text is given."""
    if kind := _KINDS.get(cls):
        head = (tree.get("kind"), tree.get("format")) if isinstance(tree, dict) else (None, None)
        if head[0] != kind:
            raise FileFormatError(
                f"{name}: expected kind {kind!r}, got {head[0]!r}. Use {_called(cls)} that undrift wrote."
            )
        if head[1] != FORMAT or isinstance(head[1], bool):
            raise FileFormatError(
                f"{name}: expected format {FORMAT}, got {head[1]!r}. Read it with the undrift that wrote it."
            )
        tree = {key: item for key, item in tree.items() if key not in ("kind", "format")}
    try:  # validate as JSON, which is strict and accepts lists for tuples
        value: Value = _adapter(cls).validate_json(json.dumps(tree, default=str))
    except ValidationError as error:
        raise FileFormatError(f"{name}: {_first_problem(cls, error, tree, text)}") from error
    except (OverflowError, RecursionError, TypeError) as error:
        raise FileFormatError(f"{name}: {error}") from error
    return value


def _first_problem(cls: type, error: ValidationError, tree: Any, text: str) -> str:
    """Return the first problem, with line and entry in TOML, with the key in JSON. Unknown keys explain others."""
    every = error.errors(include_url=False)
    problems = [problem for problem in every if problem["type"] != "too_short"] or every  # may lack its bad items only
    unknown = [problem for problem in problems if problem["type"] in ("extra_forbidden", "unexpected_keyword_argument")]
    problem: Any = (unknown or problems)[0]
    place, value = list[Any](), tree
    for step in problem["loc"]:  # pydantic also names branches of unions, which the file does not contain
        if step in value if isinstance(value, dict) else isinstance(value, list) and isinstance(step, int):
            place, value = [*place, step], value[step]
    if problem["type"] == "missing":
        place.append(problem["loc"][-1])
        what = "this key is missing. Add it."
    elif problem["type"] == "value_error":
        what = str(problem["ctx"]["error"])
    elif unknown:
        near = difflib.get_close_matches(
            str(place[-1]), sorted(_keys_in(schema_of(cls)) - {place[-1]}), n=1, cutoff=0.7
        )
        what = f"this key is unknown. Check its spelling{f' (nearest known key: {near[0]})' if near else ''}."
    else:
        got = repr(problem["input"])
        what = problem["msg"].replace("Input should be ", "expected ").splitlines()[0]
        what = f"{what}, got {got if len(got) < 80 else got[:80] + ' ...'}"
    if place:
        where = f"line {line_of(text, place)}: {entry_name(place)}" if text else f"at {'.'.join(map(str, place))}"
        what = f"{where}: {what}"
    return what + f" (and {len(problems) - 1} more)" * (len(problems) > 1)


def _keys_in(schema: Tree) -> set[str]:
    """Return all keys of the tables in a JSON Schema."""
    return {key for table in (schema, *schema.get("$defs", {}).values()) for key in table.get("properties", ())}


def _called(cls: type) -> str:
    return f"a {_KINDS[cls].rpartition('.')[2]}"


def schema_of(cls: type) -> Tree:
    """Return the JSON Schema of the files of a class."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **_adapter(cls).json_schema()}
    if cls in _KINDS:
        head = {"kind": _KINDS[cls], "format": FORMAT}
        types = {"kind": "string", "format": "integer"}
        keys = {key: {"const": value, "title": key.title(), "type": types[key]} for key, value in head.items()}
        schema["properties"] = keys | schema["properties"]
        schema["required"] = [*head, *schema["required"]]
    return schema


# ---- from value to tree


def tree_of(value: Any) -> Any:
    """Return a value as plain dicts, lists, numbers and texts, as its file contains it."""
    cls: Any = type(value)
    head = {"kind": _KINDS[cls], "format": FORMAT} if cls in _KINDS else {}
    return head | _adapter(cls).dump_python(value, mode="json", by_alias=True, warnings=False)


# ---- files


def read_json(cls: type[Value], path: Path | str) -> Value:
    """Read a value from a JSON file. NaN and Infinity are refused."""

    def refuse(name: str) -> float:
        raise ValueError(f"{name}, which JSON cannot represent")

    path = Path(path)
    if path.is_file() and path.stat().st_size > MOST_TREE:
        raise too_large(path)
    try:
        tree = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    except OSError as error:
        raise FileFormatError(f"{path}: expected {_called(cls)} file, got {error.strerror}. Check the path.") from error
    except (ValueError, RecursionError) as error:  # broken JSON, or text that is not UTF-8
        raise FileFormatError(
            f"{path}: expected {_called(cls)} file, got no valid JSON ({error}). Check the path."
        ) from error
    return value_of(cls, tree, str(path))


def read_toml(cls: type[Value], path: Path | str) -> tuple[Value, str]:
    """Return the value of a TOML file, and its text."""
    tree, text = toml_of(path)
    return value_of(cls, tree, str(path), text), text


def toml_of(path: Path | str) -> tuple[Tree, str]:
    """Return the tree of a TOML file, and its text."""
    try:
        text = read_tree(path).decode("utf-8")
        return tomllib.loads(text), text
    except UnicodeDecodeError as error:
        raise FileFormatError(
            f"{path}: expected UTF-8 text, got another encoding (byte {error.start}). Save the file as UTF-8."
        ) from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise FileFormatError(f"{path}: expected TOML, got an invalid line: {error}") from error


def json_text(value: Any, name: str) -> str:
    """Return the text of a JSON file after a check that it can be read back. ``name`` is used in error messages."""
    try:
        tree = tree_of(value)
        value_of(type(value), tree, "the file")
    except FileFormatError as error:
        raise InputError(f"{name}: {_called(type(value))} must read back, got {error}. Correct the value.") from error
    return _on_one_line(r"[^\[\]{}]", json.dumps(tree, indent=2, allow_nan=False)) + "\n"


def toml_text(tree: Tree) -> str:
    """Return the text of a TOML file. None is omitted, and a list of tables is written as [[name]] tables."""
    import tomli_w

    tree = _without_nulls(tree)
    several = {
        name: rows for name, rows in tree.items() if isinstance(rows, list) and rows and isinstance(rows[0], dict)
    }
    first = tomli_w.dumps({name: rows for name, rows in tree.items() if name not in several})
    blocks = [toml_block(name, table) for name, tables in several.items() for table in tables]
    return "\n".join(filter(None, (_on_one_line(r"[^\[\]]", first), *blocks)))


def toml_block(name: str, table: Tree) -> str:
    """Return the text of one of several tables: [[name]] and its keys."""
    import tomli_w

    head, _, rest = tomli_w.dumps({name: _without_nulls(table)}).partition("\n")
    return _on_one_line(r"[^\[\]]", f"[{head}]\n{rest}")


def _on_one_line(inner: str, text: str) -> str:
    """Return a text with each list of plain values on one line. Its strings contain no raw line breaks."""
    lists = re.compile(rf"\[\n\s*({inner}*?),?\n\s*\]")
    return lists.sub(lambda match: "[" + re.sub(r"\n\s*", " ", match[1]) + "]", text)


def _without_nulls(tree: Tree) -> Tree:
    items = {name: _without_nulls(item) if isinstance(item, dict) else item for name, item in tree.items()}
    return {name: item for name, item in items.items() if item is not None}


# ---- places in a text of TOML


def line_of(text: str, place: Sequence[str | int]) -> int:
    """Return the line of an entry in a TOML text."""
    lines, start, keys = text.splitlines(), -1, [name for name in place if isinstance(name, str)]
    wanted, listed = (place[1], 1) if len(place) > 1 and isinstance(place[1], int) else (0, 2)
    for depth in range(min(listed, len(keys)), 0, -1):  # [a.b], or [a]
        head = rf"^\s*\[+\s*{re.escape('.'.join(keys[:depth]))}\s*\]+"
        hits = [number for number, line in enumerate(lines) if re.match(head, line)]
        if wanted < len(hits):
            start, keys = hits[wanted], keys[depth:]
            break
    for key in reversed(keys):
        for number in range(start + 1, len(lines)):
            if lines[number].lstrip().startswith("["):
                break
            if re.search(rf'(^|[\s{{,"]){re.escape(key)}"?\s*=', lines[number]):
                return number + 1
    return max(start, 0) + 1


def entry_name(place: Sequence[str | int]) -> str:
    """Return an entry's name for a message: "[[turn]] 2, angle_deg"."""
    name = ""
    for step, follows in zip(place, [*place[1:], None], strict=True):
        if isinstance(step, str):
            shown = step if name else f"[[{step}]]" if isinstance(follows, int) else f"[{step}]" if follows else step
            name += f"{', ' * bool(name)}{shown}" + (f" {follows + 1}" if isinstance(follows, int) else "")
    return name
