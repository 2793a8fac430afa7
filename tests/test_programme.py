"""Programmes: what a protocol becomes, how long it takes, and what is refused before anything moves."""

import math
from dataclasses import replace

import pytest

from undrift.errors import InputError
from undrift.programme import (
    Dwell,
    Mount,
    Programme,
    ProgrammeSettings,
    Protocol,
    Soak,
    programme_of,
    settle_time,
    whole_turns_time,
)
from undrift.rig.rig import Limits, check_programme

DPS = math.pi / 180.0
SIT_TO_STAND = Protocol(
    turn_rate_min=5.0 * DPS, turn_rate_max=90.0 * DPS, turn_rate_step=5.0 * DPS, grid="paper", cutoff_hz=11.1
)
SMALL = Protocol(
    faces=("+x", "-z"), turn_rate_min=10.0 * DPS, turn_rate_max=30.0 * DPS, turn_rate_step=10.0 * DPS, axes=("x", "z")
)


def kinds(programme):
    return [step.purpose if isinstance(step, Dwell) else type(step).__name__ for step in programme.steps]


def test_a_device_settles_to_a_thousandth_and_never_less_than_the_table_needs():
    assert settle_time(11.1) == 0.3
    assert settle_time(2.0) == pytest.approx(math.log(1000.0) / (math.sqrt(0.5) * 2.0 * math.pi * 2.0))
    assert settle_time(2.0, damping=1.0) < settle_time(2.0)


def test_whole_turns_are_the_next_ones():
    assert whole_turns_time(-90.0 * DPS, 6.0) == pytest.approx(8.0)
    assert whole_turns_time(90.0 * DPS, 4.0) == pytest.approx(4.0)
    assert whole_turns_time(90.0 * DPS, 4.1) == pytest.approx(8.0)
    assert whole_turns_time(5.0 * DPS, 6.0) == pytest.approx(72.0)


def test_the_notes_grid_becomes_102_dwells_on_six_mountings_and_a_stated_time():
    programme = programme_of(SIT_TO_STAND)
    assert sum(dwell.purpose == "rate" for dwell in programme.dwells) == 102
    assert sum(isinstance(step, Mount) for step in programme.steps) == 6
    rates = [dwell for dwell in programme.dwells if dwell.purpose == "rate"]
    by_hand = sum(2.0 * abs(dwell.turn_rate) / 40.0 + 6.3 for dwell in rates) + (6 + 6) * 6.3
    assert sum(dwell.duration_s for dwell in programme.dwells) == pytest.approx(by_hand)
    assert programme.duration_s == pytest.approx(by_hand + 6 * 30.0)
    assert programme_of(SIT_TO_STAND) == programme


def test_blocks_stand_between_rests_and_a_face_shares_the_mounting_of_its_axis():
    programme = programme_of(SMALL)
    block = ["bracket", *["rate"] * 6, "bracket"]
    assert kinds(programme) == ["Mount", "face", *block, "Mount", "face", "Mount", *block]
    assert [step.up for step in programme.steps if isinstance(step, Mount)] == ["+x", "-z", "+z"]
    rates = [round(d.turn_rate / DPS) for d in programme.dwells if d.purpose == "rate"]
    assert rates[:6] == [10, -10, 20, -20, 30, -30]


def test_a_random_order_is_the_seeds_and_holds_the_same_rates():
    drawn = [programme_of(replace(SMALL, order="random", seed=seed)) for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1] != drawn[2]
    first, last = drawn[0].dwells[2:8], drawn[2].dwells[2:8]
    assert sorted(d.turn_rate for d in first) == pytest.approx(sorted(d.turn_rate for d in last))
    assert [d.turn_rate for d in first] != sorted(d.turn_rate for d in first)


def followed_s(change_c, c_per_min, lag_s, limit_c_per_min, *, step_s=0.1):
    """Heat a board step by step until it changes by less than the limit."""
    air, board, time_s = 0.0, 0.0, 0.0
    while air < change_c or 60.0 * (air - board) / lag_s > limit_c_per_min:
        air = min(air + c_per_min / 60.0 * step_s, change_c)
        board += (air - board) / lag_s * step_s
        time_s += step_s
    return time_s


@pytest.mark.parametrize(("lag_s", "change_c"), [(60.0, 12.0), (600.0, 2.0), (600.0, 27.0), (1500.0, 15.0)])
def test_a_soak_is_forecast_by_how_fast_the_board_follows(lag_s, change_c):
    protocol = replace(SMALL, temperatures_c=(25.0 + change_c,), board_lag_s=lag_s)
    soak = next(step for step in programme_of(protocol).steps if isinstance(step, Soak))
    assert soak.duration_s == pytest.approx(followed_s(change_c, 2.0, lag_s, 0.1) + 460.0, abs=1.0)


def test_a_board_without_a_lag_takes_as_long_as_the_air():
    soak = programme_of(replace(SMALL, temperatures_c=(45.0,), board_lag_s=0.0)).steps[1]
    assert soak.duration_s == pytest.approx(600.0 + 460.0)


def test_every_temperature_is_soaked_at_in_each_mounting():
    heated = programme_of(replace(SMALL, temperatures_c=(20.0, 40.0)), ProgrammeSettings(room_c=25.0))
    soaks = [step for step in heated.steps if isinstance(step, Soak)]
    assert [soak.temp_c for soak in soaks] == [20.0, 40.0] * 3
    assert soaks[0].duration_s == pytest.approx(followed_s(5.0, 2.0, 600.0, 0.1) + 460.0, abs=1.0)
    assert soaks[1].duration_s == pytest.approx(followed_s(20.0, 2.0, 600.0, 0.1) + 460.0, abs=1.0)
    assert all(dwell.temp_c in (20.0, 40.0) for dwell in heated.dwells)
    assert len(heated.dwells) == 2 * len(programme_of(SMALL).dwells)


NOTES_SOAKS = replace(SIT_TO_STAND, dwell_s=2.0, temperatures_c=(18.0, 30.0, 45.0, 60.0, 75.0))


@pytest.mark.parametrize(
    ("at", "mountings", "soaks", "minutes"),
    [("every", 6, 30, 1296.9), ("first", 6, 18, 665.3), ("room", 9, 15, 643.8)],
)
def test_faces_at_few_temperatures_save_soaks(at, mountings, soaks, minutes):
    programme = programme_of(replace(NOTES_SOAKS, faces_at=at))
    assert sum(isinstance(step, Mount) for step in programme.steps) == mountings
    assert sum(isinstance(step, Soak) for step in programme.steps) == soaks
    assert round(programme.duration_s / 60.0, 1) == minutes
    assert sum(dwell.purpose == "rate" for dwell in programme.dwells) == 5 * 102
    faces = [(dwell.up, dwell.temp_c) for dwell in programme.dwells if dwell.purpose == "face"]
    temps_c = {"every": NOTES_SOAKS.temperatures_c, "first": (18.0,), "room": (None,)}[at]
    assert sorted(faces, key=str) == sorted(((up, c) for up in NOTES_SOAKS.faces for c in temps_c), key=str)


def test_a_face_without_rates_is_mounted_before_those_that_are_heated():
    programme = programme_of(replace(SMALL, faces_at="first", temperatures_c=(20.0, 40.0)))
    steps = [
        step.up if isinstance(step, Mount) else step.temp_c for step in programme.steps if not isinstance(step, Dwell)
    ]
    assert steps == ["-z", 20.0, "+x", 20.0, 40.0, "+z", 20.0, 40.0]


def test_a_filter_that_rings_settles_later():
    slow = replace(SMALL, cutoff_hz=2.0)
    more = programme_of(replace(slow, damping=0.5)).duration_s - programme_of(slow).duration_s
    per_dwell = math.log(1000.0) / (2.0 * math.pi * 2.0) * (2.0 - math.sqrt(2.0))
    assert more == pytest.approx(len(programme_of(slow).dwells) * per_dwell)


def test_dwells_are_as_long_as_asked_for_and_as_the_uncertainty_needs():
    stated = replace(SMALL, dwell_s=2.0, turn_rate_uncertainty=0.0009 * DPS)
    assert {round(d.dwell_s, 9) for d in programme_of(stated).dwells if d.purpose == "rate"} == {10.0}
    coarse = programme_of(stated, ProgrammeSettings(encoder_lines=5000))
    assert {round(d.dwell_s, 9) for d in coarse.dwells if d.purpose == "rate"} == {20.0}
    turns = programme_of(replace(SMALL, whole_turns=True))
    assert [round(d.dwell_s, 9) for d in turns.dwells if d.purpose == "rate"][:6] == [
        36.0,
        36.0,
        18.0,
        18.0,
        12.0,
        12.0,
    ]


def test_no_bracket_is_asked_for_by_zero_seconds():
    assert "bracket" not in kinds(programme_of(replace(SMALL, bracket_s=0.0)))


def test_a_programme_without_a_dwell_is_refused():
    with pytest.raises(InputError, match="at least one dwell"):
        Programme(steps=(Mount(up="+x", duration_s=1.0),), acceleration=1.0)


def test_rates_accelerations_and_travel_beyond_the_rigs_are_refused_before_it_is_opened():
    programme = programme_of(SMALL)
    check_programme(programme, Limits())
    with pytest.raises(InputError, match=r"step 7 \(\+30 deg/s about x\): turn rate: at most 22.9183 deg/s .*, got 30"):
        check_programme(programme, Limits(turn_rate=0.4))
    with pytest.raises(InputError, match=r"acceleration: at most 572.958 deg/s2 .*, got 2291.83"):
        check_programme(programme, Limits(acceleration=10.0))
    with pytest.raises(InputError, match=r"step [3-7] .*: travel: at most 114.592 deg .*, got"):
        check_programme(programme, Limits(travel=2.0))
    check_programme(programme, Limits(travel=4.0))  # back and forth: 30 deg/s for 6.3 s is 3.3 rad
    check_programme(programme, Limits(turn_rate=0.4), frozenset(range(7, 99)))


def test_rates_for_a_persons_hands_are_refused_with_the_way_out():
    with pytest.raises(
        InputError,
        match=r"manual rig: .* got 12 dwells",
    ):
        check_programme(programme_of(SMALL), Limits(), by_hand=True)
    check_programme(programme_of(Protocol(faces=("+x",))), Limits(), by_hand=True)
