"""Manual rig: a person mounts the device on its faces and turns it by hand through known angles.

A whole turn of a turntable back to its mark is 360 deg within a small fraction of a degree, at any rate. The calibration uses the
angle, not the rate, so `move_by` works and `turn_for` does not.
"""

import math
from collections.abc import Callable

from undrift.base.clock import HOST, Clock
from undrift.errors import InputError, RigFault
from undrift.live.transports import number_of
from undrift.record import Face
from undrift.rig.chamber import ask_person
from undrift.rig.rig import Limits, Position, RigSettings
from undrift.units import RADIAN_PER_DEGREE

QUESTIONS = 3  # number of attempts to enter a number


class AskedOperator:
    """A person at the table, who is asked one line at a time."""

    def __init__(self, ask: Callable[[str], str]) -> None:
        self._ask = ask

    def mount(self, up: Face) -> None:
        """Ask the operator to mount the device."""
        line = f"Motor off. Mount the device with {up} up, step back, then press Enter (q gives up): "
        failure = f"mounting: the device was not mounted {up} up"
        ask_person(self._ask, line, failure, "Mount it and continue with `resume`.")


class ManualRig:
    """A person who is asked, one line at a time: a Rig without motor and link."""

    def __init__(self, ask: Callable[[str], str], limits: Limits = Limits(turn_rate=1e3), clock: Clock = HOST) -> None:
        self.limits = limits
        self._ask, self._clock = ask, clock
        self._angle = 0.0

    def identify(self) -> str:
        return "a person who turns the device by hand"

    def enable(self, on: bool) -> None:
        pass

    def set_acceleration(self, acceleration: float) -> float:
        return math.nan

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        raise RigFault("manual rig: a hand cannot turn at a steady rate. Replace [rates] with [turns] in the protocol.")

    def move_by(self, angle: float) -> float:
        """Ask the operator to turn the device by an angle, and return the angle that the operator reports, rad."""
        self.limits.check_travel(self._angle + angle)
        asked_deg = angle / RADIAN_PER_DEGREE
        line = f"Turn the device by {asked_deg:+g} deg, then type the angle it turned in deg (Enter: exactly that, q: give up): "
        for _ in range(QUESTIONS):
            answer = ask_person(self._ask, line, "manual rig: the turn was not done", "The operator gave up.")
            turned_deg = number_of(answer.removesuffix("deg").replace(",", ".")) if answer else asked_deg
            if math.isfinite(turned_deg):
                self._angle += turned_deg * RADIAN_PER_DEGREE
                return turned_deg * RADIAN_PER_DEGREE
        raise InputError("manual rig: three answers are not an angle in deg. Start again.")

    def position(self) -> Position:
        return Position(angle=self._angle, time=self._clock.now())

    def fault(self) -> str | None:
        return None

    def stop(self) -> None:
        pass

    def close(self) -> None:
        pass


def open_from(url: str, settings: RigSettings) -> ManualRig:
    """Open a manual rig."""
    if url:
        raise InputError(f"manual rig: the address must be 'manual:', got 'manual:{url}'. A person has no port.")
    if settings.ask is None:
        raise InputError("manual rig: it must ask a person, but `ask` is not set. Set RigSettings(ask=...).")
    return ManualRig(settings.ask, settings.limits, settings.clock)
