"""Kernel of a trial: device, correction, strapdown and pitch error in one pass, 32 trials abreast, no array in between.

Shapes and units: rows flat (rows, 5): true rate rad/s, cosine and sine of the true pitch; first, length (32,): a lane's rows;
p flat (FIELDS * 96,), field by field, axis by axis, lane by lane; key (96,); table flat (cells, 3, 2) reading unit, one after
the other. A lane never looks at its neighbours, so that its bits depend on nothing but its own trial.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from undrift.arrays import FloatArray, IntArray
from undrift.kernels.correct import SIX

UIntArray = NDArray[np.uint64]

LANES, WIDE = 32, 96  # trials abreast; times three axes
ROW = np.uint64(5)
L, L2, W = np.uint64(LANES), np.uint64(2 * LANES), np.uint64(WIDE)
ZERO, ONE, TWO, THREE, FOUR, FIVE = (np.uint64(i) for i in range(6))
SERIES_LIMIT = 0.01  # square of a half angle of 0.1 rad, as in rotation.py
TANGENT_LIMIT = 0.25  # tangent of half the pitch error: 28 deg; the first term left out is under 1e-16
IN_PLANE = math.sin(math.radians(5.0))  # as in orientation/angles.py
NEAREST = 6755399441055744.0  # 1.5 * 2^52: adding and taking it away rounds to the nearest whole number, ties to even

# Parameters, a field of 96 each: per axis and lane, or per lane in up to three columns.
OFFSET, OFFSET_1, OFFSET_2, SCALE_1 = (np.uint64(i * WIDE) for i in range(4))
D10, D11, D20, D21, D30, D31 = (np.uint64(i * WIDE) for i in range(4, 10))  # rate drift: power of rate, of warmth
WHITE, WALK, LOW, HIGH, B0, B1, B2, A1, A2 = (np.uint64(i * WIDE) for i in range(10, 19))
GAIN, NULL, FIRST_CODE, LAST_CODE, ROUNDING = (np.uint64(i * WIDE) for i in range(19, 24))
C_X, C_Y, C_Z, M_X, M_Y, M_Z = (np.uint64(i * WIDE) for i in range(24, 30))  # rows of the matrices, a column each
ZERO_READING = np.uint64(30 * WIDE)  # offset of the correction
TEMP, THERMO_A, THERMO_B, THERMO_C = (np.uint64(i * WIDE) for i in range(31, 35))  # see LANE_FIELDS of trial.py
START, TABLE = (np.uint64(i * WIDE) for i in range(35, 37))
FIELDS = 37
# State, after the parameters.
X, WARMTH, Z1, Z2, WALKED, FELT, Q, Q_END, SUMS, HALF, EXTRA = (np.uint64(i * WIDE) for i in range(37, 48))
NOISE_1, NOISE_2 = (np.uint64(i * WIDE) for i in range(48, 50))
SIZE = 50 * WIDE

GAMMA, MIX_1, MIX_2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
S27, S30, S31, S32, S52 = np.uint64(27), np.uint64(30), np.uint64(31), np.uint64(32), np.uint64(52)
LOW_WORD, FRACTION = np.uint64(0xFFFFFFFF), np.uint64(0x000FFFFFFFFFFFFF)
TWO_52_BITS, ONE_BITS = np.uint64(0x4330000000000000), np.uint64(0x3FF0000000000000)
TWO_52, TURN_4 = 4503599627370496.0, 2.0 * math.pi / 2.0**34
LN_2, ROOT_2, LN_ROOT_2 = math.log(2.0), math.sqrt(2.0), 0.5 * math.log(2.0)


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def normals(
    key: UIntArray, sample: int | np.uint64, z: UIntArray, f: FloatArray, out: FloatArray, a: np.uint64, b: np.uint64
) -> None:
    # Two normal numbers for each of 96 keys: splitmix64 of key + (sample + 1) gamma, its halves through Box and Muller.
    # z (288,) uint64 and f the same memory as float64; polynomials good to 1e-8. Out at a and b.
    step = (np.uint64(sample) + ONE) * GAMMA
    for j in range(W):
        h = key[j] + step
        h = (h ^ (h >> S30)) * MIX_1
        h = (h ^ (h >> S27)) * MIX_2
        h = h ^ (h >> S31)
        z[j] = (h >> S32) | TWO_52_BITS
        z[j + W] = (h & LOW_WORD) | TWO_52_BITS
    for j in range(W):
        f[j] = f[j] - (TWO_52 - 0.5)  # above 0, below 2^32
    for j in range(W):
        h = z[j]
        z[j + W + W] = (h >> S52) | TWO_52_BITS
        z[j] = (h & FRACTION) | ONE_BITS
    for j in range(W):
        m = f[j]
        s = (m - ROOT_2) / (m + ROOT_2)
        t = s * s
        log = (f[j + W + W] - (TWO_52 + 1055.0)) * LN_2 + LN_ROOT_2
        log += 2.0 * s * (1.0 + t * (1 / 3 + t * (1 / 5 + t * (1 / 7 + t * (1 / 9)))))
        radius = math.sqrt(max(-2.0 * log, 0.0))
        g = (f[j + W] - (TWO_52 + 2147483648.0)) * TURN_4  # a quarter of the angle
        t = g * g
        s = g * (1.0 - t * (1 / 6 - t * (1 / 120 - t * (1 / 5040 - t * (1 / 362880)))))
        c = 1.0 - t * (1 / 2 - t * (1 / 24 - t * (1 / 720 - t * (1 / 40320 - t * (1 / 3628800)))))
        c, s = c * c - s * s, 2.0 * s * c
        out[a + j], out[b + j] = radius * (c * c - s * s), radius * (2.0 * s * c)


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def felt(s: FloatArray, rows: FloatArray, at: IntArray, k: int) -> bool:
    # Motion of sample k through the matrix, temperature, thermometer; True where a lane's thermometer moved
    for j in range(L):
        i = np.uint64(at[j])
        x, y, z = rows[i], rows[i + ONE], rows[i + TWO]
        s[HALF + j], s[HALF + L + j], s[HALF + L2 + j] = x, y, z
        s[Q_END + L + j], s[Q_END + L2 + j] = rows[i + THREE], rows[i + FOUR]
    changed = 0.0
    for j in range(L):
        x, y, z = s[HALF + j], s[HALF + L + j], s[HALF + L2 + j]
        s[X + j] = s[C_X + j] * x + s[C_X + L + j] * y + s[C_X + L2 + j] * z
        s[X + L + j] = s[C_Y + j] * x + s[C_Y + L + j] * y + s[C_Y + L2 + j] * z
        s[X + L2 + j] = s[C_Z + j] * x + s[C_Z + L + j] * y + s[C_Z + L2 + j] * z
    for j in range(L):
        temp = s[TEMP + j] + s[TEMP + L + j] * float(k)
        warmth = temp - s[TEMP + L2 + j]
        s[WARMTH + j], s[WARMTH + L + j], s[WARMTH + L2 + j] = warmth, warmth, warmth
        before = temp if k == ZERO else s[FELT + j]
        lagging = temp if k == ZERO else s[FELT + L + j]
        lagging = s[THERMO_A + j] * lagging + s[THERMO_A + L + j] * temp + s[THERMO_A + L2 + j] * before
        s[FELT + j], s[FELT + L + j] = temp, lagging
        lacking = s[EXTRA + j]
        s[EXTRA + j] = lacking * s[THERMO_A + j]
        here = lagging + s[THERMO_B + j] * (1.0 - lacking)
        said = here + s[THERMO_B + L + j] + s[THERMO_B + L2 + j] * (here - 25.0)
        step = s[THERMO_C + j]
        code = ((said - s[THERMO_C + L2 + j]) * s[THERMO_C + L + j] + NEAREST) - NEAREST
        said = code * step + s[THERMO_C + L2 + j] if step > 0.0 else said
        changed += 1.0 if said != s[FELT + L2 + j] else 0.0
        s[FELT + L2 + j] = said
    return changed > 0.0


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def tabled(s: FloatArray, table: FloatArray) -> None:
    # Offset of the correction at the temperature that the thermometer says, held at the ends of the table
    for j in range(L):
        cells = s[START + L2 + j]
        if cells > 0.0:
            p = (s[FELT + L2 + j] - s[START + j]) * s[START + L + j]
            p = min(max(p, 0.0), cells)
            i = np.uint64(min(p, cells - 1.0))
            r = p - float(i)
            i = np.uint64(s[TABLE + j]) + SIX * i
            s[ZERO_READING + j] = table[i] + r * table[i + ONE]
            s[ZERO_READING + L + j] = table[i + TWO] + r * table[i + THREE]
            s[ZERO_READING + L2 + j] = table[i + FOUR] + r * table[i + FIVE]


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def device(s: FloatArray, first: bool) -> None:
    # Offset, thermal scale, rate drift, noise, rails, low-pass, converter: X becomes the reading less the correction's offset
    for j in range(W):
        d, x = s[WARMTH + j], s[X + j]
        x = x + (s[OFFSET + j] + (s[OFFSET_2 + j] * d + s[OFFSET_1 + j]) * d)
        x = x * (1.0 + s[SCALE_1 + j] * d)
        cubic, square, line = s[D30 + j] + s[D31 + j] * d, s[D20 + j] + s[D21 + j] * d, s[D10 + j] + s[D11 + j] * d
        x = x + ((cubic * x + square) * x + line) * x
        walked = 0.0 if first else s[WALKED + j] + s[WALK + j] * s[NOISE_2 + j]
        s[WALKED + j] = walked
        x = x + s[WHITE + j] * s[NOISE_1 + j] + walked
        low, high = s[LOW + j], s[HIGH + j]
        x = low if x < low else x
        s[X + j] = high if x > high else x
    if first:  # it had been resting before
        for j in range(W):
            s[Z1 + j], s[Z2 + j] = (1.0 - s[B0 + j]) * s[X + j], (s[B2 + j] - s[A2 + j]) * s[X + j]
    for j in range(W):
        x = s[X + j]
        y = s[B0 + j] * x + s[Z1 + j]
        s[Z1 + j] = s[B1 + j] * x - s[A1 + j] * y + s[Z2 + j]
        s[Z2 + j] = s[B2 + j] * x - s[A2 + j] * y
        v = s[NULL + j] + s[GAIN + j] * y
        near, down, how = (v + NEAREST) - NEAREST, math.floor(v), s[ROUNDING + j]
        v = near if how == 1.0 else v
        v = down if how == 2.0 else v
        low, high = s[FIRST_CODE + j], s[LAST_CODE + j]
        v = low if v < low else v
        v = high if v > high else v
        s[X + j] = v - s[ZERO_READING + j]


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def turned(s: FloatArray, half: float, trim: bool) -> None:
    # Matrix of the correction, then q = q exp(w dt)
    worst = 0.0
    for j in range(L):
        u, v, w = s[X + j], s[X + L + j], s[X + L2 + j]
        x = half * (s[M_X + j] * u + s[M_X + L + j] * v + s[M_X + L2 + j] * w)
        y = half * (s[M_Y + j] * u + s[M_Y + L + j] * v + s[M_Y + L2 + j] * w)
        z = half * (s[M_Z + j] * u + s[M_Z + L + j] * v + s[M_Z + L2 + j] * w)
        t = x * x + y * y + z * z
        s[HALF + j], s[HALF + L + j], s[HALF + L2 + j] = x, y, z
        s[EXTRA + L + j] = 1.0 - t * (1 / 6 - t * (1 / 120 - t * (1 / 5040 - t * (1 / 362880))))
        s[EXTRA + L2 + j] = 1.0 - t * (1 / 2 - t * (1 / 24 - t * (1 / 720 - t * (1 / 40320))))
        worst += 1.0 if t >= SERIES_LIMIT else 0.0
    if worst > 0.0:
        for j in range(L):
            x, y, z = s[HALF + j], s[HALF + L + j], s[HALF + L2 + j]
            t = x * x + y * y + z * z
            if t >= SERIES_LIMIT:
                t = math.sqrt(t)
                s[EXTRA + L + j], s[EXTRA + L2 + j] = math.sin(t) / t, math.cos(t)
    for j in range(L):
        r, c = s[EXTRA + L + j], s[EXTRA + L2 + j]
        x, y, z = r * s[HALF + j], r * s[HALF + L + j], r * s[HALF + L2 + j]
        qw, qx, qy, qz = s[Q + j], s[Q + L + j], s[Q + L2 + j], s[Q_END + j]
        s[Q + j] = (qw * c - qx * x) - (qy * y + qz * z)
        s[Q + L + j] = (qw * x + qx * c) + (qy * z - qz * y)
        s[Q + L2 + j] = (qw * y - qx * z) + (qy * c + qz * x)
        s[Q_END + j] = (qw * z + qx * y) - (qy * x - qz * c)
    if trim:
        for j in range(L):
            qw, qx, qy, qz = s[Q + j], s[Q + L + j], s[Q + L2 + j], s[Q_END + j]
            t = 1.5 - 0.5 * (qw * qw + qx * qx + qy * qy + qz * qz)
            s[Q + j], s[Q + L + j], s[Q + L2 + j], s[Q_END + j] = t * qw, t * qx, t * qy, t * qz


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def compared(s: FloatArray, length: FloatArray, k: float, axes: FloatArray) -> None:
    # Error of the sagittal pitch, into the sum of squares and the greatest of each lane; NaN where there is no pitch
    fx, fy, fz, ux, uy, uz = axes[0], axes[1], axes[2], axes[3], axes[4], axes[5]
    far = 0.0
    for j in range(L):
        qw, qx, qy, qz = s[Q + j], s[Q + L + j], s[Q + L2 + j], s[Q_END + j]
        x, y, z = 2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)
        along, upward = fx * x + fy * y + fz * z, ux * x + uy * y + uz * z
        ct, st = s[Q_END + L + j], s[Q_END + L2 + j]
        sine, cosine = -along * ct - upward * st, upward * ct - along * st
        r = math.sqrt(sine * sine + cosine * cosine)
        t = sine / (cosine + r)
        far += 1.0 if not abs(t) < TANGENT_LIMIT else 0.0
        v = t * t
        p = 1 / 13 - v * (1 / 15 - v * (1 / 17 - v * (1 / 19 - v * (1 / 21 - v * (1 / 23 - v * (1 / 25))))))
        e = 2.0 * t * (1.0 - v * (1 / 3 - v * (1 / 5 - v * (1 / 7 - v * (1 / 9 - v * (1 / 11 - v * p))))))
        s[X + j], s[X + L + j], s[X + L2 + j] = (e if r > IN_PLANE else math.nan), sine, cosine
    if far > 0.0:
        for j in range(L):
            sine, cosine = s[X + L + j], s[X + L2 + j]
            r = math.sqrt(sine * sine + cosine * cosine)
            if r > IN_PLANE and not abs(sine / (cosine + r)) < TANGENT_LIMIT:
                s[X + j] = math.atan2(sine, cosine)
    for j in range(L):
        e, live = s[X + j], k < length[j]
        size, greatest = abs(e), s[SUMS + L + j]
        s[SUMS + j] += e * e if live else 0.0
        s[SUMS + L + j] = size if live and size > greatest else greatest


@njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")
def trials(
    rows: FloatArray, first: IntArray, length: FloatArray, p: FloatArray, key: UIntArray, start: FloatArray,
    table: FloatArray, axes: FloatArray, step_s: float, noise: bool, out: FloatArray,
) -> None:  # fmt: skip
    # start (160,): w, x, y, z of the first orientation and what self-heating lacks; out (64,): RMS and greatest error, rad
    s = np.zeros(SIZE)
    s[: p.size] = p
    z = np.zeros(3 * WIDE, dtype=np.uint64)
    f = z.view(np.float64)
    at = first.copy()
    n = 0.0
    for j in range(L):
        s[Q + j], s[Q + L + j], s[Q + L2 + j], s[Q_END + j] = start[j], start[L + j], start[L2 + j], start[W + j]
        s[EXTRA + j] = start[W + L + j]
        s[FELT + L2 + j] = math.nan
        n = max(n, length[j])
    for k in range(np.uint64(n)):
        if felt(s, rows, at, k):
            tabled(s, table)
        if noise:
            normals(key, k, z, f, s, NOISE_1, NOISE_2)
        device(s, k == ZERO)
        if k > ZERO:
            turned(s, 0.5 * step_s, k % L == ZERO)
        compared(s, length, float(k), axes)
        for j in range(L):
            at[j] += 5 if float(k) + 1.0 < length[j] else 0
    for j in range(L):
        rms = math.sqrt(s[SUMS + j] / length[j])
        out[j] = rms
        out[j + L] = s[SUMS + L + j] if rms == rms else math.nan
