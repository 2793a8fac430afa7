"""The note's Discussion as an experiment: other ways to calibrate, other rates to dwell at, on the same devices.

Each method has the rate table's time. Where it cannot calibrate a triad, the data sheet stands in, with what rests add: the mean
reading of the gyroscopes, one scale of the accelerometers. Two errors of the pitch: the whole, and that of its change.

Optimal designs: one axis reads ``y = f(w)^T c + e``, f = (1, w, ..., w^p); with the share x_i of the time at rate w_i the
information is ``M = sum_i x_i f_i f_i^T``. D-optimal: greatest det M; I-optimal: least mean of ``f(w)^T M^-1 f(w)`` over the task.
``x_i <- x_i (g_i / sum_j x_j g_j)^(1/2)`` (Silvey et al., Communications in Statistics A7(14), 1978), g the derivative.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, NamedTuple, cast, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.calibrate import calibrate, calibrate_to_references
from undrift.errors import AlignmentError, CalibrationError, InputError
from undrift.fit.least_squares import fit_forward, triad_from_forward
from undrift.model import Calibration, TriadModel
from undrift.record import Record, Reference, Session, Still
from undrift.rig.programme import Protocol, rate_grid
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import preset_grade, random_device_of
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import nominal_calibration
from undrift.sim.motion.bench import BenchSettings, RivalSettings, bench_motion, rival_motion
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.tasks import TaskName, draw_task
from undrift.study.case import REST_S, device_of, perform, pitch_error, wear
from undrift.study.plan import TABLE_1, Study, StudyTask
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.trial import of_known

Method = Literal[
    "data_sheet",  # nothing is recorded
    "rate_table",  # six faces and steady rates both ways about three axes: the note's own
    "inclined_plane",  # stills on a tilted plane, nothing recorded between, as the note has it
    "plane_and_moves",  # the same with the moves between the stills recorded
    "trolley",  # a cart on a rail: known accelerations along each axis in turn
    "piston",  # a servohydraulic piston: known accelerations upright in turn
    "mocap",  # free turns of the body before optics: gyroscopes alone
    "robot_arm",  # an arm whose poses are known: gyroscopes alone
    "plane_and_mocap",  # half the time each: accelerometers from the plane, gyroscopes from optics
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

    def read(self, motion: Motion) -> Record:
        return simulate_device(self.device, motion, rng=self.rng, temp_c=TEMP_C, power_on_s=SETTLED_S).record


class _Found(NamedTuple):
    """What a method found; a triad that it could not calibrate is None."""

    calibration: Calibration | None
    notes: tuple[str, ...]
    rests: tuple[Record, ...]
    seconds: float


def rate_table_minutes() -> float:
    """Return how long the note's own session takes on the table."""
    return _length_s(bench_motion("bench", rng=np.random.default_rng(0), settings=BENCH)) / SECONDS_PER_MINUTE


def calibrate_by(
    method: Method, device: DeviceModel, *, kind: str, rng: np.random.Generator, minutes: float | None = None
) -> Rivalled:
    """Calibrate a device by one of the methods of the note's Discussion."""
    if method not in METHODS:
        raise InputError(f"rivals: wanted a method of {', '.join(METHODS)}, got '{method}'; name one of them")
    budget_s = (rate_table_minutes() if minutes is None else minutes) * SECONDS_PER_MINUTE
    bench = _Bench(device, nominal_calibration(preset_grade(kind)), budget_s, rng)
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
    plain = RivalSettings(tilt_sd=TILT_SD)
    still_s = _settled((bench.budget_s / (3.0 * len(plain.plane_angles))) - plain.move_s, "inclined plane")
    settings = replace(plain, still_s=still_s)
    return _fitted(bench, rival_motion("inclined_plane", rng=bench.rng, settings=settings), moves=moves)


def _driven(bench: _Bench, kind: Literal["trolley", "piston"]) -> _Found:
    """Fit accelerometers to the commanded motion of the drive; its departure from that is an error of the method."""
    plain = RivalSettings(tilt_sd=TILT_SD)
    runs = len(plain.trolley_hz if kind == "trolley" else plain.piston_hz)
    seconds = (bench.budget_s / 3.0 - plain.move_s - plain.still_s) / runs - plain.still_s
    settings = replace(plain, run_s=_settled(seconds, "runs"))
    motion = rival_motion(kind, rng=bench.rng, settings=settings)
    commanded = rival_motion(kind, rng=np.random.default_rng(0), settings=replace(settings, tilt_sd=0.0, shake=0.0))
    record = bench.read(motion)
    found = _fitted(bench, motion, record=record)
    if record.accel is None:
        raise InputError(f"{kind}: wanted accelerometer readings, got none; a device without them is not calibrated so")
    sliding = np.flatnonzero(np.abs(commanded.rate_b).max(axis=1) == 0.0)
    fits = []
    for lag_s in LAGS_S:
        time = commanded.time - lag_s
        force = np.column_stack([np.interp(time, commanded.time, column) for column in commanded.force_b.T])
        forward = fit_forward(force[sliding], record.accel[sliding], None)
        fits.append((float((forward.residuals**2).sum()), float(np.abs(force).max()), forward))
    _, reach, forward = min(fits, key=lambda fit: fit[0])
    units = {"unit_in": record.accel_unit, "unit_out": "m/s2"}
    accel = triad_from_forward(forward, method=f"known-force/{kind}", valid_range=(-reach, reach), **units).model
    note = f"accelerometers fitted to the commanded motion of the {kind}, not to the achieved one"
    return found._replace(calibration=replace(bench.nominal, gyro=None, accel=accel), notes=(*found.notes, note))


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
    accel = None if plane.calibration is None else plane.calibration.accel
    held = optics.calibration or replace(bench.nominal, gyro=None)
    return optics._replace(
        calibration=replace(held, accel=accel) if accel or held.gyro else None,
        notes=(*(word for word in plane.notes if "gyro" not in word), *optics.notes[:-1]),
        seconds=plane.seconds + optics.seconds,
    )


_HOW: dict[Method, Callable[[_Bench], _Found]] = {
    "data_sheet": lambda bench: _Found(
        None, ("nothing was recorded: nominal sensitivities and nulls, square axes",), (), 0.0
    ),
    "rate_table": lambda bench: _fitted(bench, bench_motion("bench", rng=bench.rng, settings=BENCH)),
    "inclined_plane": _inclined_plane,
    "plane_and_moves": partial(_inclined_plane, moves=True),
    "trolley": partial(_driven, kind="trolley"),
    "piston": partial(_driven, kind="piston"),
    "mocap": _mocap,
    "robot_arm": _robot_arm,
    "plane_and_mocap": _plane_and_mocap,
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
        made = replace(calibrate_to_references(records, references), accel=None)
    except (CalibrationError, AlignmentError) as error:
        return _Found(None, (str(error), unseen), rests, seconds)
    return _Found(made, (*made.verdict.reasons, unseen), rests, seconds)


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


def compare_rivals(
    *,
    kind: str = "enc03j_3031",
    units: int = 5,
    seed: int = 0,
    minutes: float | None = None,
    methods: tuple[Method, ...] = METHODS,
    tasks: tuple[TaskName, ...] = TASKS,
) -> tuple[RivalRow, ...]:
    """Compare ways to calibrate by the error that they leave in tasks."""
    if units < 1 or not methods or not tasks:
        raise InputError(
            f"rivals: wanted a unit, a method and a task or more, got {units}, {len(methods)} and {len(tasks)}; name some"
        )
    errors = np.full((len(tasks), len(methods), units, 3), np.nan)
    made: dict[Method, list[Rivalled]] = {method: [] for method in methods}
    refusals: dict[Method, list[str]] = {method: [] for method in methods}
    for number in range(units):
        device = random_device_of(kind, np.random.default_rng([seed, number, 0]))
        cases = []
        for k, task in enumerate(tasks):
            rng = np.random.default_rng([seed, number, 1, k])
            performed = draw_task(task, rng=rng, rest_s=REST_S)
            cases.append(wear(device, performed, rng=rng, temp_c=TEMP_C, power_on_s=SETTLED_S))
        for m, method in enumerate(methods):
            rng = np.random.default_rng([seed, number, 2, METHODS.index(method)])
            done = calibrate_by(method, device, kind=kind, rng=rng, minutes=minutes)
            made[method].append(done)
            for t, case in enumerate(cases):
                try:
                    error = pitch_error(case, done.calibration) / RADIAN_PER_DEGREE
                except InputError as refused:  # a calibration too poor to start from: no error, and not a zero
                    refusals[method].append(str(refused))
                    continue
                since = error - error[np.flatnonzero(np.isfinite(error))[0]]
                largest = np.nanmax(np.abs(error)), np.nanmax(np.abs(since))
                errors[t, m, number] = np.sqrt(np.nanmean(error**2)), *largest
    each = [(t, m) for t in range(len(tasks)) for m in range(len(methods))]
    return tuple(_row(made[methods[m]], tasks[t], errors[t, m], refusals[methods[m]][:1]) for t, m in each)


def _row(done: list[Rivalled], task: TaskName, errors: FloatArray, refused: list[str]) -> RivalRow:
    first, summaries = done[0], (np.median, np.min, np.max)
    rms, largest, change = (Spread(*(of_known(summary, column) for summary in summaries)) for column in errors.T)
    return RivalRow(
        method=first.method,
        task=task,
        minutes=first.minutes,
        observable=tuple(name for name in ("gyro", "accel") if all(name in one.observable for one in done)),
        error_rms_deg=rms,
        error_max_deg=largest,
        change_max_deg=change,
        units=len(done),
        refused=int(np.isnan(errors[:, 0]).sum()),
        notes=(*first.notes, *refused),
    )


# ---- optimal designs

Criterion = Literal["uniform", "D", "I"]
ROUNDS = 4000
CONVERGED = 1e-6  # of the greatest derivative over its mean
NOTHING = 1e-3  # share of the time that is not worth a stop


@dataclass(frozen=True, slots=True, eq=False)
class RateDesign:
    """Where to dwell, and for which share of the time."""

    criterion: Criterion  # D or I, or the uniform grid itself
    turn_rate: FloatArray  # (k,), rates, rad/s, increasing
    share: FloatArray  # (k,), of the time; they add up to 1
    d_efficiency_uniform: float  # Of the uniform grid's information over this design's; 0.5 needs twice the time
    i_efficiency_uniform: float  # As above, by the error over the task


def optimal_rates(
    candidates: FloatArray, task_rates: FloatArray, uniform: FloatArray, *, criterion: Criterion = "I", degree: int = 3
) -> RateDesign:
    """Find the rates that tell most for the dwelling time.
    candidates (n,) rad/s, increasing, task_rates (m,), uniform (u,) rad/s."""
    needed = degree + 1
    if min(len(np.unique(candidates)), len(np.unique(uniform))) < needed:
        raise InputError(
            f"design: wanted {needed} rates or more for a polynomial of degree {degree}, got {len(np.unique(candidates))} "
            f"candidates and {len(np.unique(uniform))} in the grid"
        )
    top = float(np.abs(candidates).max())
    f = np.vander(candidates / top, needed, increasing=True)
    aim = np.vander(task_rates / top, needed, increasing=True)
    wanted = aim.T @ aim / len(aim)
    share = _climb(f, wanted if criterion == "I" else None)
    kept = share > NOTHING
    share, own = share[kept] / share[kept].sum(), f[kept]
    grid = np.vander(uniform / top, needed, increasing=True)
    even = grid.T @ grid / len(grid)
    made = (own * share[:, None]).T @ own
    return RateDesign(
        criterion=criterion,
        turn_rate=candidates[kept],
        share=share,
        d_efficiency_uniform=float((np.linalg.det(even) / np.linalg.det(made)) ** (1.0 / needed)),
        i_efficiency_uniform=float(np.trace(np.linalg.solve(made, wanted)) / np.trace(np.linalg.solve(even, wanted))),
    )


def prediction_sd(
    turn_rate: FloatArray, share: FloatArray, task_rates: FloatArray, *, dwell_sd: float, dwells: float, degree: int = 3
) -> float:
    """Return how wrong the fitted curve will be over a task, root-mean-square.
    turn_rate (k,) rad/s, share (k,) rad/s, task_rates (m,) rad/s."""
    top = float(np.abs(turn_rate).max())
    f = np.vander(turn_rate / top, degree + 1, increasing=True)
    aim = np.vander(task_rates / top, degree + 1, increasing=True)
    information = (f * share[:, None]).T @ f * dwells
    return float(dwell_sd * np.sqrt(np.mean(np.einsum("mi,ij,mj->m", aim, np.linalg.inv(information), aim))))


def _climb(f: FloatArray, wanted: FloatArray | None) -> FloatArray:
    share = np.full(len(f), 1.0 / len(f))
    for _ in range(ROUNDS):
        inverse = np.linalg.inv((f * share[:, None]).T @ f)
        middle = inverse if wanted is None else inverse @ wanted @ inverse
        gain = np.einsum("ni,ij,nj->n", f, middle, f)
        mean = float(share @ gain)
        if gain.max() < mean * (1.0 + CONVERGED):
            break
        share = share * np.sqrt(gain / mean)
        share = share / share.sum()
    return share


# ---- rates to dwell at for each task

DEGREES = (1, 3)
CANDIDATES = 181
SAMPLES = 4000  # of the rates of a task
PERFORMED = 10  # subjects
RATE_HZ = 50.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignRow:
    """One set of rates for one task."""

    task: str  # What is done
    grid: str  # Whose uniform grid it is compared with: the note's, or that of the optimum
    degree: int  # Of the polynomial that an axis' reading is taken for
    criterion: Criterion  # uniform, D or I
    turn_rate_dps: tuple[float, ...]  # Rates of one axis, increasing; neighbours gathered
    share: tuple[float, ...]  # Of the time, at each
    d_efficiency_uniform: float  # Of the uniform grid's information over this set's; 1 for the grid itself
    i_efficiency_uniform: float  # As above
    dwells: int  # How many the uniform grid makes of one axis: all sets have their time
    dwell_s: float | None  # One dwell, s; None where it is stated by its uncertainty
    # Predicted error of the rate over the task, root-mean-square, deg/s; None for a device without white noise
    error_dps: float | None
    beyond: float  # Share of the task's rates above the greatest of the grid


def design_rows(study: Study, task: StudyTask, found: Protocol) -> tuple[DesignRow, ...]:
    """Compare sets of rates for one task."""
    note = TABLE_1.get(cast("TaskName", task.name)) if task.motion is None else None
    if note is None:
        grid, name = found.turn_rates(), "the optimum's"
    else:
        dps = rate_grid(note.turn_rate_min_dps, note.turn_rate_max_dps, note.turn_rate_step_dps, rule="paper")
        grid, name = dps * RADIAN_PER_DEGREE, "the note's"
    rates, dwell_s = task_rates(study, task), task.base.dwell_s
    noise = device_of(study, 0).gyro.white_noise
    dwell_sd = task.base.turn_rate_uncertainty if dwell_s is None else None
    if dwell_s is not None and noise is not None:
        dwell_sd = float(noise.random_walk[1] / np.sqrt(dwell_s))
    top, even = float(np.abs(grid).max()), np.full(len(grid), 1.0 / len(grid))
    candidates, criteria = np.linspace(-top, top, CANDIDATES), cast("tuple[Criterion, ...]", ("D", "I"))
    rows = []
    for degree in DEGREES:
        if len(np.unique(grid)) <= degree:  # too few rates for this polynomial
            continue
        designs = [RateDesign("uniform", grid, even, 1.0, 1.0)]
        designs += [optimal_rates(candidates, rates, grid, criterion=c, degree=degree) for c in criteria]
        for design in designs:
            at, share, error = design.turn_rate, design.share, None
            if dwell_sd is not None:
                error = prediction_sd(at, share, rates, dwell_sd=dwell_sd, dwells=len(grid), degree=degree)
            if design.criterion != "uniform":
                at, share = _gathered(at, share, 5.0 * top / (CANDIDATES - 1))
            row = DesignRow(
                task=task.name,
                grid=name,
                degree=degree,
                criterion=design.criterion,
                turn_rate_dps=tuple(float(rate / RADIAN_PER_DEGREE) for rate in at),
                share=tuple(map(float, share)),
                d_efficiency_uniform=design.d_efficiency_uniform,
                i_efficiency_uniform=design.i_efficiency_uniform,
                dwells=len(grid),
                dwell_s=dwell_s,
                error_dps=None if error is None else error / RADIAN_PER_DEGREE,
                beyond=float(np.mean(np.abs(rates) > top * (1.0 + 1e-9))),
            )
            rows.append(row)
    return tuple(rows)


def task_rates(study: Study, task: StudyTask) -> FloatArray:
    """Return the rates that occur in a task about the axis of the pitch, (m,) rad/s."""
    seen = []
    for number in range(1 if task.motion is not None else min(study.subjects, PERFORMED)):
        performed = perform(study, task, number)
        start, stop = performed.moving_s
        time = np.arange(start, min(stop, performed.duration_s), 1.0 / RATE_HZ)
        seen.append(performed.at(time, STANDARD_GRAVITY).rate_b[:, 1])
    rates: FloatArray = np.concatenate(seen)
    known: FloatArray = rates[np.isfinite(rates)]
    return known[:: len(known) // SAMPLES + 1].copy()


def _gathered(rate: FloatArray, share: FloatArray, near: float) -> tuple[FloatArray, FloatArray]:
    """Return a design whose neighbouring rates, of one stop that falls between candidates, are one rate."""
    groups = np.concatenate(([0], np.cumsum(np.diff(rate) > near)))
    total = np.bincount(groups, weights=share).astype(np.float64)
    return np.bincount(groups, weights=share * rate).astype(np.float64) / total, total
