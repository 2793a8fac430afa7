"""Tasks: derivatives that belong together, draws, categories, cohorts, and the sway of quiet stance."""

from functools import partial
from typing import get_args

import numpy as np
import pytest

from testkit.data import show
from undrift.frames import integrate_strapdown, quaternion_conjugate, quaternion_product, rotate
from undrift.sim.motion.motion import Burst, CourseTerm, Step, Sway, ViaPoint
from undrift.sim.motion.tasks import (
    CATEGORIES,
    GROUP_SIZE,
    TABLE_2,
    CategoryName,
    Group,
    Performance,
    Task,
    cohort,
    draw_sway,
    draw_task,
    sway_spectrum,
)

PARTS: dict[str, CourseTerm] = {
    "step": Step(0.4, 1.3, 0.7),
    "via-point": ViaPoint(0.4, 0.9, 1.4, 0.6, -0.5),
    "wave": Sway((0.5,), (0.8,), (0.3,), 0.2, 3.6, 1.0),
    "sway": Sway((0.3, 0.2, 0.1), (0.2, 0.7, 1.9), (0.0, 1.0, 2.0), 0.2, 3.6, 1.5),
    "burst": Burst(0.05, 3.0, 0.5, 0.2),
}


@pytest.mark.parametrize("name", PARTS)
def test_each_derivative_is_the_integral_of_the_next(name: str) -> None:
    time = np.linspace(0.0, 4.0, 40_001)
    value, first, second = PARTS[name].at(time)
    for low, high in ((value, first), (first, second)):
        grown = np.concatenate(([0.0], np.cumsum(0.5 * np.diff(time) * (high[1:] + high[:-1]))))
        # trapezium at 0.1 ms: h^2 / 12 times the change of the derivative, some 100 per s3
        assert np.abs(low - low[0] - grown).max() < 1e-6


def test_a_step_of_least_jerk_has_the_published_peaks() -> None:
    change, duration = 32.0, 0.92  # deg, s
    value, first, second = Step(0.0, duration, change).at(np.linspace(0.0, duration, 100_001))
    assert first.max() * duration / change == pytest.approx(1.875, rel=1e-9)  # 15/8 at half time
    assert np.abs(second).max() * duration**2 / change == pytest.approx(10.0 / np.sqrt(3.0), rel=1e-8)
    assert value[-1] == pytest.approx(change, rel=1e-12)


def test_a_via_point_is_met_at_its_instant_with_the_rate_zero() -> None:
    part = ViaPoint(1.0, 0.9, 1.4, 0.6, -0.5)
    value, first, second = part.at(np.array([1.0, 1.9, 3.3, 5.0]))
    np.testing.assert_allclose(value, [0.0, 0.6, 0.1, 0.1], atol=1e-15)
    np.testing.assert_allclose(first, 0.0, atol=1e-14)
    assert second[1] == pytest.approx(part.acceleration, rel=1e-12)
    even = ViaPoint(0.0, 1.0, 1.0, 1.0, -1.0)
    assert even.acceleration == pytest.approx(-20.0 / 3.0, rel=1e-12)
    peak = even.at(np.linspace(0.0, 1.0, 100_001))[1].max()
    show("there and back: peak rate over A/T", peak, "1.728 to 1.737")
    assert 1.728 <= peak < 1.737


TASKS = ("sit_to_stand", "posturography", "free", "step")


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


@pytest.mark.parametrize("name", get_args(CategoryName))
@pytest.mark.parametrize("group", TABLE_2)
def test_people_of_a_category_keep_its_ages_heights_and_bounds(name: CategoryName, group: Group) -> None:
    numbers = CATEGORIES[name]
    ages, heights = (numbers.age_years, numbers.height_m) if numbers.age_years and numbers.height_m else TABLE_2[group]
    people = cohort(group, rng=np.random.default_rng(2), category=name)
    assert len({person.habits.root for person in people}) == GROUP_SIZE
    for printed, drawn in ((ages, [p.age_years for p in people]), (heights, [p.height for p in people])):
        np.testing.assert_allclose((min(drawn), np.mean(drawn), max(drawn)), printed, rtol=1e-12)
        assert 0.1 < np.std(drawn) / (max(drawn) - min(drawn)) < 0.35  # spread out, not heaped at the ends
    for task, most_dps in zip(("sit_to_stand", "step", "posturography"), numbers.most_dps, strict=True):
        performed = draw_task(task, rng=np.random.default_rng(1), subject=people[0])  # type: ignore[arg-type]
        rate = performed.at(np.arange(*performed.moving_s, 0.01), 9.81).rate_b
        # looked at every 20 ms when drawn: the peak may lie between
        assert np.degrees(np.abs(rate)).max() <= 1.002 * most_dps


def test_a_quantity_keeps_its_bounds_its_mean_and_a_persons_habit() -> None:
    rng = np.random.default_rng(1)
    people = [p for _ in range(10) for p in cohort("testing", rng=rng)]
    drawn = np.array([[Performance(rng, p).number("lean", 10.0, 2.0, 4.0, 16.0) for _ in range(20)] for p in people])
    assert drawn.min() >= 4.0
    assert drawn.max() <= 16.0
    share = np.var(drawn.mean(axis=1)) / np.var(drawn)
    show("mean, sd and share of variance between people", (drawn.mean(), drawn.std(), share), "10, 2, 0.64 less tails")
    assert drawn.mean() == pytest.approx(10.0, abs=4.0 * 1.6 / np.sqrt(300))
    assert drawn.std() == pytest.approx(1.88, abs=0.15)  # habits within 2 sd: their variance is 0.774 of 1
    assert share == pytest.approx(0.58, abs=0.1)
    unknown = np.array([Performance(rng).number("lean", 10.0, 2.0, 8.0, 12.0) for _ in range(500)])
    assert unknown.min() >= 8.0
    assert unknown.max() <= 12.0


def test_sway_has_the_wanted_rms() -> None:
    sway = draw_sway(np.random.default_rng(0), partial(sway_spectrum, centre_height=0.9), rms=0.016, span=(0.0, 50.0))
    assert np.std(sway.at(np.arange(0.0, 50.0, 0.05))[0]) == pytest.approx(0.016, rel=0.01)
