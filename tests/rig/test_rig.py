"""Addresses of rigs."""

import contextlib

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError, LimitError, RigFault, RigTimeout
from undrift.rig.judge import check_delays, check_rate
from undrift.rig.rig import (
    Limits,
    Position,
    achieved_turn_rate,
    open_rig,
    parse_address,
    to_counts,
)
from undrift.units import RADIAN_PER_DEGREE as DPS


def test_an_address_names_the_rig_its_link_and_its_options():
    kind, url, settings = parse_address("galil:serial:///dev/ttyUSB0?baud=9600&encoder_lines=2500&axis=b")
    assert (kind, url) == ("galil", "serial:///dev/ttyUSB0")
    assert (settings.baud, settings.encoder_lines, settings.axis) == (9600, 2500, "B")


KINDS = "rig: expected one of galil:..., grbl:..., manual:..., simulated:..., got"


@pytest.mark.parametrize(
    ("address", "text"),
    [
        ("galil", KINDS),
        ("lathe:tcp://host:1", KINDS),
        ("galil:tcp://127.0.0.1:1?limits=9", "unknown option 'limits'"),
        ("galil:tcp://127.0.0.1:1?baud", "expected options as name=value"),
        ("galil:tcp://127.0.0.1:1?baud=fast", "'fast' is not a value"),
        ("simulated:?clock_speed=0", "must be positive"),
    ],
)
def test_an_address_that_opens_no_rig_is_refused(address, text):
    with pytest.raises(InputError, match=text):
        open_rig(address)


def test_limits_refuse_what_goes_beyond_and_allow_what_meets_them():
    limits = Limits(turn_rate=1.0, acceleration=2.0, travel=3.0)
    limits.check_turn_rate(-1.0)
    limits.check_acceleration(2.0)
    limits.check_travel(-3.0)
    with pytest.raises(LimitError, match=r"at most 57.2958 deg/s .*, got -63"):
        limits.check_turn_rate(-1.1)
    with pytest.raises(LimitError, match=r"acceleration: at most 114.592 deg/s2 .*, got 0"):
        limits.check_acceleration(0.0)
    with pytest.raises(LimitError, match=r"travel: at most 171.887 deg .*177"):
        limits.check_travel(3.1)
    with pytest.raises(LimitError, match="turn rate"):
        limits.check_turn_rate(float("nan"))


@pytest.mark.parametrize(("command", "counts"), [("SP", 0.4), ("AC", 500.0), ("PR", 3e9)])
def test_what_the_card_cannot_hold_is_refused_with_its_range(command, counts):
    with pytest.raises(LimitError, match=rf"{command}: the card accepts \d+ to \d+ in steps of \d+"):
        to_counts(command, counts)


def positions(angles, times, within_s):
    late = np.broadcast_to(within_s, np.shape(times))
    return [
        Position(angle=float(a), time=float(t), within_s=float(d)) for a, t, d in zip(angles, times, late, strict=True)
    ]


@pytest.mark.parametrize("turn_rate", [0.5, 90.0])
@pytest.mark.parametrize(("begin", "part"), [(0.75, 0.25), (0.4, 0.25), (0.5, 0.1)], ids=["end", "middle", "short"])
def test_an_axis_that_stands_still_for_a_part_of_a_dwell_is_refused(turn_rate, begin, part):
    rate, seconds = turn_rate * DPS, 6.0
    times = np.linspace(0.3, seconds, 60)
    stood = np.clip(times - begin * seconds, 0.0, part * seconds)

    def judged(moving_s):
        check_rate(achieved_turn_rate(positions(rate * moving_s, times, 0.002)), rate, "step 1")

    judged(times)
    with pytest.raises(RigFault, match=r"rig: expected (a steady turn|.* rad/s) within .*in step 1, got"):
        judged(times - stood)


def test_a_stop_that_the_mean_rate_makes_up_for_is_off_the_straight_line():
    times = np.linspace(0.0, 6.0, 61)
    angles = times + 0.05 * np.sin(2.0 * np.pi * times / 3.0)
    with pytest.raises(RigFault, match=r"steady turn within 0.05 deg in step 1, got"):
        check_rate(achieved_turn_rate(positions(angles, times, 0.0005)), 1.0, "step 1")


def test_quick_answers_count_more_in_the_achieved_rate():
    times = np.arange(20) * 0.1
    late = np.where(np.arange(20) == 18, 0.05, 0.0)
    even = achieved_turn_rate(positions(2.0 * (times - late), times, 0.0005))
    weighted = achieved_turn_rate(positions(2.0 * (times - late), times, 0.0005 + late))
    assert abs(weighted.turn_rate - 2.0) < 1e-3 * abs(even.turn_rate - 2.0) + 1e-5
    assert weighted.uncertainty < even.uncertainty
    with pytest.raises(InputError, match=r"three positions .*got 2"):
        achieved_turn_rate(positions([0.0, 1.0], [0.0, 1.0], 0.0))


@pytest.mark.parametrize(("within_s", "hidden"), [(0.024, False), (0.026, True)])
def test_a_link_whose_delays_could_hide_a_tenth_of_the_rate_is_not_believed(within_s, hidden):
    times = np.linspace(0.0, 1.0, 21)
    achieved = achieved_turn_rate(positions(times, times, within_s))
    with pytest.raises(RigTimeout, match="must be known to 10%") if hidden else contextlib.nullcontext():
        check_delays(achieved, -1.0, "step 1")


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 5, 20])
def test_few_positions_on_a_line_by_chance_do_not_make_the_rate_certain(count):
    rng, delay_s = np.random.default_rng(3), 0.02
    found = []
    for _ in range(2000):
        times = np.linspace(0.0, 2.0, count)
        late = rng.uniform(-0.5, 0.5, count) * delay_s
        found.append(achieved_turn_rate(positions(times + late, times, 0.5 * delay_s)))
    beyond = np.mean([abs(each.turn_rate - 1.0) > 3.0 * each.uncertainty for each in found])
    show(f"{count} positions: rates beyond three standard uncertainties, %", 100.0 * beyond)
    assert beyond < 0.015  # Student, 18 degrees of freedom: 0.8 %; and three standard errors of 2,000 draws
