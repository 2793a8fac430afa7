"""Curves over temperature: the textbook's conditioning, coverage with few rows, and what cannot be determined."""

import numpy as np
import pytest

from testkit.cohorts import share_limits
from testkit.data import show
from undrift.errors import NotObservable
from undrift.fit.curve import Curve, bending, fit_curve, not_a_knot

NODES = np.linspace(18.0, 75.0, 115)


def bent(temp_c):
    return 0.3 + 0.07 * (temp_c - 25.0) - 1.5e-3 * (temp_c - 25.0) ** 2


def test_not_a_knot_returns_a_cubic_exactly():
    temp = np.array([18.0, 30.0, 41.0, 60.0, 75.0])
    cubic = 1e-4 * (temp - 40.0) ** 3 - 0.02 * temp
    spline = not_a_knot(temp, cubic[:, None], np.full((5, 1), 4.0), NODES)
    np.testing.assert_allclose(spline.value[:, 0], 1e-4 * (NODES - 40.0) ** 3 - 0.02 * NODES, atol=1e-10)
    at_points = not_a_knot(temp, cubic[:, None], np.full((5, 1), 4.0), temp)
    np.testing.assert_allclose(at_points.covariance[0], 4.0 * np.eye(5), atol=1e-10)


def drawn_curve(rng, regressors=0):
    """Nine rows of two columns, with given hyperparameters."""
    x = np.sort(rng.uniform(-0.5, 0.5, 9))
    root = rng.normal(size=(9, 9))
    correlation = root @ root.T + 9.0 * np.eye(9)
    correlation /= np.sqrt(np.outer(np.diag(correlation), np.diag(correlation)))
    return Curve(
        origin_c=0.0, span_c=1.0, x=x, value=rng.normal(size=(9, 2)),
        basis=np.column_stack((np.ones(9), x, rng.normal(size=(9, regressors)))),
        stated=np.array([np.diag(rng.uniform(0.1, 0.2, 9)) for _ in range(2)]), correlation=correlation,
        bow=np.array([0.5, 0.1]), bend=np.array([3.0, 40.0]), visit=np.array([0.05, 0.3]),
    )  # fmt: skip


@pytest.mark.parametrize("regressors", [0, 2])
def test_curve_is_conditioned_as_any_gaussian(regressors):
    curve, nodes, flat = drawn_curve(np.random.default_rng(17), regressors), np.linspace(-0.8, 0.8, 7), 1e4
    both = np.concatenate((nodes, curve.x))
    at, effects = curve.at(nodes), curve.basis[:, 2:]
    for k in range(2):
        prior = curve.kernel(both, both)[k] + flat * (1.0 + np.outer(both, both))
        rows = prior[7:, 7:] + flat * effects @ effects.T + curve.visit[k] * curve.correlation + curve.stated[k]
        gain = prior[:7, 7:] @ np.linalg.inv(rows)
        np.testing.assert_allclose(at.value[:, k], gain @ curve.value[:, k], atol=3e-3)
        np.testing.assert_allclose(at.covariance[k], prior[:7, :7] - gain @ prior[7:, :7], atol=3e-3)


def test_bends_on_either_side_of_the_origin_are_independent():
    at, u = np.array([-0.7, -0.2, 0.1, 0.5, 0.9]), np.linspace(0.0, 1.0, 4001)
    # white noise at distance u from the origin changes the curve beyond it, on its own side, by the rest of the way
    sides = [np.maximum(sign * at[:, None] - u, 0.0) for sign in (-1.0, 1.0)]
    covariance = np.sum([np.trapezoid(side[:, None] * side, u) for side in sides], axis=0)
    np.testing.assert_allclose(bending(at, at), covariance, atol=1e-7)


def test_uncertainty_grows_beyond_the_data_and_holds_a_parabola():
    temp = np.linspace(25.0, 65.0, 21)
    at = fit_curve(temp, bent(temp)[:, None], np.full((21, 1), 1e-12)).at(NODES)
    inside = (NODES >= 25.0) & (NODES <= 65.0)
    np.testing.assert_allclose(at.value[inside, 0], bent(NODES[inside]), atol=1e-3)
    below, above = at.uncertainty[NODES < 24.0, 0], at.uncertainty[NODES > 66.0, 0]
    assert (np.diff(below) < 0.0).all()
    assert (np.diff(above) > 0.0).all()
    assert below.min() > at.uncertainty[inside].max()
    assert (np.abs(at.value[:, 0] - bent(NODES)) < 3.0 * at.uncertainty[:, 0] + 1e-6).all()


def test_effect_beside_temperature_gets_its_coefficient():
    rng = np.random.default_rng(1)
    temp = np.concatenate((np.linspace(18.0, 75.0, 20), np.linspace(20.0, 40.0, 7)))
    way = np.concatenate((-np.ones(20), np.ones(7)))
    value = bent(temp) + 0.05 * way + 0.002 * rng.normal(size=27)
    curve = fit_curve(temp, value[:, None], np.full((27, 1), 0.002**2), regressors=way[:, None])
    assert abs(curve.coefficient[0, 0] - 0.05) < 3.0 * curve.coefficient_uncertainty[0, 0] < 0.012
    np.testing.assert_allclose(curve.at(NODES).value[:, 0], bent(NODES), atol=0.01)


def test_one_temperature_and_undetermined_effects_are_refused():
    with pytest.raises(NotObservable, match="two temperatures"):
        fit_curve(np.full(5, 20.0), np.zeros((5, 1)), np.ones((5, 1)))
    with pytest.raises(NotObservable, match="1 effects"):
        fit_curve(np.arange(5.0), np.zeros((5, 1)), np.ones((5, 1)), regressors=np.ones((5, 1)))


@pytest.mark.parametrize(
    ("soaks", "visit", "noise"), [(4, 0.02, 0.001), (6, 0.02, 0.01), (12, 0.005, 4e-4), (12, 0.0, 0.01)]
)
def test_one_more_soak_lies_within_what_is_stated(soaks, visit, noise):
    rng, error, stated = np.random.default_rng(22), [], []
    for _ in range(60):  # parabolas of three axes, and visits that scatter
        line, square = rng.normal(size=(2, 3)) * [[0.07], [1.5e-3]]
        temp = np.append(np.linspace(18.0, 75.0, soaks), rng.uniform(20.0, 73.0))[:, None]
        y = line * temp + square * (temp - 45.0) ** 2 + np.hypot(visit, noise) * rng.normal(size=(soaks + 1, 3))
        curve = fit_curve(temp[:-1, 0], y[:-1], np.full((soaks, 3), noise**2))
        at = curve.at(temp[-1])
        error.append(y[-1] - at.value[0])
        stated.append(np.sqrt(at.uncertainty[0] ** 2 + curve.visit_deviation**2 + noise**2))
    inside = float(np.mean(np.abs(error) <= 1.96 * np.array(stated)))
    limit, _ = share_limits(180)
    show(f"{soaks} soaks, visits add {1e3 * visit:g} mdeg/s, noise {1e3 * noise:g}: inside", f"{inside:.3f}", limit)
    show("rms error and stated, mdeg/s", np.round(1e3 * np.sqrt(np.mean(np.square([error, stated]), axis=(1, 2))), 1))
    assert inside >= limit
