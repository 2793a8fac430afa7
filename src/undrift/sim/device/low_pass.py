"""Low-pass: second order, Sallen-Key, ``H(s) = w^2 / (s^2 + w s / Q + w^2)``; Butterworth for Q = 1 / sqrt(2).

In state space, ``x' = A x + B u`` with x = (y, y' / w), the response to an input that is straight between samples (first-order
hold) is exact [1]_: with E = expm(h [[A, B, 0], [0, 0, 1 / h], [0, 0, 0]]) in blocks,
``x_(k+1) = E11 x_k + E12 u_k + E13 (u_(k+1) - u_k)``.
The group delay at zero frequency is 1 / (Q w), sqrt(2) / w for Butterworth.

Unity gain: w = 1 / sqrt(R1 R2 C1 C2), Q = sqrt(R1 R2 C1 C2) / (C2 (R1 + R2)) [2]_.

References
----------
.. [1] C. F. Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Automatic Control 23(3), 1978.
.. [2] R. P. Sallen and E. L. Key, "A practical method of designing RC active filters", IRE Trans. Circuit Theory 2(1), 1955.
"""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.fields import quantity, settle
from undrift.sim.device.scene import Scene, check_even

BUTTERWORTH = 1.0 / math.sqrt(2.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LowPass:
    """Second-order low-pass of each channel.

    Parameters
    ----------
    cutoff_hz : array, shape (3,)
        w / (2 pi), Hz.
    quality : array, shape (3,)
        Q.
    """

    cutoff_hz: FloatArray = quantity("", (3,), least=1e-9)
    quality: FloatArray = quantity("", (3,), BUTTERWORTH, least=1e-9)

    def __post_init__(self) -> None:
        settle(self)

    @property
    def group_delay_s(self) -> FloatArray:
        """Delay of slow signals, s, shape (3,)."""
        delay: FloatArray = 1.0 / (self.quality * 2.0 * math.pi * self.cutoff_hz)
        return delay


def sallen_key(cutoff_hz: float, parts: FloatArray) -> LowPass:
    """Return the low-pass that parts of a tolerance make of a Butterworth design with equal resistors and C1 = 2 C2.

    Parameters
    ----------
    cutoff_hz : float
        Of the design, Hz.
    parts : array, shape (3, 4)
        Relative errors of R1, R2, C1 and C2 of each channel.

    Returns
    -------
    LowPass
        Cut-off and quality of each channel.
    """
    r1, r2, c1, c2 = np.moveaxis(1.0 + np.asarray(parts, dtype=float), -1, 0)
    root = np.sqrt(r1 * r2 * c1 * c2)
    return LowPass(cutoff_hz=cutoff_hz / root, quality=BUTTERWORTH * 2.0 * root / (c2 * (r1 + r2)))


def difference_equation(cutoff_hz: float, quality: float, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of ``y_k = b0 u_k + b1 u_(k-1) + b2 u_(k-2) - a1 y_(k-1) - a2 y_(k-2)``.

    Exact for an input that is straight between samples; equations in the module docstring.

    Parameters
    ----------
    cutoff_hz : float
        Hz.
    quality : float
        Q.
    step_s : float
        Sample period, s.

    Returns
    -------
    array, shape (3,)
        b.
    array, shape (3,)
        a, a[0] = 1.
    """
    from scipy.linalg import expm

    w, h = 2.0 * math.pi * cutoff_hz, step_s
    system = np.zeros((4, 4))
    system[:2, :2] = h * w * np.array([[0.0, 1.0], [-1.0, -1.0 / quality]])
    system[1, 2], system[2, 3] = h * w, 1.0
    grown = expm(system)
    e, now, rise = grown[:2, :2], grown[:2, 2], grown[:2, 3]
    first, last = now - rise, rise  # x_(k+1) = e x_k + first u_k + last u_(k+1)
    swap = np.array([[-e[1, 1], e[0, 1]], [e[1, 0], -e[0, 0]]])  # adj(z I - e) = z I + swap
    b = np.array([last[0], first[0] + (swap @ last)[0], (swap @ first)[0]])
    a = np.array([1.0, -float(np.trace(e)), float(np.linalg.det(e))])
    return b, a


def low_passed(x: FloatArray, effect: LowPass, scene: Scene) -> FloatArray:
    """Return a signal after its low-pass, in which it had been resting before the first sample.

    Parameters
    ----------
    x : array, shape (N, 3)
        Any unit.
    effect : LowPass
        Cut-off and quality.
    scene : Scene
        With the sample period.

    Returns
    -------
    array, shape (N, 3)
        Same unit.

    Raises
    ------
    InputError
        Samples that are not evenly spaced.
    """
    from scipy.signal import lfilter

    check_even(scene, "low-pass")
    out = np.empty_like(x)
    for axis in range(3):
        b, a = difference_equation(float(effect.cutoff_hz[axis]), float(effect.quality[axis]), scene.step_s)
        resting = np.array([1.0 - b[0], b[2] - a[2]]) * x[0, axis]
        out[:, axis] = lfilter(b, a, x[:, axis], zi=resting)[0]
    return out
