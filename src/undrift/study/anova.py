"""Repeated-measures analysis of variance: does the error depend on a parameter of the protocol?

Subjects i = 1..n meet every condition j = 1..k (one value of the parameter each)::

    SS_condition = n sum_j (y.j - y..)^2            df = k - 1
    SS_subject   = k sum_i (yi. - y..)^2
    SS_error     = SS_total - SS_condition - SS_subject   df = (n - 1)(k - 1)
    F = MS_condition / MS_error

p is given as it stands and with the degrees of freedom of Greenhouse-Geisser and Huynh-Feldt. The p to quote is the corrected
one: Huynh-Feldt where Greenhouse-Geisser's epsilon is above 0.75, else Greenhouse-Geisser (Girden, 1992); it needs no test of
sphericity first. The F of statsmodels' AnovaRM is the same, which a test holds.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import FloatArray, frozen
from undrift.errors import InputError
from undrift.study.sphericity import Sphericity, sphericity

TURN_TO_HUYNH_FELDT = 0.75


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Anova:
    """Outcome of a one-way repeated-measures analysis of variance.

    Parameters
    ----------
    subjects, conditions : int
        n and k.
    f : float
        F of the conditions.
    dof : tuple of float
        Degrees of freedom of the conditions and of the error, not corrected.
    p_uncorrected, p_greenhouse_geisser, p_huynh_feldt : float
        p of that F.
    p_value : float
        The one to quote.
    correction : str
        Which that is.
    sphericity : Sphericity
        Epsilons and Mauchly's test.
    partial_eta_squared : float
        SS_condition / (SS_condition + SS_error).
    generalized_eta_squared : float
        SS_condition / SS_total, subjects being a measured factor.
    means : array, shape (k,)
        Of the conditions.
    mean_square_error : float
        SS_error over its degrees of freedom, squared unit of the data.
    """

    subjects: int
    conditions: int
    f: float
    dof: tuple[float, float]
    p_uncorrected: float
    p_greenhouse_geisser: float
    p_huynh_feldt: float
    p_value: float
    correction: str
    sphericity: Sphericity
    partial_eta_squared: float
    generalized_eta_squared: float
    means: FloatArray
    mean_square_error: float


def compare_conditions(y: ArrayLike) -> Anova:
    """Compare conditions that every subject met.

    Parameters
    ----------
    y : array_like, shape (n, k)
        One subject a row, one condition a column; any unit.

    Returns
    -------
    Anova
        F, p with corrections, effect sizes.

    Raises
    ------
    InputError
        Fewer than two conditions or three subjects, a gap, or no variance to test against.
    """
    from scipy.stats import f as f_distribution

    table = frozen(y, (None, None), "anova")
    n, k = table.shape
    _check(table)
    grand, by_condition, by_subject = table.mean(), table.mean(axis=0), table.mean(axis=1)
    total = float(((table - grand) ** 2).sum())
    between = float(n * ((by_condition - grand) ** 2).sum())
    error = float(((table - by_condition - by_subject[:, None] + grand) ** 2).sum())
    d1, d2 = float(k - 1), float((n - 1) * (k - 1))
    if error <= 1e-24 * max(total, 1e-300):
        raise InputError(
            "anova: wanted subjects that differ in how they respond, got none that do; the conditions' differences are exact"
        )
    f = (between / d1) / (error / d2)
    form = sphericity(table)
    p, p_gg, p_hf = (
        float(f_distribution.sf(f, e * d1, e * d2)) for e in (1.0, form.greenhouse_geisser, form.huynh_feldt)
    )
    lenient = form.greenhouse_geisser > TURN_TO_HUYNH_FELDT
    return Anova(
        subjects=n,
        conditions=k,
        f=f,
        dof=(d1, d2),
        p_uncorrected=p,
        p_greenhouse_geisser=p_gg,
        p_huynh_feldt=p_hf,
        p_value=p_hf if lenient else p_gg,
        correction="huynh-feldt" if lenient else "greenhouse-geisser",
        sphericity=form,
        partial_eta_squared=between / (between + error),
        generalized_eta_squared=between / total,
        means=by_condition,
        mean_square_error=error / d2,
    )


def _check(table: FloatArray) -> None:
    n, k = table.shape
    if k < 2 or n < 3:
        raise InputError(
            f"anova: wanted three subjects or more in two conditions or more, got {n} subjects in {k}; add some"
        )
    gaps = int(np.isnan(table).any(axis=1).sum())
    if gaps:
        raise InputError(
            f"anova: wanted every subject in every condition, got {gaps} of {n} subjects with gaps; leave them out, or use "
            "compare_unbalanced"
        )
