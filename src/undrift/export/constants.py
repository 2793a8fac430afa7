"""Matrix and offset of both triads at one temperature, as JSON or as a C header, for programs without tables.

::

    accel = accel_matrix (raw - accel_offset)                                    m/s2
    gyro  = gyro_matrix (raw - gyro_offset) - gyro_g_sensitivity accel           rad/s

docs/export.md lists the places of these numbers in Fusion, ROS, PX4 and ArduPilot.
"""

import json
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray, interpolated
from undrift.correction.plan import Constants, LookupTable
from undrift.errors import InputError
from undrift.export import Exported, ExportOptions, conversions, not_in_constants
from undrift.export.c import check_prefix, comment_text, triads_of
from undrift.model import Calibration

UNIT_OUT = {"gyro": "rad/s", "accel": "m/s2"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConstantPair:
    """Both triads at one temperature."""

    gyro: Constants | None  # SI = matrix (reading - offset) - g_sensitivity a (None without a model)
    accel: Constants | None
    temp_c: float  # temperature of the constants, degC, or NaN without tables and reference temperature
    read_tables: bool  # True if tables over temperature were evaluated at temp_c


def pair_at(calibration: Calibration, temp_c: float | None = None) -> ConstantPair:
    """Return both triads at one temperature, the reference temperature by default."""
    gyro, accel = triads_of(calibration)
    candidates = [
        table for triad in (gyro, accel) if triad is not None for table in (triad.offset_table, triad.matrix_table)
    ]
    tables = [table for table in candidates if table is not None]
    temp = calibration.reference_temp_c if temp_c is None else temp_c
    if tables:
        low, high = max(t.temp.start for t in tables), min(t.temp.stop for t in tables)
        if not low <= temp <= high:
            raise InputError(
                f"export: the tables cover {low:g} to {high:g} degC, got {temp:g}. Set temp_c within this range.",
                low=low,
                high=high,
            )
    return ConstantPair(
        gyro=None if gyro is None else _at(gyro, temp),
        accel=None if accel is None else _at(accel, temp),
        temp_c=temp,
        read_tables=bool(tables),
    )


def _at(triad: Constants, temp: float) -> Constants:
    def read(table: LookupTable) -> FloatArray:
        return interpolated(temp, table.temp.nodes, table.values)

    offset, matrix = triad.offset_table, triad.matrix_table
    return replace(
        triad,
        matrix=triad.matrix if matrix is None else read(matrix).reshape(3, 3),
        offset=triad.offset if offset is None else read(offset),
    )


def write_constants(calibration: Calibration, options: ExportOptions, name: str) -> Exported:
    """Return the constants as a C header if the name of the file ends in .h, otherwise as JSON."""
    pair = pair_at(calibration, options.temp_c)
    notes = [f"tables over temperature are evaluated at {pair.temp_c:g} degC"] if pair.read_tables else []
    for sensor, triad in (("gyroscope", pair.gyro), ("accelerometer", pair.accel)):
        if triad is None:
            notes.append(f"no {sensor} constants, because the calibration has no {sensor} model")
        else:
            notes.append(f"{sensor} readings are in {triad.unit_in}")
    notes += conversions(calibration)
    if name.lower().endswith(".h"):
        notes.append("numbers are in single precision")
        text = _header(calibration, pair, options.prefix)
    else:
        text = _json(calibration, pair)
    return Exported(files={name: text}, not_carried=not_in_constants(calibration), notes=tuple(notes))


def _json(calibration: Calibration, pair: ConstantPair) -> str:
    content: dict[str, object] = {"kind": "undrift.constants", "format": 1, "device": calibration.device}
    content["temp_c"] = pair.temp_c if np.isfinite(pair.temp_c) else None
    for name, triad in (("gyro", pair.gyro), ("accel", pair.accel)):
        content[name] = triad and {
            "unit_in": triad.unit_in,
            "unit_out": UNIT_OUT[name],
            "matrix": triad.matrix.tolist(),
            "offset": triad.offset.tolist(),
            "g_sensitivity": None if triad.g_sensitivity is None else triad.g_sensitivity.tolist(),
        }
    return json.dumps(content, indent=1) + "\n"


def _header(calibration: Calibration, pair: ConstantPair, prefix: str) -> str:
    check_prefix(prefix)
    device, guard = comment_text(calibration.device) or "(no serial number)", f"{prefix.upper()}_CONSTANTS_H"
    at = f" at {pair.temp_c:g} degC" if np.isfinite(pair.temp_c) else ""
    lines = [
        f"/* Constants of the inertial sensor {device}{at}:",
        " * SI = matrix (raw - offset), of the gyroscopes minus g_sensitivity times the corrected acceleration. */",
    ]
    lines += [f"#ifndef {guard}", f"#define {guard}", ""]
    for name, triad in (("gyro", pair.gyro), ("accel", pair.accel)):
        if triad is None:
            continue
        lines.append(f"/* raw in {triad.unit_in}, result in {UNIT_OUT[name]} */")
        lines.append(_array(f"{prefix}_{name}_matrix[3][3]", triad.matrix))
        lines.append(_array(f"{prefix}_{name}_offset[3]", triad.offset))
        if triad.g_sensitivity is not None:
            lines.append(_array(f"{prefix}_{name}_g_sensitivity[3][3]", triad.g_sensitivity))
        lines.append("")
    return "\n".join((*lines, "#endif", ""))


def _array(name: str, values: FloatArray) -> str:
    rows = ["{" + ", ".join(f"{float(x):.9e}f" for x in row) + "}" for row in np.atleast_2d(values)]
    return f"static const float {name} = " + (rows[0] if values.ndim == 1 else "{" + ", ".join(rows) + "}") + ";"
