"""Text tables, separated by comma, tab, semicolon or space, plain or gzip. CSV is read with a ColumnMap or undrift's own names.

Arrow parses the rows. Only if this fails are they checked one by one. undrift writes the unit into every column name, and nothing
before the header. Frame, state and device are stored in NAME.csv.json, next to NAME.csv, if they differ from the defaults (sensor
axes, raw, no device). A corrected file is therefore never corrected twice. The same file lists columns, units and provenance.
"""

import csv
import io
import json
import os
import re
from collections import Counter
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
from undrift.io.arrow import to_arrow
from undrift.io.column_map import READ_SETTINGS, Column, ColumnMap, TextLayout, native_map
from undrift.io.columns import (
    FORMAT,
    KIND,
    RawTable,
    find_column,
    is_date,
    is_number,
    marks_of,
    native_columns,
    read_marks,
)
from undrift.io.labels import is_unit
from undrift.record import Record

Provenance: TypeAlias = Mapping[str, Any]  # key for the origin of a record and its program, as JSON
EMPTY = ["", "NaN", "nan", "NAN", "NA", "N/A", "n/a", "null", "NULL", "None", "-nan", "#N/A"]
_HEAD = 1 << 20  # bytes at the start
_LINES = 1 << 16  # number of bytes at the start from which the layout is determined
_NUMERIC = 0.6  # smallest share of the filled cells in a row of readings, and in a row of units
_NO_LINE_END = "the last row has no line end: it may be cut"
_PIECE = 1 << 24  # number of bytes that are parsed at a time
_LINE = 1 << 12  # number of bytes at the end that are searched for blank lines
_INK = re.compile(rb"\S")
_BLANK_END = re.compile(rb"(?:\n[ \t\r,;]*)+\Z")  # lines at the end without filled cells
_NUMBER = re.compile(r"[ \t\r]*[-+]?(\d+\.?\d*([eE][-+]?\d+)?|\.\d+([eE][-+]?\d+)?|(?i:inf(inity)?))[ \t\r]*", re.ASCII)


def read_csv(path: str | Path, how: ColumnMap = READ_SETTINGS) -> RawTable:
    """Read a text table, with a map or with undrift's own names."""
    path = Path(path)
    text = open_text(path, how)
    own = None if how.columns else native_map(text.names, how, source=str(path))
    marks = None if own is None else _read_sidecar(path, text.names)
    table = parse_text(text, (own or how).wanted(numeric=True))
    if own is None:
        return replace(table, notes=(*table.notes, *_skipped_readings(text)))
    own = own if marks is None or how.gaps else own.but(gaps="keep")  # empty cells are gaps
    return replace(table, notes=(*table.notes, *own.unread(text.names)), own=own, marks=marks or {})


def _skipped_readings(text: "Text") -> list[str]:
    """Return a note for each line before the header or the first row that is a row of readings."""
    lines = text.head.decode("utf-8", "replace").splitlines()[: text.layout.skip_rows]
    rows = [(k, cells_of(line, text.layout.delimiter)) for k, line in enumerate(lines, 1)]
    readings = [k for k, cells in rows if len(cells) == len(text.names) and _is_row(cells, text.layout.decimal)]
    return [f"line {k} is left out by skip_rows and looks like a row of readings" for k in readings]


def write_csv(record: Record, path: str | Path, made_by: Provenance | None = None) -> None:
    """Write a record with undrift's own column names. Every number is read back without loss."""
    path, (names, columns), beside = Path(path), native_columns(record), None
    if made_by or record.frame != "s" or record.state != "raw" or record.device:
        beside = json.dumps(statement_of(record, path, names) | {"provenance": made_by or None}, indent=1) + "\n"
    write_rows(path, names, columns, {sidecar_of(path): beside})  # or removes an earlier one


def sidecar_of(path: Path) -> Path:
    """Return the name of the file that describes a CSV file, for example walk.csv.json for walk.csv."""
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
    """Return the content of the JSON file next to a table, or None if undrift did not write such a file."""
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
        return None  # a file of another program
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
    """Write named columns as CSV, with empty cells for gaps, and their JSON file. Every number is read back without loss."""
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

    return pa.table([to_arrow(column, empty=True) for column in columns], names=list(names))


class Appender:
    """Writer of lines to a new file, piece by piece. The file is complete after each piece, even if the program is interrupted."""

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
            with suppress(OSError):  # the file may not be open
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
    """A text table with known layout, whose rows are not parsed yet."""

    path: Path
    names: tuple[str, ...]  # header, or positions as text
    layout: TextLayout
    skip: int = 0  # lines before the first row
    content: bytes | None = None  # unpacked text, or None if Arrow can read the file itself
    head: bytes  # first MiB of the text
    preamble: tuple[str, ...] = ()  # lines before the header
    units: tuple[str, ...] = ()  # cells of the unit row, if there is one

    def cells(self, number: int = 0) -> list[str]:
        """Return the cells of a row with decimal points, or no cells if there is no such row."""
        lines = self.head.splitlines()[self.skip + number : self.skip + number + 1]
        text = [line.decode("utf-8", "replace").replace(self.layout.decimal, ".") for line in lines]
        return cells_of(text[0], self.layout.delimiter) if text else []


def text_of(path: Path, content: bytes, names: tuple[str, ...], layout: TextLayout | None = None) -> Text:
    """Return rows without a header as a text table."""
    return Text(
        path=path, content=content, head=content[:_HEAD], names=names, layout=layout or TextLayout(header=False)
    )


def open_text(path: str | Path, layout: TextLayout | None = None) -> Text:
    """Open a text table with a known layout and read its header."""
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
        if _is_readings(names, layout.decimal):
            layout = layout.but(header=False)
    if not layout.header:  # positions, one for each column of most of the first rows
        counts = [line.count(layout.delimiter.encode()) + 1 for line in lines]
        names = tuple(str(i) for i in range(max(set(counts), key=counts.count)))
    return Text(path=path, content=content, head=head, names=names, layout=layout, skip=skip + layout.header)


# ---- layout of a text, determined from its first lines


def sniff(path: str | Path) -> Text:
    """Open a text table with the layout that its first lines suggest."""
    path = Path(path)
    head = read_bytes(path, _LINES)
    table = find_table(path, head)
    if table is None:  # the first line with text consists of words: it is the header
        lines = [line.decode("utf-8", "replace") for line in head.splitlines()[:64]]
        delimiter, decimal = separators_of([line for line in lines if line.strip()])
        blank = next((k for k, line in enumerate(lines) if line.strip()), 0)
        return open_text(path, TextLayout(delimiter=delimiter, decimal=decimal, skip_rows=blank))
    text = open_text(path, table.layout)
    if table.layout.header and len(text.names) != len(table.names):  # a map cannot name its columns
        text = open_text(path, table.layout.but(header=False, skip_rows=table.skip))
    return replace(text, skip=text.skip + bool(table.units), preamble=table.preamble, units=table.units)


def find_table(path: Path, content: bytes) -> Text | None:
    """Return the table in a text in UTF-8 or Latin-1, or None without successive rows of numbers."""
    content = as_utf8(content)
    lines = [line.decode("utf-8", "replace") for line in content[:_LINES].splitlines()]
    lines = lines[:-1] if len(content) > _LINES else lines
    delimiter, decimal = separators_of([line for line in lines if line.strip()])
    table = [cells_of(line, delimiter) for line in lines]
    rows = [k for k, cells in enumerate(table) if _is_row(cells, decimal)]
    start = next((k for k in rows if k + 1 in rows or k + 2 in rows or k == len(table) - 1), None)
    if start is None:
        return None
    above = [k for k in range(start) if lines[k].strip()]
    if is_numbered(table[start]) and start + 1 in rows and not (above and len(table[above[-1]]) == len(table[start])):
        above, start = [*above, start], start + 1  # the columns are numbered, not named
    width = Counter(len(table[k]) for k in rows if k >= start).most_common(1)[0][0]
    units: tuple[str, ...] = ()
    if len(above) > 1 and _are_units(table[above[-1]]) and not _are_units(table[above[-2]]):
        units = tuple(_bare(cell) for cell in table[above.pop()])
    at = above[-1] if above else start
    names = [] if is_numbered(table[at]) else table[at][:]
    while len(names) > width and not names[-1]:
        names.pop()
    filled = sum(map(bool, names))
    header = at < start and width <= 2 * filled <= 4 * width  # otherwise it is the banner of a program
    if header:
        width = max(width, len(names))
    else:
        start = next(k for k in rows if k >= start and len(table[k]) == width)  # not the remainder of a row
    names = (names + [""] * width)[:width] if header else [*map(str, range(width))]
    return Text(
        path=path,
        content=(content := packed(content) if delimiter == " " else content),
        head=content[:_HEAD],
        preamble=tuple(lines[: at if header else start]),
        names=tuple(names),
        units=(units + ("",) * width)[:width] if units else (),
        layout=TextLayout(delimiter=delimiter, decimal=decimal, header=header, skip_rows=at if header else start),
        skip=start,
    )


def as_utf8(content: bytes) -> bytes:
    """Return text as UTF-8 without a byte-order mark. Text that is not UTF-8 is read as Latin-1."""
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        content = content.decode("cp1252", "replace").encode("utf-8")
    return content.removeprefix(b"\xef\xbb\xbf")


def separators_of(lines: list[str]) -> tuple[str, str]:
    """Return delimiter and decimal sign of most lines. A comma is a delimiter only if no other character can be."""
    body = lines[-max(2, len(lines) // 4) :][-32:]
    delimiter = next((mark for mark in ";\t," if sum(mark in line for line in body) > 0.8 * len(body)), " ")
    if delimiter == ",":
        return delimiter, "."
    cells = [cell for line in body for cell in cells_of(line, delimiter)]
    commas = sum(bool(re.fullmatch(r"[-+]?\d+,\d+([eE][-+]?\d+)?", cell)) for cell in cells)
    points = sum(bool(re.fullmatch(r"[-+]?\d*\.\d+([eE][-+]?\d+)?", cell)) for cell in cells)
    return delimiter, "," if commas > points else "."


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line."""
    if delimiter == " ":
        return [cell for cell in re.split(r"[ \t\r\n]+", line) if cell]
    quoted = '"' in line and "\r" not in line and len(line) < csv.field_size_limit()
    cells = next(csv.reader([line], delimiter=delimiter), []) if quoted else line.split(delimiter)
    return [cell.strip(" \t") for cell in cells]


def packed(rows: bytes) -> bytes:
    """Return rows with each run of spaces and tabs replaced by one space, as the parser requires."""
    return re.sub(rb"^ | $", b"", re.sub(rb"[ \t]+", b" ", rows.replace(b"\r\n", b"\n")), flags=re.MULTILINE)


def _is_row(cells: list[str], decimal: str) -> bool:
    """Return True if most filled cells of a line are numbers."""
    filled = [cell.replace(decimal, ".") for cell in cells if cell]
    numbers = sum(is_number(cell) or is_date(cell) for cell in filled)
    return numbers >= min(3, len(cells)) > 0 and numbers >= _NUMERIC * len(filled)


def is_numbered(cells: list[str]) -> bool:
    """Return True for positions of columns instead of names: 0, 1, 2, ..."""
    return len(cells) > 2 and all(cell.isdecimal() for cell in cells) and set(np.diff([*map(int, cells)])) == {1}


def _is_readings(names: tuple[str, ...], decimal: str) -> bool:
    """Return True if a header is a row of readings: all cells but one are numbers and not column positions."""
    cells = [float(cell) for name in names if is_number(cell := name.replace(decimal, "."))]
    return len(cells) > 1 and len(cells) >= len(names) - 1 and bool((np.diff(cells) != 1.0).any())


def _bare(cell: str) -> str:
    """Return a unit without the brackets around it."""
    return cell[1:-1].strip() if re.fullmatch(r"\([^()]*\)|\[[^\[\]]*\]", cell) else cell


def _are_units(cells: list[str]) -> bool:
    filled = [_bare(cell) for cell in cells if cell]
    return bool(filled) and sum(is_unit(cell) for cell in filled) >= _NUMERIC * len(filled)


# ---- rows


def parse_text(text: Text, wanted: tuple[Column, ...]) -> RawTable:
    """Parse the rows of a text table piece by piece, or row by row if this fails."""
    import pyarrow as pa

    positions = [find_column(text.names, column, str(text.path)) for column in wanted]
    start = sum(map(len, text.head.splitlines(keepends=True)[: text.skip]))
    if not text.head[start:].strip():
        return RawTable(source=str(text.path), names=text.names, columns=tuple(np.empty(0) for _ in text.names))
    size = text.path.stat().st_size if text.content is None else len(text.content)
    try:
        parsed = pa.concat_tables(_pieces(text, start, size, positions), promote_options="permissive")
        table = RawTable(source=str(text.path), names=text.names, columns=tuple(parsed.columns))
    except (pa.ArrowInvalid, pa.ArrowTypeError):  # a bad row, or a column that changes from numbers to words
        table = _parse_by_row(text, positions)
    return table if _ends_with_line(text) else replace(table, notes=(_NO_LINE_END,))


def _ends_with_line(text: Text) -> bool:
    """Return True if the last line of a text ends with a line end."""
    if text.content is not None:
        return text.content.endswith(b"\n")
    with text.path.open("rb") as handle:
        handle.seek(-1, os.SEEK_END)
        return handle.read() in (b"\n", b"\r")


def _pieces(text: Text, start: int, size: int, positions: list[int]) -> Iterator[Any]:
    """Yield the rows of a text from its byte ``start`` to ``size``, parsed some megabytes at a time."""
    import pyarrow as pa

    taken = 0
    # one buffer for all pieces, because allocating memory takes as long as reading into it
    buffer = bytearray(min(size, _PIECE))
    with text.path.open("rb") if text.content is None else io.BytesIO(text.content) as handle:
        handle.seek(start)
        while end := handle.readinto(buffer):
            end = buffer.rfind(b"\n", 0, end) + 1 if start + end < size else end  # the remainder begins the next piece
            quotes = buffer.find(b'"', 0, end) >= 0 and any(
                row.count(b'"') % 2 for row in bytes(buffer[:end]).split(b"\n")
            )
            if not end or quotes:  # Arrow would read all rows after an unclosed quote as one cell
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
    numbers: list[int] = []  # positions of these rows in the file, from 0
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
    """Return the problem of a row, or "" if it has none."""
    if line.count('"') % 2:
        return f"expected quotes that close in their row, got {line[:40]!r}"
    if len(cells) != len(text.names):
        return f"expected {len(text.names)} columns in every row, got {len(cells)}"
    for k in positions:
        if cells[k] not in EMPTY and not _NUMBER.fullmatch(cells[k].replace(text.layout.decimal, ".")):
            return f"column {text.names[k]!r}: expected numbers, got {cells[k][:40]!r}"
    return ""
