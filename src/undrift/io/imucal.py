"""Calibrations of imucal, kind Ferraris: constants without uncertainty.

a = (K_a R_a)^-1 (s - b_a)          w = (K_g R_g)^-1 (s - b_g - K_ga a)
"""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import read_bytes
from undrift.findings import finding
from undrift.io.column_map import naming
from undrift.model import G_NAMES, MATRIX_NAMES, OFFSET_NAMES, Calibration, Provenance, TriadModel, Verdict
from undrift.units import canonical_unit, is_physical, si_factor

UNKNOWN = "The uncertainties are unknown, because a calibration of imucal contains none."
CALIBRATE = "Calibrate from a recording of the device."

LARGEST = 4_000_000  # size limit of such a file, bytes
VERSION = "2.0.0"
GRAVITY = 9.81  # m/s2: the default of imucal's procedure
WHAT = "imucal calibration"


def is_imucal(path: Path) -> bool:
    """Return True if the content of a file is a calibration of imucal."""
    if not path.is_file() or path.stat().st_size > LARGEST:
        return False
    content = read_bytes(path)
    return b"\0" not in content and re.search(rb'"cal_type"\s*:', content) is not None


def read_imucal(path: Path) -> Calibration:
    """Read a calibration of imucal."""
    with naming(path):
        return import_imucal(read_bytes(path).decode("utf-8", "replace"), device=path.stem)


def import_imucal(text: str, *, device: str = "") -> Calibration:
    """Return the calibration of a FerrarisCalibrationInfo of imucal."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{WHAT}: expected JSON, got {error}. Save it again from imucal.") from error
    kind = content.get("cal_type") if isinstance(content, dict) else None
    if kind != "Ferraris":
        raise FileFormatError(f"{WHAT}: expected cal_type 'Ferraris', got {kind!r}, which is not supported.")
    version = content.get("_format_version", VERSION if "from_acc_unit" in content else "1.0.0")
    if version != VERSION:
        raise FileFormatError(
            f"{WHAT}: expected format {VERSION}, got {version!r}. Convert it with imucal's legacy helpers first."
        )
    out_a = si_factor(_unit(content, "acc_unit", "accel"), "accel")
    out_g = si_factor(_unit(content, "gyr_unit", "rate"), "rate")
    inverse_a, inverse_g = _inverse(content, "K_a", "R_a"), _inverse(content, "K_g", "R_g")
    g = inverse_g @ _array(content, "K_ga", (3, 3)) * (out_g / out_a)
    return Calibration(
        device=device,
        reference_temp_c=math.nan,
        gravity_m_s2=GRAVITY,
        gyro=_model(
            inverse_g * out_g, _array(content, "b_g", (3,)), _unit(content, "from_gyr_unit", "rate"), "rad/s", g
        ),
        accel=_model(inverse_a * out_a, _array(content, "b_a", (3,)), _unit(content, "from_acc_unit", "accel"), "m/s2"),
        verdict=Verdict(status="marginal", findings=(finding("imported.uncertainty", "warn", UNKNOWN, CALIBRATE),)),
        provenance=Provenance(created=""),
    )


def _model(matrix: FloatArray, offset: FloatArray, unit: str, out: str, g: FloatArray | None = None) -> TriadModel:
    names = (*MATRIX_NAMES, *OFFSET_NAMES, *(() if g is None else G_NAMES))
    return TriadModel(
        method="imported/imucal",
        unit_in=unit,
        unit_out=out,
        matrix=matrix,
        offset=offset,
        g_sensitivity=g,
        parameters=names,
        covariance=np.full((len(names), len(names)), np.nan),
        rms_residual=math.nan,
        count=0,
        rank=0,
        condition=math.nan,
        valid_range=(math.nan, math.nan),
    )


def _unit(content: dict[str, Any], key: str, quantity: Any) -> str:
    unit = content.get(key)
    spelling = "count" if unit == "a.u." else unit
    try:
        canonical = canonical_unit(spelling, quantity) if isinstance(spelling, str) else ""
    except InputError:
        canonical = ""
    if not canonical or (not key.startswith("from") and not is_physical(canonical)):
        raise FileFormatError(f"{WHAT}: expected a unit for {key}, got {unit!r}. Write it into the file.")
    return canonical


def _array(content: dict[str, Any], key: str, shape: tuple[int, ...]) -> FloatArray:
    try:
        array = np.array(content.get(key), dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise FileFormatError(f"{WHAT}: expected {key} as finite numbers of shape {shape}. Save the file again.")
    return array


def _inverse(content: dict[str, Any], gains: str, axes: str) -> FloatArray:
    forward = _array(content, gains, (3, 3)) @ _array(content, axes, (3, 3))
    if np.linalg.matrix_rank(forward) < 3:
        raise FileFormatError(f"{WHAT}: the matrix {gains} {axes} has no inverse. Calibrate again.")
    return np.asarray(np.linalg.inv(forward))
