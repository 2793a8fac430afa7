"""Motion: input of an ideal sensor, sample by sample, with the orientation.

::

    rate_b   angular rate of b, in b
    force_b  specific force R_nb^T (p'' + g z), in b (at rest, the axis that points up reads +g)

Both are closed-form values at the time of the sample, without numerical differentiation. If a recorded motion is unknown because
the cameras lost the body, the values are NaN and ``valid`` is 0.

Course: a coordinate over time, as a sum of terms with closed-form derivatives.

``Step``      Minimum-jerk change between two rests, 10 s^3 - 15 s^4 + 6 s^5, with peak rate 1.875 A/T, acceleration 5.77 A/T^2.
``ViaPoint``  Minimum-jerk motion to a turning point at a given time and back, with free acceleration at the turning point.
``Sway``      Sum of sinusoids with a varying envelope.
``Burst``     Decaying oscillation, such as the impact of a heel.

Script: a bench motion as a list of rotations about fixed axes, each with a polynomial angle.

In piece p, the case turns about an axis u_b by theta(s), where s is the local time over the duration, from its initial orientation
q_p. All quantities follow in closed form::

    q_nb = q_p (x) exp(u theta)      w_b = u theta'      f_b = R_nb^T g z

A still has theta = 0. A hand turn has the quintic A (10 s^3 - 15 s^4 + 6 s^5), and the rate of a rate table's ramp increases with
that quintic. A label omits its first sample, whose mean rate belongs to the previous piece. The label of a hand turn includes its
last sample.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.polynomial.polynomial import Polynomial, polyval

from undrift.arrays import FloatArray, Shape, freeze
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.record import Axis, Face, Still, Turn

# ---- Course: one coordinate over time, a sum of parts whose derivatives are closed forms.


class CourseTerm(Protocol):
    """A function of time with its first two derivatives."""

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative: time (N,) s -> (3, N)."""


Course = tuple[CourseTerm, ...]
EVEN_S = 1e-12  # largest distance of a time from an even grid, s


def course_at(course: Course, time: FloatArray) -> FloatArray:
    """Return a course and its first two derivatives: time (N,) s -> (3, N)."""
    total = np.zeros((3, len(time)))
    for term in course:
        total += term.at(time)
    return total


@dataclass(frozen=True, slots=True)
class Step:
    """A smooth change: the minimum-jerk quintic 10 s^3 - 15 s^4 + 6 s^5 of the local time s."""

    start_s: float  # s
    duration_s: float  # s
    change: float  # rad or m

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative: time (N,) s -> (3, N)."""
        s = np.clip((time - self.start_s) / self.duration_s, 0.0, 1.0)
        product = s * (1.0 - s)
        value = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
        first, second = (
            30.0 * product * product / self.duration_s,
            60.0 * product * (1.0 - 2.0 * s) / self.duration_s**2,
        )
        return self.change * np.stack((value, first, second))


@dataclass(frozen=True, slots=True)
class ViaPoint:
    """Minimum-jerk motion from rest to a turning point and back to rest.

    The integral of the squared jerk is the smallest of all courses that start and end at rest and have zero rate at the via-point.
    Each side is a quintic. Acceleration and jerk are continuous at the via-point, which determines its acceleration. With the
    durations T and U and the changes A and B::

        a = (20/3) (B / U^3 - A / T^3) / (1 / T + 1 / U)

    For equal sides (B = -A, U = T), the peak rate is 1.728 A/T and the acceleration at the turn -6.67 A/T^2.
    """

    start_s: float  # s
    there_s: float  # durations before and after the via-point, s
    back_s: float
    there: float  # changes before and after the via-point, rad or m
    back: float

    @property
    def acceleration(self) -> float:
        """Acceleration at the via-point, rad/s2 or m/s2."""
        pull = self.back / self.back_s**3 - self.there / self.there_s**3
        return 20.0 / 3.0 * pull / (1.0 / self.there_s + 1.0 / self.back_s)

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative: time (N,) s -> (3, N)."""
        via_s = self.start_s + self.there_s
        total = Step(self.start_s, self.there_s, self.there).at(time) + Step(via_s, self.back_s, self.back).at(time)
        bend = _bend(np.clip((via_s - time) / self.there_s, 0.0, 1.0), self.there_s) * [[1.0], [-1.0], [1.0]]
        after = time > via_s
        bend[:, after] = _bend(np.clip((time[after] - via_s) / self.back_s, 0.0, 1.0), self.back_s)
        return total + self.acceleration * bend


def _bend(s: FloatArray, duration_s: float) -> FloatArray:
    """Return T^2 s^2 (1 - s)^3 / 2 and its derivatives: unit acceleration at s = 0, no value or rate at either end."""
    remaining = 1.0 - s
    value = 0.5 * duration_s**2 * s * s * remaining**3
    first = 0.5 * duration_s * s * remaining * remaining * (2.0 - 5.0 * s)
    return np.stack((value, first, remaining * (1.0 - 8.0 * s + 10.0 * s * s)))


@dataclass(frozen=True, slots=True)
class Sway:
    """A sum of sinusoids with a common envelope."""

    amplitudes: tuple[float, ...]  # rad or m
    frequencies_hz: tuple[float, ...]  # Hz
    phases: tuple[float, ...]  # rad
    start_s: float  # start of the term, s
    stop_s: float
    swell_s: float  # rise time to full amplitude, and fall time to zero, s

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative: time (N,) s -> (3, N)."""
        rise = Step(self.start_s, self.swell_s, 1.0).at(time)
        e, e1, e2 = rise - Step(self.stop_s - self.swell_s, self.swell_s, 1.0).at(time)
        v, v1, v2 = self._steady(time)
        return np.stack((e * v, e1 * v + e * v1, e2 * v + 2.0 * e1 * v1 + e * v2))

    def _steady(self, time: FloatArray) -> FloatArray:
        # on an even grid in blocks, t = t_i + s_j, so exp(j w t) = exp(j w t_i) exp(j w s_j)
        size = math.isqrt(len(time)) + 1
        begin, inside = time[::size], time[:size] - time[0]
        if np.abs((begin[:, None] + inside).ravel()[: len(time)] - time).max() > EVEN_S:
            begin, inside = time, np.zeros(1)
        speed = 2.0j * math.pi * np.array(self.frequencies_hz)
        lines = np.array(self.amplitudes) * np.exp(1j * np.array(self.phases)) * speed ** [[0], [1], [2]]
        total = (lines[:, None] * np.exp(np.outer(begin, speed))) @ np.exp(np.outer(speed, inside))
        return np.asarray(total.imag.reshape(3, -1)[:, : len(time)])


@dataclass(frozen=True, slots=True)
class Burst:
    """A decaying impact: A (u/T)^3 exp(3 - 3 u/T) sin(w u), with u the time since its start."""

    amplitude: float  # A, m
    frequency_hz: float  # w / 2 pi, Hz
    start_s: float  # start of the impact, s
    peak_s: float  # T, time from the start to the peak of the envelope, s

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative: time (N,) s -> (3, N)."""
        u = np.maximum((time - self.start_s) / self.peak_s, 0.0)
        decay = np.exp(3.0 - 3.0 * u)
        e, e1 = u**3 * decay, 3.0 * u * u * (1.0 - u) * decay / self.peak_s
        e2 = 3.0 * u * (2.0 - 6.0 * u + 3.0 * u * u) * decay / self.peak_s**2
        speed = 2.0 * math.pi * self.frequency_hz
        sine, cosine = np.sin(speed * self.peak_s * u), np.cos(speed * self.peak_s * u)
        first, second = e1 * sine + e * speed * cosine, (e2 - e * speed**2) * sine + 2.0 * e1 * speed * cosine
        return self.amplitude * np.stack((e * sine, first, second))


# ---- motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """True motion of a device."""

    time: Annotated[FloatArray, Shape("n")]  # (N,), s
    q_nb: Annotated[FloatArray, Shape("n", 4)]  # (N, 4), orientation, w-x-y-z
    rate_b: Annotated[FloatArray, Shape("n", 3)]  # (N, 3), angular rate at the sample, rad/s
    # (N, 3), rotation vector of the step from the previous sample, divided by its duration, rad/s, which is the input of
    # a gyroscope that averages between samples
    mean_rate_b: Annotated[FloatArray, Shape("n", 3)]
    force_b: Annotated[FloatArray, Shape("n", 3)]  # (N, 3), specific force at the sample, m/s2
    gravity_m_s2: float  # gravity of the motion, m/s2
    stills: tuple[Still, ...] = ()  # stills, exact to the sample
    turns: tuple[Turn, ...] = ()  # turns with a known rate or angle
    moving: Annotated[FloatArray, Shape("n")]  # (N,), 1 while the device moves, otherwise 0
    # (N, 3), angular acceleration, rad/s2, or None if it is unknown
    angular_acceleration_b: Annotated[FloatArray | None, Shape("n", 3)] = None
    # (N,), 1 for samples with known motion, otherwise 0 (all 1 by default)
    valid: Annotated[FloatArray, Shape("n")] = field(default_factory=lambda: np.ones(0))

    def __post_init__(self) -> None:
        if len(self.valid) == 0:
            object.__setattr__(self, "valid", np.ones(len(self.time)))
        freeze(self)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def sample_rate_hz(self) -> float:
        """Samples per second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))


def after_rest(motion: Motion, before_s: FloatArray) -> Motion:
    """Return a motion without labels, after a rest at its first row. The times of the rest are s before the first sample."""
    names = ("q_nb", "rate_b", "mean_rate_b", "force_b", "moving", "angular_acceleration_b")
    columns: dict[str, Any] = {
        name: np.concatenate((np.repeat(x[:1], len(before_s), axis=0), x))
        for name in names
        if (x := getattr(motion, name)) is not None
    }
    time = np.concatenate((motion.time[0] - before_s, motion.time))
    return Motion(time=time, gravity_m_s2=motion.gravity_m_s2, **columns)


def mean_rate(time: FloatArray, q_nb: FloatArray, first: FloatArray) -> FloatArray:
    """Return the rotation vector of each step, divided by its duration.

    ``w[k] = log(conj(q[k-1]) q[k]) / (t[k] - t[k-1])`` is exact for any motion: a rotation with w[k] for a step leads to the next
    orientation.

    Arrays: time (N,) s, q_nb (N, 4), first (3,) rad/s -> (N, 3) rad/s.
    """
    step = quaternion_product(quaternion_conjugate(q_nb[:-1]), q_nb[1:])
    step = np.where(step[:, :1] < 0.0, -step, step)
    sine = np.linalg.norm(step[:, 1:], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        stretch = np.where(sine > 0.0, 2.0 * np.arctan2(sine, step[:, 0]) / sine, 2.0)
    return np.vstack((first[None, :], step[:, 1:] * (stretch / np.diff(time))[:, None]))


# ---- Script: a bench motion written as a list of rotations about fixed axes, each with a polynomial angle.


@dataclass(frozen=True, slots=True, eq=False)
class PolynomialAngle:
    """An angle that is a polynomial of the local time s in [0, 1], rad."""

    coefficients: FloatArray  # (order + 1, 3), of the angle and of its first and second derivative

    @classmethod
    def of(cls, *coefficients: float) -> "PolynomialAngle":
        """Return the angle with these coefficients, lowest order first."""
        angle = Polynomial(coefficients)
        rows = np.zeros((len(coefficients), 3))
        for order in range(3):
            derivative = angle.deriv(order).coef
            rows[: len(derivative), order] = derivative
        return cls(rows)

    def scaled(self, factor: float) -> "PolynomialAngle":
        """Return the angle times a factor."""
        return PolynomialAngle(factor * self.coefficients)

    def at(self, s: FloatArray | float) -> FloatArray:
        """Return the angle and its first and second derivative with respect to s: (...) -> (3, ...)."""
        return np.asarray(polyval(s, self.coefficients))


REST = PolynomialAngle.of(0.0)
SMOOTH = PolynomialAngle.of(0.0, 0.0, 0.0, 10.0, -15.0, 6.0)  # 0 to 1, both derivatives vanish at both ends
RAMP_UP = PolynomialAngle.of(0.0, 0.0, 0.0, 0.0, 2.5, -3.0, 1.0)  # integral of SMOOTH: its final value is 1/2
RAMP_DOWN = PolynomialAngle.of(0.0, 1.0, 0.0, 0.0, -2.5, 3.0, -1.0)  # s minus RAMP_UP
# SMOOTH plus the unevenness 40 s^3 (s - 1/2) (s - 1)^3 of a hand
HAND = PolynomialAngle.of(0.0, 0.0, 0.0, 30.0, -115.0, 186.0, -140.0, 40.0)


@dataclass(frozen=True, slots=True)
class UnevenAngle:
    """The angle of a dwell whose rate has a ripple per turn and settles late.

    Its rate is w (1 + a sin(p + w t) + c exp(-t / T)), t = s times the duration.
    """

    turn_rate: float  # w, rad/s
    duration_s: float  # duration of the dwell, s
    ripple: float  # a, relative
    azimuth: float  # p, azimuth of the table at the start of the dwell relative to the ripple's zero, rad
    excess: float  # c, relative rate error at the start of the dwell
    settle_s: float  # T, s

    def at(self, s: FloatArray | float) -> FloatArray:
        """Return the angle and its first and second derivative with respect to s: (...) -> (3, ...)."""
        w, late = self.turn_rate, np.exp(-s * self.duration_s / self.settle_s)
        angle_turned = w * self.duration_s * s
        wave_at = self.azimuth + angle_turned
        ripple = self.ripple * (math.cos(self.azimuth) - np.cos(wave_at))
        slope = self.ripple * w * np.cos(wave_at) - self.excess / self.settle_s * late
        return np.stack(
            (
                angle_turned + ripple + w * self.excess * self.settle_s * (1.0 - late),
                w * self.duration_s * (1.0 + self.ripple * np.sin(wave_at) + self.excess * late),
                w * self.duration_s**2 * slope,
            )
        )


Angle = PolynomialAngle | UnevenAngle


@dataclass(frozen=True, slots=True, eq=False)
class TurnSegment:
    """Samples [start, stop): a turn about one axis."""

    start: int  # Samples
    stop: int  # Samples
    q: FloatArray  # (4,), orientation at its start
    axis_b: FloatArray  # (3,), unit vector
    angle: Angle


class Script:
    """Builder that writes a motion piece by piece."""

    def __init__(self, sample_rate_hz: float, up_b: FloatArray) -> None:
        self.sample_rate_hz = sample_rate_hz
        self.q = facing(np.array([1.0, 0.0, 0.0, 0.0]), up_b)
        self.pieces: list[TurnSegment] = []
        self.stills: list[Still] = []
        self.turns: list[Turn] = []

    @property
    def samples(self) -> int:
        """Return the number of samples written so far."""
        return self.pieces[-1].stop if self.pieces else 0

    def still(self, duration_s: float, face: Face | None = None) -> None:
        """Add a still."""
        start, stop = self._turn(duration_s, np.array([1.0, 0.0, 0.0]), REST)
        self.stills.append(Still(start=start + (start > 0), stop=stop, face=face))

    def lay(self, q: FloatArray, duration_s: float) -> None:
        """Turn smoothly, along the shortest path, to an orientation q (4,), or begin with it."""
        if not self.samples:
            self.q = q
            return
        step = quaternion_product(quaternion_conjugate(self.q), q)
        step = step if step[0] >= 0.0 else -step
        sine = float(np.linalg.norm(step[1:]))
        axis = step[1:] / sine if sine > 1e-12 else np.array([1.0, 0.0, 0.0])
        self._turn(duration_s, axis, SMOOTH.scaled(2.0 * np.arctan2(sine, step[0])))

    def hand_turn(self, axis: Axis, angle: float, duration_s: float, axis_b: FloatArray) -> None:
        """Turn by hand through an angle about axis_b (3,), at an uneven rate."""
        start, stop = self._turn(duration_s, axis_b, HAND.scaled(angle))
        self.turns.append(Turn(start=start + 1, stop=stop + 1, axis=axis, angle=angle))

    def spin(
        self,
        axis: Axis,
        axis_b: FloatArray,
        turn_rate: float,
        ramp_s: float,
        dwell_s: float,
        *,
        stated_rate: float,
        uneven: tuple[float, float, float, float],
    ) -> None:
        """Add a ramp up, a dwell at a rate about an axis (3,) and a ramp down. The label has the nominal axis and rate.

        `uneven` is (ripple, azimuth, excess, settle_s).
        """
        ramp, dwell = (round(length_s * self.sample_rate_hz) / self.sample_rate_hz for length_s in (ramp_s, dwell_s))
        self._turn(ramp_s, axis_b, RAMP_UP.scaled(turn_rate * ramp))
        start, stop = self._turn(dwell_s, axis_b, UnevenAngle(turn_rate, dwell, *uneven))
        self.turns.append(Turn(start=start + 1, stop=stop, axis=axis, turn_rate=stated_rate))
        self._turn(ramp_s, axis_b, RAMP_DOWN.scaled(turn_rate * ramp))

    def motion(self, gravity_m_s2: float) -> Motion:
        """Return the motion of the script."""
        counts = [piece.stop - piece.start for piece in self.pieces]
        time, duration = np.arange(self.samples) / self.sample_rate_hz, np.repeat(counts, counts) / self.sample_rate_hz
        local = [np.arange(count) / count for count in counts]
        angle, first, second = np.hstack([piece.angle.at(s) for piece, s in zip(self.pieces, local, strict=True)])
        axis_b = np.repeat([piece.axis_b for piece in self.pieces], counts, axis=0)
        q = quaternion_product(
            np.repeat([piece.q for piece in self.pieces], counts, axis=0), turn_quaternion(axis_b, angle)
        )
        rate = (first / duration)[:, None] * axis_b
        return Motion(
            time=time,
            q_nb=q,
            rate_b=rate,
            mean_rate_b=mean_rate(time, q, rate[0]),
            angular_acceleration_b=(second / duration**2)[:, None] * axis_b,
            force_b=rotate(quaternion_conjugate(q), np.broadcast_to([0.0, 0.0, gravity_m_s2], rate.shape)),
            gravity_m_s2=gravity_m_s2,
            stills=tuple(self.stills),
            turns=tuple(self.turns),
            moving=np.repeat([float(piece.angle is not REST) for piece in self.pieces], counts),
        )

    def _turn(self, duration_s: float, axis_b: FloatArray, angle: Angle) -> tuple[int, int]:
        start = self.samples
        stop = start + round(duration_s * self.sample_rate_hz)
        self.pieces.append(TurnSegment(start, stop, self.q, axis_b, angle))
        if angle is not REST:
            self.q = quaternion_product(self.q, turn_quaternion(axis_b, angle.at(1.0)[0]))
            self.q = self.q / np.linalg.norm(self.q)
        return start, stop


def unit_vector(name: str) -> FloatArray:
    """Return the unit vector (3,) of an axis or a face."""
    vector = np.zeros(3)
    vector["xyz".index(name.lstrip("+-"))] = -1.0 if name[0] == "-" else 1.0
    return vector


def turn_quaternion(axis_b: FloatArray, angle: FloatArray) -> FloatArray:
    """Return the quaternions of turns about one axis: axis_b (3,), angle (...,) rad -> (..., 4)."""
    half = 0.5 * np.asarray(angle)
    return np.concatenate((np.cos(half)[..., None], np.sin(half)[..., None] * axis_b), axis=-1)


def facing(q: FloatArray, up_b: FloatArray) -> FloatArray:
    """Return the orientation nearest to q in which a direction of the case points up: q (4,), up_b (3,) -> (4,)."""
    up = up_b / np.linalg.norm(up_b)
    now = rotate(quaternion_conjugate(q), np.array([0.0, 0.0, 1.0]))
    axis = np.cross(up, now)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:  # parallel or opposite: turn about any perpendicular axis
        axis = np.cross(now, np.eye(3)[int(np.argmin(np.abs(now)))])
    angle = np.arctan2(sine, float(up @ now))
    return quaternion_product(q, turn_quaternion(axis / np.linalg.norm(axis), np.array(angle)))
