"""Number of devices in a Monte Carlo run, and the range of its counts due to chance.

`make test` draws few and allows for chance, `make test-slow` draws many. Tests that `make mutants` runs draw more, so that they
see small faults.
"""

from collections.abc import Iterable

import numpy as np
import pytest
from scipy.stats import binom, chi2

FEW = 60
COHORTS = (FEW, pytest.param(1000, marks=pytest.mark.slow))
LARGER_COHORTS = (200, pytest.param(1000, marks=pytest.mark.slow))
FALSE_ALARM = 1e-4  # how often a limit is passed by chance where all is right
RATIO = 1.05  # limit for the ratio of a root-mean-square error to its bound
SHARES = (0.93, 0.97)  # limits for the share of nominal 95 % intervals that contain the truth


def first_and_long(each: Iterable[object]) -> list[object]:
    """Return values of a parameter: the first in `make test`, the others in `make test-slow`."""
    first, *others = each
    return [first, *(pytest.param(other, marks=pytest.mark.slow) for other in others)]


def share_limits(trials: int, nominal: float = 0.95) -> tuple[float, float]:
    """Return between which shares of so many intervals hold: ``SHARES``, or further apart by the binomial distribution."""
    low, high = (float(binom.ppf(p, trials, nominal)) / trials for p in (0.5 * FALSE_ALARM, 1.0 - 0.5 * FALSE_ALARM))
    return min(SHARES[0], low), max(SHARES[1], high)


def ratio_limit(errors: int) -> float:
    """Return the limit of the root-mean-square of so many errors over their bound: ``RATIO``, or more by chi-square."""
    return max(RATIO, float(np.sqrt(chi2.ppf(1.0 - FALSE_ALARM, errors) / errors)))
