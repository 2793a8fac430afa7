"""TriadFit: what every fit returns, and the linear algebra that the fits share.

Forward model of a triad: s = K a + b. Least squares gives (K, b) with their covariance; the correction needs the inverse,
a = M (s - o) with M = K^-1 and o = b. The covariance is carried over to first order::

    dM = -M dK M        do = db
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import TriadModel, Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadFit:
    """A fitted triad, its residuals, and what it is worth.

    Parameters
    ----------
    model : TriadModel
        The inverse model, with covariance, count, rank, condition and range.
    residuals : array, shape (E,) or (E, 3)
        Residual of each equation, unit_out.
    verdict : Verdict
        In words.
    """

    model: TriadModel
    residuals: FloatArray
    verdict: Verdict


def inverse_jacobian(matrix: FloatArray) -> FloatArray:
    """Return d vec(M) / d vec(K) for M = K^-1, both stacked row by row.

    Parameters
    ----------
    matrix : array, shape (3, 3)
        M.

    Returns
    -------
    array, shape (9, 9)
        -M (x) M^T, from dM = -M dK M.
    """
    return -np.kron(matrix, matrix.T)


def scaled_condition(design: FloatArray) -> tuple[int, float]:
    """Return rank and condition number of a design after scaling its columns to one.

    Parameters
    ----------
    design : array, shape (E, P)
        One equation a row.

    Returns
    -------
    rank : int
        Numerical rank.
    condition : float
        Ratio of the largest to the smallest singular value; infinite when the rank is short.
    """
    length = np.linalg.norm(design, axis=0)
    length[length == 0.0] = 1.0
    singular = np.linalg.svd(design / length, compute_uv=False)
    rank = int((singular > singular[0] * max(design.shape) * np.finfo(float).eps * 10.0).sum())
    return rank, float(singular[0] / singular[-1]) if rank == design.shape[1] else float("inf")
