"""The note's method on a virtual bench: emulated table, chamber and device over real sockets, fits, a worn trial, checks.

    bench      faces and rates at room temperature                   -> calibrate    offset, matrix
    thermal    rates, in the longer plan faces too, at set-points    -> fit_drift    tables
    a sit-to-stand, worn, warmer -> correct, orient, compare with the optics: none, static, static and dynamic

All data cross TCP on the loopback through the drivers that drive hardware; each protocol makes a run folder. Emulated time runs
fifty times faster than the host's. Rates come from the encoder's positions by the card's clock, so a busy host delays answers
and does not change them. The chamber heats by 10 K a second, and the board, with its thermometer in moving air, follows within
seconds; real soaks take hours. Only ``compare_with_truth`` knows the hidden truth.
"""

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.base.clock import Clock
from undrift.calibration.calibrate import calibrate
from undrift.drift.fit import DriftFit, fit_drift
from undrift.errors import InputError, LinkError, RigTimeout
from undrift.live.clock import ClockSettings
from undrift.live.recorder import DwellReadings, Recorder, RecorderSettings
from undrift.live.transports import source_at
from undrift.model import Calibration, DriftTables, TriadModel
from undrift.record import FACES, Record, Reference, Session
from undrift.rig.chamber import ChamberSetup, SoakSettings, open_chamber
from undrift.rig.folder import RunFolder
from undrift.rig.lock import stopping_on_signals
from undrift.rig.programme import Programme, ProgrammeSettings, Protocol, programme_of
from undrift.rig.rig import RigSettings, open_rig
from undrift.rig.run import Progress, RigBench, RunResult, run_programme
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.motion.poses import see
from undrift.sim.motion.tasks import draw_task
from undrift.sim.rig import emulator
from undrift.sim.rig.stream import StreamSettings
from undrift.sim.table_sessions import ROOM_TEMP_C
from undrift.study.figure3 import OPTICS, judge_compared, levels_of, worn_record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.trial import Trial

# ---- recording on the virtual bench

KIND = "enc03j_3031"
UNIT_SEED = 1  # its pitch gyroscope drifts by 0.1 deg/s per K, well inside what this kind spreads
SET_POINTS_C = (18.0, 31.0, 38.0, 45.0)  # the worn board is at 37.5; the bench at 25
THERMOMETER_LAG_S = 5.0  # in the chamber's moving air
AIR = emulator.AirSettings(ramp_c_per_min=600.0, period_s=8.0, damping=0.8, board_lag_s=4.0)
SOAK = SoakSettings(slope_c_per_min=0.5, window_s=20.0)
SETTLE_S = 35.0  # forecast of the air: overshoot, then the window
CRYSTAL = ClockSettings(memory_s=1e5, rate_tolerance=1e-4)  # the board samples by a crystal, whatever the host does
PATIENCE_S = 10.0  # the longest wait for table, chamber and device: a busy computer runs them late, host s
ATTEMPTS = 4  # a computer that is too busy loses an answer, or takes readings later than they are due; the run resumes
SLOWER = 2.5  # times, at each further attempt
PROBE_S = 0.1  # of processor time, that shows what others leave of it
LITTLE_SLOW, MOST_SLOW = 1.5, 40.0
STEP_HOST_S = 0.04  # sockets and disk take as long for each step, host s

log = logging.getLogger(__name__)

Tell = Callable[[str, float], None]  # gets what is being done, and the seconds of the host that are left of it


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchPlan:
    """What is recorded on a virtual bench."""

    bench: Protocol  # At room temperature
    thermal: Protocol  # At set-points
    speed: float = 50.0  # Emulated seconds in one of the host's

    @property
    def programmes(self) -> tuple[Programme, Programme]:
        """Both written out, with a forecast for this chamber."""
        settings = ProgrammeSettings(mount_s=0.5, heating_c_per_min=AIR.ramp_c_per_min, settle_s=SETTLE_S)
        return programme_of(self.bench, settings), programme_of(self.thermal, settings)


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchRun:
    """What was recorded."""

    plan: BenchPlan
    bench: RunResult
    thermal: RunResult
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
        board_lag_s=AIR.board_lag_s,
    )
    least = (45.0 if quick else 15.0) * RADIAN_PER_DEGREE
    room = replace(few, name="bench", faces=FACES, bracket_s=seconds, temperatures_c=())
    return BenchPlan(bench=replace(room, turn_rate_min=least, turn_rate_step=least), thermal=few)


def bench_device() -> DeviceModel:
    """Return the hidden truth: a unit of the note's kind, with its thermometer in moving air."""
    unit = random_device_of(KIND, np.random.default_rng(UNIT_SEED), serial=f"{KIND}-{UNIT_SEED}")
    return replace(unit, thermometer=replace(unit.thermometer, lag_s=THERMOMETER_LAG_S))


def host_slowness() -> float:
    """Return how many times longer than its processor time a moment's work takes here; 1 on a computer with one to spare."""
    began, used = time.monotonic(), time.process_time()
    while time.process_time() - used < PROBE_S:
        pass
    slow = (time.monotonic() - began) / PROBE_S
    return min(slow, MOST_SLOW) if slow > LITTLE_SLOW else 1.0


def record_on_bench(plan: BenchPlan, device: DeviceModel, folder: Path, *, tell: Tell) -> BenchRun:
    """Emulate a bench with a device on it and record both protocols; resume slower where the computer is too busy."""
    began = time.monotonic()
    done: list[RunResult] = []
    with stopping_on_signals():
        for attempt in range(1, ATTEMPTS + 1):
            slow = host_slowness()
            try:
                now = replace(plan, speed=plan.speed / slow)
                _record_rest(now, device, folder, done, tell, PATIENCE_S * slow, resume=attempt > 1)
                break
            except (LinkError, RigTimeout) as error:
                got = str(error).partition(";")[0]  # its advice is for a bench that is real
                if attempt == ATTEMPTS:
                    raise RigTimeout(
                        f"virtual bench: wanted a computer that keeps up, got one that leaves it 1/{slow:.1f} of a processor "
                        f"({got}); end other programs, then start again"
                    ) from error
                plan = replace(plan, speed=plan.speed / SLOWER)
                log.warning(
                    "virtual bench: busy computer (%s); resuming, attempt %d of %d, at speed %g",
                    *(got, attempt + 1, ATTEMPTS, plan.speed),
                )
    return BenchRun(plan=plan, bench=done[0], thermal=done[1], host_s=time.monotonic() - began)


def _record_rest(
    plan: BenchPlan,
    device: DeviceModel,
    folder: Path,
    done: list[RunResult],
    tell: Tell,
    patience_s: float,
    *,
    resume: bool,
) -> None:
    """Run the protocols that are not done yet on a bench of their own, and add their results."""
    stream = StreamSettings(seed=0, framing="frame")  # costs half as much as text
    emulated = emulator.EmulatedBenchSettings(
        rig=emulator.EmulatorSettings(speed=plan.speed), air=AIR, stream=stream, device=device
    )
    host_s = [p.duration_s / plan.speed + STEP_HOST_S * len(p.steps) for p in plan.programmes]
    with emulator.EmulatedBench(emulated) as bench:
        for which in range(len(done), 2):
            what = ("faces and rates at room temperature", "set-points in the thermal chamber")[which]
            tell(f"virtual bench: {what}", sum(host_s[which:]))
            later_s = sum(host_s[which + 1 :])
            done.append(_record(plan, bench, which, folder, tell, (later_s, patience_s), resume=resume))


def _record(
    plan: BenchPlan,
    bench: emulator.EmulatedBench,
    which: int,
    path: Path,
    tell: Tell,
    times_s: tuple[float, float],
    *,
    resume: bool,
) -> RunResult:
    """Run what is not on the disk yet; all connections end with it. What comes later, and the longest wait, host s."""
    later_s, patience_s = times_s
    protocol, programme = (plan.bench, plan.thermal)[which], plan.programmes[which]

    def report(progress: Progress) -> None:
        left_s = progress.left_s / plan.speed + STEP_HOST_S * (progress.steps - progress.number) + later_s
        text = f"{protocol.name} {progress.number + 1}/{progress.steps}: {progress.step}, {progress.phase}"
        tell(text, left_s)

    with ExitStack() as stack:
        folder = stack.enter_context(RunFolder(path / protocol.name, protocol, resume=resume))
        settings = RecorderSettings(clock=CRYSTAL, silence_s=patience_s)
        recorder = Recorder(source_at(bench.device_address), settings)
        readings = DwellReadings(recorder, deadline_s=patience_s)
        stack.callback(readings.close)
        recorder.start()
        chamber = None
        if protocol.temperatures_c:
            watched = ChamberSetup(soak=SOAK, clock=Clock(plan.speed), reply_timeout_s=patience_s)
            chamber = stack.enter_context(open_chamber(bench.chamber_address, watched))
        rig = open_rig(bench.rig_address, RigSettings(reply_timeout_s=patience_s))
        stack.callback(rig.close)
        hands, clock = emulator.BenchHands(bench.hands_address), Clock(speed=plan.speed)
        connected = RigBench(rig=rig, readings=readings, mounting=hands, chamber=chamber, clock=clock)
        serial = recorder.source.description.device
        return run_programme(programme, connected, folder, report=report, serial=serial, gravity_m_s2=STANDARD_GRAVITY)


# ---- fits and the worn trial

LEVELS = (
    "constant calibration",
    "static table",
    "all tables",
    "offset re-zeroed at a rest",
    "all tables, re-zeroed at a rest",
)
EXCURSION_K = 12.5  # between the note's 10 and 15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BenchFit:
    """What the runs gave."""

    constant: Calibration  # Of the bench run alone
    drift: DriftFit  # Its calibration has the tables


def fit_bench(bench: Session, thermal: Session) -> BenchFit:
    """Fit what a virtual bench recorded."""
    constant = calibrate(bench)
    return BenchFit(constant=constant, drift=fit_drift((bench, thermal), constant))


def worn_trial(device: DeviceModel, *, seed: int) -> tuple[Record, Reference]:
    """Simulate a sit-to-stand with a device that its wearer has warmed: what it reads, and what the optics see."""
    person, noise = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    performed = draw_task("sit_to_stand", rng=person)
    reference = see(performed, rng=person, settings=OPTICS)
    return worn_record(device, performed, excursion_k=EXCURSION_K, rng=noise), reference


def judge_levels(fit: BenchFit, record: Record, reference: Reference) -> tuple[Trial, ...]:
    """Compare the trial with the optics at each level of correction, and re-zeroed at the rest before it."""
    return judge_compared(levels_of(fit.constant, fit.drift.calibration), record, reference, LEVELS)


# ---- comparison with the hidden truth

MATRIX_LIMIT = 3e-3  # half a bit of 12 is 1e-3 of gravity, and there are three axes
WARM_MATRIX_LIMIT = 6e-3  # fewer and shorter turns at each set-point
GYRO_LIMIT_DPS = 0.25  # hysteresis of this kind is up to 0.1, the rest of the warm-up 0.05, random walk the rest
ACCEL_LIMIT_MG = 5.0  # three bits of 12
STATIC_SHARE, FULL_SHARE = 0.5, 0.25  # of the error without tables


class Check(NamedTuple):
    """A figure and its limit."""

    name: str  # What it is, with its unit
    value: float
    limit: float  # The most that it may be

    @property
    def passed(self) -> bool:
        """True where the value does not exceed the limit."""
        return bool(self.value <= self.limit)


def compare_with_truth(fit: BenchFit, trials: tuple[Trial, ...], device: DeviceModel) -> tuple[Check, ...]:
    """Compare the fits with the hidden truth, and the errors of the trial with each other."""
    found, true = fit.constant, true_calibration(device, temp_c=ROOM_TEMP_C)
    tables, summary = fit.drift.calibration.drift, fit.drift.gyro_summary
    if tables is None or tables.static is None or summary is None:
        raise InputError("tables: wanted offsets over temperature, got none; run the thermal programme")
    nodes = tables.static.temp_c
    seen = (nodes >= summary.seen_c[0]) & (nodes <= summary.seen_c[1])
    felt = device.thermometer  # settled: from its reading to the temperature of the board
    board = (nodes[seen] - felt.trim_error_c + 25.0 * felt.slope_error) / (1.0 + felt.slope_error) - felt.self_heating_c
    warm = true_tables(device, board, np.array([-1.0, 0.0, 1.0]))
    rows = []
    for name, one, other in (("accelerometers", found.accel, true.accel), ("gyroscopes", found.gyro, true.gyro)):
        if one is None or other is None:
            raise InputError("matrix: wanted that of both triads, got one missing; record faces and rates")
        text = f"{name}: matrix against the true one, largest element (1)"
        rows.append(Check(text, _apart(one.matrix, other.matrix), MATRIX_LIMIT))
    gyro = _offset_apart(found.gyro, tables, warm, seen) / RADIAN_PER_DEGREE
    accel = _offset_apart(found.accel, tables, warm, seen) / STANDARD_GRAVITY * 1e3
    rows.append(Check("gyroscopes: offset over temperature, largest error (deg/s)", gyro, GYRO_LIMIT_DPS))
    rows.append(Check("accelerometers: offset over temperature, largest error (mg)", accel, ACCEL_LIMIT_MG))
    scale, hidden = tables.scale, None if warm.scale is None else warm.scale.gyro_matrix
    if scale is not None and scale.gyro_matrix is not None and hidden is not None:
        apart = max(_apart(one, other) for one, other in zip(scale.gyro_matrix[seen], hidden, strict=True))
        rows.append(Check("gyroscopes: matrix over temperature, largest element (1)", apart, WARM_MATRIX_LIMIT))
    none, static, full = (trial.figures for trial in trials[:3])
    largest, what = none.max_abs_pitch_deg, "worn sit-to-stand, pitch against the optics"
    rows.append(Check(f"{what}, largest error, static table (deg)", static.max_abs_pitch_deg, STATIC_SHARE * largest))
    rows.append(Check(f"{what}, largest error, all tables (deg)", full.max_abs_pitch_deg, FULL_SHARE * largest))
    rows.append(Check(f"{what}, rms, all tables (deg)", full.rmse_pitch_deg, FULL_SHARE * none.rmse_pitch_deg))
    return tuple(rows)


def _offset_apart(triad: TriadModel | None, found: DriftTables, true: DriftTables, seen: BoolArray) -> float:
    """Return the largest error of an offset table, in the unit of the triad's output."""
    name = "gyro_offset" if triad is not None and triad.unit_out == "rad/s" else "accel_offset"
    table, hidden = (None if drift.static is None else getattr(drift.static, name) for drift in (found, true))
    if triad is None or table is None or hidden is None:
        raise InputError(f"tables: wanted {name} over temperature, got none; run the thermal programme")
    return float(np.abs((table[seen] - hidden) @ triad.matrix.T).max())


def _apart(found: FloatArray, true: FloatArray) -> float:
    """Return the largest element of M_found M_true^-1 - I."""
    return float(np.abs(found @ np.linalg.inv(true) - np.eye(3)).max())
