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

from undrift.errors import LimitError, LinkError, RigFault, RigTimeout
from undrift.live.transports import number_of
from undrift.rig.link import LinkedRig
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


AXES = "XYZABC"
STEPS, RATE, ACCELERATION = 100, 110, 120  # settings of the first axis: steps/deg, deg/min, deg/s2
SLOWEST_DEG_PER_MIN = 1.0  # lowest rate of GRBL, which replaces lower rates with it


class GrblRig(LinkedRig):
    """A rate table with a GRBL board. Opening it resets the board, which ends any motion."""

    stopped = "The table was stopped and its motor put to sleep."
    unconfirmed = "It is NOT CONFIRMED that the table stopped. Cut the motor's power."
    halt, last_words = JOG_CANCEL, (JOG_CANCEL + HOLD + RESET,)
    axes, default_axis = AXES, "A"
    unit, rad_per_unit = "deg", RADIAN_PER_DEGREE
    slack = 1.0  # the clocks of driver and board differ
    baud = 115_200
    immediate = "?" + RESET.decode("latin-1")
    reply_end = re.compile(rb"(?:^|\n)(?:ok|error:\d{1,3})[ \t]*\r?\n")

    def identify(self) -> str:
        """Return the firmware's greeting and the answer to ``$I``."""
        with self._guarded():
            return "; ".join([self._greeting, *(line.strip("[]") for line in self.do("$I"))])

    def fault(self) -> str | None:
        """Return a description of the fault, or None."""
        with self._guarded():
            state = self.state()
        asleep = self._enabled and state == "Sleep"
        return "the motor is asleep though it was switched on" if asleep else FAULTS.get(state)

    def _prepare(self, settings: RigSettings) -> None:
        if settings.accept != "moving" and self.name.startswith("tcp:"):  # opening a serial port resets the board
            check_free(self.name, "moving" if self._is_moving() else "", settings)
        self._greeting = self._wake_up()
        self._steps_per_deg = self._stored(STEPS)[1]
        self._fastest = self._stored(RATE)[1] / 60.0
        self._acceleration = self._stored(ACCELERATION)[1]
        self._home = self._read_position()

    def _wake_up(self) -> str:
        """Reset and return the greeting. If the reset interrupts motion or sleep, clear the alarm that follows."""
        self._last = math.nan
        try:
            answer = self._resynchronise()
        except RigTimeout:  # opening a serial port restarts some boards
            answer = ""
        greeting = self.reset()
        if self.state() == "Alarm" and any(f"<{state}" in answer for state in ("Sleep", *MOVING)):
            self.do("$X")
        return greeting

    def _stored(self, first: int) -> tuple[int, float]:
        """Return the number and the value of a setting of the axis. `first` is the number for the first axis."""
        settings = dict(line.removeprefix("$").split("=", 1) for line in self.do("$$") if line.startswith("$"))
        index = first + AXES.index(self.axis)
        number = index if str(index) in settings else first
        text = settings.get(str(number), "nothing").split(" ")[0]
        value = number_of(text)
        if not 0.0 < value < 1e9:
            raise LinkError(
                f"{self.name}: ${number} must be positive, got {text}. Set it on the board, and check cable and baud rate."
            )
        return number, value

    def _switch(self, on: bool) -> bool:
        """Wake the motor up, or put it to sleep (``$SLP``)."""
        if not on:
            self.do("$SLP")
            return self._reach("Sleep")
        if self.state() == "Sleep":
            self._wake_up()
        is_awake = self._reach("Idle")
        self._read_position()
        return is_awake

    def _reach(self, state: str) -> bool:
        """Poll the status until the board is in a given state, for at most 2 s."""

        def has_arrived() -> bool:
            actual = self.state()
            if actual in FAULTS:
                raise RigFault(f"{self.name}: expected state {state}, got {FAULTS[actual]}. Check the table.")
            return actual == state

        return bool(self.clock.until(has_arrived, 2.0))

    def _set_ramps(self, acceleration: float) -> float:
        """Set ``$120`` or a next setting, which the board stores. It accepts a setting only at rest."""
        self._stop()
        number, _ = self._stored(ACCELERATION)
        self.do(f"${number}={acceleration:.3f}")
        _, actual = self._stored(ACCELERATION)
        if abs(actual - round(acceleration, 3)) > 1e-3:
            raise LinkError(
                f"{self.name}: set ${number}={acceleration:.3f}, but the board returned {actual:g}. Check cable and baud rate."
            )
        return actual

    def _plan_move(self, rate: float, seconds: float) -> tuple[float, float]:
        rate = round(60.0 * rate, 3) / 60.0
        if not SLOWEST_DEG_PER_MIN <= 60.0 * abs(rate) <= 60.0 * self._fastest:
            raise LimitError(
                f"turn rate must be {SLOWEST_DEG_PER_MIN / 60:.4f} to {self._fastest:g} deg/s, got {abs(rate):.4f}. "
                "Choose another rate.",
                turn_rate=rate,
            )
        steps = round(steady_angle(rate, seconds, self._acceleration) * self._steps_per_deg)
        return rate, steps / self._steps_per_deg

    def _move(self, rate: float, distance: float) -> float:
        self.do(f"$J=G91G21{self.axis}{distance:.5f}F{60.0 * abs(rate):.3f}")
        return abs(rate)

    def _is_moving(self) -> bool:
        return self.state() in MOVING

    def _halt(self) -> None:
        if self._is_moving():
            self.send(JOG_CANCEL)

    def _come_to_rest(self) -> None:
        self._resynchronise()
        with contextlib.suppress(RigTimeout, RigFault):
            self._wait_for_rest(4.0)  # a reset during motion loses the position
        self.reset()

    def _ask_position(self) -> float:
        """Return the machine position of the axis, deg."""
        _, places = self.status()
        index = AXES.index(self.axis) if len(places) > 1 else 0
        if index >= len(places):
            raise LinkError(
                f"{self.name}: no position of axis {self.axis} among the {len(places)} positions. Set another axis."
            )
        return places[index]

    # ---- Commands and questions

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
        line = self._lines("?", status_end)[-1]
        match = STATUS.fullmatch(line)
        if match is None:
            raise LinkError(f"{self.name}: expected a status line, got {line!r}. Check cable and baud rate.")
        if match[2] != "M":
            raise LinkError(f"{self.name}: the board reports work positions, not machine positions. Set $10 to 1.")
        return match[1], [float(number) for number in match[3].split(",")]

    def state(self) -> str:
        """Return the state."""
        return self.status()[0]

    def _resynchronise(self) -> str:
        """Ask for the status and discard all bytes before it. Return the status line."""
        return self.exchange("?", until=status_end, anew=True)

    def reset(self) -> str:
        """Reset (0x18) and return the greeting. Motion ends immediately, the queue is cleared and the link is in step."""
        wait_s = max(self.reply_timeout_s, 3.0)
        answer = self.exchange(RESET.decode("latin-1"), wait_s, until=welcome_end, anew=True)
        return answer.strip().splitlines()[-1]

    def _lines(self, question: str, until: re.Pattern[bytes] | None = None) -> list[str]:
        """Return the lines of an answer. Raise LinkError for a line that GRBL never sends."""
        lines = [line.strip() for line in self.exchange(question, until=until).splitlines() if line.strip()]
        for line in lines:
            if not KNOWN.fullmatch(line):
                raise LinkError(f"{self.name}: {line!r} is not an answer to '{question}'. Check cable and baud rate.")
        return lines
