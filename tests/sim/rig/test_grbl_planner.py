"""The planner: whatever is asked from whatever speed, the axis goes as far as it was told and ends at rest."""

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from undrift.base.clock import VirtualClock
from undrift.sim.rig.grbl import GrblBoard, GrblSettings, plan

MOVES = st.lists(st.tuples(st.floats(-400.0, 400.0), st.floats(0.02, 360.0)), min_size=1, max_size=16)


def driven(legs, rate):
    """Return distance, end rate, highest speed and greatest acceleration of legs, deg and s."""
    distance, fastest, hardest = 0.0, abs(rate), 0.0
    for duration, acceleration in legs:
        distance += duration * (rate + 0.5 * acceleration * duration)
        rate += duration * acceleration
        fastest, hardest = max(fastest, abs(rate)), max(hardest, abs(acceleration))
    return distance, rate, fastest, hardest


@given(moves=MOVES, rate=st.floats(-360.0, 360.0), acceleration=st.floats(10.0, 5000.0))
@example(moves=[(-1e-9, 60.0), (7.5, 60.0)], rate=60.0, acceleration=2300.0)
@example(moves=[(7.5, 60.0)], rate=-60.0, acceleration=2300.0)
@example(moves=[(0.1, 60.0)], rate=60.0, acceleration=2300.0)
@example(moves=[(1e-9, 60.0), (7.5, 60.0)], rate=60.00000001, acceleration=2300.0)
@example(moves=[(0.0, 60.0)], rate=0.0, acceleration=2300.0)
@example(moves=[(1.0, 2.0), (2.220446049250313e-16, 2.0), (1.0, 1.5)], rate=0.0, acceleration=10.0)
def test_any_chain_from_any_speed_goes_as_far_as_wanted_and_ends_at_rest(moves, rate, acceleration):
    legs, ends = plan(moves, rate, acceleration)
    distance, left, fastest, hardest = driven(legs, rate)
    wanted = sum(distance for distance, _ in moves)
    travelled = sum(abs(distance) for distance, _ in moves) + rate * rate / acceleration
    assert distance == pytest.approx(wanted, abs=1e-9 * (1.0 + travelled))
    assert left == pytest.approx(0.0, abs=1e-6)
    assert fastest <= max(abs(rate), *(feed for _, feed in moves)) + 1e-6
    assert hardest <= acceleration * (1.0 + 1e-4) + 1e-9
    assert len(ends) == len(moves)
    assert ends == sorted(ends)
    assert ends[-1] == pytest.approx(sum(duration for duration, _ in legs), abs=1e-9)


def test_a_joint_that_rounding_has_passed_does_not_disturb_a_steady_rate():
    legs, _ = plan([(-1e-9, 60.0), (7.5, 60.0)], 60.0, 2300.0)
    assert [acceleration for _, acceleration in legs] == [0.0, -2300.0]
    legs, _ = plan([(1e-9, 60.0), (7.5, 60.0)], 60.0 + 1e-8, 2300.0)
    assert min(60.0 + duration * change for duration, change in legs[:-1]) > 59.999


@pytest.mark.slow
@given(waits=st.lists(st.floats(0.0, 0.4), min_size=5, max_size=60))
def test_a_steady_chain_never_leaves_its_rate_whenever_its_jogs_come(waits):
    clock = VirtualClock()
    board = GrblBoard(GrblSettings(acceleration_deg_s2=2300.0), clock)
    goal = 0.0
    for wait in waits:
        if not board.full:
            board.do("$J=G91A7.53740F3600")
            goal += 7.53740
        clock.wait(wait)
        board.advance()
        rate = board.stepper.pulses.at(clock.now())[1]
        assert -1e-6 <= rate <= 60.0 + 1e-6
    clock.wait(60.0)
    board.advance()
    assert board.state == "Idle"
    angle, rate = board.stepper.pulses.at(clock.now())
    assert rate == 0.0
    assert angle == pytest.approx(goal, abs=0.5 * len(waits) / board.of_axis(100))


@pytest.mark.slow
@given(st.lists(st.tuples(st.sampled_from("jjjjc!~"), st.floats(-30.0, 30.0), st.floats(0.0, 0.3)), max_size=40))
def test_whatever_jogs_and_cancels_come_the_axis_keeps_within_the_feed_and_rests(events):
    clock = VirtualClock()
    board = GrblBoard(GrblSettings(acceleration_deg_s2=2300.0), clock)
    for what, distance, wait in events:
        if what == "j" and not board.full:
            board.do(f"$J=G91A{distance:.4f}F5400")
        elif what != "j":
            board.at_once({"c": "\x85"}.get(what, what))
        clock.wait(wait)
        board.advance()
        assert math.isfinite(board.stepper.pulses.at(clock.now())[0])
        assert abs(board.stepper.pulses.at(clock.now())[1]) <= 90.0 + 1e-3
    clock.wait(60.0)
    board.advance()
    assert board.state == "Idle"
    assert board.stepper.pulses.at(clock.now())[1] == 0.0
