"""Motion: when does the body leave its first rest, and when has it come back to its last?

The author's mark of the reference says so where there is one; else the still phases of the record itself.
"""

from dataclasses import dataclass

import numpy as np

from undrift.errors import AlignmentError
from undrift.record import Record, Reference
from undrift.segments import find_still

LEAST_REST_S = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """The stretch between the first and the last rest of a recording.

    Parameters
    ----------
    start_s, stop_s : float
        On the record's clock, s: the first moment of motion, and the first moment after it.
    basis : str
        "mark of the reference" or "still phases of the record".
    """

    start_s: float
    stop_s: float
    basis: str


def find_motion(record: Record, reference: Reference, *, lag_s: float = 0.0) -> Motion:
    """Find the stretch of motion between the first and the last rest.

    Parameters
    ----------
    record : Record
        Any units.
    reference : Reference
        Its ``moving`` mark is used where it has one.
    lag_s : float
        How late the record's samples are, s: the mark is moved to the record's clock by it.

    Returns
    -------
    Motion
        On the record's clock.

    Raises
    ------
    AlignmentError
        Nothing moves, or there is no rest of 3 s before the motion.
    """
    if reference.moving is not None and (reference.moving > 0.0).any():
        marked = reference.time[np.flatnonzero(reference.moving > 0.0)] + lag_s
        step = float(np.median(np.diff(reference.time)))
        motion = Motion(start_s=float(marked[0]), stop_s=float(marked[-1]) + step, basis="mark of the reference")
    else:
        motion = _between_stills(record)
    rest = motion.start_s - max(float(record.time[0]), float(reference.time[0]) + lag_s)
    if rest < LEAST_REST_S:
        raise AlignmentError(
            f"motion: wanted {LEAST_REST_S:g} s of rest or more before the motion, got {max(rest, 0.0):.1f} s "
            f"({motion.basis}); record the device lying still first",
            rest_s=rest,
        )
    return motion


def _between_stills(record: Record) -> Motion:
    search = find_still(record)
    long = [s for s in search.stills if record.time[s.stop - 1] - record.time[s.start] >= LEAST_REST_S]
    if not long:
        raise AlignmentError(
            f"motion: wanted a still phase of {LEAST_REST_S:g} s before the motion, got none"
            + (f" ({search.reason})" if search.reason else "")
            + "; give a reference with a motion mark, or record a rest first"
        )
    first, last = long[0], search.stills[-1]
    if last.stop < len(record) - 1 - record.sample_rate_hz * LEAST_REST_S or last is first:
        stop = float(record.time[-1])  # it moves to the end
    else:
        stop = float(record.time[last.start])
    start = float(record.time[first.stop - 1])
    if stop - start < 1.0:
        raise AlignmentError("motion: wanted a motion after the first rest, got none; the device lay still throughout")
    return Motion(start_s=start, stop_s=stop, basis="still phases of the record")
