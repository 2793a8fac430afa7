"""Mistakes with how a device is worn, with folders, and with calibrations of other programs."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mistakes import causes, habits, sound, worn
from mistakes.planting import Case, Change, Told, Wrong, later_error, mistake, planted, with_recordings
from mistakes.sound import ACCEL, GYRO, Recording, recording_of, trial
from testkit.ferraris import ferraris_text
from testkit.walking import misplaced, walk
from undrift.frames import rotation

# ---- sound input, and how far from the truth


@cache
def _worn(place: str = "lower-back", turned: float = 0.0) -> tuple[Recording, np.ndarray]:
    """Return a person who stands and walks, and the rotation from device to body."""
    rng = np.random.default_rng(7003)
    q_ab = misplaced(rng, 20.0, np.array([np.cos(turned / 2.0), 0.0, 0.0, np.sin(turned / 2.0)]))
    return recording_of(walk(rng, place, q_ab=q_ab)), rotation(q_ab).as_matrix()


def mounting_error(_: Case, __: Path, told: Told) -> Wrong:
    """Return the angle between the mounting that was found and the true one; NaN where none was found."""
    result = told.answer["mounting"]
    if result is None:
        return {"deg": np.inf}
    return {
        "deg": float(
            np.degrees((Rotation.from_matrix(result["matrix"]) * Rotation.from_matrix(_worn()[1]).inv()).magnitude())
        )
    }


@cache
def mount() -> Case:
    """Return a person who stands and walks, and where the device is worn."""
    return Case(route="mount", recordings=(_worn()[0],), words=("--worn", "lower-back"), wrong=mounting_error)


@cache
def from_motion() -> Case:
    """Return a recording in which the device is turned, and a later one."""
    worn_trial = trial()
    return Case(
        route="calibrate", recordings=(worn_trial.recording,), words=("--from", "motion"), later=worn_trial.recording,
        expected=worn_trial.right, wrong=later_error,
    )  # fmt: skip


@cache
def folder() -> Case:
    """Return three recordings of one device in a folder, and its calibration."""
    worn_trial = trial()
    return replace(worn.correct(), recordings=(worn_trial.recording,) * 3, together=True, wrong=None)


@cache
def imucal() -> Case:
    """Return a recording, and its calibration by imucal."""
    return _with_file(worn.correct(), "imucal.json", ferraris_text(sound.calibrated()))


def _with_file(case: Case, name: str, text: str) -> Case:
    def write(folder: Path) -> None:
        (folder / name).write_text(text)

    return replace(case, calibration=None, words=("--calibration", f"{{folder}}/{name}"), edit=write)


# ---- changes of one thing


def slipped(case: Case) -> Case:
    """Let the device turn by 40 deg in its pouch after a part of the walks, in another recording of the same wearing."""
    (one,) = case.recordings
    time = one.columns["t"]
    first, second = one.rows(time < 27.0), one.rows(time >= 27.0)
    turn = Rotation.from_rotvec([0.0, 0.0, np.radians(40.0)]).as_matrix()
    for names in (GYRO, ACCEL):
        turned = np.stack([second.columns[name] for name in names], axis=1) @ turn.T
        second = second.with_columns(**dict(zip(names, turned.T, strict=True)))
    return replace(case, recordings=(first, second))


def one_of(number: int, change: Callable[[Recording], Recording]) -> Change:
    """Return the change of one recording of several."""
    return lambda case: replace(
        case, recordings=tuple(change(one) if k == number else one for k, one in enumerate(case.recordings))
    )


def _rows(start_s: float, stop_s: float) -> Callable[[Recording], Recording]:
    return lambda one: one.rows((one.columns["t"] >= start_s) & (one.columns["t"] < stop_s))


def _of_another_device(case: Case) -> Case:
    name = str(case.words[-1]).removeprefix("{folder}/")
    return _with_file(case, name, ferraris_text(sound.calibrated(99)))


MOUNT = [
    *planted(
        mount, habits.ACCEL_XY, habits.GYRO_YZ, habits.NEGATED, habits.DPS_FOR_RAD, habits.MS_FOR_S, habits.HALF_RATE,
        habits.SENSORS_SWAPPED, habits.NO_GRAVITY,
    ),
    mistake(mount, "stands and does not walk", with_recordings(_rows(0.0, 4.0)), (r"walk straight", r"show\w* forward")),
    mistake(mount, "never stands", with_recordings(_rows(6.0, 12.0)), (r"stand",)),
    mistake(mount, "lets the device slip in its pouch between two recordings", slipped, (r"slip", r"apart|disagree",)),
]  # fmt: skip
FOLDER = [
    mistake(
        folder,
        "has a file of another device in the folder",
        one_of(1, lambda _: trial(seed=99).recording),
        causes.OTHER_DEVICE,
    ),
    mistake(
        folder,
        "has a file in deg/s among those in rad/s",
        one_of(2, lambda one: one.scaled(GYRO, np.degrees(1.0))),
        causes.DPS_FOR_RAD,
    ),
    mistake(folder, "takes the calibration of another device", worn.another_device, causes.OTHER_DEVICE),
]
FOREIGN = [
    mistake(imucal, "takes the imucal calibration of another device", _of_another_device, causes.OTHER_DEVICE),
    *planted(imucal, habits.NEGATED, habits.DPS_FOR_RAD),
]
MOTION = planted(
    from_motion, habits.GYRO_YZ, habits.GYRO_Y_REVERSED, habits.ACCEL_XY, habits.SENSORS_SWAPPED, habits.HALF_RATE
)
MISTAKES = (*MOUNT, *FOLDER, *FOREIGN, *MOTION)
