"""The kernel of trials: equal to its stages one after the other, to any batch and thread, with noise that is noise."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.calibration.model import DriftTables, WarmUp
from undrift.correct import correct
from undrift.errors import InputError
from undrift.orientation.angles import sagittal_pitch
from undrift.orientation.strapdown import integrate_strapdown
from undrift.sim.device import simulate as stages
from undrift.sim.device.adc import Adc
from undrift.sim.device.noise import RandomWalk
from undrift.sim.device.presets import preset, random_device_of
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.motion.motion import Motion, mean_rate
from undrift.trial import Trial, TrialSettings, run_trials, trial_bench, trial_device, trial_noise

RATE_HZ = 286.0
TEMPS = np.linspace(5.0, 45.0, 9)


def nodding(seconds, lean, *, slow=0.3, rate_hz=RATE_HZ):
    """A motion that leans forward and back while it turns a little about the other axes; exact rates by its orientation."""
    time = np.arange(int(seconds * rate_hz)) / rate_hz
    phase = 2.0 * np.pi * slow * time
    pitch, roll, yaw = lean * np.sin(phase) ** 2, 0.1 * np.sin(1.3 * phase), 0.2 * np.sin(0.7 * phase)
    (cy, sy), (cp, sp), (cr, sr) = ((np.cos(0.5 * a), np.sin(0.5 * a)) for a in (yaw, pitch, roll))
    q = np.column_stack(
        (
            cy * cp * cr + sy * sp * sr,
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
        )
    )
    rate = mean_rate(time, q, np.zeros(3))
    force = np.tile([0.0, 0.0, 9.81], (len(time), 1))
    return Motion(
        time=time,
        q_nb=q,
        rate_b=rate,
        mean_rate_b=rate,
        force_b=force,
        gravity_m_s2=9.81,
        moving=np.ones(len(time)),
        angular_acceleration_b=np.zeros_like(rate),  # for the accelerometers, which a trial does not read
    )


def table_of(device):
    """Calibration with the true matrix and the true table of offsets."""
    static = true_tables(device, TEMPS, np.array([-3.0, 0.0, 3.0])).static
    calibration = true_calibration(device)
    return replace(
        calibration,
        gyro=replace(calibration.gyro, g_sensitivity=None),
        drift=DriftTables(static=static),
    )


def units(count, rng):
    """Devices of the note's kind with what the kernel knows."""
    found = [trial_device(random_device_of("enc03j_3031", rng, serial=f"u{i}")) for i in range(count)]
    walk = RandomWalk(bias_walk=np.array([2e-4, 1e-4, 3e-4]))
    return [replace(device, gyro=replace(device.gyro, random_walk=walk)) for device in found]


class Given:
    """Streams that hand out given numbers."""

    def __init__(self, white, walk):
        self._of = {"gyro_white": white, "gyro_walk": walk}

    def of(self, effect):
        numbers = self._of.get(effect)
        return np.random.default_rng(0) if numbers is None else self._Fixed(numbers)

    class _Fixed:
        def __init__(self, numbers):
            self._numbers = numbers

        def standard_normal(self, shape):
            assert shape == self._numbers.shape
            return self._numbers


def stage_by_stage(monkeypatch, motion, device, calibration, trial, settings):
    """Simulate, correct, integrate, compare: each stage with its array."""
    noise = trial_noise(settings.seed, trial.number, len(motion))
    monkeypatch.setattr(stages, "draw_streams", lambda rng: Given(*noise))
    temp = trial.temp_c + trial.warming_k_per_s * (motion.time - motion.time[0])
    record = stages.simulate_device(
        device, motion, rng=np.random.default_rng(0), temp_c=temp, power_on_s=settings.power_on_s
    ).record
    gyro = correct(record, calibration, policy="hold").gyro
    q = integrate_strapdown(gyro, motion.time, motion.q_nb[0])
    error = sagittal_pitch(q) - sagittal_pitch(motion.q_nb)
    error = np.arctan2(np.sin(error), np.cos(error))
    return np.sqrt(np.mean(error**2)), np.abs(error).max()


def test_the_kernel_equals_its_stages_one_after_the_other_with_all_its_noise(monkeypatch):
    rng = np.random.default_rng(3)
    motions = [nodding(2.0, 0.7), nodding(3.0, 0.4), nodding(1.0, 1.2, slow=1.5)]
    devices = units(3, rng)
    calibrations = [table_of(device) for device in devices] + [replace(table_of(devices[0]), drift=None)]
    plan = [
        Trial(k % 3, k // 3, k // 3, 100 + k, temp, slope)
        for k, (temp, slope) in enumerate(zip(np.linspace(12.0, 38.0, 9), np.linspace(-1.5, 1.5, 9), strict=True))
    ] + [Trial(1, 0, 3, 7, 25.0, 0.0), Trial(0, 1, 0, 8, 20.0, 0.0)]  # without a table; of another device
    settings = TrialSettings(seed=5, power_on_s=40.0)
    difference, twin = against_stages(monkeypatch, motions, devices, calibrations, plan, settings)
    show("kernel against its stages, rad", difference, 1e-12)
    assert difference < 1e-12
    assert twin.min() > 0.0
    assert twin.max() > 0.5  # beyond 28 deg, where the series for the pitch's error ends


def against_stages(monkeypatch, motions, devices, calibrations, plan, settings):
    """Largest difference of RMS and maximum, rad, and what the stages found."""
    (found,) = run_trials(trial_bench(motions, devices, calibrations, settings), plan)
    assert list(found.number) == [t.number for t in plan]
    twin = np.array(
        [
            stage_by_stage(monkeypatch, motions[t.motion], devices[t.device], calibrations[t.calibration], t, settings)
            for t in plan
        ]
    )
    return np.abs(np.stack((found.rms, found.maximum), axis=1) - twin).max(), twin


@pytest.mark.parametrize("bare", [False, True])
def test_fast_turns_at_a_low_sample_rate_and_other_converters_equal_their_stages(monkeypatch, bare):
    device = units(1, np.random.default_rng(6))[0]
    device = with_gyro(device, adc=Adc(bits=10, reference=5.0, signed=False, rounding="floor"))
    thermometer = replace(device.thermometer, lag_s=0.0, step_c=0.0)
    if bare:
        device = with_gyro(device, adc=None, amplifier=None, low_pass=None, white_noise=None, unit="rad/s")
        device = replace(device, gyro=replace(device.gyro, scale=replace(device.gyro.scale, nominal_sensitivity=1.0)))
    device = replace(device, thermometer=thermometer)
    motion = nodding(8.0, 1.2, slow=0.8, rate_hz=20.0)
    half = np.linalg.norm(motion.rate_b, axis=1) * 0.5 / 20.0
    assert half.max() > 0.12  # beyond 0.1 rad, where the series of the rotation ends
    plan = [Trial(0, 0, 0, number, 20.0 + number, 0.3) for number in range(3)]
    difference, _ = against_stages(monkeypatch, [motion], [device], [table_of(device)], plan, TrialSettings())
    assert difference < 1e-12


def test_a_body_that_lies_on_its_side_has_no_pitch_and_its_trial_no_error():
    motion, device = nodding(0.2, 0.5), units(1, np.random.default_rng(7))[0]
    aside = np.sqrt(0.5) * np.array([1.0, 1.0, 0.0, 0.0])
    lying = replace(motion, q_nb=np.tile(aside, (len(motion), 1)), rate_b=np.zeros((len(motion), 3)))
    bench = trial_bench([motion, lying], [device], [table_of(device)])
    (found,) = run_trials(bench, [Trial(0, 0, 0, 1), Trial(1, 0, 0, 2)])
    assert list(np.isnan(found.rms)) == [False, True]
    assert list(np.isnan(found.maximum)) == [False, True]


def test_a_device_with_nothing_but_a_matrix_errs_by_rounding_alone():
    plain = preset("xsens_mti1")
    plain = trial_device(
        replace(plain, gyro=replace(plain.gyro.without_noise(), thermal_scale=None, low_pass=None, rate_drift=None))
    )
    bench = trial_bench([nodding(2.0, 0.8)], [plain], [replace_g(true_calibration(plain))])
    (found,) = run_trials(bench, [Trial(0, 0, 0, 1)])
    assert found.maximum[0] < 1e-12


def replace_g(calibration):
    """The same calibration without g-sensitivity."""
    return replace(calibration, gyro=replace(calibration.gyro, g_sensitivity=None))


def test_batch_order_and_threads_do_not_change_a_bit():
    rng = np.random.default_rng(4)
    motions, devices = [nodding(0.2, 0.7), nodding(0.3, 0.4)], units(2, rng)
    calibrations = [table_of(device) for device in devices]
    plan = [Trial(k % 2, (k // 2) % 2, (k // 4) % 2, k, 15.0 + k % 20) for k in range(70)]

    def run(trials, **how):
        bench = trial_bench(motions, devices, calibrations, TrialSettings(**how))
        parts = list(run_trials(bench, iter(trials)))
        return np.concatenate([np.stack((p.rms, p.maximum)) for p in parts], axis=1), len(parts)

    whole, batches = run(plan)
    assert batches == 1
    for trials, how in ((plan, {"batch": 33}), (plan, {"threads": 2}), (plan[::-1], {"threads": 2, "batch": 50})):
        other, _ = run(trials, **how)
        assert np.array_equal(whole, other if trials is plan else other[:, ::-1])
    assert not np.array_equal(whole, run(plan, seed=1)[0])


def test_errors_stream_out_while_the_plan_is_still_being_made():
    device = units(1, np.random.default_rng(5))[0]
    bench = trial_bench([nodding(0.05, 0.5)], [device], [table_of(device)], TrialSettings(batch=4))
    asked = []

    def endless():
        number = 0
        while True:
            asked.append(number)
            yield Trial(0, 0, 0, number)
            number += 1

    first = next(run_trials(bench, endless()))
    assert len(first.rms) == 4
    assert len(asked) == 4


def test_the_counters_numbers_are_normal_white_and_independent():
    n = 4000
    draws = np.concatenate([np.hstack(trial_noise(9, number, n)) for number in (0, 1, 2**40)], axis=1)  # 18 columns
    many = draws.size
    mean, variance = draws.mean(), draws.var()
    skew, kurtosis = np.mean(draws**3), np.mean(draws**4)
    assert abs(mean) < 4.0 / np.sqrt(many)  # each bound is four standard deviations of the estimate
    assert abs(variance - 1.0) < 4.0 * np.sqrt(2.0 / many)
    assert abs(skew) < 4.0 * np.sqrt(15.0 / many)
    assert abs(kurtosis - 3.0) < 4.0 * np.sqrt(96.0 / many)
    correlation = np.corrcoef(draws.T) - np.eye(18)
    assert np.abs(correlation).max() < 4.5 / np.sqrt(n)  # the greatest of 153
    for lag in (1, 2, 3, 32, 96):
        assert abs(np.mean(draws[lag:] * draws[:-lag])) < 4.0 / np.sqrt(many)
    beyond = np.mean(np.abs(draws) > 1.959964)
    assert abs(beyond - 0.05) < 4.0 * np.sqrt(0.05 * 0.95 / many)
    show("mean, variance, kurtosis", f"{mean:.4f} {variance:.4f} {kurtosis:.4f}", "0 1 3")


def test_the_allan_deviation_of_the_numbers_falls_by_one_half_and_of_their_sum_rises_by_one_half():
    draws = np.hstack([np.hstack(trial_noise(2, number, 4096)) for number in range(4)])  # 24 columns
    sizes = np.array([1, 4, 16, 64])

    def slope(x):
        deviation = []
        for m in sizes:
            means = x[: len(x) // m * m].reshape(-1, m, x.shape[1]).mean(axis=1)
            deviation.append(np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2)))
        return np.polyfit(np.log(sizes), np.log(deviation), 1)[0]

    white = slope(draws)
    assert white == pytest.approx(-0.5, abs=0.02)  # 24 * 64 means at the longest: 2.5 % of the last of four points
    sizes = sizes[1:] * 4  # a sum of steps is a random walk only over many of them
    assert slope(np.cumsum(draws, axis=0)) == pytest.approx(0.5, abs=0.06)


def test_what_the_kernel_does_not_know_is_refused():
    whole = preset("enc03j_3031")
    device, motion = trial_device(whole), nodding(0.1, 0.5)
    good = table_of(device)

    def wanted(text, *, motions=(motion,), devices=(device,), calibrations=(good,)):
        with pytest.raises(InputError, match=text):
            trial_bench(motions, devices, calibrations)

    wanted("got nonlinearity; use trial_device", devices=[whole])
    noisy = replace(device, thermometer=replace(device.thermometer, noise_c=0.1))
    wanted("a thermometer without noise", devices=[noisy])
    other = replace(device, sampling=replace(device.sampling, gyro_averaging="interval"))
    wanted("one way of averaging, got 2", devices=[device, other])
    wanted("one unit of the readings, got count, v", devices=[device, with_gyro(device, unit="v")])
    cut = Adc(bits=12, reference=5.0, rounding="toward_zero")
    wanted("straight converter", devices=[with_gyro(device, adc=cut)])
    powers = replace(device.gyro.offset, per_k=np.ones((3, 3)))
    wanted("at most 2 powers of temperature", devices=[with_gyro(device, offset=powers)])
    powers = replace(device.gyro.rate_drift, coefficients=np.ones((4, 2, 3)))
    wanted("at most 3 powers of rate", devices=[with_gyro(device, rate_drift=powers)])
    full = replace(good, drift=true_tables(device, TEMPS, np.array([-3.0, 0.0, 3.0])))
    wanted("got g-sensitivity, codes cut toward zero or another table", calibrations=[full])
    young = replace(good.drift.static, warm_up=WarmUp(power_on_s=[0.0, 60.0], gyro_offset=[[1.0] * 3, [0.0] * 3]))
    wanted("got a warm-up over time since power-on", calibrations=[replace(good, drift=DriftTables(static=young))])
    trailing = replace(good.drift, lag_s=20.0, lag_smooth_s=2.0)
    wanted("got a thermometer's lag of 20 s; use correct", calibrations=[replace(good, drift=trailing)])
    uneven = replace(good.drift.static, temp_c=np.cumsum(np.sqrt(np.arange(2.0, 11.0))))
    wanted("got uneven ones; resample it", calibrations=[replace(good, drift=DriftTables(static=uneven))])
    slower = replace(motion, time=2.0 * motion.time)
    wanted("one even sample period", motions=[motion, slower])
    gap = np.ones(len(motion))
    gap[3] = 0.0
    wanted("got gaps; cut them out", motions=[replace(motion, valid=gap)])


def with_gyro(device, **changes):
    """The same device with another gyroscope."""
    return replace(device, gyro=replace(device.gyro, **changes))
