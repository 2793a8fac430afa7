"""Agreement statistics against a published example and closed forms, and several recordings judged together."""

import numpy as np
import pytest
from benchmarks.broad import nominal_calibration

from testkit.data import show
from testkit.hand_turns import Device, make_recording
from undrift.errors import InputError
from undrift.validation.agreement import (
    bland_altman,
    decide_between,
    intraclass_correlation,
    validate_leave_one_out,
    validate_trials,
)
from undrift.validation.trial import TrialSettings

# P. E. Shrout, J. L. Fleiss, 1979, table 2: six targets, four judges; table 4 prints the coefficients.
JUDGES = np.array([[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], dtype=float)


def test_the_published_example_gives_the_published_coefficient():
    found = intraclass_correlation(JUDGES)
    show("ICC(2,1)", round(found.value, 3), 0.29)
    assert found.value == pytest.approx(0.29, abs=0.005)  # printed to two digits
    assert found.interval == pytest.approx((0.02, 0.76), abs=0.006)  # as statistics packages print it, two digits
    sem = np.sqrt((32.49 - 1.02) / 6 + 1.02)  # the paper's mean squares: targets 11.24, judges 32.49, residual 1.02
    assert found.minimal_detectable_change == pytest.approx(1.96 * np.sqrt(2.0) * sem, abs=0.01)


def test_a_wrong_verdict_is_as_rare_as_the_level_says():
    """Differences at the margin, where each verdict but one is wrong; and equal errors, which are equivalent."""
    rng = np.random.default_rng(3)
    draws = 0.15 + 0.2 * rng.normal(size=(1000, 12))
    verdicts = [decide_between(np.zeros(12), draw, margin=0.15).verdict for draw in draws]
    wrong = np.mean([verdict in ("better", "worse") for verdict in verdicts])
    show("better or worse of a difference at the margin", wrong, 0.025)
    assert wrong < 0.05
    assert np.mean([verdict == "equivalent" for verdict in verdicts]) < 0.07
    same = decide_between(0.01 * rng.normal(size=12), 0.01 * rng.normal(size=12), margin=0.15)
    assert same.verdict == "equivalent"
    better = decide_between(0.01 * rng.normal(size=12), 1.0 + 0.01 * rng.normal(size=12), margin=0.15)
    assert (better.verdict, round(better.difference)) == ("better", 1)


def test_limits_of_agreement_follow_the_closed_form():
    first = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    second = first - np.array([0.5, 0.1, -0.3, 0.2, 0.0])
    found = bland_altman(first, second)
    sd = np.std([0.5, 0.1, -0.3, 0.2, 0.0], ddof=1)
    assert found.bias == pytest.approx(0.1)
    assert found.limits == pytest.approx((0.1 - 1.959964 * sd, 0.1 + 1.959964 * sd))
    assert found.count == 5


pytestmark = pytest.mark.usefixtures("computed_once")
FORWARD = np.array([[1.012, 0.006, -0.004], [-0.005, 0.991, 0.007], [0.003, -0.006, 1.004]])
DEVICE = Device(forward=FORWARD, offset=np.array([0.004, -0.003, 0.002]), lag_s=0.004, noise=1e-3)


@pytest.fixture(scope="module")
def pairs():
    return [make_recording(np.random.default_rng(seed), DEVICE, turn_s=40.0, optics_noise=5e-4) for seed in (1, 2, 3)]


def test_each_recording_may_bring_its_calibration(pairs):
    same = validate_trials(pairs, calibrations=[nominal_calibration(record) for record, _ in pairs])
    assert same.mean.rmse_total_deg == pytest.approx(validate_trials(pairs).mean.rmse_total_deg)


@pytest.mark.slow
def test_leave_one_out_beats_the_rest_offset(pairs):
    rest = validate_trials(pairs, settings=TrialSettings(offset="rest"))
    held = validate_leave_one_out(pairs, names=("a", "b", "c"))
    assert len(held.held_out) == 3
    assert held.trials[1].recording == "b"
    assert held.mean.end_total_deg < 0.25 * rest.mean.end_total_deg
    assert held.mean.end_total_deg < 0.3


def test_calls_that_cannot_be_are_refused(pairs):
    with pytest.raises(InputError, match="got 3 recordings, 2 calibrations, 0 names"):
        validate_trials(pairs, calibrations=(None, None))
    with pytest.raises(InputError, match="two recordings of a device or more"):
        validate_leave_one_out(pairs[:1])
    with pytest.raises(InputError, match="recording 2 has the same readings as recording 1"):
        validate_leave_one_out([pairs[0], pairs[0]])
