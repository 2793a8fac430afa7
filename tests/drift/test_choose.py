"""Which tables a device needs."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.rate_steps import GRID, SOAKS, computed
from undrift.drift.select import ALTERNATIVES, choose_tables
from undrift.errors import NotObservable
from undrift.sim.device.effects import RateDrift
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
