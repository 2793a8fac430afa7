"""Calibrations that other programs and devices hold, as calibrations of this package: constants without uncertainty.

imucal      JSON: a = (K_a R_a)^-1 (s - b_a), w = (K_g R_g)^-1 (s - b_g - K_ga a)
PX4         parameters CAL_ACC0_XOFF ..: R (raw - offset) scale, m/s2; CAL_GYRO0_XOFF ..: R (raw - offset), rad/s; R turns the
            sensor's axes to the airframe's: CAL_ACC0_ROT of an external sensor, else SENS_BOARD_ROT; then SENS_BOARD_X_OFF ..
ArduPilot   parameters INS_ACCOFFS_X, INS_ACCSCAL_X, INS_GYROFFS_X: the same, R by AHRS_ORIENTATION
x-io        Fusion's constants in C, or settings of an x-IMU3 in JSON: misalignment diag(sensitivity) (raw - offset), g and deg/s
Shimmer3    the dump of a device: (K R)^-1 (raw - b), m/s2 and deg/s, one set for each range

Polynomials over temperature of PX4 and ArduPilot are not read: the offset is that of the temperature which the file names.
``program_of`` recognises a file by its content; a new kind is a row of PROGRAMS.
"""

import json
import math
import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import read_bytes
from undrift.findings import Finding, finding
from undrift.io.columns import naming
from undrift.model import G_NAMES, MATRIX_NAMES, OFFSET_NAMES, Calibration, Provenance, TriadModel, Verdict
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, canonical_unit, is_physical, si_factor

LARGEST = 4_000_000  # bytes of such a file


def _model(
    program: str, matrix: FloatArray, offset: FloatArray, unit: str, out: str, g: FloatArray | None = None
) -> TriadModel:
    names = (*MATRIX_NAMES, *OFFSET_NAMES, *(() if g is None else G_NAMES))
    return TriadModel(
        method=f"imported/{program}",
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


def _calibration(
    program: str,
    device: str,
    gyro: TriadModel | None,
    accel: TriadModel | None,
    *more: Finding,
    temp_c: float = math.nan,
) -> Calibration:
    return Calibration(
        device=device,
        reference_temp_c=temp_c,
        gravity_m_s2=math.nan,
        gyro=gyro,
        accel=accel,
        verdict=Verdict(status="marginal", findings=(finding("imported.uncertainty", "warn", program=program), *more)),
    )


# ---- imucal: calibrations of the Ferraris kind

VERSION = "2.0.0"
KIND = "Ferraris"
GRAVITY = 9.81  # m/s2: the default of imucal's procedure
WHAT = "imucal calibration"


def import_imucal(text: str, *, device: str = "") -> Calibration:
    """Return the calibration that a FerrarisCalibrationInfo of imucal holds."""
    content = _read_imucal(text)
    comment = _comment(content.get("comment"))
    unit_a, unit_g = _unit(content, "from_acc_unit", "accel"), _unit(content, "from_gyr_unit", "rate")
    out_a = si_factor(_unit(content, "acc_unit", "accel"), "accel")
    out_g = si_factor(_unit(content, "gyr_unit", "rate"), "rate")
    inverse_a, inverse_g = _inverse(content, "K_a", "R_a"), _inverse(content, "K_g", "R_g")
    g = inverse_g @ _array(content, "K_ga", (3, 3)) * (out_g / out_a)

    def number(key: str, default: float) -> float:
        value = comment.get(key)
        return float(value) if isinstance(value, int | float) else default

    gyro = _model("imucal", inverse_g * out_g, _array(content, "b_g", (3,)), unit_g, "rad/s", g)
    accel = _model("imucal", inverse_a * out_a, _array(content, "b_a", (3,)), unit_a, "m/s2")
    made = _calibration(
        "imucal", comment.get("device") or device, gyro, accel, temp_c=number("reference_temp_c", math.nan)
    )
    created = Provenance(created=str(comment.get("created", "")))
    return replace(made, gravity_m_s2=number("gravity_m_s2", GRAVITY), provenance=created)


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
    """Return what ``export_imucal`` wrote there; nothing where the comment is another's."""
    if not isinstance(comment, str) or not comment.startswith("undrift "):
        return {}
    try:
        found = json.loads(comment.removeprefix("undrift "))
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


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


def _inverse(content: dict[str, Any], gains: str, axes: str) -> FloatArray:
    forward = _array(content, gains, (3, 3)) @ _array(content, axes, (3, 3))
    if np.linalg.matrix_rank(forward) < 3:
        raise FileFormatError(
            f"{WHAT}: wanted a matrix {gains} {axes} that has an inverse, got one that has none; calibrate anew"
        )
    inverse: FloatArray = np.linalg.inv(forward)
    return inverse


# ---- parameters of the autopilots

_PARAMETER = re.compile(  # "CAL_ACC0_XOFF,0.1", "1 1 CAL_ACC0_XOFF 0.1 9", "x + CAL_ACC0_XOFF [110,402] : 0.1"
    r"\b((?:CAL|TC|INS|AHRS|SENS_BOARD)_[A-Z0-9_]+)\b(?:[ \t]*\[[\d,]+\])?[ \t,:=]+([-+]?\d[\d.eE+-]*)"
)


def _parameters(text: str) -> dict[str, float]:
    try:
        return {name: float(value) for name, value in _PARAMETER.findall(text)}
    except ValueError as error:
        raise FileFormatError(f"parameters: wanted numbers, got {error}; save them anew") from error


def _three(values: Mapping[str, float], name: str, axes: str = "XYZ", default: float = 0.0) -> FloatArray:
    return np.array([values.get(name.format(axis), default) for axis in axes])


# Roll, pitch and yaw of each rotation, deg, in the order of MAVLink's list (MAV_SENSOR_ORIENTATION)
_BOTH = [(roll, 0, 45 * k) for roll, yaws in ((0, 8), (180, 8), (90, 4), (270, 4)) for k in range(yaws)] + [
    (0, 90, 0), (0, 270, 0), (0, 180, 90), (0, 180, 270), (90, 90, 0), (180, 90, 0), (270, 90, 0), (90, 180, 0), (270, 180, 0),
    (90, 270, 0), (180, 270, 0), (270, 270, 0), (90, 180, 90), (90, 0, 270), None, (0, 315, 0), (90, 315, 0),
]  # fmt: skip
ROTATIONS = {  # None: its angles are listed rounded
    "PX4": [*_BOTH, (270, 0, 180), (270, 0, 270), (0, 90, 180), (0, 9, 180), (0, 45, 0), (270, 0, 225), (270, 0, 315)],
    "ArduPilot": [*_BOTH, (0, 7, 0), (45, 0, 0), (315, 0, 0)],
}
STATED = {"PX4": ("CAL_{}0_ROT", "SENS_BOARD_ROT"), "ArduPilot": ("AHRS_ORIENTATION",)}


def _turned(program: str, values: Mapping[str, float], triad: str) -> FloatArray:
    """Return the rotation (3, 3) from the sensor's axes to the airframe's: R_z(yaw) R_y(pitch) R_x(roll)."""
    from scipy.spatial.transform import Rotation

    names = [name.format(triad) for name in STATED[program]]
    name, number = next(((one, values[one]) for one in names if values.get(one, -1.0) >= 0.0), ("", 0.0))
    angles = dict(enumerate(ROTATIONS[program])).get(int(number))
    if angles is None:
        raise FileFormatError(
            f"wanted a rotation that {program} lists with its angles, got {name} {number:g}; set it to 0 in a copy of the file, "
            "and turn the readings to the airframe's axes before"
        )
    level = Rotation.from_euler("xyz", _three(values, "SENS_BOARD_{}_OFF"), degrees=True)  # of PX4
    matrix: FloatArray = (level * Rotation.from_euler("xyz", angles, degrees=True)).as_matrix()
    return matrix


COLDEST_C, WARMEST_C = -100.0, 200.0  # of electronics
OTHERS = {
    "PX4": r"CAL_(?:ACC|GYRO)([1-3])_[XYZ]OFF",
    "ArduPilot": r"INS_(?:ACC|GYR)([2-9])OFFS_[XYZ]",
}  # further sensors


def _autopilot(
    program: str, device: str, values: Mapping[str, float], accel: tuple[FloatArray, FloatArray], gyro: FloatArray, warm: str
) -> Calibration:  # fmt: skip
    """Return the calibration of (offset, scale) of accelerometers and the offset of gyroscopes; ``warm`` names the temperature."""
    temp_c, notes = values.get(warm, math.nan), list[Finding]()
    if warm and not COLDEST_C < temp_c < WARMEST_C:  # ArduPilot has -300 until it was calibrated
        got = f"{temp_c:g} degC" if warm in values else "none"
        raise FileFormatError(
            f"wanted {warm}, where the offsets hold, got {got}; save all parameters of a calibrated board"
        )
    if warm:
        notes.append(finding("imported.temperature", "warn", program=program, temp_c=temp_c))
    hits = (re.fullmatch(OTHERS[program], name) for name, value in values.items() if value)
    if others := {hit[1] for hit in hits if hit}:
        notes.append(finding("imported.sensor", "warn", program=program, sensors=1 + len(others)))
    gyros = _model(program, _turned(program, values, "GYRO"), gyro, "rad/s", "rad/s")
    accels = _model(program, _turned(program, values, "ACC") * accel[1], accel[0], "m/s2", "m/s2")
    return _calibration(program, device, gyros, accels, *notes, temp_c=temp_c)


def _px4(content: bytes, device: str) -> Calibration:
    values = _parameters(content.decode("utf-8", "replace"))
    warm_g, warm_a = (bool(values.get(f"TC_{letter}_ENABLE")) for letter in "GA")
    gyro = _three(values, "CAL_GYRO0_{}OFF") + warm_g * _three(values, "TC_G0_X0_{}", "012")
    accel = _three(values, "CAL_ACC0_{}OFF") + warm_a * _three(values, "TC_A0_X0_{}", "012")
    warm = "TC_G0_TREF" if warm_g else "TC_A0_TREF" if warm_a else ""
    return _autopilot("PX4", device, values, (accel, _three(values, "CAL_ACC0_{}SCALE", default=1.0)), gyro, warm)


def _ardupilot(content: bytes, device: str) -> Calibration:
    values = _parameters(content.decode("utf-8", "replace"))
    accel = _three(values, "INS_ACCOFFS_{}"), _three(values, "INS_ACCSCAL_{}", default=1.0)
    warm = "INS_GYR1_CALTEMP" if "INS_GYR1_CALTEMP" in values else "INS_ACC1_CALTEMP"
    warm = warm if values.get("INS_TCAL1_ENABLE") else ""
    return _autopilot("ArduPilot", device, values, accel, _three(values, "INS_GYROFFS_{}"), warm)


# ---- x-io: Fusion in C, settings of an x-IMU3


def _xio(content: bytes, device: str) -> Calibration:
    text = content.decode("utf-8", "replace")

    def held(triad: str, part: str, count: int, default: FloatArray) -> FloatArray:
        hit = re.search(rf'(?is){triad}_?{part}"?\s*[=:]([^;\]]*)', text)
        if hit is None:
            return default
        cells = re.findall(r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?", hit[1])
        if len(cells) != count:
            raise FileFormatError(f"{triad} {part}: wanted {count} numbers, got {len(cells)}; write the file anew")
        return np.array(cells, dtype=np.float64)

    models = {}
    for triad, physical, factor, out in (
        ("gyroscope", "dps", RADIAN_PER_DEGREE, "rad/s"), ("accelerometer", "g", STANDARD_GRAVITY, "m/s2")
    ):  # fmt: skip
        gain = held(triad, "sensitivity", 3, np.ones(3))
        matrix = held(triad, "misalignment", 9, np.eye(3).ravel()).reshape(3, 3) * gain
        unit = physical if (abs(np.log2(gain)) < 1.0).all() else "count"  # near 1: readings that have a unit already
        models[triad] = _model("x-io", matrix * factor, held(triad, "offset", 3, np.zeros(3)), unit, out)
    return _calibration("x-io", device, models["gyroscope"], models["accelerometer"])


# ---- Shimmer3: the calibration dump, as the firmware writes it (LogAndStream, shimmer_calibration.h)
#
#     length, hardware, firmware, major (uint16), minor, internal (uint8); then for each sensor and range
#     sensor (uint16), range (uint8), length (uint8), time of calibration (uint64, 0 for the default), 21 bytes:
#     b (3 int16), K (3 int16), R (9 int8, hundredths), big-endian; K of gyroscopes in hundredths

SHIMMER_GYRO, SHIMMER_ACCEL = (30, 38), (2, 37, 31, 39)  # low noise before wide range


def _shimmer_sets(content: bytes) -> dict[int, list[tuple[int, int, bytes]]]:
    """Return time, range and bytes of each set of a sensor; nothing of a file that is no dump."""
    found: dict[int, list[tuple[int, int, bytes]]] = {}
    if len(content) < 12 or not 0 <= len(content) - struct.unpack_from("<H", content)[0] <= 2:
        return {}
    place = 10
    while place + 12 <= len(content):
        sensor, which, length, stamp = struct.unpack_from("<HBBQ", content, place)
        place += 12 + length
        if place > len(content) or not sensor:
            return {}
        if length == 21:
            found.setdefault(sensor, []).append((stamp, which, content[place - length : place]))
    return found if place == len(content) else {}


def _shimmer(content: bytes, device: str) -> Calibration:
    sets, notes = _shimmer_sets(content), list[Finding]()

    def model(sensors: tuple[int, ...], gain: float, factor: float, out: str) -> TriadModel | None:
        mine = next((sorted(sets[sensor], reverse=True) for sensor in sensors if sensor in sets), None)
        if mine is None:
            return None
        stamp, which, held = mine[0]
        if len(mine) > 1 and not stamp:
            raise FileFormatError(
                f"wanted a range that was calibrated, got defaults of {len(mine)} ranges; calibrate the device in Consensys first"
            )
        if len(mine) > 1:
            notes.append(
                finding(
                    "imported.range",
                    "warn",
                    sensor="gyroscopes" if out == "rad/s" else "accelerometers",
                    range=which,
                    ranges=len(mine),
                )
            )
        offset, sizes = (
            np.array(struct.unpack(">3h", held[:6]), float),
            np.array(struct.unpack(">3h", held[6:12]), float),
        )
        forward = np.diag(sizes * gain) @ (np.array(struct.unpack("9b", held[12:]), float).reshape(3, 3) / 100.0)
        if np.linalg.matrix_rank(forward) < 3:
            raise FileFormatError("wanted gains and axes that have an inverse, got others; calibrate the device anew")
        return _model("Shimmer", np.linalg.inv(forward) * factor, offset, "count", out)

    gyro, accel = model(SHIMMER_GYRO, 0.01, RADIAN_PER_DEGREE, "rad/s"), model(SHIMMER_ACCEL, 1.0, 1.0, "m/s2")
    return _calibration("Shimmer", device, gyro, accel, *notes)


# ---- which is which

_VALUE = rb"(?:[ \t]*\[[\d,]+\])?[ \t,:=]+[-+]?\d"
Reader = Callable[[bytes, str], Calibration]
PROGRAMS: dict[str, tuple[Callable[[bytes], object], Reader]] = {
    "imucal": (
        re.compile(rb'"cal_type"\s*:').search,
        lambda content, device: import_imucal(content.decode("utf-8", "replace"), device=device),
    ),
    "PX4": (re.compile(rb"\bCAL_(ACC|GYRO)0_[XYZ]OFF" + _VALUE).search, _px4),
    "ArduPilot": (re.compile(rb"\bINS_(ACC|GYR)OFFS_[XYZ]" + _VALUE).search, _ardupilot),
    "x-io": (re.compile(rb"(?i)(gyroscope|accelerometer)_?(misalignment|sensitivity)\"?\s*[=:]").search, _xio),
    "Shimmer": (_shimmer_sets, _shimmer),
}


def program_of(path: Path) -> str | None:
    """Return whose calibration a file holds; None where it is none of these."""
    if not path.is_file() or path.stat().st_size > LARGEST:
        return None
    content = read_bytes(path)
    texts = b"\0" not in content  # logs of autopilots, which are binary, hold names of parameters too
    return next((name for name, (held, _) in PROGRAMS.items() if texts is (name != "Shimmer") and held(content)), None)


def read_foreign(path: Path, program: str) -> Calibration:
    """Read the calibration of another program."""
    with naming(path):
        return PROGRAMS[program][1](read_bytes(path), path.stem)
