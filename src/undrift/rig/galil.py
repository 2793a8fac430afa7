"""Galil motion controllers (DMC-14xx, 2x00, 40x0, 41x3, 30010): one servo axis behind an ASCII language.

A command ends with a carriage return. The card answers ``:`` when it accepts, ``?`` when it refuses (TC1 then gives the reason),
and text before the ``:`` when it was asked for some. An answer that is not exactly of the kind that was asked for is a LinkError:
a rig never moves on garbage. Rates are counts/s of an encoder with 4 counts a line. Every number is rounded as the card rounds it
before it is sent, and read back before it is used, so that a lost byte never becomes a wrong rate.

The rate that was achieved is the difference of positions (TP) over the time between them by the card's own clock; its TV is an
average over 0.25 s and is not used. TP and TIME come in one answer; cards that do not give both give TP alone, half-way between
question and answer. A position that no axis can have reached since the last one is garbage.

Whenever an answer is late or makes no sense the driver stops the axis (ST, then AB), switches the motor off (MO), and reports
whether the card confirmed it. Waiting for rest polls ``MG _BG``, which is 1 while the profile runs.

Servo filter of older cards (1000, 1400, 1500 and Optima): D(z) = 4 KP + 4 KD (1 - 1/z) + KI / 2 / (1 - 1/z); newer ones leave out
the fours. The card records positions and errors into arrays (RA, RD, RC) every 2^n samples by itself.

Sources: command references DMC-1400, 2x00 and 40x0; user manuals DMC-1700/1800 p. 159 and DMC-1600 p. 142 (arrays).
"""

import cmath
import logging
import math
import re
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError, LimitError, LinkError, RigError, RigFault, RigTimeout
from undrift.rig.link import CardClock, Clock, GalilPort, GclibPort, LinkPort, LinkSettings
from undrift.rig.rig import (
    ACCELERATION,
    JOG,
    JOG_BY_TWO,
    LONGEST_MOVE,
    MOVE,
    SLEW,
    CountScale,
    Gains,
    Limits,
    Position,
    RigSettings,
    Trace,
    parse_address,
)
from undrift.units import RADIAN_PER_DEGREE

# ---- What the numbers of a Galil card mean: error codes (TC), stop codes (SC), switches (TS), in words a bench can act on.

ERRORS = {
    1: "the command is not known to this card",
    2: "the command works only inside a program",
    3: "the command does not work inside a program",
    4: "an operand is wrong",
    5: "the input buffer is full: too much was sent at once",
    6: "the number is out of range",
    7: "not allowed while the axis moves",
    8: "not allowed while the axis rests",
    9: "a variable is wrong",
    10: "an empty program line or an unknown label",
    11: "a wrong label or line number",
    12: "subroutines are nested too deep",
    13: "a jog speed may change only while jogging",
    14: "the card's memory fails its checksum",
    15: "the card's memory could not be written",
    16: "the new target lies behind a running move",
    17: "not allowed while a program runs",
    18: "not allowed in contour mode",
    19: "that program thread runs already",
    20: "a move needs the motor on",
    21: "a move is running already",
    22: "a limit switch forbids the move",
    24: "no sequence of moves is defined",
    28: "that operand cannot be used here",
    29: "not allowed during a coordinated move",
    50: "arguments are missing",
    51: "a question mark is not allowed here",
    52: "a quote is missing or the text is too long",
    53: "the braces are wrong",
    55: "a bracket is missing",
    56: "an array index is out of range",
    57: "the function or array is not known",
    58: "the operand is not known",
    59: "the parentheses do not match",
    66: "no room for arrays",
    67: "too many arrays or variables",
    80: "recording runs already",
    82: "the array is not defined",
    83: "not a number",
    84: "too many elements",
    90: "only an axis letter is allowed here",
    131: "the serial port timed out",
    143: "the card did not settle on the new sample time",
}
STOPS = {
    0: "running",
    1: "at the commanded position",
    2: "stopped by the forward limit",
    3: "stopped by the reverse limit",
    4: "stopped by command",
    6: "stopped by the abort input",
    7: "stopped by an abort command",
    8: "switched off because the following error passed its limit",
    9: "stopped after finding an edge",
    10: "stopped after homing",
    50: "contour running",
    51: "contour stopped",
    99: "timed out before reaching the position",
    100: "vector move running",
    101: "vector move stopped",
}
STOPS_THAT_ARE_FAULTS = (2, 3, 6, 8, 99)


@dataclass(frozen=True, slots=True, kw_only=True)
class Switches:
    """The byte that TS returns."""

    moving: bool  # The profile runs
    error_beyond_limit: bool  # The following error is larger than ER
    motor_off: bool  # The amplifier is not enabled
    forward_limit: bool  # The forward limit switch is pressed
    reverse_limit: bool  # The reverse limit switch is pressed

    @classmethod
    def from_byte(cls, byte: int) -> "Switches":
        """Read the bits; a limit switch that is not pressed reads 1."""
        return cls(
            moving=bool(byte & 0x80),
            error_beyond_limit=bool(byte & 0x40),
            motor_off=bool(byte & 0x20),
            forward_limit=not byte & 0x08,
            reverse_limit=not byte & 0x04,
        )

    def wrong(self, enabled: bool) -> list[str]:
        """Say what is not as it should be."""
        seen = (
            (enabled and self.motor_off, "the motor is off though it was switched on"),
            (self.error_beyond_limit, "the following error is beyond its limit"),
            (self.forward_limit, "the forward limit switch is pressed"),
            (self.reverse_limit, "the reverse limit switch is pressed"),
        )
        return [words for is_so, words in seen if is_so]


def error_in_words(code: int) -> str:
    """Say what an error code means."""
    return ERRORS.get(code, "an error that is not listed here; see TC in the card's command reference")


def stop_in_words(code: int) -> str:
    """Say why the axis stopped."""
    return STOPS.get(code, "a reason that is not listed here; see SC in the card's command reference")


# ---- The language of Galil cards: one command, one answer, read strictly.

NUMBER = re.compile(r"[ ]*-?[ ]?\d{1,12}(?:\.\d{1,8})?[ ]*")
CABLE = "check cable and baud"
AXES = "ABCDEFGH"


class GalilCard:
    """Commands and questions to one axis of a card."""

    def __init__(self, port: GalilPort, axis: str = "X") -> None:
        self.port = port
        self.axis = axis
        self.commas = "," * (AXES.index(axis) if axis in AXES else "XYZW".index(axis))
        self._digits: int | None = None
        self._tells_signs: bool | None = None  # of a jog speed that is read back

    def do(self, command: str, deadline_s: float | None = None) -> None:
        """Give a command that has no answer but ``:``."""
        answer = self.port.ask(command, deadline_s)
        if answer is None:
            raise _refusal(self.port, command)
        if answer:
            raise LinkError(f"{self.port.name}: wanted ':' in answer to '{command}', got {answer!r}; {CABLE}")

    def tries(self, command: str) -> bool:
        """Give a command that older cards may not know."""
        return self.port.ask(command) is not None

    def text(self, command: str, deadline_s: float | None = None) -> str:
        """Ask for text."""
        answer = self.port.ask(command, deadline_s)
        if answer is None:
            raise _refusal(self.port, command)
        return answer.strip("\r\n")

    def number(self, command: str) -> float:
        """Ask for a number."""
        answer = self.text(command)
        if not NUMBER.fullmatch(answer):
            raise LinkError(f"{self.port.name}: wanted a number in answer to '{command}', got {answer!r}; {CABLE}")
        return float(answer.replace(" ", ""))

    def integer(self, command: str, smallest: int = -(2**31), largest: int = 2**31 - 1) -> int:
        """Ask for a whole number."""
        value = self.number(command)
        if value != int(value) or not smallest <= value <= largest:
            raise LinkError(
                f"{self.port.name}: wanted a whole number from {smallest} to {largest} in answer to '{command}', "
                f"got {value:g}; {CABLE}"
            )
        return int(value)

    def position(self, command: str) -> int:
        """Ask for a position, which the card writes with a fixed number of digits once `fix_format` was called."""
        answer = self.text(command)
        digits = sum(character.isdigit() for character in answer)
        if not re.fullmatch(r" *-? ?\d{1,10} *", answer) or (self._digits is not None and digits != self._digits):
            raise LinkError(f"{self.port.name}: wanted counts in answer to '{command}', got {answer!r}; {CABLE}")
        return int(answer.replace(" ", ""))

    def fix_format(self) -> None:
        """Have positions written with ten digits, so that a lost byte shows; cards that will not are taken as they are."""
        if self.tries("PF 10.0") and self.tries("LZ 0"):
            answer = self.text(f"TP{self.axis}")
            digits = sum(character.isdigit() for character in answer)
            self._digits = 10 if digits == 10 else None

    def set(self, name: str, value: float, *, tolerance: float = 0.0, magnitude: bool = False) -> float:
        """Set a parameter of the axis and read it back."""
        tell, ask = f"{name} {self.commas}{value:.10g}", f"{name} {self.commas}?"
        self.do(tell)
        held = self.number(ask)
        if magnitude and value < 0.0:
            if held > 0.0 and self._tells_signs is None:  # a minus sign that was lost, or such a card
                self.do(tell)
                held = self.number(ask)
            self._tells_signs = self._tells_signs or held < 0.0
            held = held if self._tells_signs else -held
        if abs(held - value) > tolerance:
            raise LinkError(
                f"{self.port.name}: wanted {name} {value:.10g}, got {held:.10g} when it was read back; {CABLE}",
                wanted=value,
                held=held,
            )
        return held


def _refusal(port: GalilPort, command: str) -> RigFault:
    """Return what TC1 says about the last ``?``, in our words."""
    answer = port.ask("TC1") or ""
    found = re.match(r"\s*(\d{1,3})\b", answer)
    if not found:
        raise LinkError(f"{port.name}: wanted an error code in answer to 'TC1', got {answer!r}; {CABLE}")
    code = int(found.group(1))
    return RigFault(
        f"{port.name}: wanted '{command}', got error {code}: {error_in_words(code)}; see the state of the card",
        code=code,
        command=command,
    )


# ---- Where the axis of a Galil card is, in counts, and when that was.

BOTH = re.compile(r" *(-?\d{10}) +(-?\d{10}) *")
FINDING_S = 0.5  # longest look for the card's clock at the start, s of the host; every later position goes on looking


class Place(NamedTuple):
    """Where, and when."""

    counts: int  # TP
    time: float  # s of the clock
    within_s: float  # That time may be off by so much either way, s


class GalilPlace:
    """Reads positions."""

    def __init__(self, card: GalilCard, clock: Clock, fastest: float, slack: float) -> None:
        self.last: int | None = None
        self._card = card
        self._clock = clock
        self._fastest, self._slack = fastest, slack
        self._read_at = 0.0
        self._card_clock: CardClock | None = None
        self._both = f"MG _TP{card.axis}{{F10.0}},TIME{{F10.0}}"  # ten digits each: a lost byte shows

    def find_clock(self) -> None:
        """See whether the card tells a position and its own time in one answer, and for a moment how fast that time runs."""
        answer = self._card.port.ask(self._both)
        if answer is None or not BOTH.fullmatch(answer.strip("\r\n")):
            return
        self._card_clock = CardClock(self._card.number("MG _TM"))
        end = time.monotonic() + FINDING_S
        while self._card_clock.tick_s is None and time.monotonic() < end:
            self.read()
            time.sleep(0.02)

    def read(self) -> Place:
        """Return where it is and when that was."""
        asked, ticks = self._clock.now(), 0
        if self._card_clock is None:
            counts = self._card.position(f"TP{self._card.axis}")
        else:
            counts, ticks = self._counts_and_ticks()
        answered = self._clock.now()
        middle = 0.5 * (asked + answered)
        self._check_reach(counts, answered)
        self.last, self._read_at = counts, asked
        if self._card_clock is None:
            return Place(counts, middle, 0.5 * (answered - asked))
        return Place(counts, *self._card_clock.when(ticks, asked, answered))

    def settled(self) -> int:
        """Return the position once it changes by a count at most; the servo settles after the profile."""
        before = self.read().counts
        for _ in range(50):
            self._clock.wait(0.02)
            now = self.read().counts
            if abs(now - before) <= 1:
                break
            before = now
        return now

    @property
    def sample_s(self) -> float | None:
        """Time between two samples of the servo by the card's clock, s; None where it is not known."""
        return None if self._card_clock is None else self._card_clock.sample_s

    def _counts_and_ticks(self) -> tuple[int, int]:
        answer = self._card.text(self._both)
        found = BOTH.fullmatch(answer)
        if not found:
            raise LinkError(
                f"{self._card.port.name}: wanted two numbers of ten digits in answer to '{self._both}', got {answer!r}; "
                "check cable and baud"
            )
        return int(found.group(1)), int(found.group(2))

    def _check_reach(self, counts: int, now: float) -> None:
        """Allow for all the time that can have passed: from the last question to this answer."""
        if self.last is None:
            return
        reach = 1.5 * self._fastest * (now - self._read_at) + self._slack
        if abs(counts - self.last) > reach:
            raise LinkError(
                f"{self._card.port.name}: wanted a position within {reach:.0f} counts of {self.last}, got {counts}; "
                "the card was restarted, the answer is garbled, or an emulator runs faster than clock_speed says",
                counts=counts,
            )


# ---- One axis of a Galil card: whether it moves, bringing it to rest - and to safety when the link fails.

UNCONFIRMED = "it is NOT CONFIRMED that the table stopped: cut the amplifier's power"
RECONNECTIONS = 4
STOP_MARGIN_S = 2.0  # on top of twice the time that coming to rest should take
AXIS_DECELERATION = 256_000.0  # counts/s2, the card's own default

log = logging.getLogger(__name__)


class GalilAxis:
    """What the axis does, in counts."""

    def __init__(self, card: GalilCard, clock: Clock, fastest: float, place: GalilPlace) -> None:
        self.card = card
        self.deceleration = AXIS_DECELERATION
        self.place = place
        self.refused: str | None = None
        self.enabled = False
        self.jogging = False
        self._clock = clock
        self._fastest = fastest

    def command(self, letters: str) -> None:
        """Give a command to this axis."""
        self.card.do(f"{letters}{self.card.axis}")

    def is_moving(self) -> bool:
        """Return whether the profile runs."""
        return bool(self.card.integer(f"MG _BG{self.card.axis}", 0, 1))

    def is_on(self) -> bool:
        """Return whether the motor is on."""
        return not self.card.integer(f"MG _MO{self.card.axis}", 0, 1)

    def stop_code(self) -> int:
        """Return why it stopped."""
        return self.card.integer(f"SC{self.card.axis}", 0, 255)

    def wait_for_rest(self, expected_s: float) -> None:
        """Poll until the profile is complete: at most twice as long as it should take, and 2 s."""
        allowed_s = 2.0 * expected_s + STOP_MARGIN_S
        last = time.monotonic() + max(allowed_s / self._clock.speed, 0.5 * STOP_MARGIN_S)
        while self.is_moving():
            if time.monotonic() > last:
                raise RigTimeout(
                    f"{self.card.port.name}: wanted the axis at rest within {allowed_s:.3g} s, got it still moving; "
                    "look at the table",
                    deadline_s=allowed_s,
                )
            time.sleep(min(0.02, 0.05 / self._clock.speed))

    def stop(self) -> None:
        """Slow down (ST) and wait for the end of the profile; the motor stays on."""
        self.command("ST")
        self.wait_for_rest(self._fastest / self.deceleration)
        self.jogging = False

    @contextmanager
    def guarded(self) -> Iterator[None]:
        """Stop and switch off before the failure of a link is reported."""
        try:
            yield
        except (LinkError, RigTimeout) as error:
            outcome = "the table was stopped and its motor switched off" if self.make_safe() else UNCONFIRMED
            raise type(error)(f"{error}; {outcome}", **error.numbers) from error

    def make_safe(self) -> bool:
        """Stop and switch off, over a new connection where the old one is gone."""
        port = self.card.port
        self.enabled = self.jogging = False
        try:
            if not port.is_open:
                self.refused = "the connection was lost, and the card may have lost its commands"
                self._reconnect()
            port.shout(f"ST{self.card.axis}")  # at once; its answer is thrown away by the next line
            port.resynchronise()
            self.come_to_rest()
            self.command("MO")
            return not self.is_on()
        except RigError as error:
            log.error("%s: not confirmed at rest: %s", port.name, error)
            self.refused = "it could not be brought to rest"
            self._stop_in_the_dark()
            return False

    def _stop_in_the_dark(self) -> None:
        """Give the card, which may still listen, time for each; MO is refused until AB has ended the motion."""
        for command in (f"ST{self.card.axis}", "AB", f"MO{self.card.axis}", f"MO{self.card.axis}"):
            self.card.port.shout(command)
            time.sleep(0.05)

    def come_to_rest(self) -> None:
        """Stop (ST), or abort (AB) where that does not help."""
        try:
            self.stop()
        except (RigTimeout, RigFault):
            self.card.do("AB")
            self.wait_for_rest(0.0)

    def _reconnect(self) -> None:
        """A card that was restarted needs a moment before it answers."""
        for attempt in range(RECONNECTIONS):
            try:
                self.card.port.reconnect()
                return
            except LinkError:
                if attempt == RECONNECTIONS - 1:
                    raise
                time.sleep(0.3)


# ---- What a Galil rig says without moving: who it is, where it stands, how far behind it is, what is wrong with it.


@dataclass(frozen=True, slots=True, kw_only=True)
class GalilSettings:
    """What the driver cannot ask the card."""

    limits: Limits = field(default_factory=Limits)  # Of the commands
    encoder_lines: int = 10_000  # Lines of the encoder; a turn is 4 times as many counts
    axis: str = "X"  # Letter of the axis, A to H or X, Y, Z, W
    speed_step: int = 1  # Counts/s between two jog speeds: 1, or 2 on older cards
    move_turn_rate: float = 90.0 * RADIAN_PER_DEGREE  # Rate of `move_by`, rad/s
    # Following error at which the card switches the motor off by itself (ER, OE1), rad
    error_limit: float = 5.0 * RADIAN_PER_DEGREE
    clock: Clock = field(default_factory=Clock)  # Hardware's, or a faster emulator's

    def __post_init__(self) -> None:
        if self.axis not in tuple("ABCDEFGHXYZW"):
            raise InputError(f"galil: wanted an axis A to H or X, Y, Z, W, got '{self.axis}'; name one")
        if self.speed_step not in (1, 2):
            raise InputError(f"galil: wanted speed_step 1 or 2, got {self.speed_step}; see JG in the card's manual")


class GalilReports:
    """A Galil rig as far as it only says things; GalilRig moves it."""

    def __init__(self, port: GalilPort, settings: GalilSettings) -> None:
        self._settings = settings
        self._scale = CountScale.from_lines(settings.encoder_lines)
        self._move_speed = SLEW.round(self._scale.counts(min(settings.move_turn_rate, settings.limits.turn_rate)))
        fastest = max(self._scale.counts(settings.limits.turn_rate), self._move_speed)
        self.card = GalilCard(port, settings.axis)
        place = GalilPlace(self.card, settings.clock, fastest, slack=self._scale.counts_per_turn / 36.0)
        self._axis = GalilAxis(self.card, settings.clock, fastest, place)
        self._closed = False
        self._home = 0

    @property
    def limits(self) -> Limits:
        """Limits of its commands."""
        return self._settings.limits

    def identify(self) -> str:
        """Return the card's model and firmware, as it answers to control-R control-V."""
        with self._guarded():
            answer = self.card.text("\x12\x16").strip()
            if not answer.isprintable() or not answer:
                raise LinkError(f"{self.card.port.name}: wanted a model in answer to ^R^V, got {answer!r}; check baud")
            return answer

    def position(self) -> Position:
        """Return where the axis stands (TP) and when by the card's own TIME, from where it stood when the rig was opened, rad."""
        with self._guarded():
            place = self._axis.place.read()
        return Position(angle=self._angle(place.counts), time=place.time, within_s=place.within_s)

    def measured_turn_rate(self, duration_s: float) -> float:
        """Return the mean rate over a while, from two positions."""
        return self._settings.clock.mean_turn_rate(self.position, duration_s)

    def following_error(self) -> float:
        """Return commanded minus actual angle (TE), rad."""
        with self._guarded():
            return self._scale.angle(self.card.position(f"TE{self.card.axis}"))

    def fault(self) -> str | None:
        """Return what is wrong in words (TS, SC), None when all is well."""
        with self._guarded():
            switches = Switches.from_byte(self.card.integer(f"TS{self.card.axis}", 0, 255))
            code = self._axis.stop_code()
        wrong = [*switches.wrong(self._axis.enabled)]
        if code in STOPS_THAT_ARE_FAULTS:
            wrong.append(f"{stop_in_words(code)} (stop code {code})")
        return "; ".join(wrong) or None

    def _angle(self, counts: int) -> float:
        return self._scale.angle(counts - self._home)

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Refuse a rig that is closed or lost; else let the axis guard what is done."""
        why = "it is closed" if self._closed else self._axis.refused
        if why:
            raise LinkError(f"{self.card.port.name}: wanted a rig ready for commands, got none: {why}; open it again")
        with self._axis.guarded():
            yield


# ---- The servo filter, and what the card records of its own loop (RA, RD, RC).

RECORDED = (("UNDRTP", "TP"), ("UNDRTE", "TE"))  # our arrays, and what goes into them: position and following error
ROOM = (500, 250, 100)  # elements of each; small cards have room for 1000 in all arrays
BLOCK = 100  # elements in one answer
UPLOAD_S = 10.0  # longest wait for a block, s: 19,200 baud need one
ELEMENTS = re.compile(r"[ ]*-?[ ]?\d{1,10}(?:\.0{1,4})?(?:,[ ]*-?[ ]?\d{1,10}(?:\.0{1,4})?)*[ ]*")


class GalilServo:
    """The loop that a card closes: its gains, and records of position and error at even samples of the card's own clock."""

    def __init__(
        self,
        card: GalilCard,
        scale: CountScale,
        place: GalilPlace | None = None,
        guarded: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self._card, self._scale, self._place, self._guarded = card, scale, place, guarded
        self._room, self._records, self._period_s = 0, 0, 0.0

    def read_gains(self) -> Gains:
        """Return the servo filter that the card runs (KP, KI, KD)."""
        with self._guarded():
            kp, ki, kd = (self._card.number(f"MG _{name}{self._card.axis}") for name in ("KP", "KI", "KD"))
        return Gains(kp=kp, ki=ki, kd=kd)

    def set_gains(self, gains: Gains) -> Gains:
        """Set the servo filter until the next power-up; what the card holds is returned."""
        wanted = []
        for name, value, step, largest in (
            ("KP", gains.kp, 1 / 8, 1023.875),
            ("KI", gains.ki, 1 / 128, 2047.875),
            ("KD", gains.kd, 1 / 8, 4095.875),
        ):
            if not 0.0 <= value <= largest:
                raise LimitError(f"{name}: wanted 0 to {largest}, got {value:g}; choose another gain", gain=value)
            wanted.append((name, min(step * math.floor(value / step + 0.5), largest), step))
        with self._guarded():
            held = [self._card.set(name, value, tolerance=step) for name, value, step in wanted]
        kp, ki, kd = (
            round(value / step) * step for value, (*_, step) in zip(held, wanted, strict=True)
        )  # shown to 0.01
        return Gains(kp=kp, ki=ki, kd=kd)

    def gains_for(self, margin: float, crossover: float, response: complex) -> Gains | None:
        """Return gains with a phase margin at a crossover, from the open loop's response there; None where no PD filter has it.

        The plant is response / D, so the wanted filter is D' = exp(j (margin - pi)) D / response; KI is kept.
        """
        gains, sample_s = self.read_gains(), self._sample_s()
        lag = cmath.exp(-1j * crossover * sample_s)  # 1/z
        integral = 0.5 * gains.ki / (1.0 - lag)
        held = 4.0 * gains.kp + 4.0 * gains.kd * (1.0 - lag) + integral
        wanted = cmath.exp(1j * (margin - math.pi)) * held / response - integral
        kd = wanted.imag / (1.0 - lag).imag / 4.0
        kp = wanted.real / 4.0 - kd * (1.0 - lag).real
        if not (0.0 < kp <= 1023.875 and 0.0 < kd <= 4095.875):
            return None
        return Gains(kp=round(8.0 * kp) / 8.0, ki=gains.ki, kd=round(8.0 * kd) / 8.0)

    def nudge(self, turn_rate: float) -> None:
        """Change a jog speed; a lost byte can only make it smaller or turn it round, and the record shows what it was."""
        with self._guarded():
            self._card.do(f"JG {self._card.commas}{JOG_BY_TWO.round(self._scale.counts(turn_rate))}")

    def start(self, span_s: float) -> None:
        """Begin to record for a while, every 2^n samples, as densely as the arrays allow."""
        with self._guarded():
            self._room = self._room or self._make_room()
            sample_s = self._sample_s()
            power = min(max(1, math.ceil(math.log2(span_s / (self._room * sample_s)))), 8)
            self._period_s = sample_s * 2**power
            self._records = min(max(2, math.ceil(span_s / self._period_s)), self._room)
            self._card.do("RA " + ",".join(f"{array}[]" for array, _ in RECORDED))
            self._card.do("RD " + ",".join(f"_{word}{self._card.axis}" for _, word in RECORDED))
            self._card.do(f"RC {power},{self._records}")

    def recording(self) -> bool:
        """Return whether the card still records."""
        with self._guarded():
            return bool(self._card.integer("MG _RC", 0, 1))

    def trace(self) -> Trace:
        """Wait for the end of the record and return it."""
        last = time.monotonic() + 2.0 * self._records * self._period_s + UPLOAD_S
        while self.recording():
            if time.monotonic() > last:
                raise RigTimeout(
                    f"{self._card.port.name}: wanted the end of a record, got it still running; look at the card"
                )
            time.sleep(0.002)
        with self._guarded():
            position, error = (self._upload(array) for array, _ in RECORDED)
        return Trace(
            period_s=self._period_s, position=self._scale.angle(1.0) * position, error=self._scale.angle(1.0) * error
        )

    def free(self) -> None:
        """Give the arrays' room back to the card."""
        if self._room:
            self._room = 0
            with self._guarded():
                self._card.do("RC 0")
                self._card.do("DA " + ",".join(f"{array}[]" for array, _ in RECORDED))

    def _make_room(self) -> int:
        self._card.tries("DA " + ",".join(f"{array}[]" for array, _ in RECORDED))  # of a check that was interrupted
        for room in ROOM:
            if self._card.tries("DM " + ",".join(f"{array}[{room}]" for array, _ in RECORDED)):
                return room
        raise RigFault(
            f"{self._card.port.name}: wanted room for two arrays of {ROOM[-1]}, got none; free arrays on the card (DA)"
        )

    def _sample_s(self) -> float:
        known = self._place.sample_s if self._place else None
        return known or 1e-6 * self._card.number("MG _TM")

    def _upload(self, array: str) -> FloatArray:
        """Return an array, block by block; a lost byte leaves a number or a comma out, or something that is no number."""
        numbers: list[float] = []
        for first in range(0, self._records, BLOCK):
            last = min(first + BLOCK, self._records) - 1
            command = f"QU {array}[],{first},{last},1"
            answer = self._card.text(command, UPLOAD_S)
            parts = answer.split(",") if ELEMENTS.fullmatch(answer) else []
            if len(parts) != last - first + 1:
                wanted = f"wanted {last - first + 1} counts in answer to '{command}'"
                raise LinkError(f"{self._card.port.name}: {wanted}, got {answer[:60]!r}; {CABLE}")
            numbers += [float(part.replace(" ", "")) for part in parts]
        return np.array(numbers)


# ---- The rig.


class GalilRig(GalilReports):
    """A rate table on a Galil card; nothing moves until `turn` or `move_by`."""

    def __init__(self, port: GalilPort, settings: GalilSettings = GalilSettings()) -> None:
        super().__init__(port, settings)
        try:
            self._home = self._prepare()
        except RigError:
            port.close()
            raise
        self.servo = GalilServo(self.card, self._scale, self._axis.place, self._guarded)

    def enable(self, on: bool) -> None:
        """Switch the motor on (SH) or off (MO); off stops the axis first."""
        with self._guarded():
            if not on and self._axis.is_moving():
                self._axis.stop()
            self._axis.command("SH" if on else "MO")
            if self._axis.is_on() != on:
                word = "on" if on else "off"
                raise RigFault(
                    f"{self.card.port.name}: wanted the motor {word}, got it unchanged; look at the amplifier"
                )
            self._axis.enabled = on

    def set_acceleration(self, acceleration: float) -> float:
        """Set run-up (AC) and slow-down (DC), multiples of 1024 counts/s2."""
        self.limits.check_acceleration(acceleration)
        counts = ACCELERATION.round(self._scale.counts(acceleration))
        with self._guarded():
            held = self.card.set("AC", counts, tolerance=1024)
            self._axis.deceleration = self.card.set("DC", held, tolerance=1024)
        return self._scale.angle(held)

    def turn(self, turn_rate: float) -> float:
        """Turn at a steady rate until stopped (JG, BG); a turning axis changes over to it."""
        self.limits.check_turn_rate(turn_rate)
        if turn_rate == 0.0:
            self.stop()
            return 0.0
        grid = JOG if self._settings.speed_step == 1 else JOG_BY_TWO
        counts = grid.round(self._scale.counts(turn_rate))
        with self._guarded():
            moving = self._axis.is_moving()
            if moving and not self._axis.jogging:
                raise RigFault(f"{self.card.port.name}: wanted to turn, got a move that still runs; stop it first")
            held = self.card.set("JG", counts, tolerance=1, magnitude=True)
            self._axis.jogging = True
            if not moving:
                self._axis.command("BG")
        return self._scale.angle(held)

    def move_by(self, angle: float) -> float:
        """Turn by an angle (PR, BG) and wait until the axis is at rest."""
        counts = MOVE.round(self._scale.counts(angle))
        self.limits.check_travel(
            self._angle(self._home if self._axis.place.last is None else self._axis.place.last) + angle
        )
        with self._guarded():
            if self._axis.is_moving():
                raise RigFault(f"{self.card.port.name}: wanted to move, got an axis that moves; stop it first")
            before = self._axis.place.read().counts
            self.card.set("PR", counts)
            self._axis.jogging = False
            self._axis.command("BG")
            self._axis.wait_for_rest(abs(counts) / self._move_speed + 2.0 * self._move_speed / self._axis.deceleration)
            self._check_arrived()
            return self._scale.angle(self._axis.place.settled() - before)

    def stop(self) -> None:
        """Slow down (ST) and wait until the axis is at rest; the motor stays on."""
        with self._guarded():
            self._axis.stop()
            self._axis.place.settled()

    def close(self, *, as_found: bool = False) -> None:
        """Stop, switch the motor off or to what it was, let go of the link; harmless when called again."""
        if self._closed:
            return
        self._closed = True
        try:
            confirmed = self._restore() if as_found and self._axis.refused is None else self._axis.make_safe()
        finally:
            self.card.port.close()
        if not confirmed:
            raise LinkError(f"{self.card.port.name}: wanted the motor off at the end, got no answer; {UNCONFIRMED}")

    def _restore(self) -> bool:
        """Come to rest, with the accelerations and the motor as they were found; safe where that fails."""
        was_on, acceleration, deceleration = self._found
        with self._axis.guarded():
            self.card.port.resynchronise()
            self._axis.come_to_rest()
            self.card.set("AC", acceleration, tolerance=1024)
            self.card.set("DC", deceleration, tolerance=1024)
            if self._axis.is_on() != was_on:
                self._axis.command("SH" if was_on else "MO")
            return self._axis.is_on() == was_on

    def _prepare(self) -> int:
        """Bring the card into the state that this driver reads, and return where the axis stands; nothing moves."""
        port, card = self.card.port, self.card
        port.resynchronise()
        with self._axis.guarded():
            self._speak_plainly()
            if self._axis.is_moving():  # left so by a program that died
                self._axis.stop()
            card.set("ER", max(1, round(self._scale.counts(self._settings.error_limit))), tolerance=1)
            card.set("OE", 1)
            card.set("SP", self._move_speed, tolerance=2)
            self._axis.deceleration = card.number(f"MG _DC{card.axis}")
            self._axis.enabled = self._axis.is_on()
            self._found = (self._axis.enabled, card.number(f"MG _AC{card.axis}"), self._axis.deceleration)
            self._axis.place.find_clock()
            home = self._axis.place.read().counts
            forward, reverse = LONGEST_MOVE, -LONGEST_MOVE  # as good as none
            if self.limits.travel is not None:
                reach = int(self._scale.counts(self.limits.travel))
                forward, reverse = home + reach, home - reach
            card.set("FL", forward, tolerance=2)
            card.set("BL", reverse, tolerance=2)
        return home

    def _speak_plainly(self) -> None:
        """No echo, unsolicited characters marked, positions with all their digits."""
        port, card = self.card.port, self.card
        card.tries("EO 0")  # no echo
        port.resynchronise()
        if card.tries("CW 1"):  # what nobody asked for has its high bit set
            port.mask_unsolicited()
        card.fix_format()

    def _check_arrived(self) -> None:
        code = self._axis.stop_code()
        if code != 1:
            raise RigFault(
                f"{self.card.port.name}: wanted the move complete, got the axis {stop_in_words(code)} (stop code {code}); "
                "look at the table",
                code=code,
            )


def open_from(url: str, settings: RigSettings) -> GalilRig:
    """Open a Galil rig."""
    own = GalilSettings(
        limits=settings.limits,
        encoder_lines=settings.encoder_lines,
        axis=settings.axis or "X",
        speed_step=settings.speed_step,
        clock=Clock(speed=settings.clock_speed),
    )
    port: GalilPort
    if url.startswith("gclib://"):
        port = GclibPort(url.removeprefix("gclib://"), settings.reply_timeout_s)
    else:
        port = LinkPort(
            url,
            LinkSettings(
                reply_timeout_s=settings.reply_timeout_s,
                baud=settings.baud or 19200,
                hardware_handshake=settings.hardware_handshake,
            ),
        )
    return GalilRig(port, own)


# ---- Where a Galil table stands and what is wrong with it, read beside whoever drives it: nothing is set and nothing stops.


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """What a table says."""

    identity: str  # Model and firmware
    moving: bool  # Of the axis
    motor_on: bool  # Of the axis
    angle: float  # Of the position register, rad
    following_error: float  # Commanded minus actual, rad
    fault: str | None  # In words


def read_status(address: str) -> Status:
    """Ask a table on a connection of its own."""
    kind, url, settings = parse_address(address, RigSettings())
    if kind != "galil" or url.startswith("gclib:"):
        raise InputError(
            f"status: wanted a Galil card on TCP or serial, got '{address}'; others cannot be asked unharmed"
        )
    links = LinkSettings(
        reply_timeout_s=settings.reply_timeout_s,
        baud=settings.baud or 19200,
        hardware_handshake=settings.hardware_handshake,
    )
    port = LinkPort(url, links)
    try:
        port.resynchronise()
        rig = GalilReports(port, GalilSettings(encoder_lines=settings.encoder_lines, axis=settings.axis or "X"))
        axis = rig.card.axis
        return Status(
            identity=rig.identify(),
            moving=bool(rig.card.integer(f"MG _BG{axis}", 0, 1)),
            motor_on=not rig.card.integer(f"MG _MO{axis}", 0, 1),
            angle=rig.position().angle,
            following_error=rig.following_error(),
            fault=rig.fault(),
        )
    finally:
        port.close()
