"""Kernels of the note's method over many sessions at once: its fit, and the pitch error that each calibration leaves in a trial.

Of S sessions one after the other, N dwells: gyro (N, 3) mean readings, raw unit; rate (N,) read rate about the axis, rad/s; temp
(N,) degC; axis (N,); soak (N,); turning (N,) false at rest; first (S + 1,) where each begins. Tables as the
correction takes them: line (S, 6 cells) offset over static_c, plane (S cells of both, 12) flat from plane_first on: error over
dynamic_c and an even grid of 2 half + 1 rates up to top, rad/s. matrix (S, 9) rad/s per raw unit, offset (S, 3) raw unit,
good (S,).
"""

import math

import numpy as np
from numba import njit

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.kernels.correct import Grid, Tables, tabulated
from undrift.kernels.rotation import strapdown

# ---- cubic splines through every point, not-a-knot ends


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def slopes(x: FloatArray, y: FloatArray, n: int, s: FloatArray, c: FloatArray) -> None:
    # s: slope at each of n points, of one tridiagonal system; c is scratch
    h0, d0 = x[1] - x[0], (y[1] - y[0]) / (x[1] - x[0])
    if n == 2:
        s[0], s[1] = d0, d0
        return
    h1, d1 = x[2] - x[1], (y[2] - y[1]) / (x[2] - x[1])
    if n == 3:
        bend = (d1 - d0) / (h0 + h1)
        s[0], s[1], s[2] = d0 - bend * h0, d0 + bend * h0, d1 + bend * h1
        return
    c[0] = (h0 + h1) / h1
    s[0] = ((h0 + 2.0 * (h0 + h1)) * h1 * d0 + h0 * h0 * d1) / ((h0 + h1) * h1)
    for i in range(1, n - 1):
        h1, d1 = x[i + 1] - x[i], (y[i + 1] - y[i]) / (x[i + 1] - x[i])
        pivot = 2.0 * (h0 + h1) - h1 * c[i - 1]
        c[i] = h0 / pivot
        s[i] = (3.0 * (h1 * d0 + h0 * d1) - h1 * s[i - 1]) / pivot
        if i < n - 2:
            h0, d0 = h1, d1
    whole = h0 + h1
    last = (h1 * h1 * d0 + (2.0 * whole + h1) * h0 * d1) / whole
    s[n - 1] = (last - whole * s[n - 2]) / (h0 - whole * c[n - 2])
    for i in range(n - 2, -1, -1):
        s[i] -= c[i] * s[i + 1]


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def value(x: FloatArray, y: FloatArray, s: FloatArray, i: int, at: float) -> float:
    # of the cubic of cell i, also beyond its ends
    h, t = x[i + 1] - x[i], at - x[i]
    d = (y[i + 1] - y[i]) / h
    bend = (s[i] + s[i + 1] - 2.0 * d) / h
    found: float = y[i] + t * (s[i] + t * ((d - s[i]) / h - bend + t * bend / h))
    return found


# ---- the note's fit


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def rests(
    gyro: FloatArray, temp: FloatArray, turning: BoolArray, soak: IntArray, start: int, stop: int,
    temps: FloatArray, offsets: FloatArray,
) -> bool:  # fmt: skip
    # mean temperature (K,) and reading (K, 3) of the rests at each soak; false where one has none, or they do not rise
    count = np.zeros(temps.size)
    temps[:], offsets[:] = 0.0, 0.0
    for j in range(start, stop):
        if not turning[j]:
            k = soak[j]
            count[k] += 1.0
            temps[k] += temp[j]
            for i in range(3):
                offsets[k, i] += gyro[j, i]
    for k in range(temps.size):
        temps[k] /= count[k]
        offsets[k] /= count[k]
        if count[k] == 0.0 or (k > 0 and not temps[k] > temps[k - 1]):
            return False
    return True


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def matrix_by_eq6(
    gyro: FloatArray, rate: FloatArray, axis: IntArray, turning: BoolArray, soak: IntArray, start: int, stop: int,
    home: int, offset: FloatArray, m: FloatArray,
) -> bool:  # fmt: skip
    # C = L S^T (S S^T)^-1 of one soak; false where the readings do not span three axes
    g, h = np.zeros((3, 3)), np.zeros((3, 3))
    for j in range(start, stop):
        if turning[j] and soak[j] == home:
            for p in range(3):
                own = gyro[j, p] - offset[p]
                h[axis[j], p] += rate[j] * own
                for q in range(3):
                    g[p, q] += own * (gyro[j, q] - offset[q])
    a, b = g[1, 1] * g[2, 2] - g[1, 2] * g[2, 1], g[1, 2] * g[2, 0] - g[1, 0] * g[2, 2]
    c = g[1, 0] * g[2, 1] - g[1, 1] * g[2, 0]
    det = g[0, 0] * a + g[0, 1] * b + g[0, 2] * c
    if not det > 1e-12 * g[0, 0] * g[1, 1] * g[2, 2]:
        return False
    inverse = np.array([
        [a, g[0, 2] * g[2, 1] - g[0, 1] * g[2, 2], g[0, 1] * g[1, 2] - g[0, 2] * g[1, 1]],
        [b, g[0, 0] * g[2, 2] - g[0, 2] * g[2, 0], g[0, 2] * g[1, 0] - g[0, 0] * g[1, 2]],
        [c, g[0, 1] * g[2, 0] - g[0, 0] * g[2, 1], g[0, 0] * g[1, 1] - g[0, 1] * g[1, 0]],
    ])  # fmt: skip
    for p in range(3):
        for q in range(3):
            m[3 * p + q] = (h[p, 0] * inverse[0, q] + h[p, 1] * inverse[1, q] + h[p, 2] * inverse[2, q]) / det
    return True


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def left_over_rate(
    gyro: FloatArray, rate: FloatArray, axis: IntArray, turning: BoolArray, soak: IntArray, start: int, stop: int,
    offsets: FloatArray, m: FloatArray, top: float, half: int, error: FloatArray,
) -> bool:  # fmt: skip
    # error (K, 2 half + 1, 3): at each soak a spline through what is left over the measured rate; false where two are equal
    most = stop - start + 1
    x, y, s, c = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    for k in range(offsets.shape[0]):
        for i in range(3):
            n = 1
            x[0], y[0] = 0.0, 0.0
            for j in range(start, stop):
                if turning[j] and soak[j] == k and axis[j] == i:
                    w = 0.0
                    for p in range(3):
                        w += m[3 * i + p] * (gyro[j, p] - offsets[k, p])
                    at = n
                    while at > 0 and x[at - 1] > w:
                        x[at], y[at] = x[at - 1], y[at - 1]
                        at -= 1
                    x[at], y[at] = w, w - rate[j]
                    n += 1
            for j in range(1, n):
                if not x[j] > x[j - 1]:
                    return False
            if n < 2:
                return False
            slopes(x, y, n, s, c)
            at = 0
            for node in range(2 * half + 1):
                w = min(max(top * (node - half) / half, x[0]), x[n - 1])
                while at < n - 2 and w > x[at + 1]:
                    at += 1
                error[k, node, i] = value(x, y, s, at, w)
    return True


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def over_temperature(
    temps: FloatArray, curve: FloatArray, nodes: FloatArray, hold: bool, s: FloatArray, c: FloatArray, out: FloatArray
) -> None:
    # curve (K,) of temps (K,) at nodes: continued beyond the ends, or held there
    n, at = temps.size, 0
    slopes(temps, curve, n, s, c)
    for k in range(nodes.size):
        t = min(max(nodes[k], temps[0]), temps[n - 1]) if hold else nodes[k]
        while at < n - 2 and t > temps[at + 1]:
            at += 1
        out[k] = value(temps, curve, s, at, t)


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def fit_sessions(
    gyro: FloatArray, rate: FloatArray, temp: FloatArray, axis: IntArray, soak: IntArray, turning: BoolArray, first: IntArray,
    room: float, soaks: int, static_c: FloatArray, dynamic_c: FloatArray, top: FloatArray, half: IntArray,
    plane_first: IntArray, matrix: FloatArray, offset: FloatArray, line: FloatArray, plane: FloatArray, good: BoolArray,
) -> None:  # fmt: skip
    temps, offsets, s, c = np.empty(soaks), np.empty((soaks, 3)), np.empty(soaks), np.empty(soaks)
    own, static = np.empty(soaks), np.empty(static_c.size)
    for session in range(first.size - 1):
        start, stop, m = first[session], first[session + 1], matrix[session]
        good[session] = False
        if not rests(gyro, temp, turning, soak, start, stop, temps, offsets):
            continue
        home = int(np.argmin(np.abs(temps - room)))
        offset[session] = offsets[home]
        if not matrix_by_eq6(gyro, rate, axis, turning, soak, start, stop, home, offsets[home], m):
            continue
        if soaks == 1:
            good[session] = True
            continue
        for i in range(3):
            own[:] = offsets[:, i]
            over_temperature(temps, own, static_c, False, s, c, static)
            for k in range(static_c.size - 1):
                line[session, 6 * k + 2 * i] = static[k]
                line[session, 6 * k + 2 * i + 1] = static[k + 1] - static[k]
        count = 2 * half[session] + 1
        error, table = np.empty((soaks, count, 3)), np.empty((count, 3, dynamic_c.size))
        if not left_over_rate(
            gyro, rate, axis, turning, soak, start, stop, offsets, m, top[session], half[session], error
        ):
            continue
        for node in range(count):
            for i in range(3):
                own[:] = error[:, node, i]
                over_temperature(temps, own, dynamic_c, True, s, c, table[node, i])
        cell = plane_first[session]
        for k in range(dynamic_c.size - 1):
            for node in range(count - 1):
                for i in range(3):
                    corner, warm, fast = table[node, i, k], table[node, i, k + 1], table[node + 1, i, k]
                    plane[cell], plane[cell + 1], plane[cell + 2] = corner, warm - corner, fast - corner
                    plane[cell + 3] = table[node + 1, i, k + 1] - warm - (fast - corner)
                    cell += 4
        good[session] = True


# ---- a trial corrected and integrated with each calibration


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def corrected(
    u: FloatArray, temp: FloatArray, static_c: FloatArray, dynamic_c: FloatArray, top: FloatArray, half: IntArray,
    plane_first: IntArray, matrix: FloatArray, offset: FloatArray, line: FloatArray, plane: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    # out (S, 3 T): rates, rad/s, that each calibration makes of readings u flat (3 T,), raw unit
    none, h, g = np.empty(0), np.zeros(3), np.zeros(9)
    unused = Grid(none, 0.0, 0.0, 1)
    static, dynamic = unused, unused
    if static_c.size > 1:
        static = Grid(static_c, static_c[0], (static_c.size - 1) / (static_c[-1] - static_c[0]), static_c.size - 1)
        dynamic = Grid(
            dynamic_c, dynamic_c[0], (dynamic_c.size - 1) / (dynamic_c[-1] - dynamic_c[0]), dynamic_c.size - 1
        )
    for session in range(out.shape[0]):
        rates = Grid(none, -top[session], half[session] / top[session], 2 * half[session])
        error = plane[plane_first[session] : plane_first[session + 1]]
        tables = Tables(line[session], static, none, unused, error, dynamic, rates)
        tabulated(u, temp, none, out[session], matrix[session], offset[session], h, g, tables)


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def pitch_errors(
    rate: FloatArray, time: FloatArray, q0: FloatArray, pitch: FloatArray, skip: int, last: int, in_plane: float,
    good: BoolArray, out: FloatArray,
) -> None:  # fmt: skip
    # out (S, 3 V): for each of V true pitches, pitch (V, T) rad, the root-mean-square and the largest error over the samples
    # from ``skip`` on, and the size of the median of the ``last`` ones, rad; NaN where a fit is not good.
    # rate (S, 3 T), rad/s, from the instant of q0 (S, 4) on.
    q, end = np.empty(4 * time.size), np.empty((pitch.shape[0], last))
    square, largest = np.empty((2, pitch.shape[0]))
    count, ending = np.empty((2, pitch.shape[0]), np.int64)
    for session in range(good.size):
        out[session] = np.nan
        if not good[session]:
            continue
        strapdown(rate[session], time, q0[session], q)
        square[:], largest[:], count[:], ending[:] = 0.0, 0.0, 0, 0
        for k in range(skip, time.size):
            qw, qx, qy, qz = q[4 * k], q[4 * k + 1], q[4 * k + 2], q[4 * k + 3]
            along, up = 2.0 * (qx * qz - qw * qy), 1.0 - 2.0 * (qx * qx + qy * qy)
            if not math.hypot(along, up) > in_plane:
                continue
            found = math.atan2(-along, up)
            for v in range(pitch.shape[0]):
                if math.isnan(pitch[v, k]):
                    continue
                apart = found - pitch[v, k]
                apart -= 2.0 * math.pi * math.floor(apart / (2.0 * math.pi) + 0.5)
                square[v] += apart * apart
                largest[v] = max(largest[v], abs(apart))
                count[v] += 1
                if k >= time.size - last:
                    end[v, ending[v]] = apart
                    ending[v] += 1
        for v in range(pitch.shape[0]):
            if count[v] > 0:
                out[session, 3 * v], out[session, 3 * v + 1] = math.sqrt(square[v] / count[v]), largest[v]
            if ending[v] > 0:
                out[session, 3 * v + 2] = abs(np.median(end[v, : ending[v]]))
