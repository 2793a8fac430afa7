"""Galil motion controllers (DMC-14xx, 2x00, 40x0, 41x3, 30010): one servo axis behind an ASCII language.

A command ends with a carriage return. The card answers ``:`` when it accepts, ``?`` when it refuses (TC1 then gives the reason),
and text before the ``:`` when it was asked for some. An answer that is not exactly of the kind that was asked for is a LinkError: a
rig never moves on garbage. Every number is rounded as the card rounds it before it is sent, and read back before it is used.

The rate that was achieved is the difference of positions (TP) over the time between them by the card's own clock. TP and TIME come
in one answer; cards that do not give both give TP alone, half-way between question and answer. When an answer is late or makes no
sense the driver stops the axis (ST, then AB), switches the motor off (MO), and reports whether the card confirmed it.

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

# ---- The language: one command, one answer, read strictly.

NUMBER = re.compile(r"[ ]*-?[ ]?\d{1,12}(?:\.\d{1,8})?[ ]*")
BOTH = re.compile(r" *(-?\d{10}) +(-?\d{10}) *")
CABLE = "check cable and baud"
AXES = "ABCDEFGH"
STOPS_THAT_ARE_FAULTS = (2, 3, 6, 8, 99)


class GalilCard:
    """Commands and questions to one axis of a card."""

    def __init__(self, port: LinkPort, axis: str = "X", clock: Clock = HOST) -> None:
        self.port, self.axis, self.clock = port, axis, clock
        self.commas = "," * (AXES.index(axis) if axis in AXES else "XYZW".index(axis))
        self._digits: int | None = None

    def do(self, command: str) -> None:
        """Give a command that has no answer but ``:``."""
        if answer := self._ask(command, None):
            raise self.garbled("':'", command, repr(answer))

    def tries(self, command: str) -> bool:
        """Give a command that older cards may not know."""
        return self.port.ask(command) is not None

    def text(self, command: str, deadline_s: float | None = None) -> str:
        """Ask for text."""
        return self._ask(command, deadline_s).strip("\r\n")

    def number(self, command: str) -> float:
        """Ask for a number."""
        answer = self.text(command)
        if not NUMBER.fullmatch(answer):
            raise self.garbled("a number", command, repr(answer))
        return float(answer.replace(" ", ""))

    def integer(self, command: str, smallest: int, largest: int) -> int:
        """Ask for a whole number."""
        value = self.number(command)
        if value != int(value) or not smallest <= value <= largest:
            raise self.garbled(f"a whole number from {smallest} to {largest}", command, f"{value:g}")
        return int(value)

    def position(self, command: str) -> int:
        """Ask for a position, which the card writes with a fixed number of digits once `fix_format` was called."""
        answer = self.text(command)
        digits = sum(character.isdigit() for character in answer)
        if not re.fullmatch(r" *-? ?\d{1,10} *", answer) or self._digits not in (None, digits):
            raise self.garbled("counts", command, repr(answer))
        return int(answer.replace(" ", ""))

    def fix_format(self) -> None:
        """Have positions written with ten digits, so that a lost byte shows; cards that will not are taken as they are."""
        if self.tries("PF 10.0") and self.tries("LZ 0"):
            digits = sum(character.isdigit() for character in self.text(f"TP{self.axis}"))
            self._digits = 10 if digits == 10 else None

    def set(self, name: str, value: float, *, tolerance: float = 0.0) -> float:
        """Set a parameter of the axis and read it back."""
        self.do(f"{name} {self.commas}{value:.10g}")
        held = self.number(f"{name} {self.commas}?")
        if abs(held - value) > tolerance:
            raise LinkError(
                f"{self.port.name}: wanted {name} {value:.10g}, got {held:.10g} when it was read back; {CABLE}",
                wanted=value,
                held=held,
            )
        return held

    def garbled(self, wanted: str, command: str, got: str) -> LinkError:
        """Return the error of an answer that is not of the kind that was asked for."""
        return LinkError(f"{self.port.name}: wanted {wanted} in answer to '{command}', got {got}; {CABLE}")

    def _ask(self, command: str, deadline_s: float | None) -> str:
        """Return an answer; what TC1 says about a ``?`` is raised, in our words."""
        answer = self.port.ask(command, deadline_s)
        if answer is not None:
            return answer
        reason = self.port.ask("TC1") or ""
        found = re.match(r"\s*(\d{1,3})\b", reason)
        if not found:
            raise self.garbled("an error code", "TC1", repr(reason))
        code = int(found.group(1))
        what = f"wanted '{command}', got error {code}: {in_words('galil_error', code)}"
        raise RigFault(f"{self.port.name}: {what}; see the state of the card", code=code, command=command)


# ---- One axis of a card: where it is and when that was, whether it moves, bringing it to rest and to safety.

RECONNECTIONS = 4
STOP_MARGIN_S = 2.0  # on top of twice the time that coming to rest should take
FINDING_S = 0.5  # longest look for the card's clock at the start, s of the host; every later position goes on looking

log = logging.getLogger(__name__)


class GalilAxis:
    """What the axis does, in counts."""

    def __init__(self, card: GalilCard, fastest: float, slack: float) -> None:
        self.card, self.name = card, card.port.name
        self.acceleration = self.deceleration = 256_000.0  # counts/s2, the card's own default
        self.found = (False, 0.0, 0.0)  # motor on, AC and DC, before the driver changed them
        self.refused: str | None = None
        self.broken: RigError | None = None
        self.enabled = False
        self.last: int | None = None  # position
        self.when = (0.0, 0.0)  # s of the clock, and by how much that may be off
        self._clock, self._fastest, self._slack = card.clock, fastest, slack
        self._read_at = 0.0
        self._card_clock: CardClock | None = None
        self._both = f"MG _TP{card.axis}{{F10.0}},TIME{{F10.0}}"  # ten digits each: a lost byte shows

    def find_clock(self) -> None:
        """See whether the card tells a position and its own time in one answer, and for a moment how fast that time runs."""
        answer = self.card.port.ask(self._both)
        if answer is None or not BOTH.fullmatch(answer.strip("\r\n")):
            return
        self._card_clock = CardClock(self.card.number("MG _TM"))
        card_clock = self._card_clock

        def found() -> bool:
            self.read()
            return card_clock.tick_s is not None

        self._clock.host.until(found, FINDING_S)

    def read(self) -> int:
        """Return where it is, and note when that was."""
        asked, ticks = self._clock.now(), 0
        if self._card_clock is None:
            counts = self.card.position(f"TP{self.card.axis}")
        else:
            answer = self.card.text(self._both)
            found = BOTH.fullmatch(answer)
            if not found:
                raise self.card.garbled("two numbers of ten digits", self._both, repr(answer))
            counts, ticks = int(found.group(1)), int(found.group(2))
        answered = self._clock.now()
        # all the time that can have passed: from the last question to this answer
        reach = 1.5 * self._fastest * (answered - self._read_at) + self._slack
        if self.last is not None and abs(counts - self.last) > reach:
            raise LinkError(
                f"{self.name}: wanted a position within {reach:.0f} counts of {self.last}, got {counts}; "
                "the card was restarted, the answer is garbled, or clock_speed is wrong",
                counts=counts,
            )
        self.last, self._read_at = counts, asked
        if self._card_clock is None:
            self.when = 0.5 * (asked + answered), 0.5 * (answered - asked)
        else:
            self.when = self._card_clock.when(ticks, asked, answered)
        return counts

    def settled(self) -> int:
        """Return the position once it changes by a count at most; the servo settles after the profile."""
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
        """Time between two samples of the servo by the card's clock, s; None where it is not known."""
        return None if self._card_clock is None else self._card_clock.sample_s

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
        if not ask_until(lambda: not self.is_moving(), self._clock, allowed_s):
            raise RigTimeout(
                f"{self.name}: wanted the axis at rest within {allowed_s:.3g} s, got it still moving; look at the table",
                deadline_s=allowed_s,
            )

    def stop(self) -> None:
        """Slow down (ST) and wait for the end of the profile; the motor stays on."""
        self.command("ST")
        self.wait_for_rest(self._fastest / self.deceleration)

    def come_to_rest(self) -> None:
        """Stop (ST), or abort (AB) where that does not help."""
        try:
            self.stop()
        except (RigTimeout, RigFault):
            self.card.do("AB")
            self.wait_for_rest(0.0)

    def make_safe(self) -> bool:
        """Stop and switch off, over a new connection where the old one is gone; return whether that is confirmed."""
        port = self.card.port
        self.enabled = False
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
            log.error("%s: not confirmed at rest: %s", self.name, error)
            self.refused = "it could not be brought to rest"
            # the card may still listen; MO is refused until AB has ended the motion
            for command in (f"ST{self.card.axis}", "AB", f"MO{self.card.axis}", f"MO{self.card.axis}"):
                port.shout(command)
                self._clock.host.wait(0.05)
            return False

    def restore(self) -> bool:
        """Come to rest, with the accelerations and the motor as they were found."""
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
        """A card that was restarted needs a moment before it answers."""
        for attempt in range(RECONNECTIONS):
            try:
                return self.card.port.reconnect()
            except LinkError:
                if attempt == RECONNECTIONS - 1:
                    raise
                self._clock.host.wait(0.3)
        return None


# ---- The rig.

MOVE_TURN_RATE = 90.0 * RADIAN_PER_DEGREE  # of `move_by`, rad/s
# following error at which the card switches the motor off by itself (ER, OE1)
ERROR_LIMIT = 5.0 * RADIAN_PER_DEGREE


class GalilRig(LinkedRig):
    """A rate table on a Galil card; nothing moves until `turn_for` or `move_by`."""

    stopped = "the table was stopped and its motor switched off"
    unconfirmed = "it is NOT CONFIRMED that the table stopped: cut the amplifier's power"
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
        """Return the card's model and firmware, as it answers to control-R control-V."""
        with self._guarded():
            answer = self.card.text("\x12\x16").strip()
            if not answer.isprintable() or not answer:
                raise LinkError(f"{self.card.port.name}: wanted a model in answer to ^R^V, got {answer!r}; check baud")
            return answer

    def position(self) -> Position:
        """Return where the axis stands (TP) and when by the card's own TIME, from where it stood when the rig was opened, rad."""
        with self._guarded():
            counts = self._axis.read()
        time, within_s = self._axis.when
        return Position(angle=self._scale.angle(counts - self._home), time=time, within_s=within_s)

    def following_error(self) -> float:
        """Return commanded minus actual angle (TE), rad."""
        with self._guarded():
            return self._scale.angle(self.card.position(f"TE{self.card.axis}"))

    def fault(self) -> str | None:
        """Return what is wrong in words (TS, SC), None when all is well."""
        with self._guarded():
            wrong = wrong_switches(self.card.integer(f"TS{self.card.axis}", 0, 255), self._axis.enabled)
            code = self._axis.stop_code()
        if code in STOPS_THAT_ARE_FAULTS:
            wrong.append(f"{in_words('galil_stop', code)} (stop code {code})")
        return "; ".join(wrong) or None

    def read_servo(self) -> ServoReport:
        """Return the gains (KP, KI, KD) and the sample period (TM) that the card runs."""
        with self._guarded():
            gains = {name: self.card.number(f"MG _{name.upper()}{self.card.axis}") for name in ("kp", "ki", "kd")}
            return ServoReport(sample_s=self._axis.sample_s or 1e-6 * self.card.number("MG _TM"), **gains)

    def enable(self, on: bool) -> None:
        """Switch the motor on (SH) or off (MO); off stops the axis first."""
        with self._guarded():
            if not on and self._axis.is_moving():
                self._axis.stop()
            self._axis.command("SH" if on else "MO")
            if self._axis.is_on() != on:
                word = "on" if on else "off"
                raise RigFault(f"{self._axis.name}: wanted the motor {word}, got it unchanged; look at the amplifier")
            self._axis.enabled = on

    def set_acceleration(self, acceleration: float) -> float:
        """Set run-up (AC) and slow-down (DC), multiples of 1024 counts/s2."""
        self.limits.check_acceleration(acceleration)
        counts = ACCELERATION.round(self._scale.counts(acceleration))
        with self._guarded():
            held = self._axis.acceleration = self.card.set("AC", counts, tolerance=1024)
            self._axis.deceleration = self.card.set("DC", held, tolerance=1024)
        return self._scale.angle(held)

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        """Turn at a steady rate for so long, ramps included (SP, PR, BG); return the rate that the card holds.

        The card ends the move by itself, whatever becomes of this program.
        """
        self.limits.check_turn_rate(turn_rate)
        axis = self._axis
        speed = SLEW.round(self._scale.counts(turn_rate))
        ramp = 2.0 / (1.0 / axis.acceleration + 1.0 / axis.deceleration)
        distance = MOVE.round(steady_angle(speed, seconds, ramp))
        self.limits.check_travel(self._angle_now() + self._scale.angle(distance))
        with self._guarded():
            self._check_at_rest()
            held = self.card.set("SP", abs(speed), tolerance=1)
            self.card.set("PR", distance)
            axis.command("BG")
        return self._scale.angle(math.copysign(held, turn_rate))

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
                got = f"the axis {in_words('galil_stop', code)} (stop code {code})"
                raise RigFault(f"{axis.name}: wanted the move complete, got {got}; look at the table", code=code)
            return self._scale.angle(axis.settled() - before)

    def stop(self) -> None:
        """Slow down (ST) and wait until the axis is at rest; the motor stays on."""
        with self._guarded():
            self._axis.stop()
            self._axis.settled()

    def _angle_now(self) -> float:
        """Return the angle at the last reading of the position, from where the axis was when the rig was opened, rad."""
        return 0.0 if self._axis.last is None else self._scale.angle(self._axis.last - self._home)

    def _check_at_rest(self) -> None:
        if self._axis.is_moving():
            raise RigFault(f"{self._axis.name}: the axis still moves. Stop it first.")

    def _prepare(self) -> None:
        """Bring the card into the state that this driver reads, and note where the axis stands; nothing moves."""
        port, card, axis = self.card.port, self.card, self._axis
        port.resynchronise()
        with self._safely():
            card.tries("EO 0")  # no echo
            port.resynchronise()
            if card.tries("CW 1"):  # what nobody asked for has its high bit set
                port.mask_unsolicited()
            card.fix_format()
            if axis.is_moving():  # left so by a program that died
                axis.stop()
            card.set("ER", max(1, round(self._scale.counts(ERROR_LIMIT))), tolerance=1)
            card.set("OE", 1)
            axis.acceleration = card.number(f"MG _AC{card.axis}")
            axis.deceleration = card.number(f"MG _DC{card.axis}")
            axis.enabled = axis.is_on()
            axis.found = (axis.enabled, axis.acceleration, axis.deceleration)
            axis.find_clock()
            self._home = axis.read()
            forward, reverse = LONGEST_MOVE, -LONGEST_MOVE  # as good as none
            if self.limits.travel is not None:
                reach = int(self._scale.counts(self.limits.travel))
                forward, reverse = self._home + reach, self._home - reach
            card.set("FL", forward, tolerance=2)
            card.set("BL", reverse, tolerance=2)


def wrong_switches(byte: int, enabled: bool) -> list[str]:
    """Say what is not as it should be in the byte that TS returns; a limit switch that is not pressed reads 1."""
    seen = (
        (enabled and byte & 0x20, "the motor is off though it was switched on"),
        (byte & 0x40, "the following error is beyond its limit"),
        (not byte & 0x08, "the forward limit switch is pressed"),
        (not byte & 0x04, "the reverse limit switch is pressed"),
    )
    return [words for is_so, words in seen if is_so]


def open_from(url: str, settings: RigSettings) -> GalilRig:
    """Open a Galil rig."""
    return GalilRig(_port(url, settings), settings)


def _port(url: str, settings: RigSettings) -> LinkPort:
    if settings.axis not in ("", *"ABCDEFGHXYZW"):
        raise InputError(f"galil: wanted an axis A to H or X, Y, Z, W, got '{settings.axis}'; name one")
    return LinkPort(url, link_settings(settings))


def axis_state(url: str, settings: RigSettings) -> str:
    """Ask a card on a connection of its own: "moving", "its motor on", or "" at rest with its motor off. Nothing is set."""
    port = _port(url, settings)
    try:
        port.resynchronise()
        card = GalilCard(port, settings.axis or "X")
        if card.integer(f"MG _BG{card.axis}", 0, 1):
            return "moving"
        return "" if card.integer(f"MG _MO{card.axis}", 0, 1) else "its motor on"
    finally:
        port.close()
