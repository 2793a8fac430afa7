"""Groups of parameters whose size the data give: found where they are, left at their least where they are not."""

import numpy as np
import pytest

from undrift.fit.equations import fit_components

GROUPS = [np.arange(1, 41), np.arange(41, 81)]


def drawn(sizes, seed):
    """Return X'X, X'y of a mean and two groups of 40 effects, each seen five times with noise of 1; and the parameters."""
    rng = np.random.default_rng(seed)
    theta = np.concatenate(([3.0], *(size * rng.standard_normal(40) for size in sizes)))
    design = np.column_stack((np.ones(400), np.kron(np.eye(80), np.ones((5, 1)))))
    reading = design @ theta + rng.standard_normal(400)
    return design.T @ design, design.T @ reading, theta


def test_the_size_of_a_group_and_its_parameters_are_found_and_the_other_stays_out():
    normal, moment, theta = drawn((2.0, 0.0), 1)
    found = fit_components(normal, moment, np.zeros(81), GROUPS, np.zeros(2), 1.0)
    # 40 squares of mean 4.2: a standard error of sqrt(2 / 40), and 3 of them
    assert found.variance[0] == pytest.approx(4.0, rel=3.0 * (2.0 / 40.0) ** 0.5 * 4.2 / 4.0)
    assert found.variance[1] == 0.0
    np.testing.assert_array_equal(found.theta[41:], 0.0)
    sigma = np.sqrt(np.diag(found.covariance))[:41]
    assert np.mean(np.abs(found.theta - theta)[:41] < 1.96 * sigma) > 0.82  # 95 % of 41, chance once in a thousand
    # five readings of noise 1 and a prior of 2: 1 / sqrt(5 + 1 / 4), and the mean is uncertain too
    assert sigma[1:].min() > 0.9 / 5.25**0.5


def test_a_group_that_is_not_there_rarely_shows_and_a_least_size_is_kept():
    shown = 0
    for seed in range(60):
        normal, moment, _ = drawn((0.0, 0.0), seed)
        found = fit_components(normal, moment, np.zeros(81), GROUPS, np.array([0.0, 0.01]), 1.0)
        shown += int(found.variance[0] > 0.0)
        assert found.variance[1] >= 0.01
    assert shown <= 2  # of 60, one in a thousand each


def test_a_shown_size_exceeds_the_least_one():
    normal, moment, _ = drawn((1.0, 1.0), 4)
    found = fit_components(normal, moment, np.zeros(81), GROUPS, np.array([0.01, 0.01]), 1.0)
    assert np.all((found.variance > 0.5) & (found.variance < 2.0))  # 1.2 +- 0.27 of 40 squares
