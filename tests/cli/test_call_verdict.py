"""The exit code follows from the verdict, and every surface shows the same one."""

from dataclasses import replace

import pytest

from undrift.findings import Verdict, finding
from undrift.io.store import read_calibration, write_calibration

APPLIED = ("correct", "orient", "validate", "info", "export", "certificate")
BAD = finding("mount.uncertain", "fail", "The mounting is uncertain by 9 deg.")


@pytest.fixture
def bad(bench, tmp_path):
    """The calibration of the bench, with a verdict that is bad."""
    write_calibration(
        replace(read_calibration(bench / "calibration.json"), verdict=Verdict.of(BAD)), tmp_path / "bad.json"
    )
    return tmp_path / "bad.json"


@pytest.mark.parametrize("command", APPLIED)
def test_what_a_bad_calibration_gives_is_there_and_ends_with_code_1(undrift, bench, bad, tmp_path, command):
    trial = [command, bench / "trial.parquet", "--calibration", bad]
    words = {
        "correct": [*trial, "-o", tmp_path / "c.csv"],
        "orient": [*trial, "-o", tmp_path / "o.csv"],
        "validate": [*trial, "--reference", bench / "reference.parquet", "-o", tmp_path / "v"],
        "info": [command, bad],
        "export": [command, bad, "--target", "constants", "-o", tmp_path / "c.json"],
        "certificate": [command, bad, "-o", tmp_path / "c.html"],
    }[command]
    answer = undrift(*words, "--report", tmp_path / "page.html")
    assert (answer.code, answer.err) == (1, "")
    assert "verdict: bad\n" in answer.out
    assert "<h2>Verdict: bad</h2>" in (tmp_path / "page.html").read_text()
    told = undrift(*words, "--json")
    assert (told.code, told.json()["verdict"]) == (1, "bad")
    codes = [item["code"] for item in told.json()["findings"]]
    assert codes.count(BAD.code if command in ("info", "certificate") else "calibration.verdict") == 1
