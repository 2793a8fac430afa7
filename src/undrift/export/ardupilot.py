"""Parameters of ArduPilot: thermal cubics about 35 degC, a millionth as unit, without a constant, and static terms.

    corrected gyro  = raw - (P(T) - P(CALTEMP)) - OFFS
    corrected accel = (raw - (P(T) - P(CALTEMP)) - OFFS) SCAL
    P(T) = 1e-6 (c1 (T - 35) + c2 (T - 35)^2 + c3 (T - 35)^3)

with T held to TMIN..TMAX; gyroscopes in rad/s, accelerometers in m/s2. The constant of the cubic has no place among the thermal
coefficients: the offset at CALTEMP, OFFS, stands for it.
"""

import numpy as np

from undrift.calibration.model import Calibration
from undrift.errors import FileFormatError
from undrift.export.cubic import AutopilotSettings, Cubic, Imported, autopilot_model
from undrift.export.losses import Part, losses
from undrift.export.parameters import Parameters, parameter, read_parameters
from undrift.export.value import Exported
from undrift.units import RADIAN_PER_DEGREE

REFERENCE_C = 35.0
UNIT = 1e-6
CARRIED: frozenset[Part] = frozenset(("static", "accel gain"))
FILE = "ardupilot parameters"
AXES = ("X", "Y", "Z")


def export_ardupilot(calibration: Calibration, settings: AutopilotSettings = AutopilotSettings()) -> Exported:
    """Return a parameter file for ArduPilot.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    settings : AutopilotSettings
        Which sensor; nominal gains for counts and volts.

    Returns
    -------
    Exported
        Lines of name,value.

    Raises
    ------
    InputError
        As for ``autopilot_model``.
    """
    model = autopilot_model(calibration, settings)
    n, number = settings.sensor + 1, "" if settings.sensor == 0 else str(settings.sensor + 1)
    tables = [
        c for c, has in ((model.gyro, model.gyro_table), (model.accel, model.accel_table)) if has and c is not None
    ]
    lines, notes = [_line(f"INS_TCAL{n}_ENABLE", int(bool(tables)))], list(model.notes)
    low, high = max((c.low_c for c in tables), default=0.0), min((c.high_c for c in tables), default=0.0)
    if tables:
        lines += [_line(f"INS_TCAL{n}_TMIN", low), _line(f"INS_TCAL{n}_TMAX", high)]
    for group, cubic, table in (("ACC", model.accel, model.accel_table), ("GYR", model.gyro, model.gyro_table)):
        if cubic is None:
            continue
        about = cubic.about(REFERENCE_C)
        at = float(np.clip(_calibration_temperature(calibration, cubic), low, high)) if tables else cubic.reference_c
        if tables:
            lines += [
                _line(f"INS_TCAL{n}_{group}{power}_{axis}", float(about.coefficients[power, k]) / UNIT)
                for power in (1, 2, 3)
                for k, axis in enumerate(AXES)
            ]
        offset = cubic.at(np.array([at]))[0]
        lines.append(_line(f"INS_{group}{n}_CALTEMP", at))
        lines += [_line(f"INS_{group}{number}OFFS_{axis}", float(v)) for axis, v in zip(AXES, offset, strict=True)]
        if group == "GYR" and table:
            dropped = " / ".join(f"{v / RADIAN_PER_DEGREE:.6g}" for v in about.coefficients[0])
            notes.append(f"the gyroscopes' constants at {REFERENCE_C:g} degC, {dropped} deg/s, have no place in the cubic: "
                         f"INS_GYR{number}OFFS holds the offset at {at:g} degC instead")  # fmt: skip
    if model.accel is not None:
        lines += [
            _line(f"INS_ACC{number}SCAL_{axis}", float(v)) for axis, v in zip(AXES, model.accel_gain, strict=True)
        ]
    notes += ["ArduPilot measures INS_GYROFFS anew at every start unless INS_GYR_CAL is 0",
              "ArduPilot keeps parameters in single precision"]  # fmt: skip
    return Exported(text="\n".join(lines) + "\n", not_carried=losses(calibration, CARRIED), notes=tuple(notes))


def import_ardupilot(text: str, *, sensor: int = 0) -> Imported:
    """Return what an ArduPilot parameter file says of one inertial sensor.

    Parameters
    ----------
    text : str
        The file.
    sensor : int
        Which sensor, from 0.

    Returns
    -------
    Imported
        Cubics about 35 degC with the constant that makes them OFFS at CALTEMP; constants where compensation is off.

    Raises
    ------
    FileFormatError
        Lines that are no parameters, or a cubic without one of its own.
    """
    found = read_parameters(text, FILE)
    number = "" if sensor == 0 else str(sensor + 1)
    gain = [parameter(found, f"INS_ACC{number}SCAL_{axis}", FILE, 1.0) for axis in AXES]
    return Imported(gyro=_cubic(found, "GYR", sensor), accel=_cubic(found, "ACC", sensor), accel_gain=np.array(gain))


def _calibration_temperature(calibration: Calibration, cubic: Cubic) -> float:
    """The reference temperature, or the middle of the table where none is known."""
    reference = calibration.reference_temp_c
    return reference if np.isfinite(reference) else cubic.reference_c


def _line(name: str, value: float) -> str:
    return f"{name},{value!r}"


def _cubic(found: Parameters, group: str, sensor: int) -> Cubic | None:
    n, number = sensor + 1, "" if sensor == 0 else str(sensor + 1)
    names = [f"INS_{group}{number}OFFS_{axis}" for axis in AXES]
    offset = np.array([parameter(found, name, FILE, 0.0) for name in names])
    powers, nothing = np.zeros((4, 3)), np.full(3, np.nan)
    if parameter(found, f"INS_TCAL{n}_ENABLE", FILE, 0.0) != 1.0:
        if not any(name in names for name, _ in found):
            return None
        powers[0] = offset
        return Cubic(
            reference_c=REFERENCE_C, coefficients=powers, low_c=REFERENCE_C, high_c=REFERENCE_C, misfit=nothing
        )
    for power in (1, 2, 3):
        powers[power] = [parameter(found, f"INS_TCAL{n}_{group}{power}_{axis}", FILE) * UNIT for axis in AXES]
    low, high = parameter(found, f"INS_TCAL{n}_TMIN", FILE), parameter(found, f"INS_TCAL{n}_TMAX", FILE)
    if not low < high:
        raise FileFormatError(f"{FILE}: wanted INS_TCAL{n}_TMIN below TMAX, got {low:g} and {high:g}; repair the file")
    bare = Cubic(reference_c=REFERENCE_C, coefficients=powers, low_c=low, high_c=high, misfit=nothing)
    at = parameter(found, f"INS_{group}{n}_CALTEMP", FILE)
    powers = powers.copy()
    powers[0] = offset - bare.at(np.array([at]))[0]
    return Cubic(reference_c=REFERENCE_C, coefficients=powers, low_c=low, high_c=high, misfit=nothing)
