"""Correction kernels: raw readings to rate and specific force, for one triad or for both.

Shapes and units: x, a and out are flat (3 N,). temp (N,) is in degC. since (N,) is the time since power-on, s, or empty. m is flat
(9,) row by row, unit_out per unit_in. Offset o (3,) and rounding loss h (3,) are in unit_in. g is flat (9,), unit_out per m/s2.
Unsigned indices let the compiler use the vector units.
"""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from undrift.arrays import FloatArray
from undrift.kernels.compilation import compiled
from undrift.kernels.tables import Grid, Tables

IndexArray: TypeAlias = NDArray[np.uint32]
ZERO, ONE, TWO, THREE = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)
FOUR, FIVE, SIX, EIGHT = np.uint64(4), np.uint64(5), np.uint64(6), np.uint64(8)
TWELVE, EIGHTEEN = np.uint64(12), np.uint64(18)
LOOKED_UP = 256  # number of samples whose cells are found together: shorter and longer blocks are slower


@compiled
def affine(x: FloatArray, out: FloatArray, m: FloatArray, o: FloatArray) -> None:
    # out = M (x - o)
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    o0, o1, o2 = o[0], o[1], o[2]
    for k in range(ZERO, np.uint64(x.size), THREE):
        x0, x1, x2 = x[k] - o0, x[k + ONE] - o1, x[k + TWO] - o2
        out[k] = m0 * x0 + m1 * x1 + m2 * x2
        out[k + ONE] = m3 * x0 + m4 * x1 + m5 * x2
        out[k + TWO] = m6 * x0 + m7 * x1 + m8 * x2


@compiled
def subtract_g(a: FloatArray, out: FloatArray, g: FloatArray) -> None:
    # out -= G a
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[7], g[8]
    for k in range(ZERO, np.uint64(a.size), THREE):
        a0, a1, a2 = a[k], a[k + ONE], a[k + TWO]
        out[k] -= g0 * a0 + g1 * a1 + g2 * a2
        out[k + ONE] -= g3 * a0 + g4 * a1 + g5 * a2
        out[k + TWO] -= g6 * a0 + g7 * a1 + g8 * a2


@compiled
def affine_pair(
    x: FloatArray, y: FloatArray, out: FloatArray, out_a: FloatArray,
    m: FloatArray, o: FloatArray, n: FloatArray, p: FloatArray, g: FloatArray,
) -> None:  # fmt: skip
    # a = N (y - p), w = M (x - o) - G a
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    n0, n1, n2, n3, n4, n5, n6, n7, n8 = n[0], n[1], n[2], n[3], n[4], n[5], n[6], n[7], n[8]
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[7], g[8]
    o0, o1, o2, p0, p1, p2 = o[0], o[1], o[2], p[0], p[1], p[2]
    for k in range(ZERO, np.uint64(x.size), THREE):  # one loop: each value is read or written once
        y0, y1, y2 = y[k] - p0, y[k + ONE] - p1, y[k + TWO] - p2
        x0, x1, x2 = x[k] - o0, x[k + ONE] - o1, x[k + TWO] - o2
        a0 = n0 * y0 + n1 * y1 + n2 * y2
        a1 = n3 * y0 + n4 * y1 + n5 * y2
        a2 = n6 * y0 + n7 * y1 + n8 * y2
        out_a[k], out_a[k + ONE], out_a[k + TWO] = a0, a1, a2
        out[k] = m0 * x0 + m1 * x1 + m2 * x2 - (g0 * a0 + g1 * a1 + g2 * a2)
        out[k + ONE] = m3 * x0 + m4 * x1 + m5 * x2 - (g3 * a0 + g4 * a1 + g5 * a2)
        out[k + TWO] = m6 * x0 + m7 * x1 + m8 * x2 - (g6 * a0 + g7 * a1 + g8 * a2)


@compiled
def search(nodes: FloatArray, x: float) -> np.uint64:
    # index of the cell that contains x, by bisection, or of the first or last cell for x outside
    low, high = ZERO, np.uint64(nodes.size) - ONE
    while high - low > ONE:
        middle = (low + high) // TWO
        if x >= nodes[middle]:
            low = middle
        else:
            high = middle
    return low


@compiled
def even_cell(start: float, inverse: float, last: float, x: float) -> tuple[np.int32, float]:
    # as cell, for an even grid with a given last cell (32 bits, the only integers to which vector units convert)
    p = (x - start) * inverse
    low = p if p > 0.0 else 0.0
    i = np.int32(low if low < last else last)
    f = p - float(i)
    f = 0.0 if f < 0.0 else f
    f = 1.0 if f > 1.0 else f
    return i, f


@compiled
def cell(grid: Grid, x: float) -> tuple[np.uint64, float]:
    # cell index and fraction, limited to [0, 1], or NaN for x = NaN
    if grid.inverse > 0.0:
        even, f = even_cell(grid.start, grid.inverse, float(grid.cells - 1), x)
        return np.uint64(even), f
    i = search(grid.nodes, x)
    f = (x - grid.nodes[i]) / (grid.nodes[i + ONE] - grid.nodes[i])
    f = 0.0 if f < 0.0 else f
    f = 1.0 if f > 1.0 else f
    return i, f


@compiled
def cells_of(grid: Grid, x: FloatArray, index: IndexArray, fraction: FloatArray) -> None:
    # cell of each value
    if grid.inverse > 0.0:
        start, inverse, last = grid.start, grid.inverse, float(grid.cells - 1)
        for k in range(np.uint64(x.size)):  # runs in the vector units
            index[k], fraction[k] = even_cell(start, inverse, last, x[k])
        return
    for k in range(np.uint64(x.size)):
        index[k], fraction[k] = cell(grid, x[k])


@compiled
def add_half_step(x: FloatArray, out: FloatArray, h: FloatArray) -> None:
    # out = x + h sign(x), but x for code 0, |x| < |h|
    for k in range(0, x.size, 3):
        for axis in range(3):
            u, half = x[k + axis], h[axis]
            out[k + axis] = u + ((half if u > 0.0 else -half) if abs(u) > abs(half) else 0.0)


@compiled
def on_line(p: FloatArray, j: np.uint64, f: float) -> tuple[float, float, float]:
    # three neighbours of a table over one dimension
    return p[j] + f * p[j + ONE], p[j + TWO] + f * p[j + THREE], p[j + FOUR] + f * p[j + FIVE]


@compiled
def on_plane(p: FloatArray, j: np.uint64, f: float, r: float) -> float:
    value: float = p[j] + f * p[j + ONE] + r * (p[j + TWO] + f * p[j + THREE])
    return value


@compiled
def linear(
    x: FloatArray, a: FloatArray, out: FloatArray, m: FloatArray, o: FloatArray, g: FloatArray, tables: Tables,
    offset_at: IndexArray, offset_f: FloatArray, matrix_at: IndexArray, matrix_f: FloatArray,
) -> None:  # fmt: skip
    # out = M(T) (x - o(T)) - G a for a block (a is empty without g-sensitivity)
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[7], g[8]
    o0, o1, o2 = o[0], o[1], o[2]
    po, pm = tables.offset, tables.matrix
    has_offset, has_matrix, has_g = po.size > 0, pm.size > 0, a.size > 0
    for k in range(np.uint64(x.size) // THREE):
        q = THREE * k
        if has_offset:
            o0, o1, o2 = on_line(po, SIX * np.uint64(offset_at[k]), offset_f[k])
        if has_matrix:
            i, f = EIGHTEEN * np.uint64(matrix_at[k]), matrix_f[k]
            m0, m1, m2 = on_line(pm, i, f)
            m3, m4, m5 = on_line(pm, i + SIX, f)
            m6, m7, m8 = on_line(pm, i + TWELVE, f)
        x0, x1, x2 = x[q] - o0, x[q + ONE] - o1, x[q + TWO] - o2
        w0 = m0 * x0 + m1 * x1 + m2 * x2
        w1 = m3 * x0 + m4 * x1 + m5 * x2
        w2 = m6 * x0 + m7 * x1 + m8 * x2
        if has_g:
            a0, a1, a2 = a[q], a[q + ONE], a[q + TWO]
            w0 -= g0 * a0 + g1 * a1 + g2 * a2
            w1 -= g3 * a0 + g4 * a1 + g5 * a2
            w2 -= g6 * a0 + g7 * a1 + g8 * a2
        out[q], out[q + ONE], out[q + TWO] = w0, w1, w2


@compiled
def extremes(w: FloatArray, least: float, greatest: float) -> tuple[float, float]:
    # minimum and maximum of all values and of the given two (a separate chain per axis avoids waiting)
    l0 = l1 = l2 = least
    u0 = u1 = u2 = greatest
    for k in range(ZERO, np.uint64(w.size), THREE):
        w0, w1, w2 = w[k], w[k + ONE], w[k + TWO]
        l0, l1, l2 = w0 if w0 < l0 else l0, w1 if w1 < l1 else l1, w2 if w2 < l2 else l2
        u0, u1, u2 = w0 if w0 > u0 else u0, w1 if w1 > u1 else u1, w2 if w2 > u2 else u2
    return min(l0, l1, l2), max(u0, u1, u2)


@compiled
def tabulated(
    x: FloatArray, temp: FloatArray, a: FloatArray, out: FloatArray,
    m: FloatArray, o: FloatArray, g: FloatArray, tables: Tables,
) -> tuple[float, float]:  # fmt: skip
    # w = M(T) (x - o(T)) - G a - e(w, T) with bilinear e (a is empty without g-sensitivity). Returns the minimum and
    # maximum measured rate, so that the caller can check the range of the table. Cells are computed a block at a time, before their
    # coefficients are read, which is twice as fast as sample by sample.
    cell_index, f = np.empty(LOOKED_UP, np.uint32), np.empty(LOOKED_UP)
    matrix_at, matrix_f = np.empty(LOOKED_UP, np.uint32), np.empty(LOOKED_UP)
    rate_at, r = np.empty(3 * LOOKED_UP, np.uint32), np.empty(3 * LOOKED_UP)
    pe, rate_cells = tables.error, np.uint64(tables.error_rate.cells)
    least, greatest = math.inf, -math.inf
    for start in range(0, temp.size, LOOKED_UP):
        stop = min(start + LOOKED_UP, temp.size)
        t, u, w = temp[start:stop], x[3 * start : 3 * stop], out[3 * start : 3 * stop]
        if tables.offset.size > 0:
            cells_of(tables.offset_temp, t, cell_index, f)
        if tables.matrix.size > 0:
            cells_of(tables.matrix_temp, t, matrix_at, matrix_f)
        linear(u, a[3 * start : 3 * stop], w, m, o, g, tables, cell_index, f, matrix_at, matrix_f)
        if pe.size == 0:
            continue
        least, greatest = extremes(w, least, greatest)
        cells_of(tables.error_temp, t, cell_index, f)
        cells_of(tables.error_rate, w, rate_at, r)
        for k in range(np.uint64(t.size)):
            q, i = THREE * k, rate_cells * np.uint64(cell_index[k])
            w[q] -= on_plane(pe, TWELVE * (i + np.uint64(rate_at[q])), f[k], r[q])
            w[q + ONE] -= on_plane(pe, TWELVE * (i + np.uint64(rate_at[q + ONE])) + FOUR, f[k], r[q + ONE])
            w[q + TWO] -= on_plane(pe, TWELVE * (i + np.uint64(rate_at[q + TWO])) + EIGHT, f[k], r[q + TWO])
    return least, greatest


@compiled
def without_line(x: FloatArray, since: FloatArray, out: FloatArray, grid: Grid, cells: FloatArray) -> None:
    # out = x - line(at): warm-up over the time since power-on, with flat cells (cells, 3, 2) of value and slope
    for k in range(np.uint64(since.size)):
        i, f = cell(grid, since[k])
        for axis in range(THREE):
            q, j = THREE * k + axis, SIX * i + TWO * axis
            out[q] = x[q] - (cells[j] + f * cells[j + ONE])


# ---- while the device turns: segments.py has the rule. rate flat (3 N,) rad/s, NaN in gaps; time (N,) s; out (N,) 1 or 0;
# state (5,): low-passed rate, time of the last reading, last time at which it was above (updated in place)


@compiled
def follow_turning(
    rate: FloatArray, time: FloatArray, above: float, mean_s: float, hold_s: float, state: FloatArray, out: FloatArray
) -> None:  # fmt: skip
    m0, m1, m2, last, last_turning = state
    for k in range(time.size):
        w0, w1, w2, t = rate[3 * k], rate[3 * k + 1], rate[3 * k + 2], time[k]
        if w0 == w0 and w1 == w1 and w2 == w2:
            share = 1.0 if math.isnan(last) else (t - last) / (mean_s + t - last)
            m0, m1, m2, last = m0 + share * (w0 - m0), m1 + share * (w1 - m1), m2 + share * (w2 - m2), t
            last_turning = t if m0 * m0 + m1 * m1 + m2 * m2 > above * above else last_turning
        out[k] = 1.0 if t - last_turning <= hold_s else 0.0
    state[0], state[1], state[2], state[3], state[4] = m0, m1, m2, last, last_turning


# ---- a thermometer's time constant taken off by a causal lead, sample by sample over uneven steps. temp and out (N,) degC in
# different memory, time (N,) s, lag and smooth in s; state (4,) contains time and value of the last reading, the low-passed value
# and the last output, NaN before the first reading (updated in place)


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
