"""Tasks: rates and forces are the derivatives of the angles and coordinates."""

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.orientation.strapdown import integrate_strapdown
from undrift.sim import draw_task

TASKS = ("sit_to_stand", "posturography", "free", "step")


@pytest.mark.parametrize("name", TASKS)
def test_rate_and_force_are_derivatives_of_the_pose(name: str) -> None:
    task = draw_task(name, rng=np.random.default_rng(1))  # type: ignore[arg-type]
    step = 1e-3  # s: central differences err by step^2 times the third derivative, rounding by 1e-16 / step^2
    time = np.arange(0.0, task.duration_s, step)
    motion = task.at(time, 9.81)
    slope = (motion.q_nb[2:] - motion.q_nb[:-2]) / (2.0 * step)
    rate = 2.0 * quaternion_product(quaternion_conjugate(motion.q_nb[1:-1]), slope)[:, 1:]
    assert np.abs(rate - motion.rate_b[1:-1]).max() < 1e-4
    position = task.position(time)
    push = (position[2:] - 2.0 * position[1:-1] + position[:-2]) / step**2
    force = rotate(quaternion_conjugate(motion.q_nb[1:-1]), push + np.array([0.0, 0.0, 9.81]))
    assert np.abs(force - motion.force_b[1:-1]).max() < 0.01


@pytest.mark.parametrize("name", TASKS)
def test_a_task_rests_at_both_ends_and_its_mean_rate_leads_back_to_the_pose(name: str) -> None:
    task = draw_task(name, rng=np.random.default_rng(2), rest_s=6.0)  # type: ignore[arg-type]
    motion = task.at(np.arange(0.0, task.duration_s, 0.01), 9.81)
    assert np.abs(motion.rate_b[motion.moving == 0.0]).max() < 1e-12
    assert (motion.moving[:590] == 0.0).all()
    q = integrate_strapdown(motion.mean_rate_b, motion.time, motion.q_nb[0])
    sine = np.linalg.norm(quaternion_product(quaternion_conjugate(motion.q_nb), q)[:, 1:], axis=1)
    assert sine.max() < 1e-12


def test_peak_rates_stay_within_what_the_note_calibrates_for() -> None:
    rng = np.random.default_rng(3)
    sitting = [np.abs(_rates("sit_to_stand", rng)).max() for _ in range(30)]
    standing = [np.abs(_rates("posturography", rng)).max() for _ in range(30)]
    assert 45.0 < np.median(sitting) < 90.0  # deg/s; the note's range ends at 90
    assert max(standing) < 6.0  # deg/s; the note's range ends at 5


def _rates(name: str, rng: np.random.Generator) -> np.ndarray:
    task = draw_task(name, rng=rng)  # type: ignore[arg-type]
    return np.degrees(task.at(np.arange(0.0, task.duration_s, 0.01), 9.81).rate_b)


def test_a_task_that_is_not_one_is_refused() -> None:
    with pytest.raises(InputError, match="wanted one of sit_to_stand, posturography, free, step, got 'dance'"):
        draw_task("dance", rng=np.random.default_rng(0))  # type: ignore[arg-type]
