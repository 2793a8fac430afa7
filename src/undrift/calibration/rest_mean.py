"""Mean rate at rest over several rests, and what it is worth.

::

    m = sum w_p m_p / sum w_p        w_p = 1 / (v_p + s2)
    var m = sum share_p^2 (v_p + k s2),   share_p = w_p / sum w_p

v_p is the variance of the mean of rest p, told by block means within the rests; blocks of half a second see what samples one
by one do not (flicker, a filter), blocks of an eighth of a rest see what wanders over the whole of it. s2 is the scatter
between rests beyond that (Paule and Mandel, ``fit/excess.py``): each switch-on has an offset of its own, and it drifts. Few
rests know their own scatter badly, so that s2 counts k times, k = (t / z)^2 with t and z the 97.5 % points of Student's
distribution, for one rest less than there are, and of the normal.
"""

from collections.abc import Sequence

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.excess import excess_variance
from undrift.calibration.fit.noise import noise_of_means

_LONG_BLOCKS = 8  # of one rest
_ROUNDS = 50


def mean_of_rests(windows: Sequence[FloatArray], sizes: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Return the mean reading over rests and its variance.

    Parameters
    ----------
    windows : sequence of array, shape (N, 3)
        Readings of each rest, without gaps.
    sizes : sequence of int
        Samples in a block of half a second in each.

    Returns
    -------
    mean : array, shape (3,)
        Unit of the readings.
    variance : array, shape (3,)
        Of that mean.
    """
    return _weighted(np.array([w.mean(axis=0) for w in windows]), _variances(windows, sizes))


def _variances(windows: Sequence[FloatArray], sizes: Sequence[int]) -> FloatArray:
    # Of each rest's mean: by blocks of half a second, or by longer ones where those show more wandering.
    variances = np.array([w.var(axis=0) / max(1, len(w) - 1) for w in windows])
    long = [max(size, len(w) // _LONG_BLOCKS) for w, size in zip(windows, sizes, strict=True)]
    for lengths in (sizes, long):
        noise = noise_of_means(windows, lengths)
        if noise is not None:
            variances = np.maximum(variances, noise**2)
    return variances


def _weighted(means: FloatArray, variances: FloatArray) -> tuple[FloatArray, FloatArray]:
    if len(means) == 1:
        return means[0], variances[0]
    from scipy.stats import norm, t

    factor = float((t.ppf(0.975, len(means) - 1) / norm.ppf(0.975)) ** 2)
    mean, variance = np.zeros(3), np.zeros(3)
    for axis in range(3):
        value, own = means[:, axis], variances[:, axis]
        excess, middle = 0.0, float(value.mean())
        for _ in range(_ROUNDS):
            before, excess = excess, excess_variance(value - middle, own, len(value) - 1)
            total = own + excess
            weight = 1.0 / total if (total > 0.0).all() else np.ones(len(value))
            middle = float(weight @ value / weight.sum())
            if abs(excess - before) <= 1e-6 * excess:
                break
        share = weight / weight.sum()
        mean[axis], variance[axis] = middle, float(share**2 @ (own + factor * excess))
    return mean, variance
