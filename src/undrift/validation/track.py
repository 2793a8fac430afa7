"""Track: orientation from the readings of one recording alone, started from rest.

Tilt comes from the mean specific force over the rest before the motion, heading from the reference at the same rest; from
half a second before the motion on, only the gyroscope speaks::

    q(t_k) = q(t_(k-1)) exp(w_k (t_k - t_(k-1)))
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import AlignmentError, InputError
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotation_vector
from undrift.orientation.strapdown import check_gaps, integrate_strapdown
from undrift.orientation.tilt import shortest_rotation_up
from undrift.record import Record, Reference
from undrift.sync import Motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Integrated orientation.

    Parameters
    ----------
    time : array, shape (N,)
        s, record clock, from the start of the integration to the end of the record.
    q_nb : array, shape (N, 4)
        Orientation, w-x-y-z.
    """

    time: FloatArray
    q_nb: FloatArray

    def at(self, times: FloatArray) -> FloatArray:
        """Return the orientation at other times, along the great arc between samples.

        Parameters
        ----------
        times : array, shape (M,)
            s, record clock.

        Returns
        -------
        array, shape (M, 4)
            w-x-y-z; NaN outside the track.
        """
        k = np.clip(np.searchsorted(self.time, times, side="right") - 1, 0, len(self.time) - 2)
        share = (times - self.time[k]) / (self.time[k + 1] - self.time[k])
        step = rotation_vector(quaternion_product(quaternion_conjugate(self.q_nb[k]), self.q_nb[k + 1]))
        q = quaternion_product(self.q_nb[k], quaternion_of(step * share[:, None]))
        inside = (times >= self.time[0]) & (times <= self.time[-1])
        return np.where(inside[:, None], q, np.nan)


def track_from_rest(
    record: Record, reference: Reference, motion: Motion, *, shift_s: float, rest_s: float, lead_s: float
) -> Track:
    """Integrate the readings from the rest before the motion to the end of the record.

    Parameters
    ----------
    record : Record
        rad/s and m/s2, frame of the reference's body.
    reference : Reference
        Heading at rest; tilt too where the record has no accelerometer.
    motion : Motion
        On the record's clock.
    shift_s : float
        Record clock less reference clock, s.
    rest_s : float
        Rest before the motion over which tilt and heading are averaged, s.
    lead_s : float
        How long before the motion the integration starts, s.

    Returns
    -------
    Track
        Orientation in the reference's level frame.

    Raises
    ------
    InputError
        Gaps in the rate from the start of the integration on, or in the specific force all through the rest.
    AlignmentError
        The reference saw nothing of the rest.
    """
    if record.gyro is None:
        raise InputError("validate: wanted a record with a gyroscope, got none; map its columns")
    stop = motion.start_s - lead_s
    at_rest = (record.time >= motion.start_s - rest_s) & (record.time < stop)
    first = int(np.searchsorted(record.time, stop))
    check_gaps(record.gyro[first:], record.time[first:], "validate")
    start = _mean_pose(reference, motion.start_s - rest_s - shift_s, stop - shift_s)
    if record.accel is not None:
        force = record.accel[at_rest]
        force = force[np.isfinite(force).all(axis=1)]
        if not len(force):
            raise InputError(
                f"validate: wanted a specific force at rest before {stop:.6g} s, got nothing but gaps (NaN); correct without gaps "
                "(policy hold, temperatures filled in)"
            )
        start = _levelled(force.mean(axis=0), start)
    time = record.time[first:]
    return Track(time=time, q_nb=integrate_strapdown(record.gyro[first:], time, start))


def _mean_pose(reference: Reference, start_s: float, stop_s: float) -> FloatArray:
    seen: BoolArray = reference.valid & (reference.time >= start_s) & (reference.time < stop_s)
    if not seen.any():
        raise AlignmentError(
            f"validate: wanted the reference to see the rest from {start_s:.1f} s to {stop_s:.1f} s, got no pose there; "
            "heading needs one"
        )
    q = reference.q_nb[seen]
    q = (q * np.where(q @ q[0] < 0.0, -1.0, 1.0)[:, None]).mean(axis=0)
    mean: FloatArray = q / np.linalg.norm(q)
    return mean


def _levelled(accel: FloatArray, q_nb: FloatArray) -> FloatArray:
    # Tilt from specific force, then turned about the vertical until no heading error is left.
    tilt = shortest_rotation_up(accel)
    e = quaternion_product(q_nb, quaternion_conjugate(tilt))
    turn = np.array([e[0], 0.0, 0.0, e[3]])
    return quaternion_product(turn / np.linalg.norm(turn), tilt)
