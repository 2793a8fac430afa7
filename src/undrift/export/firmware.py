"""Constants of the correction (correction/plan.py) for firmware, with tables that can be looked up in constant time.

If the nodes of a table are whole multiples of a step, the table is converted to the even grid that contains them all. A
multiplication then finds the cell. If this would more than double the memory, the table keeps its nodes, and bisection finds the
cell. The number of bisection steps depends only on the table. This module also computes the filter that removes a thermometer's
lag.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from undrift.correction.plan import Constants, LookupTable, TableAxis, constants_of
from undrift.errors import InputError
from undrift.model import SENSORS, Calibration

TABLES = ("offset_table", "matrix_table", "error_table", "warm_up_table")


def named_tables(constants: Constants) -> list[tuple[str, LookupTable]]:
    """Return names and values of the tables in the constants."""
    return [(name, getattr(constants, name)) for name in TABLES if getattr(constants, name) is not None]


def triads_of(calibration: Calibration) -> tuple[Constants | None, Constants | None]:
    """Return the constants of gyroscopes and accelerometers for firmware, None for a triad without a model."""
    if calibration.gyro is None and calibration.accel is None:
        raise InputError("export: no model of gyroscopes or accelerometers. Calibrate first.")
    gyro, accel = (
        None if triad.model is None else _on_grids(constants_of(calibration, name))
        for name, triad in zip(SENSORS, calibration.triads, strict=True)
    )
    return gyro, accel


def _on_grids(constants: Constants) -> Constants:
    """Return the constants with tables for fast lookup. Raise InputError if any of them contains NaN."""
    tables = named_tables(constants)
    parts = [constants.matrix, *(table.values for _, table in tables), constants.half_step, constants.g_sensitivity]
    parts += [constants.offset] if constants.offset_table is None else []
    missing = sum(int(np.isnan(array).sum()) for array in parts if array is not None)
    if missing:
        raise InputError(
            f"export: the model of the {constants.name} contains {missing} NaN. Calibrate the missing parameters.",
            missing=missing,
        )
    findable: dict[str, Any] = {name: table.evened() for name, table in tables}
    return replace(constants, **findable)


def stride_of(axis: TableAxis) -> int:
    """Return the first stride of a bisection: the largest power of two below the number of cells, at least 1."""
    return 1 << max(0, (axis.cells - 1).bit_length() - 1)


# ---- Lead filter, which removes a thermometer's lag. It is equivalent to the filter of drift/temperature.py.
#
# With the low-passed reading z, d = x - z, a = dt / smooth and g = lag / smooth:
#
#     d = e^-a d + m (x - x_before)     m = (1 - e^-a) / a          y = x + (g - 1) d
#
# The state has two numbers. At steady temperature d is small, so the rounding errors of float are also small.

SHORTEST_S, LONGEST_S = 1e-3, 1e5  # range of smoothing times for the accuracy of float, s
MOST_GAIN = 2.0**15


@dataclass(frozen=True, slots=True, kw_only=True)
class Lead:
    """Constants of the lead filter."""

    lag_s: float  # time constant of the thermometer, s
    smooth_s: float  # time constant of the smoothing, s
    gain: float  # g - 1
    rate: float  # inverse of the smoothing time constant, 1/s


def lead_of(calibration: Calibration) -> Lead | None:
    """Return the lead filter of a calibration, or None if it has no lag or no tables."""
    drift = calibration.drift
    if drift is None or not drift.lag_s > 0.0 or (drift.static, drift.scale, drift.dynamic) == (None, None, None):
        return None
    smooth = drift.lag_smooth_s
    if not (SHORTEST_S <= smooth <= LONGEST_S and drift.lag_s / smooth <= MOST_GAIN):
        raise InputError(
            f"export c: smoothing must be {SHORTEST_S:g} to {LONGEST_S:g} s and lag at most {MOST_GAIN:g} times that, got a lag of "
            f"{drift.lag_s:g} s with smoothing over {smooth:g} s. Fit the lag again."
        )
    return Lead(lag_s=drift.lag_s, smooth_s=smooth, gain=drift.lag_s / smooth - 1.0, rate=1.0 / smooth)
