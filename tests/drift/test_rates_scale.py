"""Matrix over temperature: exact without noise, honest about what was not turned, and refusals."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.rate_steps import GRID, SOAKS, computed, reading
from undrift.drift.rates import fit_scale, prepared, soak_matrices
from undrift.errors import InputError, NotObservable
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration, true_tables

NODES = np.arange(18.0, 75.01, 0.5)
FEW = GRID[::4]


def device(seed=0, **changes):
    """A device whose rates are straight lines."""
    model = random_device(np.random.default_rng(seed), grade="enc03j_3031")
    return replace(model, gyro=replace(model.gyro, nonlinearity=None, rate_drift=None, **changes))


def fitted(made, temps=SOAKS, noise_dps=1e-6, steps=None, **kept):
    steps = (
        computed(made, temps, np.random.default_rng(1), rates=FEW, noise_dps=noise_dps, **kept)
        if steps is None
        else steps
    )
    truth = true_tables(made, NODES, np.radians([-90.0, 90.0]))
    made_ready = prepared(steps, true_calibration(made).gyro, static=truth.static)
    return fit_scale(made_ready, true_calibration(made).gyro, temp_c=NODES), truth


def test_matrix_without_noise_comes_back_at_every_node():
    fit, truth = fitted(device())
    # A smoothing spline leans toward straight lines by far less than the bend of 1 / (1 + k D): 1e-6 of the scale.
    assert (
        np.abs(
            fit.drift.gyro_matrix / truth.scale.gyro_matrix[:, [0], [0]][:, None]
            - truth.scale.gyro_matrix / truth.scale.gyro_matrix[:, [0], [0]][:, None]
        ).max()
        < 1e-5
    )
    assert not fit.drift.gyro_extrapolated.any()
    assert fit.verdict.status == "good"


def test_unknown_offset_leaves_the_matrix_alone():
    model = device()
    steps = computed(model, SOAKS, np.random.default_rng(1), rates=FEW, noise_dps=1e-6)
    plain, _ = fitted(model, steps=steps)
    shifted, _ = fitted(model, steps=replace(steps, gyro=steps.gyro + 7.0))
    assert np.allclose(plain.drift.gyro_matrix, shifted.drift.gyro_matrix, rtol=1e-9, atol=1e-12)


def test_axis_without_a_turn_keeps_its_column():
    model = device()
    fit, truth = fitted(model, axes=(0, 2))
    assert np.isnan(fit.drift.gyro_uncertainty[:, :, 1]).all()
    assert np.isfinite(fit.drift.gyro_uncertainty[:, :, [0, 2]]).all()
    scale = truth.scale.gyro_matrix[:, 0, 0]
    # The other columns come back up to the product of two cross-axis terms, 1e-4, and the missing sensitivity, 10 %.
    assert np.abs(fit.drift.gyro_matrix - truth.scale.gyro_matrix)[:, [0, 2], [0, 2]].max() < 1e-4 * scale.max()
    assert any("Scale factor y" in item.text for item in fit.verdict.findings if item.code == "drift.not_observable")
    assert fit.verdict.status == "marginal"


def test_nodes_beyond_the_soaks_are_marked_and_less_certain():
    fit, _ = fitted(device(), temps=np.array([30.0, 40.0, 50.0]), noise_dps=0.01)
    marks = fit.drift.gyro_extrapolated
    assert marks[NODES < 29.0].all()
    assert marks[NODES > 51.0].all()
    assert not marks[(NODES > 30.0) & (NODES < 50.0)].any()
    own = fit.drift.gyro_uncertainty[:, 0, 0]
    assert own[-1] > 2.0 * own[NODES == 40.0][0]


def test_two_soaks_are_less_certain_between_them():
    fit, _ = fitted(device(), temps=np.array([25.0, 45.0]))
    own = fit.drift.gyro_uncertainty[:, 0, 0]
    assert own[NODES == 35.0] > 2.0 * own[NODES == 25.0]


def test_one_soak_shows_nothing_over_temperature():
    with pytest.raises(NotObservable, match="got 1"):
        fitted(device(), temps=np.array([25.0]))


def test_rows_with_gaps_are_left_out_and_counted():
    model = device()
    steps = computed(model, SOAKS, np.random.default_rng(1), rates=FEW, noise_dps=1e-6)
    gyro = steps.gyro.copy()
    gyro[[3, 80], 1] = np.nan
    plain, truth = fitted(model, steps=replace(steps, gyro=gyro))
    assert any("2 of 390" in reason for reason in plain.verdict.reasons)
    assert (
        np.abs(plain.drift.gyro_matrix - truth.scale.gyro_matrix).max() < 1e-5 * np.abs(truth.scale.gyro_matrix).max()
    )


def test_nothing_but_gaps_is_refused():
    steps = computed(device(), SOAKS, np.random.default_rng(1), rates=FEW)
    with pytest.raises(InputError, match="none of 390 dwells"):
        fitted(device(), steps=replace(steps, temp_c=np.full(len(steps), np.nan)))


def test_turns_about_one_oblique_axis_are_left_out():
    steps = computed(device(), SOAKS, np.random.default_rng(1), rates=FEW, axes=(0,))
    oblique = replace(steps, rate_b=steps.rate_b[:, [0]] * np.array([0.8, 0.6, 0.0]))
    with pytest.raises(NotObservable, match="two rates"):
        fitted(device(), steps=oblique)


def test_variances_that_are_not_known_do_not_stop_the_fit():
    model = device()
    steps = computed(model, SOAKS, np.random.default_rng(1), rates=FEW, noise_dps=0.01)
    fit, _ = fitted(model, steps=replace(steps, gyro_variance=np.full_like(steps.gyro_variance, np.nan)))
    # The scatter about the lines gives the noise: 0.01 deg/s over a grid of 10 rates and 53 deg/s rms.
    relative = fit.drift.gyro_uncertainty[:, 0, 0] / fit.drift.gyro_matrix[:, 0, 0]
    assert 0.2 < np.median(relative) / (0.01 / 53.0 / np.sqrt(10.0)) < 2.0


def test_rates_both_ways_need_no_offset_table():
    model = device()
    steps = computed(model, SOAKS, np.random.default_rng(1), rates=FEW, noise_dps=1e-6)
    fit = fit_scale(
        prepared(steps, true_calibration(model).gyro, static=None), true_calibration(model).gyro, temp_c=NODES
    )
    truth = true_tables(model, NODES, np.radians([-90.0, 90.0]))
    assert np.abs(fit.drift.gyro_matrix - truth.scale.gyro_matrix).max() < 1e-5 * np.abs(truth.scale.gyro_matrix).max()


def test_soaks_given_in_any_order_come_back_by_temperature():
    model = device()
    steps = computed(model, SOAKS[::-1], np.random.default_rng(1), rates=FEW, noise_dps=1e-6)
    soaks = soak_matrices(prepared(steps, true_calibration(model).gyro, static=None), true_calibration(model).gyro)
    assert (np.diff(soaks.temp_c) > 0.0).all()
    lone = reading(model.gyro, np.eye(3)[:1], np.array([soaks.temp_c[0] - 25.0])) - reading(
        model.gyro, np.zeros((1, 3)), np.array([soaks.temp_c[0] - 25.0])
    )
    assert np.allclose(soaks.forward[0][:, 0], lone[0], rtol=1e-5, atol=1e-3)
