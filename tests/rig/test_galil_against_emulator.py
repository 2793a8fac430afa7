"""The real drivers against the emulators, on a virtual clock; over a pseudo terminal, and over sockets in the long run."""

import contextlib
import math
import threading
from dataclasses import replace

import numpy as np
import pytest

from testkit.emulated_axis import axis_angle, axis_rate, axis_state
from testkit.rig_bench import mean_turn_rate
from testkit.waiting import LONG_S
from undrift.base.clock import Clock, VirtualClock
from undrift.errors import LinkError, RigError, RigTimeout
from undrift.rig.rig import Limits, RigSettings, open_rig
from undrift.sim.rig.emulator import Emulator, EmulatorSettings

DEGREE = math.pi / 180.0
SPEED = 10.0
CLOCKS = [VirtualClock, pytest.param(lambda: Clock.started(SPEED), marks=pytest.mark.slow)]


@pytest.fixture(params=CLOCKS, ids=["virtual", "sockets"])
def emulator(request):
    with Emulator(EmulatorSettings(), request.param()) as emulator:
        yield emulator


@pytest.fixture(params=CLOCKS, ids=["virtual", "sockets"])
def board(request):
    with Emulator(EmulatorSettings(kind="grbl"), request.param()) as emulator:
        yield emulator


def opened(emulator, kind: str = "galil", url: str = "", **settings):
    url = url or f"tcp://{emulator.host}:{emulator.port}"
    return open_rig(f"{kind}:{url}", RigSettings(**{"clock": emulator.clock, "reply_timeout_s": 10.0, **settings}))


def positions(rig) -> None:
    for _ in range(20):
        rig.position()


def settled(emulator) -> None:
    assert emulator.clock.host.until(lambda: abs(axis_rate(emulator)) < 1e-3, LONG_S), "it never rests"


def turning(emulator, dps) -> None:
    """Wait until the true axis has turned at about that rate for 0.3 s."""

    def is_so():
        now = emulator.now()
        return now > 0.3 and axis_state(emulator, now, mean_s=0.3)[1] / DEGREE == pytest.approx(dps, rel=0.02, abs=0.05)

    assert emulator.clock.host.until(is_so, LONG_S), f"it never turns at {dps} deg/s"


def impatient(rig) -> None:
    """Let the answers of a rig that is connected be due soon."""
    rig.card.port.settings = replace(rig.card.port.settings, reply_timeout_s=0.3)


def measured(rig, clock, duration_s: float) -> tuple[float, float]:
    """Return the measured rate, and how far the times of its two positions leave it open, as a part of it."""
    within, ask = [], rig.position

    def position():
        said = ask()
        within.append(said.within_s)
        return said

    rig.position = position
    rate = mean_turn_rate(rig, clock, duration_s)
    del rig.position
    return rate, sum(within) / duration_s


def test_every_command_of_a_session_is_understood(emulator):
    rig = opened(emulator)
    try:
        assert rig.identify().startswith("DMC")
        assert rig.fault() is None
        rig.enable(True)
        assert emulator.motor_on
        assert rig.set_acceleration(40.0) == pytest.approx(254_976 * 2 * math.pi / 40_000)
        assert (rig.read_servo().kp, rig.read_servo().kd) == (12.5, 245.0)
        assert rig.turn(90.0 * DEGREE) == pytest.approx(90.0 * DEGREE, rel=1e-12)
        assert rig.turn(-45.0 * DEGREE) == pytest.approx(-45.0 * DEGREE, rel=1e-12)
        rig.stop()
        settled(emulator)
        assert rig.move_by(90.0 * DEGREE) / DEGREE == pytest.approx(90.0, abs=0.05)
        assert abs(rig.following_error()) / DEGREE < 0.05
        rig.card.do("AB")
        rig.enable(False)
        assert not emulator.motor_on
    finally:
        rig.close()
        rig.close()
    assert not any(thread.name.startswith("link") for thread in threading.enumerate())


@pytest.mark.parametrize(("nominal_dps", "achieved_dps"), [(90.0, 90.0), (5.0, 5.004), (0.1, 0.099)])
def test_the_achieved_rate_is_the_one_the_axis_turns_at(emulator, nominal_dps, achieved_dps):
    rig = opened(emulator)
    try:
        rig.enable(True)
        assert rig.turn(nominal_dps * DEGREE) / DEGREE == pytest.approx(achieved_dps, rel=1e-9)
        turning(emulator, achieved_dps)
        start = emulator.now()
        rate, open_part = measured(rig, emulator.clock, 5.0)
        stop = emulator.now()
        true_dps = (
            np.diff(emulator.axis_states(np.array([start + 0.5, stop - 0.5]))[0])[0] / (stop - start - 1.0) / DEGREE
        )
        assert true_dps == pytest.approx(achieved_dps, abs=0.02)  # a limit cycle of a count over 4 s
        assert rate / DEGREE == pytest.approx(achieved_dps, rel=1e-3 + open_part, abs=0.01)  # a count in each position
    finally:
        rig.close()
    settled(emulator)
    assert not emulator.motor_on


def test_a_serial_port_works_like_a_socket():
    with Emulator(EmulatorSettings(speed=SPEED, with_pty=True)) as emulator:
        rig = opened(emulator, url=f"serial://{emulator.pty_path}")
        try:
            rig.enable(True)
            assert rig.move_by(-30.0 * DEGREE) / DEGREE == pytest.approx(-30.0, abs=0.05)
        finally:
            rig.close()
        assert not emulator.motor_on


def test_the_card_itself_keeps_the_travel(emulator):
    rig = opened(emulator, limits=Limits(travel=30.0 * DEGREE))
    try:
        rig.enable(True)
        rig.turn(90.0 * DEGREE)
        assert emulator.clock.host.until(lambda: axis_angle(emulator) > 20.0 * DEGREE, LONG_S)
        settled(emulator)
        assert axis_angle(emulator) / DEGREE < 33.0
        assert "forward limit" in rig.fault()
    finally:
        rig.close()


@pytest.mark.parametrize("fault", ["drop_bytes", "stall", "garbage", "half_reply", "late_reply", "disconnect"])
def test_a_failing_link_ends_with_the_table_at_rest_or_a_cry_for_help(emulator, fault):
    rig = opened(emulator)
    try:
        rig.enable(True)
        rig.turn(20.0 * DEGREE)
        impatient(rig)
        emulator.inject(fault)
        start = emulator.clock.host.now()
        with pytest.raises((LinkError, RigTimeout)) as raised:
            positions(rig)
        assert emulator.clock.host.now() - start < 60.0  # four answers that do not come, and a busy machine
        told = str(raised.value)
        assert told.endswith("the table was stopped and its motor switched off") or "NOT CONFIRMED" in told
        settled(emulator)
        assert not emulator.motor_on
    finally:
        emulator.clear()
        with contextlib.suppress(RigError):
            rig.close()


@pytest.mark.parametrize("fault", ["amplifier_fault", "encoder_loss", "limit_switch", "abort_input"])
def test_a_failing_rig_is_reported_in_words(emulator, fault):
    rig = opened(emulator)
    try:
        rig.enable(True)
        rig.turn(90.0 * DEGREE)
        turning(emulator, 90.0)
        emulator.inject(fault)
        assert emulator.clock.host.until(rig.fault, LONG_S), "the rig never says what is wrong"
    finally:
        emulator.clear()
        rig.close()
    settled(emulator)
    assert not emulator.motor_on


def test_a_power_cut_is_a_lost_link_and_the_rig_can_be_opened_again(emulator):
    rig = opened(emulator)
    try:
        rig.enable(True)
        rig.turn(20.0 * DEGREE)
        emulator.inject("power_cut")
        with pytest.raises(LinkError, match="NOT CONFIRMED"):
            rig.position()
    finally:
        emulator.clear()
        with pytest.raises(LinkError, match="open it again"):
            rig.position()
        rig.close()
    again = opened(emulator)
    try:
        again.enable(True)
        assert again.move_by(5.0 * DEGREE) / DEGREE == pytest.approx(5.0, abs=0.05)
    finally:
        again.close()


def test_text_that_nobody_asked_for_does_not_disturb(emulator):
    rig = opened(emulator)
    try:
        emulator.inject("message")
        rig.enable(True)
        said = []

        def heard():
            assert rig.position().angle == 0.0
            said.append(rig.card.port.unsolicited())
            return "".join(said) == "EMULATED MESSAGE\r\n"

        assert emulator.clock.host.until(heard, LONG_S), "the message never comes"
    finally:
        rig.close()


def test_a_stepper_board_moves_and_sleeps(board):
    with board as emulator:
        rig = opened(emulator, kind="grbl")
        try:
            assert rig.identify().startswith("Grbl 1.1")
            rig.enable(True)
            rig.set_acceleration(2.0)
            assert rig.move_by(90.0 * DEGREE) / DEGREE == pytest.approx(90.0, abs=0.06)
            assert axis_angle(emulator) / DEGREE == pytest.approx(90.0, abs=1.0)  # a step's ripple
            assert rig.fault() is None
        finally:
            rig.close()
        assert not emulator.motor_on


def test_a_stepper_board_turns_at_the_rate_it_was_told(board):
    with board as emulator:
        rig = opened(emulator, kind="grbl")
        try:
            rig.enable(True)
            rig.set_acceleration(2.0)
            achieved = rig.turn(-45.0 * DEGREE)
            turning(emulator, achieved / DEGREE)
            rate, open_part = measured(rig, emulator.clock, 5.0)
            assert rate == pytest.approx(achieved, rel=0.01 + open_part)  # two positions, each told to a step
            rig.stop()
            assert rig.fault() is None
        finally:
            rig.close()
        settled(emulator)
        assert not emulator.motor_on
