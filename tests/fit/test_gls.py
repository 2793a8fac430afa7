"""Generalised least squares: solution, excess variances, their widening, prior and budget."""

import numpy as np
import pytest

from testkit.data import show
from undrift.fit.gls import Prior, excess_variance, noise_of_means, solve, solve_inverse, student_factor


def line(count=40):
    return np.column_stack((np.linspace(-1.0, 1.0, count), np.ones(count)))


def test_without_excess_it_is_weighted_least_squares():
    rng = np.random.default_rng(1)
    design, sigma = line(), np.linspace(0.1, 1.0, 40)
    value = design @ [2.0, -1.0] + sigma * rng.standard_normal(40)
    fit = solve(design, value, {"noise": np.diag(sigma**2)})
    weighted = np.linalg.lstsq(design / sigma[:, None], value / sigma, rcond=None)[0]
    np.testing.assert_allclose(fit.theta, weighted, rtol=1e-12)
    np.testing.assert_allclose(fit.covariance, np.linalg.inv(design.T @ np.diag(sigma**-2) @ design), rtol=1e-9)


def test_noise_of_the_readings_does_not_make_the_scale_smaller():
    rng, noise, count = np.random.default_rng(7), 0.2, 30
    value = rng.choice([-1.0, 1.0], (count, 3))
    sources = {"noise": np.full(3 * count, noise**2)}
    scales = [
        np.diag(
            solve_inverse(value + noise * rng.standard_normal((count, 3)), value, None, np.eye(3), sources)
            .theta[:9]
            .reshape(3, 3)
        )
        for _ in range(100)
    ]
    error = noise / np.sqrt(np.size(scales) * count)
    show(
        "scale from noisy readings, mean of 300",
        f"{np.mean(scales):.4f}",
        f"1 within {4.0 * error:.4f} (regression on them: {1.0 / (1.0 + noise**2):.3f})",
    )
    assert abs(np.mean(scales) - 1.0) < 4.0 * error


@pytest.mark.parametrize("stated", [1e-12, 0.04])
def test_the_excess_of_one_kind_is_the_residual_variance(stated):
    rng = np.random.default_rng(2)
    design = line()
    value = design @ [2.0, -1.0] + 0.3 * rng.standard_normal(40)
    fit = solve(design, value, {"noise": stated * np.eye(40)}, excess={"scatter": np.eye(40)})
    assert fit.excess["scatter"] + stated == pytest.approx(float(fit.residuals @ fit.residuals) / 38.0, rel=1e-3)
    assert fit.freedom["scatter"] == pytest.approx(38.0)
    inside = (fit.covariance[1, 1] * 40.0 - stated) / fit.excess["scatter"]
    assert inside == pytest.approx(student_factor(38.0), rel=1e-6)


def test_noise_as_stated_has_no_excess():
    design = line()
    value = design @ [2.0, -1.0] + 0.1 * np.tile([1.0, -1.0, -1.0, 1.0], 10)
    fit = solve(design, value, {"noise": 0.04 * np.eye(40)}, excess={"scatter": np.eye(40)})
    assert fit.excess["scatter"] == 0.0


def test_two_kinds_are_told_apart_by_their_shapes():
    rng = np.random.default_rng(3)
    count, results = 120, []
    design = line(count)
    growing = np.diag(np.linspace(0.0, 2.0, count) ** 2)
    for _ in range(60):
        error = 0.2 * rng.standard_normal(count) + 0.5 * np.linspace(0.0, 2.0, count) * rng.standard_normal(count)
        fit = solve(
            design, error, {"noise": 1e-12 * np.eye(count)}, excess={"white": np.eye(count), "growing": growing}
        )
        results.append([fit.excess["white"], fit.excess["growing"]])
    # the mean of 60 estimates of a variance from about 100 residuals: 2 % and, for the smaller, 8 %
    np.testing.assert_allclose(np.mean(results, axis=0), [0.04, 0.25], rtol=0.25)


@pytest.mark.parametrize("size", [0.0, 0.3, 3.0])
def test_intervals_hold_for_few_residuals(size):
    # six spare rows, as six faces have; a common error of pairs beside the noise
    rng = np.random.default_rng(4)
    design = np.column_stack((np.repeat(np.eye(6), 2, axis=0)[:, :3], np.ones(12)))
    design[6:, :3] = -design[:6, :3]
    shape = np.diag((np.abs(design[:, 0]) == 0.0).astype(float))
    inside = []
    for _ in range(400):
        error = rng.standard_normal(12) + size * np.sqrt(np.diag(shape)) * rng.standard_normal(12)
        fit = solve(design, error, {"noise": np.eye(12)}, excess={"tilt": shape})
        inside.append(np.abs(fit.theta) <= 1.96 * np.sqrt(np.diag(fit.covariance)))
    share = float(np.mean(inside))
    show(f"excess {size}: coverage of 95 % intervals", f"{share:.3f}", (0.90, 0.98))
    assert 0.90 <= share <= 0.98


def test_what_rows_do_not_determine_keeps_its_prior():
    design = np.column_stack((np.ones(5), np.zeros(5)))
    prior = Prior(mean=np.array([0.0, 3.0]), precision=np.diag([0.0, 4.0]))
    fit = solve(design, np.full(5, 2.0), {"noise": np.eye(5)}, prior=prior)
    np.testing.assert_allclose(fit.theta, [2.0, 3.0], rtol=1e-12)
    np.testing.assert_allclose(np.diag(fit.covariance), [0.2, 0.25], rtol=1e-9)
    np.testing.assert_allclose(fit.budget["prior"][1, 1], 0.25, rtol=1e-9)


def test_the_budget_sums_to_the_covariance():
    rng = np.random.default_rng(5)
    design, common = line(), np.outer(np.linspace(0.0, 1.0, 40), np.linspace(0.0, 1.0, 40))
    fit = solve(
        design, rng.standard_normal(40), {"noise": 0.5 * np.eye(40), "drift": common}, excess={"noise": np.eye(40)}
    )
    assert [*fit.budget] == ["noise", "drift"]
    np.testing.assert_allclose(sum(fit.budget.values()), fit.covariance, rtol=1e-12)
    assert fit.budget["drift"][0, 0] == pytest.approx(0.25, rel=1e-6)  # half the slope of a ramp from 0 to 1


def test_noise_of_a_mean_counts_blocks_minus_removed():
    rng = np.random.default_rng(15)
    windows = [rng.standard_normal((n, 3)) for n in (200, 300, 400) * 100]
    noise = noise_of_means(windows, [50] * 300)
    share = np.sqrt(np.mean(noise**2, axis=1)) * np.sqrt([len(window) for window in windows])
    # 1800 blocks less 300 means, three axes: known to 1.1 %. Without the means it would be 0.91
    np.testing.assert_allclose(share, 1.0, atol=0.035)


def test_excess_variance_meets_the_degrees_of_freedom():
    rng = np.random.default_rng(16)
    stated, residuals = rng.uniform(0.5, 2.0, 20), 3.0 * rng.standard_normal(20)
    excess = excess_variance(residuals, stated, 13)
    assert float((residuals**2 / (stated + excess)).sum()) == pytest.approx(13.0, rel=1e-6)
