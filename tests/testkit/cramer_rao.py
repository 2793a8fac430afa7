"""Cramer-Rao bounds by numerical Fisher information, and the tally of a Monte Carlo run.

Readings y ~ N(mu(theta), C) carry the information I = J^T C^-1 J, J = d mu / d theta. Nuisance parameters (the unknown
directions of free poses) are taken out by the Schur complement. The bound is carried over to the reported parameters by
a numerical derivative. Nothing here is shared with the fits: every derivative is a central difference of a forward model.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from testkit.cohorts import ratio_limit, share_limits
from testkit.data import show
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device

Array = np.ndarray
Function = Callable[[Array], Array]


def jacobian(f: Function, x: Array, steps: Array | float) -> Array:
    """Return d f / d x by central differences, shape (E, P)."""
    h = np.broadcast_to(np.asarray(steps, float), x.shape)
    columns = []
    for k in range(len(x)):
        shift = np.zeros(len(x))
        shift[k] = h[k]
        columns.append((f(x + shift) - f(x - shift)).ravel() / (2.0 * h[k]))
    return np.stack(columns, axis=1)


def information(design: Array, covariance: Array) -> Array:
    """Return J^T C^-1 J for a covariance given as variances (E,) or as blocks (K, 3, 3)."""
    if covariance.ndim == 1:
        return design.T @ (design / covariance[:, None])
    blocks = design.reshape(len(covariance), 3, -1)
    return np.einsum("kip,kiq->pq", blocks, np.linalg.solve(covariance, blocks))


def carried(g: Function, x: Array, steps: Array | float, covariance: Array) -> Array:
    """Return the standard deviations of g(x), to first order."""
    j = jacobian(g, x, steps)
    return np.sqrt(np.einsum("ip,pq,iq->i", j, covariance, j))


def inverse_model(theta: Array) -> Array:
    """Return matrix and offset of the correction, as reported by a fit, from K row by row and b."""
    return np.concatenate((np.linalg.inv(theta[:9].reshape(3, 3)).ravel(), theta[9:12], theta[12:]))


def white_device(rng: np.random.Generator, *, g_sensitivity: bool = False) -> DeviceModel:
    """Return a consumer-grade device whose noise is white: the noise of the bound."""
    device = random_device(rng)
    feigned = device.gyro.g_sensitivity if g_sensitivity else None
    return replace(
        device,
        gyro=replace(device.gyro, adc=None, random_walk=None, g_sensitivity=feigned),
        accel=replace(device.accel, adc=None, random_walk=None),
    )


@dataclass(slots=True)
class Tally:
    """Errors of many devices, in units of the bound and of the reported uncertainty."""

    name: str
    by_bound: list[Array]
    by_stated: list[Array]

    @classmethod
    def of(cls, name: str) -> "Tally":
        return cls(name, [], [])

    def add(self, error: Array, bound: Array, stated: Array) -> None:
        self.by_bound.append(error / bound)
        self.by_stated.append(error / stated)

    @property
    def ratio(self) -> float:
        """Root-mean-square error over the bound, all devices and parameters pooled."""
        return float(np.sqrt(np.mean(np.square(self.by_bound))))

    @property
    def coverage(self) -> float:
        """Return the pooled share of 95 % intervals that contain the truth."""
        return float(np.mean(np.abs(self.by_stated) <= 1.959964))

    @property
    def worst_ratio(self) -> float:
        """Return the same ratio for the worst parameter."""
        return float(np.sqrt(np.mean(np.square(self.by_bound), axis=0)).max())

    def check(self, devices: int) -> None:
        """Print the figures and check them against the promise."""
        errors = np.size(self.by_bound)
        low, high = share_limits(errors)
        show(f"{self.name}: RMSE over Cramer-Rao bound", f"{self.ratio:.4f}", ratio_limit(errors))
        show(f"{self.name}: worst parameter", f"{self.worst_ratio:.4f}")
        show(f"{self.name}: coverage of 95 % intervals", f"{self.coverage:.4f}", (low, high))
        assert len(self.by_bound) == devices
        assert self.ratio <= ratio_limit(errors)
        assert low <= self.coverage <= high
