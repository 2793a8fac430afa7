"""Run a programme on a rig and write each dwell to the disk. At the end, the table is at rest and its motor is off.

For each dwell, the run starts a turn of its duration, waits for the ramp and lets the device settle. It then reads the device,
polls positions and stops the table. Finally, it checks the dwell (rig/judge.py) and writes it. The turn rate stored with the
readings is measured with the encoder over the dwell. A dwell that was disturbed or read late is repeated, up to three times.
"""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from undrift.base.clock import Clock
from undrift.errors import InputError, RigError, RigFault, RigTimeout
from undrift.io.parquet import read_own_parquet
from undrift.programme import TURN_S, Dwell, Mount, Programme, Soak, Step
from undrift.record import Face, Kind, Record
from undrift.rig.chamber import BoardWatch, Chamber, Operator, Readings, mean_temp
from undrift.rig.folder import Head, RecordedDwell, RunFolder
from undrift.rig.judge import (
    Disturbed,
    RestCheck,
    RunSettings,
    check_delays,
    check_rate,
    check_readings,
)
from undrift.rig.lock import uninterrupted
from undrift.rig.manual import ManualRig
from undrift.rig.rig import TRAVEL_MARGIN, Position, Rig, achieved_turn_rate, check_programme

POLLS = 20  # number of positions in a short dwell
POLL_S = 0.1  # time between two positions in a long dwell, host s
ATTEMPTS = 3  # number of attempts at a dwell
SPARE_S = 2.0  # extra duration of a move beyond its dwell, host s (the run ends the move early)
AIR_POLL_S = 2.0  # time between two readings of the chamber, table s

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class RigBench:
    """Equipment of a run. The run closes the rig but nothing else."""

    rig: Rig  # open rig
    readings: Readings  # readings of the device
    mounting: Operator  # operator who mounts the device
    chamber: Chamber | None = None  # required if the programme contains soaks
    clock: Clock = field(default_factory=Clock)  # clock of the rig


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """Progress of a run."""

    phase: str  # current phase: mounting, soaking, dwelling and so on
    number: int  # number of the current step
    steps: int  # total number of steps
    step: str  # description of the step
    left_s: float  # forecast of the remaining time, table s
    live: str = ""  # latest reading of the device or the chamber


@dataclass(frozen=True, slots=True, kw_only=True)
class RunResult:
    """Result of a run."""

    pieces: tuple[RecordedDwell, ...]  # all dwells on the disk
    added: int  # number of dwells that this run added
    duration_s: float  # duration of this run, table s
    rig: str  # identity that the rig reports


Report = Callable[[Progress], None]


def run_programme(
    programme: Programme,
    bench: RigBench,
    folder: RunFolder,
    *,
    report: Report,
    serial: str = "",
    gravity_m_s2: float | None = None,
    settings: RunSettings = RunSettings(),
) -> RunResult:
    """Run all dwells that are not on the disk yet."""
    run = _Run(programme, bench, folder, report, settings)
    done = folder.done
    try:
        check_programme(programme, bench.rig.limits, done, by_hand=isinstance(bench.rig, ManualRig))
        temps_c = {step.temp_c for step in programme.steps if isinstance(step, Soak)}
        if bench.chamber is None and temps_c:
            raise InputError("run: the programme has temperatures, which require a chamber. Set its address.")
        rig_name = bench.rig.identify()
        kind: Kind = "thermal" if len(temps_c) > 1 else "calibration"  # tables require two temperatures
        folder.begin(Head(protocol=folder.digest, rig=rig_name, serial=serial, gravity_m_s2=gravity_m_s2, kind=kind))
        run.remember_rests()
        start = bench.clock.now()
        run.all_but(done)
    except BaseException as error:
        run.close(error)
        raise
    run.close(None)
    return RunResult(
        pieces=folder.pieces,
        added=len(folder.done) - len(done),
        duration_s=bench.clock.now() - start,
        rig=rig_name,
    )


class _Run:
    """A run in progress."""

    def __init__(
        self, programme: Programme, bench: RigBench, folder: RunFolder, report: Report, settings: RunSettings
    ) -> None:
        self._programme, self._folder, self._report, self._settings = programme, folder, report, settings
        self._rig, self._clock, self._chamber = bench.rig, bench.clock, bench.chamber
        self._readings, self._mounting, self._rests = bench.readings, bench.mounting, RestCheck()
        self._enabled = False
        self._old_fault: str | None = None
        self._number, self._step, self._began, self._left_s = 0, programme.steps[0], bench.clock.now(), 0.0

    def remember_rests(self) -> None:
        """Add the rests on the disk to the check that compares a rest with earlier rests."""
        for piece in self._folder.pieces:
            step = self._programme.steps[piece.step]
            if isinstance(step, Dwell):
                self._rests.keep(step, read_own_parquet(self._folder.path / piece.name), piece.name)

    def all_but(self, done: frozenset[int]) -> None:
        """Run the dwells that are not done, each after its mounting and its soak."""
        pending_s = {n: step.duration_s for n, step in enumerate(self._programme.steps) if n not in done}
        waiting: dict[type, tuple[int, Step]] = {}  # mountings and soaks are skipped unless a dwell follows
        for number, step in enumerate(self._programme.steps):
            if not isinstance(step, Dwell):
                waiting[type(step)] = (number, step)
            elif number not in done:
                due = [waiting.pop(kind) for kind in (Mount, Soak) if kind in waiting]
                for self._number, self._step in (*due, (number, step)):
                    self._left_s = sum(seconds for n, seconds in pending_s.items() if n >= self._number)
                    self._began = self._clock.now()
                    self._do(self._step)

    def close(self, cause: BaseException | None) -> None:
        """Stop the table and switch the motor off. A second Ctrl-C does not interrupt this."""
        with uninterrupted():
            try:
                self._say("closing")
            finally:
                try:
                    self._rig.close()
                except RigError as error:
                    if cause is None:
                        raise
                    reason = (str(cause) or type(cause).__name__).removesuffix(".")
                    raise type(error)(f"{reason}. At the end: {error}") from cause

    @property
    def _where(self) -> str:
        return f"step {self._number} ({self._step})"

    def _do(self, step: Step) -> None:
        if isinstance(step, Dwell):
            self._dwell(step)
            return
        self._disable()
        if isinstance(step, Mount):
            self._mount(step.up)
        elif self._chamber is not None:
            self._soak(step, self._chamber)

    def _mount(self, up: Face) -> None:
        self._say("mounting")
        self._mounting.mount(up)

    # ---- Soaks

    def _soak(self, step: Soak, chamber: Chamber) -> None:
        """Set the chamber and wait until the air and the device are steady."""
        self._say("setting" if chamber.near_c is not None else "soaking")  # setting by hand takes time
        chamber.set(step.temp_c)
        last = self._clock.now() + self._settings.soak_timeout_s
        board = BoardWatch(self._readings, self._clock, step, chamber, self._settings.device_lag_s)
        while not board.followed(chamber.soaked()):
            air_c = chamber.read()
            live = f"{'air not read' if air_c is None else f'{air_c:.2f} degC'}{board}"
            if self._clock.now() > last:
                raise RigTimeout(
                    f"chamber: not steady at {step.temp_c:g} degC within {step.slope_c_per_min:g} K/min after "
                    f"{self._settings.soak_timeout_s:g} s, got {live}. Check chamber and device."
                )
            self._say("soaking", live)
            self._clock.wait(max(AIR_POLL_S, 0.05 * self._clock.speed))

    def _check_air(self, step: Dwell) -> float | None:
        """Return the air temperature, degC, or None without a chamber. Raise RigFault if it has left the set-point."""
        if self._chamber is None:
            return None
        air_c, tolerance_c = self._chamber.read(), self._chamber.criterion.tolerance_c
        if air_c is not None and step.temp_c is not None and not abs(air_c - step.temp_c) <= tolerance_c:
            raise RigFault(
                f"chamber: expected {step.temp_c:g} degC within {tolerance_c:g} K in {self._where}, got "
                f"{air_c:.2f} degC. Check door and heater, then continue with `resume`.",
                temp_c=air_c,
            )
        return air_c

    # ---- Dwells

    def _dwell(self, step: Dwell) -> None:
        """Read a dwell. Repeat it if it was disturbed or late."""
        self._enable()
        if isinstance(self._rig, ManualRig) and step.purpose == "turn":
            self._turn_by_angle(step, self._rig)
            return
        limited = step.turn_rate != 0.0 and self._rig.limits.travel is not None  # another turn would exceed the travel
        for attempt in range(1, ATTEMPTS + 1):
            problem = self._read_dwell(step, attempt, limited)
            if problem is None:
                return
            if limited or attempt == ATTEMPTS:
                raise problem
            log.warning("%s The dwell is repeated.", problem)
            if step.purpose == "face" and isinstance(problem, Disturbed):
                self._disable()
                self._mount(step.up)
                self._enable()

    def _read_dwell(self, step: Dwell, attempt: int, limited: bool) -> RigError | None:
        """Turn, read, check and write a dwell. Return the reason if it must be repeated."""
        rig, clock, turning, settings = self._rig, self._clock, step.turn_rate != 0.0, self._settings
        set_rate, last = 0.0, math.inf
        if turning:
            spare_s = (TRAVEL_MARGIN - 1.0) * abs(step.travel / step.turn_rate)
            spare_s += 0.0 if limited else attempt * SPARE_S * clock.speed
            self._say("ramping")
            last = clock.now() + step.duration_s - step.ramp_s + spare_s  # start of the slow-down
            set_rate = rig.turn_for(step.turn_rate, step.duration_s + spare_s)
            self._old_fault = None
            clock.wait(step.ramp_s)
        self._say("settling")
        clock.wait(step.settle_s)
        self._check_air(step)
        record, positions = self._read(step)
        chamber_c, achieved = self._check_air(step), achieved_turn_rate(positions)
        late_s = clock.now() - last
        if turning:
            rig.stop()
        try:
            if turning:
                check_delays(achieved, late_s, settings, self._where)
            check_rate(achieved, set_rate, settings, self._where)
            missing = check_readings(record, step.dwell_s, settings, self._where)
            self._rests.check(step, record, self._where)
        except (Disturbed, RigTimeout) as error:
            return error
        self._keep(
            step,
            record,
            missing=missing,
            chamber_c=chamber_c,
            set_turn_rate=set_rate,
            turn_rate=achieved.turn_rate,
            turn_rate_uncertainty=achieved.uncertainty,
        )
        return None

    def _read(self, step: Dwell) -> tuple[Record, list[Position]]:
        """Read device and encoder over a dwell."""
        clock, phase = self._clock, "dwelling" if step.turn_rate != 0.0 else "resting"
        every_s = min(POLL_S * clock.speed, step.dwell_s / POLLS)
        self._say(phase)
        self._readings.start()
        air_read_at, positions = clock.now(), list[Position]()
        stop = air_read_at + step.dwell_s
        while clock.now() < stop or len(positions) < 3:
            if clock.now() - air_read_at > max(AIR_POLL_S, 0.1 * clock.speed):
                self._check_air(step)
                air_read_at = clock.now()
            clock.wait(every_s)  # before each position, so that the delays of the link are equal
            positions.append(self._rig.position())
            self._say(phase, self._readings.latest())
        return self._record(), positions

    def _turn_by_angle(self, step: Dwell, rig: ManualRig) -> None:
        """Read a turn by a known angle, with the rests before and after it. The operator reports the angle."""
        rest_s = 0.5 * (step.dwell_s - TURN_S)
        self._say("resting")
        self._clock.wait(step.settle_s)
        chamber_c = self._check_air(step)
        self._readings.start()
        self._clock.wait(rest_s)
        self._say("turning")
        angle = rig.move_by(step.angle)
        self._say("resting")
        self._clock.wait(rest_s)
        record = self._record()
        self._check_air(step)
        missing = check_readings(record, 0.0, self._settings, self._where)
        self._keep(step, record, missing=missing, chamber_c=chamber_c, angle=angle)

    def _record(self) -> Record:
        """Return the readings of the dwell until now, and raise RigFault if the rig reports a new fault."""
        record = self._readings.stop()
        fault = self._rig.fault()
        if fault is not None and fault != self._old_fault:
            raise RigFault(f"rig: fault in {self._where}: {fault}. Check the table.")
        return record

    def _keep(self, step: Dwell, record: Record, **fields: Any) -> None:
        """Write a dwell to the disk. `fields` are further fields of RecordedDwell."""
        self._say("writing")
        piece = RecordedDwell(
            step=self._number,
            purpose=step.purpose,
            up=step.up,
            axis=step.axis,
            samples=len(record),
            start_s=float(record.time[0]),
            stop_s=float(record.time[-1]) + float(np.median(np.diff(record.time))),
            nominal_turn_rate=step.turn_rate,
            temp_c=step.temp_c,
            device_c=mean_temp(record),
            **fields,
        )
        self._folder.keep(record, piece)
        self._rests.keep(step, record, piece.name)

    # ---- Motor and progress

    def _enable(self) -> None:
        if not self._enabled:
            self._say("enabling")
            self._rig.enable(True)
            self._enabled = True
            self._rig.set_acceleration(self._programme.acceleration)
            self._old_fault = self._rig.fault()  # a card reports its last stop until the next move
            self._readings.start()  # readings that are still in a buffer arrive while the table is at rest

    def _disable(self) -> None:
        """Switch the motor off during mounting and long waits."""
        if self._enabled:
            self._enabled = False
            self._rig.enable(False)

    def _say(self, phase: str, live: str = "") -> None:
        left_s = self._left_s - min(self._clock.now() - self._began, self._step.duration_s)
        steps = len(self._programme.steps)
        self._report(
            Progress(phase=phase, number=self._number, steps=steps, step=str(self._step), left_s=left_s, live=live)
        )
