"""Captured people and stances on a force plate, compared with the simulated cohort.

Captured people: lean, rates and time of rising at L5; a repetition begins and ends where the pitch rate falls below 5 deg/s. Quiet
stance on a force plate: the centre of pressure, and the horizontal force over the mass; the cohort's centre of pressure is that of
the pendulum, p = x - (1.147 h/g) x''. Captured and simulated people differ: nothing is paired.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.files import read_bytes
from undrift.frames import rotate
from undrift.orientation import sagittal_pitch
from undrift.record import Reference
from undrift.sim.motion.poses import PoseSpline, fit_pose_spline
from undrift.sim.motion.tasks import (
    DEFAULT,
    GROUP_SIZE,
    GYRATION,
    CategoryName,
    Group,
    Subject,
    Task,
    TaskName,
    cohort,
    draw_task,
)
from undrift.study.recorded import SAMPLE_RATE_HZ, SKIN
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- captured people and the cohort

Captured = Literal["sit_to_stand", "squat", "stairs"]
LIKE: dict[Captured, TaskName] = {"sit_to_stand": "sit_to_stand", "squat": "sit_to_stand", "stairs": "step"}
LACKS: dict[Captured, str] = {
    "sit_to_stand": "",
    "squat": "the library has no squat: compared with sit-to-stand, which is not a model of it",
    "stairs": "several steps without a rest between; the library has a single step: length is not compared",
}
AT_REST = 5.0 * RADIAN_PER_DEGREE  # rad/s
REACH_S = 1.5  # lean peaks this near to the rise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CapturedTrial:
    """A captured trial."""

    name: str  # Of the trial
    task: Captured  # sit_to_stand, squat or stairs
    device: Reference  # Poses of a device at L5
    category: CategoryName = DEFAULT  # category of the person, whose simulated people are compared


@dataclass(frozen=True, slots=True)
class CohortComparison:
    """A real figure and the simulated cohort's."""

    trial: str  # Which recording
    task: str  # What was done
    measure: str
    unit: str
    real: float  # median over the repetitions, NaN if the recording does not determine it
    low: float  # of the cohort, 2.5 %
    median: float  # Of the cohort
    high: float  # of the cohort, 97.5 %
    note: str = ""  # Limits of the comparison

    @property
    def inside(self) -> bool:
        """Whether the real figure lies within 95 % of the cohort's."""
        return self.low <= self.real <= self.high


REPETITION = (("lean", "deg"), ("peak flexion rate", "deg/s"), ("peak extension rate", "deg/s"), ("duration", "s"))
WHOLE = (("pitch range", "deg"), ("peak pitch rate", "deg/s"), ("peak roll rate", "deg/s"))


def motion_rows(
    captures: tuple[CapturedTrial, ...], *, subjects: int = 30, seed: int = 0, group: Group = "simulation"
) -> tuple[CohortComparison, ...]:
    """Compare captures with the simulated cohort."""
    drawn: dict[tuple[TaskName, CategoryName], FloatArray] = {}
    rows: list[CohortComparison] = []
    for capture in captures:
        like, kind = LIKE[capture.task], capture.category
        if (like, kind) not in drawn:
            rng = np.random.default_rng([seed, 1])
            figures = []
            for person in _people(group, kind, subjects, seed):
                performed = draw_task(like, rng=rng, subject=person)
                start, stop = performed.moving_s
                time = np.arange(start - 1.0, stop + 1.0, 1.0 / SAMPLE_RATE_HZ)
                figures.append(_figures_of(performed, time, whole=like == "step")[0])
            drawn[like, kind] = np.array(figures)
        measures = WHOLE if capture.task == "stairs" else REPETITION
        spline = fit_pose_spline(capture.device, SKIN)
        start, stop = spline.span_s
        time = start + np.arange(int((stop - start) * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
        found, count = _figures_of(spline, time, whole=capture.task == "stairs")
        task = f"{capture.task}, {count} repetitions" if count else capture.task
        rows += _compared((capture.name, _by(task, kind)), measures, found, drawn[like, kind], LACKS[capture.task])
    return tuple(rows)


def _people(group: Group, category: CategoryName, count: int, seed: int) -> tuple[Subject, ...]:
    """Return people of a category. More than thirty people need further cohorts."""
    seeds = ([seed, 0, *([block] if block else [])] for block in range(-(-count // GROUP_SIZE)))
    drawn = (cohort(group, rng=np.random.default_rng(each), category=category) for each in seeds)
    return tuple(person for people in drawn for person in people)[:count]


def _by(task: str, category: CategoryName) -> str:
    return task if category == DEFAULT else f"{task}, {category}"


def _compared(
    what: tuple[str, str], measures: Sequence[tuple[str, str]], real: FloatArray, cohort: FloatArray, note: str
) -> list[CohortComparison]:
    spans = np.percentile(cohort, (2.5, 50.0, 97.5), axis=0).T.tolist()
    return [
        CohortComparison(*what, measure, unit, value, low, median, high, note)
        for (measure, unit), value, (low, median, high) in zip(measures, real.tolist(), spans, strict=True)
    ]


def repetitions(time: FloatArray, pitch: FloatArray, rate: FloatArray, height: FloatArray) -> FloatArray:
    """Find risings and measure each: time (N,) s, pitch (N,) rad/s, rate (N,) rad/s, height (N,) m -> (R, 4) s."""
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
    first, last, peak = max(rise - reach, 0), min(rise + reach, len(time) - 1), rise
    while peak > first and rate[peak] < 0.0:  # the trunk turns back before the body is up, then it may bend to sit down
        peak -= 1
    while peak < last and rate[peak] > 0.0:
        peak += 1
    first, last = max(peak - reach, 0), min(peak + reach, len(time) - 1)
    before, after = peak, peak
    while before > first and rate[before - 1] > -AT_REST:
        before -= 1
    while after < last and rate[after + 1] < AT_REST:
        after += 1
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


def _figures_of(performed: Task | PoseSpline, time: FloatArray, *, whole: bool) -> tuple[FloatArray, int]:
    """Return the figures of a performance, NaN where it does not show them, and the number of repetitions."""
    motion = performed.at(time, STANDARD_GRAVITY)
    known = motion.valid > 0.0
    pitch = np.unwrap(sagittal_pitch(motion.q_nb[known]))
    if whole:
        rate = np.abs(motion.rate_b[known])
        return np.array([np.ptp(pitch), rate[:, 1].max(), rate[:, 0].max()]) / RADIAN_PER_DEGREE, 0
    height = performed.position(time)[known, 2]
    found = repetitions(time[known], pitch, np.gradient(pitch, time[known]), height)
    return np.median(found, axis=0) if len(found) else np.full(len(REPETITION), np.nan), len(found)


# ---- quiet stance on a force plate

Condition = Literal["closed on foam", "open on foam", "closed on firm", "open on firm"]
PATH_HZ = 10.0  # the path of the centre of pressure is taken at this rate: the plate's noise adds none
BAND_HZ = (0.05, 2.5)  # below, 50 s are too short, and above, the library has no power
EDGE_S = 2.5  # of the simulated stance, in which sway builds up
STANCE_S = 45.0  # of both, so that slow drift counts alike
MEASURES = (
    ("centre of pressure AP, rms", "mm"),
    ("centre of pressure ML, rms", "mm"),
    ("centre of pressure AP, range", "mm"),
    ("centre of pressure ML, range", "mm"),
    ("speed of the centre of pressure", "mm/s"),
    ("mean frequency AP", "Hz"),
    ("mean frequency ML", "Hz"),
    ("acceleration AP, rms", "mm/s2"),
    ("acceleration ML, rms", "mm/s2"),
    ("sway area, 95 % ellipse", "mm2"),
    ("median frequency AP", "Hz"),
    ("median frequency ML", "Hz"),
)
ELLIPSE_95 = 5.991  # chi square of two degrees of freedom
COLUMNS = {
    "grf": ("Time", "GRFNET_X", "GRFNET_Z", "COPNET_X", "COPNET_Z", 1.0),  # m, X forward
    "plate": ("Time[s]", "Fx[N]", "Fy[N]", "COPx[cm]", "COPy[cm]", 0.01),  # cm, x forward
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stance:
    """A stance on a force plate, forward and sideways."""

    name: str  # Of the trial
    condition: Condition  # Eyes and surface
    time: FloatArray  # (N,), s
    acceleration: FloatArray  # (N, 2), of the body's centre, m/s2
    pressure: FloatArray  # (N, 2), centre of pressure, m
    category: CategoryName = DEFAULT  # category of the person, as in a capture


def read_stance(path: Path, *, mass_kg: float, condition: Condition, category: CategoryName = DEFAULT) -> Stance:
    """Read a stance from a public force-plate file, tab-separated, gzipped or not."""
    if not mass_kg > 0.0:
        raise InputError(f"{path.name}: expected the person's mass in kg, got {mass_kg:g}. State it")
    try:
        text = io.StringIO(read_bytes(path).decode())
        names = text.readline().split("\t")
        table = np.loadtxt(text, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: expected a table of numbers under one line of names, got {error}. Check it"
        ) from error
    names = [name.strip() for name in names]
    for *wanted, scale in COLUMNS.values():
        if all(name in names for name in wanted):
            at = [names.index(str(name)) for name in wanted]
            if not (np.isfinite(table[:, at]).all() and (np.diff(table[:, at[0]]) > 0.0).all()):
                raise InputError(
                    f"{path}: expected finite numbers at increasing times, got others. Export the table again"
                )
            force, pressure = table[:, at[1:3]], table[:, at[3:5]] * float(scale)
            return Stance(
                name=path.name.split(".")[0],
                condition=condition,
                time=table[:, at[0]],
                acceleration=(force - force.mean(axis=0)) / mass_kg,
                pressure=pressure,
                category=category,
            )
    raise InputError(
        f"{path.name}: expected columns GRFNET_X, GRFNET_Z, COPNET_X, COPNET_Z or Fx[N], Fy[N], COPx[cm], COPy[cm], got "
        f"{', '.join(names[:6])}. Name them so"
    )


def sway_rows(stances: tuple[Stance, ...], *, subjects: int = 30, seed: int = 0) -> tuple[CohortComparison, ...]:
    """Compare stances with the simulated cohort's sway."""
    simulated: dict[CategoryName, FloatArray] = {}
    for kind in {stance.category for stance in stances}:
        rng = np.random.default_rng([seed, 1])
        people = _people("simulation", kind, subjects, seed)
        drawn = [draw_task("posturography", rng=rng, subject=person) for person in people]
        simulated[kind] = np.array([sway_figures(_simulated(task)) for task in drawn])
    rows: list[CohortComparison] = []
    for stance in stances:
        other = stance.condition != "closed on foam"
        note = f"{stance.condition}: the library's stance is eyes closed on foam, which sways more" if other else ""
        what = stance.name, _by("posturography", stance.category)
        rows += _compared(what, MEASURES, sway_figures(stance), simulated[stance.category], note)
    return tuple(rows)


def sway_figures(stance: Stance) -> FloatArray:
    """Measure a stance, (12,)."""
    count = round(STANCE_S * SAMPLE_RATE_HZ)
    spare = len(stance.time) - count
    if spare < 0:
        return np.full(len(MEASURES), np.nan)
    middle = slice(spare // 2, spare // 2 + count)
    pressure = 1e3 * (stance.pressure[middle] - stance.pressure[middle].mean(axis=0))
    acceleration = 1e3 * (stance.acceleration[middle] - stance.acceleration[middle].mean(axis=0))
    coarse = pressure[:: round(SAMPLE_RATE_HZ / PATH_HZ)]
    speed = float(np.linalg.norm(np.diff(coarse, axis=0), axis=1).mean()) * PATH_HZ
    mean, median = np.array([_frequencies(column) for column in pressure.T]).T
    area = float(np.pi * ELLIPSE_95 * np.sqrt(np.linalg.det(np.cov(pressure.T))))
    sizes = *pressure.std(axis=0), *np.ptp(pressure, axis=0), speed
    return np.array([*sizes, *mean, *acceleration.std(axis=0), area, *median])


def _frequencies(x: FloatArray) -> tuple[float, float]:
    """Return the mean frequency and the median one, below which half the power is, Hz."""
    power, frequency = np.abs(np.fft.rfft(x * np.hanning(len(x)))) ** 2, np.fft.rfftfreq(len(x), 1.0 / SAMPLE_RATE_HZ)
    band = (frequency >= BAND_HZ[0]) & (frequency <= BAND_HZ[1])
    below = np.cumsum(power[band]) / power[band].sum()
    return float(power[band] @ frequency[band] / power[band].sum()), float(frequency[band][np.searchsorted(below, 0.5)])


def _simulated(task: Task) -> Stance:
    time = np.arange(task.moving_s[0] + EDGE_S, task.moving_s[1] - EDGE_S + 1e-9, 1.0 / SAMPLE_RATE_HZ)
    motion = task.at(time, STANDARD_GRAVITY)
    acceleration = rotate(motion.q_nb, motion.force_b)[:, :2]
    pressure = task.position(time)[:, :2] - GYRATION * task.arm_b[2] / STANDARD_GRAVITY * acceleration
    return Stance(name="simulated", condition="closed on foam", time=time, acceleration=acceleration, pressure=pressure)


# ---- the simulated device worn in captured motions


# ---- real.toml
