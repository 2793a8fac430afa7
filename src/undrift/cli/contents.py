"""What a calibration holds, for ``undrift info``."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.calibration.model import Calibration, DriftTables
    from undrift.io.describe import Description


def contents_of(path: Path, found: "Description") -> "tuple[Description, dict[str, list[str]]]":
    """Return what a calibration holds.

    Parameters
    ----------
    path : Path
        calibration.json.
    found : Description
        What is known of it.

    Returns
    -------
    found : Description
        With the span of all its tables, degC.
    lines : dict
        What there is to say of each part.
    """
    from undrift.calibration.store import read_calibration

    held = read_calibration(path)
    lines = _triads(held)
    tables, spans = _tables(held.drift)
    if tables:
        lines["tables"] = tables
    lines["verdict"] = [held.verdict.status, *held.verdict.reasons]
    span = (max(s[0] for s in spans), min(s[-1] for s in spans)) if spans else None
    return replace(found, temp_c=None if span is None else (float(span[0]), float(span[1]))), lines


def _triads(held: "Calibration") -> dict[str, list[str]]:
    lines: dict[str, list[str]] = {}
    for name, model in (("gyro", held.gyro), ("accel", held.accel)):
        if model is None:
            lines[name] = ["no model"]
            continue
        lines[name] = [f"{model.method}, {model.unit_in} to {model.unit_out}"]
        if model.g_sensitivity is not None:
            lines[name].append("g-sensitivity")
    known = held.reference_temp_c == held.reference_temp_c
    lines["reference temperature"] = [f"{held.reference_temp_c:.2f} degC" if known else "not known"]
    return lines


def _tables(drift: "DriftTables | None") -> "tuple[list[str], list[FloatArray]]":
    """A sentence each, and the temperatures of their nodes."""
    said: list[str] = []
    spans: list[FloatArray] = []
    if drift is None:
        return said, spans
    static, scale, dynamic = drift.static, drift.scale, drift.dynamic
    parts = []
    if static is not None:
        parts += [
            ("offset of the gyro", static.temp_c, static.gyro_offset, static.gyro_extrapolated),
            ("offset of the accel", static.temp_c, static.accel_offset, static.accel_extrapolated),
        ]
    if scale is not None:
        parts += [
            ("matrix of the gyro", scale.temp_c, scale.gyro_matrix, scale.gyro_extrapolated),
            ("matrix of the accel", scale.temp_c, scale.accel_matrix, scale.accel_extrapolated),
        ]
    if dynamic is not None:
        low, high = dynamic.turn_rate[0] / RADIAN_PER_DEGREE, dynamic.turn_rate[-1] / RADIAN_PER_DEGREE
        what = f"error of the gyro over {low:.0f} to {high:.0f} deg/s"
        parts.append((what, dynamic.temp_c, dynamic.error, dynamic.extrapolated))
    for what, temp_c, values, marks in parts:
        if values is not None:
            far = 0 if marks is None else int(marks.sum())
            count = values.shape[0] if marks is None else marks.size
            said.append(f"{what} {temp_c[0]:g} to {temp_c[-1]:g} degC ({count} nodes, {far} extrapolated)")
            spans.append(temp_c)
    if static is not None and static.warm_up is not None:
        said.append(f"warm-up over {static.warm_up.power_on_s[-1]:g} s")
    if drift.lag_s > 0.0:
        said.append(f"thermometer lag {drift.lag_s:g} s")
    return said, spans
