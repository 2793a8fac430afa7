"""Temperature without the thermometer's lag and time since power-on: what the tables are looked up with, batch and stream."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testkit import twins
from testkit.full_calibration import ROUNDINGS, STEPS, N, device, record, tables
from undrift.correction.correct import Corrector, correct_checked
from undrift.drift.temperature import without_lag
from undrift.errors import DriftRangeError, InputError
from undrift.model import DriftTables, StaticDrift, WarmUp

CLOSE = 1e-13  # as in test_correct
TIMES = np.array([0.0, 0.3, 0.7, 1.5])  # s: over before the record of 2 s is
WARM = WarmUp(power_on_s=TIMES, gyro_offset=np.random.default_rng(8).normal(size=(4, 3)) * [[40], [20], [9], [0]])


def warming(drift=None, **changes):
    static = StaticDrift(temp_c=[18.0, 75.0], warm_up=WARM)  # alone, beside the constant offset
    if drift is not None:
        static = replace(drift.static, warm_up=WARM)
    return device(drift=replace(drift or DriftTables(), static=static), **changes)


def ramp(**changes):
    return record(temp_c=np.linspace(30.0, 60.0, N) + np.random.default_rng(2).normal(size=N) * 0.02, **changes)


def corrected(r, c, **choices):
    return correct_checked(r, c, **choices).record


def lagging(drift, lag_s=0.5, smooth_s=0.1):
    return replace(drift, lag_s=lag_s, lag_smooth_s=smooth_s)


@pytest.mark.parametrize("drift", [None, tables(), tables(scale=STEPS)], ids=["warm-up alone", "tables", "scale"])
@pytest.mark.parametrize("adc", ROUNDINGS[:2], ids=["unknown", "truncated"])
@pytest.mark.parametrize("since", [0.0, 0.9, 1e6])
def test_warm_up_is_subtracted_until_it_is_over(drift, adc, since):
    c, r = warming(drift, adc=adc), record()
    got = corrected(r, c, power_on_s=since)
    w, a = twins.corrected(c, r.gyro, r.accel, r.temp_c, since + r.time - r.time[0])
    np.testing.assert_allclose(got.gyro, w, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(got.accel, a, rtol=0, atol=CLOSE)
    settled = since + r.time - r.time[0] >= TIMES[-1]
    assert got.gyro[settled].tobytes() == corrected(r, c).gyro[settled].tobytes()


def test_a_warm_up_alone_asks_for_no_temperature():
    c, r = warming(), record(temp_c=None)
    w, _ = twins.corrected(c, r.gyro, r.accel, None, r.time)
    np.testing.assert_allclose(corrected(r, c, power_on_s=0.0).gyro, w, rtol=0, atol=CLOSE)


def test_a_warm_up_is_converted_with_the_readings():
    c = warming(unit="si")
    r = record(unit="si", temp_c=None)
    si, dps = corrected(r, c, power_on_s=0.1), corrected(r.in_units("dps", "g"), c, power_on_s=0.1)
    np.testing.assert_allclose(dps.gyro, si.gyro, rtol=0, atol=1e-12)  # rad/s of warm-ups near 40


def test_no_warm_up_is_subtracted_without_power_on():
    c, r = warming(tables()), record()
    done = correct_checked(r, c)
    assert done.record.gyro.tobytes() == corrected(r, device(drift=tables())).gyro.tobytes()
    most = np.degrees(np.abs(WARM.gyro_offset @ c.gyro.matrix.T).max())
    assert [item.code for item in done.findings if item.level == "info"] == ["correct.warm_up"]
    assert done.findings[-1].code == "correct.warm_up"
    assert done.findings[-1].values["largest_dps"] == pytest.approx(most, rel=1e-12)
    assert all(item.level == "warn" for item in correct_checked(r, c, power_on_s=0.0).findings)


@pytest.mark.parametrize("since", [-1.0, np.nan, np.inf])
def test_a_time_since_power_on_that_is_none_is_refused(since):
    with pytest.raises(InputError, match="0 s or"):
        corrected(record(), warming(), power_on_s=since)
    with pytest.raises(InputError, match="Omit it"):
        Corrector(warming(), power_on_s=since)


def test_tables_are_read_at_the_temperature_without_lag():
    r, drift = ramp(), tables()
    led, _ = without_lag(r.temp_c, r.time, lag_s=0.5, smooth_s=0.1)
    assert np.abs(led - r.temp_c).max() > 3.0  # degC: the test could fail
    got = corrected(r, device(drift=lagging(drift)), policy="hold")
    wanted = corrected(replace(r, temp_c=led), device(drift=drift), policy="hold")
    assert got.gyro.tobytes() == wanted.gyro.tobytes()
    assert got.accel.tobytes() == wanted.accel.tobytes()
    assert got.temp_c.tobytes() == r.temp_c.tobytes()


def test_gap_in_temperature_stays_a_gap_with_a_lag():
    r = ramp()
    temp = r.temp_c.copy()
    temp[[0, 7, 8, 100]] = np.nan
    done = correct_checked(replace(r, temp_c=temp), device(drift=lagging(tables())), policy="hold")
    assert np.flatnonzero(np.isnan(done.record.gyro).any(axis=1)).tolist() == [0, 7, 8, 100]


def test_range_is_that_of_the_temperature_without_lag():
    r = record(
        temp_c=np.linspace(40.0, 70.0, N)
    )  # at 15 degC/s half a second late, a tenth of it left: 6 degC more at the end
    c = device(drift=lagging(tables(dynamic=None)))
    assert not correct_checked(r, device(drift=tables(dynamic=None))).outside.any()
    with pytest.raises(DriftRangeError, match=r"got 40.0 to 7[5-7].\d degC"):
        correct_checked(r, c)
    done = correct_checked(r, c, policy="hold")
    assert done.reach.seconds_outside == pytest.approx(0.06, abs=0.011)  # 0.94 degC above 75; one sample at each end
    assert "0.5 s" in done.warnings[0]


def test_a_lag_without_a_table_changes_nothing():
    r = ramp(device="A")
    drift = DriftTables(lag_s=10.0, lag_smooth_s=1.0)
    quiet = {"reference_temp_c": np.nan}
    assert corrected(r, device(drift=drift, **quiet)).gyro.tobytes() == corrected(r, device(**quiet)).gyro.tobytes()


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(cuts=st.sets(st.integers(2, N - 2)), since=st.none() | st.floats(0.0, 3.0), start=st.sampled_from([0.0, 1.7e9]))
def test_stream_with_lag_and_power_on_equals_the_batch(cuts, since, start):
    r = replace(ramp(), time=start + np.arange(N) * 0.01)
    temp = r.temp_c.copy()
    temp[20:25] = np.nan
    r, c = replace(r, temp_c=temp), warming(lagging(tables()), adc=ROUNDINGS[1])
    batch = correct_checked(r, c, policy="nan", power_on_s=since)
    bounds = [0, *(k for k in sorted(cuts) if k - 1 not in cuts), N]
    corrector, pieces = Corrector(c, "nan", power_on_s=since), []
    for first, stop in pairwise(bounds):
        pieces.append(corrector.push_checked(r.part(first, stop)))
        saved, corrector = corrector.state, Corrector(c, "nan", power_on_s=since)  # as after a restart
        corrector.state = saved
    assert np.concatenate([p.record.gyro for p in pieces]).tobytes() == batch.record.gyro.tobytes()
    assert np.concatenate([p.record.accel for p in pieces]).tobytes() == batch.record.accel.tobytes()
    assert np.concatenate([p.outside for p in pieces]).tolist() == batch.outside.tolist()
    infos = [[item.text for item in done.findings if item.level == "info"] for done in (*pieces, batch)]
    assert set().union(*infos[:-1]) == set(infos[-1])


def test_a_chunk_that_is_refused_leaves_the_lag_where_it_was():
    r, c = record(temp_c=np.linspace(40.0, 90.0, N)), device(drift=lagging(tables()))
    corrector = Corrector(c)
    corrector.push_checked(r.part(0, 80))
    before = corrector.state
    with pytest.raises(DriftRangeError):
        corrector.push_checked(r.part(80, N))
    assert corrector.state is before
    again = corrector.push_checked(r.part(80, 90)).record.gyro
    assert again.tobytes() == corrected(r.part(0, 90), c).gyro[80:].tobytes()


def test_threads_change_no_bit_of_a_warm_up_or_a_lag():
    r, c = ramp(), warming(lagging(tables()))
    one = correct_checked(r, c, policy="hold", power_on_s=0.0, threads=1).record
    many = correct_checked(r, c, policy="hold", power_on_s=0.0, threads=3).record
    assert one.gyro.tobytes() == many.gyro.tobytes()
