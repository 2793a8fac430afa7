"""A device read as time goes on says what the whole simulation says, however the time is cut."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.quiet import without_noise
from undrift.sim.device.causal import SimulatedDevice
from undrift.sim.device.effects import Thermometer
from undrift.sim.device.presets import preset, random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.bench import BenchSettings, bench_motion

KINDS = ["consumer", "enc03j_3031"]


STEP_S = 0.01


def read_in_pieces(device, columns, cuts, *, power_on_s, seed=4):
    """Read the rows of columns, of which row 0 is met at the first reading."""

    def surroundings(times, step_s):
        rows = np.rint(times / step_s).astype(int) - 1
        return tuple(column[rows] for column in columns)

    read = SimulatedDevice(device, surroundings, seed, 0.0, power_on_s=power_on_s - STEP_S)
    return np.concatenate([read.read(row * STEP_S)[1] for row in cuts[1:]])


def situation(kind, seed=1):
    rng = np.random.default_rng(seed)
    device = random_device(rng, grade="consumer") if kind == "consumer" else preset(kind)
    device = replace(device, thermometer=Thermometer(lag_s=20.0, trim_error_c=0.4, self_heating_c=0.5))
    device = replace(device, sampling=replace(device.sampling, sample_rate_hz=None, clock_error=0.0, jitter_s=0.0))
    device = replace(
        device,
        sampling=replace(device.sampling, gyro_delay_s=np.zeros(3), accel_delay_s=np.zeros(3)),
    )
    motion = bench_motion("rate_table", rng=rng, settings=BenchSettings(turn_rates=(0.5, 1.5)))
    temp = 25.0 + 6.0 * np.sin(np.arange(len(motion)) * 0.01)
    return device, motion, temp


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [1, 7, 100_000])
def test_without_noise_the_readings_are_those_of_the_whole_simulation(kind, size):
    device, motion, temp = situation(kind)
    device = without_noise(device)
    whole = simulate_device(device, motion, rng=np.random.default_rng(0), temp_c=temp, power_on_s=30.0).record
    columns = (motion.rate_b, motion.angular_acceleration_b, motion.force_b, motion.mean_rate_b, temp)
    n = min(len(motion), 700 if size == 1 else 100_000)
    said = read_in_pieces(device, columns, [*range(0, n, size), n], power_on_s=30.0)
    gyro, accel, temp_c = said[:, :3], said[:, 3:6], said[:, 6]
    assert gyro == pytest.approx(whole.gyro[:n], rel=1e-9, abs=1e-9)
    assert accel == pytest.approx(whole.accel[:n], rel=1e-9, abs=1e-9)
    assert temp_c == pytest.approx(whole.temp_c[:n], abs=1e-9)


def noise_of(device, cuts, n=20_000):
    still = np.zeros((n, 3))
    return read_in_pieces(device, (still, still, still, still, np.full(n, 25.0)), cuts, power_on_s=1e6)[:, :3]


def deviation_of_means(x, length):
    means = x[: len(x) // length * length].reshape(-1, length, 3).mean(axis=1)
    return np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2))


def test_the_noise_is_that_of_the_whole_simulation_at_every_time_scale():
    device, _, _ = situation("consumer")
    device = replace(device, gyro=replace(device.gyro, adc=None))
    pieces = noise_of(device, [*range(0, 20_000, 40), 20_000])
    whole = noise_of(device, [0, 20_000])
    for length in (1, 10, 100, 1000):
        assert deviation_of_means(pieces, length) == pytest.approx(deviation_of_means(whole, length), rel=0.35)
