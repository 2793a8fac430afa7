"""Warm-up: what a young device still lacks of its settled offset: ``y = x - A (1 + k D) exp(-t / tau)`` [1]_.

The form C1 (1 - exp(-t / tau)) + C2 of the source with A = C1 and C1 + C2 counted as the settled offset.

References
----------
.. [1] B. Barshan and H. F. Durrant-Whyte, "Inertial navigation systems for mobile robots", IEEE Trans. Robotics and
   Automation 11(3):328-342, 1995.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.fields import quantity, settle
from undrift.sim.device.scene import Scene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WarmUp:
    """Offset over time since power-on.

    Parameters
    ----------
    amplitude : array, shape (3,)
        Change from power-on to the settled value, rad/s or m/s2.
    time_constant_s : float
        s.
    per_k : array, shape (3,)
        Relative change of the amplitude with temperature, per K.
    """

    amplitude: FloatArray = quantity("{x}", (3,))
    time_constant_s: float = quantity("", least=1e-9)
    per_k: FloatArray = quantity("", (3,), 0.0)

    def __post_init__(self) -> None:
        settle(self)


def warming_up(x: FloatArray, effect: WarmUp, scene: Scene) -> FloatArray:
    """Return a signal of a device that warms up.

    Parameters
    ----------
    x : array, shape (N, 3)
        Nominal input units.
    effect : WarmUp
        Amplitude and time constant.
    scene : Scene
        With age and temperature.

    Returns
    -------
    array, shape (N, 3)
        Nominal input units.
    """
    fading = np.exp(-scene.age_s / effect.time_constant_s)[:, None]
    lacking: FloatArray = effect.amplitude * (1.0 + np.outer(scene.warmth, effect.per_k)) * fading
    return x - lacking
