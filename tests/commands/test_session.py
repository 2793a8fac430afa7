"""undrift session new and undrift info --write-map: what is written by them is used by the next command as it is."""

import tomllib

import numpy as np
import pytest

from testkit.command_line import contents
from testkit.data import data_path, show
from testkit.rate_table_log import GAIN, bench
from undrift.io.formats import write_record
from undrift.io.proposal import gyro_unit_of
from undrift.io.session import read_session
from undrift.record import Record
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session

LOG = ("multipos_mpu9150", "imu0.log.gz")


@pytest.fixture
def board(undrift, tmp_path):
    """map.toml of imu0, as info writes it."""
    words = ("--write-map", tmp_path / "map.toml", "--sample-rate-hz", 100, "--accel-unit", "m/s2")
    undrift.good("info", data_path(*LOG), *words)
    return tmp_path


@pytest.mark.slow
def test_the_map_of_a_log_without_names_takes_the_gyroscopes_unit_from_gravity(board):
    text = (board / "map.toml").read_text()
    held = tomllib.loads(text)
    assert held["units"] == {"accel": "m/s2", "gyro": "rad/s"}  # SOURCE.md
    assert held["sample_rate_hz"] == 100
    assert "# accel: m/s2, as given" in text
    assert "# gyro: rad/s, proposed: it turns gravity as the accelerometers read it, to " in text
    assert "dps misses it by " in text


def test_deg_per_s_is_told_from_rad_per_s_and_nothing_from_a_device_that_only_rests(undrift, tmp_path):
    words = ("--write-map", tmp_path / "f.toml", "--sample-rate-hz", 102.4, "--accel-unit", "m/s2")
    undrift.good("info", data_path("ferraris_nilspod", "example_ferraris_session.csv"), *words)
    assert tomllib.loads((tmp_path / "f.toml").read_text())["units"]["gyro"] == "dps"  # SOURCE.md
    rng = np.random.default_rng(3)
    rest = Record(
        time=np.arange(2000) / 100.0, gyro=rng.normal(0, 0.1, (2000, 3)), accel=rng.normal([0, 0, 9.8], 0.1, (2000, 3))
    )
    assert gyro_unit_of(rest) is None


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "rad/s"), (180.0 / np.pi, "dps"), (16.4 * 180.0 / np.pi, None)])
def test_a_simulated_device_shows_its_unit_unless_it_reads_counts(factor, unit):
    session = simulate_session("multi_position", random_device(np.random.default_rng(1)), rng=np.random.default_rng(2))
    record = session.records[0]
    per_rad_s = 180.0 / np.pi * 16.4  # of this device, within its tolerance
    found = gyro_unit_of(Record(time=record.time, gyro=record.gyro * (factor / per_rad_s), accel=record.accel / 1000.0))
    show("unit found", found, unit)
    assert (None if found is None else found[0]) == unit


@pytest.mark.slow
def test_a_map_that_is_not_complete_says_what_to_put_and_a_file_that_needs_none_is_refused(undrift, bench, tmp_path):
    out = undrift.good("info", data_path("multipos_xsens", "xsens_gyro.txt.gz"), "--write-map", tmp_path / "m.toml").out
    assert "# time: s, proposed by the median step 0.01" in out  # SOURCE.md: 100 Hz
    (tmp_path / "no.csv").write_text(
        "t,gx,gy,gz\n" + "".join(f"{k / 100},{k % 3},{k % 5},{k % 7}\n" for k in range(300))
    )
    answer = undrift.good("info", tmp_path / "no.csv", "--write-map", tmp_path / "no.toml")
    assert f"put what is true where {tmp_path / 'no.toml'} has ?" in answer.out
    assert "Next:" not in answer.out
    before = contents(tmp_path)
    line = undrift.refused("info", data_path(*LOG), "--write-map", tmp_path / "rate.toml")
    assert "wanted the sample rate of a table without time, got none; add --sample-rate-hz" in line
    line = undrift.refused("info", bench / "trial.parquet", "--write-map", tmp_path / "t.toml")
    assert "wanted a table that needs a map, got recording (parquet)" in line
    assert "wanted a name ending in .toml" in undrift.refused(
        "info", data_path(*LOG), "--write-map", tmp_path / "m.json"
    )
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("--gyro-unit", "dps"), "--gyro-unit: wanted --write-map beside it, got none"),
        (("--accel-unit", "g"), "--accel-unit: wanted --write-map beside it, got none"),
        (("--gyro-gain", 0.061), "--gyro-gain: wanted --write-map beside it, got none"),
        (("--accel-gain", 0.061), "--accel-gain: wanted --write-map beside it, got none"),
        (("--write-map", "m.toml", "--figure", "f.svg"), "--figure: wanted it without --write-map, got both"),
    ],
)
def test_an_option_that_would_do_nothing_is_refused(undrift, tmp_path, words, wanted):
    placed = [tmp_path / word if str(word).endswith((".toml", ".svg")) else word for word in words]
    assert wanted in undrift.refused("info", data_path(*LOG), "--sample-rate-hz", 100, *placed)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_session_that_was_written_calibrates_as_the_bare_recording_does(undrift, board):
    words = (data_path(*LOG), "--map", board / "map.toml", "--serial", "imu0")
    told = undrift.good("session", "new", *words, "-o", board / "s", "--json").json()
    session = read_session(board / "s")
    assert (told["stills"], told["faces"], told["turns"]) == (len(session.stills), [], 0)
    assert (session.serial, session.gravity_m_s2, session.gravity_source) == ("imu0", 9.80665, "standard")
    assert "not stated: standard gravity is assumed" in (board / "s" / "session.toml").read_text()
    one = undrift.good("calibrate", board / "s", "--json").json()
    assert one["provenance"]["settings"]["gravity"] == "standard"
    at = undrift.good("calibrate", board / "s", "--json", "--latitude-deg", 0, "--height-m", 0).json()
    assert (at["gravity_m_s2"], at["provenance"]["settings"]["gravity"]) == (
        pytest.approx(9.78033, abs=1e-5),
        "latitude and height",
    )
    other = undrift.good("calibrate", *words, "--json").json()
    for triad in ("accel", "gyro"):
        sigma = np.sqrt(np.diag(np.array(other[triad]["covariance"])))[:9].reshape(3, 3)
        apart = np.abs(np.array(one[triad]["matrix"]) - other[triad]["matrix"])
        assert (apart <= 2.0 * sigma + 1e-12).all()  # the fit without stated stills looks for them anew
    assert one["file_map"] == other["file_map"]


@pytest.mark.slow
def test_faces_and_turns_are_stated_where_the_fit_uses_them(undrift, tmp_path):
    undrift.good(
        *("info", data_path("ferraris_nilspod", "example_ferraris_session.csv"), "--write-map", tmp_path / "f.toml"),
        *("--sample-rate-hz", 102.4, "--accel-unit", "m/s2"),
    )
    path = data_path("ferraris_nilspod", "example_ferraris_session.csv")
    words = (path, "--map", tmp_path / "f.toml", "--turn-deg", 360)
    undrift.good("session", "new", *words, "-o", tmp_path / "s", "--gravity-m-s2", 9.81)
    session = read_session(tmp_path / "s")
    assert {still.face for still in session.stills} >= {"+x", "-x", "+y", "-y", "+z", "-z"}
    assert [(turn.axis, round(np.degrees(turn.angle))) for turn in session.turns] == [
        ("x", -360),
        ("y", -360),
        ("z", -360),
    ]
    one = undrift.good("calibrate", tmp_path / "s", "--json").json()
    other = undrift.good("calibrate", *words, "--gravity-m-s2", 9.81, "--json").json()
    for triad in ("accel", "gyro"):
        np.testing.assert_allclose(one[triad]["matrix"], other[triad]["matrix"], rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_steady_turns_stand_as_comments_whose_rate_a_person_states(undrift, tmp_path):
    device = random_device(np.random.default_rng(7))
    made = simulate_session("rate_table", device, rng=np.random.default_rng(8), labelled=False)
    write_record(made.records[0], tmp_path / "table.parquet")
    told = undrift.good("session", "new", tmp_path / "table.parquet", "-o", tmp_path / "s", "--json").json()
    text = (tmp_path / "s" / "session.toml").read_text()
    assert told["steady_turns"] == text.count("# [[turn]]") == text.count("# turn_rate_dps = ?")
    show("steady turns", told["steady_turns"], "6 or more")
    assert told["steady_turns"] >= 6
    assert read_session(tmp_path / "s").turns == ()


def test_a_session_is_not_overwritten_nor_made_of_one(undrift, bench, board):
    words = (data_path(*LOG), "--map", board / "map.toml")
    undrift.good("session", "new", *words, "-o", board / "s")
    before = contents(board)
    assert "wanted a new session, got one that exists" in undrift.refused("session", "new", *words, "-o", board / "s")
    line = undrift.refused("session", "new", bench / "session", "-o", board / "t")
    assert "wanted bare recordings, got a session; edit its session.toml" in line
    assert contents(board) == before


@pytest.mark.slow
def test_torn_rows_are_left_out_by_an_option_and_the_map_keeps_it(undrift, tmp_path):
    log = data_path("thermal_bmi270_two_point", "BMI_270_hot_test.csv.gz")
    units = ("--gyro-unit", "count", "--accel-unit", "count", "--sample-rate-hz", 50)
    undrift.good("info", log, "--drop-bad-rows", "--write-map", tmp_path / "m.toml", *units)
    assert tomllib.loads((tmp_path / "m.toml").read_text())["drop_bad_rows"] is True
    rows = [
        undrift.good("info", log, "--map", tmp_path / "m.toml", *more, "--json").json()["rows"]
        for more in ((), ("--drop-bad-rows",))
    ]
    assert rows[0] == rows[1] > 3000
    undrift.good("info", log, "--write-map", tmp_path / "n.toml", *units)
    assert "drop_bad_rows" not in tomllib.loads((tmp_path / "n.toml").read_text())
    assert "wanted 7 columns in every row" in undrift.refused("info", log, "--map", tmp_path / "n.toml")
    assert (
        undrift.good("info", log, "--map", tmp_path / "n.toml", "--drop-bad-rows", "--json").json()["rows"] == rows[0]
    )


@pytest.mark.slow
def test_gains_of_a_data_sheet_make_units_of_counts_and_a_thermal_log_its_tables(undrift, tmp_path):
    log = data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz")
    gain = ("--gyro-gain", 0.06097560976)  # deg/s per count: SOURCE.md
    words = ("info", log, "--write-map", tmp_path / "m.toml", "--accel-unit", "g", "--accel-gain", 1 / 16384)
    line = undrift.refused(*words, *gain)
    assert "--gyro-gain: wanted the unit that it leads to, got none; add --gyro-unit" in line
    undrift.good(*words, *gain, "--gyro-unit", "dps")
    held = tomllib.loads((tmp_path / "m.toml").read_text())
    assert held["scale"] == {"gyro": {"gain": 0.06097560976}, "accel": {"gain": 1 / 16384}}
    assert (held["units"]["gyro"], held["units"]["accel"]) == ("dps", "g")
    assert undrift("drift", log, "--map", tmp_path / "m.toml", "-o", tmp_path / "d.json").code != 2
    assert undrift("correct", log, "--calibration", tmp_path / "d.json", "-o", tmp_path / "c.csv").code == 0


@pytest.mark.slow
def test_the_log_of_a_table_becomes_the_turns_that_calibrate_takes(undrift, tmp_path):
    record, dwells, path = bench(tmp_path, drift=1e-5)
    write_record(record, tmp_path / "table.parquet")
    words = ("session", "new", tmp_path / "table.parquet", "--rates", path)
    told = undrift.good(*words, "-o", tmp_path / "s", "--json").json()["rates"]
    (clock,) = told["clocks"]
    assert (told["dwells"], told["left_out"]) == (len(dwells), 0)
    assert abs(clock["drift"] - 1e-5) < 4.0 * clock["drift_uncertainty"]
    text = (tmp_path / "s" / "session.toml").read_text()
    assert text.count("# by the table's log; standard uncertainty ") == text.count("[[turn]]") == len(dwells)
    session = read_session(tmp_path / "s")
    assert [turn.axis for turn in session.turns] == [up[1] for *_, up, _ in dwells]
    made = undrift("calibrate", tmp_path / "s", "--json").json()
    assert made["gyro"]["method"].startswith("rate-table")
    forward = np.linalg.inv(np.array(made["gyro"]["matrix"])) * np.pi / 180.0
    show("gyroscope matrix off the true one", f"{np.abs(forward - GAIN).max():.2e}", "5e-4")
    np.testing.assert_allclose(forward, GAIN, atol=5e-4)  # 0.01 deg over 4 s and 0.05 deg/s of noise, at 10 to 75 deg/s
    said = undrift.good(*words, "-o", tmp_path / "t").out
    assert f"dwells from the log: {len(dwells)}, left out 0" in said
    assert "recording - log: 1234.5" in said


def test_the_options_of_a_log_are_refused_where_they_do_nothing(undrift, tmp_path):
    record, _, path = bench(tmp_path)
    write_record(record, tmp_path / "table.parquet")
    words = ("session", "new", tmp_path / "table.parquet", "-o", tmp_path / "s")
    assert "--rates-offset-s: wanted one recording and --rates" in undrift.refused(*words, "--rates-offset-s", 3)
    still = Record(time=record.time, gyro=record.gyro * 0.0 + np.random.default_rng(1).normal(size=record.gyro.shape))
    write_record(still, tmp_path / "still.parquet")
    line = undrift.refused("session", "new", tmp_path / "still.parquet", "--rates", path, "-o", tmp_path / "s")
    assert "wanted the log of the table that turned this device, got a correlation of 0." in line
    assert not (tmp_path / "s").exists()
