"""A person who stands, walks, bows or squats with a sensor on a segment: closed-form courses, no equation of the estimator.

Walking is a pendulum upside down: over the standing leg the trunk is highest and slowest. With a phase that counts strides::

    up = -h cos(2 p)      forward speed = v + d cos(2 p)      left = w sin(p)      pelvis: yaw and roll with p, pitch with 2 p

so that heel strikes (lowest, fastest) are at p = 0 and pi. Persons differ in size, phase, asymmetry and how straight they go. A
limb swings about the hip: forward within 0.38 of a stride, back within the rest.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from testkit.plain_triad import plain_triad
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.model import Calibration
from undrift.record import Record
from undrift.sim.motion.motion import turn_quaternion

GRAVITY = 9.80665
DEGREE = np.pi / 180.0


def misplaced(rng, degrees=20.0, turn=None):
    """Return q_ab of a device turned from the segment's axes by so much about a random axis, after a coarse turn."""
    axis = rng.standard_normal(3)
    q = turn_quaternion(axis / np.linalg.norm(axis), np.array([degrees * DEGREE]))[0]
    return q if turn is None else quaternion_product(np.asarray(turn), q)


def _smooth_rise(t, start, length):
    s = np.clip((t - start) / length, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def _swing(phase, forward=0.38):
    """Return a limb's angle, 1 to -1 (forward end in front is -1), quick within a share of the stride and slow within the rest."""
    p = np.mod(phase / (2.0 * np.pi), 1.0)
    return np.where(p < forward, np.cos(np.pi * p / forward), -np.cos(np.pi * (p - forward) / (1.0 - forward)))


def _sway(rng, t, rms):
    lines = rng.uniform(0.05, 0.6, 8)
    return rms * np.sqrt(2.0 / 8.0) * sum(np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 2.0 * np.pi)) for f in lines)


def walk(rng, place="lower-back", *, stand_s=4.0, walk_s=9.0, bouts=4, q_ab=(1.0, 0.0, 0.0, 0.0), rate=100.0):
    """Return a recording of somebody who stands, walks, and stands again, some times."""
    fine = 10
    t = np.arange(round((stand_s + bouts * (stand_s + walk_s)) * rate) * fine) / (rate * fine)
    starts = stand_s + (stand_s + walk_s) * np.arange(bouts)
    on = sum(_smooth_rise(t, start, 1.5) - _smooth_rise(t, start + walk_s - 1.5, 1.5) for start in starts)
    cadence, wobble = rng.uniform(0.78, 1.05), 0.02 * np.sin(2.0 * np.pi * 0.11 * t + rng.uniform(0.0, 6.0))
    phase = 2.0 * np.pi * np.cumsum(cadence * (1.0 + wobble)) / (rate * fine)
    legs = 1.0 + rng.normal(0.0, 0.1) * np.cos(phase)  # a left step is not a right one
    late = rng.normal(0.0, 0.25)
    height = rng.uniform(0.012, 0.025) * on * legs
    speed = on * (rng.uniform(0.9, 1.5) + legs * rng.uniform(0.08, 0.2) * np.cos(2.0 * phase + late))
    side = on * (
        rng.uniform(0.015, 0.03) * np.sin(phase + rng.normal(0.0, 0.3)) + rng.normal(0.0, 0.0015) * np.sin(2.0 * phase)
    )
    course = 25.0 * DEGREE * np.sin(2.0 * np.pi * 0.03 * t + rng.uniform(0.0, 6.0)) * on
    yaw = course + on * rng.uniform(3.0, 7.0) * DEGREE * np.sin(phase + rng.normal(0.0, 0.4))
    lean = (
        rng.normal(0.0, np.abs(rng.normal((0.9, 0.6), (0.3, 0.2)))) * DEGREE
    )  # a posture is not taken again as it was
    pitch = (
        lean[0] * (1.0 - on)
        + _sway(rng, t, 0.4 * DEGREE)
        + on * (3.0 + 1.5 * np.cos(2.0 * phase + rng.normal())) * DEGREE
    )
    roll = (
        lean[1] * (1.0 - on)
        + _sway(rng, t, 0.3 * DEGREE)
        + on * rng.uniform(2.0, 5.0) * DEGREE * np.sin(phase + rng.normal(0.0, 0.4))
    )
    if place != "lower-back":
        size, most = {"thigh": (22.0, 3.0), "shank": (35.0, 4.0), "foot": (40.0, 4.0), "wrist": (20.0, 4.0)}[place]
        share = 0.5 if place == "wrist" else rng.uniform(0.36, 0.42)
        pitch = pitch + on * size * DEGREE * rng.uniform(0.8, 1.2) * _smoothed(
            _swing(phase, share), round(0.12 * rate * fine)
        )
        roll, yaw = (
            roll + 0.3 * roll,
            course + on * rng.normal(0.0, most) * DEGREE * np.sin(phase + rng.uniform(0.0, 6.0)),
        )
    position = np.stack(
        (np.cumsum(speed * np.cos(course)), np.cumsum(speed * np.sin(course)), np.zeros_like(t)), axis=1
    ) / (rate * fine)
    position += np.stack((-side * np.sin(course), side * np.cos(course), -height * np.cos(2.0 * phase)), axis=1)
    return _record(t, (roll, pitch, yaw), position, rng, q_ab, fine)


def bow(rng, *, times=4, q_ab=(1.0, 0.0, 0.0, 0.0), rate=100.0):
    """Return a recording of somebody who stands still and then bows some times."""
    fine = 10
    t = np.arange(round((6.0 + 4.0 * times + 3.0) * rate) * fine) / (rate * fine)
    gone = sum(_smooth_rise(t, 6.0 + 4.0 * k, 1.3) - _smooth_rise(t, 7.8 + 4.0 * k, 1.3) for k in range(times))
    pitch = gone * rng.uniform(35.0, 60.0) * DEGREE + _sway(rng, t, 0.4 * DEGREE)
    roll = gone * rng.normal(0.0, 2.0) * DEGREE + _sway(rng, t, 0.3 * DEGREE)
    position = 0.3 * np.stack((np.sin(pitch), np.sin(roll), np.cos(pitch)), axis=1)
    return _record(t, (roll, pitch, gone * rng.normal(0.0, 2.0) * DEGREE), position, rng, q_ab, fine)


def _smoothed(x, width):
    window = np.hanning(width + 2)[1:-1]
    return np.convolve(np.pad(x, width, mode="edge"), window / window.sum(), "same")[width:-width]


def _record(t, angles, position, rng, q_ab, fine):
    q = Rotation.from_euler("xyz", np.stack(angles, axis=1)).as_quat(scalar_first=True)  # q_na, of roll, pitch and yaw
    push = np.gradient(np.gradient(position, t, axis=0), t, axis=0) + np.array([0.0, 0.0, GRAVITY])
    turn = quaternion_product(quaternion_conjugate(q[:-1]), q[1:])
    rate_a = 2.0 * turn[:, 1:] * np.sign(turn[:, :1]) / np.diff(t)[:, None]
    rate_a = np.vstack((rate_a[:1], rate_a))
    back = quaternion_conjugate(np.asarray(q_ab))  # a to b
    gyro = rotate(back, rate_a)[::fine]
    accel = rotate(back, rotate(quaternion_conjugate(q), push))[::fine]
    gyro = gyro + 0.0015 * rng.standard_normal(gyro.shape) + rng.normal(0.0, 0.3, 3) * DEGREE
    return Record(
        time=t[::fine].copy(),
        gyro=gyro,
        accel=accel + 0.02 * rng.standard_normal(accel.shape) + rng.normal(0.0, 0.02, 3),
    )


def perfect_calibration():
    """Return the calibration of a device whose sensors read right."""
    return Calibration(
        device="",
        reference_temp_c=np.nan,
        gravity_m_s2=9.80665,
        gyro=plain_triad("rad/s", "rad/s"),
        accel=plain_triad("m/s2", "m/s2", "accel"),
    )
