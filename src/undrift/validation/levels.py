"""Levels of correction: error of each level against a reference, over trials, people and tasks.

    uncalibrated        raw readings
    constants           offset and matrix at a fixed temperature
    static table        constants, with the offset over temperature
    all tables          static table, with matrix and dynamic error over temperature
    rest                constants, minus the offset of the rest before the motion (without a chamber)
    all tables, rest    all tables, minus that offset
    motion              the whole calibration, minus the offset that gravity determines during the motion

The error of a trial is the root mean square over its motion: of the pitch if every trial has one throughout, otherwise of the total
angle. Errors are averaged by person, since repeated trials of a person are not independent. The mean over people has Student's 95 %
interval. Each level is compared with the level above it over the same people (validation/agreement.py).

Agreement is on one measure of a trial, its range of pitch, or its mean inclination if pitch is not defined throughout: one mean per
person, from ten people on. ICC(2,1) is reported separately for each task, because differences between tasks would inflate it.

Each trial can include a simulated device, which is calibrated like the real device and follows the motion of the reference.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.reference import align
from undrift.correction.correct import correct_whole
from undrift.errors import InputError, UndriftError
from undrift.findings import Finding
from undrift.frames import integrate_strapdown, quaternion_conjugate, rotate
from undrift.model import BodyMounting, Calibration
from undrift.record import Record, Reference
from undrift.sim.device.effects import rounded
from undrift.sim.motion.poses import PoseSettings, fit_pose_spline
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
from undrift.validation.trial import OffsetChoice, Trial, TrialSettings, check_scale, orientation_at, validate_trial

Method = Literal["strapdown", "vqf"]
Pair = tuple[Record, Reference]
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
    """Return the calibration that a level uses, or None for raw readings.

    Raises
    ------
    InputError
        If the calibration lacks a part that the level requires.
    """
    if level.tables == "no calibration" or (calibration is None and level.offset != "none"):
        if level.tables == "all":
            raise InputError("no calibration with tables was given")
        return None
    if calibration is None:
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
    level: Level, record: Record, reference: Reference, calibration: Calibration | None, settings: TrialSettings
) -> Trial | str:
    """Return a trial judged at one level of correction, or the reason why it cannot be."""
    try:
        chosen = calibration_at(level, calibration)
        trial = validate_trial(
            record, reference, calibration=chosen, settings=replace(settings, offset=level.offset), name=level.name
        )
        check_scale(trial)
    except UndriftError as error:
        return str(error)
    return "the recording has no rest" if level.offset == "rest" and trial.rest is None else trial


# ---- trials of people


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelTrial:
    """One recording with its reference, and whose it is."""

    recording: str
    record: Record
    reference: Reference
    calibration: Calibration | None = None
    person: str = ""  # empty: a person of its own
    task: str = ""
    device: str = ""
    cluster: bool = False  # the reference is a cluster of markers, which is levelled at rest
    mounting: BodyMounting | None = None  # how the device is worn
    simulated: Pair | None = None  # readings and reference of a simulated device in this motion
    left_out: bool = False  # the calibration was fitted to other recordings, its offset to the rest of this one


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelErrors:
    """Errors of T trials at a level of correction, NaN for a trial that cannot be evaluated."""

    level: str
    method: Method
    error_deg: FloatArray  # (T,), root mean square over the motion
    end_deg: FloatArray  # (T,), total error after the motion
    measure_deg: FloatArray  # (T, 2), measure of the agreement by the device and by the reference
    simulated_deg: FloatArray  # (T,), error of the simulated device
    difference_deg: FloatArray  # (T,), largest difference between the errors of both devices over the motion
    findings: tuple[tuple[str, Finding], ...]  # warnings, each with its recording
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
    median_deg: float  # over trials
    previous: str  # level with which ``decision`` compares (empty: no comparison)
    decision: PairedDifference | None  # None with fewer than three people
    agreement: BlandAltman | None  # device minus reference over people, or None with fewer than ten
    icc: IntraclassCorrelation | None  # ICC(2,1) over people, or None (also over several tasks)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelTable:
    """Trials judged at each level of correction."""

    trials: tuple[LevelTrial, ...]
    quantity: str  # "pitch" or "total"
    measure: str  # of the agreement
    margin_deg: float  # smallest difference that matters
    errors: tuple[LevelErrors, ...]  # one for each level and method
    summaries: tuple[LevelSummary, ...]


def judge_levels(
    trials: Sequence[LevelTrial],
    *,
    settings: TrialSettings = TrialSettings(),
    margin_deg: float = NOTE_DIFFERENCE_DEG,
    methods: Sequence[Method] = ("strapdown",),
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> LevelTable:
    """Judge trials at each level of correction.

    Parameters
    ----------
    trials : sequence of LevelTrial
        Recordings with their references, calibrations and people.
    settings : TrialSettings
        Settings of ``validate_trial``, without ``offset``, which the level decides.
    margin_deg : float
        Smallest difference that matters, deg.
    methods : sequence of str
        "strapdown", "vqf", or both.
    progress : callable
        Called with the work and its share, 0 to 1.

    Returns
    -------
    LevelTable
        Errors by trial, and summaries over all trials, by task and by device.

    Raises
    ------
    InputError
        No trial can be judged at any level.
    """
    steps = list(product(methods, LEVELS))
    judged = list[tuple[Level, Method, list[Trial | str], list[Trial | str]]]()
    for number, (method, level) in enumerate(steps):
        progress(f"level of correction: {level.name}", number / len(steps))
        actual, simulated = list[Trial | str](), list[Trial | str]()
        for trial in trials:
            trial_settings = replace(
                settings,
                method=method,
                mounting=trial.mounting,
                align="level" if trial.cluster else settings.align,
            )
            step = replace(level, offset="none") if trial.left_out and level.offset == "rest" else level
            actual.append(judge_level(step, trial.record, trial.reference, trial.calibration, trial_settings))
            pair = trial.simulated
            simulated.append("" if pair is None else judge_level(step, *pair, trial.calibration, trial_settings))
        judged.append((level, method, actual, simulated))
    figures = [trial.figures for *_, actual, _ in judged for trial in actual if isinstance(trial, Trial)]
    if not figures:
        raise InputError(f"validate: no trial can be judged: {judged[0][2][0] if trials else 'there is none'}")
    quantity = "pitch" if all(one.pitch_defined == 1.0 for one in figures) else "total"
    names = [trial.recording for trial in trials]
    errors = tuple(
        _errors(level, method, actual, simulated, names, quantity) for level, method, actual, simulated in judged
    )
    return LevelTable(
        trials=tuple(trials),
        quantity=quantity,
        measure="range of pitch" if quantity == "pitch" else "mean inclination",
        margin_deg=margin_deg,
        errors=errors,
        summaries=tuple(_summaries(trials, errors, margin_deg)),
    )


def calibrate_by_others(trials: Sequence[LevelTrial], settings: TrialSettings = TrialSettings()) -> list[LevelTrial]:
    """Return trials in which each device without a calibration has one, fitted to the references of its other recordings.

    A device whose fit fails, or that has one recording only, stays without a calibration.
    """
    result = list(trials)
    for device in dict.fromkeys(trial.device for trial in trials):
        places = [n for n, trial in enumerate(trials) if trial.device == device and trial.calibration is None]
        if len(places) < 2:
            continue
        with suppress(UndriftError):
            fits, _ = calibrations_by_others(
                [(trials[n].record, trials[n].reference) for n in places], settings=settings
            )
            for n, calibration in zip(places, fits, strict=True):
                result[n] = replace(trials[n], calibration=calibration, left_out=True)
    return result


def _errors(
    level: Level,
    method: Method,
    actual: list[Trial | str],
    simulated: list[Trial | str],
    names: Sequence[str],
    quantity: str,
) -> LevelErrors:
    def column(trials: list[Trial | str], name: str) -> FloatArray:
        return np.array([getattr(trial.figures, name) if isinstance(trial, Trial) else np.nan for trial in trials])

    reasons = [trial for trial in actual if isinstance(trial, str)]
    judged = [(name, trial) for name, trial in zip(names, actual, strict=True) if isinstance(trial, Trial)]
    measures = [_measure_deg(trial, quantity) if isinstance(trial, Trial) else (np.nan, np.nan) for trial in actual]
    differences = [_difference_deg(*pair, quantity) for pair in zip(actual, simulated, strict=True)]
    return LevelErrors(
        level=level.name,
        method=method,
        error_deg=column(actual, f"rmse_{quantity}_deg"),
        end_deg=column(actual, "end_total_deg"),
        measure_deg=np.array(measures),
        simulated_deg=column(simulated, f"rmse_{quantity}_deg"),
        difference_deg=np.array(differences),
        findings=tuple((name, item) for name, trial in judged for item in trial.findings if item.level != "info"),
        missing=f"missing in {len(reasons)} of {len(actual)} trials: {reasons[0]}" if reasons else "",
    )


def _measure_deg(trial: Trial, quantity: str) -> tuple[float, float]:
    """Return the measure of a trial by the device and by the reference, deg, over the same samples."""
    if quantity == "total":
        device, reference = trial.mean_inclination
        return device / RADIAN_PER_DEGREE, reference / RADIAN_PER_DEGREE
    valid = (trial.moving > 0.0) & np.isfinite(trial.sensor_pitch) & np.isfinite(trial.reference_pitch)
    device, reference = (float(np.ptp(pitch[valid])) for pitch in (trial.sensor_pitch, trial.reference_pitch))
    return device / RADIAN_PER_DEGREE, reference / RADIAN_PER_DEGREE


def _difference_deg(actual: Trial | str, simulated: Trial | str, quantity: str) -> float:
    """Return the largest difference between the errors of the actual and the simulated device over the motion, deg."""
    if isinstance(actual, str) or isinstance(simulated, str):
        return float("nan")
    other = np.interp(actual.time, simulated.time, getattr(simulated.error, quantity))
    difference = np.abs(getattr(actual.error, quantity) - other)[actual.moving > 0.0]
    return float(np.nanmax(difference)) / RADIAN_PER_DEGREE


# ---- summaries over people


def _summaries(
    trials: Sequence[LevelTrial], errors: Sequence[LevelErrors], margin_deg: float
) -> Iterator[LevelSummary]:
    """Yield each level over all trials, and over each task and device if there are several."""
    groups = {"all": np.ones(len(trials), bool)}
    for kind, prefix in (("task", ""), ("device", "device ")):
        names = list(dict.fromkeys(getattr(trial, kind) for trial in trials))
        if len(names) > 1:
            groups |= {f"{prefix}{name}": np.array([getattr(t, kind) == name for t in trials]) for name in names}
    for group, inside in groups.items():
        previous: LevelErrors | None = None
        for row in errors:
            if previous is not None and previous.method != row.method:
                previous = None
            summary = _summary(group, trials, inside, row, previous, margin_deg)
            yield summary
            if summary.people:
                previous = row


def _summary(
    group: str,
    trials: Sequence[LevelTrial],
    inside: BoolArray,
    row: LevelErrors,
    previous: LevelErrors | None,
    margin_deg: float,
) -> LevelSummary:
    people = np.array([trial.person or f"\0{number}" for number, trial in enumerate(trials)])
    judged = inside & np.isfinite(row.error_deg)
    person_means = _means_by_person(row.error_deg, judged, people)
    mean, interval = mean_interval(person_means)
    decision = None
    if previous is not None:
        both = judged & np.isfinite(previous.error_deg)
        pair = [_means_by_person(values, both, people) for values in (row.error_deg, previous.error_deg)]
        if len(pair[0]) >= MIN_PEOPLE:
            decision = decide_between(*pair, margin=margin_deg, tests=len(LEVELS) - 1)
    measured = judged & np.isfinite(row.measure_deg).all(axis=1)
    device, reference = (_means_by_person(values, measured, people) for values in row.measure_deg.T)
    enough = len(device) >= MIN_PEOPLE_FOR_AGREEMENT
    tasks = {trial.task for trial, chosen in zip(trials, judged, strict=True) if chosen}
    ratings = np.column_stack((device, reference))
    return LevelSummary(
        group=group,
        level=row.level,
        method=row.method,
        trials=int(judged.sum()),
        people=len(person_means),
        mean_deg=mean,
        interval_deg=interval,
        median_deg=float(np.median(row.error_deg[judged])) if judged.any() else float("nan"),
        previous="" if previous is None or decision is None else previous.level,
        decision=decision,
        agreement=bland_altman(device, reference) if enough else None,
        icc=intraclass_correlation(ratings) if enough and len(tasks) == 1 else None,
    )


def _means_by_person(
    values: FloatArray, chosen: BoolArray, people: "np.ndarray[tuple[int], np.dtype[np.str_]]"
) -> FloatArray:
    return np.array([values[chosen & (people == person)].mean() for person in dict.fromkeys(people[chosen].tolist())])


# ---- the simulated device in the motion of a real trial

INVERSION_ROUNDS = 6
POSE_CUTOFF_HZ, POSITION_CUTOFF_HZ = 20.0, 10.0
MAX_CUTOFF_SHARE = 0.4  # of the rate of the poses


def simulate_trial_of(
    record: Record, reference: Reference, calibration: Calibration, *, mounting: FloatArray, rng: np.random.Generator
) -> Pair:
    """Return simulated readings of the calibration's device in the motion of the reference, and their reference.

    The readings u solve ``correct(u) = true rate and force`` by u <- u + M^-1 (true - correct(u)). Noise as in the rest of the
    recording and the steps of the codes are then added. ``mounting`` (3, 3) turns the case to the body of the reference. Before and
    after the motion, and in gaps of the poses, the motion is taken from the corrected real readings.
    """
    done = align(correct_whole(record, calibration, policy="hold").record.in_si(), reference)
    poses, time, span = done.reference, done.record.time, done.span
    highest_hz = MAX_CUTOFF_SHARE * poses.sample_rate_hz
    cutoffs = PoseSettings(
        cutoff_hz=min(POSE_CUTOFF_HZ, highest_hz), position_cutoff_hz=min(POSITION_CUTOFF_HZ, highest_hz)
    )
    # a reading is the mean over the step before its stamp
    shifted = time - (done.lag.seconds - 0.5 / done.record.sample_rate_hz)
    motion = fit_pose_spline(poses, cutoffs).at(shifted, calibration.gravity_m_s2)
    inside = (time >= span.start_s) & (time < span.stop_s)
    is_known = motion.valid > 0.0
    first = int(np.argmax(is_known & inside))
    rate = np.nan_to_num(np.where(is_known[:, None], motion.mean_rate_b, done.gyro @ mounting.T)) * inside[:, None]
    rate[: first + 1] = 0.0
    q_nb = integrate_strapdown(rate, time, motion.q_nb[first])
    force_n = rotate(motion.q_nb, motion.force_b)
    force_n[~(np.isfinite(force_n).all(axis=1) & inside)] = (0.0, 0.0, calibration.gravity_m_s2)
    force = rotate(quaternion_conjugate(q_nb), force_n) @ mounting
    raw = record.between(float(time[0]), float(time[-1]) + 0.5 / record.sample_rate_hz)
    readings = _invert(raw, calibration, rate @ mounting, force, rng, stop_s=span.start_s if span.rested else None)
    q_seen = np.where(poses.valid[:, None], orientation_at(shifted, q_nb, poses.time), np.nan)
    return readings, replace(poses, q_nb=q_seen)


def _invert(
    raw: Record,
    calibration: Calibration,
    rate: FloatArray,
    force: FloatArray,
    rng: np.random.Generator,
    *,
    stop_s: float | None,
) -> Record:
    """Return the readings that a calibration corrects to a rate and a specific force, (N, 3) SI each."""
    exact = replace(calibration, adc=None)
    record = replace(
        raw, state="raw", gyro=np.zeros_like(rate), accel=None if raw.accel is None else np.zeros_like(force)
    )
    for _ in range(INVERSION_ROUNDS):
        corrected = correct_whole(record, exact, policy="hold").record.in_si()
        changed: dict[str, Any] = {}
        for triad, true in zip(calibration.triads, (rate, force), strict=True):
            reading = getattr(record, triad.sensor)
            if triad.model is not None and reading is not None:
                missing = true - np.asarray(getattr(corrected, triad.sensor))
                changed[triad.sensor] = reading + missing @ (triad.model.forward_matrix / triad.si).T
        record = replace(record, **changed)
    before = raw.time < (raw.time[0] if stop_s is None else stop_s)
    noisy: dict[str, Any] = {}
    for triad in calibration.triads:
        reading, real = getattr(record, triad.sensor), getattr(raw, triad.sensor)
        if triad.model is None or reading is None:
            continue
        if before.sum() > 2:  # by differences of neighbours: a person at rest sways
            noise = np.nanstd(np.diff(real[before], axis=0), axis=0) / np.sqrt(2.0)
            reading = reading + noise * rng.standard_normal(reading.shape)
        step = np.full(3, float(triad.model.unit_in == "count")) if triad.lsb is None else triad.lsb
        steps = np.where(step > 0.0, step, 1.0)
        noisy[triad.sensor] = np.where(step > 0.0, rounded(reading / steps, triad.rounding) * steps, reading)
    return replace(record, **noisy)
