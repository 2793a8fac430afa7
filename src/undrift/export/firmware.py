"""A calibration as firmware evaluates it: SI per raw unit, offsets that hold the rounding's half step, tables on findable grids.

A table whose nodes are whole multiples of one step is put on the even grid that holds them all (``even_nodes``), where the
cell is found by one multiplication; one that would more than double its memory that way keeps its nodes, and the cell is
found by bisection in a number of steps that depends on the table alone. Either way a lookup takes constant time.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import Calibration, TriadModel
from undrift.drift.lookup.cells import even_nodes
from undrift.errors import InputError
from undrift.units import Quantity, canonical_unit, is_physical, si_factor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Axis:
    """One axis of a table.

    Parameters
    ----------
    nodes : array, shape (n,)
        Increasing.
    even : bool
        True where the nodes are evenly spaced.
    """

    nodes: FloatArray
    even: bool

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
        width = np.diff(self.nodes)
        return np.array([self.cells / (self.stop - self.start)]) if self.even else 1.0 / width

    @property
    def stride(self) -> int:
        """First stride of the bisection: the largest power of two below the number of cells, at least 1."""
        return 1 << max(0, (self.cells - 1).bit_length() - 1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """Values over temperature, or over temperature and rate.

    Parameters
    ----------
    temp : Axis
        Temperatures, degC.
    turn_rate : Axis or None
        Rates, rad/s; None for a table over temperature alone.
    values : array, shape (n, c) or (n, k, c)
        c values at each node.
    """

    temp: Axis
    turn_rate: Axis | None = None
    values: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Triad:
    """One triad as firmware evaluates it.

    Parameters
    ----------
    name : str
        gyro or accel.
    unit_in : str
        Unit of the reading.
    matrix : array, shape (3, 3)
        SI per raw unit.
    offset : array, shape (3,)
        Raw unit; half a step is taken off where codes are rounded down.
    half_step : array, shape (3,), or None
        Raw unit; None unless codes are cut off toward zero.
    g_sensitivity : array, shape (3, 3), or None
        rad/s per m/s2.
    offset_table, matrix_table, error_table : Table or None
        In the same units.
    warm_up_table : Table or None
        Extra offset over the time since power-on, s, in the place of the temperature; zero at its last node and after it.
    """

    name: str
    unit_in: str
    matrix: FloatArray
    offset: FloatArray
    half_step: FloatArray | None
    g_sensitivity: FloatArray | None
    offset_table: Table | None
    matrix_table: Table | None
    error_table: Table | None
    warm_up_table: Table | None = None

    @property
    def tables(self) -> tuple[Table, ...]:
        """The tables over temperature that there are."""
        every = (self.offset_table, self.matrix_table, self.error_table)
        return tuple(table for table in every if table is not None)

    @property
    def every_table(self) -> tuple[Table, ...]:
        """These, and the one over the time since power-on."""
        return self.tables if self.warm_up_table is None else (*self.tables, self.warm_up_table)

    @property
    def largest_offset(self) -> float:
        """What may come off a reading at most, raw unit."""
        most = float(np.abs(self.offsets).max())
        return most if self.warm_up_table is None else most + float(np.abs(self.warm_up_table.values).max())

    @property
    def matrices(self) -> FloatArray:
        """Every matrix that the triad may use, shape (n, 3, 3)."""
        return self.matrix[None] if self.matrix_table is None else self.matrix_table.values.reshape(-1, 3, 3)

    @property
    def offsets(self) -> FloatArray:
        """Every offset that the triad may use, shape (n, 3)."""
        return self.offset[None] if self.offset_table is None else self.offset_table.values


def triads_of(calibration: Calibration) -> tuple[Triad | None, Triad | None]:
    """Return gyroscopes and accelerometers as firmware evaluates them.

    Parameters
    ----------
    calibration : Calibration
        The device's model.

    Returns
    -------
    tuple of two Triad or None
        None where the calibration has no model.

    Raises
    ------
    InputError
        Neither triad has a model, or a number of the model is NaN.
    """
    if calibration.gyro is None and calibration.accel is None:
        raise InputError("export: wanted a model of gyroscopes or accelerometers, got neither; calibrate first")
    gyro = None if calibration.gyro is None else _triad(calibration, calibration.gyro, "rate")
    accel = None if calibration.accel is None else _triad(calibration, calibration.accel, "accel")
    return gyro, accel


def _triad(calibration: Calibration, model: TriadModel, quantity: Quantity) -> Triad:
    is_gyro, out = quantity == "rate", si_factor(model.unit_out, quantity)
    name = "gyro" if is_gyro else "accel"
    drift = calibration.drift
    static, scale, dynamic = (drift.static, drift.scale, drift.dynamic) if drift else (None, None, None)
    offsets = None if static is None else static.gyro_offset if is_gyro else static.accel_offset
    matrices = None if scale is None else scale.gyro_matrix if is_gyro else scale.accel_matrix
    warm_up = None if static is None or not is_gyro else static.warm_up
    half_step, shift = rounding_of(calibration, is_gyro=is_gyro)
    made = Triad(
        name=name,
        unit_in=model.unit_in,
        matrix=model.matrix * out,
        offset=model.offset - shift,
        half_step=half_step,
        g_sensitivity=model.g_sensitivity * out if is_gyro and model.g_sensitivity is not None else None,
        offset_table=None if static is None or offsets is None else _line(static.temp_c, offsets - shift),
        matrix_table=None if scale is None or matrices is None else _line(scale.temp_c, matrices.reshape(-1, 9) * out),
        error_table=_plane(dynamic.temp_c, dynamic.turn_rate, dynamic.error)
        if is_gyro and dynamic is not None
        else None,
        warm_up_table=None if warm_up is None else _line(warm_up.power_on_s, warm_up.gyro_offset),
    )
    _check_finite(made)
    return made


def nominal_triad(name: str, quantity: Quantity, unit: str) -> Triad:
    """Return the triad of a device without a model: readings in a physical unit, made SI and left alone otherwise.

    Parameters
    ----------
    name : str
        gyro or accel.
    quantity : str
        rate or accel.
    unit : str
        Of the readings, any known spelling.

    Returns
    -------
    Triad
        The factor to SI on the diagonal, no offset, no table.

    Raises
    ------
    InputError
        Counts or volts, or a unit that is not known.
    """
    if not is_physical(canonical_unit(unit, quantity)):
        raise InputError(
            f"export: wanted a physical unit of the {name}, which has no model, got {unit}; calibrate it, or name the unit that "
            "the firmware hands over"
        )
    return Triad(
        name=name,
        unit_in=canonical_unit(unit, quantity),
        matrix=np.eye(3) * si_factor(unit, quantity),
        offset=np.zeros(3),
        half_step=None,
        g_sensitivity=None,
        offset_table=None,
        matrix_table=None,
        error_table=None,
    )


def rounding_of(calibration: Calibration, *, is_gyro: bool) -> tuple[FloatArray | None, FloatArray]:
    """Return what gives back the half step that the rounding of the codes took.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    is_gyro : bool
        Gyroscopes, not accelerometers.

    Returns
    -------
    half_step : array, shape (3,), or None
        To add with the sign of the code, raw unit.
    shift : array, shape (3,)
        To add always, raw unit.
    """
    adc, zero = calibration.adc, np.zeros(3)
    lsb = None if adc is None else adc.gyro_lsb if is_gyro else adc.accel_lsb
    if adc is None or lsb is None:
        return None, zero
    mode = adc.gyro_rounding if is_gyro else adc.accel_rounding
    return (0.5 * lsb if mode == "toward_zero" else None), (0.5 * lsb if mode == "floor" else zero)


def _axis(nodes: FloatArray) -> Axis:
    fine = even_nodes(nodes)
    if fine is None or len(fine) > 2 * len(nodes) + 8:
        return Axis(nodes=nodes, even=False)
    return Axis(nodes=fine, even=True)


def _filled(axis: Axis, nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Values at the axis' nodes: the given ones where they were given, the straight line between."""
    if len(axis.nodes) == len(nodes):
        return values
    flat = values.reshape(len(nodes), -1)
    filled = np.column_stack([np.interp(axis.nodes, nodes, column) for column in flat.T])
    return filled.reshape(len(axis.nodes), *values.shape[1:])


def _line(temp_c: FloatArray, values: FloatArray) -> Table:
    temp = _axis(temp_c)
    return Table(temp=temp, values=_filled(temp, temp_c, values))


def _plane(temp_c: FloatArray, turn_rate: FloatArray, values: FloatArray) -> Table:
    temp, rate = _axis(temp_c), _axis(turn_rate)
    over_rate = np.moveaxis(_filled(rate, turn_rate, np.moveaxis(values, 1, 0)), 0, 1)
    return Table(temp=temp, turn_rate=rate, values=_filled(temp, temp_c, over_rate))


def _check_finite(triad: Triad) -> None:
    parts = [triad.matrix, *(table.values for table in triad.every_table)]
    parts += [triad.offset] if triad.offset_table is None else []
    parts += [part for part in (triad.half_step, triad.g_sensitivity) if part is not None]
    missing = sum(int(np.isnan(part).sum()) for part in parts)
    if missing:
        raise InputError(
            f"export: wanted numbers throughout the model of the {triad.name}, got {missing} NaN; calibrate what is missing",
            missing=missing,
        )
