"""Motions and chains that the tests of the device share."""

import numpy as np

from undrift.sim.device.effects import Sampling, Scale, SensorChain
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import Simulated, simulate_device
from undrift.sim.motion.motion import Motion

INSTANT = Sampling(gyro_averaging="instant")


def motion_of(time: np.ndarray, rate: np.ndarray, force: np.ndarray | None = None, **more: object) -> Motion:
    """Return a motion with the given rates. Its orientation does not match the rates."""
    n = len(time)
    return Motion(
        time=time,
        q_nb=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        rate_b=rate,
        mean_rate_b=rate,
        force_b=np.tile([0.0, 0.0, 9.81], (n, 1)) if force is None else force,
        gravity_m_s2=9.81,
        moving=np.zeros(n),
        **more,  # type: ignore[arg-type]
    )


def still_motion(samples: int, sample_rate_hz: float = 100.0) -> Motion:
    """Return a device at rest, z up."""
    return motion_of(np.arange(samples) / sample_rate_hz, np.zeros((samples, 3)))


def chain(unit: str = "rad/s", sensitivity: float = 1.0, **effects: object) -> SensorChain:
    """Return sensors that are ideal but for the effects named."""
    scale = effects.pop("scale", None) or Scale(nominal_sensitivity=sensitivity)
    return SensorChain(unit=unit, scale=scale, **effects)  # type: ignore[arg-type]


def device_of(gyro: SensorChain | None = None, accel: SensorChain | None = None, **more: object) -> DeviceModel:
    """Return a device of two chains, sampled at the instants of the motion."""
    more = {"sampling": INSTANT, **more}
    return DeviceModel(serial="A", gyro=gyro or chain(), accel=accel or chain("m/s2"), **more)  # type: ignore[arg-type]


def run(device: DeviceModel, motion: Motion, seed: int = 1, **more: object) -> Simulated:
    """Return the output of the device, with a fixed seed."""
    return simulate_device(device, motion, rng=np.random.default_rng(seed), **more)  # type: ignore[arg-type]
