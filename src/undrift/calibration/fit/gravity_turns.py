"""Whether gyroscopes that were fitted to stated turns turn gravity as the accelerometer sees it, from rest to rest.

::

    C(P^T M (u - o)) n_before = n_after        P one of the 48 signed permutations

The fit is right where P = 1 misses the later direction by least. Full turns bring gravity back whatever the axes are, and so do
the means on the faces: it is the moves between the rests that tell a triad whose axes are not the accelerometer's.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.axis_order import cause_by_gravity, told_order
from undrift.calibration.fit.multi_position_turns import Moves, cut_moves, gravity_directions
from undrift.calibration.model import TriadModel
from undrift.errors import Implausible
from undrift.record import Record
from undrift.session import Still
from undrift.units import RADIAN_PER_DEGREE

LARGEST_MISS_DEG = (
    20.0  # rms: hand moves and an offset that drifts miss by a few degrees, an exchanged axis by 60 and more
)
_CLEARLY = 0.5  # another order must miss by less than this share to be named
_LEAST_MOVES = 3
_SIGNS = tuple(itertools.product((1.0, -1.0), repeat=3))


def check_turns_gravity(
    records: Sequence[Record], stills: Sequence[Still], accel: TriadModel, gyro: TriadModel
) -> None:
    """Raise when fitted gyroscopes turn gravity far better with their axes in another order.

    Parameters
    ----------
    records : sequence of Record
        With both triads, in the same units.
    stills : sequence of Still
        Rests; moves run from one to the next of a recording.
    accel : TriadModel
        Accelerometer of the same session.
    gyro : TriadModel
        Gyroscopes to be checked.

    Raises
    ------
    Implausible
        With the order that fits, and which columns would have to be exchanged.
    """
    moves = cut_moves(records, stills, stills)
    if len(moves.first) < _LEAST_MOVES:
        return
    n = gravity_directions(moves, accel).unit
    own = _miss_deg(moves, n, gyro.matrix, gyro.offset)
    if own <= LARGEST_MISS_DEG:
        return
    orders = [_signed(order, signs) for order in itertools.permutations(range(3)) for signs in _SIGNS]
    misses = [_miss_deg(moves, n, order.T @ gyro.matrix, gyro.offset) for order in orders]
    best = int(np.argmin(misses))
    if misses[best] < _CLEARLY * own and not np.array_equal(orders[best], np.eye(3)):
        raise Implausible(
            f"gyro against accel: wanted gyroscopes that turn gravity from rest to rest, got moves that miss it by {own:.0f} deg "
            f"rms, and by {misses[best]:.0f} deg were the axes x, y, z of the gyroscopes {told_order(orders[best])} of the "
            f"accelerometer: {cause_by_gravity(orders[best])}; correct the order or the sign of the columns",
            miss_deg=own,
            seen=told_order(orders[best]),
        )


def _signed(order: tuple[int, ...], signs: tuple[float, ...]) -> FloatArray:
    matrix = np.zeros((3, 3))
    matrix[np.arange(3), order] = signs
    return matrix


def _miss_deg(moves: Moves, n: FloatArray, matrix: FloatArray, offset: FloatArray) -> float:
    from undrift.kernels.multi_position import rotations_between

    count = len(moves.first)
    rotation, sums = np.empty(9 * count), np.empty(36 * count)
    rotations_between(
        moves.gyro.reshape(-1),
        moves.time,
        moves.first,
        moves.last,
        np.ascontiguousarray(matrix).reshape(-1),
        offset,
        np.zeros(3 * count),
        rotation,
        sums,
    )
    arrived = (rotation.reshape(count, 3, 3).transpose(0, 2, 1) @ n[moves.before][:, :, None])[:, :, 0]
    cosine = np.clip((arrived * n[moves.after]).sum(axis=1), -1.0, 1.0)
    return float(np.sqrt(np.mean(np.arccos(cosine) ** 2))) / RADIAN_PER_DEGREE
