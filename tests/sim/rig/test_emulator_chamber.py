"""The emulated chamber: its air by its own equations, its language by the letter, its faults on command."""

import math
import socket

import numpy as np
import pytest

from undrift.base.clock import Clock, VirtualClock
from undrift.errors import InputError
from undrift.sim.rig.emulator import Air, AirSettings, EmulatedChamber


def heated(settings: AirSettings, to_c: float, duration_s: float) -> tuple[np.ndarray, np.ndarray]:
    air = Air(settings)
    air.set_point, air.on = to_c, True
    air.advance(duration_s)
    return air.at(np.arange(0.0, duration_s, 1.0))


def test_the_air_climbs_at_the_ramp_and_overshoots_by_its_damping():
    air, _ = heated(AirSettings(ramp_c_per_min=2.0, period_s=60.0), 45.0, 1500.0)
    assert 60.0 * np.diff(air)[200:500] == pytest.approx(2.0, abs=1e-3)
    assert air[-1] == pytest.approx(45.0, abs=1e-4)
    step, _ = heated(AirSettings(ramp_c_per_min=1e6, period_s=60.0, damping=0.5), 35.0, 600.0)
    wanted = 10.0 * math.exp(-math.pi * 0.5 / math.sqrt(1.0 - 0.25))  # a second-order step's
    assert step.max() - 35.0 == pytest.approx(wanted, rel=0.01)


def test_the_board_follows_with_its_lag():
    air, board = heated(AirSettings(ramp_c_per_min=2.0, period_s=20.0, board_lag_s=90.0), 65.0, 1100.0)
    assert (air - board)[900:1000] == pytest.approx(2.0 / 60.0 * 90.0, rel=1e-3)  # ramp times lag


def test_the_air_does_not_depend_on_how_often_one_looks():
    once, often = Air(AirSettings()), Air(AirSettings())
    for air in (once, often):
        air.set_point, air.on = 50.0, True
    once.advance(500.0)
    for time in np.linspace(0.0, 500.0, 777):
        often.advance(float(time))
    assert once.temp == often.temp
    assert once.board == often.board


def test_a_chamber_that_is_off_or_open_goes_to_the_room():
    air = Air(AirSettings(ramp_c_per_min=600.0, period_s=10.0))
    air.set_point, air.on = 60.0, True
    air.advance(600.0)
    air.door_open = True
    air.advance(660.0)
    assert air.temp[-1] == pytest.approx(25.0 + 35.0 * math.exp(-1.0), rel=1e-3)
    air.door_open = False
    air.advance(1500.0)
    assert air.temp[-1] == pytest.approx(60.0, abs=0.01)
    air.on = False
    air.advance(2700.0)
    assert air.temp[-1] == pytest.approx(25.0 + 35.0 * math.exp(-1.0), rel=1e-3)


def test_a_stuck_heater_creeps_away_from_where_it_was():
    air = Air(AirSettings(period_s=20.0))
    air.on = air.stuck = True
    air.set_point = 60.0
    air.advance(1200.0)
    assert air.temp[-1] == pytest.approx(25.0 + 0.5 * 20.0, abs=0.3)


@pytest.mark.parametrize("name", ["ramp_c_per_min", "period_s", "damping", "board_lag_s"])
def test_air_that_cannot_be_is_refused(name):
    with pytest.raises(InputError, match=rf"emulated chamber: wanted {name} above 0, got 0"):
        AirSettings(**{name: 0.0})


@pytest.fixture
def chamber():
    made = EmulatedChamber(AirSettings(), VirtualClock())
    try:
        yield made
    finally:
        made.close()
        made.close()


@pytest.mark.parametrize(
    ("said", "answer"),
    [
        ("*IDN?", "undrift,emulated chamber,0,1.0"),
        ("TEMP:SPO 45.04;:TEMP:SPO?", "45.0"),
        ("temp:ramp 2;:temp:ramp?", "2.00"),
        ("MEAS:TEMP?", "25.00"),
        ("OUTP ON;:OUTP?", "1"),
        ("OUTP?;:SYST:ERR?", '0;0,"No error"'),
        ("TEMP:SPO 45", ""),
        ("TEMP:SPO 500;:SYST:ERR?", '-222,"Data out of range"'),
        ("TEMP:SPO warm;:SYST:ERR?;:TEMP:SPO?", '-104,"Data type error";25.0'),
        ("HELLO;:SYST:ERR?;:SYST:ERR?", '-113,"Undefined header";0,"No error"'),
        ("OUTP MAYBE;:SYST:ERR?", '-113,"Undefined header"'),
        ("TEMP:RAMP 0;:SYST:ERR?", '-222,"Data out of range"'),
        (";;", ""),
    ],
)
def test_each_command_is_answered_by_the_letter(chamber, said, answer):
    assert chamber.obey(said) == answer


def test_lines_come_whole_out_of_pieces_over_a_socket():
    chamber = EmulatedChamber(AirSettings(), Clock.started())
    try:
        with socket.create_connection((chamber.host, chamber.port), timeout=60.0) as link:
            for byte in b"TEMP:SPO 31\nTEMP:SPO?\r\n\xff\n":
                link.sendall(bytes([byte]))
            replies = link.makefile()
            assert replies.readline() == "31.0\n"
            link.sendall(b"SYST:ERR?\n")  # over the link too, so that it comes after the line that is no text
            assert replies.readline() == '-113,"Undefined header"\n'
    finally:
        chamber.close()


def test_random_lines_crash_nothing(chamber):
    rng = np.random.default_rng(3)
    for _ in range(2000):
        chamber.obey(bytes(rng.choice(list(b"TEMP:SPO?;OUT 1.5-e*IDNRA\t"), 20)).decode())
    assert chamber.obey("*IDN?").count(",") == 3


def test_a_fault_that_is_none_is_refused(chamber):
    with pytest.raises(InputError, match=r"chamber fault: wanted one of drop_bytes, .*, got 'fire'; name one of them"):
        chamber.inject("fire")
