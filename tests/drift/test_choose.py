"""Which tables a device needs."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.rate_steps import GRID, SOAKS, computed
from undrift.commands.drift import choice_rows
from undrift.drift.fit import ALTERNATIVES, _requested, choose_tables
from undrift.drift.observe import RestBlocks
from undrift.errors import NotObservable
from undrift.sim.device.effects import RateDrift, ThermalScale
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration, true_tables

TEMPS = SOAKS[::2]
FEW = GRID[1::2]
NODES = np.arange(18.0, 75.01, 0.5)
CUBIC = np.zeros((3, 2, 3))
CUBIC[2, 1] = np.array([1.0, -1.0, 0.7]) * 1e-4


def device(seed, **changes):
    made = random_device_of("enc03j_3031", np.random.default_rng(seed))
    return replace(made, gyro=replace(made.gyro, nonlinearity=None, **changes))


def chosen(made, seed=0, temps=TEMPS, steps=None, **kept):
    if steps is None:
        steps = computed(made, temps, np.random.default_rng(seed + 100), rates=FEW, noise_dps=0.008, **kept)
    table = true_tables(made, NODES, np.radians([-90.0, 90.0])).static
    return choose_tables(steps, true_calibration(made), static=table, temp_c=NODES)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("none", {"thermal_scale": None, "rate_drift": None}),
        ("scale", {"rate_drift": None}),
        ("dynamic", {"thermal_scale": None, "rate_drift": RateDrift(coefficients=CUBIC)}),
        ("scale + dynamic", {"rate_drift": RateDrift(coefficients=CUBIC)}),
    ],
)
def test_a_device_gets_the_tables_that_it_needs(name, changes):
    for seed in range(2):
        choice = chosen(device(seed, **changes), seed)
        table = choice.alternatives
        show(f"{name}: left out, deg/s rms of {', '.join(ALTERNATIVES)}", np.round(table.left_out_rms_dps, 4))
        assert table.chosen == name
        counts = ("tables", "held_out", "soaks", "set_points")
        assert [table.why.values[value] for value in counts] == [name, 5, 7, 7]
        assert table.reason in choice.verdict.reasons
        assert (choice.scale_drift is not None) == ("scale" in name)
        assert (choice.dynamic_drift is not None) == ("dynamic" in name)
        # The noise of the means is 0.008 deg/s, and no table predicts better; six soaks of 18 rates give
        # the surface of the seventh to half of that: hypot(1, 0.5) = 1.12, and 1.25 with room for the draw.
        assert table.left_out_rms_dps[ALTERNATIVES.index(name)] < 1.25 * 0.008
        assert np.isfinite(table.soak_rms_dps).all()
        assert np.isfinite(table.rate_rms_dps).all()


def test_two_soaks_are_selected_by_rates_alone_with_a_finding():
    choice = chosen(device(0, rate_drift=None), temps=np.array([25.0, 45.0]))
    assert np.isnan(choice.alternatives.soak_rms_dps).all()
    assert choice.alternatives.chosen == "scale"
    assert "drift.tables_by_rates" in {item.code for item in choice.verdict.findings}
    counts = ("held_out", "soaks", "set_points")
    assert [choice.alternatives.why.values[name] for name in counts] == [0, 2, 2]


def test_soaks_of_one_set_point_are_counted_once_as_set_points():
    # Each set-point twice, as axis by axis or on the way back: of three the middle one alone lies between others.
    choice = chosen(device(0, rate_drift=None), temps=np.array([25.0, 35.0, 45.0, 45.3, 34.8, 25.1]))
    counts = ("held_out", "soaks", "set_points")
    assert [choice.alternatives.why.values[name] for name in counts] == [2, 6, 3]
    assert "(2 of 6 soaks at 3 set-points, and rates, held out)" in choice.alternatives.reason
    two = chosen(device(0, rate_drift=None), temps=np.array([25.0, 45.0, 45.3, 25.1]))
    assert [two.alternatives.why.values[name] for name in counts] == [0, 4, 2]
    assert any("soaks at 2 set-points" in reason for reason in two.verdict.reasons)


def test_one_soak_is_refused_with_its_temperature():
    with pytest.raises(NotObservable, match=r"wanted rate steps at two soaks or more, got one at 25\.0 degC"):
        chosen(device(0), temps=np.array([25.0]))


def test_soaks_that_turned_different_axes_are_refused():
    made = device(0)
    steps = computed(made, TEMPS[:2], np.random.default_rng(1), rates=FEW)
    axis = np.abs(steps.rate_b).argmax(axis=1)
    with pytest.raises(NotObservable, match="wanted an axis turned at two rates at two soaks, got 36 steps at 2 soaks"):
        chosen(made, steps=steps.taken(axis == steps.soak))


def test_rates_of_one_sign_and_a_missing_axis_still_give_a_choice():
    made = device(0, rate_drift=None)
    steps = computed(made, TEMPS, np.random.default_rng(1), rates=FEW, noise_dps=0.008, axes=(0, 2))
    choice = chosen(made, steps=steps.taken(steps.rate_b.sum(axis=1) > 0.0))
    assert choice.alternatives.chosen == "scale"
    assert any(
        item.code == "drift.scale_not_observable" and item.values["axis"] == "y" for item in choice.verdict.findings
    )


def test_the_dynamic_table_spans_what_the_matrix_table_spans():
    made = device(0)
    steps = computed(made, TEMPS[1:-1], np.random.default_rng(1), rates=FEW, noise_dps=0.008)
    choice = chosen(made, steps=steps)
    for fit in (choice.dynamic, choice.both):
        assert np.array_equal(fit.drift.temp_c, [18.0, *np.arange(20.0, 71.0, 5.0), 75.0])
        assert fit.drift.extrapolated[[0, -1]].all()
    assert choice.scale.drift.gyro_extrapolated[[0, -1]].all()


def one_way(seed, temps, *, scatter_dps=0.0):
    """One rate one way round about each axis at each soak, a rest before each, and a scale 0.5 % and 8 ppm/degC off."""
    rng = np.random.default_rng(seed)
    made = device(seed, thermal_scale=ThermalScale(per_k=np.full((1, 3), 8e-6)), rate_drift=None, g_sensitivity=None)
    truth = true_calibration(made)
    kept = replace(truth, gyro=replace(truth.gyro, matrix=truth.gyro.matrix * 1.005))  # reads 0.5 % too much
    steps = computed(made, temps, rng, rates=np.radians([50.0]), noise_dps=0.004)
    steps = steps.taken(steps.rate_b.sum(axis=1) > 0.0)
    resting = computed(made, temps, rng, rates=np.radians([1e-9]), noise_dps=0.004)
    resting = resting.taken(resting.rate_b.sum(axis=1) > 0.0)
    visit = (
        scatter_dps * np.radians(rng.normal(size=(len(temps), 3))) * made.gyro.gain
    )  # turns and rests of a soak share it
    steps, resting = (replace(rows, gyro=rows.gyro + visit[rows.soak]) for rows in (steps, resting))
    n = len(resting)
    rests = RestBlocks(
        session=resting.session, pose=np.arange(n) % 3, time=resting.time, power_on_s=resting.time,
        ramp_c_per_min=np.zeros(n), temp_c=resting.temp_c, gyro=resting.gyro, accel=resting.accel,
        gyro_variance=resting.gyro_variance, accel_variance=np.full((n, 3), 1e-4),
    )  # fmt: skip
    table = true_tables(made, NODES, np.radians([-90.0, 90.0]))
    return choose_tables(steps, kept, static=table.static, temp_c=NODES, rests=rests), table.scale.gyro_matrix


def test_one_rate_one_way_round_chooses_the_scale_by_the_rest_of_its_soak_and_recovers_it():
    inside = []
    for seed in range(6):
        choice, true = one_way(seed, TEMPS, scatter_dps=0.02)
        table = choice.alternatives
        assert table.chosen == "scale"
        # 0.5 % of 50 deg/s on the axis that turns; over all three that is 1 / sqrt(3)
        assert table.left_out_rms_dps[0] == pytest.approx(0.25 / 3.0**0.5, rel=0.15)
        assert table.left_out_rms_dps[1] < 0.02
        drift = choice.scale_drift
        error = np.diagonal(drift.gyro_matrix - true, axis1=1, axis2=2)
        inside.append((np.abs(error) <= 1.96 * np.diagonal(drift.gyro_uncertainty, axis1=1, axis2=2)).mean())
        assert (
            np.abs(error / np.diagonal(true, axis1=1, axis2=2)).max() < 6e-4
        )  # 0.004 of 50 deg/s twice, and extrapolated
    assert np.mean(inside) >= 0.85  # eighteen curves; 0.95 but for three of them


def test_one_rate_at_two_soaks_cannot_be_judged_and_keeps_the_line_with_a_finding():
    choice, _ = one_way(0, np.array([25.0, 45.0]))
    assert choice.alternatives.chosen == "scale"
    why = choice.alternatives.why
    assert (why.code, why.values["set_points"]) == ("drift.tables_unjudged", 2)
    assert why.values["constant_dps"] == pytest.approx(0.25 / 3.0**0.5, rel=0.15)
    assert choice.verdict.status == "marginal"


def test_nothing_is_called_held_out_that_was_fitted():
    fitted, _ = one_way(0, np.array([25.0, 45.0]))
    table = fitted.alternatives
    assert np.isnan(table.left_out_rms_dps).all()
    assert np.isfinite(table.fitted_rms_dps[:2]).all()
    assert "fitted, nothing could be held out (2 set-points)" in table.reason
    assert "nothing held out" in [row["held out (deg/s rms)"] for row in choice_rows(table)]
    asked = _requested(fitted, "scale")
    assert asked.alternatives.why.level == "warn"
    assert "fitted, nothing could be held out" in asked.alternatives.reason
    assert asked.verdict.status == "marginal"
    soaks, _ = one_way(0, TEMPS)  # one rate: no rate can be left out
    assert "(5 of 7 soaks at 7 set-points held out)" in soaks.alternatives.reason
    rates = chosen(device(0, rate_drift=None), temps=np.array([25.0, 45.0]))
    assert "(rates held out)" in rates.alternatives.reason
