"""Case: one subject in one task with a device of its own, simulated once for a cut-off frequency.

Everything is drawn from (seed, task, subject): the unit of the device, the performance, the temperature, the noise. The cut-
off frequency changes the filter alone, so that cases of one subject differ by it and by nothing else.
"""

import json
import zlib
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import Calibration
from undrift.correct import correct_checked
from undrift.orientation.angles import sagittal_pitch
from undrift.orientation.orient import orient
from undrift.record import Record
from undrift.session import Still
from undrift.sim.device.low_pass import LowPass
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.store import device_from_json
from undrift.sim.motion.library import TaskName, draw_task
from undrift.sim.motion.subject import Subject, cohort
from undrift.sim.motion.task import Task
from undrift.study.motion import RecordedTask, read_motion
from undrift.study.plan import Study, StudyTask
from undrift.study.session import ROOM_TEMP_C
from undrift.units import STANDARD_GRAVITY

SAMPLE_RATE_HZ = 100.0
WORN_S = 1800.0  # the device has been on for half an hour
REST_S = 6.0  # the note's initial rest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """A trial ready to be corrected and judged.

    Parameters
    ----------
    device : DeviceModel
        The subject's unit, with the filter of the case.
    record : Record
        What it read in the trial.
    pitch : array, shape (N,)
        True sagittal pitch, delayed by the filter as a reference is before it is compared, rad.
    still, moving : (int, int)
        Samples of the rest before, and of the motion.
    """

    device: DeviceModel
    record: Record
    pitch: FloatArray
    still: tuple[int, int]
    moving: tuple[int, int]


def seeded(study: Study, *words: str | int) -> np.random.Generator:
    """Return the generator of one part of a study.

    Parameters
    ----------
    study : Study
        Gives the seed.
    *words : str or int
        Names the part: task, subject, what is drawn.

    Returns
    -------
    Generator
        The same for the same words, whatever else is drawn.
    """
    keys = tuple(w if isinstance(w, int) else zlib.crc32(w.encode()) for w in words)
    return np.random.default_rng(np.random.SeedSequence(study.seed, spawn_key=keys))


def subject_of(study: Study, number: int) -> Subject:
    """Return one subject of the study's cohort; numbers beyond its end start again.

    Parameters
    ----------
    study : Study
        Gives the seed and the group.
    number : int
        From 0.

    Returns
    -------
    Subject
        Age, height, habits.
    """
    people = cohort(study.group, rng=seeded(study, "cohort", study.group, number // 30))
    return people[number % len(people)]


def with_cutoff(device: DeviceModel, cutoff_hz: float) -> DeviceModel:
    """Return a device whose filters were built for another cut-off frequency, out of the same parts.

    Parameters
    ----------
    device : DeviceModel
        Any device; one without filters gets some.
    cutoff_hz : float
        Hz.

    Returns
    -------
    DeviceModel
        Each channel's error of frequency and quality kept.
    """
    made = []
    for chain in (device.gyro, device.accel):
        held = chain.low_pass
        if held is None:
            low_pass = LowPass(cutoff_hz=np.full(3, cutoff_hz))
        else:
            error = held.cutoff_hz / float(np.median(held.cutoff_hz))
            low_pass = LowPass(cutoff_hz=cutoff_hz * error, quality=held.quality)
        made.append(replace(chain, low_pass=low_pass))
    return replace(device, gyro=made[0], accel=made[1])


def device_of(study: Study, number: int) -> DeviceModel:
    """Return the device that a subject wears.

    Parameters
    ----------
    study : Study
        Gives the kind, or the device itself.
    number : int
        Which subject, from 0.

    Returns
    -------
    DeviceModel
        A unit drawn within the preset's tolerances, or the study's one device.
    """
    if study.worn:
        return device_from_json(json.loads(study.worn))
    return random_device_of(study.device, seeded(study, "device", number))


def perform(study: Study, task: StudyTask, number: int) -> Task | RecordedTask:
    """Return what a subject does.

    Parameters
    ----------
    study : Study
        Gives seed and cohort.
    task : StudyTask
        What is done.
    number : int
        Which subject, from 0.

    Returns
    -------
    Task or RecordedTask
        A performance of the library's task, or the recorded motion.
    """
    if task.motion is not None:
        return read_motion(task.motion)
    return draw_task(
        cast("TaskName", task.name),
        rng=seeded(study, "task", task.name, number),
        subject=subject_of(study, number),
        rest_s=REST_S,
    )


def make_case(study: Study, task: StudyTask, number: int, cutoff_hz: float) -> Case:
    """Simulate a subject's trial.

    Parameters
    ----------
    study : Study
        Gives device, seed and temperatures.
    task : StudyTask
        What is done.
    number : int
        Which subject, from 0.
    cutoff_hz : float
        Of the filter, Hz.

    Returns
    -------
    Case
        Record and truth.
    """
    device = with_cutoff(device_of(study, number), cutoff_hz)
    performed = perform(study, task, number)
    time = np.arange(round(performed.duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    warmer = float(seeded(study, "temperature", number).uniform(*study.excursion_k))
    record = simulate_device(
        device,
        performed.at(time, STANDARD_GRAVITY),
        rng=seeded(study, "noise", task.name, number),
        temp_c=ROOM_TEMP_C + warmer,
        power_on_s=WORN_S,
    ).record
    start, stop = (round(moment * SAMPLE_RATE_HZ) for moment in performed.moving_s)
    return Case(
        device=device,
        record=record,
        pitch=_delayed_pitch(performed, time, device),
        still=(0, max(start - round(0.2 * SAMPLE_RATE_HZ), 2)),
        moving=(start, min(stop + 1, len(time))),
    )


def pitch_error(case: Case, calibration: Calibration) -> FloatArray:
    """Return the error of the pitch that a calibrated device gives.

    Parameters
    ----------
    case : Case
        Trial and truth.
    calibration : Calibration
        What the session made of the device.

    Returns
    -------
    array, shape (M,)
        Over the motion, rad; NaN where the pitch is not defined.
    """
    corrected = correct_checked(case.record, calibration, policy="hold", threads=1).record
    found = orient(corrected, Still(start=case.still[0], stop=case.still[1]))
    error = found.pitch - case.pitch
    error = (error + np.pi) % (2.0 * np.pi) - np.pi
    return error[case.moving[0] : case.moving[1]]


def _delayed_pitch(performed: Task | RecordedTask, time: FloatArray, device: DeviceModel) -> FloatArray:
    low_pass = device.gyro.low_pass
    delay = 0.0 if low_pass is None else float(np.median(low_pass.group_delay_s))
    if device.sampling.gyro_averaging == "instant":  # strapdown holds a reading over the step before its stamp
        delay -= 0.5 / SAMPLE_RATE_HZ
    return sagittal_pitch(performed.at(time - delay, STANDARD_GRAVITY).q_nb)
