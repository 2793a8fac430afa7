"""Driver for a rotary axis with a stepper motor on a GRBL board (GRBL 1.1, grblHAL, FluidNC).

The board answers a line with ``ok`` or ``error:n``. Single characters act immediately: ``?`` asks for the status, ``!`` pauses the
motion, 0x85 ends a jog, 0x18 resets the board. Alarms arrive between answers, without a question.

`$J=G91A<deg>F<deg/min>` turns by an angle and can be cancelled at any time. A steady turn is a jog by a whole number of steps. The
steps per degree are in `$100` and the next settings. The board ends the jog itself, even if this program has ended. The table has
no encoder, so the commanded rate is reported as the achieved rate.
"""

import contextlib
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace

from undrift.base.clock import HOST, Clock
from undrift.errors import InputError, LimitError, LinkError, RigError, RigFault, RigTimeout
from undrift.live.transports import number_of
from undrift.rig.link import Link, LinkedRig, LinkSettings, ask_until, end_of, link_settings
from undrift.rig.rig import Position, RigSettings, check_free, in_words, steady_angle
from undrift.units import RADIAN_PER_DEGREE

# ---- Commands: lines, and single characters that act immediately.

STATES = ("Idle", "Run", "Hold", "Jog", "Alarm", "Door", "Check", "Home", "Sleep")
MOVING = ("Jog", "Run", "Hold", "Home")
JOG_CANCEL, HOLD, RESET = b"\x85", b"!", b"\x18"
PLACE = re.compile(r"-?\d{1,9}\.\d{1,6}(?:,-?\d{1,9}\.\d{1,6}){0,5}")
KNOWN = re.compile(r"|ok|\[.*\]|<.*>|\$\d{1,3}=.*|Grbl .*|ALARM:\d{1,2}|error:\d{1,3}")

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
    if state not in STATES or not (place or "WPos" in labelled) or (place and not PLACE.fullmatch(place)):
        raise LinkError(f"{name}: expected a status line, got {line!r}. Check cable and baud rate.")
    return GrblStatus(state=state, machine=tuple(float(number) for number in place.split(",")) if place else None)


class GrblBoard(Link):
    """Commands of a GRBL board."""

    def __init__(self, url: str, settings: LinkSettings = LinkSettings(), clock: Clock = HOST) -> None:
        self.clock, self.alarm = clock, ""
        super().__init__(url, replace(settings, reply_end=reply_end))

    def do(self, line: str) -> list[str]:
        """Send a line and return the lines before ``ok``."""
        *answer, last = self._lines(line)
        if last.startswith("error:"):
            code = int(last.removeprefix("error:"))
            cause = f"error {code}: {in_words('grbl_error', code)}"
            raise RigFault(
                f"{self.name}: the board rejected '{line}' ({cause}). Check its state.", code=code, command=line
            )
        return answer

    def status(self) -> GrblStatus:
        """Return the status (``?``)."""
        return parse_status(self._lines("?", until=status_end, terminator="")[-1], self.name)

    def status_anew(self) -> str:
        """Ask for the status and discard all bytes before it. Return the status line."""
        return self.ask_anew("?", status_end, terminator="")

    def reset(self) -> str:
        """Reset (0x18) and return the greeting. Motion ends immediately, the queue is cleared and the link is in step."""
        deadline_s = max(self.settings.reply_timeout_s, 3.0)
        answer = self.ask_anew(RESET.decode("latin-1"), welcome_end, deadline_s, terminator="")
        self.alarm = ""
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
        """Return the reason why the board does not move, for messages."""
        if status.state == "Door":
            return "the safety door is open"
        return f"an alarm: {self.alarm}" if self.alarm else "an alarm"

    def _lines(
        self, question: str, *, until: Callable[[bytes], int] | None = None, terminator: str | None = None
    ) -> list[str]:
        """Return the lines of an answer, store an alarm, and raise LinkError for a line that GRBL never sends."""
        answer = self.exchange(question, until=until, terminator=terminator)
        lines = [line.strip() for line in answer.splitlines() if line.strip()]
        for line in lines:
            if not KNOWN.fullmatch(line):
                raise LinkError(f"{self.name}: {line!r} is not an answer to '{question}'. Check cable and baud rate.")
            if line.startswith("ALARM:"):
                code = int(line.removeprefix("ALARM:"))
                self.alarm = f"{in_words('grbl_alarm', code)} (alarm {code})"
        return lines


# ---- The rig.

AXES = "XYZABC"
STEPS, RATE, ACCELERATION = 100, 110, 120  # settings of the first axis: steps/deg, deg/min, deg/s2
SLACK_DEG = 1.0  # tolerance of a position, deg, since the clocks of driver and board differ
SLOWEST_DEG_PER_MIN = 1.0  # lowest rate of GRBL, which replaces lower rates with it


class GrblRig(LinkedRig):
    """A rate table with a GRBL board. Opening it resets the board, which ends any motion."""

    stopped = "The table was stopped and its motor put to sleep."
    unconfirmed = "It is NOT CONFIRMED that the table stopped. Cut the motor's power."

    def __init__(self, board: GrblBoard, settings: RigSettings = RigSettings()) -> None:
        super().__init__(board, settings.limits)
        self.board, self._axis, self._enabled = board, settings.axis or "A", False
        self._last: tuple[float, float] | None = None  # last position, deg, and the time of its question, s
        self.fastest_dps = math.inf
        try:
            if settings.accept != "moving" and board.name.startswith("tcp:"):  # opening a serial port resets the board
                state = board.status().state
                check_free(board.name, "moving" if state in MOVING else "", settings)
            self._greeting = self._wake_up()
            self._steps_per_deg = self._stored(STEPS)[1]
            self.fastest_dps = self._stored(RATE)[1] / 60.0
            self._acceleration_dps2 = self._stored(ACCELERATION)[1]
            self._place_deg = self._home_deg = self._read_place()
        except RigError:
            board.close()
            raise

    def identify(self) -> str:
        """Return the firmware's greeting and the answer to ``$I``."""
        with self._guarded():
            return "; ".join([self._greeting, *(line.strip("[]") for line in self.board.do("$I"))])

    def enable(self, on: bool) -> None:
        """Wake the motor up, or stop it and put it to sleep (``$SLP``)."""
        with self._guarded():
            self._stop()
            if not on:
                self.board.sleep()
            else:
                if self.board.status().state == "Sleep":
                    self._wake_up()
                self.board.wait_for(("Idle",))
            self._enabled = on

    def set_acceleration(self, acceleration: float) -> float:
        """Set the acceleration of both ramps (``$120`` or a next setting), which the board stores."""
        self.limits.check_acceleration(acceleration)
        wanted_dps2 = round(acceleration / RADIAN_PER_DEGREE, 3)
        with self._guarded():
            self._stop()
            number, _ = self._stored(ACCELERATION)
            self.board.do(f"${number}={wanted_dps2:.3f}")
            _, actual_dps2 = self._stored(ACCELERATION)
            if abs(actual_dps2 - wanted_dps2) > 1e-3:
                raise LinkError(
                    f"{self.board.name}: set ${number}={wanted_dps2:.3f}, but the board returned {actual_dps2:g}. "
                    "Check cable and baud rate."
                )
            self._acceleration_dps2 = actual_dps2
        return actual_dps2 * RADIAN_PER_DEGREE

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        """Turn at a steady rate for a time that includes both ramps, with one jog, and return the commanded rate."""
        self.limits.check_turn_rate(turn_rate)
        deg_per_min = round(60.0 * turn_rate / RADIAN_PER_DEGREE, 3)
        rate_dps = deg_per_min / 60.0
        if not SLOWEST_DEG_PER_MIN <= abs(deg_per_min) <= 60.0 * self.fastest_dps:
            raise LimitError(
                f"turn rate must be {SLOWEST_DEG_PER_MIN / 60:.4f} to {self.fastest_dps:g} deg/s, "
                f"got {abs(rate_dps):.4f}. Choose another rate.",
                turn_rate=turn_rate,
            )
        steps = round(steady_angle(rate_dps, seconds, self._acceleration_dps2) * self._steps_per_deg)
        distance_deg = steps / self._steps_per_deg
        self.limits.check_travel((self._place_deg - self._home_deg + distance_deg) * RADIAN_PER_DEGREE)
        with self._guarded():
            status = self.board.status()
            if status.state != "Idle":
                state = self.board.alarm_text(status) if status.state in ("Alarm", "Door") else status.state
                raise RigFault(
                    f"{self.board.name}: the board is not idle, got {state}. Enable the rig and check the table."
                )
            self.board.do(f"$J=G91G21{self._axis}{distance_deg:.5f}F{abs(deg_per_min):.3f}")
        return rate_dps * RADIAN_PER_DEGREE

    def stop(self) -> None:
        """Slow down (jog cancel) and wait until the axis is at rest. The motor stays on."""
        with self._guarded():
            self._stop()

    def position(self) -> Position:
        """Return the commanded angle since the rig was opened, rad."""
        with self._guarded():
            before_s = self.board.clock.now()
            angle = (self._read_place() - self._home_deg) * RADIAN_PER_DEGREE
            after_s = self.board.clock.now()
        return Position(angle=angle, time=0.5 * (before_s + after_s), within_s=0.5 * (after_s - before_s))

    def fault(self) -> str | None:
        """Return a description of the fault, or None."""
        with self._guarded():
            status = self.board.status()
        if status.state in ("Alarm", "Door"):
            return self.board.alarm_text(status)
        return "the motor is asleep though it was switched on" if self._enabled and status.state == "Sleep" else None

    def _wake_up(self) -> str:
        """Reset and return the greeting. If the reset interrupts motion or sleep, clear the alarm that follows."""
        self._last = None
        try:
            answer = self.board.status_anew()
        except RigTimeout:  # opening a serial port restarts some boards
            answer = ""
        greeting = self.board.reset()
        if self.board.status().state == "Alarm" and any(f"<{state}" in answer for state in ("Sleep", *MOVING)):
            self.board.do("$X")
        return greeting

    def _stored(self, first: int) -> tuple[int, float]:
        """Return the number and the value of a setting of the axis. `first` is the number for the first axis."""
        settings = dict(line.removeprefix("$").split("=", 1) for line in self.board.do("$$") if line.startswith("$"))
        axis_number = first + AXES.index(self._axis)
        number = axis_number if str(axis_number) in settings else first
        text = settings.get(str(number), "nothing").split(" ")[0]
        value = number_of(text)
        if not 0.0 < value < 1e9:
            raise LinkError(
                f"{self.board.name}: ${number} must be positive, got {text}. Set it on the board, and check cable and baud rate."
            )
        return number, value

    def _read_place(self) -> float:
        """Return the machine position of the axis, deg. A position that the axis cannot have reached raises LinkError."""
        asked_s, name = self.board.clock.now(), self.board.name
        machine = self.board.status().machine
        if machine is None:
            raise LinkError(f"{name}: the board reports work positions, not machine positions. Set $10 to 1.")
        index = AXES.index(self._axis) if len(machine) > 1 else 0
        if index >= len(machine):
            raise LinkError(
                f"{name}: no position of axis {self._axis} among the {len(machine)} positions. Set another axis."
            )
        place_deg, (last_deg, then) = machine[index], self._last or (machine[index], asked_s)
        reach_deg = 1.5 * self.fastest_dps * (self.board.clock.now() - then) + SLACK_DEG
        if abs(place_deg - last_deg) > reach_deg:
            raise LinkError(
                f"{name}: expected a position within {reach_deg:.1f} deg of {last_deg:g}, got {place_deg:g}. "
                "The board was restarted, the answer is corrupted, or clock_speed is wrong.",
                place_deg=place_deg,
            )
        self._last, self._place_deg = (place_deg, asked_s), place_deg
        return place_deg

    def _stop(self) -> None:
        """End the jog and wait until the axis is at rest."""
        if self.board.status().state in ("Jog", "Run", "Hold"):
            self.board.send(JOG_CANCEL)
            self.board.wait_for(("Idle",), self.fastest_dps / self._acceleration_dps2)
        self._read_place()

    def _make_safe(self) -> bool:
        """Stop, reset and put the motor to sleep, and reconnect first if the link is lost."""
        board, self._enabled = self.board, False
        try:
            if not board.is_open:
                board.reconnect()
            board.send(JOG_CANCEL)
            board.status_anew()
            with contextlib.suppress(RigTimeout, RigFault):
                board.wait_for(("Idle", "Sleep"), 10.0)  # a reset during motion loses the position
            board.reset()
            return board.sleep()
        except RigError:
            with contextlib.suppress(RigError):
                board.send(JOG_CANCEL + HOLD + RESET)  # the board may still receive commands
            return False


def open_from(url: str, settings: RigSettings) -> GrblRig:
    """Open a GRBL rig."""
    if settings.axis not in ("", *AXES):
        raise InputError(f"grbl: axis must be X, Y, Z, A, B or C, got '{settings.axis}'. Set another axis.")
    return GrblRig(GrblBoard(url, link_settings(settings, 115_200), settings.timing), settings)
