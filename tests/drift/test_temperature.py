"""A temperature is smoothed as a board warms, checked with numbers, and refused where no thermal fit could use it.

The thermometer's lag is taken off exactly, chunk by chunk, and said to be unknown where it is.

The lag is found from blocks that ran both ways at two speeds, and reported as not observable otherwise.
"""

from dataclasses import replace

import numpy as np
import pytest

from testkit.column_maps import column_map
from testkit.data import data_path, show
from testkit.rest_blocks import rest_blocks
from undrift.correction.plan import without_lag
from undrift.drift.temperature import (
    Temperature,
    check_span,
    default_smooth_s,
    estimate_lag,
    trusted_temperature,
    without_lag_smooth,
)
from undrift.errors import InputError, NotObservable
from undrift.io.column_map import ChannelScale
from undrift.io.formats import read_counted, read_record
from undrift.record import Record, Session, Still

TIME = np.arange(0.0, 2400.0, 0.1)
WARM_UP = 10.0 + 19.0 * (0.3 * (1.0 - np.exp(-TIME / 90.0)) + 0.7 * (1.0 - np.exp(-TIME / 700.0)))


def of(*records, stills=()):
    return Session(kind="thermal", serial="A", gravity_m_s2=9.81, records=records, stills=stills)


def session(*columns, time=TIME, stills=()):
    return of(*(Record(time=time, gyro=np.zeros((len(time), 3)), temp_c=column) for column in columns), stills=stills)


# ---- smoothing ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "noise", "limit"),
    [(1.0, 0.0, 0.1), (1.0, 0.1, 0.12), (1.0, 0.3, 0.07), (0.0, 0.5, 0.05)],
)
def test_steps_and_noise_of_a_warm_up_are_smoothed_away(step, noise, limit):
    errors = []
    for seed in range(5 if noise else 1):
        raw = WARM_UP + np.random.default_rng(seed).normal(0.0, noise, len(TIME))
        raw = np.round(raw / step) * step if step else raw
        temperature = trusted_temperature(session(raw), 0)
        errors.append(float(np.sqrt(np.mean((temperature.temp_c - WARM_UP) ** 2))))
    show(f"step {step:g} K, noise {noise:g} K: worst rms error, K", f"{max(errors):.4f}", limit)
    # a tenth of a coarse step; of fine ones what the mean of 30 s leaves of noise and of the steep start
    assert max(errors) < limit
    assert temperature.findings == ()


# ---- plausibility ---------------------------------------------------------------------------------------------------------------


def test_single_wild_readings_are_left_out():
    raw = WARM_UP + np.random.default_rng(0).normal(0.0, 0.05, len(TIME))
    raw[[500, 9000]] += 30.0
    temperature = trusted_temperature(session(raw), 0)
    assert np.abs(temperature.temp_c - WARM_UP).max() < 0.1


def test_short_gaps_are_bridged_and_long_ones_stay():
    raw = WARM_UP.copy()
    raw[1000:1050] = raw[5000:7000] = raw[-5:] = np.nan
    temperature = trusted_temperature(session(raw), 0)
    assert np.abs(temperature.temp_c[1000:1050] - WARM_UP[1000:1050]).max() < 0.05
    assert np.isnan(temperature.temp_c[5000:7000]).all()
    assert np.isnan(temperature.temp_c[-5:]).all()


@pytest.mark.parametrize(("step", "noise"), [(0.0, 0.05), (0.5, 0.02)])
def test_a_soak_before_a_pause_does_not_reach_the_soak_after_it(step, noise):
    # One minute at each of four set-points, 15 degC and six minutes apart, in one recording.
    time = np.concatenate([400.0 * k + np.arange(0.0, 60.0, 0.1) for k in range(4)])
    soaks = np.repeat(18.0 + 15.0 * np.arange(4), 600)
    raw = soaks + noise * np.random.default_rng(0).normal(size=len(soaks))
    raw = np.round(raw / step) * step if step else raw
    temperature = trusted_temperature(session(raw, time=time), 0)
    assert np.abs(temperature.temp_c - soaks).max() < 0.1  # near an end of a piece the mean is over two seconds


def test_a_column_that_denies_its_set_point_is_implausible():
    still = (Still(start=20000, stop=24000, temp_c=20.0),)
    (item,) = trusted_temperature(session(WARM_UP, stills=still), 0).findings
    assert item.code == "drift.temperature_implausible"
    assert "set-point of 20.0 degC" in item.text


def test_set_points_stand_in_for_a_column():
    stills = (Still(start=0, stop=100, temp_c=20.0), Still(start=200, stop=300, temp_c=30.0))
    temperature = trusted_temperature(session(None, stills=stills), 0)
    assert (temperature.source, temperature.noise_c) == ("set-points", 0.0)
    assert (temperature.temp_c[:100] == 20.0).all()
    assert np.isnan(temperature.temp_c[100:200]).all()


# ---- refusals -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("raw", "kind", "words"),
    [
        (None, InputError, "neither a column"),
        (np.where(TIME < 500.0, WARM_UP, np.nan), InputError, "only 5000 of 24000"),
        (np.full(len(TIME), 25.0), NotObservable, r"25.00 to 25.00\) \(constant\)"),
        (25.0 + np.random.default_rng(0).normal(0.0, 0.5, len(TIME)), NotObservable, r"span 0\."),  # noise is no span
        (WARM_UP + 100.0, InputError, r"125 degC at 841.2 s \(15588 readings\)"),
    ],
)
def test_what_no_thermal_fit_can_use_is_refused(raw, kind, words):
    with pytest.raises(kind, match=words):
        check_span([trusted_temperature(session(raw), 0)])


# ---- real recordings: the SOURCE.md in the folder of each names origin and licence -----------------------------------------


def test_real_warm_up_comes_back_from_whole_degrees():
    column = "dTemp"
    columns = column_map(
        time="Time", time_unit="ms", temp=column, temp_unit="degC", temp_scale=ChannelScale(1.0 / 340.0, 36.53),
        gyro=("Gx", "Gy", "Gz"), gyro_unit="count",
    )  # fmt: skip
    record = read_counted(data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz"), columns).record
    fine = trusted_temperature(of(record), 0)
    off = float(np.sqrt(np.mean((fine.temp_c - record.temp_c) ** 2)))
    first = record.time < record.time[0] + 120.0
    rise = float(np.ptp(fine.temp_c[first]))
    coarse = trusted_temperature(of(replace(record, temp_c=np.round(record.temp_c))), 0)
    back = float(np.sqrt(np.mean((coarse.temp_c - fine.temp_c) ** 2)))
    early = float(np.sqrt(np.mean((coarse.temp_c - fine.temp_c)[first] ** 2)))
    show(f"{column}: rms of raw about the course, K", f"{off:.4f}", "0.1")
    show(f"{column}: rise in two minutes, K", f"{rise:.2f}", "7 to 8")
    show(
        f"{column} from whole degrees, rms error, K",
        f"{back:.3f}, first two minutes {early:.3f}",
        "0.1, 0.2",
    )
    assert off < 0.1  # noise, and the first second after power-on, by one kelvin
    assert 6.5 < rise < 8.0
    assert back < 0.15
    assert early < 0.2
    assert fine.findings == ()


def test_chip_that_reads_54_degrees_is_called_implausible():
    record = read_record(data_path("wearable_formats", "agread_gt9x_example-IMU.csv.gz"))
    temperature = trusted_temperature(of(record), 0)
    show("GT9X", [seen.text for seen in temperature.findings])
    assert any("51.6 to 54.7 degC throughout" in seen.text for seen in temperature.findings)


TAU = 40.0


def column(temp_c, time, noise_c=0.0):
    return Temperature(time=time, temp_c=temp_c, noise_c=noise_c, source="column")


def lagging(time, temp):
    """Return what a thermometer reads whose temperature is straight between samples: the exact solution."""
    said = np.empty_like(temp)
    said[0] = temp[0]
    for k in range(1, len(temp)):
        step = time[k] - time[k - 1]
        slope = (temp[k] - temp[k - 1]) / step
        settled = temp[k - 1] - slope * TAU
        said[k] = settled + slope * step + (said[k - 1] - settled) * np.exp(-step / TAU)
    return said


def ramp(seed=0, n=2000):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.05, 1.5, n))
    return time, 20.0 + 5.0 * np.sin(time / 150.0)


def test_ramp_is_followed_with_the_small_lag():
    time = np.arange(0.0, 2000.0, 0.1)
    temp = 20.0 + 0.05 * time  # 3 degC/min
    said = lagging(time, temp)
    result, _ = without_lag(said, time, lag_s=TAU, smooth_s=5.0)
    assert temp[-1] - said[-1] == pytest.approx(0.05 * TAU, rel=1e-6)
    # the reading bends between samples: (dt / tau)^2
    assert temp[-1] - result[-1] == pytest.approx(0.05 * 5.0, rel=1e-4)


def test_a_gap_holds_and_the_next_reading_bridges_it():
    time, temp = ramp()
    gone = temp.copy()
    gone[[0, 1, 700, 701]] = np.nan
    result, _ = without_lag(gone, time, lag_s=TAU, smooth_s=4.0)
    assert np.isnan(result[:2]).all()
    assert (result[700:702] == result[699]).all()
    kept = np.isfinite(gone)
    np.testing.assert_array_equal(result[kept], without_lag(temp[kept], time[kept], lag_s=TAU, smooth_s=4.0)[0])


def test_for_a_fit_nothing_of_the_lag_is_left():
    time = np.arange(0.0, 3000.0, 0.5)
    temp = 20.0 + 5.0 * np.sin(time / 150.0)
    result = without_lag_smooth(column(lagging(time, temp), time), lag_s=TAU)
    assert np.abs(result - temp)[1:-1].max() < 1e-3  # central differences and the bend between samples, 0.3 mK


def test_the_smoothing_balances_noise_and_the_lag_left():
    time = 0.1 * np.arange(10)
    assert default_smooth_s(0.0, column(time, time, 0.1)) == 0.0
    assert default_smooth_s(80.0, column(time, time, 0.0)) == pytest.approx(4.0)  # a twentieth
    assert default_smooth_s(80.0, column(time, 10.0 * time, 5.0)) == pytest.approx(40.0)  # a half
    assert default_smooth_s(80.0, column(time, time, 0.02)) == pytest.approx(np.sqrt(0.02 * 80.0 * 60.0))


STEP_S = 10.0


def blocks(temp, *, lag_s=30.0, noise=0.005, loop=0.0, seed=0):
    """Return blocks of a board at ``temp``, read by a thermometer that lags, of a gyro with offset 0.07 T + 0.002 T^2."""
    read = np.empty_like(temp)
    read[0] = temp[0]
    for k in range(1, len(temp)):
        read[k] = temp[k] + (read[k - 1] - temp[k]) * np.exp(-STEP_S / lag_s)
    slope = (temp - read) / lag_s
    x = temp - 25.0
    true = np.column_stack((0.07 * x + 0.002 * x**2, -0.05 * x, 0.02 * x)) + loop * -np.sign(np.gradient(temp))[:, None]
    gyro = true + np.random.default_rng(seed).normal(0.0, noise, (len(temp), 3))
    return rest_blocks(read, gyro, noise=noise, power_on_s=np.full(len(temp), 5000.0), ramp_c_per_min=60.0 * slope)


def there_and_back(c_per_min, low=20.0, high=40.0):
    n = round((high - low) / c_per_min * 60.0 / STEP_S)
    return np.concatenate((np.linspace(low, high, n), np.linspace(high, low, n)))


def two_ramps(**kwargs):
    return blocks(np.concatenate((there_and_back(0.5), there_and_back(3.0))), **kwargs)


@pytest.mark.parametrize("loop", [0.0, 0.05])
def test_loop_that_ignores_speed_is_not_taken_for_lag(loop):
    lag = estimate_lag(two_ramps(loop=loop))
    assert abs(lag.lag_s - 30.0) < 4.0 * lag.uncertainty_s
    assert lag.uncertainty_s < 2.0


def test_the_uncertainty_is_what_the_estimates_scatter():
    results = [estimate_lag(two_ramps(seed=seed, noise=0.02)) for seed in range(40)]
    scatter = float(np.std([f.lag_s for f in results]))
    stated = float(np.mean([f.uncertainty_s for f in results]))
    assert 0.6 < scatter / stated < 1.5  # 40 draws know a standard deviation to 11 %; neighbours count as independent


def test_without_lag_none_is_found():
    lag = estimate_lag(two_ramps(lag_s=1e-3))
    assert lag.lag_s < 4.0 * lag.uncertainty_s


@pytest.mark.parametrize(
    "temp",
    [
        10.0 + 18.0 * (1.0 - np.exp(-STEP_S * np.arange(200) / 500.0)),  # a warm-up
        there_and_back(1.0),  # one speed: a lag looks like hysteresis
    ],
)
def test_what_does_not_determine_a_lag_gives_none(temp):
    lag = estimate_lag(blocks(temp, lag_s=3.0))
    assert (lag.lag_s, lag.uncertainty_s) == (0.0, np.inf)
