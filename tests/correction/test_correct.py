"""correct: the five steps against a plain twin, buffers, threads, and what it refuses."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from testkit import twins
from testkit.full_calibration import GAP, ROUNDINGS, STEPS, WILD, N, device, record, tables, with_magnetometer
from undrift.correction.correct import Corrector, DriftRangeWarning, correct, correct_checked, correct_whole
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


@pytest.mark.parametrize("n", [255, 256, 257, 700], ids=str)
def test_records_of_more_than_one_block_agree_with_the_twin_to_their_last_sample(n):
    r, c = record(n), device(g=True, drift=tables(scale=WILD), adc=ROUNDINGS[1])
    got = correct_checked(r, c, policy="hold", threads=1)
    w, a = twins.corrected(c, r.gyro, r.accel, r.temp_c)
    np.testing.assert_allclose(got.record.gyro, w, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(got.record.accel, a, rtol=0, atol=CLOSE)
    before_error = twins.corrected(
        device(g=True, drift=tables(scale=WILD, dynamic=None), adc=ROUNDINGS[1]), r.gyro, r.accel, r.temp_c
    )[0]
    np.testing.assert_allclose(got.reach.turn_rate, (before_error.min(), before_error.max()), rtol=0, atol=CLOSE)


def test_a_corrected_device_gives_back_the_motion_that_a_forward_model_fed_it():
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


def test_truncated_codes_get_half_a_step_back_and_code_zero_stays():
    adc = AdcModel(gyro_lsb=[2.0, 2.0, 2.0], gyro_rounding="toward_zero")
    model = replace(device(g=False).gyro, matrix=np.eye(3), offset=np.zeros(3))
    c = device(g=False, gyro=model, adc=adc)
    codes = np.array([[4.0, -4.0, 0.0], [0.0, 2.0, -2.0]])
    got = correct(record(2, gyro=codes, accel=None, temp_c=None), c)
    np.testing.assert_array_equal(got.gyro, [[5.0, -5.0, 0.0], [0.0, 3.0, -3.0]])


def test_floored_codes_get_half_a_step_back_and_rounded_ones_nothing():
    model = replace(device(g=False).gyro, matrix=np.eye(3), offset=np.zeros(3))
    r = record(2, gyro=np.array([[4.0, -4.0, 0.0]] * 2), accel=None, temp_c=None)
    for mode, added in (("floor", 1.0), ("nearest", 0.0)):
        c = device(g=False, gyro=model, adc=AdcModel(gyro_lsb=[2.0, 2.0, 2.0], gyro_rounding=mode))
        np.testing.assert_array_equal(correct(r, c).gyro, r.gyro + added)


def test_readings_in_another_physical_unit_are_converted():
    c = device(unit="si", adc=AdcModel(gyro_lsb=[1e-3] * 3, gyro_rounding="toward_zero"))
    si = record(unit="si", temp_c=None)
    other = si.in_units("dps", "g")
    assert other.gyro_unit == "dps"
    a, b = correct(si, c), correct(other, c)
    np.testing.assert_allclose(b.gyro, a.gyro, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(b.accel, a.accel, rtol=0, atol=CLOSE)


def test_counts_and_physical_units_are_not_mixed():
    with pytest.raises(InputError, match=r"gyro: .*readings in count, .*in"):
        correct(record(unit="si"), device())
    with pytest.raises(InputError, match=r"gyro: .*readings in rad/s, .*in count"):
        correct(record(), device(unit="si"))
    with pytest.raises(InputError, match=r"accel: .*readings in count, .*in v"):
        correct(record(accel_unit="v"), device())


def test_a_corrected_record_is_not_corrected_twice():
    c = device(unit="si", drift=None)
    once = correct(record(unit="si", temp_c=None), c)
    with pytest.raises(InputError, match="expected raw readings"):
        correct(once, c)


def test_a_triad_without_a_model_passes_nominal_values_and_a_note():
    c = device(unit="si", accel=None)
    r = record(unit="si", temp_c=None).in_units("rad/s", "g")
    done = correct_checked(r, c)
    np.testing.assert_allclose(done.record.accel, r.in_si().accel, rtol=1e-15)
    (note,) = [item.text for item in done.findings if item.level == "info"]
    assert "no accel" in note
    with pytest.raises(InputError, match="accel: expected a physical unit, got count"):
        correct(record(temp_c=None, accel_unit="count"), device(accel=None))


def test_another_serial_number_is_a_warning():
    done = correct_checked(record(temp_c=None, device="B"), device())
    (warning,) = done.warnings
    assert "device B" in warning
    assert "device A" in warning


def test_g_sensitivity_needs_the_accelerometer_and_tables_need_the_temperature():
    with pytest.raises(InputError, match="g-sensitivity"):
        correct(record(accel=None), device(g=True))
    with pytest.raises(InputError, match="need temperatures"):
        correct(record(temp_c=None), device(drift=tables()))


def test_a_gap_in_one_triad_does_not_reach_the_other_unless_g_joins_them():
    r = record(temp_c=None)
    accel = r.accel.copy()
    accel[5] = np.nan
    r = replace(r, accel=accel)
    apart, joined = correct(r, device(g=False)), correct(r, device(g=True))
    assert np.isnan(apart.accel[5]).all()
    assert np.isfinite(apart.gyro).all()
    assert np.flatnonzero(np.isnan(joined.gyro).any(axis=1)).tolist() == [5]


@pytest.mark.parametrize("static", [STEPS, WILD], ids=["even", "searched"])
def test_a_gap_in_temperature_is_a_gap_in_the_result_and_not_outside(static):
    r = record()
    temp = r.temp_c.copy()
    temp[7] = np.nan
    done = correct_checked(replace(r, temp_c=temp), device(drift=tables(static=static)))
    assert np.flatnonzero(np.isnan(done.record.gyro).any(axis=1)).tolist() == [7]
    assert not done.outside.any()


@pytest.mark.parametrize("policy", ["raise", "hold", "nan"])
def test_a_gap_in_temperature_is_counted_and_reported_whatever_the_policy(policy):
    r = record()
    temp = r.temp_c.copy()
    temp[50:90] = np.nan
    r = replace(r, temp_c=temp)
    done = correct_checked(r, device(drift=tables()), policy=policy)
    np.testing.assert_array_equal(done.missing, np.isnan(done.record.gyro).any(axis=1))
    assert np.count_nonzero(done.missing) == 40
    assert done.reach.seconds_without_temperature == pytest.approx(0.4, abs=1e-8)
    assert "no temperature for 0.4 s" in done.warnings[0]
    assert not correct_checked(r, device(drift=None), policy=policy).missing.any()  # nothing asks for a temperature


def test_time_outside_is_that_of_the_clock_and_not_a_count_of_median_steps():
    step = np.tile([0.017, 0.017, 0.068], N // 3 + 1)[:N]
    r = replace(record(low=80.0, high=90.0), time=np.cumsum(step))
    done = correct_checked(r, device(drift=tables()), policy="hold")
    assert done.outside.all()
    assert done.reach.seconds_outside == pytest.approx(step.sum(), abs=1e-8)
    with pytest.raises(DriftRangeError, match=f"{step.sum():.1f} s of them outside"):
        correct(r, device(drift=tables()))


def test_a_temperature_outside_the_tables_is_an_error_with_the_numbers():
    with pytest.raises(DriftRangeError) as caught:
        correct(record(low=60.0, high=90.0), device(drift=tables()))
    assert "expected temperatures from 18 to 75 degC, got 60." in str(caught.value)
    assert "policy hold or nan" in str(caught.value)
    assert caught.value.high == 75.0
    assert caught.value.greatest == pytest.approx(90.0, abs=1.0)  # the highest of 203 draws below 90


@pytest.mark.parametrize("static", [STEPS, WILD], ids=["even", "searched"])
def test_hold_keeps_the_end_of_the_table_and_masks_and_warns(static):
    r, c = record(low=0.0, high=100.0), device(drift=tables(static=static, dynamic=None))
    low, high = (18.0, 75.0) if static is STEPS else (17.0, 80.0)
    with pytest.warns(DriftRangeWarning, match="outside the drift table"):
        held = correct(r, c, policy="hold")
    done = correct_checked(r, c, policy="hold")
    np.testing.assert_array_equal(done.outside, (r.temp_c < low) | (r.temp_c > high))
    assert done.reach.seconds_outside == pytest.approx(done.outside.sum() * 0.01)
    w, _ = twins.corrected(c, r.gyro, r.accel, r.temp_c)
    np.testing.assert_allclose(held.gyro, w, rtol=0, atol=CLOSE)


def test_nan_makes_a_gap_of_what_a_table_does_not_cover_in_the_triads_that_have_one():
    r, c = record(low=0.0, high=100.0), device(drift=tables(accel=False))
    done = correct_checked(r, c, policy="nan")
    np.testing.assert_array_equal(np.isnan(done.record.gyro).any(axis=1), done.outside)
    assert np.isfinite(done.record.accel).all()


def test_a_rate_beyond_the_dynamic_table_is_held_and_reported():
    c = device(drift=tables())
    fast = replace(record(), gyro=np.full((N, 3), 3000.0))
    with pytest.warns(DriftRangeWarning, match=r"\(-90.0 to 90.0 deg/s\)"):
        correct(fast, c)


def test_correct_warns_of_all_that_the_checked_correction_states():
    """Of the temperature, of a rate beyond the table, and of a triad whose axes speak against the other."""
    c = device(drift=tables())
    far = replace(record(low=0.0, high=100.0), gyro=np.full((N, 3), 3000.0))
    for raw, model in ((far, c), (record(low=20.0, high=40.0), device(drift=None))):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            correct(raw, model, policy="hold")
        stated = correct_checked(raw, model, policy="hold").warnings
        assert stated
        assert {str(one.message) for one in caught} >= {*stated}
        assert {one.category for one in caught} == {DriftRangeWarning}


def test_constant_offsets_far_from_their_temperature_are_reported():
    c = device(drift=None)
    with pytest.warns(DriftRangeWarning, match=r"by up to 1\d.\d degC from the reference, 25.0 degC"):
        correct(record(low=20.0, high=40.0), c)
    assert correct_checked(record(low=20.1, high=29.9), c).warnings == ()
    assert correct_checked(record(low=20.0, high=40.0), device(reference_temp_c=np.nan)).warnings == ()


@pytest.mark.parametrize("drift", [None, tables(), tables(static=WILD, dynamic=(WILD, GAP))])
@pytest.mark.parametrize("adc", ROUNDINGS[:2])
@pytest.mark.parametrize("g", [False, True])
def test_threads_and_buffers_change_no_bit(drift, adc, g):
    r, c = record(), device(drift=drift, adc=adc, g=g)
    buffers = (np.empty((N, 3)), np.empty((N, 3)))
    one = correct_checked(r, c, policy="hold", threads=1).record
    two = correct_whole(r, c, policy="hold", threads=2, out=buffers).record
    assert one.gyro.tobytes() == two.gyro.tobytes() == buffers[0].tobytes()
    assert one.accel.tobytes() == two.accel.tobytes() == buffers[1].tobytes()


def test_a_buffer_of_another_shape_is_refused():
    with pytest.raises(InputError, match=r"float64 buffers of shape \(203, 3\) in C order, got float64 \(5, 3\)"):
        correct(record(temp_c=None), device(), out=(np.empty((5, 3)), np.empty((N, 3))))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_rate_beyond_the_dynamic_table_is_reported_on_each_axis_and_side(axis, sign):
    model = replace(device(g=False).gyro, matrix=np.eye(3), offset=np.zeros(3))
    gyro = np.zeros((4, 3))
    gyro[2, axis] = sign * np.radians(100.0)  # the table ends at 90 deg/s
    c = device(g=False, gyro=model, drift=tables(static=None))
    still = np.full(4, 25.0)  # the reference temperature
    done = correct_checked(record(4, gyro=gyro, accel=None, temp_c=still), c)
    assert [found.code for found in done.findings] == ["correct.outside"]
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
def test_constant_offsets_far_from_their_temperature_are_reported_on_either_side(away):
    c = device(g=False)  # reference temperature 25 degC
    done = correct_checked(record(4, temp_c=np.linspace(25.0, 25.0 + away, 4)), c)
    assert [found.code for found in done.findings] == ["correct.departure"]
    assert done.findings[0].values["departure_c"] == pytest.approx(12.0)


def test_a_magnetometer_is_corrected_by_the_rate_in_whole_and_in_chunks():
    c, r = with_magnetometer(device(drift=None)), record(temp_c=np.full(N, 25.0))
    r = replace(r, mag_ut=np.random.default_rng(6).uniform(-50.0, 50.0, (len(r), 3)))
    done, made = correct(r, c), c.magnetometer
    x = (r.mag_ut - made.model.offset) @ made.model.matrix.T
    np.testing.assert_allclose(done.mag_ut, x - made.lag_s * np.cross(done.gyro, x), rtol=0.0, atol=1e-12)
    corrector = Corrector(c)
    chunks = [corrector.push(r.part(first, min(first + 100, len(r)))).mag_ut for first in range(0, len(r), 100)]
    np.testing.assert_array_equal(np.concatenate(chunks), done.mag_ut)
    assert correct(replace(r, mag_ut=None), c).mag_ut is None
    np.testing.assert_array_equal(correct(r, device(drift=None), check=False).mag_ut, r.mag_ut)  # carried along
