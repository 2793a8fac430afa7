"""Timed up and go: planted phases and turns are found; what is not the whole test is refused."""

import numpy as np
import pytest

from testkit import planted
from testkit.data import show
from testkit.worn_captures import G, true_course
from undrift.errors import InputError
from undrift.measures.up_and_go import turns, up_and_go
from undrift.sim.motion.tasks import draw_task

QUINTIC = 0.189  # of its duration, where a quintic turn has come 5 % of its way


def test_planted_phases_turns_and_durations_are_found():
    edges, angles, fastest, whole = [], [], [], []
    for seed in range(16):
        person, rise, down = planted.up_and_go(np.random.default_rng([36, seed]))
        result, start = up_and_go(true_course(person.motion)), person.motion.time[0]
        values = {name: value[0] for name, value in result.values.items()}
        shown = [one for one in result.events if one.trial_type == "turn"]
        for one, (a, b, _), name in zip(shown, person.turns, ("", "second_"), strict=True):
            late = QUINTIC * (b - a)
            edges += [one.onset + start - a - late, one.onset + one.duration + start - b + late]
            angles.append(values[f"{name}turn_angle_deg"] - 180.0)
            fastest.append(values[f"{name}peak_turn_velocity_dps"] / np.degrees(1.875 * np.pi / (b - a)) - 1.0)
        whole.append(values["tug_duration_s"] - (down[1] - rise[0]))
        phases = sum(
            values[f"{name}_duration_s"] for name in ("sit_to_stand", "walk_out", "turn", "walk_back", "turn_to_sit")
        )
        assert phases == pytest.approx(values["tug_duration_s"])
    edges, angles, fastest, whole = (np.abs(one) for one in (edges, angles, fastest, whole))
    show(
        "turns: start and end, median and 95 % of errors, s",
        f"{np.median(edges):.3f}, {np.percentile(edges, 95):.3f}",
        "0.15, 0.30",
    )
    show(
        "turns: angle, largest error, deg; peak velocity, largest, %",
        f"{angles.max():.1f}, {100.0 * fastest.max():.0f}",
        "10, 25",
    )
    show("whole test, largest difference from the planted motion, s", f"{whole.max():.3f}", 0.3)
    assert np.median(edges) < 0.15
    assert np.percentile(edges, 95) < 0.30
    assert angles.max() < 10.0
    assert fastest.max() < 0.25
    assert whole.max() < 0.3


def motion(name, seed):
    task = draw_task(name, rng=np.random.default_rng([6, seed]))
    return task.at(np.arange(int(task.duration_s * 100.0)) / 100.0, G)


@pytest.mark.parametrize(
    ("task", "text"),
    [
        (lambda seed: motion("posturography", seed), "tug: wanted a rise of"),
        (lambda seed: planted.walk(np.random.default_rng([34, seed])).motion, "tug: wanted a rise of"),
        (lambda seed: motion("sit_to_stand", seed), "got a rise and no sitting down; record the whole test"),
        (
            lambda seed: planted.up_and_go(np.random.default_rng([36, seed]), turned=0.6)[0].motion,
            "got turns between rise and sitting down: 1, where two are wanted; record the whole test",
        ),
    ],
)
def test_what_is_not_the_whole_test_is_refused_in_one_line(task, text):
    for seed in range(3):
        with pytest.raises(InputError, match=text) as caught:
            up_and_go(true_course(task(seed)))
        assert "\n" not in str(caught.value)


def test_a_walk_straight_ahead_has_no_turn():
    for seed in range(4):
        assert turns(true_course(planted.walk(np.random.default_rng([34, seed])).motion)) == []
