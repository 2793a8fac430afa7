"""Mistakes on the page Recordings of the bench: a file dropped, its map confirmed, a button pressed."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

import undrift
from mistakes import causes, habits, sound, worn
from mistakes.planting import (
    Case,
    Told,
    Wrong,
    mistake,
    planted,
    record_error,
    written_references,
)
from mistakes.sound import poses, trial
from undrift.frames import quaternion_conjugate
from undrift.io.store import write_calibration
from undrift.web.bench import Visit
from undrift.web.place import Site
from undrift.web.recordings import StoredFile

# ---- what a page does


async def _dropped(case: Case, folder: Path, visit: Visit) -> StoredFile:
    """Drop the calibration and the file, and confirm the map that is proposed."""
    if case.calibration is not None:
        write_calibration(case.calibration, folder / "calibration.json")
        await visit.recordings.add(folder / "calibration.json")
    one = case.recordings[0].plain()
    held = await visit.recordings.add(one.write(folder, "recording0.csv"))
    if held.needs_map:
        units = {"gyro": one.units["gyro"], "accel": one.units["accel"]}
        visit.recordings.draft["units"] |= units
        if "sample_rate_hz" in visit.recordings.draft:
            visit.recordings.draft["sample_rate_hz"] = one.sample_rate_hz
        await visit.recordings.use_map(held)
    return held


async def _pressed(case: Case, folder: Path, visit: Visit) -> None:
    held = await _dropped(case, folder, visit)
    if not held.error:
        await visit.recordings.run(held, case.route.split()[1])


async def _validated(case: Case, folder: Path, visit: Visit) -> None:
    held = await _dropped(case, folder, visit)
    (path,) = written_references(case, folder)
    reference = await visit.recordings.add(path)
    form = visit.recordings.form
    form.markers, form.reference_up = map(str, (*case.words, "", "")[:2])
    if not held.error:
        await visit.recordings.validate(held, reference)


async def _calibrated(case: Case, folder: Path, visit: Visit) -> None:
    latitude_deg, turn_deg = (None if word is None else float(str(word)) for word in (*case.words, None)[:2])
    visit.bench.set_place(Site(latitude_deg=latitude_deg))
    held = await _dropped(case, folder, visit)
    held.serial = held.serial or "A1"
    if not held.error:
        await visit.recordings.calibrate(held, turn_deg=turn_deg)


def _made(told: Told, ending: str) -> Path:
    visit = told.answer
    return next(path for one in visit.library.files for path in one.made.values() if path.name.endswith(ending))


def corrected_error(case: Case, _: Path, told: Told) -> Wrong:
    """Return the error of what the page lets a person download."""
    return record_error(undrift.read_record(_made(told, "corrected.parquet")), case.expected)


def tilt_error(case: Case, _: Path, told: Told) -> Wrong:
    """Return the largest error of the vertical."""
    rows = np.genfromtxt(_made(told, "angles.csv"), delimiter=",", names=True)
    return {"deg": worn.largest_tilt(rows["time_s"], np.column_stack([rows[f"q_{k}"] for k in "wxyz"]), case)}


def reported_error(_: Case, __: Path, told: Told) -> Wrong:
    """Return the error that the page states."""
    import json

    return {"deg stated": json.loads(_made(told, "validation.json").read_text())["mean"]["rmse_total_deg"]}


def later_error(case: Case, _: Path, told: Told) -> Wrong:
    """Return the error of a later recording, read in the same way."""
    assert case.later is not None
    made = undrift.read_calibration(told.answer.bench.job.calibration)
    return record_error(undrift.correct(case.later.record(), made), case.expected)


# ---- sound input


@cache
def correct() -> Case:
    """Return the button Correct."""
    return replace(worn.correct(), route="bench correct", page=_pressed, wrong=corrected_error)


@cache
def orient() -> Case:
    """Return the button Orient."""
    return replace(worn.correct(), route="bench orient", page=_pressed, wrong=tilt_error)


@cache
def validate() -> Case:
    """Return the button Validate."""
    return replace(worn.validate(), route="bench validate", words=(), page=_validated, wrong=reported_error)


@cache
def validate_markers() -> Case:
    """Return the button Validate, with markers of a laboratory whose y points up."""
    held = worn.validate_markers()
    return replace(validate(), references=held.references, words=(",".join(worn.MARKERS), "y"))


@cache
def calibrate() -> Case:
    """Return the button Calibrate."""
    held = trial()
    return Case(
        route="bench calibrate",
        recordings=(poses(),),
        words=(sound.LATITUDE_DEG,),
        page=_calibrated,
        later=held.recording,
        expected=held.right,
        wrong=later_error,
    )


@cache
def calibrate_turns() -> Case:
    """Return the button Calibrate, with six faces and full turns."""
    return replace(calibrate(), recordings=(sound.faces_and_turns(),), words=(sound.LATITUDE_DEG, 360.0))


def _conjugated(case: Case) -> Case:
    (one,) = case.references
    assert isinstance(one, undrift.Reference)
    return replace(case, references=(replace(one, q_nb=quaternion_conjugate(one.q_nb)),))


MISTAKES = (
    *planted(correct, habits.NEGATED, habits.DPS_FOR_RAD, habits.GYRO_XY),
    mistake(correct, "takes the calibration of another device", worn.another_device, causes.OTHER_DEVICE),
    mistake(
        correct, "has a calibration of 25 degC and a recording of 45 degC", worn.twenty_degrees_warmer, causes.FAR_TEMP
    ),
    *planted(orient, habits.NEGATED, habits.ACCEL_RING, habits.GYRO_RING, habits.HALF_RATE, habits.RAD_FOR_DPS),
    mistake(orient, "takes the calibration of another device", worn.another_device, causes.OTHER_DEVICE),
    mistake(validate, "gives a reference that turns the laboratory to the body", _conjugated, causes.CONJUGATE),
    mistake(
        validate_markers,
        "chooses z up of a laboratory whose y points up",
        lambda case: replace(case, words=(case.words[0], "z")),
        causes.REFERENCE_UP,
    ),
    *planted(calibrate, habits.GYRO_YZ, habits.RAD_FOR_DPS),
    replace(
        mistake(
            calibrate_turns,
            "states no place and so no gravity",
            lambda case: replace(case, words=(None, 360.0)),
            causes.GRAVITY_ASSUMED,
        ),
        noted=True,
    ),
)
