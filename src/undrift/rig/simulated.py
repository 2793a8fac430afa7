"""Simulated bench for `rig run`: table, thermal chamber, device and operator in this process, with a common clock.

::

    up_b = the mounted face, slightly tilted        axis of the table, vertical
    rate_b = turn_rate up_b     force_b = g up_b

    r'  = rate towards the set-point, limited       internal set-point of the chamber's controller
    T'' = w^2 (r - T) - 2 z w T'                    air: second order, overshoots
    B'  = (T - B) / lag                             board of the device

The simulation advances to the current time when a value is read. There are no other threads, and the results do not depend on the
load of the host. The air is solved with the trapezoidal rule, and the board exactly.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.base.clock import Clock, PacedClock
from undrift.errors import InputError, RigFault, RigTimeout
from undrift.live.hands import description_of
from undrift.record import FACES, Face, Record
from undrift.rig.chamber import Chamber, ChamberSetup
from undrift.rig.rig import (
    Limits,
    Position,
    RigSettings,
    ServoReport,
    steady_angle,
    to_counts,
)
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import Seen, SimulatedDevice, Surroundings
from undrift.sim.kernels import ServoSettings
from undrift.sim.motion.motion import unit_vector
from undrift.sim.servo import Servo
from undrift.units import STANDARD_GRAVITY

# ---- Air of a chamber and board of the device.

STEP_S = 0.5
OFF_S = 1200.0  # time constant of a chamber that is switched off, s


@dataclass(frozen=True, slots=True, kw_only=True)
class AirSettings:
    """Dynamics of the air."""

    room_c: float = 25.0  # room temperature, also the initial temperature, degC
    ramp_c_per_min: float = 3.0  # largest slope of the controller's internal set-point, K/min
    period_s: float = 120.0  # 2 pi / w, s
    damping: float = 0.6  # damping ratio z (below 1 the air overshoots)
    board_lag_s: float = 60.0  # time constant of the device's board, s


class Air:
    """Temperatures of air and board, which advance when they are read."""

    def __init__(self, settings: AirSettings) -> None:
        self.settings, self.on = settings, False
        self.set_point = self._aim = settings.room_c
        self._speed = 0.0
        self._time, self._temp, self._board = [0.0], [settings.room_c], [settings.room_c]

    def advance(self, time: float) -> None:
        """Advance to a time, s, or at most one step beyond it."""
        keep = math.exp(-STEP_S / self.settings.board_lag_s)
        mean = (1.0 - keep) * self.settings.board_lag_s / STEP_S  # weight of the air before and after the step
        while self._time[-1] < time:
            before, temp = self._temp[-1], self._next(self._temp[-1])
            self._board.append(keep * self._board[-1] + (mean - keep) * before + (1.0 - mean) * temp)
            self._time.append(self._time[-1] + STEP_S)
            self._temp.append(temp)

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the temperatures of air and board, (n,) degC, at past times (n,), s."""
        first = max(min(int(float(times[0]) / STEP_S) - 1, len(self._time) - 2), 0)
        last = int(float(times[-1]) / STEP_S) + 3
        grid = self._time[first:last]
        return np.interp(times, grid, self._temp[first:last]), np.interp(times, grid, self._board[first:last])

    def _next(self, temp: float) -> float:
        if not self.on:
            after = self.settings.room_c + (temp - self.settings.room_c) * math.exp(-STEP_S / OFF_S)
            self._aim, self._speed = after, (after - temp) / STEP_S
            return after
        reach = self.settings.ramp_c_per_min / 60.0 * STEP_S
        self._aim += min(max(self.set_point - self._aim, -reach), reach)
        w = 2.0 * math.pi / self.settings.period_s
        h, damp = STEP_S / 2.0, 2.0 * self.settings.damping * w
        rise = self._speed * (1.0 - h * damp - h * h * w * w) + 2.0 * h * w * w * (self._aim - temp)
        speed = rise / (1.0 + h * damp + h * h * w * w)
        after = temp + h * (self._speed + speed)
        self._speed = speed
        return after


# ---- Bench.

SETTLED_S = 0.1  # settling time at the end of a move, s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedSettings:
    """Settings of the simulated bench, without its devices."""

    servo: ServoSettings = field(default_factory=ServoSettings)  # servo of the table
    air: AirSettings = field(default_factory=AirSettings)  # air of the chamber
    chamber: ChamberSetup = field(default_factory=ChamberSetup)  # limits and soak (with the clock of the bench)
    limits: Limits = field(default_factory=Limits)  # limits of the table
    mount_tilt_sd: float = 0.0  # standard deviation of the mounting error about each axis, rad, for each mounting
    gravity_m_s2: float = STANDARD_GRAVITY  # local gravity, m/s2
    seed: int = 0  # seed of noise and tilt


class SimulatedBench:
    """A bench that also mounts its devices. ``table`` is a Rig, ``chamber`` a Chamber, and ``readings`` are of its devices."""

    def __init__(
        self, devices: Sequence[DeviceModel] = (), settings: SimulatedSettings = SimulatedSettings(), clock: Clock | None = None
    ) -> None:  # fmt: skip
        self.settings, self.clock = settings, clock or PacedClock()
        chosen = devices or [random_device(np.random.default_rng(settings.seed), grade="consumer")]
        self._zero = self.clock.now()
        self.servo, self.air = Servo(settings.servo), Air(settings.air)
        self._hands = np.random.default_rng((settings.seed, 1))
        self._log = np.array([-1.0, 0.0]), np.zeros(2)  # recent times and angles of the axis, s and rad
        self._last = [np.zeros((1, 3)) for _ in chosen]  # rate at the last reading
        self.face: Face = "+z"
        self._up = unit_vector("+z")
        self.devices = tuple(
            SimulatedDevice(model, self._surroundings(k), settings.seed + k, 0.0) for k, model in enumerate(chosen)
        )
        self.readings = tuple(SimulatedReadings(self, device) for device in self.devices)
        self.table = SimulatedTable(self, settings.limits)
        self.chamber = SimulatedChamber(self, replace(settings.chamber, clock=self.clock))

    def now(self) -> float:
        """Return the time since the start, s."""
        return self.clock.now() - self._zero

    def advance(self) -> float:
        """Advance the bench to the current time, and return that time, s."""
        now = self.now()
        times, angles = self.servo.advance(now)
        first = max(int(np.searchsorted(self._log[0], now - 1.0)) - 1, 0)  # a reading requires the previous step
        before = self._log
        self._log = np.concatenate((before[0], times)), np.concatenate((before[1], angles))
        self.air.advance(now)
        for readings in self.readings:
            readings.take(now)
        self._log = self._log[0][first:], self._log[1][first:]
        return now

    def angle(self) -> float:
        """Return the current true angle of the axis, rad."""
        return float(np.interp(self.advance(), *self._log))

    def turn_rate(self) -> float:
        """Return the current true turn rate of the axis, rad/s."""
        self.advance()
        return float((self._log[1][-1] - self._log[1][-2]) / (self._log[0][-1] - self._log[0][-2]))

    def mount(self, up: Face) -> None:
        """Mount the devices with another face up, as an operator would."""
        if up not in FACES:
            raise InputError(
                f"mount: the face must be one of {', '.join(FACES)}, got '{up}'. Set the axis that points up."
            )
        self.advance()
        self.face = up
        unit, tilt = unit_vector(self.face), self._hands.normal(0.0, 1.0, 3) * self.settings.mount_tilt_sd
        tilted = unit + np.cross(tilt, unit)
        self._up = tilted / np.linalg.norm(tilted)

    def _surroundings(self, number: int) -> Surroundings:
        def surroundings(times: FloatArray, step_s: float) -> Seen:
            angle = np.interp(times, *self._log) - np.interp(times - step_s, *self._log)
            rate = angle[:, None] / step_s * self._up
            before = np.vstack((self._last[number], rate[:-1]))
            self._last[number] = rate[-1:]
            force = np.broadcast_to(self.settings.gravity_m_s2 * self._up, (len(times), 3))
            return rate, (rate - before) / step_s, force, rate, self.air.at(times)[1]

        return surroundings


class SimulatedTable:
    """Table of a bench, a Rig."""

    def __init__(self, bench: SimulatedBench, limits: Limits) -> None:
        self.limits, self._bench, self._servo = limits, bench, bench.servo
        self._count = 1.0 / bench.servo.settings.counts_per_rad  # rad
        self._acceleration = 256_000.0  # counts/s2

    def identify(self) -> str:
        return f"simulated table, encoder of {self._servo.settings.encoder_lines} lines"

    def read_servo(self) -> ServoReport:
        (kp, kd), period_s = self._servo.settings.gains, self._servo.settings.period_s
        return ServoReport(kp=kp, ki=0.0, kd=kd, sample_s=period_s)

    def enable(self, on: bool) -> None:
        self._bench.advance()
        self._servo.switch(on)

    def set_acceleration(self, acceleration: float) -> float:
        self.limits.check_acceleration(acceleration)
        self._acceleration = to_counts("AC", acceleration / self._count)
        return self._acceleration * self._count

    def turn_for(self, turn_rate: float, seconds: float) -> float:
        self.limits.check_turn_rate(turn_rate)
        if not self._servo.powered:
            raise RigFault("rig: cannot turn, got its motor off. Switch the motor on.")
        speed = to_counts("SP", turn_rate / self._count)
        angle = steady_angle(speed, seconds, self._acceleration) * self._count
        self.limits.check_travel(self._bench.angle() + angle)
        self._servo.turn(speed, seconds, self._acceleration)
        return speed * self._count

    def stop(self) -> None:
        self._bench.advance()
        if self._servo.powered:
            self._bench.clock.wait(self._servo.slow_down(self._acceleration) + SETTLED_S)
        self._bench.advance()

    def position(self) -> Position:
        counts = math.floor(self._bench.angle() * self._servo.settings.counts_per_rad)
        within_s = 0.5 * self._servo.settings.period_s
        return Position(angle=counts * self._count, time=self._bench.clock.now(), within_s=within_s)

    def following_error(self) -> float:
        self._bench.advance()
        return self._servo.error * self._count

    def fault(self) -> str | None:
        return None

    def close(self) -> None:
        self.stop()
        self._servo.switch(False)


class SimulatedChamber(Chamber):
    """Chamber of a bench."""

    def __init__(self, bench: SimulatedBench, settings: ChamberSetup) -> None:
        super().__init__(settings)
        self._bench = bench

    def switch_off(self) -> None:
        """Switch heater and compressor off."""
        self._bench.advance()
        self._bench.air.on = False

    def _send(self, temp_c: float) -> float:
        self._bench.advance()
        self._bench.air.on, self._bench.air.set_point = True, temp_c
        return temp_c

    def _measure(self) -> float:
        return round(float(self._bench.air.at(np.array([self._bench.advance()]))[0][0]), 2)


class SimulatedReadings:
    """Readings of a device on a bench, dwell by dwell: Readings of rig/chamber.py."""

    def __init__(self, bench: SimulatedBench, device: SimulatedDevice) -> None:
        self.description = description_of(device)
        self._bench, self._device = bench, device
        self._dwell: list[tuple[IntArray, FloatArray]] = []  # counts and rows of this dwell
        self._newest = np.full(7, np.nan)
        self._is_open = False

    def take(self, now: float) -> None:
        """Read the device up to the current time."""
        counts, rows = self._device.read(now)
        if counts.size:
            self._newest = rows[-1]
            self._dwell += [(counts, rows)] if self._is_open else []

    def start(self) -> None:
        self._bench.advance()
        self._dwell, self._is_open = [], True

    def end(self) -> None:
        self._bench.advance()
        self._is_open = False

    def stop(self) -> Record:
        self.end()
        if sum(len(counts) for counts, _ in self._dwell) < 2:
            raise RigTimeout("device: fewer than two readings. Start a dwell, and use a longer one.")
        counts, rows = (np.concatenate(parts) for parts in zip(*self._dwell, strict=True))
        return self.description.record(counts / self._device.rate, rows)

    def latest(self) -> str:
        return self.description.text_of(self._newest)

    def close(self) -> None:
        self._is_open = False


def open_from(url: str, settings: RigSettings) -> SimulatedTable:
    """Open the table of a new simulated bench."""
    if url:
        raise InputError(f"simulated rig: the address must be 'simulated:', got 'simulated:{url}'. It has no port.")
    options: dict[str, Any] = {"limits": settings.limits, "servo": ServoSettings(encoder_lines=settings.encoder_lines)}
    return SimulatedBench(settings=SimulatedSettings(**options), clock=settings.clock).table
