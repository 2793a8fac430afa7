"""The course of the segment that wears a device: what a task is measured on.

The readings are turned to the segment's axes, w_a = R_ab w_b, f_a = R_ab f_b, and VQF (offline, 6D) [1]_ gives q_na. Its
inclination follows the accelerometers with the time constant ``acc_s``. With u the vertical seen in a, and g the mean of f_a . u::

    pitch = atan2(-u_x, u_z)      roll = atan2(u_y, u_z)      turning = w_a . u      up = f_a . u - g

    v = highpass(integral of up)          upward velocity, 0.1 Hz in both directions: a slow error of ``up`` does not sum up

``acc_s`` of 6 s was chosen on simulated people of the library (sit-to-stand, step: least error of the pitch), not on captures.

.. [1] D. Laidig, T. Seel, Information Fusion 91, 187-204, 2023.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, rotate
from undrift.model import BodyMounting
from undrift.orientation import check_whole, filtered
from undrift.record import Record
from undrift.segments import unpadded
from undrift.units import RADIAN_PER_DEGREE

ACC_S = 6.0
MOST_HZ = 120.0  # faster recordings are averaged to a rate near it: people move below 20 Hz
SMOOTH_HZ = 6.0  # low-pass of rates and accelerations, in both directions (Winter 2009: 95 % of the power of gait is below 6 Hz)
DRIFT_HZ = 0.1
LEAST_S = 3.0
FAR_FROM_UP = 60.0 * RADIAN_PER_DEGREE
MEAN_UP = {"thigh": (0.5**0.5, 0.0, 0.5**0.5)}  # that of who sits and stands; else (0, 0, 1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WornReadings:
    """Readings of a worn device, with what a course depends on."""

    time: FloatArray  # (N,), s
    gyro: FloatArray  # (N, 3), rad/s, frame b
    accel: FloatArray  # (N, 3), m/s2, frame b
    matrix: FloatArray  # R_ab (3, 3)
    acc_s: float = ACC_S  # time constant by which the inclination follows the accelerometers
    offset_uncertainty: float = 0.0  # of the gyroscopes, rad/s: prior of the filter's bias
    averaged: int = 1  # readings in each sample


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """Motion of the segment."""

    time: FloatArray  # (N,), s, begins at 0
    pitch: FloatArray  # forward lean, rad
    roll: FloatArray  # to the right, rad
    rate: FloatArray  # (N, 3), axes a, low-pass, rad/s: rate[:, 1] flexes the trunk
    turning: FloatArray  # about the vertical, to the left, low-pass, rad/s
    up: FloatArray  # upward acceleration, low-pass, m/s2
    velocity: FloatArray  # upward, m/s
    force: FloatArray  # (N, 3), specific force, axes a, m/s2

    @property
    def step(self) -> float:
        """Time between samples, s."""
        return float(self.time[-1]) / (len(self.time) - 1)


def wear(record: Record, mounting: BodyMounting) -> WornReadings:
    """Return the readings of a corrected record, at a rate of people's motion."""
    whole = record.in_si()
    check_whole(whole)
    record = unpadded(whole)
    if record.accel is None or np.isnan(record.accel).any():
        raise InputError(
            "measure: wanted accelerometer readings without gaps, got none or gaps; map the columns that hold them"
        )
    if record.duration_s < LEAST_S:
        raise InputError(
            f"measure: wanted a recording of {LEAST_S:g} s or more, got {record.duration_s:.3g} s; record the whole task"
        )
    count = max(1, round(record.sample_rate_hz / MOST_HZ))
    stop = len(record) - len(record) % count
    parts = (np.asarray(one)[:stop] for one in (record.time, record.gyro, record.accel))
    time, gyro, accel = (one.reshape(stop // count, count, *one.shape[1:]).mean(axis=1) for one in parts)
    even = np.arange(time[0], time[-1] + 1e-9, (time[-1] - time[0]) / (len(time) - 1))
    if np.abs(np.diff(time) * (len(time) - 1) / (time[-1] - time[0]) - 1.0).max() > 0.1:
        gyro, accel = (np.stack([np.interp(even, time, axis) for axis in one.T], axis=1) for one in (gyro, accel))
        time = even
    worn = WornReadings(time=time, gyro=gyro, accel=accel, matrix=mounting.matrix, averaged=count)
    mean = mounting.matrix @ accel.mean(axis=0)
    up = np.array(MEAN_UP.get(mounting.place, (0.0, 0.0, 1.0)))
    off = float(np.arccos(np.clip(up @ mean / np.linalg.norm(mean), -1.0, 1.0)))
    if off > FAR_FROM_UP:
        axis = int(np.argmax(np.abs(felt := accel.mean(axis=0))))
        side = f"{'-' if felt[axis] < 0.0 else '+'}{'xyz'[axis]}"
        raise InputError(
            f"measure: wanted a device whose axis for up points up on average, got one {off / RADIAN_PER_DEGREE:.0f} deg off, "
            f"whose {side} is nearest to up; state its sides (`forward`, `up`), or find its mounting",
            off_deg=off / RADIAN_PER_DEGREE,
        )
    return worn


def follow(worn: WornReadings) -> Course:
    """Return the course of the segment."""
    gyro, force = worn.gyro @ worn.matrix.T, worn.accel @ worn.matrix.T
    record = Record(time=worn.time, gyro=gyro, accel=force)
    q, _ = filtered(record, gyro, worn.offset_uncertainty, magnetometer=False, acc_s=worn.acc_s)
    vertical = rotate(quaternion_conjugate(q), np.array([0.0, 0.0, 1.0]))
    rate_hz = record.sample_rate_hz
    upward = (force * vertical).sum(axis=1)
    up = smooth(upward - upward.mean(), SMOOTH_HZ, rate_hz)
    fall = np.concatenate(([0.0], np.cumsum(0.5 * (up[1:] + up[:-1])))) / rate_hz
    # A reading is the mean since the one before, as strapdown takes it: the rate at the sample, to the fourth order
    before, here, after, beyond = (np.pad(gyro, ((1, 2), (0, 0)), "edge")[k : k + len(gyro)] for k in range(4))
    middle = (7.0 * (here + after) - before - beyond) / 12.0
    return Course(
        time=worn.time - worn.time[0],
        pitch=np.arctan2(-vertical[:, 0], vertical[:, 2]),
        roll=np.arctan2(vertical[:, 1], vertical[:, 2]),
        rate=smooth(middle, SMOOTH_HZ, rate_hz),
        turning=smooth((middle * vertical).sum(axis=1), SMOOTH_HZ, rate_hz),
        up=up,
        velocity=smooth(fall, DRIFT_HZ, rate_hz, order=2, kind="highpass"),
        force=force,
    )


def smooth(
    x: FloatArray, cutoff_hz: float, rate_hz: float, *, order: int = 4, kind: Literal["lowpass", "highpass"] = "lowpass"
) -> FloatArray:
    """Return columns through a Butterworth of an order in all, half of it in each direction: no delay."""
    from scipy.signal import butter, sosfiltfilt

    sections = butter(order // 2, min(cutoff_hz / (0.5 * rate_hz), 0.95), kind, output="sos")
    pad = min(len(x) - 1, int(3.0 * rate_hz / cutoff_hz))
    return np.asarray(sosfiltfilt(sections, x, axis=0, padlen=pad))
