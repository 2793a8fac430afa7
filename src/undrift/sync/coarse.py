"""Coarse lag: where does the length of the rate correlate best, over a wide search and with gaps masked?

Both lengths are averaged into cells of one width on a common clock. The correlation at every shift counts only cells that
both sides have seen: with masks m, n (0 or 1) and values x, y already multiplied by them, all sums over cells are
correlations of x, y, x^2, y^2, m and n, and a Fourier transform gives them for all shifts at once.
"""

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import AlignmentError
from undrift.sync.rates import PoseRates

CELL_S = 0.02  # s
LEAST_OVERLAP = 0.3  # of the shorter side


def coarse_lag(time: FloatArray, gyro: FloatArray, rates: PoseRates, longest_lag_s: float) -> float:
    """Return the lag at which the lengths of the two rates correlate best.

    Parameters
    ----------
    time : array, shape (N,)
        s, on the record's clock.
    gyro : array, shape (N, 3)
        Readings, any unit; the median of the quietest tenth counts as offset.
    rates : PoseRates
        Rates of the reference, on its own clock.
    longest_lag_s : float
        Half-width of the search, s.

    Returns
    -------
    float
        s, to about one cell.

    Raises
    ------
    AlignmentError
        The two share too little time.
    """
    centred = gyro - _offset(gyro)
    u, w = np.linalg.norm(centred, axis=1), np.linalg.norm(rates.rate, axis=1)
    middle = 0.5 * (rates.start + rates.stop)
    start = min(time[0], middle[0])
    count = int(np.ceil((max(time[-1], middle[-1]) - start) / CELL_S)) + 1
    cell = max(1, round(float(np.median(np.diff(time))) / CELL_S), round(float(np.median(np.diff(middle))) / CELL_S))
    x, m = _cells(time, u, np.isfinite(u), start, count // cell + 1, cell * CELL_S)
    y, n = _cells(middle, w, rates.valid, start, count // cell + 1, cell * CELL_S)
    reach = min(int(longest_lag_s / (cell * CELL_S)) + 1, len(x) - 1)
    correlation, overlap = _masked_correlation(x, m, y, n, reach)
    enough = overlap >= LEAST_OVERLAP * min(m.sum(), n.sum())
    if enough.any() and not np.isfinite(correlation[enough]).any():
        raise AlignmentError(
            "lag: wanted both sides to turn, got one that does not; there is no common motion to align by"
        )
    if not enough.any():
        raise AlignmentError(
            f"lag: wanted record and reference to share {LEAST_OVERLAP:.0%} of the shorter one within {longest_lag_s:g} s "
            "of search, got less; check their clocks, or widen longest_lag_s (--longest-lag-s)"
        )
    best = int(np.nanargmax(np.where(enough, correlation, np.nan)))
    return float((best - reach) * cell * CELL_S)


def _offset(gyro: FloatArray) -> FloatArray:
    seen = gyro[np.isfinite(gyro).all(axis=1)]
    change = np.abs(np.diff(seen, axis=0)).sum(axis=1)
    quiet = seen[1:][change <= np.quantile(change, 0.1)]
    spread = np.linalg.norm(quiet - np.median(quiet, axis=0), axis=1)
    offset: FloatArray = np.median(quiet[spread <= np.median(spread)], axis=0)
    return offset


def _cells(
    t: FloatArray, values: FloatArray, valid: BoolArray, start: float, count: int, width: float
) -> tuple[FloatArray, FloatArray]:
    k = ((t[valid] - start) / width).astype(np.int64)
    weight = np.bincount(k, minlength=count).astype(float)
    mean = np.bincount(k, weights=values[valid], minlength=count) / np.maximum(weight, 1.0)
    seen = (weight > 0.0).astype(float)
    overall = float((mean * seen).sum() / max(seen.sum(), 1.0))
    return (mean - overall) * seen, seen


def _masked_correlation(
    x: FloatArray, m: FloatArray, y: FloatArray, n: FloatArray, reach: int
) -> tuple[FloatArray, FloatArray]:
    # At shift s the record's cell k + s meets the reference's cell k.
    size = 1 << (2 * len(x) - 1).bit_length()
    first = np.fft.rfft(np.stack((x, x * x, m)), size)
    second = np.conj(np.fft.rfft(np.stack((y, y * y, n)), size))

    def summed(i: int, j: int) -> FloatArray:
        full = np.fft.irfft(first[i] * second[j], size)
        return np.concatenate((full[size - reach :], full[: reach + 1]))

    count = np.maximum(np.round(summed(2, 2)), 0.0)
    safe = np.maximum(count, 1.0)
    mean_x, mean_y = summed(0, 2) / safe, summed(2, 0) / safe
    var_x = summed(1, 2) / safe - mean_x**2
    var_y = summed(2, 1) / safe - mean_y**2
    covariance = summed(0, 0) / safe - mean_x * mean_y
    good = (count > 10.0) & (var_x > 1e-12 * var_x.max()) & (var_y > 1e-12 * var_y.max())
    product = np.sqrt(np.where(good, var_x * var_y, 1.0))
    return np.where(good, covariance / product, np.nan), count
