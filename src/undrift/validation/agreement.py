"""Agreement of two methods, or of several raters: Bland-Altman limits, intraclass correlations, what change is real.

Two-way layout of n subjects (here trials) and k methods, mean squares MSR of rows, MSC of columns, MSE of the rest [1]_::

    ICC(2,1) = (MSR - MSE) / (MSR + (k-1) MSE + k (MSC - MSE) / n)      absolute agreement, methods drawn from many
    ICC(3,1) = (MSR - MSE) / (MSR + (k-1) MSE)                          consistency, these methods only
    SEM      = sqrt(max(MSC - MSE, 0) / n + MSE)                        standard error of one measurement
    MDC95    = 1.96 sqrt(2) SEM                                         least change between two that is real

Intervals from F distributions [2]_. An ICC depends on how much the subjects differ: it stands beside the limits, never alone.

References
----------
.. [1] P. E. Shrout, J. L. Fleiss, "Intraclass correlations: uses in assessing rater reliability", 1979.
.. [2] K. O. McGraw, S. P. Wong, "Forming inferences about some intraclass correlation coefficients", 1996.
.. [3] J. M. Bland, D. G. Altman, "Measuring agreement in method comparison studies", 1999.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError

Interval = tuple[float, float]
Z95 = 1.959963984540054


@dataclass(frozen=True, slots=True, kw_only=True)
class BlandAltman:
    """Difference of two methods over subjects.

    Parameters
    ----------
    bias : float
        Mean of first less second, unit of the data.
    standard_deviation : float
        Of the differences.
    limits : tuple of float
        bias -+ 1.96 standard deviations: 95 % of single differences.
    bias_interval, lower_interval, upper_interval : tuple of float
        95 % confidence intervals of the bias and of each limit.
    count : int
        Subjects.
    """

    bias: float
    standard_deviation: float
    limits: Interval
    bias_interval: Interval
    lower_interval: Interval
    upper_interval: Interval
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class IntraclassCorrelation:
    """An intraclass correlation and what goes with it.

    Parameters
    ----------
    kind : str
        "ICC(2,1)" or "ICC(3,1)".
    value : float
        Estimate; negative estimates are kept.
    interval : tuple of float
        95 % confidence interval.
    standard_error_of_measurement : float
        SEM, unit of the data; for ICC(3,1) without the differences between methods.
    minimal_detectable_change : float
        MDC95, unit of the data.
    """

    kind: str
    value: float
    interval: Interval
    standard_error_of_measurement: float
    minimal_detectable_change: float


def bland_altman(first: FloatArray, second: FloatArray) -> BlandAltman:
    """Compare two methods over subjects, one value each.

    Samples within a trial are not independent: give one summary per trial.

    Parameters
    ----------
    first, second : array, shape (n,)
        One value per subject from each method, one unit.

    Returns
    -------
    BlandAltman
        Bias and 95 % limits of agreement with confidence intervals [3]_ of the module.

    Raises
    ------
    InputError
        Fewer than three subjects, lengths that differ, or gaps.
    """
    from scipy.special import stdtrit

    table = _table(np.stack((first, second), axis=1) if len(first) == len(second) else np.empty((0, 2)))
    difference = table[:, 0] - table[:, 1]
    n, bias, sd = len(difference), float(difference.mean()), float(difference.std(ddof=1))
    t = float(stdtrit(n - 1, 0.975))
    low, high = bias - Z95 * sd, bias + Z95 * sd
    of_bias = t * sd / float(np.sqrt(n))
    of_limit = t * sd * float(np.sqrt(1.0 / n + Z95**2 / (2.0 * (n - 1))))
    return BlandAltman(
        bias=bias,
        standard_deviation=sd,
        limits=(low, high),
        bias_interval=(bias - of_bias, bias + of_bias),
        lower_interval=(low - of_limit, low + of_limit),
        upper_interval=(high - of_limit, high + of_limit),
        count=n,
    )


def intraclass_correlation(
    ratings: FloatArray, kind: Literal["ICC(2,1)", "ICC(3,1)"] = "ICC(2,1)"
) -> IntraclassCorrelation:
    """Return an intraclass correlation of single measurements with its 95 % interval.

    Parameters
    ----------
    ratings : array, shape (n, k)
        One row a subject, one column a method, no gaps.
    kind : str
        "ICC(2,1)" for absolute agreement, "ICC(3,1)" for consistency.

    Returns
    -------
    IntraclassCorrelation
        Value, interval, SEM, MDC95.

    Raises
    ------
    InputError
        Fewer than three subjects or two methods, gaps, or an unknown kind.
    """
    table = _table(ratings)
    n, k = table.shape
    rows, columns, rest = _mean_squares(table)
    if kind == "ICC(2,1)":
        bottom = rows + (k - 1) * rest + k * (columns - rest) / n
        value = (rows - rest) / bottom if bottom else float("nan")
        interval = _absolute_interval(value, n, k, (rows, columns, rest))
        sem = float(np.sqrt(max(columns - rest, 0.0) / n + rest))
    elif kind == "ICC(3,1)":
        bottom = rows + (k - 1) * rest
        value = (rows - rest) / bottom if bottom else float("nan")
        interval = _consistency_interval(n, k, rows, rest)
        sem = float(np.sqrt(rest))
    else:
        raise InputError(f"intraclass correlation: wanted ICC(2,1) or ICC(3,1), got {kind}; choose one")
    return IntraclassCorrelation(
        kind=kind,
        value=value,
        interval=interval,
        standard_error_of_measurement=sem,
        minimal_detectable_change=Z95 * float(np.sqrt(2.0)) * sem,
    )


def _table(ratings: FloatArray) -> FloatArray:
    table = np.asarray(ratings, dtype=np.float64)
    if table.ndim != 2 or table.shape[0] < 3 or table.shape[1] < 2 or not np.isfinite(table).all():
        raise InputError(
            f"agreement: wanted three subjects or more and two methods or more without gaps, got shape {table.shape}; "
            "give one value per subject and method"
        )
    return table


def _mean_squares(table: FloatArray) -> tuple[float, float, float]:
    n, k = table.shape
    mean = table.mean()
    of_rows, of_columns = table.mean(axis=1), table.mean(axis=0)
    rest = table - of_rows[:, None] - of_columns + mean
    return (
        float(k * ((of_rows - mean) ** 2).sum() / (n - 1)),
        float(n * ((of_columns - mean) ** 2).sum() / (k - 1)),
        float((rest**2).sum() / ((n - 1) * (k - 1))),
    )


def _absolute_interval(value: float, n: int, k: int, squares: tuple[float, float, float]) -> Interval:
    from scipy.special import fdtri

    rows, columns, rest = squares  # reference 2, table 7, case 2A
    if not np.isfinite(value) or value >= 1.0 or rest <= 0.0:
        return (value, value)
    a = k * value / (n * (1.0 - value))
    b = 1.0 + k * value * (n - 1) / (n * (1.0 - value))
    v = (a * columns + b * rest) ** 2 / ((a * columns) ** 2 / (k - 1) + (b * rest) ** 2 / ((n - 1) * (k - 1)))
    low_f, high_f = float(fdtri(n - 1, v, 0.975)), float(fdtri(v, n - 1, 0.975))
    mixed = k * columns + (k * n - k - n) * rest
    low = n * (rows - low_f * rest) / (low_f * mixed + n * rows)
    high = n * (high_f * rows - rest) / (mixed + n * high_f * rows)
    return (low, high)


def _consistency_interval(n: int, k: int, rows: float, rest: float) -> Interval:
    from scipy.special import fdtri

    if rest <= 0.0:
        return (1.0, 1.0)
    low_f = rows / rest / float(fdtri(n - 1, (n - 1) * (k - 1), 0.975))  # reference 2, table 7, case 3
    high_f = rows / rest * float(fdtri((n - 1) * (k - 1), n - 1, 0.975))
    return ((low_f - 1.0) / (low_f + k - 1.0), (high_f - 1.0) / (high_f + k - 1.0))
