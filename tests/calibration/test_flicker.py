"""Flicker: its covariance is that of exponential correlations, and rests that flicker show its size."""

import numpy as np

from undrift.calibration.creep import (
    SIZES,
    Blocks,
    blocks_within,
    flicker_about_mean,
    flicker_of_means,
    mean_square_size,
    size_unit,
)

RATE_HZ = 10.0
SPAN = np.array([[0.0, 6.0], [8.0, 14.0], [50.0, 54.0]])


def correlation(time: np.ndarray) -> np.ndarray:
    """Return the correlation of a process at times (N,), nine time constants evenly from 1 s to 10^4 s on a log scale."""
    apart = np.abs(time[:, None] - time)
    return np.asarray(np.mean([np.exp(-apart / 10.0**power) for power in np.linspace(0.0, 4.0, 9)], axis=0))


def averages(span: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the rows (E, N) that average over stretches."""
    inside = np.array([(time > start) & (time < stop) for start, stop in span], float)
    return np.asarray(inside / inside.sum(axis=1)[:, None])


def rests(flicker: float, seed: int, count: int = 12) -> list[np.ndarray]:
    """Return rests of 20 s with white noise of 1 and flicker of a standard deviation, 30 s from start to start."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(count * 30.0 * RATE_HZ)) / RATE_HZ
    signal = rng.standard_normal((len(time), 3))
    for power in np.linspace(0.0, 4.0, 9):
        keep = np.exp(-1.0 / RATE_HZ / 10.0**power)
        state = rng.standard_normal(3)
        for row in range(len(time)):
            state = keep * state + np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
            signal[row] += flicker / 3.0 * state
    return [signal[k : k + 200] for k in range(0, len(time), 300)]


def size_found(windows: list[np.ndarray]) -> float:
    """Return the size of flicker, root mean square over its likelihood, in the unit of the readings."""
    unit = 1.0 / np.sqrt(10.0 * RATE_HZ)
    blocks = blocks_within(windows, [RATE_HZ] * len(windows))
    return float(unit * np.sqrt(mean_square_size(blocks.likelihood(unit))))


def test_the_covariance_of_means_is_the_correlation_averaged_over_both_stretches() -> None:
    span = np.vstack((SPAN, [3.0, 52.0]))  # the last overlaps the others
    time = np.arange(0.01, 54.0, 0.02)
    rows = averages(span, time)
    # the sum over steps of 0.02 s misses the integral by (0.02 s / 1 s)^2 / 12 or less
    np.testing.assert_allclose(flicker_of_means(span), rows @ correlation(time) @ rows.T, atol=4e-5)


def test_the_mean_from_the_first_to_the_last_stretch_is_taken_off() -> None:
    time = np.arange(0.01, 54.0, 0.02)
    extent = np.array([1.0, 1.0, 4.0])  # the last is an integral over 4 s
    rows = extent[:, None] * (averages(SPAN, time) - averages(np.array([[0.0, 54.0]]), time))
    np.testing.assert_allclose(flicker_about_mean(SPAN, extent), rows @ correlation(time) @ rows.T, atol=16 * 4e-5)
    assert flicker_about_mean(np.array([[5.0, 9.0]])) == 0.0  # one stretch is its own mean


def test_rests_that_flicker_show_the_size_and_white_ones_little() -> None:
    white, flickering = (np.median([size_found(rests(size, seed)) for seed in range(5)]) for size in (0.0, 0.5))
    assert 0.25 < flickering < 1.0  # a factor of two: 36 rests of 20 s are as long as the slow parts of flicker
    assert white < 0.1  # of a reading's noise; a mean over 10 s has 0.1


def test_blocks_of_white_noise_are_uncorrelated_with_one_variance() -> None:
    rng = np.random.default_rng(3)
    windows = [rng.standard_normal((size, 3)) for size in 200 * [60, 600]]  # the longer ones have longer blocks
    blocks = blocks_within(windows, [RATE_HZ] * 400, removed=2)
    long = blocks.reading[blocks.gain > np.median(blocks.gain)]
    assert len(blocks.reading) == 200 * (12 - 2) + 200 * (33 - 2)
    # a block of half a second has a variance of 1 / 5; 1.6 % at 12,000 degrees of freedom, five of them
    np.testing.assert_allclose((blocks.reading**2).mean(axis=0), 0.2, rtol=0.08)
    np.testing.assert_allclose((long**2).mean(axis=0), 0.2, rtol=0.1)


def test_a_slope_that_the_filter_takes_out_is_no_flicker() -> None:
    windows = rests(0.0, 6)
    tilted = [window + 50.0 * np.linspace(-1.0, 1.0, len(window))[:, None] for window in windows]
    plain, other = (blocks_within(w, [RATE_HZ] * len(w), removed=2) for w in (windows, tilted))
    np.testing.assert_allclose(other.likelihood(0.1), plain.likelihood(0.1), rtol=1e-9, atol=1e-9)
    assert size_found(tilted) > 10.0 * size_found(windows)  # where only the mean is taken out, it is


def test_readings_without_noise_say_nothing() -> None:
    blocks = blocks_within([np.ones((100, 3))] * 6, [RATE_HZ] * 6)
    np.testing.assert_array_equal(blocks.likelihood(1.0), np.zeros(len(SIZES)))
    none = Blocks(reading=np.zeros((0, 3)), gain=np.zeros(0))
    np.testing.assert_array_equal(none.likelihood(1.0), np.zeros(len(SIZES)))


def test_the_unit_is_the_noise_of_a_mean_over_ten_seconds() -> None:
    noise = np.full((2, 3), 0.2)
    assert size_unit(noise, np.array([[0.0, 2.5], [10.0, 12.5]])) == 0.1
