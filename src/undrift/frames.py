"""Frame letters, and quaternions as undrift writes them.

    s  sensor axes as etched            b  device case             t  rate table
    m  optical body (markers)           n  level, z up
    a  segment of a body: x forward, y left, z up, upright

``R_bs`` maps a vector from s to b; ``q_nb`` is its quaternion (b to n), scalar first (w, x, y, z). A gyroscope reads the
rate of b against n, seen in b. An accelerometer reads specific force: at rest the axis that points up reads +g.
"""

from typing import TYPE_CHECKING, Literal

import numpy as np

from undrift.arrays import FloatArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Frame = Literal["s", "b", "t", "m", "n"]


def rotation(q: FloatArray) -> "Rotation":
    """Return scipy's Rotation of scalar-first quaternions, (N, 4)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(q, scalar_first=True)


def quaternion_product(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the Hamilton product p q, gaps (NaN) passing through. p (..., 4), q (..., 4) -> (..., 4)."""
    (pw, px, py, pz), (qw, qx, qy, qz) = ([each[..., k] for k in range(4)] for each in map(np.asarray, (p, q)))
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
    """Return vector products, a third of the time that numpy's take. a (..., 3), b (..., 3) -> (..., 3)."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for k in range(3):
        np.subtract(a[..., k - 2] * b[..., k - 1], a[..., k - 1] * b[..., k - 2], out=product[..., k])
    return product


def rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """Return vectors turned by unit quaternions, gaps (NaN) passing through. q (..., 4), v (..., 3) -> (..., 3)."""
    t = 2.0 * cross(q[..., 1:], v)
    return np.asarray(v + q[..., :1] * t + cross(q[..., 1:], t))


def rotation_vector(q: FloatArray) -> FloatArray:
    """Return the rotation vector of unit quaternions, gaps (NaN) passing through. q (..., 4) -> (..., 3) rad."""
    w, v = q[..., :1], q[..., 1:]
    sine = np.linalg.norm(v, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(w))
    per_sine = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-300), 2.0)
    return np.asarray(np.where(w < 0.0, -per_sine, per_sine) * v)


def quaternion_of(vector: FloatArray) -> FloatArray:
    """Return the unit quaternion of rotation vectors, gaps (NaN) passing through. vector (..., 3) rad -> (..., 4)."""
    half = 0.5 * np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate((np.cos(half), 0.5 * np.sinc(half / np.pi) * vector), axis=-1)


def signed(q: FloatArray) -> FloatArray:
    """Return quaternions (N, 4) without jumps of sign."""
    flips = np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    return np.asarray(q * np.append(1.0, np.cumprod(flips))[:, None])
