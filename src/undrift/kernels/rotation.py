"""Rotation kernels: integrate rates into quaternions, with their sensitivity to the parameters of a triad.

Shapes and units: gyro or rate flat (3 N,) rad/s, time (N,) s, q (4,) w-x-y-z, out flat (4 N,), regressors flat (C N,).
at (L,) contains increasing times within the record, s. q_out is flat (4 L,), and sum_out flat (9 C L,): [a, b, c] is the sum of
R_mid[a, b] regressor_c dt from the start. force is flat (3 N,) m/s2. first (K,) contains the first samples of K windows, ascending,
and weight (W,) the weights of their W samples. out of carried_means is flat (21 K,): <R f>, <[R f]x J> and <R> row by row.
"""

import math

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.kernels.compilation import COMPILED, compiled

# ---- rotation and its sensitivity, both read off at given times


@compiled
def turned(
    qw: float, qx: float, qy: float, qz: float, hx: float, hy: float, hz: float
) -> tuple[float, float, float, float]:
    # q exp(2 h): h is half the rotation vector, rad.
    square = hx * hx + hy * hy + hz * hz
    if square < 0.01:
        s = 1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0 - square / 362880.0)))
        c = 1.0 - square * (0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0 - square / 40320.0)))
    else:
        angle = math.sqrt(square)
        s = math.sin(angle) / angle
        c = math.cos(angle)
    hx, hy, hz = s * hx, s * hy, s * hz
    return (
        qw * c - qx * hx - qy * hy - qz * hz,
        qw * hx + qx * c + qy * hz - qz * hy,
        qw * hy - qx * hz + qy * c + qz * hx,
        qw * hz + qx * hy - qy * hx + qz * c,
    )


@compiled
def matrix_of(
    w: float, x: float, y: float, z: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    # the rotation matrix of a unit quaternion, row by row
    return (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@compiled
def accumulate(
    rate: FloatArray, regressors: FloatArray, time: FloatArray, at: FloatArray, q_out: FloatArray, sum_out: FloatArray
) -> None:
    # The rate of sample k applies to (t_(k-1), t_k]. The rotation at the middle of each step determines the sensitivity.
    n, points = time.size, at.size
    channels = regressors.size // n
    width = 9 * channels
    total = np.zeros(width)
    increment = np.empty(width)
    qw, qx, qy, qz = 1.0, 0.0, 0.0, 0.0
    p = 0
    while p < points and at[p] <= time[0]:
        q_out[4 * p] = 1.0
        p += 1
    for k in range(1, n):
        if p == points:
            break
        dt = time[k] - time[k - 1]
        wx, wy, wz = rate[3 * k], rate[3 * k + 1], rate[3 * k + 2]
        quarter = 0.25 * dt
        mw, mx, my, mz = turned(qw, qx, qy, qz, wx * quarter, wy * quarter, wz * quarter)
        r = matrix_of(mw, mx, my, mz)
        for e in range(9):
            scaled = r[e] * dt
            for c in range(channels):
                increment[e * channels + c] = scaled * regressors[k * channels + c]
        while p < points and at[p] <= time[k]:
            x = (at[p] - time[k - 1]) / dt
            half = 0.5 * x * dt
            q_out[4 * p], q_out[4 * p + 1], q_out[4 * p + 2], q_out[4 * p + 3] = turned(
                qw, qx, qy, qz, wx * half, wy * half, wz * half
            )
            for e in range(width):
                sum_out[p * width + e] = total[e] + x * increment[e]
            p += 1
        half = 0.5 * dt
        qw, qx, qy, qz = turned(qw, qx, qy, qz, wx * half, wy * half, wz * half)
        scale = 1.5 - 0.5 * (qw * qw + qx * qx + qy * qy + qz * qz)
        qw, qx, qy, qz = qw * scale, qx * scale, qy * scale, qz * scale
        for e in range(width):
            total[e] += increment[e]


# ---- strapdown

ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
BLOCK = 32  # samples per block (the series below runs on vector units, the product cannot)
SERIES_LIMIT = 0.01  # square of a half angle of 0.1 rad: the first omitted term is under 3e-17


@compiled
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


@compiled
def strapdown(gyro: FloatArray, time: FloatArray, q: FloatArray, out: FloatArray) -> None:
    # q_k = q_(k-1) exp(w_k (t_k - t_(k-1))): the rate of sample k applies to (k-1, k], which is exact for a constant rate.
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
            # pairs before sums, because the shorter chain from one sample to the next is faster
            nw = (qw * c - qx * x) - (qy * y + qz * z)
            nx = (qw * x + qx * c) + (qy * z - qz * y)
            ny = (qw * y - qx * z) + (qy * c + qz * x)
            nz = (qw * z + qx * y) - (qy * x - qz * c)
            qw, qx, qy, qz = nw, nx, ny, nz
            out[j], out[j + ONE], out[j + TWO], out[j + THREE] = qw, qx, qy, qz
        scale = 1.5 - 0.5 * (qw * qw + qx * qx + qy * qy + qz * qz)  # one Newton step back to unit length
        qw, qx, qy, qz = qw * scale, qx * scale, qy * scale, qz * scale


# ---- specific force, rotated into the first frame


@compiled
def carried_means(
    rate: FloatArray, force: FloatArray, rate_regressors: FloatArray, force_regressors: FloatArray,
    time: FloatArray, first: IntArray, weight: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    # Weighted sums over windows, in the frame of the first sample, R by strapdown from there: R f, the effect of a rate x_c e_b as
    # [a, b, c] of (the integral of R[:, b] x_c dt) x R f, and the effect of a force y_c e_b as R[a, b] y_c. Regressors as above.
    n = time.size
    x, y = rate_regressors.size // n, force_regressors.size // n
    width = 3 + 9 * x + 9 * y
    q = np.empty(4 * n)
    strapdown(rate, time, np.array([1.0, 0.0, 0.0, 0.0]), q)
    out[:] = 0.0
    total, values, rotation = np.zeros(9 * x), np.empty(width), np.eye(3).ravel()
    p, row = 0, 3 * x
    for k in range(n):
        half = 0.5 * (time[k] - time[max(k - 1, 0)])
        r = matrix_of(q[4 * k], q[4 * k + 1], q[4 * k + 2], q[4 * k + 3])
        for e in range(9):
            for c in range(x):
                total[e * x + c] += (rotation[e] + r[e]) * half * rate_regressors[k * x + c]
            rotation[e] = r[e]
            for c in range(y):
                values[3 + 9 * x + e * y + c] = r[e] * force_regressors[k * y + c]
        for a in range(3):
            values[a] = r[3 * a] * force[3 * k] + r[3 * a + 1] * force[3 * k + 1] + r[3 * a + 2] * force[3 * k + 2]
        for b in range(row):
            values[3 + b] = total[row + b] * values[2] - total[2 * row + b] * values[1]
            values[3 + row + b] = total[2 * row + b] * values[0] - total[b] * values[2]
            values[3 + 2 * row + b] = total[b] * values[1] - total[row + b] * values[0]
        while p < first.size and first[p] + weight.size <= k:
            p += 1
        for w in range(p, first.size):
            if first[w] > k:
                break
            share = weight[k - first[w]]
            for e in range(width):
                out[width * w + e] += share * values[e]


if not COMPILED:
    from undrift.kernels.plain import carried_means, strapdown  # noqa: F401 (in place of those above)
