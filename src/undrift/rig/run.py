"""Run: a programme on a rig, dwell by dwell to the disk; whatever ends it, the table is at rest and its motor off.

For each dwell: begin a turn of that length, wait for the ramp, let the device settle, read while positions are polled, stop, judge
(rig/judge.py), and write. The rate that goes with the readings is the one that the encoder shows over that dwell. A rest that
someone disturbed, or a face that was not mounted, is taken again.

Several devices on one table are mounted alike and read in the same dwells, a folder each. One that fails in a dwell misses it; the
run ends at once where no device is left that can read it.
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
POLLS = 20  # positions in a short dwell
POLL_S = 0.1  # between two positions of a long one, s of the host
READS = 3  # of a dwell whose positions or readings come too late
SPARE_S = 2.0  # by which a move is planned longer than its dwell, host s; the run ends it early
AIR_POLL_S = 2.0  # between two looks at the chamber, table s

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class RigBench:
    """All that a run works with; the run closes the rig, and only the rig."""

    rig: Rig  # Open
    readings: Readings  # Of the device
    mounting: Operator  # The operator
    chamber: Chamber | None = None  # Needed where the programme soaks
    clock: Clock = field(default_factory=Clock)  # The rig's


@dataclass(slots=True, kw_only=True, eq=False)
class Mounted:
    """A device on the table, its folder, and what its dwells so far say about the next."""

    readings: Readings
    folder: RunFolder
    serial: str = ""
    rests: RestCheck = field(default_factory=RestCheck)
    turns: TurnCheck = field(default_factory=TurnCheck)
    doubted: set[Face] = field(default_factory=set)
    withdrawn: frozenset[int] = frozenset()  # Steps
    missed: dict[int, RigError] = field(default_factory=dict)  # By step, why it was not read

    def recall(self, programme: Programme) -> None:
        """Learn from what is on the disk how still this rig is, and what the device reads in a turn."""
        for piece in self.folder.pieces:
            step = programme.steps[piece.step]
            if isinstance(step, Dwell):
                self.learn(step, piece.turn_rate, read_own_parquet(self.folder.path / piece.name))

    def learn(self, step: Dwell, turn_rate: float, record: Record) -> None:
        """Remember a dwell that was kept."""
        self.rests.keep(step, record)
        self.turns.keep(step, turn_rate, record)

    def keep(self, number: int, step: Dwell, record: Record, **found: Any) -> None:
        """Bring a dwell to the disk, with what was found beside the readings: fields of a RecordedDwell."""
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
            **found,
        )
        self.folder.keep(record, piece)

    def withdraw(self, face: Face) -> bool:
        """Take back all that was read with a face up that others contradict; False where that was done before."""
        if face in self.doubted:
            return False
        self.doubted.add(face)
        log.warning(
            "what was read with %s up does not fit the other faces: it is mounted and read again at the end", face
        )
        self.withdrawn |= self.folder.withdraw(face)
        self.rests.forget(face)
        return True


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """Where a run is."""

    phase: Phase  # What it does now
    number: int  # Step of how many
    steps: int
    step: str  # In words
    left_s: float  # Forecast, table s
    live: str = ""  # The device's latest reading, or the chamber's
    air_c: float | None = None  # What the chamber read last, degC
    device_c: float | None = None  # What the device's thermometer read last, in a soak or a dwell, degC
    slope_c_per_min: float | None = None  # In a soak: of the air or, once that is steady, of the device


@dataclass(frozen=True, slots=True, kw_only=True)
class RunResult:
    """What a run did."""

    pieces: tuple[RecordedDwell, ...]  # All that is on the disk
    added: int  # How many of them now
    duration_s: float  # How long this part took, table s
    rig: str  # What the rig calls itself
    others: tuple["RunResult", ...] = ()  # Of the other devices on the table


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
    """Run what is not on the disk yet; other devices than the first bring their own folders."""
    devices = (Mounted(readings=bench.readings, folder=folder, serial=serial), *others)
    run = _Run(programme, bench, devices, report, settings)
    before = [device.folder.done for device in devices]
    try:
        check_programme(programme, bench.rig.limits, run.done, by_hand=isinstance(bench.rig, ManualRig))
        if bench.chamber is None and any(isinstance(step, Soak) for step in programme.steps):
            raise InputError("run: wanted a chamber for the programme's temperatures, got none; give its address")
        name, temps_c = bench.rig.identify(), {step.temp_c for step in programme.steps if isinstance(step, Soak)}
        kind: Kind = "thermal" if len(temps_c) > 1 else "calibration"  # one temperature makes no tables
        for device in devices:
            digest, serial = device.folder.digest, device.serial
            device.folder.begin(Head(protocol=digest, rig=name, serial=serial, gravity_m_s2=gravity_m_s2, kind=kind))
            device.recall(programme)
        start = bench.clock.now()
        run.all_but(run.done)
        while again := run.withdrawn():  # a face is taken back once at most
            run.all_but(frozenset(range(len(programme.steps))) - again)
    except BaseException as error:
        run.close(error)
        raise
    run.close(None)
    for device in devices:
        _check_whole(programme, device)
    took_s = bench.clock.now() - start
    first, *more = (
        RunResult(
            pieces=device.folder.pieces,
            added=len(device.folder.done - (done - device.withdrawn)),
            duration_s=took_s,
            rig=name,
        )
        for device, done in zip(devices, before, strict=True)
    )
    return replace(first, others=tuple(more))


def _check_whole(programme: Programme, device: Mounted) -> None:
    """Say which dwells a device missed beside others."""
    steps = {number for number, step in enumerate(programme.steps) if isinstance(step, Dwell)}
    if missing := sorted(steps - device.folder.done):
        why = device.missed.get(missing[0], "it failed before")
        raise RigTimeout(
            f"{device.folder.path}: wanted {len(steps)} dwells, got {len(steps) - len(missing)}, without step {missing[0]} "
            f"({programme.steps[missing[0]]}): {why}; all devices are read: look at this one and continue with `resume`"
        )


def _air(air_c: float | None) -> str:
    return "air not read" if air_c is None else f"{air_c:.2f} degC"


def _heat(run: "_Run", step: Soak, chamber: Chamber) -> dict[Mounted, SoakWatch]:
    run._say("setting" if chamber.near_c is not None else "soaking")  # a person takes their time
    run._heated = True
    chamber.set(step.temp_c)
    run._say("soaking")
    clock, lag_s = run._bench.clock, run._settings.device_lag_s
    return run._sound(run._due, lambda one: SoakWatch(one.readings, clock, step, chamber, lag_s))


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
                f"chamber: wanted {step.temp_c:g} degC steady to {step.slope_c_per_min:g} K/min within "
                f"{run._settings.soak_timeout_s:g} s, got {_air(chamber.read())}{board}; look at chamber and device"
            )
        if board.elsewhere():
            log.warning("chamber: wanted %g degC, got a steady%s; set it again", step.temp_c, board)
            boards = _heat(run, step, chamber)
        clock.wait(max(AIR_POLL_S, 0.05 * clock.speed))
        run._temps = {"air_c": (air_c := chamber.read()), "device_c": board.temp_c}
        run._say("soaking", f"{_air(air_c)}{board}", slope_c_per_min=board.slope_c_per_min(chamber))


def _forecast_s(step: Step, soaks_s: tuple[float, float]) -> float:
    """Return how long a step takes; a soak by what those of this run were to take and took."""
    wanted_s, taken_s = soaks_s if isinstance(step, Soak) and soaks_s[0] else (1.0, 1.0)
    return step.duration_s * taken_s / wanted_s


class _Run:
    """A run that is going on."""

    def __init__(
        self, programme: Programme, bench: RigBench, devices: tuple[Mounted, ...], report: Report, settings: RunSettings
    ) -> None:
        self._programme, self._bench, self._devices = programme, bench, devices
        self._report, self._settings = report, settings
        self._enabled, self._heated, self._due = False, False, devices
        self._old_fault: str | None = None
        self._temps: dict[str, float | None] = {}  # of Progress
        self._step: Step = programme.steps[0]
        self._began, self._number, self._left_s = bench.clock.now(), 0, 0.0
        self._soaks_s = 0.0, 0.0  # of those that are over: forecast and taken

    @property
    def done(self) -> frozenset[int]:
        """Steps that are on the disk for all devices."""
        return frozenset.intersection(*(device.folder.done for device in self._devices))

    def withdrawn(self) -> frozenset[int]:
        """Return the steps that were taken back and not tried again."""
        return frozenset().union(*(each.withdrawn - each.folder.done - each.missed.keys() for each in self._devices))

    def all_but(self, done: frozenset[int]) -> None:
        """Do the dwells that are not done, each with the mounting and the soak that it needs."""
        left = {n: s for n, s in enumerate(self._programme.steps) if n not in done}
        waiting: dict[type, tuple[int, Step]] = {}  # a mounting and a soak are due only when a dwell follows
        for number, step in enumerate(self._programme.steps):
            if not isinstance(step, Dwell):
                waiting[type(step)] = (number, step)
            elif number not in done:
                due = [waiting.pop(kind) for kind in (Mount, Soak) if kind in waiting]
                for place, what in (*due, (number, step)):
                    self._left_s = sum(
                        _forecast_s(each, self._soaks_s) for later, each in left.items() if later >= place
                    )
                    self._do(place, what)

    def close(self, cause: BaseException | None) -> None:
        """Stop the table and switch the motor off; a second Ctrl-C does not disturb it."""
        with uninterrupted():
            try:
                self._say("closing")
            finally:
                try:
                    self._bench.rig.close()
                except RigError as error:
                    if cause is None:
                        raise
                    raise type(error)(f"{str(cause) or type(cause).__name__}; at the end: {error}") from cause

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
        """Do something with devices; those that fail miss this step, unless none is left that can do it."""
        done = dict[Mounted, Done]()
        for device in devices:
            try:
                done[device] = do(device)
            except RigError as error:
                self._miss(device, error)
        return done

    def _miss(self, device: Mounted, error: RigError) -> None:
        device.missed[self._number] = error
        if all(self._number in each.missed for each in self._due):
            raise error
        log.warning("%s: %s; the other devices go on", device.folder.path, error)

    def _turn(self, step: Dwell) -> None:
        """Read a turn by a known angle with the rests around it; the angle is what the rig or the operator states."""
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
        left, devices = READS, self._due
        while disturbed := self._one_dwell(step, devices):
            devices, doubts = tuple(disturbed), list[bool]()
            for device, error in disturbed.items():
                if isinstance(error, Contradiction) and (error.surely or left < READS):
                    doubts.append(device.withdraw(error.other))
            if sum(doubts) == len(disturbed):
                continue
            left -= 1
            if not left:
                for device, error in disturbed.items():
                    self._miss(device, error)
                return
            for error in disturbed.values():
                log.warning("%s; it is taken again", error)
            if step.purpose == "face":
                self._disable()
                self._say("mounting")
                self._bench.mounting.mount(step.up)
                self._enable()

    def _one_dwell(self, step: Dwell, devices: Sequence[Mounted]) -> dict[Mounted, Disturbed]:
        """Read a dwell with some devices and keep what is sound; return which were disturbed."""
        records, achieved, held, chamber_c = self._read_turning(step, devices)
        where = f"step {self._number} ({step})"
        check_rate(achieved, held, self._settings, where)
        rates = {"set_turn_rate": held, "turn_rate": achieved.turn_rate, "turn_rate_uncertainty": achieved.uncertainty}

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
        """Turn and read, again until the encoder determines the rate and the readings span the dwell; a rest needs no times.

        Return the readings, the achieved rate, the rate that the controller held, and the chamber's temperature.
        """
        rig, clock, turning = self._bench.rig, self._bench.clock, step.turn_rate != 0.0
        limited = turning and rig.limits.travel is not None
        reads = 1 if limited else READS  # another turn would leave the travel
        for attempt in range(1, reads + 1):
            held, end = 0.0, math.inf
            if turning:
                spare_s = (TRAVEL_MARGIN - 1.0) * abs(step.travel / step.turn_rate)
                spare_s += 0.0 if limited else attempt * SPARE_S * clock.speed
                self._say("ramping")
                end = clock.now() + step.duration_s - step.ramp_s + spare_s  # then it slows down
                held = rig.turn_for(step.turn_rate, step.duration_s + spare_s)
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
            # readings that came too late to be certain are missing at its start; the last is for check_readings to refuse
            spans_s = (record.duration_s + 1.0 / record.sample_rate_hz for record in records.values())
            spanned_s = min(spans_s, default=np.inf)  # none: it failed when it was to be read again
            if attempt == reads or spanned_s >= self._settings.least_part * step.dwell_s:
                return records, achieved, held, chamber_c
        raise RigTimeout(
            f"rig: wanted positions known to {self._settings.link_tolerance:.0%} of the dwell in step {self._number} ({step}), "
            f"got answers {achieved.delay_s:.3g} s late in {achieved.span_s:.3g} s, {reads} times; look at the link and at what "
            "else this computer does, or dwell longer, then continue with `resume`",
            delay_s=achieved.delay_s,
        )

    def _records(self, devices: Sequence[Mounted]) -> dict[Mounted, Record]:
        """Return what devices read until now."""
        for device in devices:  # at once: one that does not answer must not lengthen the others' dwells
            device.readings.end()
        return self._sound(devices, lambda device: device.readings.stop())

    def _read(self, step: Dwell, devices: Sequence[Mounted]) -> tuple[dict[Mounted, Record], Achieved, float]:
        """Read devices and the encoder over a dwell; return the readings, the achieved rate, and when the dwell ended."""
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
            clock.wait(every_s)  # before each alike, so that the delays of the link are alike
            positions.append(rig.position())
            latest = self._sound(devices, lambda one: f"{one.readings.latest()} of {one.serial or 'the device'}")
            devices = [*latest]
            self._say(phase, next(iter(latest.values()), ""))
        read_s = clock.now()
        records = self._records(devices)
        self._check_fault()
        return records, achieved_turn_rate(positions), read_s

    def _check_fault(self) -> None:
        wrong, where = self._bench.rig.fault(), f"step {self._number} ({self._step})"
        if wrong is not None and wrong != self._old_fault:
            raise RigFault(f"rig: wanted it sound in {where}, got {wrong}; look at the table")

    def _look_at_air(self, step: Dwell) -> float | None:
        self._temps["air_c"] = check_air(self._bench.chamber, step, f"step {self._number} ({step})")
        return self._temps["air_c"]

    def _enable(self) -> None:
        if not self._enabled:
            self._say("enabling")
            self._bench.rig.enable(True)
            self._enabled = True
            self._bench.rig.set_acceleration(self._programme.acceleration)
            self._old_fault = self._bench.rig.fault()  # why it stopped last: a card keeps it until it moves again
            # a backlog is waited out at rest, not while the table turns
            self._due = tuple(self._sound(self._due, lambda device: device.readings.start()))

    def _disable(self) -> None:
        """Switch the motor off, for mounting and long waits."""
        if self._enabled:
            self._enabled = False
            self._bench.rig.enable(False)

    def _say(self, phase: Phase, live: str = "", **seen: float | None) -> None:
        left_s = self._left_s - min(self._bench.clock.now() - self._began, _forecast_s(self._step, self._soaks_s))
        number, steps, step = self._number, len(self._programme.steps), str(self._step)
        seen = self._temps | seen
        self._report(Progress(phase=phase, number=number, steps=steps, step=step, left_s=left_s, live=live, **seen))


def check_unheated(step: Dwell, heated: bool, where: str) -> None:
    """Refuse to read at a set-point what is to be read at room temperature, as a face that is taken again."""
    if step.temp_c is None and heated:
        raise RigFault(
            f"chamber: wanted it at room temperature for {where}, got it after a soak; let it cool, then continue with `resume`"
        )


def check_air(chamber: Chamber | None, step: Dwell, where: str) -> float | None:
    """Return what the chamber reads, where there is one; end the run when it has left the set-point."""
    if chamber is None:
        return None
    air_c = chamber.read()
    tolerance_c = chamber.criterion.tolerance_c
    if air_c is not None and step.temp_c is not None and not abs(air_c - step.temp_c) <= tolerance_c:
        raise RigFault(
            f"chamber: wanted {step.temp_c:g} degC within {tolerance_c:g} K throughout {where}, got "
            f"{air_c:.2f} degC; look at door and heater, then continue with `resume`",
            temp_c=air_c,
        )
    return air_c
