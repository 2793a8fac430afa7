"""Tilt of the faces: how far from level were they, judged by the spare equations of a six-face fit.

Equation (p, i) of pose p and sensor i has the standard deviation::

    own axis     hypot(noise, gain_i tilt^2)          the cosine of the tilt
    cross axis   hypot(noise, gain_i tilt)            the sine

with gain_i = g in the unit of sensor i. ``tilt`` maximises the restricted likelihood of all rows together::

    -1/2 [ sum log sigma^2 + log det A^T W A + r^T W r ]

and is believed only where it raises twice the log-likelihood by more than 2: else the faces count as level, and the fit is
plain least squares, which is then the best there is.
"""

import numpy as np

from undrift.arrays import FloatArray

_EVIDENCE = 2.0  # 8 % false alarms on a level plane, which cost 1 % there and buy honest intervals beside it
_LARGEST = 0.2  # rad
_GRID = 60


def estimate_tilt(up: FloatArray, reading: FloatArray, noise: FloatArray, gain: FloatArray) -> float:
    """Estimate the standard deviation of the faces' tilt.

    Parameters
    ----------
    up : array, shape (P, 3)
        Nominal specific force of each pose: one axis, m/s2.
    reading : array, shape (P, 3)
        Mean readings.
    noise : array, shape (P, 3)
        Standard deviation of each mean, unit of the readings.
    gain : array, shape (3,)
        Gravity in the unit of each sensor.

    Returns
    -------
    float
        rad; 0 where the spare equations do not ask for a tilt.
    """
    if reading.size <= 12:
        return 0.0
    smallest = 0.02 * float(np.median(noise)) / float(np.median(gain))
    tilts = np.concatenate(([0.0], np.geomspace(max(smallest, 1e-9), _LARGEST, _GRID)))
    likelihood = _restricted_likelihood(up, reading, noise, gain, tilts)
    best = int(np.argmax(likelihood))
    if 2.0 * (likelihood[best] - likelihood[0]) < _EVIDENCE or best == 0:
        return 0.0
    if best == len(tilts) - 1:
        return float(tilts[best])
    left, middle, right = likelihood[best - 1 : best + 2]
    bend = left - 2.0 * middle + right  # parabola through three points of a geometric grid
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(tilts[best] * (tilts[best + 1] / tilts[best]) ** np.clip(shift, -1.0, 1.0))


def tilted_sigma(up: FloatArray, noise: FloatArray, gain: FloatArray, tilt: float) -> FloatArray:
    """Return the standard deviation of every equation for faces tilted by so much.

    Parameters
    ----------
    up : array, shape (P, 3)
        Nominal specific force of each pose: one axis.
    noise : array, shape (P, 3)
        Standard deviation of each mean, unit of the readings.
    gain : array, shape (3,)
        Gravity in the unit of each sensor.
    tilt : float
        rad.

    Returns
    -------
    array, shape (P, 3)
        Unit of the readings.
    """
    return np.asarray(np.hypot(noise, gain * np.where(up != 0.0, tilt * tilt, tilt)))


def _restricted_likelihood(
    up: FloatArray, reading: FloatArray, noise: FloatArray, gain: FloatArray, tilts: FloatArray
) -> FloatArray:
    # -1/2 [ sum log sigma^2 + log det A^T W A + r^T W r ], summed over the three rows, for every candidate tilt at once.
    design = np.column_stack((up / np.linalg.norm(up, axis=1, keepdims=True), np.ones(len(up))))
    sigma = np.stack([tilted_sigma(up, noise, gain, float(t)) for t in tilts])
    total = np.zeros(len(tilts))
    for row in range(3):
        weight = 1.0 / sigma[:, :, row] ** 2
        normal = np.einsum("pi,tp,pj->tij", design, weight, design)
        right = np.einsum("pi,tp,p->ti", design, weight, reading[:, row])
        theta = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        residual = reading[:, row] - theta @ design.T
        total -= 0.5 * ((weight * residual**2).sum(axis=1) - np.log(weight).sum(axis=1) + np.linalg.slogdet(normal)[1])
    return total
