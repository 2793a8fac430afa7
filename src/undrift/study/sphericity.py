"""Sphericity of repeated measures: whether all differences between conditions have one variance, and what it costs if not.

With the covariance S (k, k) of the conditions over subjects and C (k - 1, k) orthonormal contrasts, A = C S C^T::

    Greenhouse-Geisser   e = tr(A)^2 / ((k - 1) tr(A A))
    Huynh-Feldt          e~ = (n (k - 1) e - 2) / ((k - 1) (n - 1 - (k - 1) e)), at most 1
    lower bound          1 / (k - 1)
    Mauchly              W = det(A) / (tr(A) / (k - 1))^(k - 1), chi2 = -(n - 1 - (2 p^2 + p + 2) / (6 p)) ln W, p = k - 1

Both degrees of freedom of the F test are multiplied by the epsilon.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphericity:
    """How far repeated measures are from spherical.

    Parameters
    ----------
    greenhouse_geisser, huynh_feldt, lower_bound : float
        Epsilon of each correction, 1 for spherical.
    mauchly_w : float
        Mauchly's W, 1 for spherical; NaN where it cannot be had.
    chi_squared : float
        Of Mauchly's test.
    dof : int
        Its degrees of freedom.
    p_value : float
        Of Mauchly's test; NaN with fewer subjects than conditions, or two conditions.
    """

    greenhouse_geisser: float
    huynh_feldt: float
    lower_bound: float
    mauchly_w: float
    chi_squared: float
    dof: int
    p_value: float


def contrasts(conditions: int) -> FloatArray:
    """Return orthonormal contrasts between conditions (Helmert's).

    Parameters
    ----------
    conditions : int
        k, 2 or more.

    Returns
    -------
    array, shape (k - 1, k)
        Rows of length one, orthogonal to each other and to the mean.
    """
    rows = np.zeros((conditions - 1, conditions))
    for j in range(1, conditions):
        rows[j - 1, :j], rows[j - 1, j] = 1.0, -float(j)
        rows[j - 1] /= np.sqrt(j * (j + 1.0))
    return rows


def sphericity(y: FloatArray) -> Sphericity:
    """Find how far repeated measures are from spherical.

    Parameters
    ----------
    y : array, shape (n, k)
        One subject a row, one condition a column.

    Returns
    -------
    Sphericity
        Corrections and Mauchly's test.

    References
    ----------
    .. [1] S. Greenhouse, S. Geisser, On methods in the analysis of profile data, Psychometrika 24, 1959.
    .. [2] H. Huynh, L. Feldt, Estimation of the Box correction, J. Educational Statistics 1, 1976.
    .. [3] J. Mauchly, Significance test for sphericity of a normal n-variate distribution, Ann. Math. Stat. 11, 1940.
    .. [4] T. Anderson, An introduction to multivariate statistical analysis, Wiley, 1958, 10.7.4: the second-order term of its p.
    """
    n, k = y.shape
    p = k - 1
    transformed = y @ contrasts(k).T
    a = np.atleast_2d(np.cov(transformed, rowvar=False))
    trace, squared = float(np.trace(a)), float(np.sum(a * a))
    gg = trace**2 / (p * squared) if squared > 0.0 else 1.0
    room = p * (n - 1 - p * gg)
    hf = min(1.0, (n * p * gg - 2.0) / room) if room > 0.0 else 1.0
    w, chi, dof, p_value = _mauchly(a, n)
    return Sphericity(
        greenhouse_geisser=min(1.0, gg),
        huynh_feldt=max(hf, min(1.0, gg)),
        lower_bound=1.0 / p,
        mauchly_w=w,
        chi_squared=chi,
        dof=dof,
        p_value=p_value,
    )


def _mauchly(a: FloatArray, n: int) -> tuple[float, float, int, float]:
    from scipy.stats import chi2

    p = len(a)
    dof = p * (p + 1) // 2 - 1
    if p < 2 or n - 1 < p:
        return np.nan, np.nan, dof, np.nan
    sign, log_det = np.linalg.slogdet(a)
    if sign <= 0.0:
        return 0.0, np.inf, dof, 0.0
    log_w = float(log_det) - p * float(np.log(np.trace(a) / p))
    room = n - 1 - (2.0 * p * p + p + 2.0) / (6.0 * p)
    statistic = -room * log_w
    second = (p + 2.0) * (p - 1.0) * (p - 2.0) * (2.0 * p**3 + 6.0 * p * p + 3.0 * p + 2.0) / (288.0 * (p * room) ** 2)
    first = float(chi2.sf(statistic, dof))
    p_value = first + second * (float(chi2.sf(statistic, dof + 4)) - first)  # Anderson's second-order term
    return float(np.exp(log_w)), statistic, dof, min(max(p_value, 0.0), 1.0)
