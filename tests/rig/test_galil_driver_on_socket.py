"""The Galil driver against the emulator: all that it can be told, and all that the card can refuse."""

import contextlib
import math
import re

import pytest

from testkit.emulated_axis import axis_angle, axis_rate, axis_state
from testkit.rig_bench import mean_turn_rate
from undrift.base.clock import VirtualClock
from undrift.errors import RigFault
from undrift.rig.galil import GalilRig, open_from, read_status
from undrift.rig.link import LinkPort, LinkSettings
from undrift.rig.rig import Limits, RigSettings, codes, in_words
from undrift.sim.rig.emulator import Emulator, EmulatorSettings

DEGREE = math.pi / 180.0
ERRORS = {int(code): words for code, words in codes("galil_error").items() if code != "other"}
SPEED = 10.0
PATIENT_S = 10.0  # a busy machine answers late


def address(emulator):
    return f"tcp://{emulator.host}:{emulator.port}"


@contextlib.contextmanager
def connected(**settings):
    """An emulator, and a rig that is connected to it; the emulator is mended before the rig is closed."""
    clock = VirtualClock()
    with Emulator(EmulatorSettings(), clock) as emulator:
        rig = open_from(address(emulator), RigSettings(clock=clock, **settings))
        try:
            yield emulator, rig
        finally:
            emulator.clear()
            rig.close()


def turning(emulator, dps):
    """Wait until the true axis has turned at a rate, in the mean, for 0.2 s."""

    def is_so():
        now = emulator.now()
        return now > 0.2 and abs(axis_state(emulator, now, mean_s=0.2)[1] / DEGREE - dps) < 1.0

    assert emulator.clock.until(is_so, 20.0), f"it never turns at {dps} deg/s"


def resting(emulator):
    assert emulator.clock.until(lambda: abs(axis_rate(emulator)) < 1e-3, 20.0), "it never rests"


def says_limits(emulator, rig):
    assert rig.limits == Limits()


def says_identity(emulator, rig):
    assert rig.identify() == emulator.machine.card.settings.revision


def says_position(emulator, rig):
    rig.enable(True)
    rig.move_by(30.0 * DEGREE)
    resting(emulator)
    assert rig.position().angle == pytest.approx(axis_angle(emulator), abs=0.03 * DEGREE)  # three counts


def measures_rate(emulator, rig):
    rig.enable(True)
    rig.turn(-45.0 * DEGREE)
    turning(emulator, -45.0)
    start = emulator.now()
    measured = mean_turn_rate(rig, emulator.clock, 5.0)
    stop = emulator.now()
    angles = [axis_state(emulator, time)[0] for time in (start, stop)]
    assert (angles[1] - angles[0]) / (stop - start) / DEGREE == pytest.approx(-45.0, abs=0.2)
    assert measured < 0.0  # how well is the link's affair: test_against_emulator.py


def says_servo(emulator, rig):
    assert (rig.read_servo().kp, rig.read_servo().kd) == (12.5, 245.0)


def says_following_error(emulator, rig):
    rig.enable(True)
    assert rig.following_error() == pytest.approx(0.0, abs=0.03 * DEGREE)
    emulator.inject("amplifier_fault")
    assert math.isfinite(rig.following_error())


def says_fault(emulator, rig):
    assert rig.fault() is None
    rig.enable(True)
    emulator.inject("amplifier_fault")
    assert emulator.clock.until(lambda: not emulator.motor_on, 20.0)
    assert rig.fault() == (
        "the motor is off though it was switched on; switched off because the following error passed its limit (stop code 8)"
    )


def enables(emulator, rig):
    for on in (True, False, True):
        rig.enable(on)
        assert emulator.motor_on == on


def sets_acceleration(emulator, rig):
    held = rig.set_acceleration(40.0)
    assert held == pytest.approx(254_976 * 2.0 * math.pi / 40_000, rel=1e-12)
    assert emulator.machine.card.values["AC"] == emulator.machine.card.values["DC"] == 254_976


def turns(emulator, rig):
    rig.enable(True)
    for dps, held_dps in ((90.0, 90.0), (-5.0, -5.004), (0.0, 0.0)):
        assert rig.turn(dps * DEGREE) / DEGREE == pytest.approx(held_dps, rel=1e-12)
        turning(emulator, held_dps)


def moves(emulator, rig):
    rig.enable(True)
    assert rig.move_by(-90.0 * DEGREE) / DEGREE == pytest.approx(-90.0, abs=0.03)
    resting(emulator)
    assert axis_angle(emulator) / DEGREE == pytest.approx(-90.0, abs=0.03)


def stops(emulator, rig):
    rig.enable(True)
    rig.turn(20.0 * DEGREE)
    turning(emulator, 20.0)
    rig.stop()
    resting(emulator)
    assert emulator.motor_on


def closes(emulator, rig):
    rig.enable(True)
    rig.turn(20.0 * DEGREE)
    rig.close()
    resting(emulator)
    assert not emulator.motor_on


RIG = {
    "limits": says_limits,
    "identify": says_identity,
    "position": says_position,
    "rate from positions": measures_rate,
    "following_error": says_following_error,
    "read_servo": says_servo,
    "fault": says_fault,
    "enable": enables,
    "set_acceleration": sets_acceleration,
    "turn": turns,
    "move_by": moves,
    "stop": stops,
    "close": closes,
}


@pytest.mark.parametrize("name", RIG)
def test_every_command_of_the_driver_does_on_the_card_what_it_says(name):
    with connected() as (emulator, rig):
        RIG[name](emulator, rig)


def test_no_command_of_the_driver_is_left_out_above():
    driver = {name for name in dir(GalilRig) if callable(getattr(GalilRig, name)) and not name.startswith("_")}
    assert driver <= set(RIG)


def test_the_status_is_read_beside_whoever_drives():
    with connected() as (emulator, rig):
        rig.enable(True)
        rig.turn(20.0 * DEGREE)
        status = read_status(f"galil:{address(emulator)}", RigSettings(clock=emulator.clock))
        assert (status.moving, status.motor_on, status.fault) == (True, True, None)
        assert status.identity == rig.identify()
        turning(emulator, 20.0)  # being asked beside changed nothing


# The codes that DOMAIN names, each by a command that the card refuses for that reason. Three come otherwise: 3 only inside a
# program, so no command of a host is refused with it; 13, 7, 20, 21, 22 need a state; 131 needs a line that loses its end.
AT_REST = {
    1: ("XX", "bg", "QD"),
    2: ("WT 5", "AMX"),
    4: ("TPQ", "KPZ=5", "JG 1,2", "MG _QQX"),
    5: ("MG " + "1," * 60, "KP " + "0" * 200),
    6: ("KP 5000", "JG 99999999", "TM 50000"),
    8: ("HX",),
    9: ("KP ABCD", "NEVERSET="),
    20: ("BGX",),
    50: ("KP", "MG"),
    51: ("ST?", "BG ?"),
    83: ("KP 5$", 'MG "open'),
    143: ("TM 40",),
}
JOGGING = {7: ("DP 0", "MO", "PR 100", "TM 500"), 21: ("BGX",)}
MOVING = {13: ("JG 100",), 7: ("PA 5",), 21: ("BGX",)}
DOMAIN_CODES = {1, 2, 3, 4, 5, 6, 7, 8, 9, 13, 20, 21, 22, 50, 51, 83, 131, 143}


def refused(rig, code, command):
    """Give a command, and read what a person is told."""
    with pytest.raises(RigFault) as raised:
        rig.card.do(command)
    assert str(raised.value) == (
        f"{rig.card.port.name}: wanted '{command}', got error {code}: {ERRORS[code]}; see the state of the card"
    )
    assert (raised.value.code, raised.value.command) == (code, command)
    assert rig.card.text("TC1").startswith("0"), "the code was read, so the card has forgotten it"


@pytest.mark.parametrize("code", AT_REST)
def test_what_the_card_refuses_at_rest_is_said_with_its_reason(code):
    with connected() as (emulator, rig):
        for command in AT_REST[code]:
            refused(rig, code, command)
        assert rig.fault() is None
        assert axis_rate(emulator) == 0.0


def test_what_the_card_refuses_while_it_turns_is_said_with_its_reason():
    with connected() as (emulator, rig):
        rig.enable(True)
        rig.turn(10.0 * DEGREE)
        for code, commands in JOGGING.items():
            for command in commands:
                refused(rig, code, command)
        turning(emulator, 10.0)  # a refusal changes nothing
        rig.stop()


def test_what_the_card_refuses_during_a_move_is_said_with_its_reason():
    with connected() as (_, rig):
        rig.enable(True)
        rig.card.do("SP 1000")
        rig.card.do("PR 4000000")  # an hour of it
        rig.card.do("BGX")
        for code, commands in MOVING.items():
            for command in commands:
                refused(rig, code, command)
        with pytest.raises(RigFault, match="wanted to turn, got a move that still runs; stop it first"):
            rig.turn(1.0)
        with pytest.raises(RigFault, match="wanted to move, got an axis that moves; stop it first"):
            rig.move_by(1.0)
        rig.stop()


@pytest.mark.parametrize(("switch", "way"), [("limit_switch", 1), ("limit_switch_reverse", -1)])
def test_a_motion_towards_a_closed_limit_switch_is_refused_and_one_away_from_it_is_not(switch, way):
    with connected() as (emulator, rig):
        rig.enable(True)
        emulator.inject(switch)
        with pytest.raises(RigFault, match=f"wanted 'BGX', got error 22: {ERRORS[22]}; see the state") as raised:
            rig.turn(way * 10.0 * DEGREE)
        assert raised.value.code == 22
        assert axis_rate(emulator) == 0.0
        rig.turn(-way * 10.0 * DEGREE)
        turning(emulator, -way * 10.0)


def test_code_3_is_met_by_a_program_only_and_its_line_comes_unasked():
    with connected() as (emulator, rig):
        port = rig.card.port
        for line in ("DL", "#A;LS", "EN"):
            port.shout(line)
        port.shout("\\")
        emulator.clock.wait(0.1)  # their prompts come before the port asks again
        port.resynchronise()
        rig.card.do("XQ #A")
        said = []

        def heard():
            assert rig.fault() is None  # an answer amid what comes unasked
            said.append(port.unsolicited())
            return "".join(said).endswith("\n")

        assert emulator.clock.until(heard, 20.0), "the card never says why"
        assert "".join(said) == "?000 LS\r\n"
        code = int(re.match(r"\d+", rig.card.text("TC1").strip()).group())
        assert (code, in_words("galil_error", code)) == (3, "the command does not work inside a program")


class LosesEnds(LinkPort):
    """A serial line on which the end of one command is lost."""

    def ask(self, command, deadline_s=None):
        if command != "BGX":
            return super().ask(command, deadline_s)
        return None if self.exchange(command, 60.0, terminator="") == "?" else "answered otherwise"


def test_code_131_is_a_serial_line_that_lost_the_end_of_a_command_and_nothing_moves():
    with Emulator(EmulatorSettings(speed=SPEED, with_pty=True)) as emulator:
        port = LosesEnds(f"serial://{emulator.pty_path}", LinkSettings(reply_timeout_s=PATIENT_S))
        rig = GalilRig(port, RigSettings(clock_speed=SPEED))
        try:
            rig.enable(True)
            refused(rig, 131, "BGX")
            with pytest.raises(RigFault, match=f"wanted 'BGX', got error 131: {ERRORS[131]}"):
                rig.turn(10.0 * DEGREE)
            assert axis_rate(emulator) == 0.0
            assert rig.position().angle == 0.0
        finally:
            rig.close()
        assert not emulator.motor_on


def test_code_143_reaches_whoever_sets_a_sample_time_through_the_driver():
    with connected() as (emulator, rig):
        with pytest.raises(RigFault, match=f"wanted 'TM 40', got error 143: {ERRORS[143]}") as raised:
            rig.card.do("TM 40")
        assert raised.value.code == 143
        assert rig.card.number("MG _TM") == emulator.machine.card.values["TM"]


def test_no_code_is_left_out_above():
    assert {*AT_REST, *JOGGING, *MOVING, 3, 22, 131} == DOMAIN_CODES


def test_a_command_that_is_too_long_is_dropped_to_its_end_and_the_next_one_is_heard():
    with connected() as (emulator, rig):
        rig.enable(True)
        refused(rig, 5, "PR 4000" + " " * 100 + ";BGX")
        assert rig.card.integer("MG _BGX", 0, 1) == 0
        assert emulator.machine.card.motion.distance == 0.0
        assert rig.move_by(5.0 * DEGREE) / DEGREE == pytest.approx(5.0, abs=0.03)
