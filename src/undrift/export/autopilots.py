"""Parameters of PX4: thermal cubics about a reference temperature of their own, and static terms.

    corrected gyro  = raw - (X0 + X1 (T - TREF) + X2 (T - TREF)^2 + X3 (T - TREF)^3) - OFF
    corrected accel = (raw - (the same) - OFF) SCALE

with T held to TMIN..TMAX; gyroscopes in rad/s, accelerometers in m/s2. The constant is in X0 where there is a cubic, else in
OFF, never in both. PX4 once listed the coefficients of a published set from the cubic down; here X0 is the constant, as in its
parameter reference.

Parameters of ArduPilot: thermal cubics about 35 degC, a millionth as unit, without a constant, and static terms.

    corrected gyro  = raw - (P(T) - P(CALTEMP)) - OFFS
    corrected accel = (raw - (P(T) - P(CALTEMP)) - OFFS) SCAL
    P(T) = 1e-6 (c1 (T - 35) + c2 (T - 35)^2 + c3 (T - 35)^3)

with T held to TMIN..TMAX; gyroscopes in rad/s, accelerometers in m/s2. The constant of the cubic has no place among the thermal
coefficients: the offset at CALTEMP, OFFS, stands for it.

Offsets over temperature as cubics, the form that autopilots take::

    offset(T) = c0 + c1 (T - R) + c2 (T - R)^2 + c3 (T - R)^3        T held to [low, high]

in SI units of readings that a driver has made physical with its data sheet's gain alone: offset[SI] = nominal * offset[raw].
A cubic is fitted to the nodes of the static table that have data near them, all alike, by least squares.
"""

import math
import re
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, frozen
from undrift.errors import FileFormatError, InputError
from undrift.export.firmware import rounding_of
from undrift.export.losses import Exported, Part, losses
from undrift.export.programs import Constant, ConstantPair, constants_of
from undrift.model import Calibration, DriftTables, StaticDrift
from undrift.units import RADIAN_PER_DEGREE, Quantity, is_physical, si_factor

# ---- Offsets over temperature as cubics, the form that autopilots take::

REFERENCE_OF_NO_TABLE_C = 25.0  # where a constant is written as a cubic and no reference temperature is known


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotSettings:
    """What an autopilot's parameters need besides the calibration."""

    sensor: int = 0  # Which inertial sensor of the autopilot, from 0
    # rad/s and m/s2 that the autopilot's driver makes of one raw unit; needed for counts and volts only
    gyro_nominal: float | None = None
    # rad/s and m/s2 that the autopilot's driver makes of one raw unit; needed for counts and volts only
    accel_nominal: float | None = None
    # Where tables that cannot be carried are read, degC; None for the reference temperature
    temp_c: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cubic:
    """A cubic over temperature for three axes."""

    reference_c: float  # R, degC
    coefficients: FloatArray  # (4, 3), c0 to c3 of each axis, SI per degC to the power
    low_c: float  # Where it holds, degC
    high_c: float  # Where it holds, degC
    misfit: FloatArray  # (3,), largest departure from the nodes that it was fitted to, SI

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", frozen(self.coefficients, (4, 3), "cubic coefficients"))

    def at(self, temp_c: FloatArray) -> FloatArray:
        """Return the offset at each temperature.

        Arrays: temp_c (N,) degC -> (N, 3).
        """
        x = (np.clip(temp_c, self.low_c, self.high_c) - self.reference_c)[:, None]
        c0, c1, c2, c3 = self.coefficients
        value: FloatArray = c0 + x * (c1 + x * (c2 + x * c3))
        return value

    def about(self, reference_c: float) -> "Cubic":
        """Return the same curve about another reference temperature."""
        d = reference_c - self.reference_c
        c0, c1, c2, c3 = self.coefficients
        moved = (c0 + d * (c1 + d * (c2 + d * c3)), c1 + d * (2.0 * c2 + d * 3.0 * c3), c2 + 3.0 * d * c3, c3)
        return Cubic(
            reference_c=reference_c,
            coefficients=np.array(moved),
            low_c=self.low_c,
            high_c=self.high_c,
            misfit=self.misfit,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Imported:
    """What an autopilot's parameters say of one inertial sensor."""

    gyro: Cubic | None  # Offsets over temperature, rad/s and m/s2; None where the parameters have none
    accel: Cubic | None  # Offsets over temperature, rad/s and m/s2; None where the parameters have none
    accel_gain: FloatArray  # (3,), gain of each accelerometer

    def static(self, temp_c: FloatArray) -> StaticDrift:
        """Return the curves as a static table for readings in rad/s and m/s2.

        Arrays: temp_c (n,) degC.
        """
        return StaticDrift(
            temp_c=temp_c,
            gyro_offset=None if self.gyro is None else self.gyro.at(temp_c),
            accel_offset=None if self.accel is None else self.accel.at(temp_c),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AutopilotModel:
    """A calibration in an autopilot's form."""

    gyro: Cubic | None  # Offsets over temperature; None without a model
    accel: Cubic | None  # Offsets over temperature; None without a model
    gyro_table: bool  # True where the cubic stands for a table, not for a constant
    accel_table: bool  # True where the cubic stands for a table, not for a constant
    accel_gain: FloatArray  # (3,), diagonal of the accelerometers' matrix over the nominal gain
    notes: tuple[str, ...]  # Misfits, and what was frozen


def autopilot_model(calibration: Calibration, settings: AutopilotSettings) -> AutopilotModel:
    """Return a calibration in an autopilot's form."""
    if not 0 <= settings.sensor <= 2:
        raise InputError(f"export: wanted sensor 0, 1 or 2 of the autopilot, got {settings.sensor}; choose one")
    drift = calibration.drift or DriftTables()
    static, temp = drift.static, settings.temp_c
    if temp is None and drift.scale is None and static is not None:
        temp = float(static.temp_c.mean())  # the cubics hold the offsets of every temperature: nothing is frozen here
    pair = constants_of(calibration, temp)
    gyro = accel = None
    has_gyro = static is not None and static.gyro_offset is not None
    has_accel = static is not None and static.accel_offset is not None
    gain: FloatArray = np.ones(3)
    if pair.gyro is not None:
        nominal = _nominal(pair.gyro, "rate", settings.gyro_nominal)
        gyro = _cubic_cubic(calibration, pair, pair.gyro, "gyro", nominal)
    if pair.accel is not None:
        nominal = _nominal(pair.accel, "accel", settings.accel_nominal)
        accel = _cubic_cubic(calibration, pair, pair.accel, "accel", nominal)
        gain = np.diag(pair.accel.matrix) / nominal
    frozen = accel is not None and drift.scale is not None and drift.scale.accel_matrix is not None
    notes = (
        list(pair.notes) if frozen else []
    )  # of all that is read at one temperature a target carries these gains alone
    if gyro is not None and has_gyro:
        worst = gyro.misfit / RADIAN_PER_DEGREE
        notes.append(f"the cubics depart from the gyroscopes' table by up to {_three(worst)} deg/s, x / y / z")
    if accel is not None and has_accel:
        worst = accel.misfit / si_factor("mg", "accel")
        notes.append(f"the cubics depart from the accelerometers' table by up to {_three(worst)} mg, x / y / z")
    return AutopilotModel(
        gyro=gyro, accel=accel, gyro_table=has_gyro, accel_table=has_accel, accel_gain=gain, notes=tuple(notes)
    )


def fit_cubic(temp_c: FloatArray, offset: FloatArray) -> Cubic:
    """Fit a cubic to the nodes of a table by least squares, about the middle of their range.

    Arrays: temp_c (n,) degC, offset (n, 3).
    """
    from numpy.polynomial import chebyshev

    low, high = float(temp_c[0]), float(temp_c[-1])
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    x = (temp_c - middle) / half
    degree = min(3, len(temp_c) - 1)
    fitted = chebyshev.chebfit(x, offset, degree)
    misfit = np.abs(chebyshev.chebval(x, fitted).T - offset).max(axis=0)
    powers = np.zeros((4, 3))
    for axis in range(3):
        column = chebyshev.cheb2poly(fitted[:, axis])
        powers[: len(column), axis] = column / half ** np.arange(len(column))
    return Cubic(reference_c=middle, coefficients=powers, low_c=low, high_c=high, misfit=misfit)


def _three(values: FloatArray) -> str:
    return " / ".join(f"{v:.2g}" for v in values)


def _nominal(triad: Constant, quantity: Quantity, stated: float | None) -> float:
    if is_physical(triad.unit_in):
        return si_factor(triad.unit_in, quantity)
    if stated is None or not np.isfinite(stated) or stated <= 0.0:
        name = "gyro" if quantity == "rate" else "accel"
        option = "--gyro-dps-per-unit" if quantity == "rate" else "--accel-g-per-unit"
        raise InputError(
            f"export, {name}: wanted the gain that the autopilot's driver uses, since the calibration is for {triad.unit_in}, "
            f"got {'none' if stated is None else stated}; give the nominal gain: {option}"
        )
    return stated


def _cubic_cubic(calibration: Calibration, pair: ConstantPair, triad: Constant, name: str, nominal: float) -> Cubic:
    static = calibration.drift.static if calibration.drift else None
    offset = None if static is None else static.gyro_offset if name == "gyro" else static.accel_offset
    if static is None or offset is None:
        reference = pair.temp_c if np.isfinite(pair.temp_c) else REFERENCE_OF_NO_TABLE_C
        powers = np.zeros((4, 3))
        powers[0] = triad.offset * nominal
        return Cubic(reference_c=reference, coefficients=powers, low_c=reference, high_c=reference, misfit=np.zeros(3))
    marks = static.gyro_extrapolated if name == "gyro" else static.accel_extrapolated
    seen = np.ones(len(static.temp_c), bool) if marks is None or (~marks).sum() < 2 else ~marks
    _, shift = rounding_of(calibration, is_gyro=name == "gyro")
    return fit_cubic(static.temp_c[seen], (offset[seen] - shift) * nominal)


# ---- Parameter files of autopilots: names and numbers, one a line.

Parameters = tuple[tuple[str, float], ...]


def read_parameters(text: str, what: str) -> Parameters:
    """Return the parameters in a file of QGroundControl or ArduPilot."""
    found: list[tuple[str, float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = re.split(r"[\s,]+", line.split("#")[0].strip())
        if words == [""]:
            continue
        name, value = (words[2], words[3]) if len(words) == 5 else (words[0], words[1]) if len(words) == 2 else ("", "")
        try:
            figure = float(value)
        except ValueError:
            figure = math.nan
        if not name or not math.isfinite(figure):
            raise FileFormatError(f"{what}: wanted a name and a number, got {line[:80]!r} in line {number}; repair it")
        if any(name == known for known, _ in found):
            raise FileFormatError(f"{what}: wanted each parameter once, got {name} again in line {number}; remove one")
        found.append((name, figure))
    return tuple(found)


def parameter(parameters: Parameters, name: str, what: str, default: float | None = None) -> float:
    """Return a parameter's value."""
    for known, value in parameters:
        if known == name:
            return value
    if default is None:
        raise FileFormatError(f"{what}: wanted the parameter {name}, got none of that name; save all parameters")
    return default


# ---- Parameters of ArduPilot: thermal cubics about 35 degC, a millionth as unit, without a constant, and static terms.

REFERENCE_C = 35.0
UNIT = 1e-6
CARRIED: frozenset[Part] = frozenset(("static", "accel gain"))
FILE_ARDUPILOT = "ardupilot parameters"
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
    lines, notes = [_line_ardupilot(f"INS_TCAL{n}_ENABLE", int(bool(tables)))], list(model.notes)
    low, high = max((c.low_c for c in tables), default=0.0), min((c.high_c for c in tables), default=0.0)
    if tables:
        lines += [_line_ardupilot(f"INS_TCAL{n}_TMIN", low), _line_ardupilot(f"INS_TCAL{n}_TMAX", high)]
    for group, cubic, table in (("ACC", model.accel, model.accel_table), ("GYR", model.gyro, model.gyro_table)):
        if cubic is None:
            continue
        about = cubic.about(REFERENCE_C)
        at = float(np.clip(_calibration_temperature(calibration, cubic), low, high)) if tables else cubic.reference_c
        if tables:
            lines += [
                _line_ardupilot(f"INS_TCAL{n}_{group}{power}_{axis}", float(about.coefficients[power, k]) / UNIT)
                for power in (1, 2, 3)
                for k, axis in enumerate(AXES)
            ]
        offset = cubic.at(np.array([at]))[0]
        lines.append(_line_ardupilot(f"INS_{group}{n}_CALTEMP", at))
        lines += [
            _line_ardupilot(f"INS_{group}{number}OFFS_{axis}", float(v)) for axis, v in zip(AXES, offset, strict=True)
        ]
        if group == "GYR" and table:
            dropped = " / ".join(f"{v / RADIAN_PER_DEGREE:.6g}" for v in about.coefficients[0])
            notes.append(f"the gyroscopes' constants at {REFERENCE_C:g} degC, {dropped} deg/s, have no place in the cubic: "
                         f"INS_GYR{number}OFFS holds the offset at {at:g} degC instead")  # fmt: skip
    if model.accel is not None:
        lines += [
            _line_ardupilot(f"INS_ACC{number}SCAL_{axis}", float(v))
            for axis, v in zip(AXES, model.accel_gain, strict=True)
        ]
    notes += ["ArduPilot measures INS_GYROFFS anew at every start unless INS_GYR_CAL is 0",
              "ArduPilot keeps parameters in single precision"]  # fmt: skip
    return Exported(text="\n".join(lines) + "\n", not_carried=losses(calibration, CARRIED), notes=tuple(notes))


def import_ardupilot(text: str, *, sensor: int = 0) -> Imported:
    """Return what an ArduPilot parameter file says of one inertial sensor."""
    found = read_parameters(text, FILE_ARDUPILOT)
    number = "" if sensor == 0 else str(sensor + 1)
    gain = [parameter(found, f"INS_ACC{number}SCAL_{axis}", FILE_ARDUPILOT, 1.0) for axis in AXES]
    return Imported(
        gyro=_cubic_ardupilot(found, "GYR", sensor),
        accel=_cubic_ardupilot(found, "ACC", sensor),
        accel_gain=np.array(gain),
    )


def _calibration_temperature(calibration: Calibration, cubic: Cubic) -> float:
    """The reference temperature, or the middle of the table where none is known."""
    reference = calibration.reference_temp_c
    return reference if np.isfinite(reference) else cubic.reference_c


def _line_ardupilot(name: str, value: float) -> str:
    return f"{name},{value!r}"


def _cubic_ardupilot(found: Parameters, group: str, sensor: int) -> Cubic | None:
    n, number = sensor + 1, "" if sensor == 0 else str(sensor + 1)
    names = [f"INS_{group}{number}OFFS_{axis}" for axis in AXES]
    offset = np.array([parameter(found, name, FILE_ARDUPILOT, 0.0) for name in names])
    powers, nothing = np.zeros((4, 3)), np.full(3, np.nan)
    if parameter(found, f"INS_TCAL{n}_ENABLE", FILE_ARDUPILOT, 0.0) != 1.0:
        if not any(name in names for name, _ in found):
            return None
        powers[0] = offset
        return Cubic(
            reference_c=REFERENCE_C, coefficients=powers, low_c=REFERENCE_C, high_c=REFERENCE_C, misfit=nothing
        )
    for power in (1, 2, 3):
        powers[power] = [parameter(found, f"INS_TCAL{n}_{group}{power}_{axis}", FILE_ARDUPILOT) * UNIT for axis in AXES]
    low, high = (
        parameter(found, f"INS_TCAL{n}_TMIN", FILE_ARDUPILOT),
        parameter(found, f"INS_TCAL{n}_TMAX", FILE_ARDUPILOT),
    )
    if not low < high:
        raise FileFormatError(
            f"{FILE_ARDUPILOT}: wanted INS_TCAL{n}_TMIN below TMAX, got {low:g} and {high:g}; repair the file"
        )
    bare = Cubic(reference_c=REFERENCE_C, coefficients=powers, low_c=low, high_c=high, misfit=nothing)
    at = parameter(found, f"INS_{group}{n}_CALTEMP", FILE_ARDUPILOT)
    powers = powers.copy()
    powers[0] = offset - bare.at(np.array([at]))[0]
    return Cubic(reference_c=REFERENCE_C, coefficients=powers, low_c=low, high_c=high, misfit=nothing)


# ---- autopilots

REAL, INTEGER = 9, 6  # types of the parameter file
FILE = "px4 parameters"


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
    """Return what a PX4 parameter file says of one inertial sensor."""
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
