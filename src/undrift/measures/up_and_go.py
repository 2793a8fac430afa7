"""Timed up and go: out of a chair, three metres ahead, a turn, back, a turn, down again; by one device at the low back.

The parts are those of the instrumented test [1]_ [2]_: the rise and the sitting down of rising.py, and between them two turns::

    turn              heading, the integral of the rate about the vertical, changes by 90 deg or more where the mean rate over 1 s
                      is above 15 deg/s [3]_; it begins and ends at 5 and 95 % of that change
    peak velocity     of the rate about the vertical, low-pass 1.5 Hz [3]_: steps swing the pelvis at 1 Hz by up to 30 deg/s
    sit-to-stand      from the first motion of the trunk to upright         walk out    from there to the first turn
    walk back         from the first turn to the second                     turn-to-sit from the second turn to the last motion
    duration          from the first motion of the trunk to the last: a stopwatch begins at the word [4]_

.. [1] A. Weiss et al., "Can an accelerometer enhance the utility of the Timed Up & Go Test when evaluating patients with
   Parkinson's disease?", Medical Engineering & Physics 32, 119-125, 2010.
.. [2] A. Salarian et al., "iTUG, a sensitive and reliable measure of mobility", IEEE Trans. Neural Systems and Rehabilitation
   Engineering 18, 303-310, 2010.
.. [3] M. El-Gohary et al., "Continuous monitoring of turning in patients with movement disability", Sensors 14, 356-369, 2014.
.. [4] D. Podsiadlo, S. Richardson, "The timed Up & Go", J. American Geriatrics Society 39, 142-148, 1991.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import runs
from undrift.measures.rising import Transfer, rise_events, rise_values, rises_and_sittings
from undrift.measures.tasks import Event, TaskResult, not_shown
from undrift.measures.walking import contacts
from undrift.measures.worn import Course, smooth
from undrift.units import RADIAN_PER_DEGREE

LEAST_TURN, TURNS = 90.0 * RADIAN_PER_DEGREE, 15.0 * RADIAN_PER_DEGREE  # rad; rad/s
MEAN_S, PEAK_HZ = 1.0, 1.5
EDGES = (0.05, 0.95)  # of the change of heading
LEAST_STEPS = 3  # on each way


@dataclass(frozen=True, slots=True)
class Turning:
    """A turn about the vertical."""

    start: float  # s
    stop: float  # s
    angle: float  # rad, to either side
    fastest: float  # rad/s


def turns(course: Course) -> list[Turning]:
    """Return the turns of 90 deg or more."""
    width, seen = round(MEAN_S / course.step), list[Turning]()
    slow = np.convolve(course.turning, np.full(width, 1.0 / width), mode="same")
    rate, heading = smooth(course.turning, PEAK_HZ, 1.0 / course.step), np.cumsum(course.turning) * course.step
    for side in (1.0, -1.0):
        for a, b in runs(side * slow > TURNS).tolist():
            share = side * (heading[a:b] - heading[a])
            if share[-1] < LEAST_TURN:
                continue
            places = (
                a + float(np.interp(edge * share[-1], np.maximum.accumulate(share), np.arange(b - a))) for edge in EDGES
            )
            start, stop = (place * course.step for place in places)
            fastest = float((side * rate[a:b]).max())
            seen.append(Turning(start, stop, float(share[-1]), fastest))
    return sorted(seen, key=lambda one: one.start)


def up_and_go(course: Course) -> TaskResult:
    """Measure every time that a person gets up, goes, turns, comes back and sits down."""
    rises, sittings = rises_and_sittings(course, "tug")
    _, bouts = contacts(course.up, course.step)
    steps, about = np.concatenate([np.zeros(0), *bouts]), turns(course)
    rows, events, other = list[dict[str, float]](), list[Event](), ""
    for rise in rises:
        down = next((one for one in sittings if one.start > rise.stop), None)
        between = [one for one in about if down and rise.fastest < one.start < down.stop]
        if down is None:
            other = other or "a rise and no sitting down"
            continue
        if len(between) != 2:
            other = other or f"turns between rise and sitting down: {len(between)}, where two are wanted"
            continue
        first, second = between
        ways = (rise.stop, first.start), (first.stop, second.start)
        if any(((steps > a) & (steps < b)).sum() < LEAST_STEPS for a, b in ways):
            other = other or f"fewer than {LEAST_STEPS} steps between the turns"
            continue
        rows.append(_values(course, rise, down, first, second))
        events += [Event(rise.start, down.stop - rise.start, "tug"), *rise_events(course, rise)]
        events += [Event(a, b - a, "walking") for a, b in ways]
        events += [Event(one.start, one.stop - one.start, "turn") for one in (first, second)]
        events += [Event(down.start, down.duration, "stand-to-sit")]
    if not rows:
        wanted = (
            f"a rise, steps, a turn of {LEAST_TURN / RADIAN_PER_DEGREE:g} deg or more, steps, a turn and sitting down"
        )
        raise not_shown("tug", wanted, other, "record the whole test, from sitting to sitting")
    values = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return TaskResult(values=values, events=tuple(sorted(events, key=lambda one: (one.onset, -one.duration))))


def _values(course: Course, rise: Transfer, down: Transfer, first: Turning, second: Turning) -> dict[str, float]:
    """Return the measures of one test."""
    trunk = rise_values(course, rise)
    return {
        "tug_duration_s": down.stop - rise.start, "sit_to_stand_duration_s": rise.duration,
        "walk_out_duration_s": first.start - rise.stop, "turn_duration_s": first.stop - first.start,
        "walk_back_duration_s": second.start - first.stop, "turn_to_sit_duration_s": down.stop - second.start,
        "stand_to_sit_duration_s": down.duration,
        "turn_angle_deg": first.angle / RADIAN_PER_DEGREE, "peak_turn_velocity_dps": first.fastest / RADIAN_PER_DEGREE,
        "second_turn_angle_deg": second.angle / RADIAN_PER_DEGREE,
        "second_peak_turn_velocity_dps": second.fastest / RADIAN_PER_DEGREE,
        **{name: trunk[name] for name in ("peak_trunk_pitch_deg", "trunk_flexion_deg", "peak_flexion_velocity_dps")},
    }  # fmt: skip
