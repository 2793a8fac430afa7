"""A drawn course has the peaks and the gaps of the one it was made of."""

import numpy as np

from undrift.report.figures import envelope


def test_a_peak_of_one_sample_is_drawn_at_its_time():
    time = np.arange(50_000) / 286.0
    course = np.sin(time)
    course[31_415], course[40_001] = 8.41, -7.7
    drawn_time, drawn = envelope(time, course)
    assert len(drawn) <= 4000
    assert drawn.max() == 8.41
    assert drawn.min() == -7.7
    assert drawn_time[drawn.argmax()] == time[31_415]
    assert drawn_time[drawn.argmin()] == time[40_001]
    assert (np.diff(drawn_time) > 0.0).all()


def test_no_line_crosses_a_gap_however_short():
    time = np.arange(10_000.0)
    course = np.cos(time / 500.0)
    course[4_321] = np.nan  # within a column
    course[6_000:7_000] = np.nan  # over many
    drawn_time, drawn = envelope(time, course, columns=100)
    assert (np.diff(drawn_time) > 0.0).all()
    for gap in (4_321.0, 6_500.0):
        k = int(np.searchsorted(drawn_time, gap))
        assert np.isnan(drawn[k - 1]) or np.isnan(drawn[k])
    assert np.isfinite(drawn[(drawn_time > 4_500.0) & (drawn_time < 5_900.0)]).all()
    seen = np.isfinite(drawn)
    assert set(drawn[seen]) <= set(course)
