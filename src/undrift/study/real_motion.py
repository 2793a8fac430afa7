"""Captured people beside the simulated cohort: lean, rates and time of rising, and what a worn device would err by.

A repetition is found by the rise of the body's height past its middle. Around it the trunk leans forward to a peak and comes up
again; it begins and ends where the pitch rate falls below 5 deg/s. The same is done with captures and with the cohort's
performances, at L5, so that figures can stand side by side. The two are different people: there is nothing to pair, and so no
limits of agreement between them; a captured figure is inside the cohort's 95 % or it is not.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.orientation.angles import sagittal_pitch
from undrift.record import Reference
from undrift.sim.motion.library import TaskName, draw_task
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, fit_pose_spline
from undrift.sim.motion.subject import Group, cohort
from undrift.sim.motion.task import Task
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

Captured = Literal["sit_to_stand", "squat", "stairs"]
BESIDE: dict[Captured, TaskName] = {"sit_to_stand": "sit_to_stand", "squat": "sit_to_stand", "stairs": "step"}
LACKS: dict[Captured, str] = {
    "sit_to_stand": "",
    "squat": "the library has no squat: sit-to-stand stands beside it, and is not a model of it",
    "stairs": "several steps without a rest between; the library has a single step: length is not compared",
}
SKIN = PoseSettings(cutoff_hz=10.0, position_cutoff_hz=6.0)  # markers on skin: what is above is not the bone
RATE_HZ = 100.0
AT_REST = 5.0 * RADIAN_PER_DEGREE  # rad/s
REACH_S = 1.5  # lean peaks this near to the rise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Capture:
    """A captured trial.

    Parameters
    ----------
    name : str
        Of the trial.
    task : str
        sit_to_stand, squat or stairs.
    device : Reference
        Poses of a device at L5.
    """

    name: str
    task: Captured
    device: Reference


@dataclass(frozen=True, slots=True, kw_only=True)
class BesideRow:
    """A real figure beside the simulated cohort's.

    Parameters
    ----------
    trial, task : str
        Which recording, and what was done.
    measure, unit : str
        What.
    real : float
        Median over the repetitions; NaN where the recording does not tell.
    low, median, high : float
        Of the cohort: 2.5, 50 and 97.5 %.
    said : str
        What the data lack, empty where nothing.
    """

    trial: str
    task: str
    measure: str
    unit: str
    real: float
    low: float
    median: float
    high: float
    said: str = ""

    @property
    def inside(self) -> bool:
        """Whether the real figure lies within 95 % of the cohort's."""
        return self.low <= self.real <= self.high


REPETITION = (("lean", "deg"), ("peak flexion rate", "deg/s"), ("peak extension rate", "deg/s"), ("duration", "s"))
WHOLE = (("pitch range", "deg"), ("peak pitch rate", "deg/s"), ("peak roll rate", "deg/s"))


def motion_rows(
    captures: tuple[Capture, ...], *, subjects: int = 30, seed: int = 0, group: Group = "simulation"
) -> tuple[BesideRow, ...]:
    """Lay captures beside the simulated cohort.

    Parameters
    ----------
    captures : tuple of Capture
        Real trials.
    subjects : int
        Of the cohort, 30 at most.
    seed : int
        Draws cohort and performances.
    group : str
        simulation or testing.

    Returns
    -------
    tuple of BesideRow
        By capture, then measure.
    """
    names = tuple(dict.fromkeys(BESIDE[capture.task] for capture in captures))
    people = cohort(group, rng=np.random.default_rng([seed, 0]))[:subjects]
    drawn = []
    for name in names:
        rng = np.random.default_rng([seed, 1])
        done = [draw_task(name, rng=rng, subject=person) for person in people]
        drawn.append(np.array([_of_task(task) for task in done]))
    rows: list[BesideRow] = []
    for capture in captures:
        measures = WHOLE if capture.task == "stairs" else REPETITION
        low, middle, high = np.percentile(drawn[names.index(BESIDE[capture.task])], (2.5, 50.0, 97.5), axis=0)
        found, count = _of_capture(capture)
        for k, (measure, unit) in enumerate(measures):
            rows.append(
                BesideRow(
                    trial=capture.name,
                    task=f"{capture.task}, {count} repetitions" if count else capture.task,
                    measure=measure,
                    unit=unit,
                    real=float(found[k]),
                    low=float(low[k]),
                    median=float(middle[k]),
                    high=float(high[k]),
                    said=LACKS[capture.task],
                )
            )
    return tuple(rows)


def repetitions(time: FloatArray, pitch: FloatArray, rate: FloatArray, height: FloatArray) -> FloatArray:
    """Find risings and measure each.

    Parameters
    ----------
    time : array, shape (N,)
        s, even.
    pitch, rate : array, shape (N,)
        Sagittal pitch, forward positive, rad, and its rate, rad/s.
    height : array, shape (N,)
        Of the body, m.

    Returns
    -------
    array, shape (R, 4)
        Lean, deg; peak flexion and extension rate, deg/s; duration, s.

    Raises
    ------
    InputError
        A height that does not change.
    """
    low, high = np.percentile(height, (2.0, 98.0))
    if high - low < 0.05:
        raise InputError(
            f"repetitions: wanted a body that rises by 0.05 m or more, got {high - low:.3g} m; this is another task"
        )
    above, rises = height[0] > 0.5 * (low + high), []
    for k in range(len(height)):
        if not above and height[k] > low + 0.6 * (high - low):
            above = True
            rises.append(k)
        elif above and height[k] < low + 0.4 * (high - low):
            above = False
    reach = round(REACH_S / float(time[1] - time[0]))
    found = [_measured(time, pitch, rate, k, reach) for k in rises]
    return np.array([row for row in found if row is not None]).reshape(-1, 4)


def _measured(
    time: FloatArray, pitch: FloatArray, rate: FloatArray, rise: int, reach: int
) -> tuple[float, float, float, float] | None:
    first, last = max(rise - reach, 0), min(rise + reach, len(time) - 1)
    peak = first + int(np.argmax(pitch[first : last + 1]))
    before, after = max(peak - reach, 0), min(peak + reach, len(time) - 1)
    if peak - before < 2 or after - peak < 2:
        return None  # cut off by the recording
    flexing, extending = before + int(np.argmax(rate[before:peak])), peak + int(np.argmin(rate[peak : after + 1]))
    start, stop = flexing, extending
    while start > 0 and rate[start] > AT_REST:
        start -= 1
    while stop < len(time) - 1 and rate[stop] < -AT_REST:
        stop += 1
    lean = (pitch[peak] - pitch[start]) / RADIAN_PER_DEGREE
    rates = rate[[flexing, extending]] / RADIAN_PER_DEGREE
    return float(lean), float(rates[0]), float(-rates[1]), float(time[stop] - time[start])


def _of_task(task: Task) -> FloatArray:
    time = np.arange(task.moving_s[0] - 1.0, task.moving_s[1] + 1.0, 1.0 / RATE_HZ)
    motion = task.at(time, STANDARD_GRAVITY)
    if task.name == "sit_to_stand":
        return _of_rises(time, motion, task.position(time)[:, 2])[0]
    return _of_whole(motion)


def _of_capture(capture: Capture) -> tuple[FloatArray, int]:
    """Return the figures of a capture, NaN where it does not tell, and the number of repetitions."""
    spline = fit_pose_spline(capture.device, SKIN)
    start, stop = spline.span_s
    time = start + np.arange(int((stop - start) * RATE_HZ)) / RATE_HZ
    motion = spline.at(time, STANDARD_GRAVITY)
    if capture.task == "stairs":
        return _of_whole(motion), 0
    return _of_rises(time, motion, spline.position(time)[:, 2])


def _of_rises(time: FloatArray, motion: Motion, height: FloatArray) -> tuple[FloatArray, int]:
    known = motion.valid > 0.0
    pitch = np.unwrap(sagittal_pitch(motion.q_nb[known]))
    found = repetitions(time[known], pitch, np.gradient(pitch, time[known]), height[known])
    return np.median(found, axis=0) if len(found) else np.full(len(REPETITION), np.nan), len(found)


def _of_whole(motion: Motion) -> FloatArray:
    known = motion.valid > 0.0
    pitch, rate = np.unwrap(sagittal_pitch(motion.q_nb[known])), np.abs(motion.rate_b[known])
    return np.array([np.ptp(pitch), rate[:, 1].max(), rate[:, 0].max()]) / RADIAN_PER_DEGREE
