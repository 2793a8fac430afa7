"""Offset and its thermal drift: ``y = x + o + c_1 D + c_2 D^2 + ...``, D the temperature above reference."""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.fields import quantity, settle
from undrift.sim.device.scene import Scene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Offset:
    """Output at zero input.

    Parameters
    ----------
    constant : array, shape (3,)
        At the reference temperature, rad/s or m/s2.
    per_k : array, shape (K, 3)
        Coefficient of D, D^2, ... D^K in a row each, rad/s or m/s2 per K to that power.
    """

    constant: FloatArray = quantity("{x}", (3,), 0.0)
    per_k: FloatArray = quantity("{x}_by_power_of_k", (None, 3), ())

    def __post_init__(self) -> None:
        settle(self)

    def at(self, warmth: FloatArray | float) -> FloatArray:
        """Return the offset at a temperature.

        Parameters
        ----------
        warmth : array or float
            Temperature above reference, K.

        Returns
        -------
        array, shape (..., 3)
            rad/s or m/s2.
        """
        return self.constant + polynomial(self.per_k, np.asarray(warmth, dtype=float))


def polynomial(coefficients: FloatArray, warmth: FloatArray) -> FloatArray:
    """Return ``sum_k c_k D^k`` for k = 1, 2, ... per axis.

    Parameters
    ----------
    coefficients : array, shape (K, 3)
        One power a row, from the first on.
    warmth : array, shape (...)
        D, K.

    Returns
    -------
    array, shape (..., 3)
        Zero where there is no coefficient.
    """
    total = np.zeros((*warmth.shape, 3))
    for row in coefficients[::-1]:
        total = (total + row) * warmth[..., None]
    return total


def with_offset(x: FloatArray, effect: Offset, scene: Scene) -> FloatArray:
    """Return a signal with its offset.

    Parameters
    ----------
    x : array, shape (N, 3)
        Nominal input units.
    effect : Offset
        Constant and drift.
    scene : Scene
        With the temperature.

    Returns
    -------
    array, shape (N, 3)
        Nominal input units.
    """
    if not len(effect.per_k):
        return x + effect.constant
    return x + effect.at(scene.warmth)
