"""A card and one client, with emulated time in hand."""

import math

from testkit.emulated.axes import ServoSettings
from testkit.emulated.galil_card import CardSettings
from testkit.emulated.galil_language import GalilMachine
from testkit.emulated_axis import present
from undrift.base.clock import VirtualClock


class GalilBench:
    def __init__(self, servo: ServoSettings | None = None, serial: bool = False, **card):
        self.clock = VirtualClock()
        self.machine = GalilMachine(servo or ServoSettings(), CardSettings(**card), self.clock, 100.0)
        self.session = self.machine.open_session(serial=serial)
        self.card = self.machine.card

    def say(self, line: str, wait_s: float = 0.0) -> str:
        """Wait, send a line and return the answer."""
        self.clock.wait(wait_s)
        return b"".join(self.session.feed(line.encode("latin-1") + b"\r")).decode("latin-1")

    def number(self, line: str) -> float:
        return float(self.say(line).strip(" \r\n:"))

    def code(self) -> int:
        return int(self.say("TC0").strip(" \r\n:"))

    def rate_dps(self) -> float:
        return math.degrees(present(self.machine)[1])

    def mean_dps(self) -> float:
        """Return the mean rate of the last 0.2 s: single counts make the loop ripple by 2 deg/s."""
        time, angle = self.machine.history(0.2)
        return math.degrees(angle[-1] - angle[0]) / (time[-1] - time[0])

    def heard(self) -> bytes:
        self.machine.tick()
        return self.session.unasked()
