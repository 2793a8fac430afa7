"""The constants of correction (correction/plan.py) as firmware evaluates them: tables on findable grids.

A table whose nodes are whole multiples of one step is put on the even grid that holds them all, where the cell is found by one
multiplication; one that would more than double its memory that way keeps its nodes, and the cell is found by bisection in a
number of steps that depends on the table alone. Either way a lookup takes constant
time. Then the lead that removes a thermometer's lag.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from undrift.correction.plan import Constants, LookupTable, TableAxis, constants_of
from undrift.errors import InputError
from undrift.model import SENSORS, Calibration

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
    findable: dict[str, Any] = {name: table.evened() for name, table in tables}
    return replace(constants, **findable)


def stride_of(axis: TableAxis) -> int:
    """Return the first stride of a bisection: the largest power of two below the number of cells, at least 1."""
    return 1 << max(0, (axis.cells - 1).bit_length() - 1)


# ---- Lead: removes a thermometer's lag, the filter of drift/temperature.py rewritten
#
# With d = x - z, how far the reading x is from its low-passed z, a = dt / smooth, and g = lag / smooth:
#
#     d = e^-a d + m (x - x_before)     m = (1 - e^-a) / a          y = x + (g - 1) d
#
# so that two numbers are carried, and d is small where the temperature is steady: float loses little.

SHORTEST_S, LONGEST_S = 1e-3, 1e5  # smoothing that float holds with its accuracy
MOST_GAIN = 2.0**15


@dataclass(frozen=True, slots=True, kw_only=True)
class Lead:
    """Constants of the lead."""

    lag_s: float  # The thermometer's time constant
    smooth_s: float  # Time constant of the smoothing
    gain: float  # g - 1
    rate: float  # One over the smoothing, 1/s


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
    return Lead(lag_s=drift.lag_s, smooth_s=smooth, gain=drift.lag_s / smooth - 1.0, rate=1.0 / smooth)
