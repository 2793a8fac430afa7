"""The constants of correction, derived once: ``correct``, the stream, the C source and every other export read them.

For readings in unit r, with c model units per r and s SI units per unit that the model gives ::

    M' = s M c        offset' = (offset + K d) / c        h' = half a code step / c        warm_up' = warm_up / c

K d is the change of the offset while the device turns, K = M^-1, where a fit has it: constants hold in motion, and what is added at
rest, d' = s d, stands apart.

``constants_of`` derives them, with the tables at the nodes that were fitted. ``plan_record`` lays them out flat for the kernels,
export/firmware.py turns them into integers. A table over nodes t_0 < ... < t_n is linear between them and held at its ends. In
cell i, with f = (t - t_i) / (t_(i+1) - t_i)::

    one dimension    y = y_i + f (y_(i+1) - y_i)
    two dimensions   y = c0 + f c1 + r c2 + f r c3        r the fraction along the second axis

Nodes that are whole multiples of one step (a rate grid with a gap around zero) are filled up to an even grid, which changes no
value and finds the cell by one multiplication; others are searched. Tables are over the temperature of the sensors: where the
thermometer lags (lag_s > 0), drift/temperature.py subtracts that lag, looking back only, with a state from chunk to chunk.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np

from undrift.arrays import BoolArray, FloatArray, interpolated
from undrift.drift.temperature import LagState, without_lag
from undrift.errors import InputError
from undrift.model import Calibration, DynamicDrift, Sensor, Triad, TriadModel
from undrift.record import ForceUncertainty, Record, TemperatureSensitivity
from undrift.segments import NOT_TURNING
from undrift.units import STANDARD_GRAVITY, Quantity, is_physical, si_factor

if TYPE_CHECKING:
    from undrift.kernels.correct import Grid, Tables

NOTHING = np.empty(0)
EVERYWHERE = (-np.inf, np.inf)
MOST_NODES = 4096  # an even grid finer than this is not worth its memory
EVEN_WITHIN = 1e-9  # of a step
THREADS_FROM = 100_000  # samples; below it a second thread costs more than it saves

Kind = Literal["rate", "accel", "scale"]
T = TypeVar("T")

# ---- the constants of one triad, and its tables


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableAxis:
    """One axis of a table."""

    nodes: FloatArray  # (n,), increasing
    even: bool = False  # whether the nodes are known to be evenly spaced

    @property
    def cells(self) -> int:
        """Number of cells."""
        return len(self.nodes) - 1

    @property
    def start(self) -> float:
        """First node."""
        return float(self.nodes[0])

    @property
    def stop(self) -> float:
        """Last node."""
        return float(self.nodes[-1])

    @property
    def inverse(self) -> FloatArray:
        """One over the width of each cell, shape (cells,), or of all, shape (1,), where they are even."""
        return np.array([self.cells / (self.stop - self.start)]) if self.even else 1.0 / np.diff(self.nodes)

    @property
    def grid(self) -> "Grid":
        """How the kernel finds the cell: by one multiplication where the nodes are even, else by bisection."""
        from undrift.kernels.correct import Grid

        return Grid(np.array(self.nodes), self.start, float(self.inverse[0]) if self.even else 0.0, self.cells)

    def evened(self, most: int = MOST_NODES) -> "TableAxis":
        """Return the even grid that holds all nodes, or the nodes where there is none of so many nodes at most."""
        span = self.stop - self.start
        cells = span / np.diff(self.nodes).min()
        for parts in (1, 2, 3):  # the smallest gap may itself be two or three steps
            count = round(float(cells) * parts)
            if count + 1 > most:
                break
            places = (self.nodes - self.start) * (count / span)
            if np.abs(places - np.round(places)).max() < EVEN_WITHIN:
                return TableAxis(nodes=np.linspace(self.nodes[0], self.nodes[-1], count + 1), even=True)
        return TableAxis(nodes=self.nodes)

    def filled(self, nodes: FloatArray, values: FloatArray) -> FloatArray:
        """Values (n, ...) of fewer nodes (n,) at all of the axis: the straight line between them."""
        if len(self.nodes) == len(nodes):
            return values
        return interpolated(self.nodes, nodes, values)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LookupTable:
    """Values over temperature, or over temperature and rate."""

    temp: TableAxis  # temperatures, degC; of the warm-up the time since power-on, s
    turn_rate: TableAxis | None = None  # measured rates, rad/s; None for a table over temperature alone
    values: FloatArray  # (n, c), or (n, k, c), c values at each node
    # (n,) or (n, k), standard uncertainty of the result at nodes that no data were near, infinite where none is stated, and -1
    # where data were near; None where they were near all
    stated: FloatArray | None = None
    kind: Kind = "rate"  # what it belongs to: rate (rad/s), specific force (m/s2), or either as a share of itself

    def evened(self, most: Callable[[FloatArray], int] = lambda nodes: MOST_NODES) -> "LookupTable":
        """Return the table with its axes filled up to even grids where there are such."""
        temp, rate, values = self.temp.evened(most(self.temp.nodes)), self.turn_rate, self.values
        if self.turn_rate is not None:
            rate = self.turn_rate.evened(most(self.turn_rate.nodes))
            values = np.moveaxis(rate.filled(self.turn_rate.nodes, np.moveaxis(values, 1, 0)), 0, 1)
        return replace(self, temp=temp, turn_rate=rate, values=temp.filled(self.temp.nodes, values))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Constants:
    """What one triad's readings are corrected with."""

    name: Sensor
    unit_in: str  # unit of the readings
    matrix: FloatArray  # (3, 3), SI per unit of the readings
    offset: FloatArray  # (3,), unit of the readings; less half a step where codes are rounded down
    half_step: FloatArray | None = (
        None  # (3,), unit of the readings; None unless codes are cut off toward zero, or fitted
    )
    at_rest: FloatArray | None = None  # (3,), rad/s, added while the device does not turn; None where it was not fitted
    g_sensitivity: FloatArray | None = None  # (3, 3), rad/s per m/s2
    offset_table: LookupTable | None = None  # in the same units
    matrix_table: LookupTable | None = None
    error_table: LookupTable | None = None
    # extra offset over the time since power-on, s, in the place of the temperature; zero from its last node on
    warm_up_table: LookupTable | None = None

    @property
    def tables(self) -> list[LookupTable]:
        """Those over temperature that are looked up for each sample."""
        return [t for t in (self.offset_table, self.matrix_table, self.error_table) if t is not None]


def constants_of(calibration: Calibration, sensor: Sensor, unit: str = "") -> Constants:
    """Return the constants of one triad for readings in a unit, by default in the one that its model is made for."""
    triad = calibration.triad(sensor)
    model, out = triad.model, triad.si
    if model is None:
        return Constants(
            name=sensor, unit_in=unit, matrix=np.eye(3) * si_factor(unit, triad.quantity), offset=np.zeros(3)
        )
    factor = _input_factor(model, unit or model.unit_in, sensor, triad.quantity)
    half = None if triad.lsb is None else 0.5 * triad.lsb / factor
    shift = half if half is not None and triad.rounding == "floor" and model.code_offset is None else np.zeros(3)
    half = half if triad.rounding == "toward_zero" else None
    moving = model.moving_offset
    change = np.zeros(3) if moving is None else model.forward_matrix @ moving / factor
    g, warm_up = model.g_sensitivity if sensor == "gyro" else None, triad.warm_up
    return Constants(
        name=sensor,
        unit_in=unit or model.unit_in,
        matrix=model.matrix * (factor * out),
        offset=model.offset / factor - shift if moving is None else model.offset / factor - shift + change,
        half_step=half if model.code_offset is None else model.code_offset / factor,
        at_rest=None if moving is None else moving * out,
        g_sensitivity=None if g is None else g * out,
        offset_table=_offset_table(triad, model, factor, shift - change),
        matrix_table=_matrix_table(triad, model, factor),
        error_table=None if triad.errors is None else _error_table(triad.errors),
        warm_up_table=None if warm_up is None else _line(warm_up.power_on_s, warm_up.gyro_offset / factor),
    )


def _input_factor(model: TriadModel, unit: str, sensor: Sensor, quantity: Quantity) -> float:
    """Factor from the unit of the readings to the model's."""
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


def _line(nodes: FloatArray, values: FloatArray, stated: FloatArray | None = None, kind: Kind = "rate") -> LookupTable:
    return LookupTable(temp=TableAxis(nodes=nodes), values=values, stated=stated, kind=kind)


def _offset_table(triad: Triad, model: TriadModel, factor: float, shift: FloatArray) -> LookupTable | None:
    offsets = triad.offsets
    if offsets is None:
        return None
    kind: Kind = "rate" if triad.sensor == "gyro" else "accel"
    u = offsets.uncertainty
    if u is not None:  # becomes that of the result by the constant matrix M: sqrt(M^2 u^2), squares by element
        u = np.sqrt(u**2 @ (model.matrix * triad.si).T ** 2)
    return _line(offsets.temp_c, offsets.value / factor - shift, _stated(offsets.extrapolated, u), kind)


def _matrix_table(triad: Triad, model: TriadModel, factor: float) -> LookupTable | None:
    matrices = triad.matrices
    if matrices is None:
        return None
    u = matrices.uncertainty
    if u is not None:  # becomes a share of the result: sqrt(U^2 K^2) with K = M^-1
        u = np.sqrt(u**2 @ model.forward_matrix**2)
    flat = matrices.value.reshape(-1, 9) * (factor * triad.si)
    return _line(matrices.temp_c, flat, _stated(matrices.extrapolated, u), "scale")


def _error_table(errors: DynamicDrift) -> LookupTable:
    return LookupTable(
        temp=TableAxis(nodes=errors.temp_c),
        turn_rate=TableAxis(nodes=errors.turn_rate),
        values=errors.error,
        stated=_stated(errors.extrapolated, errors.uncertainty),
    )


def _stated(marks: BoolArray | None, uncertainty: FloatArray | None) -> FloatArray | None:
    """Uncertainty of the largest axis at the marked nodes, -1 at the others; None where none is marked."""
    if marks is None or not marks.any():
        return None
    if uncertainty is None:
        return np.where(marks, np.inf, -1.0)
    largest = uncertainty.reshape(*marks.shape, -1).max(axis=-1)
    return np.where(marks, np.nan_to_num(largest, nan=np.inf, posinf=np.inf), -1.0)


# ---- what is known of the accelerometers' errors: rest.py turns it into that of a tilt


def force_uncertainty(calibration: Calibration, unit: str) -> ForceUncertainty | None:
    """Return what a calibration knows of its accelerometers, for readings in a unit; None where it states no uncertainty."""
    triad = calibration.triad("accel")
    model = triad.model
    if model is None or not np.isfinite(model.covariance).all() or not model.covariance.any():
        return None
    matrix, covariance = model.matrix * triad.si, error_covariance(model, "accel")
    spans = [np.full(2, calibration.reference_temp_c)] * 2
    if triad.offsets is not None:  # in the place of the constant
        u = triad.offsets.uncertainty
        stated = np.zeros((1, 3)) if u is None else np.nan_to_num(u)
        covariance[9:], covariance[:, 9:] = 0.0, 0.0
        covariance[9:, 9:] = matrix @ np.diag(stated.max(axis=0) ** 2) @ matrix.T  # of the worst node
        spans[0] = triad.offsets.temp_c[[0, -1]]
    if triad.matrices is not None:
        spans[1] = triad.matrices.temp_c[[0, -1]]
    known, usual = calibration.provenance, TemperatureSensitivity()
    mg = known.number("accel_offset_mg_per_k", usual.accel_offset_mg_per_k)
    percent = known.number("accel_scale_percent_per_k", usual.accel_scale_percent_per_k)
    lsb = np.full(3, float(unit == "count")) if triad.lsb is None else triad.lsb
    return ForceUncertainty(
        covariance=covariance,
        offset_temp_c=spans[0],
        matrix_temp_c=spans[1],
        per_k=np.array([mg * 1e-3 * STANDARD_GRAVITY, 0.01 * percent]),
        step=np.abs(matrix) @ lsb,
        calibrated=calibration.provenance.created,
    )


def error_covariance(model: TriadModel, quantity: Quantity) -> FloatArray:
    """Return the covariance (12, 12) of E row by row and of d, SI, of a corrected reading's error E x + d."""
    inverse, jacobian = np.linalg.inv(model.matrix), np.zeros((12, len(model.parameters)))
    for column, name in enumerate(model.parameters):
        kind, _, axes = name.partition("_")
        if kind == "m":
            jacobian[3 * "xyz".index(axes[0]) :, column][:3] = inverse["xyz".index(axes[1])]
        elif kind == "offset":
            jacobian[9:, column] = -model.matrix[:, "xyz".index(axes)] * si_factor(model.unit_out, quantity)
    return np.asarray(jacobian @ model.covariance @ jacobian.T)


# ---- the same, flat, as the kernels take it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MarkedTable:
    """A table with extrapolated nodes, looked at in halves: 2 i is node i, 2 i + 1 lies between nodes i and i + 1.

    A half is extrapolated where any node that it draws on is: a value on a node draws on that one alone.
    """

    kind: Kind
    temp: "Grid"
    rate: "Grid | None"
    stated: FloatArray  # (halves,), as in ``LookupTable``


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadPlan:
    """One triad's constants, flat."""

    matrix: FloatArray  # (9,), row by row
    offset: FloatArray  # (3,)
    half_step: FloatArray  # (3,), zero unless codes are corrected
    g_sensitivity: FloatArray | None  # (9,)
    at_rest: FloatArray | None = None  # (3,), as in ``Constants``
    tables: "Tables | None" = None  # cell coefficients; None where the triad has no table
    temp_range: tuple[float, float] = EVERYWHERE  # temperatures that all its tables cover, degC
    marked: tuple[MarkedTable, ...] = ()  # those of the tables that have extrapolated nodes
    warm_up: "tuple[Grid, FloatArray] | None" = None


Plans: TypeAlias = tuple[TriadPlan | None, TriadPlan | None]  # gyroscopes, accelerometers; None: the record has none


def plan_record(record: Record, calibration: Calibration) -> Plans:
    """Make a calibration ready for a record's units and channels."""
    if record.state == "corrected":
        raise InputError(
            "correct: wanted raw readings, got a corrected record; correct the device's own recording, once"
        )
    gyro = None if record.gyro is None else _flat_plan(constants_of(calibration, "gyro", record.gyro_unit))
    accel = None if record.accel is None else _flat_plan(constants_of(calibration, "accel", record.accel_unit))
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


def _flat_plan(constants: Constants) -> TriadPlan:
    g, used = constants.g_sensitivity, constants.tables
    return TriadPlan(
        matrix=np.ravel(constants.matrix),
        offset=constants.offset,
        half_step=np.zeros(3) if constants.half_step is None else constants.half_step,
        g_sensitivity=None if g is None else np.ravel(g),
        at_rest=constants.at_rest,
        tables=_cells_of(constants) if used else None,
        temp_range=(max(t.temp.start for t in used), min(t.temp.stop for t in used)) if used else EVERYWHERE,
        marked=tuple(_marked(table, table.stated) for table in used if table.stated is not None),
        warm_up=None if constants.warm_up_table is None else line_cells(constants.warm_up_table),
    )


def _cells_of(constants: Constants) -> "Tables":
    """Return the cells of all tables over temperature; empty where there is no such table."""
    from undrift.kernels.correct import Grid, Tables

    unused = Grid(np.zeros(2), 0.0, 0.0, 1)
    lines = (constants.offset_table, constants.matrix_table)
    offset, matrix = ((unused, NOTHING) if table is None else line_cells(table) for table in lines)
    plane = constants.error_table
    error = (unused, unused, NOTHING) if plane is None else plane_cells(plane)
    return Tables(offset[1], offset[0], matrix[1], matrix[0], error[2], error[0], error[1])


def line_cells(table: LookupTable) -> "tuple[Grid, FloatArray]":
    """Return the grid of a table over one axis and its cell coefficients, (cells * c * 2,)."""
    table = table.evened()
    cells = np.stack((table.values[:-1], np.diff(table.values, axis=0)), axis=-1)
    return table.temp.grid, cells.reshape(-1)


def plane_cells(table: LookupTable) -> "tuple[Grid, Grid, FloatArray]":
    """Return the grids of a table over two axes and its cell coefficients, (temperature cells * rate cells * c * 4,)."""
    table = table.evened()
    values, over_rate = table.values, np.diff(table.values, axis=1)
    parts = (values[:-1, :-1], np.diff(values[:, :-1], axis=0), over_rate[:-1], np.diff(over_rate, axis=0))
    return table.temp.grid, (table.turn_rate or table.temp).grid, np.stack(parts, axis=-1).reshape(-1)


def _marked(table: LookupTable, stated: FloatArray) -> MarkedTable:
    """The halves of a table's own nodes: what is filled in between them draws on the same two."""
    temp, rate, halves = table.temp.evened(len(table.temp.nodes)).grid, None, _halves(stated)
    if table.turn_rate is not None:
        rate, halves = table.turn_rate.evened(len(table.turn_rate.nodes)).grid, _halves(halves.T).T
    return MarkedTable(kind=table.kind, temp=temp, rate=rate, stated=np.ravel(halves))


def _halves(stated: FloatArray) -> FloatArray:
    """Values on and between nodes, along the first axis: the larger of the two where it lies between."""
    halves = np.empty((2 * len(stated) - 1, *stated.shape[1:]))
    halves[::2], halves[1::2] = stated, np.maximum(stated[1:], stated[:-1])
    return halves


# ---- what the tables are looked up with, sample by sample


@dataclass(frozen=True, slots=True, kw_only=True)
class Carry:
    """What one chunk of a stream hands to the next."""

    power_on_time: float | None = None  # on the recording's clock, s; None where it is not known
    lag: LagState | None = None  # of the thermometer; None before the first sample, or without lag
    last_time: float | None = None  # time of the last sample, s; None before the first
    turning: tuple[float, ...] = NOT_TURNING  # of the search for turns; unused where the offset is the same in motion


class Conditions(NamedTuple):
    """What the samples of one chunk are looked up with; empty where it is not known or no table asks for it."""

    temp_c: FloatArray  # (N,), of the sensors, degC
    since: FloatArray  # (N,), time since power-on, s; empty after the warm-up, too


def carry_at_start(first_time: float, power_on_s: float | None) -> Carry:
    """Return the state before the first sample of a record or a stream."""
    if power_on_s is None:
        return Carry()
    if not 0.0 <= power_on_s < np.inf:
        raise InputError(
            f"power_on_s: wanted the time since power-on at the first sample, 0 s or more, got {power_on_s:g}; leave it out "
            "where it is not known",
            got=power_on_s,
        )
    return Carry(power_on_time=first_time - power_on_s)


def conditions_of(record: Record, calibration: Calibration, plans: Plans, carry: Carry) -> tuple[Conditions, Carry]:
    """Return the conditions of a chunk, and what the chunk that follows needs."""
    drift, lag = calibration.drift, carry.lag
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
    coming = replace(carry, lag=lag, last_time=float(record.time[-1]))
    return Conditions(temp_c, since), coming


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
