"""Text tables, separated by comma, tab, semicolon or blank, plain or gzip. CSV is read with a ColumnMap or undrift's
own names.

Arrow parses the rows. Only if this fails, they are checked one by one. undrift writes the unit into every column name,
and nothing before the header. Frame, state and device are stored in NAME.csv.json, next to NAME.csv, if they differ
from the defaults (sensor axes, raw, no device). A corrected file is therefore never corrected twice. The same file
lists columns, units and provenance.
"""

import csv
import io
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self, TypeAlias

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError
from undrift.files import (
    MOST_BYTES,
    checked_file,
    is_gzip,
    read_bytes,
    read_so_far,
    read_tree,
    too_large,
    unwritten,
    write_together,
)
from undrift.io.column_map import READ_SETTINGS, Column, ColumnMap, TextLayout, native_map
from undrift.io.columns import FORMAT, KIND, RawTable, find_column, is_number, marks_of, native_columns, read_marks
from undrift.record import Record

Provenance: TypeAlias = Mapping[str, Any]  # origin of a record and its program, as JSON
EMPTY = ["", "NaN", "nan", "NAN", "NA", "N/A", "n/a", "null", "NULL", "None", "-nan", "#N/A"]
_HEAD = 1 << 20  # bytes at the start
_NO_LINE_END = "the last row has no line end: it may be cut"
_PIECE = 1 << 24  # bytes that are parsed at a time
_LINE = 1 << 12  # bytes of the end in which blank lines are looked for
_INK = re.compile(rb"\S")
_BLANK_END = re.compile(rb"(?:\n[ \t\r,;]*)+\Z")  # lines at the end without a cell that is filled
_NUMBER = re.compile(r"[ \t\r]*[-+]?(\d+\.?\d*([eE][-+]?\d+)?|\.\d+([eE][-+]?\d+)?|(?i:inf(inity)?))[ \t\r]*", re.ASCII)


def read_csv(path: str | Path, how: ColumnMap = READ_SETTINGS) -> RawTable:
    """Read a text table, by a map or with undrift's own names."""
    path = Path(path)
    text = open_text(path, how)
    own = None if how.columns else native_map(text.names, how, source=str(path))
    marks = None if own is None else _read_sidecar(path, text.names)
    table = parse_text(text, (own or how).wanted(numeric=True))
    notes = () if _ends_with_line(text) else (_NO_LINE_END,)
    if own is None:
        return replace(table, notes=notes)
    own = own if marks is None or how.gaps else own.but(gaps="keep")  # undrift wrote it: an empty cell is a gap
    return replace(table, notes=notes, own=own, marks=marks or {})


def _ends_with_line(text: "Text") -> bool:
    """Return whether the last line of a text has its end."""
    if text.content is not None:
        return text.content.endswith(b"\n")
    with text.path.open("rb") as handle:
        handle.seek(-1, os.SEEK_END)
        return handle.read() in (b"\n", b"\r")


def write_csv(record: Record, path: str | Path, made_by: Provenance | None = None) -> None:
    """Write a record with undrift's own column names. Every number reads back to the same bits."""
    path, (names, columns), beside = Path(path), native_columns(record), None
    if made_by or record.frame != "s" or record.state != "raw" or record.device:
        beside = json.dumps(statement_of(record, path, names) | {"provenance": made_by or None}, indent=1) + "\n"
    write_rows(path, names, columns, {sidecar_of(path): beside})  # none also of an earlier recording of this name


def sidecar_of(path: Path) -> Path:
    """Return the name of the file that describes a CSV, for example walk.csv.json for walk.csv."""
    return path.with_name(path.name + ".json")


def statement_of(record: Record, path: Path, names: Sequence[str]) -> dict[str, Any]:
    """Return the description of a recording, as JSON for the file next to its table."""
    units = {"gyro": record.gyro_unit, "accel": record.accel_unit, "mag": "uT", "temp": "degC", "time": "s"}
    return {
        "kind": KIND,
        "format": FORMAT,
        "file": path.name,
        **marks_of(record),
        "samples": len(record),
        "sample_rate_hz": record.sample_rate_hz,
        "columns": {name: units[name.partition("_")[0]] for name in names},
    }


def _read_sidecar(path: Path, names: Sequence[str]) -> dict[str, Any] | None:
    """Return what the file beside a table of undrift states; None where there is none of undrift."""
    beside = sidecar_of(path)
    if not beside.is_file():
        return None
    content = read_tree(beside) if beside.stat().st_size else b""
    try:
        sidecar = json.loads(content)
    except (ValueError, RecursionError):
        sidecar = None
    if not isinstance(sidecar, dict) or sidecar.get("kind") != KIND:
        if b'"undrift.' in content:
            raise FileFormatError(f"{beside}: this JSON file was changed after undrift wrote it. Restore the file.")
        return None  # of another program
    if sidecar.get("format") != FORMAT:
        raise FileFormatError(
            f"{beside}: expected {KIND} format {FORMAT}, got format {sidecar.get('format')}. Read it with the "
            f"undrift that wrote it."
        )
    if [*sidecar.get("columns", ())] != [*names]:
        raise FileFormatError(
            f"{beside}: expected the columns of {path.name} ({', '.join(names)}), got {', '.join(sidecar.get('columns', ()))}. "
            "It belongs to another table. Move it away."
        )
    return read_marks(sidecar, f"{beside}: expected the frame, state and device of a recording, got other keys")


def write_rows(
    path: Path, names: Sequence[str], columns: Sequence[FloatArray], beside: Mapping[Path, str | None] | None = None
) -> None:
    """Write named columns as CSV, gaps as empty cells, and their sidecar files. Every number reads back to the same
    bits.
    """
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    table = _table_of(names, columns)

    def write(target: Path) -> None:
        packs = path.suffix == ".gz"
        with (
            pa.OSFile(str(target), "wb") as raw,
            pa.CompressedOutputStream(raw, "gzip") if packs else nullcontext(raw) as sink,
        ):
            sink.write(f"{','.join(names)}\n".encode())
            arrow_csv.write_csv(table, sink, arrow_csv.WriteOptions(include_header=False, quoting_style="none"))

    write_together({**(beside or {}), path: write})


def _table_of(names: Sequence[str], columns: Sequence[FloatArray]) -> Any:
    import pyarrow as pa

    return pa.table([pa.array(np.ascontiguousarray(column), from_pandas=True) for column in columns], names=list(names))


class Appender:
    """Writes lines piece by piece into a new file that is whole after each, whatever ends it."""

    write_every_s = 1.0  # name of the record, if it is recorded live

    def __init__(self, path: Path) -> None:
        self.path, self._sink = path, -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._sink >= 0:
            os.close(self._sink)
            self._sink = -1

    def append(self, content: bytes) -> None:
        """Append lines and sync them to the disk. If the disk is full, keep the lines that fit."""
        start = done = 0
        try:
            if self._sink < 0:
                flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
                self._sink = os.open(self.path, flags, 0o666)
            start = os.fstat(self._sink).st_size
            while done < len(content):
                done += os.write(self._sink, content[done:])
            os.fsync(self._sink)
        except OSError as error:
            with suppress(OSError):  # of a file that was not opened, too
                os.ftruncate(self._sink, start + content.rfind(b"\n", 0, done) + 1)
            raise unwritten(self.path, error) from error

    def write(self, record: Record) -> None:
        """Append a chunk of a record, with undrift's own column names."""
        from pyarrow import csv as arrow_csv

        (names, columns), buffer = native_columns(record), io.BytesIO()
        buffer.write(b"" if self._sink >= 0 else f"{','.join(names)}\n".encode())
        options = arrow_csv.WriteOptions(include_header=False, quoting_style="none")
        arrow_csv.write_csv(_table_of(names, columns), buffer, options)
        self.append(buffer.getvalue())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Text:
    """A text table, opened and its header read, its rows not parsed yet."""

    path: Path
    content: bytes | None  # unpacked text, or None if Arrow can read the file itself
    head: bytes  # The first MiB of the text
    names: tuple[str, ...]  # Header, or positions as text
    layout: TextLayout
    skip: int  # Lines before the first row


def open_text(path: str | Path, layout: TextLayout | None = None) -> Text:
    """Open a text table and read its header."""
    layout, path = layout or TextLayout(), checked_file(path)
    blanks = layout.delimiter == " "
    content = read_bytes(path) if blanks or is_gzip(path) else None
    if content is not None and blanks:
        content = packed(content)
    head = content[:_HEAD] if content is not None else read_bytes(path, _HEAD)
    if b"\0" in head[:4096]:
        raise FileFormatError(f"{path}: expected UTF-8 text, got binary data or UTF-16. Save it as UTF-8 text.")
    skip = layout.skip_rows
    lines = head.splitlines()[skip : skip + 64]
    if not lines:
        raise FileFormatError(f"{path}: expected rows after {skip} skipped lines, got none. Check skip_rows.")
    if layout.header:
        try:
            header = lines[0].removeprefix(b"\xef\xbb\xbf").decode("utf-8")
        except UnicodeDecodeError as error:
            raise FileFormatError(
                f"{path}: expected UTF-8 text, got byte 0x{lines[0][error.start]:02x} in the header. Save the file as UTF-8."
            ) from error
        names = tuple(next(csv.reader([header.strip(" ") if blanks else header], delimiter=layout.delimiter), ()))
        if _is_row(names, layout.decimal):
            layout = layout.but(header=False)
    if not layout.header:  # positions, as many as most of the first rows have columns
        counts = [line.count(layout.delimiter.encode()) + 1 for line in lines]
        names = tuple(str(i) for i in range(max(set(counts), key=counts.count)))
    return Text(path=path, content=content, head=head, names=names, layout=layout, skip=skip + layout.header)


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line."""
    if delimiter == " ":
        return line.split()
    quoted = '"' in line and "\r" not in line and len(line) < csv.field_size_limit()
    cells = next(csv.reader([line], delimiter=delimiter), []) if quoted else line.split(delimiter)
    return [cell.strip() for cell in cells]


def packed(rows: bytes) -> bytes:
    """Return rows with runs of blanks and tabs as one blank, as the parser takes them."""
    return re.sub(rb"^ | $", b"", re.sub(rb"[ \t]+", b" ", rows.replace(b"\r\n", b"\n")), flags=re.MULTILINE)


def _is_row(names: tuple[str, ...], decimal: str) -> bool:
    """Return True if a header is a row of readings: all cells but one are numbers and not column positions."""
    cells = [float(cell) for name in names if is_number(cell := name.replace(decimal, "."))]
    return len(cells) > 1 and len(cells) >= len(names) - 1 and bool((np.diff(cells) != 1.0).any())


def parse_text(text: Text, wanted: tuple[Column, ...]) -> RawTable:
    """Parse the rows of a text table: piece by piece, or row by row if they do not parse so."""
    import pyarrow as pa

    positions = [find_column(text.names, column, str(text.path)) for column in wanted]
    start = sum(map(len, text.head.splitlines(keepends=True)[: text.skip]))
    if not text.head[start:].strip():
        return RawTable(source=str(text.path), names=text.names, columns=tuple(np.empty(0) for _ in text.names))
    size = text.path.stat().st_size if text.content is None else len(text.content)
    try:
        parsed = pa.concat_tables(_pieces(text, start, size, positions), promote_options="permissive")
        return RawTable(source=str(text.path), names=text.names, columns=tuple(parsed.columns))
    except (pa.ArrowInvalid, pa.ArrowTypeError):  # a bad row, or another column that changes from numbers to words
        pass
    return _parse_by_row(text, positions)


def _pieces(text: Text, start: int, size: int, positions: list[int]) -> Iterator[Any]:
    """Yield the rows of a text from its byte ``start`` to ``size``, parsed some megabytes at a time."""
    import pyarrow as pa

    taken = 0
    # one buffer for all: fresh memory costs as much as reading into it
    buffer = bytearray(min(size, _PIECE))
    with text.path.open("rb") if text.content is None else io.BytesIO(text.content) as handle:
        handle.seek(start)
        while end := handle.readinto(buffer):
            end = buffer.rfind(b"\n", 0, end) + 1 if start + end < size else end  # the rest begins the next piece
            quotes = buffer.find(b'"', 0, end) >= 0 and any(
                row.count(b'"') % 2 for row in bytes(buffer[:end]).split(b"\n")
            )
            if not end or quotes:  # Arrow would take all rows after a quote that does not close into one cell
                raise pa.ArrowInvalid("rows that do not end, or quotes that do not close")
            start = handle.seek(start + end)
            if start >= size and (blank := _BLANK_END.search(buffer, max(0, end - _LINE), end)):
                end = blank.start() + 1
            if _INK.search(buffer, 0, end):
                yield (table := _parse_rows(text, pa.py_buffer(buffer).slice(0, end), positions))
                taken += table.nbytes
            if taken > MOST_BYTES:
                raise too_large(text.path)
            read_so_far(text.path, start / size)


def _parse_rows(text: Text, rows: Any, numbers: list[int]) -> Any:
    """Parse rows of text. Cells of the columns ``numbers`` become numbers."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    return arrow_csv.read_csv(
        pa.BufferReader(rows),
        read_options=arrow_csv.ReadOptions(column_names=[str(k) for k in range(len(text.names))]),
        parse_options=arrow_csv.ParseOptions(delimiter=text.layout.delimiter),
        convert_options=arrow_csv.ConvertOptions(
            column_types={str(k): pa.float64() for k in numbers},
            null_values=EMPTY,
            strings_can_be_null=True,
            check_utf8=False,
            decimal_point=text.layout.decimal,
        ),
    )


def _parse_by_row(text: Text, positions: list[int]) -> RawTable:
    """Parse row by row: drop the bad rows, or raise the error of the first."""
    content = text.content if text.content is not None else read_bytes(text.path)
    lines = re.split(r"\r?\n|\r", _BLANK_END.sub(b"\n", content).decode("utf-8", "replace"))[text.skip :]
    rows: list[list[Any]] = []
    numbers: list[int] = []  # of these rows in the file, from 0
    bad: list[tuple[int, str]] = []
    for number, line in enumerate(lines):
        if not line.strip():
            continue
        cells = cells_of(line, text.layout.delimiter)
        wrong = _problem_of(text, line, cells, positions)
        if wrong:
            bad.append((number, wrong))
            continue
        row: list[Any] = list(cells)
        for k in positions:
            row[k] = np.nan if cells[k] in EMPTY else float(cells[k].replace(text.layout.decimal, "."))
        rows.append(row)
        numbers.append(number)
    if bad and not text.layout.drop_bad_rows:
        number, wrong = bad[0]
        raise FileFormatError(
            f"{text.path}: {wrong} in data row {number + 1} ({len(bad)} such rows). Repair the file, or set "
            "drop_bad_rows = true in a map (`column_map` FILE).",
            row=number + 1,
        )
    kinds = [np.float64 if k in positions else object for k in range(len(text.names))]
    columns = [np.array([row[k] for row in rows], dtype=kind) for k, kind in enumerate(kinds)]
    return RawTable(
        source=str(text.path),
        names=text.names,
        columns=tuple(columns),
        rows=np.array(numbers, dtype=np.int64),
        dropped=len(bad),
    )


def _problem_of(text: Text, line: str, cells: list[str], positions: list[int]) -> str:
    """Return what is wrong with a row, "" if nothing is."""
    if line.count('"') % 2:
        return f"expected quotes that close in their row, got {line[:40]!r}"
    if len(cells) != len(text.names):
        return f"expected {len(text.names)} columns in every row, got {len(cells)}"
    for k in positions:
        if cells[k] not in EMPTY and not _NUMBER.fullmatch(cells[k].replace(text.layout.decimal, ".")):
            return f"column {text.names[k]!r}: expected numbers, got {cells[k][:40]!r}"
    return ""
