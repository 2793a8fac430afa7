"""Servo: the position loop of a sampled motion controller, its margins, and a test move.

    e    = reference - count                                 counts
    word = 4 KP e + 4 KD (e - e_last) + KI/2 sum(e)          D(z) = 4 KP + 4 KD (1 - 1/z) + KI/2 / (1 - 1/z)
    V    = clip(Kd word, 10)                                 converter, Kd volts a count
    i    = Ka V, within (+-supply - Kt omega) / R            current amplifier
    J alpha = Kt i - friction - cogging                      motor, M(s) = Kt / (J s^2)
    count = floor(4N/2pi angle)                              encoder of N lines

The defaults are the figures of the note, which are those of the makers' textbook example with N = 10,000 lines and T = 0.1 ms:
crossover 522.8 rad/s, phase margin 44.2 deg, poles -189.4 +- 403.3j.
"""

import cmath
import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.kernels.servo import Coefficients

_POSITIVE = (
    "torque_constant", "inertia", "resistance", "amplifier_gain", "supply_voltage",
    "encoder_lines", "period_s", "volts_per_count", "voltage_limit",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoSettings:
    """Coefficients of the loop.

    Parameters
    ----------
    torque_constant : float
        Kt, N m/A.
    inertia : float
        J of motor and table, kg m2.
    payload_inertia : float
        Device and fixture, kg m2; adds to J.
    resistance : float
        R of the winding, ohm; a current amplifier hides it from the loop until its supply is used up.
    amplifier_gain : float
        Ka, A/V.
    supply_voltage : float
        Supply of the amplifier, V: sets the speed at which a motor runs away.
    encoder_lines : int
        N, lines a turn; 4 N counts.
    period_s : float
        T, time between samples, s.
    gains : tuple of float
        KP, KD, KI as the card's commands take them.
    volts_per_count : float
        Kd, V; 20/65536 as the manual rounds it.
    voltage_limit : float
        Largest output either way, V.
    coulomb_friction, viscous_friction : float
        N m; N m s/rad.
    cogging_torque : float
        Amplitude, N m.
    cogging_periods : int
        Periods a turn.
    quantise : bool
        False gives an encoder without steps, for comparison with the linear loop.

    Raises
    ------
    InputError
        An inertia, period or line count that is not positive, or a negative friction.
    """

    torque_constant: float = 0.1
    inertia: float = 2.0e-4
    payload_inertia: float = 0.0
    resistance: float = 2.0
    amplifier_gain: float = 4.0
    supply_voltage: float = 48.0
    encoder_lines: int = 10_000
    period_s: float = 1.0e-4
    gains: tuple[float, float, float] = (12.5, 245.0, 0.0)
    volts_per_count: float = 3.0e-4
    voltage_limit: float = 10.0
    coulomb_friction: float = 2.0e-3
    viscous_friction: float = 0.0
    cogging_torque: float = 0.0
    cogging_periods: int = 24
    quantise: bool = True

    def __post_init__(self) -> None:
        for name in _POSITIVE:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"servo {name}: wanted a positive number, got {value}; give the loop's own figure")
        for name in ("payload_inertia", "coulomb_friction", "viscous_friction", "cogging_torque"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"servo {name}: wanted zero or more, got {value}; give the loop's own figure")

    @property
    def counts_per_turn(self) -> int:
        """Encoder counts in one turn: four a line."""
        return 4 * self.encoder_lines

    @property
    def counts_per_rad(self) -> float:
        """Kf = 4N/2pi, counts/rad."""
        return self.counts_per_turn / (2.0 * math.pi)


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopMargins:
    """What a loop's coefficients say about it.

    Parameters
    ----------
    crossover : float
        Where the open loop's gain is one, rad/s.
    phase_margin_deg : float
        Phase above -180 deg there.
    poles_z : tuple of complex
        Closed loop, sampled exactly.
    poles_s : tuple of complex
        ln(z)/T, rad/s, slowest first.
    largest_z : float
        Largest abs(z): the loop is stable below 1.
    """

    crossover: float
    phase_margin_deg: float
    poles_z: tuple[complex, ...]
    poles_s: tuple[complex, ...]
    largest_z: float


def loop_margins(servo: ServoSettings) -> LoopMargins:
    """Return crossover, phase margin and poles of the linear loop (no friction, no steps, no clip).

    Crossover and margin are of L(s) = M(s) Ka Kd Kf (2/T)/(s + 2/T) D(s) with D(s) = 4 KP + 4 KD T s + KI/(2 T s), the
    makers' way (DMC-2x00 manual, ch. 10). The poles are those of the sampled loop: (z-1)^2 + K T^2/2 (z+1) D(z) = 0.

    Parameters
    ----------
    servo : ServoSettings
        The loop.

    Returns
    -------
    LoopMargins
        rad/s and deg.
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
    """Return the poles of the sampled closed loop in z.

    Parameters
    ----------
    servo : ServoSettings
        The loop.

    Returns
    -------
    array, shape (3,) or (4,)
        Complex, 1; four with an integral term.
    """
    kp, kd, ki = (4.0 * servo.gains[0], 4.0 * servo.gains[1], 0.5 * servo.gains[2])
    half = 0.5 * _plant_gain(servo) * servo.period_s**2
    plant, lag = np.array([1.0, -2.0, 1.0]), np.array([1.0, 0.0])
    top = np.array([kp + kd, -kd])  # D(z) z
    if ki:
        plant = np.polymul(plant, [1.0, -1.0])
        top = np.polyadd(np.polymul(top, [1.0, -1.0]), [ki, 0.0, 0.0])
    return np.asarray(np.roots(np.polyadd(np.polymul(plant, lag), half * np.polymul([1.0, 1.0], top))))


def ramp_error_counts(servo: ServoSettings, acceleration_counts: float) -> float:
    """Return the steady following error under constant acceleration: a / (Kt/J Ka Kd Kf 4KP).

    Parameters
    ----------
    servo : ServoSettings
        The loop, KI = 0.
    acceleration_counts : float
        counts/s2.

    Returns
    -------
    float
        counts.
    """
    return acceleration_counts / (_plant_gain(servo) * 4.0 * servo.gains[0])


def _plant_gain(servo: ServoSettings) -> float:
    # counts/s2 per count of the filter's word
    total = servo.inertia + servo.payload_inertia
    return servo.torque_constant / total * servo.amplifier_gain * servo.volts_per_count * servo.counts_per_rad


def resting_coefficients(servo: ServoSettings) -> Coefficients:
    """Return the kernel's coefficients for a healthy card with its motor off.

    Parameters
    ----------
    servo : ServoSettings
        The loop.

    Returns
    -------
    Coefficients
        Speeds and limits as a card powers up.
    """
    return Coefficients(
        period=servo.period_s,
        proportional=4.0 * servo.gains[0],
        derivative=4.0 * servo.gains[1],
        integral=0.5 * servo.gains[2],
        volts_per_count=servo.volts_per_count,
        clip=servo.voltage_limit,
        torque_constant=servo.torque_constant,
        amplifier_gain=servo.amplifier_gain,
        supply=servo.supply_voltage,
        resistance=servo.resistance,
        inertia=servo.inertia + servo.payload_inertia,
        counts_per_rad=servo.counts_per_rad,
        coulomb=servo.coulomb_friction,
        viscous=servo.viscous_friction,
        cogging=servo.cogging_torque,
        cogging_periods=float(servo.cogging_periods),
        acceleration=256_000.0,
        deceleration=256_000.0,
        slew=25_000.0,
        error_limit=16_384.0,
        forward=2_147_483_647.0,
        reverse=-2_147_483_648.0,
        forward_at=math.inf,
        reverse_at=-math.inf,
        offset=0.0,
        quantise=servo.quantise,
        powered=True,
        motor_on=False,
        amplifier_good=True,
        encoder_good=True,
        forward_closed=False,
        reverse_closed=False,
        stride=max(1, round(1e-3 / servo.period_s)),
    )
