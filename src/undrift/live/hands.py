"""A simulated hand-held device: it rests on a face, is moved to another face or turned by whole turns, and is read.

::

    q_nb(t) = q_0  turn(a, angle(s))  turn(c SMOOTH(s))  turn(tremor(t) w(s))       s in [0, 1] over a move
    force_b = R_nb^T ((0, 0, g) + lift''(t)) + shake(t) w(s)                        w = 16 s^2 (1 - s)^2

A move to a face is the shortest rotation (c = 0). A turn has a random error of its angle and axis, and c then returns the device to
the face. About the vertical, the device slides on the bench. About other axes, it is lifted. At rest, rate and tremor are zero, and
the face has the random tilt of its last move. Rates are differences of q_nb. The board warms slightly. Moves that are requested
during a move are queued.

``HandHeld.address`` is an address for ``live``, in this process only. ``simulated:`` is a device without an operator. It is laid on
its six faces, then turned in both directions about each axis, as in ``record --guide turns``.
"""

import itertools
import math
import threading
import time as host
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from undrift.arrays import FloatArray, IntArray
from undrift.base.clock import Clock
from undrift.errors import InputError, LinkError, RigTimeout
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotate, rotation_vector
from undrift.live.decoder import Chunk, StreamDescription
from undrift.live.transports import Address, number_of
from undrift.record import FACES, Axis, Face
from undrift.sim.device.causal import Seen, SimulatedDevice
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.motion.motion import SMOOTH, UNEVEN, facing, turn_quaternion, unit_vector
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

REST_S = 0.5  # shortest rest between queued moves, s
MOST_MOVES = 16  # longest queue of moves
WAVES, TREMOR_HZ = 6, (7.0, 11.0)
OVERSHOOT = Polynomial.fromroots([0] * 17 + [1] * 3) * -(20.0**20 / (17.0**17 * 3.0**3))  # 1 at its peak, s = 0.85
HELD = Polynomial.fromroots([0, 0, 1, 1]) * 16.0  # w
LIFT = Polynomial.fromroots([0, 0, 0, 1, 1, 1]) * -64.0
STEEPEST = 2.3  # largest rate of a turn relative to its mean rate
REACH = 0.8  # largest fraction of the gyroscope's range in a turn
TOGETHER_S = 0.02  # time between two reads, host s
PAST_S = 60.0  # time for which finished moves are kept, s
INSTANT_S = 1e-4  # time step for rates from two orientations, s


@dataclass(frozen=True, slots=True, kw_only=True)
class HandSettings:
    """Random motion of an operator's hands, drawn for each move. All defaults are choices."""

    tilt_sd: float = 0.3 * RADIAN_PER_DEGREE  # standard deviation of a face's tilt about each axis, rad
    lay_s: tuple[float, float] = (1.0, 2.0)  # shortest and longest move to another face, s
    turn_s: tuple[float, float] = (3.0, 4.0)  # shortest and longest full turn, s
    axis_sd: float = 0.3 * RADIAN_PER_DEGREE  # standard deviation of a turn's axis, about each perpendicular axis, rad
    angle_sd: float = 0.5 * RADIAN_PER_DEGREE  # standard deviation of a turn's angle at the mark, rad
    overshoot_sd: float = 4.0 * RADIAN_PER_DEGREE  # standard deviation of a turn's overshoot beyond the mark, rad
    tremor: float = 1.0 * RADIAN_PER_DEGREE  # rms turn rate of the tremor in a move, about each axis, rad/s
    shake: float = 0.1  # rms acceleration of the tremor in a move, along each axis, m/s2
    lift: float = 0.08  # height of a lift, m
    temp_c: float = 25.0  # initial temperature of the board, degC
    warming_k: float = 0.3  # final temperature rise of the board, K
    warming_s: float = 900.0  # time constant of the temperature rise, s

    def __post_init__(self) -> None:
        for name in ("lay_s", "turn_s"):
            low, high = getattr(self, name)
            if not 0.0 < low <= high:
                raise InputError(f"hand held: {name} must be positive and increasing, got {low:g} and {high:g} s.")


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """One move of the device, over s = (t - start) / duration in [0, 1]."""

    start: float  # s
    duration: float  # s
    q: FloatArray  # (4,), initial orientation
    axis_b: FloatArray  # (3,), a
    angle: Polynomial  # rad over s
    back: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,), c, rad
    lift: float = 0.0  # m
    tremor: FloatArray = field(default_factory=lambda: np.zeros((4, WAVES, 3)))  # amplitudes rad, m/s2, Hz, phase rad

    @property
    def stop(self) -> float:
        """End time, s."""
        return self.start + self.duration

    def orientation(self, time: FloatArray) -> FloatArray:
        """Return q_nb (N, 4) at times (N,), s. The device is at rest before and after the move."""
        s = np.clip((time - self.start) / self.duration, 0.0, 1.0)
        q = quaternion_product(self.q, turn_quaternion(self.axis_b, self.angle(s)))
        q = quaternion_product(q, quaternion_of(SMOOTH(s)[:, None] * self.back))
        return quaternion_product(q, quaternion_of(HELD(s)[:, None] * self._waves(time, 0)))

    def push(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the upward acceleration (N,) and the tremor's acceleration (N, 3) in the axes of the case, m/s2."""
        s = (time - self.start) / self.duration
        inside = (s > 0.0) & (s < 1.0)
        upwards = np.where(inside, self.lift * LIFT.deriv(2)(s) / self.duration**2, 0.0)
        return upwards, np.where(inside, HELD(s), 0.0)[:, None] * self._waves(time, 1)

    def _waves(self, time: FloatArray, row: int) -> FloatArray:
        size, (frequency, phase) = self.tremor[row], self.tremor[2:]
        return np.asarray((size * np.sin(2.0 * math.pi * frequency * time[:, None, None] + phase)).sum(axis=1))


class HandHeld:
    """A simulated device that is moved and read from any thread."""

    def __init__(
        self,
        device: DeviceModel,
        hands: HandSettings = HandSettings(),
        clock: Clock | None = None,
        *,
        seed: int = 0,
        gravity_m_s2: float = STANDARD_GRAVITY,
    ) -> None:
        self.device, self.hands, self.gravity_m_s2 = device, hands, gravity_m_s2
        self.clock, self.lock, self._rest_s = clock or Clock.started(), threading.RLock(), REST_S
        self._draw = np.random.default_rng((seed, 1))
        self.face: Face = "+z"
        q_rest = self._laid(np.array([1.0, 0.0, 0.0, 0.0]), self.face)
        self.moves = [Move(-1.0, 1.0, q_rest, np.eye(3)[0], Polynomial([0.0]))]
        # compile the simulation before the first reading is due
        SimulatedDevice(device, self._seen, seed, 0.0).read(0.1)
        self._read = SimulatedDevice(device, self._seen, seed, self.clock.now())
        self.rate = self._read.rate
        self.address = f"{KIND}:{next(_NUMBERS)}"
        _HELD[self.address] = self

    def __enter__(self) -> "HandHeld":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def read(self) -> tuple[IntArray, FloatArray]:
        """Return numbers (n,) and values (n, 7) of the readings since the last call, with both triads and temperature."""
        with self.lock:
            return self._read.read(self.clock.now())

    def follow(self) -> None:
        """Queue moves to all faces and turns about each axis in both directions, with rests."""
        self._rest_s, self.moves[-1] = REST_ON_FACE_S, replace(self.moves[-1], start=self.clock.now() - 1.0)
        for face in FACES[:4] + FACES[5:]:
            self.lay(face)
        axes: tuple[Axis, ...] = ("x", "y", "z")
        for axis, up in zip(axes, FACES[::2], strict=True):
            self.lay(up)
            self.turn(axis, -2.0 * math.pi)
            self.turn(axis, 2.0 * math.pi)
        self._rest_s = REST_S

    def close(self) -> None:
        """Remove the device's address, so that nothing can connect to it. A second call has no effect."""
        _HELD.pop(self.address, None)

    @property
    def moving(self) -> bool:
        """True if the device is moving or a move is queued."""
        with self.lock:
            return self.clock.now() < self.moves[-1].stop

    def lay(self, face: Face) -> None:
        """Queue a move of the device, after which this face is up."""
        if face not in FACES:
            raise InputError(f"face: expected one of {', '.join(FACES)}, got '{face}'. Enter the axis that points up.")
        with self.lock:
            start, q = self._after()
            way = rotation_vector(quaternion_product(quaternion_conjugate(q), self._laid(q, face)))
            angle = float(np.linalg.norm(way))
            axis, draw = (way / angle if angle > 0.0 else np.eye(3)[0]), self._draw
            self.face = face
            self._add(start, draw.uniform(*self.hands.lay_s), q, axis, SMOOTH * angle, lift=self.hands.lift)

    def turn(self, axis: Axis, angle: float) -> None:
        """Queue a turn by whole turns about +axis, rad, after which the device rests on the same face."""
        turns = angle / (2.0 * math.pi)
        if axis not in ("x", "y", "z") or not 0 < abs(round(turns)) <= 10 or abs(turns - round(turns)) > 1e-6:
            raise InputError(
                f"turn: expected axis x, y or z and 1 to 10 whole turns, got '{axis}' and {angle / RADIAN_PER_DEGREE:g} deg. "
                "Enter for example turn z 360, or -360 for the other direction."
            )
        with self.lock:
            start, q = self._after()
            draw, hands, unit = self._draw, self.hands, unit_vector(axis)
            leaning = unit + np.cross(draw.normal(0.0, hands.axis_sd, 3), unit)
            leaning /= np.linalg.norm(leaning)
            reached = angle + draw.normal(0.0, hands.angle_sd)
            beyond = math.copysign(abs(draw.normal(0.0, hands.overshoot_sd)), angle)
            course = reached * (SMOOTH + draw.uniform(-0.3, 0.3) * UNEVEN) + beyond * OVERSHOOT
            up = rotate(quaternion_conjugate(q), np.array([0.0, 0.0, 1.0]))
            slid = abs(float(up @ unit)) > 0.9
            q_end = quaternion_product(q, turn_quaternion(leaning, np.array(reached)))
            q_laid = facing(q_end, up) if slid else self._laid(q_end, self.face)
            back = rotation_vector(quaternion_product(quaternion_conjugate(q_end), q_laid))
            quickest = STEEPEST * abs(angle) / (REACH * self.device.gyro.full_scale)
            duration = max(abs(turns) * draw.uniform(*hands.turn_s), quickest)
            self._add(start, duration, q, leaning, course, back=back, lift=0.0 if slid else hands.lift)

    def _laid(self, q: FloatArray, face: Face) -> FloatArray:
        """Return the nearest orientation to q with a face up and a random tilt."""
        up = unit_vector(face)
        return facing(q, up + np.cross(self._draw.normal(0.0, self.hands.tilt_sd, 3), up))

    def _after(self) -> tuple[float, FloatArray]:
        """Return the start time, s, and the initial orientation of the next move."""
        now, last = self.clock.now(), self.moves[-1]
        if sum(move.start > now for move in self.moves) >= MOST_MOVES:
            raise InputError(f"hand held: at most {MOST_MOVES} moves can be queued. Wait until the device rests.")
        q = last.orientation(np.array([last.stop]))[0]
        return max(now, last.stop + self._rest_s), q / np.linalg.norm(q)

    def _add(
        self, start: float, duration: float, q: FloatArray, axis: FloatArray, angle: Polynomial, **fields: Any
    ) -> None:
        draw, size = self._draw, math.sqrt(2.0 / WAVES)
        frequency, phase = draw.uniform(*TREMOR_HZ, (WAVES, 3)), draw.uniform(0.0, 2.0 * math.pi, (WAVES, 3))
        sizes = self.hands.tremor * size / (2.0 * math.pi * frequency), np.full((WAVES, 3), self.hands.shake * size)
        self.moves.append(Move(start, duration, q, axis, angle, tremor=np.stack((*sizes, frequency, phase)), **fields))
        # remove old moves, because a reading requires only the last step
        past = [k for k, move in enumerate(self.moves) if move.stop < self.clock.now() - PAST_S]
        del self.moves[: past[-1] if past else 0]

    def _warming(self, time: FloatArray) -> FloatArray:
        return np.asarray(self.hands.temp_c + self.hands.warming_k * (1.0 - np.exp(-time / self.hands.warming_s)))

    def _orientation(self, time: FloatArray) -> FloatArray:
        q = np.empty((len(time), 4))
        index = np.maximum(np.searchsorted([move.start for move in self.moves], time, side="right") - 1, 0)
        for k in np.unique(index):
            q[index == k] = self.moves[k].orientation(time[index == k])
        return q

    def _seen(self, times: FloatArray, step_s: float) -> Seen:
        n, h = len(times), INSTANT_S
        resting = bool(times[0] - step_s > self.moves[-1].stop)
        rate, mean_rate, acceleration, shake = (np.zeros((n, 3)) for _ in range(4))
        gravity_n = np.zeros((n, 3))
        gravity_n[:, 2] = self.gravity_m_s2
        if resting:
            q = np.tile(self._orientation(times[:1]), (n, 1))
        else:
            shifts = np.repeat([-step_s, -h, 0.0, h], n)
            before, early, q, late = self._orientation(np.tile(times, 4) + shifts).reshape(4, n, 4)
            began, ended = np.concatenate((before, early, q)), np.concatenate((q, q, late))
            rotation = rotation_vector(quaternion_product(quaternion_conjugate(began), ended)).reshape(3, n, 3)
            mean_rate, first, second = rotation[0] / step_s, rotation[1] / h, rotation[2] / h
            rate, acceleration = 0.5 * (first + second), (second - first) / h
            for move in self.moves:
                upwards, trembling = move.push(times)
                gravity_n[:, 2] += upwards
                shake += trembling
        force = rotate(quaternion_conjugate(q), gravity_n) + shake
        return rate, acceleration, force, mean_rate, self._warming(times)


def start_hand_held(
    *,
    seed: int | None = None,
    device: DeviceModel | None = None,
    hands: HandSettings = HandSettings(),
    speed: float = 1.0,
    clock: Clock | None = None,
    gravity_m_s2: float = STANDARD_GRAVITY,
) -> HandHeld:
    """Start a simulated device. Without `device`, a random device of consumer grade is simulated, from the seed if it is set."""
    if seed is None:
        seed = int(np.random.default_rng().integers(2**31))
    chosen = device or random_device(np.random.default_rng(seed), grade="consumer")
    return HandHeld(chosen, hands, clock or Clock.started(speed), seed=seed, gravity_m_s2=gravity_m_s2)


# ---- Source of live readings.

KIND = "simulated"
CHANNELS = ("count", "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z", "temp")
REST_ON_FACE_S = 9.0  # rest between two moves of a device without an operator, s
_HELD: dict[str, HandHeld] = {}  # devices by address
_NUMBERS = itertools.count(1)


class HandHeldSource:
    """Source that reads a hand-held device."""

    errors = 0

    def __init__(self, device: HandHeld, *, owns_device: bool) -> None:
        model, self._held, self._alone, self._open, self._followed = device.device, device, owns_device, False, False
        self.name = f"simulated device {model.serial}".rstrip()
        self.description = StreamDescription(
            channels=CHANNELS,
            rate=device.rate,
            gyro_unit=model.gyro.unit,
            accel_unit=model.accel.unit,
            clock_speed=device.clock.speed,
            device=model.serial,
        )

    def open(self) -> None:
        """Start to read. A device without an operator also starts its moves."""
        self._held.read()
        self._open = True
        if self._alone and not self._followed:
            self._followed = True
            self._held.follow()

    def read(self, deadline_s: float) -> Chunk:
        """Return the readings that have arrived, at least one."""
        last = host.monotonic() + deadline_s
        while host.monotonic() <= last:
            if not self._open or self._held.address not in _HELD:
                raise LinkError(f"{self.name}: the device is closed. Connect again.")
            counts, rows = self._held.read()
            if counts.size:
                return Chunk(host_time=np.full(len(rows), host.monotonic()), counter=counts.astype(float), values=rows)
            host.sleep(TOGETHER_S)
        raise RigTimeout(f"{self.name}: no reading within {deadline_s:g} s. Connect again.")

    def close(self) -> None:
        """Close the source. A second call has no effect."""
        self._open = False
        if self._alone:
            self._held.close()


def source_of(address: Address) -> HandHeldSource:
    """Return the source of an address, either a device of this process or a new device without an operator."""
    if address.place:
        device = _HELD.get(f"{KIND}:{address.place}")
        if device is None:
            raise InputError(f"device: unknown device 'simulated:{address.place}' in this process. Omit the number.")
        return HandHeldSource(device, owns_device=False)
    seed, speed = address.option("seed", ""), number_of(address.option("clock_speed", "1"))
    if (
        (seed and not seed.isdigit())
        or not speed > 0.0
        or {name for name, _ in address.options} - {"seed", "clock_speed"}
    ):
        raise InputError("device: the address must have the form simulated:?seed=1&clock_speed=2. Correct it.")
    return HandHeldSource(start_hand_held(seed=int(seed) if seed else None, speed=speed), owns_device=True)
