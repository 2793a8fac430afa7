"""Agreement statistics: published example, closed forms, refusals."""

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.validation.agreement import bland_altman, decide_between, intraclass_correlation

# P. E. Shrout, J. L. Fleiss, 1979, table 2: six targets, four judges; table 4 prints the coefficients.
JUDGES = np.array([[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]], dtype=float)


def test_the_published_example_gives_the_published_coefficient():
    found = intraclass_correlation(JUDGES)
    show("ICC(2,1)", round(found.value, 3), 0.29)
    assert found.value == pytest.approx(0.29, abs=0.005)  # printed to two digits
    assert found.interval == pytest.approx((0.02, 0.76), abs=0.006)  # as statistics packages print it, two digits


def test_the_error_of_measurement_follows_from_the_mean_squares():
    found = intraclass_correlation(JUDGES)  # the paper's mean squares: targets 11.24, judges 32.49, residual 1.02
    sem = np.sqrt((32.49 - 1.02) / 6 + 1.02)
    assert found.minimal_detectable_change == pytest.approx(1.96 * np.sqrt(2.0) * sem, abs=0.01)


def test_the_interval_covers_the_true_coefficient():
    rng = np.random.default_rng(0)
    inside, truth = 0, 4.0 / (4.0 + 0.5 + 1.0)
    for _ in range(600):
        table = 2.0 * rng.normal(size=(15, 1)) + np.sqrt(0.5) * rng.normal(size=(1, 3)) + rng.normal(size=(15, 3))
        low, high = intraclass_correlation(table).interval
        inside += low <= truth <= high
    show("coverage of the interval of ICC(2,1)", inside / 600, 0.95)
    assert 0.925 < inside / 600 < 0.975  # 600 draws: one deviation is 0.9 %; its F is approximate


def test_methods_that_agree_exactly_give_one():
    table = np.array([[1.0, 1.0], [2.0, 2.0], [5.0, 5.0]])
    assert intraclass_correlation(table).value == 1.0
    assert intraclass_correlation(table).interval == (1.0, 1.0)


def test_a_wrong_verdict_is_as_rare_as_the_level_says():
    """Differences at the margin, where each verdict but one is wrong; and equal errors, which are equivalent."""
    rng = np.random.default_rng(3)
    draws = 0.15 + 0.2 * rng.normal(size=(1000, 12))
    verdicts = [decide_between(np.zeros(12), draw, margin=0.15).verdict for draw in draws]
    wrong = np.mean([verdict in ("better", "worse") for verdict in verdicts])
    show("better or worse of a difference at the margin", wrong, 0.025)
    assert wrong < 0.05
    assert np.mean([verdict == "equivalent" for verdict in verdicts]) < 0.07
    same = decide_between(0.01 * rng.normal(size=12), 0.01 * rng.normal(size=12), margin=0.15)
    assert same.verdict == "equivalent"
    better = decide_between(0.01 * rng.normal(size=12), 1.0 + 0.01 * rng.normal(size=12), margin=0.15)
    assert (better.verdict, round(better.difference)) == ("better", 1)


def test_a_verdict_needs_three_people():
    with pytest.raises(InputError, match="3 people"):
        decide_between(np.zeros(2), np.ones(2), margin=0.1)


def test_limits_of_agreement_follow_the_closed_form():
    first = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    second = first - np.array([0.5, 0.1, -0.3, 0.2, 0.0])
    found = bland_altman(first, second)
    sd = np.std([0.5, 0.1, -0.3, 0.2, 0.0], ddof=1)
    assert found.bias == pytest.approx(0.1)
    assert found.limits == pytest.approx((0.1 - 1.959964 * sd, 0.1 + 1.959964 * sd))
    assert found.count == 5


def test_tables_that_cannot_be_are_refused():
    with pytest.raises(InputError, match=r"got shape \(2, 2\)"):
        bland_altman(np.ones(2), np.ones(2))
    with pytest.raises(InputError, match="without gaps"):
        intraclass_correlation(np.array([[1.0, np.nan], [1.0, 2.0], [3.0, 1.0]]))
    with pytest.raises(InputError, match=r"got shape \(0, 2\)"):
        bland_altman(np.ones(4), np.ones(3))
