"""What a foreign client sets up before it moves: motor type, encoder, smoothing, homing and the sample time."""

import numpy as np
import pytest

from testkit.data import show
from testkit.emulated_axis import present
from testkit.galil_bench import GalilBench


@pytest.mark.parametrize(
    ("before", "line", "code"),
    [
        ("", "MT 2", 96), ("", "MT -2.5", 96), ("", "MT 3", 6), ("", "MT 0", 6), ("SH", "MT 1", 135),
        ("SH;JG 100;BG", "MT 1", 7), ("", "CE 16", 6), ("", "CE -1", 6), ("SH;JG 100;BG", "CE 0", 7), ("", "IT 0.003", 6),
        ("", "IT 1.1", 6), ("SH;JG 100;BG", "HM", 7), ("", "TM 31", 6), ("", "TM 20001", 6), ("", "TM 62", 143),
    ],
)  # fmt: skip
def test_what_the_card_does_not_take_has_its_code(before, line, code):
    bench = GalilBench()
    bench.say(before)
    assert bench.say(line) == "?"
    assert bench.code() == code


def test_settings_are_told_in_their_formats():
    bench = GalilBench()
    assert (
        bench.say("MT ?;CE ?;IT ?;MG _MTX,_CEX,_ITX,_HMX")
        == " 1.0\r\n: 00\r\n: 1.0000\r\n: 1.0000 0.0000 1.0000 1.0000\r\n:"
    )
    assert bench.say("MT -1.5;CEX=10;IT 0.6;MTA=?;CE ?;IT ?") == ":::-1.5\r\n: 10\r\n: 0.5977\r\n:"
    assert bench.say("TM 62.5;MG _TM") == ": 62.5000\r\n:"
    assert bench.say("TM 20000;TM ?") == ": 20000\r\n:"


def test_a_motor_and_an_encoder_that_are_both_reversed_turn_the_other_way():
    bench = GalilBench()
    bench.say("DP 500;MT -1;CE 2;SH;JG 10000;BG")
    assert bench.number("TP") == pytest.approx(500, abs=2)  # the register goes on from where it was
    bench.clock.advance(1.0)
    assert bench.mean_dps() == pytest.approx(-90.0, rel=0.002)
    assert bench.number("TV") == pytest.approx(10_000, abs=8)
    bench.say("ST")
    bench.clock.advance(1.0)
    assert abs(bench.number("TE")) <= 1


@pytest.mark.parametrize("line", ["MT -1", "CE 2"])
def test_one_of_them_alone_runs_away_until_the_error_limit(line):
    bench = GalilBench()
    bench.say(f"{line};OE 1;ER 300;SH;PR 400;BG")
    bench.clock.advance(1.0)
    assert not bench.machine.motor_on
    assert bench.number("SC") == 8


def test_smoothing_follows_the_profile_behind_it_and_arrives_exactly():
    plain, smooth = GalilBench(), GalilBench()
    for bench, share in ((plain, 1), (smooth, 0.004)):
        assert bench.say(f"TM 1000;KP 3;KD 60;IT {share};SH;SP 20000;JG 10000;BG").count(":") == 8
        bench.clock.advance(2.0)
    # the lag of a first-order filter behind a ramp: speed x T (1 - a) / a
    lag = plain.number("RP") - smooth.number("RP")
    wanted = 10_000.0 * 1e3 / 1024e3 * 255.0
    show("smoothing, counts behind", lag, round(wanted))
    assert lag == pytest.approx(wanted, rel=0.01)
    took = []
    for bench in (plain, smooth):
        bench.say("ST")
        bench.clock.advance(4.0)
        start = bench.number("MG TIME")
        before = bench.number("RP")
        bench.say("PR 4000;BG")
        while bench.number("MG _BGX"):
            bench.clock.advance(0.005)
        took.append(bench.number("MG TIME") - start)
        assert bench.number("RP") - before == 4000
    show("4000 counts, ms", took)
    assert took[1] > took[0] + 500.0


def test_smoothing_leaves_no_step_in_the_speed():
    bench = GalilBench()
    bench.say("TM 1000;KP 3;KD 60;IT 0.05;SH;AC 2000000;JG 10000;BG")
    places = []
    for _ in range(300):
        bench.clock.advance(1e-3 * 1000.0 / 1024.0)
        places.append(bench.number("RP"))
    steepest = np.abs(np.diff(places, 2)).max()
    assert steepest <= 2.0 + 0.05 * 10.0  # 2 for whole counts; AC alone reaches 9.8 counts a sample within 5 of them


def test_homing_without_a_switch_goes_backward_until_it_is_stopped():
    bench = GalilBench()
    bench.say("SH;SP 4000;HM;BG")
    bench.clock.advance(2.0)
    assert bench.mean_dps() == pytest.approx(-36.0, rel=0.01)
    assert bench.number("MG _BGX") == 1
    bench.say("ST")
    bench.clock.advance(1.0)
    assert (bench.number("MG _BGX"), bench.number("SC")) == (0, 4)


@pytest.mark.parametrize("starts_deg", [25.0, -10.0])
def test_homing_finds_the_switch_backs_off_and_calls_the_index_zero(starts_deg):
    bench = GalilBench(home_deg=-0.5)
    counts = round(starts_deg / 0.009)
    bench.say(f"SH;SP 20000;PR {counts};BG")
    bench.clock.advance(3.0)
    pressed = starts_deg < -0.5
    assert bench.number("MG _HMX") == (0 if pressed else 1)
    bench.say("DP 12345;SP 4000;HM;BG")
    bench.clock.advance(60.0)
    assert (bench.number("MG _BGX"), bench.number("SC")) == (0, 10)
    assert bench.number("RP") == 0
    assert abs(bench.number("TP")) <= 1
    turns = np.degrees(present(bench.machine)[0]) / 360.0  # the index stands at whole turns of the axis
    assert turns == pytest.approx(round(turns), abs=0.01 / 360.0)
    bench.say("PR 100;BG")
    bench.clock.advance(1.0)
    assert bench.number("RP") == 100


def test_homing_is_ended_by_an_abort_and_by_the_motor():
    bench = GalilBench(home_deg=-90.0)
    bench.say("SH;SP 4000;HM;BG")
    bench.clock.advance(0.5)
    bench.say("AB")
    assert (bench.number("MG _BGX"), bench.number("SC")) == (0, 7)
    bench.clock.advance(5.0)
    assert abs(bench.rate_dps()) < 0.2
