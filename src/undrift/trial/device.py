"""A device as the kernel of trials takes it: the effects that it knows, as numbers in a row."""

import math
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.sim.device.chain import SensorChain
from undrift.sim.device.low_pass import difference_equation
from undrift.sim.device.model import DeviceModel

UNKNOWN = ("nonlinearity", "g_sensitivity", "warm_up", "hysteresis", "instability", "lever_arm")


def trial_device(device: DeviceModel) -> DeviceModel:
    """Return a device with those effects alone that the kernel of trials knows.

    Parameters
    ----------
    device : DeviceModel
        Any device.

    Returns
    -------
    DeviceModel
        Without non-linearity, g-sensitivity, warm-up, hysteresis, flicker, lever arm and noise of the thermometer.
    """
    return replace(
        device,
        gyro=replace(
            device.gyro,
            nonlinearity=None,
            g_sensitivity=None,
            warm_up=None,
            hysteresis=None,
            instability=None,
            lever_arm=None,
        ),
        thermometer=replace(device.thermometer, noise_c=0.0),
    )


def device_parameters(device: DeviceModel, step_s: float) -> FloatArray:
    """Return the parameters of a device, three to a field, in the order of ``kernels/trial.py``.

    Parameters
    ----------
    device : DeviceModel
        Effects that the kernel knows.
    step_s : float
        Sample period, s.

    Returns
    -------
    array, shape (111,)
        Those of trial and correction left at zero.

    Raises
    ------
    InputError
        An effect that the kernel does not know.
    """
    chain, clock, thermometer = device.gyro, device.sampling, device.thermometer
    for name in UNKNOWN:
        if getattr(chain, name) is not None:
            raise InputError(
                f"trials: wanted effects that the kernel knows, got {name}; use trial_device or simulate_device"
            )
    if not clock.on_grid or thermometer.noise_c > 0.0 or thermometer.rounding != "nearest":
        raise InputError(
            "trials: wanted readings at the samples of the motion and a thermometer without noise that rounds to nearest, got "
            "others; use simulate_device"
        )
    p = np.zeros((37, 3))
    p[:4] = _thermal(chain)
    p[4:10] = _rate_drift(chain)
    p[10] = chain.white_noise.random_walk / math.sqrt(step_s) if chain.white_noise else 0.0
    p[11] = chain.random_walk.bias_walk * math.sqrt(step_s) if chain.random_walk else 0.0
    p[12:14] = _rails(chain)
    p[14] = 1.0
    if chain.low_pass:
        for axis in range(3):
            b, a = difference_equation(
                float(chain.low_pass.cutoff_hz[axis]), float(chain.low_pass.quality[axis]), step_s
            )
            p[14:19, axis] = *b, *a[1:]
    p[19:24] = _converter(chain)
    p[24:27] = chain.scale.matrix
    p[31, 2] = device.reference_temp_c
    p[32:35] = _thermometer(device, step_s)
    return p.ravel()


def _thermal(chain: SensorChain) -> FloatArray:
    found = np.zeros((4, 3))
    offset = chain.offset.per_k if chain.offset else np.zeros((0, 3))
    scale = chain.thermal_scale.per_k if chain.thermal_scale else np.zeros((0, 3))
    if len(offset) > 2 or len(scale) > 1:
        raise InputError(
            f"trials: wanted an offset of at most 2 powers of temperature and a scale of 1, got {len(offset)} and {len(scale)}; "
            "use simulate_device"
        )
    if chain.offset:
        found[0] = chain.offset.constant
    found[1 : 1 + len(offset)], found[3 : 3 + len(scale)] = offset, scale
    return found


def _rate_drift(chain: SensorChain) -> FloatArray:
    found = np.zeros((3, 2, 3))
    if chain.rate_drift:
        powers = chain.rate_drift.coefficients
        if powers.shape[0] > 3 or powers.shape[1] > 2:
            raise InputError(
                f"trials: wanted a rate drift of at most 3 powers of rate and 2 of warmth, got {powers.shape[:2]}; "
                "use simulate_device"
            )
        found[: powers.shape[0], : powers.shape[1]] = powers
    return found.reshape(6, 3)


def _rails(chain: SensorChain) -> FloatArray:
    amplifier = chain.amplifier
    if amplifier is None:
        return np.array([[-math.inf], [math.inf]])
    total = amplifier.gain * chain.scale.nominal_sensitivity
    return np.array([[(amplifier.low - amplifier.null) / total], [(amplifier.high - amplifier.null) / total]])


def _converter(chain: SensorChain) -> FloatArray:
    """Return gain and null in steps, the codes' limits, and how it rounds: 0 not, 1 to nearest, 2 down. One step is 1 code."""
    sensitivity = chain.scale.nominal_sensitivity * (chain.amplifier.gain if chain.amplifier else 1.0)
    null = chain.amplifier.null if chain.amplifier else 0.0
    if chain.adc is None:
        return np.array([[sensitivity], [null], [-math.inf], [math.inf], [0.0]])
    if chain.adc.rounding == "toward_zero" or chain.adc.inl_lsb.any() or not chain.adc.codes:
        raise InputError(
            "trials: wanted a straight converter that gives codes, to nearest or down, got another; use simulate_device"
        )
    step, (low, high) = chain.adc.step, chain.adc.code_limits
    how = 1.0 if chain.adc.rounding == "nearest" else 2.0
    return np.array([[sensitivity / step], [null / step], [low], [high], [how]])


def _thermometer(device: DeviceModel, step_s: float) -> FloatArray:
    t = device.thermometer
    keep, mean = 0.0, 0.0
    if t.lag_s > 0.0:
        keep = math.exp(-step_s / t.lag_s)
        mean = -math.expm1(-step_s / t.lag_s) / (step_s / t.lag_s)
    inverse = 1.0 / t.step_c if t.step_c > 0.0 else 0.0
    return np.array(
        [
            [keep, 1.0 - mean, mean - keep],
            [t.self_heating_c, t.trim_error_c, t.slope_error],
            [t.step_c, inverse, t.zero_c],
        ]
    )
