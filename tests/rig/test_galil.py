"""The Galil rig against a card that believes everything, and then answers badly."""

import math
import re

import pytest

from testkit.cards import Card
from testkit.driver_bench import DriverBench
from testkit.scripted_server import Scripted, transcript
from testkit.virtual_clock import VirtualClock
from undrift.errors import LimitError, LinkError, RigFault, RigTimeout
from undrift.rig import link as link_module
from undrift.rig.galil import GalilRig
from undrift.rig.rig import Limits, RigSettings, in_words

DEGREE = math.pi / 180.0
SAFE = "The table was stopped and its motor switched off."


@pytest.fixture
def bench():
    with DriverBench("galil") as bench:
        yield bench


# ---- Commands and their answers


class Unprepared(GalilRig):
    def _prepare(self, settings):
        pass


def talk(answer, axis="X"):
    """Return the rig of a card behind a scripted server, before any question."""
    clock = VirtualClock()
    return Unprepared(Scripted(answer, clock).url, RigSettings(axis=axis, reply_timeout_s=20.0, clock=clock))


# dmc1700 manual, chapter 5: lower case is refused and TC1 says why; dmc2x00 chapter 5: PR and its question
MANUAL = [
    ("bg", b"?"),
    ("TC1", b"1 Unrecognized command\r\n:"),
    ("PR 1000", b":"),
    ("PR ?", b" 1000\r\n:"),
    ("MG _TPX{F10.0}", b" 0000012345\r\n:"),
    ("BGX", b":"),
    ("MG _BGX", b" 1.0000\r\n:"),
    ("MG _TEX{F10.0}", b"-0000000004\r\n:"),
    ("SCX", b" 001\r\n:"),
]


def test_dialogue_of_the_manual_is_understood():
    answer, wrong = transcript(MANUAL)
    card = talk(answer)
    with pytest.raises(RigFault, match=r"error 1:") as refused:
        card.ask("bg")
    assert refused.value.code == 1
    assert card.set("PR", 1000) == 1000
    assert card.read("position") == 12345.0
    card.ask("BGX")
    assert card.read("is moving") == 1.0
    assert card.read("following error") == -4.0
    assert card.read("stop code") == 1.0
    assert wrong == []


def test_other_axes_have_commas_and_letters():
    answer, wrong = transcript([("SP ,,500", b":"), ("SP ,,?", b" 500\r\n:"), ("MG _BGC", b" 0.0000\r\n:")])
    card = talk(answer, axis="C")
    assert card.set("SP", 500) == 500
    assert card.read("is moving") == 0.0
    assert wrong == []


def test_codes_have_words():
    assert "motor on" in in_words("galil_error", 20)
    assert "not listed" in in_words("galil_stop", 999)


@pytest.mark.parametrize(
    ("question", "answer"),
    [
        ("position", b":"),
        ("position", b" 000000021\r\n:"),  # a digit is lost
        ("position", b" 0000000021\r\n 1\r\n:"),
        ("position", b" 0000000021\r\n?"),
        ("position", b"\xc3\xa9\r\n:"),
        ("kp", b" nan\r\n:"),
        ("is moving", b" 0.5000\r\n:"),
        ("switches", b" 256\r\n:"),
        ("stop code", b"?"),  # also to TC1
    ],
)
def test_answer_of_another_form_is_never_a_number(question, answer):
    with pytest.raises(LinkError, match=r"not an answer to|is not text"):
        talk(lambda command: answer).read(question)


def test_resynchronising_discards_late_answers():
    clock = VirtualClock()
    server = Scripted(Card(), clock)
    card = Unprepared(server.url, RigSettings(clock=clock))
    server.line.say(b" 1\r\n: 2\r\n:?")
    card._resynchronise()
    assert card.read("is off") == 1.0


# ---- The rig


def test_opening_moves_nothing_and_sets_limits():
    with DriverBench("galil", limits=Limits(travel=math.pi)) as bench:
        told = [line for line in bench.opening if "?" not in line and not line.startswith(("MG", "TP", "SC", "TS"))]
        assert told == ["EO 0", "ER 556", "OE 1", "AC 256000", "DC 256000", "FL 20000", "BL -20000"]
        bench.rig.close()
        assert "STX" in bench.server.heard
        assert bench.server.heard[-2:] == ["MOX", "MG _MOX"]


def test_table_left_turning_is_stopped_on_opening():
    card = Card()
    card.moving = 3
    with DriverBench("galil", card) as bench:
        assert "STX" in bench.opening[: bench.opening.index("ER 556")]


def test_motor_is_switched_and_asked(bench):
    bench.rig.enable(True)
    bench.rig.enable(False)
    assert bench.server.heard == ["MG _BGX", "SHX", "MG _MOX", "MG _BGX", "MOX", "MG _MOX"]
    bench.controller.spoilt["SHX"] = [b":"]
    with pytest.raises(RigFault, match="did not switch on"):
        bench.rig.enable(True)


@pytest.mark.parametrize(("wanted", "speed", "distance"), [(90.0, 10_000, 29_609), (-0.1, 12, -36)])
def test_turn_is_one_finite_move_of_rounded_numbers(bench, wanted, speed, distance):
    achieved = bench.rig.turn_for(wanted * DEGREE, 3.0)  # speed (3 s - speed / 256000)
    assert achieved / DEGREE == pytest.approx(math.copysign(speed * 0.009, wanted), rel=1e-12)
    assert bench.server.heard == ["MG _BGX", f"SP {speed}", "SP ?", f"PR {distance}", "PR ?", "BGX"]


@pytest.mark.parametrize(("word", "lost"), [("SP", r"\d$"), ("PR", r"\d$"), ("PR", "-")])
def test_turn_starts_nothing_if_a_number_is_not_read_back(bench, word, lost):
    def poor_line(command):
        return bench.controller(re.sub(lost, "", command) if re.match(word + " -?\\d", command) else command)

    bench.server.answer = poor_line
    with pytest.raises(LinkError, match=f"set {word} to"):
        bench.rig.turn_for(-1.0, 2.0)
    assert bench.controller.moving == 0
    assert "BGX" not in bench.server.heard


def test_acceleration_is_a_multiple_of_1024_for_both_ramps(bench):
    assert bench.rig.set_acceleration(40.0) == pytest.approx(254_976 * 2 * math.pi / 40_000, rel=1e-12)
    assert (bench.controller.held["AC"], bench.controller.held["DC"]) == ("254976", "254976")


def test_move_is_refused_while_another_runs(bench):
    bench.controller.moving = 9
    with pytest.raises(RigFault, match="still moves"):
        bench.rig.turn_for(1.0, 2.0)
    assert bench.server.heard == ["MG _BGX"]


def test_faults_are_named(bench):
    assert bench.rig.fault() is None
    bench.rig.enable(True)
    bench.controller.held.update(TS="104", SC="8")
    fault = bench.rig.fault()
    for text in ("motor is off", "following error", "reverse limit switch", "stop code 8"):
        assert text in fault


def test_travel_counts_from_the_start():
    with DriverBench("galil", limits=Limits(travel=math.pi)) as bench:
        bench.rig.turn_for(1.0, 2.0)
        bench.clock.wait(3.0)
        bench.rig.stop()
        with pytest.raises(LimitError, match="travel"):
            bench.rig.turn_for(1.0, 2.0)
        bench.rig.turn_for(-1.0, 4.0)


def test_stop_that_does_not_stop_becomes_an_abort(bench, monkeypatch):
    monkeypatch.setattr(link_module, "STOP_MARGIN_S", 0.0)
    bench.controller.polls = 10_000
    bench.rig.turn_for(1.0, 2.0)
    bench.controller.spoilt["STX"] = [*[b":"] * 5]
    with pytest.raises(RigTimeout, match=f"still moving after .* {SAFE}"):
        bench.rig.stop()
    assert "AB" in bench.server.heard
