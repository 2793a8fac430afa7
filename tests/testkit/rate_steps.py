"""Rate steps at several soaks: measured with a device on a table in a chamber, and computed directly."""

from dataclasses import replace

import numpy as np

from testkit.rest_blocks import rest_blocks
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.sim.device.effects import SensorChain
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion

GRID = np.radians(np.arange(5, 91, 5))  # rates of the note's sit-to-stand task, in one direction
SOAKS = np.concatenate((np.arange(18.0, 75.0, 5.0), [75.0]))
GRAVITY = 9.80665


def soaked(
    device: DeviceModel, motion: Motion, temps: np.ndarray, rng: np.random.Generator
) -> tuple[RateSteps, RestBlocks]:
    """Return the results of a settled device at each soak, by its own thermometer."""
    steps, rests = [], []
    for soak, temp in enumerate(temps):
        record = simulate_device(device, motion, rng=rng, temp_c=float(temp), power_on_s=7200.0).record
        for turn in motion.turns:
            axis = "xyz".index(turn.axis)
            rate = turn.turn_rate * np.eye(3)[axis]
            steps.append((soak, rate, *_mean(record, turn.start + 50, turn.stop)))
        rests += [(soak, k, *_mean(record, s.start + 50, s.stop)) for k, s in enumerate(motion.stills)]
    n, m = len(steps), len(rests)
    result = RateSteps(
        session=np.zeros(n, int),
        soak=np.array([s[0] for s in steps]),
        rate_b=np.array([s[1] for s in steps]),
        temp_c=np.array([s[2] for s in steps]),
        gyro=np.array([s[3] for s in steps]),
        gyro_variance=np.array([s[5] for s in steps]),
    )
    _, pose, temp_c, gyro, accel, variance = (np.array(column) for column in zip(*rests, strict=True))
    blocks = rest_blocks(temp_c, gyro, accel=accel, noise=1e-2, time=np.arange(m, dtype=float), pose=pose)
    return result, replace(blocks, power_on_s=np.full(m, 7200.0), gyro_variance=variance)


def _mean(record, start: int, stop: int, block: int = 25):
    gyro = record.gyro[start:stop]
    whole = gyro[: len(gyro) // block * block].reshape(-1, block, 3).mean(axis=1)
    variance = whole.var(axis=0, ddof=1) / len(whole)
    return record.temp_c[start:stop].mean(), gyro.mean(axis=0), record.accel[start:stop].mean(axis=0), variance


def reading(
    chain: SensorChain, rate_b: np.ndarray, warmth: np.ndarray, force_b: np.ndarray | None = None
) -> np.ndarray:
    """Return the noise-free mean readings of a settled device, raw unit."""
    x = rate_b @ chain.scale.matrix.T
    x = chain.nonlinearity.bent(x) if chain.nonlinearity else x
    if chain.g_sensitivity and force_b is not None:
        x = x + force_b @ chain.g_sensitivity.matrix.T
    if chain.offset:
        x = x + chain.offset.at(warmth)
    if chain.thermal_scale:
        x = x * chain.thermal_scale.factor(warmth)
    if chain.rate_drift:
        x = x + chain.rate_drift.error(x, warmth)
    return chain.null + chain.gain * x


def computed(
    device: DeviceModel,
    temps: np.ndarray,
    rng: np.random.Generator,
    *,
    rates: np.ndarray = GRID,
    noise_dps: float = 0.005,
    axes: tuple[int, ...] = (0, 1, 2),
) -> RateSteps:
    """Return rate steps both ways at each soak by arithmetic, with white noise on the means."""
    signed = np.concatenate((-rates[::-1], rates))
    rate = np.concatenate([signed[:, None] * np.eye(3)[axis] for axis in axes])
    force = np.concatenate([np.tile(GRAVITY * np.eye(3)[axis], (len(signed), 1)) for axis in axes])
    n, sigma = len(rate) * len(temps), np.radians(noise_dps) * device.gyro.gain
    temp = np.repeat(temps, len(rate))
    rate, force = np.tile(rate, (len(temps), 1)), np.tile(force, (len(temps), 1))
    warmth = temp - device.reference_temp_c
    return RateSteps(
        session=np.zeros(n, int),
        soak=np.repeat(np.arange(len(temps)), n // len(temps)),
        temp_c=temp,
        rate_b=rate,
        gyro=reading(device.gyro, rate, warmth, force) + rng.normal(0.0, sigma, (n, 3)),
        gyro_variance=np.full((n, 3), sigma**2),
    )
