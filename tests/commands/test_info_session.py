"""undrift info --write-session and --write-map: what is written by them is used by the next command as it is."""

import numpy as np
import pytest

from testkit.command_line import contents, row_of
from testkit.data import data_path, show
from undrift.io.formats import write_record
from undrift.io.session import read_session
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session

LOG = ("multipos_mpu9150", "imu0.log.gz")


@pytest.fixture
def board(undrift, tmp_path):
    """map.toml of imu0, as info writes it."""
    words = ("--write-map", tmp_path / "map.toml", "--sample-rate-hz", 100, "--accel-unit", "m/s2")
    undrift.good("info", data_path(*LOG), *words)
    return tmp_path


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("--gyro-unit", "dps"), "--gyro-unit: this option requires --write-map"),
        (("--accel-unit", "g"), "--accel-unit: this option requires --write-map"),
        (("--turn-deg", 360), "--turn-deg requires --write-session"),
        (("--write-session", "s.toml", "--write-map", "m.toml"), "--write-session and --write-map cannot be combined"),
    ],
)
def test_an_option_that_would_do_nothing_is_refused(undrift, tmp_path, words, wanted):
    placed = [tmp_path / word if str(word).endswith((".toml", ".svg")) else word for word in words]
    assert wanted in undrift.refused("info", data_path(*LOG), "--sample-rate-hz", 100, *placed)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_session_that_was_written_calibrates_as_the_bare_recording_does(undrift, board):
    words = (data_path(*LOG), "--map", board / "map.toml")
    told = undrift.good("info", *words, "--write-session", board / "s", "--json").json()
    session = read_session(board / "s")
    assert row_of(told, "content", "still phases")["value"] == len(session.stills)
    assert row_of(told, "content", "faces")["value"] == "not all six, free poses"
    assert (session.gravity_m_s2, session.gravity_source) == (9.80665, "standard")
    assert "missing: standard gravity is assumed" in (board / "s" / "session.toml").read_text()
    one = undrift.good("calibrate", board / "s", "--json").data()
    assert one["provenance"]["settings"]["gravity"] == "standard"
    at = undrift.good("calibrate", board / "s", "--json", "--latitude-deg", 0, "--height-m", 0).data()
    assert (at["gravity_m_s2"], at["provenance"]["settings"]["gravity"]) == (
        pytest.approx(9.78033, abs=1e-5),
        "latitude and height",
    )
    other = undrift.good("calibrate", *words, "--json").data()
    for triad in ("accel", "gyro"):
        sigma = np.sqrt(np.diag(np.array(other[triad]["covariance"])))[:9].reshape(3, 3)
        apart = np.abs(np.array(one[triad]["matrix"]) - other[triad]["matrix"])
        assert (apart <= 2.0 * sigma + 1e-12).all()  # the fit without stated stills looks for them anew
    assert one["file_map"] == other["file_map"]


@pytest.mark.slow
def test_steady_turns_stand_as_comments_whose_rate_a_person_states(undrift, tmp_path):
    device = random_device(np.random.default_rng(7))
    made = simulate_session("rate_table", device, rng=np.random.default_rng(8), labelled=False)
    write_record(made.records[0], tmp_path / "table.parquet")
    told = undrift.good("info", tmp_path / "table.parquet", "--write-session", tmp_path / "s", "--json").json()
    steady = row_of(told, "content", "steady turns whose rate must be entered")["value"]
    text = (tmp_path / "s" / "session.toml").read_text()
    assert steady == text.count("# [[turn]]") == text.count("# turn_rate_dps = ?")
    show("steady turns", steady, "6 or more")
    assert steady >= 6
    assert read_session(tmp_path / "s").turns == ()


def test_a_session_is_not_overwritten_nor_made_of_one(undrift, bench, board):
    words = (data_path(*LOG), "--map", board / "map.toml")
    undrift.good("info", *words, "--write-session", board / "s")
    before = contents(board)
    line = undrift.refused("info", *words, "--write-session", board / "s")
    assert "the session already exists" in line
    line = undrift.refused("info", bench / "session", "--write-session", board / "t")
    assert "expected recordings without a session" in line
    assert contents(board) == before
