"""Thermal hysteresis: the offset differs between warming and cooling: ``y = x + A (z - T) / w``.

z follows T with a play of half-width w: ``z_k = min(max(z_(k-1), T_k - w), T_k + w)``. So the offset is -A while the device
warms, +A while it cools, and goes straight from one to the other over 2 w after a turn; it does not depend on speed.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.fields import quantity, settle
from undrift.sim.device.scene import Scene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hysteresis:
    """Offset between warming and cooling.

    Parameters
    ----------
    amplitude : array, shape (3,)
        Half the width of the loop, rad/s or m/s2.
    play_k : float
        Half-width of the play, K.
    """

    amplitude: FloatArray = quantity("{x}", (3,))
    play_k: float = quantity("", None, 2.0, least=1e-9)

    def __post_init__(self) -> None:
        settle(self)


def play(temp_c: FloatArray, half_width: float) -> FloatArray:
    """Return what follows a temperature with play.

    Parameters
    ----------
    temp_c : array, shape (N,)
        degC.
    half_width : float
        K.

    Returns
    -------
    array, shape (N,)
        degC; starts at the first temperature.
    """
    if np.ptp(temp_c) == 0.0:
        return temp_c
    follower, at = np.empty(len(temp_c)), float(temp_c[0])
    for k, temp in enumerate(temp_c.tolist()):
        at = min(max(at, temp - half_width), temp + half_width)
        follower[k] = at
    return follower


def with_hysteresis(x: FloatArray, effect: Hysteresis, scene: Scene) -> FloatArray:
    """Return a signal with thermal hysteresis.

    Parameters
    ----------
    x : array, shape (N, 3)
        Nominal input units.
    effect : Hysteresis
        Loop.
    scene : Scene
        With the temperature.

    Returns
    -------
    array, shape (N, 3)
        Nominal input units.
    """
    behind = (play(scene.temp_c, effect.play_k) - scene.temp_c) / effect.play_k
    return x + np.outer(behind, effect.amplitude)
