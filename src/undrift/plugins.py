"""Registries: plain tables from a name to the location of an object, "package.module:object", which is imported on demand.

Another package adds a row with an entry point, without any change to undrift::

    [project.entry-points."undrift.rigs"]
    lathe = "my_package.lathe:open_from"

The rows of undrift come first, so that no other package can replace them.
"""

import importlib
from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from typing import Any
from urllib.parse import parse_qsl

from undrift.errors import InputError

Options = tuple[tuple[str, str], ...]
Types = Mapping[str, Callable[[str], Any]]  # function that converts the text of an option, by name


def names_in(table: Mapping[str, object], group: str) -> tuple[str, ...]:
    """Return all names of a table and of the entry-point group that extends it."""
    return (*table, *(point.name for point in entry_points(group=group) if point.name not in table))


def load_named(name: str, table: Mapping[str, str], group: str, kind: type = object) -> Any:
    """Import and return the object with the given name and type. Raise KeyError if table and entry points lack the name."""
    place = table.get(name) or {point.name: point.value for point in entry_points(group=group)}[name]
    module, _, attribute = place.partition(":")
    try:
        target = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise InputError(f"{name}: expected {place}, got '{error}'. Install the package that provides it.") from error
    if not isinstance(target, kind):
        raise InputError(
            f"{name}: expected a {kind.__name__} from {place}, got {type(target).__name__}. Correct the entry point of the group "
            f"{group}."
        )
    return target


def split_address(text: str, what: str, kinds: tuple[str, ...], advice: str) -> tuple[str, str, Options]:
    """Split ``kind:place?name=value&name=value``. The kind must be one of those accepted."""
    kind, colon, rest = text.partition(":")
    if not colon or kind not in kinds:
        listing = ", ".join(f"{name}:..." for name in kinds)
        raise InputError(f"{what}: expected one of {listing}, got '{text}'. {advice}.")
    place, _, query = rest.partition("?")
    try:
        return kind, place, tuple(parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query)))
    except ValueError as error:
        raise InputError(
            f"{what}: expected options as name=value&name=value, got '{query}'. Correct the address."
        ) from error


def typed_options(options: Options, types: Types, what: str) -> dict[str, Any]:
    """Return the options of an address by name, converted to their types."""
    values = dict[str, Any]()
    for name, text in options:
        if name not in types:
            raise InputError(f"{what}: unknown option '{name}' in the address. Use one of {', '.join(types)}.")
        try:
            values[name] = types[name](text)
        except ValueError as error:
            raise InputError(f"{what}: '{text}' is not a value for {name}. Correct the address.") from error
    return values
