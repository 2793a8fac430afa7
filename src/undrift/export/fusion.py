"""Constants for Fusion of x-io: misalignment, sensitivity and offset of both triads, as C.

    calibrated = misalignment diag(sensitivity) (reading - offset)        gyroscopes deg/s, accelerometers g

so that misalignment diag(sensitivity) is the calibration's matrix: the sensitivities are the lengths of its columns, the
misalignment what is left, near the unit matrix and without a unit.
"""

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import Calibration
from undrift.export.constant import Constant, constants_of
from undrift.export.losses import Part, losses
from undrift.export.value import Exported
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

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

    Parameters
    ----------
    matrix : array, shape (3, 3)
        Result unit per raw unit.

    Returns
    -------
    misalignment : array, shape (3, 3)
        Columns of length 1.
    sensitivity : array, shape (3,)
        Result unit per raw unit, above 0.
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
