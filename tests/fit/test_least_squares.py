"""Shared least squares: exact without noise, covariance as the scatter of many fits."""

import numpy as np
import pytest

from undrift.errors import InputError, NotObservable
from undrift.fit.least_squares import fit_forward, fit_paper, student_variance, triad_from_forward

RNG = np.random.default_rng(11)
INPUTS = RNG.normal(0.0, 5.0, (30, 3))
FORWARD = np.array([[2.0, 0.02, -0.01], [0.03, 1.9, 0.05], [-0.02, 0.01, 2.1]])
OFFSET = np.array([0.5, -1.0, 2.0])


def test_exact_readings_give_back_matrix_and_offset():
    fit = fit_forward(INPUTS, INPUTS @ FORWARD.T + OFFSET, None)
    np.testing.assert_allclose(fit.matrix, FORWARD, atol=1e-13)
    np.testing.assert_allclose(fit.offset, OFFSET, atol=1e-13)
    triad = triad_from_forward(fit, method="m", unit_in="count", unit_out="m/s2", valid_range=(-1.0, 1.0))
    np.testing.assert_allclose(triad.model.matrix, np.linalg.inv(FORWARD), atol=1e-13)
    assert triad.model.count == 90
    assert triad.model.rank == 12


@pytest.mark.parametrize("known", [True, False])
def test_the_covariance_is_the_scatter_of_many_fits(known):
    rng = np.random.default_rng(12)
    sigma = np.array([0.1, 0.2, 0.05])
    found, claimed = [], []
    for _ in range(600):
        readings = INPUTS @ FORWARD.T + OFFSET + sigma * rng.standard_normal((30, 3))
        spread = np.broadcast_to(sigma, (30, 3)) if known else None
        triad = triad_from_forward(
            fit_forward(INPUTS, readings, spread), method="m", unit_in="count", unit_out="m/s2",
            valid_range=(-1.0, 1.0),
        )  # fmt: skip
        found.append(np.concatenate((triad.model.matrix.reshape(-1), triad.model.offset)))
        claimed.append(triad.model.covariance)
    scatter = np.cov(np.array(found), rowvar=False)
    mean = np.mean(claimed, axis=0)
    # 600 draws tell a standard deviation to 3 %; unknown noise widens it by (26 / 24)^0.5 = 4 % on purpose
    np.testing.assert_allclose(np.sqrt(np.diag(mean)), np.sqrt(np.diag(scatter)), rtol=0.1 if known else 0.14)
    correlation = scatter / np.sqrt(np.outer(np.diag(scatter), np.diag(scatter)))
    claimed_correlation = mean / np.sqrt(np.outer(np.diag(mean), np.diag(mean)))
    np.testing.assert_allclose(claimed_correlation, correlation, atol=0.16)  # 4 / sqrt(600)


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
