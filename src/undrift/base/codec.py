"""Codec: frozen dataclasses <-> JSON and TOML. The class is the file: no second class, no list of keys.

::

    @stored(kind="undrift.loop", format=1)
    @dataclass(frozen=True, slots=True, kw_only=True, eq=False)
    class Loop:
        temp_c: Annotated[FloatArray, Shape("n", rising=True)]
        turn_rate: Annotated[float, Key("table.turn_rate_dps", unit=RADIAN_PER_DEGREE)] = 0.0
        half_width: Annotated[FloatArray | None, Key(later=True)] = None

    write(loop, "loop.json")      {"kind": "undrift.loop", "format": 1, "temp_c": [20.0, 30.0], "table": {"turn_rate_dps": 5.0}}
    read(Loop, "loop.json")       the same value, to the last bit

This module converts value -> tree (plain dicts and lists) -> text. Reading, text -> tree -> value, uses pydantic. For
each class it checks a strict and closed table of keys (``_table_of``), then calls the class with its ``__post_init__``.
A key is required if its field has no default. In a ``whole`` class every key is required unless its mark makes it
optional.
"""

import difflib
import json
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from undrift.errors import FileFormatError, InputError
from undrift.files import MOST_TREE, read_tree, too_large, write_whole

Value = TypeVar("Value")
Result = TypeVar("Result")
Tree = dict[str, Any]
_UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")
_STRICT: Any = {"strict": True, "allow_inf_nan": False}


# ---- marks of classes and fields


@dataclass(frozen=True, slots=True, kw_only=True)
class Stored:
    """Representation of a class in a file."""

    kind: str = ""  # first key of a file of this class, "" if the file has no such key
    format: int = 1  # second key of such a file
    whole: bool = False  # True if all keys are required, except later keys
    keys: tuple[str, ...] = ()  # fields and properties in the order of the file, all fields if empty
    form: Any = None  # type that replaces the class in the file, used with ``read`` and ``write``
    read: Callable[[Any], Any] | None = None  # converts the checked keys, or the form, to the value
    write: Callable[[Any], Any] | None = None  # converts the value to its tree
    complete: Callable[[Tree], Tree] | None = None  # adds the implied keys to the tree of a file


@dataclass(frozen=True, slots=True)
class Key:
    """Mark of an annotated field: the key and the type of the field in a file."""

    path: str = ""  # key with its tables, as in "units.gyro", or "" for the name of the field
    unit: float = 1.0  # SI value of a unit of the file
    optional: bool = False  # True if the key is optional even in a whole class
    needed: bool = False  # True if the key is required when its table is present
    later: bool = False  # True if the key is optional and written only if it differs from the default
    form: Any = None  # type in the file, if it differs


@dataclass(frozen=True, slots=True)
class Number:
    """Mark of a float that may be NaN (null in a file) or infinite ("inf" or "-inf" in a file)."""

    infinite: bool = True

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema as cs

        schemas: list[Any] = [cs.float_schema(), cs.none_schema()]
        schemas += [cs.literal_schema(["inf", "-inf"])] * self.infinite
        return cs.no_info_after_validator_function(
            lambda x: math.nan if x is None else float(x), cs.union_schema(schemas)
        )


@dataclass(frozen=True, slots=True)
class Pairs:
    """Mark of a tuple of pairs of str: a list of tables with two keys in a file, or one table without keys."""

    keys: tuple[str, ...] = ()

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema as cs

        if not self.keys:
            table = cs.dict_schema(cs.str_schema(), cs.str_schema())
            return cs.no_info_after_validator_function(lambda table: tuple(table.items()), table)
        keys = {name: cs.typed_dict_field(cs.str_schema()) for name in self.keys}
        row = cs.typed_dict_schema(keys, extra_behavior="forbid", config={"title": "row"})
        return cs.no_info_after_validator_function(
            lambda rows: tuple(tuple(row[name] for name in self.keys) for row in rows), cs.list_schema(row)
        )

    def tree(self, pairs: Sequence[tuple[str, str]]) -> list[Tree] | Tree:
        """Return the list of tables, or the table."""
        if self.keys:
            return [dict(zip(self.keys, pair, strict=True)) for pair in pairs]
        if len(table := dict(pairs)) != len(pairs):
            raise InputError(f"expected each name once, got a name twice in {', '.join(name for name, _ in pairs)}.")
        return table


Gap = Annotated[float, Number(infinite=False)]
AnyNumber = Annotated[float, Number()]
_STORED: dict[type, Stored] = {}


def _cached(function: Callable[[Any], Result]) -> Callable[[Any], Result]:
    """Return a function of a class that works once for each."""
    return cache(function)


def stored(**how: Any) -> Callable[[type[Value]], type[Value]]:
    """Return a decorator that registers a dataclass for reading and writing. The keywords are the fields of ``Stored``."""

    def mark(cls: type[Value]) -> type[Value]:
        _STORED[cls] = Stored(**how)
        cls.__get_pydantic_core_schema__ = classmethod(_schema_of)  # type: ignore[attr-defined]
        return cls

    return mark


@dataclass(frozen=True, slots=True, kw_only=True)
class Slot:
    """One key of a class."""

    name: str  # name of the field or property
    path: tuple[str, ...]  # keys of its tables, then its key
    hint: Any  # type in the file
    key: Key
    required: bool
    default: Any = MISSING  # default of the field, or MISSING
    given: bool = True  # True if passed to the class (a property is only written)


@_cached
def slots_of(cls: Any) -> tuple[Slot, ...]:
    """Return the keys of a class in the order of its file."""
    how, hints = _STORED[cls], get_type_hints(cls, include_extras=True)
    by_name: dict[str, Field[Any]] = {item.name: item for item in fields(cls) if item.init}
    slots = []
    for name in how.keys or by_name:
        field = by_name.get(name)
        hint = get_type_hints(getattr(cls, name).fget)["return"] if field is None else hints[name]
        marks = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
        key = next((mark for mark in marks if isinstance(mark, Key)), Key())
        default = MISSING if field is None else field.default
        if field is not None and field.default_factory is not MISSING:
            default = field.default_factory()
        required = default is MISSING or (how.whole and not (key.optional or key.later))
        slots.append(
            Slot(
                name=name,
                path=tuple((key.path or name).split(".")),
                hint=hint if key.form is None else key.form,
                key=key,
                required=required,
                default=default,
                given=field is not None,
            )
        )
    return tuple(slots)


# ---- from tree to value


@_cached
def _adapter(cls: Any) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(cls)


_BEGUN: list[type] = []  # classes under construction; a class that contains itself is referenced by name


def _schema_of(cls: type, source: Any, handler: Any) -> Any:
    """Return pydantic's schema of a class: its table of keys, then the class made of them."""
    from pydantic_core import core_schema as cs

    how, ref = _STORED[cls], f"{cls.__module__}.{cls.__qualname__}"
    if cls in _BEGUN:
        return cs.definition_reference_schema(ref)
    _BEGUN.append(cls)
    try:
        table = _table_of(cls, handler) if how.form is None else handler.generate_schema(how.form)
    finally:
        _BEGUN.pop()
    make = partial(_build, cls) if how.form is None else how.read
    about = (cls.__doc__ or "").partition("\n")[0]
    metadata = {"pydantic_js_updates": {"title": cls.__name__, "description": about}}
    return cs.no_info_after_validator_function(make, table, ref=ref, metadata=metadata)  # type: ignore[arg-type]


def _table_of(cls: type, handler: Any) -> Any:
    """Return the table of the keys of a class. Keys with a dot in their path are placed in nested tables."""
    from pydantic_core import core_schema as cs

    tables: dict[tuple[str, ...], Tree] = {(): {}}
    for key, value in _head_of(_STORED[cls]).items():
        tables[()][key] = cs.typed_dict_field(cs.literal_schema([value]))
    for slot in slots_of(cls):
        defaults = {} if slot.required or slot.default is MISSING else {"default": default_tree(slot)}
        field = cs.typed_dict_field(
            handler.generate_schema(slot.hint),
            required=slot.required or slot.key.needed,
            metadata={"pydantic_js_updates": defaults},
        )
        for depth in range(1, len(slot.path)):
            tables.setdefault(slot.path[:depth], {})
            tables[slot.path[: depth - 1]].setdefault(
                slot.path[depth - 1], None
            )  # keeps the order until it is filled in below
        tables[slot.path[:-1]][slot.path[-1]] = field
    for path in sorted(tables, key=len, reverse=True):
        schema = cs.typed_dict_schema(tables[path], extra_behavior="forbid", config=_STRICT)
        if path:
            needed = any(slot.required for slot in slots_of(cls) if slot.path[: len(path)] == path)
            tables[path[:-1]][path[-1]] = cs.typed_dict_field(schema, required=needed)
    return schema


def _head_of(how: Stored) -> Tree:
    return {"kind": how.kind, "format": how.format} if how.kind else {}


def default_tree(slot: Slot) -> Any:
    """Return the default of a key as it is written in a file."""
    return _convert(tree_of(slot.default), slot.key.unit)


def _build(cls: type[Value], table: Tree) -> Value:
    """Make a value of its checked keys."""
    how, arguments = _STORED[cls], Tree()
    for slot in slots_of(cls):
        spot: Any = table
        for name in slot.path:
            spot = MISSING if spot is MISSING else spot.get(name, MISSING)
        if spot is not MISSING and (slot.given or how.read):
            arguments[slot.name] = _scale(spot, slot.key.unit)
    return cls(**arguments) if how.read is None else how.read(arguments)


def _scale(value: Any, factor: float) -> Any:
    """Return a number, or each of several, times a factor."""
    if factor == 1.0 or value is None:
        return value
    return type(value)(_scale(item, factor) for item in value) if isinstance(value, list | tuple) else value * factor


def value_of(cls: type[Value], tree: Any, name: str, text: str = "") -> Value:
    """Return the value of a tree. Error messages use ``name``, and line numbers if the TOML text is given."""
    how = _STORED[cls]
    if how.kind:
        kind, version = (tree.get("kind"), tree.get("format")) if isinstance(tree, dict) else (None, None)
        if kind != how.kind:
            raise FileFormatError(
                f"{name}: expected kind {how.kind!r}, got {kind!r}. Use {_name_in_messages(how)} that undrift wrote."
            )
        if version != how.format or isinstance(version, bool):
            raise FileFormatError(
                f"{name}: expected format {how.format}, got {version!r}. Read it with the undrift that wrote it."
            )
    try:
        return _validate(cls, how.complete(tree) if how.complete and isinstance(tree, dict) else tree, text)
    except (Refused, InputError, OverflowError) as error:  # the last two of `complete`
        raise FileFormatError(f"{name}: {error}") from error


class Refused(ValueError):
    """Problems that pydantic found in a file. The text is the first of them, by line and entry in TOML, by key in JSON."""

    def __init__(self, problems: list[Any], known_keys: frozenset[str] = frozenset(), text: str = "") -> None:
        # a list without its bad item is not too short, and unknown keys come first because they explain the rest
        places = [problem["loc"] for problem in problems]
        real = [
            p for p in problems if p["type"] != "too_short" or not any(_within(place, p["loc"]) for place in places)
        ]
        problem = min(real, key=lambda problem: problem["type"] not in _UNKNOWN_KEY)
        place = tuple(step for step in problem["loc"] if not _is_branch(step))
        where = f"line {line_of(text, place)}: {entry_name(place)}: " if text else f"at {'.'.join(map(str, place))}: "
        remainder = f" (and {len(real) - 1} more)" if len(real) > 1 else ""
        super().__init__((where if place else "") + _what_is_wrong(problem, place, known_keys) + remainder)


def _within(place: tuple[Any, ...], outer: tuple[Any, ...]) -> bool:
    return len(place) > len(outer) and place[: len(outer)] == outer


def _what_is_wrong(problem: Tree, place: tuple[Any, ...], known_keys: frozenset[str]) -> str:
    if problem["type"] == "missing":
        return "this key is missing. Add it."
    if problem["type"] == "value_error":
        return str(problem["ctx"]["error"])
    if problem["type"] in _UNKNOWN_KEY and place:
        near = difflib.get_close_matches(str(place[-1]), sorted(known_keys - {place[-1]}), n=1, cutoff=0.7)
        return f"this key is unknown. Check its spelling{f' (nearest known key: {near[0]})' if near else ''}."
    value = repr(problem["input"])
    message = problem["msg"].replace("Input should be ", "expected ").splitlines()[0]
    return f"{message}, got {value if len(value) < 80 else value[:80] + ' ...'}"


def _validate(cls: type[Value], tree: Any, text: str = "") -> Value:
    from pydantic import ValidationError

    try:
        # as JSON: strict, and lists are tuples there
        value: Value = _adapter(cls).validate_json(json.dumps(tree, default=str))
    except ValidationError as error:
        raise Refused(list(error.errors(include_url=False)), known_keys(schema_of(cls)), text) from error
    except (OverflowError, RecursionError, TypeError) as error:
        raise Refused([{"type": "value_error", "loc": (), "msg": str(error), "ctx": {"error": error}}]) from error
    return value


def known_keys(schema: Tree) -> frozenset[str]:
    """Return the names of all keys in a JSON Schema."""
    tables = [schema, *schema.get("$defs", {}).values()]
    for table in tables:  # grows by the tables in it
        tables += [inner for inner in table.get("properties", {}).values() if "properties" in inner]
    return frozenset(key for table in tables for key in table.get("properties", ()))


def _name_in_messages(how: Stored) -> str:
    return f"a {how.kind.rpartition('.')[2]}"


def _is_branch(step: Any) -> bool:
    """Return True for pydantic's name of a union branch, and False for a key of the file."""
    return isinstance(step, str) and (
        step in ("str", "int", "float", "bool", "nullable", "none") or "[" in step or "-" in step or step[:1].isupper()
    )


# ---- from value to tree


def tree_of(value: Any) -> Any:
    """Return a value as plain dicts, lists, numbers and texts: NaN is None, infinity "inf"."""
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None if math.isnan(value) else "inf" if value > 0.0 else "-inf"
    if hasattr(value, "tolist"):
        return tree_of(value.tolist())
    if isinstance(value, Mapping):
        return {name: tree_of(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [tree_of(item) for item in value]
    write = _STORED[type(value)].write
    return tree_by_keys(value) if write is None else write(value)


def tree_by_keys(value: Any) -> Tree:
    """Return the tree of a stored value, key by key."""
    tree = _head_of(_STORED[type(value)])
    for slot in slots_of(type(value)):
        item = getattr(value, slot.name)
        if slot.key.later and (item is slot.default or (not hasattr(item, "tolist") and item == slot.default)):
            continue
        spot = tree
        for name in slot.path[:-1]:
            spot = spot.setdefault(name, {})
        spot[slot.path[-1]] = _encode(item, slot)
    return tree


def _encode(value: Any, slot: Slot) -> Any:
    if value is not None:
        for mark in get_args(slot.hint)[1:]:
            if isinstance(mark, Pairs):
                return mark.tree(value)
    return _convert(tree_of(value), slot.key.unit)


def _convert(value: Any, unit: float) -> Any:
    """Convert numbers to the unit of the file, with the fewest digits that read back the same."""
    if unit == 1.0 or value is None:
        return value
    if isinstance(value, list):
        return [_convert(item, unit) for item in value]
    short = (float(f"{value / unit:.{digits}g}") for digits in range(12, 18))
    return next((number for number in short if number * unit == value), value / unit)


# ---- files


def _is_json(cls: type, path: Path) -> bool:
    """Return True for JSON, False for TOML, from the file extension. With another extension, a class with a kind is JSON."""
    return path.suffix == ".json" or (path.suffix != ".toml" and bool(_STORED[cls].kind))


def read(cls: type[Value], path: Path | str) -> Value:
    """Read a value from a file of JSON or TOML."""
    tree, text = (json_of(Path(path), cls), "") if _is_json(cls, Path(path)) else toml_of(path)
    return value_of(cls, tree, str(path), text)


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


def json_of(path: Path, cls: type) -> Any:
    """Return the content of a JSON file. NaN and Infinity are refused."""
    if path.is_file() and path.stat().st_size > MOST_TREE:
        raise too_large(path)
    try:
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except OSError as error:
        raise FileFormatError(
            f"{path}: expected {_name_in_messages(_STORED[cls])} file, got {error.strerror}. Check the path."
        ) from error
    except (ValueError, RecursionError) as error:  # broken JSON, or text that is not UTF-8
        kind = _name_in_messages(_STORED[cls])
        raise FileFormatError(f"{path}: expected {kind} file, got no valid JSON ({error}). Check the path.") from error


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name}, which JSON cannot represent")


def write(value: Any, path: Path | str) -> None:
    """Write a value to a file of JSON or TOML, whole or not at all."""
    as_json = _is_json(type(value), Path(path))
    write_whole(Path(path), json_text(value, str(path)) if as_json else toml_text(tree_of(value)))


def json_text(value: Any, name: str) -> str:
    """Return the text of a JSON file after a check that it reads back. ``name`` is used in error messages."""
    try:
        tree = tree_of(value)
        _validate(type(value), tree)
    except Refused as refused:
        called = _name_in_messages(_STORED[type(value)])
        raise InputError(f"{name}: expected {called} that reads back, got {refused}. Correct the value.") from refused
    text = json.dumps(tree, indent=2, allow_nan=False)
    # put lists of plain values on one line, because a JSON string cannot contain a raw line break
    lists = re.compile(r"\[\n\s*([^\[\]{}]*?)\n\s*\]")
    return lists.sub(lambda found: "[" + re.sub(r"\n\s*", " ", found[1]) + "]", text) + "\n"


def toml_text(tree: Tree) -> str:
    """Return the text of a TOML file. None is omitted, and a list of tables is written as [[name]] tables."""
    import tomli_w

    tree = _without_nulls(tree)
    several = {
        name: rows for name, rows in tree.items() if isinstance(rows, list) and rows and isinstance(rows[0], dict)
    }
    parts = [_laid_out(tomli_w.dumps({name: rows for name, rows in tree.items() if name not in several}))]
    for name, tables in several.items():
        parts += [toml_block(name, table) for table in tables]
    return "\n".join(block for block in parts if block)


def toml_block(name: str, table: Tree) -> str:
    """Return the text of one of several tables: [[name]] and its keys."""
    import tomli_w

    head, _, rest = tomli_w.dumps({name: _without_nulls(table)}).partition("\n")
    return _laid_out(f"[{head}]\n{rest}")


def _laid_out(text: str) -> str:
    """Return TOML with each list on one line. Its strings contain no raw line breaks."""
    lists = re.compile(r"\[\n\s*([^\[\]]*?),?\n\s*\]")
    return lists.sub(lambda found: "[" + re.sub(r"\n\s*", " ", found[1]) + "]", text)


def _without_nulls(tree: Tree) -> Tree:
    return {
        name: _without_nulls(item) if isinstance(item, dict) else item
        for name, item in tree.items()
        if item is not None
    }


def schema_of(cls: type) -> Tree:
    """Return the JSON Schema of the files of a class."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_adapter(cls).json_schema()}


# ---- places in a text of TOML


def line_of(text: str, place: tuple[Any, ...]) -> int:
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


def entry_name(place: tuple[Any, ...]) -> str:
    """Return an entry's name for a message: "[[turn]] 2, angle_deg"."""
    parts: list[str] = []
    for k, step in enumerate(place):
        if isinstance(step, int):
            continue
        follows = place[k + 1] if k + 1 < len(place) else None
        number = f" {follows + 1}" if isinstance(follows, int) else ""
        parts.append(
            (f"[[{step}]]" if number and k == 0 else f"[{step}]" if k == 0 and len(place) > 1 else step) + number
        )
    return ", ".join(parts)
