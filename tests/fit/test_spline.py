"""Curves over temperature: exact where they can be, honest where they cannot."""

import numpy as np
import pytest

from undrift.errors import InputError, NotObservable
from undrift.fit.smooth import (
    Problem,
    Weighed,
    bending,
    curve_at,
    fit_smooth,
    neighbours,
    not_a_knot,
    parabola,
    widening_of,
)

NODES = np.linspace(18.0, 75.0, 115)


def bent(temp_c):
    return 0.3 + 0.07 * (temp_c - 25.0) - 1.5e-3 * (temp_c - 25.0) ** 2


def test_not_a_knot_returns_a_cubic_exactly_and_its_covariance_is_linear_in_the_data():
    temp = np.array([18.0, 30.0, 41.0, 60.0, 75.0])
    cubic = 1e-4 * (temp - 40.0) ** 3 - 0.02 * temp
    found = not_a_knot(temp, cubic[:, None], np.full((5, 1), 4.0), NODES)
    # five points, cubic with not-a-knot ends: one polynomial
    np.testing.assert_allclose(found.value[:, 0], 1e-4 * (NODES - 40.0) ** 3 - 0.02 * NODES, atol=1e-10)
    at_points = not_a_knot(temp, cubic[:, None], np.full((5, 1), 4.0), temp)
    np.testing.assert_allclose(at_points.covariance[0], 4.0 * np.eye(5), atol=1e-10)


def test_not_a_knot_refuses_one_set_point_and_set_points_out_of_order():
    with pytest.raises(NotObservable, match="wanted two set-points or more, got 1; record at another temperature"):
        not_a_knot(np.array([20.0]), np.zeros((1, 3)), np.zeros((1, 3)), NODES)
    with pytest.raises(InputError, match="wanted set-points that increase"):
        not_a_knot(np.array([30.0, 20.0]), np.zeros((2, 3)), np.zeros((2, 3)), NODES)


def test_a_smooth_curve_follows_exact_values_and_its_uncertainty_grows_outside_them():
    temp = np.linspace(25.0, 65.0, 21)
    found = fit_smooth(temp, bent(temp)[:, None], np.full((21, 1), 1e-12)).at(NODES)
    inside = (NODES >= 25.0) & (NODES <= 65.0)
    np.testing.assert_allclose(found.value[inside, 0], bent(NODES[inside]), atol=1e-3)  # of 0.7: its ends are straight
    below, above = found.uncertainty[NODES < 24.0, 0], found.uncertainty[NODES > 66.0, 0]
    assert (np.diff(below) < 0.0).all()
    assert (np.diff(above) > 0.0).all()
    assert below.min() > found.uncertainty[inside].max()
    assert (np.abs(found.value[:, 0] - bent(NODES)) < 3.0 * found.uncertainty[:, 0] + 1e-6).all()


@pytest.mark.parametrize(("rows", "noise"), [(13, 0.005), (13, 0.05), (60, 0.01)])
def test_intervals_hold_the_curve_although_the_stated_variance_is_too_small(rows, noise):
    rng, inside = np.random.default_rng(0), []
    temp = np.linspace(18.0, 75.0, rows)
    for _ in range(60):
        linear, square = rng.normal(size=2) * [0.07, 1.5e-3]
        true = linear * (NODES - 25.0) + square * (NODES - 25.0) ** 2
        said = np.interp(temp, NODES, true) + noise * rng.normal(size=rows)
        found = fit_smooth(temp, said[:, None], np.full((rows, 1), (0.5 * noise) ** 2)).at(NODES)
        inside.append((np.abs(found.value[:, 0] - true) <= 1.96 * found.uncertainty[:, 0]).mean())
    assert 0.91 <= np.mean(inside) <= 0.99  # sixty curves tell their coverage to about 0.015


def test_an_effect_beside_temperature_gets_its_coefficient_and_leaves_the_curve_alone():
    rng = np.random.default_rng(1)
    temp = np.concatenate((np.linspace(18.0, 75.0, 20), np.linspace(20.0, 40.0, 7)))
    way = np.concatenate((-np.ones(20), np.ones(7)))
    said = bent(temp) + 0.05 * way + 0.002 * rng.normal(size=27)
    made = fit_smooth(temp, said[:, None], np.full((27, 1), 0.002**2), regressors=way[:, None])
    assert abs(made.coefficient[0, 0] - 0.05) < 3.0 * made.coefficient_uncertainty[0, 0] < 0.01
    np.testing.assert_allclose(made.at(NODES).value[:, 0], bent(NODES), atol=0.01)


def test_one_temperature_and_effects_that_are_not_determined_are_refused():
    with pytest.raises(NotObservable, match="wanted two temperatures or more, got 1"):
        fit_smooth(np.full(5, 20.0), np.zeros((5, 1)), np.ones((5, 1)))
    with pytest.raises(NotObservable, match="determine a line and 1 effects"):
        fit_smooth(np.arange(5.0), np.zeros((5, 1)), np.ones((5, 1)), regressors=np.ones((5, 1)))


def test_groups_are_neighbours():
    temp = np.array([30.0, 10.0, 20.0, 40.0])
    np.testing.assert_array_equal(neighbours(temp, 2), [1, 0, 0, 1])


def test_the_covariance_of_a_bending_curve_is_the_integral_of_its_two_kernels():
    at = np.array([-0.7, -0.2, 0.1, 0.5, 0.9])
    for s, row in zip(at, bending(at, at), strict=True):
        for t, found in zip(at, row, strict=True):
            u = np.linspace(0.0, min(abs(s), abs(t)), 2001) if s * t > 0.0 else np.zeros(2)
            wanted = np.trapezoid((abs(s) - u) * (abs(t) - u), u)  # curvature at u is felt s - u away from it
            assert found == pytest.approx(wanted, abs=1e-7)


def test_a_curve_is_conditioned_on_its_rows_as_any_gaussian_is():
    rng = np.random.default_rng(17)
    x, nodes = np.sort(rng.uniform(-0.5, 0.5, 9)), np.linspace(-0.8, 0.8, 7)
    problem = Problem(
        x=x, y=rng.normal(size=9), variance=rng.uniform(0.1, 0.2, 9), basis=np.column_stack((np.ones(9), x)),
        correlation=np.eye(9), groups=np.arange(9), bow=0.5,
    )  # fmt: skip
    bend, scatter = np.array([3.0, 40.0]), np.array([0.05, 0.3])
    share = np.array([0.3, 0.7])
    column = Weighed(
        problem=problem, bend=bend, scatter=scatter, weight=share, coefficient=np.zeros(0), uncertainty=np.zeros(0),
        leave_out_rms=0.0,
    )  # fmt: skip
    means, covariances, flat = [], [], 1e4  # a line of unknown height and slope: one of large variance
    both = np.concatenate((nodes, x))
    line = flat * (1.0 + np.outer(both, both))
    for q, s2 in zip(bend, scatter, strict=True):
        prior = q * bending(both, both) + problem.bow * np.outer(parabola(both), parabola(both)) + line
        rows = prior[7:, 7:] + np.diag(problem.variance + s2)
        gain = prior[:7, 7:] @ np.linalg.inv(rows)
        means.append(gain @ problem.y)
        covariances.append(prior[:7, :7] - gain @ prior[7:, :7])
    mean = share @ np.array(means)
    apart = np.array(means) - mean
    wanted = np.einsum("g,gmn->mn", share, np.array(covariances)) + (share[:, None] * apart).T @ apart
    found_mean, found = curve_at(column, nodes)
    np.testing.assert_allclose(found_mean, mean, rtol=0, atol=1e-3)  # the line's variance is 1e4, not infinite
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-3)


def test_few_degrees_of_freedom_widen_by_student_over_the_normal():
    assert widening_of(1.0) == pytest.approx((12.7062047 / 1.95996398) ** 2, rel=1e-7)  # tables of the 97.5 % points
    assert widening_of(10.0) == pytest.approx((2.22813885 / 1.95996398) ** 2, rel=1e-7)


def test_beyond_the_data_the_curvature_that_was_seen_may_continue():
    temp = np.linspace(25.0, 65.0, 21)
    found = fit_smooth(temp, bent(temp)[:, None], np.full((21, 1), 1e-12))
    for node, away in ((75.0, 10.0), (18.0, 7.0)):
        at = found.at(np.array([node]))
        # the tangent at the end of the data misses the parabola by 1.5e-3 of the square; that much is stated, two times at most
        assert 1.5e-3 * away**2 <= at.uncertainty[0, 0] * 1.96
        assert at.uncertainty[0, 0] <= 4.0 * 1.5e-3 * away**2
