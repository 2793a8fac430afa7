"""Task: human-like motion of a worn device, as functions of time.

Three angles and three coordinates are sums of smooth steps (quintics) and windowed sinusoids, with analytic derivatives::

    R_nb = Rz(yaw) Ry(pitch) Rx(roll)                     x forward, y left, z up; pitch forward is positive
    w_b  = (roll' - yaw' sin p,  pitch' cos r + yaw' cos p sin r,  yaw' cos p cos r - pitch' sin r)
    f_b  = R_nb^T (p'' + g z)

A task can be asked at any instants: the device and the optics each ask at their own.
"""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.sim.motion.motion import Motion, mean_rate
from undrift.sim.motion.script import turn_quaternion


@dataclass(frozen=True, slots=True)
class Step:
    """A smooth change: the quintic of least jerk, 10 s^3 - 15 s^4 + 6 s^5 of the local time s.

    Parameters
    ----------
    start_s, duration_s : float
        s.
    change : float
        rad or m.
    """

    start_s: float
    duration_s: float
    change: float

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative.

        Parameters
        ----------
        time : array, shape (N,)
            s.

        Returns
        -------
        array, shape (3, N)
            Value, per s, per s2.
        """
        s = np.clip((time - self.start_s) / self.duration_s, 0.0, 1.0)
        left = s * (1.0 - s)
        value = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
        first, second = 30.0 * left * left / self.duration_s, 60.0 * left * (1.0 - 2.0 * s) / self.duration_s**2
        return self.change * np.stack((value, first, second))


@dataclass(frozen=True, slots=True)
class Wave:
    """A sinusoid that swells at the start and ebbs at the end.

    Parameters
    ----------
    amplitude : float
        rad or m.
    frequency_hz : float
        Hz.
    phase : float
        rad.
    start_s, stop_s : float
        Where it is not zero, s.
    swell_s : float
        Time to full amplitude, and back to none, s.
    """

    amplitude: float
    frequency_hz: float
    phase: float
    start_s: float
    stop_s: float
    swell_s: float = 1.0

    def at(self, time: FloatArray) -> FloatArray:
        """Return value, first and second derivative.

        Parameters
        ----------
        time : array, shape (N,)
            s.

        Returns
        -------
        array, shape (3, N)
            Value, per s, per s2.
        """
        e, e1, e2 = Step(self.start_s, self.swell_s, 1.0).at(time) - Step(
            self.stop_s - self.swell_s, self.swell_s, 1.0
        ).at(time)
        speed = 2.0 * math.pi * self.frequency_hz
        sine, cosine = np.sin(speed * time + self.phase), np.cos(speed * time + self.phase)
        first = e1 * sine + e * speed * cosine
        second = e2 * sine + 2.0 * e1 * speed * cosine - e * speed**2 * sine
        return self.amplitude * np.stack((e * sine, first, second))


Course = tuple[Step | Wave, ...]


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
    roll, pitch, yaw : tuple of Step or Wave
        Angles, rad.
    forward, left, up : tuple of Step or Wave
        Coordinates of the device in n, m.
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
        roll, pitch, yaw = _course(self.roll, time), _course(self.pitch, time), _course(self.yaw, time)
        q = quaternion_product(
            turn_quaternion(np.array([0.0, 0.0, 1.0]), yaw[0]),
            quaternion_product(
                turn_quaternion(np.array([0.0, 1.0, 0.0]), pitch[0]),
                turn_quaternion(np.array([1.0, 0.0, 0.0]), roll[0]),
            ),
        )
        rate = _euler_rate(roll, pitch, yaw)
        push = np.stack([_course(course, time)[2] for course in (self.forward, self.left, self.up)], axis=1)
        force = rotate(quaternion_conjugate(q), push + np.array([0.0, 0.0, gravity_m_s2]))
        moving = ((time >= self.moving_s[0]) & (time <= self.moving_s[1])).astype(float)
        return Motion(
            time=time,
            q_nb=q,
            rate_b=rate,
            mean_rate_b=mean_rate(time, q, rate[0]),
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
        return np.stack([_course(course, time)[0] for course in (self.forward, self.left, self.up)], axis=1)


def _course(course: Course, time: FloatArray) -> FloatArray:
    total = np.zeros((3, len(time)))
    for part in course:
        total += part.at(time)
    return total


def _euler_rate(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> FloatArray:
    sr, cr, sp, cp = np.sin(roll[0]), np.cos(roll[0]), np.sin(pitch[0]), np.cos(pitch[0])
    return np.stack(
        (
            roll[1] - yaw[1] * sp,
            pitch[1] * cr + yaw[1] * cp * sr,
            yaw[1] * cp * cr - pitch[1] * sr,
        ),
        axis=1,
    )
