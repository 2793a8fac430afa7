"""A recording is held to its calibration."""

from dataclasses import replace

import numpy as np
import pytest

import undrift
from testkit.data import show
from undrift import Record
from undrift.correction.consistency import check_device
from undrift.units import STANDARD_GRAVITY


@pytest.fixture(scope="module")
def bench():
    rng = np.random.default_rng(11)
    devices = [undrift.random_device(rng) for _ in range(4)]
    calibrations = [undrift.calibrate(undrift.simulate_session("bench", device, rng=rng)) for device in devices]
    trials = [undrift.simulate_trial("sit_to_stand", device, rng=rng).record for device in devices]
    return calibrations, trials


def codes(calibration: undrift.Calibration, record: Record) -> list[str]:
    done = undrift.correct_checked(record, calibration)
    return [one.code for one in check_device(done.record, calibration)]


@pytest.mark.slow
def test_the_own_calibration_raises_no_suspicion(bench):
    for calibration, record in zip(*bench, strict=True):
        assert codes(calibration, record) == []


@pytest.mark.slow
def test_the_calibration_of_another_device_is_questioned(bench):
    calibrations, trials = bench
    seen = [codes(calibrations[k], trials[(k + 1) % 4]) for k in range(4)]
    show("questioned of 4", sum(one == ["correct.other_device"] for one in seen))
    assert all(one == ["correct.other_device"] for one in seen)


@pytest.mark.slow
def test_readings_with_the_opposite_sign_are_named_where_the_calibration_has_an_offset():
    rng = np.random.default_rng(5)
    device = undrift.random_device(rng)
    calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    record = undrift.simulate_trial("sit_to_stand", device, rng=rng).record
    offset_g = np.linalg.norm(calibration.accel.matrix @ calibration.accel.offset) / STANDARD_GRAVITY
    assert offset_g > 0.02, "the device that was drawn must have an offset to tell by"
    assert codes(calibration, replace(record, accel=-record.accel)) == ["correct.accel_reversed"]
