"""Effects switched off: one kind of error goes, the draws of all others stay, and nothing is left once all are off."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.sim.device.presets import random_device_of
from undrift.sim.device.simulate import filtered, simulate_device
from undrift.sim.motion.tasks import draw_task
from undrift.sim.table_sessions import numbers_of_dwell
from undrift.study.case import EFFECTS, bench_without, delay_of_pitch, device_without
from undrift.study.plan import NOTE_BENCH

DEVICE = random_device_of("enc03j_3031", np.random.default_rng(4))
MOTION = draw_task("step", rng=np.random.default_rng(1)).at(5.0 + np.arange(600) / 100.0, 9.81)  # it moves after 6 s


def record_of(device):  # type: ignore[no-untyped-def]
    return simulate_device(device, MOTION, rng=np.random.default_rng(2), temp_c=36.0, power_on_s=1800.0)


@pytest.mark.parametrize(
    ("effect", "gone"),
    [
        ("noise", {"white_noise"}),
        ("gyroscope offset", {"offset", "g_sensitivity", "warm_up", "hysteresis", "instability"}),
        ("dynamic drift", {"nonlinearity", "rate_drift"}),
        ("delay", set()),
    ],
)
def test_an_effect_that_is_off_adds_nothing_and_the_others_add_what_they_did(effect: str, gone: set[str]) -> None:
    whole, off = record_of(DEVICE).gyro, record_of(device_without(DEVICE, effect)).gyro  # type: ignore[arg-type]
    for each in whole.contributions:
        if each.effect in gone:
            assert np.abs(off.of(each.effect)).max() == 0.0, each.effect
            assert np.abs(each.value).max() > 0.0 or each.effect == "hysteresis", each.effect  # the board is steady
        elif each.effect in ("white_noise", "instability", "random_walk"):  # drawn, whatever the rest is
            np.testing.assert_allclose(off.of(each.effect), each.value, atol=1e-12)


def test_every_switch_but_that_of_the_delay_changes_device_or_bench() -> None:
    for effect in EFFECTS:
        device, bench = device_without(DEVICE, effect), bench_without(NOTE_BENCH, effect)
        assert [numbers_of_dwell(getattr(device, name)) for name in ("gyro", "accel")] == [
            numbers_of_dwell(getattr(DEVICE, name)) for name in ("gyro", "accel")
        ]
        same = np.array_equal(record_of(device).record.gyro, record_of(DEVICE).record.gyro)
        alike = np.array_equal(record_of(device).record.accel, record_of(DEVICE).record.accel)
        assert (same and alike) == (effect == "delay"), effect
        assert (bench == NOTE_BENCH) == (effect not in ("scale", "cross-axis", "quantisation")), effect


def test_a_device_with_all_effects_off_reads_the_motion_as_late_as_its_filter() -> None:
    device = DEVICE
    for effect in EFFECTS:
        device = device_without(device, effect)
    read = record_of(device)
    rate = (read.record.gyro - device.gyro.null) / device.gyro.gain
    late_s = delay_of_pitch(device, 100.0) + 0.005  # strapdown holds a reading over the step before
    assert late_s == pytest.approx(float(device.gyro.low_pass.group_delay_s[1]))  # type: ignore[union-attr]
    time = MOTION.time
    for axis in range(3):
        wanted = np.interp(time - late_s, time, MOTION.rate_b[:, axis])
        assert np.abs(rate[20:, axis] - wanted[20:]).max() < 0.05 * np.abs(MOTION.rate_b).max()
    free = replace(device, gyro=replace(device.gyro, low_pass=None))
    seen = (record_of(free).record.gyro - free.gyro.null) / free.gyro.gain
    np.testing.assert_allclose(seen, MOTION.rate_b, atol=1e-5)  # a step of 28 bits is 2e-7 rad/s
    digital = replace(device, sampling=replace(device.sampling, gyro_averaging="interval"))
    assert delay_of_pitch(digital, 100.0) == pytest.approx(late_s)


def test_filters_behind_a_record_give_the_record_of_a_device_that_has_them() -> None:
    bare = replace(DEVICE, **{n: replace(getattr(DEVICE, n), low_pass=None, adc=None) for n in ("gyro", "accel")})
    whole, behind = record_of(DEVICE).record, filtered(record_of(bare).record, DEVICE)
    np.testing.assert_array_equal(whole.temp_c, behind.temp_c)
    for name in ("gyro", "accel"):
        apart = np.abs(getattr(whole, name) - getattr(behind, name))
        assert (apart != 0.0).mean() < 1e-3  # a code may turn where sums in another order round otherwise
        assert apart.max() <= 1.0
