"""A skew mounting: sums of the matrix over temperature in place of columns, and what they leave open."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.skew_mounting import NODES_C, NOTES, SKEW, minutes, steps_of, unit

from undrift.drift.rate_steps import CROSS_PER_K, as_mounted, fit_scale, soak_matrices
from undrift.drift.rate_steps import steps_of as usable
from undrift.errors import Implausible, NotObservable
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration
from undrift.study.plan import NOTE_BENCH

UNITS = 24


def drawn(seed, protocol=SKEW):
    rng = np.random.default_rng(seed)
    device = random_device_of("enc03j_3031", rng)
    calibration = true_calibration(device, temp_c=25.0)
    return steps_of(protocol, device, np.zeros((3, 3)), NOTE_BENCH, rng), calibration


@pytest.mark.slow
@pytest.mark.parametrize("cross", [0.0, CROSS_PER_K])
def test_scale_of_three_axes_by_one_mounting_lies_within_what_is_stated(cross, capsys):
    error, stated = (np.array(part) for part in zip(*(unit(seed, cross) for seed in range(UNITS)), strict=True))
    rms = 100.0 * np.sqrt((error**2).mean(axis=(0, 2, 3)))
    said = 100.0 * np.sqrt((stated**2).mean(axis=(0, 2, 3)))
    inside = (np.abs(error) <= 1.96 * stated).mean(axis=(0, 2, 3))
    with capsys.disabled():
        print(
            f"\ncross-axis terms change by {cross:g} /K, {UNITS} devices: plain {rms[0]:.4f} % rms, {inside[0]:.1%} inside 95 %; "
            f"skew {rms[1]:.4f} % rms, stated {said[1]:.4f} %, {inside[1]:.1%} inside"
        )
    assert inside.min() > 0.88
    if cross:
        assert 0.7 < rms[1] / said[1] < 1.3
    else:
        assert rms[1] < 0.01  # of what is observable
    far = np.sqrt(2.0) * CROSS_PER_K * np.abs(NODES_C - 25.0)  # two cross-axis terms of each sensor
    assert (stated[:, 1].mean(axis=(0, 2)) > far).all()
    assert stated[:, 1].mean(axis=(0, 2)) == pytest.approx(far, rel=0.25)


def test_a_skew_mounting_takes_a_third_of_the_plain_sessions_minutes():
    plain, skew = minutes()
    assert round(plain, 1) == 643.8
    assert round(skew, 1) == 198.8


def test_the_axis_is_found_as_it_was_mounted_and_rates_follow_it():
    steps, calibration = drawn(3)
    skewed = as_mounted(usable(steps), calibration, None)
    (mounting,) = skewed.skew
    pose = steps.accel[skewed.inclined].mean(axis=0)
    assert mounting.axis_b == pytest.approx(pose / np.linalg.norm(pose), abs=3e-3)
    assert mounting.temp_c == pytest.approx(25.0, abs=1e-9)
    assert skewed.rate_b[skewed.inclined] == pytest.approx(skewed.along[skewed.inclined, None] * mounting.axis_b)
    assert as_mounted(skewed, calibration, None) is skewed


def test_a_soak_that_is_held_out_is_not_what_the_others_are_measured_from():
    steps, calibration = drawn(4)
    skewed = as_mounted(usable(steps), calibration, None)
    soaks = soak_matrices(skewed, calibration, static=None)
    for number in np.unique(skewed.soak):
        others = soak_matrices(skewed.taken(skewed.soak != number), calibration, static=None)
        assert len(others.temp_c) in (len(soaks.temp_c), len(soaks.temp_c) - 1)
        for temp_c, forward in zip(others.temp_c, others.forward, strict=True):
            alike = np.flatnonzero(soaks.temp_c == temp_c)
            assert any(np.array_equal(forward, soaks.forward[k], equal_nan=True) for k in alike)


def test_without_turns_about_the_axes_the_calibration_is_what_sums_are_measured_from():
    steps, calibration = drawn(5)
    alone = steps.taken((np.abs(steps.rate_b) > 0.0).all(axis=1))
    fit, whole = (fit_scale(each, calibration, static=None, temp_c=NODES_C) for each in (alone, steps))
    assert fit.drift.gyro_matrix == pytest.approx(
        whole.drift.gyro_matrix, rel=2e-3, abs=2e-3 * np.abs(whole.drift.gyro_matrix).max()
    )
    assert {item.code for item in fit.verdict.findings} >= {"drift.scale_skew"}
    unknown = replace(calibration, reference_temp_c=float("nan"))
    with pytest.raises(NotObservable, match="or a calibration of a known temperature, got neither"):
        fit_scale(alone, unknown, static=None, temp_c=NODES_C)


def test_one_temperature_or_another_way_up_is_refused():
    steps, calibration = drawn(6)
    inclined = (np.abs(steps.rate_b) > 0.0).all(axis=1)
    with pytest.raises(NotObservable, match=r"wanted its turns at two temperatures, got 25\.0 degC alone"):
        fit_scale(
            steps.taken(~inclined | (np.abs(steps.temp_c - 25.0) < 0.01)), calibration, static=None, temp_c=NODES_C
        )
    turned = replace(steps, rate_b=np.where(inclined[:, None], steps.rate_b * (1.0, -1.0, 1.0), steps.rate_b))
    with pytest.raises(
        Implausible, match=r"wanted turns about \(\+0\.58, -0\.58, \+0\.58\) of the case, got \(\+0\.58, \+0\.5"
    ):
        fit_scale(turned, calibration, static=None, temp_c=NODES_C)


def test_a_plain_session_has_nothing_in_common():
    steps, calibration = drawn(7, NOTES)
    plain = as_mounted(usable(steps), calibration, None)
    assert not plain.skew
    assert not soak_matrices(plain, calibration, static=None).common.any()
