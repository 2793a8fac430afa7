"""Mistakes with how a device is worn, with several devices on one clock, with folders, and with calibrations of other programs."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mistakes import causes, habits, sound, worn
from mistakes.planting import Case, Change, Told, Wrong, later_error, mistake, planted, with_recordings
from mistakes.sound import ACCEL, GYRO, Recording, recording_of, trial
from testkit.hand_turns import Device, make_recording
from testkit.walking import misplaced, walk
from undrift.export.autopilots import export_px4
from undrift.export.programs import export_imucal
from undrift.frames import rotation

OFFSET_S, SKEW = 3.7, 1.2e-4

# ---- sound input, and how far from the truth


@cache
def _worn(place: str = "lower-back", turned: float = 0.0) -> tuple[Recording, np.ndarray]:
    """Return a person who stands and walks, and the rotation from device to body."""
    rng = np.random.default_rng(7003)
    q_ab = misplaced(rng, 20.0, np.array([np.cos(turned / 2.0), 0.0, 0.0, np.sin(turned / 2.0)]))
    return recording_of(walk(rng, place, q_ab=q_ab)), rotation(q_ab).as_matrix()


def mounting_error(_: Case, __: Path, told: Told) -> Wrong:
    """Return the angle between the mounting that was found and the true one; NaN where none was found."""
    made = told.answer["mounting"]
    if made is None:
        return {"deg": np.inf}
    return {
        "deg": float(
            np.degrees((Rotation.from_matrix(made["matrix"]) * Rotation.from_matrix(_worn()[1]).inv()).magnitude())
        )
    }


def clock_error(_: Case, __: Path, told: Told) -> Wrong:
    """Return how far the clock that was found is from the true one."""
    one = told.answer["recordings"][1]
    if not one["synced"]:
        return {"ms": np.inf}
    return {"ms": 1e3 * abs(one["offset_s"] - OFFSET_S - SKEW * one["at_s"])}


def _two_of(seed: int) -> tuple[Recording, Recording]:
    """Return every other sample of one motion, as two devices would have them, the second turned and on a clock of its own."""
    rng = np.random.default_rng(seed)
    record, _ = make_recording(rng, noise_of_a_part())
    first, other = (
        replace(record, time=record.time[k::2], gyro=record.gyro[k::2], accel=record.accel[k::2]) for k in (0, 1)
    )
    turned = Rotation.random(random_state=rng).as_matrix().T
    clock = other.time + OFFSET_S + SKEW * other.time
    return recording_of(first), recording_of(
        replace(other, time=clock, gyro=other.gyro @ turned, accel=other.accel @ turned)
    )


def noise_of_a_part() -> Device:
    """Return a device whose rates scatter by 0.1 deg/s."""
    return Device(forward=np.eye(3), offset=np.array([0.01, -0.02, 0.005]), noise=0.002)


@cache
def mount() -> Case:
    """Return a person who stands and walks, and where the device is worn."""
    return Case(route="mount", recordings=(_worn()[0],), words=("--worn", "lower-back"), wrong=mounting_error)


@cache
def sync() -> Case:
    """Return two recordings of one motion by devices that were begun on their own."""
    first, other = _two_of(8)
    return Case(route="sync", recordings=(first, other), wrong=clock_error)


@cache
def from_motion() -> Case:
    """Return a recording in counts in which the device is turned, and a later one."""
    held = sound.counted_trial()
    return Case(
        route="calibrate", recordings=(held.recording,), words=("--from", "motion"), later=held.recording,
        expected=held.right, wrong=later_error,
    )  # fmt: skip


@cache
def folder() -> Case:
    """Return three recordings of one device in a folder, and its calibration."""
    held = trial()
    return replace(worn.correct(), recordings=(held.recording,) * 3, together=True, wrong=None)


@cache
def board() -> Case:
    """Return a recording, and the parameters of an autopilot that has its calibration."""
    return _with_file(worn.correct(), "board.params", export_px4(sound.calibrated()).text)


@cache
def imucal() -> Case:
    """Return a recording, and its calibration by imucal."""
    return _with_file(worn.correct(), "imucal.json", export_imucal(sound.calibrated()).text)


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


def _another_motion(_: Recording) -> Recording:
    return _two_of(9)[1]


def _faster_clock(one: Recording) -> Recording:
    return one.with_columns(t=2.0 * one.columns["t"])


def _of_another_device(case: Case) -> Case:
    name = str(case.words[-1]).removeprefix("{folder}/")
    export = export_px4 if name.endswith(".params") else export_imucal
    return _with_file(case, name, export(sound.calibrated(99)).text)


NOT_ONE_MOTION = (r"shares? (?:too little|no) motion",)
MOUNT = [
    *planted(
        mount, habits.ACCEL_XY, habits.GYRO_YZ, habits.NEGATED, habits.DPS_FOR_RAD, habits.MS_FOR_S, habits.HALF_RATE,
        habits.SENSORS_SWAPPED, habits.NO_GRAVITY,
    ),
    mistake(mount, "stands and does not walk", with_recordings(_rows(0.0, 4.0)), (r"walk straight", r"show\w* forward")),
    mistake(mount, "never stands", with_recordings(_rows(6.0, 12.0)), (r"stand",)),
    mistake(mount, "lets the device slip in its pouch between two recordings", slipped, (r"slip", r"apart|disagree",)),
]  # fmt: skip
SYNC = [
    mistake(sync, "gives a recording of another day", one_of(1, _another_motion), NOT_ONE_MOTION),
    mistake(
        sync,
        "states half the rate of one of them",
        one_of(1, _faster_clock),
        (*NOT_ONE_MOTION, r"sample rate|skew|clock"),
    ),
    mistake(sync, "gives a part that rests", one_of(1, _rows(0.0, 8.0)), (*NOT_ONE_MOTION, r"rest|moves? |turn")),
]
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
    mistake(board, "takes the parameters of another board", _of_another_device, causes.OTHER_DEVICE),
    mistake(imucal, "takes the imucal calibration of another device", _of_another_device, causes.OTHER_DEVICE),
    *planted(board, habits.NEGATED, habits.DPS_FOR_RAD),
]
MOTION = planted(
    from_motion, habits.GYRO_YZ, habits.GYRO_Y_REVERSED, habits.ACCEL_XY, habits.SENSORS_SWAPPED, habits.HALF_RATE
)
MISTAKES = (*MOUNT, *SYNC, *FOLDER, *FOREIGN, *MOTION)
