"""What a GRBL rig says without moving: who it is, where it stands, what is wrong with it."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from undrift.errors import InputError, LinkError, RigError
from undrift.rig.clock import Clock
from undrift.rig.grbl.axis import GrblAxis
from undrift.rig.grbl.stored import AXES
from undrift.rig.link import Link
from undrift.rig.rig import Limits, Position
from undrift.units import RADIAN_PER_DEGREE


@dataclass(frozen=True, slots=True, kw_only=True)
class GrblSettings:
    """What the driver cannot ask the controller.

    Parameters
    ----------
    limits : Limits
        What the rig may be told.
    axis : str
        Letter of the axis: X, Y, Z, A, B or C.
    move_turn_rate : float
        Rate of `move_by`, rad/s.
    clock : Clock
        Hardware's, or a faster emulator's.
    """

    limits: Limits = field(default_factory=Limits)
    axis: str = "A"
    move_turn_rate: float = 90.0 * RADIAN_PER_DEGREE
    clock: Clock = field(default_factory=Clock)

    def __post_init__(self) -> None:
        if self.axis not in tuple(AXES):
            raise InputError(f"grbl: wanted an axis X, Y, Z, A, B or C, got '{self.axis}'; name one")


class GrblReports:
    """A GRBL rig as far as it only says things; GrblRig moves it.

    Parameters
    ----------
    link : Link
        Open; closed again when nobody answers.
    settings : GrblSettings
        Limits and axis.

    Raises
    ------
    RigError
        Nobody answers, or no GRBL.
    """

    def __init__(self, link: Link, settings: GrblSettings = GrblSettings()) -> None:
        self._settings = settings
        self._closed = False
        try:
            self._axis = GrblAxis(link, settings.axis, settings.clock)
        except RigError:
            link.close()
            raise

    @property
    def limits(self) -> Limits:
        """What it may be told."""
        return self._settings.limits

    def identify(self) -> str:
        """Return the firmware's greeting and what ``$I`` says."""
        with self._guarded():
            return "; ".join([self._axis.greeting, *(line.strip("[]") for line in self._axis.grbl.do("$I"))])

    def position(self) -> Position:
        """Return where the axis stands in commanded steps, from where it stood when the rig was opened, rad."""
        clock = self._settings.clock
        with self._guarded():
            before = clock.now()
            place_deg = self._axis.read_place()
            after = clock.now()
        return Position(
            angle=(place_deg - self._axis.home_deg) * RADIAN_PER_DEGREE,
            time=0.5 * (before + after),
            within_s=0.5 * (after - before),
        )

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
        """Return NaN: a stepper without an encoder does not know."""
        return math.nan

    def fault(self) -> str | None:
        """Return what is wrong in words, None when all is well."""
        feeder = self._axis.feeder
        if feeder is not None and feeder.failure is not None:
            return str(feeder.failure)
        with self._guarded():
            status = self._axis.grbl.status()
        if status.state in ("Alarm", "Door"):
            return self._axis.grbl.alarm_text(status)
        if self._axis.enabled and status.state == "Sleep":
            return "the motor is asleep though it was switched on"
        return None

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        if self._closed:
            raise LinkError(
                f"{self._axis.name}: wanted a rig ready for commands, got none: it is closed; open it again"
            )
        with self._axis.guarded():
            yield
