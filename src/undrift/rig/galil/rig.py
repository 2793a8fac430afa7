"""Galil cards (DMC-14xx, 2x00, 40x0, 41x3, 30010): one servo axis behind an ASCII language.

Rates are counts/s of an encoder with 4 counts a line. Every number is rounded as the card rounds it before it is sent, and read
back before it is used, so that a lost byte never becomes a wrong rate. The rate that was achieved is the difference of positions
(TP) over the time between them by the card's own clock; its TV is an average over 0.25 s and is not used. Whenever an answer is
late or makes no sense the driver stops the axis (ST, then AB), switches the motor off (MO), and says whether the card confirmed it.
"""

from undrift.errors import LinkError, RigError, RigFault
from undrift.rig.address import RigSettings
from undrift.rig.clock import Clock
from undrift.rig.counts import ACCELERATION, JOG, JOG_BY_TWO, LONGEST_MOVE, MOVE
from undrift.rig.galil.axis import UNCONFIRMED
from undrift.rig.galil.gclib import GclibPort
from undrift.rig.galil.port import GalilPort, LinkPort
from undrift.rig.galil.reports import GalilReports, GalilSettings
from undrift.rig.galil.words import stop_in_words
from undrift.rig.link import LinkSettings


class GalilRig(GalilReports):
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
        super().__init__(port, settings)
        try:
            self._home = self._prepare()
        except RigError:
            port.close()
            raise

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
