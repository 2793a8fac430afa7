"""Sit-to-stand: the trunk flexes, the seat is left, the trunk extends; by one device at the lower back.

A rise is a lobe of upward velocity with a way of 0.15 m or more between two changes of its sign, and before its peak the trunk
leans forward and comes back [1]_, [2]_::

    start      where the flexion rate last was below a tenth of its peak      (the same of the extension rate: end)
    peak       greatest forward pitch: flexion ends and extension begins [1]_
    seat-off   greatest upward acceleration between start and greatest upward velocity: the ground then bears the greatest force,
               which comes as the seat is left [3]_
    sitting    a lobe of downward velocity alike: the trunk leans forward, the body sinks, the trunk comes up

By one device at a thigh, which turns from lying on the seat to upright as the seat is left [5]_::

    rise       a stretch in which the thigh turns forward by 45 deg or more and is then within 35 deg of upright
    start, end where its rate is a tenth of its peak
    seat-off   its end at the hip, as cos(pitch), has come 5 % of its way up
    sitting    the same backward

Five times sit-to-stand lasts from the first start to the fifth time upright [4]_; by a thigh, from the thigh's first motion.

.. [1] R. C. van Lummel et al., "Automated approach for quantifying the repeated sit-to-stand using one body fixed sensor in young
   and older adults", Gait & Posture 38, 153-156, 2013: phases by pitch and vertical velocity.
.. [2] L. Adamowicz et al., "Assessment of sit-to-stand transfers during daily life using an accelerometer on the lower back",
   Sensors 20, 6618, 2020.
.. [3] B. Etnyre, D. Q. Thomas, "Event standardization of sit-to-stand movements", Physical Therapy 87, 1651-1666, 2007.
.. [4] J. M. Guralnik et al., "A short physical performance battery assessing lower extremity function", J. Gerontology 49,
   M85-M94, 1994.
.. [5] "Assessment of thigh angular velocity by an activity monitor to describe sit-to-stand performance", Sensors 22, 1405, 2022.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray, runs
from undrift.measures.tasks import Event, TaskResult, not_shown
from undrift.measures.worn import Course
from undrift.units import RADIAN_PER_DEGREE

LEAST_WAY = 0.15  # m of a rise from a seat: half of what the pelvis of a short person rises from a high one [assumed]
REACH_S = 0.5  # by which the greatest pitch may come before the body rises, or after it sank
LEAST_LEAN = 5.0 * RADIAN_PER_DEGREE  # of flexion and of extension
EDGE = 0.1  # of the peak rate: where a movement begins and ends
LONGEST_S = 4.0  # of flexion, and of extension
# Of a thigh: from a high seat it turns by 60 deg [assumed]
LEAST_TURN, UPRIGHT = 45.0 * RADIAN_PER_DEGREE, 35.0 * RADIAN_PER_DEGREE
OFF = 0.05  # of the hip's way: the seat is left


@dataclass(frozen=True, slots=True)
class Transfer:
    """A change of posture, from the first to the last motion of the trunk."""

    start: float  # s
    peak: float  # greatest pitch, s
    stop: float  # s
    fastest: float  # greatest vertical velocity, s
    way: float  # vertical, of the lobe of velocity, m; above 0 upward
    lean: float  # greatest pitch, rad

    @property
    def duration(self) -> float:
        """Time from start to end, s."""
        return self.stop - self.start


def transfers(course: Course, sign: float, least: float = LEAST_WAY) -> list[Transfer]:
    """Return the rises (sign 1) from a seat, or the times that a person sits down (-1)."""
    velocity, step, reach, seen = sign * course.velocity, course.step, round(REACH_S / course.step), []
    for a, b in runs(velocity > 0.0).tolist():
        way, fastest = step * float(velocity[a:b].sum()), a + int(np.argmax(velocity[a:b]))
        peak = _highest(course.pitch, a - reach, b) if sign > 0.0 else _highest(course.pitch, a, b + reach)
        if way < least or peak is None:
            continue
        one = _transfer(course, peak, fastest, sign * way)
        if one is not None and one.start < one.fastest < one.stop:
            seen.append(one)
    return seen


def _highest(x: FloatArray, first: int, last: int) -> int | None:
    """Return the highest local maximum from a sample to before another."""
    inner = np.arange(max(first, 2), min(last, len(x) - 2))
    tops = inner[(x[inner] > x[inner - 1]) & (x[inner] >= x[inner + 1])]
    return int(tops[np.argmax(x[tops])]) if len(tops) else None


def _transfer(course: Course, peak: int, fastest: int, way: float) -> Transfer | None:
    """Return the transfer about a greatest pitch; None where the trunk does not lean there and come back."""
    rate, longest = course.rate[:, 1], round(LONGEST_S / course.step)
    before = runs(rate[max(peak - longest, 0) : peak] > 0.0) + max(peak - longest, 0)
    after = runs(rate[peak : peak + longest] < 0.0) + peak
    flexing, extending = _nearest(course, before[::-1]), _nearest(course, after)
    if flexing is None or extending is None:
        return None
    start = crossing(rate, flexing, EDGE * rate[flexing], -1)
    stop = crossing(-rate, extending, -EDGE * rate[extending], 1)
    if start is None or stop is None:
        return None  # cut off by the recording
    leans = (course.pitch[peak] - value_at(course.pitch, one) for one in (start, stop))
    if min(leans) < LEAST_LEAN:
        return None
    return Transfer(
        start=start * course.step, peak=summit(course.pitch, peak)[0] * course.step, stop=stop * course.step,
        fastest=fastest * course.step, way=way, lean=summit(course.pitch, peak)[1],
    )  # fmt: skip


def _nearest(course: Course, stretches: IntArray) -> int | None:
    """Return the sample of the greatest rate in the first stretch in which the trunk turns by the least lean."""
    rate = np.abs(course.rate[:, 1])
    for a, b in stretches.tolist():
        if course.step * rate[a:b].sum() >= LEAST_LEAN:
            return int(a + np.argmax(rate[a:b]))
    return None


def crossing(x: FloatArray, start: int, level: float, way: int) -> float | None:
    """Return where a signal falls below a level, from a sample on backward (-1) or forward (1), between samples; None if never."""
    ahead: BoolArray = x[start::way] < level
    if not ahead.any():
        return None
    k = start + way * int(np.argmax(ahead))
    inside, outside = x[k - way] - level, level - x[k]
    return float(k - way * outside / (inside + outside))


def summit(x: FloatArray, k: int) -> tuple[float, float]:
    """Return place and value of a maximum between samples, by the parabola through three."""
    before, here, after = x[k - 1 : k + 2]
    bend = before - 2.0 * here + after
    shift = 0.0 if bend >= 0.0 else float(np.clip(0.5 * (before - after) / bend, -1.0, 1.0))
    return k + shift, float(here - 0.25 * (before - after) * shift)


def value_at(x: FloatArray, place: float) -> float:
    """Return a signal between samples."""
    return float(np.interp(place, np.arange(len(x)), x))


def rises_and_sittings(course: Course, task: str) -> tuple[list[Transfer], list[Transfer]]:
    """Return rises from a seat and times of sitting down; those that share one lean are squats."""
    rises, sittings = transfers(course, 1.0), transfers(course, -1.0)
    squats = [(up, down) for up in rises for down in sittings if up.start < down.fastest < up.fastest]
    rises = [one for one in rises if all(one is not up for up, _ in squats)]
    sittings = [one for one in sittings if all(one is not down for _, down in squats)]
    if not rises and squats:
        advice = "record from sitting to standing, with the trunk back between"
        raise not_shown(task, "a rise from a seat", f"{len(squats)} squats", advice)
    if not rises:
        lean = float(np.ptp(course.pitch)) / RADIAN_PER_DEGREE
        high = max(
            [course.step * float(course.velocity[a:b].sum()) for a, b in runs(course.velocity > 0.0)], default=0.0
        )
        raise not_shown(
            task, f"a rise of {LEAST_WAY:g} m or more, the trunk leaning by {LEAST_LEAN / RADIAN_PER_DEGREE:g} deg and back",
            f"a pitch over {lean:.3g} deg and a rise of {high:.2g} m at most",
            "record from sitting to standing, and check the sides of the device (`forward`, `up`)",
        )  # fmt: skip
    return rises, sittings


def sit_to_stand(course: Course) -> TaskResult:
    """Measure every rise from a seat, and every time that the person sits down."""
    return _measured(course, *rises_and_sittings(course, "sit-to-stand"))


def five_times(course: Course) -> TaskResult:
    """Measure five times sit-to-stand."""
    return _five(course, *rises_and_sittings(course, "5xSTS"), _measured)


def sit_to_stand_of_thigh(course: Course) -> TaskResult:
    """Measure every rise from a seat, and every time that the person sits down, by the thigh."""
    return _measured_of_thigh(course, *_turns_of_thigh(course, "sit-to-stand"))


def five_times_of_thigh(course: Course) -> TaskResult:
    """Measure five times sit-to-stand by the thigh."""
    return _five(course, *_turns_of_thigh(course, "5xSTS"), _measured_of_thigh)


def _five(
    course: Course, rises: list[Transfer], sittings: list[Transfer], measured: Callable[..., TaskResult]
) -> TaskResult:
    """Return the values and events of five rises and of the sittings between."""
    if len(rises) < 5:
        raise not_shown(
            "5xSTS", "five rises from a seat", f"{len(rises)}", "record all five, or measure them as sit-to-stand"
        )
    shown = measured(course, rises[:5], [one for one in sittings if one.start < rises[4].start])
    whole = Event(rises[0].start, rises[4].stop - rises[0].start, "5xSTS")
    gaps = np.diff([one.start for one in rises[:5]])
    values = {"five_times_duration_s": np.array([whole.duration]), "cycle_s": gaps, **shown.values}
    return TaskResult(values=values, events=(whole, *shown.events))


def _turns_of_thigh(course: Course, task: str) -> tuple[list[Transfer], list[Transfer]]:
    """Return the stretches in which a thigh turns upright from a seat, and those in which it turns down to it."""
    both, most = (list[Transfer](), list[Transfer]()), 0.0
    for sign, seen in zip((1.0, -1.0), both, strict=True):
        rate = sign * course.rate[:, 1]
        for a, b in runs(rate > 0.0).tolist():
            k = a + int(np.argmax(rate[a:b]))
            edges = [crossing(rate, k, EDGE * rate[k], way) for way in (-1, 1)]
            if (start := edges[0]) is None or (stop := edges[1]) is None:
                continue  # cut off by the recording
            first, last = (value_at(course.pitch, one) for one in (start, stop))
            upright, turn = (last if sign > 0.0 else first), sign * (last - first)
            most = max(most, turn)
            if turn >= LEAST_TURN and abs(upright) < UPRIGHT:
                top = summit(rate, k)[0] if 0 < k < len(rate) - 1 else float(k)
                begun, fastest, ended = (course.step * one for one in (start, top, stop))
                seen.append(Transfer(begun, fastest, ended, fastest, turn, min(first, last)))
    if not both[0]:
        degrees = [one / RADIAN_PER_DEGREE for one in (LEAST_TURN, UPRIGHT, most)]
        raise not_shown(
            task, f"a rise in which the thigh turns by {degrees[0]:g} deg or more to within {degrees[1]:g} deg of upright",
            f"one turn of {degrees[2]:.0f} deg at most",
            "record from sitting to standing, and check the sides of the device (`forward`, `up`)",
        )  # fmt: skip
    return both


def _thigh_events(course: Course, one: Transfer) -> list[Event]:
    """Return a rise, and when the hip has come a share of its way above the knee."""
    rows = np.arange(int(one.start / course.step), int(one.stop / course.step) + 2)
    height = np.cos(course.pitch[rows])
    share = (height - height[0]) / (height[-1] - height[0])
    off = float(np.interp(OFF, np.maximum.accumulate(share), rows)) * course.step
    return [Event(one.start, one.duration, "sit-to-stand"), Event(off, 0.0, "seat-off")]


def _measured_of_thigh(course: Course, rises: list[Transfer], sittings: list[Transfer]) -> TaskResult:
    """Return values and events of a thigh that rises from a seat, and sits down."""
    rate = np.abs(course.rate[:, 1])
    fastest = [np.array([value_at(rate, one.peak / course.step) for one in each]) for each in (rises, sittings)]
    rows = [(one.duration, one.peak - one.start, one.stop - one.peak, one.way, one.lean) for one in rises]
    whole, faster, slower, turn, seated = np.array(rows).T
    values = {
        "duration_s": whole, "acceleration_duration_s": faster, "deceleration_duration_s": slower,
        "thigh_pitch_range_deg": turn / RADIAN_PER_DEGREE, "thigh_pitch_sitting_deg": seated / RADIAN_PER_DEGREE,
        "thigh_pitch_standing_deg": (seated + turn) / RADIAN_PER_DEGREE, "peak_thigh_velocity_dps": fastest[0] / RADIAN_PER_DEGREE,
    }  # fmt: skip
    if sittings:
        values["peak_thigh_velocity_sitting_dps"] = fastest[1] / RADIAN_PER_DEGREE
    return _with_sittings(values, [event for one in rises for event in _thigh_events(course, one)], sittings)


def _measured(course: Course, rises: list[Transfer], sittings: list[Transfer]) -> TaskResult:
    """Return values and events of rises, and of the times of sitting down."""
    table = [rise_values(course, one) for one in rises]
    values = {name: np.array([row[name] for row in table]) for name in table[0]}
    return _with_sittings(values, [event for one in rises for event in rise_events(course, one)], sittings)


def _with_sittings(values: dict[str, FloatArray], events: list[Event], sittings: list[Transfer]) -> TaskResult:
    """Return values and events of rises, and of the times of sitting down."""
    if sittings:
        values["sitting_duration_s"] = np.array([one.duration for one in sittings])
    events += [Event(one.start, one.duration, "stand-to-sit") for one in sittings]
    return TaskResult(values=values, events=tuple(sorted(events, key=lambda one: (one.onset, -one.duration))))


def seat_off(course: Course, one: Transfer) -> float:
    """Return when the seat is left, s."""
    first, last = round(one.start / course.step), round(one.fastest / course.step) + 1
    k = first + int(np.argmax(course.up[first:last]))
    return summit(course.up, k)[0] * course.step if 0 < k < len(course.up) - 1 else k * course.step


def rise_values(course: Course, one: Transfer) -> dict[str, float]:
    """Return the measures of one rise."""
    a, b, off = one.start / course.step, one.stop / course.step, seat_off(course, one)
    rows, rate = slice(int(a), int(b) + 2), course.rate[:, 1] / RADIAN_PER_DEGREE
    lean = one.lean / RADIAN_PER_DEGREE
    fast, slow = (int(a) + int(f(rate[rows])) for f in (np.argmax, np.argmin))
    return {
        "duration_s": one.duration,
        "flexion_duration_s": one.peak - one.start,
        "extension_duration_s": one.stop - one.peak,
        "time_to_seat_off_s": off - one.start,
        "peak_trunk_pitch_deg": lean,
        "trunk_flexion_deg": lean - value_at(course.pitch, a) / RADIAN_PER_DEGREE,
        "trunk_extension_deg": lean - value_at(course.pitch, b) / RADIAN_PER_DEGREE,
        "peak_flexion_velocity_dps": summit(rate, fast)[1] if 0 < fast < len(rate) - 1 else float(rate[fast]),
        "peak_extension_velocity_dps": -(-summit(-rate, slow)[1] if 0 < slow < len(rate) - 1 else float(rate[slow])),
        "velocity_at_seat_off_dps": value_at(rate, off / course.step),
    }


def rise_events(course: Course, one: Transfer) -> list[Event]:
    """Return a rise and its phases."""
    return [
        Event(one.start, one.duration, "sit-to-stand"),
        Event(one.start, one.peak - one.start, "flexion"),
        Event(seat_off(course, one), 0.0, "seat-off"),
        Event(one.peak, one.stop - one.peak, "extension"),
    ]
