"""A chamber has the temperatures of its equations, and sessions contain the readings at these temperatures."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from testkit.quiet import without_noise
from undrift.correction.correct import correct
from undrift.errors import InputError
from undrift.sim.device.effects import Sampling, Thermometer
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import preset
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.thermal import (
    ChamberSettings,
    ThermalChamber,
    ThermalSettings,
    simulate_thermal_session,
    soak_profile,
)

SUDDEN = 1e9  # degC/min: the set-point jumps within a step
AIR, BOARD, SET_POINT = 0, 2, 3  # columns of a chamber's states


def test_the_air_overshoots_a_sudden_step_by_what_its_damping_says() -> None:
    chamber = ThermalChamber(ChamberSettings(damping=0.5, air_lag_s=600.0), 20.0)
    chamber.ramp_to(30.0, SUDDEN)
    chamber.wait(5000.0)
    overshoot = np.array(chamber.states)[:, AIR].max() - 30.0
    # exp(-pi z / sqrt(1 - z^2)) of the step; the set-point takes 1 s of a lag of 600 s
    assert overshoot == pytest.approx(10.0 * math.exp(-math.pi * 0.5 / math.sqrt(0.75)), rel=1e-3)


def test_on_a_long_ramp_the_board_lags_by_the_sum_of_the_lags() -> None:
    chamber = ThermalChamber(ChamberSettings(air_lag_s=60.0, damping=0.7, board_lag_s=200.0), 20.0)
    chamber.ramp_to(80.0, 1.5)
    states = np.array(chamber.states)
    # of the start, 7 K exp(-2400 s / 200 s) is left
    lag_k = states[-2, SET_POINT] - states[-2, BOARD]
    assert lag_k == pytest.approx(1.5 / 60.0 * (2 * 0.7 * 60.0 + 200.0), abs=1e-4)
    assert states[-1, SET_POINT] == 80.0


def test_a_soaked_board_changes_by_less_than_the_limit_throughout_the_measurement() -> None:
    points = (18.0, 25.0, 75.0, 40.0)
    profile = soak_profile(points, 500.0, ChamberSettings())
    for set_point_c, soaked_s in zip(points, profile.soaked_s, strict=True):
        measured = (profile.time >= soaked_s) & (profile.time <= soaked_s + 500.0)
        assert np.abs(np.diff(profile.board_c[measured])).max() * 60.0 < 0.1
        # what is left of a lag of 240 s at 0.1 K/min
        assert np.abs(profile.board_c[measured] - set_point_c).max() < 240.0 * 0.1 / 60.0


QUICK = ChamberSettings(ramp_rate_c_per_min=20.0, air_lag_s=5.0, board_lag_s=10.0, soak_hold_s=10.0)
BENCH = BenchSettings(sample_rate_hz=50.0, still_s=2.0, move_s=1.0, turn_rates=(0.5, 1.5), dwell_s=1.0)
SHORT = ThermalSettings(bench=BENCH, chamber=QUICK, set_points_c=(20.0, 35.0, 50.0))


def rng() -> np.random.Generator:
    return np.random.default_rng(4)


def quiet() -> DeviceModel:
    """The note's device without noise and steps."""
    device = without_noise(preset("enc03j_3031"))
    return replace(device, gyro=replace(device.gyro, instability=None), accel=replace(device.accel, instability=None))


def settled() -> DeviceModel:
    """The same without what a table over rate and temperature does not hold: age, hysteresis, an erring thermometer."""
    device = quiet()
    return replace(
        device,
        gyro=replace(device.gyro, warm_up=None, hysteresis=None),
        thermometer=Thermometer(),
        reference_temp_c=25.0,
    )


def test_the_true_tables_turn_the_dwells_into_the_imposed_rates() -> None:
    device = settled()
    session = simulate_thermal_session("soak", device, rng=rng(), settings=SHORT)
    tables = true_tables(device, np.arange(15.0, 56.0, 1.0), np.radians(np.arange(-200.0, 201.0, 10.0)))
    record = correct(session.records[0], replace(true_calibration(device), drift=tables))
    assert len(session.turns) == 3 * 3 * 4
    assert record.gyro is not None
    for turn in session.turns:
        rate = np.zeros(3)
        rate["xyz".index(turn.axis or "")] = turn.turn_rate or 0.0
        steady = record.gyro[turn.start + 25 : turn.stop]  # the low-pass of 11.1 Hz has settled after half a second
        # Nodes 1 K apart leave 1/8 of the second difference: 2e-5 rad/s of the rate drift's slope between nodes 10 deg/s apart.
        np.testing.assert_allclose(steady, np.broadcast_to(rate, steady.shape), atol=3e-4)


def test_the_hysteresis_of_a_visit_on_the_way_down_is_the_other_one() -> None:
    device = quiet()
    plain = replace(device, gyro=replace(device.gyro, hysteresis=None))
    settings = replace(SHORT, set_points_c=(20.0, 35.0, 50.0), back=True, bench=replace(BENCH, turn_rates=()))
    with_loop, without = (
        simulate_thermal_session("soak", d, rng=rng(), settings=settings).records[0] for d in (device, plain)
    )
    visits = np.split(with_loop.gyro - without.gyro, np.flatnonzero(np.diff(with_loop.time) > 1.0) + 1)  # type: ignore[operator]
    loop = np.array([visit[:, 0].mean() for visit in visits]) / device.gyro.gain
    amplitude = device.gyro.hysteresis.amplitude[0]  # type: ignore[union-attr]
    # from rest at 20 degC; -A while warming, +A while cooling. 50 degC is approached from both sides by way of itself.
    np.testing.assert_allclose(loop / amplitude, [0.0, -1.0, -1.0, -1.0, 1.0, 1.0], atol=0.1)


def test_a_ramp_goes_up_and_down_and_a_warm_up_begins_at_power_on() -> None:
    ramp = replace(SHORT, ramp_c=(20.0, 30.0), ramp_c_per_min=5.0, ramp_hold_s=60.0)
    up_down = simulate_thermal_session("ramp", settled(), rng=rng(), settings=ramp)
    assert len(up_down.stills) == 1
    temp = up_down.records[0].temp_c
    assert temp is not None
    assert temp.max() == pytest.approx(30.0, abs=0.5)
    assert temp[[0, -1]] == pytest.approx([20.0, 20.0], abs=0.5)
    young = quiet()
    old = replace(young, gyro=replace(young.gyro, warm_up=None))
    bench = replace(BENCH, sample_rate_hz=10.0)
    lack = [
        simulate_thermal_session("warm_up", d, rng=rng(), settings=replace(SHORT, bench=bench)).records[0]
        for d in (young, old)
    ]
    lacking = (lack[0].gyro - lack[1].gyro)[:, 0] / young.gyro.gain  # type: ignore[operator,index]
    expected = -young.gyro.warm_up.amplitude[0] * np.exp(-lack[0].time / 600.0)  # type: ignore[union-attr]
    np.testing.assert_allclose(lacking, expected, atol=1e-6)  # the low-pass lags by 20 ms of 600 s


def test_labels_lie_right_on_the_samples_of_a_device_with_a_clock_of_its_own() -> None:
    device = replace(settled(), sampling=Sampling(sample_rate_hz=40.0, clock_error=1e-4))
    session = simulate_thermal_session("soak", device, rng=rng(), settings=SHORT)
    record = session.records[0]
    assert record.sample_rate_hz == pytest.approx(40.0, rel=1e-3)
    for turn in session.turns[::5]:
        column = record.gyro[:, "xyz".index(turn.axis or "")]  # type: ignore[index]
        assert turn.stop - turn.start == pytest.approx(40, abs=1)
        assert np.ptp(column[turn.start + 20 : turn.stop]) < 0.5  # counts, of some 600 that the rate makes


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: simulate_thermal_session("fridge", quiet(), rng=rng()), "soak, ramp, warm_up"),  # type: ignore[arg-type]
        (lambda: soak_profile((20.0, 120.0), 1.0, ChamberSettings(board_lag_s=1e4)), "within 14400 s at 120 degC"),
    ],
)
def test_an_impossible_thermal_session_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()
