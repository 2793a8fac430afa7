"""The lag is found from blocks that ran both ways at two speeds, and said to be unknown where nothing tells it."""

import numpy as np
import pytest

from undrift.drift.observe import RestBlocks
from undrift.drift.thermometer_lag import LagSettings, estimate_lag

STEP_S = 10.0


def blocks(temp, *, lag_s=30.0, noise=0.005, loop=0.0, seed=0, sessions=None):
    """Return blocks of a board at ``temp``, read by a thermometer that trails, of a gyro with offset 0.07 T + 0.002 T^2."""
    read = np.empty_like(temp)
    read[0] = temp[0]
    for k in range(1, len(temp)):
        read[k] = temp[k] + (read[k - 1] - temp[k]) * np.exp(-STEP_S / lag_s)
    slope = (temp - read) / lag_s
    x = temp - 25.0
    true = np.column_stack((0.07 * x + 0.002 * x**2, -0.05 * x, 0.02 * x)) + loop * -np.sign(np.gradient(temp))[:, None]
    n = len(temp)
    return RestBlocks(
        session=np.zeros(n, dtype=np.int64) if sessions is None else sessions,
        pose=np.zeros(n, dtype=np.int64) if sessions is None else sessions,
        time=STEP_S * np.arange(n),
        power_on_s=np.full(n, 5000.0),
        temp_c=read,
        ramp_c_per_min=60.0 * slope,
        gyro=true + np.random.default_rng(seed).normal(0.0, noise, (n, 3)),
        accel=np.full((n, 3), np.nan),
        gyro_variance=np.full((n, 3), noise**2),
        accel_variance=np.full((n, 3), np.nan),
    )


def there_and_back(c_per_min, low=20.0, high=40.0):
    n = round((high - low) / c_per_min * 60.0 / STEP_S)
    return np.concatenate((np.linspace(low, high, n), np.linspace(high, low, n)))


def two_ramps(**kwargs):
    return blocks(np.concatenate((there_and_back(0.5), there_and_back(3.0))), **kwargs)


@pytest.mark.parametrize("loop", [0.0, 0.05, -0.05])
def test_a_loop_that_does_not_depend_on_speed_is_not_taken_for_lag(loop):
    found = estimate_lag(two_ramps(loop=loop))
    assert found.observable
    assert found.notes == ()
    assert abs(found.lag_s - 30.0) < 4.0 * found.uncertainty_s
    assert found.uncertainty_s < 2.0
    assert found.misfit[found.lags_s.searchsorted(found.lag_s)] < 2.0


def test_the_uncertainty_is_what_the_estimates_scatter():
    found = [estimate_lag(two_ramps(seed=seed, noise=0.02)) for seed in range(40)]
    scatter = float(np.std([f.lag_s for f in found]))
    stated = float(np.mean([f.uncertainty_s for f in found]))
    assert 0.6 < scatter / stated < 1.5  # 40 draws know a standard deviation to 11 %; neighbours count as independent


def test_without_lag_none_is_found():
    found = estimate_lag(two_ramps(lag_s=1e-3))
    assert found.lag_s < 4.0 * found.uncertainty_s


def test_soaks_say_nothing():
    found = estimate_lag(blocks(np.repeat(np.arange(20.0, 60.0, 5.0), 40), lag_s=3.0))
    assert not found.observable
    assert found.lag_s == 0.0
    assert np.isinf(found.uncertainty_s)
    assert found.notes[0].startswith(
        "the thermometer's lag is not observable from soaks: the temperature moves by over 0.1"
    )


def test_a_warm_up_alone_says_nothing():
    time = STEP_S * np.arange(200)
    found = estimate_lag(blocks(10.0 + 18.0 * (1.0 - np.exp(-time / 500.0))))
    assert not found.observable
    assert "each temperature was passed at one speed only" in found.notes[0]
    assert found.notes[0].endswith("cool the device again through the same temperatures")


def test_one_speed_both_ways_names_the_doubt():
    found = estimate_lag(blocks(there_and_back(1.0)))
    assert not found.observable
    assert found.lag_s == pytest.approx(30.0, abs=3.0)
    assert "at one speed only: a lag of" in found.notes[0]


def test_a_lag_beyond_the_search_is_not_observable():
    found = estimate_lag(two_ramps(), settings=LagSettings(longest_s=20.0))
    assert not found.observable
    assert "any up to 20 s fits" in found.notes[0]


def test_a_few_blocks_say_nothing():
    assert "wanted 24 blocks of rest" in estimate_lag(blocks(np.linspace(20.0, 30.0, 10))).notes[0]
