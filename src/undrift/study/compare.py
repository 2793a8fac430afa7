"""Figure 3 for a device of one's own: real trials beside optics at each level of correction, and what its twin predicts for them.

A trial's error is the root mean square over its motion: of pitch where every trial has one throughout, else of the total angle. It
is averaged by person; without people each trial is a subject of its own. Means over subjects have Student's interval, and the
paired difference to the row before has the verdict of the study's three-sided test against a margin.

The twin has the parameters of all that the calibration has, and is corrected and judged as the trial is. For rate w and specific
force f of the motion in its case, at the temperature T of the sensors it reads ::

    u = K(T) (v + e(v) + G f) + o(T)          v = w + m d, K = M^-1; m is 1 while it turns; e at the mean temperature
    reading = round((u + noise) / step) step  noise as the trial's rest shows it; accelerometers likewise, of f

Where the reference has gaps in motion, w is the corrected real rate; before and after the motion the device is still. The twin's
reference is the orientation that w integrates to, with the real one's gaps. A warm-up and hysteresis are not simulated.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from undrift.arrays import FloatArray, interpolated
from undrift.correction.correct import correct_whole
from undrift.drift.temperature import without_lag
from undrift.errors import InputError, UndriftError
from undrift.frames import integrate_strapdown, quaternion_conjugate, rotate
from undrift.model import NO_TABLES, Calibration, Triad
from undrift.record import Record, Reference
from undrift.segments import find_turning
from undrift.sim.device.effects import rounded
from undrift.sim.motion.poses import PoseSettings, fit_pose_spline
from undrift.study.statistics import Decision, decide_between, mean_interval
from undrift.twin.accel import HIGHEST, Match, match
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.trial import OffsetChoice, Trial, TrialSettings, orientation_at, validate_trial

LEAST_SUBJECTS = 3  # of a verdict
Judged: TypeAlias = Trial | str  # or why there is none
Worn: TypeAlias = tuple[Record, Reference]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparedRow:
    """Errors of T trials at one level of correction; NaN where a trial does not have it."""

    level: str
    actual_deg: FloatArray  # (T,), rms over the motion
    simulated_deg: FloatArray  # (T,), as above, of the twin
    apart_deg: FloatArray  # (T,), largest difference of the two errors over the motion
    missing: str  # For how many trials there is no error or no twin, and why; empty where all have both
    mean_deg: float  # Over the subjects that have it
    interval_deg: tuple[float, float]  # Its 95 % interval; NaN with fewer than two
    # Against the last row before that can be made, over the subjects that have both; None with fewer than three
    decision: Decision | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelComparison:
    """Real trials at each level of correction, and their twins."""

    quantity: str  # pitch, or total where pitch is not defined throughout
    margin_deg: float  # Smallest difference that matters
    recordings: tuple[str, ...]  # T names
    tasks: tuple[str, ...]  # Of each; empty where no labels say so
    people: tuple[str, ...]  # As above
    rows: tuple[ComparedRow, ...]


def compare_levels(
    pairs: Sequence[Worn],
    calibrations: Sequence[Calibration | None],
    labels: tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]],
    *,
    settings: TrialSettings,
    margin_deg: float,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> LevelComparison:
    """Judge trials and their twins at each level of correction; a calibration for each, labels: names, tasks and people."""
    judged = list[list[tuple[Judged, Judged]]]()  # by trial, then level: actual and simulated
    for k, (pair, calibration) in enumerate(zip(pairs, calibrations, strict=True)):
        progress(f"levels of correction: recording {k + 1} of {len(pairs)}", k / len(pairs))
        real = _judged(pair, calibration, settings)
        judged.append(list(zip(real, _of_twin(pair, calibration, real, settings, k), strict=True)))
    trials = [real for row in judged for real, _ in row if isinstance(real, Trial)]
    quantity = "pitch" if all(one.figures.pitch_defined == 1.0 for one in trials) else "total"
    figures = np.array([[_figures(*both, quantity) for both in row] for row in judged])  # (T, levels, 3)
    names, tasks, people = labels
    whose = np.array(people or range(len(pairs)))
    of_each = (figures[whose == one, :, 0] for one in dict.fromkeys(whose.tolist()))
    errors = np.stack([np.ma.masked_invalid(x).mean(axis=0).filled(np.nan) for x in of_each])  # (subjects, levels)
    seen, rows, before = np.isfinite(errors), list[ComparedRow](), -1
    for k, (level, *_) in enumerate(_levels(calibrations[0])):
        decision, shared = None, seen[:, k] & seen[:, before]
        if before >= 0 and shared.sum() >= LEAST_SUBJECTS:
            tests, both = int(seen.any(axis=0).sum()) - 1, (errors[shared, k], errors[shared, before])
            decision = replace(decide_between(*both, margin=margin_deg, tests=tests), other=before)
        actual, simulated, apart = figures[:, k].T
        mean, interval = mean_interval(errors[seen[:, k], k])
        reasons = (x if isinstance(x, str) else y for x, y in (row[k] for row in judged))
        without = [x for x in reasons if isinstance(x, str)]
        rows.append(
            ComparedRow(
                level=level, actual_deg=actual, simulated_deg=simulated, apart_deg=apart, mean_deg=mean, interval_deg=interval,
                missing=f"missing in {len(without)} of {len(pairs)} trials: {without[0]}" if without else "", decision=decision,
            )
        )  # fmt: skip
        before = k if seen[:, k].any() else before
    about = {"recordings": names, "tasks": tasks, "people": people}
    return LevelComparison(quantity=quantity, margin_deg=margin_deg, **about, rows=tuple(rows))


def _levels(full: Calibration | None) -> Iterator[tuple[str, Calibration | None, OffsetChoice, str]]:
    """Yield name, calibration and offset of each level, and why it cannot be made, or nothing."""
    drift, lacking = None if full is None else full.drift, "" if full else "no calibration was given"
    constant = full and replace(full, drift=None)
    static = full and drift and replace(full, drift=replace(drift, scale=None, dynamic=None))
    beside = drift and (drift.scale or drift.dynamic)
    yield "uncalibrated", None, "none", ""
    yield "constants", constant, "none", lacking
    yield "static tables", static or None, "none", lacking or ("" if drift and drift.static else "no static table")
    yield "all tables", full, "none", lacking or ("" if beside else "no scale and no dynamic table")
    if drift:
        yield "rest, no tables", constant, "rest", ""
    yield "rest offset", full, "rest", ""
    yield "motion offset", full, "motion", ""


def _judged(pair: Worn, full: Calibration | None, settings: TrialSettings) -> list[Judged]:
    """Judge a trial, or its twin, at each level."""
    judged = list[Judged]()
    for _, calibration, offset, lacking in _levels(full):
        try:
            if lacking:
                raise InputError(lacking)
            trial = validate_trial(*pair, calibration=calibration, settings=replace(settings, offset=offset))
            judged.append("no rest" if offset == "rest" and trial.rest is None else trial)
        except UndriftError as error:
            judged.append(str(error))
    return judged


def _figures(real: Judged, twin: Judged, quantity: str) -> tuple[float, ...]:
    """Return the rms errors of both over the motion and their largest difference, deg."""
    if isinstance(real, str):
        return np.nan, np.nan, np.nan
    errors = [np.nan if isinstance(x, str) else getattr(x.figures, f"rmse_{quantity}_deg") for x in (real, twin)]
    if isinstance(twin, str):
        return (*errors, np.nan)
    moving, simulated = real.moving > 0.0, np.interp(real.time, twin.time, getattr(twin.error, quantity))
    return (*errors, np.nanmax(np.abs(getattr(real.error, quantity) - simulated)[moving]) / RADIAN_PER_DEGREE)


# ---- the twin


def _of_twin(
    pair: Worn, full: Calibration | None, real: list[Judged], settings: TrialSettings, seed: int
) -> list[Judged]:
    """Judge the twin of a trial at each level, in the mounting that was removed from the trial at the best level, if any."""
    trial = next((one for one in real[::-1] if isinstance(one, Trial)), None)
    if full is None or full.gyro is None or trial is None:
        return ["no twin without a calibration of the gyroscopes"] * len(real)
    if full.drift and full.drift.static:  # which the twin does not have
        static = replace(full.drift.static, warm_up=None)
        full = replace(full, drift=replace(full.drift, static=static))
    mounting = trial.mounting.alignment.rotation if trial.mounting and trial.mounting.applied else np.eye(3)
    try:
        worn = predict_trial(*pair, full, mounting, np.random.default_rng(seed))
    except UndriftError as error:
        return [f"no twin: {error}"] * len(real)
    judged = _judged(worn, full, settings)
    return judged if worn[1].position is not None else [*judged[:-1], "no twin, as the reference has no positions"]


def predict_trial(
    record: Record, reference: Reference, full: Calibration, mounting: FloatArray, rng: np.random.Generator
) -> Worn:
    """Return the twin's readings in a trial, and its reference; mounting (3, 3) turns its case to the reference's body."""
    done = match(correct_whole(record, full, policy="hold").record, reference)
    made, poses, most_hz = done.record, done.reference, HIGHEST * done.reference.sample_rate_hz
    spline = fit_pose_spline(poses, PoseSettings(cutoff_hz=min(20.0, most_hz), position_cutoff_hz=min(10.0, most_hz)))
    time = made.time - (done.lag.seconds - 0.5 / made.sample_rate_hz)  # a reading is the mean over the step before it
    motion = spline.at(time, full.gravity_m_s2)
    seen, inside = motion.valid > 0.0, (made.time >= done.span.start_s) & (made.time < done.span.stop_s)
    first = int(np.argmax(seen & inside))
    rate = np.nan_to_num(np.where(seen[:, None], motion.mean_rate_b, done.gyro @ mounting.T)) * inside[:, None]
    rate[: first + 1] = 0.0
    q_nb = integrate_strapdown(rate, time, motion.q_nb[first])
    push = rotate(motion.q_nb, motion.force_b)
    push[~(np.isfinite(push).all(axis=1) & inside)] = (0.0, 0.0, full.gravity_m_s2)
    force = rotate(quaternion_conjugate(q_nb), push) @ mounting
    shown = np.where(poses.valid[:, None], orientation_at(time, q_nb, poses.time), np.nan)
    return _read(done, full, rate @ mounting, force, rng), replace(poses, q_nb=shown)


def _read(done: Match, full: Calibration, rate: FloatArray, force: FloatArray, rng: np.random.Generator) -> Record:
    """Return the readings of both triads of a motion in the case: rate (N, 3) rad/s, force (N, 3) m/s2."""
    record, drift, (gyro, accel) = done.record, full.drift or NO_TABLES, full.triads
    temp_c = np.full(len(rate), full.reference_temp_c) if record.temp_c is None else record.temp_c
    if drift.lag_s > 0.0:
        temp_c, _ = without_lag(temp_c, record.time, lag_s=drift.lag_s, smooth_s=drift.lag_smooth_s)
    if gyro.model is not None and gyro.model.moving_offset is not None:
        rate = rate + find_turning(rate, record.time)[0][:, None] * gyro.model.moving_offset * gyro.si
    if gyro.errors is not None:
        table, true = interpolated(float(np.nanmean(temp_c)), gyro.errors.temp_c, gyro.errors.error), rate
        for _ in range(2):  # the table is over the measured rate
            errors = [np.interp(rate[:, k], gyro.errors.turn_rate, table[:, k]) for k in range(3)]
            rate = true + np.stack(errors, axis=1)
    if gyro.model is not None and gyro.model.g_sensitivity is not None:
        rate = rate + force @ (gyro.model.g_sensitivity * gyro.si).T
    read: dict[str, Any] = {"gyro": _sensed(gyro, rate, temp_c, done, rng), "state": "raw"}
    if record.accel is not None:
        read["accel"] = _sensed(accel, force, temp_c, done, rng)
    units: Any = {f"{x.sensor}_unit": x.model.unit_in for x in (gyro, accel) if x.model is not None}
    return replace(record, **read, **units)


def _sensed(triad: Triad, x: FloatArray, temp_c: FloatArray, done: Match, rng: np.random.Generator) -> FloatArray:
    """Return the readings of three sensors, in their own unit, of what they measure (N, 3), SI."""
    model, matrices, offsets = triad.model, triad.matrices, triad.offsets
    step = np.full(3, float(model is not None and model.unit_in == "count")) if triad.lsb is None else triad.lsb
    if (
        done.span.rested
    ):  # by neighbours: a person at rest sways; that of the codes is in it, which keeps codes changing
        steps = np.diff(getattr(done.rest, triad.sensor), axis=0)
        x = x + rng.standard_normal(x.shape) * np.nanstd(steps, axis=0) / np.sqrt(2.0)
    if model is None:
        return x
    inverse = model.matrix if matrices is None else interpolated(temp_c, matrices.temp_c, matrices.value)
    offset = model.offset if offsets is None else interpolated(temp_c, offsets.temp_c, offsets.value)
    readings = np.linalg.solve(inverse, (x / triad.si)[..., None])[..., 0] + offset
    return np.where(step > 0.0, rounded(readings / (step + (step == 0.0)), triad.rounding) * step, readings)
