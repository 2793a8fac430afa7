"""Every command that reads, every way a recording can be wrong: exit code 2, one line, nothing written, nothing lost."""

import pytest

from testkit.command_line import at_rest, contents, lines_of, write_lines
from undrift.io.formats import read_record, write_record

COMMANDS = ("info", "calibrate", "drift", "correct", "orient", "validate", "noise")


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
        "drift": ["drift", path, *calibration, "-o", folder / "kept.json"],
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
