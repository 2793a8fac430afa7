"""Solve |M (u - o)| = g for an upper triangular M: the numbers behind the multi-position fit, without judgement.

Scaled so that every parameter is near one or of the size of g::

    v = k (u - c)          c, k from the sphere through the readings
    |M' (v - o')| = g      M = k M',  o = c + o' / k

Levenberg-Marquardt on the normal equations with analytic Jacobian: with n the direction of M' (v - o'),
dr/dm'_ij = n_i (v - o')_j and dr/do' = -M'^T n. Each pose weighs by the variance of its length,
n^T M S_k M^T n + s2, S_k the variances of the mean and s2 the excess of :mod:`undrift.calibration.fit.excess`: the profile
likelihood over unknown directions.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.fit.excess import excess_variance
from undrift.calibration.fit.result import scaled_condition
from undrift.calibration.model import AXES
from undrift.errors import PoorFit

ROW, COLUMN = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2])  # of the six elements, in the order of p
NAMES = (*(f"m_{AXES[i]}{AXES[j]}" for i, j in zip(ROW, COLUMN, strict=True)), *(f"offset_{axis}" for axis in AXES))
WEAKEST = 0.02  # rms change of length, in g, per unit of a parameter that still counts as seen; random poses show 0.25
_START = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NormFit:
    """Scaled solution of the norm equations.

    Parameters
    ----------
    center : array, shape (3,)
        c, raw unit.
    scale : float
        k, m/s2 per raw unit.
    p : array, shape (9,)
        m'_xx m'_xy m'_xz m'_yy m'_yz m'_zz (1), o'_x o'_y o'_z (m/s2).
    covariance : array, shape (9, 9)
        Of p; zeros where held, NaN where the equations are singular.
    residuals : array, shape (K,)
        Length less gravity, m/s2.
    excess : float
        Standard deviation that the poses show beyond their stated noise, m/s2.
    condition : float
        Condition number of the design, columns scaled to one.
    weakest : float
        Least rms change of length, in g, that one unit of any combination of parameters makes (1, and g for offsets).
    unseen : tuple of str
        The parameters that take part in that weakest combination.
    gravity : float
        m/s2.
    """

    center: FloatArray
    scale: float
    p: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    excess: float
    condition: float
    weakest: float
    unseen: tuple[str, ...]
    gravity: float

    @property
    def matrix(self) -> FloatArray:
        """M, m/s2 per raw unit, shape (3, 3)."""
        return self.scale * _upper(self.p)

    @property
    def offset(self) -> FloatArray:
        """o, raw unit, shape (3,)."""
        offset: FloatArray = self.center + self.p[6:] / self.scale
        return offset

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty of a corrected reading of gravity, root mean square over all directions, m/s2."""
        variance = np.diag(self.covariance)
        total = float(self.gravity**2 / 3.0 * variance[:6].sum() + variance[6:].sum())
        return float(np.sqrt(total)) if np.isfinite(total) else np.inf

    def corrected(self, reading: FloatArray) -> FloatArray:
        """Return readings in m/s2.

        Parameters
        ----------
        reading : array, shape (K, 3)
            Raw unit.

        Returns
        -------
        array, shape (K, 3)
            M (u - o), m/s2.
        """
        a: FloatArray = (reading - self.offset) @ self.matrix.T
        return a


def fit_norm(
    reading: FloatArray, *, gravity: float, variances: FloatArray | None = None, cross_axis: bool = True
) -> NormFit:
    """Solve the norm equations from the sphere through the readings; weights and excess are renewed until they settle.

    Parameters
    ----------
    reading : array, shape (K, 3)
        Readings at rest, raw unit, no gaps; not all equal.
    gravity : float
        m/s2.
    variances : array, shape (K, 3), optional
        Variance of each reading, raw unit squared; None gives every equation the same weight, from the residuals.
    cross_axis : bool
        False holds the off-diagonal elements at zero.

    Returns
    -------
    NormFit
        Solution in scaled parameters.

    Raises
    ------
    PoorFit
        No solution was found.
    """
    center, scale = _sphere(reading, gravity)
    v = np.ascontiguousarray(scale * (reading - center))
    stated_raw = np.zeros_like(v) if variances is None else variances * scale**2
    free = np.arange(9) if cross_axis else np.array([0, 3, 5, 6, 7, 8])
    found, p, variance, excess = True, _START, np.ones(len(v)), 0.0
    for _ in range(1 if variances is None else 6):
        before = p
        p, found = _descend(v, variance.min() / variance, p, gravity, free)
        design, residuals = _linearised(v, p, gravity)
        stated = (design[:, 6:] ** 2 * stated_raw).sum(axis=1)  # d length / d reading = M'^T n
        excess = excess_variance(residuals, stated, len(v) - len(free))
        variance = np.maximum(stated + excess, (1e-12 * gravity) ** 2)
        if not found or float(np.abs(p - before).max()) < 1e-12 * gravity:
            break
    size = np.array([gravity] * 6 + [1.0] * 3)
    _, singular, right = np.linalg.svd(design[:, free] / size[free], full_matrices=False)
    weak = np.append(np.flatnonzero(singular < WEAKEST * np.sqrt(len(v))), len(singular) - 1)
    share = np.linalg.norm(right[weak], axis=0)
    weakest = float(singular[-1] / np.sqrt(len(v))) if len(v) >= len(free) else 0.0
    if not found and weakest > WEAKEST:
        raise PoorFit(
            f"multi-position: wanted {len(v)} readings of length {gravity:g} m/s2, got none that a linear sensor could give; "
            "check that the device lay still and that the columns are the accelerometer's",
            poses=len(v),
        )
    covariance = np.zeros((9, 9))
    covariance[np.ix_(free, free)] = _inverse(design[:, free] / np.sqrt(variance)[:, None])
    return NormFit(
        center=center,
        scale=scale,
        p=p,
        covariance=covariance,
        residuals=residuals,
        excess=float(np.sqrt(excess)),
        condition=scaled_condition(design[:, free])[1],
        weakest=weakest,
        unseen=tuple(NAMES[i] for i in free[share > 0.3 * share.max()]),
        gravity=gravity,
    )


def _upper(p: FloatArray) -> FloatArray:
    matrix = np.zeros((3, 3))
    matrix[ROW, COLUMN] = p[:6]
    return matrix


def _sphere(reading: FloatArray, gravity: float) -> tuple[FloatArray, float]:
    """Return centre and g / radius of the sphere |u - c| = R: linear in c and R^2 - |c|^2; in the plane of flat poses."""
    mean = reading.mean(axis=0)
    spread = float(np.abs(reading - mean).max())
    u = (reading - mean) / spread
    design = np.column_stack((2.0 * u, np.ones(len(u))))
    solution = np.linalg.lstsq(design, (u**2).sum(axis=1), rcond=0.02)[0]
    radius = float(np.sqrt(max(solution[3] + solution[:3] @ solution[:3], 0.01)))
    return mean + spread * solution[:3], gravity / (spread * radius)


def _descend(
    v: FloatArray, weight: FloatArray, start: FloatArray, gravity: float, free: IntArray
) -> tuple[FloatArray, bool]:
    """Return the minimum and whether there is one; the start again where the steps run away."""
    from undrift.kernels.multi_position import norm_equations

    flat, square, size = v.reshape(-1), np.ix_(free, free), np.array([1.0] * 6 + [gravity] * 3)
    normal, gradient, trial_normal, trial_gradient = np.empty(81), np.empty(9), np.empty(81), np.empty(9)
    p = start
    cost = norm_equations(flat, weight, p, gravity, normal, gradient)
    damping = 1e-9
    for _ in range(100):
        block = normal.reshape(9, 9)[square]
        step = np.zeros(9)
        step[free] = np.linalg.solve(block + damping * np.diag(np.diag(block) + 1e-12 * len(v)), -gradient[free])
        trial = p + step
        trial_cost = norm_equations(flat, weight, trial, gravity, trial_normal, trial_gradient)
        settled = float(np.abs(step / size).max()) < 1e-11
        if trial_cost <= cost:
            p, cost, damping = trial, trial_cost, max(0.1 * damping, 1e-12)
            normal, trial_normal, gradient, trial_gradient = trial_normal, normal, trial_gradient, gradient
        else:
            damping = max(10.0 * damping, 1e-6)
        if settled or damping > 1e9:
            return p, True
        if float(np.abs(p / size).max()) > 30.0:
            break
    return start, False


def _linearised(v: FloatArray, p: FloatArray, gravity: float) -> tuple[FloatArray, FloatArray]:
    """Return design (K, 9) and residuals (K,) at p."""
    matrix, d = _upper(p), v - p[6:]
    a = d @ matrix.T
    length = np.linalg.norm(a, axis=1)
    n = a / length[:, None]
    return np.column_stack((n[:, ROW] * d[:, COLUMN], -n @ matrix)), length - gravity


def _inverse(design: FloatArray) -> FloatArray:
    """Return (J^T J)^-1 by singular values, NaN where they are short of rank."""
    size = np.linalg.norm(design, axis=0)
    _, singular, right = np.linalg.svd(design / np.where(size > 0.0, size, 1.0), full_matrices=False)
    if len(singular) < design.shape[1] or len(design) < design.shape[1] or singular[-1] < 1e-9 * singular[0]:
        return np.full((design.shape[1], design.shape[1]), np.nan)
    root = right.T / singular / size[:, None]
    inverse: FloatArray = root @ root.T
    return inverse
