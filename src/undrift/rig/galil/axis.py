"""One axis of a Galil card: whether it moves, bringing it to rest - and to safety when the link fails.

Waiting for rest polls `MG _BG`, which is 1 while the profile runs. Safety is ST, AB when that does not help, then MO.
"""

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager

from undrift.errors import LinkError, RigError, RigFault, RigTimeout
from undrift.rig.clock import Clock
from undrift.rig.galil.card import GalilCard
from undrift.rig.galil.place import GalilPlace

UNCONFIRMED = "it is NOT CONFIRMED that the table stopped: cut the amplifier's power"
RECONNECTIONS = 4
STOP_MARGIN_S = 2.0  # on top of twice the time that coming to rest should take
AXIS_DECELERATION = 256_000.0  # counts/s2, the card's own default

log = logging.getLogger(__name__)


class GalilAxis:
    """What the axis does, in counts.

    Parameters
    ----------
    card : GalilCard
        Its language.
    clock : Clock
        Hardware's or an emulator's.
    fastest : float
        Largest rate the axis is ever told, counts/s.
    place : GalilPlace
        Where it is.
    """

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
        """Give a command to this axis.

        Parameters
        ----------
        letters : str
            SH, MO, BG, ST.
        """
        self.card.do(f"{letters}{self.card.axis}")

    def is_moving(self) -> bool:
        """Return whether the profile runs.

        Returns
        -------
        bool
            `MG _BG`.
        """
        return bool(self.card.integer(f"MG _BG{self.card.axis}", 0, 1))

    def is_on(self) -> bool:
        """Return whether the motor is on.

        Returns
        -------
        bool
            `MG _MO` is 0.
        """
        return not self.card.integer(f"MG _MO{self.card.axis}", 0, 1)

    def stop_code(self) -> int:
        """Return why it stopped.

        Returns
        -------
        int
            SC.
        """
        return self.card.integer(f"SC{self.card.axis}", 0, 255)

    def wait_for_rest(self, expected_s: float) -> None:
        """Poll until the profile is complete: at most twice as long as it should take, and 2 s.

        Parameters
        ----------
        expected_s : float
            How long it should take, s of the clock.

        Raises
        ------
        RigTimeout
            It still moves.
        """
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
        """Stop and switch off before the failure of a link is reported.

        Yields
        ------
        None
            Once.

        Raises
        ------
        RigTimeout or LinkError
            As it was raised within, with what became of the table.
        """
        try:
            yield
        except (LinkError, RigTimeout) as error:
            outcome = "the table was stopped and its motor switched off" if self.make_safe() else UNCONFIRMED
            raise type(error)(f"{error}; {outcome}", **error.numbers) from error

    def make_safe(self) -> bool:
        """Stop and switch off, over a new connection where the old one is gone.

        Returns
        -------
        bool
            Whether the card confirmed it; no RigError is raised.
        """
        port = self.card.port
        self.enabled = self.jogging = False
        try:
            if not port.is_open:
                self.refused = "the connection was lost, and the card may have forgotten what it was told"
                self._reconnect()
            port.shout(f"ST{self.card.axis}")  # at once; its answer is thrown away by the next line
            port.resynchronise()
            self._come_to_rest()
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

    def _come_to_rest(self) -> None:
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
