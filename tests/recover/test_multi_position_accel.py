"""Free poses give back the accelerometer; the error is the least that the noise allows."""

import numpy as np

from recover.bound import DEVICES, Tally, carried, cramer_rao, information, jacobian, white_device
from undrift.calibration.fit.multi_position_accel import fit_poses
from undrift.sim import BenchSettings, SimulatedDevice, bench_motion, read
from undrift.units import STANDARD_GRAVITY

SETTINGS = BenchSettings(poses=24, still_s=0.4, first_still_s=0.4, move_s=0.1, sample_rate_hz=50.0)
UPPER = np.triu_indices(3)
SEEN = [0, 1, 2, 4, 5, 8, 9, 10, 11]  # of m_xx .. m_zz, offsets


def pose_means(device: SimulatedDevice, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return mean readings and true directions (K, 3) of the poses of one session, and samples in each (K, 1)."""
    motion = bench_motion("multi_position", rng=rng, settings=SETTINGS)
    reading = read(device, motion, rng=rng).record.accel
    assert reading is not None
    means = np.array([reading[s.start : s.stop].mean(axis=0) for s in motion.stills])
    up = np.array([motion.force_b[s.start] for s in motion.stills]) / STANDARD_GRAVITY
    samples = np.array([[s.stop - s.start] for s in motion.stills])
    return means, up, samples


def triangular_truth(device: SimulatedDevice) -> tuple[np.ndarray, np.ndarray]:
    """Return p (m upper row by row, offset) in the axes in which M is upper triangular, and the rotation into them."""
    q, r = np.linalg.qr(np.linalg.inv(device.accel.forward_matrix))
    sign = np.sign(np.diag(r))
    return np.concatenate(((sign[:, None] * r)[UPPER], device.accel.raw_offset)), (q * sign).T


def forward(theta: np.ndarray, poses: int) -> np.ndarray:
    """Return mean readings for p (9) and pose directions as azimuth and height (2 K)."""
    m = np.zeros((3, 3))
    m[UPPER] = theta[:6]
    azimuth, height = theta[9 : 9 + poses], theta[9 + poses :]
    up = np.stack((np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)), axis=1)
    return np.linalg.solve(m, STANDARD_GRAVITY * up.T).T + theta[6:9]


def bound(p: np.ndarray, up: np.ndarray, sd: np.ndarray) -> np.ndarray:
    poses = len(up)
    theta = np.concatenate((p, np.arctan2(up[:, 1], up[:, 0]), np.arcsin(up[:, 2])))
    steps = np.concatenate((np.full(6, 1e-4 * p[0]), np.full(3, 1e-2), np.full(2 * poses, 1e-5)))
    design = jacobian(lambda t: forward(t, poses), theta, steps)
    fisher = information(design, (sd**2).ravel())
    return carried(lambda x: x, p, 1.0, cramer_rao(fisher, 9))


def test_poses_give_back_the_device_without_noise() -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        device = white_device(rng).without_noise()
        means, _, _ = pose_means(device, rng)
        fit = fit_poses(means, gravity=STANDARD_GRAVITY).model
        p, _ = triangular_truth(device)
        np.testing.assert_allclose(fit.matrix[UPPER], p[:6], atol=1e-10 * p[0])
        np.testing.assert_allclose(fit.offset, p[6:], atol=1e-6)  # counts; g is 4096


def test_error_of_a_thousand_devices_reaches_the_bound_and_its_intervals_hold() -> None:
    rng = np.random.default_rng(2)
    tally = Tally.of("multi-position accelerometer, 24 poses")
    for _ in range(DEVICES):
        device = white_device(rng)
        means, up, samples = pose_means(device, rng)
        sd = device.accel.sensitivity * device.accel.random_walk * np.sqrt(SETTINGS.sample_rate_hz / samples)
        p, turn = triangular_truth(device)
        fit = fit_poses(means, gravity=STANDARD_GRAVITY, standard_errors=sd).model
        error = np.concatenate((fit.matrix[UPPER], fit.offset)) - p
        tally.add(error, bound(p, up @ turn.T, sd), fit.standard_uncertainty[SEEN])
    tally.check()
