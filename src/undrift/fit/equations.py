"""Forward and inverse models of three sensors with their covariance, and rows that are not linear in the unknowns.

    s = K a + b + H f            forward, K (3, 3), b (3,), H (3, 3)
    a = M (s - b) - G f          inverse: M = K^-1, G = M H;   dM = -M dK M,   dG = -M dK G + M dH

Parameters are in the order of a model: K row by row, b, H row by row.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.model import G_NAMES, MATRIX_NAMES, OFFSET_NAMES

# ---- order of a model's parameters


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
