"""A calibration made ready for the correction kernels: units folded in, one flat plan a triad.

For readings in unit r, with c model units per r and s SI units per unit the model gives, the kernels take ::

    M' = s M c        offset' = offset / c        h' = half a code step / c        warm_up' = warm_up / c

Tables made ready for the correction kernels: steps made even, cells turned into coefficients.

A table over nodes t_0 < ... < t_n is linear between them and held at its ends. In cell i, with f = (t - t_i) / (t_(i+1) - t_i)::

    one dimension    y = y_i + f (y_(i+1) - y_i)
    two dimensions   y = c0 + f c1 + r c2 + f r c3        r the fraction along the second axis

Nodes that are whole multiples of one step (a rate grid with a gap around zero) are filled up to an even grid, which changes no
value and finds the cell by one multiplication; others are searched.

What the tables are looked up with, sample by sample: the temperature of the sensors and the time since power-on.

The tables are over the temperature that the sensors have. Where the calibration says that the thermometer trails them (lag_s > 0),
lag.py takes that off, looking back only, and hands its state from chunk to chunk. The record keeps what was recorded; lookup, range
check and warnings look at the temperature without lag.

Where a record meets nodes that no data were near, and how uncertain the tables say they are there.

A value between two nodes draws on both, a value on a node on that one alone. A table is therefore looked at in halves: 2 i stands
for node i, 2 i + 1 for what lies between nodes i and i + 1, and a half is extrapolated where any node that it draws on is.
"""

import copy
import os
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, TypeAlias, TypeVar

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.drift.thermometer_lag import LagState, without_lag
from undrift.errors import InputError
from undrift.model import Calibration, DriftTables, DynamicDrift, Rounding, TriadModel
from undrift.record import Record
from undrift.units import Quantity, is_physical, si_factor

if TYPE_CHECKING:
    from undrift.kernels.correct import Grid, Tables

# ---- Tables made ready for the correction kernels: steps made even, cells turned into coefficients.

MOST_NODES = 4096  # an even grid finer than this is not worth its memory
EVEN_WITHIN = 1e-9  # of a step


def even_nodes(nodes: FloatArray) -> FloatArray | None:
    """Return the even grid that holds all nodes, or None where there is none of a sensible size.

    Arrays: nodes (n,) -> (m,).
    """
    span = nodes[-1] - nodes[0]
    cells = span / np.diff(nodes).min()
    for parts in (1, 2, 3):  # the smallest gap may itself be two or three steps
        count = round(float(cells) * parts)
        if count + 1 > MOST_NODES:
            return None
        places = (nodes - nodes[0]) * (count / span)
        if np.abs(places - np.round(places)).max() < EVEN_WITHIN:
            grid: FloatArray = np.linspace(nodes[0], nodes[-1], count + 1)
            return grid
    return None


def grid_of(nodes: FloatArray) -> "Grid":
    """Return how the kernel finds the cell: by one multiplication on the even grid, where there is one, else by bisection.

    Arrays: nodes (n,).
    """
    from undrift.kernels.correct import Grid

    fine = even_nodes(nodes)
    held = np.array(nodes) if fine is None else fine
    cells = len(held) - 1
    return Grid(held, float(held[0]), 0.0 if fine is None else cells / float(held[-1] - held[0]), cells)


def line_cells(nodes: FloatArray, values: FloatArray) -> "tuple[Grid, FloatArray]":
    """Return the grid of a one-dimensional table and its cell coefficients.

    Arrays: nodes (n,), values (n, c) -> (cells * c * 2,).
    """
    grid = grid_of(nodes)
    values = _filled(grid.nodes, nodes, values)
    return grid, np.stack((values[:-1], np.diff(values, axis=0)), axis=-1).reshape(-1)


def plane_cells(dynamic: DynamicDrift) -> "tuple[Grid, Grid, FloatArray]":
    """Return the grids of the dynamic table and its cell coefficients.

    Arrays:  -> (temperature cells * rate cells * 12,).
    """
    error, grids = dynamic.error, []
    for axis, nodes in enumerate((dynamic.temp_c, dynamic.turn_rate)):
        grids.append(grid_of(nodes))
        error = np.moveaxis(_filled(grids[axis].nodes, nodes, np.moveaxis(error, axis, 0)), 0, axis)
    corner = error[:-1, :-1]
    over_temp, over_rate = error[1:, :-1] - corner, error[:-1, 1:] - corner
    both = error[1:, 1:] - error[1:, :-1] - over_rate
    return grids[0], grids[1], np.stack((corner, over_temp, over_rate, both), axis=-1).reshape(-1)


def _filled(fine: FloatArray, nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Values on the grid: the given ones at the given nodes, the straight line between them."""
    flat = values.reshape(len(nodes), -1)
    if len(fine) == len(nodes):
        return values
    filled = np.column_stack([np.interp(fine, nodes, column) for column in flat.T])
    filled[np.abs(fine[:, None] - nodes).argmin(axis=0)] = flat
    return filled.reshape(len(fine), *values.shape[1:])


# ---- Where a record meets nodes that no data were near, and how uncertain the tables say they are there.

Kind = Literal["rate", "accel", "scale"]
Triad = Literal["rate", "accel"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stated:
    """Largest standard uncertainties that tables state at the extrapolated nodes that were met; 0 where none was met."""

    rate: float = 0.0  # Of the rate, rad/s: offsets of the gyroscopes and the dynamic table
    accel: float = 0.0  # Of the specific force, m/s2: offsets of the accelerometers
    scale: float = 0.0  # Of either as a share of itself, 1: matrices over temperature

    def joined(self, other: "Stated") -> "Stated":
        """Return the larger of both."""
        return Stated(
            rate=max(self.rate, other.rate), accel=max(self.accel, other.accel), scale=max(self.scale, other.scale)
        )


NONE_MET = Stated()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Doubt:
    """A table with extrapolated nodes, as the kernels take it."""

    kind: Kind  # What its uncertainty is of: rate, accel or scale
    temp: "Grid"  # Temperatures
    rate: "Grid | None"  # Measured rates, rad/s; None for a table over temperature alone
    # (halves,), standard uncertainty, -1 where data were near, infinite where none is stated; rad/s, m/s2 or 1
    stated: FloatArray


def triad_doubts(drift: DriftTables | None, model: TriadModel, quantity: Triad) -> tuple[Doubt, ...]:
    """Make a triad's tables ready for the kernels that look for extrapolated nodes.

    Uncertainties u of offsets become those of the result by the constant matrix M, sqrt(M^2 u^2), those U of a matrix a share of
    the result, sqrt(U^2 K^2) with K = M^-1 (squares by element); the largest axis counts.
    """
    found: tuple[Doubt, ...] = ()
    if drift is None:
        return found
    gyro, static, scale, dynamic = quantity == "rate", drift.static, drift.scale, drift.dynamic
    if static is not None and (static.gyro_offset if gyro else static.accel_offset) is not None:
        marks = static.gyro_extrapolated if gyro else static.accel_extrapolated
        u = static.gyro_uncertainty if gyro else static.accel_uncertainty
        squares = (model.matrix * si_factor(model.unit_out, quantity)).T ** 2
        found += _line(quantity, static.temp_c, marks, None if u is None else np.sqrt(u**2 @ squares).max(axis=1))
    if scale is not None and (scale.gyro_matrix if gyro else scale.accel_matrix) is not None:
        marks = scale.gyro_extrapolated if gyro else scale.accel_extrapolated
        u = scale.gyro_uncertainty if gyro else scale.accel_uncertainty
        squares = model.forward_matrix**2
        found += _line("scale", scale.temp_c, marks, None if u is None else np.sqrt(u**2 @ squares).max(axis=(1, 2)))
    return found + _plane(dynamic) if gyro and dynamic is not None else found


def mark_extrapolated(
    doubts: tuple[Doubt, ...], temp_c: FloatArray, span_c: tuple[float, float], corrected: FloatArray, mask: BoolArray
) -> Stated:
    """Mark the samples that draw on extrapolated nodes of one triad's tables.

    Arrays: temp_c (N,) degC, corrected (3 N,) rad/s, mask (N,).
    """
    from undrift.kernels.correct import mark_line, mark_plane

    met = NONE_MET
    low, high = span_c
    for doubt in doubts:
        if not _may_meet(doubt, low, high):  # most records stay where data were near
            continue
        if doubt.rate is None:
            largest = mark_line(temp_c, low, high, doubt.temp, doubt.stated, mask)
        else:
            largest = mark_plane(temp_c, corrected, low, high, doubt.temp, doubt.rate, doubt.stated, mask)
        met = met.joined(Stated(**{doubt.kind: max(float(largest), 0.0)}))
    return met


def _may_meet(doubt: Doubt, low: float, high: float) -> bool:
    """Whether any half from the least to the greatest temperature is extrapolated."""
    from undrift.kernels.correct import half

    if not low <= high:  # all outside, or gaps alone
        return False
    rows = doubt.stated.reshape(2 * doubt.temp.cells + 1, -1)
    return bool((rows[int(half(doubt.temp, low)) : int(half(doubt.temp, high)) + 1] >= 0.0).any())


def _line(kind: Kind, temp_c: FloatArray, marks: BoolArray | None, u: FloatArray | None) -> tuple[Doubt, ...]:
    """A table over temperature, where a node of it is extrapolated."""
    if marks is None or not marks.any():
        return ()
    grid = grid_of(temp_c)
    return (Doubt(kind=kind, temp=grid, rate=None, stated=_halves(grid, temp_c, _at_nodes(marks, u))),)


def _plane(dynamic: DynamicDrift) -> tuple[Doubt, ...]:
    """The dynamic table, where a node of it is extrapolated."""
    if dynamic.extrapolated is None or not dynamic.extrapolated.any():
        return ()
    stated = _at_nodes(dynamic.extrapolated, None if dynamic.uncertainty is None else dynamic.uncertainty.max(axis=2))
    temp, rate = grid_of(dynamic.temp_c), grid_of(dynamic.turn_rate)
    stated = _halves(rate, dynamic.turn_rate, _halves(temp, dynamic.temp_c, stated).T).T
    return (Doubt(kind="rate", temp=temp, rate=rate, stated=np.ravel(stated)),)


def _at_nodes(marks: BoolArray, uncertainty: FloatArray | None) -> FloatArray:
    """Uncertainty at the marked nodes, -1 at the others."""
    stated = (
        np.full(marks.shape, np.inf) if uncertainty is None else np.nan_to_num(uncertainty, nan=np.inf, posinf=np.inf)
    )
    return np.where(marks, stated, -1.0)


def _halves(grid: "Grid", nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Values on and between the grid's nodes, along the first axis: the larger of the given nodes that each draws on."""
    fine = grid.nodes
    at = np.empty(2 * len(fine) - 1)
    at[::2], at[1::2] = fine, 0.5 * (fine[1:] + fine[:-1])
    near = 2.0 * EVEN_WITHIN * float(np.diff(fine).min())
    left = np.searchsorted(nodes, at + near, side="right") - 1
    right = np.searchsorted(nodes, at - near, side="left")
    drawn: FloatArray = np.maximum(values[left], values[right])
    return drawn


# ---- plan


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadPlan:
    """One triad's model in the units of the readings, flat, as the kernels take it."""

    matrix: FloatArray  # (9,), SI per reading unit, row by row
    offset: FloatArray  # (3,), reading unit; codes rounded down have half a step less here
    half_step: FloatArray  # (3,), half a code step, reading unit; zero unless codes were truncated toward zero
    g_sensitivity: FloatArray | None  # (9,), rad/s per m/s2
    tables: "Tables | None"  # Cell coefficients; None where the triad has no table
    temp_range: tuple[float, float]  # Temperatures that all its tables hold, degC
    rate_range: tuple[float, float]  # Rates that the dynamic table holds, rad/s
    doubts: tuple[Doubt, ...] = ()  # Of these tables, the ones with extrapolated nodes
    # Offset over the time since power-on (s), cell coefficients, reading unit
    warm_up: "tuple[Grid, FloatArray] | None" = None


Plans: TypeAlias = tuple[TriadPlan | None, TriadPlan | None]  # gyroscopes, accelerometers; None: the record has none


def plan_record(record: Record, calibration: Calibration) -> Plans:
    """Make a calibration ready for a record's units and channels."""
    if record.state == "corrected":
        raise InputError(
            "correct: wanted raw readings, got a corrected record; correct the device's own recording, once"
        )
    gyro = None if record.gyro is None else plan_triad(calibration, "rate", record.gyro_unit)
    accel = None if record.accel is None else plan_triad(calibration, "accel", record.accel_unit)
    if gyro is not None and gyro.g_sensitivity is not None and accel is None:
        raise InputError(
            "correct: wanted accelerometer readings, which the g-sensitivity of the gyroscopes needs, got none; "
            "map the columns that hold them"
        )
    if record.temp_c is None and any(plan is not None and plan.tables is not None for plan in (gyro, accel)):
        raise InputError("correct: wanted temperatures for the tuning tables, got none; map the column temp_c")
    return gyro, accel


def plan_triad(calibration: Calibration, quantity: Triad, unit: str) -> TriadPlan:
    """Make one triad ready for the kernels."""
    gyro = quantity == "rate"
    model = calibration.gyro if gyro else calibration.accel
    if model is None:
        return _constant_plan(np.eye(3) * si_factor(unit, quantity), np.zeros(3))
    factor = _input_factor(model, unit, quantity)
    matrix = model.matrix * (factor * si_factor(model.unit_out, quantity))
    half_step, shift = _rounding(calibration, gyro, factor)
    plan = _constant_plan(matrix, model.offset / factor - shift)
    g = None
    if gyro and model.g_sensitivity is not None:
        g = np.ravel(model.g_sensitivity * si_factor(model.unit_out, quantity))
    out = si_factor(model.unit_out, quantity)
    tables, temp_range, rate_range = _tables(calibration, gyro, factor, out, shift)
    return TriadPlan(
        matrix=plan.matrix,
        offset=plan.offset,
        half_step=half_step,
        g_sensitivity=g,
        tables=tables,
        temp_range=temp_range,
        rate_range=rate_range,
        doubts=triad_doubts(calibration.drift, model, quantity),
        warm_up=_warm_up(calibration, factor) if gyro else None,
    )


def _constant_plan(matrix: FloatArray, offset: FloatArray) -> TriadPlan:
    everywhere = (-np.inf, np.inf)
    return TriadPlan(
        matrix=np.ravel(matrix),
        offset=offset,
        half_step=np.zeros(3),
        g_sensitivity=None,
        tables=None,
        temp_range=everywhere,
        rate_range=everywhere,
    )


def _input_factor(model: TriadModel, unit: str, quantity: Quantity) -> float:
    """Factor from the record's unit to the model's."""
    if unit == model.unit_in:
        return 1.0
    if not (is_physical(unit) and is_physical(model.unit_in)):
        what = "gyro" if quantity == "rate" else "accel"
        raise InputError(
            f"{what}: wanted readings in {model.unit_in}, the unit that this calibration was made for, got {unit}; "
            "correct the recording as the device wrote it, or calibrate in its unit",
            wanted=model.unit_in,
            got=unit,
        )
    return si_factor(unit, quantity) / si_factor(model.unit_in, quantity)


def _rounding(calibration: Calibration, gyro: bool, factor: float) -> tuple[FloatArray, FloatArray]:
    """Half a step to add with the sign of the code, and half a step to add always; reading unit."""
    adc, zero = calibration.adc, np.zeros(3)
    lsb = None if adc is None else adc.gyro_lsb if gyro else adc.accel_lsb
    if adc is None or lsb is None:
        return zero, zero
    mode: Rounding = adc.gyro_rounding if gyro else adc.accel_rounding
    half = 0.5 * lsb / factor
    return (half if mode == "toward_zero" else zero), (half if mode == "floor" else zero)


def _warm_up(calibration: Calibration, factor: float) -> "tuple[Grid, FloatArray] | None":
    """The gyroscopes' warm-up in the reading unit."""
    static = calibration.drift.static if calibration.drift else None
    if static is None or static.warm_up is None:
        return None
    return line_cells(static.warm_up.power_on_s, static.warm_up.gyro_offset / factor)


def _tables(
    calibration: Calibration, gyro: bool, factor: float, out: float, shift: FloatArray
) -> "tuple[Tables | None, tuple[float, float], tuple[float, float]]":
    """The triad's tables in the reading unit and SI, and the ranges that they hold."""
    from undrift.kernels.correct import Grid, Tables

    nothing, unused = np.empty(0), Grid(np.zeros(2), 0.0, 0.0, 1)
    drift = calibration.drift
    static, scale, dynamic = (drift.static, drift.scale, drift.dynamic) if drift else (None, None, None)
    offsets = None if static is None else static.gyro_offset if gyro else static.accel_offset
    matrices = None if scale is None else scale.gyro_matrix if gyro else scale.accel_matrix
    tables = Tables(nothing, unused, nothing, unused, nothing, unused, unused)
    nodes: list[FloatArray] = []
    rates = (-np.inf, np.inf)
    if static is not None and offsets is not None:
        grid, cells = line_cells(static.temp_c, offsets / factor - shift)
        tables, nodes = tables._replace(offset=cells, offset_temp=grid), [*nodes, static.temp_c]
    if scale is not None and matrices is not None:
        grid, cells = line_cells(scale.temp_c, matrices.reshape(-1, 9) * (factor * out))
        tables, nodes = tables._replace(matrix=cells, matrix_temp=grid), [*nodes, scale.temp_c]
    if gyro and dynamic is not None:
        temp, rate, cells = plane_cells(dynamic)
        tables, nodes = tables._replace(error=cells, error_temp=temp, error_rate=rate), [*nodes, dynamic.temp_c]
        rates = (float(dynamic.turn_rate[0]), float(dynamic.turn_rate[-1]))
    if not nodes:
        return None, (-np.inf, np.inf), rates
    return tables, (max(float(n[0]) for n in nodes), min(float(n[-1]) for n in nodes)), rates


# ---- What the tables are looked up with, sample by sample: the temperature of the sensors and the time since power-on.

NOTHING = np.empty(0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Carry:
    """What one chunk of a stream hands to the next."""

    # When the device was switched on, on the recording's clock, s; None where that is not known
    power_on_time: float | None = None
    # Where taking off the thermometer's lag has come to; None before the first sample, or without lag
    lag: LagState | None = None
    last_time: float | None = None  # Time of the last sample, s; None before the first


UNKNOWN = Carry()  # before the first sample, when power-on is not known


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Conditions:
    """What the tables are looked up with."""

    temp_c: FloatArray  # (N,), temperature of the sensors, degC; empty where none was recorded
    # (N,), time since power-on, s; empty where it is not known, no table asks for it, or the warm-up is over
    power_on_s: FloatArray
    carry: Carry  # For the chunk that follows


def switched_on(first_time: float, power_on_s: float | None) -> Carry:
    """Begin a record or a stream."""
    if power_on_s is None:
        return UNKNOWN
    if not 0.0 <= power_on_s < np.inf:
        raise InputError(
            f"power_on_s: wanted the time since power-on at the first sample, 0 s or more, got {power_on_s:g}; leave it out "
            "where it is not known",
            got=power_on_s,
        )
    return Carry(power_on_time=first_time - power_on_s)


def conditions_of(record: Record, calibration: Calibration, plans: Plans, carry: Carry) -> Conditions:
    """Find what the tables are looked up with."""
    drift, lag = calibration.drift, carry.lag
    temp_c = NOTHING if record.temp_c is None else record.temp_c
    tables = any(plan is not None and plan.tables is not None for plan in plans)
    if tables and drift is not None and drift.lag_s > 0.0:
        led, lag = without_lag(temp_c, record.time, lag_s=drift.lag_s, smooth_s=drift.lag_smooth_s, state=lag)
        led[np.isnan(temp_c)] = np.nan  # a gap stays a gap
        temp_c = led
    since: FloatArray = NOTHING
    if carry.power_on_time is not None and plans[0] is not None and plans[0].warm_up is not None:
        since = record.time - carry.power_on_time
        if since[0] >= plans[0].warm_up[0].nodes[-1]:
            since = NOTHING
    coming = Carry(power_on_time=carry.power_on_time, lag=lag, last_time=float(record.time[-1]))
    return Conditions(temp_c=temp_c, power_on_s=since, carry=coming)


# ---- Where corrected readings are written: fresh arrays or the caller's, and the record that takes them over uncopied.

Buffers: TypeAlias = tuple[FloatArray, FloatArray]  # rate, rad/s, and specific force, m/s2


def out_buffers(n: int, plans: Plans, out: Buffers | None) -> Buffers:
    """Return the arrays to write to.

    Arrays: out (N, 3) -> (N, 3).
    """
    if out is None:
        gyro, accel = (np.empty((0 if plan is None else n, 3)) for plan in plans)
        return gyro, accel
    for plan, buffer in zip(plans, out, strict=True):
        wanted = buffer.shape == (n, 3) and buffer.dtype == np.float64 and buffer.flags.c_contiguous
        if plan is not None and not (wanted and buffer.flags.writeable):
            raise InputError(
                f"correct: wanted writeable float64 buffers of shape ({n}, 3) in C order, got {buffer.dtype} {buffer.shape}; "
                "make them with numpy.empty"
            )
    return out


def flat(values: FloatArray | None, start: int, stop: int) -> FloatArray:
    """Return samples as the kernels take them.

    Arrays: values (N, 3) -> (3 (stop - start).
    """
    return np.empty(0) if values is None else values[start:stop].reshape(-1)


def adopt(record: Record, plans: Plans, buffers: Buffers) -> Record:
    """Return the record with corrected readings. The kernels wrote them in the right shape, so they are neither copied nor
    checked.

    Arrays: buffers (N, 3).
    """
    done = copy.copy(record)
    for name, plan, buffer in zip(("gyro", "accel"), plans, buffers, strict=True):
        values = None
        if plan is not None:
            values = buffer.view()
            values.flags.writeable = False
        object.__setattr__(done, name, values)
    for name, text in (("gyro_unit", "rad/s"), ("accel_unit", "m/s2"), ("frame", "b"), ("state", "corrected")):
        object.__setattr__(done, name, text)
    return done


# ---- Cut a long record into pieces, a thread each: the kernels let other threads run, and no sample looks at another.

THREADS_FROM = 100_000  # samples; below it a second thread costs more than it saves

T = TypeVar("T")


def in_pieces(work: Callable[[int, int], T], n: int, threads: int | None) -> list[T]:
    """Do the work piece by piece."""
    count = (os.cpu_count() or 1) if threads is None and n >= THREADS_FROM else threads or 1
    bounds = [n * i // count for i in range(count + 1)]
    pieces = [(start, stop) for start, stop in pairwise(bounds) if stop > start]
    if len(pieces) == 1:
        return [work(*pieces[0])]
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(len(pieces)) as pool:
        return list(pool.map(lambda piece: work(*piece), pieces))
