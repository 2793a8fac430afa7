"""Kernels of calibration: thermometer lag, rotation between stills.

Lag: temp and out (N,) degC in different memory, time (N,) s, lag and smooth in s. state (4,) contains time and value of the last
reading, the low-passed value and the last output, NaN before the first reading. It is updated in place.
Moves: gyro flat (3 N,) raw unit, time (N,) s.
"""

import math

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.kernels.compilation import compiled
from undrift.kernels.rotation import matrix_of, turned

# ---- a thermometer's time constant taken off by a causal lead, sample by sample over uneven steps


@compiled
def lead(temp: FloatArray, time: FloatArray, out: FloatArray, lag: float, smooth: float, state: FloatArray) -> None:
    # (lag s + 1) / (smooth s + 1), exact for readings that are linear between samples: z' = (x - z) / smooth,
    # y = z + lag z'. With m = (1 - e^-a) / a over a step a = dt / smooth: z = e^-a z_before + (m - e^-a) x_before + (1 - m) x.
    # A NaN repeats the output and keeps the state, and the next reading bridges the gap.
    gain = lag / smooth
    last, x, z, y = state[0], state[1], state[2], state[3]
    for k in range(np.uint64(temp.size)):
        if not math.isnan(temp[k]):
            if math.isnan(x):
                z = temp[k]  # the thermometer had settled at the first reading
            else:
                a = (time[k] - last) / smooth
                keep = math.exp(-a)
                mean = -math.expm1(-a) / a
                z = keep * z + (mean - keep) * x + (1.0 - mean) * temp[k]
            last, x = time[k], temp[k]
            y = z + gain * (x - z)
        out[k] = y
    state[0], state[1], state[2], state[3] = last, x, z, y


# ---- rotation between stills


@compiled
def rotations_between(
    gyro: FloatArray, time: FloatArray, first: IntArray, last: IntArray,
    matrix: FloatArray, offset: FloatArray, drift: FloatArray, rotation: FloatArray, sums: FloatArray,
) -> None:  # fmt: skip
    # Moves j: integrate w = M (u - o - drift_j), drift (3 J,) raw unit, from sample first[j] to last[j].
    # The rate of sample k applies to (k-1, k].
    # rotation (9 J,): R from the end body frame to the start body frame, row by row.
    # sums (36 J,): per move, sum of R dt times d for d = (1, u_x - o_x, u_y - o_y, u_z - o_z), nine numbers for each,
    # from which the derivative by matrix and offset follows: the small rotation in the start frame is sum R dw dt.
    m0, m1, m2, m3, m4 = matrix[0], matrix[1], matrix[2], matrix[3], matrix[4]
    m5, m6, m7, m8 = matrix[5], matrix[6], matrix[7], matrix[8]
    for i in range(sums.size):
        sums[i] = 0.0
    for j in range(first.size):
        out = sums[36 * j : 36 * j + 36]
        ox, oy, oz = offset[0] + drift[3 * j], offset[1] + drift[3 * j + 1], offset[2] + drift[3 * j + 2]
        r = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
        qw, qx, qy, qz = 1.0, 0.0, 0.0, 0.0
        for k in range(first[j] + 1, last[j] + 1):
            half = 0.5 * (time[k] - time[k - 1])
            dx, dy, dz = gyro[3 * k] - ox, gyro[3 * k + 1] - oy, gyro[3 * k + 2] - oz
            ax = (m0 * dx + m1 * dy + m2 * dz) * half
            ay = (m3 * dx + m4 * dy + m5 * dz) * half
            az = (m6 * dx + m7 * dy + m8 * dz) * half
            qw, qx, qy, qz = turned(qw, qx, qy, qz, ax, ay, az)
            unit = 1.5 - 0.5 * (qw * qw + qx * qx + qy * qy + qz * qz)  # one Newton step back to length one
            qw, qx, qy, qz = qw * unit, qx * unit, qy * unit, qz * unit
            t = matrix_of(qw, qx, qy, qz)
            for e in range(9):
                h = half * (r[e] + t[e])  # the mean of the step's two ends approximates its middle
                out[e] += h
                out[9 + e] += dx * h
                out[18 + e] += dy * h
                out[27 + e] += dz * h
            r = t
        for e in range(9):
            rotation[9 * j + e] = r[e]
