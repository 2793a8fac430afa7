"""The servo of a simulated table: the loop against a plain twin, finite moves that end where they should, friction that holds."""

import math

import numpy as np
import pytest

from undrift.sim.kernels import ServoSettings
from undrift.sim.servo import Servo

RATE, ACCELERATION = 10_000.0, 256_000.0  # counts/s, counts/s2


def twin(s: ServoSettings, samples: int) -> np.ndarray:
    """Return the angle after each sample of a run-up, by the equations as they stand in the module."""
    t, kf = s.period_s, s.counts_per_rad
    angle = rate = last = 0.0
    out = []
    for k in range(samples):
        error = math.floor(0.5 * ACCELERATION * (k * t) ** 2) - math.floor(angle * kf)
        volts = 3e-4 * (4 * s.gains[0] * error + 4 * s.gains[1] * (error - last))
        last = error
        torque = s.torque_constant * s.amplifier_gain * min(max(volts, -10.0), 10.0)
        after = rate + torque / s.inertia * t
        angle, rate = angle + 0.5 * (rate + after) * t, after
        out.append(angle)
    return np.array(out)


def moved(settings: ServoSettings = ServoSettings(), seconds: float = 2.0) -> tuple[Servo, np.ndarray, np.ndarray]:
    servo = Servo(settings)
    servo.switch(True)
    servo.turn(RATE, seconds, ACCELERATION)
    return (servo, *servo.advance(seconds + 0.5))


def test_a_run_up_equals_the_plain_twin():
    settings = ServoSettings(friction=1e-300)
    servo = Servo(settings)
    servo.switch(True)
    servo.turn(RATE, 2.0, ACCELERATION)
    times, angles = servo.advance(0.03)  # within the run-up
    assert angles == pytest.approx(twin(settings, 300)[9::10], abs=1e-9)
    assert times == pytest.approx(0.001 * np.arange(1, 31))


def test_a_move_ends_by_itself_after_the_angle_that_its_time_makes():
    servo, times, angles = moved()
    assert servo.error == pytest.approx(0.0, abs=30.0)
    wanted = RATE * (2.0 - RATE / ACCELERATION)
    assert angles[-1] * servo.settings.counts_per_rad == pytest.approx(wanted, abs=30.0)
    assert np.ptp(angles[times > 2.2]) == 0.0  # friction holds it
    steady = (times > 0.5) & (times < 1.5)
    slope = np.polyfit(times[steady], angles[steady], 1)[0]
    assert slope * servo.settings.counts_per_rad == pytest.approx(RATE, rel=1e-4)


def test_it_slows_down_when_asked_and_coasts_to_rest_without_power():
    for powered in (True, False):
        servo = Servo()
        servo.switch(True)
        servo.turn(RATE, 20.0, ACCELERATION)
        servo.advance(1.0)
        if powered:
            assert servo.slow_down(ACCELERATION) == pytest.approx(RATE / ACCELERATION)
        else:
            servo.powered = False
        _, angles = servo.advance(3.0)
        assert np.ptp(angles[-100:]) == 0.0
        assert servo.reference()[1] == pytest.approx(0.0 if powered else RATE)
