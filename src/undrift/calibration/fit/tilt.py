"""Tilt of the faces: how far from level were they, judged by the spare equations of a six-face fit, and the fit that allows for it.

Equation (p, i) of pose p and axis i of the case has the standard deviation::

    own axis     hypot(noise, g tilt^2)          the cosine of the tilt
    cross axis   hypot(noise, g tilt)            the sine

This holds along the axes of the case. A sensor leans by a per cent against them and sees a per cent of the sine on its own
face, which can be more than the noise. So a plain fit corrects the readings first, and the tilt is judged by those::

    a = M0 (s - b0)              K0, b0 by plain least squares, M0 = K0^-1
    a = K1 up + b1               weighted;  K = K0 K1,  b = K0 b1 + b0

The restricted likelihood of a tilt is that of all rows together::

    log L = -1/2 [ sum log sigma^2 + log det A^T W A + r^T W r ]

It has six spare equations of six faces to go by, so that no single tilt is taken: the parameters are averages over every tilt,
and their covariance is that of the error over every tilt that L allows::

    theta = E1 theta(tilt)       covariance = E0 C(tilt) + E0 (theta(tilt) - theta)(theta(tilt) - theta)'

E0 weighs by L / (tilt + noise / g), which leaves room for a tilt as small as the noise; E1 by L / (tilt + 0.1 noise / g), which
leans toward level faces and so loses nothing on them. Where L is greatest at no tilt at all, the faces count as level, and
the fit is plain least squares, which is then the best there is.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.linear import ForwardFit

_EVIDENCE = 2.0  # twice the log-likelihood that a tilt must gain to be told: 8 % false alarms on a level plane
_LARGEST = 0.2  # rad
_GRID = 120
_QUIET = 0.1  # noise / g: the tilt that E1 takes for none


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Tilted:
    """Fits at T tilts: theta (T, 12) as K row by row, then b; covariance (T, 12, 12); log L (T,)."""

    tilts: FloatArray
    theta: FloatArray
    covariance: FloatArray
    likelihood: FloatArray


def fit_tilted(up: FloatArray, reading: FloatArray, noise: FloatArray, plain: ForwardFit) -> tuple[ForwardFit, float]:
    """Fit faces whose tilt is not known.

    Parameters
    ----------
    up : array, shape (P, 3)
        Nominal specific force of each pose: one axis, m/s2.
    reading : array, shape (P, 3)
        Mean readings.
    noise : array, shape (P, 3)
        Standard deviation of each mean, unit of the readings.
    plain : ForwardFit
        Least squares of the same poses, taken for level.

    Returns
    -------
    fit : ForwardFit
        K and b with the covariance that noise and tilt leave.
    tilt : float
        As ``estimate_tilt`` says, rad.
    """
    inverse = np.linalg.inv(plain.matrix)
    level = (reading - plain.offset) @ inverse.T
    sigma = np.sqrt(noise**2 @ (inverse**2).T)
    gravity = float(np.linalg.norm(up, axis=1).max())
    found = _solved(up, level, sigma, np.full(3, gravity))
    if reading.size <= 12 or int(np.argmax(found.likelihood)) == 0:
        return plain, 0.0
    small = float(np.median(sigma)) / gravity
    held, likely = _shares(found, small), _shares(found, _QUIET * small)
    theta = likely @ found.theta
    apart = found.theta - theta
    covariance = np.einsum("t,tij->ij", held, found.covariance) + (held[:, None] * apart).T @ apart
    jacobian = np.zeros((12, 12))
    jacobian[:9, :9], jacobian[9:, 9:] = np.kron(plain.matrix, np.eye(3)), plain.matrix
    matrix = plain.matrix @ theta[:9].reshape(3, 3)
    offset = plain.matrix @ theta[9:] + plain.offset
    fit = ForwardFit(
        matrix=matrix,
        offset=offset,
        covariance=jacobian @ covariance @ jacobian.T,
        residuals=reading - up @ matrix.T - offset,
        rank=plain.rank,
        condition=plain.condition,
    )
    return fit, _told(found)


def estimate_tilt(up: FloatArray, reading: FloatArray, noise: FloatArray, gain: FloatArray) -> float:
    """Estimate the standard deviation of the faces' tilt.

    Parameters
    ----------
    up : array, shape (P, 3)
        Nominal specific force of each pose: one axis, m/s2.
    reading : array, shape (P, 3)
        Mean readings, best along the axes of the case.
    noise : array, shape (P, 3)
        Standard deviation of each mean, unit of the readings.
    gain : array, shape (3,)
        Gravity in the unit of each reading.

    Returns
    -------
    float
        rad; 0 where the spare equations do not ask for a tilt.
    """
    return 0.0 if reading.size <= 12 else _told(_solved(up, reading, noise, gain))


def tilted_sigma(up: FloatArray, noise: FloatArray, gain: FloatArray, tilt: float) -> FloatArray:
    """Return the standard deviation of every equation for faces tilted by so much.

    Parameters
    ----------
    up : array, shape (P, 3)
        Nominal specific force of each pose: one axis.
    noise : array, shape (P, 3)
        Standard deviation of each mean, unit of the readings.
    gain : array, shape (3,)
        Gravity in the unit of each reading.
    tilt : float
        rad.

    Returns
    -------
    array, shape (P, 3)
        Unit of the readings.
    """
    return np.asarray(np.hypot(noise, gain * np.where(up != 0.0, tilt * tilt, tilt)))


def _shares(found: _Tilted, small: float) -> FloatArray:
    step = np.gradient(found.tilts)
    step[[0, -1]] *= 0.5  # trapezoids
    share = np.exp(found.likelihood - found.likelihood.max()) * step / (found.tilts + small)
    return np.asarray(share / share.sum())


def _told(found: _Tilted) -> float:
    tilts, likelihood = found.tilts, found.likelihood
    best = int(np.argmax(likelihood))
    if 2.0 * (likelihood[best] - likelihood[0]) < _EVIDENCE or best == 0:
        return 0.0
    if best == len(tilts) - 1:
        return float(tilts[best])
    left, middle, right = likelihood[best - 1 : best + 2]
    bend = left - 2.0 * middle + right  # parabola through three points of a geometric grid
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(tilts[best] * (tilts[best + 1] / tilts[best]) ** np.clip(shift, -1.0, 1.0))


def _solved(up: FloatArray, reading: FloatArray, noise: FloatArray, gain: FloatArray) -> _Tilted:
    # Weighted least squares of the three rows for every tilt of a grid at once.
    smallest = 0.02 * float(np.median(noise)) / float(np.median(gain))
    tilts = np.concatenate(([0.0], np.geomspace(max(smallest, 1e-9), _LARGEST, _GRID)))
    length = float(np.linalg.norm(up, axis=1).max())
    design = np.column_stack((up / length, np.ones(len(up))))
    unit = np.array([length, length, length, 1.0])
    sigma = np.stack([tilted_sigma(up, noise, gain, float(t)) for t in tilts])
    theta, covariance, likelihood = np.zeros((len(tilts), 12)), np.zeros((len(tilts), 12, 12)), np.zeros(len(tilts))
    for row in range(3):
        weight = 1.0 / sigma[:, :, row] ** 2
        normal = (design.T * weight[:, None, :]) @ design
        inverse = np.linalg.inv(normal)
        own = np.einsum("tij,tj->ti", inverse, (weight * reading[:, row]) @ design)
        residual = reading[:, row] - own @ design.T
        places = np.array([3 * row, 3 * row + 1, 3 * row + 2, 9 + row])
        theta[:, places] = own / unit
        covariance[:, places[:, None], places] = inverse / np.outer(unit, unit)
        likelihood -= 0.5 * ((weight * residual**2).sum(axis=1) - np.log(weight).sum(axis=1))
        likelihood -= 0.5 * np.linalg.slogdet(normal)[1]
    return _Tilted(tilts=tilts, theta=theta, covariance=covariance, likelihood=likelihood)
