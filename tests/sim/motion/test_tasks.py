"""Tasks: rates and forces are the derivatives of the angles and coordinates."""

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.frames import integrate_strapdown, quaternion_conjugate, quaternion_product, rotate
from undrift.sim.motion.motion import Step, Sway, ViaPoint
from undrift.sim.motion.tasks import Task, draw_task

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


def joins(task: Task) -> np.ndarray:
    """Instants at which the jerk of some part jumps."""
    found = []
    for part in (*task.roll, *task.pitch, *task.yaw, *task.forward, *task.left, *task.up):
        start = part.start_s  # type: ignore[attr-defined]
        match part:
            case Step():
                found += [start, start + part.duration_s]
            case ViaPoint():
                found += [start, start + part.there_s, start + part.there_s + part.back_s]
            case Sway():
                found += [start, start + part.swell_s, part.stop_s - part.swell_s, part.stop_s]
            case _:
                found.append(start)
    return np.array(found)


FIRST = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0  # of sixth order
SECOND = np.array([2.0, -27.0, 270.0, -490.0, 270.0, -27.0, 2.0]) / 180.0


def differences(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return sum(w * values[k : len(values) - 6 + k] for k, w in enumerate(weights))  # type: ignore[return-value]


@pytest.mark.parametrize("name", TASKS)
def test_position_angles_rate_acceleration_and_force_agree_to_a_millionth(name: str) -> None:
    task = draw_task(name, rng=np.random.default_rng(4))  # type: ignore[arg-type]
    h = 5e-4  # s: sixth order errs by (h w)^6 / 560, 1e-11 at 15 Hz; rounding 1e-15 m / h^2 = 4e-9 m/s2
    time = np.arange(5.5, min(task.duration_s, 12.0), h)
    motion, middle = task.at(time, 9.81), slice(3, -3)
    clear = (np.abs(time[middle, None] - joins(task)) > 4.0 * h).all(axis=1)
    slope = differences(motion.q_nb, FIRST) / h
    rate = 2.0 * quaternion_product(quaternion_conjugate(motion.q_nb[middle]), slope)[:, 1:]
    push = differences(task.position(time), SECOND) / h**2
    force = rotate(quaternion_conjugate(motion.q_nb[middle]), push + np.array([0.0, 0.0, 9.81]))
    spin_up = differences(motion.rate_b, FIRST) / h
    assert motion.angular_acceleration_b is not None
    for label, numeric, exact in (
        ("rate", rate, motion.rate_b),
        ("angular acceleration", spin_up, motion.angular_acceleration_b),
        ("force", force, motion.force_b),
    ):
        off = np.abs(numeric - exact[middle])[clear].max() / np.abs(exact).max()
        show(f"{name}: {label}, numeric against exact, relative", off, 1e-6)
        assert off < 1e-6
    assert clear.mean() > 0.98


@pytest.mark.parametrize("name", TASKS)
def test_integrating_the_rate_gives_back_the_pose(name: str) -> None:
    task = draw_task(name, rng=np.random.default_rng(5))  # type: ignore[arg-type]
    motion = task.at(np.arange(0.0, task.duration_s, 0.002), 9.81)
    middle = np.vstack(
        (motion.rate_b[:1], 0.5 * (motion.rate_b[1:] + motion.rate_b[:-1]))
    )  # the trapezium rule, which errs by the square of the step
    q = integrate_strapdown(middle, motion.time, motion.q_nb[0])
    off = 2.0 * np.degrees(
        np.linalg.norm(quaternion_product(quaternion_conjugate(motion.q_nb), q)[:, 1:], axis=1).max()
    )
    show(f"{name}: pose from the integrated rate, deg", off, 0.01)
    assert off < 0.01


@pytest.mark.slow
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
    with pytest.raises(InputError, match="unknown task 'dance'"):
        draw_task("dance", rng=np.random.default_rng(0))  # type: ignore[arg-type]
