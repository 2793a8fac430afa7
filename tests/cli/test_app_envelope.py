"""Every answer in JSON has the same keys; examples in every --help; completion; progress where stderr is no terminal."""

import shlex
import time
from types import SimpleNamespace

import pytest

from testkit.command_line import at_rest, check_call
from testkit.data import data_path
from testkit.long_calls import CALLS
from undrift import __version__
from undrift.cli import EXAMPLES, screen
from undrift.cli import app as program
from undrift.cli.call import FUNCTIONS
from undrift.cli.screen import Terminal
from undrift.screen import part, progress, showing_on

NOBODY = "galil:tcp://127.0.0.1:9?reply_timeout_s=0.2"
GOOD = {
    "orient": "orient {bench}/corrected.parquet -o {here}/o.csv",  # a call of each command
    "info": "info {bench}/trial.parquet",
    "calibrate": "calibrate {bench}/session",
    "drift": "drift {warm} --map {here}/warm.toml",
    "correct": "correct {bench}/trial.parquet --calibration {bench}/calibration.json -o {here}/c.csv",
    "validate": "validate {bench}/corrected.parquet --reference {bench}/reference.parquet",
    "export": "export {bench}/calibration.json --target constants -o {here}/c.json",
    "noise": "noise {here}/rest.csv",
    "mount": "mount {bench}/corrected.parquet --worn lower-back",
    "record": "record",
    "certificate": "certificate {bench}/calibration.json -o {here}/c.html",
    "sample": "sample {here}/sample",
    "simulate": "simulate sit_to_stand --device mpu6050 -o {here}/s.parquet",
    "bench": "bench --no-browser --token none --folder {here}/files",
    "rig run": "rig run {here}/protocol.toml --rig simulated:?clock_speed=1e6 --device simulated:?seed=3 --chamber simulated: "
    "-o {here}/run --yes",
    "rig stop": "rig stop --rig simulated:",
    "rig check": "rig check --rig simulated:?clock_speed=1e6 --seconds 4",
}
BAD = {  # calls that are refused
    "info": "info nowhere.csv",
    "record": "record tcp://127.0.0.1:9 -o {here}/a.xls",
    "export": "export nowhere.json --target c -o {here}/c.h",
    "rig run": "rig run nowhere.toml --rig manual: --device tcp://127.0.0.1:9 -o {here}/run",
    "rig stop": f"rig stop --rig '{NOBODY}'",
    "sample": "sample {here}",
    "demo": "demo --out {here}",
}
WARM = (
    'columns = { time = "Time", gyro = ["Gx", "Gy", "Gz"], temp = "dTemp" }\n'
    'units = { time = "ms", gyro = "dps", temp = "degC" }\n'
    "scale = { gyro = { gain = 0.06097560976 }, temp = { gain = 0.00294117647, offset = 36.53 } }\n"
)


@pytest.fixture
def words(bench, tmp_path, monkeypatch):
    (tmp_path / "warm.toml").write_text(WARM)
    at_rest(tmp_path, "rest.csv")
    names = {"bench": bench, "here": tmp_path, "warm": data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz")}
    return lambda text: [*shlex.split(text.format(**names)), "--json"]


def test_every_command_has_a_transcript_and_examples():
    assert {*GOOD, *CALLS} == set(FUNCTIONS)
    assert {name.split()[0] for name in EXAMPLES if name} == set(program.COMMANDS)


@pytest.mark.parametrize("name", BAD)
def test_a_refused_call_is_an_object_with_the_error_and_keeps_its_exit_code(undrift, words, name):
    answer = undrift(*words(BAD[name]))
    assert answer.code == (3 if name == "rig stop" else 2), answer
    told = answer.json()
    assert told.keys() == {"kind", "version", "error"}
    assert (told["kind"], told["version"]) == (f"undrift.{name.replace(' ', '_')}", __version__)
    assert told["error"]["kind"].endswith(("Error", "Timeout"))
    assert answer.err == f"undrift: {told['error']['text']}\n"


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_help_ends_with_examples_that_parse(undrift, name):
    shown = undrift.good(*name.split(), "--help").out
    end = shown[shown.index("Examples:") :].splitlines()[1:]
    assert [line.strip() for line in end if line.strip()] == list(EXAMPLES[name])
    assert 2 <= len(EXAMPLES[name]) <= 3
    for line in EXAMPLES[name]:
        assert len(line) <= 78, "it would be wrapped"
        tokens = shlex.split(line)[1:]
        assert tokens[: len(name.split())] == name.split()
        check_call(tokens)


def test_progress_is_a_line_now_and_then_where_stderr_is_no_terminal(monkeypatch, capsys):
    clock = SimpleNamespace(now=100.0)  # a busy machine does not change what is printed
    monkeypatch.setattr(screen, "time", SimpleNamespace(monotonic=lambda: clock.now))
    monkeypatch.setattr(screen, "INTERVAL_S", 0.05)
    with Terminal("twin") as shown, showing_on(shown):
        progress("reading", 0.0)
        time.sleep(0.2)
        clock.now += 30.0
        with part(0.5, 1.0):
            progress("held out: recording 2 of 4", 0.5)
        time.sleep(0.2)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "undrift twin: reading, 0 s so far, time left not known yet"
    assert lines[-1] == "undrift twin: held out: recording 2 of 4, 30 s so far, about 10 s left (75 %)"
    time.sleep(0.1)
    assert capsys.readouterr().err == ""  # nothing more once it ends
