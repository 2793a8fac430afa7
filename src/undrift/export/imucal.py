"""Calibrations of the Ferraris kind as imucal keeps them in JSON, both ways.

imucal evaluates, with diagonal K and rows of R of length 1::

    a = (K_a R_a)^-1 (s_a - b_a)        w = (K_g R_g)^-1 (s_g - b_g - K_ga a)

so that K R is the forward matrix, K the sensors' sensitivities, R their axes, and the g-sensitivity G = (K_g R_g)^-1 K_ga.
Its units are m/s^2 and deg/s. What imucal has no key for (serial number, reference temperature, gravity) stands in its comment,
from where it is read back. An imported calibration has NaN for every uncertainty: the file has none.
"""

import json
import math
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import G_NAMES, MATRIX_NAMES, OFFSET_NAMES, Calibration, Provenance, TriadModel, Verdict
from undrift.errors import FileFormatError, InputError
from undrift.export.constant import Constant, constants_of
from undrift.export.losses import Part, losses
from undrift.export.value import Exported
from undrift.units import RADIAN_PER_DEGREE, canonical_unit, is_physical, si_factor

CARRIED: frozenset[Part] = frozenset(("gain", "cross", "accel gain", "accel cross", "g"))
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
    reasons=(
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
        text=json.dumps(content, indent=4) + "\n", not_carried=losses(calibration, CARRIED), notes=pair.notes
    )


def import_imucal(text: str, *, device: str = "") -> Calibration:
    """Return the calibration that a FerrarisCalibrationInfo of imucal holds.

    Parameters
    ----------
    text : str
        JSON as imucal's to_json wrote it, format 2.
    device : str
        Serial number, where its comment does not say it.

    Returns
    -------
    Calibration
        Covariance NaN and verdict marginal: the file has no uncertainties. Gravity is the comment's, else 9.81 m/s2.

    Raises
    ------
    FileFormatError
        Not JSON, another kind or version, a key that is missing or of another shape, a unit that is not known.
    """
    content = _read(text)
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


def _read(text: str) -> dict[str, Any]:
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
