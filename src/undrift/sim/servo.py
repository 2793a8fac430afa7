"""Servo of the note: motor, amplifier, encoder, sampled position loop and moves.

::

    e    = reference - count                               counts
    V    = clip(Kd (4 KP e + 4 KD (e - e_last)), 10)        filter and converter, Kd volts a count
    i    = Ka V, within (+-12 V - Kt omega) / R             current amplifier
    J alpha = Kt i - friction                               motor and table
    count = floor(4 N angle / 2 pi)                         encoder of N lines
"""

import math

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import check_positive
from undrift.sim.kernels import ANGLE, ERROR, SAMPLES, ServoSettings, servo

LOG_S = 1e-3  # time between two returned angles, s


class Servo:
    """A shaft with its control loop, which advances when it is read. It starts at rest with the motor off."""

    def __init__(self, settings: ServoSettings = ServoSettings()) -> None:
        names = ("torque_constant", "inertia", "resistance", "amplifier_gain", "supply_voltage", "encoder_lines")
        check_positive(settings, "servo", "Enter the parameter of the control loop", *names, "period_s")
        self.settings, self.powered = settings, False
        self._state, self._stride = np.zeros(4), max(1, round(LOG_S / settings.period_s))
        self._profile = np.zeros((1, 4))

    @property
    def step_s(self) -> float:
        """Time between two angles that ``advance`` returns, s."""
        return self._stride * self.settings.period_s

    @property
    def time(self) -> float:
        """Current simulation time, s."""
        return float(self._state[SAMPLES]) * self.settings.period_s

    @property
    def count(self) -> int:
        """Counts of the encoder since the start."""
        return math.floor(float(self._state[ANGLE]) * self.settings.counts_per_rad)

    @property
    def error(self) -> float:
        """Commanded minus actual position, counts."""
        return float(self._state[ERROR])

    def advance(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Advance to a given time or slightly beyond. Return the times (n,), s, and angles (n,), rad, of the steps."""
        count = max(math.ceil((time - self.time) / self.step_s - 1e-6), 0)
        times, angles = self.time + self.step_s * np.arange(1, count + 1), np.empty(count)
        servo(self._state, self.settings, self.powered, self._profile, self._stride, angles)
        return times, angles

    @property
    def moving(self) -> bool:
        """Return True if the reference moves, because a turn or a deceleration to rest is not complete."""
        return self.time < float(self._profile[-1, 0])

    def reference(self) -> tuple[float, float]:
        """Return the commanded position and speed, counts and counts/s."""
        start, position, speed, acceleration = self._profile[np.searchsorted(self._profile[1:, 0], self.time, "right")]
        u = self.time - start
        return float(position + u * (speed + 0.5 * u * acceleration)), float(speed + u * acceleration)

    def switch(self, on: bool) -> None:
        """Switch the motor on (at the current position of the axis) or off."""
        self._follow((0.0, self.count, 0.0, 0.0))
        self.powered, self._state[ERROR] = on, 0.0

    def turn(self, speed: float, duration_s: float, acceleration: float) -> None:
        """Turn at a speed, counts/s, for a given time including ramps, counts/s2, and then rest."""
        position, way = self.reference()[0], math.copysign(acceleration, speed)
        ramp_s = abs(speed) / acceleration
        held_s = duration_s - 2.0 * ramp_s
        ramp = 0.5 * speed * ramp_s
        self._follow(
            (0.0, position, 0.0, way),
            (ramp_s, position + ramp, speed, 0.0),
            (ramp_s + held_s, position + ramp + speed * held_s, speed, -way),
            (duration_s, position + 2.0 * ramp + speed * held_s, 0.0, 0.0),
        )

    def slow_down(self, acceleration: float) -> float:
        """Decelerate to rest and return the duration, s."""
        position, speed = self.reference()
        ramp_s = abs(speed) / acceleration
        rest = (ramp_s, position + 0.5 * speed * ramp_s, 0.0, 0.0)
        self._follow((0.0, position, speed, -math.copysign(acceleration, speed)), rest)
        return ramp_s

    def _follow(self, *rows: tuple[float, float, float, float]) -> None:
        self._profile = np.array(rows)
        self._profile[:, 0] += self.time
