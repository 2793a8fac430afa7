"""GRBL boards (GRBL 1.1, grblHAL, FluidNC): a stepper-driven rotary axis, jogged by finite moves.

Lines are answered by ``ok`` or ``error:n``; single characters act at once: ``?`` asks for the status, ``!`` holds, 0x85 ends a jog,
0x18 resets. Alarms come by themselves, between answers.

`$J=G91A<deg>F<deg/min>` turns by an angle and can be cancelled at any time. A steady turn is one such jog of a whole number of
steps (`$100` and its neighbours, steps per degree), which the board ends by itself, whatever becomes of this program. There is no
encoder: what was commanded counts as achieved, and there is no following error.
"""

import contextlib
import math
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

from undrift.base.clock import Clock
from undrift.errors import InputError, LimitError, LinkError, RigError, RigFault, RigTimeout
from undrift.live.transports import number_of
from undrift.rig.link import Link, LinkedRig, ask_until, end_of, link_settings
from undrift.rig.rig import Position, RigSettings, in_words, steady_angle
from undrift.units import RADIAN_PER_DEGREE

# ---- The language: lines, and single characters that act at once.

STATES = ("Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep")
JOG_CANCEL, HOLD, RESET = b"\x85", b"!", b"\x18"
_PLACE = re.compile(r"-?\d{1,9}\.\d{1,6}(?:,-?\d{1,9}\.\d{1,6}){0,5}")
_KNOWN = re.compile(r"|ok|\[.*\]|<.*>|\$\d{1,3}=.*|Grbl .*|ALARM:\d{1,2}|error:\d{1,3}")

reply_end = end_of(rb"(?:^|\n)(?:ok|error:\d{1,3})[ \t]*\r?\n")
status_end = end_of(rb"<[^<>\r\n]*>\r?\n")
welcome_end = end_of(rb"Grbl[^\r\n]*\r?\n")


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblStatus:
    """A status line."""

    state: str  # One of STATES
    # Machine positions (MPos) of all axes, deg on rotary axes; None when the line has work positions
    machine: tuple[float, ...] | None


def parse_status(line: str, name: str) -> GrblStatus:
    """Read a status line strictly."""
    fields = line.strip().removeprefix("<").removesuffix(">").split("|")
    state = fields[0].split(":")[0]
    labelled = dict(field.split(":", 1) for field in fields[1:] if ":" in field)
    place = labelled.get("MPos")
    if state not in STATES or not (place or "WPos" in labelled) or (place and not _PLACE.fullmatch(place)):
        raise LinkError(f"{name}: wanted a status line, got {line!r}; check cable and baud")
    return GrblStatus(state=state, machine=tuple(float(number) for number in place.split(",")) if place else None)


class GrblController:
    """Commands of a controller."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self.link, self.clock, self.name = link, clock, link.name
        self.alarm: str | None = None
        self.broken: RigError | None = None  # how the link first failed since it was last in step
        self._one_at_a_time = threading.RLock()

    def do(self, line: str) -> list[str]:
        """Send a line and return the lines before ``ok``."""
        *answer, last = self._ask(line)
        if last.startswith("error:"):
            code = int(last.removeprefix("error:"))
            what = f"wanted '{line}', got error {code}: {in_words('grbl_error', code)}"
            raise RigFault(f"{self.name}: {what}; see the controller's state", code=code, command=line)
        return answer

    def status(self) -> GrblStatus:
        """Ask for the status (``?``)."""
        return parse_status(self._ask("?", until=status_end, terminator="")[-1], self.name)

    def status_anew(self) -> str:
        """Ask for the status, and throw away all before it."""
        with self._one_at_a_time:
            return self.link.ask_anew("?", status_end, terminator="")

    def reset(self) -> str:
        """Reset (0x18): motion ends at once, whatever was queued is forgotten; back in step when it greets."""
        deadline_s = max(self.link.settings.reply_timeout_s, 3.0)
        with self._one_at_a_time:
            answer = self.link.ask_anew(RESET.decode("latin-1"), welcome_end, deadline_s, terminator="")
        self.alarm = self.broken = None
        return answer.strip().splitlines()[-1]

    def wait_for(self, states: tuple[str, ...], expected_s: float = 0.0) -> GrblStatus:
        """Poll the status until it is one of these: at most twice as long as it should take, and 2 s."""
        allowed_s, wanted = 2.0 * expected_s + 2.0, " or ".join(states)

        def reached() -> GrblStatus | None:
            status = self.status()
            if status.state in ("Alarm", "Door") and status.state not in states:
                raise RigFault(f"{self.name}: wanted {wanted}, got {self.alarm_text(status)}; look at the table")
            return status if status.state in states else None

        if (status := ask_until(reached, self.clock, allowed_s)) is None:
            raise RigTimeout(
                f"{self.name}: wanted {wanted} within {allowed_s:.3g} s, got {self.status().state}; look at the table",
                deadline_s=allowed_s,
            )
        return status

    def sleep(self) -> bool:
        """Switch the motor off."""
        self.do("$SLP")
        return self.wait_for(("Sleep",)).state == "Sleep"

    def alarm_text(self, status: GrblStatus) -> str:
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
            self.status_anew()
            with contextlib.suppress(RigTimeout, RigFault):
                self.wait_for(("Idle", "Sleep"), 10.0)  # a reset in motion loses the position
            self.reset()
            return self.sleep()
        except RigError:
            with contextlib.suppress(RigError):
                self.link.send(JOG_CANCEL + HOLD + RESET)  # in the dark: it may still listen
            return False

    def _ask(
        self, question: str, *, until: Callable[[bytes], int] | None = None, terminator: str | None = None
    ) -> list[str]:
        """Return the lines of an answer, one thread at a time; what GRBL never says is garbage, an alarm is remembered.

        The first failure is kept, since those of other threads only follow from it.
        """
        with self._one_at_a_time:
            try:
                answer = self.link.exchange(question, until=until, terminator=terminator)
                lines = [line.strip() for line in answer.splitlines() if line.strip()]
                for line in lines:
                    if not _KNOWN.fullmatch(line):
                        raise LinkError(
                            f"{self.name}: wanted an answer to '{question}', got {line!r}; check cable and baud"
                        )
                    if line.startswith("ALARM:"):
                        code = int(line.removeprefix("ALARM:"))
                        self.alarm = f"{in_words('grbl_alarm', code)} (alarm {code})"
            except (LinkError, RigTimeout) as error:
                self.broken = self.broken or error
                raise
            return lines


# ---- One axis of a controller in degrees: its settings, where it is, jogs, and bringing it to rest.

AXES = "XYZABC"
STEPS, RATE, ACCELERATION = 100, 110, 120  # settings of the first axis: steps/deg, deg/min, deg/s2
OWN_STOPS = ("Sleep", "Jog", "Run", "Hold")
SLACK_DEG = 1.0  # of a position: the driver's clock and the board's are not quite the same


class GrblAxis(GrblController):
    """What the axis does, in degrees."""

    refused: str | None = None  # a controller that was reset can be used again

    def __init__(self, link: Link, axis: str, clock: Clock) -> None:
        super().__init__(link, clock)
        self.enabled = False
        self._axis = axis
        self._last: tuple[float, float] | None = None  # deg, and when it was asked for, s
        self._found_asleep: bool | None = None
        self.greeting = self.wake_up()
        _, self.steps_per_deg = self.stored(STEPS)
        self.fastest_dps = self.stored(RATE)[1] / 60.0
        self._reach_dps = 1.5 * self.fastest_dps
        _, self.acceleration_dps2 = self.stored(ACCELERATION)
        self._found_dps2 = self.acceleration_dps2
        self.place_deg = self.home_deg = self.read_place()

    def wake_up(self) -> str:
        """Reset, and clear an alarm that a reset in our own motion or our own sleep leaves behind."""
        self._last = None
        try:
            answer = self.status_anew()
        except RigTimeout:  # a board that a serial port's opening restarted
            answer = ""
        if self._found_asleep is None:
            self._found_asleep = not answer or "<Sleep" in answer
        greeting = self.reset()
        if self.status().state == "Alarm" and any(f"<{state}" in answer for state in OWN_STOPS):
            self.do("$X")
        return greeting

    def stored(self, first: int) -> tuple[int, float]:
        """Return the number and the value of a setting of the axis."""
        listed = dict(line.removeprefix("$").split("=", 1) for line in self.do("$$") if line.startswith("$"))
        own = first + AXES.index(self._axis)
        number = own if str(own) in listed else first
        text = listed.get(str(number), "nothing").split(" ")[0]
        value = number_of(text)
        if not 0.0 < value < 1e9:
            raise LinkError(
                f"{self.name}: wanted ${number} above 0, got {text}; set it on the controller, check cable and baud"
            )
        return number, value

    def store_acceleration(self, acceleration_dps2: float) -> float:
        """Store run-up and slow-down."""
        number, _ = self.stored(ACCELERATION)
        self.do(f"${number}={acceleration_dps2:.3f}")
        _, held = self.stored(ACCELERATION)
        if abs(held - acceleration_dps2) > 1e-3:
            raise LinkError(
                f"{self.name}: wanted ${number}={acceleration_dps2:.3f}, got {held:g}; check cable and baud"
            )
        return held

    def read_place(self) -> float:
        """Return the machine position."""
        asked = self.clock.now()
        machine = self.status().machine
        if machine is None:
            raise LinkError(f"{self.name}: wanted machine positions, got work positions; set $10 to 1")
        index = AXES.index(self._axis) if len(machine) > 1 else 0
        if index >= len(machine):
            raise LinkError(
                f"{self.name}: wanted a position of axis {self._axis}, got {len(machine)}; name another axis"
            )
        place_deg, (last_deg, then) = machine[index], self._last or (machine[index], asked)
        reach_deg = self._reach_dps * (self.clock.now() - then) + SLACK_DEG
        if abs(place_deg - last_deg) > reach_deg:
            raise LinkError(
                f"{self.name}: wanted a position within {reach_deg:.1f} deg of {last_deg:g}, got {place_deg:g}; "
                "the controller was restarted, the answer is garbled, or clock_speed is wrong",
                place_deg=place_deg,
            )
        self._last, self.place_deg = (place_deg, asked), place_deg
        return place_deg

    def jog(self, distance_deg: float, deg_per_min: float) -> None:
        """Queue a jog by a whole number of steps, signed, at a rate above 0."""
        self.do(f"$J=G91G21{self._axis}{distance_deg:.5f}F{deg_per_min:.3f}")

    def stop(self) -> None:
        """End the jog, and wait for rest; the motor stays on."""
        if self.status().state in ("Jog", "Run", "Hold"):
            self.link.send(JOG_CANCEL)
            self.wait_for(("Idle",), self.fastest_dps / self.acceleration_dps2)
        self.read_place()

    def check_awake(self) -> None:
        """Refuse to jog when the motor is off or an alarm stands."""
        status = self.status()
        if status.state != "Idle":
            got = self.alarm_text(status) if status.state in ("Alarm", "Door") else status.state
            raise RigFault(f"{self.name}: wanted an idle controller, got {got}; enable the rig, look at the table")

    def restore(self) -> bool:
        """Come to rest, with the acceleration and the motor as they were found."""
        self.status_anew()
        self.stop()
        if self.acceleration_dps2 != self._found_dps2:
            self.store_acceleration(self._found_dps2)
        return self.sleep() if self._found_asleep else self.status().state == "Idle"

    def make_safe(self) -> bool:
        """Stop and put the motor to sleep."""
        self.enabled = False
        return super().make_safe()

    def let_go(self) -> None:
        """Close the link."""
        self.link.close()


# ---- The rig.

SLOWEST_DEG_PER_MIN = 1.0  # GRBL raises anything slower to this
MOVE_DPS = 90.0  # of `move_by`


class GrblRig(LinkedRig):
    """A rate table behind GRBL; opening resets the controller, which ends any motion."""

    stopped = "the table was stopped and its motor put to sleep"
    unconfirmed = "it is NOT CONFIRMED that the table stopped: cut the motor's power"
    _axis: GrblAxis

    def __init__(self, link: Link, settings: RigSettings = RigSettings()) -> None:
        try:
            axis = GrblAxis(link, settings.axis or "A", settings.timing)
        except RigError:
            link.close()
            raise
        super().__init__(axis, settings.limits)

    def identify(self) -> str:
        """Return the firmware's greeting and what ``$I`` says."""
        with self._guarded():
            return "; ".join([self._axis.greeting, *(line.strip("[]") for line in self._axis.do("$I"))])

    def read_servo(self) -> None:
        """Return None: the board drives a stepper and reads no encoder."""
        return

    def enable(self, on: bool) -> None:
        """Wake the motor up, or stop and put it to sleep (``$SLP``)."""
        with self._guarded():
            self._axis.stop()
            if not on:
                self._axis.sleep()
            else:
                if self._axis.status().state == "Sleep":
                    self._axis.wake_up()
                self._axis.wait_for(("Idle",))
            self._axis.enabled = on

    def set_acceleration(self, acceleration: float) -> float:
        """Set run-up and slow-down (``$120`` and its neighbours), which the controller stores."""
        self.limits.check_acceleration(acceleration)
        with self._guarded():
            self._axis.stop()
            held = self._axis.store_acceleration(round(acceleration / RADIAN_PER_DEGREE, 3))
            self._axis.acceleration_dps2 = held
        return held * RADIAN_PER_DEGREE

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        """Turn at a steady rate for so long, ramps included, by one jog; return the rate that is commanded."""
        self.limits.check_turn_rate(turn_rate)
        axis, deg_per_min = self._axis, round(60.0 * turn_rate / RADIAN_PER_DEGREE, 3)
        rate_dps = deg_per_min / 60.0
        if not SLOWEST_DEG_PER_MIN <= abs(deg_per_min) <= 60.0 * axis.fastest_dps:
            raise LimitError(
                f"turn rate: wanted {SLOWEST_DEG_PER_MIN / 60:.4f} to {axis.fastest_dps:g} deg/s, "
                f"got {abs(rate_dps):.4f}; choose another",
                turn_rate=turn_rate,
            )
        distance = (
            round(steady_angle(rate_dps, seconds, axis.acceleration_dps2) * axis.steps_per_deg) / axis.steps_per_deg
        )
        self.limits.check_travel((axis.place_deg - axis.home_deg + distance) * RADIAN_PER_DEGREE)
        with self._guarded():
            axis.check_awake()
            axis.jog(distance, abs(deg_per_min))
        return rate_dps * RADIAN_PER_DEGREE

    def move_by(self, angle: float) -> float:
        """Turn by an angle and wait until the axis is at rest."""
        axis = self._axis
        if not math.isfinite(angle) or abs(angle) / RADIAN_PER_DEGREE * axis.steps_per_deg < 0.5:
            raise LimitError(f"angle: wanted a step at least, got {angle:g} rad; choose a larger one", angle=angle)
        self.limits.check_travel((axis.place_deg - axis.home_deg) * RADIAN_PER_DEGREE + angle)
        distance = round(angle / RADIAN_PER_DEGREE * axis.steps_per_deg) / axis.steps_per_deg
        rate = min(MOVE_DPS * RADIAN_PER_DEGREE, self.limits.turn_rate, axis.fastest_dps * RADIAN_PER_DEGREE)
        rate_dps = round(60.0 * rate / RADIAN_PER_DEGREE, 3) / 60.0
        with self._guarded():
            axis.stop()
            axis.check_awake()
            before = axis.place_deg
            axis.jog(distance, 60.0 * rate_dps)
            axis.wait_for(("Idle",), abs(distance) / rate_dps + 2.0 * rate_dps / axis.acceleration_dps2)
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

    def position(self) -> Position:
        """Return where the axis stands in commanded steps, from where it stood when the rig was opened, rad."""
        axis, clock = self._axis, self._axis.clock
        with self._guarded():
            before = clock.now()
            angle = (axis.read_place() - axis.home_deg) * RADIAN_PER_DEGREE
            after = clock.now()
        return Position(angle=angle, time=0.5 * (before + after), within_s=0.5 * (after - before))

    def following_error(self) -> float:
        """Return NaN: a stepper without an encoder does not know."""
        return math.nan

    def fault(self) -> str | None:
        """Return what is wrong in words, None when all is well."""
        axis = self._axis
        with self._guarded():
            status = axis.status()
        if status.state in ("Alarm", "Door"):
            return axis.alarm_text(status)
        return "the motor is asleep though it was switched on" if axis.enabled and status.state == "Sleep" else None


def open_from(url: str, settings: RigSettings) -> GrblRig:
    """Open a GRBL rig."""
    if settings.axis not in ("", *AXES):
        raise InputError(f"grbl: wanted an axis X, Y, Z, A, B or C, got '{settings.axis}'; name one")
    return GrblRig(Link(url, replace(link_settings(settings, 115200), reply_end=reply_end)), settings)
