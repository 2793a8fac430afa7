"""undrift drift: real logs as a lab reads them, made sessions, and what is refused with its number and nothing written."""

import gzip
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from testkit.command_line import contents, lines_of, write_lines
from testkit.data import data_path, show
from undrift.io.formats import write_record
from undrift.io.session import write_session
from undrift.io.store import read_calibration, write_calibration
from undrift.record import Record
from undrift.sim.device.presets import preset
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.thermal import ChamberSettings, ThermalSettings, WarmUpSettings, simulate_thermal_session

pytestmark = pytest.mark.usefixtures("computed_once")

DEVICE = preset("enc03j_3031")
QUICK = ChamberSettings(ramp_rate_c_per_min=20.0, air_lag_s=5.0, board_lag_s=10.0, soak_hold_s=300.0)
BENCH = BenchSettings(
    sample_rate_hz=50.0, still_s=6.0, move_s=1.0, turn_rates=tuple(np.radians((30.0, 60.0, 90.0))), dwell_s=1.5
)
SOAKS = ThermalSettings(
    bench=BENCH, chamber=QUICK, set_points_c=(18.0, 28.0, 38.0, 47.0, 57.0, 66.0, 75.0), back=True, faces="six"
)
MPU_MAP = f"""columns = {{ time = "Time", gyro = ["Gx", "Gy", "Gz"], accel = ["Ax", "Ay", "Az"], temp = "dTemp" }}
units = {{ time = "ms", gyro = "dps", accel = "g", temp = "degC" }}
scale = {{ gyro = {{ gain = {1 / 16.4} }}, accel = {{ gain = {1 / 16384} }}, temp = {{ gain = {1 / 340}, offset = 36.53 }} }}
"""
BMI_MAP = """columns = { temp = 0, accel = [1, 2, 3], gyro = [4, 5, 6] }
units = { temp = "degC", accel = "g", gyro = "dps" }
header = false
skip_rows = 1
sample_rate_hz = 50.0
drop_bad_rows = true
"""
HEAD = '[session]\nkind = "thermal"\nserial = "{serial}"\ngravity_m_s2 = 9.80665\n'


@pytest.fixture(scope="module")
def soaks(tmp_path_factory):
    """A session of soaks up and down on six faces, and the device's calibration."""
    folder = tmp_path_factory.mktemp("soaks")
    made = simulate_thermal_session("soak", DEVICE, rng=np.random.default_rng(1), settings=SOAKS)
    write_session(made, folder / "session")
    write_calibration(true_calibration(DEVICE), folder / "calibration.json")
    return folder


def slopes_of(text):
    """Return slope and uncertainty of each axis of the first table."""
    rows = re.findall(r"^ ([xyz]) +([-+][\d.]+) \+- ([\d.]+)", text, re.MULTILINE)[:3]
    assert [row[0] for row in rows] == ["x", "y", "z"]
    return np.array([row[1:] for row in rows], float)


@pytest.mark.slow
def test_a_warm_up_of_a_bare_board_gives_its_slopes_and_says_what_it_cannot_tell(undrift, tmp_path):
    (tmp_path / "map.toml").write_text(MPU_MAP)
    log = data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz")
    words = ["drift", log, "--map", tmp_path / "map.toml"]
    answer = undrift.good(*words, "-o", tmp_path / "mpu.json", "--report", tmp_path / "mpu.html", "--details")
    found = 1e3 * slopes_of(answer.out)[:, 0]
    show("slopes as shown, mdeg/s per degC", found, "-3.5 / +27.9 / -2.4 within 0.5")
    np.testing.assert_allclose(found, [-3.5, 27.9, -2.4], atol=0.5)
    for said in (
        "verdict: marginal",
        "Gyroscope offset over temperature: 10.8 to 28.9 degC seen, ",
        "No calibration given",
        "Gyroscope scale over temperature not observable",
    ):
        assert answer.out.count(said) == 1, said
    assert f"--calibration {tmp_path / 'mpu.json'}" in answer.out
    assert len(answer.out.splitlines()) < 50  # three findings take up to three lines each
    corrected = tmp_path / "corrected.parquet"
    undrift.good(
        "correct", log, "--map", tmp_path / "map.toml", "--calibration", tmp_path / "mpu.json", "-o", corrected
    )
    assert corrected.is_file()
    page = (tmp_path / "mpu.html").read_text()
    assert page.count("<svg") == 2
    assert "Verdict: marginal" in page


@pytest.mark.slow
def test_two_plateaus_with_torn_lines_name_the_fourfold_error(undrift, tmp_path):
    session = HEAD.format(serial="BMI270")
    for name in ("cold", "hot"):
        shutil.copy(data_path("thermal_bmi270_two_point", f"BMI_270_{name}_test.csv.gz"), tmp_path)
        session += (
            f'[[recording]]\nfile = "BMI_270_{name}_test.csv.gz"\nsample_rate_hz = 50\nheader = false\nskip_rows = 1\n'
            "drop_bad_rows = true\ncolumns = { temp = 0, accel = [1, 2, 3], gyro = [4, 5, 6] }\n"
            'units = { temp = "degC", accel = "g", gyro = "dps" }\n'
        )
    (tmp_path / "session.toml").write_text(session)
    answer = undrift.good("drift", tmp_path, "--details")
    found = 1e3 * slopes_of(answer.out)[:, 0]
    show("BMI270, mdeg/s per degC", found, "+19.1 / +12.9 / -1.5")
    np.testing.assert_allclose(found, [19.1, 12.9, -1.5], atol=0.5)
    assert answer.out.count("readings are 4 times too small") == 1
    assert "Accelerometer offset over temperature: " not in answer.out
    assert "no data near them" in answer.out
    assert "verdict: marginal" in answer.out
    (tmp_path / "map.toml").write_text(BMI_MAP)
    bare = undrift.good("drift", *sorted(tmp_path.glob("*.gz")), "--map", tmp_path / "map.toml", "--details")
    assert bare.out.count("not seen") == 3  # between sessions, on each axis
    assert "Turn-on bias repeatability not observable" in bare.out
    for out in (answer.out, bare.out):
        assert "each session rested at one or two temperatures" in out
        assert "one way only" not in out


@pytest.mark.slow
def test_eleven_recordings_of_a_bicycle_are_one_session(undrift, tmp_path):
    session = HEAD.format(serial="bicycle")
    for path in sorted(data_path("multipos_mpu6050_bicycle").glob("*.npz")):
        shutil.copy(path, tmp_path)
        session += (
            f'[[recording]]\nfile = "{path.name}"\n'
            'columns = { time = "t_s", gyro = "gyro_rad_s", accel = "acc_raw", temp = "temp_degC" }\n'
            'units = { time = "s", gyro = "rad/s", accel = "count", temp = "degC" }\n'
        )
    (tmp_path / "session.toml").write_text(session)
    answer = undrift.good("drift", tmp_path, "--details")
    found, stated = 1e3 * slopes_of(answer.out).T
    show("bicycle, mdeg/s per degC", found, "-84 / +18 / -4")
    np.testing.assert_array_less(np.abs(found - [-84.0, 18.0, -4.0]), 3.0 * stated)
    assert "count per degC" in answer.out.replace("\n", " ") or "(count" in answer.out


@pytest.mark.slow
def test_a_full_session_is_good_and_every_table_is_shown_and_drawn(undrift, soaks, tmp_path):
    words = ["drift", soaks / "session", "--calibration", soaks / "calibration.json"]
    answer = undrift.good(
        *words, "--details", "-o", tmp_path / "c.json", "--report", tmp_path / "p.html", "--figure", tmp_path / "f.png"
    )
    out = answer.out
    for said in (
        "verdict: good",
        "hysteresis half-width",
        "scale factor",
        "asymmetry",
        "scale + dynamic",
        "chosen",
        "extrapolated",
    ):
        assert said in out, said
    sensitivity = re.findall(r"^ [xyz] +([-+]0\.2\d+) \+- ", out, re.MULTILINE)
    assert len(sensitivity) == 3  # 0.2 %/K by the preset
    assert (tmp_path / "f.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "p.html").read_text().count("<svg") >= 4
    assert len(out.splitlines()) < 66  # three findings take up to three lines each
    held = read_calibration(tmp_path / "c.json")
    assert held.drift.static.gyro_hysteresis is not None
    assert held.drift.scale is not None


@pytest.mark.slow
def test_json_is_the_calibration_with_its_tables(undrift, soaks):
    words = ["drift", soaks / "session", "--calibration", soaks / "calibration.json"]
    told = undrift.good(*words, "--json", "--range-c", "20:70", "--step-c", "2.5", "--tables", "scale").json()
    assert told["kind"] == "undrift.calibration"
    assert told["drift"]["static"]["temp_c"] == list(np.arange(20.0, 70.1, 2.5))
    assert told["drift"]["dynamic"] is None
    assert np.shape(told["drift"]["scale"]["gyro_matrix"]) == (21, 3, 3)
    note = undrift.good(*words, "--json", "--spline", "not-a-knot", "--tables", "none", "--lag-s", "3").json()
    assert dict(note["provenance"]["settings"])["drift_spline"] == "not-a-knot"
    assert note["drift"]["lag_s"] == 3.0
    assert note["drift"]["lag_smooth_s"] > 0.0


@pytest.mark.slow
def test_the_calibration_may_be_written_over_and_is_not_where_it_fails(undrift, soaks, tmp_path):
    shutil.copy(soaks / "calibration.json", tmp_path)
    own = tmp_path / "calibration.json"
    undrift.good("drift", soaks / "session", "--calibration", own, "-o", own, "--tables", "none")
    assert read_calibration(own).drift is not None
    before = contents(tmp_path)
    bare = replace(
        simulate_thermal_session("warm_up", DEVICE, rng=np.random.default_rng(2)).records[0], temp_c=None, device=""
    )
    write_record(bare, tmp_path / "bare.parquet")
    before = contents(tmp_path)
    undrift.refused("drift", tmp_path / "bare.parquet", "--calibration", own, "-o", own)
    assert contents(tmp_path) == before


@pytest.mark.slow
def test_several_logs_are_combined_and_a_warm_up_is_fitted(undrift, soaks, tmp_path):
    for k in range(3):
        settings = replace(
            SOAKS, warm_up=WarmUpSettings(start_c=8.0 + 10.0 * k, end_c=28.0 + 10.0 * k, duration_s=1500.0)
        )
        made = simulate_thermal_session("warm_up", DEVICE, rng=np.random.default_rng(k), settings=settings)
        write_record(made.records[0], tmp_path / f"day{k}.parquet")
    logs = sorted(tmp_path.glob("*.parquet"))
    own = tmp_path / "c.json"
    answer = undrift.good(
        "drift", *logs, "--calibration", soaks / "calibration.json", "--warm-up", "-o", own, "--details"
    )
    assert "between sessions" in answer.out
    assert "one session only" not in answer.out
    assert "--power-on-s 0 -o corrected.parquet" in answer.out
    assert read_calibration(own).drift.static.warm_up is not None
    walk = tmp_path / "walk.parquet"
    write_record(simulate_thermal_session("warm_up", DEVICE, rng=np.random.default_rng(9)).records[0], walk)
    words = [walk, "--calibration", own]
    assert "No warm-up was subtracted" in undrift.good("noise", *words).out
    assert "No warm-up was subtracted" not in undrift.good("noise", *words, "--power-on-s", "0").out
    words += ["-o", tmp_path / "angles.parquet"]
    assert "No warm-up was subtracted" in undrift.good("orient", *words).out
    assert "No warm-up was subtracted" not in undrift.good("orient", *words, "--power-on-s", "0").out


def warm_log(path, *, temp_c=None, **changes):
    rng = np.random.default_rng(3)
    n = 50 * 300
    values = {
        "time": np.arange(n) / 50.0,
        "gyro": rng.normal(0.0, 1e-3, (n, 3)),
        "accel": rng.normal([0.0, 0.0, 9.8], 1e-2, (n, 3)),
        "temp_c": np.linspace(20.0, 30.0, n) if temp_c is None else temp_c(n),
    }
    write_record(Record(**(values | changes)), path)
    return path


def shaken(n):
    return np.cumsum(np.random.default_rng(4).normal(0.0, 1.0, (n, 3)), axis=0) % 3.0


REFUSED = {
    "no temperature": ({"temp_c": lambda n: None}, r"wanted a column .* got neither"),
    "constant": ({"temp_c": lambda n: np.full(n, 25.0)}, r"got 25\.00 degC throughout \(constant\)"),
    "a narrow span": (
        {"temp_c": lambda n: np.linspace(20.0, 21.6, n)},
        r"wanted a span of 2 degC or more, got 1\.6 \(20\.00 to 21\.60\)",
    ),
    "impossible": ({"temp_c": lambda n: np.linspace(20.0, 300.0, n)}, r"wanted -40 to 125 degC of a board, got 125"),
    "corrected": ({"state": "corrected", "frame": "b"}, "wanted raw readings, got a corrected record"),
    "counts": ({"gyro_unit": "count"}, "wanted a calibration, or gyroscope readings in a physical unit, got count"),
    "never at rest": (
        {"gyro": shaken(15000), "accel": 10.0 * shaken(15000)},
        r"wanted stretches at rest, got none: .* known to 2\.\d deg/s only",
    ),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_a_log_that_tells_nothing_is_refused_with_its_number(undrift, tmp_path, fault):
    changes, message = REFUSED[fault]
    log = warm_log(tmp_path / "log.parquet", **changes)
    before = contents(tmp_path)
    outputs = ["-o", tmp_path / "c.json", "--report", tmp_path / "p.html", "--figure", tmp_path / "f.svg"]
    assert re.search(message, undrift.refused("drift", log, *outputs))
    assert contents(tmp_path) == before


@pytest.mark.slow
def test_lines_that_are_wrong_are_refused_with_their_row(undrift, tmp_path):
    log = warm_log(tmp_path / "log.csv")
    lines = lines_of(log)
    place = next(k for k, head in enumerate(lines[0]) if head.startswith("temp"))
    lines[300][place] = "nan"
    write_lines(tmp_path / "nan.csv", lines)
    assert "data row 300" in undrift.refused("drift", tmp_path / "nan.csv", "-o", tmp_path / "c.json")
    for cells in lines[1:]:
        cells[place] = "nan"
    write_lines(tmp_path / "all.csv", lines)
    line = undrift.refused("drift", tmp_path / "all.csv", "--gaps", "keep", "-o", tmp_path / "c.json")
    assert re.search(r"got 0 of 15000 \(the others NaN\)", line)
    lines = lines_of(log)
    lines[400][0] = lines[200][0]
    write_lines(tmp_path / "back.csv", lines)
    assert re.search(r"time|backward", undrift.refused("drift", tmp_path / "back.csv", "-o", tmp_path / "c.json"))
    assert not (tmp_path / "c.json").exists()


@pytest.mark.slow
def test_another_device_is_refused(undrift, soaks, tmp_path):
    log = warm_log(tmp_path / "log.parquet", device="other")
    line = undrift.refused("drift", log, "--calibration", soaks / "calibration.json", "-o", tmp_path / "c.json")
    assert "got other, enc03j_3031-typical" in line
    assert not (tmp_path / "c.json").exists()


@pytest.mark.slow
def test_a_call_that_is_wrong_is_refused_before_anything_is_read(undrift, soaks, tmp_path):
    session = soaks / "session"
    for words, message in (
        ((), "parameter SESSIONS requires an argument. Say undrift drift --help."),
        ((session, "--range-c", "20"), "wanted LOW:HIGH in degC, got '20'"),
        ((session, "--range-c", "70:20"), "wanted LOW below HIGH in degC, got '70:20'"),
        ((session, "--step-c", "0"), "wanted more than 0 degC, got 0"),
        ((session, "-o", tmp_path / "c.txt"), "wanted a name ending in .json"),
        ((session, "--report", tmp_path / "p.pdf"), "wanted a name ending in .html"),
        ((session, "--figure", tmp_path / "none" / "f.png"), "make it first"),
        ((tmp_path / "missing.csv",), "missing.csv"),
    ):
        assert message in undrift.refused("drift", *words), message
    line = undrift.refused(
        "drift", session, "--calibration", soaks / "calibration.json", "--range-c", "20:70", "--step-c", "3"
    )
    assert "wanted a range that the step divides, got 20 to 70 degC by 3" in line
    assert contents(tmp_path) == {}


@pytest.mark.slow
def test_accelerometers_alone_have_tables_and_no_picture_of_gyroscopes(undrift, soaks, tmp_path):
    made = simulate_thermal_session("warm_up", DEVICE, rng=np.random.default_rng(5))
    write_session(replace(made, records=(replace(made.records[0], gyro=None),)), tmp_path / "session")
    words = ["drift", tmp_path / "session", "--calibration", soaks / "calibration.json"]
    out = undrift.good(*words, "--details").out
    assert "Accelerometer offset over temperature: " in out
    assert "Gyroscope offset over temperature" not in out
    before = contents(tmp_path)
    line = undrift.refused(*words, "--figure", tmp_path / "f.png", "-o", tmp_path / "c.json")
    assert "wanted gyroscopes to draw, got none" in line
    assert contents(tmp_path) == before


def test_an_empty_file_named_as_gzip_is_one_line(undrift, tmp_path):
    with gzip.open(tmp_path / "log.csv.gz", "wt") as file:
        file.write("")
    assert "log.csv.gz" in undrift.refused("drift", tmp_path / "log.csv.gz", "-o", tmp_path / "c.json")


@pytest.mark.slow
def test_a_log_given_twice_is_refused_and_a_log_in_two_files_is_one_switch_on(undrift, tmp_path):
    (tmp_path / "map.toml").write_text(MPU_MAP)
    log = data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz")
    (tmp_path / "again.csv.gz").write_bytes(log.read_bytes())
    words = ["--map", tmp_path / "map.toml", "-o", tmp_path / "made.json"]
    refused = undrift.refused("drift", log, tmp_path / "again.csv.gz", *words)
    for said in ("session 1 (Tempdata01-02-14.csv.gz) and session 2 (again.csv.gz): the same file", "leave one out"):
        assert said in refused, said
    assert not (tmp_path / "made.json").exists()
    head, *rows = gzip.decompress(log.read_bytes()).splitlines(keepends=True)
    (tmp_path / "a.csv").write_bytes(b"".join([head, *rows[: len(rows) // 2]]))
    (tmp_path / "b.csv").write_bytes(b"".join([head, *rows[len(rows) // 2 :]]))
    answer = undrift.good("drift", tmp_path / "b.csv", tmp_path / "a.csv", *words, "--details")
    assert "Turn-on bias repeatability unknown" in answer.out
    assert "one session only" in answer.out
    assert "between sessions" not in answer.out


def test_a_table_of_set_points_is_fitted_by_its_map_and_is_no_recording(undrift, tmp_path):
    rng, lines = np.random.default_rng(1), ["T;n;gx;gy;gz;sx;sy;sz"]
    for temp in (*range(20, 75, 10), *range(65, 20, -10)):
        mean = 0.02 * (temp - 25.0) + rng.normal(0.0, 0.003, 3)
        lines.append(";".join(map(str, (temp, 400, *(round(float(value / 0.07), 3) for value in mean), 1.0, 1.0, 1.0))))
    (tmp_path / "chamber.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "map.toml").write_text(
        'columns = { temp = "T", gyro = ["gx", "gy", "gz"] }\nunits = { temp = "degC", gyro = "dps" }\n'
        'scale = { gyro = { gain = 0.07 } }\ndelimiter = ";"\n'
        'set_points = { count = "n", gyro_sd = ["sx", "sy", "sz"] }\n'
    )
    words = (tmp_path / "chamber.csv", "--map", tmp_path / "map.toml", "-o", tmp_path / "c.json")
    told = undrift.good("drift", *words, "--details")
    for slope, uncertainty in slopes_of(told.out):
        assert slope == pytest.approx(0.02, abs=4.0 * uncertainty)
    assert "from spread and count" in told.out
    assert "Next:" not in told.out  # a table is nothing that correct can read
    made = read_calibration(tmp_path / "c.json")
    assert made.file_map is None
    assert made.reference_temp_c == pytest.approx(25.0)
    assert "is for undrift drift" in undrift.refused("calibrate", *words[:3], "-o", tmp_path / "d.json")
    seen = undrift.good("info", *words[:3]).out
    assert "11 means over set-points, 0 of them at known rates" in seen
    assert "20.00 to 70.00 degC" in seen
    assert seen.splitlines()[-1].startswith("Next: undrift drift ")
    assert "problem" not in seen
    assert "still" not in seen
