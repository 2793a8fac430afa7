"""Runs at the end of the range, and steps too coarse to tell."""

import numpy as np
import pytest

from undrift.calibration.checks import check_range, stuck_windows
from undrift.errors import Implausible

SWING = 3.0 * np.sin(np.arange(2000) / 40.0)[:, None] * np.ones(3)


def noisy(seed=0):
    return SWING + 0.01 * np.random.default_rng(seed).normal(size=SWING.shape)


def test_readings_cut_off_at_the_top_are_named_with_their_axis():
    cut = noisy()
    cut[:, 1] = cut[:, 1].clip(None, 2.5)
    check_range([noisy()], "gyroscope")
    check_range([], "gyroscope")
    with pytest.raises(
        Implausible, match=r"gyroscope: wanted y readings inside the range, got \d+ samples stuck at 2.5"
    ):
        check_range([cut[:1000], cut[1000:]], "gyroscope")


def test_coarse_steps_and_gaps_say_nothing():
    check_range([np.round(noisy())], "gyroscope")
    check_range([np.full((50, 3), np.nan)], "gyroscope")


def test_the_rounded_top_of_a_turn_is_no_end_of_the_range():
    turn = np.round(2000.0 * np.sin(np.linspace(0.0, np.pi, 620)))[:, None] * np.ones(3)
    assert (turn == turn.max()).sum() >= 3 * 5  # a run long enough to be taken for one
    check_range([turn], "gyroscope in the turn about z")
    with pytest.raises(Implausible, match="stuck at 1990"):
        check_range([turn.clip(None, 1990.0)], "gyroscope in the turn about z")


def test_a_reading_that_jumps_to_the_end_of_the_range_is_seen_among_coarse_codes_at_rest():
    """Codes of a rest repeat for long, but no code is left and reached in one sample from far away."""
    coarse = np.round(np.concatenate((np.zeros((300, 3)), 100.0 * noisy(), np.zeros((300, 3)))))
    check_range([coarse], "gyroscope")
    spoilt = coarse.copy()
    spoilt[1000:1010, 0] = -32768.0
    with pytest.raises(Implausible, match=r"gyroscope: wanted x .* got 10 samples stuck at -32768"):
        check_range([spoilt], "gyroscope")
    assert stuck_windows([coarse[:1000], spoilt[900:1100], coarse[1000:]]).tolist() == [False, True, False]


def test_samples_that_are_held_are_no_end_of_the_range():
    check_range([np.repeat(100.0 * noisy(), 6, axis=0)], "gyroscope")


def test_a_pose_that_sticks_as_a_whole_is_seen_among_the_others():
    rng = np.random.default_rng(1)
    poses = [up + 0.02 * rng.normal(size=(200, 3)) for up in 9.81 * np.vstack((np.eye(3), -np.eye(3)))]
    check_range(poses, "accelerometer")
    with pytest.raises(Implausible, match=r"accelerometer: wanted x .* stuck at 9\.5"):
        check_range([pose.clip(None, 9.5) for pose in poses], "accelerometer")
