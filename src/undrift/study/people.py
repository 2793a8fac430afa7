"""A validation over people, tasks and devices: what each pipeline leaves beside optics, and whether it agrees with them.

A pipeline is a calibration, an offset and what makes the orientation. Of a device without a calibration each recording is corrected
by what its other recordings show. A trial's error is the root mean square over its motion; trials are averaged by person, and the
mean over people has Student's interval; the paired difference to readings as they come has the verdict of the study's three-sided
test. Agreement is on one measure of a trial, its range of pitch, or where pitch is not defined throughout its mean inclination:
Bland and Altman's limits, ICC(2,1), and equivalence by two one-sided tests of the mean difference of people.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.calibrate import calibrate_from_motion
from undrift.errors import InputError, UndriftError
from undrift.findings import Finding
from undrift.model import BodyMounting, Calibration
from undrift.study.statistics import Decision, decide_between, mean_interval
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.agreement import (
    LEAST_FOR_AGREEMENT,
    BlandAltman,
    IntraclassCorrelation,
    Pair,
    bland_altman,
    calibrations_by_others,
    intraclass_correlation,
)
from undrift.validation.trial import OffsetChoice, Trial, TrialSettings, check_scale, validate_trial

LEAST = 3  # people of a verdict
Source: TypeAlias = Literal["none", "constants", "tables", "best", "motion"]
Made: TypeAlias = Calibration | str | None  # or why there is none
Method: TypeAlias = Literal["strapdown", "vqf"]
Progress: TypeAlias = Callable[[str, float], None]
PIPELINES: tuple[tuple[str, Source, OffsetChoice], ...] = (
    ("as read", "none", "none"),
    ("rest offset", "none", "rest"),
    ("calibrated", "constants", "rest"),
    ("calibrated, tables", "tables", "rest"),
    ("calibrated, motion offset", "best", "motion"),
    ("motion alone", "motion", "motion"),
)
METHODS: tuple[Method, ...] = ("strapdown", "vqf")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PersonTrial:
    """One recording beside its reference, and whose it is."""

    recording: str
    person: str
    task: str
    device: str
    pair: Pair
    calibration: Calibration | None = None  # Of the device; None takes its other recordings
    cluster: bool = False  # The reference is a cluster of markers, whose axes mean nothing: levelled at rest
    mounting: BodyMounting | None = None  # How the device is worn: its readings are turned to the segment's axes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PipelineErrors:
    """Errors of T trials by one pipeline and method, deg; NaN where there is none."""

    pipeline: str
    method: Method
    total_deg: FloatArray  # (T,), rms over the motion
    inclination_deg: FloatArray
    pitch_deg: FloatArray
    end_deg: FloatArray  # After the motion
    measure: FloatArray  # (T, 2), by the sensor and by the optics, deg
    findings: tuple[tuple[str, Finding], ...]  # That warn or fail, each with its recording
    missing: str  # In how many trials, and why; empty where all have it


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """One pipeline over the trials of a task, of a device, or all."""

    of: str  # The task, "device ..." or "all"
    pipeline: str
    method: Method
    trials: int
    people: int
    mean_deg: float  # Of the judged error over people
    interval_deg: tuple[float, float]  # 95 %
    median_deg: float  # Over trials
    # Error of the same method as read less this one's, over people; None with fewer than three
    decision: Decision | None
    limits: BlandAltman | None  # Sensor less optics, over trials; None with fewer than three
    icc: IntraclassCorrelation | None  # ICC(2,1) of sensor and optics over trials
    equivalence: Decision | None  # Sensor against optics over people


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PeopleStudy:
    """A validation over people, tasks and devices."""

    trials: tuple[PersonTrial, ...]
    quantity: str  # Of the errors: pitch, or total
    measure: str  # Of the agreement
    margin_deg: float
    errors: tuple[PipelineErrors, ...]
    groups: tuple[Group, ...]


def study_people(
    trials: Sequence[PersonTrial],
    *,
    margin_deg: float,
    settings: TrialSettings = TrialSettings(),
    progress: Progress = lambda what, share: None,
) -> PeopleStudy:
    """Judge each trial by each pipeline and method, and sum up by task, by device and over all."""
    progress("calibrations", 0.0)
    sources, judged = _calibrations(trials, settings), list[tuple[str, Method, list[Trial | str]]]()
    for k, (pipeline, source, offset) in enumerate(PIPELINES):
        progress(pipeline, 0.4 + 0.6 * k / len(PIPELINES))
        for method in METHODS:
            how = replace(settings, offset=offset, method=method)
            each = [_judged(one, by, how) for one, by in zip(trials, sources[source], strict=True)]
            judged.append((pipeline, method, each))
    seen = [one for *_, each in judged for one in each if isinstance(one, Trial)]
    if not seen:
        raise InputError(f"validate: wanted one trial or more that can be judged, got none: {judged[0][2][0]}")
    by_pitch = all(one.figures.pitch_defined == 1.0 for one in seen)
    errors = tuple(_errors(pipeline, method, each, by_pitch=by_pitch) for pipeline, method, each in judged)
    quantity = "pitch" if by_pitch else "total"
    groups = tuple(_groups(trials, errors, quantity, margin_deg))
    measure = "range of pitch" if by_pitch else "mean inclination"
    return PeopleStudy(
        trials=tuple(trials), quantity=quantity, measure=measure, margin_deg=margin_deg, errors=errors, groups=groups
    )


# ---- calibrations


def _calibrations(trials: Sequence[PersonTrial], settings: TrialSettings) -> dict[Source, list[Made]]:
    """Return what each trial is corrected by, from each source, or why it is not."""
    sources: dict[Source, list[Made]] = {
        source: [None] * len(trials) for source in ("none", "constants", "tables", "motion")
    }
    for device in dict.fromkeys(trial.device for trial in trials):
        rows = [k for k, trial in enumerate(trials) if trial.device == device]
        given = [trials[k].calibration for k in rows]
        pairs = [trials[k].pair for k in rows]
        if all(given):
            constants: Sequence[Made] = [one and replace(one, drift=None) for one in given]
        else:
            constants = _or_why(device, pairs, lambda those: calibrations_by_others(those, settings=settings)[0])
        tables: list[Made] = [one if one and one.drift else "no calibration with tables is stated" for one in given]
        kinds: tuple[tuple[Source, Sequence[Made]], ...] = (
            ("constants", constants),
            ("tables", tables),
            ("motion", _or_why(device, pairs, _by_motion)),
        )
        for source, each in kinds:
            for k, one in zip(rows, each, strict=True):
                sources[source][k] = one
    best = (
        table if isinstance(table, Calibration) else one
        for table, one in zip(sources["tables"], sources["constants"], strict=True)
    )
    return sources | {"best": list(best)}


def _by_motion(pairs: Sequence[Pair]) -> Sequence[Calibration]:
    """Return the calibration of each recording by what the others' motion shows."""
    records = [record for record, _ in pairs]
    return [calibrate_from_motion([other for other in records if other is not one]) for one in records]


def _or_why(
    device: str, pairs: Sequence[Pair], make: Callable[[Sequence[Pair]], Sequence[Calibration]]
) -> Sequence[Made]:
    """Return a calibration for each recording of a device by its others, or why there is none."""
    if len(pairs) < 2:
        return [f"device {device} has one recording: state its calibration"] * len(pairs)
    try:
        return list(make(pairs))
    except UndriftError as error:
        return [f"device {device}: {error}"] * len(pairs)


def _judged(trial: PersonTrial, by: Made, settings: TrialSettings) -> Trial | str:
    if isinstance(by, str):
        return by
    settings = replace(settings, mounting=trial.mounting, align="level" if trial.cluster else settings.align)
    method = by.gyro.method if by and by.gyro else ""
    if method.startswith("reference") and trial.calibration is None and settings.offset == "rest":
        settings = replace(settings, offset="none")  # a fit to the others has the offset of this recording's rest
    try:
        judged = validate_trial(*trial.pair, calibration=by, settings=settings, name=trial.recording)
        check_scale(judged)
        return judged
    except UndriftError as error:
        return str(error)


# ---- sums


def _errors(pipeline: str, method: Method, each: list[Trial | str], *, by_pitch: bool) -> PipelineErrors:
    """Return a pipeline's errors."""

    def column(name: str) -> FloatArray:
        return np.array([getattr(one.figures, name) if isinstance(one, Trial) else np.nan for one in each])

    reasons = [one for one in each if isinstance(one, str)]
    return PipelineErrors(
        pipeline=pipeline,
        method=method,
        total_deg=column("rmse_total_deg"),
        inclination_deg=column("rmse_inclination_deg"),
        pitch_deg=column("rmse_pitch_deg"),
        end_deg=column("end_total_deg"),
        measure=np.array(
            [_measure(one, by_pitch=by_pitch) if isinstance(one, Trial) else (np.nan, np.nan) for one in each]
        ),
        findings=tuple(
            (one.recording, item)
            for one in each
            if isinstance(one, Trial)
            for item in one.findings
            if item.level != "info"
        ),
        missing=f"missing in {len(reasons)} of {len(each)} trials: {reasons[0]}" if reasons else "",
    )


def _measure(trial: Trial, *, by_pitch: bool) -> tuple[float, float]:
    """Return the measure of a trial by sensor and optics, deg, over the same samples."""
    if not by_pitch:
        return trial.mean_inclination[0] / RADIAN_PER_DEGREE, trial.mean_inclination[1] / RADIAN_PER_DEGREE
    both = (trial.moving > 0.0) & np.isfinite(trial.sensor_pitch) & np.isfinite(trial.reference_pitch)
    spans = (np.ptp(pitch[both]) / RADIAN_PER_DEGREE for pitch in (trial.sensor_pitch, trial.reference_pitch))
    return float(next(spans)), float(next(spans))


def _groups(
    trials: Sequence[PersonTrial], errors: Sequence[PipelineErrors], quantity: str, margin_deg: float
) -> Iterator[Group]:
    """Yield each pipeline over all trials, each task and each device, where there are several."""
    people, every = np.array([trial.person for trial in trials]), np.ones(len(trials), np.bool_)
    parts = {"all": every}
    for kind in ("task", "device"):
        names = list(dict.fromkeys(getattr(trial, kind) for trial in trials))
        if len(names) > 1:
            label = "" if kind == "task" else "device "
            parts |= {f"{label}{name}": np.array([getattr(trial, kind) == name for trial in trials]) for name in names}
    for name, rows in parts.items():
        for one in errors:
            raw = next(x for x in errors if x.method == one.method)
            yield _group(name, trials, one, raw, rows, people, quantity, margin_deg)


def _group(
    name: str,
    trials: Sequence[PersonTrial],
    one: PipelineErrors,
    raw: PipelineErrors,
    rows: BoolArray,
    people: NDArray[np.str_],
    quantity: str,
    margin_deg: float,
) -> Group:
    """Return one pipeline over the trials of a group."""
    error, before = (getattr(x, f"{quantity}_deg") for x in (one, raw))
    seen = rows & np.isfinite(error)
    by_person = [_of_people(values, seen, people) for values in (error, before, *one.measure.T)]
    number, tests = len(by_person[0]), 2 * (len(PIPELINES) - 1)
    mean, interval = mean_interval(by_person[0]) if number else (float("nan"), (float("nan"),) * 2)
    tasks = {trial.task for trial, row in zip(trials, seen, strict=True) if row}
    measured = np.column_stack(by_person[2:])  # one mean per person: repeated trials are not independent
    measured = measured[np.isfinite(measured).all(axis=1)]
    several = len(measured) >= LEAST_FOR_AGREEMENT
    enough = number >= LEAST and np.isfinite(by_person[1]).all()
    agrees = number >= LEAST and np.isfinite(by_person[2]).all()
    return Group(
        of=name,
        pipeline=one.pipeline,
        method=one.method,
        trials=int(seen.sum()),
        people=number,
        mean_deg=mean,
        interval_deg=interval,
        median_deg=float(np.median(error[seen])) if number else float("nan"),
        decision=decide_between(by_person[0], by_person[1], margin=margin_deg, tests=tests)
        if enough and one is not raw
        else None,
        limits=bland_altman(*measured.T) if several else None,
        icc=intraclass_correlation(measured) if several and len(tasks) == 1 else None,
        equivalence=decide_between(by_person[2], by_person[3], margin=margin_deg) if agrees else None,
    )


def _of_people(values: FloatArray, seen: BoolArray, people: NDArray[np.str_]) -> FloatArray:
    return np.array([values[seen & (people == one)].mean() for one in dict.fromkeys(people[seen].tolist())])
