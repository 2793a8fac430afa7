"""A simulated ENC-03J beside a thermometer that trails: its lag is found, and taking it off is worth tenths of a deg/s."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from testkit.data import show
from undrift.drift.observe import observe_rests
from undrift.drift.temperature import (
    default_smooth_s,
    estimate_lag,
    trusted_temperature,
    without_lag,
    without_lag_smooth,
)
from undrift.record import Session, Still
from undrift.sim.device.presets import preset
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion
from undrift.units import STANDARD_GRAVITY

RATE_HZ = 10.0
LOW, HIGH = 20.0, 40.0
SLOW, FAST = 0.5, 3.0  # degC/min
GYRO_DPS = 0.67e-3 * 20.0 * 4096 / 5.0  # counts per deg/s, nominal


def at_rest(n):
    still, ones = np.zeros((n, 3)), np.ones((n, 1))
    return Motion(
        time=np.arange(n) / RATE_HZ,
        q_nb=ones * [1.0, 0.0, 0.0, 0.0],
        rate_b=still,
        mean_rate_b=still,
        force_b=ones * [0.0, 0.0, STANDARD_GRAVITY],
        gravity_m_s2=STANDARD_GRAVITY,
        moving=np.zeros(n),
    )


def device(lag_s, *, hysteresis=True):
    model = preset("enc03j_3031")
    gyro = replace(model.gyro, low_pass=None, warm_up=None, hysteresis=model.gyro.hysteresis if hysteresis else None)
    return replace(
        model,
        gyro=gyro,
        accel=replace(model.accel, low_pass=None, lever_arm=None),
        thermometer=replace(model.thermometer, lag_s=lag_s, self_heating_c=0.0),
    )


@cache
def ramped(lag_s, ramp, seed, *, hysteresis=True):
    """Return a session of one ramp up and down, degC/min."""
    half = round(60.0 * (HIGH - LOW) / ramp * RATE_HZ)
    temp = np.concatenate((np.linspace(LOW, HIGH, half), np.linspace(HIGH, LOW, half)))
    simulation = simulate_device(
        device(lag_s, hysteresis=hysteresis), at_rest(len(temp)), rng=np.random.default_rng(seed), temp_c=temp
    )
    rest = (Still(start=0, stop=len(temp)),)
    session = Session(
        kind="thermal", serial="A", gravity_m_s2=STANDARD_GRAVITY, records=(simulation.record,), stills=rest
    )
    return session


def estimated(*sessions):
    return estimate_lag(observe_rests(sessions, temperatures=[[trusted_temperature(s, 0).temp_c] for s in sessions]))


def static_table(temp, gyro):
    """Return the mean reading in cells of half a degree, both ways weighing alike."""
    cell = np.round(2.0 * temp)
    cells = np.unique(cell)
    return cells / 2.0, np.array([gyro[cell == c].mean(axis=0) for c in cells])


def error_dps(table, temp, gyro):
    residual = gyro - np.column_stack([np.interp(temp, table[0], table[1][:, k]) for k in range(3)])
    seconds = (
        residual[: len(residual) // 100 * 100].reshape(-1, 100, 3).mean(axis=1)
    )  # 10 s: the noise of a reading aside
    return float(np.sqrt(np.mean(seconds**2))) / GYRO_DPS


@pytest.mark.slow
@pytest.mark.parametrize("lag_s", [10.0, 20.0, 40.0, 80.0])
def test_lag_is_found_and_removed(lag_s):
    slow, fast = ramped(lag_s, SLOW, 1), ramped(lag_s, FAST, 2)
    lag = estimated(slow, fast)
    show(f"lag {lag_s:g} s: estimated, s", f"{lag.lag_s:.1f} +- {lag.uncertainty_s:.1f}", "4 standard deviations + 1")
    assert np.isfinite(lag.uncertainty_s)
    assert abs(lag.lag_s - lag_s) <= 4.0 * lag.uncertainty_s + 1.0
    calm = [ramped(lag_s, ramp, seed, hysteresis=False) for ramp, seed in ((SLOW, 3), (FAST, 4))]
    trusted, record = trusted_temperature(calm[0], 0), calm[0].records[0]
    smooth_s = default_smooth_s(lag.lag_s, trusted)
    plain = static_table(trusted.temp_c, record.gyro)
    lagless = static_table(without_lag_smooth(trusted, lag_s=lag.lag_s), record.gyro)
    errors = {}
    for name, session in zip(("slow", "fast"), calm, strict=True):
        ramp = session.records[0]
        led, _ = without_lag(ramp.temp_c, ramp.time, lag_s=lag.lag_s, smooth_s=smooth_s)
        errors[name] = (error_dps(plain, ramp.temp_c, ramp.gyro), error_dps(lagless, led, ramp.gyro))
        show(
            f"lag {lag_s:g} s, {name} ramp: rate error of a static table, deg/s",
            f"{errors[name][0]:.4f} with the lag, {errors[name][1]:.4f} without (tau_f {smooth_s:.1f} s)",
        )
    with_lag, without = errors["fast"]
    residual = np.hypot(
        smooth_s / lag_s * with_lag, errors["slow"][1]
    )  # the lag tau_f that the lead leaves, and the noise of 10 s
    show(f"lag {lag_s:g} s, fast ramp: expected of the lead, deg/s", f"{residual:.4f}", "1.25 times it")
    assert without < 1.25 * residual  # a quarter more: chosen from the runs shown, 1.04 to 1.17 times it
    assert without < 0.5 * with_lag
