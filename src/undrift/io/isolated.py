"""A library's parser in a process of its own: a damaged file may crash it or keep it waiting, and then there is one error.

``python -m undrift.io.isolated KIND FILE OUT.npz OPTIONS`` reads FILE with ``libraries.KINDS[KIND]`` and writes an npz file.
"""

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from undrift.errors import FileFormatError, InputError
from undrift.files import checked_file, first_line
from undrift.io.columns import ReadSettings

TIMEOUT_S, SECOND_PER_MEGABYTE = 120.0, 1.0
Channels = dict[str, tuple[Any, str]]


@dataclass(kw_only=True)
class Parsed:
    """What a library found in a file; arrays and plain values only."""

    time: Any = None  # (N,), s
    channels: Channels = field(default_factory=dict)  # (N,) or (N, 3), and the unit
    table: dict[str, Any] = field(default_factory=dict)  # arrays by name, for a map
    notes: list[str] = field(default_factory=list)
    about: dict[str, Any] = field(default_factory=dict)  # device, frame, state


def read_isolated(path: Path, kind: str, settings: ReadSettings | None = None, *, mapped: bool = False) -> Parsed:
    """Return what a library finds in a file, read in a process of its own."""
    path = path if path.is_dir() else checked_file(path)
    limit_s = TIMEOUT_S + SECOND_PER_MEGABYTE * path.stat().st_size / 1e6
    options = {
        "sensor": settings and settings.sensor,
        "drop": bool(settings and settings.drop_bad_rows),
        "mapped": mapped,
    }
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.npz"
        words = [sys.executable, "-m", "undrift.io.isolated", kind, str(path.resolve()), str(out), json.dumps(options)]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        try:
            done = subprocess.run(words, env=environment, capture_output=True, timeout=limit_s, check=False)
        except subprocess.TimeoutExpired as error:
            raise FileFormatError(
                f"{path}: the parser did not end within {limit_s:.0f} s; copy the file again"
            ) from error
        if not out.is_file():
            raise FileFormatError(f"{path}: the parser crashed (exit code {done.returncode}); copy the file again")
        with np.load(out, allow_pickle=False) as held:
            tree, arrays = json.loads(str(held["tree"])), {name: held[name] for name in held.files}
    if "error" in tree:
        kinds = {"InputError": InputError, "FileFormatError": FileFormatError}
        numbers = {key: tuple(value) if isinstance(value, list) else value for key, value in tree["numbers"].items()}
        raise kinds.get(tree["error"], FileFormatError)(tree["text"].replace(str(path.resolve()), str(path)), **numbers)
    return Parsed(
        time=arrays.get("time"),
        channels={name: (arrays[f"c{k}"], unit) for k, (name, unit) in enumerate(tree["channels"])},
        table={name: arrays[f"t{k}"] for k, name in enumerate(tree["table"])},
        notes=tree["notes"],
        about=tree["about"],
    )


def answer(kind: str, path: Path, out: Path, options: str) -> None:
    """Read a file and write what was found, or the error, as npz."""
    from undrift.io.libraries import KINDS

    arrays: dict[str, Any] = {}
    try:
        found = KINDS[kind](path, **json.loads(options))
        units = [(name, unit) for name, (_, unit) in found.channels.items()]
        tree: dict[str, Any] = {
            "channels": units,
            "table": list(found.table),
            "notes": found.notes,
            "about": found.about,
        }
        arrays = {f"c{k}": values for k, (values, _) in enumerate(found.channels.values())}
        arrays |= {f"t{k}": values for k, values in enumerate(found.table.values())}
        arrays |= {} if found.time is None else {"time": found.time}
    except InputError as error:
        text = str(error) if str(error).startswith(str(path)) else f"{path}: {error}"
        tree = {"error": type(error).__name__, "text": text, "numbers": error.numbers}
    except Exception as error:  # noqa: BLE001 - a library may raise anything on a damaged file
        why = f"{type(error).__name__}: {first_line(error)}"
        tree = {
            "error": "FileFormatError",
            "text": f"{path}: damaged or cut file ({why}); copy it again",
            "numbers": {},
        }
    np.savez(out, tree=json.dumps(tree), **arrays)


if __name__ == "__main__":
    answer(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4])
