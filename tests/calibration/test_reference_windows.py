"""The chain of poses: refuses what it cannot see, and breaks where a pose is missing."""

from typing import cast

import numpy as np
import pytest

from undrift.calibration.reference_windows import Recording, Windows, _whitened, solve_chain
from undrift.errors import NotObservable


class Poses:
    """The part of a recording that the chain reads."""

    def __init__(self, count: int) -> None:
        self.q_nb = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))


def recording(count: int) -> Recording:
    return cast(Recording, Poses(count))


def steps(design: np.ndarray, turn: np.ndarray, first: np.ndarray) -> Windows:
    return Windows(turn=turn, design=design, first=first)


def test_too_few_steps_are_refused() -> None:
    few = steps(np.ones((3, 3, 12)), np.zeros((3, 3)), np.arange(3))
    with pytest.raises(NotObservable, match="wanted more than 8 steps between poses, got 3; record longer motion"):
        solve_chain([recording(4)], [few], kept=np.arange(12))


def test_motion_about_one_axis_is_refused_with_its_rank() -> None:
    design = np.zeros((40, 3, 12))
    design[:, 0, 0] = np.random.default_rng(1).normal(size=40)
    with pytest.raises(NotObservable, match="design of rank 1 for 12 parameters; turn the device about every axis"):
        solve_chain([recording(41)], [steps(design, np.zeros((40, 3)), np.arange(40))], kept=np.arange(12))


def test_whitening_undoes_the_covariance_of_a_chain_with_a_gap() -> None:
    n, kappa = 7, 0.3
    linked = np.array([True, True, False, True, True, True])
    tied = np.diag(linked.astype(float), 1)
    covariance = (1 - kappa) * (2 * np.eye(n) - tied - tied.T) + kappa * np.eye(n)
    table = np.repeat(np.eye(n)[:, None, :], 3, axis=1)  # (n, 3, n): each column one unit step
    white = _whitened([table], [linked], kappa)[::3]  # the whitener itself, one body axis
    np.testing.assert_allclose(white @ covariance @ white.T, np.eye(n), atol=1e-14)


def test_parameters_held_fixed_stay_and_one_bad_pose_moves_little() -> None:
    rng = np.random.default_rng(2)
    design, truth = rng.normal(size=(200, 3, 12)), rng.normal(size=12)
    truth[9:] = 0.0
    pose = rng.normal(0.0, 1e-3, (201, 3))
    pose[100] += 0.5
    turn = design @ truth + np.diff(pose, axis=0)
    solution = solve_chain([recording(201)], [steps(design, turn, np.arange(200))], kept=np.arange(9))
    assert solution.step.shape == (9,)
    assert solution.covariance.shape == (9, 9)
    # Pose noise of 1e-3 over 200 steps gives 1e-4; plain least squares would err by some 0.01.
    np.testing.assert_allclose(solution.step, truth[:9], atol=6e-4)
