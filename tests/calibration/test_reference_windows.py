"""Windows state what errors of poses, readings and offset do to the fit; the chain refuses what it cannot see."""

from typing import cast

import numpy as np
import pytest

from undrift.calibration import reference
from undrift.calibration.reference import Recording, Solution, Windows, _whitened, solve, solve_chain
from undrift.errors import NotObservable
from undrift.frames import rotate


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
    assert solution.covariance().shape == (9, 9)
    # Pose noise of 1e-3 over 200 steps gives 1e-4; plain least squares would err by some 0.01.
    np.testing.assert_allclose(solution.step, truth[:9], atol=6e-4)


# ---- covariance of windows

REACH, POSES = 32, 240
ERRORS = {
    "poses": lambda rng, n: rng.normal(size=(n, 3)),
    "readings": lambda rng, n: np.cumsum(rng.normal(size=(n, 3)), axis=0),
    "offset": lambda rng, n: np.cumsum(np.cumsum(rng.normal(size=(n, 3)), axis=0), axis=0),
}


def windows_of(rng: np.random.Generator, error: np.ndarray) -> tuple[Recording, Windows]:
    """Windows over a body that turns, true parameters zero: columns are sums of rates that last 2 to 20 poses."""
    count = len(error)
    made = cast(Poses, recording(count))
    q = rng.normal(size=(count, 4))
    made.q_nb = q / np.linalg.norm(q, axis=1, keepdims=True)
    kept = np.exp(-1.0 / rng.uniform(2.0, 20.0, (3, 12)))
    rate = rng.normal(size=(count, 3, 12))
    for k in range(1, count):
        rate[k] += kept * rate[k - 1]
    total, first = np.cumsum(rate, axis=0), np.arange(count - REACH)
    columns = np.concatenate((total, error[:, :, None]), axis=2)
    back = made.q_nb[REACH:] * (1.0, -1.0, -1.0, -1.0)  # into the body at the end
    inside = np.moveaxis(rotate(back[:, None], np.moveaxis(columns[REACH:] - columns[:-REACH], 1, 2)), 2, 1)
    return cast(Recording, made), steps(inside[:, :, :12], inside[:, :, 12], first)


def solved(rng: np.random.Generator, errors: list[np.ndarray]) -> Solution:
    pairs = [windows_of(rng, error) for error in errors]
    return solve([p[0] for p in pairs], [p[1] for p in pairs], kept=np.arange(12), reach=REACH)


@pytest.mark.parametrize("kind", ERRORS)
def test_stated_intervals_hold_whatever_errs(kind: str) -> None:
    # 60 fits of 12 parameters: the share inside 95 % has a standard deviation of about 1 %.
    z = []
    for seed in range(60):
        rng = np.random.default_rng((seed, 5))
        solution = solved(rng, [ERRORS[kind](rng, POSES) for _ in range(2)])
        z.append(solution.step / np.sqrt(np.diag(solution.covariance())))
    inside = 100.0 * float(np.mean(np.abs(z) < 1.96))
    print(f"  {kind}: {inside:.1f} % inside 95 %")
    assert 90.0 <= inside <= 98.0


def test_a_jump_of_the_poses_is_bounded_and_stated() -> None:
    # 32 of 416 windows are off by 300 standard deviations: 83 times the scatter, were they not bounded. Bounded ones still err all
    # one way, which moves the fit; a guard of a tenth of 83.
    error = np.random.default_rng(8).normal(size=(POSES, 3))
    jumped = np.where((np.arange(POSES) > 200)[:, None], 300.0, 0.0) + error
    fits = [solved(np.random.default_rng(9), [one, error]) for one in (error, jumped)]
    sigma = [np.sqrt(np.diag(fit.covariance())) for fit in fits]
    assert (sigma[1] < 8.3 * sigma[0]).all()
    assert np.abs(fits[1].step / sigma[1]).max() < 3.5  # 12 parameters


def test_long_recordings_are_taken_stretch_by_stretch(monkeypatch: pytest.MonkeyPatch) -> None:
    error = ERRORS["readings"](np.random.default_rng(3), 500)
    whole = solved(np.random.default_rng(4), [error]).covariance()
    monkeypatch.setattr(reference, "_STRETCH", 156)
    parts = solved(np.random.default_rng(4), [error]).covariance()
    # Windows that overlap across two cuts are 2 x 32 of 468: their products with the others are left out.
    assert np.sqrt(np.diag(parts) / np.diag(whole)) == pytest.approx(1.0, abs=0.2)
    assert not np.allclose(parts, whole, rtol=1e-6)
