"""Levels of correction: error of each level against a reference, over trials, people and tasks.

    uncalibrated        raw readings
    constants           offset and matrix at a fixed temperature
    static table        constants, with the offset over temperature
    all tables          static table, with matrix and dynamic error over temperature
    rest                constants, minus the offset of the rest before the motion (without a chamber)
    all tables, rest    all tables, minus that offset
    motion              the whole calibration, minus the offset that gravity determines during the motion

The error of a trial is the root mean square over its motion. It is the pitch error if every trial has a pitch throughout, otherwise
the error of the total angle. Errors are averaged by person, since repeated trials of a person are not independent. The mean over
people has Student's 95 % interval. Each level is compared with the level above it, over the same people (validation/agreement.py).

Agreement is computed for the range of pitch of a trial, with one mean per person, if there are ten people or more. ICC(2,1) is
reported separately for each task, because differences between tasks would inflate it.

The simulated device has exactly the errors that its calibration describes. In the motion of a trial, its error at a level is the
difference between the orientation at that level and the orientation with the whole calibration. If the actual error differs, the
device has an error that the calibration does not describe (the note's Figure 3).
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import InputError, UndriftError
from undrift.findings import Finding
from undrift.model import BodyMounting, Calibration
from undrift.record import Record, Reference
from undrift.sync import Clocks
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.agreement import (
    MIN_PEOPLE,
    MIN_PEOPLE_FOR_AGREEMENT,
    BlandAltman,
    IntraclassCorrelation,
    PairedDifference,
    bland_altman,
    calibrations_by_others,
    decide_between,
    intraclass_correlation,
    mean_interval,
)
from undrift.validation.trial import (
    OffsetChoice,
    Trial,
    TrialSettings,
    compare_orientations,
    rms,
    validate_trial,
)

Method = Literal["strapdown", "vqf"]
NOTE_DIFFERENCE_DEG = 0.15  # largest difference between simulated and actual device in the note's Figure 3

# ---- the levels

Tables = Literal["no calibration", "none", "static", "all", "any"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """One step of a correction."""

    name: str
    tables: Tables  # tables of the calibration that are used ("any": all available tables)
    offset: OffsetChoice


LEVELS = (
    Level(name="uncalibrated", tables="no calibration", offset="none"),
    Level(name="constants", tables="none", offset="none"),
    Level(name="static table", tables="static", offset="none"),
    Level(name="all tables", tables="all", offset="none"),
    Level(name="rest", tables="none", offset="rest"),
    Level(name="all tables, rest", tables="all", offset="rest"),
    Level(name="motion", tables="any", offset="motion"),
)
LEVEL_NAMES = tuple(level.name for level in LEVELS)


def calibration_at(level: Level, calibration: Calibration | None) -> Calibration | None:
    """Return the calibration that a level uses, or None for raw readings. Raise InputError if a required part is missing."""
    if level.tables == "no calibration":
        return None
    if calibration is None:
        if level.offset != "none" and level.tables != "all":
            return None
        raise InputError("no calibration was given")
    drift = calibration.drift
    if level.tables == "none":
        return replace(calibration, drift=None)
    if level.tables == "any":
        return calibration
    if drift is None or drift.static is None:
        raise InputError("the calibration has no static table")
    if level.tables == "static":
        return replace(calibration, drift=replace(drift, scale=None, dynamic=None))
    if drift.scale is None and drift.dynamic is None:
        raise InputError("the calibration has neither a scale table nor a dynamic table")
    return calibration


def judge_level(
    level: Level,
    record: Record,
    reference: Reference,
    calibration: Calibration | None,
    settings: TrialSettings,
    clocks: Clocks | None = None,
) -> Trial | str:
    """Return a trial judged at one level of correction, or the reason why it cannot be."""
    try:
        trial = validate_trial(
            record,
            reference,
            calibration=calibration_at(level, calibration),
            settings=replace(settings, offset=level.offset),
            name=level.name,
            clocks=clocks,
        )
    except UndriftError as error:
        return str(error)
    return "the recording has no rest" if level.offset == "rest" and trial.rest is None else trial


Judged = dict[tuple[Method, str], list[Trial | str]]  # by method and level, one for each trial

# ---- trials of people


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelTrial:
    """One recording with its reference and its person."""

    recording: str
    record: Record
    reference: Reference
    calibration: Calibration | None = None
    person: str = ""  # empty: a separate person
    task: str = ""
    device: str = ""
    cluster: bool = False  # True if the reference is a cluster of markers, which is levelled at rest
    mounting: BodyMounting | None = None  # orientation of the device on the body segment
    left_out: bool = False  # True if the calibration is from other recordings, with the offset of this one's rest
    clocks: Clocks | None = None  # clocks from an earlier comparison


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelErrors:
    """Errors of T trials at a level of correction, NaN for a trial that cannot be evaluated."""

    level: str
    method: Method
    error_deg: FloatArray  # (T,), root-mean-square error over the motion
    measure_deg: FloatArray  # (T, 2), range of pitch from the device and from the reference
    simulated_deg: FloatArray  # (T,), error of the simulated device
    difference_deg: FloatArray  # (T,), largest difference between the errors of both devices over the motion
    findings: tuple[tuple[str, Finding], ...]  # warnings, each with the name of its recording
    missing: str  # number of trials that cannot be evaluated, and the first reason (empty if all can)


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelSummary:
    """One level over the trials of a task, of a device, or over all trials."""

    group: str  # "all", the name of a task, or "device ..."
    level: str
    method: Method
    trials: int
    people: int
    mean_deg: float  # over people
    interval_deg: tuple[float, float]  # 95 %
    previous: str  # level with which ``decision`` compares (empty: no comparison)
    decision: PairedDifference | None  # None with fewer than three people
    agreement: BlandAltman | None  # device minus reference over people, or None with fewer than ten people
    icc: IntraclassCorrelation | None  # ICC(2,1) over people, or None (also over several tasks)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelTable:
    """Trials judged at each level of correction."""

    trials: tuple[LevelTrial, ...]
    quantity: str  # "pitch" or "total"
    margin_deg: float  # smallest difference that matters
    errors: tuple[LevelErrors, ...]  # one per level and method
    summaries: tuple[LevelSummary, ...]


def judge_levels(
    trials: Sequence[LevelTrial],
    *,
    settings: TrialSettings = TrialSettings(),
    methods: Sequence[Method] = ("strapdown",),
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> LevelTable:
    """Judge trials at each level of correction with one or both methods. The level determines the offset that is subtracted.

    Raise InputError if no trial can be judged at any level.
    """
    clocks, judged = [trial.clocks for trial in trials], Judged()
    for number, (method, level) in enumerate(product(methods, LEVELS)):
        progress(f"level of correction: {level.name}", number / (len(methods) * len(LEVELS)))
        row = judged[method, level.name] = []
        for k, trial in enumerate(trials):
            align = "level" if trial.cluster else settings.align
            own_settings = replace(settings, method=method, mounting=trial.mounting, align=align)
            step = replace(level, offset="none") if trial.left_out and level.offset == "rest" else level
            result = judge_level(step, trial.record, trial.reference, trial.calibration, own_settings, clocks[k])
            clocks[k] = clocks[k] or (result.clocks if isinstance(result, Trial) else None)
            row.append(result)
    figures = [result.figures for row in judged.values() for result in row if isinstance(result, Trial)]
    if not figures:
        reason = judged[methods[0], LEVEL_NAMES[0]][0] if trials else "there is none"
        raise InputError(f"validate: no trial can be judged: {reason}")
    quantity = "pitch" if all(errors.pitch_defined == 1.0 for errors in figures) else "total"
    errors = [_errors(level, method, trials, judged, quantity, settings) for method, level in product(methods, LEVELS)]
    return LevelTable(
        trials=tuple(trials),
        quantity=quantity,
        margin_deg=NOTE_DIFFERENCE_DEG,
        errors=tuple(errors),
        summaries=tuple(_summaries(trials, errors)),
    )


def calibrate_by_others(trials: Sequence[LevelTrial], settings: TrialSettings = TrialSettings()) -> list[LevelTrial]:
    """Return trials in which each device without a calibration has one, fitted to the references of its other recordings.

    A device whose fit fails, or that has only one recording, remains without a calibration.
    """
    result = list(trials)
    for device in dict.fromkeys(trial.device for trial in trials):
        places = [n for n, trial in enumerate(trials) if trial.device == device and trial.calibration is None]
        if len(places) < 2:
            continue
        with suppress(UndriftError):
            pairs = [(trials[n].record, trials[n].reference) for n in places]
            for n, calibration in zip(places, calibrations_by_others(pairs, settings=settings)[0], strict=True):
                result[n] = replace(trials[n], calibration=calibration, left_out=True)
    return result


# ---- one level over all trials


def _by_whole_calibration(judged: Judged, level: Level, method: Method, k: int) -> Trial | None:
    """Return trial k corrected with its whole calibration, or None if the level already uses the whole calibration."""
    for other in reversed(LEVELS):
        result = judged[method, other.name][k]
        if other.offset == level.offset and other.tables != "no calibration" and isinstance(result, Trial):
            return None if other == level else result
    return None


def _errors(
    level: Level,
    method: Method,
    trials: Sequence[LevelTrial],
    judged: Judged,
    quantity: str,
    settings: TrialSettings,
) -> LevelErrors:
    row = judged[method, level.name]
    count = len(trials)
    error_deg, simulated_deg, difference_deg = (np.full(count, np.nan) for _ in range(3))
    measure_deg = np.full((count, 2), np.nan)
    findings = list[tuple[str, Finding]]()
    for k, trial in enumerate(row):
        if isinstance(trial, str):
            continue
        findings += [(trials[k].recording, item) for item in trial.findings if item.level != "info"]
        moving = trial.moving
        error_deg[k] = getattr(trial.figures, f"rmse_{quantity}_deg")
        if quantity == "pitch":
            pitches = np.stack((trial.sensor_pitch, trial.reference_pitch))[:, moving]
            measure_deg[k] = np.ptp(pitches[:, np.isfinite(pitches).all(axis=0)], axis=1) / RADIAN_PER_DEGREE
        whole = _by_whole_calibration(judged, level, method, k)
        if whole is not None:
            simulated = compare_orientations(trial.q_nb, whole.q_nb, forward=settings.forward, up=settings.up)
            actual, predicted = (getattr(error, quantity)[moving] for error in (trial.error, simulated))
            simulated_deg[k] = rms(predicted) / RADIAN_PER_DEGREE
            difference_deg[k] = np.nanmax(np.abs(actual - predicted)) / RADIAN_PER_DEGREE
    reasons = [trial for trial in row if isinstance(trial, str)]
    return LevelErrors(
        level=level.name,
        method=method,
        error_deg=error_deg,
        measure_deg=measure_deg,
        simulated_deg=simulated_deg,
        difference_deg=difference_deg,
        findings=tuple(findings),
        missing=f"missing in {len(reasons)} of {count} trials: {reasons[0]}" if reasons else "",
    )


# ---- summaries over people


def _summaries(trials: Sequence[LevelTrial], errors: Sequence[LevelErrors]) -> Iterator[LevelSummary]:
    """Yield each level over all trials, and over each task and device if there are several."""
    people = np.array([trial.person or f"\0{number}" for number, trial in enumerate(trials)])
    tasks, devices = np.array([trial.task for trial in trials]), np.array([trial.device for trial in trials])
    groups = {"all": np.ones(len(trials), bool)}
    for names, prefix in ((tasks, ""), (devices, "device ")):
        if len(set(names)) > 1:
            groups |= {f"{prefix}{name}": names == name for name in dict.fromkeys(names.tolist())}
    for group, inside in groups.items():
        previous: LevelErrors | None = None
        for row in errors:
            if previous is not None and previous.method != row.method:
                previous = None
            judged: BoolArray = inside & np.isfinite(row.error_deg)
            one_task = len(set(tasks[judged])) == 1
            yield _summary(group, row, previous, judged, people, one_task=one_task)
            if judged.any():
                previous = row


def _summary(
    group: str,
    row: LevelErrors,
    previous: LevelErrors | None,
    judged: BoolArray,
    people: "np.ndarray[tuple[int], np.dtype[np.str_]]",
    *,
    one_task: bool,
) -> LevelSummary:
    def means_by_person(values: FloatArray, chosen: BoolArray) -> FloatArray:
        names = dict.fromkeys(people[chosen].tolist())
        return np.array([values[chosen & (people == name)].mean(axis=0) for name in names])

    person_means = means_by_person(row.error_deg, judged)
    mean, interval = mean_interval(person_means)
    decision = None
    if previous is not None:
        both = judged & np.isfinite(previous.error_deg)
        pair = [means_by_person(errors.error_deg, both) for errors in (row, previous)]
        if len(pair[0]) >= MIN_PEOPLE:
            decision = decide_between(*pair, margin=NOTE_DIFFERENCE_DEG, tests=len(LEVELS) - 1)
    measures = means_by_person(row.measure_deg, judged & np.isfinite(row.measure_deg).all(axis=1))
    enough = len(measures) >= MIN_PEOPLE_FOR_AGREEMENT
    return LevelSummary(
        group=group,
        level=row.level,
        method=row.method,
        trials=int(judged.sum()),
        people=len(person_means),
        mean_deg=mean,
        interval_deg=interval,
        previous="" if previous is None or decision is None else previous.level,
        decision=decision,
        agreement=bland_altman(*measures.T) if enough else None,
        icc=intraclass_correlation(measures) if enough and one_task else None,
    )
