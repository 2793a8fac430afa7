"""Robust linear least squares of overlapping windows, with a covariance that knows that they overlap.

Huber's estimate by reweighting: an equation whose residual r exceeds k s counts k s / |r|, s from the median. Neighbouring
windows share readings and pose errors, so the covariance is the sandwich N^-1 S N^-1 with S the long-run covariance of the
scores g = J^T w r, lags up to the window length and beyond under Bartlett's triangle [1]_. The triangle is what the squares
of all sliding sums of B neighbours give, which is how it is computed here.

References
----------
.. [1] W. K. Newey, K. D. West, "A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent
   covariance matrix", 1987.
.. [2] J. G. MacKinnon, H. White, "Some heteroskedasticity-consistent covariance matrix estimators with improved finite
   sample properties", 1985.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.reference_windows import Windows
from undrift.calibration.fit.result import scaled_condition
from undrift.errors import NotObservable
from undrift.sync.rates import box_sums

_REWEIGHTINGS = 15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """One linear solution.

    Parameters
    ----------
    step : array, shape (P,)
        Change of the parameters.
    covariance : array, shape (P, P)
        Sandwich.
    residuals : array, shape (n, 3)
        rad, all windows.
    scale : float
        Robust standard deviation of the residuals, rad.
    rank, condition : int, float
        Of the design with columns scaled to one.
    """

    step: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    scale: float
    rank: int
    condition: float


def independent_windows(windows: Sequence[Windows], reach: int) -> int:
    """Return how many windows that do not overlap the recordings hold.

    Parameters
    ----------
    windows : sequence of Windows
        One for each recording.
    reach : int
        Strides in a window.

    Returns
    -------
    int
        Windows.
    """
    return sum(-(-len(w.first) // reach) for w in windows)


def solve(windows: Sequence[Windows], *, keep: FloatArray, huber: float, reach: int) -> Solution:
    """Solve the equations of several recordings.

    Parameters
    ----------
    windows : sequence of Windows
        One for each recording.
    keep : array, shape (P,)
        1 for a parameter to fit, 0 for one held fixed.
    huber : float
        Residuals up to this many standard deviations count fully.
    reach : int
        Strides in a window.

    Returns
    -------
    Solution
        Zero step and covariance for parameters held fixed.

    Raises
    ------
    NotObservable
        Too few windows, or motion that leaves a parameter undetermined.
    """
    kept = np.flatnonzero(keep)
    a = np.concatenate([w.design for w in windows])[:, :, kept]
    y = np.concatenate([w.turn for w in windows])
    independent = independent_windows(windows, reach)
    if 3 * independent <= len(kept):
        raise NotObservable(
            f"reference: wanted more than {len(kept) // 3} windows that do not overlap, got {independent}; "
            "record longer motion, or ask for shorter windows",
            windows=independent,
        )
    rank, condition = scaled_condition(a.reshape(-1, len(kept)))
    if rank < len(kept):
        raise NotObservable(
            f"reference: wanted motion about all three axes, got a design of rank {rank} for {len(kept)} parameters; "
            "turn the device about every axis",
            rank=rank,
        )
    x, weight, scale = _huber(a.reshape(-1, len(kept)), y.reshape(-1), huber)
    residual = y - a @ x
    bread = np.linalg.inv((a.reshape(-1, len(kept)).T * weight) @ a.reshape(-1, len(kept)))
    scores = np.einsum("nap,na->np", a, weight.reshape(-1, 3) * residual)
    meat = _long_run(scores, windows, 2 * reach)
    # Residuals are short of errors by their leverage, P / n on average; HC3's square of it, not HC1's first power [2]_.
    covariance = bread @ meat @ bread * (3 * independent / (3 * independent - len(kept))) ** 2
    return Solution(
        step=_spread(x, kept, len(keep)),
        covariance=_spread(_spread(covariance, kept, len(keep)).T, kept, len(keep)),
        residuals=residual,
        scale=scale,
        rank=rank,
        condition=condition,
    )


def _huber(a: FloatArray, y: FloatArray, k: float) -> tuple[FloatArray, FloatArray, float]:
    length = np.linalg.norm(a, axis=0)
    scaled = a / length
    weight = np.ones(len(y))
    x, scale = np.zeros(a.shape[1]), 0.0
    for _ in range(_REWEIGHTINGS):
        previous = x
        x = np.linalg.solve((scaled.T * weight) @ scaled, scaled.T @ (weight * y))
        size = np.abs(y - scaled @ x)
        scale = 1.4826 * float(np.median(size))
        weight = np.minimum(1.0, k * scale / np.maximum(size, 1e-15)) if scale > 0.0 else weight
        if np.abs(x - previous).max() <= 1e-9 * max(float(np.abs(x).max()), 1e-12):
            break
    return x / length, weight, scale


def _long_run(scores: FloatArray, windows: Sequence[Windows], width: int) -> FloatArray:
    size = scores.shape[1]
    meat = np.zeros((size, size))
    row = 0
    for w in windows:
        if not len(w.first):
            continue
        line = np.zeros((int(w.first[-1] - w.first[0]) + 2 * width - 1, size))
        line[w.first - w.first[0] + width - 1] = scores[row : row + len(w.first)]
        row += len(w.first)
        sums = box_sums(line, width)
        meat += sums.T @ sums / width
    return meat


def _spread(values: FloatArray, kept: np.ndarray, size: int) -> FloatArray:
    full = np.zeros((size, *values.shape[1:]))
    full[kept] = values
    return full
