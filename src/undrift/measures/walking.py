"""Walking, by one device at the low back, a shank or a thigh: steps, strides and their spread.

At the low back the step frequency 1 / T is where the upward acceleration has most power. A foot comes down, nearly, at a peak of it
smoothed by a Gaussian of 0.14 T, which is the wavelet of [1]_ centred on that frequency: the ground then bears most. The peak is
late by a share of the double support, the same at each step, so that durations are free of it::

    step      from a contact to the next            stride    from a contact to the next but one, of the same foot
    cadence   60 / mean step duration               spread    standard deviation, and in per cent of the mean (CV) [2]_
    regularity of steps and strides                 unbiased autocorrelation at T and 2 T, 100 % if all were alike [3]_
    bout      eight contacts or more, none 1.6 T after the one before, of a regularity of 30 % or more [4]_
    turn      a stride over which the heading changes by 45 deg or more [5]_, or the pitch by 25 deg, is in no figure, nor are the
              first and last of a bout

By a shank or a thigh strides are those of its own leg, s the rate at which it swings forward about the left axis [6]_, [7]_::

    mid-swing        a peak of s above 50 deg/s and half of the usual one, the greatest within 0.5 s
    initial contact  of the shank: s falls below zero after mid-swing [8]_
    end contact      of the shank: the least s within half a stride before mid-swing
    stance, swing    from initial to end contact, and from there to the next initial contact; in per cent of the stride
    stride           from an initial contact to the next; of a thigh, which shows none, from a mid-swing to the next
    bout             five of those or more, else as above, s for the acceleration

Range of pitch and roll: within a stride, mean over strides. Lengths and speed want more than one device: they are not stated.

.. [1] J. McCamley, M. Donati, E. Grimpampi, C. Mazza, "An enhanced estimate of initial contact and final contact instants of time
   using lower trunk inertial sensor data", Gait & Posture 36, 316-318, 2012.
.. [2] J. M. Hausdorff, "Gait variability: methods, modeling and meaning", J. NeuroEngineering and Rehabilitation 2, 19, 2005.
.. [3] R. Moe-Nilssen, J. L. Helbostad, "Estimation of gait cycle characteristics by trunk accelerometry", J. Biomechanics 37,
   121-126, 2004.
.. [4] F. Kluge et al., "Consensus based framework for digital mobility monitoring", PLoS ONE 16, e0256541, 2021: two strides
   of each foot or more; a pause of less than 3 s does not end a bout there, but the strides about it are in no figure here.
.. [5] M. El-Gohary et al., "Continuous monitoring of turning in patients with movement disability", Sensors 14, 356-369, 2014.
.. [6] K. Aminian et al., "Spatio-temporal parameters of gait measured by an ambulatory system using miniature gyroscopes",
   J. Biomechanics 35, 689-699, 2002.
.. [7] A. Salarian et al., "Gait assessment in Parkinson's disease: toward an ambulatory system for long-term monitoring", IEEE
   Trans. Biomedical Engineering 51, 1434-1443, 2004: the initial contact is the minimum that follows, whose instant moves by 0.04 s
   with the low-pass; that of the change of sign moves by 0.002 s (docs/decisions/2026-11-28-measures-of-limbs.md).
.. [8] A. Behboodi et al., "Real-time detection of seven phases of gait in children with cerebral palsy using two gyroscopes",
   Sensors 19, 2517, 2019.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.measures.rising import crossing, summit
from undrift.measures.tasks import Event, TaskResult, not_shown
from undrift.measures.worn import Course
from undrift.units import RADIAN_PER_DEGREE

STEP_S = (0.3, 1.5)  # from running to 40 steps a minute
LEAST_STEPS = 8  # two strides of each foot, and the first and the last
LEAST_SWINGS = 5  # of one leg, alike
SWING, NEAR_S = 50.0 * RADIAN_PER_DEGREE, 0.5  # rad/s, s [7]_
SPAN_S = 8.0  # of a spectrum
LEAST_SWING = 0.5  # m/s2, of a peak above what is about it: steps of 5 mm at 1.2 Hz [assumed]; stance on foam has 0.3
LEAST_REGULARITY = 0.3
MOST_GAP = 1.6  # T
# of pitch in a stride: who rises, sits or bows leans further [assumed]; a shank has 80 deg in fast walking
MOST_RANGE, MOST_OF_LEG = 25.0 * RADIAN_PER_DEGREE, 110.0 * RADIAN_PER_DEGREE
TURN = 45.0 * RADIAN_PER_DEGREE
SHARE = 0.14  # of a step: 0.2, the centre frequency of the wavelet, over sqrt(2)


def contacts(up: FloatArray, step: float) -> tuple[float, list[FloatArray]]:
    """Return the duration of a step and the instants of contacts in each bout, s: up (N,) m/s2, step between samples, s."""
    from scipy.ndimage import gaussian_filter1d
    from scipy.signal import find_peaks, welch

    frequency, power = welch(up, 1.0 / step, nperseg=min(len(up), round(SPAN_S / step)))
    band = np.flatnonzero((frequency > 1.0 / STEP_S[1]) & (frequency < 1.0 / STEP_S[0]))
    place, _ = summit(power, int(band[np.argmax(power[band])]))
    duration = 1.0 / (place * float(frequency[1]))
    x = gaussian_filter1d(up, SHARE * duration / step)
    tops, _ = find_peaks(x, prominence=LEAST_SWING, distance=max(1, round(0.5 * duration / step)))
    times = step * np.array([summit(x, k)[0] for k in tops.tolist()])
    return duration, _split(times, duration)


def regularity(up: FloatArray, lag: float) -> float:
    """Return the greatest unbiased autocorrelation at lags near one, in samples."""
    x, lags = up - up.mean(), range(round(0.8 * lag), round(1.2 * lag) + 1)
    r = np.array([x[: len(x) - k] @ x[k:] / (len(x) - k) for k in lags]) / (x @ x / len(x))
    return summit(r, int(np.argmax(r[1:-1])) + 1)[1]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bouts:
    """Walking straight ahead."""

    which: list[int]  # of the bouts that were seen
    instants: list[FloatArray]  # of steps or strides in each, s
    straight: list[BoolArray]  # strides of each that count
    rows: FloatArray  # (n, 3), of those: duration, s, range of pitch and of roll, deg
    regular: FloatArray  # autocorrelation at each lag


def _bouts(course: Course, seen: list[FloatArray], x: FloatArray, duration: float = 0.0, *, legs: int) -> Bouts:
    """Return the bouts that are walking, of both legs or one: x (N,) repeats with each step, of one leg with each stride."""
    least, most = (LEAST_STEPS, MOST_RANGE) if legs == 2 else (LEAST_SWINGS, MOST_OF_LEG)
    angles = np.stack((course.pitch, course.roll), axis=1) / RADIAN_PER_DEGREE
    which, straights, rows, regular = list[int](), list[BoolArray](), list[list[float]](), list[list[float]]()
    for number, bout in enumerate(seen):
        if len(bout) < least:
            continue
        places = np.rint(bout / course.step).astype(int)
        inner = x[places[1] : places[-2]]
        lag = (duration or float(np.median(np.diff(bout)))) / course.step
        alike = [regularity(inner, k * lag) for k in range(1, legs + 1)]
        both = [slice(a, b) for a, b in zip(places[:-legs], places[legs:], strict=True)]
        turned = np.abs([course.turning[stride].sum() * course.step for stride in both])
        spans = np.array([np.ptp(angles[stride], axis=0) for stride in both])
        straight = (turned < TURN) & (spans[:, 0] < most / RADIAN_PER_DEGREE)
        straight[[0, -1]] = False
        if max(alike) < LEAST_REGULARITY or straight.sum() < least - 2 - legs:
            continue
        which.append(number)
        straights.append(straight)
        regular.append(alike)
        rows += np.column_stack((bout[legs:] - bout[:-legs], spans))[straight].tolist()
    if not which:
        count, what = max((len(one) for one in seen), default=0), "steps" if legs == 2 else "swings of the leg"
        raise not_shown(
            "walk", f"{least} {what} or more in a row, alike, without turn or bow",
            f"{count} in a row that differ, turn or bow" if count >= least else f"{count} in a row at most",
            "record steady walking straight ahead, 10 s or more, or name the task that was done",
        )  # fmt: skip
    instants = [seen[k] for k in which]
    mean = np.average(regular, axis=0, weights=[len(one) for one in instants])
    return Bouts(which=which, instants=instants, straight=straights, rows=np.array(rows), regular=mean)


def _shown(bouts: Bouts, segment: str, more: Mapping[str, float], events: list[Event]) -> TaskResult:
    """Return the values of strides, of two steps each, and more; the events beside the bouts."""
    strides, pitch, roll = bouts.rows.T
    mean, spread = float(strides.mean()), float(strides.std(ddof=1))
    values = {
        "stride_duration_s": mean, "stride_duration_sd_s": spread, "stride_duration_cv_percent": 100.0 * spread / mean,
        "cadence_per_min": 120.0 / mean, **more, "stride_regularity_percent": 100.0 * bouts.regular[-1],
        f"{segment}_pitch_range_deg": pitch.mean(), f"{segment}_roll_range_deg": roll.mean(),
        "walking_duration_s": sum(one[-1] - one[0] for one in bouts.instants),
    }  # fmt: skip
    events = [Event(float(one[0]), float(one[-1] - one[0]), "walking") for one in bouts.instants] + events
    return TaskResult(
        values={name: np.array([float(value)]) for name, value in values.items()},
        events=tuple(sorted(events, key=lambda one: (one.onset, -one.duration))),
        strides=len(strides),
        by_time={
            "cadence_per_min": values["cadence_per_min"] ** 2 / 60.0,
            **dict.fromkeys(("stride_duration_cv_percent", "stance_percent"), 100.0 / mean),
        },
    )


def _instants(names: str, bouts: list[FloatArray]) -> list[Event]:
    """Return instants as events of a type."""
    return [Event(float(instant), 0.0, names) for bout in bouts for instant in bout]


def walk(course: Course) -> TaskResult:
    """Measure the strides of all bouts straight ahead."""
    duration, seen = contacts(course.up, course.step)
    bouts, steps = _bouts(course, seen, course.up, duration, legs=2), list[float]()
    for bout, straight in zip(bouts.instants, bouts.straight, strict=True):
        either = np.append(straight, False) | np.insert(straight, 0, False)  # a step of one stride or of the next
        steps += np.diff(bout)[either].tolist()
    more = {
        "cadence_per_min": 60.0 / np.mean(steps), "step_duration_s": np.mean(steps), "step_duration_sd_s": np.std(steps, ddof=1),
        "step_regularity_percent": 100.0 * bouts.regular[0],
    }  # fmt: skip
    return _shown(bouts, "trunk", more, _instants("initial contact", bouts.instants))


def swings(course: Course) -> tuple[FloatArray, list[int], float]:
    """Return the rate at which a leg swings forward, rad/s, the samples of mid-swing, and the usual stride, samples."""
    from scipy.signal import find_peaks

    swing = -course.rate[:, 1]
    ahead, back = (float(np.percentile(sign * swing, 99.0)) / RADIAN_PER_DEGREE for sign in (1.0, -1.0))
    if back > max(ahead, SWING / RADIAN_PER_DEGREE):
        raise not_shown(
            "walk", "a leg that swings forward faster than back", f"{ahead:.0f} and {back:.0f} deg/s",
            "check the sides of the device (`forward`, `up`), or name the task that was done",
        )  # fmt: skip
    tops = find_peaks(swing, height=SWING, distance=max(1, round(NEAR_S / course.step)))[0]
    tops = tops[swing[tops] > 0.5 * np.median(swing[tops])] if len(tops) else tops
    return swing, tops.tolist(), float(np.median(np.diff(tops))) if len(tops) > 1 else 1.0


def walk_of_thigh(course: Course) -> TaskResult:
    """Measure the strides of the leg whose thigh wears the device."""
    swing, tops, stride = swings(course)
    times = course.step * np.array([summit(swing, k)[0] for k in tops])
    bouts = _bouts(course, _split(times, stride * course.step), swing, legs=1)
    return _shown(bouts, "thigh", {}, _instants("mid-swing", bouts.instants))


def contacts_of_shank(course: Course) -> tuple[FloatArray, list[FloatArray]]:
    """Return the rate at which a shank swings forward; by bout initial contact, the end contact before, s, peak, rad/s (K, 3)."""
    swing, tops, stride = swings(course)
    rows = list[tuple[float, float, float]]()
    for k in tops:
        first, stop = max(0, k - round(0.5 * stride)), crossing(swing, k, 0.0, 1)
        low = first + int(np.argmin(swing[first:k])) if k else 0
        if low > 0 and stop is not None and stop - k < 0.5 * stride:
            rows.append((course.step * stop, course.step * summit(-swing, low)[0], summit(swing, k)[1]))
    return swing, _split(np.array(rows).reshape(-1, 3), stride * course.step)


def walk_of_shank(course: Course) -> TaskResult:
    """Measure the strides of the leg whose shank wears the device, and their stance and swing."""
    swing, tables = contacts_of_shank(course)
    bouts = _bouts(course, [one[:, 0] for one in tables], swing, legs=1)
    inside = [
        np.column_stack((one[1:, 1] - one[:-1, 0], one[1:, 0] - one[1:, 1], one[1:, 2]))[straight]
        for one, straight in zip((tables[k] for k in bouts.which), bouts.straight, strict=True)
    ]
    stance, swung, fastest = np.concatenate(inside).T
    more = {
        "stance_duration_s": stance.mean(), "swing_duration_s": swung.mean(),
        "stance_percent": 100.0 * (stance / (stance + swung)).mean(), "peak_swing_velocity_dps": fastest.mean() / RADIAN_PER_DEGREE,
    }  # fmt: skip
    ends = _instants("end contact", [tables[k][:, 1] for k in bouts.which])
    return _shown(bouts, "shank", more, _instants("initial contact", bouts.instants) + ends)


def _split(rows: FloatArray, duration: float) -> list[FloatArray]:
    """Return instants (K,), or rows that begin with them, by bout."""
    return np.split(rows, np.flatnonzero(np.diff(rows if rows.ndim == 1 else rows[:, 0]) > MOST_GAP * duration) + 1)
