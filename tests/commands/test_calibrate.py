"""undrift calibrate: real sessions written as session.toml, and the simulated bench."""

import json
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.broad import DEVICES, trial
from benchmarks.in_motion import pairs

from testkit.command_line import contents, row_of
from testkit.data import data_path, needs_data, show
from testkit.stepper_jig import turned
from undrift.correction.answer import pitch_limits
from undrift.frames import quaternion_conjugate, quaternion_product
from undrift.io.formats import read_reference, write_record
from undrift.io.session import write_session
from undrift.io.store import content_hash, read_calibration
from undrift.orientation import heading_of
from undrift.record import Session
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session

HEAD = '[session]\nkind = "calibration"\nserial = "{serial}"\ngravity_m_s2 = {gravity}\n'


def written(folder, serial, recordings, *, gravity=9.81, pieces=""):
    folder.mkdir()
    text = HEAD.format(serial=serial, gravity=gravity) + "".join(f"[[recording]]\n{entry}\n" for entry in recordings)
    (folder / "session.toml").write_text(text + pieces)
    return folder


def test_a_worn_recording_is_refused_for_want_of_a_still_phase(undrift, tmp_path):
    entry = (
        f'file = "{data_path("worn_lowback", "HA_001_Test11.csv.gz")}"\nsample_rate_hz = 100\n'
        'columns = { gyro = ["gyr_x", "gyr_y", "gyr_z"], accel = ["acc_x", "acc_y", "acc_z"] }\n'
        'units = { gyro = "dps", accel = "g" }'
    )
    session = written(tmp_path / "s", "worn", [entry])
    before = contents(tmp_path)
    assert "still" in undrift.refused("calibrate", session, "-o", tmp_path / "c.json")
    assert contents(tmp_path) == before


@pytest.mark.slow
def test_the_bench_is_calibrated_by_every_way_that_it_allows(undrift, bench, tmp_path):
    session = bench / "session"
    answer = undrift.good("calibrate", session)
    assert "Nothing was written" in answer.out
    assert answer.out.startswith("Good for a sit-to-stand after a rest: pitch within 0.")
    told = undrift.good("calibrate", session, "--json", "-o", tmp_path / "c.json").json()
    model = read_calibration(tmp_path / "c.json")
    assert told["data"]["gyro"]["method"] == "rate-table/affine"
    assert json.loads((tmp_path / "c.json").read_text()) == told["data"]
    after, warmer, without = (
        row_of(told, "pitch_of_a_sit_to_stand", name)["after 60 s (deg)"]
        for name in ("after a rest", "after a rest, 5 K warmer", "without a rest")
    )
    assert after == pytest.approx(np.degrees(pitch_limits(model)[1]))
    assert after < warmer < without
    offset = row_of(told, "gyroscopes_parameters", "offset_x")["value"]
    assert (offset["value"], offset["uncertainty"]) == (model.gyro.offset[0], model.gyro.standard_uncertainty[9])
    row = row_of(told, "recordings", "recording_0.parquet")
    assert (row["rests used"], row["turns used"], row["not used"]) == (9, 12, 0)
    for words in (["--accel", "six-face"], ["--gyro", "rate-table"], ["--mode", "affine"], ["--latitude-deg", "45"]):
        assert undrift.good("calibrate", session, *words, "--json").json()["verdict"] in ("good", "marginal")
    turned = undrift.good("calibrate", session, "--latitude-deg", "45", "--json").json()
    assert turned["data"]["gyro"]["offset"] != told["data"]["gyro"]["offset"]


@pytest.mark.parametrize("word", ["session", "session/session.toml"])
def test_a_session_is_named_by_its_folder_or_its_file(undrift, bench, word):
    assert undrift.good("calibrate", bench / word, "--json").json()["verdict"] == "good"


@pytest.mark.parametrize(("sensor", "code"), [("bno", 0), ("lsm", 1)])
def test_a_rate_table_about_one_axis_is_written_and_a_wrong_conversion_ends_with_one(undrift, tmp_path, sensor, code):
    """Rimu_Test_Jig: the ST sensor was converted with 30.5 in place of 35 mdeg/s a code (SOURCE.md), the Bosch one well."""
    record, turns = turned("giro_test_filt", sensor)
    write_session(
        Session(kind="calibration", serial="jig", gravity_m_s2=9.81, records=(record,), turns=turns), tmp_path / "s"
    )
    answer = undrift("calibrate", tmp_path / "s", "--details", "-o", tmp_path / "c.json")
    assert answer.code == code
    assert ("Gyroscope y is" in answer.out) == bool(code)
    assert answer.out.startswith("Do not use" if code else "Not good enough")
    assert "x, z" in answer.out  # axes without turns keep their nominal scale
    made = read_calibration(tmp_path / "c.json").gyro
    off = made.forward_matrix[1, 1] * np.pi / 180.0 - 1.0
    show(f"{sensor}: scale of y off by", f"{100 * off:.2f} %", "0.4 % or -15 %")
    assert abs(off) > 0.1 if code else abs(off) < 0.005  # never the identity in silence
    assert made.standard_uncertainty[0] / made.matrix[0, 0] == pytest.approx(0.03, rel=0.1)


def test_a_calibration_without_accelerometers_is_not_offered_for_correct_and_says_what_is_missing(undrift, tmp_path):
    session = simulate_session("bench", random_device(np.random.default_rng(7)), rng=np.random.default_rng(8))
    four = replace(session, stills=tuple(still for still in session.stills if still.face not in ("-y", "+x")))
    write_session(four, tmp_path / "s")
    answer = undrift.good("calibrate", tmp_path / "s", "-o", tmp_path / "c.json")
    assert "Next: undrift correct" not in answer.out
    assert "The accelerometers are not calibrated" in answer.out
    first = answer.out[answer.out.index("verdict: ") :].splitlines()[1:2]
    assert first[0].startswith("  - The session does not determine the accelerometer")
    assert "without a rest: +x, -y" in first[0]
    assert undrift.good("calibrate", tmp_path / "s", "--json").json()["data"].get("accel") is None


@pytest.mark.slow
@needs_data
def test_recordings_in_motion_calibrate_both_triads_and_state_the_offset_of_each(undrift, tmp_path):
    files = []
    for number, (record, _) in enumerate(pairs("chain")):
        files.append(tmp_path / f"{number}.csv")
        write_record(record, files[-1])
    made = tmp_path / "by_motion.json"
    called = undrift("calibrate", *files, "--from", "motion", "-o", made, "--json")
    printed = called.json()
    assert (called.code, printed["verdict"]) == (0, "marginal")
    (tmp_path / "printed.json").write_text(json.dumps(printed["data"]))
    assert content_hash(read_calibration(tmp_path / "printed.json")) == content_hash(read_calibration(made))
    assert printed["data"]["gyro"]["method"] == printed["data"]["accel"]["method"] == "motion"
    rows = printed["tables"]["gyroscope_offset_of_each_recording"]
    assert [row["recording"] for row in rows] == ["0.csv", "1.csv"]
    for row in rows:
        offset = [row[f"{axis} (deg/s)"] for axis in "xyz"]
        show("offset of a recording, deg/s", np.round(offset, 3).tolist())
        np.testing.assert_allclose(offset, (-0.54, -0.20, -0.60), atol=3 * row["u (deg/s)"])
    assert read_calibration(made).gyro.matrix[0, 0] == pytest.approx(1.0, abs=0.01)
    words = undrift.good("calibrate", *files, "--from", "motion").out
    assert "Gyroscope offset of each recording" in words
    assert "hold the device with each of these axes up, then down" in words


@pytest.mark.slow
@needs_data
def test_a_magnetometer_is_calibrated_by_the_same_motion_and_gives_a_heading_from_north(undrift, tmp_path):
    for number in DEVICES["C"]:
        record, _ = trial(number)
        channels = {name: getattr(record, name)[::3] for name in ("time", "gyro", "accel", "mag_ut")}
        write_record(replace(record, **channels), tmp_path / f"{number}.csv")
    made, words = tmp_path / "c.json", ("calibrate", tmp_path / "03.csv", "--from", "motion")
    shown = undrift.good(*words, "--magnetometer", "-o", made, "--report", tmp_path / "c.html").out
    assert "axes of the gyroscopes, which it lags by 1" in shown
    mag = read_calibration(made).magnetometer
    np.testing.assert_allclose(mag.model.offset, (-0.31, 1.02, -1.59), atol=0.15)
    assert np.linalg.det(mag.model.matrix) == pytest.approx(1.0)
    assert "--magnetometer requires --from motion" in undrift.refused(
        "calibrate", tmp_path / "03.csv", "--magnetometer"
    )
    turned = ("orient", tmp_path / "24.csv", "--calibration", made, "-o", tmp_path / "o.csv", "--magnetometer")
    shown = undrift.good(*turned, "--method", "vqf", "--details").out
    assert "Heading is relative to magnetic east" in shown
    found = read_reference(tmp_path / "o.csv")
    apart = quaternion_product(found.q_nb[:2000], quaternion_conjugate(trial("24")[1].q_nb[: 3 * 2000 : 3]))
    assert np.degrees(np.nanmedian(np.abs(heading_of(apart)))) < 4.0  # east-north-up of the optics
    assert "the method vqf" in undrift.refused(*turned)
    undrift.good(*words, "-o", tmp_path / "plain.json")
    bare = [str(word).replace("c.json", "plain.json") for word in turned]
    assert "The magnetometer is not calibrated" in undrift.good(*bare, "--method", "vqf").out
    alone = ("orient", tmp_path / "24.csv", "-o", tmp_path / "raw.csv", "--magnetometer", "--method", "vqf")
    assert "The magnetometer is not calibrated" in undrift.good(*alone).out  # raw readings, as their file says


@needs_data
def test_options_that_motion_alone_cannot_use_are_refused(undrift, tmp_path):
    record, _ = pairs("chain")[0]
    write_record(record, tmp_path / "walk.csv")
    refused = undrift(
        "calibrate", tmp_path / "walk.csv", "--from", "motion", "--turn-deg", "360", "-o", tmp_path / "c.json"
    )
    assert refused.code == 2
    assert "cannot be used with" in refused.err
    assert "--turn-deg" in refused.err
    assert not (tmp_path / "c.json").exists()
    assert "--mode cannot be used" in undrift.refused(
        "calibrate", tmp_path / "walk.csv", "--from", "motion", "--mode", "paper"
    )
