"""Mistakes in scripts: the Python interface."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

import undrift
from mistakes import causes, habits, sound, worn
from mistakes.planting import Case, Change, Told, Wrong, mistake, planted, record_error
from mistakes.sound import poses, trial
from undrift.frames import quaternion_conjugate
from undrift.orientation import OrientSettings
from undrift.validation.trial import TrialSettings

# ---- sound calls, and how far from the truth


def _read(case: Case) -> undrift.Record:
    return case.recordings[0].record()


def _correct(case: Case) -> object:
    assert case.calibration is not None
    return undrift.correct(_read(case), case.calibration)


def _orient(case: Case) -> object:
    assert case.calibration is not None
    corrected = undrift.correct(_read(case), case.calibration)
    return undrift.orient(corrected, settings=OrientSettings(offset="rest"))


def _calibrate(case: Case) -> object:
    session = undrift.Session(
        kind="calibration",
        serial="",
        gravity_m_s2=sound.GRAVITY,
        records=tuple(one.record() for one in case.recordings),
    )
    return undrift.calibrate(session)


def _validate(case: Case) -> object:
    (reference,) = case.references
    assert isinstance(reference, undrift.Reference)
    settings = TrialSettings(offset="rest")
    return undrift.validate_trial(_read(case), reference, calibration=case.calibration, settings=settings)


def _noise(case: Case) -> object:
    return undrift.fit_noise(_read(case))


def corrected_error(case: Case, _: Path, told: Told) -> Wrong:
    """Return the error of what correct returned."""
    return record_error(told.answer, case.expected)


def tilt_error(case: Case, _: Path, told: Told) -> Wrong:
    """Return the largest error of the vertical."""
    return {"deg": worn.largest_tilt(told.answer.time, told.answer.q_nb, case)}


def later_error(case: Case, _: Path, told: Told) -> Wrong:
    """Return the error of a later recording, read in the same way."""
    assert case.later is not None
    return record_error(undrift.correct(case.later.record(), told.answer), case.expected)


def reported_error(_: Case, __: Path, told: Told) -> Wrong:
    """Return the error that the trial states."""
    return {"deg stated": told.answer.figures.rmse_total_deg}


def walk_error(_: Case, __: Path, told: Told) -> Wrong:
    """Return the angle random walk over its true value, whichever is more over the other."""
    true = float(np.max(sound.phone().gyro.white_noise.random_walk))
    walks = [axis.angle_random_walk.value for axis in told.answer.gyro]
    return {"times": max(max(one / true, true / one) for one in walks)}


@cache
def correct() -> Case:
    """Return a call of correct."""
    return replace(worn.correct(), route="python correct", call=_correct, wrong=corrected_error)


@cache
def orient() -> Case:
    """Return a call of orient."""
    return replace(worn.orient(), route="python orient", call=_orient, wrong=tilt_error)


@cache
def calibrate() -> Case:
    """Return a call of calibrate."""
    worn_trial = trial()
    return Case(
        route="python calibrate",
        recordings=(poses(),),
        call=_calibrate,
        later=worn_trial.recording,
        expected=worn_trial.right,
        wrong=later_error,
    )


@cache
def validate() -> Case:
    """Return a call of validate_trial."""
    return replace(worn.validate(), route="python validate", call=_validate, wrong=reported_error)


@cache
def noise() -> Case:
    """Return a call of fit_noise."""
    return Case(route="python noise", recordings=(sound.rest(),), call=_noise, wrong=walk_error)


# ---- changes of one thing


def on_its_side(case: Case) -> Case:
    """Give arrays with time along the second axis."""

    def call(held: Case) -> object:
        one = held.recordings[0]
        gyro = np.stack([one.columns[name] for name in one.gyro])
        return undrift.Record.from_arrays(gyro=gyro, gyro_unit="rad/s", sample_rate_hz=100.0)

    return replace(case, call=call)


def twice(case: Case) -> Case:
    """Correct what correct returned."""

    def call(held: Case) -> object:
        assert held.calibration is not None
        return undrift.correct(undrift.correct(_read(held), held.calibration), held.calibration)

    return replace(case, call=call)


def _reference(change: Callable[[undrift.Reference], undrift.Reference]) -> Change:
    return lambda case: replace(case, references=tuple(change(one) for one in case.references))  # type: ignore[arg-type]


MISTAKES = (
    *planted(correct, habits.NEGATED, habits.GYRO_YZ, habits.HALF_RATE),
    mistake(correct, "takes the calibration of another device", worn.another_device, causes.OTHER_DEVICE),
    mistake(correct, "corrects a corrected record again", twice, causes.ALREADY),
    mistake(correct, "gives arrays with time along the second axis", on_its_side, (r"time is axis 0",)),
    *planted(orient, habits.NEGATED, habits.ACCEL_XY, habits.RAD_FOR_DPS, habits.DOUBLE_RATE),
    *planted(calibrate, habits.GYRO_XY, habits.RAD_FOR_DPS, habits.HALF_RATE, habits.MS_FOR_S),
    *planted(validate, habits.GYRO_Y_REVERSED, habits.NEGATED),
    mistake(
        validate,
        "gives a reference that turns the laboratory to the body",
        _reference(lambda one: replace(one, q_nb=quaternion_conjugate(one.q_nb))),
        causes.CONJUGATE,
    ),
    *planted(noise, habits.DPS_FOR_RAD),
)
