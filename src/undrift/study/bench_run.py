"""A virtual bench recorded over real sockets: emulated table, thermal chamber, device and hands; a run folder for each protocol.

::

    bench      faces and rates at room temperature            for the constant calibration
    thermal    rates, and in the longer plan faces, at set-points    for the tables

All goes over TCP on the loopback through the drivers that drive hardware. Emulated time runs fifty times faster than the host's.
Rates are what positions of the encoder show against the card's clock; a busy host delays answers, and does not blur them. Hours of
soaking would still be long, so that this chamber heats by 10 K a second and this board, with its thermometer in moving air, follows
within seconds.
"""

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from undrift.errors import LinkError, RigTimeout
from undrift.live.address import source_at
from undrift.live.clock import ClockSettings
from undrift.live.dwells import DwellReadings
from undrift.live.recorder import Recorder, RecorderSettings
from undrift.protocol import Protocol
from undrift.rig.address import open_rig
from undrift.rig.chamber import ChamberSettings, SoakSettings, open_chamber
from undrift.rig.clock import Clock
from undrift.rig.folder import RunFolder
from undrift.rig.programme import Programme, ProgrammeSettings, programme_of
from undrift.rig.run import Bench, Progress, RunResult, run_programme
from undrift.rig.signals import stopping_on_signals
from undrift.session import FACES
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device_of
from undrift.sim.rig.air import AirSettings
from undrift.sim.rig.bench import Bench as EmulatedBench
from undrift.sim.rig.bench import BenchHands, EmulatedBenchSettings, start_bench
from undrift.sim.rig.emulator import EmulatorSettings
from undrift.sim.rig.stream import StreamSettings
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

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
    """What is recorded on a virtual bench.

    Parameters
    ----------
    bench, thermal : Protocol
        At room temperature, and at set-points.
    speed : float
        Emulated seconds in one of the host's.
    soak : SoakSettings
        When a set-point counts as reached.
    seed : int
        Of the device's noise.
    """

    bench: Protocol
    thermal: Protocol
    speed: float = 50.0
    soak: SoakSettings = SOAK
    seed: int = 0

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
    """What was recorded.

    Parameters
    ----------
    plan : BenchPlan
        What was asked for.
    bench, thermal : RunResult
        What was done.
    host_s : float
        How long both took, host s.
    """

    plan: BenchPlan
    bench: RunResult
    thermal: RunResult
    host_s: float


def bench_plan(*, quick: bool = False) -> BenchPlan:
    """Return what the demo records.

    Parameters
    ----------
    quick : bool
        Two rates for six, two set-points for four and no faces at them.

    Returns
    -------
    BenchPlan
        Faces and rates at room temperature, then the set-points.
    """
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
    """Return the hidden truth: a unit of the note's kind, with its thermometer in moving air.

    Parameters
    ----------
    seed : int
        Which unit.

    Returns
    -------
    DeviceModel
        Three ENC-03J-like gyroscopes and three 3031-like accelerometers at 12 bits, with an LM335-like thermometer.
    """
    unit = random_device_of(KIND, np.random.default_rng(seed), serial=f"{KIND}-{seed}")
    return replace(unit, thermometer=replace(unit.thermometer, lag_s=THERMOMETER_LAG_S))


def record_on_bench(plan: BenchPlan, device: DeviceModel, folder: Path, *, told: Told) -> BenchRun:
    """Emulate a bench with a device on it and record both protocols.

    Parameters
    ----------
    plan : BenchPlan
        What to record.
    device : DeviceModel
        Goes to the emulator, and nowhere else.
    folder : Path
        Holds the run folders bench and thermal afterwards.
    told : callable
        Is told of each step.

    Returns
    -------
    BenchRun
        Every socket is closed, also after an exception or Ctrl-C.

    Raises
    ------
    RigError
        A link or the table failed.
    InputError
        A folder with a run in it, a full disk.
    """
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
