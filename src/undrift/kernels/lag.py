"""Lag kernel: a thermometer's time constant taken off by a causal lead, sample by sample over uneven steps.

Shapes and units: temp, time, out (N,) degC, s, degC, out not the same memory; lag, smooth s; state (4,): time and value of the
last reading, the low-passed value, and the last output; NaN before the first reading; changed in place.
"""

import math

import numpy as np
from numba import njit

from undrift.arrays import FloatArray


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
