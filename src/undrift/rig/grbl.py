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

from undrift.errors import InputError, LimitError, LinkError, RigError, RigFault, RigTimeout
from undrift.live.transports import number_of
from undrift.rig.link import Link, LinkedRig, ask_until
from undrift.rig.rig import RigSettings, check_free, in_words, steady_angle
from undrift.units import RADIAN_PER_DEGREE

# ---- Commands: lines, and single characters that act immediately.

MOVING = ("Jog", "Run", "Hold", "Home")
FAULTS = {"Alarm": "an alarm", "Door": "the safety door is open"}  # states in which the board does not move
JOG_CANCEL, HOLD, RESET = b"\x85", b"!", b"\x18"
PLACE = r"-?\d{1,9}\.\d{1,6}"
STATUS = re.compile(
    rf"<(Idle|Run|Hold|Jog|Alarm|Door|Check|Home|Sleep)(?::\d)?\|([MW])Pos:({PLACE}(?:,{PLACE}){{0,5}})(?:\|.*)?>"
)
KNOWN = re.compile(r"|ok|\[.*\]|<.*>|\$\d{1,3}=.*|Grbl .*|ALARM:\d{1,2}|error:\d{1,3}")

status_end = re.compile(rb"<[^<>\r\n]*>\r?\n")
welcome_end = re.compile(rb"Grbl[^\r\n]*\r?\n")


class GrblBoard(Link):
    """Commands of a GRBL board."""

    reply_end = re.compile(rb"(?:^|\n)(?:ok|error:\d{1,3})[ \t]*\r?\n")

    def do(self, line: str) -> list[str]:
        """Send a line and return the lines before ``ok``."""
        *answer, last = self._lines(line)
        if last.startswith("error:"):
            code = int(last.removeprefix("error:"))
            raise RigFault(
                f"{self.name}: the board rejected '{line}' (error {code}: {in_words('grbl_error', code)}). Check its state.",
                code=code,
                command=line,
            )
        return answer

    def status(self) -> tuple[str, list[float]]:
        """Return the state, and the machine positions of all axes, deg for rotary axes (``?``)."""
        line = self._lines("?", until=status_end, terminator="")[-1]
        match = STATUS.fullmatch(line)
        if match is None:
            raise LinkError(f"{self.name}: expected a status line, got {line!r}. Check cable and baud rate.")
        if match[2] != "M":
            raise LinkError(f"{self.name}: the board reports work positions, not machine positions. Set $10 to 1.")
        return match[1], [float(number) for number in match[3].split(",")]

    def state(self) -> str:
        """Return the state."""
        return self.status()[0]

    def status_anew(self) -> str:
        """Ask for the status and discard all bytes before it. Return the status line."""
        return self.exchange("?", until=status_end, terminator="", anew=True)

    def reset(self) -> str:
        """Reset (0x18) and return the greeting. Motion ends immediately, the queue is cleared and the link is in step."""
        wait_s = max(self.reply_timeout_s, 3.0)
        answer = self.exchange(RESET.decode("latin-1"), wait_s, until=welcome_end, terminator="", anew=True)
        return answer.strip().splitlines()[-1]

    def _lines(
        self, question: str, *, until: re.Pattern[bytes] | None = None, terminator: str | None = None
    ) -> list[str]:
        """Return the lines of an answer. Raise LinkError for a line that GRBL never sends."""
        answer = self.exchange(question, until=until, terminator=terminator)
        lines = [line.strip() for line in answer.splitlines() if line.strip()]
        for line in lines:
            if not KNOWN.fullmatch(line):
                raise LinkError(f"{self.name}: {line!r} is not an answer to '{question}'. Check cable and baud rate.")
        return lines


# ---- The rig.

AXES = "XYZABC"
STEPS, RATE, ACCELERATION = 100, 110, 120  # settings of the first axis: steps/deg, deg/min, deg/s2
SLOWEST_DEG_PER_MIN = 1.0  # lowest rate of GRBL, which replaces lower rates with it


class GrblRig(LinkedRig):
    """A rate table with a GRBL board. Opening it resets the board, which ends any motion."""

    stopped = "The table was stopped and its motor put to sleep."
    unconfirmed = "It is NOT CONFIRMED that the table stopped. Cut the motor's power."
    unit, slack = "deg", 1.0  # the clocks of driver and board differ
    rad_per_unit = RADIAN_PER_DEGREE

    def __init__(self, board: GrblBoard, settings: RigSettings = RigSettings()) -> None:
        self.board, self._axis = board, settings.axis or "A"
        super().__init__(board, settings)

    def identify(self) -> str:
        """Return the firmware's greeting and the answer to ``$I``."""
        with self._guarded():
            return "; ".join([self._greeting, *(line.strip("[]") for line in self.board.do("$I"))])

    def enable(self, on: bool) -> None:
        """Wake the motor up, or stop it and put it to sleep (``$SLP``)."""
        with self._guarded():
            self._stop()
            if not on:
                self._sleep()
            else:
                if self.board.state() == "Sleep":
                    self._wake_up()
                self._wait_for(("Idle",))
                self._read_position()
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
        if not SLOWEST_DEG_PER_MIN <= abs(deg_per_min) <= 60.0 * self._fastest:
            raise LimitError(
                f"turn rate must be {SLOWEST_DEG_PER_MIN / 60:.4f} to {self._fastest:g} deg/s, "
                f"got {abs(rate_dps):.4f}. Choose another rate.",
                turn_rate=turn_rate,
            )
        steps = round(steady_angle(rate_dps, seconds, self._acceleration_dps2) * self._steps_per_deg)
        distance_deg = steps / self._steps_per_deg
        self._check_travel(distance_deg)
        with self._guarded():
            state = self.board.state()
            if state != "Idle":
                raise RigFault(
                    f"{self.board.name}: the board is not idle, got {FAULTS.get(state, state)}. Enable the rig and check the "
                    "table."
                )
            self.board.do(f"$J=G91G21{self._axis}{distance_deg:.5f}F{abs(deg_per_min):.3f}")
        return rate_dps * RADIAN_PER_DEGREE

    def stop(self) -> None:
        """Slow down (jog cancel) and wait until the axis is at rest. The motor stays on."""
        with self._guarded():
            self._stop()

    def fault(self) -> str | None:
        """Return a description of the fault, or None."""
        with self._guarded():
            state = self.board.state()
        asleep = self._enabled and state == "Sleep"
        return "the motor is asleep though it was switched on" if asleep else FAULTS.get(state)

    def _prepare(self, settings: RigSettings) -> None:
        """Check that the table is free, reset the board, and read its settings and its position."""
        if settings.accept != "moving" and self.board.name.startswith("tcp:"):  # opening a serial port resets the board
            check_free(self.board.name, "moving" if self.board.state() in MOVING else "", settings)
        self._greeting = self._wake_up()
        self._steps_per_deg = self._stored(STEPS)[1]
        self._fastest = self._stored(RATE)[1] / 60.0
        self._acceleration_dps2 = self._stored(ACCELERATION)[1]
        self._home = self._read_position()

    def _wake_up(self) -> str:
        """Reset and return the greeting. If the reset interrupts motion or sleep, clear the alarm that follows."""
        self._last = math.nan
        try:
            answer = self.board.status_anew()
        except RigTimeout:  # opening a serial port restarts some boards
            answer = ""
        greeting = self.board.reset()
        if self.board.state() == "Alarm" and any(f"<{state}" in answer for state in ("Sleep", *MOVING)):
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

    def _ask_position(self) -> float:
        """Return the machine position of the axis, deg."""
        _, places = self.board.status()
        index = AXES.index(self._axis) if len(places) > 1 else 0
        if index >= len(places):
            raise LinkError(
                f"{self.board.name}: no position of axis {self._axis} among the {len(places)} positions. Set another axis."
            )
        return places[index]

    def _wait_for(self, states: tuple[str, ...], expected_s: float = 0.0) -> None:
        """Poll the status until its state is in `states`, for at most twice the expected time plus 2 s."""
        allowed_s, expected = 2.0 * expected_s + 2.0, " or ".join(states)

        def has_arrived() -> bool:
            state = self.board.state()
            if state in FAULTS:
                raise RigFault(f"{self.board.name}: expected state {expected}, got {FAULTS[state]}. Check the table.")
            return state in states

        if not ask_until(has_arrived, self.clock, allowed_s):
            raise RigTimeout(
                f"{self.board.name}: expected state {expected} within {allowed_s:.3g} s, got {self.board.state()}. Check the "
                "table.",
                deadline_s=allowed_s,
            )

    def _sleep(self) -> None:
        self.board.do("$SLP")
        self._wait_for(("Sleep",))

    def _stop(self) -> None:
        """End the jog and wait until the axis is at rest."""
        if self.board.state() in ("Jog", "Run", "Hold"):
            self.board.send(JOG_CANCEL)
            self._wait_for(("Idle",), self._fastest / self._acceleration_dps2)
        self._read_position()

    def _make_safe(self) -> bool:
        """Stop, reset and put the motor to sleep, and reconnect first if the link is lost."""
        board, self._enabled = self.board, False
        try:
            if not board.is_open:
                board.reconnect()
            board.send(JOG_CANCEL)
            board.status_anew()
            with contextlib.suppress(RigTimeout, RigFault):
                self._wait_for(("Idle", "Sleep"), 10.0)  # a reset during motion loses the position
            board.reset()
            self._sleep()
        except RigError:
            with contextlib.suppress(RigError):
                board.send(JOG_CANCEL + HOLD + RESET)  # the board may still receive commands
            return False
        return True


def open_from(url: str, settings: RigSettings) -> GrblRig:
    """Open a GRBL rig."""
    if settings.axis not in ("", *AXES):
        raise InputError(f"grbl: axis must be X, Y, Z, A, B or C, got '{settings.axis}'. Set another axis.")
    return GrblRig(GrblBoard(url, **settings.link(115_200)), settings)
