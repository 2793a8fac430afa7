"""Kernels of rotation.py in numpy, for interpreters without a compiler, in which a loop over samples is slow."""

import numpy as np

from undrift.arrays import FloatArray, IntArray


def strapdown(gyro: FloatArray, time: FloatArray, q: FloatArray, out: FloatArray) -> None:
    # as rotation.strapdown: products of 1, 2, 4, .. neighbouring turns until every sample has the product of all before it
    half = 0.5 * gyro.reshape(-1, 3).T * np.diff(time, prepend=time[0])
    angle = np.linalg.norm(half, axis=0)
    turns = np.vstack((np.cos(angle), np.sinc(angle / np.pi) * half))  # (4, N)
    turns[:, 0] = q
    reach = 1
    while reach < turns.shape[1]:
        (pw, px, py, pz), (qw, qx, qy, qz) = turns[:, :-reach], turns[:, reach:]
        turns[:, reach:] = (
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        )
        reach *= 2
    out[:] = (turns / np.linalg.norm(turns, axis=0)).T.ravel()


def carried_means(
    rate: FloatArray, force: FloatArray, rate_regressors: FloatArray, force_regressors: FloatArray,
    time: FloatArray, first: IntArray, weight: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    # same result as rotation.carried_means
    from scipy.spatial.transform import Rotation

    n = time.size
    x, y = rate_regressors.reshape(n, 1, 1, -1), force_regressors.reshape(n, 1, 1, -1)
    q = np.empty(4 * n)
    strapdown(rate, time, np.array([1.0, 0.0, 0.0, 0.0]), q)
    matrix = Rotation.from_quat(q.reshape(n, 4), scalar_first=True).as_matrix()
    half = 0.5 * np.diff(time, prepend=time[0])[:, None, None]
    before = np.concatenate((matrix[:1], matrix[:-1]))
    turned = np.cumsum(((before + matrix) * half)[..., None] * x, axis=0)  # (N, 3, 3, C)
    carried = np.einsum("nij,nj->ni", matrix, force.reshape(n, 3))
    by_rate = np.cross(turned, carried[:, :, None, None], axis=1)
    values = np.concatenate([part.reshape(n, -1) for part in (carried, by_rate, matrix[..., None] * y)], axis=1)
    for row, start in zip(out.reshape(len(first), -1), first, strict=True):
        row[:] = weight @ values[start : start + weight.size]
