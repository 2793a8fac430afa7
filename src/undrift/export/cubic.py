"""Offsets over temperature as cubics, the form that autopilots take::

    offset(T) = c0 + c1 (T - R) + c2 (T - R)^2 + c3 (T - R)^3        T held to [low, high]

in SI units of readings that a driver has made physical with its data sheet's gain alone: offset[SI] = nominal * offset[raw].
A cubic is fitted to the nodes of the static table that have data near them, all alike, by least squares.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, frozen
from undrift.calibration.model import Calibration, DriftTables, StaticDrift
from undrift.errors import InputError
from undrift.export.constant import Constant, ConstantPair, constants_of
from undrift.export.firmware import rounding_of
from undrift.units import RADIAN_PER_DEGREE, Quantity, is_physical, si_factor

REFERENCE_OF_NO_TABLE_C = 25.0  # where a constant is written as a cubic and no reference temperature is known


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotSettings:
    """What an autopilot's parameters need besides the calibration.

    Parameters
    ----------
    sensor : int
        Which inertial sensor of the autopilot, from 0.
    gyro_nominal, accel_nominal : float or None
        rad/s and m/s2 that the autopilot's driver makes of one raw unit; needed for counts and volts only.
    temp_c : float or None
        Where tables that cannot be carried are read, degC; None for the reference temperature.
    """

    sensor: int = 0
    gyro_nominal: float | None = None
    accel_nominal: float | None = None
    temp_c: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cubic:
    """A cubic over temperature for three axes.

    Parameters
    ----------
    reference_c : float
        R, degC.
    coefficients : array, shape (4, 3)
        c0 to c3 of each axis, SI per degC to the power.
    low_c, high_c : float
        Where it holds, degC.
    misfit : array, shape (3,)
        Largest departure from the nodes that it was fitted to, SI.
    """

    reference_c: float
    coefficients: FloatArray
    low_c: float
    high_c: float
    misfit: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "coefficients", frozen(self.coefficients, (4, 3), "cubic coefficients"))

    def at(self, temp_c: FloatArray) -> FloatArray:
        """Return the offset at each temperature.

        Parameters
        ----------
        temp_c : array, shape (N,)
            degC; held to the range.

        Returns
        -------
        array, shape (N, 3)
            SI.
        """
        x = (np.clip(temp_c, self.low_c, self.high_c) - self.reference_c)[:, None]
        c0, c1, c2, c3 = self.coefficients
        value: FloatArray = c0 + x * (c1 + x * (c2 + x * c3))
        return value

    def about(self, reference_c: float) -> "Cubic":
        """Return the same curve about another reference temperature.

        Parameters
        ----------
        reference_c : float
            degC.

        Returns
        -------
        Cubic
            The same curve.
        """
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
    """What an autopilot's parameters say of one inertial sensor.

    Parameters
    ----------
    gyro, accel : Cubic or None
        Offsets over temperature, rad/s and m/s2; None where the parameters have none.
    accel_gain : array, shape (3,)
        Gain of each accelerometer.
    """

    gyro: Cubic | None
    accel: Cubic | None
    accel_gain: FloatArray

    def static(self, temp_c: FloatArray) -> StaticDrift:
        """Return the curves as a static table for readings in rad/s and m/s2.

        Parameters
        ----------
        temp_c : array, shape (n,)
            Nodes, degC, increasing.

        Returns
        -------
        StaticDrift
            Without uncertainties: the parameters have none.
        """
        return StaticDrift(
            temp_c=temp_c,
            gyro_offset=None if self.gyro is None else self.gyro.at(temp_c),
            accel_offset=None if self.accel is None else self.accel.at(temp_c),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AutopilotModel:
    """A calibration in an autopilot's form.

    Parameters
    ----------
    gyro, accel : Cubic or None
        Offsets over temperature; None without a model.
    gyro_table, accel_table : bool
        True where the cubic stands for a table, not for a constant.
    accel_gain : array, shape (3,)
        Diagonal of the accelerometers' matrix over the nominal gain.
    notes : tuple of str
        Misfits, and what was frozen.
    """

    gyro: Cubic | None
    accel: Cubic | None
    gyro_table: bool
    accel_table: bool
    accel_gain: FloatArray
    notes: tuple[str, ...]


def autopilot_model(calibration: Calibration, settings: AutopilotSettings) -> AutopilotModel:
    """Return a calibration in an autopilot's form.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    settings : AutopilotSettings
        Nominal gains for counts and volts.

    Returns
    -------
    AutopilotModel
        Cubics about the middle of their range, notes with their misfit.

    Raises
    ------
    InputError
        Counts or volts without a nominal gain; as for ``constants_of``.
    """
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
        gyro = _cubic(calibration, pair, pair.gyro, "gyro", nominal)
    if pair.accel is not None:
        nominal = _nominal(pair.accel, "accel", settings.accel_nominal)
        accel = _cubic(calibration, pair, pair.accel, "accel", nominal)
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

    Parameters
    ----------
    temp_c : array, shape (n,)
        Nodes, degC, increasing.
    offset : array, shape (n, 3)
        SI.

    Returns
    -------
    Cubic
        Of lower degree where there are fewer than four nodes.
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


def _cubic(calibration: Calibration, pair: ConstantPair, triad: Constant, name: str, nominal: float) -> Cubic:
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
