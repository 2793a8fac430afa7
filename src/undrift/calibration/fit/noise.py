"""Noise of a mean reading, told by the scatter of short block means within the windows."""

from collections.abc import Sequence

import numpy as np

from undrift.arrays import FloatArray

BLOCK_S = 0.5  # means of this length count as independent of each other
_LEAST_SPARE = 6  # fewer spare blocks than this say nothing


def noise_of_means(windows: Sequence[FloatArray], sizes: Sequence[int], removed: int = 1) -> FloatArray | None:
    """Return the standard deviation of the mean of each window.

    Each window is cut into blocks; the variance of block means about their window's mean is pooled over all windows, and the
    mean of N samples has that variance times block length / N.

    Parameters
    ----------
    windows : sequence of array, shape (N, 3)
        Readings, or what a filter left of them.
    sizes : sequence of int
        Samples in a block of each window.
    removed : int
        Parameters fitted to each window: the mean alone, or those of the polynomial that was taken off.

    Returns
    -------
    array, shape (P, 3), or None
        Standard deviations; None where there are too few blocks to tell.
    """
    square, spare = np.zeros(3), 0
    for values, size in zip(windows, sizes, strict=True):
        count = len(values) // size
        if count > removed:
            means = values[: count * size].reshape(count, size, 3).mean(axis=1)
            square += ((means - means.mean(axis=0)) ** 2).sum(axis=0)
            spare += count - removed
    if spare < _LEAST_SPARE:
        return None
    share = np.array([size / max(1, len(values)) for values, size in zip(windows, sizes, strict=True)])
    return np.asarray(np.sqrt(square / spare * share[:, None]))


def block_size(sample_rate_hz: float) -> int:
    """Return the samples in one block.

    Parameters
    ----------
    sample_rate_hz : float
        Hz.

    Returns
    -------
    int
        One at least.
    """
    return max(1, round(BLOCK_S * sample_rate_hz))
