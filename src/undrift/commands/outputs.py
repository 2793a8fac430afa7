"""Outputs of commands. They are checked before the work begins, so that a wrong name does not waste time or overwrite files."""

import json
import shlex
from collections.abc import Iterable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

from undrift.base.options import WRITTEN
from undrift.base.spoken import CALLED
from undrift.commands.files import names_in
from undrift.errors import InputError
from undrift.files import sha256_of, write_whole
from undrift.io.session import NAME
from undrift.report.page import Origin, write_report
from undrift.report.report import Report, as_json, plain


def check_output(
    path: Path | None, *, endings: tuple[str, ...], reads: Iterable[Path | None] = (), beside: Iterable[Path] = ()
) -> None:
    """Raise for an output with an unsuitable ending, in a missing folder, or equal to an input or its JSON file."""
    if path is None:
        return
    if not path.name.lower().endswith(endings):
        either = endings[0] if len(endings) == 1 else ", ".join(endings[:-1]) + " or " + endings[-1]
        raise InputError(f"{path}: expected a name ending in {either}. Change the ending.")
    if path.is_dir():
        raise InputError(f"{path}: expected the name of a file to write, got a folder. Add the name of a file.")
    _check_parent(path)
    inputs = [read for read in reads if read is not None]
    for file in (path, *beside):
        if file.exists() and any(_holds(read, file) for read in inputs):
            raise InputError(f"{file}: this file is an input and cannot be written. Choose another name.")


def check_folder(path: Path | None) -> None:
    """Raise for a folder that cannot be written to, and cannot be created in an existing folder."""
    if path is None or path.is_dir():
        return
    if path.exists():
        raise InputError(f"{path}: expected a folder to write to, got a file with this name. Choose another name.")
    _check_parent(path)


def _check_parent(path: Path) -> None:
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist. Create it first.")


def _holds(read: Path, target: Path) -> bool:
    """Return True if a file is the input, or inside the input folder."""
    if not read.is_dir():
        return read.exists() and target.samefile(read)
    if (read / NAME).is_file():
        names = [NAME, *(name for names_of_record in names_in(read) for name in names_of_record)]
    else:
        names = [file.name for file in read.iterdir()]  # files of a device that records into a folder
    return any((read / name).exists() and target.samefile(read / name) for name in names)


def name_of(path: Path) -> str:
    """Return a recording's name without its endings, for rows and files: walk.v2 for walk.v2.csv.gz."""
    name = path.resolve().name if path.name in ("", "..") else path.name
    for ending in (".gz", ".csv", ".txt", ".log", ".parquet", ".npz", ".mat", ".hdf5", ".h5", ".tsv"):
        if len(name) > len(ending):
            name = name.removesuffix(ending)
    return name


def files_in(value: object) -> Iterator[Path]:
    """Yield the files among the values of options, including the fields of settings."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from files_in(item)
    elif is_dataclass(value):
        for item in fields(value):
            if WRITTEN not in getattr(item.type, "__metadata__", ()):
                yield from files_in(getattr(value, item.name))


def origin_of(*read: Path | None) -> Origin:
    """Return the origin of a page: the command, and its files with their sha256, including each file of a folder."""
    paths = [path for path in read if path is not None and path.exists()]
    files = {
        file: str(file.relative_to(path.parent)) if path.is_dir() else path.name
        for path in paths
        for file in (sorted(path.rglob("*")) if path.is_dir() else (path,))
        if file.is_file()
    }
    inputs = tuple((name, sha256_of(file)) for file, name in files.items())
    return Origin(command=shlex.join(("undrift", *CALLED.get())), inputs=inputs)


def write_results(folder: Path, report: Report, command: str, origin: Origin, *, name: str = "summary.json") -> None:
    """Write the report of a command into a folder, as JSON and as a page."""
    text = json.dumps(plain(as_json(report, command)), indent=1, allow_nan=False)
    write_whole(folder / name, text + "\n")
    write_report(folder / "report.html", report, origin)
