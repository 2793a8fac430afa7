"""Mistakes with a recording of a worn device: correct, orient, validate."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

import undrift
from mistakes import causes, habits, sound
from mistakes.planting import (
    Case,
    Change,
    Told,
    Wrong,
    later_error,
    mistake,
    planted,
    record_error,
    with_recordings,
)
from mistakes.sound import ACCEL, GYRO, trial
from testkit.trc_text import trc
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.io.text import write_rows
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.motion import turn_quaternion

# ---- sound input, and how far from the truth


def corrected_error(case: Case, folder: Path, _: Told) -> Wrong:
    """Return the error of what correct wrote."""
    return record_error(undrift.read_record(folder / "made.parquet"), case.expected)


def tilt_error(case: Case, folder: Path, _: Told) -> Wrong:
    """Return the largest error of the vertical that orient found, at the moments that it states."""
    assert case.motion is not None
    values = pq.read_table(folder / "made.parquet").to_pydict()
    return {"deg": largest_tilt(np.array(values["time_s"]), np.column_stack([values[f"q_{k}"] for k in "wxyz"]), case)}


def largest_tilt(time: np.ndarray, q_nb: np.ndarray, case: Case) -> float:
    """Return the largest angle between the vertical that was found and the true one, deg."""
    assert case.motion is not None
    nearest = np.clip(np.searchsorted(case.motion.time, time), 0, len(case.motion.time) - 1)
    up = np.array([0.0, 0.0, 1.0])
    result, true = (rotate(quaternion_conjugate(q), up) for q in (q_nb, case.motion.q_nb[nearest]))
    return float(np.degrees(np.arccos(np.clip((result * true).sum(axis=1), -1.0, 1.0))).max())


def pitch_error(case: Case, folder: Path, _: Told) -> Wrong:
    """Return the largest error of the pitch of the trunk."""
    assert case.motion is not None
    result = np.array(pq.read_table(folder / "made.parquet").to_pydict()["pitch_deg"])
    up = rotate(quaternion_conjugate(case.motion.q_nb), np.array([0.0, 0.0, 1.0]))
    return {"deg of pitch": float(np.nanmax(np.abs(result - np.degrees(np.arctan2(-up[:, 0], up[:, 2])))))}


def reported_error(_: Case, __: Path, told: Told) -> Wrong:
    """Return the error that validate states of the device."""
    return {"deg stated": max(one["rmse_total_deg"] for one in told.answer["trials"])}


def fitted_error(case: Case, folder: Path, told: Told) -> Wrong:
    """Return the error of a later recording, by the calibration that was fitted to the reference."""
    (folder / "made" / "calibration.json").rename(folder / "made.json")
    return later_error(case, folder, told)


@cache
def correct() -> Case:
    """Return a recording to correct."""
    worn_trial = trial()
    return Case(
        route="correct",
        recordings=(worn_trial.recording,),
        calibration=sound.calibrated(),
        expected=worn_trial.right,
        motion=worn_trial.motion,
        wrong=corrected_error,
    )


@cache
def correct_by_table() -> Case:
    """Return a recording to correct by a table over temperature."""
    tables = undrift.fit_drift([sound.soak()], calibration=sound.calibrated()).calibration
    return replace(correct(), calibration=tables)


@cache
def orient() -> Case:
    """Return a recording to orient."""
    return replace(correct(), route="orient", words=("--offset", "rest"), wrong=tilt_error)


@cache
def validate() -> Case:
    """Return a recording with its reference."""
    worn_trial = trial()
    return replace(orient(), route="validate", references=(worn_trial.reference,), wrong=reported_error)


@cache
def validate_fit() -> Case:
    """Return a recording whose reference is to calibrate the device, and a later one."""
    worn_trial = trial()
    return Case(
        route="validate",
        recordings=(worn_trial.recording,),
        words=("--calibrate-from", "reference"),
        references=(worn_trial.reference,),
        later=worn_trial.recording,
        expected=worn_trial.right,
        wrong=fitted_error,
    )


@cache
def worn_pitch() -> Case:
    """Return a sit-to-stand with a device worn with its x up and its z to the left, and the options that say so."""
    worn_trial = trial("sit_to_stand")
    return Case(
        route="orient",
        recordings=(sound.remounted(worn_trial.recording),),
        words=("--offset", "rest", "--forward", "+y", "--up", "+x"),
        calibration=sound.calibrated(remounted_=True),
        motion=worn_trial.motion,
        wrong=pitch_error,
    )


MARKERS = ("A", "B", "C", "D")


def markers_of(reference: undrift.Reference, *, mirrored: bool = False, unit: str = "m") -> str:
    """Return a cluster of four markers on the device as TRC, in a laboratory whose y points up."""
    arms = np.array([[0.08, 0.0, 0.0], [-0.05, 0.07, 0.0], [-0.04, -0.06, 0.03], [0.0, 0.02, 0.09]])
    values = np.asarray(reference.q_nb)
    places = np.zeros((len(values), 3)) if reference.position is None else reference.position
    points = np.stack([places + rotate(values, arm) for arm in arms], axis=1)
    x, y, z = np.moveaxis(points, -1, 0)
    return trc(np.stack((x, z, y if mirrored else -y), axis=-1), MARKERS, unit=unit)


@cache
def validate_markers() -> Case:
    """Return a recording with markers of a laboratory whose y points up."""
    words = (*orient().words, "--markers", ",".join(MARKERS), "--reference-up", "y")
    return replace(validate(), words=words, references=(markers_of(trial().reference),))


# ---- changes of one thing


def _calibration(made: undrift.Calibration) -> Change:
    return lambda case: replace(case, calibration=made)


def another_device(case: Case) -> Case:
    """Take the calibration of another phone; neither states a serial number."""
    return replace(case, calibration=sound.calibrated(13))


def another_serial(case: Case) -> Case:
    """Take the calibration of another phone, whose serial number it states, as the map does of the recording."""
    other = replace(sound.calibrated(13), device="B2")
    recordings = tuple(replace(one, more='device = "A1"') for one in case.recordings)
    return replace(case, calibration=other, recordings=recordings)


def _at(temp_c: float) -> Change:
    """Return the change that records at another temperature."""

    def changed(case: Case) -> Case:
        result = undrift.simulate_trial(
            "free", sound.phone(), rng=np.random.default_rng(21), temp_c=temp_c, gravity_m_s2=sound.GRAVITY
        )
        right = undrift.correct(result.record, true_calibration(sound.phone(), temp_c=temp_c))
        return replace(case, recordings=(sound.recording_of(result.record),), expected=right)

    return changed


twenty_degrees_warmer = _at(45.0)


def cold_in_degf(case: Case) -> Case:
    """Record at 4 degC with a thermometer in degF, whose 39 are inside the table in degC."""
    return with_recordings(habits.FAHRENHEIT.change)(_at(4.0)(case))


def corrected_before(case: Case) -> Case:
    """Give a recording that was corrected before, in a file that does not say so, to be corrected again."""
    return replace(case, recordings=(sound.recording_of(undrift.correct(trial().record, sound.calibrated())),))


def marked_corrected(case: Case) -> Case:
    """Give a file that undrift itself corrected."""

    def edit(folder: Path) -> None:
        record = undrift.correct(trial().record, sound.calibrated())
        undrift.write_record(record, folder / "recording0.csv")

    return replace(case, edit=edit, mapped=False)


def sensor_logger_on_ios(case: Case) -> Case:
    """Give the folder that Sensor Logger writes on iOS, whose acceleration is negative up, without its Metadata.csv."""

    def edit(folder: Path) -> None:
        values = case.recordings[0].columns
        (folder / "recording0.csv").unlink()
        (folder / "recording0.csv").mkdir()
        for file, names, sign in (("TotalAcceleration.csv", ACCEL, -1.0), ("Gyroscope.csv", GYRO, 1.0)):
            x, y, z = (sign * values[name] for name in names)
            columns = (1.7e18 + np.round(1e9 * values["t"]), values["t"], z, y, x)
            write_rows(folder / "recording0.csv" / file, ("time", "seconds_elapsed", "z", "y", "x"), columns)

    return replace(case, edit=edit, mapped=False)


def other_kind(case: Case) -> Case:
    """Name a file of another program as calibration.json."""

    def edit(folder: Path) -> None:
        (folder / "calibration.json").write_text('{"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "bias": [0, 0, 0]}')

    return replace(case, edit=edit)


def other_format(case: Case) -> Case:
    """Name a calibration of a format that this undrift does not know."""

    def edit(folder: Path) -> None:
        path = folder / "calibration.json"
        path.write_text(path.read_text().replace('"format": 1', '"format": 0').replace('"format":1', '"format":0'))

    return replace(case, edit=edit)


def turning_in_the_rest(case: Case) -> Case:
    """Turn the device about x by half a degree a second in the rest at the start."""
    values, rate = trial(), np.radians(0.5)
    time = values.motion.time
    back = np.where(time < values.motion.time[0] + 5.5, rate * (time - 5.5), 0.0)
    turn = turn_quaternion(np.array([1.0, 0.0, 0.0]), back)
    one, force = values.recording, np.stack([values.recording.columns[name] for name in ACCEL], axis=1)
    columns = dict(zip(ACCEL, rotate(quaternion_conjugate(turn), force).T, strict=True))
    turned = one.with_columns(**columns, gx=one.columns["gx"] + np.where(back < 0.0, rate, 0.0))
    motion = replace(values.motion, q_nb=quaternion_product(values.motion.q_nb, turn))
    return replace(case, recordings=(turned,), motion=motion)


def _in_mm(one: undrift.Reference) -> undrift.Reference:
    """Return a reference with its positions in mm, as a file may hold them; the value itself refuses them."""
    result = replace(one)
    object.__setattr__(result, "position", 1e3 * np.asarray(one.position))
    return result


def _reference(change) -> Change:
    def changed(case: Case) -> Case:
        (one,) = case.references
        assert isinstance(one, undrift.Reference)
        return replace(case, references=(change(one),))

    return changed


def _other_body(one: undrift.Reference) -> undrift.Reference:
    bend = 0.35 * np.sin(2.0 * np.pi * 0.4 * (one.time - one.time[0]))
    bend = np.where(np.asarray(one.moving) > 0.5, bend, 0.0) if one.moving is not None else bend
    return replace(one, q_nb=quaternion_product(one.q_nb, turn_quaternion(np.array([0.0, 1.0, 0.0]), bend)))


def _mirrored(one: undrift.Reference) -> undrift.Reference:
    return replace(one, q_nb=np.asarray(one.q_nb) * [1.0, -1.0, 1.0, -1.0])


def _other_trial(_: undrift.Reference) -> undrift.Reference:
    other = undrift.simulate_trial(
        "free", sound.phone(), rng=np.random.default_rng(99), temp_c=sound.TEMP_C, gravity_m_s2=sound.GRAVITY
    )
    return other.reference


def without(*left_out: object) -> Change:
    """Return the change that leaves options out."""
    return lambda case: replace(case, words=tuple(word for word in case.words if word not in left_out))


def saying(*words: object) -> Change:
    """Return the change that says other options."""
    return lambda case: replace(case, words=words)


def _markers(*, mirrored: bool = False) -> Change:
    return lambda case: replace(case, references=(markers_of(trial().reference, mirrored=mirrored),))


# ---- the list


ORIENT = [
    *planted(
        orient,
        habits.ACCEL_XY,
        habits.ACCEL_RING,
        habits.GYRO_YZ,
        habits.GYRO_RING,
        habits.GYRO_Y_REVERSED,
        habits.GYRO_REVERSED,
        habits.ACCEL_Z_REVERSED,
        habits.NEGATED,
        habits.LEFT_HANDED,
        habits.DPS_FOR_RAD,
        habits.RAD_FOR_DPS,
        habits.MDPS_FOR_DPS,
        habits.G_FOR_SI,
        habits.SI_FOR_G,
        habits.MS_FOR_S,
        habits.US_FOR_S,
        habits.NS_FOR_S,
        habits.S_FOR_MS,
        habits.HALF_RATE,
        habits.DOUBLE_RATE,
        habits.TEMPERATURE_AS_ACCEL,
        habits.SENSORS_SWAPPED,
        habits.NO_GRAVITY,
        habits.DOUBLED_ROWS,
        habits.REVERSED_TIME,
        habits.GYRO_CLIPPED,
    ),
    mistake(orient, "takes the calibration of another device", another_device, causes.OTHER_DEVICE),
    mistake(
        orient, "gives a folder of Sensor Logger on iOS, without Metadata.csv", sensor_logger_on_ios, causes.NEGATED
    ),
    mistake(orient, "corrects a corrected recording again", marked_corrected, causes.ALREADY),
    mistake(orient, "turns slowly in the rest at the start", turning_in_the_rest, causes.NOT_STILL),
    mistake(
        orient,
        "names a stretch of motion as the rest",
        saying("--offset", "rest", "--rest-s", "20:24"),
        causes.NOT_STILL,
    ),
    mistake(
        orient,
        "loses two seconds of rows in the motion",
        with_recordings(lambda one: habits.gap(one, 20.0, 22.0, kept=False)),
        causes.DROPPED,
    ),
    mistake(
        orient,
        "has two seconds of NaN in the motion",
        with_recordings(lambda one: habits.gap(one, 20.0, 22.0, kept=True)),
        causes.DROPPED,
    ),
    mistake(
        worn_pitch, "leaves --forward and --up out for a worn device", saying("--offset", "rest"), causes.UPSIDE_DOWN
    ),
    mistake(
        worn_pitch,
        "mounts the device upside down",
        with_recordings(lambda one: one.scaled(("gx", "gz", "ax", "az"), -1.0)),
        causes.UPSIDE_DOWN,
    ),
]
CORRECT = [
    *planted(
        correct,
        habits.ACCEL_YZ,
        habits.GYRO_XY,
        habits.NEGATED,
        habits.ACCEL_Z_REVERSED,
        habits.DPS_FOR_RAD,
        habits.RAD_FOR_DPS,
        habits.COUNTS_FOR_DPS,
        habits.G_FOR_SI,
        habits.MG_FOR_SI,
        habits.MG_FOR_G,
        habits.MS_FOR_S,
        habits.HALF_RATE,
        habits.SENSORS_SWAPPED,
        habits.NO_GRAVITY,
        habits.ACCEL_CLIPPED,
        habits.BACKWARD_TIME,
    ),
    *planted(correct_by_table, habits.FAHRENHEIT, habits.KELVIN, habits.TEMP_COUNTS),
    mistake(
        correct_by_table, "records at 4 degC and states degC of a temperature in degF", cold_in_degf, causes.FAHRENHEIT
    ),
    mistake(correct, "takes the calibration of another device", another_device, causes.OTHER_DEVICE),
    mistake(correct, "takes a calibration that names another serial number", another_serial, causes.OTHER_DEVICE),
    mistake(correct, "has a calibration of 25 degC and a recording of 45 degC", twenty_degrees_warmer, causes.FAR_TEMP),
    mistake(correct, "corrects a corrected recording again", marked_corrected, causes.ALREADY),
    mistake(
        correct,
        "corrects a recording again that another program had corrected",
        corrected_before,
        (*causes.ALREADY, r"the calibration of another device"),
    ),
    mistake(correct, "names a file of another program as calibration", other_kind, causes.OTHER_KIND),
    mistake(correct, "names a calibration of an unknown format", other_format, causes.OTHER_KIND),
]
VALIDATE = [
    *planted(
        validate,
        habits.GYRO_XY,
        habits.GYRO_Y_REVERSED,
        habits.NEGATED,
        habits.DPS_FOR_RAD,
        habits.RAD_FOR_DPS,
        habits.HALF_RATE,
        habits.MS_FOR_S,
    ),
    mistake(validate, "takes the calibration of another device", another_device, causes.OTHER_DEVICE),
    mistake(
        validate,
        "writes the reference's quaternions as x-y-z-w",
        _reference(lambda one: replace(one, q_nb=np.roll(np.asarray(one.q_nb), -1, axis=1))),
        causes.SCALAR_LAST,
    ),
    mistake(
        validate,
        "gives a reference that turns the laboratory to the body",
        _reference(lambda one: replace(one, q_nb=quaternion_conjugate(one.q_nb))),
        causes.CONJUGATE,
    ),
    mistake(validate, "gives a reference of a mirrored laboratory", _reference(_mirrored), causes.MIRRORED),
    mistake(validate, "gives the reference of another trial", _reference(_other_trial), causes.OTHER_TRIAL),
    mistake(validate, "gives the reference of another body segment", _reference(_other_body), causes.OTHER_BODY),
    mistake(
        validate_markers,
        "says --reference-up z of a laboratory whose y points up",
        lambda case: replace(case, words=(*case.words[:-1], "z")),
        causes.REFERENCE_UP,
    ),
    mistake(validate_markers, "gives markers of a mirrored laboratory", _markers(mirrored=True), causes.MIRRORED),
    *planted(validate_fit, habits.NEGATED, habits.ACCEL_XY, habits.GYRO_RING),
    mistake(
        validate_fit,
        "gives positions in mm as m",
        _reference(_in_mm),
        causes.MILLIMETRES,
    ),
]
MISTAKES = (*CORRECT, *ORIENT, *VALIDATE)
