"""Angles of an orientation q_nb = (w, x, y, z): inclination, heading, sagittal pitch, and Cardan angles for segments.

::

    inclination = 2 acos sqrt(w^2 + z^2)         angle of the body's z from the vertical
    heading     = 2 atan(z / w)                  turn about the vertical
    pitch       = atan2(-u . forward, u . up)    u the vertical seen in b: forward lean is positive

The pitch has no singularity until the vertical leaves the sagittal plane, where it is a gap (NaN).
"""

from typing import NamedTuple

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, rotate
from undrift.session import FACES, Face

IN_PLANE = np.sin(np.radians(5.0))  # shortest part of the vertical in the sagittal plane that still has a direction
SEQUENCE = "ZXY"


class CardanAngles(NamedTuple):
    """Angles about moving axes and the order in which they were taken.

    Parameters
    ----------
    angles : array, shape (N, 3)
        rad, in the order of the sequence.
    sequence : str
        Moving axes, first to last.
    """

    angles: FloatArray
    sequence: str


def inclination_of(q_nb: FloatArray) -> FloatArray:
    """Return the angle between the body's z and the vertical.

    Parameters
    ----------
    q_nb : array, shape (N, 4)
        Orientation, w-x-y-z; NaN rows pass through.

    Returns
    -------
    array, shape (N,)
        0 to pi, rad.
    """
    w, x, y, z = np.moveaxis(q_nb, -1, 0)
    angle: FloatArray = 2.0 * np.arctan2(
        np.hypot(x, y), np.hypot(w, z)
    )  # the arc cosine loses half its digits near zero
    return angle


def heading_of(q_nb: FloatArray) -> FloatArray:
    """Return the turn about the vertical.

    Parameters
    ----------
    q_nb : array, shape (N, 4)
        Orientation, w-x-y-z; NaN rows pass through.

    Returns
    -------
    array, shape (N,)
        -pi to pi, rad; not defined where the body's z points straight down.
    """
    w, _, _, z = np.moveaxis(q_nb, -1, 0)
    flip = np.where(w < 0.0, -1.0, 1.0)  # q and -q are one orientation
    angle: FloatArray = 2.0 * np.arctan2(flip * z, flip * w)
    return angle


def sagittal_pitch(q_nb: FloatArray, *, forward: Face = "+x", up: Face = "+z") -> FloatArray:
    """Return the direction of gravity in the segment's sagittal plane.

    Parameters
    ----------
    q_nb : array, shape (N, 4)
        Orientation, w-x-y-z; NaN rows pass through.
    forward, up : str
        Device axes that point forward and up when the segment stands upright: "+x", "-x", "+y", ...

    Returns
    -------
    array, shape (N,)
        -pi to pi, rad, forward lean positive; NaN where the vertical is within 5 deg of the plane's normal.

    Raises
    ------
    InputError
        Axes that are not two different ones.
    """
    if forward not in FACES or up not in FACES or forward[1] == up[1]:
        raise InputError(
            f"pitch: wanted two different axes of {', '.join(FACES)}, got forward {forward} and up {up}; "
            "name the axes that point forward and up"
        )
    vertical = rotate(quaternion_conjugate(q_nb), np.array([0.0, 0.0, 1.0]))
    along, upward = _component(vertical, forward), _component(vertical, up)
    pitch: FloatArray = np.where(np.hypot(along, upward) > IN_PLANE, np.arctan2(-along, upward), np.nan)
    return pitch


def cardan_angles(q: FloatArray) -> CardanAngles:
    """Return Cardan angles of a segment, or of one against another, in the sequence for joints [1]_.

    R = R_z(a) R_x(b) R_y(c), moving axes: flexion about z, ab- or adduction about x, axial rotation about y.

    Parameters
    ----------
    q : array, shape (N, 4)
        Orientation, w-x-y-z; NaN rows pass through.

    Returns
    -------
    CardanAngles
        a, b, c in rad and the sequence "ZXY"; b lies between -pi/2 and pi/2, where a and c are one.

    References
    ----------
    .. [1] G. Wu and P. R. Cavanagh, "ISB recommendations for standardization in the reporting of kinematic data",
       J. Biomechanics 28 (1995) 1257.
    """
    w, x, y, z = np.moveaxis(q, -1, 0)
    a = np.arctan2(2.0 * (w * z - x * y), 1.0 - 2.0 * (x * x + z * z))
    b = np.arcsin(np.clip(2.0 * (y * z + w * x), -1.0, 1.0))
    c = np.arctan2(2.0 * (w * y - x * z), 1.0 - 2.0 * (x * x + y * y))
    return CardanAngles(np.stack((a, b, c), axis=-1), SEQUENCE)


def _component(vector: FloatArray, face: Face) -> FloatArray:
    part: FloatArray = vector[..., "xyz".index(face[1])] * (1.0 if face[0] == "+" else -1.0)
    return part
