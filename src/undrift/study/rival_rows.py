"""Rivals compared: each method calibrates the same units in the same time, each unit then does the same tasks.

Pitch is compared with the truth, delayed as the filter delays it. Two errors are told: the whole, and that of the change of
pitch since the motion began, which leaves the tilt at the start out: the accelerometers give that one, the gyroscopes the other.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.orientation.angles import sagittal_pitch
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.library import TaskName, draw_task
from undrift.study.case import REST_S, SAMPLE_RATE_HZ, Case, pitch_error
from undrift.study.rivals import METHODS, SETTLED_S, TEMP_C, Method, Rivalled, calibrate_by
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

TASKS: tuple[TaskName, ...] = ("sit_to_stand", "posturography")


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """A figure over units.

    Parameters
    ----------
    median, least, greatest : float
        Same unit as the figure.
    """

    median: float
    least: float
    greatest: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RivalRow:
    """One method in one task.

    Parameters
    ----------
    method : str
        Which.
    task : str
        What was done.
    minutes : float
        Of recordings, min.
    observable : tuple of str
        gyro, accel: what the method calibrated in every unit.
    error_rms_deg, error_max_deg : Spread
        Pitch error over the motion, deg, over units.
    change_max_deg : Spread
        Largest error of the change of pitch since the motion began, deg: what the gyroscopes' calibration is worth.
    units, refused : int
        How many units, and with how many of them the tilt at the start was refused, the length of gravity being too far off;
        those have no error and are not in the figures.
    said : tuple of str
        What the fits said of the first unit, what the method cannot see; and why units were refused.
    """

    method: Method
    task: TaskName
    minutes: float
    observable: tuple[str, ...]
    error_rms_deg: Spread
    error_max_deg: Spread
    change_max_deg: Spread
    units: int
    refused: int
    said: tuple[str, ...]


def compare_rivals(
    *,
    kind: str = "enc03j_3031",
    units: int = 5,
    seed: int = 0,
    minutes: float | None = None,
    methods: tuple[Method, ...] = METHODS,
    tasks: tuple[TaskName, ...] = TASKS,
) -> tuple[RivalRow, ...]:
    """Compare ways to calibrate by the error that they leave in tasks.

    Parameters
    ----------
    kind : str
        Preset that units are drawn from.
    units : int
        How many; each does all tasks with all methods.
    seed : int
        Draws units, sessions and tasks.
    minutes : float, optional
        For recordings, min; that of the note's rate table where not given.
    methods : tuple of str
        Of ``METHODS``.
    tasks : tuple of str
        Of the library.

    Returns
    -------
    tuple of RivalRow
        By task, then method.

    Raises
    ------
    InputError
        No unit, no method, no task; or a time too short for a method.
    """
    if units < 1 or not methods or not tasks:
        raise InputError(
            f"rivals: wanted a unit, a method and a task or more, got {units}, {len(methods)} and {len(tasks)}; name some"
        )
    errors = np.full((units, len(methods), len(tasks), 3), np.nan)
    refusals: list[list[str]] = [[] for _ in methods]
    made: list[list[Rivalled]] = [[] for _ in methods]
    for number in range(units):
        device = random_device_of(kind, np.random.default_rng([seed, number, 0]))
        cases = [_case(device, task, np.random.default_rng([seed, number, 1, k])) for k, task in enumerate(tasks)]
        for m, method in enumerate(methods):
            rng = np.random.default_rng([seed, number, 2, METHODS.index(method)])
            done = calibrate_by(method, device, kind=kind, rng=rng, minutes=minutes)
            made[m].append(done)
            for t, case in enumerate(cases):
                try:
                    errors[number, m, t] = _told(pitch_error(case, done.calibration) / RADIAN_PER_DEGREE)
                except InputError as error:  # a calibration too poor to start from is refused: no error, and not a zero
                    refusals[m].append(str(error))
    return tuple(
        _row(made[m], task, errors[:, m, t], refusals[m]) for t, task in enumerate(tasks) for m in range(len(methods))
    )


def _row(done: list[Rivalled], task: TaskName, errors: FloatArray, refusals: list[str]) -> RivalRow:
    first = done[0]
    rms, largest, change = (_spread(column) for column in errors.T)
    return RivalRow(
        method=first.method,
        task=task,
        minutes=first.minutes,
        observable=tuple(name for name in ("gyro", "accel") if all(name in one.observable for one in done)),
        error_rms_deg=rms,
        error_max_deg=largest,
        change_max_deg=change,
        units=len(done),
        refused=int(np.isnan(errors[:, 0]).sum()),
        said=(*first.said, *refusals[:1]),
    )


def _spread(values: FloatArray) -> Spread:
    seen = values[np.isfinite(values)]
    if not len(seen):
        return Spread(median=np.nan, least=np.nan, greatest=np.nan)
    return Spread(median=float(np.median(seen)), least=float(seen.min()), greatest=float(seen.max()))


def _told(error: FloatArray) -> tuple[float, float, float]:
    since = error - error[np.flatnonzero(np.isfinite(error))[0]]
    return float(np.sqrt(np.nanmean(error**2))), float(np.nanmax(np.abs(error))), float(np.nanmax(np.abs(since)))


def _case(device: DeviceModel, name: TaskName, rng: np.random.Generator) -> Case:
    performed = draw_task(name, rng=rng, rest_s=REST_S)
    time = np.arange(round(performed.duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    motion = performed.at(time, STANDARD_GRAVITY)
    record = simulate_device(device, motion, rng=rng, temp_c=TEMP_C, power_on_s=SETTLED_S).record
    low_pass = device.gyro.low_pass
    delay_s = 0.0 if low_pass is None else float(np.median(low_pass.group_delay_s))
    delay_s -= 0.5 / SAMPLE_RATE_HZ  # strapdown holds each reading over the step before its stamp
    start, stop = (round(moment * SAMPLE_RATE_HZ) for moment in performed.moving_s)
    return Case(
        device=device,
        record=record,
        pitch=sagittal_pitch(performed.at(time - delay_s, STANDARD_GRAVITY).q_nb),
        still=(0, start - round(0.2 * SAMPLE_RATE_HZ)),
        moving=(start, min(stop + 1, len(time))),
    )
