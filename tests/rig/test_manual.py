"""A rig that is a person: asked one line at a time."""

import math
import re

import numpy as np
import pytest

import undrift
from testkit.data import show
from testkit.rig_bench import GAIN, OFFSET, UP
from testkit.virtual_clock import VirtualClock
from undrift.base.clock import Clock
from undrift.errors import InputError
from undrift.io.session import read_session
from undrift.programme import programme_of, read_protocol
from undrift.record import Record
from undrift.rig.folder import RunFolder
from undrift.rig.manual import AskedOperator, ManualRig
from undrift.rig.rig import RigSettings, open_rig
from undrift.rig.run import Mounted, RigBench, run_programme
from undrift.units import STANDARD_GRAVITY

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
    """Mounts the device, turns it by hand within a few seconds, a little off the asked angle, and states what it was."""

    def __init__(self, clock: Clock, off_deg: float = -0.8) -> None:
        self.clock, self.off_deg = clock, off_deg
        self.up, self.lines, self.turns = "+z", [], []  # turns: when, for how long, by how much

    def __call__(self, line: str) -> str:
        self.lines.append(line)
        if mounted := re.match(r"Motor off. Mount the device with (\S+) up", line):
            self.up = mounted.group(1)
            return ""
        asked = float(re.match(r"Turn the device by (\S+) deg", line).group(1))
        begun, span_s = self.clock.now() + 0.5, 4.0
        self.turns.append((begun, span_s, math.radians(asked + self.off_deg)))
        self.clock.wait(span_s + 1.0)
        return f"{asked + self.off_deg:g}"

    def rate(self, times):
        """Return the rate about the vertical, rad/s: a raised cosine over each turn."""
        rate = np.zeros(len(times))
        for begun, span_s, angle in self.turns:
            part = np.clip((times - begun) / span_s, 0.0, 1.0)
            rate += angle / span_s * (1.0 - np.cos(2.0 * np.pi * part))
        return rate


class HeldDevice:
    """Reads what the operator does, through the matrix and the offset of the rig's test device."""

    def __init__(self, operator: Operator) -> None:
        self.operator, self.rng = operator, np.random.default_rng(4)

    def start(self, *, certain=True):
        self.began = self.operator.clock.now()

    def end(self):
        """Read no more; stop hands out what was read."""

    def stop(self):
        times = np.arange(self.began, self.operator.clock.now(), 0.01)
        up = UP[self.operator.up]
        gyro = (
            np.degrees(self.operator.rate(times)[:, None] * up) @ GAIN.T
            + OFFSET
            + self.rng.normal(0.0, 0.01, (len(times), 3))
        )
        accel = STANDARD_GRAVITY * up + self.rng.normal(0.0, 1e-3, (len(times), 3))
        return Record(time=times, gyro=gyro, accel=accel, gyro_unit="dps", accel_unit="m/s2", device="held")

    def latest(self):
        return ""

    def close(self):
        pass


TURNS = """
[protocol]
name = "by hand"
[faces]
seconds = 3.0
[turns]
angle_deg = 360.0
rest_s = 2.0
"""


@pytest.fixture
def by_hand(tmp_path):
    """Return a protocol of turns by hand, and what runs it."""
    (tmp_path / "protocol.toml").write_text(TURNS)
    protocol = read_protocol(tmp_path / "protocol.toml")
    clock = VirtualClock()
    operator = Operator(clock)

    def run(path, *, resume=False):
        rig = ManualRig(operator, clock=clock)
        bench = RigBench(rig=rig, mounting=AskedOperator(operator), clock=clock)
        with RunFolder(path, protocol, resume=resume) as folder:
            mounted = Mounted(readings=HeldDevice(operator), folder=folder)
            (result,) = run_programme(
                programme_of(protocol), bench, mounted, report=lambda progress: None, gravity_m_s2=STANDARD_GRAVITY
            )
        return result

    return protocol, operator, run


def test_turns_by_hand_become_a_session_that_calibrates_the_gyroscopes(by_hand, tmp_path):
    _, operator, run = by_hand
    result = run(tmp_path / "run")
    assert [piece.axis for piece in result.pieces if piece.purpose == "turn"] == ["x", "y", "z"]
    assert sum(line.startswith("Turn the device by +360 deg") for line in operator.lines) == 3
    session = read_session(tmp_path / "run")
    assert [turn.axis for turn in session.turns] == ["x", "y", "z"]
    assert [turn.angle / DEGREE for turn in session.turns] == pytest.approx([359.2] * 3)  # as stated, not as asked
    assert all(turn.turn_rate is None for turn in session.turns)
    found = undrift.calibrate(session)
    assert found.gyro.method.startswith("known-rotation")
    worst = np.abs(found.gyro.matrix @ GAIN * math.degrees(1.0) - np.eye(3)).max()
    show("matrix found by turns by hand, off the true one", worst, 1e-3)
    assert worst < 1e-3  # noise of 0.01 dps over 8 s is 0.003 deg of 360
    assert found.gyro.offset == pytest.approx(OFFSET, abs=3e-3)  # 0.01 dps over thousands of samples
