"""Thermal scale: ``y = x (1 + k_1 D + k_2 D^2 + ...)``; it acts on the offset too, which passes the same element."""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.fields import quantity, settle
from undrift.sim.device.offset import polynomial
from undrift.sim.device.scene import Scene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThermalScale:
    """Sensitivity over temperature.

    Parameters
    ----------
    per_k : array, shape (K, 3)
        Relative change with D, D^2, ... D^K in a row each, per K to that power.
    """

    per_k: FloatArray = quantity("by_power_of_k", (None, 3))

    def __post_init__(self) -> None:
        settle(self)

    def factor(self, warmth: FloatArray | float) -> FloatArray:
        """Return the factor at a temperature.

        Parameters
        ----------
        warmth : array or float
            Temperature above reference, K.

        Returns
        -------
        array, shape (..., 3)
            1 at the reference temperature.
        """
        return 1.0 + polynomial(self.per_k, np.asarray(warmth, dtype=float))


def warmed(x: FloatArray, effect: ThermalScale, scene: Scene) -> FloatArray:
    """Return a signal at the sensitivity of its temperature.

    Parameters
    ----------
    x : array, shape (N, 3)
        Nominal input units.
    effect : ThermalScale
        Coefficients.
    scene : Scene
        With the temperature.

    Returns
    -------
    array, shape (N, 3)
        Nominal input units.
    """
    return x * effect.factor(scene.warmth)
