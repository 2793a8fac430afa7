"""Every command that reads, every way a recording can be wrong: exit code 2, one line, nothing written, nothing lost."""

import pytest

from testkit.command_line import at_rest, contents, lines_of, write_lines
from undrift.io.formats import read_record, write_record

COMMANDS = ("info", "calibrate", "correct", "orient", "validate", "noise")


def _cell(column, value, row=300):
    def spoil(lines):
        lines[row][next(k for k, head in enumerate(lines[0]) if head.startswith(column))] = value

    return spoil


FAULTS = {
    "NaN": (_cell("gyro_x", "nan"), "1 empty or NaN cells, first in data row 300"),
    "text in a number column": (_cell("accel_x", "abc"), "expected numbers, got 'abc' in data row 300"),
}


@pytest.fixture(scope="module")
def sound(bench, tmp_path_factory):
    """Sound CSV files: trial.csv in counts, rest.csv in rad/s and m/s2, and a session."""
    folder = tmp_path_factory.mktemp("sound")
    write_record(read_record(bench / "trial.parquet"), folder / "trial.csv")
    at_rest(folder, "rest.csv", seconds=30.0)
    write_record(read_record(bench / "session" / "recording_0.parquet"), folder / "session.csv")
    return folder


def source_of(command):
    return {"calibrate": "session.csv", "noise": "rest.csv"}.get(command, "trial.csv")


def words_for(command, path, bench, folder):
    """Return a call that reads a recording and would write beside it."""
    calibration = ["--calibration", bench / "calibration.json"]
    if command == "calibrate":
        text = (bench / "session" / "session.toml").read_text().replace("recording_0.parquet", path.name)
        (folder / "session.toml").write_text(text)
        return ["calibrate", folder, "-o", folder / "kept.json"]
    return {
        "info": ["info", path, "--json"],
        "correct": ["correct", path, *calibration, "-o", folder / "kept.parquet"],
        "orient": ["orient", path, *calibration, "-o", folder / "kept.csv"],
        "validate": ["validate", path, *calibration, "--reference", bench / "reference.parquet", "-o", folder / "kept"],
        "noise": ["noise", path, "--report", folder / "kept.html"],
    }[command]


def older_results(folder):
    """Results of an earlier day, which a refused call must leave as they are."""
    for name in ("kept.json", "kept.parquet", "kept.csv", "kept.html"):
        (folder / name).write_text("older result")
    (folder / "kept").mkdir()
    (folder / "kept" / "validation.json").write_text("older result")


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_wrong_recording_is_refused_in_one_line(undrift, bench, sound, tmp_path, command, fault):
    spoil, expected = FAULTS[fault]
    lines = lines_of(sound / source_of(command))
    spoil(lines)
    path = tmp_path / "r.csv"
    write_lines(path, lines)
    words = words_for(command, path, bench, tmp_path)
    older_results(tmp_path)
    before = contents(tmp_path)
    line = undrift.refused(*words)
    assert expected in line
    assert "r.csv" in line
    assert contents(tmp_path) == before


UNITS = {
    "dps declared as rad/s": ("gyro", 180.0 / 3.141592653589793),
    "g declared as m/s2": ("accel", 1.0 / 9.80665),
    "mg declared as m/s2": ("accel", 1000.0 / 9.80665),
}


SHOWN = [  # a device at rest turns at its offset alone: nothing tells noise the unit of the gyroscope
    (command, fault)
    for command in ("orient", "validate", "noise")
    for fault in UNITS
    if (command, fault[:3]) != ("noise", "dps")
]


@pytest.mark.parametrize(("command", "fault"), SHOWN)
def test_a_wrong_unit_is_refused_where_it_shows(undrift, bench, sound, tmp_path, command, fault):
    channel, factor = UNITS[fault]
    write_record(read_record(bench / "corrected.parquet"), tmp_path / "good.csv")
    lines = lines_of(sound / "rest.csv" if command == "noise" else tmp_path / "good.csv")
    (tmp_path / "good.csv").unlink()
    for cells in lines[1:]:
        for k, head in enumerate(lines[0]):
            cells[k] = repr(float(cells[k]) * factor) if head.startswith(channel) else cells[k]
    path = tmp_path / "r.csv"
    write_lines(path, lines)
    words = {
        "orient": ["orient", path, "-o", tmp_path / "o.csv"],
        "validate": ["validate", path, "--reference", bench / "reference.parquet", "-o", tmp_path / "v"],
        "noise": ["noise", path, "--report", tmp_path / "n.html"],
    }[command]
    before = contents(tmp_path)
    line = undrift.refused(*words)
    assert "unit" in line or "still" in line or "20000 m/s2" in line
    assert contents(tmp_path) == before
    if channel == "accel":
        assert any(f["code"] == "recording.gravity" for f in undrift.good("info", path, "--json").json()["findings"])


@pytest.mark.parametrize(("channel", "unit"), [("gyro", "dps"), ("accel", "g")])
def test_a_session_in_a_wrong_unit_is_not_calibrated(undrift, tmp_path, channel, unit):
    from testkit.data import data_path

    units = {"gyro": "rad/s", "accel": "m/s2"} | {channel: unit}
    (tmp_path / "session.toml").write_text(
        '[session]\nkind = "calibration"\nserial = "imu0"\ngravity_m_s2 = 9.81\n[[recording]]\n'
        f'file = "{data_path("multipos_mpu9150", "imu0.log.gz")}"\nsample_rate_hz = 100\nheader = false\ndelimiter = " "\n'
        "columns = { accel = [0, 1, 2], gyro = [3, 4, 5] }\n"
        f'units = {{ gyro = "{units["gyro"]}", accel = "{units["accel"]}" }}\n'
    )
    before = contents(tmp_path)
    assert "expected" in undrift.refused("calibrate", tmp_path, "-o", tmp_path / "c.json")
    assert contents(tmp_path) == before
