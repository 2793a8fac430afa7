"""Driver for a rotary axis with a stepper motor on a GRBL board (GRBL 1.1, grblHAL, FluidNC).

The board answers a line with ``ok`` or ``error:n``. Single characters act immediately: ``?`` asks for the status, ``!`` pauses the
motion, 0x85 ends a jog, 0x18 resets the board. Alarms arrive between answers, without a question.

`$J=G91A<deg>F<deg/min>` turns by an angle and can be cancelled at any time. A steady turn is a jog by a whole number of steps. The
steps per degree are in `$100` and the next settings. The board ends the jog itself, even if this program has ended. The table has
no encoder, so the commanded rate is reported as the achieved rate, and the following error is NaN.
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

# ---- Commands: lines, and single characters that act immediately.

STATES = ("Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep")
JOG_CANCEL, HOLD, RESET = b"\x85", b"!", b"\x18"
_PLACE = re.compile(r"-?\d{1,9}\.\d{1,6}(?:,-?\d{1,9}\.\d{1,6}){0,5}")
_KNOWN = re.compile(r"|ok|\[.*\]|<.*>|\$\d{1,3}=.*|Grbl .*|ALARM:\d{1,2}|error:\d{1,3}")

reply_end = end_of(rb"(?:^|\n)(?:ok|error:\d{1,3})[ \t]*\r?\n")
status_end = end_of(rb"<[^<>\r\n]*>\r?\n")
welcome_end = end_of(rb"Grbl[^\r\n]*\r?\n")


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblStatus:
    """Contents of a status line."""

    state: str  # a member of STATES
    # machine positions (MPos) of all axes, deg for rotary axes, or None if the line has work positions
    machine: tuple[float, ...] | None


def parse_status(line: str, name: str) -> GrblStatus:
    """Parse a status line. Raise LinkError if any part is malformed."""
    fields = line.strip().removeprefix("<").removesuffix(">").split("|")
    state = fields[0].split(":")[0]
    labelled = dict(field.split(":", 1) for field in fields[1:] if ":" in field)
    place = labelled.get("MPos")
    if state not in STATES or not (place or "WPos" in labelled) or (place and not _PLACE.fullmatch(place)):
        raise LinkError(f"{name}: expected a status line, got {line!r}. Check cable and baud rate.")
    return GrblStatus(state=state, machine=tuple(float(number) for number in place.split(",")) if place else None)


class GrblController:
    """Commands of a GRBL controller."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self.link, self.clock, self.name = link, clock, link.name
        self.alarm: str | None = None
        self.broken: RigError | None = None  # first failure of the link since it was last in step
        self._one_at_a_time = threading.RLock()

    def do(self, line: str) -> list[str]:
        """Send a line and return the lines before ``ok``."""
        *answer, last = self._ask(line)
        if last.startswith("error:"):
            code = int(last.removeprefix("error:"))
            cause = f"error {code}: {in_words('grbl_error', code)}"
            raise RigFault(
                f"{self.name}: the controller rejected '{line}' ({cause}). Check its state.", code=code, command=line
            )
        return answer

    def status(self) -> GrblStatus:
        """Return the status (``?``)."""
        return parse_status(self._ask("?", until=status_end, terminator="")[-1], self.name)

    def status_anew(self) -> str:
        """Ask for the status and discard all bytes before it. Return the status line."""
        with self._one_at_a_time:
            return self.link.ask_anew("?", status_end, terminator="")

    def reset(self) -> str:
        """Reset (0x18) and return the greeting. Motion ends immediately, the queue is cleared and the link is in step."""
        deadline_s = max(self.link.settings.reply_timeout_s, 3.0)
        with self._one_at_a_time:
            answer = self.link.ask_anew(RESET.decode("latin-1"), welcome_end, deadline_s, terminator="")
        self.alarm = self.broken = None
        return answer.strip().splitlines()[-1]

    def wait_for(self, states: tuple[str, ...], expected_s: float = 0.0) -> GrblStatus:
        """Poll the status until its state is in `states`, for at most twice the expected time plus 2 s."""
        allowed_s, expected = 2.0 * expected_s + 2.0, " or ".join(states)

        def reached() -> GrblStatus | None:
            status = self.status()
            if status.state in ("Alarm", "Door") and status.state not in states:
                raise RigFault(
                    f"{self.name}: expected state {expected}, got {self.alarm_text(status)}. Check the table."
                )
            return status if status.state in states else None

        if (status := ask_until(reached, self.clock, allowed_s)) is None:
            raise RigTimeout(
                f"{self.name}: expected state {expected} within {allowed_s:.3g} s, got {self.status().state}. Check the table.",
                deadline_s=allowed_s,
            )
        return status

    def sleep(self) -> bool:
        """Switch the motor off (``$SLP``)."""
        self.do("$SLP")
        return self.wait_for(("Sleep",)).state == "Sleep"

    def alarm_text(self, status: GrblStatus) -> str:
        """Return the reason why the controller does not move, for messages."""
        if status.state == "Door":
            return "the safety door is open"
        return f"an alarm: {self.alarm}" if self.alarm else "an alarm"

    def make_safe(self) -> bool:
        """Stop, reset and put the motor to sleep, and reconnect first if the link is lost. Return True if confirmed."""
        try:
            if not self.link.is_open:
                self.link.reconnect()
            self.link.send(JOG_CANCEL)
            self.status_anew()
            with contextlib.suppress(RigTimeout, RigFault):
                self.wait_for(("Idle", "Sleep"), 10.0)  # a reset during motion loses the position
            self.reset()
            return self.sleep()
        except RigError:
            with contextlib.suppress(RigError):
                self.link.send(JOG_CANCEL + HOLD + RESET)  # the board may still receive commands
            return False

    def _ask(
        self, question: str, *, until: Callable[[bytes], int] | None = None, terminator: str | None = None
    ) -> list[str]:
        """Return the lines of an answer, store an alarm, and raise LinkError for a line that GRBL never sends.

        The first failure is stored, since later failures of other threads follow from it.
        """
        with self._one_at_a_time:
            try:
                answer = self.link.exchange(question, until=until, terminator=terminator)
                lines = [line.strip() for line in answer.splitlines() if line.strip()]
                for line in lines:
                    if not _KNOWN.fullmatch(line):
                        raise LinkError(
                            f"{self.name}: {line!r} is not an answer to '{question}'. Check cable and baud rate."
                        )
                    if line.startswith("ALARM:"):
                        code = int(line.removeprefix("ALARM:"))
                        self.alarm = f"{in_words('grbl_alarm', code)} (alarm {code})"
            except (LinkError, RigTimeout) as error:
                self.broken = self.broken or error
                raise
            return lines


# ---- One axis of a controller in degrees: its settings, its position, jogs and the stop.

AXES = "XYZABC"
STEPS, RATE, ACCELERATION = 100, 110, 120  # settings of the first axis: steps/deg, deg/min, deg/s2
OWN_STOPS = ("Sleep", "Jog", "Run", "Hold")
SLACK_DEG = 1.0  # tolerance of a position, deg, since the clocks of driver and board differ


class GrblAxis(GrblController):
    """Position and motion of an axis, in degrees."""

    refused: str | None = None  # always None, since a controller can be used again after a reset

    def __init__(self, link: Link, axis: str, clock: Clock) -> None:
        super().__init__(link, clock)
        self.enabled = False
        self._axis = axis
        self._last: tuple[float, float] | None = None  # last position, deg, and the time of its question, s
        self._found_asleep: bool | None = None
        self.greeting = self.wake_up()
        _, self.steps_per_deg = self.stored(STEPS)
        self.fastest_dps = self.stored(RATE)[1] / 60.0
        self._reach_dps = 1.5 * self.fastest_dps
        _, self.acceleration_dps2 = self.stored(ACCELERATION)
        self._found_dps2 = self.acceleration_dps2
        self.place_deg = self.home_deg = self.read_place()

    def wake_up(self) -> str:
        """Reset and return the greeting. If the reset interrupts motion or sleep, clear the alarm that follows."""
        self._last = None
        try:
            answer = self.status_anew()
        except RigTimeout:  # opening a serial port restarts some boards
            answer = ""
        if self._found_asleep is None:
            self._found_asleep = not answer or "<Sleep" in answer
        greeting = self.reset()
        if self.status().state == "Alarm" and any(f"<{state}" in answer for state in OWN_STOPS):
            self.do("$X")
        return greeting

    def stored(self, first: int) -> tuple[int, float]:
        """Return the number and the value of a setting of the axis. `first` is the number for the first axis."""
        settings = dict(line.removeprefix("$").split("=", 1) for line in self.do("$$") if line.startswith("$"))
        axis_number = first + AXES.index(self._axis)
        number = axis_number if str(axis_number) in settings else first
        text = settings.get(str(number), "nothing").split(" ")[0]
        value = number_of(text)
        if not 0.0 < value < 1e9:
            raise LinkError(
                f"{self.name}: ${number} must be positive, got {text}. Set it on the controller, and check cable and baud rate."
            )
        return number, value

    def store_acceleration(self, acceleration_dps2: float) -> float:
        """Store the acceleration on the controller and return the stored value, deg/s2."""
        number, _ = self.stored(ACCELERATION)
        self.do(f"${number}={acceleration_dps2:.3f}")
        _, actual = self.stored(ACCELERATION)
        if abs(actual - acceleration_dps2) > 1e-3:
            raise LinkError(
                f"{self.name}: set ${number}={acceleration_dps2:.3f}, but the controller returned {actual:g}. "
                "Check cable and baud rate."
            )
        return actual

    def read_place(self) -> float:
        """Return the machine position of the axis, deg."""
        asked_s = self.clock.now()
        machine = self.status().machine
        if machine is None:
            raise LinkError(f"{self.name}: the controller reports work positions, not machine positions. Set $10 to 1.")
        index = AXES.index(self._axis) if len(machine) > 1 else 0
        if index >= len(machine):
            raise LinkError(
                f"{self.name}: no position of axis {self._axis} among the {len(machine)} positions. Set another axis."
            )
        place_deg, (last_deg, then) = machine[index], self._last or (machine[index], asked_s)
        reach_deg = self._reach_dps * (self.clock.now() - then) + SLACK_DEG
        if abs(place_deg - last_deg) > reach_deg:
            raise LinkError(
                f"{self.name}: expected a position within {reach_deg:.1f} deg of {last_deg:g}, got {place_deg:g}. "
                "The controller was restarted, the answer is corrupted, or clock_speed is wrong.",
                place_deg=place_deg,
            )
        self._last, self.place_deg = (place_deg, asked_s), place_deg
        return place_deg

    def jog(self, distance_deg: float, deg_per_min: float) -> None:
        """Start a jog by a signed angle of a whole number of steps, at a positive rate."""
        self.do(f"$J=G91G21{self._axis}{distance_deg:.5f}F{deg_per_min:.3f}")

    def stop(self) -> None:
        """End the jog and wait until the axis is at rest. The motor stays on."""
        if self.status().state in ("Jog", "Run", "Hold"):
            self.link.send(JOG_CANCEL)
            self.wait_for(("Idle",), self.fastest_dps / self.acceleration_dps2)
        self.read_place()

    def check_awake(self) -> None:
        """Raise RigFault unless the controller is idle, for example if the motor is off or an alarm is active."""
        status = self.status()
        if status.state != "Idle":
            state = self.alarm_text(status) if status.state in ("Alarm", "Door") else status.state
            raise RigFault(f"{self.name}: the controller is not idle, got {state}. Enable the rig and check the table.")

    def restore(self) -> bool:
        """Stop the axis and restore the initial acceleration and motor state."""
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

SLOWEST_DEG_PER_MIN = 1.0  # lowest rate of GRBL, which replaces lower rates with it
MOVE_DPS = 90.0  # turn rate of `move_by`, deg/s


class GrblRig(LinkedRig):
    """A rate table with a GRBL board. Opening it resets the board, which ends any motion."""

    stopped = "The table was stopped and its motor put to sleep."
    unconfirmed = "It is NOT CONFIRMED that the table stopped. Cut the motor's power."
    _axis: GrblAxis

    def __init__(self, link: Link, settings: RigSettings = RigSettings()) -> None:
        try:
            axis = GrblAxis(link, settings.axis or "A", settings.timing)
        except RigError:
            link.close()
            raise
        super().__init__(axis, settings.limits)

    def identify(self) -> str:
        """Return the firmware's greeting and the answer to ``$I``."""
        with self._guarded():
            return "; ".join([self._axis.greeting, *(line.strip("[]") for line in self._axis.do("$I"))])

    def read_servo(self) -> None:
        """Return None, because the board drives a stepper without an encoder."""
        return

    def enable(self, on: bool) -> None:
        """Wake the motor up, or stop it and put it to sleep (``$SLP``)."""
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
        """Set the acceleration of both ramps (``$120`` or a next setting), which the controller stores."""
        self.limits.check_acceleration(acceleration)
        with self._guarded():
            self._axis.stop()
            actual = self._axis.store_acceleration(round(acceleration / RADIAN_PER_DEGREE, 3))
            self._axis.acceleration_dps2 = actual
        return actual * RADIAN_PER_DEGREE

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        """Turn at a steady rate for a time that includes both ramps, with one jog, and return the commanded rate."""
        self.limits.check_turn_rate(turn_rate)
        axis, deg_per_min = self._axis, round(60.0 * turn_rate / RADIAN_PER_DEGREE, 3)
        rate_dps = deg_per_min / 60.0
        if not SLOWEST_DEG_PER_MIN <= abs(deg_per_min) <= 60.0 * axis.fastest_dps:
            raise LimitError(
                f"turn rate must be {SLOWEST_DEG_PER_MIN / 60:.4f} to {axis.fastest_dps:g} deg/s, "
                f"got {abs(rate_dps):.4f}. Choose another rate.",
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
            raise LimitError(
                f"angle: {angle:g} rad is smaller than a step of the motor. Choose a larger angle.", angle=angle
            )
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
            moved_deg = axis.read_place() - before
            if abs(moved_deg - distance) > 1.0 / axis.steps_per_deg + 2e-3:
                raise RigFault(
                    f"{axis.name}: expected a move by {distance:g} deg, got {moved_deg:g}. Check the table.",
                    moved_deg=moved_deg,
                )
        return distance * RADIAN_PER_DEGREE

    def stop(self) -> None:
        """Slow down (jog cancel) and wait until the axis is at rest. The motor stays on."""
        with self._guarded():
            self._axis.stop()

    def position(self) -> Position:
        """Return the commanded angle since the rig was opened, rad."""
        axis, clock = self._axis, self._axis.clock
        with self._guarded():
            before = clock.now()
            angle = (axis.read_place() - axis.home_deg) * RADIAN_PER_DEGREE
            after = clock.now()
        return Position(angle=angle, time=0.5 * (before + after), within_s=0.5 * (after - before))

    def following_error(self) -> float:
        """Return NaN, because a stepper without an encoder has no following error."""
        return math.nan

    def fault(self) -> str | None:
        """Return a description of the fault, or None."""
        axis = self._axis
        with self._guarded():
            status = axis.status()
        if status.state in ("Alarm", "Door"):
            return axis.alarm_text(status)
        return "the motor is asleep though it was switched on" if axis.enabled and status.state == "Sleep" else None


def open_from(url: str, settings: RigSettings) -> GrblRig:
    """Open a GRBL rig."""
    if settings.axis not in ("", *AXES):
        raise InputError(f"grbl: axis must be X, Y, Z, A, B or C, got '{settings.axis}'. Set another axis.")
    return GrblRig(Link(url, replace(link_settings(settings, 115200), reply_end=reply_end)), settings)
