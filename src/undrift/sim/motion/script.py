"""Script: a bench motion written as a list of rotations about fixed axes, each with a polynomial angle.

In piece p the case turns about one axis u_b by theta(s), s = local time over duration, from the orientation q_p in which
the piece began. Everything follows in closed form::

    q_nb = q_p (x) exp(u theta)      w_b = u theta'      f_b = R_nb^T (c'' + g z) + w' x r + w x (w x r)

with r the lever arm of the accelerometers from the turning axis and c the path of a slide, along which nothing turns.
A still has theta = 0; a hand turn has the quintic A (10 s^3 - 15 s^4 + 6 s^5); the ramp of a rate table has a rate that
rises by that quintic. A label leaves out its first sample, whose mean rate still belongs to the step before; the label of
a hand turn takes in the sample that ends it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from undrift.arrays import FloatArray
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.session import Axis, Face, Still, Turn
from undrift.sim.motion.course import Course, course_at
from undrift.sim.motion.motion import Motion, mean_rate

REST = Polynomial([0.0])
SMOOTH = Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])  # 0 to 1, first and second derivatives vanish at both ends
RAMP = SMOOTH.integ()  # its derivative rises smoothly from 0 to 1; reaches 1/2
UNEVEN = Polynomial.fromroots([0, 0, 0, 0.5, 1, 1, 1]) * 40.0  # a hand that hesitates half way; 0 at both ends

Path = tuple[Course, Course, Course]


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Samples [start, stop): a turn about one axis.

    Parameters
    ----------
    start, stop : int
        Samples.
    q : array, shape (4,)
        Orientation at its first instant.
    axis_b : array, shape (3,)
        Unit vector.
    angle : Polynomial
        Angle over s in [0, 1), rad.
    path : tuple of Course
        Displacement along x, y, z of n over the time since its first instant, m.
    """

    start: int
    stop: int
    q: FloatArray
    axis_b: FloatArray
    angle: Polynomial
    path: Path = ((), (), ())


class Script:
    """Writes a motion piece by piece.

    Parameters
    ----------
    sample_rate_hz : float
        Samples per second.
    up_b : array, shape (3,)
        Direction of the case that points up at the start.
    """

    def __init__(self, sample_rate_hz: float, up_b: FloatArray) -> None:
        self.sample_rate_hz = sample_rate_hz
        self.q = facing(np.array([1.0, 0.0, 0.0, 0.0]), up_b)
        self.pieces: list[Piece] = []
        self.stills: list[Still] = []
        self.turns: list[Turn] = []

    @property
    def samples(self) -> int:
        """Samples written so far."""
        return self.pieces[-1].stop if self.pieces else 0

    def still(self, duration_s: float, face: Face | None = None) -> None:
        """Stand still.

        Parameters
        ----------
        duration_s : float
            s.
        face : str, optional
            Axis that points up, for the label.
        """
        start, stop = self._turn(duration_s, np.array([1.0, 0.0, 0.0]), REST)
        self.stills.append(Still(start=start + (start > 0), stop=stop, face=face))

    def turn_to(self, q: FloatArray, duration_s: float) -> None:
        """Turn smoothly, by the shortest way, to an orientation.

        Parameters
        ----------
        q : array, shape (4,)
            Wanted q_nb.
        duration_s : float
            s.
        """
        step = quaternion_product(quaternion_conjugate(self.q), q)
        step = step if step[0] >= 0.0 else -step
        sine = float(np.linalg.norm(step[1:]))
        axis = step[1:] / sine if sine > 1e-12 else np.array([1.0, 0.0, 0.0])
        self._turn(duration_s, axis, SMOOTH * (2.0 * np.arctan2(sine, step[0])))

    def hand_turn(self, axis: Axis, angle: float, duration_s: float, axis_b: FloatArray, label: float) -> None:
        """Turn by hand through an angle, at a rate that is anything but constant.

        Parameters
        ----------
        axis : str
            Case axis of the label.
        angle : float
            Angle turned, rad.
        duration_s : float
            s.
        axis_b : array, shape (3,)
            True axis of the turn, a unit vector.
        label : float
            Angle that the label states, rad.
        """
        start, stop = self._turn(duration_s, axis_b, (SMOOTH + UNEVEN) * angle)
        self.turns.append(Turn(start=start + 1, stop=stop + 1, axis=axis, angle=label))

    def spin(self, axis: Axis, turn_rate: float, ramp_s: float, dwell_s: float) -> None:
        """Ramp up, hold a steady rate, ramp down; the dwell is labelled.

        Parameters
        ----------
        axis : str
            Case axis along the table's.
        turn_rate : float
            About +axis, rad/s.
        ramp_s, dwell_s : float
            s.
        """
        unit = unit_vector(axis)
        ramp, dwell = self._whole(ramp_s), self._whole(dwell_s)
        self._turn(ramp_s, unit, RAMP * (turn_rate * ramp))
        start, stop = self._turn(dwell_s, unit, Polynomial([0.0, turn_rate * dwell]))
        self.turns.append(Turn(start=start + 1, stop=stop, axis=axis, turn_rate=turn_rate))
        self._turn(ramp_s, unit, (Polynomial([0.0, 1.0]) - RAMP) * (turn_rate * ramp))

    def slide(self, path: Path, duration_s: float) -> None:
        """Move along a path without turning.

        Parameters
        ----------
        path : tuple of Course
            Displacement along x, y, z of n, m, over the time since the slide began; at rest at both ends.
        duration_s : float
            s.
        """
        start, stop = self._turn(duration_s, np.array([1.0, 0.0, 0.0]), REST)
        self.pieces[-1] = Piece(start, stop, self.q, np.array([1.0, 0.0, 0.0]), REST, path)

    def motion(self, gravity_m_s2: float, *, lever_arm_b: FloatArray, earth_rate_n: FloatArray) -> Motion:
        """Return what was written.

        Parameters
        ----------
        gravity_m_s2 : float
            m/s2.
        lever_arm_b : array, shape (3,)
            Accelerometers from the turning axis, m.
        earth_rate_n : array, shape (3,)
            Rate of n against inertial space, rad/s.

        Returns
        -------
        Motion
            With stills and turns labelled.
        """
        n = self.samples
        time = np.arange(n) / self.sample_rate_hz
        q, rate, rotation_acceleration, moving = np.empty((n, 4)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
        push_n = np.zeros((n, 3))
        for piece in self.pieces:
            cut = slice(piece.start, piece.stop)
            count = piece.stop - piece.start
            if piece.angle is REST:
                q[cut] = piece.q
                moving[cut] = float(any(piece.path))
                since = np.arange(count) / self.sample_rate_hz
                push_n[cut] = np.stack([course_at(course, since)[2] for course in piece.path], axis=1)
                continue
            s, duration = np.arange(count) / count, count / self.sample_rate_hz
            q[cut] = quaternion_product(piece.q, turn_quaternion(piece.axis_b, piece.angle(s)))
            rate[cut] = np.outer(piece.angle.deriv(1)(s) / duration, piece.axis_b)
            rotation_acceleration[cut] = np.outer(piece.angle.deriv(2)(s) / duration**2, piece.axis_b)
            moving[cut] = 1.0
        inverse = quaternion_conjugate(q)
        earth_b = rotate(inverse, np.broadcast_to(earth_rate_n, (n, 3)))
        arm = np.broadcast_to(lever_arm_b, (n, 3))
        swing = np.cross(rotation_acceleration, arm) + np.cross(rate, np.cross(rate, arm))
        return Motion(
            time=time,
            q_nb=q,
            rate_b=rate + earth_b,
            mean_rate_b=mean_rate(time, q, rate[0]) + earth_b,
            angular_acceleration_b=rotation_acceleration - np.cross(rate, earth_b),
            force_b=rotate(inverse, push_n + np.array([0.0, 0.0, gravity_m_s2])) + swing,
            gravity_m_s2=gravity_m_s2,
            stills=tuple(self.stills),
            turns=tuple(self.turns),
            moving=moving,
        )

    def _turn(self, duration_s: float, axis_b: FloatArray, angle: Polynomial) -> tuple[int, int]:
        start = self.samples
        stop = start + round(duration_s * self.sample_rate_hz)
        self.pieces.append(Piece(start, stop, self.q, axis_b, angle))
        if angle is not REST:
            self.q = quaternion_product(self.q, turn_quaternion(axis_b, np.array(angle(1.0))))
            self.q = self.q / np.linalg.norm(self.q)
        return start, stop

    def _whole(self, duration_s: float) -> float:
        return round(duration_s * self.sample_rate_hz) / self.sample_rate_hz


def unit_vector(name: Axis | Face) -> FloatArray:
    """Return the unit vector of an axis or face.

    Parameters
    ----------
    name : str
        "x", "+x", "-x", ...

    Returns
    -------
    array, shape (3,)
        In b.
    """
    vector = np.zeros(3)
    vector["xyz".index(name[-1])] = -1.0 if name[0] == "-" else 1.0
    return vector


def turn_quaternion(axis_b: FloatArray, angle: FloatArray) -> FloatArray:
    """Return the quaternions of turns about one axis.

    Parameters
    ----------
    axis_b : array, shape (3,)
        Unit vector.
    angle : array, shape (...,)
        rad.

    Returns
    -------
    array, shape (..., 4)
        w-x-y-z.
    """
    half = 0.5 * np.asarray(angle)
    return np.concatenate((np.cos(half)[..., None], np.sin(half)[..., None] * axis_b), axis=-1)


def facing(q: FloatArray, up_b: FloatArray) -> FloatArray:
    """Return the orientation nearest to q in which a direction of the case points up.

    Parameters
    ----------
    q : array, shape (4,)
        q_nb to start from.
    up_b : array, shape (3,)
        Direction, of any length.

    Returns
    -------
    array, shape (4,)
        q_nb.
    """
    up = up_b / np.linalg.norm(up_b)
    now = rotate(quaternion_conjugate(q), np.array([0.0, 0.0, 1.0]))
    axis = np.cross(up, now)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:  # same way or upside down: turn about any axis across
        axis = np.cross(now, np.eye(3)[int(np.argmin(np.abs(now)))])
    angle = np.arctan2(sine, float(up @ now))
    return quaternion_product(q, turn_quaternion(axis / np.linalg.norm(axis), np.array(angle)))
