"""The mistakes: sound input, what the person does, the change, and a text that names the cause.

Acceleration of the opposite sign is not among those with unlabelled rests: directions turn alike under either sign, and no reading
shows it. Faces, optics, a calibration with an offset, and the maker's statement do.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import undrift
from mistakes import cases, habits, sound
from mistakes.habits import (
    ALREADY_SAYS,
    DPS_FOR_RAD,
    FAHRENHEIT,
    KELVIN,
    NEGATED,
    NOT_STILL_SAYS,
    OTHER_DEVICE_SAYS,
    RAD_FOR_DPS,
    SATURATED_SAYS,
    TEMP_COUNTS,
    in_gap,
)
from mistakes.planting import Case, Change, Mistake
from mistakes.sound import ACCEL, GYRO, Recording
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.io.text import write_rows
from undrift.record import Session, Still, Turn
from undrift.sim.motion.motion import turn_quaternion

MISTAKES: list[Mistake] = []

MIRRORED_SAYS = "mirrored"
CONJUGATE_SAYS = "level to body, not body to level"
CUT_TURN_SAYS = r"cut off|still turns at"
TURN_SCALE_SAYS = "depends on the given turns only, so a wrong angle, rate or sample rate"


def plant(sound_input: str, names: str, outcome: str = "named") -> None:
    """Enter habits by their names: all recordings are read with them."""
    for name in names.split():
        habit = getattr(habits, name)
        add(sound_input, habit.name, in_recordings(habit.change), habit.says, outcome)


def add(sound_input: str, name: str, change: Change, says: str, outcome: str = "named", *, noted: bool = False) -> None:
    MISTAKES.append(Mistake(sound=sound_input, name=name, change=change, says=says, outcome=outcome, noted=noted))


# ---- changes of one thing


def in_recordings(change: Callable[[Recording], Recording]) -> Change:
    return lambda case: replace(case, recordings=tuple(change(recording) for recording in case.recordings))


def in_recording(number: int, change: Callable[[Recording], Recording]) -> Change:
    def changed(case: Case) -> Case:
        recordings = [change(item) if k == number else item for k, item in enumerate(case.recordings)]
        return replace(case, recordings=tuple(recordings))

    return changed


def in_session(change: Callable[[Session], Session]) -> Change:
    return lambda case: replace(case, session=change(case.session))  # type: ignore[arg-type]


def in_stills(change: Callable[[Still], Still | None]) -> Change:
    """Return the change of each rest of a session; None leaves it out."""

    def changed(session: Session) -> Session:
        stills = (change(still) for still in session.stills)
        return replace(session, stills=tuple(still for still in stills if still is not None))

    return in_session(changed)


def in_turns(change: Callable[[Turn], dict[str, Any]]) -> Change:
    """Return the change of some fields of each turn of a session."""
    return in_session(lambda session: replace(session, turns=tuple(replace(t, **change(t)) for t in session.turns)))


def in_columns(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Return the change of a channel of a session."""

    def changed(session: Session) -> Session:
        records = (replace(record, **{name: change(np.array(getattr(record, name)))}) for record in session.records)
        return replace(session, records=tuple(records))

    return in_session(changed)


def with_labels(**labels: str) -> Change:
    """Return the change that labels faces as others: px="-x" labels +x as -x."""
    other = {name.replace("p", "+").replace("m", "-"): face for name, face in labels.items()}
    return in_stills(lambda still: replace(still, face=other.get(still.face or "", still.face)))


def with_options(*options: object) -> Change:
    return lambda case: replace(case, options=options)


def with_calibration(seed: int) -> Change:
    return lambda case: replace(case, calibration=sound.calibrated(seed))


def with_edit(edit: Callable[[Path], None], *, mapped: bool = True) -> Change:
    return lambda case: replace(case, edit=edit, mapped=mapped)


def with_reference(change: Callable[[undrift.Reference], undrift.Reference]) -> Change:
    return lambda case: replace(case, references=tuple(change(item) for item in case.references))  # type: ignore[arg-type]


def with_quaternions(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    return with_reference(lambda reference: replace(reference, q_nb=change(np.asarray(reference.q_nb))))


def by_seconds(start_s: float, stop_s: float) -> Change:
    return in_recordings(lambda item: item.rows((item.columns["t"] >= start_s) & (item.columns["t"] < stop_s)))


# ---- calibrate


def two_devices(case: Case) -> Case:
    """Add the poses of another phone to the command."""
    return replace(case, recordings=(*case.recordings, sound.poses(13)))


def short_rests(case: Case) -> Case:
    return replace(case, recordings=(sound.faces_and_turns(still_s=0.5, move_s=1.0),))


def lost_readings(session: Session) -> Session:
    """Return a session in which the gyroscope reads -32768 for 0.1 s in the middle of the second turn."""
    middle = (session.turns[1].start + session.turns[1].stop) // 2
    gyro = np.array(session.records[0].gyro)
    gyro[middle : middle + 10] = -32768.0
    return replace(session, records=(replace(session.records[0], gyro=gyro),))


def tipped_face(session: Session) -> Session:
    """Return a session in which the device tips by 5 deg about x while its +z face rests."""
    still = next(still for still in session.stills if still.face == "+z")
    gyro, accel = np.array(session.records[0].gyro), np.array(session.records[0].accel)
    rows, count = slice(still.start, still.stop), still.stop - still.start
    angle = np.linspace(0.0, np.radians(5.0), count)
    y, z = accel[rows, 1].copy(), accel[rows, 2].copy()
    accel[rows, 1], accel[rows, 2] = np.cos(angle) * y + np.sin(angle) * z, np.cos(angle) * z - np.sin(angle) * y
    gyro[rows, 0] += 16.4 * 5.0 / (count / 100.0)
    return replace(session, records=(replace(session.records[0], gyro=gyro, accel=accel),))


def cut_in_a_turn(recording: Recording) -> Recording:
    """Return six faces and turns, whose file ends within the last turn."""
    last = int(np.flatnonzero(np.abs(recording.columns["gz"]) > np.radians(30.0))[-1])
    return recording.rows(np.arange(last - 100))


plant(
    "free_poses",
    "GYRO_XY ACCEL_YZ ACCEL_Z_REVERSED DPS_FOR_RAD RAD_FOR_DPS G_FOR_SI MS_FOR_S HALF_RATE TEMPERATURE_AS_ACCEL "
    "NO_GRAVITY ACCEL_CLIPPED",
)
add("free_poses", "calibrates from the recordings of two devices", two_devices, "off the mean rate of the other")
plant("turns_by_hand", "GYRO_XY HALF_RATE")
add("turns_by_hand", "rests on each face for half a second", short_rests, r"hold each pose[^;]*\d s")
add("turns_by_hand", "gives no gravity", with_options("--turn-deg", 360), "standard gravity was assumed", noted=True)
add(
    "turns_by_hand",
    "gives the latitude in radians",
    with_options("--latitude-deg", 1.0472, "--height-m", 0, "--turn-deg", 360),
    "may be in radians",
)
add("turns_by_hand", "ends the recording within a turn", in_recordings(cut_in_a_turn), CUT_TURN_SAYS)
plant("from_motion", "GYRO_YZ GYRO_Y_REVERSED ACCEL_XY SENSORS_SWAPPED HALF_RATE")
for name, change, says in (
    ("gives 180 deg of full turns", in_turns(lambda turn: {"angle": 0.5 * turn.angle}), "wrong angle|turns 0.5"),
    (
        "gives the angle of full turns in rad",
        in_turns(lambda turn: {"angle": np.radians(turn.angle)}),
        "in deg, not rad",
    ),
    ("tips a face while it rests", in_session(tipped_face), NOT_STILL_SAYS),
    (
        "gives a turn with the other sign",
        in_turns(lambda turn: {"angle": -turn.angle if turn.axis == "y" else turn.angle}),
        "turn about y reads reversed",
    ),
    (
        "gives a turn about another axis",
        in_turns(lambda turn: {"axis": {"x": "y", "y": "x"}.get(turn.axis or "", turn.axis)}),
        "columns x and y are exchanged",
    ),
    (
        "gives the start of a turn too late",
        in_turns(lambda turn: {"start": turn.start + 150 * (turn.axis == "y")}),
        CUT_TURN_SAYS,
    ),
    ("lays the same face twice", with_labels(mz="+z"), "labelled twice"),
    ("exchanges the labels of two opposite faces", with_labels(px="-x", mx="+x"), r"faces \+x and -x"),
):
    add("labelled_turns", name, change, says)
add(  # five faces and the scatter about them give the right result
    "labelled_turns",
    "leaves a face out",
    in_stills(lambda still: None if still.face == "-z" else still),
    "-z is missing",
    "harmless",
)
for name, change, says in (
    ("labels face +x as +y and +y as +x", with_labels(px="+y", py="+x"), r"\+x and \+y are swapped"),
    ("gives all rates with the other sign", in_turns(lambda turn: {"turn_rate": -turn.turn_rate}), "are reversed"),
    ("gives rates in rad/s as deg/s", in_turns(lambda turn: {"turn_rate": np.radians(turn.turn_rate)}), "rad/s"),
    ("loses ten samples to -32768 in a turn", in_session(lost_readings), SATURATED_SAYS),
    ("has exchanged accelerometer columns", in_columns("accel", lambda a: a[:, [1, 0, 2]]), "x and y are exchanged"),
    ("has negated acceleration", in_columns("accel", np.negative), "opposite sign"),
):
    add("rate_table", name, change, says)
add(  # counts of an unknown sensitivity, turned about the vertical: any angle, rate or time fits
    "rate_table",
    "gives twice the rates, for a gear of 2",
    in_turns(lambda turn: {"turn_rate": 2.0 * turn.turn_rate}),
    TURN_SCALE_SAYS,
    "noted",
)
plant("new_session", "RAD_FOR_DPS")
add(
    "table_with_log",
    "has a log of rates in rad/s under the name of deg/s",
    with_edit(cases.table_log(np.radians(1.0))),
    "rad/s",
)

# ---- drift, noise, info


def two_devices_in_soaks(session: Session) -> Session:
    """Take every second soak from another phone."""
    (record, *_), (other, *_) = session.records, sound.soak(13).records
    gyro, accel = np.array(record.gyro), np.array(record.accel)
    for still in session.stills[1::2]:
        rows = slice(still.start, still.stop)
        gyro[rows], accel[rows] = np.asarray(other.gyro)[rows], np.asarray(other.accel)[rows]
    return replace(session, records=(replace(record, gyro=gyro, accel=accel),))


def turning_soak(session: Session) -> Session:
    """Return soaks in the third of which the table under the device creeps by 0.4 deg/s."""
    gyro = np.array(session.records[0].gyro)
    gyro[session.stills[2].start : session.stills[2].stop, 2] += np.radians(0.4)
    return replace(session, records=(replace(session.records[0], gyro=gyro),))


def exchanged_set_points(still: Still) -> Still:
    return replace(still, temp_c={17.0: 41.0, 41.0: 17.0}.get(still.temp_c or 0.0, still.temp_c))


def carried(recording: Recording) -> Recording:
    """Return a rest in which somebody carries the device for twenty seconds."""
    t = recording.columns["t"] - recording.columns["t"][0]
    swing = np.where((t > 300.0) & (t < 320.0), np.sin(np.pi * recording.columns["t"]), 0.0)
    return recording.changed(GYRO, lambda gyro: gyro + swing[:, None] * (0.4, 0.2, 0.3))


for name, change, says in (
    ("takes the calibration of another device", with_calibration(13), "which device was recorded"),
    ("takes two devices for one", in_session(two_devices_in_soaks), "two devices"),
    ("gives degC of a temperature in degF", in_columns("temp_c", lambda temp: 1.8 * temp + 32.0), FAHRENHEIT.says),
    ("gives degC of a temperature in K", in_columns("temp_c", lambda temp: temp + 273.15), KELVIN.says),
    ("gives degC of a temperature in counts", in_columns("temp_c", lambda t: 340.0 * (t - 36.53)), TEMP_COUNTS.says),
    ("gives rad/s of a gyroscope in deg/s", in_columns("gyro", np.degrees), DPS_FOR_RAD.says),
    ("gives deg/s of a gyroscope in rad/s", in_columns("gyro", np.radians), RAD_FOR_DPS.says),
    ("turns the device slowly in a soak", in_session(turning_soak), "slow turn"),
):
    add("soaks", name, change, says)
add("stated_soaks", "exchanges two set-points", in_stills(exchanged_set_points), "set-points in the wrong order")
add(
    "ramp",
    "records one temperature only",
    in_recordings(lambda recording: recording.rows(np.flatnonzero(recording.columns["T"] < 16.0))),
    "degC only",
)
add(
    "ramp",
    "leaves the temperature out of the map",
    in_recordings(lambda recording: replace(recording, temp="")),
    r"columns\.temp",
)
plant("at_rest", "DPS_FOR_RAD RAD_FOR_DPS G_FOR_SI MS_FOR_S")
add("at_rest", "carries the device in the recording", in_recordings(carried), "must be at rest, but")
plant(
    "described",
    "ACCEL_XY GYRO_RING DPS_FOR_RAD RAD_FOR_DPS G_FOR_SI MS_FOR_S HALF_RATE DOUBLED_ROWS GYRO_CLIPPED",
)

# ---- correct


def at_temperature(temp_c: float) -> Change:
    """Return the change that records at another temperature."""
    return lambda case: replace(case, recordings=(sound.recording_of(sound.trial(temp_c=temp_c).record),))


def cold_in_degf(case: Case) -> Case:
    """Record at 4 degC with a thermometer in degF, whose 39 are inside the table in degC."""
    return in_recordings(FAHRENHEIT.change)(at_temperature(4.0)(case))


def corrected() -> undrift.Record:
    return undrift.correct(replace(sound.trial().record, device=""), sound.calibrated())


def another_serial(case: Case) -> Case:
    """Take the calibration of another phone; calibration and map name the serial numbers."""
    calibration = replace(sound.calibrated(13), device="B2")
    return in_recordings(lambda recording: replace(recording, keys={"device": "A1"}))(
        replace(case, calibration=calibration)
    )


def write_corrected(folder: Path) -> None:
    undrift.write_record(corrected(), folder / "recording0.csv")


def write_other_kind(folder: Path) -> None:
    (folder / "calibration.json").write_text('{"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "bias": [0, 0, 0]}')


def write_other_format(folder: Path) -> None:
    path = folder / "calibration.json"
    path.write_text(path.read_text().replace('"format": 1', '"format": 0').replace('"format":1', '"format":0'))


ANOTHER_DEVICE = ("takes the calibration of another device", with_calibration(13), OTHER_DEVICE_SAYS)
CORRECTED_TWICE = ("corrects a corrected recording again", with_edit(write_corrected, mapped=False), ALREADY_SAYS)
WARMER = ("records at 45 degC, 20 K above the calibration", at_temperature(45.0), "differs by up to 20.1 degC")
plant(
    "correct",
    "ACCEL_YZ GYRO_XY NEGATED ACCEL_Z_REVERSED DPS_FOR_RAD RAD_FOR_DPS COUNTS_FOR_DPS G_FOR_SI MG_FOR_SI MG_FOR_G "
    "MS_FOR_S HALF_RATE SENSORS_SWAPPED NO_GRAVITY ACCEL_CLIPPED BACKWARD_TIME",
)
add("correct", *ANOTHER_DEVICE)
add("correct", *CORRECTED_TWICE)
add("correct", *WARMER)
add("correct", "takes a calibration with another serial number", another_serial, OTHER_DEVICE_SAYS)
add(
    "correct",
    "corrects a recording that another program has corrected",
    lambda case: replace(case, recordings=(sound.recording_of(corrected()),)),
    OTHER_DEVICE_SAYS,
)
add("correct", "names a file of another program", with_edit(write_other_kind), r"kind 'undrift\.calibration'")
add("correct", "names a calibration of an unknown format", with_edit(write_other_format), "expected format 1")
plant("correct_by_table", "FAHRENHEIT KELVIN TEMP_COUNTS")
add(  # 39 degC is a temperature of a device, and 4 degC is outside the table
    "correct_by_table", "records 4 degC as degF", cold_in_degf, FAHRENHEIT.says, "warned"
)
plant("imucal", "NEGATED DPS_FOR_RAD")
add("imucal", "takes another device's calibration", lambda case: cases.by_imucal(case, 99), OTHER_DEVICE_SAYS)
add("folder", *ANOTHER_DEVICE)
add(
    "folder",
    "has a file of another device in the folder",
    in_recording(1, lambda _: sound.recording_of(sound.trial(seed=99).record)),
    OTHER_DEVICE_SAYS,
)
add("folder", "has a file in deg/s among those in rad/s", in_recording(2, DPS_FOR_RAD.change), DPS_FOR_RAD.says)

# ---- orient, mount


def write_sensor_logger(folder: Path) -> None:
    """Write the folder of Sensor Logger on iOS, whose acceleration is negative up, without its Metadata.csv."""
    columns = sound.recording_of(sound.trial().record).columns
    path = folder / "recording0.csv"
    path.unlink()
    path.mkdir()
    for file, names, sign in (("TotalAcceleration.csv", ACCEL, -1.0), ("Gyroscope.csv", GYRO, 1.0)):
        x, y, z = (sign * columns[name] for name in names)
        values = (1.7e18 + np.round(1e9 * columns["t"]), columns["t"], z, y, x)
        write_rows(path / file, ("time", "seconds_elapsed", "z", "y", "x"), values)


def turning_in_the_rest(recording: Recording) -> Recording:
    """Turn the device about x by half a degree a second in the rest at the start."""
    time, rate = sound.trial().motion.time, np.radians(0.5)
    angle = np.where(time < time[0] + 5.5, rate * (time - 5.5), 0.0)
    turn = turn_quaternion(np.array([1.0, 0.0, 0.0]), angle)
    turned = recording.changed(ACCEL, lambda force: rotate(quaternion_conjugate(turn), force))
    return turned.with_columns(gx=recording.columns["gx"] + np.where(angle < 0.0, rate, 0.0))


def slipped(case: Case) -> Case:
    """Let the device turn by 40 deg in its pouch after a part of the walks, in another recording."""
    (recording,) = case.recordings
    first, second = (recording.rows(rows) for rows in (recording.columns["t"] < 27.0, recording.columns["t"] >= 27.0))
    q = turn_quaternion(np.array([0.0, 0.0, 1.0]), np.array([np.radians(40.0)]))
    for names in (GYRO, ACCEL):
        second = second.changed(names, lambda values: rotate(np.repeat(q, len(values), axis=0), values))
    return replace(case, recordings=(first, second))


plant(
    "orient",
    "ACCEL_XY ACCEL_RING GYRO_YZ GYRO_RING GYRO_Y_REVERSED GYRO_REVERSED ACCEL_Z_REVERSED NEGATED LEFT_HANDED "
    "DPS_FOR_RAD RAD_FOR_DPS MDPS_FOR_DPS G_FOR_SI SI_FOR_G MS_FOR_S US_FOR_S NS_FOR_S S_FOR_MS HALF_RATE "
    "DOUBLE_RATE TEMPERATURE_AS_ACCEL SENSORS_SWAPPED NO_GRAVITY DOUBLED_ROWS REVERSED_TIME GYRO_CLIPPED",
)
add("orient", *ANOTHER_DEVICE)
add("orient", *CORRECTED_TWICE)
for name, change, says in (
    ("gives Sensor Logger of iOS without Metadata.csv", with_edit(write_sensor_logger, mapped=False), NEGATED.says),
    ("turns slowly in the rest at the start", in_recordings(turning_in_the_rest), NOT_STILL_SAYS),
    ("names motion as the rest", with_options("--offset", "rest", "--rest-s", "20:24"), NOT_STILL_SAYS),
    ("loses two seconds of rows", in_recordings(lambda item: in_gap(item, with_nan=False)), "After a hole"),
    ("has two seconds of NaN", in_recordings(lambda item: in_gap(item, with_nan=True)), "After a gap"),
):
    add("orient", name, change, says)
add("worn_pitch", "leaves --forward and --up out", with_options("--offset", "rest"), "Use [+]x for `up`")
add(
    "worn_pitch",
    "mounts the device upside down",
    in_recordings(lambda recording: recording.scaled(("gx", "gz", "ax", "az"), -1.0)),
    "Use -x for `up`",
)
plant("mount", "MS_FOR_S SENSORS_SWAPPED NO_GRAVITY")
# A trunk that walks turns by a few degrees: readings cannot determine which column is which, and the sides that point forward and
# up are in the answer. Rates of 57 times the size are neither posture nor walking, and slow steps are those of a patient.
plant("mount", "ACCEL_XY GYRO_YZ DPS_FOR_RAD HALF_RATE", "warned")
plant("mount", "NEGATED", "noted")
add("mount", "stands and does not walk", by_seconds(0.0, 4.0), "walk straight|show\\w* forward")
add("mount", "never stands", by_seconds(6.0, 12.0), "stand")
add("mount", "lets the device slip between two recordings", slipped, "slip|apart|disagree")

# ---- validate


def other_body(reference: undrift.Reference) -> undrift.Reference:
    """Return a reference that bends against the device in the motion."""
    bend = 0.35 * np.sin(2.0 * np.pi * 0.4 * (reference.time - reference.time[0]))
    bend = np.where(np.asarray(reference.moving) > 0.5, bend, 0.0) if reference.moving is not None else bend
    turn = turn_quaternion(np.array([0.0, 1.0, 0.0]), bend)
    return replace(reference, q_nb=quaternion_product(reference.q_nb, turn))


def in_millimetres(reference: undrift.Reference) -> undrift.Reference:
    """Return a reference with positions in mm, as a file may contain them; the value itself refuses them."""
    result = replace(reference)
    object.__setattr__(result, "position", 1e3 * np.asarray(reference.position))
    return result


CONJUGATE = ("gives a reference from laboratory to body", with_quaternions(quaternion_conjugate), CONJUGATE_SAYS)
plant("validate", "GYRO_XY GYRO_Y_REVERSED NEGATED DPS_FOR_RAD RAD_FOR_DPS HALF_RATE MS_FOR_S")
add("validate", *ANOTHER_DEVICE)
add("validate", *CONJUGATE)
for name, change, says in (
    ("writes quaternions as x-y-z-w", with_quaternions(lambda q: np.roll(q, -1, axis=1)), "x-y-z-w|scalar last"),
    ("gives a mirrored laboratory", with_quaternions(lambda q: q * [1.0, -1.0, 1.0, -1.0]), MIRRORED_SAYS),
    (
        "gives the reference of another trial",
        with_reference(lambda _: sound.trial(draw=99).reference),
        "no common motion",
    ),
    ("gives the reference of another body segment", with_reference(other_body), "another segment"),
):
    add("validate", name, change, says)
add(
    "validate_markers",
    "says --reference-up z of a laboratory whose y points up",
    lambda case: replace(case, options=(*case.options[:-1], "z")),
    "points up is [+]?y, not",
)
add(
    "validate_markers",
    "gives markers of a mirrored laboratory",
    lambda case: replace(case, references=(cases.markers(mirrored=True),)),
    MIRRORED_SAYS,
)
plant("validate_fit", "NEGATED ACCEL_XY GYRO_RING")
add("validate_fit", "gives positions in mm as m", with_reference(in_millimetres), "in mm, not m")

# ---- Python and the page


def transposed(case: Case) -> Case:
    """Give arrays with time along the second axis."""

    def script(case: Case) -> object:
        gyro = np.stack([case.recordings[0].columns[name] for name in GYRO])
        return undrift.Record.from_arrays(gyro=gyro, gyro_unit="rad/s", sample_rate_hz=100.0)

    return replace(case, script=script)


def correct_twice(case: Case) -> Case:
    """Correct the result of a correction."""
    return replace(case, script=lambda case: undrift.correct(corrected(), sound.calibrated()))


plant("python_correct", "NEGATED GYRO_YZ HALF_RATE")
add("python_correct", *ANOTHER_DEVICE)
add("python_correct", "corrects a corrected record again", correct_twice, ALREADY_SAYS)
add("python_correct", "gives arrays with time along the second axis", transposed, "time is axis 0")
plant("python_orient", "NEGATED ACCEL_XY RAD_FOR_DPS DOUBLE_RATE")
plant("python_calibrate", "GYRO_XY RAD_FOR_DPS HALF_RATE MS_FOR_S")
plant("python_validate", "GYRO_Y_REVERSED NEGATED")
add("python_validate", *CONJUGATE)
plant("python_noise", "DPS_FOR_RAD")
plant("page_correct", "NEGATED DPS_FOR_RAD GYRO_XY")
add("page_correct", *ANOTHER_DEVICE)
add("page_correct", *WARMER)
plant("page_orient", "NEGATED ACCEL_RING GYRO_RING HALF_RATE RAD_FOR_DPS")
add("page_orient", *ANOTHER_DEVICE)
plant("page_calibrate", "GYRO_YZ RAD_FOR_DPS")
add(
    "page_calibrate_turns",
    "gives no location and so no gravity",
    with_options(None, 360.0),
    "standard gravity was assumed",
    noted=True,
)
