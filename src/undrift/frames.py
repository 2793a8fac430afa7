"""Frame letters, and quaternions as undrift writes them.

    s  sensor axes as etched            b  device case             t  rate table
    m  optical body (markers)           n  level, z up
    a  segment of a body: x forward, y left, z up, upright

``R_bs`` maps a vector from s to b. ``q_nb`` is the quaternion from b to n, scalar first (w, x, y, z). A gyroscope measures
the rate of b relative to n, in axes b. An accelerometer measures specific force: at rest, the axis that points up reads +g.

Strapdown integration updates q_nb from this rate. It is exact if the rate is constant on (k-1, k]::

    q_nb[k] = q_nb[k-1] (x) exp(w_b[k] (t[k] - t[k-1]))
"""

from typing import TYPE_CHECKING, Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Frame = Literal["s", "b", "t", "m", "n"]


def rotation(q: FloatArray) -> "Rotation":
    """Return scipy's Rotation of scalar-first quaternions, (N, 4)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(q, scalar_first=True)


def quaternion_product(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the Hamilton product p q. Gaps (NaN) remain gaps. p (..., 4), q (..., 4) -> (..., 4)."""
    (pw, px, py, pz), (qw, qx, qy, qz) = (
        [quaternion[..., k] for k in range(4)] for quaternion in map(np.asarray, (p, q))
    )
    product = np.empty(np.broadcast_shapes(np.shape(p), np.shape(q)))
    product[..., 0] = pw * qw - px * qx - py * qy - pz * qz
    product[..., 1] = pw * qx + px * qw + py * qz - pz * qy
    product[..., 2] = pw * qy - px * qz + py * qw + pz * qx
    product[..., 3] = pw * qz + px * qy - py * qx + pz * qw
    return product


def quaternion_conjugate(q: FloatArray) -> FloatArray:
    """Return the inverse of unit quaternions. q (..., 4) -> (..., 4)."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return vector products, three times as fast as numpy. a (..., 3), b (..., 3) -> (..., 3)."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for k in range(3):
        np.subtract(a[..., k - 2] * b[..., k - 1], a[..., k - 1] * b[..., k - 2], out=product[..., k])
    return product


def rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """Return vectors turned by unit quaternions. Gaps (NaN) remain gaps. q (..., 4), v (..., 3) -> (..., 3)."""
    t = 2.0 * cross(q[..., 1:], v)
    return np.asarray(v + q[..., :1] * t + cross(q[..., 1:], t))


def rotation_vector(q: FloatArray) -> FloatArray:
    """Return the rotation vectors of unit quaternions. Gaps (NaN) remain gaps. q (..., 4) -> (..., 3) rad."""
    w, v = q[..., :1], q[..., 1:]
    sine = np.linalg.norm(v, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(w))
    per_sine = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 2.0)
    return np.asarray(np.where(w < 0.0, -per_sine, per_sine) * v)


def quaternion_of(vector: FloatArray) -> FloatArray:
    """Return the unit quaternions of rotation vectors. Gaps (NaN) remain gaps. vector (..., 3) rad -> (..., 4)."""
    half = 0.5 * np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate((np.cos(half), 0.5 * np.sinc(half / np.pi) * vector), axis=-1)


def signed(q: FloatArray) -> FloatArray:
    """Return quaternions (N, 4) without jumps of sign."""
    flips = np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    return np.asarray(q * np.append(1.0, np.cumprod(flips))[:, None])


def integrate_strapdown(
    gyro_b: FloatArray, time: FloatArray, q_nb: FloatArray, *, out: FloatArray | None = None
) -> FloatArray:
    """Integrate angular rate from an initial orientation.

    Parameters
    ----------
    gyro_b : array, shape (N, 3)
        Corrected rate, rad/s, frame b, without gaps.
    time : array, shape (N,)
        s, strictly increasing.
    q_nb : array, shape (4,)
        Orientation at the first sample, w-x-y-z.
    out : array, shape (N, 4), optional
        Buffer for the result, float64 in C order. Without it, a new array is allocated.

    Returns
    -------
    array, shape (N, 4)
        q_nb at every sample, unit length.

    Raises
    ------
    InputError
        If shapes disagree, or if the rate has gaps.

    References
    ----------
    .. [1] J. E. Bortz, "A new mathematical formulation for strapdown inertial navigation", 1971: constant-axis case.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> time = np.arange(101) / 100.0
    >>> quarter = np.tile([0.0, 0.0, np.pi / 2], (101, 1))  # rad/s about z for 1 s
    >>> q_nb = undrift.integrate_strapdown(quarter, time, np.array([1.0, 0.0, 0.0, 0.0]))
    >>> float(np.degrees(2.0 * np.arctan2(q_nb[-1, 3], q_nb[-1, 0])).round(6))
    90.0
    """
    from undrift.kernels.rotation import strapdown

    if gyro_b.shape != (len(time), 3) or np.shape(q_nb) != (4,):
        raise InputError(
            f"strapdown: expected gyro (N, 3), time (N,), q (4,), got {gyro_b.shape}, {time.shape}, {np.shape(q_nb)}"
        )
    q = np.empty((len(time), 4)) if out is None else out
    if q.shape != (len(time), 4) or q.dtype != np.float64 or not q.flags.c_contiguous:
        raise InputError(
            f"strapdown: expected a float64 buffer of shape ({len(time)}, 4) in C order, got {q.dtype} {q.shape}. "
            "Create it with numpy.empty."
        )
    gyro = np.ascontiguousarray(gyro_b, dtype=np.float64).reshape(-1)
    strapdown(gyro, np.ascontiguousarray(time, dtype=np.float64), np.array(q_nb, dtype=np.float64), q.reshape(-1))
    if not np.isfinite(q[-1]).all():  # NaN propagates through the product, so the last sample reveals any gap
        raise InputError(
            "strapdown: expected a rate at every sample, got gaps. Integrate each stretch between gaps separately."
        )
    return q
