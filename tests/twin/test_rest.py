"""Rest: white noise and bandwidth from a spectrum that is known."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from undrift.record import Record
from undrift.twin.fit import rest_noise

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
