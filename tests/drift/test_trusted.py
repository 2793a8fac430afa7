"""A temperature is smoothed as a board warms, checked with numbers, and refused where no thermal fit could use it."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import data_path, show
from undrift.drift.temperature import check_span, step_of, trusted_temperature
from undrift.errors import InputError, NotObservable
from undrift.io.columns import ColumnMap, Scale, TextLayout
from undrift.io.makers import DIALECTS
from undrift.io.text import read_csv
from undrift.record import Record, Session, Still

TIME = np.arange(0.0, 2400.0, 0.1)
WARM_UP = 10.0 + 19.0 * (0.3 * (1.0 - np.exp(-TIME / 90.0)) + 0.7 * (1.0 - np.exp(-TIME / 700.0)))


def session(*columns, time=TIME, stills=()):
    records = tuple(Record(time=time, gyro=np.zeros((len(time), 3)), temp_c=column) for column in columns)
    return Session(kind="thermal", serial="A", gravity_m_s2=9.81, records=records, stills=stills)


def of(record):
    return Session(kind="thermal", serial="A", gravity_m_s2=9.81, records=(record,))


# ---- smoothing ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("step", "noise", "limit"),
    [
        (1.0, 0.0, 0.03),
        (1.0, 0.1, 0.04),
        (1.0, 0.2, 0.1),
        (1.0, 0.3, 0.07),
        (0.5, 0.0, 0.03),
        (0.0, 0.5, 0.04),
        (0.0, 0.02, 0.003),
    ],
)
def test_steps_and_noise_of_a_warm_up_are_smoothed_away(step, noise, limit):
    errors = []
    for seed in range(5 if noise else 1):
        raw = WARM_UP + np.random.default_rng(seed).normal(0.0, noise, len(TIME))
        raw = np.round(raw / step) * step if step else raw
        found = trusted_temperature(session(raw), 0)
        errors.append(float(np.sqrt(np.mean((found.temp_c - WARM_UP) ** 2))))
    worst = max(errors)
    show(
        f"step {step:g} K, noise {noise:g} K: worst rms error, K",
        f"{worst:.4f}, stated {found.uncertainty_c:.4f}",
        limit,
    )
    assert worst < limit  # one and a half times the worst of 20 seeds, rounded up
    assert worst < 1.5 * found.uncertainty_c
    assert found.step_c == pytest.approx(step)
    assert [seen.code for seen in found.findings] == ["drift.temperature_steps"] * (step >= 0.5)


def test_a_soak_between_ramps_keeps_its_level_within_half_a_step():
    true = np.interp(TIME, [0, 300, 900, 1200, 1800, 2400], [20.2, 20.2, 30.7, 30.7, 25.1, 25.1])
    found = trusted_temperature(session(np.round(true)), 0)
    assert np.abs(found.temp_c - true).max() < 0.5
    assert float(np.sqrt(np.mean((found.temp_c - true) ** 2))) < found.uncertainty_c


def test_uneven_time_is_smoothed_too():
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.choice((0.011, 0.017, 0.1, 2.8), 20000, p=(0.4, 0.4, 0.19, 0.01)))
    true = 15.0 + 10.0 * (1.0 - np.exp(-time / 150.0))
    found = trusted_temperature(session(true + rng.normal(0.0, 0.1, len(time)), time=time), 0)
    assert float(np.sqrt(np.mean((found.temp_c - true) ** 2))) < 1.5 * found.uncertainty_c < 0.02


def test_the_step_of_a_column_is_found():
    assert step_of(np.round(WARM_UP * 8.0) / 8.0) == pytest.approx(0.125)
    assert step_of(np.round(WARM_UP * 340.0) / 340.0) == pytest.approx(1.0 / 340.0)
    assert step_of(WARM_UP) == 0.0
    assert step_of(np.full(10, 25.0)) == 0.0


# ---- plausibility ---------------------------------------------------------------------------------------------------------------


def seen_in(raw, code, words, **kwargs):
    found = trusted_temperature(session(raw, **kwargs), 0)
    assert any(seen.code == code and words in seen.text for seen in found.findings), found.findings
    return found


def test_a_good_column_gives_no_finding():
    assert (
        trusted_temperature(session(WARM_UP + np.random.default_rng(0).normal(0.0, 0.02, len(TIME))), 0).findings == ()
    )


def test_a_column_that_stays_and_then_jumps_is_stale_there():
    raw = np.round(WARM_UP * 8.0) / 8.0
    raw[3000:9000] = raw[3000]
    words = f"{raw[3000]:.2f} degC for 605 s from 295.3 s, then a jump of 5.25 K"
    found = seen_in(raw, "drift.temperature_stale", words)
    assert np.isnan(found.temp_c[4000:8000]).all()
    assert np.abs(found.temp_c[9100:] - WARM_UP[9100:]).max() < 0.1


def test_a_noisy_column_that_freezes_is_stale_without_a_jump():
    raw = WARM_UP + np.random.default_rng(0).normal(0.0, 0.05, len(TIME))
    raw[-2000:] = raw[-2000]
    seen_in(raw, "drift.temperature_stale", "for 200 s")


def test_a_board_does_not_jump():
    raw = WARM_UP + np.where(TIME > 1000.0, 4.0, 0.0) + np.random.default_rng(0).normal(0.0, 0.05, len(TIME))
    words = "by up to 3.97 K, faster than a board changes, first at 1000.1 s (1 such)"
    seen_in(raw, "drift.temperature_jumps", words)


def test_single_wild_readings_are_left_out():
    raw = WARM_UP + np.random.default_rng(0).normal(0.0, 0.05, len(TIME))
    raw[[500, 9000]] += 30.0
    found = seen_in(raw, "drift.temperature_spikes", "2 temperature spikes left out: the first at 50 s")
    assert np.abs(found.temp_c - WARM_UP).max() < 0.1


def test_short_gaps_are_bridged_and_long_ones_stay():
    raw = WARM_UP.copy()
    raw[1000:1050] = raw[5000:7000] = raw[-5:] = np.nan
    words = "2055 temperature readings missing: 50 interpolated in gaps of up to 10 s, 2005 left out"
    found = seen_in(raw, "drift.temperature_gaps", words)
    assert np.abs(found.temp_c[1000:1050] - WARM_UP[1000:1050]).max() < 0.01
    assert np.isnan(found.temp_c[5000:7000]).all()
    assert np.isnan(found.temp_c[-5:]).all()


def test_a_column_that_denies_its_set_point_is_implausible():
    still = (Still(start=20000, stop=24000, temp_c=20.0),)
    seen_in(WARM_UP, "drift.temperature_off_set_point", "the column reads 28.", stills=still)


def test_set_points_stand_in_for_a_column():
    stills = (Still(start=0, stop=100, temp_c=20.0), Still(start=200, stop=300, temp_c=30.0))
    found = trusted_temperature(session(None, stills=stills), 0)
    assert (found.source, found.uncertainty_c, found.step_c, found.noise_c) == ("set-points", 0.5, 0.0, 0.0)
    assert (found.temp_c[:100] == 20.0).all()
    assert np.isnan(found.temp_c[100:200]).all()
    assert (found.findings[0].code, found.findings[0].values["pieces"]) == ("drift.temperature_set_points", 2)


# ---- refusals -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("raw", "kind", "words"),
    [
        (
            None,
            InputError,
            r"temperature of recording 0: wanted a column \(columns.temp\) or set-points .* got neither",
        ),
        (np.full(len(TIME), np.nan), InputError, "wanted readings in 50 % of the rows or more, got 0 of 24000"),
        (np.where(TIME < 500.0, WARM_UP, np.nan), InputError, "got 5000 of 24000"),
        (
            np.full(len(TIME), 25.0),
            NotObservable,
            r"wanted temperatures that differ, got 25.00 degC throughout \(constant\)",
        ),
        (WARM_UP * 0.1, NotObservable, r"wanted a span of 2 degC or more, got 1.\d"),
        (
            WARM_UP + 100.0,
            InputError,
            r"wanted -40 to 125 degC of a board, got 125 degC at 841.2 s \(15588 such\); check units.temp",
        ),
    ],
)
def test_what_no_thermal_fit_can_use_is_refused(raw, kind, words):
    with pytest.raises(kind, match=words):
        check_span([trusted_temperature(session(raw), 0)])


def test_noise_is_no_span():
    raw = 25.0 + np.random.default_rng(0).normal(0.0, 0.5, len(TIME))
    assert np.ptp(raw) > 3.0
    with pytest.raises(NotObservable, match=r"wanted a span of 2 degC or more, got 0\.0"):
        check_span([trusted_temperature(session(raw), 0)])


def test_recordings_at_several_temperatures_are_one_span():
    flat = np.full(len(TIME), 20.0)
    both = session(flat, flat + 10.0)
    found = [trusted_temperature(both, k) for k in (0, 1)]
    assert check_span(found) == pytest.approx(10.0)
    with pytest.raises(NotObservable, match="constant"):
        check_span(found[:1])
    with pytest.raises(NotObservable, match="wanted a recording with a known temperature, got none"):
        check_span([replace(found[0], temp_c=np.full(3, np.nan))])


def test_a_recording_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="wanted recording 0 to 0, got 1"):
        trusted_temperature(session(WARM_UP), 1)


# ---- real recordings: the SOURCE.md in the folder of each names origin and licence -----------------------------------------


def warm_up(column, scale=None):
    columns = ColumnMap(time="Time", gyro=("Gx", "Gy", "Gz"), temp=column, time_unit="ms", gyro_unit="count",
                        temp_unit="degC", temp_scale=scale)  # fmt: skip
    return read_csv(data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz"), columns).record


@pytest.mark.parametrize(("column", "scale"), [("dTemp", Scale(1.0 / 340.0, 36.53)), ("Temp", None)])
def test_a_real_warm_up_keeps_its_shape_and_comes_back_from_whole_degrees(column, scale):
    record = warm_up(column, scale)
    fine = trusted_temperature(of(record), 0)
    off = float(np.sqrt(np.mean((fine.temp_c - record.temp_c) ** 2)))
    first = record.time < record.time[0] + 120.0
    rise = float(np.ptp(fine.temp_c[first]))
    coarse = trusted_temperature(of(replace(record, temp_c=np.round(record.temp_c))), 0)
    back = float(np.sqrt(np.mean((coarse.temp_c - fine.temp_c) ** 2)))
    early = float(np.sqrt(np.mean((coarse.temp_c - fine.temp_c)[first] ** 2)))
    show(f"{column}: rms of raw about the course, K", f"{off:.4f}", "1.2 times its noise, and 0.005")
    show(f"{column}: rise in two minutes, K", f"{rise:.2f}", "7 to 8")
    show(
        f"{column} from whole degrees, rms error, K",
        f"{back:.3f}, first two minutes {early:.3f}",
        f"0.1, 0.2; stated {coarse.uncertainty_c:.2f}",
    )
    assert off < 1.2 * fine.noise_c + 0.005
    assert 7.0 < rise < 8.0
    assert back < 0.1
    assert early < 0.2
    assert fine.findings == ()


def test_a_chip_that_reads_54_degrees_on_a_table_is_called_implausible():
    record = DIALECTS["actigraph"].read(data_path("wearable_formats", "agread_gt9x_example-IMU.csv.gz")).record
    found = trusted_temperature(of(record), 0)
    show("GT9X", [seen.text for seen in found.findings])
    assert any("implausible unless in a chamber: 51.6 to 54.7 degC throughout" in seen.text for seen in found.findings)


def test_two_real_soaks_are_one_span_and_each_alone_is_judged():
    columns = ColumnMap(temp=0, accel=(1, 2, 3), gyro=(4, 5, 6), temp_unit="degC", accel_unit="g", gyro_unit="dps",
                        sample_rate_hz=50.0, layout=TextLayout(header=False, skip_rows=1, drop_bad_rows=True))  # fmt: skip
    hot, cold = (
        read_csv(data_path("thermal_bmi270_two_point", f"BMI_270_{k}_test.csv.gz"), columns).record
        for k in ("hot", "cold")
    )
    found = [trusted_temperature(of(record), 0) for record in (hot, cold)]
    wanted = float(np.quantile(hot.temp_c, 0.99) - np.quantile(cold.temp_c, 0.01))
    show(
        "BMI270 span, K",
        f"{check_span(found):.2f}",
        f"{wanted:.2f} within 0.1: quantiles 1 and 99 % of the raw columns",
    )
    assert check_span(found) == pytest.approx(wanted, abs=0.1)
    assert any(
        seen.code == "drift.temperature_jumps" and "by up to 2.0" in seen.text and "first at 0." in seen.text
        for seen in found[0].findings
    )  # its first ten rows are 2 K warmer
    with pytest.raises(NotObservable, match=r"wanted a span of 2 degC or more, got 0\.\d+ \(13\.0"):
        check_span(found[1:])


def test_eleven_recordings_on_a_bicycle_span_two_degrees_together():
    paths = sorted(data_path("multipos_mpu6050_bicycle").glob("*.npz"))
    held = [np.load(path) for path in paths]
    records = tuple(Record(time=d["t_s"], gyro=d["gyro_rad_s"], temp_c=d["temp_degC"]) for d in held)
    made = Session(kind="thermal", serial="bicycle", gravity_m_s2=9.81, records=records)
    found = [trusted_temperature(made, k) for k in range(len(records))]
    show("bicycle: span together, K", f"{check_span(found):.2f}", "2.0 to 2.5")
    assert 2.0 < check_span(found) < 2.5
    assert all(f.uncertainty_c < 0.02 for f in found)


def test_a_worn_sensor_without_a_thermometer_is_refused():
    columns = ColumnMap(accel=("acc_x", "acc_y", "acc_z"), gyro=("gyr_x", "gyr_y", "gyr_z"), accel_unit="g", gyro_unit="dps",
                        sample_rate_hz=100.0)  # fmt: skip
    record = read_csv(data_path("worn_lowback", "HA_001_Test11.csv.gz"), columns).record
    with pytest.raises(InputError, match="got neither; map the thermometer's column or state temp_c"):
        trusted_temperature(of(record), 0)
