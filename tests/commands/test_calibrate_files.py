"""undrift calibrate FILE...: bare recordings, what was found in them, gravity and its source, and the map a calibration keeps."""

import json
import re

import numpy as np
import pytest

from testkit.command_line import contents
from testkit.data import data_path, show
from undrift.calibration.calibrate import calibrate
from undrift.calibration.observe import CalibrateSettings
from undrift.errors import InputError
from undrift.io.formats import read_record, write_record
from undrift.io.session import read_file_map, read_map, read_session, session_from_files, write_session
from undrift.io.store import calibration_json, read_calibration
from undrift.model import Calibration
from undrift.record import Record
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session
from undrift.units import gravity_at

BOARD = (
    'sample_rate_hz = 100\nheader = false\ndelimiter = " "\ncolumns = { accel = [0, 1, 2], gyro = [3, 4, 5] }\n'
    'units = { accel = "m/s2", gyro = "rad/s" }\n'
)
FERRARIS = (
    'sample_rate_hz = 102.4\ncolumns = { gyro = ["gyr_x", "gyr_y", "gyr_z"], accel = ["acc_x", "acc_y", "acc_z"] }\n'
    'units = { gyro = "dps", accel = "m/s2" }\n'
)
BICYCLE = (
    'columns = { time = "t_s", gyro = "gyro_rad_s", accel = "acc_raw", temp = "temp_degC" }\n'
    'units = { time = "s", gyro = "rad/s", accel = "count", temp = "degC" }\n'
)
XSENS = (
    'header = false\ndelimiter = " "\ncolumns = [{ time = 0, accel = [1, 2, 3] }, { time = 0, gyro = [1, 2, 3] }]\n'
    'units = { time = "s", accel = "count", gyro = "count" }\n'
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
    """Two calibrations with the same numbers."""
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
    stated = undrift.good("calibrate", folder, "--json").json()
    told = undrift.good("calibrate", log, "--map", board / "board.toml", "--serial", "imu0", "--json").json()
    same(stated, told)
    assert (told["device"], told["gravity_m_s2"]) == ("imu0", 9.80665)
    used = told["provenance"]["settings"]
    assert used["gravity"] == "standard"
    assert used["turns"] == "none"
    show("still phases", used["stills"], "17-18 or more (SOURCE.md)")
    assert int(used["stills"].removesuffix(" found")) >= 17
    assert stated["provenance"]["settings"]["gravity"] == "stated"
    text = undrift.good("calibrate", log, "--map", board / "board.toml").out
    assert "gravity 9.80665 m/s2 (standard, assumed)" in text
    assert f"still phases: {used['stills']}; faces: {used['faces']}; turns: none" in text
    assert "Local gravity assumed" in text


@pytest.mark.slow
def test_gravity_is_stated_or_by_latitude_and_height_and_never_by_half(undrift, board):
    log, words = data_path("multipos_mpu9150", "imu0.log.gz"), ("--map", board / "board.toml", "--json")
    told = undrift.good("calibrate", log, *words, "--gravity-m-s2", 9.81).json()
    assert (told["gravity_m_s2"], told["provenance"]["settings"]["gravity"]) == (9.81, "stated")
    assert not any("Local gravity assumed" in reason for reason in told["verdict"]["reasons"])
    told = undrift.good("calibrate", log, *words, "--latitude-deg", 59.9, "--height-m", 20).json()
    assert told["gravity_m_s2"] == gravity_at(59.9, 20.0)
    assert told["provenance"]["settings"]["gravity"] == "latitude and height"
    session = board / "session-without-gravity"
    session.mkdir()
    (session / "session.toml").write_text(
        f'[session]\nkind = "calibration"\nserial = ""\n[[recording]]\nfile = "{log}"\n{BOARD}'
    )
    read = undrift.good("calibrate", session, "--json").json()
    assert (read["gravity_m_s2"], read["provenance"]["settings"]["gravity"]) == (9.80665, "standard")
    read = undrift.good("calibrate", session, "--latitude-deg", 59.9, "--height-m", 20, "--json").json()
    same(read, told)
    assert read["provenance"]["settings"]["gravity"] == "latitude and height"
    before = contents(board)
    line = undrift.refused("calibrate", log, *words[:2], "--height-m", 20, "-o", board / "no.json")
    assert "wanted gravity_m_s2, or latitude_deg and height_m, got only one of the last two" in line
    assert contents(board) == before


@pytest.mark.slow
def test_several_still_recordings_are_one_session_without_a_toml_of_it(undrift, tmp_path):
    (tmp_path / "bicycle.toml").write_text(BICYCLE)
    files = sorted(data_path("multipos_mpu6050_bicycle").glob("*.npz"))
    told = undrift.good("calibrate", *files, "--map", tmp_path / "bicycle.toml", "--json").json()
    np.testing.assert_allclose(
        np.array(told["accel"]["offset"]) / 16.384, [58.0, -6.0, -123.0], atol=2.0
    )  # SOURCE.md, mg
    assert len(told["provenance"]["inputs"]) == 11


@pytest.mark.slow
def test_files_side_by_side_are_as_many_as_the_map_has_tables(undrift, tmp_path):
    (tmp_path / "xsens.toml").write_text(XSENS)
    files = [data_path("multipos_xsens", f"xsens_{name}.txt.gz") for name in ("acc", "gyro")]
    answer = undrift.good(
        "calibrate", *files, "--map", tmp_path / "xsens.toml", "--gravity-m-s2", "9.81", "-o", tmp_path / "x.json"
    )
    assert "verdict: good" in answer.out
    model = read_calibration(tmp_path / "x.json").accel
    np.testing.assert_allclose(model.scale_factor * 9.80665, [3983.0, 4045.0, 4028.0], rtol=0.03)  # SOURCE.md
    line = undrift.refused("calibrate", files[0], "--map", tmp_path / "xsens.toml")
    assert "wanted 2 files for each recording, as the map has tables, got 1; name them" in line
    line = undrift.refused("correct", files[0], "--calibration", tmp_path / "x.json", "-o", tmp_path / "c.csv")
    assert "wanted 2 files side by side, got one; give a map of it" in line


@pytest.mark.slow
def test_turns_of_a_stated_angle_are_found_in_a_session_by_hand(undrift, tmp_path):
    (tmp_path / "ferraris.toml").write_text(FERRARIS)
    path = data_path("ferraris_nilspod", "example_ferraris_session.csv")
    answer = undrift.good(
        "calibrate", path, "--map", tmp_path / "ferraris.toml", "--turn-deg", 360, "-o", tmp_path / "f.json"
    )
    assert "faces: +x, -x, +y, -y, +z, -z; turns: 3 found" in answer.out
    made = read_calibration(tmp_path / "f.json")
    assert made.gyro.method.startswith("known-rotation")
    assert made.accel.method.startswith("six-face")
    scale = np.diag(made.gyro.forward_matrix) * np.pi / 180.0
    show("gyro scale", np.round(scale, 4), "1.028, 0.983, 0.998 (SOURCE.md)")
    np.testing.assert_allclose(scale, [1.028, 0.983, 0.998], atol=6e-3)  # integrals by hand-set ranges there
    found = next(item for item in made.verdict.findings if item.code == "session.turns_found")
    assert found.values["turns"] == ("x -", "y -", "z -")


@pytest.mark.slow
@pytest.mark.parametrize("counts", [False, True])
def test_simulated_turns_are_found_in_physical_units_and_in_counts(tmp_path, counts):
    device = random_device(np.random.default_rng(7))
    session = simulate_session("ferraris", device, rng=np.random.default_rng(8), labelled=False)
    record = session.records[0]  # in counts
    stated = calibrate(simulate_session("ferraris", device, rng=np.random.default_rng(8)))
    per_rad_s, per_m_s2 = (np.diag(triad.forward_matrix).mean() for triad in (stated.gyro, stated.accel))
    if not counts:
        record = Record(time=record.time, gyro=record.gyro / per_rad_s, accel=record.accel / per_m_s2)
    write_record(record, tmp_path / "turns.csv")
    made = calibrate(session_from_files([tmp_path / "turns.csv"]), settings=CalibrateSettings(turn_angle_deg=360.0))
    assert made.gyro.method.startswith("known-rotation")
    assert dict(made.provenance.settings)["turns"] == "3 found"
    scale = stated.gyro.forward_matrix / (1.0 if counts else per_rad_s)
    np.testing.assert_allclose(
        made.gyro.forward_matrix, scale, atol=1e-3 * np.abs(scale).max()
    )  # other ends of each turn


@pytest.mark.slow
def test_turns_that_are_not_there_are_a_finding_and_a_wrong_angle_is_refused(undrift, board):
    log, words = data_path("multipos_mpu9150", "imu0.log.gz"), ("--map", board / "board.toml")
    told = undrift.good("calibrate", log, *words, "--turn-deg", 720, "--json").json()
    missing = next(item for item in told["verdict"]["findings"] if item["code"] == "session.turns_missing")
    assert missing["values"]["axes"] == ["x", "y", "z"]
    assert "0 of 720 deg found between rests, none about x, y, z" in missing["text"]
    assert told["gyro"]["method"] == "multi-position"
    assert "wanted turn_angle_deg above 0, got -360" in undrift.refused("calibrate", log, *words, "--turn-deg", -360)


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
    assert undrift.good("noise", log, *c, "--stop-s", 5, "--json").json()["gyro"]


@pytest.mark.slow
def test_a_session_keeps_its_map_too_and_a_drift_its_devices(board):
    made = read_calibration(board / "board.json")
    folder = board / "session"
    folder.mkdir()
    log = data_path("multipos_mpu9150", "imu0.log.gz")
    (folder / "session.toml").write_text(
        HEAD.format(serial="", gravity=9.81) + f'[[recording]]\nfile = "{log}"\n{BOARD}'
    )
    assert read_session(folder).file_map == made.file_map == read_file_map(board / "board.toml")
    write_session(read_session(folder), board / "own")
    assert read_session(board / "own").file_map is None  # undrift's own names need none


@pytest.mark.slow
def test_an_own_map_and_undrifts_own_names_overrule_the_map_that_is_kept(undrift, board):
    c = ("--calibration", board / "board.json")
    log = data_path("multipos_mpu9150", "imu1.log.gz")
    (board / "half.toml").write_text(BOARD.replace("= 100", "= 50"))
    told = undrift.good("correct", log, *c, "--map", board / "half.toml", "-o", board / "half.parquet")
    assert told.err == ""
    assert read_record(board / "half.parquet").sample_rate_hz == pytest.approx(50.0)
    undrift.good("correct", log, *c, "--sample-rate-hz", 200, "-o", board / "fast.parquet")
    assert read_record(board / "fast.parquet").sample_rate_hz == pytest.approx(200.0)
    write_record(read_session_record(board, log), board / "native.csv")
    undrift.good("correct", board / "native.csv", *c, "-o", board / "n.parquet")
    np.testing.assert_array_equal(
        read_record(board / "n.parquet").gyro[:100],
        undrift_corrected(undrift, board, log, c)[:100],
    )


def read_session_record(folder, log):
    return session_from_files([log], read_file_map(folder / "board.toml")).records[0]


def undrift_corrected(undrift, folder, log, c):
    undrift.good("correct", log, *c, "-o", folder / "again.parquet")
    return read_record(folder / "again.parquet").gyro


@pytest.mark.parametrize("command", ["correct", "orient", "noise", "validate"])
def test_a_file_that_does_not_fit_the_kept_map_is_refused_in_one_line_that_names_both(undrift, board, command):
    other = data_path("ferraris_nilspod", "example_ferraris_session.csv")
    words = {
        "correct": ("-o", board / "x.csv"),
        "orient": ("-o", board / "x.csv"),
        "noise": (),
        "validate": ("--reference", other),
    }
    before = contents(board)
    line = undrift.refused(command, other, "--calibration", board / "board.json", *words[command])
    assert f"{other}: does not fit the map that {board / 'board.json'} keeps of its device: " in line
    assert "name its own with --map" in line
    assert contents(board) == before


def test_a_session_states_what_the_options_would_and_stands_alone(undrift, bench, board):
    session, log = bench / "session", data_path("multipos_mpu9150", "imu0.log.gz")
    line = undrift.refused("calibrate", session, "--serial", "A1", "--gaps", "keep")
    assert "wanted none of --gaps, --serial beside a session, got 2; its session.toml states them" in line
    line = undrift.refused("calibrate", session, "--latitude-deg", 59.9, "--height-m", 20)
    assert "wanted none of --height-m beside a session" in line
    line = undrift.refused("calibrate", session, log)
    assert "wanted one session, or recordings, got a session and 1 more" in line
    line = undrift.refused("calibrate", board)
    assert "wanted a folder with session.toml, got none" in line
    line = undrift.refused("calibrate", data_path("ferraris_nilspod", "example_ferraris_session.csv"))
    assert "undrift info FILE proposes a map of them, --write-map map.toml writes it; give it with --map" in line
    with pytest.raises(InputError, match="wanted one recording or more, got 0; name them"):
        session_from_files([])


@pytest.mark.slow
def test_what_json_says_is_a_calibration_too(undrift, board):
    log = data_path("multipos_mpu9150", "imu0.log.gz")
    answer = undrift.good("calibrate", log, "--map", board / "board.toml", "--json")
    (board / "said.json").write_text(answer.out)
    one, other = read_calibration(board / "said.json"), read_calibration(board / "board.json")
    np.testing.assert_array_equal(one.gyro.matrix, other.gyro.matrix)
    assert one.file_map == other.file_map


def test_python_takes_what_the_command_line_takes_and_sees_the_same(undrift, board):
    log, words = data_path("multipos_mpu9150", "imu0.log.gz"), {"column_map": board / "board.toml", "serial": "imu0"}
    told = undrift.good("calibrate", log, "--map", board / "board.toml", "--serial", "imu0", "--json").json()
    made = calibrate(str(log), **words)
    record = read_record(log, read_map(board / "board.toml")[0])
    frame = record.to_frame()
    for one in (made, calibrate(record, serial="imu0"), calibrate(frame, serial="imu0")):
        assert isinstance(one, Calibration)
        same(told, calibration_json(one))
        assert one.device == "imu0"
        assert [item.code for item in one.verdict.findings] == [item["code"] for item in told["verdict"]["findings"]]
    assert dict(calibrate(record, gravity_m_s2=9.81).provenance.settings)["gravity"] == "stated"
    with pytest.raises(InputError, match="wanted none of units beside a Record"):
        calibrate(record, units={"gyro": "rad/s"})
    with pytest.raises(InputError, match="got a mixture"):
        calibrate(record, log)
    with pytest.raises(InputError, match="wanted a table of pandas, polars or Arrow, got int"):
        calibrate(7)
    with pytest.raises(InputError, match="wanted gravity_m_s2, or latitude_deg and height_m, got only one"):
        calibrate(record, height_m=20.0)


@pytest.mark.slow
def test_python_takes_a_sessions_folder_with_the_checks_of_the_command(undrift, bench):
    told = undrift.good("calibrate", bench / "session", "--json").json()
    made = calibrate(bench / "session")
    same(told, calibration_json(made))
    turned = undrift.good("calibrate", bench / "session", "--latitude-deg", "45", "--json").json()
    same(turned, calibration_json(calibrate(str(bench / "session"), latitude_deg=45.0)))
    with pytest.raises(InputError, match="wanted none of --serial beside a session"):
        calibrate(bench / "session", serial="A1")
    shown = undrift.good("calibrate", bench / "session").out
    assert all(cell in shown for cell in re.findall(r"<td>(.*?)</td>", made._repr_html_()))
    assert len(repr(made).splitlines()) == 5
