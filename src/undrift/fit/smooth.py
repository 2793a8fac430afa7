"""Curves over temperature, with their covariance: through every point, or as stiff as the data allow.

``not_a_knot``   the note's cubic spline through set-point means; linear in the data, so its covariance is B V B'
``fit_smooth``   a smoothing spline (``fit/smooth.py``): how much it bends (q) and how much the values scatter beyond their stated
                 variance (s2) are weighed by leave-out error: how well each group of neighbours is told by the others

One pair (q, s2) is seldom certain. Every pair on a grid gets the weight exp(sum of the log densities of what was left out),
times a wide prior on the bend: that the slope changes by as much as it is over 50 degC, give or take a factor of ten. The same
change laid out evenly, a parabola, is told apart from it, as most drift curves are parabolas first of all. Value and
covariance are those of the mixture, widened by Student's factor for few rows. s2 is the floor under the variance of a cell: a
thousand blocks at the hot end of a warm-up count no more than the scatter between cells lets them.

Curves that bend at random: the algebra behind the smoothing spline.

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

Which stiffness: pairs (q, s2) on a grid, weighed by how well each group of neighbours is told by the others.

The grid is laid twice: over the prior, then about what the first round left. A pair's weight is exp(sum of the log densities of
the values left out) times the prior; where too few groups can be left out the restricted likelihood takes their place.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError, NotObservable

# ---- Curves that bend at random: the algebra behind the smoothing spline.

_JITTER = 1e-11  # of the variance of the values: keeps a curve through exact values solvable


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """One column of values over scaled temperature."""

    x: FloatArray  # (n,), scaled temperature
    y: FloatArray  # (n,), values, any unit
    variance: FloatArray  # (n,), v, that unit squared
    basis: FloatArray  # (n, 2 + p), H: ones, x, and p regressors
    correlation: FloatArray  # (n, n), C
    groups: IntArray  # (n,), rows of one number are left out together
    shared: FloatArray | float = 0.0  # (n, n), known covariance of the rows beside v, that unit squared
    bow: float = 0.0  # Prior variance of g, that unit squared; 0 for no parabola

    def covariance(self, bend: FloatArray, scatter: FloatArray) -> FloatArray:
        """Return K for each pair of hyperparameters.

        Arrays: bend (G,), scatter (G,) -> (G, n, n).
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
    """A problem at G pairs of hyperparameters."""

    inverse: FloatArray  # (G, n, n), K^-1
    projected: FloatArray  # (G, n, n), P
    beta_covariance: FloatArray  # (G, 2 + p, 2 + p), (H' K^-1 H)^-1
    beta: FloatArray  # (G, 2 + p), a, b and c


def bending(one: FloatArray, two: FloatArray) -> FloatArray:
    """Return the covariance of a once integrated Wiener process that runs both ways from 0, where it is flat.

    ``k(s, t) = m^2 (3 M - m) / 6`` with m the lesser and M the greater of |s| and |t|, on one side of 0; zero across it.

    Arrays: one (n,), two (m,) -> (n, m).
    """
    least = np.minimum(np.abs(one)[:, None], np.abs(two)[None, :])
    most = np.maximum(np.abs(one)[:, None], np.abs(two)[None, :])
    same_side = one[:, None] * two[None, :] > 0.0
    return np.where(same_side, least**2 * (3.0 * most - least) / 6.0, 0.0)


def parabola(x: FloatArray) -> FloatArray:
    """Return p: a parabola between the ends of the data, its tangents outside.

    Arrays: x (n,) -> (n,).
    """
    size = np.abs(x)
    inside = np.minimum(size, 0.5)
    p: FloatArray = 4.0 * (inside**2 + size - inside)
    return p


def solved(problem: Problem, bend: FloatArray, scatter: FloatArray) -> Solved:
    """Solve a problem for each pair of hyperparameters.

    Arrays: bend (G,), scatter (G,).
    """
    inverse = np.linalg.inv(problem.covariance(bend, scatter))
    weighted = inverse @ problem.basis
    beta_covariance = np.linalg.inv(np.swapaxes(problem.basis.T @ weighted, 1, 2))
    projected = inverse - weighted @ beta_covariance @ np.swapaxes(weighted, 1, 2)
    beta = np.einsum("gij,gnj,n->gi", beta_covariance, weighted, problem.y)
    return Solved(inverse=inverse, projected=projected, beta_covariance=beta_covariance, beta=beta)


def leave_out(problem: Problem, made: Solved) -> tuple[FloatArray, FloatArray]:
    """Return how well each group is told by the others.

    Arrays:  -> (G,), (G,).
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

    Arrays:  -> (G,).
    """
    misfit = np.einsum("n,gnm,m->g", problem.y, made.projected, problem.y)
    log_det: FloatArray = np.linalg.slogdet(made.inverse)[1] + np.linalg.slogdet(made.beta_covariance)[1]
    likelihood: FloatArray = 0.5 * (log_det - misfit)
    return likelihood


def curve_at(problem: Problem, made: Solved, bend: FloatArray, nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the curve at nodes, without the regressors, for each pair of hyperparameters.

    Arrays: bend (G,), nodes (m,) -> (G, m), (G, m, m).
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


# ---- Which stiffness: pairs (q, s2) on a grid, weighed by how well each group of neighbours is told by the others.

_NEGLIGIBLE = 1e-5  # weight
_LEAST_GROUPS = 5  # fewer groups cannot be left out one by one
_POINTS = 9  # of the grid along each hyperparameter, in each of two rounds


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothSettings:
    """What a curve is taken to be before the data speak."""

    # The slope changes by as much as the mean slope over this span, degC: of the parabola and of the bends beside it.
    # Shorter allows more of both where data are few
    bend_span_c: float = 50.0
    bend_spread: float = 2.3  # Standard deviation of the logarithm of q about that. Larger leaves more to the data
    # Standard deviation of the logarithm of s2 about a stated ``scatter``: hundreds of blocks tell that within a
    # tenth, and the law by which it is carried to hours within a factor of two
    scatter_spread: float = 0.7
    groups: int = 12  # Groups of neighbours that are left out in turn where no groups are given; at most one a point


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weighed:
    """One column: the pairs of hyperparameters that count, and what they make of the p regressors."""

    problem: Problem  # Values, any unit
    bend: FloatArray  # (G,), q, s2 (unit squared) and weight
    scatter: FloatArray  # (G,), q, s2 (unit squared) and weight
    weight: FloatArray  # (G,), q, s2 (unit squared) and weight
    coefficient: FloatArray  # (p,), of the regressors, and standard uncertainty
    uncertainty: FloatArray  # (p,), of the regressors, and standard uncertainty
    leave_out_rms: float  # Unit of the values


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
    """Return the pairs of hyperparameters that count."""
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

    Arrays: value (n,), variance (n,).
    """
    share = span / (8.0 * settings.bend_span_c)
    return share**2 * _size(value, variance)


def widening_of(freedom: float) -> float:
    """Return the factor on a variance that few degrees of freedom ask for."""
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


# ---- smooth

_ENDS = np.array([-0.5, -0.4, 0.4, 0.5])  # scaled temperature: where the slope at either end of the data is taken


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wander:
    """How n rows scatter beyond their stated variance."""

    correlation: FloatArray | None = None  # (n, n), C, of that scatter; None for independent rows
    scatter: FloatArray | None = None  # (k,), what is known of s2 beforehand, unit squared; None where nothing is
    # (k, n, n), known covariance of the rows besides, unit squared: what the rows of one session have in common
    shared: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NodeValues:
    """A curve at nodes."""

    temp_c: FloatArray  # (m,), nodes, degC
    value: FloatArray  # (m, k), k curves, their own unit
    covariance: FloatArray  # (k, m, m), of each curve's nodes, unit squared

    @property
    def uncertainty(self) -> FloatArray:
        """Standard uncertainty of each node, shape (m, k)."""
        variance = np.diagonal(self.covariance, axis1=1, axis2=2).T
        deviation: FloatArray = np.sqrt(np.maximum(variance, 0.0))
        return deviation


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothSpline:
    """A fitted smoothing spline of k columns; evaluate it with ``at``."""

    origin_c: float  # T_0 and span of the scaled temperature, degC
    span_c: float  # T_0 and span of the scaled temperature, degC
    problems: tuple[Problem, ...]  # One a column
    bend: tuple[FloatArray, ...]  # (G,), q, s2 and weight of the pairs that count, one array a column
    scatter: tuple[FloatArray, ...]  # (G,), q, s2 and weight of the pairs that count, one array a column
    weight: tuple[FloatArray, ...]  # (G,), q, s2 and weight of the pairs that count, one array a column
    coefficient: FloatArray  # (p, k), of the regressors, unit of the values per unit of the regressor
    coefficient_uncertainty: FloatArray  # (p, k), standard uncertainty of each
    scatter_deviation: FloatArray  # (k,), root of the mean s2, unit of the values
    # (k,), root-mean-square error of values left out between others, unit of the values; NaN where there are none
    leave_out_rms: FloatArray
    # Factor on variances for few rows: (t / z)^2 with the 97.5 % points of Student's distribution and the normal
    widening: float

    def at(self, temp_c: FloatArray) -> NodeValues:
        """Return the curves at nodes; regressors count as 0 there.

        Arrays: temp_c (m,) degC.
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

    Arrays: temp_c (n,) degC, value (n, k), variance (n, k), nodes (m,) degC.
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

    Arrays: temp_c (n,) degC, value (n, k), variance (n, k), regressors (n, p), groups (n,).
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

    Arrays: temp_c (n,) degC -> (n,).
    """
    rank = np.argsort(np.argsort(temp_c, kind="stable"), kind="stable")
    groups: IntArray = rank * min(count, len(temp_c)) // len(temp_c)
    return groups
