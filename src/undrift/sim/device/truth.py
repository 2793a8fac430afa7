"""True and nominal calibrations of a simulated device, for comparison with estimates."""

from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.model import (
    MATRIX_NAMES,
    OFFSET_NAMES,
    AdcModel,
    Calibration,
    DriftTables,
    DynamicDrift,
    Rounding,
    ScaleDrift,
    StaticDrift,
    TriadModel,
)
from undrift.sim.device.effects import SensorChain
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import Grade, typical_device
from undrift.units import STANDARD_GRAVITY


def true_calibration(device: DeviceModel, *, temp_c: float | None = None) -> Calibration:
    """Return the exact calibration of the linear part of a settled device at a temperature.

    With k(T) the thermal scale, C the scale's matrix and S the gain: ``matrix = (S diag(1 + k) C)^-1``,
    ``offset = null + S (1 + k) o(T)``. The g-sensitivity is multiplied by the same matrix.
    """
    temp = device.reference_temp_c if temp_c is None else temp_c
    warmth = temp - device.reference_temp_c
    return Calibration(
        device=device.serial,
        reference_temp_c=temp,
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=_model(device.gyro, warmth, "rad/s"),
        accel=_model(device.accel, warmth, "m/s2"),
        adc=_adc(device),
    )


def true_tables(device: DeviceModel, temp_c: FloatArray, turn_rate: FloatArray) -> DriftTables:
    """Return the exact tables of a settled device, at nodes temp_c (n,), degC, and turn_rate (k,), rad/s."""
    models = [
        (_model(device.gyro, t, "rad/s"), _model(device.accel, t, "m/s2")) for t in temp_c - device.reference_temp_c
    ]
    reach = 1.2 * turn_rate[[0, -1]]
    true = np.linspace(reach[0], reach[1], 20 * len(turn_rate))
    error = np.empty((len(temp_c), len(turn_rate), 3))
    for k, temp in enumerate(temp_c):
        for axis in range(3):
            measured = _measured(device.gyro, true, axis, float(temp) - device.reference_temp_c)
            error[k, :, axis] = np.interp(turn_rate, measured, measured - true)
    return DriftTables(
        static=StaticDrift(
            temp_c=temp_c,
            gyro_offset=np.array([gyro.offset for gyro, _ in models]),
            accel_offset=np.array([accel.offset for _, accel in models]),
        ),
        scale=ScaleDrift(
            temp_c=temp_c,
            gyro_matrix=np.array([gyro.matrix for gyro, _ in models]),
            accel_matrix=np.array([accel.matrix for _, accel in models]),
        ),
        dynamic=DynamicDrift(temp_c=temp_c, turn_rate=turn_rate, error=error),
    )


def nominal_calibration(grade: Grade) -> Calibration:
    """Return the calibration from a data sheet: nominal sensitivity, orthogonal axes and no offset."""
    device = typical_device(grade)

    gyro, accel = (
        _inverse(chain, unit_out, "nominal", np.eye(3) / chain.gain, np.full(3, chain.null))
        for chain, unit_out in ((device.gyro, "rad/s"), (device.accel, "m/s2"))
    )
    return Calibration(
        device="nominal", reference_temp_c=float("nan"), gravity_m_s2=STANDARD_GRAVITY, gyro=gyro, accel=accel
    )


def _model(chain: SensorChain, warmth: float, unit_out: str) -> TriadModel:
    factor, offset = _warmed(chain, warmth)
    matrix = np.linalg.inv(factor[:, None] * chain.forward_matrix)
    model = _inverse(chain, unit_out, "truth", matrix, chain.null + chain.gain * factor * offset)
    limit = chain.full_scale / float(np.max(1.0 + chain.scale.error))
    apparent = matrix @ (chain.gain * factor[:, None] * chain.g_sensitivity.matrix) if chain.g_sensitivity else None
    return replace(model, g_sensitivity=apparent, valid_range=(-limit, limit))


def _warmed(chain: SensorChain, warmth: float) -> tuple[FloatArray, FloatArray]:
    """Return the sensitivity factor and the offset at a temperature, (3,) each."""
    factor = chain.thermal_scale.factor(warmth) if chain.thermal_scale else np.ones(3)
    return factor, chain.offset.at(warmth) if chain.offset else np.zeros(3)


def _measured(chain: SensorChain, true: FloatArray, axis: int, warmth: float) -> FloatArray:
    """Return the rates that offset(T) and M(T) compute for true rates about one axis, rad/s, shape (K,)."""
    x: FloatArray = true[:, None] * chain.scale.matrix[:, axis]
    x = chain.nonlinearity.bent(x) if chain.nonlinearity else x
    factor, offset = _warmed(chain, warmth)
    x = (x + offset) * factor
    if chain.rate_drift:
        x = x + chain.rate_drift.error(x, np.full(len(x), warmth))
    measured: FloatArray = (x - factor * offset) @ np.linalg.inv(factor[:, None] * chain.scale.matrix).T
    return measured[:, axis]


def _adc(device: DeviceModel) -> AdcModel | None:
    """Return the converter model of a device. For unsigned codes, rounding toward zero is rounding down."""

    def side(chain: SensorChain) -> tuple[FloatArray | None, Rounding]:
        if chain.adc is None:
            return None, "nearest"
        cut_down = chain.adc.rounding == "toward_zero" and not chain.adc.signed
        return np.full(3, 1.0 if chain.adc.codes else chain.adc.step), "floor" if cut_down else chain.adc.rounding

    if device.gyro.adc is None and device.accel.adc is None:
        return None
    (gyro_lsb, gyro_rounding), (accel_lsb, accel_rounding) = side(device.gyro), side(device.accel)
    return AdcModel(gyro_lsb=gyro_lsb, accel_lsb=accel_lsb, gyro_rounding=gyro_rounding, accel_rounding=accel_rounding)


def _inverse(chain: SensorChain, unit_out: str, method: str, matrix: FloatArray, offset: FloatArray) -> TriadModel:
    return TriadModel(
        method=method,
        unit_in=chain.unit,
        unit_out=unit_out,
        matrix=matrix,
        offset=offset,
        covariance=np.zeros((12, 12)),
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES),
        rms_residual=0.0,
        count=0,
        rank=12,
        condition=1.0,
        valid_range=(-chain.full_scale, chain.full_scale),
    )
