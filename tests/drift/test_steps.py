"""Rate steps made ready: soaks, mountings, offsets."""

from dataclasses import replace

import numpy as np

from testkit.rate_steps import GRID, computed
from undrift.drift.rate_steps import offset_at, steps_of
from undrift.model import StaticDrift
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration

DEVICE = random_device_of("enc03j_3031", np.random.default_rng(0))


def made(temps=(20.0, 40.0)):
    return computed(DEVICE, np.array(temps), np.random.default_rng(1), rates=GRID[:3])


def test_each_axis_of_each_soak_is_a_mounting_and_both_signs_belong_to_it():
    steps = steps_of(made())
    assert len(np.unique(steps.mounting)) == 6
    for m in range(6):
        own = steps.mounting == m
        assert len(np.unique(steps.soak[own])) == 1
        assert np.array_equal(np.sort(np.degrees(steps.along[own]).round(6)), [-15.0, -10.0, -5.0, 5.0, 10.0, 15.0])


def test_a_wobble_of_the_axis_is_the_same_mounting():
    given = made()
    wobbling = replace(given, rate_b=given.rate_b + 0.01 * np.abs(given.rate_b).max(axis=1, keepdims=True))
    assert len(np.unique(steps_of(wobbling).mounting)) == 6


def test_soaks_of_one_number_in_two_sessions_are_two():
    given = made()
    split = replace(given, session=(np.arange(len(given)) % 2), soak=np.zeros(len(given), int))
    assert len(np.unique(steps_of(split).soak)) == 2


def test_dwells_at_rest_are_no_steps():
    given = made()
    rate = given.rate_b.copy()
    rate[:4] = 0.0
    assert len(steps_of(replace(given, rate_b=rate))) == len(given) - 4


def test_the_offset_is_linear_between_nodes_held_beyond_and_constant_without_a_table():
    calibration = true_calibration(DEVICE)
    table = StaticDrift(temp_c=[20.0, 30.0], gyro_offset=[[0.0, 1.0, 2.0], [10.0, 1.0, 0.0]])
    at = offset_at(np.array([10.0, 25.0, 40.0]), calibration, table)
    assert np.allclose(at, [[0.0, 1.0, 2.0], [5.0, 1.0, 1.0], [10.0, 1.0, 0.0]])
    assert np.array_equal(offset_at(np.array([10.0]), calibration, None)[0], calibration.gyro.offset)
