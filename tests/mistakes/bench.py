"""Mistakes on the bench and in the chamber: calibrate, drift, noise, info.

Acceleration of the opposite sign is not among those with unlabelled rests: directions turn alike under either sign, and no reading
shows it. Faces, optics, a calibration with an offset, and the maker's statement do.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

import undrift
from mistakes import causes, habits, sound
from mistakes.planting import (
    Case,
    Change,
    Mistake,
    Told,
    Wrong,
    later_error,
    mistake,
    planted,
    record_error,
    with_recordings,
)
from mistakes.sound import GYRO, Recording, poses, trial
from undrift.io.column_map import read_map
from undrift.io.text import write_rows
from undrift.record import Session, Still, Turn
from undrift.sim.motion.bench import BenchSettings

GRAVITY = ("--latitude-deg", sound.LATITUDE_DEG, "--height-m", 0)

# ---- sound input, and how far from the truth


@cache
def free_poses() -> Case:
    """Return free poses of a phone, and a later recording that the person reads in the same way."""
    held = trial()
    return Case(
        route="calibrate",
        recordings=(poses(),),
        words=GRAVITY,
        later=held.recording,
        expected=held.right,
        wrong=later_error,
    )


@cache
def turns_by_hand() -> Case:
    """Return six faces and full turns of a phone, nothing labelled."""
    return replace(free_poses(), recordings=(sound.faces_and_turns(),), words=(*GRAVITY, "--turn-deg", 360))


@cache
def rate_table() -> Case:
    """Return a session of six faces and a rate table."""
    held = sound.counted_trial()
    return Case(
        route="calibrate",
        session=sound.table_session(),
        later=held.recording,
        expected=held.right,
        wrong=later_error,
    )


@cache
def labelled_turns() -> Case:
    """Return a session of six faces and full turns by hand."""
    return replace(rate_table(), session=sound.hand_session())


@cache
def new_session() -> Case:
    """Return bare recordings of six faces and turns, of which a session is to be written."""
    words = ("--turn-deg", 360, "--write-session", "{folder}/made")
    return replace(turns_by_hand(), route="info", words=words, wrong=session_error)


@cache
def table_with_log() -> Case:
    """Return a bare recording of a rate table, and the log of the table's controller."""
    held = sound.counted_trial()
    session = sound.table_alone()
    return Case(
        route="calibrate",
        recordings=(sound.recording_of(session.records[0]),),
        words=(*GRAVITY, "--rates", "{folder}/rates.csv"),
        edit=_log(1.0),
        later=held.recording,
        expected=held.right,
        wrong=later_error,
    )


@cache
def soaks() -> Case:
    """Return rests at five temperatures."""
    return Case(route="drift", session=sound.soak(), calibration=sound.calibrated(), wrong=table_error)


@cache
def stated_soaks() -> Case:
    """Return rests at five temperatures, of which the set-points are stated and no thermometer was recorded."""
    held = sound.soak()
    return replace(
        soaks(),
        session=replace(
            held, records=tuple(replace(one, temp_c=None) for one in held.records), stills=_set_points(held)
        ),
    )


@cache
def ramp() -> Case:
    """Return a bare recording at rest in a ramp up and back."""
    return replace(soaks(), session=None, recordings=(sound.ramp(),))


@cache
def at_rest() -> Case:
    """Return ten minutes at rest."""
    return Case(route="noise", recordings=(sound.rest(),), wrong=walk_error)


@cache
def described() -> Case:
    """Return a recording that is to be looked at."""
    held = trial()
    return Case(route="info", recordings=(held.recording,), expected=held.record, wrong=read_error)


def session_error(case: Case, folder: Path, told: Told) -> Wrong:
    """Return the error of a later recording, by the calibration that the written session gives."""
    session = replace(undrift.read_session(folder / "made"), gravity_m_s2=sound.GRAVITY, gravity_source="stated")
    undrift.write_calibration(undrift.calibrate(session), folder / "made.json")
    return later_error(case, folder, told)


def table_error(_: Case, folder: Path, __: Told) -> Wrong:
    """Return by how much the table misses what the device read at the true temperatures of the soaks."""
    calibration = undrift.read_calibration(folder / "made.json")
    static = calibration.drift.static if calibration.drift is not None else None
    if static is None or static.gyro_offset is None:
        return {"deg/s": np.inf}
    held = sound.soak()
    missed = 0.0
    for still in held.stills:
        record = held.records[still.recording]
        part = slice(still.start, still.stop)
        at_c = float(np.asarray(record.temp_c)[part].mean())
        table = np.array([np.interp(at_c, static.temp_c, column) for column in static.gyro_offset.T])
        missed = max(missed, float(np.abs(table - np.asarray(record.gyro)[part].mean(axis=0)).max()))
    return {"deg/s": np.degrees(missed)}


def walk_error(_: Case, __: Path, told: Told) -> Wrong:
    """Return the angle random walk over its true value, whichever is more over the other."""
    true = float(np.max(sound.phone().gyro.white_noise.random_walk))
    ratios = [axis["angle_random_walk"]["value"] or np.inf for axis in told.answer["gyro"]]
    return {"times": max(max(one / true, true / one) for one in ratios)}


def read_error(case: Case, folder: Path, _: Told) -> Wrong:
    """Return the error of what was read, before any correction."""
    return record_error(undrift.read_record(folder / "recording0.csv", read_map(folder / "map.toml")), case.expected)


# ---- changes of one thing


def _log(factor: float) -> Callable[[Path], None]:
    """Return what writes the log of the table: its rates times a factor, under the name turn_rate_dps."""

    def edit(folder: Path) -> None:
        session = sound.table_alone()
        knots, rates = [0.0], [0.0]
        for turn in session.turns:
            start_s, stop_s = session.records[0].time[[turn.start, turn.stop - 1]]
            knots += [start_s - 0.5, start_s, stop_s, stop_s + 0.5]
            rates += [0.0, turn.turn_rate or 0.0, turn.turn_rate or 0.0, 0.0]
        time = np.arange(0.0, session.records[0].duration_s, 0.02)
        rate = factor * 180.0 / np.pi * np.interp(time, knots, rates)
        write_rows(folder / "rates.csv", ("time_s", "turn_rate_dps"), (time + 3.0, rate))

    return edit


def _set_points(held: Session) -> tuple[Still, ...]:
    """Return the stills with the set-points of the chamber."""
    points = sound.SET_POINTS_C
    each = len(held.stills) // len(points)
    return tuple(replace(one, temp_c=points[k // each]) for k, one in enumerate(held.stills))


def _session(change: Callable[[Session], Session]) -> Change:
    def changed(case: Case) -> Case:
        assert case.session is not None
        return replace(case, session=change(case.session))

    return changed


def _stills(change: Callable[[list[Still]], list[Still]]) -> Change:
    return _session(lambda held: replace(held, stills=tuple(change(list(held.stills)))))


def _turns(change: Callable[[Turn], Turn]) -> Change:
    return _session(lambda held: replace(held, turns=tuple(change(one) for one in held.turns)))


def _faces(**labels: str) -> Change:
    """Return the change that labels faces as others: px="-x" labels +x as -x."""
    other = {name.replace("p", "+").replace("m", "-"): face for name, face in labels.items()}
    return _stills(lambda held: [replace(one, face=other.get(one.face, one.face)) for one in held])


def _columns(held: Session, change: Callable[[np.ndarray], np.ndarray], *names: str) -> Session:
    records = tuple(replace(r, **{n: change(np.array(getattr(r, n))) for n in names}) for r in held.records)
    return replace(held, records=records)


def lost_readings(held: Session) -> Session:
    """Return a session in which the gyroscope read -32768 for 0.1 s in the middle of the second turn."""
    turn = held.turns[1]
    middle = (turn.start + turn.stop) // 2

    def spoil(gyro: np.ndarray) -> np.ndarray:
        gyro[middle : middle + 10] = -32768.0
        return gyro

    return _columns(held, spoil, "gyro")


def two_devices(case: Case) -> Case:
    """Add the poses of another phone to the command."""
    return replace(case, recordings=(*case.recordings, poses(13)))


def two_devices_in_soaks(held: Session) -> Session:
    """Take every second soak from another phone."""
    other = sound.soak(13)
    (one, *_), (two, *_) = held.records, other.records
    gyro, accel = np.array(one.gyro), np.array(one.accel)
    for still in held.stills[1::2]:
        part = slice(still.start, still.stop)
        gyro[part], accel[part] = np.asarray(two.gyro)[part], np.asarray(two.accel)[part]
    return replace(held, records=(replace(one, gyro=gyro, accel=accel),))


def turned_in_a_soak(held: Session) -> Session:
    """Return soaks in the third of which the table under the device crept by 0.4 deg/s."""
    still = held.stills[2]

    def creep(gyro: np.ndarray) -> np.ndarray:
        gyro[still.start : still.stop, 2] += np.radians(0.4)
        return gyro

    return _columns(held, creep, "gyro")


def short_rests(case: Case) -> Case:
    """Rest on each face for half a second."""
    brisk = BenchSettings(gravity_m_s2=sound.GRAVITY, still_s=0.5, move_s=1.0)
    session = undrift.simulate_session(
        "ferraris", sound.phone(), rng=np.random.default_rng(41), settings=brisk, temp_c=sound.TEMP_C
    )
    return replace(case, recordings=(sound.recording_of(session.records[0]),))


def tipped(held: Session) -> Session:
    """Return a session in which the device tips by 5 deg about x while its +z face rests."""
    still = next(one for one in held.stills if one.face == "+z")
    gyro, accel = np.array(held.records[0].gyro), np.array(held.records[0].accel)
    part = slice(still.start, still.stop)
    angle = np.linspace(0.0, np.radians(5.0), still.stop - still.start)
    y, z = accel[part, 1].copy(), accel[part, 2].copy()
    accel[part, 1], accel[part, 2] = np.cos(angle) * y + np.sin(angle) * z, np.cos(angle) * z - np.sin(angle) * y
    gyro[part, 0] += 16.4 * 5.0 / ((still.stop - still.start) / 100.0)
    return replace(held, records=(replace(held.records[0], gyro=gyro, accel=accel),))


def cut_in_a_turn(one: Recording) -> Recording:
    """Return six faces and turns, whose file ends within the last turn."""
    turning = np.abs(one.columns["gz"]) > np.radians(30.0)
    last = int(np.flatnonzero(turning)[-1])
    return one.rows(np.arange(last - 100))


def begun_in_a_turn(turn: Turn) -> Turn:
    """Return a turn whose start is stated a second and a half too late."""
    return replace(turn, start=turn.start + 150) if turn.axis == "y" else turn


def _saying(*words: object) -> Change:
    return lambda case: replace(case, words=words)


def _moving(one: Recording) -> Recording:
    """Return a rest in which somebody carries the device for twenty seconds."""
    t = one.columns["t"]
    inside = (t - t[0] > 300.0) & (t - t[0] < 320.0)
    swing = np.where(inside, np.sin(2.0 * np.pi * 0.5 * t), 0.0)
    columns = {name: one.columns[name] + size * swing for name, size in zip(GYRO, (0.4, 0.2, 0.3), strict=True)}
    return one.with_columns(**columns)


def _room_alone(one: Recording) -> Recording:
    return one.rows(np.flatnonzero(one.columns["T"] < 16.0))


def _other_calibration(case: Case) -> Case:
    return replace(case, calibration=sound.calibrated(13))


# ---- the list


def _once(
    sound_case: Callable[[], Case], name: str, change: Callable[[Recording], Recording], named: tuple[str, ...]
) -> Mistake:
    """Return a mistake with these recordings alone; the later one is sound."""
    return mistake(
        sound_case, name, lambda case: replace(case, recordings=tuple(change(one) for one in case.recordings)), named
    )


CALIBRATE = [
    *planted(
        free_poses,
        habits.GYRO_XY,
        habits.ACCEL_YZ,
        habits.ACCEL_Z_REVERSED,
        habits.DPS_FOR_RAD,
        habits.RAD_FOR_DPS,
        habits.G_FOR_SI,
        habits.MS_FOR_S,
        habits.HALF_RATE,
        habits.TEMPERATURE_AS_ACCEL,
        habits.NO_GRAVITY,
        habits.ACCEL_CLIPPED,
    ),
    mistake(free_poses, "calibrates from the recordings of two devices", two_devices, causes.TWO_DEVICES),
    mistake(turns_by_hand, "rests on each face for half a second", short_rests, causes.SHORT_RESTS),
    replace(
        mistake(turns_by_hand, "states no gravity", _saying("--turn-deg", 360), causes.GRAVITY_ASSUMED), noted=True
    ),
    mistake(
        turns_by_hand,
        "states the latitude in radians",
        _saying("--latitude-deg", 1.0472, "--height-m", 0, "--turn-deg", 360),
        causes.RADIANS_LATITUDE,
    ),
    mistake(
        labelled_turns,
        "states 180 deg of full turns",
        _turns(lambda one: replace(one, angle=0.5 * (one.angle or 0.0))),
        (*causes.TURN_ANGLE, *causes.SCALE_AS_STATED),
    ),
    mistake(
        labelled_turns,
        "states the angle of full turns in rad, as deg",
        _turns(lambda one: replace(one, angle=np.radians(one.angle or 0.0))),
        causes.TURN_ANGLE,
    ),
    mistake(labelled_turns, "tips a face while it rests", _session(tipped), causes.NOT_STILL),
    planted(turns_by_hand, habits.GYRO_XY)[0],
    planted(turns_by_hand, habits.HALF_RATE)[0],
    _once(turns_by_hand, "ends the recording within a turn", cut_in_a_turn, causes.CUT_TURN),
    mistake(
        labelled_turns,
        "states a turn with the other sign",
        _turns(lambda one: replace(one, angle=-(one.angle or 0.0)) if one.axis == "y" else one),
        causes.TURN_SIGN,
    ),
    mistake(
        labelled_turns,
        "states a turn about another axis",
        _turns(lambda one: replace(one, axis={"x": "y", "y": "x"}.get(one.axis or "", one.axis))),
        (*causes.exchanged("(?:columns|axes|axis|turns?)", "x", "y"), r"axes of the turns"),
    ),
    mistake(labelled_turns, "states the start of a turn too late", _turns(begun_in_a_turn), causes.CUT_TURN),
    mistake(labelled_turns, "lays the same face twice", _faces(mz="+z"), causes.FACE_TWICE),
    mistake(
        labelled_turns,
        "leaves a face out",
        _stills(lambda held: [one for one in held if one.face != "-z"]),
        causes.MISSING_FACE,
    ),
    mistake(
        labelled_turns, "exchanges the labels of two opposite faces", _faces(px="-x", mx="+x"), causes.SWAPPED_FACES
    ),
    mistake(
        rate_table,
        "labels face +x as +y and +y as +x",
        _faces(px="+y", py="+x"),
        (r"\+x and \+y[^;]*swapped|swapped[^;]*\+x[^;]*\+y",),
    ),
    mistake(
        rate_table,
        "states all rates with the other sign",
        _turns(lambda one: replace(one, turn_rate=-(one.turn_rate or 0.0))),
        causes.TURN_SIGN,
    ),
    mistake(
        rate_table,
        "states rates in rad/s as deg/s",
        _turns(lambda one: replace(one, turn_rate=np.radians(one.turn_rate or 0.0))),
        causes.RATE_UNIT,
    ),
    mistake(
        rate_table,
        "states twice the rates, for a gear of 2",
        _turns(lambda one: replace(one, turn_rate=2.0 * (one.turn_rate or 0.0))),
        (r"rates?[^;]*2(?:\.0+)? times|half of the stated|gear", *causes.SCALE_AS_STATED),
    ),
    mistake(rate_table, "loses ten samples to -32768 in a turn", _session(lost_readings), causes.SATURATED),
    mistake(
        rate_table,
        "has exchanged accelerometer columns x and y",
        _session(lambda held: _columns(held, lambda a: a[:, [1, 0, 2]], "accel")),
        causes.exchanged(causes.ACCEL, "x", "y"),
    ),
    mistake(
        rate_table,
        "has negated acceleration",
        _session(lambda held: _columns(held, np.negative, "accel")),
        causes.NEGATED,
    ),
]
SESSION = [
    planted(new_session, habits.RAD_FOR_DPS)[0],
    mistake(
        table_with_log,
        "has a log of rates in rad/s under the name of deg/s",
        lambda case: replace(case, edit=_log(np.radians(1.0))),
        causes.RATE_UNIT,
    ),
]
DRIFT = [
    mistake(soaks, "takes the calibration of another device", _other_calibration, causes.OTHER_DEVICE),
    mistake(soaks, "takes two devices for one", _session(two_devices_in_soaks), causes.TWO_DEVICES),
    mistake(
        soaks,
        "states degC of a temperature in degF",
        _session(lambda held: _columns(held, lambda t: 1.8 * t + 32.0, "temp_c")),
        causes.FAHRENHEIT,
    ),
    mistake(
        soaks,
        "states degC of a temperature in K",
        _session(lambda held: _columns(held, lambda t: t + 273.15, "temp_c")),
        causes.KELVIN,
    ),
    mistake(
        soaks,
        "states degC of a temperature in counts",
        _session(lambda held: _columns(held, lambda t: 340.0 * (t - 36.53), "temp_c")),
        causes.TEMP_COUNTS,
    ),
    mistake(
        stated_soaks,
        "exchanges two set-points",
        _stills(
            lambda held: [
                replace(one, temp_c={17.0: 41.0, 41.0: 17.0}.get(one.temp_c or 0.0, one.temp_c)) for one in held
            ]
        ),
        causes.SOAK_ORDER,
    ),
    mistake(
        soaks,
        "states rad/s of a gyroscope that writes deg/s",
        _session(lambda held: _columns(held, np.degrees, "gyro")),
        causes.DPS_FOR_RAD,
    ),
    mistake(
        soaks,
        "states deg/s of a gyroscope that writes rad/s",
        _session(lambda held: _columns(held, np.radians, "gyro")),
        causes.RAD_FOR_DPS,
    ),
    _once(ramp, "records one temperature alone", _room_alone, causes.ONE_TEMPERATURE),
    mistake(soaks, "turns the device slowly in a soak", _session(turned_in_a_soak), causes.NOT_STILL),
    mistake(
        ramp,
        "leaves the temperature out of the map",
        with_recordings(lambda one: replace(one, temp="")),
        (r"columns\.temp|no temperature (?:column|was recorded)",),
    ),
]
NOISE = [
    *planted(at_rest, habits.DPS_FOR_RAD, habits.RAD_FOR_DPS, habits.G_FOR_SI, habits.MS_FOR_S),
    _once(at_rest, "carries the device in the recording", _moving, causes.NOT_STILL),
]
INFO = [
    *planted(
        described,
        habits.ACCEL_XY,
        habits.GYRO_RING,
        habits.DPS_FOR_RAD,
        habits.RAD_FOR_DPS,
        habits.G_FOR_SI,
        habits.MS_FOR_S,
        habits.HALF_RATE,
        habits.DOUBLED_ROWS,
        habits.GYRO_CLIPPED,
    )
]
MISTAKES = (*CALIBRATE, *SESSION, *DRIFT, *NOISE, *INFO)
