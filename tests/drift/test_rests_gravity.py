"""The g-sensitivity that rests in several poses show: found with its uncertainty, never twice, never out of nothing."""

from dataclasses import replace

import numpy as np
import pytest

from drift.test_static import blocks
from testkit.data import show
from testkit.full_calibration import device
from undrift.correction.correct import correct
from undrift.drift.checks import rests_verdict
from undrift.drift.rests import with_g_sensitivity
from undrift.drift.static import fit_static
from undrift.model import G_NAMES, DriftTables
from undrift.record import Record

FACES = 9.81 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
POINTS = np.array([20.0, 30.0, 40.0])
CALIBRATION = device(unit="rad/s")
KNOWN = CALIBRATION.gyro.g_sensitivity
NAIVE = replace(
    CALIBRATION,
    gyro=replace(
        CALIBRATION.gyro, g_sensitivity=None, parameters=CALIBRATION.gyro.parameters[:12], covariance=np.zeros((12, 12))
    ),
)
NOISE = 2e-5  # rad/s, 0.001 deg/s: of the mean of a block
TRUE = np.radians([[0.05, -0.02, 0.08], [0.0, 0.06, -0.03], [0.1, 0.02, -0.05]]) / 9.81


def rests(rng, faces=FACES, *, felt=TRUE, by_pose=0.0):
    """Two blocks on each face at each set-point."""
    rows = [(p, k) for p in range(len(POINTS)) for k in range(len(faces)) for _ in range(2)]
    temp, pose = np.array([POINTS[p] for p, _ in rows]), np.array([k for _, k in rows])
    time = 10.0 * np.arange(len(rows)) + 600.0 * pose + 3600.0 * np.array([p for p, _ in rows])
    force = faces[pose]
    gyro, accel = CALIBRATION.gyro, CALIBRATION.accel
    rate = force @ felt.T + by_pose * rng.normal(size=(len(faces), 3))[pose]
    reading = rate @ gyro.forward_matrix.T + 1e-4 * (temp[:, None] - 30.0) + NOISE * rng.normal(size=force.shape)
    made = blocks(temp, reading, accel=force @ accel.forward_matrix.T + accel.offset, noise=NOISE, time=time)
    return replace(made, pose=pose)


@pytest.mark.parametrize("by_pose", [0.0, 2e-4])
def test_six_faces_tell_it_and_its_intervals_hold(by_pose):
    # Fifty devices, nine elements each; with by_pose the offset differs by 0.011 deg/s from pose to pose for other reasons.
    inside, error, kept = [], [], 0
    for seed in range(50):
        found, _ = with_g_sensitivity(rests(np.random.default_rng(seed), by_pose=by_pose), NAIVE)
        if found.gyro.g_sensitivity is None:
            continue
        kept += 1
        off = (found.gyro.g_sensitivity - TRUE).ravel()
        inside.append(np.abs(off) <= 1.96 * found.gyro.standard_uncertainty[12:])
        error.append(off)
    share, rms = float(np.mean(inside)), float(np.degrees(np.sqrt(np.mean(np.square(error)))) * 9.81)
    show(f"by pose {by_pose:g} rad/s: kept of 50, inside, error (deg/s)/g", f"{kept}, {share:.3f}, {rms:.4f}", 0.93)
    assert kept == 50
    assert share >= 0.93
    assert rms < (
        0.002 if by_pose == 0.0 else 0.012
    )  # noise of twelve blocks; 0.011 deg/s over root two, either way up


def test_the_table_is_without_it_and_correct_takes_it_off_once():
    made = rests(np.random.default_rng(1))
    found, verdict = with_g_sensitivity(made, NAIVE)
    (estimate,) = verdict.findings
    assert estimate.code == "drift.g_sensitivity"
    assert "up to 0.1 (deg/s)/g from rests in 6 poses" in estimate.text
    before, after = (fit_static(made, nodes=np.arange(20.0, 40.5, 1.0), calibration=c) for c in (NAIVE, found))
    assert (after.table.gyro_uncertainty[0] < 0.2 * before.table.gyro_uncertainty[0]).all()
    assert [item.code for item in rests_verdict(before, NAIVE).findings] == ["drift.poses_g"]
    assert rests_verdict(after, found).reasons == ()
    np.testing.assert_allclose(after.table.gyro_offset[10], 0.0, atol=5 * NOISE)
    use = replace(found, drift=DriftTables(static=after.table), adc=None)
    record = Record(
        time=0.01 * np.arange(len(made)), gyro=made.gyro, accel=made.accel, temp_c=made.temp_c, gyro_unit="rad/s",
        accel_unit=CALIBRATION.accel.unit_in,
    )  # fmt: skip
    left = correct(record, use).gyro
    show("what correct leaves of the rests, deg/s rms", f"{np.degrees(np.sqrt((left**2).mean())):.4f}", 0.003)
    assert np.degrees(np.sqrt((left**2).mean())) < 0.003  # 0.001 is the noise


def test_what_is_known_is_kept():
    made = rests(np.random.default_rng(2), felt=KNOWN)
    found, verdict = with_g_sensitivity(made, CALIBRATION)
    assert found is CALIBRATION
    assert verdict.reasons == ()


@pytest.mark.slow
def test_nothing_is_felt_where_nothing_is():
    felt = [
        with_g_sensitivity(rests(np.random.default_rng(seed), felt=np.zeros((3, 3)), by_pose=by_pose), NAIVE)[0]
        for seed in range(100)
        for by_pose in (0.0, 2e-4)
    ]
    count = sum(found.gyro.g_sensitivity is not None for found in felt)
    show("devices that feel nothing and are given a g-sensitivity, of 200", count, 4)
    assert count <= 4  # one in a thousand were the variances known


@pytest.mark.parametrize("faces", [FACES[:1], FACES[::2], FACES[:4], FACES[[0, 1, 2, 4]]])
def test_too_few_poses_or_poses_in_a_plane_tell_nothing(faces):
    found, verdict = with_g_sensitivity(rests(np.random.default_rng(3), faces), NAIVE)
    assert found is NAIVE
    assert verdict.reasons == ()


def test_without_accelerometers_nothing_tells_gravity():
    made = rests(np.random.default_rng(4))
    assert with_g_sensitivity(made, replace(NAIVE, accel=None))[1].reasons == ()
    assert with_g_sensitivity(replace(made, accel=np.full(made.accel.shape, np.nan)), NAIVE)[1].reasons == ()


def test_the_uncertainty_of_a_known_one_enters_the_table_of_one_pose():
    made = rests(np.random.default_rng(5), FACES[4:5], felt=KNOWN)
    own = np.zeros((21, 21))
    own[12:, 12:] = np.eye(9) * 1e-5**2
    doubtful = replace(CALIBRATION.gyro, covariance=own, parameters=(*NAIVE.gyro.parameters, *G_NAMES))
    sure, poor = (
        fit_static(made, nodes=POINTS, calibration=replace(CALIBRATION, gyro=model)).table.gyro_uncertainty
        for model in (replace(doubtful, covariance=np.zeros((21, 21))), doubtful)
    )
    added = np.sqrt(poor**2 - sure**2)
    np.testing.assert_allclose(
        added, np.tile(9.81e-5 * np.linalg.norm(doubtful.forward_matrix, axis=1), (3, 1)), rtol=1e-3
    )
