"""Fixed point: every number of a triad as integers, and what that costs in accuracy.

Readings, temperatures and results are int32 with 16 bits behind the point (Q16.16); readings with fewer where their codes need
the room. A table holds int16 values q of a value y, one base and scale for each column::

    y = (base + q scale / 2^shift) / 2^bits        positions in a table have 16 bits behind the point too

Products are int64, sums are rounded to nearest, results saturate. Where nothing saturates and the result lies within
``FULL_RATE`` and ``FULL_FORCE`` on every axis, the error against exact arithmetic on the same inputs is at most ``bound``: the
sum of what each rounding can do at worst.
"""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError
from undrift.export.firmware import Axis, Table, Triad
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

OUT_BITS = 16
FULL_RATE = 2000.0 * RADIAN_PER_DEGREE  # rad/s: the range that the error bound is stated for
FULL_FORCE = 16.0 * STANDARD_GRAVITY  # m/s2
MATRIX_BITS = 28  # of the largest element: three products with a reading less its offset, 33 bits, stay below 2^62
MOST_SHIFT = 60
HALF = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FixedAxis:
    """One axis of a table in integers.

    Parameters
    ----------
    axis : Axis
        The same in real numbers.
    nodes : array of int
        All nodes, Q16.16; of an even axis the first and the last.
    inverse : array of int
        round(2^shift / width), of each cell or of all.
    shift : int
        Of ``inverse``.
    """

    axis: Axis
    nodes: IntArray
    inverse: IntArray
    shift: int

    @property
    def position_error(self) -> tuple[float, float]:
        """Worst error of a position: in units of the axis, from rounded nodes, and in cells, from the arithmetic."""
        reach = (self.axis.stop - self.axis.start) if self.axis.even else float(np.diff(self.axis.nodes).max())
        return HALF / 2**16, 1.0 / 2**16 + HALF * (reach + 2.0**-16) / 2**self.shift


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FixedTable:
    """A table in integers.

    Parameters
    ----------
    temp : FixedAxis
        Temperatures.
    turn_rate : FixedAxis or None
        Rates.
    values : array of int, shape of the table
        int16.
    base : array of int, shape (c,)
        Middle of each column.
    scale : array of int, shape (c,)
        Of each column.
    shift : int
        Of ``scale``.
    error : array, shape (c,)
        Worst error of a value looked up, in its own unit.
    """

    temp: FixedAxis
    turn_rate: FixedAxis | None
    values: IntArray
    base: IntArray
    scale: IntArray
    shift: int
    error: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FixedTriad:
    """A triad in integers.

    Parameters
    ----------
    raw_bits : int
        Bits behind the point of a reading.
    matrix, offset : array of int
        Constants; unused where there is a table.
    matrix_bits : int
        Bits behind the point of the matrix.
    half_step, g_sensitivity : array of int, or None
        As in ``Triad``.
    g_bits : int
        Bits behind the point of the g-sensitivity.
    offset_table, matrix_table, error_table, warm_up_table : FixedTable or None
        As in ``Triad``.
    bound : array, shape (3,)
        Worst error of a result, SI.
    """

    raw_bits: int
    matrix: IntArray
    offset: IntArray
    matrix_bits: int
    half_step: IntArray | None
    g_sensitivity: IntArray | None
    g_bits: int
    offset_table: FixedTable | None
    matrix_table: FixedTable | None
    error_table: FixedTable | None
    warm_up_table: FixedTable | None
    bound: FloatArray

    @property
    def out_shift(self) -> int:
        """From the product of matrix and reading to the result."""
        return self.raw_bits + self.matrix_bits - OUT_BITS


def fixed_triad(
    triad: Triad, *, raw_bits: int | None, full: float, accel_bound: FloatArray | None = None, accel_full: float = 0.0
) -> FixedTriad:
    """Return a triad in integers with its error bound.

    Parameters
    ----------
    triad : Triad
        In real numbers.
    raw_bits : int or None
        Bits behind the point of a reading; None for 16, or fewer where the offsets tell of codes that need the room.
    full : float
        Largest result that the bound is stated for, SI.
    accel_bound : array, shape (3,), optional
        Error bound of the specific force that the g-sensitivity meets, m/s2.
    accel_full : float
        Largest specific force that the bound is stated for, m/s2.

    Returns
    -------
    FixedTriad
        Ready to print.

    Raises
    ------
    InputError
        Values that 32 bits do not hold.
    """
    raw = _raw_bits(triad) if raw_bits is None else raw_bits
    bits = min(_bits_of(triad.matrices), MOST_SHIFT + OUT_BITS - raw)
    if raw + bits - OUT_BITS < 1:
        largest = float(np.abs(triad.matrices).max())
        raise InputError(
            f"fixed point, {triad.name}: wanted gains that 32 bits hold, got {largest:.3g} SI per {triad.unit_in}; use float"
        )
    half = 0.0 if triad.half_step is None else float(np.abs(triad.half_step).max())
    largest = max(half, triad.largest_offset)
    if largest * 2.0**raw >= 2.0**30:
        raise InputError(
            f"fixed point, {triad.name}: wanted offsets that leave room in 32 bits with {raw} bits behind the point, got "
            f"{largest:.6g} {triad.unit_in}; use fewer raw bits",
            raw_bits=raw,
        )
    g_bits = 1 if triad.g_sensitivity is None else max(1, min(_bits_of(triad.g_sensitivity[None]), MOST_SHIFT))
    offset_table = None if triad.offset_table is None else fixed_table(triad.offset_table, raw)
    matrix_table = None if triad.matrix_table is None else fixed_table(triad.matrix_table, bits)
    error_table = None if triad.error_table is None else fixed_table(triad.error_table, OUT_BITS)
    warm_up = None if triad.warm_up_table is None else fixed_table(triad.warm_up_table, raw)
    tables = offset_table, matrix_table, error_table, warm_up
    return FixedTriad(
        raw_bits=raw,
        matrix=_rounded(triad.matrix.ravel(), bits),
        offset=_rounded(triad.offset, raw),
        matrix_bits=bits,
        half_step=None if triad.half_step is None else _rounded(triad.half_step, raw),
        g_sensitivity=None if triad.g_sensitivity is None else _rounded(triad.g_sensitivity.ravel(), g_bits),
        g_bits=g_bits,
        offset_table=offset_table,
        matrix_table=matrix_table,
        error_table=error_table,
        warm_up_table=warm_up,
        bound=_bound(triad, tables, (raw, bits, g_bits), full, (accel_bound, accel_full)),
    )


def fixed_table(table: Table, bits: int) -> FixedTable:
    """Return a table in integers.

    Parameters
    ----------
    table : Table
        In real numbers.
    bits : int
        Bits behind the point of the values that come out.

    Returns
    -------
    FixedTable
        With the worst error of a value, columns apart.
    """
    flat = table.values.reshape(-1, table.values.shape[-1])
    middle, half = (flat.max(axis=0) + flat.min(axis=0)) / 2.0, np.ptp(flat, axis=0) / 2.0
    step = half / 32767.0
    q = np.round((flat - middle) / np.where(step > 0.0, step, 1.0)).astype(np.int64)
    fine = step * 2.0**bits / 2.0**16  # of one unit of a position-weighted value
    largest = float(fine.max())
    shift = 1 if largest == 0.0 else max(1, min(MOST_SHIFT, 30 - math.frexp(largest)[1]))
    if largest * 2.0**shift >= 2.0**30:
        raise InputError("fixed point: wanted a table whose values 32 bits hold, got more; use float")
    temp = _fixed_axis(table.temp)
    rate = None if table.turn_rate is None else _fixed_axis(table.turn_rate)
    error = step / 2.0 + (HALF + HALF + 2.0**31 * HALF / 2.0**shift) / 2.0**bits
    for place, axis in enumerate((temp, rate)):
        if axis is not None:
            error = error + _slope_error(axis, table.values, place, step)
    if rate is not None:
        error = error + step * HALF / 2**16
    return FixedTable(
        temp=temp,
        turn_rate=rate,
        values=q.reshape(table.values.shape),
        base=_rounded(middle, bits),
        scale=np.round(fine * 2.0**shift).astype(np.int64),
        shift=shift,
        error=error,
    )


def _slope_error(axis: FixedAxis, values: FloatArray, place: int, step: FloatArray) -> FloatArray:
    """What a wrong position does to a value, columns apart."""
    moved = np.abs(np.diff(values, axis=place))
    width = np.diff(axis.axis.nodes).reshape(-1, *([1] * (moved.ndim - 1 - place)))
    others = tuple(range(moved.ndim - 1))
    per_cell, per_unit = moved.max(axis=others) + step, (moved / width).max(axis=others)
    of_nodes, of_cells = axis.position_error
    worst: FloatArray = of_nodes * per_unit + of_cells * per_cell
    return worst


def _fixed_axis(axis: Axis) -> FixedAxis:
    nodes = _rounded(np.array([axis.start, axis.stop]) if axis.even else axis.nodes, 16)
    if int(np.abs(nodes).max()) >= 2**31 or not (np.diff(nodes) > 0).all():
        raise InputError(
            "fixed point: wanted nodes within 32767 and more than 1/65536 apart, got others; use float, or fewer nodes"
        )
    inverse = axis.inverse
    shift = max(1, min(34, 31 - math.frexp(float(inverse.max()))[1]))
    return FixedAxis(axis=axis, nodes=nodes, inverse=np.round(inverse * 2.0**shift).astype(np.int64), shift=shift)


def _raw_bits(triad: Triad) -> int:
    """Bits behind the point: 16, or what leaves codes of twice the largest offset room."""
    largest, bits = 2.0 * triad.largest_offset, 16
    while bits > 0 and largest * 2.0**bits >= 2.0**31:
        bits -= 1
    return bits


def _bits_of(matrices: FloatArray) -> int:
    largest = float(np.abs(matrices).max())
    return MATRIX_BITS if largest == 0.0 else MATRIX_BITS - math.frexp(largest)[1]


def _rounded(x: FloatArray, bits: int) -> IntArray:
    return np.round(x * 2.0**bits).astype(np.int64)


def _bound(
    triad: Triad,
    tables: tuple[FixedTable | None, FixedTable | None, FixedTable | None, FixedTable | None],
    bits: tuple[int, int, int],
    full: float,
    accel: tuple[FloatArray | None, float],
) -> FloatArray:
    """Sum of the worst cases, step by step."""
    of_offset, of_matrix, of_error, of_warm_up = tables
    raw, matrix, g = (2.0**-b for b in bits)
    out, gain = 2.0**-OUT_BITS, np.abs(triad.matrices).max(axis=0)
    g_sensitivity = np.zeros((3, 3)) if triad.g_sensitivity is None else np.abs(triad.g_sensitivity)
    e = np.zeros(3) if triad.error_table is None else np.abs(triad.error_table.values).max(axis=(0, 1))
    measured = full + e + g_sensitivity.sum(axis=1) * accel[1]  # before steps 4 and 5
    reading = np.abs(np.linalg.inv(triad.matrices)).max(axis=0) @ measured
    u = (HALF * raw if of_offset is None else of_offset.error) + (0.0 if triad.half_step is None else HALF * raw)
    u = u if of_warm_up is None else u + of_warm_up.error
    m = np.full((3, 3), HALF * matrix) if of_matrix is None else of_matrix.error.reshape(3, 3)
    worst = gain @ np.broadcast_to(u, 3) + m @ (reading + u) + HALF * out
    if triad.g_sensitivity is not None:
        of_accel = np.zeros(3) if accel[0] is None else accel[0]
        worst = worst + g_sensitivity @ of_accel + HALF * g * (3.0 * accel[1] + of_accel.sum()) + HALF * out
    if of_error is not None and triad.error_table is not None and triad.error_table.turn_rate is not None:
        width = np.diff(triad.error_table.turn_rate.nodes)[None, :, None]
        slope = np.abs(np.diff(triad.error_table.values, axis=1) / width).max(axis=(0, 1))
        worst = worst * (1.0 + slope) + of_error.error
    bound: FloatArray = worst * (1.0 + 1e-6)  # and the rounding of these sums themselves
    return bound
