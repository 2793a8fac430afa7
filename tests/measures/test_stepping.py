"""Step rising: planted lifts are found, one by one and on stairs; what is no step is refused."""

from dataclasses import fields, replace

import numpy as np
import pytest

from testkit import planted
from testkit.data import show
from testkit.worn_captures import G, true_course
from undrift.errors import InputError
from undrift.measures.stepping import step
from undrift.sim.motion.tasks import draw_task

TENTH = (
    0.0866  # of its duration, where the velocity of a quintic lift is a tenth of its peak: s (1 - s) = sqrt(0.1) / 4
)


def lifted(seed, **how):
    """A planted course, and the true start and end (K, 2) and height of its lifts."""
    person, duration, height = planted.step_up(np.random.default_rng([35, seed]), **how)
    starts = person.contacts - person.motion.time[0]
    return (
        true_course(person.motion),
        np.stack((starts + TENTH * duration, starts + (1 - TENTH) * duration), axis=1),
        height,
    )


def spans(result):
    return np.array([(one.onset, one.onset + one.duration) for one in result.events])


@pytest.mark.parametrize(("count", "pause"), [(1, 0.0), (3, 3.0), (10, 0.15)])
def test_planted_lifts_are_found(count, pause):
    edges, heights = [], []
    for seed in range(12):
        course, truth, height = lifted(seed, count=count, pause=pause)
        result = step(course)
        assert len(result.events) == count
        edges.append(np.abs(spans(result) - truth))
        heights.append(np.abs(result.values["rise_height_m"] - height))
    edge = np.concatenate([one.ravel() for one in edges])
    ends = f"{np.median(edge):.3f}, {np.percentile(edge, 95):.3f}"
    show(f"{count} lifts: start and end, median and 95 % of errors, s", ends, "0.05, 0.10")
    show(f"{count} lifts: height, largest error, m", f"{np.concatenate(heights).max():.3f}", 0.02)
    assert np.median(edge) < 0.05
    assert np.percentile(edge, 95) < 0.10
    assert np.concatenate(heights).max() < 0.02


def motion(name, seed):
    task = draw_task(name, rng=np.random.default_rng([6, seed]))
    return task.at(np.arange(int(task.duration_s * 100.0)) / 100.0, G)


def test_the_step_of_the_library_is_a_step():
    for seed in range(6):
        result = step(true_course(motion("step", seed)))
        assert len(result.events) == 1
        assert 0.12 < result.values["rise_height_m"][0] < 0.22


@pytest.mark.parametrize(
    ("task", "got"),
    [
        (lambda seed: motion("sit_to_stand", seed), "a rise of 0.3. m, as from a seat"),
        (lambda seed: motion("posturography", seed), "none"),
        (lambda seed: planted.walk(np.random.default_rng([34, seed])).motion, "ups and downs alike, as in walking"),
        (lambda seed: planted.step_up(np.random.default_rng([35, seed]), count=1, height=0.04)[0].motion, "none"),
    ],
)
def test_what_is_no_step_is_refused_in_one_line(task, got):
    for seed in range(4):
        with pytest.raises(InputError, match=f"step: wanted a rise of 0.08 to 0.27 m, got {got}; record from standing"):
            step(true_course(task(seed)))


def test_a_lift_that_the_recording_cuts_off_is_no_figure():
    course, truth, _ = lifted(3, count=1)
    stop, names = int(truth[0, 1] / course.step) - 10, (one.name for one in fields(course))
    cut = replace(course, **{name: getattr(course, name)[:stop] for name in names})
    with pytest.raises(InputError, match=r"without a stance of 0\.5 s before and after"):
        step(cut)


def test_a_deep_bow_while_the_body_rises_is_no_step():
    course, _, _ = lifted(3, count=1)
    with pytest.raises(InputError, match=r"one in which the trunk leans by \d+ deg"):
        step(replace(course, pitch=6.0 * course.pitch))
