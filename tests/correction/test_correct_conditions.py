"""Lag of the thermometer, time since power-on, turns and chunks of a stream: what correction carries from sample to sample."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testkit import twins
from testkit.full_calibration import ROUNDINGS, STEPS, WILD, N, device, record, tables
from undrift.correction.correct import Corrector, correct, correct_checked
from undrift.correction.plan import without_lag
from undrift.correction.rest import rest_offset
from undrift.errors import DriftRangeError, InputError
from undrift.model import CODE_NAMES, MATRIX_NAMES, MOVING_NAMES, OFFSET_NAMES, DriftTables, StaticDrift, WarmUp
from undrift.record import Still

CLOSE = 1e-13  # as in test_correct
TIMES = np.array([0.0, 0.3, 0.7, 1.5])  # s: over before the record of 2 s is
WARM = WarmUp(power_on_s=TIMES, gyro_offset=np.random.default_rng(8).normal(size=(4, 3)) * [[40], [20], [9], [0]])
LONG = 1200
FIRST = Still(start=0, stop=290)  # a rest of 2.9 s
MOVING, CODE = np.array([0.02, -0.01, 0.03]), np.array([0.4, -0.3, 0.7])  # rad/s, counts


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


def test_range_is_that_of_the_temperature_without_lag():
    # at 15 degC/s half a second late, a tenth of it left: 6 degC more at the end
    r = record(temp_c=np.linspace(40.0, 70.0, N))
    c = device(drift=lagging(tables(dynamic=None)))
    assert not correct_checked(r, device(drift=tables(dynamic=None))).outside.any()
    with pytest.raises(DriftRangeError, match=r"got 40.0 to 7[5-7].\d degC"):
        correct_checked(r, c)
    done = correct_checked(r, c, policy="hold")
    assert done.reach.seconds_outside == pytest.approx(0.06, abs=0.011)  # 0.94 degC above 75; one sample at each end
    assert "0.5 s" in done.warnings[0]


# ---- the change of the offset while the device turns, and the loss by codes


def moving(drift=None, *, code=CODE, **changes):
    model = device(drift=drift, **changes)
    gyro = replace(
        model.gyro, moving_offset=MOVING, code_offset=code,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES, *MOVING_NAMES, *CODE_NAMES), covariance=np.eye(18) * 1e-6,
    )  # fmt: skip
    return replace(model, gyro=gyro)


def turns_and_rests(calibration, **changes):
    """Two turns between rests, in counts, and the true rates."""
    rng, time = np.random.default_rng(5), np.arange(LONG) * 0.01
    rate = np.zeros((LONG, 3))
    rate[300:520], rate[800:900] = rng.normal(size=(220, 3)) * 2.0, (0.2, 0.0, 0.1)
    gyro = np.round(rate @ calibration.gyro.forward_matrix.T + calibration.gyro.offset)
    return record(LONG, gyro=gyro, time=time, **changes)


def as_at_rest(calibration):
    return replace(calibration, gyro=replace(calibration.gyro, moving_offset=None))


@pytest.mark.parametrize("g", [True, False])
def test_the_change_is_subtracted_while_the_device_turns_alone(g):
    c = moving(g=g)
    r = turns_and_rests(c)
    got, without = (correct_checked(r, item).record for item in (c, as_at_rest(c)))
    u = r.gyro + CODE * np.sign(r.gyro) * (np.abs(r.gyro) > np.abs(CODE))
    w, _ = twins.corrected(c, u, r.accel, r.temp_c)
    np.testing.assert_allclose(without.gyro, w, rtol=0, atol=CLOSE)
    m = twins.turning(w, r.time)
    np.testing.assert_allclose(got.gyro, w - m[:, None] * MOVING, rtol=0, atol=CLOSE)
    if not g:  # forces drawn at random make rates by the g-sensitivity
        assert m[:300].max() == m[640:790].max() == 0.0  # half a second beyond what the low-pass needs
        assert m[303:570].min() == m[805:940].min() == 1.0  # from a few samples on


def test_the_rest_is_subtracted_once():
    # What a device reads at rest has moved by 3 counts: the rest takes that, and the turns keep the change to motion.
    c = moving(g=False)
    r = turns_and_rests(c)
    later = replace(r, gyro=np.asarray(r.gyro) + 3.0)
    rest = rest_offset(correct_checked(later, c).record, FIRST)
    gyro = correct_checked(later, c, offset=rest).record.gyro
    np.testing.assert_allclose(gyro[:280].mean(axis=0), 0.0, atol=1e-12)
    before = correct_checked(r, c, offset=rest_offset(correct_checked(r, c).record, FIRST)).record.gyro
    np.testing.assert_allclose(gyro[300:520], before[300:520], rtol=0, atol=2e-3)  # but for codes about zero


def test_the_rest_states_what_is_left_of_the_change_to_motion():
    c = moving(g=False)
    r = turns_and_rests(c, accel=np.tile((0.0, 0.0, 1962.0), (LONG, 1)))
    rest, assumed = (
        correct_checked(r, item, offset="rest").rest
        for item in (c, replace(c, gyro=replace(c.gyro, moving_offset=None)))
    )
    assert rest.moved == pytest.approx(np.sqrt(3e-6 + 3.0 * np.radians(0.005) ** 2), rel=1e-12)
    assert assumed.moved == pytest.approx(np.sqrt(3.0) * np.radians(0.02), rel=1e-12)
    assert rest.uncertainty == pytest.approx(np.sqrt(np.trace(rest.covariance[0]) + rest.moved**2), rel=1e-12)


@pytest.mark.parametrize("adc", ROUNDINGS)
def test_fitted_code_offset_replaces_half_a_step(adc):
    plain = moving(g=False)
    c, r = replace(plain, adc=adc), turns_and_rests(plain)
    assert correct_checked(r, c).record.gyro.tobytes() == correct_checked(r, plain).record.gyro.tobytes()


# ---- a stream


def gap_in(r, channel, rows):
    values = np.array(getattr(r, channel))
    values[rows] = np.nan
    return replace(r, **{channel: values})


STREAMED = [  # calibration, record and time since power-on
    *(
        (device(drift=d, adc=a, g=g), record(low=10.0, high=80.0), None)
        for d in (None, tables(), tables(static=WILD, scale=WILD))
        for a in ROUNDINGS[:2]
        for g in (False, True)
    ),
    *(
        (warming(lagging(tables()), adc=ROUNDINGS[1]), gap_in(ramp(), "temp_c", slice(20, 25)), since)
        for since in (None, 0.9)
    ),
    (moving(), gap_in(turns_and_rests(moving()), "gyro", slice(310, 320)), None),
]


def streamed(c, r, bounds, policy, since=None):
    """Return the corrected chunks, each by a corrector that was restored from the state of the one before, and the last one."""
    corrector, pieces = Corrector(c, policy, power_on_s=since), []
    for first, stop in pairwise(bounds):
        pieces.append(corrector.push_checked(r.part(first, stop)))
        saved, corrector = corrector.state, Corrector(c, policy, power_on_s=since)
        corrector.state = saved
    return pieces, corrector


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(
    which=st.integers(0, len(STREAMED) - 1),
    cuts=st.sets(st.floats(0.0, 1.0)),
    policy=st.sampled_from(["hold", "nan"]),
)
def test_a_stream_equals_the_batch_to_the_last_bit(which, cuts, policy):
    c, r, since = STREAMED[which]
    rows = {round(2 + cut * (len(r) - 4)) for cut in cuts}
    bounds = [0, *(k for k in sorted(rows) if k - 1 not in rows), len(r)]  # chunks of two samples or more
    batch = correct_checked(r, c, policy=policy, power_on_s=since)
    pieces, corrector = streamed(c, r, bounds, policy, since)
    assert np.concatenate([p.record.gyro for p in pieces]).tobytes() == batch.record.gyro.tobytes()
    assert np.concatenate([p.record.accel for p in pieces]).tobytes() == batch.record.accel.tobytes()
    assert np.concatenate([p.outside for p in pieces]).tolist() == batch.outside.tolist()
    assert corrector.state.reach.samples == len(r)
    assert corrector.state.reach.samples_outside == batch.outside.sum()


def test_a_chunk_that_comes_again_is_refused_and_the_state_stays():
    r, corrector = record(temp_c=None), Corrector(device())
    corrector.push(r.part(0, 50))
    before = corrector.state
    with pytest.raises(InputError, match=r"after 0.49 s"):
        corrector.push(r.part(40, 60))
    assert corrector.state == before


def test_seconds_of_a_stream_are_those_of_the_batch():
    rng = np.random.default_rng(8)
    r = record(low=0.0, high=90.0)
    temp = np.where(rng.random(N) < 0.1, np.nan, r.temp_c)
    r = replace(r, time=np.cumsum(rng.uniform(0.001, 0.3, N)), temp_c=temp)
    c = device(drift=tables())
    batch = correct_checked(r, c, policy="hold")
    _, corrector = streamed(c, r, [0, 2, 31, 132, N], "hold")
    assert corrector.state.reach.seconds_outside == pytest.approx(batch.reach.seconds_outside)
    assert batch.reach.seconds_outside > 1.0
    assert corrector.state.reach.samples_without_temperature == np.isnan(temp).sum() == batch.missing.sum() > 10
    assert tuple(item.text for item in corrector.findings) == batch.warnings


def test_a_stream_refuses_a_corrected_record():
    c = device(unit="si", drift=None)
    raw, corrector = record(unit="si", temp_c=None), Corrector(c)
    corrector.push(raw.part(0, 50))  # the plans of these units are made
    with pytest.raises(InputError, match="expected raw readings"):
        corrector.push(correct(raw.part(50, N), c))
    assert corrector.state.reach.samples == 50
