"""Mounting: simulated people who stand, walk and bow with a misplaced device."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from testkit.data import show
from testkit.walking import bow, misplaced, walk
from undrift.errors import InputError
from undrift.frames import quaternion_product, rotation
from undrift.model import BodyMounting
from undrift.mounting import find_mounting
from undrift.record import Record

HALF_TURNS = np.eye(4)  # as worn, upside down, turned round: q_ab about no axis, x, y, z
PEOPLE = 40
LARGEST_DEG, COVERED = 2.0, (0.90, 0.98)  # rms error of the whole rotation; share of angles inside their 95 %


def drawn(seed, place, movement="walk"):
    """Return the recording of a person whose device is 20 deg off some half-turn, and R_ab."""
    rng = np.random.default_rng(seed)
    q_ab = misplaced(rng, 20.0, HALF_TURNS[rng.integers(4)])
    how = walk(rng, place, q_ab=q_ab) if movement == "walk" else bow(rng, q_ab=q_ab)
    return how, rotation(q_ab).as_matrix()


def off(found, matrix):
    """Return the error about the segment's axes, rad."""
    return Rotation.from_matrix(found.matrix @ matrix.T).as_rotvec()


def errors(place, seeds, movement="walk"):
    """Return errors and stated standard uncertainties of people, (K, 3) each, rad."""
    rows = []
    for seed in seeds:
        record, matrix = drawn(seed, place, movement)
        fit = find_mounting([record], place, movement=movement)
        mounting = fit.mounting
        assert mounting is not None, (place, seed)
        rows.append((off(mounting, matrix), np.sqrt(np.diag(mounting.covariance))))
    return np.array(rows).transpose(1, 0, 2)


@pytest.mark.slow
@pytest.mark.parametrize("place", ["lower-back", "shank"])
def test_posture_and_walking_show_a_device_that_is_20_deg_off(place):
    error, stated = errors(place, range(7000, 7000 + PEOPLE))  # none of whom chose a setting
    rms = np.degrees(np.sqrt((error**2).sum(axis=1).mean()))
    inside = float((np.abs(error) < 1.96 * stated).mean())
    show(f"{place}, {PEOPLE} people: rms error, deg", f"{rms:.2f}", LARGEST_DEG)
    show(f"{place}: rms about x, y, z, deg", np.degrees(np.sqrt((error**2).mean(axis=0))).round(2))
    show(f"{place}: share of angles inside 95 %", f"{inside:.3f}", COVERED)
    assert rms <= LARGEST_DEG
    assert COVERED[0] <= inside <= COVERED[1]


@pytest.mark.parametrize(
    ("place", "movement"),
    [("thigh", "walk"), ("foot", "walk"), ("wrist", "walk"), ("lower-back", "bow")],
)
def test_every_place_and_movement_shows_forward(place, movement):
    error, stated = errors(place, range(2000, 2008), movement)
    worst = float((np.abs(error) / stated).max())
    show(f"{place} by {movement}: rms error, deg", np.degrees(np.sqrt((error**2).sum(axis=1).mean())).round(2))
    assert worst < 3.5  # of 24 angles; 3.5 standard deviations leave out one angle in two thousand


def test_what_is_not_shown_is_named():
    record, _ = drawn(4, "lower-back")
    standing = find_mounting([record.between(0.0, 4.0)], "lower-back")
    assert standing.mounting is None
    assert [finding.code for finding in standing.verdict.findings] == ["mount.not_determined"]
    assert "walk straight" in standing.verdict.findings[0].action
    rng = np.random.default_rng(0)
    gyro = rng.normal(0.0, 2.0, (3000, 3)).cumsum(axis=0) * 0.05
    force = rng.normal(0.0, 0.2, (3000, 3)) + np.array([0.0, 0.0, 9.8])
    shaken = Record(time=np.arange(3000) / 100.0, gyro=gyro, accel=force)
    lost = find_mounting([shaken], "lower-back")
    assert lost.mounting is None
    assert [finding.code for finding in lost.verdict.findings] == ["mount.not_determined"]


def test_a_device_that_slipped_between_recordings_is_less_sure():
    rng = np.random.default_rng(5)
    slipped = quaternion_product(np.array([np.cos(0.35), 0.0, 0.0, np.sin(0.35)]), np.array([1.0, 0.0, 0.0, 0.0]))
    first, second = walk(rng), walk(rng, q_ab=slipped)
    result, sound = (find_mounting(records, "lower-back") for records in ([first, second], [first]))
    assert result.mounting.covariance[2, 2] > 9.0 * sound.mounting.covariance[2, 2]
    assert "mount.uncertain" in [finding.code for finding in result.verdict.findings]


def test_a_bow_moves_the_lower_back_only():
    record, _ = drawn(6, "lower-back")
    with pytest.raises(InputError, match="Choose walk"):
        find_mounting([record], "foot", movement="bow")


def test_mounting_gives_the_orientation_of_the_segment():
    q_ab = misplaced(np.random.default_rng(8), 30.0)
    worn = BodyMounting(place="thigh", matrix=rotation(q_ab).as_matrix(), covariance=np.eye(3) * 1e-4, basis="stated")
    q_na = misplaced(np.random.default_rng(9), 50.0)
    # q_nb = q_na (x) q_ab
    np.testing.assert_allclose(np.abs(worn.of_body(quaternion_product(q_na, q_ab)) @ q_na), 1.0, atol=1e-12)
    assert worn.uncertainty == pytest.approx(np.sqrt(3e-4))
    with pytest.raises(InputError, match=r"mounting: the matrix"):
        BodyMounting(place="thigh", matrix=np.diag([1.0, 1.0, -1.0]), covariance=np.eye(3), basis="")
