"""The GRBL rig against a scripted board: dialogues of the 1.1 interface, every error, and bad answers."""

import contextlib
import math

import pytest

from testkit.cards import Board
from testkit.scripted_server import VirtualScripted
from testkit.virtual_clock import VirtualClock
from undrift.errors import InputError, LimitError, LinkError, RigFault, RigTimeout
from undrift.rig.grbl import GrblBoard, GrblRig, open_from
from undrift.rig.rig import Limits, RigSettings

DEGREE = math.pi / 180.0
SAFE = "The table was stopped and its motor put to sleep."
LOST = "NOT CONFIRMED"


class Bench:
    def __init__(self, board: Board | None = None, timeout_s: float = 20.0, **settings) -> None:
        self.board = board or Board()
        self.clock = VirtualClock()
        self.server = VirtualScripted(self.board, self.clock, terminator=b"\n", at_once="?!~\x18\x85")
        self.link = GrblBoard(self.server.url, reply_timeout_s=timeout_s, clock=self.clock)
        try:
            self.rig = GrblRig(self.link, RigSettings(clock=self.clock, **settings))
        except BaseException:
            self.server.close()
            raise
        self.server.heard.clear()

    def __enter__(self):
        return self

    def __exit__(self, *failure):
        with contextlib.suppress(LinkError):
            self.rig.close()
        self.server.close()

    def grow_impatient(self) -> None:
        """Let answers be due soon from now on, so that those which never come are not waited for."""
        self.link.reply_timeout_s = 0.5


@pytest.fixture
def bench():
    with Bench() as bench:
        yield bench


def test_opening_resets_reads_the_settings_and_moves_nothing():
    board = Board()
    with Bench(board) as bench:
        assert bench.rig.identify() == "Grbl 1.1h ['$' for help]; VER:1.1h.20190830:; OPT:V,15,128"
        assert board.jogs == []


def test_turn_for_is_one_jog_of_whole_steps_that_stop_cancels(bench):
    assert bench.rig.turn_for(-45.0 * DEGREE, 4.0) / DEGREE == pytest.approx(-45.0)
    bench.clock.wait(3.0)
    bench.rig.stop()
    # 45 deg/s for 4 s less a run-up of 45 ms at 1000 deg/s2, in steps of 1 / 8.889 deg
    assert bench.board.jogs == [(pytest.approx(-1582 / 8.889, abs=1e-5), 2700.0)]
    assert "\x85" in bench.server.heard


def test_an_acceleration_is_stored_and_listed(bench):
    assert bench.rig.set_acceleration(2.0) / DEGREE == pytest.approx(114.592)
    assert "$120=114.592" in bench.server.heard
    bench.board.spoilt["$120="] = [b"ok\r\n"]
    with pytest.raises(LinkError, match=r"set \$120=57.296, .* returned 114.592.*" + SAFE):
        bench.rig.set_acceleration(1.0)


def test_an_axis_of_several_has_its_own_settings_and_place():
    board = Board()
    board.settings["103"] = "20.000"
    with Bench(board) as bench:
        board.spoilt["?"] = [b"<Idle|MPos:1.000,2.000,3.000,0.500|FS:0,0>\r\n"]
        assert bench.rig.position().angle / DEGREE == pytest.approx(0.5)
        bench.rig.turn_for(45.0 * DEGREE, 2.0)
        assert board.jogs[-1][0] == pytest.approx(1760 / 20.0)  # 45 deg/s for 2 s minus a ramp of 45 ms, in steps


def test_the_motor_sleeps_and_wakes_and_our_own_alarm_is_cleared(bench):
    bench.rig.enable(True)
    bench.rig.enable(False)
    assert bench.board.state == "Sleep"
    bench.rig.enable(True)
    assert bench.board.state == "Idle"
    assert bench.rig.fault() is None
    bench.board.state = "Sleep"
    assert bench.rig.fault() == "the motor is asleep though it was switched on"


def test_an_alarm_that_is_not_ours_stays_for_a_person():
    board = Board()
    board.state = board.wakes_to = "Alarm"
    with Bench(board) as bench:
        assert bench.rig.fault() == "an alarm"
        with pytest.raises(RigFault, match="expected state Idle, got an alarm"):
            bench.rig.enable(True)
        assert "$X" not in bench.server.heard


@pytest.mark.parametrize(
    "told",
    [
        lambda rig: rig.turn_for(7.0, 0.4),
        lambda rig: rig.turn_for(1e-4, 1.0),
        lambda rig: rig.turn_for(1.0, 4.0),
        lambda rig: rig.turn_for(1.0, 0.01),
        lambda rig: rig.set_acceleration(1e4),
    ],
)
def test_what_goes_beyond_a_limit_is_refused_before_a_byte_is_sent(told):
    with Bench(limits=Limits(travel=math.pi)) as bench:
        with pytest.raises(LimitError):
            told(bench.rig)
        assert bench.server.heard == []


@pytest.mark.parametrize(
    "bad", [None, b"<Idle|MPos:0.0", b"gar\r\n<b>\r\nok\r\n", b"\xe9\xff<Idle|MPos:0.000>\r\nok\r\n"]
)
@pytest.mark.parametrize("command", ["$J=", "?"])
def test_bad_answer_stops_the_table_and_says_so(bench, command, bad):
    bench.grow_impatient()
    bench.board.spoilt[command] = [bad]
    with pytest.raises((LinkError, RigTimeout)) as raised:
        bench.rig.turn_for(1.0, 2.0)
    assert str(raised.value).endswith(SAFE)
    assert bench.board.state == "Sleep"
    bench.rig.enable(True)
    assert bench.rig.fault() is None


def test_a_board_that_is_silent_for_good_is_reported_unconfirmed(bench):
    bench.grow_impatient()
    bench.server._answer = lambda command: None
    with pytest.raises(RigTimeout, match=LOST):
        bench.rig.position()
    with pytest.raises(LinkError, match=f"no answer .* {LOST}"):
        bench.rig.close()
    bench.rig.close()
    with pytest.raises(LinkError, match="it is closed"):
        bench.rig.turn_for(1.0, 2.0)


def test_a_link_that_is_lost_is_opened_again_to_stop_the_table(bench):
    bench.server.hang_up()
    with pytest.raises(LinkError, match=SAFE):
        bench.rig.position()
    assert bench.board.state == "Sleep"


@pytest.mark.parametrize("line", ["<Flying|MPos:0.000>", "<Idle|MPos:0>"])
def test_what_is_no_status_is_refused(bench, line):
    bench.board.spoilt["?"] = [f"{line}\r\n".encode()]
    with pytest.raises(LinkError, match="expected a status line"):
        bench.rig.position()


def test_a_status_of_work_positions_is_no_place(bench):
    bench.board.spoilt["?"] = [b"<Idle|WPos:1.000|FS:0,0>\r\n"]
    with pytest.raises(LinkError, match=r"reports work positions"):
        bench.rig.position()
    bench.board.spoilt["?"] = [b"<Idle|MPos:1.000,2.000|FS:0,0>\r\n"]
    with pytest.raises(LinkError, match="axis A among the 2 positions"):
        bench.rig.position()


@pytest.mark.parametrize("text", ["0.000", "many"])
def test_steps_that_are_none_are_refused_on_opening(text):
    board = Board()
    board.settings["100"] = text
    with pytest.raises(LinkError, match=rf"\$100 must be positive, got {text}"):
        Bench(board)


def test_a_silent_port_is_a_timeout_and_an_axis_must_be_one():
    with pytest.raises(RigTimeout, match="no answer to"):
        Bench(lambda command: None, timeout_s=0.2)
    with pytest.raises(InputError, match=r"grbl: axis .*, got 'Q'"):
        open_from("tcp://127.0.0.1:9", RigSettings(axis="Q"))


def test_a_position_that_no_axis_can_have_reached_is_garbage(bench):
    bench.rig.position()
    bench.board.spoilt["?"] = [b"<Idle|MPos:-20000000.000|FS:0,0>\r\n"]
    with pytest.raises(LinkError, match=r"within [\d.]+ deg of 0, got -2e\+07.*" + SAFE):
        bench.rig.position()
    bench.rig.enable(True)
    assert bench.rig.position().angle == 0.0


def test_refused_jog_is_a_fault_with_its_code(bench):
    bench.board.spoilt["$J="] = [b"error:15\r\n"]
    with pytest.raises(RigFault) as refused:
        bench.rig.turn_for(1.0, 2.0)
    assert refused.value.code == 15
    bench.board.state = "Door"
    with pytest.raises(RigFault, match="safety door"):
        bench.rig.turn_for(1.0, 2.0)
