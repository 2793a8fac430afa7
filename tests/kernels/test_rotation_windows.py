"""The running sum of rotation and sensitivity against a plain numpy twin."""

import numpy as np
from scipy.spatial.transform import Rotation

from undrift.kernels.rotation import accumulate


def twin(rate, regressors, time, at):
    turned, total = Rotation.identity(), np.zeros((3, 3, regressors.shape[1]))
    q, sums = np.zeros((len(at), 4)), np.zeros((len(at), *total.shape))
    q[at <= time[0], 0] = 1.0
    for k in range(1, len(time)):
        dt = time[k] - time[k - 1]
        middle = (turned * Rotation.from_rotvec(0.5 * rate[k] * dt)).as_matrix()
        part = middle[:, :, None] * regressors[k] * dt
        for p in np.flatnonzero((at > time[k - 1]) & (at <= time[k])):
            x = (at[p] - time[k - 1]) / dt
            q[p] = (turned * Rotation.from_rotvec(rate[k] * x * dt)).as_quat(scalar_first=True)
            sums[p] = total + x * part
        turned = turned * Rotation.from_rotvec(rate[k] * dt)
        total = total + part
    return q, sums


def test_rotation_and_sensitivity_equal_the_numpy_twin():
    rng = np.random.default_rng(0)
    n = 300
    time = np.cumsum(rng.uniform(0.008, 0.012, n))
    rate = rng.normal(0.0, 8.0, (n, 3))
    rate[100] *= 40.0  # over the bound of the series: the exact branch
    regressors = rng.normal(size=(n, 7))
    at = np.sort(np.concatenate((time[[0, 5, 299]], rng.uniform(time[0], time[-1], 40))))
    q, sums = np.zeros((len(at), 4)), np.zeros((len(at), 3, 3, 7))
    accumulate(rate.reshape(-1), regressors.reshape(-1), time, at, q.reshape(-1), sums.reshape(-1))
    q_twin, sums_twin = twin(rate, regressors, time, at)
    q_twin *= np.sign((q * q_twin).sum(axis=1))[:, None]
    assert np.abs(q - q_twin).max() < 1e-11  # series to 1e-12 per step, 300 steps
    assert np.abs(sums - sums_twin).max() < 1e-11 * np.abs(sums_twin).max()
