"""Non-linearity and asymmetry: ``y = x + q x^2 + c x^3 + (a / 2) |x|``, per channel.

a is 2 (S+ - S-) / (S+ + S-), the asymmetry of the scale factor as IEEE Std 528 names it.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.fields import quantity, settle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Nonlinearity:
    """How the output departs from a straight line.

    Parameters
    ----------
    quadratic : array, shape (3,)
        q, per rad/s or per m/s2.
    cubic : array, shape (3,)
        c, per square of that.
    asymmetry : array, shape (3,)
        a, relative.
    """

    quadratic: FloatArray = quantity("per_{x}", (3,), 0.0)
    cubic: FloatArray = quantity("per_{x}_squared", (3,), 0.0)
    asymmetry: FloatArray = quantity("", (3,), 0.0)

    def __post_init__(self) -> None:
        settle(self)


def bent(x: FloatArray, effect: Nonlinearity) -> FloatArray:
    """Return a signal after non-linearity and asymmetry.

    Parameters
    ----------
    x : array, shape (N, 3)
        Nominal input units.
    effect : Nonlinearity
        Coefficients.

    Returns
    -------
    array, shape (N, 3)
        Nominal input units.
    """
    bend: FloatArray = x + x * x * (effect.quadratic + effect.cubic * x) + 0.5 * effect.asymmetry * np.abs(x)
    return bend
