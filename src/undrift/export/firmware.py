"""The constants of correction (correction/plan.py) as firmware evaluates them: tables on findable grids, and all of it in integers.

A table whose nodes are whole multiples of one step is put on the even grid that holds them all, where the cell is found by one
multiplication; one that would more than double its memory that way keeps its nodes, and the cell is found by bisection in a
number of steps that depends on the table alone. Either way a lookup takes constant time.

Then the same in integers with its error bound, the cost of each build, and the lead that removes a thermometer's lag.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.correction.plan import Constants, LookupTable, TableAxis, constants_of
from undrift.errors import InputError
from undrift.model import SENSORS, Calibration
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

TABLES = ("offset_table", "matrix_table", "error_table", "warm_up_table")


def named_tables(constants: Constants) -> list[tuple[str, LookupTable]]:
    """Return the tables that firmware has, by name."""
    return [(name, getattr(constants, name)) for name in TABLES if getattr(constants, name) is not None]


def triads_of(calibration: Calibration) -> tuple[Constants | None, Constants | None]:
    """Return gyroscopes and accelerometers as firmware evaluates them."""
    if calibration.gyro is None and calibration.accel is None:
        raise InputError("export: wanted a model of gyroscopes or accelerometers, got neither; calibrate first")
    gyro, accel = (
        None if triad.model is None else _on_grids(constants_of(calibration, name))
        for name, triad in zip(SENSORS, calibration.triads, strict=True)
    )
    return gyro, accel


def _on_grids(constants: Constants) -> Constants:
    """Return the constants with findable tables; NaN in any of them is refused."""
    tables = named_tables(constants)
    parts = [constants.matrix, *(table.values for _, table in tables), constants.half_step, constants.g_sensitivity]
    parts += [constants.offset] if constants.offset_table is None else []
    missing = sum(int(np.isnan(part).sum()) for part in parts if part is not None)
    if missing:
        raise InputError(
            f"export: wanted numbers throughout the model of the {constants.name}, got {missing} NaN; calibrate what is missing",
            missing=missing,
        )
    findable: dict[str, Any] = {name: table.evened(lambda nodes: 2 * len(nodes) + 8) for name, table in tables}
    return replace(constants, **findable)


def stride_of(axis: TableAxis) -> int:
    """Return the first stride of a bisection: the largest power of two below the number of cells, at least 1."""
    return 1 << max(0, (axis.cells - 1).bit_length() - 1)


def matrices_of(constants: Constants) -> FloatArray:
    """Return every matrix that a triad may use, shape (n, 3, 3)."""
    table = constants.matrix_table
    return constants.matrix[None] if table is None else table.values.reshape(-1, 3, 3)


def largest_offset(constants: Constants) -> float:
    """Return what may come off a reading at most, raw unit."""
    table, warm_up = constants.offset_table, constants.warm_up_table
    most = float(np.abs(constants.offset if table is None else table.values).max())
    return most if warm_up is None else most + float(np.abs(warm_up.values).max())


# ---- Fixed point
#
# Readings, temperatures and results are int32 with 16 bits behind the point (Q16.16); readings with fewer where their codes
# need the room. A table holds int16 values q of a value y, one base and scale for each column:
#
#     y = (base + q scale / 2^shift) / 2^bits        positions in a table have 16 bits behind the point too
#
# Products are int64, sums are rounded to nearest, results saturate. Where nothing saturates and the result lies within
# FULL_RATE and FULL_FORCE on every axis, the error against exact arithmetic on the same inputs is at most ``bound``: the sum
# of the worst that each rounding can do.

OUT_BITS = 16
FULL_RATE = 2000.0 * RADIAN_PER_DEGREE  # rad/s: the range that the error bound is stated for
FULL_FORCE = 16.0 * STANDARD_GRAVITY  # m/s2
MATRIX_BITS = 28  # of the largest element: three products with a reading less its offset, 33 bits, stay below 2^62
MOST_SHIFT = 60
HALF = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FixedAxis:
    """One axis of a table in integers."""

    axis: TableAxis  # The same in real numbers
    nodes: IntArray  # All nodes, Q16.16; of an even axis the first and the last
    inverse: IntArray  # round(2^shift / width), of each cell or of all
    shift: int  # Of ``inverse``


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FixedTable:
    """A table in integers."""

    temp: FixedAxis  # Temperatures
    turn_rate: FixedAxis | None  # Rates
    values: IntArray  # int16
    base: IntArray  # (c,), middle of each column
    scale: IntArray  # (c,), of each column
    shift: int  # Of ``scale``
    error: FloatArray  # (c,), worst error of a value looked up, in its own unit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FixedTriad:
    """A triad in integers."""

    raw_bits: int  # Bits behind the point of a reading
    matrix: IntArray  # Constants; unused where there is a table
    offset: IntArray
    matrix_bits: int  # Bits behind the point of the matrix
    half_step: IntArray | None  # As in ``Constants``
    g_sensitivity: IntArray | None
    g_bits: int  # Bits behind the point of the g-sensitivity
    offset_table: FixedTable | None  # As in ``Constants``
    matrix_table: FixedTable | None
    error_table: FixedTable | None
    warm_up_table: FixedTable | None
    bound: FloatArray  # (3,), worst error of a result, SI

    @property
    def out_shift(self) -> int:
        """From the product of matrix and reading to the result."""
        return self.raw_bits + self.matrix_bits - OUT_BITS


def fixed_triad(
    triad: Constants,
    *,
    raw_bits: int | None,
    full: float,
    accel_bound: FloatArray | None = None,
    accel_full: float = 0.0,
) -> FixedTriad:
    """Return a triad in integers with its error bound: accel_bound (3,) m/s2."""
    # bits behind the point of a reading: 16, or what leaves codes of twice the largest offset room
    raw = max(0, min(16, 30 - math.frexp(largest_offset(triad))[1])) if raw_bits is None else raw_bits
    bits = min(_bits_of(matrices_of(triad)), MOST_SHIFT + OUT_BITS - raw)
    if raw + bits - OUT_BITS < 1:
        largest = float(np.abs(matrices_of(triad)).max())
        raise InputError(
            f"fixed point, {triad.name}: wanted gains that 32 bits hold, got {largest:.3g} SI per {triad.unit_in}; use float"
        )
    half = 0.0 if triad.half_step is None else float(np.abs(triad.half_step).max())
    largest = max(half, largest_offset(triad))
    if largest * 2.0**raw >= 2.0**30:
        raise InputError(
            f"fixed point, {triad.name}: wanted offsets that leave room in 32 bits with {raw} bits behind the point, got "
            f"{largest:.6g} {triad.unit_in}; use fewer raw bits",
            raw_bits=raw,
        )
    g_bits = 1 if triad.g_sensitivity is None else max(1, min(_bits_of(triad.g_sensitivity[None]), MOST_SHIFT))
    places = dict(zip(TABLES, (raw, bits, OUT_BITS, raw), strict=True))
    held = {name: getattr(triad, name) for name in TABLES}
    tables = {name: None if table is None else fixed_table(table, places[name]) for name, table in held.items()}
    return FixedTriad(
        raw_bits=raw,
        matrix=_rounded(triad.matrix.ravel(), bits),
        offset=_rounded(triad.offset, raw),
        matrix_bits=bits,
        half_step=None if triad.half_step is None else _rounded(triad.half_step, raw),
        g_sensitivity=None if triad.g_sensitivity is None else _rounded(triad.g_sensitivity.ravel(), g_bits),
        g_bits=g_bits,
        bound=_bound(triad, tables, (raw, bits, g_bits), full, (accel_bound, accel_full)),
        **tables,
    )


def fixed_table(table: LookupTable, bits: int) -> FixedTable:
    """Return a table in integers."""
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
    reach = axis.axis.stop - axis.axis.start if axis.axis.even else float(np.diff(axis.axis.nodes).max())
    # of a position: in units of the axis, from rounded nodes, and in cells, from the arithmetic
    of_nodes, of_cells = HALF / 2**16, 1.0 / 2**16 + HALF * (reach + 2.0**-16) / 2**axis.shift
    worst: FloatArray = of_nodes * per_unit + of_cells * per_cell
    return worst


def _fixed_axis(axis: TableAxis) -> FixedAxis:
    nodes = _rounded(np.array([axis.start, axis.stop]) if axis.even else axis.nodes, 16)
    if int(np.abs(nodes).max()) >= 2**31 or not (np.diff(nodes) > 0).all():
        raise InputError(
            "fixed point: wanted nodes within 32767 and more than 1/65536 apart, got others; use float, or fewer nodes"
        )
    inverse = axis.inverse
    shift = max(1, min(34, 31 - math.frexp(float(inverse.max()))[1]))
    return FixedAxis(axis=axis, nodes=nodes, inverse=np.round(inverse * 2.0**shift).astype(np.int64), shift=shift)


def _bits_of(matrices: FloatArray) -> int:
    largest = float(np.abs(matrices).max())
    return MATRIX_BITS if largest == 0.0 else MATRIX_BITS - math.frexp(largest)[1]


def _rounded(x: FloatArray, bits: int) -> IntArray:
    return np.round(x * 2.0**bits).astype(np.int64)


def _bound(
    triad: Constants,
    tables: dict[str, FixedTable | None],
    bits: tuple[int, int, int],
    full: float,
    accel: tuple[FloatArray | None, float],
) -> FloatArray:
    """Sum of the worst cases, step by step."""
    of_offset, of_matrix, of_error, of_warm_up = (tables[name] for name in TABLES)
    raw, matrix, g = (2.0**-b for b in bits)
    out, matrices = 2.0**-OUT_BITS, matrices_of(triad)
    gain = np.abs(matrices).max(axis=0)
    g_sensitivity = np.zeros((3, 3)) if triad.g_sensitivity is None else np.abs(triad.g_sensitivity)
    e = np.zeros(3) if triad.error_table is None else np.abs(triad.error_table.values).max(axis=(0, 1))
    measured = full + e + g_sensitivity.sum(axis=1) * accel[1]  # before steps 4 and 5
    reading = np.abs(np.linalg.inv(matrices)).max(axis=0) @ measured
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


# ---- Cost of a build: bytes of flash, and cycles of one sample
#
# Tables are counted byte by byte. Instructions are estimates for a Cortex-M4F at -O2 with tables in flash without wait states:
# float uses its floating-point unit, double is done in software, fixed point uses the 32 by 32 bit multiplier. A sample costs
# the sum of its steps, each so many loads, products, comparisons and so on, counted by hand from the generated source.

Arithmetic = Literal["float", "double", "fixed"]
ASSUMPTION = "Cortex-M4F, -O2, no wait states, double in software"


STEPS = {  # of one step in float, double and fixed: cycles, then bytes of code
    "call": (40, 55, 40),  # Entering, copying in and out
    "place": (24, 290, 20),  # A cell and a position on an even grid
    "stride": (9, 40, 8),  # One comparison of a bisection
    "between": (12, 190, 24),  # A value between two nodes
    "both": (36, 560, 52),  # A value between four nodes, without its place on the rate axis
    "row": (17, 330, 44),  # Three products of a matrix with a vector, summed
    "less": (8, 90, 16),  # Half a step and offset of one axis
    "lead": (320, 4900, 1700),  # One call that removes the lag, with a step of time of at most half the smoothing
    "code_base": (300, 520, 430),  # Once
    "code_triad": (140, 260, 170),  # For each triad
    "code_table": (120, 260, 150),  # For each table over temperature
    "code_warm_up": (200, 400, 250),  # For the warm-up with its second entry
    "code_lead": (260, 520, 460),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What one build costs."""

    arithmetic: Arithmetic  # float, double or fixed
    table_bytes: int  # Constants, exact
    code_bytes: int  # Instructions, estimated
    cycles: int  # One call of the correction, with the warm-up where there is one, estimated
    lead_cycles: int = 0  # One call that removes the lag, estimated; 0 where there is none

    @property
    def flash_bytes(self) -> int:
        """Constants and instructions."""
        return self.table_bytes + self.code_bytes


def cost_of(triads: tuple[Constants, ...], arithmetic: Arithmetic, table_bytes: int, *, lead: bool = False) -> Cost:
    """Return what a build costs."""
    steps = {name: row[("float", "double", "fixed").index(arithmetic)] for name, row in STEPS.items()}
    cycles, code = steps["call"], steps["code_base"] + steps["code_lead"] * lead

    def place(axis: TableAxis) -> int:
        return steps["place"] + (0 if axis.even else stride_of(axis).bit_length() * steps["stride"])

    for triad in triads:
        code += steps["code_triad"] + steps["code_table"] * len(triad.tables)
        cycles += 3 * (steps["less"] + steps["row"])
        if triad.g_sensitivity is not None:
            cycles += 3 * (steps["row"] + 2)
        for table in triad.tables:
            cycles += place(table.temp)
            if table.turn_rate is None:
                cycles += table.values.shape[-1] * steps["between"]
            else:
                cycles += 3 * (place(table.turn_rate) + steps["both"])
        if triad.warm_up_table is not None:
            code += steps["code_warm_up"]
            cycles += place(triad.warm_up_table.temp) + 3 * (steps["between"] + steps["less"])
    ahead = steps["lead"] * lead
    return Cost(arithmetic=arithmetic, table_bytes=table_bytes, code_bytes=code, cycles=cycles, lead_cycles=ahead)


# ---- Lead: removes a thermometer's lag, the filter of drift/temperature.py rewritten
#
# With d = x - z, how far the reading x is from its low-passed z, a = dt / smooth, and g = lag / smooth:
#
#     d = e^-a d + m (x - x_before)     m = (1 - e^-a) / a          y = x + (g - 1) d
#
# so that two numbers are carried, and d is small where the temperature is steady: float loses little.

STEP_BITS = 20  # behind the point of a step of time: 1 us, up to 2047 s
SHORTEST_S, LONGEST_S = 1e-3, 1e5  # smoothing that 32 bits hold with their accuracy
MOST_GAIN = 2.0**15


@dataclass(frozen=True, slots=True, kw_only=True)
class Lead:
    """Constants of the lead."""

    lag_s: float  # The thermometer's time constant
    smooth_s: float  # Time constant of the smoothing
    gain: float  # g - 1
    fixed_gain: int  # g - 1 with 16 bits behind the point
    rate: float  # One over the smoothing, 1/s
    fixed_rate: int  # The same with 30 significant bits
    rate_shift: int  # How far the product of a step and ``fixed_rate`` is moved down to have 31 bits behind the point


def lead_of(calibration: Calibration) -> Lead | None:
    """Return the lead that a calibration asks for."""
    drift = calibration.drift
    if drift is None or not drift.lag_s > 0.0 or (drift.static, drift.scale, drift.dynamic) == (None, None, None):
        return None
    smooth = drift.lag_smooth_s
    if not (SHORTEST_S <= smooth <= LONGEST_S and drift.lag_s / smooth <= MOST_GAIN):
        raise InputError(
            f"export c: wanted a lag smoothed over {SHORTEST_S:g} to {LONGEST_S:g} s, of at most {MOST_GAIN:g} times that, got "
            f"{drift.lag_s:g} s over {smooth:g} s; fit the lag again"
        )
    gain, rate = drift.lag_s / smooth - 1.0, 1.0 / smooth
    bits = 30 - math.frexp(rate)[1]  # behind the point of the fixed rate
    return Lead(
        lag_s=drift.lag_s,
        smooth_s=smooth,
        gain=gain,
        fixed_gain=round(gain * 2**16),
        rate=rate,
        fixed_rate=round(rate * 2.0**bits),
        rate_shift=bits + STEP_BITS - 31,
    )
