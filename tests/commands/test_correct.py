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


@pytest.mark.parametrize(
    ("change_c", "words"), [(0.0, "none outside"), (12.0, "from the temperature"), (None, "not compared")]
)
def test_answer_says_how_far_the_temperature_is_from_the_calibration(undrift, bench, tmp_path, change_c, words):
    record = read_record(bench / "trial.parquet")
    temp_c = None if change_c is None else record.temp_c + change_c
    write_record(replace(record, temp_c=temp_c), tmp_path / "r.parquet")
    calibration = bench / "calibration.json"
    made = undrift("correct", tmp_path / "r.parquet", "--calibration", calibration, "-o", tmp_path / "c.parquet")
    assert words in made.out.splitlines()[0] + made.out.splitlines()[1]


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
    assert "this file is an input" in line
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
        there, here = contents(tmp_path / "there"), contents(tmp_path / "here")
        assert {name: there[name] for name in here if name != "summary.csv"} == {
            name: content for name, content in here.items() if name != "summary.csv"
        }
        torn.write_bytes(records[0].read_bytes()[:5000])
        answer = undrift("correct", torn, *words, "-o", tmp_path / "part", "--scheduler", address)
        assert answer.code == 1
        assert "1 failed" in answer.out
        assert not (tmp_path / "part" / "torn.parquet").exists()


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
