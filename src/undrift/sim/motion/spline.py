"""Spline: a pose as a function of time, with its exact derivatives.

Position p(t) and the four numbers s(t) of a quaternion are quintic splines; the orientation is s over its length. With
conj(s) s' = (s . s') + (vector part), everything follows in closed form and belongs together::

    q = s / |s|
    w = 2 Im(conj(s) s') / |s|^2                                       angular rate of b against n, seen in b
    w' = 2 Im(conj(s) s'') / |s|^2  -  2 w (s . s') / |s|^2            conj(s') s' is a number, so it adds nothing
    a = p''                                                            in n
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from undrift.arrays import FloatArray
from undrift.frames import quaternion_conjugate, quaternion_product

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

DEGREE = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Turning:
    """Orientation and what belongs to it, at given instants.

    Parameters
    ----------
    q_nb : array, shape (N, 4)
        w-x-y-z.
    rate_b : array, shape (N, 3)
        rad/s.
    acceleration_b : array, shape (N, 3)
        Angular acceleration, rad/s2.
    """

    q_nb: FloatArray
    rate_b: FloatArray
    acceleration_b: FloatArray


def quintic(time: FloatArray, values: FloatArray) -> "BSpline":
    """Return the quintic spline through values.

    Parameters
    ----------
    time : array, shape (K,)
        s, six or more.
    values : array, shape (K, C)
        Any unit.

    Returns
    -------
    BSpline
        Four derivatives are continuous.
    """
    from scipy.interpolate import make_interp_spline

    return make_interp_spline(time, values, k=DEGREE)


def turning(spline: "BSpline", time: FloatArray) -> Turning:
    """Return orientation, rate and angular acceleration of a spline of quaternions.

    Parameters
    ----------
    spline : BSpline
        Four columns, of about unit length and without jumps of sign.
    time : array, shape (N,)
        s.

    Returns
    -------
    Turning
        Exact derivatives of one another.
    """
    s, first, second = spline(time), spline(time, nu=1), spline(time, nu=2)
    square = (s * s).sum(axis=1, keepdims=True)
    inverse = quaternion_conjugate(s)
    rate = 2.0 * quaternion_product(inverse, first)[:, 1:] / square
    swell = 2.0 * (s * first).sum(axis=1, keepdims=True) / square
    acceleration = 2.0 * quaternion_product(inverse, second)[:, 1:] / square - rate * swell
    return Turning(q_nb=s / np.sqrt(square), rate_b=rate, acceleration_b=acceleration)
