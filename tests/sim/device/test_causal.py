"""A device read as time goes on says what the whole simulation says, however the time is cut."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from testkit.quiet import without_noise
from undrift.sim.device.causal import CausalDevice
from undrift.sim.device.effects import Scene, Thermometer, scene_of
from undrift.sim.device.presets import preset, random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.bench import BenchSettings, bench_motion

KINDS = ["consumer", "enc03j_3031"]


def cut(scene: Scene, start: int, stop: int) -> Scene:
    part = slice(start, stop)
    return replace(
        scene,
        time=scene.time[part],
        temp_c=scene.temp_c[part],
        warmth=scene.warmth[part],
        age_s=scene.age_s[part],
        rate_b=scene.rate_b[part],
        force_b=scene.force_b[part],
        angular_acceleration_b=None if scene.angular_acceleration_b is None else scene.angular_acceleration_b[part],
    )


def read_in_pieces(device, scene, mean_rate, cuts, seed=4):
    causal = CausalDevice(device, scene.step_s, np.random.default_rng(seed))
    said = [causal.read(cut(scene, a, b), mean_rate[a:b]) for a, b in pairwise(cuts)]
    return [np.concatenate(parts) for parts in zip(*said, strict=True)]


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
    scene = scene_of(motion, temp, device.reference_temp_c, 30.0)
    n = min(len(motion), 700 if size == 1 else 100_000)
    gyro, accel, temp_c = read_in_pieces(device, scene, motion.mean_rate_b, [*range(0, n, size), n])
    assert gyro == pytest.approx(whole.gyro[:n], rel=1e-9, abs=1e-9)
    assert accel == pytest.approx(whole.accel[:n], rel=1e-9, abs=1e-9)
    assert temp_c == pytest.approx(whole.temp_c[:n], abs=1e-9)


def noise_of(device, cuts, n=20_000):
    still = np.zeros((n, 3))
    time = np.arange(1, n + 1) * 0.01
    scene = Scene(
        time=time,
        step_s=0.01,
        temp_c=np.full(n, 25.0),
        warmth=np.zeros(n),
        age_s=time + 1e6,
        rate_b=still,
        angular_acceleration_b=still,
        force_b=still,
    )
    return read_in_pieces(device, scene, still, cuts)[0]


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
