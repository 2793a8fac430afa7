"""A simulated hand-held device for practice: it rests on a face, is moved to another face or turned by whole turns, and can be
read.

::

    q_nb(t) = q_0  turn(a, angle(s))  turn(c SMOOTH(s))       s in [0, 1] over a move
    force_b = R_nb^T (0, 0, g)

A move to a face is the shortest rotation (c = 0). A turn has a random error of its angle and axis, and c then returns the device to
the face. At rest, the rate is zero, and the face has the random tilt of its last move. Rates are differences of q_nb. Moves that
are requested during a move are queued.

``HandHeld.address`` is an address for ``live``, in this process only. ``simulated:`` is a device without an operator. It is laid on
its six faces, then turned in both directions about each axis, as in ``record --guide turns``.
"""

import itertools
import math
import threading
import time as host
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.polynomial import Polynomial

from undrift.arrays import FloatArray, IntArray
from undrift.base.clock import Clock
from undrift.errors import InputError, LinkError
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotate, rotation_vector
from undrift.live.decoder import COUNTER, MEASURED, Chunk, StreamDescription
from undrift.plugins import typed_options
from undrift.record import FACES, Axis, Face
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import Seen, SimulatedDevice
from undrift.sim.motion.motion import facing, turn_quaternion, unit_vector
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# random motion of the hands, drawn for each move (all values are chosen)
SMOOTH = Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])  # 0 to 1, first and second derivatives vanish at both ends
UNEVEN = 40.0 * Polynomial.fromroots([0, 0, 0, 0.5, 1, 1, 1])  # unevenness of a turn by hand, with 0 at both ends
TILT_SD = 0.3 * RADIAN_PER_DEGREE  # standard deviation of a face's tilt about each axis, rad
AXIS_SD = 0.3 * RADIAN_PER_DEGREE  # standard deviation of a turn's axis, about each perpendicular axis, rad
ANGLE_SD = 0.5 * RADIAN_PER_DEGREE  # standard deviation of a turn's angle, rad
LAY_S, TURN_S = (1.0, 2.0), (3.0, 4.0)  # shortest and longest move to another face, and full turn, s
BOARD_C = 25.0  # temperature of the board, degC

REST_S = 0.5  # shortest rest between queued moves, s
REST_ON_FACE_S = 9.0  # rest between two moves of a device without an operator, s
MOST_MOVES = 16  # longest queue of moves
STEEPEST = 2.3  # largest rate of a turn relative to its mean rate
REACH = 0.8  # largest fraction of the gyroscope's range in a turn
TOGETHER_S = 0.02  # time between two reads, host s
PAST_S = 60.0  # time for which finished moves are kept, s
INSTANT_S = 1e-4  # time step for rates from two orientations, s


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """One move of the device, over s = (t - start) / duration in [0, 1]."""

    start: float  # s
    duration: float  # s
    q: FloatArray  # (4,), initial orientation
    axis_b: FloatArray  # (3,), a
    angle: Polynomial  # rad over s
    back: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,), c, rad

    @property
    def stop(self) -> float:
        """End time, s."""
        return self.start + self.duration

    def orientation(self, time: FloatArray) -> FloatArray:
        """Return q_nb (N, 4) at times (N,), s. The device is at rest before and after the move."""
        s = np.clip((time - self.start) / self.duration, 0.0, 1.0)
        q = quaternion_product(self.q, turn_quaternion(self.axis_b, self.angle(s)))
        return quaternion_product(q, quaternion_of(SMOOTH(s)[:, None] * self.back))


class HandHeld:
    """A simulated device that is moved and read from any thread. By default, it is a random device of consumer grade."""

    def __init__(
        self,
        *,
        seed: int | None = None,
        device: DeviceModel | None = None,
        clock: Clock | None = None,
        gravity_m_s2: float = STANDARD_GRAVITY,
    ) -> None:
        seed = int(np.random.default_rng().integers(2**31)) if seed is None else seed
        self.device = device or random_device(np.random.default_rng(seed), grade="consumer")
        self.gravity_m_s2 = gravity_m_s2
        self.clock, self.lock, self._rest_s = clock or Clock.started(), threading.RLock(), REST_S
        self._draw = np.random.default_rng((seed, 1))
        self.face: Face = "+z"
        q_rest = self._lay(np.array([1.0, 0.0, 0.0, 0.0]), self.face)
        self.moves = [Move(-1.0, 1.0, q_rest, np.eye(3)[0], Polynomial([0.0]))]
        # compile the simulation before the first reading is due
        SimulatedDevice(self.device, self._seen, seed, 0.0).read(0.1)
        self._read = SimulatedDevice(self.device, self._seen, seed, self.clock.now())
        self.description = description_of(self._read, self.clock.speed)
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
        with self.lock:
            start, q = self._after()
            way = rotation_vector(quaternion_product(quaternion_conjugate(q), self._lay(q, face)))
            angle = float(np.linalg.norm(way))
            axis = way / angle if angle > 0.0 else np.eye(3)[0]
            self.face = face
            self._add(Move(start, self._draw.uniform(*LAY_S), q, axis, SMOOTH * angle))

    def turn(self, axis: Axis, angle: float) -> None:
        """Queue a turn by whole turns about +axis, rad, after which the device rests on the same face."""
        with self.lock:
            start, q = self._after()
            draw, unit = self._draw, unit_vector(axis)
            leaning = unit + np.cross(draw.normal(0.0, AXIS_SD, 3), unit)
            leaning /= np.linalg.norm(leaning)
            reached = angle + draw.normal(0.0, ANGLE_SD)
            course = reached * (SMOOTH + draw.uniform(-0.3, 0.3) * UNEVEN)
            q_end = quaternion_product(q, turn_quaternion(leaning, np.array(reached)))
            back = rotation_vector(quaternion_product(quaternion_conjugate(q_end), self._lay(q_end, self.face)))
            quickest_s = STEEPEST * abs(angle) / (REACH * self.device.gyro.full_scale)
            duration_s = max(abs(angle) / math.tau * draw.uniform(*TURN_S), quickest_s)
            self._add(Move(start, duration_s, q, leaning, course, back))

    def _lay(self, q: FloatArray, face: Face) -> FloatArray:
        """Return the nearest orientation to q with a face up and a random tilt."""
        up = unit_vector(face)
        return facing(q, up + np.cross(self._draw.normal(0.0, TILT_SD, 3), up))

    def _after(self) -> tuple[float, FloatArray]:
        """Return the start time, s, and the initial orientation of the next move."""
        now, last = self.clock.now(), self.moves[-1]
        if sum(move.start > now for move in self.moves) >= MOST_MOVES:
            raise InputError(f"hand held: at most {MOST_MOVES} moves can be queued. Wait until the device rests.")
        q = last.orientation(np.array([last.stop]))[0]
        return max(now, last.stop + self._rest_s), q / np.linalg.norm(q)

    def _add(self, move: Move) -> None:
        self.moves.append(move)
        # remove old moves, because a reading requires only the last step
        past = [k for k, old in enumerate(self.moves) if old.stop < self.clock.now() - PAST_S]
        del self.moves[: past[-1] if past else 0]

    def _orientation(self, time: FloatArray) -> FloatArray:
        q = np.empty((len(time), 4))
        index = np.maximum(np.searchsorted([move.start for move in self.moves], time, side="right") - 1, 0)
        for k in np.unique(index):
            q[index == k] = self.moves[k].orientation(time[index == k])
        return q

    def _seen(self, times: FloatArray, step_s: float) -> Seen:
        """Return rate, angular acceleration, force, mean rate over the step (n, 3) and temperature (n,)."""
        n, h = len(times), INSTANT_S
        shifts = np.repeat([-step_s, -h, 0.0, h], n)
        before, early, q, late = self._orientation(np.tile(times, 4) + shifts).reshape(4, n, 4)
        began, ended = np.concatenate((before, early, q)), np.concatenate((q, q, late))
        rotation = rotation_vector(quaternion_product(quaternion_conjugate(began), ended)).reshape(3, n, 3)
        mean_rate, first, second = rotation[0] / step_s, rotation[1] / h, rotation[2] / h
        force = rotate(quaternion_conjugate(q), np.tile([0.0, 0.0, self.gravity_m_s2], (n, 1)))
        return 0.5 * (first + second), (second - first) / h, force, mean_rate, np.full(n, BOARD_C)


# ---- Source of live readings.

KIND = "simulated"
_HELD: dict[str, HandHeld] = {}  # devices by address
_NUMBERS = itertools.count(1)


def description_of(device: SimulatedDevice, clock_speed: float = 1.0) -> StreamDescription:
    """Return the description of the readings of a simulated device."""
    return StreamDescription(
        channels=(COUNTER, *MEASURED[:6], "temp"),
        rate=device.rate,
        gyro_unit=device.model.gyro.unit,
        accel_unit=device.model.accel.unit,
        clock_speed=clock_speed,
        device=device.model.serial,
    )


class HandHeldSource:
    """Source that reads a hand-held device."""

    errors = 0

    def __init__(self, device: HandHeld, *, owns_device: bool) -> None:
        self._held, self._alone, self._open, self._followed = device, owns_device, False, False
        self.name = f"simulated device {device.device.serial}".rstrip()
        self.description = device.description

    def open(self) -> None:
        """Start to read. A device without an operator also starts its moves."""
        self._held.read()
        self._open = True
        if self._alone and not self._followed:
            self._followed = True
            self._held.follow()

    def read(self, wait_s: float) -> Chunk | None:
        """Return the readings since the last call, or None."""
        if not self._open or self._held.address not in _HELD:
            raise LinkError(f"{self.name}: the device is closed. Connect again.")
        counts, rows = self._held.read()
        if counts.size:
            return Chunk(host_time=host.monotonic(), counter=counts.astype(float), values=rows)
        host.sleep(TOGETHER_S)
        return None

    def received_instead(self) -> str:
        return "nothing"

    def close(self) -> None:
        """Close the source. A second call has no effect."""
        self._open = False
        if self._alone:
            self._held.close()


def source_of(place: str, options: dict[str, str]) -> HandHeldSource:
    """Return the source of an address, either a device of this process or a new device without an operator."""
    if place:
        device = _HELD.get(f"{KIND}:{place}")
        if device is None:
            raise InputError(f"device: unknown device 'simulated:{place}' in this process. Omit the number.")
        return HandHeldSource(device, owns_device=False)
    values = typed_options(tuple(options.items()), {"seed": int, "clock_speed": float}, "device")
    clock = Clock.started(values.get("clock_speed", 1.0))
    return HandHeldSource(HandHeld(seed=values.get("seed"), clock=clock), owns_device=True)
