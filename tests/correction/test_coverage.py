"""Nodes that no data were near: time spent there, against a plain twin, batch and stream.

Corrected readings beyond what a fit has seen: counted, with the worst, in chunks as at once.
"""

from dataclasses import replace

import numpy as np
import pytest

from testkit import twins
from testkit.full_calibration import GAP, STEPS, WILD, N, device, record, tables
from undrift.correction.correct import Corrector, correct_checked
from undrift.errors import DriftRangeError
from undrift.model import DriftTables, DynamicDrift

QUANTISED = np.round(np.linspace(20.0, 70.0, N) * 2.0) / 2.0  # on the nodes of STEPS


def marked(drift, *, static=None, scale=None, dynamic=None, accel=True):
    """The same tables with marks."""
    if static is not None:
        marks = {"gyro_extrapolated": static} | ({"accel_extrapolated": static[::-1]} if accel else {})
        drift = replace(drift, static=replace(drift.static, **marks))
    if scale is not None:
        drift = replace(drift, scale=replace(drift.scale, gyro_extrapolated=scale))
    if dynamic is not None:
        drift = replace(drift, dynamic=replace(drift.dynamic, extrapolated=dynamic))
    return drift


@pytest.mark.parametrize("nodes", [STEPS, WILD, np.array([18.0, 20.0, 26.0, 75.0])], ids=["even", "searched", "filled"])
@pytest.mark.parametrize("temp", [record().temp_c, QUANTISED], ids=["between", "on nodes"])
def test_sample_at_an_extrapolated_node_is_extrapolated(nodes, temp):
    marks = np.random.default_rng(7).random(len(nodes)) < (0.2 if len(nodes) > 9 else 0.0)
    marks[0] = True
    drift = marked(tables(static=nodes, dynamic=None), static=marks)
    c, r = device(drift=drift), replace(record(), temp_c=temp)
    done = correct_checked(r, c)
    of_rate, of_accel = (twins.extrapolated(nodes, item, temp) for item in (marks, marks[::-1]))
    np.testing.assert_array_equal(done.extrapolated, of_rate | of_accel)
    assert 0 < np.count_nonzero(done.extrapolated) < N
    assert done.reach.seconds_extrapolated == pytest.approx(np.count_nonzero(done.extrapolated) * 0.01)


def test_dynamic_table_is_extrapolated_at_a_mark():
    marks = np.zeros((len(STEPS), len(GAP)), dtype=bool)
    marks[STEPS > 40.0] = np.radians(45.0) < GAP  # hot and fast to the one side
    c = device(drift=marked(tables(static=None, dynamic=(STEPS, GAP)), dynamic=marks))
    done = correct_checked(record(), c, policy="hold")
    hot = record().temp_c > 40.0
    fast = (done.record.gyro > np.radians(45.0)).any(axis=1)
    np.testing.assert_array_equal(done.extrapolated, hot & fast)
    assert 0 < done.extrapolated.sum() < hot.sum()


def test_readings_outside_the_table_are_not_extrapolated():
    marks = (STEPS < 30.0) | (STEPS > 70.0)
    c, r = device(drift=marked(tables(dynamic=None), static=marks)), record(low=10.0, high=80.0)
    for policy in ("hold", "nan"):
        done = correct_checked(r, c, policy=policy)
        assert (r.temp_c[done.outside] < 18.0).any()
        assert (r.temp_c[done.outside] > 75.0).any()
        np.testing.assert_array_equal(done.outside, (r.temp_c < 18.0) | (r.temp_c > 75.0))
        inside = (r.temp_c >= 18.0) & (r.temp_c <= 75.0)
        # the marks of the accelerometers run the other way: below 23 and above 63 degC
        np.testing.assert_array_equal(done.extrapolated, inside & ((r.temp_c < 30.0) | (r.temp_c > 63.0)))
        assert [finding.code for finding in done.findings] == ["correct.outside", "correct.outside"]
        for seconds, warning in zip((done.outside.sum(), done.extrapolated.sum()), done.warnings, strict=True):
            assert f"{seconds * 0.01:.1f} s" in warning


def test_raise_refuses_readings_far_beyond_the_data():
    c = device(drift=marked(tables(dynamic=None), static=STEPS > 60.0, accel=False))
    assert correct_checked(record(high=62.9), c).extrapolated.any()
    with pytest.raises(DriftRangeError, match="18 to 63 degC"):
        correct_checked(record(high=63.9), c)
    with pytest.raises(DriftRangeError, match="18 to 63 degC"):
        Corrector(c, "raise").push_checked(record(high=63.9))


def test_a_stream_reports_the_extrapolated_nodes_of_the_batch():
    marks = np.zeros((len(STEPS), len(GAP)), dtype=bool)
    marks[50:] = GAP > 0.5
    c, r = device(drift=marked(tables(), static=STEPS > 60.0, dynamic=marks)), record(low=10.0, high=80.0)
    batch, corrector = correct_checked(r, c, policy="nan"), Corrector(c, "nan")
    masks = [corrector.push_checked(r.part(k, min(k + 29, N))).extrapolated for k in range(0, N, 29)]
    np.testing.assert_array_equal(np.concatenate(masks), batch.extrapolated)
    assert tuple(item.text for item in corrector.findings) == batch.warnings
    assert corrector.state.reach.samples_extrapolated == batch.extrapolated.sum()
    assert corrector.state.reach.seconds_extrapolated == pytest.approx(batch.reach.seconds_extrapolated)
    many = correct_checked(r, c, policy="nan", threads=3)
    np.testing.assert_array_equal(many.extrapolated, batch.extrapolated)
    assert many.warnings == batch.warnings


def test_mark_on_a_node_of_rate_and_temperature_counts_there():
    temp, rate = np.array([20.0, 30.0, 40.0]), np.array([-1.0, 0.0, 1.0])
    model = replace(device(g=False).gyro, matrix=np.eye(3), offset=np.zeros(3))
    for place in np.ndindex(3, 3):
        marks = np.zeros((3, 3), dtype=bool)
        marks[place] = True
        error = DynamicDrift(temp_c=temp, turn_rate=rate, error=np.zeros((3, 3, 3)), extrapolated=marks)
        c = device(g=False, gyro=model, drift=DriftTables(dynamic=error))
        r = record(9, gyro=np.repeat(rate, 3)[:, None] * np.ones(3), accel=None, temp_c=np.tile(temp, 3))
        np.testing.assert_array_equal(correct_checked(r, c).extrapolated, marks.T.ravel())
