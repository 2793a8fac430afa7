"""Least squares of readings whose offset wanders while they are taken.

Readings u of times t follow X theta + b(t) + n: n is white with known standard deviations, b a random walk that is zero in
the middle t_m of the session and spreads by q sqrt(|t - t_m|) either way::

    V(q) = diag(sigma^2) + q^2 min(|t_i - t_m|, |t_j - t_m|)     for t_i, t_j on one side of t_m, else diagonal

q is the one that makes the residuals most likely (REML: log|V| + log|X' V^-1 X| + r' V^-1 r least), from zero up; theta and its
covariance follow by generalised least squares. So drift during a session costs uncertainty instead of hiding in it [1]_.

References
----------
.. [1] D. A. Harville, "Maximum likelihood approaches to variance component estimation and to related problems", 1977.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wandering:
    """One sensor's solution.

    Parameters
    ----------
    theta : array, shape (P,)
        Parameters.
    covariance : array, shape (P, P)
        Of them.
    variance : array, shape (E, E)
        V at the q found.
    walk : float
        q, reading per square root of a second; 0 where none shows.
    square : float
        r' V^-1 r; E - P is expected.
    """

    theta: FloatArray
    covariance: FloatArray
    variance: FloatArray
    walk: float
    square: float


def fit_wandering(design: FloatArray, reading: FloatArray, sigma: FloatArray, time: FloatArray | None) -> Wandering:
    """Solve for the parameters of one sensor and how its offset wandered.

    Parameters
    ----------
    design : array, shape (E, P)
        X, one equation a row.
    reading : array, shape (E,)
        u.
    sigma : array, shape (E,)
        Standard deviation of each reading.
    time : array, shape (E,), or None
        s; None leaves the walk out.

    Returns
    -------
    Wandering
        theta with covariance, and q.
    """
    white = np.diag(sigma**2)
    if time is None or len(reading) <= design.shape[1] + 1:
        return _solved(design, reading, white, 0.0)[0]
    from scipy.optimize import minimize_scalar

    away = time - 0.5 * (time.min() + time.max())
    same = np.sign(away)[:, None] == np.sign(away)[None, :]
    shape = np.where(same, np.minimum(np.abs(away)[:, None], np.abs(away)[None, :]), 0.0)
    size = float(np.median(sigma)) / np.sqrt(max(float(np.abs(away).max()), 1e-9))

    def unlikely(log_q: float) -> float:
        return _solved(design, reading, white + (size * np.exp(log_q)) ** 2 * shape, 0.0)[1]

    found = minimize_scalar(unlikely, bounds=(-5.0, 8.0), method="bounded", options={"xatol": 0.02})
    still, unlikely_still = _solved(design, reading, white, 0.0)
    if unlikely_still - float(found.fun) < 2.0 * 1.92:  # 95 %: chi-square of one degree of freedom
        return still
    walk = size * float(np.exp(found.x))
    return _solved(design, reading, white + walk**2 * shape, walk)[0]


def chi_square(design: FloatArray, reading: FloatArray, variance: FloatArray) -> float:
    """Return the least r' V^-1 r of a design with a given covariance of the readings.

    Parameters
    ----------
    design : array, shape (E, P)
        X.
    reading : array, shape (E,)
        u.
    variance : array, shape (E, E)
        V.

    Returns
    -------
    float
        Weighted sum of squares.
    """
    return _solved(design, reading, variance, 0.0)[0].square


def _solved(design: FloatArray, reading: FloatArray, variance: FloatArray, walk: float) -> tuple[Wandering, float]:
    factor = np.linalg.cholesky(variance)
    x, y = np.linalg.solve(factor, design), np.linalg.solve(factor, reading)
    scale = np.linalg.norm(x, axis=0)
    normal = (x / scale).T @ (x / scale)
    theta = np.linalg.lstsq(x / scale, y, rcond=None)[0] / scale
    square = float(((y - x @ theta) ** 2).sum())
    solution = Wandering(
        theta=theta,
        covariance=np.linalg.inv(normal) / np.outer(scale, scale),
        variance=variance,
        walk=walk,
        square=square,
    )
    unlikely = (
        2.0 * float(np.log(np.diag(factor)).sum())
        + float(np.linalg.slogdet(normal)[1])
        + 2.0 * float(np.log(scale).sum())
        + square
    )
    return solution, unlikely
