"""Constants of correction, computed once for ``correct``, the stream, the C source and every other export.

For readings in unit r, with c model units per r and s SI units per unit of the model's output ::

    M' = s M c        offset' = (offset + K d) / c        h' = half a code step / c        warm_up' = warm_up / c

d is the change of the offset while the device turns, if a fit has one, and K = M^-1. The constants apply in motion, and d' = s d is
added at rest.

``constants_of`` computes them, with the tables at the nodes of the fit. ``cells`` prepares the tables for the kernels. A table over
nodes t_0 < ... < t_n is linear between them and constant beyond its ends. In cell i, with f = (t - t_i) / (t_(i+1) - t_i)::

    one dimension    y = y_i + f (y_(i+1) - y_i)
    two dimensions   y = c0 + f c1 + r c2 + f r c3        r is the fraction along the second axis

Nodes that are whole multiples of a step (a rate grid with a gap around zero) are extended to an even grid. This does not change any
value, and one multiplication determines the cell. Cells of other nodes are found by bisection. Tables are over the temperature of
the sensors. A causal filter with state subtracts the lag of the thermometer (drift/temperature.py).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np

from undrift.arrays import BoolArray, FloatArray, interpolated
from undrift.base import workers
from undrift.errors import InputError
from undrift.kernels.tables import Grid, Tables
from undrift.model import MATRIX_NAMES, OFFSET_NAMES, Calibration, Sensor, TriadModel
from undrift.record import ForceUncertainty, Record, TemperatureSensitivity
from undrift.segments import NOT_TURNING
from undrift.units import STANDARD_GRAVITY, Quantity, is_physical, si_factor

NOTHING = np.empty(0)
Span: TypeAlias = tuple[float, float]  # least and greatest
EVERYWHERE: Span = (-np.inf, np.inf)
NOWHERE: Span = (np.inf, -np.inf)
EVEN_WITHIN = 1e-9  # in steps
THREADS_FROM = 100_000  # number of samples above which a second thread is worthwhile

T = TypeVar("T")

# ---- the constants of one triad, and its tables


def searched(nodes: FloatArray) -> Grid:
    """Return the grid of nodes whose cells are found by bisection."""
    return Grid(np.array(nodes), float(nodes[0]), 0.0, len(nodes) - 1)


def evened(nodes: FloatArray) -> Grid:
    """Return the even grid that contains all nodes, or the nodes if that grid would be more than twice as long."""
    start, span, most = float(nodes[0]), float(nodes[-1] - nodes[0]), 2 * len(nodes) + 8
    for parts in (1, 2, 3):  # the smallest gap may itself be two or three steps
        count = round(span / float(np.diff(nodes).min()) * parts)
        if count + 1 > most:
            break
        places = (nodes - start) * (count / span)
        if np.abs(places - np.round(places)).max() < EVEN_WITHIN:
            return Grid(np.linspace(start, float(nodes[-1]), count + 1), start, count / span, count)
    return searched(nodes)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LookupTable:
    """Table of values over temperature, or over temperature and rate."""

    temp: Grid  # temperatures, degC, or for the warm-up the time since power-on, s
    turn_rate: Grid | None = None  # measured rates, rad/s, or None for a table over temperature only
    values: FloatArray  # (n, c), or (n, k, c), c values at each node
    extrapolated: BoolArray | None = None  # (n,) or (n, k), nodes of the fit: True if there were no data nearby

    def evened(self) -> "LookupTable":
        """Return the table with its axes extended to even grids, if possible."""
        temp, rate, values = evened(self.temp.nodes), self.turn_rate, self.values
        if rate is not None:
            rate = evened(rate.nodes)
            values = np.moveaxis(_filled(self.turn_rate, rate, np.moveaxis(values, 1, 0)), 0, 1)
        return replace(self, temp=temp, turn_rate=rate, values=_filled(self.temp, temp, values))


def _filled(grid: Grid | None, even: Grid, values: FloatArray) -> FloatArray:
    """Return values (n, ...) at the nodes of a grid, linearly interpolated to all nodes of the even grid."""
    return values if grid is None or even.cells == grid.cells else interpolated(even.nodes, grid.nodes, values)


@dataclass(frozen=True, kw_only=True, eq=False)
class Constants:
    """Constants that correct the readings of a triad."""

    name: Sensor
    unit_in: str  # unit of the readings
    matrix: FloatArray  # (3, 3), SI unit per unit of the readings
    offset: FloatArray  # (3,), offset, unit of the readings, minus half a step if codes are rounded down
    half_step: FloatArray | None = None  # (3,), half a code step if truncated, or fitted, unit of the readings
    at_rest: FloatArray | None = None  # (3,), rate added while the device does not turn, rad/s
    g_sensitivity: FloatArray | None = None  # (3, 3), rad/s per m/s2
    offset_table: LookupTable | None = None  # rounding and offset in the same units
    matrix_table: LookupTable | None = None
    error_table: LookupTable | None = None
    # extra offset over the time since power-on, s, instead of temperature, with zero from its last node on
    warm_up_table: LookupTable | None = None

    @property
    def tables(self) -> list[LookupTable]:
        """Tables over temperature, which are looked up for each sample."""
        return [t for t in (self.offset_table, self.matrix_table, self.error_table) if t is not None]

    @property
    def temp_range(self) -> Span:
        """Temperatures that all tables cover, degC."""
        used = self.tables
        return (max(t.temp.start for t in used), min(t.temp.stop for t in used)) if used else EVERYWHERE

    @cached_property
    def cells(self) -> Tables | None:
        """Return the cells of the tables over temperature, with an empty array for a missing table, or None without tables."""
        if not self.tables:
            return None
        unused = Grid(np.zeros(2), 0.0, 0.0, 1)
        offset, matrix = (
            (unused, NOTHING) if table is None else line_cells(table)
            for table in (self.offset_table, self.matrix_table)
        )
        error = (unused, unused, NOTHING) if self.error_table is None else plane_cells(self.error_table)
        return Tables(*offset, *matrix, *error)

    @cached_property
    def warm_up(self) -> tuple[Grid, FloatArray] | None:
        """Interpolation cells of the warm-up over the time since power-on, or None without a warm-up table."""
        return None if self.warm_up_table is None else line_cells(self.warm_up_table)


def constants_of(calibration: Calibration, sensor: Sensor, unit: str = "") -> Constants:
    """Return the constants of a triad for readings in a unit, by default the input unit of its model."""
    triad = calibration.triad(sensor)
    model, si = triad.model, triad.si
    if model is None:
        nominal = np.eye(3) * si_factor(unit, triad.quantity)
        return Constants(name=sensor, unit_in=unit, matrix=nominal, offset=np.zeros(3))
    factor = _input_factor(model, unit or model.unit_in, sensor, triad.quantity)
    half = None if triad.lsb is None else 0.5 * triad.lsb / factor
    shift = half if half is not None and triad.rounding == "floor" and model.code_offset is None else np.zeros(3)
    half = half if triad.rounding == "toward_zero" else None
    moving = model.moving_offset
    if moving is not None:
        shift = shift - model.forward_matrix @ moving / factor
    g, warm_up = model.g_sensitivity if sensor == "gyro" else None, triad.warm_up
    offsets, matrices, errors = triad.offsets, triad.matrices, triad.errors
    return Constants(
        name=sensor,
        unit_in=unit or model.unit_in,
        matrix=model.matrix * (factor * si),
        offset=model.offset / factor - shift,
        half_step=half if model.code_offset is None else model.code_offset / factor,
        at_rest=None if moving is None else moving * si,
        g_sensitivity=None if g is None else g * si,
        offset_table=None
        if offsets is None
        else _line(offsets.temp_c, offsets.value / factor - shift, offsets.extrapolated),
        matrix_table=None
        if matrices is None
        else _line(matrices.temp_c, matrices.value.reshape(-1, 9) * (factor * si), matrices.extrapolated),
        error_table=None
        if errors is None
        else LookupTable(
            temp=searched(errors.temp_c),
            turn_rate=searched(errors.turn_rate),
            values=errors.error,
            extrapolated=errors.extrapolated,
        ),
        warm_up_table=None if warm_up is None else _line(warm_up.power_on_s, warm_up.gyro_offset / factor),
    )


def _line(nodes: FloatArray, values: FloatArray, extrapolated: BoolArray | None = None) -> LookupTable:
    return LookupTable(temp=searched(nodes), values=values, extrapolated=extrapolated)


def _input_factor(model: TriadModel, unit: str, sensor: Sensor, quantity: Quantity) -> float:
    """Return the factor from the unit of the readings to the unit of the model."""
    if unit == model.unit_in:
        return 1.0
    if not (is_physical(unit) and is_physical(model.unit_in)):
        raise InputError(
            f"{sensor}: this calibration is for readings in {model.unit_in}, but the recording is in {unit}. "
            "Correct the recording as the device wrote it, or calibrate in its unit.",
            wanted=model.unit_in,
            got=unit,
        )
    return si_factor(unit, quantity) / si_factor(model.unit_in, quantity)


# ---- uncertainty of the accelerometers, for the uncertainty of a tilt (rest.py)


def force_uncertainty(calibration: Calibration, unit: str) -> ForceUncertainty | None:
    """Return the uncertainty of a calibration's accelerometers, for readings in a unit, or None if it is unknown."""
    triad = calibration.triad("accel")
    model = triad.model
    if model is None or not np.isfinite(model.covariance).all() or not model.covariance.any():
        return None
    matrix, covariance = model.matrix * triad.si, error_covariance(model)
    spans = [np.full(2, calibration.reference_temp_c)] * 2
    if triad.offsets is not None:  # the table replaces the constant
        u = triad.offsets.uncertainty
        largest = np.zeros(3) if u is None else np.nan_to_num(u).max(axis=0)  # value of the worst node
        covariance[9:], covariance[:, 9:] = 0.0, 0.0
        covariance[9:, 9:] = matrix @ np.diag(largest**2) @ matrix.T
        spans[0] = triad.offsets.temp_c[[0, -1]]
    if triad.matrices is not None:
        spans[1] = triad.matrices.temp_c[[0, -1]]
    settings, usual = calibration.provenance, TemperatureSensitivity()
    mg = settings.number("accel_offset_mg_per_k", usual.accel_offset_mg_per_k)
    percent = settings.number("accel_scale_percent_per_k", usual.accel_scale_percent_per_k)
    lsb = np.full(3, float(unit == "count")) if triad.lsb is None else triad.lsb
    return ForceUncertainty(
        covariance=covariance,
        offset_temp_c=spans[0],
        matrix_temp_c=spans[1],
        per_k=np.array([mg * 1e-3 * STANDARD_GRAVITY, 0.01 * percent]),
        step=np.abs(matrix) @ lsb,
        calibrated=calibration.provenance.created,
    )


def error_covariance(model: TriadModel) -> FloatArray:
    """Return the covariance (12, 12) of E, row by row, and of d, m/s2, of the error E f + d of a specific force."""
    jacobian = np.zeros((12, 12))  # E = dM M^-1 and d = -M do
    jacobian[:9, :9] = np.kron(np.eye(3), model.forward_matrix.T)
    jacobian[9:, 9:] = -model.matrix * si_factor(model.unit_out, "accel")
    return np.asarray(jacobian @ model.covariance_of((*MATRIX_NAMES, *OFFSET_NAMES)) @ jacobian.T)


# ---- the constants in the form that the kernels need


Plans: TypeAlias = tuple[Constants | None, Constants | None]  # gyroscopes, accelerometers (None if not recorded)


def plan_record(record: Record, calibration: Calibration) -> Plans:
    """Prepare a calibration for a record's units and channels."""
    if record.state == "corrected":
        raise InputError(
            "correct: expected raw readings, got a corrected record. Give the recording that the device wrote."
        )
    gyro = None if record.gyro is None else constants_of(calibration, "gyro", record.gyro_unit)
    accel = None if record.accel is None else constants_of(calibration, "accel", record.accel_unit)
    if gyro is not None and gyro.g_sensitivity is not None and accel is None:
        raise InputError(
            "correct: the g-sensitivity of the gyroscopes needs accelerometer readings. Map the accelerometer columns."
        )
    if record.temp_c is None and has_tables((gyro, accel)):
        raise InputError("correct: the tuning tables need temperatures. Map a column to temp_c.")
    return gyro, accel


def has_tables(plans: Plans) -> bool:
    """Return True if any table over temperature is looked up."""
    return any(plan is not None and plan.tables for plan in plans)


def line_cells(table: LookupTable) -> tuple[Grid, FloatArray]:
    """Return the grid of a table over an axis and its cell coefficients, (cells * c * 2,)."""
    table = table.evened()
    cells = np.stack((table.values[:-1], np.diff(table.values, axis=0)), axis=-1)
    return table.temp, cells.reshape(-1)


def plane_cells(table: LookupTable) -> tuple[Grid, Grid, FloatArray]:
    """Return the grids of a table over two axes and its cell coefficients, (temperature cells * rate cells * c * 4,)."""
    table = table.evened()
    values, over_rate = table.values, np.diff(table.values, axis=1)
    parts = (values[:-1, :-1], np.diff(values[:, :-1], axis=0), over_rate[:-1], np.diff(over_rate, axis=0))
    return table.temp, table.turn_rate or table.temp, np.stack(parts, axis=-1).reshape(-1)


# ---- temperature and time since power-on, with which the tables are looked up


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """Range of the quantities on which the calibration depends, in a record or in all chunks of a stream so far."""

    samples: int = 0
    samples_outside: int = 0  # beyond the tuning tables
    samples_extrapolated: int = 0  # inside the tables, at nodes without nearby data
    samples_without_temperature: int = 0  # missing for the tables (the result is a gap under every policy)
    seconds_outside: float = 0.0
    seconds_extrapolated: float = 0.0
    seconds_without_temperature: float = 0.0
    temp_c: Span = NOWHERE  # degC, or (inf, -inf) if nothing depends on it
    departure_c: float = 0.0  # distance to the temperature of the constant offsets, degC, or 0 if no offset is constant
    turn_rate: Span = NOWHERE  # measured rate in the dynamic table, rad/s, or (inf, -inf) without the table

    def joined(self, later: "Reach") -> "Reach":
        """Return the combined range of both."""
        counts = [name for name in Reach.__slots__ if name.startswith(("samples", "seconds"))]
        return Reach(
            **{name: getattr(self, name) + getattr(later, name) for name in counts},
            temp_c=hull(self.temp_c, later.temp_c),
            departure_c=max(self.departure_c, later.departure_c),
            turn_rate=hull(self.turn_rate, later.turn_rate),
        )


def hull(*spans: Span) -> Span:
    """Return the span that contains all spans."""
    return min(span[0] for span in spans), max(span[1] for span in spans)


# state of the filter between chunks: time of the last reading, s, the reading, the reading behind the low-pass tau_f, and the last
# temperature returned, degC, which is repeated while readings are NaN (all NaN before the first reading)
NO_READING = (math.nan,) * 4
AT_ONCE = 1e-300  # time constant of a low-pass that has no effect, for no lag, s


@dataclass(frozen=True, slots=True, kw_only=True)
class Carry:
    """State passed from one chunk of a stream to the next."""

    power_on_time: float | None = None  # time of power-on on the recording's clock, s, or None if unknown
    lag: tuple[float, ...] = NO_READING  # state of the filter that subtracts the thermometer's lag
    last_time: float | None = None  # time of the last sample, s, or None before the first
    turning: tuple[float, ...] = NOT_TURNING  # state of the search for turns
    reach: Reach = Reach()  # temperatures of all chunks so far


class Conditions(NamedTuple):
    """Table coordinates of the samples of a chunk. Arrays are empty if unknown or if no table needs them."""

    temp_c: FloatArray  # (N,), of the sensors, degC
    since: FloatArray  # (N,), time since power-on, s, or empty after the warm-up


def carry_at_start(first_time: float, power_on_s: float | None) -> Carry:
    """Return the state before the first sample of a record or a stream."""
    if power_on_s is None:
        return Carry()
    if not 0.0 <= power_on_s < np.inf:
        raise InputError(
            f"power_on_s: expected the time since power-on at the first sample, 0 s or more, got {power_on_s:g}. Omit it "
            "if you do not know it.",
            got=power_on_s,
        )
    return Carry(power_on_time=first_time - power_on_s)


def without_lag(
    temp_c: FloatArray, time: FloatArray, *, lag_s: float, smooth_s: float, state: tuple[float, ...] = NO_READING
) -> tuple[FloatArray, tuple[float, ...]]:
    """Subtract the thermometer's lag with a causal filter, for temperatures (N,), degC, at times (N,), s."""
    from undrift.kernels.correct import lead

    x, t = (np.ascontiguousarray(v, dtype=np.float64) for v in (temp_c, time))
    y, next_state = np.empty_like(x), np.array(state)
    lead(x, t, y, lag_s, smooth_s or AT_ONCE, next_state)
    return y, tuple(next_state.tolist())


def conditions_of(record: Record, calibration: Calibration, plans: Plans, carry: Carry) -> tuple[Conditions, Carry]:
    """Return the conditions of a chunk, and the state for the next chunk."""
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
    return Conditions(temp_c, since), replace(carry, lag=lag, last_time=float(record.time[-1]))


# ---- pieces of a long record, one thread each: the kernels release the interpreter lock, and samples are independent


def flat(values: FloatArray | None, rows: slice) -> FloatArray:
    """Return samples in the layout of the kernels, (N, 3) -> (3 n,)."""
    return NOTHING if values is None else values[rows].reshape(-1)


def in_pieces(work: Callable[[slice], T], n: int, threads: int | None) -> list[T]:
    """Call a function with slices of n samples, each in its own thread."""
    count = workers.processors() if threads is None and n >= THREADS_FROM else threads or 1
    bounds = [n * i // count for i in range(count + 1)]
    pieces = [slice(start, stop) for start, stop in pairwise(bounds) if stop > start]
    if len(pieces) == 1:
        return [work(pieces[0])]
    with workers.threads(len(pieces)) as pool:
        return list(pool.map(work, pieces))
