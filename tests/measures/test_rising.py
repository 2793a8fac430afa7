"""Sit-to-stand by a device at a thigh: planted rises are found; what is none is refused."""

from dataclasses import fields, replace

import numpy as np
import pytest

from testkit import planted
from testkit.data import show
from testkit.worn_captures import true_course
from undrift.errors import InputError
from undrift.measures.rising import five_times_of_thigh, sit_to_stand_of_thigh

TENTH = 0.0866  # of its duration, where the rate of a quintic turn is a tenth of its peak: s (1 - s) = sqrt(0.1) / 4
TWENTIETH = 0.189  # where it has come 5 % of its way


def chairs(count):
    return [planted.chair_of_thigh(np.random.default_rng([38, seed])) for seed in range(count)]


def spans(result, kind, start):
    return start + np.array([(one.onset, one.onset + one.duration) for one in result.events if one.trial_type == kind])


def test_planted_rises_and_sittings_of_a_thigh_are_found():
    edges, pitch = [], []
    for person, rises, sittings in chairs(16):
        result = five_times_of_thigh(true_course(person.motion))
        for kind, truth in (("sit-to-stand", rises), ("stand-to-sit", sittings[:4])):
            late = TENTH * np.diff(truth, axis=1)
            edges += np.abs(spans(result, kind, person.motion.time[0]) - truth - late * [1.0, -1.0]).ravel().tolist()
        values = result.values
        pitch += (values["thigh_pitch_standing_deg"] - values["thigh_pitch_sitting_deg"]).tolist()
        np.testing.assert_allclose(values["thigh_pitch_range_deg"], pitch[-5:])
        whole = rises[4, 1] - rises[0, 0]
        assert values["five_times_duration_s"][0] == pytest.approx(whole, abs=0.5)
    show(
        "thigh: start and end, median and 95 % of errors, s",
        f"{np.median(edges):.4f}, {np.percentile(edges, 95):.4f}",
        "0.02, 0.06",
    )
    assert np.median(edges) < 0.02
    assert np.percentile(edges, 95) < 0.06
    assert 60.0 < min(pitch) < max(pitch) < 105.0


def test_the_seat_is_left_where_the_hip_has_come_a_twentieth_of_its_way():
    late = []
    for person, rises, _ in chairs(8):
        result, start = sit_to_stand_of_thigh(true_course(person.motion)), person.motion.time[0]
        for (onset, _), (a, b) in zip(spans(result, "seat-off", start), rises, strict=True):
            late.append(onset - a - TWENTIETH * (b - a))
    show("thigh: seat-off beside 5 % of the planted turn, largest, s", f"{np.abs(late).max():.3f}", 0.1)
    assert np.abs(late).max() < 0.1  # cos(pitch) of a thigh that lies is not its angle


def test_a_thigh_that_swings_or_lies_upside_down_has_no_rise():
    leg = planted.walk_of_leg(np.random.default_rng([37, 3]), "thigh")[0]
    person = chairs(1)[0][0]
    course = true_course(person.motion)
    back = replace(course, pitch=-course.pitch, rate=-course.rate)
    for one in (true_course(leg.motion), back):
        with pytest.raises(
            InputError, match="sit-to-stand: wanted a rise in which the thigh turns by 45 deg or more"
        ) as caught:
            sit_to_stand_of_thigh(one)
        assert "\n" not in str(caught.value)


def test_four_rises_of_a_thigh_are_no_five_and_one_that_the_recording_cuts_off_is_none():
    person, rises, _ = planted.chair_of_thigh(np.random.default_rng([38, 2]))
    course = true_course(person.motion)
    stop = round((rises[4].mean() - person.motion.time[0]) / course.step)
    cut = replace(course, **{one.name: getattr(course, one.name)[:stop] for one in fields(course)})
    assert len(sit_to_stand_of_thigh(cut).values["duration_s"]) == 4
    with pytest.raises(InputError, match="5xSTS: wanted five rises from a seat, got 4; record all five"):
        five_times_of_thigh(cut)
