"""Optimal designs: those of the books come out, and what they promise holds in a simulation."""

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.study.search import optimal_rates, prediction_sd

DPS = np.pi / 180.0
FINE = np.linspace(-90.0, 90.0, 361) * DPS
NOTE = np.concatenate((-np.arange(10.0, 91.0, 5.0), np.arange(10.0, 91.0, 5.0))) * DPS
TASK = np.random.default_rng(0).normal(0.0, 30.0, 4000).clip(-90.0, 90.0) * DPS


def gathered(rates: np.ndarray, share: np.ndarray, at: np.ndarray) -> np.ndarray:
    return np.array([share[np.abs(rates - a) < 0.03].sum() for a in at])


def test_the_d_optimal_cubic_design_is_that_of_the_books() -> None:
    # Fedorov, Theory of optimal experiments, 1972: degree 3 on [-1, 1]: equal shares at -1, -1/sqrt(5), 1/sqrt(5), 1
    found = optimal_rates(FINE, TASK, NOTE, criterion="D")
    x = found.turn_rate / (90.0 * DPS)
    np.testing.assert_allclose(gathered(x, found.share, np.array([-1.0, -(5**-0.5), 5**-0.5, 1.0])), 0.25, atol=2e-3)


def test_the_d_optimal_line_rests_at_both_ends() -> None:
    found = optimal_rates(FINE, TASK, NOTE, criterion="D", degree=1)
    np.testing.assert_allclose(found.turn_rate, [-90.0 * DPS, 90.0 * DPS])
    np.testing.assert_allclose(found.share, 0.5, atol=1e-6)


def test_each_design_is_best_by_its_own_measure() -> None:
    d, i = (optimal_rates(FINE, TASK, NOTE, criterion=c) for c in ("D", "I"))  # type: ignore[arg-type]
    assert d.d_efficiency_uniform < i.d_efficiency_uniform
    assert i.i_efficiency_uniform < d.i_efficiency_uniform
    show("the note's grid has of the D-optimal information", d.d_efficiency_uniform, "< 1")
    show("the note's grid has of the I-optimal information", i.i_efficiency_uniform, "< 1")
    assert d.d_efficiency_uniform < 1.0
    assert i.i_efficiency_uniform < 1.0


def test_the_error_that_a_design_promises_is_the_one_that_a_simulation_finds() -> None:
    found, rng = optimal_rates(FINE, TASK, NOTE, criterion="I"), np.random.default_rng(1)
    counts = np.maximum(np.round(found.share * 400), 1).astype(int)
    rate = np.repeat(found.turn_rate, counts)
    design, aim = np.vander(rate, 4), np.vander(TASK, 4)
    errors = []
    for _ in range(400):
        fitted, *_ = np.linalg.lstsq(design, rng.normal(0.0, 0.01, len(rate)), rcond=None)
        errors.append(np.mean((aim @ fitted) ** 2))
    promised = prediction_sd(found.turn_rate, counts / counts.sum(), TASK, dwell_sd=0.01, dwells=len(rate))
    assert np.sqrt(np.mean(errors)) == pytest.approx(promised, rel=0.08)  # 400 draws of four parameters: 2.5 %


def test_too_few_rates_are_refused() -> None:
    with pytest.raises(InputError, match="wanted 4 rates or more for a polynomial of degree 3, got 2 candidates"):
        optimal_rates(np.array([-1.0, 1.0]), TASK, NOTE)
