"""Equations of three sensors: solved, carried and budgeted as by the whole system at once, and by finite differences."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad_vec

from testkit.cohorts import LARGER_COHORTS
from testkit.data import show
from undrift.fit.equations import (
    Equations,
    Inverse,
    Rows,
    carried_own,
    covariance_of,
    descend,
    diagonal,
    fit_components,
    fit_with_walks,
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


# ---- groups of parameters whose size the data give: found where they are, left at their least where they are not

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


@pytest.mark.slow
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


# ---- generalised least squares with a random walk: against plain linear algebra, closed forms, and its own statistics

TIME = np.arange(40.0) * 5.0
WALK_DESIGN = np.column_stack((np.tile([1.0, -1.0, 0.5, -0.5], 10), np.repeat([1.0, -1.0, 0.0, 1.0], 10), np.ones(40)))
WALK_THETA = np.array([2.0, -0.3, 0.7])
SIGMA = np.where(np.arange(40) % 3 == 0, 0.02, 0.03)


def fit_with_walk(design, reading, sigma, time):
    """One sensor, without a warm-up."""
    return fit_with_walks(design, reading[:, None], sigma[:, None], time, np.zeros(1))[0]


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


def walking(rng, walk, time=TIME, sigma=SIGMA):
    away = time - (time.min() + time.max()) / 2.0
    offset = np.zeros(len(time))
    for side in (away > 0.0, away < 0.0):
        order = np.flatnonzero(side)[np.argsort(np.abs(away[side]))]
        offset[order] = np.cumsum(
            walk * np.sqrt(np.diff(np.abs(away[order]), prepend=0.0)) * rng.standard_normal(len(order))
        )
    return WALK_DESIGN @ WALK_THETA + offset + sigma * rng.standard_normal(len(time))


def at(q, reading):
    """theta, covariance, r' V^-1 r and log L at one q, by explicit inverses."""
    weight = np.linalg.inv(np.diag(SIGMA**2) + q**2 * shape())
    normal = WALK_DESIGN.T @ weight @ WALK_DESIGN
    theta = np.linalg.solve(normal, WALK_DESIGN.T @ weight @ reading)
    left = reading - WALK_DESIGN @ theta
    square = left @ weight @ left
    log = 0.5 * (np.linalg.slogdet(weight)[1] - np.linalg.slogdet(normal)[1] - square)
    return theta, np.linalg.inv(normal), square, log


def test_without_noise_the_parameters_come_back():
    fit = fit_with_walk(WALK_DESIGN, WALK_DESIGN @ WALK_THETA, np.full(40, 1e-9), TIME)
    np.testing.assert_allclose(fit.theta, WALK_THETA, atol=1e-14)
    assert fit.walk == 0.0
    assert fit.square < 1e-6


def test_without_times_it_is_weighted_least_squares():
    reading = walking(np.random.default_rng(1), 0.05)
    fit = fit_with_walk(WALK_DESIGN, reading, SIGMA, None)
    theta, covariance, square, _ = at(0.0, reading)
    np.testing.assert_allclose(fit.theta, theta, rtol=1e-11)
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-10, atol=1e-16)
    assert fit.square == pytest.approx(square, rel=1e-10)
    assert fit.walk == 0.0


@pytest.mark.parametrize("walk", [0.0, 0.002, 0.05])
def test_parameters_and_covariance_are_averages_over_every_walk(walk):
    reading = walking(np.random.default_rng(2), walk)
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
    fit = fit_with_walk(WALK_DESIGN, reading, SIGMA, TIME)
    uncertain = np.sqrt(np.diag(expected))
    # Trapezoids in steps of a tenth: good to a per cent of the uncertainty.
    np.testing.assert_allclose(fit.theta / uncertain, theta / uncertain, atol=0.01)
    np.testing.assert_allclose(
        fit.covariance / np.outer(uncertain, uncertain), expected / np.outer(uncertain, uncertain), atol=0.01
    )


@pytest.mark.slow
def test_the_walk_is_the_most_likely_one():
    reading = walking(np.random.default_rng(3), 0.05)
    grid = np.geomspace(0.01, 0.3, 4000)
    best = max(grid, key=lambda q: at(q, reading)[3])
    fit = fit_with_walk(WALK_DESIGN, reading, SIGMA, TIME)
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
    reading = walking(np.random.default_rng(4), 0.0)
    fit = fit_with_walk(WALK_DESIGN, reading, SIGMA, np.full(40, 3.0))
    assert fit.walk == 0.0
    np.testing.assert_allclose(fit.theta, at(0.0, reading)[0], rtol=1e-10)


@pytest.mark.parametrize("runs", LARGER_COHORTS)
def test_a_walk_that_is_not_there_is_told_once_in_forty(runs):
    rng = np.random.default_rng(5)
    told = np.mean([fit_with_walk(WALK_DESIGN, walking(rng, 0.0), SIGMA, TIME).walk > 0.0 for _ in range(runs)])
    show("walks told where there is none", told, 0.05)
    assert told <= 0.05  # chi-square at 95 %, one side: 2.5 %, standard error 0.9 % of 300 runs, 0.5 % of 1,000


@pytest.mark.parametrize("runs", LARGER_COHORTS)
@pytest.mark.parametrize("walk", [0.03, 0.3])
def test_a_walk_that_is_there_is_found_within_its_scatter(walk, runs):
    rng = np.random.default_rng(6)
    found = np.array([fit_with_walk(WALK_DESIGN, walking(rng, walk), SIGMA, TIME).walk for _ in range(runs)])
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
        fit = fit_with_walk(WALK_DESIGN, walking(rng, walk), SIGMA, TIME)
        inside.append(np.abs(fit.theta - WALK_THETA) <= 1.959964 * np.sqrt(np.diag(fit.covariance)))
    share = np.mean(inside, axis=0)
    show(f"coverage of 95 % intervals, walk {walk}: scale, slow parameter, offset", share)
    # 900 intervals: standard error 0.7 %; a walk too small to rule out makes them too wide, not too narrow
    assert 0.93 <= np.mean(share) <= 0.985
    assert (share >= 0.925).all()  # 300 each: 1.3 %, 1,000 each: 0.7 %


@pytest.mark.parametrize("runs", LARGER_COHORTS)
@pytest.mark.parametrize(
    "times", [(1.0, 1.0, 1.0), (10.0, 1.0, 1.0), (0.1, 1.0, 1.0)], ids=["alike", "one tenfold", "one a tenth"]
)
def test_sensors_of_one_part_hold_by_what_they_say_together(times, runs):
    rng, walk, truth = np.random.default_rng(7), 0.005, WALK_THETA
    inside, error, stated = [], [], []
    for _ in range(runs):
        readings = np.column_stack([walking(rng, walk * factor) for factor in times])
        for fit in fit_with_walks(WALK_DESIGN, readings, np.column_stack([SIGMA] * 3), TIME, np.zeros(3)):
            variance = np.diag(fit.covariance)
            inside.append(np.abs(fit.theta - truth) <= 1.959964 * np.sqrt(variance))
            error.append((fit.theta - truth) ** 2)
            stated.append(variance)
    ratio = np.sqrt(np.mean(error, axis=0) / np.mean(stated, axis=0))
    show(f"walks {times}: coverage, and error over stated", np.array([np.mean(inside, axis=0), ratio]))
    assert (np.abs(np.mean(inside, axis=0) - 0.95) < 0.03).all()
    assert ((ratio > 0.85) & (ratio < 1.15)).all()
    each = np.mean(np.reshape(inside, (runs, 3, 3)), axis=(0, 2))
    assert (each > 0.92).all()  # of each sensor, that which is unlike too
