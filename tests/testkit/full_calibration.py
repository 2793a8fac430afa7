"""A device with every term of the correction model, its tables, and readings to correct."""

from dataclasses import replace

import numpy as np

from undrift.model import (
    AdcModel,
    Calibration,
    DriftTables,
    DynamicDrift,
    Magnetometer,
    ScaleDrift,
    StaticDrift,
    TriadModel,
)
from undrift.record import Record

N = 203  # odd, so that no vector width divides it, and small, so that the tests also run without the compiler


def triad(rng, unit_in, unit_out, scale, offset, g=None):
    return TriadModel(
        method="test",
        unit_in=unit_in,
        unit_out=unit_out,
        matrix=(np.eye(3) + rng.normal(size=(3, 3)) * 0.02) * scale,
        offset=rng.normal(size=3) * offset,
        g_sensitivity=g,
        covariance=np.zeros((12, 12)),
        rms_residual=0.0,
        count=12,
        rank=12,
        condition=1.0,
        valid_range=(-1.0, 1.0),
    )


def device(*, g=True, unit="count", **changes):
    rng = np.random.default_rng(3)
    of_g = rng.normal(size=(3, 3)) * 1e-3 if g else None
    rate = 1e-3 if unit == "count" else 1.0
    values = {
        "device": "A",
        "reference_temp_c": 25.0,
        "gravity_m_s2": 9.81,
        "gyro": triad(rng, unit if unit == "count" else "rad/s", "rad/s", rate, 30.0 * 1e-3 / rate, of_g),
        "accel": triad(rng, unit if unit == "count" else "m/s2", "m/s2", 5e-3 if unit == "count" else 1.0, 30.0),
        **changes,
    }
    return Calibration(**values)


def with_magnetometer(made):
    """Return a calibration that has one too."""
    model = replace(triad(np.random.default_rng(9), "uT", "uT", 1.0, 20.0), rms_residual=0.4)
    return replace(made, magnetometer=Magnetometer(model=model, lag_s=0.0128, lag_uncertainty_s=2e-4))


STEPS = np.linspace(18.0, 75.0, 115)
GAP = np.radians(np.concatenate((-np.arange(90, 9, -5), np.arange(10, 91, 5))))  # the paper's grid: none below 10 deg/s
WILD = np.array([17.0, 18.3, 25.0, 40.71, 80.0])  # no common step: searched


def tables(*, static=STEPS, scale=None, dynamic=(STEPS, GAP), accel=True):
    rng = np.random.default_rng(4)

    def small(*shape):
        return rng.normal(size=shape)

    offsets = matrices = errors = None
    if static is not None:
        offset = small(len(static), 3) * 30.0
        offsets = StaticDrift(temp_c=static, gyro_offset=offset, accel_offset=offset[::-1] if accel else None)
    if scale is not None:
        matrix = np.eye(3) + small(len(scale), 3, 3) * 0.02
        matrices = ScaleDrift(temp_c=scale, gyro_matrix=matrix * 1e-3, accel_matrix=matrix * 5e-3 if accel else None)
    if dynamic is not None:
        error = small(len(dynamic[0]), len(dynamic[1]), 3) * 0.01
        errors = DynamicDrift(temp_c=dynamic[0], turn_rate=dynamic[1], error=error)
    return DriftTables(static=offsets, scale=matrices, dynamic=errors)


def record(n=N, *, seed=1, low=20.0, high=70.0, unit="count", **changes):
    rng = np.random.default_rng(seed)
    scale = 1.0 if unit == "count" else 1e-3
    gyro = np.round(rng.normal(size=(n, 3)) * 600.0) * scale
    gyro[:3] = 0.0
    values = {
        "time": np.arange(n) * 0.01,
        "gyro": gyro,
        "accel": np.round(rng.normal(size=(n, 3)) * 1000.0) * scale,
        "temp_c": rng.uniform(low, high, n),
        "gyro_unit": "count" if unit == "count" else "rad/s",
        "accel_unit": "count" if unit == "count" else "m/s2",
        **changes,
    }
    return Record(**values)


ROUNDINGS = [
    None,
    AdcModel(gyro_lsb=[1, 1, 1], accel_lsb=[2, 2, 2], gyro_rounding="toward_zero", accel_rounding="floor"),
    AdcModel(gyro_lsb=[1, 1, 1], accel_lsb=[1, 1, 1], gyro_rounding="nearest", accel_rounding="toward_zero"),
]
