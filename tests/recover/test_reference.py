"""Poses of the body give back the gyroscope; its error is compared with the least that the poses used allow.

Data of the bound: the poses at the stride, with white noise, and the readings between them, with white noise. Every pose
but the first two is shared by two steps, so their covariance is tridiagonal; it is written down here and solved as it is.
"""

import numpy as np
import pytest

from testkit.cohorts import COHORTS
from testkit.cramer_rao import Array, Tally, carried, white_device
from testkit.data import show
from testkit.twins import rotation_matrices
from undrift.calibration.reference import STRIDE_S, fit_reference
from undrift.model import TriadModel
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import OpticsSettings, see
from undrift.sim.motion.tasks import draw_task
from undrift.units import STANDARD_GRAVITY

SAMPLE_RATE_HZ = 50.0
OPTICS = OpticsSettings(sample_rate_hz=SAMPLE_RATE_HZ, angle_sd=3e-4, gaps=0)
TASK = draw_task("free", rng=np.random.default_rng(0))
MOTION = TASK.at(np.arange(round(TASK.duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ, STANDARD_GRAVITY)


def fitted(device: DeviceModel, rng: np.random.Generator, optics: OpticsSettings) -> TriadModel:
    record = simulate_device(device, MOTION, rng=rng).record
    return fit_reference((record,), (see(TASK, rng=rng, settings=optics),)).triad.model


def physical_information(motion: Motion, pose_sd: float, random_walk: float) -> Array:
    """Return the information on E and e of w = (1 + E) w_true - e that poses and readings of one recording hold."""
    first, last = (
        round((edge + side * 0.5) * SAMPLE_RATE_HZ) for edge, side in zip(TASK.moving_s, (-1, 1), strict=True)
    )
    at = np.arange(first, last + 1, round(STRIDE_S * SAMPLE_RATE_HZ))
    turn = rotation_matrices(motion.q_nb)
    middle = 0.5 * (turn[1:] + turn[:-1]) / SAMPLE_RATE_HZ
    gain = np.einsum("kab,kc->kabc", middle, motion.mean_rate_b[1:]).reshape(-1, 3, 9)
    total = np.concatenate((np.zeros((1, 3, 12)), np.cumsum(np.concatenate((gain, -middle), axis=2), axis=0)))
    steps = total[at[1:]] - total[at[:-1]]
    n = len(steps)
    poses = pose_sd**2 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    covariance = poses + random_walk**2 * STRIDE_S * np.eye(n)
    return np.einsum("iap,iaq->pq", steps, np.einsum("ij,jaq->iaq", np.linalg.inv(covariance), steps))


def bound(device: DeviceModel, information: Array) -> Array:
    gain = device.gyro.forward_matrix
    to_physical = np.zeros((12, 12))
    to_physical[:9, :9] = np.kron(np.eye(3), gain.T)  # E = dM K
    to_physical[9:, 9:] = np.linalg.inv(gain)  # e = M do
    return carried(lambda x: x, np.zeros(12), 1.0, np.linalg.inv(to_physical.T @ information @ to_physical))


def error_of(model: TriadModel, device: DeviceModel) -> Array:
    wrong = model.matrix - np.linalg.inv(device.gyro.forward_matrix)
    return np.concatenate((wrong.ravel(), model.offset - device.gyro.raw_offset))


@pytest.mark.slow
@pytest.mark.parametrize("devices", COHORTS)
def test_long_windows_cost_less_than_half_more_error(devices: int) -> None:
    rng = np.random.default_rng(3)
    tally = Tally.of("reference, windows")
    information = physical_information(
        MOTION, OPTICS.angle_sd, float(white_device(rng).gyro.white_noise.random_walk[0])
    )
    for _ in range(devices):
        device = white_device(rng)
        model = fitted(device, rng, OPTICS)
        errors, least = error_of(model, device)[:9], bound(device, information)[:9]  # rests show the offset too
        tally.add(errors, least, model.standard_uncertainty[:9])
    # Real optics wander with the pose, and there the long windows win: that is why they are the default.
    show("reference, windows: RMSE over Cramer-Rao bound", f"{tally.ratio:.3f}", 1.5)
    show("reference, windows: coverage of 95 % intervals", f"{tally.coverage:.3f}")
    assert tally.ratio < 1.5
