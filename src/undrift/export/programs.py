"""Constants for Fusion, imucal and ROS: both triads at one temperature, as each program evaluates them.

Fusion of x-io, gyroscopes deg/s, accelerometers g::

    calibrated = misalignment diag(sensitivity) (reading - offset)

so that misalignment diag(sensitivity) is the calibration's matrix: the sensitivities are the lengths of its columns.

imucal, with diagonal K and rows of R of length 1, in m/s^2 and deg/s::

    a = (K_a R_a)^-1 (s_a - b_a)        w = (K_g R_g)^-1 (s_g - b_g - K_ga a)

so that K R is the forward matrix, K the sensors' sensitivities, R their axes, and the g-sensitivity G = (K_g R_g)^-1 K_ga. What
imucal has no key for (serial number, reference temperature, gravity) stands in its comment, from where it is read back. An imported
calibration has NaN for every uncertainty: the file has none.

ROS 2 has no standard for an inertial sensor's calibration; the file holds parameters of a node, flat lists row by row::

    accel = accel_matrix (raw - accel_offset)        gyro = gyro_matrix (raw - gyro_offset) - gyro_g_sensitivity accel

SM and bias are the accelerometer again, as imu_calib has it: SM raw - bias; noise stands under the names of Kalibr.

Kalibr's own imu.yaml comes of a noise fit: densities and random walks of the worst axis, continuous-time, in rad/s/sqrt(Hz),
rad/s^2/sqrt(Hz), m/s^2/sqrt(Hz) and m/s^3/sqrt(Hz) ("IMU Noise Model", wiki of ethz-asl/kalibr); rad/s/sqrt(s) is rad/s^2/sqrt(Hz).
"""

import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray, interpolated
from undrift.calibration.noise import NoiseFit
from undrift.correction.plan import Constants, LookupTable
from undrift.errors import InputError
from undrift.export import Target
from undrift.export.firmware import triads_of
from undrift.export.losses import Exported, Part, losses, texts_of
from undrift.findings import Finding, finding
from undrift.io.imucal import KIND, VERSION
from undrift.io.store import calibration_text
from undrift.model import MATRIX_NAMES, OFFSET_NAMES, Calibration
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical

# ---- A calibration at one temperature, for targets that have no tables


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConstantPair:
    """Both triads at one temperature."""

    gyro: Constants | None  # SI = matrix (reading - offset) - g_sensitivity a; None where the calibration has no model
    accel: Constants | None
    temp_c: float  # Where tables were read; NaN where there are none and the reference temperature is not known
    notes: tuple[Finding, ...]  # What was frozen


def pair_at(calibration: Calibration, temp_c: float | None = None) -> ConstantPair:
    """Return both triads at one temperature; at the reference temperature by default."""
    gyro, accel = triads_of(calibration)
    held = [table for triad in (gyro, accel) if triad is not None for table in (triad.offset_table, triad.matrix_table)]
    tables = [table for table in held if table is not None]
    temp = calibration.reference_temp_c if temp_c is None else temp_c
    if tables:
        low, high = max(t.temp.start for t in tables), min(t.temp.stop for t in tables)
        if not low <= temp <= high:
            raise InputError(
                f"export: wanted a temperature from {low:g} to {high:g} degC to read the tables at, got {temp:g}; give temp_c",
                low=low,
                high=high,
            )
    return ConstantPair(
        gyro=None if gyro is None else _at(gyro, temp),
        accel=None if accel is None else _at(accel, temp),
        temp_c=temp,
        notes=(finding("export.read_at", "info", temp_c=temp),) if tables else (),
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


# ---- Fusion

CARRIED_FUSION: frozenset[Part] = frozenset(("gain", "cross", "accel gain", "accel cross"))


def export_fusion(calibration: Calibration, *, temp_c: float | None = None) -> Exported:
    """Return the constants that FusionModelInertial takes, as a C header.

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
        No model, NaN in it, or a temperature outside its tables.
    """
    pair = pair_at(calibration, temp_c)
    lines = [
        "/* FusionModelInertial(reading, misalignment, sensitivity, offset): gyroscope deg/s, accelerometer g. */",
        "#include <Fusion.h>",
        "",
    ]
    notes = list(pair.notes)
    for name, triad, unit in (
        ("gyroscope", pair.gyro, RADIAN_PER_DEGREE),
        ("accelerometer", pair.accel, STANDARD_GRAVITY),
    ):
        if triad is None:
            notes.append(finding("export.no_constants", "info", triad=name))
            continue
        misalignment, sensitivity = decompose(triad.matrix / unit)
        notes.append(finding("export.readings", "info", triad=name, unit=triad.unit_in))
        lines += [  # elements by name: the array is [3][3] in older headers and [9] in present ones
            f"static const FusionMatrix {name}Misalignment = {{.element = {{{_floats(misalignment.ravel())}}}}};",
            f"static const FusionVector {name}Sensitivity = {{.array = {{{_floats(sensitivity)}}}}};",
            f"static const FusionVector {name}Offset = {{.array = {{{_floats(triad.offset)}}}}};",
            "",
        ]
    notes.append(finding("export.single_precision", "info"))
    return Exported(text="\n".join(lines) + "\n", **texts_of(losses(calibration, CARRIED_FUSION), notes))


def decompose(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return misalignment M and sensitivity s with matrix = M diag(s)."""
    sensitivity: FloatArray = np.linalg.norm(matrix, axis=0)
    return matrix / sensitivity, sensitivity


def _floats(values: FloatArray) -> str:
    return ", ".join(f"{float(v):.9e}f" for v in values)


# ---- imucal: calibrations of the Ferraris kind in JSON; io/foreign.py reads them

CARRIED_IMUCAL: frozenset[Part] = frozenset(("gain", "cross", "accel gain", "accel cross", "g"))
UNIT_NAMES = {"m/s2": "m/s^2", "dps": "deg/s", "count": "a.u.", "rad/s": "rad/s", "g": "g", "mg": "mg", "v": "V"}


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
        A triad without a model, NaN in it, or a temperature outside its tables.
    """
    pair = pair_at(calibration, temp_c)
    if pair.gyro is None or pair.accel is None:
        raise InputError("export imucal: wanted gyroscopes and accelerometers, got one of them; calibrate both")
    forward_a, forward_g = np.linalg.inv(pair.accel.matrix), np.linalg.inv(pair.gyro.matrix / RADIAN_PER_DEGREE)
    gains_a, gains_g = (np.linalg.norm(forward, axis=1) for forward in (forward_a, forward_g))
    g = np.zeros((3, 3)) if pair.gyro.g_sensitivity is None else pair.gyro.g_sensitivity / RADIAN_PER_DEGREE
    comment = {
        "device": calibration.device,
        "reference_temp_c": pair.temp_c if math.isfinite(pair.temp_c) else None,
        "gravity_m_s2": calibration.gravity_m_s2 if math.isfinite(calibration.gravity_m_s2) else None,
        "created": calibration.provenance.created,
    }
    content = {
        "acc_unit": "m/s^2",
        "gyr_unit": "deg/s",
        "from_acc_unit": UNIT_NAMES[pair.accel.unit_in],
        "from_gyr_unit": UNIT_NAMES[pair.gyro.unit_in],
        "comment": "undrift " + json.dumps(comment),
        "K_a": np.diag(gains_a).tolist(),
        "R_a": (forward_a / gains_a[:, None]).tolist(),
        "b_a": pair.accel.offset.tolist(),
        "K_g": np.diag(gains_g).tolist(),
        "R_g": (forward_g / gains_g[:, None]).tolist(),
        "K_ga": (forward_g @ g).tolist(),
        "b_g": pair.gyro.offset.tolist(),
        "cal_type": KIND,
        "_format_version": VERSION,
    }
    text = json.dumps(content, indent=4) + "\n"
    return Exported(text=text, **texts_of(losses(calibration, CARRIED_IMUCAL), pair.notes))


# ---- ROS

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
        No model, NaN in it, or a temperature outside its tables.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("six_face", device, rng=rng))
    >>> exported = undrift.export_ros(calibration)
    >>> exported.text.splitlines()[0]
    '# accel = accel_matrix (raw - accel_offset), m/s2'
    """
    pair = pair_at(calibration, temp_c)
    lines = [
        "# accel = accel_matrix (raw - accel_offset), m/s2",
        "# gyro = gyro_matrix (raw - gyro_offset) - gyro_g_sensitivity accel, rad/s",
        "# covariances of sensor_msgs/Imu: NAME_covariance + NAME_covariance_per_hz x sampling rate in Hz; rates at rest",
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
    noise = calibration.noise
    if noise is not None:
        densities = {
            "gyroscope_noise_density": noise.angle_random_walk,
            "gyroscope_random_walk": noise.rate_random_walk,
            "accelerometer_noise_density": noise.velocity_random_walk,
            "accelerometer_random_walk": noise.accel_random_walk,
        }
        known = {name: float(np.nanmax(axes)) for name, axes in densities.items() if np.isfinite(axes).any()}
        lines += [f"    {name}: {number(worst)}" for name, worst in known.items()]
    lines += _covariances(calibration)
    notes = (*pair.notes, finding("export.keys_of_node", "info"))
    return Exported(text="\n".join(lines) + "\n", **texts_of(losses(calibration, CARRIED_ROS), notes))


def _covariances(calibration: Calibration) -> Iterator[str]:
    """Yield those of sensor_msgs/Imu, nine elements each: of the calibration, and of white noise for each Hz of sampling.

    ::

        angular_velocity        M C_oo M^T                                                      at rest
        linear_acceleration     M C_oo M^T + sum_kl C(m_ik, m_jl) (g^2 / 3) (K K^T)_kl          K = M^-1, mean over all poses
        for each Hz             diag(N^2)                                                       N, unit/sqrt(Hz)
    """
    noise = calibration.noise
    densities = (None, None) if noise is None else (noise.angle_random_walk, noise.velocity_random_walk)
    for triad, name, density in zip(
        calibration.triads, ("angular_velocity", "linear_acceleration"), densities, strict=True
    ):
        model = triad.model
        if model is None:
            continue
        at = [model.parameters.index(one) for one in (*MATRIX_NAMES, *OFFSET_NAMES)]
        held = model.covariance[np.ix_(at, at)]
        felt = STANDARD_GRAVITY / triad.si if triad.quantity == "accel" else 0.0
        inverse = np.linalg.inv(model.matrix)
        rows = held[:9, :9].reshape(3, 3, 3, 3)  # C(m_ik, m_jl)
        whole = model.matrix @ held[9:, 9:] @ model.matrix.T
        whole = triad.si**2 * (whole + np.einsum("ikjl,kl->ij", rows, felt**2 / 3.0 * inverse @ inverse.T))
        if np.isfinite(whole).all():  # an imported calibration states none
            yield _list(f"{name}_covariance", whole)
        if density is not None and np.isfinite(density).all():
            yield _list(f"{name}_covariance_per_hz", np.diag(density**2))


KALIBR = (
    ("accelerometer_noise_density", "accel", "angle_random_walk", "m/s^2/sqrt(Hz)"),
    ("accelerometer_random_walk", "accel", "rate_random_walk", "m/s^3/sqrt(Hz)"),
    ("gyroscope_noise_density", "gyro", "angle_random_walk", "rad/s/sqrt(Hz)"),
    ("gyroscope_random_walk", "gyro", "rate_random_walk", "rad/s^2/sqrt(Hz)"),
)


def kalibr_text(found: NoiseFit, *, update_rate_hz: float, rostopic: str) -> tuple[str, tuple[Finding, ...]]:
    """Return Kalibr's imu.yaml: the worst axis, and the upper limit where the record does not show a term, with a finding."""
    for triad, unit, si in (("gyro", found.gyro_unit, "rad/s"), ("accel", found.accel_unit, "m/s2")):
        if not getattr(found, triad) or not is_physical(unit):
            got = unit if getattr(found, triad) else "none"
            raise InputError(
                f"imu.yaml: wanted {triad} readings in {si}, got {got}; Kalibr needs both sensors: correct the recording with its "
                "calibration first"
            )
    lines, findings = [], []
    for key, triad, name, unit in KALIBR:
        terms = [getattr(axis, name) for axis in getattr(found, triad)]
        unseen = any(np.isnan(term.value) for term in terms)
        worst = max(term.interval[1] if np.isnan(term.value) else term.value for term in terms)
        if unseen:
            findings.append(finding("export.kalibr_limit", "warn", key=key, value=worst, unit=unit))
        lines.append(f"{key}: {number(worst)}  # {unit}, {'upper limit' if unseen else 'worst axis'}")
    lines += [f"rostopic: {json.dumps(rostopic)}", f"update_rate: {number(update_rate_hz)}  # Hz"]
    return "\n".join(lines) + "\n", tuple(findings)


def number(x: float) -> str:
    """Return a number that every YAML reader takes for one: with a point, also before an exponent."""
    return re.sub(r"^(-?\d+)(e|$)", r"\1.0\2", repr(float(x)))


def _list(name: str, values: FloatArray) -> str:
    """Return a flat list, since ROS 2 takes no other."""
    return f"    {name}: [{', '.join(number(float(v)) for v in np.ravel(values))}]"


# ---- Targets of ``undrift export``

FUSION = Target(endings=(".h",), write=lambda model, options, _: export_fusion(model, temp_c=options.temp_c))
IMUCAL = Target(endings=(".json",), write=lambda model, options, _: export_imucal(model, temp_c=options.temp_c))
ROS = Target(endings=(".yaml", ".yml"), write=lambda model, options, _: export_ros(model, temp_c=options.temp_c))
UNDRIFT = Target(
    endings=(".json",),
    write=lambda model, _, name: Exported(text=calibration_text(model, name), not_carried=()),
)
