"""What the coefficients of a servo loop say about it, for tests of the emulated axis."""

import cmath
import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.rig.axes import ServoSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopMargins:
    """What a loop's coefficients say about it."""

    crossover: float  # Where the open loop's gain is one, rad/s
    phase_margin_deg: float  # Phase above -180 deg there
    poles_z: tuple[complex, ...]  # Closed loop, sampled exactly
    poles_s: tuple[complex, ...]  # ln(z)/T, rad/s, slowest first
    largest_z: float  # Largest abs(z): the loop is stable below 1


def loop_margins(servo: ServoSettings) -> LoopMargins:
    """Return crossover, phase margin and poles of the linear loop (no friction, no steps, no clip).

    Crossover and margin belong to L(s) = M(s) Ka Kd Kf (2/T)/(s + 2/T) D(s) with D(s) = 4 KP + 4 KD T s + KI/(2 T s), the
    makers' way (DMC-2x00 manual, ch. 10). The poles are those of the sampled loop: (z-1)^2 + K T^2/2 (z+1) D(z) = 0.
    """
    gain = _plant_gain(servo)
    kp, kd, ki = (4.0 * servo.gains[0], 4.0 * servo.gains[1], 0.5 * servo.gains[2])
    period = servo.period_s

    def open_loop(omega: float) -> complex:
        s = 1j * omega
        filtered = kp + kd * period * s + ki / (period * s)
        return gain / s**2 * filtered / (1.0 + 0.5 * period * s)

    low, high = 1e-6 / period, 1e3 / period
    for _ in range(200):  # |L| falls all the way: bisection on a log scale
        middle = math.sqrt(low * high)
        low, high = (middle, high) if abs(open_loop(middle)) > 1.0 else (low, middle)
    crossover = math.sqrt(low * high)
    margin = math.pi + (cmath.phase(open_loop(crossover)) - 2.0 * math.pi) % (-2.0 * math.pi)
    poles_z = closed_loop_poles(servo)
    poles_s = sorted((cmath.log(complex(z)) / period for z in poles_z if abs(z) > 0.0), key=lambda s: -s.real)
    return LoopMargins(
        crossover=crossover,
        phase_margin_deg=math.degrees(margin),
        poles_z=tuple(complex(z) for z in poles_z),
        poles_s=tuple(poles_s),
        largest_z=float(np.abs(poles_z).max()),
    )


def closed_loop_poles(servo: ServoSettings) -> FloatArray:
    """Return the poles of the sampled closed loop in z, (3,)."""
    kp, kd, ki = (4.0 * servo.gains[0], 4.0 * servo.gains[1], 0.5 * servo.gains[2])
    half = 0.5 * _plant_gain(servo) * servo.period_s**2
    plant, lag = np.array([1.0, -2.0, 1.0]), np.array([1.0, 0.0])
    top = np.array([kp + kd, -kd])  # D(z) z
    if ki:
        plant = np.polymul(plant, [1.0, -1.0])
        top = np.polyadd(np.polymul(top, [1.0, -1.0]), [ki, 0.0, 0.0])
    return np.asarray(np.roots(np.polyadd(np.polymul(plant, lag), half * np.polymul([1.0, 1.0], top))))


def ramp_error_counts(servo: ServoSettings, acceleration_counts: float) -> float:
    """Return the steady following error under constant acceleration: a / (Kt/J Ka Kd Kf 4KP)."""
    return acceleration_counts / (_plant_gain(servo) * 4.0 * servo.gains[0])


def _plant_gain(servo: ServoSettings) -> float:
    # counts/s2 per count of the filter's word
    total = servo.inertia + servo.payload_inertia
    return servo.torque_constant / total * servo.amplifier_gain * servo.volts_per_count * servo.counts_per_rad
