"""Parameters of a twin: rotations, spreads, means."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from undrift.twin.fit import g_sensitivity_parameters, mean_with_error, polar_rotation, spread_of


def test_the_polar_rotation_is_the_mounting_and_its_slope_the_antisymmetric_part():
    turn = np.array([0.3, -0.2, 0.5])
    stretch = np.diag((1.01, 0.98, 1.03))
    vector, _ = polar_rotation(Rotation.from_rotvec(turn).as_matrix() @ stretch)
    assert vector == pytest.approx(turn, abs=1e-9)
    vector, slope = polar_rotation(np.eye(3))
    small = np.array([[0.0, -3e-4, 2e-4], [3e-4, 0.0, -1e-4], [-2e-4, 1e-4, 0.0]])
    assert slope @ small.ravel() == pytest.approx((1e-4, 2e-4, 3e-4), abs=1e-9)
    assert slope @ np.diag((1.0, 2.0, 3.0)).ravel() == pytest.approx(np.zeros(3), abs=1e-9)


def test_one_recording_has_the_spread_of_the_prior_and_many_their_own():
    assert spread_of(np.ones((1, 3)), 0.01) == pytest.approx(np.full(3, 0.01))
    many = np.random.default_rng(1).normal(0.0, 0.2, (500, 3))
    assert spread_of(many, 0.01) == pytest.approx(np.full(3, 0.2), rel=0.1)


def test_the_error_of_a_mean_is_the_larger_of_claim_and_scatter():
    assert mean_with_error([1.0, 1.0], [0.3, 0.4])[1] == pytest.approx(0.25)
    assert mean_with_error([0.0, 2.0], [0.1, 0.1])[1] == pytest.approx(1.0)


def test_g_sensitivity_within_its_error_is_not_identified():
    found = g_sensitivity_parameters(np.array([9e-4] + [1e-5] * 8), np.full(9, 1e-4))
    assert [p.identifiable for p in found] == [True] + [False] * 8
    assert (found[1].finding.code, found[1].finding.values) == ("twin.g_sensitivity_zero", {"sigmas": 4.0})
    assert found[1].reason.startswith("Within 4 standard errors of zero")
