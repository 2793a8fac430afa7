"""Curves over temperature, with their covariance: through every point (``not_a_knot``), or as smooth as the data show.

    y_i = f(x_i) + Z_i c + u_i + e_i        f = a + b x + g p(x) + sqrt(q) * integral of a Wiener process
    x = (T - T_0) / span, T_0 the middle of the data;  p = 4 x^2 between the ends of the data, its tangents outside
    u: what one visit to a temperature adds and the next does not, variance s2, correlation C;  e: known covariance

a, b, c have no prior; g, the bow, a wide one about 0, as drift curves are parabolas first of all: its slope changes by as much as
its mean over 10 K. The two sizes that only the rows can show lie, for each column, about a size that all columns share, by a factor
of two: five rows of three axes show together what those of one cannot. The shared sizes have half-t priors (Gelman 2006).
sqrt(s2): one degree of freedom, as he advises for few groups; scale 3.1 times what is expected, which is 0.1 % of the range of the
values and 0.78 times the noise of a row at least. sqrt(q): three; bends by which a curve over 50 K departs from its parabola by
0.247 % of the range, rms. Neither is larger than the residuals about a parabola leave open: larger ones would leave as little in
one of ten fits.

Restricted likelihood (Harville 1977): with A orthonormal, A' (1, x, Z) = 0, the contrasts A'y know nothing of a, b and c. For each
s2, one eigendecomposition makes A' K A = q W^-T diag(l) W^-1 + W^-T W^-1, so that every q costs n products::

    -2 log L = sum log(1 + q l) + sum z^2 / (1 + q l) - 2 log |W|,   z = W' A'y

One pair (q, s2) is seldom certain: mean and covariance are those of the mixture over all pairs, weighted by L times the priors. So
the covariance holds the uncertainty of the hyperparameters; for n contrasts it is wider than at the best pair by about n / (n - 2),
the variance of Student's t. Rows I that are left out are predicted with the error P_II^-1 (P y)_I of covariance P_II^-1, where
P = A (A'KA)^-1 A' at the mean q and s2: no second fit.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError, NotObservable

_JITTER = 1e-11  # of the variance of the values: keeps a curve through exact values solvable
_NOTHING = 1e-12  # rad/s, m/s2 or count: readings that do not change at all
_ENDS = np.array([-0.5, -0.4, 0.4, 0.5])  # scaled temperature: where the slope at either end of the data is taken
_BOW_SPAN_C = 10.0  # of the bow: the slope changes by as much as the mean slope over this span
_BEND_SPAN_C = 50.0
_DEPARTURE = 2.47e-3  # of the range of the values over 50 K: by which a curve usually departs from its parabola
_PER_BEND = 0.0202  # that departure, root-mean-square, for q = 1
_VISITS, _OF_NOISE = 1e-3, 0.78  # of the range, and of the noise of a row: scatter of visits that is expected at least
_USUAL = 3.1  # times what is expected of visits: the scale of their prior
_CHANCE = 0.1  # of residuals about a parabola that are too small by as much as the upper limits allow [assumed]
_BESIDE = 1.29  # times what is expected: visits may add that beside what residuals leave open
_FACTOR = 2.0  # within which the sizes of the columns of one fit usually lie about a common one [assumed]
_LEAST = 0.03  # of what is expected: the least
_LEVELS, _BENDS = 8, 24  # of the grid over s2, in each of two rounds, and over q
_NEGLIGIBLE = 1e-4  # weight
_GROUPS = 12  # of neighbours that are left out in turn where no groups are given; at most one a point


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scatter:
    """How n rows scatter beyond their stated variance."""

    correlation: FloatArray | None = None  # (n, n), C, diagonal 1; None where every row is a visit of its own
    expected: FloatArray | None = None  # (k,), sqrt(s2) as it is expected before the data; None where nothing is known
    shared: FloatArray | None = None  # (k, n, n), known covariance, as of rows of one session, unit squared


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Column:
    """One column of n values, and the pairs of hyperparameters that count: L of s2, each with B of q."""

    x: FloatArray  # (n,), scaled temperature
    y: FloatArray  # (n,)
    basis: FloatArray  # (n, 2 + p), H: ones, x, and p regressors
    known: FloatArray  # (n, n), covariance of e
    correlation: FloatArray  # (n, n), C
    bow: float  # prior variance of g
    bend: FloatArray  # (B,), q
    scatter: FloatArray  # (L,), s2
    weight: FloatArray  # (L, B)
    size: FloatArray  # (L, r), l
    turn: FloatArray  # (L, r, r), W

    @property
    def covariance(self) -> FloatArray:
        """K at the mean of the hyperparameters, (n, n)."""
        q, s2 = self.weight.sum(axis=0) @ self.bend, self.weight.sum(axis=1) @ self.scatter
        bow = parabola(self.x)
        signal = q * bending(self.x, self.x) + self.bow * np.outer(bow, bow)
        return np.asarray(signal + s2 * self.correlation + self.known)


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
    columns: tuple[Column, ...]
    groups: IntArray  # (n,), rows of one number are left out together

    @property
    def coefficient(self) -> FloatArray:
        """Of the regressors, (p, k), unit of the values per unit of the regressor."""
        return np.stack([predicted(column, np.zeros(0), spread=False)[0] for column in self.columns], axis=1)

    @property
    def coefficient_uncertainty(self) -> FloatArray:
        """Standard uncertainty of each coefficient, (p, k)."""
        variances = [np.diag(predicted(column, np.zeros(0))[1]) for column in self.columns]
        return np.asarray(np.sqrt(np.maximum(np.stack(variances, axis=1), 0.0)))

    @property
    def visit_deviation(self) -> FloatArray:
        """Root of the mean s2, (k,): what a visit to come adds, unit of the values."""
        return np.array([np.sqrt(c.weight.sum(axis=1) @ c.scatter) for c in self.columns])

    @property
    def left_out(self) -> FloatArray:
        """Of groups left out, (2, k): rms error between others, unit of the values, and over its deviation (``leave_out``)."""
        return np.array([leave_out(column, self.groups) for column in self.columns]).T

    def at(self, temp_c: FloatArray, *, spread: bool = True) -> NodeValues:
        """Return the curves at nodes, (m,) degC, with their covariance unless unwanted; regressors count as 0 there."""
        nodes, n = (np.asarray(temp_c, float) - self.origin_c) / self.span_c, len(temp_c)
        beyond = 0.5 * np.maximum(np.abs(nodes) - 0.5, 0.0) ** 2
        asked = np.concatenate((nodes, _ENDS))
        values, covariances = [], []
        for column in self.columns:
            mean, both = predicted(column, asked, spread=spread)
            slopes = np.diff(mean[n:])[::2] / (_ENDS[1] - _ENDS[0])
            bow = beyond * (slopes[1] - slopes[0])  # the curvature continues outside
            values.append(mean[:n])
            covariances += [both[:n, :n] + np.outer(bow, bow)] if spread else []
        return NodeValues(
            temp_c=np.array(temp_c, float), value=np.stack(values, axis=1), covariance=np.array(covariances)
        )


def fit_smooth(
    temp_c: FloatArray,
    value: FloatArray,
    variance: FloatArray,
    *,
    regressors: FloatArray | None = None,
    groups: IntArray | None = None,
    scatter: Scatter = Scatter(),
) -> SmoothSpline:
    """Fit a smoothing spline to each column by restricted likelihood.

    Rows: temp_c (n,) degC, value and variance (n, k), regressors (n, p); groups (n,) are left out together.
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
    covariance = np.array([np.diag(each) for each in variance.T]) + (0.0 if scatter.shared is None else scatter.shared)
    expected = np.zeros(value.shape[1]) if scatter.expected is None else scatter.expected
    columns = _weighed(x, value, basis, covariance, correlation, span, expected)
    return SmoothSpline(origin_c=origin, span_c=span, columns=columns, groups=groups)


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


def widening_of(freedom: float) -> float:
    """Return the factor on a variance for few degrees of freedom."""
    from scipy.stats import norm, t

    return float((t.ppf(0.975, max(freedom, 1.0)) / norm.ppf(0.975)) ** 2)


# ---- the random part of a curve


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


# ---- hyperparameters: pairs (q, s2) on a grid, weighted by restricted likelihood and prior


def _weighed(
    x: FloatArray,
    value: FloatArray,
    basis: FloatArray,
    stated: FloatArray,
    correlation: FloatArray,
    span: float,
    expected: FloatArray,
) -> tuple[Column, ...]:
    """Return columns of value (n, k); stated covariance (k, n, n); expected (k,): sqrt(s2) before the data, or 0."""
    noise = np.sqrt(np.median(np.diagonal(stated, axis1=1, axis2=2), axis=1))
    spread = np.ptp(value, axis=0)  # columns of one fit are alike
    size = np.maximum(np.maximum(spread, np.sqrt(np.mean(spread**2))), np.maximum(2.0 * noise, _NOTHING))
    jitter = _JITTER * np.maximum(value.var(axis=0), 0.01 * size**2)
    covariance = stated + jitter[:, None, None] * np.eye(len(x))
    bow = (span / (8.0 * _BOW_SPAN_C) * size) ** 2
    expected = np.maximum(expected, np.maximum(_VISITS * size, _OF_NOISE * noise))
    usual = _DEPARTURE * size * np.sqrt(span / _BEND_SPAN_C) / _PER_BEND
    visits, bends = _left_open(x, value, basis, correlation, noise)
    # in units of what is expected and usual: a grid that all columns share, then one as fine where each has its weight
    level: FloatArray = np.geomspace(_LEAST, _BESIDE + (visits / expected).max(), 2 * _LEVELS)
    root: FloatArray = np.geomspace(_LEAST, 1.0 + (bends / _PER_BEND / usual).max(), _BENDS)
    parts, bowed, columns = contrasts(x, basis), np.outer(parabola(x), parabola(x)), []

    def likely(k: int, levels: FloatArray, roots: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        fixed = covariance[k] + bow[k] * bowed
        return likelihood(
            parts, value[:, k], x, fixed, correlation, (roots * usual[k]) ** 2, (levels * expected[k]) ** 2
        )

    visiting, bent = _half_t(level, _USUAL, 1.0), _half_t(root, 1.0, 3.0)
    log = np.array([likely(k, level, root)[2] for k in range(len(size))])
    of_level = _tied(np.logaddexp.reduce(log + bent, axis=2), level, visiting)
    of_root = _tied(np.logaddexp.reduce(log + visiting[:, None], axis=1), root, bent)
    for k, coarse in enumerate(_weights(log + of_level[:, :, None] + of_root[:, None, :])):
        levels, roots = _finer(level, coarse.sum(axis=1), _LEVELS), _finer(root, coarse.sum(axis=0), _BENDS)
        eigen, turn, log_k = likely(k, levels, roots)
        prior = np.interp(np.log(levels), np.log(level), of_level[k])[:, None]
        weight = _weights((log_k + prior + np.interp(np.log(roots), np.log(root), of_root[k]))[None])[0]
        counts = weight.sum(axis=1) > _NEGLIGIBLE
        columns.append(
            Column(
                x=x,
                y=value[:, k],
                basis=basis,
                known=covariance[k],
                correlation=correlation,
                bow=float(bow[k]),
                bend=(roots * usual[k]) ** 2,
                scatter=(levels[counts] * expected[k]) ** 2,
                weight=weight[counts] / weight[counts].sum(),
                size=eigen[counts],
                turn=turn[counts],
            )
        )
    return tuple(columns)


def _left_open(
    x: FloatArray, value: FloatArray, basis: FloatArray, correlation: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return sqrt(s2) of visits and the rms of bends, (k,), that residuals about a parabola fall short of by chance _CHANCE."""
    from scipy.special import chdtri

    bent = np.column_stack((basis, parabola(x)))
    left = value - bent @ np.linalg.lstsq(bent, value, rcond=None)[0]
    square, freedom = (left**2).sum(axis=0), max(left.size - bent.shape[1] * left.shape[1], left.shape[1])
    most = square * left.shape[1] / float(chdtri(freedom, 1.0 - _CHANCE))
    # rows of one visit, which share u, show it by the mean of their residuals
    shown = np.maximum(np.einsum("ik,ij,jk->k", left, correlation, left), 0.0) * len(x)
    shown /= np.maximum(square, 1e-300) * (correlation**2).sum()
    return np.sqrt(np.maximum(most * shown - noise**2, 0.0)), np.sqrt(np.maximum(most - noise**2, 0.0))


def _tied(log: FloatArray, size: FloatArray, prior: FloatArray) -> FloatArray:
    """Return the log prior of sizes (m,) of each column by what the others show; log (k, m): likelihood of each by its own size.

    Sizes of columns lie about a common one by a factor of two, Student's t of three degrees of freedom; that has the prior (m,).
    """
    apart = np.log(size[:, None] / size) / np.log(_FACTOR)
    tie = -2.0 * np.log1p(apart**2 / 3.0)
    tie -= np.logaddexp.reduce(tie, axis=1, keepdims=True)  # (common, own)
    shown = np.logaddexp.reduce(tie + log[:, None, :], axis=2)
    others = prior + shown.sum(axis=0) - shown
    return np.asarray(np.logaddexp.reduce(tie.T + others[:, None, :], axis=2))


def _weights(log: FloatArray) -> FloatArray:
    """Return weights, (k, L, B), each of sum 1, from their logarithms."""
    weight = np.exp(log - log.max(axis=(1, 2), keepdims=True))
    return np.asarray(weight / weight.sum(axis=(1, 2), keepdims=True))


def _half_t(root: FloatArray, scale: float, freedom: float) -> FloatArray:
    """Return the logarithm of the half-t density, of log(root)."""
    return np.asarray(np.log(root) - 0.5 * (freedom + 1.0) * np.log1p((root / scale) ** 2 / freedom))


def _finer(root: FloatArray, weight: FloatArray, count: int) -> FloatArray:
    """Return a grid of so many over the values that count, weight of sum 1."""
    log = np.log(root)
    inside = np.flatnonzero(np.cumsum(weight) > 1e-3)[0], np.flatnonzero(np.cumsum(weight[::-1]) > 1e-3)[0]
    low, high = max(inside[0] - 1, 0), min(len(log) - inside[1], len(log) - 1)
    return np.asarray(np.exp(np.linspace(log[low], log[high], count)))


def contrasts(x: FloatArray, basis: FloatArray) -> FloatArray:
    """Return A, (n, n - 2 - p)."""
    return np.asarray(np.linalg.qr(basis, mode="complete")[0][:, basis.shape[1] :])


def likelihood(
    a: FloatArray,
    y: FloatArray,
    x: FloatArray,
    fixed: FloatArray,
    correlation: FloatArray,
    bend: FloatArray,
    scatter: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return l (L, r), W (L, r, r), and the log restricted likelihood, (L, B), up to a constant.

    fixed (n, n): the covariance that depends on neither q nor s2.
    """
    rest = a.T @ fixed @ a + scatter[:, None, None] * (a.T @ correlation @ a)
    factor = np.linalg.inv(np.linalg.cholesky(rest))
    size, turn = np.linalg.eigh(factor @ (a.T @ bending(x, x) @ a) @ factor.swapaxes(1, 2))
    size, turn = np.maximum(size, 0.0), factor.swapaxes(1, 2) @ turn
    log = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    spread = 1.0 + bend[:, None] * size[:, None, :]
    z = (a.T @ y @ turn)[:, None, :]
    return size, turn, np.asarray(log[:, None] - 0.5 * (np.log(spread) + z**2 / spread).sum(axis=2))


# ---- the mixture


def predicted(column: Column, nodes: FloatArray, *, spread: bool = True) -> tuple[FloatArray, FloatArray]:
    """Return the curve at nodes, (m,), with its covariance, (m, m), if wanted; without nodes the p coefficients, with theirs.

    f at the nodes less B y, B = H_nodes H^+, has no trend either: it is predicted from the contrasts alone.
    """
    x, n, p = column.x, len(nodes), column.basis.shape[1]
    a, at_rows = contrasts(x, column.basis), parabola(x)
    if n:
        straight = np.column_stack((np.ones(n), nodes, np.zeros((n, p - 2))))
        at_nodes, cross, gram = parabola(nodes), bending(nodes, x), bending(nodes, nodes)
    else:
        n = p - 2
        straight, at_nodes, cross, gram = np.eye(p)[2:], np.zeros(n), np.zeros((n, len(x))), np.zeros((n, n))
    by_trend = straight @ np.linalg.pinv(column.basis)
    rows, bow = bending(x, x), column.bow
    fixed = column.known + bow * np.outer(at_rows, at_rows)
    size, w = column.size, column.turn
    z = a.T @ column.y @ w
    of_bends = (cross - by_trend @ rows) @ a @ w  # (L, m, r)
    of_rest = bow * np.outer(at_nodes, at_rows) - by_trend @ fixed
    of_rest = (of_rest - column.scatter[:, None, None] * (by_trend @ column.correlation)) @ a @ w
    q, weight = column.bend[:, None], column.weight
    filtered = 1.0 / (1.0 + q * size[:, None, :])  # (L, B, r)
    values = (filtered * z[:, None]) @ of_rest.swapaxes(1, 2) + (filtered * q * z[:, None]) @ of_bends.swapaxes(1, 2)
    values = values.reshape(weight.size, n)
    mean = weight.ravel() @ values
    if not spread:
        return by_trend @ column.y + mean, np.zeros((0, 0))
    apart = np.sqrt(weight).reshape(-1, 1) * (values - mean)
    none, once, twice = (np.einsum("lb,lbr->lr", weight * column.bend**power, filtered) for power in range(3))
    q_mean, s2_mean = column.weight.sum(axis=0) @ column.bend, column.weight.sum(axis=1) @ column.scatter
    tied = by_trend @ (q_mean * rows + fixed + s2_mean * column.correlation) @ by_trend.T
    crossed = (q_mean * cross + bow * np.outer(at_nodes, at_rows)) @ by_trend.T
    covariance = q_mean * gram + bow * np.outer(at_nodes, at_nodes) + tied - crossed - crossed.T + apart.T @ apart
    both = _sum_of_products(of_rest * once[:, None], of_bends)
    covariance -= _sum_of_products(of_rest * none[:, None], of_rest) + both + both.T
    covariance -= _sum_of_products(of_bends * twice[:, None], of_bends)
    return by_trend @ column.y + mean, np.asarray(covariance)


def _sum_of_products(one: FloatArray, two: FloatArray) -> FloatArray:
    """Return the sum of A_l B_l' over l, (m, m), of A and B (L, m, r)."""
    m = one.shape[1]
    wide = (m, one.shape[0] * one.shape[2])
    return np.asarray(one.transpose(1, 0, 2).reshape(wide) @ two.transpose(1, 0, 2).reshape(wide).T)


def leave_out(column: Column, groups: IntArray) -> tuple[float, float]:
    """Return the rms error of groups left out between others, and the rms of the errors of all groups' means over their deviations.

    NaN where no group can be left out: the others do not determine a line and the regressors.
    """
    a = contrasts(column.x, column.basis)
    p = a @ np.linalg.solve(a.T @ column.covariance @ a, a.T)
    ends = groups[[np.argmin(column.x), np.argmax(column.x)]]
    between, scaled = list[float](), list[float]()
    for number in np.unique(groups):
        inside = np.flatnonzero(groups == number)
        others = column.basis[groups != number]
        if len(others) < others.shape[1] or np.linalg.matrix_rank(others) < others.shape[1]:
            continue
        stated = np.linalg.inv(p[np.ix_(inside, inside)])
        error = stated @ p[inside] @ column.y
        scaled.append(float(error.mean() ** 2 / stated.mean()))
        between += [] if number in ends else (error**2).tolist()
    nothing = float("nan")
    return tuple(float(np.sqrt(np.mean(each))) if each else nothing for each in (between, scaled))  # type: ignore[return-value]


# ---- curves of fixed stiffness: the basis that fits share


@dataclass(frozen=True, slots=True, kw_only=True)
class Cubics:
    """Cubic B-splines on even knots."""

    low: float
    high: float
    intervals: int  # between the knots

    @property
    def knots(self) -> FloatArray:
        """Knots in units of the span, ends four-fold, shape (intervals + 7,)."""
        return np.concatenate((np.zeros(3), np.linspace(0.0, 1.0, self.intervals + 1), np.ones(3)))

    def at(self, x: FloatArray) -> FloatArray:
        """Return the splines at points, (n,) -> (n, intervals + 3)."""
        from scipy.interpolate import BSpline

        z = np.clip((x - self.low) / (self.high - self.low), 0.0, 1.0)
        return np.asarray(BSpline.design_matrix(z, self.knots, 3).toarray())

    def products(self, derivative: int) -> FloatArray:
        """Return the integrals over the span of the products of all pairs, or of their derivatives."""
        from scipy.interpolate import BSpline

        at, weight = np.polynomial.legendre.leggauss(4)
        step = 1.0 / self.intervals
        z = (np.arange(self.intervals)[:, None] * step + 0.5 * step * (at + 1.0)).ravel()
        y: FloatArray = np.asarray(BSpline(self.knots, np.eye(self.intervals + 3), 3)(z, nu=derivative))
        return np.asarray(y.T @ (y * np.tile(0.5 * step * weight, self.intervals)[:, None]))
