"""CSV: any text table through a ColumnMap, and undrift's own names without one.

undrift writes the unit into every column name. Frame, state and device stand in one first line, only where they are not
the usual ones (sensor axes, raw, no device), so that a corrected file is never corrected twice::

    # undrift record; frame=b; state=corrected; device=MTi-1
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.frames import Frame
from undrift.io.build import Built, build
from undrift.io.columns import ACCEL_SUFFIX, AXES, GYRO_SUFFIX, ColumnMap, Gaps, TextLayout, native_map
from undrift.io.text import Text, open_text, parse_text
from undrift.record import Record, State


def read_csv(
    path: str | Path, columns: ColumnMap | None = None, *, sample_rate_hz: float | None = None, gaps: Gaps = "raise"
) -> Record:
    """Read a record from a text table, plain or gzip.

    Parameters
    ----------
    path : str or Path
        The file.
    columns : ColumnMap or None
        Which column is what; None for a file with undrift's own names.
    sample_rate_hz : float or None
        Hz, for a file with undrift's own names and no time_s.
    gaps : str
        For a file with undrift's own names: "raise" refuses empty cells, "keep" keeps them.

    Returns
    -------
    Record
        Time in s; gyro and accel in the unit of the map.

    Raises
    ------
    InputError
        No such file, no such column, names that need a map, NaN, time that goes back, two rates in one file.
    FileFormatError
        Empty, cut, binary, not UTF-8, ragged rows, text in a number column, values no sensor reads.
    """
    return build_csv(path, columns, sample_rate_hz=sample_rate_hz, gaps=gaps).record


def build_csv(
    path: str | Path,
    columns: ColumnMap | None = None,
    *,
    sample_rate_hz: float | None = None,
    gaps: Gaps = "raise",
    repair_time: bool = False,
    drop_bad_rows: bool = False,
) -> Built:
    """Read a record and the count of rows left out.

    Parameters
    ----------
    path : str or Path
        The file.
    columns : ColumnMap or None
        As for :func:`read_csv`.
    sample_rate_hz : float or None
        Hz, likewise.
    gaps : str
        Likewise.
    repair_time : bool
        For a file with undrift's own names: leave out rows whose time does not go forward.
    drop_bad_rows : bool
        Likewise rows that do not parse.

    Returns
    -------
    Built
        Record, dropped and repaired rows.

    Raises
    ------
    InputError
        As :func:`read_csv`.
    """
    text = open_text(path, TextLayout(drop_bad_rows=drop_bad_rows) if columns is None else columns.layout)
    if columns is None:
        columns = replace(_native(text, sample_rate_hz, gaps), repair_time=repair_time)
    wanted = tuple(column for channel in columns.mapped() for column in columns.columns_of(channel))
    return build(parse_text(text, wanted), columns)


def write_csv(record: Record, path: str | Path) -> None:
    """Write a record with undrift's own column names; every number reads back to the same bits.

    Parameters
    ----------
    record : Record
        Readings; gaps become empty cells.
    path : str or Path
        File to write; packed where the name ends in .gz.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    names, columns = native_columns(record)
    table = pa.table([pa.array(column, from_pandas=True) for column in columns], names=list(names))
    path = Path(path)
    try:
        with pa.OSFile(str(path), "wb") as raw:
            sink = pa.CompressedOutputStream(raw, "gzip") if path.suffix == ".gz" else raw
            sink.write(_mark(record) + ",".join(names).encode() + b"\n")
            arrow_csv.write_csv(table, sink, arrow_csv.WriteOptions(include_header=False, quoting_style="none"))
            if sink is not raw:
                sink.close()
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error}; check the folder and its rights") from error


def native_columns(record: Record) -> tuple[tuple[str, ...], tuple[FloatArray, ...]]:
    """Return a record as named columns, undrift's own names.

    Parameters
    ----------
    record : Record
        Readings.

    Returns
    -------
    tuple of str
        time_s, gyro_x_dps, ...
    tuple of array
        One of shape (N,) for each name.
    """
    names, columns = ["time_s"], [record.time]
    triples: list[tuple[str, str, Any]] = [
        ("gyro", GYRO_SUFFIX[record.gyro_unit], record.gyro),
        ("accel", ACCEL_SUFFIX[record.accel_unit], record.accel),
        ("mag", "ut", record.mag_ut),
    ]
    for channel, suffix, values in triples:
        if values is not None:
            names += [f"{channel}_{axis}_{suffix}" for axis in AXES]
            columns += [np.ascontiguousarray(values[:, k]) for k in range(3)]
    if record.temp_c is not None:
        names.append("temp_c")
        columns.append(record.temp_c)
    return tuple(names), tuple(columns)


def _native(text: Text, sample_rate_hz: float | None, gaps: Gaps) -> ColumnMap:
    try:
        columns = native_map(text.names, sample_rate_hz=sample_rate_hz, layout=text.layout)
    except InputError as error:
        raise InputError(f"{text.path}: {error}") from error
    frame, state, device = _read_mark(text) if text.mark else ("s", "raw", "")
    return replace(columns, gaps=gaps, frame=frame, state=state, device=device)


def _mark(record: Record) -> bytes:
    if record.frame == "s" and record.state == "raw" and not record.device:
        return b""
    device = " ".join(record.device.replace(";", ",").split())
    return f"# undrift record; frame={record.frame}; state={record.state}; device={device}\n".encode()


def _read_mark(text: Text) -> tuple[Frame, State, str]:
    found = dict(part.strip().split("=", 1) for part in text.mark.split(";")[1:] if "=" in part)
    frames = {name: name for name in get_args(Frame)}
    states = {name: name for name in get_args(State)}
    if found.get("frame") not in frames or found.get("state") not in states:
        raise FileFormatError(
            f"{text.path}: wanted '# undrift record; frame=...; state=...; device=...' in line 1, got {text.mark[:60]!r}"
        )
    return frames[found["frame"]], states[found["state"]], found.get("device", "")
