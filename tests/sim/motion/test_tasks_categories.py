"""Categories of subjects: the note's performs as before there were others; each keeps its numbers and bounds."""

from typing import get_args

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.sim.motion.tasks import (
    CATEGORIES,
    DEFAULT,
    TABLE_2,
    CategoryName,
    Performance,
    TaskName,
    cohort,
    draw_task,
)

TASKS: tuple[TaskName, ...] = ("sit_to_stand", "step", "posturography")


@pytest.mark.parametrize(
    ("name", "stop_s", "most"),
    [  # drawn on 2026-11-22, before there were categories
        ("sit_to_stand", 9.555276457193637, 0.7284568537198002),
        ("step", 8.719944132648067, 0.2776899259857994),
        ("posturography", 56.0, 0.08003704147865993),
    ],
)
def test_the_notes_category_performs_as_before_there_were_others(name: TaskName, stop_s: float, most: float) -> None:
    person = cohort("simulation", rng=np.random.default_rng(1))[3]
    task = draw_task(name, rng=np.random.default_rng(5), subject=person)
    rate = task.at(np.arange(*task.moving_s, 0.05), 9.81).rate_b
    # sines and exponentials of another C library may differ in the last digit
    assert (task.moving_s[1], np.abs(rate).max()) == pytest.approx((stop_s, most), rel=1e-12)


@pytest.mark.parametrize("name", get_args(CategoryName))
def test_people_of_a_category_keep_its_ages_heights_and_bounds(name: CategoryName) -> None:
    held = CATEGORIES[name]
    ages, heights = (held.age_years, held.height) if held.age_years and held.height else TABLE_2["simulation"]
    people = cohort("simulation", rng=np.random.default_rng(2), category=name)
    assert {person.category for person in people} == {name}
    for printed, drawn in ((ages, [p.age_years for p in people]), (heights, [p.height for p in people])):
        np.testing.assert_allclose((min(drawn), np.mean(drawn), max(drawn)), printed, rtol=1e-12)
    for task, most_dps in zip(TASKS, held.most_dps, strict=True):
        for person in people[:5]:
            drawn_task = draw_task(task, rng=np.random.default_rng(person.number), subject=person)
            rate = drawn_task.at(np.arange(*drawn_task.moving_s, 0.01), 9.81).rate_b
            # looked at every 20 ms when drawn: the peak may lie between
            assert np.degrees(np.abs(rate)).max() <= 1.002 * most_dps


@pytest.mark.parametrize("name", get_args(CategoryName))
def test_the_numbers_of_a_category_can_be_drawn(name: CategoryName) -> None:
    held = CATEGORIES[name]
    spreads = [held.rise_s, held.turn, held.flexion_deg, held.sitting_deg, held.standing_deg]
    spreads += [held.step_s, held.lean_deg, held.roll_deg, *held.sway_deg, held.upright_deg, held.stiffness]
    who = Performance(np.random.default_rng(0))
    for mean, sd, low, high in spreads:
        assert low < mean < high
        drawn = [who.number("any", mean, sd, low, high) for _ in range(400)]
        # bounds cut the tails, a little more on one side: 0.2 sd, and 3 standard errors of 400
        assert np.mean(drawn) == pytest.approx(mean, abs=0.35 * sd)


def test_a_person_has_the_same_habits_in_every_category() -> None:
    noted, young = (cohort("testing", rng=np.random.default_rng(3), category=kind) for kind in (DEFAULT, "young"))
    assert [person.habits.root for person in noted] == [person.habits.root for person in young]
    assert noted[0].age_years != young[0].age_years


def test_a_category_that_is_not_one_is_refused() -> None:
    with pytest.raises(
        InputError,
        match=r"'frail'. Use one of level_1, level_2",
    ):
        cohort("testing", rng=np.random.default_rng(0), category="frail")  # type: ignore[arg-type]
