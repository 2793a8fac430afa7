"""A device turned by hand between two rests, and its optical poses: forward equations for tests only."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from undrift.frames import quaternion_product
from undrift.record import Record, Reference

FINE_HZ = 2000.0
GRAVITY = 9.81


@dataclass(frozen=True)
class Device:
    """u = K (w + G f) + offset + noise, delayed by lag_s, with K and offset in the unit of the readings."""

    forward: np.ndarray = None
    offset: np.ndarray = None
    motion_offset: np.ndarray = None
    g_sensitivity: np.ndarray = None
    lag_s: float = 0.0
    noise: float = 0.0
    unit: str = "rad/s"


def turning_rate(t, rng, *, rest_s, turn_s, speed):
    """Smooth body rate, rad/s, zero in the first and last rest_s."""
    f = rng.uniform(0.15, 0.9, (3, 6))
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 6))
    size = rng.uniform(0.4, 1.0, (3, 6)) * speed
    w = (size[:, :, None] * np.sin(2.0 * np.pi * f[:, :, None] * t + phase[:, :, None])).sum(axis=1).T
    rise = np.clip(np.minimum(t - rest_s, rest_s + turn_s - t) / 1.0, 0.0, 1.0)
    return w * (rise * rise * (3.0 - 2.0 * rise))[:, None]


def make_recording(
    rng,
    device=None,
    *,
    sample_rate_hz=200.0,
    optics_hz=100.0,
    rest_s=8.0,
    turn_s=60.0,
    speed=0.6,
    optics_noise=0.0,
    mounting=None,
    mark=True,
    tilt=0.3,
    planar=False,
    pauses=False,
):
    """Return the record of a device and the reference that cameras saw, optics on the true clock."""
    device = device or Device()
    total = 2.0 * rest_s + turn_s
    fine = np.arange(round((total + 1.0) * FINE_HZ)) / FINE_HZ
    w = turning_rate(fine, rng, rest_s=rest_s, turn_s=turn_s, speed=speed) * ((1.0, 1.0, 0.0) if planar else 1.0)
    gate = np.ones(len(fine))
    if pauses:  # 6 s of turning, 4 s of rest, with half a second from one to the other
        place = np.mod(fine - rest_s, 10.0)
        gate = np.clip(np.minimum(place, 6.0 - place) / 0.5, 0.0, 1.0)
        w = w * gate[:, None]
    middle = 0.5 * (w + np.concatenate((w[1:], w[-1:])))
    steps = Rotation.from_rotvec(middle / FINE_HZ)
    start = Rotation.from_euler("xyz", (tilt, -0.5 * tilt, 0.7)).as_quat(scalar_first=True)
    q = running_product(np.vstack((start, steps.as_quat(scalar_first=True)[:-1])))
    turned = Rotation.from_quat(q, scalar_first=True)
    force = turned.inv().apply((0.0, 0.0, GRAVITY))
    t = np.arange(round(total * sample_rate_hz)) / sample_rate_hz
    true = np.clip(t - device.lag_s, 0.0, fine[-1])
    rate = np.stack([np.interp(true, fine, w[:, i]) for i in range(3)], axis=1)
    f = np.stack([np.interp(true, fine, force[:, i]) for i in range(3)], axis=1)
    k = np.eye(3) if device.forward is None else device.forward
    g = np.zeros((3, 3)) if device.g_sensitivity is None else device.g_sensitivity
    moving = ((true >= rest_s) & (true < rest_s + turn_s) & (np.interp(true, fine, gate) > 0.0)).astype(float)
    gyro = (rate + f @ g.T) @ k.T + device.noise * rng.normal(size=rate.shape)
    if device.offset is not None:
        gyro = gyro + device.offset
    if device.motion_offset is not None:
        gyro = gyro + moving[:, None] * device.motion_offset
    record = Record(time=t, gyro=gyro, accel=f, gyro_unit=device.unit)
    every = round(FINE_HZ / optics_hz)
    seen = turned[::every]
    if mounting is not None:
        seen = seen * mounting.inv()
    if optics_noise:
        seen = seen * Rotation.from_rotvec(optics_noise * rng.normal(size=(len(fine[::every]), 3)))
    at = fine[::every]
    at, seen = at[at <= total], seen[at <= total]
    reference = Reference(
        time=at,
        q_nb=seen.as_quat(scalar_first=True),
        moving=((at >= rest_s) & (at < rest_s + turn_s)).astype(float) if mark else None,
        name="turned by hand",
    )
    return record, reference


def running_product(q):
    """Product of all quaternions up to each: many short runs side by side, then from run to run."""
    n = len(q)
    width = round(np.sqrt(n))
    runs = np.vstack((q, np.tile((1.0, 0.0, 0.0, 0.0), (-n % width, 1)))).reshape(-1, width, 4)
    for k in range(1, width):
        runs[:, k] = quaternion_product(runs[:, k - 1], runs[:, k])
    for k in range(1, len(runs)):
        runs[k] = quaternion_product(runs[k - 1, -1], runs[k])
    return runs.reshape(-1, 4)[:n]


def hidden(reference, start_s, stop_s):
    """The reference with nothing seen from start_s to stop_s."""
    q = np.array(reference.q_nb)
    q[(reference.time >= start_s) & (reference.time < stop_s)] = np.nan
    return replace(reference, q_nb=q)


def later(reference, shift_s):
    """The reference on a clock that shows shift_s more."""
    return replace(reference, time=reference.time + shift_s)


def upsampled(reference, sample_rate_hz):
    """The reference drawn on great arcs between its frames, at another rate."""
    n = int((reference.time[-1] - reference.time[0]) * sample_rate_hz)
    t = reference.time[0] + 0.37 / sample_rate_hz + np.arange(n - 1) / sample_rate_hz
    q = Slerp(reference.time, Rotation.from_quat(reference.q_nb, scalar_first=True))(t)
    return Reference(time=t, q_nb=q.as_quat(scalar_first=True), name=reference.name)
