"""Every command that reads, every way a recording can be wrong: exit code 2, one line, nothing written, nothing lost."""

import gzip

import pytest

from testkit.command_line import at_rest, contents, lines_of, row_of, write_lines
from undrift.io.formats import read_record, write_record

COMMANDS = ("info", "calibrate", "correct", "orient", "validate", "noise")


def _cell(column, value, row=300):
    def spoil(lines):
        lines[row][next(k for k, head in enumerate(lines[0]) if head.startswith(column))] = value

    return spoil


def _drop(column):
    def spoil(lines):
        k = next(k for k, head in enumerate(lines[0]) if head.startswith(column))
        for cells in lines:
            del cells[k]

    return spoil


def _time(row, source):
    def spoil(lines):
        lines[row][0] = lines[source][0]

    return spoil


def _mixed(lines):
    del lines[600::2]


def _short_row(lines):
    lines[300] = lines[300][:3]


def _one_row(lines):
    del lines[2:]


def _no_rows(lines):
    del lines[1:]


def _two_units(lines):
    lines[0] = [head.replace("gyro_x_rad_s", "gyro_x_dps").replace("gyro_x_count", "gyro_x_dps") for head in lines[0]]


FAULTS = {
    "NaN": (_cell("gyro_x", "nan"), "1 empty or NaN cells, first in data row 300"),
    "an empty cell": (_cell("accel_z", ""), "1 empty or NaN cells, first in data row 300"),
    "infinity": (_cell("accel_y", "inf"), "got inf in data row 300"),
    "a huge value": (_cell("gyro_z", "1e9"), "got 1e+09 in data row 300"),
    "text in a number column": (_cell("accel_x", "abc"), "expected numbers, got 'abc' in data row 300"),
    "a missing column": (_drop("gyro_y"), "Add the missing axes"),
    "no time": (_drop("time"), "expected a time column or sample_rate_hz"),
    "two units in one triad": (_two_units, "expected"),
    "time that goes back": (_time(501, 400), "backward"),
    "time that stands still": (_time(501, 500), "doubled"),
    "time with NaN": (_cell("time", "nan"), "first in data row 300"),
    "two sample rates": (_mixed, "expected one sample rate, got 100 Hz and then 50 Hz"),
    "a short row": (_short_row, "got 3 in data row 300"),
    "one row": (_one_row, "expected two rows or more, got 1"),
    "a head alone": (_no_rows, "expected"),
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


@pytest.mark.parametrize("command", COMMANDS)
def test_the_sound_recordings_are_taken(undrift, bench, sound, tmp_path, command):
    path = tmp_path / "r.csv"
    path.write_bytes((sound / source_of(command)).read_bytes())
    undrift.good(*words_for(command, path, bench, tmp_path))


@pytest.mark.parametrize("older", [False, True], ids=["new", "older"])
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_wrong_recording_is_refused_in_one_line(undrift, bench, sound, tmp_path, command, fault, older):
    spoil, expected = FAULTS[fault]
    lines = lines_of(sound / source_of(command))
    spoil(lines)
    path = tmp_path / "r.csv"
    write_lines(path, lines)
    words = words_for(command, path, bench, tmp_path)
    if older:
        older_results(tmp_path)
    before = contents(tmp_path)
    line = undrift.refused(*words)
    assert expected in line
    assert "r.csv" in line
    assert contents(tmp_path) == before


def _truncated(sound, source, path):
    packed = gzip.compress((sound / source).read_bytes())
    path.write_bytes(packed[: len(packed) // 2])


def _torn(sound, source, path):
    packed = bytearray(gzip.compress((sound / source).read_bytes()))
    packed[200:220] = bytes(20)
    path.write_bytes(packed)


FILES = {
    "a gzip that is cut off": (_truncated, "gzip file is truncated"),
    "a damaged gzip": (_torn, "gzip file"),
    "an empty file": (lambda sound, source, path: path.write_bytes(b""), "got an empty file"),
    "no file": (lambda sound, source, path: None, "no file of that name"),
    "a folder": (lambda sound, source, path: path.mkdir(), "expected"),
    "a torn Parquet file": (lambda sound, source, path: path.write_bytes(b"PAR1" + bytes(200)), "expected"),
}


@pytest.mark.parametrize("fault", FILES)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_damaged_or_missing_file_is_refused_in_one_line(undrift, bench, sound, tmp_path, command, fault):
    make, expected = FILES[fault]
    path = tmp_path / "r.csv.gz"
    make(sound, source_of(command), path)
    words = words_for(command, path, bench, tmp_path)
    older_results(tmp_path)
    before = contents(tmp_path)
    assert expected in undrift.refused(*words)
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


def test_a_wrongly_named_channel_is_pointed_at(undrift, bench, sound, tmp_path):
    lines = lines_of(sound / "trial.csv")
    lines[0] = [head.replace("gyro", "rot") for head in lines[0]]
    path = tmp_path / "r.csv"
    write_lines(path, lines)
    told = undrift.good("info", path, "--json").json()
    assert row_of(told, "content", "unit of gyro")["value"] == "no readings"
    assert any("rot_x_count, rot_y_count, rot_z_count" in note for note in told["notes"])
    assert "no gyroscope readings" in undrift.refused(*words_for("orient", path, bench, tmp_path))
    assert "gyroscope" in undrift.refused(*words_for("validate", path, bench, tmp_path))
    done = undrift.good(*words_for("correct", path, bench, tmp_path))
    assert "no gyroscope" in done.out


CALIBRATIONS = {
    "nothing": (None, "No such file"),
    "text": ("not json", "expected JSON"),
    "half": ("half", "expected JSON"),
    "another kind": ('{"kind": "undrift.device", "format": 1}', "expected kind 'undrift.calibration'"),
    "another version": ("version", "expected format 1, got 99"),
    "another shape": ("shape", "at gyro.matrix"),
    "another unit": ("unit", "is for readings in v"),
    "a list": ("[1, 2]", "expected kind 'undrift.calibration'"),
    "a folder": ("folder", "no calibration of"),
}


@pytest.mark.parametrize("fault", CALIBRATIONS)
@pytest.mark.parametrize("command", ["correct", "orient", "validate", "noise"])
def test_a_calibration_that_cannot_be_used_is_refused_in_one_line(undrift, bench, tmp_path, command, fault):
    import json

    how, expected = CALIBRATIONS[fault]
    path = tmp_path / "calibration.json"
    text = (bench / "calibration.json").read_text()
    held = json.loads(text)
    if how == "half":
        path.write_text(text[: len(text) // 2])
    elif how == "version":
        path.write_text(json.dumps(held | {"format": 99}))
    elif how == "shape":
        held["gyro"]["matrix"] = held["gyro"]["matrix"][:2]
        path.write_text(json.dumps(held))
    elif how == "unit":
        held["gyro"]["unit_in"] = "v"
        path.write_text(json.dumps(held))
    elif how == "folder":
        path.mkdir()
    elif how is not None:
        path.write_text(how)
    words = words_for(command, bench / "trial.parquet", bench, tmp_path)
    if command == "noise":
        words += ["--rest-s", "0:5", "--calibration", path]
    else:
        words[words.index("--calibration") + 1] = path
    older_results(tmp_path)
    before = contents(tmp_path)
    assert expected in undrift.refused(*words)
    assert contents(tmp_path) == before
