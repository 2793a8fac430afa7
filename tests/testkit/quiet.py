"""A simulated device without noise."""

from dataclasses import replace

from undrift.sim.device.effects import Amplifier, SensorChain
from undrift.sim.device.model import DeviceModel


def without_noise(device: DeviceModel) -> DeviceModel:
    """Return the same device without noise, jitter, rounding and range limits."""
    return replace(
        device,
        gyro=_quiet(device.gyro),
        accel=_quiet(device.accel),
        thermometer=replace(device.thermometer, noise_c=0.0, step_c=0.0),
        sampling=replace(device.sampling, jitter_s=0.0),
    )


def _quiet(chain: SensorChain) -> SensorChain:
    """Return the same sensors with one gain in place of amplifier and converter: the unit of the reading does not change."""
    free = Amplifier(gain=chain.gain / chain.scale.nominal_sensitivity, null=chain.null)
    quiet = dict.fromkeys(("white_noise", "instability", "random_walk", "adc"))
    return replace(chain, **quiet, amplifier=free if chain.amplifier or chain.adc else None)
