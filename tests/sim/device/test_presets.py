"""Kinds of devices, units within their tolerances, and device.json."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testkit.quiet import without_noise
from testkit.simulated_device import motion_of
from undrift.correction.correct import correct
from undrift.errors import FileFormatError
from undrift.sim.device.model import device_json, read_device, write_device
from undrift.sim.device.presets import GRADES, PRESETS, grade_of, preset, random_device, sensitivity_of
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import nominal_calibration, true_calibration
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

DPS = RADIAN_PER_DEGREE
LIMIT_SD = 2.0


@pytest.mark.parametrize("name", PRESETS)
def test_every_unit_lies_within_the_tolerance_and_a_typical_one_at_half_of_it(name: str) -> None:
    grade, rng = grade_of(name), np.random.default_rng(1)
    units = [random_device(rng, grade=name) for _ in range(50)]
    for side in ("gyro", "accel"):
        sheet = getattr(grade, side)
        chains = [getattr(unit, side) for unit in units]
        gains = np.abs([chain.scale.error for chain in chains])
        offsets = np.abs([chain.offset.constant for chain in chains])
        assert gains.max() <= LIMIT_SD * sheet.sensitivity_sd
        assert offsets.max() <= LIMIT_SD * sheet.offset_sd
        assert offsets.max() > 1.5 * sheet.offset_sd  # 150 draws reach far: chance 1e-8
        typical = getattr(preset(name), side)
        np.testing.assert_allclose(np.abs(typical.offset.constant), sheet.offset_sd)
    assert preset(name).source_tag
    assert preset(name).name == name
    assert units[0].source_tag == "drawn"


def test_the_notes_device_has_the_notes_figures() -> None:
    device = preset("enc03j_3031")
    lsb = 1.0 / device.gyro.gain / DPS
    assert lsb == pytest.approx(0.091, abs=5e-4)  # deg/s: 12 bit, 5 V, gain 20 at 0.67 mV/(deg/s)
    np.testing.assert_allclose(np.abs(device.gyro.offset.per_k[0]) / DPS, 0.07)  # type: ignore[union-attr]
    np.testing.assert_allclose(device.gyro.low_pass.cutoff_hz, 11.1, rtol=0.02)  # type: ignore[union-attr]
    assert device.gyro.null == 2048.0


@pytest.mark.parametrize("name", ["enc03j_3031", "mpu6050"])
def test_true_calibration_is_within_noise_and_the_data_sheet_within_tolerance(name: str) -> None:
    device = preset(name)
    rate = np.tile([0.3, -0.2, 0.1], (2000, 1))
    motion = motion_of(np.arange(2000) / 100.0, rate, angular_acceleration_b=np.zeros((2000, 3)))
    record = simulate_device(device, motion, rng=np.random.default_rng(1), power_on_s=1e6).record
    # A steady turn whose gravity does not turn is no motion of a body: the check would say so.
    true = correct(record, true_calibration(device), check=False)
    # What is left: flicker (3 B, stationary), non-linearity at a third of a rad/s, g: 0.01 deg/s; hysteresis of 0 at rest.
    assert np.abs(true.gyro.mean(axis=0) - rate[0]).max() < 0.03 * DPS  # type: ignore[union-attr]
    sheet = grade_of(name).gyro
    nominal = correct(replace(record, device=""), nominal_calibration(grade_of(name)), check=False)
    off = np.abs(nominal.gyro.mean(axis=0) - rate[0]).max()  # type: ignore[union-attr]
    spread = sheet.offset_sd + 0.6 * (sheet.sensitivity_sd + 2.0 * sheet.misalignment_sd)
    assert off < LIMIT_SD * spread + 4.0 * sheet.g_sensitivity_sd * STANDARD_GRAVITY


@pytest.mark.slow
@pytest.mark.parametrize("name", ["enc03j_3031", "mpu6050"])
def test_the_prior_of_a_part_is_the_scatter_of_its_units_over_temperature(name: str) -> None:
    prior, units = sensitivity_of(name), [random_device(np.random.default_rng(k), grade=name) for k in range(400)]
    scales = [unit.gyro.thermal_scale.per_k for unit in units if unit.gyro.thermal_scale]
    offsets = [unit.gyro.offset.per_k[0] / RADIAN_PER_DEGREE for unit in units if unit.gyro.offset]
    # the standard error of a deviation of 1200 draws is 2 %
    assert prior.gyro_scale_percent_per_k == pytest.approx(100.0 * np.std(scales), rel=0.08)
    assert prior.gyro_offset_dps_per_k == pytest.approx(np.std(offsets), rel=0.08)
    assert prior.thermometer_lag_s == grade_of(name).thermometer.lag_s


def test_devices_that_differ_have_different_serial_numbers():
    """The same seed draws the same unit of a kind, and another serial of another kind."""
    kinds = [random_device(np.random.default_rng(0), grade=name).serial for name in (*PRESETS, *GRADES)]
    every = [*kinds, *(random_device(np.random.default_rng(seed)).serial for seed in range(1, 4))]
    assert len(set(every)) == len(every)
    changed = replace(grade_of("consumer"), trim_error_sd=0.5)
    assert random_device(np.random.default_rng(0), grade=changed).serial not in every
    assert random_device(np.random.default_rng(0)).serial == kinds[len(PRESETS)]


@pytest.mark.parametrize("name", ["enc03j_3031", "bmi270"])
def test_a_device_reads_back_as_it_was_written(name: str, tmp_path: Path) -> None:
    device = without_noise(random_device(np.random.default_rng(3), grade=name))
    write_device(device, tmp_path / "device.json")
    back = read_device(tmp_path / "device.json")
    assert device_json(back) == device_json(device)
    np.testing.assert_array_equal(back.gyro.forward_matrix, device.gyro.forward_matrix)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(format=2), "format 1, got 2"),
        (lambda c: c.pop("gyro"), "at gyro: "),
        (lambda c: c["gyro"].update(colour="red"), "at gyro.colour: "),
        (lambda c: c["gyro"]["adc"].update(bits=0), "bits: must be 1 or more"),
    ],
)
def test_a_file_that_is_not_a_device_is_refused(change: Callable[[Any], object], message: str, tmp_path: Path) -> None:
    content = json.loads(json.dumps(device_json(preset("enc03j_3031"))))
    change(content)
    (tmp_path / "d.json").write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=message):
        read_device(tmp_path / "d.json")
