"""The emulated card and a client that is not ours: a motor record as control systems keep one, written from the command reference.

It shares nothing with the driver: several commands in a line, a prompt for each; axis A by name; states by MG of many operands;
TC1 after a refusal; what the card says by itself told apart by its high bit; a program downloaded, started and polled.
"""

import contextlib
import math
import re
import socket
import threading
import time

import pytest

from testkit.data import show
from testkit.emulated_axis import present
from undrift.sim.rig.emulator import Emulator, EmulatorSettings
from undrift.sim.rig.galil_card import CardSettings


class Refusal(Exception):
    """The card said `?`; the text is what TC1 told."""


class Controller:
    """A connection: lines out, answers and messages in."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=60.0)
        self._held = b""
        self.messages = ""
        self.command("EO 0")
        self.command("CW 1")  # messages have their high bit set from now on
        self.command("CFI")
        (self.model,) = self.command("\x12\x16")

    def close(self) -> None:
        self._socket.close()

    def command(self, *commands: str) -> list[str]:
        """Send commands in one line; return the text of each answer."""
        self._socket.sendall(";".join(commands).encode("latin-1") + b"\r")
        answers = []
        for _ in commands:
            text, prompt = self._answer()
            if prompt == "?":  # the rest of the line is dropped
                self._socket.sendall(b"TC1\r")
                raise Refusal(self._answer()[0])
            answers.append(text)
        return answers

    def values(self, *operands: str) -> list[float]:
        """Return operands that one MG tells; a minus sign stands where the blank before a number would."""
        (text,) = self.command("MG " + ",".join(operands))
        return [float(word) for word in re.findall(r"-?\d+\.\d+", text)]

    def download(self, *lines: str) -> None:
        self._socket.sendall(b"DL\r" + "\r".join(lines).encode() + b"\r\\")
        assert self._answer() == ("", ":")

    def _answer(self) -> tuple[str, str]:
        answer = ""
        while True:
            while not self._held:
                self._held = self._socket.recv(4096)
                assert self._held, "the card hung up"
            byte, self._held = self._held[0], self._held[1:]
            if byte & 0x80:
                self.messages += chr(byte & 0x7F)
            elif chr(byte) in ":?":
                return answer.strip(), chr(byte)
            else:
                answer += chr(byte)


class Motor:
    """A motor record: VAL, RBV, DMOV, MSTA, STOP, HOMR, in degrees."""

    def __init__(self, controller: Controller, counts_per_turn: int) -> None:
        self.controller, self.resolution_deg = controller, 360.0 / counts_per_turn
        (kind,) = controller.values("_MTA")
        assert kind in (1.0, -1.0)  # a servo
        controller.command("SPA=20000", "ACA=1024000", "DCA=1024000", "ERA=2000", "OEA=1", "SHA")

    def poll(self) -> dict[str, float]:
        names = ("_TPA", "_RPA", "_TEA", "_BGA", "_TSA", "_SCA", "_LFA", "_LRA", "_HMA", "_MOA")
        seen = dict(zip(names, self.controller.values(*names), strict=True))
        return {"rbv": seen["_TPA"] * self.resolution_deg, "dmov": 1.0 - seen["_BGA"]} | seen

    def move(self, target_deg: float) -> None:
        counts = round(target_deg / self.resolution_deg)
        self.controller.command(f"PAA={counts}", "BGA")

    def wait(self, within_s: float = 60.0) -> dict[str, float]:
        last = time.monotonic() + within_s
        while not (state := self.poll())["dmov"]:
            assert time.monotonic() < last, state
            time.sleep(0.01)
        time.sleep(0.02)  # DLY, the settling time of a motor record: 0.4 s of the card
        return self.poll()


@pytest.fixture
def emulator():
    settings = EmulatorSettings(speed=20.0, card=CardSettings())
    with Emulator(settings) as running:
        yield running


@pytest.fixture
def motor(emulator):
    controller = Controller(emulator.host, emulator.port)
    with contextlib.closing(controller):
        yield Motor(controller, 40_000)


def test_it_moves_reads_back_and_stops(emulator, motor):
    assert motor.controller.model.startswith("DMC")
    motor.move(45.0)
    state = motor.wait()
    assert state["rbv"] == pytest.approx(45.0, abs=2 * motor.resolution_deg)
    assert (state["_SCA"], state["_RPA"], int(state["_TSA"]) & 0x20) == (1, 5000, 0)
    motor.controller.command("JGA=-4000", "BGA")
    assert motor.poll()["_SCA"] == 0
    motor.controller.command("STA")
    assert motor.wait()["_SCA"] == 4
    angle = math.degrees(present(emulator.machine)[0])
    assert motor.poll()["rbv"] == pytest.approx(angle, abs=2 * motor.resolution_deg)


def test_a_refusal_is_told_in_words_and_drops_the_rest_of_its_line(motor):
    motor.controller.command("MOA")
    with pytest.raises(Refusal, match="20 Begin not valid with motor off"):
        motor.controller.command("PRA=100", "BGA", "SHA")
    assert motor.controller.values("_MOA") == [1.0]
    with pytest.raises(Refusal, match="1 Unrecognized command"):
        motor.controller.command("foo")
    assert motor.controller.command("TC1") == ["0"]


def test_what_the_card_says_by_itself_does_not_get_into_answers(motor):
    motor.controller.download("#TELL", 'MG "AT",_TPA{F6.0}', "N=N+1", "WT 50", "JP #TELL,(N<20)", "EN")
    motor.move(10.0)
    motor.wait()
    motor.controller.command("N=0", "XQ #TELL,0")
    while motor.controller.values("_HX0")[0]:
        motor.poll()
    motor.poll()  # what came last
    assert motor.controller.messages.count("AT") == 20
    assert motor.controller.messages.endswith("001111\r\n")


def test_many_clients_poll_while_one_moves(emulator, motor):
    polled: list[float] = []
    ended = threading.Event()

    def poll() -> None:
        with contextlib.closing(Controller(emulator.host, emulator.port)) as controller:
            while not ended.is_set():
                polled.extend(controller.values("_TPA"))
                time.sleep(0.01)

    threads = [threading.Thread(target=poll) for _ in range(4)]
    for thread in threads:
        thread.start()
    for target in (90.0, -90.0, 0.0):
        motor.move(target)
        motor.wait()
        enough, last = len(polled) + 2 * len(threads), time.monotonic() + 60.0
        while len(polled) < enough and time.monotonic() < last:  # one of them was asked after the move
            time.sleep(0.01)
    ended.set()
    for thread in threads:
        thread.join(60.0)
    show("positions polled beside a move", len(polled))
    assert max(polled) > 9000
    assert min(polled) < -9000
    assert motor.poll()["rbv"] == pytest.approx(0.0, abs=2 * motor.resolution_deg)
