"""The chain as a whole, its bookkeeping, streams that leave each other alone, and a device that is read as time goes on."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.quiet import without_noise
from testkit.simulated_device import chain, device_of, motion_of, run, still_motion
from undrift.correction.correct import correct
from undrift.errors import InputError
from undrift.sim.device.effects import (
    Adc,
    Amplifier,
    BiasInstability,
    GSensitivity,
    LowPass,
    RandomWalk,
    Sampling,
    Thermometer,
    WhiteNoise,
)
from undrift.sim.device.presets import preset, random_device
from undrift.sim.device.simulate import SimulatedDevice, simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings, bench_motion
from undrift.sim.motion.tasks import draw_task

SHORT = BenchSettings(still_s=1.0, turn_rates=(0.5, 1.5), dwell_s=1.0)


def test_the_true_calibration_undoes_a_reading_without_noise() -> None:
    device = without_noise(random_device(np.random.default_rng(1)))
    motion = bench_motion("bench", rng=np.random.default_rng(2), settings=SHORT)
    record = simulate_device(device, motion, rng=np.random.default_rng(3), temp_c=40.0).record
    done = correct(record, true_calibration(device, temp_c=40.0))
    np.testing.assert_allclose(done.accel, motion.force_b, atol=1e-10)
    np.testing.assert_allclose(done.gyro, motion.mean_rate_b, atol=1e-12)


def test_truth_and_contributions_add_up_to_the_reading() -> None:
    rng = np.random.default_rng(5)
    motion = draw_task("free", rng=rng).at(np.arange(8000) / 400.0, 9.81)
    device = random_device(rng)
    device = replace(
        device,
        gyro=replace(
            device.gyro,
            amplifier=Amplifier(gain=1.0, low=-1000.0, high=1000.0),
            low_pass=LowPass(cutoff_hz=np.full(3, 11.1)),
        ),
    )
    for sampling in (Sampling(), Sampling(sample_rate_hz=90.0, jitter_s=1e-4, clock_error=1e-4)):
        made = simulate_device(replace(device, sampling=sampling), motion, rng=rng, temp_c=31.0)
        for model, triad, reading in (
            (device.gyro, made.gyro, made.record.gyro),
            (device.accel, made.accel, made.record.accel),
        ):
            total = triad.true + sum(triad.contributions.values())
            np.testing.assert_allclose(total, (reading - model.null) / model.gain, atol=1e-11)  # type: ignore[operator]
        names = list(made.gyro.contributions)
        assert names[:3] == ["scale", "g_sensitivity", "offset"]
        assert names[-1] == "adc"
        assert not made.gyro.of("warm_up").any()
        assert made.gyro.saturated.any()
        assert not made.accel.saturated.any()


def test_the_same_seed_gives_the_same_readings_and_an_effect_more_leaves_the_noise_of_the_others_alone() -> None:
    motion = still_motion(200)
    quiet = device_of(chain(white_noise=WhiteNoise(random_walk=np.full(3, 0.01))))
    busy = device_of(
        replace(
            quiet.gyro,
            instability=BiasInstability(instability=np.full(3, 0.01)),
            random_walk=RandomWalk(bias_walk=np.full(3, 0.01)),
        ),
        chain("m/s2", white_noise=WhiteNoise(random_walk=np.full(3, 0.1))),
        thermometer=Thermometer(noise_c=0.1),
        sampling=Sampling(gyro_averaging="instant", jitter_s=0.0),
    )
    first, again, second = run(quiet, motion, 9), run(quiet, motion, 9), run(busy, motion, 9)
    np.testing.assert_array_equal(first.record.gyro, again.record.gyro)  # type: ignore[arg-type]
    np.testing.assert_array_equal(first.gyro.of("white_noise"), second.gyro.of("white_noise"))
    for noisy in (second.gyro.of("instability"), second.gyro.of("random_walk"), second.accel.of("white_noise")):
        assert np.std(noisy) > 0.0
    assert np.std(second.record.temp_c) > 0.0  # type: ignore[arg-type]
    assert not np.array_equal(run(quiet, motion, 10).record.gyro, first.record.gyro)  # type: ignore[arg-type]


def test_readings_are_gaps_where_the_motion_is_unknown() -> None:
    n = 400
    rate, valid = np.full((n, 3), 0.5), np.ones(n)
    rate[100:150], valid[100:150] = np.nan, 0.0
    motion = motion_of(np.arange(n) / 100.0, rate, valid=valid)
    device = device_of(
        chain(low_pass=LowPass(cutoff_hz=np.full(3, 10.0)), white_noise=WhiteNoise(random_walk=np.full(3, 1e-3)))
    )
    record = run(device, motion).record
    assert np.isnan(record.gyro[100:150]).all()  # type: ignore[index]
    assert np.isfinite(record.gyro[150:]).all()  # type: ignore[index]
    assert np.isnan(record.accel[100:150]).all()  # type: ignore[index]
    blind = motion_of(motion.time, rate, np.full((n, 3), np.nan), valid=valid)
    assert run(device, blind).record.accel is None
    with pytest.raises(InputError, match="no specific force"):
        run(device_of(chain(g_sensitivity=GSensitivity(matrix=np.eye(3)))), blind)
    with pytest.raises(InputError, match="samples are unknown"):
        run(device, motion_of(motion.time, np.full((n, 3), np.nan), valid=np.zeros(n)))


def test_readings_beyond_the_codes_are_held_and_reported() -> None:
    coarse = Adc(bits=8, reference=9.5, codes=False)
    made = run(device_of(accel=chain("m/s2", adc=coarse)), still_motion(5))
    np.testing.assert_allclose(made.record.accel[:, 2], 127.0 * 9.5 / 128.0)  # type: ignore[index]
    np.testing.assert_array_equal(made.accel.saturated, np.tile([False, False, True], (5, 1)))
    assert not made.gyro.saturated.any()


STEP_S = 0.01


def read_in_pieces(device, columns, cuts, *, power_on_s, seed=4):
    """Read the rows of columns, of which row 0 is met at the first reading."""

    def surroundings(times, step_s):
        rows = np.rint(times / step_s).astype(int) - 1
        return tuple(column[rows] for column in columns)

    read = SimulatedDevice(device, surroundings, seed, 0.0, power_on_s=power_on_s - STEP_S)
    return np.concatenate([read.read(row * STEP_S)[1] for row in cuts[1:]])


def situation(kind):
    rng = np.random.default_rng(1)
    device = random_device(rng, grade="consumer") if kind == "consumer" else preset(kind)
    clock = replace(device.sampling, sample_rate_hz=None, clock_error=0.0, jitter_s=0.0)
    clock = replace(clock, gyro_delay_s=np.zeros(3), accel_delay_s=np.zeros(3))
    thermometer = Thermometer(lag_s=20.0, trim_error_c=0.4, self_heating_c=0.5)
    motion = bench_motion("rate_table", rng=rng, settings=BenchSettings(turn_rates=(0.5, 1.5)))
    temp = 25.0 + 6.0 * np.sin(np.arange(len(motion)) * 0.01)
    return replace(device, thermometer=thermometer, sampling=clock), motion, temp


@pytest.mark.parametrize(("kind", "size"), [("consumer", 7), ("enc03j_3031", 1), ("enc03j_3031", 100_000)])
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


def test_the_noise_is_that_of_the_whole_simulation_at_every_time_scale():
    device, _, _ = situation("consumer")
    device, count = replace(device, gyro=replace(device.gyro, adc=None)), 20_000
    still = np.zeros((count, 3))
    pieces, whole = (
        read_in_pieces(device, (still, still, still, still, np.full(count, 25.0)), cuts, power_on_s=1e6)[:, :3]
        for cuts in ([*range(0, count, 40), count], [0, count])
    )
    for length in (1, 10, 100, 1000):
        sizes = [np.diff(x.reshape(-1, length, 3).mean(axis=1), axis=0).std() for x in (pieces, whole)]
        assert sizes[0] == pytest.approx(sizes[1], rel=0.35)
