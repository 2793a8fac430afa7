"""Driver for one servo axis of a Galil motion controller (DMC-14xx, 2x00, 40x0, 41x3, 30010).

A command ends with a carriage return. The card answers ``:`` if it accepts the command and ``?`` if it rejects it. TC1 then returns
the reason. The answer to a question is text before the ``:``. An answer of any other form raises LinkError, so a corrupted answer
never moves a rig. Every number is rounded as the card rounds it before it is sent, and is read back before it is used.

A turn is a move by a known distance (SP, PR, BG), which the card ends itself, even if this program has ended.

A position (TP) is timed half-way between question and answer. If an answer is late or corrupted, the driver stops the axis (ST,
then AB) and switches the motor off (MO). It then reports if the card confirmed the stop.

Sources: command references DMC-1400, 2x00 and 40x0.
"""

import contextlib
import logging
import math
import re

from undrift.base.clock import HOST, Clock
from undrift.errors import InputError, LinkError, RigError, RigFault, RigTimeout
from undrift.rig.link import Link, LinkedRig, ask_until
from undrift.rig.rig import (
    ACCELERATION,
    LONGEST_MOVE,
    MOVE,
    SLEW,
    RigSettings,
    ServoReport,
    check_free,
    in_words,
    steady_angle,
)
from undrift.units import RADIAN_PER_DEGREE

# ---- Commands and answers. An x in a question is the letter of the axis.

NUMBER = r" *(-? ?\d{1,12}(?:\.\d{1,8})?) *"
BIT = r" *([01])(?:\.0{1,8})? *"
BYTE = r" *(25[0-5]|2[0-4]\d|[01]?\d?\d)(?:\.0{1,8})? *"
TEN_DIGITS = r" *(-?\d{10})"  # a fixed number of digits, so that a lost byte is detected
QUESTIONS = {  # command, and form of its answer
    "position": ("MG _TPx{F10.0}", rf"{TEN_DIGITS} *"),
    "following error": ("MG _TEx{F10.0}", rf"{TEN_DIGITS} *"),
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
AXES = "ABCDEFGH"

log = logging.getLogger(__name__)


class GalilCard(Link):
    """Commands and questions for one axis of a card."""

    terminator = "\r"
    reply_end = re.compile(rb"(?:^|\n)[:?]")  # prompt at the start of a line

    def __init__(
        self, url: str, axis: str = "X", *, reply_timeout_s: float = 2.0, baud: int = 19200, clock: Clock = HOST
    ) -> None:
        self.axis, self._token = axis, 41_000
        self._commas = "," * (AXES.index(axis) if axis in AXES else "XYZW".index(axis))
        super().__init__(url, reply_timeout_s=reply_timeout_s, baud=baud, clock=clock)

    def ask(self, command: str, form: str = "") -> tuple[str, ...]:
        """Send a command and return the groups of its answer, which must have a form. By default, the form is a bare ``:``.

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

    def read(self, question: str) -> list[float]:
        """Ask one of QUESTIONS and return the numbers of its answer."""
        command, form = QUESTIONS[question]
        return [float(text.replace(" ", "")) for text in self.ask(command.replace("x", self.axis), form)]

    def set(self, name: str, value: float, *, tolerance: float = 0.0) -> float:
        """Set a parameter of the axis, read it back and return it."""
        self.ask(f"{name} {self._commas}{value:.10g}")
        (text,) = self.ask(f"{name} {self._commas}?", NUMBER)
        actual = float(text.replace(" ", ""))
        if abs(actual - value) > tolerance:
            raise LinkError(
                f"{self.name}: set {name} to {value:.10g}, but the card returned {actual:.10g}. Check cable and baud rate.",
                wanted=value,
                held=actual,
            )
        return actual

    def shout(self, command: str) -> None:
        """Send without waiting for an answer. The next question reports a lost link."""
        with contextlib.suppress(RigError):
            self.send(f"{command}\r".encode("ascii"))

    def resynchronise(self) -> None:
        """Ask the card to print a number that was not used before, and discard all bytes before that number."""
        for attempt in range(3):
            self._token += 1
            number = re.compile(rb"(?<!\d)0*%d(?:\.0*)?[ ]*\r?\n:" % self._token)  # with leading zeros and decimals
            try:
                self.exchange(f"MG {self._token}", until=number, anew=True)
                return
            except RigTimeout:
                if attempt == 2:
                    raise


# ---- The rig.

STOPS_THAT_ARE_FAULTS = (2, 3, 6, 8, 99)
RECONNECTIONS = 4
STOP_MARGIN_S = 2.0  # added to twice the expected stopping time, s
START_ACCELERATION = 256_000.0  # default of the card, set at opening, counts/s2
ERROR_LIMIT = 5.0 * RADIAN_PER_DEGREE  # following error at which the card switches the motor off (ER, OE1)


class GalilRig(LinkedRig):
    """A rate table with a Galil card. It does not move until `turn_for`."""

    stopped = "The table was stopped and its motor switched off."
    unconfirmed = "It is NOT CONFIRMED that the table stopped. Cut the amplifier's power."
    unit = "counts"

    def __init__(self, card: GalilCard, settings: RigSettings = RigSettings()) -> None:
        self.card, self.rad_per_unit = card, settings.count
        self._acceleration = START_ACCELERATION  # of both ramps, counts/s2
        super().__init__(card, settings)

    def identify(self) -> str:
        """Return the card's model and firmware, from control-R control-V."""
        with self._guarded():
            return self.card.ask("\x12\x16", MODEL)[0].strip()

    def following_error(self) -> float:
        """Return commanded minus actual angle (TE), rad."""
        with self._guarded():
            return self.card.read("following error")[0] * self.rad_per_unit

    def fault(self) -> str | None:
        """Return a description of the faults (TS, SC), or None."""
        with self._guarded():
            faults = wrong_switches(int(self.card.read("switches")[0]), self._enabled)
            code = int(self.card.read("stop code")[0])
        if code in STOPS_THAT_ARE_FAULTS:
            faults.append(f"{in_words('galil_stop', code)} (stop code {code})")
        return "; ".join(faults) or None

    def read_servo(self) -> ServoReport:
        """Return the gains (KP, KI, KD) and the sample period (TM) of the card."""
        with self._guarded():
            gains = {name: self.card.read(name)[0] for name in ("kp", "ki", "kd")}
            sample_s = 1e-6 * self.card.read("sample period")[0]
        return ServoReport(sample_s=sample_s, **gains)

    def enable(self, on: bool) -> None:
        """Switch the motor on (SH), or stop the axis and switch the motor off (MO)."""
        with self._guarded():
            if not on and self._is_moving():
                self._stop()
            self._command("SH" if on else "MO")
            if self._is_on() != on:
                word = "on" if on else "off"
                raise RigFault(f"{self.card.name}: the motor did not switch {word}. Check the amplifier.")
            self._enabled = on

    def set_acceleration(self, acceleration: float) -> float:
        """Set acceleration (AC) and deceleration (DC), multiples of 1024 counts/s2."""
        self.limits.check_acceleration(acceleration)
        counts = ACCELERATION.round(acceleration / self.rad_per_unit)
        with self._guarded():
            self._set_ramps(counts)
        return self._acceleration * self.rad_per_unit

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        """Turn at a steady rate for a time that includes both ramps (SP, PR, BG), and return the rate set in the card."""
        self.limits.check_turn_rate(turn_rate)
        speed = SLEW.round(turn_rate / self.rad_per_unit)
        distance = MOVE.round(steady_angle(speed, seconds, self._acceleration))
        self._check_travel(distance)
        with self._guarded():
            if self._is_moving():
                raise RigFault(f"{self.card.name}: the axis still moves. Stop it first.")
            actual = self.card.set("SP", abs(speed), tolerance=1)
            self.card.set("PR", distance)
            self._command("BG")
        return math.copysign(actual, turn_rate) * self.rad_per_unit

    def stop(self) -> None:
        """Slow down (ST) and wait until the axis is at rest. The motor stays on."""
        with self._guarded():
            self._stop()
            before = self._read_position()
            for _ in range(50):  # the servo settles after the profile ends
                self.clock.wait(0.02)
                counts = self._read_position()
                if abs(counts - before) <= 1:
                    break
                before = counts

    def _prepare(self, settings: RigSettings) -> None:
        """Check that the table is free, configure the card and store the initial position. A running move is stopped."""
        card = self.card
        self._fastest = settings.limits.turn_rate / self.rad_per_unit
        self.slack = math.radians(10.0) / self.rad_per_unit
        card.resynchronise()
        state = "moving" if self._is_moving() else "its motor on" if self._is_on() else ""
        check_free(card.name, state, settings)
        with self._guarded():
            card.exchange("EO 0")  # no echo
            card.resynchronise()
            if state == "moving":
                self._stop()
            card.set("ER", max(1, round(ERROR_LIMIT / self.rad_per_unit)), tolerance=1)
            card.set("OE", 1)
            self._set_ramps(ACCELERATION.round(min(START_ACCELERATION, self.limits.acceleration / self.rad_per_unit)))
            self._enabled = self._is_on()
            self._home = self._read_position()
            forward, reverse = float(LONGEST_MOVE), -float(LONGEST_MOVE)  # no limits in effect
            if self.limits.travel is not None:
                reach = int(self.limits.travel / self.rad_per_unit)
                forward, reverse = self._home + reach, self._home - reach
            card.set("FL", forward, tolerance=2)
            card.set("BL", reverse, tolerance=2)

    def _ask_position(self) -> float:
        return self.card.read("position")[0]

    def _set_ramps(self, counts: int) -> None:
        self._acceleration = self.card.set("AC", counts, tolerance=1024)
        self.card.set("DC", self._acceleration)

    def _command(self, letters: str) -> None:
        self.card.ask(f"{letters}{self.card.axis}")

    def _is_moving(self) -> bool:
        return self.card.read("is moving") == [1.0]

    def _is_on(self) -> bool:
        return self.card.read("is off") == [0.0]

    def _stop(self) -> None:
        self._command("ST")
        self._wait_for_rest(self._fastest / self._acceleration)

    def _wait_for_rest(self, expected_s: float) -> None:
        """Poll until the profile is complete, for at most twice the expected time plus 2 s."""
        allowed_s = 2.0 * expected_s + STOP_MARGIN_S
        if not ask_until(lambda: not self._is_moving(), self.clock, allowed_s):
            raise RigTimeout(
                f"{self.card.name}: the axis is still moving after {allowed_s:.3g} s. Check the table.",
                deadline_s=allowed_s,
            )

    def _make_safe(self) -> bool:
        """Stop (ST, or AB if that fails) and switch the motor off (MO). Reconnect first if the link is lost."""
        card, self._enabled = self.card, False
        try:
            if not card.is_open:
                self._refused = "the connection was lost, and the card may have lost its commands"
                self._reconnect()
            card.shout(f"ST{card.axis}")  # stop at once (the next line discards the answer)
            card.resynchronise()
            try:
                self._stop()
            except (RigTimeout, RigFault):
                card.ask("AB")
                self._wait_for_rest(0.0)
            self._command("MO")
            return not self._is_on()
        except RigError as error:
            log.error("%s: not confirmed at rest: %s", card.name, error)
            self._refused = "it could not be brought to rest"
            # The card may still receive commands. It rejects MO until AB has ended the motion.
            for command in (f"ST{card.axis}", "AB", f"MO{card.axis}", f"MO{card.axis}"):
                card.shout(command)
                self.clock.wait(0.05)
            return False

    def _reconnect(self) -> None:
        """Reconnect, with repeated attempts, because a card does not answer immediately after a restart."""
        for _ in range(RECONNECTIONS - 1):
            with contextlib.suppress(LinkError):
                return self.card.reconnect()
            self.clock.wait(0.3)
        return self.card.reconnect()


def wrong_switches(byte: int, enabled: bool) -> list[str]:
    """Return the faults in the byte from TS. The bit of a limit switch is 1 if the switch is not pressed."""
    faults = (
        (enabled and byte & 0x20, "the motor is off though it was switched on"),
        (byte & 0x40, "the following error is beyond its limit"),
        (not byte & 0x08, "the forward limit switch is pressed"),
        (not byte & 0x04, "the reverse limit switch is pressed"),
    )
    return [text for is_set, text in faults if is_set]


def open_from(url: str, settings: RigSettings) -> GalilRig:
    """Open a Galil rig."""
    if settings.axis not in ("", *"ABCDEFGHXYZW"):
        raise InputError(f"galil: axis must be A to H, X, Y, Z or W, got '{settings.axis}'. Set another axis.")
    return GalilRig(GalilCard(url, settings.axis or "X", **settings.link()), settings)
