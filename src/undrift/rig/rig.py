"""Rig: what every rate table can do, whichever controller stands behind it.

Angles are rad, rates rad/s, positive about the table's own axis. A rig rounds what it is told to its counts; every call returns
the value it ACHIEVED, never the one that was asked for.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np


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

    turn_rate: float = 2.0 * np.pi
    acceleration: float = 100.0
    travel: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Position:
    """Where the axis stands.

    Parameters
    ----------
    angle : float
        rad.
    time : float
        The host's monotonic clock, s.
    """

    angle: float
    time: float


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
