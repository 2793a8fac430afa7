"""undrift orient: angles of corrected and of raw recordings."""

import numpy as np
import pytest

from testkit.command_line import contents, row_of, warm_between
from undrift.correction.correct import correct
from undrift.io.formats import read_record, read_reference
from undrift.io.store import read_calibration
from undrift.io.write import COLUMNS
from undrift.orientation import orient


def test_a_corrected_and_a_raw_recording_give_the_same_angles(undrift, bench, tmp_path):
    first = undrift.good("orient", bench / "corrected.parquet", "-o", tmp_path / "a.csv")
    told = undrift.good(
        "orient",
        bench / "trial.parquet",
        "--calibration",
        bench / "calibration.json",
        "-o",
        tmp_path / "b.parquet",
        "--json",
    ).json()
    a, b = read_reference(tmp_path / "a.csv"), read_reference(tmp_path / "b.parquet")
    np.testing.assert_allclose(a.q_nb, b.q_nb, atol=1e-9)
    assert (tmp_path / "a.csv").read_text().splitlines()[0].replace('"', "").split(",") == list(COLUMNS)
    assert told["data"]["samples"] == len(a)
    pitch = row_of(told, "angles", "pitch")
    assert 0.0 < pitch["maximum (deg)"] < 60.0
    assert f"{pitch['maximum (deg)']:.2f}" in first.out


@pytest.mark.parametrize("name", ["c.parquet", "c.csv", "c.csv.gz"])
def test_the_tilt_is_stated_alike_from_a_raw_file_from_a_corrected_one_and_in_python(undrift, bench, tmp_path, name):
    raw, calibration = bench / "trial.parquet", bench / "calibration.json"
    words = ("--json", "-o", tmp_path / "o.csv")
    undrift.good("correct", raw, "--calibration", calibration, "-o", tmp_path / name)
    corrected = undrift.good("orient", tmp_path / name, *words).json()
    at_once = undrift.good("orient", raw, "--calibration", calibration, *words).json()
    in_python = orient(correct(read_record(raw), read_calibration(calibration))).tilt
    for told in (corrected, at_once):
        parts = {row["source"]: row["size"] for row in told["tables"]["standard_uncertainty"]}
        assert told["data"]["tilt_basis"] == "calibration"
        assert parts["tilt, all sources"] == pytest.approx(np.degrees(in_python.inclination_uncertainty), rel=1e-9)
        assert parts["tilt, 95 %"] == pytest.approx(np.degrees(in_python.expanded_uncertainty))
        sources = [size for source, size in parts.items() if source.startswith("tilt: ")]
        assert np.linalg.norm(sources) == pytest.approx(parts["tilt, all sources"])
        assert parts["tilt: calibration"] > 0.0


def test_what_orient_refuses(undrift, bench, tmp_path):
    (tmp_path / "mine.csv").write_text("kept")
    before = contents(tmp_path)

    def refused(*words):
        line = undrift.refused("orient", *words)
        assert contents(tmp_path) == before
        return line

    corrected = bench / "corrected.parquet"
    assert "Add --calibration calibration.json" in refused(bench / "trial.parquet", "-o", tmp_path / "o.csv")
    assert "--output" in refused(corrected)
    assert "expected a name ending in .parquet, .csv, .csv.gz or .sto" in refused(corrected, "-o", tmp_path / "o.xls")
    assert "this file is an input" in refused(corrected, "-o", corrected)
    assert "up" in refused(corrected, "-o", tmp_path / "o.csv", "--up", "+x")
    assert "expected a recording" in refused(bench / "calibration.json", "-o", tmp_path / "mine.csv")


@pytest.mark.parametrize("inside", ["recording_0.parquet", "session.toml"])
def test_a_recording_of_the_session_that_is_read_is_not_written_over(undrift, bench, inside):
    path = bench / "session" / inside
    before = path.read_bytes()
    line = undrift.refused("orient", bench / "session", "--calibration", bench / "calibration.json", "-o", path)
    assert "expected" in line or "is an input" in line
    assert path.read_bytes() == before


def test_no_orientation_is_carried_over_a_gap_that_the_policy_nan_left(undrift, bench, tmp_path):
    corrected = tmp_path / "corrected.parquet"
    undrift.good("correct", *warm_between(bench, tmp_path, 8.0, 8.01), "-o", corrected, "--policy", "nan")
    line = undrift.refused("orient", corrected, "-o", tmp_path / "o.csv")
    assert "at 1 of 1604, the first stretch from 8 to 8 s" in line
    assert "policy hold" in line
    assert not (tmp_path / "o.csv").exists()
