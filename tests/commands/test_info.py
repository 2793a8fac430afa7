"""undrift info: every public recording, and the keys that other programs rely on."""

import json
import shlex

import numpy as np
import pytest

from testkit.command_line import beyond_the_table, contents
from testkit.data import DATA, data_path
from testkit.host import stamp_on_host
from undrift.base.codec import tree_of
from undrift.findings import finding
from undrift.io.formats import read_record, write_record
from undrift.model import Verdict
from undrift.record import Record

pytestmark = pytest.mark.usefixtures("described_once")
EVERY = sorted(str(path.relative_to(DATA)) for path in DATA.rglob("*")) if DATA.is_dir() else []


@pytest.mark.slow
def test_what_a_file_needs_is_said_in_words_of_the_command_line_and_then_it_reads(undrift):
    apdm, ximu = data_path("wearable_formats", "opensim_apdm_imuData01.csv.gz"), data_path("wearable_formats", "ximu")
    assert f"Next: undrift info {apdm} --sensor Static\n" in undrift.good("info", apdm).out
    assert undrift.good("info", apdm, "--sensor", "Upper", "--json").data()["rows"] == 1024
    assert f"Next: undrift info {ximu} --sample-rate-hz 256\n" in undrift.good("info", ximu).out
    assert undrift.good("info", ximu, "--sample-rate-hz", 256, "--json").data()["rows"] == 12626
    squat = data_path("c3d", "squat.c3d.gz")
    assert "which axis points up" in undrift.good("info", squat).out
    assert undrift.good("info", squat, "--reference-up", "y", "--json").data()["problems"] == []


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


def test_a_calibration_is_told_triad_by_triad_and_table_by_table(undrift, bench, tmp_path):
    path, *_ = beyond_the_table(bench, tmp_path)
    path = path.with_name("c.json")
    told = undrift.good("info", path, "--json").json()
    (table,) = told["tables"]["tables_over_temperature"]
    assert table == {
        "table": "offset of the gyro",
        "from (degC)": 20.0,
        "to (degC)": 30.0,
        "nodes": 2,
        "extrapolated": 0,
    }
    parts = {row["part"]: row["content"] for row in told["tables"]["parts"]}
    assert "count to " in parts["gyro"]
    assert isinstance(parts["reference temperature (degC)"], float)
    assert "offset of the gyro" in undrift.good("info", path).out


def test_a_folder_is_listed_file_by_file_with_damage_named(undrift, bench, tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "walk.parquet").write_bytes((bench / "trial.parquet").read_bytes())
    (tmp_path / "torn.parquet").write_bytes((bench / "trial.parquet").read_bytes()[:500])
    before = contents(tmp_path)
    answer = undrift("info", tmp_path, "--json")
    rows = answer.json()["tables"]["recordings"]
    assert (answer.code, [(row["recording"], row["verdict"]) for row in rows]) == (
        1,
        [("torn.parquet", "error"), ("walk.parquet", "good")],
    )
    assert "100 Hz" in rows[1]["result"]
    several = undrift.good("info", tmp_path / "walk.parquet", bench / "corrected.parquet").out
    assert "2 of 2 recordings are done" in several
    assert "got an empty folder" in undrift.refused("info", tmp_path / "sub")
    assert contents(tmp_path) == before


def test_names_with_brackets_are_shown_as_they_are(undrift, bench, tmp_path):
    path = tmp_path / "[red]walk.parquet"
    path.write_bytes((bench / "trial.parquet").read_bytes())
    assert str(path) in undrift.good("info", path).out
    assert (
        path.name
        in undrift.good("correct", path, "--calibration", bench / "calibration.json", "-o", tmp_path / "o").out
    )


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


def test_a_map_of_one_key_serves_own_names_and_an_option_overrules_it(undrift, tmp_path):
    rows = "".join(f"{t},1,2,3\n" for t in (0.0, 0.01, 0.005, 0.02))
    (tmp_path / "r.csv").write_text("time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps\n" + rows)
    (tmp_path / "map.toml").write_text("repair_time = true\n")
    assert "repair_time = true in a map" in undrift.refused("info", tmp_path / "r.csv")
    told = undrift.good("info", tmp_path / "r.csv", "--map", tmp_path / "map.toml", "--json").json()
    assert told["data"]["rows"] == 3
    assert told["data"]["problems"][0].startswith("1 rows were left out")
    assert (told["findings"][0]["code"], told["findings"][0]["values"]["count"]) == ("recording.rows_left_out", 1)
    (tmp_path / "gap.csv").write_text("time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps\n0,1,2,3\n0.01,,2,3\n0.02,1,2,3\n")
    assert 'gaps = "keep" in a map' in undrift.refused("info", tmp_path / "gap.csv")
    (tmp_path / "keep.toml").write_text('gaps = "keep"\n')
    assert undrift.good("info", tmp_path / "gap.csv", "--map", tmp_path / "keep.toml", "--json").data()["gaps"] == 1


def test_the_findings_of_a_verdict_stand_one_by_one_and_all_with_details(undrift, bench, tmp_path):
    held = json.loads((bench / "calibration.json").read_text())
    found = [finding("gyro.scale_factor", "warn", f"It is {6.0 + k} % off.") for k in range(5)]
    verdict = Verdict.of(*found)
    held["verdict"] = tree_of(verdict)
    (tmp_path / "c.json").write_text(json.dumps(held))
    answer = undrift.good("info", tmp_path / "c.json", "--json").json()
    assert answer["verdict"] == "marginal"
    assert [item["text"] for item in answer["findings"]] == [*verdict.reasons]
    lines = undrift.good("info", tmp_path / "c.json").out.splitlines()
    listed = lines[lines.index("verdict: marginal") + 1 :]
    assert sum(line.startswith("  - ") for line in listed) == 3
    assert any("2 more: --details" in line for line in listed)
    lines = undrift.good("info", tmp_path / "c.json", "--details").out.splitlines()
    listed = lines[lines.index("verdict: marginal") + 1 :]
    assert sum(line.startswith("  - ") for line in listed) >= 5


def test_every_public_folder_was_found():
    if EVERY:
        assert sum("/" not in name for name in EVERY) == len(list(DATA.iterdir()))
        assert len(EVERY) > 80


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("shimmer_consensys/read_test_data.csv", "--sensor LN"),
        ("delsys_trigno/truncated_trigno_sample.csv", "--sensor 'Mini sensor 10'"),
        ("stm_mems_logs/unico_acc_only_driving.txt", "--sample-rate-hz 26"),
    ],
)
def test_what_an_export_leaves_open_is_asked_for_by_an_option_that_opens_it(undrift, name, hint):
    path = data_path("makers", name)
    printed = undrift.good("info", path).out
    if "26" in hint:  # nobody but its owner knows the rate
        assert "Set --sample-rate-hz" in printed
    else:
        assert f"Next: undrift info {path} {hint}\n" in printed
    told = undrift.good("info", path, *shlex.split(hint), "--json").json()
    assert told["data"]["kind"] == "recording"
    assert {item["code"] for item in told["findings"]} <= {"recording.uneven_sampling", "recording.rows_left_out"}


def stamp_by_host(undrift, path):
    """Write a simulated recording with the times at which a host received its samples; return how many samples it has."""
    undrift.good("simulate", "free", "--device", "mpu6050", "-o", path.with_suffix(".parquet"))
    record = stamp_on_host(read_record(path.with_suffix(".parquet")), rng=np.random.default_rng(0)).record
    write_record(record, path)
    return len(record)


@pytest.mark.slow
def test_stamps_of_a_host_are_named_with_what_mends_them(undrift, tmp_path):
    samples = stamp_by_host(undrift, tmp_path / "host.csv")
    said = undrift.good("info", tmp_path / "host.csv").out
    assert "steps of 1 to 43 ms" in said
    assert "Read it with clock = 'regular' in a map" in said
    (tmp_path / "map.toml").write_text('clock = "regular"\n')
    words = ("info", tmp_path / "host.csv", "--map", tmp_path / "map.toml")
    told = undrift.good(*words, "--json").data()
    assert told["rows"] == samples
    assert told["usual_rate_hz"] == pytest.approx(100.0, rel=1e-3)
    assert "regular clock of" in undrift.good(*words).out


def test_a_session_is_read_on_its_regular_clock(undrift, tmp_path):
    stamp_by_host(undrift, tmp_path / "host.csv")
    head = '[session]\nkind = "calibration"\nserial = "A"\ngravity_m_s2 = 9.81\n'
    (tmp_path / "session.toml").write_text(head + '[[recording]]\nfile = "host.csv"\n')
    plain = undrift.good("info", tmp_path / "session.toml", "--json").data()
    (tmp_path / "session.toml").write_text(head + '[[recording]]\nfile = "host.csv"\nclock = "regular"\n')
    fitted = undrift.good("info", tmp_path / "session.toml", "--json").data()
    assert any("stamps are the host's" in problem for problem in plain["problems"])
    assert not any("stamps are the host's" in problem for problem in fitted["problems"])
    assert fitted["usual_rate_hz"] == pytest.approx(100.0, rel=1e-3)
