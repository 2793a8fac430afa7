"""What a Galil rig says without moving: who it is, where it stands, how far behind it is, what is wrong with it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from undrift.errors import InputError, LinkError
from undrift.rig.clock import Clock
from undrift.rig.counts import SLEW, CountScale
from undrift.rig.galil.axis import GalilAxis
from undrift.rig.galil.card import GalilCard
from undrift.rig.galil.place import GalilPlace
from undrift.rig.galil.port import GalilPort
from undrift.rig.galil.words import STOPS_THAT_ARE_FAULTS, Switches, stop_in_words
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


class GalilReports:
    """A Galil rig as far as it only says things; GalilRig moves it.

    Parameters
    ----------
    port : GalilPort
        Open.
    settings : GalilSettings
        Encoder, limits, axis.
    """

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
        """What it may be told."""
        return self._settings.limits

    def identify(self) -> str:
        """Return the card's model and firmware, as it answers to control-R control-V."""
        with self._guarded():
            said = self.card.text("\x12\x16").strip()
            if not said.isprintable() or not said:
                raise LinkError(f"{self.card.port.name}: wanted a model in answer to ^R^V, got {said!r}; check baud")
            return said

    def position(self) -> Position:
        """Return where the axis stands (TP) and when by the card's own TIME, from where it stood when the rig was opened, rad."""
        with self._guarded():
            place = self._axis.place.read()
        return Position(angle=self._angle(place.counts), time=place.time, within_s=place.within_s)

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
