"""undrift measure: measures of a task with their uncertainty, from files, folders and Python."""

import csv
import json
import time
from dataclasses import replace

import numpy as np
import pytest

import undrift
from testkit import planted
from undrift.commands.measure import DECIMALS, FIRST
from undrift.io.formats import read_record, write_record
from undrift.io.store import read_calibration, write_calibration
from undrift.measures.tasks import TASKS, TYPES, UNITS
from undrift.measures.uncertainty import Measure
from undrift.model import BodyMounting
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.sessions import simulate_trial

WORN = BodyMounting(place="lower-back", matrix=np.eye(3), covariance=np.radians(1.0) ** 2 * np.eye(3), basis="posture")


@pytest.fixture
def worn(bench, tmp_path):
    """The calibration of the bench with a mounting."""
    path = tmp_path / "worn.json"
    write_calibration(replace(read_calibration(bench / "calibration.json"), mounting=WORN), path)
    return path


@pytest.mark.slow
def test_a_raw_and_a_corrected_recording_give_the_same_measures(undrift, bench, tmp_path, worn):
    undrift.good("correct", bench / "trial.parquet", "--calibration", worn, "-o", tmp_path / "c.parquet")
    words = ("--task", "sit-to-stand", "--json")
    raw = undrift.good("measure", bench / "trial.parquet", "--calibration", worn, *words).json()
    corrected = undrift.good("measure", tmp_path / "c.parquet", "--mounting", worn, *words).json()
    assert raw["measures"].keys() == corrected["measures"].keys()
    for name, one in raw["measures"].items():
        for key, value in one.items():
            assert any(key.endswith(end) for end in UNITS)
            if key.startswith(("values", "mean")):
                assert value == pytest.approx(corrected["measures"][name][key], rel=1e-6)
    peak = raw["measures"]["peak_trunk_pitch_deg"]
    parts = peak["uncertainty_parts_deg"]
    assert next(iter(parts)) == "mounting"
    assert parts["mounting"] == pytest.approx(1.0, abs=0.02)  # 1 deg about the lateral axis turns the pitch by it
    assert peak["standard_uncertainty_deg"] == pytest.approx(np.linalg.norm(list(parts.values())))


@pytest.mark.slow
def test_the_answer_states_the_peak_with_what_its_uncertainty_is_made_of(undrift, bench, worn):
    shown = undrift.good("measure", bench / "trial.parquet", "--calibration", worn, "--task", "sit-to-stand")
    first = shown.out.splitlines()[0]
    assert first.startswith("sit-to-stand: duration ")
    assert " deg +- 1.0 (1.0 mounting" in first
    assert "smallest change" in shown.out
    in_python = undrift_measure(bench / "trial.parquet", calibration=worn)
    assert in_python.summary().answer == first
    assert [one.code for one in in_python.findings if one.code == "measure.limit_mounting"]


def undrift_measure(path, **stated):
    return undrift.measure(str(path), task="sit-to-stand", **stated)


@pytest.mark.slow
def test_events_are_a_table_of_bids_with_the_meaning_of_its_columns(undrift, bench, tmp_path, worn):
    out = tmp_path / "sub-01_task-chair_events.tsv"
    undrift.good("measure", bench / "trial.parquet", "--calibration", worn, "--task", "sit-to-stand", "-o", out)
    rows = list(csv.DictReader(out.read_text().splitlines(), delimiter="\t"))
    described = json.loads(out.with_suffix(".json").read_text())
    assert list(rows[0]) == list(described) == ["onset", "duration", "trial_type"]
    assert {row["trial_type"] for row in rows} == {"sit-to-stand", "flexion", "seat-off", "extension"}
    assert described["trial_type"]["Levels"].keys() == {row["trial_type"] for row in rows}
    onsets = [float(row["onset"]) for row in rows]
    assert onsets == sorted(onsets)
    whole, flexion, extension = (
        next(r for r in rows if r["trial_type"] == k) for k in ("sit-to-stand", "flexion", "extension")
    )
    assert float(flexion["duration"]) + float(extension["duration"]) == pytest.approx(
        float(whole["duration"]), abs=2e-4
    )


def test_eyes_closed_stand_beside_eyes_open(undrift, tmp_path, worn):
    device = random_device(np.random.default_rng(3))
    for k, name in enumerate(("open", "closed")):
        trial = simulate_trial("posturography", device, rng=np.random.default_rng(k))
        write_record(replace(trial.record, **_in_si(trial.record)), tmp_path / f"{name}.parquet")
    opened, closed = tmp_path / "open.parquet", tmp_path / "closed.parquet"
    words = ("measure", opened, "--task", "standing", "--up", "+z", "--eyes-closed")
    shown = undrift.good(*words, closed, "--json").json()
    assert shown["eyes_closed"].keys() == shown["measures"].keys()
    same = undrift.good(*words, opened)
    assert "1.00 +-" in same.out


def _in_si(record):
    """Readings of a device without errors, as its counts are none here."""
    known = record if record.gyro_unit == "rad/s" else undrift.correct(record, _nominal(record))
    return {"gyro": known.gyro, "accel": known.accel, "gyro_unit": "rad/s", "accel_unit": "m/s2", "state": "corrected"}


def _nominal(record):
    device = random_device(np.random.default_rng(3))
    return undrift.calibrate(undrift.simulate_session("bench", device, rng=np.random.default_rng(4)))


@pytest.mark.slow
def test_a_folder_gives_a_table(undrift, bench, tmp_path, worn):
    folder = tmp_path / "chairs"
    folder.mkdir()
    for name in ("a", "b"):
        write_record(read_record(bench / "trial.parquet"), folder / f"{name}.parquet")
    out = tmp_path / "events"
    undrift.good("measure", folder, "--calibration", worn, "--task", "sit-to-stand", "-o", out)
    assert {path.name for path in out.iterdir()} >= {"a_events.tsv", "b_events.json", "summary.csv"}


@pytest.fixture
def strides(tmp_path):
    """A corrected recording of a planted walk."""
    motion = planted.walk(np.random.default_rng([34, 4])).motion
    record = simulate_device(random_device(np.random.default_rng(3)), motion, rng=np.random.default_rng(1)).record
    path = tmp_path / "walk.parquet"
    write_record(replace(record, **_in_si(record)), path)
    return path


@pytest.mark.slow
def test_a_walk_has_its_cadence_its_strides_its_contacts_as_events_and_its_page(undrift, tmp_path, strides):
    out, page = tmp_path / "walk_events.tsv", tmp_path / "walk.html"
    shown = undrift.good(
        "measure", strides, "--task", "walk", "--up", "+z", "--forward", "+x", "-o", out, "--report", page, "--json"
    ).json()
    assert shown["strides"] == 20
    assert shown["measures"]["cadence_per_min"]["mean_per_min"] == pytest.approx(
        60.0 / shown["measures"]["step_duration_s"]["mean_s"]
    )
    rows = list(csv.DictReader(out.read_text().splitlines(), delimiter="\t"))
    assert [row["trial_type"] for row in rows].count("initial contact") == 24
    assert "measure.few_strides" in {one["code"] for one in shown["findings"]}
    text = undrift.good("measure", strides, "--task", "walk", "--up", "+z", "--forward", "+x").out
    assert text.startswith("walk, 20 strides: cadence ")
    assert "steps/min +-" in text.splitlines()[0]
    assert "upward acceleration" in page.read_text()
    assert "no rise" not in undrift.refused(
        "measure", strides, "--task", "sit-to-stand", "--up", "+z", "--forward", "+x"
    )


@pytest.mark.slow
def test_a_step_has_its_rise_its_pitch_and_its_events(undrift, tmp_path):
    motion = planted.step_up(np.random.default_rng([35, 4]), count=2)[0].motion
    record = simulate_device(random_device(np.random.default_rng(3)), motion, rng=np.random.default_rng(1)).record
    path, out = tmp_path / "step.parquet", tmp_path / "step_events.tsv"
    write_record(replace(record, **_in_si(record)), path)
    words = ("measure", path, "--task", "step", "--up", "+z", "--forward", "+x")
    text = undrift.good(*words, "-o", out).out
    assert text.startswith("step, 2 times: rise duration ")
    assert "peak trunk pitch" in text.splitlines()[0]
    assert [row["trial_type"] for row in csv.DictReader(out.read_text().splitlines(), delimiter="\t")] == [
        "rise",
        "rise",
    ]
    assert "walk: wanted 8 steps" in undrift.refused("measure", path, "--task", "walk", "--up", "+z", "--forward", "+x")


@pytest.mark.slow
def test_timed_up_and_go_has_its_phases_and_turns(undrift, tmp_path):
    motion = planted.up_and_go(np.random.default_rng([36, 4]))[0].motion
    record = simulate_device(random_device(np.random.default_rng(3)), motion, rng=np.random.default_rng(1)).record
    path, out, page = (tmp_path / f"tug{end}" for end in (".parquet", "_events.tsv", ".html"))
    write_record(replace(record, **_in_si(record)), path)
    text = undrift.good(
        "measure", path, "--task", "tug", "--up", "+z", "--forward", "+x", "-o", out, "--report", page
    ).out
    assert text.startswith("tug: tug duration ")
    assert "peak turn velocity" in text.splitlines()[0]
    kinds = [row["trial_type"] for row in csv.DictReader(out.read_text().splitlines(), delimiter="\t")]
    assert [kind for kind in kinds if kind in ("sit-to-stand", "walking", "turn", "stand-to-sit")] == [
        "sit-to-stand", "walking", "turn", "walking", "turn", "stand-to-sit"
    ]  # fmt: skip
    assert "turning (deg/s)" in page.read_text()


@pytest.fixture
def of_leg(tmp_path):
    """Corrected recordings of a planted person by a device at a shank and at a thigh."""
    rng = np.random.default_rng
    motions = {
        "shank": planted.walk_of_leg(rng([37, 4]), "shank")[0].motion, "thigh": planted.chair_of_thigh(rng([38, 4]))[0].motion
    }  # fmt: skip
    for name, motion in motions.items():
        record = simulate_device(random_device(rng(3)), motion, rng=rng(1)).record
        write_record(replace(record, **_in_si(record)), tmp_path / f"{name}.parquet")
    return {name: tmp_path / f"{name}.parquet" for name in motions}


def test_a_walk_by_a_shank_has_stance_and_swing_its_contacts_and_its_page(undrift, tmp_path, of_leg):
    out, page = tmp_path / "shank_events.tsv", tmp_path / "shank.html"
    words = ("measure", of_leg["shank"], "--task", "walk", "--worn", "shank")
    shown = undrift.good(*words, "-o", out, "--report", page, "--json").json()
    measures = shown["measures"]
    assert shown["place"] == "shank"
    assert measures["stance_duration_s"]["mean_s"] + measures["swing_duration_s"]["mean_s"] == pytest.approx(
        measures["stride_duration_s"]["mean_s"], abs=1e-6
    )
    kinds = [row["trial_type"] for row in csv.DictReader(out.read_text().splitlines(), delimiter="\t")]
    assert kinds.count("initial contact") == kinds.count("end contact") == shown["strides"] + 3
    assert "shank pitch (deg)" in page.read_text()
    first = undrift.good(*words).out.splitlines()[0]
    assert first.startswith(f"walk, {shown['strides']} strides: cadence ")
    assert "stance 6" in first


@pytest.mark.slow
def test_rises_by_a_thigh_take_their_place_from_the_mounting_or_by_name(undrift, tmp_path, of_leg, worn):
    at_thigh = tmp_path / "thigh.json"
    write_calibration(replace(read_calibration(worn), mounting=replace(WORN, place="thigh")), at_thigh)
    task = ("measure", of_leg["thigh"], "--task", "5xSTS")
    named, mounted = (
        undrift.good(*task, *how, "--json").json() for how in (("--worn", "thigh"), ("--mounting", at_thigh))
    )
    assert named["measures"].keys() == mounted["measures"].keys()
    assert named["measures"]["thigh_pitch_range_deg"]["mean_deg"] == pytest.approx(
        mounted["measures"]["thigh_pitch_range_deg"]["mean_deg"], abs=0.5
    )
    assert "peak thigh velocity" in undrift.good(*task, "--worn", "thigh").out.splitlines()[0]
    refused = undrift.refused(*task, "--mounting", at_thigh, "--worn", "lower-back")
    assert "wanted a device at the lower-back (--worn), got a mounting for the thigh" in refused
    words = ("measure", of_leg["thigh"], "--task", "standing", "--mounting", at_thigh)
    assert "standing: wanted a device at the lower-back, got one at the thigh" in undrift.refused(*words)
    words = ("measure", of_leg["shank"], "--task", "sit-to-stand", "--worn", "shank")
    assert "sit-to-stand: wanted a device at the lower-back or thigh, got one at the shank" in undrift.refused(*words)


@pytest.mark.slow
def test_what_halves_the_uncertainty_is_stated_in_numbers(undrift, bench, worn):
    """Mounting alone limits the peak: its part must fall by a known share, and no calibration halves it."""
    found = undrift_measure(bench / "trial.parquet", calibration=worn)
    peak = next(one for one in found.measures if one.name == "peak_trunk_pitch_deg")
    limit = next(one for one in found.findings if one.code == "measure.limit_mounting")
    share = limit.values["aim"] / limit.values["size"]
    assert limit.values["size"] == pytest.approx(1.0)
    assert np.hypot(share * peak.parts["mounting"], peak.without("mounting")) == pytest.approx(0.5 * peak.uncertainty)
    assert limit.values["times"] == np.ceil(share**-2)
    shown = undrift.good(
        "measure", bench / "trial.parquet", "--calibration", worn, "--task", "sit-to-stand", "--details"
    ).out
    assert "A perfect calibration would leave 1 of 1 deg of the uncertainty of peak trunk pitch." in shown
    assert "Next:" not in shown


def test_a_calibration_that_limits_an_angle_names_the_study_that_finds_a_better_one(bench, worn):
    found = undrift_measure(bench / "trial.parquet", calibration=worn)
    names, values = ("mounting", "calibration", "offset"), np.array([30.0])
    one = Measure(name="peak_trunk_pitch_deg", values=values, columns=np.array([[0.1], [0.8], [0.1]]), sources=names)
    summary = replace(found, measures=(one,)).summary()
    small = np.sqrt(0.25 * 0.66 - 0.02)
    assert summary.next == ("study", "--preset", "note", "--target-deg", f"{small:.2g}", "-o", "study")
    several = Measure(
        name="peak_trunk_pitch_deg", values=values, columns=np.array([[0.5], [0.5], [0.1]]), sources=names
    )
    assert several.halving("mounting") == several.halving("calibration") == 0.0
    assert replace(found, measures=(several,)).summary().next == ()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--task", "standing"), "standing: wanted 10 s or more of quiet stance"),
        (
            ("--task", "walk"),
            "walk: wanted 8 steps or more in a row, alike, without turn or bow, got 1 in a row at most; record",
        ),
        (("--task", "step"), "step: wanted a rise of 0.08 to 0.27 m, got a rise of 0."),
        (
            ("--task", "tug"),
            "tug: wanted a rise, steps, a turn of 90 deg or more, steps, a turn and sitting down, got a rise and",
        ),
        (("--task", "5xSTS"), "5xSTS: wanted five rises from a seat, got 1; record all five"),
        (
            ("--task", "sit-to-stand", "--up", "+x", "--forward", "-z"),
            "deg off, whose +z is nearest to up; state its sides",
        ),
        (("--task", "sit-to-stand", "--up", "+z", "--forward", "-z"), "wanted two axes of the device"),
        (("--task", "sit-to-stand", "--eyes-closed", "a.csv"), "wanted eyes_closed with the task standing alone"),
        (("--task", "sit-to-stand", "--mounting", "{calibration}"), "wanted a calibration that keeps a mounting"),
    ],
)
def test_what_a_recording_does_not_show_is_refused(undrift, bench, words, text):
    words = [one.format(calibration=bench / "calibration.json") for one in words]
    assert text in undrift.refused("measure", bench / "corrected.parquet", *words)


@pytest.mark.slow
def test_a_minute_is_measured_in_two_seconds(worn):
    device = random_device(np.random.default_rng(3))
    record = simulate_trial("posturography", device, rng=np.random.default_rng(1)).record
    record = replace(record, **_in_si(record))
    from undrift.measures.standing import sway
    from undrift.measures.uncertainty import instrument, take

    take(instrument(record, None, WORN), sway)  # compiled, imported
    began = time.process_time()
    take(instrument(record, None, WORN), sway)
    taken_s = time.process_time() - began
    print(f"  {record.duration_s:.0f} s of stance measured in {taken_s:.2f} s of a processor   (limit 2)")
    assert taken_s < 2.0


def test_every_task_has_an_answer_every_unit_decimals_and_every_event_a_meaning():
    assert FIRST.keys() >= set(TASKS)
    assert set(UNITS.values()) <= DECIMALS.keys()
    assert all(text for text in TYPES.values())
