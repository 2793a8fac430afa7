"""Repeated measures: does the error depend on a parameter, and by how much?

Every subject meets each of k values: F = MS_condition / MS_error, with degrees of freedom (k - 1) and (n - 1)(k - 1) times
Greenhouse and Geisser's epsilon (1959). p values of several parameters are adjusted after Holm (1979). With enough simulated
people, any difference becomes significant. So each p is reported with the span of the means in degrees.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import FloatArray
from undrift.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class Anova:
    """One-way repeated-measures analysis of variance."""

    subjects: int
    f: float
    dof: tuple[float, float]  # not corrected
    epsilon: float  # Greenhouse and Geisser's
    p_value: float  # with the corrected degrees of freedom


def repeated_measures_anova(errors: ArrayLike) -> Anova:
    """Compare k conditions that each of n subjects met: errors (n, k)."""
    from scipy.linalg import helmert
    from scipy.stats import f as f_distribution

    y = np.asarray(errors, dtype=float)
    if y.ndim != 2 or y.shape[0] < 3 or y.shape[1] < 2 or not np.isfinite(y).all():
        raise InputError(
            f"anova: expected three subjects or more in two conditions or more without gaps, got shape {y.shape}."
        )
    n, k = y.shape
    condition_means, subject_means, grand = y.mean(axis=0), y.mean(axis=1, keepdims=True), y.mean()
    between = n * float(((condition_means - grand) ** 2).sum())
    error = float(((y - condition_means - subject_means + grand) ** 2).sum())
    d1, d2 = float(k - 1), float((n - 1) * (k - 1))
    if error <= 1e-24 * max(float(((y - grand) ** 2).sum()), 1e-300):
        raise InputError("anova: the subjects respond all alike. The differences between the conditions are exact.")
    f = (between / d1) / (error / d2)
    covariance = np.atleast_2d(np.cov(y @ helmert(k).T, rowvar=False))
    squares = float((covariance * covariance).sum())
    epsilon = min(1.0, float(np.trace(covariance)) ** 2 / (d1 * squares)) if squares > 0.0 else 1.0
    p = float(f_distribution.sf(f, epsilon * d1, epsilon * d2))
    return Anova(subjects=n, f=f, dof=(d1, d2), epsilon=epsilon, p_value=p)


def adjust_holm(p: ArrayLike) -> FloatArray:
    """Adjust p values (m,) after Holm (Scandinavian Journal of Statistics 6, 1979)."""
    values = np.asarray(p, dtype=float)
    order = np.argsort(values, kind="stable")
    stepped = np.maximum.accumulate((len(values) - np.arange(len(values))) * values[order])
    adjusted = np.empty(len(values))
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted
