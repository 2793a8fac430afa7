"""Axis: the emulated shaft and its servo, brought up to a moment when someone looks.

The state is advanced in whole samples of the card. Where the axis was is kept in a ring of 1 ms steps, read back by cubic
interpolation from angle and rate. The position loop is that of a sampled motion controller::

    e    = reference - count                                 counts
    word = 4 KP e + 4 KD (e - e_last) + KI/2 sum(e)          D(z) = 4 KP + 4 KD (1 - 1/z) + KI/2 / (1 - 1/z)
    V    = clip(Kd word, 10)                                 converter, Kd volts a count
    i    = Ka V, within (+-supply - Kt omega) / R            current amplifier
    J alpha = Kt i - friction - cogging                      motor, M(s) = Kt / (J s^2)
    count = floor(4N/2pi angle)                              encoder of N lines

The defaults are the figures of the note, which are those of the makers' textbook example with N = 10,000 lines and T = 0.1 ms:
crossover 522.8 rad/s, phase margin 44.2 deg, poles -189.4 +- 403.3j.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from testkit.emulated import servo_kernel as k
from testkit.emulated.servo_kernel import Coefficients
from undrift.arrays import FloatArray
from undrift.errors import InputError

# ---- Servo: the position loop of a sampled motion controller

_POSITIVE = (
    "torque_constant", "inertia", "resistance", "amplifier_gain", "supply_voltage",
    "encoder_lines", "period_s", "volts_per_count", "voltage_limit",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoSettings:
    """Coefficients of the loop."""

    torque_constant: float = 0.1  # Kt, N m/A
    inertia: float = 2.0e-4  # J of motor and table, kg m2
    payload_inertia: float = 0.0  # Device and fixture, kg m2; adds to J
    # R of the winding, ohm; a current amplifier hides it from the loop until its supply is used up
    resistance: float = 2.0
    amplifier_gain: float = 4.0  # Ka, A/V
    supply_voltage: float = 12.0  # Of the amplifier, V, +-12 in the note: sets the speed at which a motor runs away
    encoder_lines: int = 10_000  # N, lines a turn; 4 N counts
    period_s: float = 1.0e-4  # T, time between samples, s
    gains: tuple[float, float, float] = (12.5, 245.0, 0.0)  # KP, KD, KI as the card's commands take them
    volts_per_count: float = 3.0e-4  # Kd, V; 20/65536 as the manual rounds it
    voltage_limit: float = 10.0  # Largest output either way, V
    coulomb_friction: float = 2.0e-3  # N m; N m s/rad
    viscous_friction: float = 0.0
    cogging_torque: float = 0.0  # Amplitude, N m
    cogging_periods: int = 24  # Periods a turn
    quantise: bool = True  # False gives an encoder without steps, for comparison with the linear loop

    def __post_init__(self) -> None:
        for name in (*_POSITIVE, "payload_inertia", "coulomb_friction", "viscous_friction", "cogging_torque"):
            value, wanted = getattr(self, name), "a positive number" if name in _POSITIVE else "zero or more"
            if not (math.isfinite(value) and value >= 0.0) or (value == 0.0 and name in _POSITIVE):
                raise InputError(f"servo {name}: wanted {wanted}, got {value}; give the loop's own figure")

    @property
    def counts_per_turn(self) -> int:
        """Encoder counts in one turn: four a line."""
        return 4 * self.encoder_lines

    @property
    def counts_per_rad(self) -> float:
        """Kf = 4N/2pi, counts/rad."""
        return self.counts_per_turn / (2.0 * math.pi)


def resting_coefficients(servo: ServoSettings) -> Coefficients:
    """Return the kernel's coefficients for a healthy card with its motor off."""
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
        quantise=servo.quantise,
        stride=max(1, round(1e-3 / servo.period_s)),
    )


# ---- axes


class MotorAxis:
    """One shaft with motor, encoder and sampled loop."""

    def __init__(self, servo: ServoSettings, history_s: float = 1200.0) -> None:
        self.servo = servo
        self.coefficients: Coefficients = resting_coefficients(servo)
        self.values: FloatArray = np.zeros(k.SIZE)
        length = max(16, round(history_s / (self.coefficients.stride * servo.period_s)))
        self._log: FloatArray = np.zeros((3, length))  # time, angle, rate: a ring
        self.values[k.LOGGED] = 1.0  # the axis at rest at time zero

    def change(self, **coefficients: Any) -> None:
        """Change coefficients of the loop or the state of its parts from the next sample on."""
        self.coefficients = self.coefficients._replace(**coefficients)

    def warm(self) -> None:
        """Compile the loop, so that the first look does not wait for it."""
        k.servo(np.zeros(k.SIZE), self.coefficients, np.zeros(2), np.zeros(2), np.zeros(2), 2)

    def advance(self, time: float) -> int:
        """Bring the axis up to a moment, or to the first event before it."""
        samples = int((time - self.values[k.TIME]) / self.coefficients.period + 1e-6)
        if samples <= 0:
            return k.NOTHING
        return int(k.servo(self.values, self.coefficients, self._log[0], self._log[1], self._log[2], samples))

    @property
    def time(self) -> float:
        """Emulated time that the axis has reached, s."""
        return float(self.values[k.TIME])

    @property
    def register(self) -> int:
        """Position register, counts: what TP tells."""
        return round(float(self.values[k.COUNT]) + self.coefficients.offset)

    def define(self, counts: int) -> None:
        """Call where the axis stands a number; the axis and its loop notice nothing."""
        shift = counts - (self.values[k.COUNT] + self.coefficients.offset)
        self.values[k.REFERENCE] += shift
        self.change(offset=self.coefficients.offset + shift)

    def states(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where the axis was: times (n,) s -> (n,) rad."""
        t = np.asarray(times, float)
        time, angle, rate = self.history(max(self.time - t.min(initial=self.time), 0.0) + 0.1)
        if t.size and (t.max() > time[-1] + self.coefficients.period or t.min() < time[0]):
            raise InputError(
                f"axis state: wanted times in {time[0]:.4f}..{time[-1]:.4f} s, got {t.min():.4f}..{t.max():.4f} s; "
                "ask for what has been emulated and is still kept"
            )
        right = np.clip(np.searchsorted(time, t), 1, len(time) - 1)
        left = right - 1
        h = np.maximum(time[right] - time[left], 1e-12)  # at time zero there is one moment
        u = (t - time[left]) / h
        rise = angle[right] - angle[left]
        v0, v1 = rate[left] * h, rate[right] * h
        square, cube = 3.0 * rise - 2.0 * v0 - v1, v0 + v1 - 2.0 * rise
        return (angle[left] + u * (v0 + u * (square + u * cube)), (v0 + u * (2.0 * square + 3.0 * u * cube)) / h)

    def history(self, last_s: float | None = None) -> FloatArray:
        """Return the kept past, the present last: time, angle and rate, (3, n) s, rad, rad/s."""
        size, logged = self._log.shape[1], int(self.values[k.LOGGED])
        kept = min(size, logged)
        if last_s is not None:
            kept = min(kept, int(last_s / (self.coefficients.period * self.coefficients.stride)) + 3)
        log = self._log[:, np.arange(logged - kept, logged) % size]
        present = self.values[[k.TIME, k.ANGLE, k.RATE]]
        return log if log[0, -1] >= present[0] else np.column_stack((log, present))
