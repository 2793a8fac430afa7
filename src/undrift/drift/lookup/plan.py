"""A calibration made ready for the correction kernels: units folded in, one flat plan a triad.

For readings in unit r, with c model units per r and s SI units per unit the model gives, the kernels take ::

    M' = s M c        offset' = offset / c        h' = half a code step / c        warm_up' = warm_up / c
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import Calibration, Rounding, TriadModel
from undrift.drift.lookup.cells import line_cells, plane_cells
from undrift.drift.lookup.extrapolated import Doubt, Triad, triad_doubts
from undrift.errors import InputError
from undrift.record import Record
from undrift.units import Quantity, is_physical, si_factor

if TYPE_CHECKING:
    from undrift.kernels.correct import Grid, Tables


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
    doubts : tuple of Doubt
        Of these tables, the ones with extrapolated nodes.
    warm_up : tuple of Grid and array, or None
        Offset over the time since power-on (s), cell coefficients, reading unit.
    """

    matrix: FloatArray
    offset: FloatArray
    half_step: FloatArray
    g_sensitivity: FloatArray | None
    tables: "Tables | None"
    temp_range: tuple[float, float]
    rate_range: tuple[float, float]
    doubts: tuple[Doubt, ...] = ()
    warm_up: "tuple[Grid, FloatArray] | None" = None


Plans: TypeAlias = tuple[TriadPlan | None, TriadPlan | None]  # gyroscopes, accelerometers; None: the record has none


def plan_record(record: Record, calibration: Calibration) -> Plans:
    """Make a calibration ready for a record's units and channels.

    Parameters
    ----------
    record : Record
        Raw readings.
    calibration : Calibration
        The device's model.

    Returns
    -------
    tuple of two TriadPlan or None
        Gyroscopes and accelerometers.

    Raises
    ------
    InputError
        Readings corrected already, in a unit that the calibration does not know, or without what the model needs:
        specific force for the g-sensitivity, temperatures for the tables.
    """
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
