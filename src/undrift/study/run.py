"""Run a study: each device is calibrated once with every session and worn in every task, in batches of devices and people.

    Session x device -> calibration        shared by all tasks and categories
    Task x person    -> trial              the person of a device's own number
    both             -> errors of the pitch, one ``Run`` each

The unit of work is a device with its own seed, so the numbers do not depend on the executor or the number of workers.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from undrift.errors import CalibrationError, InputError
from undrift.model import Calibration
from undrift.sim.motion.tasks import Subject, Task, cohort, draw_task
from undrift.study.case import (
    EFFECTS,
    REST_S,
    EffectName,
    OffsetRule,
    device_without,
    make_case,
    pitch_errors_deg,
    stream,
    with_cutoff,
)
from undrift.study.plan import Study, StudyTask
from undrift.study.recorded import RecordedTask, read_motion
from undrift.study.sessions import (
    ROOM_TEMP_C,
    CalibrationSession,
    add_tables,
    calibrate_before_soaks,
    calibrate_by_means,
)
from undrift.validation.agreement import mean_interval

# ---- executors

BATCH = 10  # devices between two looks at the intervals
SENSITIVITY_K = (0.0, 5.0, 20.0)  # additional temperature rises for the sensitivity, K


@contextmanager
def executor(workers: int | None = None, scheduler: str | None = None) -> Iterator[Callable[..., Iterator[Any]]]:
    """Return a ``map`` over processes of this machine, or over the workers of a Dask scheduler."""
    if scheduler is not None and workers is not None:
        raise InputError("study: `scheduler` has its own workers. Omit `workers`.")
    if scheduler is not None:
        import distributed

        connect: Any = distributed.Client
        try:
            client = connect(scheduler, timeout=10.0, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InputError(
                f"scheduler: no Dask scheduler answers at {scheduler} ({error}). Start one: dask scheduler."
            ) from error
        with client:
            yield client.get_executor().map
        return
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    if count < 1:
        raise InputError(f"study: `workers` must be 1 or more, got {count}.")
    if count == 1:
        yield map
        return
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
        yield pool.map


# ---- one device


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """Errors of a device and a person in a task with a calibration."""

    task: str
    subject: int
    session: str
    cutoff_hz: float  # NaN for the device's own filter
    excursion_k: float  # board temperature above the room, K
    offset: OffsetRule
    role: str  # "session", "try", "sensitivity", or the effect that is switched off
    rms_deg: float  # NaN if the session could not calibrate the device
    real_time_deg: float  # rms against the true pitch of now
    largest_deg: float


def perform(study: Study, task: StudyTask, number: int) -> list[Task | RecordedTask]:
    """Return the trials that a subject performs: one drawn, or all recordings of a person."""
    if task.motion is not None:
        return [read_motion(motion) for motion in task.motion.of(number)]
    people = cohort(
        study.group, rng=stream(study.seed, "cohort", study.group, number // 30), category=study.kind(task.category)
    )
    subject: Subject = people[number % len(people)]
    rng = stream(study.seed, study.group, "task", task.name, number)
    return [draw_task(task.name, rng=rng, subject=subject, rest_s=REST_S)]  # type: ignore[arg-type]


class _Device:
    """One device with its calibrations, each made once."""

    def __init__(self, study: Study, number: int, without: EffectName | None = None) -> None:
        self.study, self.number = study, number
        unit = study.unit(number)
        self.model = unit if without is None else device_without(unit, without)
        self.aligned = without != "delay"
        self._calibrations: dict[str, Calibration | None] = {}
        self._before_soaks: dict[CalibrationSession, Calibration] = {}
        self._performed: dict[str, list[Task | RecordedTask]] = {}

    def calibration(self, session: CalibrationSession) -> Calibration | None:
        """Calibrate the device with a session. Return None if the session cannot calibrate it."""
        if session.name not in self._calibrations:
            self._calibrations[session.name] = None
            if session.suits(self.model):
                with suppress(CalibrationError):
                    self._calibrations[session.name] = self._calibrate(session)
        return self._calibrations[session.name]

    def _calibrate(self, session: CalibrationSession) -> Calibration:
        study, device = self.study, with_cutoff(self.model, None)
        streams = partial(stream, study.seed, study.group, "bench", self.number)
        how: dict[str, Any] = {"errors": study.bench, "streams": streams, "fit": study.fit}
        if session.by_means and session.protocol:
            return calibrate_by_means(session.protocol, device, **how)
        stage = session.at_one_temperature
        if stage not in self._before_soaks:
            self._before_soaks[stage] = calibrate_before_soaks(stage, device, **how)
        return add_tables(session, self._before_soaks[stage], device, **how)

    def perform(self, task: StudyTask) -> list[Task | RecordedTask]:
        """Return the trials of the device's person."""
        if task.key not in self._performed:
            self._performed[task.key] = perform(self.study, task, self.number)
        return self._performed[task.key]

    def runs(
        self,
        task: StudyTask,
        sessions: Sequence[CalibrationSession],
        role: str,
        *,
        cutoff_hz: float | None = None,
        excursion_k: float | None = None,
        offsets: Sequence[OffsetRule] = (),
    ) -> Iterator[Run]:
        """Yield the errors of a task for each session. All sessions use the same trials."""
        study = self.study
        rise = float(stream(study.seed, study.group, "temperature", self.number).uniform(*study.excursion_k))
        rise = rise if excursion_k is None else excursion_k
        device = with_cutoff(self.model, cutoff_hz)
        cases = [
            make_case(
                device,
                performed,
                temp_c=ROOM_TEMP_C + rise,
                rng=stream(study.seed, study.group, "noise", task.name, self.number, place),
                aligned=self.aligned,
            )
            for place, performed in enumerate(self.perform(task))
        ]
        for session in sessions:
            calibration = self.calibration(session)
            for offset in offsets or (study.offset,):
                errors = np.full(3, np.nan)
                if calibration is not None:
                    with suppress(CalibrationError):  # such as accelerometers that do not measure gravity
                        errors = np.mean([pitch_errors_deg(case, calibration, offset) for case in cases], axis=0)
                yield Run(
                    task=task.key, subject=self.number, session=session.name, excursion_k=rise, offset=offset, role=role,
                    cutoff_hz=float("nan") if cutoff_hz is None else cutoff_hz,
                    rms_deg=float(errors[0]), real_time_deg=float(errors[1]), largest_deg=float(errors[2]),
                )  # fmt: skip


def run_device(study: Study, number: int) -> list[Run]:
    """Run one device: all sessions in all tasks, the variations of the note's numbers, and the sensitivity in the first task."""
    device, runs = _Device(study, number), list[Run]()
    for task in study.tasks:
        runs += device.runs(task, study.sessions, "session")
        tried = dict[tuple[str, float], None]()
        for _, _, numbers in task.variations():
            session = numbers.session()
            if (session.name, numbers.cutoff_hz) not in tried:
                tried[session.name, numbers.cutoff_hz] = None
                runs += device.runs(task, (session,), "try", cutoff_hz=numbers.cutoff_hz)
    first = study.tasks[0]
    for rise in SENSITIVITY_K:
        runs += device.runs(first, study.sessions, "sensitivity", excursion_k=rise, offsets=("rest", "none"))
    runs += device.runs(first, study.sessions, "sensitivity", offsets=("rest", "none"))
    return runs


def run_effects(study: Study, chosen: tuple[tuple[str, str], ...], number: int) -> list[Run]:
    """Run one device again with one kind of error switched off at a time, for chosen pairs of task and session."""
    runs = list[Run]()
    sessions_by_name = {session.name: session for session in study.sessions}
    for effect in EFFECTS:
        device = _Device(study, number, effect)
        for task in study.tasks:
            for key, name in chosen:
                if key == task.key:
                    runs += device.runs(task, (sessions_by_name[name],), effect)
    return runs


def run_chosen(study: Study, chosen: tuple[tuple[str, str], ...], number: int) -> list[Run]:
    """Run one device of the other group by chosen sessions only."""
    device, runs = _Device(study, number), list[Run]()
    sessions_by_name = {session.name: session for session in study.sessions}
    for task in study.tasks:
        sessions = [sessions_by_name[name] for key, name in dict.fromkeys(chosen) if key == task.key]
        runs += device.runs(task, sessions, "testing")
    return runs


# ---- all devices


def run_study(
    study: Study, spread: Callable[..., Iterator[Any]], advance: Callable[[int, int], None] = lambda done, total: None
) -> list[Run]:
    """Run devices until the mean error of each session is known to a quarter of the margin, or there are enough."""
    runs, done = list[Run](), 0
    wanted = study.subjects
    people = [task.motion.people for task in study.tasks if task.motion is not None and task.motion.others]
    most = max(study.subjects_max, study.subjects)
    if people:  # no person counts twice
        wanted, most = min(wanted, *people), min(most, *people)
    while done < wanted:
        for made in spread(partial(run_device, study), range(done, wanted)):
            runs += made
            done += 1
            advance(done, most)
        if _is_narrow(study, runs) or wanted >= most:
            break
        wanted = min(wanted + BATCH, most)
    return runs


def _is_narrow(study: Study, runs: list[Run]) -> bool:
    cells = dict[tuple[str, str], list[float]]()
    for run in runs:
        if run.role == "session" and np.isfinite(run.rms_deg):
            cells.setdefault((run.task, run.session), []).append(run.rms_deg)
    best = [min((v for k, v in cells.items() if k[0] == task.key), key=np.mean, default=[]) for task in study.tasks]
    ends = [mean_interval(np.array(values))[1] for values in best]
    return all(high - low <= 0.5 * study.margin_deg for low, high in ends)
