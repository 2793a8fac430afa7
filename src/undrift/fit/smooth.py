"""Curves over temperature, with their covariance: through every point (``not_a_knot``), or as stiff as the data allow.

    y = f(x) + Z c + e     f = a + b x + g p(x) + sqrt(q) * integral of a Wiener process,  cov e = diag(v) + s2 C
    x = (T - T_0) / span, T_0 the middle; p = 4 x^2 between the ends, its tangents outside; v, C known, q and s2 to be found

The mean of f given y is the cubic smoothing spline with stiffness s2 / q; its covariance grows with the cube of the distance
outside the data (Wahba 1978). a, b, c have no prior; g, the bow, a wide one about 0, as drift curves are parabolas first of
all. With K = q k + g2 p p' + cov e, H = (1, x, Z) and P = K^-1 - K^-1 H (H' K^-1 H)^-1 H' K^-1, rows I left out are predicted
with the error P_II^-1 (P y)_I of covariance P_II^-1: no second fit. One pair (q, s2) is seldom certain: every pair on a grid
weighs by the density of what was left out, times a wide prior on the bend; the grid is laid over the prior, then about what the
first round left. Value and covariance are those of the mixture, widened by Student's factor. s2 is the floor under the variance
of a cell with a thousand blocks.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError, NotObservable

_JITTER = 1e-11  # of the variance of the values: keeps a curve through exact values solvable
_NEGLIGIBLE = 1e-5  # weight
_LEAST_GROUPS = 5  # fewer groups cannot be left out one by one
_POINTS = 9  # of the grid along each hyperparameter, in each of two rounds
_ENDS = np.array([-0.5, -0.4, 0.4, 0.5])  # scaled temperature: where the slope at either end of the data is taken


# What a curve is taken to be before the data: its slope changes by as much as the mean slope over this span, degC, for the
# parabola and the random bends, with this standard deviation of the logarithm of q.
_BEND_SPAN_C, _BEND_SPREAD = 50.0, 2.3
_GROUPS = 12  # of neighbours that are left out in turn where no groups are given; at most one a point


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothSettings:
    """What is known of the scatter before the data."""

    # Standard deviation of the logarithm of s2 about a stated one: hundreds of blocks show that within a tenth, and the
    # law by which it is carried to hours within a factor of two
    scatter_spread: float = 0.7


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scatter:
    """How n rows scatter beyond their stated variance."""

    correlation: FloatArray | None = None  # (n, n), C, of that scatter; None for independent rows
    variance: FloatArray | None = None  # (k,), what is known of s2 beforehand, unit squared; None where nothing is
    shared: FloatArray | None = None  # (k, n, n), known covariance, as of rows of one session, unit squared


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """One column of n values over scaled temperature, any unit."""

    x: FloatArray  # (n,), scaled temperature
    y: FloatArray  # (n,)
    variance: FloatArray  # (n,), v
    basis: FloatArray  # (n, 2 + p), H: ones, x, and p regressors
    correlation: FloatArray  # (n, n), C
    groups: IntArray  # (n,), rows of one number are left out together
    shared: FloatArray | float = 0.0  # (n, n), known covariance of the rows
    bow: float = 0.0  # g2, prior variance of g; 0 for no parabola

    def covariance(self, bend: FloatArray, scatter: FloatArray) -> FloatArray:
        """Return K for each pair of hyperparameters, (G,) and (G,) -> (G, n, n)."""
        bow = parabola(self.x)
        own = self.shared + self.bow * np.outer(bow, bow)
        own = own + np.diag(self.variance + _JITTER * max(float(np.var(self.y)), 1e-300))
        rest = scatter[:, None, None] * self.correlation
        return np.asarray(bend[:, None, None] * bending(self.x, self.x) + own + rest)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """A problem at G pairs of hyperparameters."""

    inverse: FloatArray  # (G, n, n), K^-1
    projected: FloatArray  # (G, n, n), P
    beta_covariance: FloatArray  # (G, 2 + p, 2 + p), (H' K^-1 H)^-1
    beta: FloatArray  # (G, 2 + p), a, b and c


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weighed:
    """One column: the pairs of hyperparameters that count, and what they make of the p regressors."""

    problem: Problem
    bend: FloatArray  # (G,), q
    scatter: FloatArray  # (G,), s2
    weight: FloatArray  # (G,)
    coefficient: FloatArray  # (p,), of the regressors
    uncertainty: FloatArray  # (p,), of them
    leave_out_rms: float  # unit of the values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NodeValues:
    """A curve at nodes."""

    temp_c: FloatArray  # (m,), degC
    value: FloatArray  # (m, k), k curves, their own unit
    covariance: FloatArray  # (k, m, m), of each curve's nodes, unit squared

    @property
    def uncertainty(self) -> FloatArray:
        """Standard uncertainty of each node, shape (m, k)."""
        variance = np.diagonal(self.covariance, axis1=1, axis2=2).T
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothSpline:
    """A fitted smoothing spline of k columns; evaluate it with ``at``."""

    origin_c: float  # T_0, degC
    span_c: float  # of the scaled temperature, degC
    columns: tuple[Weighed, ...]
    coefficient: FloatArray  # (p, k), of the regressors, unit of the values per unit of the regressor
    coefficient_uncertainty: FloatArray  # (p, k), standard uncertainty of each
    scatter_deviation: FloatArray  # (k,), root of the mean s2, unit of the values
    leave_out_rms: FloatArray  # (k,), error of values left out between others, unit of the values; NaN without any
    # Factor on variances for few rows: (t / z)^2 with the 97.5 % points of Student's distribution and the normal
    widening: float

    def at(self, temp_c: FloatArray) -> NodeValues:
        """Return the curves at nodes, (m,) degC; regressors count as 0 there."""
        nodes = (np.asarray(temp_c, float) - self.origin_c) / self.span_c
        beyond = 0.5 * np.maximum(np.abs(nodes) - 0.5, 0.0) ** 2
        asked = np.concatenate((nodes, _ENDS))
        values, covariances = [], []
        for column in self.columns:
            mean, both = curve_at(column, asked)
            n = len(nodes)
            slopes = np.diff(mean[n:])[::2] / (_ENDS[1] - _ENDS[0])
            bow = beyond * (slopes[1] - slopes[0])  # the curvature continues outside
            values.append(mean[:n])
            covariances.append(both[:n, :n] + np.outer(bow, bow))
        covariance = self.widening * np.array(covariances)
        return NodeValues(temp_c=np.array(temp_c, float), value=np.stack(values, axis=1), covariance=covariance)


def fit_smooth(
    temp_c: FloatArray,
    value: FloatArray,
    variance: FloatArray,
    *,
    regressors: FloatArray | None = None,
    groups: IntArray | None = None,
    scatter: Scatter = Scatter(),
    settings: SmoothSettings = SmoothSettings(),
) -> SmoothSpline:
    """Fit a smoothing spline to each column, its stiffness weighed by leave-out error.

    Rows: temp_c (n,) degC, value and variance (n, k), regressors (n, p), groups (n,).
    """
    span = float(np.ptp(temp_c)) if len(temp_c) else 0.0
    if span <= 0.0:
        raise NotObservable(
            f"spline: wanted two temperatures or more, got {min(len(temp_c), 1)}; record at another temperature"
        )
    origin = 0.5 * float(temp_c.min() + temp_c.max())
    x = (temp_c - origin) / span
    basis = np.column_stack((np.ones(len(x)), x, *([] if regressors is None else [regressors])))
    if np.linalg.matrix_rank(basis) < basis.shape[1]:
        raise NotObservable(
            f"spline: wanted rows that determine a line and {basis.shape[1] - 2} effects, got {len(x)} rows that do not; "
            "record more temperatures"
        )
    groups = neighbours(temp_c, _GROUPS) if groups is None else groups
    correlation = np.eye(len(x)) if scatter.correlation is None else scatter.correlation
    parts = []
    for column in range(value.shape[1]):
        y, v = value[:, column], variance[:, column]
        problem = Problem(
            x=x,
            y=y,
            variance=v,
            basis=basis,
            correlation=correlation,
            groups=groups,
            shared=0.0 if scatter.shared is None else scatter.shared[column],
            bow=(span / (8.0 * _BEND_SPAN_C)) ** 2 * _size(y, v),
        )
        known = None if scatter.variance is None else float(scatter.variance[column])
        parts.append(weigh(problem, known, span, settings.scatter_spread))
    freedom = 0.0 if scatter.variance is None else 2.0 / settings.scatter_spread**2
    widening = widening_of(max(len(x) - basis.shape[1] - 1, 0) + freedom)
    return SmoothSpline(
        origin_c=origin,
        span_c=span,
        columns=tuple(parts),
        coefficient=np.stack([part.coefficient for part in parts], axis=1),
        coefficient_uncertainty=np.sqrt(widening) * np.stack([part.uncertainty for part in parts], axis=1),
        scatter_deviation=np.array([np.sqrt(part.weight @ part.scatter) for part in parts]),
        leave_out_rms=np.array([part.leave_out_rms for part in parts]),
        widening=widening,
    )


def neighbours(temp_c: FloatArray, count: int) -> IntArray:
    """Return groups of rows that are neighbours in temperature, (n,), about as many rows in each."""
    rank = np.argsort(np.argsort(temp_c, kind="stable"), kind="stable")
    groups: IntArray = rank * min(count, len(temp_c)) // len(temp_c)
    return groups


def not_a_knot(temp_c: FloatArray, value: FloatArray, variance: FloatArray, nodes: FloatArray) -> NodeValues:
    """Return the cubic spline through every point, (n,) and (n, k), with not-a-knot ends, at nodes (m,)."""
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


# ---- which stiffness: pairs (q, s2) on a grid, weighed by leave-out error


def weigh(problem: Problem, known: float | None, span: float, scatter_spread: float) -> Weighed:
    """Return the pairs of hyperparameters that count; known is s2 where something is known of it beforehand."""
    size = _size(problem.y, problem.variance)
    stated = known is not None and known > 0.0
    if known is not None and stated:
        middle, width = float(np.log(known)), scatter_spread
    else:
        middle, width = _scatter_range(problem, size)
    # Logarithms of q and s2; that of s2 is no prior but a range for the grid unless it is stated.
    prior, prior_spread = np.array([np.log(size * span / _BEND_SPAN_C), middle]), np.array([_BEND_SPREAD, width])
    centre, spread, steps = prior, prior_spread, np.linspace(-3.0, 3.0, _POINTS)
    for _ in range(2):
        grid = np.array([g.ravel() for g in np.meshgrid(*(centre[:, None] + spread[:, None] * steps))])
        made = solved(problem, *np.exp(grid))
        off = -0.5 * ((grid - prior[:, None]) / prior_spread[:, None]) ** 2
        score, square = leave_out(problem, made)
        if len(np.unique(problem.groups)) < _LEAST_GROUPS:
            score = restricted_likelihood(problem, made)
        total = score + (off[0] + off[1] if stated else off[0])
        weight = np.exp(total - total.max())
        weight = weight / weight.sum()
        centre = np.array([weight @ g for g in grid])
        own = np.array([np.sqrt(weight @ (g - middle) ** 2) for g, middle in zip(grid, centre, strict=True)])
        spread = np.maximum(own, spread * 3.0 / (_POINTS - 1))  # no finer than its own step resolves
    kept = weight > _NEGLIGIBLE
    weight = weight[kept] / weight[kept].sum()
    beta, covariance = made.beta[kept, 2:], np.diagonal(made.beta_covariance[kept], axis1=1, axis2=2)[:, 2:]
    coefficient = weight @ beta
    return Weighed(
        problem=problem,
        bend=np.exp(grid[0, kept]),
        scatter=np.exp(grid[1, kept]),
        weight=weight,
        coefficient=coefficient,
        uncertainty=np.sqrt(weight @ (covariance + (beta - coefficient) ** 2)),
        leave_out_rms=float(np.sqrt(weight @ square[kept])),
    )


def _scatter_range(problem: Problem, size: float) -> tuple[float, float]:
    """Return middle and spread of the logarithm of s2 where nothing is known of it."""
    left = problem.y - problem.basis @ np.linalg.lstsq(problem.basis, problem.y, rcond=None)[0]
    noise = float(np.median(problem.variance))
    most = max(4.0 * float(np.mean(left**2)), noise, 1e-12 * size)
    least = max(1e-2 * noise, 1e-6 * most)
    return float(0.5 * np.log(most * least)), max(float(0.5 * np.log(most / least)) / 3.0, 0.3)


def widening_of(freedom: float) -> float:
    """Return the factor on a variance for few degrees of freedom."""
    from scipy.stats import norm, t

    return float((t.ppf(0.975, max(freedom, 1.0)) / norm.ppf(0.975)) ** 2)


def _size(value: FloatArray, variance: FloatArray) -> float:
    """Return the square of how far the values range, no less than their noise makes them."""
    return max(float(np.ptp(value)) ** 2, 4.0 * float(np.median(variance)), 1e-300)


# ---- the algebra of curves that bend at random


def bending(one: FloatArray, two: FloatArray) -> FloatArray:
    """Return the covariance of a once integrated Wiener process that runs both ways from 0, where it is flat.

    ``k(s, t) = m^2 (3 M - m) / 6`` with m the lesser and M the greater of |s| and |t|, on one side of 0; zero across it.
    """
    least = np.minimum(np.abs(one)[:, None], np.abs(two)[None, :])
    most = np.maximum(np.abs(one)[:, None], np.abs(two)[None, :])
    same_side = one[:, None] * two[None, :] > 0.0
    return np.where(same_side, least**2 * (3.0 * most - least) / 6.0, 0.0)


def parabola(x: FloatArray) -> FloatArray:
    """Return p: a parabola between the ends of the data, its tangents outside; (n,) -> (n,)."""
    size = np.abs(x)
    inside = np.minimum(size, 0.5)
    return np.asarray(4.0 * (inside**2 + size - inside))


def solved(problem: Problem, bend: FloatArray, scatter: FloatArray) -> Solved:
    """Solve a problem for each pair of hyperparameters q, s2, (G,) each."""
    inverse = np.linalg.inv(problem.covariance(bend, scatter))
    weighted = inverse @ problem.basis
    beta_covariance = np.linalg.inv(np.swapaxes(problem.basis.T @ weighted, 1, 2))
    projected = inverse - weighted @ beta_covariance @ np.swapaxes(weighted, 1, 2)
    beta = np.einsum("gij,gnj,n->gi", beta_covariance, weighted, problem.y)
    return Solved(inverse=inverse, projected=projected, beta_covariance=beta_covariance, beta=beta)


def leave_out(problem: Problem, made: Solved) -> tuple[FloatArray, FloatArray]:
    """Return the log density of groups left out in turn, (G,), and the mean square of what was inside, (G,)."""
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
    """Return the log restricted likelihood, (G,), up to a constant; serves where too few groups can be left out."""
    misfit = np.einsum("n,gnm,m->g", problem.y, made.projected, problem.y)
    log_det = np.linalg.slogdet(made.inverse)[1] + np.linalg.slogdet(made.beta_covariance)[1]
    return np.asarray(0.5 * (log_det - misfit))


def curve_at(column: Weighed, nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mixture's curve at nodes, (m,), and its covariance, (m, m), without the regressors."""
    problem, bend, share = column.problem, column.bend[:, None, None], column.weight
    made = solved(problem, column.bend, column.scatter)
    bow = parabola(nodes)
    cross = bend * bending(nodes, problem.x) + problem.bow * np.outer(bow, parabola(problem.x))
    straight = np.zeros((len(nodes), problem.basis.shape[1]))
    straight[:, 0], straight[:, 1] = 1.0, nodes
    weight = cross @ made.inverse
    value = made.beta @ straight.T + np.einsum("gmn,gn->gm", weight, problem.y - made.beta @ problem.basis.T)
    lacking = straight - weight @ problem.basis
    mean = share @ value
    off = value - mean
    covariance = (
        (share @ column.bend) * bending(nodes, nodes)
        + problem.bow * np.outer(bow, bow)
        - _sum_of_products(share, weight, cross)
        + _sum_of_products(share, lacking @ made.beta_covariance, lacking)
        + (share * off.T) @ off
    )
    return mean, covariance


def _sum_of_products(share: FloatArray, one: FloatArray, two: FloatArray) -> FloatArray:
    """Return the sum of share_g A_g B_g' over g, (m, m), of A and B (G, m, n)."""
    wide = (share[:, None, None] * one).transpose(1, 0, 2).reshape(one.shape[1], -1)
    return np.asarray(wide @ two.transpose(1, 0, 2).reshape(two.shape[1], -1).T)
