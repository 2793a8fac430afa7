"""Agreement statistics: published example, closed forms, refusals."""

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.validation.agreement import bland_altman, intraclass_correlation

# P. E. Shrout, J. L. Fleiss, 1979, table 2: six targets, four judges; table 4 prints the coefficients.
JUDGES = np.array([[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], dtype=float)


def test_the_published_example_gives_the_published_coefficients():
    absolute = intraclass_correlation(JUDGES, "ICC(2,1)")
    consistency = intraclass_correlation(JUDGES, "ICC(3,1)")
    show("ICC(2,1)", round(absolute.value, 3), 0.29)
    show("ICC(3,1)", round(consistency.value, 3), 0.71)
    assert absolute.value == pytest.approx(0.29, abs=0.005)  # printed to two digits
    assert consistency.value == pytest.approx(0.71, abs=0.005)
    # Intervals of the same table as statistics packages print them, two digits.
    assert absolute.interval == pytest.approx((0.02, 0.76), abs=0.006)
    assert consistency.interval == pytest.approx((0.34, 0.95), abs=0.006)


def test_the_error_of_measurement_follows_from_the_mean_squares():
    # The paper's mean squares: between targets 11.24, judges 32.49, residual 1.02.
    absolute = intraclass_correlation(JUDGES)
    consistency = intraclass_correlation(JUDGES, "ICC(3,1)")
    assert consistency.standard_error_of_measurement == pytest.approx(np.sqrt(1.02), abs=0.003)
    assert absolute.standard_error_of_measurement == pytest.approx(np.sqrt((32.49 - 1.02) / 6 + 1.02), abs=0.003)
    assert absolute.minimal_detectable_change == pytest.approx(
        1.96 * np.sqrt(2) * absolute.standard_error_of_measurement, rel=1e-4
    )


def test_intervals_cover_the_true_coefficient():
    rng = np.random.default_rng(0)
    inside = {"ICC(2,1)": 0, "ICC(3,1)": 0}
    truth = {"ICC(2,1)": 4.0 / (4.0 + 0.5 + 1.0), "ICC(3,1)": 4.0 / 5.0}
    for _ in range(600):
        table = 2.0 * rng.normal(size=(15, 1)) + np.sqrt(0.5) * rng.normal(size=(1, 3)) + rng.normal(size=(15, 3))
        for kind in truth:
            low, high = intraclass_correlation(table, kind).interval
            inside[kind] += low <= truth[kind] <= high
    for kind, count in inside.items():
        show(f"coverage of the interval of {kind}", count / 600, 0.95)
        assert 0.925 < count / 600 < 0.975  # 600 draws: one deviation is 0.9 %; the first kind's F is approximate


def test_methods_that_agree_exactly_give_one():
    table = np.array([[1.0, 1.0], [2.0, 2.0], [5.0, 5.0]])
    assert intraclass_correlation(table).value == 1.0
    assert intraclass_correlation(table, "ICC(3,1)").interval == (1.0, 1.0)
    assert intraclass_correlation(table).interval == (1.0, 1.0)


def test_limits_of_agreement_follow_the_closed_form():
    first = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    second = first - np.array([0.5, 0.1, -0.3, 0.2, 0.0])
    found = bland_altman(first, second)
    sd = np.std([0.5, 0.1, -0.3, 0.2, 0.0], ddof=1)
    t = 2.7764451  # Student's t, 4 degrees of freedom, 97.5 %
    assert found.bias == pytest.approx(0.1)
    assert found.limits == pytest.approx((0.1 - 1.959964 * sd, 0.1 + 1.959964 * sd))
    assert found.bias_interval == pytest.approx((0.1 - t * sd / np.sqrt(5), 0.1 + t * sd / np.sqrt(5)))
    half = t * sd * np.sqrt(1 / 5 + 1.959964**2 / 8)
    assert found.upper_interval == pytest.approx((found.limits[1] - half, found.limits[1] + half))
    assert found.lower_interval == pytest.approx((found.limits[0] - half, found.limits[0] + half))
    assert found.count == 5


def test_tables_that_cannot_be_are_refused():
    with pytest.raises(
        InputError, match=r"three subjects or more and two methods or more without gaps, got shape \(2, 2\)"
    ):
        bland_altman(np.ones(2), np.ones(2))
    with pytest.raises(InputError, match="without gaps"):
        intraclass_correlation(np.array([[1.0, np.nan], [1.0, 2.0], [3.0, 1.0]]))
    with pytest.raises(InputError, match=r"got shape \(0, 2\)"):
        bland_altman(np.ones(4), np.ones(3))
    with pytest.raises(InputError, match=r"wanted ICC\(2,1\) or ICC\(3,1\), got ICC\(1,1\)"):
        intraclass_correlation(JUDGES, "ICC(1,1)")
