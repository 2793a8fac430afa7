"""The calibration file in pydantic models: every key, its type and its shape. The JSON Schema is made from them.

null stands for NaN; infinity, which JSON does not know, is "inf" or "-inf" where it can occur. A key with a default is written
only where it says something, so that a file without it reads everywhere.
"""

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, Field

from undrift.calibration.model import Rounding, Status

KIND = "undrift.calibration"
FORMAT = 1


def _finite(x: float) -> float:
    if not math.isfinite(x):
        raise ValueError("wanted a finite number, null or 'inf'")
    return x


Finite = Annotated[float, AfterValidator(_finite)]
Number = Finite | None | Literal["inf", "-inf"]
Vector = Annotated[list[Finite | None], Field(min_length=3, max_length=3)]
Matrix = Annotated[list[Vector], Field(min_length=3, max_length=3)]
Nodes = Annotated[list[Finite], Field(min_length=2)]


class TriadFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """One triad: corrected = matrix @ (raw - offset) - g_sensitivity @ accel; matrix in unit_out per unit_in."""

    method: str
    unit_in: str
    unit_out: str
    matrix: Matrix
    offset: Vector
    g_sensitivity: Matrix | None
    parameters: list[str]
    covariance: list[list[Finite | None]]
    rms_residual: Number
    count: int
    rank: int
    condition: Number
    valid_range: Annotated[list[Number], Field(min_length=2, max_length=2)]


class WarmUpFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Extra offset over the time since power-on, raw unit; it ends at zero."""

    power_on_s: Nodes
    gyro_offset: list[Vector]


class StaticFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Absolute offsets over temperature and their standard uncertainties, raw unit; temperatures in degC.

    extrapolated: no data were near the node. hysteresis: half of what cooling reads more than warming.
    """

    temp_c: Nodes
    gyro_offset: list[Vector] | None = None
    accel_offset: list[Vector] | None = None
    gyro_uncertainty: list[Vector] | None = None
    accel_uncertainty: list[Vector] | None = None
    gyro_extrapolated: list[bool] | None = None
    accel_extrapolated: list[bool] | None = None
    gyro_hysteresis: Vector | None = None
    warm_up: WarmUpFile | None = None


class ScaleFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Matrices over temperature and the standard uncertainty of each element, unit_out per unit_in; temperatures in degC."""

    temp_c: Nodes
    gyro_matrix: list[Matrix] | None = None
    accel_matrix: list[Matrix] | None = None
    gyro_uncertainty: list[Matrix] | None = None
    accel_uncertainty: list[Matrix] | None = None
    gyro_extrapolated: list[bool] | None = None
    accel_extrapolated: list[bool] | None = None


class DynamicFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Rate error over temperature and measured rate and its standard uncertainty, rad/s; temperatures in degC."""

    temp_c: Nodes
    turn_rate: Nodes
    error: list[list[Vector]]
    uncertainty: list[list[Vector]] | None = None
    extrapolated: list[list[bool]] | None = None


class DriftFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Tuning tables, null where there is none, over the temperature that the thermometer shows lag_s late (s)."""

    static: StaticFile | None = None
    scale: ScaleFile | None = None
    dynamic: DynamicFile | None = None
    lag_s: Annotated[Finite, Field(ge=0.0)] = 0.0
    lag_smooth_s: Annotated[Finite, Field(ge=0.0)] = 0.0


class AdcFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Code step in the raw unit and rounding: lsb and rounding of the gyroscopes, accel_ the same of the accelerometers."""

    lsb: Vector | None
    rounding: Rounding
    accel_lsb: Vector | None
    accel_rounding: Rounding


class NoiseFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Noise coefficients per axis, SI; null where the record was too short to tell."""

    angle_random_walk: Vector
    bias_instability: Vector
    rate_random_walk: Vector
    velocity_random_walk: Vector
    accel_bias_instability: Vector
    accel_random_walk: Vector


class VerdictFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """What the calibration is worth."""

    status: Status
    reasons: list[str]


class InputFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """A file that the calibration was made from."""

    file: str
    sha256: str


class ProvenanceFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Where the calibration came from; time is ISO 8601, UTC."""

    inputs: list[InputFile]
    settings: dict[str, str]
    versions: dict[str, str]
    time: str


class CalibrationFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """A device's calibration as undrift writes it."""

    kind: Literal["undrift.calibration"]
    format: Literal[1]
    device: str
    reference_temp_c: Finite | None
    gravity_m_s2: Finite
    gyro: TriadFile | None
    accel: TriadFile | None
    drift: DriftFile | None
    adc: AdcFile | None
    noise: NoiseFile | None
    verdict: VerdictFile
    provenance: ProvenanceFile
