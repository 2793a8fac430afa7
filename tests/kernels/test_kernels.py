"""Strapdown, its sensitivity, carried means and the lead filter: against exact solutions and plain numpy twins."""

import os

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from testkit import twins
from testkit.data import show
from undrift.errors import InputError
from undrift.frames import integrate_strapdown, quaternion_conjugate, quaternion_product
from undrift.kernels.correct import lead
from undrift.kernels.rotation import accumulate, carried_means

COMPILED = os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0")
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def angle_between(p, q):
    """Angle from p to q, rad, good near zero."""
    e = quaternion_product(p, quaternion_conjugate(q))
    return 2.0 * np.arctan2(np.linalg.norm(e[..., 1:], axis=-1), np.abs(e[..., 0]))


@pytest.mark.parametrize("rate", [0.0, 1e-9, 0.3, 19.9, 20.1, 300.0])  # at 100 Hz the series ends at 20 rad/s
def test_a_constant_rate_is_integrated_exactly(rate):
    n, axis = 300, np.array([2.0, -1.0, 2.0]) / 3.0
    time = np.arange(n) * 0.01
    q = integrate_strapdown(np.tile(axis * rate, (n, 1)), time, LEVEL)
    half = 0.5 * rate * time
    truth = np.column_stack((np.cos(half), np.sin(half)[:, None] * axis))
    assert angle_between(q, truth).max() < 1e-12  # 300 products of one rounding each, times the growth of the phase


def test_rotations_agree_with_scipy():
    rng = np.random.default_rng(1)
    n = 301
    time = np.cumsum(rng.uniform(0.001, 0.03, n))
    gyro = rng.normal(size=(n, 3)) * np.where(rng.uniform(size=(n, 1)) < 0.1, 200.0, 5.0)
    start = rng.normal(size=4)
    start /= np.linalg.norm(start)
    q = integrate_strapdown(gyro, time, start)
    # both are right to a few roundings a step
    assert angle_between(q, twins.strapdown(gyro, time, start)).max() < 1e-13


@pytest.mark.skipif(not COMPILED, reason="a million samples need the compiler")
def test_length_is_kept_over_a_million_samples():
    n, rate = 1_000_000, np.array([0.7, -1.1, 0.4])
    time = np.arange(n) * 0.01
    q = integrate_strapdown(np.tile(rate, (n, 1)), time, LEVEL)
    worst = np.abs(np.linalg.norm(q, axis=1) - 1.0).max()
    half = 0.5 * np.linalg.norm(rate) * time[-1]
    truth = np.array([np.cos(half), *(np.sin(half) * rate / np.linalg.norm(rate))])
    off = angle_between(q[-1], truth)
    show("length after 1e6 samples, departure from one", worst, "1e-14")
    show("angle after 1e6 samples and 2200 turns, rad", off, "1e-9")
    assert worst < 1e-14  # at most a block of 32 roundings from the last step back to one
    assert off < 1e-9  # each step rounds by 1e-16: at worst 1e-10 for a million, and time itself is rounded to 1e-12 s


def test_a_buffer_is_filled_and_given_back():
    time, out = np.arange(5) * 0.01, np.empty((5, 4))
    assert integrate_strapdown(np.ones((5, 3)), time, LEVEL, out=out) is out
    assert out.tobytes() == integrate_strapdown(np.ones((5, 3)), time, LEVEL).tobytes()


def test_shapes_that_disagree_and_gaps_are_refused():
    time = np.arange(5) * 0.01
    with pytest.raises(InputError, match=r"got \(4, 3\)"):
        integrate_strapdown(np.ones((4, 3)), time, LEVEL)
    gap = np.ones((5, 3))
    gap[2, 1] = np.nan
    with pytest.raises(InputError, match="got gaps"):
        integrate_strapdown(gap, time, LEVEL)
    with pytest.raises(InputError, match=r"shape \(5, 4\)"):
        integrate_strapdown(np.ones((5, 3)), time, LEVEL, out=np.empty((4, 5)).T)


@pytest.mark.parametrize("width", [4, 7, 40])  # of odd windows that half overlap, three share a sample
@pytest.mark.parametrize("regressors", [(1, 1), (4, 3)])
def test_carried_means_agree_with_the_plain_twin(width, regressors):
    rng = np.random.default_rng(3)
    n = 201
    time = np.cumsum(rng.uniform(0.005, 0.02, n))
    rate, force = rng.normal(size=(n, 3)), rng.normal(0.0, 5.0, size=(n, 3))
    of_rate, of_force = (rng.normal(size=(n, count)) for count in regressors)
    first, weight = np.arange(0, n - width + 1, width // 2), rng.uniform(size=width)
    weight /= weight.sum()

    def means(rate, force):
        out = np.full((len(first), 3 + 9 * sum(regressors)), np.nan)
        given = (rate, force, of_rate, of_force)
        carried_means(*(item.reshape(-1) for item in given), time, first, weight, out.reshape(-1))
        return out

    out, twin = means(rate, force), twins.carried_means(rate, force, of_rate, of_force, time, first, weight)
    np.testing.assert_allclose(out, np.hstack([item.reshape(len(first), -1) for item in twin]), rtol=0, atol=1e-11)
    # what they say of a change is what comes of it
    turned, fixed = np.split(out[:, 3:], [9 * regressors[0]], axis=1)
    small, little = (1e-5 * rng.normal(size=(3, count)) for count in regressors)
    for changed, shown, limit in (
        ((rate + of_rate @ small.T, force), turned.reshape(len(first), 3, -1) @ small.ravel(), 1e-3),
        ((rate, force + of_force @ little.T), fixed.reshape(len(first), 3, -1) @ little.ravel(), 1e-6),
    ):
        came = means(*changed)[:, :3] - out[:, :3]
        np.testing.assert_allclose(came, shown, rtol=0, atol=limit * np.abs(came).max())


# ---- the running sum of rotation and sensitivity, and the lead over uneven steps, against plain numpy twins


def accumulated_twin(rate, regressors, time, at):
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


def test_rotation_and_sensitivity_equal_the_numpy_accumulated_twin():
    rng = np.random.default_rng(0)
    n = 300
    time = np.cumsum(rng.uniform(0.008, 0.012, n))
    rate = rng.normal(0.0, 8.0, (n, 3))
    rate[100] *= 40.0  # over the bound of the series: the exact branch
    regressors = rng.normal(size=(n, 7))
    at = np.sort(np.concatenate((time[[0, 5, 299]], rng.uniform(time[0], time[-1], 40))))
    q, sums = np.zeros((len(at), 4)), np.zeros((len(at), 3, 3, 7))
    accumulate(rate.reshape(-1), regressors.reshape(-1), time, at, q.reshape(-1), sums.reshape(-1))
    q_twin, sums_twin = accumulated_twin(rate, regressors, time, at)
    q_twin *= np.sign((q * q_twin).sum(axis=1))[:, None]
    assert np.abs(q - q_twin).max() < 1e-11  # series to 1e-12 per step, 300 steps
    assert np.abs(sums - sums_twin).max() < 1e-11 * np.abs(sums_twin).max()


def lead_twin(temp, time, lag, smooth):
    """Integrate z' = (x - z) / smooth with x straight between samples."""
    z = [temp[0]]
    for k in range(1, len(temp)):
        slope = (temp[k] - temp[k - 1]) / (time[k] - time[k - 1])

        def rate(t, z, k=k, slope=slope):
            return (temp[k - 1] + slope * (t - time[k - 1]) - z) / smooth

        z.append(solve_ivp(rate, (time[k - 1], time[k]), [z[-1]], rtol=1e-11, atol=1e-12, method="DOP853").y[0, -1])
    z = np.array(z)
    return z + lag / smooth * (temp - z)


def test_the_lead_equals_the_numpy_twin_over_uneven_steps():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.choice((0.01, 0.3, 2.8, 40.0), 60))  # from far below to far above the time constant
    temp = 20.0 + np.cumsum(rng.normal(0.0, 0.3, 60))
    out, state = np.empty(60), np.full(4, np.nan)
    lead(temp, time, out, 30.0, 4.0, state)
    wanted = lead_twin(temp, time, 30.0, 4.0)
    assert np.abs(out - wanted).max() < 1e-8  # the integrator's tolerance times lag / smooth
    assert state[0] == time[-1]
    assert state[1] == temp[-1]
    assert state[3] == out[-1]
