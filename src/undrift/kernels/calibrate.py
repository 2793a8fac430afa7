"""Kernels of the multi-position fit: norm of gravity over poses, and rotation between stills.

Shapes and units: reading flat (3 K,) raw unit, p (9,) = m_xx m_xy m_xz m_yy m_yz m_zz o_x o_y o_z, weight (K,); gyro flat
(3 N,) raw unit, time (N,) s. The free parameters of the accelerometer are scaled by the caller so that all are near one.

Kernels of the Allan variance: mean square of second and third differences.

Shapes and units: phase (N,), any unit (the running sum of the reading times the sample period); differences over m samples.

Lag kernel: a thermometer's time constant taken off by a causal lead, sample by sample over uneven steps.

Shapes and units: temp, time, out (N,) degC, s, degC, out not the same memory; lag, smooth s; state (4,): time and value of the
last reading, the low-passed value, and the last output; NaN before the first reading; changed in place.
"""

import math

import numpy as np
from numba import njit

from undrift.arrays import FloatArray, IntArray

# ---- Kernels of the Allan variance: mean square of second and third differences.


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def second_difference(phase: FloatArray, m: int, stride: int) -> float:
    # Mean of (x_(k+2m) - 2 x_(k+m) + x_k)^2 over k = 0, stride, ...
    total, count = 0.0, 0
    for k in range(0, phase.size - 2 * m, stride):
        d = phase[k + 2 * m] - 2.0 * phase[k + m] + phase[k]
        total += d * d
        count += 1
    return total / count


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def third_difference(phase: FloatArray, m: int, stride: int) -> float:
    # Mean of (x_(k+3m) - 3 x_(k+2m) + 3 x_(k+m) - x_k)^2 over k = 0, stride, ...
    total, count = 0.0, 0
    for k in range(0, phase.size - 3 * m, stride):
        d = (phase[k + 3 * m] - phase[k]) - 3.0 * (phase[k + 2 * m] - phase[k + m])
        total += d * d
        count += 1
    return total / count


# ---- Lag kernel: a thermometer's time constant taken off by a causal lead, sample by sample over uneven steps.


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def lead(temp: FloatArray, time: FloatArray, out: FloatArray, lag: float, smooth: float, state: FloatArray) -> None:
    # (lag s + 1) / (smooth s + 1), exact where the reading is straight between samples: z' = (x - z) / smooth,
    # y = z + lag z'. Over a step a = dt / smooth: z = e^-a z_before + (m - e^-a) x_before + (1 - m) x, m = (1 - e^-a) / a.
    # A NaN holds the output and leaves the state: the next reading bridges it.
    gain = lag / smooth
    last, x, z, y = state[0], state[1], state[2], state[3]
    for k in range(np.uint64(temp.size)):
        if not math.isnan(temp[k]):
            if math.isnan(x):
                z = temp[k]  # it had settled at the first reading
            else:
                a = (time[k] - last) / smooth
                keep = math.exp(-a)
                mean = -math.expm1(-a) / a
                z = keep * z + (mean - keep) * x + (1.0 - mean) * temp[k]
            last, x = time[k], temp[k]
            y = z + gain * (x - z)
        out[k] = y
    state[0], state[1], state[2], state[3] = last, x, z, y


# ---- calibrate


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def norm_equations(
    reading: FloatArray, weight: FloatArray, p: FloatArray, gravity: float, normal: FloatArray, gradient: FloatArray
) -> float:
    # Residual r = |M (u - o)| - g; normal (81,) = J^T W J, gradient (9,) = J^T W r; returns sum of w r^2.
    # With n = M (u - o) / |M (u - o)|: dr/dm_ij = n_i (u - o)_j, dr/do = -M^T n.
    xx, xy, xz, yy, yz, zz = p[0], p[1], p[2], p[3], p[4], p[5]
    ox, oy, oz = p[6], p[7], p[8]
    row = gradient.copy()
    for i in range(81):
        normal[i] = 0.0
    for i in range(9):
        gradient[i] = 0.0
    cost = 0.0
    for k in range(weight.size):
        dx, dy, dz = reading[3 * k] - ox, reading[3 * k + 1] - oy, reading[3 * k + 2] - oz
        ax, ay, az = xx * dx + xy * dy + xz * dz, yy * dy + yz * dz, zz * dz
        length = math.sqrt(ax * ax + ay * ay + az * az)
        residual = length - gravity
        nx, ny, nz = ax / length, ay / length, az / length
        row[0], row[1], row[2] = nx * dx, nx * dy, nx * dz
        row[3], row[4], row[5] = ny * dy, ny * dz, nz * dz
        row[6], row[7], row[8] = -xx * nx, -xy * nx - yy * ny, -xz * nx - yz * ny - zz * nz
        w = weight[k]
        cost += w * residual * residual
        for i in range(9):
            scaled = w * row[i]
            gradient[i] += scaled * residual
            for j in range(i + 1):
                normal[9 * i + j] += scaled * row[j]
    for i in range(9):
        for j in range(i):
            normal[9 * j + i] = normal[9 * i + j]
    return cost


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def rotations_between(
    gyro: FloatArray,
    time: FloatArray,
    first: IntArray,
    last: IntArray,
    matrix: FloatArray,
    offset: FloatArray,
    drift: FloatArray,
    rotation: FloatArray,
    sums: FloatArray,
) -> None:
    # Moves j: integrate w = M (u - o - drift_j), drift (3 J,) raw unit, from sample first[j] to last[j];
    # the rate of sample k holds on (k-1, k].
    # rotation (9 J,): R of the end body frame seen in the start body frame, row by row.
    # sums (36 J,): per move, sum of R dt times d for d = (1, u_x - o_x, u_y - o_y, u_z - o_z), nine numbers each,
    # from which the derivative by matrix and offset follows: the small rotation in the start frame is sum R dw dt.
    m0, m1, m2, m3, m4 = matrix[0], matrix[1], matrix[2], matrix[3], matrix[4]
    m5, m6, m7, m8 = matrix[5], matrix[6], matrix[7], matrix[8]
    for i in range(sums.size):
        sums[i] = 0.0
    for j in range(first.size):
        out = sums[36 * j : 36 * j + 36]
        ox, oy, oz = offset[0] + drift[3 * j], offset[1] + drift[3 * j + 1], offset[2] + drift[3 * j + 2]
        r0, r1, r2, r3, r4, r5, r6, r7, r8 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
        qw, qx, qy, qz = 1.0, 0.0, 0.0, 0.0
        for k in range(first[j] + 1, last[j] + 1):
            dt = time[k] - time[k - 1]
            dx = gyro[3 * k] - ox
            dy = gyro[3 * k + 1] - oy
            dz = gyro[3 * k + 2] - oz
            half = 0.5 * dt
            ax = (m0 * dx + m1 * dy + m2 * dz) * half
            ay = (m3 * dx + m4 * dy + m5 * dz) * half
            az = (m6 * dx + m7 * dy + m8 * dz) * half
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
            unit = 1.5 - 0.5 * (nw * nw + nx * nx + ny * ny + nz * nz)  # one Newton step back to length one
            qw, qx, qy, qz = nw * unit, nx * unit, ny * unit, nz * unit
            t0, t1, t2 = 1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy - qw * qz), 2.0 * (qx * qz + qw * qy)
            t3, t4, t5 = 2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz - qw * qx)
            t6, t7, t8 = 2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
            # The mean of the step's two ends stands for its middle.
            h0, h1, h2 = half * (r0 + t0), half * (r1 + t1), half * (r2 + t2)
            h3, h4, h5 = half * (r3 + t3), half * (r4 + t4), half * (r5 + t5)
            h6, h7, h8 = half * (r6 + t6), half * (r7 + t7), half * (r8 + t8)
            out[0], out[1], out[2] = out[0] + h0, out[1] + h1, out[2] + h2
            out[3], out[4], out[5] = out[3] + h3, out[4] + h4, out[5] + h5
            out[6], out[7], out[8] = out[6] + h6, out[7] + h7, out[8] + h8
            for b in range(3):
                d = dx if b == 0 else (dy if b == 1 else dz)
                at = 9 * b + 9
                out[at], out[at + 1], out[at + 2] = out[at] + d * h0, out[at + 1] + d * h1, out[at + 2] + d * h2
                out[at + 3], out[at + 4], out[at + 5] = out[at + 3] + d * h3, out[at + 4] + d * h4, out[at + 5] + d * h5
                out[at + 6], out[at + 7], out[at + 8] = out[at + 6] + d * h6, out[at + 7] + d * h7, out[at + 8] + d * h8
            r0, r1, r2, r3, r4, r5, r6, r7, r8 = t0, t1, t2, t3, t4, t5, t6, t7, t8
        base = 9 * j
        rotation[base], rotation[base + 1], rotation[base + 2] = r0, r1, r2
        rotation[base + 3], rotation[base + 4], rotation[base + 5] = r3, r4, r5
        rotation[base + 6], rotation[base + 7], rotation[base + 8] = r6, r7, r8
