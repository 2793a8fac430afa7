"""Inverse models carry errors as finite differences do; a descent ends at the minimum."""

from collections.abc import Callable

import numpy as np
import pytest

from undrift.fit.equations import (
    Inverse,
    Rows,
    covariance_of,
    descend,
    joined,
    offset_of,
    parameter_order,
)

RNG = np.random.default_rng(5)
THETA = np.column_stack((np.eye(3) + 0.05 * RNG.normal(size=(3, 3)), RNG.normal(size=3), 0.1 * RNG.normal(size=(3, 3))))


@pytest.mark.parametrize("count", [4, 7])
def test_the_inverse_model_carries_errors_as_finite_differences_do(count: int) -> None:
    def parameters(theta: np.ndarray) -> np.ndarray:
        inverse = Inverse.of(theta)
        g = np.zeros(0) if inverse.g_sensitivity is None else inverse.g_sensitivity.ravel()
        return np.concatenate((inverse.matrix.ravel(), inverse.offset, g))

    theta, order, step = THETA[:, :count], parameter_order(count), 1e-6
    expected = np.zeros((3 * count, 3 * count))
    for place, flat in enumerate(order):
        moved = np.zeros(3 * count)
        moved[flat] = step
        away = moved.reshape(3, count)
        expected[:, place] = (parameters(theta + away) - parameters(theta - away)) / (2.0 * step)
    np.testing.assert_allclose(Inverse.of(theta).jacobian, expected, atol=1e-8)
    assert len(Inverse.of(theta).parameters) == 3 * count


def test_the_offset_of_a_constant_carries_errors_as_finite_differences_do() -> None:
    matrix, constant, step = THETA[:, :3], THETA[:, 3], 1e-6
    offset, jacobian = offset_of(matrix, constant, 12)
    np.testing.assert_allclose(matrix @ offset, constant, atol=1e-12)
    for place in range(12):
        moved = np.zeros(12)
        moved[place] = step
        high, low = (
            offset_of(matrix + s * moved[:9].reshape(3, 3), constant + s * moved[9:], 12)[0] for s in (1.0, -1.0)
        )
        np.testing.assert_allclose(jacobian[9:12, place], (high - low) / (2.0 * step), atol=1e-8)


def test_joined_keeps_leading_dimensions_and_the_order_of_a_model() -> None:
    parts = [np.stack([np.full((4, 4), 10.0 * t + k) for t in range(2)]) for k in range(3)]
    total = joined(parts)
    assert total.shape == (2, 12, 12)
    np.testing.assert_array_equal(np.diag(total[1])[:9], np.repeat([10.0, 11.0, 12.0], 3))
    assert total[1, 0, 9] == 10.0
    assert total[1, 0, 10] == 0.0


NONE = np.zeros((0, 2))  # no prior


def rows_of(exponents: np.ndarray, reading: np.ndarray) -> Callable[[np.ndarray], Rows]:
    """Return the rows of reading = a exp(-b t), weighed alike; the residuals are their state."""

    def rows(p: np.ndarray) -> Rows:
        wave = np.exp(-p[1] * exponents)
        residual, design = p[0] * wave - reading, np.column_stack((wave, -p[0] * exponents * wave))
        return Rows(residual, design, residual)

    return rows


def test_a_descent_ends_at_the_minimum_with_the_rows_there() -> None:
    time = np.linspace(0.0, 3.0, 20)
    rows, start = rows_of(time, 2.0 * np.exp(-0.7 * time)), np.array([1.0, 0.1])
    p, best, found = descend(rows, start, NONE, tolerance=1e-12, size=np.ones(2))
    assert found
    np.testing.assert_allclose(p, [2.0, 0.7], rtol=1e-9)
    np.testing.assert_array_equal(best.state, rows(p).state)


def test_a_descent_that_runs_away_or_out_of_steps_gives_its_start_back() -> None:
    time = np.linspace(0.0, 3.0, 20)
    rows, start = rows_of(time, 2.0 * np.exp(-0.7 * time)), np.array([1.0, 0.1])
    for limits in ({"farthest": 1.5}, {"steps": 1}):
        p, best, found = descend(
            rows, start, NONE, first=(first := rows(start)), tolerance=1e-12, size=np.ones(2), **limits
        )
        assert not found
        assert p is start
        assert best is first


def test_a_prior_is_rows_among_the_others() -> None:
    time, prior = np.linspace(0.0, 3.0, 20), np.array([[0.5, -0.3]])
    rows, start = rows_of(time, 2.0 * np.exp(-0.7 * time)), np.array([1.0, 0.1])

    def stacked(p: np.ndarray) -> Rows:
        own = rows(p)
        return Rows(np.append(own.residual, prior @ p), np.vstack((own.design, prior)), own.state)

    (p, best, found), (q, other, _) = (
        descend(each, start, known, tolerance=1e-12, size=np.ones(2))
        for each, known in ((rows, prior), (stacked, NONE))
    )
    assert found
    np.testing.assert_allclose(p, q, rtol=1e-12)
    np.testing.assert_allclose(covariance_of(best.design), covariance_of(other.design), rtol=1e-9)
    np.testing.assert_allclose(covariance_of(best.design), np.linalg.inv(best.design.T @ best.design), rtol=1e-9)
    assert np.isnan(covariance_of(np.ones((5, 2)))).all()
