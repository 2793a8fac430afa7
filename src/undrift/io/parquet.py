"""Parquet, undrift's own format: names carry the unit, the schema carries frame, state and device.

The schema metadata holds one key, ``undrift``: ``{"kind": "undrift.record", "format": 1, "gyro_unit": "dps", "accel_unit": "g",
"frame": "s", "state": "raw", "device": "MTi-1"}``. Files of any size are read and written in chunks of constant memory.
"""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from undrift.errors import FileFormatError, InputError
from undrift.io.build import build_record
from undrift.io.columns import ColumnMap, Gaps, native_map
from undrift.io.csv import native_columns
from undrift.io.files import checked_file
from undrift.io.table import Table
from undrift.record import Record

FORMAT = 1
KIND = "undrift.record"
CHUNK_ROWS = 65_536  # 4 MB of seven channels: stays in the cache
_KEY = b"undrift"
_BUFFER = 1 << 20


def read_parquet(
    path: str | Path,
    columns: ColumnMap | None = None,
    *,
    sample_rate_hz: float | None = None,
    gaps: Gaps | None = None,
    repair_time: bool = False,
) -> Record:
    """Read a record.

    Parameters
    ----------
    path : str or Path
        The file.
    columns : ColumnMap or None
        None for undrift's own names.
    sample_rate_hz : float or None
        Hz, for undrift's own names without time_s.
    gaps : str or None
        "raise" or "keep"; None keeps them in files that undrift wrote and refuses them in others.
    repair_time : bool
        For undrift's own names: leave out rows whose time does not go forward.

    Returns
    -------
    Record
        Readings.

    Raises
    ------
    InputError
        No such file or column; NaN where gaps are refused; time that goes back.
    FileFormatError
        Not Parquet, damaged, or of an unknown format version.
    """
    handle = _open(path)
    names = tuple(handle.schema_arrow.names)
    columns = columns or replace(
        _native(Path(path), names, handle.schema_arrow.metadata, sample_rate_hz, gaps), repair_time=repair_time
    )
    with handle:
        return _record(Path(path), _whole(handle, path), columns)


def iter_parquet(
    path: str | Path,
    columns: ColumnMap | None = None,
    *,
    rows: int = CHUNK_ROWS,
    gaps: Gaps | None = None,
    repair_time: bool = False,
) -> Iterator[Record]:
    """Read a record in chunks: constant memory, whatever the size of the file.

    Parameters
    ----------
    path : str or Path
        The file. It must have a time column.
    columns : ColumnMap or None
        None for undrift's own names.
    rows : int
        Samples in a chunk, two or more; the last chunk may be one longer or shorter.
    gaps : str or None
        As for :func:`read_parquet`.
    repair_time : bool
        Likewise, within a chunk.

    Yields
    ------
    Record
        Chunks in order of time.

    Raises
    ------
    InputError
        As :func:`read_parquet`; also where time does not go forward from one chunk to the next.
    """
    if rows < 2:
        raise InputError(f"rows: wanted two samples or more in a chunk, got {rows}")
    path, handle = Path(path), _open(path, stream=True)
    names = tuple(handle.schema_arrow.names)
    columns = columns or replace(
        _native(path, names, handle.schema_arrow.metadata, None, gaps), repair_time=repair_time
    )
    if columns.time is None:
        raise InputError(f"{path}: wanted a time column to read in chunks, got none; add time_s or read it whole")
    last: float | None = None
    with handle:
        for table in _batches(handle, rows, path):
            record = _record(path, table, columns)
            if last is not None and record.time[0] <= last:
                raise InputError(
                    f"{path}: wanted strictly increasing time, got {last:.9g} s then {record.time[0]:.9g} s; repair the file"
                )
            last = float(record.time[-1])
            yield record


def write_parquet(record: Record, path: str | Path) -> None:
    """Write a record; every bit reads back.

    Parameters
    ----------
    record : Record
        Readings; NaN is kept.
    path : str or Path
        File to write. It appears whole or not at all.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    with ParquetWriter(path) as writer:
        writer.write(record)


class ParquetWriter:
    """Write a record chunk by chunk. The file appears under its name only when the with block ends well.

    Parameters
    ----------
    path : str or Path
        File to write.

    Raises
    ------
    InputError
        Chunks whose channels, units, frame, state or device differ, time that does not go forward from chunk to chunk, or
        a file that cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._part = self.path.with_name(self.path.name + ".part")
        self._writer: Any = None
        self._schema: Any = None
        self._last = float("-inf")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.close()
        if kind is None and self._writer is not None:
            self._part.replace(self.path)
        else:
            self._part.unlink(missing_ok=True)

    def write(self, record: Record) -> None:
        """Append a chunk.

        Parameters
        ----------
        record : Record
            Later in time than the chunk before.

        Raises
        ------
        InputError
            Another kind of record than the first, or earlier in time.
        """
        import pyarrow as pa
        from pyarrow import parquet as pq

        names, columns = native_columns(record)
        schema = pa.schema([(name, pa.float64()) for name in names], metadata=_metadata(record))
        if self._writer is None:
            try:
                self._writer = pq.ParquetWriter(self._part, schema, use_dictionary=False)
            except OSError as error:
                raise InputError(f"{self.path}: cannot be written: {error}; check the folder and its rights") from error
            self._schema = schema
        if not schema.equals(self._schema, check_metadata=True):
            raise InputError(
                f"{self.path}: wanted chunks of one record, got {schema.names} after {self._schema.names} or another "
                "frame, state or device"
            )
        if record.time[0] <= self._last:
            raise InputError(
                f"{self.path}: wanted chunks in order of time, got {record.time[0]:.9g} s after {self._last:.9g} s"
            )
        self._last = float(record.time[-1])
        self._writer.write_table(pa.Table.from_arrays([pa.array(column) for column in columns], schema=schema))


def parquet_rows(path: str | Path) -> int:
    """Return the number of rows without reading them.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    int
        Rows.

    Raises
    ------
    FileFormatError
        Not a Parquet file.
    """
    with _open(path) as handle:
        return int(handle.metadata.num_rows)


def parquet_names(path: str | Path) -> tuple[str, ...]:
    """Return the column names.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    tuple of str
        Names as stored.

    Raises
    ------
    FileFormatError
        Not a Parquet file.
    """
    with _open(path) as handle:
        return tuple(handle.schema_arrow.names)


def read_parquet_table(path: str | Path) -> Table:
    """Return the columns of a Parquet file as they are.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    Table
        All columns.

    Raises
    ------
    FileFormatError
        Not a Parquet file, or a damaged one.
    """
    with _open(path) as handle:
        return _table(Path(path), _whole(handle, path))


def _open(path: str | Path, *, stream: bool = False) -> Any:
    import pyarrow as pa
    from pyarrow import parquet as pq

    path = checked_file(path)
    try:
        # Read ahead, Arrow keeps every row group it has read: as much memory as the file is long.
        return pq.ParquetFile(path, pre_buffer=not stream, buffer_size=_BUFFER if stream else 0)
    except (pa.ArrowInvalid, OSError) as error:
        raise FileFormatError(
            f"{path}: wanted a Parquet file, got something else or a cut one; {_first(error)}"
        ) from error


def _whole(handle: Any, path: str | Path) -> Any:
    try:
        return handle.read()
    except OSError as error:
        raise FileFormatError(f"{path}: wanted a sound Parquet file, got a damaged one; {_first(error)}") from error


def _batches(handle: Any, rows: int, path: Path) -> Iterator[Any]:
    """Yield Arrow tables of ``rows`` rows; a last single row goes with the chunk before it."""
    import pyarrow as pa

    held: list[Any] = []
    count = 0
    try:
        for batch in handle.iter_batches(batch_size=rows):
            held.append(batch)
            count += batch.num_rows
            while count >= rows + 2:  # what is left over is a chunk of its own
                table = pa.Table.from_batches(held)
                yield table.slice(0, rows)
                held, count = table.slice(rows).to_batches(), count - rows
    except OSError as error:
        raise FileFormatError(f"{path}: wanted a sound Parquet file, got a damaged one; {_first(error)}") from error
    yield pa.Table.from_batches(held, schema=handle.schema_arrow)


def _record(path: Path, table: Any, columns: ColumnMap) -> Record:
    return build_record(_table(path, table), columns)


def _table(path: Path, table: Any) -> Table:
    return Table(source=str(path), names=tuple(table.column_names), columns=tuple(table.columns))


def _native(
    path: Path,
    names: tuple[str, ...],
    metadata: dict[bytes, bytes] | None,
    sample_rate_hz: float | None,
    gaps: Gaps | None,
) -> ColumnMap:
    try:
        columns = native_map(names, sample_rate_hz=sample_rate_hz)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    if not metadata or _KEY not in metadata:
        return replace(columns, gaps=gaps or "raise")
    held = json.loads(metadata[_KEY])
    if held.get("kind") != KIND or held.get("format") != FORMAT:
        raise FileFormatError(
            f"{path}: wanted {KIND} format {FORMAT}, got {held.get('kind')} format {held.get('format')}; read it with the "
            "undrift that wrote it"
        )
    return replace(columns, gaps=gaps or "keep", frame=held["frame"], state=held["state"], device=held["device"])


def _metadata(record: Record) -> dict[bytes, bytes]:
    held = {
        "kind": KIND,
        "format": FORMAT,
        "gyro_unit": record.gyro_unit if record.gyro is not None else None,
        "accel_unit": record.accel_unit if record.accel is not None else None,
        "frame": record.frame,
        "state": record.state,
        "device": record.device,
    }
    return {_KEY: json.dumps(held, sort_keys=True).encode()}


def _first(error: BaseException) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
