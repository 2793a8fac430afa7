"""The axis that points up in each still phase of a record."""

from collections.abc import Sequence

import numpy as np

from undrift.record import Face, Record, Still
from undrift.segments import faces_of
from undrift.units import is_physical


def still_means(values: np.ndarray, stills: Sequence[Still]) -> np.ndarray:
    """Return the mean reading (P, 3) of each still phase, without gaps."""
    return np.array([np.nanmean(values[s.start : s.stop], axis=0) for s in stills]).reshape(-1, 3)


def faces_at(record: Record, stills: Sequence[Still]) -> list[Face | None]:
    """Return the face of each still, or None for a free pose."""
    return list(faces_of(still_means(np.asarray(record.accel), stills), centred=is_physical(record.accel_unit)))
