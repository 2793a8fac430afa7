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
from dataclasses import dataclass, field, replace
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


def geometric_peak(grid: FloatArray, likelihood: FloatArray, best: int) -> float:
    """Return where a parabola through the best point of a geometric grid and its neighbours is highest."""
    if best == len(grid) - 1:
        return float(grid[best])
    left, middle, right = likelihood[best - 1 : best + 2]
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(grid[best] * (grid[best + 1] / grid[best]) ** np.clip(shift, -1.0, 1.0))


# ---- offsets that drift: least squares with a random walk of unknown size
#
# Readings at times t follow X theta + b(t) + n: n white with known standard deviations, b a random walk that is zero in the
# middle t_m of the session and spreads by q sqrt(|t - t_m|) either way:
#
#     V(q) = diag(sigma^2) + q^2 min(|t_i - t_m|, |t_j - t_m|)     t_i, t_j on one side of t_m, else diagonal
#
# One session knows its q to a factor of two or so, and its offset and g-sensitivity depend on it. So no single q is taken: the
# parameters are averaged over all, weighted by L(q), and the covariance is that of the error over every q (Gelman 2006). E0 takes
# every q >= 0 as equally likely beforehand: nothing milder gives intervals that hold where the walk is too small to show. E1 takes
# 1 / (q + q0), with q0 a walk that ends a tenth of one reading's noise off: without drift the error of the offset is then 1.1 times
# the least possible, where E0 makes it 1.3 times.
#
# Sensors of one part walk alike: theirs are q_s = q exp(0.4 z), z ~ N(0, 1) [assumed], but for one in ten, which is a part of its
# own. So each is weighed by what the others say of q too; by itself it was stated 1.15 to 1.5 times as wide as it erred.
#
# A warm-up may be beside the walk, of an amplitude ~ N(0, a^2) at the first reading, fading with a time constant from 10 s to the
# length of the session: V(q) + a^2 f f', f = exp(-(t - t_0) / time constant). None is as likely beforehand as all these together.

_SHORTEST_S, _TIME_CONSTANTS = 10.0, 8
_LARGEST = 1e5  # of a warm-up, in units of the median sigma: V stays invertible
_LEAST_SPARE_EQUATIONS = 4  # with fewer, the average over q has no finite variance
# q sqrt(half the session) in units of the median sigma: steps of a tenth
_SPREAD = np.concatenate(([0.0], np.geomspace(0.02, 1e6, 180)))
_SMALL_WALK = 0.1  # q0, in the same unit
_WEIGHT = np.log(np.gradient(_SPREAD) / (_SPREAD + _SMALL_WALK))
_EVIDENCE = 3.84  # 95 %: chi-square of one degree of freedom
_APART, _UNLIKE = 0.4, 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WalkFit:
    """One sensor's parameters and the random walk of its offset."""

    theta: FloatArray  # (P,)
    covariance: FloatArray  # (P, P)
    walk: float  # most likely q, reading per root second; 0 where it is not significant
    square: float  # r' V^-1 r at the most likely q; E - P is expected
    warm_up: float = 0.0  # probability that the offset settles
    settles_s: float = np.nan  # its time constant, s


def fit_with_walks(
    design: FloatArray, readings: FloatArray, sigma: FloatArray, time: FloatArray | None, warm_up: FloatArray
) -> list[WalkFit]:
    """Fit sensors, sigma and readings (E, S), whose offsets may drift, each by itself, and settle, all together.

    design (E, P), time (E,): no walk without times; warm_up (S,) is a of each sensor: none where all are 0.
    """
    sensors = list(zip(readings.T, sigma.T, warm_up, strict=True))
    if time is None or len(readings) < design.shape[1] + _LEAST_SPARE_EQUATIONS:
        plain = [solutions(design, reading, noise[None]) for reading, noise, _ in sensors]
        return [
            WalkFit(theta=p.theta[0], covariance=p.covariance[0], walk=0.0, square=float(p.square[0])) for p in plain
        ]
    settling, warm = fading(np.column_stack((time, time)), np.ones(len(time)))
    if not warm_up.any() or np.ptp(time) <= 2.0 * _SHORTEST_S:
        settling, warm = settling[:0], warm[:0]
    fits = [[_over_walks(design, *one, time, columns) for columns in (warm[:0, :, 0].T, *warm)] for one in sensors]
    evidence = np.sum([[np.logaddexp.reduce(each.likelihood + _WEIGHT) for each in one] for one in fits], axis=0)
    of_times, units = shares(evidence, settling), [_unit(noise, time) for noise in sigma.T]
    by_likelihood = np.array([[each.likelihood for each in one] for one in fits])
    over = zip(*(_of_one_part(by_likelihood, prior) for prior in (1.0, 1.0 / (_SPREAD + _SMALL_WALK))), strict=True)
    return [_over_warm_ups(one, unit, by, of_times) for one, unit, by in zip(fits, units, over, strict=True)]


def _of_one_part(likelihood: FloatArray, prior: FloatArray | float) -> FloatArray:
    """Return the share of each walk (S, C, T) by log likelihoods of the sensors of one part, which walk alike; prior (T,) of q."""
    likely, before = np.exp(likelihood - likelihood.max(axis=-1, keepdims=True)), _steps(_SPREAD) * prior
    share = likely * before
    if len(share) > 1:
        size, alike = np.log(_SPREAD[1:]), np.zeros((len(_SPREAD), len(_SPREAD)))
        alike[0, 0], alike[1:, 1:] = 1.0, np.exp(-0.5 * ((size - size[:, None]) / _APART) ** 2)
        alike /= alike.sum(axis=1, keepdims=True)
        of_part = np.log(np.maximum(likely @ alike.T, 1e-300))
        others = of_part.sum(axis=0) - of_part
        of_part = before * np.exp(others - others.max(axis=-1, keepdims=True))
        of_part /= of_part.sum(axis=-1, keepdims=True)
        share = likely * (of_part @ alike * (1.0 - _UNLIKE) + _UNLIKE / len(_SPREAD))
    return np.asarray(share / share.sum(axis=-1, keepdims=True))


def _unit(sigma: FloatArray, time: FloatArray) -> float:
    return float(np.median(sigma) / max(0.5 * float(np.ptp(time)), 1e-9) ** 0.5)


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


def _over_walks(
    design: FloatArray, reading: FloatArray, sigma: FloatArray, warm_up: float, time: FloatArray, columns: FloatArray
) -> Solutions:
    """Solve one sensor for every walk, beside a warm-up that adds columns (E, c) of one time constant."""
    away = time - 0.5 * (time.min() + time.max())
    same = np.sign(away)[:, None] == np.sign(away)[None, :]
    shape = np.where(same, np.minimum(np.abs(away)[:, None], np.abs(away)[None, :]), 0.0)
    size = min(warm_up, _LARGEST * float(np.median(sigma)))
    left, singular, _ = np.linalg.svd(size * columns / sigma[:, None], full_matrices=False)
    spread = 1.0 + singular**2
    whitener = np.eye(len(time)) + left * (spread**-0.5 - 1.0) @ left.T
    # V(q) is diagonal in this basis for every q
    gain, basis = np.linalg.eigh(whitener @ (shape * _unit(sigma, time) ** 2 / np.outer(sigma, sigma)) @ whitener)
    root = np.sqrt(1.0 + _SPREAD[:, None] ** 2 * gain.clip(0.0))
    each = solutions(basis.T @ (whitener @ (design / sigma[:, None])), basis.T @ (whitener @ (reading / sigma)), root)
    return replace(each, likelihood=each.likelihood - 0.5 * np.log(spread).sum())


def _over_warm_ups(
    fits: list[Solutions],
    unit: float,
    over: tuple[FloatArray, FloatArray],
    of_times: tuple[FloatArray, float, float],
) -> WalkFit:
    """Average one sensor over walks by E0 and E1 (C, T), then over none and all times of a warm-up, by their ``shares``."""
    share, settles, settles_s = of_times
    each = fits[int(np.argmax(share))]
    best = int(np.argmax(each.likelihood))
    shows = 2.0 * (each.likelihood[best] - each.likelihood[0]) > _EVIDENCE
    likely = float(_SPREAD[best]) if best < 2 else geometric_peak(_SPREAD, each.likelihood, best)
    averages = (mixed(one.theta, one.covariance, *by) for one, *by in zip(fits, *over, strict=True))
    thetas, covariances = zip(*averages, strict=True)
    theta, covariance = mixed(np.array(thetas), np.array(covariances), share)
    return WalkFit(
        theta=theta,
        covariance=covariance,
        walk=unit * likely if shows else 0.0,
        square=float(each.square[best]),
        warm_up=settles,
        settles_s=settles_s,
    )


# ---- groups of parameters that scatter about 0 by an unknown size: the data give size and parameters
#
#     y = X theta + n,  n white of variance 1     theta_g ~ N(0, v_g) for each group g, the others by a precision given
#     maximise over v    2 log p(y | v) = c' theta - log|X'X + P| + log|P|        c = X'y, P = diag(1 / v_g)
#     v_g <- |theta_g|^2 / gamma_g     gamma_g = n_g - tr(C_g) / v_g,  C = (X'X + P)^-1     (MacKay, "Bayesian interpolation", 1992)
#
# A group leaves its least size, 0 for none of it, only where chance makes such a gain of likelihood once in a thousand.

GROUP_SHOWS = 9.55  # of 2 log p: chi-square of one degree of freedom on the boundary, chance 1e-3
_STEPS = 20  # of v, unless it stops before


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Components:
    """Parameters of all groups."""

    theta: FloatArray  # (P,)
    covariance: FloatArray  # (P, P)
    variance: FloatArray  # (G,), v of each group
    likelihood: float  # log p(y | v), to a constant


def fit_components(
    normal: FloatArray,
    moment: FloatArray,
    precision: FloatArray,
    groups: Sequence[IntArray],
    least: FloatArray,
    first: float,
) -> Components:
    """Fit X'X (P, P) and X'y (P,); groups of places start at the variance ``first`` and never go below ``least`` (G,)."""
    chosen: set[int] = set()
    best = _at_sizes(normal, moment, precision, groups, least)
    while len(chosen) < len(groups):
        tries = []
        for number in set(range(len(groups))) - chosen:
            free = [*chosen, number]
            variance = best.variance.copy()
            variance[number] = max(first, least[number])
            tries.append((number, _climbed(normal, moment, precision, groups, (variance, least), free)))
        number, made = max(tries, key=lambda one: one[1].likelihood)
        if 2.0 * (made.likelihood - best.likelihood) < GROUP_SHOWS:
            break
        chosen.add(number)
        best = made
    return best


def _climbed(
    normal: FloatArray,
    moment: FloatArray,
    precision: FloatArray,
    groups: Sequence[IntArray],
    sizes: tuple[FloatArray, FloatArray],
    free: Sequence[int],
) -> Components:
    variance, least = sizes
    fit = _at_sizes(normal, moment, precision, groups, variance)
    for _ in range(_STEPS):
        before = variance.copy()
        for number in free:
            own = groups[number]
            left = len(own) - float(fit.covariance[own, own].sum()) / max(float(fit.variance[number]), 1e-300)
            size = float(fit.theta[own] @ fit.theta[own]) / max(left, 1e-3 * len(own))
            variance[number] = max(size, least[number], 1e-6 * float(fit.variance[number]))
        fit = _at_sizes(normal, moment, precision, groups, variance)
        if (np.abs(variance - before) <= 1e-3 * before).all():
            break
    return fit


def _at_sizes(
    normal: FloatArray, moment: FloatArray, precision: FloatArray, groups: Sequence[IntArray], variance: FloatArray
) -> Components:
    prior, on, logs = precision.copy(), np.ones(len(moment), bool), 0.0
    for own, size in zip(groups, variance, strict=True):
        on[own] = size > 0.0
        if size > 0.0:
            prior[own] = 1.0 / size
            logs -= len(own) * float(np.log(size))
    theta, covariance = np.zeros(len(moment)), np.zeros_like(normal)
    whole = normal[np.ix_(on, on)] + np.diag(prior[on])
    covariance[np.ix_(on, on)] = np.linalg.inv(whole) if on.any() else 0.0
    theta[on] = covariance[np.ix_(on, on)] @ moment[on]
    likelihood = 0.5 * (float(moment @ theta) - float(np.linalg.slogdet(whole)[1]) + logs)
    return Components(theta=theta, covariance=covariance, variance=variance.copy(), likelihood=likelihood)


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
