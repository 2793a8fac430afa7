"""Readings that stuck at the end of the range in free poses, moves or turns by hand."""

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.model import AXES
from undrift.errors import Implausible

_RUN = 5  # equal readings in a row: at an end it is the converter's, unless readings inside repeat as long
_LEAST_VALUES = 20  # different readings; fewer are a constant or steps, with no top to speak of


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
    for name, column in zip(AXES, np.concatenate(windows).T, strict=True):
        finite = column[np.isfinite(column)]
        if len(np.unique(finite)) < _LEAST_VALUES or _longest_inside(finite) >= _RUN:
            continue
        for end in (finite.max(), finite.min()):
            stuck = finite == end
            if _longest(stuck) >= _RUN and _piles_up(finite, end):
                raise Implausible(
                    f"{what}: wanted {name} readings inside the range, got {int(stuck.sum())} samples stuck at {end:g}; choose a "
                    "wider range or move more slowly",
                    samples=int(stuck.sum()),
                    extreme=float(end),
                )


def _piles_up(finite: FloatArray, end: float) -> bool:
    """Tell whether more readings lie at an end than within one sample's change of it."""
    change = np.abs(np.diff(finite))
    away = np.abs(finite - end)
    return bool((away == 0.0).sum() > ((away > 0.0) & (away <= np.median(change[change > 0.0]))).sum())


def _longest_inside(finite: FloatArray) -> int:
    """Return the longest run of equal readings that are neither the largest nor the smallest."""
    begins = np.flatnonzero(np.concatenate(([True], np.diff(finite) != 0.0)))
    length = np.diff(np.append(begins, len(finite)))
    inside = (finite[begins] != finite.max()) & (finite[begins] != finite.min())
    return int(length[inside].max()) if inside.any() else 0


def _longest(flag: BoolArray) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flag.astype(np.int8), [0]))))
    return int((edges[1::2] - edges[::2]).max()) if len(edges) else 0
