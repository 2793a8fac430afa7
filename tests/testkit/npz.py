"""Recordings that are kept as numpy arrays."""

import numpy as np

from undrift.io.arrays import table_of_arrays
from undrift.io.columns import build_record


def read_npz(path, columns):
    """Return the record of the arrays of an npz file, through a map."""
    with np.load(path) as held:
        arrays = tuple((name, held[name]) for name in held.files)
    return build_record(table_of_arrays(arrays, path, columns.wanted()), columns).record
