"""Offset of a real device over temperature, from a recording at rest while its board warms or cools; added to a device to simulate.

    b(T) = c_0 + c_1 D + c_2 D^2 + c_3 D^3,   D = T - T_ref     least squares over means of 10 s, each axis by itself

One pose cannot tell an accelerometer's offset from its scale: what changes there is taken for offset. The offset at the reference
temperature stays the device's own. A thermometer that lags behind the sensors is not seen in one ramp.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.record import Record
from undrift.sim.device.effects import Offset, SensorChain, Thermometer
from undrift.sim.device.model import DeviceModel

BLOCK_S = 10.0
DEGREE = 3
LEAST_SPAN_K = 5.0
SAME_C = 1e-6  # readings nearer than that are one step


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WarmUpFit:
    """What a recording at rest shows of offsets over temperature."""

    range_c: tuple[float, float]  # Of the means, degC
    gyro_per_k: FloatArray  # (3, 3), coefficient of D, D^2, D^3 in a row each, rad/s per K to that power
    accel_per_k: FloatArray  # As above, m/s2
    gyro_residual: FloatArray  # (3,), standard deviation of what is left, rad/s
    accel_residual: FloatArray  # As above, m/s2
    thermometer: Thermometer  # Noise and step of its column
    reference_c: float  # T_ref, degC


def fit_warm_up(record: Record, *, reference_c: float) -> WarmUpFit:
    """Fit offsets over temperature to a recording at rest."""
    held = record.in_units("rad/s", "m/s2")
    temp_c, gyro, accel = held.temp_c, held.gyro, held.accel
    if temp_c is None or gyro is None or accel is None:
        raise InputError(
            "warm-up: wanted gyroscopes, accelerometers and temperature, got a recording without one of them"
        )
    columns = np.column_stack((temp_c, gyro, accel))
    whole = np.isfinite(columns).all(axis=1)
    block = ((held.time - held.time[0]) // BLOCK_S).astype(np.int64)
    whole &= block < block[-1]  # the last one is not whole
    counts = np.bincount(block[whole])
    sums = np.stack([np.bincount(block[whole], weights=column) for column in columns[whole].T], axis=1)
    means = sums[counts > 0] / counts[counts > 0, None]
    temp = means[:, 0]
    if len(means) <= DEGREE + 1 or float(np.ptp(temp)) < LEAST_SPAN_K:
        raise InputError(
            f"warm-up: wanted {LEAST_SPAN_K:g} K or more over {DEGREE + 2} blocks of {BLOCK_S:g} s or more, got "
            f"{np.ptp(temp):.1f} K over {len(means)}; record from a cold start"
        )
    design = np.vander(temp - reference_c, DEGREE + 1, increasing=True)
    found, *_ = np.linalg.lstsq(design, means[:, 1:], rcond=None)
    left = np.sqrt(np.square(means[:, 1:] - design @ found).sum(axis=0) / (len(means) - DEGREE - 1))
    return WarmUpFit(
        range_c=(float(temp.min()), float(temp.max())),
        gyro_per_k=found[1:, :3],
        accel_per_k=found[1:, 3:],
        gyro_residual=left[:3],
        accel_residual=left[3:],
        thermometer=_thermometer(temp_c[np.isfinite(temp_c)]),
        reference_c=reference_c,
    )


def _thermometer(temp_c: FloatArray) -> Thermometer:
    """Return a thermometer with the noise and the step of a column (N,), degC."""
    steps, noise = np.diff(np.unique(temp_c)), float(np.std(np.diff(temp_c)) / np.sqrt(2.0))
    return Thermometer(noise_c=noise, step_c=float(steps[steps > SAME_C].min(initial=np.inf)))


def with_warm_up(device: DeviceModel, found: WarmUpFit) -> DeviceModel:
    """Return a device whose offsets change with temperature as was found."""

    def drifting(chain: SensorChain, per_k: FloatArray) -> SensorChain:
        return replace(chain, offset=replace(chain.offset or Offset(), per_k=per_k))

    return replace(
        device,
        gyro=drifting(device.gyro, found.gyro_per_k),
        accel=drifting(device.accel, found.accel_per_k),
        thermometer=found.thermometer,
        reference_temp_c=found.reference_c,
    )
