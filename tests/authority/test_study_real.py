"""The study's report on real recordings: BROAD trials, people rising, squatting and climbing, stance on a force plate.

BROAD: Laidig et al., Data 2021, CC BY 4.0. Captures: repository nimblephysics, snapshot of 2025-09-14. Stance: BMClab/datasets,
Santos and Duarte 2016 (BDS) and dos Santos et al. 2017 (PDS), CC BY 4.0, snapshot of 2023-09-26. The people captured are not the
cohort: younger and brisker in rising, on firm ground or with open eyes in standing. What differs is printed, and held to be so.
"""

from functools import cache

import pytest

from testkit.data import data_path, show
from testkit.real_people import (
    Captured,
    CapturedTrial,
    CohortComparison,
    Condition,
    Stance,
    motion_rows,
    read_stance,
    sway_rows,
)
from undrift.io.mocap import read_c3d, read_trc
from undrift.io.reference import device_on, find_body

pytestmark = pytest.mark.usefixtures("computed_once")

TRIALS: tuple[tuple[str, Captured, tuple[str, str]], ...] = (
    ("STS1", "sit_to_stand", ("mocap_sit_to_stand", "STS1.trc.gz")),
    ("STSAsym1", "sit_to_stand", ("mocap_sit_to_stand", "STSAsym1.trc.gz")),
    ("squats1", "squat", ("mocap_sit_to_stand", "squats1.trc.gz")),
    ("Squat2", "squat", ("mocap_stair_up", "markers_Squat2.trc.gz")),
    ("squat.c3d", "squat", ("c3d", "squat.c3d.gz")),
    ("StairUp3", "stairs", ("mocap_stair_up", "markers_StairUp3.trc.gz")),
)
STANCES: tuple[tuple[str, float, Condition], ...] = (
    ("PDS13OR1grf", 65.35, "open on firm"),
    ("PDS13CR1grf", 65.35, "closed on firm"),
    ("PDS13OF1grf", 65.35, "open on foam"),
    ("BDS00025", 63.4, "closed on firm"),
    ("BDS00027", 63.4, "closed on firm"),
    ("BDS00030", 63.4, "open on firm"),
    ("BDS00033", 63.4, "open on foam"),
)


@cache
def captures() -> tuple[CapturedTrial, ...]:
    """The six captured trials, a device at L5."""
    made = []
    for name, task, parts in TRIALS:
        read = read_c3d if name.endswith("c3d") else read_trc
        made.append(
            CapturedTrial(name=name, task=task, device=device_on(find_body(read(data_path(*parts), up="y"), "pelvis")))
        )
    return tuple(made)


def tell(rows: tuple[CohortComparison, ...]) -> None:
    """Print rows."""
    for row in rows:
        show(
            f"{row.trial} ({row.task}), {row.measure}, {row.unit}",
            f"{row.real:.2f}; cohort {row.median:.2f}, 95 % {row.low:.2f} to {row.high:.2f}; "
            + ("inside" if row.inside else "outside")
            + (f"; {row.note}" if row.note else ""),
        )


@pytest.mark.slow
def test_people_rise_faster_than_the_notes_bound_and_climb_as_the_cohort_does() -> None:
    rows = motion_rows(captures())
    tell(rows)
    by = {(row.trial, row.measure): row for row in rows}
    for name in ("STS1", "STSAsym1"):
        assert by[name, "lean"].task.endswith("5 repetitions")  # as the data's own description counts them
        # The library holds to the note's 90 deg/s for a Tinetti level of 2; these people, told to rise five times, do not.
        assert by[name, "peak flexion rate"].real > 90.0 > by[name, "peak flexion rate"].high
    assert by["squats1", "lean"].task.endswith("5 repetitions")
    assert all(by["StairUp3", m].inside for m in ("pitch range", "peak pitch rate", "peak roll rate"))
    assert all(row.note for row in rows if not row.task.startswith("sit_to_stand"))


@pytest.fixture(scope="module")
def stances() -> tuple[Stance, ...]:
    """Seven stances of two people."""
    return tuple(
        read_stance(data_path("posturography", f"{name}.txt.gz"), mass_kg=mass, condition=condition)
        for name, mass, condition in STANCES
    )


def test_stance_on_a_plate_beside_the_simulated_sway(stances: tuple[Stance, ...]) -> None:
    rows = sway_rows(stances)
    tell(rows)
    by = {(row.trial, row.measure): row for row in rows}
    assert all("eyes closed on foam" in row.note for row in rows)  # none of the enclosed trials is in that condition
    for name, _, condition in STANCES:
        speed = by[name, "speed of the centre of pressure"]
        # Foam shakes even open eyes as much as the model; firm ground does not.
        assert speed.inside if condition == "open on foam" else speed.real < speed.low
        assert by[name, "acceleration AP, rms"].inside == (condition == "open on foam")
        assert by[name, "mean frequency AP"].real > by[name, "mean frequency AP"].low
