"""Parquet, undrift's own format: column names contain the unit, and the schema contains frame, state and device.

The schema metadata contains the key ``undrift``: ``{"kind": "undrift.record", "format": 1, "gyro_unit": "dps", "accel_unit": "g",
"frame": "s", "state": "raw", "device": "MTi-1"}``. A corrected record also has ``accel_uncertainty`` (see record.ForceUncertainty)
and, if an offset was subtracted, ``offset_uncertainty``, rad/s. The second key, ``undrift.crc32``, is the CRC-32 of the first key
and of the column names. Each page has its own CRC, so that a changed byte is detected. Files of any size are read and written in
chunks of constant memory.
"""

import json
import zlib
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from undrift.errors import FileFormatError, InputError
from undrift.files import MOST_BYTES, checked_file, first_line, new_file, sound, too_large
from undrift.io.arrow import to_arrow
from undrift.io.column_map import READ_SETTINGS, ColumnMap, native_map
from undrift.io.columns import FORMAT, KIND, RawTable, build_record, marks_of, native_columns, read_marks
from undrift.record import Record

CHUNK_ROWS = 65_536  # 4 MB for seven channels, which fit into the cache
_KEY, _CRC = b"undrift", b"undrift.crc32"
_BUFFER = 1 << 20


def read_parquet(path: str | Path, how: ColumnMap = READ_SETTINGS) -> RawTable:
    """Read a table, with the map and marks of undrift's names."""
    with _open(path) as handle:
        return _stating(Path(path), handle, _table(path, _whole(path, handle)), how)


def read_own_parquet(path: Path) -> Record:
    """Read a record that undrift wrote."""
    return build_record(read_parquet(path)).record


def iter_parquet(path: str | Path, how: ColumnMap = READ_SETTINGS, *, rows: int = CHUNK_ROWS) -> Iterator[Record]:
    """Read a record in chunks, with constant memory for any file size."""
    if rows < 2:
        raise InputError(f"rows: expected two samples or more in a chunk, got {rows}")
    last: float | None = None
    with _open(path, stream=True) as handle:
        own = _stating(Path(path), handle, RawTable(source=str(path), names=_names(handle), columns=()), how)
        if not (own.own or how).columns_of("time"):
            raise InputError(
                f"{path}: expected a time column to read in chunks, got none. Add time_s, or read the "
                f"file in one piece."
            )
        for chunk in _batches(path, handle, rows):
            record = build_record(replace(own, columns=tuple(chunk.columns)), how).record
            if last is not None and record.time[0] <= last:
                raise InputError(
                    f"{path}: expected strictly increasing time, got {last:.9g} s then {record.time[0]:.9g} s. Repair the file."
                )
            last = float(record.time[-1])
            yield record


def write_parquet(record: Record, path: str | Path) -> None:
    """Write a record. Every bit is read back."""
    with ParquetWriter(path) as writer:
        writer.write(record)


class ParquetWriter:
    """Write a record chunk by chunk. The file appears under its name only if the with block ends without an error."""

    write_every_s = 10.0  # name of the record, if it is recorded live

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._stack = ExitStack()  # the new file, its sink and its writer
        self._writer: Any = None
        self._schema: Any = None
        self._last = float("-inf")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def write(self, record: Record) -> None:
        """Append a chunk."""
        import pyarrow as pa
        from pyarrow import parquet as pq

        names, columns = native_columns(record)
        marks = marks_of(record) | {"kind": KIND, "format": FORMAT}
        for triad, unit in (("gyro", record.gyro_unit), ("accel", record.accel_unit)):
            marks[f"{triad}_unit"] = None if getattr(record, triad) is None else unit
        metadata = {_KEY: json.dumps(marks, sort_keys=True).encode()}
        metadata[_CRC] = _crc(names, metadata[_KEY])
        schema = pa.schema([(name, pa.float64()) for name in names], metadata=metadata)
        if self._writer is None:
            sink = self._stack.enter_context(pa.OSFile(str(self._stack.enter_context(new_file(self.path))), "wb"))
            how = {"write_page_checksum": True, "write_statistics": ["time_s"]}  # other rows are matched by time only
            self._writer = self._stack.enter_context(pq.ParquetWriter(sink, schema, use_dictionary=False, **how))
            self._schema = schema
        if not schema.equals(self._schema, check_metadata=True):
            raise InputError(
                f"{self.path}: expected chunks of one record, got {schema.names} after {self._schema.names} or another "
                "frame, state or device"
            )
        if record.time[0] <= self._last:
            raise InputError(
                f"{self.path}: expected chunks in order of time, got {record.time[0]:.9g} s after {self._last:.9g} s"
            )
        self._last = float(record.time[-1])
        table = pa.Table.from_arrays([to_arrow(column) for column in columns], schema=schema)
        self._writer.write_table(table)


def parquet_rows(path: str | Path) -> int:
    """Return the number of rows without reading them."""
    with _open(path) as handle:
        return int(handle.metadata.num_rows)


def parquet_names(path: str | Path) -> tuple[str, ...]:
    """Return the column names."""
    with _open(path) as handle:
        return _names(handle)


def read_parquet_table(path: str | Path) -> RawTable:
    """Return the columns of a Parquet file as they are."""
    with _open(path) as handle:
        return _table(path, _whole(path, handle))


def _names(handle: Any) -> tuple[str, ...]:
    return tuple(handle.schema_arrow.names)


def _open(path: str | Path, *, stream: bool = False) -> Any:
    import pyarrow as pa
    from pyarrow import parquet as pq

    path = checked_file(path)
    try:
        # With read-ahead, Arrow keeps every row group that it has read, so memory would grow to the size of the file.
        buffer = _BUFFER if stream else 0
        return pq.ParquetFile(path, pre_buffer=not stream, buffer_size=buffer, page_checksum_verification=True)
    except (pa.ArrowInvalid, OSError) as error:
        raise FileFormatError(
            f"{path}: expected a Parquet file, got another format or a truncated file. {first_line(error)}."
        ) from error


def _whole(path: str | Path, handle: Any) -> Any:
    if 8 * handle.metadata.num_rows * handle.metadata.num_columns > MOST_BYTES:
        raise too_large(Path(path))
    with sound(Path(path), "Parquet"):
        return handle.read()


def _batches(path: str | Path, handle: Any, rows: int) -> Iterator[Any]:
    """Yield Arrow tables of ``rows`` rows. A single last row is added to the chunk before it."""
    import pyarrow as pa

    batches, count = list[Any](), 0
    with sound(Path(path), "Parquet"):
        for batch in handle.iter_batches(batch_size=rows):
            batches.append(batch)
            count += batch.num_rows
            while count >= rows + 2:  # the remainder is a separate chunk
                table = pa.Table.from_batches(batches)
                yield table.slice(0, rows)
                batches, count = table.slice(rows).to_batches(), count - rows
    yield pa.Table.from_batches(batches, schema=handle.schema_arrow)


def _table(path: str | Path, table: Any) -> RawTable:
    return RawTable(source=str(path), names=tuple(table.column_names), columns=tuple(table.columns))


def _crc(names: Iterable[str], statement: bytes) -> bytes:
    return b"%08x" % zlib.crc32(statement, zlib.crc32(",".join(names).encode()))


def _stating(path: Path, handle: Any, table: RawTable, how: ColumnMap) -> RawTable:
    """Return the table with its map and marks, unless a given map names the columns."""
    if how.columns:
        return table
    own = native_map(table.names, how, source=str(path))
    table = replace(table, notes=own.unread(table.names))
    metadata = handle.schema_arrow.metadata
    if not metadata or _KEY not in metadata:
        return replace(table, own=own)
    if metadata.get(_CRC, crc := _crc(table.names, metadata[_KEY])) != crc:
        raise FileFormatError(f"{path}: the file header was changed after it was written (CRC-32). Restore the file.")
    held = json.loads(metadata[_KEY])
    if held.get("kind") != KIND or held.get("format") != FORMAT:
        raise FileFormatError(
            f"{path}: expected {KIND} format {FORMAT}, got {held.get('kind')} format {held.get('format')}. Read it with the "
            f"version of undrift that wrote it."
        )
    marks = read_marks(held, f"{path}: expected the frame, state and device of a recording, got other keys")
    return replace(table, own=own if how.gaps else own.but(gaps="keep"), marks=marks)  # NaN means a gap
