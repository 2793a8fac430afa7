"""The GRBL rig against a scripted board: dialogues of the 1.1 interface, every error, and bad answers."""

import math

import pytest

from testkit.cards import Board
from testkit.driver_bench import DriverBench
from undrift.errors import LinkError, RigFault

DEGREE = math.pi / 180.0
SAFE = "The table was stopped and its motor put to sleep."


@pytest.fixture
def bench():
    with DriverBench("grbl") as bench:
        yield bench


def test_opening_resets_reads_the_settings_and_moves_nothing():
    board = Board()
    with DriverBench("grbl", board) as bench:
        assert bench.rig.identify() == "Grbl 1.1h ['$' for help]; VER:1.1h.20190830:; OPT:V,15,128"
        assert board.jogs == []


def test_turn_for_is_one_jog_of_whole_steps_that_stop_cancels(bench):
    assert bench.rig.turn_for(-45.0 * DEGREE, 4.0) / DEGREE == pytest.approx(-45.0)
    bench.clock.wait(3.0)
    bench.rig.stop()
    # 45 deg/s for 4 s less a run-up of 45 ms at 1000 deg/s2, in steps of 1 / 8.889 deg
    assert bench.controller.jogs == [(pytest.approx(-1582 / 8.889, abs=1e-5), 2700.0)]
    assert "\x85" in bench.server.heard


def test_an_acceleration_is_stored_and_listed(bench):
    assert bench.rig.set_acceleration(2.0) / DEGREE == pytest.approx(114.592)
    assert "$120=114.592" in bench.server.heard
    bench.controller.spoilt["$120="] = [b"ok\r\n"]
    with pytest.raises(LinkError, match=r"set \$120=57.296, .* returned 114.592.*" + SAFE):
        bench.rig.set_acceleration(1.0)


def test_an_axis_of_several_has_its_own_settings_and_place():
    board = Board()
    board.settings["103"] = "20.000"
    with DriverBench("grbl", board) as bench:
        board.spoilt["?"] = [b"<Idle|MPos:1.000,2.000,3.000,0.500|FS:0,0>\r\n"]
        assert bench.rig.position().angle / DEGREE == pytest.approx(0.5)
        bench.rig.turn_for(45.0 * DEGREE, 2.0)
        assert board.jogs[-1][0] == pytest.approx(1760 / 20.0)  # 45 deg/s for 2 s minus a ramp of 45 ms, in steps


def test_the_motor_sleeps_and_wakes_and_our_own_alarm_is_cleared(bench):
    bench.rig.enable(True)
    bench.rig.enable(False)
    assert bench.controller.state == "Sleep"
    bench.rig.enable(True)
    assert bench.controller.state == "Idle"
    assert bench.rig.fault() is None
    bench.controller.state = "Sleep"
    assert bench.rig.fault() == "the motor is asleep though it was switched on"


def test_an_alarm_that_is_not_ours_stays_for_a_person():
    board = Board()
    board.state = board.wakes_to = "Alarm"
    with DriverBench("grbl", board) as bench:
        assert bench.rig.fault() == "an alarm"
        with pytest.raises(RigFault, match="expected state Idle, got an alarm"):
            bench.rig.enable(True)
        assert "$X" not in bench.server.heard


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("<Flying|MPos:0.000>", "expected a status line"),
        ("<Idle|MPos:0>", "expected a status line"),
        ("<Idle|WPos:1.000|FS:0,0>", "reports work positions"),
        ("<Idle|MPos:1.000,2.000|FS:0,0>", "axis A among the 2 positions"),
    ],
)
def test_a_status_without_a_place_is_refused(bench, line, text):
    bench.controller.spoilt["?"] = [f"{line}\r\n".encode()]
    with pytest.raises(LinkError, match=text):
        bench.rig.position()


@pytest.mark.parametrize("text", ["0.000", "many"])
def test_steps_that_are_none_are_refused_on_opening(text):
    board = Board()
    board.settings["100"] = text
    with pytest.raises(LinkError, match=rf"\$100 must be positive, got {text}"):
        DriverBench("grbl", board)


def test_open_safety_door_is_a_fault_and_the_jog_is_refused(bench):
    bench.controller.state = "Door"
    assert "safety door" in bench.rig.fault()
    with pytest.raises(RigFault, match="error 9"):
        bench.rig.turn_for(1.0, 2.0)
