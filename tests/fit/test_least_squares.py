"""Shared least squares: exact without noise, covariance as the scatter of many fits."""

import numpy as np
import pytest

from undrift.errors import InputError, NotObservable
from undrift.fit.equations import inverse_jacobian
from undrift.fit.least_squares import (
    excess_variance,
    fit_forward,
    fit_paper,
    noise_of_means,
    offset_verdict,
    parameter_names,
    student_variance,
)
from undrift.model import MATRIX_NAMES, OFFSET_NAMES

RNG = np.random.default_rng(11)
INPUTS = RNG.normal(0.0, 5.0, (30, 3))
FORWARD = np.array([[2.0, 0.02, -0.01], [0.03, 1.9, 0.05], [-0.02, 0.01, 2.1]])
OFFSET = np.array([0.5, -1.0, 2.0])


def test_inputs_that_miss_an_axis_are_not_observable():
    flat = INPUTS * np.array([1.0, 1.0, 0.0])
    with pytest.raises(NotObservable, match=r"inputs that span three axes and an offset \(rank 4\), got rank 3"):
        fit_forward(flat, flat, None)
    with pytest.raises(NotObservable, match="wanted readings that span three axes, got rank 2 from 30 columns"):
        fit_paper(flat, flat, None, method="m", unit_in="count", unit_out="rad/s")


def test_shapes_that_disagree_are_refused():
    with pytest.raises(InputError, match=r"wanted inputs and readings \(E, 3\), got \(30, 3\) and \(29, 3\)"):
        fit_forward(INPUTS, INPUTS[1:], None)


def test_student_variance_needs_three_spare_equations():
    assert student_variance(np.array([1.0, -1.0, 1.0, -1.0]), 4) == 2.0
    assert np.isnan(student_variance(np.ones(4), 2))


def test_the_jacobian_of_the_inverse_is_its_derivative():
    matrix = np.array([[2.0, 0.7, -0.4], [-0.3, 1.0, 0.5], [0.6, -0.2, 3.0]])  # far from symmetric
    jacobian = inverse_jacobian(np.linalg.inv(matrix))
    for k in range(9):
        step = np.zeros(9)
        step[k] = 1e-6
        ends = [np.linalg.inv(matrix + sign * step.reshape(3, 3)).reshape(-1) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(jacobian[:, k], (ends[0] - ends[1]) / 2e-6, rtol=0, atol=1e-9)


def test_an_error_in_common_weighs_as_by_generalised_least_squares():
    rng = np.random.default_rng(12)
    sigma, columns = 0.01 * (1.0 + rng.random((30, 3))), 0.05 * rng.normal(size=(3, 30, 2))
    readings = INPUTS @ FORWARD.T + OFFSET + sigma * rng.normal(size=(30, 3))
    fit = fit_forward(INPUTS, readings, sigma, columns @ columns.transpose(0, 2, 1))
    design = np.column_stack((INPUTS, np.ones(30)))
    for k in range(3):
        weight = np.linalg.inv(np.diag(sigma[:, k] ** 2) + columns[k] @ columns[k].T)
        covariance = np.linalg.inv(design.T @ weight @ design)
        theta = covariance @ design.T @ weight @ readings[:, k]
        np.testing.assert_allclose([*fit.matrix[k], fit.offset[k]], theta, rtol=1e-9)
        places = [3 * k, 3 * k + 1, 3 * k + 2, 9 + k]
        np.testing.assert_allclose(fit.covariance[np.ix_(places, places)], covariance, rtol=1e-7, atol=1e-18)


def test_unequal_noise_weighs_the_equations_and_is_their_covariance():
    rng = np.random.default_rng(13)
    sigma = rng.uniform(0.01, 1.0, (30, 3))
    readings = INPUTS @ FORWARD.T + OFFSET + sigma * rng.standard_normal((30, 3))
    fit = fit_forward(INPUTS, readings, sigma)
    design = np.column_stack((INPUTS, np.ones(30)))
    for row in range(3):
        weight = np.diag(1.0 / sigma[:, row] ** 2)
        inverse = np.linalg.inv(design.T @ weight @ design)
        np.testing.assert_allclose(
            np.append(fit.matrix[row], fit.offset[row]), inverse @ design.T @ weight @ readings[:, row]
        )
        places = [3 * row, 3 * row + 1, 3 * row + 2, 9 + row]
        np.testing.assert_allclose(fit.covariance[np.ix_(places, places)], inverse, rtol=1e-9, atol=1e-15)


def test_the_covariance_without_an_offset_is_the_scatter_of_many_fits():
    rng = np.random.default_rng(14)
    forward = np.array([[2.0, 0.4, 0.0], [0.0, 0.5, 0.1], [0.3, 0.0, 8.0]])
    inputs = np.tile(INPUTS * [1.0, 3.0, 0.2], (2, 1))
    # each input once quietly and once not: then the mean variance is the whole truth
    sigma = np.repeat([0.2, 1.8], 30)[:, None] * [0.02, 0.05, 0.01]
    fits = [
        fit_paper(
            inputs, inputs @ forward.T + sigma * rng.standard_normal((60, 3)), sigma,
            method="m", unit_in="count", unit_out="m/s2",
        ).model
        for _ in range(1000)
    ]  # fmt: skip
    scatter = np.cov(np.array([fit.matrix.reshape(-1) for fit in fits]), rowvar=False)
    size, claimed = np.sqrt(np.diag(scatter)), fits[0].covariance[:9, :9]
    # 1000 draws tell a standard deviation to 2 %, a correlation to 3 %
    np.testing.assert_allclose(np.sqrt(np.diag(claimed)), size, rtol=0.1)
    np.testing.assert_allclose(claimed / np.outer(size, size), scatter / np.outer(size, size), rtol=0, atol=0.15)


def test_the_noise_of_a_mean_counts_blocks_less_what_was_removed_from_each_window():
    rng = np.random.default_rng(15)
    windows = [rng.standard_normal((n, 3)) for n in (200, 300, 400) * 100]
    noise = noise_of_means(windows, [50] * 300)
    share = np.sqrt(np.mean(noise**2, axis=1)) * np.sqrt([len(window) for window in windows])
    # 1800 blocks less 300 means, three axes: known to 1.1 %. Without the means it would be 0.91
    np.testing.assert_allclose(share, 1.0, atol=0.035)


def test_excess_variance_brings_the_weighted_squares_to_their_degrees_of_freedom():
    rng = np.random.default_rng(16)
    stated, residuals = rng.uniform(0.5, 2.0, 20), 3.0 * rng.standard_normal(20)
    excess = excess_variance(residuals, stated, 13)
    assert float((residuals**2 / (stated + excess)).sum()) == pytest.approx(13.0, rel=1e-6)


def test_the_loss_of_an_offset_left_in_is_over_the_squares_of_one_axis():
    inputs = np.vstack((np.eye(3), -np.eye(3))) * 4.0  # two of 16 on each axis
    readings = inputs @ FORWARD.T + FORWARD @ [0.4, 0.0, 0.0]
    fit = fit_paper(inputs, readings, None, method="m", unit_in="count", unit_out="m/s2")
    (left,) = offset_verdict(fit, inputs, readings, np.full((6, 3), 1e-6)).findings
    share = 6.0 / 32.0 * 0.4**2
    assert left.values["loss_percent"] == pytest.approx(100.0 * share / (1.0 + share), rel=1e-9)
    assert fit.model.matrix @ FORWARD @ [1.0, 0.0, 0.0] == pytest.approx([1.0 / (1.0 + share), 0.0, 0.0], abs=1e-12)


# ---- parameters are named as a laboratory names them


@pytest.mark.parametrize(
    ("names", "shown"),
    [
        (("m_xy", "m_xz"), "cross-axis terms xy and xz"),
        (("m_yz",), "cross-axis term yz"),
        (("m_yy", "offset_y"), "scale of y, offset of y"),
        (("offset_x", "offset_y", "offset_z"), "offset of x, y and z"),
        (
            (*MATRIX_NAMES, *OFFSET_NAMES),
            "scale of x, y and z, cross-axis terms xy, xz, yx, yz, zx and zy, offset of x, y and z",
        ),
    ],
)
def test_names_of_one_kind_are_listed_together(names, shown):
    assert parameter_names(names) == shown
