"""Dwells against the device's readings sample by sample."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.sim.device.effects import WhiteNoise
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.kernels import add_drift
from undrift.sim.motion.motion import Motion
from undrift.sim.table_sessions import ImposedDwells, mean_readings, numbers_of_dwell

G = 9.80665


def device(name: str, seed: int = 3) -> DeviceModel:
    return random_device(np.random.default_rng(seed), grade=name)


def dwells(n: int, *, duration_s: float = 2.0, seed: int = 4) -> ImposedDwells:
    draw = np.random.default_rng(seed)
    return ImposedDwells(
        start_s=600.0 + 5.0 * np.arange(n),
        duration_s=np.full(n, duration_s),
        rate_b=draw.uniform(-1.5, 1.5, (n, 3)),
        force_b=np.tile([0.0, 0.0, G], (n, 1)),
    )


def drawn(made: DeviceModel, imposed: ImposedDwells, seed: int = 0, name: str = "gyro") -> np.ndarray:
    chain = made.gyro if name == "gyro" else made.accel
    normals = np.random.default_rng(seed).standard_normal((len(imposed.start_s), 3, numbers_of_dwell(chain)))
    return mean_readings(made, name, imposed, normals, np.arange(len(imposed.start_s)))  # type: ignore[arg-type]


def held(rate: np.ndarray, samples: int, start_s: float, sample_rate_hz: float = 100.0) -> Motion:
    return Motion(
        time=start_s + np.arange(samples) / sample_rate_hz,
        q_nb=np.tile([1.0, 0.0, 0.0, 0.0], (samples, 1)),
        rate_b=np.tile(rate, (samples, 1)),
        mean_rate_b=np.tile(rate, (samples, 1)),
        force_b=np.tile([0.0, 0.0, G], (samples, 1)),
        gravity_m_s2=G,
        moving=np.ones(samples),
        angular_acceleration_b=np.zeros((samples, 3)),
    )


@pytest.mark.parametrize("name", ["enc03j_3031", "mpu6050", "bmi270"])
def test_without_noise_a_dwell_is_the_mean_of_the_samples(name: str) -> None:
    quiet = device(name)
    bare = {"white_noise": None, "instability": None, "random_walk": None, "hysteresis": None, "adc": None}
    quiet = replace(quiet, gyro=replace(quiet.gyro, **bare), accel=replace(quiet.accel, **bare))
    imposed = dwells(6)
    gyro, accel = drawn(quiet, imposed), drawn(quiet, imposed, name="accel")
    for k in range(6):
        motion = held(imposed.rate_b[k], 200, float(imposed.start_s[k]))
        record = simulate_device(
            quiet,
            motion,
            rng=np.random.default_rng(0),
            temp_c=25.0,
            power_on_s=float(imposed.start_s[k]),
        ).record
        assert record.gyro is not None
        assert record.accel is not None
        # the warm-up dies away by 1e-7 of a reading over two seconds
        np.testing.assert_allclose(gyro[k], record.gyro.mean(axis=0), rtol=1e-6)
        np.testing.assert_allclose(accel[k], record.accel.mean(axis=0), rtol=1e-9)


@pytest.mark.parametrize("name", ["enc03j_3031", "mpu6050"])
def test_scatter_of_dwells_and_between_dwells_is_that_of_the_samples(name: str) -> None:
    noisy, n = device(name), 400
    imposed = ImposedDwells(
        start_s=600.0 + 2.5 * np.arange(n),
        duration_s=np.full(n, 2.0),
        rate_b=np.zeros((n, 3)),
        force_b=np.tile([0.0, 0.0, G], (n, 1)),
    )
    found = drawn(noisy, imposed, seed=1)
    record = simulate_device(
        noisy, held(np.zeros(3), 250 * n, 600.0), rng=np.random.default_rng(2), power_on_s=600.0
    ).record
    assert record.gyro is not None
    blocks = record.gyro.reshape(n, 250, 3)[:, :200]
    steps = np.diff(found, axis=0).var(axis=0) / np.diff(blocks.mean(axis=1), axis=0).var(axis=0)
    np.testing.assert_allclose(steps, 1.0, atol=0.25)  # variance of 400 steps: 7 % each way, 10 % together, 2.5 sigma


@pytest.mark.parametrize("sd", [0.4, 1.5])
def test_scatter_of_the_mean_of_rounded_readings_is_that_of_samples(sd: float) -> None:
    n, runs, draw = 200, 2000, np.random.default_rng(8)
    exact = device("mpu6050")
    bare = {"instability": None, "random_walk": None, "warm_up": None}
    walk = np.full(3, sd / exact.gyro.gain / 10.0)  # sd codes at 100 Hz
    noisy = replace(exact, gyro=replace(exact.gyro, **bare, white_noise=WhiteNoise(random_walk=walk)))
    quiet = replace(noisy, gyro=replace(noisy.gyro, white_noise=None, adc=None))
    found = drawn(noisy, dwells(runs)) - drawn(quiet, dwells(runs)) * noisy.gyro.gain / quiet.gyro.gain
    level = draw.uniform(size=(runs, 1))
    of_samples = np.rint(level + sd * draw.standard_normal((runs, n))).mean(axis=1, keepdims=True) - level
    assert found.std() == pytest.approx(
        of_samples.std(), rel=0.08
    )  # 2000 draws: 1.6 % each way; bias of 0.013 codes at 0.4


def test_the_drift_between_dwells_has_the_covariance_of_its_processes() -> None:
    """One process and the walk: variances and covariances of means over dwells of unlike length and gap, from the integrals."""
    tau, sd, k, runs, rng = 30.0, 0.004, 2e-4, 4000, np.random.default_rng(6)
    start, length = np.array([0.0, 2.5, 40.0, 47.0]), np.array([2.0, 6.0, 2.0, 50.0])
    drift, numbers = np.zeros((4 * runs, 3)), rng.standard_normal((4 * runs, 3, 5))
    sessions, rows = np.arange(0, 4 * runs + 1, 4), np.arange(4 * runs)
    times = np.tile(start, runs) + 600.0, np.tile(length, runs)
    add_drift(numbers, rows, *times, sessions, np.array([tau]), np.full((1, 3), sd), np.full(3, k), drift)
    means = drift.reshape(runs, 4, 3)
    for i in range(4):
        for j in range(i + 1):
            s = start[i] + length[i] * (np.arange(400) + 0.5) / 400.0
            t = start[j] + length[j] * (np.arange(400) + 0.5) / 400.0
            apart = np.abs(s[:, None] - t[None, :])
            wanted = (sd * sd * np.exp(-apart / tau)).mean() + k * k * np.minimum(s[:, None], t[None, :]).mean()
            found = (means[:, i] * means[:, j]).mean()
            own = sd * sd + k * k * 100.0
            show(f"covariance of dwells {i} and {j}, of the process' variance", found / own, f"{wanted / own:.3f}")
            assert found == pytest.approx(wanted, abs=0.05 * own)  # 12,000 products: 1.3 % each way at most


def test_a_converter_that_cuts_toward_zero_is_refused() -> None:
    signed = device("mpu6050")
    assert signed.gyro.adc is not None
    cut = replace(signed, gyro=replace(signed.gyro, adc=replace(signed.gyro.adc, rounding="toward_zero")))
    with pytest.raises(InputError, match="straight converter"):
        drawn(cut, dwells(3))
