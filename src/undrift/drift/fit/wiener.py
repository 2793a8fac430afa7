"""Curves that bend at random: the algebra behind the smoothing spline.

::

    y = f(x) + Z c + e       f = a + b x + g p(x) + sqrt(q) * integral of a Wiener process
                             x = (T - T_0) / span, T_0 the middle; p = 4 x^2 between the ends, its tangents outside
    cov e = diag(v) + s2 C   v known, C known, q and s2 to be found

The mean of f given y is the cubic smoothing spline with stiffness s2 / q, and its covariance is known everywhere: small among
the data, growing with the cube of the distance outside [1]_. a, b and c have no prior; g, the bow, has a wide one about 0, as most
drift curves are parabolas first of all: without it five values would leave the whole bow to chance between them. With
K = q k(x, x') + g2 p p' + cov e, H = (1, x, Z) and P = K^-1 - K^-1 H (H' K^-1 H)^-1 H' K^-1, what the others say about rows I left
out is off by P_II^-1 (P y)_I with covariance P_II^-1: the leave-out error needs no second fit.

References
----------
.. [1] G. Wahba, "Improper priors, spline smoothing and the problem of guarding against model errors in regression", J. R.
   Statist. Soc. B 40, 1978, 364-372.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray

_JITTER = 1e-11  # of the variance of the values: keeps a curve through exact values solvable


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """One column of values over scaled temperature.

    Parameters
    ----------
    x : array, shape (n,)
        Scaled temperature.
    y : array, shape (n,)
        Values, any unit.
    variance : array, shape (n,)
        v, that unit squared.
    basis : array, shape (n, 2 + p)
        H: ones, x, and p regressors.
    correlation : array, shape (n, n)
        C.
    groups : array of int, shape (n,)
        Rows of one number are left out together.
    shared : array, shape (n, n), or 0
        Known covariance of the rows beside v, that unit squared.
    bow : float
        Prior variance of g, that unit squared; 0 for no parabola.
    """

    x: FloatArray
    y: FloatArray
    variance: FloatArray
    basis: FloatArray
    correlation: FloatArray
    groups: IntArray
    shared: FloatArray | float = 0.0
    bow: float = 0.0

    def covariance(self, bend: FloatArray, scatter: FloatArray) -> FloatArray:
        """Return K for each pair of hyperparameters.

        Parameters
        ----------
        bend, scatter : array, shape (G,)
            q and s2.

        Returns
        -------
        array, shape (G, n, n)
            Unit of y squared.
        """
        bow = parabola(self.x)
        own = self.shared + self.bow * np.outer(bow, bow)
        own = own + np.diag(self.variance + _JITTER * max(float(np.var(self.y)), 1e-300))
        made: FloatArray = (
            bend[:, None, None] * bending(self.x, self.x) + own + scatter[:, None, None] * self.correlation
        )
        return made


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """A problem at G pairs of hyperparameters.

    Parameters
    ----------
    inverse : array, shape (G, n, n)
        K^-1.
    projected : array, shape (G, n, n)
        P.
    beta_covariance : array, shape (G, 2 + p, 2 + p)
        (H' K^-1 H)^-1.
    beta : array, shape (G, 2 + p)
        a, b and c.
    """

    inverse: FloatArray
    projected: FloatArray
    beta_covariance: FloatArray
    beta: FloatArray


def bending(one: FloatArray, two: FloatArray) -> FloatArray:
    """Return the covariance of a once integrated Wiener process that runs both ways from 0, where it is flat.

    ``k(s, t) = m^2 (3 M - m) / 6`` with m the lesser and M the greater of |s| and |t|, on one side of 0; zero across it.

    Parameters
    ----------
    one : array, shape (n,)
        Places.
    two : array, shape (m,)
        Other places.

    Returns
    -------
    array, shape (n, m)
        For q = 1.
    """
    least = np.minimum(np.abs(one)[:, None], np.abs(two)[None, :])
    most = np.maximum(np.abs(one)[:, None], np.abs(two)[None, :])
    same_side = one[:, None] * two[None, :] > 0.0
    return np.where(same_side, least**2 * (3.0 * most - least) / 6.0, 0.0)


def parabola(x: FloatArray) -> FloatArray:
    """Return p: a parabola between the ends of the data, its tangents outside.

    Parameters
    ----------
    x : array, shape (n,)
        Scaled temperature.

    Returns
    -------
    array, shape (n,)
        0 in the middle, 1 at either end.
    """
    size = np.abs(x)
    inside = np.minimum(size, 0.5)
    p: FloatArray = 4.0 * (inside**2 + size - inside)
    return p


def solved(problem: Problem, bend: FloatArray, scatter: FloatArray) -> Solved:
    """Solve a problem for each pair of hyperparameters.

    Parameters
    ----------
    problem : Problem
        Values and what is known of them.
    bend, scatter : array, shape (G,)
        q and s2.

    Returns
    -------
    Solved
        Matrices and coefficients.
    """
    inverse = np.linalg.inv(problem.covariance(bend, scatter))
    weighted = inverse @ problem.basis
    beta_covariance = np.linalg.inv(np.swapaxes(problem.basis.T @ weighted, 1, 2))
    projected = inverse - weighted @ beta_covariance @ np.swapaxes(weighted, 1, 2)
    beta = np.einsum("gij,gnj,n->gi", beta_covariance, weighted, problem.y)
    return Solved(inverse=inverse, projected=projected, beta_covariance=beta_covariance, beta=beta)


def leave_out(problem: Problem, made: Solved) -> tuple[FloatArray, FloatArray]:
    """Return how well each group is told by the others.

    Parameters
    ----------
    problem : Problem
        Values and groups.
    made : Solved
        For G pairs of hyperparameters.

    Returns
    -------
    score : array, shape (G,)
        Sum over groups of the logarithm of the density that the others give to the values left out.
    square : array, shape (G,)
        Mean of the squared errors of the values left out between others, not at the ends, unit of y squared; NaN where none can
        be left out.
    """
    projected_y = made.projected @ problem.y
    score, square, count = np.zeros(len(made.beta)), np.zeros(len(made.beta)), 0
    ends = problem.groups[[np.argmin(problem.x), np.argmax(problem.x)]]
    for number in np.unique(problem.groups):
        inside = np.flatnonzero(problem.groups == number)
        others = problem.basis[problem.groups != number]
        if len(others) < others.shape[1] or np.linalg.matrix_rank(others) < others.shape[1]:
            continue  # the others do not determine a line and the regressors
        precision = made.projected[:, inside[:, None], inside]
        own = projected_y[:, inside]
        error = np.linalg.solve(precision, own[..., None])[..., 0]
        score += 0.5 * (np.linalg.slogdet(precision)[1] - (own * error).sum(axis=1))
        if number not in ends:
            square += (error**2).sum(axis=1)
            count += len(inside)
    return score, square / count if count else np.full(len(score), np.nan)


def restricted_likelihood(problem: Problem, made: Solved) -> FloatArray:
    """Return the logarithm of the restricted likelihood, up to a constant; serves where too few groups can be left out.

    Parameters
    ----------
    problem : Problem
        Values.
    made : Solved
        For G pairs of hyperparameters.

    Returns
    -------
    array, shape (G,)
        Logarithm.
    """
    misfit = np.einsum("n,gnm,m->g", problem.y, made.projected, problem.y)
    log_det: FloatArray = np.linalg.slogdet(made.inverse)[1] + np.linalg.slogdet(made.beta_covariance)[1]
    likelihood: FloatArray = 0.5 * (log_det - misfit)
    return likelihood


def curve_at(problem: Problem, made: Solved, bend: FloatArray, nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the curve at nodes, without the regressors, for each pair of hyperparameters.

    Parameters
    ----------
    problem : Problem
        Values.
    made : Solved
        For G pairs of hyperparameters.
    bend : array, shape (G,)
        q.
    nodes : array, shape (m,)
        Scaled temperature.

    Returns
    -------
    value : array, shape (G, m)
        Mean of f, unit of y.
    covariance : array, shape (G, m, m)
        Of f, unit of y squared.
    """
    bow = parabola(nodes)
    cross = bend[:, None, None] * bending(nodes, problem.x) + problem.bow * np.outer(bow, parabola(problem.x))
    straight = np.zeros((len(nodes), problem.basis.shape[1]))
    straight[:, 0], straight[:, 1] = 1.0, nodes
    weight = cross @ made.inverse
    value = made.beta @ straight.T + np.einsum("gmn,gn->gm", weight, problem.y - made.beta @ problem.basis.T)
    lacking = straight - weight @ problem.basis
    covariance = (
        bend[:, None, None] * bending(nodes, nodes)
        + problem.bow * np.outer(bow, bow)
        - weight @ np.swapaxes(cross, 1, 2)
        + lacking @ made.beta_covariance @ np.swapaxes(lacking, 1, 2)
    )
    return value, covariance
