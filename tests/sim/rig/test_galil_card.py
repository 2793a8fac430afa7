"""The card's motions: what starts them, what ends them, what SC says, and what breaks."""

import numpy as np
import pytest

from testkit.data import show
from testkit.emulated_axis import present
from testkit.galil_bench import GalilBench
from undrift.sim.rig.axes import ServoSettings


def test_a_jog_reaches_its_speed_and_st_ends_it():
    bench = GalilBench()
    bench.say("SH;JG 10000;BG")
    assert bench.number("SC") == 0
    bench.clock.wait(1.0)
    assert bench.mean_dps() == pytest.approx(90.0, abs=0.1)
    assert bench.mean_dps() == pytest.approx(90.0, rel=0.002)
    bench.say("ST")
    assert bench.number("MG _BGX") == 1
    bench.clock.wait(0.1)
    assert bench.number("MG _BGX") == 0
    assert bench.number("SC") == 4
    bench.clock.wait(0.5)
    assert bench.rate_dps() == pytest.approx(0.0, abs=0.2)


def test_the_told_velocity_is_a_mean_over_a_quarter_of_a_second():
    bench = GalilBench()
    bench.say("SH;JG 10000;BG")
    bench.clock.wait(0.125)
    bench.clock.wait(0.3)
    assert bench.mean_dps() == pytest.approx(90.0, abs=0.1)


def test_a_jog_may_change_while_it_runs_and_turn_back():
    bench = GalilBench()
    bench.say("SH;JG 10000;BG", 0.0)
    bench.say("JG -5000", 1.0)
    bench.clock.wait(1.0)
    assert bench.mean_dps() == pytest.approx(-45.0, rel=0.002)
    assert bench.number("JG ?") == -5000


@pytest.mark.parametrize(
    ("line", "ends"), [("PR 4000", 4500), ("PA 4000", 4000), ("PR -40000", -39_500), ("PA 500", 500)]
)
def test_a_move_ends_at_its_target_with_stop_code_1(line, ends):
    bench = GalilBench()
    bench.say(f"SH;DP 500;SP 20000;{line};BG")
    bench.clock.wait(4.0)
    assert bench.number("MG _BGX") == 0
    assert bench.number("SC") == 1
    assert bench.number("RP") == ends
    assert abs(bench.number("TP") - ends) <= 1


def test_the_slow_rates_of_the_note_are_what_the_card_makes_of_them():
    bench = GalilBench()
    bench.say("SH;JG 11;BG", 0.0)
    bench.clock.wait(5.0)
    start = bench.machine.history()[1][-1]
    bench.clock.wait(60.0)
    rate = np.degrees(bench.machine.history()[1][-1] - start) / 60.0
    show("JG 11, deg/s", round(rate, 5), 0.099)
    assert rate == pytest.approx(0.099, abs=0.018 / 60.0)  # a count at each end


def test_abort_stops_the_reference_at_once():
    bench = GalilBench()
    bench.say("SH;JG 10000;BG")
    bench.clock.wait(1.0)
    before = bench.number("RP")
    bench.say("AB")
    assert bench.number("RP") == before
    assert bench.number("SC") == 7
    assert bench.card.motor_on
    bench.clock.wait(1.0)
    assert abs(bench.number("TE")) <= 2


def test_a_software_limit_slows_to_rest_and_bars_the_way():
    bench = GalilBench()
    bench.say("SH;FL 3000;JG 10000;BG")
    bench.clock.wait(2.0)
    assert bench.number("SC") == 2
    assert 3000 < bench.number("TP") < 3300  # 196 counts to slow down
    assert bench.say("BG") == "?"
    assert bench.say("JG -10000;BG") == "::"


@pytest.mark.parametrize("oe", [0, 1])
def test_an_amplifier_fault_switches_the_motor_off_with_oe1(oe):
    bench = GalilBench()
    bench.say(f"OE {oe};SH;JG 10000;BG")
    bench.clock.wait(1.0)
    bench.machine.set_fault("amplifier_fault", True)
    bench.clock.wait(0.5)
    if oe:
        assert not bench.machine.motor_on
        assert bench.number("SC") == 8
        assert bench.number("MG _BGX") == 0
    else:
        assert bench.number("MG _BGX") == 1
        assert bench.number("TE") > 3000  # nobody follows
    assert bench.rate_dps() == 0.0  # 1.57 rad/s stop in 0.16 s at 10 rad/s2
    bench.machine.set_fault("amplifier_fault", False)
    if oe:
        assert bench.say("SH;JG 1000;BG") == ":::"
        bench.clock.wait(0.5)
        assert bench.mean_dps() == pytest.approx(9.0, rel=0.02)


def test_a_lost_encoder_runs_away_until_the_error_limit():
    bench = GalilBench()
    bench.say("OE 1;ER 200;SH;JG 10000;BG")
    bench.clock.wait(1.0)
    bench.machine.set_fault("encoder_loss", True)
    told = bench.number("TP")
    bench.clock.wait(0.019)
    assert bench.number("TP") == told
    assert bench.rate_dps() > 100.0
    bench.clock.wait(0.01)
    assert bench.number("SC") == 8
    assert not bench.machine.motor_on
    fastest = bench.rate_dps()
    show("runaway with ER 200, deg/s", round(fastest))
    bench.clock.wait(30.0)
    assert bench.rate_dps() == 0.0


def test_an_error_beyond_its_limit_is_only_shown_with_oe0():
    bench = GalilBench()
    bench.say("ER 50;SH;JG 10000;BG")
    bench.machine.set_fault("amplifier_fault", True)
    bench.clock.wait(0.5)
    assert int(bench.number("TS")) & 0b1000000
    assert bench.card.motor_on


@pytest.mark.parametrize(("fault", "jog", "code"), [("limit_switch", 5000, 2), ("limit_switch_reverse", -5000, 3)])
def test_a_pressed_limit_switch_ends_the_motion(fault, jog, code):
    bench = GalilBench()
    bench.say(f"SH;JG {jog};BG")
    bench.clock.wait(1.0)
    bench.machine.set_fault(fault, True)
    bench.clock.wait(0.5)
    assert bench.number("SC") == code
    assert bench.rate_dps() == pytest.approx(0.0, abs=0.2)
    assert bench.say("BG") == "?"
    bench.machine.set_fault(fault, False)
    assert bench.say("BG") == ":"


def test_oe_2_switches_off_at_a_limit():
    bench = GalilBench()
    bench.say("OE 2;SH;JG 5000;BG")
    bench.machine.set_fault("limit_switch", True)
    bench.clock.wait(0.1)
    assert not bench.machine.motor_on


@pytest.mark.parametrize("oe", [0, 1])
def test_the_abort_input_ends_the_motion(oe):
    bench = GalilBench()
    bench.say(f"OE {oe};SH;JG 5000;BG")
    bench.clock.wait(0.2)
    bench.machine.set_fault("abort_input", True)
    assert bench.number("SC") == 6
    assert bench.machine.motor_on == (oe == 0)


def test_after_a_power_cut_the_axis_coasts_and_the_card_starts_afresh():
    bench = GalilBench()
    bench.say("KP 3;SH;JG 10000;BG")
    bench.clock.wait(1.0)
    bench.machine.set_fault("power_cut", True)
    assert bench.say("TP") == ""
    bench.clock.wait(0.05)
    assert 40.0 < bench.rate_dps() < 70.0
    bench.clock.wait(1.0)
    assert bench.rate_dps() == 0.0
    bench.machine.set_fault("power_cut", False)
    assert bench.say("TP") == " 0000000000\r\n:"
    assert bench.number("MG _KPX") == 12.5
    assert bench.number("MG _MOX") == 1


def test_the_past_of_the_axis_is_kept_and_smooth():
    bench = GalilBench()
    bench.say("SH;JG 10000;BG")
    bench.clock.wait(1.0)
    at = np.linspace(0.5, 0.9, 1777)
    angle, rate = bench.machine.states(at)
    assert np.abs(np.gradient(angle, at)[1:-1] - rate[1:-1]).max() < 0.05  # the loop's own ripple is 0.04 rad/s
    time, _ = bench.machine.history()
    assert (np.diff(time) > 0.0).all()
    assert time[-1] == pytest.approx(1.0)
    assert len(bench.machine.history(0.1)[0]) < 110
    bench.clock.wait(150.0)
    assert bench.machine.history()[0][0] == pytest.approx(51.0, abs=0.01)  # 100 s are kept


def test_the_same_commands_at_the_same_times_give_the_same_motion():
    ends = []
    for _ in range(2):
        bench = GalilBench(ServoSettings(cogging_torque=1e-3))
        bench.say("SH;JG 7777;BG", 0.123)
        bench.say("ST", 1.2345)
        bench.clock.wait(0.5)
        ends.append(present(bench.machine))
    assert ends[0] == ends[1]
