"""Generalised least squares with a random walk: against plain linear algebra, closed forms, and its own statistics."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad_vec

from testkit.cohorts import LARGER_COHORTS
from testkit.data import show
from undrift.fit.equations import fit_with_walk

TIME = np.arange(40.0) * 5.0
DESIGN = np.column_stack((np.tile([1.0, -1.0, 0.5, -0.5], 10), np.repeat([1.0, -1.0, 0.0, 1.0], 10), np.ones(40)))
THETA = np.array([2.0, -0.3, 0.7])
SIGMA = np.where(np.arange(40) % 3 == 0, 0.02, 0.03)


def shape_of(time):
    """min of the distances from the middle, on the same side, written out."""
    middle = (time.min() + time.max()) / 2.0
    shape = np.zeros((len(time), len(time)))
    for i, a in enumerate(time - middle):
        for j, b in enumerate(time - middle):
            if a * b > 0.0:
                shape[i, j] = min(abs(a), abs(b))
    return shape


@cache
def shape():
    return shape_of(TIME)


def drawn(rng, walk, time=TIME, sigma=SIGMA):
    away = time - (time.min() + time.max()) / 2.0
    offset = np.zeros(len(time))
    for side in (away > 0.0, away < 0.0):
        order = np.flatnonzero(side)[np.argsort(np.abs(away[side]))]
        offset[order] = np.cumsum(
            walk * np.sqrt(np.diff(np.abs(away[order]), prepend=0.0)) * rng.standard_normal(len(order))
        )
    return DESIGN @ THETA + offset + sigma * rng.standard_normal(len(time))


def at(q, reading):
    """theta, covariance, r' V^-1 r and log L at one q, by explicit inverses."""
    weight = np.linalg.inv(np.diag(SIGMA**2) + q**2 * shape())
    normal = DESIGN.T @ weight @ DESIGN
    theta = np.linalg.solve(normal, DESIGN.T @ weight @ reading)
    left = reading - DESIGN @ theta
    square = left @ weight @ left
    log = 0.5 * (np.linalg.slogdet(weight)[1] - np.linalg.slogdet(normal)[1] - square)
    return theta, np.linalg.inv(normal), square, log


def test_without_noise_the_parameters_come_back():
    fit = fit_with_walk(DESIGN, DESIGN @ THETA, np.full(40, 1e-9), TIME)
    np.testing.assert_allclose(fit.theta, THETA, atol=1e-14)
    assert fit.walk == 0.0
    assert fit.square < 1e-6


def test_without_times_it_is_weighted_least_squares():
    reading = drawn(np.random.default_rng(1), 0.05)
    fit = fit_with_walk(DESIGN, reading, SIGMA, None)
    theta, covariance, square, _ = at(0.0, reading)
    np.testing.assert_allclose(fit.theta, theta, rtol=1e-11)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-10, atol=1e-16)
    assert fit.square == pytest.approx(square, rel=1e-10)
    assert fit.walk == 0.0


@pytest.mark.parametrize("walk", [0.0, 0.002, 0.05])
def test_parameters_and_covariance_are_averages_over_every_walk(walk):
    reading = drawn(np.random.default_rng(2), walk)
    unit = np.median(SIGMA) / np.sqrt(97.5)  # a walk that ends one sigma off
    top = max(at(q, reading)[3] for q in np.geomspace(1e-5, 1.0, 200))

    def moments(u, quiet):
        theta, covariance, _, log = at(u * unit, reading)
        share = np.exp(log - top) / (u + quiet if quiet else 1.0)
        return share * np.concatenate(([1.0], theta, np.outer(theta, theta).ravel(), covariance.ravel()))

    def average(quiet):
        total = quad_vec(lambda u: moments(u, quiet), 0.0, 400.0, points=(0.1, 1.0, 10.0), epsrel=1e-7)[0]
        return total[1:4] / total[0], total[4:13].reshape(3, 3) / total[0], total[13:].reshape(3, 3) / total[0]

    theta = average(0.1)[0]
    mean, square, covariance = average(0.0)
    expected = covariance + square - np.outer(mean, theta) - np.outer(theta, mean) + np.outer(theta, theta)
    fit = fit_with_walk(DESIGN, reading, SIGMA, TIME)
    uncertain = np.sqrt(np.diag(expected))
    # Trapezoids in steps of a tenth: good to a per cent of the uncertainty.
    np.testing.assert_allclose(fit.theta / uncertain, theta / uncertain, atol=0.01)
    np.testing.assert_allclose(
        fit.covariance / np.outer(uncertain, uncertain), expected / np.outer(uncertain, uncertain), atol=0.01
    )


def test_the_walk_is_the_most_likely_one():
    reading = drawn(np.random.default_rng(3), 0.05)
    grid = np.geomspace(0.01, 0.3, 4000)
    best = max(grid, key=lambda q: at(q, reading)[3])
    fit = fit_with_walk(DESIGN, reading, SIGMA, TIME)
    assert fit.walk == pytest.approx(best, rel=0.005)  # a parabola over a fifth of an e-fold
    assert fit.square == pytest.approx(
        at(best, reading)[2], rel=0.2
    )  # at the nearest of the grid, a tenth apart, squared


def test_the_offset_is_that_of_the_middle_between_its_neighbours():
    # Noise is nothing beside the walk. Seen from the middle, t = 5, the readings at 4 and at 10 are 1 and 5 s away: their walks
    # have variances 1 : 5, so that the offset is (5 u(4) + u(10)) / 6, and what lies beyond adds nothing.
    time = np.array([0.0, 1.0, 2.0, 4.0, 10.0])
    reading = np.array([0.3, -0.2, 0.6, 1.0, 4.0])
    fit = fit_with_walk(np.ones((5, 1)), reading, np.full(5, 1e-6), time)
    assert fit.theta[0] == pytest.approx((5.0 * 1.0 + 4.0) / 6.0, abs=1e-4)
    assert fit.walk > 0.0


def test_fewer_than_four_equations_to_spare_leave_the_walk_out():
    reading = np.array([0.0, 5.0, -5.0, 5.0, -5.0])
    sigma, time = np.full(5, 1e-3), np.arange(5.0)
    assert fit_with_walk(np.ones((5, 1)), reading, sigma, time).walk > 0.0
    short = fit_with_walk(np.ones((4, 1)), reading[:4], sigma[:4], time[:4])
    assert short.walk == 0.0
    np.testing.assert_allclose(short.covariance, [[1e-6 / 4.0]], rtol=1e-12)


def test_times_that_are_all_the_same_leave_nothing_to_walk():
    reading = drawn(np.random.default_rng(4), 0.0)
    fit = fit_with_walk(DESIGN, reading, SIGMA, np.full(40, 3.0))
    assert fit.walk == 0.0
    np.testing.assert_allclose(fit.theta, at(0.0, reading)[0], rtol=1e-10)


@pytest.mark.parametrize("runs", LARGER_COHORTS)
def test_a_walk_that_is_not_there_is_told_once_in_forty(runs):
    rng = np.random.default_rng(5)
    told = np.mean([fit_with_walk(DESIGN, drawn(rng, 0.0), SIGMA, TIME).walk > 0.0 for _ in range(runs)])
    show("walks told where there is none", told, 0.05)
    assert told <= 0.05  # chi-square at 95 %, one side: 2.5 %, standard error 0.9 % of 300 runs, 0.5 % of 1,000


@pytest.mark.parametrize("runs", LARGER_COHORTS)
@pytest.mark.parametrize("walk", [0.03, 0.3])
def test_a_walk_that_is_there_is_found_within_its_scatter(walk, runs):
    rng = np.random.default_rng(6)
    found = np.array([fit_with_walk(DESIGN, drawn(rng, walk), SIGMA, TIME).walk for _ in range(runs)])
    spread = np.sqrt(2.0 / 37.0)  # of q^2, with 37 equations to spare and a walk far above the noise
    if walk == 0.03:
        spread = float(np.std(found**2)) / walk**2  # where noise is beside it, by its own scatter
        assert spread < 0.6
    show(f"mean q^2 over truth, walk {walk}", np.mean(found**2) / walk**2)
    assert np.mean(found**2) / walk**2 == pytest.approx(1.0, abs=3.0 * spread / np.sqrt(runs))


@pytest.mark.parametrize("runs", LARGER_COHORTS)
@pytest.mark.parametrize("walk", [0.002, 0.005, 0.03, 0.3])
def test_intervals_hold_whether_the_walk_shows_or_not(walk, runs):
    rng = np.random.default_rng(7)
    inside = []
    for _ in range(runs):
        fit = fit_with_walk(DESIGN, drawn(rng, walk), SIGMA, TIME)
        inside.append(np.abs(fit.theta - THETA) <= 1.959964 * np.sqrt(np.diag(fit.covariance)))
    share = np.mean(inside, axis=0)
    show(f"coverage of 95 % intervals, walk {walk}: scale, slow parameter, offset", share)
    # 900 intervals: standard error 0.7 %; a walk too small to rule out makes them too wide, not too narrow
    assert 0.93 <= np.mean(share) <= 0.985
    assert (share >= 0.925).all()  # 300 each: 1.3 %, 1,000 each: 0.7 %
