"""Step rising: the body is lifted onto a step, or up stairs; by one device at the low back.

The upward velocity v is the integral of the upward acceleration, less the line between stances: zero where the person stands, which
is 0.5 s in which that acceleration is below 0.2 m/s2 rms. A slow error does not sum up, and a long flight of stairs keeps its rise.
A rise is a lobe of v from a stance to the next, or between the least velocities before and after it::

    start, end   where v falls below a tenth of the lobe's peak, backward and forward, or is least between two lobes       [1]_
    duration     from start to end: the body's lift, not the way of a foot                                                 [2]_
    height       integral of v, 0.08 to 0.27 m: who rises from a seat or a squat is lifted higher
    peak pitch   greatest forward pitch from 0.5 s before the start, or the rise before, to the end: the trunk leans before it lifts
    range        of pitch and of roll, in the same time

Where v falls below minus half the peak next to a lobe the body sinks as it rises: that is walking, or a squat. The
trunk leans by 25 deg at most.

.. [1] The rule of a tenth of the peak, as for the trunk in rising.py.
.. [2] B. J. McFadyen, D. A. Winter, "An integrated biomechanical analysis of normal stair ascent and descent", J. Biomechanics 21,
   733-744, 1988: the pull-up from one step to the next.
"""

from itertools import pairwise

import numpy as np

from undrift.arrays import FloatArray, runs
from undrift.measures.rising import EDGE, REACH_S, crossing, summit
from undrift.measures.tasks import Event, TaskResult, not_shown
from undrift.measures.worn import Course
from undrift.units import RADIAN_PER_DEGREE

HEIGHT = (0.08, 0.27)  # m, of the body: half of a usual step, above which walking rises by 0.05; a high step [assumed]
LEAST_VELOCITY = 0.1  # m/s, of a lobe's peak above what is about it: a slow rise has 0.13
MOST_FALL = 0.5  # of the peak
MOST_RANGE = 25.0 * RADIAN_PER_DEGREE  # of pitch: who rises from a low seat leans further [assumed]
STANCE_S, STANCE = 0.5, 0.2  # s; m/s2 rms, twice that of stance on foam, eyes closed


def zeroed_velocity(course: Course) -> tuple[FloatArray, int, int]:
    """Return upward velocity (N,), m/s, zero in every stance, and the first and last sample of one; 0, 0 if there is none."""
    width = round(STANCE_S / course.step)
    power = np.convolve(course.up**2, np.full(width, 1.0 / width), mode="valid")
    stands = np.zeros(len(course.up), dtype=bool)
    for a, b in runs(power < STANCE**2).tolist():
        stands[a + width // 4 : b + width - 1 - width // 4] = True  # the edges of a window may move
    fall = np.concatenate(([0.0], np.cumsum(0.5 * (course.up[1:] + course.up[:-1])))) * course.step
    where = np.flatnonzero(stands)
    if len(where) == 0:
        return fall, 0, 0
    return fall - np.interp(np.arange(len(fall)), where, fall[where]), int(where[0]), int(where[-1])


def lifts(course: Course) -> tuple[list[tuple[float, float, float, float]], str]:
    """Return start and end, in samples, greatest upward velocity, m/s, and height, m, of each rise; and what else was seen."""
    from scipy.signal import find_peaks

    v, begun, ended = zeroed_velocity(course)
    seen, other = list[tuple[float, float, float, float]](), "none" if ended else "no stance of 0.5 s"
    tops = [k for k in find_peaks(v, prominence=LEAST_VELOCITY)[0].tolist() if v[k] > LEAST_VELOCITY]
    least = [a + int(np.argmin(v[a:b])) for a, b in pairwise(tops)]
    for k, first, last in zip(tops, [begun, *least], [*least, ended][: len(tops)], strict=False):
        if not begun < k < ended:
            other = f"one without a stance of {STANCE_S:g} s before and after"
            continue
        low, high = (crossing(v, k, EDGE * v[k], way) for way in (-1, 1))
        start, stop = max(float(first), low or 0.0), min(float(last), float(last) if high is None else high)
        reach = round(REACH_S / course.step)
        around = slice(max(first, round(start) - reach), min(last, round(stop) + reach))
        lean = float(np.ptp(course.pitch[around]))
        height = course.step * float(v[round(start) : round(stop) + 1].sum())
        if v[around].min() < -MOST_FALL * v[k]:
            other = "ups and downs alike, as in walking"
        elif height > HEIGHT[1]:
            other = f"a rise of {height:.2f} m, as from a seat"
        elif lean > MOST_RANGE:
            other = f"one in which the trunk leans by {lean / RADIAN_PER_DEGREE:.0f} deg"
        elif height >= HEIGHT[0]:
            seen.append((start, stop, summit(v, k)[1], height))
    return seen, other


def step(course: Course) -> TaskResult:
    """Measure every rise of a step."""
    rows, before, (seen, other) = list[tuple[float, ...]](), 0, lifts(course)
    if not seen:
        raise not_shown(
            "step", "a rise of {:g} to {:g} m".format(*HEIGHT), other,
            "record from standing to standing a step higher, or name the task that was done",
        )  # fmt: skip
    for start, stop, fastest, height in seen:
        inside = slice(max(before, round(start) - round(REACH_S / course.step)), round(stop) + 1)
        pitch, roll = course.pitch[inside], course.roll[inside]
        angles = (float(one) for one in (pitch.max(), np.ptp(pitch), np.ptp(roll)))
        rows.append((start * course.step, stop * course.step, fastest, height, *angles))
        before = inside.stop
    begun, ended, velocity, heights, peak, span, side = np.array(rows).T
    values = {
        "rise_duration_s": ended - begun, "peak_trunk_pitch_deg": peak / RADIAN_PER_DEGREE,
        "trunk_pitch_range_deg": span / RADIAN_PER_DEGREE, "trunk_roll_range_deg": side / RADIAN_PER_DEGREE,
        "peak_upward_velocity_m_s": velocity, "rise_height_m": heights,
    }  # fmt: skip
    spans = zip(begun.tolist(), (ended - begun).tolist(), strict=True)
    return TaskResult(values=values, events=tuple(Event(*one, "rise") for one in spans))
