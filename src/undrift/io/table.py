"""Table: named columns as a file holds them, before any unit is applied. What every reader of tables makes."""

import csv
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.errors import FileFormatError, InputError
from undrift.files import checked_file, is_gzip, read_bytes
from undrift.io.columns import Column, TextLayout


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """Columns of one file."""

    source: str  # File, for the errors
    names: tuple[str, ...]  # Column names as in the file; positions as text where there is no header
    # One numpy array or Arrow column for each name, all of the same length; text where the cells are no numbers
    columns: tuple[Any, ...]
    # (N,), number of each row in the file, from 0, where rows were left out; None where none was
    rows: IntArray | None = None
    dropped: int = 0  # Rows left out

    def __len__(self) -> int:
        return len(self.columns[0]) if self.columns else 0

    def position(self, column: Column) -> int:
        """Return the position of a column."""
        return find_column(self.names, column, self.source)

    def numbers(self, column: Column) -> FloatArray:
        """Return a column as float64.

        Arrays:  -> (N,).
        """
        position = self.position(column)
        values = self.columns[position]
        if not isinstance(values, np.ndarray):
            values = _from_arrow(values)
        if values.dtype.kind not in "fiub":
            row, cell = _first_text(values)
            raise FileFormatError(
                f"{self.source}: column {self.names[position]!r}: wanted numbers, got {cell!r} in data row {self.row(row)}; "
                "repair the file, or set drop_bad_rows"
            )
        return np.asarray(values, dtype=np.float64)

    def row(self, index: int) -> int:
        """Return the number of a row in the file, from 1, the header not counted."""
        return int(index if self.rows is None else self.rows[index]) + 1


def find_column(names: tuple[str, ...], column: Column, source: str) -> int:
    """Return the position of a column in a header."""
    if isinstance(column, int):
        if 0 <= column < len(names):
            return column
        raise InputError(f"{source}: wanted column {column} (from 0), got {len(names)} columns; check the positions")
    hits = [i for i, name in enumerate(names) if name == column]
    hits = hits or [i for i, name in enumerate(names) if name.strip() == column.strip()]
    if len(hits) == 1:
        return hits[0]
    held = ", ".join(repr(name) for name in names[:16]) + (", ..." if len(names) > 16 else "")
    if hits:
        raise InputError(f"{source}: wanted one column {column!r}, got {len(hits)}; map by position from 0")
    raise InputError(f"{source}: wanted column {column!r}, got {held or 'no columns'}; check the mapping")


def _from_arrow(column: Any) -> NDArray[Any]:
    """Return an Arrow column as numpy: empty cells become NaN, a column of empty cells only is all NaN."""
    kind = str(column.type)
    if kind == "null":
        return np.full(len(column), np.nan)
    values: NDArray[Any] = np.asarray(column.to_numpy())
    return values if kind == "double" or values.dtype.kind in "fiu" else values.astype(object)


def _first_text(values: NDArray[Any]) -> tuple[int, str]:
    for row, cell in enumerate(values):
        try:
            float(cell)
        except (TypeError, ValueError):
            return row, str(cell)[:40]
    return 0, str(values[0])[:40] if len(values) else ""


# ---- Text tables: comma, tab, semicolon or blank separated, plain or gzip, parsed by Arrow and checked row by row only on failure.

MARK = b"# undrift "
EMPTY = ["", "NaN", "nan", "NAN", "NA", "N/A", "n/a", "null", "NULL", "None", "-nan", "#N/A"]
_HEAD = 1 << 20
_NUMBER = r"^[ \t\r]*[-+]?(\d+\.?\d*([eE][-+]?\d+)?|\.\d+([eE][-+]?\d+)?|[iI][nN][fF](inity)?)[ \t\r]*$"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Text:
    """A text table, opened and its header read, its rows not parsed yet."""

    path: Path  # The file
    content: bytes | None  # Unpacked text; None when Arrow may read the file itself
    head: bytes  # The first MiB of the text
    names: tuple[str, ...]  # Header, or positions as text
    layout: TextLayout  # As asked for
    skip: int  # Lines before the first row
    mark: str  # undrift's own first line, "" where there is none


def open_text(path: str | Path, layout: TextLayout | None = None) -> Text:
    """Open a text table and read its header."""
    layout = layout or TextLayout()
    path = checked_file(path)
    content = read_bytes(path) if is_gzip(path) or layout.delimiter == " " else None
    if content is not None and layout.delimiter == " ":
        content = _single_blanks(content)
    head = content[:_HEAD] if content is not None else read_bytes(path, _HEAD)
    if b"\0" in head[:4096]:
        raise FileFormatError(f"{path}: wanted UTF-8 text, got binary data or UTF-16; save it as UTF-8 text")
    mark = ""
    if head.startswith(MARK):
        mark = head.splitlines()[0].decode("utf-8", "replace")
    skip = layout.skip_rows + bool(mark)
    lines = head.splitlines()[skip : skip + 64]
    if not lines:
        raise FileFormatError(f"{path}: wanted rows after {skip} skipped lines, got none; check skip_rows")
    names = _header(lines[0], path, layout) if layout.header else _positions(lines, layout)
    return Text(path=path, content=content, head=head, names=names, layout=layout, skip=skip + layout.header, mark=mark)


def parse_text(text: Text, wanted: tuple[Column, ...]) -> Table:
    """Parse the rows of a text table."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    positions = [find_column(text.names, column, str(text.path)) for column in wanted]
    if not any(line.strip() for line in text.head.splitlines()[text.skip :]):
        return Table(source=str(text.path), names=text.names, columns=tuple(np.empty(0) for _ in text.names))
    try:
        parsed = arrow_csv.read_csv(
            _source(text),
            read_options=arrow_csv.ReadOptions(
                column_names=[str(i) for i in range(len(text.names))], skip_rows=text.skip, block_size=1 << 22
            ),
            parse_options=arrow_csv.ParseOptions(delimiter=text.layout.delimiter),
            convert_options=_convert(text, {str(i): pa.float64() for i in positions}),
        )
    except pa.ArrowInvalid:
        return _parse_dirty(text, positions)
    return Table(source=str(text.path), names=text.names, columns=tuple(parsed.columns))


def _parse_dirty(text: Text, positions: list[int]) -> Table:
    """Parse row by row: find the bad rows, and drop them or name the first."""
    import pyarrow as pa
    from pyarrow import compute as pc
    from pyarrow import csv as arrow_csv

    ragged: list[Any] = []

    def skip(row: Any) -> str:
        ragged.append(row)
        return "skip"

    try:
        parsed = arrow_csv.read_csv(
            _source(text),
            read_options=arrow_csv.ReadOptions(
                column_names=[str(i) for i in range(len(text.names))], skip_rows=text.skip, use_threads=False
            ),
            parse_options=arrow_csv.ParseOptions(delimiter=text.layout.delimiter, invalid_row_handler=skip),
            convert_options=_convert(text, {str(i): pa.binary() for i in range(len(text.names))}),
        )
    except pa.ArrowInvalid as error:
        raise FileFormatError(
            f"{text.path}: wanted rows of text, got something else: {str(error).splitlines()[0]}; check the file and the delimiter"
        ) from error
    if ragged and not text.layout.drop_bad_rows:
        row = ragged[0]
        raise FileFormatError(
            f"{text.path}: wanted {row.expected_columns} columns in every row, got {row.actual_columns} in data row "
            f"{row.number - text.skip} ({row.text[:40]!r}; {len(ragged)} such rows); repair them, or say "
            "drop_bad_rows = true in a map (--map FILE)",
            row=row.number - text.skip,
        )
    lost = np.array([row.number - text.skip - 1 for row in ragged], dtype=np.int64)
    rows = np.setdiff1d(np.arange(parsed.num_rows + len(lost)), lost)
    decimal = text.layout.decimal.encode()
    columns, good = list(parsed.columns), np.ones(parsed.num_rows, dtype=np.bool_)
    for i in positions:
        cells = columns[i] if decimal == b"." else pc.replace_substring(columns[i], decimal, b".")
        fine = _numeric(cells)
        if not fine.all() and not text.layout.drop_bad_rows:
            first = int(np.flatnonzero(~fine)[0])
            raise FileFormatError(
                f"{text.path}: column {text.names[i]!r}: wanted numbers, got {_shown(columns[i][first])} in data row "
                f"{rows[first] + 1} ({int((~fine).sum())} such rows); repair the file, or say drop_bad_rows = true "
                "in a map (--map FILE)",
                row=int(rows[first]) + 1,
            )
        good &= fine
        clean = pc.if_else(pa.array(fine), cells, None)
        columns[i] = pc.cast(pc.utf8_trim_whitespace(pc.cast(clean, pa.string())), pa.float64())
    mask = pa.array(good)
    return Table(
        source=str(text.path),
        names=text.names,
        columns=tuple(column.filter(mask) for column in columns),
        rows=rows[good],
        dropped=len(lost) + int((~good).sum()),
    )


def _convert(text: Text, types: dict[str, Any]) -> Any:
    from pyarrow import csv as arrow_csv

    return arrow_csv.ConvertOptions(
        column_types=types,
        null_values=EMPTY,
        strings_can_be_null=True,
        check_utf8=False,
        decimal_point=text.layout.decimal,
    )


def _source(text: Text) -> Any:
    import pyarrow as pa

    return pa.OSFile(str(text.path), "rb") if text.content is None else pa.BufferReader(text.content)


def _numeric(cells: Any) -> BoolArray:
    """True where a cell is a number or empty."""
    from pyarrow import compute as pc

    fine = pc.fill_null(pc.match_substring_regex(cells, _NUMBER), True)
    return np.asarray(fine.to_numpy(), dtype=np.bool_)


def _shown(cell: Any) -> str:
    return repr(cell.as_py()[:40].decode("utf-8", "replace"))


def _header(line: bytes, path: Path, layout: TextLayout) -> tuple[str, ...]:
    try:
        decoded = line.removeprefix(b"\xef\xbb\xbf").decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileFormatError(
            f"{path}: wanted UTF-8 text, got byte 0x{line[error.start]:02x} in the header; save the file as UTF-8"
        ) from error
    return tuple(
        next(csv.reader([decoded.strip(" ") if layout.delimiter == " " else decoded], delimiter=layout.delimiter), ())
    )


def _positions(lines: list[bytes], layout: TextLayout) -> tuple[str, ...]:
    """Return positions as names: as many as most of the first rows have columns."""
    counts = [line.count(layout.delimiter.encode()) + 1 for line in lines]
    return tuple(str(i) for i in range(max(set(counts), key=counts.count)))


def _single_blanks(content: bytes) -> bytes:
    """Return text with runs of blanks and tabs made one blank, and none at the ends of a line."""
    content = content.replace(b"\t", b" ").replace(b"\r\n", b"\n")
    while b"  " in content:
        content = content.replace(b"  ", b" ")
    return re.sub(rb"^ | $", b"", content, flags=re.MULTILINE)
