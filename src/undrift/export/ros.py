"""Parameters of a ROS 2 node, YAML. There is no standard for an inertial sensor's calibration: these keys are documented here.

    gyro_matrix, gyro_offset, gyro_g_sensitivity, accel_matrix, accel_offset      row by row, SI per raw unit and raw unit::

        accel = accel_matrix (raw - accel_offset)        gyro = gyro_matrix (raw - gyro_offset) - gyro_g_sensitivity accel

    SM, bias                                             the accelerometer again, as imu_calib has it: SM raw - bias, m/s2
    gyroscope_noise_density, gyroscope_random_walk, accelerometer_noise_density, accelerometer_random_walk
                                                         noise under the names that Kalibr gave it: the largest of three axes

Lists are flat, since ROS 2 takes no other, and every number has a point, so that none is read as an integer or as text.
"""

import json
import re

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import Calibration
from undrift.export.constant import constants_of
from undrift.export.losses import Part, losses
from undrift.export.value import Exported

CARRIED: frozenset[Part] = frozenset(("gain", "cross", "accel gain", "accel cross", "g", "noise"))


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
    return Exported(text="\n".join(lines) + "\n", not_carried=losses(calibration, CARRIED), notes=notes)


def number(x: float) -> str:
    """Return a number that every YAML reader takes for one: with a point, also before an exponent.

    Parameters
    ----------
    x : float
        Finite.

    Returns
    -------
    str
        Reads back to the last bit.
    """
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
