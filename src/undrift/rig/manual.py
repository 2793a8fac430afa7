"""Manual rig: a person mounts the device on its faces and turns it by hand through known angles.

A whole turn of a turntable back to its mark is 360 deg to a small fraction of a degree, at any rate. The calibration uses the
angle, not the rate, so `move_by` works and `turn_for` does not. A person can also set a chamber. The device's own thermometer then
determines when the soak ends.
"""

import logging
import math
from collections.abc import Callable

from undrift.base.clock import HOST, Clock
from undrift.errors import InputError, RigFault
from undrift.live.transports import number_of
from undrift.record import Face
from undrift.rig.chamber import Chamber, ChamberSetup
from undrift.rig.rig import Limits, Position, RigSettings
from undrift.units import RADIAN_PER_DEGREE

log = logging.getLogger(__name__)
GIVING_UP = ("q", "quit", "stop")
QUESTIONS = 3  # number of attempts to get a number


def _answer(ask: Callable[[str], str], line: str, failure: str, advice: str) -> str:
    try:
        answer = ask(line).strip()
    except EOFError:
        answer = "q"
    if answer.lower() in GIVING_UP:
        raise RigFault(f"{failure}, got '{answer}'. {advice}")
    return answer


class AskedOperator:
    """A person at the table, who is asked one line at a time."""

    def __init__(self, ask: Callable[[str], str]) -> None:
        self._ask = ask

    def mount(self, up: Face) -> None:
        """Ask the operator to mount the device."""
        line = f"Motor off. Mount the device with {up} up, step back, then press Enter (q gives up): "
        failure = f"mounting: the device was not mounted {up} up"
        _answer(self._ask, line, failure, "Mount it and continue with `resume`.")


class HandChamber(Chamber):
    """A chamber that a person sets. Its temperature cannot be read."""

    near_c = 5.0  # self-heating plus the error of an untrimmed thermometer, K

    def __init__(self, ask: Callable[[str], str], settings: ChamberSetup = ChamberSetup()) -> None:
        super().__init__(settings)
        self._ask = ask

    def read(self) -> None:
        """Return None, because the temperature cannot be read."""
        return

    def soaked(self) -> bool:
        """Return True, because only the device's thermometer can decide."""
        return True

    def switch_off(self) -> None:
        """Warn that the person must switch the chamber off."""
        if self._set_point is not None:
            log.warning("chamber: set by hand, so it is still on. Switch it off.")

    def _measure(self) -> float:
        return math.nan

    def _send(self, temp_c: float) -> float:
        line = f"Set the chamber to {temp_c:g} degC, then press Enter (q gives up): "
        failure = f"chamber: it was not set to {temp_c:g} degC"
        _answer(self._ask, line, failure, "Set it and continue with `resume`.")
        return temp_c


def open_chamber_from(address: str, settings: ChamberSetup, ask: Callable[[str], str] | None) -> HandChamber:
    """Return a chamber that a person sets and switches off."""
    if ask is None:
        raise InputError("chamber: a chamber set by hand requires a person to ask. Use a terminal.")
    return HandChamber(ask, settings)


class ManualRig:
    """A person who is asked, one line at a time."""

    def __init__(self, ask: Callable[[str], str], limits: Limits = Limits(turn_rate=1e3), clock: Clock = HOST) -> None:
        self.limits = limits
        self._ask, self._clock = ask, clock
        self._angle = 0.0

    def identify(self) -> str:
        """Return a description of the manual rig."""
        return "a person who turns the device by hand"

    def enable(self, on: bool) -> None:
        """Do nothing, because there is no motor."""

    def set_acceleration(self, acceleration: float) -> float:
        """Return NaN, because the acceleration of a hand is unknown."""
        return math.nan

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        """Raise RigFault, because a hand cannot turn at a steady rate."""
        raise RigFault("manual rig: a hand cannot turn at a steady rate. Replace [rates] with [turns] in the protocol.")

    def move_by(self, angle: float) -> float:
        """Ask the operator to turn the device by an angle, and return the angle that the operator reports, rad."""
        self.limits.check_travel(self._angle + angle)
        asked_deg = angle / RADIAN_PER_DEGREE
        line = f"Turn the device by {asked_deg:+g} deg, then type the angle it turned in deg (Enter: exactly that, q: give up): "
        for _ in range(QUESTIONS):
            answer = _answer(self._ask, line, "manual rig: the turn was not done", "The operator gave up.")
            turned_deg = number_of(answer.removesuffix("deg").replace(",", ".")) if answer else asked_deg
            if math.isfinite(turned_deg):
                self._angle += turned_deg * RADIAN_PER_DEGREE
                return turned_deg * RADIAN_PER_DEGREE
        raise InputError("manual rig: three answers are not an angle in deg. Start again.")

    def stop(self) -> None:
        """Do nothing, because a manual rig does not move without its operator."""

    def position(self) -> Position:
        """Return the sum of the reported angles, rad, and the current time."""
        return Position(angle=self._angle, time=self._clock.now())

    def fault(self) -> str | None:
        """Return None, because the operator reports faults."""
        return None

    def close(self) -> None:
        """Do nothing, because there is no link."""


def open_from(url: str, settings: RigSettings) -> ManualRig:
    """Open a manual rig."""
    if url:
        raise InputError(f"manual rig: the address must be 'manual:', got 'manual:{url}'. A person has no port.")
    if settings.ask is None:
        raise InputError("manual rig: no way to ask a person. Set RigSettings(ask=...).")
    return ManualRig(settings.ask, settings.limits, settings.timing)
