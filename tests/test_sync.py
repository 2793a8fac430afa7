"""Sync: lag, native frames, motion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from testkit.hand_turns import Device, hidden, later, make_recording, upsampled
from undrift.errors import AlignmentError, InputError
from undrift.record import Reference
from undrift.sync import find_lag, find_motion, in_step, native_poses, seen_poses

FORWARD = np.array([[1.02, 0.01, -0.004], [-0.006, 0.97, 0.012], [0.003, -0.008, 1.01]])


@pytest.fixture(scope="module")
def pair():
    device = Device(forward=FORWARD, offset=np.array([0.01, -0.02, 0.005]), lag_s=0.00714)
    return make_recording(np.random.default_rng(1), device, turn_s=40.0)


def test_a_lag_of_a_fraction_of_a_sample_is_found_without_noise(pair):
    lag = find_lag(*pair)
    # 1/1000 of a sample; straight lines between samples leave more
    assert lag.seconds == pytest.approx(0.00714, abs=5e-6)
    assert lag.correlation > 0.99999
    assert np.allclose(lag.matrix, np.linalg.inv(FORWARD), atol=2e-4)
    assert np.allclose(lag.constant, -np.linalg.inv(FORWARD) @ (0.01, -0.02, 0.005), atol=2e-4)


def test_a_mounting_of_any_angle_does_not_disturb_the_lag():
    mounting = Rotation.from_rotvec((1.4, -0.8, 2.0))
    record, reference = make_recording(np.random.default_rng(2), Device(lag_s=0.0123), turn_s=30.0, mounting=mounting)
    lag = find_lag(record, reference)
    assert lag.seconds == pytest.approx(0.0123, abs=5e-6)
    assert np.allclose(lag.matrix, mounting.as_matrix(), atol=1e-3)


@pytest.mark.slow
def test_noise_moves_the_lag_by_its_standard_uncertainty():
    z = []
    for seed in range(12):
        record, reference = make_recording(
            np.random.default_rng(100 + seed), Device(lag_s=0.004, noise=0.02), turn_s=20.0, optics_noise=1e-3
        )
        lag = find_lag(record, reference)
        z.append((lag.seconds - 0.004) / lag.standard_uncertainty)
        assert lag.standard_uncertainty < 2e-4
    assert np.abs(z).max() < 4.0  # twelve draws, uncertainty from some forty blocks each: t beyond 4 is 1 in 200
    assert 0.4 < np.std(z) < 1.8


def test_clocks_seconds_apart_are_brought_together_across_gaps(pair):
    record, reference = pair
    moved = hidden(hidden(later(reference, -3.2), 10.0, 12.5), 20.0, 20.3)
    lag = find_lag(record, moved)
    assert lag.seconds == pytest.approx(3.2 + 0.00714, abs=1e-4)


def test_frames_drawn_on_straight_lines_are_given_back():
    _, native = make_recording(np.random.default_rng(3), turn_s=30.0, optics_hz=100.0, optics_noise=3e-4)
    drawn = upsampled(native, 285.7)
    assert len(drawn) > 2.5 * len(native)
    back = native_poses(drawn)
    assert back.sample_rate_hz == pytest.approx(100.0, abs=1e-4)
    k = np.round(back.time * 100.0).astype(int)
    assert np.abs(back.time - native.time[k]).max() < 2e-5  # the phase comes from the middles of the repeats
    turn = (
        Rotation.from_quat(back.q_nb, scalar_first=True).inv() * Rotation.from_quat(native.q_nb[k], scalar_first=True)
    ).magnitude()
    assert turn.max() < 1e-4  # 2e-5 s at up to 3 rad/s


def test_frames_are_given_back_around_a_gap():
    _, native = make_recording(np.random.default_rng(4), turn_s=30.0, optics_hz=100.0, optics_noise=3e-4)
    back = native_poses(hidden(upsampled(native, 310.0), 15.0, 17.0))
    assert back.sample_rate_hz == pytest.approx(100.0, abs=1e-4)
    lost = (back.time > 15.02) & (back.time < 16.98)
    assert not back.valid[lost].any()
    assert back.valid[(back.time > 1.0) & (back.time < 14.9)].all()


def test_poses_as_they_were_taken_stay_as_they_are():
    _, native = make_recording(np.random.default_rng(4), turn_s=20.0, optics_noise=3e-4)
    assert native_poses(native) is native
    still = Reference(time=native.time, q_nb=np.tile((1.0, 0.0, 0.0, 0.0), (len(native), 1)))
    assert native_poses(still) is still


def test_motion_follows_the_mark_of_the_reference(pair):
    record, reference = pair
    motion = find_motion(record, reference, lag_s=0.5)
    assert (motion.start_s, motion.stop_s) == pytest.approx((8.5, 48.5), abs=0.011)


def test_motion_without_a_mark_lies_between_the_still_phases():
    record, reference = make_recording(np.random.default_rng(8), Device(noise=0.002), turn_s=20.0, mark=False)
    motion = find_motion(record, reference)
    assert motion.start_s == pytest.approx(8.0, abs=0.8)  # half a window of the search is lost on purpose
    assert motion.stop_s == pytest.approx(28.0, abs=0.8)


def test_motion_without_a_long_rest_is_the_whole_overlap(pair):
    record, reference = pair
    motion = find_motion(record.between(6.0, 60.0), reference)
    assert (motion.start_s, motion.stop_s, motion.rested) == (pytest.approx(8.0), pytest.approx(48.0, abs=0.02), False)
    never, reference = make_recording(np.random.default_rng(8), Device(noise=0.002), turn_s=20.0, mark=False)
    motion = find_motion(never.between(10.0, 26.0), reference)
    assert (motion.start_s, motion.stop_s, motion.rested) == (pytest.approx(10.0), pytest.approx(25.995), False)
    with pytest.raises(AlignmentError, match=r"share 0\.0 s"):
        find_motion(never.between(10.0, 26.0), later(reference, 30.0))


def skewed(record, ppm, *, jump_s=0.0):
    late = 1e-6 * ppm * record.time + jump_s * (record.time > 28.0)
    return replace(record, time=record.time + late)


def test_a_clock_that_runs_fast_is_found_and_undone(pair):
    record, reference = pair
    same = in_step(record, reference)
    assert (same.time is record.time, same.findings) == (True, ())
    done = in_step(skewed(record, 300.0), reference)
    assert done.findings == ()
    # What the fit of the lag leaves: 15 ppm of 20 s either way.
    assert np.abs(done.time - record.time - (done.lag.seconds - same.lag.seconds)).max() < 4e-4


def test_samples_that_were_lost_are_named(pair):
    record, reference = pair
    result = in_step(skewed(record, 0.0, jump_s=0.3), reference).findings
    assert "sync.out_of_step" in [item.code for item in result]


def test_reference_that_repeats_its_last_pose_has_a_gap(pair):
    record, reference = pair
    q_nb, still = np.array(reference.q_nb), seen_poses(record, reference, find_lag(record, reference))
    assert still is reference  # it rests at both ends, and the record with it
    cut = reference.time < 40.0
    held = replace(reference, q_nb=np.where(cut[:, None], q_nb, q_nb[cut][-1]))
    part = replace(held, time=held.time[:4500], q_nb=held.q_nb[:4500], moving=None)
    seen = seen_poses(record, part, find_lag(record, reference))
    assert np.isnan(seen.q_nb[part.time > 40.02]).all()
    assert np.isfinite(seen.q_nb[part.time < 39.98]).all()


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda record, reference: (record, make_recording(np.random.default_rng(77), turn_s=40.0)[1]), AlignmentError,
         "common motion"),
        (lambda record, reference: (record, replace(reference, q_nb=np.tile(np.eye(4)[0], (len(reference), 1)))),
         AlignmentError, "both turn"),
        (lambda record, reference: (record, later(reference, 500.0)), AlignmentError, "share less"),
        (lambda record, reference: (replace(record, gyro=None), reference), InputError, "no gyroscope"),
    ],
)  # fmt: skip
def test_recordings_without_common_motion_have_no_lag(pair, change, error, words):
    with pytest.raises(error, match=words):
        find_lag(*change(*pair))
