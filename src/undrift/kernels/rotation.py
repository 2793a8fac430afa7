"""Rotation kernels: integrate rates into quaternions.

Shapes and units: gyro flat (3 N,) rad/s, time (N,) s, q (4,) w-x-y-z, out flat (4 N,).
"""

import math

from numba import njit

from undrift.arrays import FloatArray


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def strapdown(gyro: FloatArray, time: FloatArray, q: FloatArray, out: FloatArray) -> None:
    # q_k = q_(k-1) exp(w_k (t_k - t_(k-1))): the rate of sample k holds on (k-1, k]; exact for a constant rate.
    n = time.size
    qw, qx, qy, qz = q[0], q[1], q[2], q[3]
    out[0], out[1], out[2], out[3] = qw, qx, qy, qz
    for k in range(1, n):
        half = 0.5 * (time[k] - time[k - 1])
        ax, ay, az = gyro[3 * k] * half, gyro[3 * k + 1] * half, gyro[3 * k + 2] * half
        square = ax * ax + ay * ay + az * az
        if square < 0.01:  # half angle under 0.1 rad: series to 1e-12
            s = 1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0 - square / 362880.0)))
            c = 1.0 - square * (0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0 - square / 40320.0)))
        else:
            angle = math.sqrt(square)
            s = math.sin(angle) / angle
            c = math.cos(angle)
        ax, ay, az = s * ax, s * ay, s * az
        nw = qw * c - qx * ax - qy * ay - qz * az
        nx = qw * ax + qx * c + qy * az - qz * ay
        ny = qw * ay - qx * az + qy * c + qz * ax
        nz = qw * az + qx * ay - qy * ax + qz * c
        scale = 1.5 - 0.5 * (nw * nw + nx * nx + ny * ny + nz * nz)  # one Newton step back to length one
        qw, qx, qy, qz = nw * scale, nx * scale, ny * scale, nz * scale
        out[4 * k], out[4 * k + 1], out[4 * k + 2], out[4 * k + 3] = qw, qx, qy, qz
