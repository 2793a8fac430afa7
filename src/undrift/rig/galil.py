"""Galil cards (DMC-14xx, 2x00, 40x0, 41x3, 30010): one servo axis behind an ASCII language.

Rates are counts/s of an encoder with 4 counts a line. Every number is rounded as the card rounds it before it is sent, and read
back before it is used, so that a lost byte never becomes a wrong rate. The rate that was achieved is the difference of two
positions (TP) over the time between them; the card's own TV is an average over 0.25 s and is not used. Whenever an answer is late
or makes no sense the driver stops the axis (ST, then AB), switches the motor off (MO), and says whether the card confirmed it.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from undrift.errors import InputError, LinkError, RigError, RigFault
from undrift.rig.address import RigSettings
from undrift.rig.clock import Clock
from undrift.rig.counts import ACCELERATION, JOG, JOG_BY_TWO, LONGEST_MOVE, MOVE, SLEW, CountScale
from undrift.rig.galil_axis import UNCONFIRMED, GalilAxis
from undrift.rig.galil_card import GalilCard
from undrift.rig.galil_gclib import GclibPort
from undrift.rig.galil_port import GalilPort, LinkPort
from undrift.rig.galil_words import STOPS_THAT_ARE_FAULTS, Switches, stop_in_words
from undrift.rig.link import LinkSettings
from undrift.rig.rig import Limits, Position
from undrift.units import RADIAN_PER_DEGREE


@dataclass(frozen=True, slots=True, kw_only=True)
class GalilSettings:
    """What the driver cannot ask the card.

    Parameters
    ----------
    limits : Limits
        What the rig may be told.
    encoder_lines : int
        Lines of the encoder; a turn is 4 times as many counts.
    axis : str
        Letter of the axis, A to H or X, Y, Z, W.
    speed_step : int
        Counts/s between two jog speeds: 1, or 2 on older cards.
    move_turn_rate : float
        Rate of `move_by`, rad/s.
    error_limit : float
        Following error at which the card switches the motor off by itself (ER, OE1), rad.
    clock : Clock
        Hardware's, or a faster emulator's.
    """

    limits: Limits = field(default_factory=Limits)
    encoder_lines: int = 10_000
    axis: str = "X"
    speed_step: int = 1
    move_turn_rate: float = 90.0 * RADIAN_PER_DEGREE
    error_limit: float = 5.0 * RADIAN_PER_DEGREE
    clock: Clock = field(default_factory=Clock)

    def __post_init__(self) -> None:
        if self.axis not in tuple("ABCDEFGHXYZW"):
            raise InputError(f"galil: wanted an axis A to H or X, Y, Z, W, got '{self.axis}'; name one")
        if self.speed_step not in (1, 2):
            raise InputError(f"galil: wanted speed_step 1 or 2, got {self.speed_step}; see JG in the card's manual")


class GalilRig:
    """A rate table on a Galil card; nothing moves until `turn` or `move_by`.

    Parameters
    ----------
    port : GalilPort
        Open; the rig closes it.
    settings : GalilSettings
        Encoder, limits, axis.

    Raises
    ------
    RigTimeout
        The card does not answer.
    LinkError
        What answers is no Galil card.
    """

    def __init__(self, port: GalilPort, settings: GalilSettings = GalilSettings()) -> None:
        self._settings = settings
        self._scale = CountScale.from_lines(settings.encoder_lines)
        self._move_speed = SLEW.round(self._scale.counts(min(settings.move_turn_rate, settings.limits.turn_rate)))
        fastest = max(self._scale.counts(settings.limits.turn_rate), self._move_speed)
        self.card = GalilCard(port, settings.axis)
        self._axis = GalilAxis(self.card, settings.clock, fastest, slack=self._scale.counts_per_turn / 36.0)
        self._closed = False
        try:
            self._home = self._prepare()
        except RigError:
            port.close()
            raise

    @property
    def limits(self) -> Limits:
        """What it may be told."""
        return self._settings.limits

    def identify(self) -> str:
        """Return the card's model and firmware, as it answers to control-R control-V."""
        with self._guarded():
            said = self.card.text("\x12\x16").strip()
            if not said.isprintable() or not said:
                raise LinkError(f"{self.card.port.name}: wanted a model in answer to ^R^V, got {said!r}; check baud")
            return said

    def enable(self, on: bool) -> None:
        """Switch the motor on (SH) or off (MO); off stops the axis first.

        Parameters
        ----------
        on : bool
            True for on.

        Raises
        ------
        RigFault
            The card did not do it.
        """
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
        """Set run-up (AC) and slow-down (DC), multiples of 1024 counts/s2.

        Parameters
        ----------
        acceleration : float
            rad/s2.

        Returns
        -------
        float
            As the card holds it, rad/s2.

        Raises
        ------
        LimitError
            Beyond the rig's limits or the card's range.
        """
        self.limits.check_acceleration(acceleration)
        counts = ACCELERATION.round(self._scale.counts(acceleration))
        with self._guarded():
            held = self.card.set("AC", counts, tolerance=1024)
            self._axis.deceleration = self.card.set("DC", held, tolerance=1024)
        return self._scale.angle(held)

    def turn(self, turn_rate: float) -> float:
        """Turn at a steady rate until told otherwise (JG, BG); a turning axis changes over to it.

        Parameters
        ----------
        turn_rate : float
            rad/s, signed; 0 stops.

        Returns
        -------
        float
            As the card holds it, rad/s.

        Raises
        ------
        LimitError
            Beyond the rig's limits, or less than one count per second.
        RigFault
            The motor is off, a limit switch is pressed, or a move still runs.
        """
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
        """Turn by an angle (PR, BG) and wait until the axis is at rest.

        Parameters
        ----------
        angle : float
            rad, signed.

        Returns
        -------
        float
            Angle between the positions before and after, rad.

        Raises
        ------
        LimitError
            Beyond the travel or the card's range.
        RigFault
            The axis stopped short; the reason in words.
        RigTimeout
            It did not come to rest in time.
        """
        counts = MOVE.round(self._scale.counts(angle))
        self.limits.check_travel(self._angle(self._axis.last[0] if self._axis.last else self._home) + angle)
        with self._guarded():
            if self._axis.is_moving():
                raise RigFault(f"{self.card.port.name}: wanted to move, got an axis that moves; stop it first")
            before, _ = self._axis.read_position()
            self.card.set("PR", counts)
            self._axis.jogging = False
            self._axis.command("BG")
            self._axis.wait_for_rest(abs(counts) / self._move_speed + 2.0 * self._move_speed / self._axis.deceleration)
            self._check_arrived()
            return self._scale.angle(self._axis.settled() - before)

    def stop(self) -> None:
        """Slow down (ST) and wait until the axis is at rest; the motor stays on."""
        with self._guarded():
            self._axis.stop()
            self._axis.settled()

    def position(self) -> Position:
        """Return where the axis stands (TP), from where it stood when the rig was opened, rad."""
        with self._guarded():
            counts, now = self._axis.read_position()
        return Position(angle=self._angle(counts), time=now)

    def measured_turn_rate(self, duration_s: float) -> float:
        """Return the mean rate over a while, from two positions.

        Parameters
        ----------
        duration_s : float
            s.

        Returns
        -------
        float
            rad/s.
        """
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

    def close(self) -> None:
        """Stop, switch the motor off, let go of the link; harmless when called again.

        Raises
        ------
        LinkError
            The card did not confirm that the motor is off; raised once, after the link was let go.
        """
        if self._closed:
            return
        self._closed = True
        try:
            confirmed = self._axis.make_safe()
        finally:
            self.card.port.close()
        if not confirmed:
            raise LinkError(f"{self.card.port.name}: wanted the motor off at the end, got no answer; {UNCONFIRMED}")

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
            home, _ = self._axis.read_position()
            forward, reverse = LONGEST_MOVE, -LONGEST_MOVE - 1  # switched off
            if self.limits.travel is not None:
                reach = int(self._scale.counts(self.limits.travel))
                forward, reverse = home + reach, home - reach
            card.set("FL", forward)
            card.set("BL", reverse)
        return home

    def _speak_plainly(self) -> None:
        """No echo, unsolicited characters marked, positions with all their digits."""
        port, card = self.card.port, self.card
        card.tries("EO 0")  # no echo
        port.resynchronise()
        if card.tries("CW 1"):  # what nobody asked for has its high bit set
            port.mask_unsolicited()
        card.fix_format()

    def _angle(self, counts: int) -> float:
        return self._scale.angle(counts - self._home)

    def _check_arrived(self) -> None:
        code = self._axis.stop_code()
        if code != 1:
            raise RigFault(
                f"{self.card.port.name}: wanted the move complete, got the axis {stop_in_words(code)} (stop code {code}); "
                "look at the table",
                code=code,
            )

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Refuse a rig that is closed or lost; else let the axis guard what is done."""
        why = "it is closed" if self._closed else self._axis.refused
        if why:
            raise LinkError(f"{self.card.port.name}: wanted a rig ready for commands, got none: {why}; open it again")
        with self._axis.guarded():
            yield


def open_from(url: str, settings: RigSettings) -> GalilRig:
    """Open a Galil rig.

    Parameters
    ----------
    url : str
        As Link takes it, or ``gclib://`` and what gclib takes.
    settings : RigSettings
        Encoder, limits, link.

    Returns
    -------
    GalilRig
        Connected.
    """
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
