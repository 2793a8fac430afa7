"""The readings of a recording, its rests and its turns, as the page Check draws them."""

from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.pieces import pieces_of
from undrift.calibration.session import look
from undrift.calibration.settings import CalibrateSettings
from undrift.commands.files import Opening
from undrift.io.inspect import describe
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, Quantity, is_physical, si_factor

MOST_BLOCKS = 500  # of a recording that is drawn: the least and the greatest reading of each
_SHOWN: tuple[tuple[str, Quantity, str, float], ...] = (
    ("gyro", "rate", "deg/s", RADIAN_PER_DEGREE),
    ("accel", "accel", "g", STANDARD_GRAVITY),
)


def trace_of(recording: Path, opening: Opening) -> dict[str, Any]:
    """Return the data of a recording that a page draws: time, readings, rests and turns, and the mean readings at rest.

    Times are in s since the first sample. Readings are [x, y, z] of each sensor, in deg/s and g if the recording has
    physical units.
    """
    session = describe(recording, opening.how(recording)).session
    if session is None or session.means:
        return {}
    observed = look(session, CalibrateSettings())
    record, pieces = observed.session.records[0], pieces_of(observed)
    time = record.time - record.time[0]
    trace: dict[str, Any] = {"time": _envelope(time[:, None])[0], "readings": {}, "units": {}, "at_rest": {}}
    for name, quantity, unit, size in _SHOWN:
        if (values := getattr(record, name)) is None:
            continue
        trace["units"][name] = raw_unit = getattr(record, f"{name}_unit")
        if is_physical(raw_unit):
            values, trace["units"][name] = values * (si_factor(raw_unit, quantity) / size), unit
        trace["readings"][name] = _envelope(values)
        if means := [np.linalg.norm(values[still.start : still.stop].mean(axis=0)) for still in observed.stills]:
            trace["at_rest"][name] = float(np.median(means))
    spans = [(piece.kind, piece.label, float(time[piece.start]), float(time[piece.stop - 1])) for piece in pieces]
    return trace | {"stretches": spans}


def _envelope(values: FloatArray) -> list[list[float | None]]:
    """Return the least and greatest value of each block of samples per column, or all samples of a short recording."""
    width = -(-len(values) // MOST_BLOCKS)
    if width > 2:
        starts = np.arange(0, len(values), width)
        ends = np.stack((np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)), axis=1)
        falling = values[starts] > values[np.append(starts[1:], len(values)) - 1]
        values = np.where(falling[:, None], ends[:, ::-1], ends).reshape(-1, values.shape[1])
    return [[float(f"{value:.5g}") if np.isfinite(value) else None for value in column] for column in values.T]
