"""Files of named arrays, npz and mat, as tables.

An array of shape (N,) is one column under its name; one of shape (N, K) is K columns ``name[0]`` ... . Fields of a MATLAB
struct are ``struct.field``. Arrays of other lengths (a second clock, settings) are left out of the table.
"""

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from undrift.errors import FileFormatError, InputError
from undrift.io.build import build_record
from undrift.io.columns import Column, ColumnMap, Gaps, native_map
from undrift.io.files import checked_file
from undrift.io.table import Table
from undrift.record import Record

Arrays = tuple[tuple[str, NDArray[Any]], ...]


def read_npz(
    path: str | Path, columns: ColumnMap | None = None, *, sample_rate_hz: float | None = None, gaps: Gaps = "raise"
) -> Record:
    """Read a record from a numpy .npz file.

    Parameters
    ----------
    path : str or Path
        The file.
    columns : ColumnMap or None
        Array names; a channel of shape (N, 3) is one name: gyro=("gyro_raw",). None for undrift's own names.
    sample_rate_hz : float or None
        Hz, for undrift's own names without time_s.
    gaps : str
        For undrift's own names: "raise" or "keep".

    Returns
    -------
    Record
        Readings.

    Raises
    ------
    InputError
        No such file or array, arrays of different lengths, NaN, time that goes back.
    FileFormatError
        Not an npz file, a damaged one, or one that holds Python objects.
    """
    return record_of_arrays(npz_arrays(path), Path(path), columns, sample_rate_hz=sample_rate_hz, gaps=gaps)


def read_mat(
    path: str | Path, columns: ColumnMap | None = None, *, sample_rate_hz: float | None = None, gaps: Gaps = "raise"
) -> Record:
    """Read a record from a MATLAB .mat file, version 5 to 7.3.

    Parameters
    ----------
    path : str or Path
        The file.
    columns : ColumnMap or None
        Variable names; fields of a struct as "struct.field". None for undrift's own names.
    sample_rate_hz : float or None
        Hz, for undrift's own names without time_s.
    gaps : str
        For undrift's own names: "raise" or "keep".

    Returns
    -------
    Record
        Readings.

    Raises
    ------
    InputError
        No such file or variable, variables of different lengths, NaN, time that goes back.
    FileFormatError
        Not a MAT file, or a damaged one.
    """
    return record_of_arrays(mat_arrays(path), Path(path), columns, sample_rate_hz=sample_rate_hz, gaps=gaps)


def npz_arrays(path: str | Path) -> Arrays:
    """Return the arrays of an npz file.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    tuple of (str, array)
        Name and array, as stored.

    Raises
    ------
    FileFormatError
        Not an npz file, a damaged one, or one that holds Python objects.
    """
    path = checked_file(path)
    try:
        with path.open("rb") as raw:
            held = np.load(raw, allow_pickle=False)
            if isinstance(held, np.lib.npyio.NpzFile):
                return tuple((name, held[name]) for name in held.files)
    except (OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error) as error:
        raise FileFormatError(f"{path}: wanted a sound npz file of plain arrays, got {_first(error)}") from error
    raise FileFormatError(f"{path}: wanted an npz file of named arrays, got a single array; save with np.savez")


def mat_arrays(path: str | Path) -> Arrays:
    """Return the numeric arrays of a MAT file, structs laid flat.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    tuple of (str, array)
        Name and array; vectors as (N,).

    Raises
    ------
    InputError
        The reader is not installed.
    FileFormatError
        Not a MAT file, or a damaged one.
    """
    path = checked_file(path)
    try:
        from pymatreader import read_mat as load
    except ImportError as error:  # pragma: no cover - the io extra is installed where the tests run
        raise InputError(f"{path}: MAT files need pymatreader; install undrift[io]") from error
    try:
        held = load(str(path))
    except Exception as error:
        raise FileFormatError(
            f"{path}: wanted a MAT file, got something else or a damaged one; {_first(error)}"
        ) from error
    return tuple(_flat("", held))


def record_of_arrays(
    arrays: Arrays, path: Path, columns: ColumnMap | None, *, sample_rate_hz: float | None = None, gaps: Gaps = "raise"
) -> Record:
    """Return the record that named arrays hold.

    Parameters
    ----------
    arrays : tuple of (str, array)
        From :func:`npz_arrays` or :func:`mat_arrays`.
    path : Path
        For the errors.
    columns : ColumnMap or None
        None for undrift's own names.
    sample_rate_hz : float or None
        Hz.
    gaps : str
        "raise" or "keep", for undrift's own names.

    Returns
    -------
    Record
        Readings.

    Raises
    ------
    InputError
        As :func:`read_npz`.
    """
    from dataclasses import replace

    if columns is None:
        try:
            columns = replace(native_map(_columns_of(arrays), sample_rate_hz=sample_rate_hz), gaps=gaps)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
    wanted = tuple(column for channel in columns.mapped() for column in columns.columns_of(channel))
    return build_record(table_of_arrays(arrays, path, wanted), columns)


def table_of_arrays(arrays: Arrays, path: Path, wanted: tuple[Column, ...]) -> Table:
    """Return the arrays that are as long as the first wanted one, as a table.

    Parameters
    ----------
    arrays : tuple of (str, array)
        Named arrays.
    path : Path
        For the errors.
    wanted : tuple of str or int
        Column or array names; positions have no meaning here.

    Returns
    -------
    Table
        Columns of one length.

    Raises
    ------
    InputError
        No such array, or wanted arrays of different lengths.
    """
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
    names: list[str] = []
    columns: list[NDArray[Any]] = []
    for name, array in arrays:
        if array.ndim == 1 and len(array) == length:
            names.append(name)
            columns.append(array)
        elif array.ndim == 2 and len(array) == length:
            names += [f"{name}[{k}]" for k in range(array.shape[1])]
            columns += [array[:, k] for k in range(array.shape[1])]
    return Table(source=str(path), names=tuple(names), columns=tuple(columns))


def _columns_of(arrays: Arrays) -> tuple[str, ...]:
    return tuple(name for name, _ in arrays)


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
    return [(prefix, np.atleast_1d(array.squeeze() if array.ndim == 2 and 1 in array.shape else array))]


def _first(error: BaseException) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
