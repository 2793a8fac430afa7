"""Sampling: when the readings are truly taken, and over which interval.

Sample j is stamped t_j = t_0 + j / f. Channel i is taken at t_0 + (j / f) / (1 + c) + d_i + jitter_j: c is how much too fast
the device's clock runs, d_i the delay of a converter that takes its channels in turn. An "instant" reading is the signal at
that time; an "interval" reading is its mean since the sample before, from the running integral of the signal.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.sim.device.fields import quantity, settle

Averaging = Literal["instant", "interval"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sampling:
    """The device's clock and its converters' timing.

    Parameters
    ----------
    sample_rate_hz : float or None
        Nominal rate; None takes a sample at each sample of the motion, where only jitter, clock and delays move it.
    clock_error : float
        c, relative; positive for a clock that runs fast.
    jitter_s : float
        Standard deviation of the time of a sample, s.
    gyro_delay_s, accel_delay_s : array, shape (3,)
        d, s.
    gyro_averaging, accel_averaging : str
        instant or interval.
    """

    sample_rate_hz: float | None = quantity("", None, None, least=1e-9)
    clock_error: float = quantity("", None, 0.0, least=-0.5)
    jitter_s: float = quantity("", None, 0.0, least=0.0)
    gyro_delay_s: FloatArray = quantity("", (3,), 0.0)
    accel_delay_s: FloatArray = quantity("", (3,), 0.0)
    gyro_averaging: Averaging = quantity("", None, "interval")
    accel_averaging: Averaging = quantity("", None, "instant")

    def __post_init__(self) -> None:
        settle(self)
        for name in ("gyro_averaging", "accel_averaging"):
            if getattr(self, name) not in ("instant", "interval"):
                raise InputError(f"{name}: wanted instant or interval, got '{getattr(self, name)}'; name one of them")

    @property
    def on_grid(self) -> bool:
        """True where every reading is taken exactly at a sample of the motion."""
        moved = self.clock_error or self.jitter_s or self.gyro_delay_s.any() or self.accel_delay_s.any()
        return self.sample_rate_hz is None and not moved


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ticks:
    """Times of M samples.

    Parameters
    ----------
    stamped_s : array, shape (M,)
        What the record says, s.
    true_s : array, shape (M,)
        When they were taken, without the delay of a channel, s.
    """

    stamped_s: FloatArray
    true_s: FloatArray


def ticks_of(effect: Sampling, time: FloatArray, rng: np.random.Generator) -> Ticks:
    """Return the times of the samples that lie within a motion.

    Parameters
    ----------
    effect : Sampling
        Clock.
    time : array, shape (N,)
        Of the motion, s.
    rng : Generator
        Stream of the jitter.

    Returns
    -------
    Ticks
        Only samples whose channels are all taken within the motion.

    Raises
    ------
    InputError
        Fewer than two of them.
    """
    if effect.on_grid:
        return Ticks(stamped_s=time, true_s=time)
    if effect.sample_rate_hz is None:
        stamped = time
    else:
        stamped = (
            time[0] + np.arange(int((time[-1] - time[0]) * effect.sample_rate_hz * 1.5) + 2) / effect.sample_rate_hz
        )
    true = time[0] + (stamped - time[0]) / (1.0 + effect.clock_error)
    true = true + effect.jitter_s * rng.standard_normal(len(true))
    delays = np.concatenate((effect.gyro_delay_s, effect.accel_delay_s, [0.0]))
    margin = 1e-9 * (time[-1] - time[0])  # of rounding
    inside = (true + delays.min() >= time[0] - margin) & (true + delays.max() <= time[-1] + margin)
    if inside.sum() < 2 or (np.diff(true[inside]) <= 0.0).any():
        raise InputError(
            f"sampling: wanted two samples or more in order of time, got {int(inside.sum())} within the motion; "
            "give a longer motion, or a jitter well below the sample period"
        )
    return Ticks(stamped_s=stamped[inside], true_s=true[inside])


def instant(x: FloatArray, time: FloatArray, at: FloatArray, delay_s: FloatArray) -> FloatArray:
    """Return a signal at other times, by a cubic spline.

    Parameters
    ----------
    x : array, shape (N, 3)
        Any unit.
    time : array, shape (N,)
        s.
    at : array, shape (M,)
        s.
    delay_s : array, shape (3,)
        Added to it for each channel, s.

    Returns
    -------
    array, shape (M, 3)
        Same unit.
    """
    from scipy.interpolate import CubicSpline

    return np.stack([CubicSpline(time, x[:, k])(at + delay_s[k]) for k in range(3)], axis=1)


def interval(means: FloatArray, time: FloatArray, at: FloatArray, delay_s: FloatArray) -> FloatArray:
    """Return the mean of a signal since the sample before, from its means over the steps of its own grid.

    Parameters
    ----------
    means : array, shape (N, 3)
        Mean over the step that ends with each sample, any unit; the first stands for the time before the grid.
    time : array, shape (N,)
        s.
    at : array, shape (M,)
        s.
    delay_s : array, shape (3,)
        Added to it for each channel, s.

    Returns
    -------
    array, shape (M, 3)
        Same unit.
    """
    from scipy.interpolate import CubicSpline

    steps = np.diff(time, prepend=time[0])
    integral = np.cumsum(means * steps[:, None], axis=0)
    out = np.empty((len(at), 3))
    for k in range(3):
        taken = at + delay_s[k]
        before = np.concatenate(([taken[0] - (taken[1] - taken[0])], taken[:-1]))
        spline = CubicSpline(time, integral[:, k])
        early = np.minimum(before - time[0], 0.0) * means[0, k]
        out[:, k] = (spline(taken) - spline(np.maximum(before, time[0])) - early) / (taken - before)
    return out


def step_means(x: FloatArray, time: FloatArray) -> FloatArray:
    """Return the mean of a smooth signal over each step of its grid, by the integral of its cubic spline.

    Parameters
    ----------
    x : array, shape (N, 3)
        Any unit.
    time : array, shape (N,)
        s.

    Returns
    -------
    array, shape (N, 3)
        Same unit; the first is the signal itself.
    """
    from scipy.interpolate import CubicSpline

    integral = np.asarray(CubicSpline(time, x).antiderivative()(time))
    return np.vstack((x[:1], np.diff(integral, axis=0) / np.diff(time)[:, None]))
