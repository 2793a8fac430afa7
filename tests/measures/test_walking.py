"""Walking: contacts, durations and their spread of planted people; what is no walk is refused."""

from dataclasses import replace

import numpy as np
import pytest

from testkit import planted
from testkit.data import show
from testkit.worn_captures import G, true_course
from undrift.errors import InputError
from undrift.measures.tasks import measure_of
from undrift.measures.walking import contacts_of_shank, walk, walk_of_shank, walk_of_thigh
from undrift.sim.motion.tasks import draw_task


def people(count):
    return [planted.walk(np.random.default_rng([34, seed])) for seed in range(count)]


def shown_contacts(result, motion):
    return motion.time[0] + np.array([one.onset for one in result.events if one.trial_type == "initial contact"])


@pytest.mark.slow
def test_planted_contacts_durations_and_spread_are_found():
    late, wrong, values = [], [], []
    for person in people(20):
        result = walk(true_course(person.motion))
        found, planned = shown_contacts(result, person.motion), person.contacts
        nearest = found[np.abs(found[:, None] - planned).argmin(axis=0)] - planned
        late.append(np.median(nearest))
        wrong += (nearest - late[-1]).tolist()
        steps, strides = np.diff(planned)[1:-1], (planned[2:] - planned[:-2])[1:-1]
        truth = {
            "stride_duration_s": strides.mean(), "cadence_per_min": 60.0 / steps.mean(),
            "stride_duration_sd_s": strides.std(ddof=1), "step_duration_sd_s": steps.std(ddof=1),
        }  # fmt: skip
        values.append([abs(result.values[name][0] - value) for name, value in truth.items()])
        assert 0 <= len(found) - len(planned) <= 2  # the body moves up and down once more where a walk begins and ends
    wrong, (stride, cadence, strides_sd, steps_sd) = np.abs(wrong), np.max(values, axis=0)
    show("contacts late, median over people, s", f"{np.median(late):.3f}")
    show(
        "contacts, less that of the person: median, 95 %, s",
        f"{np.median(wrong):.4f}, {np.percentile(wrong, 95):.4f}",
        "0.02, 0.06",
    )
    show("largest error: mean stride s, cadence per min", f"{stride:.4f}, {cadence:.2f}", "0.01, 1")
    show("largest error: SD of strides, of steps, s", f"{strides_sd:.4f}, {steps_sd:.4f}", "0.01, 0.01")
    assert np.median(wrong) < 0.02
    assert np.percentile(wrong, 95) < 0.06
    assert stride < 0.01
    assert cadence < 1.0
    assert max(strides_sd, steps_sd) < 0.01


def test_slow_small_steps_are_found_and_a_limp_is_kept_apart_from_its_stride():
    rng = np.random.default_rng(5)
    slow = np.random.default_rng(6).normal(0.9, 0.02, 19).cumsum() + 4.5
    limp = 4.5 + np.cumsum(np.where(np.arange(24) % 2, 0.5, 0.75))
    for contacts, step in ((slow, np.diff(slow).mean()), (limp, 0.625)):  # one long step more than short ones: 0.007 s
        t = np.arange(round((contacts[-1] + 4.0) * planted.FINE)) / planted.FINE
        angles, way = planted.walked(rng, t, contacts)
        result = walk(true_course(planted.motion_of(t, *angles.T, way)))
        assert result.values["step_duration_s"][0] == pytest.approx(step, abs=0.01)
        assert result.values["stride_duration_s"][0] == pytest.approx(2.0 * step, abs=0.02)
    assert result.values["step_duration_sd_s"][0] > 2.0 * result.values["stride_duration_sd_s"][0]


def test_a_turn_belongs_to_no_stride():
    person = planted.walk(np.random.default_rng([34, 3]))
    course = true_course(person.motion)
    straight = walk(course)
    middle = person.contacts[12] - person.motion.time[0]
    turned = replace(course, turning=course.turning + np.pi * np.exp(-(((course.time - middle) / 0.4) ** 2)))
    result = walk(turned)
    assert 0 < result.strides < straight.strides
    assert result.strides <= straight.strides - 2


def motion(name, seed):
    task = draw_task(name, rng=np.random.default_rng([6, seed]))
    return task.at(np.arange(int(task.duration_s * 100.0)) / 100.0, G)


@pytest.mark.parametrize("name", ["posturography", "step", "sit_to_stand", "free"])
def test_what_is_no_walk_is_refused_in_one_line(name):
    for seed in range(3):
        with pytest.raises(InputError, match="walk: wanted 8 steps or more in a row") as caught:
            walk(true_course(motion(name, seed)))
        assert "\n" not in str(caught.value)


def test_a_walk_is_no_rise_from_a_seat_and_no_stance():
    for person in people(8):
        course = true_course(person.motion)
        for task in ("sit-to-stand", "5xSTS", "standing"):
            with pytest.raises(InputError, match=f"{task}: wanted"):
                measure_of(task)(course)


def test_seven_steps_are_too_few():
    person = planted.walk(np.random.default_rng([34, 2]), count=7)
    with pytest.raises(InputError, match="got 7 in a row at most"):
        walk(true_course(person.motion))


def legs(place, count):
    return [planted.walk_of_leg(np.random.default_rng([37, seed]), place) for seed in range(count)]


def near(shown, planned):
    """Errors of instants, each beside the nearest planted one."""
    return shown[np.abs(shown[:, None] - planned).argmin(axis=0)] - planned


@pytest.mark.slow
def test_planted_contacts_and_strides_of_a_leg_are_found():
    wrong, late, values = [], [], []
    for person, ends in legs("shank", 20):
        result, start = walk_of_shank(true_course(person.motion)), person.motion.time[0]
        shown = {
            kind: start + np.array([one.onset for one in result.events if one.trial_type == kind])
            for kind in ("initial contact", "end contact")
        }
        errors = [
            near(shown[kind], planned)[1:-1]
            for kind, planned in (("initial contact", person.contacts), ("end contact", ends))
        ]
        late.append([np.median(one) for one in errors])
        wrong += np.concatenate([one - np.median(one) for one in errors]).tolist()
        inside = (shown["initial contact"] > person.contacts[0] - 0.3) & (
            shown["initial contact"] < person.contacts[-1] + 0.3
        )
        counted = np.diff(shown["initial contact"])[1:-1]
        assert result.values["stride_duration_s"][0] == pytest.approx(counted.mean(), abs=1e-9)
        assert inside.sum() == len(person.contacts)
        strides = np.diff(person.contacts)
        stance = (ends[: len(strides)] - person.contacts[:-1])[1:-1]
        values.append(
            [
                abs(result.values["stride_duration_s"][0] - strides.mean()),
                abs(result.values["stride_duration_sd_s"][0] - strides.std(ddof=1)),
                abs(result.values["stance_percent"][0] - 100.0 * (stance / strides[1:-1]).mean()),
            ]
        )
    late, (mean, spread, stance) = np.array(late), np.max(values, axis=0)
    show("shank: initial and end contact late, median over people, s", np.round(np.median(late, axis=0), 3), "0.02")
    show(
        "shank: contacts, less that of the person: median, 95 %, s",
        f"{np.median(np.abs(wrong)):.4f}, {np.percentile(np.abs(wrong), 95):.4f}", "0.02, 0.06",
    )  # fmt: skip
    show(
        "shank: largest error: mean stride s, its SD s, stance %",
        f"{mean:.4f}, {spread:.4f}, {stance:.2f}",
        "0.01, 0.01, 2",
    )
    assert np.abs(np.median(late, axis=0)).max() < 0.02
    assert np.median(np.abs(wrong)) < 0.02
    assert np.percentile(np.abs(wrong), 95) < 0.06
    assert mean < 0.01
    assert spread < 0.01
    assert stance < 2.0


@pytest.mark.slow
def test_planted_strides_of_a_thigh_are_found():
    wrong = []
    for person, swings in legs("thigh", 20):
        result, start = walk_of_thigh(true_course(person.motion)), person.motion.time[0]
        shown = start + np.array([one.onset for one in result.events if one.trial_type == "mid-swing"])
        error = near(shown, swings)[1:-1]
        wrong += np.abs(error - np.median(error)).tolist()
        assert result.values["cadence_per_min"][0] == pytest.approx(120.0 / result.values["stride_duration_s"][0])
        assert 20.0 < result.values["thigh_pitch_range_deg"][0] < 60.0
    show(
        "thigh: mid-swings, less that of the person: median, 95 %, s",
        f"{np.median(wrong):.4f}, {np.percentile(wrong, 95):.4f}",
        "0.02, 0.06",
    )
    assert np.median(wrong) < 0.02
    assert np.percentile(wrong, 95) < 0.06


def test_a_leg_that_is_worn_back_to_front_is_refused():
    person, _ = legs("shank", 1)[0]
    course = true_course(person.motion)
    with pytest.raises(
        InputError, match=r"walk: wanted a leg that swings forward faster than back, got .* deg/s; check the sides"
    ):
        walk_of_shank(replace(course, rate=-course.rate))


def test_a_leg_that_takes_four_strides_at_most_or_sits_does_not_walk():
    person, _ = planted.walk_of_leg(np.random.default_rng([37, 1]), "shank", count=3)
    chair = planted.chair_of_thigh(np.random.default_rng([38, 1]))[0]
    few = "walk: wanted 5 swings of the leg or more in a row, alike, without turn or bow, got [34] in a row at most"
    sits = "check the sides .*, or name the task that was done"
    for measured, motion, text in ((walk_of_shank, person.motion, few), (walk_of_thigh, chair.motion, sits)):
        with pytest.raises(InputError, match=text) as caught:
            measured(true_course(motion))
        assert "\n" not in str(caught.value)


def test_the_initial_contact_does_not_move_with_the_low_pass():
    person, _ = legs("shank", 1)[0]
    course = true_course(person.motion)
    rates = [course.rate, person.motion.rate_b]
    tables = [np.concatenate(contacts_of_shank(replace(course, rate=one))[1]) for one in rates]
    assert np.abs(tables[0][:, 0] - tables[1][:, 0]).max() < 0.025
