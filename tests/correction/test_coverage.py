"""Corrected readings beyond what a fit has seen: counted, with the worst, in chunks as at once.

How long marked samples last: by their own clock, in one piece or in many.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from testkit.full_calibration import STEPS, N, device, record, tables
from undrift.correction.correct import Corrector, correct_checked
from undrift.correction.coverage import seconds_of
from undrift.errors import DriftRangeError

QUANTISED = np.round(np.linspace(20.0, 70.0, N) * 2.0) / 2.0  # on the nodes of STEPS


def marked(drift, *, static, accel=True):
    """The same tables with marks."""
    marks = {"gyro_extrapolated": static} | ({"accel_extrapolated": static[::-1]} if accel else {})
    return replace(drift, static=replace(drift.static, **marks))


def test_readings_outside_the_table_are_counted():
    marks = (STEPS < 30.0) | (STEPS > 70.0)
    c, r = device(drift=marked(tables(dynamic=None), static=marks)), record(low=10.0, high=80.0)
    for policy in ("hold", "nan"):
        done = correct_checked(r, c, policy=policy)
        assert (r.temp_c[done.outside] < 18.0).any()
        assert (r.temp_c[done.outside] > 75.0).any()
        np.testing.assert_array_equal(done.outside, (r.temp_c < 18.0) | (r.temp_c > 75.0))
        assert [finding.code for finding in done.findings] == ["correct.outside"]
        assert f"{done.outside.sum() * 0.01:.1f} s" in done.warnings[0]


def test_raise_refuses_readings_far_beyond_the_data():
    c = device(drift=marked(tables(dynamic=None), static=STEPS > 60.0, accel=False))
    assert not correct_checked(record(high=62.9), c).outside.any()
    with pytest.raises(DriftRangeError, match="18 to 63 degC"):
        correct_checked(record(high=63.9), c)
    with pytest.raises(DriftRangeError, match="18 to 63 degC"):
        Corrector(c, "raise").push_checked(record(high=63.9))


def test_a_stream_reports_what_the_batch_reports():
    c, r = device(drift=marked(tables(), static=STEPS > 60.0)), record(low=10.0, high=80.0)
    batch, corrector = correct_checked(r, c, policy="nan"), Corrector(c, "nan")
    masks = [corrector.push_checked(r.part(k, min(k + 29, N))).outside for k in range(0, N, 29)]
    np.testing.assert_array_equal(np.concatenate(masks), batch.outside)
    assert tuple(item.text for item in corrector.findings) == batch.warnings
    assert corrector.state.reach.samples_outside == batch.outside.sum()
    assert corrector.state.reach.seconds_outside == pytest.approx(batch.reach.seconds_outside)
    many = correct_checked(r, c, policy="nan", threads=3)
    np.testing.assert_array_equal(many.outside, batch.outside)
    assert many.warnings == batch.warnings


def test_pieces_add_up_to_the_whole():
    rng = np.random.default_rng(5)
    time = 1.7e9 + np.cumsum(rng.uniform(0.003, 0.4, 1000))
    mask = rng.random(1000) < 0.5
    bounds = [0, 2, 7, 333, 500, 998, 1000]
    pieces = [seconds_of(mask[a:b], time[a:b], None if a == 0 else float(time[a - 1])) for a, b in pairwise(bounds)]
    assert sum(pieces) == pytest.approx(seconds_of(mask, time, None))
