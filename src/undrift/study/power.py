"""Power of the repeated-measures analysis, and what looking again and again does to it.

With the conditions' true means m_j, error variance s^2 per subject and condition (subjects' own levels taken out) and n subjects::

    lambda = e n sum_j (m_j - m.)^2 / s^2      power = P(F' > F_crit), F' noncentral with e (k-1), e (n-1)(k-1), lambda

e is the epsilon of the sphericity. The normal use: means and s^2 of a first study say how many subjects the next one needs.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import FloatArray, frozen
from undrift.errors import InputError
from undrift.study.anova import compare_conditions

MOST_SUBJECTS = 100_000


def power_of_anova(
    means: ArrayLike, error_variance: float, subjects: int, *, epsilon: float = 1.0, level: float = 0.05
) -> float:
    """Return the chance that the analysis finds a difference that is there.

    Parameters
    ----------
    means : array_like, shape (k,)
        True means of the conditions; any unit.
    error_variance : float
        Variance of a subject's response about its own mean and the condition's, that unit squared.
    subjects : int
        n.
    epsilon : float
        Of the sphericity, 1 / (k - 1) to 1.
    level : float
        Of the test.

    Returns
    -------
    float
        0 to 1. Of a study's own means it says nothing that its p does not say; use it to plan the next one.

    Raises
    ------
    InputError
        No variance, fewer than two conditions or two subjects, an epsilon that is not one.
    """
    from scipy.stats import f, ncf

    m = frozen(means, (None,), "power means")
    k = len(m)
    if k < 2 or subjects < 2 or not error_variance > 0.0 or not 1.0 / max(k - 1, 1) - 1e-9 <= epsilon <= 1.0:
        raise InputError(
            f"power: wanted two conditions or more, two subjects or more, a variance above 0 and an epsilon from 1/(k-1) to 1, got "
            f"{k}, {subjects}, {error_variance:g} and {epsilon:g}"
        )
    d1, d2 = epsilon * (k - 1), epsilon * (k - 1) * (subjects - 1)
    noncentrality = epsilon * subjects * float(((m - m.mean()) ** 2).sum()) / error_variance
    critical = f.ppf(1.0 - level, d1, d2)
    return float(ncf.sf(critical, d1, d2, noncentrality))


def subjects_needed(
    means: ArrayLike, error_variance: float, *, power: float = 0.8, epsilon: float = 1.0, level: float = 0.05
) -> int:
    """Return the fewest subjects with which the analysis has a stated power.

    Parameters
    ----------
    means : array_like, shape (k,)
        True means of the conditions; any unit.
    error_variance : float
        As for ``power_of_anova``.
    power : float
        Wanted.
    epsilon : float
        Of the sphericity.
    level : float
        Of the test.

    Returns
    -------
    int
        n, 3 or more.

    Raises
    ------
    InputError
        More than a hundred thousand would be needed: the means do not differ.
    """
    low, high = 2, 3
    while power_of_anova(means, error_variance, high, epsilon=epsilon, level=level) < power:
        low, high = high, 2 * high
        if high > MOST_SUBJECTS:
            raise InputError(
                f"power: wanted {100 * power:g} % with at most {MOST_SUBJECTS} subjects, got conditions that hardly differ; no "
                "number of subjects is worth it"
            )
    while high - low > 1:
        middle = (low + high) // 2
        enough = power_of_anova(means, error_variance, middle, epsilon=epsilon, level=level) >= power
        low, high = (low, middle) if enough else (middle, high)
    return max(high, 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class OptionalStopping:
    """What happens when subjects are added until p falls below the level.

    Parameters
    ----------
    p_by_subjects : tuple of (int, float)
        Number of subjects and p at each look.
    crossings : int
        How often p went from above the level to below it or back.
    false_alarm : float
        Chance that such looking finds a difference where there is none.
    looks : int
        Looks that this chance was computed for.
    """

    p_by_subjects: tuple[tuple[int, float], ...]
    crossings: int
    false_alarm: float
    looks: int


def stopping_of(
    y: ArrayLike, *, first: int = 10, level: float = 0.05, simulations: int = 1000, rng: np.random.Generator
) -> OptionalStopping:
    """Return what a study would have found had it looked after each subject, and what such looking does to the level.

    Parameters
    ----------
    y : array_like, shape (n, k)
        One subject a row in the order of arrival, one condition a column.
    first : int
        Subjects at the first look.
    level : float
        Of the test.
    simulations : int
        Studies without any difference, to compute the chance of a false alarm.
    rng : Generator
        Draws them.

    Returns
    -------
    OptionalStopping
        p at each look, and the chance of a false alarm.
    """
    table = frozen(y, (None, None), "optional stopping")
    n, k = table.shape
    looks = range(min(first, n), n + 1)
    p = tuple((m, compare_conditions(table[:m]).p_value) for m in looks)
    below = [value < level for _, value in p]
    null = rng.normal(size=(simulations, n, k))
    return OptionalStopping(
        p_by_subjects=p,
        crossings=sum(a != b for a, b in pairwise(below)),
        false_alarm=float(np.mean([any(_finds(study[:m], level) for m in looks) for study in null])),
        looks=len(looks),
    )


def _finds(table: FloatArray, level: float) -> bool:
    from scipy.special import fdtrc

    n, k = table.shape
    by_condition, by_subject, grand = table.mean(axis=0), table.mean(axis=1), table.mean()
    between = n * ((by_condition - grand) ** 2).sum() / (k - 1)
    error = ((table - by_condition - by_subject[:, None] + grand) ** 2).sum() / ((n - 1) * (k - 1))
    return bool(fdtrc(k - 1, (n - 1) * (k - 1), between / error) < level)
