"""Rig: what every rate table can do, whichever controller stands behind it.

Angles are rad, rates rad/s, positive about the table's own axis. A rig rounds what it is told to its counts; every call returns
the value it ACHIEVED, never the one that was asked for.
"""

import math
from dataclasses import dataclass
from typing import Protocol

from undrift.errors import InputError, LimitError

ROUNDING = 1.0 + 1e-9  # a limit given in degrees is met exactly by a rate given in degrees


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a rig may be told to do; anything beyond raises LimitError before a byte is sent.

    Parameters
    ----------
    turn_rate : float
        Largest rate either way, rad/s.
    acceleration : float
        Largest acceleration, rad/s2.
    travel : float or None
        Largest angle either way from where it was connected, rad; None turns without end.
    """

    turn_rate: float = 2.0 * math.pi
    acceleration: float = 100.0
    travel: float | None = None

    def __post_init__(self) -> None:
        for name in ("turn_rate", "acceleration", "travel"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise InputError(f"limits: wanted {name} above 0, got {value}; a rig without limits is not driven")

    def check_turn_rate(self, turn_rate: float) -> None:
        """Refuse a rate that the rig may not be told.

        Parameters
        ----------
        turn_rate : float
            rad/s, signed.

        Raises
        ------
        LimitError
            Too fast, or not a number.
        """
        if not abs(turn_rate) <= self.turn_rate * ROUNDING:
            raise LimitError(
                f"turn rate: wanted at most {self.turn_rate:g} rad/s either way, got {turn_rate:g}; choose a slower one",
                turn_rate=turn_rate,
            )

    def check_acceleration(self, acceleration: float) -> None:
        """Refuse an acceleration that the rig may not be told.

        Parameters
        ----------
        acceleration : float
            rad/s2.

        Raises
        ------
        LimitError
            Not above zero, or too large.
        """
        if not 0.0 < acceleration <= self.acceleration * ROUNDING:
            raise LimitError(
                f"acceleration: wanted above 0 and at most {self.acceleration:g} rad/s2, got {acceleration:g}; "
                "choose a smaller one",
                acceleration=acceleration,
            )

    def check_travel(self, angle: float) -> None:
        """Refuse an angle that the rig may not be turned to.

        Parameters
        ----------
        angle : float
            rad, from where the rig was connected.

        Raises
        ------
        LimitError
            Too far from the start.
        """
        if self.travel is not None and not abs(angle) <= self.travel * ROUNDING:
            raise LimitError(
                f"travel: wanted to stay within {self.travel:g} rad of the start, got a move to {angle:g}; "
                "choose a shorter one",
                angle=angle,
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """Where the axis stands.

    Parameters
    ----------
    angle : float
        rad.
    time : float
        The host's monotonic clock, s; only differences count where a controller's own clock is in it.
    within_s : float
        It may be off by that much either way, s: half the time between question and answer, or half a tick of the controller.
    """

    angle: float
    time: float
    within_s: float = 0.0


class Rig(Protocol):
    """One axis that turns a device."""

    @property
    def limits(self) -> Limits:
        """What it may be told."""

    def identify(self) -> str:
        """Return make, model and firmware."""

    def enable(self, on: bool) -> None:
        """Switch the motor on or off.

        Parameters
        ----------
        on : bool
            True for on.
        """

    def set_acceleration(self, acceleration: float) -> float:
        """Set run-up and slow-down.

        Parameters
        ----------
        acceleration : float
            rad/s2.

        Returns
        -------
        float
            As the controller rounded it, rad/s2.
        """

    def turn(self, turn_rate: float) -> float:
        """Turn at a steady rate until told otherwise.

        Parameters
        ----------
        turn_rate : float
            rad/s, signed.

        Returns
        -------
        float
            As the controller rounded it, rad/s.
        """

    def move_by(self, angle: float) -> float:
        """Turn by an angle and come to rest.

        Parameters
        ----------
        angle : float
            rad, signed.

        Returns
        -------
        float
            Angle that was turned, rad.
        """

    def stop(self) -> None:
        """Slow down and wait until the axis is at rest; the motor stays on."""

    def position(self) -> Position:
        """Return where the axis stands now."""

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

    def following_error(self) -> float:
        """Return commanded minus actual angle, rad."""

    def fault(self) -> str | None:
        """Return what is wrong with it, or None."""

    def close(self) -> None:
        """Stop, switch the motor off, let go of the link; harmless when called again."""
