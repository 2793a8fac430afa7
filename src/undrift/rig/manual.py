"""A rig that is a person: mounts the device on its faces and turns it by hand through known angles.

A whole turn of a turntable back to its mark is 360 deg to a small fraction of a degree, whatever its rate was. The angle
calibrates, not the rate, so `move_by` works and `turn_for` does not. A chamber can be set by a person too: the device's own
thermometer shows when it has soaked.
"""

import logging
import math
from collections.abc import Callable

from undrift.base.clock import HOST, Clock
from undrift.errors import InputError, LinkError, RigFault
from undrift.live.transports import number_of
from undrift.record import Face
from undrift.rig.chamber import Chamber, ChamberSetup
from undrift.rig.rig import Limits, Position, RigSettings
from undrift.units import RADIAN_PER_DEGREE

log = logging.getLogger(__name__)
GIVING_UP = ("q", "quit", "stop")
QUESTIONS = 3  # how often an answer that is no number is asked for again


def _said(ask: Callable[[str], str], line: str, wanted: str, advice: str) -> str:
    try:
        answer = ask(line).strip()
    except EOFError:
        answer = "q"
    if answer.lower() in GIVING_UP:
        raise RigFault(f"{wanted}, got '{answer}'; {advice}")
    return answer


class AskedOperator:
    """A person at the table, asked one line at a time."""

    def __init__(self, ask: Callable[[str], str]) -> None:
        self._ask = ask

    def mount(self, up: Face) -> None:
        """Have the device mounted."""
        line = f"Motor off. Mount the device with {up} up, step back, then press Enter (q gives up): "
        _said(self._ask, line, f"mounting: wanted the device mounted {up} up", "continue with `resume` when it is")


class HandChamber(Chamber):
    """A chamber that a person sets when asked to; nothing can be read from it."""

    near_c = 5.0  # K, self-heating plus the error of an untrimmed thermometer

    def __init__(self, ask: Callable[[str], str], settings: ChamberSetup = ChamberSetup()) -> None:
        super().__init__(settings)
        self._ask = ask

    def read(self) -> None:
        """Nothing to read."""
        return

    def soaked(self) -> bool:
        """Leave it to the device's thermometer."""
        return True

    def switch_off(self) -> None:
        """Leave it to the person, and say so."""
        if self._set_point is not None:
            log.warning("chamber: set by hand, and still on; switch it off")

    def _measure(self) -> float:
        return math.nan

    def _send(self, temp_c: float) -> float:
        line = f"Set the chamber to {temp_c:g} degC, then press Enter (q gives up): "
        _said(self._ask, line, f"chamber: wanted it set to {temp_c:g} degC", "continue with `resume` when it can be")
        return temp_c


def open_chamber_from(address: str, settings: ChamberSetup, ask: Callable[[str], str] | None) -> HandChamber:
    """Return a chamber that a person sets and switches off."""
    if ask is None:
        raise InputError("chamber: wanted a person to ask, got none; a chamber by hand needs a terminal")
    return HandChamber(ask, settings)


class ManualRig:
    """A person who is asked, one line at a time."""

    def __init__(self, ask: Callable[[str], str], limits: Limits = Limits(turn_rate=1e3), clock: Clock = HOST) -> None:
        self.limits = limits
        self._ask, self._clock = ask, clock
        self._angle = 0.0
        self._closed = False

    def identify(self) -> str:
        """Return that this is a person."""
        return "a person who turns the device by hand"

    def read_servo(self) -> None:
        """Return None: a person has no servo."""
        return

    def enable(self, on: bool) -> None:
        """Nothing to switch."""
        self._check_open()

    def set_acceleration(self, acceleration: float) -> float:
        """Nothing to set: how a hand runs up is unknown."""
        self._check_open()
        return math.nan

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        """Refuse: no hand keeps a steady rate."""
        self._check_open()
        raise RigFault(
            "manual rig: wanted a steady rate, got a hand; plan turns through known angles (move_by) instead"
        )

    def move_by(self, angle: float) -> float:
        """Have the device turned by an angle."""
        self._check_open()
        self.limits.check_travel(self._angle + angle)
        asked_deg = angle / RADIAN_PER_DEGREE
        line = f"Turn the device by {asked_deg:+g} deg, then type the angle it turned in deg (Enter: exactly that; q gives up): "
        for _ in range(QUESTIONS):
            answer = _said(self._ask, line, "manual rig: wanted the step done", "the person gave up")
            turned_deg = number_of(answer.removesuffix("deg").replace(",", ".")) if answer else asked_deg
            if math.isfinite(turned_deg):
                self._angle += turned_deg * RADIAN_PER_DEGREE
                return turned_deg * RADIAN_PER_DEGREE
        raise InputError("manual rig: wanted an angle in deg, got none in three answers; start again")

    def stop(self) -> None:
        """Nothing moves by itself."""

    def position(self) -> Position:
        """Return the sum of the stated angles, rad, now."""
        self._check_open()
        return Position(angle=self._angle, time=self._clock.now())

    def following_error(self) -> float:
        """Return NaN: nobody knows how far a hand is off."""
        return math.nan

    def fault(self) -> str | None:
        """Return None: a person says so when something is wrong."""
        return None

    def close(self, *, as_found: bool = False) -> None:
        """Ask nothing more; harmless when called again."""
        self._closed = True

    def _check_open(self) -> None:
        if self._closed:
            raise LinkError("manual rig: wanted a rig ready for commands, got none: it is closed; open it again")


def open_from(url: str, settings: RigSettings) -> ManualRig:
    """Make a manual rig."""
    if url:
        raise InputError(f"manual rig: wanted the address 'manual:', got 'manual:{url}'; a person has no port")
    if settings.ask is None:
        raise InputError("manual rig: wanted a way to ask a person, got none; give RigSettings(ask=...)")
    return ManualRig(settings.ask, settings.limits, settings.timing)
