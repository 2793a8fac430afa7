"""undrift info: every public recording, and the keys that other programs rely on."""

import numpy as np
import pytest

from undrift.io.formats import write_record
from undrift.record import Record

pytestmark = pytest.mark.usefixtures("described_once")


@pytest.mark.parametrize(
    ("name", "kind", "word"),
    [
        ("session", "session", "1 recording, 9 stills, 12 turns"),
        ("session/session.toml", "session", "1 recording, 9 stills, 12 turns"),
        ("trial.parquet", "recording", "100 Hz"),
        ("reference.parquet", "reference", "poses at 100 Hz"),
        ("calibration.json", "calibration", "format 1"),
        ("summary.json", "demo", "demo of a device"),
        ("report.html", "text", "doctype"),
    ],
)
def test_what_undrift_writes_is_told(undrift, bench, name, kind, word):
    told = undrift.good("info", bench / name, "--json").data()
    assert told["kind"] == kind
    assert word in told["summary"]
    if kind in ("session", "recording"):
        assert told["stills"]
        assert told["units"]["accel"] == "count"
        assert told["temp_c"][0] < told["temp_c"][1]


def test_an_uneven_log_is_told_by_samples_over_time_with_its_usual_step_beside(undrift, tmp_path):
    """Steps of 10 ms, and one hole of 10 s in 20: 1000 samples over 20 s are 50 Hz, whatever the usual step."""
    time = np.arange(1000) * 0.01 + np.where(np.arange(1000) < 500, 0.0, 10.0)
    rng = np.random.default_rng(3)
    values = rng.normal(0.0, 0.01, (1000, 3))
    write_record(Record(time=time, gyro=values, accel=values + np.array([0.0, 0.0, 9.8])), tmp_path / "log.csv")
    told = undrift.good("info", tmp_path / "log.csv", "--json").data()
    assert told["sample_rate_hz"] == pytest.approx(999 / 19.99)
    assert told["usual_rate_hz"] == pytest.approx(100.0)
    said = undrift.good("info", tmp_path / "log.csv").out
    assert "1000 samples at 49.97 Hz on average (usual step 10 ms, 100 Hz), 19.99 s" in said
    assert "longest 10.01 s" in said


def test_a_recording_of_half_a_second_is_told_without_its_still_phases(undrift, tmp_path):
    write_record(Record(time=np.arange(50) / 100.0, gyro=np.zeros((50, 3))), tmp_path / "short.csv")
    assert "50 samples at 100 Hz" in (said := undrift.good("info", tmp_path / "short.csv").out)
    assert "No still phase: 0.49 s are too short to look for one (1 s and more)." in said


def test_the_proposed_map_can_be_copied(undrift, tmp_path):
    """Its lines are a map as soon as every ? is a unit or a rate."""
    rows = ["1,2,3;4;5;6".replace(",", ";")] * 60
    (tmp_path / "t.csv").write_text("gx;gy;gz;ax;ay;az\n" + "\n".join(rows) + "\n")
    told = undrift.good("info", tmp_path / "t.csv", "--json").json()
    text = "\n".join(row["map.toml"] for row in told["tables"]["proposed_map"])
    text = text.replace('gyro = "?"', 'gyro = "dps"').replace('accel = "?"', 'accel = "g"').replace("= ?", "= 50")
    (tmp_path / "map.toml").write_text(text)
    assert undrift.good("info", tmp_path / "t.csv", "--map", tmp_path / "map.toml", "--json").data()["rows"] == 60
