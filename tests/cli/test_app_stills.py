"""Rests on the command line: found in a hand, by another window or threshold, and drawn."""

import numpy as np
import pytest

from testkit.data import data_path
from testkit.hand_held import Tremor, hand_held_log
from undrift.io.formats import write_record

STRONG = Tremor(rate_dps=3.0, sway_deg=1.0, accel=0.25)
BROAD = ("broad", "02_undisturbed_slow_rotation_B.hdf5")


@pytest.fixture
def session(tmp_path):
    """A folder with one hand-held recording."""
    record, _ = hand_held_log(np.random.default_rng(2), STRONG, poses=12)
    folder = tmp_path / "hand"
    folder.mkdir()
    write_record(record, folder / "log.parquet")
    head = '[session]\nkind = "calibration"\nserial = "S1"\ngravity_m_s2 = 9.81\n[[recording]]\nfile = "log.parquet"\n'
    (folder / "session.toml").write_text(head)
    return folder


@pytest.mark.slow
def test_info_finds_the_poses_of_a_hand_and_draws_them(undrift, session, tmp_path):
    picture = tmp_path / "log.svg"
    told = undrift.good("info", session / "log.parquet", "--figure", picture, "--json").json()
    assert 11 <= len(told["stills"]) <= 14
    text = picture.read_text()
    assert f"{len(told['stills'])} stills found" in text
    assert "log: found" in text
    assert f"Wrote {picture}" in undrift.good("info", session / "log.parquet", "--figure", picture).out


@pytest.mark.slow
def test_a_window_and_a_threshold_that_are_given_are_used(undrift, session):
    log = session / "log.parquet"
    fixed = undrift.good("info", log, "--still-window-s", 1.0, "--json").json()
    assert len(fixed["stills"]) <= 2
    wide = undrift.good("info", log, "--still-window-s", 1.0, "--still-threshold", 8, "--json").json()
    assert len(wide["stills"]) >= 9
    narrow = undrift.good("info", log, "--still-threshold", 0.5, "--json").json()
    assert narrow["stills"] == []
    assert narrow["no_still_because"].startswith("no still phase: ")
    wrong = undrift("info", log, "--still-window-s", 0)
    assert (wrong.code, wrong.out) == (2, "")
    assert "stills: wanted window, smoothing, shortest duration and thresholds above 0" in wrong.err


@pytest.mark.slow
def test_calibrate_takes_the_poses_of_a_hand_and_draws_what_it_used(undrift, session, tmp_path):
    output, picture = tmp_path / "c.json", tmp_path / "used.png"
    done = undrift.good("calibrate", session, "-o", output, "--figure", picture)
    assert f"Wrote {picture}" in done.out
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert undrift.good("calibrate", session, "--json").json()["accel"]["method"].startswith("multi-position")
    by_window = undrift("calibrate", session, "--still-window-s", 1.0)
    assert by_window.code == 2
    assert "too restless: a device at rest varies less than 0.0122 rad/s" in by_window.err
    told = undrift.good("calibrate", session, "--still-threshold", 8, "--json").json()
    assert abs(told["accel"]["matrix"][0][0] - 1.0) < 2e-3


@pytest.mark.slow
def test_a_recording_with_motion_capture_is_drawn(undrift, tmp_path):
    picture = tmp_path / "trial.svg"
    undrift.good("info", data_path(*BROAD), "--figure", picture)
    text = picture.read_text()
    for label in ("2 stills found", "1 turn found", "+z", "gyro (rad/s)"):
        assert label in text


def test_what_cannot_be_drawn_is_refused_before_anything_is_written(undrift, session, tmp_path):
    for words, message in (
        (
            ("info", tmp_path, "--figure", tmp_path / "a.svg"),
            "--figure: wanted a recording or a session, got the folder",
        ),
        (
            ("info", session / "session.toml", "--figure", tmp_path / "a.txt"),
            "wanted a name ending in .svg, .png or .pdf",
        ),
        (("calibrate", session, "--figure", tmp_path / "a.txt"), "wanted a name ending in .svg, .png or .pdf"),
    ):
        answer = undrift(*words)
        assert (answer.code, answer.out) == (2, "")
        assert message in answer.err
    c = tmp_path / "c.json"
    undrift.good("calibrate", session, "-o", c)
    answer = undrift("info", c, "--figure", tmp_path / "a.svg")
    assert "--figure: wanted a recording or a session, got calibration" in answer.err
    assert not (tmp_path / "a.svg").exists()
