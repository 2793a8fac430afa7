"""Rest of a motion of one's own: what its poses say of it, and what becomes of a statement that they do not bear out."""

import re
from pathlib import Path

import numpy as np
import pytest

from testkit.data import data_path
from undrift.errors import InputError
from undrift.record import Reference
from undrift.sim.motion.poses import PoseSpline, fit_pose_spline
from undrift.study.recorded import (
    SKIN,
    OwnMotion,
    Posed,
    check_rest,
    find_rest,
    length_of_rest,
    read_motion,
    read_poses,
)
from undrift.units import STANDARD_GRAVITY

DEG = np.pi / 180.0
FILE = Path("poses.parquet")


def leaning(rate_dps: float, *, from_s: float, noise_deg: float = 0.0) -> PoseSpline:
    """A body that stands, and from an instant on leans forward at a steady rate."""
    time = np.arange(600) / 100.0
    lean = rate_dps * DEG * np.maximum(time - from_s, 0.0)
    lean = lean + noise_deg * DEG * np.random.default_rng(1).standard_normal(len(time))
    q = np.stack((np.cos(lean / 2.0), np.zeros(600), np.sin(lean / 2.0), np.zeros(600)), axis=1)
    return fit_pose_spline(Reference(time=time, q_nb=q, position=np.zeros((600, 3))), SKIN)


def test_a_body_that_stands_is_at_rest_as_long_as_it_does() -> None:
    is_still = find_rest(leaning(40.0, from_s=2.0))
    assert length_of_rest(is_still) == pytest.approx(
        1.9, abs=0.15
    )  # the first 0.1 s are not believed; a window to notice
    check_rest(is_still, 1.5, FILE)


def test_a_turn_in_the_stated_rest_is_told_with_how_long_the_rest_is() -> None:
    is_still = find_rest(leaning(40.0, from_s=2.0))
    with pytest.raises(InputError, match=r"rest_s = 3 s") as caught:
        check_rest(is_still, 3.0, FILE)
    text = str(caught.value)
    still = re.search(r"still for (\S+) s\. To continue, set rest_s = (\S+)\.$", text)
    assert still
    assert still[1] == still[2]
    assert 1.7 <= float(still[1]) <= 2.0
    check_rest(is_still, float(still[1]), FILE)  # what is advised is taken


def test_a_slow_turn_counts_by_the_tilt_that_it_spoils() -> None:
    is_still = find_rest(leaning(3.0, from_s=0.0))  # slower than the limit
    with pytest.raises(InputError, match=r"The body is still for 0\.6 s"):
        check_rest(is_still, 2.0, FILE)  # half of 3 deg/s times 2 s


def test_noise_of_cameras_is_no_motion() -> None:
    # 0.1 deg: 0.1 mm on markers 60 mm apart
    assert length_of_rest(find_rest(leaning(0.0, from_s=0.0, noise_deg=0.1))) > 5.5


@pytest.mark.slow
def test_people_who_stand_are_at_rest_and_a_squat_that_has_begun_is_not() -> None:
    stood = data_path("mocap_sit_to_stand", "static1.trc.gz")
    standing = fit_pose_spline(read_poses(stood, Posed(body="pelvis", up="y")), SKIN)
    check_rest(find_rest(standing), 4.5, stood)
    squat = data_path("c3d", "squat.c3d.gz")
    for up in ("y", "z"):
        own = OwnMotion(path=str(squat), rest_s=2.0, body="pelvis", up=up)
        with pytest.raises(InputError, match="or set hold = true and rest_s = 6"):
            read_motion(own)


def test_a_pose_that_is_held_is_a_rest_before_the_same_motion() -> None:
    squat = data_path("c3d", "squat.c3d.gz")
    own = OwnMotion(path=str(squat), rest_s=6.0, body="pelvis", up="y", hold=True)
    task = read_motion(own)
    time = np.arange(-10, 1000) / 100.0
    motion, before = task.at(time, STANDARD_GRAVITY), time < 6.0
    assert task.moving_s == (6.0, pytest.approx(task.duration_s))
    np.testing.assert_array_equal(motion.rate_b[before], 0.0)
    np.testing.assert_array_equal(motion.valid, 1.0)
    np.testing.assert_allclose(np.linalg.norm(motion.force_b[before], axis=1), STANDARD_GRAVITY, rtol=1e-12)
    plain = task.spline.at(time[~before] - 6.0 + task.spline.span_s[0], STANDARD_GRAVITY)
    np.testing.assert_array_equal(motion.q_nb[~before], plain.q_nb)
    np.testing.assert_array_equal(motion.force_b[~before], plain.force_b)
    np.testing.assert_allclose(motion.q_nb[before], np.tile(plain.q_nb[0], (before.sum(), 1)), atol=1e-12)


def test_a_pose_is_held_long_enough_for_a_tilt() -> None:
    squat = data_path("c3d", "squat.c3d.gz")
    own = OwnMotion(path=str(squat), rest_s=0.2, body="pelvis", up="y", hold=True)
    with pytest.raises(InputError, match=r"rest_s must be 0\.5 s or more, got 0\.2"):
        read_motion(own)
