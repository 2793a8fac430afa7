"""undrift correct: one recording, many, every ending, and nothing half done."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from testkit.command_line import contents
from undrift.io.formats import read_record, write_record


@pytest.mark.parametrize("name", ["c.parquet", "c.csv", "c.csv.gz"])
def test_one_recording_is_corrected_into_a_file_of_any_ending(undrift, bench, tmp_path, name):
    answer = undrift.good(
        "correct", bench / "trial.parquet", "--calibration", bench / "calibration.json", "-o", tmp_path / name
    )
    made, known = read_record(tmp_path / name), read_record(bench / "corrected.parquet")
    assert (made.state, made.gyro_unit, made.accel_unit) == ("corrected", "rad/s", "m/s2")
    np.testing.assert_allclose(made.gyro, known.gyro, atol=1e-12, rtol=0.0)  # rad/s, rounding alone
    lines = answer.out.splitlines()
    assert lines[0].startswith(f"{len(known)} samples are in rad/s and m/s2, none outside")
    assert lines[-2:] == [
        f"Wrote {tmp_path / name}",
        f"Next: undrift orient {tmp_path / name} -o {tmp_path / 'angles.csv'}",
    ]
    beside = [name + ".json"] if ".csv" in name else []
    assert sorted(path.name for path in tmp_path.iterdir()) == [name, *beside]


def test_a_corrected_csv_is_plain_for_pandas_and_states_where_it_came_from_beside_it(undrift, bench, tmp_path):
    words = ("correct", bench / "trial.parquet", "--calibration", bench / "calibration.json", "-o", tmp_path / "c.csv")
    undrift.good(*words)
    table, known = pd.read_csv(tmp_path / "c.csv"), read_record(bench / "corrected.parquet")
    assert list(table)[:4] == ["time_s", "gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s"]
    np.testing.assert_allclose(table[list(table)[1:4]], known.gyro, atol=1e-12, rtol=0.0)  # rad/s, rounding alone
    stated = json.loads((tmp_path / "c.csv.json").read_text())
    assert (stated["frame"], stated["state"], stated["samples"]) == ("b", "corrected", len(known))
    assert stated["columns"]["accel_z_m_s2"] == "m/s2"
    inputs = {item["file"]: item["sha256"] for item in stated["provenance"]["inputs"]}
    assert inputs["calibration.json"] == hashlib.sha256((bench / "calibration.json").read_bytes()).hexdigest()
    assert inputs["trial.parquet"] == hashlib.sha256((bench / "trial.parquet").read_bytes()).hexdigest()
    again = undrift.refused("correct", tmp_path / "c.csv", *words[2:4], "-o", tmp_path / "d.csv")
    assert "got a corrected record" in again


def test_a_file_beside_the_output_that_is_read_is_not_written_over(undrift, bench, tmp_path):
    model = tmp_path / "c.csv.json"
    model.write_bytes((bench / "calibration.json").read_bytes())
    before = contents(tmp_path)
    line = undrift.refused("correct", bench / "trial.parquet", "--calibration", model, "-o", tmp_path / "c.csv")
    assert "this file is also read" in line
    assert contents(tmp_path) == before


@pytest.mark.slow
def test_workers_of_a_scheduler_write_the_same_bytes(undrift, bench, tmp_path):
    import distributed

    raw = read_record(bench / "trial.parquet")
    records = [tmp_path / f"walk{k}.parquet" for k in range(3)]
    for record in records:
        write_record(raw, record)
    words = [*records, "--calibration", bench / "calibration.json"]
    undrift.good("correct", *words, "-o", tmp_path / "here")
    torn = tmp_path / "torn.parquet"
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=True,
        dashboard_address="127.0.0.1:0",
        host="127.0.0.1",
        silence_logs=50,
    ) as cluster:
        address = cluster.scheduler_address
        undrift.good("correct", *words, "-o", tmp_path / "there", "--scheduler", address)
        assert contents(tmp_path / "there") == contents(tmp_path / "here")
        torn.write_bytes(records[0].read_bytes()[:5000])
        answer = undrift("correct", torn, *words, "-o", tmp_path / "part", "--scheduler", address)
        assert answer.code == 1
        assert "1 failed" in answer.out
        assert not (tmp_path / "part" / "torn.parquet").exists()


@pytest.mark.parametrize("name", ["out.csv", "out.parquet"])
def test_specific_force_that_no_motion_explains_is_refused_by_the_name_of_its_unit(undrift, bench, tmp_path, name):
    """A file in m/s2 that says g reads 9.8 g; 2.5 times gravity from one shaken hard is told and written."""
    record = read_record(bench / "trial.parquet")
    command = ("--calibration", bench / "calibration.json", "-o", tmp_path / name)
    for factor in (9.80665, 1 / 9.80665):
        write_record(replace(record, accel=record.accel * factor), tmp_path / "wrong.parquet")
        said = undrift.refused("correct", tmp_path / "wrong.parquet", *command)
        assert "accelerometer: expected gravity" in said
        assert "--map (units = { accel = ... })" in said
        assert not (tmp_path / name).exists()
    write_record(replace(record, accel=record.accel * 2.5), tmp_path / "hard.parquet")
    assert "body at rest reads 1 g" in undrift.good("correct", tmp_path / "hard.parquet", *command).out
    assert (tmp_path / name).exists()


def test_the_offset_at_a_rest_is_subtracted_the_same_from_a_stream_and_at_once_and_stated(undrift, bench, tmp_path):
    raw, known = read_record(bench / "trial.parquet"), read_record(bench / "corrected.parquet")
    write_record(raw, tmp_path / "raw.csv")
    words, rows = ("--calibration", bench / "calibration.json", "--offset", "rest"), []
    for record, name in ((bench / "trial.parquet", "a.parquet"), (tmp_path / "raw.csv", "a.csv")):
        told = undrift.good("correct", record, *words, "-o", tmp_path / name, "--json").json()
        rows.append(told["data"])
        made = read_record(tmp_path / name)
        left = np.radians(rows[-1]["rest"]["offset_dps"])
        np.testing.assert_allclose(known.gyro - made.gyro, np.tile(left, (len(raw), 1)), atol=1e-9)
    start_s, stop_s = rows[0]["rest"]["rest_s"]
    inside = (known.time >= start_s) & (known.time <= stop_s)
    np.testing.assert_allclose(rows[0]["rest"]["offset_dps"], np.degrees(known.gyro[inside].mean(axis=0)), atol=1e-12)
    assert rows[1]["rest"]["rest_s"] == pytest.approx(rows[0]["rest"]["rest_s"], abs=1e-6)
    assert rows[1]["rest"]["offset_dps"] == pytest.approx(rows[0]["rest"]["offset_dps"], abs=1e-9)
    assert 0.0 < max(rows[0]["rest"]["offset_uncertainty_dps"]) < 0.1
    assert any("offset was subtracted" in note for note in told["notes"])
    stated = json.loads((tmp_path / "a.csv.json").read_text())
    assert stated["provenance"]["settings"]["offset"] == "rest"
    corrected = ("orient", bench / "corrected.parquet", "--offset", "rest", "-o", tmp_path / "o.csv", "--json")
    same = undrift.good(*corrected).data()  # orient's own option takes the same rest and the same rate
    assert same["offset_dps"] == pytest.approx(rows[0]["rest"]["offset_dps"], abs=1e-12)
    assert same["still_s"] == pytest.approx(rows[0]["rest"]["rest_s"])


def test_a_rest_is_named_by_its_times_and_refused_where_there_is_none(undrift, bench, tmp_path):
    words = ("--calibration", bench / "calibration.json", "-o", tmp_path / "a.parquet")
    named = ("--rest-s", "0.5:1.5")
    told = undrift.good("correct", bench / "trial.parquet", *words, "--offset", "rest", *named, "--json").data()
    assert told["rest"]["rest_s"] == pytest.approx([0.5, 1.49], abs=0.011)
    (tmp_path / "a.parquet").unlink()
    assert "--rest-s requires --offset rest or motion" in undrift.refused(
        "correct", bench / "trial.parquet", *words, *named
    )
    raw = read_record(bench / "trial.parquet")
    rng = np.random.default_rng(1)
    shaken = replace(raw, gyro=raw.gyro + 300.0 * rng.normal(size=raw.gyro.shape))
    write_record(shaken, tmp_path / "shaken.parquet")
    before = contents(tmp_path)
    line = undrift.refused("correct", tmp_path / "shaken.parquet", *words, "--offset", "rest")
    assert "shaken.parquet: correct: no still phase" in line
    assert contents(tmp_path) == before
