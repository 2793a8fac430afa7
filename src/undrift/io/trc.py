"""TRC marker files, plain or gzip: four or five header lines, then frame, time and x, y, z of every marker.

Header tabs differ between programs (labels every three columns, or every two), so a label belongs to the next
triple in order. Rows are tab separated; an empty cell, a row that ends early, and the point 0, 0, 0 that some programs write
for a marker they lost, are gaps.
"""

from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.io.files import read_bytes
from undrift.io.markers import Markers, Up, level_from, unique_labels
from undrift.units import si_factor

_HEAD = ("DataRate", "NumMarkers", "Units")


def read_trc(path: str | Path, *, up: Up) -> Markers:
    """Read marker trajectories from a TRC file.

    Parameters
    ----------
    path : str or Path
        The file, plain or gzip.
    up : str
        Laboratory axis that points up, "y" (OpenSim's habit) or "z"; the file does not say.

    Returns
    -------
    Markers
        m, z up, gaps NaN.

    Raises
    ------
    InputError
        No such file, an axis that is not one, time that goes back.
    FileFormatError
        Not a TRC file, a header that disagrees with the rows, text among the numbers.
    """
    path = Path(path)
    lines = _lines(path)
    keys, values = lines[1].split("\t"), lines[2].split("\t")
    head = dict(zip((key.strip() for key in keys), (value.strip() for value in values), strict=False))
    if not all(head.get(key) for key in _HEAD):
        raise FileFormatError(
            f"{path}: wanted {', '.join(_HEAD)} in lines 2 and 3, got {', '.join(filter(None, head))}"
        )
    labels = tuple(cell.strip() for cell in lines[3].split("\t")[2:] if cell.strip())
    wanted = _whole(head["NumMarkers"], path)
    if len(labels) != wanted:
        raise FileFormatError(f"{path}: wanted {wanted} marker labels in line 4 (NumMarkers), got {len(labels)}")
    time, cells = _rows(lines, 2 + 3 * wanted, path)
    if len(time) < 2:
        raise FileFormatError(f"{path}: wanted two frames or more, got {len(time)}; the file is cut")
    points = cells.reshape(len(time), wanted, 3) * si_factor(head["Units"], "length")
    points[~np.isfinite(points).all(axis=2) | (points == 0.0).all(axis=2)] = np.nan
    try:
        return Markers(labels=unique_labels(labels), time=time, points=level_from(points, up), name=path.name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _lines(path: Path) -> list[str]:
    try:
        text = read_bytes(path).decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileFormatError(
            f"{path}: wanted a TRC file in UTF-8, got other bytes at {error.start}; save it again"
        ) from error
    lines = text.splitlines()
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        raise FileFormatError(
            f"{path}: wanted a TRC file (first word PathFileType), got {lines[0][:40] if lines else ''!r}"
        )
    return lines


def _rows(lines: list[str], width: int, path: Path) -> tuple[FloatArray, FloatArray]:
    """Return time (N,) and cells (N, width - 2), short rows filled with NaN."""
    rows = [(number, line.split("\t")) for number, line in enumerate(lines[5:], start=6) if line.strip()]
    out = np.full((len(rows), width), np.nan)
    for row, (number, cells) in enumerate(rows):
        extra = [cell for cell in cells[width:] if cell.strip()]
        if extra or len(cells) < 2:
            raise FileFormatError(
                f"{path}: wanted {width} columns in line {number}, got {len(cells)}; the header disagrees"
            )
        try:
            out[row, : min(width, len(cells))] = [float(cell) if cell.strip() else np.nan for cell in cells[:width]]
        except ValueError as error:
            raise FileFormatError(
                f"{path}: wanted numbers in line {number}, got text ({error}); repair the line"
            ) from error
    return out[:, 1], out[:, 2:]


def _whole(text: str, path: Path) -> int:
    if not text.isdigit() or int(text) < 1:
        raise FileFormatError(f"{path}: wanted NumMarkers of 1 or more in line 3, got {text!r}")
    return int(text)
