"""The g-sensitivity that rests in several poses show: found with its uncertainty, never twice, never out of nothing."""

from dataclasses import replace

import numpy as np

from drift.test_static import blocks
from testkit.full_calibration import device
from undrift.drift.checks import rests_verdict
from undrift.drift.static import fit_static
from undrift.model import G_NAMES

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


def test_the_table_is_without_what_the_calibration_knows_and_a_pose_that_counts_is_named():
    made = rests(np.random.default_rng(1), felt=KNOWN)
    before, after = (fit_static(made, nodes=np.arange(20.0, 40.5, 1.0), calibration=c) for c in (NAIVE, CALIBRATION))
    assert (after.table.gyro_uncertainty[0] < 0.2 * before.table.gyro_uncertainty[0]).all()
    assert [item.code for item in rests_verdict(before, NAIVE).findings] == ["drift.poses_g"]
    assert rests_verdict(after, CALIBRATION).reasons == ()
    np.testing.assert_allclose(after.table.gyro_offset[10], 0.0, atol=5 * NOISE)


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
