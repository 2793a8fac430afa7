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
from undrift.live.hands import TILT_SD, HandHeld
from undrift.live.recorder import Recorder
from undrift.live.transports import source_at
from undrift.record import FACES
from undrift.sim.device.presets import random_device
from undrift.sim.motion.motion import unit_vector
from undrift.units import STANDARD_GRAVITY

DEVICE = random_device(np.random.default_rng(8), grade="consumer")
TURN = 2.0 * math.pi


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
def test_simulated_address_with_another_option_is_refused(address):
    with pytest.raises(InputError, match=r"one|speed above 0|color"):
        source_at(address)
