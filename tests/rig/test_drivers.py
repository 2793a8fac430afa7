"""What every driver of a table promises: limits before a byte is sent, and a table at rest after whatever went wrong."""

import math

import pytest

from testkit.driver_bench import DriverBench
from undrift.errors import InputError, LimitError, LinkError, RigFault, RigTimeout
from undrift.rig.galil import GalilRig
from undrift.rig.grbl import GrblRig
from undrift.rig.rig import Limits, RigSettings

SAFE = {
    "galil": "The table was stopped and its motor switched off.",
    "grbl": "The table was stopped and its motor put to sleep.",
}
LOST = "NOT CONFIRMED"
BAD = {
    "galil": (("BGX", "PR ?"), (None, b" 00", b"\x07gar\r\n:", b" 1\r\n 2\r\n:", b"\xe9\xff\r\n:")),
    "grbl": (("$J=", "?"), (None, b"<Idle|MPos:0.0", b"gar\r\n<b>\r\nok\r\n", b"\xe9\xff<Idle|MPos:0.000>\r\nok\r\n")),
}


@pytest.fixture(params=SAFE)
def bench(request):
    with DriverBench(request.param) as bench:
        yield bench


@pytest.mark.parametrize("kind", SAFE)
@pytest.mark.parametrize(
    "told",
    [
        lambda rig: rig.turn_for(7.0, 0.4),
        lambda rig: rig.turn_for(math.nan, 1.0),
        lambda rig: rig.turn_for(1e-5, 1.0),
        lambda rig: rig.turn_for(1.0, 4.0),
        lambda rig: rig.turn_for(1.0, 0.01),
        lambda rig: rig.set_acceleration(1e4),
    ],
)
def test_command_beyond_a_limit_sends_no_byte(kind, told):
    with DriverBench(kind, limits=Limits(travel=math.pi)) as bench:
        with pytest.raises(LimitError):
            told(bench.rig)
        assert bench.server.heard == []


@pytest.mark.parametrize(
    ("kind", "command", "bad"),
    [(kind, command, bad) for kind, (commands, answers) in BAD.items() for command in commands for bad in answers],
)
def test_bad_answer_stops_the_table_and_says_so(kind, command, bad):
    with DriverBench(kind) as bench:
        bench.controller.polls = 3
        bench.controller.spoilt[command] = [bad]
        with pytest.raises((LinkError, RigTimeout)) as raised:
            bench.rig.turn_for(1.0, 2.0)
        assert str(raised.value).endswith(SAFE[kind])
        assert bench.at_rest()
        bench.rig.enable(True)  # it can go on


def test_silent_controller_is_reported_unconfirmed(bench):
    bench.server.answer = lambda command: None
    with pytest.raises(RigTimeout, match=LOST):
        bench.rig.turn_for(1.0, 2.0)
    with pytest.raises(LinkError, match=LOST):
        bench.rig.close()
    bench.rig.close()
    with pytest.raises(LinkError):
        bench.rig.turn_for(1.0, 2.0)


def test_lost_link_is_opened_again_to_stop_the_table(bench):
    bench.rig.enable(True)
    bench.server.hang_up()
    with pytest.raises(LinkError, match=SAFE[bench.kind]):
        bench.rig.position()
    assert bench.at_rest()
    bench.server.refuse_from_now_on()
    with pytest.raises(LinkError, match=LOST):
        bench.rig.close()


def test_position_that_no_axis_can_have_reached_is_refused(bench):
    if bench.kind == "galil":
        bench.controller.held["TP"] = "400000"
    else:
        bench.rig.position()
        bench.controller.spoilt["?"] = [b"<Idle|MPos:-20000000.000|FS:0,0>\r\n"]
    with pytest.raises(LinkError, match=r"got (400000|-2e\+07)"):
        bench.rig.position()


@pytest.mark.parametrize(
    ("kind", "command", "refusal", "code"), [("galil", "BGX", b"?", 20), ("grbl", "$J=", b"error:15\r\n", 15)]
)
def test_refused_move_is_a_fault_with_its_code(kind, command, refusal, code):
    with DriverBench(kind) as bench:
        bench.controller.code = code
        bench.controller.spoilt[command] = [refusal]
        with pytest.raises(RigFault) as refused:
            bench.rig.turn_for(1.0, 2.0)
        assert refused.value.code == code


@pytest.mark.parametrize(("kind", "rig"), [("galil", GalilRig), ("grbl", GrblRig)])
def test_nobody_there_and_an_axis_that_is_none_are_refused(kind, rig):
    with pytest.raises(RigTimeout, match="no answer"):
        DriverBench(kind, lambda command: None, reply_timeout_s=0.2)
    with pytest.raises(InputError, match=r"axis .*, got 'Q'"):
        rig("tcp://127.0.0.1:9", RigSettings(axis="Q"))
