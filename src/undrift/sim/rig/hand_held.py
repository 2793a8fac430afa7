"""An emulated device in an operator's hands: it lies on a face, is laid on another or turned by whole turns, and sends.

::

    q_nb(t) = q_0  turn(a, angle(s))  turn(c SMOOTH(s))  turn(tremor(t) w(s))       s in [0, 1] over a move
    force_b = R_nb^T ((0, 0, g) + lift''(t)) + shake(t) w(s)                        w = 16 s^2 (1 - s)^2

A move to a face takes the shortest way (c = 0). A turn is by the angle and an error of its own, about an axis that leans; c
then lays the device back on the face. About the vertical it slides on the bench, about another axis it is lifted. At rest
nothing moves: rate and tremor are zero, and the face is off level by what was drawn when it was laid down. Rates come from q_nb
itself. The board warms by a little. Moves that are asked for while it moves follow each other. The operator listens on a port
of its own: ``face +x`` (or ``MOUNT +x``) and ``turn z 360`` are answered by ``OK ...``, ``state?`` by ``rest +x`` or ``moving
+x``.
"""

import math
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.polynomial import Polynomial

from undrift.arrays import FloatArray
from undrift.base.clock import Clock
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotate, rotation_vector
from undrift.record import FACES, Axis, Face, MountedFace
from undrift.sim.device.effects import Scene
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.motion.bench import earth_rate
from undrift.sim.motion.motion import SMOOTH, UNEVEN, facing, turn_quaternion, unit_vector
from undrift.sim.rig.server import Closed, FaultyLink, LineMachine, server_of
from undrift.sim.rig.stream import EmulatedDevice, StreamSettings
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

REST_S = 0.5  # at least, between moves that were asked for at once
MOST_MOVES = 8  # that wait
WAVES, TREMOR_HZ = 6, (7.0, 11.0)
OVERSHOOT = Polynomial.fromroots([0] * 17 + [1] * 3) * -(20.0**20 / (17.0**17 * 3.0**3))  # 1 at its peak, s = 0.85
HELD = Polynomial.fromroots([0, 0, 1, 1]) * 16.0  # w
LIFT = Polynomial.fromroots([0, 0, 0, 1, 1, 1]) * -64.0
STEEPEST = 2.3  # largest rate of a turn over its mean
REACH = 0.8  # of the gyroscope's range: a faster turn would be cut off
TOGETHER_S = 0.02  # readings that are sent at once, host s
INSTANT_S = 1e-4  # over which a rate is taken from two orientations


@dataclass(frozen=True, slots=True, kw_only=True)
class HandSettings:
    """What an operator's hands do; each move draws anew. All defaults are choices."""

    tilt_sd: float = 0.3 * RADIAN_PER_DEGREE  # Of a face off level, about each axis, rad
    lay_s: tuple[float, float] = (1.0, 2.0)  # Shortest and longest move to another face, s
    turn_s: tuple[float, float] = (3.0, 4.0)  # The same for one full turn, s
    axis_sd: float = 0.3 * RADIAN_PER_DEGREE  # Of a turn's axis, about each axis across it, rad
    angle_sd: float = 0.5 * RADIAN_PER_DEGREE  # Of a turn's angle back at the mark, rad
    overshoot_sd: float = 4.0 * RADIAN_PER_DEGREE  # How far a turn goes beyond the mark and comes back, rad
    tremor: float = 1.0 * RADIAN_PER_DEGREE  # Rate of the tremor while held, rms about each axis, rad/s
    shake: float = 0.1  # Acceleration of the tremor while held, rms along each axis, m/s2
    lift: float = 0.08  # How high the device is lifted, m
    temp_c: float = 25.0  # Of the board at the start, degC
    warming_k: float = 0.3  # By how much it warms in the end, K
    warming_s: float = 900.0  # Time constant of that, s

    def __post_init__(self) -> None:
        for name in ("lay_s", "turn_s"):
            low, high = getattr(self, name)
            if not 0.0 < low <= high:
                raise InputError(f"hand held: wanted {name} above 0, the shorter first, got {low:g} and {high:g} s")


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """One move of the device, over s = (t - start) / duration in [0, 1]."""

    start: float  # s
    duration: float  # s
    q: FloatArray  # (4,), orientation before
    axis_b: FloatArray  # (3,), a
    angle: Polynomial  # rad over s
    back: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,), c, rad
    lift: float = 0.0  # m
    tremor: FloatArray = field(default_factory=lambda: np.zeros((4, WAVES, 3)))  # sizes rad and m/s2, Hz, phase rad

    @property
    def stop(self) -> float:
        """When it ends, s."""
        return self.start + self.duration

    def orientation(self, time: FloatArray) -> FloatArray:
        """Return q_nb (N, 4) at moments (N,) s; at rest before and after."""
        s = np.clip((time - self.start) / self.duration, 0.0, 1.0)
        q = quaternion_product(self.q, turn_quaternion(self.axis_b, self.angle(s)))
        q = quaternion_product(q, quaternion_of(SMOOTH(s)[:, None] * self.back))
        return quaternion_product(q, quaternion_of(HELD(s)[:, None] * self._waves(time, 0)))

    def push(self, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the acceleration upwards (N,), and that of the tremor (N, 3) in the case's axes, m/s2."""
        s = (time - self.start) / self.duration
        inside = (s > 0.0) & (s < 1.0)
        upwards = np.where(inside, self.lift * LIFT.deriv(2)(s) / self.duration**2, 0.0)
        return upwards, np.where(inside, HELD(s), 0.0)[:, None] * self._waves(time, 1)

    def _waves(self, time: FloatArray, row: int) -> FloatArray:
        size, (frequency, phase) = self.tremor[row], self.tremor[2:]
        return np.asarray((size * np.sin(2.0 * math.pi * frequency * time[:, None, None] + phase)).sum(axis=1))


class HandHeldDevice(EmulatedDevice):
    """A device that lies, is moved by hand when asked, and sends until closed."""

    def __init__(self, device: DeviceModel, hands: HandSettings, clock: Clock, settings: StreamSettings) -> None:
        self.hands = hands
        self._moves: list[Move] = []
        super().__init__(device, _FixedBench(), self._warming, clock, settings)

    @property
    def moving(self) -> bool:
        """Whether it is being moved, or about to be."""
        with self.lock:
            return self.clock.now() < self._moves[-1].stop

    def tick(self) -> None:
        """Come up to now, several readings at a time: it costs less."""
        if self.clock.now() - self._next * self._step > TOGETHER_S * self.clock.speed:
            super().tick()

    def mount(self, face: MountedFace) -> None:
        """Lay it on another face, with this one up."""
        if face not in FACES:
            raise InputError(f"face: wanted one of {', '.join(FACES)}, got '{face}'; name the axis that points up")
        with self.lock:
            start, q = self._after()
            way = rotation_vector(quaternion_product(quaternion_conjugate(q), self._laid(q, face)))
            angle = float(np.linalg.norm(way))
            axis, draw = (way / angle if angle > 0.0 else np.eye(3)[0]), self._hands
            self.face = face
            self._add(start, draw.uniform(*self.hands.lay_s), q, axis, SMOOTH * angle, lift=self.hands.lift)

    def turn(self, axis: Axis, angle: float) -> None:
        """Turn it by an angle about +axis, rad, a whole number of turns, and lay it down as it lay."""
        turns = angle / (2.0 * math.pi)
        if axis not in ("x", "y", "z") or not 0 < abs(round(turns)) <= 10 or abs(turns - round(turns)) > 1e-6:
            raise InputError(
                f"turn: wanted an axis x, y or z and 1 to 10 whole turns, got '{axis}' and {angle / RADIAN_PER_DEGREE:g} deg; "
                "say turn z 360, or -360 the other way"
            )
        with self.lock:
            start, q = self._after()
            draw, hands, unit = self._hands, self.hands, unit_vector(axis)
            leaning = unit + np.cross(draw.normal(0.0, hands.axis_sd, 3), unit)
            leaning /= np.linalg.norm(leaning)
            reached = angle + draw.normal(0.0, hands.angle_sd)
            beyond = math.copysign(abs(draw.normal(0.0, hands.overshoot_sd)), angle)
            course = reached * (SMOOTH + draw.uniform(-0.3, 0.3) * UNEVEN) + beyond * OVERSHOOT
            up = rotate(quaternion_conjugate(q), np.array([0.0, 0.0, 1.0]))
            slid = abs(float(up @ unit)) > 0.9
            q_end = quaternion_product(q, turn_quaternion(leaning, np.array(reached)))
            laid = facing(q_end, up) if slid else self._laid(q_end, self.face)
            back = rotation_vector(quaternion_product(quaternion_conjugate(q_end), laid))
            quickest = STEEPEST * abs(angle) / (REACH * self.device.gyro.full_scale)
            duration = max(abs(turns) * draw.uniform(*hands.turn_s), quickest)
            self._add(start, duration, q, leaning, course, back=back, lift=0.0 if slid else hands.lift)

    def _mount(self, face: MountedFace) -> None:  # where it lies at the start
        lying = self._laid(np.array([1.0, 0.0, 0.0, 0.0]), face)
        self.face = face
        self._moves.append(Move(-1.0, 1.0, lying, np.eye(3)[0], Polynomial([0.0])))

    def _laid(self, q: FloatArray, face: MountedFace) -> FloatArray:
        """Return the orientation nearest to one in which a face is up, off level as drawn."""
        up = unit_vector(face)
        return facing(q, up + np.cross(self._hands.normal(0.0, self.hands.tilt_sd, 3), up))

    def _after(self) -> tuple[float, FloatArray]:
        """Return when the next move may begin, and the orientation then."""
        self._go_on()
        now, last = self.clock.now(), self._moves[-1]
        if sum(move.start > now for move in self._moves) >= MOST_MOVES:
            raise InputError(
                f"hand held: wanted at most {MOST_MOVES} moves that wait, got one more; wait until it rests"
            )
        q = last.orientation(np.array([last.stop]))[0]
        return max(now, last.stop + REST_S), q / np.linalg.norm(q)

    def _add(
        self, start: float, duration: float, q: FloatArray, axis: FloatArray, angle: Polynomial, **more: Any
    ) -> None:
        draw, each = self._hands, math.sqrt(2.0 / WAVES)
        frequency, phase = draw.uniform(*TREMOR_HZ, (WAVES, 3)), draw.uniform(0.0, 2.0 * math.pi, (WAVES, 3))
        sizes = self.hands.tremor * each / (2.0 * math.pi * frequency), np.full((WAVES, 3), self.hands.shake * each)
        self._moves.append(Move(start, duration, q, axis, angle, tremor=np.stack((*sizes, frequency, phase)), **more))
        # what was sent needs no past but that of the last step
        past = [k for k, move in enumerate(self._moves) if move.stop < self.clock.now() - 1.0]
        del self._moves[: past[-1] if past else 0]

    def _warming(self, time: FloatArray) -> FloatArray:
        return np.asarray(self.hands.temp_c + self.hands.warming_k * (1.0 - np.exp(-time / self.hands.warming_s)))

    def _orientation(self, time: FloatArray) -> FloatArray:
        q = np.empty((len(time), 4))
        at = np.maximum(np.searchsorted([move.start for move in self._moves], time, side="right") - 1, 0)
        for k in np.unique(at):
            q[at == k] = self._moves[k].orientation(time[at == k])
        return q

    def _scene(self, times: FloatArray) -> tuple[Scene, FloatArray]:
        settings, n, h = self.settings, len(times), INSTANT_S
        resting = bool(times[0] - self._step > self._moves[-1].stop)
        rate, mean_rate, acceleration, shake = (np.zeros((n, 3)) for _ in range(4))
        gravity_n = np.zeros((n, 3))
        gravity_n[:, 2] = settings.gravity_m_s2
        if resting:
            q = np.tile(self._orientation(times[:1]), (n, 1))
        else:
            shifts = np.repeat([-self._step, -h, 0.0, h], n)
            before, early, q, late = self._orientation(np.tile(times, 4) + shifts).reshape(4, n, 4)
            began, ended = np.concatenate((before, early, q)), np.concatenate((q, q, late))
            turned = rotation_vector(quaternion_product(quaternion_conjugate(began), ended)).reshape(3, n, 3)
            mean_rate, first, second = turned[0] / self._step, turned[1] / h, turned[2] / h
            rate, acceleration = 0.5 * (first + second), (second - first) / h
            for move in self._moves:
                upwards, trembling = move.push(times)
                gravity_n[:, 2] += upwards
                shake += trembling
        to_b = quaternion_conjugate(q)
        if settings.latitude_deg is not None:
            earth_b = rotate(to_b, np.broadcast_to(earth_rate(settings.latitude_deg), (n, 3)))
            acceleration = acceleration - np.cross(rate, earth_b)
            rate, mean_rate = rate + earth_b, mean_rate + earth_b
        return self._surroundings(times, rate, acceleration, rotate(to_b, gravity_n) + shake), mean_rate


class _FixedBench:
    """What lies under the device does not turn."""

    def axis_states(self, times: FloatArray, *, mean_s: float = 0.0) -> tuple[FloatArray, FloatArray]:
        return np.zeros(len(times)), np.zeros(len(times))


# ---- The device and the operator's port together


class HandHeld(Closed):
    """A running device and its operator; a context manager that closes both."""

    def __init__(
        self, device: DeviceModel, hands: HandSettings, stream: StreamSettings, speed: float, clock: Clock | None
    ) -> None:
        self.device, chosen = device, clock or Clock.started(speed)
        self.stream = HandHeldDevice(device, hands, chosen, stream)
        try:
            self._operator = server_of(LineMachine(chosen, self._answered), FaultyLink(chosen), (stream.host, 0))
        except OSError:
            self.stream.close()
            raise
        self.address = self.stream.address(speed)
        self.operator_address = f"tcp://{self._operator.host}:{self._operator.port}"

    @property
    def face(self) -> MountedFace:
        """The face that is up, or will be after the move."""
        return self.stream.face

    @property
    def moving(self) -> bool:
        """Whether it is being moved."""
        return self.stream.moving

    def lay(self, face: Face) -> None:
        """Lay it with another face up."""
        self.stream.mount(face)

    def turn(self, axis: Axis, angle: float) -> None:
        """Turn it by whole turns about +axis, rad."""
        self.stream.turn(axis, angle)

    def close(self) -> None:
        """Close every socket and end every thread; harmless when called again."""
        self._operator.close()
        self.stream.close()

    def _answered(self, line: str) -> str:
        """Do what the operator is asked."""
        words = line.lower().split()
        if words == ["state?"]:
            return f"{'moving' if self.moving else 'rest'} {self.face}"
        if words[:1] in (["face"], ["mount"]) and len(words) == 2:
            self.lay(cast(Face, words[1]))
        elif words[:1] == ["turn"] and len(words) == 3:
            self.turn(cast(Axis, words[1]), _number(words[2]) * RADIAN_PER_DEGREE)
        else:
            raise InputError("operator: wanted 'face +x', 'turn z 360' or 'state?', got another line; send one of them")
        return f"OK {' '.join(line.split()[1:])}"


def start_hand_held(
    *,
    seed: int | None = None,
    device: DeviceModel | None = None,
    hands: HandSettings = HandSettings(),
    stream: StreamSettings | None = None,
    speed: float = 1.0,
    clock: Clock | None = None,
    gravity_m_s2: float = STANDARD_GRAVITY,
) -> HandHeld:
    """Start a device in an operator's hands; one of consumer grade is drawn where none is given, anew without a seed."""
    if seed is None:
        seed = int(np.random.default_rng().integers(2**31))
    chosen = device or random_device(np.random.default_rng(seed), grade="consumer")
    return HandHeld(chosen, hands, stream or StreamSettings(seed=seed, gravity_m_s2=gravity_m_s2), speed, clock)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"turn: wanted an angle in deg, got '{text}'; say turn z 360")
    return value
