"""device.json reads back to the last bit, and refuses what it does not know."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testkit.quiet import without_noise
from undrift.errors import FileFormatError, InputError
from undrift.sim.device.model import device_from_json, device_json, read_device, write_device
from undrift.sim.device.presets import PRESETS, preset, random_device


@pytest.mark.parametrize("name", PRESETS)
def test_a_device_reads_back_as_it_was_written(name: str, tmp_path: Path) -> None:
    device = random_device(np.random.default_rng(3), grade=name)
    write_device(device, tmp_path / "device.json")
    back = read_device(tmp_path / "device.json")
    assert device_json(back) == device_json(device)
    np.testing.assert_array_equal(back.gyro.forward_matrix, device.gyro.forward_matrix)
    assert not list(tmp_path.glob(".*"))


def test_keys_are_the_names_of_the_fields_in_si_units() -> None:
    device = device_json(preset("enc03j_3031"))
    assert device["gyro"]["scale"]["nominal_sensitivity"] == pytest.approx(0.67e-3 * 180.0 / np.pi)
    assert device["gyro"]["adc"]["reference"] == 5.0
    assert device["accel"]["warm_up"] is None


def test_infinite_rails_are_words(tmp_path: Path) -> None:
    bare = without_noise(random_device(np.random.default_rng(1)))
    write_device(without_noise(preset("enc03j_3031")), tmp_path / "d.json")
    assert read_device(tmp_path / "d.json").gyro.amplifier.high == np.inf  # type: ignore[union-attr]
    assert device_from_json(device_json(bare)).gyro.adc is None


def changed(change: Callable[[Any], object]) -> Any:
    content = json.loads(json.dumps(device_json(preset("enc03j_3031"))))
    change(content)
    return content


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(kind="undrift.calibration"), "kind 'undrift.device', got 'undrift.calibration'"),
        (lambda c: c.update(format=2), "format 1, got 2"),
        (lambda c: c.pop("gyro"), "at gyro: "),
        (lambda c: c["gyro"].update(colour="red"), "at gyro.colour: "),
        (lambda c: c["gyro"].update(scale=3), "at gyro.scale: "),
        (lambda c: c["gyro"]["scale"].update(error=3), "at gyro.scale.error: "),
        (lambda c: c["gyro"]["scale"].update(error=[1.0]), "at gyro.scale.error: "),
        (lambda c: c["gyro"]["amplifier"].update(gain="big"), "at gyro.amplifier.gain: "),
        (lambda c: c["gyro"]["adc"].update(bits=12.5), "at gyro.adc.bits: "),
        (lambda c: c["gyro"]["adc"].update(bits=0), "Adc.bits: must be 1 or more, got 0"),
        (lambda c: c["gyro"]["adc"].update(rounding="up"), "at gyro.adc.rounding: "),
    ],
)
def test_a_file_that_is_not_a_device_of_this_format_is_refused(
    change: Callable[[Any], object], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "d.json"
    path.write_text(json.dumps(changed(change)))
    with pytest.raises(FileFormatError, match=message):
        read_device(path)


def test_files_that_cannot_be_read_or_written_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="expected a device file, got No such file"):
        read_device(tmp_path / "none.json")
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(FileFormatError, match="expected JSON, got"):
        read_device(tmp_path / "broken.json")
    with pytest.raises(InputError, match="expected a folder to write to, got No such file"):
        write_device(preset("bmi160"), tmp_path / "none" / "d.json")
    (tmp_path / "taken.json").mkdir()
    with pytest.raises(InputError, match="cannot be written: Is a directory"):
        write_device(preset("bmi160"), tmp_path / "taken.json")
