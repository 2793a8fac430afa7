"""Task: human-like motion of a worn device, as functions of time.

Three angles and three coordinates are courses: sums of parts with analytic derivatives (course.py)::

    R_nb = Rz(yaw) Ry(pitch) Rx(roll)                     x forward, y left, z up; pitch forward is positive
    w_b  = (roll' - yaw' sin p,  pitch' cos r + yaw' cos p sin r,  yaw' cos p cos r - pitch' sin r),   w_b' from it
    p    = c + R_nb r                                     c the coordinates, r the device's arm from what they follow
    f_b  = R_nb^T (c'' + g z) + w' x r + w x (w x r)

A task can be asked at any instants: the device and the optics each ask at their own.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.sim.motion.course import Course, course_at
from undrift.sim.motion.motion import Motion, mean_rate
from undrift.sim.motion.script import turn_quaternion


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A motion that can be asked at any instant.

    Parameters
    ----------
    name : str
        What is done.
    duration_s : float
        Length of a recording of it, s.
    moving_s : tuple of float
        First and last instant of motion, s.
    roll, pitch, yaw : tuple of Part
        Angles, rad.
    forward, left, up : tuple of Part
        Coordinates in n of the point that ``arm_b`` starts from, m.
    arm_b : tuple of float
        Device from that point, which is the device itself where it is zero, m.
    """

    name: str
    duration_s: float
    moving_s: tuple[float, float]
    roll: Course = ()
    pitch: Course = ()
    yaw: Course = ()
    forward: Course = ()
    left: Course = ()
    up: Course = ()
    arm_b: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def at(self, time: FloatArray, gravity_m_s2: float) -> Motion:
        """Return the motion at given instants.

        Parameters
        ----------
        time : array, shape (N,)
            s, increasing.
        gravity_m_s2 : float
            m/s2.

        Returns
        -------
        Motion
            Exact at those instants.
        """
        roll, pitch, yaw = course_at(self.roll, time), course_at(self.pitch, time), course_at(self.yaw, time)
        q = self._orientation(roll[0], pitch[0], yaw[0])
        rate, spin_up = _euler_rate(roll, pitch, yaw)
        arm = np.array(self.arm_b)
        push = np.stack([course_at(course, time)[2] for course in (self.forward, self.left, self.up)], axis=1)
        force = rotate(quaternion_conjugate(q), push + np.array([0.0, 0.0, gravity_m_s2]))
        force = force + np.cross(spin_up, arm) + np.cross(rate, np.cross(rate, arm))
        moving = ((time >= self.moving_s[0]) & (time <= self.moving_s[1])).astype(float)
        return Motion(
            time=time,
            q_nb=q,
            rate_b=rate,
            mean_rate_b=mean_rate(time, q, rate[0]),
            angular_acceleration_b=spin_up,
            force_b=force,
            gravity_m_s2=gravity_m_s2,
            moving=moving,
        )

    def position(self, time: FloatArray) -> FloatArray:
        """Return where the device is.

        Parameters
        ----------
        time : array, shape (N,)
            s.

        Returns
        -------
        array, shape (N, 3)
            m, frame n.
        """
        base = np.stack([course_at(course, time)[0] for course in (self.forward, self.left, self.up)], axis=1)
        q = self._orientation(*(course_at(course, time)[0] for course in (self.roll, self.pitch, self.yaw)))
        return base + rotate(q, np.broadcast_to(self.arm_b, (len(time), 3)))

    @staticmethod
    def _orientation(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> FloatArray:
        x, y, z = np.eye(3)
        return quaternion_product(
            turn_quaternion(z, yaw), quaternion_product(turn_quaternion(y, pitch), turn_quaternion(x, roll))
        )


def _euler_rate(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return w_b and its derivative from angles and their first two derivatives, each (3, N)."""
    sr, cr, sp, cp = np.sin(roll[0]), np.cos(roll[0]), np.sin(pitch[0]), np.cos(pitch[0])
    along, across = yaw[1] * cp, yaw[2] * cp - yaw[1] * pitch[1] * sp  # yaw' cos p and its derivative
    rate = np.stack((roll[1] - yaw[1] * sp, pitch[1] * cr + along * sr, along * cr - pitch[1] * sr), axis=1)
    spin_up = np.stack(
        (
            roll[2] - yaw[2] * sp - yaw[1] * pitch[1] * cp,
            pitch[2] * cr + across * sr + roll[1] * rate[:, 2],
            across * cr - pitch[2] * sr - roll[1] * rate[:, 1],
        ),
        axis=1,
    )
    return rate, spin_up
