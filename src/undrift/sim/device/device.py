"""SimulatedDevice: a device that does not exist, told by what it physically is.

Reading i of a triad, in its own raw unit, at temperature T with rate or force x and specific force f::

    u_i = S_i (e_i . x + o_i + c_i (T - T0) + g_i . f + n_i)        then rounded to the LSB, then held to full scale

S sensitivity, e_i unit vector of the sensor's axis in b, o zero offset and c its drift with temperature, g_i what
specific force feigns (gyroscopes), n noise: white, and a random walk from the first sample on. T0 is the reference
temperature. No matrix is inverted here; the correction undrift fits is another set of equations.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray, frozen
from undrift.errors import InputError

Rounding = Literal["nearest", "floor", "toward_zero"]
Sampling = Literal["mean", "instant"]


def _zeros() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedTriad:
    """Three sensors of one kind.

    Parameters
    ----------
    unit : str
        Unit of the reading: count, v, dps, rad/s, g, m/s2.
    sensitivity : array, shape (3,)
        Raw unit per rad/s or m/s2.
    axes : array, shape (3, 3)
        Unit vector of each sensor in b, one a row.
    offset : array, shape (3,)
        Output at zero input and reference temperature, rad/s or m/s2.
    offset_per_k : array, shape (3,)
        Drift of the offset, rad/s/K or m/s2/K.
    g_sensitivity : array, shape (3, 3)
        Rate feigned by specific force, rad/s per m/s2: row i for sensor i, columns x, y, z of b.
    random_walk : array, shape (3,)
        White noise as IEEE Std 952 states it (angle or velocity random walk), rad/s/sqrt(Hz) or m/s2/sqrt(Hz): the
        standard deviation of one sample is random_walk * sqrt(sample rate). A datasheet's one-sided density is sqrt(2)
        times this.
    bias_walk : array, shape (3,)
        Random walk of the offset, rad/s/sqrt(s) or m/s2/sqrt(s).
    lsb : float
        Step of the reading, raw unit; 0 for none.
    rounding : str
        nearest, floor or toward_zero.
    full_scale : float
        Largest reading either way, raw unit; infinite for none.
    """

    unit: str
    sensitivity: FloatArray
    axes: FloatArray
    offset: FloatArray = field(default_factory=_zeros)
    offset_per_k: FloatArray = field(default_factory=_zeros)
    g_sensitivity: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    random_walk: FloatArray = field(default_factory=_zeros)
    bias_walk: FloatArray = field(default_factory=_zeros)
    lsb: float = 0.0
    rounding: Rounding = "nearest"
    full_scale: float = math.inf

    def __post_init__(self) -> None:
        for name in ("sensitivity", "offset", "offset_per_k", "random_walk", "bias_walk"):
            object.__setattr__(self, name, frozen(getattr(self, name), (3,), f"SimulatedTriad.{name}"))
        for name in ("axes", "g_sensitivity"):
            object.__setattr__(self, name, frozen(getattr(self, name), (3, 3), f"SimulatedTriad.{name}"))
        length = np.linalg.norm(self.axes, axis=1)
        if (np.abs(length - 1.0) > 1e-9).any():
            raise InputError(
                f"simulated triad: wanted unit vectors as axes, got lengths {np.array2string(length, precision=4)}; "
                "put the gain into sensitivity"
            )

    @property
    def forward_matrix(self) -> FloatArray:
        """Raw unit per rad/s or m/s2 of each case axis, shape (3, 3)."""
        matrix: FloatArray = self.sensitivity[:, None] * self.axes
        return matrix

    @property
    def raw_offset(self) -> FloatArray:
        """Reading at zero input and reference temperature, raw unit, shape (3,)."""
        offset: FloatArray = self.sensitivity * self.offset
        return offset

    def without_noise(self) -> "SimulatedTriad":
        """Return the same sensors with no noise, no rounding and no end to their range.

        Returns
        -------
        SimulatedTriad
            Deterministic.
        """
        return replace(self, random_walk=_zeros(), bias_walk=_zeros(), lsb=0.0, full_scale=math.inf)


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedThermometer:
    """A board thermometer.

    Parameters
    ----------
    offset_c : float
        Reading minus truth, K.
    lag_s : float
        Time constant, s; 0 for none.
    noise_c : float
        Standard deviation of a sample, K.
    lsb_c : float
        Step of the reading, K; 0 for none.
    """

    offset_c: float = 0.0
    lag_s: float = 0.0
    noise_c: float = 0.0
    lsb_c: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedDevice:
    """Three gyroscopes, three accelerometers and a thermometer.

    Parameters
    ----------
    serial : str
        Serial number.
    gyro, accel : SimulatedTriad
        The sensors.
    thermometer : SimulatedThermometer
        The board thermometer.
    reference_temp_c : float
        Temperature at which the offsets are stated, degC.
    sampling : str
        "mean": a gyroscope reading is the mean over the step that ends with the sample; "instant": the rate at the sample.
    """

    serial: str
    gyro: SimulatedTriad
    accel: SimulatedTriad
    thermometer: SimulatedThermometer = SimulatedThermometer()
    reference_temp_c: float = 25.0
    sampling: Sampling = "mean"

    def without_noise(self) -> "SimulatedDevice":
        """Return the same device with no noise, no rounding and no end to its range.

        Returns
        -------
        SimulatedDevice
            Deterministic.
        """
        return replace(
            self,
            gyro=self.gyro.without_noise(),
            accel=self.accel.without_noise(),
            thermometer=replace(self.thermometer, noise_c=0.0, lsb_c=0.0),
        )
