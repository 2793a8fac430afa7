"""The stepper board: transcripts, motion, alarms, error codes, faults; a clock moved by hand."""

import math
import random

import numpy as np
import pytest

from testkit.data import show
from testkit.emulated_axis import present
from undrift.base.clock import VirtualClock
from undrift.errors import InputError
from undrift.sim.rig.grbl import GrblMachine, GrblSettings


class Bench:
    """A board and one client, with emulated time in hand."""

    def __init__(self, **settings):
        self.clock = VirtualClock()
        self.machine = GrblMachine(GrblSettings(**settings), self.clock)
        self.session = self.machine.open_session(serial=True)

    def say(self, text, wait_s=0.0):
        self.clock.wait(wait_s)
        data = text.encode("latin-1") if isinstance(text, str) else text
        return b"".join(self.session.feed(data)).decode()

    def angle_deg(self):
        return math.degrees(present(self.machine)[0])

    def rate_dps(self):
        return math.degrees(present(self.machine)[1])


def test_a_jog_runs_is_reported_and_ends_on_a_step():
    bench = Bench(ripple_deg=0.0)
    assert bench.session.greet() == b"\r\nGrbl 1.1h ['$' for help]\r\n"
    assert bench.say("?") == "<Idle|MPos:0.000,0.000,0.000,0.000|FS:0,0>\r\n"
    assert bench.say("$J=G91 A360 F5400\n") == "ok\r\n"
    bench.clock.wait(1.0)
    assert bench.say("?").startswith("<Jog|MPos:0.000,0.000,0.000,81.8")
    assert "|FS:5400,0>" in bench.say("?")
    assert bench.rate_dps() == pytest.approx(90.0, rel=2e-5)  # $103 is rounded to 8.889
    bench.clock.wait(5.0)
    assert (
        bench.say("?") == "<Idle|MPos:0.000,0.000,0.000,359.996|FS:0,0>\r\n"
    )  # 3200 steps of 1/8.889 deg, as $103 says
    assert bench.angle_deg() == pytest.approx(360.0, abs=1e-9)  # the shaft counts whole steps of 1.8/16 deg


def test_a_cancelled_jog_slows_down_and_forgets_what_waits():
    bench = Bench()
    bench.say("$J=G91A3600F5400\n$J=G91A100F5400\n")
    bench.clock.wait(2.0)
    assert bench.say(b"\x85") == ""
    assert bench.rate_dps() > 80.0
    bench.clock.wait(0.3)
    assert bench.rate_dps() == 0.0
    assert bench.say("?").startswith("<Idle|")
    at = bench.angle_deg()
    bench.clock.wait(5.0)
    assert bench.angle_deg() == at


def test_jogs_that_wait_follow_each_other():
    bench = Bench(ripple_deg=0.0)
    assert bench.say("$J=G91A9F5400\n$J=G91A-4.5F5400\n$J=G91A15.75F600\n") == "ok\r\nok\r\nok\r\n"
    bench.clock.wait(10.0)
    assert bench.angle_deg() == pytest.approx(20.25, abs=0.06)


def test_moves_the_same_way_join_without_a_rest_and_a_full_board_holds_its_answers_back():
    bench = Bench(ripple_deg=0.0)
    assert bench.say("$J=G91A9F5400\n" * 30) == "ok\r\n" * 16
    bench.clock.wait(1.0)
    assert bench.session.unasked() == b"ok\r\n" * 9  # 81 deg are behind it
    bench.clock.wait(0.5)
    assert bench.rate_dps() == pytest.approx(90.0, rel=2e-5)
    assert bench.session.unasked() == b"ok\r\n" * 5
    rates = np.degrees(bench.machine.states(np.linspace(0.2, 1.5, 500))[1])
    assert np.ptp(rates) < 1e-6
    bench.clock.wait(5.0)
    assert bench.angle_deg() == pytest.approx(270.0, abs=0.06)
    bench.say("$J=G91A9F5400\n$J=G91A9F1800\n")
    bench.clock.wait(0.25)
    assert bench.rate_dps() == pytest.approx(30.0, rel=2e-5)
    bench.clock.wait(5.0)
    assert bench.angle_deg() == pytest.approx(288.0, abs=0.06)


def test_a_reset_in_motion_alarms_and_locks_until_unlocked():
    bench = Bench()
    bench.say("$J=G91A3600F5400\n")
    bench.clock.wait(1.0)
    assert bench.say(b"\x18") == "ALARM:3\r\n\r\nGrbl 1.1h ['$' for help]\r\n"
    bench.clock.wait(0.01)
    assert bench.rate_dps() == 0.0
    assert bench.say("$J=G91A1F60\n") == "error:9\r\n"
    assert bench.say("?").startswith("<Alarm|")
    assert bench.say("$X\n") == "[MSG:Caution: Unlocked]\r\nok\r\n"
    assert bench.say("$J=G91A1F60\n") == "ok\r\n"


ERRORS = [
    ("$J=1A\n", 20), ("$J=G\n", 20), ("$J=G91A1.2.3F5\n", 20), ("$foo\n", 3), ("$999=1\n", 3), ("$103=-1\n", 4),
    ("$103=x\n", 2), ("$103=0\n", 4), ("$H\n", 3), ("x" * 100 + "\n", 11), ("$J=G91A1F60M3\n", 20), ("M3\n", 20),
    ("G1A1F5\n", 20), ("$J=G90A1F5\n", 20), ("$J=G91A10\n", 20), ("$J=G91A10F0\n", 22), ("$J=G91X1F5\n", 20),
    ("$J=G91A1F-5\n", 20),
]  # fmt: skip


@pytest.mark.parametrize(("line", "code"), ERRORS)
def test_each_wrong_line_has_its_error(line, code):
    assert Bench().say(line) == f"error:{code}\r\n"


def test_a_board_that_jogs_keeps_its_settings_and_takes_no_program():
    bench = Bench()
    assert bench.say("$J=G91A-10F60\n") == "ok\r\n"
    assert bench.say("$100=5\n") == "error:8\r\n"
    assert bench.say("G1A1F5\n") == "error:9\r\n"


def test_settings_are_listed_and_kept():
    bench = Bench(axes="A")
    listed = bench.say("$$\n")
    assert "$100=8.889\r\n" in listed
    assert listed.endswith("$120=500.000\r\nok\r\n")
    bench.say("$100=100\n")
    assert "$100=100.000\r\n" in bench.say("$$\n")
    assert bench.say("$I\n").endswith("ok\r\n")


def test_a_wrong_steps_per_degree_turns_the_shaft_too_far():
    bench = Bench(ripple_deg=0.0)
    bench.say("$103=17.778\n$J=G91A90F5400\n")
    bench.clock.wait(10.0)
    assert bench.angle_deg() == pytest.approx(180.0, abs=0.06)


def test_the_motor_has_current_while_it_moves_or_for_ever():
    bench = Bench()
    assert not bench.machine.motor_on
    bench.say("$J=G91A9F5400\n", 1.0)
    bench.clock.wait(0.1)
    assert bench.machine.motor_on
    bench.clock.wait(2.0)
    assert not bench.machine.motor_on
    bench.say("$1=255\n")
    assert bench.machine.motor_on
    bench.say("$SLP\n")
    assert not bench.machine.motor_on


def test_detents_ripple_the_rate_and_not_the_mean():
    bench = Bench(ripple_deg=0.02)
    bench.say("$J=G91A360F5400\n")
    bench.clock.wait(2.0)
    times = np.linspace(1.0, 1.0 + 10 * 1.8 / 90.0, 2001)[:-1]  # ten full steps
    _, rate = bench.machine.states(times)
    rate = np.degrees(rate)
    show("rate ripple, dps", round(rate.max() - 90.0, 3), 90.0 * 0.02 * 2.0 * math.pi / 1.8)
    assert rate.mean() == pytest.approx(90.0, abs=0.01)
    assert rate.max() - 90.0 == pytest.approx(90.0 * 0.02 * 2.0 * math.pi / 1.8, rel=0.01)
    with pytest.raises(InputError, match=r"axis state: wanted times in 0\.\.2\.0000 s, got 3\.0000\.\.3\.0000 s"):
        bench.machine.states(np.array([3.0]))


def test_a_limit_switch_alarms_and_stops_at_once():
    bench = Bench()
    bench.say("$J=G91A3600F5400\n")
    bench.clock.wait(1.0)
    bench.machine.set_fault("limit_switch", True)
    bench.clock.wait(0.01)
    assert bench.session.unasked() == b"ALARM:1\r\n[MSG:Reset to continue]\r\n"
    assert bench.rate_dps() == 0.0
    assert "|Pn:A>" in bench.say("?")


@pytest.mark.parametrize("fault", ["amplifier_fault", "power_cut"])
def test_without_current_the_shaft_coasts_to_rest(fault):
    bench = Bench(ripple_deg=0.0)
    bench.say("$J=G91A3600F5400\n")
    bench.clock.wait(1.0)
    bench.machine.set_fault(fault, True)
    bench.clock.wait(0.1)
    assert bench.rate_dps() == pytest.approx(50.0, abs=2e-3)  # 400 deg/s2
    bench.clock.wait(1.0)
    assert bench.rate_dps() == 0.0
    assert not bench.machine.motor_on
    assert (bench.say("?") == "") == (fault == "power_cut")
    rested = bench.angle_deg()
    bench.machine.set_fault(fault, False)
    bench.say("$J=G91A9F5400\n", 60.0)
    bench.clock.wait(60.0)
    assert bench.angle_deg() == pytest.approx(rested + 9.0, abs=0.06)


def test_a_message_and_an_abort_input_are_heard():
    bench = Bench()
    bench.machine.set_fault("message", True)
    bench.machine.set_fault("abort_input", True)
    assert bench.session.unasked() == b"[MSG:Emulated message]\r\n\r\nGrbl 1.1h ['$' for help]\r\n"


def test_an_axis_that_the_board_lacks_is_refused():
    with pytest.raises(InputError, match="grbl axis: wanted one of X, Y, got 'A'"):
        GrblSettings(axes="XY")


@pytest.mark.slow
def test_ten_thousand_random_lines_crash_nothing_and_are_answered():
    rng = random.Random(5)
    bench = Bench()
    words = [
        "$J=",
        "$J=G91",
        "G1",
        "G0",
        "A",
        "F",
        "X",
        "$$",
        "$X",
        "$10",
        "=",
        "-",
        ".",
        "9",
        "1e9",
        "G91",
        "$",
        " ",
        "\x7f",
    ]
    for _ in range(10_000):
        line = "".join(
            rng.choice(words) + rng.choice(["", str(rng.randint(-999, 999))]) for _ in range(rng.randint(0, 5))
        )
        answer = bench.say(line + "\n", rng.random() * 0.2)
        if not answer:  # the board was full
            bench.clock.wait(1e7)
            answer = bench.session.unasked().decode()
        assert answer.endswith("ok\r\n") or answer.startswith("error:"), line
        if rng.random() < 0.05:
            bench.say(bytes([rng.choice(b"?!~\x18\x85")]))
            bench.say("$X\n")
        assert abs(bench.rate_dps()) < 1e3
