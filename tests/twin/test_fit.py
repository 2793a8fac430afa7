"""Parameters of a twin: their errors, noise and bandwidth at rest, offsets over temperature."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt
from scipy.spatial.transform import Rotation

from undrift.record import Record
from undrift.twin.fit import (
    g_sensitivity_parameters,
    mean_with_error,
    polar_rotation,
    rest_noise,
)

# ---- parameters of a twin: rotations, spreads, means


def test_the_polar_rotation_is_the_mounting_and_its_slope_the_antisymmetric_part():
    turn = np.array([0.3, -0.2, 0.5])
    stretch = np.diag((1.01, 0.98, 1.03))
    vector, _ = polar_rotation(Rotation.from_rotvec(turn).as_matrix() @ stretch)
    assert vector == pytest.approx(turn, abs=1e-9)
    vector, slope = polar_rotation(np.eye(3))
    small = np.array([[0.0, -3e-4, 2e-4], [3e-4, 0.0, -1e-4], [-2e-4, 1e-4, 0.0]])
    assert slope @ small.ravel() == pytest.approx((1e-4, 2e-4, 3e-4), abs=1e-9)
    assert slope @ np.diag((1.0, 2.0, 3.0)).ravel() == pytest.approx(np.zeros(3), abs=1e-9)


def test_the_error_of_a_mean_is_the_larger_of_claim_and_scatter():
    assert mean_with_error([1.0, 1.0], [0.3, 0.4])[1] == pytest.approx(0.25)
    assert mean_with_error([0.0, 2.0], [0.1, 0.1])[1] == pytest.approx(1.0)


def test_g_sensitivity_within_its_error_is_not_identified():
    found = g_sensitivity_parameters(np.array([9e-4] + [1e-5] * 8), np.full(9, 1e-4))
    assert [p.identifiable for p in found] == [True] + [False] * 8
    assert (found[1].finding.code, found[1].finding.values) == ("twin.g_sensitivity_zero", {"sigmas": 4.0})
    assert found[1].reason.startswith("Within 4 standard errors of zero")


# ---- rest: white noise and bandwidth from a spectrum that is known

RATE_HZ = 400.0


def at_rest(seed, *, bandwidth_hz=None, walk=1e-4, step=0.0):
    rng = np.random.default_rng(seed)
    fine = 8 if bandwidth_hz else 1  # the filter is analogue: eight samples for one
    noise = walk * np.sqrt(RATE_HZ * fine) * rng.standard_normal((24000 * fine, 3))
    if bandwidth_hz:
        noise = sosfilt(butter(2, bandwidth_hz, fs=RATE_HZ * fine, output="sos"), noise, axis=0)[::fine]
    if step:
        noise = np.rint(noise / step) * step
    return Record(time=np.arange(len(noise)) / RATE_HZ, gyro=noise)


def test_white_noise_is_told_to_its_standard_error():
    found = rest_noise([at_rest(1)], "gyro")
    assert np.abs((found.random_walk - 1e-4) / found.random_walk_error).max() < 4.0
    assert found.random_walk_error.max() < 1.5e-6
    assert np.isnan(found.bandwidth_hz)
    assert found.bandwidth_above_hz > 150.0


def test_the_noise_of_the_codes_is_taken_off():
    step = 2e-3  # as large as the noise
    found = rest_noise([at_rest(2, step=step)], "gyro", step=step)
    assert found.random_walk == pytest.approx(np.full(3, 1e-4), rel=0.03)


def test_a_bandwidth_within_the_band_is_told_to_its_standard_error():
    found = rest_noise([at_rest(3, bandwidth_hz=90.0), at_rest(4, bandwidth_hz=90.0)], "gyro")
    assert found.bandwidth_hz == pytest.approx(90.0, abs=max(4.0 * found.bandwidth_error_hz, 1.0))
    assert found.bandwidth_error_hz < 2.0
    assert found.random_walk == pytest.approx(np.full(3, 1e-4), rel=0.04)


def test_short_rests_and_missing_triads_tell_nothing():
    assert rest_noise([at_rest(5).part(0, 500)], "gyro") is None
    assert rest_noise([at_rest(5)], "accel") is None
    assert rest_noise([], "gyro") is None


# ---- offsets of a device over temperature from a recording at rest: planted courses come back, what shows none is refused

GYRO = np.radians([[0.002, 0.03, -0.005], [1e-4, -3e-4, 4e-4], [-1e-5, 4e-6, -2e-5]])  # rad/s per K, K2, K3
ACCEL = np.array([[2e-3, -1e-3, -0.02], [1e-5, 0.0, 1e-4], [0.0, 1e-6, -1e-5]])
NOISE, NOISE_C, STEP_C = np.radians(0.05), 0.0125, 1.0 / 340.0


def warm_up(rate_hz: float = 30.0, duration_s: float = 1800.0) -> Record:
    """A board that warms from 11 towards 29 degC, with noise; 2 s are missing, and another 2 s are gaps."""
    rng = np.random.default_rng(5)
    time = np.arange(round(rate_hz * duration_s)) / rate_hz
    temp = 29.0 - 18.0 * np.exp(-time / 500.0)
    d = temp[:, None] - 15.0
    gyro = np.radians([0.3, -0.2, 0.1]) + sum(row * d ** (k + 1) for k, row in enumerate(GYRO))
    accel = np.array([0.1, 0.2, 9.7]) + sum(row * d ** (k + 1) for k, row in enumerate(ACCEL))
    gyro = gyro + rng.normal(0.0, NOISE, gyro.shape)
    gyro[3000:3060] = np.nan
    kept = (time < 600.0) | (time >= 602.0)
    return Record(
        time=time[kept],
        gyro=np.degrees(gyro[kept]),
        accel=(accel + rng.normal(0.0, 0.02, accel.shape))[kept],
        temp_c=(np.round((temp + rng.normal(0.0, NOISE_C, len(temp))) / STEP_C) * STEP_C)[kept],
        gyro_unit="dps",
        accel_unit="m/s2",
    )
