"""Dynamic drift: the table over measured rate and temperature."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.rate_steps import GRID, SOAKS, computed
from undrift.drift.rates import fit_dynamic, measured_rate, prepared
from undrift.errors import NotObservable
from undrift.sim.device.effects import RateDrift
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration, true_tables

FEW = GRID[1::2]
TEMPS = SOAKS[::2]
NODES = np.arange(18.0, 75.01, 0.5)
CUBIC = np.zeros((3, 2, 3))
CUBIC[2, 1] = np.array([1.0, -1.0, 0.7]) * 1e-4


def device(**changes):
    model = random_device(np.random.default_rng(0), grade="enc03j_3031")
    changes = {"thermal_scale": None, "rate_drift": RateDrift(coefficients=CUBIC), **changes}
    return replace(model, gyro=replace(model.gyro, nonlinearity=None, **changes))


def fitted(made, temps=TEMPS, noise_dps=1e-5, steps=None, **kept):
    if steps is None:
        steps = computed(made, temps, np.random.default_rng(1), rates=FEW, noise_dps=noise_dps, **kept)
    table = true_tables(made, NODES, np.radians([-90.0, 90.0])).static
    calibration = true_calibration(made).gyro
    return fit_dynamic(prepared(steps, calibration, static=table), calibration, span_c=(15.0, 75.0))


def test_the_table_is_that_of_the_device_over_measured_rate():
    model = device()
    fit = fitted(model)
    truth = true_tables(model, fit.drift.temp_c, fit.drift.turn_rate).dynamic
    seen = ~fit.drift.extrapolated
    # e reaches 1.1 deg/s; knots every 30 deg/s hold a cubic, and what smoothing is left costs 1 % of it.
    assert np.degrees(np.abs(fit.drift.error - truth.error)[seen]).max() < 0.01
    assert np.degrees(np.abs(truth.error[seen])).max() > 0.4


def test_nodes_are_the_imposed_rates():
    fit = fitted(device())
    assert 0.0 in fit.drift.turn_rate
    nearest = np.abs(np.concatenate((-FEW, FEW))[:, None] - fit.drift.turn_rate).min(axis=1)
    assert nearest.max() < 1e-9
    assert np.array_equal(fit.drift.temp_c, np.arange(15.0, 76.0, 5.0))
    assert (fit.drift.error[:, fit.drift.turn_rate == 0.0] == 0.0).all() or np.abs(
        fit.drift.error[:, fit.drift.turn_rate == 0.0]
    ).max() < 1e-12


def test_rates_measured_beyond_the_imposed_ones_get_a_node():
    model = random_device(np.random.default_rng(0), grade="enc03j_3031")
    fit = fitted(model)
    assert fit.drift.turn_rate[-1] > 1.01 * FEW[-1]
    # Only the hottest soaks reach it, and not with every axis: a node counts as seen where all turned axes saw it.
    assert fit.drift.extrapolated[0, -1]
    inside = np.abs(fit.drift.turn_rate) < 0.9 * FEW[-1]
    soaked = (fit.drift.temp_c > 17.5) & (fit.drift.temp_c < 75.5)
    assert not fit.drift.extrapolated[np.ix_(soaked, inside)].any()


def test_cross_axis_rate_is_left_to_the_matrix():
    result = device(rate_drift=None)
    steps = computed(result, TEMPS, np.random.default_rng(1), rates=FEW, noise_dps=1e-3)
    model = true_calibration(result).gyro
    crossed = (
        steps.gyro
        + (steps.rate_b[:, [1]] * 0.02 * (steps.temp_c[:, None] - 25.0) / 50.0)
        @ (model.forward_matrix @ np.eye(3)[:, :1]).T
    )
    fit = fitted(result, steps=replace(steps, gyro=crossed))
    # Turns about y feign up to 1.8 deg/s about x here; the table of x holds what the noise of 1 mdeg/s leaves.
    assert np.degrees(np.abs(fit.drift.error[..., 0])[~fit.drift.extrapolated]).max() < 0.005


def test_axis_without_a_turn_has_no_uncertainty():
    fit = fitted(device(), axes=(0, 2))
    assert (fit.drift.error[..., 1] == 0.0).all()
    assert np.isnan(fit.drift.uncertainty[..., 1]).all()
    assert fit.surfaces[1] is None
    assert any("y" in reason and "dynamic drift" in reason.lower() for reason in fit.verdict.reasons)


def test_the_measured_rate_is_the_table_offset_and_the_matrix():
    model = device(rate_drift=None, g_sensitivity=None)
    steps = computed(model, TEMPS[:2], np.random.default_rng(1), rates=FEW, noise_dps=1e-9)
    table = true_tables(model, TEMPS[:2], np.radians([-90.0, 90.0]))
    ready = prepared(steps, true_calibration(model).gyro, static=table.static)
    w = measured_rate(ready.reading, steps.temp_c, true_calibration(model).gyro, table.scale)
    assert np.abs(w - steps.rate_b).max() < 1e-9


def test_noise_of_another_sensor_enters_by_the_matrix():
    # Sensor x leans 30 deg to z, so that the rate about x takes tan 30 deg of z's reading and that about z takes none of x's.
    lean = np.radians(30.0)
    axes = np.array([[np.cos(lean), 0.0, np.sin(lean)], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    model = device()
    model = replace(model, gyro=replace(model.gyro, scale=replace(model.gyro.scale, axes=axes)))
    steps = computed(model, TEMPS, np.random.default_rng(1), rates=FEW, noise_dps=1e-6)
    gain = true_calibration(model).gyro.scale_factor
    own = np.array([1e-6, 1e-6, 1e-2])  # rad/s, stated for the readings
    fit = fitted(model, steps=replace(steps, gyro_variance=np.tile((own * gain) ** 2, (len(steps), 1))))
    x, _, z = np.moveaxis(fit.drift.uncertainty[~fit.drift.extrapolated], -1, 0)
    show("uncertainty of x over that of z", f"{np.median(x / z):.2f}", "tan 30 deg = 0.58")
    # The same rates and soaks about both axes; each surface finds its own softness, which is worth less than a factor of 1.5.
    assert np.tan(lean) / 1.5 < np.median(x / z) < np.tan(lean) * 1.5


@pytest.mark.parametrize(("temps", "words"), [((25.0,), "54 turns"), ((25.0, 45.0), "three soaks")])
def test_too_few_soaks_are_refused(temps, words):
    with pytest.raises(NotObservable, match=words):
        fitted(device(), temps=np.array(temps))
