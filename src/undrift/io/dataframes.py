"""Conversion between records and data frames of pandas, and of all libraries that support Arrow, such as polars. pandas is imported
only to create a frame.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.io.column_map import AXES, CHANNELS, ColumnMap, Gaps, is_native, map_of_channels, native_map
from undrift.io.columns import RawTable, build_record, marks_of, native_columns, read_marks
from undrift.io.write import COLUMNS
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    import pandas as pd

SOURCE = "DataFrame"
NAMES: dict[str, str | tuple[str, ...]] = {  # undrift's own, without the unit
    "time": "time", "temp": "temp", **{name: tuple(f"{name}_{axis}" for axis in AXES) for name in ("gyro", "accel", "mag")}
}  # fmt: skip


def read_frame(
    frame: "pd.DataFrame",
    columns: Mapping[str, str | Sequence[str]] | None,
    units: Mapping[str, str],
    *,
    sample_rate_hz: float | None,
    gaps: Gaps,
    device: str,
) -> Record:
    """Return the record in a frame, with every value checked as for a file."""
    for what, mapping in (("columns", columns or {}), ("units", units)):
        unknown = sorted(set(mapping) - set(CHANNELS))
        if unknown:
            raise InputError(
                f"from_frame: expected {what} of {', '.join(CHANNELS)}, got {', '.join(unknown)}. Use these names."
            )
    data, index, marks = _columns_of(frame)
    time, native = dict(columns or NAMES).get("time"), columns is None and is_native(tuple(data))
    if sample_rate_hz is None and "time_s" not in data and time not in data and index is not None and _is_clock(index):
        time = "time_s" if native else str(time or "time")
        data[time] = index.to_series()
        columns = None if columns is None else {**columns, "time": time}
    dated = [name for name, values in data.items() if values.dtype.kind in "Mm" or hasattr(values.dtype, "tz")]
    table = RawTable(
        source=SOURCE,
        names=tuple(data),
        columns=tuple(_numbers(values, name in dated) for name, values in data.items()),
        marks=read_marks(
            {**marks, "device": device or marks.get("device", "")}, f"{SOURCE}: the attrs were not written by undrift"
        ),
    )
    if native:
        own = native_map(table.names, ColumnMap(gaps=gaps, sample_rate_hz=sample_rate_hz), source=SOURCE)
    else:
        chosen = {
            key: name if isinstance(name, str) else tuple(name)
            for key, name in (columns or _plain(table.names)).items()
        }
        clock = {"time": "s"} if time in dated else {}
        own = map_of_channels(chosen, {**units, **clock}, sample_rate_hz=sample_rate_hz, gaps=gaps)
    return build_record(replace(table, own=own)).record


def _columns_of(frame: Any) -> tuple[dict[str, Any], Any, dict[str, Any]]:
    """Return the columns by name, including the index if there is one, and undrift's marks."""
    raw = {"frame": "s", "state": "raw"}
    if hasattr(frame, "iloc"):  # a pandas frame
        columns = {str(name): frame.iloc[:, k] for k, name in enumerate(frame.columns)}
        return columns, frame.index, frame.attrs.get("undrift", raw)
    import pyarrow as pa

    try:
        table = pa.table(frame)
    except TypeError as error:
        got = type(frame).__name__
        raise InputError(
            f"{SOURCE}: expected a table of pandas, polars or Arrow, got {got}. Convert it to one of these."
        ) from error
    return {name: table[name].to_numpy() for name in table.column_names}, None, raw


def frame_of(record: Record) -> "pd.DataFrame":
    """Return a record as a frame."""
    frame = _frame(*native_columns(record))
    frame.attrs["undrift"] = marks_of(record)
    return frame


def orientation_frame(time: FloatArray, q_nb: FloatArray, angles: Sequence[FloatArray]) -> "pd.DataFrame":
    """Return orientations over time as a frame, with the columns of their files: three angles (N,) rad."""
    return _frame(COLUMNS, (time, *q_nb.T, *(angle / RADIAN_PER_DEGREE for angle in angles)))


def _frame(names: Sequence[str], columns: Sequence[FloatArray]) -> "pd.DataFrame":
    try:
        import pandas as pd
    except ImportError as error:
        raise InputError("to_frame: the package pandas is missing. Run pip install pandas.") from error
    return pd.DataFrame(dict(zip(names, columns, strict=True)))


def _is_clock(index: Any) -> bool:
    return index.dtype.kind in "Mm" or hasattr(index.dtype, "tz") or str(index.name) in ("time", "time_s")


def _plain(names: Sequence[str]) -> dict[str, str | tuple[str, ...]]:
    """Return the channels of a table that have undrift's names without units."""
    return {key: want for key, want in NAMES.items() if set((want,) if isinstance(want, str) else want) & set(names)}


def _numbers(values: Any, dated: bool) -> Any:
    """Return a column as float64, with dates in s from the first date. Text is returned unchanged, so that a later error
    can quote it.
    """
    arrow = isinstance(values, np.ndarray)
    if dated:
        passed = values - values[0] if arrow else (values - values.iloc[0]).to_numpy()
        return passed / np.timedelta64(1, "s")
    try:
        return values.astype(np.float64) if arrow else values.to_numpy(dtype=np.float64, na_value=np.nan)
    except (TypeError, ValueError):
        return values.astype(object) if arrow else values.to_numpy(dtype=object)
