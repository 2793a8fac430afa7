"""Least squares of readings whose offset wanders while they are taken.

Readings u of times t follow X theta + b(t) + n: n is white with known standard deviations, b a random walk that is zero in
the middle t_m of the session and spreads by q sqrt(|t - t_m|) either way::

    V(q) = diag(sigma^2) + q^2 min(|t_i - t_m|, |t_j - t_m|)     for t_i, t_j on one side of t_m, else diagonal

For each q, generalised least squares gives theta(q) with covariance C(q), and the restricted likelihood says how well that q
explains what is left (REML [1]_)::

    -2 log L(q) = log|V| + log|X' V^-1 X| + r' V^-1 r

One session knows its q to a factor of two or so, and its offset and g-sensitivity hang on it. So no single q is taken: the
parameters are averaged over all of them, each weighted by L(q), and the covariance is that of the error over every q that L(q)
allows [2]_::

    theta = E1 theta(q)        covariance = E0 C(q) + E0 (theta(q) - theta)(theta(q) - theta)'

E0 takes every q from zero up for equally likely beforehand: nothing milder gives intervals that hold where the walk is too
small to show. E1 takes 1 / (q + q0), with q0 a walk that ends a tenth of one reading's noise off: where nothing wanders the
error of the offset is then 1.1 times what it would be if that were known, where E0 makes it 1.3 times. There the intervals
of the offset are too wide, since no session can rule a small walk out: drift costs uncertainty instead of hiding in it.

References
----------
.. [1] D. A. Harville, "Maximum likelihood approaches to variance component estimation and to related problems", 1977.
.. [2] A. Gelman, "Prior distributions for variance parameters in hierarchical models", 2006.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray

_LEAST_SPARE = 4  # with fewer, the average over q has no finite variance
_SPREADS = (0.02, 1e6, 180)  # q sqrt(half the session) in units of the median sigma: steps of a tenth
_QUIET = 0.1  # q0, in the same unit
_EVIDENCE = 3.84  # 95 %: chi-square of one degree of freedom


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wandering:
    """One sensor's solution.

    Parameters
    ----------
    theta : array, shape (P,)
        Parameters.
    covariance : array, shape (P, P)
        Of them.
    walk : float
        Most likely q, reading per square root of a second; 0 where it is not told from none.
    square : float
        r' V^-1 r at the most likely q; E - P is expected.
    """

    theta: FloatArray
    covariance: FloatArray
    walk: float
    square: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Solutions:
    """Solutions for T values of q: theta (T, P), covariance (T, P, P), square (T,), and log L (T,)."""

    theta: FloatArray
    covariance: FloatArray
    square: FloatArray
    likelihood: FloatArray


def fit_wandering(design: FloatArray, reading: FloatArray, sigma: FloatArray, time: FloatArray | None) -> Wandering:
    """Solve for the parameters of one sensor and how its offset wandered.

    Parameters
    ----------
    design : array, shape (E, P)
        X, one equation a row; full rank.
    reading : array, shape (E,)
        u.
    sigma : array, shape (E,)
        Standard deviation of each reading, positive.
    time : array, shape (E,), or None
        s; None leaves the walk out, and so do fewer than four equations to spare.

    Returns
    -------
    Wandering
        theta with covariance, and q.
    """
    x, y = design / sigma[:, None], reading / sigma
    if time is None or len(reading) < design.shape[1] + _LEAST_SPARE:
        only = _solved(x, y, np.zeros(len(y)), np.zeros(1))
        return Wandering(theta=only.theta[0], covariance=only.covariance[0], walk=0.0, square=float(only.square[0]))
    away = time - 0.5 * (time.min() + time.max())
    half = max(float(np.abs(away).max()), 1e-9)
    unit = float(np.median(sigma)) / half**0.5
    same = np.sign(away)[:, None] == np.sign(away)[None, :]
    shape = np.where(same, np.minimum(np.abs(away)[:, None], np.abs(away)[None, :]), 0.0)
    gain, basis = np.linalg.eigh(
        shape * unit**2 / np.outer(sigma, sigma)
    )  # V(q) is diagonal in this basis, for every q
    spread = np.concatenate(([0.0], np.geomspace(*_SPREADS)))
    solutions = _solved(basis.T @ x, basis.T @ y, gain.clip(0.0), spread)
    return _averaged(solutions, spread, unit)


def _solved(x: FloatArray, y: FloatArray, gain: FloatArray, spread: FloatArray) -> _Solutions:
    # Uncorrelated readings of variance 1 + gain spread^2, solved for every spread at once.
    length = np.linalg.norm(x, axis=0)
    x = x / length
    weight = 1.0 / (1.0 + spread[:, None] ** 2 * gain)
    normal = (weight[:, None, :] * x.T) @ x
    inverse = np.linalg.inv(normal)
    start = np.linalg.lstsq(x, y, rcond=None)[
        0
    ]  # what is left of y is small, so that rounding in the normal equations is too
    left = y - x @ start
    step = (inverse @ ((weight * left) @ x)[:, :, None])[:, :, 0]
    square = (weight * (left - step @ x.T) ** 2).sum(axis=1)
    return _Solutions(
        theta=(start + step) / length,
        covariance=inverse / np.outer(length, length),
        square=square,
        likelihood=0.5 * (np.log(weight).sum(axis=1) - np.linalg.slogdet(normal)[1] - square),
    )


def _averaged(solutions: _Solutions, spread: FloatArray, unit: float) -> Wandering:
    best = int(np.argmax(solutions.likelihood))
    shows = 2.0 * (solutions.likelihood[best] - solutions.likelihood[0]) > _EVIDENCE
    step = np.gradient(spread)
    step[[0, -1]] *= 0.5  # trapezoids
    share = np.exp(solutions.likelihood - solutions.likelihood[best]) * step
    likely = share / (spread + _QUIET)
    share, likely = share / share.sum(), likely / likely.sum()
    theta = likely @ solutions.theta
    apart = solutions.theta - theta
    return Wandering(
        theta=theta,
        covariance=np.einsum("t,tij->ij", share, solutions.covariance) + (share[:, None] * apart).T @ apart,
        walk=unit * _peak(spread, solutions.likelihood, best) if shows else 0.0,
        square=float(solutions.square[best]),
    )


def _peak(spread: FloatArray, likelihood: FloatArray, best: int) -> float:
    if best < 2 or best == len(spread) - 1:
        return float(spread[best])
    left, middle, right = likelihood[best - 1 : best + 2]
    bend = left - 2.0 * middle + right  # parabola through three points of a geometric grid
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(spread[best] * (spread[best + 1] / spread[best]) ** np.clip(shift, -1.0, 1.0))
