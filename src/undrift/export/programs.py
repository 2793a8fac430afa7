"""Constants for Fusion of x-io: misalignment, sensitivity and offset of both triads, as C.

    calibrated = misalignment diag(sensitivity) (reading - offset)        gyroscopes deg/s, accelerometers g

so that misalignment diag(sensitivity) is the calibration's matrix: the sensitivities are the lengths of its columns, the
misalignment what is left, near the unit matrix and without a unit.

Calibrations of the Ferraris kind as imucal keeps them in JSON, both ways.

imucal evaluates, with diagonal K and rows of R of length 1::

    a = (K_a R_a)^-1 (s_a - b_a)        w = (K_g R_g)^-1 (s_g - b_g - K_ga a)

so that K R is the forward matrix, K the sensors' sensitivities, R their axes, and the g-sensitivity G = (K_g R_g)^-1 K_ga.
Its units are m/s^2 and deg/s. What imucal has no key for (serial number, reference temperature, gravity) stands in its comment,
from where it is read back. An imported calibration has NaN for every uncertainty: the file has none.

Parameters of a ROS 2 node, YAML. There is no standard for an inertial sensor's calibration: these keys are documented here.

    gyro_matrix, gyro_offset, gyro_g_sensitivity, accel_matrix, accel_offset      row by row, SI per raw unit and raw unit::

        accel = accel_matrix (raw - accel_offset)        gyro = gyro_matrix (raw - gyro_offset) - gyro_g_sensitivity accel

    SM, bias                                             the accelerometer again, as imu_calib has it: SM raw - bias, m/s2
    gyroscope_noise_density, gyroscope_random_walk, accelerometer_noise_density, accelerometer_random_walk
                                                         noise under the names that Kalibr gave it: the largest of three axes

Lists are flat, since ROS 2 takes no other, and every number has a point, so that none is read as an integer or as text.
"""

import json
import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.export.firmware import Table, Triad, triads_of
from undrift.export.losses import Exported, Part, losses
from undrift.model import G_NAMES, MATRIX_NAMES, OFFSET_NAMES, Calibration, Provenance, TriadModel, Verdict
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, canonical_unit, is_physical, si_factor

# ---- A calibration at one temperature: matrix and offset of each triad, for targets that have no tables.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Constant:
    """A triad at one temperature: SI = matrix (reading - offset) - g_sensitivity a."""

    unit_in: str  # Unit of the reading
    matrix: FloatArray  # (3, 3), SI per raw unit
    offset: FloatArray  # (3,), raw unit
    g_sensitivity: FloatArray | None  # (3, 3), rad/s per m/s2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConstantPair:
    """Both triads at one temperature."""

    gyro: Constant | None  # None where the calibration has no model
    accel: Constant | None  # None where the calibration has no model
    temp_c: float  # Where tables were read, degC; NaN where there are none and the reference temperature is not known
    notes: tuple[str, ...]  # What was frozen


def constants_of(calibration: Calibration, temp_c: float | None = None) -> ConstantPair:
    """Return both triads at one temperature."""
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


# ---- Calibrations of the Ferraris kind as imucal keeps them in JSON, both ways.

CARRIED_IMUCAL: frozenset[Part] = frozenset(("gain", "cross", "accel gain", "accel cross", "g"))
VERSION = "2.0.0"
KIND = "Ferraris"
GRAVITY = 9.81  # m/s2: what imucal's procedure takes unless told otherwise
UNIT_NAMES = (
    ("m/s2", "m/s^2"),
    ("dps", "deg/s"),
    ("count", "a.u."),
    ("rad/s", "rad/s"),
    ("g", "g"),
    ("mg", "mg"),
    ("v", "V"),
)
WHAT = "imucal calibration"
UNKNOWN = Verdict(
    status="marginal",
    remarks=(
        "imported from imucal, whose file has no uncertainties: they are NaN here; calibrate from the recording itself for them",
    ),
)


def export_imucal(calibration: Calibration, *, temp_c: float | None = None) -> Exported:
    """Return a FerrarisCalibrationInfo of imucal as JSON.

    Parameters
    ----------
    calibration : Calibration
        The device's model; both triads.
    temp_c : float or None
        Where to read tables over temperature, degC; None for the reference temperature.

    Returns
    -------
    Exported
        The JSON text.

    Raises
    ------
    InputError
        A triad without a model; as for ``constants_of``.
    """
    pair = constants_of(calibration, temp_c)
    if pair.gyro is None or pair.accel is None:
        raise InputError("export imucal: wanted gyroscopes and accelerometers, got one of them; calibrate both")
    gains_a, axes_a, _ = _split(pair.accel.matrix)
    gains_g, axes_g, forward = _split(pair.gyro.matrix / RADIAN_PER_DEGREE)
    g = np.zeros((3, 3)) if pair.gyro.g_sensitivity is None else pair.gyro.g_sensitivity / RADIAN_PER_DEGREE
    comment = {
        "device": calibration.device,
        "reference_temp_c": _or_none(pair.temp_c),
        "gravity_m_s2": _or_none(calibration.gravity_m_s2),
        "created": calibration.provenance.created,
    }
    content = {
        "acc_unit": "m/s^2",
        "gyr_unit": "deg/s",
        "from_acc_unit": dict(UNIT_NAMES)[pair.accel.unit_in],
        "from_gyr_unit": dict(UNIT_NAMES)[pair.gyro.unit_in],
        "comment": "undrift " + json.dumps(comment),
        "K_a": np.diag(gains_a).tolist(),
        "R_a": axes_a.tolist(),
        "b_a": _plain(pair.accel),
        "K_g": np.diag(gains_g).tolist(),
        "R_g": axes_g.tolist(),
        "K_ga": (forward @ g).tolist(),
        "b_g": _plain(pair.gyro),
        "cal_type": KIND,
        "_format_version": VERSION,
    }
    return Exported(
        text=json.dumps(content, indent=4) + "\n", not_carried=losses(calibration, CARRIED_IMUCAL), notes=pair.notes
    )


def import_imucal(text: str, *, device: str = "") -> Calibration:
    """Return the calibration that a FerrarisCalibrationInfo of imucal holds."""
    content = _read_imucal(text)
    said = _comment(content.get("comment"))
    unit_a, unit_g = _unit(content, "from_acc_unit", "accel"), _unit(content, "from_gyr_unit", "rate")
    out_a = si_factor(_unit(content, "acc_unit", "accel"), "accel")
    out_g = si_factor(_unit(content, "gyr_unit", "rate"), "rate")
    inverse_a = _inverse(_array(content, "K_a", (3, 3)) @ _array(content, "R_a", (3, 3)), "K_a R_a")
    inverse_g = _inverse(_array(content, "K_g", (3, 3)) @ _array(content, "R_g", (3, 3)), "K_g R_g")
    g = inverse_g @ _array(content, "K_ga", (3, 3)) * (out_g / out_a)
    return Calibration(
        device=said.get("device") or device,
        reference_temp_c=_number(said.get("reference_temp_c"), math.nan),
        gravity_m_s2=_number(said.get("gravity_m_s2"), GRAVITY),
        gyro=_model(inverse_g * out_g, _array(content, "b_g", (3,)), unit_g, "rad/s", g),
        accel=_model(inverse_a * out_a, _array(content, "b_a", (3,)), unit_a, "m/s2", None),
        verdict=UNKNOWN,
        provenance=Provenance(created=str(said.get("created", ""))),
    )


def _split(matrix: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Sensitivities, axes, and the forward matrix that they make."""
    forward = np.linalg.inv(matrix)
    length = np.linalg.norm(forward, axis=1)
    return length, forward / length[:, None], forward


def _plain(triad: Constant) -> list[float]:
    return [float(v) for v in triad.offset]


def _or_none(x: float) -> float | None:
    return x if math.isfinite(x) else None


def _read_imucal(text: str) -> dict[str, Any]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{WHAT}: wanted JSON, got {error}; save it anew from imucal") from error
    kind = content.get("cal_type") if isinstance(content, dict) else None
    if kind != KIND:
        raise FileFormatError(f"{WHAT}: wanted cal_type {KIND!r}, got {kind!r}; other kinds are not read")
    version = content.get("_format_version", VERSION if "from_acc_unit" in content else "1.0.0")
    if version != VERSION:
        raise FileFormatError(
            f"{WHAT}: wanted format {VERSION}, got {version!r}; convert it with imucal's legacy helpers first"
        )
    return dict(content)


def _comment(comment: object) -> dict[str, Any]:
    """What this package once wrote there; nothing where the comment is another's."""
    if not isinstance(comment, str) or not comment.startswith("undrift "):
        return {}
    try:
        said = json.loads(comment.removeprefix("undrift "))
    except ValueError:
        return {}
    return said if isinstance(said, dict) else {}


def _number(x: object, default: float) -> float:
    return float(x) if isinstance(x, int | float) else default


def _unit(content: dict[str, Any], key: str, quantity: Any) -> str:
    unit = content.get(key)
    known = "count" if unit == "a.u." else unit
    try:
        found = canonical_unit(known, quantity) if isinstance(known, str) else ""
    except InputError:
        found = ""
    if not found or (not key.startswith("from") and not is_physical(found)):
        raise FileFormatError(f"{WHAT}: wanted a unit for {key}, got {unit!r}; write it into the file")
    return found


def _array(content: dict[str, Any], key: str, shape: tuple[int, ...]) -> FloatArray:
    try:
        array = np.array(content.get(key), dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise FileFormatError(f"{WHAT}: wanted {key} as finite numbers of shape {shape}, got others; save it anew")
    return array


def _inverse(forward: FloatArray, name: str) -> FloatArray:
    if np.linalg.matrix_rank(forward) < 3:
        raise FileFormatError(
            f"{WHAT}: wanted a matrix {name} that has an inverse, got one that has none; calibrate anew"
        )
    inverse: FloatArray = np.linalg.inv(forward)
    return inverse


def _model(matrix: FloatArray, offset: FloatArray, unit: str, out: str, g: FloatArray | None) -> TriadModel:
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


# ---- Parameters of a ROS 2 node, YAML. There is no standard for an inertial sensor's calibration: these keys are documented here.

CARRIED_ROS: frozenset[Part] = frozenset(("gain", "cross", "accel gain", "accel cross", "g", "noise"))


def export_ros(calibration: Calibration, *, temp_c: float | None = None) -> Exported:
    """Return a parameter file for a ROS 2 node.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    temp_c : float or None
        Where to read tables over temperature, degC; None for the reference temperature.

    Returns
    -------
    Exported
        YAML.

    Raises
    ------
    InputError
        As for ``constants_of``.
    """
    pair = constants_of(calibration, temp_c)
    lines = [
        "# accel = accel_matrix (raw - accel_offset), m/s2",
        "# gyro = gyro_matrix (raw - gyro_offset) - gyro_g_sensitivity accel, rad/s",
        "/**:",
        "  ros__parameters:",
        f"    device: {json.dumps(calibration.device)}",
    ]
    if np.isfinite(pair.temp_c):
        lines.append(f"    temperature_c: {number(pair.temp_c)}")
    for name, triad in (("gyro", pair.gyro), ("accel", pair.accel)):
        if triad is None:
            continue
        lines += [f"    {name}_unit_in: {json.dumps(triad.unit_in)}"]
        lines += [_list(f"{name}_matrix", triad.matrix), _list(f"{name}_offset", triad.offset)]
        if triad.g_sensitivity is not None:
            lines.append(_list(f"{name}_g_sensitivity", triad.g_sensitivity))
    if pair.accel is not None:
        lines += [_list("SM", pair.accel.matrix), _list("bias", pair.accel.matrix @ pair.accel.offset)]
    lines += _noise(calibration)
    notes = (*pair.notes, "no standard names these keys: map them to those of your node")
    return Exported(text="\n".join(lines) + "\n", not_carried=losses(calibration, CARRIED_ROS), notes=notes)


def number(x: float) -> str:
    """Return a number that every YAML reader takes for one: with a point, also before an exponent."""
    return re.sub(r"^(-?\d+)(e|$)", r"\1.0\2", repr(float(x)))


def _list(name: str, values: FloatArray) -> str:
    return f"    {name}: [{', '.join(number(float(v)) for v in np.ravel(values))}]"


def _noise(calibration: Calibration) -> list[str]:
    noise = calibration.noise
    if noise is None:
        return []
    named = (
        ("gyroscope_noise_density", noise.angle_random_walk),
        ("gyroscope_random_walk", noise.rate_random_walk),
        ("accelerometer_noise_density", noise.velocity_random_walk),
        ("accelerometer_random_walk", noise.accel_random_walk),
    )
    return [f"    {name}: {number(float(np.nanmax(v)))}" for name, v in named if np.isfinite(v).any()]


# ---- programs

CARRIED: frozenset[Part] = frozenset(("gain", "cross", "accel gain", "accel cross"))


def export_fusion(calibration: Calibration, *, temp_c: float | None = None) -> Exported:
    """Return the constants that FusionCalibrationInertial takes, as a C header.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    temp_c : float or None
        Where to read tables over temperature, degC; None for the reference temperature.

    Returns
    -------
    Exported
        Definitions of FusionMatrix and FusionVector for each triad.

    Raises
    ------
    InputError
        As for ``constants_of``.
    """
    pair = constants_of(calibration, temp_c)
    lines = [
        "/* calibrated = misalignment * (sensitivity .* (reading - offset)): gyroscope deg/s, accelerometer g. */",
        "#include <Fusion.h>",
        "",
    ]
    triads = (("gyroscope", pair.gyro, RADIAN_PER_DEGREE), ("accelerometer", pair.accel, STANDARD_GRAVITY))
    notes = list(pair.notes)
    for name, triad, unit in triads:
        if triad is None:
            notes.append(f"no {name} constants: the calibration has no model of it")
            continue
        misalignment, sensitivity = decompose(triad.matrix / unit)
        notes.append(f"{name} readings are in {triad.unit_in}")
        lines += _text(name, triad, misalignment, sensitivity)
    return Exported(
        text="\n".join(lines) + "\n", not_carried=losses(calibration, CARRIED), notes=(*notes, "single precision")
    )


def decompose(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return misalignment M and sensitivity s with matrix = M diag(s).

    Arrays: matrix (3, 3) -> (3, 3), (3,).
    """
    sensitivity: FloatArray = np.linalg.norm(matrix, axis=0)
    return matrix / sensitivity, sensitivity


def _text(name: str, triad: Constant, misalignment: FloatArray, sensitivity: FloatArray) -> list[str]:
    rows = ", ".join("{" + _numbers(row) + "}" for row in misalignment)
    return [
        f"static const FusionMatrix {name}Misalignment = {{.array = {{{rows}}}}};",
        f"static const FusionVector {name}Sensitivity = {{.array = {{{_numbers(sensitivity)}}}}};",
        f"static const FusionVector {name}Offset = {{.array = {{{_numbers(triad.offset)}}}}};",
        "",
    ]


def _numbers(values: FloatArray) -> str:
    return ", ".join(f"{float(v):.9e}f" for v in values)
