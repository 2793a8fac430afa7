"""One device in one trial: what an exact calibration leaves, the delay, and errors that are switched off."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift import OrientSettings, correct, orient
from undrift.sim.device.presets import preset
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.tasks import draw_task
from undrift.study.case import EFFECTS, device_without, make_case, pitch_delay_s, pitch_errors_deg, stream, with_cutoff

DEVICE = with_cutoff(preset("enc03j_3031"), 11.1)
TASK = draw_task("sit_to_stand", rng=np.random.default_rng(5), rest_s=6.0)


def case_of(device, temp_c=25.0, **more):
    return make_case(device, TASK, temp_c=temp_c, rng=np.random.default_rng(1), **more)


def test_an_exact_calibration_at_its_temperature_leaves_noise():
    aligned, now, largest = pitch_errors_deg(case_of(DEVICE), true_calibration(DEVICE, temp_c=25.0), "rest")
    show("exact calibration: rms aligned, real time, largest, deg", (aligned, now, largest))
    assert aligned < 0.15  # 12 bits, and half of the hysteresis over 3 s
    assert now > 2.0 * aligned  # 15 ms at up to 90 deg/s
    assert aligned <= largest


def test_pitch_is_the_one_that_correct_and_orient_return():
    calibration = true_calibration(DEVICE, temp_c=27.0)
    case = case_of(DEVICE)
    pitch = orient(correct(case.record, calibration, policy="hold"), case.still, OrientSettings(offset="rest")).pitch
    error = np.degrees(pitch - case.pitch)[case.moving]
    assert pitch_errors_deg(case, calibration, "rest")[0] == pytest.approx(np.sqrt(np.nanmean(error**2)), abs=1e-9)


def test_a_wrong_offset_grows_with_time_unless_the_rest_is_subtracted():
    calibration = true_calibration(DEVICE, temp_c=25.0)
    off = 1.0 * np.pi / 180.0 / calibration.gyro.si_per_reading("rate")
    wrong = replace(calibration, gyro=replace(calibration.gyro, offset=calibration.gyro.offset + off))
    case = case_of(DEVICE)
    assert pitch_errors_deg(case, wrong, "none")[0] > 0.5
    assert pitch_errors_deg(case, wrong, "rest")[0] < 0.15


def test_the_delay_is_that_of_the_filter_minus_half_a_sample():
    share = np.median(DEVICE.gyro.low_pass.cutoff_hz) / DEVICE.gyro.low_pass.cutoff_hz[1]  # tolerance of the parts
    for cutoff_hz in (5.0, 20.0):
        expected = share * np.sqrt(2.0) / (2.0 * np.pi * cutoff_hz) - 0.005  # Butterworth of second order, 100 Hz
        assert pitch_delay_s(with_cutoff(DEVICE, cutoff_hz)) == pytest.approx(expected, abs=5e-4)


def test_without_the_delay_both_errors_are_the_aligned_one():
    case = case_of(DEVICE, aligned=False)
    aligned, now, _ = pitch_errors_deg(case, true_calibration(DEVICE, temp_c=25.0), "rest")
    assert aligned == now


@pytest.mark.parametrize("effect", EFFECTS)
def test_an_effect_that_is_switched_off_leaves_the_other_draws(effect):
    device = device_without(DEVICE, effect)
    one, other = case_of(DEVICE).record, case_of(device).record
    changed = not np.array_equal(one.gyro, other.gyro) or not np.array_equal(one.accel, other.accel)
    assert changed == (effect not in ("delay", "assumed figures"))
    if effect == "gyroscope offset":
        assert np.array_equal(one.accel, other.accel)


def test_streams_of_the_same_words_repeat():
    assert stream(1, "a", 2).normal() == stream(1, "a", 2).normal()
    assert stream(1, "a", 2).normal() != stream(1, "a", 3).normal()
