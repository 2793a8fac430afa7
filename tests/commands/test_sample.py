"""undrift sample: the recordings of the package come whole, and run through the commands."""

from pathlib import Path

import pytest

from testkit.command_line import contents


def test_sample_writes_all_recordings(undrift, tmp_path):
    answer = undrift.good("sample", tmp_path / "first", "--json").json()
    assert answer["written"] == [str(tmp_path / "first")]
    written = {path.name for path in (tmp_path / "first").iterdir()}
    assert {"bench", "thermal", "rest.parquet", "sit_to_stand.parquet", "sit_to_stand_optics.parquet"} <= written
    assert sum(path.stat().st_size for path in (tmp_path / "first").rglob("*")) < 1_000_000


@pytest.mark.parametrize(
    ("folder", "text"),
    [
        ("here", "the folder exists already"),
        ("nowhere/here", "the folder nowhere does not exist"),
    ],
)
def test_sample_refuses_a_folder_that_it_cannot_make(undrift, tmp_path, monkeypatch, folder, text):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path)
    assert text in undrift.refused("sample", folder)
    assert contents(tmp_path) == {"here": None}


@pytest.mark.slow
def test_the_sample_runs_through_the_commands(undrift, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    undrift.good("sample")
    monkeypatch.chdir(tmp_path / "sample")
    made = undrift.good("calibrate", "bench", "-o", "calibration.json", "--json").data()
    assert made["gyro"]["method"] == "rate-table/affine"
    assert made["accel"]["method"] == "six-face/affine"
    assert undrift.good("noise", "rest.parquet", "--calibration", "calibration.json", "--json").data()["gyro"]
    undrift.good("drift", "bench", "thermal", "--calibration", "calibration.json", "-o", "tables.json", "--json")
    undrift.good("correct", "sit_to_stand.parquet", "--calibration", "tables.json", "-o", "corrected.parquet", "--json")
    undrift.good("orient", "corrected.parquet", "-o", "angles.csv", "--json")
    words = ("--reference", "sit_to_stand_optics.parquet", "--calibration", "tables.json", "--json")
    trial = undrift.good("validate", "sit_to_stand.parquet", *words).data()["trials"][0]
    assert trial["max_abs_pitch_deg"] < 0.5  # three times what the first run showed: 0.12
    undrift.good("certificate", "tables.json", "-o", "certificate.html", "--json")
    assert Path("certificate.html").read_text("utf-8").startswith("<!doctype html>")
