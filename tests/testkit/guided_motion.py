"""A device that a person turns by axes and faces according to a guide: forward equations for tests only."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from undrift.record import Record

GRAVITY = 9.80665
RATE_HZ = 100.0


@dataclass(frozen=True)
class TurnedDevice:
    """readings = K x + offset + noise, of gyroscopes and accelerometers."""

    gyro: np.ndarray
    accel: np.ndarray
    gyro_offset: np.ndarray
    accel_offset: np.ndarray


def drawn_device(rng: np.random.Generator) -> TurnedDevice:
    """Scales off by 1.5 and 1 %, cross-axis terms of 2 and 1 mrad, offsets of 0.6 deg/s and 0.2 m/s2, one sigma."""
    scale, cross = (0.015, 0.01), (0.002, 0.001)
    gyro, accel = (
        np.eye(3) + np.diag(rng.normal(0.0, a, 3)) + rng.normal(0.0, b, (3, 3))
        for a, b in zip(scale, cross, strict=True)
    )
    return TurnedDevice(gyro, accel, rng.normal(0.0, 0.01, 3), rng.normal(0.0, 0.2, 3))


def guided_rates(rng: np.random.Generator, rounds: int) -> np.ndarray:
    """Return body rates (N, 3), rad/s: a rest, then rounds of full turns in both directions about level axes, with
    rests on faces.
    """
    pieces = [np.zeros((round(5.0 * RATE_HZ), 3))]

    def move(axis: int, angle: float, seconds: float) -> None:
        s = np.arange(round(seconds * RATE_HZ)) / round(seconds * RATE_HZ)
        rate = np.zeros((len(s), 3))
        rate[:, axis] = angle / seconds * (1.0 - np.cos(2.0 * np.pi * s))
        pieces.append(rate)

    for _ in range(rounds):
        pace = rng.uniform(4.0, 6.0)
        for axis in rng.permutation(3):
            if axis == 2:  # it is upright: level it first
                move(0, 0.5 * np.pi, 2.0)
            move(axis, 2.0 * np.pi, pace)
            move(axis, -2.0 * np.pi, pace)
            if axis == 2:
                move(0, -0.5 * np.pi, 2.0)
        for axis in rng.permutation(2):
            for _ in range(4):
                move(axis, 0.5 * np.pi, 1.5)
                pieces.append(np.zeros((round(rng.uniform(2.0, 3.0) * RATE_HZ), 3)))
    return np.concatenate(pieces)


@cache
def guided_recording(seed: int, rounds: int = 3) -> tuple[Record, TurnedDevice]:
    """Return the readings of a device turned in this way, with a tremor of 6 deg/s and 3 cm, and its true parameters."""
    rng = np.random.default_rng(seed)
    device, rate = drawn_device(rng), guided_rates(rng, rounds)
    time = np.arange(len(rate)) / RATE_HZ
    held = np.clip(time - 5.0, 0.0, 1.0)[:, None]  # a second after the rest

    def waves(low_hz: float, high_hz: float, size: float, derivatives: int) -> np.ndarray:
        pulse = 2.0 * np.pi * rng.uniform(low_hz, high_hz, (8, 3))
        angle = pulse * time[:, None, None] + rng.uniform(0.0, 2.0 * np.pi, (8, 3))
        return held * (-0.5 * size * (1j * pulse) ** derivatives * np.exp(1j * angle)).sum(axis=1).imag

    rate = rate + waves(0.1, 1.0, 0.1, 0)
    middle = 0.5 * (rate + np.vstack((rate[:1], rate[:-1])))
    turned, orientation = Rotation.identity(), np.empty((len(time), 4))
    for k, step in enumerate(Rotation.from_rotvec(middle / RATE_HZ)):
        turned = turned * step
        orientation[k] = turned.as_quat()
    force = Rotation.from_quat(orientation).inv().apply(waves(0.2, 1.0, 0.03, 2) + np.array([0.0, 0.0, GRAVITY]))
    gyro = rate @ device.gyro.T + device.gyro_offset + rng.normal(0.0, 0.001, rate.shape)
    accel = force @ device.accel.T + device.accel_offset + rng.normal(0.0, 0.02, rate.shape)
    return Record(time=time, gyro=gyro, accel=accel), device
