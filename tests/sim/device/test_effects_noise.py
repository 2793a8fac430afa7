"""Noise: the Allan deviation of each kind at rest has the slope and the height that IEEE Std 952 gives it."""

import math

import numpy as np
import pytest

from testkit.data import show
from testkit.simulated_device import chain, device_of, run, still_motion
from undrift.calibration.noise import allan_deviation
from undrift.sim.device.effects import BiasInstability, LowPass, RandomWalk, Sampling, WhiteNoise

N, RATE_HZ = 400_000, 100.0


def deviations(gyro: np.ndarray, taus: list[float]) -> np.ndarray:
    """Return the root-mean-square over the three axes."""
    axes = [allan_deviation(gyro[:, k], RATE_HZ, taus=taus).deviation for k in range(3)]
    return np.sqrt(np.mean(np.square(axes), axis=0))


@pytest.fixture(scope="module")
def rest():  # type: ignore[no-untyped-def]
    return still_motion(N, RATE_HZ)


def test_white_noise_falls_with_the_root_of_the_time(rest) -> None:  # type: ignore[no-untyped-def]
    gyro = run(device_of(chain(white_noise=WhiteNoise(random_walk=np.full(3, 0.002)))), rest).record.gyro
    assert np.std(gyro) == pytest.approx(0.02, rel=4.0 / math.sqrt(6.0 * N))  # type: ignore[arg-type]
    taus = [0.01, 0.1, 1.0]
    ratio = deviations(gyro, taus) * np.sqrt(taus) / 0.002  # type: ignore[arg-type]
    show("white noise: Allan deviation over N / sqrt(tau)", np.round(ratio, 3), "1 +- 0.02")
    np.testing.assert_allclose(ratio, 1.0, atol=0.02)  # 4 standard errors at 1 s: 4 / sqrt(2 * 3 * 4000 * 1.5)


@pytest.mark.parametrize("averaging", ["instant", "interval"])
def test_white_noise_off_the_grid_is_that_of_the_devices_own_rate(averaging: str) -> None:
    clock = Sampling(sample_rate_hz=80.0, clock_error=1e-3, gyro_averaging=averaging)  # type: ignore[arg-type]
    device = device_of(chain(white_noise=WhiteNoise(random_walk=np.full(3, 0.002))), sampling=clock)
    gyro = run(device, still_motion(100_000, RATE_HZ)).record.gyro
    sd = np.std(gyro)  # type: ignore[arg-type]
    assert sd == pytest.approx(0.002 * math.sqrt(80.0), rel=4.0 / math.sqrt(6.0 * 80_000))


def test_white_noise_behind_a_low_pass_keeps_its_level_at_low_frequency() -> None:
    low_pass = LowPass(cutoff_hz=np.full(3, 10.0))
    device = device_of(chain(white_noise=WhiteNoise(random_walk=np.full(3, 0.002)), low_pass=low_pass))
    gyro = run(device, still_motion(N, RATE_HZ)).record.gyro
    assert deviations(gyro, [1.0])[0] == pytest.approx(0.002, rel=0.04)  # type: ignore[arg-type]


def test_a_random_walk_rises_with_the_root_of_the_time(rest) -> None:  # type: ignore[no-untyped-def]
    made = run(device_of(chain(random_walk=RandomWalk(bias_walk=np.full(3, 0.001)))), rest).gyro.of("random_walk")
    np.testing.assert_array_equal(made[0], 0.0)
    assert np.std(np.diff(made, axis=0)) == pytest.approx(1e-4, rel=4.0 / math.sqrt(6.0 * N))
    taus = [1.0, 10.0, 40.0]
    ratio = deviations(made, taus) / (0.001 * np.sqrt(np.array(taus) / 3.0))
    show("random walk: Allan deviation over K sqrt(tau / 3)", np.round(ratio, 3), "1 +- 0.2")
    assert (np.abs(ratio - 1.0) < [0.03, 0.1, 0.2]).all()  # 4 / sqrt(6 T / tau), T = 4000 s


@pytest.mark.slow
def test_bias_instability_is_flat_at_its_floor(rest) -> None:  # type: ignore[no-untyped-def]
    flicker = BiasInstability(instability=np.full(3, 0.01), shortest_s=0.01, longest_s=1e4)
    made = run(device_of(chain(instability=flicker)), rest).gyro.of("instability")
    taus = [0.5, 2.0, 8.0, 32.0]
    ratio = deviations(made, taus) / (0.01 * math.sqrt(2.0 * math.log(2.0) / math.pi))
    show("bias instability: Allan deviation over 0.664 B", np.round(ratio, 3), "1 +- 0.15")
    assert (np.abs(ratio - 1.0) < [0.05, 0.06, 0.1, 0.15]).all()  # 2 % ripple and 4 / sqrt(6 T / tau)
