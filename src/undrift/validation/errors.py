"""Orientation errors in degrees of freedom that matter: total, heading, inclination, sagittal pitch.

With both orientations body to level frame, the error in earth axes is e = q_imu (x) q_ref^-1 = (w, x, y, z), and [1]_::

    total        2 acos |w|
    heading      2 atan(z / w)             signed; positive where the sensor has turned too far about the vertical
    inclination  2 acos sqrt(w^2 + z^2)    the angle between the two verticals

The error of sagittal pitch is the signed difference of two pitches (``orientation.angles``), brought into (-pi, pi].

References
----------
.. [1] D. Laidig, M. Caruso, A. Cereatti, T. Seel, "BROAD - A benchmark for robust inertial orientation estimation", Data
   6(7), 72, 2021.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.frames import quaternion_conjugate, quaternion_product
from undrift.orientation.angles import heading_of, inclination_of, sagittal_pitch
from undrift.session import Face


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrientationError:
    """Error of one orientation against another, sample by sample; NaN where either is missing.

    Parameters
    ----------
    total, heading, inclination : array, shape (N,)
        rad; heading signed.
    pitch : array, shape (N,)
        Signed difference of sagittal pitch, rad; NaN where the vertical leaves the sagittal plane.
    """

    total: FloatArray
    heading: FloatArray
    inclination: FloatArray
    pitch: FloatArray


def compare_orientations(
    q_nb: FloatArray, reference_q_nb: FloatArray, *, forward: Face = "+x", up: Face = "+z"
) -> OrientationError:
    """Compare orientations of the same body at the same times.

    Parameters
    ----------
    q_nb : array, shape (N, 4)
        Judged orientation, w-x-y-z.
    reference_q_nb : array, shape (N, 4)
        Reference orientation, w-x-y-z.
    forward, up : str
        Axes of the body that span its sagittal plane, "+x" and the like.

    Returns
    -------
    OrientationError
        In rad.
    """
    e = quaternion_product(q_nb, quaternion_conjugate(reference_q_nb))
    pitch = sagittal_pitch(q_nb, forward=forward, up=up) - sagittal_pitch(reference_q_nb, forward=forward, up=up)
    return OrientationError(
        total=2.0 * np.arctan2(np.linalg.norm(e[:, 1:], axis=1), np.abs(e[:, 0])),
        heading=heading_of(e),
        inclination=inclination_of(e),
        pitch=wrapped(pitch),
    )


def wrapped(angle: FloatArray) -> FloatArray:
    """Return angles brought into (-pi, pi].

    Parameters
    ----------
    angle : array, shape (N,)
        rad.

    Returns
    -------
    array, shape (N,)
        rad.
    """
    turned: FloatArray = np.pi - np.mod(np.pi - angle, 2.0 * np.pi)
    return turned


def rms(values: FloatArray) -> float:
    """Return the root-mean-square of what is not a gap.

    Parameters
    ----------
    values : array, shape (N,)
        Any unit; NaN is a gap.

    Returns
    -------
    float
        Same unit; NaN where all are gaps.
    """
    seen = values[np.isfinite(values)]
    return float(np.sqrt((seen**2).mean())) if len(seen) else float("nan")


def median(values: FloatArray) -> float:
    """Return the median of what is not a gap.

    Parameters
    ----------
    values : array, shape (N,)
        Any unit; NaN is a gap.

    Returns
    -------
    float
        Same unit; NaN where all are gaps.
    """
    seen = values[np.isfinite(values)]
    return float(np.median(seen)) if len(seen) else float("nan")


def slope(time: FloatArray, values: FloatArray, chosen: BoolArray) -> float:
    """Return the least-squares slope of values over time.

    Parameters
    ----------
    time : array, shape (N,)
        s.
    values : array, shape (N,)
        Any unit; NaN is a gap.
    chosen : array, shape (N,)
        Samples that count.

    Returns
    -------
    float
        Unit per second; NaN with fewer than two samples.
    """
    good = chosen & np.isfinite(values)
    if good.sum() < 2:
        return float("nan")
    t = time[good] - time[good].mean()
    return float((t * values[good]).sum() / (t * t).sum())
