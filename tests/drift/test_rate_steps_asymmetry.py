"""Scale factor asymmetry."""

from dataclasses import replace

import numpy as np

from testkit.rate_steps import SOAKS, computed
from undrift.drift.rate_steps import scale_asymmetry
from undrift.sim.device.effects import Nonlinearity
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration


def device(asymmetry=(2e-3, -1e-3, 0.0)):
    made = random_device_of("enc03j_3031", np.random.default_rng(0))
    uneven = Nonlinearity(asymmetry=np.array(asymmetry))
    return replace(made, gyro=replace(made.gyro, nonlinearity=uneven, rate_drift=None))


def test_the_asymmetry_of_a_device_comes_back_within_its_uncertainty():
    made = device()
    found = scale_asymmetry(computed(made, SOAKS, np.random.default_rng(1)), true_calibration(made))
    # 2 (S+ - S-) / (S+ + S-) = a for y = x + (a / 2) |x|, to second order in the cross-axis terms of 1 %: 1e-6.
    assert (np.abs(found.mean - [2e-3, -1e-3, 0.0]) < 4.0 * found.mean_uncertainty + 1e-6).all()
    assert found.mean_uncertainty.max() < 3e-5
    assert any(reason.startswith("Scale factor asymmetry x: +0.2") for reason in found.verdict.reasons)


def test_intervals_of_the_asymmetry_hold_the_truth():
    made = device()
    z = []
    for seed in range(20):
        found = scale_asymmetry(computed(made, SOAKS, np.random.default_rng(seed)), true_calibration(made))
        z.append((found.value - [2e-3, -1e-3, 0.0]) / found.uncertainty)
    # 780 values: standard error 0.8 %.
    assert 0.92 < np.mean(np.abs(z) < 1.96) < 0.98


def test_rates_of_one_sign_show_no_asymmetry():
    made = device()
    steps = computed(made, SOAKS[:2], np.random.default_rng(1))
    found = scale_asymmetry(steps.taken(steps.rate_b.sum(axis=1) > 0.0), true_calibration(made))
    assert np.isnan(found.value).all()
    assert np.isnan(found.mean).all()
    assert found.verdict.status == "marginal"
    assert any(
        item.code == "drift.asymmetry_not_observable" and item.values["axes"] == ("x", "y", "z")
        for item in found.verdict.findings
    )


def test_one_soak_gives_a_value():
    made = device()
    found = scale_asymmetry(computed(made, SOAKS[:1], np.random.default_rng(1)), true_calibration(made))
    assert np.isfinite(found.mean).all()
