"""Convert arrays to columns of Arrow tables, and back.

If pandas is installed, the conversions of pyarrow import it, which takes longer than many commands. The functions here use the
buffers.
"""

import re
from typing import Any

import numpy as np

from undrift.arrays import FloatArray


def to_arrow(column: FloatArray, *, empty: bool = False) -> Any:
    """Return an array (N,) as an Arrow array. With ``empty``, a NaN is an empty cell."""
    import pyarrow as pa

    values, bitmap = np.ascontiguousarray(column), None
    if empty and (gaps := np.isnan(values)).any():
        bitmap = pa.py_buffer(np.packbits(~gaps, bitorder="little"))
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [bitmap, pa.py_buffer(values)])


def from_arrow(column: Any) -> np.ndarray[Any, Any]:
    """Return a column (N,) of an Arrow table as an array. Empty cells of numbers become NaN."""
    kind = str(column.type)
    if kind == "null":
        return np.full(len(column), np.nan)
    if kind == "string":  # a parser of tables does not check its text
        cells = column.cast("binary").to_pylist()
        return np.array([None if cell is None else cell.decode("utf-8", "replace") for cell in cells], dtype=object)
    if not re.fullmatch(r"double|float|u?int(8|16|32|64)", kind):
        return np.asarray(column.to_numpy())
    arrays = []
    for chunk in column.chunks:
        bitmap, buffer = chunk.buffers()
        rows = slice(chunk.offset, chunk.offset + len(chunk))
        values = np.frombuffer(buffer or b"", {"double": "f8", "float": "f4"}.get(kind, kind))[rows]
        if chunk.null_count:
            filled = np.unpackbits(np.frombuffer(bitmap, np.uint8), bitorder="little")[rows]
            values = np.where(filled, values, np.nan)
        arrays.append(values)
    return arrays[0] if len(arrays) == 1 else np.concatenate([np.empty(0), *arrays])
