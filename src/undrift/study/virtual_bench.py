"""A virtual bench recorded over real sockets: emulated table, thermal chamber, device and hands; a run folder for each protocol.

::

    bench      faces and rates at room temperature            for the constant calibration
    thermal    rates, and in the longer plan faces, at set-points    for the tables

All goes over TCP on the loopback through the drivers that drive hardware. Emulated time runs fifty times faster than the host's.
Rates are what positions of the encoder show against the card's clock; a busy host delays answers, and does not blur them. Hours of
soaking would still be long, so that this chamber heats by 10 K a second and this board, with its thermometer in moving air, follows
within seconds.

The note's method on what a virtual bench recorded: constant calibration, tables, and a worn trial at three levels.

::

    bench                        -> calibrate    offset, matrix
    bench and thermal            -> fit_drift    tables
    a sit-to-stand, worn, warmer -> correct, orient, compare with the optics     none, static, static and dynamic

Only ``bench_checks`` knows the hidden truth.
"""

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.calibrate import calibrate
from undrift.drift.fit import DriftFit, fit_drift
from undrift.errors import InputError, LinkError, RigTimeout
from undrift.live.clock import ClockSettings
from undrift.live.recorder import DwellReadings, Recorder, RecorderSettings
from undrift.live.transports import source_at
from undrift.model import Calibration, DriftTables, TriadModel
from undrift.record import FACES, Record, Reference, Session
from undrift.rig.chamber import ChamberSettings, SoakSettings, open_chamber
from undrift.rig.folder import RunFolder
from undrift.rig.guard import stopping_on_signals
from undrift.rig.link import Clock
from undrift.rig.programme import Programme, ProgrammeSettings, Protocol, programme_of
from undrift.rig.rig import open_rig
from undrift.rig.run import Bench, Progress, RunResult, run_programme
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.motion.poses import OpticsSettings, see
from undrift.sim.motion.tasks import draw_task
from undrift.sim.rig.bench import AirSettings, BenchHands, EmulatedBenchSettings, start_bench
from undrift.sim.rig.bench import Bench as EmulatedBench
from undrift.sim.rig.emulator import EmulatorSettings
from undrift.sim.rig.stream import StreamSettings
from undrift.study.figure3 import ROOM_TEMP_C, worn_record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.trial import Trial, validate_trial

# ---- The note's method on what a virtual bench recorded: constant calibration, tables, and a worn trial at three levels.

Level = Literal["constant calibration", "static table", "all tables"]
LEVELS: tuple[Level, ...] = ("constant calibration", "static table", "all tables")
EXCURSION_K = 12.5  # between the note's 10 and 15
OPTICS = OpticsSettings(gaps=0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BenchFit:
    """What the runs gave."""

    constant: Calibration  # Of the bench run alone
    drift: DriftFit  # Its calibration has the tables

    @property
    def levels(self) -> tuple[Calibration, Calibration, Calibration]:
        """Calibrations for each of ``LEVELS``."""
        full = self.drift.calibration
        static = replace(full.drift or DriftTables(), scale=None, dynamic=None)
        return self.constant, replace(full, drift=static), full


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WornTrial:
    """A sit-to-stand of a person who wears the device."""

    record: Record  # What the device read
    reference: Reference  # What the optics saw


def fit_bench(bench: Session, thermal: Session) -> BenchFit:
    """Fit what a virtual bench recorded."""
    constant = calibrate(bench)
    return BenchFit(constant=constant, drift=fit_drift((bench, thermal), constant))


def worn_trial(device: DeviceModel, *, seed: int, excursion_k: float = EXCURSION_K) -> WornTrial:
    """Simulate a sit-to-stand with a device that its wearer has warmed."""
    person, noise = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    performed = draw_task("sit_to_stand", rng=person)
    reference = see(performed, rng=person, settings=OPTICS)
    return WornTrial(record=worn_record(device, performed, excursion_k=excursion_k, rng=noise), reference=reference)


def judge_levels(fit: BenchFit, worn: WornTrial) -> tuple[Trial, ...]:
    """Hold the trial against the optics at each level of correction."""
    return tuple(
        validate_trial(worn.record, worn.reference, calibration=calibration, name=name)
        for name, calibration in zip(LEVELS, fit.levels, strict=True)
    )


# ---- What a virtual bench found, held against the hidden truth: the one place that may look at it.

MATRIX_LIMIT = 3e-3  # half a bit of 12 is 1e-3 of gravity, and there are three axes
WARM_MATRIX_LIMIT = 6e-3  # fewer and shorter turns at each set-point
GYRO_LIMIT_DPS = (
    0.25  # hysteresis of this kind is up to 0.1, what is left of the warm-up 0.05, the wander of an hour the rest
)
ACCEL_LIMIT_MG = 5.0  # three bits of 12
STATIC_SHARE, FULL_SHARE = 0.5, 0.25  # of the error without tables


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """A figure and the limit that it is held to."""

    name: str  # What it is, with its unit
    value: float  # The figure, and the most that it may be
    limit: float  # The figure, and the most that it may be

    @property
    def passed(self) -> bool:
        """True where the value does not exceed the limit."""
        return bool(self.value <= self.limit)


def bench_checks(fit: BenchFit, trials: tuple[Trial, ...], device: DeviceModel) -> tuple[Check, ...]:
    """Compare what was found with the hidden truth, and the errors of the trial with each other."""
    truth = true_calibration(device, temp_c=ROOM_TEMP_C)
    matrices = tuple(
        Check(
            name=f"{name}: matrix against the hidden one, largest element (1)",
            value=_matrix_apart(one, other),
            limit=MATRIX_LIMIT,
        )
        for name, one, other in (
            ("accelerometers", fit.constant.accel, truth.accel),
            ("gyroscopes", fit.constant.gyro, truth.gyro),
        )
    )
    return (*matrices, *_table_checks(fit, device), *_pitch_checks(trials))


def board_temperature(device: DeviceModel, reading_c: FloatArray) -> FloatArray:
    """Return the temperature of the board where a settled thermometer gives a reading.

    Arrays: reading_c (n,) degC -> (n,) degC.
    """
    thermometer = device.thermometer
    felt = (reading_c - thermometer.trim_error_c + 25.0 * thermometer.slope_error) / (1.0 + thermometer.slope_error)
    board: FloatArray = felt - thermometer.self_heating_c
    return board


def _table_checks(fit: BenchFit, device: DeviceModel) -> tuple[Check, ...]:
    """Offsets and the gyroscopes' matrix over the temperatures that were measured."""
    tables, summary = fit.drift.calibration.drift, fit.drift.gyro_summary
    if tables is None or tables.static is None or summary is None:
        raise InputError("tables: wanted offsets over temperature, got none; run the thermal programme")
    nodes = tables.static.temp_c
    seen = (nodes >= summary.seen_c[0]) & (nodes <= summary.seen_c[1])
    true = true_tables(device, board_temperature(device, nodes[seen]), np.array([-1.0, 0.0, 1.0]))
    constant = fit.constant
    gyro = _offset_apart(constant.gyro, tables, true, seen) / RADIAN_PER_DEGREE
    accel = _offset_apart(constant.accel, tables, true, seen) / STANDARD_GRAVITY * 1e3
    checks = [
        Check(name="gyroscopes: offset over temperature, largest error (deg/s)", value=gyro, limit=GYRO_LIMIT_DPS),
        Check(name="accelerometers: offset over temperature, largest error (mg)", value=accel, limit=ACCEL_LIMIT_MG),
    ]
    if tables.scale is not None and tables.scale.gyro_matrix is not None and true.scale is not None:
        hidden = true.scale.gyro_matrix
        pairs = zip(tables.scale.gyro_matrix[seen], () if hidden is None else hidden, strict=True)
        apart = max(_apart(one, other) for one, other in pairs)
        name = "gyroscopes: matrix over temperature, largest element (1)"
        checks.append(Check(name=name, value=apart, limit=WARM_MATRIX_LIMIT))
    return tuple(checks)


def _offset_apart(triad: TriadModel | None, found: DriftTables, true: DriftTables, seen: BoolArray) -> float:
    """Return the largest error of an offset table, in the unit that the triad makes of readings."""
    name = "gyro_offset" if triad is not None and triad.unit_out == "rad/s" else "accel_offset"
    table, hidden = (None if drift.static is None else getattr(drift.static, name) for drift in (found, true))
    if triad is None or table is None or hidden is None:
        raise InputError(f"tables: wanted {name} over temperature, got none; run the thermal programme")
    return float(np.abs((table[seen] - hidden) @ triad.matrix.T).max())


def _matrix_apart(found: TriadModel | None, true: TriadModel | None) -> float:
    if found is None or true is None:
        raise InputError("matrix: wanted that of both triads, got one missing; record faces and rates")
    return _apart(found.matrix, true.matrix)


def _apart(found: FloatArray, true: FloatArray) -> float:
    """Return the largest element of M_found M_true^-1 - I."""
    return float(np.abs(found @ np.linalg.inv(true) - np.eye(3)).max())


def _pitch_checks(trials: tuple[Trial, ...]) -> tuple[Check, ...]:
    none, static, full = (trial.figures for trial in trials)
    what = "worn sit-to-stand, pitch against the optics"
    return (
        Check(
            name=f"{what}, largest error, static table (deg)",
            value=static.max_abs_pitch_deg,
            limit=STATIC_SHARE * none.max_abs_pitch_deg,
        ),
        Check(
            name=f"{what}, largest error, all tables (deg)",
            value=full.max_abs_pitch_deg,
            limit=FULL_SHARE * none.max_abs_pitch_deg,
        ),
        Check(
            name=f"{what}, rms, all tables (deg)",
            value=full.rmse_pitch_deg,
            limit=FULL_SHARE * none.rmse_pitch_deg,
        ),
    )


# ---- virtual bench

KIND = "enc03j_3031"
UNIT_SEED = 1  # its pitch gyroscope drifts by 0.1 deg/s per K, well inside what this kind spreads
SET_POINTS_C = (18.0, 31.0, 38.0, 45.0)  # the worn board is at 37.5; the bench at 25
THERMOMETER_LAG_S = 5.0  # in the chamber's moving air
AIR = AirSettings(ramp_c_per_min=600.0, period_s=8.0, damping=0.8, board_lag_s=4.0)
SOAK = SoakSettings(slope_c_per_min=0.5, window_s=20.0)
SOAK_S = 25.0  # forecast of a soak: overshoot, then the window
CRYSTAL = ClockSettings(
    memory_s=1e5, rate_tolerance=1e-4
)  # a board that samples by a crystal: a busy host does not bend it
ATTEMPTS = 3  # a computer that is busy for a moment loses an answer; the run resumes
STEP_HOST_S = 0.04  # sockets and disk take as long for each step, host s

log = logging.getLogger(__name__)

Told = Callable[[str, float], None]  # what is being done, and the seconds of the host that are left of it


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchPlan:
    """What is recorded on a virtual bench."""

    bench: Protocol  # At room temperature, and at set-points
    thermal: Protocol  # At room temperature, and at set-points
    speed: float = 50.0  # Emulated seconds in one of the host's
    soak: SoakSettings = SOAK  # When a set-point counts as reached
    seed: int = 0  # Of the device's noise

    @property
    def programmes(self) -> tuple[Programme, Programme]:
        """Both written out, with a forecast for this chamber."""
        settings = ProgrammeSettings(mount_s=0.5, heating_c_per_min=AIR.ramp_c_per_min, soak_s=SOAK_S)
        return programme_of(self.bench, settings), programme_of(self.thermal, settings)

    @property
    def host_s(self) -> float:
        """Forecast of both, host s."""
        return sum(p.duration_s / self.speed + STEP_HOST_S * len(p.steps) for p in self.programmes)


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchRun:
    """What was recorded."""

    plan: BenchPlan  # What was asked for
    bench: RunResult  # What was done
    thermal: RunResult  # What was done
    host_s: float  # How long both took, host s


def bench_plan(*, quick: bool = False) -> BenchPlan:
    """Return what the demo records."""
    seconds = 3.0
    few = Protocol(
        name="thermal",
        faces=() if quick else FACES,
        face_s=seconds,
        dwell_s=seconds,
        bracket_s=2.0 * seconds,
        turn_rate_min=45.0 * RADIAN_PER_DEGREE,
        turn_rate_max=90.0 * RADIAN_PER_DEGREE,
        turn_rate_step=45.0 * RADIAN_PER_DEGREE,
        temperatures_c=SET_POINTS_C[1:3] if quick else SET_POINTS_C,
        soak_c_per_min=0.5,
    )
    least = (45.0 if quick else 15.0) * RADIAN_PER_DEGREE
    room = replace(
        few,
        name="bench",
        faces=FACES,
        bracket_s=seconds,
        turn_rate_min=least,
        turn_rate_step=least,
        temperatures_c=(),
    )
    return BenchPlan(bench=room, thermal=few)


def bench_device(seed: int = UNIT_SEED) -> DeviceModel:
    """Return the hidden truth: a unit of the note's kind, with its thermometer in moving air."""
    unit = random_device_of(KIND, np.random.default_rng(seed), serial=f"{KIND}-{seed}")
    return replace(unit, thermometer=replace(unit.thermometer, lag_s=THERMOMETER_LAG_S))


def record_on_bench(plan: BenchPlan, device: DeviceModel, folder: Path, *, told: Told) -> BenchRun:
    """Emulate a bench with a device on it and record both protocols."""
    began = time.monotonic()
    emulated = EmulatedBenchSettings(
        rig=EmulatorSettings(speed=plan.speed), air=AIR, stream=StreamSettings(seed=plan.seed), device=device
    )
    room, warm = plan.programmes
    later_s = warm.duration_s / plan.speed + STEP_HOST_S * len(warm.steps)
    with stopping_on_signals(), start_bench(emulated) as bench:
        told("virtual bench: faces and rates at room temperature", plan.host_s)
        first = _record(plan, bench, (plan.bench, room), folder / "bench", _steps("bench", plan, later_s, told))
        told("virtual bench: set-points in the thermal chamber", later_s)
        second = _record(plan, bench, (plan.thermal, warm), folder / "thermal", _steps("thermal", plan, 0.0, told))
    return BenchRun(plan=plan, bench=first, thermal=second, host_s=time.monotonic() - began)


def _record(
    plan: BenchPlan,
    bench: EmulatedBench,
    what: tuple[Protocol, Programme],
    path: Path,
    report: Callable[[Progress], None],
) -> RunResult:
    """Run one protocol, and resume it where a late answer ended it."""
    for attempt in range(1, ATTEMPTS):
        try:
            return _record_once(plan, bench, what, path, report, resume=attempt > 1)
        except (LinkError, RigTimeout) as error:
            log.warning("%s; resuming, attempt %d of %d", error, attempt + 1, ATTEMPTS)
    return _record_once(plan, bench, what, path, report, resume=True)


def _record_once(
    plan: BenchPlan,
    bench: EmulatedBench,
    what: tuple[Protocol, Programme],
    path: Path,
    report: Callable[[Progress], None],
    *,
    resume: bool,
) -> RunResult:
    """Run what is not on the disk yet; all connections end with it."""
    protocol, programme = what
    with ExitStack() as stack:
        folder = stack.enter_context(RunFolder(path, protocol, resume=resume))
        recorder = Recorder(source_at(bench.device_address), settings=RecorderSettings(clock=CRYSTAL))
        recorder.start()
        readings = DwellReadings(recorder)
        stack.callback(readings.close)
        chamber = None
        if protocol.temperatures_c:
            watched = ChamberSettings(soak=plan.soak, clock_speed=plan.speed, steepest_c_per_min=AIR.ramp_c_per_min)
            chamber = open_chamber(bench.chamber_address, watched)
            stack.callback(chamber.close)
        rig = open_rig(bench.rig_address)
        stack.callback(rig.close)
        connected = Bench(
            rig=rig,
            readings=readings,
            mounting=BenchHands(bench.hands_address),
            chamber=chamber,
            clock=Clock(speed=plan.speed),
        )
        return run_programme(
            programme,
            connected,
            folder,
            report=report,
            serial=recorder.source.description.device,
            gravity_m_s2=STANDARD_GRAVITY,
        )


def _steps(name: str, plan: BenchPlan, later_s: float, told: Told) -> Callable[[Progress], None]:
    def report(progress: Progress) -> None:
        left_s = progress.left_s / plan.speed + STEP_HOST_S * (progress.steps - progress.number) + later_s
        told(f"{name} {progress.number + 1}/{progress.steps}: {progress.step}, {progress.phase}", left_s)

    return report
