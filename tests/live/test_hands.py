"""The device in an operator's hands: gravity and rates agree, it rests when it rests, and it does what it is asked."""

import math

import numpy as np
import pytest

from testkit.quiet import without_noise
from testkit.virtual_clock import VirtualClock
from testkit.waiting import eventually
from undrift.base.clock import Clock
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotate
from undrift.live.hands import ANGLE_SD, TILT_SD, HandHeld
from undrift.live.recorder import Recorder
from undrift.live.transports import source_at
from undrift.record import FACES
from undrift.sim.device.presets import random_device
from undrift.sim.motion.motion import unit_vector
from undrift.units import STANDARD_GRAVITY

DEVICE = random_device(np.random.default_rng(8), grade="consumer")
TURN = 2.0 * math.pi
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def held():
    with HandHeld(seed=4, device=DEVICE, clock=VirtualClock()) as made:
        yield made


def truth(held, duration_s, step_s=0.01):
    """Go on, and return moments, rate, mean rate over each step, and force (N, 3)."""
    start = held.clock.now()
    held.clock.wait(duration_s)
    times = start + step_s * np.arange(1, round(duration_s / step_s) + 1)
    rate, _, force, mean, _ = held._seen(times, 0.01)
    held.read()
    return times, rate, mean, force


@pytest.mark.parametrize("face", FACES)
def test_a_device_that_was_laid_on_a_face_rests_there_and_feels_gravity(held, face):
    held.lay(face)
    assert held.moving
    assert held.face == face
    truth(held, 4.0)
    assert not held.moving
    _, rate, mean, force = truth(held, 1.0)
    assert np.abs(rate).max() < 1e-9
    assert np.abs(mean).max() < 1e-9
    assert np.ptp(force, axis=0).max() == 0.0
    assert np.linalg.norm(force[0]) == pytest.approx(STANDARD_GRAVITY, rel=1e-12)
    tilt = math.acos(force[0] @ unit_vector(face) / STANDARD_GRAVITY)
    assert 0.0 < tilt < 5.0 * TILT_SD * math.sqrt(2.0)  # two axes, five standard deviations


@pytest.mark.slow
def test_a_face_is_off_level_by_another_tilt_each_time(held):
    tilts = []
    for face in ("+x", "+z") * 20:
        held.lay(face)
        truth(held, 4.0)
        if face == "+x":
            tilts.append(truth(held, 0.1)[3][0, 1:] / STANDARD_GRAVITY)
    # sd of 40 draws is known to 1 / sqrt(80) = 11 %: within four of these
    assert np.std(tilts) == pytest.approx(TILT_SD, rel=0.45)


@pytest.mark.parametrize(
    "asked", [lambda h: h.lay("-z"), lambda h: h.turn("z", -TURN), lambda h: h.turn("x", 2.0 * TURN)]
)
def test_what_the_gyroscopes_feel_turns_gravity_as_the_accelerometers_feel_it(held, asked):
    before = truth(held, 0.6)[3][-1]
    asked(held)
    _, _, mean, force = truth(held, 12.0)
    q = np.array([1.0, 0.0, 0.0, 0.0])  # from where it lay
    for step in mean:
        q = quaternion_product(q, quaternion_of(step * 0.01))
    assert not held.moving
    assert rotate(quaternion_conjugate(q), before) == pytest.approx(force[-1], abs=1e-8 * STANDARD_GRAVITY)


def test_a_rate_is_the_mean_rate_of_a_short_step(held):
    held.turn("y", TURN)
    _, rate, _, _ = truth(held, 3.0, step_s=0.001)
    with HandHeld(seed=4, device=DEVICE, clock=VirtualClock()) as other:
        other.turn("y", TURN)
        other.clock.wait(3.0)
        # the mean over a step ends at the moment: behind by half of it
        mean = other._seen(0.001 * np.arange(1, 3001), 1e-5)[3]
    # the rate changes by up to 1 rad/s of tremor and turn within 1/20 s: half of 1e-5 s makes 1e-4 rad/s
    assert mean == pytest.approx(rate, abs=5e-4)


@pytest.mark.slow
def test_a_turn_is_by_the_angle_about_the_axis_but_for_what_hands_err(held):
    errors = []
    for axis in ("x", "y", "z") * 6:
        held.lay(f"+{axis}")
        truth(held, 4.0)
        held.turn(axis, TURN)
        _, _, mean, _ = truth(held, 7.0)
        assert not held.moving
        turned = mean.sum(axis=0) * 0.01
        errors.append(turned["xyz".index(axis)] - TURN)
        assert np.delete(mean, "xyz".index(axis), axis=1).max() < 0.3 * mean.max()
    # angle errors of 18 turns: sd within 17 %, four of these, and a cosine of the axis' lean that is below 1e-3
    assert np.std(errors) == pytest.approx(ANGLE_SD, rel=0.7)
    assert np.abs(errors).max() < 5.0 * ANGLE_SD


def test_a_slow_gyroscope_is_turned_within_its_range():
    slow = random_device(np.random.default_rng(2), grade="enc03j_3031")
    with HandHeld(seed=4, device=slow, clock=VirtualClock()) as held:
        held.turn("z", TURN)
        assert np.abs(truth(held, 20.0)[1]).max() < slow.gyro.full_scale


def test_the_readings_do_not_depend_on_how_often_the_device_is_looked_at():
    said = []
    for steps in ([3.0], [0.07] * 30 + [0.9]):
        with HandHeld(seed=4, device=without_noise(DEVICE), clock=VirtualClock()) as held:
            rows = []
            held.turn("x", TURN)
            for step in steps:
                held.clock.wait(step)
                rows.append(held.read()[1])
            said.append(np.vstack(rows))
    assert len(said[0]) == 300
    # the last step of one chunk is the first of the next: the change of the rate between them is that of the chunk
    assert said[1] == pytest.approx(said[0], rel=1e-9, abs=1e-6)


def test_moves_that_are_asked_for_at_once_follow_each_other_and_only_a_few_wait(held):
    for face in ("+x", "-x") * 8:
        held.lay(face)
    with pytest.raises(InputError, match=r"at most 16 moves"):
        held.lay("+y")
    truth(held, 80.0)
    assert truth(held, 0.1)[3][0, 0] == pytest.approx(-STANDARD_GRAVITY, rel=1e-3)
    held.clock.wait(60.0)
    held.lay("+y")
    assert len(held.moves) == 2  # what is over is forgotten


def test_what_cannot_be_is_refused(held):
    with pytest.raises(InputError, match=r"face: .*\+x, .*, got 'up'"):
        held.lay("up")
    for axis, angle in (("z", 1.0), ("w", TURN), ("z", 0.0), ("z", 11.0 * TURN)):
        with pytest.raises(InputError, match=r"1 to 10 whole turns, got '"):
            held.turn(axis, angle)


def test_its_address_is_read_by_live_at_the_speed_it_has():
    with (
        HandHeld(seed=4, device=DEVICE, clock=Clock.started(10.0)) as held,
        Recorder(source_at(held.address)) as recorder,
    ):
        start = recorder.now()
        held.lay("-x")
        eventually(lambda: not held.moving and recorder.now() > start + 1.0, "the device rests")
        record = recorder.between(start, recorder.now())
    assert record.device == DEVICE.serial
    assert record.sample_rate_hz == pytest.approx(held.description.rate)
    assert record.duration_s > 8.0
    assert record.accel[-1, 0] == pytest.approx(-DEVICE.accel.gain * STANDARD_GRAVITY, rel=0.05)
    assert recorder.timeline.marker.missing == 0
    with pytest.raises(InputError, match=r"unknown device 'simulated:\d+'"):
        source_at(held.address)


def test_a_device_that_nobody_holds_is_laid_on_all_faces_and_turned_about_all_axes():
    clock = VirtualClock()
    with HandHeld(seed=4, device=without_noise(DEVICE), clock=clock) as held:
        held.follow()
        rested = set()
        turned = np.zeros(3)
        while held.moving:
            _, rate, _, force = truth(held, 1.0)
            if np.abs(rate).max() < 1e-6:
                axis = int(np.argmax(np.abs(force[0])))
                rested.add("+-"[int(force[0, axis] < 0.0)] + "xyz"[axis])
            else:
                turned += np.abs(rate.sum(axis=0)) * 0.01
    assert rested == set(FACES)
    assert (turned > 2.0 * TURN * 0.9).all()


@pytest.mark.parametrize("address", ["simulated:?seed=one", "simulated:?clock_speed=0", "simulated:?color=red"])
def test_an_address_that_says_something_else_is_refused(address):
    with pytest.raises(InputError, match=r"simulated:\?seed=1&clock_speed=2"):
        source_at(address)


def test_a_device_is_drawn_from_the_seed_or_anew():
    with HandHeld(seed=5) as one, HandHeld(seed=5) as same, HandHeld() as other:
        assert one.device.serial == same.device.serial != other.device.serial
