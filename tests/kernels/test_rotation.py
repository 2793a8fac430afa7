"""The strapdown kernel: exact for a constant rate, true to its rule, and of unit length for ever."""

import os

import numpy as np
import pytest

from testkit import twins
from testkit.data import show
from undrift.errors import InputError
from undrift.frames import integrate_strapdown, quaternion_conjugate, quaternion_product
from undrift.kernels.rotation import carried_means

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
    assert (
        angle_between(q, twins.strapdown(gyro, time, start)).max() < 1e-13
    )  # both are right to a few roundings a step


def test_coning_error_falls_with_the_square_of_the_step():
    # Classical coning: an axis tilted by a cone angle goes round; the rate held over a step misses the third-order area.
    cone, speed, seconds = 0.1, 2.0 * np.pi, 1.0

    def error(n):
        time = np.linspace(0.0, seconds, n + 1)
        middle = time - 0.5 * seconds / n  # the mean rate of a step, to second order, is the rate at its middle
        s, c = np.sin(cone), np.cos(cone)
        gyro = speed * np.column_stack(
            (-s * np.sin(speed * middle), s * np.cos(speed * middle), np.full(n + 1, -(1.0 - c)))
        )
        half = 0.5 * cone
        truth = np.column_stack(
            (
                np.full(n + 1, np.cos(half)),
                np.sin(half) * np.cos(speed * time),
                np.sin(half) * np.sin(speed * time),
                np.zeros(n + 1),
            )
        )
        return angle_between(integrate_strapdown(gyro, time, truth[0]), truth)[-1]

    coarse, fine = error(100), error(200)
    show("coning, 100 and 200 steps a turn, rad", (coarse, fine))
    assert coarse / fine == pytest.approx(4.0, rel=0.02)  # second order; the next term is 2 % at a hundred steps a turn
    assert fine < 1e-4


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
