"""Kernel of dwells: white noise through the low-pass and the converter about a steady value, averaged.

Shapes and units: steady (N, 3) signal before the low-pass, nominal input units; samples (N,) per dwell; white (3,) standard
deviation of a sample; b, a (3, 3) difference equation of the low-pass, b[:, 0] = 1 and the rest 0 for none; converter (5,) gain
and null in steps, first and last code, rounding: 0 none, 1 nearest, 2 down; rails (2,) unit of the signal. Out: mean and variance
of the samples (N, 3).
"""

import math

import numpy as np
from numba import njit

from undrift.arrays import FloatArray, IntArray


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def dwell_readings(
    steady: FloatArray, samples: IntArray, burn_in: int, white: FloatArray, b: FloatArray, a: FloatArray,
    converter: FloatArray, rails: FloatArray, rng: np.random.Generator, mean: FloatArray, variance: FloatArray,
) -> None:  # fmt: skip
    gain, null, first, last, rounding = converter[0], converter[1], converter[2], converter[3], converter[4]
    for j in range(steady.shape[0]):
        for i in range(3):
            level, sd, n = steady[j, i], white[i], samples[j]
            b0, b1, b2, a1, a2 = b[i, 0], b[i, 1], b[i, 2], a[i, 1], a[i, 2]
            z1, z2 = (1.0 - b0) * level, (b2 - a2) * level  # the filter rests at the level
            total, squares, pivot = 0.0, 0.0, 0.0
            for k in range(-burn_in, n):
                x = level + (sd * rng.standard_normal() if sd > 0.0 else 0.0)
                x = min(max(x, rails[0]), rails[1])
                y = b0 * x + z1
                z1 = b1 * x - a1 * y + z2
                z2 = b2 * x - a2 * y
                u = null + gain * y
                if rounding == 1.0:
                    u = np.rint(u)
                elif rounding == 2.0:
                    u = math.floor(u)
                if rounding > 0.0:
                    u = min(max(u, first), last)
                if k < 0:
                    continue
                if k == 0:
                    pivot = u
                total += u - pivot
                squares += (u - pivot) * (u - pivot)
            mean[j, i] = pivot + total / n
            variance[j, i] = max(squares - total * total / n, 0.0) / max(n - 1, 1)


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def follow(x: FloatArray, keep: FloatArray) -> None:
    # Unit normal numbers x (N, 3) to a first-order Gauss-Markov process of unit variance: x_j = keep x_(j-1) + sqrt(1 - keep^2) x_j
    for j in range(1, x.shape[0]):
        fresh = math.sqrt(1.0 - keep[j - 1] * keep[j - 1])
        for i in range(x.shape[1]):
            x[j, i] = keep[j - 1] * x[j - 1, i] + fresh * x[j, i]
