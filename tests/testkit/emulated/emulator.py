"""Emulator: a rig that does not exist, on a real socket; and a bench: table, chamber and device together, on one clock.

The hands are a socket of their own: ``MOUNT +x`` is answered by ``OK +x``, ``FACE?`` by the face that points up. The chamber's
language is read by a parser of its own: words joined by colons, commands by semicolons, a line ends with LF. Its air and board::

    r'  = the set-point's way, at most the ramp     what the controller follows
    T'' = w^2 (r - T) - 2 z w T'                    air: second order, overshoots
    B'  = (T - B) / lag                             board of the device

Off, the air goes to the room's temperature with a time constant of its own; so it does, faster, with the door open. A stuck heater
leaves r where it is and drifts up. Each step of time is solved with the trapezoidal rule for the air and exactly for the board.
"""

import contextlib
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, cast, get_args

import numpy as np

from testkit.emulated.axes import MotorAxis, ServoSettings
from testkit.emulated.galil_card import CardSettings
from testkit.emulated.galil_language import GalilMachine
from testkit.emulated.grbl import GrblMachine, GrblSettings
from testkit.emulated.server import LINK_FAULTS, Closed, FaultyLink, LineMachine, Served, server_of
from testkit.emulated.stream import EmulatedDevice, StreamSettings
from undrift.arrays import FloatArray
from undrift.base.clock import HOST, Clock
from undrift.errors import InputError, RigError, RigFault, check_positive
from undrift.live.transports import host_and_port
from undrift.record import MountedFace
from undrift.rig.link import Link, LinkSettings
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device

# ---- Emulated rig

RIG_FAULTS = {
    "amplifier_fault": "no torque while it lasts; with OE1 the card switches the motor off, SC 8; else the error grows",
    "encoder_loss": "the count freezes and the axis runs away, until the error passes ER with OE1: motor off, SC 8",
    "limit_switch": "the forward switch closes: a forward motion slows to rest, SC 2; BG forward is refused with TC 22",
    "limit_switch_reverse": "the reverse switch closes: a reverse motion slows to rest, SC 3; BG back is refused with TC 22",
    "abort_input": "the motion ends at once, SC 6; with OE1 the motor is switched off",
    "power_cut": "sockets close, none is accepted, the axis coasts to rest by friction; cleared, the card starts afresh",
    "message": "the card sends a line that nobody asked for, once",
}


EmulatorKind = Literal["galil", "grbl"]
LOOPBACK = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True, slots=True, kw_only=True)
class EmulatorSettings:
    """What is emulated, and where it listens."""

    kind: EmulatorKind = "galil"  # galil (a servo card) or grbl (a stepper board)
    servo: ServoSettings = field(default_factory=ServoSettings)  # Loop of the servo card
    card: CardSettings = field(default_factory=CardSettings)  # The servo card
    grbl: GrblSettings = field(default_factory=GrblSettings)  # The stepper board
    host: str = "127.0.0.1"  # A loopback address
    port: int = 0  # 0 takes a free one
    with_pty: bool = False  # True opens a pseudo terminal as well
    speed: float = 1.0  # Emulated seconds in one of the host's
    history_s: float = 1200.0  # How far back the axis is remembered, emulated s


class Emulator(Served):
    """A running rig; a context manager that closes it."""

    faults = RIG_FAULTS

    def __init__(self, settings: EmulatorSettings = EmulatorSettings(), clock: Clock | None = None) -> None:
        if settings.kind not in get_args(EmulatorKind):
            wanted = " or ".join(get_args(EmulatorKind))
            raise InputError(f"emulator kind: wanted {wanted}, got '{settings.kind}'; name one of them")
        if settings.host not in LOOPBACK:
            raise InputError(
                f"emulator host: wanted one of {', '.join(LOOPBACK)}, got '{settings.host}'; it serves this computer only"
            )
        MotorAxis(settings.servo, 1.0).warm()
        chosen = clock or Clock.started(settings.speed)
        self.settings, self.clock = settings, chosen
        self.machine: GalilMachine | GrblMachine = (
            GalilMachine(settings.servo, settings.card, chosen, settings.history_s)
            if settings.kind == "galil"
            else GrblMachine(settings.grbl, chosen, settings.history_s)
        )
        self.serve(self.machine, (settings.host, settings.port), 0, settings.with_pty)
        self.pty_path: str | None = self._server.pty_path

    def now(self) -> float:
        """Return emulated time from the start, s."""
        return self.clock.now()

    @property
    def motor_on(self) -> bool:
        """Whether the motor holds the axis."""
        return self.machine.motor_on

    def axis_states(self, times: FloatArray, *, mean_s: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return the true angle and turn rate at moments of the past: times (n,) s -> (n,) rad."""
        if not mean_s > 0.0:
            return self.machine.states(times)
        before = np.maximum(times - mean_s, 0.0)  # the axis rested before it was made
        angle, _ = self.machine.states(np.concatenate((times, before)))
        return angle[: len(times)], (angle[: len(times)] - angle[len(times) :]) / mean_s

    def history(self, last_s: float | None = None) -> tuple[FloatArray, FloatArray]:
        """Return where the axis has been, (n,) s."""
        return self.machine.history(last_s)

    def set_fault(self, fault: str, on: bool) -> None:
        """Break or mend a part; after a power cut the rig starts afresh."""
        self.machine.set_fault(fault, on)
        if fault == "power_cut":
            self._server.dark = on


# ---- The air of an emulated chamber and the board in it.

STEP_S = 0.5
OFF_S = 1200.0  # time constant of a chamber that is off, s
DOOR_S = 60.0
STUCK_C_PER_MIN = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class AirSettings:
    """How the air moves."""

    room_c: float = 25.0  # Temperature around, and at the start, degC
    ramp_c_per_min: float = 3.0  # Steepest change of the controller's own set-point, K/min
    period_s: float = 120.0  # 2 pi / w, s
    damping: float = 0.6  # z; below 1 overshoots
    board_lag_s: float = 60.0  # Time constant of the device's board, s

    def __post_init__(self) -> None:
        check_positive(self, "emulated chamber", "state it", "ramp_c_per_min", "period_s", "damping", "board_lag_s")


class Air:
    """Air and board, advanced when someone looks."""

    def __init__(self, settings: AirSettings) -> None:
        self.settings = settings
        self.set_point = self.aim = settings.room_c
        self.ramp_c_per_min = settings.ramp_c_per_min
        self.on = self.stuck = self.door_open = False
        self.speed = 0.0
        self.time, self.temp, self.board = [0.0], [settings.room_c], [settings.room_c]

    def advance(self, time: float) -> None:
        """Go on to a moment, or a step beyond it."""
        while self.time[-1] < time:
            temp = self._next(self.temp[-1])
            keep = math.exp(-STEP_S / self.settings.board_lag_s)
            mean = (1.0 - keep) * self.settings.board_lag_s / STEP_S  # weight of where the air comes from and goes to
            board = keep * self.board[-1] + (mean - keep) * self.temp[-1] + (1.0 - mean) * temp
            self.time.append(self.time[-1] + STEP_S)
            self.temp.append(temp)
            self.board.append(board)

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return air and board at moments that have been reached: times (n,) s -> (n,) degC."""
        first = max(min(int(float(times[0]) / STEP_S) - 1, len(self.time) - 2), 0)
        last = int(float(times[-1]) / STEP_S) + 3
        grid = self.time[first:last]
        return np.interp(times, grid, self.temp[first:last]), np.interp(times, grid, self.board[first:last])

    def _next(self, temp: float) -> float:
        if self.door_open or not self.on:
            keep = math.exp(-STEP_S / (DOOR_S if self.door_open else OFF_S))
            after = self.settings.room_c + (temp - self.settings.room_c) * keep
            self.aim, self.speed = after, (after - temp) / STEP_S
            return after
        reach = self.ramp_c_per_min / 60.0 * STEP_S
        wanted = self.aim + STUCK_C_PER_MIN / 60.0 * STEP_S if self.stuck else self.set_point
        self.aim += min(max(wanted - self.aim, -reach), reach)
        w = 2.0 * math.pi / self.settings.period_s
        h, damp = STEP_S / 2.0, 2.0 * self.settings.damping * w
        speed = (self.speed * (1.0 - h * damp - h * h * w * w) + 2.0 * h * w * w * (self.aim - temp)) / (
            1.0 + h * damp + h * h * w * w
        )
        after = temp + h * (self.speed + speed)
        self.speed = speed
        return after


# ---- An emulated thermal chamber on a loopback socket, with faults.

CHAMBER_FAULTS = {
    "stuck_heater": "the heater no longer follows the set-point; the air creeps up by 0.5 K/min",
    "open_door": "the air goes to the room's temperature with a time constant of 60 s",
}
LOWEST_C, HIGHEST_C, STEEPEST_C_PER_MIN = -40.0, 130.0, 600.0
IDENTITY = "undrift,emulated chamber,0,1.0"
NO_ERROR = '0,"No error"'


class EmulatedChamber(Served, LineMachine):
    """A chamber that listens until closed."""

    faulty, faults = "chamber fault", CHAMBER_FAULTS

    def __init__(self, settings: AirSettings, clock: Clock, host: str = "127.0.0.1", port: int = 0) -> None:
        LineMachine.__init__(self, clock, self.obey)
        self.air = Air(settings)
        self._errors: deque[str] = deque(maxlen=16)
        self.serve(self, (host, port), 0)
        self.address = f"tcp://{self.host}:{self.port}"

    def tick(self) -> None:
        """Bring the air up to now."""
        with self.lock:
            self.air.advance(self.clock.now())

    def board_temp(self, times: FloatArray) -> FloatArray:
        """Return the temperature of the device's board at moments up to now: times (n,) s -> (n,) degC."""
        with self.lock:
            self.air.advance(float(times[-1]))
            return self.air.at(times)[1]

    def set_fault(self, fault: str, on: bool) -> None:
        """Break or mend a part."""
        setattr(self.air, "stuck" if fault == "stuck_heater" else "door_open", on)

    def obey(self, line: str) -> str:
        """Do what a line says."""
        with self.lock:
            self.air.advance(self.clock.now())
            answers = [self._obey_one(command.strip().removeprefix(":")) for command in line.split(";")]
        return ";".join(answer for answer in answers if answer)

    def _obey_one(self, command: str) -> str:
        word, _, value = command.upper().partition(" ")
        asked: dict[str, Callable[[], str]] = {
            "*IDN?": lambda: IDENTITY,
            "TEMP:SPO?": lambda: f"{self.air.set_point:.1f}",
            "TEMP:RAMP?": lambda: f"{self.air.ramp_c_per_min:.2f}",
            "MEAS:TEMP?": lambda: f"{self.air.at(np.array([self.clock.now()]))[0][0]:.2f}",
            "OUTP?": lambda: str(int(self.air.on)),
            "SYST:ERR?": lambda: self._errors.popleft() if self._errors else NO_ERROR,
        }
        if word in asked:
            return asked[word]()
        if word == "TEMP:SPO":
            self.air.set_point = self._number(value, LOWEST_C, HIGHEST_C, self.air.set_point)
        elif word == "TEMP:RAMP":
            self.air.ramp_c_per_min = self._number(value, 0.01, STEEPEST_C_PER_MIN, self.air.ramp_c_per_min)
        elif word == "OUTP" and value.strip() in ("ON", "OFF", "1", "0"):
            self.air.on = value.strip() in ("ON", "1")
        elif word:
            self._errors.append('-113,"Undefined header"')
        return ""

    def _number(self, text: str, low: float, high: float, held: float) -> float:
        try:
            value = float(text)
        except ValueError:
            self._errors.append('-104,"Data type error"')
            return held
        if not low <= value <= high:
            self._errors.append('-222,"Data out of range"')
            return held
        return value


# ---- bench

HANDS_TIMEOUT_S = 30.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EmulatedBenchSettings:
    """What is emulated."""

    rig: EmulatorSettings = field(default_factory=EmulatorSettings)  # The table; its speed is that of the whole bench
    air: AirSettings = field(default_factory=AirSettings)  # The chamber
    stream: StreamSettings = field(default_factory=StreamSettings)  # How the device is mounted and sends
    device: DeviceModel | None = None  # The hidden truth; None draws one of consumer grade from the stream's seed
    others: tuple[DeviceModel, ...] = ()  # More devices on the table, mounted alike
    hands_port: int = 0  # Where the hands listen; 0 takes a free one


class EmulatedBench(Closed):
    """A running bench; a context manager that closes it."""

    def __init__(self, settings: EmulatedBenchSettings, clock: Clock | None = None) -> None:
        self.settings = settings
        chosen = settings.device or random_device(np.random.default_rng(settings.stream.seed), grade="consumer")
        self.device: DeviceModel = chosen
        with contextlib.ExitStack() as opened:
            self.rig: Emulator = opened.enter_context(Emulator(settings.rig, clock))
            host = settings.rig.host
            self.chamber = EmulatedChamber(settings.air, self.rig.clock, host)
            opened.callback(self.chamber.close)
            self.streams: list[EmulatedDevice] = []
            for k, device in enumerate((chosen, *settings.others)):
                sent = replace(settings.stream, seed=settings.stream.seed + k, port=settings.stream.port * (not k))
                self.streams.append(EmulatedDevice(device, self.rig, self.chamber.board_temp, self.rig.clock, sent))
                opened.callback(self.streams[-1].close)
            self.stream = self.streams[0]
            operator = LineMachine(self.rig.clock, self._mounted)
            hands = server_of(operator, FaultyLink(operator.clock), (host, settings.hands_port))
            opened.callback(hands.close)
            self._opened = opened.pop_all()
        options = f"?clock_speed={settings.rig.speed!r}"
        if settings.rig.kind == "galil":
            options += f"&encoder_lines={settings.rig.servo.encoder_lines}"
        self.rig_address = f"{settings.rig.kind}:tcp://{self.rig.host}:{self.rig.port}{options}"
        self.device_addresses = [stream.address(settings.rig.speed) for stream in self.streams]
        self.device_address = self.device_addresses[0]
        self.chamber_address = self.chamber.address
        self.hands_address = f"tcp://{hands.host}:{hands.port}"
        path = self.rig.pty_path
        self.pty_address = None if path is None else f"{settings.rig.kind}:serial://{path}{options}"

    def break_as(self, planned: "PlannedFault") -> None:
        """Break a part when its time has come, and mend it again; waits for both."""
        part: Served = self.chamber if planned.name in CHAMBER_FAULTS else self.rig
        self.rig.clock.wait(planned.after_s)
        part.inject(planned.name)
        if planned.for_s is not None:
            self.rig.clock.wait(planned.for_s)
            part.clear(planned.name)

    def mount(self, face: MountedFace) -> None:
        """Mount the devices with another face up."""
        for stream in self.streams:
            stream.mount(face)

    def close(self) -> None:
        """Close every socket and end every thread; harmless when called again."""
        self._opened.close()

    def _mounted(self, line: str) -> str:
        """Do what the hands are asked."""
        if line == "FACE?":
            return str(self.stream.face)
        word, _, face = line.partition(" ")
        if word != "MOUNT":
            raise InputError("hands: wanted MOUNT +x or FACE?, got another word; say one of them")
        self.mount(cast(MountedFace, face))
        return f"OK {face}"


ALL_FAULTS = LINK_FAULTS | RIG_FAULTS | CHAMBER_FAULTS


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedFault:
    """A fault that comes by itself."""

    name: str  # One of ALL_FAULTS
    after_s: float = 0.0  # From the start, emulated s
    for_s: float | None = None  # None: until the end


def planned_fault(text: str) -> PlannedFault:
    """Read NAME, NAME:AFTER_S or NAME:AFTER_S:FOR_S."""
    name, *times = text.split(":")
    try:
        after, last = ([float(part) for part in times] + [0.0, math.inf][len(times) :])[:2]
        if name in ALL_FAULTS and len(times) <= 2 and 0.0 <= after < math.inf and last > 0.0:
            return PlannedFault(name=name, after_s=after, for_s=None if last == math.inf else last)
    except ValueError:
        pass
    raise InputError(
        f"fault: wanted NAME, NAME:AFTER_S or NAME:AFTER_S:FOR_S with a name out of {', '.join(ALL_FAULTS)}, got '{text}'; "
        "`fault` list explains them"
    )


class BenchHands:
    """Hands of an emulated bench in another process, as a run asks for them."""

    def __init__(self, address: str, clock: Clock = HOST) -> None:
        if not address.startswith("tcp:") or not all(host_and_port(address.removeprefix("tcp:"))):
            raise InputError(f"hands: wanted tcp://host:port, got '{address}'; rig emulate prints it")
        self._address, self._waits = address, LinkSettings(reply_timeout_s=HANDS_TIMEOUT_S, clock=clock.host)

    def mount(self, up: MountedFace) -> None:
        """Have the device mounted."""
        try:
            with Link(self._address, self._waits) as link:
                answer = link.exchange(f"MOUNT {up}").strip()
        except RigError as error:
            raise RigFault(f"hands: wanted {up} up, got '{error}'; is the emulated bench running?") from error
        if answer != f"OK {up}":
            raise RigFault(f"hands: wanted {up} up, got '{answer}'; mount it with a face that there is")
