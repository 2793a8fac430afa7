"""Which conditions differ: paired t tests of all pairs, p after Holm; contrasts of the mixed model where values are missing.

Holm's p of the r-th smallest of m: max over those up to it of (m - r + 1) p, at most 1; it holds the chance of any false
finding at the level, whatever the dependence between the tests.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import FloatArray, frozen
from undrift.errors import InputError
from undrift.study.mixed import MixedModel


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two conditions compared.

    Parameters
    ----------
    first, second : int
        Columns, or places of a mixed model's conditions.
    difference : float
        Mean of first minus second, unit of the data.
    interval : tuple of float
        Its 95 % interval, not corrected for the number of pairs.
    t : float
        Paired t, n - 1 degrees of freedom.
    p_value, p_holm : float
        Two-sided, as it stands and after Holm.
    cohen_dz : float
        Difference over the standard deviation of the differences; in a mixed model that is sqrt(2) s_e.
    """

    first: int
    second: int
    difference: float
    interval: tuple[float, float]
    t: float
    p_value: float
    p_holm: float
    cohen_dz: float


def compare_pairs(y: ArrayLike) -> tuple[Pair, ...]:
    """Compare every pair of conditions.

    Parameters
    ----------
    y : array_like, shape (n, k)
        One subject a row, one condition a column; any unit.

    Returns
    -------
    tuple of Pair
        k (k - 1) / 2 of them, by columns.

    Raises
    ------
    InputError
        Fewer than three subjects.
    """
    table = frozen(y, (None, None), "pairs")
    n, k = table.shape
    if n < 3 or k < 2:
        raise InputError(f"pairs: wanted three subjects or more in two conditions or more, got {n} in {k}; add some")
    pairs = list(combinations(range(k), 2))
    apart = np.array([table[:, i] - table[:, j] for i, j in pairs])
    sd = apart.std(axis=1, ddof=1)
    return _judged(pairs, apart.mean(axis=1), sd / np.sqrt(n), sd, n - 1)


def compare_pairs_of(model: MixedModel) -> tuple[Pair, ...]:
    """Compare every pair of conditions of a mixed model, by its contrasts.

    The uncertainty of a difference is that of the model, one residual for all pairs; t has n - 1 degrees of freedom, as the paired
    test would.

    Parameters
    ----------
    model : MixedModel
        Outcome.

    Returns
    -------
    tuple of Pair
        k (k - 1) / 2 of them, by the conditions' places.
    """
    pairs = list(combinations(range(len(model.conditions)), 2))
    first, second = np.array(pairs).T
    v = model.covariance
    uncertainty = np.sqrt(v[first, first] + v[second, second] - 2.0 * v[first, second])
    sd = np.full(len(pairs), np.sqrt(2.0) * model.residual_sd)
    return _judged(pairs, model.means[first] - model.means[second], uncertainty, sd, model.subjects - 1)


def _judged(
    pairs: list[tuple[int, int]], mean: FloatArray, uncertainty: FloatArray, sd: FloatArray, dof: int
) -> tuple[Pair, ...]:
    from scipy.stats import t as t_distribution

    without = np.where(mean == 0.0, 0.0, np.sign(mean) * np.inf)  # no spread at all
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(sd > 0.0, mean / uncertainty, without)
        dz = np.where(sd > 0.0, mean / sd, without)
    p = 2.0 * t_distribution.sf(np.abs(t), dof)
    reach = float(t_distribution.ppf(0.975, dof)) * uncertainty
    holm = adjust_holm(p)
    return tuple(
        Pair(
            first=i,
            second=j,
            difference=float(mean[r]),
            interval=(float(mean[r] - reach[r]), float(mean[r] + reach[r])),
            t=float(t[r]),
            p_value=float(p[r]),
            p_holm=float(holm[r]),
            cohen_dz=float(dz[r]),
        )
        for r, (i, j) in enumerate(pairs)
    )


def adjust_holm(p: ArrayLike) -> FloatArray:
    """Adjust p values after Holm.

    Parameters
    ----------
    p : array_like, shape (m,)
        As they stand.

    Returns
    -------
    array, shape (m,)
        Adjusted, in the given order.

    References
    ----------
    .. [1] S. Holm, A simple sequentially rejective multiple test procedure, Scand. J. Statistics 6, 1979.
    """
    values = np.asarray(p, dtype=float)
    order = np.argsort(values, kind="stable")
    stepped = np.maximum.accumulate((len(values) - np.arange(len(values))) * values[order])
    adjusted = np.empty(len(values))
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted
