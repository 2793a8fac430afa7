"""Calibration: the one object that owns the correction model, and the values it is made of.

In symbols, for a reading u (3,) at temperature T::

    u1 = u + rounding(u)          adc      half an LSB back for truncated codes
    u2 = u1 - offset(T) - o(t)    static   table of absolute offsets, else the constant offset; warm-up over time since power-on
    w  = M(T) u2                  matrix   constant, or a table over temperature
    w  = w - G a                  g-sensitivity, gyroscopes only
    w  = w - e(w, T)              dynamic  table over measured rate and temperature

``correct.py`` is the only place that evaluates it. The maps are inverse models: raw to physical. A forward model
(physical to raw) is S = K a + b with K = M^-1 and b = offset.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import BoolArray, FloatArray, frozen
from undrift.errors import InputError

Rounding = Literal["nearest", "floor", "toward_zero"]
Status = Literal["good", "marginal", "bad"]

AXES = ("x", "y", "z")
MATRIX_NAMES = tuple(f"m_{row}{column}" for row in AXES for column in AXES)
OFFSET_NAMES = tuple(f"offset_{axis}" for axis in AXES)
G_NAMES = tuple(f"g_{row}{column}" for row in AXES for column in AXES)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdict:
    """What a fit is worth, in words.

    Parameters
    ----------
    status : str
        good, marginal or bad.
    reasons : tuple of str
        Why, one sentence each; also what was not observable and what recording would fix it.
    """

    status: Status = "good"
    reasons: tuple[str, ...] = ()

    def also(self, other: "Verdict") -> "Verdict":
        """Return both verdicts as one: the worse status, all reasons.

        Parameters
        ----------
        other : Verdict
            Another verdict on the same device.

        Returns
        -------
        Verdict
            The two together.
        """
        order = ("good", "marginal", "bad")
        worse = max(self.status, other.status, key=order.index)
        return Verdict(status=worse, reasons=(*self.reasons, *(r for r in other.reasons if r not in self.reasons)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadModel:
    """Inverse model of three sensors: corrected = matrix @ (raw - offset) - g_sensitivity @ accel.

    Parameters
    ----------
    method : str
        How it was found: six-face, rate-table, known-rotation, multi-position, reference; mode behind a slash.
    unit_in, unit_out : str
        Unit of the raw reading and of the corrected value.
    matrix : array, shape (3, 3)
        unit_out per unit_in; sensor axes s to case b.
    offset : array, shape (3,)
        Reading at zero input and reference temperature, unit_in.
    g_sensitivity : array, shape (3, 3), or None
        Rate that one m/s2 of specific force feigns, unit_out per m/s2; gyroscopes only.
    parameters : tuple of str
        Names of the parameters that ``covariance`` speaks of: m_xx..m_zz row by row, offset_x.., g_xx..
    covariance : array, shape (P, P)
        Of those parameters, in their units; a parameter that was held fixed has zeros.
    rms_residual : float
        Root-mean-square residual of the fit, unit_out.
    count : int
        Equations in the fit.
    rank : int
        Rank of the fit's normal matrix; full rank means that every parameter was observable.
    condition : float
        Condition number of the design after its columns were scaled to one.
    valid_range : tuple of float
        Least and greatest corrected value per axis that the fit has seen, unit_out.
    """

    method: str
    unit_in: str
    unit_out: str
    matrix: FloatArray
    offset: FloatArray
    g_sensitivity: FloatArray | None = None
    parameters: tuple[str, ...] = (*MATRIX_NAMES, *OFFSET_NAMES)
    covariance: FloatArray
    rms_residual: float
    count: int
    rank: int
    condition: float
    valid_range: tuple[float, float]

    def __post_init__(self) -> None:
        p = len(self.parameters)
        _freeze(self, matrix=(3, 3), offset=(3,), covariance=(p, p))
        if self.g_sensitivity is not None:
            _freeze(self, g_sensitivity=(3, 3))

    @property
    def standard_uncertainty(self) -> FloatArray:
        """Standard uncertainty of each parameter, shape (P,), in its own unit."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def forward_matrix(self) -> FloatArray:
        """K of the forward model raw = K w + offset, unit_in per unit_out, shape (3, 3)."""
        forward: FloatArray = np.linalg.inv(self.matrix)
        return forward

    @property
    def scale_factor(self) -> FloatArray:
        """Sensitivity of each sensor along its own axis, unit_in per unit_out, shape (3,): the row lengths of K."""
        length: FloatArray = np.linalg.norm(self.forward_matrix, axis=1)
        return length

    @property
    def sensor_axes(self) -> FloatArray:
        """Unit vector of each sensor's axis in b, one a row, shape (3, 3): K = diag(scale_factor) @ sensor_axes."""
        axes: FloatArray = self.forward_matrix / self.scale_factor[:, None]
        return axes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WarmUp:
    """Extra offset of a device that was switched on a short while ago; it dies away to zero.

    Parameters
    ----------
    power_on_s : array, shape (k,)
        Nodes of the time since power-on, s, increasing from 0.
    gyro_offset : array, shape (k, 3)
        To be added to the settled offset, raw unit; the last row is zero.
    """

    power_on_s: FloatArray
    gyro_offset: FloatArray

    def __post_init__(self) -> None:
        _freeze(self, power_on_s=(None,))
        _check_nodes(self.power_on_s, "warm-up power_on_s")
        _freeze(self, gyro_offset=(len(self.power_on_s), 3))
        if self.power_on_s[0] != 0.0 or self.gyro_offset[-1].any():
            raise InputError(
                f"warm-up: wanted nodes from 0 s to an offset of zero, got {self.power_on_s[0]:g} s and "
                f"{np.abs(self.gyro_offset[-1]).max():g} at the end; the settled offset belongs into the static table"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StaticDrift:
    """Tuning table of absolute offsets over temperature, linear between nodes.

    Parameters
    ----------
    temp_c : array, shape (n,)
        Nodes, degC, increasing.
    gyro_offset, accel_offset : array, shape (n, 3), or None
        Reading at zero input, raw unit.
    gyro_uncertainty, accel_uncertainty : array, shape (n, 3), or None
        Standard uncertainty of each node, raw unit.
    gyro_extrapolated, accel_extrapolated : array of bool, shape (n,), or None
        True where no data were near the node.
    gyro_hysteresis : array, shape (3,), or None
        Half the loop: offset while cooling minus offset while warming, over two, raw unit; the table holds the middle.
    warm_up : WarmUp or None
        Extra offset after power-on.
    """

    temp_c: FloatArray
    gyro_offset: FloatArray | None = None
    accel_offset: FloatArray | None = None
    gyro_uncertainty: FloatArray | None = None
    accel_uncertainty: FloatArray | None = None
    gyro_extrapolated: BoolArray | None = None
    accel_extrapolated: BoolArray | None = None
    gyro_hysteresis: FloatArray | None = None
    warm_up: WarmUp | None = None

    def __post_init__(self) -> None:
        _freeze(self, temp_c=(None,))
        n = len(self.temp_c)
        _check_nodes(self.temp_c, "static drift temp_c")
        _freeze_some(self, (n, 3), "gyro_offset", "accel_offset", "gyro_uncertainty", "accel_uncertainty")
        _freeze_some(self, (3,), "gyro_hysteresis")
        _freeze_marks(self, (n,), "gyro_extrapolated", "accel_extrapolated")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaleDrift:
    """Matrix over temperature (thermal scale factor and cross-axis), linear between nodes.

    Parameters
    ----------
    temp_c : array, shape (n,)
        Nodes, degC, increasing.
    gyro_matrix, accel_matrix : array, shape (n, 3, 3), or None
        unit_out per unit_in.
    gyro_uncertainty, accel_uncertainty : array, shape (n, 3, 3), or None
        Standard uncertainty of each element.
    gyro_extrapolated, accel_extrapolated : array of bool, shape (n,), or None
        True where no data were near the node.
    """

    temp_c: FloatArray
    gyro_matrix: FloatArray | None = None
    accel_matrix: FloatArray | None = None
    gyro_uncertainty: FloatArray | None = None
    accel_uncertainty: FloatArray | None = None
    gyro_extrapolated: BoolArray | None = None
    accel_extrapolated: BoolArray | None = None

    def __post_init__(self) -> None:
        _freeze(self, temp_c=(None,))
        n = len(self.temp_c)
        _check_nodes(self.temp_c, "scale drift temp_c")
        _freeze_some(self, (n, 3, 3), "gyro_matrix", "accel_matrix", "gyro_uncertainty", "accel_uncertainty")
        _freeze_marks(self, (n,), "gyro_extrapolated", "accel_extrapolated")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DynamicDrift:
    """Rate error left over after static and matrix correction: e(measured rate, T), bilinear.

    Parameters
    ----------
    temp_c : array, shape (m,)
        Nodes, degC, increasing.
    turn_rate : array, shape (k,)
        Nodes of the measured rate, rad/s, increasing.
    error : array, shape (m, k, 3)
        Measured minus true rate per axis, rad/s.
    uncertainty : array, shape (m, k, 3), or None
        Standard uncertainty of each node, rad/s.
    extrapolated : array of bool, shape (m, k), or None
        True where no data were near the node.
    """

    temp_c: FloatArray
    turn_rate: FloatArray
    error: FloatArray
    uncertainty: FloatArray | None = None
    extrapolated: BoolArray | None = None

    def __post_init__(self) -> None:
        _freeze(self, temp_c=(None,), turn_rate=(None,))
        m, k = len(self.temp_c), len(self.turn_rate)
        _check_nodes(self.temp_c, "dynamic drift temp_c")
        _check_nodes(self.turn_rate, "dynamic drift turn_rate")
        _freeze(self, error=(m, k, 3))
        _freeze_some(self, (m, k, 3), "uncertainty")
        _freeze_marks(self, (m, k), "extrapolated")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DriftTables:
    """The tuning tables of one device.

    Parameters
    ----------
    static : StaticDrift or None
        Offsets over temperature.
    scale : ScaleDrift or None
        Matrices over temperature.
    dynamic : DynamicDrift or None
        Rate-dependent error over temperature.
    lag_s : float
        Time constant by which the thermometer trails the sensors, s; the tables are over the temperature without it.
    lag_smooth_s : float
        Time constant of the smoothing that taking the lag off needs, s; above 0 where there is a lag.
    """

    static: StaticDrift | None = None
    scale: ScaleDrift | None = None
    dynamic: DynamicDrift | None = None
    lag_s: float = 0.0
    lag_smooth_s: float = 0.0

    def __post_init__(self) -> None:
        lag, smooth = self.lag_s, self.lag_smooth_s
        if not (0.0 <= lag < np.inf and 0.0 <= smooth < np.inf) or (lag > 0.0 and smooth == 0.0):
            raise InputError(
                "drift tables: wanted lag_s and lag_smooth_s of 0 s or more, with a lag the smoothing above 0, "
                f"got {lag:g} and {smooth:g}; drift.lag.default_smooth_s gives one"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AdcModel:
    """How codes were made of voltages: the step and the rounding of each triad.

    Parameters
    ----------
    gyro_lsb, accel_lsb : array, shape (3,), or None
        One code step, raw unit; None where it was not identified.
    gyro_rounding, accel_rounding : str
        nearest, floor or toward_zero.
    """

    gyro_lsb: FloatArray | None = None
    accel_lsb: FloatArray | None = None
    gyro_rounding: Rounding = "nearest"
    accel_rounding: Rounding = "nearest"

    def __post_init__(self) -> None:
        for name in ("gyro_lsb", "accel_lsb"):
            if getattr(self, name) is not None:
                _freeze(self, **{name: (3,)})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseModel:
    """Noise coefficients of both triads at rest, as IEEE Std 952 names them; NaN where the record was too short to tell.

    Parameters
    ----------
    angle_random_walk, bias_instability, rate_random_walk : array, shape (3,)
        Gyroscopes: rad/s/sqrt(Hz), rad/s, rad/s/sqrt(s).
    velocity_random_walk, accel_bias_instability, accel_random_walk : array, shape (3,)
        Accelerometers: m/s2/sqrt(Hz), m/s2, m/s2/sqrt(s).
    """

    angle_random_walk: FloatArray
    bias_instability: FloatArray
    rate_random_walk: FloatArray
    velocity_random_walk: FloatArray
    accel_bias_instability: FloatArray
    accel_random_walk: FloatArray

    def __post_init__(self) -> None:
        _freeze(self, angle_random_walk=(3,), bias_instability=(3,), rate_random_walk=(3,))
        _freeze(self, velocity_random_walk=(3,), accel_bias_instability=(3,), accel_random_walk=(3,))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Provenance:
    """Where a calibration came from.

    Parameters
    ----------
    inputs : tuple of (str, str)
        File name and sha256 of each input.
    settings : tuple of (str, str)
        Name and value of each choice that was made.
    versions : tuple of (str, str)
        Package and version.
    created : str
        ISO 8601 time, UTC.
    """

    inputs: tuple[tuple[str, str], ...] = ()
    settings: tuple[tuple[str, str], ...] = ()
    versions: tuple[tuple[str, str], ...] = ()
    created: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibration:
    """Everything that is needed to turn one device's readings into rad/s and m/s2.

    Parameters
    ----------
    device : str
        Serial number.
    reference_temp_c : float
        Temperature at which the constant offsets hold, degC; NaN when no temperature was recorded.
    gravity_m_s2 : float
        Local gravity that the accelerometer fit used, m/s2.
    gyro, accel : TriadModel or None
        None where the session did not observe it.
    drift : DriftTables or None
        None for constant offsets.
    adc : AdcModel or None
        None when the codes' rounding is not known.
    noise : NoiseModel or None
        None when no noise was measured.
    verdict : Verdict
        What it is worth.
    provenance : Provenance
        Where it came from.
    """

    device: str
    reference_temp_c: float
    gravity_m_s2: float
    gyro: TriadModel | None = None
    accel: TriadModel | None = None
    drift: DriftTables | None = None
    adc: AdcModel | None = None
    noise: NoiseModel | None = None
    verdict: Verdict = Verdict()
    provenance: Provenance = Provenance()


def _freeze(value: object, **shapes: tuple[int | None, ...]) -> None:
    for name, shape in shapes.items():
        array: ArrayLike = getattr(value, name)
        object.__setattr__(value, name, frozen(array, shape, f"{type(value).__name__}.{name}"))


def _freeze_some(value: object, shape: tuple[int, ...], *names: str) -> None:
    for name in names:
        if getattr(value, name) is not None:
            _freeze(value, **{name: shape})


def _freeze_marks(value: object, shape: tuple[int, ...], *names: str) -> None:
    for name in names:
        marks = getattr(value, name)
        if marks is not None:
            held = np.array(marks, dtype=bool)
            if held.shape != shape:
                raise InputError(
                    f"{type(value).__name__}.{name}: wanted shape {shape}, got {held.shape}; one mark for each node"
                )
            held.flags.writeable = False
            object.__setattr__(value, name, held)


def _check_nodes(nodes: FloatArray, name: str) -> None:
    if len(nodes) < 2 or not (np.diff(nodes) > 0.0).all():
        raise InputError(f"{name}: wanted two or more increasing nodes, got {len(nodes)}; sort and merge them")
