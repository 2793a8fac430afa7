"""Parameters of PX4: thermal cubics about a reference temperature of their own, and static terms.

    corrected gyro  = raw - (X0 + X1 (T - TREF) + X2 (T - TREF)^2 + X3 (T - TREF)^3) - OFF
    corrected accel = (raw - (the same) - OFF) SCALE

with T held to TMIN..TMAX; gyroscopes in rad/s, accelerometers in m/s2. The constant is in X0 where there is a cubic, else in
OFF, never in both. PX4 once listed the coefficients of a published set from the cubic down; here X0 is the constant, as in its
parameter reference.
"""

import numpy as np

from undrift.calibration.model import Calibration
from undrift.export.cubic import AutopilotSettings, Cubic, Imported, autopilot_model
from undrift.export.losses import Part, losses
from undrift.export.parameters import Parameters, parameter, read_parameters
from undrift.export.value import Exported

CARRIED: frozenset[Part] = frozenset(("static", "accel gain"))
REAL, INTEGER = 9, 6  # types of the parameter file
FILE = "px4 parameters"
AXES = ("X", "Y", "Z")


def export_px4(calibration: Calibration, settings: AutopilotSettings = AutopilotSettings()) -> Exported:
    """Return a parameter file for PX4, as QGroundControl loads it.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    settings : AutopilotSettings
        Which sensor; nominal gains for counts and volts.

    Returns
    -------
    Exported
        Lines of vehicle, component, name, value, type.

    Raises
    ------
    InputError
        As for ``autopilot_model``.
    """
    model = autopilot_model(calibration, settings)
    n, lines = settings.sensor, ["# Vehicle-Id Component-Id Name Value Type"]
    for letter, group, cubic, table in (
        ("G", "GYRO", model.gyro, model.gyro_table),
        ("A", "ACC", model.accel, model.accel_table),
    ):
        if cubic is None:
            continue
        lines.append(_line(f"TC_{letter}_ENABLE", int(table)))
        offset = np.zeros(3) if table else cubic.coefficients[0]
        if table:
            lines += _thermal(f"TC_{letter}{n}", cubic)
        lines += [_line(f"CAL_{group}{n}_{axis}OFF", float(v)) for axis, v in zip(AXES, offset, strict=True)]
    if model.accel is not None:
        gains = zip(AXES, model.accel_gain, strict=True)
        lines += [_line(f"CAL_ACC{n}_{axis}SCALE", float(v)) for axis, v in gains]
    notes = (
        *model.notes,
        f"set TC_G{n}_ID, TC_A{n}_ID, CAL_GYRO{n}_ID and CAL_ACC{n}_ID to the sensor's device id: no calibration knows it",
        "PX4 keeps parameters in single precision",
    )
    return Exported(text="\n".join(lines) + "\n", not_carried=losses(calibration, CARRIED), notes=notes)


def import_px4(text: str, *, sensor: int = 0) -> Imported:
    """Return what a PX4 parameter file says of one inertial sensor.

    Parameters
    ----------
    text : str
        The file.
    sensor : int
        Which sensor, from 0.

    Returns
    -------
    Imported
        Cubics where its thermal compensation is on, constants otherwise.

    Raises
    ------
    FileFormatError
        Lines that are no parameters, or a cubic without one of its own.
    """
    found = read_parameters(text, FILE)
    gain = [parameter(found, f"CAL_ACC{sensor}_{axis}SCALE", FILE, 1.0) for axis in AXES]
    return Imported(
        gyro=_cubic(found, "G", "GYRO", sensor), accel=_cubic(found, "A", "ACC", sensor), accel_gain=np.array(gain)
    )


def _thermal(prefix: str, cubic: Cubic) -> list[str]:
    lines = [
        _line(f"{prefix}_X{power}_{axis}", float(cubic.coefficients[power, axis]))
        for power in range(4)
        for axis in range(3)
    ]
    ranges = (("TREF", cubic.reference_c), ("TMIN", cubic.low_c), ("TMAX", cubic.high_c))
    return lines + [_line(f"{prefix}_{name}", value) for name, value in ranges]


def _line(name: str, value: float) -> str:
    return f"1\t1\t{name}\t{value!r}\t{INTEGER if isinstance(value, int) else REAL}"


def _cubic(found: Parameters, letter: str, group: str, sensor: int) -> Cubic | None:
    offset = np.array([parameter(found, f"CAL_{group}{sensor}_{axis}OFF", FILE, 0.0) for axis in AXES])
    powers = np.zeros((4, 3))
    prefix = f"TC_{letter}{sensor}"
    has_cubic = any(name.startswith(f"{prefix}_") for name, _ in found)
    if has_cubic and parameter(found, f"TC_{letter}_ENABLE", FILE, 0.0) == 1.0:
        for power in range(4):
            powers[power] = [parameter(found, f"{prefix}_X{power}_{axis}", FILE) for axis in range(3)]
        reference, low, high = (parameter(found, f"{prefix}_{name}", FILE) for name in ("TREF", "TMIN", "TMAX"))
    elif any(name.startswith(f"CAL_{group}{sensor}_") for name, _ in found):
        reference, low, high = 25.0, 25.0, 25.0
    else:
        return None
    powers[0] += offset
    return Cubic(reference_c=reference, coefficients=powers, low_c=low, high_c=high, misfit=np.full(3, np.nan))
