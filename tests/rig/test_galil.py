"""The Galil rig against a card that believes everything, and then answers badly."""

import contextlib
import math
import re
from dataclasses import replace

import pytest

from testkit.cards import Card
from testkit.scripted_server import Scripted, VirtualScripted
from testkit.virtual_clock import VirtualClock
from undrift.errors import InputError, LimitError, LinkError, RigFault, RigTimeout
from undrift.rig import galil as axis_module
from undrift.rig.galil import GalilCard, GalilRig, open_from
from undrift.rig.link import LinkSettings
from undrift.rig.rig import Limits, RigSettings

DEGREE = math.pi / 180.0
PATIENT = LinkSettings(reply_timeout_s=30.0, connect_timeout_s=30.0)
QUICK = LinkSettings(reply_timeout_s=0.3, connect_timeout_s=0.5)
SAFE = "The table was stopped and its motor switched off."
LOST = "NOT CONFIRMED"


class Bench:
    """A rig on a scripted card."""

    def __init__(self, **settings) -> None:
        self.card = Card()
        self.clock = VirtualClock()
        self.server = VirtualScripted(self.card, self.clock)
        self.port = GalilCard(self.server.url, replace(PATIENT, clock=self.clock))
        self.rig = GalilRig(self.port, RigSettings(clock=self.clock, **settings))
        self.server.heard.clear()

    def expect_silence(self) -> None:
        self.port.settings = replace(
            self.port.settings, reply_timeout_s=QUICK.reply_timeout_s, connect_timeout_s=QUICK.connect_timeout_s
        )

    @property
    def sent(self) -> list[str]:
        """What was told, without questions."""
        return [
            line
            for line in self.server.heard
            if not line.startswith(("MG", "TP", "TE", "TS", "SC")) and "?" not in line
        ]

    def __enter__(self):
        return self

    def __exit__(self, *failure):
        with contextlib.suppress(LinkError):
            self.rig.close()
        self.server.close()


@pytest.fixture
def bench():
    with Bench() as bench:
        yield bench


def test_opening_a_rig_moves_nothing_and_sets_what_is_read_later():
    card = Card()
    with Scripted(card) as server:
        GalilRig(GalilCard(server.url, PATIENT), RigSettings(limits=Limits(travel=math.pi))).close()
        told = [line for line in server.heard if "?" not in line and not line.startswith(("MG", "TP", "SC", "TS"))]
    settings = ["EO 0", "ER 556", "OE 1", "AC 256000", "DC 256000", "FL 20000", "BL -20000"]
    assert told[:8] == [*settings, "STX"]
    assert told[-1] == "MOX"
    assert "BGX" not in server.heard


def test_a_table_left_turning_by_a_dead_program_is_stopped_on_opening():
    card = Card()
    card.moving = 3
    with Scripted(card) as server:
        GalilRig(GalilCard(server.url, PATIENT)).close()
        assert "STX" in server.heard[: server.heard.index("ER 556")]


def test_the_motor_is_switched_on_and_off_and_asked(bench):
    bench.rig.enable(True)
    bench.rig.enable(False)
    assert bench.server.heard == ["SHX", "MG _MOX", "MG _BGX", "MOX", "MG _MOX"]


def test_a_motor_that_stays_off_is_a_fault(bench):
    bench.card.spoil("SHX", b":")
    with pytest.raises(RigFault, match="did not switch on"):
        bench.rig.enable(True)


@pytest.mark.parametrize(("wanted", "speed", "distance"), [(90.0, 10_000, 29_609), (-0.1, 12, -36), (5.0, 556, 1667)])
def test_turn_for_is_one_finite_move_of_rounded_numbers(bench, wanted, speed, distance):
    achieved = bench.rig.turn_for(wanted * DEGREE, 3.0)  # speed (3 s - speed / 256000)
    assert achieved / DEGREE == pytest.approx(math.copysign(speed * 0.009, wanted), rel=1e-12)
    told = ["MG _BGX", f"SP {speed}", "SP ?", f"PR {distance}", "PR ?", "BGX"]
    assert bench.server.heard == told


@pytest.mark.parametrize(("word", "lost"), [("SP", r"\d$"), ("PR", r"\d$"), ("PR", "-")])
def test_turn_for_begins_nothing_if_a_number_is_not_read_back(bench, word, lost):
    def poor_line(command):
        return bench.card(re.sub(lost, "", command) if re.match(word + " -?\\d", command) else command)

    bench.server._answer = poor_line
    with pytest.raises(LinkError, match=f"set {word} to .*, but the card returned"):
        bench.rig.turn_for(-1.0, 2.0)
    assert bench.card.moving == 0
    assert "BGX" not in bench.sent


def test_an_acceleration_is_a_multiple_of_1024_for_run_up_and_slow_down(bench):
    achieved = bench.rig.set_acceleration(40.0)
    assert bench.sent == ["AC 254976", "DC 254976"]
    assert achieved == pytest.approx(254_976 * 2 * math.pi / 40_000, rel=1e-12)


def test_a_move_is_refused_while_another_runs(bench):
    bench.card.moving = 9
    with pytest.raises(RigFault, match="still moves"):
        bench.rig.turn_for(1.0, 2.0)
    assert bench.sent == []


def test_the_following_error_is_te_in_radians(bench):
    bench.card.held["TE"] = "-4"
    assert bench.rig.following_error() / DEGREE == pytest.approx(-0.036)


def test_faults_are_said_in_words(bench):
    assert bench.rig.fault() is None
    bench.rig.enable(True)
    bench.card.held.update(TS="104", SC="8")
    assert bench.rig.fault() == (
        "the motor is off though it was switched on; the following error is beyond its limit; the reverse limit switch is "
        "pressed; switched off because the following error passed its limit (stop code 8)"
    )


@pytest.mark.parametrize(
    "told",
    [
        lambda rig: rig.turn_for(7.0, 0.4),
        lambda rig: rig.turn_for(math.nan, 1.0),
        lambda rig: rig.turn_for(1e-5, 1.0),
        lambda rig: rig.turn_for(0.0, 1.0),
        lambda rig: rig.turn_for(1.0, 4.0),
        lambda rig: rig.turn_for(1.0, 0.01),
        lambda rig: rig.set_acceleration(1e4),
        lambda rig: rig.set_acceleration(-1.0),
    ],
)
def test_what_goes_beyond_a_limit_is_refused_before_a_byte_is_sent(told):
    with Bench(limits=Limits(travel=math.pi)) as bench:
        with pytest.raises(LimitError):
            told(bench.rig)
        assert bench.server.heard == []


def test_a_second_turn_counts_from_where_the_first_ended():
    with Bench(limits=Limits(travel=math.pi)) as bench:
        bench.rig.turn_for(1.0, 2.0)
        bench.clock.wait(3.0)
        bench.rig.stop()
        with pytest.raises(LimitError, match="travel"):
            bench.rig.turn_for(1.0, 2.0)
        bench.rig.turn_for(-1.0, 4.0)


def test_a_refused_command_is_a_fault_with_its_code(bench):
    bench.card.refused["BGX"] = 20
    with pytest.raises(RigFault, match=r"'BGX' .error 20") as refused:
        bench.rig.turn_for(1.0, 2.0)
    assert refused.value.code == 20


STEPS = {
    "identify": (lambda rig: rig.identify(), "\x12\x16"),
    "enable": (lambda rig: rig.enable(True), "SHX"),
    "acceleration": (lambda rig: rig.set_acceleration(40.0), "AC ?"),
    "turn": (lambda rig: rig.turn_for(1.0, 2.0), "SP ?"),
    "begin": (lambda rig: rig.turn_for(1.0, 2.0), "BGX"),
    "distance": (lambda rig: rig.turn_for(1.0, 2.0), "PR ?"),
    "poll": (lambda rig: rig.stop(), "MG _BGX"),
    "stop": (lambda rig: rig.stop(), "STX"),
    "position": (lambda rig: rig.position(), "MG _TPX"),
    "error": (lambda rig: rig.following_error(), "MG _TEX"),
    "fault": (lambda rig: rig.fault(), "TSX"),
}
BAD = {
    "silence": (None, RigTimeout),
    "half a reply": (b" 00", RigTimeout),
    "garbage": (b"\x07gar\r\n:", LinkError),
    "two prompts of another": (b" 1\r\n 2\r\n:", LinkError),
    "no text": (b"\xe9\xff\r\n:", LinkError),
}


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("step", STEPS)
def test_a_bad_answer_at_any_step_stops_the_table_and_says_so(bench, step, bad):
    does, command = STEPS[step]
    answer, error = BAD[bad]
    bench.card.polls = 3
    bench.card.spoil(command, answer)
    if error is RigTimeout:
        bench.expect_silence()
    with pytest.raises(error) as raised:
        does(bench.rig)
    assert str(raised.value).endswith(SAFE)
    assert bench.server.heard[-3:] == ["MG _BGX", "MOX", "MG _MOX"]
    assert bench.card.held["MO"] == "1"
    assert bench.card.moving == 0


def test_a_stop_that_does_not_stop_becomes_an_abort(bench, monkeypatch):
    monkeypatch.setattr(axis_module, "STOP_MARGIN_S", 0.0)
    bench.card.polls = 10_000
    bench.rig.turn_for(1.0, 2.0)
    bench.card.spoil("STX", *[b":"] * 5)
    with pytest.raises(RigTimeout, match=f"still moving after .* {SAFE}"):
        bench.rig.stop()
    assert "AB" in bench.sent


def test_a_card_that_is_silent_for_good_is_shouted_at_and_reported_unconfirmed(bench):
    bench.server._answer = lambda command: None
    bench.expect_silence()
    with pytest.raises(RigTimeout, match=LOST):
        bench.rig.turn_for(1.0, 2.0)
    assert bench.server.heard[-4:] == ["STX", "AB", "MOX", "MOX"]
    with pytest.raises(LinkError, match=r"not be brought to rest"):
        bench.rig.turn_for(1.0, 2.0)
    with pytest.raises(LinkError, match=f"no answer .* {LOST}"):
        bench.rig.close()
    bench.rig.close()


def test_a_link_that_is_lost_is_opened_again_to_stop_the_table(bench):
    bench.rig.enable(True)
    bench.server.hang_up()
    with pytest.raises(LinkError, match=SAFE):
        bench.rig.turn_for(1.0, 2.0)
    assert bench.card.held["MO"] == "1"
    with pytest.raises(LinkError, match="the connection was lost"):
        bench.rig.turn_for(1.0, 2.0)


def test_a_link_that_is_lost_for_good_is_reported_unconfirmed(bench):
    bench.server.refuse_from_now_on()
    bench.expect_silence()
    with pytest.raises(LinkError, match=LOST):
        bench.rig.position()


def test_a_position_that_no_axis_can_have_reached_is_no_position(bench):
    bench.card.held["TP"] = "400000"
    with pytest.raises(LinkError, match="got 400000"):
        bench.rig.position()


def test_a_rig_is_closed_once_and_refuses_afterwards(bench):
    bench.rig.close()
    heard = len(bench.server.heard)
    bench.rig.close()
    assert len(bench.server.heard) == heard
    with pytest.raises(LinkError, match="it is closed"):
        bench.rig.turn_for(1.0, 2.0)


def test_what_does_not_answer_like_a_card_is_not_opened():
    with (
        Scripted(lambda command: b"hello\r\n") as server,
        pytest.raises(RigTimeout, match="no answer to 'MG 41003'"),
    ):
        GalilRig(GalilCard(server.url, QUICK))


def test_an_axis_that_no_card_has_is_refused():
    with pytest.raises(InputError, match=r"axis .*, got 'Q'"):
        open_from("tcp://127.0.0.1:9", RigSettings(axis="Q"))
