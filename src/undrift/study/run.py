"""Run a study: each device is calibrated once with every session and worn in every task, in batches of devices and people.

    Session x device -> calibration        shared by all tasks and categories
    Task x person    -> trial              person with the number of the device
    both             -> errors of the pitch, one ``Run`` each

The unit of work is a device with its own seed, so the numbers do not depend on the executor or the number of workers.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np

from undrift.errors import CalibrationError
from undrift.model import Calibration
from undrift.sim.motion.tasks import GROUP_SIZE, Group, Kind, Subject, Task, cohort, draw_task
from undrift.study.case import (
    ASSUMED,
    EFFECTS,
    REST_S,
    TRIALS_KEPT,
    Case,
    EffectName,
    OffsetRule,
    Worn,
    device_without,
    make_case,
    pitch_errors_deg,
    simulate_worn,
    stream,
    with_cutoff,
)
from undrift.study.plan import Study, StudyTask
from undrift.study.recorded import RecordedTask, read_motion
from undrift.study.sessions import (
    ROOM_TEMP_C,
    SESSIONS,
    CalibrationSession,
    calibrate_before_soaks,
    calibrate_by,
    calibrate_by_means,
)
from undrift.study.shipped import agree, device_text, key_of, pack, shipped_fits, unpack
from undrift.validation.agreement import mean_interval

CHECKED = SESSIONS["note"]  # the only session that determines tables of all three kinds
BATCH = 10  # number of devices between two checks of the intervals
SENSITIVITY_K = (0.0, 5.0, 20.0)  # additional temperature rises for the sensitivity, K

# ---- one device


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """Errors of one device, worn by one person in a task, with one calibration."""

    task: str
    subject: int
    session: str
    cutoff_hz: float  # NaN for the device's own filter
    excursion_k: float  # board temperature above the room, K
    offset: OffsetRule
    role: str  # "session", "try", "sensitivity", or the effect that is switched off
    rms_deg: float  # NaN if the session could not calibrate the device
    real_time_deg: float  # rms error relative to the current true pitch
    largest_deg: float


def perform(study: Study, task: StudyTask, number: int) -> list[Task | RecordedTask]:
    """Return the trials that a subject performs: one drawn, or all recordings of a person."""
    if task.motion is not None:
        return [read_motion(motion) for motion in task.motion.of(number)]
    return [_drawn(study.seed, study.group, task.name, study.kind(task.category), number)]


@lru_cache(maxsize=TRIALS_KEPT)
def _drawn(seed: int, group: Group, task: str, kind: Kind, number: int) -> Task:
    people = _people(seed, group, kind, number // GROUP_SIZE)
    rng, subject = stream(seed, group, "task", task, number), people[number % GROUP_SIZE]
    return draw_task(task, rng=rng, subject=subject, rest_s=REST_S)  # type: ignore[arg-type]


@lru_cache(maxsize=TRIALS_KEPT)
def _people(seed: int, group: Group, kind: Kind, number: int) -> tuple[Subject, ...]:
    return cohort(group, rng=stream(seed, "cohort", group, number), category=kind)


class StudyDevice:
    """One device with its calibrations and trials, each computed once."""

    def __init__(self, study: Study, number: int, without: EffectName | None = None) -> None:
        self.study, self.number = study, number
        unit = study.unit(number, assumed=without != ASSUMED)
        self.model = unit if without is None else device_without(unit, without)
        self.worn = with_cutoff(self.model, None)
        self.text = device_text(self.worn)
        self.aligned = without != "delay"
        self.rise_k = float(stream(study.seed, study.group, "temperature", number).uniform(*study.excursion_k))
        self.streams = partial(stream, study.seed, study.group, "bench", number)
        self._calibrations: dict[str, Calibration | None] = {}
        self._before_soaks: dict[CalibrationSession, Calibration] = {}
        self._worn: dict[tuple[str, float], list[Worn]] = {}
        self._cases: dict[tuple[str, float | None, float], list[Case]] = {}

    def key(self, session: CalibrationSession | str) -> int:
        """Return the key of the fit of a session, or of a rival by its name."""
        study = self.study
        fit = study.fit if isinstance(session, CalibrationSession) and session.kind == "table" else "product"
        return key_of(self.text, session, study.bench.errors, fit, study.seed, study.group, self.number)

    def calibration(self, session: CalibrationSession) -> Calibration | None:
        """Return the fit of a session. Return None if the session cannot calibrate the device."""
        return self.recall(session, partial(self.fit, session))

    def recall(self, session: CalibrationSession | str, fit: Callable[[], Calibration | None]) -> Calibration | None:
        """Return the shipped fit of a session, or of a rival by its name. Without a shipped fit, compute the fit once."""
        name = session if isinstance(session, str) else session.name
        if name not in self._calibrations:
            shipped = shipped_fits().get(self.key(session)) if self.study.shipped else None
            self._calibrations[name] = fit() if shipped is None else unpack(shipped, self.worn, ROOM_TEMP_C)
        return self._calibrations[name]

    def fit(self, session: CalibrationSession) -> Calibration | None:
        """Record a session and fit it. Return None if the session cannot calibrate the device."""
        how: dict[str, Any] = {"errors": self.study.bench.errors, "streams": self.streams, "fit": self.study.fit}
        if not session.suits(self.model):
            return None
        with suppress(CalibrationError):
            if session.by_means and session.protocol:
                return calibrate_by_means(session.protocol, self.worn, **how)
            stage = session.at_one_temperature
            if stage not in self._before_soaks:
                self._before_soaks[stage] = calibrate_before_soaks(stage, self.worn, **how)
            return calibrate_by(session, self.worn, before_soaks=self._before_soaks[stage], **how)
        return None

    def cases(self, task: StudyTask, *, cutoff_hz: float | None = None, excursion_k: float | None = None) -> list[Case]:
        """Return the trials of the device's person in a task."""
        rise = self.rise_k if excursion_k is None else excursion_k
        key = task.key, cutoff_hz, rise
        if key not in self._cases:
            device = self.worn if cutoff_hz is None else with_cutoff(self.model, cutoff_hz)
            self._cases[key] = [
                make_case(trial, device, aligned=self.aligned) for trial in self._worn_trials(task, rise)
            ]
        return self._cases[key]

    def _worn_trials(self, task: StudyTask, rise_k: float) -> list[Worn]:
        """Return the performance of the device's wearer in a task, with the signals of the device."""
        key, study = (task.key, rise_k), self.study
        if key not in self._worn:
            self._worn[key] = [
                simulate_worn(
                    self.worn, performed, temp_c=ROOM_TEMP_C + rise_k,
                    rng=stream(study.seed, study.group, "noise", task.name, self.number, place),
                )
                for place, performed in enumerate(perform(study, task, self.number))
            ]  # fmt: skip
        return self._worn[key]

    def runs(
        self,
        task: StudyTask,
        sessions: Sequence[CalibrationSession],
        role: str,
        *,
        cutoff_hz: float | None = None,
        excursion_k: float | None = None,
        offset: OffsetRule | None = None,
    ) -> Iterator[Run]:
        """Yield the errors of a task for each session. All sessions use the same trials."""
        rule = offset or self.study.offset
        calibrations = [self.calibration(session) for session in sessions]
        cases = self.cases(task, cutoff_hz=cutoff_hz, excursion_k=excursion_k)
        errors = np.mean([pitch_errors_deg(case, calibrations, rule) for case in cases], axis=0)
        for session, (rms, now, largest) in zip(sessions, errors.tolist(), strict=True):
            yield Run(
                task=task.key, subject=self.number, session=session.name, offset=rule, role=role,
                excursion_k=self.rise_k if excursion_k is None else excursion_k,
                cutoff_hz=float("nan") if cutoff_hz is None else cutoff_hz,
                rms_deg=rms, real_time_deg=now, largest_deg=largest,
            )  # fmt: skip


def run_device(study: Study, number: int) -> list[Run]:
    """Run one device: all sessions in all tasks, the variations of the note's numbers, and the sensitivity in the first task."""
    device, runs = StudyDevice(study, number), list[Run]()
    for task in study.tasks:
        runs += device.runs(task, study.sessions, "session")
        tried = dict.fromkeys((numbers.cutoff_hz, numbers.session()) for _, _, numbers in task.variations())
        for cutoff_hz, pairs in groupby(sorted(tried, key=itemgetter(0)), key=itemgetter(0)):
            runs += device.runs(task, [session for _, session in pairs], "try", cutoff_hz=cutoff_hz)
    first = study.tasks[0]
    for rise in SENSITIVITY_K:
        runs += device.runs(first, study.sessions, "sensitivity", excursion_k=rise)
    runs += device.runs(first, study.sessions, "sensitivity", offset="rest" if study.offset == "none" else "none")
    return runs


def run_effects(study: Study, chosen: tuple[tuple[str, str], ...], number: int) -> list[Run]:
    """Run one device again with one kind of error, or all assumed errors, switched off, for chosen pairs of task and session."""
    effects = [effect for effect in EFFECTS if not (study.worn and effect == ASSUMED)]
    return [run for effect in effects for run in _chosen(StudyDevice(study, number, effect), chosen, effect)]


def run_chosen(study: Study, chosen: tuple[tuple[str, str], ...], number: int) -> list[Run]:
    """Run one device of the other group with chosen sessions only."""
    return [*_chosen(StudyDevice(study, number), chosen, "testing")]


def _chosen(device: StudyDevice, chosen: tuple[tuple[str, str], ...], role: str) -> Iterator[Run]:
    sessions_by_name = {session.name: session for session in device.study.sessions}
    for task in device.study.tasks:
        sessions = [sessions_by_name[name] for key, name in dict.fromkeys(chosen) if key == task.key]
        yield from device.runs(task, sessions, role)


def agrees(study: Study, session: CalibrationSession) -> bool:
    """Return True if the shipped fit of a session with device 0 equals the fit of this code, or if there is none."""
    device = StudyDevice(study, 0)
    shipped = shipped_fits().get(device.key(session))
    return shipped is None or agree(pack(device.fit(session)), shipped)


def with_checked_fits(study: Study, spread: Callable[..., Iterator[Any]]) -> Study:
    """Return the study with its choice of shipped fits. They are used if one for device 0 equals the fit of this code."""
    usable = study.offset != "motion" and bool(shipped_fits())
    return replace(study, shipped=usable and all(spread(partial(agrees, study), [CHECKED])))


# ---- all devices


def run_study(
    study: Study, spread: Callable[..., Iterator[Any]], advance: Callable[[int, int], None] = lambda done, total: None
) -> list[Run]:
    """Run devices until the mean error of each session is known to a quarter of the margin, or there are enough."""
    runs, done = list[Run](), 0
    wanted = study.subjects
    people = [
        len(task.motion.trials) for task in study.tasks if task.motion is not None and len(task.motion.trials) > 1
    ]
    most = max(study.subjects_max, study.subjects)
    if people:  # each person counts only once
        wanted, most = min(wanted, *people), min(most, *people)
    while done < wanted:
        for batch in spread(partial(run_device, study), range(done, wanted)):
            runs += batch
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
