"""Acceptance of a table: the following error in the step wave, the limit that decides, and the table left as it was found.

Most tests drive the real driver and the emulated card without a socket, on a clock that only they move: no wait, same bits.
"""

import math
from dataclasses import replace

import pytest

from testkit.data import show
from testkit.emulated.axes import ServoSettings
from testkit.emulated.emulator import Emulator, EmulatorSettings
from testkit.emulated_axis import axis_rate
from testkit.galil_bench import GalilBench
from undrift.base.clock import Clock, VirtualClock
from undrift.errors import InputError, LimitError, LinkError
from undrift.rig.check import CheckSettings, check_rig
from undrift.rig.galil import GalilRig
from undrift.rig.rig import Limits, RigSettings, ServoReport, open_rig

DEGREE = math.pi / 180.0
LIMITS = Limits(turn_rate=100.0 * DEGREE, acceleration=2300.0 * DEGREE)
SHORT = CheckSettings(duration_s=4.0)


class BenchPort:
    """A port to a card in hand: each answer takes a millisecond."""

    name, is_open = "bench", True

    def __init__(self, bench: GalilBench) -> None:
        self.bench, self.heard = bench, []
        self.fail = ""

    def ask(self, command, deadline_s=None):
        self.heard.append(command)
        if self.fail and command.startswith(self.fail):
            self.fail = ""
            raise LinkError(f"bench: wanted an answer to '{command}', got a cut")
        answer = self.bench.say(command, 1e-3)
        return None if answer.endswith("?") else answer.removesuffix(":")

    def shout(self, command):
        self.bench.say(command, 1e-3)

    def resynchronise(self):
        pass

    mask_unsolicited = reconnect = close = resynchronise

    def unsolicited(self):
        return ""


@pytest.fixture
def in_hand():
    """Return what opens a rig on a card in hand, with waits that move its clock."""

    def opened(servo=None, *, motor_on=False, limits=LIMITS, **card):
        bench = GalilBench(servo or ServoSettings(), **card)
        if motor_on:
            assert bench.say("SH") == ":"
        return bench, GalilRig(BenchPort(bench), RigSettings(limits=limits, clock=bench.clock)), bench.clock

    return opened


def test_the_notes_step_wave_of_60_s_stays_within_its_error(in_hand):
    bench, rig, clock = in_hand()
    found = check_rig(rig, clock, CheckSettings())
    show("largest error at steady rate, deg", round(found.error.largest / DEGREE, 4), 0.012)
    show("largest error in a run-up, deg", round(found.error.in_run_up / DEGREE, 4), 0.0155)
    assert found.passed
    assert found.verdict.status == "good"
    assert found.error.rms < found.error.largest < 0.012 * DEGREE
    assert 0.012 * DEGREE < found.error.in_run_up < 0.019 * DEGREE  # 0.0155 at AC 256000, a count more by friction
    assert found.error.turn_rate / DEGREE == pytest.approx(90.0, abs=0.02)  # a count in 0.8 s
    assert found.servo == ServoReport(kp=12.5, ki=0.0, kd=245.0, sample_s=pytest.approx(1e-4, rel=0.03))
    assert bench.clock.now() > 60.0


def test_an_error_beyond_the_limit_fails_with_its_numbers(in_hand):
    _, rig, clock = in_hand()
    found = check_rig(rig, clock, replace(SHORT, limit=0.004 * DEGREE))
    assert found.passed is False
    assert found.verdict.status == "bad"
    (failed,) = [item for item in found.verdict.findings if item.level == "fail"]
    assert failed.code == "rig_check.error"
    assert failed.values["largest_deg"] == pytest.approx(found.error.largest / DEGREE)
    assert failed.values["limit_deg"] == pytest.approx(0.004)


@pytest.mark.parametrize("motor_on", [False, True])
def test_the_table_is_left_as_it_was_found(in_hand, motor_on):
    bench, rig, clock = in_hand(motor_on=motor_on)
    bench.say("AC 102400;DC 204800")
    found = (bench.card.values["AC"], bench.card.values["DC"])
    rig = GalilRig(BenchPort(bench), RigSettings(limits=LIMITS, clock=clock))
    check_rig(rig, clock, SHORT)
    assert bench.card.motor_on is motor_on
    clock.wait(0.3)
    assert abs(bench.mean_dps()) < 0.5  # a count of creep
    assert not bench.card.motion.running
    assert (bench.card.values["AC"], bench.card.values["DC"]) == found


@pytest.mark.parametrize("motor_on", [False, True])
def test_ctrl_c_in_the_wave_leaves_the_table_as_it_was_found(in_hand, motor_on):
    bench, rig, clock = in_hand(motor_on=motor_on)

    def interrupt(line):
        if line.startswith("step wave") and bench.clock.now() > 2.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        check_rig(rig, clock, SHORT, interrupt)
    assert not bench.card.motion.running
    assert bench.card.motor_on is motor_on


@pytest.mark.parametrize("command", ["SP", "TE", "MG _TP"])
def test_a_link_that_fails_leaves_the_motor_off(in_hand, command):
    bench, rig, clock = in_hand(motor_on=True)
    rig.card.port.fail = command
    with pytest.raises(LinkError, match=r"got a cut; the table was stopped and its motor switched off"):
        check_rig(rig, clock, SHORT)
    assert not bench.card.motion.running
    assert not bench.card.motor_on


@pytest.mark.parametrize(
    ("settings", "limits", "error", "message"),
    [
        ({"turn_rate": 120.0 * DEGREE}, LIMITS, LimitError, "turn rate: wanted at most"),
        ({"acceleration": 3000.0 * DEGREE}, LIMITS, LimitError, "acceleration: wanted above 0"),
        ({}, replace(LIMITS, travel=1.0), LimitError, "travel: wanted to stay within 1 rad"),
    ],
)
def test_a_wave_beyond_the_limits_moves_nothing(in_hand, settings, limits, error, message):
    bench, rig, clock = in_hand(limits=limits)
    with pytest.raises(error, match=message):
        check_rig(rig, clock, replace(SHORT, **settings))
    assert not any(command.startswith("BG") for command in rig.card.port.heard)
    assert not bench.card.motor_on


@pytest.mark.parametrize("settings", [{"duration_s": 0.0}, {"limit": math.nan}, {"acceleration": 1.0}])
def test_a_wave_that_is_none_is_refused(settings):
    with pytest.raises(InputError, match="rig check: wanted"):
        CheckSettings(**settings)


@pytest.mark.parametrize("clock", [VirtualClock(), pytest.param(Clock.started(), marks=pytest.mark.slow)])
def test_over_a_link_the_notes_loop_passes(clock):
    with Emulator(EmulatorSettings(), clock) as emulator:
        settings = RigSettings(limits=LIMITS, reply_timeout_s=10.0, clock=clock)
        rig = open_rig(f"galil:tcp://{emulator.host}:{emulator.port}", settings)
        found = check_rig(rig, clock, CheckSettings(duration_s=2.0))
        assert not emulator.motor_on
    assert found.passed
    assert found.identity.startswith("DMC")


def test_a_stepper_is_refused_before_it_turns():
    clock = VirtualClock()
    with Emulator(EmulatorSettings(kind="grbl"), clock) as emulator:
        rig = open_rig(f"grbl:tcp://{emulator.host}:{emulator.port}", RigSettings(limits=LIMITS, clock=clock))
        with pytest.raises(InputError, match="no encoder"):
            check_rig(rig, clock, SHORT)
        assert axis_rate(emulator) == 0.0
