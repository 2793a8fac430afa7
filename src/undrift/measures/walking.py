"""Walking, by one device at the low back: steps, strides and their spread.

The step frequency 1 / T is where the upward acceleration has most power. A foot comes down, nearly, at a peak of the acceleration
smoothed by a Gaussian of 0.14 T, which is the wavelet of [1]_ centred on that frequency: the ground then bears most. The peak is
late by a share of the double support, the same at each step, so that durations are free of it::

    step      from a contact to the next            stride    from a contact to the next but one, of the same foot
    cadence   60 / mean step duration               spread    standard deviation, and in per cent of the mean (CV) [2]_
    regularity of steps and strides                 unbiased autocorrelation at T and 2 T, 100 % if all were alike [3]_
    bout      eight contacts or more, none 1.6 T after the one before, of a regularity of 30 % or more [4]_
    turn      a stride over which the heading changes by 45 deg or more [5]_, or the pitch by 25 deg, is in no figure, nor are the
              first and last of a bout

Range of pitch and roll: within a stride, mean over strides. Lengths and speed want more than one device: they are not stated.

.. [1] J. McCamley, M. Donati, E. Grimpampi, C. Mazza, "An enhanced estimate of initial contact and final contact instants of time
   using lower trunk inertial sensor data", Gait & Posture 36, 316-318, 2012.
.. [2] J. M. Hausdorff, "Gait variability: methods, modeling and meaning", J. NeuroEngineering and Rehabilitation 2, 19, 2005.
.. [3] R. Moe-Nilssen, J. L. Helbostad, "Estimation of gait cycle characteristics by trunk accelerometry", J. Biomechanics 37,
   121-126, 2004.
.. [4] F. Kluge et al., "Consensus based framework for digital mobility monitoring", PLoS ONE 16, e0256541, 2021: two strides
   of each foot or more; a pause of less than 3 s does not end a bout there, but the strides about it are in no figure here.
.. [5] M. El-Gohary et al., "Continuous monitoring of turning in patients with movement disability", Sensors 14, 356-369, 2014.
"""

import numpy as np

from undrift.arrays import FloatArray
from undrift.measures.rising import summit
from undrift.measures.tasks import Event, TaskResult, not_shown
from undrift.measures.worn import Course
from undrift.units import RADIAN_PER_DEGREE

STEP_S = (0.3, 1.5)  # from running to 40 steps a minute
LEAST_STEPS = 8  # two strides of each foot, and the first and the last
SPAN_S = 8.0  # of a spectrum
LEAST_SWING = 0.5  # m/s2, of a peak above what is about it: steps of 5 mm at 1.2 Hz [assumed]; stance on foam has 0.3
LEAST_REGULARITY = 0.3
MOST_GAP = 1.6  # T
MOST_RANGE = 25.0 * RADIAN_PER_DEGREE  # of pitch in a stride; who rises, sits or bows leans further [assumed]
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
    return duration, np.split(times, np.flatnonzero(np.diff(times) > MOST_GAP * duration) + 1)


def regularity(up: FloatArray, lag: float) -> float:
    """Return the greatest unbiased autocorrelation at lags near one, in samples."""
    x, lags = up - up.mean(), range(round(0.8 * lag), round(1.2 * lag) + 1)
    r = np.array([x[: len(x) - k] @ x[k:] / (len(x) - k) for k in lags]) / (x @ x / len(x))
    return summit(r, int(np.argmax(r[1:-1])) + 1)[1]


def walk(course: Course) -> TaskResult:
    """Measure the strides of all bouts straight ahead."""
    bouts, regular, steps, rows = list[FloatArray](), list[tuple[float, ...]](), list[float](), list[list[float]]()
    duration, seen = contacts(course.up, course.step)
    angles = np.stack((course.pitch, course.roll), axis=1) / RADIAN_PER_DEGREE
    for bout in (one for one in seen if len(one) >= LEAST_STEPS):
        places = np.rint(bout / course.step).astype(int)
        alike = tuple(regularity(course.up[places[1] : places[-2]], k * duration / course.step) for k in (1, 2))
        both = [slice(a, b) for a, b in zip(places[:-2], places[2:], strict=True)]
        turned = np.abs([course.turning[stride].sum() * course.step for stride in both])
        spans = np.array([np.ptp(angles[stride], axis=0) for stride in both])
        straight = (turned < TURN) & (spans[:, 0] < MOST_RANGE / RADIAN_PER_DEGREE)
        straight[[0, -1]] = False
        if max(alike) < LEAST_REGULARITY or straight.sum() < LEAST_STEPS - 4:
            continue
        bouts.append(bout)
        regular.append(alike)
        either = np.append(straight, False) | np.insert(straight, 0, False)  # a step of one stride or of the next
        steps += np.diff(bout)[either].tolist()
        rows += np.column_stack((bout[2:] - bout[:-2], spans))[straight].tolist()
    if not bouts:
        most = max((len(one) for one in seen), default=0)
        raise not_shown(
            "walk", f"{LEAST_STEPS} steps or more in a row, alike, without turn or bow",
            f"{most} in a row that differ, turn or bow" if most >= LEAST_STEPS else f"{most} in a row at most",
            "record steady walking straight ahead, 10 s or more, or name the task that was done",
        )  # fmt: skip
    strides, pitch, roll = np.array(rows).T
    regularities = np.average(regular, axis=0, weights=[len(one) for one in bouts])
    values = {
        "stride_duration_s": strides.mean(), "cadence_per_min": 60.0 / np.mean(steps), "step_duration_s": np.mean(steps),
        "stride_duration_sd_s": strides.std(ddof=1), "stride_duration_cv_percent": 100.0 * strides.std(ddof=1) / strides.mean(),
        "step_duration_sd_s": np.std(steps, ddof=1),
        "step_regularity_percent": 100.0 * regularities[0], "stride_regularity_percent": 100.0 * regularities[1],
        "trunk_pitch_range_deg": pitch.mean(), "trunk_roll_range_deg": roll.mean(),
        "walking_duration_s": sum(one[-1] - one[0] for one in bouts),
    }  # fmt: skip
    events = [Event(float(one[0]), float(one[-1] - one[0]), "walking") for one in bouts]
    events += [Event(float(instant), 0.0, "initial contact") for one in bouts for instant in one]
    return TaskResult(
        values={name: np.array([float(value)]) for name, value in values.items()},
        events=tuple(sorted(events, key=lambda one: (one.onset, -one.duration))),
        strides=len(rows),
        by_time={
            "cadence_per_min": float(values["cadence_per_min"] / values["step_duration_s"]),
            "stride_duration_cv_percent": 100.0 / float(strides.mean()),
        },
    )
