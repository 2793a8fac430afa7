"""Readings: the forward equation, the converter, and noise that is what it says."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.sim import (
    BenchSettings,
    SimulatedDevice,
    SimulatedThermometer,
    SimulatedTriad,
    bench_motion,
    random_device,
    read,
    true_calibration,
)
from undrift.sim.device.read import round_to_step
from undrift.sim.motion.motion import Motion

SHORT = BenchSettings(still_s=1.0, turn_rates=(0.5, 1.5), dwell_s=1.0)


def still_motion(samples: int, sample_rate_hz: float = 100.0) -> Motion:
    zero = np.zeros((samples, 3))
    return Motion(
        time=np.arange(samples) / sample_rate_hz,
        q_nb=np.tile([1.0, 0.0, 0.0, 0.0], (samples, 1)),
        rate_b=zero,
        mean_rate_b=zero,
        force_b=zero + np.array([0.0, 0.0, 9.81]),
        gravity_m_s2=9.81,
        moving=np.zeros(samples),
    )


def plain(**changes: object) -> SimulatedTriad:
    return SimulatedTriad(**{"unit": "rad/s", "sensitivity": np.ones(3), "axes": np.eye(3), **changes})  # type: ignore[arg-type]


def device_of(gyro: SimulatedTriad, accel: SimulatedTriad | None = None, **changes: object) -> SimulatedDevice:
    return SimulatedDevice(serial="A", gyro=gyro, accel=accel or plain(unit="m/s2"), **changes)  # type: ignore[arg-type]


def test_the_true_calibration_undoes_a_reading_without_noise() -> None:
    device = random_device(np.random.default_rng(1)).without_noise()
    motion = bench_motion("bench", rng=np.random.default_rng(2), settings=SHORT)
    record = read(device, motion, rng=np.random.default_rng(3), temp_c=40.0).record
    truth = true_calibration(device, temp_c=40.0)
    assert truth.gyro is not None
    assert truth.accel is not None
    assert truth.gyro.g_sensitivity is not None
    force = (record.accel - truth.accel.offset) @ truth.accel.matrix.T
    rate = (record.gyro - truth.gyro.offset) @ truth.gyro.matrix.T - motion.force_b @ truth.gyro.g_sensitivity.T
    np.testing.assert_allclose(force, motion.force_b, atol=1e-10)
    np.testing.assert_allclose(rate, motion.mean_rate_b, atol=1e-12)


def test_one_effect_at_a_time_moves_the_reading_by_what_it_says() -> None:
    motion, rng = still_motion(10), np.random.default_rng(1)
    heated = read(device_of(plain(offset_per_k=[0.01, 0.0, -0.01])), motion, rng=rng, temp_c=35.0).record
    np.testing.assert_allclose(heated.gyro[0], [0.1, 0.0, -0.1])  # type: ignore[index]
    feigned = read(device_of(plain(g_sensitivity=np.outer([0.0, 1e-3, 0.0], [0, 0, 1]))), motion, rng=rng).record
    np.testing.assert_allclose(feigned.gyro[0], [0.0, 9.81e-3, 0.0])  # type: ignore[index]
    leaning = plain(unit="m/s2", axes=[[1.0, 0, 0], [0, 1, 0], [0.6, 0, 0.8]], sensitivity=[1.0, 1.0, 2.0])
    tipped = read(device_of(plain(), leaning), motion, rng=rng).record
    np.testing.assert_allclose(tipped.accel[0], [0.0, 0.0, 2.0 * 0.8 * 9.81])  # type: ignore[index]


def test_codes_are_cut_the_way_the_converter_cuts() -> None:
    values = np.array([-1.6, -0.4, 0.4, 1.6])
    np.testing.assert_array_equal(round_to_step(values, 1.0, "nearest"), [-2.0, 0.0, 0.0, 2.0])
    np.testing.assert_array_equal(round_to_step(values, 1.0, "floor"), [-2.0, -1.0, 0.0, 1.0])
    np.testing.assert_array_equal(round_to_step(values, 1.0, "toward_zero"), [-1.0, 0.0, 0.0, 1.0])
    np.testing.assert_array_equal(round_to_step(values, 0.0, "floor"), values)


def test_readings_beyond_full_scale_are_held_and_reported() -> None:
    reading = read(
        device_of(plain(), plain(unit="m/s2", full_scale=9.5)), still_motion(5), rng=np.random.default_rng(1)
    )
    np.testing.assert_array_equal(reading.record.accel[:, 2], 9.5)  # type: ignore[index]
    np.testing.assert_array_equal(reading.accel_saturated, np.tile([False, False, True], (5, 1)))
    assert not reading.gyro_saturated.any()


def test_white_noise_and_walk_have_the_stated_size() -> None:
    n, sample_rate_hz = 200_000, 100.0
    noisy = plain(random_walk=np.full(3, 0.002), bias_walk=np.full(3, 0.0))
    record = read(device_of(noisy), still_motion(n, sample_rate_hz), rng=np.random.default_rng(4)).record
    assert np.std(record.gyro) == pytest.approx(0.002 * np.sqrt(sample_rate_hz), rel=4.0 / np.sqrt(2 * 3 * n))
    walking = plain(bias_walk=np.full(3, 0.001))
    steps = np.diff(read(device_of(walking), still_motion(n), rng=np.random.default_rng(4)).record.gyro, axis=0)  # type: ignore[arg-type]
    assert np.std(steps) == pytest.approx(0.001 / np.sqrt(sample_rate_hz), rel=4.0 / np.sqrt(2 * 3 * n))


def test_adding_an_effect_leaves_the_noise_of_the_others_alone() -> None:
    motion = still_motion(50)
    quiet = device_of(plain(random_walk=np.full(3, 0.01)))
    busy = replace(
        quiet,
        accel=plain(unit="m/s2", random_walk=np.full(3, 0.1)),
        thermometer=SimulatedThermometer(noise_c=0.1),
    )
    first = read(quiet, motion, rng=np.random.default_rng(9)).record
    second = read(busy, motion, rng=np.random.default_rng(9)).record
    np.testing.assert_array_equal(first.gyro, second.gyro)
    assert np.std(second.accel[:, 2]) > 0.0  # type: ignore[index]
    assert np.std(second.temp_c) > 0.0  # type: ignore[arg-type]


def test_an_instant_gyroscope_reads_the_rate_at_the_sample() -> None:
    motion = bench_motion("ferraris", rng=np.random.default_rng(2), settings=SHORT)
    record = read(device_of(plain(), sampling="instant"), motion, rng=np.random.default_rng(3)).record
    np.testing.assert_array_equal(record.gyro, motion.rate_b)
    mean = read(device_of(plain()), motion, rng=np.random.default_rng(3)).record
    np.testing.assert_array_equal(mean.gyro, motion.mean_rate_b)


def test_a_thermometer_lags_and_steps() -> None:
    motion = still_motion(1000, 10.0)
    lagging = device_of(plain(), thermometer=SimulatedThermometer(lag_s=20.0, offset_c=1.0))
    step = np.where(motion.time < 10.0, 20.0, 30.0)
    temp = read(lagging, motion, rng=np.random.default_rng(1), temp_c=step).record.temp_c
    assert temp is not None
    assert temp[50] == pytest.approx(21.0)
    assert temp[300] == pytest.approx(31.0 - 10.0 * np.exp(-20.1 / 20.0), abs=1e-9)  # sample 100 is the first hot one
    coarse = device_of(plain(), thermometer=SimulatedThermometer(lsb_c=0.5))
    assert set(np.unique(read(coarse, motion, rng=np.random.default_rng(1), temp_c=20.3).record.temp_c)) == {20.5}  # type: ignore[arg-type]


def test_axes_that_are_not_unit_vectors_and_a_temperature_of_another_length_are_refused() -> None:
    with pytest.raises(InputError, match="wanted unit vectors as axes"):
        plain(axes=2.0 * np.eye(3))
    with pytest.raises(InputError, match=r"temp_c: wanted shape \(10,\), got \(3,\)"):
        read(device_of(plain()), still_motion(10), rng=np.random.default_rng(1), temp_c=np.zeros(3))
