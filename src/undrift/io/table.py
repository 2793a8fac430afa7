"""Table: named columns as a file holds them, before any unit is applied. What every reader of tables makes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from undrift.arrays import FloatArray, IntArray
from undrift.errors import FileFormatError, InputError
from undrift.io.columns import Column


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """Columns of one file.

    Parameters
    ----------
    source : str
        File, for the errors.
    names : tuple of str
        Column names as in the file; positions as text where there is no header.
    columns : tuple of array
        One numpy array or Arrow column for each name, all of the same length; text where the cells are no numbers.
    rows : array, shape (N,), or None
        Number of each row in the file, from 0, where rows were left out; None where none was.
    dropped : int
        Rows left out.
    """

    source: str
    names: tuple[str, ...]
    columns: tuple[Any, ...]
    rows: IntArray | None = None
    dropped: int = 0

    def __len__(self) -> int:
        return len(self.columns[0]) if self.columns else 0

    def position(self, column: Column) -> int:
        """Return the position of a column.

        Parameters
        ----------
        column : str or int
            Name (blanks around it do not count) or position from 0.

        Returns
        -------
        int
            Position from 0.

        Raises
        ------
        InputError
            No such column, or two of that name.
        """
        return find_column(self.names, column, self.source)

    def numbers(self, column: Column) -> FloatArray:
        """Return a column as float64.

        Parameters
        ----------
        column : str or int
            Name or position.

        Returns
        -------
        array, shape (N,)
            NaN where the cell is empty.

        Raises
        ------
        InputError
            No such column.
        FileFormatError
            Text or infinity where a number is wanted; says in which row.
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
        """Return the number of a row in the file, from 1, the header not counted.

        Parameters
        ----------
        index : int
            Row of this table, from 0.

        Returns
        -------
        int
            As a person counts.
        """
        return int(index if self.rows is None else self.rows[index]) + 1


def find_column(names: tuple[str, ...], column: Column, source: str) -> int:
    """Return the position of a column in a header.

    Parameters
    ----------
    names : tuple of str
        Header.
    column : str or int
        Name (blanks around it do not count) or position from 0.
    source : str
        File, for the error.

    Returns
    -------
    int
        Position from 0.

    Raises
    ------
    InputError
        No such column, or two of that name.
    """
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
