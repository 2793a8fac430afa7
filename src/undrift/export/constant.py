"""A calibration at one temperature: matrix and offset of each triad, for targets that have no tables."""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import Calibration
from undrift.errors import InputError
from undrift.export.firmware import Table, Triad, triads_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Constant:
    """A triad at one temperature: SI = matrix (reading - offset) - g_sensitivity a.

    Parameters
    ----------
    unit_in : str
        Unit of the reading.
    matrix : array, shape (3, 3)
        SI per raw unit.
    offset : array, shape (3,)
        Raw unit.
    g_sensitivity : array, shape (3, 3), or None
        rad/s per m/s2.
    """

    unit_in: str
    matrix: FloatArray
    offset: FloatArray
    g_sensitivity: FloatArray | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConstantPair:
    """Both triads at one temperature.

    Parameters
    ----------
    gyro, accel : Constant or None
        None where the calibration has no model.
    temp_c : float
        Where tables were read, degC; NaN where there are none and the reference temperature is not known.
    notes : tuple of str
        What was frozen.
    """

    gyro: Constant | None
    accel: Constant | None
    temp_c: float
    notes: tuple[str, ...]


def constants_of(calibration: Calibration, temp_c: float | None = None) -> ConstantPair:
    """Return both triads at one temperature.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    temp_c : float or None
        Where to read its tables, degC; None for the reference temperature.

    Returns
    -------
    ConstantPair
        Half a step of codes rounded down is in the offset.

    Raises
    ------
    InputError
        Tables and no temperature to read them at, or one that they do not hold; no model.
    """
    gyro, accel = triads_of(calibration)
    tables = [
        table for triad in (gyro, accel) if triad is not None for table in (triad.offset_table, triad.matrix_table)
    ]
    held = [table for table in tables if table is not None]
    temp = calibration.reference_temp_c if temp_c is None else temp_c
    notes: tuple[str, ...] = ()
    if held:
        low, high = max(t.temp.start for t in held), min(t.temp.stop for t in held)
        if not low <= temp <= high:
            raise InputError(
                f"export: wanted a temperature from {low:g} to {high:g} degC to read the tables at, got {temp:g}; give temp_c",
                low=low,
                high=high,
            )
        notes = (f"tables over temperature are read at {temp:g} degC",)
    return ConstantPair(
        gyro=None if gyro is None else _at(gyro, temp),
        accel=None if accel is None else _at(accel, temp),
        temp_c=temp,
        notes=notes,
    )


def _at(triad: Triad, temp: float) -> Constant:
    offset, matrix = triad.offset_table, triad.matrix_table
    return Constant(
        unit_in=triad.unit_in,
        matrix=triad.matrix if matrix is None else _read(matrix, temp).reshape(3, 3),
        offset=triad.offset if offset is None else _read(offset, temp),
        g_sensitivity=triad.g_sensitivity,
    )


def _read(table: Table, temp: float) -> FloatArray:
    return np.array([np.interp(temp, table.temp.nodes, column) for column in table.values.T])
