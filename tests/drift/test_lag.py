"""The thermometer's lag is taken off exactly, chunk by chunk, and said to be unknown where it is."""

import numpy as np
import pytest

from undrift.drift.temperature import LagState, default_smooth_s, without_lag, without_lag_smooth
from undrift.errors import InputError

TAU = 40.0


def lagging(time, temp):
    """Return what a thermometer reads whose temperature is straight between samples: the exact solution."""
    said = np.empty_like(temp)
    said[0] = temp[0]
    for k in range(1, len(temp)):
        step = time[k] - time[k - 1]
        slope = (temp[k] - temp[k - 1]) / step
        settled = temp[k - 1] - slope * TAU
        said[k] = settled + slope * step + (said[k - 1] - settled) * np.exp(-step / TAU)
    return said


def ramp(seed=0, n=2000):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.05, 1.5, n))
    return time, 20.0 + 5.0 * np.sin(time / 150.0)


def test_a_ramp_is_followed_with_the_small_lag_instead_of_the_large_one():
    time = np.arange(0.0, 2000.0, 0.1)
    temp = 20.0 + 0.05 * time  # 3 degC/min
    said = lagging(time, temp)
    found, _ = without_lag(said, time, lag_s=TAU, smooth_s=5.0)
    assert temp[-1] - said[-1] == pytest.approx(0.05 * TAU, rel=1e-6)
    assert temp[-1] - found[-1] == pytest.approx(
        0.05 * 5.0, rel=1e-4
    )  # the reading bends between samples: (dt / tau)^2


def test_chunks_give_the_bits_of_the_batch():
    time, temp = ramp()
    temp[[7, 8, 500]] = np.nan
    whole, last = without_lag(temp, time, lag_s=TAU, smooth_s=4.0)
    state, parts = None, []
    for part in np.split(np.arange(len(time)), [1, 8, 9, 500, 501, 1300]):
        done, state = without_lag(temp[part], time[part], lag_s=TAU, smooth_s=4.0, state=state)
        parts.append(done)
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    assert state == last


def test_a_gap_holds_and_the_next_reading_bridges_it():
    time, temp = ramp()
    gone = temp.copy()
    gone[[0, 1, 700, 701]] = np.nan
    found, _ = without_lag(gone, time, lag_s=TAU, smooth_s=4.0)
    assert np.isnan(found[:2]).all()
    assert (found[700:702] == found[699]).all()
    kept = np.isfinite(gone)
    np.testing.assert_array_equal(found[kept], without_lag(temp[kept], time[kept], lag_s=TAU, smooth_s=4.0)[0])


def test_a_thermometer_without_lag_is_left_alone():
    time, temp = ramp()
    np.testing.assert_array_equal(without_lag(temp, time, lag_s=0.0, smooth_s=0.0)[0], temp)
    np.testing.assert_array_equal(without_lag_smooth(temp, time, lag_s=0.0), temp)


def test_an_empty_chunk_changes_nothing():
    state = LagState(time=3.0, temp_c=20.0, smooth_c=20.0, output_c=20.0)
    done, after = without_lag(np.empty(0), np.empty(0), lag_s=TAU, smooth_s=4.0, state=state)
    assert len(done) == 0
    assert after == state


def test_for_a_fit_nothing_of_the_lag_is_left():
    time = np.arange(0.0, 3000.0, 0.5)
    temp = 20.0 + 5.0 * np.sin(time / 150.0)
    found = without_lag_smooth(lagging(time, temp), time, lag_s=TAU)
    left = np.abs(found - temp)[1:-1].max()
    assert left < 1e-3  # central differences: tau T''' dt^2 / 6 and the bend of the input between samples, 0.3 mK
    gone = lagging(time, temp)
    gone[1000:1010] = np.nan
    again = without_lag_smooth(gone, time, lag_s=TAU)
    assert np.isnan(again[1000:1010]).all()
    np.testing.assert_array_equal(again[:999], found[:999])


def test_the_smoothing_balances_noise_and_the_lag_left():
    assert default_smooth_s(0.0, noise_c=0.1, interval_s=0.1) == 0.0
    assert default_smooth_s(80.0, noise_c=0.0, interval_s=0.1) == pytest.approx(4.0)  # a twentieth
    assert default_smooth_s(80.0, noise_c=5.0, interval_s=1.0) == pytest.approx(40.0)  # a half
    noise = 0.05 * np.sqrt(0.1)
    assert default_smooth_s(80.0, noise_c=0.05, interval_s=0.1) == pytest.approx(np.sqrt(noise * 80.0 * 60.0))
    stepped = default_smooth_s(80.0, noise_c=0.0, interval_s=0.1, step_c=0.1)
    assert stepped == pytest.approx(np.sqrt(0.1 / np.sqrt(12.0) * 80.0 * 60.0))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"lag_s": -1.0}, "wanted lag_s and smooth_s of 0 s or more, got -1 and 4"),
        ({"smooth_s": float("nan")}, "wanted lag_s and smooth_s of 0 s or more, got 40 and nan"),
        ({"smooth_s": 0.0}, "wanted smooth_s above 0 s to subtract 40 s, got 0"),
        ({"time": np.arange(3.0)}, r"wanted a time for each temperature, got \(3,\) for \(4,\)"),
        ({"state": LagState(time=2.0)}, "wanted readings from after 2 s, got 0 s; push chunks in order"),
    ],
)
def test_a_wrong_call_is_refused(changes, words):
    call = {"time": np.arange(4.0), "lag_s": TAU, "smooth_s": 4.0, **changes}
    with pytest.raises(InputError, match=words):
        without_lag(np.full(4, 20.0), **call)


def test_noise_below_nothing_is_refused():
    with pytest.raises(InputError, match="wanted noise and step of 0 K or more and an interval above 0 s, got -1"):
        default_smooth_s(10.0, noise_c=-1.0, interval_s=0.1)
