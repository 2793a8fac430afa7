"""HDF5 files, opened with one clear line when they cannot be."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.io.files import checked_file


@contextmanager
def open_hdf5(path: str | Path) -> Iterator[Any]:
    """Open an HDF5 file for reading.

    Parameters
    ----------
    path : str or Path
        The file.

    Yields
    ------
    h5py.File
        Open for the length of the with block.

    Raises
    ------
    InputError
        No such file, or h5py is not installed.
    FileFormatError
        Not an HDF5 file, or a damaged one.
    """
    path = checked_file(path)
    try:
        import h5py
    except ImportError as error:  # pragma: no cover - the io extra is installed where the tests run
        raise InputError(f"{path}: HDF5 needs h5py; install undrift[io]") from error
    try:
        handle = h5py.File(path, "r")
    except OSError as error:
        raise FileFormatError(
            f"{path}: wanted an HDF5 file, got something else or a cut one; {_first(error)}"
        ) from error
    with handle:
        yield handle


def read_array(handle: Any, name: str, path: Path) -> FloatArray:
    """Return one dataset as float64.

    Parameters
    ----------
    handle : h5py.File or h5py.Group
        Where it is.
    name : str
        Dataset.
    path : Path
        For the error.

    Returns
    -------
    array
        Values as stored.

    Raises
    ------
    FileFormatError
        No such dataset, or not numbers.
    """
    if name not in handle:
        held = ", ".join(sorted(handle.keys())) or "nothing"
        raise FileFormatError(f"{path}: wanted dataset {name}, got {held}; check that this is the right kind of file")
    try:
        return np.asarray(handle[name][()], dtype=np.float64)
    except (OSError, TypeError, ValueError, AttributeError) as error:
        raise FileFormatError(f"{path}: {name}: wanted readable numbers, got an error: {_first(error)}") from error


def _first(error: BaseException) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
