"""From a fit to a model: errors are carried as finite differences do; the note's matrix has the covariance of many fits."""

import numpy as np
import pytest

from undrift.calibration.sources import in_case
from undrift.errors import NotObservable
from undrift.fit.gls import solve_inverse
from undrift.fit.triad import fit_paper, inverse_jacobian, parameter_names
from undrift.model import MATRIX_NAMES, OFFSET_NAMES

RNG = np.random.default_rng(11)
INPUTS = RNG.normal(0.0, 5.0, (30, 3))
FORWARD = np.array([[2.0, 0.02, -0.01], [0.03, 1.9, 0.05], [-0.02, 0.01, 2.1]])
NAMES = {"method": "m", "unit_in": "count", "unit_out": "m/s2"}


def paper_of(inputs, readings, sigma, forward=FORWARD):
    """Return the note's matrix of readings with noise of each sensor."""
    matrix, sigma = np.linalg.inv(forward), np.broadcast_to(sigma, readings.shape)
    noise = in_case(matrix, np.eye(len(readings))[:, :, None] * sigma[:, None] ** 2)
    return fit_paper(inputs, readings, solve_inverse(readings, inputs, None, matrix, {"noise": noise}), **NAMES)


def test_fit_paper_refuses_readings_that_miss_an_axis():
    flat = INPUTS * np.array([1.0, 1.0, 0.0])
    with pytest.raises(NotObservable, match="rank 2 from 30"):
        fit_paper(flat, flat, solve_inverse(INPUTS, INPUTS, None, np.eye(3), {"noise": np.ones(90)}), **NAMES)


def test_the_jacobian_of_the_inverse_is_its_derivative():
    matrix = np.array([[2.0, 0.7, -0.4], [-0.3, 1.0, 0.5], [0.6, -0.2, 3.0]])  # far from symmetric
    step = 1e-6 * np.random.default_rng(3).normal(size=(3, 3))
    change = np.linalg.inv(matrix + step) - np.linalg.inv(matrix - step)
    np.testing.assert_allclose(2.0 * inverse_jacobian(np.linalg.inv(matrix)) @ step.ravel(), change.ravel(), rtol=1e-6)


def test_covariance_without_an_offset_is_the_scatter():
    rng = np.random.default_rng(14)
    forward = np.array([[2.0, 0.4, 0.0], [0.0, 0.5, 0.1], [0.3, 0.0, 8.0]])
    inputs = np.tile(INPUTS * [1.0, 3.0, 0.2], (2, 1))
    sigma = np.repeat([0.2, 1.8], 30)[:, None] * [0.02, 0.05, 0.01]
    fits = [
        paper_of(inputs, inputs @ forward.T + sigma * rng.standard_normal((60, 3)), sigma, forward).model
        for _ in range(400)
    ]
    scatter = np.cov(np.array([fit.matrix.reshape(-1) for fit in fits]), rowvar=False)
    size, claimed = np.sqrt(np.diag(scatter)), fits[0].covariance[:9, :9]
    # 400 draws tell a standard deviation to 4 %, a correlation to 5 %
    np.testing.assert_allclose(np.sqrt(np.diag(claimed)), size, rtol=0.1)
    np.testing.assert_allclose(claimed / np.outer(size, size), scatter / np.outer(size, size), rtol=0, atol=0.15)


# ---- parameters are named as a laboratory names them


@pytest.mark.parametrize(
    ("names", "shown"),
    [
        (("m_yz",), "cross-axis term yz"),
        (("m_yy", "offset_y"), "scale of y, offset of y"),
        (
            (*MATRIX_NAMES, *OFFSET_NAMES),
            "scale of x, y and z, cross-axis terms xy, xz, yx, yz, zx and zy, offset of x, y and z",
        ),
    ],
)
def test_names_of_one_kind_are_listed_together(names, shown):
    assert parameter_names(names) == shown
