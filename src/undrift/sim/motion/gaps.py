"""Gaps: the stretches of a recording over which one spline may be drawn, and how much of each is to be believed.

A pose that is missing for no longer than ``gap_s`` is bridged. A longer gap ends the stretch: nothing is drawn across it, and
beside it ``trim_s`` is taken off, where the filter and the spline still lean on the edge. The ends of the recording lose
``end_trim_s``.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.errors import InputError

FEWEST = 12  # poses in a stretch: twice what a quintic needs to be one


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stretch:
    """Poses without a long gap among them.

    Parameters
    ----------
    rows : array of int, shape (K,)
        Rows of the recording that were seen.
    start_s, stop_s : float
        From where to where the motion is known, s: the stretch less what is trimmed.
    """

    rows: IntArray
    start_s: float
    stop_s: float


def find_stretches(
    time: FloatArray, seen: BoolArray, *, gap_s: float = 0.1, trim_s: float = 0.2, end_trim_s: float = 0.1
) -> tuple[Stretch, ...]:
    """Return the stretches between long gaps.

    Parameters
    ----------
    time : array, shape (N,)
        s.
    seen : array of bool, shape (N,)
        Whether there is a pose.
    gap_s : float
        Longest time between two neighbouring poses that is bridged, s.
    trim_s : float
        Taken off beside a longer gap, s.
    end_trim_s : float
        Taken off at the ends of the recording, s.

    Returns
    -------
    tuple of Stretch
        In order of time; those too short to leave anything are left out.

    Raises
    ------
    InputError
        No stretch is left.
    """
    rows = np.flatnonzero(seen)
    breaks = np.flatnonzero(np.diff(time[rows]) > gap_s * (1.0 + 1e-9)) + 1
    found = []
    for piece in np.split(rows, breaks):
        if len(piece) < FEWEST:
            continue
        before = end_trim_s if piece[0] == 0 else trim_s
        after = end_trim_s if piece[-1] == len(time) - 1 else trim_s
        start, stop = float(time[piece[0]]) + before, float(time[piece[-1]]) - after
        if stop > start:
            found.append(Stretch(rows=piece, start_s=start, stop_s=stop))
    if not found:
        raise InputError(
            f"poses: wanted a stretch of {FEWEST} poses or more without a gap over {gap_s:g} s, longer than what is trimmed, "
            f"got none among {len(rows)} poses seen of {len(time)}; trim less or record without gaps"
        )
    return tuple(found)
