"""Bias instability: noise of spectral density B^2 / (2 pi f), whose Allan deviation is flat at sqrt(2 ln 2 / pi) B [1]_.

Made of first-order Gauss-Markov processes with time constants tau_j a factor r apart and variance B^2 ln(r) / pi each: their
densities add up to the flicker's between 1 / (2 pi longest) and 1 / (2 pi shortest), with a ripple below 2 % for r = sqrt(10).
Each process is sampled exactly and starts in its stationary state.

References
----------
.. [1] IEEE Std 952-1997, annex C.
"""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.fields import quantity, settle
from undrift.sim.device.scene import Scene

RATIO = math.sqrt(10.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BiasInstability:
    """Flicker of the offset.

    Parameters
    ----------
    instability : array, shape (3,)
        B, rad/s or m/s2.
    shortest_s, longest_s : float
        Time constants of the fastest and the slowest process, s.
    """

    instability: FloatArray = quantity("{x}", (3,), least=0.0)
    shortest_s: float = quantity("", None, 0.1, least=1e-9)
    longest_s: float = quantity("", None, 1e4, least=1e-9)

    def __post_init__(self) -> None:
        settle(self)

    @property
    def time_constants_s(self) -> FloatArray:
        """Time constants of the processes, s."""
        count = round(math.log(self.longest_s / self.shortest_s) / math.log(RATIO)) + 1
        constants: FloatArray = self.shortest_s * RATIO ** np.arange(count)
        return constants


def with_instability(x: FloatArray, effect: BiasInstability, scene: Scene, rng: np.random.Generator) -> FloatArray:
    """Return a signal whose offset flickers.

    Parameters
    ----------
    x : array, shape (N, 3)
        Nominal input units.
    effect : BiasInstability
        Its size and band.
    scene : Scene
        With the sample rate.
    rng : Generator
        Stream of this effect.

    Returns
    -------
    array, shape (N, 3)
        Nominal input units.
    """
    from scipy.signal import lfilter

    sd = effect.instability * math.sqrt(math.log(RATIO) / math.pi)
    total = np.array(x)
    for constant in effect.time_constants_s.tolist():
        keep = math.exp(-scene.step_s / constant)
        draws = rng.standard_normal(x.shape)
        draws[1:] *= math.sqrt(-math.expm1(-2.0 * scene.step_s / constant))
        total += sd * np.asarray(lfilter([1.0], [1.0, -keep], draws, axis=0))
    return total
