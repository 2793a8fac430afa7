"""A device held by hand in a series of poses, with tremor and sway: forward equations for tests only."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from undrift.record import Record

GRAVITY = 9.81
FINE_HZ = 200.0


@dataclass(frozen=True)
class Tremor:
    """Motion of a hand that holds a pose, rms of three axes together."""

    rate_dps: float  # tremor of 7 to 11 Hz
    sway_deg: float  # slow turning of 0.1 to 0.5 Hz
    accel: float  # tremor of 7 to 11 Hz, m/s2


def hand_waves(rng, t, low_hz, high_hz):
    """Sum of twelve sines for each axis with rms 1 over the three axes, and its derivative."""
    f = rng.uniform(low_hz, high_hz, (12, 3))
    phase = rng.uniform(0.0, 2.0 * np.pi, (12, 3))
    size = np.sqrt(2.0 / 36.0)
    angle = 2.0 * np.pi * f * t[:, None, None] + phase
    return size * np.sin(angle).sum(axis=1), size * (2.0 * np.pi * f * np.cos(angle)).sum(axis=1)


def hand_held_log(rng, tremor, *, poses=10, hold_s=(3.0, 7.0), move_s=(0.8, 1.6), sample_rate_hz=100.0, clock=1.0):
    """Return the record (rad/s, m/s2, with time times ``clock``) and the stretches (poses, 2), s, in which each pose is
    held.
    """
    holds, moves = rng.uniform(*hold_s, poses), rng.uniform(*move_s, poses - 1)
    # Axes that lie all around: a spiral on the sphere, the device turned about them at random.
    z = 1.0 - 2.0 * (np.arange(poses) + 0.5) / poses
    azimuth = np.arange(poses) * np.pi * (3.0 - np.sqrt(5.0))
    ring = np.sqrt(1.0 - z**2)
    up = rng.permutation(np.column_stack((ring * np.cos(azimuth), ring * np.sin(azimuth), z)))
    values = [Rotation.align_vectors([[0.0, 0.0, 1.0]], [item])[0] for item in up]
    ends = np.cumsum(np.concatenate(([holds[0]], np.column_stack((moves, holds[1:])).ravel())))
    starts = np.concatenate(([0.0], ends[1::2]))
    spans = np.column_stack((starts, ends[::2]))
    t = np.arange(round(ends[-1] * FINE_HZ)) / FINE_HZ
    knots, turned = [0.0], [values[0]]
    for k, (start, stop) in enumerate(spans):
        knots += [start, stop] if k else [stop]
        turned += [values[k]] * (2 if k else 1)
    steps = np.searchsorted(knots, t, side="right") - 1
    fraction = np.clip((t - np.take(knots, steps)) / np.diff(knots)[np.minimum(steps, len(knots) - 2)], 0.0, 1.0)
    smooth = np.take(knots, steps) + np.diff(knots)[np.minimum(steps, len(knots) - 2)] * (
        10.0 * fraction**3 - 15.0 * fraction**4 + 6.0 * fraction**5
    )
    path = Slerp(knots, Rotation.concatenate(turned))(np.minimum(smooth, knots[-1]))
    fast, fast_rate = hand_waves(rng, t, 7.0, 11.0)
    slow, _ = hand_waves(rng, t, 0.1, 0.5)
    shake, _ = hand_waves(rng, t, 7.0, 11.0)
    fast *= np.radians(tremor.rate_dps) / np.sqrt((fast_rate**2).sum(axis=1).mean())
    body = path * Rotation.from_rotvec(fast + np.radians(tremor.sway_deg) * slow)
    rate = (body[:-1].inv() * body[1:]).as_rotvec() * FINE_HZ
    force = body.inv().apply([0.0, 0.0, GRAVITY]) + tremor.accel * shake
    step = round(FINE_HZ / sample_rate_hz)
    rate, force = rate[::step], force[:-1:step]
    return Record(
        time=np.arange(len(rate)) / sample_rate_hz * clock,
        gyro=rate + 0.01 + 0.002 * rng.standard_normal(rate.shape),
        accel=force + 0.02 * rng.standard_normal(force.shape),
    ), spans * clock
