"""Kernels of the Allan variance: mean square of second and third differences.

Shapes and units: phase (N,), any unit (the running sum of the reading times the sample period); differences over m samples.
"""

from numba import njit

from undrift.arrays import FloatArray


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
