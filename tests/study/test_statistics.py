"""Repeated measures: published examples and a second program."""

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.study.statistics import adjust_holm, repeated_measures_anova

# A. Field, Discovering statistics: eight people, seconds until they retch at four foods.
FOODS = np.array(
    [[8, 9, 6, 5, 8, 7, 10, 12], [7, 5, 2, 3, 4, 5, 2, 6], [1, 2, 3, 1, 5, 6, 7, 8], [6, 5, 8, 9, 8, 7, 2, 1]], float
).T
# B. Winer, Statistical principles in experimental design, 4.2-1: reaction times of five people under four drugs.
DRUGS = np.array([[30, 28, 16, 34], [14, 18, 10, 22], [24, 20, 18, 30], [38, 34, 20, 44], [26, 28, 14, 30]], float)


def test_the_example_of_the_foods_comes_out_as_printed():
    found = repeated_measures_anova(FOODS)
    for name, value, printed in (("F", found.f, 3.79), ("epsilon", found.epsilon, 0.533), ("p", found.p_value, 0.063)):
        show(f"foods: {name}", value, printed)
        assert value == pytest.approx(printed, abs=0.0051 if printed > 1 else 0.00051)  # as many digits as printed


def test_the_example_of_the_drugs_comes_out_as_printed():
    found = repeated_measures_anova(DRUGS)
    assert found.f == pytest.approx(24.76, abs=0.005)
    assert found.epsilon == pytest.approx(0.6049, abs=5e-5)


def test_f_is_the_one_of_statsmodels():
    import pandas as pd
    from statsmodels.stats.anova import AnovaRM

    y = np.random.default_rng(1).normal(size=(9, 5)) + np.arange(5)
    long = pd.DataFrame({"y": y.ravel(), "s": np.repeat(np.arange(9), 5), "c": list("abcde") * 9})
    theirs = AnovaRM(long, "y", "s", within=["c"]).fit().anova_table
    assert repeated_measures_anova(y).f == pytest.approx(float(theirs["F Value"].iloc[0]), rel=1e-10)


def test_p_is_uniform_without_an_effect():
    rng = np.random.default_rng(2)
    p = [repeated_measures_anova(rng.normal(size=(12, 4))).p_value for _ in range(400)]
    show("share of p below 0.05 without an effect", np.mean(np.array(p) < 0.05), 0.05)
    assert np.mean(np.array(p) < 0.05) < 0.08  # 400 draws: one deviation is 1.1 %; the correction is conservative


def test_holm_by_hand():
    np.testing.assert_allclose(adjust_holm([0.01, 0.04, 0.03]), [0.03, 0.06, 0.06])


def test_what_cannot_be_analysed_is_refused():
    for table in (np.ones((2, 3)), np.ones((3, 1)), np.full((4, 3), np.nan)):
        with pytest.raises(InputError, match="three subjects"):
            repeated_measures_anova(table)
    with pytest.raises(InputError, match="exact"):
        repeated_measures_anova(np.arange(4.0)[:, None] + np.arange(3.0))
