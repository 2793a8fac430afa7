"""How long marked samples last: by their own clock, in one piece or in many."""

from itertools import pairwise

import numpy as np
import pytest

from undrift.correction.coverage import seconds_of


def test_samples_of_an_even_clock_last_a_step_each():
    time = 5.0 + np.arange(100) * 0.01
    mask = np.zeros(100, dtype=bool)
    mask[[0, 3, 99]] = True
    assert seconds_of(mask, time, None) == pytest.approx(0.03, abs=3e-9)  # each time is rounded to 2^-30 s
    assert seconds_of(~mask & mask, time, None) == 0.0


def test_samples_of_an_uneven_clock_last_as_long_as_it_says():
    time = np.cumsum(np.tile([0.017, 0.051], 500))  # the median of the steps is not their mean
    mask = time > 17.0
    assert seconds_of(mask, time, None) == pytest.approx(17.0, abs=0.06)  # one step at the edge


@pytest.mark.parametrize("start", [0.0, 1.7e9], ids=["from zero", "since 1970"])
def test_pieces_add_up_to_the_bits_of_the_whole(start):
    rng = np.random.default_rng(5)
    time = start + np.cumsum(rng.uniform(0.003, 0.4, 1000))
    mask = rng.random(1000) < 0.5
    bounds = [0, 2, 7, 333, 500, 998, 1000]
    pieces = [seconds_of(mask[a:b], time[a:b], None if a == 0 else float(time[a - 1])) for a, b in pairwise(bounds)]
    assert sum(pieces) == seconds_of(mask, time, None)
