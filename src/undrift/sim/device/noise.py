"""White noise and random walk: ``y_k = x_k + N sqrt(f) n_k + sum_j<=k K / sqrt(f) m_j``, f the samples per second.

N and K as IEEE Std 952 states them: Allan deviation N / sqrt(tau) and K sqrt(tau / 3). Behind a
low-pass white noise is drawn on the motion's grid, else on the device's own samples: f is the rate of these.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.fields import quantity, settle
from undrift.sim.device.scene import Scene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WhiteNoise:
    """Angle or velocity random walk.

    Parameters
    ----------
    random_walk : array, shape (3,)
        N, rad/s/sqrt(Hz) or m/s2/sqrt(Hz): the standard deviation of one sample is N sqrt(sample rate). A datasheet's
        one-sided density is sqrt(2) times this.
    """

    random_walk: FloatArray = quantity("{x}_per_sqrt_hz", (3,), least=0.0)

    def __post_init__(self) -> None:
        settle(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RandomWalk:
    """Random walk of the offset, from the first sample on.

    Parameters
    ----------
    bias_walk : array, shape (3,)
        K, rad/s/sqrt(s) or m/s2/sqrt(s).
    """

    bias_walk: FloatArray = quantity("{x}_per_sqrt_s", (3,), least=0.0)

    def __post_init__(self) -> None:
        settle(self)


def with_white_noise(x: FloatArray, effect: WhiteNoise, step_s: float, rng: np.random.Generator) -> FloatArray:
    """Return a signal with white noise.

    Parameters
    ----------
    x : array, shape (N, 3)
        Nominal input units.
    effect : WhiteNoise
        Its size.
    step_s : float
        Time from sample to sample, s.
    rng : Generator
        Stream of this effect.

    Returns
    -------
    array, shape (N, 3)
        Nominal input units.
    """
    noise: FloatArray = rng.standard_normal(x.shape) * (effect.random_walk / np.sqrt(step_s))
    return x + noise


def with_random_walk(x: FloatArray, effect: RandomWalk, scene: Scene, rng: np.random.Generator) -> FloatArray:
    """Return a signal whose offset walks.

    Parameters
    ----------
    x : array, shape (N, 3)
        Nominal input units.
    effect : RandomWalk
        Its size.
    scene : Scene
        With the sample rate.
    rng : Generator
        Stream of this effect.

    Returns
    -------
    array, shape (N, 3)
        Nominal input units; the first sample has not walked yet.
    """
    steps = rng.standard_normal(x.shape) * (effect.bias_walk * np.sqrt(scene.step_s))
    steps[0] = 0.0
    walked: FloatArray = x + np.cumsum(steps, axis=0)
    return walked
