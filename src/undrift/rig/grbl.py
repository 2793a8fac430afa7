"""GRBL boards: a stepper axis by jogs and status reports.

GRBL 1.1, grblHAL, FluidNC: a stepper-driven rotary axis, jogged by finite moves.

`$J=G91A<deg>F<deg/min>` turns by an angle and can be cancelled at any time. A steady rate is a chain of such jogs, each a whole
number of steps (`$100` and its neighbours, steps per degree), a second or so of them queued: if this program dies, the table stops
by itself when the queue is empty. There is no encoder, so what was commanded counts as achieved, and there is no following error.

One axis of a GRBL controller in degrees: its settings, where it is, jogs, and bringing it to rest.

Waking up is a reset; an alarm that a reset in our own motion or our own sleep leaves behind is cleared with ``$X``, any other alarm
stays for a person to look at.

The language of GRBL 1.1 (grblHAL, FluidNC): lines answered by ``ok`` or ``error:n``, and single characters that act at once.

``?`` asks for the status, ``!`` holds, 0x85 ends a jog, 0x18 resets. Alarms come by themselves, between answers.

A steady rate out of finite jogs: one is sent whenever less than a while's worth is queued.

The controller's planner joins jogs of one direction and rate without slowing down, as long as the queue reaches further than it
needs to stop. Whoever feeds it can die: the queue ends and the table comes to rest by itself.

What GRBL 1.1 says, in words: error codes, alarms, and its status line.

The numbers are those of the GRBL 1.1 interface; the sentences are ours.
"""

import math
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from undrift.errors import InputError, LimitError, LinkError, RigError, RigFault, RigTimeout
from undrift.rig.link import Clock, Link, LinkSettings
from undrift.rig.rig import Limits, Position, RigSettings
from undrift.units import RADIAN_PER_DEGREE

# ---- What GRBL 1.1 says, in words: error codes, alarms, and its status line.

ERRORS = {
    1: "a letter was expected in the command",
    2: "a number is missing or is no number",
    3: "the $ command is not known",
    4: "a negative value where only a positive one is allowed",
    5: "homing is not switched on in the settings",
    6: "the step pulse is shorter than the board allows",
    7: "the stored settings could not be read and were reset",
    8: "the $ command needs an idle controller",
    9: "locked by an alarm or by a jog that still runs",
    10: "software limits need homing to be switched on",
    11: "the line is too long",
    12: "the steps per second would be more than the board can do",
    13: "the safety door is open",
    14: "the line is too long to be stored",
    15: "the jog would leave the machine's travel",
    16: "the jog has no motion or a word that a jog may not have",
    17: "laser mode needs a controllable output",
    20: "the G-code is not supported",
    22: "the feed rate is missing or not set",
    24: "two commands of one line need the same axis",
    33: "the motion has no valid target",
}
ALARMS = {
    1: "a limit switch was hit; the position is lost",
    2: "the target lies outside the travel",
    3: "reset while moving; the position is lost",
    4: "the probe was not in its starting state",
    5: "the probe was not touched",
    6: "homing was reset",
    7: "the safety door was opened while homing",
    8: "homing could not clear the switch",
    9: "homing did not find the switch",
    10: "homing did not find the second switch",
}
STATES = ("Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep")
STATUS = re.compile(rb"<[^<>\r\n]*>\r?\n")
REPLY = re.compile(rb"(?:^|\n)(?:ok|error:\d{1,3})[ \t]*\r?\n")
WELCOME = re.compile(rb"Grbl[^\r\n]*\r?\n")
_PLACE = re.compile(r"-?\d{1,9}\.\d{1,6}(?:,-?\d{1,9}\.\d{1,6}){0,5}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """A status line."""

    state: str  # Idle, Run, Hold, Jog, Alarm, Door, Check, Home or Sleep
    # Machine positions (MPos) of all axes, deg on rotary axes; None when the line has work positions
    machine: tuple[float, ...] | None


def reply_end(received: bytes) -> int:
    """Return where an answer ends: at ``ok`` or ``error:n``."""
    found = REPLY.search(received)
    return found.end() if found else 0


def status_end(received: bytes) -> int:
    """Return where a status line ends."""
    found = STATUS.search(received)
    return found.end() if found else 0


def welcome_end(received: bytes) -> int:
    """Return where the greeting after a reset ends."""
    found = WELCOME.search(received)
    return found.end() if found else 0


def parse_status(line: str, name: str) -> Status:
    """Read a status line strictly."""
    fields = line.strip().removeprefix("<").removesuffix(">").split("|")
    state = fields[0].split(":")[0]
    labelled = dict(field.split(":", 1) for field in fields[1:] if ":" in field)
    place = labelled.get("MPos")
    if state not in STATES or not (place or "WPos" in labelled) or (place and not _PLACE.fullmatch(place)):
        raise LinkError(f"{name}: wanted a status line, got {line!r}; check cable and baud")
    return Status(state=state, machine=tuple(float(number) for number in place.split(",")) if place else None)


def error_in_words(code: int) -> str:
    """Say what an error code means."""
    return ERRORS.get(code, "an error that is not listed here; see the firmware's list of error codes")


def alarm_in_words(code: int) -> str:
    """Say what an alarm means."""
    return ALARMS.get(code, "an alarm that is not listed here; see the firmware's list of alarms")


# ---- The language of GRBL 1.1 (grblHAL, FluidNC): lines answered by ``ok`` or ``error:n``, and single characters that act at once.

JOG_CANCEL = b"\x85"
HOLD = b"!"
RESET = b"\x18"
UNCONFIRMED = "it is NOT CONFIRMED that the table stopped: cut the motor's power"
_KNOWN = re.compile(r"|ok|\[.*\]|<.*>|\$\d{1,3}=.*|Grbl .*|ALARM:\d{1,2}|error:\d{1,3}")


class GrblController:
    """Commands of the controller."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self.link = link
        self.clock = clock
        self.alarm: str | None = None
        self.broken: LinkError | RigTimeout | None = None  # how the link first failed since it was last in step
        self._one_at_a_time = threading.RLock()

    @property
    def name(self) -> str:
        """The link's URL."""
        return self.link.url

    def do(self, line: str) -> list[str]:
        """Send a line and return the lines before ``ok``."""
        *answer, last = self._ask(line)
        if last.startswith("error:"):
            code = int(last.removeprefix("error:"))
            raise RigFault(
                f"{self.name}: wanted '{line}', got error {code}: {error_in_words(code)}; see the controller's state",
                code=code,
                command=line,
            )
        return answer

    def status(self, deadline_s: float | None = None) -> Status:
        """Ask for the status (``?``)."""
        *_, last = self._ask("?", deadline_s, until=status_end, terminator="")
        return parse_status(last, self.name)

    def reset(self, deadline_s: float) -> str:
        """Reset (0x18): motion ends at once, whatever was queued is forgotten; back in step when it greets."""
        with self._one_at_a_time:
            answer = self.link.resynchronise(RESET.decode("latin-1"), welcome_end, deadline_s, terminator="")
        self.alarm = self.broken = None
        return answer.strip().splitlines()[-1]

    def wait_for(self, states: tuple[str, ...], expected_s: float) -> Status:
        """Poll the status until it is one of these: at most twice as long as it should take, and 2 s."""
        allowed_s = 2.0 * expected_s + 2.0
        last = time.monotonic() + max(allowed_s / self.clock.speed, 1.0)
        while (status := self.status()).state not in states:
            if status.state in ("Alarm", "Door"):
                raise RigFault(
                    f"{self.name}: wanted {' or '.join(states)}, got {self.alarm_text(status)}; look at the table"
                )
            if time.monotonic() > last:
                raise RigTimeout(
                    f"{self.name}: wanted {' or '.join(states)} within {allowed_s:.3g} s, got {status.state}; look at the table",
                    deadline_s=allowed_s,
                )
            time.sleep(min(0.02, 0.05 / self.clock.speed))
        return status

    def alarm_text(self, status: Status) -> str:
        """Say what keeps the controller from moving."""
        if status.state == "Door":
            return "the safety door is open"
        return f"an alarm: {self.alarm}" if self.alarm else "an alarm"

    def make_safe(self) -> bool:
        """Stop, reset, put the motor to sleep, over a new connection where the old one is gone."""
        try:
            if not self.link.is_open:
                self.link.reconnect()
            self.link.send(JOG_CANCEL)
            self._slow_down()
            self.reset(max(self.link.settings.reply_timeout_s, 3.0))
            self.do("$SLP")
            return self.wait_for(("Sleep",), 0.0).state == "Sleep"
        except RigError:
            try:
                self.link.send(JOG_CANCEL + HOLD + RESET)  # in the dark: it may still listen
            except RigError:
                return False
            return False

    def _slow_down(self) -> None:
        """Give a cancelled jog time to come to rest; a reset in motion would lose the position."""
        with self._one_at_a_time:
            self.link.resynchronise("?", status_end, terminator="")
        try:
            self.wait_for(("Idle", "Sleep"), 10.0)
        except (RigTimeout, RigFault):
            return

    def _ask(
        self,
        question: str,
        deadline_s: float | None = None,
        *,
        until: Callable[[bytes], int] | None = None,
        terminator: str | None = None,
    ) -> list[str]:
        """Ask, one thread at a time; the first failure is kept, since those of other threads only follow from it."""
        with self._one_at_a_time:
            try:
                return self._lines(
                    self.link.exchange(question, deadline_s, until=until, terminator=terminator), question
                )
            except (LinkError, RigTimeout) as error:
                self.broken = self.broken or error
                raise

    def _lines(self, answer: str, question: str) -> list[str]:
        """Return the lines of an answer; what GRBL never says is garbage, an alarm is remembered."""
        lines = [line.strip() for line in answer.splitlines() if line.strip()]
        for line in lines:
            if not _KNOWN.fullmatch(line):
                raise LinkError(f"{self.name}: wanted an answer to '{question}', got {line!r}; check cable and baud")
            if line.startswith("ALARM:"):
                code = int(line.removeprefix("ALARM:"))
                self.alarm = f"{alarm_in_words(code)} (alarm {code})"
        return lines


# ---- A steady rate out of finite jogs: one is sent whenever less than a while's worth is queued.


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """One jog."""

    distance_deg: float  # Signed, a whole number of steps
    deg_per_min: float  # Above zero

    @property
    def duration_s(self) -> float:
        """How long it lasts at full rate, s."""
        return 60.0 * abs(self.distance_deg) / self.deg_per_min


class Feeder:
    """Sends jogs from its own thread from birth until `end`."""

    def __init__(
        self, jog: Callable[[Segment], None], segment: Segment, clock: Clock, queued: int, room: int | None
    ) -> None:
        self.failure: RigError | None = None
        self._jog = jog
        self._segment = segment
        self._clock = clock
        self._ahead_s = queued * segment.duration_s
        self._room = room
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._feed, name="grbl feeder", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Send no more, and wait for the thread; harmless when called again."""
        self._end.set()
        self._thread.join(timeout=10.0)

    def _feed(self) -> None:
        sent = 0
        planned = self._clock.now()
        pause_s = 0.25 * self._segment.duration_s / self._clock.speed
        while not self._end.is_set() and (self._room is None or sent < self._room):
            now = self._clock.now()
            if planned - now > self._ahead_s:
                self._end.wait(pause_s)
                continue
            try:
                self._jog(self._segment)
            except RigError as error:
                self.failure = error
                return
            planned = max(planned, now) + self._segment.duration_s
            sent += 1


# ---- Settings that a GRBL controller stores: ``$100`` and its neighbours steps per degree, ``$110`` rate, ``$120`` acceleration.

AXES = "XYZABC"
STEPS, RATE, ACCELERATION = 100, 110, 120  # of the first axis: steps/deg, deg/min, deg/s2


def stored(grbl: GrblController, first: int, axis: str) -> tuple[int, float]:
    """Return a setting of an axis."""
    listed = dict(line.removeprefix("$").split("=", 1) for line in grbl.do("$$") if line.startswith("$"))
    own = first + AXES.index(axis)
    number = own if str(own) in listed else first
    text = listed.get(str(number), "nothing").split(" ")[0]
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e9:
        raise LinkError(
            f"{grbl.name}: wanted ${number} above 0, got {text}; set it on the controller, check cable and baud"
        )
    return number, value


def store_acceleration(grbl: GrblController, axis: str, acceleration_dps2: float) -> float:
    """Store the run-up of an axis."""
    number, _ = stored(grbl, ACCELERATION, axis)
    grbl.do(f"${number}={acceleration_dps2:.3f}")
    _, held = stored(grbl, ACCELERATION, axis)
    if abs(held - acceleration_dps2) > 1e-3:
        raise LinkError(f"{grbl.name}: wanted ${number}={acceleration_dps2:.3f}, got {held:g}; check cable and baud")
    return held


# ---- One axis of a GRBL controller in degrees: its settings, where it is, jogs, and bringing it to rest.

OWN_STOPS = ("Sleep", "Jog", "Run", "Hold")
SLACK_DEG = 1.0  # of a position: the driver's clock and the board's are not quite the same
QUEUED_JOGS = 8  # of the 15 that a small board can hold


class GrblAxis:
    """What the axis does, in degrees."""

    def __init__(self, link: Link, axis: str, clock: Clock) -> None:
        self.grbl = GrblController(link, clock)
        self.clock = clock
        self.enabled = False
        self.feeder: Feeder | None = None
        self._axis = axis
        self._last: tuple[float, float] | None = None  # deg, and when it was asked for, s
        self._found_asleep: bool | None = None
        self.greeting = self.wake_up()
        _, self.steps_per_deg = stored(self.grbl, STEPS, axis)
        _, fastest_deg_per_min = stored(self.grbl, RATE, axis)
        self.fastest_dps = fastest_deg_per_min / 60.0
        self._reach_dps = 1.5 * self.fastest_dps
        _, self.acceleration_dps2 = stored(self.grbl, ACCELERATION, axis)
        self._found_dps2 = self.acceleration_dps2
        self.place_deg = self.home_deg = self.read_place()

    @property
    def name(self) -> str:
        """Where it is connected."""
        return self.grbl.name

    def wake_up(self) -> str:
        """Reset, and clear an alarm of our own making."""
        link = self.grbl.link
        self._last = None
        try:
            answer = link.resynchronise("?", status_end, terminator="")
        except RigTimeout:  # a board that a serial port's opening restarted
            answer = ""
        if self._found_asleep is None:
            self._found_asleep = not answer or "<Sleep" in answer
        greeting = self.grbl.reset(max(link.settings.reply_timeout_s, 3.0))
        if self.grbl.status().state == "Alarm" and any(f"<{state}" in answer for state in OWN_STOPS):
            self.grbl.do("$X")
        return greeting

    def read_place(self) -> float:
        """Return the machine position."""
        asked = self.clock.now()
        machine = self.grbl.status().machine
        if machine is None:
            raise LinkError(f"{self.name}: wanted machine positions, got work positions; set $10 to 1")
        index = AXES.index(self._axis) if len(machine) > 1 else 0
        if index >= len(machine):
            raise LinkError(
                f"{self.name}: wanted a position of axis {self._axis}, got {len(machine)}; name another axis"
            )
        self._check_reach(machine[index], asked)
        self.place_deg = machine[index]
        return self.place_deg

    def _check_reach(self, place_deg: float, asked: float) -> None:
        if self._last is not None:
            last_deg, then = self._last
            reach_deg = self._reach_dps * (self.clock.now() - then) + SLACK_DEG
            if abs(place_deg - last_deg) > reach_deg:
                raise LinkError(
                    f"{self.name}: wanted a position within {reach_deg:.1f} deg of {last_deg:g}, got {place_deg:g}; "
                    "the controller was restarted, the answer is garbled, or an emulator runs faster than clock_speed says",
                    place_deg=place_deg,
                )
        self._last = (place_deg, asked)

    def jog(self, segment: Segment) -> None:
        """Queue a jog."""
        self.grbl.do(f"$J=G91G21{self._axis}{segment.distance_deg:.5f}F{segment.deg_per_min:.3f}")

    def start_turning(self, deg_per_min: float, room_deg: float) -> None:
        """Start a chain of jogs."""
        rate_dps = abs(deg_per_min) / 60.0
        ahead_s = max(1.0, 2.0 * rate_dps / self.acceleration_dps2)
        steps = max(1, round(rate_dps * ahead_s / QUEUED_JOGS * self.steps_per_deg))
        distance_deg = steps / self.steps_per_deg
        room = None if math.isinf(room_deg) else int(room_deg / distance_deg)
        segment = Segment(distance_deg=math.copysign(distance_deg, deg_per_min), deg_per_min=abs(deg_per_min))
        self.feeder = Feeder(self.jog, segment, self.clock, QUEUED_JOGS, room)

    def stop(self) -> None:
        """End the chain and the jog, and wait for rest; the motor stays on."""
        failure = self.end_feeding()
        if isinstance(failure, LinkError | RigTimeout):
            raise failure
        if self.grbl.status().state in ("Jog", "Run", "Hold"):
            self.grbl.link.send(JOG_CANCEL)
            self.grbl.wait_for(("Idle",), self.fastest_dps / self.acceleration_dps2)
        self.read_place()
        if failure is not None:
            raise failure

    def check_awake(self) -> None:
        """Refuse to jog when the motor is off or an alarm stands."""
        status = self.grbl.status()
        if status.state != "Idle":
            got = self.grbl.alarm_text(status) if status.state in ("Alarm", "Door") else status.state
            raise RigFault(f"{self.name}: wanted an idle controller, got {got}; enable the rig, look at the table")

    def end_feeding(self) -> Exception | None:
        """End the chain of jogs."""
        feeder, self.feeder = self.feeder, None
        if feeder is None:
            return None
        feeder.end()
        return feeder.failure

    @contextmanager
    def guarded(self) -> Iterator[None]:
        """Stop and put the motor to sleep before the failure of a link is reported."""
        try:
            yield
        except (LinkError, RigTimeout) as error:
            first = self.grbl.broken or error
            outcome = "the table was stopped and its motor put to sleep" if self.make_safe() else UNCONFIRMED
            self.grbl.broken = None
            raise type(first)(f"{first}; {outcome}", **first.numbers) from error

    def restore(self) -> bool:
        """Come to rest, with the acceleration and the motor as they were found."""
        with self.guarded():
            self.grbl.link.resynchronise("?", status_end, terminator="")
            self.stop()
            if self.acceleration_dps2 != self._found_dps2:
                store_acceleration(self.grbl, self._axis, self._found_dps2)
            if not self._found_asleep:
                return self.grbl.status().state == "Idle"
            self.grbl.do("$SLP")
            return self.grbl.wait_for(("Sleep",), 0.0).state == "Sleep"

    def make_safe(self) -> bool:
        """End the chain, stop, put the motor to sleep."""
        self.enabled = False
        self.end_feeding()
        return self.grbl.make_safe()


# ---- What a GRBL rig says without moving: who it is, where it stands, what is wrong with it.


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblSettings:
    """What the driver cannot ask the controller."""

    limits: Limits = field(default_factory=Limits)  # Of the commands
    axis: str = "A"  # Letter of the axis: X, Y, Z, A, B or C
    move_turn_rate: float = 90.0 * RADIAN_PER_DEGREE  # Rate of `move_by`, rad/s
    clock: Clock = field(default_factory=Clock)  # Hardware's, or a faster emulator's

    def __post_init__(self) -> None:
        if self.axis not in tuple(AXES):
            raise InputError(f"grbl: wanted an axis X, Y, Z, A, B or C, got '{self.axis}'; name one")


class GrblReports:
    """A GRBL rig as far as it only says things; GrblRig moves it."""

    def __init__(self, link: Link, settings: GrblSettings = GrblSettings()) -> None:
        self._settings = settings
        self._closed = False
        try:
            self._axis = GrblAxis(link, settings.axis, settings.clock)
        except RigError:
            link.close()
            raise

    @property
    def limits(self) -> Limits:
        """Limits of its commands."""
        return self._settings.limits

    def identify(self) -> str:
        """Return the firmware's greeting and what ``$I`` says."""
        with self._guarded():
            return "; ".join([self._axis.greeting, *(line.strip("[]") for line in self._axis.grbl.do("$I"))])

    def position(self) -> Position:
        """Return where the axis stands in commanded steps, from where it stood when the rig was opened, rad."""
        clock = self._settings.clock
        with self._guarded():
            before = clock.now()
            place_deg = self._axis.read_place()
            after = clock.now()
        return Position(
            angle=(place_deg - self._axis.home_deg) * RADIAN_PER_DEGREE,
            time=0.5 * (before + after),
            within_s=0.5 * (after - before),
        )

    def measured_turn_rate(self, duration_s: float) -> float:
        """Return the mean rate over a while, from two positions."""
        return self._settings.clock.mean_turn_rate(self.position, duration_s)

    def following_error(self) -> float:
        """Return NaN: a stepper without an encoder does not know."""
        return math.nan

    def fault(self) -> str | None:
        """Return what is wrong in words, None when all is well."""
        feeder = self._axis.feeder
        if feeder is not None and feeder.failure is not None:
            return str(feeder.failure)
        with self._guarded():
            status = self._axis.grbl.status()
        if status.state in ("Alarm", "Door"):
            return self._axis.grbl.alarm_text(status)
        if self._axis.enabled and status.state == "Sleep":
            return "the motor is asleep though it was switched on"
        return None

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        if self._closed:
            raise LinkError(
                f"{self._axis.name}: wanted a rig ready for commands, got none: it is closed; open it again"
            )
        with self._axis.guarded():
            yield


# ---- GRBL 1.1, grblHAL, FluidNC: a stepper-driven rotary axis, jogged by finite moves.

SLOWEST_DEG_PER_MIN = 1.0  # GRBL raises anything slower to this


class GrblRig(GrblReports):
    """A rate table behind GRBL; opening resets the controller, which ends any motion."""

    servo = None  # commanded steps count as positions

    def enable(self, on: bool) -> None:
        """Wake the motor up, or stop and put it to sleep (``$SLP``)."""
        with self._guarded():
            self._axis.stop()
            if not on:
                self._axis.grbl.do("$SLP")
                self._axis.grbl.wait_for(("Sleep",), 0.0)
            else:
                if self._axis.grbl.status().state == "Sleep":
                    self._axis.wake_up()
                self._axis.grbl.wait_for(("Idle",), 0.0)
            self._axis.enabled = on

    def set_acceleration(self, acceleration: float) -> float:
        """Set run-up and slow-down (``$120`` and its neighbours), which the controller stores."""
        self.limits.check_acceleration(acceleration)
        with self._guarded():
            self._axis.stop()
            held = store_acceleration(self._axis.grbl, self._settings.axis, round(acceleration / RADIAN_PER_DEGREE, 3))
            self._axis.acceleration_dps2 = held
        return held * RADIAN_PER_DEGREE

    def turn(self, turn_rate: float) -> float:
        """Turn at a steady rate until stopped, by chained jogs."""
        self.limits.check_turn_rate(turn_rate)
        deg_per_min = round(60.0 * turn_rate / RADIAN_PER_DEGREE, 3)
        fastest_dps = self._axis.fastest_dps
        if turn_rate != 0.0 and not SLOWEST_DEG_PER_MIN <= abs(deg_per_min) <= 60.0 * fastest_dps:
            raise LimitError(
                f"turn rate: wanted {SLOWEST_DEG_PER_MIN / 60:.4f} to {fastest_dps:g} deg/s, "
                f"got {abs(deg_per_min) / 60:.4f}; choose another",
                turn_rate=turn_rate,
            )
        with self._guarded():
            self._axis.stop()
            if deg_per_min != 0.0:
                self._axis.check_awake()
                self._axis.start_turning(deg_per_min, self._room_deg(deg_per_min))
        return deg_per_min / 60.0 * RADIAN_PER_DEGREE

    def move_by(self, angle: float) -> float:
        """Turn by an angle and wait until the axis is at rest."""
        axis = self._axis
        if not math.isfinite(angle) or abs(angle) / RADIAN_PER_DEGREE * axis.steps_per_deg < 0.5:
            raise LimitError(f"angle: wanted a step at least, got {angle:g} rad; choose a larger one", angle=angle)
        self.limits.check_travel((axis.place_deg - axis.home_deg) * RADIAN_PER_DEGREE + angle)
        distance = round(angle / RADIAN_PER_DEGREE * axis.steps_per_deg) / axis.steps_per_deg
        rate = min(self._settings.move_turn_rate, self.limits.turn_rate, axis.fastest_dps * RADIAN_PER_DEGREE)
        rate_dps = round(60.0 * rate / RADIAN_PER_DEGREE, 3) / 60.0
        with self._guarded():
            axis.stop()
            axis.check_awake()
            before = axis.place_deg
            axis.jog(Segment(distance_deg=distance, deg_per_min=60.0 * rate_dps))
            axis.grbl.wait_for(("Idle",), abs(distance) / rate_dps + 2.0 * rate_dps / axis.acceleration_dps2)
            went = axis.read_place() - before
            if abs(went - distance) > 1.0 / axis.steps_per_deg + 2e-3:
                raise RigFault(
                    f"{axis.name}: wanted a move by {distance:g} deg, got {went:g}; look at the table", moved_deg=went
                )
        return distance * RADIAN_PER_DEGREE

    def stop(self) -> None:
        """Slow down (jog cancel) and wait until the axis is at rest; the motor stays on."""
        with self._guarded():
            self._axis.stop()

    def close(self, *, as_found: bool = False) -> None:
        """Stop, put the motor to sleep or leave it as it was, let go of the link; harmless when called again."""
        if self._closed:
            return
        self._closed = True
        try:
            confirmed = self._axis.restore() if as_found else self._axis.make_safe()
        finally:
            self._axis.grbl.link.close()
        if not confirmed:
            raise LinkError(f"{self._axis.name}: wanted the motor off at the end, got no answer; {UNCONFIRMED}")

    def _room_deg(self, deg_per_min: float) -> float:
        """Return how far the travel lets it turn, deg."""
        if self.limits.travel is None:
            return math.inf
        gone = math.copysign(1.0, deg_per_min) * (self._axis.place_deg - self._axis.home_deg)
        return max(self.limits.travel / RADIAN_PER_DEGREE - gone, 0.0)


def open_from(url: str, settings: RigSettings) -> GrblRig:
    """Open a GRBL rig."""
    link = Link(
        url,
        LinkSettings(
            reply_end=reply_end,
            reply_timeout_s=settings.reply_timeout_s,
            baud=settings.baud or 115200,
            hardware_handshake=settings.hardware_handshake,
        ),
    )
    own = GrblSettings(limits=settings.limits, axis=settings.axis or "A", clock=Clock(speed=settings.clock_speed))
    return GrblRig(link, own)
