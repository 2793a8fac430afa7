"""The lag is found from blocks that ran both ways at two speeds, and reported as not observable otherwise."""

import numpy as np
import pytest

from undrift.drift.observe import RestBlocks
from undrift.drift.temperature import estimate_lag

STEP_S = 10.0


def blocks(temp, *, lag_s=30.0, noise=0.005, loop=0.0, seed=0, sessions=None):
    """Return blocks of a board at ``temp``, read by a thermometer that lags, of a gyro with offset 0.07 T + 0.002 T^2."""
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
    assert found.findings == ()
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


def test_soaks_show_no_lag():
    found = estimate_lag(blocks(np.repeat(np.arange(20.0, 60.0, 5.0), 40), lag_s=3.0))
    assert not found.observable
    assert found.lag_s == 0.0
    assert np.isinf(found.uncertainty_s)
    (why,) = found.findings
    assert why.code == "drift.lag_few_blocks"
    assert why.values["count"] < why.values["wanted"] == 24
    assert "blocks of rest change by over 0.1 degC/min" in why.text


def test_a_warm_up_alone_shows_no_lag():
    time = STEP_S * np.arange(200)
    found = estimate_lag(blocks(10.0 + 18.0 * (1.0 - np.exp(-time / 500.0))))
    assert not found.observable
    (why,) = found.findings
    assert why.code == "drift.lag_one_way"
    assert why.text.endswith("also cool through the same temperatures")


def test_one_speed_both_ways_does_not_separate_lag_from_hysteresis():
    found = estimate_lag(blocks(there_and_back(1.0)))
    assert not found.observable
    assert found.lag_s == pytest.approx(30.0, abs=3.0)
    assert [why.code for why in found.findings] == ["drift.lag_or_hysteresis"]
    assert found.findings[0].values["lag_s"] == found.lag_s


def test_a_lag_beyond_the_search_is_not_observable():
    found = estimate_lag(two_ramps(), longest_s=20.0)
    assert not found.observable
    assert [why.code for why in found.findings] == ["drift.lag_unbounded"]
    assert found.findings[0].values["longest_s"] == 20.0


def test_a_few_blocks_show_no_lag():
    (why,) = estimate_lag(blocks(np.linspace(20.0, 30.0, 10))).findings
    assert (why.code, why.values["wanted"]) == ("drift.lag_few_blocks", 24)
