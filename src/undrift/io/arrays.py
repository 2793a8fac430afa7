"""Files of named arrays: npz and mat as tables, and HDF5.

An array of shape (N,) is one column under its name; one of shape (N, K) is K columns ``name[0]`` ... . Fields of a MATLAB
struct are ``struct.field``. An array of 3 or 4 rows and 16 columns or more has time along its columns: it is turned.
Arrays of other lengths (a second clock, settings) are left out of the table.
"""

import hashlib
import json
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import checked_file, first_line, read_bytes
from undrift.io.box import boxed, load
from undrift.io.columns import (
    READ_SETTINGS,
    Column,
    ColumnMap,
    RawTable,
    ReadResult,
    ReadSettings,
    build_record,
    native_map,
    stated,
)


@contextmanager
def open_hdf5(path: str | Path) -> Iterator[Any]:
    """Open an HDF5 file for reading."""
    path = checked_file(path)
    h5py = load("h5py", path)
    try:
        handle = h5py.File(path, "r")
    except OSError as error:
        raise FileFormatError(
            f"{path}: wanted an HDF5 file, got something else or a cut one; {first_line(error)}"
        ) from error
    with handle:
        yield handle


@boxed("h5py")
def hdf5_names(path: str | Path) -> dict[str, bool]:
    """Return the names in an HDF5 file, and whether MATLAB wrote each."""
    with open_hdf5(path) as held:
        return {name: "MATLAB_class" in held[name].attrs for name in held}


def read_array(handle: Any, name: str, path: Path) -> FloatArray:
    """Return one dataset as float64."""
    if name not in handle:
        held = ", ".join(sorted(handle.keys())) or "nothing"
        raise FileFormatError(f"{path}: wanted dataset {name}, got {held}; check that this is the right kind of file")
    try:
        return np.asarray(handle[name][()], dtype=np.float64)
    except (OSError, TypeError, ValueError, AttributeError) as error:
        raise FileFormatError(f"{path}: {name}: wanted readable numbers, got an error: {first_line(error)}") from error


# ---- npz and mat

Arrays = tuple[tuple[str, NDArray[Any]], ...]
_ROWS = 16  # fewer columns than these are no recording


@boxed()
def read_npz(path: str | Path, columns: ColumnMap | None = None, settings: ReadSettings = READ_SETTINGS) -> ReadResult:
    """Read a record from a numpy .npz file."""
    return _record(npz_arrays(path), path, columns, settings)


@boxed("pymatreader")
def read_mat(path: str | Path, columns: ColumnMap | None = None, settings: ReadSettings = READ_SETTINGS) -> ReadResult:
    """Read a record from a MATLAB .mat file, version 5 to 7.3; one that undrift wrote states frame, state and device."""
    held = mat_tree(checked_file(path))
    arrays = tuple(_flat("", held))
    if columns is None and isinstance(held.get("undrift"), str):
        columns = native_map(tuple(name for name, _ in arrays), settings, source=str(path))
        try:
            statement = dict(json.loads(held["undrift"]))
        except (ValueError, TypeError, RecursionError):
            statement = {}
        digest = held.get("undrift_sha256")
        if digest is not None and digest != digest_of(
            held["undrift"], {n: a for n, a in arrays if n in statement.get("columns", ())}
        ):
            raise FileFormatError(
                f"{path}: wanted the readings as they were written, got others (sha256); restore the file"
            )
        columns = stated(columns, statement, f"{path}: wanted frame, state and device in 'undrift', got others")
    return _record(arrays, path, columns, settings)


def digest_of(statement: str, columns: Mapping[str, NDArray[Any]]) -> str:
    """Return the sha256 of a statement and of columns of numbers with their names, however they lie."""
    digest = hashlib.sha256(statement.encode())
    for name in sorted(columns):
        digest.update(name.encode() + np.ascontiguousarray(columns[name], dtype="<f8").tobytes())
    return digest.hexdigest()


def _record(arrays: Arrays, path: str | Path, columns: ColumnMap | None, settings: ReadSettings) -> ReadResult:
    columns = columns or native_map(tuple(name for name, _ in arrays), settings, source=str(path))
    return build_record(table_of_arrays(arrays, path, columns.wanted()), columns)


@boxed()
def npz_arrays(path: str | Path) -> Arrays:
    """Return the arrays of an npz file."""
    path = checked_file(path)
    try:
        with path.open("rb") as raw:
            held = np.load(raw, allow_pickle=False)
            if isinstance(held, np.lib.npyio.NpzFile):
                return tuple((name, _upright(held[name])) for name in held.files)
    except (OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise FileFormatError(f"{path}: wanted a sound npz file of plain arrays, got {first_line(error)}") from error
    raise FileFormatError(f"{path}: wanted an npz file of named arrays, got a single array; save with np.savez")


@boxed("pymatreader")
def mat_arrays(path: str | Path) -> Arrays:
    """Return the numeric arrays of a MAT file, structs laid flat."""
    return tuple(_flat("", mat_tree(checked_file(path))))


def mat_tree(path: Path) -> dict[str, Any]:
    """Return what a MAT file holds, structs as dicts and cells as lists, for readers in a box."""
    library = load("pymatreader", path)
    try:
        with warnings.catch_warnings(action="ignore"):
            held = dict(library.read_mat(str(path)))
    except Exception as error:
        raise FileFormatError(
            f"{path}: wanted a MAT file, got something else or a damaged one; {first_line(error)}"
        ) from error
    objects = held.pop("None", None)  # objects of classes, which no reader of the file takes apart
    if objects is not None and not _flat("", held):
        raise FileFormatError(
            f"{path}: wanted arrays, got objects of MATLAB, such as the timetables of MATLAB Mobile; write each as text there, "
            'writetimetable(Acceleration, "Acceleration.csv") and AngularVelocity alike, and give both files'
        )
    return held


@boxed("scipy.io")
def mat_names(path: str | Path) -> set[str]:
    """Return the names of the arrays of a MAT file; none where it is damaged."""
    from scipy.io import whosmat

    try:
        if read_bytes(path, 10) == b"MATLAB 7.3":
            return set(hdf5_names(path))
        return {name for name, _, _ in whosmat(str(path))}
    except Exception:  # noqa: BLE001 - what reads the file says what is wrong with it
        return set()


def table_of_arrays(arrays: Arrays, path: str | Path, wanted: tuple[Column, ...]) -> RawTable:
    """Return the arrays that are as long as the first wanted one, as a table."""
    lengths = {name: len(array) for name, array in arrays if array.ndim in (1, 2)}
    lengths |= {f"{name}[{k}]": len(array) for name, array in arrays if array.ndim == 2 for k in range(array.shape[1])}
    held = ", ".join(f"{name} {array.shape}" for name, array in arrays[:16]) or "no arrays"
    for column in wanted:
        if column not in lengths:
            raise InputError(f"{path}: wanted array {column!r}, got {held}; check the mapping")
    rows = {str(column): lengths[str(column)] for column in wanted}
    if len(set(rows.values())) != 1:
        shown = ", ".join(f"{name} {count}" for name, count in rows.items())
        raise InputError(f"{path}: wanted arrays of one length, got {shown} rows; two clocks need two records")
    length = next(iter(rows.values()))
    found: dict[str, NDArray[Any]] = {}
    for name, array in arrays:
        if array.ndim in (1, 2) and len(array) == length:
            found |= {name: array} if array.ndim == 1 else {f"{name}[{k}]": array[:, k] for k in range(array.shape[1])}
    return RawTable(source=str(path), names=tuple(found), columns=tuple(found.values()))


def _flat(prefix: str, value: Any) -> list[tuple[str, NDArray[Any]]]:
    if isinstance(value, dict):
        return [
            pair
            for name, inner in value.items()
            if not str(name).startswith(("__", "#"))
            for pair in _flat(f"{prefix}.{name}" if prefix else str(name), inner)
        ]
    array = np.asarray(value) if isinstance(value, (np.ndarray, int, float)) else np.empty(0, dtype=object)
    if array.dtype.kind not in "fiub":
        return []
    return [(prefix, np.atleast_1d(array.squeeze() if array.ndim == 2 and 1 in array.shape else _upright(array)))]


def _upright(array: NDArray[Any]) -> NDArray[Any]:
    """Return x, y, z (or w, x, y, z) by columns, as MATLAB code often has them by rows."""
    return array.T if array.ndim == 2 and array.shape[0] in (3, 4) and array.shape[1] >= _ROWS else array
