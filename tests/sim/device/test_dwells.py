"""Dwells against the device's readings sample by sample."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.simulate import Dwells, simulate_device, simulate_dwells
from undrift.sim.motion.motion import Motion

G = 9.80665


def device(name: str, seed: int = 3) -> DeviceModel:
    return random_device_of(name, np.random.default_rng(seed))


def dwells(n: int, *, duration_s: float = 2.0, seed: int = 4) -> Dwells:
    draw = np.random.default_rng(seed)
    return Dwells(
        start_s=600.0 + 5.0 * np.arange(n),
        duration_s=np.full(n, duration_s),
        rate_b=draw.uniform(-1.5, 1.5, (n, 3)),
        force_b=np.tile([0.0, 0.0, G], (n, 1)),
        temp_c=np.linspace(20.0, 70.0, n),
    )


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
    found = simulate_dwells(quiet, imposed, rng=np.random.default_rng(0))
    for k in range(6):
        motion = held(imposed.rate_b[k], 200, float(imposed.start_s[k]))
        record = simulate_device(
            quiet,
            motion,
            rng=np.random.default_rng(0),
            temp_c=float(imposed.temp_c[k]),
            power_on_s=float(imposed.start_s[k]),
        ).record
        assert record.gyro is not None
        assert record.accel is not None
        # the warm-up dies away by 1e-7 of a reading over two seconds
        np.testing.assert_allclose(found.gyro[k], record.gyro.mean(axis=0), rtol=1e-6)
        np.testing.assert_allclose(found.accel[k], record.accel.mean(axis=0), rtol=1e-9)


@pytest.mark.parametrize("name", ["enc03j_3031", "mpu6050"])
def test_scatter_in_a_dwell_and_between_dwells_is_that_of_the_samples(name: str) -> None:
    noisy, n = device(name), 400
    imposed = Dwells(
        start_s=600.0 + 2.5 * np.arange(n),
        duration_s=np.full(n, 2.0),
        rate_b=np.zeros((n, 3)),
        force_b=np.tile([0.0, 0.0, G], (n, 1)),
        temp_c=np.full(n, 25.0),
    )
    found = simulate_dwells(noisy, imposed, rng=np.random.default_rng(1))
    record = simulate_device(
        noisy, held(np.zeros(3), 250 * n, 600.0), rng=np.random.default_rng(2), power_on_s=600.0
    ).record
    assert record.gyro is not None
    blocks = record.gyro.reshape(n, 250, 3)[:, :200]
    inside = found.gyro_variance.mean(axis=0) / blocks.var(axis=1, ddof=1).mean(axis=0)
    np.testing.assert_allclose(inside, 1.0, atol=0.1)  # the variance inside a dwell, 400 dwells
    steps = np.diff(found.gyro, axis=0).var(axis=0) / np.diff(blocks.mean(axis=1), axis=0).var(axis=0)
    np.testing.assert_allclose(steps, 1.0, atol=0.35)  # variance of 400 steps: 7 % each way, flicker is drawn coarser


def test_the_same_generator_gives_the_same_readings() -> None:
    one = simulate_dwells(device("enc03j_3031"), dwells(5), rng=np.random.default_rng(5))
    two = simulate_dwells(device("enc03j_3031"), dwells(5), rng=np.random.default_rng(5))
    assert (one.gyro == two.gyro).all()
    assert (one.accel == two.accel).all()


def test_dwells_out_of_order_are_refused() -> None:
    good = dwells(3)
    with pytest.raises(InputError, match="one after the other"):
        replace(good, start_s=good.start_s[::-1])


def test_a_converter_that_cuts_toward_zero_is_refused() -> None:
    signed = device("mpu6050")
    assert signed.gyro.adc is not None
    cut = replace(signed, gyro=replace(signed.gyro, adc=replace(signed.gyro.adc, rounding="toward_zero")))
    with pytest.raises(InputError, match="straight converter"):
        simulate_dwells(cut, dwells(3), rng=np.random.default_rng(6))
