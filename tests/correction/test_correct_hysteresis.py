"""correct: hysteresis is subtracted as far as the course of the temperature is known."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from testkit import twins
from testkit.full_calibration import ROUNDINGS, STEPS, device, record, tables
from undrift.correction.correct import Corrector, correct_checked
from undrift.drift.hysteresis import follow_loop, state_of
from undrift.model import DriftTables, Hysteresis, WarmUp

HALF = np.array([[4.0, -20.0, 0.0], [8.0, -10.0, 2.0]])
LOOP = Hysteresis(
    crossing_k=4.0,
    crossing_uncertainty_k=0.5,
    temp_c=[20.0, 60.0],
    gyro_half_width=HALF,
    gyro_uncertainty=np.ones((2, 3)),
)
WARM_UP = WarmUp(power_on_s=[0.0, 500.0], gyro_offset=[[9.0, 5.0, -3.0], [0.0, 0.0, 0.0]])


def looped(*, adc=None, warm_up=None):
    drift = tables(scale=STEPS[::2])
    static = replace(drift.static, gyro_hysteresis=[6.0, -15.0, 1.0], hysteresis=LOOP, warm_up=warm_up)
    return device(drift=replace(drift, static=static), adc=adc)


def cycled(n=700):
    temp = np.concatenate((np.linspace(30.0, 45.0, n // 2), np.linspace(45.0, 38.0, n - n // 2)))
    return record(n, time=np.arange(n) * 10.0, temp_c=temp)


@pytest.mark.parametrize("adc", ROUNDINGS, ids=["unknown", "truncated", "nearest"])
@pytest.mark.parametrize("history", [None, "cooling", (60.0, 28.0)], ids=["none", "side", "turns"])
def test_what_is_subtracted_is_the_position_times_the_half_width(history, adc):
    r, c = cycled(), looped(adc=adc)
    got = correct_checked(r, c, temp_history=history)
    position, _ = follow_loop(r.temp_c, r.time, state=state_of(history, 4.0))
    half = twins.table(LOOP.temp_c, HALF, r.temp_c)
    plain = replace(c, drift=replace(c.drift, static=replace(c.drift.static, hysteresis=None)))
    h = np.zeros(3)
    if adc is not None and adc.gyro_rounding == "toward_zero":
        h = adc.gyro_lsb
    u = twins.rounded(r.gyro, h, "toward_zero") - position[:, None] * half
    bare = replace(plain, adc=None if adc is None or adc.gyro_rounding == "toward_zero" else adc)
    w, _ = twins.corrected(bare, u, r.accel, r.temp_c)
    if adc is not None and adc.gyro_rounding == "toward_zero":  # the accelerometer's own rounding enters through g
        w += (
            twins.corrected(plain, r.gyro, r.accel, r.temp_c)[0]
            - twins.corrected(bare, twins.rounded(r.gyro, h, "toward_zero"), r.accel, r.temp_c)[0]
        )
        np.testing.assert_allclose(got.record.gyro, w, rtol=0, atol=2e-3)  # the dynamic table is met at another rate
    else:
        np.testing.assert_allclose(got.record.gyro, w, rtol=0, atol=1e-12)
    assert np.abs(got.record.gyro - correct_checked(r, plain).record.gyro).max() > 1e-3


@pytest.mark.parametrize("power_on_s", [None, 100.0])
def test_a_stream_gives_the_bits_of_the_batch(power_on_s):
    r, c = cycled(), looped(warm_up=WARM_UP)
    whole = correct_checked(r, c, power_on_s=power_on_s, temp_history=(25.0,), threads=2)
    corrector = Corrector(c, power_on_s=power_on_s, temp_history=(25.0,))
    bounds = [0, 2, 30, 333, 700]
    parts = [corrector.push_checked(r.part(a, b)).record for a, b in pairwise(bounds)]
    assert np.concatenate([part.gyro for part in parts]).tobytes() == whole.record.gyro.tobytes()
    assert corrector.state.carry == whole.carry


def told(done):
    (found,) = [found for found in done.findings if found.code.startswith("correct.hysteresis")]
    return found


def test_the_notes_say_whether_it_was_corrected():
    c, short = looped(), record(200, temp_c=np.full(200, 40.0))
    widest = np.degrees(np.abs(HALF @ c.gyro.matrix.T).max())
    unknown = told(correct_checked(short, c))
    assert unknown.code == "correct.hysteresis_unknown"
    assert unknown.values["half_width_dps"] == pytest.approx(widest, rel=1e-12)
    assert "counts as uncertainty; temperature moved by less than 4 degC" in unknown.text
    half_known = told(correct_checked(short, c, temp_history=(37.0,)))
    assert half_known.code == "correct.hysteresis_corrected"
    # 3 of 4 K: the position is -0.75 +- 0.25, the crossing 4 +- 0.5 K, the half-width known to 1
    share = np.hypot(0.25, (1.0 - 0.75**2) * 0.5 / 4.0)
    left = np.degrees((np.hypot(share * HALF, 0.75) @ c.gyro.matrix.T).max())
    assert half_known.values["left_dps"] == pytest.approx(left, rel=1e-9)
    sure = np.degrees((np.ones(3) @ c.gyro.matrix.T).max())  # what the half-width itself is known to
    for history in ("warming", (25.0,)):
        known = told(correct_checked(short, c, temp_history=history))
        assert known.code == "correct.hysteresis_corrected"
        assert known.values["left_dps"] == pytest.approx(sure, rel=1e-9)
    by_its_course = told(correct_checked(cycled(), c))
    assert by_its_course.values["left_dps"] == pytest.approx(sure, rel=1e-9)


def test_it_can_be_switched_off():
    c, r = looped(), cycled()
    middle = replace(c, drift=replace(c.drift, static=replace(c.drift.static, hysteresis=None)))
    done, plain = correct_checked(r, c, temp_history="none"), correct_checked(r, middle)
    np.testing.assert_array_equal(done.record.gyro, plain.record.gyro)
    assert told(done).code == "correct.hysteresis"
    assert "which counts as uncertainty" in told(done).text
    stream = Corrector(c, temp_history="none")
    np.testing.assert_array_equal(stream.push_checked(r.part(0, 300)).record.gyro, done.record.gyro[:300])
    np.testing.assert_array_equal(stream.push_checked(r.part(300, 700)).record.gyro, done.record.gyro[300:])


def test_without_history_or_movement_the_middle_of_the_loop_stays():
    c, short = looped(), record(20, temp_c=np.full(20, 40.0))
    middle = replace(c, drift=replace(c.drift, static=replace(c.drift.static, hysteresis=None)))
    a, b = (correct_checked(short, held).record.gyro for held in (c, middle))
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)
    gap = correct_checked(record(20, temp_c=np.r_[np.full(10, np.nan), np.full(10, 40.0)]), c, policy="hold")
    assert np.isnan(gap.record.gyro[:10]).all()
    assert np.isfinite(gap.record.gyro[10:]).all()
    assert isinstance(c.drift, DriftTables)
