"""Ten poses of 3 to 7 s held in the hand, from a support to a strong tremor, are found and calibrate the device."""

import numpy as np
import pytest

from testkit.data import show
from testkit.hand_held import Tremor, hand_held_log
from undrift.calibration.calibrate import calibrate
from undrift.errors import NotObservable
from undrift.record import Record, Session
from undrift.segments import find_poses, find_still

# Postural tremor of a hand with a phone: about 1 deg/s and 0.05 m/s2; a strong one is four times that.
TREMORS = {
    "supported": Tremor(rate_dps=0.1, sway_deg=0.02, accel=0.01),
    "light": Tremor(rate_dps=0.7, sway_deg=0.15, accel=0.04),
    "medium": Tremor(rate_dps=1.5, sway_deg=0.4, accel=0.1),
    "strong": Tremor(rate_dps=3.0, sway_deg=1.0, accel=0.25),
    "severe": Tremor(rate_dps=6.0, sway_deg=1.5, accel=0.6),
}


def found_again(record, spans):
    """Return how many poses hold a still, and how many stills lie in no pose."""
    middles = [0.5 * (record.time[s.start] + record.time[s.stop - 1]) for s in find_poses((record,))[0].stills]
    inside = np.array([[a <= m <= b for m in middles] for a, b in spans])
    return int(inside.any(axis=1).sum()), int((~inside.any(axis=0)).sum())


def session_of(*records):
    return Session(kind="calibration", serial="", gravity_m_s2=9.81, records=records)


@pytest.mark.slow
@pytest.mark.parametrize("sample_rate_hz", [100.0, 25.0])
@pytest.mark.parametrize("level", TREMORS)
def test_ten_poses_in_a_hand_are_found_at_every_tremor(level, sample_rate_hz):
    counts = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        counts.append(found_again(*hand_held_log(rng, TREMORS[level], sample_rate_hz=sample_rate_hz)))
    show(f"{level:9} {sample_rate_hz:3.0f} Hz: poses found of 10, stills elsewhere", counts, "9 or 10, 1")
    assert min(result for result, _ in counts) >= 9
    assert max(elsewhere for _, elsewhere in counts) <= 1
    assert np.mean([result for result, _ in counts]) > 9.6


@pytest.mark.slow
@pytest.mark.parametrize("level", ["light", "medium", "strong"])
def test_a_hand_held_log_calibrates_the_accelerometer(level):
    record, _ = hand_held_log(np.random.default_rng(2), TREMORS[level], poses=12)
    calibration = calibrate(session_of(record))
    error = np.abs(calibration.accel.matrix - np.eye(3)).max()
    show(f"{level}: largest element error of the matrix, verdict", (f"{error:.1e}", calibration.verdict.status), 2e-3)
    assert calibration.accel.method.startswith("multi-position")
    # 0.25 m/s2 of tremor at 9 Hz, averaged over 3 s and more, and 1 deg of sway, which gravity's length does not see
    assert error < 2e-3


def test_white_noise_over_the_limits_of_a_bench_hides_no_rest():
    """At rest throughout, with white noise of 2 deg/s and 0.3 m/s2 a sample at 25 Hz."""
    rng = np.random.default_rng(6)
    record = Record(
        time=np.arange(1500) / 25.0,
        gyro=np.radians(2.0) * rng.standard_normal((1500, 3)),
        accel=[0.0, 0.0, 9.81] + 0.3 * rng.standard_normal((1500, 3)),
    )
    assert sum(s.stop - s.start for s in find_still(record).stills) > 1400


def test_walk_gives_no_poses_in_its_slow_moments():
    rng = np.random.default_rng(7)
    time = np.arange(6000) / 100.0
    stride = np.sin(2.0 * np.pi * 0.9 * time + 0.3 * np.sin(0.7 * time))
    accel = np.column_stack((2.0 * stride, 0.5 * np.roll(stride, 30), 9.81 + 3.0 * np.roll(stride, 60)))
    record = Record(
        time=time,
        gyro=np.column_stack((0.3 * stride, 1.5 * np.roll(stride, 20), 0.2 * stride))
        + 0.01 * rng.standard_normal((6000, 3)),
        accel=accel + 0.05 * rng.standard_normal((6000, 3)),
    )
    assert find_poses((record,))[0].stills == ()
    with pytest.raises(NotObservable, match="too restless"):
        calibrate(session_of(record))
