"""Mistakes on the page of the bench: a file dropped, its map confirmed, a button pressed."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

import undrift
from mistakes import causes, habits, sound, worn
from mistakes.planting import Case, Told, Wrong, mistake, planted, record_error
from mistakes.sound import poses, trial
from undrift.io.store import write_calibration
from undrift.web.bench import Bench
from undrift.web.items import Item
from undrift.web.place import Site

# ---- what a page does


async def _dropped(case: Case, folder: Path, bench: Bench) -> Item:
    """Drop the calibration and the file, and confirm the map that is proposed."""
    places = [bench.folder / "uploads" / name for name in ("calibration", "recording")]
    for place in places:
        place.mkdir()
    if case.calibration is not None:
        write_calibration(case.calibration, places[0] / "device.json")
        await bench.add([places[0] / "device.json"])
    one = case.recordings[0].plain()
    await bench.add([one.write(places[1], "recording0.csv")])
    item = bench.items[0]
    if item.draft:
        item.draft["units"] |= {"gyro": one.units["gyro"], "accel": one.units["accel"]}
        if "sample_rate_hz" in item.draft:
            item.draft["sample_rate_hz"] = one.sample_rate_hz
        await bench.read_again(item)
    return item


async def _corrected(case: Case, folder: Path, bench: Bench) -> None:
    await bench.correct(await _dropped(case, folder, bench))


async def _oriented(case: Case, folder: Path, bench: Bench) -> None:
    await bench.orient(await _dropped(case, folder, bench))


async def _calibrated(case: Case, folder: Path, bench: Bench) -> None:
    latitude_deg, turn_deg = (None if word is None else float(str(word)) for word in (*case.words, None)[:2])
    bench.set_place(Site(latitude_deg=latitude_deg))
    item = await _dropped(case, folder, bench)
    item.turn_deg = turn_deg
    await bench.calibrate(item)


def _made(told: Told, ending: str) -> Path:
    return next(path for item in told.answer.items for path in item.folder.glob(f"*{ending}"))


def corrected_error(case: Case, _: Path, told: Told) -> Wrong:
    """Return the error of what the page lets a person download."""
    return record_error(undrift.read_record(_made(told, "corrected.csv")), case.expected)


def tilt_error(case: Case, _: Path, told: Told) -> Wrong:
    """Return the largest error of the vertical."""
    rows = np.genfromtxt(_made(told, "angles.csv"), delimiter=",", names=True)
    return {"deg": worn.largest_tilt(rows["time_s"], np.column_stack([rows[f"q_{k}"] for k in "wxyz"]), case)}


def later_error(case: Case, _: Path, told: Told) -> Wrong:
    """Return the error of a later recording, read in the same way."""
    assert case.later is not None
    calibration = undrift.read_calibration(told.answer.calibration)
    return record_error(undrift.correct(case.later.record(), calibration), case.expected)


# ---- sound input


@cache
def correct() -> Case:
    """Return the button Correct."""
    return replace(worn.correct(), route="bench correct", page=_corrected, wrong=corrected_error)


@cache
def orient() -> Case:
    """Return the button Orient."""
    return replace(worn.correct(), route="bench orient", page=_oriented, wrong=tilt_error)


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


MISTAKES = (
    *planted(correct, habits.NEGATED, habits.DPS_FOR_RAD, habits.GYRO_XY),
    mistake(correct, "takes the calibration of another device", worn.another_device, causes.OTHER_DEVICE),
    mistake(
        correct, "has a calibration of 25 degC and a recording of 45 degC", worn.twenty_degrees_warmer, causes.FAR_TEMP
    ),
    *planted(orient, habits.NEGATED, habits.ACCEL_RING, habits.GYRO_RING, habits.HALF_RATE, habits.RAD_FOR_DPS),
    mistake(orient, "takes the calibration of another device", worn.another_device, causes.OTHER_DEVICE),
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
