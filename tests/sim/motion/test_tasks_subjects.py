"""Cohorts: the printed statistics, people who share nothing, habits."""

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.sim.motion.tasks import Group, Performance, cohort

TABLE_2: dict[Group, tuple[tuple[float, float, float], tuple[float, float, float]]] = {  # the note, Table 2
    "simulation": ((45.0, 62.0, 84.0), (1.50, 1.66, 1.85)),
    "testing": ((45.0, 65.0, 83.0), (1.52, 1.67, 1.83)),
}


@pytest.mark.parametrize("group", TABLE_2)
def test_a_cohort_has_the_ranges_and_means_of_table_2(group: Group) -> None:
    for seed in range(20):
        people = cohort(group, rng=np.random.default_rng(seed))
        assert len(people) == 30
        assert [person.number for person in people] == list(range(1, 31))
        assert {person.group for person in people} == {group}
        for values, printed in zip(
            ([p.age_years for p in people], [p.height for p in people]), TABLE_2[group], strict=True
        ):
            np.testing.assert_allclose((min(values), np.mean(values), max(values)), printed, rtol=1e-12)
            assert 0.1 < np.std(values) / (max(values) - min(values)) < 0.35  # spread out, not heaped at the ends
    show(f"{group}: age low, mean, high", [round(f([p.age_years for p in people]), 6) for f in (min, np.mean, max)])
    show(f"{group}: height low, mean, high", [round(f([p.height for p in people]), 6) for f in (min, np.mean, max)])


def test_the_two_cohorts_share_no_random_numbers_even_from_equal_generators() -> None:
    people = [p for group in TABLE_2 for p in cohort(group, rng=np.random.default_rng(0))]
    assert len({p.habits.root for p in people}) == 60
    ages = np.array([p.age_years for p in people]).reshape(2, 30)
    assert not np.isin(ages[0, (ages[0] > 45.0)], ages[1]).any()


def test_equal_generators_give_equal_people() -> None:
    assert cohort("testing", rng=np.random.default_rng(5)) == cohort("testing", rng=np.random.default_rng(5))
    assert cohort("testing", rng=np.random.default_rng(5)) != cohort("testing", rng=np.random.default_rng(6))


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


def test_a_group_that_is_not_one_is_refused() -> None:
    with pytest.raises(InputError, match="unknown group or category 'control'"):
        cohort("control", rng=np.random.default_rng(0))  # type: ignore[arg-type]
