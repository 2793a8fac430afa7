"""Run a programme on a rig and write each dwell to the disk. At the end, the table is at rest and its motor is off.

For each dwell, the run starts a turn of its duration, waits for the ramp and lets the device settle. It then reads the device,
polls positions and stops the table. Finally, it checks the dwell (rig/judge.py) and writes it. The turn rate stored with the
readings is measured with the encoder over the dwell. A rest that was disturbed, or a face that was not mounted, is repeated.

Several devices on a table are mounted in the same orientation and read in the same dwells, with one folder per device. A device
that fails in a dwell misses that dwell. If all devices fail, the run ends.
"""

import logging
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, TypeVar

import numpy as np

from undrift.base.clock import Clock
from undrift.errors import InputError, RigError, RigFault, RigTimeout
from undrift.io.parquet import read_own_parquet
from undrift.programme import TURN_S, Dwell, Mount, Programme, Soak, Step
from undrift.record import Face, Kind, Record
from undrift.rig.chamber import Chamber, Operator, Readings, SoakWatch, mean_temp
from undrift.rig.folder import Head, RecordedDwell, RunFolder
from undrift.rig.judge import (
    Contradiction,
    Disturbed,
    RestCheck,
    RunSettings,
    TurnCheck,
    check_board,
    check_rate,
    check_readings,
    link_hides,
)
from undrift.rig.lock import uninterrupted
from undrift.rig.manual import ManualRig
from undrift.rig.rig import TRAVEL_MARGIN, Achieved, Position, Rig, achieved_turn_rate, check_programme

# ---- run

Phase = Literal[
    "enabling",
    "mounting",
    "setting",
    "soaking",
    "ramping",
    "settling",
    "dwelling",
    "turning",
    "resting",
    "writing",
    "closing",
]
POLLS = 20  # number of positions in a short dwell
POLL_S = 0.1  # time between two positions in a long dwell, host s
READS = 3  # number of attempts if positions or readings arrive too late
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


@dataclass(slots=True, kw_only=True, eq=False)
class Mounted:
    """A device on the table, with its folder and the checks that compare a dwell with earlier dwells."""

    readings: Readings
    folder: RunFolder
    serial: str = ""
    rests: RestCheck = field(default_factory=RestCheck)
    turns: TurnCheck = field(default_factory=TurnCheck)
    doubted: set[Face] = field(default_factory=set)
    withdrawn: frozenset[int] = frozenset()  # numbers of withdrawn steps
    missed: dict[int, RigError] = field(default_factory=dict)  # reasons for missed dwells, by step number

    def recall(self, programme: Programme) -> None:
        """Add the dwells on the disk to the checks of rests and turns."""
        for piece in self.folder.pieces:
            step = programme.steps[piece.step]
            if isinstance(step, Dwell):
                self.learn(step, piece.turn_rate, read_own_parquet(self.folder.path / piece.name))

    def learn(self, step: Dwell, turn_rate: float, record: Record) -> None:
        """Add an accepted dwell to the checks of rests and turns."""
        self.rests.keep(step, record)
        self.turns.keep(step, turn_rate, record)

    def keep(self, number: int, step: Dwell, record: Record, **fields: Any) -> None:
        """Write a dwell to the disk. `fields` are further fields of RecordedDwell."""
        piece = RecordedDwell(
            step=number,
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
        self.folder.keep(record, piece)

    def withdraw(self, face: Face) -> bool:
        """Withdraw all dwells with a face up that contradicts the others. Return False if that face was withdrawn before."""
        if face in self.doubted:
            return False
        self.doubted.add(face)
        log.warning(
            "the readings with %s up contradict the other faces, so this face is mounted and read again at the end",
            face,
        )
        self.withdrawn |= self.folder.withdraw(face)
        self.rests.forget(face)
        return True


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """Progress of a run."""

    phase: Phase  # current phase
    number: int  # number of the current step
    steps: int  # total number of steps
    step: str  # description of the step
    left_s: float  # forecast of the remaining time, table s
    live: str = ""  # latest reading of the device or the chamber
    air_c: float | None = None  # latest temperature of the chamber, degC
    device_c: float | None = None  # latest temperature of the device in a soak or a dwell, degC
    slope_c_per_min: float | None = None  # slope in a soak: of the air or, when that is steady, of the device


@dataclass(frozen=True, slots=True, kw_only=True)
class RunResult:
    """Result of a run."""

    pieces: tuple[RecordedDwell, ...]  # all dwells on the disk
    added: int  # number of dwells that this run added
    duration_s: float  # duration of this run, table s
    rig: str  # identity that the rig reports
    others: tuple["RunResult", ...] = ()  # results of the other devices on the table


Done = TypeVar("Done")
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
    others: Sequence[Mounted] = (),
) -> RunResult:
    """Run all dwells that are not on the disk yet. Each further device in `others` has its own folder."""
    devices = (Mounted(readings=bench.readings, folder=folder, serial=serial), *others)
    run = _Run(programme, bench, devices, report, settings)
    before = [device.folder.done for device in devices]
    try:
        check_programme(programme, bench.rig.limits, run.done, by_hand=isinstance(bench.rig, ManualRig))
        if bench.chamber is None and any(isinstance(step, Soak) for step in programme.steps):
            raise InputError("run: the programme has temperatures, which require a chamber. Set its address.")
        name, temps_c = bench.rig.identify(), {step.temp_c for step in programme.steps if isinstance(step, Soak)}
        kind: Kind = "thermal" if len(temps_c) > 1 else "calibration"  # tables require two temperatures
        for device in devices:
            digest, serial = device.folder.digest, device.serial
            device.folder.begin(Head(protocol=digest, rig=name, serial=serial, gravity_m_s2=gravity_m_s2, kind=kind))
            device.recall(programme)
        start = bench.clock.now()
        run.all_but(run.done)
        while again := run.withdrawn():  # a face is withdrawn once at most
            run.all_but(frozenset(range(len(programme.steps))) - again)
    except BaseException as error:
        run.close(error)
        raise
    run.close(None)
    for device in devices:
        _check_whole(programme, device)
    took_s = bench.clock.now() - start
    first, *further = (
        RunResult(
            pieces=device.folder.pieces,
            added=len(device.folder.done - (done - device.withdrawn)),
            duration_s=took_s,
            rig=name,
        )
        for device, done in zip(devices, before, strict=True)
    )
    return replace(first, others=tuple(further))


def _check_whole(programme: Programme, device: Mounted) -> None:
    """Raise RigTimeout if a device missed dwells."""
    steps = {number for number, step in enumerate(programme.steps) if isinstance(step, Dwell)}
    if missing := sorted(steps - device.folder.done):
        reason = str(device.missed.get(missing[0], "it failed before")).removesuffix(".")
        raise RigTimeout(
            f"{device.folder.path}: expected {len(steps)} dwells, got {len(steps) - len(missing)}. Step {missing[0]} "
            f"({programme.steps[missing[0]]}) is missing: {reason}. Check this device and continue with `resume`."
        )


def _air(air_c: float | None) -> str:
    return "air not read" if air_c is None else f"{air_c:.2f} degC"


def _heat(run: "_Run", step: Soak, chamber: Chamber) -> dict[Mounted, SoakWatch]:
    run._say("setting" if chamber.near_c is not None else "soaking")  # setting by hand takes time
    run._heated = True
    chamber.set(step.temp_c)
    run._say("soaking")
    clock, lag_s = run._bench.clock, run._settings.device_lag_s
    return run._sound(run._due, lambda device: SoakWatch(device.readings, clock, step, chamber, lag_s))


def _followed(boards: dict[Mounted, SoakWatch], steady: bool, device: Mounted) -> bool:
    return boards[device].followed(steady)


def _soak(run: "_Run", step: Soak, chamber: Chamber) -> None:
    clock, run._due = run._bench.clock, run._devices
    last, boards = clock.now() + run._settings.soak_timeout_s, _heat(run, step, chamber)
    while True:
        followed = run._sound(boards, partial(_followed, boards, chamber.soaked()))
        boards = {device: boards[device] for device in followed}
        board = next(iter(boards.values()))
        if all(followed.values()):
            run._soaks_s = run._soaks_s[0] + step.duration_s, run._soaks_s[1] + clock.now() - run._began
            return
        if clock.now() > last:
            raise RigTimeout(
                f"chamber: not steady at {step.temp_c:g} degC within {step.slope_c_per_min:g} K/min after "
                f"{run._settings.soak_timeout_s:g} s, got {_air(chamber.read())}{board}. Check chamber and device."
            )
        if board.elsewhere():
            log.warning("chamber: expected %g degC, got a steady%s. Set the chamber again.", step.temp_c, board)
            boards = _heat(run, step, chamber)
        clock.wait(max(AIR_POLL_S, 0.05 * clock.speed))
        run._temps = {"air_c": (air_c := chamber.read()), "device_c": board.temp_c}
        run._say("soaking", f"{_air(air_c)}{board}", slope_c_per_min=board.slope_c_per_min(chamber))


def _forecast_s(step: Step, soaks_s: tuple[float, float]) -> float:
    """Return the forecast duration of a step, s. Soaks are scaled with the actual durations of earlier soaks in this run."""
    wanted_s, taken_s = soaks_s if isinstance(step, Soak) and soaks_s[0] else (1.0, 1.0)
    return step.duration_s * taken_s / wanted_s


class _Run:
    """A run in progress."""

    def __init__(
        self, programme: Programme, bench: RigBench, devices: tuple[Mounted, ...], report: Report, settings: RunSettings
    ) -> None:
        self._programme, self._bench, self._devices = programme, bench, devices
        self._report, self._settings = report, settings
        self._enabled, self._heated, self._due = False, False, devices
        self._old_fault: str | None = None
        self._temps: dict[str, float | None] = {}  # temperatures for Progress
        self._step: Step = programme.steps[0]
        self._began, self._number, self._left_s = bench.clock.now(), 0, 0.0
        self._soaks_s = 0.0, 0.0  # forecast and actual duration of all finished soaks

    @property
    def done(self) -> frozenset[int]:
        """Numbers of the steps that are on the disk for all devices."""
        return frozenset.intersection(*(device.folder.done for device in self._devices))

    def withdrawn(self) -> frozenset[int]:
        """Return the steps that were withdrawn and not repeated."""
        return frozenset().union(*(dev.withdrawn - dev.folder.done - dev.missed.keys() for dev in self._devices))

    def all_but(self, done: frozenset[int]) -> None:
        """Run the dwells that are not done, each after its mounting and its soak."""
        pending = {n: s for n, s in enumerate(self._programme.steps) if n not in done}
        waiting: dict[type, tuple[int, Step]] = {}  # mountings and soaks are skipped unless a dwell follows
        for number, step in enumerate(self._programme.steps):
            if not isinstance(step, Dwell):
                waiting[type(step)] = (number, step)
            elif number not in done:
                due = [waiting.pop(kind) for kind in (Mount, Soak) if kind in waiting]
                for next_number, next_step in (*due, (number, step)):
                    self._left_s = sum(_forecast_s(s, self._soaks_s) for n, s in pending.items() if n >= next_number)
                    self._do(next_number, next_step)

    def close(self, cause: BaseException | None) -> None:
        """Stop the table and switch the motor off. A second Ctrl-C does not interrupt this."""
        with uninterrupted():
            try:
                self._say("closing")
            finally:
                try:
                    self._bench.rig.close()
                except RigError as error:
                    if cause is None:
                        raise
                    reason = (str(cause) or type(cause).__name__).removesuffix(".")
                    raise type(error)(f"{reason}. At the end: {error}") from cause

    def _do(self, number: int, step: Step) -> None:
        self._number, self._step, self._began = number, step, self._bench.clock.now()
        if isinstance(step, Dwell):
            self._dwell(step)
            return
        self._disable()
        if isinstance(step, Mount):
            self._say("mounting")
            self._bench.mounting.mount(step.up)
        elif self._bench.chamber is not None:
            _soak(self, step, self._bench.chamber)

    def _sound(self, devices: Iterable[Mounted], do: Callable[[Mounted], Done]) -> dict[Mounted, Done]:
        """Call a function for each device. A device that fails misses this step. If all devices fail, raise the error."""
        done = dict[Mounted, Done]()
        for device in devices:
            try:
                done[device] = do(device)
            except RigError as error:
                self._miss(device, error)
        return done

    def _miss(self, device: Mounted, error: RigError) -> None:
        device.missed[self._number] = error
        if all(self._number in due.missed for due in self._due):
            raise error
        log.warning("%s: %s The other devices continue.", device.folder.path, error)

    def _turn(self, step: Dwell) -> None:
        """Read a turn by a known angle, with the rests before and after it. The rig or the operator reports the angle."""
        clock, rest_s, where = self._bench.clock, 0.5 * (step.dwell_s - TURN_S), f"step {self._number} ({step})"
        self._say("resting")
        clock.wait(step.settle_s)
        chamber_c = self._look_at_air(step)
        devices = [*self._sound(self._due, lambda device: device.readings.start())]
        clock.wait(rest_s)
        self._say("turning")
        angle = self._bench.rig.move_by(step.angle)
        self._say("resting")
        clock.wait(rest_s)
        records = self._records(devices)
        self._check_fault()
        self._look_at_air(step)

        def take(device: Mounted) -> None:
            missing = check_readings(records[device], 0.0, self._settings, where)
            self._temps["device_c"] = mean_temp(records[device])
            device.keep(self._number, step, records[device], missing=missing, chamber_c=chamber_c, angle=angle)

        self._say("writing")
        self._sound(records, take)

    def _dwell(self, step: Dwell) -> None:
        check_unheated(step, self._heated, f"step {self._number} ({step})")
        self._due = tuple(device for device in self._devices if self._number not in device.folder.done)
        for device in self._due:
            device.missed.pop(self._number, None)
        self._enable()
        if step.purpose == "turn":
            self._turn(step)
            return
        attempts, devices = READS, self._due
        while disturbed := self._one_dwell(step, devices):
            devices, doubts = tuple(disturbed), list[bool]()
            for device, error in disturbed.items():
                if isinstance(error, Contradiction) and (error.surely or attempts < READS):
                    doubts.append(device.withdraw(error.other))
            if sum(doubts) == len(disturbed):
                continue
            attempts -= 1
            if not attempts:
                for device, error in disturbed.items():
                    self._miss(device, error)
                return
            for error in disturbed.values():
                log.warning("%s The dwell is repeated.", error)
            if step.purpose == "face":
                self._disable()
                self._say("mounting")
                self._bench.mounting.mount(step.up)
                self._enable()

    def _one_dwell(self, step: Dwell, devices: Sequence[Mounted]) -> dict[Mounted, Disturbed]:
        """Read a dwell with some devices and write the accepted dwells. Return the devices that were disturbed."""
        records, achieved, set_rate, chamber_c = self._read_turning(step, devices)
        where = f"step {self._number} ({step})"
        check_rate(achieved, set_rate, self._settings, where)
        rates = {"set_turn_rate": set_rate, "turn_rate": achieved.turn_rate}
        rates["turn_rate_uncertainty"] = achieved.uncertainty

        def take(device: Mounted) -> Disturbed | None:
            record = records[device]
            missing = check_readings(record, step.dwell_s, self._settings, where)
            if step.temp_c is not None and self._bench.chamber is not None:
                check_board(record, self._bench.chamber.criterion.tolerance_c, where)
            try:
                device.rests.check(step, record, where)
                device.turns.check(step, achieved.turn_rate, record, where)
            except Disturbed as error:
                return error
            self._temps["device_c"] = mean_temp(record)
            device.keep(self._number, step, record, missing=missing, chamber_c=chamber_c, **rates)
            device.learn(step, achieved.turn_rate, record)
            return None

        self._say("writing")
        return {device: error for device, error in self._sound(records, take).items() if error is not None}

    def _read_turning(
        self, step: Dwell, devices: Sequence[Mounted]
    ) -> tuple[dict[Mounted, Record], Achieved, float, float | None]:
        """Turn and read, and repeat until the encoder determines the rate and the readings span the dwell.

        Return the readings, the achieved rate, the rate that the controller set and the temperature of the chamber.
        """
        rig, clock, turning = self._bench.rig, self._bench.clock, step.turn_rate != 0.0
        limited = turning and rig.limits.travel is not None
        reads = 1 if limited else READS  # another turn would exceed the travel
        for attempt in range(1, reads + 1):
            set_rate, end = 0.0, math.inf
            if turning:
                spare_s = (TRAVEL_MARGIN - 1.0) * abs(step.travel / step.turn_rate)
                spare_s += 0.0 if limited else attempt * SPARE_S * clock.speed
                self._say("ramping")
                end = clock.now() + step.duration_s - step.ramp_s + spare_s  # start of the slow-down
                set_rate = rig.turn_for(step.turn_rate, step.duration_s + spare_s)
                self._old_fault = None
                clock.wait(step.ramp_s)
            self._say("settling")
            clock.wait(step.settle_s)
            self._look_at_air(step)
            records, achieved, read_s = self._read(step, devices)
            chamber_c = self._look_at_air(step)
            if turning:
                rig.stop()
                if read_s > end or link_hides(achieved, self._settings):
                    continue
            # Late readings are missing at the start of the dwell. After the last attempt, check_readings rejects such a dwell.
            spans_s = (record.duration_s + 1.0 / record.sample_rate_hz for record in records.values())
            spanned_s = min(spans_s, default=np.inf)  # no device is left after a failed repetition
            if attempt == reads or spanned_s >= self._settings.least_part * step.dwell_s:
                return records, achieved, set_rate, chamber_c
        raise RigTimeout(
            f"rig: times of positions must be known to {self._settings.link_tolerance:.0%} of the dwell in step {self._number} "
            f"({step}), got delays of {achieved.delay_s:.3g} s in {achieved.span_s:.3g} s, {reads} times. Check the link and the "
            "load of this computer, or use longer dwells. Then continue with `resume`.",
            delay_s=achieved.delay_s,
        )

    def _records(self, devices: Sequence[Mounted]) -> dict[Mounted, Record]:
        """Return the readings of the devices until now."""
        for device in devices:  # all at the same time, so that a device without answer does not prolong other dwells
            device.readings.end()
        return self._sound(devices, lambda device: device.readings.stop())

    def _read(self, step: Dwell, devices: Sequence[Mounted]) -> tuple[dict[Mounted, Record], Achieved, float]:
        """Read devices and encoder over a dwell. Return the readings, the achieved rate and the end time of the dwell."""
        rig, clock = self._bench.rig, self._bench.clock
        phase: Phase = "dwelling" if step.turn_rate != 0.0 else "resting"
        every_s = min(POLL_S * clock.speed, step.dwell_s / POLLS)
        self._say(phase)
        devices = [*self._sound(devices, lambda device: device.readings.start())]
        looked, positions = clock.now(), list[Position]()
        stop = looked + step.dwell_s
        while clock.now() < stop or len(positions) < 3:
            if clock.now() - looked > max(AIR_POLL_S, 0.1 * clock.speed):
                self._look_at_air(step)
                looked = clock.now()
            clock.wait(every_s)  # before each position, so that the delays of the link are equal
            positions.append(rig.position())
            latest = self._sound(devices, lambda dev: f"{dev.readings.latest()} of {dev.serial or 'the device'}")
            devices = [*latest]
            self._say(phase, next(iter(latest.values()), ""))
        read_s = clock.now()
        records = self._records(devices)
        self._check_fault()
        return records, achieved_turn_rate(positions), read_s

    def _check_fault(self) -> None:
        fault, where = self._bench.rig.fault(), f"step {self._number} ({self._step})"
        if fault is not None and fault != self._old_fault:
            raise RigFault(f"rig: fault in {where}: {fault}. Check the table.")

    def _look_at_air(self, step: Dwell) -> float | None:
        self._temps["air_c"] = check_air(self._bench.chamber, step, f"step {self._number} ({step})")
        return self._temps["air_c"]

    def _enable(self) -> None:
        if not self._enabled:
            self._say("enabling")
            self._bench.rig.enable(True)
            self._enabled = True
            self._bench.rig.set_acceleration(self._programme.acceleration)
            self._old_fault = self._bench.rig.fault()  # a card reports its last stop until the next move
            # readings that are still in a buffer arrive while the table is at rest
            self._due = tuple(self._sound(self._due, lambda device: device.readings.start()))

    def _disable(self) -> None:
        """Switch the motor off during mounting and long waits."""
        if self._enabled:
            self._enabled = False
            self._bench.rig.enable(False)

    def _say(self, phase: Phase, live: str = "", **temps: float | None) -> None:
        left_s = self._left_s - min(self._bench.clock.now() - self._began, _forecast_s(self._step, self._soaks_s))
        number, steps, step = self._number, len(self._programme.steps), str(self._step)
        temps = self._temps | temps
        self._report(Progress(phase=phase, number=number, steps=steps, step=step, left_s=left_s, live=live, **temps))


def check_unheated(step: Dwell, heated: bool, where: str) -> None:
    """Raise RigFault if a dwell at room temperature would be read after a soak, such as a repeated face."""
    if step.temp_c is None and heated:
        raise RigFault(
            f"chamber: {where} requires room temperature, but the chamber was heated. Let it cool, then continue with `resume`."
        )


def check_air(chamber: Chamber | None, step: Dwell, where: str) -> float | None:
    """Return the air temperature, degC, or None without a chamber. Raise RigFault if it has left the set-point."""
    if chamber is None:
        return None
    air_c = chamber.read()
    tolerance_c = chamber.criterion.tolerance_c
    if air_c is not None and step.temp_c is not None and not abs(air_c - step.temp_c) <= tolerance_c:
        raise RigFault(
            f"chamber: expected {step.temp_c:g} degC within {tolerance_c:g} K in {where}, got "
            f"{air_c:.2f} degC. Check door and heater, then continue with `resume`.",
            temp_c=air_c,
        )
    return air_c
