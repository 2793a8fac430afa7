"""Filter kernel: one second-order section (biquad) on three channels at a time.

Shapes and units: x, out flat (3 N,) any unit, not the same memory; b0, b1, b2, a1, a2 coefficients with a0 = 1; state (12,):
the last two inputs and the last two outputs, oldest first, changed in place.
"""

import numpy as np
from numba import njit

from undrift.arrays import FloatArray

ONE, TWO, THREE, SIX = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(6)
BLOCK = 192  # values whose forward part is made together, on vector units; the feedback part cannot be


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def forward_part(x: FloatArray, out: FloatArray, b0: float, b1: float, b2: float) -> None:
    # x (M + 6,), out (M,): v_k = b0 x_k + b1 x_(k-1) + b2 x_(k-2), channel by channel; indices only grow, so it vectorises
    for k in range(np.uint64(out.size)):
        out[k] = b0 * x[k + SIX] + b1 * x[k + THREE] + b2 * x[k]


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def biquad(
    x: FloatArray, out: FloatArray, b0: float, b1: float, b2: float, a1: float, a2: float, state: FloatArray
) -> None:
    # direct form I: v_k = b0 x_k + b1 x_(k-1) + b2 x_(k-2), then y_k = v_k - a2 y_(k-2) - a1 y_(k-1)
    p0, p1, p2, q0, q1, q2 = state[6], state[7], state[8], state[9], state[10], state[11]
    for start in range(0, x.size, BLOCK):
        stop = min(start + BLOCK, x.size)
        first = start
        if start == 0:  # the first two samples look back into the state
            first = min(6, stop)
            for k in range(first):
                before = x[k - 3] if k >= 3 else state[3 + k]
                out[k] = b0 * x[k] + b1 * before + b2 * state[k]
        if stop > first:
            forward_part(x[first - 6 : stop], out[first:stop], b0, b1, b2)
        for k in range(np.uint64(start), np.uint64(stop), THREE):
            y0 = (out[k] - a2 * p0) - a1 * q0
            y1 = (out[k + ONE] - a2 * p1) - a1 * q1
            y2 = (out[k + TWO] - a2 * p2) - a1 * q2
            p0, p1, p2, q0, q1, q2 = q0, q1, q2, y0, y1, y2
            out[k], out[k + ONE], out[k + TWO] = y0, y1, y2
    for k in range(3):
        state[k] = x[x.size - 6 + k] if x.size >= 6 else state[3 + k]
        state[3 + k] = x[x.size - 3 + k]
    state[6], state[7], state[8], state[9], state[10], state[11] = p0, p1, p2, q0, q1, q2
