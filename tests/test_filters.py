"""The low-pass: equal to scipy's, 3 dB down where it says, settled at its start."""

import numpy as np
import pytest

from testkit.data import show
from undrift import filters as filters_module
from undrift.errors import InputError
from undrift.filters import TWO_PASSES, butterworth, lowpass
from undrift.kernels.filter import biquad
from undrift.record import Record

RATE = 100.0


def readings(n=1001, seed=1):
    return np.random.default_rng(seed).normal(size=(n, 3)) + np.array([10.0, -5.0, 0.0])


@pytest.mark.parametrize("cutoff_hz", [0.5, 11.1, 45.0])
def test_the_coefficients_are_scipys(cutoff_hz):
    from scipy.signal import butter

    sos = butter(2, cutoff_hz, fs=RATE, output="sos")[0]
    b0, b1, b2, a1, a2 = butterworth(cutoff_hz, RATE)
    np.testing.assert_allclose([b0, b1, b2, 1.0, a1, a2], sos, rtol=1e-12)  # scipy goes through poles and zeros


@pytest.mark.parametrize("n", [1, 2, 3, 63, 64, 65, 1001])
@pytest.mark.parametrize("cutoff_hz", [1.0, 11.1, 40.0])
def test_a_causal_pass_equals_scipys_started_settled(n, cutoff_hz):
    from scipy.signal import butter, sosfilt, sosfilt_zi

    x = readings(n)
    sos = butter(2, cutoff_hz, fs=RATE, output="sos")
    wanted, _ = sosfilt(sos, x, axis=0, zi=sosfilt_zi(sos)[:, :, None] * x[0])
    # the same recursion in another form; at 1 Hz its poles amplify a rounding by a few hundred
    np.testing.assert_allclose(lowpass(x, cutoff_hz, sample_rate_hz=RATE), wanted, rtol=0, atol=1e-12)


def test_from_rest_the_kernel_equals_sosfilt_and_goes_on_where_it_stopped():
    from scipy.signal import sosfilt

    x, section = readings(500), butterworth(5.0, RATE)
    wanted = sosfilt([[*section[:3], 1.0, *section[3:]]], x, axis=0)
    for cuts in ([500], [1, 2, 3, 64, 430], [250, 250]):
        state, out, start = np.zeros(12), np.empty_like(x), 0
        for n in cuts:
            part = slice(start, start + n)
            biquad(x[part].reshape(-1), out[part].reshape(-1), *section, state)
            start += n
        np.testing.assert_allclose(out, wanted, rtol=0, atol=1e-13)


def test_zero_phase_equals_scipys_forward_and_back_at_the_corrected_cutoff():
    from scipy.signal import sosfiltfilt

    x, section = readings(), butterworth(11.1, RATE, zero_phase=True)
    wanted = sosfiltfilt([[*section[:3], 1.0, *section[3:]]], x, axis=0)
    np.testing.assert_allclose(lowpass(x, 11.1, sample_rate_hz=RATE, zero_phase=True), wanted, rtol=0, atol=1e-12)


@pytest.mark.parametrize("zero_phase", [False, True])
def test_a_sine_at_the_cutoff_loses_three_decibels_either_way(zero_phase):
    time = np.arange(4000) / RATE
    sine = np.sin(2.0 * np.pi * 10.0 * time)
    y = lowpass(np.column_stack((sine, sine, sine)), 10.0, sample_rate_hz=RATE, zero_phase=zero_phase)[1000:3000, 0]
    gain = np.sqrt(2.0 * np.mean(y**2))
    show("gain at the cut-off", gain, "0.7071")
    assert gain == pytest.approx(np.sqrt(0.5), abs=1e-6)
    lag = np.angle(1j * np.sum(y * np.exp(-2j * np.pi * 10.0 * time[1000:3000])))  # a sine is a cosine 90 deg late
    assert lag == pytest.approx(0.0 if zero_phase else -np.pi / 2.0, abs=1e-6)


def test_the_two_pass_factor_is_winters():
    assert pytest.approx(0.802, abs=5e-4) == TWO_PASSES


def test_a_constant_passes_unchanged_from_the_first_sample():
    x = np.tile([3.0, -1.0, 9.81], (50, 1))
    np.testing.assert_allclose(lowpass(x, 5.0, sample_rate_hz=RATE), x, rtol=1e-13)
    np.testing.assert_allclose(lowpass(x, 5.0, sample_rate_hz=RATE, zero_phase=True), x, rtol=1e-13)


def test_a_record_is_filtered_in_both_triads_and_keeps_the_rest():
    record = Record(time=np.arange(200) / RATE, gyro=readings(200), accel=readings(200, 2), gyro_unit="dps", device="A")
    done = lowpass(record, 11.1)
    np.testing.assert_array_equal(done.gyro, lowpass(record.gyro, 11.1, sample_rate_hz=record.sample_rate_hz))
    np.testing.assert_array_equal(done.accel, lowpass(record.accel, 11.1, sample_rate_hz=record.sample_rate_hz))
    assert (done.device, done.gyro_unit, done.gyro.flags.writeable) == ("A", "dps", False)
    assert lowpass(Record(time=record.time, gyro=record.gyro), 11.1).accel is None


def test_two_threads_give_the_bits_of_one(monkeypatch):
    record = Record(time=np.arange(200) / RATE, gyro=readings(200), accel=readings(200, 2))
    one = lowpass(record, 11.1)
    monkeypatch.setattr(filters_module, "THREADS_FROM", 100)
    two = lowpass(record, 11.1)
    assert one.gyro.tobytes() == two.gyro.tobytes()
    assert one.accel.tobytes() == two.accel.tobytes()


def test_what_cannot_be_filtered_is_refused():
    x = readings(100)
    with pytest.raises(InputError, match="wanted a cut-off between 0 and 50 Hz, half the sample rate, got 50 Hz"):
        lowpass(x, 50.0, sample_rate_hz=RATE)
    with pytest.raises(InputError, match="wanted the sample rate of the array, got none"):
        lowpass(x, 5.0)
    with pytest.raises(InputError, match=r"wanted an array of shape \(N, 3\), got \(3, 100\)"):
        lowpass(x.T, 5.0, sample_rate_hz=RATE)
    with pytest.raises(InputError, match="wanted more than 9 samples for zero phase, got 9"):
        lowpass(x[:9], 5.0, sample_rate_hz=RATE, zero_phase=True)
    gap = x.copy()
    gap[50, 2] = np.nan
    for zero_phase in (False, True):
        with pytest.raises(InputError, match="wanted readings without gaps, got NaN; filter each stretch by itself"):
            lowpass(gap, 5.0, sample_rate_hz=RATE, zero_phase=zero_phase)
    time = np.arange(100) / RATE
    time[40:] += 0.5
    with pytest.raises(InputError, match=r"wanted even time, got 1 uneven steps, the first at 0.39 s"):
        lowpass(Record(time=time, gyro=x), 5.0)
