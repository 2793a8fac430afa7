"""Columns of Arrow tables from arrays and back, by their buffers.

The conversions of pyarrow import pandas if it is installed, which takes longer than most commands do.
"""

import re
from typing import Any

import numpy as np

from undrift.arrays import FloatArray


def to_arrow(column: FloatArray, *, empty: bool = False) -> Any:
    """Return an array (N,) as an Arrow array. With ``empty``, a NaN is an empty cell."""
    import pyarrow as pa

    values, present = np.ascontiguousarray(column), None
    if empty and (gaps := np.isnan(values)).any():
        present = pa.py_buffer(np.packbits(~gaps, bitorder="little"))
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [present, pa.py_buffer(values)])


def from_arrow(column: Any) -> np.ndarray[Any, Any]:
    """Return the column (N,) of an Arrow table. Numbers become float64, and empty cells NaN."""
    kind = str(column.type)
    if kind == "null":
        return np.full(len(column), np.nan)
    if not re.fullmatch(r"double|float|u?int(8|16|32|64)", kind):
        return np.asarray(column.to_numpy())
    parts = []
    for chunk in column.chunks:
        present, values = chunk.buffers()
        rows = slice(chunk.offset, chunk.offset + len(chunk))
        part = np.frombuffer(values or b"", {"double": "f8", "float": "f4"}.get(kind, kind))[rows]
        if chunk.null_count:
            known = np.unpackbits(np.frombuffer(present, np.uint8), bitorder="little")[rows]
            part = np.where(known, part, np.nan)
        parts.append(part)
    return parts[0] if len(parts) == 1 else np.concatenate([np.empty(0), *parts])
