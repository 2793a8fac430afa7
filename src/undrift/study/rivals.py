"""The note's Discussion as an experiment: other ways to calibrate the same devices.

Each method has the rate table's time, and rigs that err alike: mountings, level and clock of a unit are the same draws in all.
Where it cannot calibrate a triad, the data sheet stands in, with what rests add: the mean reading of the gyroscopes, one scale of
the accelerometers. Two errors of the pitch: the whole, and that of its change. Then each triad alone against the truth, M and o::

    scale, cross-axis  diagonal of M_found M^-1 - 1, and the rest of it: alignment to the case included
    offset             M (o_found - o)
    tilt               angle of M_found (u - o_found) to f, root-mean-square over 26 directions of f
    change of pitch    as above, with accelerometers that are exact
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.calibrate import calibrate, calibrate_to_references
from undrift.calibration.reference import ReferenceSettings
from undrift.errors import AlignmentError, CalibrationError, InputError
from undrift.fit.least_squares import fit_forward, triad_from_forward
from undrift.frames import quaternion_of, quaternion_product, rotate
from undrift.model import Calibration, TriadModel
from undrift.record import Record, Reference, Session, Still
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import preset_grade, random_device_of
from undrift.sim.device.simulate import draw_streams, simulate_device
from undrift.sim.device.truth import nominal_calibration, true_calibration
from undrift.sim.motion.bench import (
    BenchSettings,
    RivalKind,
    RivalSettings,
    bench_motion,
    motion_of_arm,
    rig_of,
    rival_motion,
    robot_task,
)
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import OpticsSettings, disturbed
from undrift.sim.motion.tasks import Task, TaskName, draw_task
from undrift.study.case import REST_S, pitch_error, wear
from undrift.study.plan import DEVICE, MARGIN_DEG, NOTE_BENCH
from undrift.study.run import Executor, InProcess
from undrift.study.statistics import Decision, decide_between
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.trial import of_known

Method = Literal[
    "data_sheet",  # nothing is recorded
    "rate_table",  # six faces and steady rates both ways about three axes: the note's own
    "inclined_plane",  # stills on a tilted plane, nothing recorded between, as the note has it
    "plane_and_moves",  # the same with the moves between the stills recorded
    "trolley",  # a cart on a rail: known accelerations along each axis in turn
    "piston",  # a servohydraulic piston: known accelerations upright in turn
    "mocap",  # free turns and moves by hand before optics, which see orientation and position
    "robot_arm",  # the same by an arm whose poses are known
]
METHODS: tuple[Method, ...] = get_args(Method)
TriadName = Literal["gyro", "accel"]
TRIADS: tuple[TriadName, ...] = get_args(TriadName)
SECONDS_PER_MINUTE = 60.0
TEMP_C = 25.0
SETTLED_S = 3600.0
TABLE = BenchSettings()  # the note's rates for the sit-to-stand
MOST_OF_RANGE = 0.9  # of the gyroscopes' range, which a free motion keeps within
LOOK_HZ = 10.0  # often enough for its slow turns
HAND = RivalSettings()  # a minute of turns and ways between two stills, by an arm or by hand
LAGS_S = np.arange(0.0, 0.0401, 0.002)  # a filter delays the reading against the known acceleration
DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])

# What the rival rigs do wrong beside mounting, level, wobble and clock, which they share with the study's bench. All assumed.
PLANE_ANGLE_SD = 0.05 * RADIAN_PER_DEGREE  # a digital inclinometer
STROKE_SD = {"trolley": 0.01, "piston": 0.005}  # a crank set by a ruler, 1 mm of 150; a transducer of class 0.5
HARMONIC_SD = {"trolley": 0.01, "piston": 0.002}  # a crank with a short rod; a servo valve
# Optics, whose cluster of markers gives way; an arm that repeats within 0.05 mm over a metre, and bends with its pose.
POSES = {
    "mocap": OpticsSettings(slow_sd=0.05 * RADIAN_PER_DEGREE),
    "robot_arm": OpticsSettings(angle_sd=5e-5, position_sd=5e-5, slow_sd=0.01 * RADIAN_PER_DEGREE),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rivalled:
    """A device calibrated by one method."""

    method: Method  # Which
    calibration: Calibration  # What the method gave, the data sheet where it gave nothing
    minutes: float  # Of recordings, min
    observable: tuple[str, ...]  # gyro, accel: what the method calibrated
    notes: tuple[str, ...]  # Findings of the fits


@dataclass(frozen=True, slots=True, eq=False)
class _Bench:
    """A device on which a method has a given time to work."""

    device: DeviceModel
    nominal: Calibration
    budget_s: float
    rng: np.random.Generator
    errors: BenchErrors  # Of all rigs
    state: Mapping[str, Any]  # Of the generator that every rig of this unit is drawn from

    def rig(self) -> np.random.Generator:
        """Return the generator of mountings, level and clock, the same for every motion."""
        rng = np.random.default_rng(0)
        rng.bit_generator.state = dict(self.state)
        return rng

    def read(self, motion: Motion) -> Record:
        return simulate_device(self.device, motion, rng=self.rng, temp_c=TEMP_C, power_on_s=SETTLED_S).record


class _Found(NamedTuple):
    """What a method found; a triad that it could not calibrate is None."""

    calibration: Calibration | None
    notes: tuple[str, ...]
    rests: tuple[Record, ...]
    seconds: float


@cache
def rate_table_minutes() -> float:
    """Return how long the note's own session takes on the table."""
    return _length_s(bench_motion("bench", rng=np.random.default_rng(0), settings=TABLE)) / SECONDS_PER_MINUTE


def calibrate_by(
    method: Method,
    device: DeviceModel,
    *,
    kind: str,
    rng: np.random.Generator,
    minutes: float | None = None,
    errors: BenchErrors = NOTE_BENCH,
) -> Rivalled:
    """Calibrate a device by one of the methods of the note's Discussion; generators of one state give rigs that err alike."""
    if method not in METHODS:
        raise InputError(f"rivals: wanted a method of {', '.join(METHODS)}, got '{method}'; name one of them")
    bench = _Bench(
        device=device,
        nominal=nominal_calibration(preset_grade(kind)),
        budget_s=(rate_table_minutes() if minutes is None else minutes) * SECONDS_PER_MINUTE,
        errors=replace(
            errors, inclination=PLANE_ANGLE_SD, stroke=STROKE_SD.get(method, 0.0), harmonic=HARMONIC_SD.get(method, 0.0)
        ),
        state=np.random.default_rng(rng.integers(2**63)).bit_generator.state,
        rng=rng,
    )
    found = _HOW[method](bench)
    held = found.calibration
    gyro, accel = (None, None) if held is None else (held.gyro, held.accel)
    return Rivalled(
        method=method,
        calibration=replace(
            held or bench.nominal,
            device=device.serial,
            gyro=gyro or _at_rest(bench.nominal.gyro, found.rests),
            accel=accel or _to_gravity(bench.nominal, found.rests),
            reference_temp_c=TEMP_C,
        ),
        minutes=found.seconds / SECONDS_PER_MINUTE,
        observable=tuple(name for name, model in (("gyro", gyro), ("accel", accel)) if model is not None),
        notes=found.notes,
    )


def _inclined_plane(bench: _Bench, *, moves: bool = False) -> _Found:
    """Fit accelerometers to the stated angles; with the moves between them, as poses whose angles nobody knows."""
    plain = RivalSettings(errors=bench.errors)
    still_s = _settled((bench.budget_s / (3.0 * len(plain.plane_angles))) - plain.move_s, "inclined plane")
    settings = replace(plain, still_s=still_s)
    motion = rival_motion("inclined_plane", rng=bench.rig(), settings=settings)
    record = bench.read(motion)
    found = _fitted(bench, motion, record=record, moves=moves)
    return found if moves else _to_force(bench, "inclined_plane", settings, record, found)


def _driven(bench: _Bench, kind: Literal["trolley", "piston"]) -> _Found:
    plain = RivalSettings(errors=bench.errors)
    runs = len(plain.trolley_hz if kind == "trolley" else plain.piston_hz)
    seconds = (bench.budget_s / 3.0 - plain.move_s - plain.still_s) / runs - plain.still_s
    settings = replace(plain, run_s=_settled(seconds, "runs"))
    motion = rival_motion(kind, rng=bench.rig(), settings=settings)
    record = bench.read(motion)
    return _to_force(bench, kind, settings, record, _fitted(bench, motion, record=record))


def _to_force(bench: _Bench, kind: RivalKind, settings: RivalSettings, record: Record, found: _Found) -> _Found:
    """Fit accelerometers to what the rig was to do; its departure from that is an error of the method."""
    exact = replace(settings, errors=BenchErrors(), shake=0.0)
    commanded = rival_motion(kind, rng=np.random.default_rng(0), settings=exact)
    if record.accel is None:
        raise InputError(f"{kind}: wanted accelerometer readings, got none; a device without them is not calibrated so")
    steady = np.flatnonzero(np.abs(commanded.rate_b).max(axis=1) == 0.0)
    fits = []
    for lag_s in LAGS_S if kind != "inclined_plane" else LAGS_S[:1]:
        time = commanded.time - lag_s
        force = np.column_stack([np.interp(time, commanded.time, column) for column in commanded.force_b.T])
        forward = fit_forward(force[steady], record.accel[steady], None)
        fits.append((float((forward.residuals**2).sum()), float(np.abs(force).max()), forward))
    _, reach, forward = min(fits, key=lambda fit: fit[0])
    units = {"unit_in": record.accel_unit, "unit_out": "m/s2"}
    accel = triad_from_forward(forward, method=f"known-force/{kind}", valid_range=(-reach, reach), **units).model
    note = f"accelerometers fitted to the commanded motion of the {kind.replace('_', ' ')}, not to the achieved one"
    return found._replace(calibration=replace(bench.nominal, gyro=None, accel=accel), notes=(*found.notes, note))


def _referred(bench: _Bench, kind: Literal["mocap", "robot_arm"]) -> _Found:
    """Turn and move the device a minute at a time, mounted once, and fit it to the poses."""
    count = max(1, round(bench.budget_s / (6.0 * HAND.run_s + 2.0 * HAND.still_s)))
    motions, records, references = [], [], []
    for _ in range(count):
        task = _within_range(bench)
        motions.append(motion_of_arm(task, HAND))
        records.append(bench.read(motions[-1]))
        references.append(_seen(bench, task, motions[-1], POSES[kind]))
    seconds = sum(map(_length_s, motions))
    rests = tuple(record.part(m.stills[0].start, m.stills[0].stop) for record, m in zip(records, motions, strict=True))
    try:
        made = calibrate_to_references(records, references, settings=ReferenceSettings(mounting="one"))
    except (CalibrationError, AlignmentError) as error:
        return _Found(None, (str(error),), rests, seconds)
    return _Found(made, made.verdict.reasons, rests, seconds)


def _seen(bench: _Bench, task: Task, motion: Motion, poses: OpticsSettings) -> Reference:
    """Return poses with their noise, of a body that the device is mounted on askew, by a clock and a level that err."""
    mount, level, gain = rig_of(bench.errors, bench.rig())
    streams = draw_streams(bench.rng)
    q, position = disturbed(motion.q_nb, task.position(motion.time), streams=streams, settings=poses)
    q = quaternion_product(level, quaternion_product(q, quaternion_of(mount)))
    return Reference(time=motion.time * gain, q_nb=q, position=rotate(level, position), moving=motion.moving)


def _within_range(bench: _Bench) -> Task:
    """Return a motion about all axes that stays within the gyroscopes' range, as who performs it would see to."""
    limit = MOST_OF_RANGE * bench.device.gyro.full_scale
    state = bench.rng.bit_generator.state
    task = robot_task(rng=bench.rng, settings=HAND)
    peak = float(np.abs(motion_of_arm(task, replace(HAND, sample_rate_hz=LOOK_HZ)).rate_b).max())
    if peak <= limit:
        return task
    bench.rng.bit_generator.state = state
    roll, pitch, yaw = (limit / peak * turn for turn in HAND.robot_turn)
    return robot_task(rng=bench.rng, settings=replace(HAND, robot_turn=(roll, pitch, yaw)))


_HOW: dict[Method, Callable[[_Bench], _Found]] = {
    "data_sheet": lambda bench: _Found(
        None, ("nothing was recorded: nominal sensitivities and nulls, square axes",), (), 0.0
    ),
    "rate_table": lambda bench: _fitted(
        bench, bench_motion("bench", rng=bench.rig(), settings=replace(TABLE, errors=bench.errors))
    ),
    "inclined_plane": _inclined_plane,
    "plane_and_moves": partial(_inclined_plane, moves=True),
    "trolley": partial(_driven, kind="trolley"),
    "piston": partial(_driven, kind="piston"),
    "mocap": partial(_referred, kind="mocap"),
    "robot_arm": partial(_referred, kind="robot_arm"),
}


def _fitted(bench: _Bench, motion: Motion, *, record: Record | None = None, moves: bool = True) -> _Found:
    """Calibrate by the product's own procedure: from the whole recording, or from its stills alone."""
    record = record or bench.read(motion)
    parts = tuple(record.part(still.start, still.stop) for still in motion.stills)
    alone = tuple(Still(start=0, stop=len(part), recording=k) for k, part in enumerate(parts))
    session = Session(
        kind="calibration",
        serial=record.device,
        gravity_m_s2=motion.gravity_m_s2,
        records=(record,) if moves else parts,
        stills=motion.stills if moves else alone,
        turns=motion.turns if moves else (),
    )
    try:
        made = calibrate(session)
    except CalibrationError as error:
        return _Found(None, (str(error),), parts, _length_s(motion))
    # An offset without a scale is no calibration of the gyroscopes: the procedure says so, and gives no model.
    return _Found(made, made.verdict.reasons, parts, _length_s(motion))


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


def _settled(seconds: float, what: str) -> float:
    if seconds < 2.0:
        raise InputError(
            f"rivals: wanted 2 s or more for each still or run ({what}), got {seconds:.3g} s; give more minutes"
        )
    return math.floor(seconds * 10.0) / 10.0


def _length_s(motion: Motion) -> float:
    return len(motion) / motion.sample_rate_hz


# ---- methods compared

TASKS: tuple[TaskName, ...] = ("sit_to_stand", "posturography")
UNITS = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class RivalPlan:
    """What is compared on what."""

    kind: str = DEVICE  # Of device
    units: int = UNITS
    seed: int = 0
    minutes: float | None = None  # That each method has; None: the note's session on the table
    methods: tuple[Method, ...] = METHODS
    tasks: tuple[TaskName, ...] = TASKS
    errors: BenchErrors = NOTE_BENCH  # Of all rigs
    margin_deg: float = MARGIN_DEG["maximum"]  # Smallest difference of largest errors that matters
    level: float = 0.05  # Of the verdicts of one table together

    def __post_init__(self) -> None:
        if self.units < 1 or not self.methods or not self.tasks:
            raise InputError(
                f"rivals: wanted a unit, a method and a task or more, got {self.units}, {len(self.methods)} and "
                f"{len(self.tasks)}; name some"
            )


@dataclass(frozen=True, slots=True)
class Spread:
    """A figure over units."""

    median: float
    least: float
    greatest: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RivalRow:
    """One method in one task."""

    method: Method  # Which
    task: TaskName  # What was done
    minutes: float  # Of recordings, min
    observable: tuple[str, ...]  # gyro, accel: what the method calibrated in every unit
    error_rms_deg: Spread  # Pitch error over the motion, deg, over units
    error_max_deg: Spread
    # Largest error of the change of pitch since the motion began, deg: what the gyroscopes' calibration is worth
    change_max_deg: Spread
    units: int
    refused: int  # Units whose gravity at rest is too far off to start from; they are not in the figures
    # Findings of the fits to the first unit, what the method cannot observe; and why units were refused
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Worth:
    """What a triad's calibration leaves in one figure, and whether that is more or less than what the rate table leaves."""

    figure: str  # tilt, or the task whose change of pitch it is
    error_deg: Spread
    decision: Decision | None  # Against the rate table, or its six faces; None for these, and below three units


@dataclass(frozen=True, slots=True, kw_only=True)
class TriadRow:
    """One triad by one method, against the truth, over units."""

    triad: TriadName
    method: Method
    minutes: float  # Of recordings, min
    calibrated: int  # Units in which the method calibrated it; the data sheet stands in for the others
    units: int
    scale_percent: Spread  # Largest of the three axes
    cross_axis_percent: Spread  # Largest of the six terms, alignment to the case included
    offset: Spread  # Largest of the three axes, m/s2 or deg/s
    worth: tuple[Worth, ...]  # Tilt of the accelerometers; change of pitch of the gyroscopes, task by task


class Rivals(NamedTuple):
    """Methods in tasks, and each triad alone."""

    rows: tuple[RivalRow, ...]
    triads: tuple[TriadRow, ...]


class _Compared(NamedTuple):
    """One unit by M methods in T tasks."""

    made: list[Rivalled]
    errors: FloatArray  # (T, M, 3), deg; NaN where a unit was refused
    terms: FloatArray  # (2, M, 3), largest scale, cross-axis and offset error of gyroscopes and accelerometers
    worth: dict[TriadName, FloatArray]  # (k, M), deg
    refusals: list[tuple[int, str]]


def compare_rivals(
    plan: RivalPlan = RivalPlan(),
    *,
    executor: Executor | None = None,
    advance: Callable[[int, int], None] = lambda done, total: None,
) -> Rivals:
    """Compare ways to calibrate by the errors of each triad, and by those that they leave in tasks."""
    held: dict[int, _Compared] = {}
    for number, found in (executor or InProcess()).run(partial(_compare_unit, plan), range(plan.units)):
        held[number] = found
        advance(len(held), plan.units)
    units = [held[number] for number in range(plan.units)]
    each = [(t, m) for t in range(len(plan.tasks)) for m in range(len(plan.methods))]
    rows = tuple(
        _row(
            [unit.made[m] for unit in units],
            plan.tasks[t],
            np.array([unit.errors[t, m] for unit in units]),
            [text for unit in units for place, text in unit.refusals if place == m][:1],
        )
        for t, m in each
    )
    return Rivals(rows, tuple(row for name in TRIADS for row in _triad_rows(plan, units, name)))


def _compare_unit(plan: RivalPlan, number: int) -> _Compared:
    device = random_device_of(plan.kind, np.random.default_rng([plan.seed, number, 0]))
    truth, cases = true_calibration(device, temp_c=TEMP_C), []
    for k, task in enumerate(plan.tasks):
        rng = np.random.default_rng([plan.seed, number, 1, k])
        performed = draw_task(task, rng=rng, rest_s=REST_S)
        cases.append(wear(device, performed, rng=rng, temp_c=TEMP_C, power_on_s=SETTLED_S)[0])
    count, made, refusals = len(plan.methods), list[Rivalled](), list[tuple[int, str]]()
    errors, terms = np.full((len(cases), count, 3), np.nan), np.full((2, count, 3), np.nan)
    worth: dict[TriadName, FloatArray] = {"gyro": np.empty((len(cases), count)), "accel": np.empty((1, count))}
    for m, method in enumerate(plan.methods):
        rng = np.random.default_rng([plan.seed, number, 2])  # one state: the same rigs, and noise as far as it goes
        words: Any = {"kind": plan.kind, "rng": rng, "minutes": plan.minutes, "errors": plan.errors}
        made.append(calibrate_by(method, device, **words))
        found = made[-1].calibration
        for k, name in enumerate(TRIADS):
            terms[k, m] = _terms(getattr(found, name), getattr(truth, name))
        worth["accel"][0, m] = _tilt_deg(found.accel, truth.accel)
        for t, case in enumerate(cases):
            alone = pitch_error(case, replace(found, accel=truth.accel)) / RADIAN_PER_DEGREE
            worth["gyro"][t, m] = np.nanmax(np.abs(_since_start(alone)))
            try:
                error = pitch_error(case, found) / RADIAN_PER_DEGREE
            except InputError as refused:  # a calibration too poor to start from: no error, and not a zero
                refusals.append((m, str(refused)))
                continue
            largest = np.nanmax(np.abs(error)), np.nanmax(np.abs(_since_start(error)))
            errors[t, m] = np.sqrt(np.nanmean(error**2)), *largest
    return _Compared(made, errors, terms, worth, refusals)


def _since_start(error: FloatArray) -> FloatArray:
    since: FloatArray = error - error[np.flatnonzero(np.isfinite(error))[0]]
    return since


def _terms(found: TriadModel | None, truth: TriadModel | None) -> tuple[float, float, float]:
    """Return the largest error of scale and cross-axis terms, percent, and of the offset, m/s2 or deg/s."""
    if found is None or truth is None:
        return math.nan, math.nan, math.nan
    error = 100.0 * np.abs(found.matrix @ np.linalg.inv(truth.matrix) - np.eye(3))
    scale, offset = np.diag(error), np.abs(truth.matrix @ (found.offset - truth.offset))
    unit = RADIAN_PER_DEGREE if truth.unit_out == "rad/s" else 1.0
    return float(scale.max()), float((error - np.diag(scale)).max()), float(offset.max()) / unit


def _tilt_deg(found: TriadModel | None, truth: TriadModel | None) -> float:
    """Return how far what is found for gravity is from it, root-mean-square over its directions."""
    if found is None or truth is None:
        return math.nan
    up = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
    readings = STANDARD_GRAVITY * up @ np.linalg.inv(truth.matrix).T + truth.offset
    seen = (readings - found.offset) @ found.matrix.T
    angle = np.arctan2(np.linalg.norm(np.cross(seen, up), axis=1), (seen * up).sum(axis=1))
    return float(np.sqrt(np.mean(angle**2))) / RADIAN_PER_DEGREE


def _spread(values: FloatArray) -> Spread:
    return Spread(*(of_known(summary, values) for summary in (np.median, np.min, np.max)))


def _row(done: list[Rivalled], task: TaskName, errors: FloatArray, refused: list[str]) -> RivalRow:
    first = done[0]
    rms, largest, change = (_spread(column) for column in errors.T)
    return RivalRow(
        method=first.method,
        task=task,
        minutes=first.minutes,
        observable=tuple(name for name in TRIADS if all(name in one.observable for one in done)),
        error_rms_deg=rms,
        error_max_deg=largest,
        change_max_deg=change,
        units=len(done),
        refused=int(np.isnan(errors[:, 0]).sum()),
        notes=(*first.notes, *refused),
    )


def _triad_rows(plan: RivalPlan, units: list[_Compared], name: TriadName) -> tuple[TriadRow, ...]:
    """Return one triad by each method; verdicts against the rate table are after Bonferroni over all of them."""
    terms = np.array([unit.terms[TRIADS.index(name)] for unit in units])
    worth = np.array([unit.worth[name] for unit in units])  # (n, k, M)
    figures = plan.tasks if name == "gyro" else ("tilt",)
    table = plan.methods.index("rate_table") if "rate_table" in plan.methods else None

    def decided(k: int, m: int) -> Decision | None:
        if table is None or m == table or len(units) < 3:
            return None
        tests = len(figures) * (len(plan.methods) - 1)
        return decide_between(worth[:, k, m], worth[:, k, table], margin=plan.margin_deg, level=plan.level, tests=tests)

    return tuple(
        TriadRow(
            triad=name,
            method=method,
            minutes=units[0].made[m].minutes,
            calibrated=sum(name in unit.made[m].observable for unit in units),
            units=len(units),
            scale_percent=_spread(terms[:, m, 0]),
            cross_axis_percent=_spread(terms[:, m, 1]),
            offset=_spread(terms[:, m, 2]),
            worth=tuple(
                Worth(figure=figure, error_deg=_spread(worth[:, k, m]), decision=decided(k, m))
                for k, figure in enumerate(figures)
            ),
        )
        for m, method in enumerate(plan.methods)
    )
