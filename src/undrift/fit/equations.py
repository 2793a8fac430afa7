"""Equations of three sensors: blocks of unknowns, rows, and named sources of uncertainty; solved, carried and budgeted here.

Sensor i = x, y, z has E rows of one design X, in blocks: K_i (matrix), b_i (offset), and H_i (g) where a g-sensitivity is fitted::

    y_i = X theta_i + errors         V_i = sum over sources of S_i,   each S_i (E, E)
    theta_i = G_i y_i                G_i = (X' V_i^-1 X)^-1 X' V_i^-1
    cov(theta_i, theta_k)            G_i S_i G_i' for i = k of a source by which each sensor errs on its own;
                                     G_i c_i c_k' G_k' of one that the sensors share, c_i (E, c) one standard deviation each

Corrected values come from the inverse model, a = M (s - b) - G f:

    M = K^-1, G = M H        dM = -M dK M        dG = -M dK G + M dH

Sources whose size is not known make a family V(t): it is solved on a grid of t, and averaged by restricted likelihood.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.model import G_NAMES, MATRIX_NAMES, OFFSET_NAMES, Budget

# ---- rows of three sensors, and what is known of their errors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Equations:
    """Readings of three sensors, what multiplies their unknowns, and the sources of their errors."""

    unknowns: Mapping[str, FloatArray]  # Columns (E, 3) of "matrix", (E, 1) of "offset", (E, 3) of "g", in this order
    reading: FloatArray  # (E, 3)
    # By name of a budget's line: (3, E, E), covariance of the rows of each sensor, which errs on its own
    own: Mapping[str, FloatArray]
    # (3, E, c): errors of one standard deviation each that the sensors share
    shared: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def design(self) -> FloatArray:
        """X, shape (E, P)."""
        return np.hstack([*self.unknowns.values()])

    @property
    def covariance(self) -> FloatArray:
        """V_i, shape (3, E, E)."""
        total = np.zeros((3, len(self.reading), len(self.reading)))
        for part in self.own.values():
            total += part
        for columns in self.shared.values():
            total += columns @ columns.transpose(0, 2, 1)
        return total

    def square(self, residuals: FloatArray) -> float:
        """Return r' V^-1 r of residuals (E, 3), all sensors together."""
        each = residuals.T[:, :, None]
        return float((each * np.linalg.solve(self.covariance, each)).sum())

    def gains(self, covariance: FloatArray | None = None) -> FloatArray:
        """Return G_i (3, P, E), by the covariance of all sources or by another one."""
        design = self.design
        weighed = np.linalg.solve(self.covariance if covariance is None else covariance, design)
        return np.linalg.solve(design.T @ weighed, weighed.transpose(0, 2, 1))

    def shares(self, gains: FloatArray) -> dict[str, FloatArray]:
        """Return the covariance of the unknowns by source, (3 P, 3 P) each, in the order of a model's parameters."""
        parts = {name: carried_own(gains, part) for name, part in self.own.items()}
        for name, columns in self.shared.items():
            parts[name] = parts.get(name, 0.0) + carried_shared(gains, columns)
        return parts

    def carried(self, gains: FloatArray, more: FloatArray | float = 0.0) -> FloatArray:
        """Return the covariance of the unknowns by all sources, and by more covariance (3, E, E) of each sensor on its own."""
        own = carried_own(gains, np.asarray(more + sum(self.own.values())))
        return own + sum(carried_shared(gains, columns) for columns in self.shared.values())

    def budget(
        self,
        inverse: "Inverse",
        covariance: FloatArray,
        rest: str,
        *,
        gains: FloatArray | None = None,
        more: Sequence[tuple[str, FloatArray]] = (),
    ) -> Budget:
        """Return the budget of an inverse model's covariance: all sources, ``more`` covariances by name, and the rest."""
        parts = self.shares(self.gains() if gains is None else gains)
        variances = {name: np.diag(inverse.carried(part)) for name, part in parts.items()}
        for name, part in more:
            variances[name] = variances.get(name, 0.0) + np.diag(part)
        return Budget.of(covariance, variances, rest)


def diagonal(variance: FloatArray) -> FloatArray:
    """Return the covariances (3, E, E) of rows that err one by one: variance (E, 3)."""
    return np.stack([np.diag(column) for column in variance.T])


def parameter_order(count: int) -> IntArray:
    """Return the places of a model's parameters, K row by row, b, H row by row, among three sensors' unknowns (K_i, b_i, H_i)."""
    places = np.arange(3 * count).reshape(3, count)
    return np.concatenate((places[:, :3].ravel(), places[:, 3], places[:, 4:].ravel()))


def joined(covariances: Sequence[FloatArray] | FloatArray) -> FloatArray:
    """Return the covariance (.., 3 P, 3 P), in the order of a model, of three sensors whose unknowns (.., P, P) err apart."""
    *many, count, _ = covariances[0].shape
    total, order = np.zeros((*many, 3 * count, 3 * count)), parameter_order(count)
    for k, part in enumerate(covariances):
        total[..., k * count : (k + 1) * count, k * count : (k + 1) * count] = part
    return np.asarray(total[..., order[:, None], order])


def carried_own(gains: FloatArray, own: FloatArray) -> FloatArray:
    """Return the covariance (3 P, 3 P), in the order of a model, by which each sensor errs on its own: G (3, P, E), S (3, E, E)."""
    return joined(gains @ own @ gains.transpose(0, 2, 1))


def moved_by(gains: FloatArray, columns: FloatArray) -> FloatArray:
    """Return how errors c (3, E, c) of the rows move the unknowns, (3 P, c), in the order of a model."""
    return np.asarray((gains @ columns).reshape(-1, columns.shape[2])[parameter_order(gains.shape[1])])


def carried_shared(gains: FloatArray, columns: FloatArray) -> FloatArray:
    """Return the same covariance of errors that the sensors share: c (3, E, c)."""
    moved = moved_by(gains, columns)
    return np.asarray(moved @ moved.T)


# ---- from the forward model to the one that corrects


def inverse_jacobian(matrix: FloatArray) -> FloatArray:
    """Return d vec(M) / d vec(K) (9, 9) for M = K^-1, both stacked row by row."""
    return -np.kron(matrix, matrix.T)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inverse:
    """The model that corrects readings, of a forward one."""

    matrix: FloatArray  # (3, 3), M
    offset: FloatArray  # (3,), b
    g_sensitivity: FloatArray | None  # (3, 3), G; None where it was not fitted
    jacobian: FloatArray  # (3 P, 3 P), d (M, b, G) / d (K, b, H)

    @classmethod
    def of(cls, theta: FloatArray) -> "Inverse":
        """Return the inverse of three sensors' unknowns (3, P): K_i, b_i, and H_i where P is 7."""
        matrix, jacobian, g = np.linalg.inv(theta[:, :3]), np.eye(theta.size), None
        jacobian[:9, :9] = inverse_jacobian(matrix)
        if theta.shape[1] > 4:
            g = matrix @ theta[:, 4:]
            jacobian[12:, :9] = -np.kron(matrix, g.T)
            jacobian[12:, 12:] = np.kron(matrix, np.eye(3))
        return cls(matrix=matrix, offset=theta[:, 3], g_sensitivity=g, jacobian=jacobian)

    @property
    def forward(self) -> FloatArray:
        """The three sensors' unknowns, (3, P)."""
        k = np.linalg.inv(self.matrix)
        h = () if self.g_sensitivity is None else (k @ self.g_sensitivity,)
        return np.column_stack((k, self.offset, *h))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of ``jacobian``."""
        return (*MATRIX_NAMES, *OFFSET_NAMES, *(() if self.g_sensitivity is None else G_NAMES))

    def carried(self, covariance: FloatArray) -> FloatArray:
        """Return the covariance of M, b and G from that of K, b and H."""
        return np.asarray(self.jacobian @ covariance @ self.jacobian.T)


def offset_of(matrix: FloatArray, constant: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return o of M (u - o) = M u - c, and d (M, o, ..) / d (M, c, ..), (P, P): do = M^-1 dc - M^-1 dM o."""
    inverse, jacobian = np.linalg.inv(matrix), np.eye(count)
    offset = inverse @ constant
    jacobian[9:12, 9:12], jacobian[9:12, :9] = inverse, -np.kron(inverse, offset)
    return offset, jacobian


# ---- a family of covariances: each solved, with its restricted likelihood, and averaged
#
#     log L(t) = -1/2 [ log det V + log det X' V^-1 X + r' V^-1 r ]          (Harville 1977)
#     theta = E1 theta(t)        covariance = E0 C(t) + E0 (theta(t) - theta)(theta(t) - theta)'
#
# E0 and E1 weigh t by L over priors of their own.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solutions:
    """One sensor's unknowns for each of T covariances."""

    theta: FloatArray  # (T, P)
    covariance: FloatArray  # (T, P, P)
    weighed: FloatArray  # (T, P, E), X' V^-1 of columns over their ``length``
    length: FloatArray  # (P,)
    square: FloatArray  # (T,), r' V^-1 r
    likelihood: FloatArray  # (T,), log L to a constant

    @property
    def gain(self) -> FloatArray:
        """G, shape (T, P, E)."""
        return self.covariance @ (self.weighed * self.length[:, None])


def solutions(design: FloatArray, reading: FloatArray, root: FloatArray) -> Solutions:
    """Solve design (E, P) and reading (E,) for T covariances: standard deviations (T, E), or Cholesky factors (T, E, E)."""
    one_by_one, white = root.ndim == 2, whitened(root[0], design)
    length = np.linalg.norm(white, axis=0)
    # What the first covariance leaves of the readings is small, and so is rounding in the normal equations of all
    start = np.linalg.lstsq(white / length, whitened(root[0], reading), rcond=None)[0]
    x = design / length
    rest = reading - x @ start
    if one_by_one:
        weight = 1.0 / root**2
        weighed, moment = weight[:, None] * x.T, (weight * rest) @ x
    else:
        weighed = np.linalg.solve(root.transpose(0, 2, 1), np.linalg.solve(root, x)).transpose(0, 2, 1)
        moment = weighed @ rest
    normal = weighed @ x
    inverse = np.linalg.inv(normal)
    step = (inverse @ moment[:, :, None])[:, :, 0]
    away = rest - step @ x.T
    if one_by_one:
        square, scale = (weight * away**2).sum(axis=1), np.log(root).sum(axis=1)
    else:
        square = (np.linalg.solve(root, away[:, :, None]) ** 2).sum(axis=(1, 2))
        scale = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    return Solutions(
        theta=(start + step) / length,
        covariance=inverse / np.outer(length, length),
        weighed=weighed,
        length=length,
        square=square,
        likelihood=-scale - 0.5 * (np.linalg.slogdet(normal)[1] + square),
    )


def roots(sigma: FloatArray, in_common: FloatArray) -> FloatArray:
    """Return what ``solutions`` takes: noise sigma (E,) or (T, E), and the covariance (E, E) of what rows have in common."""
    each = np.atleast_2d(sigma)
    if not in_common.any():
        return each
    return np.linalg.cholesky(each[:, :, None] ** 2 * np.eye(len(in_common)) + in_common)


def whitened(root: FloatArray, rows: FloatArray) -> FloatArray:
    """Return rows (E,) or (E, P) in standard deviations, by one of the ``roots``: (E,) or (E, E)."""
    return np.linalg.solve(root, rows) if root.ndim == 2 else np.asarray((rows.T / root).T)


def averaged(
    grid: FloatArray,
    likelihood: FloatArray,
    thetas: FloatArray,
    covariances: FloatArray,
    over: tuple[FloatArray | float, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Return theta and covariance averaged over a grid (T,): E0 weighs by the likelihood over the first of two, E1 the second."""
    by_likelihood = np.exp(likelihood - likelihood.max()) * _steps(grid)
    share, likely = (part / part.sum() for part in (by_likelihood / over[0], by_likelihood / over[1]))
    return mixed(thetas, covariances, share, likely)


def _steps(grid: FloatArray) -> FloatArray:
    step = np.gradient(grid)
    step[[0, -1]] *= 0.5  # trapezoids
    return np.asarray(step)


def mixed(
    thetas: FloatArray, covariances: FloatArray, share: FloatArray, likely: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the mean of T alternatives by ``likely`` (``share`` if None), and the second moment about it by their share (T,)."""
    theta = (share if likely is None else likely) @ thetas
    apart = thetas - theta
    return theta, np.einsum("t,tij->ij", share, covariances) + (share[:, None] * apart).T @ apart


# ---- offsets that settle after the power is switched on

_SHORTEST_S, _TIME_CONSTANTS = 10.0, 8


def fading(span: FloatArray, extent: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return time constants (T,), s, and what a warm-up adds to the rows (T, E, 2): exp(-t / time constant), and its deviation
    for time constants between two of these."""
    start, stop = (span - span.min()).T
    times = np.geomspace(_SHORTEST_S, max(2.0 * _SHORTEST_S, float(stop.max())), 2 * _TIME_CONSTANTS + 1)[:, None]
    part = np.maximum(stop - start, 1e-3) / times
    mean = extent * np.exp(-start / times) * -np.expm1(-part) / part
    return times[1::2, 0], np.stack((mean[1::2], (mean[2::2] - mean[:-1:2]) / 12.0**0.5), axis=-1)


def shares(evidence: FloatArray, times: FloatArray) -> tuple[FloatArray, float, float]:
    """Return shares of no warm-up and of each time constant (T,), s, by log evidence (1 + T,); that of all, and their mean."""
    share = np.exp(evidence - evidence.max())
    share[1:] /= max(1, len(times))
    share /= share.sum()
    settles = float(share[1:].sum())
    return share, settles, float(share[1:] @ times) / max(settles, 1e-300)


# ---- rows that are not linear in the unknowns: Levenberg and Marquardt's steps of fixed weights, priors as rows among the others


_MOST_DAMPING = 1e6  # no step makes the rows better: rounding


class Rows(NamedTuple):
    """Rows r at some p, in standard deviations, with J = dr/dp."""

    residual: FloatArray  # (E,)
    design: FloatArray  # (E, P)
    state: Any = None  # What else was computed at p

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.residual @ self.residual)

    def known(self, prior: FloatArray, p: FloatArray) -> "Rows":
        """Return them with the rows of a prior, (R, P): combinations of p that are 0 +- 1."""
        if not len(prior):
            return self
        return Rows(np.concatenate((self.residual, prior @ p)), np.vstack((self.design, prior)), self.state)


def descend(
    rows: Callable[[FloatArray], Rows],
    start: FloatArray,
    prior: FloatArray,
    *,
    first: Rows | None = None,
    tolerance: float,
    size: FloatArray,
    farthest: float = np.inf,
    steps: int = 60,
) -> tuple[FloatArray, Rows, bool]:
    """Return the minimum (P,), the rows there with those of the prior, and whether there is one; else the start again.

    A step below the tolerance ends the search, in units of ``size`` (P,) like the farthest place where a minimum may lie.
    """
    p, damping = start, 1e-9
    best = begun = (rows(start) if first is None else first).known(prior, start)
    for _ in range(steps):
        length = np.linalg.norm(best.design, axis=0)
        length[length == 0.0] = 1.0
        scaled = best.design / length
        normal = scaled.T @ scaled
        normal.flat[:: len(p) + 1] += damping
        step = -np.linalg.solve(normal, scaled.T @ best.residual) / length
        if float(np.abs(step / size).max()) < tolerance or damping > _MOST_DAMPING:
            return p, best, True
        trial = rows(p + step).known(prior, p + step)
        if trial.cost <= best.cost:
            p, best, damping = p + step, trial, max(0.1 * damping, 1e-12)
        else:
            damping = max(10.0 * damping, 1e-6)
        if farthest < np.inf and float(np.abs(p / size).max()) > farthest:
            break
    return start, begun, False


def covariance_of(design: FloatArray) -> FloatArray:
    """Return (J' J)^-1 (P, P) of rows in standard deviations, by singular values; NaN where these are short of rank."""
    size = np.linalg.norm(design, axis=0)
    _, singular, right = np.linalg.svd(design / np.where(size > 0.0, size, 1.0), full_matrices=False)
    if len(singular) < design.shape[1] or len(design) < design.shape[1] or singular[-1] < 1e-9 * singular[0]:
        return np.full((design.shape[1], design.shape[1]), np.nan)
    root = right.T / singular / size[:, None]
    return np.asarray(root @ root.T)
