"""Daily recordings of a device as a thermal session: two weeks of simulated use, each day one switch-on."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.daily_use import DailyUseSettings, simulate_daily_use
from testkit.data import show
from undrift.drift.fit import fit_drift
from undrift.errors import NotObservable
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.tasks import draw_task
from undrift.units import RADIAN_PER_DEGREE as DPS
from undrift.units import STANDARD_GRAVITY

DAYS = 14
STEEP = np.array([[0.03, -0.02, 0.01], [5e-4, 0.0, -5e-4]]) * DPS  # offset over temperature, rad/s per K and per K2
# An estimator made for daily use, with priors for turn-on and ageing, was once given the same fourteen days. Per axis, deg/s:
FORMER_RMS = np.array([0.0080, 0.0102, 0.0118])  # its rms error
FORMER_MEAN = np.array([0.0097, 0.0091, 0.0138])  # standard uncertainty that it stated for the mean over switch-ons
FORMER_TO_COME = np.array([0.0262, 0.0282, 0.0381])  # and for a future switch-on


@pytest.fixture(scope="module")
def two_weeks():
    """Return a device with a steep offset, its calibration at one temperature, and fourteen days of use."""
    rng = np.random.default_rng(5)
    device = random_device(rng, grade="mpu6050")
    device = replace(
        device,
        gyro=replace(device.gyro, offset=replace(device.gyro.offset, per_k=STEEP)),
        thermometer=replace(device.thermometer, trim_error_c=0.0),
    )
    days = list(simulate_daily_use(device, rng=rng, settings=DailyUseSettings(days=DAYS)))
    return device, true_calibration(device), days


@pytest.fixture(scope="module")
def fitted(two_weeks):
    _, calibration, days = two_weeks
    return fit_drift([day.session for day in days], calibration)


def errors_dps(table, two_weeks):
    """Return error and stated uncertainty of the offsets near data, (n, 3), deg/s; true is the mean over the days."""
    device, calibration, days = two_weeks
    near, si = ~table.gyro_extrapolated, 1.0 / calibration.gyro.scale_factor / DPS
    aged = np.mean([day.aged for day in days], axis=0) / DPS
    true = np.array([true_calibration(device, temp_c=t).gyro.offset for t in table.temp_c[near]]) * si + aged
    return table.gyro_offset[near] * si - true, table.gyro_uncertainty[near] * si


def test_two_weeks_of_recordings_give_the_offset(two_weeks, fitted):
    table = fitted.static.table
    error, stated = errors_dps(table, two_weeks)
    near = table.temp_c[~table.gyro_extrapolated]
    show("degC of nodes near data", near[[0, -1]])
    show("rms error, deg/s", np.sqrt((error**2).mean(axis=0)), FORMER_RMS)
    show("largest error, deg/s", np.abs(error).max(axis=0), 2.0 * FORMER_MEAN)
    show("largest error over the stated uncertainty", np.abs(error / stated).max(axis=0), 2.0)
    show("stated for a future switch-on, deg/s", stated.mean(axis=0), 1.25 * FORMER_TO_COME)
    assert near[0] < 5.0
    assert near[-1] > 30.0
    assert (np.sqrt((error**2).mean(axis=0)) < FORMER_RMS).all()
    assert (np.abs(error) < 2.0 * FORMER_MEAN).all()
    assert (np.abs(error) < 2.0 * stated).all()
    assert (stated.mean(axis=0) < 1.25 * FORMER_TO_COME).all()  # no prior draws the turn-on of the three axes together


def test_a_recording_without_a_rest_is_left_out_with_a_finding(two_weeks, fitted):
    device, calibration, days = two_weeks
    rng = np.random.default_rng(1)
    motion = draw_task("free", rng=rng, rest_s=0.0).at(np.arange(0.0, 30.0, 0.04), STANDARD_GRAVITY)
    moved = simulate_device(device, motion, rng=rng, temp_c=np.linspace(20.0, 24.0, len(motion.time))).record
    walk = replace(days[0].session, records=(moved,), inputs=(("walk.csv", "0" * 64),))
    fit = fit_drift([*(day.session for day in days), walk], calibration)
    left_out = next(item for item in fit.verdict.findings if item.code == "drift.left_out")
    assert "walk.csv" in left_out.text
    np.testing.assert_array_equal(fit.static.table.gyro_offset, fitted.static.table.gyro_offset)
    with pytest.raises(NotObservable, match="rest"):
        fit_drift([walk], calibration)


# ---- the simulated days
