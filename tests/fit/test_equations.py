"""Equations of three sensors: solved, carried and budgeted as by the whole system at once, and by finite differences."""

from collections.abc import Callable

import numpy as np
import pytest

from undrift.fit.equations import (
    Equations,
    Inverse,
    Rows,
    carried_own,
    covariance_of,
    descend,
    diagonal,
    joined,
    offset_of,
    parameter_order,
    roots,
    solutions,
)

RNG = np.random.default_rng(5)
E = 14
THETA = np.column_stack((np.eye(3) + 0.05 * RNG.normal(size=(3, 3)), RNG.normal(size=3), 0.1 * RNG.normal(size=(3, 3))))
UNKNOWNS = {"matrix": RNG.normal(size=(E, 3)), "offset": np.ones((E, 1)), "g": RNG.normal(size=(E, 3))}
DESIGN = np.hstack([*UNKNOWNS.values()])
NOISE = 0.01 * (1.0 + RNG.random((E, 3)))
CREEP, ANGLE = 0.02 * RNG.normal(size=(3, E, 2)), 0.02 * RNG.normal(size=(3, E, 4))


def equations() -> Equations:
    return Equations(
        unknowns=UNKNOWNS,
        reading=DESIGN @ THETA.T,
        own={"noise": diagonal(NOISE**2), "temperature": CREEP @ CREEP.transpose(0, 2, 1)},
        shared={"angle": ANGLE},
    )


def whole(gains: np.ndarray) -> np.ndarray:
    """Return the covariance of all unknowns by one system of 3 E rows, in the order of a model's parameters."""
    rows, gain = np.zeros((3 * E, 3 * E)), np.zeros((21, 3 * E))
    for k in range(3):
        part = slice(E * k, E * k + E)
        rows[part, part] = np.diag(NOISE[:, k] ** 2) + CREEP[k] @ CREEP[k].T
        gain[7 * k : 7 * k + 7, part] = gains[k]
    errors = ANGLE.reshape(3 * E, 4)
    order = [
        *(7 * i + j for i in range(3) for j in range(3)),
        3,
        10,
        17,
        *(7 * i + 4 + j for i in range(3) for j in range(3)),
    ]
    return np.asarray((gain @ (rows + errors @ errors.T) @ gain.T)[np.ix_(order, order)])


def test_gains_give_the_unknowns_of_exact_readings() -> None:
    theta = np.einsum("ipe,ei->ip", equations().gains(), equations().reading)
    np.testing.assert_allclose(theta, THETA, atol=1e-12)


def test_gains_are_those_of_generalised_least_squares() -> None:
    for k, gain in enumerate(equations().gains()):
        weight = np.linalg.inv(np.diag(NOISE[:, k] ** 2) + CREEP[k] @ CREEP[k].T + ANGLE[k] @ ANGLE[k].T)
        np.testing.assert_allclose(
            gain, np.linalg.inv(DESIGN.T @ weight @ DESIGN) @ DESIGN.T @ weight, rtol=1e-8, atol=1e-10
        )


def test_sensors_that_share_an_error_are_correlated_by_it_alone() -> None:
    e, gains = equations(), equations().gains()
    np.testing.assert_allclose(e.carried(gains), whole(gains), rtol=1e-9, atol=1e-16)
    apart = carried_own(gains, e.own["noise"])
    assert apart[0, 3] == 0.0
    assert e.shares(gains)["angle"][0, 3] != 0.0


def test_shares_and_what_comes_on_top_sum_to_the_covariance() -> None:
    e, gains = equations(), equations().gains()
    more = carried_own(gains, diagonal(0.1 * NOISE**2))
    np.testing.assert_allclose(sum(e.shares(gains).values()), e.carried(gains), rtol=1e-12)
    np.testing.assert_allclose(
        e.carried(gains, diagonal(0.1 * NOISE**2)), e.carried(gains) + more, rtol=1e-9, atol=1e-18
    )


def test_a_budget_has_a_line_for_each_source_and_one_for_the_rest() -> None:
    e, inverse = equations(), Inverse.of(THETA)
    total = 1.5 * inverse.carried(e.carried(e.gains()))
    table = 0.25 * inverse.carried(e.carried(e.gains()))
    budget = e.budget(inverse, total, "instability", more=[("ripple", table), ("noise", 0.0 * table)])
    assert set(budget.sources) == {"noise", "temperature", "angle", "ripple", "instability"}
    np.testing.assert_allclose((budget.uncertainty**2).sum(axis=0), np.diag(total), rtol=1e-9)
    ripple = budget.uncertainty[budget.sources.index("ripple")] ** 2
    np.testing.assert_allclose(ripple, np.diag(total) / 6.0, rtol=1e-9)


def test_the_square_of_residuals_is_weighed_by_all_sources() -> None:
    residuals = RNG.normal(size=(E, 3))
    direct = sum(float(r @ np.linalg.inv(v) @ r) for r, v in zip(residuals.T, equations().covariance, strict=True))
    assert equations().square(residuals) == pytest.approx(direct, rel=1e-9)


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


def test_a_family_of_covariances_is_solved_as_each_of_them() -> None:
    reading = DESIGN @ THETA[0] + NOISE[:, 0] * RNG.normal(size=E)
    sigma = NOISE[:, 0] * np.array([[1.0], [3.0]])
    columns = CREEP[0]
    fit = solutions(DESIGN, reading, roots(sigma, columns @ columns.T))
    values = []
    for k in range(2):
        v = np.diag(sigma[k] ** 2) + columns @ columns.T
        normal = DESIGN.T @ np.linalg.solve(v, DESIGN)
        theta = np.linalg.solve(normal, DESIGN.T @ np.linalg.solve(v, reading))
        rest = reading - DESIGN @ theta
        square = float(rest @ np.linalg.solve(v, rest))
        np.testing.assert_allclose(fit.theta[k], theta, rtol=1e-9)
        np.testing.assert_allclose(fit.covariance[k], np.linalg.inv(normal), rtol=1e-8)
        np.testing.assert_allclose(fit.gain[k] @ reading, theta, rtol=1e-8)
        assert fit.square[k] == pytest.approx(square, rel=1e-9)
        values.append(-0.5 * (np.linalg.slogdet(v)[1] + np.linalg.slogdet(normal)[1] + square))
    assert np.diff(fit.likelihood)[0] == pytest.approx(np.diff(values)[0], rel=1e-9)


def test_deviations_and_their_cholesky_factors_give_one_solution() -> None:
    reading, sigma = DESIGN @ THETA[0] + 0.01 * RNG.normal(size=E), NOISE[:, 0][None]
    one, two = solutions(DESIGN, reading, sigma), solutions(DESIGN, reading, sigma[:, :, None] * np.eye(E))
    for name in ("theta", "covariance", "gain", "square", "likelihood"):
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), rtol=1e-9, atol=1e-14)
    np.testing.assert_array_equal(roots(sigma[0], np.zeros((E, E))), sigma)


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
