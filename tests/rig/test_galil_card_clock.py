"""The card's clock: which tick it counts is determined by the clock of the host."""

import math

import numpy as np
import pytest

from undrift.rig.galil import matching_ticks

TICKS = [1e-3, 1e-3 * 1000.0 / 1024.0]


def answers(tick_s, count, rng, *, step_s=0.02, late_s=0.005, speed=1.0, start_s=1000.0):
    """Return ticks, and the host's clock before and after: the answer is true somewhere between the two."""
    asked, rows = start_s, []
    for _ in range(count):
        wait, back = rng.exponential(late_s, 2)
        true = asked + wait
        rows.append((math.floor((true - 17.3) / tick_s), speed * asked, speed * (true + back)))
        asked = true + back + step_s
    return rows


@pytest.mark.parametrize("tick_s", [*TICKS, 250e-6, 250e-6 * 1000.0 / 1024.0])
@pytest.mark.parametrize("seed", range(5))
def test_the_true_tick_is_the_only_one_after_half_a_second_and_always_among_them(tick_s, seed):
    sample_s = 250e-6 if tick_s < 5e-4 else 1e-3
    rows = answers(tick_s, 40, np.random.default_rng(seed))
    for count in range(1, len(rows)):
        assert any(math.isclose(tick, tick_s, rel_tol=1e-9) for tick in matching_ticks(rows[:count], sample_s))
    assert matching_ticks(rows, sample_s) == [pytest.approx(tick_s, rel=1e-9)]


def test_crystals_may_differ_by_100_ppm():
    assert matching_ticks(answers(1e-3 * (1.0 + 1e-4), 2000, np.random.default_rng(4), step_s=5.0), 1e-3) == [1e-3]


def test_a_clock_that_fits_no_candidate_is_not_used():
    assert matching_ticks(answers(1e-3, 300, np.random.default_rng(5), speed=0.9), 1e-3) == []
