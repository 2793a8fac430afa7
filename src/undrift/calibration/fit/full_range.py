"""Readings that stuck at the end of the range in free poses, moves or turns by hand."""

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.plausibility import check_saturation

_COARSE = 5  # equal readings in a row inside the range: steps so coarse that a run at its end says nothing


def check_range(windows: list[FloatArray], what: str) -> None:
    """Raise when a triad sticks at its largest or smallest reading, over all windows together.

    A column that repeats itself inside its range too (a coarse converter, or samples written twice) is left alone, and so is
    the rounded top of a turn: there as many readings lie one sample's change below the end as at it.

    Parameters
    ----------
    windows : list of array, shape (n_i, 3)
        Readings of the stretches that a fit uses, any unit; gaps are NaN.
    what : str
        Which readings.

    Raises
    ------
    Implausible
        With the axis, the number of samples and the reading they stick at.
    """
    if not windows:
        return
    values = np.concatenate(windows)
    told = np.full_like(values, np.nan)
    for axis, column in enumerate(values.T):
        if _longest_inside(column) < _COARSE:
            told[:, axis] = column
            for sign in (1.0, -1.0):
                if not _piles_up(sign * column):
                    told[sign * column == np.nanmax(sign * column), axis] = np.nanmedian(
                        column
                    )  # a rounded top, no end
    check_saturation(told, what)


def _piles_up(column: FloatArray) -> bool:
    """Tell whether more readings lie at the upper end than within one sample's change of it."""
    finite = column[np.isfinite(column)]
    change = np.abs(np.diff(finite))
    band = float(np.median(change[change > 0.0])) if (change > 0.0).any() else 0.0
    below = finite.max() - finite
    return bool((below == 0.0).sum() > ((below > 0.0) & (below <= band)).sum())


def _longest_inside(column: FloatArray) -> int:
    """Return the longest run of equal readings that are neither the largest nor the smallest."""
    finite = column[np.isfinite(column)]
    if not len(finite):
        return _COARSE
    begins = np.flatnonzero(np.concatenate(([True], np.diff(finite) != 0.0)))
    length = np.diff(np.append(begins, len(finite)))
    inside = (finite[begins] != finite.max()) & (finite[begins] != finite.min())
    return int(length[inside].max()) if inside.any() else 0
