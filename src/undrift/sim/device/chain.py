"""SensorChain: three sensors of one kind, as the effects that lie between motion and reading, left to right.

::

    lever arm -> scale -> non-linearity -> g-sensitivity -> offset -> thermal scale -> rate drift -> warm-up -> hysteresis
    -> white noise -> bias instability -> random walk -> amplifier -> low-pass -> sampling -> ADC

An effect that is None is switched off. Up to the low-pass, signals are in nominal input units (rad/s, m/s2): what the nominal
sensitivity would make of the output. The reading at zero noise, linear, at the reference temperature, is
``u = S (C x + o) + null`` with S the gain of the whole chain and C the scale's matrix.
"""

from dataclasses import dataclass, fields, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.adc import Adc
from undrift.sim.device.amplifier import Amplifier
from undrift.sim.device.fields import quantity, settle
from undrift.sim.device.g_sensitivity import GSensitivity
from undrift.sim.device.hysteresis import Hysteresis
from undrift.sim.device.instability import BiasInstability
from undrift.sim.device.lever_arm import LeverArm
from undrift.sim.device.low_pass import LowPass
from undrift.sim.device.noise import RandomWalk, WhiteNoise
from undrift.sim.device.nonlinearity import Nonlinearity
from undrift.sim.device.offset import Offset
from undrift.sim.device.rate_drift import RateDrift
from undrift.sim.device.scale import Scale
from undrift.sim.device.thermal_scale import ThermalScale
from undrift.sim.device.warm_up import WarmUp


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorChain:
    """Three sensors of one kind.

    Parameters
    ----------
    unit : str
        Unit of the reading: count, v, dps, rad/s, g, m/s2.
    scale : Scale
        Sensitivity, axes, crosstalk.
    lever_arm : LeverArm or None
        Accelerometers.
    nonlinearity : Nonlinearity or None
        With asymmetry.
    g_sensitivity : GSensitivity or None
        Gyroscopes.
    offset : Offset or None
        With its thermal drift.
    thermal_scale : ThermalScale or None
        Sensitivity over temperature.
    rate_drift : RateDrift or None
        e(omega, T).
    warm_up : WarmUp or None
        b(t, T).
    hysteresis : Hysteresis or None
        Of the offset over temperature.
    white_noise : WhiteNoise or None
        Angle or velocity random walk.
    instability : BiasInstability or None
        Flicker of the offset.
    random_walk : RandomWalk or None
        Of the offset.
    amplifier : Amplifier or None
        Gain and rails.
    low_pass : LowPass or None
        Analogue, second order.
    adc : Adc or None
        Converter.
    """

    unit: str = quantity("")
    scale: Scale = quantity("")
    lever_arm: LeverArm | None = quantity("", None, None)
    nonlinearity: Nonlinearity | None = quantity("", None, None)
    g_sensitivity: GSensitivity | None = quantity("", None, None)
    offset: Offset | None = quantity("", None, None)
    thermal_scale: ThermalScale | None = quantity("", None, None)
    rate_drift: RateDrift | None = quantity("", None, None)
    warm_up: WarmUp | None = quantity("", None, None)
    hysteresis: Hysteresis | None = quantity("", None, None)
    white_noise: WhiteNoise | None = quantity("", None, None)
    instability: BiasInstability | None = quantity("", None, None)
    random_walk: RandomWalk | None = quantity("", None, None)
    amplifier: Amplifier | None = quantity("", None, None)
    low_pass: LowPass | None = quantity("", None, None)
    adc: Adc | None = quantity("", None, None)

    def __post_init__(self) -> None:
        settle(self)

    @property
    def gain(self) -> float:
        """Nominal gain of the whole chain, unit of the reading per rad/s or m/s2."""
        return self.scale.nominal_sensitivity * (self.amplifier.gain if self.amplifier else 1.0) / self._per_code

    @property
    def null(self) -> float:
        """Reading at zero signal, unit of the reading."""
        return (self.amplifier.null if self.amplifier else 0.0) / self._per_code

    @property
    def forward_matrix(self) -> FloatArray:
        """Unit of the reading per rad/s or m/s2 of each case axis at the reference temperature, shape (3, 3)."""
        matrix: FloatArray = self.gain * self.scale.matrix
        return matrix

    @property
    def raw_offset(self) -> FloatArray:
        """Reading at zero input and reference temperature, unit of the reading, shape (3,)."""
        offset = self.offset.constant if self.offset else np.zeros(3)
        raw: FloatArray = self.null + self.gain * offset
        return raw

    @property
    def raw_random_walk(self) -> FloatArray:
        """White noise in the reading, its unit per sqrt(Hz), shape (3,)."""
        walk = self.white_noise.random_walk if self.white_noise else np.zeros(3)
        raw: FloatArray = self.gain * walk
        return raw

    @property
    def full_scale(self) -> float:
        """Largest rate or force either way that the amplifier and the converter take, rad/s or m/s2."""
        limits = [np.inf]
        total = self.scale.nominal_sensitivity * (self.amplifier.gain if self.amplifier else 1.0)
        null = self.amplifier.null if self.amplifier else 0.0
        if self.amplifier:
            limits += [(null - self.amplifier.low) / total, (self.amplifier.high - null) / total]
        if self.adc:
            low, high = self.adc.code_limits
            limits += [(null - low * self.adc.step) / total, (high * self.adc.step - null) / total]
        return float(min(limits))

    @property
    def _per_code(self) -> float:
        return self.adc.step if self.adc and self.adc.codes else 1.0

    def without_noise(self) -> "SensorChain":
        """Return the same sensors with no noise, no rounding and no end to their range; the reading keeps its unit.

        Returns
        -------
        SensorChain
            Deterministic.
        """
        step = self._per_code
        open_amplifier = Amplifier(
            gain=(self.amplifier.gain if self.amplifier else 1.0) / step, null=self.null if self.amplifier else 0.0
        )
        needed = self.amplifier is not None or step != 1.0
        return replace(
            self,
            white_noise=None,
            instability=None,
            random_walk=None,
            amplifier=open_amplifier if needed else None,
            adc=None,
        )


def effects_of(chain: SensorChain) -> tuple[str, ...]:
    """Return the names of the effects that are switched on, in their order.

    Parameters
    ----------
    chain : SensorChain
        Sensors.

    Returns
    -------
    tuple of str
        Names of fields.
    """
    names = [f.name for f in fields(chain) if f.name not in ("unit", "scale") and getattr(chain, f.name) is not None]
    at = names.index("lever_arm") + 1 if "lever_arm" in names else 0
    return (*names[:at], "scale", *names[at:])
