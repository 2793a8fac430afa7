"""What every command does with the recordings that it reads."""

import pytest

from undrift.io.formats import read_record, write_record

NOTE = "These columns have other names than undrift's and were not read: humidity."
WORDS = {
    "info": (),
    "correct": ("--calibration", "{bench}/calibration.json", "-o", "{here}/c.parquet"),
    "orient": ("--calibration", "{bench}/calibration.json", "-o", "{here}/o.csv"),
    "noise": ("--rest-s", "0.5:1.5"),
    "validate": ("--calibration", "{bench}/calibration.json", "--reference", "{bench}/reference.parquet"),
}


@pytest.mark.parametrize("command", WORDS)
def test_notes_on_the_reading_are_shown(undrift, bench, tmp_path, command):
    write_record(read_record(bench / "trial.parquet"), tmp_path / "walk.csv")
    (tmp_path / "walk.csv.json").unlink(missing_ok=True)
    lines = (tmp_path / "walk.csv").read_text().splitlines()
    text = [f"{lines[0]},humidity", *(f"{line},40" for line in lines[1:])]
    (tmp_path / "walk.csv").write_text("\n".join(text) + "\n")
    words = (word.format(bench=bench, here=tmp_path) for word in WORDS[command])
    assert NOTE in undrift(command, tmp_path / "walk.csv", *words).out
