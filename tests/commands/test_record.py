"""undrift record: what a device sends is in the file, whatever ends the recording; a guide leads to a calibration."""

import math
import re
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from testkit.data import show
from testkit.printing_board import PrintingBoard, sketch_line
from testkit.waiting import eventually
from undrift.base.clock import Clock
from undrift.commands.bench import source
from undrift.commands.files import Place
from undrift.commands.record import record as recording
from undrift.io.formats import read_record
from undrift.io.session import read_session
from undrift.io.store import read_calibration
from undrift.live.hands import HandHeld
from undrift.record import Face
from undrift.screen import Screen, showing_on
from undrift.sim.device.truth import true_calibration

HELD_SPEED = 4.0  # with the device, the person and the program in one process; a pseudo-terminal holds 45 lines


@pytest.fixture
def board() -> Iterator[PrintingBoard]:
    with PrintingBoard() as made:
        yield made.print_lines()


# ---- From a port to a file


def test_ports_are_listed_and_the_only_one_is_taken(undrift, tmp_path, monkeypatch, board):
    ports = [("/dev/ttyACM0", "Arduino Uno"), ("/dev/ttyUSB1", "CP2102 USB to UART")]
    for module in (sys.modules["undrift.commands.record"], source):
        monkeypatch.setattr(module, "serial_ports", lambda: ports)
    monkeypatch.setattr(source, "lsl_streams", lambda: [("wrist", "IMU, 6 channels, 100 Hz")])

    out = undrift.good("record").out
    assert "Serial ports: 2, LSL streams: 1." in out
    assert re.search(r"/dev/ttyACM0 +Arduino Uno", out)
    assert re.search(r"lsl:wrist +IMU, 6 channels, 100 Hz", out)
    assert undrift.good("record", "--json").json()["tables"]["devices"][-1] == {
        "kind": "LSL stream", "address": "lsl:wrist", "device": "IMU, 6 channels, 100 Hz"
    }  # fmt: skip
    assert out.endswith("Next: undrift record /dev/ttyACM0 -o walk.parquet\n")
    assert "got 2 (/dev/ttyACM0, /dev/ttyUSB1)" in undrift.refused("record", "-o", tmp_path / "a.csv")
    monkeypatch.setattr(sys.modules["undrift.commands.record"], "serial_ports", lambda: [(board.port, "a board")])
    assert undrift("record", "-o", tmp_path / "a.csv", "--duration-s", "1").code == 0
    for way in ("serial_ports", "lsl_streams"):
        monkeypatch.setattr(source, way, list)
    assert "No device was found" in undrift.good("record").out


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("/dev/ttyX",), "expected a file to write, got none. Add --output walk.parquet to record serial:///dev/ttyX"),
        (("/dev/ttyX", "-o", "a.xls"), "expected a name ending in .parquet, .csv or .csv.gz"),
        (("tcp://h:1", "-o", "old.csv"), "the file already exists"),
        (("pigeon:x", "-o", "a.csv"), "expected one of tcp:..."),
    ],
)
def test_what_cannot_be_recorded_is_refused(undrift, tmp_path, words, wanted):
    (tmp_path / "old.csv").write_text("earlier")
    placed = [tmp_path / word if word.endswith((".csv", ".xls")) else word for word in words]
    assert wanted in undrift.refused("record", *placed)


# ---- What ends it


def test_a_cable_that_is_pulled_is_one_line_and_costs_nothing(undrift, tmp_path, monkeypatch, board):
    monkeypatch.setattr(sys.modules["undrift.commands.record"], "LOST_S", 2.0)
    csv = tmp_path / "a.parquet.csv"

    def unplug():
        eventually(lambda: csv.exists() and csv.stat().st_size > 15_000, "two seconds of readings")
        board.unplug()

    threading.Thread(target=unplug).start()
    answer = undrift("record", board.port, "-o", tmp_path / "a.parquet", "--json")
    assert answer.code == 3, answer
    error = answer.json()["error"]
    assert error["kind"] == "LinkError"
    assert answer.err.splitlines()[-1] == f"undrift: {error['text']}"
    assert re.search(r"\(the \d\.\d s until then are in .*a\.parquet\)", error["text"]), error
    made = read_record(tmp_path / "a.parquet")
    assert made.duration_s > 1.0
    np.testing.assert_allclose(np.diff(made.time), 0.01, atol=1e-9)
    assert [one.name for one in tmp_path.iterdir()] == ["a.parquet"]


# ---- A guide


class Operator(Screen):
    """Reads the screen and does what it asks for, with a simulated device in its hands."""

    def __init__(self, hands: HandHeld) -> None:
        self.hands, self.said = hands, list[str]()

    def say(self, *lines: str) -> None:
        self.said += lines

    def over(self, line: str, *, step: int | None = None, last: bool = False) -> None:
        if self.said[-1:] != [line.rpartition("\n")[0]]:
            self.said.append(line.rpartition("\n")[0])
        if self.hands.moving:
            return
        if found := re.search(r"(?:Turn|Lay it with) ([+-][xyz]) up", line):
            self._lay(found[1])
        elif found := re.search(r"Turn it once (counter-)?clockwise", line):
            self.hands.turn(self.hands.face[1], math.copysign(2.0 * math.pi, 1.0 if found[1] else -1.0))

    def _lay(self, face: Face) -> None:
        if face != self.hands.face:
            self.hands.lay(face)


@pytest.fixture
def held() -> Iterator[tuple[PrintingBoard, Operator]]:
    ended = threading.Event()
    with HandHeld(seed=3, clock=Clock.started(HELD_SPEED)) as hands, PrintingBoard(patience_s=1.0) as board:

        def send() -> None:
            while not ended.wait(0.02):
                counts, rows = hands.read()
                lines = (
                    sketch_line(int(k), round(k * 1e4), row[:3], row[3:6], row[6])
                    for k, row in zip(counts, rows, strict=True)
                )
                board.write(b"".join(lines))

        sender = threading.Thread(target=send)
        sender.start()
        yield board, Operator(hands)
        ended.set()
        sender.join()


@pytest.mark.slow
def test_from_a_port_to_a_verdict(tmp_path, held, monkeypatch):
    board, operator = held
    monkeypatch.setattr(sys.modules["undrift.commands.record"], "LOOK_S", 0.05)
    began = time.monotonic()
    address, path = f"{board.port}?clock_speed={HELD_SPEED:g}", tmp_path / "bench.parquet"
    with showing_on(operator):
        made = recording(address, output=path, guide="turns", place=Place(gravity_m_s2=9.80665), duration_s=900.0)
    assert "recording" in made.data, (made.answer, operator.said[-20:])
    took_s = time.monotonic() - began
    seconds = made.data["recording"]["seconds"]
    listened_s = took_s - seconds / HELD_SPEED
    command = "undrift record PORT -o bench.parquet --guide turns"
    show(
        "from a port to a verdict",
        f"1 command ({command}), {seconds:.0f} s of the device and {listened_s:.1f} s beside",
    )
    assert made.status in ("good", "marginal"), made.findings
    assert made.data["gyro"]["method"]
    assert made.data["recording"]["ended"] == "guide"
    session = read_session(tmp_path / "bench")
    assert len([still for still in session.stills if still.face]) == 6
    assert len(session.turns) == 6
    assert {one.name for one in tmp_path.iterdir()} == {"bench", "bench.json", "bench.parquet"}
    assert operator.said[1].startswith("Recording serial:")
    assert [one.split(":")[0] for one in operator.said[2:4]] == ["Faces", "Turns"]  # how it is done
    assert operator.said[4].startswith("Faces: 0 of 6\n"), operator.said[:6]
    assert "Faces: 1 of 6\n+z is captured. Turn +x up." in operator.said
    assert operator.said[-2] == "Turns: 6 of 6\nCaptured: about z, clockwise. All turns are captured."
    calibration = read_calibration(tmp_path / "bench.json")
    assert calibration.device == ""  # no name was printed
    true = true_calibration(operator.hands.device, temp_c=25.0)
    for found, wanted in ((calibration.accel, true.accel), (calibration.gyro, true.gyro)):
        np.testing.assert_allclose(np.diag(found.matrix), np.diag(wanted.matrix), rtol=0.01)
