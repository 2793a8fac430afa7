"""A whole run over an emulated stepper board: every dwell turns at its rate; by the command line in the long run."""

import contextlib
import json
import subprocess
import sys

import pytest

from testkit import rig_bench
from testkit.rig_bench import at_rest
from undrift.cli.app import run
from undrift.io.session import read_session
from undrift.rig.programme import read_protocol
from undrift.rig.rig import RigSettings, open_rig
from undrift.units import RADIAN_PER_DEGREE

PROTOCOL = """
[protocol]
name = "steps"
[faces]
order = ["+z"]
seconds = 1.0
[rates]
turn_rate_min_dps = 30.0
turn_rate_max_dps = 90.0
turn_rate_step_dps = 30.0
grid = "inclusive"
axes = ["z"]
seconds = 4.0
bracket_s = 1.0
acceleration_dps2 = 2300.0
"""


@pytest.fixture
def emulated():
    calls = ["rig", "emulate", "--kind", "grbl", "--speed", "2", "--seed", "3", "--json"]
    code = f"from undrift.cli.app import main; main({calls!r})"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        yield json.loads(process.stdout.readline())
        process.terminate()
        assert process.wait(20.0) == 0
    finally:
        process.kill()
        process.communicate()


@pytest.mark.slow
def test_a_run_over_a_stepper_board_turns_at_every_rate_and_ends_at_rest(tmp_path):
    (tmp_path / "protocol.toml").write_text(PROTOCOL)
    with rig_bench.emulated(kind="grbl") as emulator:
        result, _ = rig_bench.run(emulator, tmp_path / "run", read_protocol(tmp_path / "protocol.toml"))
        assert at_rest(emulator)
    assert result.added == 9
    check_rates(tmp_path / "run")


def check_rates(path):
    turns = read_session(path).turns
    assert len(turns) == 6
    rates = sorted(turn.turn_rate / RADIAN_PER_DEGREE for turn in turns)
    assert rates == pytest.approx([-90.0, -60.0, -30.0, 30.0, 60.0, 90.0], rel=0.02)


@pytest.mark.slow
def test_the_command_turns_a_stepper_board_in_another_process(emulated, tmp_path, capsys):
    (tmp_path / "protocol.toml").write_text(PROTOCOL)
    words = [word for name in ("rig", "device", "hands") for word in (f"--{name}", emulated[name])]
    said = run(["rig", "run", str(tmp_path / "protocol.toml"), *words, "-o", str(tmp_path / "run"), "--yes", "--json"])
    out, err = capsys.readouterr()
    assert said == 0, err
    assert json.loads(out)["dwells"] == 9
    check_rates(tmp_path / "run")
    with contextlib.closing(open_rig(emulated["rig"], RigSettings())) as rig:
        assert rig.fault() is None
        before = rig.position().angle
        assert rig.position().angle == before
