"""Calibration: the object that contains the correction model, and the values of which it consists.

In symbols, for a reading u (3,) at temperature T::

    u1 = u + rounding(u)          adc      plus half an LSB for truncated codes, or the fitted code offset
    u2 = u1 - offset(T) - o(t)    static   table of absolute offsets or the constant offset; warm-up over time since power-on
    w  = M(T) u2                  matrix   constant, or a table over temperature
    w  = w - G a                  g-sensitivity, gyroscopes only
    w  = w - e(w, T)              dynamic  table over measured rate and temperature
    w  = w - m(t) d               moving   m is 1 while the device turns; gyroscopes fitted to references only

Only ``correction/correct.py`` evaluates the model. The maps are inverse models: raw to physical. A forward model
(physical to raw) is S = K a + b with K = M^-1 and b = offset.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge
from pydantic import Field

from undrift.arrays import BoolArray, FloatArray, Shape, freeze
from undrift.base.codec import LATER, AnyNumber, As, FileTable, Gap, Pairs, stored
from undrift.errors import InputError
from undrift.findings import Finding as Finding
from undrift.findings import Status as Status
from undrift.findings import Verdict as Verdict
from undrift.findings import level_of as level_of
from undrift.frames import quaternion_product
from undrift.record import Axis, FileMap
from undrift.shown import Shown
from undrift.units import Quantity, si_factor

Rounding = Literal["nearest", "floor", "toward_zero"]
Sensor = Literal["gyro", "accel"]

AXES: tuple[Axis, Axis, Axis] = ("x", "y", "z")
SENSORS: tuple[Sensor, Sensor] = ("gyro", "accel")
BEYOND_SEEN_C = 3.0  # default range by which tables extend beyond the measured temperatures, degC
MATRIX_NAMES = tuple(f"m_{row}{column}" for row in AXES for column in AXES)
OFFSET_NAMES = tuple(f"offset_{axis}" for axis in AXES)
G_NAMES = tuple(f"g_{row}{column}" for row in AXES for column in AXES)
MOVING_NAMES, CODE_NAMES = tuple(f"moving_{axis}" for axis in AXES), tuple(f"code_{axis}" for axis in AXES)
SOURCES = (  # sources of uncertainty, in the order of a budget
    "rate", "angle", "axis", "ripple", "mounting", "level", "nonlinearity", "temperature", "noise", "adc", "instability",
    "repeatability", "prior", "fit",
)  # fmt: skip
Triple = Annotated[FloatArray, Shape(3)]
Vector = Annotated[FloatArray | None, Shape(3)]
Rows3 = Annotated[FloatArray | None, Shape("n", 3)]
Matrices = Annotated[FloatArray | None, Shape("n", 3, 3)]
Marks = Annotated[BoolArray | None, Shape("n")]
Nodes = Annotated[FloatArray, Shape("n", rising=True)]
_EXCEEDS = 1e-3  # largest relative excess of the summed linear parts over a variance that was averaged over a grid


@stored(
    form=As(
        dict[str, list[float]],
        lambda rows: Budget(sources=tuple(rows), uncertainty=np.array([*rows.values()]).reshape(len(rows), -1)),
        lambda budget: dict(zip(budget.sources, budget.uncertainty.tolist(), strict=True)),
    )
)
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Budget:
    """Standard uncertainty of each parameter by source. The squares of the sources sum to the variance of the parameter."""

    sources: tuple[str, ...]  # names of ``SOURCES``
    uncertainty: Annotated[FloatArray, Shape("s", "p")]  # one row per source, unit of the parameter

    def __post_init__(self) -> None:
        freeze(self, s=len(self.sources))

    @classmethod
    def of(cls, covariance: FloatArray, parts: Mapping[str, FloatArray], rest: str) -> "Budget":
        """Return the budget of a covariance (P, P): the variances (P,) of separable sources, and the remainder named ``rest``.

        Negative variances count as zero. If the sources sum to more than the total, they are not separable, and the
        budget has the single source ``fit``.
        """
        variances = np.diag(covariance)
        shares = {name: np.maximum(share, 0.0) for name, share in parts.items()}
        remainder = variances - sum(shares.values(), np.zeros(len(variances)))
        if not (remainder >= -_EXCEEDS * variances).all():
            shares, remainder, rest = {}, variances, "fit"
        shares[rest] = shares.get(rest, 0.0) + np.maximum(remainder, 0.0)
        names = tuple(name for name in SOURCES if name in shares and shares[name].any())
        variance = np.array([shares[name] for name in names]).reshape(-1, len(variances))
        total = variance.sum(axis=0)
        variance *= np.divide(variances, total, out=np.ones_like(variances), where=total > 0.0)
        return cls(sources=names, uncertainty=np.sqrt(variance))


@stored(whole=True)
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadModel:
    """Inverse model of three sensors: corrected = matrix @ (raw + code_offset sign(raw) - offset) - g_sensitivity @ accel.

    While the device turns, ``moving_offset`` is also subtracted.
    """

    # six-face, rate-table, known-rotation, multi-position, reference or motion, with the mode after a slash
    method: str
    unit_in: str  # unit of the raw reading
    unit_out: str  # unit of the corrected value
    matrix: Annotated[FloatArray, Shape(3, 3)]  # sensor axes s to case b, unit_out per unit_in
    offset: Triple  # reading at zero input and reference temperature, unit_in
    # apparent rate per specific force, unit_out per m/s2 (gyroscopes only)
    g_sensitivity: Annotated[FloatArray | None, Shape(3, 3)] = None
    # names of the rows of ``covariance``: m_xx to m_zz row by row, offset_x.., g_xx.., moving_x.., code_x..
    parameters: tuple[str, ...] = (*MATRIX_NAMES, *OFFSET_NAMES)
    covariance: Annotated[
        FloatArray, Shape("p", "p")
    ]  # covariance in the units of the parameters, 0 for a fixed parameter
    rms_residual: AnyNumber  # root mean square residual of the fit, unit_out
    count: int  # number of equations in the fit
    rank: int  # rank of the normal matrix, full if every parameter was observable
    condition: AnyNumber  # condition number of the design matrix with columns scaled to one
    valid_range: tuple[AnyNumber, AnyNumber]  # smallest and largest corrected value per axis in the fit, unit_out
    budget: Annotated[Budget | None, LATER] = None  # None if the fit does not separate sources
    # offset while the device turns minus offset at rest, unit_out, axes of the result, or None if not fitted
    moving_offset: Annotated[Vector, LATER] = None
    # added to a reading with the sign of the reading, unit_in, for codes truncated toward zero (if None, ``adc`` applies)
    code_offset: Annotated[Vector, LATER] = None

    def __post_init__(self) -> None:
        freeze(self, p=len(self.parameters))
        if self.budget is not None:
            variances, budget_sum = np.diag(self.covariance), (self.budget.uncertainty**2).sum(axis=0)
            if budget_sum.shape != variances.shape or not np.allclose(budget_sum, variances, rtol=1e-9, atol=0.0):
                raise InputError(
                    "budget: the squares must sum to the diagonal of the covariance. Give the correct budget, or none."
                )

    @property
    def standard_uncertainty(self) -> FloatArray:
        """Standard uncertainty of each parameter, shape (P,), in its unit."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def values(self) -> FloatArray:
        """Value of each parameter, shape (P,), in its unit."""
        parts = (self.matrix, self.offset, self.g_sensitivity, self.moving_offset, self.code_offset)
        value_of: dict[str, float] = {}
        for names, values in zip((MATRIX_NAMES, OFFSET_NAMES, G_NAMES, MOVING_NAMES, CODE_NAMES), parts, strict=True):
            if values is not None:
                value_of |= dict(zip(names, values.ravel().tolist(), strict=True))
        return np.array([value_of.get(name, 0.0) for name in self.parameters])

    @property
    def offset_covariance(self) -> FloatArray:
        """Covariance of the corrected value at zero input, unit_out squared, shape (3, 3).

        It is M C M', where C is the covariance of the offset.
        """
        return np.asarray(self.matrix @ self.covariance_of(OFFSET_NAMES) @ self.matrix.T)

    def covariance_of(self, names: tuple[str, ...]) -> FloatArray:
        """Return the covariance of some parameters, shape (n, n), with 0 for a parameter that was not fitted."""
        fitted = [k for k, name in enumerate(names) if name in self.parameters]
        rows = [self.parameters.index(names[k]) for k in fitted]
        covariance = np.zeros((len(names), len(names)))
        covariance[np.ix_(fitted, fitted)] = self.covariance[np.ix_(rows, rows)]
        return covariance

    @property
    def forward_matrix(self) -> FloatArray:
        """K of the forward model raw = K w + offset, unit_in per unit_out, shape (3, 3)."""
        return np.asarray(np.linalg.inv(self.matrix))

    @property
    def scale_factor(self) -> FloatArray:
        """Sensitivity of each sensor along its axis, unit_in per unit_out, shape (3,). These are the row lengths of K."""
        return np.asarray(np.linalg.norm(self.forward_matrix, axis=1))

    def si_per_reading(self, quantity: Quantity) -> FloatArray:
        """Return the SI value of a raw unit of each sensor, shape (3,)."""
        return np.asarray(si_factor(self.unit_out, quantity) / self.scale_factor)

    @property
    def relative_uncertainty(self) -> float:
        """Largest standard uncertainty of an element of matrix @ K. The value 0.01 means 1 % of the gain."""
        return float((self.standard_uncertainty[:9].reshape(3, 3) @ np.abs(self.forward_matrix)).max())


@stored()
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Magnetometer:
    """Inverse model of a magnetometer: field = x - lag_s (w x x), with x = matrix (raw - offset) and w the rate.

    The field is in the axes of the gyroscopes.
    """

    model: TriadModel  # uT to uT (the matrix has determinant 1, so it does not scale the field)
    lag_s: float  # lag of the readings behind the gyroscopes, s
    lag_uncertainty_s: float  # standard uncertainty of the lag, s

    def corrected(self, mag_ut: FloatArray, rate: FloatArray | None) -> FloatArray:
        """Return the field (N, 3), uT, of readings (N, 3) at corrected rates (N, 3), rad/s. Without rates, the lag remains."""
        x = (mag_ut - self.model.offset) @ self.model.matrix.T
        return np.asarray(x if rate is None else x - self.lag_s * np.cross(rate, x))


@stored()
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WarmUp:
    """Additional offset of a device after power-on, which decays to zero."""

    power_on_s: Nodes  # time since power-on, s, starting at 0
    gyro_offset: Annotated[FloatArray, Shape("n", 3)]  # addition to the settled offset, raw unit (the last row is zero)

    def __post_init__(self) -> None:
        freeze(self)
        if self.power_on_s[0] != 0.0 or self.gyro_offset[-1].any():
            raise InputError(
                f"warm-up: nodes must start at 0 s and end with an offset of zero, got {self.power_on_s[0]:g} s and "
                f"{np.abs(self.gyro_offset[-1]).max():g} at the end. Put the settled offset into the static table."
            )


def seen_span(temp_c: FloatArray, extrapolated: BoolArray | None) -> tuple[float, float]:
    """Return the first and last node supported by data, degC. Without marks, or if all nodes are marked, all nodes count."""
    nodes = temp_c if extrapolated is None or extrapolated.all() else temp_c[~extrapolated]
    return float(nodes[0]), float(nodes[-1])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OverTemperature:
    """Table over temperature of a sensor, n nodes."""

    temp_c: FloatArray  # (n,), temperatures, degC
    value: FloatArray  # offsets (n, 3) or matrices (n, 3, 3)
    uncertainty: FloatArray | None  # standard uncertainty, in the shape of ``value``
    extrapolated: BoolArray | None  # (n,), True if there were no data near the node


@stored()
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StaticDrift:
    """Tuning table of absolute offsets over temperature, linear between nodes."""

    temp_c: Nodes  # degC
    gyro_offset: Rows3 = None  # reading at zero input, raw unit
    accel_offset: Rows3 = None
    # standard uncertainty of each node for a future visit to its temperature, raw unit
    gyro_uncertainty: Annotated[Rows3, LATER] = None
    accel_uncertainty: Annotated[Rows3, LATER] = None
    gyro_extrapolated: Annotated[Marks, LATER] = None  # True if there were no data near the node
    accel_extrapolated: Annotated[Marks, LATER] = None
    # half the difference of the offsets while cooling and while warming, raw unit (the table is the mean of both)
    gyro_hysteresis: Annotated[Vector, LATER] = None
    warm_up: Annotated[WarmUp | None, LATER] = None

    def __post_init__(self) -> None:
        freeze(self)


@stored()
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaleDrift:
    """Matrix over temperature (thermal scale factor and cross-axis), linear between nodes."""

    temp_c: Nodes  # degC
    gyro_matrix: Matrices = None  # unit_out per unit_in
    accel_matrix: Matrices = None
    gyro_uncertainty: Annotated[Matrices, LATER] = None  # standard uncertainty of each element
    accel_uncertainty: Annotated[Matrices, LATER] = None
    gyro_extrapolated: Annotated[Marks, LATER] = None  # True if there were no data near the node
    accel_extrapolated: Annotated[Marks, LATER] = None

    def __post_init__(self) -> None:
        freeze(self)


@stored()
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DynamicDrift:
    """Rate error that remains after static and matrix correction: e(measured rate, T), bilinear."""

    temp_c: Annotated[FloatArray, Shape("m", rising=True)]  # degC
    turn_rate: Annotated[FloatArray, Shape("k", rising=True)]  # nodes of the measured rate, rad/s
    error: Annotated[FloatArray, Shape("m", "k", 3)]  # measured minus true rate per axis, rad/s
    # standard uncertainty of each node, rad/s
    uncertainty: Annotated[FloatArray | None, Shape("m", "k", 3), LATER] = None
    extrapolated: Annotated[BoolArray | None, Shape("m", "k"), LATER] = None  # True if there were no data near the node

    def __post_init__(self) -> None:
        freeze(self)


@stored()
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriftTables:
    """Tuning tables of a device: offsets, matrices and rate-dependent error over the temperature of the sensors."""

    static: StaticDrift | None = None
    scale: ScaleDrift | None = None
    dynamic: DynamicDrift | None = None
    lag_s: Annotated[float, Ge(0.0), LATER] = 0.0  # time constant of the lag of the thermometer behind the sensors, s
    # time constant of the smoothing applied when the lag is removed, s (above 0 if there is a lag)
    lag_smooth_s: Annotated[float, Ge(0.0), LATER] = 0.0

    def __post_init__(self) -> None:
        lag, smooth = self.lag_s, self.lag_smooth_s
        if not (0.0 <= lag < np.inf and 0.0 <= smooth < np.inf) or (lag > 0.0 and smooth == 0.0):
            raise InputError(
                "drift tables: lag_s and lag_smooth_s must be 0 s or more, and lag_smooth_s positive if there is a lag, got "
                f"{lag:g} and {smooth:g}. Give both, or neither."
            )


@stored(whole=True)
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AdcModel:
    """Code step of each triad, (3,), raw unit, or None if not identified, and the rounding of the codes."""

    gyro_lsb: Annotated[Vector, Field(alias="lsb")] = None
    gyro_rounding: Annotated[Rounding, Field(alias="rounding")] = "nearest"
    accel_lsb: Vector = None
    accel_rounding: Rounding = "nearest"

    def __post_init__(self) -> None:
        freeze(self)


NO_TABLES, _NO_CODES = DriftTables(), AdcModel()  # shared by all calibrations without tables or codes


@stored(whole=True)
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseModel:
    """Noise coefficients of both triads at rest, named as in IEEE Std 952, (3,) each. NaN means not observable."""

    angle_random_walk: Triple  # rad/s/sqrt(Hz)
    bias_instability: Triple  # rad/s
    rate_random_walk: Triple  # rad/s/sqrt(s)
    velocity_random_walk: Triple  # m/s2/sqrt(Hz)
    accel_bias_instability: Triple  # m/s2
    accel_random_walk: Triple  # m/s2/sqrt(s)

    def __post_init__(self) -> None:
        freeze(self)


@stored()
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyMounting:
    """Mounting of a device on the body: the rotation from case axes b to segment axes a (x forward, y left, z up, upright)."""

    place: str  # body segment: lower-back, thigh, shank, wrist, foot
    matrix: Annotated[FloatArray, Shape(3, 3)]  # R_ab, with the rows forward, left and up in axes b
    covariance: Annotated[FloatArray, Shape(3, 3)]  # covariance of a small rotation about the axes a, rad^2
    basis: str  # data from which the mounting was determined

    def __post_init__(self) -> None:
        freeze(self)
        if not np.allclose(self.matrix @ self.matrix.T, np.eye(3), atol=1e-6) or np.linalg.det(self.matrix) < 0.0:
            raise InputError(
                "mounting: the matrix is not a rotation from case to body axes. Determine the mounting again."
            )

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty of the rotation, all axes combined, rad."""
        return float(np.sqrt(np.trace(self.covariance)))

    def of_body(self, q_nb: FloatArray) -> FloatArray:
        """Return segment orientations (a to n) from case orientations (b to n). q_nb (..., 4) -> (..., 4)."""
        from scipy.spatial.transform import Rotation

        return quaternion_product(q_nb, Rotation.from_matrix(self.matrix.T).as_quat(scalar_first=True))


class InputFile(FileTable):
    """An input file in a calibration file."""

    file: str
    sha256: str


InputFiles = Annotated[
    tuple[tuple[str, str], ...],
    As(
        tuple[InputFile, ...],
        lambda files: tuple((item.file, item.sha256) for item in files),
        lambda pairs: [{"file": file, "sha256": sha256} for file, sha256 in pairs],
    ),
]


@stored(whole=True)
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Provenance:
    """Origin of a calibration: input files with their sha256, settings, packages with their versions, and date."""

    inputs: InputFiles = ()
    settings: Pairs = ()
    versions: Pairs = ()
    created: Annotated[str, Field(alias="time")] = ""  # date and time, ISO 8601, UTC

    def text(self, name: str) -> str:
        """Return a setting, or an empty string if it was not set."""
        return dict(self.settings).get(name, "")

    def number(self, name: str, usual: float) -> float:
        """Return a numeric setting, or ``usual`` if it was not set."""
        return float(self.text(name) or usual)


@cache
def versions_used() -> tuple[tuple[str, str], ...]:
    """Return the packages that a fit depends on, with their versions."""
    from importlib.metadata import version

    return tuple((name, version(name)) for name in ("undrift", "numpy", "scipy"))


@stored(kind="undrift.calibration", whole=True)
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration(Shown):
    """Everything that is needed to convert the readings of a device to rad/s and m/s2.

    Parameters
    ----------
    device : str
        Serial number.
    reference_temp_c : float
        Temperature at which the constant offsets are valid, degC. NaN if no temperature was recorded.
    gravity_m_s2 : float
        Local gravity that the accelerometer fit used, m/s2.
    gyro, accel : TriadModel or None
        Model of each triad, or None if the session did not determine it.
    drift, adc, noise : DriftTables, AdcModel, NoiseModel or None
        Tuning tables, rounding of the codes, and noise at rest. None means constant offsets, unknown rounding, or unmeasured noise.
    verdict, provenance : Verdict, Provenance
        Quality of the fit, and origin of the calibration.
    file_map : FileMap or None
        Column map for the recordings of the device, if they need one.
    magnetometer : Magnetometer or None
        Model of the magnetometer, or None if it was not fitted. Its readings are then not changed.
    mounting : BodyMounting or None
        Mounting of the device on the body, if it was determined.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> device = undrift.random_device(np.random.default_rng(7))
    >>> session = undrift.simulate_session("six_face", device, rng=np.random.default_rng(8))
    >>> calibration = undrift.calibrate(session)
    >>> calibration.gyro is None, calibration.accel.method
    (True, 'six-face/affine')
    """

    device: str
    reference_temp_c: Gap
    gravity_m_s2: float
    gyro: TriadModel | None = None
    accel: TriadModel | None = None
    drift: DriftTables | None = None
    adc: AdcModel | None = None
    noise: NoiseModel | None = None
    verdict: Verdict = Verdict()  # noqa: RUF009  frozen
    provenance: Provenance = Provenance()
    file_map: Annotated[FileMap | None, LATER] = None
    magnetometer: Annotated[Magnetometer | None, LATER] = None
    mounting: Annotated[BodyMounting | None, LATER] = None

    def triad(self, sensor: Sensor) -> "Triad":
        """Return model, tables and code properties of a sensor."""
        drift, adc, gyro = self.drift or NO_TABLES, self.adc or _NO_CODES, sensor == "gyro"
        static = drift.static
        return Triad(
            sensor=sensor,
            quantity="rate" if gyro else "accel",
            model=self.gyro if gyro else self.accel,
            offsets=_select_table(drift.static, sensor, "offset"),
            matrices=_select_table(drift.scale, sensor, "matrix"),
            errors=drift.dynamic if gyro else None,
            warm_up=static.warm_up if gyro and static is not None else None,
            lsb=adc.gyro_lsb if gyro else adc.accel_lsb,
            rounding=adc.gyro_rounding if gyro else adc.accel_rounding,
        )

    @property
    def triads(self) -> "tuple[Triad, Triad]":
        """Return gyroscopes and accelerometers, as ``triad`` does."""
        return self.triad("gyro"), self.triad("accel")

    __repr__ = Shown.__str__


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Triad:
    """The parts of a calibration that belong to one sensor. Missing parts are None."""

    sensor: Sensor
    quantity: Quantity
    model: TriadModel | None
    offsets: OverTemperature | None  # raw unit
    matrices: OverTemperature | None  # unit_out per unit_in
    errors: DynamicDrift | None  # gyroscopes only
    warm_up: WarmUp | None  # gyroscopes only
    lsb: FloatArray | None  # (3,), code step, raw unit
    rounding: Rounding

    @property
    def si(self) -> float:
        """SI units per output unit of the model, or 1 without a model."""
        return 1.0 if self.model is None else si_factor(self.model.unit_out, self.quantity)


def _select_table(table: StaticDrift | ScaleDrift | None, sensor: Sensor, what: str) -> OverTemperature | None:
    """Return the table of a sensor, or None without a table."""
    if table is None:
        return None
    value, uncertainty, marks = (getattr(table, f"{sensor}_{name}") for name in (what, "uncertainty", "extrapolated"))
    if value is None:
        return None
    return OverTemperature(temp_c=table.temp_c, value=value, uncertainty=uncertainty, extrapolated=marks)
