"""Grades: how the devices of a production run spread, as standard deviations about what the data sheet says.

Every property of a unit is drawn from a normal distribution, cut off at ``limit_sd`` standard deviations. Noise is typical,
the same in every unit.
"""

import math
from dataclasses import dataclass, field

from undrift.sim.device.adc import Adc
from undrift.sim.device.amplifier import Amplifier
from undrift.sim.device.sampling import Sampling
from undrift.sim.device.thermometer import Thermometer


@dataclass(frozen=True, slots=True, kw_only=True)
class TriadGrade:
    """How the sensors of one kind spread over units.

    Parameters
    ----------
    unit : str
        Unit of the reading.
    sensitivity : float
        Nominal, of the sensor, its output unit per rad/s or m/s2.
    sensitivity_sd : float
        Relative standard deviation of it.
    misalignment_sd : float
        Of each axis about each axis across it, rad.
    cross_axis_sd : float
        Of each crosstalk term, relative.
    nonlinearity_sd : float
        Of the quadratic departure at full scale, relative to full scale.
    asymmetry_sd : float
        Of the asymmetry of the scale factor, relative.
    offset_sd : float
        rad/s or m/s2.
    offset_per_k_sd : float
        rad/s/K or m/s2/K.
    offset_per_k2_sd : float
        rad/s/K2 or m/s2/K2.
    scale_per_k_sd : float
        Relative, per K.
    rate_drift_sd : float
        Of the rate-dependent drift at full scale, relative to full scale, per K: ``e = c x^3 D``.
    g_sensitivity_sd : float
        rad/s per m/s2.
    warm_up_sd : float
        Of the amplitude, rad/s or m/s2.
    warm_up_s : float
        Time constant, s.
    hysteresis_sd : float
        Of the amplitude, rad/s or m/s2.
    lever_arm_sd : float
        Of each coordinate of each sensor, m.
    random_walk : float
        White noise, rad/s/sqrt(Hz) or m/s2/sqrt(Hz).
    instability : float
        B, rad/s or m/s2.
    bias_walk : float
        rad/s/sqrt(s) or m/s2/sqrt(s).
    full_scale : float
        Range, rad/s or m/s2; non-linearity and rate drift refer to it.
    amplifier : Amplifier or None
        The same in every unit.
    cutoff_hz : float or None
        Of the Sallen-Key low-pass; None for none.
    part_sd : float
        Relative standard deviation of its resistors and capacitors.
    adc : Adc or None
        The same in every unit.
    """

    unit: str
    sensitivity: float
    sensitivity_sd: float
    misalignment_sd: float
    cross_axis_sd: float = 0.0
    nonlinearity_sd: float = 0.0
    asymmetry_sd: float = 0.0
    offset_sd: float
    offset_per_k_sd: float
    offset_per_k2_sd: float = 0.0
    scale_per_k_sd: float = 0.0
    rate_drift_sd: float = 0.0
    g_sensitivity_sd: float = 0.0
    warm_up_sd: float = 0.0
    warm_up_s: float = 600.0
    hysteresis_sd: float = 0.0
    lever_arm_sd: float = 0.0
    random_walk: float
    instability: float = 0.0
    bias_walk: float = 0.0
    full_scale: float = math.inf
    amplifier: Amplifier | None = None
    cutoff_hz: float | None = None
    part_sd: float = 0.0
    adc: Adc | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Grade:
    """How devices spread over units.

    Parameters
    ----------
    gyro, accel : TriadGrade
        The sensors.
    thermometer : Thermometer
        The same in every unit, but for its trim error.
    trim_error_sd : float
        Of the thermometer, K.
    sampling : Sampling
        The same in every unit.
    limit_sd : float
        Where the spread ends, standard deviations.
    name : str
        Kind of device.
    source_tag : str
        How far its figures are to be trusted.
    """

    gyro: TriadGrade
    accel: TriadGrade
    thermometer: Thermometer = field(default_factory=lambda: Thermometer(noise_c=0.05, step_c=0.125))
    trim_error_sd: float = 0.0
    sampling: Sampling = field(default_factory=Sampling)
    limit_sd: float = math.inf
    name: str = ""
    source_tag: str = "assumed"
