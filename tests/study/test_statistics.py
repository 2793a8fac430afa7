"""Repeated measures: published examples, a second program, and the rates that the tests promise."""

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.study.statistics import (
    adjust_holm,
    compare_conditions,
    compare_pairs,
)

# A. Field, Discovering statistics: eight people, seconds until they retch at four foods.
FOODS = np.array(
    [[8, 9, 6, 5, 8, 7, 10, 12], [7, 5, 2, 3, 4, 5, 2, 6], [1, 2, 3, 1, 5, 6, 7, 8], [6, 5, 8, 9, 8, 7, 2, 1]], float
).T
# B. Winer, Statistical principles in experimental design, 4.2-1: reaction times of five people under four drugs.
DRUGS = np.array([[30, 28, 16, 34], [14, 18, 10, 22], [24, 20, 18, 30], [38, 34, 20, 44], [26, 28, 14, 30]], float)
THREE = np.array([[2.2, 3.1, 4.3, 4.1, 7.2], [1.1, 2.5, 4.1, 5.2, 6.4], [8.2, 4.5, 3.4, 6.2, 7.2]]).T


def test_the_example_of_the_foods_comes_out_as_printed() -> None:
    found = compare_conditions(FOODS)
    for name, value, printed in (
        ("F", found.f, 3.79),
        ("Mauchly's W", found.sphericity.mauchly_w, 0.136),
        ("chi squared", found.sphericity.chi_squared, 11.41),
        ("p of Mauchly", found.sphericity.p_value, 0.047),
        ("Greenhouse-Geisser", found.sphericity.greenhouse_geisser, 0.533),
        ("Huynh-Feldt", found.sphericity.huynh_feldt, 0.666),
        ("p", found.p_uncorrected, 0.026),
        ("p Greenhouse-Geisser", found.p_greenhouse_geisser, 0.063),
        ("p Huynh-Feldt", found.p_huynh_feldt, 0.048),
    ):
        show(f"foods: {name}", value, printed)
        assert (
            abs(value - printed) <= 0.0051 if printed > 1 else abs(value - printed) <= 0.00051
        )  # as many digits as printed


def test_the_example_of_the_drugs_comes_out_as_printed() -> None:
    found = compare_conditions(DRUGS)
    show("drugs: F", found.f, 24.76)
    assert found.f == pytest.approx(24.76, abs=0.005)
    assert found.sphericity.greenhouse_geisser == pytest.approx(0.6049, abs=5e-5)


def test_three_conditions_agree_with_a_second_program() -> None:
    # printed in the documentation of a statistics package for these numbers: epsilons, W, chi squared, p
    form = compare_conditions(THREE).sphericity
    assert form.greenhouse_geisser == pytest.approx(0.5587754577585018, rel=1e-12)
    assert form.huynh_feldt == pytest.approx(0.6223448311539789, rel=1e-12)
    assert form.lower_bound == 0.5
    assert (round(form.mauchly_w, 2), round(form.chi_squared, 3), form.dof) == (0.21, 4.677, 2)
    assert form.p_value == pytest.approx(0.09649016283209633, rel=1e-10)


def test_f_is_the_one_of_statsmodels() -> None:
    import pandas as pd
    from statsmodels.stats.anova import AnovaRM

    y = np.random.default_rng(1).normal(size=(9, 5)) + np.arange(5)
    long = pd.DataFrame({"y": y.ravel(), "s": np.repeat(np.arange(9), 5), "c": list("abcde") * 9})
    theirs = AnovaRM(long, "y", "s", within=["c"]).fit().anova_table
    ours = compare_conditions(y)
    assert ours.f == pytest.approx(float(theirs["F Value"].iloc[0]), rel=1e-10)
    assert ours.p_uncorrected == pytest.approx(float(theirs["Pr > F"].iloc[0]), rel=1e-9)


def test_with_two_conditions_it_is_the_paired_t_test() -> None:
    from scipy.stats import ttest_rel

    y = np.random.default_rng(2).normal(size=(12, 2))
    found, t = compare_conditions(y), ttest_rel(y[:, 0], y[:, 1])
    assert found.f == pytest.approx(float(t.statistic) ** 2, rel=1e-12)
    assert found.p_value == pytest.approx(float(t.pvalue), rel=1e-9)
    (pair,) = compare_pairs(y)
    assert pair.p_holm == pytest.approx(float(t.pvalue), rel=1e-9)


@pytest.mark.slow
def test_holm_is_the_one_of_statsmodels() -> None:
    from statsmodels.stats.multitest import multipletests

    p = np.random.default_rng(3).uniform(0, 0.1, 15)
    np.testing.assert_allclose(adjust_holm(p), multipletests(p, method="holm")[1], rtol=1e-12)


@pytest.mark.slow
def test_the_level_is_kept_on_null_data_spherical_or_not() -> None:
    rng = np.random.default_rng(4)
    mixed = np.linalg.cholesky(0.7 ** np.abs(np.subtract.outer(np.arange(6), np.arange(6))))  # neighbours alike
    for name, root in (("spherical", np.eye(6)), ("neighbours alike", mixed)):
        y = rng.normal(size=(2000, 30, 6)) @ root.T + rng.normal(size=(2000, 30, 1))
        rate = np.mean([compare_conditions(study).p_value < 0.05 for study in y])
        show(f"type I error, {name} (30 subjects, 6 conditions, 2,000 studies)", float(rate), "0.04 to 0.06")
        assert 0.04 <= rate <= 0.06


@pytest.mark.parametrize(
    ("table", "text"),
    [
        (np.ones((2, 3)), "three subjects or more"),
        (np.array([[1.0, np.nan], [1.0, 2.0], [2.0, 2.0]]), "1 of 3 subjects with gaps"),
        (np.arange(12.0).reshape(4, 3), "subjects that differ in how they respond"),
    ],
)
def test_data_that_cannot_be_compared_are_refused(table: np.ndarray, text: str) -> None:
    with pytest.raises(InputError, match=text):
        compare_conditions(table)


def test_pairs_need_three_subjects() -> None:
    with pytest.raises(InputError, match="three subjects or more"):
        compare_pairs(np.ones((2, 3)))
