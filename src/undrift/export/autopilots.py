"""Parameters of PX4 and ArduPilot: offsets over temperature as cubics, and static terms.

Both hold T to TMIN..TMAX; gyroscopes in rad/s, accelerometers in m/s2, from readings that a driver has made physical with its data
sheet's gain alone: offset[SI] = nominal * offset[raw]. PX4, about a reference temperature TREF of its own::

    gyro  = raw - (X0 + X1 (T - TREF) + X2 (T - TREF)^2 + X3 (T - TREF)^3) - OFF
    accel = (raw - (the same) - OFF) SCALE

The constant is in X0 where there is a cubic, else in OFF, never in both. PX4 once listed the coefficients of a published set from
the cubic down; here X0 is the constant, as in its parameter reference. ArduPilot, about 35 degC, a millionth as unit::

    gyro  = raw - (P(T) - P(CALTEMP)) - OFFS
    accel = (raw - (P(T) - P(CALTEMP)) - OFFS) SCAL
    P(T) = 1e-6 (c1 (T - 35) + c2 (T - 35)^2 + c3 (T - 35)^3)

The constant has no place among the thermal coefficients: the offset at CALTEMP, OFFS, stands for it.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray, frozen
from undrift.correction.plan import Constants, constants_of
from undrift.errors import InputError
from undrift.export import ExportOptions, Target
from undrift.export.losses import Exported, Part, losses, texts_of
from undrift.export.programs import ConstantPair, pair_at
from undrift.findings import Finding, finding
from undrift.model import NO_TABLES, Calibration
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, Quantity, is_physical, si_factor

CARRIED: frozenset[Part] = frozenset(("static", "accel gain"))
AXES = ("X", "Y", "Z")
REFERENCE_OF_NO_TABLE_C = 25.0  # where a constant is written as a cubic and no reference temperature is known


# ---- Offsets over temperature as a cubic, fitted to the nodes of the static table that have data near them


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cubic:
    """c0 + c1 (T - R) + c2 (T - R)^2 + c3 (T - R)^3 for three axes, T held to [low, high]."""

    reference_c: float  # R
    coefficients: FloatArray  # (4, 3), c0 to c3 of each axis, SI per degC to the power
    low_c: float
    high_c: float
    misfit: FloatArray  # (3,), largest departure from the nodes that it was fitted to, SI
    table: bool = False  # True where the cubic stands for a table, not for a constant

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", frozen(self.coefficients, (4, 3), "cubic coefficients"))

    def at(self, temp_c: FloatArray) -> FloatArray:
        """Return the offset at each temperature, shape (N, 3)."""
        x = (np.clip(temp_c, self.low_c, self.high_c) - self.reference_c)[:, None]
        c0, c1, c2, c3 = self.coefficients
        value: FloatArray = c0 + x * (c1 + x * (c2 + x * c3))
        return value

    def about(self, reference_c: float) -> "Cubic":
        """Return the same curve about another reference temperature."""
        d = reference_c - self.reference_c
        c0, c1, c2, c3 = self.coefficients
        moved = np.array((c0 + d * (c1 + d * (c2 + d * c3)), c1 + d * (2.0 * c2 + d * 3.0 * c3), c2 + 3.0 * d * c3, c3))
        return replace(self, reference_c=reference_c, coefficients=moved)


def fit_cubic(temp_c: FloatArray, offset: FloatArray) -> Cubic:
    """Fit a cubic to the nodes (n,) of a table (n, 3) by least squares, about the middle of their range."""
    from numpy.polynomial import chebyshev

    low, high = float(temp_c[0]), float(temp_c[-1])
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    x = (temp_c - middle) / half
    fitted = chebyshev.chebfit(x, offset, min(3, len(temp_c) - 1))
    misfit = np.abs(chebyshev.chebval(x, fitted).T - offset).max(axis=0)
    powers = np.zeros((4, 3))
    for axis in range(3):
        column = chebyshev.cheb2poly(fitted[:, axis])
        powers[: len(column), axis] = column / half ** np.arange(len(column))
    return Cubic(reference_c=middle, coefficients=powers, low_c=low, high_c=high, misfit=misfit, table=True)


# ---- A calibration in an autopilot's form


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AutopilotModel:
    """A calibration in an autopilot's form."""

    gyro: Cubic | None  # None without a model
    accel: Cubic | None
    accel_gain: FloatArray  # (3,), diagonal of the accelerometers' matrix over the nominal gain
    notes: tuple[Finding, ...]  # Misfits, and what was frozen


def autopilot_model(calibration: Calibration, options: ExportOptions) -> AutopilotModel:
    """Return a calibration in an autopilot's form."""
    if not 0 <= options.sensor <= 2:
        raise InputError(f"export: wanted sensor 0, 1 or 2 of the autopilot, got {options.sensor}; choose one")
    drift = calibration.drift or NO_TABLES
    static, temp = drift.static, options.temp_c
    if temp is None and drift.scale is None and static is not None:
        temp = float(static.temp_c.mean())  # the cubics hold the offsets of every temperature: nothing is frozen here
    pair = pair_at(calibration, temp)
    made: dict[str, Cubic | None] = {"gyro": None, "accel": None}
    gain: FloatArray = np.ones(3)
    # of all that is read at one temperature a target carries the accelerometers' gains alone
    frozen_gains = pair.accel is not None and drift.scale is not None and drift.scale.accel_matrix is not None
    notes = list(pair.notes) if frozen_gains else []
    sides: tuple[tuple[str, Constants | None, Quantity, float | None], ...] = (
        ("gyro", pair.gyro, "rate", options.gyro_dps_per_unit),
        ("accel", pair.accel, "accel", options.accel_g_per_unit),
    )
    for name, triad, quantity, stated in sides:
        if triad is None:
            continue
        nominal = _nominal(triad, quantity, stated)
        made[name] = cubic = _offsets(calibration, pair, triad, nominal)
        if name == "accel":
            gain = np.diag(triad.matrix) / nominal
        if cubic.table:
            whose, unit, shown = ("gyroscopes'", "dps", "deg/s") if name == "gyro" else ("accelerometers'", "mg", "mg")
            misfit = cubic.misfit / si_factor(unit, quantity)
            notes.append(finding("export.misfit", "info", triad=whose, misfit=misfit, unit=shown))
    return AutopilotModel(**made, accel_gain=gain, notes=tuple(notes))


def _nominal(triad: Constants, quantity: Quantity, stated: float | None) -> float:
    if is_physical(triad.unit_in):
        return si_factor(triad.unit_in, quantity)
    if stated is None or not np.isfinite(stated) or stated <= 0.0:
        name = "gyro" if quantity == "rate" else "accel"
        option = "--gyro-dps-per-unit" if quantity == "rate" else "--accel-g-per-unit"
        raise InputError(
            f"export, {name}: wanted the gain that the autopilot's driver uses, since the calibration is for {triad.unit_in}, "
            f"got {'none' if stated is None else stated}; give the nominal gain: {option}"
        )
    return stated * (RADIAN_PER_DEGREE if quantity == "rate" else STANDARD_GRAVITY)


def _offsets(calibration: Calibration, pair: ConstantPair, triad: Constants, nominal: float) -> Cubic:
    table, fitted = constants_of(calibration, triad.name).offset_table, calibration.triad(triad.name).offsets
    if table is None or fitted is None:
        reference = pair.temp_c if np.isfinite(pair.temp_c) else REFERENCE_OF_NO_TABLE_C
        powers = np.zeros((4, 3))
        powers[0] = triad.offset * nominal
        return Cubic(reference_c=reference, coefficients=powers, low_c=reference, high_c=reference, misfit=np.zeros(3))
    marks = fitted.extrapolated
    seen = np.ones(len(fitted.temp_c), bool) if marks is None or (~marks).sum() < 2 else ~marks
    return fit_cubic(fitted.temp_c[seen], table.values[seen] * nominal)


# ---- ArduPilot

REFERENCE_C = 35.0
UNIT = 1e-6


def export_ardupilot(calibration: Calibration, options: ExportOptions = ExportOptions()) -> Exported:
    """Return a parameter file for ArduPilot.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    options : ExportOptions
        Which sensor; nominal gains for counts and volts.

    Returns
    -------
    Exported
        Lines of name,value.

    Raises
    ------
    InputError
        A sensor that no autopilot has, tables without a temperature to read them at, counts or volts without a nominal gain.
    """
    model = autopilot_model(calibration, options)
    n, number = options.sensor + 1, "" if options.sensor == 0 else str(options.sensor + 1)
    triads = [(group, cubic) for group, cubic in (("ACC", model.accel), ("GYR", model.gyro)) if cubic is not None]
    tables = [cubic for _, cubic in triads if cubic.table]
    values: dict[str, float] = {f"INS_TCAL{n}_ENABLE": int(bool(tables))}
    notes = list(model.notes)
    low, high = max((c.low_c for c in tables), default=0.0), min((c.high_c for c in tables), default=0.0)
    if tables:
        values |= {f"INS_TCAL{n}_TMIN": low, f"INS_TCAL{n}_TMAX": high}
    for group, cubic in triads:
        about, at = cubic.about(REFERENCE_C), cubic.reference_c  # the middle of the table
        if tables:
            known = np.isfinite(calibration.reference_temp_c)
            at = float(np.clip(calibration.reference_temp_c if known else at, low, high))
            values |= {
                f"INS_TCAL{n}_{group}{power}_{axis}": float(about.coefficients[power, k]) / UNIT
                for power in (1, 2, 3)
                for k, axis in enumerate(AXES)
            }
        values[f"INS_{group}{n}_CALTEMP"] = at
        values |= _by_axis(f"INS_{group}{number}OFFS_{{}}", cubic.at(np.array([at]))[0])
        if group == "GYR" and cubic.table:
            dropped = about.coefficients[0] / RADIAN_PER_DEGREE
            place = f"INS_GYR{number}OFFS"
            notes.append(
                finding(
                    "export.constant_moved", "info", at_c=REFERENCE_C, offset_dps=dropped, parameter=place, temp_c=at
                )
            )
    if model.accel is not None:
        values |= _by_axis(f"INS_ACC{number}SCAL_{{}}", model.accel_gain)
    notes.append(finding("export.measured_anew", "info"))
    notes.append(finding("export.parameters_single", "info", program="ArduPilot"))
    text = "".join(f"{name},{value!r}\n" for name, value in values.items())
    return Exported(text=text, **texts_of(losses(calibration, CARRIED), notes))


def _by_axis(name: str, values: FloatArray) -> dict[str, float]:
    return {name.format(axis): float(v) for axis, v in zip(AXES, values, strict=True)}


# ---- PX4

REAL, INTEGER = 9, 6  # types of the parameter file


def export_px4(calibration: Calibration, options: ExportOptions = ExportOptions()) -> Exported:
    """Return a parameter file for PX4, as QGroundControl loads it.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    options : ExportOptions
        Which sensor; nominal gains for counts and volts.

    Returns
    -------
    Exported
        Lines of vehicle, component, name, value, type.

    Raises
    ------
    InputError
        A sensor that no autopilot has, tables without a temperature to read them at, counts or volts without a nominal gain.
    """
    model = autopilot_model(calibration, options)
    n, values = options.sensor, dict[str, float]()
    for letter, group, cubic in (("G", "GYRO", model.gyro), ("A", "ACC", model.accel)):
        if cubic is None:
            continue
        values[f"TC_{letter}_ENABLE"] = int(cubic.table)
        if cubic.table:
            values |= {
                f"TC_{letter}{n}_X{power}_{axis}": float(cubic.coefficients[power, axis])
                for power in range(4)
                for axis in range(3)
            }
            ends = (("TREF", cubic.reference_c), ("TMIN", cubic.low_c), ("TMAX", cubic.high_c))
            values |= {f"TC_{letter}{n}_{name}": value for name, value in ends}
        values |= _by_axis(f"CAL_{group}{n}_{{}}OFF", np.zeros(3) if cubic.table else cubic.coefficients[0])
    if model.accel is not None:
        values |= _by_axis(f"CAL_ACC{n}_{{}}SCALE", model.accel_gain)
    rows = [f"1\t1\t{k}\t{v!r}\t{INTEGER if isinstance(v, int) else REAL}\n" for k, v in values.items()]
    notes = [*model.notes, finding("export.device_ids", "info", sensor=n)]
    notes.append(finding("export.parameters_single", "info", program="PX4"))
    text = "# Vehicle-Id Component-Id Name Value Type\n" + "".join(rows)
    return Exported(text=text, **texts_of(losses(calibration, CARRIED), notes))


# ---- Targets of ``undrift export``


PX4 = Target(endings=(".params", ".param"), write=lambda model, options, _: export_px4(model, options))
ARDUPILOT = Target(
    endings=(".param", ".parm", ".params"), write=lambda model, options, _: export_ardupilot(model, options)
)
