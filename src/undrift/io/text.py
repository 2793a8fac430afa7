"""Text tables: comma, tab, semicolon or blank separated, plain or gzip, parsed by Arrow and checked row by row only on failure."""

import csv
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import BoolArray
from undrift.errors import FileFormatError
from undrift.io.columns import Column, TextLayout
from undrift.io.files import checked_file, is_gzip, read_bytes
from undrift.io.table import Table, find_column

MARK = b"# undrift "
EMPTY = ["", "NaN", "nan", "NAN", "NA", "N/A", "n/a", "null", "NULL", "None", "-nan", "#N/A"]
_HEAD = 1 << 20
_NUMBER = r"^[ \t\r]*[-+]?(\d+\.?\d*([eE][-+]?\d+)?|\.\d+([eE][-+]?\d+)?|[iI][nN][fF](inity)?)[ \t\r]*$"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Text:
    """A text table, opened and its header read, its rows not parsed yet.

    Parameters
    ----------
    path : Path
        The file.
    content : bytes or None
        Unpacked text; None when Arrow may read the file itself.
    head : bytes
        The first MiB of the text.
    names : tuple of str
        Header, or positions as text.
    layout : TextLayout
        As asked for.
    skip : int
        Lines before the first row.
    mark : str
        undrift's own first line, "" where there is none.
    """

    path: Path
    content: bytes | None
    head: bytes
    names: tuple[str, ...]
    layout: TextLayout
    skip: int
    mark: str


def open_text(path: str | Path, layout: TextLayout | None = None) -> Text:
    """Open a text table and read its header.

    Parameters
    ----------
    path : str or Path
        The file, plain or gzip.
    layout : TextLayout or None
        How it is laid out; None for commas and a header.

    Returns
    -------
    Text
        Ready to parse.

    Raises
    ------
    InputError
        No such file.
    FileFormatError
        Empty, binary, not UTF-8 in the header, or fewer lines than are to be skipped.
    """
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
    """Parse the rows of a text table.

    Parameters
    ----------
    text : Text
        From :func:`open_text`.
    wanted : tuple of str or int
        Columns that must be numbers; the others are left as they are.

    Returns
    -------
    Table
        All columns, with the count of rows left out.

    Raises
    ------
    InputError
        A wanted column that is not there.
    FileFormatError
        A row with another number of columns, or text in a wanted column, unless the layout says to drop such rows.
    """
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
