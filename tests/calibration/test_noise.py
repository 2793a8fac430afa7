"""Noise coefficients come back from simulated noise, and are refused where a record does not show them."""

import numpy as np
import pytest

from undrift.calibration.noise import allan_deviation, fit_noise
from undrift.errors import InputError
from undrift.record import Record

RATE = 100.0


def noisy(samples: int, white: float, walk: float, seed: int, unit: str = "rad/s") -> Record:
    rng = np.random.default_rng(seed)
    gyro = white * np.sqrt(RATE) * rng.normal(size=(samples, 3))
    gyro += np.cumsum(walk / np.sqrt(RATE) * rng.normal(size=(samples, 3)), axis=0)
    return Record(time=np.arange(samples) / RATE, gyro=gyro, gyro_unit=unit)


def test_white_noise_and_random_walk_come_back() -> None:
    white, walk = 0.005, 0.02
    fit = fit_noise(noisy(1_000_000, white, walk, seed=1))
    for axis in fit.gyro:
        n, k = axis.angle_random_walk, axis.rate_random_walk
        print(f"  {axis.axis}: N {n.value / white:.4f}, K {k.value / walk:.4f} of what was put in")
        assert abs(n.value / white - 1.0) < 0.05
        assert abs(k.value / walk - 1.0) < 0.05
        assert n.interval[0] < n.value < n.interval[1]
        assert n.unit == "rad/s/sqrt(Hz)"
        assert k.unit == "rad/s/sqrt(s)"


def test_short_record_states_what_it_does_not_show() -> None:
    fit = fit_noise(noisy(20_000, 0.005, 0.0, seed=2))
    for axis in fit.gyro:
        assert axis.angle_random_walk.value == pytest.approx(0.005, rel=0.05)
        assert np.isnan(axis.rate_random_walk.value)
        assert axis.rate_random_walk.reason.startswith("not observable")
        assert axis.rate_random_walk.interval[0] == 0.0
        assert axis.rate_random_walk.interval[1] > 0.0
        assert "record longer" in axis.bias_instability.reason
    lost = next(f for f in fit.verdict.findings if "rate random walk" in f.sentence)
    assert (lost.code, lost.level) == ("session.not_observable", "info")
    assert "200 s" in lost.sentence


def test_a_flat_floor_is_separated_from_a_slope() -> None:
    # Flicker: white noise shaped by the square root of frequency, put on top of white; B from h_-1 = B^2 / pi.
    rng, samples, instability = np.random.default_rng(3), 2**18, 0.01
    frequency = np.fft.rfftfreq(samples, 1.0 / RATE)
    spectrum = np.zeros(len(frequency), complex)
    spectrum[1:] = np.sqrt(instability**2 / np.pi / frequency[1:] * RATE * samples / 4.0) * (
        rng.normal(size=len(frequency) - 1) + 1j * rng.normal(size=len(frequency) - 1)
    )
    flicker = np.fft.irfft(spectrum, samples)
    y = flicker + 0.001 * np.sqrt(RATE) * rng.normal(size=samples)
    fit = fit_noise(Record(time=np.arange(samples) / RATE, gyro=np.column_stack((y, y[::-1], -y))))
    print(f"  B {fit.gyro[0].bias_instability.value / instability:.3f} of what was put in")
    assert fit.gyro[0].bias_instability.value == pytest.approx(instability, rel=0.1)  # 1.2 decades of floor: 4 % sigma


def test_counts_stay_counts() -> None:
    fit = fit_noise(noisy(5_000, 1.0, 0.0, seed=4, unit="count"))
    assert fit.gyro_unit == "count"
    assert fit.gyro[0].angle_random_walk.unit == "count/sqrt(Hz)"


def test_records_that_move_have_gaps_or_say_nothing_are_refused() -> None:
    record = noisy(3_000, 0.005, 0.0, seed=5)
    assert record.gyro is not None
    moved = np.array(record.gyro)
    moved[1_500:1_600] += 3.0 * np.sin(np.arange(100) / 5.0)[:, None]
    with pytest.raises(InputError, match="first at 15 s"):
        fit_noise(Record(time=record.time, gyro=moved))
    holed = np.array(record.gyro)
    holed[40:] = np.nan
    with pytest.raises(InputError, match="got 40 and"):
        fit_noise(Record(time=record.time, gyro=holed))
    stuck = np.array(record.gyro)
    stuck[:, 2] = 4.0
    with pytest.raises(InputError, match="a constant value"):
        fit_noise(Record(time=record.time, gyro=stuck))
    bursts = np.repeat(record.time[::5], 5)[: len(record)] + np.tile(np.arange(5) * 0.001, 600)
    with pytest.raises(InputError, match="599 drop-outs"):
        fit_noise(Record(time=bursts, gyro=record.gyro))


def test_a_filtered_record_is_fitted_with_a_stated_departure() -> None:
    record = noisy(60_000, 0.0005, 0.0, seed=6)  # 0.03 deg/s/sqrt(Hz): a poor gyroscope
    assert record.gyro is not None
    smooth = np.apply_along_axis(lambda y: np.convolve(y, np.ones(8) / 8.0, mode="same"), 0, record.gyro)
    fit = fit_noise(Record(time=record.time, gyro=smooth))
    assert fit.gyro[0].model_error >= 0.1
    assert fit.verdict.status == "marginal"
    departs = [f for f in fit.verdict.findings if f.code == "noise.model_error"]
    assert departs
    assert all(f.level == "warn" and f.values["error_percent"] >= 10.0 for f in departs)


# ---- allan deviations against their definitions, their confidence against simulation


def test_overlapping_deviation_is_its_definition_sum_by_sum() -> None:
    y = np.random.default_rng(0).normal(size=200) + 5.0
    for m in (1, 3, 20):
        means = np.convolve(y, np.ones(m) / m, mode="valid")
        expected = np.sqrt(0.5 * np.mean((means[m:] - means[:-m]) ** 2))
        got = allan_deviation(y, 10.0, taus=[m / 10.0])
        assert got.deviation[0] == pytest.approx(expected, rel=1e-10)
        assert got.taus_s[0] == pytest.approx(m / 10.0)


def test_what_cannot_be_averaged_is_refused() -> None:
    y = np.ones(100)
    every_third = np.where(np.arange(100) % 2 == 0, y, np.nan)
    with pytest.raises(InputError, match="50 gaps"):
        allan_deviation(every_third, 1.0)


def test_limits_with_gaps_cover_the_true_deviation() -> None:
    covered, true = [], 1.0 / np.sqrt([1.0, 8.0, 64.0])
    for seed in range(200):
        rng = np.random.default_rng(seed)
        y = rng.normal(size=4000)
        for start in rng.integers(0, 3990, 12):
            y[start : start + 10] = np.nan
        curve = allan_deviation(y, 1.0, taus=[1, 8, 64])
        covered.append((curve.lower < true) & (true < curve.upper))
    share = np.mean(covered, axis=0)
    print(f"  with gaps 95 % limits at 1, 8, 64 s cover {np.round(100 * share, 1)} %")
    np.testing.assert_allclose(share, 0.95, atol=0.05)  # 200 records: 1.5 % one sigma, and kinds taken wrong
