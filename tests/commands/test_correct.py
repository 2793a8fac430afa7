"""undrift correct: one recording, many, every ending, and nothing half done."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from testkit.command_line import contents
from undrift.io.formats import read_record, write_record
from undrift.io.store import read_calibration, write_calibration
from undrift.model import DriftTables, StaticDrift, WarmUp
from undrift.record import Record
from undrift.segments import find_still
from undrift.units import RADIAN_PER_DEGREE


@pytest.mark.parametrize("name", ["c.parquet", "c.csv", "c.csv.gz"])
def test_one_recording_is_corrected_into_a_file_of_any_ending(undrift, bench, tmp_path, name):
    answer = undrift.good(
        "correct", bench / "trial.parquet", "--calibration", bench / "calibration.json", "-o", tmp_path / name
    )
    made, known = read_record(tmp_path / name), read_record(bench / "corrected.parquet")
    assert (made.state, made.gyro_unit, made.accel_unit) == ("corrected", "rad/s", "m/s2")
    np.testing.assert_allclose(made.gyro, known.gyro, atol=1e-12, rtol=0.0)  # rad/s, rounding alone
    lines = answer.out.splitlines()
    answer_of_page = f"{len(known)} samples are in rad/s and m/s2, none outside the temperatures of the calibration."
    assert (lines[0], lines[-2]) == (answer_of_page, f"Wrote {tmp_path / name}")
    assert lines[-1] == f"Next: undrift orient {tmp_path / name} -o {tmp_path / 'angles.csv'}"
    assert " ".join([line for line in lines if "trial.parquet" in line][1].split()) == (
        f"trial.parquet {name} {len(known)} 0 0 0"
    )
    assert "  warning: " not in answer.out
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


def test_several_recordings_go_into_a_folder_under_their_own_names(undrift, bench, tmp_path):
    raw = read_record(bench / "trial.parquet")
    for name in ("walk.v1.csv", "walk.v2.csv.gz", "sit.parquet"):
        write_record(raw, tmp_path / name)
    records = [tmp_path / name for name in ("walk.v1.csv", "walk.v2.csv.gz", "sit.parquet")]
    calibration = ["--calibration", bench / "calibration.json"]
    told = undrift.good("correct", *records, *calibration, "-o", tmp_path / "out", "--json").json()
    assert [row["output"] for row in told["recordings"]] == [
        str(tmp_path / "out" / name) for name in ("walk.v1.parquet", "walk.v2.parquet", "sit.parquet")
    ]
    assert all(set(row) >= {"recording", "samples", "samples_outside", "findings"} for row in told["recordings"])
    assert {row["samples"] for row in told["recordings"]} == {len(raw)}
    assert all(read_record(row["output"]).state == "corrected" for row in told["recordings"])
    before = contents(tmp_path / "out")
    undrift.good("correct", *records, *calibration, "-o", tmp_path / "out")  # again: the same bytes
    assert contents(tmp_path / "out") == before


def test_a_recording_at_another_temperature_is_corrected_with_a_warning_on_stdout(undrift, bench, tmp_path):
    raw = read_record(bench / "trial.parquet")
    write_record(replace(raw, temp_c=raw.temp_c + 15.0), tmp_path / "warm.parquet")
    answer = undrift.good(
        "correct", tmp_path / "warm.parquet", "--calibration", bench / "calibration.json", "-o", tmp_path / "c.csv"
    )
    assert "  warning: " in answer.out
    assert "degC" in answer.out


def test_rests_are_stated_and_drawn_raw_beside_corrected(undrift, bench, tmp_path):
    raw, done = read_record(bench / "trial.parquet"), read_record(bench / "corrected.parquet")
    model = read_calibration(bench / "calibration.json")
    words = ("correct", bench / "trial.parquet", "--calibration", bench / "calibration.json", "-o", tmp_path / "c.csv")
    at_rest = undrift.good(*words, "--json").json()["recordings"][0]["at_rest"]
    stills = find_still(done).stills
    assert at_rest["rests"] == len(stills) > 1
    for key, name, ideal, unit in (
        ("accel_mg", "accel", model.gravity_m_s2, 9.80665e-3),
        ("rate_dps", "gyro", 0.0, RADIAN_PER_DEGREE),
    ):
        triad = getattr(model, name)
        assert triad.unit_in == "count"
        read = (getattr(raw, name) - triad.offset.mean()) / triad.scale_factor.mean()
        for prefix, values in (("raw_", read), ("", getattr(done, name))):
            sizes = [np.linalg.norm(values[one.start : one.stop].mean(axis=0)) for one in stills]
            expected = np.sqrt(np.mean((np.array(sizes) - ideal) ** 2)) / unit
            assert at_rest[prefix + key] == pytest.approx(expected, rel=1e-6)
    assert at_rest["raw_accel_mg"] > 10.0 * at_rest["accel_mg"]
    assert at_rest["raw_rate_dps"] > 10.0 * at_rest["rate_dps"]
    answer = undrift.good(*words, "--report", tmp_path / "r.html")
    line = next(line for line in answer.out.splitlines() if " -> " in line and "trial.parquet" in line)
    pairs = (f"{at_rest['raw_' + key]:.3g} -> {at_rest[key]:.3g}" for key in ("accel_mg", "rate_dps"))
    assert line.split() == ["trial.parquet", str(len(stills)), *" ".join(pairs).split()]
    assert "Each rest, raw and corrected" in (tmp_path / "r.html").read_text()


def test_raw_readings_in_a_physical_unit_are_taken_in_it_and_without_rests_none_are_compared(undrift, bench, tmp_path):
    model = read_calibration(bench / "calibration.json")
    gyro, accel = (
        replace(one, unit_in=unit, matrix=np.eye(3) * si, offset=np.full(3, 0.1))
        for one, unit, si in ((model.gyro, "dps", RADIAN_PER_DEGREE), (model.accel, "g", 9.80665))
    )
    write_calibration(replace(model, gyro=gyro, accel=accel, adc=None), tmp_path / "c.json")
    rng, time = np.random.default_rng(1), np.arange(2000) / 100.0
    for name, moves in (("rest", 0.0), ("moves", 1.0)):
        rates = 30.0 * moves * np.sin(time)[:, None] + rng.normal(0.0, 0.01, (2000, 3))
        force = (
            np.tile([0.0, 0.0, 1.1], (2000, 1))
            + rng.normal(0.0, 1e-3, (2000, 3))
            + moves * 0.3 * np.sin(9.0 * time)[:, None]
        )
        write_record(
            Record(time=time, gyro=rates, accel=force, gyro_unit="dps", accel_unit="g"), tmp_path / f"{name}.csv"
        )
    words = (
        "correct",
        tmp_path / "rest.csv",
        tmp_path / "moves.csv",
        "--calibration",
        tmp_path / "c.json",
        "-o",
        tmp_path / "o",
    )
    rest, moves = (row["at_rest"] for row in undrift.good(*words, "--json").json()["recordings"])
    assert rest["rests"] == 1
    assert rest["raw_accel_mg"] == pytest.approx(1e3 * (1.1 - model.gravity_m_s2 / 9.80665), abs=0.5)
    assert rest["raw_rate_dps"] == pytest.approx(0.0, abs=0.002)
    assert moves == {"rests": 0, "raw_accel_mg": None, "accel_mg": None, "raw_rate_dps": None, "rate_dps": None}
    cells = next(line for line in undrift.good(*words).out.splitlines() if "moves.csv" in line).split()
    assert cells == ["moves.csv", "0", "–", "->", "–", "–", "->", "–"]


@pytest.fixture
def tuned(bench, tmp_path):
    """The bench's calibration with a table of which the cold end is extrapolated, hysteresis and warm-up; a ramp through it."""
    c = read_calibration(bench / "calibration.json")
    static = StaticDrift(
        temp_c=[20.0, 25.0, 30.0],
        gyro_offset=np.tile(c.gyro.offset, (3, 1)),
        gyro_uncertainty=np.full((3, 3), 0.5),
        gyro_extrapolated=[True, False, False],
        gyro_hysteresis=[1.0, 1.0, 1.0],
        warm_up=WarmUp(power_on_s=[0.0, 600.0], gyro_offset=[[9.0, 9.0, 9.0], [0.0, 0.0, 0.0]]),
    )
    write_calibration(replace(c, drift=DriftTables(static=static)), tmp_path / "tuned.json")
    raw = read_record(bench / "trial.parquet")
    raw = replace(raw, temp_c=np.linspace(17.5, 32.5, len(raw)))
    for name in ("ramp.parquet", "ramp.csv"):
        write_record(raw, tmp_path / name)
    return raw


@pytest.mark.slow
def test_time_outside_and_at_extrapolated_nodes_is_told_in_text_and_json(undrift, tuned, tmp_path):
    words = ["--calibration", tmp_path / "tuned.json", "--policy", "hold"]
    lasts = len(tuned) / tuned.sample_rate_hz
    rows = []
    for name in ("ramp.parquet", "ramp.csv"):
        out = tmp_path / f"out.{name}"
        rows.append(undrift.good("correct", tmp_path / name, *words, "-o", out, "--json").json()["recordings"][0])
        text = undrift.good("correct", tmp_path / name, *words, "-o", out).out
        assert [line for line in text.splitlines() if line.startswith(("  warning", "  note"))] == [
            *(f"  warning: {found['text']}" for found in rows[-1]["findings"]),
            *(f"  note: {said}" for said in rows[-1]["notes"]),
        ]
    for row in rows:
        assert row["seconds_outside"] == pytest.approx(lasts / 3.0, abs=0.05)  # 2.5 degC of 15 at either end
        assert row["seconds_extrapolated"] == pytest.approx(lasts / 3.0, abs=0.05)  # 20 to 25 degC
        assert row["samples_outside"] == pytest.approx(row["seconds_outside"] * tuned.sample_rate_hz)
        assert [(one["code"], one["level"]) for one in row["findings"]] == [
            ("correct.outside", "warn"), ("correct.outside", "warn"),
        ]  # fmt: skip
        assert [one["values"]["seconds"] for one in row["findings"]] == [
            row["seconds_outside"], row["seconds_extrapolated"],
        ]  # fmt: skip
        assert row["notes"][0].startswith("Hysteresis is not corrected: half-width up to")
        assert row["notes"][1].startswith("No warm-up was subtracted: up to")
        assert len(row["notes"]) == 2
    assert rows[0]["findings"] == rows[1]["findings"], "streamed and at once"


def test_signs_of_another_unit_or_column_stand_among_the_findings(undrift, tuned, tmp_path):
    write_record(replace(tuned, gyro=None), tmp_path / "accel.parquet")
    words = ["--calibration", tmp_path / "tuned.json", "--policy", "hold", "-o", tmp_path / "o.parquet", "--json"]
    told = undrift.good("correct", tmp_path / "accel.parquet", *words).json()
    (found,) = (one for one in told["findings"] if one["code"] == "correct.sensors_differ")
    assert "no gyroscope" in found["text"]
    assert told["recordings"][0]["findings"] == told["findings"]


def test_time_without_temperature_is_told_under_every_policy_in_text_and_json(undrift, tuned, tmp_path):
    temp = np.full(len(tuned), 27.0)
    temp[100:300] = np.nan
    write_record(replace(tuned, temp_c=temp), tmp_path / "gaps.parquet")
    words = [
        "correct",
        tmp_path / "gaps.parquet",
        "--calibration",
        tmp_path / "tuned.json",
        "-o",
        tmp_path / "o.parquet",
    ]
    for policy in ("raise", "hold", "nan"):
        row = undrift.good(*words, "--policy", policy, "--json").json()["recordings"][0]
        assert row["samples_without_temperature"] == 200
        assert row["seconds_without_temperature"] == pytest.approx(200 / tuned.sample_rate_hz, abs=1e-6)
        assert "s without a temperature: the drift table cannot be evaluated there" in row["findings"][0]["text"]
        assert "  warning: " + row["findings"][0]["text"] in undrift.good(*words, "--policy", policy).out
        assert np.isnan(read_record(tmp_path / "o.parquet").gyro).any(axis=1).sum() == 200


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
        before = contents(tmp_path)
        torn.write_bytes(records[0].read_bytes()[:5000])
        line = undrift.refused("correct", torn, *words, "-o", tmp_path / "no", "--scheduler", address)
        assert "torn.parquet" in line
        torn.unlink()
        assert contents(tmp_path) == before


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
    assert "far from 1 g" in undrift.good("correct", tmp_path / "hard.parquet", *command).out
    assert (tmp_path / name).exists()


def test_the_offset_at_a_rest_is_subtracted_the_same_from_a_stream_and_at_once_and_stated(undrift, bench, tmp_path):
    raw, known = read_record(bench / "trial.parquet"), read_record(bench / "corrected.parquet")
    write_record(raw, tmp_path / "raw.csv")
    words, rows = ("--calibration", bench / "calibration.json", "--offset", "rest"), []
    for record, name in ((bench / "trial.parquet", "a.parquet"), (tmp_path / "raw.csv", "a.csv")):
        told = undrift.good("correct", record, *words, "-o", tmp_path / name, "--json").json()
        rows.append(told["recordings"][0])
        made = read_record(tmp_path / name)
        left = np.radians(rows[-1]["rest"]["offset_dps"])
        np.testing.assert_allclose(known.gyro - made.gyro, np.tile(left, (len(raw), 1)), atol=1e-9)
    start_s, stop_s = rows[0]["rest"]["rest_s"]
    inside = (known.time >= start_s) & (known.time <= stop_s)
    np.testing.assert_allclose(rows[0]["rest"]["offset_dps"], np.degrees(known.gyro[inside].mean(axis=0)), atol=1e-12)
    assert rows[1]["rest"]["rest_s"] == pytest.approx(rows[0]["rest"]["rest_s"], abs=1e-6)
    assert rows[1]["rest"]["offset_dps"] == pytest.approx(rows[0]["rest"]["offset_dps"], abs=1e-9)
    assert 0.0 < max(rows[0]["rest"]["offset_uncertainty_dps"]) < 0.1
    assert any("Offset subtracted" in note for note in rows[0]["notes"])
    stated = json.loads((tmp_path / "a.csv.json").read_text())
    assert stated["provenance"]["settings"]["offset"] == "rest"
    corrected = ("orient", bench / "corrected.parquet", "--offset", "rest", "-o", tmp_path / "o.csv", "--json")
    same = undrift.good(*corrected).json()  # orient's own option takes the same rest and the same rate
    assert same["offset_dps"] == pytest.approx(rows[0]["rest"]["offset_dps"], abs=1e-12)
    assert same["still"] == pytest.approx(rows[0]["rest"]["rest_s"])


def test_a_rest_is_named_by_its_times_and_refused_where_there_is_none(undrift, bench, tmp_path):
    words = ("--calibration", bench / "calibration.json", "-o", tmp_path / "a.parquet")
    named = ("--rest-s", "0.5:1.5")
    told = undrift.good("correct", bench / "trial.parquet", *words, "--offset", "rest", *named, "--json").json()
    assert told["recordings"][0]["rest"]["rest_s"] == pytest.approx([0.5, 1.49], abs=0.011)
    (tmp_path / "a.parquet").unlink()
    assert "--rest-s requires --offset rest or motion" in undrift.refused(
        "correct", bench / "trial.parquet", *words, *named
    )
    raw = read_record(bench / "trial.parquet")
    rng = np.random.default_rng(1)
    shaken = replace(raw, gyro=raw.gyro + 300.0 * rng.normal(size=raw.gyro.shape))
    write_record(shaken, tmp_path / "shaken.parquet")
    before = contents(tmp_path)
    both = (bench / "trial.parquet", tmp_path / "shaken.parquet")
    line = undrift.refused("correct", *both, *words[:2], "-o", tmp_path / "out", "--offset", "rest")
    assert "shaken.parquet: correct: no still phase" in line
    assert contents(tmp_path) == before
