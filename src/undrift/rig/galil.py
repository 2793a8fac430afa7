"""Driver for one servo axis of a Galil motion controller (DMC-14xx, 2x00, 40x0, 41x3, 30010).

A command ends with a carriage return. The card answers ``:`` if it accepts the command and ``?`` if it rejects it. TC1 then returns
the reason. The answer to a question is text before the ``:``. An answer of any other form raises LinkError, so a corrupted answer
never moves a rig. Every number is rounded as the card rounds it before it is sent, and is read back before it is used.

A turn is a move by a known distance (SP, PR, BG), which the card ends itself, even if this program has ended.

The achieved rate is the difference of positions (TP) over the difference of the card's clock (TIME). The card returns TP and TIME
in one answer. If a card cannot do that, TP is read without TIME, and its time is the middle between question and answer. If an
answer is late or corrupted, the driver stops the axis (ST, then AB) and switches the motor off (MO). It then reports if the card
confirmed the stop.

Sources: command references DMC-1400, 2x00 and 40x0.
"""

import contextlib
import logging
import math
import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from undrift.errors import InputError, LinkError, RigError, RigFault, RigTimeout
from undrift.rig.link import Link, LinkedRig, LinkSettings, ask_until, end_of, link_settings
from undrift.rig.rig import (
    ACCELERATION,
    LONGEST_MOVE,
    MOVE,
    SLEW,
    CountScale,
    Position,
    RigSettings,
    ServoReport,
    check_free,
    in_words,
    steady_angle,
)
from undrift.units import RADIAN_PER_DEGREE

# ---- Commands and answers, with strict parsing.

NUMBER = re.compile(r"[ ]*-?[ ]?\d{1,12}(?:\.\d{1,8})?[ ]*")
BOTH = re.compile(r" *(-?\d{10}) +(-?\d{10}) *")
CABLE = "Check cable and baud rate."
AXES = "ABCDEFGH"

reply_end = end_of(rb"(?:^|\n)[:?]")  # prompt at the start of a line
log = logging.getLogger(__name__)


class GalilCard(Link):
    """Commands and questions for one axis of a card."""

    def __init__(self, url: str, settings: LinkSettings = LinkSettings(), axis: str = "X") -> None:
        self.axis, self._token = axis, 41_000
        self.commas = "," * (AXES.index(axis) if axis in AXES else "XYZW".index(axis))
        self._digits: int | None = None
        super().__init__(url, replace(settings, terminator="\r", reply_end=reply_end))

    def ask(self, command: str, deadline_s: float | None = None) -> str | None:
        """Return the text of the answer ("" for a bare ``:``), or None if the card rejects the command."""
        reply = self.exchange(command, deadline_s)
        if reply == "?":
            return None
        if not reply.endswith(":") or "?" in reply:
            raise LinkError(f"{self.name}: {reply!r} is not an answer to '{command}'. {CABLE}")
        return reply[:-1]

    def shout(self, command: str) -> None:
        """Send without waiting for an answer. The next question reports a lost link."""
        with contextlib.suppress(RigError):
            self.send(f"{command}\r".encode("ascii"))

    def resynchronise(self) -> None:
        """Ask the card to print a number that was not used before, and discard all bytes before that number."""
        for attempt in range(3):
            self._token += 1
            try:  # the card may add leading zeros and decimals
                self.ask_anew(f"MG {self._token}", end_of(rb"(?<!\d)0*%d(?:\.0*)?[ ]*\r?\n:" % self._token))
                return
            except RigTimeout:
                if attempt == 2:
                    raise

    def do(self, command: str) -> None:
        """Send a command whose only answer is ``:``."""
        if answer := self.text(command):
            raise self.garbled("':'", command, repr(answer))

    def text(self, command: str) -> str:
        """Ask for text and return it. If the card rejects the command, raise RigFault with the reason from TC1."""
        answer = self.ask(command)
        if answer is not None:
            return answer.strip("\r\n")
        reason = self.ask("TC1") or ""
        match = re.match(r"\s*(\d{1,3})\b", reason)
        if not match:
            raise self.garbled("an error code", "TC1", repr(reason))
        code = int(match.group(1))
        cause = f"error {code}: {in_words('galil_error', code)}"
        raise RigFault(
            f"{self.name}: the card rejected '{command}' ({cause}). Check the state of the card.",
            code=code,
            command=command,
        )

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
        if self.ask("PF 10.0") is not None and self.ask("LZ 0") is not None:
            digits = sum(character.isdigit() for character in self.text(f"TP{self.axis}"))
            self._digits = 10 if digits == 10 else None

    def set(self, name: str, value: float, *, tolerance: float = 0.0) -> float:
        """Set a parameter of the axis and read it back."""
        self.do(f"{name} {self.commas}{value:.10g}")
        actual = self.number(f"{name} {self.commas}?")
        if abs(actual - value) > tolerance:
            raise LinkError(
                f"{self.name}: set {name} to {value:.10g}, but the card returned {actual:.10g}. {CABLE}",
                wanted=value,
                held=actual,
            )
        return actual

    def garbled(self, wanted: str, command: str, got: str) -> LinkError:
        """Return the LinkError for an answer of the wrong form."""
        return LinkError(f"{self.name}: expected {wanted} in answer to '{command}', got {got}. {CABLE}")


# ---- Clock of a card.

OLD_SECOND = 1000.0 / 1024.0  # factor of old cards, which count milliseconds of 1/1024 s
CRYSTAL = 2e-4  # largest relative difference between the clock rates of card and host, 1
FINDING_S = 0.5  # longest search for the card's tick at the start, host s


def matching_ticks(answers: Iterable[tuple[int, float, float]], sample_s: float) -> list[float]:
    """Return the ticks, s, that agree with answers of TIME (ticks n, time of the question a, time of the answer b, s).

    TIME counts samples or nominal milliseconds. On old cards a millisecond is 1/1024 s (DMC-1400 command reference, TM and TIME).
    So the tick is 1 ms, 1000/1024 ms, TM or TM 1000/1024. Two answers bound it:

        (a - b0) / (n - n0 + 1) <= tick <= (b - a0) / (n - n0 - 1)
    """
    n, asked, answered = np.array([*answers], dtype=float).T
    count = n[-1] - n[:-1]
    low = ((asked[-1] - answered[:-1]) / (count + 1.0)).max(initial=0.0)
    high = ((answered[-1] - asked[:-1]) / np.maximum(count - 1.0, 0.5)).min(initial=math.inf)
    candidates = {round(tick * factor, 12) for tick in (1e-3, sample_s) for factor in (1.0, OLD_SECOND)}
    return [tick for tick in sorted(candidates) if low * (1.0 - CRYSTAL) <= tick <= high * (1.0 + CRYSTAL)]


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

    def __init__(self, card: GalilCard, settings: RigSettings = RigSettings()) -> None:
        super().__init__(card, settings.limits)
        self.card, self.clock = card, settings.timing
        self._scale = CountScale.from_lines(settings.encoder_lines)
        self._fastest = self._scale.counts(settings.limits.turn_rate)
        self._acceleration = START_ACCELERATION  # of both ramps, counts/s2
        self._enabled, self._home = False, 0
        self._last: int | None = None  # last position, counts
        self._read_at = 0.0  # time of its question, s
        self._when = (0.0, 0.0)  # time of the last position and its largest error, s
        self._both = f"MG _TP{card.axis}{{F10.0}},TIME{{F10.0}}"  # ten digits each, so that a lost byte is detected
        self._has_time = False  # True if the card returns position and time in one answer
        self._tick: tuple[float, float] | None = None  # tick and host time of tick 0, s
        self._sample_s: float | None = None  # sample period of the servo, s
        try:
            self._prepare(settings)
        except RigError:
            card.close()
            raise

    def identify(self) -> str:
        """Return the card's model and firmware, from control-R control-V."""
        with self._guarded():
            answer = self.card.text("\x12\x16").strip()
            if not answer.isprintable() or not answer:
                raise LinkError(f"{self.card.name}: {answer!r} is not a model in answer to ^R^V. Check the baud rate.")
            return answer

    def position(self) -> Position:
        """Return the angle since the rig was opened (TP), rad, and its time from the card's clock if available (TIME)."""
        with self._guarded():
            counts = self._counts()
        time, within_s = self._when
        return Position(angle=self._scale.angle(counts - self._home), time=time, within_s=within_s)

    def following_error(self) -> float:
        """Return commanded minus actual angle (TE), rad."""
        with self._guarded():
            return self._scale.angle(self.card.position(f"TE{self.card.axis}"))

    def fault(self) -> str | None:
        """Return a description of the faults (TS, SC), or None."""
        with self._guarded():
            wrong = wrong_switches(self.card.integer(f"TS{self.card.axis}", 0, 255), self._enabled)
            code = self.card.integer(f"SC{self.card.axis}", 0, 255)
        if code in STOPS_THAT_ARE_FAULTS:
            wrong.append(f"{in_words('galil_stop', code)} (stop code {code})")
        return "; ".join(wrong) or None

    def read_servo(self) -> ServoReport:
        """Return the gains (KP, KI, KD) and the sample period (TM) of the card."""
        with self._guarded():
            gains = {name: self.card.number(f"MG _{name.upper()}{self.card.axis}") for name in ("kp", "ki", "kd")}
            return ServoReport(sample_s=self._sample_s or 1e-6 * self.card.number("MG _TM"), **gains)

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
        counts = ACCELERATION.round(self._scale.counts(acceleration))
        with self._guarded():
            self._set_ramps(counts)
        return self._scale.angle(self._acceleration)

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        """Turn at a steady rate for a time that includes both ramps (SP, PR, BG), and return the rate set in the card."""
        self.limits.check_turn_rate(turn_rate)
        speed = SLEW.round(self._scale.counts(turn_rate))
        distance = MOVE.round(steady_angle(speed, seconds, self._acceleration))
        self.limits.check_travel(self._angle_now() + self._scale.angle(distance))
        with self._guarded():
            if self._is_moving():
                raise RigFault(f"{self.card.name}: the axis still moves. Stop it first.")
            actual = self.card.set("SP", abs(speed), tolerance=1)
            self.card.set("PR", distance)
            self._command("BG")
        return self._scale.angle(math.copysign(actual, turn_rate))

    def stop(self) -> None:
        """Slow down (ST) and wait until the axis is at rest. The motor stays on."""
        with self._guarded():
            self._stop()
            self._settle()

    def _prepare(self, settings: RigSettings) -> None:
        """Check that the table is free, configure the card and store the initial position. A running move is stopped."""
        card = self.card
        card.resynchronise()
        state = "moving" if self._is_moving() else "its motor on" if self._is_on() else ""
        check_free(card.name, state, settings)
        with self._safely():
            card.ask("EO 0")  # no echo
            card.resynchronise()
            card.fix_format()
            if state == "moving":
                self._stop()
            card.set("ER", max(1, round(self._scale.counts(ERROR_LIMIT))), tolerance=1)
            card.set("OE", 1)
            self._set_ramps(ACCELERATION.round(min(START_ACCELERATION, self._scale.counts(self.limits.acceleration))))
            self._enabled = self._is_on()
            self._find_clock()
            self._home = self._counts()
            forward, reverse = LONGEST_MOVE, -LONGEST_MOVE  # no limits in effect
            if self.limits.travel is not None:
                reach = int(self._scale.counts(self.limits.travel))
                forward, reverse = self._home + reach, self._home - reach
            card.set("FL", forward, tolerance=2)
            card.set("BL", reverse, tolerance=2)

    # ---- Position and time

    def _find_clock(self) -> None:
        """Use the card's clock if the card returns position and time in one answer. Search briefly for its tick."""
        answer = self.card.ask(self._both)
        self._has_time = answer is not None and bool(BOTH.fullmatch(answer.strip("\r\n")))
        if not self._has_time:
            return
        sample_s = 1e-6 * self.card.number("MG _TM")
        answers = list[tuple[int, float, float]]()

        def only_tick() -> float | None:
            answers.append(self._read()[1:])
            ticks = matching_ticks(answers, sample_s)
            return ticks[0] if len(ticks) == 1 else None

        if tick_s := self.clock.host.until(only_tick, FINDING_S):
            n, asked_s, answered_s = min(answers, key=lambda answer: answer[2] - answer[1])
            self._tick = tick_s, 0.5 * (asked_s + answered_s) - tick_s * n
            old_ticks = (1e-3 * OLD_SECOND, sample_s * OLD_SECOND)
            is_old = any(math.isclose(tick_s, tick, rel_tol=1e-9) for tick in old_ticks)
            self._sample_s = sample_s * (OLD_SECOND if is_old else 1.0)

    def _read(self) -> tuple[int, int, float, float]:
        """Return the position in counts, the card's time in ticks, and the times of question and answer, s."""
        asked_s = self.clock.now()
        if not self._has_time:
            return self.card.position(f"TP{self.card.axis}"), 0, asked_s, self.clock.now()
        answer = self.card.text(self._both)
        match = BOTH.fullmatch(answer)
        if not match:
            raise self.card.garbled("two numbers with ten digits", self._both, repr(answer))
        return int(match.group(1)), int(match.group(2)), asked_s, self.clock.now()

    def _counts(self) -> int:
        """Return the position in counts, and store its time. A position that the axis cannot have reached raises LinkError."""
        counts, ticks, asked_s, answered_s = self._read()
        # largest possible motion, from the last question to this answer, and 10 deg
        reach = 1.5 * self._fastest * (answered_s - self._read_at) + self._scale.counts_per_turn / 36.0
        if self._last is not None and abs(counts - self._last) > reach:
            raise LinkError(
                f"{self.card.name}: expected a position within {reach:.0f} counts of {self._last}, got {counts}. "
                "The card was restarted, the answer is corrupted, or clock_speed is wrong.",
                counts=counts,
            )
        self._last, self._read_at = counts, asked_s
        self._when = 0.5 * (asked_s + answered_s), 0.5 * (answered_s - asked_s)
        if self._tick is not None:
            tick_s, zero_s = self._tick
            self._when = zero_s + tick_s * (ticks + 0.5), 0.5 * tick_s
        return counts

    def _angle_now(self) -> float:
        """Return the angle since the rig was opened at the last reading of the position, rad."""
        return 0.0 if self._last is None else self._scale.angle(self._last - self._home)

    def _settle(self) -> None:
        """Wait until the position changes by at most one count. The servo settles after the profile ends."""
        before = self._counts()
        for _ in range(50):
            self.clock.wait(0.02)
            counts = self._counts()
            if abs(counts - before) <= 1:
                break
            before = counts

    # ---- Motion

    def _set_ramps(self, counts: int) -> None:
        self._acceleration = self.card.set("AC", counts, tolerance=1024)
        self.card.set("DC", self._acceleration)

    def _command(self, letters: str) -> None:
        self.card.do(f"{letters}{self.card.axis}")

    def _is_moving(self) -> bool:
        return bool(self.card.integer(f"MG _BG{self.card.axis}", 0, 1))

    def _is_on(self) -> bool:
        return not self.card.integer(f"MG _MO{self.card.axis}", 0, 1)

    def _wait_for_rest(self, expected_s: float) -> None:
        """Poll until the profile is complete, for at most twice the expected time plus 2 s."""
        allowed_s = 2.0 * expected_s + STOP_MARGIN_S
        if not ask_until(lambda: not self._is_moving(), self.clock, allowed_s):
            raise RigTimeout(
                f"{self.card.name}: the axis is still moving after {allowed_s:.3g} s. Check the table.",
                deadline_s=allowed_s,
            )

    def _stop(self) -> None:
        self._command("ST")
        self._wait_for_rest(self._fastest / self._acceleration)

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
                card.do("AB")
                self._wait_for_rest(0.0)
            self._command("MO")
            return not self._is_on()
        except RigError as error:
            log.error("%s: not confirmed at rest: %s", card.name, error)
            self._refused = "it could not be brought to rest"
            # The card may still receive commands. It rejects MO until AB has ended the motion.
            for command in (f"ST{card.axis}", "AB", f"MO{card.axis}", f"MO{card.axis}"):
                card.shout(command)
                self.clock.host.wait(0.05)
            return False

    def _reconnect(self) -> None:
        """Reconnect, with repeated attempts, because a card does not answer immediately after a restart."""
        for _ in range(RECONNECTIONS - 1):
            with contextlib.suppress(LinkError):
                return self.card.reconnect()
            self.clock.host.wait(0.3)
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
    return GalilRig(GalilCard(url, link_settings(settings), settings.axis or "X"), settings)
