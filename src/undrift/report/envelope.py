"""Envelope: a course with few enough points to draw, that keeps its least and largest value in every column of the picture."""

from itertools import pairwise

import numpy as np

from undrift.arrays import FloatArray, IntArray

COLUMNS_DRAWN = 2000  # more than a picture of 8.2 inches shows apart


def envelope(time: FloatArray, values: FloatArray, columns: int = COLUMNS_DRAWN) -> tuple[FloatArray, FloatArray]:
    """Return the points of a course that its picture needs: the least and the largest of each column, in order of time.

    The points on either side of a gap are kept too, and a gap between two points stays one: no line is drawn across it, and
    none is lost between two gaps.

    Parameters
    ----------
    time : array, shape (N,)
        s.
    values : array, shape (N,)
        Any unit; NaN is a gap.
    columns : int
        Columns of the picture; a course of no more than two points a column is returned as it is.

    Returns
    -------
    time : array, shape (M,)
        s, of the points kept.
    values : array, shape (M,)
        Theirs.
    """
    if len(values) <= 2 * columns:
        return time, values
    gaps = np.isnan(values)
    edges = np.linspace(0, len(values), columns + 1).astype(np.int64)
    low = [a + int(np.argmin(part)) for a, part in _columns(np.where(gaps, np.inf, values), edges)]
    high = [a + int(np.argmax(part)) for a, part in _columns(np.where(gaps, -np.inf, values), edges)]
    beside = np.flatnonzero(np.diff(gaps))
    kept = np.unique(np.concatenate((low, high, beside, beside + 1)))
    return time[kept], values[kept]


def _columns(values: FloatArray, edges: IntArray) -> list[tuple[int, FloatArray]]:
    return [(int(a), values[a:b]) for a, b in pairwise(edges)]
