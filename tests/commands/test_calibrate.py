"""undrift calibrate: real sessions written as session.toml, and the simulated bench."""

import json
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.in_motion import pairs

from testkit.command_line import row_of
from testkit.data import needs_data
from undrift.correction.answer import pitch_limits
from undrift.io.formats import write_record
from undrift.io.session import write_session
from undrift.io.store import read_calibration
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session


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
    assert read_calibration(tmp_path / "c.json").accel is None


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
