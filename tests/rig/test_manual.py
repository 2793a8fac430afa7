"""A rig that is a person: asked one line at a time."""

import math
import re

import numpy as np
import pytest

import undrift
from testkit.data import show
from testkit.rig_bench import GAIN, OFFSET, Device, simulated
from undrift.errors import InputError
from undrift.io.session import read_session
from undrift.programme import programme_of, read_protocol
from undrift.rig.folder import RunFolder
from undrift.rig.manual import AskedOperator, ManualRig
from undrift.rig.rig import RigSettings, open_rig
from undrift.rig.run import Mounted, RigBench, run_programme

DEGREE = math.pi / 180.0


class Person:
    def __init__(self, *answers: str) -> None:
        self.answers = list(answers)
        self.lines: list[str] = []

    def __call__(self, line: str) -> str:
        self.lines.append(line)
        return self.answers.pop(0) if self.answers else ""


def test_a_turn_is_what_the_person_says_it_was():
    rig = ManualRig(Person("", "358,5", " -90 deg", "10"))
    assert rig.move_by(2 * math.pi) == pytest.approx(2 * math.pi)
    assert rig.move_by(2 * math.pi) / DEGREE == pytest.approx(358.5)
    assert rig.move_by(-90 * DEGREE) / DEGREE == pytest.approx(-90)
    assert rig.position().angle / DEGREE == pytest.approx(360 + 358.5 - 90)


def test_a_wrong_answer_is_asked_for_again_three_times():
    rig = ManualRig(Person("once", "nan", "355"))
    assert rig.move_by(2 * math.pi) / DEGREE == pytest.approx(355)
    with pytest.raises(InputError, match="three answers"):
        ManualRig(Person("a", "b", "c")).move_by(1.0)


def test_nobody_to_ask_and_a_person_with_a_port_are_refused():
    with pytest.raises(InputError, match=r"RigSettings\(ask=...\)"):
        open_rig("manual:")
    with pytest.raises(InputError, match=r"manual rig: .*address"):
        open_rig("manual:tcp://host:1", RigSettings(ask=lambda line: ""))


class Operator:
    """Mounts the device, turns it about 0.8 deg less than asked, and reports the angle."""

    def __init__(self, bench):
        self.bench, self.lines = bench, []

    def __call__(self, line):
        self.lines.append(line)
        bench, table, speed = self.bench, self.bench.table, math.radians(90.0)
        if mounted := re.match(r"Motor off. Mount the device with (\S+) up", line):
            bench.mount(mounted[1])
            return ""
        angle = math.radians(float(re.match(r"Turn the device by (\S+) deg", line)[1]) - 0.8)
        before = bench.angle()
        table.enable(True)
        seconds = angle / speed + speed / table.set_acceleration(10.0)
        table.turn_for(speed, seconds)
        bench.clock.wait(seconds + 1.0)
        return f"{math.degrees(bench.angle() - before):.6f}"


TURNS = """
[protocol]
name = "by hand"
[faces]
seconds = 3.0
[turns]
angle_deg = 360.0
rest_s = 2.0
"""


def test_turns_by_hand_become_a_session_that_calibrates_the_gyroscopes(tmp_path):
    (tmp_path / "protocol.toml").write_text(TURNS)
    protocol, bench = read_protocol(tmp_path / "protocol.toml"), simulated()
    operator = Operator(bench)
    connected = RigBench(
        rig=ManualRig(operator, clock=bench.clock), mounting=AskedOperator(operator), clock=bench.clock
    )
    with RunFolder(tmp_path / "run", protocol) as folder:
        mounted = Mounted(readings=Device(bench), folder=folder)
        (result,) = run_programme(programme_of(protocol), connected, mounted, report=lambda progress: None)
    assert [piece.axis for piece in result.pieces if piece.purpose == "turn"] == ["x", "y", "z"]
    assert sum(line.startswith("Turn the device by +360 deg") for line in operator.lines) == 3
    session = read_session(tmp_path / "run")
    assert [turn.axis for turn in session.turns] == ["x", "y", "z"]
    assert [turn.angle / DEGREE for turn in session.turns] == pytest.approx(
        [359.2] * 3, abs=0.1
    )  # as reported, not as asked
    assert all(turn.turn_rate is None for turn in session.turns)
    found = undrift.calibrate(session)
    assert found.gyro.method.startswith("known-rotation")
    worst = np.abs(found.gyro.matrix @ GAIN * math.degrees(1.0) - np.eye(3)).max()
    show("matrix found by turns by hand, off the true one", worst, 1e-3)
    assert worst < 1e-3  # noise of 0.02 dps over 8 s is 0.006 deg of 360
    assert found.gyro.offset == pytest.approx(OFFSET, abs=5e-3)  # 0.02 dps over thousands of samples
