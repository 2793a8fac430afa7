"""Run a programme on a rig and write each dwell to the disk. At the end, the table is at rest and its motor is off.

For each dwell, the run starts a turn of its duration, waits for the ramp and lets the device settle. It then reads the device,
polls positions and stops the table. Finally, it checks the dwell (rig/judge.py) and writes it. The turn rate stored with the
readings is measured with the encoder over the dwell. A dwell that was disturbed or read late is repeated, up to three times.

Several devices on a table are mounted in the same orientation and read in the same dwells, with one folder per device. A device
that fails in a dwell misses this dwell. If all devices fail, the run ends.
"""

import logging
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast

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
    check_board,
    check_delays,
    check_rate,
    check_readings,
)
from undrift.rig.lock import uninterrupted
from undrift.rig.manual import ManualRig
from undrift.rig.rig import TRAVEL_MARGIN, Position, Rig, achieved_turn_rate, check_programme

POLLS = 20  # number of positions in a short dwell
POLL_S = 0.1  # time between two positions in a long dwell, table s
ATTEMPTS = 3  # number of attempts at a dwell
SPARE_S = 2.0  # extra duration of a move beyond its dwell, table s (the run ends the move early)
SOAK_TIMEOUT_S = 6.0 * 3600.0  # longest soak, table s
AIR_POLL_S = 2.0  # time between two readings of the chamber, table s

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class RigBench:
    """Equipment of a run, without its devices. The run closes the rig but nothing else."""

    rig: Rig  # open rig
    mounting: Operator  # operator who mounts the device
    chamber: Chamber | None = None  # required if the programme contains soaks
    clock: Clock = field(default_factory=Clock)  # clock of the rig


@dataclass(slots=True, kw_only=True, eq=False)
class Mounted:
    """A device on the table, with its folder and the check that compares a rest with earlier rests."""

    readings: Readings
    folder: RunFolder
    serial: str = ""
    rests: RestCheck = field(default_factory=RestCheck)
    missed: dict[int, RigError] = field(default_factory=dict)  # reasons for missed dwells, by step number

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
        self.rests.keep(step, record, piece.name)


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """Progress of a run."""

    phase: str  # current phase, for example dwelling
    number: int  # number of the current step
    steps: int  # total number of steps
    step: str  # description of the step
    left_s: float  # forecast of the remaining time, table s
    live: str = ""  # latest reading of the device or the chamber


@dataclass(frozen=True, slots=True, kw_only=True)
class RunResult:
    """Result of a run for a device."""

    pieces: tuple[RecordedDwell, ...]  # all dwells on the disk
    added: int  # number of dwells that this run added
    duration_s: float  # duration of this run, table s
    rig: str  # identity that the rig reports


Done = TypeVar("Done")
Report = Callable[[Progress], None]


def run_programme(
    programme: Programme,
    bench: RigBench,
    *devices: Mounted,
    report: Report,
    gravity_m_s2: float | None = None,
) -> tuple[RunResult, ...]:
    """Run all dwells that are not on the disk yet, and return a result for each device."""
    counts, start = [len(device.folder.done) for device in devices], bench.clock.now()
    with _Run(programme, bench, devices, report) as run:
        done = frozenset.intersection(*(device.folder.done for device in devices))
        check_programme(programme, bench.rig.limits, done, by_hand=isinstance(bench.rig, ManualRig))
        temps_c = {step.temp_c for step in programme.steps if isinstance(step, Soak)}
        if bench.chamber is None and temps_c:
            raise InputError("run: the programme has temperatures, which require a chamber. Set its address.")
        rig_name = bench.rig.identify()
        kind: Kind = "thermal" if len(temps_c) > 1 else "calibration"  # tables require two temperatures
        for device in devices:
            folder = device.folder
            head = Head(
                protocol=folder.digest, rig=rig_name, serial=device.serial, gravity_m_s2=gravity_m_s2, kind=kind
            )
            folder.begin(head)
            for piece in folder.pieces:
                step = programme.steps[piece.step]
                if isinstance(step, Dwell):
                    device.rests.keep(step, read_own_parquet(folder.path / piece.name), piece.name)
        run.all_but(done)
    duration_s = bench.clock.now() - start
    for device in devices:
        _check_whole(programme, device)
    return tuple(
        RunResult(
            pieces=device.folder.pieces, added=len(device.folder.done) - count, duration_s=duration_s, rig=rig_name
        )
        for device, count in zip(devices, counts, strict=True)
    )


def _check_whole(programme: Programme, device: Mounted) -> None:
    """Raise RigTimeout if a device missed dwells."""
    steps = {number for number, step in enumerate(programme.steps) if isinstance(step, Dwell)}
    if missing := sorted(steps - device.folder.done):
        reason = str(device.missed.get(missing[0], "it failed before")).removesuffix(".")
        raise RigTimeout(
            f"{device.folder.path}: expected {len(steps)} dwells, got {len(steps) - len(missing)}. Step {missing[0]} "
            f"({programme.steps[missing[0]]}) is missing: {reason}. Check this device and continue with `resume`."
        )


class _Run:
    """A run in progress, a context manager that stops the table and switches its motor off at the end."""

    def __init__(self, programme: Programme, bench: RigBench, devices: tuple[Mounted, ...], report: Report) -> None:
        self._programme, self._rig, self._clock, self._chamber = programme, bench.rig, bench.clock, bench.chamber
        self._mounting, self._devices, self._report = bench.mounting, devices, report
        self._enabled = self._air_steady = False
        self._due = devices  # devices that read the current step
        self._old_fault: str | None = None
        self._number, self._step, self._began, self._left_s = 0, programme.steps[0], bench.clock.now(), 0.0

    def __enter__(self) -> "_Run":
        return self

    def __exit__(self, kind: object, cause: BaseException | None, trace: object) -> None:
        with uninterrupted():  # a second Ctrl-C waits
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
        """Set the chamber and wait until the air and all devices are steady."""
        self._due = self._devices
        self._say("setting" if chamber.near_c is not None else "soaking")  # setting by hand takes time
        chamber.set(step.temp_c)
        last = self._clock.now() + SOAK_TIMEOUT_S
        boards = self._sound(self._due, lambda device: BoardWatch(device.readings, self._clock, step, chamber))
        while True:
            self._air_steady = chamber.soaked(step.slope_c_per_min)
            steady = self._sound(boards, lambda device: boards[device].followed(self._air_steady))
            if all(steady.values()):
                return
            board, air_c = boards[next(iter(steady))], chamber.read()
            live = f"{'air not read' if air_c is None else f'{air_c:.2f} degC'}{board}"
            if self._clock.now() > last:
                raise RigTimeout(
                    f"chamber: not steady at {step.temp_c:g} degC within {step.slope_c_per_min:g} K/min after "
                    f"{SOAK_TIMEOUT_S:g} s, got {live}. Check chamber and device."
                )
            self._say("soaking", live)
            self._clock.wait(AIR_POLL_S)

    def _check_air(self, step: Dwell) -> float | None:
        """Return the air temperature, degC, or None without a chamber. Raise RigFault if it has left the set-point."""
        if self._chamber is None:
            return None
        air_c, tolerance_c = self._chamber.read(), self._chamber.settings.tolerance_c
        if air_c is not None and step.temp_c is not None and not abs(air_c - step.temp_c) <= tolerance_c:
            raise RigFault(
                f"chamber: expected {step.temp_c:g} degC within {tolerance_c:g} K in {self._where}, got "
                f"{air_c:.2f} degC. Check door and heater, then continue with `resume`.",
                temp_c=air_c,
            )
        return air_c

    # ---- Dwells

    def _dwell(self, step: Dwell) -> None:
        """Read a dwell with all devices that do not have it. Repeat it for devices that were disturbed or late."""
        self._due = tuple(device for device in self._devices if self._number not in device.folder.done)
        for device in self._due:
            device.missed.pop(self._number, None)
        self._enable()
        if step.purpose == "turn":
            self._turn_by_angle(step)
            return
        limited = step.turn_rate != 0.0 and self._rig.limits.travel is not None  # another turn would exceed the travel
        devices = self._due
        for attempt in range(1, ATTEMPTS + 1):
            problems = self._read_dwell(step, devices, attempt, limited)
            if not problems:
                return
            if limited or attempt == ATTEMPTS:
                break
            for error in problems.values():
                log.warning("%s The dwell is repeated.", error)
            if step.purpose == "face" and any(isinstance(error, Disturbed) for error in problems.values()):
                self._disable()
                self._mount(step.up)
                self._enable()
            devices = tuple(problems)
        for device, error in problems.items():
            self._miss(device, error)

    def _read_dwell(
        self, step: Dwell, devices: Sequence[Mounted], attempt: int, limited: bool
    ) -> dict[Mounted, RigError]:
        """Turn, read, check and write a dwell. Return the devices that must repeat it, with the reason."""
        rig, clock, turning = self._rig, self._clock, step.turn_rate != 0.0
        set_rate, last = 0.0, math.inf
        if turning:
            spare_s = (TRAVEL_MARGIN - 1.0) * abs(step.travel / step.turn_rate)
            spare_s += 0.0 if limited else attempt * SPARE_S
            self._say("ramping")
            last = clock.now() + step.duration_s - step.ramp_s + spare_s  # start of the slow-down
            set_rate = rig.turn_for(step.turn_rate, step.duration_s + spare_s)
            self._old_fault = None
            clock.wait(step.ramp_s)
        self._say("settling")
        clock.wait(step.settle_s)
        self._check_air(step)
        records, positions = self._read(step, devices)
        chamber_c, achieved = self._check_air(step), achieved_turn_rate(positions)
        if turning:
            late_s = clock.now() - last
            rig.stop()
            try:
                check_delays(achieved, late_s, self._where)
            except RigTimeout as error:
                return dict.fromkeys(records, error)
        check_rate(achieved, set_rate, self._where)
        rates = {"set_turn_rate": set_rate, "turn_rate": achieved.turn_rate}
        rates["turn_rate_uncertainty"] = achieved.uncertainty

        def take(device: Mounted) -> RigError | None:
            record = records[device]
            if step.temp_c is not None and self._chamber is not None:
                check_board(record, self._chamber.settings.tolerance_c, self._where)
            try:
                missing = check_readings(record, step.dwell_s, self._where)
                device.rests.check(step, record, self._where)
            except (Disturbed, RigTimeout) as error:
                return error
            device.keep(self._number, step, record, missing=missing, chamber_c=chamber_c, **rates)
            return None

        self._say("writing")
        return {device: error for device, error in self._sound(records, take).items() if error is not None}

    def _read(self, step: Dwell, devices: Iterable[Mounted]) -> tuple[dict[Mounted, Record], list[Position]]:
        """Read devices and encoder over a dwell."""
        clock, phase = self._clock, "dwelling" if step.turn_rate != 0.0 else "resting"
        self._say(phase)
        devices = [*self._sound(devices, lambda device: device.readings.start())]
        air_read_at, positions = clock.now(), list[Position]()
        stop = air_read_at + step.dwell_s
        while clock.now() < stop or len(positions) < 3:
            if clock.now() - air_read_at > AIR_POLL_S:
                self._check_air(step)
                air_read_at = clock.now()
            clock.wait(
                min(POLL_S, step.dwell_s / POLLS)
            )  # before each position, so that the delays of the link are equal
            positions.append(self._rig.position())
            latest = self._sound(devices, lambda dev: f"{dev.readings.latest()} of {dev.serial or 'the device'}")
            devices = [*latest]
            self._say(phase, next(iter(latest.values()), ""))
        return self._records(devices), positions

    def _turn_by_angle(self, step: Dwell) -> None:
        """Read a turn by a known angle, with the rests before and after it. The operator reports the angle."""
        rest_s = 0.5 * (step.dwell_s - TURN_S)
        self._say("resting")
        self._clock.wait(step.settle_s)
        chamber_c = self._check_air(step)
        devices = [*self._sound(self._due, lambda device: device.readings.start())]
        self._clock.wait(rest_s)
        self._say("turning")
        angle = cast(ManualRig, self._rig).move_by(step.angle)
        self._say("resting")
        self._clock.wait(rest_s)
        records = self._records(devices)
        self._check_air(step)

        def take(device: Mounted) -> None:
            missing = check_readings(records[device], 0.0, self._where)
            device.keep(self._number, step, records[device], missing=missing, chamber_c=chamber_c, angle=angle)

        self._say("writing")
        self._sound(records, take)

    def _records(self, devices: Sequence[Mounted]) -> dict[Mounted, Record]:
        """Return the readings of the devices until now, and raise RigFault if the rig reports a new fault."""
        for device in devices:  # all at the same time, so that a silent device does not prolong other dwells
            device.readings.end()
        records = self._sound(devices, lambda device: device.readings.stop())
        fault = self._rig.fault()
        if fault is not None and fault != self._old_fault:
            raise RigFault(f"rig: fault in {self._where}: {fault}. Check the table.")
        return records

    # ---- Devices, motor and progress

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

    def _enable(self) -> None:
        if not self._enabled:
            self._say("enabling")
            self._rig.enable(True)
            self._enabled = True
            self._rig.set_acceleration(self._programme.acceleration)
            self._old_fault = self._rig.fault()  # a card reports its last stop until the next move
            # readings that are still in a buffer arrive while the table is at rest
            self._due = tuple(self._sound(self._due, lambda device: device.readings.start()))

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
