"""Fake controllers for the tests of the rig's drivers: a Galil card and a GRBL board, as functions from a command to its answer.

`Card` and `Board` believe everything, move at once, and can be told to answer badly. `TurningCard` and `TurningBoard` turn the
table of a simulated bench, in the bench's time: whole runs go through a driver and over its wire.
"""

import abc
import math
import re

from testkit.scripted_server import Scripted
from undrift.rig.simulated import SimulatedBench
from undrift.sim.servo import Servo

# ---- Galil


class Controller(abc.ABC):
    """What answers commands, and can be told to answer badly."""

    def __init__(self) -> None:
        self.spoilt: dict[str, list[bytes | None]] = {}  # answers to the next commands that begin so

    def __call__(self, command: str) -> bytes | None:
        for start, answers in self.spoilt.items():
            if command.startswith(start) and answers:
                return answers.pop(0)
        return self.answer(command)

    @abc.abstractmethod
    def answer(self, command: str) -> bytes | None:
        """Return what follows a command on the line."""


def turn(servo: Servo, way: float, speed: float, acceleration: float) -> None:
    """Turn by a way with ramps, in counts: at most at a speed, and at less if the way is too short for it."""
    speed = min(speed, math.sqrt(abs(way) * acceleration))
    servo.turn(math.copysign(speed, way), abs(way) / speed + speed / acceleration, acceleration)


class Card(Controller):
    """A card that accepts everything: settings are read back, a move ends after some polls, and answers can be spoilt."""

    def __init__(self, polls: int = 1) -> None:
        super().__init__()
        self.held = {
            "AC": "256000",
            "DC": "256000",
            "MO": "1",
            "TP": "0",
            "TE": "0",
            "SC": "1",
            "TS": "44",
            "TM": "1000",
        }
        self.polls, self.moving, self.code = polls, 0, 0

    def answer(self, command: str) -> bytes:
        if command == "TC1":
            return f"{self.code} Some words\r\n:".encode()
        if command == "\x12\x16":
            return b"DMC1415 Rev 1.0u\r\n:"
        if result := re.fullmatch(r"MG (\d+)", command):
            return f" {result.group(1)}.0000\r\n:".encode()
        if command == "MG _BGX":
            return f" {int(self.poll())}.0000\r\n:".encode()
        if result := re.fullmatch(r"MG _([A-Z]{2})X?", command):
            return f" {float(self.held[result.group(1)]):.4f}\r\n:".encode()
        if result := re.fullmatch(r"MG _(TP|TE)X\{F10.0\}", command):
            return f"{int(self.held[result.group(1)]): 011d}\r\n:".encode()
        if result := re.fullmatch(r"(TS|SC)X", command):
            return f" {int(self.held[result.group(1)]):03d}\r\n:".encode()
        if result := re.fullmatch(r"([A-Z]{2}) \?", command):
            return f" {float(self.held[result.group(1)]):.4f}\r\n:".encode()
        if result := re.fullmatch(r"([A-Z]{2}) (-?[\d.]+)", command):
            self.held[result.group(1)] = result.group(2)
            return b":"
        return self.act(command)

    def poll(self) -> bool:
        """Return whether a move runs."""
        self.moving = max(self.moving - 1, 0)
        return self.moving > 0

    def act(self, command: str) -> bytes:
        if command == "SHX":
            self.held["MO"] = "0"
        elif command == "MOX":
            self.held["MO"] = "1"
        elif command == "BGX":
            self.moving = self.polls
            if "PR" in self.held:
                self.held["TP"] = str(int(self.held["TP"]) + int(self.held["PR"]))
        elif command in ("STX", "AB"):
            self.moving = 0
        else:
            self.code = 1
            return b"?"
        return b":"


class TurningCard(Card):
    """A card that turns the table of a simulated bench. Each move takes its time and ends by itself.

    ``fault`` is ``limit_switch`` (the forward switch), ``abort_input`` or ``stall`` (of the amplifier: the axis coasts).
    """

    def __init__(self, bench: SimulatedBench) -> None:
        super().__init__()
        self.bench, self.fault, self.server = bench, "", Scripted(self, bench.clock)
        self.address = f"galil:{self.server.url}"
        self.start()

    def start(self) -> None:
        """Forget all that was set, as after a power cut."""
        kp, kd = self.bench.servo.settings.gains
        period_us = 1e6 * self.bench.servo.settings.period_s
        self.held = {"AC": "256000", "DC": "256000", "TM": f"{period_us:.0f}", "KP": str(kp), "KI": "0", "KD": str(kd)}
        self.on, self.why = False, 1

    def answer(self, command: str) -> bytes:
        bench, servo = self.bench, self.bench.servo
        bench.advance()
        servo.powered &= self.fault != "stall"
        if self.fault in ("limit_switch", "abort_input") and servo.moving:
            self.act("STX" if self.fault == "limit_switch" else "AB")
            self.why = 2 if self.fault == "limit_switch" else 6
        if self.on and not servo.powered:  # the amplifier failed: the following error passed its limit
            self.on, self.why = False, 8
        switches = 0x0C - 0x08 * (self.fault == "limit_switch") + 0x20 * (not servo.powered)
        self.held |= {"TP": str(servo.count), "TE": str(round(servo.error)), "MO": str(int(not servo.powered))}
        self.held |= {"TS": str(switches), "SC": str(0 if servo.moving else self.why)}
        return super().answer(command)

    def poll(self) -> bool:
        return self.bench.servo.moving

    def act(self, command: str) -> bytes:
        servo = self.bench.servo
        if command == "MOX" and servo.moving:
            return self.refuse(7)
        if command in ("SHX", "MOX"):
            self.on = command == "SHX"
            servo.switch(self.on)
        elif command == "BGX":
            way = int(self.held["PR"])
            if not servo.powered or (way > 0 and self.fault == "limit_switch"):
                return self.refuse(22 if servo.powered else 20)
            self.why = 1
            turn(servo, way, float(self.held["SP"]), float(self.held["AC"]))
        elif command == "STX":
            servo.slow_down(float(self.held["DC"]))
            self.why = 4
        elif command == "AB":
            servo.switch(servo.powered)
            self.why = 7
        else:
            return super().act(command)
        return b":"

    def refuse(self, code: int) -> bytes:
        self.code = code
        return b"?"


# ---- GRBL


class Board(Controller):
    """A board with a rotary axis whose jogs end immediately, and that answers badly on request."""

    def __init__(self) -> None:
        super().__init__()
        self.settings = {"100": "8.889", "110": "2160000.000", "120": "1000.000"}
        self.state = "Idle"
        self.place = 0.0
        self.jogs: list[tuple[float, float]] = []
        self.stays = 0
        self.wakes_to = "Idle"

    def answer(self, command: str) -> bytes | None:
        if command == "?":
            self.stays = max(self.stays - 1, 0)
            if self.state == "Jog" and not self.stays:
                self.state = "Idle"
            return f"<{self.state}|MPos:{self.place:.3f}|FS:0,0>\r\n".encode()
        if command == "\x18":
            was, self.state = self.state, self.wakes_to
            if was == "Sleep":
                self.state = "Alarm"
            return b"\r\nGrbl 1.1h ['$' for help]\r\n"
        if command == "\x85":
            self.state = "Idle"
            return None
        return self.line(command)

    def line(self, command: str) -> bytes:
        if result := re.fullmatch(r"\$J=G91G21A(-?[\d.]+)F([\d.]+)", command):
            if self.state in ("Alarm", "Door", "Sleep"):
                return b"error:9\r\n"
            self.jogs.append((float(result.group(1)), float(result.group(2))))
            self.place += self.jogs[-1][0]
            self.state, self.stays = "Jog", 3
            return b"ok\r\n"
        if command == "$$":
            return "".join(f"${n}={v}\r\n" for n, v in self.settings.items()).encode() + b"ok\r\n"
        if command == "$I":
            return b"[VER:1.1h.20190830:]\r\n[OPT:V,15,128]\r\nok\r\n"
        if result := re.fullmatch(r"\$(\d+)=([\d.]+)", command):
            self.settings[result.group(1)] = result.group(2)
            return b"ok\r\n"
        if command == "$SLP":
            self.state = "Sleep"
            return b"ok\r\n"
        if command == "$X":
            self.state = "Idle"
            return b"[MSG:Caution: Unlocked]\r\nok\r\n"
        return b"error:3\r\n"


class TurningBoard(Board):
    """A board that turns the table of a simulated bench with finite jogs. Each jog takes its time and ends by itself."""

    def __init__(self, bench: SimulatedBench) -> None:
        super().__init__()
        self.bench, self.fault = bench, ""
        self.server = Scripted(self, bench.clock, terminator=b"\n", at_once="?!~\x18\x85")
        self.address = f"grbl:{self.server.url}"

    def __call__(self, command: str) -> bytes | None:
        bench, servo = self.bench, self.bench.servo
        bench.advance()
        self.place, self.stays = math.degrees(bench.angle()), 2 * servo.moving
        answer = super().__call__(command)
        if command == "\x18" or command == "$X":
            servo.switch(True)
        elif command == "\x85":
            self.state = "Jog" if servo.moving else "Idle"
            servo.slow_down(float(self.settings["120"]) / 360.0 * self.counts_per_turn)
        elif command == "$SLP":
            servo.switch(False)
        elif command.startswith("$J="):
            distance, deg_per_min = self.jogs[-1]
            per_deg = self.counts_per_turn / 360.0
            turn(servo, distance * per_deg, deg_per_min / 60.0 * per_deg, float(self.settings["120"]) * per_deg)
        return answer

    @property
    def counts_per_turn(self) -> float:
        return 2.0 * math.pi * self.bench.servo.settings.counts_per_rad
