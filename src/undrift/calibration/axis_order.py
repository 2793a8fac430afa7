"""Axis order: whether a gyroscope's columns stand in the order and sense of the axes they are said to have.

Of the 48 matrices with one +1 or -1 in every row and column, the one nearest to a gyroscope's forward matrix K, its rows
scaled to one, says what each column sees::

    P = argmax sum_ij P_ij K_ij / |K_i|        P_ij = +1: column i reads + for a turn about +j

Any P but the identity is an exchange of columns, a wrong sign, or axis labels that do not belong to the data; it is told
here, where a left-handed triad is only one half of the cases (an even exchange stays right-handed).
"""

import itertools
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import AXES
from undrift.errors import Implausible

Against = Literal["accelerometer", "turns"]


def nearest_signed_permutation(forward: FloatArray) -> FloatArray:
    """Return the signed permutation nearest to a forward matrix.

    Parameters
    ----------
    forward : array, shape (3, 3)
        K, reading per input; row i is the column i of the readings.

    Returns
    -------
    array, shape (3, 3)
        P: one +1 or -1 in every row and column.
    """
    gain = forward / np.linalg.norm(forward, axis=1)[:, None]
    order = max(itertools.permutations(range(3)), key=lambda p: sum(abs(gain[i, p[i]]) for i in range(3)))
    nearest = np.zeros((3, 3))
    for row, column in enumerate(order):
        nearest[row, column] = 1.0 if gain[row, column] >= 0.0 else -1.0
    return nearest


def check_axis_order(forward: FloatArray, what: str, *, against: Against) -> None:
    """Raise unless each gyroscope column reads + for a turn about its own axis.

    Parameters
    ----------
    forward : array, shape (3, 3)
        K of the gyroscopes.
    what : str
        Which fit.
    against : str
        What the axes come from: accelerometer, or turns whose axes were stated.

    Raises
    ------
    Implausible
        With what each column sees, and which columns are exchanged or reversed.
    """
    seen = nearest_signed_permutation(forward)
    if not np.array_equal(seen, np.eye(3)):
        by_turns = against == "turns"
        cause = cause_by_turns(seen) if by_turns else cause_by_gravity(seen)
        raise Implausible(
            f"{what}: wanted gyroscope columns x, y, z that read turns about +x, +y, +z "
            f"{'as stated' if by_turns else 'of the accelerometer axes'}, got {told_order(seen)}: {cause}; correct the order or "
            f"the sign of the columns{' or of the turns' if by_turns else ''}",
            seen=told_order(seen),
        )


def told_order(seen: FloatArray) -> str:
    """Return what the columns see, as "+y, +x, +z".

    Parameters
    ----------
    seen : array, shape (3, 3)
        Signed permutation.

    Returns
    -------
    str
        One axis with its sign for each of the columns x, y, z.
    """
    axis = np.abs(seen).argmax(axis=1)
    return ", ".join(f"{'+' if seen[i, j] > 0.0 else '-'}{AXES[j]}" for i, j in enumerate(axis))


def cause_by_turns(seen: FloatArray) -> str:
    """Return which columns or stated turns would have to be exchanged or reversed to give an order.

    Parameters
    ----------
    seen : array, shape (3, 3)
        Signed permutation other than the identity.

    Returns
    -------
    str
        In words.
    """
    negative, moved = _reversed_and_moved(seen)
    if not moved:
        return f"column {' and '.join(negative)} reversed, or the sign of the turns about {' and '.join(negative)}"
    ring = " in a ring" if len(moved) == 3 else ""
    names = f"{', '.join(moved[:-1])} and {moved[-1]}"
    return f"columns {names} exchanged{ring}{_and_reversed(negative)}, or the axes of the turns"


def cause_by_gravity(seen: FloatArray) -> str:
    """Return which columns, of gyroscope or accelerometer, would have to be exchanged or reversed to give an order.

    A turn is a pseudovector: accelerometer columns that are exchanged or reversed, A, show as P = det(A) A^T.

    Parameters
    ----------
    seen : array, shape (3, 3)
        Signed permutation other than the identity.

    Returns
    -------
    str
        In words.
    """
    negative, moved = _reversed_and_moved(seen)
    if not moved:
        if len(negative) == 2:
            other = next(a for a in AXES if a not in negative)
            return f"gyroscope columns {' and '.join(negative)} are reversed, or accelerometer column {other} is"
        if len(negative) == 3:
            return "all gyroscope columns are reversed, or the same two columns of both triads are exchanged"
        return f"gyroscope column {negative[0]} is reversed"
    if len(moved) == 3:
        how = f"columns x, y and z are exchanged in a ring{_and_reversed(negative)}"
        return f"{how}, those of the gyroscope or those of the accelerometer" if not negative else f"gyroscope {how}"
    pair = " and ".join(moved)
    if len(negative) == 3:
        return (
            f"accelerometer columns {pair} are exchanged, or gyroscope columns {pair} and all their signs are reversed"
        )
    return f"gyroscope columns {pair} are exchanged{_and_reversed(negative)}"


def _reversed_and_moved(seen: FloatArray) -> tuple[list[str], list[str]]:
    negative = [AXES[i] for i in range(3) if seen[i].min() < 0.0]
    return negative, [AXES[i] for i in range(3) if seen[i, i] == 0.0]


def _and_reversed(negative: list[str]) -> str:
    return f", and {' and '.join(negative)} reversed" if negative else ""
