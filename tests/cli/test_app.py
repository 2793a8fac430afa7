"""What becomes of errors, and the program as a process."""

import json
import subprocess
import sys

import pytest
from benchmarks.broad_files import broad_file

from undrift import __version__
from undrift.cli import app as program
from undrift.errors import InputError, LimitError, NotObservable, RigFault


def errors_in(said):
    """Return what is not progress, which a busy computer has time to show."""
    return "".join(line for line in said.splitlines(keepends=True) if " s so far, " not in line)


def process(*words, **more):
    call = [sys.executable, "-m", "undrift", *map(str, words)]
    return subprocess.run(call, capture_output=True, text=True, timeout=120, check=False, **more)


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (InputError("wanted a, got b;\n  do c"), 2, "undrift: wanted a, got b; do c\n"),
        (NotObservable("m_xy: wanted poses, got none; add some"), 2, "undrift: m_xy: wanted poses, got none; add some\n"),
        (RigFault("axis 1: following error; home it"), 3, "undrift: axis 1: following error; home it\n"),
        (LimitError("wanted 90 deg/s or less, got 900"), 3, "undrift: wanted 90 deg/s or less, got 900\n"),
        (PermissionError(13, "Not you", "a.csv"), 2, "undrift: a.csv: Not you. Check the path and its permissions.\n"),
        (KeyboardInterrupt(), 130, "undrift: stopped. No file was left incomplete.\n"),
    ],
)  # fmt: skip
def test_every_kind_of_error_has_its_exit_code_and_one_line(undrift, monkeypatch, error, code, line):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("undrift.cli.call.call", fail)
    answer = undrift("info")
    assert (answer.code, answer.out, answer.err) == (code, "", line)


def test_a_defect_is_one_line_too_and_shows_its_place_on_request(undrift, monkeypatch):
    def fail(*_, **__):
        raise ZeroDivisionError("float division")

    monkeypatch.setattr("undrift.cli.call.call", fail)
    monkeypatch.delenv("UNDRIFT_TRACEBACK", raising=False)
    assert "internal error: ZeroDivisionError: float division. Please report it" in undrift.refused("info")
    monkeypatch.setenv("UNDRIFT_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        program.run(["info"])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["bogus"], 'Unknown command "bogus"'),
        (["info"], "FILES is missing. Run undrift info --help."),
        (["info", "--bogus", "a"], "Unknown option: --bogus"),
        (["correct"], "RECORDING is missing. Run undrift correct --help."),
        (["calibrate", "s", "--gyro", "by-eye"], 'Invalid value "by-eye" for --gyro. Choose from: "rate-table"'),
        (["calibrate", "s", "--latitude-deg", "north"], 'unable to convert "north" into float'),
        (["correct", "a.csv", "--calibration", "c.json"], "--output is missing"),
        (["orient", "a.csv"], "--output is missing"),
        (["validate", "a.csv", "--offset", "some"], 'Invalid value "some" for --offset'),
        (["noise", "a.csv", "--rest-s"], "--rest-s requires a value"),
        (["demo", "extra"], "unexpected argument extra. Run undrift demo --help"),
        (["--json"], 'Unknown command "--json"'),
    ],
)
def test_a_wrong_call_is_told_in_one_line(undrift, words, expected):
    line = undrift.refused(*words)
    assert expected in line
    assert "--help" in line


@pytest.mark.parametrize("words", [["info"], ["info", "--json"], ["calibrate"], ["drift", "--json"]])
def test_a_name_that_is_not_utf_8_is_refused_in_one_line(undrift, tmp_path, words):
    named = str(tmp_path / "caf\udce9.csv")  # as the shell hands over the byte 0xe9
    line = undrift.refused(words[0], named, *words[1:])
    assert r"caf\udce9.csv: the name is not valid UTF-8" in line


def test_without_a_command_the_help_is_shown_in_80_columns(undrift):
    shown = undrift.good().out
    assert "Usage: undrift COMMAND" in shown
    assert shown == undrift.good("--help").out == undrift.good("-h").out
    assert undrift.good("rig").out == undrift.good("rig", "--help").out
    rows = [line for line in shown.partition("Examples:")[0].splitlines() if line.startswith("  ")]
    assert [row.split()[0] for row in rows] == [*program.COMMANDS, "--version"]
    assert max(map(len, rows)) <= 80
    assert undrift.good("--version").out == f"{__version__}\n"


def test_main_exits_with_the_code(undrift, monkeypatch):
    with pytest.raises(SystemExit) as exit_:
        program.main(["info", "nowhere.csv"])
    assert exit_.value.code == 2
    monkeypatch.setattr(sys, "argv", ["undrift", "--version"])
    with pytest.raises(SystemExit) as exit_:
        program.main()
    assert exit_.value.code == 0


@pytest.mark.slow
def test_as_a_process_results_go_to_stdout_and_errors_to_stderr(tmp_path):
    path = broad_file("02_undisturbed_slow_rotation_B")
    done = process("info", path, "--json")
    assert (done.returncode, errors_in(done.stderr)) == (0, "")
    assert json.loads(done.stdout)["data"]["rows"] == 53240
    done = process("orient", path, "-o", "angles.csv", cwd=tmp_path)
    assert (done.returncode, errors_in(done.stderr)) == (0, "")
    assert [p.name for p in tmp_path.iterdir()] == ["angles.csv"]
    done = process("correct", path, "--calibration", "none.json", "-o", "c.parquet", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("undrift: none.json: expected a calibration file, got No such file")
    assert done.stderr.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["angles.csv"]
