"""TOML files checked against a model; errors name the line and the entry."""

import re
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from undrift.errors import FileFormatError
from undrift.io.files import read_bytes


class Entry(BaseModel):
    """A TOML table: unknown keys are an error, and nothing is converted on the quiet."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


Model = TypeVar("Model", bound=BaseModel)


def read_toml(path: str | Path, model: type[Model]) -> Model:
    """Read a TOML file into a model.

    Parameters
    ----------
    path : str or Path
        The file.
    model : type
        Pydantic model of the whole file.

    Returns
    -------
    Model
        Checked values.

    Raises
    ------
    InputError
        No such file.
    FileFormatError
        Not TOML, an unknown key, a missing key, or a value of the wrong kind; names line and entry.
    """
    path = Path(path)
    try:
        text = read_bytes(path).decode("utf-8")
        held = tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise FileFormatError(
            f"{path}: wanted UTF-8 text, got other bytes at {error.start}; save the file as UTF-8"
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(f"{path}: wanted TOML, got a line that is not: {error}") from error
    try:
        return model.model_validate(held)
    except ValidationError as error:
        raise FileFormatError(f"{path}: {_explained(error, text)}") from error


def line_of(text: str, place: tuple[Any, ...]) -> int:
    """Return the line of an entry in a TOML text.

    Parameters
    ----------
    text : str
        The file.
    place : tuple
        Keys and positions, as ("still", 1, "face").

    Returns
    -------
    int
        Line from 1: of the key, else of its table, else 1.
    """
    lines, start, keys = text.splitlines(), -1, [part for part in place if isinstance(part, str)]
    if keys:
        head = rf"^\s*\[+\s*{re.escape(keys[0])}\s*\]+"
        hits = [number for number, line in enumerate(lines) if re.match(head, line)]
        wanted = place[1] if len(place) > 1 and isinstance(place[1], int) else 0
        if wanted < len(hits):
            start, keys = hits[wanted], keys[1:]
    for key in reversed(keys):
        for number in range(start + 1, len(lines)):
            if lines[number].lstrip().startswith("["):
                break
            if re.search(rf'(^|[\s{{,"]){re.escape(key)}"?\s*=', lines[number]):
                return number + 1
    return max(start, 0) + 1


def entry_name(place: tuple[Any, ...]) -> str:
    """Return an entry's name as a person says it.

    Parameters
    ----------
    place : tuple
        Keys and positions, as ("still", 1, "face").

    Returns
    -------
    str
        "[[still]] 2, face".
    """
    parts: list[str] = []
    for k, part in enumerate(place):
        if isinstance(part, int):
            continue
        follows = place[k + 1] if k + 1 < len(place) else None
        number = f" {follows + 1}" if isinstance(follows, int) else ""
        parts.append(
            (f"[[{part}]]" if number and k == 0 else f"[{part}]" if k == 0 and len(place) > 1 else part) + number
        )
    return ", ".join(parts)


def _explained(error: ValidationError, text: str) -> str:
    """Say the first thing that is wrong: unknown keys first, they explain the rest."""
    problems = sorted(error.errors(), key=lambda problem: problem["type"] != "extra_forbidden")
    problem = problems[0]
    place = tuple(part for part in problem["loc"] if not _is_branch(part))
    what = {
        "extra_forbidden": "wanted a known key, got this one; check its spelling",
        "missing": "wanted this key, got none; add it",
    }.get(problem["type"], f"{_plain(problem['msg'])}, got {problem['input']!r}")
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"line {line_of(text, place)}: {entry_name(place)}: {what}{more}"


def _is_branch(part: Any) -> bool:
    """Tell pydantic's names for the branches of a union from keys of the file."""
    return isinstance(part, str) and (part in ("str", "int", "float", "bool") or "[" in part or part[:1].isupper())


def _plain(message: str) -> str:
    message = message.removeprefix("Value error, ")
    return message.replace("Input should be ", "wanted ").splitlines()[0]
