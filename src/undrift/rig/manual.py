"""A rig that is a person: lays the device on its faces and turns it by hand through known angles.

A whole turn of a turntable back to its mark is 360 deg to a small fraction of a degree, whatever its rate was: the angle is what
calibrates, not the rate. So `move_by` works, and `turn` does not.
"""

import math
from collections.abc import Callable

from undrift.errors import InputError, LinkError, RigFault
from undrift.record import Face
from undrift.rig.link import Clock
from undrift.rig.rig import Limits, Position, RigSettings
from undrift.units import RADIAN_PER_DEGREE

# ---- An operator who mounts the device

GIVING_UP = ("q", "quit", "stop")


class AskedOperator:
    """A person at the table, asked one line at a time."""

    def __init__(self, ask: Callable[[str], str]) -> None:
        self._ask = ask

    def mount(self, up: Face) -> None:
        """Have the device mounted."""
        try:
            answer = self._ask(
                f"Motor off. Mount the device with {up} up, step back, then press Enter (q gives up): "
            ).strip()
        except EOFError:
            answer = "q"
        if answer.lower() in GIVING_UP:
            raise RigFault(
                f"mounting: wanted the device mounted {up} up, got '{answer}'; continue with --resume when it is"
            )


# ---- manual

FACES = ("+x", "-x", "+y", "-y", "+z", "-z")
QUESTIONS = 3  # how often an answer that is no number is asked for again


class ManualRig:
    """A person who is asked, one line at a time."""

    servo = None

    def __init__(
        self, ask: Callable[[str], str], limits: Limits = Limits(turn_rate=1e3), clock: Clock = Clock()
    ) -> None:
        self._ask = ask
        self._limits = limits
        self._clock = clock
        self._angle = 0.0
        self._closed = False

    @property
    def limits(self) -> Limits:
        """Limits of its commands."""
        return self._limits

    def identify(self) -> str:
        """Return that this is a person."""
        return "a person who turns the device by hand"

    def enable(self, on: bool) -> None:
        """Nothing to switch."""
        self._check_open()

    def set_acceleration(self, acceleration: float) -> float:
        """Nothing to set: how a hand runs up is unknown."""
        self._check_open()
        return math.nan

    def turn(self, turn_rate: float) -> float:
        """Refuse: a hand holds no rate; 0 is rest and allowed."""
        self._check_open()
        if turn_rate != 0.0:
            raise RigFault(
                "manual rig: wanted a steady rate, got a hand; plan turns through known angles (move_by) instead"
            )
        return 0.0

    def place(self, face: str) -> None:
        """Have the device laid still on a face."""
        self._check_open()
        if face not in FACES:
            raise InputError(
                f"manual rig: wanted a face out of {', '.join(FACES)}, got '{face}'; name the axis that points up"
            )
        self._said(f"Lay the device still with its {face} axis up, let go, then press Enter (q gives up): ")

    def move_by(self, angle: float) -> float:
        """Have the device turned by an angle."""
        self._check_open()
        self._limits.check_travel(self._angle + angle)
        asked_deg = angle / RADIAN_PER_DEGREE
        line = f"Turn the device by {asked_deg:+g} deg, then type the angle it turned in deg (Enter: exactly that; q gives up): "
        for _ in range(QUESTIONS):
            turned_deg = _number(self._said(line), asked_deg)
            if turned_deg is not None:
                self._angle += turned_deg * RADIAN_PER_DEGREE
                return turned_deg * RADIAN_PER_DEGREE
        raise InputError("manual rig: wanted an angle in deg, got none in three answers; start again")

    def stop(self) -> None:
        """Nothing moves by itself."""

    def position(self) -> Position:
        """Return the sum of the stated angles, rad, now."""
        self._check_open()
        return Position(angle=self._angle, time=self._clock.now())

    def measured_turn_rate(self, duration_s: float) -> float:
        """Return the mean rate over a while, from two positions: 0, as nothing moves between questions."""
        return self._clock.mean_turn_rate(self.position, duration_s)

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

    def _said(self, line: str) -> str:
        try:
            answer = self._ask(line).strip()
        except EOFError:
            answer = "q"
        if answer.lower() in GIVING_UP:
            raise RigFault(f"manual rig: wanted the step done, got '{answer}'; the person gave up")
        return answer


def _number(answer: str, asked: float) -> float | None:
    """Return the angle that was typed, the one asked for when none was, None when it is no number."""
    if not answer:
        return asked
    try:
        number = float(answer.removesuffix("deg").replace(",", "."))
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def open_from(url: str, settings: RigSettings) -> ManualRig:
    """Make a manual rig."""
    if url:
        raise InputError(f"manual rig: wanted the address 'manual:', got 'manual:{url}'; a person has no port")
    if settings.ask is None:
        raise InputError("manual rig: wanted a way to ask a person, got none; give RigSettings(ask=...)")
    return ManualRig(settings.ask, settings.limits, Clock(speed=settings.clock_speed))
