"""What a virtual bench found, held against the hidden truth: the one place that may look at it."""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.model import DriftTables, TriadModel
from undrift.errors import InputError
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.study.bench_demo import BenchFit
from undrift.study.figure3 import ROOM_TEMP_C
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.trial import Trial

MATRIX_LIMIT = 3e-3  # half a bit of 12 is 1e-3 of gravity, and there are three axes
WARM_MATRIX_LIMIT = 6e-3  # fewer and shorter turns at each set-point
GYRO_LIMIT_DPS = (
    0.25  # hysteresis of this kind is up to 0.1, what is left of the warm-up 0.05, the wander of an hour the rest
)
ACCEL_LIMIT_MG = 5.0  # three bits of 12
STATIC_SHARE, FULL_SHARE = 0.5, 0.25  # of the error without tables


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """A figure and the limit that it is held to.

    Parameters
    ----------
    name : str
        What it is, with its unit.
    value, limit : float
        The figure, and the most that it may be.
    """

    name: str
    value: float
    limit: float

    @property
    def passed(self) -> bool:
        """True where the value does not exceed the limit."""
        return bool(self.value <= self.limit)


def bench_checks(fit: BenchFit, trials: tuple[Trial, ...], device: DeviceModel) -> tuple[Check, ...]:
    """Compare what was found with the hidden truth, and the errors of the trial with each other.

    Parameters
    ----------
    fit : BenchFit
        What was found.
    trials : tuple of Trial
        At each level: constant, static, static and dynamic.
    device : DeviceModel
        The hidden truth.

    Returns
    -------
    tuple of Check
        Matrices, offsets over temperature, matrix over temperature, pitch errors.

    Raises
    ------
    InputError
        Something to compare is missing.
    """
    truth = true_calibration(device, temp_c=ROOM_TEMP_C)
    matrices = tuple(
        Check(
            name=f"{name}: matrix against the hidden one, largest element (1)",
            value=_matrix_apart(one, other),
            limit=MATRIX_LIMIT,
        )
        for name, one, other in (
            ("accelerometers", fit.constant.accel, truth.accel),
            ("gyroscopes", fit.constant.gyro, truth.gyro),
        )
    )
    return (*matrices, *_table_checks(fit, device), *_pitch_checks(trials))


def board_temperature(device: DeviceModel, reading_c: FloatArray) -> FloatArray:
    """Return the temperature of the board where a settled thermometer gives a reading.

    Parameters
    ----------
    device : DeviceModel
        The hidden truth.
    reading_c : array, shape (n,)
        degC.

    Returns
    -------
    array, shape (n,)
        degC.
    """
    thermometer = device.thermometer
    felt = (reading_c - thermometer.trim_error_c + 25.0 * thermometer.slope_error) / (1.0 + thermometer.slope_error)
    board: FloatArray = felt - thermometer.self_heating_c
    return board


def _table_checks(fit: BenchFit, device: DeviceModel) -> tuple[Check, ...]:
    """Offsets and the gyroscopes' matrix over the temperatures that were measured."""
    tables, summary = fit.drift.calibration.drift, fit.drift.gyro_summary
    if tables is None or tables.static is None or summary is None:
        raise InputError("tables: wanted offsets over temperature, got none; run the thermal programme")
    nodes = tables.static.temp_c
    seen = (nodes >= summary.seen_c[0]) & (nodes <= summary.seen_c[1])
    true = true_tables(device, board_temperature(device, nodes[seen]), np.array([-1.0, 0.0, 1.0]))
    constant = fit.constant
    gyro = _offset_apart(constant.gyro, tables, true, seen) / RADIAN_PER_DEGREE
    accel = _offset_apart(constant.accel, tables, true, seen) / STANDARD_GRAVITY * 1e3
    checks = [
        Check(name="gyroscopes: offset over temperature, largest error (deg/s)", value=gyro, limit=GYRO_LIMIT_DPS),
        Check(name="accelerometers: offset over temperature, largest error (mg)", value=accel, limit=ACCEL_LIMIT_MG),
    ]
    if tables.scale is not None and tables.scale.gyro_matrix is not None and true.scale is not None:
        hidden = true.scale.gyro_matrix
        pairs = zip(tables.scale.gyro_matrix[seen], () if hidden is None else hidden, strict=True)
        apart = max(_apart(one, other) for one, other in pairs)
        name = "gyroscopes: matrix over temperature, largest element (1)"
        checks.append(Check(name=name, value=apart, limit=WARM_MATRIX_LIMIT))
    return tuple(checks)


def _offset_apart(triad: TriadModel | None, found: DriftTables, true: DriftTables, seen: BoolArray) -> float:
    """Return the largest error of an offset table, in the unit that the triad makes of readings."""
    name = "gyro_offset" if triad is not None and triad.unit_out == "rad/s" else "accel_offset"
    table, hidden = (None if drift.static is None else getattr(drift.static, name) for drift in (found, true))
    if triad is None or table is None or hidden is None:
        raise InputError(f"tables: wanted {name} over temperature, got none; run the thermal programme")
    return float(np.abs((table[seen] - hidden) @ triad.matrix.T).max())


def _matrix_apart(found: TriadModel | None, true: TriadModel | None) -> float:
    if found is None or true is None:
        raise InputError("matrix: wanted that of both triads, got one missing; record faces and rates")
    return _apart(found.matrix, true.matrix)


def _apart(found: FloatArray, true: FloatArray) -> float:
    """Return the largest element of M_found M_true^-1 - I."""
    return float(np.abs(found @ np.linalg.inv(true) - np.eye(3)).max())


def _pitch_checks(trials: tuple[Trial, ...]) -> tuple[Check, ...]:
    none, static, full = (trial.figures for trial in trials)
    what = "worn sit-to-stand, pitch against the optics"
    return (
        Check(
            name=f"{what}, largest error, static table (deg)",
            value=static.max_abs_pitch_deg,
            limit=STATIC_SHARE * none.max_abs_pitch_deg,
        ),
        Check(
            name=f"{what}, largest error, all tables (deg)",
            value=full.max_abs_pitch_deg,
            limit=FULL_SHARE * none.max_abs_pitch_deg,
        ),
        Check(
            name=f"{what}, rms, all tables (deg)",
            value=full.rmse_pitch_deg,
            limit=FULL_SHARE * none.rmse_pitch_deg,
        ),
    )
