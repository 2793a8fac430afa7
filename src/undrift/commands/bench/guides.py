"""Guides lead a person through captures by hand, step by step: six faces and whole turns, or arbitrary poses.

A guide receives the newest readings. It shows the next step, judges the motion of the device, and captures a step that
is correct. Steps may be done in any order and repeated. A capture remains until it is replaced. A gap of more than 0.1
s, a touch or a tilt invalidates a step. A single lost reading does not.

    faces: moving -> settling -> still, counting down -> captured -> the next
    turns: rest, ready -> turning -> rest: the turn is judged -> rest, ready ...

A turn is valid if it is about an axis of the device, gravity is the same before and after, and its angle is near a whole number of
turns. If readings are in counts, the scale is unknown. A turn then counts as a single turn, and its integral must be similar to
those of the other turns. Its sign is the sign of the reading. The gyroscopes are calibrated with the nominal angles, not with the
angles read here.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.commands.bench.capture import COUNTDOWN_S, SETTLE_S, UNKNOWN, Capture, CapturedTurn, Light, Rest, State
from undrift.errors import InputError
from undrift.record import FACES, Axis, Face, Record, Still
from undrift.segments import StillSettings, find_still, find_turns
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

ORDER: tuple[Face, ...] = ("+z", "+x", "-z", "-x", "+y", "-y")  # each is a quarter turn from the previous one
WAYS = FACES  # + is counter-clockwise, seen with the axis up
FULL_TURN = 2.0 * math.pi
NEAR = 0.15  # relative tolerance of a whole turn: an uncalibrated gyroscope is more accurate
LIKE = 0.3  # largest relative difference between turns in counts
SAME_POSE = math.cos(15.0 * RADIAN_PER_DEGREE)
REST_S = 3.0  # rest before and after a turn, and in a pose, s
POSES, NEW_POSE = 15, math.cos(25.0 * RADIAN_PER_DEGREE)
SHARP = StillSettings(
    window_s=0.25, smooth_s=0.05, min_duration_s=0.25, threshold_floors=8.0
)  # settings for rests that extend close to a turn
LOST_S = 0.5  # part of a rest next to a turn that is lost with the usual window, s
LONGEST_S = 60.0  # longest turn with its rests, s
GAP = "Gap in the readings: that turn does not count."


class Guide(ABC):
    """A guide for a kind of step. Its state remains until all steps are captured."""

    step: str  # name of a step
    order: tuple[str, ...]

    def __init__(self, capture: Capture, done: Mapping[str, Rest] | Mapping[str, CapturedTurn]) -> None:
        self.capture, self.done = capture, done  # names of all steps, and captured steps
        self.again: str | None = None  # step that is to be captured again
        self.light = Light(state="no readings", text="No readings. Connect a device.")
        self._asked_s = -math.inf  # time at which a step was requested again, at which its countdown begins

    @property
    def wanted(self) -> str | None:
        """Return the next step, or None if all steps are captured."""
        return self.again or next((step for step in self.order if step not in self.done), None)

    @property
    def complete(self) -> bool:
        """Return True if all steps are captured."""
        return len(self.done) == len(self.order)

    def redo(self, step: str | None) -> None:
        """Request a step again, or cancel the request with None. The earlier capture remains until it is replaced."""
        if step is not None and step not in self.order:
            raise InputError(f"redo: expected one of {', '.join(FACES)}, got '{step}'. Select a {self.step}.")
        self.again, self._asked_s = step, self.capture.newest_s

    def update(self, record: Record | None, now_s: float, key: object = None) -> Light:
        """Process the newest readings and return the light."""
        self.capture.take(record, now_s, key)
        if self.capture.silent(now_s):
            self.light = Light(state="no readings", text="No readings. Check power and connection of the device.")
        else:
            self.light = self._judge(self.capture.rest())
        return self.light

    def _captured(self, step: str) -> None:
        self.again = None if step == self.again else self.again

    @abstractmethod
    def _judge(self, rest: Rest | None) -> Light: ...


class SixFaces(Guide):
    """Guide through rests with each face up."""

    step, order = "face", ORDER

    def __init__(self, capture: Capture) -> None:
        super().__init__(capture, capture.faces)

    def _judge(self, rest: Rest | None) -> Light:
        wanted = self.wanted
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
        rested_s = rest.stop_s - max(rest.start_s, self._asked_s)
        if rested_s < SETTLE_S:
            return Light(state="settling", face=face, text=f"Settling, {face} up. Do not touch it.")
        left_s = SETTLE_S + COUNTDOWN_S - rested_s
        if left_s > 0.0:
            return Light(state="still", face=face, text=f"Still, {face} up. Do not touch it.", left_s=left_s)
        self.capture.add_face(face, rest)
        self._captured(face)
        return Light(state="captured", face=face, text=f"{face} is captured. {_turn(self.wanted)}")


def _turn(face: str | None) -> str:
    return "All six faces are captured." if face is None else f"Turn {face} up."


class Poses(Guide):
    """Guide through rests in different arbitrary poses, as many as the accelerometers need."""

    step, order = "pose", tuple(str(k + 1) for k in range(POSES))

    def __init__(self, capture: Capture) -> None:
        self._poses, self._ups = dict[str, Rest](), list[FloatArray]()
        super().__init__(capture, self._poses)

    def _judge(self, rest: Rest | None) -> Light:
        if self.complete:
            return Light(state="captured", text=f"All {POSES} poses are captured.")
        if rest is None:
            return Light(state="moving", text="Moving. Hold it still in another pose, on a support if you can.")
        up, _ = self.capture.up(rest)
        if up is None:
            return Light(state="unknown face", text=UNKNOWN)
        if any(float(up @ earlier) > NEW_POSE for earlier in self._ups):
            return Light(state="captured", text="This pose is captured. Tilt it by 30 deg or more in any direction.")
        if rest.duration_s < REST_S:
            return Light(state="settling", text="Still. Do not touch it.", left_s=REST_S - rest.duration_s)
        self._ups.append(up)
        self._poses[str(len(self._ups))] = rest
        return Light(state="captured", text="Captured. Tilt it by 30 deg or more in any direction.")


class Turns(Guide):
    """Guide through whole turns about each axis in both directions: ``+x`` is counter-clockwise about x."""

    step, order = "turn", WAYS

    def __init__(self, capture: Capture) -> None:
        super().__init__(capture, capture.turns)
        self.outcome = ""  # message about the last turn
        self._before: Rest | None = None  # turn
        self._moved, self._unlike = False, 0.0  # reading of the last turn that differed from the only captured turn

    @property
    def enough(self) -> bool:
        """Return True if each axis has a turn."""
        return {way[1] for way in self.done} == {"x", "y", "z"}

    def _judge(self, rest: Rest | None) -> Light:
        before = self._before
        if before is not None and before.stop_s < self.capture.whole_from_s:
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
        self._before, self._moved = rest, False
        state: State = "captured" if self.wanted is None else "tilted" if tilt_deg else "still"
        return Light(state=state, face=face, text=f"{self.outcome} {self._asked(face)}".strip())

    def _asked(self, face: Face | None = None) -> str:
        way = self.wanted
        if way is None:
            return "All turns are captured."
        return f"Turn it once {_seen(way)}." if face == f"+{way[1]}" else f"Lay it with +{way[1]} up."

    def _take_turn(self, before: Rest, after: Rest) -> str:
        """Capture the turn between two rests, and return a message about the result."""
        start_s = max(before.start_s, before.stop_s - 2.0 * REST_S)
        if after.stop_s - start_s > LONGEST_S:
            return f"That took longer than {LONGEST_S:g} s."
        record = self.capture.tail(after.stop_s - start_s)
        if record is None:
            return GAP
        stills = find_still(record).stills
        if len(stills) < 2:
            return "That was not a turn."
        first, last = _nearest(record, stills[0], stills[-1])
        time = record.time
        if self.capture.lost(float(time[first.stop]), float(time[last.start])):
            return GAP
        turns = find_turns(record, (first, last))
        if not turns.rotations:
            return "That was not a turn."
        turn, reading = turns.rotations[0], turns.rotation_angle[0]
        up, down = self.capture.up(before)[0], self.capture.up(after)[0]
        if up is None or down is None or not float(up @ down) > SAME_POSE:
            return ""  # laid on another face
        if turn.axis is None:
            return "That was not about an axis of the device. Lay it flat, and turn it on the bench."
        along = float(reading["xyz".index(turn.axis)])
        count, reason = self._count_turns(turn.axis, along, record.gyro_unit)
        if not count:
            return reason
        captured = CapturedTurn(
            turn=replace(turn, angle=count * FULL_TURN),
            before=replace(before, start_s=float(time[first.start]), stop_s=float(time[first.stop])),
            after=replace(after, start_s=float(time[last.start])),
            reading=along / count,
        )
        self.capture.add_turn(captured)
        self._captured(captured.way)
        return f"Captured: {named(captured.way)}{'' if abs(count) == 1 else f', {abs(count)} turns'}."

    def _count_turns(self, axis: Axis, along: float, unit: str) -> tuple[int, str]:
        """Return the number of whole turns of a reading, or 0 and the reason."""
        if is_physical(unit):
            turns = along * si_factor(unit, "rate") / FULL_TURN
            count = round(turns)
            if not count or abs(turns - count) > NEAR * abs(turns):
                return 0, f"That was {abs(turns) * 360.0:.0f} deg. Turn by 360 deg, back to the mark."
            return count, ""
        lengths = [abs(captured.reading) for captured in self.capture.turns.values()]
        if len(lengths) == 1 and _like(along, self._unlike) and not _like(along, lengths[0]):
            self.capture.turns.clear()  # two turns agree and contradict the first, which was not a whole turn
        elif lengths and not _like(along, float(np.median(lengths))):
            self._unlike = abs(along)
            return 0, "That was shorter or longer than the other turns. Turn once, back to the mark."
        return (1 if along > 0.0 else -1), ""


def _like(along: float, reading: float) -> bool:
    """Return True if the reading of a turn in counts is similar to that of another turn."""
    return abs(abs(along) - reading) < LIKE * reading


def _nearest(record: Record, first: Still, last: Still) -> tuple[Still, Still]:
    """Return two rests, extended with short windows as close as possible to the turn between them."""
    short, lost = find_still(record, SHARP).stills, round(LOST_S * record.sample_rate_hz)
    stop = max((still.stop for still in short if still.start <= first.stop + lost), default=first.stop)
    start = min((still.start for still in short if still.stop >= last.start - lost), default=last.start)
    if not first.stop <= stop < start <= last.start:
        return first, last
    return replace(first, stop=stop), replace(last, start=start)


def asked(way: str) -> str:
    """Return the instructions for a turn."""
    return f"Lay it with +{way[1]} up. Turn it once {_seen(way)}, back to the mark."


def _seen(way: str) -> str:
    return "counter-clockwise" if way[0] == "+" else "clockwise"


def named(way: str) -> str:
    """Return the name of a turn in instructions."""
    return f"about {way[1]}, {_seen(way)}"
