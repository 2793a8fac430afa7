"""Curves over temperature, with their covariance: through every point, or as stiff as the data allow.

``not_a_knot``   the note's cubic spline through set-point means; linear in the data, so its covariance is B V B'
``fit_smooth``   a smoothing spline (``wiener.py``): how much it bends (q) and how much the values scatter beyond their stated
                 variance (s2) are weighed by leave-out error: how well each group of neighbours is told by the others

One pair (q, s2) is seldom certain. Every pair on a grid gets the weight exp(sum of the log densities of what was left out),
times a wide prior on the bend: that the slope changes by as much as it is over 50 degC, give or take a factor of ten. The same
change laid out evenly, a parabola, is told apart from it, as most drift curves are parabolas first of all. Value and
covariance are those of the mixture, widened by Student's factor for few rows. s2 is the floor under the variance of a cell: a
thousand blocks at the hot end of a warm-up count no more than the scatter between cells lets them.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.drift.fit.weigh import SmoothSettings, bow_variance, weigh, widening_of
from undrift.drift.fit.wiener import Problem, curve_at, solved
from undrift.errors import InputError, NotObservable

_ENDS = np.array([-0.5, -0.4, 0.4, 0.5])  # scaled temperature: where the slope at either end of the data is taken


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wander:
    """How n rows scatter beyond their stated variance.

    Parameters
    ----------
    correlation : array, shape (n, n), or None
        C, of that scatter; None for independent rows.
    scatter : array, shape (k,), or None
        What is known of s2 beforehand, unit squared; None where nothing is.
    shared : array, shape (k, n, n), or None
        Known covariance of the rows besides, unit squared: what the rows of one session have in common.
    """

    correlation: FloatArray | None = None
    scatter: FloatArray | None = None
    shared: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NodeValues:
    """A curve at nodes.

    Parameters
    ----------
    temp_c : array, shape (m,)
        Nodes, degC.
    value : array, shape (m, k)
        k curves, their own unit.
    covariance : array, shape (k, m, m)
        Of each curve's nodes, unit squared.
    """

    temp_c: FloatArray
    value: FloatArray
    covariance: FloatArray

    @property
    def uncertainty(self) -> FloatArray:
        """Standard uncertainty of each node, shape (m, k)."""
        variance = np.diagonal(self.covariance, axis1=1, axis2=2).T
        deviation: FloatArray = np.sqrt(np.maximum(variance, 0.0))
        return deviation


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothSpline:
    """A fitted smoothing spline of k columns; evaluate it with ``at``.

    Parameters
    ----------
    origin_c, span_c : float
        T_0 and span of the scaled temperature, degC.
    problems : tuple of Problem
        One a column.
    bend, scatter, weight : tuple of array, shape (G,)
        q, s2 and weight of the pairs that count, one array a column.
    coefficient : array, shape (p, k)
        Of the regressors, unit of the values per unit of the regressor.
    coefficient_uncertainty : array, shape (p, k)
        Standard uncertainty of each.
    scatter_deviation : array, shape (k,)
        Root of the mean s2, unit of the values.
    leave_out_rms : array, shape (k,)
        Root-mean-square error of values left out between others, unit of the values; NaN where there are none.
    widening : float
        Factor on variances for few rows: (t / z)^2 with the 97.5 % points of Student's distribution and the normal.
    """

    origin_c: float
    span_c: float
    problems: tuple[Problem, ...]
    bend: tuple[FloatArray, ...]
    scatter: tuple[FloatArray, ...]
    weight: tuple[FloatArray, ...]
    coefficient: FloatArray
    coefficient_uncertainty: FloatArray
    scatter_deviation: FloatArray
    leave_out_rms: FloatArray
    widening: float

    def at(self, temp_c: FloatArray) -> NodeValues:
        """Return the curves at nodes; regressors count as 0 there.

        Outside the data the curve runs straight on, and what the mean curvature over their span would make of the distance
        counts as uncertainty besides.

        Parameters
        ----------
        temp_c : array, shape (m,)
            Nodes, degC.

        Returns
        -------
        NodeValues
            Values with covariance.
        """
        nodes = (np.asarray(temp_c, float) - self.origin_c) / self.span_c
        beyond = 0.5 * np.maximum(np.abs(nodes) - 0.5, 0.0) ** 2
        asked = np.concatenate((nodes, _ENDS))
        values, covariances = [], []
        for problem, bend, scatter, weight in zip(self.problems, self.bend, self.scatter, self.weight, strict=True):
            value, covariance = curve_at(problem, solved(problem, bend, scatter), bend, asked)
            mean = weight @ value
            off = value - mean
            both = np.einsum("g,gij->ij", weight, covariance) + np.einsum("g,gi,gj->ij", weight, off, off)
            n = len(nodes)
            slopes = np.diff(mean[n:])[::2] / (_ENDS[1] - _ENDS[0])
            bow = beyond * (slopes[1] - slopes[0])  # a curvature that lasts goes on outside
            values.append(mean[:n])
            covariances.append(both[:n, :n] + np.outer(bow, bow))
        return NodeValues(
            temp_c=np.array(temp_c, float),
            value=np.stack(values, axis=1),
            covariance=self.widening * np.array(covariances),
        )


def not_a_knot(temp_c: FloatArray, value: FloatArray, variance: FloatArray, nodes: FloatArray) -> NodeValues:
    """Return the cubic spline through every point, with not-a-knot ends.

    Linear in the data: nodes B y with covariance B V B'. It says what the noise of the points does, not how the device behaves
    between them. Two points give a line, three a parabola.

    Parameters
    ----------
    temp_c : array, shape (n,)
        Set-points, degC, increasing.
    value : array, shape (n, k)
        Means there, any unit.
    variance : array, shape (n, k)
        Of those means, unit squared.
    nodes : array, shape (m,)
        Where to evaluate, degC.

    Returns
    -------
    NodeValues
        k curves.

    Raises
    ------
    NotObservable
        Fewer than two set-points.
    InputError
        Set-points that do not increase.
    """
    from scipy.interpolate import CubicSpline

    if len(temp_c) < 2:
        raise NotObservable(
            f"spline: wanted two set-points or more, got {len(temp_c)}; record at another temperature",
            count=len(temp_c),
        )
    if (np.diff(temp_c) <= 0.0).any():
        raise InputError("spline: wanted set-points that increase, got some that do not; sort and join equal ones")
    basis = np.asarray(CubicSpline(temp_c, np.eye(len(temp_c)), bc_type="not-a-knot")(nodes))
    covariance = np.einsum("mi,ik,ni->kmn", basis, variance, basis)
    return NodeValues(temp_c=np.array(nodes, float), value=basis @ value, covariance=covariance)


def fit_smooth(
    temp_c: FloatArray,
    value: FloatArray,
    variance: FloatArray,
    *,
    regressors: FloatArray | None = None,
    groups: IntArray | None = None,
    wander: Wander = Wander(),
    settings: SmoothSettings = SmoothSettings(),
) -> SmoothSpline:
    """Fit a smoothing spline to each column, its stiffness weighed by leave-out error.

    Parameters
    ----------
    temp_c : array, shape (n,)
        degC, any order; about a hundred rows at most: gather more into cells first.
    value : array, shape (n, k)
        Values, any unit.
    variance : array, shape (n, k)
        Of each value, unit squared; zero where nothing is known.
    regressors : array, shape (n, p), or None
        Effects beside temperature, each with a coefficient of its own in each column: direction of a sweep, warm-up, session.
    groups : array of int, shape (n,), or None
        Rows of one number are left out together; None makes groups of neighbours in temperature.
    wander : Wander
        Scatter beyond the stated variance, and what is known of it.
    settings : SmoothSettings
        Priors.

    Returns
    -------
    SmoothSpline
        Evaluate it with ``at``.

    Raises
    ------
    NotObservable
        Fewer than two temperatures, or regressors that the rows do not determine.
    """
    span = float(np.ptp(temp_c)) if len(temp_c) else 0.0
    if span <= 0.0:
        raise NotObservable(
            f"spline: wanted two temperatures or more, got {min(len(temp_c), 1)}; record at another temperature"
        )
    origin = 0.5 * float(temp_c.min() + temp_c.max())
    x = (temp_c - origin) / span
    basis = (
        np.column_stack((np.ones(len(x)), x))
        if regressors is None
        else np.column_stack((np.ones(len(x)), x, regressors))
    )
    if np.linalg.matrix_rank(basis) < basis.shape[1]:
        raise NotObservable(
            f"spline: wanted rows that determine a line and {basis.shape[1] - 2} effects, got {len(x)} rows that do not; "
            "record more temperatures"
        )
    groups = neighbours(temp_c, settings.groups) if groups is None else groups
    correlation = np.eye(len(x)) if wander.correlation is None else wander.correlation
    parts = []
    for column in range(value.shape[1]):
        problem = Problem(
            x=x,
            y=value[:, column],
            variance=variance[:, column],
            basis=basis,
            correlation=correlation,
            groups=groups,
            shared=0.0 if wander.shared is None else wander.shared[column],
            bow=bow_variance(value[:, column], variance[:, column], span, settings),
        )
        parts.append(weigh(problem, None if wander.scatter is None else float(wander.scatter[column]), span, settings))
    known = 0.0 if wander.scatter is None else 2.0 / settings.scatter_spread**2
    widening = widening_of(max(len(x) - basis.shape[1] - 1, 0) + known)
    return SmoothSpline(
        origin_c=origin,
        span_c=span,
        problems=tuple(part.problem for part in parts),
        bend=tuple(part.bend for part in parts),
        scatter=tuple(part.scatter for part in parts),
        weight=tuple(part.weight for part in parts),
        coefficient=np.stack([part.coefficient for part in parts], axis=1),
        coefficient_uncertainty=np.sqrt(widening) * np.stack([part.uncertainty for part in parts], axis=1),
        scatter_deviation=np.array([np.sqrt(part.weight @ part.scatter) for part in parts]),
        leave_out_rms=np.array([part.leave_out_rms for part in parts]),
        widening=widening,
    )


def neighbours(temp_c: FloatArray, count: int) -> IntArray:
    """Return groups of rows that are neighbours in temperature, about as many rows in each.

    Parameters
    ----------
    temp_c : array, shape (n,)
        degC.
    count : int
        Groups at most.

    Returns
    -------
    array of int, shape (n,)
        Number of each row's group.
    """
    rank = np.argsort(np.argsort(temp_c, kind="stable"), kind="stable")
    groups: IntArray = rank * min(count, len(temp_c)) // len(temp_c)
    return groups
