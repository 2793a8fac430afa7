"""Mean of rests: its stated variance is the one that repeated experiments show."""

import numpy as np
import pytest

from testkit.cohorts import COHORTS, share_limits
from undrift.calibration.observe import mean_of_rests


def covered(rng, count, between, *, correlated=0.0, length=2000, trials):
    """Return the share of 95 % intervals that hold the truth, here zero."""
    held = 0
    for _ in range(trials):
        windows = []
        for _ in range(count):
            noise = rng.standard_normal((length, 3))
            if correlated:
                noise += correlated * np.repeat(rng.standard_normal((length // 50, 3)), 50, axis=0)
            windows.append(noise + between * rng.standard_normal(3))
        mean, variance = mean_of_rests(windows, [50] * count)
        held += int((np.abs(mean) <= 1.96 * np.sqrt(variance)).sum())
    return held / (3 * trials)


@pytest.mark.parametrize("trials", COHORTS)
@pytest.mark.parametrize(
    ("count", "between", "correlated"),
    [(1, 0.0, 0.0), (1, 0.0, 1.0), (11, 0.0, 0.0), (11, 1.0, 0.0), (4, 1.0, 0.0), (11, 0.1, 1.0)],
)
def test_intervals_hold_whether_rests_scatter_or_not(count, between, correlated, trials):
    share = covered(np.random.default_rng(41), count, between, correlated=correlated, trials=trials)
    print(f"{count} rests, scatter {between}, correlated {correlated}: {100 * share:.1f} % of 95 % intervals hold")
    low, high = share_limits(3 * trials)
    assert low <= share <= max(high, 0.995)  # the larger of two block lengths is a little too wide on white noise


def test_scatter_between_rests_is_not_taken_for_noise_of_samples():
    rng = np.random.default_rng(42)
    windows = [0.01 * rng.standard_normal((2400, 3)) + shift for shift in np.linspace(-0.1, 0.1, 11)]
    variance = mean_of_rests(windows, [50] * 11)[1]
    white = 0.01**2 / (11 * 2400)
    # standard deviation of the shifts 0.066 over sqrt(11), times Student's factor 1.14
    np.testing.assert_allclose(np.sqrt(variance), 0.0663 / np.sqrt(11) * 1.137, rtol=0.02)
    assert (variance > 100.0 * white).all()


def test_readings_without_any_scatter_have_none():
    mean, variance = mean_of_rests([np.ones((200, 3)), np.ones((300, 3))], [50, 50])
    np.testing.assert_array_equal(mean, 1.0)
    np.testing.assert_array_equal(variance, 0.0)


@pytest.mark.parametrize("warmth", [(-0.6, -0.5, -0.1, 1.2), (0.1, 0.5, 0.9, 1.3)])
def test_offsets_that_creep_with_temperature_cost_what_their_slope_leaves_unknown(warmth):
    rng, held, stated, scatter = np.random.default_rng(43), 0, [], []
    away = np.array(warmth)  # K above the reference, of each rest
    for _ in range(300):
        slope = rng.normal(0.0, 0.5, 3)
        windows = [rng.standard_normal((2000, 3)) + each * slope for each in away]
        mean, variance = mean_of_rests(windows, [50] * 4, 0.5 * away)
        held += int((np.abs(mean) <= 1.96 * np.sqrt(variance)).sum())
        stated.append(variance)
        scatter.append(mean_of_rests(windows, [50] * 4)[1])
    assert 0.92 <= held / 900 <= 0.995  # as above
    # Taken for scatter, 0.5 per K over a span near 1 K leaves 0.1 to 0.2; known as a slope little more than noise, 0.01 to 0.03
    assert np.sqrt(np.mean(stated) / np.mean(scatter)) < 0.25
