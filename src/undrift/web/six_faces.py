"""Six faces: a guided capture. It is fed the newest readings; it says what to do next, and captures a face that rests long enough.

    moving -> settling -> still, counting down -> captured -> the next face, in any order

A gap in the readings over 0.1 s, a touch or a tilt restarts the countdown; a single reading that was lost does not. A face that
is captured again takes the place of the one before.
"""

from typing import get_args

from undrift.errors import InputError
from undrift.record import FACES, Face, Record
from undrift.web.capture import UNKNOWN, Capture, Light, Rest, State

ORDER: tuple[Face, ...] = ("+z", "+x", "-z", "-x", "+y", "-y")  # each a quarter turn from the one before


class SixFaces:
    """The guide; its state stays until all faces are there."""

    def __init__(self, capture: Capture) -> None:
        self.capture = capture
        self.again: Face | None = None  # that is to be captured once more
        self._asked = (-1, 0.0)  # stretch and time at which a face was asked for again: its countdown begins there
        self.light = Light(state="no readings", text="No readings. Connect a device.")

    @property
    def wanted(self) -> Face | None:
        """The face to turn up next; None when all are captured."""
        return self.again or next((face for face in ORDER if face not in self.capture.faces), None)

    @property
    def complete(self) -> bool:
        """Whether all six are captured."""
        return len(self.capture.faces) == len(FACES)

    def redo(self, face: Face | None) -> None:
        """Ask for a face once more; None takes that back. What was captured stays until it is there."""
        if face is not None and face not in get_args(Face):
            raise InputError(f"redo: wanted one of {', '.join(FACES)}, got '{face}'; name a face")
        self.again, self._asked = face, (self.capture.stretch, self.capture.newest_s)

    def update(self, record: Record | None, now_s: float, key: object = None) -> Light:
        """Take the newest readings and return the light."""
        self.capture.take(record, now_s, key)
        rest = None if self.capture.silent(now_s) else self.capture.rest()
        self.light = self._silent(now_s) or self._judged(rest)
        return self.light

    def _silent(self, now_s: float) -> Light | None:
        if not self.capture.silent(now_s):
            return None
        return Light(state="no readings", text="No readings. Check power and connection of the device.")

    def _judged(self, rest: Rest | None) -> Light:
        settings, wanted = self.capture.settings, self.wanted
        if rest is None:
            return Light(state="moving", text=f"Moving. {_turn(wanted)}")
        face, tilt_deg = self.capture.face_of(rest)
        if face is None:
            return Light(state="unknown face", text=UNKNOWN)
        if tilt_deg:
            return Light(state="tilted", face=face, text=f"Tilted by {tilt_deg:.0f} deg. Lay it flat with {face} up.")
        if face in self.capture.faces and face != self.again:
            if wanted is None:
                return Light(state="captured", face=face, text="All six faces are captured.")
            state: State = "wrong face" if self.again else "captured"
            return Light(state=state, face=face, text=f"{face} is captured. {_turn(wanted)}")
        fresh = self._asked[1] if self.again and self._asked[0] == self.capture.stretch else rest.start_s
        rested_s = rest.stop_s - max(rest.start_s, fresh)
        if rested_s < settings.settle_s:
            return Light(state="settling", face=face, text=f"Settling, {face} up. Do not touch it.")
        left_s = settings.settle_s + settings.countdown_s - rested_s
        if left_s > 0.0:
            return Light(state="still", face=face, text=f"Still, {face} up. Do not touch it.", left_s=left_s)
        self.capture.add_face(face, rest)
        self.again = None if face == self.again else self.again
        return Light(state="captured", face=face, text=f"{face} is captured. {_turn(self.wanted)}")


def _turn(face: Face | None) -> str:
    return "All six faces are captured." if face is None else f"Turn {face} up."
