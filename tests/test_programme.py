"""Programmes: what a protocol becomes, how long it takes, and what is refused before anything moves."""

import math
from pathlib import Path

import numpy as np
import pytest

from undrift.errors import FileFormatError, InputError
from undrift.programme import (
    Dwell,
    FacesTable,
    Mount,
    ProgrammeSettings,
    Protocol,
    ProtocolTable,
    RatesTable,
    Soak,
    TemperaturesTable,
    TurnsTable,
    programme_of,
    rate_grid,
    read_protocol,
    settle_time,
    write_protocol,
)
from undrift.rig.rig import Limits, check_programme

DPS = math.pi / 180.0
RATES = RatesTable(turn_rate_min_dps=5.0, turn_rate_max_dps=90.0, turn_rate_step_dps=5.0, grid="paper")
SIT_TO_STAND = Protocol(faces=FacesTable(), rates=RATES)
SMALL = Protocol(
    faces=FacesTable(order=("+x", "-z")),
    rates=RatesTable(turn_rate_min_dps=10.0, turn_rate_max_dps=30.0, turn_rate_step_dps=10.0, axes=("x", "z")),
)


def heated(protocol, *set_points_c, **choices):
    return protocol.but(temperatures=TemperaturesTable(set_points_c=set_points_c, **choices))


def kinds(programme):
    return [step.purpose if isinstance(step, Dwell) else type(step).__name__ for step in programme.steps]


def test_device_settles_to_a_thousandth():
    assert settle_time(11.1) == 0.3
    assert settle_time(2.0) == pytest.approx(math.log(1000.0) / (math.sqrt(0.5) * 2.0 * math.pi * 2.0))
    assert settle_time(2.0, damping=1.0) < settle_time(2.0)


def test_notes_grid_becomes_102_dwells():
    programme = programme_of(SIT_TO_STAND)
    assert sum(dwell.purpose == "rate" for dwell in programme.dwells) == 102
    assert sum(isinstance(step, Mount) for step in programme.steps) == 6
    rates = [dwell for dwell in programme.dwells if dwell.purpose == "rate"]
    by_hand = sum(2.0 * abs(dwell.turn_rate) / 40.0 + 6.3 for dwell in rates) + (6 + 6) * 6.3
    assert sum(dwell.duration_s for dwell in programme.dwells) == pytest.approx(by_hand)
    assert programme.duration_s == pytest.approx(by_hand + 6 * 30.0)
    assert programme_of(SIT_TO_STAND) == programme
    assert SIT_TO_STAND.with_faces_at_room().faces.at == "room"


def test_blocks_stand_between_rests():
    programme = programme_of(SMALL)
    block = ["bracket", *["rate"] * 6, "bracket"]
    assert kinds(programme) == ["Mount", "face", *block, "Mount", "face", "Mount", *block]
    assert [step.up for step in programme.steps if isinstance(step, Mount)] == ["+x", "-z", "+z"]
    rates = [round(d.turn_rate / DPS) for d in programme.dwells if d.purpose == "rate"]
    assert rates[:6] == [10, -10, 20, -20, 30, -30]


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
    protocol = heated(SMALL, 25.0 + change_c, board_lag_s=lag_s)
    soak = next(step for step in programme_of(protocol).steps if isinstance(step, Soak))
    assert soak.duration_s == pytest.approx(followed_s(change_c, 2.0, lag_s, 0.1) + 460.0, abs=1.0)


def test_every_temperature_is_soaked_at_in_each_mounting():
    programme = programme_of(heated(SMALL, 20.0, 40.0), ProgrammeSettings(room_c=25.0))
    soaks = [step for step in programme.steps if isinstance(step, Soak)]
    assert [soak.temp_c for soak in soaks] == [20.0, 40.0] * 3
    assert soaks[0].duration_s == pytest.approx(followed_s(5.0, 2.0, 600.0, 0.1) + 460.0, abs=1.0)
    assert soaks[1].duration_s == pytest.approx(followed_s(20.0, 2.0, 600.0, 0.1) + 460.0, abs=1.0)
    assert all(dwell.temp_c in (20.0, 40.0) for dwell in programme.dwells)
    assert len(programme.dwells) == 2 * len(programme_of(SMALL).dwells)


NOTES_SOAKS = heated(SIT_TO_STAND.but(rates=RATES.but(seconds=2.0)), 18.0, 30.0, 45.0, 60.0, 75.0)


@pytest.mark.parametrize(
    ("at", "mountings", "soaks", "minutes"),
    [("every", 6, 30, 1296.9), ("room", 9, 15, 643.8)],
)
def test_faces_at_few_temperatures_save_soaks(at, mountings, soaks, minutes):
    programme = programme_of(NOTES_SOAKS.but(faces=FacesTable(at=at)))
    assert sum(isinstance(step, Mount) for step in programme.steps) == mountings
    assert sum(isinstance(step, Soak) for step in programme.steps) == soaks
    assert round(programme.duration_s / 60.0, 1) == minutes
    assert sum(dwell.purpose == "rate" for dwell in programme.dwells) == 5 * 102
    faces = [(dwell.up, dwell.temp_c) for dwell in programme.dwells if dwell.purpose == "face"]
    temps_c = {"every": NOTES_SOAKS.temperatures_c, "room": (None,)}[at]
    assert sorted(faces, key=str) == sorted(((up, c) for up in NOTES_SOAKS.face_order for c in temps_c), key=str)


def test_programme_beyond_the_limits_is_refused():
    programme = programme_of(SMALL)
    check_programme(programme, Limits())
    with pytest.raises(InputError, match=r"step 7 .*got 30"):
        check_programme(programme, Limits(turn_rate=0.4))
    with pytest.raises(InputError, match=r"got 2291.83"):
        check_programme(programme, Limits(acceleration=10.0))
    with pytest.raises(InputError, match=r"at most 114.592"):
        check_programme(programme, Limits(travel=2.0))
    check_programme(programme, Limits(travel=4.0))  # back and forth: 30 deg/s for 6.3 s is 3.3 rad
    check_programme(programme, Limits(turn_rate=0.4), frozenset(range(7, 99)))


def test_rates_for_a_persons_hands_are_refused_with_the_way_out():
    with pytest.raises(
        InputError,
        match="got 12 dwells",
    ):
        check_programme(programme_of(SMALL), Limits(), by_hand=True)
    check_programme(programme_of(Protocol(faces=FacesTable(order=("+x",)))), Limits(), by_hand=True)


# ---- protocol: the note's grids, and what cannot be done is refused


@pytest.mark.parametrize(
    ("limits", "paper", "inclusive"),
    [((5.0, 90.0, 5.0), 102, 108), ((3.0, 45.0, 3.0), 84, 90), ((0.1, 5.0, 0.1), 294, 300)],
)
def test_the_grid_counts_the_columns_as_the_note_does(
    limits: tuple[float, float, float], paper: int, inclusive: int
) -> None:
    assert 3 * len(rate_grid(*limits, rule="paper")) == paper
    assert 3 * len(rate_grid(*limits, rule="inclusive")) == inclusive
    assert rate_grid(*limits, rule="inclusive").max() == pytest.approx(limits[1])
    assert np.abs(rate_grid(*limits, rule="paper")).min() == pytest.approx(limits[0] + limits[2])


def test_a_grid_that_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match=r"must divide 85, got 4.* 4\.04"):
        rate_grid(5.0, 90.0, 4.0)
    with pytest.raises(InputError, match=r"positive step .*got 5, 3, 1"):
        rate_grid(5.0, 3.0, 1.0)


# ---- protocol.toml reads back as it was written; what is wrong is named


def test_a_protocol_reads_back_as_it_was(tmp_path: Path) -> None:
    wanted = Protocol(
        protocol=ProtocolTable(name='so "called"', damping=0.8),
        faces=FacesTable(order=("+x", "-z"), at="room"),
        rates=RATES.but(axes=("z",), seconds=4.0),
        turns=TurnsTable(axes=("x",)),
        temperatures=TemperaturesTable(set_points_c=(18.0, 75.0)),
    )
    write_protocol(wanted, tmp_path / "protocol.toml")
    assert read_protocol(tmp_path / "protocol.toml") == wanted
    write_protocol(SIT_TO_STAND, tmp_path / "protocol.toml")
    assert read_protocol(tmp_path / "protocol.toml") == SIT_TO_STAND


RATES_TOML = "[rates]\nturn_rate_min_dps = 5.0\nturn_rate_max_dps = 90.0\nturn_rate_step_dps = "


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (RATES_TOML + "4.0\n", "must divide 85, got 4"),
        (RATES_TOML + "5.0\nseconds = 0.0\n", r"line 5: \[rates\], seconds: expected greater than 0, got 0"),
        (RATES_TOML + "5.0\nacceleration_dps2 = -1\n", "acceleration_dps2: expected greater than 0"),
        ("rates = 5\n", "line 1: rates: expected"),
        ("[faces]\nseconds = nan\n", "seconds: expected a finite number"),
        ("[turns]\nangle_deg = 0.0\n", "must not be 0"),
        ("[faces]\n[temperatures]\nset_points_c = [30.0, 20.0]\n", "temperatures must increase"),
        ("[protocol]\nname = 'x'\n", "rates and turns"),
        ("[faces]\nsecond = 3.0\n", "second"),
        ("[temperatures]\nset_points_c = []\n", "set_points_c"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "p.toml").write_text(text)
    with pytest.raises(FileFormatError, match=told):
        read_protocol(tmp_path / "p.toml")
