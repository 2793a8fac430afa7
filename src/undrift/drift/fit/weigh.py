"""Which stiffness: pairs (q, s2) on a grid, weighed by how well each group of neighbours is told by the others.

The grid is laid twice: over the prior, then about what the first round left. A pair's weight is exp(sum of the log densities of
the values left out) times the prior; where too few groups can be left out the restricted likelihood takes their place.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.drift.fit.wiener import Problem, Solved, leave_out, restricted_likelihood, solved

_NEGLIGIBLE = 1e-5  # weight
_LEAST_GROUPS = 5  # fewer groups cannot be left out one by one
_POINTS = 9  # of the grid along each hyperparameter, in each of two rounds


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothSettings:
    """What a curve is taken to be before the data speak.

    Parameters
    ----------
    bend_span_c : float
        The slope changes by as much as the mean slope over this span, degC: of the parabola and of the bends beside it. Shorter
        allows more of both where data are few.
    bend_spread : float
        Standard deviation of the logarithm of q about that. Larger leaves more to the data.
    scatter_spread : float
        Standard deviation of the logarithm of s2 about a stated ``scatter``: hundreds of blocks tell that within a tenth, and the
        law by which it is carried to hours within a factor of two.
    groups : int
        Groups of neighbours that are left out in turn where no groups are given; at most one a point.
    """

    bend_span_c: float = 50.0
    bend_spread: float = 2.3
    scatter_spread: float = 0.7
    groups: int = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weighed:
    """One column: the pairs of hyperparameters that count, and what they make of the p regressors.

    Parameters
    ----------
    problem : Problem
        Values, any unit.
    bend, scatter, weight : array, shape (G,)
        q, s2 (unit squared) and weight.
    coefficient, uncertainty : array, shape (p,)
        Of the regressors, and standard uncertainty.
    leave_out_rms : float
        Unit of the values.
    """

    problem: Problem
    bend: FloatArray
    scatter: FloatArray
    weight: FloatArray
    coefficient: FloatArray
    uncertainty: FloatArray
    leave_out_rms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _Prior:
    """Where the grid lies: logarithms of q and s2, and how the first of them, and perhaps the second, spread."""

    bend: float
    bend_spread: float
    scatter: float
    scatter_spread: float
    flat: bool

    def of(self, bend: FloatArray, scatter: FloatArray) -> FloatArray:
        density: FloatArray = -0.5 * ((bend - self.bend) / self.bend_spread) ** 2
        return density if self.flat else density - 0.5 * ((scatter - self.scatter) / self.scatter_spread) ** 2


def _prior(problem: Problem, scatter: float | None, span: float, settings: SmoothSettings) -> _Prior:
    straight = problem.basis
    left = problem.y - straight @ np.linalg.lstsq(straight, problem.y, rcond=None)[0]
    noise = float(np.median(problem.variance))
    size = _size(problem.y, problem.variance)
    bend = float(np.log(size * span / settings.bend_span_c))
    if scatter is not None and scatter > 0.0:
        return _Prior(
            bend=bend, bend_spread=settings.bend_spread, scatter=float(np.log(scatter)), scatter_spread=settings.scatter_spread,
            flat=False,
        )  # fmt: skip
    most = max(4.0 * float(np.mean(left**2)), noise, 1e-12 * size)
    least = max(1e-2 * noise, 1e-6 * most)
    middle, half = 0.5 * np.log(most * least), 0.5 * np.log(most / least)
    return _Prior(
        bend=bend, bend_spread=settings.bend_spread, scatter=float(middle), scatter_spread=max(float(half) / 3.0, 0.3),
        flat=True,
    )  # fmt: skip


def weigh(problem: Problem, scatter: float | None, span: float, settings: SmoothSettings) -> Weighed:
    """Return the pairs of hyperparameters that count.

    Parameters
    ----------
    problem : Problem
        One column of values.
    scatter : float or None
        What is known of s2 beforehand, unit squared.
    span : float
        Of the temperatures, degC.
    settings : SmoothSettings
        Priors.

    Returns
    -------
    Weighed
        Pairs with weights that add up to one.
    """
    prior = _prior(problem, scatter, span, settings)
    centre, spread = (prior.bend, prior.scatter), (prior.bend_spread, prior.scatter_spread)
    steps = np.linspace(-3.0, 3.0, _POINTS)
    for last in (False, True):
        bend, scatters = (
            grid.ravel() for grid in np.meshgrid(centre[0] + spread[0] * steps, centre[1] + spread[1] * steps)
        )
        made = solved(problem, np.exp(bend), np.exp(scatters))
        weight, square = _weights(problem, made, prior.of(bend, scatters))
        centre = (float(weight @ bend), float(weight @ scatters))
        spread = (_deviation(bend, weight, spread[0]), _deviation(scatters, weight, spread[1]))
        if last:
            break
    kept = weight > _NEGLIGIBLE
    weight = weight[kept] / weight[kept].sum()
    beta, covariance = made.beta[kept, 2:], np.diagonal(made.beta_covariance[kept], axis1=1, axis2=2)[:, 2:]
    coefficient = weight @ beta
    return Weighed(
        problem=problem,
        bend=np.exp(bend[kept]),
        scatter=np.exp(scatters[kept]),
        weight=weight,
        coefficient=coefficient,
        uncertainty=np.sqrt(weight @ (covariance + (beta - coefficient) ** 2)),
        leave_out_rms=float(np.sqrt(weight @ square[kept])),
    )


def bow_variance(value: FloatArray, variance: FloatArray, span: float, settings: SmoothSettings) -> float:
    """Return the prior variance of the bow: a slope that changes evenly, by the mean slope over ``bend_span_c``.

    Parameters
    ----------
    value, variance : array, shape (n,)
        One column, any unit, and its square.
    span : float
        Of the temperatures, degC.
    settings : SmoothSettings
        Priors.

    Returns
    -------
    float
        Unit squared: of what the parabola makes from the middle to either end.
    """
    share = span / (8.0 * settings.bend_span_c)
    return share**2 * _size(value, variance)


def widening_of(freedom: float) -> float:
    """Return the factor on a variance that few degrees of freedom ask for.

    Parameters
    ----------
    freedom : float
        Degrees of freedom; fewer than one count as one.

    Returns
    -------
    float
        (t / z)^2 of the 97.5 % points of Student's distribution and the normal.
    """
    from scipy.stats import norm, t

    return float((t.ppf(0.975, max(freedom, 1.0)) / norm.ppf(0.975)) ** 2)


def _size(value: FloatArray, variance: FloatArray) -> float:
    """Return the square of how far the values range, no less than their noise makes them."""
    return max(float(np.ptp(value)) ** 2, 4.0 * float(np.median(variance)), 1e-300)


def _deviation(grid: FloatArray, weight: FloatArray, spread: float) -> float:
    # Of a weighted grid, no finer than its own step allows it to tell.
    own = float(np.sqrt(weight @ (grid - weight @ grid) ** 2))
    return max(own, spread * 3.0 / (_POINTS - 1))


def _weights(problem: Problem, made: Solved, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    score, square = leave_out(problem, made)
    if len(np.unique(problem.groups)) < _LEAST_GROUPS:
        score = restricted_likelihood(problem, made)
    total = score + prior
    weight = np.exp(total - total.max())
    return weight / weight.sum(), square
