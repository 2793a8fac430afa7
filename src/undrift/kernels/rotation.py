"""Rotation kernels: integrate rates into quaternions.

Shapes and units: gyro flat (3 N,) rad/s, time (N,) s, q (4,) w-x-y-z, out flat (4 N,).
"""

import math

import numpy as np
from numba import njit

from undrift.arrays import FloatArray

ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
BLOCK = 32  # samples whose increments are made together; the series below runs on vector units, the product cannot
SERIES_LIMIT = 0.01  # square of a half angle of 0.1 rad: the first term left out is under 3e-17


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def large_increments(gyro: FloatArray, time: FloatArray, out: FloatArray, start: int, stop: int) -> None:
    # out[k] = exp(w_k (t_k - t_(k-1)) / 2) for those k in [start, stop) whose half angle is beyond the series
    for k in range(np.uint64(start), np.uint64(stop)):
        half = 0.5 * (time[k] - time[k - ONE])
        i, j = THREE * k, FOUR * k
        x, y, z = gyro[i] * half, gyro[i + ONE] * half, gyro[i + TWO] * half
        square = x * x + y * y + z * z
        if square >= SERIES_LIMIT:
            angle = math.sqrt(square)
            s = math.sin(angle) / angle
            out[j] = math.cos(angle)
            out[j + ONE], out[j + TWO], out[j + THREE] = s * x, s * y, s * z


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def strapdown(gyro: FloatArray, time: FloatArray, q: FloatArray, out: FloatArray) -> None:
    # q_k = q_(k-1) exp(w_k (t_k - t_(k-1))): the rate of sample k holds on (k-1, k]; exact for a constant rate.
    qw, qx, qy, qz = q[0], q[1], q[2], q[3]
    out[0], out[1], out[2], out[3] = qw, qx, qy, qz
    for start in range(1, time.size, BLOCK):
        stop = min(start + BLOCK, time.size)
        worst = 0.0
        for k in range(np.uint64(start), np.uint64(stop)):
            half = 0.5 * (time[k] - time[k - ONE])
            i, j = THREE * k, FOUR * k
            x, y, z = gyro[i] * half, gyro[i + ONE] * half, gyro[i + TWO] * half
            square = x * x + y * y + z * z
            worst = square if square > worst else worst
            s = 1.0 - square * (1 / 6 - square * (1 / 120 - square * (1 / 5040 - square * (1 / 362880))))
            out[j] = 1.0 - square * (1 / 2 - square * (1 / 24 - square * (1 / 720 - square * (1 / 40320))))
            out[j + ONE], out[j + TWO], out[j + THREE] = s * x, s * y, s * z
        if worst >= SERIES_LIMIT:
            large_increments(gyro, time, out, start, stop)
        for k in range(np.uint64(start), np.uint64(stop)):
            j = FOUR * k
            c, x, y, z = out[j], out[j + ONE], out[j + TWO], out[j + THREE]
            # pairs before sums: the shorter chain from one sample to the next sets the pace
            nw = (qw * c - qx * x) - (qy * y + qz * z)
            nx = (qw * x + qx * c) + (qy * z - qz * y)
            ny = (qw * y - qx * z) + (qy * c + qz * x)
            nz = (qw * z + qx * y) - (qy * x - qz * c)
            qw, qx, qy, qz = nw, nx, ny, nz
            out[j], out[j + ONE], out[j + TWO], out[j + THREE] = qw, qx, qy, qz
        scale = 1.5 - 0.5 * (qw * qw + qx * qx + qy * qy + qz * qz)  # one Newton step back to length one
        qw, qx, qy, qz = qw * scale, qx * scale, qy * scale, qz * scale
