"""Tables made ready for the correction kernels: units folded in, steps made even, cells turned into coefficients.

A table over nodes t_0 < ... < t_n is linear between them and held at its ends. In cell i, with f = (t - t_i) / (t_(i+1) - t_i)::

    one dimension    y = y_i + f (y_(i+1) - y_i)
    two dimensions   y = c0 + f c1 + r c2 + f r c3        r the fraction along the second axis

Nodes that are whole multiples of one step (a rate grid with a gap around zero) are filled up to an even grid, which changes no
value and finds the cell by one multiplication; others are searched.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import Calibration, DynamicDrift, Rounding, TriadModel
from undrift.errors import InputError
from undrift.units import Quantity, is_physical, si_factor

if TYPE_CHECKING:
    from undrift.kernels.correct import Grid, Tables

MOST_NODES = 4096  # an even grid finer than this is not worth its memory
EVEN_WITHIN = 1e-9  # of a step


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadPlan:
    """One triad's model in the units of the readings, flat, as the kernels take it.

    Parameters
    ----------
    matrix : array, shape (9,)
        SI per reading unit, row by row.
    offset : array, shape (3,)
        Reading unit; codes rounded down have half a step less here.
    half_step : array, shape (3,)
        Half a code step, reading unit; zero unless codes were truncated toward zero.
    g_sensitivity : array, shape (9,), or None
        rad/s per m/s2.
    tables : Tables or None
        Cell coefficients; None where the triad has no table.
    temp_range : tuple of float
        Temperatures that all its tables hold, degC.
    rate_range : tuple of float
        Rates that the dynamic table holds, rad/s.
    """

    matrix: FloatArray
    offset: FloatArray
    half_step: FloatArray
    g_sensitivity: FloatArray | None
    tables: "Tables | None"
    temp_range: tuple[float, float]
    rate_range: tuple[float, float]


Plans: TypeAlias = tuple[TriadPlan | None, TriadPlan | None]  # gyroscopes, accelerometers; None: the record has none


def plan_triad(calibration: Calibration, quantity: Quantity, unit: str) -> TriadPlan:
    """Make one triad ready for the kernels.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    quantity : str
        "rate" for the gyroscopes, "accel" for the accelerometers.
    unit : str
        Unit of the readings.

    Returns
    -------
    TriadPlan
        A triad without a model passes its nominal SI values.

    Raises
    ------
    InputError
        Counts or volts where the calibration was made for a physical unit, the other way round, or without any model.
    """
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
    tables, temp_range, rate_range = _tables(calibration, gyro, factor, si_factor(model.unit_out, quantity), shift)
    return TriadPlan(
        matrix=plan.matrix,
        offset=plan.offset,
        half_step=half_step,
        g_sensitivity=g,
        tables=tables,
        temp_range=temp_range,
        rate_range=rate_range,
    )


def even_nodes(nodes: FloatArray) -> FloatArray | None:
    """Return the even grid that holds all nodes, or None where there is none of a sensible size.

    Parameters
    ----------
    nodes : array, shape (n,)
        Increasing.

    Returns
    -------
    array, shape (m,), or None
        m >= n, from the first node to the last.
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


def line_cells(nodes: FloatArray, values: FloatArray) -> "tuple[Grid, FloatArray]":
    """Return the grid of a one-dimensional table and its cell coefficients.

    Parameters
    ----------
    nodes : array, shape (n,)
        Increasing.
    values : array, shape (n, c)
        c values at each node.

    Returns
    -------
    grid : Grid
        How the kernel finds the cell.
    coefficients : array, shape (cells * c * 2,)
        Value and slope per cell, flat.
    """
    fine = even_nodes(nodes)
    if fine is not None:
        values = _filled(fine, nodes, values)
    grid = _grid(nodes if fine is None else fine, even=fine is not None)
    return grid, np.stack((values[:-1], np.diff(values, axis=0)), axis=-1).reshape(-1)


def plane_cells(dynamic: DynamicDrift) -> "tuple[Grid, Grid, FloatArray]":
    """Return the grids of the dynamic table and its cell coefficients.

    Parameters
    ----------
    dynamic : DynamicDrift
        Rate error over temperature and measured rate, rad/s.

    Returns
    -------
    temperature, turn_rate : Grid
        How the kernel finds the cell.
    coefficients : array, shape (temperature cells * rate cells * 12,)
        c0, c1, c2, c3 for each axis, flat.
    """
    error, grids = dynamic.error, []
    for axis, nodes in enumerate((dynamic.temp_c, dynamic.turn_rate)):
        fine = even_nodes(nodes)
        if fine is not None:
            error = np.moveaxis(_filled(fine, nodes, np.moveaxis(error, axis, 0)), 0, axis)
        grids.append(_grid(nodes if fine is None else fine, even=fine is not None))
    corner = error[:-1, :-1]
    over_temp, over_rate = error[1:, :-1] - corner, error[:-1, 1:] - corner
    both = error[1:, 1:] - error[1:, :-1] - over_rate
    return grids[0], grids[1], np.stack((corner, over_temp, over_rate, both), axis=-1).reshape(-1)


def _grid(nodes: FloatArray, *, even: bool) -> "Grid":
    from undrift.kernels.correct import Grid

    cells = len(nodes) - 1
    inverse = cells / float(nodes[-1] - nodes[0]) if even else 0.0
    return Grid(np.array(nodes), float(nodes[0]), inverse, cells)


def _filled(fine: FloatArray, nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Values on the even grid: the given ones at the given nodes, the straight line between them."""
    flat = values.reshape(len(nodes), -1)
    if len(fine) == len(nodes):
        return values
    filled = np.column_stack([np.interp(fine, nodes, column) for column in flat.T])
    filled[np.abs(fine[:, None] - nodes).argmin(axis=0)] = flat
    return filled.reshape(len(fine), *values.shape[1:])


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
