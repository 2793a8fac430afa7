"""How long marked samples last, by their own clock: each stands for the time since the sample before it.

Times are put on a grid of 2^-30 s (about 1 ns) first. Sums of such steps are exact up to 97 days, so that it does not matter in
which pieces they are taken: the chunks of a stream give the bits of the batch.
"""

import numpy as np

from undrift.arrays import BoolArray, FloatArray

TICKS_PER_S = 2.0**30


def seconds_of(mask: BoolArray, time: FloatArray, before: float | None) -> float:
    """Return how long the marked samples last: the sum of t_k - t_(k-1) over them.

    Parameters
    ----------
    mask : array of bool, shape (N,)
        True for the samples that count.
    time : array, shape (N,)
        Clock, s, two samples or more.
    before : float or None
        Time of the sample before the first, s; None where there is none: the first sample then lasts as long as the second.

    Returns
    -------
    float
        s.
    """
    if not mask.any():
        return 0.0
    first = 2.0 * time[0] - time[1] if before is None else before
    ticks = np.round(np.concatenate(([first], time)) * TICKS_PER_S)
    return float(np.diff(ticks)[mask].sum() / TICKS_PER_S)
