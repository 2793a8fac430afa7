"""Turns by hand: a guided capture of whole turns about x, y and z, each between two rests. It is fed the newest readings.

    rest, ready -> turning -> rest: the turn is judged -> rest, ready ...

A turn counts where its axis is one of the device's, gravity reads the same before and after, and its angle is near a whole
number of turns. In counts no scale is known: a turn then is one turn, and its length must be like that of the others. Its sign
is that of the reading. The gyroscopes are calibrated by the stated angles, not by what is read here.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from undrift.errors import InputError
from undrift.record import Axis, Face, Record, Still
from undrift.segments import StillSettings, find_still, find_turns
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor
from undrift.web.capture import UNKNOWN, Capture, CapturedTurn, Light, Piece, Rest, State, way_of

WAYS = ("+x", "-x", "+y", "-y", "+z", "-z")  # + is counter-clockwise, seen with the axis up
FULL_TURN = 2.0 * math.pi
NEAR = 0.15  # of a whole turn, relative: an uncalibrated gyroscope reads it within that
LIKE = 0.3  # readings of turns in counts differ by less than this, relative
SAME_POSE = math.cos(15.0 * RADIAN_PER_DEGREE)
REST_S = 3.0  # before a turn and after it
SHARP = StillSettings(
    window_s=0.25, smooth_s=0.05, min_duration_s=0.25, threshold_floors=8.0
)  # how near a rest comes to a turn
LOST_S = 0.5  # of a rest beside a turn, by the usual window
LONGEST_S = 60.0  # of a turn with its rests
GAP = "Gap in the readings: that turn does not count."


@dataclass(frozen=True, slots=True)
class _Before:
    stretch: int
    rest: Rest
    face: Face | None


class Turns:
    """The guide; its state stays until all turns are there."""

    def __init__(self, capture: Capture) -> None:
        self.capture = capture
        self.again: str | None = None  # that is to be made once more
        self.light = Light(state="no readings", text="No readings. Connect a device.")
        self.outcome = ""  # about the last turn
        self._before: _Before | None = None
        self._moved = False

    @property
    def done(self) -> dict[str, CapturedTurn]:
        """What is captured, by its way."""
        return {way_of(turn): turn for turn in self.capture.turns}

    @property
    def wanted(self) -> str | None:
        """The turn to make next: ``+x`` is one about x, counter-clockwise; None when all are captured."""
        return self.again or next((way for way in WAYS if way not in self.done), None)

    @property
    def enough(self) -> bool:
        """Whether each axis has one turn or more."""
        return {way[1] for way in self.done} == {"x", "y", "z"}

    @property
    def complete(self) -> bool:
        """Whether all six turns are captured."""
        return set(self.done) == set(WAYS)

    def redo(self, way: str | None) -> None:
        """Ask for a turn once more; None takes that back. What was captured stays until it is there."""
        if way is not None and way not in WAYS:
            raise InputError(f"redo: wanted one of {', '.join(WAYS)}, got '{way}'; name a turn")
        self.again = way

    def update(self, record: Record | None, now_s: float, key: object = None) -> Light:
        """Take the newest readings and return the light."""
        self.capture.take(record, now_s, key)
        if self.capture.silent(now_s):
            self._before = None
            self.light = Light(state="no readings", text="No readings. Check power and connection of the device.")
        else:
            self.light = self._judged()
        return self.light

    def _judged(self) -> Light:
        before, rest = self._before, self.capture.rest()
        if before is not None and before.stretch != self.capture.stretch:
            before = self._before = None
            self.outcome = GAP
        if rest is None:
            self._moved = before is not None
            return Light(state="moving", text="Turning. Go back to the mark." if before else f"Moving. {self._asked()}")
        if rest.duration_s < REST_S:
            return Light(state="settling", text="Settling. Do not touch it.", left_s=REST_S - rest.duration_s)
        face, tilt_deg = self.capture.face_of(rest)
        if face is None:
            return Light(state="unknown face", text=UNKNOWN)
        if before is not None and self._moved:
            self.outcome = self._take_turn(before, rest)
        self._before, self._moved = _Before(self.capture.stretch, rest, face), False
        state: State = "captured" if self.wanted is None else "tilted" if tilt_deg else "still"
        return Light(state=state, face=face, text=f"{self.outcome} {self._asked(face)}".strip())

    def _asked(self, face: Face | None = None) -> str:
        way = self.wanted
        if way is None:
            return "All turns are captured."
        return f"Turn it once {_seen(way)}." if face == f"+{way[1]}" else f"Lay it with +{way[1]} up."

    def _take_turn(self, before: _Before, after: Rest) -> str:
        """Capture the turn between two rests, and say what became of it."""
        start_s = max(before.rest.start_s, before.rest.stop_s - 2.0 * REST_S)
        if after.stop_s - start_s > LONGEST_S:
            return f"That took longer than {LONGEST_S:g} s."
        record = self.capture.tail(after.stop_s - start_s)
        if record is None:
            return GAP
        stills = find_still(record, StillSettings()).stills
        if len(stills) < 2:
            return "That was no turn."
        first, last = _nearest(record, stills[0], stills[-1])
        time = record.time
        if self.capture.lost(float(time[first.stop]), float(time[last.start])):
            return GAP
        found = find_turns(record, (first, last))
        if not found.rotations:
            return "That was no turn."
        turn, reading = found.rotations[0], found.rotation_angle[0]
        if not self._returned(before, after):
            return ""  # laid on another face
        if turn.axis is None:
            return "That was about no axis of the device. Lay it flat, and turn it on the bench."
        along = float(reading["xyz".index(turn.axis)])
        whole, reason = self._whole(turn.axis, along, record.gyro_unit)
        if not whole:
            return reason
        piece = CapturedTurn(
            stretch=self.capture.stretch,
            start_s=float(time[first.stop]),
            stop_s=float(time[last.start]),
            turn=replace(turn, angle=whole * FULL_TURN),
            before=Piece(
                stretch=self.capture.stretch, start_s=float(time[first.start]), stop_s=float(time[first.stop])
            ),
            after=Piece(stretch=self.capture.stretch, start_s=float(time[last.start]), stop_s=after.stop_s),
            reading=along / whole,
        )
        self.capture.add_turn(piece)
        way = way_of(piece)
        self.again = None if way == self.again else self.again
        return f"Captured: {named(way)}{'' if abs(whole) == 1 else f', {abs(whole)} turns'}."

    def _returned(self, before: _Before, after: Rest) -> bool:
        """Whether gravity reads the same before and after."""
        up, down = self.capture.up(before.rest)[0], self.capture.up(after)[0]
        return up is not None and down is not None and float(up @ down) > SAME_POSE

    def _whole(self, axis: Axis, along: float, unit: str) -> tuple[int, str]:
        """Return how many turns a reading is, 0 with the reason where it is none."""
        if is_physical(unit):
            turns = along * si_factor(unit, "rate") / FULL_TURN
            whole = round(turns)
            if not whole or abs(turns - whole) > NEAR * abs(turns):
                return 0, f"That was {abs(turns) * 360.0:.0f} deg. Turn by 360 deg, back to the mark."
            return whole, ""
        others = [abs(held.reading) for held in self.capture.turns]
        if others and not 1.0 - LIKE < abs(along) / float(np.median(others)) < 1.0 + LIKE:
            return 0, "That was shorter or longer than the other turns. Turn once, back to the mark."
        return (1 if along > 0.0 else -1), ""


def _nearest(record: Record, first: Still, last: Still) -> tuple[Still, Still]:
    """Return two rests that reach as near to the turn between them as short windows show."""
    short, lost = find_still(record, SHARP).stills, round(LOST_S * record.sample_rate_hz)
    stop = max((each.stop for each in short if each.start <= first.stop + lost), default=first.stop)
    start = min((each.start for each in short if each.stop >= last.start - lost), default=last.start)
    if not first.stop <= stop < start <= last.start:
        return first, last
    return replace(first, stop=stop), replace(last, start=start)


def asked(way: str) -> str:
    """Return how to make a turn, in words."""
    return f"Lay it with +{way[1]} up. Turn it once {_seen(way)}, back to the mark."


def _seen(way: str) -> str:
    return "counter-clockwise" if way[0] == "+" else "clockwise"


def named(way: str) -> str:
    """Return what to call a turn."""
    return f"about {way[1]}, {_seen(way)}"
