"""A driver of a table on a scripted controller, on a virtual clock: what it sends is heard, and answers can be spoilt."""

import contextlib

from testkit.cards import Board, Card
from testkit.scripted_server import Scripted
from testkit.virtual_clock import VirtualClock
from undrift.errors import LinkError
from undrift.rig.galil import GalilRig
from undrift.rig.grbl import GrblRig
from undrift.rig.rig import RigSettings

KINDS = {  # controller, rig, and how the lines end
    "galil": (Card, GalilRig, {}),
    "grbl": (Board, GrblRig, {"terminator": b"\n", "at_once": "?!~\x18\x85"}),
}


class DriverBench:
    """A rig on a scripted controller, as a context manager."""

    def __init__(self, kind, controller=None, *, reply_timeout_s=20.0, **settings):
        made, rig, line = KINDS[kind]
        self.kind, self.controller, self.clock = kind, controller or made(), VirtualClock()
        self.server = Scripted(self.controller, self.clock, **line)
        self.rig = rig(self.server.url, RigSettings(clock=self.clock, reply_timeout_s=reply_timeout_s, **settings))
        self.opening = [*self.server.heard]
        self.server.heard.clear()

    def __enter__(self):
        return self

    def __exit__(self, *failure):
        with contextlib.suppress(LinkError):
            self.rig.close()

    def at_rest(self):
        """Return whether the controller has no move, and its motor is off."""
        if self.kind == "galil":
            return (self.controller.held["MO"], self.controller.moving) == ("1", 0)
        return self.controller.state == "Sleep"
