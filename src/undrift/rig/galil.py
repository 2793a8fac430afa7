"""Driver for one servo axis of a Galil motion controller (DMC-14xx, 2x00, 40x0, 41x3, 30010).

A command ends with a carriage return. The card answers ``:`` if it accepts the command and ``?`` if it rejects it. TC1 then returns
the reason. The answer to a question is text before the ``:``. An answer of any other form raises LinkError, so a corrupted answer
never moves a rig. Every number is rounded as the card rounds it before it is sent, and is read back before it is used.

The achieved rate is the difference of positions (TP) over the difference of the card's clock (TIME). The card returns TP and TIME
in one answer. If a card cannot do that, TP is read without TIME, and its time is the middle between question and answer. If an
answer is late or corrupted, the driver stops the axis (ST, then AB) and switches the motor off (MO). It then reports if the card
confirmed the stop.

Sources: command references DMC-1400, 2x00 and 40x0.
"""

import logging
import math
import re

from undrift.base.clock import HOST, Clock
from undrift.errors import InputError, LinkError, RigError, RigFault, RigTimeout
from undrift.rig.link import CardClock, LinkedRig, LinkPort, ask_until, link_settings
from undrift.rig.rig import (
    ACCELERATION,
    LONGEST_MOVE,
    MOVE,
    SLEW,
    CountScale,
    Position,
    RigSettings,
    ServoReport,
    in_words,
    steady_angle,
)
from undrift.units import RADIAN_PER_DEGREE

# ---- Commands and answers, with strict parsing.

NUMBER = re.compile(r"[ ]*-?[ ]?\d{1,12}(?:\.\d{1,8})?[ ]*")
BOTH = re.compile(r" *(-?\d{10}) +(-?\d{10}) *")
CABLE = "Check cable and baud rate."
AXES = "ABCDEFGH"
STOPS_THAT_ARE_FAULTS = (2, 3, 6, 8, 99)


class GalilCard:
    """Commands and questions for one axis of a card."""

    def __init__(self, port: LinkPort, axis: str = "X", clock: Clock = HOST) -> None:
        self.port, self.axis, self.clock = port, axis, clock
        self.commas = "," * (AXES.index(axis) if axis in AXES else "XYZW".index(axis))
        self._digits: int | None = None

    def do(self, command: str) -> None:
        """Send a command whose only answer is ``:``."""
        if answer := self._ask(command, None):
            raise self.garbled("':'", command, repr(answer))

    def tries(self, command: str) -> bool:
        """Send a command that older cards may not support. Return True if the card accepts it."""
        return self.port.ask(command) is not None

    def text(self, command: str, deadline_s: float | None = None) -> str:
        """Ask for text and return it."""
        return self._ask(command, deadline_s).strip("\r\n")

    def number(self, command: str) -> float:
        """Ask for a number and return it."""
        answer = self.text(command)
        if not NUMBER.fullmatch(answer):
            raise self.garbled("a number", command, repr(answer))
        return float(answer.replace(" ", ""))

    def integer(self, command: str, smallest: int, largest: int) -> int:
        """Ask for a whole number within a range and return it."""
        value = self.number(command)
        if value != int(value) or not smallest <= value <= largest:
            raise self.garbled(f"a whole number from {smallest} to {largest}", command, f"{value:g}")
        return int(value)

    def position(self, command: str) -> int:
        """Ask for a position in counts. After `fix_format`, its number of digits is checked."""
        answer = self.text(command)
        digits = sum(character.isdigit() for character in answer)
        if not re.fullmatch(r" *-? ?\d{1,10} *", answer) or self._digits not in (None, digits):
            raise self.garbled("counts", command, repr(answer))
        return int(answer.replace(" ", ""))

    def fix_format(self) -> None:
        """Set the position format to ten digits, so that a lost byte is detected. Cards without this format keep their own."""
        if self.tries("PF 10.0") and self.tries("LZ 0"):
            digits = sum(character.isdigit() for character in self.text(f"TP{self.axis}"))
            self._digits = 10 if digits == 10 else None

    def set(self, name: str, value: float, *, tolerance: float = 0.0) -> float:
        """Set a parameter of the axis and read it back."""
        self.do(f"{name} {self.commas}{value:.10g}")
        actual = self.number(f"{name} {self.commas}?")
        if abs(actual - value) > tolerance:
            raise LinkError(
                f"{self.port.name}: set {name} to {value:.10g}, but the card returned {actual:.10g}. {CABLE}",
                wanted=value,
                held=actual,
            )
        return actual

    def garbled(self, wanted: str, command: str, got: str) -> LinkError:
        """Return the LinkError for an answer of the wrong form."""
        return LinkError(f"{self.port.name}: expected {wanted} in answer to '{command}', got {got}. {CABLE}")

    def _ask(self, command: str, deadline_s: float | None) -> str:
        """Send a command and return the answer. If the card rejects it, raise RigFault with the reason from TC1."""
        answer = self.port.ask(command, deadline_s)
        if answer is not None:
            return answer
        reason = self.port.ask("TC1") or ""
        match = re.match(r"\s*(\d{1,3})\b", reason)
        if not match:
            raise self.garbled("an error code", "TC1", repr(reason))
        code = int(match.group(1))
        cause = f"error {code}: {in_words('galil_error', code)}"
        raise RigFault(
            f"{self.port.name}: the card rejected '{command}' ({cause}). Check the state of the card.",
            code=code,
            command=command,
        )


# ---- One axis of a card: its position and time, its motion, and its stop.

RECONNECTIONS = 4
STOP_MARGIN_S = 2.0  # added to twice the expected stopping time, s
FINDING_S = 0.5  # longest search for the card's tick at the start, host s (later positions continue it)

log = logging.getLogger(__name__)


class GalilAxis:
    """Position and motion of an axis, in counts."""

    def __init__(self, card: GalilCard, fastest: float, slack: float) -> None:
        self.card, self.name = card, card.port.name
        self.acceleration = self.deceleration = 256_000.0  # default of the card, counts/s2
        self.found = (False, 0.0, 0.0)  # motor on, AC and DC, before the driver changed them
        self.refused: str | None = None
        self.broken: RigError | None = None
        self.enabled = False
        self.last: int | None = None  # position
        self.when = (0.0, 0.0)  # time of the last position and its largest error, s
        self._clock, self._fastest, self._slack = card.clock, fastest, slack
        self._read_at = 0.0
        self._card_clock: CardClock | None = None
        self._both = f"MG _TP{card.axis}{{F10.0}},TIME{{F10.0}}"  # ten digits each, so that a lost byte is detected

    def find_clock(self) -> None:
        """Use the card's clock if the card returns position and time in one answer. Search briefly for its tick."""
        answer = self.card.port.ask(self._both)
        if answer is None or not BOTH.fullmatch(answer.strip("\r\n")):
            return
        self._card_clock = CardClock(self.card.number("MG _TM"))
        card_clock = self._card_clock

        def tick_is_known() -> bool:
            self.read()
            return card_clock.tick_s is not None

        self._clock.host.until(tick_is_known, FINDING_S)

    def read(self) -> int:
        """Return the position in counts, and store its time in `when`."""
        asked_s, ticks = self._clock.now(), 0
        if self._card_clock is None:
            counts = self.card.position(f"TP{self.card.axis}")
        else:
            answer = self.card.text(self._both)
            match = BOTH.fullmatch(answer)
            if not match:
                raise self.card.garbled("two numbers with ten digits", self._both, repr(answer))
            counts, ticks = int(match.group(1)), int(match.group(2))
        answered_s = self._clock.now()
        # largest possible motion, from the last question to this answer
        reach = 1.5 * self._fastest * (answered_s - self._read_at) + self._slack
        if self.last is not None and abs(counts - self.last) > reach:
            raise LinkError(
                f"{self.name}: expected a position within {reach:.0f} counts of {self.last}, got {counts}. "
                "The card was restarted, the answer is corrupted, or clock_speed is wrong.",
                counts=counts,
            )
        self.last, self._read_at = counts, asked_s
        if self._card_clock is None:
            self.when = 0.5 * (asked_s + answered_s), 0.5 * (answered_s - asked_s)
        else:
            self.when = self._card_clock.when(ticks, asked_s, answered_s)
        return counts

    def settled(self) -> int:
        """Wait until the position changes by at most one count, and return it. The servo settles after the profile ends."""
        before = self.read()
        for _ in range(50):
            self._clock.wait(0.02)
            now = self.read()
            if abs(now - before) <= 1:
                break
            before = now
        return now

    @property
    def sample_s(self) -> float | None:
        """Sample period of the servo from the card's clock, s, or None if it is unknown."""
        return None if self._card_clock is None else self._card_clock.sample_s

    def command(self, letters: str) -> None:
        """Send a command for this axis."""
        self.card.do(f"{letters}{self.card.axis}")

    def is_moving(self) -> bool:
        """Return True if the motion profile is running."""
        return bool(self.card.integer(f"MG _BG{self.card.axis}", 0, 1))

    def is_on(self) -> bool:
        """Return True if the motor is on."""
        return not self.card.integer(f"MG _MO{self.card.axis}", 0, 1)

    def stop_code(self) -> int:
        """Return the card's code for the reason of the last stop."""
        return self.card.integer(f"SC{self.card.axis}", 0, 255)

    def wait_for_rest(self, expected_s: float) -> None:
        """Poll until the profile is complete, for at most twice the expected time plus 2 s."""
        allowed_s = 2.0 * expected_s + STOP_MARGIN_S
        if not ask_until(lambda: not self.is_moving(), self._clock, allowed_s):
            raise RigTimeout(
                f"{self.name}: the axis is still moving after {allowed_s:.3g} s. Check the table.",
                deadline_s=allowed_s,
            )

    def stop(self) -> None:
        """Slow down (ST) and wait for the end of the profile. The motor stays on."""
        self.command("ST")
        self.wait_for_rest(self._fastest / self.deceleration)

    def come_to_rest(self) -> None:
        """Stop the axis (ST), or abort (AB) if that fails."""
        try:
            self.stop()
        except (RigTimeout, RigFault):
            self.card.do("AB")
            self.wait_for_rest(0.0)

    def make_safe(self) -> bool:
        """Stop and switch the motor off, and reconnect first if the link is lost. Return True if the card confirms it."""
        port = self.card.port
        self.enabled = False
        try:
            if not port.is_open:
                self.refused = "the connection was lost, and the card may have lost its commands"
                self._reconnect()
            port.shout(f"ST{self.card.axis}")  # stop at once (the next line discards the answer)
            port.resynchronise()
            self.come_to_rest()
            self.command("MO")
            return not self.is_on()
        except RigError as error:
            log.error("%s: not confirmed at rest: %s", self.name, error)
            self.refused = "it could not be brought to rest"
            # The card may still receive commands. It rejects MO until AB has ended the motion.
            for command in (f"ST{self.card.axis}", "AB", f"MO{self.card.axis}", f"MO{self.card.axis}"):
                port.shout(command)
                self._clock.host.wait(0.05)
            return False

    def restore(self) -> bool:
        """Stop the axis and restore the initial accelerations and motor state."""
        was_on, acceleration, deceleration = self.found
        self.card.port.resynchronise()
        self.come_to_rest()
        self.card.set("AC", acceleration, tolerance=1024)
        self.card.set("DC", deceleration, tolerance=1024)
        if self.is_on() != was_on:
            self.command("SH" if was_on else "MO")
        return self.is_on() == was_on

    def let_go(self) -> None:
        """Close the link."""
        self.card.port.close()

    def _reconnect(self) -> None:
        """Reconnect, with repeated attempts, because a card does not answer immediately after a restart."""
        for attempt in range(RECONNECTIONS):
            try:
                return self.card.port.reconnect()
            except LinkError:
                if attempt == RECONNECTIONS - 1:
                    raise
                self._clock.host.wait(0.3)
        return None


# ---- The rig.

MOVE_TURN_RATE = 90.0 * RADIAN_PER_DEGREE  # turn rate of `move_by`, rad/s
# following error at which the card switches the motor off (ER, OE1)
ERROR_LIMIT = 5.0 * RADIAN_PER_DEGREE


class GalilRig(LinkedRig):
    """A rate table with a Galil card. It does not move until `turn_for` or `move_by`."""

    stopped = "The table was stopped and its motor switched off."
    unconfirmed = "It is NOT CONFIRMED that the table stopped. Cut the amplifier's power."
    _axis: GalilAxis

    def __init__(self, port: LinkPort, settings: RigSettings = RigSettings()) -> None:
        self.card = GalilCard(port, settings.axis or "X", settings.timing)
        self._settings = settings
        self._scale = CountScale.from_lines(settings.encoder_lines)
        self._move_speed = SLEW.round(self._scale.counts(min(MOVE_TURN_RATE, settings.limits.turn_rate)))
        fastest = max(self._scale.counts(settings.limits.turn_rate), self._move_speed)
        axis = GalilAxis(self.card, fastest, slack=self._scale.counts_per_turn / 36.0)
        super().__init__(axis, settings.limits)
        self._home = 0
        try:
            self._prepare()
        except RigError:
            self._axis.let_go()
            raise

    def identify(self) -> str:
        """Return the card's model and firmware, from control-R control-V."""
        with self._guarded():
            answer = self.card.text("\x12\x16").strip()
            if not answer.isprintable() or not answer:
                raise LinkError(
                    f"{self.card.port.name}: {answer!r} is not a model in answer to ^R^V. Check the baud rate."
                )
            return answer

    def position(self) -> Position:
        """Return the angle since the rig was opened (TP), rad, and its time from the card's clock if available (TIME)."""
        with self._guarded():
            counts = self._axis.read()
        time, within_s = self._axis.when
        return Position(angle=self._scale.angle(counts - self._home), time=time, within_s=within_s)

    def following_error(self) -> float:
        """Return commanded minus actual angle (TE), rad."""
        with self._guarded():
            return self._scale.angle(self.card.position(f"TE{self.card.axis}"))

    def fault(self) -> str | None:
        """Return a description of the faults (TS, SC), or None."""
        with self._guarded():
            wrong = wrong_switches(self.card.integer(f"TS{self.card.axis}", 0, 255), self._axis.enabled)
            code = self._axis.stop_code()
        if code in STOPS_THAT_ARE_FAULTS:
            wrong.append(f"{in_words('galil_stop', code)} (stop code {code})")
        return "; ".join(wrong) or None

    def read_servo(self) -> ServoReport:
        """Return the gains (KP, KI, KD) and the sample period (TM) of the card."""
        with self._guarded():
            gains = {name: self.card.number(f"MG _{name.upper()}{self.card.axis}") for name in ("kp", "ki", "kd")}
            return ServoReport(sample_s=self._axis.sample_s or 1e-6 * self.card.number("MG _TM"), **gains)

    def enable(self, on: bool) -> None:
        """Switch the motor on (SH), or stop the axis and switch the motor off (MO)."""
        with self._guarded():
            if not on and self._axis.is_moving():
                self._axis.stop()
            self._axis.command("SH" if on else "MO")
            if self._axis.is_on() != on:
                word = "on" if on else "off"
                raise RigFault(f"{self._axis.name}: the motor did not switch {word}. Check the amplifier.")
            self._axis.enabled = on

    def set_acceleration(self, acceleration: float) -> float:
        """Set acceleration (AC) and deceleration (DC), multiples of 1024 counts/s2."""
        self.limits.check_acceleration(acceleration)
        counts = ACCELERATION.round(self._scale.counts(acceleration))
        with self._guarded():
            actual = self._axis.acceleration = self.card.set("AC", counts, tolerance=1024)
            self._axis.deceleration = self.card.set("DC", actual, tolerance=1024)
        return self._scale.angle(actual)

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        """Turn at a steady rate for a time that includes both ramps (SP, PR, BG), and return the rate set in the card.

        The card ends the move itself, even if this program has ended.
        """
        self.limits.check_turn_rate(turn_rate)
        axis = self._axis
        speed = SLEW.round(self._scale.counts(turn_rate))
        ramp = 2.0 / (1.0 / axis.acceleration + 1.0 / axis.deceleration)
        distance = MOVE.round(steady_angle(speed, seconds, ramp))
        self.limits.check_travel(self._angle_now() + self._scale.angle(distance))
        with self._guarded():
            self._check_at_rest()
            actual = self.card.set("SP", abs(speed), tolerance=1)
            self.card.set("PR", distance)
            axis.command("BG")
        return self._scale.angle(math.copysign(actual, turn_rate))

    def move_by(self, angle: float) -> float:
        """Turn by an angle (PR, BG) and wait until the axis is at rest."""
        axis, counts = self._axis, MOVE.round(self._scale.counts(angle))
        self.limits.check_travel(self._angle_now() + angle)
        with self._guarded():
            self._check_at_rest()
            before = axis.read()
            self.card.set("SP", self._move_speed, tolerance=1)
            self.card.set("PR", counts)
            axis.command("BG")
            axis.wait_for_rest(abs(counts) / self._move_speed + 2.0 * self._move_speed / axis.deceleration)
            code = axis.stop_code()
            if code != 1:
                reason = f"the axis {in_words('galil_stop', code)} (stop code {code})"
                raise RigFault(f"{axis.name}: the move is not complete, {reason}. Check the table.", code=code)
            return self._scale.angle(axis.settled() - before)

    def stop(self) -> None:
        """Slow down (ST) and wait until the axis is at rest. The motor stays on."""
        with self._guarded():
            self._axis.stop()
            self._axis.settled()

    def _angle_now(self) -> float:
        """Return the angle since the rig was opened at the last reading of the position, rad."""
        return 0.0 if self._axis.last is None else self._scale.angle(self._axis.last - self._home)

    def _check_at_rest(self) -> None:
        if self._axis.is_moving():
            raise RigFault(f"{self._axis.name}: the axis still moves. Stop it first.")

    def _prepare(self) -> None:
        """Configure the card for this driver and store the initial position. A motion of an earlier program is stopped."""
        port, card, axis = self.card.port, self.card, self._axis
        port.resynchronise()
        with self._safely():
            card.tries("EO 0")  # no echo
            port.resynchronise()
            if card.tries("CW 1"):  # sets the high bit of unsolicited bytes
                port.mask_unsolicited()
            card.fix_format()
            if axis.is_moving():  # an earlier program has ended during a move
                axis.stop()
            card.set("ER", max(1, round(self._scale.counts(ERROR_LIMIT))), tolerance=1)
            card.set("OE", 1)
            axis.acceleration = card.number(f"MG _AC{card.axis}")
            axis.deceleration = card.number(f"MG _DC{card.axis}")
            axis.enabled = axis.is_on()
            axis.found = (axis.enabled, axis.acceleration, axis.deceleration)
            axis.find_clock()
            self._home = axis.read()
            forward, reverse = LONGEST_MOVE, -LONGEST_MOVE  # no limits in effect
            if self.limits.travel is not None:
                reach = int(self._scale.counts(self.limits.travel))
                forward, reverse = self._home + reach, self._home - reach
            card.set("FL", forward, tolerance=2)
            card.set("BL", reverse, tolerance=2)


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
    return GalilRig(_port(url, settings), settings)


def _port(url: str, settings: RigSettings) -> LinkPort:
    if settings.axis not in ("", *"ABCDEFGHXYZW"):
        raise InputError(f"galil: axis must be A to H, X, Y, Z or W, got '{settings.axis}'. Set another axis.")
    return LinkPort(url, link_settings(settings))


def axis_state(url: str, settings: RigSettings) -> str:
    """Return the state of an axis over a separate connection, without setting anything.

    The state is "moving", "its motor on", or "" if the axis is at rest with its motor off.
    """
    port = _port(url, settings)
    try:
        port.resynchronise()
        card = GalilCard(port, settings.axis or "X")
        if card.integer(f"MG _BG{card.axis}", 0, 1):
            return "moving"
        return "" if card.integer(f"MG _MO{card.axis}", 0, 1) else "its motor on"
    finally:
        port.close()
