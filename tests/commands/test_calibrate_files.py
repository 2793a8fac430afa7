"""undrift calibrate FILE...: bare recordings, what was found in them, gravity and its source, and the map a calibration keeps."""

import json

import numpy as np
import pytest

from testkit.command_line import contents
from testkit.data import data_path, show
from undrift.errors import InputError
from undrift.io.formats import read_record
from undrift.io.session import session_from_files

BOARD = (
    'sample_rate_hz = 100\nheader = false\ndelimiter = " "\ncolumns = { accel = [0, 1, 2], gyro = [3, 4, 5] }\n'
    'units = { accel = "m/s2", gyro = "rad/s" }\n'
)
HEAD = '[session]\nkind = "calibration"\nserial = "{serial}"\ngravity_m_s2 = {gravity}\n'


@pytest.fixture
def board(undrift, tmp_path):
    """board.json of imu0, made from the bare log and a map."""
    (tmp_path / "board.toml").write_text(BOARD)
    log = data_path("multipos_mpu9150", "imu0.log.gz")
    undrift.good("calibrate", log, "--map", tmp_path / "board.toml", "-o", tmp_path / "board.json")
    return tmp_path


def same(one, other):
    for triad in ("gyro", "accel"):
        np.testing.assert_array_equal(one[triad]["matrix"], other[triad]["matrix"])
        np.testing.assert_array_equal(one[triad]["offset"], other[triad]["offset"])
        assert one[triad]["method"] == other[triad]["method"]


@pytest.mark.slow
def test_a_bare_log_gives_the_numbers_of_its_session_and_says_what_it_used(undrift, board):
    log = data_path("multipos_mpu9150", "imu0.log.gz")
    folder = board / "session"
    folder.mkdir()
    entry = f'[[recording]]\nfile = "{log}"\n{BOARD}'
    (folder / "session.toml").write_text(HEAD.format(serial="imu0", gravity=9.80665) + entry)
    stated = undrift.good("calibrate", folder, "--json").json()["data"]
    told = undrift.good("calibrate", log, "--map", board / "board.toml", "--serial", "imu0", "--json").json()["data"]
    same(stated, told)
    assert (told["device"], told["gravity_m_s2"]) == ("imu0", 9.80665)
    used = told["provenance"]["settings"]
    assert used["gravity"] == "standard"
    assert used["turns"] == "none"
    show("still phases", used["stills"], "17-18 or more (SOURCE.md)")
    assert int(used["stills"].removesuffix(" found")) >= 17
    assert stated["provenance"]["settings"]["gravity"] == "stated"
    text = undrift.good("calibrate", log, "--map", board / "board.toml").out
    assert "Gravity 9.80665 m/s2 (standard gravity, assumed)" in text
    assert f"Still phases: {used['stills']}. Faces: {used['faces']}. Turns: none." in text
    assert "gravity was assumed" in text


@pytest.mark.slow
def test_a_calibration_keeps_the_map_and_the_next_commands_need_none(undrift, board):
    held = json.loads((board / "board.json").read_text())
    assert held["file_map"]["columns"] == {"gyro": [3, 4, 5], "accel": [0, 1, 2]}
    log, c = data_path("multipos_mpu9150", "imu1.log.gz"), ("--calibration", board / "board.json")
    undrift.good("correct", log, *c, "-o", board / "one.parquet")
    undrift.good("correct", log, *c, "--map", board / "board.toml", "-o", board / "two.parquet")
    undrift.good("correct", log, *c, "-o", board / "three.csv")
    one, two, three = (read_record(board / f"{name}") for name in ("one.parquet", "two.parquet", "three.csv"))
    np.testing.assert_array_equal(one.gyro, two.gyro)
    np.testing.assert_array_equal(one.gyro, three.gyro)
    undrift.good("orient", log, *c, "-o", board / "o.csv")
    assert undrift.good("noise", log, *c, "--rest-s", "0:5", "--json").data()["gyro"]


@pytest.mark.parametrize("command", ["correct", "orient", "noise", "validate"])
def test_a_file_that_does_not_fit_the_kept_map_is_refused_in_one_line_that_names_both(undrift, board, command):
    other = data_path("ferraris_nilspod", "example_ferraris_session.csv")
    words = {
        "correct": ("-o", board / "x.parquet"),
        "orient": ("-o", board / "x.csv"),
        "noise": (),
        "validate": ("--reference", other),
    }
    before = contents(board)
    line = undrift.refused(command, other, "--calibration", board / "board.json", *words[command])
    assert f"{other}: the file does not match the map stored in {board / 'board.json'} for its device: " in line
    assert line.count("Give another map with --map") == 1
    assert contents(board) == before


def test_a_session_states_what_the_options_would_and_stands_alone(undrift, bench, board):
    session, log = bench / "session", data_path("multipos_mpu9150", "imu0.log.gz")
    line = undrift.refused("calibrate", session, "--serial", "A1", "--sensor", "a")
    assert "--sensor, --serial cannot be used with a session" in line
    line = undrift.refused("calibrate", session, "--latitude-deg", 59.9, "--height-m", 20)
    assert "--height-m cannot be used with a session" in line
    line = undrift.refused("calibrate", session, log)
    assert "expected one session, or recordings, got a session and 1 more" in line
    line = undrift.refused("calibrate", board)
    assert "expected a folder with session.toml, got none" in line
    line = undrift.refused("calibrate", data_path("ferraris_nilspod", "example_ferraris_session.csv"))
    assert "undrift info FILE --write-map map.toml to propose a map, and name the map with --map" in line
    with pytest.raises(InputError, match="expected one recording or more, got 0"):
        session_from_files([])
