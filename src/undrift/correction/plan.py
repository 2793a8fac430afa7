"""A calibration made ready for the correction kernels: units folded in, one flat plan for each triad.

For readings in unit r, with c model units per r and s SI units per unit that the model gives, the kernels take ::

    M' = s M c        offset' = offset / c        h' = half a code step / c        warm_up' = warm_up / c

A table over nodes t_0 < ... < t_n is linear between them and held at its ends. In cell i, with f = (t - t_i) / (t_(i+1) - t_i)::

    one dimension    y = y_i + f (y_(i+1) - y_i)
    two dimensions   y = c0 + f c1 + r c2 + f r c3        r the fraction along the second axis

Nodes that are whole multiples of one step (a rate grid with a gap around zero) are filled up to an even grid, which changes no
value and finds the cell by one multiplication; others are searched. Tables are over the temperature of the sensors: where the
thermometer lags (lag_s > 0), drift/thermometer_lag.py subtracts that lag, looking back only, with a state from chunk to chunk.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.drift.hysteresis import LoopState, TempHistory, follow_loop, state_of
from undrift.drift.thermometer_lag import LagState, without_lag
from undrift.errors import InputError
from undrift.model import Calibration, DriftTables, DynamicDrift, TriadModel
from undrift.record import Record
from undrift.units import Quantity, is_physical, si_factor

if TYPE_CHECKING:
    from undrift.kernels.correct import Grid, Tables

NOTHING = np.empty(0)
EVERYWHERE = (-np.inf, np.inf)
MOST_NODES = 4096  # an even grid finer than this is not worth its memory
EVEN_WITHIN = 1e-9  # of a step
THREADS_FROM = 100_000  # samples; below it a second thread costs more than it saves

Sensor = Literal["gyro", "accel"]
Kind = Literal["rate", "accel", "scale"]
T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MarkedTable:
    """A table with extrapolated nodes, looked at in halves: 2 i is node i, 2 i + 1 lies between nodes i and i + 1.

    A half is extrapolated where any node that it draws on is: a value on a node draws on that one alone.
    """

    kind: Kind  # what its uncertainty belongs to: rate (rad/s), specific force (m/s2), or either as a share of itself
    temp: "Grid"
    rate: "Grid | None"  # measured rates, rad/s; None for a table over temperature alone
    stated: FloatArray  # (halves,), standard uncertainty, -1 where data were near, infinite where none is stated


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadPlan:
    """One triad's model in the units of the readings, flat, as the kernels take it."""

    matrix: FloatArray  # (9,), SI per reading unit, row by row
    offset: FloatArray  # (3,), reading unit; codes rounded down have half a step less here
    # (3,), half a code step, reading unit; zero unless codes were truncated toward zero
    half_step: FloatArray = field(default_factory=lambda: np.zeros(3))
    g_sensitivity: FloatArray | None = None  # (9,), rad/s per m/s2
    tables: "Tables | None" = None  # cell coefficients; None where the triad has no table
    temp_range: tuple[float, float] = EVERYWHERE  # temperatures that all its tables cover, degC
    marked: tuple[MarkedTable, ...] = ()  # those of the tables that have extrapolated nodes
    warm_up: "tuple[Grid, FloatArray] | None" = None  # offset over the time since power-on (s), reading unit
    loop: "tuple[Grid, FloatArray] | None" = None  # half-width of the hysteresis over temperature, reading unit


Plans: TypeAlias = tuple[TriadPlan | None, TriadPlan | None]  # gyroscopes, accelerometers; None: the record has none


def plan_record(record: Record, calibration: Calibration) -> Plans:
    """Make a calibration ready for a record's units and channels."""
    if record.state == "corrected":
        raise InputError(
            "correct: wanted raw readings, got a corrected record; correct the device's own recording, once"
        )
    gyro = None if record.gyro is None else _plan_triad(calibration, "gyro", record.gyro_unit)
    accel = None if record.accel is None else _plan_triad(calibration, "accel", record.accel_unit)
    if gyro is not None and gyro.g_sensitivity is not None and accel is None:
        raise InputError(
            "correct: wanted accelerometer readings, which the g-sensitivity of the gyroscopes needs, got none; "
            "map the columns that hold them"
        )
    if record.temp_c is None and has_tables((gyro, accel)):
        raise InputError("correct: wanted temperatures for the tuning tables, got none; map the column temp_c")
    return gyro, accel


def has_tables(plans: Plans) -> bool:
    """Tell whether any table is looked up."""
    return any(plan is not None and plan.tables is not None for plan in plans)


def _plan_triad(calibration: Calibration, sensor: Sensor, unit: str) -> TriadPlan:
    quantity: Quantity = "rate" if sensor == "gyro" else "accel"
    model = calibration.gyro if sensor == "gyro" else calibration.accel
    if model is None:
        return TriadPlan(matrix=np.ravel(np.eye(3) * si_factor(unit, quantity)), offset=np.zeros(3))
    drift, out = calibration.drift or DriftTables(), si_factor(model.unit_out, quantity)
    factor = _input_factor(model, unit, sensor, quantity)
    half_step, shift = _rounding(calibration, sensor, factor)
    tables, temp_range = _tables(drift, sensor, factor, out, shift)
    warm_up = drift.static.warm_up if drift.static is not None and sensor == "gyro" else None
    loop = drift.static.hysteresis if drift.static is not None and sensor == "gyro" else None
    g = model.g_sensitivity if sensor == "gyro" else None
    return TriadPlan(
        matrix=np.ravel(model.matrix * (factor * out)),
        offset=model.offset / factor - shift,
        half_step=half_step,
        g_sensitivity=None if g is None else np.ravel(g * out),
        tables=tables,
        temp_range=temp_range,
        marked=_marked_tables(drift, model, sensor, out),
        warm_up=None if warm_up is None else line_cells(warm_up.power_on_s, warm_up.gyro_offset / factor),
        loop=None if loop is None else line_cells(loop.temp_c, loop.gyro_half_width / factor),
    )


def _input_factor(model: TriadModel, unit: str, sensor: Sensor, quantity: Quantity) -> float:
    """Factor from the record's unit to the model's."""
    if unit == model.unit_in:
        return 1.0
    if not (is_physical(unit) and is_physical(model.unit_in)):
        raise InputError(
            f"{sensor}: wanted readings in {model.unit_in}, the unit that this calibration was made for, got {unit}; "
            "correct the recording as the device wrote it, or calibrate in its unit",
            wanted=model.unit_in,
            got=unit,
        )
    return si_factor(unit, quantity) / si_factor(model.unit_in, quantity)


def _rounding(calibration: Calibration, sensor: Sensor, factor: float) -> tuple[FloatArray, FloatArray]:
    """Half a step to add with the sign of the code, and half a step to add always; reading unit."""
    lsb, zero = _part(calibration.adc, sensor, "lsb"), np.zeros(3)
    mode, half = _part(calibration.adc, sensor, "rounding"), zero if lsb is None else 0.5 * lsb / factor
    return (half if mode == "toward_zero" else zero), (half if mode == "floor" else zero)


def _part(value: object, sensor: Sensor, what: str) -> Any:
    """One triad's part of a table, None where there is no table."""
    return None if value is None else getattr(value, f"{sensor}_{what}")


# ---- tables: steps made even, cells turned into coefficients


def even_nodes(nodes: FloatArray) -> FloatArray | None:
    """Return the even grid that holds all nodes, or None where there is none of a sensible size: nodes (n,) -> (m,)."""
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
    """Return how the kernel finds the cell: by one multiplication on the even grid, where there is one, else by bisection."""
    from undrift.kernels.correct import Grid

    fine = even_nodes(nodes)
    held = np.array(nodes) if fine is None else fine
    cells = len(held) - 1
    return Grid(held, float(held[0]), 0.0 if fine is None else cells / float(held[-1] - held[0]), cells)


def line_cells(nodes: FloatArray, values: FloatArray) -> "tuple[Grid, FloatArray]":
    """Return the grid of a one-dimensional table and its cell coefficients.
    nodes (n,), values (n, c) -> (cells * c * 2,)."""
    grid = grid_of(nodes)
    values = _filled(grid.nodes, nodes, values)
    return grid, np.stack((values[:-1], np.diff(values, axis=0)), axis=-1).reshape(-1)


def plane_cells(dynamic: DynamicDrift) -> "tuple[Grid, Grid, FloatArray]":
    """Return the grids of the dynamic table and its cell coefficients, (temperature cells * rate cells * 12,)."""
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
    if len(fine) == len(nodes):
        return values
    flat = values.reshape(len(nodes), -1)
    filled = np.column_stack([np.interp(fine, nodes, column) for column in flat.T])
    filled[np.abs(fine[:, None] - nodes).argmin(axis=0)] = flat
    return filled.reshape(len(fine), *values.shape[1:])


def _tables(
    drift: DriftTables, sensor: Sensor, factor: float, out: float, shift: FloatArray
) -> "tuple[Tables | None, tuple[float, float]]":
    """The triad's tables in the reading unit and SI, and the temperatures that they cover."""
    from undrift.kernels.correct import Grid, Tables

    unused = Grid(np.zeros(2), 0.0, 0.0, 1)
    tables, nodes = Tables(NOTHING, unused, NOTHING, unused, NOTHING, unused, unused), list[FloatArray]()
    offset, matrix = _part(drift.static, sensor, "offset"), _part(drift.scale, sensor, "matrix")
    if drift.static is not None and offset is not None:
        nodes.append(drift.static.temp_c)
        grid, cells = line_cells(nodes[-1], offset / factor - shift)
        tables = tables._replace(offset=cells, offset_temp=grid)
    if drift.scale is not None and matrix is not None:
        nodes.append(drift.scale.temp_c)
        grid, cells = line_cells(nodes[-1], matrix.reshape(-1, 9) * (factor * out))
        tables = tables._replace(matrix=cells, matrix_temp=grid)
    if sensor == "gyro" and drift.dynamic is not None:
        nodes.append(drift.dynamic.temp_c)
        temp, rate, cells = plane_cells(drift.dynamic)
        tables = tables._replace(error=cells, error_temp=temp, error_rate=rate)
    if not nodes:
        return None, EVERYWHERE
    return tables, (max(float(n[0]) for n in nodes), min(float(n[-1]) for n in nodes))


def _marked_tables(drift: DriftTables, model: TriadModel, sensor: Sensor, out: float) -> tuple[MarkedTable, ...]:
    """The triad's tables that have extrapolated nodes, with the uncertainty that they state there.

    Uncertainties u of offsets become those of the result by the constant matrix M, sqrt(M^2 u^2), those U of a matrix a share of
    the result, sqrt(U^2 K^2) with K = M^-1 (squares by element); the largest axis counts.
    """
    found: list[MarkedTable] = []
    kind: Kind = "rate" if sensor == "gyro" else "accel"
    for table, values in ((drift.static, "offset"), (drift.scale, "matrix")):
        marks, u = _part(table, sensor, "extrapolated"), _part(table, sensor, "uncertainty")
        if table is None or _part(table, sensor, values) is None or marks is None or not marks.any():
            continue
        if u is not None:
            offset = values == "offset"
            spread = u**2 @ (model.matrix * out).T ** 2 if offset else u**2 @ model.forward_matrix**2
            u = np.sqrt(spread).reshape(len(u), -1).max(axis=1)
        grid = grid_of(table.temp_c)
        halves = _halves(grid, table.temp_c, _at_nodes(marks, u))
        found.append(MarkedTable(kind=kind if values == "offset" else "scale", temp=grid, rate=None, stated=halves))
    dynamic = drift.dynamic if sensor == "gyro" else None
    if dynamic is not None and dynamic.extrapolated is not None and dynamic.extrapolated.any():
        u = None if dynamic.uncertainty is None else dynamic.uncertainty.max(axis=2)
        temp, rate = grid_of(dynamic.temp_c), grid_of(dynamic.turn_rate)
        over_temp = _halves(temp, dynamic.temp_c, _at_nodes(dynamic.extrapolated, u))
        halves = np.ravel(_halves(rate, dynamic.turn_rate, over_temp.T).T)
        found.append(MarkedTable(kind="rate", temp=temp, rate=rate, stated=halves))
    return tuple(found)


def _at_nodes(marks: BoolArray, uncertainty: FloatArray | None) -> FloatArray:
    """Uncertainty at the marked nodes, -1 at the others."""
    stated = np.inf if uncertainty is None else np.nan_to_num(uncertainty, nan=np.inf, posinf=np.inf)
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


# ---- what the tables are looked up with, sample by sample


@dataclass(frozen=True, slots=True, kw_only=True)
class Carry:
    """What one chunk of a stream hands to the next."""

    power_on_time: float | None = None  # on the recording's clock, s; None where it is not known
    lag: LagState | None = None  # of the thermometer; None before the first sample, or without lag
    last_time: float | None = None  # time of the last sample, s; None before the first
    loop: LoopState | None = None  # of the hysteresis; None where the calibration has none to correct


class Conditions(NamedTuple):
    """What the samples of one chunk are looked up with; empty where it is not known or no table asks for it."""

    temp_c: FloatArray  # (N,), of the sensors, degC
    since: FloatArray  # (N,), time since power-on, s; empty after the warm-up, too
    loop: FloatArray  # (N,), position in the loop of the hysteresis, -1 ... 1


def carry_at_start(
    first_time: float, power_on_s: float | None, calibration: Calibration, history: TempHistory | None = None
) -> Carry:
    """Begin a record or a stream."""
    static = None if calibration.drift is None else calibration.drift.static
    model = None if static is None else static.hysteresis
    off = isinstance(history, str) and history == "none"
    loop = None if model is None or off else state_of(history, model.crossing_k)
    if power_on_s is None:
        return Carry(loop=loop)
    if not 0.0 <= power_on_s < np.inf:
        raise InputError(
            f"power_on_s: wanted the time since power-on at the first sample, 0 s or more, got {power_on_s:g}; leave it out "
            "where it is not known",
            got=power_on_s,
        )
    return Carry(power_on_time=first_time - power_on_s, loop=loop)


def conditions_of(record: Record, calibration: Calibration, plans: Plans, carry: Carry) -> tuple[Conditions, Carry]:
    """Return the conditions of a chunk, and what the chunk that follows needs."""
    drift, lag, loop = calibration.drift, carry.lag, carry.loop
    temp_c = NOTHING if record.temp_c is None else record.temp_c
    if has_tables(plans) and drift is not None and drift.lag_s > 0.0:
        led, lag = without_lag(temp_c, record.time, lag_s=drift.lag_s, smooth_s=drift.lag_smooth_s, state=lag)
        led[np.isnan(temp_c)] = np.nan  # a gap stays a gap
        temp_c = led
    since: FloatArray = NOTHING
    if carry.power_on_time is not None and plans[0] is not None and plans[0].warm_up is not None:
        since = record.time - carry.power_on_time
        if since[0] >= plans[0].warm_up[0].nodes[-1]:
            since = NOTHING
    position: FloatArray = NOTHING
    if loop is not None and plans[0] is not None and plans[0].loop is not None and len(temp_c):
        position, loop = follow_loop(temp_c, record.time, state=loop)
    coming = replace(carry, lag=lag, loop=loop, last_time=float(record.time[-1]))
    return Conditions(temp_c, since, position), coming


# ---- pieces of a long record, a thread each: the kernels let other threads run, and no sample looks at another


def flat(values: FloatArray | None, start: int, stop: int) -> FloatArray:
    """Return samples as the kernels take them, (N, 3) -> (3 (stop - start),)."""
    return NOTHING if values is None else values[start:stop].reshape(-1)


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
