"""Effects switched off: a device and a bench without one kind of error, and with the draws of all the others.

What is switched off is zeroed and not removed, so that it takes as many random numbers as before::

    noise                  white noise of both triads and of the thermometer; with it the converter's steps, which nothing would
                           dither any more
    gyroscope offset       zero-rate output with its drift over temperature and time (warm-up, hysteresis, flicker, random walk)
                           and under force (g-sensitivity)
    accelerometer offset   the same of the accelerometers
    scale                  sensitivity and its change with temperature, gains of the chain; rate and servo of the table
    cross-axis             axes and crosstalk; faces, mounting, level and wobble of the bench
    dynamic drift          what grows with the rate: non-linearity, asymmetry, rate drift
    delay                  how late the readings are: nothing of the device, the truth is taken as late (``delay_of_pitch``)
    quantisation           steps of converter, thermometer and encoder
"""

from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np

from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.effects import SensorChain
from undrift.sim.device.model import DeviceModel

EffectName = Literal[
    "noise",
    "gyroscope offset",
    "accelerometer offset",
    "scale",
    "cross-axis",
    "dynamic drift",
    "delay",
    "quantisation",
]
EFFECTS: tuple[EffectName, ...] = get_args(EffectName)

FINER_BITS = 16  # a converter of so many bits more has no steps to speak of
_OFFSET: dict[str, tuple[str, ...]] = {
    "offset": ("constant", "per_k"),
    "g_sensitivity": ("matrix",),
    "warm_up": ("amplitude",),
    "hysteresis": ("amplitude",),
    "instability": ("instability",),
    "random_walk": ("bias_walk",),
}
_OF_TRIAD: dict[str, EffectName] = {"gyro": "gyroscope offset", "accel": "accelerometer offset"}
# Fields of each of a chain's effects
_ZEROED: dict[EffectName, dict[str, tuple[str, ...]]] = {
    "noise": {"white_noise": ("random_walk",)},
    "scale": {"scale": ("error",), "thermal_scale": ("per_k",)},
    "dynamic drift": {"nonlinearity": ("quadratic", "cubic", "asymmetry"), "rate_drift": ("coefficients",)},
}
_BENCH: dict[EffectName, tuple[str, ...]] = {
    "scale": ("table_rate", "servo"),
    "cross-axis": ("face_tilt", "mount_tilt", "level", "wobble"),
    "quantisation": ("encoder_lines",),
}


def device_without(device: DeviceModel, effect: EffectName) -> DeviceModel:
    """Return a device without one kind of error."""
    off: dict[str, Any] = {name: _chain_without(getattr(device, name), name, effect) for name in ("gyro", "accel")}
    thermometer = device.thermometer
    if effect == "noise":
        thermometer = replace(thermometer, noise_c=0.0)
    if effect == "quantisation":
        thermometer = replace(thermometer, step_c=0.0)
    return replace(device, **off, thermometer=thermometer)


def bench_without(errors: BenchErrors, effect: EffectName) -> BenchErrors:
    """Return a bench without one kind of error."""
    return replace(errors, **dict.fromkeys(_BENCH.get(effect, ()), 0))


def delay_of_pitch(device: DeviceModel, sample_rate_hz: float) -> float:
    """Return how late strapdown with a device's readings truly is about the axis of the pitch, s."""
    low_pass, sampling = device.gyro.low_pass, device.sampling
    late_s = 0.0 if low_pass is None else float(low_pass.group_delay_s[1])
    held_s = 0.5 / sample_rate_hz if sampling.gyro_averaging == "instant" else 0.0  # over the step before its stamp
    return late_s + float(sampling.gyro_delay_s[1]) - held_s


def _chain_without(chain: SensorChain, triad: str, effect: EffectName) -> SensorChain:
    off: dict[str, Any] = {}
    for name, fields in (_OFFSET if effect == _OF_TRIAD[triad] else _ZEROED.get(effect, {})).items():
        if (held := getattr(chain, name)) is not None:
            off[name] = replace(held, **{field: np.zeros_like(getattr(held, field)) for field in fields})
    if effect == "cross-axis":
        off["scale"] = replace(chain.scale, axes=np.eye(3), cross_axis=np.zeros((3, 3)))
    if effect in ("noise", "quantisation") and chain.adc is not None:
        off["adc"] = replace(chain.adc, bits=chain.adc.bits + FINER_BITS)
    return replace(chain, **off)
