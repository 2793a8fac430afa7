"""Mounting: simulated people who stand, walk and bow with a misplaced device, hinges, and a pendulum under cameras."""

import gzip
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from testkit.data import data_path, show
from testkit.walking import hinge, misplaced, repeat, walk
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, quaternion_product, rotation, rotation_vector, signed
from undrift.model import BodyMounting
from undrift.mounting import find_mounting, fit_hinge
from undrift.record import Record

HALF_TURNS = np.eye(4)  # as worn, upside down, turned round: q_ab about no axis, x, y, z
PEOPLE = 40
LARGEST_DEG, COVERED = 2.0, (0.90, 0.98)  # rms error of the whole rotation; share of angles inside their 95 %


def drawn(seed, place, movement="walk"):
    """Return the recording of a person whose device is 20 deg off some half-turn, and R_ab."""
    rng = np.random.default_rng(seed)
    q_ab = misplaced(rng, 20.0, HALF_TURNS[rng.integers(4)])
    how = walk(rng, place, q_ab=q_ab) if movement == "walk" else repeat(rng, place, movement=movement, q_ab=q_ab)
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
        found = fit.mounting
        assert found is not None, (place, seed)
        assert "mount.slipped" not in [one.code for one in fit.verdict.findings], (place, seed)
        rows.append((off(found, matrix), np.sqrt(np.diag(found.covariance))))
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
    [
        *((place, "walk") for place in ("thigh", "foot", "wrist")),
        *(("lower-back", "bow"), ("thigh", "squat"), ("shank", "squat"), ("wrist", "raise")),
    ],
)
def test_every_place_and_movement_shows_forward(place, movement):
    error, stated = errors(place, range(2000, 2008), movement)
    worst = float((np.abs(error) / stated).max())
    show(f"{place} by {movement}: rms error, deg", np.degrees(np.sqrt((error**2).sum(axis=1).mean())).round(2))
    assert worst < 3.5  # of 24 angles; 3.5 standard deviations leave out one angle in two thousand


def test_where_nobody_stands_up_is_the_mean_over_walking_and_less_sure():
    record, matrix = drawn(3, "lower-back")
    walking = record.between(6.0, 12.0)  # of the first bout
    found = find_mounting([walking, *(record.between(a, a + 5.5) for a in (19.5, 32.5, 45.5))], "lower-back")
    assert [one.code for one in found.verdict.findings] == ["mount.no_stance", "mount.look", "mount.uncertain"]
    assert np.degrees(np.linalg.norm(off(found.mounting, matrix))) < 3.0 * np.degrees(found.mounting.uncertainty)
    assert found.mounting.uncertainty > np.radians(7.0)


def test_what_is_not_shown_is_named():
    record, _ = drawn(4, "lower-back")
    standing = find_mounting([record.between(0.0, 4.0)], "lower-back")
    assert standing.mounting is None
    assert [one.code for one in standing.verdict.findings] == ["mount.no_forward"]
    assert "walk straight for 8 s and halt" in standing.verdict.findings[0].action
    rng = np.random.default_rng(0)
    gyro = rng.normal(0.0, 2.0, (3000, 3)).cumsum(axis=0) * 0.05
    force = rng.normal(0.0, 0.2, (3000, 3)) + np.array([0.0, 0.0, 9.8])
    shaken = Record(time=np.arange(3000) / 100.0, gyro=gyro, accel=force)
    lost = find_mounting([shaken], "lower-back")
    assert lost.mounting is None
    assert [one.code for one in lost.verdict.findings] == ["mount.no_up"]


def test_a_device_that_slipped_between_recordings_is_noticed():
    rng = np.random.default_rng(5)
    slipped = quaternion_product(np.array([np.cos(0.35), 0.0, 0.0, np.sin(0.35)]), np.array([1.0, 0.0, 0.0, 0.0]))
    first, second = walk(rng), walk(rng, walk_s=60.0, bouts=3, q_ab=slipped)
    found = find_mounting([first, *(second.between(a, a + 50.0) for a in (8.0, 72.0, 136.0))], "lower-back")
    assert "mount.apart" in [one.code for one in found.verdict.findings]


def test_a_named_posture_is_taken_and_a_movement_must_move_the_segment():
    record, matrix = drawn(6, "lower-back")
    found = find_mounting([record], "lower-back", named=(0.2, 3.5))
    assert "0.2 to 3.5 s" in found.basis[0]
    assert np.degrees(np.linalg.norm(off(found.mounting, matrix))) < 4.0
    with pytest.raises(InputError, match=r"wanted a movement of the foot, walk or raise, got bow; name one"):
        find_mounting([record], "foot", movement="bow")


def test_sitting_is_less_sure_than_standing():
    record, _ = drawn(7, "lower-back")
    sitting, standing = (find_mounting([record], "lower-back", posture=one).mounting for one in ("sitting", "standing"))
    assert sitting.covariance[0, 0] > 9.0 * standing.covariance[0, 0]


def test_a_mounting_is_a_rotation_and_gives_the_orientation_of_the_segment():
    q_ab = misplaced(np.random.default_rng(8), 30.0)
    worn = BodyMounting(place="thigh", matrix=rotation(q_ab).as_matrix(), covariance=np.eye(3) * 1e-4, basis="stated")
    q_na = misplaced(np.random.default_rng(9), 50.0)
    # q_nb = q_na (x) q_ab
    np.testing.assert_allclose(np.abs(worn.of_body(quaternion_product(q_na, q_ab)) @ q_na), 1.0, atol=1e-12)
    assert worn.uncertainty == pytest.approx(np.sqrt(3e-4))
    with pytest.raises(InputError, match=r"mounting: wanted a rotation from case to body axes, got another matrix"):
        BodyMounting(place="thigh", matrix=np.diag([1.0, 1.0, -1.0]), covariance=np.eye(3), basis="")


# ---- Hinges


def apart(found, true):
    """Return the angle between two axes, either way round, deg."""
    return float(np.degrees(np.arccos(min(1.0, abs(float(found @ true))))))


@pytest.mark.slow
def test_a_hinge_that_is_turned_every_way_shows_axes_and_angle():
    for seed in range(4):
        records, true, angle = hinge(np.random.default_rng(seed))
        found = fit_hinge(*records, "knee")
        axes = [apart(*pair) for pair in zip(found.axes, true, strict=True)]
        rms = np.degrees(np.sqrt(((found.angle - angle[: len(found.angle)]) ** 2).mean()))
        show(
            f"hinge {seed}: axes off, deg; rms error of the angle, deg", (np.round(axes, 2), round(rms, 2)), (1.0, 1.0)
        )
        assert max(axes) < 1.0  # limits: a tenth of what a strap turns by
        assert rms < 1.0
        assert "mount.hinge_side" in [one.code for one in found.verdict.findings]


def test_two_recordings_need_a_stretch_in_common():
    (first, second), _, _ = hinge(np.random.default_rng(0), duration_s=20.0)
    with pytest.raises(
        InputError, match=r"wanted two recordings on one clock with 10 s in common, got 3\.99 s; record both"
    ):
        fit_hinge(first.between(0.0, 8.0), second.between(4.0, 20.0), "knee")


def test_without_a_posture_the_straight_end_is_zero():
    (first, second), _, _ = hinge(np.random.default_rng(2))
    found = fit_hinge(first.between(8.0, 60.0), second.between(8.0, 60.0), "elbow")
    assert "mount.straight" in [one.code for one in found.verdict.findings]
    assert np.degrees(found.angle.min()) > -8.0


def pendulum(test, segment):
    """Return q (N, 4) of the cameras and the readings of a segment (RepoIMU)."""
    name = f"Pendulum_Test{test}_Trial1_Segment_{segment}.csv.gz"
    with gzip.open(data_path("pendulum_with_optics", name), "rt") as file:
        lines = file.read().splitlines()[2:]
    rows = np.array([[float(cell or "nan") for cell in line.replace(",", ".").split(";")[:11]] for line in lines])
    time = np.linspace(rows[0, 0], rows[-1, 0], len(rows))  # stamps are rounded to 1 ms, with repeats
    return signed(rows[:, 1:5]), Record(time=time, gyro=rows[:, 8:11], accel=rows[:, 5:8])


@pytest.mark.slow
@pytest.mark.parametrize("test", ["02a", "02b"])
def test_the_joint_of_a_real_pendulum_agrees_with_the_cameras(test):
    (q_1, first), (q_2, second) = pendulum(test, 1), pendulum(test, 2)
    found = fit_hinge(first, second, "knee")
    count = min(len(q_1), len(q_2), len(found.angle))
    turned = rotation_vector(signed(quaternion_product(quaternion_conjugate(q_1[:count]), q_2[:count])))
    truth = turned @ np.linalg.eigh(turned.T @ turned)[1][:, -1]
    inner = slice(200, count - 200)
    error = min((way * found.angle[inner] - truth[inner] for way in (1.0, -1.0)), key=np.std)
    show(f"pendulum {test}: angle, rms error without its mean, deg", f"{np.degrees(error.std()):.2f}", 2.0)
    show(f"pendulum {test}: stated, deg", f"{np.degrees(found.angle_uncertainty):.2f}")
    assert np.degrees(error.std()) < 2.0  # limit: 2 % of its span of 90 deg


# ---- qmt (MIT), in an environment of its own: python -m venv q && q/bin/pip install qmt==0.2.4; UNDRIFT_QMT=q/bin/python

OLSSON = """
import contextlib, io, json, sys
import numpy as np, qmt
data = np.load(sys.argv[1])
with contextlib.redirect_stdout(io.StringIO()):
    axes = qmt.jointAxisEstHingeOlsson(*(data[name] for name in ("accel_1", "accel_2", "gyro_1", "gyro_2")))
print(json.dumps([np.ravel(axis).tolist() for axis in axes]))
"""


@pytest.mark.slow
def test_the_axes_agree_with_those_of_qmt(tmp_path):
    records, _, _ = hinge(np.random.default_rng(0))
    found = fit_hinge(*records, "knee").axes
    python = os.environ.get("UNDRIFT_QMT", "")
    if not Path(python).is_file():
        pytest.skip("qmt is not here: UNDRIFT_QMT names the Python of an environment that has it")
    names = {f"{name}_{k + 1}": getattr(one, name) for k, one in enumerate(records) for name in ("gyro", "accel")}
    np.savez(tmp_path / "hinge.npz", **names)
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    call = [python, "-c", OLSSON, str(tmp_path / "hinge.npz")]
    done = subprocess.run(call, capture_output=True, text=True, check=True, env=clean)
    theirs = np.array(json.loads(done.stdout))
    off_deg = [apart(*pair) for pair in zip(found, theirs, strict=True)]
    show("axes against qmt's jointAxisEstHingeOlsson, deg", np.round(off_deg, 2), 1.0)
    assert max(off_deg) < 1.0
