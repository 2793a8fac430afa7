"""GRBL 1.1, grblHAL, FluidNC: a stepper-driven rotary axis, jogged by finite moves.

`$J=G91A<deg>F<deg/min>` turns by an angle and can be cancelled at any time. A steady rate is a chain of such jogs, each a whole
number of steps (`$100` and its neighbours, steps per degree), a second or so of them queued: if this program dies, the table stops
by itself when the queue is empty. There is no encoder, so what was commanded counts as achieved, and there is no following error.
"""

import math

from undrift.errors import LimitError, LinkError, RigFault
from undrift.rig.address import RigSettings
from undrift.rig.clock import Clock
from undrift.rig.grbl.controller import UNCONFIRMED
from undrift.rig.grbl.feeder import Segment
from undrift.rig.grbl.reports import GrblReports, GrblSettings
from undrift.rig.grbl.stored import store_acceleration
from undrift.rig.grbl.words import reply_end
from undrift.rig.link import Link, LinkSettings
from undrift.units import RADIAN_PER_DEGREE

SLOWEST_DEG_PER_MIN = 1.0  # GRBL raises anything slower to this


class GrblRig(GrblReports):
    """A rate table behind GRBL; opening resets the controller, which ends any motion.

    Parameters
    ----------
    link : Link
        Open, as `open_from` makes it; the rig closes it.
    settings : GrblSettings
        Limits and axis.

    Raises
    ------
    RigTimeout
        Nobody answers.
    LinkError
        What answers is no GRBL, or lists no steps per degree.
    """

    def enable(self, on: bool) -> None:
        """Wake the motor up, or stop and put it to sleep (``$SLP``).

        Parameters
        ----------
        on : bool
            True for on.

        Raises
        ------
        RigFault
            An alarm that a person must look at.
        """
        with self._guarded():
            self._axis.stop()
            if not on:
                self._axis.grbl.do("$SLP")
                self._axis.grbl.wait_for(("Sleep",), 0.0)
            else:
                if self._axis.grbl.status().state == "Sleep":
                    self._axis.wake_up()
                self._axis.grbl.wait_for(("Idle",), 0.0)
            self._axis.enabled = on

    def set_acceleration(self, acceleration: float) -> float:
        """Set run-up and slow-down (``$120`` and its neighbours), which the controller stores.

        Parameters
        ----------
        acceleration : float
            rad/s2.

        Returns
        -------
        float
            As the controller lists it, rad/s2.

        Raises
        ------
        LimitError
            Beyond the rig's limits.
        LinkError
            It lists something else.
        """
        self.limits.check_acceleration(acceleration)
        with self._guarded():
            self._axis.stop()
            held = store_acceleration(self._axis.grbl, self._settings.axis, round(acceleration / RADIAN_PER_DEGREE, 3))
            self._axis.acceleration_dps2 = held
        return held * RADIAN_PER_DEGREE

    def turn(self, turn_rate: float) -> float:
        """Turn at a steady rate until told otherwise, by chained jogs.

        Parameters
        ----------
        turn_rate : float
            rad/s, signed; 0 stops.

        Returns
        -------
        float
            As it is commanded, in thousandths of a degree per minute, rad/s.

        Raises
        ------
        LimitError
            Beyond the rig's limits or the controller's.
        """
        self.limits.check_turn_rate(turn_rate)
        deg_per_min = round(60.0 * turn_rate / RADIAN_PER_DEGREE, 3)
        fastest_dps = self._axis.fastest_dps
        if turn_rate != 0.0 and not SLOWEST_DEG_PER_MIN <= abs(deg_per_min) <= 60.0 * fastest_dps:
            raise LimitError(
                f"turn rate: wanted {SLOWEST_DEG_PER_MIN / 60:.4f} to {fastest_dps:g} deg/s, "
                f"got {abs(deg_per_min) / 60:.4f}; choose another",
                turn_rate=turn_rate,
            )
        with self._guarded():
            self._axis.stop()
            if deg_per_min != 0.0:
                self._axis.check_awake()
                self._axis.start_turning(deg_per_min, self._room_deg(deg_per_min))
        return deg_per_min / 60.0 * RADIAN_PER_DEGREE

    def move_by(self, angle: float) -> float:
        """Turn by an angle and wait until the axis is at rest.

        Parameters
        ----------
        angle : float
            rad, signed.

        Returns
        -------
        float
            A whole number of steps, rad.

        Raises
        ------
        LimitError
            Less than a step, or beyond the travel.
        RigFault
            The axis stopped short.
        """
        axis = self._axis
        if not math.isfinite(angle) or abs(angle) / RADIAN_PER_DEGREE * axis.steps_per_deg < 0.5:
            raise LimitError(f"angle: wanted a step at least, got {angle:g} rad; choose a larger one", angle=angle)
        self.limits.check_travel((axis.place_deg - axis.home_deg) * RADIAN_PER_DEGREE + angle)
        distance = round(angle / RADIAN_PER_DEGREE * axis.steps_per_deg) / axis.steps_per_deg
        rate = min(self._settings.move_turn_rate, self.limits.turn_rate, axis.fastest_dps * RADIAN_PER_DEGREE)
        rate_dps = round(60.0 * rate / RADIAN_PER_DEGREE, 3) / 60.0
        with self._guarded():
            axis.stop()
            axis.check_awake()
            before = axis.place_deg
            axis.jog(Segment(distance_deg=distance, deg_per_min=60.0 * rate_dps))
            axis.grbl.wait_for(("Idle",), abs(distance) / rate_dps + 2.0 * rate_dps / axis.acceleration_dps2)
            went = axis.read_place() - before
            if abs(went - distance) > 1.0 / axis.steps_per_deg + 2e-3:
                raise RigFault(
                    f"{axis.name}: wanted a move by {distance:g} deg, got {went:g}; look at the table", moved_deg=went
                )
        return distance * RADIAN_PER_DEGREE

    def stop(self) -> None:
        """Slow down (jog cancel) and wait until the axis is at rest; the motor stays on."""
        with self._guarded():
            self._axis.stop()

    def close(self) -> None:
        """Stop, put the motor to sleep, let go of the link; harmless when called again.

        Raises
        ------
        LinkError
            The controller did not confirm it; raised once, after the link was let go.
        """
        if self._closed:
            return
        self._closed = True
        try:
            confirmed = self._axis.make_safe()
        finally:
            self._axis.grbl.link.close()
        if not confirmed:
            raise LinkError(f"{self._axis.name}: wanted the motor off at the end, got no answer; {UNCONFIRMED}")

    def _room_deg(self, deg_per_min: float) -> float:
        """Return how far the travel lets it turn, deg."""
        if self.limits.travel is None:
            return math.inf
        gone = math.copysign(1.0, deg_per_min) * (self._axis.place_deg - self._axis.home_deg)
        return max(self.limits.travel / RADIAN_PER_DEGREE - gone, 0.0)


def open_from(url: str, settings: RigSettings) -> GrblRig:
    """Open a GRBL rig.

    Parameters
    ----------
    url : str
        As Link takes it.
    settings : RigSettings
        Limits, axis, link.

    Returns
    -------
    GrblRig
        Connected.
    """
    link = Link(
        url,
        LinkSettings(
            reply_end=reply_end,
            reply_timeout_s=settings.reply_timeout_s,
            baud=settings.baud or 115200,
            hardware_handshake=settings.hardware_handshake,
        ),
    )
    own = GrblSettings(limits=settings.limits, axis=settings.axis or "A", clock=Clock(speed=settings.clock_speed))
    return GrblRig(link, own)
