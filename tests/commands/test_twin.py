"""``undrift twin``: a device out, the contract's keys, calls refused in one line."""

import json
from pathlib import Path

import pytest
from benchmarks.broad_files import broad_file

from testkit.pages import faults_of
from undrift.cli.app import run
from undrift.sim.device.model import read_device

pytestmark = pytest.mark.usefixtures("computed_once")

COLUMNS = {"parameter", "value", "standard error", "unit"}


@pytest.mark.slow
def test_one_recording_makes_a_device_that_can_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(broad_file("32_disturbed_attached_magnet_1cm"))
    assert run(["twin", path, "-o", str(tmp_path / "device.json"), "--json", "--report", str(tmp_path / "t.html")]) == 0
    assert faults_of((tmp_path / "t.html").read_text()) == []
    said = json.loads(capsys.readouterr().out)
    assert all(row.keys() == COLUMNS for row in said["tables"]["parameters_of_the_device"])
    assert "held_out_recordings" not in said["tables"]  # one recording: nothing is held out
    device = read_device(tmp_path / "device.json")
    assert device.source_tag == "fitted"
    assert device.gyro.adc is not None


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "parameter RECORDS requires an argument. Run undrift twin --help."),
        (["missing.parquet", "--reference", "missing.csv"], "missing.parquet: there is no file of that name"),
    ],
)
def test_a_wrong_call_is_one_line(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["twin", *words]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert len(told.err.splitlines()) == 1
    assert said in told.err
