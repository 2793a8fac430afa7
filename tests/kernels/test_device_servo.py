"""The servo kernel against a plain twin, and the corners of its profile and its friction."""

import math

import numpy as np
import pytest
from numba import njit
from scipy.signal import lfilter

from undrift.kernels import device as k
from undrift.sim.rig.axes import MotorAxis, ServoSettings, resting_coefficients


def twin(servo: ServoSettings, target: float, samples: int) -> np.ndarray:
    """Return the angle at each sample of a jog, by the equations as they stand in DOMAIN 3.2."""
    t, kf = servo.period_s, servo.counts_per_rad
    kp, kd, ki = servo.gains
    angle = rate = reference = speed = last = total = 0.0
    out = []
    for _ in range(samples):
        count = math.floor(angle * kf)
        before = speed
        speed = min(target, speed + 256_000.0 * t)
        reference += 0.5 * (before + speed) * t
        error = math.floor(reference) - count
        total += error
        volts = servo.volts_per_count * (4 * kp * error + 4 * kd * (error - last) + 0.5 * ki * total)
        last = error
        volts = min(max(volts, -servo.voltage_limit), servo.voltage_limit)
        torque = servo.torque_constant * servo.amplifier_gain * volts - servo.viscous_friction * rate
        torque -= servo.cogging_torque * math.sin(servo.cogging_periods * angle)
        alpha = torque / (servo.inertia + servo.payload_inertia)
        angle += rate * t + 0.5 * alpha * t * t
        rate += alpha * t
        out.append(angle)
    return np.array(out)


def test_a_jog_equals_the_plain_twin():
    servo = ServoSettings(
        gains=(12.5, 245.0, 0.5), coulomb_friction=0.0, viscous_friction=1e-4, cogging_torque=1e-3, payload_inertia=5e-5
    )
    axis = MotorAxis(servo)
    axis.change(motor_on=True)
    axis.values[k.MODE], axis.values[k.TARGET] = k.JOG, 5_000.0
    angles = []
    for _ in range(3000):
        axis.advance(axis.time + servo.period_s)
        angles.append(axis.values[k.ANGLE])
    assert np.abs(np.array(angles) - twin(servo, 5_000.0, 3000)).max() < 1e-9  # rounding, through floor of the count


@njit
def followed_to_its_end(state, c, way):
    """Return the greatest speed, change of speed in a sample, and place along the way, until the motion ends."""
    fastest = steepest = furthest = 0.0
    for _ in range(100_000):
        before = state[k.SPEED]
        done = k.profile(state, c)
        fastest, steepest = max(fastest, abs(state[k.SPEED])), max(steepest, abs(state[k.SPEED] - before))
        furthest = max(furthest, state[k.REFERENCE] * way)
        if done:
            break
    return fastest, steepest, furthest


@pytest.mark.parametrize("distance", [1.0, -1.0, 7.0, 400.0, -40_000.0, 123_457.0])
@pytest.mark.parametrize("slew", [2.0, 2_000.0, 25_000.0])
def test_a_move_ends_on_its_target_without_passing_it(distance, slew):
    distance = math.copysign(
        min(abs(distance), 5.0 * slew), distance
    )  # short, as the tests also run without the compiler
    state = np.zeros(k.SIZE)
    c = resting_coefficients(ServoSettings())._replace(slew=slew, motor_on=True)
    state[k.MODE], state[k.TARGET] = k.MOVE, distance
    fastest, steepest, furthest = followed_to_its_end(state, c, math.copysign(1.0, distance))
    assert furthest <= abs(distance) + 1e-6
    assert state[k.REFERENCE] == distance
    assert state[k.SPEED] == 0.0
    assert fastest <= slew + 1e-9
    assert steepest <= 1.51 * c.acceleration * c.period  # the last sample rounds


def test_a_reversed_jog_rests_at_zero_before_it_turns():
    c = resting_coefficients(ServoSettings())._replace(acceleration=100.0, deceleration=300.0, period=0.01)
    assert k.approach(5.0, -10.0, 1.0, 3.0) == 2.0
    assert k.approach(2.0, -10.0, 1.0, 3.0) == 0.0
    assert k.approach(0.0, -10.0, 1.0, 3.0) == -1.0
    assert k.approach(8.0, 4.0, 1.0, 3.0) == 5.0
    assert k.approach(-4.0, -4.5, 1.0, 3.0) == -4.5
    assert c.deceleration * c.period == 3.0


def test_friction_stops_a_coasting_axis_and_holds_it():
    servo = ServoSettings(coulomb_friction=2e-3)
    axis = MotorAxis(servo)
    axis.values[k.RATE] = 1.5
    axis.advance(1.0)
    assert axis.values[k.RATE] == 0.0
    assert axis.values[k.ANGLE] == pytest.approx(1.5**2 / (2.0 * 10.0), rel=1e-6)  # omega^2 J / (2 torque)
    rested = axis.values[k.ANGLE]
    axis.advance(2.0)
    assert axis.values[k.ANGLE] == rested


def test_an_axis_without_friction_swings_in_its_cogging_and_keeps_its_energy():
    servo = ServoSettings(coulomb_friction=0.0, cogging_torque=1e-3, cogging_periods=10)
    axis = MotorAxis(servo)
    axis.values[k.ANGLE] = 0.1
    start = -1e-3 / 10 * math.cos(1.0)
    axis.advance(5.0)
    energy = 0.5 * servo.inertia * axis.values[k.RATE] ** 2 - 1e-3 / 10 * math.cos(10 * axis.values[k.ANGLE])
    assert axis.values[k.RATE] != 0.0
    assert abs(energy - start) < 0.1 * 1e-4  # the sampled torque gains a little


def test_a_runaway_is_bounded_by_the_supply():
    servo = ServoSettings(coulomb_friction=0.0)
    axis = MotorAxis(servo)
    axis.change(motor_on=True, encoder_good=False, error_limit=math.inf)
    axis.values[k.MODE], axis.values[k.TARGET] = k.JOG, 10_000.0
    axis.advance(5.0)
    fastest = servo.supply_voltage / servo.torque_constant  # where the motor's own voltage is all of the supply
    assert 0.95 * fastest < axis.values[k.RATE] <= fastest + 1e-6


def test_a_gauss_markov_process_has_the_bits_of_a_filter_and_goes_on_from_its_state() -> None:
    draws, sd = np.random.default_rng(1).standard_normal((50, 3)), np.array([0.1, 1.0, 7.0])
    keep, fresh = 0.97, math.sqrt(1.0 - 0.97**2)
    scaled = np.concatenate((draws[:1], fresh * draws[1:]))  # from a stationary start
    wanted = 1.0 + sd * lfilter([1.0], [1.0, -keep], scaled, axis=0)
    whole, halves, states = np.ones((50, 3)), np.ones((50, 3)), (np.zeros(3), np.zeros(3))
    k.add_process(draws, keep, fresh, True, sd, states[0], whole)
    for part in (slice(0, 20), slice(20, 50)):
        k.add_process(draws[part], keep, fresh, part.start == 0, sd, states[1], halves[part])
    np.testing.assert_array_equal(whole, wanted)
    np.testing.assert_array_equal(halves, wanted)
