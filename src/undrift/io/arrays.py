"""Named arrays of a MATLAB file (extra ``formats``) as a table that a map reads. A struct field is named ``struct.field``."""

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from undrift.errors import FileFormatError, InputError
from undrift.io.column_map import Column, ColumnMap, native_map
from undrift.io.columns import RawTable
from undrift.io.isolated import Parsed, library, read_isolated

Arrays = tuple[tuple[str, NDArray[Any]], ...]


def mat_arrays(path: Path) -> Arrays:
    """Return the numeric arrays of a MAT file, structs laid flat: ``struct.field``."""
    return tuple(read_isolated(Path(path), "mat").table.items())


def read_mat(path: Path, how: ColumnMap) -> RawTable:
    """Read the arrays of a MAT file, version 5 to 7.3."""
    arrays = mat_arrays(path)
    own = None if how.columns else native_map(tuple(name for name, _ in arrays), how, source=str(path))
    return replace(table_of_arrays(arrays, path, (own or how).wanted()), own=own)


def table_of_arrays(arrays: Arrays, path: str | Path, wanted: tuple[Column, ...]) -> RawTable:
    """Return the arrays that are as long as the first array of `wanted`, as a table. An array (N, K) becomes K columns
    ``name[0]`` ... .
    """
    lengths = {name: len(array) for name, array in arrays if array.ndim in (1, 2)}
    lengths |= {f"{name}[{k}]": len(array) for name, array in arrays if array.ndim == 2 for k in range(array.shape[1])}
    listed = ", ".join(f"{name} {array.shape}" for name, array in arrays[:16]) or "no arrays"
    for column in wanted:
        if column not in lengths:
            raise InputError(f"{path}: expected array {column!r}, got {listed}. Check the mapping.")
    rows = {str(column): lengths[str(column)] for column in wanted}
    if len(set(rows.values())) != 1:
        row_counts = ", ".join(f"{name} {count}" for name, count in rows.items())
        raise InputError(
            f"{path}: expected arrays of one length, got {row_counts} rows. Read arrays with different "
            f"clocks into separate records."
        )
    length = next(iter(rows.values()))
    columns: dict[str, NDArray[Any]] = {}
    for name, array in arrays:
        if array.ndim in (1, 2) and len(array) == length:
            columns |= (
                {name: array} if array.ndim == 1 else {f"{name}[{k}]": array[:, k] for k in range(array.shape[1])}
            )
    return RawTable(source=str(path), names=tuple(columns), columns=tuple(columns.values()))


def parse_mat(path: Path, **_: Any) -> Parsed:
    with warnings.catch_warnings(action="ignore"):
        tree = dict(library("pymatreader").read_mat(str(path)))
    objects, arrays = tree.pop("None", None), dict(_flat("", tree))
    if objects is not None and not arrays:  # objects of classes, which no reader of the file takes apart
        raise FileFormatError(
            f"{path}: expected arrays, got MATLAB objects, such as the timetables of MATLAB Mobile. In MATLAB, "
            f"write each as text, "
            'for example writetimetable(Acceleration, "Acceleration.csv"), and read the text files.'
        )
    return Parsed(table=arrays)


def _flat(prefix: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            if not str(name).startswith(("__", "#")):
                yield from _flat(f"{prefix}.{name}" if prefix else str(name), inner)
        return
    array = np.asarray(value) if isinstance(value, (np.ndarray, int, float)) else np.empty(0, dtype=object)
    if array.dtype.kind in "fiub":
        array = np.atleast_1d(array.squeeze() if array.ndim == 2 and 1 in array.shape else array)
        # axes by rows, as MATLAB code often has them, are turned; rotation matrices (3, 3, N) become rows of nine
        if array.ndim == 3 and array.shape[:2] == (3, 3):
            array = np.moveaxis(array, 2, 0).reshape(-1, 9)
        by_rows = array.ndim == 2 and array.shape[0] in (3, 4, 6) and array.shape[1] >= 16
        yield prefix, array.T if by_rows else array
