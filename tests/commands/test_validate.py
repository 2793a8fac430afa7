"""undrift validate: BROAD, simulated trials, and markers as the reference."""

import json
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from benchmarks.broad_files import broad_file

from testkit.data import data_path, show
from testkit.hand_turns import Device, make_recording
from testkit.walking import perfect_calibration
from undrift.io.formats import write_record
from undrift.io.reference import write_reference
from undrift.io.store import read_calibration, write_calibration

pytestmark = pytest.mark.usefixtures("computed_once")

B = [
    "02_undisturbed_slow_rotation_B", "05_undisturbed_slow_rotation_with_breaks_B", "07_undisturbed_fast_rotation_B",
    "09_undisturbed_fast_rotation_with_breaks_B",
]  # fmt: skip


def broad(*names):
    data_path("broad")
    return [broad_file(name) for name in names]


def end(told):
    return told["mean"]["end_total_deg"]


@pytest.mark.slow
def test_each_recording_judged_by_the_others_and_what_is_written(undrift, tmp_path):
    words = ["--calibrate-from", "reference", "--leave-one-out"]
    out = tmp_path / "report"
    answer = undrift.good("validate", *broad(*B), *words, "-o", out, "--json")
    assert {path.name for path in out.iterdir()} == {"validation.json", "report.html", "calibration.json"}
    written = json.loads((out / "validation.json").read_text())
    told = written["data"]
    show("BROAD B, leave one out, mean end error, deg", f"{end(told):.2f}", 1.5)
    assert end(told) < 1.5
    assert told["leave_one_out"] is True
    made = read_calibration(out / "calibration.json")
    assert made.gyro is not None
    assert [name for name, _ in made.provenance.inputs] == [path.name for path in broad(*B)]
    assert datetime.fromisoformat(made.provenance.created).tzinfo == UTC
    assert dict(made.provenance.versions).keys() == {"undrift", "numpy", "scipy"}
    page = (out / "report.html").read_text()
    assert page.count("<svg") == 6  # the errors, the levels and four courses
    assert "calibrated with the other recordings" in page
    assert page.count("the same file") == 4
    rows = {row["level"]: row for row in told["levels"]["errors"]}
    uncalibrated = rows["uncalibrated"]
    assert told["levels"]["quantity"] == "total"
    assert np.mean(uncalibrated["error_deg"]) > 5.0 * np.mean(rows["constants"]["error_deg"])
    assert np.mean(uncalibrated["simulated_deg"]) == pytest.approx(np.mean(uncalibrated["error_deg"]), rel=0.15)
    assert told["calibration"] == "reference"
    assert answer.json() == written


@pytest.mark.slow
@pytest.mark.parametrize("offset", ["rest", "motion"])
def test_correct_orient_and_validate_subtract_the_rate_of_the_same_first_rest(undrift, tmp_path, offset):
    # two rests before the motion; the device is jolted between them, and its offset then is another
    rng = np.random.default_rng(23)
    record, reference = make_recording(rng, Device(noise=1e-3), rest_s=16.0, turn_s=20.0, tilt=0.1)
    gyro, accel = np.array(record.gyro), np.array(record.accel) + 2e-3 * rng.standard_normal((len(record), 3))
    first, jolt = record.time < 7.0, (record.time >= 7.0) & (record.time < 9.0)
    gyro += np.where(first[:, None], [0.02, -0.01, 0.005], [0.021, -0.008, 0.004])
    swing = np.sin(2.0 * np.pi * (record.time[jolt] - 7.0) * 2.0)[:, None]
    gyro[jolt] += 0.5 * swing
    accel[jolt] += swing
    record = replace(record, gyro=gyro, accel=accel)
    write_record(record, tmp_path / "r.parquet")
    write_reference(reference, tmp_path / "ref.parquet")
    write_calibration(perfect_calibration(), tmp_path / "c.json")
    words = (tmp_path / "r.parquet", "--calibration", tmp_path / "c.json", "--offset", offset, "--json")
    corrected = undrift.good("correct", *words, "-o", tmp_path / "c.parquet").data()["rest"]
    oriented = undrift.good("orient", *words, "-o", tmp_path / "o.csv").data()
    judged = undrift.good("validate", *words, "--reference", tmp_path / "ref.parquet").data()["trials"][0]["rest"]
    assert corrected == judged
    assert 5.0 < judged["rest_s"][1] < 7.0
    assert oriented["still_s"] == pytest.approx(judged["rest_s"])
    np.testing.assert_allclose(oriented["offset_dps"], judged["offset_dps"], rtol=1e-12)
    near = (
        1.5e-4 if offset == "rest" else 1e-3
    )  # 5 sigma of 1300 samples; the jolt is a move, after which it is another
    np.testing.assert_allclose(np.radians(judged["offset_dps"]), [0.02, -0.01, 0.005], atol=near)
