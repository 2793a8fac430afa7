"""Correction kernels: raw readings to rate and specific force, one triad or both at a time.

Shapes and units: x, a, out flat (3 N,); temp (N,) degC; since (N,) s since power-on, or empty; m flat (9,) row by row, unit_out
per unit_in; o (3,) offset and h (3,) half a code step, unit_in; g flat (9,) unit_out per m/s2. Unsigned indices let the compiler
use the vector units.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from undrift.arrays import BoolArray, FloatArray

ZERO, ONE, TWO, THREE = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)
FOUR, SIX, TWELVE, EIGHTEEN = np.uint64(4), np.uint64(6), np.uint64(12), np.uint64(18)
BLOCK = 192  # values, 64 samples: longer blocks measured slower
AT_NODE = 1e-9  # of a cell: nearer to a node than this is on it


class Grid(NamedTuple):
    """Nodes of a table: ``inverse`` is one over the step, or 0 where the steps differ and nodes are searched."""

    nodes: FloatArray
    start: float
    inverse: float
    cells: int


class Tables(NamedTuple):
    """Cell coefficients of one triad's tables, flat; an empty array where there is no such table."""

    offset: FloatArray
    offset_temp: Grid
    matrix: FloatArray
    matrix_temp: Grid
    error: FloatArray
    error_temp: Grid
    error_rate: Grid


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def affine(x: FloatArray, out: FloatArray, m: FloatArray, o: FloatArray, h: FloatArray) -> None:
    # out = M (x + h sign(x) - o); h is zero unless codes were truncated toward zero, and code 0, |x| < h, stays
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    o0, o1, o2, h0, h1, h2 = o[0], o[1], o[2], h[0], h[1], h[2]
    if h0 == 0.0 and h1 == 0.0 and h2 == 0.0:  # the signs would cost half as much again
        for k in range(ZERO, np.uint64(x.size), THREE):
            x0, x1, x2 = x[k] - o0, x[k + ONE] - o1, x[k + TWO] - o2
            out[k] = m0 * x0 + m1 * x1 + m2 * x2
            out[k + ONE] = m3 * x0 + m4 * x1 + m5 * x2
            out[k + TWO] = m6 * x0 + m7 * x1 + m8 * x2
        return
    for k in range(ZERO, np.uint64(x.size), THREE):
        x0, x1, x2 = x[k], x[k + ONE], x[k + TWO]
        x0 = x0 + (math.copysign(h0, x0) if abs(x0) > h0 else 0.0) - o0
        x1 = x1 + (math.copysign(h1, x1) if abs(x1) > h1 else 0.0) - o1
        x2 = x2 + (math.copysign(h2, x2) if abs(x2) > h2 else 0.0) - o2
        out[k] = m0 * x0 + m1 * x1 + m2 * x2
        out[k + ONE] = m3 * x0 + m4 * x1 + m5 * x2
        out[k + TWO] = m6 * x0 + m7 * x1 + m8 * x2


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def subtract_g(a: FloatArray, out: FloatArray, g: FloatArray) -> None:
    # out -= G a
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[7], g[8]
    for k in range(ZERO, np.uint64(a.size), THREE):
        a0, a1, a2 = a[k], a[k + ONE], a[k + TWO]
        out[k] -= g0 * a0 + g1 * a1 + g2 * a2
        out[k + ONE] -= g3 * a0 + g4 * a1 + g5 * a2
        out[k + TWO] -= g6 * a0 + g7 * a1 + g8 * a2


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def affine_pair(
    x: FloatArray, y: FloatArray, out: FloatArray, out_a: FloatArray,
    m: FloatArray, o: FloatArray, h: FloatArray, n: FloatArray, p: FloatArray, q: FloatArray, g: FloatArray,
) -> None:  # fmt: skip
    # a = N (y + q sign(y) - p), w = M (x + h sign(x) - o) - G a
    if h[0] != 0.0 or h[1] != 0.0 or h[2] != 0.0 or q[0] != 0.0 or q[1] != 0.0 or q[2] != 0.0:
        for start in range(0, x.size, BLOCK):  # a block at a time: the second look at it costs no memory
            stop = min(start + BLOCK, x.size)
            affine(y[start:stop], out_a[start:stop], n, p, q)
            affine(x[start:stop], out[start:stop], m, o, h)
            subtract_g(out_a[start:stop], out[start:stop], g)
        return
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    n0, n1, n2, n3, n4, n5, n6, n7, n8 = n[0], n[1], n[2], n[3], n[4], n[5], n[6], n[7], n[8]
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[7], g[8]
    o0, o1, o2, p0, p1, p2 = o[0], o[1], o[2], p[0], p[1], p[2]
    for k in range(ZERO, np.uint64(x.size), THREE):  # one loop: each reading is fetched once, each result written once
        y0, y1, y2 = y[k] - p0, y[k + ONE] - p1, y[k + TWO] - p2
        x0, x1, x2 = x[k] - o0, x[k + ONE] - o1, x[k + TWO] - o2
        a0 = n0 * y0 + n1 * y1 + n2 * y2
        a1 = n3 * y0 + n4 * y1 + n5 * y2
        a2 = n6 * y0 + n7 * y1 + n8 * y2
        out_a[k], out_a[k + ONE], out_a[k + TWO] = a0, a1, a2
        out[k] = m0 * x0 + m1 * x1 + m2 * x2 - (g0 * a0 + g1 * a1 + g2 * a2)
        out[k + ONE] = m3 * x0 + m4 * x1 + m5 * x2 - (g3 * a0 + g4 * a1 + g5 * a2)
        out[k + TWO] = m6 * x0 + m7 * x1 + m8 * x2 - (g6 * a0 + g7 * a1 + g8 * a2)


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def search(nodes: FloatArray, x: float) -> np.uint64:
    # index of the cell that holds x, by bisection; the first or last cell where x lies outside
    low, high = ZERO, np.uint64(nodes.size) - ONE
    while high - low > ONE:
        middle = (low + high) // TWO
        if x >= nodes[middle]:
            low = middle
        else:
            high = middle
    return low


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def cell(grid: Grid, x: float) -> tuple[np.uint64, float]:
    # cell index and fraction in [0, 1]: held at the ends, NaN where x is NaN
    if grid.inverse > 0.0:
        p = (x - grid.start) * grid.inverse
        last = float(grid.cells - 1)
        low = p if p > 0.0 else 0.0
        i = np.uint64(low if low < last else last)
        f = p - float(i)
    else:
        i = search(grid.nodes, x)
        f = (x - grid.nodes[i]) / (grid.nodes[i + ONE] - grid.nodes[i])
    f = 0.0 if f < 0.0 else f
    f = 1.0 if f > 1.0 else f
    return i, f


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def warmed(x: FloatArray, since: FloatArray, out: FloatArray, h: FloatArray, grid: Grid, cells: FloatArray) -> None:
    # out = x + h sign(x) - warm_up(since); cells (cells, 3, 2) flat: value and slope; zero from the last node on
    settled = grid.nodes[-1]
    for k in range(np.uint64(since.size)):
        i, f = cell(grid, since[k])
        for axis in range(THREE):
            q, j = THREE * k + axis, SIX * i + TWO * axis
            u = x[q] + (math.copysign(h[axis], x[q]) if abs(x[q]) > h[axis] else 0.0)
            out[q] = u - (cells[j] + f * cells[j + ONE]) if since[k] < settled else u


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def tabulated(
    x: FloatArray, temp: FloatArray, a: FloatArray, out: FloatArray,
    m: FloatArray, o: FloatArray, h: FloatArray, g: FloatArray, tables: Tables,
) -> tuple[float, float]:  # fmt: skip
    # w = M(T) (x + h sign(x) - o(T)) - G a - e(w, T), e bilinear; a empty without g-sensitivity. Returns the least and the
    # greatest measured rate, so that the caller can tell whether it left the table.
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    g0, g1, g2, g3, g4, g5, g6, g7, g8 = g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[7], g[8]
    o0, o1, o2, h0, h1, h2 = o[0], o[1], o[2], h[0], h[1], h[2]
    po, pm, pe = tables.offset, tables.matrix, tables.error
    has_offset, has_matrix, has_error, has_g = po.size > 0, pm.size > 0, pe.size > 0, a.size > 0
    rate_cells = np.uint64(tables.error_rate.cells)
    least, greatest = math.inf, -math.inf
    for k in range(np.uint64(temp.size)):
        q = THREE * k
        t = temp[k]
        if has_offset:
            i, f = cell(tables.offset_temp, t)
            i = SIX * i
            o0 = po[i] + f * po[i + ONE]
            o1 = po[i + TWO] + f * po[i + THREE]
            o2 = po[i + FOUR] + f * po[i + FOUR + ONE]
        if has_matrix:
            i, f = cell(tables.matrix_temp, t)
            i = EIGHTEEN * i
            m0, m1, m2 = pm[i] + f * pm[i + ONE], pm[i + TWO] + f * pm[i + THREE], pm[i + FOUR] + f * pm[i + FOUR + ONE]
            i += SIX
            m3, m4, m5 = pm[i] + f * pm[i + ONE], pm[i + TWO] + f * pm[i + THREE], pm[i + FOUR] + f * pm[i + FOUR + ONE]
            i += SIX
            m6, m7, m8 = pm[i] + f * pm[i + ONE], pm[i + TWO] + f * pm[i + THREE], pm[i + FOUR] + f * pm[i + FOUR + ONE]
        x0, x1, x2 = x[q], x[q + ONE], x[q + TWO]
        x0 = x0 + (math.copysign(h0, x0) if abs(x0) > h0 else 0.0) - o0
        x1 = x1 + (math.copysign(h1, x1) if abs(x1) > h1 else 0.0) - o1
        x2 = x2 + (math.copysign(h2, x2) if abs(x2) > h2 else 0.0) - o2
        w0 = m0 * x0 + m1 * x1 + m2 * x2
        w1 = m3 * x0 + m4 * x1 + m5 * x2
        w2 = m6 * x0 + m7 * x1 + m8 * x2
        if has_g:
            a0, a1, a2 = a[q], a[q + ONE], a[q + TWO]
            w0 -= g0 * a0 + g1 * a1 + g2 * a2
            w1 -= g3 * a0 + g4 * a1 + g5 * a2
            w2 -= g6 * a0 + g7 * a1 + g8 * a2
        if has_error:
            least = w0 if w0 < least else least
            least = w1 if w1 < least else least
            least = w2 if w2 < least else least
            greatest = w0 if w0 > greatest else greatest
            greatest = w1 if w1 > greatest else greatest
            greatest = w2 if w2 > greatest else greatest
            i, f = cell(tables.error_temp, t)
            i *= rate_cells
            j, r = cell(tables.error_rate, w0)
            j = TWELVE * (i + j)
            w0 -= pe[j] + f * pe[j + ONE] + r * (pe[j + TWO] + f * pe[j + THREE])
            j, r = cell(tables.error_rate, w1)
            j = TWELVE * (i + j) + FOUR
            w1 -= pe[j] + f * pe[j + ONE] + r * (pe[j + TWO] + f * pe[j + THREE])
            j, r = cell(tables.error_rate, w2)
            j = TWELVE * (i + j) + FOUR + FOUR
            w2 -= pe[j] + f * pe[j + ONE] + r * (pe[j + TWO] + f * pe[j + THREE])
        out[q], out[q + ONE], out[q + TWO] = w0, w1, w2
    return least, greatest


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def half(grid: Grid, x: float) -> np.uint64:
    # 2 i on node i, 2 i + 1 between nodes i and i + 1
    i, f = cell(grid, x)
    return TWO * i + (ZERO if f < AT_NODE else TWO if f > 1.0 - AT_NODE else ONE)


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def mark_line(temp: FloatArray, low: float, high: float, grid: Grid, stated: FloatArray, mask: BoolArray) -> float:
    # stated (2 cells + 1,): uncertainty on and between nodes, -1 where data were near. Sets mask (N,) where temperatures from
    # low to high meet another; returns the largest that they met, or -1.
    largest = -1.0
    for k in range(np.uint64(temp.size)):
        t = temp[k]
        if low <= t <= high:
            u = stated[half(grid, t)]
            if u >= 0.0:
                mask[k] = True
                largest = u if u > largest else largest
    return largest


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def mark_plane(
    temp: FloatArray, w: FloatArray, low: float, high: float, temp_grid: Grid, rate_grid: Grid, stated: FloatArray,
    mask: BoolArray,
) -> float:  # fmt: skip
    # as mark_line, for temperatures and rates w flat (3 N,), rad/s; stated (2 temperature cells + 1, 2 rate cells + 1) flat
    largest, row = -1.0, TWO * np.uint64(rate_grid.cells) + ONE
    for k in range(np.uint64(temp.size)):
        t = temp[k]
        if low <= t <= high:
            i = row * half(temp_grid, t)
            for axis in range(THREE):
                x = w[THREE * k + axis]
                u = stated[i + half(rate_grid, x)] if x == x else -1.0
                if u >= 0.0:
                    mask[k] = True
                    largest = u if u > largest else largest
    return largest
