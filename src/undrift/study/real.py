"""Real recordings judged as the study judges simulated ones; real.toml names them (docs/study-results.md shows one).

Trials beside optics (BROAD, or any recording with its poses) at three levels: none, no offset removed; rest, less the mean rate
of the first rest; calibrated, a gyroscope fit to the other trials of the same device. A truncating converter leaves half a step
as an offset, worth as much as a level: all levels are judged with the rounding undone and with it left in.

Captured people and the simulated cohort: lean, rates and time of rising at L5; a repetition begins and ends where the pitch rate
falls below 5 deg/s. Quiet stance on a force plate: the centre of pressure, and the horizontal force over the mass; the cohort's
centre of pressure is that of the pendulum, p = x - (1.147 h/g) x''. Captured and simulated people differ: nothing is paired.

[actual] is Figure 3 with a twin of a real device as the actual one: matrix, offset, noise and codes as ``undrift twin`` found
them beside optics, offsets over temperature as a recording at rest has them. The simulated device is a preset.
"""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import numpy as np
from annotated_types import Gt, MinLen

from undrift.arrays import FloatArray
from undrift.base.codec import read, stored
from undrift.errors import FileFormatError, InputError, UndriftError
from undrift.files import read_bytes
from undrift.findings import Finding, finding
from undrift.frames import rotate
from undrift.io.formats import detect, read_record, read_reference
from undrift.io.session import read_map
from undrift.orientation import sagittal_pitch
from undrift.record import Record, Reference
from undrift.sim.device.model import DeviceModel, read_device
from undrift.sim.device.presets import preset
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
from undrift.sim.table_sessions import ROOM_TEMP_C
from undrift.study.case import REST_S, pitch_error, typical_unit, wear
from undrift.study.figure3 import LEVELS, SETTLED_S, Climate, Figure3, calibrated, figure3
from undrift.study.plan import SAMPLE_RATE_HZ, SKIN, Posed, RecordedTask, Study, read_poses
from undrift.twin.fit import fit_warm_up, with_warm_up
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation import agreement
from undrift.validation.trial import Adc, Figures, Trial, TrialSettings

Rounding = Literal["undone", "left in", "none found"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DeviceTrials:
    """Trials of one device with their optics."""

    device: str  # What to call it
    names: tuple[str, ...]  # Of the trials
    pairs: tuple[agreement.Pair, ...]  # Two or more


@dataclass(frozen=True, slots=True)
class Pairwise:
    """Agreement of two ways to measure one quantity over trials."""

    quantity: str  # What, with its unit
    limits: agreement.BlandAltman  # Bias and limits
    icc: agreement.IntraclassCorrelation  # Absolute agreement, ICC(2,1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RealErrors:
    """Errors of real trials at one level."""

    level: str  # none, rest or calibrated
    # What became of the converter's rounding: undone, left in, or none found in the codes of any trial
    rounding: Rounding
    trials: tuple[Trial, ...]  # Each judged
    median: Figures  # Over the trials
    agreement: Pairwise | None  # Of mean inclination, sensor and optics; None with fewer than three trials


def real_errors(devices: Sequence[DeviceTrials]) -> tuple[RealErrors, ...]:
    """Judge real trials without calibration, with their rest alone, and with a calibration from the device's other trials."""
    undone, left_in = _levels(devices, "auto", "undone"), _levels(devices, "none", "left in")
    errors = [[t.figures.rmse_total_deg for level in levels for t in level.trials] for levels in (undone, left_in)]
    if np.array_equal(errors[0], errors[1], equal_nan=True):
        return tuple(replace(level, rounding="none found") for level in undone)
    return (*undone, *left_in)


def _levels(devices: Sequence[DeviceTrials], adc: Adc, rounding: Rounding) -> tuple[RealErrors, ...]:
    """Judge the trials at the three levels, the codes treated alike in all."""
    settings, levels = TrialSettings(adc=adc), dict[str, agreement.Validation]()
    pairs, names = [pair for one in devices for pair in one.pairs], [name for one in devices for name in one.names]
    for offset in ("none", "rest"):
        levels[offset] = agreement.validate_trials(pairs, settings=replace(settings, offset=offset), names=names)
    fitted = (agreement.validate_leave_one_out(one.pairs, settings=settings, names=one.names) for one in devices)
    levels["calibrated"] = agreement.summed(tuple(trial for of_device in fitted for trial in of_device.trials))
    return tuple(
        RealErrors(level=level, rounding=rounding, trials=seen.trials, median=seen.median, agreement=_pairwise(seen))
        for level, seen in levels.items()
    )


def _pairwise(seen: agreement.Validation) -> Pairwise | None:
    both = seen.agreement
    return None if both is None else Pairwise("mean inclination, deg", both.limits, both.absolute)


def agreement_of(quantity: str, first: FloatArray, second: FloatArray) -> Pairwise | None:
    """Return the agreement of two ways to measure: first (n,), second (n,)."""
    if len(first) < agreement.LEAST_FOR_AGREEMENT:
        return None
    icc = agreement.intraclass_correlation(np.stack((first, second), axis=1), "ICC(2,1)")
    return Pairwise(quantity, agreement.bland_altman(first, second), icc)


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
    category: CategoryName = DEFAULT  # Of the person, whose simulated people are compared


@dataclass(frozen=True, slots=True)
class CohortComparison:
    """A real figure and the simulated cohort's."""

    trial: str  # Which recording
    task: str  # What was done
    measure: str
    unit: str
    real: float  # Median over the repetitions; NaN where the recording does not show it
    low: float  # Of the cohort, 2.5 %
    median: float  # Of the cohort
    high: float  # Of the cohort, 97.5 %
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
    """Return people of a category; beyond thirty, of further cohorts."""
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
    while peak > first and rate[peak] < 0.0:  # the trunk turns back before the body is up; then it may bend to sit down
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
BAND_HZ = (0.05, 2.5)  # below, 50 s are too short; above, the library has no power
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
    category: CategoryName = DEFAULT  # Of the person, as of a capture


def read_stance(path: Path, *, mass_kg: float, condition: Condition, category: CategoryName = DEFAULT) -> Stance:
    """Read a stance from a public force-plate file, tab-separated, gzipped or not."""
    if not mass_kg > 0.0:
        raise InputError(f"{path.name}: wanted the person's mass in kg, got {mass_kg:g}; state it")
    try:
        text = io.StringIO(read_bytes(path).decode())
        names = text.readline().split("\t")
        table = np.loadtxt(text, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: wanted a table of numbers under one line of names, got {error}; check it") from error
    names = [name.strip() for name in names]
    for *wanted, scale in COLUMNS.values():
        if all(name in names for name in wanted):
            at = [names.index(str(name)) for name in wanted]
            if not (np.isfinite(table[:, at]).all() and (np.diff(table[:, at[0]]) > 0.0).all()):
                raise InputError(
                    f"{path}: wanted finite numbers at increasing times, got others; export the table again"
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
        f"{path.name}: wanted columns GRFNET_X, GRFNET_Z, COPNET_X, COPNET_Z or Fx[N], Fy[N], COPx[cm], COPy[cm], got "
        f"{', '.join(names[:6])}; name them so"
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


@dataclass(frozen=True, slots=True, kw_only=True)
class WornRow:
    """Pitch error in a captured motion."""

    trial: str  # Which capture
    level: str  # none, static or full correction
    error_rms_deg: float  # Over the motion
    error_max_deg: float
    lean_optics_deg: float  # Largest pitch less the first, by the optics
    lean_device_deg: float  # As above, by the device
    length_s: float  # Of the motion
    saturated: float  # Share of the samples in which the gyroscopes were at the end of their range


@dataclass(frozen=True, slots=True, kw_only=True)
class Worn:
    """Errors in captured motions and agreement over them."""

    rows: tuple[WornRow, ...]  # By capture, then level
    # Of the largest lean, device less optics, for each level; empty with fewer than three captures
    agreement: tuple[tuple[str, Pairwise], ...]


def worn_in(
    captures: tuple[CapturedTrial, ...], device: DeviceModel | None = None, *, seed: int = 0, excursion_k: float = 12.5
) -> Worn:
    """Wear a device in captured motions, at a board temperature above the bench's."""
    worn = device or preset("enc03j_3031")
    levels = calibrated(worn, rng=np.random.default_rng([seed, 0]))
    rows = []
    for number, capture in enumerate(captures):
        spline = fit_pose_spline(capture.device, SKIN)
        start, stop, turned, moved = spline.pieces[0]  # up to the first long gap
        length_s = int((stop - start) * SAMPLE_RATE_HZ) / SAMPLE_RATE_HZ
        first = replace(spline, pieces=((start, start + length_s, turned, moved),))
        task = RecordedTask(spline=first, moving_s=(REST_S, REST_S + length_s), held_s=REST_S)
        rng, temp_c = np.random.default_rng([seed, 1, number]), ROOM_TEMP_C + excursion_k
        case, saturated = wear(worn, task, rng=rng, temp_c=temp_c, power_on_s=SETTLED_S)
        moving = slice(*case.moving)
        seen = case.pitch_now[moving] / RADIAN_PER_DEGREE
        for level, calibration in zip(LEVELS, levels, strict=True):
            error = pitch_error(case, calibration) / RADIAN_PER_DEGREE
            shown = case.pitch[moving] / RADIAN_PER_DEGREE + error
            rows.append(
                WornRow(
                    trial=capture.name,
                    level=level,
                    error_rms_deg=float(np.sqrt(np.nanmean(error**2))),
                    error_max_deg=float(np.nanmax(np.abs(error))),
                    lean_optics_deg=float(np.nanmax(seen) - seen[0]),
                    lean_device_deg=float(np.nanmax(shown) - shown[0]),
                    length_s=length_s,
                    saturated=saturated,
                )
            )
    agreed = []
    for level in LEVELS:
        leans = np.array([(row.lean_device_deg, row.lean_optics_deg) for row in rows if row.level == level])
        if (pairwise := agreement_of("largest lean, deg", *leans.reshape(-1, 2).T)) is not None:
            agreed.append((level, pairwise))
    return Worn(rows=tuple(rows), agreement=tuple(agreed))


# ---- real.toml

Given = TypeVar("Given")


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class TrialEntry:
    """[[trial]]."""

    recording: str  # Readings of the device
    device: str  # Which
    map: str | None = None  # Columns, units and sample rate of a foreign recording, a file as for --map
    reference: str | None = None  # Poses; None where the recording is a BROAD file
    markers: tuple[str, ...] = ()  # As of a capture
    up: Literal["y", "z"] | None = None


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureEntry(Posed):
    """[[capture]]."""

    file: str  # Poses or markers
    task: Captured  # sit_to_stand, squat or stairs
    category: CategoryName = DEFAULT  # Of the person


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class StanceEntry:
    """[[stance]]."""

    file: str  # Table of a force plate
    mass_kg: Annotated[float, Gt(0.0)]  # Of the person
    condition: Condition  # Eyes and surface
    category: CategoryName = DEFAULT  # Of the person


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class ActualEntry:
    """[actual]."""

    device: str  # device.json of a twin
    warm_up: str  # Recording at rest over temperature
    map: str | None = None  # Its columns and units, a file as for --map
    kind: str  # Preset of the simulated device
    room_c: float  # Of the bench, degC
    set_points_c: Annotated[tuple[float, ...], MinLen(2)]  # Of the chamber, degC


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class RealFile:
    """The whole file."""

    actual: ActualEntry | None = None  # Figure 3's actual device; any of the four may be left out
    trial: tuple[TrialEntry, ...] = ()
    capture: tuple[CaptureEntry, ...] = ()
    stance: tuple[StanceEntry, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ActualTwin:
    """A twin of a real device for Figure 3."""

    device: DeviceModel  # With offsets over temperature
    model: DeviceModel  # Typical unit of its kind
    climate: Climate  # In which both are calibrated and worn
    range_c: tuple[float, float]  # Of the recording over temperature, degC


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RealData:
    """Real recordings, read."""

    devices: tuple[DeviceTrials, ...]  # Trials by device
    captures: tuple[CapturedTrial, ...]  # Captured people
    stances: tuple[Stance, ...]  # On a force plate
    actual: ActualTwin | None = None  # Figure 3's actual device


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RealOutcome:
    """Real recordings, judged."""

    # Levels none, rest, calibrated, the converter's rounding undone and left in; empty without trials
    errors: tuple[RealErrors, ...]
    motions: tuple[CohortComparison, ...]  # Captures and stances beside the cohort
    sways: tuple[CohortComparison, ...]
    worn: Worn | None  # The study's device worn in the captures
    lacks: tuple[Finding, ...]  # What is missing, and why
    figure3: Figure3 | None = None  # With the twin as actual device


def read_real(path: str | Path) -> RealData:
    """Read all recordings that a file names."""
    held, folder = read(RealFile, path), Path(path).parent
    if not (held.trial or held.capture or held.stance or held.actual):
        raise FileFormatError(
            f"{path}: wanted a [[trial]], a [[capture]], a [[stance]] or [actual], got none; name a recording"
        )
    try:
        return RealData(
            devices=_devices(held.trial, folder),
            captures=tuple(_capture(entry, folder) for entry in held.capture),
            stances=tuple(
                read_stance(folder / one.file, mass_kg=one.mass_kg, condition=one.condition, category=one.category)
                for one in held.stance
            ),
            actual=None if held.actual is None else _actual(held.actual, folder),
        )
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _actual(entry: ActualEntry, folder: Path) -> ActualTwin:
    columns, settings = (None, None) if entry.map is None else read_map(folder / entry.map)
    found = fit_warm_up(read_record(folder / entry.warm_up, columns, settings=settings), reference_c=entry.room_c)
    climate = Climate(room_c=entry.room_c, set_points_c=entry.set_points_c)
    (low, high), asked = found.range_c, (entry.room_c, *entry.set_points_c)
    if min(asked) < low or max(asked) > high:
        raise InputError(
            f"{entry.warm_up}: wanted room_c and set_points_c within its {low:.1f} to {high:.1f} degC, got {min(asked):g} to "
            f"{max(asked):g}; change them"
        )
    device = with_warm_up(read_device(folder / entry.device), found)
    return ActualTwin(device=device, model=preset(entry.kind), climate=climate, range_c=found.range_c)


def _worn_by_twin(twin: ActualTwin, *, seed: int, excursion_k: float) -> Figure3:
    hottest, high = twin.climate.room_c + excursion_k, twin.range_c[1]
    if hottest > high:
        raise InputError(f"wanted the trial within {high:.1f} degC of the warm-up, got {hottest:g}; lower room_c")
    return figure3(twin.model, actual=twin.device, climate=twin.climate, seed=seed, excursion_k=excursion_k)


def _devices(entries: tuple[TrialEntry, ...], folder: Path) -> tuple[DeviceTrials, ...]:
    devices = []
    for name in dict.fromkeys(entry.device for entry in entries):
        own = [entry for entry in entries if entry.device == name]
        if len(own) < 2:
            raise InputError(
                f"trial: wanted two or more of each device, got one of '{name}'; a fit that judges a trial must come from others"
            )
        names = tuple(Path(entry.recording).name.split(".")[0] for entry in own)
        devices.append(DeviceTrials(device=name, names=names, pairs=tuple(_pair(entry, folder) for entry in own)))
    return tuple(devices)


def _pair(entry: TrialEntry, folder: Path) -> tuple[Record, Reference]:
    recording = folder / entry.recording
    if entry.reference is None and detect(recording) != "broad":
        raise InputError(f"{recording}: wanted a reference, got none and no BROAD file, which holds its own; name one")
    poses = recording if entry.reference is None else folder / entry.reference
    columns, settings = (None, None) if entry.map is None else read_map(folder / entry.map)
    reference = read_reference(poses, labels=entry.markers or None, up=entry.up)
    return read_record(recording, columns, settings=settings), reference


def _capture(entry: CaptureEntry, folder: Path) -> CapturedTrial:
    poses = read_poses(folder / entry.file, entry)
    if poses.position is None:
        raise InputError(f"{entry.file}: wanted poses with positions, got none; risings are found by the height")
    name = Path(entry.file).name.split(".")[0]
    return CapturedTrial(name=name, task=entry.task, device=poses, category=entry.category)


def judge_real(data: RealData, study: Study) -> RealOutcome:
    """Judge real recordings as the study judges its own."""
    lacks: list[Finding] = []

    def judged(part: str, given: Sequence[object], judge: Callable[[], Given]) -> Given | None:
        made, lack = tried(part, judge) if given else (None, finding("study.none_given", "info", part=part))
        lacks.extend([lack] if lack else [])
        return made

    def counted(part: str, given: int, unit: str) -> None:
        numbers = {"wanted": agreement.LEAST_FOR_AGREEMENT, "unit": unit, "given": given}
        lacks.append(finding("study.too_few_for_agreement", "info", part=part, **numbers))

    captures, stances, unit, seed = data.captures, data.stances, typical_unit(study), study.seed
    warmer, people, group = sum(study.excursion_k) / 2.0, min(study.subjects, 30), study.group
    errors = judged("trials beside optics", data.devices, lambda: real_errors(data.devices))
    if errors and errors[0].agreement is None:
        counted("agreement over trials", len(errors[0].trials), "trials ")
    rows = partial(motion_rows, captures, subjects=people, seed=seed, group=group)
    motions = judged("captured motions", captures, rows)
    worn_by = partial(worn_in, captures, unit, seed=seed, excursion_k=warmer)
    worn = judged("device worn in captured motions", captures, worn_by)
    if worn is not None and not worn.agreement:
        counted("agreement over captures", len(captures), "")
    sways = judged("stances", stances, lambda: sway_rows(stances, subjects=people, seed=seed))
    twin = None
    if (actual := data.actual) is not None:
        twin = judged("Figure 3 with a twin", (actual,), lambda: _worn_by_twin(actual, seed=seed, excursion_k=warmer))
    return RealOutcome(
        errors=errors or (), motions=motions or (), sways=sways or (), worn=worn, lacks=tuple(lacks), figure3=twin
    )


def tried(part: str, make: Callable[[], Given]) -> tuple[Given | None, Finding | None]:
    """Return what is made, or why not: this device cannot be calibrated so, and the study's own figures stand."""
    try:
        return make(), None
    except UndriftError as error:
        return None, finding("study.part_failed", "info", part=part, reason=str(error))
