"""The twin as a device that ``sim`` can simulate, and draws of it within its uncertainty."""

from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.adc import Adc
from undrift.sim.device.chain import SensorChain
from undrift.sim.device.lever_arm import LeverArm
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.noise import WhiteNoise
from undrift.sim.device.offset import Offset
from undrift.sim.device.sampling import Sampling
from undrift.sim.device.scale import Scale
from undrift.twin.fit import Twin
from undrift.twin.rest import RestNoise

_BITS = 16


def device_of(twin: Twin, *, sample_rate_hz: float, serial: str = "") -> DeviceModel:
    """Return the fitted device for simulation.

    A reading in the simulation is taken at its stamp plus a delay, so the delays found enter with their sign turned; a
    gyroscope reading is the mean since the sample before, which is half a step of its delay.

    Parameters
    ----------
    twin : Twin
        Fitted parameters.
    sample_rate_hz : float
        Of the real device, Hz.
    serial : str
        Name of the device.

    Returns
    -------
    DeviceModel
        Readings in rad/s and m/s2. An accelerometer that was not fitted is ideal.
    """
    model, half = twin.gyro.triad.model, 0.5 / sample_rate_hz
    gyro = chain_of(model.matrix, model.offset, twin.gyro_noise, "rad/s")
    if twin.adc is not None and twin.adc.gyro_lsb is not None:
        step = float(np.mean(twin.adc.gyro_lsb))
        reference = step * 2.0 ** (_BITS - 1)
        gyro = replace(gyro, adc=Adc(bits=_BITS, reference=reference, rounding=twin.adc.gyro_rounding, codes=False))
    accel, late = SensorChain(unit="m/s2", scale=Scale(nominal_sensitivity=1.0)), twin.delay
    if twin.accel is not None:
        late = twin.delay + twin.accel.delay
        accel = chain_of(twin.accel.model.matrix, twin.accel.model.offset, twin.accel_noise, "m/s2")
        accel = replace(accel, lever_arm=LeverArm(arms=np.tile(twin.accel.lever_arm, (3, 1))))
    return DeviceModel(
        serial=serial,
        gyro=gyro,
        accel=accel,
        sampling=Sampling(
            sample_rate_hz=sample_rate_hz,
            gyro_delay_s=np.full(3, half - twin.delay),
            accel_delay_s=np.full(3, -late),
        ),
        name="twin",
        source_tag="fitted",
    )


def drawn_gyro(device: DeviceModel, twin: Twin, rng: np.random.Generator) -> DeviceModel:
    """Return a device with gyroscope matrix and in-motion offset drawn from the twin's uncertainty.

    Parameters
    ----------
    device : DeviceModel
        As ``device_of`` gives it.
    twin : Twin
        With covariance.
    rng : Generator
        Draws.

    Returns
    -------
    DeviceModel
        Another device that the recordings do not tell from the first.
    """
    model = twin.gyro.triad.model
    spread = model.covariance[:12, :12].copy()
    wander = twin.settings.motion_offset_spread**2
    spread[range(9, 12), range(9, 12)] += wander
    step = rng.multivariate_normal(np.zeros(12), spread, method="eigh")
    chain = chain_of(model.matrix + step[:9].reshape(3, 3), model.offset + step[9:], None, "rad/s")
    return replace(device, gyro=replace(device.gyro, scale=chain.scale, offset=chain.offset))


def with_offset(device: DeviceModel, offset: FloatArray) -> DeviceModel:
    """Return a device with another offset of the gyroscopes.

    Parameters
    ----------
    device : DeviceModel
        The device.
    offset : array, shape (3,)
        rad/s.

    Returns
    -------
    DeviceModel
        The same otherwise.
    """
    return replace(device, gyro=replace(device.gyro, offset=Offset(constant=offset)))


def chain_of(matrix: FloatArray, offset: FloatArray, noise: RestNoise | None, unit: str) -> SensorChain:
    """Return the chain whose readings a correction matrix and offset undo.

    Parameters
    ----------
    matrix : array, shape (3, 3)
        Corrected = matrix (reading - offset).
    offset : array, shape (3,)
        Unit of the reading.
    noise : RestNoise or None
        White noise.
    unit : str
        Of the reading: rad/s or m/s2.

    Returns
    -------
    SensorChain
        Scale, axes, offset and noise.
    """
    forward = np.linalg.inv(matrix)
    gain = np.linalg.norm(forward, axis=1)
    return SensorChain(
        unit=unit,
        scale=Scale(nominal_sensitivity=1.0, error=gain - 1.0, axes=forward / gain[:, None]),
        offset=Offset(constant=offset),
        white_noise=None if noise is None else WhiteNoise(random_walk=noise.random_walk),
    )
