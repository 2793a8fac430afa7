"""Run the parser of a library in a new process. If a damaged file crashes or blocks the parser, the result is one error.

The process writes its result, or the error, to its standard output as a pickle, which only its parent reads.
"""

import json
import os
import pickle
import subprocess
import sys
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from undrift.errors import FileFormatError, InputError
from undrift.files import checked_file, first_line
from undrift.io.column_map import READ_SETTINGS, ColumnMap

TIMEOUT_S, SECOND_PER_MEGABYTE = 120.0, 1.0
Channels = dict[str, tuple[Any, str]]


@dataclass(kw_only=True)
class Parsed:
    """Result of a library's parser."""

    time: Any = None  # (N,), s
    channels: Channels = field(default_factory=dict)  # (N,) or (N, 3), and the unit
    table: dict[str, Any] = field(default_factory=dict)  # arrays by name, for a map
    notes: list[str] = field(default_factory=list)
    about: dict[str, Any] = field(default_factory=dict)  # device, frame, state


def read_isolated(path: Path, kind: str, how: ColumnMap = READ_SETTINGS) -> Parsed:
    """Parse a file with a library in a separate process."""
    path = path if path.is_dir() else checked_file(path)
    limit_s = TIMEOUT_S + SECOND_PER_MEGABYTE * path.stat().st_size / 1e6
    options = json.dumps({"sensor": how.sensor, "drop": how.drop_bad_rows, "mapped": how.columns is not None})
    argv = [sys.executable, "-c", "from undrift.io.isolated import answer; answer()", kind, str(path), options]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        done = subprocess.run(argv, env=environment, capture_output=True, timeout=limit_s, check=False)
    except subprocess.TimeoutExpired as error:
        raise FileFormatError(
            f"{path}: the parser did not finish within {limit_s:.0f} s. Copy the file again."
        ) from error
    if done.returncode:
        raise FileFormatError(f"{path}: the parser crashed (exit code {done.returncode}). Copy the file again.")
    parsed: Parsed | InputError = pickle.loads(done.stdout)
    if isinstance(parsed, InputError):
        raise parsed
    return parsed


def library(module: str) -> Any:
    """Return a library of the extra ``formats``."""
    try:
        return import_module(module)
    except ImportError as error:
        name = module.split(".")[0]
        raise InputError(f"the library {name} is required to read it. Run pip install 'undrift[formats]'.") from error


def parse(path: Path, kind: str, options: dict[str, Any]) -> Parsed | InputError:
    """Parse a file with a library in this process. Return the result or the error."""
    from undrift.io.libraries import KINDS

    try:
        return KINDS[kind](path, **options)
    except InputError as error:
        text = str(error)
        return type(error)(text if text.startswith(str(path)) else f"{path}: {text}", **error.numbers)
    except Exception as error:  # noqa: BLE001 - a library may raise anything on a damaged file
        why = f"{type(error).__name__}: {first_line(error)}"
        return FileFormatError(f"{path}: the file is damaged or truncated ({why}). Copy it again.")


def answer() -> None:
    """Parse the file named on the command line, and write the result to standard output."""
    stdout = os.dup(1)
    os.dup2(2, 1)  # what libraries print is not the answer
    kind, path, options = sys.argv[1:]
    with os.fdopen(stdout, "wb") as stream:
        pickle.dump(parse(Path(path), kind, json.loads(options)), stream)
