"""The real drivers against the emulators, over real sockets and a pseudo terminal."""

import contextlib
import math
import threading
import time

import numpy as np
import pytest

from undrift.errors import LinkError, RigError, RigFault, RigTimeout
from undrift.rig.address import RigSettings, open_rig
from undrift.rig.galil.tuning import Gains, read_gains, set_gains
from undrift.rig.rig import Limits
from undrift.sim.rig.emulator import Emulator, EmulatorSettings

DEGREE = math.pi / 180.0
SPEED = 10.0


@pytest.fixture
def emulator():
    with Emulator(EmulatorSettings(speed=SPEED)) as emulator:
        yield emulator


def opened(emulator, kind: str = "galil", url: str = "", **settings):
    url = url or f"tcp://{emulator.host}:{emulator.port}"
    return open_rig(f"{kind}:{url}", RigSettings(**{"clock_speed": SPEED, "reply_timeout_s": 0.5, **settings}))


def positions(rig) -> None:
    for _ in range(20):
        rig.position()


def settled(emulator) -> None:
    """Wait until the true axis is at rest."""
    last = time.monotonic() + 5.0
    while abs(emulator.axis_rate()) > 1e-3:
        assert time.monotonic() < last, "the axis never came to rest"
        time.sleep(0.01)


def test_every_command_of_a_session_is_understood(emulator):
    rig = opened(emulator)
    try:
        assert rig.identify().startswith("DMC")
        assert rig.fault() is None
        rig.enable(True)
        assert emulator.motor_on
        assert rig.set_acceleration(40.0) == pytest.approx(254_976 * 2 * math.pi / 40_000)
        assert set_gains(rig.card, Gains(kp=12.5, ki=0.0, kd=245.0)) == read_gains(rig.card)
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
        time.sleep(0.1)
        start = emulator.now()
        measured_dps = rig.measured_turn_rate(5.0) / DEGREE
        stop = emulator.now()
        true_dps = (
            np.diff(emulator.axis_states(np.array([start + 0.5, stop - 0.5]))[0])[0] / (stop - start - 1.0) / DEGREE
        )
        assert true_dps == pytest.approx(achieved_dps, abs=0.02)  # a limit cycle of a count over 4 s
        assert measured_dps == pytest.approx(achieved_dps, rel=5e-3, abs=0.01)  # the host's clock over a socket
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


REFUSALS = {
    "XX": 1, "QD": 1, "WT 5": 2, "AMX": 2, "KP ABCD": 9, "KP 5$": 83, "KPZ=5": 4, "TPQ": 4, "JG 1,2": 4,
    "KP 5000": 6, "HX": 8, "JG 99999999": 6,
    "BGX": 20, "KP": 50, "ST?": 51, "MG _QQX": 4,
}  # fmt: skip
WHILE_JOGGING = {"DP 0": 7, "MO": 7, "PR 100": 7, "BGX": 21}


@pytest.mark.parametrize("command", REFUSALS)
def test_what_the_card_refuses_is_a_fault_in_words(emulator, command):
    rig = opened(emulator)
    try:
        with pytest.raises(RigFault, match=r"got error \d+: ") as refused:
            rig.card.do(command)
        assert refused.value.code == REFUSALS[command]
        assert rig.fault() is None
        assert emulator.axis_rate() == 0.0
    finally:
        rig.close()


def test_what_the_card_refuses_in_motion_is_a_fault_in_words(emulator):
    rig = opened(emulator)
    try:
        rig.enable(True)
        rig.turn(10.0 * DEGREE)
        for command, code in WHILE_JOGGING.items():
            with pytest.raises(RigFault, match=rf"got error {code}: "):
                rig.card.do(command)
        rig.stop()
        rig.card.do("PR 40000")
        rig.card.do("BGX")
        with pytest.raises(RigFault, match="got error 13: "):
            rig.card.do("JG 100")
        rig.stop()
        emulator.inject("limit_switch")
        rig.card.do("PR 4000")
        with pytest.raises(RigFault, match="got error 22: "):
            rig.card.do("BGX")
    finally:
        emulator.clear()
        rig.close()


def test_beginning_while_running_and_jogging_in_a_move_are_refused(emulator):
    rig = opened(emulator)
    try:
        rig.enable(True)
        rig.turn(10.0 * DEGREE)
        with pytest.raises(RigFault, match="error 21: a move is running already"):
            rig.card.do("BGX")
        with pytest.raises(RigFault, match="got an axis that moves; stop it first"):
            rig.move_by(1.0)
    finally:
        rig.close()


def test_the_card_itself_keeps_the_travel(emulator):
    rig = opened(emulator, limits=Limits(travel=30.0 * DEGREE))
    try:
        rig.enable(True)
        rig.turn(90.0 * DEGREE)
        time.sleep(0.3)
        settled(emulator)
        assert emulator.axis_angle() / DEGREE < 33.0
        assert "forward limit" in rig.fault()
    finally:
        rig.close()


@pytest.mark.parametrize("fault", ["drop_bytes", "stall", "garbage", "half_reply", "late_reply", "disconnect"])
def test_a_failing_link_ends_with_the_table_at_rest_or_a_cry_for_help(emulator, fault):
    rig = opened(emulator, reply_timeout_s=0.3)
    try:
        rig.enable(True)
        rig.turn(20.0 * DEGREE)
        emulator.inject(fault)
        start = time.monotonic()
        with pytest.raises((LinkError, RigTimeout)) as raised:
            positions(rig)
        assert time.monotonic() - start < 10.0
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
        time.sleep(0.1)
        emulator.inject(fault)
        time.sleep(0.3)
        try:
            assert rig.fault()
        except LinkError:
            assert fault == "encoder_loss"
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
        time.sleep(0.1)
        rig.enable(True)
        assert rig.position().angle == 0.0
        assert rig.card.port.unsolicited() != ""
    finally:
        rig.close()


def test_a_stepper_board_moves_and_sleeps():
    with Emulator(EmulatorSettings(kind="grbl", speed=SPEED)) as emulator:
        rig = opened(emulator, kind="grbl")
        try:
            assert rig.identify().startswith("Grbl 1.1")
            rig.enable(True)
            rig.set_acceleration(2.0)
            assert rig.move_by(90.0 * DEGREE) / DEGREE == pytest.approx(90.0, abs=0.06)
            assert emulator.axis_angle() / DEGREE == pytest.approx(90.0, abs=1.0)  # a step's ripple
            assert rig.fault() is None
        finally:
            rig.close()
        assert not emulator.motor_on


def test_a_stepper_board_turns_at_the_rate_it_was_told():
    with Emulator(EmulatorSettings(kind="grbl", speed=SPEED)) as emulator:
        rig = opened(emulator, kind="grbl")
        try:
            rig.enable(True)
            rig.set_acceleration(2.0)
            achieved = rig.turn(-45.0 * DEGREE)
            time.sleep(0.3)
            assert rig.measured_turn_rate(5.0) == pytest.approx(achieved, rel=0.02)
            rig.stop()
            assert rig.fault() is None
        finally:
            rig.close()
        settled(emulator)
        assert not emulator.motor_on
