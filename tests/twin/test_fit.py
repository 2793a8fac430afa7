"""Parameters of a twin: the error of a mean, white noise at rest."""

import numpy as np
import pytest

from undrift.record import Record
from undrift.twin.fit import mean_with_error, rest_noise

RATE_HZ = 400.0


def at_rest(seed, *, walk=1e-4, step=0.0, sway=0.0):
    rng = np.random.default_rng(seed)
    time = np.arange(24000) / RATE_HZ
    noise = walk * np.sqrt(RATE_HZ) * rng.standard_normal((len(time), 3))
    noise += sway * np.sin(2.0 * np.pi * 0.3 * time)[:, None]
    if step:
        noise = np.rint(noise / step) * step
    return Record(time=time, gyro=noise)


def test_error_of_a_mean_is_the_larger_of_claim_and_scatter():
    assert mean_with_error(np.array([1.0, 1.0]), np.array([0.3, 0.4]))[1] == pytest.approx(0.25)
    assert mean_with_error(np.array([0.0, 2.0]), np.array([0.1, 0.1]))[1] == pytest.approx(1.0)


@pytest.mark.parametrize("sway", [0.0, 2e-3])
def test_white_noise_lies_within_its_standard_error(sway):
    noise = rest_noise([at_rest(1, sway=sway)], "gyro")
    assert np.abs((noise.random_walk - 1e-4) / noise.random_walk_error).max() < 4.0
    assert noise.random_walk_error.max() < 1.5e-6


def test_noise_of_the_codes_is_removed():
    step = 2e-3  # as large as the noise
    assert rest_noise([at_rest(2, step=step)], "gyro", step=step).random_walk == pytest.approx(
        np.full(3, 1e-4), rel=0.03
    )


def test_short_rests_and_missing_triads_have_no_noise():
    assert rest_noise([at_rest(5).part(0, 500)], "gyro") is None
    assert rest_noise([at_rest(5)], "accel") is None
    assert rest_noise([], "gyro") is None
