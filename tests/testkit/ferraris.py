"""A calibration in imucal's own file, by the equations of its documentation: a = (K_a R_a)^-1 (s_a - b_a), m/s^2;
w = (K_g R_g)^-1 (s_g - b_g - K_ga a), deg/s; K diagonal, rows of R of length 1."""

import json

import numpy as np

from undrift.model import Calibration
from undrift.units import RADIAN_PER_DEGREE

UNIT_NAMES = {"m/s2": "m/s^2", "dps": "deg/s", "count": "a.u.", "rad/s": "rad/s", "g": "g", "mg": "mg", "v": "V"}


def ferraris_text(made: Calibration) -> str:
    """Return a FerrarisCalibrationInfo of imucal, format 2.0.0, for a calibration without tables."""
    gyro, accel = made.gyro, made.accel
    forward_a = np.linalg.inv(accel.matrix)
    forward_g = np.linalg.inv(gyro.matrix / RADIAN_PER_DEGREE)
    gains_a, gains_g = (np.linalg.norm(forward, axis=1) for forward in (forward_a, forward_g))
    g = np.zeros((3, 3)) if gyro.g_sensitivity is None else gyro.g_sensitivity / RADIAN_PER_DEGREE
    content = {
        "acc_unit": "m/s^2", "gyr_unit": "deg/s",
        "from_acc_unit": UNIT_NAMES[accel.unit_in], "from_gyr_unit": UNIT_NAMES[gyro.unit_in], "comment": None,
        "K_a": np.diag(gains_a).tolist(), "R_a": (forward_a / gains_a[:, None]).tolist(), "b_a": accel.offset.tolist(),
        "K_g": np.diag(gains_g).tolist(), "R_g": (forward_g / gains_g[:, None]).tolist(),
        "K_ga": (forward_g @ g).tolist(), "b_g": gyro.offset.tolist(), "cal_type": "Ferraris", "_format_version": "2.0.0",
    }  # fmt: skip
    return json.dumps(content, indent=4) + "\n"
