"""Amplifier, low-pass, sampling and converter, each alone."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lsim

from testkit.data import show
from testkit.simulated_device import chain, device_of, motion_of, run, still_motion
from undrift.errors import InputError
from undrift.sim.device.effects import Adc, Amplifier, LowPass, Sampling, rounded, sallen_key


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


def test_the_group_delay_of_a_butterworth_is_root_two_over_the_cutoff() -> None:
    low_pass = LowPass(cutoff_hz=np.full(3, 11.1))
    assert low_pass.group_delay_s[0] * 1e3 == pytest.approx(20.28, abs=0.005)  # ms, DOMAIN: sqrt(2) / (2 pi 11.1)
    time = np.arange(4000) / 1000.0
    ramp = np.outer(time, np.ones(3))
    late = run(device_of(chain(low_pass=low_pass)), motion_of(time, ramp)).record.gyro
    delay = (ramp - late)[-1, 0]  # s: a ramp of 1/s comes late by the delay at zero frequency
    show("delay of a ramp behind an 11.1 Hz Butterworth, ms", f"{1e3 * delay:.4f}", "20.2774")
    assert delay == pytest.approx(math.sqrt(2.0) / (2.0 * math.pi * 11.1), abs=1e-9)


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


def test_a_motion_too_short_for_the_clock_and_an_unknown_averaging_are_refused() -> None:
    with pytest.raises(InputError, match="at least two samples"):
        run(device_of(sampling=Sampling(sample_rate_hz=1.0)), still_motion(50))
    with pytest.raises(InputError, match=r"Sampling: `gyro_averaging` .*'interval', got 'median'"):
        Sampling(gyro_averaging="median")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"low-pass: .*evenly spaced"):
        run(
            device_of(chain(low_pass=LowPass(cutoff_hz=np.full(3, 5.0)))),
            motion_of(np.array([0.0, 0.1, 0.3]), np.zeros((3, 3))),
        )
