"""Unit of work: one subject in one task with one cut-off frequency, all protocols of it.

For each protocol: simulate the session -> fit -> tables -> correct the trial -> orient -> compare. Nothing but the readings
passes from the simulated device to the fit.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import CalibrationError
from undrift.study.calibrate import calibrate_as_the_note
from undrift.study.case import make_case, pitch_error, seeded
from undrift.study.plan import Study, StudyTask
from undrift.study.session import impose, read_session
from undrift.units import RADIAN_PER_DEGREE

COLUMNS = (
    "cutoff_hz",
    "turn_rate_step_dps",
    "turn_rate_min_dps",
    "turn_rate_max_dps",
    "error_rms_deg",
    "error_max_deg",
    "rig_minutes",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """A subject in a task with a cut-off frequency.

    Parameters
    ----------
    study : Study
        Seed, device, temperatures.
    task : StudyTask
        With its protocols.
    subject : int
        From 0.
    cutoff_hz : float
        Hz.
    """

    study: Study
    task: StudyTask
    subject: int
    cutoff_hz: float

    @property
    def key(self) -> str:
        """Name of the unit, good for a file."""
        return f"{self.task.name}-{self.subject:04d}-{self.cutoff_hz:g}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UnitRuns:
    """Runs of a unit, one for each protocol.

    Parameters
    ----------
    cutoff_hz, turn_rate_step_dps, turn_rate_min_dps, turn_rate_max_dps : array, shape (P,)
        The protocol, Hz and deg/s.
    error_rms_deg, error_max_deg : array, shape (P,)
        Pitch error over the motion, deg; NaN where the protocol could not calibrate the device.
    rig_minutes : array, shape (P,)
        Length of the session, min.
    """

    cutoff_hz: FloatArray
    turn_rate_step_dps: FloatArray
    turn_rate_min_dps: FloatArray
    turn_rate_max_dps: FloatArray
    error_rms_deg: FloatArray
    error_max_deg: FloatArray
    rig_minutes: FloatArray


def units_of(study: Study) -> tuple[Unit, ...]:
    """Return the units of a study.

    Parameters
    ----------
    study : Study
        What to do.

    Returns
    -------
    tuple of Unit
        By task, subject, cut-off frequency.
    """
    return tuple(
        Unit(study=study, task=task, subject=subject, cutoff_hz=cutoff)
        for task in study.tasks
        for subject in range(study.subjects)
        for cutoff in task.space.cutoff_hz
    )


def run_unit(unit: Unit) -> UnitRuns:
    """Run all protocols of a unit.

    Parameters
    ----------
    unit : Unit
        Which.

    Returns
    -------
    UnitRuns
        Error of each; the same bits wherever it runs.
    """
    study, protocols = unit.study, unit.task.candidates(unit.cutoff_hz)
    case = make_case(study, unit.task, unit.subject, unit.cutoff_hz)
    rms, worst, minutes = (np.full(len(protocols), np.nan) for _ in range(3))
    for k, protocol in enumerate(protocols):
        rng = seeded(study, "session", unit.task.name, unit.subject, k)
        imposed = impose(protocol)
        minutes[k] = imposed.duration_s / 60.0
        readings = read_session(imposed, case.device, rng=rng)
        try:
            calibration = calibrate_as_the_note(
                imposed, readings, unit_gyro=case.device.gyro.unit, unit_accel=case.device.accel.unit
            )
        except CalibrationError:  # this protocol cannot calibrate this device: no error to report, and not a zero
            continue
        error = pitch_error(case, calibration) / RADIAN_PER_DEGREE
        rms[k], worst[k] = np.sqrt(np.nanmean(error**2)), np.nanmax(np.abs(error))
    dps = [np.array([getattr(p, name) for p in protocols]) / RADIAN_PER_DEGREE for name in _GRID]
    return UnitRuns(
        cutoff_hz=np.full(len(protocols), unit.cutoff_hz),
        turn_rate_step_dps=dps[0],
        turn_rate_min_dps=dps[1],
        turn_rate_max_dps=dps[2],
        error_rms_deg=rms,
        error_max_deg=worst,
        rig_minutes=minutes,
    )


_GRID = ("turn_rate_step", "turn_rate_min", "turn_rate_max")
