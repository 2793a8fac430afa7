"""A chamber's temperatures are those of its equations, and a soak is one."""

import math

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.sim.thermal import (
    ChamberSettings,
    ThermalChamber,
    ThermalSettings,
    ramp_profile,
    soak_profile,
    warm_up_profile,
)

SUDDEN = 1e9  # degC/min: the set-point jumps within a step
AIR, BOARD, SET_POINT = 0, 2, 3  # columns of a chamber's states


def stepped(**settings: float) -> np.ndarray:
    chamber = ThermalChamber(ChamberSettings(**settings), 20.0)
    chamber.ramp_to(30.0, SUDDEN)
    chamber.wait(5000.0)
    return np.array(chamber.states)


def test_the_air_overshoots_a_sudden_step_by_what_its_damping_says() -> None:
    overshoot = stepped(damping=0.5, air_lag_s=600.0)[:, AIR].max() - 30.0
    # exp(-pi z / sqrt(1 - z^2)) of the step; the set-point takes 1 s of a lag of 600 s
    assert overshoot == pytest.approx(10.0 * math.exp(-math.pi * 0.5 / math.sqrt(0.75)), rel=1e-3)


def test_the_board_follows_quick_air_as_an_exponential() -> None:
    board_c = stepped(air_lag_s=0.1, damping=1.0, board_lag_s=500.0)[:, BOARD]
    time = np.arange(len(board_c))
    # the set-point takes one step of 1 s, which delays the board by half of it, and the air by 0.2 s: 0.7 s of 10 K / 500 s
    np.testing.assert_allclose(board_c[3:], (30.0 - 10.0 * np.exp(-time / 500.0))[3:], atol=0.016)


def test_on_a_long_ramp_the_board_lags_by_the_sum_of_the_lags() -> None:
    chamber = ThermalChamber(ChamberSettings(air_lag_s=60.0, damping=0.7, board_lag_s=200.0), 20.0)
    chamber.ramp_to(80.0, 1.5)
    states = np.array(chamber.states)
    # of the start, 7 K exp(-2400 s / 200 s) is left
    lag_k = states[-2, SET_POINT] - states[-2, BOARD]
    assert lag_k == pytest.approx(1.5 / 60.0 * (2 * 0.7 * 60.0 + 200.0), abs=1e-4)
    assert states[-1, SET_POINT] == 80.0


def test_a_ramp_comes_back_and_the_play_remembers_its_turn() -> None:
    profile = ramp_profile(ThermalSettings(ramp_c=(20.0, 30.0), ramp_c_per_min=2.0, ramp_hold_s=300.0))
    np.testing.assert_allclose(profile.turns_before(math.inf), [20.0, profile.board_c.max()])
    assert len(profile.turns_before(0.0)) == 0


def test_the_set_point_never_moves_faster_than_the_limit_and_arrives() -> None:
    chamber = ThermalChamber(ChamberSettings(), 18.0)
    for set_point_c in (25.0, 20.3):
        chamber.ramp_to(set_point_c, 2.0)
        assert chamber.states[-1][SET_POINT] == set_point_c
    assert np.abs(np.diff(np.array(chamber.states)[:, SET_POINT])).max() * 60.0 <= 2.0 + 1e-9


def test_a_soaked_board_changes_by_less_than_the_limit_throughout_the_measurement() -> None:
    points = (18.0, 25.0, 75.0, 40.0)
    profile = soak_profile(points, 500.0, ChamberSettings())
    for set_point_c, soaked_s in zip(points, profile.soaked_s, strict=True):
        measured = (profile.time >= soaked_s) & (profile.time <= soaked_s + 500.0)
        assert np.abs(np.diff(profile.board_c[measured])).max() * 60.0 < 0.1
        # what is left of a lag of 240 s at 0.1 K/min
        assert np.abs(profile.board_c[measured] - set_point_c).max() < 240.0 * 0.1 / 60.0


def test_the_default_warm_up_is_that_of_the_recorded_board() -> None:
    profile = warm_up_profile(ThermalSettings())
    # the recording: 7 degC in 2 min, 28.94 degC at its end
    assert float(np.interp(120.0, profile.time, profile.board_c)) - profile.board_c[0] == pytest.approx(7.0, abs=0.2)
    assert profile.board_c[-1] == pytest.approx(28.94, abs=0.1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ChamberSettings(board_lag_s=0.0), "board_lag_s` must be above 0, got 0"),
        (lambda: soak_profile((), 1.0, ChamberSettings()), "at least one set-point"),
        (
            lambda: soak_profile((20.0, 120.0), 1.0, ChamberSettings(board_lag_s=1e4)),
            "below 0.1 degC/min within 14400 s at 120 degC, got",
        ),
    ],
)
def test_what_no_chamber_can_do_is_refused(make, message: str) -> None:
    with pytest.raises(InputError) as raised:
        make()
    assert message in str(raised.value)
