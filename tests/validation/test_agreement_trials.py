"""Several recordings judged, and fits judged where they were not made."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.broad import nominal_calibration

from testkit.hand_turns import Device, make_recording
from undrift.calibration.codes import device_adc
from undrift.errors import InputError
from undrift.validation.agreement import validate_leave_one_out, validate_trials
from undrift.validation.trial import TrialSettings

pytestmark = pytest.mark.usefixtures("computed_once")

FORWARD = np.array([[1.012, 0.006, -0.004], [-0.005, 0.991, 0.007], [0.003, -0.006, 1.004]])
DEVICE = Device(forward=FORWARD, offset=np.array([0.004, -0.003, 0.002]), lag_s=0.004, noise=1e-3)


@pytest.fixture(scope="module")
def pairs():
    return [make_recording(np.random.default_rng(seed), DEVICE, turn_s=40.0, optics_noise=5e-4) for seed in (1, 2, 3)]


def test_each_recording_may_bring_its_calibration(pairs):
    same = validate_trials(pairs, calibrations=[nominal_calibration(record) for record, _ in pairs])
    none = validate_trials(pairs)
    assert same.mean.rmse_total_deg == pytest.approx(none.mean.rmse_total_deg)


@pytest.mark.slow
def test_leave_one_out_beats_the_rest_offset(pairs):
    rest = validate_trials(pairs, settings=TrialSettings(offset="rest"))
    held = validate_leave_one_out(pairs, names=("a", "b", "c"))
    assert len(held.held_out) == 3
    assert held.trials[1].recording == "b"
    assert held.mean.end_total_deg < 0.25 * rest.mean.end_total_deg
    assert held.mean.end_total_deg < 0.3


def test_the_adc_of_a_device_is_what_its_recordings_say_together(pairs):
    lsb = 1e-2
    records = [replace(r, gyro=np.trunc(r.gyro / lsb) * lsb) for r, _ in pairs]
    found = device_adc(records)
    assert found is not None
    assert found.gyro_rounding == "toward_zero"
    assert found.gyro_lsb == pytest.approx(np.full(3, lsb), rel=1e-6)
    assert device_adc([r for r, _ in pairs]) is None
    rounded = replace(pairs[0][0], gyro=np.round(pairs[0][0].gyro / lsb) * lsb)
    assert device_adc([records[0], rounded]) is None  # one says this, one says that


def test_calls_that_cannot_be_are_refused(pairs):
    with pytest.raises(InputError, match="got 0 recordings, 1 calibrations, 0 names"):
        validate_trials([])
    with pytest.raises(InputError, match="got 3 recordings, 2 calibrations, 0 names"):
        validate_trials(pairs, calibrations=(None, None))
    with pytest.raises(InputError, match="got 3 recordings, 1 calibrations, 1 names"):
        validate_trials(pairs, names=("a",))
    with pytest.raises(InputError, match="two recordings of a device or more are needed, got 1"):
        validate_leave_one_out(pairs[:1])


def test_a_recording_cannot_judge_itself(pairs):
    with pytest.raises(InputError, match="recording 2 has the same readings as recording 1"):
        validate_leave_one_out([pairs[0], pairs[0]])
