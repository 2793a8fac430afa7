"""The note's Discussion as an experiment: other ways to calibrate against the rate table, on the same device in the same time.

    data_sheet            nothing is recorded
    rate_table            six faces and steady rates both ways about three axes                  the note's own
    inclined_plane        stills on a tilted plane, nothing recorded between                     as the note has it
    plane_and_moves       the same with the moves between the stills recorded
    trolley               a cart on a rail: known accelerations along each axis in turn
    piston                a servohydraulic piston: known accelerations upright in turn
    mocap                 free turns of the body beside optics                                   gyroscopes alone
    robot_arm             an arm whose poses are known                                           gyroscopes alone
    plane_and_mocap       half the time each: accelerometers from the plane, gyroscopes from optics

Where a method cannot calibrate a triad, the data sheet stands in for it, with what rests alone can add: the gyroscopes' offset
is their mean reading at rest, the accelerometers are scaled, all axes alike, until rests read gravity. What a method cannot see is
said in the words of its own fit. The tasks are done at the temperature of the calibration: what differs is the calibration, not
the drift.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from undrift.calibration.fit.linear import fit_forward, triad_from_forward
from undrift.calibration.model import Calibration, TriadModel, Verdict
from undrift.calibration.procedure import calibrate
from undrift.calibration.procedure_reference import calibrate_to_references
from undrift.errors import AlignmentError, CalibrationError, InputError
from undrift.record import Record, Reference
from undrift.session import Session, Still
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import preset_grade
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import nominal_calibration
from undrift.sim.motion.bench import BenchSettings, bench_motion
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.rivals import RivalSettings, rival_motion
from undrift.units import RADIAN_PER_DEGREE

Method = Literal[
    "data_sheet",
    "rate_table",
    "inclined_plane",
    "plane_and_moves",
    "trolley",
    "piston",
    "mocap",
    "robot_arm",
    "plane_and_mocap",
]
METHODS: tuple[Method, ...] = get_args(Method)
SECONDS_PER_MINUTE = 60.0
TEMP_C = 25.0
SETTLED_S = 3600.0
TILT_SD = 0.1 * RADIAN_PER_DEGREE  # [assumed] of every mounting and face, in all methods alike
BENCH = BenchSettings(tilt_sd=TILT_SD)  # the note's rates for the sit-to-stand
OPTICS_ANGLE_SD = 3e-4  # rad, that of the simulated optics
ARM_ANGLE_SD = 5e-5  # [assumed] rad: an industrial arm repeats within hundredths of a millimetre over half a metre
MOST_OF_RANGE = 0.9  # of the gyroscopes' range, which a free motion keeps within
HAND = RivalSettings()  # a minute of turns and ways between two stills, by an arm or by hand
LAGS_S = np.arange(0.0, 0.0401, 0.002)  # a filter delays the reading against the known acceleration


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rivalled:
    """A device calibrated by one method.

    Parameters
    ----------
    method : str
        Which.
    calibration : Calibration
        What the method gave, the data sheet where it gave nothing.
    minutes : float
        Of recordings, min.
    observable : tuple of str
        gyro, accel: what the method calibrated.
    said : tuple of str
        What the fits said.
    """

    method: Method
    calibration: Calibration
    minutes: float
    observable: tuple[str, ...]
    said: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Bench:
    """A device on which a method has a given time to work."""

    device: DeviceModel
    nominal: Calibration
    budget_s: float
    rng: np.random.Generator

    def read(self, motion: Motion) -> Record:
        made = simulate_device(self.device, motion, rng=self.rng, temp_c=TEMP_C, power_on_s=SETTLED_S)
        return made.record

    def session(self, motion: Motion) -> Session:
        return _session((self.read(motion),), motion.stills, motion)


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """What a method found; None where it could not."""

    gyro: TriadModel | None
    accel: TriadModel | None
    said: tuple[str, ...]
    rests: tuple[Record, ...]
    seconds: float
    calibration: Calibration | None = None


def rate_table_minutes(settings: BenchSettings | None = None) -> float:
    """Return how long the note's own session takes on the table.

    Parameters
    ----------
    settings : BenchSettings, optional
        Rates and dwells; the note's sit-to-stand where not given.

    Returns
    -------
    float
        Of recording, min.
    """
    motion = bench_motion("bench", rng=np.random.default_rng(0), settings=settings or BENCH)
    return len(motion) / motion.sample_rate_hz / SECONDS_PER_MINUTE


def calibrate_by(
    method: Method, device: DeviceModel, *, kind: str, rng: np.random.Generator, minutes: float | None = None
) -> Rivalled:
    """Calibrate a device by one of the methods of the note's Discussion.

    Parameters
    ----------
    method : str
        One of ``METHODS``.
    device : DeviceModel
        The device.
    kind : str
        Preset of the device, whose data sheet stands in for what a method cannot see.
    rng : Generator
        Draws mountings, paths and noise.
    minutes : float, optional
        Time for recordings, min; that of the rate table where not given. The rate table takes its own.

    Returns
    -------
    Rivalled
        Calibration, time and words.

    Raises
    ------
    InputError
        A method that is not one, or too little time for it.
    """
    if method not in METHODS:
        raise InputError(f"rivals: wanted a method of {', '.join(METHODS)}, got '{method}'; name one of them")
    budget_s = (rate_table_minutes() if minutes is None else minutes) * SECONDS_PER_MINUTE
    bench = _Bench(device, nominal_calibration(preset_grade(kind)), budget_s, rng)
    found = _HOW[method](bench)
    known = {"gyro": found.gyro, "accel": found.accel}
    held = found.calibration or bench.nominal
    return Rivalled(
        method=method,
        calibration=replace(
            held,
            device=device.serial,
            gyro=found.gyro or _at_rest(bench.nominal.gyro, found.rests),
            accel=found.accel or _to_gravity(bench.nominal, found.rests),
            reference_temp_c=TEMP_C,
        ),
        minutes=found.seconds / SECONDS_PER_MINUTE,
        observable=tuple(name for name, model in known.items() if model is not None),
        said=found.said,
    )


def _rate_table(bench: _Bench) -> _Found:
    motion = bench_motion("bench", rng=bench.rng, settings=BENCH)
    return _fitted(bench.session(motion), _length_s(motion))


def _inclined_plane(bench: _Bench) -> _Found:
    motion = rival_motion("inclined_plane", rng=bench.rng, settings=_plane(bench.budget_s))
    record = bench.read(motion)
    records = tuple(record.part(still.start, still.stop) for still in motion.stills)
    stills = tuple(Still(start=0, stop=len(part), recording=k) for k, part in enumerate(records))
    return _fitted(_session(records, stills, motion), _length_s(motion))


def _plane_and_moves(bench: _Bench) -> _Found:
    motion = rival_motion("inclined_plane", rng=bench.rng, settings=_plane(bench.budget_s))
    return _fitted(bench.session(motion), _length_s(motion))


def _trolley(bench: _Bench) -> _Found:
    plain = RivalSettings(tilt_sd=TILT_SD)
    runs = len(plain.trolley_hz)
    return _driven(bench, "trolley", replace(plain, run_s=_run_s(bench.budget_s, plain, runs)))


def _piston(bench: _Bench) -> _Found:
    plain = RivalSettings(tilt_sd=TILT_SD)
    runs = len(plain.piston_hz)
    return _driven(bench, "piston", replace(plain, run_s=_run_s(bench.budget_s, plain, runs)))


def _driven(bench: _Bench, kind: Literal["trolley", "piston"], settings: RivalSettings) -> _Found:
    """Fit accelerometers to what the drive was told to do; what the drive does besides is an error of the method."""
    motion = rival_motion(kind, rng=bench.rng, settings=settings)
    told = rival_motion(kind, rng=np.random.default_rng(0), settings=replace(settings, tilt_sd=0.0, shake=0.0))
    session = bench.session(motion)
    said = (*_words(session), f"accelerometers fitted to what the {kind} was told to do, not to what it did")
    record = session.records[0]
    accel = record.accel
    if accel is None:
        raise InputError(f"{kind}: wanted accelerometer readings, got none; a device without them is not calibrated so")
    sliding = np.flatnonzero(np.abs(told.rate_b).max(axis=1) == 0.0)
    best: tuple[float, TriadModel] | None = None
    for lag_s in LAGS_S:
        force = np.column_stack([np.interp(told.time - lag_s, told.time, column) for column in told.force_b.T])
        forward = fit_forward(force[sliding], accel[sliding], None)
        size = float((forward.residuals**2).sum())
        if best is None or size < best[0]:
            reach = float(np.abs(force).max())
            model = triad_from_forward(
                forward,
                method=f"known-force/{kind}",
                unit_in=record.accel_unit,
                unit_out="m/s2",
                valid_range=(-reach, reach),
                verdict=Verdict(),
            ).model
            best = (size, model)
    return _Found(None, None if best is None else best[1], said, _stills(session), _length_s(motion))


def _mocap(bench: _Bench) -> _Found:
    """Turn the device by hand before the cameras, a minute at a time."""
    count = max(1, round(bench.budget_s / (6.0 * HAND.run_s + 2.0 * HAND.still_s)))
    motions = [_within_range(bench, HAND) for _ in range(count)]
    return _referred(bench, motions, OPTICS_ANGLE_SD, "optics see")


def _robot_arm(bench: _Bench) -> _Found:
    run_s = (bench.budget_s - 2.0 * HAND.still_s) / 6.0
    return _referred(bench, [_within_range(bench, replace(HAND, run_s=run_s))], ARM_ANGLE_SD, "an arm tells")


def _within_range(bench: _Bench, settings: RivalSettings) -> Motion:
    """Return a motion about all axes that stays within the gyroscopes' range, as who performs it would see to."""
    limit = MOST_OF_RANGE * bench.device.gyro.full_scale
    state = bench.rng.bit_generator.state
    motion = rival_motion("robot_arm", rng=bench.rng, settings=settings)
    peak = float(np.abs(motion.rate_b).max())
    if peak <= limit:
        return motion
    bench.rng.bit_generator.state = state
    roll, pitch, yaw = (limit / peak * turn for turn in settings.robot_turn)
    return rival_motion("robot_arm", rng=bench.rng, settings=replace(settings, robot_turn=(roll, pitch, yaw)))


def _plane_and_mocap(bench: _Bench) -> _Found:
    half = replace(bench, budget_s=0.5 * bench.budget_s)
    plane, optics = _inclined_plane(half), _mocap(half)
    return replace(
        optics,
        accel=plane.accel,
        said=(*(word for word in plane.said if "gyro" not in word), *optics.said[:-1]),
        seconds=plane.seconds + optics.seconds,
    )


def _data_sheet(bench: _Bench) -> _Found:
    return _Found(None, None, ("nothing was recorded: nominal sensitivities and nulls, square axes",), (), 0.0)


_HOW: dict[Method, Callable[[_Bench], _Found]] = {
    "data_sheet": _data_sheet,
    "rate_table": _rate_table,
    "inclined_plane": _inclined_plane,
    "plane_and_moves": _plane_and_moves,
    "trolley": _trolley,
    "piston": _piston,
    "mocap": _mocap,
    "robot_arm": _robot_arm,
    "plane_and_mocap": _plane_and_mocap,
}


def _fitted(session: Session, seconds: float) -> _Found:
    try:
        made = calibrate(session)
    except CalibrationError as error:
        return _Found(None, None, (str(error),), _stills(session), seconds)
    # An offset without a scale is no calibration of the gyroscopes: the procedure says so, and gives no model.
    return _Found(made.gyro, made.accel, made.verdict.reasons, _stills(session), seconds, made)


def _words(session: Session) -> tuple[str, ...]:
    """Return what the procedure says to a session that it has no fit for."""
    try:
        return calibrate(session).verdict.reasons
    except CalibrationError as error:
        return (str(error),)


def _referred(bench: _Bench, motions: list[Motion], angle_sd: float, what: str) -> _Found:
    """Fit gyroscopes to poses of given noise."""
    unseen = f"accelerometers not observable: {what} orientation, not specific force; rest on six faces for them"
    records = tuple(bench.read(motion) for motion in motions)
    references = []
    for motion in motions:
        q = motion.q_nb + 0.5 * angle_sd * bench.rng.standard_normal(motion.q_nb.shape)
        q = q / np.linalg.norm(q, axis=1, keepdims=True)
        references.append(Reference(time=motion.time, q_nb=q, moving=motion.moving, name=what))
    seconds = sum(_length_s(motion) for motion in motions)
    rests = tuple(record.part(m.stills[0].start, m.stills[0].stop) for record, m in zip(records, motions, strict=True))
    try:
        made = calibrate_to_references(records, references)
    except (CalibrationError, AlignmentError) as error:
        return _Found(None, None, (str(error), unseen), rests, seconds)
    return _Found(made.gyro, None, (*made.verdict.reasons, unseen), rests, seconds, made)


def _session(records: tuple[Record, ...], stills: tuple[Still, ...], motion: Motion) -> Session:
    return Session(
        kind="calibration",
        serial=records[0].device,
        gravity_m_s2=motion.gravity_m_s2,
        records=records,
        stills=stills,
        turns=motion.turns if len(records) == 1 else (),
    )


def _stills(session: Session) -> tuple[Record, ...]:
    return tuple(session.records[still.recording].part(still.start, still.stop) for still in session.stills)


def _at_rest(nominal: TriadModel | None, rests: tuple[Record, ...]) -> TriadModel | None:
    """Return the data sheet's gyroscopes with the mean reading at rest as their offset."""
    seen = [part.gyro for part in rests if part.gyro is not None]
    return nominal if nominal is None or not seen else replace(nominal, offset=np.nanmean(np.concatenate(seen), axis=0))


def _to_gravity(nominal: Calibration, rests: tuple[Record, ...]) -> TriadModel | None:
    """Return the data sheet's accelerometers, all axes scaled alike so that rests read gravity in the mean."""
    seen = [part.accel.mean(axis=0) for part in rests if part.accel is not None]
    model = nominal.accel
    if model is None or not seen:
        return model
    length = float(np.mean([np.linalg.norm(model.matrix @ (mean - model.offset)) for mean in seen]))
    return replace(model, matrix=model.matrix * (nominal.gravity_m_s2 / length))


def _plane(budget_s: float) -> RivalSettings:
    plain = RivalSettings(tilt_sd=TILT_SD)
    still_s = _settled((budget_s / (3.0 * len(plain.plane_angles))) - plain.move_s, "inclined plane")
    return replace(plain, still_s=still_s)


def _run_s(budget_s: float, plain: RivalSettings, runs: int) -> float:
    return _settled((budget_s / 3.0 - plain.move_s - plain.still_s) / runs - plain.still_s, "runs")


def _settled(seconds: float, what: str) -> float:
    if seconds < 2.0:
        raise InputError(
            f"rivals: wanted 2 s or more for each still or run ({what}), got {seconds:.3g} s; give more minutes"
        )
    return math.floor(seconds * 10.0) / 10.0


def _length_s(motion: Motion) -> float:
    return len(motion) / motion.sample_rate_hz
