"""Effects of a device, each alone, against a closed form or the slope that IEEE Std 952 gives its noise."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lsim

from testkit.data import show
from testkit.simulated_device import chain, device_of, motion_of, run, still_motion
from undrift.calibration.noise import allan_deviation
from undrift.errors import InputError
from undrift.sim.device.effects import (
    Adc,
    Amplifier,
    BiasInstability,
    GSensitivity,
    LeverArm,
    LowPass,
    Nonlinearity,
    Offset,
    PowerOnTransient,
    RandomWalk,
    RateDrift,
    Sampling,
    Scale,
    ThermalHysteresis,
    ThermalScale,
    Thermometer,
    WhiteNoise,
    play,
    rounded,
    sallen_key,
)

TIME = np.arange(101) / 100.0
RAMP = np.linspace(-3.0, 3.0, 101)[:, None] * np.array([1.0, 0.5, -1.0])


def test_scale_and_axes_are_one_matrix() -> None:
    lean = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]])
    scale = Scale(nominal_sensitivity=2.0, error=np.array([0.1, 0.0, -0.1]), axes=lean)
    made = run(device_of(chain(scale=scale)), motion_of(TIME, RAMP))
    x, y, z = RAMP.T
    wanted = 2.0 * np.stack((1.1 * x, y, 0.9 * (0.6 * x + 0.8 * z)), axis=1)
    np.testing.assert_allclose(made.record.gyro, wanted, atol=1e-14)
    np.testing.assert_allclose(made.gyro.of("scale"), wanted / 2.0 - RAMP, atol=1e-14)


def test_each_accelerometer_of_a_body_that_turns_while_it_travels_feels_its_own_place() -> None:
    step = 1e-4
    time = np.arange(20001) * step
    angle, rate, spin = 0.8 * np.sin(5.0 * time), 4.0 * np.cos(5.0 * time), -20.0 * np.sin(5.0 * time)
    travel = np.stack((0.3 * np.sin(3.0 * time), 0.1 * time**3, 0.2 * np.cos(2.0 * time)), axis=1)
    pull = np.stack((-2.7 * np.sin(3.0 * time), 0.6 * time, 9.81 - 0.8 * np.cos(2.0 * time)), axis=1)
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    hat = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    turn = np.eye(3) + np.sin(angle)[:, None, None] * hat + (1.0 - np.cos(angle))[:, None, None] * (hat @ hat)
    arms = np.array([[0.02, 0.0, 0.01], [0.0, -0.03, 0.0], [0.05, 0.05, 0.05]])
    motion = motion_of(
        time,
        np.outer(rate, axis),
        np.einsum("nji,nj->ni", turn, pull),
        angular_acceleration_b=np.outer(spin, axis),
    )
    felt = run(device_of(accel=chain("m/s2", lever_arm=LeverArm(arms=arms))), motion).record.accel
    assert felt is not None
    weights = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / (12.0 * step**2)
    for sensor in range(3):
        place = travel + turn @ arms[sensor]
        pulled = sum(w * place[k : len(place) - 4 + k] for k, w in enumerate(weights)) + np.array([0.0, 0.0, 9.81])
        seen = np.einsum("nj,nj->n", turn[2:-2, :, sensor], pulled)
        # Fourth-order differences of doubles near 1 at 0.1 ms: 30 / 12 * 1e-16 / 1e-8 = 1e-7 of rounding, m/s2.
        np.testing.assert_allclose(felt[2:-2, sensor], seen, atol=1e-6)


def test_non_linearity_bends() -> None:
    bend = Nonlinearity(quadratic=[0.01, 0.0, -0.02])  # type: ignore[arg-type]
    made = run(device_of(chain(nonlinearity=bend)), motion_of(TIME, RAMP))
    x, y, z = RAMP.T
    added = made.gyro.of("nonlinearity")
    np.testing.assert_allclose(added[:, 0], 0.01 * x**2, atol=1e-15)
    np.testing.assert_allclose(added[:, 2], -0.02 * z**2, atol=1e-15)
    np.testing.assert_allclose(made.record.gyro[:, 1], y, atol=1e-15)  # type: ignore[index]


def test_specific_force_feigns_a_rate() -> None:
    made = run(
        device_of(chain(g_sensitivity=GSensitivity(matrix=np.outer([0.0, 1e-3, 0.0], [0, 0, 1])))), still_motion(3)
    )
    np.testing.assert_allclose(made.record.gyro, np.tile([0.0, 9.81e-3, 0.0], (3, 1)))


def test_rate_drift_grows_with_rate_and_warmth() -> None:
    c = np.zeros((3, 2, 3))
    c[0, 0, 0], c[1, 1, 1], c[2, 1, 2] = 0.01, 0.002, 0.003
    made = run(device_of(chain(rate_drift=RateDrift(coefficients=c))), motion_of(TIME, RAMP), temp_c=35.0)
    x, y, z = RAMP.T
    wanted = np.stack((0.01 * x, 0.002 * y**2 * 10.0, 0.003 * z**3 * 10.0), axis=1)
    np.testing.assert_allclose(made.gyro.of("rate_drift"), wanted, atol=1e-15)


def test_the_offset_is_a_polynomial_of_the_warmth_and_the_thermal_scale_acts_on_all_before_it() -> None:
    n = 61
    temp = np.linspace(10.0, 70.0, n)
    rate = np.tile([1.0, 0.0, -1.0], (n, 1))
    motion = motion_of(np.arange(n) / 10.0, rate)
    offset = Offset(constant=np.full(3, 0.1), per_k=np.array([[0.01, 0.02, 0.0], [1e-4, 0.0, 0.0], [0.0, 0.0, 1e-6]]))
    scale = ThermalScale(per_k=np.array([[2e-3, 0.0, 1e-3]]))
    made = run(device_of(chain(offset=offset, thermal_scale=scale)), motion, temp_c=temp)
    d = temp - 25.0
    shift = np.stack((0.1 + 0.01 * d + 1e-4 * d**2, 0.1 + 0.02 * d, 0.1 + 1e-6 * d**3), axis=1)
    factor = np.stack((1.0 + 2e-3 * d, np.ones(n), 1.0 + 1e-3 * d), axis=1)
    np.testing.assert_allclose(made.gyro.of("offset"), shift, atol=1e-14)
    np.testing.assert_allclose(made.record.gyro, (rate + shift) * factor, atol=1e-14)


def test_a_young_device_settles_exponentially_from_power_on() -> None:
    motion = still_motion(1001, 10.0)
    warm_up = PowerOnTransient(amplitude=[0.1, 0.0, -0.2], time_constant_s=30.0)  # type: ignore[arg-type]
    device = device_of(chain(warm_up=warm_up))
    gyro = run(device, motion, temp_c=35.0).record.gyro
    np.testing.assert_allclose(gyro[:, 0], -0.1 * np.exp(-motion.time / 30.0), atol=1e-15)  # type: ignore[index]
    np.testing.assert_allclose(gyro[:, 2], 0.2 * np.exp(-motion.time / 30.0), atol=1e-15)  # type: ignore[index]
    later = run(device, motion, temp_c=35.0, power_on_s=50.0).record.gyro
    np.testing.assert_allclose(later[:500], gyro[500:1000], atol=1e-15)  # type: ignore[index]


def test_warming_and_cooling_trace_a_loop_of_the_stated_width_at_any_speed() -> None:
    device = device_of(chain(hysteresis=ThermalHysteresis(amplitude=[0.01, 0.0, -0.02], play_k=1.0)))  # type: ignore[arg-type]
    for samples in (400, 4000):
        up = np.linspace(20.0, 60.0, samples)
        temp = np.concatenate((up, up[::-1], up))
        made = run(device, still_motion(len(temp)), temp_c=temp).gyro.of("hysteresis")
        middle = [samples // 2, samples + samples // 2, 2 * samples + samples // 2]  # 40 degC, upward, downward, upward
        np.testing.assert_allclose(made[middle, 0], [-0.01, 0.01, -0.01], atol=1e-12)
        np.testing.assert_allclose(made[middle, 2], [0.02, -0.02, 0.02], atol=1e-12)
        turning = made[samples : 2 * samples, 0]
        fallen = 60.0 - temp[samples : 2 * samples]
        np.testing.assert_allclose(turning, 0.01 * np.clip(fallen - 1.0, -1.0, 1.0), atol=1e-12)
    np.testing.assert_array_equal(play(np.full(5, 30.0), 1.0), 30.0)


def test_a_thermometer_answers_a_step_with_its_lag_and_warms_itself() -> None:
    motion = still_motion(3001, 10.0)
    slow = Thermometer(lag_s=80.0, trim_error_c=1.0)
    step = np.where(motion.time < 10.0, 20.0, 30.0)
    said = run(device_of(thermometer=slow), motion, temp_c=step).record.temp_c
    assert said is not None
    # Between the samples at 9.9 and 10.0 s the temperature rises straight: the answer is exact for that.
    h, since = 0.1, motion.time[101:] - 10.0
    risen = 1.0 - 80.0 / h * (1.0 - np.exp(-h / 80.0))
    felt = 30.0 - 10.0 * (1.0 - risen) * np.exp(-since / 80.0)
    np.testing.assert_allclose(said[101:], felt + 1.0, atol=1e-9)
    assert said[50] == pytest.approx(20.0 + 1.0)
    board = Thermometer(step_c=5.0 / 2**12 / 0.010, zero_c=-273.15)  # LM335: 12 bits of 5 V, 10 mV/K
    shown = run(device_of(thermometer=board), still_motion(3), temp_c=25.0).record.temp_c
    assert shown[0] == pytest.approx(round(298.15 / board.step_c) * board.step_c - 273.15)  # type: ignore[index]
    own = run(device_of(thermometer=Thermometer(lag_s=80.0, self_heating_c=0.6)), motion, temp_c=25.0).record.temp_c
    np.testing.assert_allclose(own, 25.0 + 0.6 * (1.0 - np.exp(-motion.time / 80.0)), atol=1e-12)


def wave(time: np.ndarray, hz: float) -> np.ndarray:
    return np.outer(np.sin(2.0 * np.pi * hz * time), [1.0, 0.5, -1.0])


def test_the_amplifier_holds_to_its_rails() -> None:
    time = np.arange(200) / 100.0
    amplifier = Amplifier(gain=20.0, null=2.5, low=0.2, high=4.0)
    made = run(device_of(chain("v", 0.1, amplifier=amplifier)), motion_of(time, wave(time, 1.0)))
    np.testing.assert_allclose(made.record.gyro, np.clip(2.5 + 2.0 * wave(time, 1.0), 0.2, 4.0), atol=1e-14)
    np.testing.assert_array_equal(made.gyro.saturated, 2.5 + 2.0 * wave(time, 1.0) > 4.0)
    with pytest.raises(InputError, match="amplifier: gain must be positive"):
        Amplifier(gain=20.0, null=5.0, low=0.0, high=5.0)


def test_the_low_pass_is_the_continuous_filter_of_what_is_straight_between_samples() -> None:
    coarse = np.arange(400) / 100.0
    knots = np.random.default_rng(1).normal(size=(400, 3))
    low_pass = LowPass(cutoff_hz=[11.1, 4.0, 30.0], quality=[1.0 / math.sqrt(2.0), 0.6, 1.2])  # type: ignore[arg-type]
    made = run(device_of(chain(low_pass=low_pass)), motion_of(coarse, knots)).record.gyro
    assert made is not None
    fine = (
        np.arange(399 * 20 + 1) / 2000.0
    )  # straight between the same knots: lsim's own first-order hold on a finer grid
    for k in range(3):
        w, q = 2.0 * math.pi * low_pass.cutoff_hz[k], low_pass.quality[k]
        start = [0.0, knots[0, k] / w**2]
        output = lsim(([w * w], [1.0, w / q, w * w]), np.interp(fine, coarse, knots[:, k]), fine, X0=start)[1]
        np.testing.assert_allclose(made[:, k], output[::20], atol=1e-9)


def test_parts_of_a_tolerance_move_cutoff_and_quality() -> None:
    exact = sallen_key(11.1, np.zeros((3, 4)))
    np.testing.assert_allclose(exact.cutoff_hz, 11.1)
    np.testing.assert_allclose(exact.quality, 1.0 / math.sqrt(2.0))
    parts = np.array([[0.01, 0.01, 0.0, 0.0], [0.0, 0.0, 0.04, 0.0], [0.0, 0.0, 0.0, 0.04]])
    made = sallen_key(11.1, parts)
    np.testing.assert_allclose(made.cutoff_hz, 11.1 / np.array([1.01, 1.02, 1.02]), rtol=2e-4)  # sqrt(1.04) = 1.0198
    np.testing.assert_allclose(made.quality * math.sqrt(2.0), [1.0, 1.02, 1.0 / 1.02], rtol=2e-4)


@pytest.mark.parametrize(
    ("rounding", "lowest", "width"), [("nearest", -0.5, 1.0), ("floor", 0.0, 1.0), ("toward_zero", -1.0, 2.0)]
)
def test_the_histogram_of_codes_shows_the_rounding(rounding: str, lowest: float, width: float) -> None:
    n = 200_001
    ramp = np.outer(np.linspace(-10.0, 10.0, n), np.ones(3))
    adc = Adc(bits=8, reference=128.0, rounding=rounding)  # type: ignore[arg-type]
    codes = run(device_of(chain("count", adc=adc)), motion_of(np.arange(n) / 1000.0, ramp)).record.gyro[:, 0]  # type: ignore[index]
    counts = {code: int((codes == code).sum()) for code in (-3, 0, 3)}
    assert counts[-3] == pytest.approx(10_000, abs=1)
    assert counts[3] == pytest.approx(10_000, abs=1)
    assert counts[0] == pytest.approx(10_000 * width, abs=1)  # code 0 is twice as wide where codes are cut toward zero
    assert ramp[codes == 0, 0].min() == pytest.approx(lowest, abs=2e-4)


def test_unsigned_codes_start_at_the_null_and_end_at_the_reference() -> None:
    adc = Adc(bits=12, reference=5.0, signed=False)
    assert adc.step == 5.0 / 4096
    device = device_of(chain("count", 1.0, amplifier=Amplifier(gain=1.0, null=2.5), adc=adc))
    rate = np.array([[0.0, 0.001, -0.001], [3.0, -3.0, 1.0]])
    made = run(device, motion_of(np.array([0.0, 0.01]), rate))
    np.testing.assert_array_equal(made.record.gyro, [[2048, 2049, 2047], [4095, 0, 2867]])
    np.testing.assert_array_equal(made.gyro.saturated[1], [True, True, False])


def test_integral_non_linearity_bows_the_codes() -> None:
    adc = Adc(bits=12, reference=4096.0, signed=False, inl_lsb=np.array([2.0, 0.0, -4.0]), codes=True)
    span = np.outer(np.linspace(0.0, 4095.0, 4096), np.ones(3))
    codes = run(device_of(chain("count", adc=adc)), motion_of(np.arange(4096) / 100.0, span)).record.gyro
    bow = (codes - span)[[0, 2048, 4095]]  # type: ignore[operator]
    np.testing.assert_array_equal(bow, [[0, 0, 0], [2, 0, -4], [0, 0, 0]])
    with pytest.raises(InputError, match=r"Adc: `rounding` .*'toward_zero', got 'up'"):
        replace(adc, rounding="up")  # type: ignore[arg-type]
    np.testing.assert_array_equal(rounded(np.array([-1.6, -0.4, 0.4, 1.6]), "floor"), [-2.0, -1.0, 0.0, 1.0])


def test_sampling_takes_the_signal_when_its_clock_and_its_channels_say() -> None:
    time = np.arange(20_000) / 2000.0
    signal = wave(time, 3.0)
    delays = np.array([0.0, 1e-4, 2e-4])
    clock = Sampling(sample_rate_hz=90.0, clock_error=1e-3, gyro_delay_s=delays, gyro_averaging="instant")
    made = run(device_of(sampling=clock), motion_of(time, signal))
    np.testing.assert_allclose(np.diff(made.record.time), 1.0 / 90.0, atol=1e-12)
    true = made.record.time / 1.001
    np.testing.assert_allclose(made.true_time, true, atol=1e-12)
    wanted = np.stack([wave(true + d, 3.0)[:, k] for k, d in enumerate(delays)], axis=1)
    # A cubic spline errs by 5 / 384 (w h)^4 = 1e-10, at its ends, which know no curvature, by up to (w h)^4 = 1e-8.
    np.testing.assert_allclose(made.record.gyro, wanted, atol=2e-8)
    shaken = run(device_of(sampling=replace(clock, jitter_s=1e-4, gyro_delay_s=np.zeros(3))), motion_of(time, signal))
    jitter = shaken.true_time - shaken.record.time / 1.001
    assert np.std(jitter) == pytest.approx(1e-4, rel=4.0 / math.sqrt(2.0 * len(jitter)))
    np.testing.assert_allclose(shaken.record.gyro, wave(shaken.true_time, 3.0), atol=2e-8)


def test_interval_readings_are_the_integral_of_the_signal() -> None:
    time = np.arange(8001) / 2000.0
    w = 2.0 * np.pi * 3.0
    force = np.outer(np.sin(w * time), np.ones(3))
    clock = Sampling(sample_rate_hz=100.0, accel_averaging="interval", gyro_averaging="instant")
    made = run(device_of(sampling=clock), motion_of(time, force, force))
    ends = made.record.time
    wanted = (np.cos(w * (ends - 0.01)) - np.cos(w * ends)) / (w * 0.01)
    np.testing.assert_allclose(made.record.accel[1:, 0], wanted[1:], atol=1e-7)  # type: ignore[index]
    whole = np.sum(made.record.accel[1:], axis=0) * 0.01  # type: ignore[index]
    np.testing.assert_allclose(whole, CubicSpline(time, force).integrate(0.0, ends[-1]), atol=1e-9)


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


def test_white_noise_off_the_grid_is_that_of_the_devices_own_rate() -> None:
    clock = Sampling(sample_rate_hz=80.0, clock_error=1e-3)
    device = device_of(chain(white_noise=WhiteNoise(random_walk=np.full(3, 0.002))), sampling=clock)
    gyro = run(device, still_motion(100_000, RATE_HZ)).record.gyro
    assert np.std(gyro) == pytest.approx(0.002 * math.sqrt(80.0), rel=4.0 / math.sqrt(6.0 * 80_000))  # type: ignore[arg-type]


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


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Scale(nominal_sensitivity=1.0, axes=2.0 * np.eye(3)), "unit vectors"),
        (lambda: Thermometer(lag_s=-1.0), r"Thermometer.lag_s: .*0 or more, got -1"),
        (lambda: Sampling(gyro_averaging="median"), "got 'median'"),  # type: ignore[arg-type]
        (lambda: run(device_of(sampling=Sampling(sample_rate_hz=1.0)), still_motion(50)), "at least two samples"),
        (
            lambda: run(
                device_of(chain(low_pass=LowPass(cutoff_hz=np.full(3, 5.0)))),
                motion_of(np.array([0.0, 0.1, 0.3]), np.zeros((3, 3))),
            ),
            "evenly spaced",
        ),
        (
            lambda: run(device_of(accel=chain("m/s2", lever_arm=LeverArm(arms=np.eye(3)))), motion_of(TIME, RAMP)),
            "no angular acceleration",
        ),
    ],
)
def test_an_impossible_device_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()
