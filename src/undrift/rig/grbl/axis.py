"""One axis of a GRBL controller in degrees: its settings, where it is, jogs, and bringing it to rest.

Waking up is a reset; an alarm that a reset in our own motion or our own sleep leaves behind is cleared with ``$X``, any other alarm
stays for a person to look at.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager

from undrift.errors import LinkError, RigFault, RigTimeout
from undrift.rig.clock import Clock
from undrift.rig.grbl.controller import JOG_CANCEL, UNCONFIRMED, GrblController
from undrift.rig.grbl.feeder import Feeder, Segment
from undrift.rig.grbl.stored import ACCELERATION, AXES, RATE, STEPS, stored
from undrift.rig.grbl.words import status_end
from undrift.rig.link import Link

OWN_STOPS = ("Sleep", "Jog", "Run", "Hold")
SLACK_DEG = 1.0  # of a position: the driver's clock and the board's are not quite the same
QUEUED_JOGS = 8  # of the 15 that a small board can hold


class GrblAxis:
    """What the axis does, in degrees.

    Parameters
    ----------
    link : Link
        Open, with line feeds and GRBL's ends of replies.
    axis : str
        X, Y, Z, A, B or C.
    clock : Clock
        Hardware's or an emulator's.

    Raises
    ------
    RigTimeout
        Nobody answers.
    LinkError
        What answers is no GRBL, or lists no steps per degree.
    """

    def __init__(self, link: Link, axis: str, clock: Clock) -> None:
        self.grbl = GrblController(link, clock)
        self.clock = clock
        self.enabled = False
        self.feeder: Feeder | None = None
        self._axis = axis
        self._last: tuple[float, float] | None = None  # deg, and when it was asked for, s
        self.greeting = self.wake_up()
        _, self.steps_per_deg = stored(self.grbl, STEPS, axis)
        _, fastest_deg_per_min = stored(self.grbl, RATE, axis)
        self.fastest_dps = fastest_deg_per_min / 60.0
        self._reach_dps = 1.5 * self.fastest_dps
        _, self.acceleration_dps2 = stored(self.grbl, ACCELERATION, axis)
        self.place_deg = self.home_deg = self.read_place()

    @property
    def name(self) -> str:
        """Where it is connected."""
        return self.grbl.name

    def wake_up(self) -> str:
        """Reset, and clear an alarm of our own making.

        Returns
        -------
        str
            The firmware's greeting.
        """
        link = self.grbl.link
        self._last = None
        try:
            said = link.resynchronise("?", status_end, terminator="")
        except RigTimeout:  # a board that a serial port's opening restarted
            said = ""
        greeting = self.grbl.reset(max(link.settings.reply_timeout_s, 3.0))
        if self.grbl.status().state == "Alarm" and any(f"<{state}" in said for state in OWN_STOPS):
            self.grbl.do("$X")
        return greeting

    def read_place(self) -> float:
        """Return the machine position.

        Returns
        -------
        float
            deg.

        Raises
        ------
        LinkError
            The status has none for this axis, or one that no axis can have reached since the last.
        """
        asked = self.clock.now()
        machine = self.grbl.status().machine
        if machine is None:
            raise LinkError(f"{self.name}: wanted machine positions, got work positions; set $10 to 1")
        index = AXES.index(self._axis) if len(machine) > 1 else 0
        if index >= len(machine):
            raise LinkError(
                f"{self.name}: wanted a position of axis {self._axis}, got {len(machine)}; name another axis"
            )
        self._check_reach(machine[index], asked)
        self.place_deg = machine[index]
        return self.place_deg

    def _check_reach(self, place_deg: float, asked: float) -> None:
        if self._last is not None:
            last_deg, then = self._last
            reach_deg = self._reach_dps * (self.clock.now() - then) + SLACK_DEG
            if abs(place_deg - last_deg) > reach_deg:
                raise LinkError(
                    f"{self.name}: wanted a position within {reach_deg:.1f} deg of {last_deg:g}, got {place_deg:g}; "
                    "the controller was restarted, the answer is garbled, or an emulator runs faster than clock_speed says",
                    place_deg=place_deg,
                )
        self._last = (place_deg, asked)

    def jog(self, segment: Segment) -> None:
        """Queue a jog.

        Parameters
        ----------
        segment : Segment
            How far and how fast.
        """
        self.grbl.do(f"$J=G91G21{self._axis}{segment.distance_deg:.5f}F{segment.deg_per_min:.3f}")

    def start_turning(self, deg_per_min: float, room_deg: float) -> None:
        """Start a chain of jogs.

        Parameters
        ----------
        deg_per_min : float
            Signed.
        room_deg : float
            How far it may go; infinity for ever.
        """
        rate_dps = abs(deg_per_min) / 60.0
        ahead_s = max(1.0, 2.0 * rate_dps / self.acceleration_dps2)
        steps = max(1, round(rate_dps * ahead_s / QUEUED_JOGS * self.steps_per_deg))
        distance_deg = steps / self.steps_per_deg
        room = None if math.isinf(room_deg) else int(room_deg / distance_deg)
        segment = Segment(distance_deg=math.copysign(distance_deg, deg_per_min), deg_per_min=abs(deg_per_min))
        self.feeder = Feeder(self.jog, segment, self.clock, QUEUED_JOGS, room)

    def stop(self) -> None:
        """End the chain and the jog, and wait for rest; the motor stays on.

        Raises
        ------
        RigError
            What the chain failed with.
        """
        failure = self.end_feeding()
        if isinstance(failure, LinkError | RigTimeout):
            raise failure
        if self.grbl.status().state in ("Jog", "Run", "Hold"):
            self.grbl.link.send(JOG_CANCEL)
            self.grbl.wait_for(("Idle",), self.fastest_dps / self.acceleration_dps2)
        self.read_place()
        if failure is not None:
            raise failure

    def check_awake(self) -> None:
        """Refuse to jog when the motor is off or an alarm stands.

        Raises
        ------
        RigFault
            Which of them.
        """
        status = self.grbl.status()
        if status.state != "Idle":
            got = self.grbl.alarm_text(status) if status.state in ("Alarm", "Door") else status.state
            raise RigFault(f"{self.name}: wanted an idle controller, got {got}; enable the rig, look at the table")

    def end_feeding(self) -> Exception | None:
        """End the chain of jogs.

        Returns
        -------
        Exception or None
            What it failed with.
        """
        feeder, self.feeder = self.feeder, None
        if feeder is None:
            return None
        feeder.end()
        return feeder.failure

    @contextmanager
    def guarded(self) -> Iterator[None]:
        """Stop and put the motor to sleep before the failure of a link is reported.

        Yields
        ------
        None
            Once.

        Raises
        ------
        RigTimeout or LinkError
            As it was raised within - or by the chain of jogs, if that came first - with what became of the table.
        """
        try:
            yield
        except (LinkError, RigTimeout) as error:
            first = self.grbl.broken or error
            outcome = "the table was stopped and its motor put to sleep" if self.make_safe() else UNCONFIRMED
            self.grbl.broken = None
            raise type(first)(f"{first}; {outcome}", **first.numbers) from error

    def make_safe(self) -> bool:
        """End the chain, stop, put the motor to sleep.

        Returns
        -------
        bool
            Whether the controller confirmed it.
        """
        self.enabled = False
        self.end_feeding()
        return self.grbl.make_safe()
