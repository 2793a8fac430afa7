"""Driver for one servo axis of a Galil motion controller (DMC-14xx, 2x00, 40x0, 41x3, 30010).

A command ends with a carriage return. The card answers ``:`` if it accepts the command and ``?`` if it rejects it. TC1 then returns
the reason. The answer to a question is text before the ``:``. An answer of any other form raises LinkError, so a corrupted answer
never moves a rig. Every number is rounded as the card rounds it before it is sent, and is read back before it is used.

A turn is a move by a known distance (SP, PR, BG), which the card ends itself, even if this program has ended. If an answer is late
or corrupted, the driver stops the axis (ST, then AB), switches the motor off (MO) and reports whether the card confirmed the stop.

Sources: command references DMC-1400, 2x00 and 40x0.
"""

import math
import re

from undrift.errors import LinkError, RigFault, RigTimeout
from undrift.rig.link import LinkedRig
from undrift.rig.rig import COMMANDS, RigSettings, ServoReport, check_free, in_words, steady_angle, to_counts
from undrift.units import RADIAN_PER_DEGREE

# ---- Commands and answers. An x in a question is the letter of the axis.

NUMBER = r" *(-? ?\d{1,12}(?:\.\d{1,8})?) *"
BIT = r" *([01])(?:\.0{1,8})? *"
BYTE = r" *(25[0-5]|2[0-4]\d|[01]?\d?\d)(?:\.0{1,8})? *"
TEN_DIGITS = r" *(-?\d{10}) *"  # a fixed number of digits, so that a lost byte is detected
QUESTIONS = {  # command, and form of its answer
    "position": ("MG _TPx{F10.0}", TEN_DIGITS),
    "following error": ("MG _TEx{F10.0}", TEN_DIGITS),
    "is moving": ("MG _BGx", BIT),
    "is off": ("MG _MOx", BIT),
    "switches": ("TSx", BYTE),
    "stop code": ("SCx", BYTE),
    "kp": ("MG _KPx", NUMBER),
    "ki": ("MG _KIx", NUMBER),
    "kd": ("MG _KDx", NUMBER),
    "sample period": ("MG _TM", NUMBER),  # us
}
MODEL = r"([^?\x00-\x1f\x7f]+)"
ERROR_CODE = r"\s*(\d{1,3})\b[^?]*"
AXES = "ABCDEFGHXYZW"  # A and X are the first axis


STOPS_THAT_ARE_FAULTS = (2, 3, 6, 8, 99)
START_ACCELERATION = 256_000.0  # default of the card, set at opening, counts/s2
ERROR_LIMIT = 5.0 * RADIAN_PER_DEGREE  # following error at which the card switches the motor off (ER, OE1)


class GalilRig(LinkedRig):
    """A rate table with a Galil card. It does not move until `turn_for`."""

    stopped = "The table was stopped and its motor switched off."
    unconfirmed = "It is NOT CONFIRMED that the table stopped. Cut the amplifier's power."
    axes, default_axis = AXES, "X"
    terminator, unit = "\r", "counts"
    baud = 19_200
    reply_end = re.compile(rb"(?:^|\n)[:?]")  # prompt at the start of a line

    def __init__(self, url: str, settings: RigSettings = RigSettings()) -> None:
        self.rad_per_unit, self.slack = settings.count, math.radians(10.0) / settings.count
        self._token = 41_000  # number that the card prints to resynchronise
        super().__init__(url, settings)

    def identify(self) -> str:
        """Return the card's model and firmware, from control-R control-V."""
        with self._guarded():
            return self.ask("\x12\x16", MODEL)[0].strip()

    def following_error(self) -> float:
        """Return commanded minus actual angle (TE), rad."""
        with self._guarded():
            return self.read("following error") * self.rad_per_unit

    def fault(self) -> str | None:
        """Return a description of the faults (TS, SC), or None."""
        with self._guarded():
            faults = wrong_switches(int(self.read("switches")), self._enabled)
            code = int(self.read("stop code"))
        if code in STOPS_THAT_ARE_FAULTS:
            faults.append(f"{in_words('galil_stop', code)} (stop code {code})")
        return "; ".join(faults) or None

    def read_servo(self) -> ServoReport:
        """Return the gains (KP, KI, KD) and the sample period (TM) of the card."""
        with self._guarded():
            gains = {name: self.read(name) for name in ("kp", "ki", "kd")}
            return ServoReport(sample_s=1e-6 * self.read("sample period"), **gains)

    def _prepare(self, settings: RigSettings) -> None:
        largest, off = COMMANDS["PR"][1], f"MO{self.axis}\r".encode()
        self.halt = f"ST{self.axis}\r".encode()
        self.last_words = (self.halt, b"AB\r", off, off)  # the card rejects MO until AB has ended the motion
        self._fastest, self._acceleration = settings.limits.turn_rate / self.rad_per_unit, START_ACCELERATION
        self._resynchronise()
        is_moving, is_on = self._is_moving(), self.read("is off") == 0.0
        check_free(self.name, "moving" if is_moving else "its motor on" if is_on else "", settings)
        with self._guarded():
            self.exchange("EO 0")  # switch the echo off
            self._resynchronise()
            if is_moving:
                self._stop()
            self.set("ER", max(1, round(ERROR_LIMIT / self.rad_per_unit)), tolerance=1)
            self.set("OE", 1)
            self._acceleration = self._set_ramps(min(START_ACCELERATION, self.limits.acceleration / self.rad_per_unit))
            self._enabled = self.read("is off") == 0.0
            self._home = self._read_position()
            forward, reverse = float(largest), -float(largest)  # switch the limits off
            if self.limits.travel is not None:
                reach = int(self.limits.travel / self.rad_per_unit)
                forward, reverse = self._home + reach, self._home - reach
            self.set("FL", forward, tolerance=2)
            self.set("BL", reverse, tolerance=2)

    def _switch(self, on: bool) -> bool:
        self._command("SH" if on else "MO")
        return (self.read("is off") == 0.0) == on

    def _set_ramps(self, acceleration: float) -> float:
        actual = self.set("AC", to_counts("AC", acceleration), tolerance=1024)
        return self.set("DC", actual)

    def _plan_move(self, rate: float, seconds: float) -> tuple[float, float]:
        speed = to_counts("SP", rate)
        return speed, to_counts("PR", steady_angle(speed, seconds, self._acceleration))

    def _move(self, rate: float, distance: float) -> float:
        actual = self.set("SP", abs(rate), tolerance=1)
        self.set("PR", distance)
        self._command("BG")
        return actual

    def _is_moving(self) -> bool:
        return self.read("is moving") == 1.0

    def _halt(self) -> None:
        self._command("ST")

    def _come_to_rest(self) -> None:
        self._resynchronise()
        try:
            self._stop()
        except (RigTimeout, RigFault):
            self.ask("AB")
            self._wait_for_rest()

    def _ask_position(self) -> float:
        return self.read("position")

    def _command(self, letters: str) -> None:
        self.ask(f"{letters}{self.axis}")

    # ---- Commands and questions

    def ask(self, command: str, form: str = "") -> tuple[str, ...]:
        """Send a command and return the groups of its answer, which must have a given form. By default, the form is a bare ``:``.

        If the card rejects the command, raise RigFault with the reason from TC1.
        """
        reply = self.exchange(command)
        if reply == "?" and command != "TC1":
            code = int(self.ask("TC1", ERROR_CODE)[0])
            raise RigFault(
                f"{self.name}: the card rejected '{command}' (error {code}: {in_words('galil_error', code)}). Check the state "
                "of the card.",
                code=code,
                command=command,
            )
        match = re.fullmatch(rf"[\r\n]*{form}[\r\n]*:", reply)
        if match is None:
            raise LinkError(f"{self.name}: {reply!r} is not an answer to '{command}'. Check cable and baud rate.")
        return match.groups()

    def read(self, question: str) -> float:
        """Ask one of QUESTIONS and return the number in its answer."""
        command, form = QUESTIONS[question]
        return _number(self.ask(command.replace("x", self.axis), form))

    def set(self, name: str, value: float, *, tolerance: float = 0.0) -> float:
        """Set a parameter of the axis, read it back and return it."""
        assignment = f"{name} {',' * (AXES.index(self.axis) % 8)}"
        self.ask(f"{assignment}{value:.10g}")
        actual = _number(self.ask(f"{assignment}?", NUMBER))
        if abs(actual - value) > tolerance:
            raise LinkError(
                f"{self.name}: set {name} to {value:.10g}, but the card returned {actual:.10g}. Check cable and baud rate.",
                wanted=value,
                held=actual,
            )
        return actual

    def _resynchronise(self) -> None:
        """Ask the card to print a number that was not used before, and discard all bytes before that number."""
        for attempt in range(3):
            self._token += 1
            number = re.compile(rb"(?<!\d)0*%d(?:\.0*)?[ ]*\r?\n:" % self._token)  # leading zeros, decimals
            try:
                self.exchange(f"MG {self._token}", until=number, anew=True)
                return
            except RigTimeout:
                if attempt == 2:
                    raise


def _number(groups: tuple[str, ...]) -> float:
    return float(groups[0].replace(" ", ""))


def wrong_switches(byte: int, enabled: bool) -> list[str]:
    """Return the faults in the byte from TS. The bit of a limit switch is 1 if the switch is not pressed."""
    faults = (
        (enabled and byte & 0x20, "the motor is off though it was switched on"),
        (byte & 0x40, "the following error is beyond its limit"),
        (not byte & 0x08, "the forward limit switch is pressed"),
        (not byte & 0x04, "the reverse limit switch is pressed"),
    )
    return [text for is_set, text in faults if is_set]
