"""The position in a loop of hysteresis, sample by sample: drift/hysteresis.py has the model.

Shapes and units: temp (N,) degC, NaN in gaps; time (N,) s; out (N,) position; x, y flat (3 N,) readings; state (7,), written back.
"""

import math

import numpy as np
from numba import njit

from undrift.arrays import FloatArray
from undrift.kernels.correct import ONE, SIX, THREE, TWO, Grid, cell


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def follow(
    temp: FloatArray, time: FloatArray, crossing: float, settle: float, smooth: float, state: FloatArray, out: FloatArray
) -> None:  # fmt: skip
    # state: first and last time, readings so far, their mean, where low and high were last moved, low, high. The mean takes all
    # readings until settle, then exponential; low and high are moved from settle on, and before that only for the output.
    first, last, count, mean, at, low, high = state
    for k in range(temp.size):
        t = temp[k]
        if t == t:
            first = time[k] if count == 0.0 else first
            count += 1.0
            if time[k] - first < settle or count == 1.0:
                mean = t if count == 1.0 else mean + (t - mean) / count
            else:
                mean += (t - mean) * (time[k] - last) / (smooth + time[k] - last)
            last = time[k]
        at = mean if math.isnan(at) and last - first >= settle else at
        change = 0.0 if math.isnan(at) or math.isnan(mean) else 2.0 * (mean - at) / crossing
        least, most = min(max(low - change, -1.0), 1.0), min(max(high - change, -1.0), 1.0)
        out[k] = 0.5 * (least + most)
        if last - first >= settle:
            at, low, high = mean, least, most
    state[0], state[1], state[2], state[3], state[4], state[5], state[6] = first, last, count, mean, at, low, high


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def without_loop(
    x: FloatArray, temp: FloatArray, position: FloatArray, out: FloatArray, h: FloatArray, grid: Grid, cells: FloatArray
) -> None:  # fmt: skip
    # out = x + h sign(x) - position half(temp); cells (cells, 3, 2) flat: value and slope
    for k in range(np.uint64(temp.size)):
        i, f = cell(grid, temp[k])
        for axis in range(THREE):
            q, j = THREE * k + axis, SIX * i + TWO * axis
            u = x[q] + (math.copysign(h[axis], x[q]) if abs(x[q]) > h[axis] else 0.0)
            out[q] = u - position[k] * (cells[j] + f * cells[j + ONE])
