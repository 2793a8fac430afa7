"""correct: the five steps against a plain twin, buffers, threads, and what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from testkit import twins
from testkit.full_calibration import GAP, ROUNDINGS, STEPS, WILD, N, device, record, tables, with_magnetometer
from undrift.correction.correct import Corrector, DriftRangeWarning, correct, correct_checked
from undrift.errors import DriftRangeError, InputError
from undrift.model import AdcModel

# Twin and kernel do the same sums in another order and with fused products: a few units in the last place of values near 10.
CLOSE = 1e-13


@pytest.mark.parametrize("adc", ROUNDINGS, ids=["unknown", "truncated", "nearest"])
@pytest.mark.parametrize("g", [False, True], ids=["no g", "g"])
@pytest.mark.parametrize(
    "drift",
    [
        None,
        tables(),
        tables(accel=False),
        tables(static=None, scale=STEPS[::2], dynamic=None),
        tables(static=WILD, scale=WILD, dynamic=(WILD, np.array([-1.0, -0.31, 0.0, 0.7, 1.1]))),
        tables(scale=np.array([10.0, 30.0, 80.0]), dynamic=(np.array([18.0, 20.0, 26.0, 75.0]), np.array([-2.0, 2.0]))),
    ],
    ids=["constant", "even", "gyro only", "scale", "searched", "filled"],
)
def test_every_step_agrees_with_the_plain_twin(drift, g, adc):
    r, c = record(), device(g=g, drift=drift, adc=adc)
    got = correct_checked(r, c, policy="hold").record
    w, a = twins.corrected(c, r.gyro, r.accel, r.temp_c)
    np.testing.assert_allclose(got.gyro, w, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(got.accel, a, rtol=0, atol=CLOSE)
    assert (got.state, got.frame, got.gyro_unit, got.accel_unit) == ("corrected", "b", "rad/s", "m/s2")
    assert not got.gyro.flags.writeable


@pytest.mark.parametrize("change", [{"offset": np.array([1e4, -1e4, 1e4])}, {"matrix": np.eye(3) * 7.0}])
def test_a_constant_that_a_table_replaces_has_no_say(change):
    r, c = record(), device(drift=tables(scale=STEPS))
    other = replace(c, gyro=replace(c.gyro, **change), accel=replace(c.accel, **change))
    assert correct_checked(r, c).record.gyro.tobytes() == correct_checked(r, other).record.gyro.tobytes()
    assert correct_checked(r, c).record.accel.tobytes() == correct_checked(r, other).record.accel.tobytes()


@pytest.mark.parametrize("n", [256, 257, 700], ids=str)
def test_long_records_agree_with_the_twin_to_their_last_sample(n):
    r, c = record(n), device(g=True, drift=tables(scale=WILD), adc=ROUNDINGS[1])
    got = correct_checked(r, c, policy="hold", threads=1)
    w, a = twins.corrected(c, r.gyro, r.accel, r.temp_c)
    np.testing.assert_allclose(got.record.gyro, w, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(got.record.accel, a, rtol=0, atol=CLOSE)
    before_error = twins.corrected(
        device(g=True, drift=tables(scale=WILD, dynamic=None), adc=ROUNDINGS[1]), r.gyro, r.accel, r.temp_c
    )[0]
    np.testing.assert_allclose(got.reach.turn_rate, (before_error.min(), before_error.max()), rtol=0, atol=CLOSE)


def test_corrected_device_gives_back_the_motion():
    c = device(g=True)
    rng = np.random.default_rng(5)
    w, a = rng.normal(size=(N, 3)), rng.normal(size=(N, 3)) * 9.81
    raw = record(
        gyro=(w + a @ c.gyro.g_sensitivity.T) @ c.gyro.forward_matrix.T + c.gyro.offset,
        accel=a @ c.accel.forward_matrix.T + c.accel.offset,
        temp_c=None,
    )
    got = correct(raw, c)
    np.testing.assert_allclose(got.gyro, w, rtol=0, atol=1e-12)  # two 3x3 products of values near 1000 counts
    np.testing.assert_allclose(got.accel, a, rtol=0, atol=1e-12)


def test_truncated_codes_get_half_a_step_back():
    adc = AdcModel(gyro_lsb=[2.0, 2.0, 2.0], gyro_rounding="toward_zero")
    model = replace(device(g=False).gyro, matrix=np.eye(3), offset=np.zeros(3))
    c = device(g=False, gyro=model, adc=adc)
    codes = np.array([[4.0, -4.0, 0.0], [0.0, 2.0, -2.0]])
    got = correct(record(2, gyro=codes, accel=None, temp_c=None), c)
    np.testing.assert_array_equal(got.gyro, [[5.0, -5.0, 0.0], [0.0, 3.0, -3.0]])


def test_readings_in_another_physical_unit_are_converted():
    c = device(unit="si", adc=AdcModel(gyro_lsb=[1e-3] * 3, gyro_rounding="toward_zero"))
    si = record(unit="si", temp_c=None)
    other = si.in_units("dps", "g")
    assert other.gyro_unit == "dps"
    a, b = correct(si, c), correct(other, c)
    np.testing.assert_allclose(b.gyro, a.gyro, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(b.accel, a.accel, rtol=0, atol=CLOSE)


def test_triad_without_a_model_passes_nominal_values():
    c = device(unit="si", accel=None)
    r = record(unit="si", temp_c=None).in_units("rad/s", "g")
    done = correct_checked(r, c)
    np.testing.assert_allclose(done.record.accel, r.in_si().accel, rtol=1e-15)
    (note,) = [item.text for item in done.findings if item.level == "info"]
    assert "no accel" in note


def test_another_serial_number_is_a_warning():
    done = correct_checked(record(temp_c=None, device="B"), device())
    assert [finding.level for finding in done.findings if finding.code == "correct.device"] == ["warn"]


def test_gap_in_one_triad_does_not_reach_the_other():
    r = record(temp_c=None)
    accel = r.accel.copy()
    accel[5] = np.nan
    r = replace(r, accel=accel)
    apart, joined = correct(r, device(g=False)), correct(r, device(g=True))
    assert np.isnan(apart.accel[5]).all()
    assert np.isfinite(apart.gyro).all()
    assert np.flatnonzero(np.isnan(joined.gyro).any(axis=1)).tolist() == [5]


@pytest.mark.parametrize("policy", ["raise", "hold", "nan"])
def test_gap_in_temperature_is_counted_under_every_policy(policy):
    r = record()
    temp = r.temp_c.copy()
    temp[50:90] = np.nan
    r = replace(r, temp_c=temp)
    done = correct_checked(r, device(drift=tables()), policy=policy)
    np.testing.assert_array_equal(done.missing, np.isnan(done.record.gyro).any(axis=1))
    assert np.count_nonzero(done.missing) == 40
    assert done.reach.seconds_without_temperature == pytest.approx(0.4, abs=1e-8)
    assert done.warnings
    assert not correct_checked(r, device(drift=None), policy=policy).missing.any()  # nothing asks for a temperature


def test_time_outside_is_that_of_the_clock():
    step = np.tile([0.017, 0.017, 0.068], N // 3 + 1)[:N]
    r = replace(record(low=80.0, high=90.0), time=np.cumsum(step))
    done = correct_checked(r, device(drift=tables()), policy="hold")
    assert done.outside.all()
    assert done.reach.seconds_outside == pytest.approx(step.sum(), abs=1e-8)
    with pytest.raises(DriftRangeError, match=f"{step.sum():.1f} s outside"):
        correct(r, device(drift=tables()))


def test_temperature_outside_the_tables_is_an_error():
    with pytest.raises(DriftRangeError) as caught:
        correct(record(low=60.0, high=90.0), device(drift=tables()))
    assert caught.value.least == pytest.approx(60.0, abs=1.0)
    assert caught.value.high == 75.0
    assert caught.value.greatest == pytest.approx(90.0, abs=1.0)  # the highest of 203 draws below 90


@pytest.mark.parametrize("static", [STEPS, WILD], ids=["even", "searched"])
def test_hold_keeps_the_end_of_the_table_and_masks_and_warns(static):
    r, c = record(low=0.0, high=100.0), device(drift=tables(static=static, dynamic=None))
    low, high = (18.0, 75.0) if static is STEPS else (17.0, 80.0)
    with pytest.warns(DriftRangeWarning, match="degC were recorded"):
        held = correct(r, c, policy="hold")
    done = correct_checked(r, c, policy="hold")
    np.testing.assert_array_equal(done.outside, (r.temp_c < low) | (r.temp_c > high))
    assert done.reach.seconds_outside == pytest.approx(done.outside.sum() * 0.01)
    w, _ = twins.corrected(c, r.gyro, r.accel, r.temp_c)
    np.testing.assert_allclose(held.gyro, w, rtol=0, atol=CLOSE)


def test_nan_makes_gaps_in_the_triads_that_have_a_table():
    r, c = record(low=0.0, high=100.0), device(drift=tables(accel=False))
    done = correct_checked(r, c, policy="nan")
    np.testing.assert_array_equal(np.isnan(done.record.gyro).any(axis=1), done.outside)
    assert np.isfinite(done.record.accel).all()


@pytest.mark.parametrize("drift", [None, tables(), tables(static=WILD, dynamic=(WILD, GAP))])
@pytest.mark.parametrize("adc", ROUNDINGS[:2])
@pytest.mark.parametrize("g", [False, True])
def test_threads_and_buffers_change_no_bit(drift, adc, g):
    r, c = record(), device(drift=drift, adc=adc, g=g)
    buffers = (np.empty((N, 3)), np.empty((N, 3)))
    one = correct_checked(r, c, policy="hold", threads=1).record
    two = correct_checked(r, c, policy="hold", threads=2, out=buffers).record
    assert one.gyro.tobytes() == two.gyro.tobytes() == buffers[0].tobytes()
    assert one.accel.tobytes() == two.accel.tobytes() == buffers[1].tobytes()


@pytest.mark.parametrize(("axis", "sign"), [(0, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)])
def test_rate_beyond_the_table_is_reported_on_each_side(axis, sign):
    model = replace(device(g=False).gyro, matrix=np.eye(3), offset=np.zeros(3))
    gyro = np.zeros((4, 3))
    gyro[2, axis] = sign * np.radians(100.0)  # the table ends at 90 deg/s
    c = device(g=False, gyro=model, drift=tables(static=None))
    still = np.full(4, 25.0)  # the reference temperature
    done = correct_checked(record(4, gyro=gyro, accel=None, temp_c=still), c)
    assert [finding.code for finding in done.findings] == ["correct.outside"]
    values = done.findings[0].values
    assert (values["least_dps"], values["greatest_dps"]) == pytest.approx(
        (min(sign * 100.0, 0.0), max(sign * 100.0, 0.0))
    )
    inside = correct_checked(record(4, gyro=0.8 * gyro, accel=None, temp_c=still), c)
    assert inside.findings == ()


def test_several_tables_hold_where_all_of_them_reach():
    c = device(drift=tables(static=np.linspace(20.0, 60.0, 5), dynamic=(np.linspace(30.0, 70.0, 5), GAP)))
    temps = np.array([19.0, 25.0, 30.0, 60.0, 65.0])
    done = correct_checked(record(5, temp_c=temps, accel=None), device(g=False, drift=c.drift), policy="hold")
    np.testing.assert_array_equal(done.outside, [True, True, False, False, True])


@pytest.mark.parametrize("away", [-12.0, 12.0])
def test_offsets_far_from_their_temperature_are_reported(away):
    c = device(g=False)  # reference temperature 25 degC
    done = correct_checked(record(4, temp_c=np.linspace(25.0, 25.0 + away, 4)), c)
    assert [finding.code for finding in done.findings] == ["correct.departure"]
    assert done.findings[0].values["departure_c"] == pytest.approx(12.0)


def test_magnetometer_is_corrected_in_whole_and_in_chunks():
    c, r = with_magnetometer(device(drift=None)), record(temp_c=np.full(N, 25.0))
    r = replace(r, mag_ut=np.random.default_rng(6).uniform(-50.0, 50.0, (len(r), 3)))
    done, result = correct(r, c), c.magnetometer
    x = (r.mag_ut - result.model.offset) @ result.model.matrix.T
    np.testing.assert_allclose(done.mag_ut, x - result.lag_s * np.cross(done.gyro, x), rtol=0.0, atol=1e-12)
    corrector = Corrector(c)
    chunks = [corrector.push(r.part(first, min(first + 100, len(r)))).mag_ut for first in range(0, len(r), 100)]
    np.testing.assert_array_equal(np.concatenate(chunks), done.mag_ut)
    assert correct(replace(r, mag_ut=None), c).mag_ut is None
    np.testing.assert_array_equal(correct(r, device(drift=None), check=False).mag_ut, r.mag_ut)  # carried along


@pytest.mark.parametrize(
    ("readings", "calibration", "words"),
    [
        (record(unit="si"), device(), "readings in count"),
        (record(), device(unit="si"), "readings in rad/s"),
        (record(accel_unit="v"), device(), "readings in count"),
        (correct(record(unit="si", temp_c=None), device(unit="si", drift=None)), device(unit="si"), "raw readings"),
        (record(accel=None), device(g=True), "g-sensitivity"),
        (record(temp_c=None), device(drift=tables()), "need temperatures"),
        (record(temp_c=None, accel_unit="count"), device(accel=None), "got count"),
    ],
)
def test_readings_that_the_calibration_does_not_fit_are_refused(readings, calibration, words):
    with pytest.raises(InputError, match=words):
        correct(readings, calibration)
