"""A chamber's temperatures are those of its equations, and a soak is one."""

import math

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.sim.thermal import (
    ChamberSettings,
    RampSettings,
    WarmUpSettings,
    ramp_profile,
    soak_profile,
    warm_up_profile,
)

SUDDEN = 1e9  # degC/min: the set-point jumps within a step


def test_the_air_overshoots_a_sudden_step_by_what_its_damping_says() -> None:
    settings = ChamberSettings(ramp_rate_c_per_min=SUDDEN, damping=0.5, air_lag_s=600.0, soak_hold_s=5000.0)
    profile = soak_profile((20.0, 30.0), measured_s=1.0, settings=settings)
    overshoot = profile.air_c.max() - 30.0
    # exp(-pi z / sqrt(1 - z^2)) of the step; the set-point takes 1 s of a lag of 600 s
    assert overshoot == pytest.approx(10.0 * math.exp(-math.pi * 0.5 / math.sqrt(0.75)), rel=1e-3)


def test_the_board_follows_quick_air_as_an_exponential() -> None:
    settings = ChamberSettings(ramp_rate_c_per_min=SUDDEN, air_lag_s=0.1, damping=1.0, board_lag_s=500.0)
    profile = soak_profile((20.0, 30.0), measured_s=1.0, settings=settings)
    since = profile.time - profile.soaks[1].begin_s
    after = since > 2.0
    expected = 30.0 - 10.0 * np.exp(-since[after] / 500.0)
    # the set-point takes one step of 1 s, which delays the board by half of it, and the air by 0.2 s: 0.7 s of 10 K / 500 s
    np.testing.assert_allclose(profile.board_c[after], expected, atol=0.016)


def test_on_a_long_ramp_the_board_lags_by_the_sum_of_the_lags() -> None:
    settings = ChamberSettings(air_lag_s=60.0, damping=0.7, board_lag_s=200.0)
    profile = ramp_profile(
        RampSettings(low_c=20.0, high_c=80.0, up_c_per_min=1.5, down_c_per_min=0.0), settings=settings
    )
    k = int(np.argmax(profile.set_point_c == 80.0)) - 1
    # of the start, 7 K exp(-2400 s / 200 s) is left
    assert profile.set_point_c[k] - profile.board_c[k] == pytest.approx(1.5 / 60.0 * (2 * 0.7 * 60.0 + 200.0), abs=1e-4)
    assert profile.set_point_c[-1] == 80.0


def test_a_ramp_comes_back_and_the_play_remembers_its_turn() -> None:
    profile = ramp_profile(RampSettings(low_c=20.0, high_c=30.0, up_c_per_min=2.0, down_c_per_min=1.0, hold_s=300.0))
    moves = np.diff(profile.set_point_c) * 60.0
    assert moves.max() == pytest.approx(2.0)
    assert moves.min() == pytest.approx(-1.0)
    np.testing.assert_allclose(profile.turns_before(math.inf), [20.0, profile.board_c.max()])
    assert len(profile.turns_before(0.0)) == 0


def test_the_set_point_never_moves_faster_than_the_limit_and_arrives() -> None:
    profile = soak_profile((18.0, 25.0, 20.3), measured_s=30.0)
    assert np.abs(np.diff(profile.set_point_c)).max() * 60.0 <= 2.0 + 1e-9
    assert [float(profile.set_point_c[int(soak.end_s)]) for soak in profile.soaks] == [18.0, 25.0, 20.3]


def test_a_soaked_board_changes_by_less_than_the_limit_throughout_the_measurement() -> None:
    profile = soak_profile((18.0, 25.0, 75.0, 40.0), measured_s=500.0)
    for soak in profile.soaks:
        measured = (profile.time >= soak.soaked_s) & (profile.time <= soak.end_s)
        assert np.abs(np.diff(profile.board_c[measured])).max() * 60.0 < 0.1
        # what is left of a lag of 240 s at 0.1 K/min
        assert np.abs(profile.board_c[measured] - soak.set_point_c).max() < 240.0 * 0.1 / 60.0
        assert soak.end_s - soak.soaked_s == 500.0


def test_the_default_warm_up_is_that_of_the_recorded_board() -> None:
    profile = warm_up_profile(WarmUpSettings())
    # the recording: 7 degC in 2 min, 28.94 degC at its end
    assert float(np.interp(120.0, profile.time, profile.board_c)) - profile.board_c[0] == pytest.approx(7.0, abs=0.2)
    assert profile.board_c[-1] == pytest.approx(28.94, abs=0.1)
    assert np.isnan(profile.air_c).all()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ChamberSettings(board_lag_s=0.0), "board_lag_s` must be above 0, got 0"),
        (lambda: soak_profile((), measured_s=1.0), "at least one set-point"),
        (
            lambda: soak_profile((20.0, 120.0), measured_s=1.0, settings=ChamberSettings(board_lag_s=1e4)),
            "below 0.1 degC/min within 14400 s at 120 degC, got",
        ),
    ],
)
def test_what_no_chamber_can_do_is_refused(make, message: str) -> None:
    with pytest.raises(InputError) as raised:
        make()
    assert message in str(raised.value)
